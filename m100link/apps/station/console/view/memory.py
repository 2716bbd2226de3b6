"""What a page remembers from one view to the next."""

from __future__ import annotations

from m100link.apps.station.console.view.alarms import (
    Alarm,
    AlarmChange,
    AlarmDesk,
    AlarmName,
    AlarmState,
)
from m100link.apps.station.console.view.checklist import Checklist, ChecklistDesk
from m100link.apps.station.console.view.events import Diary
from m100link.apps.station.console.view.inputs import Inputs
from m100link.apps.station.console.view.situation import Level, Situation, situation_of
from m100link.apps.station.console.view.words import Text, say

__all__ = ["Memory"]

_TOLD = {
    AlarmState.RAISED: "alarms.event.raised",
    AlarmState.ACKNOWLEDGED: "alarms.event.acknowledged",
    AlarmState.PASSED: "alarms.event.passed",
    AlarmState.QUIET: "alarms.event.quiet",
}
_LEVELS = {Level.DANGER: "error", Level.WARNING: "warning"}


class Memory:
    """One page's alarms, what its operator said before take-off, and its list of events.

    Attributes:
        alarms: Whoever looks at the page has to acknowledge them.
        checklist: What the operator said about this take-off.
        diary: The station's events, and what happened to the alarms here.
        situation: What was known when it looked last.
    """

    def __init__(self) -> None:
        self.alarms = AlarmDesk()
        self.checklist = ChecklistDesk()
        self.diary = Diary()
        self.situation = Situation()
        self._ahead = 0.0  # the wall's clock of the agent's

    def look(self, inputs: Inputs) -> tuple[tuple[Alarm, ...], Checklist]:
        """Judge everything by what is known now; returns the alarms and the checklist."""
        now = self.situation = situation_of(inputs)
        self._ahead = inputs.wall - inputs.now
        self.diary.take(inputs.events, inputs.now, inputs.wall)
        self._write(self.alarms.advance(now))
        return self.alarms.shown, self.checklist.look(now)

    def acknowledge(self, name: AlarmName) -> Text | None:
        """The operator knows of an alarm; returns what that one says, None when it is quiet."""
        said = next((one.text for one in self.alarms.shown if one.name is name), None)
        self._write(self.alarms.acknowledge(name, self.situation.now))
        return said

    def _write(self, changes: list[AlarmChange]) -> None:
        for change in changes:
            is_news = change.what in (AlarmState.RAISED, AlarmState.PASSED)
            self.diary.write(
                say(_TOLD[change.what], alarm=change.text),
                change.at + self._ahead,
                _LEVELS[change.level] if is_news else "info",
            )
