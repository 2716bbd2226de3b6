"""The link in numbers."""

from __future__ import annotations

import anyio
import pytest

from m100link.apps.agent.messages import LeaseChanged, LinkCounted, State
from m100link.apps.agent.remote_error import Fault
from m100link.apps.station.console.view.catalogue import CATALOGUE
from m100link.apps.station.console.view.inputs import Inputs
from m100link.apps.station.console.view.link import LINK_ITEMS, link_of
from m100link.apps.station.console.view.words import Speaker
from m100link.errors import LinkLost
from m100link.telemetry.state import AircraftState
from m100link.wire.frame import Discard
from tests.apps.station.conftest import Rig

pytestmark = pytest.mark.anyio

SAY = Speaker()


def test_without_an_aircraft_nothing_is_counted() -> None:
    state = State(0.0, "lost", connection_fault=Fault.of(LinkLost("the cable is out")), discards=4)
    link = link_of(Inputs(state=state))
    assert SAY(link.texts["connection"]) == "lost"
    assert SAY(link.texts["discards"]) == "–"
    assert (link.causes, link.rates) == ((), ())
    assert "the cable is out" in link.reason


def test_with_one_everything_is() -> None:
    state = State(
        0.0, "connected", firmware="3.1", round_trip=0.0123, discards=4, lease_remaining=3
    )
    counted = LinkCounted(1.0, {"late_acks": 2}, {"unheard_of": 1, "frame_crc": 3}, 0.0042)
    link = link_of(
        Inputs(
            state=state,
            telemetry=AircraftState(lambda: 0.0),
            holder=LeaseChanged(1, "tab"),
            link=counted,
            front_lag=0.007,
            page_trip=0.0205,
        )
    )
    assert tuple(link.texts) == LINK_ITEMS
    shown = {"aircraft_ms": "12 ms", "page_ms": "20 ms", "agent_lag": "4 ms", "front_lag": "7 ms"}
    shown |= {"discards": "4", "late_acks": "2", "acks": "–", "clients": "tab, 3 s"}
    assert {name: SAY(link.texts[name]) for name in shown} == shown
    said = [(SAY(cause), count) for cause, count in link.causes]
    assert said == [("checksum of the frame", "3"), ("unheard_of", "1")]
    assert link.reason == ""


def test_slow_clients_are_named_the_slowest_first() -> None:
    link = link_of(Inputs(dropped=(("tab", 0), ("rosbridge 127.0.0.1:5", 12), ("a tab", 0))))
    assert link.dropped == (("rosbridge 127.0.0.1:5", "12"), ("a tab", "0"), ("tab", "0"))


def test_an_aircraft_that_does_not_answer_is_said_to() -> None:
    inputs = Inputs(state=State(0.0), telemetry=AircraftState(lambda: 0.0))
    assert SAY(link_of(inputs).texts["aircraft_ms"]) == "no answer"


def test_an_agent_that_is_not_heard_is_silent() -> None:
    inputs = Inputs(state=State(0.0, "connected"), is_silent=True)
    assert SAY(link_of(inputs).texts["connection"]) == "silent"


@pytest.mark.parametrize("name", [*LINK_ITEMS, *(f"cause.{one}" for one in Discard)])
def test_every_number_has_a_name(name: str) -> None:
    assert f"link.{name}" in CATALOGUE


async def test_the_agent_counts_and_items_arrive(rig: Rig) -> None:
    await anyio.sleep(2.5)
    counted = rig.front.link
    assert counted is not None
    assert counted.counters["frames_received"] > 100
    assert counted.loop_lag >= 0.0
    link = link_of(Inputs(state=rig.front.state, telemetry=rig.front.telemetry, link=counted))
    assert SAY(link.texts["frames_received"]).isdigit()
    rates = {SAY(one.name): one for one in link.rates}
    assert float(rates["attitude"].rate) == pytest.approx(100.0, abs=5.0)
    rig.aircraft.unplug()
    await rig.until(lambda: rig.front.link is None)
