"""Losses in a log are counted and reported, by what they are and not by what they may be."""

from __future__ import annotations

import asyncio
import logging
from pathlib import Path
from typing import Any

import pytest

from m100link.errors import UsageError
from m100link.log import Damage, read, recorder, recover
from m100link.log.channels import LINK, RX
from m100link.log.damage import Losses
from m100link.sim import VirtualClockEventLoop
from tests.log.flight import flown
from tests.log.test_records import changed, parts


@pytest.fixture
def flight(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A flight in many parts."""
    monkeypatch.setattr(recorder, "FLUSH_S", 0.0)  # of the wall clock: a part for each batch
    path = tmp_path / "flight.mcap"
    with asyncio.Runner(loop_factory=VirtualClockEventLoop) as runner:
        runner.run(flown(path))
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


# -- counting, by hand -----------------------------------------------------------------------------

S = 10**9


def heard_of(*rows: tuple[int, int, float] | tuple[int, int], ends: bool = True) -> Losses:
    """Channel, number and time of each message, or begin and end of a damaged place."""
    losses = Losses()
    losses.topics = {1: "/a", 2: "/b"}
    losses.is_ended = ends
    for row in rows:
        if len(row) == 2:
            losses.place(*row)
        else:
            losses.hear(row[0], row[1], round(row[2] * S), True)
    return losses


@pytest.mark.parametrize(
    ("given", "places", "size"),
    [
        ([(5, 9)], ((5, 9),), 4),
        ([(5, 5), (9, 7)], (), 0),  # nothing
        ([(5, 9), (9, 12)], ((5, 12),), 7),
        ([(5, 9), (7, 8)], ((5, 9),), 4),
        ([(5, 9), (3, 12)], ((3, 12),), 9),
        ([(5, 9), (10, 12)], ((5, 9), (10, 12)), 6),
    ],
)
def test_places_that_touch_are_one(
    given: list[tuple[int, int]], places: tuple[tuple[int, int], ...], size: int
) -> None:
    damage = heard_of(*given).damage()
    assert (damage.places, damage.damaged_bytes, bool(damage)) == (places, size, bool(places))


@pytest.mark.parametrize(
    ("rows", "missing", "spans"),
    [
        ([(1, 0, 5.0), (1, 1, 6.0)], {}, ()),
        ([(1, 2, 5.0), (1, 3, 6.0)], {"/a": 2}, ((None, 5.0),)),
        ([(1, 0, 5.0), (1, 4, 6.0), (1, 5, 7.0)], {"/a": 3}, ((5.0, 6.0),)),
        # A damaged place between two messages that follow each other took none.
        ([(1, 0, 5.0), (100, 200), (1, 1, 6.0)], {}, ()),
        ([(1, 0, 5.0), (100, 200), (1, 2, 6.0)], {"/a": 1}, ((5.0, 6.0),)),
        # The other topic shows which of the places it was: between the first and the last.
        ([(2, 0, 4.0), (1, 0, 5.0), (9, 12), (1, 1, 6.0), (2, 2, 7.0)], {"/b": 1}, ((5.0, 6.0),)),
        (
            [(1, 0, 5.0), (9, 12), (1, 1, 6.0), (20, 22), (1, 3, 8.0), (2, 1, 9.0)],
            {"/a": 1, "/b": 1},
            ((5.0, 6.0), (6.0, 8.0)),
        ),
        # A message that is late makes the clock of a hole go back no further.
        ([(1, 0, 5.0), (2, 0, 4.0), (9, 12), (1, 2, 6.0)], {"/a": 1}, ((5.0, 6.0),)),
        ([(1, 0, 5.0), (1, 0, 6.0), (1, 1, 7.0)], {}, ()),
        # Bytes behind the last message may have held none.
        ([(1, 0, 5.0), (1, 1, 6.0), (9, 12)], {}, ()),
    ],
)
def test_numbers_show_how_many_are_missing_and_where(
    rows: list[Any], missing: dict[str, int], spans: tuple[Any, ...]
) -> None:
    damage = heard_of(*rows).damage()
    assert (damage.missing, damage.spans_utc) == (missing, spans)
    assert damage.missing_messages == sum(missing.values())
    assert damage.began_utc == rows[0][2]


def test_the_end_of_a_file_counts_what_no_number_shows() -> None:
    losses = heard_of((1, 0, 5.0), (1, 1, 6.0), (9, 12))
    losses.counts = {1: 5, 2: 2, 3: 1}
    damage = losses.damage()
    assert damage.missing == {"/a": 3, "/b": 2, "": 1}
    assert damage.spans_utc == ((6.0, None),)
    losses.counts = {1: 2}
    assert losses.damage().missing == {}
    losses.hear(7, 0, 7 * S, False)  # of a topic that the file does not name
    assert losses.damage().missing == {"": 1}


@pytest.mark.parametrize(
    ("damage", "said"),
    [
        (Damage(), "nothing is missing"),
        (
            Damage(is_ended=False),
            "it ended without being closed: its process was killed, or had no more disk",
        ),
        (Damage(is_ended=False, is_written=True), "it is still being recorded"),
        (
            Damage(places=((1000, 2500),)),
            "1,500 bytes are damaged (bytes 1,000 to 2,499); no message is missing",
        ),
        (
            Damage(places=((1, 2),), is_ended=False),
            (
                "1 bytes are damaged (bytes 1 to 1); nobody knows how many messages are missing; "
                "its end is missing"
            ),
        ),
        (
            Damage(is_changed=True),
            "the file was changed: its checksum is wrong; no message is missing",
        ),
        (
            Damage(missing={"/b": 2, "": 1}, spans_utc=((None, 12.25), (13.5, None)), began_utc=10),
            (
                "3 messages are missing at least (1 ?, 2 /b); "
                "missing is from the beginning to 2.2 s, 3.5 s to the end"
            ),
        ),
        (
            Damage(places=tuple((10 * n, 10 * n + 1) for n in range(5))),
            (
                "5 bytes are damaged (bytes 0 to 0, 10 to 10, 20 to 20 and 2 more); "
                "no message is missing"
            ),
        ),
    ],
)
def test_damage_is_said_in_words(damage: Damage, said: str) -> None:
    assert str(damage) == said
