"""The live view of ``m100link sim``: what a terminal shows, and what its keys do."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from rich.console import Group
from rich.panel import Panel
from rich.table import Table
from rich.text import Text

from m100link.apps.cli.common import out
from m100link.errors import UsageError
from m100link.sim.orders.actions import perform, status

if TYPE_CHECKING:
    from rich.console import RenderableType

    from m100link.sim.virtual import VirtualAircraft

__all__ = ["KEYS", "LiveView"]

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

_ESCAPES = {b"\x1b[A": "UP", b"\x1b[B": "DOWN", b"\x1b[D": "LEFT", b"\x1b[C": "RIGHT"}


def read_keys(data: bytes) -> list[str]:
    """The keys in what the terminal sent."""
    keys = []
    while data:
        for escape, name in _ESCAPES.items():
            if data.startswith(escape):
                keys.append(name)
                data = data[len(escape) :]
                break
        else:
            keys.append(chr(data[0]))
            data = data[1:]
    return keys


class LiveView:
    """One aircraft on the screen."""

    def __init__(self, aircraft: VirtualAircraft, ports: list[str]) -> None:
        self._aircraft = aircraft
        self._ports = ports
        self._message = ""

    def press(self, key: str) -> None:
        """Do what a key stands for."""
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
        rows = [
            (
                "flight",
                f"{state['flight_status']}, {state['maneuver']}",
                "height",
                f"{state['height']:.2f} m",
            ),
            (
                "attitude",
                f"roll {_degrees(motion.roll)} pitch {_degrees(motion.pitch)} yaw {heading:.0f}°",
                "velocity",
                f"N {north:+.1f} E {east:+.1f} up {up:+.1f} m/s",
            ),
            (
                "control",
                control,
                "place",
                f"N {state['north']:+.1f} E {state['east']:+.1f} m",
            ),
            (
                "RC",
                f"{state['rc_mode']}" + ("" if state["rc_is_on"] else ", off"),
                "battery, GPS",
                f"{state['battery_percent']:.0f} %, {state['gps_health']}",
            ),
            (
                "app",
                _app(state["app_connected"], state["app_has_internet"], state["activated_app"]),
                "line",
                f"{state['frames_sent']} out, {state['commands']} in, {state['frames_lost']} lost",
            ),
        ]
        if state["mission"] is not None:
            ended = self._aircraft.vehicle.missions.running is None
            rows.append(("last mission" if ended else "mission", *_mission(state["mission"])))
        table = Table.grid(padding=(0, 2))
        for row in rows:
            left, right = ((Text(title, style="bold"), told) for title, told in (row[:2], row[2:]))
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


def _mission(told: dict[str, Any]) -> tuple[str, str, str]:
    """What the mission does, and how far it is."""
    doing = f"{told['kind']}: {'paused' if told['is_paused'] else told['doing']}"
    if "waypoint" not in told:
        return doing, "", ""
    return doing, "waypoint", f"{told['waypoint']} of 0 to {told['waypoints'] - 1}"


def _degrees(radians: float) -> str:
    return f"{radians * 57.29578:+.1f}°"


def _app(connected: bool, internet: bool, active: int | None) -> str:
    words = "connected" if connected else "not connected"
    if connected and not internet:
        words += ", no Internet"
    return words + (", not activated" if active is None else f", app {active} active")
