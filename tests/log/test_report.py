"""The sentences about a flight, from notes by hand in the log of a virtual aircraft."""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import Any

import pytest

from m100link import connect
from m100link.log import read
from m100link.log.picture import line_quality
from m100link.log.reading import FrameLoss
from m100link.log.report import Sentence, report
from m100link.log.story import FlightSummary, read_story
from tests.log.flight import URL

pytestmark = pytest.mark.anyio

NAMES = {"client": "console", "by": "Anna"}
NOTES: list[tuple[str, dict[str, Any], str]] = [
    ("client", {"name": "console", "is_there": True}, "console came."),
    ("lease", {"holder": "Anna", "why": "acquired"}, "Anna has the lease (acquired)."),
    (
        "control",
        {"before": "obtaining", "after": "held", "why": "given"},
        "Control authority was obtained for Anna.",
    ),
    (
        "order",
        {**NAMES, "order": "fly to", "stage": "asked", "arguments": {"height": 5.0}},
        "Anna asked for fly to (height 5.0).",
    ),
    ("order", {**NAMES, "order": "fly to", "stage": "done"}, "Anna got fly to."),
    (
        "order",
        {"client": "ros", "by": "", "order": "land", "stage": "failed", "seen": "Anna flies"},
        "ros did not get land: Anna flies.",
    ),
    (
        "setpoints",
        {**NAMES, "stage": "refused", "seen": "STOP was pressed"},
        "Setpoints of Anna were refused: STOP was pressed.",
    ),
    (
        "plan",
        {"name": "Anna", "waypoints": [[1, 2, 3]] * 4},
        "Anna uploaded a plan of 4 waypoints.",
    ),
    ("text", {"client": "ros", "text": "Bob: STOP"}, "Bob: STOP."),
    ("journal", {"level": "info", "text": "stop"}, "stop."),
    ("lease", {"holder": "Bob", "why": "taken over"}, "Bob has the lease (taken over from Anna)."),
    ("lease", {"holder": "", "why": "expired"}, "Bob has the lease no more (expired)."),
    ("text", {"client": "x", "text": "a\x1b[2Jb"}, "a�[2Jb."),
]
STRANGE: list[tuple[str, dict[str, Any]]] = [
    *(("order", {}), ("lease", {"holder": 3}), ("client", {"name": None, "is_there": 1})),
    *(("setpoints", {"client": "x", "by": "x", "setpoint": 7}), ("unknown", {"x": 1})),
]


async def told(path: Path, notes: list[tuple[str, dict[str, Any]]]) -> list[Sentence]:
    async with connect(URL, record=path) as aircraft:
        for event, values in notes:
            aircraft.note(event, **values)
            await asyncio.sleep(0.05)
    flight = read(path)
    return report(flight, read_story(flight))


async def test_each_note_is_a_sentence(tmp_path: Path) -> None:
    said = await told(tmp_path / "a.mcap", [(event, values) for event, values, _ in NOTES])
    events = {event for event, _, _ in NOTES}
    assert [one.text for one in said if one.kind in events] == [text for _, _, text in NOTES]
    assert said[-1].text == "The connection ended: the link was closed by this side."
    assert [one.at_s for one in said] == sorted(one.at_s for one in said)


async def test_notes_that_nobody_can_read_cost_themselves_alone(tmp_path: Path) -> None:
    said = await told(tmp_path / "a.mcap", [*STRANGE, ("text", {"client": "x", "text": "whole"})])
    assert "whole." in [one.text for one in said]


async def test_a_note_that_cannot_be_written_costs_itself_alone(tmp_path: Path) -> None:
    class Bad:
        def __str__(self) -> str:
            raise ValueError("no text")

    notes: list[tuple[str, dict[str, Any]]] = [
        ("a", {"value": Bad()}),
        ("b", {"value": object(), "key": "app_id=1234567", "at": "never", "flag": float("nan")}),
        ("text", {"client": "x", "text": "whole"}),
    ]
    said = await told(tmp_path / "a.mcap", notes)
    assert "whole." in [one.text for one in said]
    events = {
        one.content()["event"]: one.content()
        for one in read(tmp_path / "a.mcap").messages("/m100/event")
    }
    assert events["note"]["problem"] == "ValueError"
    assert events["b"]["key"] == "app_id=…"


async def test_the_line_is_judged(tmp_path: Path) -> None:
    """By the specification of the line: none is lost on a clean one, a tenth on the other."""
    async with connect(URL, record=tmp_path / "clean.mcap"):
        await asyncio.sleep(5.0)
    assert line_quality(read_story(read(tmp_path / "clean.mcap"))).startswith(
        "0.0 % of frames lost; 0 frames damaged or cut off (0.0 %)"
    )
    lossy = "&damage=0.1"
    async with connect(URL + lossy, record=tmp_path / "lossy.mcap"):
        await asyncio.sleep(20.0)
    story = read_story(read(tmp_path / "lossy.mcap"))
    damaged, whole = sum(story.line["discards"].values()), story.line["frames_received"]
    assert 0.06 < damaged / (damaged + whole) < 0.16
    assert story.lost_share is not None
    assert 0.07 < story.lost_share < 0.13
    assert f"{story.line['discarded_bytes']:,} bytes discarded" in line_quality(story)


async def test_frames_that_vanish_whole_are_counted(tmp_path: Path) -> None:
    """No byte of them comes, so that only their numbers tell."""
    async with connect(URL + "&loss=0.2&duplicate=0.1", record=tmp_path / "a.mcap"):
        await asyncio.sleep(20.0)
    story = read_story(read(tmp_path / "a.mcap"))
    assert story.discarded_bytes == 0
    assert story.lost_share is not None
    assert 0.16 < story.lost_share < 0.24


@pytest.mark.parametrize(
    ("numbers", "share"),
    [
        ([], None),
        ([7] * 50, None),  # an aircraft that does not count
        ([65534, 65535, 0, 1], 0.0),
        ([1, 2, 3, 3, 4], 0.0),  # one came twice
        ([1, 2, 3, 4, 5, 7, 8, 9], 1 / 9),
        ([1, 2, 3, 4, 30000, 30001, 30002], 0.0),  # switched off and on
        ([3, 4, 5, 4, 5, 6], 0.0),  # one overtook another
    ],
)
def test_lost_frames_by_their_numbers(numbers: list[int], share: float | None) -> None:
    loss = FrameLoss()
    for number in numbers:
        loss.hear(number)
    assert loss.share == (None if share is None else pytest.approx(share))


async def test_a_version_that_comes_late_is_that_of_the_flight(tmp_path: Path) -> None:
    """On a line that loses frames the first counters have the default profile."""
    async with connect(URL + "&firmware=3.1&loss=0.2", record=tmp_path / "a.mcap"):
        await asyncio.sleep(3.0)
    flight = read(tmp_path / "a.mcap")
    names = [one.content()["firmware"] for one in flight.messages("/m100/link")]
    assert (names[0], names[-1]) == ("1.0", "3.1")
    assert str(flight.firmware) == "3.1"


def test_a_log_without_counters_has_a_quality_too() -> None:
    assert line_quality(FlightSummary("x")).startswith("0 frames damaged or cut off (0.0 %)")
