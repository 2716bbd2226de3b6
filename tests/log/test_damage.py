"""Losses in a log are counted and reported, by what they are and not by what they may be."""

from __future__ import annotations

import asyncio
import logging
from pathlib import Path

import pytest

from m100link.errors import UsageError
from m100link.log import Damage, read, recorder, recover
from m100link.log.channels import LINK, RX
from m100link.log.damage import Losses
from m100link.sim import VirtualClockEventLoop
from tests.log.flight import fly
from tests.log.test_records import changed, parts


@pytest.fixture
def flight(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A flight in many parts."""
    monkeypatch.setattr(recorder, "FLUSH_S", 0.0)  # of the wall clock: a part for each batch
    path = tmp_path / "flight.mcap"
    with asyncio.Runner(loop_factory=VirtualClockEventLoop) as runner:
        runner.run(fly(path))
    return path


def holed(path: Path, number: int, *, begin: int = 60, size: int = 1) -> Path:
    """A copy with a part that is damaged."""
    whole = path.read_bytes()
    at = parts(whole)[number][0] + begin
    bad = path.with_name("bad.mcap")
    bad.write_bytes(
        whole[:at] + bytes(one ^ 1 for one in whole[at : at + size]) + whole[at + size :]
    )
    return bad


def test_a_flipped_bit_is_reported_with_what_it_cost(
    flight: Path, caplog: pytest.LogCaptureFixture
) -> None:
    every = list(read(flight).messages())
    assert not read(flight).damage
    log = read(holed(flight, 5))
    with caplog.at_level(logging.WARNING):
        kept = list(log.messages())
        list(log.samples())
    lost = [message for message in every if message not in set(kept)]
    begin, end = parts(flight.read_bytes())[5]
    damage = log.damage
    assert damage.places == ((begin, end),)
    assert damage.missing_messages == len(lost) > 0
    assert damage.missing[RX] == sum(message.topic == RX for message in lost)
    ((first, last),) = damage.spans_utc
    assert first is not None
    assert last is not None
    assert all(first - 0.5 <= message.utc <= last + 0.5 for message in lost)
    assert [record.message for record in caplog.records] == [f"{log.path}: {damage}"], "once"
    assert log.summary().is_whole is False


def test_the_last_part_of_an_ended_file_is_missed_by_what_its_end_counts(
    flight: Path,
) -> None:
    every = len(list(read(flight).messages()))
    log = read(holed(flight, -1))
    kept = len(list(log.messages()))
    assert log.damage.missing_messages == every - kept > 0
    assert log.damage.spans_utc[-1][1] is None, "to the end of the file"
    assert log.damage.is_ended


def test_a_hole_is_never_reported_as_a_process_that_was_killed(flight: Path) -> None:
    whole = flight.read_bytes()
    tail = flight.with_name("tail.mcap")
    half = parts(whole)[len(parts(whole)) // 2][0] + 30
    tail.write_bytes(whole[:half] + bytes(len(whole) - half))
    assert "killed" not in str(read(tail).damage)
    assert "its end is missing" in str(read(tail).damage)
    cut = flight.with_name("cut.mcap")
    cut.write_bytes(whole[:half])
    damage = read(cut).damage
    assert not damage
    assert not damage.is_ended
    assert damage.cut_bytes == 30
    assert "killed" in str(damage)


def test_what_no_part_holds_is_covered_by_a_checksum_too(flight: Path) -> None:
    """An index whose kind is one bit off was passed on as a message that nobody wrote."""
    whole = flight.read_bytes()
    every = set(read(flight).messages())
    index = parts(whole)[3][1]
    assert whole[index] == 7
    bad = flight.with_name("bad.mcap")
    for place in (9, index, index + 20, len(whole) - 60):
        bad.write_bytes(changed(whole, place, whole[place] ^ 2))
        assert read(bad).damage, place
        assert set(read(bad).messages()) <= every


def test_a_file_without_its_first_bytes_is_read_all_the_same(flight: Path) -> None:
    bad = flight.with_name("bad.mcap")
    bad.write_bytes(bytes(8) + flight.read_bytes()[8:])
    assert list(read(bad).messages()) == list(read(flight).messages())
    assert read(bad).damage.places[0][0] == 0
    bad.write_bytes(b"\x0f\x04" + bytes(7 + 100))
    with pytest.raises(UsageError, match="not a flight log"):
        read(bad)


def test_a_bad_sector_of_a_mended_file_costs_half_a_second(flight: Path) -> None:
    """Of one that was written as a single part it cost the flight."""
    whole = flight.read_bytes()
    cut, mended = flight.with_name("cut.mcap"), flight.with_name("mended.mcap")
    cut.write_bytes(whole[: parts(whole)[-1][1]])
    saved = recover(cut, mended)
    data = mended.read_bytes()
    found = parts(data)
    assert len(found) >= 5
    for begin, _ in found[:-1]:
        mended.write_bytes(data[: begin + 100] + bytes(512) + data[begin + 612 :])
        log = read(mended)
        kept = len(list(log.messages()))
        assert kept > 0.5 * saved
        assert log.damage.missing_messages == saved - kept
        assert log.summary().began_utc is not None


def test_what_a_mended_file_lacks_is_written_in_it(flight: Path) -> None:
    mended = flight.with_name("mended.mcap")
    bad = read(holed(flight, 5))
    recover(bad.path, mended)
    again = read(mended).damage
    assert again.places == ()
    assert again.missing == bad.damage.missing
    assert again.is_ended


def test_an_unknown_firmware_is_laid_to_what_is_missing(flight: Path) -> None:
    whole = bytearray(flight.read_bytes())
    for begin, end in parts(bytes(whole)):
        whole[begin + 60] ^= 1
        del end
    bad = flight.with_name("bad.mcap")
    bad.write_bytes(whole)
    with pytest.raises(UsageError, match="which firmware") as caught:
        list(read(bad).samples())
    assert "damage" in caught.value.cause
    assert read(bad).damage.missing[LINK] > 0


def test_numbers_of_other_programs_are_no_holes() -> None:
    losses = Losses()
    losses.is_numbered = False
    losses.is_ended = True
    for number in (5, 9, 0):
        losses.hear(1, number, 10, True)
    assert losses.damage() == Damage(began_utc=1e-8, ended_utc=1e-8)
    assert str(losses.damage()) == "nothing is missing"
