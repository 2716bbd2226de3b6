"""``m100link config``: the user's configuration file, and what is in force."""

from __future__ import annotations

import os
import sys
from typing import Annotated, Any

from cyclopts import Parameter
from rich.table import Table
from rich.text import Text

from m100link.apps.cli.common import out
from m100link.apps.cli.configuration import Configuration, read_configuration, shown
from m100link.apps.cli.options import offered
from m100link.apps.cli.outcome import ExitCode, print_json
from m100link.apps.station.config import resolve

_EXAMPLE = """\
[defaults]
aircraft = "lab-m100"      # when nobody names one
app_id = 1022384           # real aircraft only: sim:// has an app of its own
key_file = "m100.key"      # beside this file; chmod 600

[aircraft.lab-m100]
url = "/dev/ttyUSB0"
baud = 921600
firmware = "3.1"
"""

_SHOWN = (
    *("url", "firmware", "baud_rate", "timeout"),
    *("app_id", "key_file", "key", "level", "app_version", "bundle_id"),
)
_CALLED = {"baud_rate": "baud"}


def _names() -> list[str]:
    return list(read_configuration().aircraft)


def config(
    aircraft: Annotated[
        str | None,
        Parameter(help="Its name or URL; without it, what M100LINK_URL or the file says"),
        offered(lambda: read_configuration().aircraft),
        offered(_names),
    ] = None,
    /,
    *,
    json: bool = False,
) -> int:
    """Show the configuration file: where it is, which aircraft it names, what is in force.

    Args:
        aircraft: Which aircraft.
        json: One JSON object instead of tables; the default in a pipe.
    """
    configuration = read_configuration()
    for name in configuration.aircraft:  # what cannot be is told now, not before a flight
        resolve({"url": name}, {}, of_aircraft=configuration.sources_of_station)
    in_force = _in_force(configuration, aircraft)
    if json or not sys.stdout.isatty():
        print_json(
            {
                "path": str(configuration.path),
                "exists": configuration.exists,
                "default": configuration.default,
                "aircraft": {name: one["url"] for name, one in configuration.aircraft.items()},
                "in_force": in_force,
            }
        )
    else:
        _print(configuration, in_force)
    return ExitCode.OK


def _in_force(configuration: Configuration, aircraft: str | None) -> dict[str, dict[str, Any]]:
    """Value and source of each setting by its name; a key is only said to be set."""
    settings = resolve({"url": aircraft}, os.environ, of_aircraft=configuration.sources)
    values = {}
    for name in _SHOWN:
        value = getattr(settings, name)
        if value is not None:
            values[_CALLED.get(name, name)] = {
                "value": "(set)" if name == "key" else value,
                "source": settings.origins.get(name, "default"),
            }
    return values


def _print(configuration: Configuration, in_force: dict[str, dict[str, Any]]) -> None:
    out.print(shown(configuration.path), style="bold", markup=False, end="")
    if not configuration.exists:
        out.print(" is not there. It could say:\n")
        out.print(_EXAMPLE, markup=False)
    else:
        out.print()
        names = Table(box=None, pad_edge=False, show_header=False)
        for name, table in configuration.aircraft.items():
            is_default = name == configuration.default
            names.add_row(name, Text(table["url"]), "[dim]by default[/]" if is_default else "")
        out.print(names)
    values = Table("in force", "", "from", box=None, pad_edge=False)
    for name, one in in_force.items():
        if one["source"] != "default":
            source = one["source"].removeprefix(f"{shown(configuration.path)} ")
            values.add_row(name, Text(str(one["value"])), Text(source, style="dim"))
    if values.rows:
        out.print(values)
