"""The messages about the aircraft, as a table: values in, values out by common.xml of MAVLink.

Each row says sign, unit, frame and scale as the definitions have them, not as the bridge does.
"""

from __future__ import annotations

import itertools
import math
import random
from collections import Counter
from dataclasses import replace
from typing import Any

import anyio
import pytest

from m100link.apps.agent.client import VehicleView
from m100link.apps.agent.messages import LeaseChanged, State
from m100link.apps.agent.orders import FlyAround, FlyTo
from m100link.apps.mavlink.translator.codec import (
    LAYOUTS,
    MavlinkMessage,
    MessageReader,
    Peer,
    write_frame,
)
from m100link.apps.mavlink.translator.numbers import MavCommand, MavResult, Severity
from m100link.apps.mavlink.translator.telemetry import (
    STREAMS,
    Rates,
    Texts,
    severity_of,
)
from m100link.apps.mavlink.translator.vehicle_state import VehicleState
from m100link.protocol.records import (
    Acceleration,
    AngularVelocity,
    Attitude,
    Battery,
    FlightStatus,
    Magnetometer,
    Position,
    RemoteControl,
    Velocity,
)
from m100link.telemetry.integrity import IntegrityState
from tests.apps.mavlink.conftest import Ground, Rig, session_of, world_of
from tests.known import LATITUDE, LONGITUDE, Known, felt, position, quaternion

NOW = 1234.5678
U16, I16 = 0xFFFF, 0x7FFF
NAN = math.nan
BOOT, USEC = {"time_boot_ms": 1_234_567}, {"time_usec": 1_234_567_800}
RATES = {"rollspeed": 0.11, "pitchspeed": -0.23, "yawspeed": 0.37}  # rad/s, body, FRD
PLACE = {"lat": -331_234_567, "lon": 1_512_345_678}  # degE7
HERE = (30.0, -70.0, 12.34)
"""North, east and up of home, m."""


def wire(name: str, fields: dict[str, Any]) -> MavlinkMessage:
    """As a ground station reads it."""
    frame = write_frame(MavlinkMessage(name, fields), system=1, sequence=1, signer=None, now=0)
    [found] = MessageReader(frame, signer=None, now=0)
    return found


def told(name: str, known: Known, home: tuple[float, float, float] | None = HERE) -> Any:
    world = world_of(known, home=home)
    fields = STREAMS[name].fields(world, NOW)
    return None if fields is None else wire(name, fields)


XACC, YACC, ZACC = felt()
NAMED = ("q1", "q2", "q3", "q4")

TABLE: dict[str, dict[str, Any]] = {
    # rad, -pi to pi; right wing down, nose up and clockwise are positive
    "ATTITUDE": BOOT
    | RATES
    | {"roll": math.radians(10.0), "pitch": math.radians(-20.0), "yaw": math.radians(-130.0)},
    "ATTITUDE_QUATERNION": BOOT  # w, x, y, z; of no turn 1, 0, 0, 0
    | RATES
    | dict(zip(NAMED, quaternion(10.0, -20.0, -130.0), strict=True)),
    # mm above the sea and above home; cm/s north, east and down; cdeg, 0 to 35999
    "GLOBAL_POSITION_INT": BOOT
    | PLACE
    | {"alt": 87_650, "relative_alt": 12_340, "vx": 321, "vy": -157, "vz": -84, "hdg": 23_000},
    # m and m/s, north, east and down
    "LOCAL_POSITION_NED": BOOT
    | {"x": 30.0, "y": -70.0, "z": -12.34, "vx": 3.21, "vy": -1.57, "vz": -0.84},
    # degE7, mm above the sea; the quaternion NaN where it is not known
    "HOME_POSITION": USEC
    | {"latitude": -331_237_265, "longitude": 1_512_353_100 - 0, "altitude": 10_500}
    | {"x": 0.0, "y": 0.0, "z": 0.0, "approach_x": NAN, "approach_y": NAN, "approach_z": NAN},
    # 3 is a 3D fix; cm/s over ground; course and accuracies unknown 65535, satellites 255
    "GPS_RAW_INT": USEC
    | PLACE
    | {"fix_type": 3, "alt": 87_650, "vel": 357, "cog": U16, "eph": U16, "epv": U16}
    | {"satellites_visible": 255},
    # percent; a voltage 65535, a current -1 where unknown
    "BATTERY_STATUS": {"battery_remaining": 63, "current_battery": -1, "current_consumed": -1}
    | {"energy_consumed": -1, "temperature": I16, "voltages": (U16,) * 10}
    | {"voltages_ext": (0,) * 4},
    "SYS_STATUS": {"battery_remaining": 63, "voltage_battery": U16, "current_battery": -1}
    | {"errors_comm": 77, "drop_rate_comm": 0, "onboard_control_sensors_present": 0x10010027}
    | {"onboard_control_sensors_health": 0x10110027}
    | {"onboard_control_sensors_enabled": 0x10010027},
    "EXTENDED_SYS_STATE": {"vtol_state": 0, "landed_state": 2},
    # µs, 1500 in the middle; channels that are not there 65535, rssi 255
    "RC_CHANNELS": BOOT
    | {"chancount": 6, "rssi": 255, "chan1_raw": 1550, "chan2_raw": 1400, "chan3_raw": 1300}
    | {"chan4_raw": 1650, "chan5_raw": 1900, "chan6_raw": 1273}
    | {f"chan{place}_raw": U16 for place in range(7, 19)},
    # m/s, degrees 0 to 360, m above the sea; climb is up
    "VFR_HUD": {"airspeed": NAN, "groundspeed": math.hypot(3.21, 1.57), "heading": 230}
    | {"alt": 87.65, "climb": 0.84},
    "ALTITUDE": USEC
    | {"altitude_amsl": 87.65, "altitude_local": 12.34, "altitude_relative": 12.34}
    | dict.fromkeys(("altitude_monotonic", "altitude_terrain", "bottom_clearance"), NAN),
    # m/s² and rad/s, body, FRD; bits 0 to 2 acceleration, 3 to 5 turn
    "HIGHRES_IMU": USEC
    | {"xacc": XACC, "yacc": YACC, "zacc": ZACC, "xgyro": 0.11, "ygyro": -0.23, "zgyro": 0.37}
    | {"fields_updated": 0b111_111, "xmag": NAN, "ymag": NAN, "zmag": NAN, "abs_pressure": NAN}
    | {"diff_pressure": NAN, "pressure_alt": NAN, "temperature": NAN},
    "SYSTEM_TIME": BOOT | {"time_unix_usec": 0},
    # ESTIMATOR_STATUS_FLAGS: attitude 1, velocity 2 and 4, absolute position 16 and 32
    "ESTIMATOR_STATUS": USEC
    | {"flags": 1 | 2 | 4 | 16 | 32, "pos_horiz_ratio": 0.25, "pos_vert_ratio": 0.375}
    | dict.fromkeys(("vel_ratio", "mag_ratio", "hagl_ratio", "tas_ratio"), NAN)
    | {"pos_horiz_accuracy": NAN, "pos_vert_accuracy": NAN},
}


OF_PAYLOAD = {f"CAMERA_{name}" for name in ("INFORMATION", "SETTINGS", "CAPTURE_STATUS")} | {
    *("STORAGE_INFORMATION", "GIMBAL_MANAGER_INFORMATION", "GIMBAL_DEVICE_INFORMATION"),
    *("GIMBAL_MANAGER_STATUS", "GIMBAL_DEVICE_ATTITUDE_STATUS"),
}
"""Messages of test_payload."""


def test_the_table_has_every_stream() -> None:
    assert set(TABLE) | {row[0] for row in OF_FLIGHTS} == set(STREAMS) - OF_PAYLOAD


# The take-off point is 75.31 m above the sea. type_mask: bits 3 to 5 speed, 6 to 8 acceleration, 10
# yaw, 11 turn are to be ignored. The radius is positive clockwise; frames: GLOBAL 0, GLOBAL_INT 5.
AIM = -33.1234567, 151.2345678
OF_FLIGHTS: list[tuple[str, Any, dict[str, float]]] = [
    (
        "POSITION_TARGET_GLOBAL_INT",
        FlyTo(*AIM, 20.0, 3.0),
        BOOT
        | {"lat_int": -331_234_567, "lon_int": 1_512_345_678, "alt": 95.31, "coordinate_frame": 5}
        | {"type_mask": 0b1101_1111_1000},
    ),
    (
        "POSITION_TARGET_GLOBAL_INT",
        FlyTo(*AIM, 20.0, 3.0, -90.0),
        {"type_mask": 0b1001_1111_1000, "yaw": -math.pi / 2},
    ),
    (
        "ORBIT_EXECUTION_STATUS",
        FlyAround(*AIM, 8.0, 12.5),
        USEC | {"radius": 12.5, "frame": 0, "x": -331_234_567, "y": 1_512_345_678, "z": 83.31},
    ),
    ("ORBIT_EXECUTION_STATUS", FlyAround(*AIM, 8.0, 12.5, clockwise=False), {"radius": -12.5}),
]


@pytest.mark.parametrize(("name", "leg", "expected"), OF_FLIGHTS)
def test_where_a_flight_leads_is_shown_while_it_is_flown(
    name: str, leg: Any, expected: dict[str, float]
) -> None:
    world = world_of(Known(), home=HERE)
    assert STREAMS[name].fields(world, NOW) is None
    world.target = lambda: leg
    fields = STREAMS[name].fields(world, NOW)
    assert fields is not None
    found = wire(name, fields)
    assert {field: found[field] for field in expected} == pytest.approx(expected, rel=1e-6)
    other = next(one for one, *_ in OF_FLIGHTS if one != name)
    assert STREAMS[other].fields(world, NOW) is None
    world.known.without(Position)  # type: ignore[attr-defined]  # a stand-in
    assert STREAMS[name].fields(world, NOW) is None, "the altitude of the ground is unknown"


@pytest.mark.parametrize("name", TABLE)
def test_what_is_reported_of_an_aircraft_whose_numbers_all_differ(name: str) -> None:
    found, expected = told(name, Known()), dict(TABLE[name])
    for place in ("latitude", "longitude"):  # of home: where that is, see the one below
        if place in expected:
            assert abs(found[place] - expected.pop(place)) < 20_000
    for field, value in expected.items():
        given = found[field]
        wanted = value if isinstance(value, tuple) else pytest.approx(value, rel=1e-6, abs=1e-6)
        if field in ("x", "y") and name == "LOCAL_POSITION_NED":
            wanted = pytest.approx(value, rel=0.01)  # a sphere here, the ellipsoid there
        if isinstance(value, float) and math.isnan(value):
            assert math.isnan(given), field
        else:
            assert given == wanted, field


def test_home_is_where_it_stood() -> None:
    known = Known(position(altitude=10.5), FlightStatus(1))
    world = world_of(known)
    world.look()
    fields = STREAMS["HOME_POSITION"].fields(world, NOW)
    assert fields is not None
    assert (fields["latitude"], fields["longitude"]) == (-331_234_567, 1_512_345_678)


@pytest.mark.parametrize(
    ("yaw", "hdg", "heading"),
    [
        (0.0, 0, 0),
        (90.0, 9000, 90),
        (-90.0, 27_000, 270),
        (179.99, 17_999, 180),
        (-0.004, 0, 0),
        (-0.01, 35_999, 0),
        (-0.6, 35_940, 359),
        (1.234, 123, 1),
    ],
)
def test_a_heading_is_never_that_of_a_whole_turn(yaw: float, hdg: int, heading: int) -> None:
    known = Known(Attitude(*quaternion(3.0, 4.0, yaw)))
    assert told("GLOBAL_POSITION_INT", known)["hdg"] == hdg
    assert told("VFR_HUD", known)["heading"] == heading


@pytest.mark.parametrize(
    ("name", "gone", "field", "unknown"),
    [
        ("GLOBAL_POSITION_INT", Attitude, "hdg", U16),
        ("ATTITUDE", AngularVelocity, "yawspeed", NAN),
        ("ATTITUDE_QUATERNION", AngularVelocity, "rollspeed", NAN),
        ("GPS_RAW_INT", Velocity, "vel", U16),
        ("SYS_STATUS", Battery, "battery_remaining", -1),
        ("EXTENDED_SYS_STATE", FlightStatus, "landed_state", 0),
        ("HIGHRES_IMU", Acceleration, "zacc", NAN),
        ("HIGHRES_IMU", Acceleration, "fields_updated", 0b111_000),
        ("HIGHRES_IMU", Attitude, "xacc", NAN),
        ("ESTIMATOR_STATUS", Attitude, "flags", 2 | 4 | 16 | 32),
        ("ESTIMATOR_STATUS", Velocity, "flags", 1 | 16 | 32),
        ("ESTIMATOR_STATUS", Position, "flags", 1 | 2 | 4),
    ],
)
def test_a_field_that_nobody_knows_says_so(
    name: str, gone: type[Any], field: str, unknown: float
) -> None:
    found = told(name, Known().without(gone), None)[field]
    assert math.isnan(found) if math.isnan(unknown) else found == unknown


@pytest.mark.parametrize(
    ("name", "gone"),
    [
        ("ATTITUDE", Attitude),
        ("ATTITUDE_QUATERNION", Attitude),
        ("GLOBAL_POSITION_INT", Position),
        ("GLOBAL_POSITION_INT", Velocity),
        ("LOCAL_POSITION_NED", Position),
        ("LOCAL_POSITION_NED", Velocity),
        ("GPS_RAW_INT", Position),
        ("BATTERY_STATUS", Battery),
        ("RC_CHANNELS", RemoteControl),
        ("VFR_HUD", Position),
        ("VFR_HUD", Velocity),
        ("VFR_HUD", Attitude),
        ("ALTITUDE", Position),
        ("HIGHRES_IMU", AngularVelocity),
    ],
)
def test_a_message_that_would_be_made_up_is_not_sent(name: str, gone: type[Any]) -> None:
    known = Known()
    world = world_of(known, home=HERE)
    assert STREAMS[name].fields(world, NOW) is not None
    known.without(gone)
    assert STREAMS[name].fields(world, NOW) is None


@pytest.mark.parametrize("name", ["LOCAL_POSITION_NED", "HOME_POSITION"])
def test_without_home_nothing_is_measured_from_it(name: str) -> None:
    assert told(name, Known(), None) is None


def test_on_the_ground_no_place_is_reported_before_home_is_known() -> None:
    assert told("GLOBAL_POSITION_INT", Known(), None) is not None
    assert told("GLOBAL_POSITION_INT", Known(FlightStatus(1)), None) is None


@pytest.mark.parametrize(
    ("health", "fix"), [(0, 0), (1, 2), (2, 2), (3, 3), (4, 3), (5, 3), (None, None)]
)
def test_a_fix_is_one_from_health_three(health: int | None, fix: int | None) -> None:
    found = told("GPS_RAW_INT", Known(position(health=health)), None)
    assert (None if found is None else found["fix_type"]) == fix
    status = told("SYS_STATUS", Known(position(health=health)), None)
    is_one = (health or 0) >= 3
    assert bool(status["onboard_control_sensors_health"] & 0x20) is is_one
    assert bool(status["onboard_control_sensors_health"] & 0x10000000) is is_one
    assert (told("GLOBAL_POSITION_INT", Known(position(health=health)), None) is None) is not is_one


@pytest.mark.parametrize(
    ("gone", "bit"),
    [
        (AngularVelocity, 1),
        (Acceleration, 2),
        (Magnetometer, 4),
        (Position, 0x20),
        (RemoteControl, 0x10000),
    ],
)
def test_a_sensor_that_tells_nothing_is_not_there(gone: type[Any], bit: int) -> None:
    found = told("SYS_STATUS", Known().without(gone), None)
    assert not found["onboard_control_sensors_present"] & bit
    assert not found["onboard_control_sensors_health"] & bit
    assert found["onboard_control_sensors_present"] & ~bit & 0x10027 == 0x10027 & ~bit


@pytest.mark.parametrize(
    ("late", "bit"), [(AngularVelocity, 1), (Magnetometer, 4), (Position, 0x20)]
)
def test_a_sensor_that_fell_silent_is_there_and_not_healthy(late: type[Any], bit: int) -> None:
    known = Known()
    known.ages[late] = 60.0
    found = told("SYS_STATUS", known, None)
    assert found["onboard_control_sensors_present"] & bit
    assert not found["onboard_control_sensors_health"] & bit


@pytest.mark.parametrize(("damaged", "told_of"), [(0, 0), (65_535, 65_535), (70_000, 65_535)])
def test_damaged_frames_are_counted_up_to_sixteen_bits(damaged: int, told_of: int) -> None:
    known = Known()
    known.state = replace(known.state, discards=damaged)
    assert told("SYS_STATUS", known)["errors_comm"] == told_of


@pytest.mark.parametrize(
    ("values", "may_arm"),
    [
        ((), True),
        ((Battery(20),), True),
        ((Battery(19),), False),
        ((Battery(101),), False),
        ((RemoteControl(0, 0, 0, 0, 0, None),), False),
        ((RemoteControl(0, 0, 0, 0, -8000, None),), False),
    ],
)
def test_ready_to_arm_needs_gps_a_battery_and_the_switch_in_f(
    values: tuple[Any, ...], may_arm: bool
) -> None:
    health = told("SYS_STATUS", Known(*values), None)["onboard_control_sensors_health"]
    assert bool(health & 0x10000000) is may_arm


@pytest.mark.parametrize(("status", "landed"), [(1, 1), (2, 3), (3, 2), (4, 4), (5, 4), (9, 0)])
def test_the_landed_state_is_that_of_the_definitions(status: int, landed: int) -> None:
    assert told("EXTENDED_SYS_STATE", Known(FlightStatus(status)), None)["landed_state"] == landed


@pytest.mark.parametrize(
    ("raw", "microseconds"),
    [(-10000, 1000), (-20000, 1000), (0, 1500), (10000, 2000), (30000, 2000)],
)
def test_a_stick_is_a_pulse(raw: int, microseconds: int) -> None:
    found = told("RC_CHANNELS", Known(RemoteControl(raw, 0, 0, 0, 0, None)))
    assert (found["chan1_raw"], found["chan2_raw"], found["chancount"]) == (microseconds, 1500, 5)
    assert found["chan6_raw"] == U16


def test_speeds_that_do_not_fit_are_the_greatest_that_do() -> None:
    found = told("GLOBAL_POSITION_INT", Known(Velocity(400.0, -400.0, 400.0, 3)))
    assert (found["vx"], found["vy"], found["vz"]) == (32767, -32767, -32767)
    assert told("GPS_RAW_INT", Known(Velocity(4e5, 0.0, 0.0, 3)))["vel"] == 65534


@pytest.mark.parametrize("percent", [101, 200])
def test_a_battery_of_more_than_all_is_not_known(percent: int) -> None:
    assert told("BATTERY_STATUS", Known(Battery(percent))) is None
    assert told("SYS_STATUS", Known(Battery(percent)))["battery_remaining"] == -1


# Bit 1024: GPS glitch. GPS is sensor 0x20 of SYS_STATUS.
@pytest.mark.parametrize(
    ("state", "flags", "has_gps"),
    [
        (IntegrityState.UNKNOWN, 1 | 2 | 4 | 16 | 32, True),
        (IntegrityState.CLOCK_STOPPED, 1, True),
        (IntegrityState.LATE, 1, True),
        (IntegrityState.JUMPED, 1 | 1024, False),
        (IntegrityState.FROZEN, 1 | 1024, False),
        (IntegrityState.INCONSISTENT, 1 | 1024, False),
    ],
)
def test_a_place_that_cannot_be_true_is_a_glitch(
    state: IntegrityState, flags: int, has_gps: bool
) -> None:
    known = Known().doubted(state)
    found = told("ESTIMATOR_STATUS", known, None)
    assert (found["flags"], found["pos_horiz_ratio"]) == (flags, 4.5)
    health = told("SYS_STATUS", known, None)["onboard_control_sensors_health"]
    assert bool(health & 0x20) is has_gps


def test_places_are_those_of_the_item() -> None:
    found = told("GLOBAL_POSITION_INT", Known(position(latitude=12.5, longitude=-0.25)), None)
    assert (found["lat"], found["lon"]) == (125_000_000, -2_500_000)
    assert (LATITUDE, LONGITUDE) != (12.5, -0.25)


# MAV_DATA_STREAM: sensors 1, status 2, sticks 3, position 6, and three that are free: 10 to 12.
RATES_BY_DEFAULT = {
    "SYS_STATUS": (2, 2),
    "EXTENDED_SYS_STATE": (2, 2),
    "GLOBAL_POSITION_INT": (20, 6),
    "LOCAL_POSITION_NED": (20, 6),
    "ATTITUDE": (20, 10),
    "ATTITUDE_QUATERNION": (20, 10),
    "HOME_POSITION": (1, 6),
    "GPS_RAW_INT": (5, 1),
    "BATTERY_STATUS": (1, 2),
    "RC_CHANNELS": (5, 3),
    "POSITION_TARGET_GLOBAL_INT": (1, 6),
    "ORBIT_EXECUTION_STATUS": (1, 6),
    "VFR_HUD": (4, 11),
    "ALTITUDE": (0, 12),
    "HIGHRES_IMU": (0, 1),
    "SYSTEM_TIME": (0, 12),
    "ESTIMATOR_STATUS": (1, 2),
}


def test_what_nobody_asked_for_comes_as_often_as_the_manual_says() -> None:
    found = {name: (one.hz, one.group) for name, one in STREAMS.items()}
    hz = {"GIMBAL_MANAGER_STATUS": 1, "GIMBAL_DEVICE_ATTITUDE_STATUS": 5}
    assert found == RATES_BY_DEFAULT | {name: (hz.get(name, 0), -1) for name in OF_PAYLOAD}


# -- each peer gets what it asked for, and nobody gets less because another asked ------------------


PEER_HERE, THERE = ("127.0.0.1", 1), ("127.0.0.1", 2)
FIRST, SECOND = Peer(PEER_HERE, 245, 190), Peer(THERE, 246, 190)
NEIGHBOUR = Peer(PEER_HERE, 247, 190)


class NoAircraft:
    """Nothing is known; messages that need nothing are sent all the same."""

    view = VehicleView(0.0, 0.0, False, State(at=0.0), LeaseChanged(0, ""), None)


def rates() -> Rates:
    nothing: Any = NoAircraft()
    return Rates(VehicleState(nothing, session_of(nothing, number=0)))


def counted(one: Rates, *peers: Peer, begin: float = 0.0) -> Counter[tuple[str, int]]:
    """How often each message goes to each port in ten seconds."""
    found: Counter[tuple[str, int]] = Counter()
    audience = {
        address: tuple(peer for peer in peers if peer.address == address)
        for address in (PEER_HERE, THERE)
    }
    for step in range(500):
        for message, addresses in one.due(begin + step * 0.02, audience):
            found.update((message.name, port) for _, port in addresses)
    return found


def test_what_one_asks_for_changes_nothing_for_another() -> None:
    one = rates()
    usual = counted(one, FIRST, SECOND)
    for name in STREAMS:
        one.set_hz(name, 1000.0, FIRST)
    one.set_hz("SYS_STATUS", 0.0, FIRST)
    found = counted(one, FIRST, SECOND, begin=10.0)
    assert found["SYSTEM_TIME", PEER_HERE[1]] == pytest.approx(10 * 50, abs=1), "50 Hz at most"
    assert found["SYS_STATUS", PEER_HERE[1]] == 0
    there = {pair: count for pair, count in found.items() if pair[1] == THERE[1]}
    assert there == {pair: count for pair, count in usual.items() if pair[1] == THERE[1]}
    assert there["SYS_STATUS", THERE[1]] == 20


def test_a_station_that_asks_again_gets_what_it_asked_for_last_and_the_usual_for_nothing() -> None:
    one = rates()
    for begin, hz, expected in ((0, 5.0, 50), (10, 0.5, 5), (20, None, 20), (30, -3.0, 0)):
        one.set_hz("SYS_STATUS", hz, FIRST)
        assert counted(one, FIRST, begin=begin)["SYS_STATUS", PEER_HERE[1]] == expected
    assert one.hz("SYS_STATUS", FIRST) == 0.0
    assert one.hz("SYS_STATUS", SECOND) == STREAMS["SYS_STATUS"].hz


def test_peers_behind_one_address_do_not_take_from_each_other() -> None:
    one = rates()
    one.set_hz("SYS_STATUS", 0.0, FIRST)
    one.set_hz("SYSTEM_TIME", 10.0, FIRST)
    found = counted(one, FIRST, NEIGHBOUR)
    assert found["SYS_STATUS", PEER_HERE[1]] == 20
    assert found["SYSTEM_TIME", PEER_HERE[1]] == 100


def test_rates_of_the_silent_are_kept_while_there_is_room() -> None:
    one = rates()
    one.set_hz("SYS_STATUS", 10.0, FIRST)
    assert counted(one, SECOND)["SYS_STATUS", PEER_HERE[1]] == 20, "nobody is there who wants more"
    assert counted(one, FIRST, begin=10.0)["SYS_STATUS", PEER_HERE[1]] == pytest.approx(100, abs=4)
    for number in range(1600):
        one.set_hz("SYS_STATUS", 10.0, Peer(("127.0.0.1", 1000 + number), 1, 1))
    assert len(one._asked) == 32
    assert one.hz("SYS_STATUS", FIRST) == 10.0, "it is there"
    counted(one, SECOND, begin=20.0)
    for number in range(1600):
        one.set_hz("SYS_STATUS", 10.0, Peer(("127.0.0.1", 1000 + number), 1, 1))
    assert one.hz("SYS_STATUS", FIRST) == STREAMS["SYS_STATUS"].hz


def test_what_comes_seldom_comes_soon_when_who_wanted_that_has_gone() -> None:
    one = rates()
    one.set_hz("SYS_STATUS", 0.001, FIRST)
    assert counted(one, FIRST)["SYS_STATUS", PEER_HERE[1]] == 1
    assert counted(one, NEIGHBOUR, begin=10.0)["SYS_STATUS", PEER_HERE[1]] == pytest.approx(
        20, abs=1
    )


@pytest.mark.parametrize("seed", range(4))
def test_nothing_is_due_before_the_time_that_says_so(seed: int) -> None:
    """Rates that are asked in each step, and the same asked only when they say so."""
    chance = random.Random(seed)
    always, due = rates(), rates()
    audience: dict[tuple[str, int], tuple[Peer, ...]] = {}
    skipped, now = 0, 0.0
    for step in range(1000):
        now += chance.choice((0.02, 0.02, 0.05))
        if chance.random() < 0.02:
            name, hz = chance.choice(list(STREAMS)), chance.choice((0.0, 0.3, 7.0, 50.0, None))
            always.set_hz(name, hz, FIRST)
            due.set_hz(name, hz, FIRST)
        if chance.random() < 0.01:
            audience = dict.fromkeys(chance.sample((PEER_HERE, THERE), chance.randrange(3)), ())
            audience |= {one: (FIRST,) for one in audience if one == PEER_HERE}
        expected = list(always.due(now, audience))
        if now >= due.due_at or audience != due.audience:
            assert list(due.due(now, audience)) == expected, (seed, step)
        else:
            skipped += 1
            assert expected == [], (seed, step)
    assert skipped > 100, "that is what it is for"


def test_a_group_is_what_older_programs_ask_for() -> None:
    one = rates()
    one.set_group(2, 10.0, FIRST)
    assert one.hz("SYS_STATUS", FIRST) == 10.0
    assert one.hz("ATTITUDE", FIRST) == STREAMS["ATTITUDE"].hz
    one.set_group(0, 4.0, FIRST)
    is_of_payload = {name for name, stream in STREAMS.items() if stream.is_of_payload}
    for group in (0, 99, -1):
        assert {one.hz(name, FIRST) for name in STREAMS.keys() - is_of_payload} == {4.0}
        assert {one.hz(name, FIRST) for name in is_of_payload} == {0, 1, 5}, "they are in no group"
        one.set_group(group, 4.0, FIRST)


@pytest.mark.anyio
async def test_a_peer_that_asks_for_a_kilohertz_changes_nothing_for_another(
    rig: Rig, ground: Ground
) -> None:
    other = Ground(rig, ("127.0.0.1", 7000), 246)
    other.beat()
    await anyio.sleep(0.1)
    for name in ("ATTITUDE", "SYSTEM_TIME"):
        number = LAYOUTS[name].number
        assert await ground.ask(MavCommand.SET_MESSAGE_INTERVAL, number, 1000) is MavResult.ACCEPTED
    number = LAYOUTS["GLOBAL_POSITION_INT"].number
    assert await ground.ask(MavCommand.SET_MESSAGE_INTERVAL, number, -1) is MavResult.ACCEPTED
    ground.heard.clear()
    other.heard.clear()
    await anyio.sleep(10.0)
    for one, attitudes, times, places in ((ground, 500, 500, 0), (other, 200, 0, 200)):
        assert len(one.all("ATTITUDE")) == pytest.approx(attitudes, abs=3)
        assert len(one.all("SYSTEM_TIME")) == pytest.approx(times, abs=3)
        assert len(one.all("GLOBAL_POSITION_INT")) == pytest.approx(places, abs=3)
    assert await other.ask(MavCommand.GET_MESSAGE_INTERVAL, number) is MavResult.ACCEPTED
    assert other.last("MESSAGE_INTERVAL")["interval_us"] == 50_000
    assert await ground.ask(MavCommand.GET_MESSAGE_INTERVAL, number) is MavResult.ACCEPTED
    assert ground.last("MESSAGE_INTERVAL")["interval_us"] == -1
    number = LAYOUTS["ATTITUDE"].number  # asked for each millisecond; the answer is its rate
    assert await ground.ask(MavCommand.GET_MESSAGE_INTERVAL, number) is MavResult.ACCEPTED
    assert ground.last("MESSAGE_INTERVAL")["interval_us"] == 20_000


@pytest.mark.anyio
@pytest.mark.parametrize(
    ("name", "expected"), [("ATTITUDE", 50_000), ("ALTITUDE", -1), ("HIL_STATE", 0)]
)
async def test_an_interval_is_that_of_the_definitions(
    ground: Ground, name: str, expected: int
) -> None:
    """MESSAGE_INTERVAL: -1 is disabled, 0 not available, and more the interval in µs."""
    number = LAYOUTS[name].number if name in LAYOUTS else 90
    wanted = LAYOUTS["MESSAGE_INTERVAL"].number
    assert await ground.ask(MavCommand.REQUEST_MESSAGE, wanted, number) is MavResult.ACCEPTED
    assert ground.last("MESSAGE_INTERVAL")["message_id"] == number
    assert ground.last("MESSAGE_INTERVAL")["interval_us"] == expected


@pytest.mark.anyio
async def test_nobody_counts_as_lost_what_went_to_another(rig: Rig, ground: Ground) -> None:
    """Ground stations show how many are missing by the numbers of the frames."""
    other = Ground(rig, ("127.0.0.1", 7000), 246)
    other.beat()
    await anyio.sleep(0.1)
    rig.sent.clear()
    ground.command(MavCommand.SET_MESSAGE_INTERVAL, LAYOUTS["ATTITUDE"].number, 1000)
    ground.send("PARAM_REQUEST_LIST", target_system=1, target_component=1)
    await anyio.sleep(2.0)
    for one in (ground, other):
        numbers = []
        for data, address in rig.sent:
            at = 0
            while address == one.address and at < len(data):
                numbers.append(data[at + 4])
                at += data[at + 1] + 12
        assert len(numbers) > 100
        steps = {(after - before) % 256 for before, after in itertools.pairwise(numbers)}
        assert steps == {1}


@pytest.mark.anyio
async def test_request_data_stream_is_obeyed_for_who_asks(rig: Rig, ground: Ground) -> None:
    other = Ground(rig, ("127.0.0.1", 7000), 246)
    other.beat()
    fields = {"target_system": 1, "target_component": 1, "req_stream_id": 10}
    ground.send("REQUEST_DATA_STREAM", req_message_rate=2, start_stop=1, **fields)
    await anyio.sleep(0.1)
    ground.heard.clear()
    other.heard.clear()
    await anyio.sleep(10.0)
    assert len(ground.all("ATTITUDE")) == pytest.approx(20, abs=1)
    assert len(other.all("ATTITUDE")) == pytest.approx(200, abs=2)
    ground.send("REQUEST_DATA_STREAM", req_message_rate=2, start_stop=0, **fields)
    await anyio.sleep(0.1)
    ground.heard.clear()
    await anyio.sleep(2.0)
    assert ground.all("ATTITUDE") == []


# -- texts as common.xml has them: 50 characters, parts in order, and never a flood ----------------


def texts_of(text: str) -> list[tuple[str, int]]:
    one = Texts()
    one.tell(Severity.WARNING, text)
    found = list(one.due(1.0))
    assert {message["severity"] for message in found} == {4}
    assert len({message.fields.get("id", 0) for message in found}) == 1
    return [(message["text"], message.fields.get("chunk_seq", 0)) for message in found]


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        ("short", ["short"]),
        ("a" * 50, ["a" * 50]),
        ("a" * 50 + "b", ["a" * 50, "b"]),
        # one that is full is followed by another one: an empty one says that it is over
        ("a" * 50 + "b" * 50, ["a" * 50, "b" * 50, ""]),
        ("".join(f"{n:03d}-" for n in range(70)), None),
        ("two\n lines\t and  ü", ["two lines and ?"]),
    ],
)
def test_a_text_is_sent_in_parts_of_fifty(text: str, parts: list[str] | None) -> None:
    expected = [text[begin : begin + 50] for begin in range(0, 200, 50)] if parts is None else parts
    assert texts_of(text) == [(part, number) for number, part in enumerate(expected)]


def test_parts_of_one_text_have_a_number_of_their_own() -> None:
    one, numbers = Texts(), []
    for letter in "abc":
        one.tell(Severity.INFO, letter * 60)
        numbers += [message["id"] for message in one.due(1.0)]
    assert numbers == [1, 1, 2, 2, 3, 3]


def test_none_comes_twice_in_two_seconds_and_not_more_than_ten_a_second() -> None:
    one, count = Texts(), []
    for at in (10.0, 11.0, 11.9, 12.1):
        one.tell(Severity.ERROR, "again")
        count.append(len(list(one.due(at))))
    assert count == [1, 0, 0, 1]
    flood = Texts()
    for at in range(10):
        for number in range(100):
            flood.tell(Severity.INFO, f"{at} {number}")
        count.append(len(list(flood.due(100.0 + at))))
    assert count[4] == 20
    assert set(count[5:]) == {10}


@pytest.mark.parametrize(
    ("level", "severity"), [("info", 6), ("warning", 4), ("error", 3), ("another", 6)]
)
def test_how_bad_an_event_is(level: str, severity: int) -> None:
    assert severity_of(level) == severity
