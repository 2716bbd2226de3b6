"""Every name of an item or column that is understood, and the one that is written."""

from __future__ import annotations

import re
from dataclasses import replace
from importlib.util import find_spec, module_from_spec
from pathlib import Path

import pytest

from m100link import AircraftState
from m100link.protocol.items import BY_NAME, ITEMS
from m100link.telemetry.columns import ITEM_NAMES, column_named, columns_of, snake

COLUMNS = columns_of(item.record for item in ITEMS)


def test_an_item_is_known_by_its_own_name_that_of_the_state_and_that_of_the_document() -> None:
    for item in ITEMS:
        assert ITEM_NAMES[item.name] is item
        assert ITEM_NAMES[snake(item.record)] is item
        assert isinstance(getattr(AircraftState, snake(item.record)), property)
    document = "time q acc vel w pos mag rc gimbal flight_status battery ctrl_device"
    named = [ITEM_NAMES[name] for name in document.split()]
    assert named == list(ITEMS)[: len(named)]


def test_an_item_that_the_document_does_not_have_is_known_by_its_own_names(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A table of the document's names is no second list of items: an item is declared once."""
    another = replace(BY_NAME["control_device"], bit=15, name="nobody_has")
    monkeypatch.setattr("m100link.protocol.items.ITEMS", (*ITEMS, another))
    spec = find_spec("m100link.telemetry.columns")
    assert spec is not None
    assert spec.loader is not None
    made = module_from_spec(spec)
    spec.loader.exec_module(made)
    assert made.ITEM_NAMES["nobody_has"] is another
    assert made.column_named("nobody_has.control") == "nobody_has.control"
    assert made.column_named("vgx") == "velocity.north_m_s"


def test_every_column_is_known_as_it_is_written() -> None:
    assert [column_named(column) for column in COLUMNS] == COLUMNS


@pytest.mark.parametrize(
    ("name", "column"),
    [
        ("attitude.yaw_deg", "quaternion.yaw_deg"),
        ("remote_control.throttle", "rc.throttle"),
        ("velocity.x", "velocity.north_m_s"),
        ("VEL.vgz", "velocity.up_m_s"),
        ("vgx", "velocity.north_m_s"),
        ("agy", "acceleration.east_m_s2"),
        ("wz", "angular_velocity.down_rad_s"),
        ("q0", "quaternion.q0"),
        ("Q.q3", "quaternion.q3"),
        ("lati", "position.latitude_rad"),
        ("POS.longti", "position.longitude_rad"),
        ("alti", "position.altitude_m"),
        ("height", "position.height_m"),
        ("health_flag", "position.gps_health"),
        ("mag.mx", "magnetometer.x"),
        ("time_stamp", "time.tick"),
        ("battery.status", "battery.percent"),
        ("ctrl_device.status", "control_device.control"),
        ("gimbal.pitch", "gimbal.pitch_deg"),
    ],
)
def test_a_column_is_known_by_the_names_of_the_document(name: str, column: str) -> None:
    assert column_named(name) == column
    assert column in COLUMNS


@pytest.mark.parametrize("name", ["", "roll", "status", "position", "position.", "x.y", "rc.q0"])
def test_what_is_ambiguous_or_unknown_has_no_column(name: str) -> None:
    assert column_named(name) is None


def test_the_manual_lists_the_names_of_the_document() -> None:
    page = (Path(__file__).parents[2] / "docs/reference/telemetry.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| `(\w+)` \| `(\w+)` \| (?:`(\w+)`|none) \|", page, re.MULTILINE)
    missing = [
        item.name for item in ITEMS if item.name not in dict.fromkeys(row[0] for row in rows)
    ]
    assert not missing, f"the names in docs/reference/telemetry.md have no row for {missing}"
    assert [ITEM_NAMES[row[0]] for row in rows] == list(ITEMS)
    for names in rows:
        assert len({ITEM_NAMES[name.lower()].name for name in filter(None, names)}) == 1
