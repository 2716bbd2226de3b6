"""The events of a waypoint mission, from its pushes and with losses among them."""

from __future__ import annotations

import random
from typing import Any

import pytest

from m100link import AtEnd
from m100link.flight.missions.context import Over, WaypointTracker
from m100link.flight.missions.events import Aborted, ActionsDone, Finished, Reached
from m100link.protocol.codes import MissionCode
from m100link.protocol.commands import missions as wire
from m100link.protocol.commands.waypoint import WaypointMission, WaypointMissionAnswer
from tests.flight.missions.foreign import plan


def status(index: int) -> wire.MissionStatus:
    return wire.MissionStatus(wire.WaypointStatus(index, status=1))


def idle(flags: int = 0, reason: int = 0) -> wire.MissionStatus:
    return wire.MissionStatus(wire.IdleStatus(1, flags, reason))


def reached(index: int, status: int = 4) -> wire.WaypointEvent:
    return wire.WaypointEvent(wire.Reached(index, status))


FINISHED = wire.WaypointEvent(wire.Finished())


def told(track: WaypointTracker, *pushes: wire.MissionStatus | wire.WaypointEvent) -> list[Any]:
    return [news for push in pushes for news in track.take(push)]


def flight(points: int = 4) -> list[wire.MissionStatus | wire.WaypointEvent]:
    """What an aircraft pushes on its way."""
    pushes: list[wire.MissionStatus | wire.WaypointEvent] = []
    for index in range(points):
        pushes += [status(index)] * 3
        pushes += [reached(index), status(index), reached(index, 6)]
    return [*pushes, FINISHED, idle(), idle()]


def test_each_waypoint_is_reported_once_and_in_order() -> None:
    news = told(WaypointTracker(plan()), *flight())
    assert [n for n in news if isinstance(n, Reached)] == [Reached(i) for i in range(4)]
    assert [n for n in news if isinstance(n, ActionsDone)] == [ActionsDone(i) for i in range(4)]
    assert news.index(Finished()) == len(news) - 1 - news[::-1].index(Finished())
    assert isinstance(news[-1], Over)


@pytest.mark.parametrize("seed", range(50))
def test_events_that_are_lost_are_made_up_for_by_the_status(seed: int) -> None:
    chance = random.Random(seed)
    pushes = [push for push in flight() if chance.random() > 0.4]
    news = told(WaypointTracker(plan()), *pushes, status(3), idle())
    assert [n.index for n in news if isinstance(n, Reached)] == [0, 1, 2, 3]
    assert sum(isinstance(n, Finished) for n in news) == 1
    assert isinstance(news[-1], Over)


def test_no_mission_before_ours_was_seen_says_nothing() -> None:
    assert told(WaypointTracker(plan()), idle(), idle(1, 0xD0)) == []


def test_no_mission_behind_ours_is_its_end() -> None:
    news = told(WaypointTracker(plan()), status(0), idle())
    assert isinstance(news[-2], Finished)
    assert isinstance(news[-1], Over)


def test_one_that_was_broken_off_is_reported_with_the_reason_and_the_waypoint() -> None:
    news = told(WaypointTracker(plan()), status(2), idle(1, 0xD9))
    assert news[-1] == Aborted(0xD9, MissionCode(0xD9).meaning, 2)
    news = told(WaypointTracker(plan()), status(1), idle(1, 0))
    assert isinstance(news[-1], Aborted)
    assert "remote controller" in news[-1].reason


def test_another_kind_of_mission_is_the_end_of_ours() -> None:
    hotpoint = wire.MissionStatus(wire.HotpointStatus(1))
    [news] = told(WaypointTracker(plan()), status(1), hotpoint)[-1:]
    assert isinstance(news, Aborted)


def test_a_way_that_is_flown_twice_is_reported_twice_and_ended_by_the_status_alone() -> None:
    once = flight()[:-2]
    track = WaypointTracker(plan(repeat=2))
    news = told(track, *once)
    assert not [n for n in news if isinstance(n, Finished | Over)], "one run is to come"
    news = told(track, *once, idle())
    assert [n.index for n in news if isinstance(n, Reached)] == [0, 1, 2, 3]
    assert sum(isinstance(n, Finished) for n in news) == 1
    assert isinstance(news[-1], Over)


@pytest.mark.parametrize("at_end", [AtEnd.FIRST_POINT, AtEnd.ENDLESS])
def test_behind_an_end_that_flies_on_it_is_not_over(at_end: AtEnd) -> None:
    track = WaypointTracker(plan(at_end=at_end))
    assert not [n for n in told(track, *flight()[:-2]) if isinstance(n, Over)]
    assert isinstance(told(track, idle())[-1], Over)


def test_what_the_aircraft_has_stored_tells_the_end_where_nothing_is_pushed() -> None:
    track = WaypointTracker(plan())

    def answer(code: int, count: int) -> WaypointMissionAnswer:
        mission = WaypointMission(count=count, max_speed=10.0, idle_speed=5.0)
        return WaypointMissionAnswer(MissionCode(code), mission)

    assert track.polled(answer(0, 4)) == []
    assert track.polled(answer(0xD1, 0)) == [], "a refusal says nothing"
    assert isinstance(track.polled(answer(0, 0))[-1], Over)
    assert isinstance(WaypointTracker(plan()).polled(answer(0xEA, 0))[-1], Over)


def test_an_index_that_no_plan_has_is_not_believed() -> None:
    assert told(WaypointTracker(plan()), reached(200), status(255)) == []


def test_finished_far_from_the_last_waypoint_is_that_of_a_mission_before() -> None:
    assert told(WaypointTracker(plan()), FINISHED, idle()) == []
    track = WaypointTracker(plan())
    assert told(track, status(1), FINISHED, status(1), FINISHED) == []
    assert Finished() in told(track, status(3), FINISHED, FINISHED)


def test_an_event_of_before_does_not_make_an_old_status_the_end() -> None:
    assert told(WaypointTracker(plan()), reached(3, 6), idle()) == [
        *(Reached(index, is_inferred=True) for index in range(3)),
        Reached(3),
        ActionsDone(3),
    ]
