"""Which mission flies, as the pushes tell, and for how long one is believed."""

from __future__ import annotations

import random

import pytest

from m100link import MissionKind
from m100link.flight.mission_state import BELIEVED_S, MissionState, MissionWatch
from m100link.protocol.commands import missions as wire


class Time:
    now = 100.0


def watch() -> tuple[MissionWatch, type[Time]]:
    Time.now = 100.0
    return MissionWatch(lambda: Time.now), Time


def told(kind: MissionKind) -> wire.MissionStatus:
    statuses: dict[MissionKind, wire.Status] = {
        MissionKind.NONE: wire.IdleStatus(),
        MissionKind.WAYPOINT: wire.WaypointStatus(3, status=1),
        MissionKind.HOTPOINT: wire.HotpointStatus(1, radius_cm=1000),
        MissionKind.FOLLOW: wire.FollowStatus(),
        MissionKind.IOC: wire.IocStatus(),
    }
    return wire.MissionStatus(statuses[kind])


def test_before_any_push_nobody_knows() -> None:
    found, _ = watch()
    assert found.state == MissionState()
    assert found.state.kind is MissionKind.UNKNOWN
    assert not found.state.is_running


@pytest.mark.parametrize("kind", [kind for kind in MissionKind if kind is not MissionKind.UNKNOWN])
def test_each_kind_is_reported_and_only_missions_run(kind: MissionKind) -> None:
    found, time = watch()
    found.on_status(told(kind), time.now)
    time.now += 1.0
    found.on_status(told(kind), time.now)
    assert found.state.kind is kind
    assert found.state.since == 100.0
    runs = kind in (MissionKind.WAYPOINT, MissionKind.HOTPOINT, MissionKind.FOLLOW)
    assert found.state.is_running is runs
    assert found.state.index == (3 if kind is MissionKind.WAYPOINT else None)


def test_a_push_that_is_old_is_not_believed_any_more() -> None:
    found, time = watch()
    found.on_status(told(MissionKind.WAYPOINT), time.now)
    time.now += BELIEVED_S
    assert (found.state.is_running, found.flying) == (True, (MissionKind.WAYPOINT,))
    time.now += 0.1
    assert (found.state.is_running, found.flying) == (False, ())


def test_late_pushes_of_a_mission_that_has_ended_are_not_a_new_one() -> None:
    found, time = watch()
    found.on_status(told(MissionKind.WAYPOINT), time.now)
    found.ended(MissionKind.WAYPOINT, is_echoing=True)
    found.on_status(told(MissionKind.WAYPOINT), time.now)
    assert not found.state.is_running
    found.on_status(told(MissionKind.HOTPOINT), time.now)
    assert found.state.kind is MissionKind.HOTPOINT
    found.ended(MissionKind.HOTPOINT, is_echoing=True)
    time.now += 1.5
    found.on_status(told(MissionKind.HOTPOINT), time.now)
    assert found.state.is_running, "it goes on, whatever was said"


def test_a_kind_is_reported_since_its_first_push_whatever_others_say_between() -> None:
    found, time = watch()
    for kind in (MissionKind.WAYPOINT, MissionKind.NONE, MissionKind.WAYPOINT):
        found.on_status(told(kind), time.now)
        time.now += BELIEVED_S
    assert found.state.since == found.reported_since(MissionKind.WAYPOINT) == 100.0 + 2 * BELIEVED_S
    time.now -= BELIEVED_S
    for _ in range(3):
        time.now += 0.5 * BELIEVED_S
        found.on_status(told(MissionKind.HOTPOINT), time.now)
        found.on_status(told(MissionKind.WAYPOINT), time.now)
    assert found.reported_since(MissionKind.WAYPOINT) == 100.0 + 2 * BELIEVED_S
    assert found.reported_since(MissionKind.FOLLOW) is None
    time.now += BELIEVED_S + 0.1
    assert found.reported_since(MissionKind.HOTPOINT) is None


def test_what_is_pushed_behind_a_push_that_ended_a_mission_is_no_late_one() -> None:
    found, time = watch()
    found.on_status(told(MissionKind.WAYPOINT), time.now)
    found.on_status(told(MissionKind.NONE), time.now)
    found.ended(MissionKind.WAYPOINT, is_echoing=False)
    assert found.reported_since(MissionKind.WAYPOINT) is None
    time.now += 0.1
    found.on_status(told(MissionKind.WAYPOINT), time.now)
    assert found.state.is_running
    assert found.state.since == time.now


@pytest.mark.parametrize("seed", range(8))
def test_what_flies_by_the_pushes_may_fly_and_what_was_claimed_may_for_good(seed: int) -> None:
    """Pushes, silence and ends by chance; the setpoints of a program ask that one value."""
    chance = random.Random(seed)
    found, time = watch()
    assert not found.may_fly
    seen = set()
    for step in range(400):
        kind = chance.choice([one for one in MissionKind if one is not MissionKind.UNKNOWN])
        if chance.random() < 0.6:
            kind = MissionKind.NONE
        if chance.random() < 0.1:
            found.ended(kind, is_echoing=chance.random() < 0.5)
        else:
            found.on_status(told(kind), time.now)
        assert found.may_fly or not found.flying, (seed, step)
        seen.add(found.may_fly)
        time.now += chance.choice((0.0, 0.1, 0.1, 1.0, 4.0))
        assert found.may_fly or not found.flying, (seed, step)
    assert seen == {True, False}
    found.claim()
    time.now += 2 * BELIEVED_S
    found.on_status(told(MissionKind.NONE), time.now)
    assert found.may_fly, "nobody tells of it yet"


def test_a_kind_that_nobody_knows_changes_nothing() -> None:
    found, time = watch()
    found.on_status(told(MissionKind.FOLLOW), time.now)
    found.on_status(wire.MissionStatus(wire.OtherKind(9, bytes(5))), time.now)
    assert found.state.kind is MissionKind.FOLLOW
