"""The model in three dimensions; the rest of the page is seen in a browser."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any, cast

import pytest

from tests.known import seen

pytest.importorskip("nicegui")

from m100link.apps.station.console.components.data import TelemetryPart
from m100link.apps.station.console.view.fly import instruments_of
from m100link.apps.station.console.view.situation import Inputs
from m100link.apps.station.console.view.texts import Translator
from m100link.telemetry.state import AircraftState
from tests import known


def test_the_model_points_where_the_aircraft_does() -> None:
    """The scene has east, north, up, the model forward, left, up; angles are right-handed.

    South-west by 230 degrees is 220 degrees from east, counter-clockwise. The nose goes down by a
    turn to the right hand about the left axis, the right side by one about the forward axis.
    """
    state = AircraftState(lambda: 0.0)
    state.update(known.sample())
    turned: list[tuple[float, float, float]] = []
    part = object.__new__(TelemetryPart)
    part._wording = cast(Any, Translator())
    label: Any = SimpleNamespace(set_text=lambda text: None, classes=lambda **_: None)
    part._rows, part._age, part._frame = {}, label, label
    part._model = cast(Any, SimpleNamespace(rotate=lambda *angles: turned.append(angles)))
    view = SimpleNamespace(instruments=instruments_of(Inputs(vehicle=seen(state))))
    part.update(cast(Any, view))
    [angles] = turned
    assert [math.degrees(one) % 360 for one in angles] == pytest.approx([10, 20, 220], abs=1e-3)
