"""Before take-off: what is right, what is needed, and when take-off is offered."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import anyio
import pytest

from m100link.apps.agent.client import Hearing
from m100link.apps.agent.messages import GuardLimits, LeaseChanged, RemoteError, State
from m100link.apps.agent.orders import GuidedFlight
from m100link.apps.station.console.view.fly import (
    ACTIONS,
    CAMERA,
    ENOUGH_BATTERY,
    FIELDS,
    FLIGHTS,
    FREE_FOR_S,
    FROM_GROUND,
    HELD,
    ITEMS,
    MISSIONS,
    Check,
    Checklist,
    ChecklistItem,
    ChecklistModel,
    FieldSpec,
    ItemState,
    actions_of,
    instruments_of,
    live,
)
from m100link.apps.station.console.view.situation import (
    Inputs,
    Situation,
    situation_of,
)
from m100link.apps.station.console.view.texts import (
    Language,
    LengthUnit,
    SpeedUnit,
    Translator,
    Units,
    translations,
)
from m100link.protocol.codes import ActivationCode
from m100link.protocol.records import (
    Attitude,
    ControlDevice,
    Device,
    FlightPhase,
    FlightStatus,
    RcMode,
)
from m100link.sim.vehicle.missions.route import MissionSettings
from m100link.telemetry.state import AircraftState
from tests.apps.station.conftest import Rig
from tests.known import seen

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
    limits=GuardLimits(50.0, 150.0, 10.0, 20),
)


def looked(**known: Any) -> Checklist:
    """The list of an operator who looked around."""
    model = ChecklistModel()
    model.say_free(READY.now, is_free=True)
    return model.look(replace(READY, **known))


def check(checklist: Checklist, item: ChecklistItem) -> Check:
    return next(one for one in checklist.checks if one.item is item)


def test_when_everything_is_right_take_off_is_offered() -> None:
    checklist = looked()
    assert [one.item for one in checklist.checks] == list(ChecklistItem)
    assert checklist.missing == ()
    assert checklist.is_green
    assert checklist.may_take_off
    assert all(one.remedy is None for one in checklist.checks)


R, W, U = ItemState.RIGHT, ItemState.WRONG, ItemState.UNKNOWN

CASES: list[tuple[ChecklistItem, dict[str, Any], ItemState, str]] = [
    (ChecklistItem.LINE, {"connection": "lost"}, W, "not connected"),
    (ChecklistItem.LINE, {"hearing": Hearing.SILENT}, W, "not connected"),
    (ChecklistItem.LINE, {"telemetry_at": None}, W, "not connected"),
    (ChecklistItem.LINE, {"telemetry_at": 98.0}, W, "the aircraft is silent"),
    (ChecklistItem.QUALITY, {"round_trip": None}, U, "unknown"),
    (ChecklistItem.QUALITY, {"page_trip": None}, U, "unknown"),
    (ChecklistItem.QUALITY, {"round_trip": 0.5}, W, "500 ms to the aircraft, 10 ms to this page"),
    (ChecklistItem.QUALITY, {"page_trip": 0.6}, W, "30 ms to the aircraft, 600 ms to this page"),
    (ChecklistItem.ACTIVATION, {"is_activated": False}, W, "not activated"),
    (ChecklistItem.GROUND, {"phase": FlightPhase.IN_AIR}, W, "already flying"),
    (ChecklistItem.GROUND, {"phase": None}, U, "unknown"),
    (ChecklistItem.SWITCH, {"switch": RcMode.P}, W, "in P"),
    (ChecklistItem.SWITCH, {"switch": None}, U, "unknown"),
    (ChecklistItem.CONTROL, {"has_authority": False}, W, "not obtained"),
    (ChecklistItem.CONTROL, {"has_lease": False, "holder": "Anna"}, W, "Anna has control"),
    (ChecklistItem.GPS, {"gps": 2}, W, "2 of 5"),
    (ChecklistItem.GPS, {"gps": None}, U, "unknown"),
    (ChecklistItem.HOME, {"place": None}, U, "unknown"),
    (ChecklistItem.BATTERY, {"battery": ENOUGH_BATTERY}, W, "30 %"),
    (ChecklistItem.BATTERY, {"battery": None}, U, "unknown"),
    (ChecklistItem.GUARDS, {"limits": GuardLimits()}, W, "not all are on"),
    (ChecklistItem.GUARDS, {"limits": GuardLimits(50.0, None, 10.0, 20)}, W, "not all are on"),
]


@pytest.mark.parametrize(("item", "known", "state", "seen"), CASES)
def test_what_is_not_right_says_what_was_seen_and_how_to_mend_it(
    item: ChecklistItem, known: dict[str, Any], state: ItemState, seen: str
) -> None:
    checklist = looked(**known)
    one = check(checklist, item)
    assert (one.state, Translator()(one.seen)) == (state, seen)
    assert one.remedy is not None
    assert Translator()(one.remedy)
    assert one in checklist.missing
    assert not checklist.is_green
    assert not checklist.may_take_off


def test_every_item_has_a_name_a_remedy_and_a_case() -> None:
    for item in ChecklistItem:
        assert f"checklist.{item.value}" in translations()
        assert f"checklist.{item.value}.remedy" in translations()
    assert {item for item, *_ in CASES} == set(ChecklistItem) - {ChecklistItem.FREE}


@pytest.mark.parametrize(("item", "known", "state", "seen"), CASES)
def test_a_reason_offers_take_off_unless_the_aircraft_would_refuse(
    item: ChecklistItem, known: dict[str, Any], state: ItemState, seen: str
) -> None:
    model = ChecklistModel()
    model.say_free(READY.now, is_free=True)
    model.say_why("a test of the floor")
    checklist = model.look(replace(READY, **known))
    needs = {ChecklistItem.LINE, ChecklistItem.ACTIVATION, ChecklistItem.CONTROL}
    # In the air no reason holds: it was said for another take-off.
    assert checklist.may_take_off == (
        item not in needs and known.get("phase") is not FlightPhase.IN_AIR
    )
    assert {one for one, is_needed in ITEMS.items() if is_needed} == needs


@pytest.mark.parametrize(
    ("reason", "counts"), [("", False), ("  a ", False), ("hm", False), ("fog", True)]
)
def test_a_reason_is_more_than_a_key_that_was_hit(reason: str, counts: bool) -> None:
    model = ChecklistModel()
    model.say_why(reason)
    assert model.look(READY).may_take_off is counts


def test_a_reason_is_one_line_and_short() -> None:
    model = ChecklistModel()
    model.say_why("so\nit\tis " * 100)
    reason = model.look(READY).reason
    assert reason.startswith("so it is so")
    assert len(reason) == 200


def test_that_the_place_is_free_is_said_by_the_operator_and_holds_for_a_while() -> None:
    model = ChecklistModel()
    assert check(model.look(READY), ChecklistItem.FREE).state is W
    model.say_free(READY.now, is_free=True)
    later = replace(READY, now=READY.now + FREE_FOR_S, telemetry_at=READY.now + FREE_FOR_S)
    assert model.look(later).is_green
    assert not model.look(replace(later, now=later.now + 0.5)).is_free_said
    model.say_free(later.now, is_free=True)
    model.say_free(later.now, is_free=False)
    assert not model.look(later).is_free_said


def test_a_flight_ends_what_was_said() -> None:
    model = ChecklistModel()
    model.say_free(READY.now, is_free=True)
    model.say_why("a test")
    model.look(replace(READY, phase=FlightPhase.TAKING_OFF))
    after = model.look(READY)
    assert (after.is_free_said, after.reason) == (False, "")


def test_an_item_that_did_not_come_for_a_moment_ends_nothing() -> None:
    model = ChecklistModel()
    model.say_free(READY.now, is_free=True)
    model.look(replace(READY, phase=None))
    assert model.look(READY).may_take_off


def test_enough_is_what_a_mission_needs() -> None:
    assert MissionSettings().least_battery_percent == ENOUGH_BATTERY


# -- which buttons can be pressed in which state ---------------------------------------------------

MINE, NOBODY = LeaseChanged(3, "tab"), LeaseChanged(0, "")
KEPT = {"release", "mission_upload"}


def look(inputs: Inputs, *, has_reason: bool) -> Checklist:
    """The list of an operator who has a reason for everything, or none."""
    model = ChecklistModel()
    model.say_why("a test" * has_reason)
    ready = replace(
        situation_of(inputs),
        is_activated=True,
        telemetry_at=inputs.vehicle.now,
        phase=FlightPhase.STANDBY,
    )
    return model.look(ready)


def offered_of(inputs: Inputs) -> frozenset[str]:
    """What is offered to an operator who has a reason for everything."""
    return actions_of(inputs, situation_of(inputs), look(inputs, has_reason=True))


def inputs_of(
    *, is_mine: bool, obeyed: bool, task: str = "", mission: str = "", is_silent: bool = False
) -> Inputs:
    state = State(0.0, "connected", has_authority=obeyed, task=task, mission=mission)
    return Inputs(
        vehicle=seen(None, state=state, holder=MINE, heard_at=-9.0 if is_silent else 0.0),
        has_lease=is_mine,
    )


@pytest.mark.parametrize(
    ("inputs", "offered"),
    [
        (Inputs(vehicle=seen(None, state=State(at=0.0))), set()),
        (inputs_of(is_mine=False, obeyed=True), {"obtain"}),
        (inputs_of(is_mine=True, obeyed=False), {"obtain", *KEPT}),
        (inputs_of(is_mine=True, obeyed=True), {*KEPT, *FLIGHTS}),
        (
            inputs_of(is_mine=True, obeyed=True, mission="no mission"),
            {*KEPT, *FLIGHTS},
        ),
        (inputs_of(is_mine=True, obeyed=True, task="landing"), {*KEPT}),
        (
            inputs_of(is_mine=True, obeyed=True, mission="hotpoint"),
            {*KEPT, *MISSIONS, "pause"},
        ),
        (inputs_of(is_mine=True, obeyed=True, is_silent=True), {*KEPT}),
    ],
)
def test_what_is_offered(inputs: Inputs, offered: set[str]) -> None:
    actions = offered_of(inputs)
    assert actions == {"stop", *offered}
    assert actions <= ACTIONS


FLIES = replace(
    situation_of(Inputs(vehicle=seen(None, state=State(at=0.0)))), phase=FlightPhase.IN_AIR
)


@pytest.mark.parametrize(
    ("now", "has_reason", "leaves"),
    [
        (replace(FLIES, phase=FlightPhase.STANDBY), False, False),
        (replace(FLIES, phase=FlightPhase.STANDBY), True, True),
        (replace(FLIES, phase=None), False, False),  # nobody knows: it counts as standing
        (FLIES, False, True),  # a mission or a task that begins in flight
    ],
)
def test_what_leaves_the_ground_is_offered_by_the_checklist(
    now: Situation, has_reason: bool, leaves: bool
) -> None:
    inputs = inputs_of(is_mine=True, obeyed=True)
    actions = actions_of(inputs, now, look(inputs, has_reason=has_reason))
    in_flight = {"take_off"} if now.is_on_ground is False else set()
    assert actions & FROM_GROUND == (FROM_GROUND - in_flight if leaves else set())
    assert actions >= {"land", "go_home"}


@pytest.mark.parametrize(
    ("state", "said"),
    [
        (State(0.0), "not activated"),
        (State(0.0, is_activated=True), "active"),
        (
            State(0.0, activation_code=ActivationCode.NEW_DEVICE),
            f"failed: {ActivationCode.NEW_DEVICE.meaning}",
        ),
        (State(0.0, activation_fault=RemoteError("LinkError", "no answer")), "no answer"),
    ],
)
def test_how_far_activation_is(state: State, said: str) -> None:
    inputs = Inputs(vehicle=seen(None, state=state))
    found = ChecklistModel().look(situation_of(inputs)).checks
    assert [Translator()(one.seen) for one in found if one.item is ChecklistItem.ACTIVATION] == [
        said
    ]


@pytest.mark.parametrize(
    ("firmware", "is_activated", "holder", "is_offered"),
    [
        ("3.1", True, NOBODY, True),  # it needs no control
        ("2.3", True, NOBODY, True),
        ("1.0", True, NOBODY, False),  # which has no commands for it
        ("3.1", False, NOBODY, False),
        ("3.1", True, MINE, False),  # somebody else has control
        ("", True, NOBODY, False),
    ],
)
def test_when_the_camera_obeys(
    firmware: str, is_activated: bool, holder: LeaseChanged, is_offered: bool
) -> None:
    state = State(0.0, "connected", firmware=firmware, is_activated=is_activated)
    offered = offered_of(Inputs(vehicle=seen(None, state=state, holder=holder)))
    assert offered & CAMERA == (CAMERA if is_offered else set())


def test_anybody_may_let_a_guided_flight_hover() -> None:
    state = State(0.0, "connected", guided=GuidedFlight("change of height"))
    assert offered_of(Inputs(vehicle=seen(None, state=state))) == {
        "stop",
        "obtain",
        "pause",
    }


def test_what_flies_by_itself_has_to_be_held_and_its_button_says_so() -> None:
    assert HELD >= FLIGHTS
    assert not HELD & {"stop", "pause", "mission_stop", "release"}
    labels = [key for key, english in translations().items() if english.endswith("(hold)")]
    german = translations(Language.GERMAN)
    assert labels == [key for key, label in german.items() if label.endswith("(halten)")]
    assert len(labels) == len(HELD)


# -- instruments show a value, and that it is old --------------------------------------------------

pytestmark = pytest.mark.anyio


async def test_each_field_has_its_reading_and_grows_old(rig: Rig) -> None:
    telemetry = rig.front.telemetry
    assert isinstance(telemetry, AircraftState)
    shown = instruments_of(Inputs(vehicle=seen(telemetry)))
    assert set(shown.readings) == {field.name for field in FIELDS} | {"flight_time"}
    assert not shown.readings["heading"].is_stale
    attitude = telemetry.get(Attitude)
    assert attitude is not None
    assert shown.attitude == (attitude.roll_deg, attitude.pitch_deg, attitude.yaw_deg)


@pytest.mark.parametrize(
    ("seconds", "said"), [(None, "–"), (0.9, "0:00"), (185.2, "3:05"), (3605.0, "1:00:05")]
)
async def test_the_time_since_take_off_grows_old_with_the_flight_status(
    rig: Rig, seconds: float | None, said: str
) -> None:
    await anyio.sleep(1.5)  # the flight status comes once a second
    telemetry = rig.front.telemetry
    for at, is_stale in ((rig.front.now, False), (rig.front.now + 60.0, True)):
        shown = instruments_of(Inputs(vehicle=seen(telemetry, at), airborne_s=seconds))
        reading = shown.readings["flight_time"]
        assert (Translator()(reading.text), reading.is_stale) == (said, is_stale)


async def test_the_socket_tells_speed_over_ground_and_where_to(rig: Rig) -> None:
    await anyio.sleep(1.5)  # the flight status comes once a second
    told = live(rig.front.view)
    assert told["op"] == "live"
    assert len(told["vel"]) == 4
    assert len(str(told)) < 400  # twenty times a second


async def test_heights_and_speeds_are_in_the_units_and_the_language_that_were_chosen(
    rig: Rig,
) -> None:
    await anyio.sleep(1.5)
    readings = instruments_of(Inputs(vehicle=seen(rig.front.telemetry))).readings
    said = Translator(Language.GERMAN, Units(LengthUnit.FOOT, SpeedUnit.KM_H))
    assert said(readings["height"].text) == "0,0 ft"
    assert said(readings["speed"].text) == "0,0 km/h"
    assert said(readings["climb"].text) == "+0,0 km/h"
    assert said(readings["flight_status"].text) == "am Boden"
    assert said(readings["gps"].text) == "Güte 5 von 5"


@pytest.mark.parametrize("field", FIELDS, ids=lambda field: field.name)
def test_every_field_has_a_name(field: FieldSpec) -> None:
    assert f"instruments.{field.name}" in translations()


def test_every_phase_and_every_device_has_words() -> None:
    fields = {field.name: field.text for field in FIELDS}
    phases = [fields["flight_status"](FlightStatus(phase)) for phase in FlightPhase]
    devices = [fields["control_device"](ControlDevice(device, None)) for device in Device]
    assert all(text.key in translations() for text in (*phases, *devices))
    assert Translator()(fields["flight_status"](FlightStatus(9))) == "9?"
