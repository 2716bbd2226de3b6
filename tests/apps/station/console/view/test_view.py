"""A view holds everything that the page shows, and nothing that nobody told."""

from __future__ import annotations

from m100link.apps.agent.messages import Event
from m100link.apps.station.console.view.inputs import Inputs
from m100link.apps.station.console.view.memory import Memory
from m100link.apps.station.console.view.view import view_of
from m100link.apps.station.console.view.words import say


def test_of_nothing_known_nothing_is_shown() -> None:
    view = view_of(Inputs(now=7.0))
    assert view.at == 7.0
    assert view.instruments.attitude is None
    assert {reading.text.key for reading in view.instruments.readings.values()} == {
        "instruments.nothing"
    }
    assert all(reading.is_stale for reading in view.instruments.readings.values())
    assert view.mission.plan == say("mission.no_plan")
    assert view.events == ()


def test_events_are_as_they_came() -> None:
    events = (Event(1, 0.5, "info", "one"), Event(2, 0.6, "error", "two"))
    lines = view_of(Inputs(now=1.0, wall=1000.0, events=events)).events
    assert [(line.at, line.level, line.text) for line in lines] == [
        (999.5, "info", "one"),
        (999.6, "error", "two"),
    ]


def test_what_a_page_remembers_goes_from_one_view_to_the_next() -> None:
    memory = Memory()
    event = Event(1, 0.5, "info", "one")
    view_of(Inputs(events=(event,)), memory)
    assert len(view_of(Inputs(events=(event,)), memory).events) == 1
