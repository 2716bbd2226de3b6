"""What holds for a plan as a whole, and the survey that makes its points."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from enum import IntEnum
from functools import partial
from typing import Any

from nicegui import events, ui

from m100link.errors import UsageError
from m100link.missions.survey import line_spacing
from m100link.missions.waypoint import AtEnd, Heading, Trace
from m100link.station.console.parts.fields import card
from m100link.station.console.view.draft import Draft

__all__ = ["WholePart"]

X3_DEG = 81.0
"""Field of view of a Zenmuse X3 across its pictures, °: 20 mm in terms of 35 mm film, at 4 to 3."""

_CHOICES: tuple[tuple[str, str, type[IntEnum]], ...] = (
    ("at_end", "at_end", AtEnd),
    ("heading", "nose", Heading),
    ("trace", "trace", Trace),
)


class WholePart:
    """Two cards.

    Args:
        word: Says a word of the catalogue.
        change: Takes another draft.
        survey: Makes lines over the area.
    """

    def __init__(
        self,
        word: Callable[[str], str],
        change: Callable[[Draft], None],
        survey: Callable[..., None],
    ) -> None:
        self._word, self._change, self._survey = word, change, survey
        self._draft = Draft()
        self._selects: dict[str, ui.select] = {}
        self._lines: dict[str, ui.number] = {}
        self._is_showing = False  # what is set then was not chosen

    def build(self) -> None:
        """Lay it out."""
        with ui.element("div").classes("card w-full"), ui.element("div").classes("numbers"):
            self._speed = ui.number(label=self._word("speed"), min=0, max=15, step=0.5)
            self._speed.props("dense outlined debounce=300 for=plan-speed")
            self._speed.on_value_change(self._sped)
            for name, word, kind in _CHOICES:
                options = {one.value: self._word(f"{word}.{one.name.lower()}") for one in kind}
                select = ui.select(options, label=self._word(word))
                select.props(f"dense outlined for=plan-{word}")
                select.on_value_change(partial(self._selected, name, kind))
                self._selects[name] = select
        with card(self._word("survey")):
            with ui.element("div").classes("numbers"):
                for name, value, low, step in (
                    ("height", 30.0, 2, 1),
                    ("overlap", 70.0, 0, 5),
                    ("spacing", None, 1, 1),
                    ("angle", 0.0, -180, 5),
                    ("photo_every", None, 2, 1),
                ):
                    number = ui.number(label=self._word(name), value=value, min=low, step=step)
                    number.props(f"dense outlined clearable for=survey-{name}")
                    self._lines[name] = number
            button = ui.element("button").classes("act plain").props("type=button data-plan=lines")
            with button:
                ui.label(self._word("lines"))
            button.on("click", self._make_lines, args=[])

    def show(self, draft: Draft) -> None:
        """Show what holds for a draft."""
        self._draft, self._is_showing = draft, True
        if self._speed.value != draft.speed:
            self._speed.set_value(draft.speed)
        for name, select in self._selects.items():
            select.set_value(int(getattr(draft, name)))
        self._is_showing = False

    def _sped(self, event: events.ValueChangeEventArguments[Any]) -> None:
        if not self._is_showing and isinstance(event.value, int | float):
            speed = float(event.value)
            self._change(replace(self._draft, speed=speed, max_speed=max(10.0, speed)))

    def _selected(
        self, name: str, kind: type[IntEnum], event: events.ValueChangeEventArguments[Any]
    ) -> None:
        if not self._is_showing:
            # Names of three fields, each with values of its own kind.
            self._change(replace(self._draft, **{name: kind(event.value)}))  # type: ignore[arg-type]

    def _make_lines(self) -> None:
        values = {name: number.value for name, number in self._lines.items()}
        height, every = float(values["height"] or 0.0), values["photo_every"]
        spacing = values["spacing"]
        if spacing is None:  # from the overlap
            try:
                spacing = line_spacing(height, (values["overlap"] or 0.0) / 100.0, X3_DEG)
            except UsageError:
                spacing = 0.0  # which is refused with its remedy
        self._survey(
            height=height,
            spacing=float(spacing),
            angle_deg=float(values["angle"] or 0.0),
            photo_every=None if every is None else float(every),
        )
