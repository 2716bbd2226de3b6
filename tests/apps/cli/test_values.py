"""Telemetry records as rows of named numbers."""

from __future__ import annotations

import math

import pytest

from m100link.apps.cli.display import items_named, row
from m100link.errors import UsageError
from m100link.protocol.items import BY_NAME, ITEMS, Item
from m100link.protocol.records import Attitude, Battery, FlightStatus, Position, RemoteControl
from m100link.telemetry.columns import columns_of


def test_a_row_has_the_fields_and_their_views_in_the_units_of_the_api() -> None:
    values = row(Position(math.radians(10.0), math.radians(20.0), 300.0, 12.5, 5))
    assert values["position.latitude_deg"] == pytest.approx(10.0)
    assert values["position.longitude_deg"] == pytest.approx(20.0)
    assert values["position.height_m"] == 12.5
    assert values["position.gps_health"] == 5


def test_an_enumeration_is_told_by_its_name_and_an_unknown_value_by_none() -> None:
    assert row(RemoteControl(0, 0, 0, 0, 8000, -4545))["rc.mode_switch"] == "F"
    assert row(FlightStatus(3))["flight_status.phase"] == "IN_AIR"
    assert row(FlightStatus(77))["flight_status.phase"] is None


@pytest.mark.parametrize("item", ITEMS, ids=lambda item: item.name)
def test_the_columns_are_announced_as_they_come(item: Item) -> None:
    ones = item.record(*[1] * len(item.record._fields))
    assert columns_of([item.record]) == list(row(ones))


def test_items_are_found_by_name_in_the_order_asked_for() -> None:
    assert items_named(["battery", "position"]) == [Battery, Position]
    assert items_named([]) == [item.record for item in ITEMS]


def test_a_name_that_is_not_an_item_lists_those_that_are() -> None:
    with pytest.raises(UsageError, match="altitude") as caught:
        items_named(["battery", "altitude"])
    assert all(name in caught.value.remedy for name in BY_NAME)
    with pytest.raises(UsageError) as caught:
        items_named(["Positon"])
    assert caught.value.remedy.startswith("did you mean position")


def test_items_are_found_by_the_names_of_the_state_and_of_the_document() -> None:
    assert items_named(["attitude", "Q", "remote_control", "POS"]) == [
        *(Attitude, Attitude, RemoteControl, Position)
    ]
