"""Commands and their answers, who had control, and what the line lost, from a log's messages."""

from __future__ import annotations

import json
import math
import struct
from pathlib import Path
from typing import Any, cast
from unittest.mock import patch

import pytest
from mcap.writer import Writer

from m100link.log import read
from m100link.log import story as story_module
from m100link.log.channels import Curve
from m100link.log.picture import panels
from m100link.log.reading import Message
from m100link.log.story import (
    FlightPath,
    FlightSummary,
    Moment,
    Span,
    _CommandReader,
    _SampleReader,
    read_story,
)
from m100link.protocol.firmware import profile
from m100link.protocol.items import BY_RECORD
from m100link.protocol.records import (
    Attitude,
    Battery,
    ControlDevice,
    FlightStatus,
    Position,
    Velocity,
)


def told(tmp_path: Path, *messages: tuple[float, str, dict[str, Any]]) -> FlightSummary:
    path = tmp_path / "flight.mcap"
    with path.open("wb") as stream:
        writer: Any = Writer(stream)
        writer.start()
        channels: dict[str, int] = {}
        for at, topic, content in messages:
            if topic not in channels:
                channels[topic] = writer.register_channel(topic, "json", 0)
            time = round((100.0 + at) * 1e9)
            data = json.dumps(content).encode()
            writer.add_message(
                channel_id=channels[topic], log_time=time, publish_time=time, data=data
            )
        writer.finish()
    return read_story(read(path))


def sent(
    at: float, command: str, sequence: int, **fields: Any
) -> tuple[float, str, dict[str, Any]]:
    head = {"is_ack": False, "direction": "tx", "session": 2, "sequence": sequence}
    return at, "/m100/command", {**head, "command": command, **fields}


def answered(
    at: float, command: str, sequence: int, name: str
) -> tuple[float, str, dict[str, Any]]:
    head = {"is_ack": True, "direction": "rx", "session": 2, "sequence": sequence}
    return at, "/m100/command", {**head, "command": command, "ack": {"code": 1, "name": name}}


def test_a_command_has_its_answer_and_what_it_took(tmp_path: Path) -> None:
    found = told(
        tmp_path,
        sent(0.0, "get_version", 1),
        sent(1.0, "start_task", 2, task="land"),
        sent(1.2, "start_task", 2, task="land"),  # once more: no answer came
        answered(1.5, "start_task", 2, "STARTED"),
        answered(1.6, "start_task", 2, "STARTED"),
        sent(3.0, "arm", 3, on=True),
    )
    assert [str(one) for one in found.commands] == [
        "start_task task=land: STARTED",
        "arm on=True: no answer",
    ]
    assert found.commands[0].after_s == 0.5
    assert found.duration_s == 3.0


def test_setpoints_are_spans_and_a_pause_ends_one(tmp_path: Path) -> None:
    moves = [sent(0.1 * n, "move", 0) for n in range(10)]
    moves += [sent(5.0 + 0.1 * n, "move", 0) for n in range(5)]
    spans = told(tmp_path, *moves).streams
    assert [span.text for span in spans] == ["10 × move", "5 × move"]
    assert [round(span.begin_s, 3) for span in spans] == [0.0, 5.0]


def test_the_holders_of_control_and_how_it_was_lost(tmp_path: Path) -> None:
    def authority(at: float, before: str, after: str, reason: str = "") -> Any:
        event = {"event": "authority", "before": before, "after": after, "reason": reason}
        return at, "/m100/event", event

    found = told(
        tmp_path,
        sent(0.0, "request_authority", 1, obtain=True),
        authority(1.0, "obtaining", "held"),
        authority(4.0, "held", "lost", "rc mode"),
        authority(5.0, "lost", "held"),
        authority(7.0, "held", "releasing"),
        authority(8.0, "releasing", "none"),
        sent(9.0, "request_authority", 2, obtain=False),
    )
    spans = [(span.name, span.begin_s, span.end_s) for span in found.control]
    assert spans == [
        ("pilot", 0.0, 1.0),
        ("program", 1.0, 4.0),
        ("pilot", 4.0, 5.0),
        ("program", 5.0, 8.0),
        ("pilot", 8.0, 9.0),
    ]
    assert [(alarm.name, alarm.text) for alarm in found.alarms] == [
        ("authority_lost", "control was lost: rc mode")
    ]


def test_the_line_is_reported_by_differences(tmp_path: Path) -> None:
    def counted(at: float, lost: int, acks: int, total_s: float) -> Any:
        trips = {"total_s": total_s}
        counters = {"discarded_bytes": lost, "acks": acks, "repeats": 3, "round_trips": trips}
        return at, "/m100/link", {"firmware": "1.0", **counters}

    found = told(
        tmp_path, counted(0.0, 5, 1, 1.0), counted(1.0, 5, 1, 1.0), counted(3.0, 25, 3, 1.1)
    )
    assert list(found.curves.discarded_bytes_per_s.points()) == [(1.0, 0.0), (3.0, 10.0)]
    [(at, round_trip)] = found.curves.round_trip_ms.points()
    assert (at, round(round_trip, 6)) == (3.0, 50.0)
    assert found.repeats == 3


def test_only_what_this_side_asks_and_hears_is_a_command_and_its_answer(tmp_path: Path) -> None:
    heard = [
        sent(0.0, "arm", 0, on=True),
        sent(1.0, "arm", 0, on=True),
        sent(2.0, "query_task", 1),
        sent(2.0, "follow_target", 0),
        sent(2.5, "follow_target", 0),  # half a second later it goes on
        sent(3.125, "follow_target", 0),
        sent(3.5, "land", 5, task_sequence=9, redacted=True, height=3.5),
        answered(3.75, "land", 5, "STARTED"),
        sent(4.0, "go", 6),
    ]
    refused = answered(6.5, "go", 6, "")
    del refused[2]["ack"]
    refused[2]["problem"] = "too short"
    heard += [
        (5.0, "/m100/command", answered(5.0, "go", 6, "MINE")[2] | {"direction": "tx"}),
        (6.0, "/m100/command", sent(6.0, "theirs", 7)[2] | {"direction": "rx"}),
        refused,
        sent(7.0, "go", 6),  # the number is used once more
    ]
    heard[0][2]["session"] = heard[1][2]["session"] = 0  # no ack: each is one of its own
    found = told(tmp_path, *heard)
    assert [(one.at_s, str(one), one.after_s) for one in found.commands] == [
        (0.0, "arm on=True: asks for no answer", None),
        (1.0, "arm on=True: asks for no answer", None),
        (3.5, "land height=3.5: STARTED", 0.25),
        (4.0, "go: too short", 2.5),
        (7.0, "go: no answer", None),
    ]
    assert [(one.text, one.begin_s, one.end_s) for one in found.streams] == [
        ("2 × follow_target", 2.0, 2.5),
        ("1 × follow_target", 3.125, 3.125),
    ]


def test_a_connection_ends_by_the_line_or_by_this_side(tmp_path: Path) -> None:
    def connection(at: float, is_connected: bool, error: str | None) -> Any:
        event = {"event": "connection", "is_connected": is_connected, "error": error}
        return at, "/m100/event", event

    lost = told(tmp_path, sent(0.0, "arm", 1), connection(2.0, False, "the port went away"))
    assert lost.ended == "the port went away"
    assert lost.alarms == [Span("link_lost", 2.0, 2.0, "the port went away")]
    back = told(tmp_path, connection(0.0, False, None), connection(2.0, True, None))
    assert (back.ended, [one.text for one in back.alarms]) == (None, [""])
    closed = "the link was closed by this side"
    ours = told(tmp_path, connection(0.0, True, None), connection(2.0, False, closed))
    assert (ours.ended, ours.alarms) == (closed, [])


def test_counters_of_the_line_are_differences_in_their_units(tmp_path: Path) -> None:
    """Bytes per second; milliseconds per ack; a counter that began anew lost nothing."""

    def counted(at: float, lost: int, acks: int, total_s: float, repeats: int) -> Any:
        counters = {"discarded_bytes": lost, "acks": acks, "repeats": repeats}
        return (
            at,
            "/m100/link",
            {**counters, "firmware": "1.0", "round_trips": {"total_s": total_s}},
        )

    rows = [(0.0, 50, 9, 1.0, 2), (0.5, 60, 9, 1.0, 3), (2.5, 10, 13, 1.5, 4)]
    found = told(tmp_path, *(counted(*row) for row in rows))
    assert list(found.curves.discarded_bytes_per_s.points()) == [(0.5, 20.0), (2.5, 0.0)]
    assert list(found.curves.round_trip_ms.points()) == [(2.5, 125.0)]
    assert (found.repeats, found.discarded_bytes) == (4, 10)


def test_a_listener_hears_setpoints_as_often_as_it_asks() -> None:
    heard: list[float] = []
    story = FlightSummary("made")
    reader = _CommandReader(story, 100.0, 0.5, lambda _, at, __: heard.append(round(at, 3)), None)
    data = json.dumps(sent(0.0, "move", 0)[2], separators=(",", ":")).encode()
    for step in range(12):
        reader.hear_move(Message("/m100/command", 101.0 + step / 8, 0.0, data))
    reader.end()
    assert heard == [1.0, 1.5, 2.0]
    assert story.streams == [Span("move", 1.0, 2.375, "12 × move")]
    assert story.duration_s == 2.375


def test_a_stream_names_its_own_last_motion_and_no_earlier_one() -> None:
    story = FlightSummary("made")
    reader = _CommandReader(story, 100.0, 0.5, None, profile("1.0"))
    for at, north in ((101.0, 2.0), (101.1, 0.0), (105.0, 0.0), (105.1, 0.0)):
        movement = {"control_flag": 72, "roll_or_x": north, "pitch_or_y": 0.0,
                    "throttle_or_z": 0.0, "yaw": 0.0}  # fmt: skip
        data = json.dumps({"command": "move", "movement": movement}, separators=(",", ":"))
        reader.hear_move(Message("/m100/command", at, 0.0, data.encode()))
    reader.end()
    moving = "the last with motion at 1.00 s: 2 m/s north, 0 m/s east, 0 m/s up, 0 °/s yaw rate"
    assert [one.text for one in story.streams] == [f"2 × move, {moving}", "2 × move"]


@pytest.mark.parametrize(
    ("flag", "speed", "climb", "height"),
    [  # the control flag (document 3.2): bits 7 and 6 horizontal, 5 and 4 vertical
        (0b0100_1000, 5.0, -1.5, None),
        (0b0100_1010, 5.0, -1.5, None),
        (0b0101_1000, 5.0, None, -1.5),
        (0b1000_1000, None, -1.5, None),
        (0b0000_0000, None, -1.5, None),
        (0b0010_1000, None, None, None),
        (0b1100_0000, None, None, None),  # no mode
    ],
)
def test_a_curve_has_what_setpoints_ask_for(
    flag: int, speed: float | None, climb: float | None, height: float | None
) -> None:
    story = FlightSummary("made")
    reader = _CommandReader(story, 100.0, 0.5, None, profile("1.0"))
    movement = {"control_flag": flag, "roll_or_x": 3.0, "pitch_or_y": -4.0,
                "throttle_or_z": -1.5, "yaw": 0.0}  # fmt: skip
    data = json.dumps({"command": "move", "movement": movement}, separators=(",", ":")).encode()
    for step in range(30):
        reader.hear_move(Message("/m100/command", 101.0 + step / 50, 0.0, data))
    reader.end()
    curves = story.curves
    for curve, value in (
        (curves.sent_speed_m_s, speed),
        (curves.sent_climb_m_s, climb),
        (curves.sent_height_m, height),
    ):
        found = list(curve.points())
        assert [one for _, one in found] == [value] * (0 if value is None else 6)
    drawn = {line.name for panel in panels(story) for line in panel.lines}
    assert ("sent" in drawn, "sent height" in drawn) == (speed is not None, height is not None)


# -- telemetry -------------------------------------------------------------------------------------


def heard(
    *packages: tuple[float, list[Any]],
    commands: tuple[Moment, ...] = (),
    ends_s: float | None = None,
    interval_s: float = 0.0,
) -> FlightSummary:
    story = FlightSummary("made", commands=list(commands))
    reader = _SampleReader(story, interval_s, None)
    made = {}  # packages with values that no frame could carry, by their bytes
    for number, (_, records) in enumerate(packages):
        flags = sum(1 << BY_RECORD[type(one)].bit for one in records)
        made[struct.pack("<HH", flags, number)] = {type(one): one for one in records}
    values = [(value, at) for value, (at, _) in zip(made, packages, strict=True)]
    with patch.object(story_module, "Sample", lambda value, *_: made[value]):
        reader.hear(values, 0.0, cast(Any, None))
    story.duration_s = packages[-1][0] if ends_s is None else ends_s
    reader.end()
    return story


GROUND, TAKES_OFF, FLIES, LANDS, TOUCHES = (FlightStatus(number) for number in range(1, 6))


def health(number: int | None, height_m: float = 5.0) -> Position:
    return Position(0.4, 0.9, 60.0, height_m, number)


@pytest.mark.parametrize(
    ("phase", "readings", "alarms"),
    [
        (GROUND, [Battery(26), Battery(25), Battery(26), Battery(27)], [("battery_low", 1, 3)]),
        (GROUND, [Battery(10), Battery(9), Battery(9), Battery(9)], [("battery_low", 0, 3)]),
        (
            FLIES,
            [Battery(11), Battery(10), Battery(11), Battery(12)],
            [("battery_low", 0, 3), ("battery_critical", 1, 3)],
        ),
        (FLIES, [health(3), health(2), health(0), health(3)], [("gps", 1, 3)]),
        (FLIES, [health(None), health(5), health(3), health(None)], []),
        (GROUND, [health(0), health(2), health(0), health(1)], []),
        (TAKES_OFF, [health(0), health(2), health(0), health(1)], []),
    ],
)
def test_an_alarm_begins_and_ends_at_its_limit(
    phase: FlightStatus, readings: list[Any], alarms: list[tuple[str, float, float]]
) -> None:
    later = ((float(n), [one]) for n, one in enumerate(readings[1:], 1))
    story = heard((0.0, [phase, readings[0]]), *later)
    assert [tuple(one[:3]) for one in story.alarms] == alarms
    if alarms[:1] == [("gps", 1, 3)]:
        assert story.alarms[0].text == "GPS health 2: it cannot hold its place"
    if alarms[-1:] == [("battery_critical", 1, 3)]:
        assert [one.text for one in story.alarms] == ["battery 11 %", "battery 10 %"]


def ordered(at: float, command: str, **arguments: Any) -> Moment:
    return Moment(at, command, arguments, None, None)


@pytest.mark.parametrize(
    ("commands", "rings"),
    [
        ([], True),
        ([ordered(8.0, "start_task", task="land")], False),
        ([ordered(9.0, "start_task", task="go_home")], False),  # at the same moment
        ([ordered(9.5, "start_task", task="land")], True),  # afterwards
        ([ordered(3.0, "start_task", task="land")], True),  # of the flight before
        ([ordered(8.0, "start_task", task="take_off")], True),
        ([ordered(3.0, "waypoint_start_stop")], False),  # a mission may end by it, whenever begun
        ([ordered(3.0, "hotpoint_start")], False),
        ([ordered(3.0, "follow_start")], False),
        ([ordered(9.5, "hotpoint_start")], True),
    ],
)
def test_it_lands_by_itself_unless_a_command_of_this_flight_asked(
    commands: list[Moment], rings: bool
) -> None:
    statuses = ((0.0, FLIES), (1.0, GROUND), (5.0, GROUND), (6.0, FLIES), (9.0, LANDS))
    after = ((9.5, TOUCHES), (10.25, GROUND), (11.0, GROUND))
    packages = [(at, [one]) for at, one in (*statuses, *after)]
    every = [*packages[:2], (4.0, [FLIES]), *packages[2:]]
    story = heard(*every, commands=tuple(commands))
    found = [tuple(one[:3]) for one in story.alarms if one.name == "lands_itself"]
    assert found == ([("lands_itself", 9.0, 10.25)] if rings else [])


@pytest.mark.parametrize(
    ("gaps", "ends_s", "silences", "longest"),
    [
        ([0.25, 0.5, 0.75, 0.6], 2.1, [], 0.75),
        ([0.5, 1.0], 1.5, [], 1.0),
        ([0.5, 1.25], 1.75, [(0.5, 1.75, "1.2")], 1.25),
        ([0.5, 3.0, 2.0], 5.5, [(0.5, 3.5, "3.0"), (3.5, 5.5, "2.0")], 3.0),
        ([0.5], 4.0, [(0.5, 4.0, "3.5")], 3.5),  # to the end of the log
    ],
)
def test_a_silence_is_longer_than_a_second(
    gaps: list[float], ends_s: float, silences: list[tuple[float, float, str]], longest: float
) -> None:
    times = [sum(gaps[:number]) for number in range(len(gaps) + 1)]
    story = heard(*((at, []) for at in times), ends_s=ends_s)
    assert [(one.begin_s, one.end_s, one.text) for one in story.alarms] == [
        (begin, end, f"no telemetry for {said} s") for begin, end, said in silences
    ]
    assert story.maxima.silence_s == longest
    assert story.packages == len(times)


def test_packages_are_counted_by_the_second_and_a_hole_is_three_zeros() -> None:
    times = [0.0, 0.3, 0.9, 1.0, 1.5, 2.25, 9.5, 9.75, 10.5]
    story = heard(*((at, []) for at in times))
    assert list(story.curves.packages_per_s.points()) == [
        *((0.5, 3.0), (1.5, 2.0), (2.5, 1.0)),
        *((3.5, 0.0), (4.5, 0.0), (5.5, 0.0)),
        (7.5, pytest.approx(math.nan, nan_ok=True)),
        (9.5, 2.0),
    ]


def test_phases_owners_and_maxima_of_a_flight() -> None:
    """Owners by the three lowest bits: 0 the remote control, 1 the app, 2 the onboard device."""
    moving = Velocity(3.0, -4.0, -1.5, 1)
    story = heard(
        (0.0, [GROUND, ControlDevice(0, None), Battery(90), Velocity(0.0, 0.0, 0.0, 1)]),
        (1.0, [FlightStatus(9), ControlDevice(0x0A, None)]),
        (2.0, [TAKES_OFF, ControlDevice(2, None), Velocity(0.0, 0.0, 2.5, 1)]),
        (3.0, [FLIES, ControlDevice(1, None), moving, health(5, -3.0)]),
        (4.0, [FLIES, ControlDevice(7, None), Battery(88), health(5, 12.5)]),
        (5.0, [LANDS, health(5, math.nan), Velocity(math.nan, 0.0, 9.0, 1)]),
        (6.0, [TOUCHES, Attitude(0.0, 0.6, 0.0, 0.8)]),
        (7.5, [GROUND, Attitude(math.nan, 0.0, 0.0, 0.0)]),
        ends_s=9.0,
    )
    assert story.phases == [
        Span(name, begin, end)
        for name, begin, end in (
            *(("ground", 0.0, 1.0), ("unknown", 1.0, 2.0), ("take-off", 2.0, 3.0)),
            *(("flight", 3.0, 5.0), ("landing", 5.0, 7.5), ("ground", 7.5, 9.0)),
        )
    ]
    assert story.control == [
        *(Span("pilot", 0.0, 1.0), Span("program", 1.0, 3.0), Span("app", 3.0, 9.0))
    ]
    assert (story.took_off_s, story.maxima.airborne_s) == (2.0, 5.5)
    most = story.maxima
    assert (most.ground_speed_m_s, most.climb_m_s, most.descent_m_s) == (5.0, 9.0, 1.5)
    assert (most.height_m, most.battery_first_percent, most.battery_last_percent) == (12.5, 90, 88)
    # Turned by 2 asin 0.6 about the forward axis and 180 degrees about the vertical one.
    assert most.tilt_deg == pytest.approx(2 * math.degrees(math.asin(0.6)))
    heights = [value for _, value in story.curves.height_m.points()]
    assert heights == [-3.0, 12.5]


def test_a_quick_look_takes_new_items_at_once_and_others_by_its_interval() -> None:
    """Rarer items come with packages of their own, which an interval must not miss."""
    readings: list[tuple[float, list[Any]]]
    readings = [(step / 8, [health(5, float(step))]) for step in range(17)]
    readings[3] = (3 / 8, [health(5, 99.0), Battery(50)])
    readings[5] = (5 / 8, [Battery(49)])
    story = heard(*readings, interval_s=0.5)
    assert [value for _, value in story.curves.height_m.points()] == [
        0.0,
        4.0,
        8.0,
        12.0,
        16.0,
    ]
    assert [value for _, value in story.curves.battery_percent.points()] == [50, 49]
    assert story.packages == 17


# -- curves and paths, by hand ---------------------------------------------------------------------


def test_a_curve_keeps_the_least_and_the_largest_of_each_fiftieth_of_a_second() -> None:
    curve = Curve(gap_s=0.5)
    for at, value in ((1.0, 5.0), (1.005, -7.0), (1.01, 6.0), (1.015, 5.5), (1.021, 1.0)):
        curve.add(at, value)
    assert list(curve.points()) == [(1.005, -7.0), (1.01, 6.0), (1.021, 1.0)]
    curve.add(1.521, 2.0)
    assert list(curve.points())[3:] == [(1.521, 2.0)]
    curve.add(2.025, 3.0)
    assert math.isnan(list(curve.points())[4][1])
    assert list(curve.points())[4][0] == pytest.approx(1.773)


def test_a_long_curve_has_no_holes_between_its_own_spans() -> None:
    """At 0.02 s and 800 spans; a package each 40 s for a day is 2160 of them: spans of 164 s."""
    curve = Curve(gap_s=2.0)
    for number in range(2160):
        curve.add(40.0 * number, float(number % 7))
    points = list(curve.points())
    assert len(curve) <= 800
    assert not any(math.isnan(value) for _, value in points)
    curve.add(90_000.0, 1.0)
    assert sum(math.isnan(value) for _, value in curve.points()) == 1


def test_a_flight_counts_from_its_take_off_to_its_landing() -> None:
    path = FlightPath()
    assert path.airborne_s(5.0) is None
    path.hear_phase(1.0, is_off_ground=True)  # it flew before anybody looked: for how long?
    assert path.airborne_s(5.0) is None
    for at, is_off_ground in ((10.0, False), (20.0, True), (25.0, True), (80.5, False)):
        path.hear_phase(at, is_off_ground=is_off_ground)
    path.hear_phase(100.0, is_off_ground=True)
    seconds = {
        10.0: None,
        20.0: 0.0,
        31.5: 11.5,
        80.5: 60.5,
        99.0: 60.5,
        100.0: 0.0,
        3701.0: 3601.0,
    }
    assert {at: path.airborne_s(at) for at in seconds} == seconds


def test_before_a_take_off_home_is_where_it_stands_and_else_the_first_one() -> None:
    path = FlightPath()
    path.add(1.0, health(5))
    where = (math.degrees(0.4), math.degrees(0.9))
    assert path.home(7.0) == (7.0, *where)
    assert (path.version, path.points()[0][0]) == ((0, False), 1.0)
    path.hear_phase(3.0, is_off_ground=True)
    assert path.version == (0, True)
    for at in (2.0, 3.0, 9.0):
        assert path.home(at) == (3.0, *where)
    assert path.points() == []
    blind = FlightPath()
    blind.hear_phase(1.0, is_off_ground=True)
    blind.add(2.0, health(5))
    assert (blind.home(5.0), len(blind.points())) == (None, 1), "it flew, nobody knows from where"
