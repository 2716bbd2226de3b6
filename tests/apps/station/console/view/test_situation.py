"""What is known: fresh values as they are, old and impossible ones as unknown."""

from __future__ import annotations

from dataclasses import replace

import anyio
import pytest

from m100link.apps.agent.client import Hearing
from m100link.apps.agent.messages import Event, EventTopic, GuardLimits, LeaseChanged, State
from m100link.apps.station.console.view.situation import (
    Inputs,
    Situation,
    situation_of,
)
from m100link.errors import LossReason
from m100link.protocol.records import Device, FlightPhase, RcMode
from tests.apps.station.conftest import Rig
from tests.known import seen

pytestmark = pytest.mark.anyio


def inputs(rig: Rig) -> Inputs:
    return Inputs(vehicle=rig.front.view, events=tuple(rig.front.events))


async def test_what_telemetry_tells_of_an_aircraft_that_flies(rig: Rig) -> None:
    rig.aircraft.set_rates(control_device=10)
    await rig.airborne()
    await anyio.sleep(1.0)
    now = situation_of(inputs(rig))
    assert now.switch is RcMode.F
    assert now.device is Device.ONBOARD
    assert now.phase is FlightPhase.IN_AIR
    assert (now.gps, now.is_on_ground, now.has_authority) == (5, False, True)
    assert now.battery == pytest.approx(99, abs=1)
    assert now.height == pytest.approx(1.2, abs=0.2)
    assert now.distance == pytest.approx(0.0, abs=1.0)
    assert now.limits.max_height_m == 50.0
    assert now.telemetry_age is not None
    assert now.telemetry_age < 0.1


async def test_what_is_old_is_unknown_and_its_age_goes_on(rig: Rig) -> None:
    await rig.airborne()
    known = inputs(rig)
    assert situation_of(known).switch is RcMode.F
    rig.aircraft.line.stall()
    await anyio.sleep(5.1)
    then = seen(known.vehicle.telemetry, rig.front.now, state=known.vehicle.state)
    now = situation_of(replace(known, vehicle=then))
    assert (now.switch, now.device, now.phase, now.battery) == (None, None, None, None)
    assert (now.gps, now.height, now.place, now.distance) == (None, None, None, None)
    assert now.telemetry_age == pytest.approx(5.1, abs=0.2)
    assert now.is_on_ground is None


async def test_without_good_gps_there_is_no_place(rig: Rig) -> None:
    await rig.airborne()
    rig.aircraft.gps_health = 2
    await anyio.sleep(0.5)
    now = situation_of(inputs(rig))
    assert (now.gps, now.place, now.distance) == (2, None, None)
    assert now.height is not None


def test_without_telemetry_nothing_is_known() -> None:
    assert situation_of(Inputs(vehicle=seen(None, 5.0, state=State(at=0.0)))) == Situation(
        now=5.0, heard_at=5.0, connection="connecting"
    )


def test_an_agent_that_is_gone_or_silent_is_not_heard() -> None:
    assert (
        situation_of(Inputs(vehicle=seen(None, state=State(at=0.0), heard_at=-9.0))).hearing
        is Hearing.SILENT
    )
    assert (
        situation_of(
            Inputs(vehicle=seen(None, state=State(at=0.0), is_gone=True, heard_at=-9.0))
        ).hearing
        is Hearing.GONE
    )
    assert situation_of(Inputs(vehicle=seen(None, state=State(at=0.0)))).hearing is Hearing.HEARD


def test_what_the_tab_knows_is_handed_on() -> None:
    end = LeaseChanged(3, "Anna")
    now = situation_of(
        Inputs(
            vehicle=seen(
                None, state=State(at=0.0, mission_index=-1, limits=GuardLimits(1.0)), holder=end
            ),
            lease_end=end,
            loss=LossReason.APP,
            page_trip=0.2,
            is_virtual=True,
        )
    )
    assert (now.holder, now.lease_end, now.loss, now.page_trip) == ("Anna", end, "app", 0.2)
    assert (now.is_virtual, now.mission_index, now.limits) == (True, None, GuardLimits(1.0))


def test_the_newest_mission_that_was_broken_off_counts() -> None:
    events = (
        Event(4, 0.0, "error", "first", EventTopic.MISSION_ABORTED),
        Event(9, 0.0, "error", "second", EventTopic.MISSION_ABORTED),
        Event(12, 0.0, "info", "something else"),
    )
    now = situation_of(Inputs(vehicle=seen(None, state=State(at=0.0)), events=events))
    assert (now.aborted, now.aborted_why) == (9, "second")
