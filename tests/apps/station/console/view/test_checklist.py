"""Before take-off: what is right, what is needed, and when take-off is offered."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from m100link.apps.agent.messages import Limits
from m100link.apps.station.console.view.catalogue import CATALOGUE
from m100link.apps.station.console.view.checklist import (
    ENOUGH_BATTERY,
    ITEMS,
    Check,
    Checklist,
    ChecklistDesk,
    Item,
    ItemState,
)
from m100link.apps.station.console.view.situation import Hearing, Situation
from m100link.apps.station.console.view.words import Speaker
from m100link.protocol.records import FlightPhase, RcMode
from m100link.sim.vehicle.missions.route import MissionSettings

READY = Situation(
    now=100.0,
    telemetry_at=99.9,
    is_activated=True,
    has_lease=True,
    has_authority=True,
    holder="tab",
    round_trip=0.03,
    page_trip=0.01,
    switch=RcMode.F,
    phase=FlightPhase.STANDBY,
    battery=90,
    gps=5,
    place=(22.5, 113.9),
    limits=Limits(50.0, 150.0, 10.0, 20),
)


def looked(**known: Any) -> Checklist:
    """The list of an operator who looked around."""
    desk = ChecklistDesk()
    desk.say_free(READY.now, is_free=True)
    return desk.look(replace(READY, **known))


def check(checklist: Checklist, item: Item) -> Check:
    return next(one for one in checklist.checks if one.item is item)


def test_when_everything_is_right_take_off_is_offered() -> None:
    checklist = looked()
    assert [one.item for one in checklist.checks] == list(Item)
    assert checklist.missing == ()
    assert checklist.is_green
    assert checklist.may_take_off
    assert all(one.remedy is None for one in checklist.checks)


R, W, U = ItemState.RIGHT, ItemState.WRONG, ItemState.UNKNOWN

CASES: list[tuple[Item, dict[str, Any], ItemState, str]] = [
    (Item.LINE, {"connection": "lost"}, W, "not connected"),
    (Item.LINE, {"hearing": Hearing.SILENT}, W, "not connected"),
    (Item.LINE, {"telemetry_at": None}, W, "not connected"),
    (Item.LINE, {"telemetry_at": 98.0}, W, "the aircraft is silent"),
    (Item.QUALITY, {"round_trip": None}, U, "unknown"),
    (Item.QUALITY, {"page_trip": None}, U, "unknown"),
    (Item.QUALITY, {"round_trip": 0.5}, W, "500 ms to the aircraft, 10 ms to this page"),
    (Item.QUALITY, {"page_trip": 0.6}, W, "30 ms to the aircraft, 600 ms to this page"),
    (Item.ACTIVATION, {"is_activated": False}, W, "not activated"),
    (Item.GROUND, {"phase": FlightPhase.IN_AIR}, W, "it flies already"),
    (Item.GROUND, {"phase": None}, U, "unknown"),
    (Item.SWITCH, {"switch": RcMode.P}, W, "in P"),
    (Item.SWITCH, {"switch": None}, U, "unknown"),
    (Item.CONTROL, {"has_authority": False}, W, "not obtained"),
    (Item.CONTROL, {"has_lease": False, "holder": "Anna"}, W, "Anna has control"),
    (Item.GPS, {"gps": 2}, W, "2 of 5"),
    (Item.GPS, {"gps": None}, U, "unknown"),
    (Item.HOME, {"place": None}, U, "unknown"),
    (Item.BATTERY, {"battery": ENOUGH_BATTERY}, W, "30 %"),
    (Item.BATTERY, {"battery": None}, U, "unknown"),
    (Item.GUARDS, {"limits": Limits()}, W, "not all are on"),
    (Item.GUARDS, {"limits": Limits(50.0, None, 10.0, 20)}, W, "not all are on"),
]


@pytest.mark.parametrize(("item", "known", "state", "seen"), CASES)
def test_what_is_not_right_says_what_was_seen_and_how_to_mend_it(
    item: Item, known: dict[str, Any], state: ItemState, seen: str
) -> None:
    checklist = looked(**known)
    one = check(checklist, item)
    assert (one.state, Speaker()(one.seen)) == (state, seen)
    assert one.remedy is not None
    assert Speaker()(one.remedy)
    assert one in checklist.missing
    assert not checklist.is_green
    assert not checklist.may_take_off


def test_every_item_has_a_name_a_remedy_and_a_case() -> None:
    for item in Item:
        assert f"checklist.{item.value}" in CATALOGUE
        assert f"checklist.{item.value}.remedy" in CATALOGUE
    assert {item for item, *_ in CASES} == set(Item) - {Item.FREE}


@pytest.mark.parametrize(("item", "known", "state", "seen"), CASES)
def test_a_reason_offers_take_off_unless_the_aircraft_would_refuse(
    item: Item, known: dict[str, Any], state: ItemState, seen: str
) -> None:
    desk = ChecklistDesk()
    desk.say_free(READY.now, is_free=True)
    desk.say_why("a test of the floor")
    checklist = desk.look(replace(READY, **known))
    needs = {Item.LINE, Item.ACTIVATION, Item.CONTROL}
    # In the air no reason holds: it was said for another take-off.
    assert checklist.may_take_off == (
        item not in needs and known.get("phase") is not FlightPhase.IN_AIR
    )
    assert {one for one, is_needed in ITEMS.items() if is_needed} == needs


@pytest.mark.parametrize(
    ("reason", "counts"), [("", False), ("  a ", False), ("hm", False), ("fog", True)]
)
def test_a_reason_is_more_than_a_key_that_was_hit(reason: str, counts: bool) -> None:
    desk = ChecklistDesk()
    desk.say_why(reason)
    assert desk.look(READY).may_take_off is counts


def test_a_reason_is_one_line_and_short() -> None:
    desk = ChecklistDesk()
    desk.say_why("so\nit\tis " * 100)
    reason = desk.look(READY).reason
    assert reason.startswith("so it is so")
    assert len(reason) == 200


def test_that_the_place_is_free_is_said_by_the_operator_and_holds_for_a_while() -> None:
    desk = ChecklistDesk()
    assert check(desk.look(READY), Item.FREE).state is W
    desk.say_free(READY.now, is_free=True)
    at = READY.now + 5 * 60.0  # the page and the manual say five minutes
    later = replace(READY, now=at, telemetry_at=at)
    assert desk.look(later).is_green
    assert not desk.look(replace(later, now=later.now + 0.5)).is_free_said
    desk.say_free(later.now, is_free=True)
    desk.say_free(later.now, is_free=False)
    assert not desk.look(later).is_free_said


def test_a_flight_ends_what_was_said() -> None:
    desk = ChecklistDesk()
    desk.say_free(READY.now, is_free=True)
    desk.say_why("a test")
    desk.look(replace(READY, phase=FlightPhase.TAKING_OFF))
    after = desk.look(READY)
    assert (after.is_free_said, after.reason) == (False, "")


def test_an_item_that_did_not_come_for_a_moment_ends_nothing() -> None:
    desk = ChecklistDesk()
    desk.say_free(READY.now, is_free=True)
    desk.look(replace(READY, phase=None))
    assert desk.look(READY).may_take_off


def test_enough_is_what_a_mission_needs() -> None:
    assert MissionSettings().least_battery_percent == ENOUGH_BATTERY
