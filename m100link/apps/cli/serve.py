"""Stations as commands: their options, how they run, what they print."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import os
import re
import sys
import webbrowser
from collections.abc import AsyncIterator, Callable, Sequence
from dataclasses import dataclass, fields, replace
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, Protocol

from cyclopts import Parameter

from m100link.apps.cli.common import ended_by_signal, err, layer_of_settings, out, places
from m100link.apps.cli.configuration import read_configuration
from m100link.apps.cli.options import On, offered
from m100link.apps.cli.terminal import (
    AS_IT_IS,
    ExitCode,
    LogOptions,
    as_json,
    panel,
    print_json,
    tell,
)
from m100link.apps.station.config import ONLY_NAME, Settings, namespace_of, resolve
from m100link.apps.station.log_output import FlightProgress, log_of, tell_elsewhere
from m100link.errors import UsageError
from m100link.errors.usage import of_extra

if TYPE_CHECKING:
    from m100link.apps.agent.messages import Event
    from m100link.apps.station.listeners import Sockets
    from m100link.apps.station.supervisor import ChildProcess


_logger = logging.getLogger(__name__)

MOST_UNWRITTEN = 200

_AT_ONCE, _MOMENT_S = ("sim:", "replay:"), 2.0


_RARE = Parameter(group=panel("Rarely needed"))


@Parameter(name="*", group=panel("Start and output"))
@dataclass(frozen=True)
class RunOptions:
    """How a station runs, and how it reports.

    Attributes:
        show_config: Print each setting with its source, and end.
        single_process: Let one process both fly and serve clients: for debugging, not for flight.
    """

    show_config: bool = False
    single_process: Annotated[bool, _RARE] = False
    log: LogOptions = AS_IT_IS


AS_USUAL = RunOptions()


async def run_station(
    aircraft: dict[str, Settings],
    options: RunOptions,
    *,
    with_console: bool = False,
    with_rosbridge: bool = True,
    open_browser: bool = False,
) -> int:
    """Run a station until a signal ends it. Raises UsageError: a setting is missing or wrong."""
    if options.show_config:
        for name, settings in aircraft.items():
            show(settings, name)
        return ExitCode.OK
    if with_rosbridge or with_console:
        require_packages()
    served = {"with_console": with_console, "with_rosbridge": with_rosbridge}
    from m100link.apps.station.supervisor import leave_what_stays

    ended = ended_by_signal()
    log_of(next(iter(aircraft)) if len(aircraft) == 1 else "")
    with FlightProgress("talk", MOST_UNWRITTEN) as teller:
        tell = partial(tell_event, teller, options.log, is_named=len(aircraft) > 1)
        async with _running(aircraft, options, served, tell) as (station, front):
            announce = partial(_announce, aircraft, station)
            await _are_there(aircraft, station)
            announce()
            leave_what_stays()
            settings = next(iter(aircraft.values()))
            warn_of(settings)
            if front is not None:
                # The code in the console's address works once; a front that is new has another.
                front.on_restart.append(lambda: teller.do(announce))
            if station.sockets.ports("console") and open_browser:
                await asyncio.to_thread(webbrowser.open, _console_url(settings, station))
            await ended.wait()
            end = "ending: control authority goes back; a flying aircraft hovers"
            text = end if station.has_authority else "ending"
            teller.do(lambda: err.print(text))
    return ExitCode.OK


def require_packages() -> None:
    """Look for the packages that serve pages. Raises UsageError: one is missing."""
    for package in ("cbor2", "starlette", "uvicorn", "websockets"):
        if find_spec(package) is None:  # the process of the fronts loads them
            of_extra(package, "the ground station", "station")


def show(settings: Settings, aircraft: str) -> None:
    """Print the settings of an aircraft, and where each came from."""
    if aircraft != ONLY_NAME and not as_json():
        out.print(f"[{aircraft}]")
    for name in settings.__dataclass_fields__:
        if name in ("origins", "unused"):
            continue
        value = getattr(settings, name)
        shown = "(set)" if name in ("key", "token") and value else value
        source = settings.origins.get(name, "default")
        facts = {"aircraft": aircraft, "setting": name, "value": shown, "source": source}
        tell(facts, f"{name:14} {shown!s:40} {source}")
    _tell_unused(settings)


@contextlib.asynccontextmanager
async def _running(
    aircraft: dict[str, Settings],
    options: RunOptions,
    served: dict[str, Any],
    tell: Callable[[str, Event], None],
) -> AsyncIterator[tuple[_Station, ChildProcess | None]]:
    from m100link.apps.station.supervisor import beginning_fronts

    if options.single_process and len(aircraft) > 1:
        raise UsageError("one process has one aircraft", remedy="leave out --single-process")
    async with contextlib.AsyncExitStack() as stack:
        enter = stack.enter_async_context
        is_apart = len(aircraft) > 1 or not (options.single_process or sys.platform == "win32")
        if is_apart:
            shown = _recordings(aircraft) if served["with_console"] else ()
            begun = await enter(beginning_fronts(aircraft, **served, recordings=shown))
        # Loaded while the other process loads the fronts.
        from m100link.apps.agent.messages import JOURNAL_LOG
        from m100link.apps.station.run import running, running_apart, running_several

        tell_elsewhere(JOURNAL_LOG)
        if len(aircraft) > 1:
            several = await enter(running_several(aircraft, begun, tell=tell))
            yield several, several.front
            return
        ((name, settings),) = aircraft.items()
        if sys.platform == "win32" and not (settings.is_virtual or settings.is_replay):
            err.print(
                "warning: on Windows one process both flies and serves clients", style="yellow"
            )
        run: Any = running_apart(settings, begun) if is_apart else running(settings, **served)
        one = await enter(run)
        for event in one.agent.journal.events:
            tell(name, event)
        one.agent.journal.on_event.append(partial(tell, name))
        yield one, getattr(one, "front", None)


def _recordings(aircraft: dict[str, Settings]) -> list[tuple[str, str]]:
    """The file of each recorded flight, and the firmware that is forced on it, or empty."""
    from m100link.link.url import parse_replay

    replays = [(one.url, one.firmware or "") for one in aircraft.values() if one.is_replay]
    return [(str(parse_replay(url or "").path.absolute()), firmware) for url, firmware in replays]


async def _are_there(aircraft: dict[str, Settings], station: Any) -> None:
    """Wait for virtual aircraft and recordings: a program flies as soon as it reads the address."""
    if not all(one.sim or str(one.url).startswith(_AT_ONCE) for one in aircraft.values()):
        return
    agents = getattr(station, "agents", {})

    def are_there() -> bool:
        if agents:
            return all(one.is_connected for one in agents.values())
        return station.agent.connection.aircraft is not None

    with contextlib.suppress(TimeoutError):
        async with asyncio.timeout(_MOMENT_S):
            while not are_there():  # noqa: ASYNC110 - agents of two kinds, and neither has an event
                await asyncio.sleep(0.01)


def tell_event(
    teller: FlightProgress, log: LogOptions, name: str, event: Event, *, is_named: bool = True
) -> None:
    """Report an event of an aircraft: in the log, if that is JSON, else in words."""
    if log.log_json:
        level = logging.getLevelNamesMapping()[event.level.upper()]
        _logger.log(level, "%s", event.text, extra={"aircraft": name})
        return
    style = {"warning": "yellow", "error": "red"}.get(event.level)
    text = f"{name}: {event.text}" if is_named else event.text
    teller.do(lambda: err.print(text, style=style, soft_wrap=True))


class _Station(Protocol):
    @property
    def has_authority(self) -> bool: ...
    @property
    def sockets(self) -> Sockets: ...
    def console_path(self) -> str: ...


def _console_url(settings: Settings, running: _Station) -> str:
    (url,) = _urls(settings, running.sockets, "console")
    return url + running.console_path()


def _urls(settings: Settings, sockets: Sockets, name: str) -> list[str]:
    from m100link.apps.station.listeners import FRONTS

    front = FRONTS[name]
    is_secure = settings.tls_cert is not None and front.scheme != "tcp"
    scheme = front.scheme + ("s" if is_secure else "")
    return [f"{scheme}://{settings.authority(n)}{front.path}" for n in sockets.ports(name)]


def _announce(aircraft: dict[str, Settings], running: _Station) -> None:
    settings, sockets = next(iter(aircraft.values())), running.sockets
    served = {name: _urls(settings, sockets, name) for name in sockets.of}
    served |= {"mavlink": sockets.datagram_urls("mavlink")}
    served |= {"ros2": _nodes(aircraft)} if settings.ros2 else {}
    served |= {"console": [_console_url(settings, running)]} if "console" in served else {}
    if as_json():
        facts: dict[str, Any] = {"console": None} if "rosbridge" in served else {}
        for name, urls in served.items():
            if urls:
                facts[name] = urls[0] if name in ("console", "metrics", "foxglove") else urls
        facts["sim"] = settings.is_virtual
        print_json(facts | ({"aircraft": list(aircraft)} if len(aircraft) > 1 else {}))
        return
    for name, urls in served.items():
        if urls:
            out.print(f"{name + ':':10} {', '.join(urls)}", soft_wrap=True)


def _nodes(aircraft: dict[str, Settings]) -> list[str]:
    from m100link.apps.ros2.graph import NodeName
    from m100link.apps.station.ros2 import nodes_of

    names = nodes_of(next(iter(aircraft.values())), list(aircraft)).values()
    return [NodeName(0, "", one.namespace, one.node).full for one in names]


def _tell_unused(settings: Settings) -> None:
    if settings.unused:
        unused = ", ".join(settings.unused)
        text = f"warning: the launch file has parameters that nothing reads: {unused}"
        err.print(text, style="yellow")


def warn_of(settings: Settings) -> None:
    """Warn of dangerous settings."""
    _tell_unused(settings)
    if settings.is_plain_beyond_loopback():
        err.print(
            "warning: without TLS everybody on this network can read the token and "
            "fly the aircraft: give --tls-cert and --tls-key, unless you trust the network",
            style="yellow",
        )
    if "null" in settings.allow_origin:
        err.print(
            "warning: --allow-origin null admits pages opened from files, and "
            "sandboxed frames of any web page",
            style="yellow",
        )


# -- ``m100link serve`` and ``m100link console``: aircraft for many clients, and for browsers ------


_ELSEWHERE = ("url", "key", "token", "console_port", "tiles", "video", "origins", "unused")
"""Settings that are not options of both commands, or not of the command line at all."""

_OPTIONS = [one.name for one in fields(Settings) if one.name not in _ELSEWHERE]
_FromSettings: Any = layer_of_settings(_OPTIONS)


def settings_of(
    options: Any,  # one source of the settings, with ``run``
    *,
    launch: Path | None = None,  # a ROS launch file of DJI's node
    page: PageOptions | None = None,
    **more: Any,
) -> Settings:
    """The settings from all sources. Raises UsageError: a setting is wrong, or one of 0.2."""
    if os.environ.get("M100LINK_CONFIG"):  # a script of 0.2 would serve by other settings
        remedy = "move its settings to [station] of the file that `m100link config` shows; unset it"
        raise UsageError("M100LINK_CONFIG names a file that 1.0 does not read", remedy=remedy)
    known = Settings.__dataclass_fields__
    asked = vars(options) | ({} if page is None else vars(page))
    flags = {name: value for name, value in asked.items() if name in known and value != ()}
    configuration = read_configuration()
    settings = resolve(
        flags | more, os.environ, launch=launch, of_aircraft=configuration.sources_of_station
    )
    if settings.record is None and hasattr(options, "no_record") and not settings.no_record:
        from m100link.log.folder import default_folder  # decoding a frame needs none

        settings = replace(settings, record=default_folder())
    return settings


def aircraft_of(
    options: Any, words: Sequence[str], *, is_sim: bool = False, **more: Any
) -> dict[str, Settings]:
    """The settings of each aircraft by its name. Raises UsageError, BadURL."""
    if len(words) < 2:
        name, url = _named(words[0]) if words else ("", None)
        return {name or ONLY_NAME: _in_process(settings_of(options, url=url, **more))}
    if is_sim:
        raise UsageError(
            "aircraft and --sim were given",
            remedy="name sim:// among the aircraft, once for each virtual one",
        )
    named = read_configuration().aircraft
    found: dict[str, Settings] = {}
    for place, word in enumerate(words, 1):
        name, url = _named(word)
        settings = _in_process(settings_of(options, url=url, **more))
        name = name or (url if url in named else f"m100_{place}")
        _check_other(name, settings, found)
        found[name] = settings
    replays = [name for name, one in found.items() if one.is_replay]
    if replays and len(replays) < len(found):
        raise UsageError(
            f"{', '.join(replays)} would be a recorded flight beside aircraft that fly",
            cause="a station that shows both would leave doubt about what flies",
            remedy="replay recorded flights apart: m100link replay FILE",
        )
    return found


def _in_process(settings: Settings) -> Settings:
    """Turn ``sim://`` into an aircraft of the station. Raises BadURL: it has no transport."""
    if settings.url == "sim://":
        return replace(settings, url=None, sim=True)
    if settings.url is not None and not settings.is_replay:
        from m100link.link.transport import find_transport  # decoding a frame needs none
        from m100link.link.url import parse_url

        find_transport(parse_url(settings.url))
    return settings


@Parameter(name="*")
@dataclass(frozen=True)
class StationOptions(_FromSettings):  # type: ignore[misc] # a class that is made has no type
    """Where the aircraft is, whose app it is, who may connect.

    Settings also come from environment, ROS launch file and configuration file, in this order.

    Attributes:
        launch: ROS launch file of DJI's node, read as it is.
    """

    launch: Annotated[Path | None, Parameter(group=panel("Start and output"))] = None
    run: RunOptions = AS_USUAL


@Parameter(name="*")
@dataclass(frozen=True)
class PageOptions(layer_of_settings(("console_port", "tiles", "video"))):  # type: ignore[misc] # a class that is made
    """Where the console is served, and whether a browser shows it at once.

    Attributes:
        open_browser: Open the console in the browser.
    """

    open_browser: Annotated[On, Parameter(group=panel("Console"))] = True


AS_CONFIGURED = StationOptions()
IN_BROWSER = PageOptions()


def _named(word: str) -> tuple[str, str]:
    """The name in ``name=URL``, empty without one, and the rest."""
    found = re.fullmatch(r"([A-Za-z][A-Za-z0-9_-]*)=(.+)", word)
    return ("", word) if found is None else (found[1], found[2])


def _check_other(name: str, settings: Settings, found: dict[str, Settings]) -> None:
    """Raise UsageError, if an aircraft has the name or the line of another."""
    for other, one in found.items():
        if namespace_of(name) == namespace_of(other):
            raise UsageError(
                f"two aircraft are called {name}", remedy="name them: first=URL second=URL"
            )
        is_same = settings.url is not None and settings.url == one.url
        if is_same and not settings.is_replay:
            raise UsageError(
                f"{other} and {name} are at the same place: {settings.url}",
                remedy="give each aircraft a line of its own",
            )


Urls = Annotated[
    str,
    Parameter(help="Where the aircraft is: a URL, a port, a name, or NAME=URL; one or several."),
    offered(places),
]


async def serve(*url: Urls, options: StationOptions = AS_CONFIGURED) -> int:
    """Share the aircraft with any number of clients by rosbridge v2.

    All clients get telemetry; one at a time has control. DJI's web page of 2015 and roslib programs
    work as they are: `m100link serve --sim --pages dji_keyboard_ctrl`.
    """
    aircraft = aircraft_of(options, url, is_sim=options.sim, launch=options.launch)
    return await run_station(aircraft, options.run, with_console=False)


async def console(
    *url: Urls, options: StationOptions = AS_CONFIGURED, page: PageOptions = IN_BROWSER
) -> int:
    """Open the console in the browser, and serve all that `serve` does."""
    aircraft = aircraft_of(options, url, page=page, is_sim=options.sim, launch=options.launch)
    return await run_station(
        aircraft, options.run, with_console=True, open_browser=page.open_browser
    )


# -- ``m100link mavlink``: aircraft as vehicles for MAVSDK, QGroundControl and others --------------


USUAL = ("udp://127.0.0.1:14550", "udp://127.0.0.1:14540")
"""Where ground stations and programs listen for a vehicle, as PX4's simulator knows them."""

OF_THE_AIRCRAFT = (
    *("baud_rate", "firmware", "timeout", "acceleration"),
    *("app_id", "key", "key_file", "level"),
    *("app_version", "bundle_id", "max_height", "max_radius"),
    *("record", "no_record", "record_keep", "record_keep_mb"),
)
"""Settings of each station without a page: who may fly how far, and where it is recorded."""


@Parameter(name="*")
@dataclass(frozen=True)
class MavlinkOptions(
    layer_of_settings(  # type: ignore[misc] # a class that is made
        (*OF_THE_AIRCRAFT, "mavlink", "mavlink_to", "sysid", "autopilot", "signing_key_file"),
        {"mavlink": "--listen", "mavlink_to": "--to"},
    )
):
    """Where the aircraft is, who may fly it and how far, and where its flights are recorded."""

    run: RunOptions = AS_USUAL


async def mavlink(*url: Urls, options: MavlinkOptions = MavlinkOptions()) -> int:
    """Let MAVSDK, QGroundControl and other MAVLink programs fly.

    They see each aircraft as a vehicle with PX4's modes, until Ctrl-C. Without --listen and --to
    m100link sends to UDP ports 14550 and 14540 of this machine, where such programs listen.
    """
    aircraft = aircraft_of(options, url)
    first = next(iter(aircraft.values()))
    if not first.mavlink and not first.mavlink_to:
        aircraft = aircraft_of(options, url, mavlink_to=USUAL)
    return await run_station(aircraft, options.run, with_rosbridge=False)


# -- ``m100link ros2``: aircraft as nodes of ROS 2, for RViz, Nav2, rosbag2 and every program ------


_OF_THE_NODE = ("rmw", "namespace", "node", "domain", "remap", "dji_names")


@Parameter(name="*")
@dataclass(frozen=True)
class Ros2Options(
    layer_of_settings(  # type: ignore[misc] # a class that is made
        (*OF_THE_AIRCRAFT, *(f"ros2_{name}" for name in _OF_THE_NODE)),
        {f"ros2_{name}": f"--{name.replace('_', '-')}" for name in _OF_THE_NODE},
    )
):
    """Where the aircraft is, its names in the graph, and where its flights are recorded."""

    run: RunOptions = AS_USUAL


async def ros2(*url: Urls, options: Ros2Options = Ros2Options()) -> int:
    """Run a ROS 2 node, without a ROS installation, until Ctrl-C.

    Programs with RMW_IMPLEMENTATION=rmw_zenoh_cpp see and fly the aircraft, by the router at
    localhost:7447 or that of ZENOH_SESSION_CONFIG_URI and ZENOH_CONFIG_OVERRIDE. Every program that
    reaches this router can fly. With --rmw dds, which needs rclpy, programs on Fast DDS or Cyclone
    do, and everybody in that network can fly.
    """
    return await run_station(
        aircraft_of(options, url, ros2=True), options.run, with_rosbridge=False
    )


# -- ``m100link replay``: recorded flights in the console, as they were ----------------------------


_OF_A_REPLAY = [n for n in _OPTIONS if n == "firmware" or n not in ("sim", *OF_THE_AIRCRAFT)]


@Parameter(name="*")
@dataclass(frozen=True)
class ReplayOptions(layer_of_settings(_OF_A_REPLAY)):  # type: ignore[misc] # a class that is made
    """Ports and access of a station in which nothing flies."""

    run: RunOptions = AS_USUAL


async def replay(
    *file: Path,
    speed: Annotated[float | Literal["max"], Parameter()] = 1.0,
    from_: Annotated[float, Parameter(name="--from")] = 0.0,
    until: float | None = None,
    options: ReplayOptions = ReplayOptions(),
    page: PageOptions = IN_BROWSER,
) -> int:
    """Replay flights in the console: pause, seek, change the speed.

    Nothing flies: the page says REPLAY and gives no control. Two files are two aircraft of one
    station, each with its own page. rosbridge serves them only with --port, --also-port, --pages or
    --metrics.

    Args:
        file: Flight logs of `m100link record`, `serve`, `console`, `demo` or connect(record=…).
        speed: Speed of the replay, 0.1 to 100 times the flight's, or max.
        from_: Where to begin, in seconds from the first byte.
        until: Where to end, in seconds from the first byte.
    """
    if not file:
        raise UsageError("no flight log was named", remedy="m100link replay flight.mcap")
    end = "" if until is None else f"&until={until!r}"
    urls = [f"replay://{path.absolute()}?speed={speed}&from={from_!r}{end}" for path in file]
    words = urls
    if len(urls) > 1:
        words = [f"{name}={url}" for name, url in zip(_names(file), urls, strict=True)]
    aircraft = aircraft_of(options, words, page=page, no_record=True)
    asked = next(iter(aircraft.values())).origins
    return await run_station(
        aircraft,
        options.run,
        with_console=True,
        with_rosbridge=any(asked.get(name) == "command line" for name in _OF_ROSBRIDGE),
        open_browser=page.open_browser,
    )


_OF_ROSBRIDGE = ("port", "also_ports", "pages", "metrics_port")
"""Options by which somebody asks for rosbridge. A port in a file of settings is for flights."""


def _names(files: tuple[Path, ...]) -> list[str]:
    names: list[str] = []
    for path in files:
        stem = re.sub(r"[^A-Za-z0-9_]+", "_", path.stem).strip("_") or "flight"
        stem = stem if stem[0].isalpha() else f"flight_{stem}"
        name, number = stem, 1
        while namespace_of(name) in map(namespace_of, names):
            number += 1
            name = f"{stem}_{number}"
        names.append(name)
    return names
