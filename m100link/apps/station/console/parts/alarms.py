"""Alarms in the header: colour, shape, words, and a button to say that one knows."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Any

from nicegui import ui

from m100link.apps.station.console.parts.part import Deck
from m100link.apps.station.console.parts.status import SHAPES
from m100link.apps.station.console.parts.wording import attribute
from m100link.apps.station.console.view.alarms import Alarm, AlarmName, AlarmState
from m100link.apps.station.console.view.view import View
from m100link.apps.station.console.view.words import Text, say

__all__ = ["AlarmsPart"]


@dataclass(slots=True)
class _Row:
    """One alarm on the page.

    Attributes:
        box: The whole row.
        shape: Its shape.
        text: What it says.
        button: With which it is acknowledged.
        state: What stands there now.
    """

    box: Any
    shape: Any
    text: Any
    button: Any
    state: str = ""


class AlarmsPart:
    """Always on the page. Sound and speech are made by ``static/alarms.js``.

    Args:
        deck: What it stands on.
    """

    def __init__(self, deck: Deck) -> None:
        self._deck = deck
        self._rows: dict[AlarmName, _Row] = {}
        self._spoken: dict[AlarmName, float] = {}  # what was told to be spoken, and since when

    def build(self) -> None:
        """Lay it out."""
        wording = self._deck.wording
        with ui.element("ul").props("id=alarms").classes("alarms") as alarms:
            for name in AlarmName:
                self._rows[name] = self._build_row(name)
        wording.put(attribute(alarms), "alarms.title")
        # What a screen reader says at once, whatever it is saying.
        self._loud = ui.label().classes("unseen").props("id=alarm-loud role=alert")
        with ui.element("div").classes("sound-blocked").props("id=sound-blocked hidden"):
            note = ui.label()
            with ui.element("button").props("type=button id=allow-sound").classes("see"):
                allow = ui.label()
        wording.put(note.set_text, "alarms.sound_blocked")
        wording.put(allow.set_text, "alarms.allow_sound")
        self._sound = ui.element("i").props("id=alarm-sound hidden data-level= data-say=[]")
        self._deck.load("alarms.js")

    def _build_row(self, name: AlarmName) -> _Row:
        with ui.element("li").classes("alarm").props(f"data-alarm={name.value}") as box:
            shape = ui.label().classes("shape").props("aria-hidden=true")
            text = ui.label().classes("what")
            with ui.element("button").props(f"type=button data-see={name.value}") as button:
                see = ui.label()
        button.classes("see")
        self._deck.wording.put(see.set_text, "alarms.acknowledge")
        button.on("click", lambda: self._acknowledge(name))
        box.set_visibility(False)
        return _Row(box, shape, text, button)

    def _acknowledge(self, name: AlarmName) -> None:
        text = self._deck.memory.acknowledge(name)
        if text is not None:
            # For whoever reads the station's log later; in English, as everything there.
            english = type(self._deck.wording.settings)().speaker
            self._deck.agent.note(f"{self._deck.tab.name} acknowledged: {english(text)}")

    def update(self, view: View) -> None:
        """Show what is."""
        shown = {alarm.name: alarm for alarm in view.alarms}
        for name, row in self._rows.items():
            self._show(row, shown.get(name))
        self._tell(view)

    def _show(self, row: _Row, alarm: Alarm | None) -> None:
        state = "" if alarm is None else f"{alarm.level.value} {alarm.state.value}"
        if alarm is not None:
            wording = self._deck.wording
            text = wording(_whole(alarm))
            row.text.set_text(text)
            row.shape.set_text(SHAPES[alarm.level])
            attribute(row.button)(wording(say("alarms.acknowledge_named", alarm=alarm.text)))
        if state != row.state:
            row.box.classes(remove=row.state, add=state)
            row.state = state
            row.box.set_visibility(alarm is not None)
            is_known = alarm is not None and alarm.state is AlarmState.ACKNOWLEDGED
            row.button.set_visibility(not is_known)

    def _tell(self, view: View) -> None:
        """Hand what is new to sound and speech."""
        raised = [one for one in view.alarms if one.state is AlarmState.RAISED]
        since = {one.name: one.began_at for one in raised}
        new = [one for one in raised if self._spoken.get(one.name) != one.began_at]
        self._spoken = since
        settings, wording = self._deck.wording.settings, self._deck.wording
        if new:
            said = [wording(one.text) for one in new]
            self._loud.set_text(". ".join(said))
            if settings.speech:
                spoken = {"at": view.at, "texts": said, "language": settings.language.value}
                attribute(self._sound, "data-say")(json.dumps(spoken))
        elif not raised:
            self._loud.set_text("")
        sounds = settings.sound and view.sounding is not None
        level = view.sounding.value if sounds and view.sounding is not None else ""
        attribute(self._sound, "data-level")(level)


def _whole(alarm: Alarm) -> Text:
    """What an alarm says, and whether it is over."""
    if alarm.state is AlarmState.PASSED:
        return say("alarms.passed", alarm=alarm.text)
    return alarm.text
