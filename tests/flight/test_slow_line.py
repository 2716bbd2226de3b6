"""Flights over lines whose answers take up to 10 s, and that lose a tenth of the frames."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from pathlib import Path
from random import Random

import pytest

from m100link import (
    AckTimeout,
    Aircraft,
    BackOff,
    Credentials,
    Envelope,
    Finished,
    FlightPhase,
    GuardRefused,
    Guards,
    LinkLost,
    M100Error,
    NoAnswer,
    Reached,
    Setpoint,
    SilentLine,
    SupervisionState,
    TelemetryStalled,
    Waypoint,
    WaypointPlan,
    connect,
)
from m100link.aircraft.supervising import Supervised
from m100link.geodesy import LocalFrame
from m100link.protocol.records import Device, FlightStatus
from m100link.sim import DEMO_APP_ID, DEMO_KEY
from m100link.sim.line import LineFaults
from m100link.testing import ConnectableAircraft
from tests.apps.cli.conftest import Simulator
from tests.rig import FIRMWARES, NORTH, Rig, put_in_the_air, rig

pytestmark = pytest.mark.anyio

LATENCIES = (0.35, 1.0, 2.0, 5.0)  # each way, s
LOSSES = (0.0, 0.1)


def slow(delay: float, loss: float = 0.0) -> LineFaults:
    return LineFaults(delay=delay, loss=loss)


def now() -> float:
    return asyncio.get_running_loop().time()


async def airborne(flown: Rig, delay: float) -> None:
    """Hovering at 5 m, and the program knows it."""
    put_in_the_air(flown.virtual, 5.0)
    await asyncio.sleep(2 * delay + 1.0)


@pytest.mark.slow
@pytest.mark.parametrize("loss", LOSSES)
@pytest.mark.parametrize("delay", LATENCIES)
async def test_a_flight_from_connection_to_landing(delay: float, loss: float) -> None:
    seed = Random(f"{delay} {loss}").randrange(1 << 30)
    print(f"seed {seed}")  # noqa: T201 (pytest shows it when the test fails)
    firmware = FIRMWARES[seed % 3]
    async with rig(seed=seed, firmware=firmware, faults=slow(delay, loss)) as flown:
        trip = flown.aircraft.statistics().round_trip_s
        assert trip is not None
        assert 2 * delay - 0.001 <= trip < 2 * delay + 0.7
        async with flown.aircraft.control(stop="land") as control:
            await control.take_off()
            assert flown.virtual.height > 1.0
            await flown.fly(control, 2.0)
        assert flown.virtual.height == 0.0
        assert not flown.is_running
        assert flown.virtual.position[0] > 2.0  # it did fly north
        await asyncio.sleep(2 * delay)
        assert flown.is_released


@pytest.mark.slow
@pytest.mark.parametrize("delay", LATENCIES)
async def test_a_program_that_fails_leaves_it_hovering_one_latency_later(delay: float) -> None:
    failed_at = 0.0
    async with rig(seed=5, firmware="3.1", faults=slow(delay)) as flown:
        await airborne(flown, delay)
        with pytest.raises(RuntimeError):
            async with flown.aircraft.control() as control:
                flown.virtual.set_faults(slow(delay, 0.1))
                await flown.fly(control, 2.0 + 2 * delay)
                failed_at = now()
                raise RuntimeError("the program's own")
        await asyncio.sleep(2 * delay)
        stopped_at = next(
            at
            for at, move in zip(flown.moves.times, flown.moves, strict=True)
            if flown.is_neutral(move)
        )
        assert stopped_at - failed_at < delay + 0.1
        flown.assert_stopped_in_order()
        assert flown.is_released
        await flown.assert_hovers()


@pytest.mark.slow
@pytest.mark.parametrize("delay", LATENCIES)
async def test_a_lost_line_is_connected_again_and_activated(delay: float) -> None:
    virtual = ConnectableAircraft(seed=7, faults=slow(delay, 0.1))

    async def open_aircraft() -> Aircraft:
        return await connect(await virtual.open_link())

    supervised = Supervised(
        open_aircraft,
        credentials=virtual.credentials,
        back_off=BackOff(first=0.5),
        random=Random(3),
    )
    async with supervised:
        first = await supervised.connected()
        await asyncio.sleep(20.0)
        assert supervised.aircraft is first, "a slow line was taken for a lost one"
        virtual.driver.hang_up() if hasattr(
            virtual.driver, "hang_up"
        ) else first.link._transport.abort()  # type: ignore[union-attr]
        await asyncio.sleep(0.1)
        assert supervised.state is not SupervisionState.CONNECTED
        second = await supervised.connected()
        assert second is not first
        assert second.is_activated
        await asyncio.sleep(12.0)
        assert supervised.round_trip is None or supervised.round_trip >= 2 * delay - 0.001
    virtual.stop()


@pytest.mark.slow
@pytest.mark.parametrize("loss", LOSSES)
@pytest.mark.parametrize("delay", [0.35, 2.0])
async def test_a_mission_is_uploaded_flown_and_reported(delay: float, loss: float) -> None:
    """Each waypoint of the upload costs a round trip; the autopilot flies it without the line."""
    async with rig(seed=11, firmware="3.1", faults=slow(delay)) as flown:
        await airborne(flown, delay)
        here = flown.aircraft.state.position
        assert here is not None
        frame = LocalFrame(here.latitude_deg, here.longitude_deg)
        corners = ((10.0, 0.0), (10.0, 10.0), (0.0, 10.0), (0.0, 0.0))
        points = [Waypoint(*frame.to_geodetic(*corner), height=8.0) for corner in corners]
        flown.virtual.set_faults(slow(delay, loss))
        began_at = now()
        async with flown.aircraft.control() as control:
            async with control.waypoint_mission(WaypointPlan(points, speed=4.0)) as mission:
                events = [event async for event in mission]
        took = now() - began_at
        # Twice for authority, the task, four waypoints, the start, at the end the release.
        assert took > 8 * 2 * delay
        assert [one.index for one in events if isinstance(one, Reached)] == [0, 1, 2, 3]
        assert isinstance(events[-1], Finished)
        await asyncio.sleep(2 * delay + 1.0)
        assert flown.is_released
        assert flown.virtual.height == pytest.approx(8.0, abs=0.5)


async def test_telemetry_that_stops_on_a_slow_line_has_the_latency_as_a_cause() -> None:
    async with rig(seed=1, faults=slow(1.0)) as flown:
        await airborne(flown, 1.0)
        with pytest.raises(TelemetryStalled, match=r"no telemetry for 1\.0 s") as caught:
            async with flown.aircraft.control() as control:
                flown.virtual.set_faults(LineFaults(delay=1.0, mute=True))
                await flown.fly(control, 20.0)
    assert "the line is slow: 2 s round trip" in caught.value.cause
    assert "stale_telemetry_s" in caught.value.remedy


@pytest.mark.pty
@pytest.mark.slow
def test_over_real_tcp_it_takes_off_is_cut_off_comes_back_and_lands(tmp_path: Path) -> None:
    """The same at 2 and 5 s took 97 and 204 s, at a load of 18 on two cores."""

    async def fly(url: str) -> None:
        async with connect(url) as aircraft:
            assert aircraft.statistics().round_trip_s == pytest.approx(2.0, abs=0.5)
            await aircraft.activate(Credentials(app_id=DEMO_APP_ID, key=DEMO_KEY))
            with pytest.raises(LinkLost):
                async with aircraft.control() as control:
                    await control.take_off()
                    async for _ in control.ticks():
                        control.send(NORTH)
                        aircraft.link._transport.abort()  # type: ignore[union-attr] # it is open
        async with connect(url) as aircraft, aircraft.control(stop="land"):
            assert aircraft.state.flight_status == FlightStatus(FlightPhase.IN_AIR)
        assert aircraft.state.flight_status is not None
        assert aircraft.state.flight_status.phase is FlightPhase.STANDBY

    running = Simulator(tmp_path, "--tcp", "127.0.0.1:0", "--delay", "1", "--activated")
    try:
        asyncio.run(fly(running.port))
    finally:
        running.close()


async def test_an_answer_counts_until_the_time_out_and_not_after_it() -> None:
    virtual = ConnectableAircraft(seed=1, faults=slow(2.0))
    async with virtual.connect(timeout=4.1) as aircraft:
        assert (await aircraft.version()).profile is aircraft.firmware
    virtual.stop()
    virtual = ConnectableAircraft(seed=1, faults=slow(2.0))
    began_at = now()
    with pytest.raises(NoAnswer, match="no answer to a version query") as caught:
        async with virtual.connect(timeout=3.9):
            pytest.fail("connected")
    assert now() - began_at == pytest.approx(3.9)
    assert "answers take longer than 3.9 s" in caught.value.cause
    assert "timeout=" in caught.value.remedy
    virtual.stop()


async def test_one_question_is_asked_under_one_number() -> None:
    virtual = ConnectableAircraft(seed=1, faults=slow(1.0))
    async with virtual.connect() as aircraft:
        await asyncio.sleep(2.5)
        counted = aircraft.statistics()
        assert (counted.acks, counted.foreign_acks, counted.expired) == (1, 0, 0)
        assert counted.duplicate_acks == counted.repeats > 0
    virtual.stop()


async def test_an_aircraft_that_is_heard_and_never_answers_is_waited_for_15_s() -> None:
    virtual = ConnectableAircraft(seed=1)
    virtual.set_faults(LineFaults(), to_aircraft=LineFaults(deaf=True))
    began_at = now()
    with pytest.raises(NoAnswer):
        async with virtual.connect():
            pytest.fail("connected")
    assert now() - began_at == pytest.approx(15.0)
    virtual.stop()


async def test_a_network_that_brings_nothing_is_waited_for_8_s() -> None:
    virtual = ConnectableAircraft(seed=1)
    virtual.set_faults(LineFaults(mute=True))
    began_at = now()
    with pytest.raises(SilentLine):
        async with virtual.connect():
            pytest.fail("connected")
    assert now() - began_at == pytest.approx(8.0)
    virtual.stop()


async def test_a_line_that_becomes_slow_is_learnt_from_the_first_late_answer() -> None:
    async with rig(seed=1) as flown:
        flown.virtual.set_faults(slow(2.0))
        with pytest.raises(AckTimeout):
            await flown.aircraft.version()
        await asyncio.sleep(4.0)  # its answer comes, too late
        await flown.aircraft.version()
        await flown.aircraft.version()


# -- what does not fly over a slow line, and says why ----------------------------------------------


@pytest.mark.parametrize("delay", [1.0, 2.0, 5.0])
async def test_closed_loops_are_refused_with_the_latency_as_the_cause(delay: float) -> None:
    async with rig(seed=1, faults=slow(delay)) as flown:
        await airborne(flown, delay)
        async with flown.aircraft.control() as control:
            flights: tuple[Callable[[], Awaitable[object]], ...] = (
                lambda: control.fly_to(north=5.0, east=0.0, up=0.0),
                lambda: control.fly_path([(5.0, 0.0, 5.0)], speed=2.0),
                lambda: control.orbit(center_north=10.0, center_east=0.0),
            )
            for flight in flights:
                with pytest.raises(GuardRefused, match="the line is slow") as caught:
                    await flight()
                assert caught.value.guard == "round_trip_s"
                assert caught.value.measured == pytest.approx(2 * delay, abs=0.01)
                assert caught.value.limit == 0.8
            for setpoint in (
                Setpoint.tilt(roll_deg=5.0, pitch_deg=0.0, up=0.0, yaw_rate_deg_s=0.0),
                Setpoint.tilt(roll_deg=0.0, pitch_deg=0.0, thrust_percent=45.0, yaw_rate_deg_s=0.0),
            ):
                with pytest.raises(GuardRefused, match="tilt or thrust"):
                    control.send(setpoint)
        assert not [move for move in flown.moves if not flown.is_neutral(move)]


@pytest.mark.slow
@pytest.mark.parametrize("delay", LATENCIES)
async def test_what_the_autopilot_corrects_by_itself_flies_at_any_latency(delay: float) -> None:
    async with rig(seed=1, faults=slow(delay)) as flown:
        await airborne(flown, delay)
        async with flown.aircraft.control() as control:
            await control.climb_to(8.0)
            assert flown.virtual.height == pytest.approx(8.0, abs=0.4)
            await control.turn_to(90.0)


async def test_the_gimbal_is_waited_for_until_telemetry_can_show_it() -> None:
    async with rig(seed=1, firmware="3.1", faults=slow(5.0)) as flown:
        await flown.aircraft.gimbal.set_angles(pitch=-30.0, wait=True)
        assert flown.aircraft.state.gimbal is not None
        assert flown.aircraft.state.gimbal.pitch_deg == pytest.approx(-30.0, abs=2.0)


async def test_closed_loops_fly_at_0_35_s_each_way() -> None:
    async with rig(seed=1, faults=slow(0.35)) as flown:
        await airborne(flown, 0.35)
        async with flown.aircraft.control() as control:
            await control.fly_to(north=10.0, east=0.0, up=0.0)
            assert flown.virtual.position[0] == pytest.approx(10.0, abs=1.0)


async def test_a_program_that_says_so_flies_a_closed_loop_all_the_same() -> None:
    async with rig(seed=1, faults=slow(0.5)) as flown:
        await airborne(flown, 0.5)
        async with flown.aircraft.control(guards=Guards(round_trip_s=None)) as control:
            await control.fly_to(north=10.0, east=0.0, up=0.0)
            assert flown.virtual.position[0] == pytest.approx(10.0, abs=1.0)


@pytest.mark.slow
@pytest.mark.parametrize("delay", [1.0, 5.0])
async def test_the_envelope_ends_earlier_by_what_is_flown_meanwhile(delay: float) -> None:
    """The place is one latency old, and the neutral arrives one later: 5 m/s fly 5 · 2 · delay."""
    guards = Guards(envelope=Envelope(max_radius_m=90.0))
    north = Setpoint.velocity(north=5.0, east=0.0, up=0.0, yaw_rate_deg_s=0.0)
    async with rig(seed=1, faults=slow(delay)) as flown:
        await airborne(flown, delay)
        with pytest.raises(GuardRefused, match="the envelope ends at 90 m"):
            async with flown.aircraft.control(guards=guards) as control:
                async for _ in control.ticks():
                    control.send(north)
        await asyncio.sleep(2 * delay + 6.0)
        assert 70.0 < flown.virtual.position[0] < 90.0 + 5.0  # 5 m to stop


async def test_a_take_off_on_its_way_is_landed_though_telemetry_shows_the_ground() -> None:
    """What arrives within one round trip of the order is from before it."""
    async with rig(seed=1, faults=slow(2.0)) as flown:
        with pytest.raises(M100Error):
            async with flown.aircraft.control(stop="land") as control:
                taking_off = asyncio.ensure_future(control.take_off())
                await asyncio.sleep(3.2)  # flown for a second, and seen on the ground
                assert flown.virtual.height >= 0.0
                taking_off.cancel()
                raise M100Error("the program ends")
        await asyncio.sleep(5.0)
        assert flown.virtual.height == 0.0
        assert not flown.is_running
        assert flown.device is Device.RC
