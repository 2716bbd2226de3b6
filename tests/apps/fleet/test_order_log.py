"""What outlives an agent that was killed."""

from __future__ import annotations

import asyncio
import errno
import json
import math
import os
import stat
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from typing import Any
from zlib import crc32

import pytest
from cryptography import x509

from m100link.apps.agent.messages import MessageError
from m100link.apps.fleet.order_log import (
    FENCES_AT_ONCE,
    KEPT_S,
    AuditLog,
    FileOrderLog,
    LastFlightRecord,
    Mark,
    MemoryOrderLog,
    OrderCache,
    audit_facts,
    is_time,
    seal,
    since_boot,
    words,
)
from m100link.apps.fleet.payloads import OrderReply, Outcome, Progress
from m100link.apps.fleet.pki import Kind, init, issue
from m100link.apps.fleet.revocations import Revocations
from m100link.apps.fleet.signing import Seal, audited, merge_audit
from m100link.errors import UsageError
from tests.disk import Disk

pytestmark = pytest.mark.anyio


@pytest.fixture
def anyio_backend() -> str:
    return "asyncio"


def opened(path: Path, utc: float, boot: str, up: float) -> FileOrderLog:
    return FileOrderLog(path, lambda: utc, lambda: (boot, up))


async def test_what_was_begun_is_known_by_the_next_run(tmp_path: Path) -> None:
    path = tmp_path / "site" / "a1.jsonl"
    for identity, up in (("one", 50.0), ("two", 51.0)):
        log = opened(path, 1000.0, "boot", up)
        await log.begin(identity)
        log.close()  # as the kernel does when it is killed; each word was on the disk
    # Whatever the calendar says, set forth or back:
    for utc in (1002.0, 1002.0 + 3600.0, 1002.0 - 3600.0):
        log = opened(path, utc, "boot", 52.0)
        assert log.begun == {"one": 50.0, "two": 51.0}
        log.close()
    log = opened(path, 1000.0, "boot", 50.5 + KEPT_S)
    assert log.begun == {"two": 51.0}
    log.close()


async def test_what_is_from_before_the_computer_was_started_is_kept_as_long_again(
    tmp_path: Path,
) -> None:
    """Nobody knows how old it is: a clock without a battery begins anywhere."""
    path = tmp_path / "a1.jsonl"
    first = opened(path, 1000.0, "boot", 5000.0)
    await first.begin("one")
    first.close()
    for utc, up, is_kept in (
        (0.0, 5.0, True),
        (1e9, 4.0 + KEPT_S, True),
        (0.0, 6.0 + KEPT_S, False),
    ):
        after = opened(path, utc, "another", up)
        assert ("one" in after.begun) is is_kept, up
        after.close()


async def test_the_file_does_not_grow_without_end(tmp_path: Path, monkeypatch: Any) -> None:
    monkeypatch.setattr("m100link.apps.fleet.order_log.MOST_KEPT", 100)
    path, up = tmp_path / "a1.jsonl", [0.0]
    log = FileOrderLog(path, lambda: 0.0, lambda: ("boot", up[0]))
    sizes = set()
    await log.flies(17)
    for number in range(1000):
        up[0] += 1.0
        await log.begin(f"{number:032x}")
        sizes.add(len(path.read_text().splitlines()))
    assert max(sizes) <= 310
    await log.granted(log.leases_before + 2 * FENCES_AT_ONCE)
    log.close()
    after = opened(path, 0.0, "boot", up[0])
    assert list(after.begun)[-1] == f"{999:032x}"
    assert len(after.begun) == 100
    assert after.last_flight == LastFlightRecord(17, up[0])
    assert after.leases_before >= 2 * FENCES_AT_ONCE
    after.close()


async def test_few_words_are_written_and_none_by_one_that_is_closed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The file is written anew with the fence and three orders, once six lines follow its first."""
    monkeypatch.setattr("m100link.apps.fleet.order_log.MOST_KEPT", 3)
    path, lines = tmp_path / "a1.jsonl", list[int]()
    log = FileOrderLog(path, lambda: 0.0)
    for number in range(10):
        await log.begin(str(number))
        lines.append(path.read_text().count("\n"))
    for number in (FENCES_AT_ONCE, FENCES_AT_ONCE + 1):  # the first one reserves the second
        await log.granted(log.leases_before + number)
        lines.append(path.read_text().count("\n"))
    assert lines == [2, 3, 4, 5, 6, 7, 8, 5, 6, 7, 8, 8]
    log.close()
    with pytest.raises(UsageError, match="Bad file descriptor"):
        await log.begin("later")


def test_two_agents_have_two_ledgers(tmp_path: Path) -> None:
    path = tmp_path / "a1.jsonl"
    first = FileOrderLog(path, lambda: 0.0)
    with pytest.raises(UsageError, match="another agent has it"):
        FileOrderLog(path, lambda: 0.0)
    FileOrderLog(tmp_path / "a2.jsonl", lambda: 0.0).close()
    first.close()
    FileOrderLog(path, lambda: 0.0).close()


async def test_a_line_that_was_cut_off_is_no_order_and_harms_none(tmp_path: Path) -> None:
    path = tmp_path / "a1.jsonl"
    log = FileOrderLog(path, lambda: 0.0)
    await log.begin("one")
    log.close()
    for damage in (b'{"id": "tw', b"\xff\xfe\n", b"[]\n", b'{"id": 7}\n', b'{"fence": "9"}\n'):
        path.write_bytes(path.read_bytes() + damage)
        again = FileOrderLog(path, lambda: 1.0)
        assert "one" in again.begun
        assert again.damaged == damage.endswith(b"\n"), "what has no end was never kept"
        again.close()
    again = FileOrderLog(path, lambda: 1.0)
    assert again.damaged == 0, "it was reported once"
    again.close()


async def test_a_fence_is_never_granted_again(tmp_path: Path) -> None:
    path = tmp_path / "a1.jsonl"
    greatest = 0
    for _ in range(3):
        log = FileOrderLog(path, lambda: 0.0)
        assert log.leases_before >= greatest
        for number in range(1, 2 * FENCES_AT_ONCE + 10):
            greatest = log.leases_before + number
            await log.granted(greatest)
        log.close()


async def test_a_folder_that_cannot_be_written_is_reported(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(UsageError, match="file") as caught:
        FileOrderLog(tmp_path / "file" / "a1.jsonl", lambda: 0.0)
    assert "--order-log" in caught.value.remedy


async def test_one_in_memory_does_the_same_for_a_virtual_aircraft() -> None:
    first = MemoryOrderLog()
    await first.begin("one")
    await first.granted(17)
    second = MemoryOrderLog(first)
    assert second.begun == {"one": 0.0}
    assert second.leases_before >= 17


async def test_the_last_flight_is_known_with_its_age_whatever_the_calendar_does(
    tmp_path: Path,
) -> None:
    path = tmp_path / "a1.jsonl"

    first = opened(path, 1000.0, "one", 50.0)
    assert first.last_flight is None
    await first.flies(17)
    first.close()
    for utc, boot, up, ago in (
        (1009.0, "one", 60.0, 10.0),
        (9999.0, "one", 60.0, 10.0),  # the clock was set
        (1.0, "one", 60.0, 10.0),
        (1030.0, "two", 5.0, 30.0),  # the computer began anew
        (900.0, "two", 5.0, None),  # and has lost its calendar
        (1030.0, "", 60.0, 30.0),  # it does not say which run this is
    ):
        again = opened(path, utc, boot, up)
        assert again.last_flight == LastFlightRecord(17, ago), (utc, boot, up)
        again.close()
    last = opened(path, 1000.0, "one", 70.0)
    await last.flies(0)
    last.close()
    again = opened(path, 1000.0, "one", 70.0)
    assert again.last_flight is None
    again.close()


def sealed(*lines: str) -> str:
    """The file of these lines; one with a NUL in it is as a bad disk left it."""
    bodies = [f"{number} 1 {line}" for number, line in enumerate(lines, 1)]
    sums = [crc32(body.replace("\x00", "").encode()) for body in bodies]
    return "".join(f"{one:08x} {body}\n" for one, body in zip(sums, bodies, strict=True))


@pytest.mark.parametrize("line", ['{"flies": "17"}', '{"flies": -1}', '{"flies": true}', "{}"])
def test_a_line_of_nonsense_lands_nobody(tmp_path: Path, line: str) -> None:
    path = tmp_path / "a1.jsonl"
    path.write_text(sealed(line))
    log = FileOrderLog(path, lambda: 0.0)
    assert log.last_flight is None
    log.close()
    path.with_suffix(".lock").unlink()
    path.write_text(sealed('{"flies": 17, "at": "x", "up": "y", "boot": 3}'))
    log = FileOrderLog(path, lambda: 0.0)
    assert log.last_flight == LastFlightRecord(17, None)
    log.close()


def test_a_run_of_this_computer_has_a_name_and_an_age() -> None:
    (boot, before), (same, after) = since_boot(), since_boot()
    assert boot == same
    assert 0.0 < before <= after


@pytest.mark.parametrize("damage", ["[" * 100_000, '{"fence": 1' + "0" * 30 + "}", "\x00" * 4096])
async def test_what_a_bad_disk_made_of_a_line_costs_that_line(tmp_path: Path, damage: str) -> None:
    """The deepest of brackets raised, and no message carries the number of such a lease."""
    path = tmp_path / "a1.jsonl"
    first = opened(path, 1000.0, "boot", 50.0)
    await first.begin("one")
    first.close()
    with path.open("a") as stream:
        stream.write(f"{damage}\n")
    after = opened(path, 1000.0, "boot", 51.0)
    assert after.begun == {"one": 50.0}
    assert after.leases_before == FENCES_AT_ONCE
    assert after.damaged == 1
    after.close()


async def test_where_words_are_lost_leases_begin_above_all_that_may_have_been(
    tmp_path: Path,
) -> None:
    path, utc = tmp_path / "a1.jsonl", 1_800_000_000.0
    path.write_text(sealed('{"fence": 3000}', '{"fence": 40\x00\x00}'))
    log = opened(path, utc, "boot", 50.0)
    assert log.leases_before == 1_800_000_000
    log.close()
    again = opened(path, utc - 1e9, "boot", 51.0)  # the calendar was set back
    assert again.leases_before >= 1_800_000_000 + FENCES_AT_ONCE
    again.close()


@pytest.mark.parametrize(
    ("words", "ago_s"), [(("flies", "\x00"), None), (("\x00", "flies"), 1.0), (("flies",), 1.0)]
)
async def test_the_last_flight_is_not_believed_where_a_later_record_is_lost(
    tmp_path: Path, words: tuple[str, ...], ago_s: float | None
) -> None:
    """It may say that nobody flew any more, and somebody with a remote control does."""
    flies = '{"flies": 17, "at": 1000.0, "boot": "boot", "up": 50.0}'
    path = tmp_path / "a1.jsonl"
    path.write_text(sealed(*(flies if word == "flies" else word for word in words)))
    path.with_suffix(".lock").write_bytes(bytes(Mark(len(words), 1)))
    log = opened(path, 1001.0, "boot", 51.0)
    assert log.last_flight == LastFlightRecord(17, ago_s)
    log.close()


async def full(path: Path) -> FileOrderLog:
    """One that knows an order, and who flies."""
    log = opened(path, 1000.0, "boot", 50.0)
    await log.begin("one")
    await log.flies(17)
    return log


@pytest.mark.parametrize("how", ["removed", "replaced", "emptied", "folder"])
async def test_an_order_log_that_vanishes_while_the_agent_runs_is_made_again_and_reported(
    tmp_path: Path, how: str
) -> None:
    path = tmp_path / "site" / "a1.jsonl"
    log, told = await full(path), list[str]()
    log.tell = told.append
    if how == "replaced":
        path.rename(path.with_suffix(".old"))
        path.write_text("")
    elif how == "emptied":
        os.truncate(path, 0)
    else:
        path.unlink()
    if how == "folder":
        path.with_suffix(".lock").unlink()
        path.parent.rmdir()
    await log.begin("two")
    await log.begin("three")
    assert len(told) == 1
    assert "was removed or changed" in told[0]
    with pytest.raises(UsageError, match="another agent has it"):
        opened(path, 1000.0, "boot", 51.0)
    log.close()
    again = opened(path, 1000.0, "boot", 51.0)
    assert list(again.begun) == ["one", "two", "three"]
    assert again.last_flight == LastFlightRecord(17, 1.0)
    assert again.damaged == 0
    again.close()


@pytest.mark.parametrize("how", ["removed", "emptied", "last line", "mark"])
async def test_a_ledger_that_went_while_no_agent_ran_is_noticed(tmp_path: Path, how: str) -> None:
    path, utc = tmp_path / "a1.jsonl", 1_800_000_000.0
    (await full(path)).close()
    if how == "removed":
        path.unlink()
    elif how == "emptied":
        path.write_text("")
    elif how == "last line":
        path.write_text("".join(path.read_text().splitlines(keepends=True)[:-1]))
    else:
        path.with_suffix(".lock").write_text("")
    again = opened(path, utc, "boot", 51.0)
    assert again.damaged >= 1
    assert again.leases_before == utc, "above all that may have been granted"
    assert again.last_flight in (None, LastFlightRecord(17, None)), "the aircraft is not landed"
    again.close()
    after = opened(path, utc, "boot", 52.0)
    assert after.damaged == 0, "it was reported once"
    after.close()


async def test_what_a_full_disk_refused_is_never_reported_as_begun(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It stood in a buffer, and was written with the next word when there was room again."""
    path = tmp_path / "a1.jsonl"
    log = await full(path)
    write = os.pwrite

    def part(handle: int, data: bytes, at: int) -> int:
        if len(data) > 20 and not data.endswith(b"00\n"):
            return write(handle, data[:20], at)
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "pwrite", part)
    for _ in range(3):
        with pytest.raises(UsageError, match="No space left"):
            await log.begin("refused")
    for fence in (5000, 5000):
        with pytest.raises(UsageError, match="No space left"):
            await log.granted(fence)
    with pytest.raises(UsageError, match="No space left"):
        await log.flies(0)
    monkeypatch.setattr(os, "pwrite", write)
    await log.granted(5000)
    await log.begin("two")
    log.close()
    again = opened(path, 1000.0, "boot", 51.0)
    assert list(again.begun) == ["one", "two"]
    assert again.leases_before >= 5000
    assert again.last_flight is None, "that nobody flies was written as soon as there was room"
    assert again.damaged == 0
    again.close()


async def test_no_file_is_left_behind_by_a_disk_without_room(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    log = await full(tmp_path / "a1.jsonl")
    (tmp_path / "a1.jsonl").unlink()

    def fail(_: int) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "fsync", fail)
    with pytest.raises(UsageError, match="No space left"):
        await log.begin("two")
    monkeypatch.undo()
    with os.scandir(tmp_path) as entries:
        assert [one.name for one in entries] == ["a1.lock"]
    await log.begin("three")
    log.close()


@pytest.mark.parametrize("error", [RuntimeError("can't start new thread"), MemoryError()])
async def test_a_computer_without_threads_or_memory_is_reported_as_a_disk_without_room(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, error: Exception
) -> None:
    """The agent on board would end by it, in the air: it keeps who flies in a loop."""
    log = await full(tmp_path / "a1.jsonl")

    async def fail(*_: object) -> None:
        raise error

    monkeypatch.setattr(asyncio, "to_thread", fail)
    for keep in (log.begin("two"), log.flies(17), log.granted(10**6)):
        with pytest.raises(UsageError, match=r"can't start new thread|MemoryError"):
            await keep
    monkeypatch.undo()
    await log.begin("three")
    log.close()


@pytest.fixture
def disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Disk:
    return Disk(monkeypatch, tmp_path)


async def test_a_word_is_on_the_disk_before_anything_is_done(tmp_path: Path, disk: Disk) -> None:
    """Not only with the kernel: the computer on board loses its power in a crash."""
    path = tmp_path / "a1.jsonl"
    log = opened(path, 1000.0, "boot", 50.0)
    await log.begin("an order")
    assert b"an order" in disk.files["a1.jsonl"]
    before = disk.files["a1.jsonl"]
    await log.granted(log.leases_before + FENCES_AT_ONCE + 1)
    assert disk.files["a1.jsonl"] != before, "numbers of leases are reserved on the disk as well"
    log.close()
    again = opened(path, 1000.0, "boot", 51.0)
    assert again.begun == {"an order": 50.0}
    again.close()


async def test_no_loss_of_power_leaves_a_ledger_that_cannot_tell_whether_words_are_gone(
    tmp_path: Path, disk: Disk
) -> None:
    """The mark of the newest word stands in the file of the lock, and is there before the words.

    What is left at each moment is read by the next agent: it has no damage, and every order that
    had been begun by then.
    """
    board = tmp_path / "a1.jsonl"
    log = opened(board, 1000.0, "boot", 50.0)
    assert set(disk.files) == {"a1.jsonl", "a1.lock"}
    assert all(one == (tmp_path / name).read_bytes() for name, one in disk.files.items())
    await log.begin("one")
    board.unlink()  # it is made again, with what is still needed
    await log.begin("two")
    log.close()
    written = [one for one in disk.moments if one.get("a1.jsonl")]
    assert all(one["a1.lock"] for one in written)
    for number, left in enumerate(written):
        after = tmp_path / f"after-{number}"
        after.mkdir()
        for name, data in left.items():
            (after / name).write_bytes(data)
        again = opened(after / "a1.jsonl", 1000.0, "boot", 51.0)
        assert again.damaged == 0
        assert {"one", "two"} & again.begun.keys() == {
            one for one in ("one", "two") if one.encode() in left["a1.jsonl"]
        }
        again.close()


def test_a_start_after_damage_is_no_surer_who_flew_than_the_start_before(tmp_path: Path) -> None:
    path = tmp_path / "a1.jsonl"
    # Sealed, by hand: {"flies": 7, …} is number 1, and the mark says that a number 2 is lost.
    word = '1 1 {"flies": 7, "at": 1000.0, "boot": "boot", "up": 6.0}'
    path.write_text(f"{crc32(word.encode()):08x} {word}\n")
    mark = f"{2:018d} {1:018d}"
    path.with_suffix(".lock").write_text(f"{crc32(mark.encode()):08x} {mark}\n")
    for _ in range(3):
        log = opened(path, 1004.0, "boot", 10.0)
        assert log.last_flight == LastFlightRecord(7, None)
        log.close()


def test_a_number_that_no_float_holds_is_damage(tmp_path: Path) -> None:
    path = tmp_path / "a1.jsonl"
    path.write_text(sealed('{"flies": 7, "at": 1' + "0" * 400 + "}"))
    log = opened(path, 1004.0, "boot", 10.0)
    assert log.damaged == 1


async def test_nobody_else_reads_a_ledger_or_holds_its_lock(tmp_path: Path) -> None:
    log = opened(tmp_path / "site" / "a1.jsonl", 1000.0, "boot", 50.0)
    await log.begin("an order")
    files = list((tmp_path / "site").iterdir())
    assert files
    assert {path.stat().st_mode & 0o777 for path in files} == {0o600}
    assert (tmp_path / "site").stat().st_mode & 0o777 == 0o700
    log.close()


# -- what was heard is known, for a while ----------------------------------------------------------


def reply(identity: str) -> OrderReply:
    return OrderReply(identity, "a1", "boot", Progress.DONE, Outcome.OK, order=identity.encode())


def test_an_order_runs_then_has_an_outcome() -> None:
    cache = OrderCache()
    assert not cache.is_known("a")
    cache.begin("a", b"a", 0.0)
    assert cache.is_known("a")
    assert cache.reply("a") is None
    cache.end(reply("a"), 0.0)
    assert cache.reply("a") == reply("a")


def test_what_is_old_is_forgotten_but_not_what_runs() -> None:
    cache, now = OrderCache(), 1e5
    cache.begin("a", b"a", now)
    cache.end(reply("a"), now)
    cache.begin("b", b"b", now + KEPT_S - 1)
    assert cache.is_known("a")
    cache.begin("c", b"c", now + KEPT_S)
    assert not cache.is_known("a")
    assert cache.is_known("b")
    cache.begin("d", b"d", now + 3 * KEPT_S)
    assert cache.is_known("b"), "it runs"


def test_an_id_is_that_of_one_order() -> None:
    cache = OrderCache()
    assert not cache.heard("a", b"a")
    cache.begin("a", b"a", 0.0)
    for _ in range(2):
        assert cache.heard("a", b"a")
        with pytest.raises(MessageError, match="another order came under the id a"):
            cache.heard("a", b"b")
        cache.end(reply("a"), 0.0)


def test_what_an_agent_before_began_is_known_as_that() -> None:
    cache = OrderCache(["a"])
    assert cache.was_begun_before("a")
    assert not cache.is_known("a")
    assert not cache.was_begun_before("b")


def test_what_was_made_before_words_were_lost_may_have_been_begun() -> None:
    cache = OrderCache(["a"], unsure_before=10.0)
    assert cache.is_unsure(9.9)
    assert not cache.is_unsure(10.0)
    assert not OrderCache(["a"]).is_unsure(-1e9)


def test_it_does_not_grow_without_end() -> None:
    cache = OrderCache()
    for number in range(50_000):
        cache.begin(str(number), b"", number * 1e-3)
        cache.end(reply(str(number)), number * 1e-3)
    assert sum(cache.is_known(str(number)) for number in range(50_000)) <= 20_001


def test_one_that_runs_for_long_keeps_no_other_one() -> None:
    """A mission of half an hour, begun first: what ended since is forgotten all the same."""
    cache = OrderCache()
    cache.begin("mission", b"", 0.0)
    for number in range(50_000):
        cache.begin(str(number), b"", number * 1e-3)
        cache.end(reply(str(number)), number * 1e-3)
    cache.begin("last", b"", 2000.0)
    assert not any(cache.is_known(str(number)) for number in range(50_000))
    assert cache.is_known("mission")
    assert cache.reply("mission") is None
    cache.end(reply("mission"), 2000.0)
    cache.begin("another", b"", 2000.0 + KEPT_S - 1)
    assert cache.reply("mission") == reply("mission"), "its client may still ask"


# -- A word that was changed or is gone is noticed, whatever became of it --------------------------


LINES = [seal(number, 7, {"id": f"{number}"}) for number in (7, 8, 9)]
MARK = bytes(Mark(9, 7))


def test_what_was_written_is_read() -> None:
    read = words("".join(LINES).encode(), MARK)
    assert read.kept == {number: {"id": f"{number}"} for number in (7, 8, 9)}
    assert (read.damaged, read.sure_from, read.newest) == (0, 0, 9)


@pytest.mark.parametrize("bit", range(8))
def test_no_bit_of_file_or_mark_turns_over_unnoticed(bit: int) -> None:
    whole = "".join(LINES).encode()
    for at in range(len(whole)):
        data = whole[:at] + bytes((whole[at] ^ 1 << bit,)) + whole[at + 1 :]
        read = words(data, MARK)
        assert read.damaged, (at, bit)
        assert all(read.kept[number] == {"id": f"{number}"} for number in read.kept)
    for at in range(len(MARK)):
        mark = MARK[:at] + bytes((MARK[at] ^ 1 << bit,)) + MARK[at + 1 :]
        assert words(whole, mark).damaged == 1


@pytest.mark.parametrize(
    ("kept", "mark", "damaged", "sure_from"),
    [
        ([], MARK, 3, 10),
        ([8, 9], MARK, 1, 8),
        ([7, 9], MARK, 1, 9),
        ([7, 8], MARK, 1, 10),
        ([9, 7, 8], MARK, 0, 0),  # sectors that changed places say the same
        ([7, 8, 9], bytes(Mark(8, 7)), 0, 0),  # the power went before the mark was on the disk
        ([7, 8, 9], bytes(Mark(6, 1)), 0, 0),  # or just after the file was written anew
        ([7, 8, 9], b"", 1, 10),
        ([], b"", 0, 0),
        ([], bytes(Mark(0, 0)), 0, 0),
    ],
)
def test_what_is_gone_is_counted(
    kept: list[int], mark: bytes, damaged: int, sure_from: int
) -> None:
    read = words("".join(LINES[number - 7] for number in kept).encode(), mark)
    assert (read.damaged, read.sure_from) == (damaged, sure_from)


def test_a_mark_is_as_long_whatever_it_says() -> None:
    assert {len(bytes(Mark(newest, 1))) for newest in (0, 9, 10**9, 10**17)} == {len(MARK)}
    assert Mark.read(MARK) == Mark(9, 7)


# -- the audit log: each line is signed by its aircraft, and names the one before ------------------


@pytest.fixture
def own(tmp_path: Path) -> tuple[Seal, x509.Certificate]:
    now = datetime(2026, 11, 29, tzinfo=UTC)
    init(tmp_path / "pki", now=now)
    issue(tmp_path / "pki", Kind.AGENT, "a1", now=now)
    return Seal.read(tmp_path / "pki", "a1"), Revocations.of_folder(tmp_path / "pki").authority


def written(seal: Seal, path: Path | None = None, orders: int = 5) -> AuditLog:
    log = AuditLog(path, seal.audit, lambda: 1_800_000_000.0)
    for number in range(orders):
        log.add({"by": "anna", "signer": "anna", "order": f"order {number}", "outcome": "ok"})
    return log


def test_a_log_that_nobody_touched_is_whole(own: tuple[Seal, x509.Certificate]) -> None:
    data = written(own[0]).since(1, 1 << 20)
    found, wrong = audited(data, "a1", own[1])
    assert wrong == []
    assert [facts["number"] for facts in found] == [1, 2, 3, 4, 5, 6]
    assert [facts.get("order") for facts in found] == [None, *(f"order {n}" for n in range(5))]
    assert found[1]["at"] == 1_800_000_000.0
    assert written(own[0]).since(3, 1).count(b"\n") == 1, "one line goes whatever its length"
    assert written(own[0]).since(7, 1 << 20) == b""


@pytest.mark.parametrize(
    ("at", "is_line"),
    [
        (1_799_999_990.5, True),
        (0.0, True),
        (-1.0, False),
        (1e10, False),
        (math.nan, False),
        (1_800_000_000, False),  # each time is a float, as JSON has it
        ("now", False),
    ],
)
def test_a_line_with_a_time_that_no_calendar_has_is_none(at: object, is_line: bool) -> None:
    """Readers make a date of it; the agent leaves out such a time of an order."""
    facts = {"number": 1, "at": 1.8e9, "order": "land", "ordered_at": at}
    line = json.dumps(facts).encode() + b"\tsignature"
    assert bool(audit_facts(line)) is is_line
    assert is_time(at) is is_line


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda lines: [*lines[:2], *lines[4:]], ["lines 3 to 4 are missing"]),
        (
            lambda lines: [*lines[:2], lines[2].replace(b"anna", b"eve!"), *lines[3:]],
            ["line 3 was altered: a1 has not signed it"],
        ),
        (
            lambda lines: [*lines[:2], b"no line\n", *lines[3:]],
            ["line 3 was altered: a1 has not signed it"],
        ),
        (lambda lines: lines[1:], ["line 2 was altered: a1 has not signed it"]),
        (lambda lines: [*lines, *lines[3:]], ["line 4 stands behind line 6, not in its place"]),
        (
            lambda lines: [*lines[:2], lines[3], lines[2], *lines[4:]],
            ["lines 3 to 3 are missing", "line 3 stands behind line 4, not in its place"],
        ),
    ],
)
def test_a_line_that_was_altered_or_removed_is_named(
    own: tuple[Seal, x509.Certificate],
    change: Callable[[list[bytes]], list[bytes]],
    said: list[str],
) -> None:
    lines = written(own[0]).since(1, 1 << 20).splitlines(keepends=True)
    _, wrong = audited(b"".join(change(lines)), "a1", own[1])
    assert wrong[: len(said)] == said


def test_a_line_of_another_log_of_the_same_aircraft_is_named(
    own: tuple[Seal, x509.Certificate],
) -> None:
    """Signed by the same key, in the place of the one with its number."""
    lines = written(own[0]).since(1, 1 << 20).splitlines(keepends=True)
    other = AuditLog(None, own[0].audit, lambda: 1_900_000_000.0)
    other.add({"order": "another"})
    lines[1] = other.since(2, 1 << 20)
    _, wrong = audited(b"".join(lines), "a1", own[1])
    assert wrong == ["line 1 stands in the place of another one"]


@pytest.mark.parametrize("count", [20, 21, 29, 30, 31, 57])
async def test_what_is_left_of_a_long_audit_log_can_be_verified(
    own: tuple[Seal, x509.Certificate], monkeypatch: pytest.MonkeyPatch, count: int
) -> None:
    monkeypatch.setattr("m100link.apps.fleet.order_log.MOST_KEPT", 20)
    log = AuditLog(None, own[0].audit, lambda: 1_900_000_000.0)
    for number in range(2, count + 1):
        log.add({"order": "stop", "signer": "anna", "by": "", "outcome": f"n{number}"})
    found, wrong = audited(log.since(1, 1 << 20), "a1", own[1])
    assert wrong == []
    lines = log.since(1, 1 << 20).splitlines(keepends=True)
    if (cut := next((at for at, one in enumerate(lines) if at and b"certificate" in one), 0)) > 0:
        _, wrong = audited(b"".join(lines[cut:]), "a1", own[1])
        first = found[0]["number"]
        said = f"lines {first} to {first + cut - 1} are missing: the beginning was cut off"
        assert wrong == [said]
    assert 10 <= len(found) <= 20
    assert [one["number"] for one in found] == list(range(count - len(found) + 1, count + 1))


@pytest.mark.parametrize(
    "odd",
    [{"before": None}, {"before": [1]}, {"at": "x"}, {"at": 1e300}, {"order": [1]}, {"number": -5}],
)
def test_a_line_that_an_aircraft_signs_and_no_agent_writes_is_named(
    own: tuple[Seal, x509.Certificate], odd: dict[str, object]
) -> None:
    """The key of one aircraft in wrong hands keeps nobody from reading the logs of the others."""
    log = written(own[0], orders=0)
    log.add({"order": "an order"} | odd)
    found, wrong = audited(log.since(1, 1 << 20), "a1", own[1])
    assert len(found) == 1
    assert wrong == ["line 2 was altered: a1 has not signed it"]


def test_another_aircraft_or_authority_signs_nothing(
    own: tuple[Seal, x509.Certificate], tmp_path: Path
) -> None:
    data = written(own[0], orders=1).since(1, 1 << 20)
    assert len(audited(data, "a2", own[1])[1]) == 2
    init(tmp_path / "other", now=datetime(2026, 11, 29, tzinfo=UTC))
    other = Revocations.of_folder(tmp_path / "other").authority
    assert len(audited(data, "a1", other)[1]) == 2


async def test_the_next_agent_goes_on_behind_a_line_that_was_cut_off(
    own: tuple[Seal, x509.Certificate], tmp_path: Path
) -> None:
    path = tmp_path / "a1.audit"
    log = written(own[0], path)
    await log.flush()
    assert path.read_bytes() == log.since(1, 1 << 20)
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    with path.open("ab") as file:
        file.write(b'{"number": 7, "by')
    after = written(own[0], path, orders=1)
    await after.flush()
    found, wrong = audited(path.read_bytes(), "a1", own[1])
    assert wrong == []
    assert [facts["number"] for facts in found] == list(range(1, 9))


async def test_a_disk_without_room_costs_no_line(
    own: tuple[Seal, x509.Certificate], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "none" / "a1.audit"
    told: list[str] = []
    log = written(own[0], path)
    log.tell = told.append
    await log.flush()
    assert len(told) == 1
    path.parent.mkdir()
    for lines in (7, 9):
        log.add({"order": "later"})
        await log.flush()
        assert path.read_bytes() == log.since(1, 1 << 20)
        assert log.since(1, 1 << 20).count(b"\n") == lines
        with monkeypatch.context() as patch:  # it takes a part
            patch.setattr(os, "write", lambda handle, data, do=os.write: do(handle, data[:20]))
            log.add({"order": "half"})
            await log.flush()
        assert told[-1].startswith(f"{path}: the disk is full: ")


async def test_a_copy_is_brought_up_to_date_and_tells_what_became_less(
    own: tuple[Seal, x509.Certificate], tmp_path: Path
) -> None:
    log, copy = written(own[0]), tmp_path / "copies" / "a1.audit"

    async def fetch(number: int) -> bytes:
        return log.since(number, 1 << 20)

    assert (await merge_audit(copy, "a1", fetch, own[1]))[1] == []
    log.add({"order": "later"})
    found, wrong = await merge_audit(copy, "a1", fetch, own[1])
    assert (len(found), wrong) == (7, [])
    log = written(own[0], orders=2)  # somebody emptied it
    found, wrong = await merge_audit(copy, "a1", fetch, own[1])
    assert len(found) == 7
    seen = f"line 7 of {copy} is not on board: altered, removed, or of a virtual run before"
    assert wrong == [seen]
    with pytest.raises(UsageError, match="copies cannot be read: Is a directory"):
        await merge_audit(copy.parent, "a1", fetch, own[1])
