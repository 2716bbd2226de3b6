"""Names with values, cards that hold them, and numbers that are typed in the operator's units."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from nicegui import events, ui

from m100link.apps.station.console.parts.wording import Wording, attribute
from m100link.apps.station.console.view.instruments import Reading
from m100link.apps.station.console.view.units import Kind
from m100link.apps.station.console.view.words import Text

__all__ = ["NumberField", "ReadingRow", "card", "field", "say_options"]

_DIGITS = 2  # of what was converted


def card(key: str, wording: Wording) -> Any:
    """A box with a title; to be used as ``with``.

    Args:
        key: Of the title in the catalogue.
        wording: Says it in the operator's language.
    """
    box = ui.element("section").classes("card w-full")
    with box, ui.element("h2"):
        heading = ui.label()
    wording.put(heading.set_text, key)
    wording.put(attribute(box), key)
    return box


def field(name: str, key: str, wording: Wording) -> tuple[Any, Any, Any]:
    """A name and its value: the row, the value, the note below it.

    Args:
        name: Of the field.
        key: Of what stands before the value, in the catalogue.
        wording: Says it in the operator's language.
    """
    with ui.element("div").classes("field") as row:
        wording.put(ui.label().classes("name").set_text, key)
        with ui.element("div"):
            value = ui.label("–").classes("value").props(f"data-field={name}")
            note = ui.label("").classes("note")
    return row, value, note


def say_options(select: Any, keys: Mapping[Any, str], wording: Wording) -> None:
    """Let the options of a select be said in the operator's language.

    Args:
        select: The select.
        keys: Of each value, the key in the catalogue.
        wording: Says them.
    """
    wording.follow(
        lambda: select.set_options({value: wording(Text(key)) for value, key in keys.items()})
    )


class ReadingRow:
    """A row that shows a reading, struck through while it is stale.

    Args:
        name: Of the field.
        wording: Says what it is called and what it shows.
    """

    def __init__(self, name: str, wording: Wording) -> None:
        self._wording = wording
        self._row, self._value, self._note = field(name, f"instruments.{name}", wording)
        self._is_stale = False

    def show(self, reading: Reading) -> None:
        """Show it."""
        self._value.set_text(self._wording(reading.text))
        self._note.set_text("" if reading.note is None else self._wording(reading.note))
        if reading.is_stale is not self._is_stale:
            self._is_stale = reading.is_stale
            self._row.classes(add="stale") if self._is_stale else self._row.classes(remove="stale")


class NumberField:
    """A number that is typed in the operator's unit; who asks gets it in that of the protocol.

    Args:
        wording: Says what it is called, and knows the units.
        key: Of its name in the catalogue, with ``{unit}`` in it where there is a kind.
        kind: What it measures; None where nobody chooses the unit.
        limits: Least and greatest value that is offered, in the unit of the protocol.
        step: Of its arrows, in the operator's unit.
        value: At the beginning, in the unit of the protocol.
        changed: Called with each value that somebody typed; None for none.

    Attributes:
        element: The number on the page, in the operator's unit.
        kind: As given.
    """

    def __init__(
        self,
        wording: Wording,
        key: str,
        *,
        kind: Kind | None = None,
        limits: tuple[float | None, float | None] = (None, None),
        step: float = 1.0,
        value: float | None = None,
        changed: Callable[[float | None], None] | None = None,
    ) -> None:
        self._wording, self.kind, self._limits = wording, kind, limits
        self._value, self._changed = value, changed
        self._is_showing = False  # what is set then was not typed
        self.element = ui.number(step=step)
        self.element.on_value_change(self._typed)
        unit = {} if kind is None else {"unit": kind}
        wording.put(attribute(self.element, "label"), key, **unit)
        wording.follow(self._show)

    @property
    def value(self) -> float | None:
        """What stands there, in the unit of the protocol; None for nothing."""
        return self._value

    @property
    def shown_limits(self) -> tuple[float | None, float | None]:
        """The limits in the operator's unit."""
        low, high = self._limits
        return self._to_shown(low), self._to_shown(high)

    def set(self, value: float | None) -> None:
        """Let another value stand there, in the unit of the protocol."""
        if value != self._value:
            self._value = value
            self._show()

    def _to_shown(self, value: float | None) -> float | None:
        if value is None or self.kind is None:
            return value
        return round(self._wording.settings.units.convert(value, self.kind), _DIGITS)

    def _show(self) -> None:
        self._is_showing = True
        low, high = self.shown_limits
        if low is not None:
            self.element.min = low
        if high is not None:
            self.element.max = high
        self.element.set_value(self._to_shown(self._value))
        self._is_showing = False

    def _typed(self, event: events.ValueChangeEventArguments[Any]) -> None:
        if self._is_showing:
            return
        value = event.value if isinstance(event.value, int | float) else None
        if value is not None and self.kind is not None:
            value = self._wording.settings.units.to_si(value, self.kind)
        self._value = value
        if self._changed is not None:
            self._changed(value)
