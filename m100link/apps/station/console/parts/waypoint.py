"""The chosen waypoint of a plan, in numbers: everything that dragging does, and more."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, Protocol

from nicegui import events, ui

from m100link.apps.station.console.parts.fields import NumberField
from m100link.apps.station.console.parts.wording import Wording, attribute
from m100link.apps.station.console.view.draft import actions_of, text_of
from m100link.apps.station.console.view.units import Kind
from m100link.errors import UsageError
from m100link.missions.waypoint import Waypoint

__all__ = ["WaypointPart"]


class ChangePoint(Protocol):
    """Changes values of the chosen waypoint."""

    def __call__(self, **values: object) -> None: ...


class WaypointPart:
    """A card for one waypoint.

    Args:
        wording: Says what stands there.
        change: Changes its values.
        move: Puts it earlier (-1) or later (1), or removes it (0).
        refuse: Told what is not an action.
    """

    def __init__(
        self,
        wording: Wording,
        change: ChangePoint,
        move: Callable[[int], None],
        refuse: Callable[[str], None],
    ) -> None:
        self._wording, self._change, self._move, self._refuse = wording, change, move, refuse
        self._numbers: dict[str, NumberField] = {}
        self._is_showing = False  # what is set then was not typed

    def build(self) -> None:
        """Lay it out."""
        with ui.element("div").classes("card w-full").props("id=waypoint") as self._card:
            self._title = ui.label().classes("title")
            with ui.element("div").classes("numbers"):
                for name, word, step, kind in (
                    ("height", "height", 1.0, Kind.LENGTH),
                    ("heading_deg", "heading", 5.0, None),
                    ("gimbal_pitch_deg", "pitch", 5.0, None),
                    ("latitude_deg", "latitude", 1e-5, None),
                    ("longitude_deg", "longitude", 1e-5, None),
                ):
                    number = NumberField(
                        self._wording,
                        f"plan.{word}",
                        kind=kind,
                        step=step,
                        changed=partial(self._typed, name),
                    )
                    number.element.props(f"dense outlined debounce=300 for=waypoint-{word}")
                    self._numbers[name] = number
            self._actions = ui.input()
            self._actions.props("dense outlined debounce=500 for=waypoint-actions")
            self._wording.put(attribute(self._actions, "label"), "plan.actions")
            self._wording.put(attribute(self._actions, "hint"), "plan.actions_hint")
            self._actions.on_value_change(self._acted)
            with ui.element("div").classes("choices"):
                for word, by in (("earlier", -1), ("later", 1), ("remove", 0)):
                    button = ui.element("button").props(f"type=button data-plan={word}")
                    with button:
                        self._wording.put(ui.label().set_text, f"plan.{word}")
                    button.on("click", partial(self._move, by), args=[])
        self._card.set_visibility(False)

    def show(self, index: int | None, point: Waypoint | None) -> None:
        """Show one, or none."""
        self._card.set_visibility(point is not None)
        if index is None or point is None:
            return
        self._is_showing = True
        self._title.set_text(str(index + 1))
        for name, number in self._numbers.items():
            number.set(getattr(point, name))
        if not self._is_same_text(point):
            self._actions.set_value(text_of(point.actions))
        self._is_showing = False

    def _is_same_text(self, point: Waypoint) -> bool:
        """Whether what stands there means these actions: nobody's typing is rewritten."""
        try:
            return actions_of(self._actions.value or "") == tuple(point.actions)
        except UsageError:
            return False

    def _typed(self, name: str, value: float | None) -> None:
        if value is not None:
            self._change(**{name: value})

    def _acted(self, event: events.ValueChangeEventArguments[Any]) -> None:
        if self._is_showing:
            return
        try:
            actions = actions_of(str(event.value or ""))
        except UsageError as error:
            self._refuse(str(error))
        else:
            self._change(actions=actions)
