"""What a guardian would send, frame by frame, read by an aircraft that shares no code with it."""

from __future__ import annotations

import asyncio
import struct
from collections.abc import Awaitable, Callable

import pytest

from m100link import Control
from m100link.flight.guardian import (
    NOTHING,
    GuardianPlan,
    GuardianStep,
    control_plan,
    virtual_rc_plan,
)
from m100link.flight.stop_path import StopPath
from m100link.wire import Cipher, Frame, FrameDecoder
from tests.flight.test_endings import long_way
from tests.rig import NORTH, Rig, rig

pytestmark = pytest.mark.anyio

MOVE, AUTHORITY, TASK, MISSION_STOP = b"\x01\x03", b"\x01\x00\x00", b"\x01\x01", b"\x03\x12\x01"


def path_of(control: Control) -> StopPath:
    return control._block._stop_path


def plan_of(flown: Rig, control: Control) -> GuardianPlan:
    return control_plan(flown.aircraft._commander, path_of(control).wanted, 65_530)


def frames(flown: Rig, steps: tuple[GuardianStep, ...]) -> list[tuple[int, Frame]]:
    """When each arrives, ms, and what it says."""
    decoder = FrameDecoder()
    decoder.cipher = Cipher(flown.virtual.credentials.key)
    at, found = 0, []
    for step in steps:
        for _ in range(step.times):
            at += step.gap_ms
            (frame,) = decoder.feed(step.frame)
            found.append((at, frame))
    return found


async def planned(
    stop: str, flying: Callable[[Control], Awaitable[None]]
) -> list[tuple[int, Frame]]:
    async with rig(firmware="3.1") as flown:
        async with flown.aircraft.control(stop=stop) as control:  # type: ignore[arg-type]  # a word
            await flying(control)
            found = frames(flown, plan_of(flown, control).last)
    return found


async def in_the_air(control: Control) -> None:
    await control.take_off()
    control.send(NORTH)


async def test_hover_is_fifteen_neutrals_in_three_tenths_of_a_second_then_the_release() -> None:
    found = await planned("hover", in_the_air)
    neutrals = [at for at, frame in found if frame.data[:2] == MOVE]
    assert neutrals == list(range(0, 300, 20))
    flags = {frame.data[2] & 0b0011_1000 for _, frame in found if frame.data[:2] == MOVE}
    assert flags == {0b0000_1000}, "by climb rate and yaw rate"
    assert {frame.data[3:] for _, frame in found if frame.data[:2] == MOVE} == {bytes(16)}
    rest = found[15:]
    assert {frame.data for _, frame in rest} == {AUTHORITY}
    assert all(at <= 500 for at, _ in rest), "in order within half a second"


async def test_a_repetition_has_the_number_of_before_and_every_order_its_own() -> None:
    """An aircraft answers a repeated number of a session from memory, without carrying it out."""
    found = await planned("land", in_the_air)
    orders = [frame for _, frame in found if frame.session]
    assert {frame.session for frame in orders} == {31}
    numbers = [frame.sequence for frame in orders]
    assert numbers[::2] == numbers[1::2], "each twice, one behind the other"
    assert len(set(numbers)) == len(numbers) // 2
    assert all(frame.encrypted for frame in orders)


async def test_the_release_waits_until_a_landing_is_over() -> None:
    found = await planned("land", in_the_air)
    landings = [at for at, frame in found if frame.data[:2] == TASK]
    releases = [at for at, frame in found if frame.data == AUTHORITY]
    assert {frame.data[3] for _, frame in found if frame.data[:2] == TASK} == {6}
    assert landings[0] <= 500
    assert landings[-1] >= 10_000, "a take-off that is under way refuses it for six seconds"
    assert releases[0] - landings[0] >= 60_000
    assert releases[-1] - releases[0] < 500


async def test_of_a_landing_each_order_comes_when_the_stop_path_would_give_it() -> None:
    """Eight landings 1.5 s apart, each twice; three releases 50 ms apart after 60 s."""
    found = await planned("land", in_the_air)
    first = 300  # behind fifteen neutrals 20 ms apart, from 0 on, and a pause
    landings = [at for at, frame in found if frame.data[:2] == TASK]
    assert landings == [first + each * 1520 + again * 20 for each in range(8) for again in range(2)]
    releases = [at for at, frame in found if frame.data == AUTHORITY]
    last = landings[-1] + 60_000 - 7 * 1500
    assert releases == [last + each * 70 + again * 20 for each in range(3) for again in range(2)]


async def test_a_stalled_program_has_fifteen_neutrals_and_nothing_is_ended() -> None:
    async with rig(firmware="3.1") as flown:
        async with flown.aircraft.control(stop="land") as control:
            await in_the_air(control)
            found = frames(flown, plan_of(flown, control).stalled)
    assert [at for at, _ in found] == list(range(0, 300, 20))
    assert {frame.data[:2] for _, frame in found} == {MOVE}
    assert {frame.data[3:] for _, frame in found} == {bytes(16)}


@pytest.mark.parametrize("falls_back", [True, False])
async def test_a_virtual_remote_control_is_centred_and_switched_off_2_2_s_later(
    falls_back: bool,
) -> None:
    """DJI's header: settings more often than every 2 s lock the aircraft. Channels of 1024 hover in
    P, with the gear down; off is bit 0, and bit 1 says that the real one flies then."""
    async with rig(firmware="3.1") as flown:
        plan = virtual_rc_plan(flown.aircraft._commander, falls_back=falls_back)
        stalled, last = frames(flown, plan.stalled), frames(flown, plan.last)
    channels = [1024, 1024, 1024, 1024, 1324, 1024, 1552, *[1024] * 9]
    centred = b"\x05\x01" + struct.pack("<16I", *channels)
    off = b"\x05\x00" + bytes([2 * falls_back])
    assert [(at, frame.data) for at, frame in stalled] == [
        (at, centred) for at in range(0, 400, 100)
    ]
    assert [(at, frame.data) for at, frame in last] == [
        *((at, centred) for at in range(0, 2300, 100)),
        (2300, off),
    ]


async def test_a_mission_is_stopped_before_anything_else() -> None:
    async with rig(firmware="3.1") as flown:
        async with flown.aircraft.control() as control:
            async with control.waypoint_mission(long_way(flown), take_off=True):
                found = frames(flown, plan_of(flown, control).last)
                assert [frame.data[:3] for _, frame in found[:4]] == [MISSION_STOP] * 4
                assert {frame.data for _, frame in found[4:]} == {AUTHORITY}
                assert not plan_of(flown, control).stalled, "a mission needs nobody to be renewed"


async def test_a_detached_mission_flies_on_and_nothing_is_sent() -> None:
    async with rig(firmware="3.1") as flown:
        async with flown.aircraft.control(stop="land") as control:
            async with control.waypoint_mission(long_way(flown), take_off=True) as mission:
                mission.detach()
            assert path_of(control).wanted == NOTHING


async def test_on_the_ground_nothing_lands() -> None:
    async with rig(firmware="3.1") as flown:
        async with flown.aircraft.control(stop="land") as control:
            await asyncio.sleep(1.0)
            wanted = path_of(control).wanted
            assert wanted == NOTHING._replace(release=True)
            await control.take_off()
            assert path_of(control).wanted.land
        assert path_of(control).wanted == NOTHING, "it is over"


async def test_what_the_pilot_flies_is_only_given_back() -> None:
    async with rig(firmware="3.1") as flown:
        async with flown.aircraft.control(stop="land", on_pause="wait") as control:
            await in_the_air(control)
            flown.virtual.leave_f()
            await asyncio.sleep(0.5)
            assert path_of(control).wanted == NOTHING._replace(release=True)


async def test_while_authority_is_asked_for_it_would_be_given_back() -> None:
    """Its ack may be lost, and the program dead before it comes."""
    async with rig(firmware="3.1") as flown:
        control = flown.aircraft.control()
        entering = asyncio.ensure_future(control.__aenter__())
        await asyncio.sleep(0)
        assert path_of(control).wanted in (NOTHING, NOTHING._replace(release=True))
        await entering
        assert path_of(control).wanted.release
        await control.__aexit__(None, None, None)


async def test_nothing_is_planned_before_a_block_begins() -> None:
    async with rig() as flown:
        assert path_of(flown.aircraft.control()).wanted == NOTHING
