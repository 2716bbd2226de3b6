"""``m100link serve`` and ``m100link console``: one aircraft for many clients, and for browsers."""

from __future__ import annotations

import asyncio
import os
import signal
import webbrowser
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from m100link.cli.common import ExitCode, err, out, print_json, run_async
from m100link.errors import UsageError

if TYPE_CHECKING:
    from m100link.agent.journal import Event
    from m100link.station.config import Settings
    from m100link.station.run import Running

__all__ = ["console", "serve"]


@Parameter(name="*")
@dataclass(frozen=True)
class StationOptions:
    """Where the aircraft is, whose app it is, who may connect.

    Every value may also come from the environment, a TOML file or a ROS launch file, in this order.

    Attributes:
        sim: Bring a virtual aircraft.
        config: TOML file with settings.
        launch: ROS launch file of DJI's node, read as it is.
        baud_rate: Rate when the URL has none (M100LINK_BAUD_RATE).
        firmware: Force a firmware profile (M100LINK_PROFILE).
        app_id: App id at DJI (M100LINK_APP_ID).
        key_file: File with its key, 64 hex digits, readable by you alone (M100LINK_KEY_FILE).
        level: Authorization level of the app id (M100LINK_LEVEL).
        app_version: Version of the app (firmware 1.0).
        bundle_id: Bundle id of the app.
        host: Address to bind; beyond this machine a token is needed (M100LINK_HOST).
        port: Port of rosbridge (M100LINK_PORT).
        also_port: One more port for it, such as 19871 for DJI's later page; may be repeated.
        allow_host: A name that this station goes by; may be repeated.
        allow_origin: A page from elsewhere that may connect, such as http://127.0.0.1:8000; null
            is a page opened from a file. May be repeated.
        token_file: File with the token that clients have to know (M100LINK_TOKEN_FILE).
        tls_cert: Certificate, PEM.
        tls_key: Its private key, PEM.
        pages: Folder with web pages to serve on the rosbridge port, such as DJI's keyboard page.
        max_clients: Clients at once.
        json_output: Print one line of JSON when it runs.
        show_config: Print the settings and where each came from, and end.
    """

    sim: bool | None = None
    config: Annotated[Path | None, Parameter(env_var="M100LINK_CONFIG")] = None
    launch: Path | None = None
    baud_rate: int | None = None
    firmware: str | None = None
    app_id: int | None = None
    key_file: Path | None = None
    level: int | None = None
    app_version: int | None = None
    bundle_id: str | None = None
    host: str | None = None
    port: int | None = None
    also_port: tuple[int, ...] = ()
    allow_host: tuple[str, ...] = ()
    allow_origin: tuple[str, ...] = ()
    token_file: Path | None = None
    tls_cert: Path | None = None
    tls_key: Path | None = None
    pages: Path | None = None
    max_clients: int | None = None
    json_output: Annotated[bool, Parameter(name="--json")] = False
    show_config: bool = False

    def settings(self, **more: Any) -> Settings:
        """The settings from all sources."""
        from m100link.station.config import resolve

        flags = {
            name: getattr(self, name)
            for name in self.__dataclass_fields__
            if name not in ("config", "launch", "also_port", "json_output", "show_config")
        }
        flags["also_ports"] = self.also_port
        given = {name: value for name, value in flags.items() if value != ()}
        environment = dict(os.environ)
        return resolve(given | more, environment, config=self.config, launch=self.launch)


def serve(url: str | None = None, *, options: StationOptions = StationOptions()) -> int:
    """Own the serial port and share the aircraft: rosbridge v2 for any number of clients.

    Telemetry for all of them, control for one at a time. DJI's web page of 2015 and roslib programs
    work as they are: `m100link serve --sim --pages dji_keyboard_ctrl`.

    Args:
        url: Where the aircraft is (M100LINK_URL).
        options: See below.
    """
    return _run(options.settings(url=url), options, with_console=False)


def console(
    url: str | None = None,
    *,
    console_port: int | None = None,
    tiles: Path | None = None,
    open_browser: bool = True,
    options: StationOptions = StationOptions(),
) -> int:
    """Serve the console for browsers, beside everything that `serve` serves, and open it.

    Args:
        url: Where the aircraft is (M100LINK_URL).
        console_port: Port of the console (M100LINK_CONSOLE_PORT).
        tiles: Folder with map tiles {z}/{x}/{y}.png; without it the track is drawn on a grid.
        open_browser: Open the console in the browser.
        options: See below.
    """
    settings = options.settings(url=url, console_port=console_port, tiles=tiles)
    return _run(settings, options, with_console=True, open_browser=open_browser)


def _run(
    settings: Settings,
    options: StationOptions,
    *,
    with_console: bool,
    open_browser: bool = False,
) -> int:
    if options.show_config:
        return _show(settings)
    try:
        import cbor2  # noqa: F401 - only whether it is there
        import starlette  # noqa: F401 - only whether it is there
        import uvicorn  # noqa: F401 - only whether it is there
        import websockets  # noqa: F401 - only whether it is there
    except ModuleNotFoundError as error:
        raise UsageError(
            f"the ground station needs {error.name}, which is not installed",
            remedy="pip install 'm100link[station]'",
        ) from None
    return run_async(_serve(settings, options, with_console, open_browser))


def _show(settings: Settings) -> int:
    for name in settings.__dataclass_fields__:
        if name == "origins":
            continue
        value = getattr(settings, name)
        shown = "(set)" if name in ("key", "token") and value else value
        source = settings.origins.get(name, "default")
        out.print(f"{name:14} {shown!s:40} {source}", markup=False, soft_wrap=True)
    return ExitCode.OK


async def _serve(
    settings: Settings, options: StationOptions, with_console: bool, open_browser: bool
) -> int:
    from m100link.station.run import running

    ended = asyncio.Event()
    loop = asyncio.get_running_loop()
    for number in (signal.SIGINT, signal.SIGTERM):
        loop.add_signal_handler(number, ended.set)
    async with running(settings, with_console=with_console) as station:
        for event in station.agent.journal.events:
            _tell(event)
        station.agent.journal.on_event.append(_tell)
        _announce(settings, station, as_json=options.json_output)
        if station.console_port is not None and open_browser:
            await asyncio.to_thread(webbrowser.open, _console_url(settings, station))
        await ended.wait()
        err.print("ending: the aircraft hovers, control authority goes back")
    return ExitCode.OK


def _console_url(settings: Settings, running: Running) -> str:
    scheme = "http" if settings.tls_cert is None else "https"
    assert running.console_port is not None
    return f"{scheme}://{settings.authority(running.console_port)}{running.console_path()}"


def _announce(settings: Settings, running: Running, *, as_json: bool) -> None:
    scheme = "ws" if settings.tls_cert is None else "wss"
    addresses = [f"{scheme}://{settings.authority(port)}" for port in running.ports]
    console_url = None if running.console_port is None else _console_url(settings, running)
    if as_json:
        print_json({"rosbridge": addresses, "console": console_url, "sim": settings.sim})
    else:
        out.print(f"rosbridge: {', '.join(addresses)}", markup=False, soft_wrap=True)
        if console_url is not None:
            out.print(f"console:   {console_url}", markup=False, soft_wrap=True)
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


def _tell(event: Event) -> None:
    style = {"warning": "yellow", "error": "red"}.get(event.level)
    err.print(event.text, style=style, markup=False)
