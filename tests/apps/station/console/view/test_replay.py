"""What the page says of a recorded flight, and that it offers nothing."""

from __future__ import annotations

from dataclasses import replace

import pytest

from m100link.apps.agent.messages import Replay, State
from m100link.apps.station.console.view.inputs import Inputs
from m100link.apps.station.console.view.replay import replay_of
from m100link.apps.station.console.view.status import Cause
from m100link.apps.station.console.view.view import view_of
from m100link.apps.station.console.view.words import Speaker

TOLD = Replay(
    name="flight.mcap",
    utc=1_767_225_600.0,
    clock=500.0,
    rate=2.0,
    position_s=65.4,
    duration_s=3725.0,
    speed=2.0,
    is_paused=False,
    is_at_end=False,
    is_cut_off=False,
)


def test_the_bar_says_what_is_played_and_where_it_is() -> None:
    shown, say = replay_of(TOLD), Speaker()
    assert shown is not None
    assert say(shown.title) == "REPLAY flight.mcap"
    assert say(shown.place) == "1:05 of 1:02:05, 2026-01-01 00:00:00 UTC"
    assert shown.note is None
    assert shown.is_running
    assert replay_of(None) is None


@pytest.mark.parametrize(
    ("changes", "note"),
    [
        ({"is_paused": True}, None),
        ({"is_at_end": True}, "at its end"),
        ({"is_at_end": True, "is_cut_off": True}, "the recording was cut off"),
    ],
)
def test_one_that_stands_says_why(changes: dict[str, bool], note: str | None) -> None:
    shown = replay_of(replace(TOLD, **changes))  # type: ignore[arg-type] # each is a bool
    assert shown is not None
    assert not shown.is_running
    assert (None if shown.note is None else Speaker()(shown.note)) == note


def test_nothing_is_offered_and_the_line_says_that_nothing_flies() -> None:
    state = State(at=10.0, connection="connected", replay=TOLD)
    view = view_of(Inputs(now=500.0, state=state))
    assert view.actions == frozenset(), "not even STOP: there is nothing to stop"
    assert view.replay is not None
    told = state.flight_time(10.5)
    assert told == 501.0, "its clock goes as fast as it is played"
    assert view.situation.is_replay
    assert view.status.cause in (Cause.REPLAY, Cause.NEVER_HEARD)
    flown = view_of(Inputs(now=500.0, state=replace(state, replay=None)))
    assert "stop" in flown.actions
    assert flown.replay is None
