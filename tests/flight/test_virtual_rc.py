"""The virtual remote control: sticks that somebody wants, and no others, however it ends."""

from __future__ import annotations

import asyncio
import contextlib
import signal
from collections.abc import AsyncIterator, Callable
from itertools import pairwise
from typing import Any

import pytest

from m100link import (
    AuthorityLost,
    AuthorityRefused,
    CommandNotSupported,
    Envelope,
    GuardRefused,
    Guards,
    LinkClosed,
    LinkError,
    M100Error,
    NoAuthority,
    NotActivated,
    NotObserved,
    TaskRefused,
    TelemetryStalled,
    UsageError,
)
from m100link.flight import virtual_rc
from m100link.flight.lifecycle import StopCause
from m100link.flight.tasks import Deflections
from m100link.flight.virtual_rc import VirtualRc
from m100link.protocol.codes import VersionCode
from m100link.protocol.commands.activation import Version
from m100link.protocol.commands.virtual_rc import CENTRE, VirtualRcData, VirtualRcSettings
from m100link.sim import AssistantSettings
from tests.flight.test_signals import acted, come
from tests.rig import Rig, rig

pytestmark = pytest.mark.anyio

__all__ = ["acted"]  # a fixture

NEUTRAL = (CENTRE,) * 4
OTHER = Version(VersionCode.ACTIVATED, 0xD3D21804, "SDK-v1.0 BETA M100-02.03.10.00")
SHOWN = AssistantSettings(rates_hz={"control_device": 10})


def frames(flown: Rig, kind: type[Any]) -> list[tuple[float, Any]]:
    received = flown.virtual.autopilot.received_commands
    return [(one.time, one.command) for one in received if isinstance(one.command, kind)]


def sticks(flown: Rig) -> list[tuple[float, tuple[int, ...]]]:
    """When channels arrived, and where they put the sticks."""
    return [(at, data.channels[:4]) for at, data in frames(flown, VirtualRcData)]


def switches(flown: Rig) -> list[tuple[float, bool]]:
    return [(at, settings.is_on) for at, settings in frames(flown, VirtualRcSettings)]


def is_on(flown: Rig) -> bool:
    return flown.virtual.vehicle.remote.virtual.is_on


def assert_ended_well(flown: Rig) -> None:
    """Centred sticks were the last, then off; and never two settings within two seconds."""
    assert not is_on(flown)
    assert not flown.virtual.vehicle.remote.virtual.is_locked
    assert [on for _, on in switches(flown)][-1] is False
    assert sticks(flown)[-1][1] == NEUTRAL
    off_at = switches(flown)[-1][0]
    moved = [at for at, where in sticks(flown) if where != NEUTRAL]
    if moved:
        assert [where for at, where in sticks(flown) if at > moved[-1]][:3] == [NEUTRAL] * 3
        assert off_at - moved[-1] > 0.29
    assert not [at for at, _ in sticks(flown) if at > off_at]


@contextlib.asynccontextmanager
async def in_the_air(**options: Any) -> AsyncIterator[Rig]:
    """The pilot hovers at 10 m, the mode switch in F."""
    options.setdefault("assistant", SHOWN)
    async with rig(firmware="3.1", **options) as flown:
        flown.virtual.pilot_takes_off()
        await asyncio.sleep(8.0)
        flown.virtual.vehicle.flight.dynamics.place(0.0, 0.0, 10.0)
        await asyncio.sleep(0.5)
        flown.virtual.autopilot.received_commands.clear()
        yield flown


@pytest.fixture
async def flown() -> AsyncIterator[Rig]:
    async with in_the_air() as made:
        yield made


# -- flying ---------------------------------------------------------------------------------------


async def test_it_flies_without_authority_and_ends_centred_and_off(flown: Rig) -> None:
    async with flown.aircraft.virtual_rc() as rc:
        assert is_on(flown)
        await rc.hold(4.0, pitch=0.5)
        assert flown.speed == pytest.approx(5.0, abs=0.3)
        assert not flown.virtual.vehicle.authority.is_requested
        assert rc.is_flying
    assert_ended_well(flown)
    await asyncio.sleep(6.0)
    assert flown.speed < 0.05


async def test_channels_go_out_ten_times_a_second_in_p(flown: Rig) -> None:
    async with flown.aircraft.virtual_rc() as rc:
        await rc.hold(3.0, roll=0.2, throttle=-0.3, yaw=0.5)
    times = [at for at, _ in sticks(flown)]
    gaps = [later - earlier for earlier, later in pairwise(times)]
    assert max(gaps) < 0.15
    assert len(times) < 10 * (times[-1] - times[0]) + 8
    assert {data.channels[4:7] for _, data in frames(flown, VirtualRcData)} == {(1324, 1024, 1552)}
    moved = {where for _, where in sticks(flown)} - {NEUTRAL}
    assert moved == {(1024 + 132, 1024, 1024 - 198, 1024 + 330)}


async def test_sticks_that_are_not_renewed_go_back_within_half_a_second(flown: Rig) -> None:
    async with flown.aircraft.virtual_rc() as rc:
        await asyncio.sleep(0.03)  # between two frames: they come 0.1 s apart
        rc.set(pitch=0.5)
        set_at = flown.virtual.vehicle.time
        await asyncio.sleep(2.0)
        moved = [at for at, where in sticks(flown) if where != NEUTRAL]
        back = next(at for at, where in sticks(flown) if at > moved[-1] and where == NEUTRAL)
        assert back - set_at <= 0.52
        assert is_on(flown)
        rc.set(pitch=0.5)
        await asyncio.sleep(0.2)
        assert sticks(flown)[-1][1] != NEUTRAL
    assert_ended_well(flown)


@pytest.mark.parametrize("why", ["renewed", "guard"])
async def test_sticks_are_centred_before_a_log_that_takes_its_time_hears_of_it(
    flown: Rig, monkeypatch: pytest.MonkeyPatch, why: str
) -> None:
    arrived: list[tuple[int, ...]] = []
    warned: list[tuple[int, ...]] = []
    async with flown.aircraft.virtual_rc() as rc:
        push = rc._requests.push

        def pushed(command: VirtualRcData) -> bool:
            arrived.append(command.channels[:4])
            return push(command)

        monkeypatch.setattr(rc._requests, "push", pushed)
        monkeypatch.setattr(virtual_rc._logger, "warning", lambda *_: warned.append(arrived[-1]))
        rc.set(pitch=0.5)
        await asyncio.sleep(0.2)
        if why == "guard":
            flown.virtual.vehicle.flight.battery_percent = 5.0
        await asyncio.sleep(1.0)
        monkeypatch.undo()
    assert warned == [NEUTRAL]
    assert arrived[0] != NEUTRAL


async def test_a_program_that_never_renews_does_not_keep_the_pilot_out(flown: Rig) -> None:
    began_at = flown.now

    async def hang() -> None:
        async with flown.aircraft.virtual_rc() as rc:
            rc.set(pitch=0.5)
            await asyncio.sleep(600.0)

    with pytest.raises(AuthorityLost, match="not renewed for 3 s"):
        await hang()
    assert flown.now - began_at < 9.0
    assert_ended_well(flown)


async def test_another_task_that_lives_renews_nothing(flown: Rig) -> None:
    """The caller of set() is watched, not the event loop."""
    async with flown.aircraft.virtual_rc() as rc:
        holding = asyncio.create_task(rc.hold(60.0, pitch=0.5))
        await asyncio.sleep(1.0)
        holding.cancel()
        await asyncio.sleep(0.15)
        assert sticks(flown)[-1][1] == NEUTRAL
    assert_ended_well(flown)


# -- every ending ---------------------------------------------------------------------------------


async def fly_on(rc: VirtualRc) -> None:
    await rc.hold(600.0, pitch=0.4)


async def fly_for_ever(flown: Rig, error: BaseException | None = None) -> None:
    async with flown.aircraft.virtual_rc() as rc:
        if error is not None:
            await rc.hold(1.0, pitch=0.4)
            rc.set(pitch=0.4)
            raise error
        await fly_on(rc)


async def test_an_exception_ends_it(flown: Rig) -> None:
    with pytest.raises(KeyError):
        await fly_for_ever(flown, KeyError("mine"))
    assert_ended_well(flown)


async def test_one_that_ends_before_it_is_on_is_not_entered() -> None:
    async with rig(firmware="3.1", assistant=SHOWN) as flown:
        rc = flown.aircraft.virtual_rc()
        asyncio.get_running_loop().call_later(0.01, rc._end, StopCause.LEFT)
        with pytest.raises(asyncio.CancelledError):
            async with rc:
                pytest.fail("entered")
        assert (switches(flown), sticks(flown)) == ([], [])


@pytest.mark.parametrize("after", [0.0, 0.5, 1.0, 2.1, 2.25, 2.5, 3.0, 4.0, 5.0, 7.3])
async def test_a_cancellation_ends_it_whenever_it_comes(after: float) -> None:
    async with in_the_air() as flown:
        task = asyncio.create_task(fly_for_ever(flown))
        await asyncio.sleep(after)
        task.cancel()
        with pytest.raises(asyncio.CancelledError):
            await task
        if switches(flown):
            assert_ended_well(flown)
        assert not is_on(flown)
        async with flown.aircraft.control():  # the claim was given back
            pass


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
async def test_a_signal_ends_it_and_then_acts(
    number: signal.Signals,
    acted: list[signal.Signals],
) -> None:
    async with in_the_air() as flown:
        task = asyncio.create_task(fly_for_ever(flown))
        await asyncio.sleep(4.0)
        come(number)
        with pytest.raises(asyncio.CancelledError):
            await task
        assert acted == [number]
        assert_ended_well(flown)


async def test_closing_the_connection_ends_it_first(flown: Rig) -> None:
    task = asyncio.create_task(fly_for_ever(flown))
    await asyncio.sleep(4.0)
    await flown.aircraft.aclose()
    assert_ended_well(flown)
    with pytest.raises(LinkClosed):
        await task


async def test_a_lost_line_ends_it_and_the_aircraft_falls_back_after_a_second(flown: Rig) -> None:
    task = asyncio.create_task(fly_for_ever(flown))
    await asyncio.sleep(4.0)
    lost_at = flown.now
    await flown.aircraft.link.close()
    with pytest.raises(LinkError):
        await task
    assert flown.now - lost_at < 0.5
    await asyncio.sleep(1.2)
    assert not is_on(flown)


async def test_telemetry_that_stalls_ends_it(flown: Rig) -> None:
    task = asyncio.create_task(fly_for_ever(flown))
    await asyncio.sleep(4.0)
    flown.virtual.autopilot.set_rates(dict.fromkeys(flown.virtual.autopilot.rates_hz, 0))
    with pytest.raises(TelemetryStalled):
        await task
    assert_ended_well(flown)


async def test_the_pilot_leaves_f_and_has_the_aircraft_at_once(flown: Rig) -> None:
    """V3."""
    task = asyncio.create_task(fly_for_ever(flown))
    await asyncio.sleep(4.0)
    left_at = flown.virtual.vehicle.time
    flown.virtual.leave_f()
    with pytest.raises(AuthorityLost, match="virtual RC is off") as raised:
        await task
    assert raised.value.reason == "mode_switch"
    assert not is_on(flown)
    assert not [at for at, _ in sticks(flown) if at > left_at + 0.3]
    assert not flown.virtual.vehicle.remote.virtual.is_locked


async def test_a_process_that_stood_still_does_not_go_on(flown: Rig) -> None:
    """The virtual aircraft would stand still with it: only the sticks do here."""

    async def block() -> None:
        async with flown.aircraft.virtual_rc() as rc:
            rc.set(pitch=0.4)
            await asyncio.sleep(0.2)
            assert rc._timer is not None
            rc._timer.cancel()
            await asyncio.sleep(1.5)
            rc.set(pitch=0.4)
            rc._beat()
            await asyncio.sleep(600.0)

    with pytest.raises(NotObserved, match=r"no channels could be sent for 1\.[567]"):
        await block()
    assert not is_on(flown)
    assert not flown.virtual.vehicle.remote.virtual.is_locked
    await asyncio.sleep(6.0)
    assert flown.speed < 0.05


async def test_what_raises_while_sending_ends_it(
    flown: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    task = asyncio.create_task(fly_for_ever(flown))
    await asyncio.sleep(4.0)

    def fail(*_: object) -> None:
        raise RuntimeError("a bug")

    monkeypatch.setattr("m100link.flight.virtual_rc.known", fail)
    with pytest.raises(M100Error, match="cannot be sent: RuntimeError"):
        await task
    assert_ended_well(flown)


async def test_a_line_that_does_not_drain_ends_it(
    flown: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    task = asyncio.create_task(fly_for_ever(flown))
    await asyncio.sleep(4.0)
    monkeypatch.setattr(flown.aircraft.link, "push", lambda *_, **__: False)
    with pytest.raises(NotObserved, match="no channels could be sent"):
        await task
    await asyncio.sleep(1.0)
    assert not is_on(flown)
    with pytest.raises(LinkError, match="not switched on: the line does not drain"):
        await flown.aircraft.virtual_rc().__aenter__()


async def test_without_falling_back_it_goes_home_when_the_program_dies(flown: Rig) -> None:
    async def program() -> None:
        async with flown.aircraft.virtual_rc(fall_back=False) as rc:
            await rc.hold(1.0)
            await flown.aircraft.link.close()
            await asyncio.sleep(600.0)

    with pytest.raises(LinkClosed):
        await program()
    [(_, settings)] = frames(flown, VirtualRcSettings)
    assert settings == VirtualRcSettings(True, falls_back=False)
    await asyncio.sleep(5.0)
    assert flown.virtual.vehicle.authority.failsafe


# -- settings -------------------------------------------------------------------------------------


async def test_v2_blocks_one_behind_the_other_keep_two_seconds_apart(flown: Rig) -> None:
    for _ in range(4):
        async with flown.aircraft.virtual_rc():
            pass
    times = [at for at, _ in switches(flown)]
    assert [on for _, on in switches(flown)] == [True, False] * 4
    assert min(later - earlier for earlier, later in pairwise(times)) >= 2.0
    assert not flown.virtual.vehicle.remote.virtual.is_locked


async def test_v2_the_program_before_may_have_sent_some() -> None:
    async with in_the_air() as flown, flown.virtual.connect() as aircraft:
        aircraft.use_key(flown.virtual.credentials)
        connected_at = flown.virtual.vehicle.time
        async with aircraft.virtual_rc():
            pass
        assert switches(flown)[0][0] - connected_at >= 2.0


# -- who may --------------------------------------------------------------------------------------


async def test_not_beside_a_control_block_and_no_control_block_beside_it(flown: Rig) -> None:
    async with flown.aircraft.control():
        with pytest.raises(UsageError, match="another control block"):
            await flown.aircraft.virtual_rc().__aenter__()
        # It did not free the firmware by which the block flies: another one is not taken now.
        flown.aircraft._requests._choose_firmware(OTHER)
        assert flown.aircraft.firmware.name == "3.1"
    async with flown.aircraft.virtual_rc():
        with pytest.raises(UsageError, match="another control block"):
            await flown.aircraft.control().__aenter__()
        with pytest.raises(UsageError, match="another control block"):
            await flown.aircraft.virtual_rc().__aenter__()
    rc = flown.aircraft.virtual_rc()
    async with rc:
        pass
    with pytest.raises(UsageError, match="entered before"):
        await rc.__aenter__()
    with pytest.raises(NoAuthority, match="nothing was sent"):
        rc.set(pitch=0.5)


@pytest.mark.parametrize("firmware", ["1.0", "2.3"])
async def test_older_firmware_is_not_asked(firmware: str) -> None:
    async with rig(firmware=firmware) as flown:
        with pytest.raises(CommandNotSupported, match="nothing was sent"):
            await flown.aircraft.virtual_rc().__aenter__()
        assert not [
            one
            for one in flown.virtual.autopilot.received_commands
            if one.address and one.address[0] == 0x05
        ]
        async with flown.aircraft.control():
            pass


async def test_an_aircraft_that_is_not_activated_is_not_asked() -> None:
    async with rig(firmware="3.1", activated=False) as flown:
        with pytest.raises(NotActivated, match="not sent"):
            await flown.aircraft.virtual_rc().__aenter__()
        assert switches(flown) == []


@pytest.mark.parametrize("change", [lambda v: v.leave_f(), lambda v: v.set_rates(rc=0)])
async def test_the_pilots_way_out_must_be_there(change: Callable[[Any], None]) -> None:
    async with in_the_air() as flown:
        change(flown.virtual)
        await asyncio.sleep(2.0)
        with pytest.raises(AuthorityRefused, match="mode switch is"):
            await flown.aircraft.virtual_rc().__aenter__()
        assert switches(flown) == []


async def test_a_switch_that_is_not_known_yet_is_waited_for(flown: Rig) -> None:
    flown.virtual.set_rates(rc=0)
    await asyncio.sleep(2.0)
    asyncio.get_running_loop().call_later(0.5, lambda: flown.virtual.set_rates(rc=50))
    async with flown.aircraft.virtual_rc():
        assert is_on(flown)


async def test_telemetry_that_does_not_show_it_on_is_reported_and_it_is_switched_off(
    flown: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    given = property(lambda _: 3.0, lambda *_: None)
    monkeypatch.setattr(type(flown.aircraft.link.latency), "slack_s", given)
    virtual = flown.virtual.vehicle.remote.virtual
    monkeypatch.setattr(type(virtual), "switch", lambda *_: None)
    with pytest.raises(NotObserved, match="telemetry does not show it"):
        await fly_for_ever(flown)
    (on_at, is_on), (off_at, is_still_on) = switches(flown)
    assert (is_on, is_still_on) == (True, False)
    assert off_at - on_at >= 3.5, "a slow line has its time"


async def test_without_the_control_item_it_flies_and_says_what_nobody_knows(
    caplog: pytest.LogCaptureFixture,
) -> None:
    async with in_the_air(assistant=AssistantSettings()) as flown:
        async with flown.aircraft.virtual_rc() as rc:
            await rc.hold(1.0, pitch=0.4)
        assert "nobody knows whether virtual RC is on" in caplog.text
        assert_ended_well(flown)


# -- what sticks may do ---------------------------------------------------------------------------


@pytest.mark.parametrize("stick", ["roll", "pitch", "yaw", "throttle"])
@pytest.mark.parametrize("value", [1.01, -2.0, float("nan"), float("inf")])
async def test_a_stick_has_ends(flown: Rig, stick: str, value: float) -> None:
    async with flown.aircraft.virtual_rc() as rc:
        with pytest.raises(UsageError, match=f"(?s){stick} stick .*-1 to 1"):
            rc.set(**{stick: value})
        assert {where for _, where in sticks(flown)} == {NEUTRAL}


async def test_the_guards_see_every_frame(flown: Rig) -> None:
    guards = Guards(envelope=Envelope(max_radius_m=12.0, max_height_m=15.0))
    async with flown.aircraft.virtual_rc(guards=guards) as rc:
        with pytest.raises(GuardRefused, match=r"deflection of 0\.80"):
            rc.set(pitch=0.8)
        with pytest.raises(GuardRefused, match="from the start was refused"):
            await rc.hold(20.0, pitch=0.5)
        assert sticks(flown)[-1][1] == NEUTRAL or flown.speed > 0
        await rc.hold(2.0)
        assert abs(flown.virtual.position[0]) < 25.0
        await rc.hold(1.0, pitch=-0.5)  # back is allowed
    assert_ended_well(flown)


async def test_a_refusal_between_two_calls_centres_and_is_reported_by_the_next(flown: Rig) -> None:
    async with flown.aircraft.virtual_rc() as rc:
        flown.virtual.vehicle.flight.battery_percent = 15.0
        for _ in range(10):
            rc.set(pitch=0.3)
            await asyncio.sleep(0.45)  # renewed in time, and seldom: a frame meets it first
            if sticks(flown)[-1][1] == NEUTRAL:
                break
        assert sticks(flown)[-1][1] == NEUTRAL
        with pytest.raises(GuardRefused, match="battery"):
            rc.set()  # what happened since the last call
        with pytest.raises(GuardRefused, match="battery"):
            rc.set(pitch=0.3)
        rc.set()  # centred sticks are never refused
    assert_ended_well(flown)


async def test_the_corner_is_not_a_deflection_like_others(flown: Rig) -> None:
    async with flown.aircraft.virtual_rc(guards=Guards(envelope=None)) as rc:
        with pytest.raises(UsageError, match="start and stop the motors"):
            rc.set(roll=-1, pitch=-1, throttle=-1, yaw=1)
        with pytest.raises(TaskRefused, match="not known to be on the ground"):
            await rc.toggle_motors()
        assert {where for _, where in sticks(flown)} == {NEUTRAL}


@pytest.mark.parametrize(
    ("roll", "pitch", "throttle", "yaw", "is_it"),
    [
        (-1.0, -1.0, -1.0, 1.0, True),
        (0.95, -0.91, -0.92, -0.93, True),
        (-1.0, -0.8, -1.0, 1.0, False),
        (-1.0, -1.0, -0.8, 1.0, False),
        (-0.8, -1.0, -1.0, 1.0, False),
        (-1.0, -1.0, -1.0, 0.8, False),
        (-1.0, 1.0, 1.0, 1.0, False),
    ],
)
def test_both_sticks_down_and_aside_are_the_corner(
    roll: float, pitch: float, throttle: float, yaw: float, is_it: bool
) -> None:
    assert Deflections(roll, pitch, throttle, yaw).are_in_corner is is_it


async def test_v4_the_motors_start_and_stop_by_their_name_on_the_ground() -> None:
    async with rig(firmware="3.1", assistant=SHOWN) as flown:
        async with flown.aircraft.virtual_rc() as rc:
            await rc.toggle_motors()
            assert flown.virtual.vehicle.flight.dynamics.motors_on
            await rc.hold(0.5)
            await rc.toggle_motors()
            assert not flown.virtual.vehicle.flight.dynamics.motors_on
        assert_ended_well(flown)
