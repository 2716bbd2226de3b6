"""The short form of `python -m tests.soak.integrity`."""

from __future__ import annotations

import pytest

from tests.soak.integrity import flown


@pytest.mark.slow
def test_a_quarter_of_an_hour_in_weather_raises_no_false_alarm() -> None:
    found = flown(0.25, seed=1)
    print(found)  # noqa: T201 (pytest shows it when the test fails)
    assert found.alarms == []
    assert found.hours >= 0.25
