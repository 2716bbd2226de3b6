"""Legs of a mission as a plan that the aircraft flies by itself, or why there is none."""

from __future__ import annotations

import pytest

from m100link.apps.agent.guided import FlyTo
from m100link.apps.mavlink.translator.modes import Mode
from m100link.apps.mavlink.translator.route import Leg, Unfit, flies_missions, plan_of
from m100link.missions.plan import AtEnd, Heading


def leg(number: int, yaw: float | None = None, wait: float = 0.0, height: float = 12.0) -> Leg:
    return Leg(number, FlyTo(47.0 + number * 1e-4, -8.5, height, 3.5, yaw), wait)


@pytest.mark.parametrize(
    ("then", "at_end"),
    [(Mode.HOLD, AtEnd.HOVER), (Mode.RTL, AtEnd.GO_HOME), (Mode.LAND, AtEnd.LAND)],
)
def test_places_speed_and_end(then: Mode, at_end: AtEnd) -> None:
    plan = plan_of([leg(1), leg(2, height=21.0)], then, yaw_deg=None)
    assert (plan.speed, plan.at_end, plan.heading) == (3.5, at_end, Heading.AS_AT_START)
    found = [(one.latitude_deg, one.longitude_deg, one.height) for one in plan.waypoints]
    assert found == [(47.0001, -8.5, 12.0), (47.0002, -8.5, 21.0)]
    assert plan.max_speed == 10.0, "the pilot's stick may add to it"


def test_a_heading_that_no_item_names_stays_and_turns_the_short_way() -> None:
    legs = [leg(1), leg(2, 170.0), leg(3), leg(4, -170.0), leg(5, 100.0)]
    plan = plan_of(legs, Mode.HOLD, yaw_deg=-30.0)
    assert plan.heading is Heading.BY_WAYPOINT
    assert [one.heading_deg for one in plan.waypoints] == [-30.0, 170.0, 170.0, -170.0, 100.0]
    turns = [one.turn_clockwise for one in plan.waypoints]
    assert turns == [True, False, True, True, False]


@pytest.mark.parametrize(
    ("wait", "parts"), [(0.0, 0), (5.0, 1), (32.767, 1), (33.0, 2), (100.0, 4)]
)
def test_a_wait_is_made_of_those_that_the_wire_can_say(wait: float, parts: int) -> None:
    [first, _] = plan_of([leg(1, wait=wait), leg(2)], Mode.HOLD, yaw_deg=None).waypoints
    assert len(first.actions) == parts
    assert sum(getattr(one, "seconds", 0.0) for one in first.actions) == pytest.approx(wait)


@pytest.mark.parametrize(
    ("legs", "yaw", "why"),
    [
        ([], 0.0, "no place is left"),
        ([leg(1), leg(2, 90.0)], None, "nobody knows the heading"),
        ([leg(4), leg(7, wait=9_000.0)], None, "item 7: it hovers for 9000 s"),
        ([leg(4), leg(7, height=5_000.0)], None, "item 7"),
        ([leg(4)], None, ""),
    ],
)
def test_what_the_aircraft_cannot_fly_is_told_by_its_item(
    legs: list[Leg], yaw: float | None, why: str
) -> None:
    with pytest.raises(Unfit) as caught:
        plan_of(legs, Mode.HOLD, yaw_deg=yaw)
    assert why in str(caught.value)


@pytest.mark.parametrize(("firmware", "is_one"), [("3.1", True), ("none", False)])
def test_which_firmware_flies_missions(firmware: str, is_one: bool) -> None:
    assert flies_missions(firmware) is is_one
