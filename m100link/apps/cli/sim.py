"""``m100link sim``: run virtual aircraft, and give orders to running ones."""

from __future__ import annotations

import asyncio
import os
import secrets
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import Parameter
from rich.console import Group
from rich.panel import Panel
from rich.table import Table
from rich.text import Text

from m100link.apps.agent.background import when_signalled
from m100link.apps.cli.common import out, pairs, until
from m100link.apps.cli.options import Above0, On, Simulated, group, options_of
from m100link.apps.cli.terminal import (
    AS_IT_IS,
    LogOptions,
    as_json,
    keys_pressed,
    panel,
    print_json,
    tell,
)
from m100link.errors import UsageError
from m100link.link.keyfile import read_key
from m100link.sim.clock import loop_factory
from m100link.sim.line import LineFaults
from m100link.sim.orders import ACTIONS, CtlServer, Scenario, perform, send_order, status
from m100link.sim.ports.driver import (
    LINE_OPTIONS,
    MISSION_OPTIONS,
    SITE_OPTIONS,
    Driver,
    TcpServer,
    serve_tcp,
)
from m100link.sim.ports.pty import PtyPort
from m100link.sim.vehicle.activation import DEMO_APP_ID, DEMO_KEY
from m100link.sim.vehicle.dynamics import read_airframe
from m100link.sim.vehicle.missions.route import MissionSettings
from m100link.sim.vehicle.settings import AircraftSettings, AssistantSettings
from m100link.sim.virtual import VirtualAircraft
from m100link.wire import Key

if TYPE_CHECKING:
    from rich.console import RenderableType

    from m100link.sim.virtual import VirtualAircraft


app = group("sim", "Run a virtual Matrice 100, for people and for programs.")

for _verb, _function in (("compare", "compare"), ("fit", "fit_recordings")):
    app.command(f"m100link.apps.cli.sim_fit:{_function}", name=_verb)


@Parameter(name="*", group=panel("Line faults"))
@dataclass(frozen=True)
class FaultOptions(
    options_of(LineFaults, LINE_OPTIONS)  # type: ignore[misc] # a class that is made
):
    """The faults of the line, in both directions: every fault that there is."""

    def faults(self) -> LineFaults:
        """As the line takes them."""
        return LineFaults(**asdict(self))


@Parameter(name="*", group=panel("Site and sensors"))
@dataclass(frozen=True)
class SiteOptions(
    options_of(AircraftSettings, SITE_OPTIONS, defaults={"noise": 1.0})  # type: ignore[misc] # a class that is made
):
    """Where it stands, and how good its sensors are."""

    def settings(self, missions: MissionSettings) -> AircraftSettings:
        """As the aircraft takes them."""
        return AircraftSettings(**asdict(self), missions=missions)


@Parameter(name="*", group=panel("Missions"))
@dataclass(frozen=True)
class MissionOptions(
    options_of(MissionSettings, MISSION_OPTIONS)  # type: ignore[misc] # a class that is made
):
    """How firmware 3.1 takes missions, where sources are silent or disagree."""

    def settings(self) -> MissionSettings:
        """As the aircraft takes them."""
        return MissionSettings(**asdict(self))


@Parameter(name="*", group=panel("App registered with DJI"))
@dataclass(frozen=True)
class RegisteredAppOptions:
    """The app that the virtual server knows.

    Attributes:
        app_id: App id of the registration.
        key: Its AES key, 64 hex digits; by default the well-known demo key 000102…1f.
        key_file: File with that key.
        level: Authorization level of the registration.
        activated: Start activated for this app, as after an earlier program.
    """

    app_id: int = DEMO_APP_ID
    key: str | None = None
    key_file: Path | None = None
    level: Literal[0, 1, 2] = 2
    activated: bool = False

    def secret(self) -> Key:
        """The key. Raises UsageError, BadKey."""
        if self.key is not None and self.key_file is not None:
            raise UsageError("--key and --key-file exclude each other", remedy="give one of them")
        if self.key_file is not None:
            return read_key(self.key_file)
        return DEMO_KEY if self.key is None else Key(self.key)


@Parameter(name="*", group=panel("Port"))
@dataclass(frozen=True)
class AssistantOptions(
    options_of(AssistantSettings, {"baud_rate": "baud", "acceleration": "acceleration"})  # type: ignore[misc] # a class that is made
):
    """Its ports, and what the PC assistant sets.

    Attributes:
        link: Name of the port: a symbolic link to the pseudo-terminal, removed at the end.
        tcp: Listen on [HOST:]PORT instead, or with --link as well; port 0 chooses a free one.
        count: Number of aircraft; their ports are numbered from 0.
        pace: Let bytes take their time at --baud, in both directions.
        item_rate: ITEM=HZ, a telemetry rate of the PC assistant (0, 1, 10, 50, 100); repeatable.
    """

    link: Path | None = None
    tcp: str | None = None
    count: int = 1
    pace: On = True
    item_rate: tuple[str, ...] = ()

    def settings(self, *, cold: bool) -> AssistantSettings:
        """As the aircraft takes them."""
        return AssistantSettings(
            api_control_enabled=not cold,
            baud_rate=self.baud_rate,
            rates_hz=pairs(self.item_rate),
            acceleration=self.acceleration,
        )


@dataclass(frozen=True)
class _Plan:
    aircraft: list[VirtualAircraft]
    link: Path | None
    tcp: tuple[str, int] | None
    scenario: Path | None
    duration: float | None
    seed: int


@app.default
def run(
    *,
    firmware: Simulated = "1.0",
    seed: int | None = None,
    airframe: str | None = None,
    cold: bool = False,
    speed: float = 1.0,
    scenario: Path | None = None,
    duration: Annotated[float | None, Above0] = None,
    registered: RegisteredAppOptions = RegisteredAppOptions(),
    assistant: AssistantOptions = AssistantOptions(),
    faults: FaultOptions = FaultOptions(),
    site: SiteOptions = SiteOptions(),
    missions: MissionOptions = MissionOptions(),
    log: LogOptions = AS_IT_IS,
) -> int:
    """Run a virtual aircraft behind a serial port that programs can open.

    It stands ready to fly, and answers until Ctrl-C or SIGTERM. A terminal shows it live and has
    keys; a pipe gets one line of JSON once it answers.

    Args:
        seed: Seed of everything random; by default a new one, which the command prints.
        airframe: How it flies: document, measured-3.1.10, or a file of `m100link sim fit`.
        cold: Start as after power-on: API control not enabled, switch in P, no app, no GPS.
        speed: Speed of its clock, times real time.
        scenario: TOML file of timed events.
        duration: Seconds of its own clock until it ends by itself.
    """
    if seed is None:
        seed = secrets.randbits(32)
    if assistant.count < 1:
        raise UsageError(f"{assistant.count} aircraft cannot be run", remedy="--count 1, or more")
    if not 0.0 < speed <= 1000.0:
        raise UsageError(f"the speed is {speed:g}", remedy="above 0 and at most 1000")
    options: dict[str, Any] = {
        "firmware": firmware,
        "app_id": registered.app_id,
        "key": registered.secret(),
        "level": registered.level,
        "cold": cold,
        "paced": assistant.pace,
        "activated": registered.activated,
    }
    try:
        settings = site.settings(missions.settings())
        if airframe is not None:
            settings = replace(settings, airframe=read_airframe(airframe))
        options |= {
            "settings": settings,
            "faults": faults.faults(),
            "assistant": assistant.settings(cold=cold),
        }
        aircraft = [
            VirtualAircraft(seed=seed + index, **options) for index in range(assistant.count)
        ]
    except UsageError:
        raise
    except ValueError as error:
        raise UsageError(str(error), remedy="m100link sim --help has the values") from error
    address = None if assistant.tcp is None else _read_address(assistant.tcp)
    plan = _Plan(aircraft, assistant.link, address, scenario, duration, seed)
    with asyncio.Runner(loop_factory=loop_factory(speed)) as runner:
        return runner.run(_serve(plan))


def _read_address(text: str) -> tuple[str, int]:
    host, _, port = text.rpartition(":")
    if not port.isdecimal() or int(port) > 65_535:
        raise UsageError(f"{text!r} is not [HOST:]PORT", remedy="--tcp 7000 or --tcp 0.0.0.0:7000")
    return host or "127.0.0.1", int(port)


async def _serve(plan: _Plan) -> int:
    ended = asyncio.Event()
    when_signalled(ended.set, "SIGINT", "SIGTERM", "SIGHUP")
    drivers = [Driver(aircraft) for aircraft in plan.aircraft]
    servers: list[TcpServer] = []
    control = CtlServer(plan.aircraft)
    try:
        ports = await _open_ports(plan, drivers, servers)
        if plan.scenario is not None:
            for driver in drivers:
                driver.scenario = Scenario.read(plan.scenario)
        await control.start()
        if as_json():
            print_json(_announcement(plan, ports, control))
            await until(plan.duration, ended.wait())
        else:
            await _show(plan, ports, ended)
    finally:
        await control.stop()
        for server in servers:
            await server.stop()
        for driver in drivers:
            driver.stop()
    return 0


async def _open_ports(plan: _Plan, drivers: list[Driver], servers: list[TcpServer]) -> list[str]:
    """One port per aircraft, or two with --link and --tcp; the first of each is returned."""
    ports = []
    for index, driver in enumerate(drivers):
        names = []
        if plan.link is not None or plan.tcp is None:
            link = plan.link
            if link is not None and len(drivers) > 1:
                link = link.with_name(f"{link.name}{index}")
            names.append(PtyPort(driver, link=link).name)
        if plan.tcp is not None:
            host, number = plan.tcp
            try:
                server = await serve_tcp(driver, host, number + index if number else 0)
            except OSError as error:
                raise UsageError(
                    f"cannot listen on {host}:{number}: {error.strerror}",
                    remedy="name an address of this machine and a free port, or port 0",
                ) from error
            servers.append(server)
            names.append(f"tcp://{host}:{server.port}")
        ports.append(names[0])
    return ports


def _announcement(plan: _Plan, ports: list[str], control: CtlServer) -> dict[str, Any]:
    first = plan.aircraft[0]
    line: dict[str, Any] = {
        "port": ports[0],
        "firmware": first.autopilot.profile.name,
        "seed": plan.seed,
        "app_id": first.credentials.app_id,
        "level": first.credentials.level,
        "serial_number": first.vehicle.serial_number,
        "pid": os.getpid(),
        "control_socket": None if control.path is None else str(control.path),
    }
    if len(ports) > 1:
        line["ports"] = ports
    return line


async def _show(plan: _Plan, ports: list[str], ended: asyncio.Event) -> None:
    from rich.live import Live

    view = LiveView(plan.aircraft[0], ports)
    loop = asyncio.get_running_loop()
    deadline = None if plan.duration is None else loop.time() + plan.duration
    shown = Live(view.render(), console=out, auto_refresh=False, screen=True)
    with keys_pressed(view.press), shown as live:
        while not ended.is_set() and (deadline is None or loop.time() < deadline):
            live.update(view.render(), refresh=True)
            await until(0.1, ended.wait())


@app.command
def ctl(
    *order: Annotated[str, Parameter(allow_leading_hyphen=True)],
    socket: Path | None = None,
    aircraft: int = 0,
) -> int:
    """Give an order to a virtual aircraft that runs in another shell.

    Without an order, the command lists the actions.

    Args:
        order: The action and its arguments, such as: rc-mode P.
        socket: Control socket of the simulator, if several run; its first line of JSON names it.
        aircraft: Number of the aircraft, from 0, if the simulator has several.
    """
    if not order:
        for action in ACTIONS.values():
            facts = {"action": action.name, "arguments": action.usage, "does": action.help}
            tell(facts, f"{action.name:18} {action.usage:36} {action.help}")
        return 0
    answer = send_order(list(order), path=socket, aircraft=aircraft)
    if not answer.get("ok"):
        raise UsageError(str(answer.get("error", "no answer")))
    status = answer["status"]
    return tell(status, *(f"{name:24} {value}" for name, value in status.items()))


# -- the live view of ``m100link sim``: what a terminal shows, and what its keys do ----------------


KEYS: dict[str, tuple[str, str]] = {
    "p": ("rc-mode P", "RC to P"),
    "a": ("rc-mode A", "RC to A"),
    "f": ("rc-mode F", "RC to F"),
    "r": ("rc-off", "RC off"),
    "R": ("rc-on", "RC on"),
    "UP": ("stick pitch=0.5", "stick forward"),
    "DOWN": ("stick pitch=-0.5", "back"),
    "LEFT": ("stick roll=-0.5", "left"),
    "RIGHT": ("stick roll=0.5", "right"),
    "w": ("stick throttle=0.5", "climb"),
    "s": ("stick throttle=-0.5", "sink"),
    "q": ("stick yaw=-0.5", "turn left"),
    "e": ("stick yaw=0.5", "turn right"),
    " ": ("release-sticks", "let go"),
    "t": ("take-off", "pilot takes off"),
    "l": ("land", "pilot lands"),
    "m": ("app-takes-control", "app takes control"),
    "M": ("app-releases-control", "app lets go"),
    "n": ("no-app", "no app"),
    "N": ("app", "app connected"),
    "g": ("gps 1", "GPS lost"),
    "G": ("gps 5", "GPS good"),
    "b": ("battery 12", "battery low"),
    "x": ("faults loss=0.2 damage=0.05", "bad line"),
    "X": ("no-faults", "clean line"),
    "u": ("unplug", "unplug"),
    "U": ("replug", "replug"),
    "B": ("reboot", "reboot"),
}
"""Order and label per key. Ctrl-C ends the simulator."""

_WIDE = 72
"""Columns of a terminal that has room for two values on a line."""


class LiveView:
    """One aircraft on the screen."""

    def __init__(self, aircraft: VirtualAircraft, ports: list[str]) -> None:
        self._aircraft = aircraft
        self._ports = ports
        self._message = ""

    def press(self, key: str) -> None:
        """Carry out the order of a key."""
        if key not in KEYS:
            return
        order, _ = KEYS[key]
        try:
            perform(self._aircraft, order)
            self._message = order
        except UsageError as error:
            self._message = error.seen

    def render(self) -> RenderableType:
        """The view as it is now."""
        return Group(self._state(), self._history(), self._help())

    def _state(self) -> Panel:
        state = status(self._aircraft)
        motion = self._aircraft.vehicle.flight.dynamics
        north, east, up = state["velocity"]
        heading = state["heading_deg"]
        control = state["control"].upper()
        if state["authority_obstacle"]:
            control += f"  (API: {state['authority_obstacle']})"
        app = _app(state["app_connected"], state["app_has_internet"], state["activated_app"])
        sent, lost = state["frames_sent"], state["frames_lost"]
        shown = {
            "flight": f"{state['flight_status']}, {state['maneuver']}",
            "height": f"{state['height']:z.2f} m",
            "attitude": f"roll {_degrees(motion.roll)} pitch {_degrees(motion.pitch)} "
            f"yaw {heading:z.0f}°",
            "velocity": f"N {north:+z.1f} E {east:+z.1f} up {up:+z.1f} m/s",
            "control": control,
            "place": f"N {state['north']:+z.1f} E {state['east']:+z.1f} m",
            "RC": state["rc_mode"] + ("" if state["rc_is_on"] else ", off"),
            "battery, GPS": f"{state['battery_percent']:.0f} %, {state['gps_health']}",
            "app": app,
            "line": f"{sent} out, {state['commands']} in, {lost} lost",
        }
        if state["mission"] is not None:
            ended = self._aircraft.vehicle.missions.running is None
            doing, what, how_far = _mission(state["mission"])
            shown |= {"last mission" if ended else "mission": doing, what: how_far}
        table = Table.grid(padding=(0, 2))
        cells = [(Text(name, style="bold"), value) for name, value in shown.items()]
        for left, right in zip(cells[::2], cells[1::2], strict=True):
            if out.width >= _WIDE:
                table.add_row(*left, *right)
            else:
                table.add_row(*left)
                table.add_row(*right)
        title = f"Matrice 100, firmware {state['firmware']}, seed {state['seed']}"
        return Panel(table, title=title, subtitle=", ".join(self._ports), title_align="left")

    def _history(self) -> Panel:
        autopilot = self._aircraft.autopilot
        lines = [
            f"{entry.time:8.2f}  {entry.text}" for entry in list(self._aircraft.vehicle.events)[-6:]
        ]
        commands = []
        for command in list(autopilot.received_commands)[-4:]:
            name = command.command.NAME if command.command else str(command.address)
            code = "" if command.code is None else f" -> 0x{command.code:04X}"
            commands.append(f"{command.time:8.2f}  {name}{code}")
        if autopilot.received_movements:
            move = autopilot.received_movements[-1]
            commands.append(
                f"{autopilot.counters.movements:8d}  movements, flag 0x{move.control_flag:02X} "
                f"({move.roll_or_x:g}, {move.pitch_or_y:g}, {move.throttle_or_z:g}, {move.yaw:g})"
            )
        table = Table.grid(padding=(0, 3))
        table.add_row(Text("\n".join(lines)), Text("\n".join(commands)))
        return Panel(table, title="events and commands", title_align="left")

    def _help(self) -> Text:
        text = Text(style="dim")
        for key, (_, label) in KEYS.items():
            text.append("space" if key == " " else key.lower() if len(key) > 1 else key, "bold")
            text.append(f" {label}  ")
        if self._message:
            text.append(f"\n> {self._message}", style="yellow")
        return text


def _mission(mission: dict[str, Any]) -> tuple[str, str, str]:
    doing = f"{mission['kind']}: {'paused' if mission['is_paused'] else mission['doing']}"
    if "waypoint" not in mission:
        return doing, "", ""
    return doing, "waypoint", f"{mission['waypoint']} of 0 to {mission['waypoints'] - 1}"


def _degrees(radians: float) -> str:
    return f"{radians * 57.29578:+z.1f}°"


def _app(connected: bool, internet: bool, active: int | None) -> str:
    words = "connected" if connected else "not connected"
    if connected and not internet:
        words += ", no Internet"
    return words + (", not activated" if active is None else f", app {active} active")
