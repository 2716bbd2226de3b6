"""The live view of the simulator: keys and pictures, without a terminal."""

from __future__ import annotations

import io

import pytest
from rich.console import Console

from m100link.apps.cli.sim import KEYS, LiveView, read_keys
from m100link.protocol.commands.waypoint import WaypointPauseResume
from m100link.sim import VirtualAircraft
from tests.sim.vehicle.missions.flights import begin, host, point


def shown(view: LiveView) -> str:
    console = Console(width=200, file=io.StringIO())
    with console.capture() as captured:
        console.print(view.render())
    return captured.get()


def test_arrows_and_letters_are_told_apart_in_one_read() -> None:
    assert read_keys(b"p\x1b[A\x1b[DX ") == ["p", "UP", "LEFT", "X", " "]
    assert read_keys(b"") == []


@pytest.mark.parametrize("key", KEYS)
def test_every_key_is_an_order_that_exists(key: str) -> None:
    aircraft = VirtualAircraft(seed=1)
    view = LiveView(aircraft, ["/dev/pts/9"])
    view.press(key)
    assert f"> {KEYS[key][0]}" in shown(view)


def test_a_key_does_what_it_says_and_is_shown() -> None:
    aircraft = VirtualAircraft(seed=7)
    view = LiveView(aircraft, ["/dev/pts/9"])
    view.press("p")
    text = shown(view)
    for part in ("/dev/pts/9", "seed 7", "> rc-mode P", "the mode switch is not in F"):
        assert part in text


def test_a_mission_is_shown_and_how_it_ended() -> None:
    program = host()
    view = LiveView(program.aircraft, [])
    assert "mission" not in shown(view)
    begin(program, [point(0, 0, 0, 10), point(1, 30, 0, 10)])
    program.wait(12.0)
    for part in ("waypoint: flies", "1 of 0 to 1", "waypoint 0 reached"):
        assert part in shown(view)
    program.ask(WaypointPauseResume(0))
    assert "waypoint: paused" in shown(view)
    program.aircraft.leave_f()
    program.wait(0.1)
    assert "last mission" in shown(view)
    assert "waypoint: broken off: the remote controller is not in F position" in shown(view)


def test_any_other_key_does_nothing() -> None:
    view = LiveView(VirtualAircraft(seed=1), [])
    before = shown(view)
    view.press("?")
    assert shown(view) == before
