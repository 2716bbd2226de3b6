"""The sentences about a flight, from notes by hand in the log of a virtual aircraft."""

from __future__ import annotations

import asyncio
import math
import random
from pathlib import Path
from typing import Any

import pytest

from m100link import connect
from m100link.errors import UsageError
from m100link.link import Direction
from m100link.log import read
from m100link.log.picture import line_quality, page
from m100link.log.reading import FrameLoss
from m100link.log.recorder import Batch, LogWriter
from m100link.log.report import Sentence, _TelemetryReader, report
from m100link.log.story import FlightSummary, read_story
from m100link.protocol import encode_telemetry, profile
from m100link.protocol.commands.monitor import PushTelemetry
from m100link.wire import encode_frame
from tests.log.flight import URL
from tests.log.test_share import written

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
        "Anna ordered fly to (height 5.0).",
    ),
    ("order", {**NAMES, "order": "fly to", "stage": "done"}, "Anna's order ended: fly to."),
    (
        "order",
        {"client": "ros", "by": "", "order": "land", "stage": "failed", "seen": "Anna flies"},
        "ros's order failed: land: Anna flies.",
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


def test_what_is_noted_later_has_the_time_when_it_was(tmp_path: Path) -> None:
    """Messages are a second apart, from 1 s on; the last tells of 2.5 s ago."""
    note = {"event": "text", "client": "x", "text": "hi", "earlier_s": 2.5}
    others = [("/m100/link", {"firmware": "1.0"})] * 6
    flight = written(tmp_path / "a.mcap", *others, ("/m100/event", note))
    assert [one.at_s for one in report(flight, read_story(flight)) if one.text == "hi."] == [3.5]


async def test_a_sentence_is_of_the_kind_that_it_is_about(tmp_path: Path) -> None:
    note = ("state", {"limits": {"max_height_m": 30.0}})
    kinds = {one.text: one.kind for one in await told(tmp_path / "a.mcap", [note])}
    assert kinds["In force: at most 30 m high."] == "limits"
    assert kinds["The connection ended: the link was closed by this side."] == "line"


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


def test_acks_have_the_numbers_of_their_commands_and_tell_of_no_loss(tmp_path: Path) -> None:
    value = bytes(PushTelemetry.ADDRESS) + encode_telemetry({"battery": (50,)}, profile("1.0"))
    frames = [encode_frame(value, session=0, sequence=number) for number in range(10, 30)]
    frames.insert(7, encode_frame(b"\0\0", session=2, sequence=60, is_ack=True))
    with (tmp_path / "a.mcap").open("xb") as stream:
        log = LogWriter(stream, 10.0)
        heard = [(Direction.RECEIVED, one, 5.0 + n / 100) for n, one in enumerate(frames)]
        log.write(Batch(heard, profile=profile("1.0")))
        log.finish()
    flight = read(tmp_path / "a.mcap")
    assert len(list(flight.samples(firmware="1.0"))) == 20
    assert (flight.loss.came, flight.loss.lost) == (20, 0)


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
    line = {"frames_received": 30, "discards": {"header_crc": 6, "length": 4}}
    assert line_quality(FlightSummary("x", line=line)).startswith(
        "10 frames damaged or cut off (25.0 %)"
    )


# -- logs of other writers, and with bits turned over ----------------------------------------------


ESCAPE = "\x1b]0;x\x07\x1b[2J\n\u202e"
VALUES: tuple[Any, ...] = (
    *("", ESCAPE, None, True, -1, 2**63, 1e308, math.nan, math.inf, [], {}, [[]], [1, 2, 3]),
    *("held", "releasing", "asked", "failed", "refused", "velocity", "rate", "ground", 72, 1.0),
)
NAMES_OF_FIELDS = (
    *("before", "after", "why", "reason", "holder", "name", "is_there", "client", "by", "order"),
    *("stage", "seen", "arguments", "setpoint", "waypoints", "text", "is_connected", "error"),
    *("limits", "max_height_m", "mode", "x", "y", "z", "yaw", "frame", "earlier_s", "is_ack"),
    *("direction", "session", "sequence", "command", "movement", "control_flag", "roll_or_x"),
    *("ack", "discards", "round_trips", "acks", "discarded_bytes", "repeats", "frames_received"),
)
EVENTS = ("client", "lease", "control", "order", "setpoints", "plan", "text", "journal", "state",
          "connection", "authority")  # fmt: skip


def drawn(draw: random.Random, depth: int = 0) -> Any:
    if depth < 3 and draw.random() < 0.3:
        return {draw.choice(NAMES_OF_FIELDS): drawn(draw, depth + 1) for _ in range(4)}
    return draw.choice(VALUES)


def hostile(draw: random.Random) -> tuple[str, dict[str, Any]]:
    content = {draw.choice(NAMES_OF_FIELDS): drawn(draw) for _ in range(draw.randrange(1, 10))}
    topic = draw.choice(("/m100/event", "/m100/event", "/m100/command", "/m100/link"))
    if topic == "/m100/event":
        content["event"] = draw.choice(EVENTS)
    elif topic == "/m100/command":
        content["command"] = draw.choice(("move", "start_task", "get_version", drawn(draw)))
    else:
        content["firmware"] = "1.0" if draw.random() < 0.98 else drawn(draw)
    return topic, content


@pytest.mark.parametrize("seed", range(12))
def test_no_content_of_a_log_raises_or_reaches_a_terminal(tmp_path: Path, seed: int) -> None:
    print(f"{seed=}")  # noqa: T201 (of a failure)
    draw = random.Random(seed)
    messages = [hostile(draw) for _ in range(100)]
    flight = written(tmp_path / "a.mcap", ("/m100/link", {"firmware": "1.0"}), *messages)
    try:
        story = read_story(flight)
        said = report(flight, story)
    except UsageError:  # it names a firmware that nobody knows
        return
    assert all(one.text.isprintable() and one.who.isprintable() for one in said)
    assert line_quality(story)
    assert page(story)


# -- motion, by telemetry made by hand: velocity at 10 Hz, m/s to the north and up -----------------


def moved(*spans: tuple[float, float, float]) -> list[tuple[float, str]]:
    """The sentences of motion: spans are seconds, and speeds; NaN for no telemetry."""
    known, values, at = profile("1.0"), [], 0.0
    for seconds, north, up in spans:
        for _ in range(round(10 * seconds)):
            if not math.isnan(north):
                items = {"velocity": (north, 0.0, up), "rc": (0, 0, 0, 0, 8000, -4545)}
                values.append((encode_telemetry(items, known), 100.0 + at))
            at += 0.1
    reader = _TelemetryReader(FlightSummary("made"), known, [])
    reader.hear(values, 100.0)
    return [(round(one.at_s, 1), one.text) for one in reader.end() if one.kind == "motion"]


BEGAN, SILENT = "The aircraft began to move.", "It was moving when telemetry fell silent."


@pytest.mark.parametrize(
    ("spans", "said"),
    [
        ([(2, 0.2, 0.0)], []),
        (
            [(1, 0.0, 0.0), (2, 2.0, 0.0), (1, 0.0, 0.0)],
            [(1.0, BEGAN), (2.9, "The aircraft stood still; it had moved 3.8 m in 1.9 s.")],
        ),
        (  # slower than that for less than half a second
            [(1, 1.0, 0.0), (0.4, 0.1, 0.0), (1, 1.0, 0.0), (1, 0.0, 0.0)],
            [(0.0, BEGAN), (2.3, "The aircraft stood still; it had moved 2.3 m in 2.3 s.")],
        ),
        (  # down
            [(1, 0.0, -0.5), (1, 0.0, 0.0)],
            [(0.0, BEGAN), (0.9, "The aircraft stood still; it had moved 0.5 m in 0.9 s.")],
        ),
        (  # what it did meanwhile nobody knows
            [(1, 2.0, 0.0), (3, math.nan, 0.0), (1, 2.0, 0.0), (1, 0.0, 0.0)],
            [(0.0, BEGAN), (0.9, SILENT), (4.0, BEGAN),
             (4.9, "The aircraft stood still; it had moved 1.8 m in 0.9 s.")],
        ),
        ([(1, 2.0, 0.0)], [(0.0, BEGAN), (0.9, "It was moving when telemetry ended.")]),
    ],
)  # fmt: skip
def test_motion_begins_and_ends(
    spans: list[tuple[float, float, float]], said: list[tuple[float, str]]
) -> None:
    assert moved(*spans) == said
