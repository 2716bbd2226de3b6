"""The example of a fleet, and twenty of which three cannot: on a network in memory."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from types import ModuleType

import anyio
import pytest

from m100link.apps.fleet.payloads import Outcome
from tests.apps.fleet.conftest import Rig

pytestmark = pytest.mark.anyio

EXAMPLE = Path(__file__).parents[3] / "examples" / "fleet" / "all_take_off.py"


def example() -> ModuleType:
    spec = importlib.util.spec_from_file_location("all_take_off", EXAMPLE)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


async def test_all_take_off_climb_and_land_but_one_that_refuses(
    rig: Rig, capsys: pytest.CaptureFixture[str]
) -> None:
    ones = [await rig.aircraft(name) for name in ("a1", "a2", "a3")]
    ones[1].aircraft.vehicle.remote.set_mode("P")
    pilot = await rig.pilot()
    highest = [0.0] * 3

    async def look() -> None:
        while True:
            highest[:] = [max(one.height, most) for one, most in zip(ones, highest, strict=True)]
            await anyio.sleep(0.5)

    async with anyio.create_task_group() as group:
        group.start_soon(look)
        await example().fly(pilot)
        group.cancel_scope.cancel()
    told = capsys.readouterr().out.splitlines()
    assert told[0] == "take-off a1: ok"
    assert told[1].startswith("take-off a2: refused (")
    assert told[2] == "take-off a3: ok"
    assert told[3:] == ["climb a1: ok", "climb a3: ok", *(f"landing a{n}: ok" for n in (1, 2, 3))]
    assert highest == pytest.approx([3.0, 0.0, 4.0], abs=0.6)


async def test_of_twenty_three_are_named_with_their_reason(rig: Rig) -> None:
    """One in P mode, one with an empty battery, one unplugged."""
    ones = {name: await rig.aircraft(name) for name in (f"a{n:02}" for n in range(1, 21))}
    ones["a03"].aircraft.vehicle.remote.set_mode("P")
    ones["a07"].aircraft.battery_percent = 10.0
    ones["a11"].aircraft.stall_line()
    await anyio.sleep(5.0)
    results = await (await rig.pilot()).each(lambda one: one.take_off())
    bad = {name: result for name, result in results.items() if not result.is_ok}
    assert set(bad) == {"a03", "a07", "a11"}, {name: str(one) for name, one in bad.items()}
    assert len(results) == 20
    assert bad["a03"].outcome is Outcome.REFUSED
    assert bad["a07"].outcome is Outcome.REFUSED
    assert "battery" in str(bad["a07"])
    assert bad["a11"].outcome in (Outcome.REFUSED, Outcome.UNKNOWN)
    assert all((one.height > 1.0) is (name not in bad) for name, one in ones.items())
