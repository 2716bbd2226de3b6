"""What a vehicle tells and is asked by messages, of an aircraft that stands on the ground."""

from __future__ import annotations

import math
import struct

import anyio
import pytest

from m100link.apps.mavlink.translator.codec import LAYOUTS
from m100link.apps.mavlink.translator.numbers import MavCommand, MavResult
from m100link.apps.mavlink.translator.parameters import PARAMETERS
from m100link.apps.mavlink.translator.telemetry import STREAMS
from m100link.apps.mavlink.translator.vehicle_state import MODES, Mode
from m100link.protocol.records import FlightPhase, RcMode
from tests.apps.mavlink.conftest import Ground, Rig

OF_FLIGHTS = ("POSITION_TARGET_GLOBAL_INT", "ORBIT_EXECUTION_STATUS")
PAYLOAD = [name for name, one in STREAMS.items() if one.is_of_payload]  # from firmware 2.3 on
ALWAYS = [name for name in STREAMS if name not in (*OF_FLIGHTS, *PAYLOAD)]

pytestmark = pytest.mark.anyio


def number(name: str) -> int:
    return LAYOUTS[name].number


async def counted(ground: Ground, name: str, seconds: float = 4.0) -> float:
    """How often a message comes in a second."""
    known = len(ground.all(name))
    await anyio.sleep(seconds)
    return (len(ground.all(name)) - known) / seconds


# -- telemetry ------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ALWAYS)
async def test_a_message_comes_as_often_as_the_table_says(ground: Ground, name: str) -> None:
    assert await counted(ground, name) == pytest.approx(STREAMS[name].hz, abs=0.6)


@pytest.mark.parametrize("name", ALWAYS)
async def test_a_message_comes_as_often_as_it_is_asked_for(ground: Ground, name: str) -> None:
    asked = MavCommand.SET_MESSAGE_INTERVAL, number(name)
    assert await ground.ask(*asked, 1e6 / 8) is MavResult.ACCEPTED
    assert await counted(ground, name) == pytest.approx(8, abs=0.6)
    assert await ground.ask(MavCommand.GET_MESSAGE_INTERVAL, number(name)) is MavResult.ACCEPTED
    assert ground.last("MESSAGE_INTERVAL")["interval_us"] == 125_000
    assert await ground.ask(*asked, -1) is MavResult.ACCEPTED
    assert await counted(ground, name) == 0
    assert await ground.ask(*asked, 0) is MavResult.ACCEPTED
    assert await counted(ground, name) == pytest.approx(STREAMS[name].hz, abs=0.6)


async def test_nobody_gets_more_than_fifty_a_second(ground: Ground) -> None:
    asked = MavCommand.SET_MESSAGE_INTERVAL, number("ATTITUDE")
    assert await ground.ask(*asked, 10.0) is MavResult.ACCEPTED
    assert await counted(ground, "ATTITUDE") <= 51


@pytest.mark.parametrize("given", [math.nan, math.inf, -math.inf])
async def test_rates_that_are_not_numbers_are_denied(ground: Ground, given: float) -> None:
    asked = MavCommand.SET_MESSAGE_INTERVAL, number("ATTITUDE")
    assert await ground.ask(*asked, given) is MavResult.DENIED
    assert await ground.ask(MavCommand.SET_MESSAGE_INTERVAL, given, 0) in (
        MavResult.UNSUPPORTED,
        MavResult.DENIED,
    )


@pytest.mark.parametrize(
    "name", [*ALWAYS, "AUTOPILOT_VERSION", "AVAILABLE_MODES", "CURRENT_MODE", "HEARTBEAT"]
)
async def test_a_message_is_sent_when_it_is_asked_for(ground: Ground, name: str) -> None:
    assert await ground.ask(MavCommand.REQUEST_MESSAGE, number(name), 0) is MavResult.ACCEPTED
    assert ground.all(name)


@pytest.mark.parametrize("asked", [280, 395, 0x7FFFFF, -1, 1e30])
async def test_a_message_that_is_not_there_is_reported(ground: Ground, asked: float) -> None:
    assert await ground.ask(MavCommand.REQUEST_MESSAGE, asked) is MavResult.UNSUPPORTED


@pytest.mark.parametrize("name", OF_FLIGHTS)
async def test_where_a_flight_leads_is_shown_as_long_as_it_flies(
    rig: Rig, ground: Ground, name: str
) -> None:
    """QGroundControl draws its circle, and its mark of a go-to, from these alone."""
    await ground.fly(5.0)
    assert await ground.ask(MavCommand.REQUEST_MESSAGE, number(name)) == 1  # temporarily rejected
    here = ground.last("GLOBAL_POSITION_INT")
    latitude, longitude = here["lat"] / 1e7 + 2.25e-4, here["lon"] / 1e7  # 25 m north
    place = (latitude, longitude, rig.ground_altitude + 6.0)
    if name == OF_FLIGHTS[0]:
        assert await ground.ask(MavCommand.DO_REPOSITION, 3.0, 0, 0, math.nan, *place) == 0
    else:
        assert await ground.ask(MavCommand.DO_ORBIT, -8.0, 2.0, 0, 0, *place) == 0
    await rig.until(lambda: rig.speed > 1.0)
    await anyio.sleep(3.0)
    [found, *_] = ground.all(name)
    lat, lon = ("lat_int", "lon_int") if name == OF_FLIGHTS[0] else ("x", "y")
    assert found[lat] == pytest.approx(latitude * 1e7, abs=40)  # 0.5 m of a float
    assert found[lon] == pytest.approx(longitude * 1e7, abs=40)
    assert len(ground.all(name)) == pytest.approx(4, abs=2), "once a second"
    assert await ground.set_mode(Mode.HOLD) == 0
    await anyio.sleep(0.2)
    ground.heard.clear()
    await anyio.sleep(3.0)
    assert ground.all(name) == []


async def test_speeds_come_four_times_a_second(ground: Ground) -> None:
    """QGroundControl takes ground speed and climb from VFR_HUD alone, and asks for none."""
    ground.heard.clear()
    await anyio.sleep(5.0)
    assert len(ground.all("VFR_HUD")) == pytest.approx(20, abs=1)


async def test_what_nobody_knows_is_not_a_number(ground: Ground) -> None:
    await anyio.sleep(2.0)
    gps = ground.last("GPS_RAW_INT")
    assert (gps["satellites_visible"], gps["eph"], gps["epv"]) == (255, 0xFFFF, 0xFFFF)
    battery = ground.last("BATTERY_STATUS")
    assert set(battery["voltages"]) == {0xFFFF}
    assert battery["current_battery"] == -1
    status = ground.last("SYS_STATUS")
    assert (status["voltage_battery"], status["current_battery"]) == (0xFFFF, -1)
    rc = ground.last("RC_CHANNELS")
    assert (rc["rssi"], rc["chan7_raw"], rc["chancount"]) == (255, 0xFFFF, 6)
    assert all(math.isnan(one) for one in ground.last("HOME_POSITION")["q"])


async def test_without_gps_there_is_no_place(rig: Rig, ground: Ground) -> None:
    rig.aircraft.gps_health = 2
    await anyio.sleep(2.0)
    ground.heard.clear()
    await anyio.sleep(2.0)
    assert ground.all("GLOBAL_POSITION_INT") == ground.all("LOCAL_POSITION_NED") == []
    assert ground.last("GPS_RAW_INT")["fix_type"] == 2
    assert not ground.last("SYS_STATUS")["onboard_control_sensors_health"] & 0x20


async def test_a_position_that_jumps_is_a_glitch(rig: Rig, ground: Ground) -> None:
    """ESTIMATOR_STATUS_FLAGS: 0x400 GPS glitch, 0x10 and 0x20 absolute position."""
    flight = rig.aircraft.vehicle.flight
    flight.start_motors()
    flight.phase = FlightPhase.IN_AIR
    flight.dynamics.place(0.0, 0.0, 10.0)
    await anyio.sleep(5.0)
    before = ground.last("ESTIMATOR_STATUS")
    assert before["flags"] == 0x37
    assert before["pos_horiz_ratio"] < 1.0
    assert math.isnan(before["vel_ratio"])
    flight.dynamics.place(500.0, 0.0, 10.0)
    await anyio.sleep(1.5)
    assert ground.last("ESTIMATOR_STATUS")["flags"] == 0x401
    assert not ground.last("SYS_STATUS")["onboard_control_sensors_health"] & 0x20
    await anyio.sleep(6.0)
    assert ground.last("ESTIMATOR_STATUS")["flags"] == 0x37
    assert ground.last("SYS_STATUS")["onboard_control_sensors_health"] & 0x20


async def test_an_aircraft_that_is_not_heard_is_silent(rig: Rig, ground: Ground) -> None:
    rig.aircraft.unplug()
    await anyio.sleep(5.0)
    ground.heard.clear()
    await anyio.sleep(5.0)
    assert {one.name for one in ground.heard} <= {"STATUSTEXT"}


async def test_a_switch_out_of_f_is_shown_and_a_refused_arming_says_why(
    rig: Rig, ground: Ground
) -> None:
    rig.aircraft.set_rc_mode(RcMode.A)
    await rig.until(lambda: ground.mode is Mode.ALTCTL)
    assert not ground.armed()
    await anyio.sleep(1.0)
    assert not ground.last("SYS_STATUS")["onboard_control_sensors_health"] & 0x10000000
    assert await ground.ask(MavCommand.COMPONENT_ARM_DISARM, 1) is MavResult.TEMPORARILY_REJECTED
    await rig.until(lambda: "arm: " in ground.texts)
    assert not rig.client.holder.number, "what was not obtained is not kept"


async def test_another_client_that_has_control_is_named(rig: Rig, ground: Ground) -> None:
    rig.agent.leases.acquire("the console", rig.agent.now)
    await anyio.sleep(0.1)
    assert await ground.ask(MavCommand.COMPONENT_ARM_DISARM, 1) is MavResult.TEMPORARILY_REJECTED
    assert await ground.set_mode(Mode.LAND) is MavResult.TEMPORARILY_REJECTED
    await rig.until(lambda: "the console has control" in ground.texts)


async def test_the_flight_log_has_orders_and_no_questions(rig: Rig, ground: Ground) -> None:
    """MAVSDK asks for camera, gimbal and others for ever, and filled the report of a flight."""
    notes: list[str] = []

    def note(text: str, level: str = "info") -> None:
        notes.append(text)

    rig.client.note = note  # type: ignore[method-assign]
    for command in MavCommand:
        if command.name.startswith(("REQUEST", "GET", "SET_M")):
            await ground.ask(command, 259.0)
    assert await ground.ask(MavCommand.MISSION_START) is MavResult.DENIED
    assert [one for one in notes if "):" in one] == [
        "MAVLink 245 at 127.0.0.1:14540: MISSION_START(): DENIED"
    ]


async def test_a_long_text_comes_in_parts(rig: Rig, ground: Ground) -> None:
    text = "x" * 120
    ground.heard.clear()
    rig.agent.journal.note(text)
    await rig.until(lambda: len(ground.all("STATUSTEXT")) >= 3)
    parts = [one for one in ground.all("STATUSTEXT") if one["id"]][-3:]
    assert "".join(one["text"] for one in parts) == text
    assert [one["chunk_seq"] for one in parts] == [0, 1, 2]


async def test_texts_never_flood(rig: Rig, ground: Ground) -> None:
    for place in range(500):
        rig.agent.journal.note(f"text {place}")
    await anyio.sleep(2.0)
    assert len(ground.all("STATUSTEXT")) < 50


# -- parameters -----------------------------------------------------------------------------------


async def test_all_parameters_are_listed(ground: Ground) -> None:
    ground.send("PARAM_REQUEST_LIST", target_system=1, target_component=1)
    await anyio.sleep(0.1)
    told = ground.all("PARAM_VALUE")
    assert [one["param_id"] for one in told] == list(PARAMETERS)
    assert [one["param_index"] for one in told] == list(range(len(PARAMETERS)))
    assert {one["param_count"] for one in told} == {len(PARAMETERS)}


async def test_a_parameter_is_set_inside_its_range_and_nowhere_else(ground: Ground) -> None:
    async def told(name: str) -> tuple[str, bytes]:
        ground.send("PARAM_REQUEST_READ", param_id=name, param_index=-1, target_system=1)
        await anyio.sleep(0.1)
        last = ground.last("PARAM_VALUE")
        return last["param_id"], struct.pack("<f", last["param_value"])

    for name, one in PARAMETERS.items():
        before = await told(name)
        for value in (one.least, one.most) if one.is_settable else ():
            ground.send("PARAM_SET", param_id=name, param_value=value, target_system=1)
            before = name, struct.pack("<f", value)
            assert await told(name) == before
        for value in (one.most + 1, one.least - 1, math.nan, math.inf):
            ground.send("PARAM_SET", param_id=name, param_value=value, target_system=1)
            assert await told(name) == before, value


async def test_an_integer_travels_as_its_bits(ground: Ground) -> None:
    for name, value in (("MAV_SYS_ID", 1), ("SYS_AUTOSTART", 4001), ("COM_FLTMODE1", -1)):
        ground.send("PARAM_REQUEST_READ", param_id=name, param_index=-1, target_system=1)
        await anyio.sleep(0.1)
        raw = struct.pack("<f", ground.last("PARAM_VALUE")["param_value"])
        assert struct.unpack("<i", raw) == (value,)


async def test_a_parameter_that_is_read_only_says_so(rig: Rig, ground: Ground) -> None:
    ground.send("PARAM_SET", param_id="RTL_RETURN_ALT", param_value=30.0, target_system=1)
    await rig.until(lambda: "RTL_RETURN_ALT is read-only" in ground.texts)


# -- modes and everything else --------------------------------------------------------------------


async def test_the_modes_are_listed(ground: Ground) -> None:
    assert await ground.ask(MavCommand.REQUEST_MESSAGE, number("AVAILABLE_MODES"), 0) == 0
    told = ground.all("AVAILABLE_MODES")
    assert [one["mode_name"] for one in told] == [mode.value for mode in MODES]
    assert [one["mode_index"] for one in told] == list(range(1, len(MODES) + 1))
    assert {one["number_modes"] for one in told} == {len(MODES)}


@pytest.mark.parametrize("main", [1, 5, 7, 99])
async def test_a_mode_that_is_not_there_is_denied(ground: Ground, main: int) -> None:
    assert await ground.ask(MavCommand.DO_SET_MODE, 1, main, 0) is MavResult.DENIED


@pytest.mark.parametrize("given", [math.nan, math.inf, -1.0, 1e9])
async def test_numbers_that_are_none_are_denied(ground: Ground, given: float) -> None:
    assert await ground.ask(MavCommand.DO_SET_MODE, given, given, given) is MavResult.DENIED
    assert await ground.ask(MavCommand.DO_SET_STANDARD_MODE, given) is MavResult.DENIED
    assert await ground.ask(MavCommand.COMPONENT_ARM_DISARM, given) is MavResult.DENIED


async def test_pings_are_answered(ground: Ground) -> None:
    ground.send("PING", seq=7)
    ground.send("TIMESYNC", ts1=99)
    assert (ground.last("PING")["seq"], ground.last("PING")["target_system"]) == (7, 245)
    assert ground.last("TIMESYNC")["ts1"] == 99


async def test_the_version_has_its_numbers(ground: Ground) -> None:
    assert await ground.ask(MavCommand.REQUEST_MESSAGE, number("AUTOPILOT_VERSION")) == 0
    version = ground.last("AUTOPILOT_VERSION")
    assert version["flight_sw_version"] >= 0x01040100
    assert version["flight_custom_version"][7] < 100


@pytest.mark.parametrize("version", ["3.17.203", "3.17.203rc1", "3.17.203.dev4"])
async def test_a_version_is_read_from_its_last_number_on(
    ground: Ground, monkeypatch: pytest.MonkeyPatch, version: str
) -> None:
    monkeypatch.setattr("m100link.apps.mavlink.translator.vehicle.__version__", version)
    assert await ground.ask(MavCommand.REQUEST_MESSAGE, number("AUTOPILOT_VERSION")) == 0
    assert ground.last("AUTOPILOT_VERSION")["flight_custom_version"] == (0, 0, 0, 0, 0, 203, 17, 3)


async def test_an_activation_that_is_refused_is_reported(rig: Rig, ground: Ground) -> None:
    rig.aircraft.app.disconnect()
    assert await ground.ask(MavCommand.COMPONENT_ARM_DISARM, 1) is MavResult.TEMPORARILY_REJECTED
    assert not ground.armed()


@pytest.mark.parametrize(
    ("system", "component", "is_ours"),
    [(1, 1, True), (1, 0, True), (0, 0, True), (2, 1, False), (255, 0, False), (1, 154, False)],
)
async def test_what_is_for_another_system_or_component_is_not_done(
    ground: Ground, system: int, component: int, is_ours: bool
) -> None:
    """Zero is all of them. 154 is a gimbal."""
    known = len(ground.heard)
    ground.send("PARAM_REQUEST_LIST", target_system=system, target_component=component)
    arm = {f"param{place}": 0.0 for place in range(1, 8)}
    ground.send(
        "COMMAND_LONG",
        command=MavCommand.COMPONENT_ARM_DISARM,
        target_system=system,
        target_component=component,
        **arm,
    )
    await anyio.sleep(0.5)
    heard = {one.name for one in ground.heard[known:]}
    assert ("PARAM_VALUE" in heard, "COMMAND_ACK" in heard) == (is_ours, is_ours)


async def test_the_sticks_of_a_station_fly_for_that_station(rig: Rig, ground: Ground) -> None:
    """MANUAL_CONTROL: 500 of 1000 forwards, throttle in the middle at 500."""
    await ground.fly(5.0)
    assert not rig.vehicle.is_busy
    flown: list[float] = []

    async def push() -> None:
        for _ in range(100):
            ground.send("MANUAL_CONTROL", target=1, x=500, y=0, z=500, r=0)
            await anyio.sleep(0.05)
            flown.append(rig.speed)

    async with anyio.create_task_group() as group:
        group.start_soon(push)
        await anyio.sleep(0.2)
        assert await ground.set_mode(Mode.POSCTL) is MavResult.ACCEPTED
        assert rig.vehicle.is_busy
    assert max(flown) > 1.0


@pytest.mark.parametrize(("asked_us", "told_us"), [(40_000, 40_000), (-1, -1), (0, 50_000)])
async def test_an_interval_is_reported_in_microseconds(
    ground: Ground, asked_us: int, told_us: int
) -> None:
    """Never is -1; by default it comes 20 times a second."""
    attitude = number("ATTITUDE")
    assert (
        await ground.ask(MavCommand.SET_MESSAGE_INTERVAL, attitude, asked_us) is MavResult.ACCEPTED
    )
    assert await ground.ask(MavCommand.GET_MESSAGE_INTERVAL, attitude) is MavResult.ACCEPTED
    assert ground.last("MESSAGE_INTERVAL")["interval_us"] == told_us
