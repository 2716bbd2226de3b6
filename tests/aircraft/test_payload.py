"""Pointing the gimbal: what reaches the aircraft, what telemetry shows, what is refused."""

from __future__ import annotations

import asyncio
import math
from collections.abc import AsyncIterator

import pytest

from m100link import (
    Aircraft,
    CommandNotSupported,
    Credentials,
    Gimbal,
    LevelTooLow,
    LineBlocked,
    LinkClosed,
    LinkError,
    NotActivated,
    NotObserved,
    TelemetryStalled,
    UsageError,
)
from m100link.protocol.commands.gimbal import GimbalAngle, GimbalSpeed
from m100link.sim import AssistantSettings, VirtualClockEventLoop
from m100link.testing import ConnectableAircraft
from tests.rig import Rig, rig

pytestmark = pytest.mark.anyio


@pytest.fixture
def anyio_backend() -> object:
    return "asyncio", {"loop_factory": VirtualClockEventLoop}


@pytest.fixture
async def flown() -> AsyncIterator[Rig]:
    async with rig(firmware="3.1") as made:
        yield made


def commands(flown: Rig, kind: type) -> list[tuple[float, object]]:
    """The commands of that class that arrived, and when."""
    received = flown.virtual.autopilot.received_commands
    return [(one.time, one.command) for one in received if isinstance(one.command, kind)]


# -- angles ---------------------------------------------------------------------------------------


async def test_angles_are_sent_and_axes_that_are_not_named_are_left_alone(flown: Rig) -> None:
    gimbal = flown.aircraft.gimbal
    await gimbal.set_angles(pitch=-45, yaw=30, seconds=1.5)
    await asyncio.sleep(2.0)
    assert (seen := flown.aircraft.state.gimbal)
    assert (seen.pitch_deg, seen.yaw_deg, seen.roll_deg) == pytest.approx((-45, 30, 0), abs=0.2)
    await gimbal.set_angles(roll=10)
    await asyncio.sleep(1.5)
    assert (seen := flown.aircraft.state.gimbal)
    assert (seen.pitch_deg, seen.yaw_deg, seen.roll_deg) == pytest.approx((-45, 30, 10), abs=0.2)
    assert [command for _, command in commands(flown, GimbalAngle)] == [
        GimbalAngle(30.0, 0.0, -45.0, mode=0b0101, duration_s=1.5),
        GimbalAngle(0.0, 10.0, 0.0, mode=0b1011, duration_s=1.0),
    ]
    assert "pitch -45.0°" in repr(gimbal)


async def test_it_returns_when_sent_or_when_telemetry_shows_the_angles(flown: Rig) -> None:
    gimbal, began_at = flown.aircraft.gimbal, flown.now
    await gimbal.set_angles(pitch=-30, seconds=2)
    assert flown.now == began_at
    await gimbal.set_angles(pitch=-60, yaw=-90, seconds=2, wait=True)
    assert 1.5 < flown.now - began_at < 2.2
    assert (seen := flown.aircraft.state.gimbal)
    assert (seen.pitch_deg, seen.yaw_deg) == pytest.approx((-60, -90), abs=1.6)


async def test_relative_angles_are_waited_for_from_where_it_looked(flown: Rig) -> None:
    gimbal = flown.aircraft.gimbal
    await gimbal.set_angles(pitch=-40, yaw=170, wait=True)
    await gimbal.set_angles(pitch=10, yaw=20, relative=True, wait=True)
    assert (seen := flown.aircraft.state.gimbal)
    assert seen.pitch_deg == pytest.approx(-30, abs=1.6)
    assert seen.yaw_deg % 360.0 == pytest.approx(190, abs=1.6)


async def test_straight_down_only_the_pitch_is_waited_for(
    flown: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    mount = flown.virtual.vehicle.gimbal
    mount.point(GimbalAngle(90.0, 0.0, 0.0, 1, 0.1))  # the yaw is elsewhere
    await asyncio.sleep(0.5)
    monkeypatch.setattr(type(mount), "_shortest_way", lambda self, yaw: self.yaw)  # and stays there
    await flown.aircraft.gimbal.set_angles(pitch=-90, yaw=0, wait=True)
    with pytest.raises(NotObserved, match=r"yaw 0\.0°"):
        await flown.aircraft.gimbal.set_angles(pitch=-20, yaw=0, wait=True)


async def test_an_axis_at_its_stop_is_named_when_the_angle_does_not_show(flown: Rig) -> None:
    gimbal, began_at = flown.aircraft.gimbal, flown.now
    await gimbal.set_angles(pitch=-80, wait=True)
    with pytest.raises(NotObserved, match="shows pitch -90") as raised:
        await gimbal.set_angles(pitch=-60, relative=True, wait=True, timeout=2.5)
    assert raised.value.cause == "at its stop: pitch"
    assert raised.value.situation["gimbal"] == {"yaw": 0.0, "roll": 0.0, "pitch": -90.0}
    assert flown.now - began_at < 4.0


@pytest.mark.parametrize(
    ("rates", "seen"), [({"gimbal": 0}, "has never come"), ({}, r"came \d\.\d s ago")]
)
async def test_an_item_that_is_not_sent_is_reported_before_anything_is_sent(
    rates: dict[str, int], seen: str
) -> None:
    async with rig(firmware="3.1", assistant=AssistantSettings(rates_hz=rates)) as flown:
        if not rates:
            flown.virtual.autopilot.set_rates({"gimbal": 0})
            await asyncio.sleep(2.0)
        with pytest.raises(TelemetryStalled, match=f"nothing was sent.*{seen}"):
            await flown.aircraft.gimbal.set_angles(pitch=-45, wait=True)
        assert commands(flown, GimbalAngle) == []
        await flown.aircraft.gimbal.set_angles(pitch=-45)
        await asyncio.sleep(1.2)
        assert flown.virtual.vehicle.gimbal.pitch == -45.0


async def test_an_item_that_stops_meanwhile_is_the_cause(flown: Rig) -> None:
    waiting = asyncio.create_task(
        flown.aircraft.gimbal.set_angles(pitch=-45, wait=True, timeout=5.0)
    )
    await asyncio.sleep(0.1)
    flown.virtual.autopilot.set_rates({"gimbal": 0})
    with pytest.raises(NotObserved) as raised:
        await waiting
    assert raised.value.cause.startswith("the gimbal item stopped 4.")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"pitch": 31}, "pitch 31 °.*-90 to 30"),
        ({"pitch": math.nan}, "pitch nan °.*-90 to 30"),
        ({"yaw": -321}, "yaw -321 °.*-320 to 320"),
        ({"roll": math.inf}, "roll inf °.*-35 to 35"),
        ({"pitch": 0, "seconds": 0}, "seconds 0 s.*0.1 to 25.5"),
        ({"pitch": 0, "seconds": 26}, "seconds 26 s.*0.1 to 25.5"),
        ({}, "no angle was given"),
    ],
)
async def test_what_cannot_be_asked_names_the_field_and_its_limit(
    flown: Rig, arguments: dict[str, float], words: str
) -> None:
    for wait in (False, True):
        with pytest.raises(UsageError, match=f"(?s){words}"):
            await flown.aircraft.gimbal.set_angles(**arguments, wait=wait)  # type: ignore[arg-type]
    assert commands(flown, GimbalAngle) == []


# -- rates ----------------------------------------------------------------------------------------


async def test_one_rate_command_holds_for_half_a_second(flown: Rig) -> None:
    await flown.aircraft.gimbal.set_angular_rates(yaw=20, pitch=-10)
    await asyncio.sleep(2.0)
    mount = flown.virtual.vehicle.gimbal
    assert (mount.yaw, mount.pitch) == pytest.approx((10, -5), abs=1.1)
    assert len(commands(flown, GimbalSpeed)) == 1


async def test_for_some_seconds_it_is_repeated_ten_times_a_second_then_stopped(flown: Rig) -> None:
    await flown.aircraft.gimbal.set_angular_rates(pitch=-10, seconds=3)
    await asyncio.sleep(0.2)
    sent = commands(flown, GimbalSpeed)
    assert 30 <= len(sent) <= 32
    assert sent[-1][1] == GimbalSpeed()
    mount = flown.virtual.vehicle.gimbal
    assert mount.pitch == pytest.approx(-30, abs=1.0)
    await asyncio.sleep(2.0)
    assert mount.pitch == pytest.approx(-30, abs=1.0)


async def test_a_block_turns_it_until_it_is_left_in_whatever_way(flown: Rig) -> None:
    gimbal, mount = flown.aircraft.gimbal, flown.virtual.vehicle.gimbal

    async def look_around() -> None:
        async with gimbal.hold_angular_rates(yaw=30) as rates:
            await asyncio.sleep(2.0)
            rates.set(pitch=-30)
            with pytest.raises(UsageError, match=r"yaw rate 200 °/s.*"):
                rates.set(yaw=200)
            await asyncio.sleep(60.0)

    looking = asyncio.create_task(look_around())
    await asyncio.sleep(3.0)
    looking.cancel()
    with pytest.raises(asyncio.CancelledError):
        await looking
    await asyncio.sleep(0.1)
    before = mount.yaw, mount.pitch
    assert before == pytest.approx((60, -30), abs=4.0)
    await asyncio.sleep(3.0)
    assert (mount.yaw, mount.pitch) == before
    assert not any(task.get_name() == "m100link gimbal" for task in asyncio.all_tasks())


async def lose_the_line(flown: Rig, error: Exception | None = None) -> None:
    async with flown.aircraft.gimbal.hold_angular_rates(yaw=30):
        await flown.aircraft.link.close()
        await asyncio.sleep(1.0)
        if error is not None:
            raise error


async def test_a_line_that_is_lost_ends_the_block(flown: Rig) -> None:
    with pytest.raises(LinkError):
        await lose_the_line(flown)


async def test_an_error_of_the_program_comes_before_that_of_the_line(flown: Rig) -> None:
    with pytest.raises(KeyError):
        await lose_the_line(flown, KeyError("mine"))


@pytest.mark.parametrize("axis", ["yaw", "pitch", "roll"])
@pytest.mark.parametrize("rate", [-180.1, 181.0, math.nan, math.inf])
async def test_a_rate_beyond_its_limit_is_not_sent(flown: Rig, axis: str, rate: float) -> None:
    with pytest.raises(UsageError, match=f"(?s){axis} rate.*-180 to 180 °/s"):
        await flown.aircraft.gimbal.set_angular_rates(**{axis: rate})
    with pytest.raises(UsageError, match=r"(?s)seconds nan s"):
        await flown.aircraft.gimbal.set_angular_rates(yaw=1, seconds=math.nan)
    assert commands(flown, GimbalSpeed) == []


# -- who may --------------------------------------------------------------------------------------


async def test_no_control_authority_is_needed_and_none_is_taken(flown: Rig) -> None:
    """G1."""
    await flown.aircraft.gimbal.set_angles(pitch=-45, wait=True)
    assert flown.virtual.vehicle.authority.device.name == "RC"
    assert not flown.virtual.vehicle.authority.is_requested


async def test_before_activation_it_is_refused_and_not_lost_in_silence() -> None:
    async with rig(firmware="3.1", activated=False) as flown:
        with pytest.raises(NotActivated, match="gimbal_angle was not sent"):
            await flown.aircraft.gimbal.set_angles(pitch=-45)
        assert commands(flown, GimbalAngle) == []


async def test_an_aircraft_that_another_program_activated_obeys_plain_commands() -> None:
    virtual = ConnectableAircraft(seed=1, firmware="3.1")
    async with virtual.connect() as first, virtual.connect() as second:
        await first.activate(virtual.credentials)
        await _point(second)
    virtual.stop()


async def _point(aircraft: Aircraft) -> None:
    await aircraft.gimbal.set_angles(pitch=-45, wait=True)
    assert aircraft.state.get(Gimbal) is not None


async def test_level_0_is_refused_where_the_firmware_has_levels() -> None:
    async with rig(firmware="2.3", activated=False) as flown:
        known = flown.virtual.credentials
        await flown.aircraft.activate(Credentials(known.app_id, known.key, level=0))
        with pytest.raises(LevelTooLow, match="gimbal_angle was not sent"):
            await flown.aircraft.gimbal.set_angles(pitch=-45)
        await flown.aircraft.activate(Credentials(known.app_id, known.key, level=1))
        await flown.aircraft.gimbal.set_angles(pitch=-45)


async def test_firmware_1_0_has_no_such_command() -> None:
    async with rig(firmware="1.0") as flown:
        with pytest.raises(CommandNotSupported, match="nothing was sent"):
            await flown.aircraft.gimbal.set_angles(pitch=-45)
        with pytest.raises(CommandNotSupported, match="nothing was sent"):
            await flown.aircraft.gimbal.set_angular_rates(pitch=-45, seconds=1)


# -- the camera: sent, and nobody confirms ---------------------------------------------------------


@pytest.mark.parametrize("firmware", ["2.3", "3.1"])
async def test_photographs_and_video_reach_the_camera_without_authority(firmware: str) -> None:
    async with rig(firmware=firmware) as flown:
        camera, virtual = flown.aircraft.camera, flown.virtual.vehicle.camera
        began_at = flown.now
        await camera.take_photo()
        await camera.start_video()
        assert flown.now == began_at  # nobody is waited for
        await asyncio.sleep(0.1)
        assert (virtual.photos, virtual.is_recording) == (1, True)
        await camera.stop_video()
        await asyncio.sleep(0.1)
        assert not virtual.is_recording
        assert not flown.virtual.vehicle.authority.is_requested


async def test_what_would_be_lost_in_silence_is_refused() -> None:
    async with rig(firmware="3.1", activated=False) as flown:
        with pytest.raises(NotActivated, match="take_photo was not sent"):
            await flown.aircraft.camera.take_photo()
    async with rig(firmware="1.0") as flown:
        with pytest.raises(CommandNotSupported, match="nothing was sent"):
            await flown.aircraft.camera.start_video()


async def test_a_line_that_does_not_drain_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    async with rig(firmware="3.1") as flown:
        monkeypatch.setattr(flown.aircraft.link, "push", lambda *_, **__: False)
        with pytest.raises(LineBlocked, match="take_photo was not sent: the line takes no more"):
            await flown.aircraft.camera.take_photo()
        monkeypatch.undo()
        await flown.aircraft.aclose()
        with pytest.raises(LinkClosed):
            await flown.aircraft.camera.take_photo()
