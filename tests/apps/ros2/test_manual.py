"""The manual's calls of services, in its order, by a program: each does what the page says."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest

from m100link.log.cdr import DEFINITIONS
from tests.apps.ros2.conftest import Rig

pytestmark = pytest.mark.anyio

PAGE = Path(__file__).parents[3] / "docs" / "howto" / "fly-by-ros2.md"
CALL = re.compile(r"ros2 service call /m100/(\S+) (\w+/srv/\w+)(?: (['\"])(.*?)\3)?", re.DOTALL)


def zero_of(kind: str) -> Any:
    if kind.endswith("]"):
        return []
    if kind in DEFINITIONS:
        return whole(kind, {})
    return {"string": "", "bool": False}.get(kind, 0.0 if kind.startswith("float") else 0)


def whole(kind: str, given: dict[str, Any]) -> dict[str, Any]:
    """A message of which some fields are given, as the command line of ROS takes it."""
    fields = {name: of for of, name in (one.split() for one in DEFINITIONS[kind].splitlines())}
    assert set(given) <= set(fields), "the page gives a field that is not there"
    made = {name: given.get(name, zero_of(of)) for name, of in fields.items()}
    for name, of in fields.items():
        inner = of.partition("[")[0]
        if of.endswith("]") and inner in DEFINITIONS:
            made[name] = [whole(inner, one) for one in made[name]]
    return made


async def test_services_are_called_as_the_page_says() -> None:
    calls = CALL.findall(PAGE.read_text(encoding="utf-8"))
    names = [name for name, *_ in calls]
    assert names[:3] == ["obtain_control", "takeoff", "land"]
    assert {"mission/upload", "mission/start", "point_gimbal"} <= set(names)
    async with Rig(firmware="3.1").running() as rig:
        for name, kind, _, text in calls:
            given = json.loads(re.sub(r"(\w+):", r'"\1":', text)) if text else {}
            request = whole(f"{kind}_Request", given) if given else {}
            answer = await rig.program.call(f"~/{name}", kind, **request)
            assert answer["success"], (name, answer)
            if name in ("takeoff", "land"):
                await rig.until(lambda: not rig.client.state.task)
        # The mission ends at home.
        await rig.until(lambda: rig.height > 20.0)
        assert rig.aircraft.vehicle.gimbal.pitch == pytest.approx(-60.0, abs=1.0)
        await rig.until(lambda: not rig.motors_on, 300.0)
    assert len(calls) == 7
