"""Names with values, and cards that hold them."""

from __future__ import annotations

from typing import Any

from nicegui import ui

from m100link.station.console.parts.wording import Wording, attribute
from m100link.station.console.view.instruments import Reading

__all__ = ["ReadingRow", "card", "field"]


def card(title: str, wording: Wording | None = None) -> Any:
    """A box with a title; to be used as ``with``.

    Args:
        title: The title, or its key where there is a wording.
        wording: Says it in the operator's language.
    """
    box = ui.element("section").classes("card w-full")
    with box, ui.element("h2"):
        heading = ui.label()
    if wording is None:
        heading.set_text(title)
        attribute(box)(title)
    else:
        wording.put(heading.set_text, title)
        wording.put(attribute(box), title)
    return box


def field(name: str, label: str) -> tuple[Any, Any, Any]:
    """A name and its value: the row, the value, the note below it."""
    with ui.element("div").classes("field") as row:
        ui.label(label).classes("name")
        with ui.element("div"):
            value = ui.label("–").classes("value").props(f"data-field={name}")
            note = ui.label("").classes("note")
    return row, value, note


class ReadingRow:
    """A row that shows a reading, struck through while it is stale.

    Args:
        name: Of the field.
        label: What stands before the value.
    """

    def __init__(self, name: str, label: str) -> None:
        self._row, self._value, self._note = field(name, label)
        self._is_stale = False

    def show(self, reading: Reading) -> None:
        """Show it."""
        self._value.set_text(reading.text)
        self._note.set_text(reading.note)
        if reading.is_stale is not self._is_stale:
            self._is_stale = reading.is_stale
            self._row.classes(add="stale") if self._is_stale else self._row.classes(remove="stale")
