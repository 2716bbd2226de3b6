"""What is said about logs: there and back, and nothing that cannot be is read."""

from __future__ import annotations

import contextlib
import fcntl
import hashlib
import os
import random
import resource
from collections.abc import Callable
from io import FileIO
from pathlib import Path

import pytest

from m100link.apps.agent.messages import MessageError, fault_of
from m100link.apps.fleet.logs.words import (
    MOST_PIECE,
    LogPart,
    LogReply,
    pack_entries,
    pack_reply,
    require_possible,
    unpack_entries,
    unpack_reply,
)
from m100link.apps.fleet.payloads import VERSION, LogQuestion, Outcome, What
from m100link.errors import UsageError
from m100link.log.folder import LogEntry
from tests.disk import Disk

NAME = "m100link-20260101-000000.mcap"


def test_what_is_said_comes_out_as_it_went_in() -> None:
    for question in (
        LogQuestion(What.LIST),
        LogQuestion(What.PIECE, NAME, 5, MOST_PIECE),
        LogQuestion(What.DIGEST, "m100link-20260101-000000-12.mcap", 0, 1 << 40),
    ):
        require_possible(question)
    fault = fault_of(UsageError("no", remedy="none"))
    reply = LogReply("i" * 32, "a1", Outcome.REFUSED, fault, 0.5, 3, 7, True)
    assert unpack_reply(pack_reply(reply, b"\n\0{}")) == (reply, b"\n\0{}")
    entries = [LogEntry(NAME, 3, 1.5, True)]
    assert unpack_entries(pack_entries(entries)) == entries


@pytest.mark.parametrize(
    "name",
    [
        "",
        "..",
        "../a2/" + NAME,
        "/etc/passwd",
        f"{NAME}/..",
        f"./{NAME}",
        NAME + "\n",
        NAME + "\0",
        "ledger.jsonl",
    ],
)
def test_a_name_that_no_recorder_gives_is_no_log(name: str) -> None:
    for what in (What.PIECE, What.DIGEST):
        with pytest.raises(MessageError, match="no name of a log"):
            require_possible(LogQuestion(what, name))
    assert unpack_entries(pack_entries([LogEntry(name, 3, 0.0, False)])) == []


@pytest.mark.parametrize("at", [-1.0, 1e12, 1e300])
def test_a_log_of_no_time_is_not_listed(at: float) -> None:
    """A shown list has dates."""
    assert unpack_entries(pack_entries([LogEntry(NAME, 3, at, False)])) == []


@pytest.mark.parametrize(("offset", "length"), [(-1, 5), (0, -1), (0, MOST_PIECE + 1)])
def test_no_more_than_a_piece_can_be_asked_for(offset: int, length: int) -> None:
    with pytest.raises(MessageError, match="no part of a log"):
        require_possible(LogQuestion(What.PIECE, NAME, offset, length))


def test_another_version_is_said_and_too_much_is_not_read() -> None:
    good = pack_reply(LogReply("", "a1"))
    assert good[0] == VERSION
    assert unpack_reply(good + bytes(MOST_PIECE))[1] == bytes(MOST_PIECE)
    with pytest.raises(MessageError, match="not a list of logs"):
        unpack_entries(b"{}")
    with pytest.raises(MessageError, match="version 9"):
        unpack_reply(b"\x09" + good[1:])
    with pytest.raises(MessageError):
        unpack_reply(good + bytes(MOST_PIECE + 1))


def test_junk_is_refused_and_raises_nothing_else() -> None:
    chance = random.Random(4)
    good = [pack_reply(LogReply("", "a1")), pack_entries([LogEntry(NAME, 3, 1.0, True)])]
    for number in range(6000):
        data = bytearray(good[number % 2])
        for _ in range(chance.randrange(1, 6)):
            data[chance.randrange(len(data))] = chance.randrange(256)
        for read in (unpack_reply, unpack_entries):
            with contextlib.suppress(MessageError):
                read(bytes(data))


# -- A log on its way: what is there is a beginning of it, whatever ended the one before -----------


def opened(folder: Path, size: int = 100) -> LogPart:
    part = LogPart(folder, "a1-x.mcap")
    part.open(size)
    return part


def test_it_goes_on_where_it_ended_and_becomes_the_log(tmp_path: Path) -> None:
    first = opened(tmp_path / "new")
    first.add(b"abc")
    first.close()
    second = opened(tmp_path / "new")
    assert second.at == 3
    second.add(b"def")
    assert second.digest() == hashlib.sha256(b"abcdef").digest()
    second.finish()
    second.close()
    assert [path.name for path in (tmp_path / "new").iterdir()] == ["a1-x.mcap"]
    assert second.whole_digest() == (6, hashlib.sha256(b"abcdef").digest())


def test_two_programs_do_not_write_one_part(tmp_path: Path) -> None:
    first = opened(tmp_path)
    with pytest.raises(UsageError, match="another program fetches it"):
        opened(tmp_path)
    first.add(b"a")
    first.close()
    opened(tmp_path).close()


@pytest.mark.parametrize("ends", [LogPart.finish, LogPart.close])
def test_the_next_one_does_not_get_the_outcome_of_an_earlier_part(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, ends: Callable[[LogPart], None]
) -> None:
    """It was opened while the other program had it, and locked when that had it no more."""
    first = opened(tmp_path)
    if ends is LogPart.finish:
        first.add(b"abc")
    lock = fcntl.flock

    def late(file: FileIO, how: int) -> None:
        monkeypatch.setattr(fcntl, "flock", lock)
        ends(first)
        lock(file, how)

    monkeypatch.setattr(fcntl, "flock", late)
    second = opened(tmp_path, size=2)
    assert second.at == 0
    second.add(b"de")
    assert second.path.read_bytes() == b"de"
    if ends is LogPart.finish:
        assert second.whole.read_bytes() == b"abc", "and a fetched log is whole"
    second.close()


def test_where_no_byte_came_nothing_is_left(tmp_path: Path) -> None:
    opened(tmp_path).close()
    assert list(tmp_path.iterdir()) == []


def test_what_is_longer_than_the_log_is_of_another_one(tmp_path: Path) -> None:
    first = opened(tmp_path)
    first.add(b"abc")
    first.close()
    second = opened(tmp_path, size=2)
    assert second.at == 0
    second.close()


def test_the_file_of_before_stays_until_the_new_one_is_whole(tmp_path: Path) -> None:
    (tmp_path / "a1-x.mcap").write_bytes(b"abc")
    part = opened(tmp_path)
    part.take_up()
    part.add(b"d")
    assert (tmp_path / "a1-x.mcap").read_bytes() == b"abc"
    part.finish()
    part.close()
    assert (tmp_path / "a1-x.mcap").read_bytes() == b"abcd"


def test_a_log_that_is_there_is_on_the_disk(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A client that has fetched it may remove it on board."""
    disk = Disk(monkeypatch, tmp_path)
    part = opened(tmp_path)
    part.add(b"abc")
    part.add(b"def")
    part.finish()
    part.close()
    assert disk.content(tmp_path / "a1-x.mcap") == b"abcdef"
    assert disk.files["a1-x.mcap"] == b"abcdef", "and under its name"


def test_a_disk_that_takes_no_more_is_reported_and_what_came_stays(tmp_path: Path) -> None:
    import signal

    part = opened(tmp_path, size=1 << 20)
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    handler = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1000, before[1]))
    try:
        with pytest.raises(UsageError, match="File too large"):
            part.add(bytes(4000))
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
        signal.signal(signal.SIGXFSZ, handler)
    part.close()
    assert (tmp_path / "a1-x.mcap.part").stat().st_size == part.at == 1000


def test_a_folder_that_cannot_be_is_reported(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(UsageError, match="--output"):
        LogPart(tmp_path / "file" / "below", "x")
    part = LogPart(tmp_path, "y" * 300)
    with pytest.raises(UsageError):
        part.open(3)


def test_what_was_closed_meanwhile_is_not_written(tmp_path: Path) -> None:
    part = opened(tmp_path)
    part.close()
    with pytest.raises(UsageError, match="it is closed"):
        part.add(b"late")


def test_a_log_has_its_name_when_it_is_on_the_disk_and_not_before(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of a computer without power nobody may find half of one under its name."""
    synced: list[tuple[bytes, list[str]]] = []
    part = opened(tmp_path)
    part.add(b"abcdef")

    def fsync(handle: int) -> None:
        names = sorted(path.name for path in tmp_path.iterdir())
        if os.path.samestat(os.fstat(handle), tmp_path.stat()):
            synced.append((b"the folder", names))
        else:
            assert os.path.samestat(os.fstat(handle), part.path.stat())
            synced.append((part.path.read_bytes(), names))

    monkeypatch.setattr(os, "fsync", fsync)
    part.finish()
    part.close()
    assert synced == [(b"abcdef", [part.path.name]), (b"the folder", [part.whole.name])]
    assert part.whole.read_bytes() == b"abcdef"
