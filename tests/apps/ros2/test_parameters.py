"""Parameters by the services that ``ros2 param`` calls."""

from __future__ import annotations

from typing import Any

import anyio
import pytest

from tests.apps.ros2.conftest import Program, Rig

pytestmark = pytest.mark.anyio


async def ask(program: Program, name: str, **request: Any) -> dict[str, Any]:
    kind = "".join(word.capitalize() for word in name.split("_"))
    return await program.call(f"~/{name}", f"rcl_interfaces/srv/{kind}", **request)


def value(number: float, kind: int = 3) -> dict[str, Any]:
    arrays = ("byte", "bool", "integer", "double", "string")
    return {
        "type": kind,
        "bool_value": False,
        "integer_value": 0,
        "double_value": number,
        "string_value": "",
        **{f"{one}_array_value": [] for one in arrays},
    }


async def names_of(program: Program, *prefixes: str) -> list[str]:
    answer = await ask(program, "list_parameters", prefixes=list(prefixes), depth=0)
    return list(answer["result"]["names"])


async def test_they_are_listed_described_and_read(rig: Rig, program: Program) -> None:
    names = await names_of(program)
    assert {"use_sim_time", "rates.imu", "guards.max_height_m"} <= set(names)
    assert set(await names_of(program, "guards")) == {n for n in names if n.startswith("guards.")}
    found = (await ask(program, "get_parameters", names=[*names, "nothing"]))["values"]
    types = (await ask(program, "get_parameter_types", names=[*names, "nothing"]))["types"]
    assert [one["type"] for one in found] == types
    assert types[-1] == 0
    by_name = dict(zip(names, found, strict=False))
    assert by_name["guards.max_height_m"]["double_value"] == rig.client.state.limits.max_height_m
    described = (await ask(program, "describe_parameters", names=names))["descriptors"]
    assert [one["name"] for one in described] == names
    assert {one["name"] for one in described if not one["read_only"]} == {
        n for n in names if n.startswith(("rates.", "deviations."))
    }


async def test_a_deviation_is_set_and_is_squared_in_the_covariance(
    rig: Rig, program: Program
) -> None:
    [before] = (await ask(program, "get_parameters", names=["deviations.height_m"]))["values"]
    assert before["double_value"] == 2.0
    wanted = [{"name": "deviations.height_m", "value": value(0.5)}]
    [result] = (await ask(program, "set_parameters", parameters=wanted))["results"]
    assert result["successful"]
    await anyio.sleep(0.2)
    pose = rig.said("~/odom")[-1]["pose"]["covariance"]
    fix = rig.said("~/fix")[-1]["position_covariance"]
    assert (pose[14], fix[8], pose[0]) == (0.25, 0.25, 6.25)


async def test_a_rate_is_set(rig: Rig, program: Program) -> None:
    slower = [{"name": "rates.imu", "value": value(10.0)}]
    [result] = (await ask(program, "set_parameters", parameters=slower))["results"]
    assert result["successful"]
    [now] = (await ask(program, "get_parameters", names=["rates.imu"]))["values"]
    assert now["double_value"] == 10.0
    await anyio.sleep(1.0)
    rig.outlet("~/imu").sent.clear()
    await anyio.sleep(5.0)
    assert len(rig.outlet("~/imu").sent) == pytest.approx(50, abs=2)


@pytest.mark.parametrize(
    ("name", "given"),
    [
        ("rates.imu", value(float("nan"))),
        ("rates.imu", value(-1.0)),
        ("rates.imu", value(200.0)),
        ("rates.imu", value(5.0, kind=2)),
        ("guards.max_height_m", value(9999.0)),
        ("use_sim_time", value(1.0)),
        ("nothing", value(1.0)),
    ],
)
async def test_what_cannot_be_set_says_why(
    rig: Rig, program: Program, name: str, given: dict[str, Any]
) -> None:
    before = dict(rig.node.teller.hz)
    wanted = [{"name": "rates.odom", "value": value(7.0)}, {"name": name, "value": given}]
    answer = await ask(program, "set_parameters_atomically", parameters=wanted)
    assert not answer["result"]["successful"]
    assert name in answer["result"]["reason"]
    assert rig.node.teller.hz == before


async def test_sim_time_may_be_said_to_be_what_it_is(rig: Rig, program: Program) -> None:
    same = [{"name": "use_sim_time", "value": value(0.0, kind=1)}]
    [result] = (await ask(program, "set_parameters", parameters=same))["results"]
    assert result["successful"]


async def test_a_rate_is_at_most_a_hundred_and_the_description_says_so(
    rig: Rig, program: Program
) -> None:
    hz = rig.node.teller.hz
    for wanted, now in ((0.0, 0.0), (100.0, 100.0), (100.1, 100.0)):
        asked = [{"name": "rates.odom", "value": value(wanted)}]
        [result] = (await ask(program, "set_parameters", parameters=asked))["results"]
        assert result["successful"] is (wanted == now)
        assert hz["~/odom"] == now
    names = ["rates.odom", "guards.max_height_m", "use_sim_time", "nothing"]
    rate, guard, sim, nothing = (await ask(program, "describe_parameters", names=names))[
        "descriptors"
    ]
    [span] = rate["floating_point_range"]
    assert (span["from_value"], span["to_value"], span["step"]) == (0.0, 100.0, 0.0)
    assert (rate["type"], guard["type"], sim["type"], nothing["type"]) == (3, 3, 1, 0)
    assert [one["read_only"] for one in (rate, guard, sim, nothing)] == [False, True, True, True]
    assert not guard["floating_point_range"]


async def test_sixty_four_names_are_answered_at_once_and_not_one_more(
    rig: Rig, program: Program
) -> None:
    before = rig.node.ends.refused
    answer = await ask(program, "get_parameter_types", names=["nothing"] * 64)
    assert answer["types"] == [0] * 64
    assert rig.node.ends.refused == before
    with anyio.move_on_after(1.0):
        await ask(program, "get_parameter_types", names=["nothing"] * 65)
    assert rig.node.ends.refused == before + 1
