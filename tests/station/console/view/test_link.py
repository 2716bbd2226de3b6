"""The link in numbers."""

from __future__ import annotations

from m100link.agent.fault import Fault
from m100link.agent.messages import LeaseChanged, State
from m100link.errors import LinkLost
from m100link.station.console.view.inputs import Inputs
from m100link.station.console.view.link import LINK_ITEMS, link_of
from m100link.telemetry.state import AircraftState


def test_without_an_aircraft_nothing_is_counted() -> None:
    state = State(0.0, "lost", connection_fault=Fault.of(LinkLost("the cable is out")), discards=4)
    link = link_of(Inputs(state=state))
    assert link.texts["connection"] == "lost"
    assert link.texts["discards"] == "–"
    assert "the cable is out" in link.reason


def test_with_one_everything_is() -> None:
    state = State(
        0.0, "connected", firmware="3.1", round_trip=0.0123, discards=4, lease_remaining=3
    )
    telemetry = AircraftState(lambda: 0.0)
    link = link_of(Inputs(state=state, telemetry=telemetry, holder=LeaseChanged(1, "tab")))
    assert set(link.texts) == {name for name, _ in LINK_ITEMS}
    assert link.texts["aircraft_ms"] == "12 ms"
    assert link.texts["discards"] == "4"
    assert link.texts["clients"] == "tab, 3 s"
    assert link.reason == ""
    assert (
        link_of(Inputs(state=State(0.0), telemetry=telemetry)).texts["aircraft_ms"] == "no answer"
    )


def test_an_agent_that_is_not_heard_is_silent() -> None:
    assert (
        link_of(Inputs(state=State(0.0, "connected"), is_silent=True)).texts["connection"]
        == "silent"
    )
