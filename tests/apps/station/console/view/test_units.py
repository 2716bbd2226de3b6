"""Lengths and speeds in each unit, and numbers in each language."""

from __future__ import annotations

import pytest

from m100link.apps.station.console.view.units import (
    Kind,
    Language,
    LengthUnit,
    Quantity,
    SpeedUnit,
    Units,
    number,
)


@pytest.mark.parametrize(
    ("unit", "text"), [(LengthUnit.METRE, "30.5 m"), (LengthUnit.FOOT, "100.0 ft")]
)
def test_a_height_in_each_unit(unit: LengthUnit, text: str) -> None:
    assert Units(length=unit).text(Quantity.length(30.48, 1)) == text


@pytest.mark.parametrize(
    ("unit", "text"),
    [(SpeedUnit.M_S, "10.0 m/s"), (SpeedUnit.KM_H, "36.0 km/h"), (SpeedUnit.KNOT, "19.4 kn")],
)
def test_a_speed_in_each_unit(unit: SpeedUnit, text: str) -> None:
    assert Units(speed=unit).text(Quantity.speed(10.0)) == text


def test_what_rises_has_a_plus_and_a_zero_has_no_minus() -> None:
    units = Units()
    assert units.text(Quantity.speed(1.26, signed=True)) == "+1.3 m/s"
    assert units.text(Quantity.speed(-1.26, signed=True)) == "-1.3 m/s"
    assert units.text(Quantity.speed(-0.01, signed=True)) == "+0.0 m/s"
    assert number(-0.01, 1) == "0.0"


def test_a_german_number_has_a_comma() -> None:
    assert number(1.5, 1, Language.GERMAN) == "1,5"
    assert Units().text(Quantity.length(1.5, 1), Language.GERMAN) == "1,5 m"


def test_every_unit_converts_and_has_a_sign() -> None:
    for length in LengthUnit:
        for speed in SpeedUnit:
            units = Units(length, speed)
            assert units.convert(1.0, Kind.LENGTH) > 0
            assert units.convert(1.0, Kind.SPEED) > 0
            assert (units.unit(Kind.LENGTH), units.unit(Kind.SPEED)) == (length.value, speed.value)
