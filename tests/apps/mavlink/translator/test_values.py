"""Messages in, messages out, by the numbers of common.xml and PX4; the time is an argument."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from random import Random
from typing import Any

import pytest

from m100link.apps.agent.messages import Event, EventTopic
from m100link.apps.agent.orders import FlyAround, FlyTo, GuidedOrder
from m100link.apps.mavlink.order_executor import MissionFlights
from m100link.apps.mavlink.translator.codec import MavlinkMessage, Peer
from m100link.apps.mavlink.translator.missions import MissionProtocol, _cross, read_fence
from m100link.apps.mavlink.translator.orders import (
    FlightSequence,
    HoldPosition,
    ModeRequest,
    PayloadOrder,
)
from m100link.apps.mavlink.translator.payload import Aim, _aim_of
from m100link.apps.mavlink.translator.vehicle import MavlinkVehicle
from m100link.apps.mavlink.translator.vehicle_state import (
    ARM_VERDICTS,
    DISARM_VERDICTS,
    MODES,
    RUNNING,
    VERDICTS,
    FlightSource,
    Mode,
    VehiclePhase,
    available,
    mode_of_number,
    mode_of_standard,
)
from m100link.errors import UsageError
from m100link.geodesy import LocalFrame
from m100link.protocol.records import Attitude, FlightStatus, Position, Velocity
from m100link.protocol.setpoint import Setpoint
from tests.apps.mavlink.conftest import session_of
from tests.known import LATITUDE, LONGITUDE, Known, position, quaternion

PEER, OTHER = Peer(("127.0.0.1", 1), 245, 190), Peer(("127.0.0.1", 2), 246, 191)
MISSION, FENCE, RALLY, ALL = 0, 1, 2, 255
# MAV_MISSION_RESULT
OK, UNSUPPORTED, NO_SPACE, INVALID, SEQUENCE, DENIED, CANCELLED = 0, 3, 4, 5, 13, 14, 15

Told = tuple[str, int, int]
"""Of an answer: its name, its number (item, count or result), and the system that gets it."""


# -- the mission protocol --------------------------------------------------------------------------


class Uploads:
    """The mission protocol, two stations, and the messages that they received."""

    def __init__(self) -> None:
        self.refusals: dict[int, str] = {}  # of changes, by the kind of list
        self.texts: list[str] = []
        self.sent: list[tuple[MavlinkMessage, Peer | None]] = []
        self.ground: float | None = 100.0
        self.missions = MissionProtocol(
            lambda message, peer: self.sent.append((message, peer)),
            lambda _, text: self.texts.append(text),
            ground=lambda: self.ground,
            speed=lambda: 3.5,
            may_change=lambda _, kind: self.refusals.get(kind, ""),
            refusal_of=lambda route: "too high" if route.legs[0].order.height > 50.0 else "",
        )

    def answers(self) -> list[Told]:
        sent, self.sent = self.sent, []
        found = []
        for message, peer in sent:
            assert peer is not None
            assert message["target_system"] == peer.system
            assert message["target_component"] == peer.component
            number = next(message[one] for one in ("seq", "count", "type") if one in message.fields)
            found.append((message.name.removeprefix("MISSION_"), number, peer.system))
        return found

    def say(self, name: str, at: float = 0.0, peer: Peer = PEER, **fields: Any) -> list[Told]:
        given = {"mission_type": MISSION} | fields
        self.missions.receive(MavlinkMessage(f"MISSION_{name}", given), peer, at)
        return self.answers()

    def item(self, seq: int, at: float = 0.0, peer: Peer = PEER, **more: Any) -> list[Told]:
        given = {"command": 16, "frame": 6, "x": 225_431_000 + seq, "y": 1_139_589_000, "z": 8.0}
        given |= {f"param{place}": 0.0 for place in range(1, 5)}
        if more.get("mission_type") == FENCE:
            given |= {"command": 5004, "param1": 3.0}
        return self.say("ITEM_INT", at, peer, seq=seq, **(given | more))

    def upload(self, count: int = 2, kind: int = MISSION) -> Told:
        """So many items of a kind; the answer to the last one."""
        assert self.say("COUNT", count=count, mission_type=kind) == [("REQUEST_INT", 0, 245)]
        for seq in range(count):
            [told] = self.item(seq, mission_type=kind)
        return told

    def stored(self, kind: int = MISSION) -> int:
        [(name, count, _)] = self.say("REQUEST_LIST", mission_type=kind)
        assert name == "COUNT"
        return count


def test_items_are_asked_for_one_by_one_and_the_last_is_acknowledged() -> None:
    one = Uploads()
    assert one.say("COUNT", count=2) == [("REQUEST_INT", 0, 245)]
    assert one.item(1) == [], "it comes too early"
    assert one.item(0) == [("REQUEST_INT", 1, 245)]
    assert one.item(0) == [], "it came twice"
    assert one.say("COUNT", count=2) == [("REQUEST_INT", 1, 245)], "that question was lost"
    assert one.stored() == 0, "half of a mission is none"
    assert one.item(1, 10.0) == [("ACK", OK, 245)]
    assert one.item(1, 14.9) == [("ACK", OK, 245)], "that answer was lost"
    assert one.item(1, 14.9, OTHER) == one.item(1, 14.9, mission_type=FENCE) == []
    assert one.item(1, 15.0) == [], "it is of long ago"
    assert one.stored() == 2
    assert one.missions.items[1]["x"] == 225_431_001


def test_a_slow_upload_keeps_no_other_station_from_uploading() -> None:
    """One that sent an item each seven seconds had blocked all others for two hours."""
    one = Uploads()
    one.say("COUNT", count=500)
    for at in range(0, 70, 7):
        one.item(at // 7, float(at))
    assert one.say("COUNT", 70.0, OTHER, count=2) == [("REQUEST_INT", 0, 246)]
    assert one.item(0, 70.1, OTHER) == [("REQUEST_INT", 1, 246)]
    assert one.item(1, 70.2, OTHER) == [("ACK", OK, 246)]
    assert one.stored() == 2
    assert one.item(10, 70.3) == [("REQUEST_INT", 11, 245)], "and is not ended by it"
    told = [*one.missions.due(70.5, is_flying=False)]
    assert [message.name for message in told] == ["MISSION_CURRENT"]
    assert one.answers() == []
    assert one.missions.due_at == 70.55
    [*one.missions.due(70.55, is_flying=False)]
    assert one.answers() == [("REQUEST_INT", 11, 245)]
    assert one.item(11, 70.6) == [("REQUEST_INT", 12, 245)]
    assert one.missions.due_at == pytest.approx(70.8), "of the question before"


def test_a_station_begins_its_upload_anew() -> None:
    one = Uploads()
    one.say("COUNT", count=3)
    one.item(0)
    assert one.item(1, peer=OTHER) == one.item(1, mission_type=FENCE) == []
    assert one.say("COUNT", count=2) == [("REQUEST_INT", 0, 245)], "of another length"
    one.item(0)
    assert one.say("COUNT", count=2, mission_type=FENCE) == [("REQUEST_INT", 0, 245)]
    for peer, result in ((OTHER, INVALID), (PEER, OK)):
        one.say("ACK", peer=peer, type=result)
        assert one.item(0, mission_type=FENCE) != []
        one.say("COUNT", count=3, mission_type=FENCE)
    one.say("ACK", type=CANCELLED)
    assert one.item(0, mission_type=FENCE) == [], "it does not want to go on"


@pytest.mark.parametrize(
    ("kind", "count", "told"),
    [
        (MISSION, 1000, ("REQUEST_INT", 0, 245)),
        (MISSION, 1001, ("ACK", NO_SPACE, 245)),
        (MISSION, 0, ("ACK", OK, 245)),
        (3, 2, ("ACK", UNSUPPORTED, 245)),
        (ALL, 2, ("ACK", UNSUPPORTED, 245)),
    ],
)
def test_how_long_a_list_may_be_and_of_which_kind(kind: int, count: int, told: Told) -> None:
    one = Uploads()
    one.upload()
    assert one.say("COUNT", count=count, mission_type=kind) == [told]
    assert one.stored() == (0 if count == 0 else 2), "an empty one clears it"
    assert one.stored(3) == 0


@pytest.mark.parametrize("kind", [MISSION, FENCE, RALLY])
def test_what_may_not_be_changed_now_is_not(kind: int) -> None:
    one = Uploads()
    one.upload(2, kind)
    one.refusals[kind] = "it is flown"
    for count in (1, 0):
        assert one.say("COUNT", count=count, mission_type=kind) == [("ACK", DENIED, 245)]
    for cleared in (kind, ALL):
        assert one.say("CLEAR_ALL", mission_type=cleared) == [("ACK", DENIED, 245)]
    assert set(one.texts[-4:]) == {"mission: it is flown"}
    one.refusals.clear()
    one.say("COUNT", count=1, mission_type=kind)
    one.refusals[kind] = "it took off"
    assert one.item(0, mission_type=kind) == [("ACK", DENIED, 245)], "while it was uploaded"
    assert one.texts[-1] == "mission refused: it took off"
    assert one.stored(kind) == 2
    one.refusals.clear()
    assert one.say("CLEAR_ALL", mission_type=ALL) == [("ACK", OK, 245)]
    assert one.stored(kind) == 0


def test_what_clears_one_list_leaves_the_others() -> None:
    one = Uploads()
    for kind in (MISSION, FENCE, RALLY):
        assert one.upload(2, kind) == ("ACK", OK, 245)
    assert [len(area.edges) for area in one.missions.fence.areas] == [0, 0]
    assert one.say("CLEAR_ALL", mission_type=FENCE) == [("ACK", OK, 245)]
    assert [one.stored(kind) for kind in (MISSION, FENCE, RALLY)] == [2, 0, 2]
    assert not one.missions.fence.areas
    assert one.say("CLEAR_ALL", mission_type=MISSION) == [("ACK", OK, 245)]
    assert [one.stored(kind) for kind in (MISSION, FENCE, RALLY)] == [0, 0, 2]


def test_what_does_not_come_is_asked_for_thirty_times_a_quarter_of_a_second_apart() -> None:
    one, now = Uploads(), 100.0
    one.say("COUNT", now, count=2)
    list(one.missions.due(now, is_flying=False))
    asked: list[float] = []
    for begins_at, expected in ((0, 29), (1, 30)):
        if begins_at:
            assert one.item(0, now) == [("REQUEST_INT", 1, 245)]  # and is patient again
        asked.clear()
        for _ in range(29 + begins_at):
            assert one.missions.due_at <= now + 0.25
            list(one.missions.due(now + 0.24, is_flying=False))
            assert one.answers() == []
            now += 0.25
            list(one.missions.due(now, is_flying=False))
            asked += [number for _, number, _ in one.answers()]
        assert asked == [begins_at] * expected
    list(one.missions.due(now + 0.25, is_flying=False))
    assert one.answers() == [("ACK", CANCELLED, 245)]
    assert "broke off" in one.texts[-1]
    list(one.missions.due(now + 0.5, is_flying=False))
    assert one.answers() == []


def test_a_list_is_given_back_as_it_came_and_names_the_item_that_is_flown_to() -> None:
    one = Uploads()
    one.upload(3)
    one.upload(2, FENCE)
    one.missions.flies_to(1)
    for name in ("REQUEST_INT", "REQUEST"):
        for kind, number, current in ((MISSION, 0, 0), (MISSION, 1, 1), (FENCE, 1, 0)):
            one.missions.receive(
                MavlinkMessage(f"MISSION_{name}", {"seq": number, "mission_type": kind}), OTHER, 0.0
            )
            [(item, peer)] = one.sent
            assert (item["x"], item["mission_type"]) == (225_431_000 + number, kind)
            assert (item["current"], peer) == (current, OTHER)
            assert one.answers() == [("ITEM_INT", number, 246)]
        assert one.say(name, seq=3) == [("ACK", SEQUENCE, 245)]
        assert one.say(name, seq=0, mission_type=3) == [("ACK", SEQUENCE, 245)]


def test_another_mission_is_another_edition_and_begins_with_its_first_item() -> None:
    one = Uploads()
    missions, editions = one.missions, []

    def changed(what: Callable[[], object]) -> None:
        before = missions.edition
        what()
        editions.append(missions.edition - before)

    changed(one.upload)
    changed(lambda: one.upload(2, FENCE))
    changed(lambda: one.upload(2, RALLY))
    changed(lambda: missions.begin_at(1))
    assert missions.current == 1
    changed(lambda: missions.flies_to(0))
    missions.over()
    assert (missions.is_over, missions.current) == (True, 1)
    assert [(told["seq"], peer) for told, peer in one.sent] == [(1, None)], "everybody hears it"
    missions.over()
    assert len(one.sent) == 1, "once"
    missions.begin_at(0)
    assert not missions.is_over
    missions.over()
    one.sent.clear()
    changed(one.upload)
    assert (missions.is_over, missions.current) == (False, 0)
    missions.over()
    one.sent.clear()
    changed(lambda: one.say("CLEAR_ALL"))
    assert (missions.is_over, missions.current, missions.route()) == (False, 0, None)
    assert editions == [1, 0, 0, 1, 0, 1, 1]


def test_the_current_item_is_told_once_a_second_and_when_it_changes() -> None:
    one = Uploads()
    one.upload(3)
    told = []
    for at in (10.0, 10.99, 11.0, 11.5, 11.6, 12.59, 12.6):
        if at == 11.6:
            one.missions.flies_to(2)
            one.missions.flies_to(2)
        due = one.missions.due_at <= at
        found = list(one.missions.due(at, is_flying=True))
        assert due is bool(found), at
        told += [
            (at, message["seq"], message["total"], message["mission_state"]) for message in found
        ]
    assert told == [(10.0, 0, 3, 3), (11.0, 0, 3, 3), (11.6, 2, 3, 3), (12.6, 2, 3, 3)]


def test_what_is_not_flown_of_a_mission_is_named_once() -> None:
    one = Uploads()
    one.say("COUNT", count=4)
    for seq, command in enumerate((2000, 206, 2000)):
        one.item(seq, command=command)
    assert one.item(3) == [("ACK", OK, 245)]
    assert one.texts == [
        "mission: without effect: IMAGE_START_CAPTURE (2000), DO_SET_CAM_TRIGG_DIST (206)"
    ]
    route = one.missions.route()
    assert route is not None
    assert [(leg.item, leg.order.speed) for leg in route.legs] == [(3, 3.5)]


def test_heights_above_the_sea_are_uploaded_before_the_ground_is_known() -> None:
    one = Uploads()
    one.ground = None
    one.say("COUNT", count=1)
    assert one.item(0, frame=5, z=140.0) == [("ACK", OK, 245)]
    one.ground = 100.0
    route = one.missions.route()
    assert route is not None
    assert route.legs[0].order.height == 40.0
    one.ground, craft = None, vehicle()
    flights = MissionFlights(craft.world, craft.manager, one.missions, lambda *_: None)
    with pytest.raises(UsageError, match="altitude of the ground is unknown"):
        flights.mission_request(PEER, None)


# -- modes, and what takes over from what: as the manual has it ------------------------------------

ORDER = (
    *(Mode.HOLD, Mode.TAKEOFF, Mode.MISSION, Mode.RTL, Mode.LAND),
    *(Mode.OFFBOARD, Mode.POSCTL, Mode.ALTCTL, Mode.ORBIT, Mode.GOTO),
)
# Hold, take-off, mission, return, land, offboard, position, altitude, orbit, go to.
IN_PHASE = {
    VehiclePhase.AWAY: "REJECT " * 10,
    VehiclePhase.OTHER: "REJECT " * 10,
    VehiclePhase.PILOT: "REJECT " * 10,
    VehiclePhase.DISARMED: "NOTHING REMEMBER REMEMBER NOTHING NOTHING REMEMBER" + " DENY" * 4,
    VehiclePhase.ARMED: "NOTHING START START NOTHING NOTHING START" + " DENY" * 4,
    VehiclePhase.AIRBORNE: "START DENY" + " START" * 8,
    VehiclePhase.FREE: "OBTAIN REJECT REJECT OBTAIN OBTAIN" + " REJECT" * 5,
}
OVER = {
    FlightSource.NOTHING: "REPLACE " * 10,
    FlightSource.FLIGHT: "REPLACE " * 10,
    FlightSource.STREAM: "REPLACE " * 10,
    FlightSource.TAKE_OFF: "WAIT KEEP" + " WAIT" * 8,
    FlightSource.LAND: "INTERRUPT REFUSE REFUSE INTERRUPT KEEP" + " REFUSE" * 5,
    FlightSource.GO_HOME: "INTERRUPT REFUSE REFUSE KEEP INTERRUPT" + " REFUSE" * 5,
    FlightSource.MISSION: "PAUSE STOP KEEP" + " STOP" * 7,
    FlightSource.PAUSED: "KEEP STOP RESUME" + " STOP" * 7,
}
ARMING = {
    VehiclePhase.AWAY: "REJECT REJECT",
    VehiclePhase.OTHER: "REJECT REJECT",
    VehiclePhase.DISARMED: "START NOTHING",
    VehiclePhase.ARMED: "NOTHING START",
    VehiclePhase.AIRBORNE: "NOTHING DENY",
    VehiclePhase.FREE: "START DENY",
    VehiclePhase.PILOT: "REJECT DENY",
}


def test_each_wish_in_each_phase_and_over_all_that_flies() -> None:
    for expected, tables in ((IN_PHASE, VERDICTS), (OVER, RUNNING)):
        rows: dict[Any, dict[Mode, Any]] = dict(tables)
        found = {one: [rows[one][mode].name for mode in ORDER] for one in rows}
        assert found == {one: text.split() for one, text in expected.items()}
    found_arming = {
        one: f"{ARM_VERDICTS[one].name} {DISARM_VERDICTS[one].name}" for one in VehiclePhase
    }
    assert found_arming == ARMING


# custom_mode of PX4: main mode, sub mode; MAV_STANDARD_MODE; MAV_MODE_FLAG without the first bit;
# MAV_MODE_PROPERTY: 1 for experts, 2 not to be chosen by its number.
PX4 = {
    Mode.HOLD: (4, 3, 0, 4 | 8, 0),
    Mode.TAKEOFF: (4, 2, 8, 4 | 8, 0),
    Mode.MISSION: (4, 4, 6, 4 | 8, 0),
    Mode.RTL: (4, 5, 5, 4 | 8, 0),
    Mode.LAND: (4, 6, 7, 4 | 8, 0),
    Mode.OFFBOARD: (6, 0, 0, 8, 1),
    Mode.POSCTL: (3, 0, 1, 64, 0),
    Mode.ALTCTL: (2, 0, 4, 64, 0),
    Mode.ORBIT: (3, 1, 2, 4 | 8, 2),
}


@pytest.mark.parametrize("mode", PX4)
def test_a_mode_has_the_numbers_of_px4_and_of_the_standard(mode: Mode) -> None:
    main, sub, standard, base, properties = PX4[mode]
    place = list(MODES).index(mode) + 1
    [told] = available(place)
    assert told.fields == {
        "number_modes": 9,
        "mode_index": place,
        "standard_mode": standard,
        "custom_mode": main << 16 | sub << 24,
        "properties": properties,
        "mode_name": mode.value,
    }
    assert MODES[mode].base == base
    chosen = mode if mode is not Mode.ORBIT else None
    assert mode_of_number(main, sub) is chosen
    assert mode_of_standard(standard) is (chosen if standard else None)
    assert available(10) == []
    assert set(MODES) == set(PX4)


# -- a vehicle: questions and their answers --------------------------------------------------------


def vehicle(*values: Any, **state: Any) -> MavlinkVehicle:
    """In the air with control authority, as a peer has it."""
    known: Any = Known(*values).flown()
    known.state = replace(known.state, **state)
    known.note = lambda *_: None
    return MavlinkVehicle(known, session_of(known), 1, 12)


def test_sticks_are_speeds_in_position_mode_and_tilts_in_altitude_mode() -> None:
    """As in PX4: POSCTL holds the place when they are let go of, ALTCTL does not."""
    half = {"x": 500, "y": 0, "z": 500, "r": 0}
    one = vehicle()
    flown = {}
    for mode in (Mode.POSCTL, Mode.ALTCTL):
        one._manual[mode].receive(MavlinkMessage("MANUAL_CONTROL", half), 2.5)
        flown[mode] = one._manual[mode].setpoint(2.5)
    assert flown == {
        Mode.POSCTL: Setpoint.velocity(forward=2.5, right=0.0, up=0.0, yaw_rate_deg_s=0.0),
        Mode.ALTCTL: Setpoint.tilt(roll_deg=0.0, pitch_deg=-7.5, up=0.0, yaw_rate_deg_s=0.0),
    }


def answers(one: MavlinkVehicle, name: str, at: float = 2.5, **fields: Any) -> list[MavlinkMessage]:
    """What is sent for a message to the peer that sent it."""
    one.outbox.clear()
    one.receive(MavlinkMessage(name, fields), PEER, at)
    assert {peer for _, peer in one.outbox} <= {PEER}
    return [message for message, _ in one.outbox]


TO_PEER = {"target_system": 245, "target_component": 190}


def test_a_ping_and_a_time_are_answered_and_answers_are_not() -> None:
    one = vehicle()
    ping = {"time_usec": 77, "seq": 7, "target_system": 0, "target_component": 0}
    assert answers(one, "PING", **ping) == [MavlinkMessage("PING", ping | TO_PEER)]
    assert answers(one, "PING", **(ping | {"target_system": 1})) == []
    # Nanoseconds of who answers, and the time of who asked.
    told = MavlinkMessage("TIMESYNC", {"tc1": 2_500_000_000, "ts1": 99})
    assert answers(one, "TIMESYNC", tc1=0, ts1=99) == [told]
    assert answers(one, "TIMESYNC", tc1=5, ts1=99) == []


def test_the_version_says_what_is_there() -> None:
    """Vendor: DJI's number at the USB forum; 1.15.0, and of development."""
    [told, _] = answers(
        vehicle(),
        "COMMAND_LONG",
        command=512,
        **{f"param{place}": 148.0 if place == 1 else math.nan for place in range(1, 8)},
    )
    assert told["capabilities"] == 4 | 8 | 16 | 32 | 64 | 128 | 8192 | 16384
    assert (told["flight_sw_version"], told["vendor_id"]) == (0x010F0000, 0x2CA3)


def test_set_mode_of_older_programs_names_a_mode_of_px4() -> None:
    one = vehicle()
    land = 4 << 16 | 6 << 24
    [told] = answers(one, "SET_MODE", custom_mode=land, base_mode=1)
    assert (told.name, told["command"], told["result"]) == ("COMMAND_ACK", 11, 0)
    assert one.manager.mode is Mode.LAND
    for wrong in ({"custom_mode": land, "base_mode": 8}, {"custom_mode": 9 << 16, "base_mode": 1}):
        one = vehicle()
        assert answers(one, "SET_MODE", **wrong) == []
        assert one.manager.mode is Mode.HOLD
        assert f"mode 0x{wrong['custom_mode']:08x}" in one._texts.waiting[-1][1]


def test_parameters_by_index_and_by_name_and_who_may_set_one() -> None:
    one = vehicle()
    [cruise] = answers(one, "PARAM_REQUEST_READ", param_id="MPC_XY_CRUISE", param_index=-1)
    assert (cruise["param_value"], cruise["param_type"], cruise["param_count"]) == (5.0, 9, 45)
    index = cruise["param_index"]
    for place, name in ((index, "MPC_XY_CRUISE"), (0, "MAV_SYS_ID")):
        [told] = answers(one, "PARAM_REQUEST_READ", param_id="", param_index=place)
        assert (told["param_id"], told["param_index"]) == (name, place)
    assert told["param_type"] == 6, "an integer"
    for operator, expected in ((PEER, 7.5), (OTHER, 7.5), (None, 6.0)):
        one.manager.operator = operator
        value = 7.5 if operator is PEER else 6.0
        told = answers(one, "PARAM_SET", param_id="MPC_XY_CRUISE", param_value=value)[0]
        assert told["param_value"] == expected, operator


# MAV_PARAM_ERROR: does not exist 1, value out of range 2, permission denied 3, read-only 5.
@pytest.mark.parametrize(
    ("name", "fields", "operator", "error", "text"),
    [
        ("READ", {"param_id": "FOLL_MODE", "param_index": -1}, None, 1, ""),
        ("READ", {"param_id": "_HASH_CHECK", "param_index": -1}, None, 1, ""),
        ("READ", {"param_id": "", "param_index": 45}, None, 1, ""),
        ("SET", {"param_id": "NONE"}, None, 1, "there is no parameter NONE"),
        ("SET", {"param_id": "MPC_XY_CRUISE"}, None, 2, "MPC_XY_CRUISE is 0.5 to 10"),
        ("SET", {"param_id": "MPC_XY_CRUISE", "param_value": 4.0}, OTHER, 3, "somebody else flies"),
        ("SET", {"param_id": "CAL_MAG0_ID"}, None, 5, "CAL_MAG0_ID is read-only"),
    ],
)
def test_a_parameter_that_is_not_read_or_set_says_why(
    name: str, fields: dict[str, Any], operator: Peer | None, error: int, text: str
) -> None:
    """MAVSDK asked six times for one that there is not, until its time was over."""
    one = vehicle()
    one.manager.operator = operator
    name = {"READ": "PARAM_REQUEST_READ", "SET": "PARAM_SET"}[name]
    *values, refusal = answers(one, name, **{"param_value": 77.0, **fields})
    assert [value.name for value in values] == ["PARAM_VALUE"] * (error != 1), "the one in force"
    assert (refusal.name, refusal["error"]) == ("PARAM_ERROR", error)
    index = fields.get("param_index", -1)
    assert (refusal["param_id"], refusal["param_index"]) == (fields["param_id"], index)
    assert (refusal["target_system"], refusal["target_component"]) == (245, 190)
    assert [told for _, told in one._texts.waiting if text and text in told] == [
        told for _, told in one._texts.waiting
    ]
    assert bool(one._texts.waiting) is bool(text)


@pytest.mark.parametrize(
    ("name", "field", "value"),
    [
        ("GF_MAX_HOR_DIST", "max_radius_m", 150.0),
        ("GF_MAX_VER_DIST", "max_height_m", 50.0),
        ("COM_ARM_BAT_MIN", "battery_floor_percent", 25),
    ],
)
def test_limits_of_the_agent_are_parameters(name: str, field: str, value: float) -> None:
    one = vehicle()
    for limit in (None, value):
        known: Any = one.world.known
        known.state = replace(known.state, limits=replace(known.state.limits, **{field: limit}))
        [told] = answers(one, "PARAM_REQUEST_READ", param_id=name, param_index=-1)
        share = 0.25 if name == "COM_ARM_BAT_MIN" else value
        assert told["param_value"] == (0.0 if limit is None else share)


# -- a vehicle as time passes ----------------------------------------------------------------------


def passes(one: MavlinkVehicle, at: float) -> list[tuple[str, int]]:
    """The messages to everybody at a time, but for telemetry: names, and modes or results."""
    one.outbox.clear()
    one.advance(at, {}, lambda *_: False)
    found = []
    for message, _ in one.outbox:
        if message.name in ("HEARTBEAT", "CURRENT_MODE"):
            found.append((message.name, message["custom_mode"] >> 24))
        elif message.name == "COMMAND_ACK":
            assert message["progress"] == 255, "nobody knows how far it is"
            found.append((message.name, message["result"]))
    return found


def test_a_heartbeat_comes_once_a_second_and_when_it_changes() -> None:
    one = vehicle()
    beat, mode = ("HEARTBEAT", 3), ("CURRENT_MODE", 3)
    assert passes(one, 10.0) == [mode, beat]
    assert [passes(one, at) for at in (10.5, 10.99, 11.0, 11.9)] == [[], [], [beat], []]
    known: Any = one.world.known
    known.items[FlightStatus] = FlightStatus(1)
    known.has_authority = False
    assert passes(one, 11.95) == [beat], "it is not armed any more, in the same mode"
    known.has_authority = True
    known.items[FlightStatus] = FlightStatus(3)
    passes(one, 12.0)
    one.manager.request_mode(ModeRequest(Mode.RTL, HoldPosition(), PEER), 12.0)
    assert passes(one, 12.1) == [("CURRENT_MODE", 5), ("HEARTBEAT", 5)]
    known.newest_age = 2.0
    assert passes(one, 14.0) == [], "an aircraft that nobody hears is silent"
    one, beats = vehicle(firmware="3.1"), []
    for at in (10.0, 10.5, 10.99, 11.0):
        one.outbox.clear()
        one.advance(at, {}, lambda *_: False)
        beats.append([m.name for m, _ in one.outbox if m.component == 100].count("HEARTBEAT"))
    assert beats == [1, 0, 0, 1], "that of the camera"


def test_who_arms_hears_every_third_of_a_second_that_it_takes_time() -> None:
    one = vehicle(FlightStatus(1))
    known: Any = one.world.known
    known.has_authority = False
    arm = {"command": 400, "param1": 1.0} | {f"param{place}": 0.0 for place in range(2, 8)}
    assert answers(one, "COMMAND_LONG", 10.0, **arm) == []
    [again] = answers(one, "COMMAND_LONG", 10.1, **arm)
    assert (again["result"], again["progress"]) == (5, 255)
    told = []
    for step in range(16):
        now = 10.0 + step / 16
        told += [now for name, _ in passes(one, now) if name == "COMMAND_ACK"]
    assert told == [10.3125, 10.625, 10.9375]


@pytest.mark.parametrize(
    ("topic", "why"),
    [
        (EventTopic.STOPPED, "STOP was pressed"),
        (EventTopic.HALTED, "the console: hover"),
        (EventTopic.MISSION_ABORTED, None),
        (EventTopic.NONE, None),
    ],
)
def test_what_somebody_else_stops_is_a_hold_with_its_reason(
    topic: EventTopic, why: str | None
) -> None:
    one = vehicle()
    one.manager._begin(ModeRequest(Mode.GOTO, FlightSequence((FlyTo(1.0, 2.0, 8.0),)), PEER))
    one.manager.orders.clear()
    one.event(Event(1, 0.0, "warning", "the console: hover", topic))
    assert one._texts.waiting[0] == (4, "the console: hover")
    expected = [] if why is None else [HoldPosition(why=f"Go to: {why}", follows_stop=True)]
    assert one.manager.orders == expected


# -- a fence is looked at ahead --------------------------------------------------------------------

HERE = LocalFrame(LATITUDE, LONGITUDE)


def circle(radius: float, north: float = 0.0, east: float = 0.0, command: int = 5003) -> Any:
    latitude, longitude = HERE.to_geodetic(north, east)
    place = {"x": round(latitude * 1e7), "y": round(longitude * 1e7)}
    return MavlinkMessage("MISSION_ITEM_INT", {"command": command, "param1": radius} | place)


def polygon(*corners: tuple[float, float]) -> Any:
    """The area that excludes what lies between corners north and east of the known place, m."""
    items = []
    for latitude, longitude in (HERE.to_geodetic(*corner) for corner in corners):
        place = {"x": round(latitude * 1e7), "y": round(longitude * 1e7)}
        fields = {"command": 5002, "param1": float(len(corners)), **place}
        items.append(MavlinkMessage("MISSION_ITEM_INT", fields))
    [area] = read_fence(items).areas
    return area


def flying(
    speed: tuple[float, float], leg: GuidedOrder | None = None, **state: Any
) -> MavlinkVehicle:
    """At the place of the known aircraft, with that velocity north and east, m/s."""
    one = vehicle(Velocity(*speed, 0.0, 7), **state)
    flight = FlightSequence((leg or FlyTo(0.0, 0.0, 8.0),))
    one.manager._begin(ModeRequest(Mode.GOTO, flight, PEER))
    if leg is not None:
        one.flights.leg(flight, 0, False)
    return one


def is_held(one: MavlinkVehicle, *areas: Any) -> bool:
    one._missions.fence = read_fence(areas)
    one.manager.orders.clear()
    one._watch_fence()
    return any(isinstance(order, HoldPosition) for order in one.manager.orders)


# It needs 1.9 s, and 0.042 s for each m/s, to stop; what is seen is as old as it is, and a hold is
# a round trip late.
@pytest.mark.parametrize(
    ("speed", "age", "round_trip", "metres"),
    [
        ((5.0, 0.0), 0.0, None, 10.55),
        ((0.0, -10.0), 0.0, None, 23.2),
        ((15.0, 20.0), 0.0, None, 73.75),
        ((10.0, 0.0), 0.4, None, 27.2),
        ((-10.0, 0.0), 0.0, 0.5, 28.2),
    ],
)
def test_it_is_held_so_far_before_a_fence(
    speed: tuple[float, float], age: float, round_trip: float | None, metres: float
) -> None:
    for kind in (Position, Velocity):
        for beyond in (-0.3, 0.3):
            one = flying(speed, round_trip=round_trip)
            known: Any = one.world.known
            known.ages[kind] = age
            assert is_held(one, circle(metres + beyond)) is (beyond < 0.0), kind


def to(north: float, east: float) -> FlyTo:
    return FlyTo(*HERE.to_geodetic(north, east), 8.0)


@pytest.mark.parametrize(
    ("leg", "held"),
    [
        (to(10.0, 0.0), False),  # it stops there
        (to(10.0, 0.8), False),
        (to(10.0, 1.2), True),  # past it
        (to(10.0, -1.2), True),
        (to(24.0, 0.0), True),
        (to(-5.0, 0.0), True),  # it still flies away from there
        (None, True),
    ],
)
def test_a_flight_to_a_place_ends_there_before_a_fence(leg: FlyTo | None, held: bool) -> None:
    """At 10 m/s north, 23.2 m are looked ahead; the fence is at 12 m."""
    assert is_held(flying((10.0, 0.0), leg), circle(12.0)) is held


@pytest.mark.parametrize(
    ("speed", "radius", "fence", "east", "held"),
    [
        (5.0, 20.0, 21.0, 20.0, False),
        (5.0, 19.0, 21.0, 20.0, True),
        (5.0, 30.0, 21.0, 20.0, True),
        (2.2, 20.0, 20.3, 20.0, False),
        (5.0, 20.0, 9.7, 0.0, False),  # 9.3 m north and 2.3 m east, 9.6 m from here
        (5.0, 20.0, 9.5, 0.0, True),
    ],
)
def test_a_circle_is_flown_around_its_middle_before_a_fence(
    speed: float, radius: float, fence: float, east: float, held: bool
) -> None:
    """20 m west of the middle, to the north: straight on it would be 22.6 m from the middle.

    At 2.2 m/s, which look 4.4 m ahead, that is 20.5 m.
    """
    leg = FlyAround(*HERE.to_geodetic(0.0, 20.0), 8.0, radius)
    assert is_held(flying((speed, 0.0), leg), circle(fence, 0.0, east)) is held


@pytest.mark.parametrize("turn", [1, 1j, -1, -1j])
def test_out_of_an_excluded_circle_the_way_leads_out_from_its_first_metre(turn: complex) -> None:
    """6 m from its middle, of 10 m, on any side."""
    one = vehicle()
    one._missions.fence = read_fence([circle(10.0, (6 * turn).real, (6 * turn).imag, 5004)])
    for way, is_out in ((40 * turn, False), (-12 * turn, True), (-400 * turn, True)):
        why = one._may_fly_to(None, HERE.to_geodetic(way.real, way.imag), 0.0)
        assert ("does not lead out straight" in why) is not is_out


def test_polygons_share_a_frame_within_two_kilometres_alone() -> None:
    items = []
    for latitude, longitude in ((22.5, 113.9), (22.501, 113.901), (22.6, 113.9), (22.5, 114.0)):
        for corner in (0.0, 1e-4), (1e-4, 0.0), (0.0, 0.0):
            place = {"x": latitude + corner[0], "y": longitude + corner[1]}
            fields: dict[str, float] = {name: round(one * 1e7) for name, one in place.items()}
            fields |= {"command": 5001, "param1": 3.0}
            items.append(MavlinkMessage("MISSION_ITEM_INT", fields))
    first, near, north, east = (area.frame for area in read_fence(items).areas)
    assert near is first
    assert (north.latitude_deg, east.longitude_deg) == (22.6, 114.0)


def test_a_gimbal_turns_by_60_degrees_a_second_and_not_by_a_heading_that_nobody_knows() -> None:
    one = vehicle()
    # It looks 37.25 degrees down and to 118.75; each axis has its own way and speed.
    for rates, seconds in (((math.nan, -25.0), 0.75), ((10.0, math.nan), 2.275)):
        turn = one._payload._angles_of(Aim(PEER, -60.0, 100.0, math.nan, False, *rates))
        assert turn is not None
        assert turn.duration_s == pytest.approx(seconds)
    # 14.14 m away to the north-east, and as much below.
    below = 12.34 - 10.0 * math.sqrt(2.0)
    there = one._payload._direction((*HERE.to_geodetic(10.0, 10.0), below))
    assert there == pytest.approx((-45.0, 45.0), abs=0.01)
    known: Any = one.world.known
    del known.items[Attitude]
    with pytest.raises(UsageError, match="heading of the aircraft is unknown"):
        one._payload._heading()


def test_photos_at_an_interval_are_as_many_as_are_asked_for() -> None:
    """IMAGE_START_CAPTURE of two seconds; the first one is taken at once."""
    for count, left in ((3.0, 2), (0.0, None)):
        one = vehicle(firmware="3.1")
        known: Any = one.world.known
        known.now = 2.5
        values = dict(enumerate((0.0, 2.0, count, 0.0, math.nan, math.nan, math.nan), 1))
        answers(one, "COMMAND_LONG", command=2000, **{f"param{n}": v for n, v in values.items()})
        order = one.manager.orders[-1]
        assert isinstance(order, PayloadOrder)
        order.done(None)
        assert one._payload._interval is not None
        assert one._payload._interval.left == left


def test_the_attitude_of_a_gimbal_is_a_quaternion_of_about_length_1_and_finite_numbers() -> None:
    def aim(size: float, rate: float = 0.25) -> Aim:
        q = tuple(size * one for one in quaternion(10.0, -20.0, 100.0))
        turn = {"angular_velocity_x": 0.0, "angular_velocity_y": rate, "angular_velocity_z": 0.5}
        return _aim_of(MavlinkMessage("GIMBAL_MANAGER_SET_ATTITUDE", {"q": q} | turn), PEER)

    found = aim(1.05)
    assert found.angles == pytest.approx((100.0, 10.0, -20.0))
    rates_deg = math.degrees(0.25), math.degrees(0.5)
    assert (found.pitch_deg_s, found.yaw_deg_s) == pytest.approx(rates_deg)
    for size in (0.89, 1.11):
        with pytest.raises(UsageError, match="not of length 1"):
            aim(size)
    with pytest.raises(UsageError, match="not finite"):
        aim(1.0, math.inf)


@pytest.mark.parametrize(("beside", "is_entered"), [(9.9, True), (14.0, False)])
def test_ten_kilometres_straight_do_not_pass_below_a_circle(
    beside: float, is_entered: bool
) -> None:
    """The chord of such a way lies 2 m below the ground: length² / (8 · 6371 km)."""
    [area] = read_fence([circle(10.0, 0.0, beside, 5004)]).areas
    ends = HERE.to_geodetic(-5000.0, 0.0), HERE.to_geodetic(5000.0, 0.0)
    assert area.is_entered(*ends) is is_entered
    [area] = read_fence([circle(10.0, 50.0, 0.0, 5004)]).areas
    for north in (39.5, 40.5):
        assert area.is_entered((LATITUDE, LONGITUDE), HERE.to_geodetic(north, 0.0)) is (north > 40)


def test_from_outside_a_flight_may_lead_back_and_never_farther_away() -> None:
    one = vehicle(Velocity(0.0, 0.0, 0.0, 7))
    known: Any = one.world.known

    def at(depth: float, north: float) -> bool:
        """So deep outside of a circle around a place in the south, with that speed north."""
        known.items[Velocity] = Velocity(north, 0.0, 0.0, 7)
        return is_held(one, circle(50.0, -50.0 - depth))

    assert not at(10.0, 5.0), "nothing flies that could be held"
    one.manager._begin(ModeRequest(Mode.GOTO, FlightSequence((FlyTo(0.0, 0.0, 8.0),)), PEER))
    assert not at(10.0, -5.0)
    assert not at(10.2, 0.0), "it is blown away a little"
    assert not at(10.2, 0.03)
    assert at(10.2, 0.1), "0.39 m farther than it was at its least"
    one.manager._begin(ModeRequest(Mode.OFFBOARD, None, PEER))
    assert at(10.0, -5.0), "setpoints are not flown out there"
    one = flying((-5.0, 0.0))
    known = one.world.known
    assert at(10.0, -5.0), "nobody has asked where it leads"
    del known.items[Position]
    assert is_held(flying((1.0, 0.0))) is False, "there is no fence"


@pytest.mark.parametrize("lost", [Position, Velocity])
def test_nobody_flies_on_before_a_fence_without_a_place_and_a_speed(lost: type[Any]) -> None:
    one = flying((1.0, 0.0))
    known: Any = one.world.known
    del known.items[lost]
    assert is_held(one, circle(500.0))
    assert one._texts.waiting[-1][1] == "hold: the distance to the fence is unknown"
    known.items[FlightStatus] = FlightStatus(1)
    known.items[lost] = position() if lost is Position else Velocity(30.0, 0.0, 0.0, 7)
    one.manager._begin(ModeRequest(Mode.HOLD, HoldPosition(), PEER))
    assert not is_held(one, circle(5.0)), "on the ground"


# The middle of the frame is the last corner: its sides begin and end at exactly 0 m east.
@pytest.mark.parametrize(
    ("corners", "north", "is_inside"),
    [
        ([(10.0, -50.0), (-60.0, -50.0), (-60.0, 50.0), (10.0, 50.0)], -30.0, True),
        ([(10.0, -50.0), (-60.0, -50.0), (-60.0, 50.0), (10.0, 50.0)], 5.0, False),
        ([(50.0, -50.0), (-50.0, -50.0)], -10.0, False),
        ([(-50.0, 50.0), (50.0, 50.0)], -10.0, False),
    ],
)
def test_a_place_south_of_a_corner_is_inside_where_the_area_goes_on_at_both_sides(
    corners: list[tuple[float, float]], north: float, is_inside: bool
) -> None:
    area = polygon(*corners, (0.0, 0.0))
    assert area.has(LATITUDE + north / 111_195.0, LONGITUDE) is is_inside


@pytest.mark.parametrize(
    ("east", "is_entered"), [(-50.0, True), (50.0, True)], ids=["tip to the east", "to the west"]
)
def test_a_way_that_touches_a_corner_enters_the_area(east: float, is_entered: bool) -> None:
    area = polygon((50.0, east), (-50.0, east), (0.0, 0.0))
    way = [(LATITUDE + north / 111_195.0, LONGITUDE) for north in (-100.0, 100.0)]
    assert area.is_entered(*way) is is_entered
    assert not area.is_entered(way[0], way[0])
    assert not area.is_entered(way[0], (LATITUDE - 1e-5, LONGITUDE)), "it ends before it"


def test_ways_cross_an_edge_where_both_go_through_the_same_place() -> None:
    """As complex numbers: a + t (b - a) = c + u (d - c), with t and u from 0 to 1."""
    random = Random(7)
    for _ in range(300):
        a, b, c, d = (complex(random.uniform(-9, 9), random.uniform(-5, 9)) for _ in range(4))
        way, edge, between = b - a, d - c, c - a
        area = (way.conjugate() * edge).imag
        t, u = ((between.conjugate() * one).imag / area for one in (edge, way))
        ends = ((one.real, one.imag) for one in (a, b, c, d))
        assert _cross(*ends) is (0.0 <= t <= 1.0 and 0.0 <= u <= 1.0), (a, b, c, d)
    north, at_it = ((0.0, 0.0), (2.0, 0.0)), ((1.0, 1.0), (1.0, 0.0))
    assert _cross(*north, *at_it), "the edge ends on the way"
    assert _cross(*at_it, *north), "the way ends on the edge"
