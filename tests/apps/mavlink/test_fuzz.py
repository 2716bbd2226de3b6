"""Valid frames with any content: nothing raises out of the reader, and nothing flies away."""

from __future__ import annotations

import math
import struct
from random import Random
from typing import Any

import anyio
import pytest

from m100link.apps.mavlink.translator.codec import LAYOUTS, Layout
from m100link.apps.mavlink.translator.commands import COMMANDS
from m100link.apps.mavlink.translator.modes import Mode
from m100link.apps.mavlink.translator.numbers import Command, Result
from m100link.apps.mavlink.translator.route import ITEMS
from tests.apps.mavlink.conftest import Ground, Rig

pytestmark = pytest.mark.anyio

ODD = (math.nan, math.inf, -math.inf, 0.0, -0.0, 1e38, -1e38, 1e-40, 1.0, -1.0, 180.0, 47.0)


def any_fields(layout: Layout, random: Random) -> dict[str, Any]:
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
    assert await ground.ask(Command.GET_HOME_POSITION) in (0, 1)


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
    operator = rig.vehicle.deck.operator
    await pour(other, 9, 300)
    assert rig.vehicle.deck.operator in (None, operator)
    assert await other.ask(Command.DO_CHANGE_SPEED, 1, 3.0) in (
        Result.TEMPORARILY_REJECTED,
        Result.ACCEPTED,
    )
