"""What was recorded before a restart is not obeyed after it."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from m100link.apps.mavlink.translator.codec import (
    AHEAD,
    LAST_SIGNATURE,
    NEW_WITHIN,
    Message,
    SignatureMemory,
    Signer,
    read_datagram,
    write_frame,
)

KEY = bytes(range(32))
SECOND = 100_000
NOW = 10**12


def ping(at: int, system: int = 245) -> bytes:
    message = Message("PING", {}, component=190)
    return write_frame(message, system=system, sequence=0, signer=Signer(KEY), now=at)


def is_taken(signer: Signer, frame: bytes, now: int) -> bool:
    return bool(list(read_datagram(frame, signer=signer, now=now)))


def started(folder: Path, now: int = NOW) -> tuple[Signer, SignatureMemory]:
    signer = Signer(KEY)
    memory = SignatureMemory(folder, signer)
    assert memory.recall(now) == ""
    return signer, memory


def work(memory: SignatureMemory) -> None:
    """One turn of what runs beside the bridge."""
    snapshot = memory.due()
    if snapshot is not None:
        memory.write(snapshot)


def test_what_was_recorded_is_not_taken_after_the_process_was_killed(tmp_path: Path) -> None:
    signer, memory = started(tmp_path)
    recorded = [ping(NOW + step * SECOND) for step in range(10)]
    for step, frame in enumerate(recorded):
        assert is_taken(signer, frame, NOW + step * SECOND)
        if step in (0, 8):  # the last of them is newer than what is written
            work(memory)
    signer, memory = started(tmp_path)
    now = NOW + 10 * SECOND
    assert not any(is_taken(signer, frame, now) for frame in recorded)
    ahead = NOW + 8 * SECOND + AHEAD
    assert is_taken(signer, ping(ahead + 1), now)


def test_without_a_memory_a_minute_passes_in_which_it_is_taken(tmp_path: Path) -> None:
    """Which is what the specification asks for, and not enough."""
    recorded = ping(NOW)
    assert is_taken(started(tmp_path)[0], recorded, NOW)
    assert is_taken(started(tmp_path)[0], recorded, NOW + NEW_WITHIN - 1)
    assert not is_taken(started(tmp_path)[0], recorded, NOW + NEW_WITHIN)


def test_after_a_proper_end_nobody_waits(tmp_path: Path) -> None:
    signer, memory = started(tmp_path)
    recorded = ping(NOW)
    assert is_taken(signer, recorded, NOW)
    work(memory)
    last = memory.last()
    assert last is not None
    memory.write(last)
    signer, _ = started(tmp_path)
    assert not is_taken(signer, recorded, NOW)
    assert is_taken(signer, ping(NOW + 1), NOW)


def test_a_clock_that_was_set_back_takes_and_signs_nothing_old(tmp_path: Path) -> None:
    """A computer without a clock of its own begins in the past."""
    signer, memory = started(tmp_path)
    recorded = ping(NOW - 2 * NEW_WITHIN, system=246)
    assert is_taken(signer, ping(NOW), NOW)
    work(memory)
    past = NOW - 3 * NEW_WITHIN
    signer, _ = started(tmp_path, past)
    assert not is_taken(signer, recorded, past), "it was never heard, and is two minutes old"
    signer.sign(b"", past)
    assert signer.sent > NOW


def test_who_has_a_later_clock_does_not_refuse_what_is_signed_here() -> None:
    signer = Signer(KEY)
    assert is_taken(signer, ping(NOW + 10 * NEW_WITHIN), NOW)
    signer.sign(b"", NOW)
    assert signer.sent > NOW + 10 * NEW_WITHIN
    assert not is_taken(signer, ping(LAST_SIGNATURE + 1), NOW), "the field would be at its end"


@pytest.mark.parametrize(
    "spoilt",
    [
        *("", "{", "[" * 60000, "x" * 70000, "[]", '{"sent": 1}', '{"sent": 1, "newest": []}'),
        *('{"sent": 1, "newest": {"1.2": 3}}', '{"sent": 1, "newest": {"1.2.x": 3}}'),
        *('{"sent": -1, "newest": {}}', '{"sent": "now", "newest": {}}', "\xff"),
        f'{{"sent": 1, "newest": {{"1.1.1": {2**48}}}}}',
    ],
)
def test_a_memory_that_cannot_be_read_hides_nothing(tmp_path: Path, spoilt: str) -> None:
    signer = Signer(KEY)
    memory = SignatureMemory(tmp_path, signer)
    memory.path.write_text(spoilt, "latin-1")
    assert "cannot be read" in memory.recall(NOW)
    assert not is_taken(signer, ping(NOW - SECOND), NOW)
    assert is_taken(signer, ping(NOW + SECOND), NOW)
    work(memory)
    assert not is_taken(started(tmp_path)[0], ping(NOW + SECOND), NOW)


@pytest.mark.parametrize("beyond", [0, 1])
def test_a_memory_has_a_greatest_time_and_a_greatest_size(tmp_path: Path, beyond: int) -> None:
    """The last one that fits, and what the clock may be behind it; 64 kB."""
    latest = LAST_SIGNATURE + AHEAD
    for text in (
        f'{{"sent": {latest + beyond}, "newest": {{}}}}',
        f'{{"sent": 1, "newest": {{"1.1.1": {latest + beyond}}}}}',
        '{"sent": 1, "newest": {}}'.ljust(65536 + beyond),
    ):
        memory = SignatureMemory(tmp_path, Signer(KEY))
        memory.path.write_text(text)
        assert ("cannot be read" in memory.recall(NOW)) is bool(beyond)


def test_no_bit_of_it_turns_over_unnoticed(tmp_path: Path) -> None:
    """A time that became less would let in again what was recorded."""
    signer, memory = started(tmp_path)
    assert is_taken(signer, ping(NOW + SECOND), NOW)
    work(memory)
    whole = memory.path.read_bytes()
    assert SignatureMemory(tmp_path, Signer(KEY)).recall(NOW) == ""
    for at in range(len(whole)):
        for bit in range(8):
            memory.path.write_bytes(whole[:at] + bytes((whole[at] ^ 1 << bit,)) + whole[at + 1 :])
            told = SignatureMemory(tmp_path, Signer(KEY)).recall(NOW)
            if not told:  # what stands between values may be any white space
                assert json.loads(memory.path.read_bytes()) == json.loads(whole), (at, bit)


def test_one_of_an_older_version_is_read(tmp_path: Path) -> None:
    signer = Signer(KEY)
    memory = SignatureMemory(tmp_path, signer)
    memory.path.write_text(f'{{"sent": {NOW + SECOND}, "newest": {{}}}}')
    assert memory.recall(NOW) == ""
    assert signer.sent == NOW + SECOND


def test_the_file_is_ours_alone_and_small_and_tells_no_key(tmp_path: Path) -> None:
    folder = tmp_path / "made" / "for it"
    signer, memory = started(folder)
    for system in range(1, 251):
        at = NOW + system * 60 * SECOND // 25
        assert is_taken(signer, ping(at, system), at)
        work(memory)
    assert memory.path.stat().st_mode & 0o777 == 0o600
    assert folder.stat().st_mode & 0o777 == 0o700
    text = memory.path.read_text()
    assert len(json.loads(text)["newest"]) < 30, "who is older is refused for that"
    assert KEY.hex() not in text + memory.path.name
    assert [one.name for one in folder.iterdir()] == [memory.path.name]
    other = SignatureMemory(folder, Signer(bytes(32)))
    assert other.path != memory.path


def test_two_bridges_with_one_key_forget_nothing_of_each_other(tmp_path: Path) -> None:
    first, first_memory = started(tmp_path)
    second, second_memory = started(tmp_path)
    assert is_taken(first, ping(NOW, 245), NOW)
    assert is_taken(second, ping(NOW + SECOND, 246), NOW)
    work(first_memory)
    work(second_memory)
    for memory in (first_memory, second_memory):
        last = memory.last()
        assert last is not None
        memory.write(last)
    later, _ = started(tmp_path)
    assert not is_taken(later, ping(NOW, 245), NOW)
    assert not is_taken(later, ping(NOW + SECOND, 246), NOW)


def test_of_one_sender_that_two_bridges_hear_the_later_word_counts(tmp_path: Path) -> None:
    bridges = [started(tmp_path), started(tmp_path)]
    for (signer, memory), at in zip(bridges, (NOW, NOW + SECOND), strict=True):
        assert is_taken(signer, ping(at), at)
        work(memory)
    for _, memory in reversed(bridges):
        last = memory.last()
        assert last is not None
        memory.write(last)
    later, _ = started(tmp_path, NOW + SECOND)
    assert not is_taken(later, ping(NOW + SECOND), NOW + SECOND)


def test_it_is_written_once_in_a_while_and_at_once_for_somebody_new(tmp_path: Path) -> None:
    signer, memory = started(tmp_path)
    writes = 0
    for step in range(600):
        is_taken(signer, ping(NOW + step * SECOND // 10), NOW)
        snapshot = memory.due()
        if snapshot is not None:
            writes += 1
            memory.write(snapshot)
    assert writes == pytest.approx(60 * SECOND / AHEAD, abs=2)
    assert is_taken(signer, ping(NOW, 246), NOW)
    assert memory.due() is not None


def test_a_disk_that_does_not_take_it_is_told(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    signer = Signer(KEY)
    memory = SignatureMemory(tmp_path / "file" / "folder", signer)
    assert memory.recall(NOW)
    assert is_taken(signer, ping(NOW + 1), NOW)
    snapshot = memory.due()
    assert snapshot is not None
    with pytest.raises(OSError):  # noqa: PT011 - whichever it is
        memory.write(snapshot)
    assert memory.due() is not None
