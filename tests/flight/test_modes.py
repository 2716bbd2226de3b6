"""All 14 control modes flown in both frames under every firmware: where the aircraft goes.

The virtual aircraft faces east, so that ground and body frame differ: forward is east, right is
south. What the bytes of each mode are is pinned by golden vectors in ``tests/protocol``; here it
is seen that the aircraft, which reads them, flies the way their names promise.
"""

from __future__ import annotations

import asyncio
import math
from dataclasses import dataclass

import pytest

from m100link import BadSetpoint, Guards, ReferenceFrame, Setpoint
from m100link.protocol.setpoint import ControlMode, Horizontal, Vertical, Yaw
from m100link.sim import AircraftSettings
from tests.rig import FIRMWARES, rig

pytestmark = pytest.mark.anyio

HEADING = 90.0
SECONDS = 3.0

MODES = [
    ControlMode(horizontal, vertical, yaw)
    for vertical in Vertical
    for horizontal in Horizontal
    for yaw in Yaw
    if vertical is not Vertical.THRUST or horizontal is Horizontal.TILT
]


@dataclass(frozen=True)
class Asked:
    """What a setpoint asks for, and where that leads the aircraft that faces east."""

    setpoint: Setpoint
    north: float  # sign of the way that is expected, 0 where there should be none
    east: float


def asked(mode: ControlMode, frame: ReferenceFrame) -> Asked:
    """A setpoint with a north (or forward) part only, 1 m/s, 4 m or 5 degrees."""
    z = {Vertical.VELOCITY: 0.8, Vertical.HEIGHT: 4.0, Vertical.THRUST: 47.0}[mode.vertical]
    yaw = {Yaw.ANGLE: -150.0, Yaw.RATE: 15.0}[mode.yaw]
    if mode.horizontal is Horizontal.TILT:
        # Negative pitch flies along the axis: north in the ground frame, forward in the body's.
        x, y = 0.0, -5.0
    else:
        x, y = (4.0, 0.0) if mode.horizontal is Horizontal.POSITION_OFFSET else (1.0, 0.0)
    setpoint = Setpoint(mode, x, y, z, yaw, frame)
    return (
        Asked(setpoint, 1.0, 0.0) if frame is ReferenceFrame.GROUND else Asked(setpoint, 0.0, 1.0)
    )


def is_selectable(mode: ControlMode, frame: ReferenceFrame, firmware: str) -> bool:
    """Firmware 1.0 takes tilt in the body frame only."""
    return not (
        mode.horizontal is Horizontal.TILT and frame is ReferenceFrame.GROUND and firmware == "1.0"
    )


def test_there_are_fourteen_modes_and_both_frames_make_twenty_eight() -> None:
    assert [mode.number for mode in MODES] == list(range(1, 15))


@pytest.mark.parametrize("firmware", FIRMWARES)
@pytest.mark.parametrize("frame", ReferenceFrame, ids=lambda f: f.name.lower())
@pytest.mark.parametrize("mode", MODES, ids=lambda m: f"mode{m.number}")
async def test_each_mode_flies_where_it_says(
    mode: ControlMode, frame: ReferenceFrame, firmware: str
) -> None:
    wanted = asked(mode, frame)
    settings = AircraftSettings(heading_deg=HEADING)
    async with rig(firmware=firmware, settings=settings) as flown:
        motion = flown.virtual.vehicle.flight.dynamics
        async with flown.aircraft.control() as control:
            await control.take_off()
            if not is_selectable(mode, frame, firmware):
                count = len(flown.moves)
                with pytest.raises(BadSetpoint, match="body frame only"):
                    control.send(wanted.setpoint)
                assert len(flown.moves) == count
                return
            height = motion.height
            # A body frame that turns would make a circle: no turning while that is looked at.
            straight = wanted.setpoint
            if frame is ReferenceFrame.BODY:
                still = HEADING if mode.yaw is Yaw.ANGLE else 0.0
                straight = Setpoint(mode, straight.x, straight.y, straight.z, still, frame)
            async for tick in control.ticks():
                if tick.elapsed >= SECONDS:
                    break
                control.send(straight)
            north, east = flown.virtual.position
            along, across = (north, east) if frame is ReferenceFrame.GROUND else (east, -north)
            assert along > 0.5, "it does not fly along the axis that was asked for"
            # Tilt in the ground frame lags behind the turning nose a little.
            assert abs(across) < 0.25 * along, "it strays"
            if mode.vertical is Vertical.VELOCITY:
                assert motion.height - height == pytest.approx(0.8 * SECONDS, rel=0.25)
            elif mode.vertical is Vertical.HEIGHT:
                assert motion.height == pytest.approx(4.0, abs=0.3)
            else:
                assert motion.height > height + 0.3, "47 % is a little more than it needs to hover"
            if frame is ReferenceFrame.GROUND:
                await asyncio.sleep(0)
                turned = math.degrees(motion.yaw) - HEADING
                if mode.yaw is Yaw.RATE:
                    assert turned == pytest.approx(15.0 * SECONDS, rel=0.1)
                else:
                    assert math.degrees(motion.yaw) == pytest.approx(-150.0, abs=5.0)


@pytest.mark.parametrize("firmware", FIRMWARES)
async def test_the_default_order_on_the_wire_is_throttle_before_yaw(firmware: str) -> None:
    """The document prints yaw before throttle; every program that DJI shipped sends throttle first.

    Swapped, a climb of 0.5 m/s would be a yaw rate of 0.5 degrees per second, and a turn at
    20 degrees per second a climb at full 4 m/s: one climbs instead of turning. So it is flown
    with values that tell.
    """
    async with rig(firmware=firmware) as flown:
        motion = flown.virtual.vehicle.flight.dynamics
        async with flown.aircraft.control() as control:
            await control.take_off()
            height = motion.height
            for _ in range(100):
                control.send(Setpoint.velocity(north=0, east=0, up=0, yaw_rate_deg_s=20))
                await asyncio.sleep(0.02)
            assert motion.height == pytest.approx(height, abs=0.05)
            # 40° less what the dead time and the lag of the airframe take.
            late = motion.airframe.command_delay + motion.airframe.yaw_time_constant
            assert math.degrees(motion.yaw) == pytest.approx(20.0 * (2.0 - late), rel=0.05)


@pytest.mark.parametrize(
    ("roll", "pitch", "north", "east"),
    [(0, -8, 1, 0), (0, 8, -1, 0), (8, 0, 0, 1), (-8, 0, 0, -1)],
    ids=["pitch down: forward", "pitch up: back", "roll right: right", "roll left: left"],
)
async def test_signs_of_tilt(roll: float, pitch: float, north: int, east: int) -> None:
    async with rig() as flown, flown.aircraft.control() as control:
        await control.take_off()
        start = flown.virtual.position
        for _ in range(100):
            control.send(
                Setpoint.tilt(roll_deg=roll, pitch_deg=pitch, up=0, yaw_rate_deg_s=0),
            )
            await asyncio.sleep(0.02)
        flew = [now - before for now, before in zip(flown.virtual.position, start, strict=True)]
        assert [round(value / max(map(abs, flew))) for value in flew] == [north, east]


@pytest.mark.parametrize("firmware", FIRMWARES)
async def test_stable_mode_exists_in_firmware_3_1_only(firmware: str) -> None:
    """Bit 0 of the flag: stable mode there, the yaw frame before."""
    setpoint = Setpoint.velocity(north=1, east=0, up=0, yaw_rate_deg_s=0, stable=True)
    async with rig(firmware=firmware) as flown, flown.aircraft.control() as control:
        await control.take_off()
        if firmware == "3.1":
            control.send(setpoint)
            await asyncio.sleep(0.02)
            assert flown.moves[-1].control_flag & 1
            return
        with pytest.raises(BadSetpoint, match="no stable mode"):
            control.send(setpoint)
        control.send(Setpoint.velocity(north=1, east=0, up=0, yaw_rate_deg_s=0))
        await asyncio.sleep(0.02)
        assert not flown.moves[-1].control_flag & 1


async def test_a_value_that_no_float_of_the_wire_can_hold_is_refused_not_lost() -> None:
    async with rig() as flown, flown.aircraft.control(guards=Guards(envelope=None)) as control:
        await control.take_off()
        with pytest.raises(BadSetpoint):
            control.send(Setpoint.position_offset(north=1e39, east=0.0, up=0.0, yaw_rate_deg_s=0.0))
        await asyncio.sleep(0.1)
        control.send(Setpoint.velocity(north=1, east=0, up=0, yaw_rate_deg_s=0))
        await asyncio.sleep(0.1)
        assert flown.moves[-1].roll_or_x == 1.0
