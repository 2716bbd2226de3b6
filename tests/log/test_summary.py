"""Commands and their answers, who had control, and what the line lost, from a log's messages."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from mcap.writer import Writer

from m100link.log import read
from m100link.log.story import FlightSummary, read_story


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
