"""Everything that the page shows at one moment.

Pure: tests read a view without a browser. Each part of it has a file of its own beside this one.
"""

from __future__ import annotations

from dataclasses import dataclass

from m100link.agent.messages import Event
from m100link.station.console.view.actions import actions_of
from m100link.station.console.view.chart import Chart, chart_of
from m100link.station.console.view.fleet import FleetRow, fleet_of
from m100link.station.console.view.inputs import Inputs
from m100link.station.console.view.instruments import Instruments, instruments_of
from m100link.station.console.view.link import LinkView, link_of
from m100link.station.console.view.mission import MissionView, mission_of
from m100link.station.console.view.status import StatusLine, status_of

__all__ = ["View", "view_of"]


@dataclass(frozen=True, slots=True)
class View:
    """What the page shows.

    Attributes:
        at: Time on the agent's clock, s.
        status: The status line.
        instruments: Values of the telemetry, each with its age.
        chart: What stands on the map besides what moves.
        actions: Names of the buttons that can be pressed.
        mission: The mission.
        link: The link in numbers.
        events: What happened lately, oldest first.
        fleet: A row for each aircraft, when there are several.
    """

    at: float
    status: StatusLine
    instruments: Instruments
    chart: Chart
    actions: frozenset[str]
    mission: MissionView
    link: LinkView
    events: tuple[Event, ...]
    fleet: tuple[FleetRow, ...]


def view_of(inputs: Inputs) -> View:
    """The view of what is known."""
    return View(
        at=inputs.now,
        status=status_of(inputs),
        instruments=instruments_of(inputs),
        chart=chart_of(inputs),
        actions=actions_of(inputs),
        mission=mission_of(inputs),
        link=link_of(inputs),
        events=inputs.events,
        fleet=fleet_of(inputs.fleet),
    )
