"""What the operator chooses for this page; the browser keeps it."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from enum import Enum
from typing import Any

from nicegui import ui

from m100link.apps.station.console.parts.fields import card, say_options
from m100link.apps.station.console.parts.part import Deck
from m100link.apps.station.console.parts.simpanel import SimPanel
from m100link.apps.station.console.parts.wording import attribute
from m100link.apps.station.console.view.settings import Settings, Theme
from m100link.apps.station.console.view.units import Language, LengthUnit, SpeedUnit
from m100link.apps.station.console.view.view import View
from m100link.apps.station.console.view.words import Text, for_browser

__all__ = ["SettingsPart", "apply_settings", "load_settings"]

_KEY = "m100link.settings"
_PATIENCE = 30.0  # seconds that a busy browser has to say what it kept
_CHOICES: tuple[tuple[str, type[Enum]], ...] = (
    ("language", Language),
    ("length", LengthUnit),
    ("speed", SpeedUnit),
    ("theme", Theme),
)
_NAMED = ("language", "theme")  # the others are signs of units


async def load_settings(deck: Deck) -> None:
    """Take over what the browser kept, and where its clock stands."""
    try:
        kept, ahead = await ui.run_javascript(
            f"[localStorage.getItem({json.dumps(_KEY)}), -new Date().getTimezoneOffset()]",
            timeout=_PATIENCE,
        )
    except TimeoutError:
        return  # the page has gone, or hangs: it stays as it is
    if isinstance(ahead, int) and abs(ahead) <= 14 * 60:
        deck.wording.utc_offset_min = ahead
    apply_settings(deck, Settings.from_text(kept))


def apply_settings(deck: Deck, settings: Settings) -> None:
    """Let the page look and speak as it was chosen."""
    if settings.name:
        deck.tab.name = settings.name
    deck.dark.set_value({Theme.AUTO: None, Theme.DARK: True}.get(settings.theme, False))
    told = json.dumps(for_browser(settings.speaker))
    ui.run_javascript(
        f"document.body.classList.toggle('sun', {json.dumps(settings.theme is Theme.SUN)});"
        f'import("/console/said.js").then((said) => said.choose({told}));'
    )
    deck.wording.choose(settings)


class SettingsPart:
    """Language, units, looks, sound, and who it is.

    Args:
        deck: What it stands on.
    """

    def __init__(self, deck: Deck) -> None:
        self._deck = deck

    def build(self) -> None:
        """Lay it out."""
        wording = self._deck.wording
        with card("settings.title", wording):
            name = ui.input(value=self._deck.tab.name).props("for=name outlined maxlength=64")
            name.classes("w-60")
            name.on_value_change(lambda event: self._rename(str(event.value)))
            wording.put(attribute(name, "label"), "settings.name")
            for field, kind in _CHOICES:
                self._build_choice(field, kind)
            for field in ("sound", "speech"):
                box = ui.checkbox(value=getattr(wording.settings, field)).props(f"id={field}")
                box.on_value_change(self._chooser(field, bool))
                wording.put(box.set_text, f"settings.{field}")
            with ui.element("div").classes("acts"):
                with ui.element("button").classes("act plain") as attempt:
                    label = ui.label()
                attempt.props("type=button id=try-sound").on("click", self._try_sound)
            wording.put(label.set_text, "settings.try_sound")
            for key in ("settings.english_errors", "settings.kept"):
                wording.put(ui.label().classes("note-plain").set_text, key)
        if self._deck.orders is not None:
            with card("status.virtual", wording):
                SimPanel(self._deck.orders, wording).build()

    def _build_choice(self, field: str, kind: type[Enum]) -> None:
        wording = self._deck.wording
        values = [str(one.value) for one in kind]
        chosen = getattr(wording.settings, field).value
        choice = ui.select({value: value for value in values}, value=chosen)
        choice.props(f"for={field} outlined").classes("w-60")
        choice.on_value_change(self._chooser(field, kind))
        wording.put(attribute(choice, "label"), f"settings.{field}")
        if field in _NAMED:
            say_options(choice, {one: f"settings.{field}.{one}" for one in values}, wording)

    def _rename(self, name: str) -> None:
        self._deck.tab.name = name[:64]
        self._choose(name=name[:64])

    def _chooser(self, field: str, kind: Callable[[Any], Any]) -> Callable[[Any], None]:
        return lambda event: self._choose(**{field: kind(event.value)})

    def _choose(self, **chosen: Any) -> None:
        settings = replace(self._deck.wording.settings, **chosen)
        if settings == self._deck.wording.settings:
            return
        ui.run_javascript(
            f"localStorage.setItem({json.dumps(_KEY)}, {json.dumps(settings.to_text())})"
        )
        apply_settings(self._deck, settings)

    def _try_sound(self) -> None:
        wording = self._deck.wording
        tried = {
            "text": wording(Text("settings.tried")),
            "language": wording.settings.language.value,
            "sound": wording.settings.sound,
            "speech": wording.settings.speech,
        }
        ui.run_javascript(
            f'import("/console/alarms.js").then((module) => module.attempt({json.dumps(tried)}))'
        )

    def update(self, view: View) -> None:
        """Nothing of it comes from the aircraft."""
