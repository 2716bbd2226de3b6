"""Strangers, forgers and floods in each phase of a flight: the aircraft does not move for them.

Without a key any program may hold, land and return, and fly an aircraft that nobody flies: these
are no attacks.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
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
from m100link.apps.mavlink.translator.numbers import MavCommand, MavResult
from m100link.apps.mavlink.translator.vehicle_state import MODES, Mode
from tests.apps.mavlink.conftest import GCS, Rig

pytestmark = [pytest.mark.anyio, pytest.mark.slow]

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
PHASES = ("disarmed", "armed", "hover", "on its way")


async def attacked(
    rig: Rig, attack: Callable[[Random, int], Datagrams], systems: tuple[int, int], seed: int
) -> None:
    """Eight seconds, 250 datagrams a second from each of two addresses."""
    random = Random(seed)
    sources = [(attack(random, system), system) for system in systems]
    for step in range(400):
        for (source, system), address in zip(sources, STRANGERS, strict=True):
            if step % 40 == 0:
                rig.bridge.received(of("HEARTBEAT", system, type=6, autopilot=8), address)
            for _ in range(5):
                rig.bridge.received(next(source), address)
        await anyio.sleep(0.02)


async def begun(rig: Rig, phase: str) -> tuple[float, float, float]:
    """Bring it into a phase; where it is to be afterwards, m north, east and up of its start."""
    if phase == "disarmed":
        return 0.0, 0.0, 0.0
    if phase == "armed":
        await rig.ground.arm()
        return 0.0, 0.0, 0.0
    await rig.ground.fly(height=6.0)
    if phase == "hover":
        return 0.0, 0.0, 6.0
    home = rig.vehicle.world.home
    assert home is not None
    target = (*home.frame.to_geodetic(15.0, 0.0), rig.ground_altitude + 6.0)
    asked = rig.ground.ask(MavCommand.DO_REPOSITION, 3.0, 0, NAN, NAN, *target)
    assert await asked is MavResult.ACCEPTED
    return 15.0, 0.0, 6.0


def place(rig: Rig) -> tuple[float, float, float]:
    motion = rig.aircraft.vehicle.flight.dynamics
    return motion.north, motion.east, rig.height


SENDERS: dict[str, tuple[bytes | None, tuple[int, int]]] = {
    "strangers": (None, (77, 78)),
    "forged system": (None, (245, 245)),
    "with a key": (KEY, (77, 245)),
}
CASES = [
    (phase, attack, sender)
    for phase in PHASES
    for attack in ATTACKS
    for sender, (key, _) in SENDERS.items()
    if key or (phase, attack) != ("disarmed", "orders of two other stations")
]


@pytest.mark.parametrize(("phase", "attack", "sender"), CASES)
async def test_nobody_but_its_operator_moves_it(
    tmp_path: Path, phase: str, attack: str, sender: str
) -> None:
    key, systems = SENDERS[sender]
    seed = sum(map(ord, phase + attack + sender))
    signer = PacketSigner(key, sent=2**47) if key else None
    rig = Rig(firmware="3.1", signer=signer, logs=tmp_path)
    async with rig.running():
        expected = await begun(rig, phase)
        start = place(rig)
        gimbal = rig.aircraft.vehicle.gimbal.pitch
        await attacked(rig, ATTACKS[attack], systems, seed)
        await rig.until(lambda: phase != "on its way" or abs(place(rig)[0] - 15.0) < 1.0)
        assert place(rig) == pytest.approx(expected, abs=1.0), f"seed {seed}"
        if phase in ("disarmed", "armed"):
            assert not rig.motors_on
            assert place(rig) == start
        if phase != "disarmed" or key:  # nobody flies it there: anybody may take a photo
            assert rig.aircraft.vehicle.camera.photos == 0
            assert rig.aircraft.vehicle.gimbal.pitch == gimbal
        if phase in ("hover", "on its way"):  # and its operator still flies it
            assert await rig.ground.set_mode(Mode.LAND) is MavResult.ACCEPTED
            await rig.until(lambda: not rig.motors_on, within=90.0)


@pytest.mark.parametrize("phase", ["hover", "on its way"])
async def test_an_operator_that_falls_silent_under_attack_leaves_a_hover(phase: str) -> None:
    async with Rig(firmware="3.1").running() as rig:
        await begun(rig, phase)
        rig.ground.is_silent = True
        await anyio.sleep(3.5)
        rests = place(rig)
        await attacked(rig, looks, (77, 78), 3)
        assert place(rig) == pytest.approx(rests, abs=2.0)
        assert rig.speed < 0.3


@pytest.mark.parametrize("phase", PHASES)
async def test_what_was_recorded_of_its_operator_moves_nothing_with_a_key(phase: str) -> None:
    """All that a flight needs is recorded, and played after its landing and in each phase."""
    signer = PacketSigner(KEY, sent=2**47)
    async with Rig(firmware="3.1", signer=signer).running() as rig:
        recorded: list[bytes] = []
        take = rig.bridge.received

        def listen(data: bytes, address: tuple[str, int]) -> None:
            recorded.append(data)
            take(data, address)

        rig.bridge.received = listen  # type: ignore[method-assign]  # a tap on the wire
        await begun(rig, "on its way")
        await anyio.sleep(8.0)
        await rig.ground.set_mode(Mode.LAND)
        await rig.until(lambda: not rig.motors_on, within=90.0)
        await anyio.sleep(3.0)
        rig.bridge.received = take  # type: ignore[method-assign]  # and off
        where = place(rig)
        if phase == "armed":
            await rig.ground.arm()
        elif phase != "disarmed":
            await rig.ground.fly(height=6.0)
            where = *where[:2], 6.0
        for data in recorded:
            for address in (GCS, STRANGERS[0]):
                rig.bridge.received(data, address)
            await anyio.sleep(0.01)
        assert place(rig) == pytest.approx(where, abs=1.0)
