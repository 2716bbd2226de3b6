"""``m100link serve`` and ``m100link console``: aircraft for many clients, and for browsers."""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Annotated, Any, Protocol

from cyclopts import Parameter

from m100link.apps.cli.common import places
from m100link.apps.cli.configuration import read_configuration
from m100link.apps.cli.options import offered, options_of
from m100link.apps.cli.serving import AS_USUAL, RunOptions, run_station
from m100link.apps.station.config import ENVIRONMENT, ONLY_NAME, Settings, namespace_of, resolve
from m100link.errors import UsageError

__all__ = ["StationOptions", "aircraft_of", "console", "serve", "settings_of"]

_ELSEWHERE = ("url", "key", "token", "console_port", "tiles", "no_record", "origins", "unused")
"""Settings that are not options of both commands, or not of the command line at all."""

_FromSettings: Any = options_of(
    Settings,
    [one.name for one in fields(Settings) if one.name not in _ELSEWHERE],
    environment=ENVIRONMENT,
    called={
        "also_ports": "--also-port",
        "baud_rate": "--baud",
        "metrics_port": "--metrics",
        "foxglove_port": "--foxglove",
        "ros2": "--ros2",
    },
    is_layer=True,
)


class SettingsOptions(Protocol):
    """Options of the command line that are one source of the settings."""

    @property
    def run(self) -> RunOptions: ...


def settings_of(options: SettingsOptions, *, launch: Path | None = None, **more: Any) -> Settings:
    """The settings from all sources.

    Args:
        options: From the command line.
        launch: ROS launch file of DJI's node.
        more: Other settings from the command line.
    """
    known = {one.name for one in fields(Settings)}
    given = {name: value for name, value in vars(options).items() if name in known}
    flags = {name: value for name, value in given.items() if value != ()}
    configuration = read_configuration()
    settings = resolve(
        flags | more,
        os.environ,
        config=options.run.config,
        launch=launch,
        of_aircraft=configuration.sources_of_station,
    )
    if settings.record is None and hasattr(options, "no_record") and not settings.no_record:
        from m100link.log.folder import default_folder  # who decodes a frame needs none

        settings = replace(settings, record=default_folder())
    return settings


def aircraft_of(
    options: SettingsOptions, words: Sequence[str], *, is_sim: bool = False, **more: Any
) -> dict[str, Settings]:
    """The settings by the name of each aircraft, those of the only one without words.

    Args:
        options: From the command line.
        words: URLs, names of the configuration file, or ``name=URL``.
        is_sim: Whether a virtual one was asked for by an option.
        more: Other settings from the command line.

    Raises:
        UsageError: Two are called alike or are the same, or something cannot be.
        BadURL: No transport leads to one.
    """
    if len(words) < 2:
        name, url = _named(words[0]) if words else ("", None)
        return {name or ONLY_NAME: _in_process(settings_of(options, url=url, **more))}
    if is_sim:
        raise UsageError(
            "aircraft and --sim were given",
            remedy="write sim:// in the row of aircraft, once for each virtual one",
        )
    named = read_configuration().aircraft
    found: dict[str, Settings] = {}
    for place, word in enumerate(words, 1):
        name, url = _named(word)
        settings = _in_process(settings_of(options, url=url, **more))
        name = name or (url if url in named else f"m100_{place}")
        _check_other(name, settings, found)
        found[name] = settings
    replays = [name for name, one in found.items() if (one.url or "").startswith("replay://")]
    if replays and len(replays) < len(found):
        raise UsageError(
            f"{', '.join(replays)} would be a recorded flight beside aircraft that fly",
            cause="whoever looks at a station must never doubt what flies",
            remedy="show recorded flights by a station of their own: m100link replay FILE",
        )
    return found


def _in_process(settings: Settings) -> Settings:
    """``sim://`` is the virtual aircraft that a station brings; for another there is a transport.

    Raises:
        BadURL: There is none, and waiting for the aircraft would not end.
    """
    if settings.url == "sim://":
        return replace(settings, url=None, sim=True)
    if settings.url is not None and not settings.url.startswith("replay://"):
        from m100link.link.transport import find_transport  # who decodes a frame needs none
        from m100link.link.url import parse_url

        find_transport(parse_url(settings.url))
    return settings


@Parameter(name="*")
@dataclass(frozen=True)
class StationOptions(_FromSettings):  # type: ignore[misc] # a class that is made has no type
    """Where the aircraft is, whose app it is, who may connect.

    Every setting may also come from the environment, a TOML file, a ROS launch file or the user's
    configuration file, in this order. To the fields of
    :class:`~m100link.apps.station.config.Settings` come:

    Attributes:
        launch: ROS launch file of DJI's node, read as it is.
        no_record: Record nothing.
        run: How the station is run and told of.
    """

    launch: Path | None = None
    no_record: Annotated[bool | None, Parameter(negative=())] = None
    run: RunOptions = AS_USUAL


def _named(word: str) -> tuple[str, str]:
    """The name in ``name=URL``, empty without one, and the rest."""
    found = re.fullmatch(r"([A-Za-z][A-Za-z0-9_-]*)=(.+)", word)
    return ("", word) if found is None else (found[1], found[2])


def _check_other(name: str, settings: Settings, found: dict[str, Settings]) -> None:
    """Refuse an aircraft that another one is taken for.

    Raises:
        UsageError: It has the name or the line of another.
    """
    for other, one in found.items():
        if namespace_of(name) == namespace_of(other):
            raise UsageError(
                f"two aircraft are called {name}", remedy="name them: first=URL second=URL"
            )
        is_same = settings.url is not None and settings.url == one.url
        if is_same and not str(settings.url).startswith("replay://"):
            raise UsageError(f"{other} and {name} are at the same place: {settings.url}")


_Url = Annotated[str, offered(places)]


def serve(*url: _Url, options: StationOptions = StationOptions()) -> int:
    """Own the serial port and share the aircraft: rosbridge v2 for any number of clients.

    Telemetry for all of them, control for one at a time. DJI's web page of 2015 and roslib programs
    work as they are: `m100link serve --sim --pages dji_keyboard_ctrl`.

    Args:
        url: Where the aircraft is, or its name (M100LINK_URL); several, or name=URL, for a station
            with several.
        options: See below.
    """
    aircraft = aircraft_of(options, url, is_sim=options.sim, launch=options.launch)
    return run_station(aircraft, options.run, with_console=False)


def console(
    *url: _Url,
    console_port: int | None = None,
    tiles: Path | None = None,
    open_browser: bool = True,
    options: StationOptions = StationOptions(),
) -> int:
    """Serve the console for browsers, beside everything that `serve` serves, and open it.

    Args:
        url: Where the aircraft is, or its name (M100LINK_URL); several, or name=URL, for a station
            with several.
        console_port: Port of the console (M100LINK_CONSOLE_PORT).
        tiles: Folder with map tiles {z}/{x}/{y}.png; without it the track is drawn on a grid.
        open_browser: Open the console in the browser.
        options: See below.
    """
    more: dict[str, Any] = {"console_port": console_port, "tiles": tiles, "launch": options.launch}
    aircraft = aircraft_of(options, url, is_sim=options.sim, **more)
    return run_station(aircraft, options.run, with_console=True, open_browser=open_browser)
