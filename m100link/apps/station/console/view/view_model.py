"""Everything that the page shows at one moment.

Pure: tests read a view without a browser. Each part of it has a file of its own beside this one.
"""

from __future__ import annotations

from dataclasses import dataclass

from m100link.apps.station.console.view import fly, header
from m100link.apps.station.console.view.alarms import (
    ActiveAlarm,
    AlarmManager,
    AlarmName,
    AlarmState,
    recorded_alarms,
)
from m100link.apps.station.console.view.data import Diary, EventLine, LinkView, link_of
from m100link.apps.station.console.view.map import Chart, chart_of
from m100link.apps.station.console.view.situation import (
    AlarmLevel,
    Inputs,
    RecordedFlight,
    Situation,
    situation_of,
)
from m100link.apps.station.console.view.texts import Text, problem_text, tr


@dataclass(frozen=True, slots=True)
class ViewModel:
    at: float  # time on the agent's clock, s
    situation: Situation  # what is known, as plain values
    status: header.StatusLine  # the status line
    problem: Text | None  # what was refused last; None for nothing
    alarms: tuple[ActiveAlarm, ...]  # what is alarming, the most urgent first
    sounding: (
        AlarmLevel | None
    )  # the most urgent level that nobody has acknowledged; None for silence
    checklist: fly.Checklist  # what is right before take-off
    instruments: fly.Instruments  # values of the telemetry, each with its age
    chart: Chart  # what stands on the map besides what moves
    actions: frozenset[str]  # names of the buttons that can be pressed
    mission: header.MissionView
    link: LinkView  # the link in numbers
    events: tuple[EventLine, ...]  # what happened, oldest first
    fleet: tuple[header.FleetRow, ...]  # a row for each aircraft, when there are several
    replay: header.ReplayView | None  # where the replay is; None for an aircraft
    flight: RecordedFlight | None  # what its file says, once it was read


def view_of(inputs: Inputs, memory: Memory | None = None) -> ViewModel:
    """The view of what is known; ``memory`` is that of the page, and learns."""
    memory = memory if memory is not None else Memory()
    alarms, checklist = memory.look(inputs)
    return ViewModel(
        at=inputs.vehicle.now,
        situation=memory.situation,
        status=header.status_line(memory.situation),
        problem=None if inputs.refusal is None else problem_text(inputs.refusal),
        alarms=alarms,
        # Nobody has to be warned of the past.
        sounding=None if memory.situation.is_replay else memory.alarms.sounding,
        checklist=checklist,
        instruments=fly.instruments_of(inputs),
        chart=chart_of(inputs),
        actions=fly.actions_of(inputs, memory.situation, checklist),
        mission=header.mission_of(inputs),
        link=link_of(inputs),
        events=tuple(memory.diary.lines),
        fleet=header.fleet_of(inputs.fleet),
        replay=header.replay_of(inputs.vehicle.state.replay, inputs.flight, inputs.flight_fault),
        flight=inputs.flight,
    )


# -- what a page remembers from one view to the next -----------------------------------------------

_REPORTED = {
    AlarmState.RAISED: "alarms.event.raised",
    AlarmState.ACKNOWLEDGED: "alarms.event.acknowledged",
    AlarmState.PASSED: "alarms.event.passed",
    AlarmState.QUIET: "alarms.event.quiet",
}
_LEVELS = {AlarmLevel.DANGER: "error", AlarmLevel.WARNING: "warning"}


class Memory:
    """One page's alarms, what its operator said before take-off, and its list of events."""

    def __init__(self) -> None:
        self.alarms = AlarmManager()  # the operator of the page acknowledges them
        self.checklist = fly.ChecklistModel()  # what the operator said about this take-off
        self.diary = Diary()  # the station's events, and what happened to the alarms here
        self.situation = Situation()  # what was known when it looked last
        self.compared = ""  # of a replay: the aircraft whose flight is laid over it
        self._ahead = 0.0  # the wall's clock of the agent's

    def look(self, inputs: Inputs) -> tuple[tuple[ActiveAlarm, ...], fly.Checklist]:
        """Judge everything by what is known now; returns the alarms and the checklist."""
        now = self.situation = situation_of(inputs)
        if now.is_replay:  # all of it is in the file
            if inputs.flight is None:
                return (), self.checklist.look(now)
            self.diary.take_story(inputs.flight.story)
            return recorded_alarms(inputs.flight, now), self.checklist.look(now)
        self._ahead = inputs.wall - inputs.vehicle.now
        self.diary.take(inputs.events, inputs.vehicle.now, inputs.wall)
        self._write(self.alarms.advance(now))
        return self.alarms.shown, self.checklist.look(now)

    def acknowledge(self, name: AlarmName) -> Text | None:
        """The operator knows of an alarm; returns what that one says, None when it is quiet."""
        said = next((one.text for one in self.alarms.shown if one.name is name), None)
        self._write(self.alarms.acknowledge(name, self.situation.now))
        return said

    def _write(self, changes: list[ActiveAlarm]) -> None:
        for change in changes:
            is_news = change.state in (AlarmState.RAISED, AlarmState.PASSED)
            self.diary.write(
                tr(_REPORTED[change.state], alarm=change.text),
                change.at + self._ahead,
                _LEVELS[change.level] if is_news else "info",
            )
