"""The journal: events are numbered, bounded and told."""

from __future__ import annotations

from m100link.apps.agent.messages import Event, Journal, Topic


def test_events_are_numbered_told_and_bounded() -> None:
    now = 0.0
    journal = Journal(lambda: now)
    told: list[Event] = []
    journal.on_event.append(told.append)
    for number in range(1000):
        now = float(number)
        journal.note(f"event {number}", "warning" if number % 2 else "info")
    assert len(told) == 1000
    assert told[0] == Event(1, 0.0, "info", "event 0")
    assert list(journal.events) == told[-len(journal.events) :]
    assert len(journal.events) == 200


def test_what_a_program_has_to_know_has_a_topic() -> None:
    journal = Journal(lambda: 0.0)
    journal.note("the aircraft broke the mission off: battery", "warning", Topic.MISSION_ABORTED)
    journal.note("take off begins")
    assert [one.topic for one in journal.events] == [Topic.MISSION_ABORTED, Topic.NONE]
