"""The list of aircraft: one line each, and nothing that is old."""

from __future__ import annotations

from dataclasses import replace

import anyio
import pytest

from m100link.apps.agent.messages import LeaseChanged, State
from m100link.apps.station.console.view.fleet import fleet_of
from m100link.apps.station.console.view.inputs import Ship
from m100link.apps.station.console.view.units import Language
from m100link.apps.station.console.view.words import Speaker
from m100link.telemetry.state import AircraftState
from tests.apps.station.conftest import Rig

pytestmark = pytest.mark.anyio

CONNECTED = State(0.0, "connected", has_authority=True)
BASE = Ship(
    "kite", CONNECTED, LeaseChanged(0, ""), None, is_heard=True, is_shown=True, is_ours=False
)
OTHER = replace(BASE, name="crow", is_shown=False)


@pytest.fixture
async def telemetry(rig: Rig) -> AircraftState:
    await anyio.sleep(1.5)  # the battery is told once a second
    assert rig.front.telemetry is not None
    return rig.front.telemetry


def test_of_one_aircraft_there_is_no_list() -> None:
    assert fleet_of([BASE]) == ()


@pytest.mark.parametrize(
    ("ship", "kind", "said"),
    [
        (BASE, "free", "the pilot flies"),
        (replace(BASE, holder=LeaseChanged(3, "tower")), "theirs", "tower has it"),
        (replace(BASE, holder=LeaseChanged(3, "me"), is_ours=True), "mine", "you have it"),
        (
            replace(BASE, is_ours=True, state=replace(CONNECTED, has_authority=False)),
            "mine",
            "obeys the pilot",
        ),
        (replace(BASE, is_heard=False, is_ours=True), "lost", "not heard"),
        (replace(BASE, state=State(0.0, "lost"), is_ours=True), "lost", "not connected"),
    ],
)
def test_who_has_it_is_said_in_words_and_by_a_kind(ship: Ship, kind: str, said: str) -> None:
    row, other = fleet_of([ship, OTHER])
    assert (row.kind, Speaker()(row.control)) == (kind, said)
    assert Speaker(Language.GERMAN)(row.control)
    assert (row.is_shown, other.is_shown) == (True, False)


async def test_nobody_flies_what_stands_on_the_ground(telemetry: AircraftState) -> None:
    row, _ = fleet_of([replace(BASE, telemetry=telemetry), OTHER])
    assert (row.kind, Speaker()(row.control)) == ("free", "nobody has it")


async def test_values_are_shown_while_they_are_new(telemetry: AircraftState) -> None:
    ship = replace(BASE, telemetry=telemetry)
    flying = replace(ship, state=replace(CONNECTED, mission="waypoint"))
    rows = fleet_of([ship, flying, replace(ship, is_heard=False)])
    said = [(Speaker()(row.flies), Speaker()(row.battery)) for row in rows]
    assert said[0][0].endswith(" m")
    assert said[0][1].endswith(" %")
    assert said[1][0] == f"{said[0][0]}, waypoint"
    assert said[2] == ("–", "–")
