"""The table of items: what it says, and that whatever enumerates items has them all."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from typing import Any, get_args, get_type_hints

import pytest

import m100link
from m100link.errors import UsageError
from m100link.protocol import PROFILES, TelemetryPacket, encode_telemetry, records
from m100link.protocol.commands.activation import RATES_HZ
from m100link.protocol.items import (
    BY_NAME,
    BY_RECORD,
    ITEMS,
    Item,
    ItemLayout,
    Record,
    RecordViews,
    layouts,
)

# Bit, name and default rate as the document prints them (2.2.3.1).
DOCUMENT = [
    ("time", 100),
    ("quaternion", 100),
    ("acceleration", 100),
    ("velocity", 100),
    ("angular_velocity", 100),
    ("position", 100),
    ("magnetometer", 0),
    ("rc", 50),
    ("gimbal", 50),
    ("flight_status", 10),
    ("battery", 1),
    ("control_device", 0),
]

each_item = pytest.mark.parametrize("item", ITEMS, ids=[item.name for item in ITEMS])


def test_bits_names_and_rates_are_those_of_the_document() -> None:
    assert [(item.name, item.rate_hz) for item in ITEMS] == DOCUMENT
    assert [item.bit for item in ITEMS] == list(range(len(DOCUMENT)))
    assert list(BY_NAME.values()) == list(BY_RECORD.values()) == list(ITEMS)


@each_item
def test_every_item_has_a_rate_that_can_be_set(item: Item) -> None:
    assert item.rate_hz in RATES_HZ


@each_item
def test_every_record_has_its_view_of_packages_and_state(item: Item) -> None:
    name = re.sub(r"(?<!^)(?=[A-Z])", "_", item.record.__name__).lower()
    view = getattr(RecordViews, name)
    assert view.__doc__
    assert get_type_hints(view.fget)["return"] == item.record | None


def test_the_public_records_are_those_of_the_table() -> None:
    public = {name: getattr(m100link, name) for name in records.__all__}
    of_items = {item.record.__name__: item.record for item in ITEMS}
    assert {n: kind for n, kind in public.items() if issubclass(kind, tuple)} == of_items
    assert set(records.__all__) <= set(m100link.__all__)


def test_any_record_means_every_record_of_the_table() -> None:
    assert get_args(Record) == tuple(item.record for item in ITEMS)


@each_item
def test_every_item_reaches_its_record_under_every_firmware_that_has_it(item: Item) -> None:
    """Every wire field arrives in the record field that the table names for it."""
    carriers = [profile for profile in PROFILES.values() if item.name in profile.items]
    assert carriers
    for profile in carriers:
        wire = profile.items[item.name].fields
        raw = {field: number for number, field in enumerate(wire, start=1)}
        value = encode_telemetry({item.name: list(raw.values())}, profile)
        packet = TelemetryPacket(value, profile)
        record: Any = packet.get(item.record)
        expected = [raw.get(field) for field in item.fields]
        assert list(record) == expected + [getattr(profile, f) for f in item.profile_fields]
        assert packet.raw_items() == {item.name: raw}
        assert packet.columns == tuple(f"{item.name}.{field}" for field in wire)


def test_a_firmware_has_the_latest_layout_that_it_descends_from() -> None:
    assert layouts("1.0")["time"] == ItemLayout("I", ("tick",))
    assert layouts("1.0", "2.3", "3.1")["time"].fields == ("tick", "nanoseconds", "sync")
    assert layouts("1.0", "2.3", "3.1")["velocity"] == layouts("1.0", "2.3")["velocity"]
    assert layouts("2.3").keys() == {"velocity"}
    with pytest.raises(UsageError, match=r"4\.0"):
        layouts("1.0", "4.0")


@pytest.mark.parametrize(
    ("format_", "fields", "seen"),
    [
        ("3f", ("x", "y"), "3 values"),
        ("f", ("x", "y"), "1 values"),
        ("k", ("x",), "'k' is not a layout"),
    ],
)
def test_a_layout_names_each_of_its_values(
    format_: str, fields: tuple[str, ...], seen: str
) -> None:
    with pytest.raises(UsageError, match=seen):
        ItemLayout(format_, fields)


@pytest.mark.parametrize(
    ("wrong", "seen"),
    [
        ({"fields": ("percent", "volts")}, "other fields"),
        ({"profile_fields": ("tick_hz",)}, "other fields"),
        ({"views": ("volts",)}, "no view volts"),
        ({"layouts": {"1.0": ItemLayout("2B", ("percent", "volts"))}}, "cannot have the fields"),
        ({"layouts": {"1.0": ItemLayout("", ())}}, "cannot have the fields"),
    ],
)
def test_a_row_whose_parts_do_not_fit_is_refused(wrong: dict[str, Any], seen: str) -> None:
    with pytest.raises(UsageError, match=seen):
        replace(BY_NAME["battery"], **wrong)


def test_the_items_stand_in_the_order_of_their_bits_without_a_gap() -> None:
    """What finds an item by its bit takes it from its place."""
    assert [item.bit for item in ITEMS] == list(range(len(ITEMS)))


def test_an_item_is_found_by_its_record_and_nothing_else() -> None:
    assert all(m100link.protocol.items.item_of(item.record) is item for item in ITEMS)
    for other in (
        dict,
        [records.Attitude],
        {records.Attitude: 50},
    ):  # a list of them is a likely slip
        with pytest.raises(UsageError, match="is not a telemetry record"):
            m100link.protocol.items.item_of(other)  # type: ignore[arg-type] # what is asked


@pytest.mark.parametrize(
    ("latitude", "longitude", "altitude", "is_possible"),
    [
        (0.9, 0.1, 12.0, True),
        (-1.55, -3.1, 0.0, True),
        (1.56, 0.0, 0.0, False),
        (0.9, 6.3, 0.0, False),
        (math.nan, 0.1, 0.0, False),
        (0.9, math.inf, 0.0, False),
        (0.9, 0.1, -math.inf, False),
    ],
)
def test_a_place_is_possible_when_it_is_finite_and_not_at_a_pole(
    latitude: float, longitude: float, altitude: float, is_possible: bool
) -> None:
    assert records.Position(latitude, longitude, altitude, 0.0, 5).is_possible is is_possible
