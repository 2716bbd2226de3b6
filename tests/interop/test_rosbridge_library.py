"""rosbridge_suite's own library beside the station: the same clients, the answers field by field.

It needs a Python with rospy, and is skipped without one: see conftest.py.
"""

from __future__ import annotations

import json
import os
import subprocess
from pathlib import Path

import pytest

pytest.importorskip("starlette", reason="the extra `station` is not installed")

from tests.interop.rosbridge_scenarios import SCENARIOS, WORLD, Seen, ours, theirs
from tests.waiting import PATIENCE

HERE = Path(__file__).parent
MANUAL = HERE.parent.parent / "docs" / "reference" / "station.md"

pytestmark = pytest.mark.timeout(600)


def deliberate() -> set[str]:
    """The clients in the table of the manual."""
    section = MANUAL.read_text().split("### Where it differs from rosbridge_suite", 1)[1]
    rows = [line for line in section.split("\n### ", 1)[0].splitlines() if line.startswith("| ")]
    return {row.split(" | ")[0].removeprefix("| ") for row in rows[1:]}


@pytest.fixture(scope="module")
def reference(ros_python: str, rosbridge_library: str) -> dict[str, Seen]:
    """What each client saw of the reference."""
    done = subprocess.run(
        [ros_python, str(HERE / "rosbridge_reference.py")],
        input=json.dumps({"world": WORLD, "scenarios": SCENARIOS}),
        env={**os.environ, "PYTHONPATH": rosbridge_library},
        capture_output=True,
        text=True,
        timeout=4 * PATIENCE,
        check=False,
    )
    answers = [json.loads(line) for line in done.stdout.splitlines()]
    assert len(answers) == len(SCENARIOS), done.stderr
    return {answer["name"]: theirs(answer) for answer in answers}


@pytest.mark.parametrize("name", SCENARIOS)
def test_a_client_sees_the_same_unless_the_manual_says_why_not(
    reference: dict[str, Seen], name: str
) -> None:
    if name in deliberate():
        assert ours(SCENARIOS[name]) != reference[name], "the manual lists it, and it is the same"
    else:
        assert ours(SCENARIOS[name]) == reference[name]


def test_the_manual_lists_clients_that_there_are() -> None:
    assert deliberate() <= set(SCENARIOS)
    assert len(SCENARIOS) == 113, "the manual names the number"
