"""Everything that the page shows at one moment.

Pure: tests read a view without a browser. Each part of it has a file of its own beside this one.
"""

from __future__ import annotations

from dataclasses import dataclass

from m100link.apps.station.console.view.actions import actions_of
from m100link.apps.station.console.view.alarms import Alarm
from m100link.apps.station.console.view.chart import Chart, chart_of
from m100link.apps.station.console.view.checklist import Checklist
from m100link.apps.station.console.view.errors import problem_text
from m100link.apps.station.console.view.events import Line
from m100link.apps.station.console.view.fleet import FleetRow, fleet_of
from m100link.apps.station.console.view.inputs import Inputs
from m100link.apps.station.console.view.instruments import Instruments, instruments_of
from m100link.apps.station.console.view.link import LinkView, link_of
from m100link.apps.station.console.view.memory import Memory
from m100link.apps.station.console.view.mission import MissionView, mission_of
from m100link.apps.station.console.view.replay import ReplayView, replay_of
from m100link.apps.station.console.view.situation import Level, Situation
from m100link.apps.station.console.view.status import StatusLine, activation_of, status_line
from m100link.apps.station.console.view.words import Text

__all__ = ["View", "view_of"]


@dataclass(frozen=True, slots=True)
class View:
    """What the page shows.

    Attributes:
        at: Time on the agent's clock, s.
        situation: What is known, as plain values.
        status: The status line.
        activation: How far activation is.
        problem: What was refused last; None for nothing.
        alarms: What is alarming, the most urgent first.
        sounding: The most urgent level that nobody has acknowledged; None for silence.
        checklist: What is right before take-off.
        instruments: Values of the telemetry, each with its age.
        chart: What stands on the map besides what moves.
        actions: Names of the buttons that can be pressed.
        mission: The mission.
        link: The link in numbers.
        events: What happened, oldest first.
        fleet: A row for each aircraft, when there are several.
        replay: Where the replay is; None for an aircraft.
    """

    at: float
    situation: Situation
    status: StatusLine
    activation: Text
    problem: Text | None
    alarms: tuple[Alarm, ...]
    sounding: Level | None
    checklist: Checklist
    instruments: Instruments
    chart: Chart
    actions: frozenset[str]
    mission: MissionView
    link: LinkView
    events: tuple[Line, ...]
    fleet: tuple[FleetRow, ...]
    replay: ReplayView | None


def view_of(inputs: Inputs, memory: Memory | None = None) -> View:
    """The view of what is known; ``memory`` is that of the page, and learns."""
    memory = memory if memory is not None else Memory()
    alarms, checklist = memory.look(inputs)
    return View(
        at=inputs.now,
        situation=memory.situation,
        status=status_line(memory.situation),
        activation=activation_of(inputs),
        problem=None if inputs.refusal is None else problem_text(inputs.refusal),
        alarms=alarms,
        sounding=memory.alarms.sounding,
        checklist=checklist,
        instruments=instruments_of(inputs),
        chart=chart_of(inputs),
        actions=actions_of(inputs, memory.situation, checklist),
        mission=mission_of(inputs),
        link=link_of(inputs),
        events=tuple(memory.diary.lines),
        fleet=fleet_of(inputs.fleet),
        replay=replay_of(inputs.state.replay),
    )
