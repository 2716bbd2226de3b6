"""Everything that can be done to a virtual aircraft, by name: one table for all who do it.

``m100link sim ctl``, the keys of the live view and scenario files speak these words; each is one
method of :class:`~m100link.sim.virtual.VirtualAircraft`. An order is a line of text::

    rc-mode P
    stick pitch=0.5 yaw=-0.2
    faults loss=0.1 damage=0.02
"""

from __future__ import annotations

import asyncio
import contextlib
import dataclasses
import json
import math
import os
import re
import shlex
import socket
import tempfile
from bisect import insort
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, get_type_hints

from m100link.errors import M100Error, UsageError
from m100link.errors.texts import read_json, read_toml
from m100link.errors.usage import unread
from m100link.sim.line import LineFaults
from m100link.sim.ports.driver import stop_listening
from m100link.sim.virtual import VirtualAircraft

_ON = {"on": True, "yes": True, "true": True, "1": True}
_OFF = {"off": False, "no": False, "false": False, "0": False}
_LIST = "`m100link sim ctl` lists the orders with their arguments"


@dataclass(frozen=True, slots=True)
class Action:
    """One thing that can be done."""

    name: str  # the word for it
    usage: str  # its arguments, for help
    help: str
    # Does it, given positional and ``name=value`` arguments as text.
    run: Callable[[VirtualAircraft, list[str], dict[str, str]], Any]


def _switch(words: list[str]) -> bool:
    if not words:
        return True
    answers = _ON | _OFF
    if words[0].lower() not in answers:
        raise UsageError(f"{words[0]!r} is neither on nor off", remedy="say on or off")
    return answers[words[0].lower()]


def _number(words: list[str], index: int = 0) -> float:
    try:
        return float(words[index])
    except IndexError:
        raise UsageError("a number is missing", remedy=_LIST) from None
    except ValueError:
        raise UsageError(f"{words[index]!r} is not a number", remedy=_LIST) from None


def _numbers(named: dict[str, str]) -> dict[str, float]:
    return {name: _number([value]) for name, value in named.items()}


def _rc_mode(aircraft: VirtualAircraft, words: list[str], _: dict[str, str]) -> None:
    mode = words[0].upper() if words else ""
    if mode not in ("P", "A", "F"):
        raise UsageError(f"the mode switch has no position {mode!r}", remedy="P, A or F")
    aircraft.set_rc_mode(mode)


def _app_takes(aircraft: VirtualAircraft, _: list[str], __: dict[str, str]) -> None:
    if not aircraft.app_takes_control():
        raise UsageError(
            "the app cannot take control: it is not connected, or the switch is not in F",
            remedy="app, then rc-mode F",
        )


_FAULTS: dict[str, Any] = get_type_hints(LineFaults)
"""Type of each fault by its name: what a word of an order is read as."""


def _faults(aircraft: VirtualAircraft, words: list[str], named: dict[str, str]) -> None:
    changes: dict[str, Any] = {}
    for name, value in (dict.fromkeys(words, "on") | named).items():
        field = name.replace("-", "_")
        kind = _FAULTS.get(field)
        if kind is None or (name in words and kind is not bool):
            raise UsageError(
                f"no fault is called {name!r}", remedy=f"faults: {', '.join(sorted(_FAULTS))}"
            )
        if kind is bool:
            changes[field] = _switch([value])
        else:
            changes[field] = _number([value]) if kind is float else int(_number([value]))
    aircraft.set_faults(dataclasses.replace(aircraft.line.to_host.faults, **changes))


def _faults_usage() -> str:
    return " ".join(name if kind is bool else f"{name}=…" for name, kind in _FAULTS.items())


def _rates(aircraft: VirtualAircraft, _: list[str], named: dict[str, str]) -> None:
    aircraft.set_rates(**{item: int(rate) for item, rate in _numbers(named).items()})


def _acceleration(aircraft: VirtualAircraft, words: list[str], _: dict[str, str]) -> None:
    aircraft.set_acceleration(" ".join(words))


def _message(aircraft: VirtualAircraft, words: list[str], named: dict[str, str]) -> None:
    if "hex" in named:
        aircraft.send_from_mobile(bytes.fromhex(named["hex"]))
    else:
        aircraft.send_from_mobile(" ".join(words).encode())


def _mission(aircraft: VirtualAircraft, words: list[str], _: dict[str, str]) -> None:
    missions = aircraft.vehicle.missions
    acts = {"stop": missions.stop, "pause": missions.pause, "resume": missions.resume}
    if not words:
        return
    if words[0] not in acts:
        raise UsageError(f"a mission cannot be given {words[0]!r}", remedy="stop, pause or resume")
    if missions.running is None:
        raise UsageError("no mission runs", remedy="start one first")
    code = acts[words[0]](type(missions.running))
    if code:
        raise UsageError(f"mission {words[0]}: {code.meaning}", remedy="look at it: status")


def _battery(aircraft: VirtualAircraft, words: list[str], _: dict[str, str]) -> None:
    aircraft.battery_percent = _number(words)


def _gps(aircraft: VirtualAircraft, words: list[str], _: dict[str, str]) -> None:
    aircraft.gps_health = int(_number(words))


def _stick(aircraft: VirtualAircraft, _: list[str], named: dict[str, str]) -> None:
    unknown = set(named) - {"roll", "pitch", "yaw", "throttle"}
    if unknown or not named:
        raise UsageError(
            f"{', '.join(sorted(unknown)) or 'nothing'} is no stick",
            remedy="roll, pitch, yaw, throttle: stick pitch=0.5",
        )
    aircraft.move_stick(**_numbers(named))


def _plain(method: str) -> Callable[..., None]:
    return lambda aircraft, _, __: getattr(aircraft, method)()


def _switched(method: str) -> Callable[..., None]:
    return lambda aircraft, words, _: getattr(aircraft, method)(_switch(words))


ACTIONS: dict[str, Action] = {
    action.name: action
    for action in (
        Action("status", "", "show the aircraft", lambda aircraft, _, __: None),
        Action("rc-mode", "P|A|F", "turn the mode switch", _rc_mode),
        Action("leave-f", "", "the pilot takes over (mode switch to P)", _plain("leave_f")),
        Action("return-to-f", "", "the pilot gives the aircraft back", _plain("return_to_f")),
        Action("stick", "roll=… pitch=… yaw=… throttle=…", "deflect sticks, -1 to 1", _stick),
        Action("release-sticks", "", "let all sticks go", _plain("release_sticks")),
        Action("rc-off", "", "switch the remote control off", _plain("rc_lost")),
        Action("rc-on", "", "switch it on again", _plain("rc_back")),
        Action("take-off", "", "the pilot takes off", _plain("pilot_takes_off")),
        Action("land", "", "the pilot lands", _plain("pilot_lands")),
        Action(
            "app",
            "[internet=on|off]",
            "connect the mobile app",
            lambda aircraft, _, named: aircraft.connect_app(
                internet=_switch([named["internet"]] if "internet" in named else [])
            ),
        ),
        Action("no-app", "", "disconnect the mobile app", _plain("disconnect_app")),
        Action("app-takes-control", "", "the mobile app takes control", _app_takes),
        Action("app-releases-control", "", "it gives control back", _plain("app_releases_control")),
        Action("message", "TEXT | hex=…", "the mobile app sends data", _message),
        Action("server-refuses", "[on|off]", "no new activations", _switched("server_refuses")),
        Action(
            "key",
            "HEX",
            "another key at the server",
            lambda aircraft, words, _: aircraft.change_key(words[0] if words else ""),
        ),
        Action("api", "[on|off]", "tick 'enable API control'", _switched("enable_api")),
        Action("ioc", "[on|off]", "intelligent orientation control", _switched("set_ioc")),
        Action("rates", "ITEM=HZ …", "telemetry rates", _rates),
        Action("acceleration", "raw|fused", "how acceleration is sent", _acceleration),
        Action("gps", "0…5", "GPS health", _gps),
        Action("battery", "PERCENT", "charge of the battery", _battery),
        Action(
            "wind",
            "NORTH EAST",
            "velocity of the air in m/s",
            lambda aircraft, words, _: aircraft.set_wind(_number(words), _number(words, 1)),
        ),
        Action("mission", "[stop|pause|resume]", "show, end or hold the mission", _mission),
        Action("reboot", "", "restart the autopilot", _plain("reboot")),
        Action("faults", _faults_usage(), "spoil the line", _faults),
        Action("no-faults", "", "a clean line", _plain("set_faults")),
        Action("stall", "[on|off]", "stop the line", _switched("stall_line")),
        Action("unplug", "", "pull the plug", _plain("unplug")),
        Action("replug", "", "put the plug back", _plain("replug")),
    )
}
"""Every action by name."""


def perform(aircraft: VirtualAircraft, order: str | list[str]) -> Action:
    """Carry out an order, a line of text or its words; returns the action that was done.

    Raises ``UsageError``: no such action, or arguments that it cannot have.
    """
    words = shlex.split(order) if isinstance(order, str) else list(order)
    if not words:
        raise UsageError("an order needs a word", remedy=_LIST)
    action = ACTIONS.get(words[0])
    if action is None:
        raise UsageError(
            f"there is no action called {words[0]!r}", remedy=f"actions: {', '.join(ACTIONS)}"
        )
    positional = [word for word in words[1:] if "=" not in word]
    named = dict(word.split("=", 1) for word in words[1:] if "=" in word)
    try:
        action.run(aircraft, positional, named)
    except UsageError:
        raise
    except (ValueError, TypeError) as error:
        raise UsageError(
            f"{action.name}: {error}", remedy=f"{action.name} {action.usage}"
        ) from error
    return action


def status(aircraft: VirtualAircraft) -> dict[str, Any]:
    """The state of an aircraft as JSON can carry it."""
    autopilot, vehicle = aircraft.autopilot, aircraft.vehicle
    flight, motion, authority = vehicle.flight, vehicle.flight.dynamics, vehicle.authority
    obstacle = authority.obstacle()
    active = vehicle.activation.active
    move = autopilot.received_movements[-1] if autopilot.received_movements else None
    statistics, line = autopilot.endpoint.statistics, aircraft.line
    return {
        "time": round(vehicle.time, 2),
        "firmware": autopilot.profile.name,
        "seed": aircraft.seed,
        "flight_status": flight.phase.name.lower(),
        "maneuver": flight.maneuver.value,
        "height": round(motion.height, 3),
        "north": round(motion.north, 3),
        "east": round(motion.east, 3),
        "velocity": [
            round(motion.velocity_north, 3),
            round(motion.velocity_east, 3),
            round(motion.velocity_up, 3),
        ],
        "heading_deg": round(vehicle.heading_deg, 1),
        "motors_on": motion.motors_on,
        "battery_percent": round(flight.battery_percent, 1),
        "gps_health": flight.gps_health,
        "rc_mode": aircraft.remote.sticks().mode.name,
        "rc_is_on": aircraft.remote.is_connected,
        "control": authority.device.name.lower(),
        "authority_obstacle": None if obstacle is None else obstacle.value,
        "app_connected": aircraft.app.is_connected,
        "app_has_internet": aircraft.app.has_internet,
        "activated_app": None if active is None else active.app_id,
        "task": None if flight.tasks.task is None else flight.tasks.task.name.lower(),
        "task_state": flight.tasks.state.name.lower(),
        "mission": vehicle.missions.summary(),
        "movements": autopilot.counters.movements,
        "last_movement": None if move is None else move.fields()["movement"],
        "ignored_movements": autopilot.counters.ignored_movements,
        "commands": statistics.commands,
        "repeated_commands": statistics.repeated_commands,
        "undecodable": autopilot.counters.undecodable,
        "frames_sent": line.to_host.frames,
        "frames_lost": line.to_host.lost + line.to_aircraft.lost,
        "plugged": line.is_plugged,
    }


# -- scenario files: what happens to an aircraft, and when -----------------------------------------
# TOML, one table per step, in any order; the words are those of this file::
#
#     [[step]]
#     at = 12.0                # seconds since power-on
#     do = "rc-mode P"
#
#     [[step]]
#     at = 20.0
#     do = ["faults loss=0.2", "gps 2"]
#
#     [[step]]
#     when = "waypoint 3"      # a mission first reaches its waypoint 3, counted from 0
#     after = 2.0              # seconds later; without it, at once
#     do = "rc-off"


_WAYPOINT = re.compile(r"[0-9]{1,6}")
_EVENT = "waypoint"


@dataclass(frozen=True, slots=True)
class ScenarioStep:
    """One order and when it is due."""

    at: float  # seconds since power-on, or since the waypoint was reached
    order: str  # a line for :func:`~m100link.sim.orders.perform`
    # The waypoint whose reaching it waits for, None when the time alone decides.
    waypoint: int | None = None


class Scenario:
    """The steps of a scenario, in time; :meth:`advance` does those that are due."""

    def __init__(self, steps: list[ScenarioStep]) -> None:
        self.steps = sorted(
            (step for step in steps if step.waypoint is None), key=lambda step: step.at
        )
        self._done = 0
        # Steps whose waypoint was not reached yet, and how many arrivals were looked at.
        self._waiting = [step for step in steps if step.waypoint is not None]
        self._seen = 0

    @classmethod
    def read(cls, path: str | Path) -> Scenario:
        """Read a file.

        Raises ``UsageError``: it is not there, is not TOML, or a step cannot be one.
        """
        try:
            content = read_toml(Path(path).read_bytes())
        except OSError as error:
            raise unread(path, error) from error
        except ValueError as error:
            raise UsageError(f"{path} is not TOML: {error}", remedy="mend that line") from error
        steps = content.get("step", [])
        if not isinstance(steps, list) or set(content) - {"step"}:
            raise UsageError(
                f"{path}: a scenario is a list of [[step]] tables",
                remedy='[[step]]\n      at = 12.0\n      do = "rc-mode P"',
            )
        read: list[ScenarioStep] = []
        for number, table in enumerate(steps, start=1):
            read += _read_step(table, f"{path}, step {number}")
        return cls(read)

    def advance(self, aircraft: VirtualAircraft) -> list[ScenarioStep]:
        """Do what is due by now; returns the steps that were done.

        Raises ``UsageError``: a step cannot be done, such as the app taking control out of F.
        """
        if self._waiting:
            self._look_at_arrivals(aircraft)
        done = []
        while self._done < len(self.steps):
            step = self.steps[self._done]
            if step.at > aircraft.vehicle.time + 1e-9:
                break
            self._done += 1
            perform(aircraft, step.order)
            aircraft.vehicle.log(f"scenario: {step.order}")
            done.append(step)
        return done

    def _look_at_arrivals(self, aircraft: VirtualAircraft) -> None:
        """Give a time to the steps whose waypoint was reached."""
        arrivals = aircraft.vehicle.missions.arrivals
        new = set(arrivals[self._seen :])
        self._seen = len(arrivals)
        for step in [step for step in self._waiting if step.waypoint in new]:
            self._waiting.remove(step)
            due = replace(step, at=aircraft.vehicle.time + step.at)
            insort(self.steps, due, lo=self._done, key=lambda each: each.at)


def _time(value: Any, name: str, place: str) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0 <= value < math.inf:
        raise UsageError(f"{place}: {name!r} is {value!r}", remedy="a number of seconds from 0")
    return float(value)


def _read_step(table: Any, place: str) -> list[ScenarioStep]:
    keys = set(table) if isinstance(table, dict) else set()
    if keys not in ({"at", "do"}, {"when", "do"}, {"when", "after", "do"}):
        raise UsageError(
            f"{place}: the keys are {', '.join(sorted(keys)) or 'missing'}",
            remedy="'do' (an order or a list), and 'at' (seconds since power-on) or "
            "'when' (\"waypoint 3\") with 'after' (seconds) if that is not at once",
        )
    name = "at" if "at" in keys else "after"
    at, waypoint = _time(table.get(name, 0.0), name, place), None
    if "when" in keys:
        words = str(table["when"]).split()
        if len(words) != 2 or words[0] != _EVENT or not _WAYPOINT.fullmatch(words[1]):
            raise UsageError(f"{place}: 'when' is {table['when']!r}", remedy='when = "waypoint 3"')
        waypoint = int(words[1])
    orders = table["do"]
    orders = [orders] if isinstance(orders, str) else orders
    if not isinstance(orders, list) or not all(isinstance(order, str) for order in orders):
        raise UsageError(f"{place}: 'do' is {orders!r}", remedy="an order or a list of orders")
    for order in orders:
        words = order.split()
        if not words or words[0] not in ACTIONS:
            raise UsageError(
                f"{place}: there is no action called {order!r}",
                remedy=f"actions: {', '.join(ACTIONS)}",
            )
    return [ScenarioStep(at, order, waypoint) for order in orders]


# -- orders from another shell: a Unix socket that takes lines of JSON -----------------------------
# A request is ``{"aircraft": 0, "order": ["rc-mode", "P"]}``, the answer is
# ``{"ok": true, "status": {...}}`` or ``{"ok": false, "error": "..."}``. The socket of each process
# stands in a directory that belongs to its user.


_LIMIT = 65_536


def socket_directory() -> Path:
    """Where the sockets of this user's simulators are."""
    base = os.environ.get("XDG_RUNTIME_DIR")
    if base and Path(base).is_dir():
        return Path(base) / "m100link"
    return Path(tempfile.gettempdir()) / f"m100link-{os.getuid()}"


def find_sockets() -> list[Path]:
    """Sockets of simulators that run; what dead ones left is removed."""
    found = []
    for path in sorted(socket_directory().glob("sim-*.sock")):
        with socket.socket(socket.AF_UNIX) as probe:
            probe.settimeout(1.0)
            try:
                probe.connect(str(path))
            except OSError:
                with contextlib.suppress(OSError):
                    path.unlink()
            else:
                found.append(path)
    return found


class CtlServer:
    """Takes orders for the aircraft of one process."""

    def __init__(self, aircraft: list[VirtualAircraft], path: Path | None = None) -> None:
        self._aircraft = aircraft
        self.path: Path | None = None  # on Windows, where nobody listens
        if hasattr(socket, "AF_UNIX"):
            self.path = path or socket_directory() / f"sim-{os.getpid()}.sock"
        self._server: asyncio.Server | None = None
        self._serving: dict[asyncio.Task[Any], asyncio.StreamWriter] = {}

    async def start(self) -> None:
        """Listen."""
        if self.path is None:
            return
        self.path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        with contextlib.suppress(FileNotFoundError):
            self.path.unlink()
        self._server = await asyncio.start_unix_server(
            self._serve, path=str(self.path), limit=_LIMIT
        )

    async def stop(self) -> None:
        """Stop listening and remove the socket."""
        if self._server is not None:
            await stop_listening(self._server)
            self._server = None
            for writer in self._serving.values():
                writer.close()
            if self._serving:
                await asyncio.wait(list(self._serving), timeout=1.0)
        with contextlib.suppress(OSError):
            if self.path is not None:
                self.path.unlink()

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        task = asyncio.current_task()
        assert task is not None
        self._serving[task] = writer
        try:
            while line := await reader.readline():
                writer.write(json.dumps(self.answer(line)).encode() + b"\n")
                await writer.drain()
                await asyncio.sleep(0)  # lines may wait in a row: what flies has its turn
        except (ValueError, ConnectionError):
            pass  # a line beyond the limit, or the other side is gone: nobody to tell
        finally:
            writer.close()
            with contextlib.suppress(OSError):
                await writer.wait_closed()
            del self._serving[task]

    def answer(self, line: bytes) -> dict[str, Any]:
        """Carry out one request."""
        try:
            request = read_json(line)
            index, order = request.get("aircraft", 0), request["order"]
            aircraft = self._aircraft[index]
            perform(aircraft, order)
        except UsageError as error:
            return {"ok": False, "error": str(error)}
        except (ValueError, KeyError, IndexError, TypeError, AttributeError) as error:
            return {"ok": False, "error": f"a request that makes no sense: {error!r}"}
        return {"ok": True, "status": status(aircraft)}


class NoSimulator(
    M100Error,
    code="M100-NO-SIMULATOR",
    cause="no virtual aircraft runs, or another user's",
    remedy="start one: `m100link sim`",
):
    """No simulator runs, or it is not clear which one is meant."""


def send_order(order: list[str], *, path: Path | None = None, aircraft: int = 0) -> dict[str, Any]:
    """Send one order to a running simulator and return its answer.

    ``path``: socket; by default that of the only simulator that runs. ``aircraft``: which aircraft
    of a process with several, from 0. Raises ``NoSimulator``: none runs, none answers in 5 s, or
    several run and ``path`` says nothing.
    """
    if not hasattr(socket, "AF_UNIX"):
        raise NoSimulator(
            "a simulator takes no orders from another shell on Windows",
            cause="they go through a Unix socket",
            remedy="give it a scenario: m100link sim --scenario FILE, or use the console",
        )
    if path is None:
        path = _only_socket()
    with socket.socket(socket.AF_UNIX) as connection:
        connection.settimeout(5.0)
        try:
            connection.connect(str(path))
            request = {"aircraft": aircraft, "order": order}
            connection.sendall(json.dumps(request).encode() + b"\n")
            with connection.makefile("rb") as answers:
                answer: dict[str, Any] = read_json(answers.readline(_LIMIT))
        except (OSError, ValueError) as error:
            raise NoSimulator(
                f"the simulator at {path} does not answer: {error}",
                remedy="start one with `m100link sim`",
            ) from error
    return answer


def _only_socket() -> Path:
    found = find_sockets()
    if not found:
        raise NoSimulator("no simulator runs", remedy="start one with `m100link sim`")
    if len(found) > 1:
        names = "".join(f"\n      --socket {path}" for path in found)
        raise NoSimulator("several simulators run", remedy=f"say which:{names}")
    return found[0]


# -- orders of the panel of the console ------------------------------------------------------------


class SimulatorOrders:
    """Gives orders to a virtual aircraft, and keeps its last state."""

    def __init__(
        self, give: Callable[[list[str]], Awaitable[dict[str, Any]]], shown: dict[str, Any]
    ) -> None:
        self._give = give
        # As :func:`status` has it, after the last order.
        self.status = shown

    async def give(self, *lines: str) -> None:
        """Carry out orders, each a line of text.

        Raises ``M100Error``: one cannot be carried out.
        """
        for line in lines:
            self.status = await self._give(shlex.split(line))


def orders_in_process(virtual: VirtualAircraft) -> SimulatorOrders:
    """Orders to a virtual aircraft of this process."""

    async def give(words: list[str]) -> dict[str, Any]:
        perform(virtual, words)
        return status(virtual)

    return SimulatorOrders(give, status(virtual))


async def orders_by_socket(path: Path) -> SimulatorOrders:
    """Orders to the virtual aircraft behind a socket of :class:`CtlServer`.

    Raises ``M100Error``: nobody answers there.
    """

    async def give(words: list[str]) -> dict[str, Any]:
        answer = await asyncio.to_thread(send_order, words, path=path)
        if not answer.get("ok"):
            raise UsageError(str(answer.get("error", "the order was refused")))
        shown: dict[str, Any] = answer["status"]
        return shown

    return SimulatorOrders(give, await give(["status"]))
