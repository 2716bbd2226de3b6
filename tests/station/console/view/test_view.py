"""A view holds everything that the page shows, and nothing that nobody told."""

from __future__ import annotations

from m100link.agent.messages import Event
from m100link.station.console.view.inputs import Inputs
from m100link.station.console.view.view import view_of


def test_of_nothing_known_nothing_is_shown() -> None:
    view = view_of(Inputs(now=7.0))
    assert view.at == 7.0
    assert view.instruments.attitude is None
    assert {reading.text for reading in view.instruments.readings.values()} == {"–"}
    assert all(reading.is_stale for reading in view.instruments.readings.values())
    assert view.mission.plan == "no plan"
    assert view.events == ()


def test_events_are_as_they_came() -> None:
    events = (Event(1, 0.5, "info", "one"), Event(2, 0.6, "error", "two"))
    assert view_of(Inputs(events=events)).events == events
