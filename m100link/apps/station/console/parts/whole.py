"""What holds for a plan as a whole, and the survey that makes its points."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from enum import IntEnum
from functools import partial
from typing import Any

from nicegui import events, ui

from m100link.apps.station.console.parts.fields import NumberField, card, say_options
from m100link.apps.station.console.parts.wording import Wording, attribute
from m100link.apps.station.console.view.draft import Draft
from m100link.apps.station.console.view.units import Kind
from m100link.errors import UsageError
from m100link.missions.survey import line_spacing
from m100link.missions.waypoint import AtEnd, Heading, Trace

__all__ = ["WholePart"]

X3_DEG = 81.0
"""Field of view of a Zenmuse X3 across its pictures, °: 20 mm in terms of 35 mm film, at 4 to 3."""

_CHOICES: tuple[tuple[str, str, type[IntEnum]], ...] = (
    ("at_end", "at_end", AtEnd),
    ("heading", "nose", Heading),
    ("trace", "trace", Trace),
)

_LINES: tuple[tuple[str, float | None, float, float, Kind | None], ...] = (
    ("height", 30.0, 2, 1, Kind.LENGTH),
    ("overlap", 70.0, 0, 5, None),
    ("spacing", None, 1, 1, Kind.LENGTH),
    ("angle", 0.0, -180, 5, None),
    ("photo_every", None, 2, 1, Kind.LENGTH),
)
"""Of the survey: its name, what stands there at first, the least, the step of its arrows, and what
it measures."""


class WholePart:
    """Two cards.

    Args:
        wording: Says what stands there.
        change: Takes another draft.
        survey: Makes lines over the area.
    """

    def __init__(
        self,
        wording: Wording,
        change: Callable[[Draft], None],
        survey: Callable[..., None],
    ) -> None:
        self._wording, self._change, self._survey = wording, change, survey
        self._draft = Draft()
        self._selects: dict[str, ui.select] = {}
        self._lines: dict[str, NumberField] = {}
        self._is_showing = False  # what is set then was not chosen

    def build(self) -> None:
        """Lay it out."""
        wording = self._wording
        with ui.element("div").classes("card w-full"), ui.element("div").classes("numbers"):
            self._speed = NumberField(
                wording,
                "plan.speed",
                kind=Kind.SPEED,
                limits=(0, 15),
                step=0.5,
                changed=self._sped,
            )
            self._speed.element.props("dense outlined debounce=300 for=plan-speed")
            for name, word, kind in _CHOICES:
                select = ui.select([one.value for one in kind])
                say_options(
                    select, {one.value: f"plan.{word}.{one.name.lower()}" for one in kind}, wording
                )
                wording.put(attribute(select, "label"), f"plan.{word}")
                select.props(f"dense outlined for=plan-{word}")
                select.on_value_change(partial(self._selected, name, kind))
                self._selects[name] = select
        with card("plan.survey", wording):
            with ui.element("div").classes("numbers"):
                for name, value, low, step, measure in _LINES:
                    number = NumberField(
                        wording,
                        f"plan.{name}",
                        kind=measure,
                        limits=(low, None),
                        step=step,
                        value=value,
                    )
                    number.element.props(f"dense outlined clearable for=survey-{name}")
                    self._lines[name] = number
            button = ui.element("button").classes("act plain").props("type=button data-plan=lines")
            with button:
                wording.put(ui.label().set_text, "plan.lines")
            button.on("click", self._make_lines, args=[])

    def show(self, draft: Draft) -> None:
        """Show what holds for a draft."""
        self._draft, self._is_showing = draft, True
        self._speed.set(draft.speed)
        for name, select in self._selects.items():
            select.set_value(int(getattr(draft, name)))
        self._is_showing = False

    def _sped(self, speed: float | None) -> None:
        if speed is not None:
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
