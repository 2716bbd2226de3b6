"""Strangers, forgers and floods in each phase of a flight: the aircraft does not move for them.

The truth of the virtual aircraft is compared with the way that its operator ordered, 50 times a
second. Without a key any program may hold, land and return, and fly an aircraft that nobody flies:
these are no attacks.
"""

from __future__ import annotations

import math
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import asynccontextmanager
from itertools import cycle, pairwise
from pathlib import Path
from random import Random
from typing import Any

import anyio
import pytest

from m100link.apps.mavlink.translator.codec import (
    LAYOUTS,
    MavlinkMessage,
    PacketSigner,
    write_frame,
)
from m100link.apps.mavlink.translator.numbers import MavCommand, MavResult, MissionResult
from m100link.apps.mavlink.translator.vehicle_state import MODES, Mode
from tests.apps.mavlink.conftest import GCS, Rig
from tests.apps.mavlink.translator.test_missions import Exchange, waypoint

pytestmark = pytest.mark.anyio

KEY = bytes(range(32))
STRANGERS = ("127.0.0.1", 4001), ("127.0.0.1", 4002)
NAN = math.nan
NUMBERS = (NAN, 0.0, -0.0, 1.0, -1.0, 3.4e38, -3.4e38, 1e-40, 47.0, 8.0, 20.0, 255.0)
Datagrams = Iterator[bytes]


def of(name: str, system: int, component: int = 190, **fields: Any) -> bytes:
    to = {"target_system": 1, "target_component": fields.pop("to", 1)}
    known = LAYOUTS[name].fields
    values = {key: value for key, value in (to | fields).items() if key in known}
    message = MavlinkMessage(name, values, component=component)
    return write_frame(message, system=system, sequence=0)


def command(random: Random, number: int, system: int, *parameters: float, to: int = 1) -> bytes:
    given = [*parameters, *(random.choice(NUMBERS) for _ in range(7))][:7]
    named = {f"param{place}": value for place, value in enumerate(given, 1)}
    fields: dict[str, Any] = {"command": number, "to": to, **named}
    return of("COMMAND_LONG", system, **fields)


def flies(random: Random, system: int) -> Datagrams:
    """Orders that would move it, arm it, or change what flies."""
    modes = [row for mode, row in MODES.items() if mode not in (Mode.HOLD, Mode.LAND, Mode.RTL)]
    place = (47.001, 8.001)
    while True:
        row = random.choice(modes)
        yield random.choice(
            [
                command(random, MavCommand.COMPONENT_ARM_DISARM, system, 1.0),
                command(random, MavCommand.NAV_TAKEOFF, system),
                command(random, MavCommand.DO_SET_MODE, system, 1, row.main, row.sub),
                command(random, MavCommand.DO_REPOSITION, system, 5, 0, 0, NAN, *place, 30.0),
                command(random, MavCommand.DO_ORBIT, system, 20.0, 5.0),
                command(random, MavCommand.MISSION_START, system, 0.0),
                command(random, MavCommand.DO_CHANGE_SPEED, system, 1.0, 10.0),
                of("SET_POSITION_TARGET_LOCAL_NED", system, vx=9.0, type_mask=0b1101_1100_0111),
                of("SET_ATTITUDE_TARGET", system, q=(0.9, 0.3, 0.3, 0.0), thrust=1.0),
                of("MANUAL_CONTROL", system, target=1, x=1000, y=1000, z=1000, r=1000),
                of("PARAM_SET", system, param_id="MPC_XY_VEL_MAX", param_value=10.0, param_type=9),
                of("MISSION_COUNT", system, count=2),
                of("MISSION_CLEAR_ALL", system),
                of("MISSION_ITEM_INT", system, command=16, frame=6, z=40.0, x=470_000_000),
            ]
        )


def looks(random: Random, system: int) -> Datagrams:
    """Questions and rates, for logs and files, and orders to camera and gimbal."""
    numbers = [layout.number for layout in LAYOUTS.values()]
    kinds = [
        name for name in LAYOUTS if name.startswith(("LOG_", "GIMBAL_MANAGER_SET", "PARAM_RE"))
    ]
    payload = [MavCommand[name] for name in MavCommand.__members__ if "CAPTURE" in name]
    payload += [MavCommand.DO_GIMBAL_MANAGER_PITCHYAW, MavCommand.DO_GIMBAL_MANAGER_CONFIGURE]
    payload += [MavCommand.DO_SET_ROI_LOCATION, MavCommand.DO_SET_ROI_NONE]
    asks = (MavCommand.REQUEST_MESSAGE, MavCommand.SET_MESSAGE_INTERVAL)
    while True:
        name = random.choice(kinds)
        values: dict[str, Any] = {
            key: random.randrange(256) for key in LAYOUTS[name].fields if "target" not in key
        }
        values |= {"param_id": "A"} if "param_id" in values else {}
        values |= {"q": (1.0, 0.0, 0.0, 0.0)} if "q" in values else {}
        values |= {"data": bytes(90)} if "data" in values else {}
        files = bytes((random.randrange(256), 0, 0, random.choice((3, 4, 5, 15)), 6, 0, 0, 0))
        files += bytes(4) + random.choice((b"/log/.", b"../../", b"log/" + bytes(40)))
        yield random.choice(
            [
                command(random, random.choice(asks), system, random.choice(numbers), 1.0),
                command(random, random.choice(payload), system, to=random.choice((0, 1, 100))),
                of(name, system, **values),
                of("FILE_TRANSFER_PROTOCOL", system, payload=tuple(files)),
            ]
        )


def junk(random: Random, system: int) -> Datagrams:
    while True:
        whole = bytearray(next(flies(random, system)))
        for _ in range(random.randrange(1, 4)):
            whole[random.randrange(len(whole))] ^= 1 << random.randrange(8)
        yield bytes(whole) if random.random() < 0.5 else random.randbytes(random.randrange(300))


ATTACKS: dict[str, Callable[[Random, int], Datagrams]] = {
    "orders of two other stations": flies,
    "questions of two other stations": looks,
    "damaged orders": junk,
}
GROUND, ABOVE, AWAY = (0.0, 0.0, 0.0), (0.0, 0.0, 6.0), (15.0, 0.0, 6.0)
HIGH, CORNER = (0.0, 0.0, 14.0), (15.0, 15.0, 6.0)
# The way that its operator orders in each phase: m north, east and up of the take-off point.
WAYS: dict[str, tuple[tuple[float, float, float], ...]] = {
    "disarmed": (GROUND,),
    "armed": (GROUND,),
    "take-off": (GROUND, ABOVE),
    "hover": (ABOVE,),
    "on its way": (ABOVE, AWAY),
    "mission": (GROUND, ABOVE, AWAY, CORNER),
    "landing": (HIGH, GROUND),
}
ON_GROUND = ("disarmed", "armed")
AWAY_FROM_WAY_M = 1.0
"""The virtual aircraft holds its place and height to half a metre."""


class Watch:
    """Where it is, m north, east and up of the take-off point, against the way of its operator."""

    def __init__(self, rig: Rig, phase: str) -> None:
        self.rig, self.way = rig, WAYS[phase]
        self.farthest = 0.0  # m away from that way, so far

    @property
    def place(self) -> tuple[float, float, float]:
        motion = self.rig.aircraft.vehicle.flight.dynamics
        return motion.north, motion.east, self.rig.height

    def is_at(self, point: tuple[float, float, float], within: float = AWAY_FROM_WAY_M) -> bool:
        return math.dist(self.place, point) < within

    async def run(self) -> None:
        while True:
            legs = [*pairwise(self.way)] or [(self.way[0], self.way[0])]
            away = min(distance(self.place, *leg) for leg in legs)
            self.farthest = max(self.farthest, away)
            await anyio.sleep(0.02)


def distance(
    place: tuple[float, float, float],
    begin: tuple[float, float, float],
    end: tuple[float, float, float],
) -> float:
    """From a leg of a way, m."""
    leg = [two - one for one, two in zip(begin, end, strict=True)]
    size = sum(one * one for one in leg)
    share = sum((here - one) * along for here, one, along in zip(place, begin, leg, strict=True))
    share = min(1.0, max(0.0, share / size)) if size else 0.0
    return math.dist(place, [one + share * along for one, along in zip(begin, leg, strict=True)])


@asynccontextmanager
async def watched(rig: Rig, phase: str) -> AsyncIterator[Watch]:
    """Bring it into a phase, and compare it with the way ordered in it from then on."""
    watch = Watch(rig, phase)
    await begin(rig, phase)
    async with anyio.create_task_group() as group:
        group.start_soon(watch.run)
        yield watch
        group.cancel_scope.cancel()
    assert watch.farthest < AWAY_FROM_WAY_M


async def begin(rig: Rig, phase: str) -> None:
    ground = rig.ground
    if phase == "armed":
        await ground.arm()
    elif phase == "take-off":
        await ground.arm()
        altitude = rig.ground_altitude + ABOVE[2]
        asked = ground.ask(MavCommand.NAV_TAKEOFF, 0, 0, 0, NAN, NAN, NAN, altitude)
        assert await asked is MavResult.ACCEPTED
        await rig.until(lambda: rig.height > 0.5)
    elif phase == "mission":
        items = [waypoint(*AWAY), waypoint(*CORNER)]
        assert await Exchange(ground).upload(items) is MissionResult.ACCEPTED
        await ground.arm()
        assert await ground.ask(MavCommand.MISSION_START, 0, 0) is MavResult.ACCEPTED
        await rig.until(lambda: rig.height > 5.0)
    elif phase != "disarmed":
        await ground.fly(height=HIGH[2] if phase == "landing" else ABOVE[2])
    if phase == "on its way":
        home = rig.vehicle.world.home
        assert home is not None
        target = (*home.frame.to_geodetic(*AWAY[:2]), rig.ground_altitude + AWAY[2])
        asked = ground.ask(MavCommand.DO_REPOSITION, 3.0, 0, NAN, NAN, *target)
        assert await asked is MavResult.ACCEPTED
    if phase == "landing":
        assert await ground.set_mode(Mode.LAND) is MavResult.ACCEPTED


async def attacked(
    rig: Rig,
    attack: Callable[[Random, int], Datagrams],
    systems: tuple[int, int],
    seed: int,
    *,
    seconds: float = 8.0,
) -> None:
    """250 datagrams a second from each of two addresses."""
    random = Random(seed)
    sources = [(attack(random, system), system) for system in systems]
    for step in range(round(seconds * 50)):
        for (source, system), address in zip(sources, STRANGERS, strict=True):
            if step % 40 == 0:
                rig.bridge.received(of("HEARTBEAT", system, type=6, autopilot=8), address)
            for _ in range(5):
                rig.bridge.received(next(source), address)
        await anyio.sleep(0.02)


SENDERS: dict[str, tuple[bytes | None, tuple[int, int]]] = {
    "strangers": (None, (77, 78)),
    "forged system": (None, (245, 245)),
    "with a key": (KEY, (77, 245)),
}
CASES = [
    (phase, attack, sender)
    for phase in WAYS
    for attack in ATTACKS
    for sender, (key, _) in SENDERS.items()
    if key or (phase, attack) != ("disarmed", "orders of two other stations")
]


@pytest.mark.slow
@pytest.mark.parametrize(("phase", "attack", "sender"), CASES)
async def test_nobody_but_its_operator_moves_it(
    tmp_path: Path, phase: str, attack: str, sender: str
) -> None:
    key, systems = SENDERS[sender]
    seed = sum(map(ord, phase + attack + sender))
    signer = PacketSigner(key, sent=2**47) if key else None
    rig = Rig(firmware="3.1", signer=signer, logs=tmp_path)
    async with rig.running(), watched(rig, phase) as watch:
        start = watch.place
        gimbal = rig.aircraft.vehicle.gimbal.pitch
        await attacked(rig, ATTACKS[attack], systems, seed)
        assert rig.motors_on is (phase not in ON_GROUND)
        if phase in ON_GROUND:
            assert watch.place == start
        if phase != "disarmed" or key:  # nobody flies it there: anybody may take a photo
            assert rig.aircraft.vehicle.camera.photos == 0
            assert rig.aircraft.vehicle.gimbal.pitch == gimbal
        await rig.until(lambda: watch.is_at(watch.way[-1]), within=90.0)
        if phase not in ON_GROUND:  # and its operator still lands it, where it is
            await rig.until(lambda: phase == "landing" or rig.ground.mode is Mode.HOLD)
            assert watch.farthest < AWAY_FROM_WAY_M
            watch.way = (watch.way[-1], (*watch.way[-1][:2], 0.0))
            assert await rig.ground.set_mode(Mode.LAND) is MavResult.ACCEPTED
            await rig.until(lambda: not rig.motors_on, within=90.0)


async def test_a_forger_moves_nothing_in_half_a_second_of_a_take_off() -> None:
    """The short form of the test above, for each run of all tests."""
    async with Rig(firmware="3.1").running() as rig, watched(rig, "take-off"):
        await attacked(rig, flies, (245, 78), 7, seconds=0.5)


FLOODED = [(phase, sender) for phase in WAYS for sender in SENDERS]


@pytest.mark.slow
@pytest.mark.parametrize(("phase", "sender"), FLOODED)
async def test_a_flood_of_orders_moves_nothing(phase: str, sender: str) -> None:
    """A second of 2 MB/s, more than the bridge reads; disarmed, of those that order nothing."""

    def flood(random: Random, system: int) -> Datagrams:
        source = looks(random, system) if phase == "disarmed" else flies(random, system)
        yield from cycle([b"".join(next(source) for _ in range(100))[:4000] for _ in range(8)])

    key, systems = SENDERS[sender]
    signer = PacketSigner(key, sent=2**47) if key else None
    async with Rig(firmware="3.1", signer=signer).running() as rig, watched(rig, phase) as watch:
        await attacked(rig, flood, systems, 11, seconds=1.0)
        assert rig.bridge.dropped > 100
        await rig.until(lambda: watch.is_at(watch.way[-1]), within=90.0)


@pytest.mark.slow
@pytest.mark.parametrize("firmware", ["1.0", "3.1"])
@pytest.mark.parametrize("phase", WAYS)
async def test_an_operator_that_falls_silent_under_attack_leaves_a_hover(
    phase: str, firmware: str
) -> None:
    """A landing goes on, and on the ground control goes back: nobody's orders begin there."""
    async with Rig(firmware=firmware).running() as rig, watched(rig, phase) as watch:
        rig.ground.is_silent = True
        await attacked(rig, looks, (77, 78), 3, seconds=4.0)
        if phase in ("landing", *ON_GROUND):
            await rig.until(lambda: not rig.motors_on, within=90.0)
            await rig.until(lambda: not rig.agent.holding.has_authority)
            assert watch.is_at(GROUND)
            return
        await rig.until(lambda: rig.vehicle.manager.mode is Mode.HOLD)
        await anyio.sleep(3.0)
        rests = watch.place
        await attacked(rig, looks, (77, 78), 4)
        assert watch.is_at(rests)
        assert rig.speed < 0.3


@pytest.mark.slow
@pytest.mark.parametrize("phase", WAYS)
async def test_what_was_recorded_of_its_operator_moves_nothing_with_a_key(phase: str) -> None:
    """All that a flight needs is recorded, and played in each phase of a later flight."""
    signer = PacketSigner(KEY, sent=2**47)
    first, second = (Rig(firmware="3.1", signer=signer) for _ in range(2))
    second.ground_signer = first.ground_signer  # its clock goes on
    async with first.running() as rig:
        recorded: list[bytes] = []
        take = rig.bridge.received

        def listen(data: bytes, address: tuple[str, int]) -> None:
            recorded.append(data)
            take(data, address)

        rig.bridge.received = listen  # type: ignore[method-assign]  # a tap on the wire
        await begin(rig, "mission")
        await anyio.sleep(8.0)
        await rig.ground.set_mode(Mode.RTL)
        await rig.until(lambda: not rig.motors_on, within=90.0)
        await anyio.sleep(3.0)
        rig.bridge.received = take  # type: ignore[method-assign]  # and off
    async with second.running() as rig, watched(rig, phase) as watch:
        for data in recorded:
            for address in (GCS, STRANGERS[0]):
                rig.bridge.received(data, address)
            await anyio.sleep(0.01)
        await rig.until(lambda: watch.is_at(watch.way[-1]), within=90.0)
