"""Every pair of state and input of a mission, against a table written by hand with reasons."""

from __future__ import annotations

import asyncio
import itertools
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any, cast

import pytest

from m100link.errors import M100Error, MissionAborted, UsageError
from m100link.flight.mission_state import MissionKind, MissionWatch
from m100link.flight.missions.context import Over
from m100link.flight.missions.events import (
    IN_THE_AIR,
    OWES_A_STOP,
    TRANSITIONS,
    Aborted,
    Events,
    Finished,
    MissionProgress,
    Reached,
    RunInput,
    RunState,
)
from m100link.flight.missions.mission_session import MissionSession
from m100link.protocol.commands.missions import MissionStatus, WaypointStatus

pytestmark = pytest.mark.anyio

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
    S.READY: {**STARTS, I.STOP: (S.OVER, "nothing flies, and nothing is to begin")},
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


# -- what the aircraft tells of it, in each state --------------------------------------------------


def mission(
    state: RunState,
    *,
    ends_by_landing: bool = False,
    clock: Callable[[], float] = lambda: 100.0,
    slack_s: float = 0.0,
) -> MissionSession:
    """A waypoint mission in that state, which takes as news what it is pushed."""
    link = SimpleNamespace(
        loop=SimpleNamespace(time=clock), latency=SimpleNamespace(slack_s=slack_s)
    )
    commander = SimpleNamespace(missions=MissionWatch(clock), link=link)
    block = SimpleNamespace(require_flying=lambda what: None)
    context = SimpleNamespace(commander=commander, block=block)
    track = SimpleNamespace(ends_by_landing=ends_by_landing, take=lambda push: [push], poll=None)
    found = MissionSession(cast(Any, context), MissionKind.WAYPOINT, cast(Any, track))
    found.state = state
    return found


DONE = (S.FLYING, S.PAUSED, S.UNSTOPPED, S.ENDING)
"""States in which an end that the aircraft tells is one."""


@pytest.mark.parametrize("state", S, ids=lambda s: s.name)
def test_what_is_told_in_each_state(state: RunState) -> None:
    told = (Over(), Aborted(0xF3, "why", 2), Finished(), Reached(1))
    for news, ends_by_landing in itertools.product(told, (True, False)):
        one = mission(state, ends_by_landing=ends_by_landing)
        one._on_push(cast(Any, news))
        is_end = isinstance(news, Over | Aborted)
        after = state
        if is_end and state in DONE:
            after = S.OVER
        elif isinstance(news, Finished) and state in (S.FLYING, S.PAUSED):
            after = S.RETURNING if ends_by_landing else S.ENDING
        assert one.state is after, news
        # During a start it waits for the answer, and a stop tells its end by itself.
        is_told = state in IN_THE_AIR - {S.STARTING, S.STOPPING} and not isinstance(news, Over)
        is_told = is_told and (state in DONE or not isinstance(news, Aborted))
        assert list(one.events._waiting) == [news] * is_told, news
        assert one.events.is_over is (is_end and state in DONE), news
        failure = one.events.failure
        if isinstance(news, Aborted) and state in DONE:
            assert isinstance(failure, MissionAborted)
            assert (failure.code, failure.index, failure.mission) == (0xF3, 2, "waypoint mission")
            assert "on the way to waypoint 2: why" in failure.seen
        else:
            assert failure is None, news
        assert one._early == [news] * (state is S.STARTING)
        assert one._is_seen_over is (state is S.STOPPING and is_end), news


@pytest.mark.parametrize("slack_s", [0.0, 0.5])
async def test_pushes_behind_an_end_are_waited_for_and_contradict_it(slack_s: float) -> None:
    """For 1.3 s and within 3 s of it, on a slow line for so much longer; where any are pushed."""
    clock = asyncio.get_running_loop().time
    silent = mission(S.OVER, clock=clock, slack_s=slack_s)
    silent.ending.tell()
    await silent.ending.require_over()
    assert clock() == silent.ending.over_at
    flying = MissionStatus(WaypointStatus(0, status=1))
    for since, flies_on in ((2.9, True), (3.1, False)):
        one = mission(S.OVER, clock=clock, slack_s=slack_s)
        watch = one._context.commander.missions
        watch.on_status(flying, clock())
        assert not one.flies_all_the_same, "it never began: somebody else's"
        one.ending.tell()
        await one.ending.require_over()
        assert clock() - one.ending.over_at == pytest.approx(1.3 + slack_s, abs=0.03)
        watch._reported.clear()
        await asyncio.sleep(one.ending.over_at + since + slack_s - clock())
        watch.on_status(flying, clock())
        assert one.flies_all_the_same is flies_on


async def test_of_progress_that_nobody_takes_the_newest_stays_and_all_else_does() -> None:
    """A program that takes none for an hour would be held an hour of events."""
    events = Events()
    for number in range(3):
        events.add(MissionProgress(float(number)))
        events.add(Reached(number))
    events.end()
    taken = [await events.take() for _ in range(5)]
    assert taken == [Reached(0), Reached(1), MissionProgress(2.0), Reached(2), None]


@pytest.mark.parametrize("state", S, ids=lambda s: s.name)
async def test_a_source_of_targets_that_ended_stops_what_owes_a_stop(state: RunState) -> None:
    one, sent = mission(state), list[str]()

    async def stop() -> None:
        sent.append("stop")
        raise M100Error("not answered")

    one.stop = stop  # type: ignore[method-assign]
    why = M100Error("the source failed")
    await one.end_by_program(why)
    owes = state in OWES_A_STOP
    assert (sent, one.events.failure) == (["stop"] * owes, why if owes else None)
    quiet = mission(state)
    quiet.stop = stop  # type: ignore[method-assign]
    await quiet.end_by_program(None)
    assert getattr(quiet.events.failure, "seen", None) == ("not answered" if owes else None)


@pytest.mark.parametrize("state", S, ids=lambda s: s.name)
def test_it_is_let_go_where_it_flies_and_nothing_is_under_way(state: RunState) -> None:
    one = mission(state)
    if I.DETACH in EXPECTED[state]:
        one.detach()
        assert (one.state, one.events.is_over, one.events.failure) == (S.DETACHED, True, None)
        return
    why = "cannot be detached" if state in IN_THE_AIR else "to be detached was asked for, but"
    with pytest.raises(UsageError, match=why):
        one.detach()
    assert (one.state, one.events.is_over) == (state, False)
