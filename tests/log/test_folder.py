"""Logs that nobody asked for: where they are, which make room, and that none keeps from flying."""

from __future__ import annotations

import asyncio
import fcntl
import hashlib
import os
import threading
from contextlib import nullcontext
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import MagicMock

import pytest
from mcap.writer import Writer

from m100link import connect
from m100link.apps.agent.server.connection import by_driver, by_url
from m100link.errors import NoAircraft, UsageError
from m100link.log import Recorder, read
from m100link.log.folder import Flights, LogDirectory, default_folder, is_log_name
from m100link.sim import Driver, VirtualAircraft
from tests.apps.fleet.logs.conftest import FIRST, SECOND, bytes_of
from tests.apps.fleet.logs.conftest import directory as directory
from tests.waiting import PATIENCE, blocking_until

pytestmark = pytest.mark.anyio


class Told:
    """The reports to people."""

    def __init__(self) -> None:
        self.all: list[tuple[str, str]] = []

    def __call__(self, text: str, level: str) -> None:
        self.all.append((level, text))


async def made(folder: Path, name: str, age_s: float) -> Path:
    """A log of ours, so old."""
    path = folder / name
    async with connect("sim://", record=path):
        await asyncio.sleep(0.2)
    stamp = 1_700_000_000 - age_s
    os.utime(path, (stamp, stamp))
    return path


def files_in(folder: Path) -> list[Path]:
    return sorted(folder.iterdir())


def test_flights_are_kept_where_the_system_wants_state(tmp_path: Path) -> None:
    own = Path("~/.local/state/m100link/flights").expanduser()
    assert default_folder({}) == own
    assert default_folder({"XDG_STATE_HOME": "relative"}) == own
    assert default_folder({"XDG_STATE_HOME": str(tmp_path)}) == tmp_path / "m100link/flights"


async def test_the_oldest_of_ours_that_nobody_writes_make_room(tmp_path: Path) -> None:
    names = [f"m100link-20260101-00000{n}.mcap" for n in range(6)]
    paths = [await made(tmp_path, name, 600.0 - n) for n, name in enumerate(names)]
    foreign = tmp_path / "m100link-20250101-000000.mcap"
    foreign.write_bytes(b"\x89MCAP0\r\n" + b"\x01" + (8).to_bytes(8, "little") + bytes(8))
    other, empty = tmp_path / "holiday.mcap", tmp_path / "m100link-20240101-000000.mcap"
    other.write_bytes(paths[0].read_bytes())
    empty.touch()
    away = tmp_path / "elsewhere"
    away.write_bytes(paths[0].read_bytes())
    link = tmp_path / "m100link-20230101-000000.mcap"
    link.symlink_to(away)
    for path in (foreign, other, empty):
        os.utime(path, (1_600_000_000, 1_600_000_000))
    writing = Recorder(tmp_path / "m100link-20220101-000000.mcap")
    async with connect("sim://", record=writing):
        await asyncio.sleep(0.5)
        os.utime(writing.path, (1_500_000_000, 1_500_000_000))
        flights = Flights(tmp_path, keep=3, tell=Told())
        flights.make_room()
        assert [path.exists() for path in paths] == [False] * 3 + [True] * 3
        assert writing.path.exists()
    for path in (foreign, other, empty, link, away):
        assert path.exists(), path
    size = paths[-1].stat().st_size
    assert size < 1_000_000
    Flights(tmp_path, keep_mb=0, tell=Told()).make_room()
    assert paths[3].exists()


async def test_megabytes_are_counted_from_the_newest(tmp_path: Path) -> None:
    paths = [await made(tmp_path, f"m100link-20260101-00000{n}.mcap", -n) for n in range(3)]
    for path in paths[1:]:
        stamp = path.stat().st_mtime
        with path.open("ab") as stream:
            stream.truncate(700_000)
        os.utime(path, (stamp, stamp))
    Flights(tmp_path, keep_mb=1, tell=Told()).make_room()
    assert [path.exists() for path in paths] == [False, False, True]


@pytest.mark.parametrize(
    ("keep", "keep_mb", "left"),
    [(3, 0, 3), (2, 0, 2), (1, 0, 1), (0, 2, 3), (0, 1, 2), (2, 2, 2), (0, 0, 4)],
)
async def test_as_many_are_kept_as_was_said(
    tmp_path: Path, keep: int, keep_mb: int, left: int
) -> None:
    """Four logs; the three newest have two megabytes together, and the two newest one."""
    paths = [await made(tmp_path, f"m100link-20260101-00000{n}.mcap", -n) for n in range(4)]
    for path, size in zip(paths, (100_000, 1_000_000, 400_000, 600_000), strict=True):
        stamp = path.stat().st_mtime
        with path.open("ab") as stream:
            stream.truncate(size)
        os.utime(path, (stamp, stamp))
    Flights(tmp_path, keep=keep, keep_mb=keep_mb, tell=Told()).make_room()
    assert [path.exists() for path in paths] == [False] * (4 - left) + [True] * left


@pytest.mark.parametrize("anyio_backend", ["asyncio"])
async def test_each_connection_of_an_agent_gets_a_log(tmp_path: Path) -> None:
    """By the machine's clock: the threads that write take their time, a virtual one takes none."""
    told = Told()
    flights = Flights(tmp_path / "made" / "by us", tell=told)
    driver = Driver(VirtualAircraft(seed=3))
    driver.start()
    for opened in (by_url("sim://", flights=flights), by_driver(driver, flights=flights)):
        aircraft = await opened()
        await asyncio.sleep(0.5)
        await aircraft.aclose()
        assert flights.newest is not None
        log = read(flights.newest)
        summary = log.summary()
        assert summary.is_whole
        assert summary.firmware == "1.0"
        assert sum(1 for _ in log.samples()) > 20
    driver.stop()
    assert len(list(flights.folder.iterdir())) == 2
    assert [level for level, _ in told.all] == ["info", "info"]
    assert flights.folder.stat().st_mode & 0o077 == 0, "where somebody flew is theirs to tell"


async def test_an_attempt_that_found_no_aircraft_leaves_nothing(tmp_path: Path) -> None:
    flights = Flights(tmp_path, tell=Told())
    for _ in range(3):
        with pytest.raises(NoAircraft):
            await by_url("sim://?mute", timeout=0.5, flights=flights)()
    assert files_in(tmp_path) == []


async def test_what_cannot_be_recorded_is_reported_once_and_flown(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    told = Told()
    file = tmp_path / "a file"
    file.touch()
    flights = Flights(file, tell=told)
    for _ in range(2):
        aircraft = await by_url("sim://", flights=flights)()
        await aircraft.aclose()
    assert [level for level, _ in told.all] == ["warning"]
    assert "not recorded" in told.all[0][1]
    monkeypatch.setitem(__import__("sys").modules, "mcap.writer", None)
    told.all.clear()
    aircraft = await by_url("sim://", flights=Flights(tmp_path / "there", tell=told))()
    await aircraft.aclose()
    assert "pip install '.[log]'" in told.all[0][1]


@pytest.mark.parametrize("lacking", [RuntimeError("can't start new thread"), MemoryError()])
async def test_a_log_for_which_there_is_no_thread_keeps_no_aircraft_from_flying(
    lacking: Exception, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    why, start = str(lacking) or "MemoryError()", threading.Thread.start
    for name, text in (("log ", "not recorded"), ("m100link: old logs", "old flight logs stay")):

        def refuse(thread: threading.Thread, name: str = name) -> None:
            if thread.name.startswith(name):
                raise lacking
            start(thread)

        monkeypatch.setattr(threading.Thread, "start", refuse)
        told = Told()
        aircraft = await by_url("sim://", flights=Flights(tmp_path, tell=told))()
        await aircraft.aclose()
        assert told.all[-1] == ("warning", f"{text}: {why}")


async def test_of_a_log_that_nobody_waits_for_only_one_that_was_made_is_closed() -> None:
    flights, loop = Flights(Path(), tell=Told()), asyncio.get_running_loop()
    closed: list[str] = []

    async def aclose() -> None:
        closed.append("made")

    made, failed, cancelled = (loop.create_future() for _ in range(3))
    made.set_result(SimpleNamespace(aclose=aclose))
    failed.set_exception(OSError("no space"))
    cancelled.cancel()  # the program ends while the disk stands still
    for making in (cancelled, failed, made):
        flights._abandon(making)
    await asyncio.gather(*flights._ending)
    assert closed == ["made"]


async def test_no_disk_is_waited_for_in_the_event_loop(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Another aircraft of the process may fly in it while this one connects."""
    flights = Flights(tmp_path, keep=1, tell=Told())
    threads: set[int] = set()
    made, dropped = flights._made, flights.drop
    has_room = threading.Event()

    def make() -> Recorder:
        threads.add(threading.get_ident())
        return made()

    def drop(log: Recorder) -> None:
        threads.add(threading.get_ident())
        dropped(log)

    def make_room() -> None:
        threads.add(threading.get_ident())
        has_room.set()

    for name, one in (("_made", make), ("drop", drop), ("make_room", make_room)):
        monkeypatch.setattr(flights, name, one)
    aircraft = await by_url("sim://", flights=flights)()
    await aircraft.aclose()
    assert has_room.wait(PATIENCE)
    with pytest.raises(NoAircraft):
        await by_url("sim://?mute", timeout=0.5, flights=flights)()
    assert threads
    assert threading.get_ident() not in threads


async def test_a_program_that_is_cancelled_while_a_log_is_made_leaves_none(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    flights = Flights(tmp_path, tell=Told())
    has_begun, goes_on, is_made = (threading.Event() for _ in range(3))
    made = flights._made

    def make() -> Recorder:
        has_begun.set()
        goes_on.wait(PATIENCE)
        try:
            return made()
        finally:
            is_made.set()

    monkeypatch.setattr(flights, "_made", make)
    beginning = asyncio.ensure_future(flights.begin())
    await asyncio.to_thread(has_begun.wait, PATIENCE)
    beginning.cancel()
    with pytest.raises(asyncio.CancelledError):
        await beginning
    goes_on.set()
    assert is_made.wait(PATIENCE)
    assert files_in(tmp_path) != []
    await asyncio.to_thread(blocking_until, lambda: files_in(tmp_path) == [])


async def test_a_disk_that_stands_still_keeps_nobody_from_flying(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """An aircraft whose cable was out for a second waits in the air to be connected again."""
    told = Told()
    flights = Flights(tmp_path, tell=told)
    goes_on, made, tries = threading.Event(), flights._made, list[int]()

    def make() -> Recorder:
        tries.append(1)
        goes_on.wait(PATIENCE)
        return made()

    monkeypatch.setattr("m100link.log.folder.DISK_S", 0.01)
    monkeypatch.setattr(flights, "_made", make)
    for _ in range(3):
        aircraft = await by_url("sim://", flights=flights)()
        await aircraft.aclose()
    assert tries == [1], "one thread is enough to wait for it"
    text = f"{tmp_path}: the disk does not answer within 0.01 s (name a folder of another disk)"
    assert told.all == [("warning", f"not recorded: {text}")]
    goes_on.set()
    monkeypatch.undo()
    assert flights._making is not None
    await asyncio.wait({flights._making})
    aircraft = await by_url("sim://", flights=flights)()
    await aircraft.aclose()
    await asyncio.to_thread(blocking_until, lambda: len(files_in(tmp_path)) == 1)


def log_of(folder: Path, number: int, *, library: str = "m100link 9", size: int = 0) -> Path:
    """A log of some writer, the later ones newer, filled up to a size."""
    path = folder / f"m100link-20260101-00000{number}.mcap"
    with path.open("wb") as stream:
        writer: Any = Writer(stream)
        writer.start(library=library)
        writer.finish()
        stream.truncate(max(size, stream.tell()))
    os.utime(path, (1_700_000_000 + number, 1_700_000_000 + number))
    return path


@pytest.mark.parametrize(
    ("sizes", "keep", "keep_mb", "left"),
    [
        ([0, 0, 0], 1, 0, [2]),
        ([0, 0, 0], 0, 1, [0, 1, 2]),
        ([400_000, 600_000, 400_000], 0, 1, [1, 2]),  # of the newest a megabyte
        ([400_000, 600_001, 400_000], 0, 1, [2]),
        ([0, 0, 2_000_000], 0, 1, [2]),  # the newest stays, whatever it takes
        ([0, 0, 2_000_000], 5, 0, [0, 1, 2]),
        ([0, 0, 0], 0, 0, [0, 1, 2]),
    ],
)
def test_the_newest_stays_and_older_ones_while_there_is_room(
    tmp_path: Path, sizes: list[int], keep: int, keep_mb: int, left: list[int]
) -> None:
    paths = [log_of(tmp_path, number, size=size) for number, size in enumerate(sizes)]
    Flights(tmp_path, keep=keep, keep_mb=keep_mb, tell=Told()).make_room()
    assert [number for number, path in enumerate(paths) if path.exists()] == left


def test_what_somebody_writes_or_somebody_else_wrote_is_left_alone(tmp_path: Path) -> None:
    ours, written = log_of(tmp_path, 0), log_of(tmp_path, 1)
    others = [log_of(tmp_path, 2, library="m100linked"), log_of(tmp_path, 3, library="")]
    newest = log_of(tmp_path, 4)
    with written.open("rb") as stream:
        fcntl.flock(stream, fcntl.LOCK_EX)
        Flights(tmp_path, keep=1, tell=Told()).make_room()
        assert files_in(tmp_path) == [written, *others, newest]
    Flights(tmp_path, keep=1, tell=Told()).make_room()
    assert files_in(tmp_path) == [*others, newest]
    assert not ours.exists()


@pytest.mark.parametrize(
    ("name", "is_one"),
    [
        ("m100link-20260101-120000.mcap", True),
        ("m100link-20260101-120000-2.mcap", True),
        ("m100link-2026010-120000.mcap", False),
        ("m100link-20260101-120000.mcap.part", False),
        ("m100link-20260101-120000-.mcap", False),
        ("a/m100link-20260101-120000.mcap", False),
        ("m100link-20260101-120000.mcap\n", False),
    ],
)
def test_a_log_has_a_name_of_its_time(name: str, is_one: bool) -> None:
    assert is_log_name(name) is is_one


# -- the folder on board: logs, and nothing else that is in it or near it --------------------------


def wanted() -> bool:
    return True


def test_the_newest_stands_first_and_what_is_written_is_said(directory: Path) -> None:
    os.utime(directory / FIRST, (1000.0, 1000.0))
    recorder = Recorder(directory)
    names = {one.log: one for one in LogDirectory(directory).entries()}
    assert list(names) == [recorder.path.name, FIRST]
    assert (names[FIRST].size, names[FIRST].at, names[FIRST].is_written) == (300_000, 1000.0, False)
    assert names[recorder.path.name].is_written
    [newest] = LogDirectory(directory).entries(1)
    assert newest == names[recorder.path.name]
    recorder._end()


def test_a_piece_ends_where_the_log_does(directory: Path) -> None:
    data, entry = LogDirectory(directory).piece(FIRST, 299_990, 64)
    assert data == bytes_of(300_000)[-10:]
    assert entry.size == 300_000
    assert LogDirectory(directory).piece(FIRST, 400_000, 64)[0] == b""


def test_the_digest_is_of_the_first_bytes(directory: Path) -> None:
    found = LogDirectory(directory).digest(FIRST, 1000, wanted)
    assert found == hashlib.sha256(bytes_of(300_000)[:1000]).digest()
    with pytest.raises(UsageError, match="it has 300000 bytes"):
        LogDirectory(directory).digest(FIRST, 300_001, wanted)
    with pytest.raises(UsageError, match="the agent ends"):
        LogDirectory(directory).digest(FIRST, 1000, lambda: False)


def test_a_log_on_a_disk_that_fails_is_refused(
    directory: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = LogDirectory(directory)
    with (directory / FIRST).open("rb") as file:
        stream = MagicMock(fileno=file.fileno)
        stream.read.side_effect = OSError(5, "Input/output error")
        monkeypatch.setattr(found, "_opened", lambda _: nullcontext(stream))
        with pytest.raises(UsageError, match="Input/output error"):
            found.piece(FIRST, 0, 9)
        with pytest.raises(UsageError, match="Input/output error"):
            found.digest(FIRST, 9, wanted)


def test_no_name_leads_out_and_no_link_anywhere(directory: Path) -> None:
    secret = directory.parent / FIRST
    secret.write_bytes(b"secret")
    (directory / SECOND).symlink_to(secret)
    (directory / "m100link-20260101-000002.mcap").mkdir()
    os.mkfifo(directory / "m100link-20260101-000003.mcap")
    (directory / "notes.mcap").write_bytes(b"theirs")
    one = LogDirectory(directory)
    assert [entry.log for entry in one.entries()] == [FIRST]
    for name in (
        SECOND,
        f"../{FIRST}",
        str(secret),
        "notes.mcap",
        "m100link-20260101-000002.mcap",
        "m100link-20260101-000003.mcap",
        "m100link-20260101-000009.mcap",
        "",
    ):
        for ask in (
            lambda name=name: one.piece(name, 0, 9),
            lambda n=name: one.digest(n, 1, wanted),
        ):
            with pytest.raises(UsageError, match="no log"):
                ask()


def test_where_nothing_is_recorded_there_is_nothing(tmp_path: Path) -> None:
    assert LogDirectory(None).entries() == LogDirectory(tmp_path / "none").entries() == []
    with pytest.raises(UsageError):
        LogDirectory(None).piece(FIRST, 0, 1)
