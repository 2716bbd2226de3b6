"""The gamepad of a page: directions, dead zones, buttons, and each way in which it lets go.

On the standard mapping of the W3C a stick that is pushed away from oneself is -1, one that is
pushed to the right +1: axes 0 and 1 are the left stick, 2 and 3 the right one.
"""

from __future__ import annotations

import json
import shutil
import subprocess
from pathlib import Path
from typing import Any

import pytest

pytestmark = pytest.mark.skipif(shutil.which("node") is None, reason="node is not installed")

HERE = Path(__file__).parent
STATIC = HERE.parents[3] / "m100link/apps/station/console/static"

FLY, STOP = 4, 1
REST = [0.0, 0.0, 0.0, 0.0]

Step = dict[str, Any]


def step(axes: list[float] | None = None, *buttons: int, **changed: Any) -> Step:
    return {"axes": REST if axes is None else axes, "buttons": list(buttons)} | changed


def run(*steps: Step, kept: Any = None) -> Any:
    program = ["node", str(HERE / "gamepad.mjs"), str(STATIC), json.dumps(kept), json.dumps(steps)]
    done = subprocess.run(program, capture_output=True, text=True, check=True)
    return json.loads(done.stdout)


def beat(found: Any) -> dict[str, float] | None:
    """The setpoint that a look sent; None for none."""
    [*beats] = [one for one in found["notes"] if isinstance(one, dict) and one["op"] == "beat"]
    return {name: beats[0][name] for name in "xyzw"} if beats else None


def beats(*steps: Step, kept: Any = None) -> list[dict[str, float] | None]:
    return [beat(one) for one in run(*steps, kept=kept)["result"]]


# Mode 1: x is pitch, ° (negative forward), y roll, ° (positive to the right); mode 2: x is east and
# y north, m/s. z turns, °/s clockwise from above, and w climbs, m/s. At level 1: 2°, 0.5 m/s,
# 6 °/s, 0.3 m/s. Behind a dead zone of 0.1 a stick at 0.55 is half of its way.
DIRECTIONS: list[tuple[list[float], int, dict[str, float]]] = [
    ([0, -1, 0, 0], 1, {"w": 0.3}),
    ([0, 1, 0, 0], 1, {"w": -0.3}),
    ([1, 0, 0, 0], 1, {"z": 6.0}),
    ([-1, 0, 0, 0], 1, {"z": -6.0}),
    ([0, 0, 1, 0], 1, {"y": 2.0}),
    ([0, 0, -1, 0], 1, {"y": -2.0}),
    ([0, 0, 0, -1], 1, {"x": -2.0}),
    ([0, 0, 0, 1], 1, {"x": 2.0}),
    ([0, 0, 1, 0], 2, {"x": 0.5}),
    ([0, 0, 0, -1], 2, {"y": 0.5}),
    ([0, -0.55, 0, 0], 1, {"w": 0.15}),
    ([0.1, -0.1, 0.09, -0.1], 1, {}),
    ([0, -7.0, 0, 0], 1, {"w": 0.3}),
]


def test_sticks_fly_where_they_are_pushed_as_far_as_they_are_pushed() -> None:
    steps = [step()]
    steps += [step(axes, FLY, mode=mode) for axes, mode, _ in DIRECTIONS]
    for (axes, _, wanted), found in zip(DIRECTIONS, beats(*steps)[1:], strict=True):
        expected = dict.fromkeys("xyzw", 0.0) | wanted
        assert found == pytest.approx(expected, abs=1e-9), axes


def test_a_mapping_exchanges_axes_and_turns_them_round() -> None:
    """Mode 1 of two sticks: climb on the right one, forward on the left one, which is inverted."""
    usual = {"sign": -1, "dead": 0.2}
    kept = {"axes": {"up": {"axis": 3} | usual, "forward": {"axis": 1, "sign": 1, "dead": 0.0}}}
    _, climbs, forward, dead = beats(
        step(), step([0, 0, 0, -1], FLY), step([0, 0.5, 0, 0], FLY), step([0, 0, 0, 0.2], FLY),
        kept=kept | {"buttons": {"4": "fly", "0": "stop"}},
    )  # fmt: skip
    assert climbs == pytest.approx({"x": 0.0, "y": 0.0, "z": 0.0, "w": 0.3}, abs=1e-9)
    assert forward == pytest.approx({"x": -1.0, "y": 0.0, "z": 0.0, "w": 0.0}, abs=1e-9)
    assert dead == pytest.approx(dict.fromkeys("xyzw", 0.0), abs=1e-9)


UP = [0.0, -1.0, 0.0, 0.0]

LETS_GO: dict[str, Step] = {
    "its STOP is pressed": step(UP, FLY, STOP),
    "the handle is let go": step(UP),
    "it disconnects": step(UP, FLY, is_there=False),
    "the mapping page is opened": step(UP, FLY, view="settings"),
    "another view is opened": step(UP, FLY, view="plan"),
    "the pad loses the focus": step(UP, FLY, focus=False),
}


@pytest.mark.parametrize("how", LETS_GO)
def test_it_hovers_at_once_and_flies_only_for_a_new_press(how: str) -> None:
    back = {"view": "fly"}
    steps = [step(), step(UP, FLY), LETS_GO[how], step(UP, FLY, **back), step(), step(UP, FLY)]
    if how == "the handle is let go":
        del steps[3]  # that is the new press
    found = run(*steps)["result"]
    flew = [beat(one) is not None for one in found]
    assert flew[:2] == [False, True]
    assert {"op": "rest"} in found[2]["notes"]
    assert not any(flew[2:-1])
    assert flew[-1]


@pytest.mark.parametrize("first", [step(UP, FLY), step(UP, FLY, is_there=False)])
def test_one_that_comes_with_its_handle_held_flies_nothing(first: Step) -> None:
    assert beats(first, step(UP, FLY), step(UP, FLY)) == [None, None, None]


def pad(index: int, axes: list[float], *buttons: int, **changed: Any) -> dict[str, Any]:
    return {"id": "pad", "index": index, "axes": axes, "buttons": list(buttons)} | changed


def several(*pads: dict[str, Any] | None) -> Step:
    return {"pads": list(pads)}


@pytest.mark.parametrize(
    ("other", "gone"),
    [(pad(0, REST), None), (pad(0, UP), None), (pad(0, REST, 2), pad(1, UP, FLY, id="another"))],
    ids=str,
)
def test_one_that_comes_back_beside_another_flies_nothing(other: Any, gone: Any) -> None:
    """It went with its handle held, while another gamepad stayed."""
    held = several(other, pad(1, UP, FLY))
    without = several(other) if gone is None else several(other, gone)
    there, flies, *flew, anew = beats(
        several(other, pad(1, REST)), held, without, held, held, several(other, pad(1, REST)), held
    )
    assert (there, flew) == (None, [None] * 4)
    assert flies == anew is not None


# Where an axis rests that is no stick: a trigger, a hat, a throttle without a spring, a worn one.
@pytest.mark.parametrize(
    ("axis", "rest"), [(2, -1.0), (3, 1.0), (0, 3.2857), (0, 1.2857), (1, 1.0), (2, 0.11)]
)
def test_an_axis_that_does_not_rest_in_the_middle_moves_nothing(axis: int, rest: float) -> None:
    axes = [rest if one == axis else 0.0 for one in range(4)]
    steps = [step(axes), step(axes, FLY), step(axes), step(axes, FLY), step(), step(axes, FLY)]
    found = run(*steps)["result"]
    flew = [beat(one) is not None for one in found]
    assert flew == [False, False, False, False, False, True]
    fates = [one["fate"] for one in found]
    assert fates == ["", "let_go_first", "", "let_go_first", "", "sent"]


def test_a_gamepad_without_the_button_of_a_mapping_for_another_has_stop() -> None:
    kept = {"buttons": {"4": "fly", "14": "stop", "1": "fly"}}
    small, large = pad(0, REST, count=6), pad(0, REST, count=17)
    assert [
        run(several(one), several(one | {"buttons": [button]}), kept=kept)["result"][1][
            "notes"
        ].count("stop")
        for one, button in ((small, STOP), (large, STOP), (large, 14))
    ] == [1, 0, 1]


@pytest.mark.parametrize("count", [0, 40])
def test_however_many_axes_it_has_only_those_of_the_mapping_move(count: int) -> None:
    axes = [0.0 if one < 4 else 1.0 for one in range(count)]
    _, found = beats(several(pad(0, axes)), several(pad(0, axes, FLY)))
    assert found == pytest.approx(dict.fromkeys("xyzw", 0.0), abs=1e-9)


def test_without_its_handle_a_stick_moves_nothing() -> None:
    assert beats(step(), step(UP), step([1, 1, 1, 1], 0, 2, 3)) == [None, None, None]


@pytest.mark.parametrize("view", ["fly", "plan", "settings", "events"])
def test_stop_is_pressed_once_in_every_view_and_other_buttons_act_in_one(view: str) -> None:
    kept = {"buttons": {"0": "faster", "1": "stop", "2": "photo", "3": "mode", "4": "fly"}}
    found = run(
        step(view=view), step(None, 0, 1, 2, 3), step(None, 0, 1, 2, 3), step(), step(None, STOP),
        kept=kept,
    )["result"]  # fmt: skip
    assert [one["notes"].count("stop") for one in found] == [0, 1, 0, 0, 1]
    is_fly = view == "fly"
    assert [one["notes"].count("photo_pressed") for one in found] == [0, int(is_fly), 0, 0, 0]
    assert (found[-1]["level"], found[-1]["mode"]) == ((2, 2) if is_fly else (1, 1))


def test_of_the_press_that_shows_a_gamepad_to_the_page_only_stop_counts() -> None:
    [found] = run(step(None, 0, STOP), kept={"buttons": {"0": "faster", "1": "stop"}})["result"]
    assert (found["notes"].count("stop"), found["level"]) == (1, 1)


BROKEN: list[Any] = [
    None,
    [],
    "x",
    7,
    {"axes": 3, "buttons": {"0": "fly"}},
    {"axes": {"up": None}, "buttons": []},
    {"axes": {"up": {"axis": -1, "sign": 0, "dead": "0.3"}}, "buttons": {"1": "dance"}},
    {"axes": {"up": {"axis": 1.5, "sign": 2, "dead": 0.6}}, "buttons": {"99": "stop"}},
]


@pytest.mark.parametrize("kept", BROKEN, ids=str)
def test_whatever_was_kept_there_is_a_mapping_with_stop(kept: Any) -> None:
    found = run(kept=kept)
    assert "stop" in found["kept"]["buttons"].values()
    assert found["kept"]["axes"] == found["usual"]["axes"]
    assert found["usual"]["buttons"] == {"1": "stop", "4": "fly", "5": "fly"}
    assert found["read"] == {"turn": 0, "up": -1, "right": 0, "forward": 0}


def test_stop_cannot_be_taken_away() -> None:
    [found, pressed] = run(step(map={"buttons": {"1": "none", "4": "fly"}}), step(None, STOP))[
        "result"
    ]
    [[_, kept]] = [one for one in found["notes"] if isinstance(one, list)]
    assert kept["buttons"] == {"1": "stop", "4": "fly"}
    assert "stop" in pressed["notes"]
