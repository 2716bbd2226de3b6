"""Every pair of state and input of a mission, against a table written by hand with reasons."""

from __future__ import annotations

import pytest

from m100link.flight.missions.events import (
    IN_THE_AIR,
    OWES_A_STOP,
    TRANSITIONS,
    RunInput,
    RunState,
)

S, I = RunState, RunInput  # noqa: E741

STARTS = {I.START: (S.STARTING, "a stop is owed before the first byte of the start leaves")}
ENDS = {
    I.FINISHED: (S.OVER, "the aircraft says that it is over"),
    I.BROKEN_OFF: (S.OVER, "the aircraft says that it broke it off"),
}
STOPS = {I.STOP: (S.STOPPING, "it may be stopped at any moment")}
LETS_GO = {I.DETACH: (S.DETACHED, "by name only")}
FLOWN = {
    I.FLOWN: (S.ENDING, "endless, or back to the first point: it flies on"),
    I.RETURNS: (S.RETURNING, "it goes home or lands by itself"),
}

# What changes something; every other pair must change nothing.
EXPECTED: dict[RunState, dict[RunInput, tuple[RunState, str]]] = {
    S.READY: STARTS,
    S.STARTING: {
        I.STARTED: (S.FLYING, "the ack"),
        I.REFUSED: (S.OVER, "nothing flies"),
        **STOPS,
    },
    S.FLYING: {I.PAUSED: (S.PAUSED, "the ack"), **FLOWN, **ENDS, **STOPS, **LETS_GO},
    S.PAUSED: {I.RESUMED: (S.FLYING, "the ack"), **FLOWN, **ENDS, **STOPS, **LETS_GO},
    S.ENDING: {**ENDS, **STOPS, **LETS_GO},
    S.RETURNING: {
        I.FINISHED: (S.OVER, "it stands on the ground"),
        **STOPS,
        **LETS_GO,
    },
    S.STOPPING: {
        I.STOPPED: (S.OVER, "the ack, or that none is running"),
        I.NOT_STOPPED: (S.UNSTOPPED, "nobody knows"),
    },
    S.UNSTOPPED: {**ENDS, **STOPS, **LETS_GO},
    S.DETACHED: {},
    S.OVER: {},
}


@pytest.mark.parametrize("state", S, ids=lambda s: s.name)
@pytest.mark.parametrize("what", I, ids=lambda w: w.name)
def test_each_input_in_each_state_leads_where_the_reasons_say(
    state: RunState, what: RunInput
) -> None:
    expected = EXPECTED[state].get(what)
    after = TRANSITIONS[state].get(what)
    assert after == (None if expected is None else expected[0]), expected


def test_what_may_fly_owes_a_stop_except_on_its_way_home() -> None:
    assert {S.RETURNING} == IN_THE_AIR - OWES_A_STOP
    assert frozenset(S) - IN_THE_AIR == {S.READY, S.DETACHED, S.OVER}


def test_every_state_that_owes_a_stop_can_be_stopped() -> None:
    for state in OWES_A_STOP - {S.STOPPING}:
        assert TRANSITIONS[state][I.STOP] is S.STOPPING
