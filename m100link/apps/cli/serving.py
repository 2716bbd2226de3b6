"""A station as a command: what every such command is told, how it runs, what it says of itself."""

from __future__ import annotations

import asyncio
import contextlib
import importlib
import logging
import queue
import threading
import webbrowser
from collections.abc import AsyncIterator, Callable
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Protocol, Self

from cyclopts import Parameter

from m100link.apps.cli.common import Told, err, out, run_async
from m100link.apps.cli.logs import AS_IT_IS, LogOptions
from m100link.apps.cli.outcome import ExitCode, print_json
from m100link.apps.station.config import Settings
from m100link.apps.station.log_output import log_of, tell_elsewhere
from m100link.errors import UsageError

if TYPE_CHECKING:
    from m100link.apps.agent.messages import Event
    from m100link.apps.station.child import Child

__all__ = [
    "AS_USUAL",
    "RunOptions",
    "Teller",
    "require_packages",
    "run_station",
    "show",
    "warn_of",
]


_MOST_UNTOLD = 200
_LAST_WORDS = 1.0
"""Seconds that the end waits for what is still to be told."""


@Parameter(name="*")
@dataclass(frozen=True)
class RunOptions:
    """How a station is run and told of.

    Attributes:
        config: TOML file with settings.
        json_output: Print one line of JSON when it runs.
        show_config: Print the settings and where each came from, and end.
        single_process: Let one process fly and talk to clients: to look into it, not to fly.
        log: What is logged; as JSON it has the events, too, which are told as text otherwise.
    """

    config: Annotated[Path | None, Parameter(env_var="M100LINK_CONFIG")] = None
    json_output: Annotated[bool, Parameter(name="--json")] = False
    show_config: bool = False
    single_process: bool = False
    log: LogOptions = AS_IT_IS


AS_USUAL = RunOptions()


def run_station(
    aircraft: dict[str, Settings],
    options: RunOptions,
    *,
    with_console: bool = False,
    with_rosbridge: bool = True,
    open_browser: bool = False,
    keys: Keys | None = None,
) -> int:
    """Run a station until it is told to end.

    Args:
        aircraft: Settings by name.
        options: How.
        with_console: Serve the console.
        with_rosbridge: Serve rosbridge.
        open_browser: Open the console.
        keys: Takes what is pressed at the terminal while it runs.

    Raises:
        UsageError: Something is missing, or cannot be.
    """
    if options.show_config:
        for name, settings in aircraft.items():
            if len(aircraft) > 1:
                out.print(f"[{name}]", markup=False)
            show(settings)
        return ExitCode.OK
    if with_rosbridge or with_console:
        require_packages()
    served = _Served(with_console, with_rosbridge)
    return run_async(_serve(aircraft, options, served, open_browser, keys))


def require_packages() -> None:
    """Look whether what serves pages is installed.

    Raises:
        UsageError: It is not.
    """
    try:
        for package in ("cbor2", "starlette", "uvicorn", "websockets"):
            importlib.import_module(package)
    except ModuleNotFoundError as error:
        raise UsageError(
            f"the ground station needs {error.name}, which is not installed",
            remedy="pip install '.[station]' in a clone of m100link",
        ) from None


Keys = Callable[[Any, asyncio.Event], contextlib.AbstractContextManager[None]]
"""With the station that runs, and what ends it."""


@dataclass(frozen=True)
class _Served:
    """What is served beside MAVLink."""

    with_console: bool
    with_rosbridge: bool


def show(settings: Settings) -> None:
    """Print the settings and where each came from."""
    for name in settings.__dataclass_fields__:
        if name in ("origins", "unused"):
            continue
        value = getattr(settings, name)
        shown = "(set)" if name in ("key", "token") and value else value
        source = settings.origins.get(name, "default")
        out.print(f"{name:14} {shown!s:40} {source}", markup=False, soft_wrap=True)
    _tell_unused(settings)


async def _serve(
    aircraft: dict[str, Settings],
    options: RunOptions,
    served: _Served,
    open_browser: bool,
    keys: Keys | None,
) -> int:
    from m100link.apps.agent.journal import JOURNAL_LOG
    from m100link.apps.station.child import leave_what_stays

    ended = Told()
    tell_elsewhere(JOURNAL_LOG)
    events = logging.getLogger(__name__)
    log_of(next(iter(aircraft)) if len(aircraft) == 1 else "")
    with Teller() as teller:

        def tell(name: str, event: Event) -> None:
            if options.log.log_json:
                level = logging.getLevelNamesMapping()[event.level.upper()]
                events.log(level, "%s", event.text, extra={"aircraft": name})
                return
            style = {"warning": "yellow", "error": "red"}.get(event.level)
            text = f"{name}: {event.text}" if len(aircraft) > 1 else event.text
            teller.do(lambda: err.print(text, style=style, markup=False))

        async with _running(aircraft, options, served, tell) as (station, front):
            announce = partial(_announce, aircraft, station, as_json=options.json_output)
            announce()
            leave_what_stays()
            settings = next(iter(aircraft.values()))
            warn_of(settings)
            if front is not None:
                # The code in the console's address works once; a front that is new has another.
                front.on_restart.append(lambda: teller.do(announce))
            if station.console_port is not None and open_browser:
                await asyncio.to_thread(webbrowser.open, _console_url(settings, station))
            with contextlib.nullcontext() if keys is None else keys(station, ended):
                await ended.wait()
            end = "ending: control authority goes back, an aircraft that flies hovers"
            told = end if station.has_authority else "ending"
            teller.do(lambda: err.print(told))
    return ExitCode.OK


@contextlib.asynccontextmanager
async def _running(
    aircraft: dict[str, Settings],
    options: RunOptions,
    served: _Served,
    tell: Callable[[str, Event], None],
) -> AsyncIterator[tuple[_Station, Child | None]]:
    """The station, and the process of its fronts."""
    from m100link.apps.station.apart import RunningApart, running_apart
    from m100link.apps.station.run import running
    from m100link.apps.station.several import running_several

    if len(aircraft) > 1:
        if options.single_process:
            raise UsageError("one process has one aircraft", remedy="leave out --single-process")
        async with running_several(aircraft, **asdict(served), tell=tell) as several:
            yield several, several.front
        return
    ((name, settings),) = aircraft.items()
    run = running if options.single_process else running_apart
    async with run(settings, **asdict(served)) as one:
        for event in one.agent.journal.events:
            tell(name, event)
        one.agent.journal.on_event.append(partial(tell, name))
        yield one, one.front if isinstance(one, RunningApart) else None


class Teller:
    """Tells in a thread of its own what happens while an aircraft flies.

    A terminal that was stopped by Ctrl-S and a pipe that nobody reads or that was closed are no
    reason to hold up setpoints, or to raise where something happened.
    """

    def __init__(self) -> None:
        self._work: queue.Queue[Callable[[], object] | None] = queue.Queue(_MOST_UNTOLD)
        self._thread = threading.Thread(target=self._run, name="m100link: talk", daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        with contextlib.suppress(queue.Full):
            self._work.put(None, timeout=_LAST_WORDS)
            self._thread.join(_LAST_WORDS)

    def do(self, print_it: Callable[[], object]) -> None:
        """Have something printed; what nobody reads in time is not."""
        with contextlib.suppress(queue.Full):
            self._work.put_nowait(print_it)

    def _run(self) -> None:
        with contextlib.suppress(OSError):  # nobody reads it any more
            while (print_it := self._work.get()) is not None:
                print_it()


class _Station(Protocol):
    """What every kind of running station tells of itself."""

    @property
    def has_authority(self) -> bool: ...
    @property
    def ports(self) -> list[int]: ...
    @property
    def console_port(self) -> int | None: ...
    @property
    def metrics_port(self) -> int | None: ...
    @property
    def foxglove_port(self) -> int | None: ...
    @property
    def mavlink(self) -> list[str]: ...
    def console_path(self) -> str: ...


def _console_url(settings: Settings, running: _Station) -> str:
    scheme = "http" if settings.tls_cert is None else "https"
    assert running.console_port is not None
    return f"{scheme}://{settings.authority(running.console_port)}{running.console_path()}"


def _announce(aircraft: dict[str, Settings], running: _Station, *, as_json: bool) -> None:
    settings = next(iter(aircraft.values()))
    scheme = "ws" if settings.tls_cert is None else "wss"
    addresses = [f"{scheme}://{settings.authority(port)}" for port in running.ports]
    console_url = None if running.console_port is None else _console_url(settings, running)
    metrics_url = None
    if running.metrics_port is not None:
        http = "http" if settings.tls_cert is None else "https"
        metrics_url = f"{http}://{settings.authority(running.metrics_port)}/metrics"
    viewed = running.foxglove_port
    viewers = [] if viewed is None else [f"{scheme}://{settings.authority(viewed)}"]
    if as_json:
        told: dict[str, Any] = {"sim": settings.sim}
        if addresses:
            told = {"rosbridge": addresses, "console": console_url} | told
        if running.mavlink:
            told |= {"mavlink": running.mavlink}
        told |= {"ros2": _nodes(aircraft)} if settings.ros2 else {}
        told |= {} if metrics_url is None else {"metrics": metrics_url}
        told |= {"foxglove": viewers[0]} if viewers else {}
        print_json(told | ({"aircraft": list(aircraft)} if len(aircraft) > 1 else {}))
    else:
        all_served = {"rosbridge": addresses, "mavlink": running.mavlink, "foxglove": viewers}
        all_served["ros2"] = _nodes(aircraft) if settings.ros2 else []
        for name, served in all_served.items():
            if served:
                out.print(f"{name + ':':10} {', '.join(served)}", markup=False, soft_wrap=True)
        if console_url is not None:
            out.print(f"console:   {console_url}", markup=False, soft_wrap=True)
        if metrics_url is not None:
            out.print(f"metrics:   {metrics_url}", markup=False, soft_wrap=True)


def _nodes(aircraft: dict[str, Settings]) -> list[str]:
    from m100link.apps.ros2.graph import NodeName
    from m100link.apps.station.ros2 import nodes_of

    settings = next(iter(aircraft.values()))
    names = nodes_of(settings, list(aircraft)).values()
    return [NodeName(0, "", one.namespace, one.node).full for one in names]


def _tell_unused(settings: Settings) -> None:
    if settings.unused:
        told = "[yellow]warning:[/] the launch file has parameters that mean nothing here: "
        err.print(told, end="")
        err.print(", ".join(settings.unused), markup=False)


def warn_of(settings: Settings) -> None:
    """Say what is dangerous about the settings."""
    _tell_unused(settings)
    if settings.is_plain_beyond_loopback():
        err.print(
            "[yellow]warning:[/] without TLS everybody on this network can read the token and "
            "fly the aircraft: give --tls-cert and --tls-key unless you trust the network"
        )
    if "null" in settings.allow_origin:
        err.print(
            "[yellow]warning:[/] --allow-origin null lets in pages opened from files, and "
            "sandboxed frames of any web page"
        )
