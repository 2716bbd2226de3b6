"""Plans in files: which kind they are, and what cannot be read or written."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from m100link import BadPlan, Trace, Waypoint, WaypointPlan

PLAN = WaypointPlan(
    [Waypoint(52.1, 4.31, 20.0), Waypoint(52.101, 4.31, 20.0, damping=2)],
    trace=Trace.COORDINATED_TURNS,
)


@pytest.mark.parametrize("name", ["a.json", "a.plan", "A.PLAN", "a"])
def test_a_file_is_written_by_its_name_and_read_by_what_it_is(tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    PLAN.write(path)
    is_for_qgroundcontrol = '"fileType": "Plan"' in path.read_text(encoding="utf-8")
    assert is_for_qgroundcontrol == name.lower().endswith(".plan")
    renamed = path.rename(tmp_path / "other.txt")
    assert WaypointPlan.read(renamed) == WaypointPlan.read(str(renamed)) == PLAN


def test_what_cannot_be_read_or_written_says_why(tmp_path: Path) -> None:
    with pytest.raises(BadPlan, match=r"missing\.json' cannot be read: No such file"):
        WaypointPlan.read(tmp_path / "missing.json")
    with pytest.raises(BadPlan, match="cannot be read: Is a directory"):
        WaypointPlan.read(tmp_path)
    with pytest.raises(BadPlan, match=r"cannot be read: .*embedded null"):
        WaypointPlan.read("a\0b")
    with pytest.raises(BadPlan, match="cannot be written: Is a directory"):
        PLAN.write(tmp_path)


def test_what_is_far_too_large_is_not_read(tmp_path: Path) -> None:
    path = tmp_path / "large"
    with path.open("wb") as file:
        file.truncate(17 * 1024 * 1024)
    with pytest.raises(BadPlan, match="too large for a plan"):
        WaypointPlan.read(path)


def test_a_port_is_not_waited_for() -> None:
    ours, port = os.openpty()
    try:
        for device in (os.ttyname(port), "/dev/zero"):
            with pytest.raises(BadPlan, match="is a device, not a file"):
                WaypointPlan.read(device)
    finally:
        os.close(ours)
        os.close(port)


@pytest.mark.parametrize("text", ["", "{}", "[]", "null", '{"fileType": "plan"}', b"\xff"])
def test_what_is_neither_is_no_plan(text: str | bytes) -> None:
    with pytest.raises(BadPlan):
        WaypointPlan.parse(text)
