"""What is recorded, what it must not hold, and what a bad disk does to the flight: nothing."""

from __future__ import annotations

import asyncio
import atexit
import errno
import itertools
import json
import logging
import math
import subprocess
import sys
import threading
import time
import zlib
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from mcap.writer import Writer

from m100link import Position, connect
from m100link.errors import PortNotFound, UsageError
from m100link.link import Direction
from m100link.log import Recorder, read, recorder
from m100link.log.channels import COMMAND, EVENT, FIX, LINK, RX, TELEMETRY, TX, Entry
from m100link.wire import encode_frame
from tests.disk import Disk
from tests.log.flight import APP_ID, KEY, URL, fly
from tests.waiting import PATIENCE, kept_waiting_altogether

pytestmark = pytest.mark.anyio

VERSION = encode_frame(b"\x00\x00\x00", session=2, sequence=78)


def files_in(folder: Path) -> list[Path]:
    return sorted(folder.iterdir())


async def test_every_byte_of_the_flight_is_in_its_log(tmp_path: Path) -> None:
    heard: dict[Direction, list[bytes]] = {one: [] for one in Direction}
    path = tmp_path / "flight.mcap"
    seen = await fly(path, tap=lambda way, data, _: heard[way].append(data))
    log = read(path)
    for direction, topic in ((Direction.RECEIVED, RX), (Direction.SENT, TX)):
        joined = b"".join(message.data for message in log.messages(topic))
        whole = b"".join(heard[direction])
        assert len(joined) == len(whole)
        chunks = [one.data for one in log.chunks() if one.direction is direction]
        assert len(chunks) > 20
        assert b"".join(chunks) == joined
        if direction is Direction.RECEIVED:
            assert joined == whole
    samples = list(log.samples())[-len(seen) :]
    assert [one.value for one in samples] == [one.value for one in seen]
    assert [one.received_at for one in samples] == pytest.approx(
        [one.received_at for one in seen], abs=2e-6
    )
    assert max(log.table(Position).column("position.height_m")) > 1.5


def records_of(data: bytes) -> list[tuple[int, int, bytes]]:
    """Offset, opcode and content of each record between the magics of an MCAP file."""
    found, at = [], 8
    while at < len(data) - 8:
        size = int.from_bytes(data[at + 1 : at + 9], "little")
        found.append((at, data[at], data[at + 9 : at + 9 + size]))
        at += 9 + size
    assert at == len(data) - 8
    return found


async def test_each_byte_of_a_log_is_under_a_checksum(tmp_path: Path) -> None:
    """MCAP: CRC-32 of each chunk, of the data section and of the summary; 0 is none at all."""
    path = tmp_path / "flight.mcap"
    await fly(path)
    data = path.read_bytes()
    records = records_of(data)
    chunks = [content for _, opcode, content in records if opcode == 0x06]
    assert chunks
    assert all(any(content[24:28]) for content in chunks)
    [(ends_at, end)] = [(at, content) for at, opcode, content in records if opcode == 0x0F]
    assert int.from_bytes(end[:4], "little") == zlib.crc32(data[:ends_at]) != 0
    at, opcode, footer = records[-1]
    assert opcode == 0x02
    summary_at = int.from_bytes(footer[:8], "little")
    assert ends_at < summary_at < at
    # Up to the checksum itself: the footer's head and the two offsets in it count, too.
    summary = data[summary_at : at + 9 + 16]
    assert int.from_bytes(footer[16:20], "little") == zlib.crc32(summary) != 0


async def test_what_was_commanded_is_reported_with_its_answer(tmp_path: Path) -> None:
    path = tmp_path / "flight.mcap"
    await fly(path)
    told = [message.content() for message in read(path).messages(COMMAND)]
    names = [(one["command"], one["is_ack"]) for one in told]
    for name in ("get_version", "activate", "request_authority", "start_task"):
        assert (name, False) in names
        assert (name, True) in names
    tasks = [one["task"] for one in told if one["command"] == "start_task" and not one["is_ack"]]
    assert tasks == ["take_off", "land"]
    moves = [one for one in told if one["command"] == "move"]
    assert len(moves) > 50
    assert all(one["direction"] == "tx" for one in moves)
    assert max(one["movement"]["roll_or_x"] for one in moves) > 1.0  # to the north
    events = [message.content() for message in read(path).messages(EVENT)]
    after = [one["after"] for one in events if one["event"] == "authority"]
    assert after == ["obtaining", "held", "releasing", "none"]
    assert events[-1]["event"] == "connection"
    assert events[-1]["is_connected"] is False


async def test_neither_app_id_nor_key_is_in_the_file_in_any_form(tmp_path: Path) -> None:
    path = tmp_path / "flight.mcap"
    await fly(path)
    log = read(path)
    inside = b"\n".join(message.data for message in log.messages())
    plain = path.read_bytes() + inside
    forms = {
        APP_ID.to_bytes(4, "little"),
        APP_ID.to_bytes(4, "big"),
        str(APP_ID).encode(),
        f"{APP_ID:x}".encode(),
        bytes.fromhex(KEY),
        KEY.encode(),
        KEY.upper().encode(),
    }
    assert [form for form in forms if form in plain] == []
    told = [message.content() for message in log.messages(COMMAND)]
    asked = [one for one in told if one["command"] == "activate" and not one["is_ack"]]
    assert asked
    assert all(one["redacted"] for one in asked)


@pytest.mark.parametrize("cuts", [(), (16,), (3, 15, 17, 40), (61,)])
@pytest.mark.parametrize("pause", [0.0, 0.25])
async def test_a_line_joined_with_itself_does_not_show_the_app_id(
    tmp_path: Path, cuts: tuple[int, ...], pause: float
) -> None:
    secret = APP_ID.to_bytes(4, "little")
    activation = encode_frame(b"\x00\x01" + secret + bytes(range(40)), session=2, sequence=1)
    path = tmp_path / "flight.mcap"
    record = Recorder(path)
    clock = asyncio.get_running_loop()
    record.tap(Direction.SENT, activation, clock.time())
    edges = (0, *cuts, len(activation))
    for begin, end in itertools.pairwise(edges):
        await asyncio.sleep(pause)
        record.tap(Direction.RECEIVED, activation[begin:end], clock.time())
    await record.aclose()
    raw = {topic: b"".join(one.data for one in read(path).messages(topic)) for topic in (RX, TX)}
    assert raw[RX] == raw[TX]
    assert len(raw[RX]) == len(activation)
    assert secret not in raw[RX]


async def test_an_activation_that_the_disk_did_not_take_is_not_shown_by_its_echo(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    secret = APP_ID.to_bytes(4, "little")
    activation = encode_frame(b"\x00\x01" + secret + bytes(range(40)), session=2, sequence=1)
    record = Recorder(tmp_path / "flight.mcap")
    clock = asyncio.get_running_loop()
    with monkeypatch.context() as stands_still:
        stands_still.setattr(recorder, "MAX_WAITING", 0)
        record.tap(Direction.SENT, activation + VERSION, clock.time())
        record.tap(Direction.SENT, VERSION, clock.time())
        await asyncio.sleep(0.15)
    assert record.dropped == len(VERSION)
    record.tap(Direction.RECEIVED, activation, clock.time())
    await record.aclose()
    raw = b"".join(one.data for one in read(record.path).messages(RX, TX))
    assert len(raw) == 2 * len(activation) + len(VERSION)
    assert secret not in raw


async def test_telemetry_is_thinned_and_counters_come_once_a_second(tmp_path: Path) -> None:
    counts = {}
    for rate in (10.0, 0.0):
        record = Recorder(tmp_path / f"{rate}.mcap", rate_hz=rate)
        await fly(record)
        summary = read(record.path).summary()
        counts[rate] = summary.messages[TELEMETRY]
        assert summary.is_whole
        assert summary.firmware == "1.0"
        assert summary.messages[LINK] == pytest.approx(summary.duration_s, abs=2)
        assert summary.messages[FIX] == counts[rate]
    assert counts[0.0] > 9 * counts[10.0]


async def test_json_of_a_log_is_json(tmp_path: Path) -> None:
    path = tmp_path / "flight.mcap"
    await fly(path)

    def refuse(word: str) -> None:
        raise AssertionError(f"{word} is not JSON")

    for message in read(path).messages(COMMAND, EVENT, FIX, LINK, TELEMETRY):
        json.loads(message.data, parse_constant=refuse)


async def test_a_full_disk_ends_the_log_with_one_warning_and_not_the_flight(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    calls = 0

    def flush(self: object) -> None:
        nonlocal calls
        calls += 1
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(Writer, "flush", flush)
    monkeypatch.setattr(recorder, "FLUSH_S", 0.0)
    record = Recorder(tmp_path / "flight.mcap")
    seen = await fly(record)
    assert len(seen) > 500
    assert isinstance(record.failure, OSError)
    assert calls == 1
    [warning] = [one for one in caplog.records if one.name == "m100link.log.recorder"]
    assert warning.levelno == logging.WARNING
    assert "the flight goes on" in warning.message


async def test_a_disk_that_stands_still_delays_nothing_and_what_is_lost_is_counted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    goes_on = threading.Event()
    whole = Writer.add_message

    def add_message(self: Writer, *args: object, **more: object) -> None:
        assert goes_on.wait(PATIENCE)
        whole(self, *args, **more)  # type: ignore[arg-type]

    monkeypatch.setattr(Writer, "add_message", add_message)
    monkeypatch.setattr(recorder, "MAX_WAITING", 20_000)
    record = Recorder(tmp_path / "flight.mcap")
    async with connect(URL, record=record) as aircraft:
        await asyncio.sleep(10.0)  # by the virtual clock: the thread writes nothing meanwhile
        assert aircraft.state.newest_age is not None
        assert aircraft.state.newest_age < 0.1
        received = aircraft.statistics().bytes_received
        goes_on.set()
    assert received > 100_000
    assert received - 40_000 < record.dropped < received
    kept = sum(len(message.data) for message in read(record.path).messages(RX, TX))
    sent = sum(len(message.data) for message in read(record.path).messages(TX))
    assert kept + record.dropped == pytest.approx(received + sent, abs=3000)


async def test_files_that_cannot_be_are_refused_before_a_port_is_opened(tmp_path: Path) -> None:
    there = tmp_path / "there.mcap"
    there.write_bytes(b"mine")
    for path, why in (
        (there, "is there already"),
        (tmp_path / "no" / "such.mcap", "No such file or directory"),
        (tmp_path / ("x" * 300), "File name too long"),
    ):
        with pytest.raises(UsageError, match=why):
            await connect("/dev/no-such-port", record=path)
    assert there.read_bytes() == b"mine"
    with pytest.raises(UsageError, match="not a rate"):
        Recorder(tmp_path / "x.mcap", rate_hz=-1)
    with pytest.raises(PortNotFound):
        await connect("/dev/no-such-port", record=tmp_path / "empty.mcap")
    assert files_in(tmp_path) == [there]  # where nothing was heard, nothing is left


async def test_two_processes_that_begin_in_one_second_get_a_file_each(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(time, "strftime", lambda *_: "m100link-20261122-101500")
    other = tmp_path / "m100link-20261122-101500.mcap"
    other.write_bytes(b"theirs")
    monkeypatch.setattr(Path, "exists", lambda _: False)  # it came between looking and opening
    record = Recorder(tmp_path)
    assert record.path.name == "m100link-20261122-101500-2.mcap"
    await record.aclose()
    assert other.read_bytes() == b"theirs"


async def test_a_recorder_is_of_one_connection(tmp_path: Path) -> None:
    record = Recorder(tmp_path / "flight.mcap")
    async with connect("sim://", record=record):
        with pytest.raises(UsageError, match="is the log of another connection"):
            await connect("sim://", record=record)
        await asyncio.sleep(2.0)
    with pytest.raises(UsageError, match="is the log of another connection"):
        await connect("sim://", record=record)
    summary = read(record.path).summary()  # the refused did not end it
    assert summary.is_whole
    assert summary.duration_s == pytest.approx(2.0, abs=0.3)


async def test_a_recorder_that_is_ended_early_notes_nothing_more(tmp_path: Path) -> None:
    record = Recorder(tmp_path / "flight.mcap")
    record._given = record._taken = recorder.MAX_WAITING  # what the disk took waits no more
    async with connect("sim://", record=record) as aircraft:
        await asyncio.sleep(1.0)
        await record.aclose()
        await asyncio.sleep(5.0)
        assert aircraft.statistics().bytes_received > 10_000
        assert record._batch.size == 0
    assert read(record.path).summary().duration_s == pytest.approx(1.0, abs=0.3)


async def test_what_cannot_be_asked_costs_its_records_and_not_the_bytes(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    record = Recorder(tmp_path / "flight.mcap")
    asked = 0

    def look() -> list[Entry]:
        nonlocal asked
        asked += 1
        raise RuntimeError("not today")

    async with connect("sim://", record=record) as aircraft:
        await asyncio.sleep(1.0)
        record.watch(aircraft.link, lambda: aircraft.firmware, look)
        await asyncio.sleep(5.0)
    assert asked == 1
    [said] = [one for one in caplog.records if one.name == "m100link.log.recorder"]
    assert "only bytes are recorded" in said.message
    summary = read(record.path).summary()
    assert summary.is_whole
    assert summary.duration_s == pytest.approx(6.0, abs=0.3)


@pytest.mark.parametrize("error", [KeyboardInterrupt, SystemExit])
async def test_an_interrupt_while_it_is_noted_does_not_end_the_log(
    tmp_path: Path, error: type[BaseException]
) -> None:
    record = Recorder(tmp_path / "flight.mcap")

    def look() -> list[Entry]:
        raise error

    loop = asyncio.get_running_loop()
    record._look = look
    record.tap(Direction.SENT, b"before", loop.time())
    with pytest.raises(error):
        record._tick()
    record._look = tuple
    record.tap(Direction.SENT, b"after", loop.time())
    await asyncio.sleep(0.3)
    assert record._batch.size == 0  # handed over: the timer goes on
    await record.aclose()


async def test_a_tap_that_raises_costs_the_log_nothing(tmp_path: Path) -> None:
    def fails(*_: object) -> None:
        raise ValueError("a bad tap")

    path = tmp_path / "flight.mcap"
    async with connect("sim://", record=path, tap=fails) as aircraft:
        await asyncio.sleep(2.0)
        received = aircraft.statistics().bytes_received
    assert read(path).summary().bytes_received == pytest.approx(received, rel=0.1)
    assert received > 10_000


async def test_a_folder_gets_a_file_for_each_flight(tmp_path: Path) -> None:
    for _ in range(3):
        async with connect("sim://", record=tmp_path):
            await asyncio.sleep(0.3)
    files = files_in(tmp_path)
    assert len(files) == 3
    assert all(read(file).summary().is_whole for file in files)


@pytest.mark.smoke
@pytest.mark.pty  # in real time, for who is killed has no other
def test_a_process_that_is_killed_loses_a_second_at_most(tmp_path: Path) -> None:
    path = tmp_path / "flight.mcap"
    with subprocess.Popen(
        [sys.executable, "-c", FLIES_ON, str(path)], stdout=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        told = [process.stdout.readline()]
        before = kept_waiting_altogether(process.pid)
        told += [process.stdout.readline() for _ in range(100)]
        late = kept_waiting_altogether(process.pid) - before
        assert str(read(path).damage) == "it is still being recorded"
        process.kill()
        lived = float([*told, *process.stdout.read().split()][-1])
    log = read(path)
    lost = lived - max(chunk.utc for chunk in log.chunks())
    # What it noted for 0.1 s, and wrote without a flush for 0.5 s. Where the machine keeps the
    # program from running for longer than that, the test is repeated, or not judged.
    assert lost < 1.0
    assert lost < 1.0 + late, "late: because others ran"
    assert not log.summary().is_whole
    assert not log.damage.is_written


FLIES_ON = """
import asyncio, sys, time, m100link

async def main():
    async with m100link.connect("sim://", record=sys.argv[1]):
        while True:
            await asyncio.sleep(0.02)
            print(time.time(), flush=True)

asyncio.run(main())
"""


def test_a_log_is_ours_also_when_somebody_looks_at_it_as_it_begins(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A program that lists logs locks each for a moment; without it, it counts as written."""
    lock, looks = recorder._lock, iter([False, False])
    monkeypatch.setattr(recorder, "_lock", lambda stream: next(looks, True) and lock(stream))
    one = Recorder(tmp_path)
    monkeypatch.undo()
    assert recorder.is_being_written(one.path)
    one._end()


async def test_a_log_is_on_the_disk_as_it_ends(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Not only with the kernel: after a flight a cut of the power leaves all of it."""
    disk = Disk(monkeypatch, tmp_path)
    await fly(tmp_path / "flight.mcap")
    assert disk.content(tmp_path / "flight.mcap") == (tmp_path / "flight.mcap").read_bytes()


def test_a_computer_that_loses_its_power_loses_five_seconds_of_the_log(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As the manual says; the thread looks at the time with each batch, here every 0.1 s."""
    path, now = tmp_path / "flight.mcap", [1000.0]
    disk = Disk(monkeypatch, tmp_path)
    with path.open("xb") as stream, monkeypatch.context() as patch:
        patch.setattr(time, "monotonic", lambda: now[0])
        log = recorder.LogWriter(stream, 10.0)
        lost, flushes, flush = [], 0, log.flush

        def counted() -> None:
            nonlocal flushes
            flushes += 1
            flush()

        patch.setattr(log, "flush", counted)
        for number in range(130):
            now[0] += 0.1
            log.write(recorder.Batch([(Direction.SENT, VERSION, now[0])]))
            log.flush_in_time()
            kept = disk.content(path)
            if number % 7 == 0 and kept:
                (tmp_path / "left.mcap").write_bytes(kept)
                newest = max(one.at for one in read(tmp_path / "left.mcap").chunks())
                lost.append(now[0] - newest)
        log.close()
    assert 20 <= flushes <= 27, "13 s, and two a second: small parts make a large file"
    assert len(lost) > 10
    assert max(lost) < 5.0 + 0.7  # what waits for its flush comes to that
    assert len(disk.moments) < 4, "a disk of a small computer has other things to do"


async def test_a_connection_ends_although_its_disk_hangs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What flies is connected again: it waits for no log."""
    goes_on = threading.Event()

    def add_message(*_: object, **__: object) -> None:
        goes_on.wait(5.0)
        goes_on.set()  # the others pass

    monkeypatch.setattr(Writer, "add_message", add_message)
    monkeypatch.setattr(recorder, "END_TIMEOUT_S", PATIENCE)
    monkeypatch.setattr(recorder, "HANGS_S", 0.1)
    record = Recorder(tmp_path / "flight.mcap")
    async with connect(URL, record=record):
        await asyncio.sleep(2.0)
    assert record._thread.is_alive()
    goes_on.set()
    record._thread.join(PATIENCE)
    assert not record._thread.is_alive()


async def test_each_tenth_of_a_second_what_was_noted_goes_to_the_thread(tmp_path: Path) -> None:
    """A process that is killed loses a batch, and not the flight: the timer goes on."""
    log, clock = Recorder(tmp_path / "flight.mcap"), asyncio.get_running_loop().time
    for _ in range(3):
        log.tap(Direction.RECEIVED, b"bytes", clock())
        await asyncio.sleep(0.09)
        assert len(log._batch.chunks) == 1
        await asyncio.sleep(0.02)
        assert log._batch.chunks == []
        await asyncio.sleep(0.09)
    await log.aclose()
    assert b"".join(one.data for one in read(log.path).chunks()) == b"bytes" * 3


# -- values: how long, how much, and what is counted -----------------------------------------------


@pytest.mark.parametrize(("takes", "seconds"), [(False, 3.0), (True, 15.0)])
def test_the_end_of_a_log_waits_for_a_disk_that_takes_something(
    takes: bool, seconds: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    now = 100.0
    monkeypatch.setattr(time, "monotonic", lambda: now)

    def join(timeout: float) -> None:
        nonlocal now
        now += timeout
        if takes:
            record._alive_at = now

    record: Any = object.__new__(Recorder)
    record._alive_at = now
    record._thread = SimpleNamespace(is_alive=lambda: True, join=join)
    record._wait_for_end()
    assert now - 100.0 == pytest.approx(seconds, abs=0.11)


@pytest.mark.parametrize("rate_hz", [-0.1, float("inf"), float("nan")])
def test_what_is_no_rate_of_telemetry(tmp_path: Path, rate_hz: float) -> None:
    with pytest.raises(UsageError, match="is not a rate"):
        Recorder(tmp_path / "x.mcap", rate_hz=rate_hz)
    assert files_in(tmp_path) == []


async def test_bytes_that_the_disk_did_not_take_stand_beside_the_counters(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    record = Recorder(tmp_path / "flight.mcap")
    told: list[Entry] = [(LINK, {"firmware": "3.1"}), (EVENT, {"event": "note", "value": math.inf})]
    record._look = lambda: told
    now = asyncio.get_running_loop().time()
    with monkeypatch.context() as stands_still:
        stands_still.setattr(recorder, "MAX_WAITING", 0)
        record.tap(Direction.RECEIVED, b"seven b", now)
        record._hand_over()
    record.tap(Direction.RECEIVED, b"bytes", now)
    await record.aclose()
    log = read(record.path)
    assert [one.content() for one in log.messages(LINK)] == [
        {"firmware": "3.1", "log_dropped_bytes": 7}
    ]
    # JSON has no infinity, and an event counts nothing.
    assert [one.content() for one in log.messages(EVENT)] == [{"event": "note", "value": None}]
    assert b"".join(one.data for one in log.chunks()) == b"bytes"


async def test_a_log_that_nobody_closed_is_written_as_the_interpreter_ends(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ends: list[Any] = []
    monkeypatch.setattr(atexit, "register", ends.append)
    monkeypatch.setattr(atexit, "unregister", ends.remove)
    closed, left = Recorder(tmp_path / "closed.mcap"), Recorder(tmp_path / "left.mcap")
    await closed.aclose()
    assert ends == [left._end]
    left.tap(Direction.SENT, VERSION, asyncio.get_running_loop().time())
    left._end()
    assert left._timer is not None
    left._timer.cancel()
    assert [one.data for one in read(left.path).chunks()] == [VERSION]
    assert recorder.is_being_written(tmp_path / "no such file"), "nobody touches such a file"
    assert not recorder.is_being_written(left.path)
