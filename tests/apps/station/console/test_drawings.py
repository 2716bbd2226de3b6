"""What the scripts of the page draw of the known aircraft: signs, units, directions.

A canvas counts y downwards and turns clockwise. By the convention of attitude indicators the
horizon turns against the roll, and rises where the nose points down.
"""

from __future__ import annotations

import json
import math
import shutil
import subprocess
from pathlib import Path
from typing import Any

import pytest

from m100link.apps.station.console.view.fly import live
from m100link.apps.station.console.view.texts import (
    Language,
    LengthUnit,
    SpeedUnit,
    Translator,
    Units,
    for_browser,
)
from m100link.telemetry.state import AircraftState
from tests import known
from tests.known import seen

pytestmark = pytest.mark.skipif(shutil.which("node") is None, reason="node is not installed")

HERE = Path(__file__).parent
STATIC = HERE.parents[3] / "m100link/apps/station/console/static"

GERMAN = Translator(Language.GERMAN, Units(LengthUnit.FOOT, SpeedUnit.KM_H))
BELOW, HEIGHT = 20.0, 300.0  # the strip of the heading; what is left of 320 pixels
FROM, TO = (-33.12, 151.23), (-33.119, 151.232)
"""A place and another: 111.3 m to the north and 186.5 m to the east of it, on a sphere."""


def message(**changed: Any) -> dict[str, Any]:
    state = AircraftState(lambda: 0.25)
    state.update(known.sample())
    return live(seen(state)) | changed


TOLD: dict[str, tuple[dict[str, Any], Translator]] = {
    "metric": (message(), Translator()),
    "feet": (message(), GERMAN),
    "sinks": (message(vel=[3.57, -0.84, 3.21, -1.57]), Translator()),
    "nothing": ({"op": "live", "t": 1.0}, Translator()),
}


@pytest.fixture(scope="module")
def drawn() -> dict[str, dict[str, Any]]:
    told = [
        {"chosen": for_browser(speaker), "live": one, "from": FROM, "to": TO}
        for one, speaker in TOLD.values()
    ]
    program = ["node", str(HERE / "drawings.mjs"), str(STATIC), json.dumps(told)]
    done = subprocess.run(program, capture_output=True, text=True, check=True)
    return dict(zip(TOLD, json.loads(done.stdout), strict=True))


@pytest.fixture
def shown(drawn: dict[str, dict[str, Any]]) -> dict[str, Any]:
    return drawn["metric"]


def calls(found: dict[str, Any], name: str) -> list[list[Any]]:
    return [one[1:] for one in found["notes"] if one[0] == name]


def texts(found: dict[str, Any]) -> list[tuple[str, float, float]]:
    return [(str(text), x, y) for text, x, y, *_ in calls(found, "fillText")]


def test_the_horizon_turns_against_the_roll_and_rises_as_the_nose_goes_down(
    shown: dict[str, Any],
) -> None:
    [[angle, _]] = calls(shown, "rotate")
    assert angle == pytest.approx(math.radians(-10.0))
    ladder = [y for x, y, *_ in calls(shown, "translate") if x == 0 and y]
    # 60 degrees from top to bottom: nose 20 degrees down, the horizon 100 pixels up.
    assert ladder[0] == pytest.approx(-20.0 * HEIGHT / 60.0)
    sky, ground = calls(shown, "fillRect")[:2]
    assert (sky[1] < 0 == ground[1], sky[-1], ground[-1]) == (True, "#3b7dc4", "#7a5f30")
    marks = {text: y for text, _, y in texts(shown)[:6]}
    assert marks["30"] < marks["10"] < 0 < marks["-10"] < marks["-30"]


def test_the_heading_is_clockwise_from_north(shown: dict[str, Any]) -> None:
    assert ("230°", 200.0, 15.0) in texts(shown)
    tape = {text: x for text, x, y in texts(shown) if y == 15.0 and text in ("210", "240", "W")}
    # Three pixels a degree, west of south-west to the right.
    assert tape == {
        "210": pytest.approx(140.0),
        "240": pytest.approx(230.0),
        "W": pytest.approx(320.0),
    }


@pytest.mark.parametrize(
    ("told", "speed", "height", "units", "said"),
    [
        ("metric", "3.6", "12.3", ["m/s", "m"], ["12.3 m", "-3.2 m/s"]),
        ("feet", "12,9", "40,5", ["km/h", "ft"], ["40,5 ft", "-11,6 km/h"]),
    ],
)
def test_tapes_show_speed_and_height_in_the_units_that_were_chosen(
    drawn: dict[str, dict[str, Any]],
    told: str,
    speed: str,
    height: str,
    units: list[str],
    said: list[str],
) -> None:
    found = drawn[told]
    middle = [text for text, x, y in texts(found) if y == HEIGHT / 2 + 5 and x == 23.0]
    assert middle == [speed, height]
    assert [text for text, _, y in texts(found) if y == HEIGHT - 5] == units
    shown = [(float(text), y) for text, x, y in texts(found) if x == 23.0 and y not in (155, 295)]
    upwards = [value for value, _ in sorted(shown[:5], key=lambda one: -one[1])]
    assert upwards == sorted(upwards), "larger numbers stand above"
    assert [found["length"], found["speed"]] == said


@pytest.mark.parametrize(
    ("told", "top", "look"), [("metric", 118.5, "#81c784"), ("sinks", 150.0, "#ffb74d")]
)
def test_climb_goes_up_from_the_middle_and_sinking_down(
    drawn: dict[str, dict[str, Any]], told: str, top: float, look: str
) -> None:
    x, y, _, size, colour = calls(drawn[told], "fillRect")[-1]
    # 4 m/s at either end: 0.84 of them are 31.5 of 150 pixels.
    assert (x, y, size) == (3, pytest.approx(top), pytest.approx(31.5))
    assert colour == look


def test_sticks_have_their_sign_and_their_channel(shown: dict[str, Any]) -> None:
    values = {name: one["--value"] for name, one in shown["bars"].items()}
    assert values == {"roll": 0.1, "pitch": -0.2, "yaw": 0.3, "throttle": -0.4}
    assert [one["title"] for one in shown["bars"].values()] == [1000, -2000, 3000, -4000]
    assert not any(one["stale"] for one in shown["bars"].values())


def test_what_is_not_reported_is_crossed_out(drawn: dict[str, dict[str, Any]]) -> None:
    found = drawn["nothing"]
    assert found["stale"] == "stale"
    words = for_browser(Translator())["words"]
    assert isinstance(words, dict)
    said = [text for text, _, _ in texts(found)]
    assert said.count(words["old"]) == 2
    assert words["no_attitude"] in said
    assert all(one["stale"] for one in found["bars"].values())


def test_the_map_measures_east_and_north(shown: dict[str, Any]) -> None:
    assert shown["metres"] == pytest.approx([186.5, 111.3], abs=0.3)
    assert shown["place"] == pytest.approx(TO, abs=1e-9)
    assert shown["bearing"] == pytest.approx(59.2, abs=0.1)
