"""Whole flights by datagrams, on virtual time and without a socket; and frames with any content."""

from __future__ import annotations

import itertools
import math
import random
import struct
from random import Random
from typing import Any

import anyio
import pytest

from m100link.apps.mavlink.translator.codec import (
    LAYOUTS,
    MavlinkMessage,
    MessageLayout,
    PacketSigner,
    write_frame,
)
from m100link.apps.mavlink.translator.commands import COMMANDS
from m100link.apps.mavlink.translator.numbers import MavCommand, MavResult
from m100link.apps.mavlink.translator.parameters import PARAMETERS
from m100link.apps.mavlink.translator.route import ITEMS
from m100link.apps.mavlink.translator.vehicle_state import MODES, Mode
from m100link.sim.vehicle.flight import Maneuver
from tests.apps.mavlink.conftest import Ground, Rig

pytestmark = pytest.mark.anyio


@pytest.mark.parametrize("firmware", ["1.0", "2.3", "3.1"])
async def test_armed_up_and_down_again(firmware: str) -> None:
    async with Rig(firmware=firmware).running() as rig:
        ground = rig.ground
        assert not ground.armed()
        await ground.fly(5.0)
        assert ground.armed()
        assert ground.last("EXTENDED_SYS_STATE")["landed_state"] == 2
        place = ground.last("GLOBAL_POSITION_INT")
        assert place["relative_alt"] == pytest.approx(5000, abs=700)
        assert await ground.ask(MavCommand.NAV_LAND) is MavResult.ACCEPTED
        await rig.until(lambda: ground.mode is Mode.LAND)
        await rig.until(lambda: not ground.armed())
        assert not rig.motors_on
        await rig.until(lambda: not rig.client.holder.number)


async def test_nothing_is_reported_before_somebody_is_heard(rig: Rig) -> None:
    silent = Ground(rig, ("127.0.0.1", 5555), 77)
    silent.is_silent = True
    silent.command(MavCommand.COMPONENT_ARM_DISARM, 1)
    await anyio.sleep(3.0)
    assert silent.heard == []
    assert not rig.client.holder.number


async def test_a_peer_is_forgotten_when_it_is_silent(rig: Rig, ground: Ground) -> None:
    ground.is_silent = True
    await anyio.sleep(11.0)
    known = len(ground.heard)
    await anyio.sleep(5.0)
    assert len(ground.heard) == known


async def test_a_new_peer_hears_once_that_this_is_no_ardupilot(rig: Rig, ground: Ground) -> None:
    """Programs for ArduPilot wait for its messages for ever, and said nothing of the reason."""
    text = "DJI M100: modes of PX4, no programs for ArduPilot"
    other = Ground(rig, ("127.0.0.1", 7000), 246)
    ground.heard.clear()
    other.beat()
    await anyio.sleep(5.0)
    assert other.texts.splitlines().count(text) == 1
    assert text not in ground.texts


async def test_there_are_never_more_than_a_few_peers(rig: Rig) -> None:
    for place in range(80):
        Ground(rig, ("127.0.0.1", 20000 + place), 100).beat()
    addresses = rig.bridge.peers.audience(rig.client.now)
    assert len(addresses) == 16
    assert rig.bridge.peers.refused > 0


async def test_junk_between_commands_swallows_none(rig: Rig, ground: Ground) -> None:
    random = Random(7)
    for _ in range(200):
        for _ in range(20):
            rig.bridge.received(random.randbytes(random.randrange(100)), ground.address)
        assert await ground.ask(MavCommand.GET_HOME_POSITION) is MavResult.ACCEPTED
        await anyio.sleep(0.02)


async def test_an_unknown_command_is_answered(rig: Rig, ground: Ground) -> None:
    for command in (MavCommand.DO_SET_HOME, 2000, 31999):
        assert await ground.ask(command) is MavResult.UNSUPPORTED


async def test_a_command_for_another_system_is_not_ours(rig: Rig, ground: Ground) -> None:
    ground.command(MavCommand.NAV_LAND, target=9)
    await anyio.sleep(1.0)
    assert ground.all("COMMAND_ACK") == []


async def test_copies_of_arming_are_one_request(rig: Rig, ground: Ground) -> None:
    for _ in range(3):
        ground.command(MavCommand.COMPONENT_ARM_DISARM, 1)
    await anyio.sleep(4.0)
    answers = [one["result"] for one in ground.all("COMMAND_ACK")]
    assert answers[0] == MavResult.IN_PROGRESS, "activation takes two seconds"
    assert answers[-1] == MavResult.ACCEPTED
    assert answers.count(MavResult.ACCEPTED) == 1
    assert [one.text for one in rig.agent.journal.events if "obtained" in one.text] == [
        "control authority obtained"
    ]


async def test_it_disarms_by_itself_when_nobody_takes_off(rig: Rig, ground: Ground) -> None:
    await ground.arm()
    await rig.until(lambda: ground.armed())
    await anyio.sleep(8.0)
    assert ground.armed()
    await anyio.sleep(4.0)
    assert not ground.armed()
    assert "no take-off" in ground.texts


async def test_a_take_off_waits_for_the_arming(rig: Rig, ground: Ground) -> None:
    """QGroundControl's order: NAV_TAKEOFF disarmed, and arming behind the answer."""
    altitude = rig.ground_altitude + 10.0
    args = (-1, 0, 0, math.nan, math.nan, math.nan, altitude)
    assert await ground.ask(MavCommand.NAV_TAKEOFF, *args) is MavResult.ACCEPTED
    await anyio.sleep(2.0)
    assert rig.height < 0.1
    assert ground.mode is Mode.TAKEOFF
    await ground.arm()
    await rig.until(lambda: rig.height > 9.5)


async def test_a_take_off_that_nobody_arms_is_forgotten(rig: Rig, ground: Ground) -> None:
    assert await ground.ask(MavCommand.NAV_TAKEOFF) is MavResult.ACCEPTED
    await anyio.sleep(10.5)
    await ground.arm()
    await anyio.sleep(5.0)
    assert rig.height < 0.1


async def test_a_landing_during_the_take_off_waits_and_nothing_pushes_it_out(
    rig: Rig, ground: Ground
) -> None:
    await ground.arm()
    assert await ground.ask(MavCommand.NAV_TAKEOFF) is MavResult.ACCEPTED
    await rig.until(lambda: rig.height > 0.3)
    assert await ground.ask(MavCommand.NAV_LAND) is MavResult.ACCEPTED
    assert await ground.set_mode(Mode.HOLD) is MavResult.TEMPORARILY_REJECTED
    await rig.until(lambda: not ground.armed())
    assert rig.height < 0.1


async def test_a_way_home_is_shown_until_its_end_was_heard() -> None:
    """On a slow way to the agent it climbs and flies on for seconds behind an accepted hold."""
    async with Rig(late=0.5).running() as rig:
        ground = rig.ground
        await ground.fly(5.0)
        assert await ground.set_mode(Mode.RTL) is MavResult.ACCEPTED
        flight = rig.aircraft.vehicle.flight
        await rig.until(lambda: flight.maneuver is not Maneuver.NONE)
        assert await ground.set_mode(Mode.HOLD) is MavResult.ACCEPTED
        while ground.mode is not Mode.HOLD:  # noqa: ASYNC110 - virtual time
            await anyio.sleep(0.02)
        assert flight.maneuver is Maneuver.NONE
        assert "home is 0 m away" in ground.texts


async def test_hold_ends_the_way_home(rig: Rig, ground: Ground) -> None:
    await ground.fly(6.0)
    assert await ground.set_mode(Mode.RTL) is MavResult.ACCEPTED
    await rig.until(lambda: ground.mode is Mode.RTL)
    assert await ground.set_mode(Mode.HOLD) is MavResult.ACCEPTED
    await anyio.sleep(8.0)
    height = rig.height
    await anyio.sleep(5.0)
    assert rig.height == pytest.approx(height, abs=0.3)
    assert height > 2.0
    assert ground.armed()
    assert ground.mode is Mode.HOLD


async def test_the_pilot_takes_it_and_armed_does_not_lie(rig: Rig, ground: Ground) -> None:
    await ground.fly(6.0)
    rig.aircraft.vehicle.remote.set_mode("P")
    await rig.until(lambda: ground.mode is Mode.POSCTL)
    assert ground.armed()
    assert await ground.set_mode(Mode.LAND) is MavResult.TEMPORARILY_REJECTED
    await rig.until(lambda: "the mode switch is in P" in ground.texts)
    assert await ground.ask(MavCommand.COMPONENT_ARM_DISARM, 0, 21196) is MavResult.DENIED
    rig.aircraft.vehicle.remote.set_mode("F")
    await rig.until(lambda: ground.mode is Mode.HOLD)
    assert await ground.set_mode(Mode.LAND) is MavResult.ACCEPTED
    await rig.until(lambda: not ground.armed())


async def test_a_ground_station_that_is_lost_holds(rig: Rig, ground: Ground) -> None:
    await ground.fly(3.0)
    args = (0, 0, 0, math.nan, math.nan, math.nan, rig.ground_altitude + 40.0)
    assert await ground.ask(MavCommand.DO_REPOSITION, *args) is MavResult.ACCEPTED
    await rig.until(lambda: rig.height > 5.0)
    ground.is_silent = True
    other = Ground(rig, ("127.0.0.1", 7000), 246)
    other.beat()
    await rig.until(lambda: "is lost" in other.texts, within=5.0)
    await anyio.sleep(3.0)
    assert rig.speed < 0.1
    assert rig.height < 20.0
    assert await other.set_mode(Mode.LAND) is MavResult.ACCEPTED
    await rig.until(lambda: not other.armed())


async def test_the_way_to_the_ground_goes_on_when_the_ground_station_is_lost(
    rig: Rig, ground: Ground
) -> None:
    await ground.fly(6.0)
    assert await ground.set_mode(Mode.LAND) is MavResult.ACCEPTED
    await anyio.sleep(1.5)
    ground.is_silent = True
    await rig.until(lambda: not rig.motors_on)


async def test_two_ground_stations_and_one_of_them_flies(rig: Rig, ground: Ground) -> None:
    other = Ground(rig, ("127.0.0.1", 7000), 246)
    other.beat()
    await ground.fly(4.0)
    assert (
        await other.ask(MavCommand.DO_REPOSITION, -1, 0, 0, 1.0) is MavResult.TEMPORARILY_REJECTED
    )
    await rig.until(lambda: "MAVLink 245 at 127.0.0.1:14540 flies" in other.texts)
    assert other.last("HEARTBEAT")["base_mode"] & 128
    assert await other.set_mode(Mode.LAND) is MavResult.ACCEPTED
    await rig.until(lambda: not ground.armed())


async def test_a_stranger_with_the_number_of_the_station_that_flies_hears_that_it_flies(
    rig: Rig, ground: Ground
) -> None:
    """The bridge told a stranger that streamed setpoints: "no setpoint came"."""
    await ground.fly(4.0)
    stranger = Ground(rig, ("127.0.0.1", 7000), ground.system)
    stranger.beat()
    for _ in range(10):
        stranger.send("SET_POSITION_TARGET_LOCAL_NED", coordinate_frame=1, type_mask=3527, vx=3.0)
        await anyio.sleep(0.05)
    assert await stranger.set_mode(Mode.OFFBOARD) is MavResult.TEMPORARILY_REJECTED
    await rig.until(lambda: "MAVLink 245 at 127.0.0.1:14540 flies" in stranger.texts)
    assert "no setpoint" not in stranger.texts
    assert rig.speed < 0.1


async def test_setpoints_that_stop_are_not_flown_on(rig: Rig, ground: Ground) -> None:
    await ground.fly(5.0)

    def north() -> None:
        mask = 0b0000_1101_1100_0111
        ground.send(
            "SET_POSITION_TARGET_LOCAL_NED",
            target_system=1,
            target_component=1,
            coordinate_frame=1,
            type_mask=mask,
            vx=3.0,
        )

    north()
    assert await ground.set_mode(Mode.OFFBOARD) is MavResult.ACCEPTED
    for _ in range(60):
        north()
        await anyio.sleep(0.05)
    assert rig.speed > 2.0
    await anyio.sleep(3.5)
    assert ground.mode is Mode.HOLD
    assert rig.speed < 0.1
    assert "setpoints stopped" in ground.texts


async def test_the_bridge_ends_and_gives_control_back(rig: Rig, ground: Ground) -> None:
    await ground.fly(4.0)
    rig.work.cancel()
    await rig.until(lambda: not rig.agent.holding.has_authority, within=5.0)
    await anyio.sleep(3.0)
    assert rig.speed < 0.1


async def test_what_was_sent_while_the_process_stood_still_is_not_carried_out(
    rig: Rig, ground: Ground, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A machine that wakes up does not take off by what somebody asked for, and gave up."""
    drained: list[float] = []

    def drain() -> list[Any]:
        drained.append(rig.client.now)
        return []

    bridge, step = rig.bridge, rig.bridge.step
    monkeypatch.setattr(bridge, "_drain", drain)
    monkeypatch.setattr(bridge, "step", lambda: None)
    ground.is_silent = True  # what is sent waits in the socket
    await anyio.sleep(3.0)
    ground.command(MavCommand.COMPONENT_ARM_DISARM, 1)
    assert drained, "what waits behind it is as old"
    ground.is_silent = False
    ground.beat()
    monkeypatch.setattr(bridge, "step", step)
    await anyio.sleep(5.0)
    assert not rig.agent.holding.has_authority
    assert "s of standstill" in ground.texts
    await ground.arm()
    assert rig.agent.holding.has_authority


@pytest.mark.parametrize(
    ("what", "place"),
    [
        *(("hold", "the first"), ("hold", "one behind it"), ("land", "the first")),
        *(("disarm", "one behind it"), ("hold of nobody", "one behind it")),
    ],
)
async def test_a_stream_does_not_go_on_over_a_stop_that_came_in_a_standstill(
    rig: Rig, ground: Ground, monkeypatch: pytest.MonkeyPatch, what: str, place: str
) -> None:
    await ground.fly(4.0)
    other = Ground(rig, ("127.0.0.1", 7000), 246)
    other.beat()
    send_velocity(ground, vx=2.0)
    assert await ground.set_mode(Mode.OFFBOARD) is MavResult.ACCEPTED

    async def stream(seconds: float) -> None:
        for _ in range(round(seconds / 0.05)):
            send_velocity(ground, vx=2.0)
            await anyio.sleep(0.05)

    await stream(2.0)
    assert rig.speed > 1.5
    bridge, step, received = rig.bridge, rig.bridge.step, rig.bridge.received
    waits: list[tuple[Any, ...]] = []
    monkeypatch.setattr(bridge, "received", lambda *came: waits.append(came))
    monkeypatch.setattr(bridge, "step", lambda: None)
    sender = Ground(rig, ("127.0.0.1", 7001), 250) if "nobody" in what else other
    if place == "one behind it":
        send_velocity(ground, vx=2.0)
    command = MavCommand.NAV_LAND if what == "land" else MavCommand.DO_PAUSE_CONTINUE
    sender.command(MavCommand.COMPONENT_ARM_DISARM if what == "disarm" else command, 0)
    send_velocity(ground, vx=2.0)
    await anyio.sleep(1.2)
    monkeypatch.setattr(bridge, "_drain", lambda: [waits.pop(0) for _ in list(waits)])
    monkeypatch.setattr(bridge, "received", received)
    monkeypatch.setattr(bridge, "step", step)
    bridge.received(*waits.pop(0))
    await stream(3.0)
    if "nobody" in what:
        assert rig.speed > 1.5
        return
    assert ground.mode is Mode.HOLD
    assert rig.speed < 0.1
    assert "one of these may have ended the flight" in ground.texts
    assert await ground.set_mode(Mode.OFFBOARD) is MavResult.ACCEPTED
    await stream(2.0)
    assert rig.speed > 1.5


@pytest.mark.parametrize("is_known", [False, True])
async def test_a_flood_from_one_address_does_not_keep_others_out(
    rig: Rig, ground: Ground, is_known: bool
) -> None:
    await ground.fly(4.0)
    flood = Ground(rig, ("127.0.0.1", 9999), 99)
    flood.is_silent = not is_known
    flood.beat()
    await anyio.sleep(0.1)
    looks_like_frames = b"\xfe\xf0\0\0\0\0" * 230  # each of them is checked, and none is right
    for _ in range(300):
        rig.bridge.received(looks_like_frames, flood.address)
    ground.command(MavCommand.NAV_LAND)
    assert ground.last("COMMAND_ACK")["command"] == MavCommand.NAV_LAND
    assert ground.last("COMMAND_ACK")["result"] == MavResult.ACCEPTED
    assert rig.bridge.dropped > 200


NAN = math.nan
ENDING: tuple[tuple[int, tuple[float, ...]], ...] = (
    (MavCommand.NAV_LAND, ()),
    (MavCommand.NAV_RETURN_TO_LAUNCH, ()),
    (MavCommand.COMPONENT_ARM_DISARM, (0,)),
    (MavCommand.DO_SET_MODE, (1, MODES[Mode.HOLD].main, MODES[Mode.HOLD].sub)),
    (MavCommand.DO_SET_MODE, (1, MODES[Mode.LAND].main, MODES[Mode.LAND].sub)),
    (MavCommand.DO_SET_STANDARD_MODE, (MODES[Mode.RTL].standard,)),
    (MavCommand.DO_PAUSE_CONTINUE, (0,)),
    (MavCommand.DO_REPOSITION, (NAN, NAN, NAN, NAN, NAN, NAN, NAN)),
)
"""Commands that stop, land or give control back: COMMANDS has no others."""


@pytest.mark.slow
@pytest.mark.parametrize("is_signed", [False, True])
async def test_a_peer_that_floods_is_heard_when_it_ends_a_flight(is_signed: bool) -> None:
    signer = PacketSigner(bytes(range(32))) if is_signed else None
    async with Rig(signer=signer).running() as rig:
        ground = rig.ground
        await ground.fly(4.0)
        for command, parameters in ENDING:
            for target in (0, 1):
                await anyio.sleep(0.1)
                ground.heard.clear()
                for _ in range(1000):
                    ground.send("MANUAL_CONTROL", target=1)
                    ground.command(MavCommand.GET_HOME_POSITION)
                ground.command(command, *parameters, target=target)
                ground.command(MavCommand.REQUEST_MESSAGE, 0)
                await anyio.sleep(0.1)
                answered = {one["command"] for one in ground.all("COMMAND_ACK")}
                assert command in answered, (command, parameters, target)
                assert MavCommand.REQUEST_MESSAGE not in answered


async def test_of_those_behind_one_address_nobody_replaces_what_another_asked_for(
    rig: Rig, ground: Ground
) -> None:
    """As behind a router; SET_MODE of older programs counts, too."""
    await ground.fly(4.0)
    other, stranger = (Ground(rig, ground.address, system) for system in (100, 101))
    other.beat()
    stranger.is_silent = True
    await anyio.sleep(0.1)
    for _ in range(1000):
        ground.send("MANUAL_CONTROL", target=1)
    land = MODES[Mode.LAND].number
    ground.send("SET_MODE", custom_mode=land, target_system=1, base_mode=1)
    dropped = rig.bridge.dropped
    other.send("SET_MODE", custom_mode=0, target_system=1, base_mode=0)
    for number in range(2, 100):
        stranger.command(MavCommand.NAV_LAND, target=1)
        other.command(MavCommand.NAV_LAND, target=number)
    assert rig.bridge.dropped == dropped + 2 * 98
    await rig.until(lambda: ground.mode is Mode.LAND, within=1.0)


async def test_noise_between_the_commands_of_a_peer_costs_it_none(rig: Rig, ground: Ground) -> None:
    ground.beat()
    await anyio.sleep(0.1)
    chance = random.Random(20261122)
    for _ in range(100):
        await anyio.sleep(0.001)  # nothing waits, and steps are far apart
        for _ in range(100):
            rig.bridge.received(chance.randbytes(chance.randrange(1, 60)), ground.address)
        ground.heard.clear()
        ground.command(MavCommand.GET_HOME_POSITION)
        assert ground.last("COMMAND_ACK")["command"] == MavCommand.GET_HOME_POSITION
    assert rig.bridge.dropped == 0


async def test_what_is_answered_counts_as_what_is_read(rig: Rig, ground: Ground) -> None:
    """A question of twenty bytes has answers of five hundred."""
    for _ in range(500):
        ground.send("PARAM_REQUEST_LIST", target_system=1, target_component=1)
    assert len(ground.all("PARAM_VALUE")) < 1000
    await anyio.sleep(0.1)
    ground.heard.clear()
    ground.send("PARAM_REQUEST_LIST", target_system=1, target_component=1)
    assert len(ground.all("PARAM_VALUE")) == len(PARAMETERS)


def send_velocity(ground: Ground, **velocity: float) -> None:
    """A setpoint that ignores all but velocities."""
    ground.send(
        "SET_POSITION_TARGET_LOCAL_NED",
        target_system=1,
        target_component=1,
        coordinate_frame=1,
        type_mask=0b1101_1100_0111,
        **velocity,
    )


async def test_nobody_is_flown_by_setpoints_of_another(rig: Rig, ground: Ground) -> None:
    await ground.fly(5.0)
    ground.is_silent = True
    other = Ground(rig, ("127.0.0.1", 7000), 246)
    third = Ground(rig, ("127.0.0.1", 7001), 247)
    other.beat()
    third.beat()
    await rig.until(lambda: "is lost" in other.texts)
    send_velocity(third, vx=3.0)
    assert await other.set_mode(Mode.OFFBOARD) is MavResult.DENIED
    send_velocity(other)
    assert await other.set_mode(Mode.OFFBOARD) is MavResult.ACCEPTED
    for _ in range(20):
        send_velocity(third, vx=3.0)
        await anyio.sleep(0.1)
        assert rig.speed < 0.1


@pytest.mark.parametrize("firmware", ["1.0", "2.3"])
async def test_nothing_resumes_when_the_pilot_was_there_however_short(
    firmware: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    async with Rig(firmware=firmware).running() as rig:
        ground, remote = rig.ground, rig.aircraft.vehicle.remote
        await ground.fly(5.0)
        send_velocity(ground, vx=2.0)
        assert await ground.set_mode(Mode.OFFBOARD) is MavResult.ACCEPTED
        for number in range(160):
            send_velocity(ground, vx=2.0)
            await anyio.sleep(0.05)
            if number == 40:
                assert rig.speed > 1.0
                step = rig.bridge.step
                monkeypatch.setattr(rig.bridge, "step", lambda: None)  # it is late
                remote.set_mode("P")
                await rig.until(lambda: not rig.client.has_authority)
                remote.set_mode("F")
                await rig.until(lambda: rig.client.has_authority)
                monkeypatch.setattr(rig.bridge, "step", step)
        assert ground.mode is not Mode.OFFBOARD
        assert rig.speed < 0.1


async def test_with_a_key_nothing_is_sent_to_those_that_do_not_sign() -> None:
    """One datagram of 21 bytes from a forged address had 150 messages/s sent there for 10 s."""
    key = bytes(range(32))
    async with Rig(signer=PacketSigner(key)).running() as rig:
        message = MavlinkMessage("HEARTBEAT", {"type": 6})
        unsigned = write_frame(message, system=9, sequence=0)
        other_key = PacketSigner(bytes(32))
        forged = write_frame(message, system=9, sequence=0, signer=other_key, now=2**47)
        for port in range(80):
            for data in (unsigned, forged):
                rig.bridge.received(data, ("192.0.2.1", 20000 + port))
        await anyio.sleep(3.0)
        assert {address for _, address in rig.sent} == {rig.ground.address}
        late = Ground(rig, ("127.0.0.1", 7000), 246)
        late.beat()
        await late.arm()


async def test_short_messages_are_as_few_as_long_ones(rig: Rig, ground: Ground) -> None:
    await anyio.sleep(0.1)
    for _ in range(1000):
        ground.beat()
    assert rig.bridge.dropped > 700


async def test_steps_are_few_while_nothing_waits_and_short_when_something_does(
    rig: Rig, ground: Ground, monkeypatch: pytest.MonkeyPatch
) -> None:
    await ground.fly(5.0)
    steps: list[float] = []
    step = rig.bridge.step

    def counted() -> None:
        steps.append(rig.client.now)
        step()

    monkeypatch.setattr(rig.bridge, "step", counted)
    await anyio.sleep(2.0)
    assert len(steps) == pytest.approx(40, abs=2)
    for _ in range(100):  # who gives orders without end gets no more steps than setpoints
        ground.command(MavCommand.DO_SET_MODE, 1, 4, 3)
        await anyio.sleep(0.001)
    between = [after - before for before, after in itertools.pairwise(steps)]
    assert min(between) > 0.018
    steps.clear()
    send_velocity(ground)
    assert await ground.set_mode(Mode.OFFBOARD) is MavResult.ACCEPTED
    for _ in range(40):
        send_velocity(ground)
        await anyio.sleep(0.05)
    assert len(steps) == pytest.approx(100, abs=6)


# -- valid frames with any content: nothing raises out of the reader, and nothing flies away -------


ODD = (math.nan, math.inf, -math.inf, 0.0, -0.0, 1e38, -1e38, 1e-40, 1.0, -1.0, 180.0, 47.0)


def any_fields(layout: MessageLayout, random: Random) -> dict[str, Any]:
    """Mostly what could be meant, with numbers that nobody means among it."""
    fields = layout.read(random.randbytes(layout.size))
    for name, value in fields.items():
        if isinstance(value, float) and random.random() < 0.8:
            fields[name] = struct.unpack("<f", struct.pack("<f", random.choice(ODD)))[0]
        if name in ("target_system", "target_component", "target", "mission_type"):
            fields[name] = random.choice((0, 1, 1, 1))
        if name in ("seq", "count", "coordinate_frame", "frame"):
            fields[name] = random.randrange(12)
        if name == "command":
            fields[name] = random.choice([*COMMANDS, *ITEMS, 5001, 5003, random.randrange(65536)])
        if name == "type_mask":
            most = 0xFF if layout.name == "SET_ATTITUDE_TARGET" else 0xFFF
            fields[name] = (
                random.choice((0, 0xDC7, 0xFC7, 0xFFF, 0x9F8, random.randrange(4096))) & most
            )
    return fields


async def pour(ground: Ground, seed: int, count: int) -> None:
    random = Random(seed)
    names = [name for name in LAYOUTS if name != "HEARTBEAT"]
    for _ in range(count):
        name = random.choice([*names, "COMMAND_LONG", "COMMAND_INT", "MISSION_ITEM_INT"])
        ground.send(name, **any_fields(LAYOUTS[name], random))
        if random.random() < 0.3:
            await anyio.sleep(random.random() * 0.1)


@pytest.mark.parametrize("seed", range(2))
async def test_nothing_raises_on_the_ground(rig: Rig, ground: Ground, seed: int) -> None:
    await pour(ground, seed, 400)
    assert not rig.work.done()
    assert await ground.ask(MavCommand.GET_HOME_POSITION) in (0, 1)


@pytest.mark.parametrize("seed", range(2))
async def test_nothing_flies_away(rig: Rig, ground: Ground, seed: int) -> None:
    await ground.fly(10.0)
    await pour(ground, seed, 400)
    assert not rig.work.done()
    assert math.hypot(*rig.aircraft.position) < 165.0
    assert rig.height < 55.0
    for one in rig.grounds:
        one.is_silent = True
    await anyio.sleep(10.0)
    landing = rig.aircraft.vehicle.flight.phase.name
    assert rig.speed < 0.2 or landing.endswith("LANDING") or ground.mode is Mode.RTL


async def test_what_is_poured_by_somebody_else_does_not_take_control(
    rig: Rig, ground: Ground
) -> None:
    await ground.fly(5.0)
    other = Ground(rig, ("127.0.0.1", 7000), 250)
    other.beat()
    operator = rig.vehicle.manager.operator
    await pour(other, 9, 300)
    assert rig.vehicle.manager.operator in (None, operator)
    assert await other.ask(MavCommand.DO_CHANGE_SPEED, 1, 3.0) in (
        MavResult.TEMPORARILY_REJECTED,
        MavResult.ACCEPTED,
    )
