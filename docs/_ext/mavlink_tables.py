"""What the bridge to MAVLink understands, made of its own tables.

```{mavlink-modes}        m100link.apps.mavlink.translator.vehicle_state.MODES
```{mavlink-commands}     m100link.apps.mavlink.translator.commands.COMMANDS
```{mavlink-streams}      m100link.apps.mavlink.translator.telemetry.STREAMS
```{mavlink-items}        m100link.apps.mavlink.translator.route.ITEMS
```{mavlink-parameters}   m100link.apps.mavlink.translator.parameters.PARAMETERS
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any

from tables import TableDirective

from m100link.apps.mavlink.translator.commands import COMMANDS
from m100link.apps.mavlink.translator.numbers import MavCommand
from m100link.apps.mavlink.translator.parameters import PARAMETERS
from m100link.apps.mavlink.translator.route import ITEMS, WITHOUT_EFFECT
from m100link.apps.mavlink.translator.telemetry import STREAMS
from m100link.apps.mavlink.translator.vehicle_state import MODES
from m100link.missions.qgroundcontrol import command_name

if TYPE_CHECKING:
    from sphinx.application import Sphinx


class Modes(TableDirective):
    """The flight modes."""

    def rows(self) -> Iterable[Sequence[str]]:
        """One row per mode."""
        yield "Mode", "PX4", "Standard mode", "What it is here"
        for mode, row in MODES.items():
            standard = str(row.standard) if row.standard else "–"
            yield mode.value, f"{row.main}.{row.sub}", standard, row.meaning


class Commands(TableDirective):
    """The commands."""

    def rows(self) -> Iterable[Sequence[str]]:
        """One row per command."""
        yield "Number", "Command", "What it does"
        for number, row in COMMANDS.items():
            yield str(int(number)), f"``{MavCommand(number).name}``", row.meaning


class Telemetry(TableDirective):
    """What is sent by itself, or on request."""

    def rows(self) -> Iterable[Sequence[str]]:
        """One row per message."""
        yield "Message", "Per second", "Made of"
        for name, stream in STREAMS.items():
            yield f"``{name}``", f"{stream.hz:g}" if stream.hz else "on request", stream.source


class Items(TableDirective):
    """Items of missions that are flown, and those that are left out."""

    def rows(self) -> Iterable[Sequence[str]]:
        """One row per item."""
        yield "Number", "Item", "What it is here"
        for number, row in ITEMS.items():
            yield str(int(number)), f"``{MavCommand(number).name}``", row.meaning
        named = ", ".join(map(command_name, sorted(WITHOUT_EFFECT)))
        yield "others", named, "without effect; a text names them"


class Settings(TableDirective):
    """The parameters."""

    def rows(self) -> Iterable[Sequence[str]]:
        """One row per parameter."""
        yield "Parameter", "At first", "May be set to", "What it is"
        for name, one in PARAMETERS.items():
            value = "–" if one.value is None else f"{one.value:g}"
            span = f"{one.least:g} to {one.most:g}" if one.is_settable else "read-only"
            yield f"``{name}``", value, span, one.meaning


def setup(app: Sphinx) -> dict[str, Any]:
    """Called by Sphinx."""
    app.add_directive("mavlink-modes", Modes)
    app.add_directive("mavlink-commands", Commands)
    app.add_directive("mavlink-streams", Telemetry)
    app.add_directive("mavlink-items", Items)
    app.add_directive("mavlink-parameters", Settings)
    return {"version": "1", "parallel_read_safe": True, "parallel_write_safe": True}
