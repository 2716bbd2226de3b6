"""Motors on the ground: started, stopped, refused in the air, and not left running."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable

import pytest

from m100link import (
    CommandNotSupported,
    Control,
    FlightPhase,
    GuardRefused,
    NoAuthority,
    NotObserved,
    Setpoint,
    TaskFailed,
    TaskRefused,
    TelemetryStalled,
)
from m100link.flight.stop_path import StopAction
from m100link.protocol.codes import ArmCode
from m100link.protocol.commands.control import Arm
from m100link.sim import AircraftSettings, AssistantSettings
from m100link.sim.vehicle.sensors import Sensors
from tests.rig import NORTH, Rig, put_in_the_air, rig

pytestmark = pytest.mark.anyio

UP = Setpoint.velocity(north=0, east=0, up=1.0, yaw_rate_deg_s=0)


@pytest.fixture
async def flown() -> AsyncIterator[Rig]:
    async with rig(firmware="3.1") as made:
        yield made


def arms(flown: Rig) -> list[tuple[bool, int | None]]:
    """What was asked of the motors, and what the aircraft said."""
    received = flown.virtual.autopilot.received_commands
    return [(bool(one.command.on), one.code) for one in received if isinstance(one.command, Arm)]


async def climb(control: Control, seconds: float) -> None:
    async for tick in control.ticks():
        if tick.elapsed >= seconds:
            return
        control.send(UP)


async def test_motors_start_and_stop_on_the_ground(flown: Rig) -> None:
    async with flown.aircraft.control() as control:
        await control.arm()
        seen = [(flown.is_running, flown.phase)]
        await control.arm()  # already
        await control.disarm()
        seen.append((flown.is_running, flown.phase))
        assert seen == [(True, FlightPhase.STANDBY), (False, FlightPhase.STANDBY)]
        await control.disarm()
    assert arms(flown) == [(True, 0), (True, 2), (False, 0), (False, 2)]
    assert flown.is_released


async def test_a_setpoint_that_climbs_takes_it_off_from_there(flown: Rig) -> None:
    async with flown.aircraft.control() as control:
        await control.arm()
        await climb(control, 3.0)
        await control.land()
    assert not flown.is_running
    assert flown.phase is FlightPhase.STANDBY


async def test_in_the_air_no_disarm_is_sent(flown: Rig) -> None:
    async with flown.aircraft.control(stop="land") as control:
        await control.take_off()
        with pytest.raises(TaskRefused, match="refused: the aircraft is in the air") as raised:
            await control.disarm()
        assert raised.value.code == ArmCode.IN_THE_AIR
        assert raised.value.remedy == "land first"
        assert raised.value.situation["flight_status"] == "IN_AIR"
        assert arms(flown) == []
        assert flown.phase is FlightPhase.IN_AIR


async def test_an_aircraft_that_refuses_is_believed(
    flown: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Telemetry said "on the ground" a moment ago."""
    async with flown.aircraft.control(stop="land") as control:
        await control.take_off()
        monkeypatch.setattr("m100link.flight.tasks.is_on_ground", lambda _: True)
        with pytest.raises(TaskRefused, match=r"in the air \(code 3"):
            await control.disarm()
        assert arms(flown) == [(False, 3)]
        assert flown.is_running


async def test_when_nobody_knows_whether_it_flies_no_disarm_is_sent() -> None:
    assistant = AssistantSettings(rates_hz={"flight_status": 0})
    async with (
        rig(firmware="3.1", assistant=assistant) as flown,
        flown.aircraft.control() as control,
    ):
        await control.arm()
        with pytest.raises(TelemetryStalled, match="nobody knows"):
            await control.disarm()
        assert arms(flown) == [(True, 0)]


async def test_a_stand_that_the_velocity_contradicts_is_no_flight(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """An operator beside it hears why the motors run on, and not that it is in the air."""
    for item, wrong in (
        ("flight_status", (FlightPhase.STANDBY,)),
        ("velocity", (0.0, 0.0, 0.9, 7)),
    ):
        read = getattr(Sensors, f"_read_{item}")

        def told(
            sensors: Sensors, read: Callable[[Sensors], object] = read, wrong: object = wrong
        ) -> object:
            return wrong if lies else read(sensors)

        monkeypatch.setattr(Sensors, f"_read_{item}", told)
    lies = False
    async with rig(firmware="3.1") as flown, flown.aircraft.control(stop="land") as control:
        await control.take_off()
        lies = True
        await asyncio.sleep(0.5)
        with pytest.raises(TelemetryStalled, match="nobody knows") as raised:
            await control.disarm()
        lies = False
        assert "velocity or height contradicts it" in raised.value.cause
        assert arms(flown) == []


async def test_without_authority_nothing_is_sent(flown: Rig) -> None:
    """A1."""
    control = flown.aircraft.control()
    for method in (control.arm, control.disarm):
        with pytest.raises(NoAuthority, match="nothing was sent"):
            await method()
    assert arms(flown) == []


async def test_the_guards_of_a_take_off_come_before_the_blades() -> None:
    async with rig(firmware="3.1") as flown, flown.aircraft.control() as control:
        flown.virtual.vehicle.flight.battery_percent = 15.0
        await asyncio.sleep(1.5)
        with pytest.raises(GuardRefused, match="battery has 15 %"):
            await control.arm()
        assert arms(flown) == []


async def test_older_firmware_is_not_asked() -> None:
    async with rig(firmware="2.3") as flown, flown.aircraft.control() as control:
        with pytest.raises(CommandNotSupported, match="nothing was sent"):
            await control.arm()


async def test_one_thing_at_a_time(flown: Rig) -> None:
    async with flown.aircraft.control(stop="land") as control:
        taking_off = asyncio.create_task(control.take_off())
        await asyncio.sleep(0.5)
        for method in (control.arm, control.disarm):
            with pytest.raises(TaskRefused, match="during take off"):
                await method()
        await taking_off
        assert arms(flown) == []


async def test_k7_a_take_off_with_running_motors_fails_and_says_so(flown: Rig) -> None:
    async with flown.aircraft.control() as control:
        await control.arm()
        with pytest.raises(TaskFailed, match="began and failed"):
            await control.take_off()
        await control.disarm()
        await control.take_off()
        assert flown.phase is FlightPhase.IN_AIR


# -- how it ends ----------------------------------------------------------------------------------


@pytest.mark.parametrize("slack_s", [0.0, 1.5])
@pytest.mark.parametrize("stop", ["hover", "land"])
async def test_blades_that_never_flew_do_not_run_on(
    flown: Rig, stop: StopAction, slack_s: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    given = property(lambda _: slack_s, lambda *_: None)
    monkeypatch.setattr(type(flown.aircraft.link.latency), "slack_s", given)

    async def program() -> None:
        async with flown.aircraft.control(stop=stop) as control:
            await control.arm()
            control.send(NORTH)  # does not lift it
            await asyncio.sleep(0.1)
            raise KeyError

    with pytest.raises(KeyError):
        await program()
    assert not flown.is_running
    assert arms(flown)[-1] == (False, 0)
    assert flown.is_released


@pytest.mark.parametrize("stop", ["hover", "land"])
@pytest.mark.parametrize("seconds", [0.2, 0.5, 1.0, 1.5, 3.0])
@pytest.mark.parametrize("status_hz", [1, 10, 0])
async def test_what_has_lifted_off_is_never_disarmed(
    stop: StopAction, seconds: float, status_hz: int
) -> None:
    assistant = AssistantSettings(rates_hz={"flight_status": status_hz})
    async with rig(firmware="3.1", assistant=assistant) as flown:
        async with flown.aircraft.control(stop=stop) as control:
            await control.arm()
            await climb(control, seconds)
        if flown.phase is not FlightPhase.STANDBY:  # in the air
            assert (False, 0) not in arms(flown)
        assert flown.is_released
        if stop == "land":
            assert flown.phase is FlightPhase.STANDBY
        elif seconds >= 1.0:
            assert flown.phase is FlightPhase.IN_AIR
            await flown.assert_hovers()


@pytest.mark.parametrize("stop", ["hover", "land"])
@pytest.mark.parametrize("was_there", [False, True])
async def test_at_the_end_no_disarm_is_sent_when_nobody_knows_whether_it_flies(
    stop: StopAction, was_there: bool, caplog: pytest.LogCaptureFixture
) -> None:
    """No setpoint lifted it; somebody by the remote control may have."""
    async with rig(firmware="3.1") as flown:
        if not was_there:
            flown.virtual.set_rates(flight_status=0)
            await asyncio.sleep(3.0)
        async with flown.aircraft.control(stop=stop) as control:
            await control.arm()
            flown.virtual.set_rates(flight_status=0)
            await asyncio.sleep(3.0)
        assert arms(flown) == [(True, 0)]
        assert flown.is_running
        assert flown.is_released
    assert "the motors were not stopped: nobody knows whether it stands" in caplog.text


async def test_the_taker_of_the_aircraft_has_the_motors_too(flown: Rig) -> None:
    async def program() -> None:
        async with flown.aircraft.control() as control:
            await control.arm()
            flown.virtual.leave_f()
            await asyncio.sleep(5.0)

    with pytest.raises(Exception, match="pilot"):
        await program()
    assert flown.is_running
    assert arms(flown) == [(True, 0)]


async def test_armed_motors_stop_by_themselves() -> None:
    """A3: what is left when the program dies."""
    settings = AircraftSettings(armed_idle_seconds=5.0)
    async with rig(firmware="3.1", settings=settings) as flown:
        async with flown.aircraft.control() as control:
            await control.arm()
            await asyncio.sleep(5.5)
            assert not flown.is_running


async def test_motors_that_waited_for_the_guards_do_not_start_behind_the_block(
    flown: Rig,
) -> None:
    asked: list[asyncio.Task[None]] = []

    async def program() -> None:
        async with flown.aircraft.control() as control:
            flown.virtual.set_rates(position=0)
            await asyncio.sleep(2.0)
            asked.append(asyncio.create_task(control.arm()))
            await asyncio.sleep(0.5)

    await program()
    flown.virtual.set_rates(position=50)
    with pytest.raises(NoAuthority, match="over with this block"):
        await asked[0]
    assert arms(flown) == []
    assert not flown.is_running


async def test_motors_that_are_said_to_stop_in_the_air_are_not_believed_to(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """It takes off as it answers: somebody else's hand, or an answer about another order."""
    async with rig(firmware="3.1") as flown, flown.aircraft.control() as control:
        await control.arm()
        flight = flown.virtual.vehicle.flight

        def take(*_: object) -> ArmCode:
            put_in_the_air(flown.virtual)
            return ArmCode.DONE

        monkeypatch.setattr(flight, "arm", take)
        with pytest.raises(NotObserved, match="tells of IN_AIR"):
            await control.disarm()
