"""The life of one mission as a table of states and inputs.

A mission lives in the flight controller: it flies on when the program dies, and setpoints are
ignored while it runs (facts M8, M9). So from the moment before its start leaves until its end is
known, whoever ends the program's block owes the aircraft a stop.
"""

from __future__ import annotations

from enum import Enum

__all__ = ["IN_THE_AIR", "OWES_A_STOP", "TRANSITIONS", "RunInput", "RunState"]


class RunState(Enum):
    """Where a mission is in its life, as this program knows it."""

    READY = "nothing was sent that flies"
    STARTING = "the start is under way; nobody knows yet whether it flies"
    FLYING = "the aircraft flies it and ignores setpoints"
    PAUSED = "it hovers by order of the program; setpoints are ignored all the same"
    ENDING = "every waypoint was flown; it flies on to the first one, or waits for the stick"
    RETURNING = "every waypoint was flown, and the aircraft goes home or lands, as planned"
    STOPPING = "a stop is under way"
    UNSTOPPED = "the stop was not answered, or refused: it may be flying on"
    DETACHED = "the program said that it shall fly on, and looks away"
    OVER = "it does not fly any more"


class RunInput(Enum):
    """What moves a mission through its life."""

    START = "the start is about to be sent"
    STARTED = "the aircraft accepted it"
    REFUSED = "the aircraft refused it"
    PAUSED = "the aircraft accepted a pause"
    RESUMED = "the aircraft accepted that it goes on"
    STOP = "a stop is about to be sent"
    STOPPED = "the aircraft stopped it, or says that none is running"
    NOT_STOPPED = "the stop was not answered, or refused"
    FLOWN = "every waypoint was flown, and the mission goes on"
    RETURNS = "every waypoint was flown, and the aircraft goes home or lands"
    FINISHED = "the aircraft does not fly it any more, and all was well"
    BROKEN_OFF = "the aircraft broke it off"
    DETACH = "the program lets go of it"


_S, _I = RunState, RunInput

_ENDS = {_I.FINISHED: _S.OVER, _I.BROKEN_OFF: _S.OVER}
_IN_FLIGHT = {
    _I.STOP: _S.STOPPING,
    _I.FLOWN: _S.ENDING,
    _I.RETURNS: _S.RETURNING,
    _I.DETACH: _S.DETACHED,
    **_ENDS,
}

TRANSITIONS: dict[RunState, dict[RunInput, RunState]] = {
    _S.READY: {
        _I.START: _S.STARTING,
    },
    _S.STARTING: {
        _I.STARTED: _S.FLYING,
        _I.REFUSED: _S.OVER,
        # What is pushed before the ack waits for it: it may be about another mission.
        _I.STOP: _S.STOPPING,
    },
    _S.FLYING: {
        _I.PAUSED: _S.PAUSED,
        **_IN_FLIGHT,
    },
    _S.PAUSED: {
        _I.RESUMED: _S.FLYING,
        **_IN_FLIGHT,
    },
    _S.ENDING: {
        _I.STOP: _S.STOPPING,
        _I.DETACH: _S.DETACHED,
        **_ENDS,
    },
    _S.RETURNING: {
        # Asked for by name alone: leaving the block lets the aircraft land where it was to land.
        _I.STOP: _S.STOPPING,
        _I.DETACH: _S.DETACHED,
        # The mission itself is over: what is pushed about it changes nothing.
        _I.FINISHED: _S.OVER,
    },
    _S.STOPPING: {
        # What the pushes say meanwhile may be older than the stop: its answer decides.
        _I.STOPPED: _S.OVER,
        _I.NOT_STOPPED: _S.UNSTOPPED,
    },
    _S.UNSTOPPED: {
        _I.STOP: _S.STOPPING,
        _I.DETACH: _S.DETACHED,
        **_ENDS,
    },
    _S.DETACHED: {},
    _S.OVER: {},
}
"""State, input, next state. A pair that is not in the table changes nothing."""

IN_THE_AIR = frozenset(_S) - {_S.READY, _S.DETACHED, _S.OVER}
"""States in which the aircraft flies by it, as far as anybody knows."""

OWES_A_STOP = IN_THE_AIR - {_S.RETURNING}
"""States that nobody may leave behind."""
