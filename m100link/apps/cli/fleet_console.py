"""``m100link fleet console``: a page in the browser for aircraft that are elsewhere."""

from __future__ import annotations

import asyncio
import os
import webbrowser
from dataclasses import dataclass, fields
from typing import Any

from cyclopts import Parameter

from m100link.apps.cli.common import Told, err, out, run_async
from m100link.apps.cli.fleet import NO_OPTIONS, FleetOptions
from m100link.apps.cli.options import options_of
from m100link.apps.cli.outcome import ExitCode, print_json
from m100link.apps.cli.serving import require_packages, warn_of
from m100link.apps.station.config import ENVIRONMENT, Settings, resolve
from m100link.apps.station.fleet_console import serving_fleet_console

__all__ = ["console"]

_FromSettings: Any = options_of(
    Settings,
    (
        *("host", "console_port", "allow_host", "allow_origin", "token_file"),
        *("tls_cert", "tls_key", "tiles"),
    ),
    environment=ENVIRONMENT,
    is_layer=True,
)


@Parameter(name="*")
@dataclass(frozen=True)
class PageOptions(_FromSettings):  # type: ignore[misc] # a class that is made has no type
    """Who may open the page, and where it is served.

    Attributes:
        open_browser: Open it in the browser.
    """

    open_browser: bool = True


def console(
    *names: str,
    options: FleetOptions = NO_OPTIONS,
    page: PageOptions = PageOptions(),
) -> int:
    """Serve the console for a fleet, until Ctrl-C: all on a list and a map, one to look at and fly.

    Without names it shows whoever is there and whoever comes. What is steered flies on board, under
    the lease and the guards of that aircraft's agent. The one that is looked at sends every
    package, the others what suffices for a wall. When this ends, control that was taken here is
    given back: that aircraft hovers.

    Args:
        names: Names of aircraft.
        options: Which fleet.
        page: See below.
    """
    known = {one.name for one in fields(Settings)}
    given = {name: value for name, value in vars(page).items() if name in known and value != ()}
    settings = resolve(given, os.environ)
    require_packages()
    return run_async(_serve(names, options, settings, is_opened=page.open_browser))


async def _serve(
    names: tuple[str, ...], options: FleetOptions, settings: Settings, *, is_opened: bool
) -> int:
    ended = Told()
    async with options.open() as fleet, serving_fleet_console(fleet, settings, names) as served:
        scheme = "http" if settings.tls_cert is None else "https"
        path = served.fronts.console_path()
        url = f"{scheme}://{settings.authority(served.console_port)}{path}"
        if options.json_output:
            print_json({"console": url, "aircraft": served.names})
        else:
            out.print(f"console:   {url}", markup=False, soft_wrap=True)
            out.print(f"aircraft:  {', '.join(served.names)}", markup=False, soft_wrap=True)
        warn_of(settings)
        if is_opened:
            await asyncio.to_thread(webbrowser.open, url)
        await ended.wait()
        err.print("ending: an aircraft that was flown from here hovers")
    return ExitCode.OK
