"""Writes three modules beside it from the API with ``await``: they cannot lag behind.

    nox -s sync

It is in no wheel, and imports nothing of this folder, which may not load before it ran. A test
compares the files with its output. A coroutine becomes a call that waits; a function becomes a call
in the thread of the aircraft; a property is read. ``BY_HAND`` has the members that need more than
that, ``LEFT_OUT`` those without a place in a program without ``await``, with the reason.
"""

from __future__ import annotations

import ast
import builtins
import inspect
import re
import subprocess
import sys
import textwrap
import typing
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from types import FunctionType
from typing import Any

import m100link.aircraft.connecting
import m100link.flight.control
from m100link.aircraft import Aircraft
from m100link.aircraft.payload import AircraftCamera, AircraftGimbal
from m100link.flight.control import Control

FOLDER = Path(__file__).parent

HEAD = '''"""SUMMARY Written by ``nox -s sync``: do not edit.

It has the one with ``await`` and hands every call to the thread in which that lives.
"""

from __future__ import annotations

IMPORTS

__all__ = EXPORTS
'''

LEFT_OUT = {
    "aclose": "close() is the word here",
    "push": "for experts, who await",
    "virtual_rc": "its sticks are renewed twice a second by a program that awaits",
    "send_raw_move_as_expert": "for experts, who await",
}

AIRCRAFT_HEAD = '''
A = TypeVar("A")


class Aircraft:
    """A connected aircraft without ``await``. Get one from :func:`connect`.

    It lives in a thread of its own: telemetry is taken, setpoints are repeated and expire, and the
    stop path runs whatever the thread that called does meanwhile. May be used by several threads.
    """

    def __init__(self, portal: Portal, aircraft: aio.Aircraft) -> None:
        self._portal = portal
        self._aircraft = aircraft
        self.gimbal = AircraftGimbal(portal, aircraft.gimbal)
        self.camera = AircraftCamera(portal, aircraft.camera)
        SIGNALS.connected(portal)
        self.close = portal.close_after(aircraft.aclose, partial(SIGNALS.closed, portal))
        """End the control block that runs, then close the line. May be called again."""

    def __repr__(self) -> str:
        return repr(self._aircraft)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        exc_type: type[BaseException] | None,
        exc: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.close()

    @property
    def authority(self) -> Authority:
        """The state of control authority, as far as this program knows."""
        return self._aircraft.authority
'''

CONTROL_HEAD = '''
class Control:
    """Control of the aircraft without ``await``: ``with aircraft.control() as control:``.

    Leaving takes the stop path, after an error, Ctrl-C and SIGTERM too. The reason that would
    cancel a block with ``await`` is raised here by the call that waits, or by the next one.
    """

    def __init__(self, portal: Portal, control: aio.Control, *, handle_signals: bool) -> None:
        self._portal = portal
        self._control = control
        self._handles_signals = handle_signals

    def __repr__(self) -> str:
        return repr(self._control)

    def __enter__(self) -> Self:
        return self.obtain()

    def __exit__(
        self,
        exc_type: type[BaseException] | None,
        exc: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        try:
            self.release()
        except M100Error:
            if exc is None:
                raise

    @property
    def is_flying(self) -> bool:
        """Whether nothing has ended it."""
        return self._control.is_flying

    @property
    def is_over(self) -> bool:
        """Whether its stop path has ended."""
        return self._control.is_over

    def interrupt(self) -> None:
        """Begin the stop path without waiting for its end: for signal handlers, other threads."""
        self._portal.soon(self._control.interrupt)
'''

GIMBAL_HEAD = '''
class AircraftGimbal:
    """The gimbal of a connected aircraft, without ``await``: ``aircraft.gimbal``."""

    def __init__(self, portal: Portal, gimbal: payload.AircraftGimbal) -> None:
        self._portal = portal
        self._gimbal = gimbal

    def __repr__(self) -> str:
        return repr(self._gimbal)
'''

CAMERA_HEAD = '''
class AircraftCamera:
    """The camera of a connected aircraft, without ``await``: ``aircraft.camera``.

    **Sent, and nobody confirms**: no firmware says whether a picture was taken or a video runs.
    """

    def __init__(self, portal: Portal, camera: payload.AircraftCamera) -> None:
        self._portal = portal
        self._camera = camera
'''

TAIL = """
def connect(
CONNECT_PARAMETERS
) -> Aircraft:
CONNECT_DOC
    portal = Portal(clock_of(line))
    try:
        aircraft = portal.wait(lambda _: _connected(aio.connect(CONNECT_ARGUMENTS)))
    except BaseException:
        portal.close()
        raise
    return Aircraft(portal, aircraft)


async def _connected(connecting: aio.Connecting) -> aio.Aircraft:
    return await connecting
"""

TIMED = ("telemetry", "from_mobile", "events")
"""Members that a program iterates, here with a time-out."""

BY_HAND = {
    **{
        name: f"""
        subscription = self._portal.call(self._aircraft.{name}, ARGUMENTS)
        return Subscription(self._portal, subscription, timeout)
    """
        for name in TIMED
    },
    "control": """
        return Control(
            self._portal,
            self._portal.call(self._aircraft.control, ARGUMENTS),
            handle_signals=handle_signals,
        )
    """,
    "ticks": "return Ticks(self._portal, self._portal.call(self._control.ticks, ARGUMENTS))",
    "hold": "return Hold(self._portal, self._control.hold(ARGUMENTS))",
    "hold_angular_rates": """
        return GimbalRates(self._portal, self._gimbal.hold_angular_rates(ARGUMENTS))
    """,
    "follow": """
        self._portal.wait(
            lambda caller: self._control.follow(
                asked(caller, source, self._control.ticks(rate_hz)), ARGUMENTS
            )
        )
    """,
    "waypoint_mission": """
        return WaypointFlight(
            self._portal, lambda caller: self._control.waypoint_mission(ARGUMENTS)
        )
    """,
    "hotpoint": """
        return HotpointFlight(self._portal, lambda _: self._control.hotpoint(ARGUMENTS))
    """,
    "follow_target": """
        return FollowFlight(self._portal, lambda _: self._control.follow_target(ARGUMENTS))
    """,
    "obtain": """
        if self._handles_signals:
            SIGNALS.join(self)
        try:
            self._portal.wait(lambda _: self._control.obtain())
        except Exception:
            SIGNALS.leave(self)
            raise
        return self
    """,
    "release": """
        try:
            self._portal.wait(lambda _: self._control.release())
        finally:
            SIGNALS.leave(self)
    """,
}
"""Bodies of methods that do more than hand on."""

TYPES = {
    "AsyncIterator[Hold]": "Hold",
    "AsyncIterator[GimbalRates]": "GimbalRates",
    "Ticker": "Ticks",
    "TargetSource": "Target",
    "SetpointSource": "Callable[[Tick], Setpoint | None]",
}
"""Names here of the types with ``await``."""


def functions(cls: type) -> Iterator[tuple[str, Any]]:
    """The public members of a class in their order."""
    for name, member in vars(cls).items():
        if not name.startswith("_") and name not in LEFT_OUT:
            yield name, member


def definition(function: Callable[..., Any]) -> ast.FunctionDef | ast.AsyncFunctionDef:
    """The source of a function as a tree."""
    [node] = ast.parse(textwrap.dedent(inspect.getsource(inspect.unwrap(function)))).body
    assert isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)
    return node


@cache
def names_in(module: str) -> dict[str, Any]:
    """The names of a module, also those that it imports for type checkers alone."""
    names = dict(vars(sys.modules[module]))
    for node in ast.parse(inspect.getsource(sys.modules[module])).body:
        if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING":
            exec(compile(ast.Module(node.body, []), f"<{module}>", "exec"), names)
    return names


def without_await(text: str) -> str:
    """A docstring as it reads here."""
    for word, other in (
        (r"async (with|for)", r"\1"),
        (r"await asyncio\.sleep", "time.sleep"),
        (r"await ", ""),
        (r"aclose", "close"),
        (r"m100link\.connect", "m100link.sync.connect"),
        (r" \(when it is entered or awaited\)", ""),
        (r"; no asyncio, but trio", ""),
        (r"targets\(\)\) as mission:  # an async generator", "first) as mission:"),
        (r"Targets as they are known, [^;]*; or the first\n +one, to be", "The first one, to be"),
        (r"when the source ends, and when", "when"),
        (r"and returns a setpoint, or None to end;\n.*", "and returns a setpoint, or None to end."),
    ):
        text = re.sub(word, other, text)
    return text


def with_timeout(doc: str) -> str:
    """The docstring with the argument that iterating has here."""
    said = "    timeout: Seconds that iterating waits for a value; None: for ever."
    if "Args:\n" not in doc:
        return f"{doc}\n\nIterating waits up to ``timeout`` seconds for a value; None: for ever."
    before, after = doc.split("\n\nRaises", 1)
    return f"{before}\n{said}\n\nRaises{after}"


class Writer:
    """Collects what the file needs while its methods are written."""

    def __init__(self) -> None:
        self.used: dict[str, Any] = {}  # names in annotations and defaults, and what they are

    def note_names(self, node: ast.AST, namespace: dict[str, Any]) -> None:
        """Remember which names an expression uses."""
        for inner in ast.walk(node):
            if isinstance(inner, ast.Name) and inner.id in namespace:
                self.used[inner.id] = namespace[inner.id]

    def parameters(
        self, node: ast.FunctionDef | ast.AsyncFunctionDef, namespace: dict[str, Any]
    ) -> tuple[str, str]:
        """The parameters without ``self``, as text, and how they are handed on."""
        arguments = node.args
        if arguments.args and arguments.args[0].arg == "self":
            arguments.args.pop(0)
        for argument in [*arguments.args, *arguments.kwonlyargs]:
            assert argument.annotation is not None
            text = ast.unparse(argument.annotation)
            if text in TYPES:
                argument.annotation = ast.parse(TYPES[text], mode="eval").body
        for part in ast.walk(arguments):
            self.note_names(part, namespace)
        handed = [argument.arg for argument in arguments.args]
        if arguments.vararg:
            handed.append(f"*{arguments.vararg.arg}")
        for argument in arguments.kwonlyargs:
            is_callback = argument.arg == "progress"
            value = f"caller.callback({argument.arg})" if is_callback else argument.arg
            handed.append(f"{argument.arg}={value}")
        if arguments.kwarg:
            handed.append(f"**{arguments.kwarg.arg}")
        return ast.unparse(arguments), ", ".join(handed)

    def method(self, part: str, name: str, member: Any) -> str:
        """One method or property."""
        is_property = isinstance(member, property)
        function: Any = member.fget if isinstance(member, property) else member
        bare = inspect.unwrap(function)
        assert isinstance(bare, FunctionType)
        namespace, node = names_in(bare.__module__), definition(function)
        assert node.returns is not None
        returned = ast.unparse(node.returns)
        self.note_names(node.returns, namespace)
        returned = TYPES.get(returned, returned)
        doc = without_await(ast.get_docstring(node) or "")
        if name in TIMED:
            doc = with_timeout(doc)
        parameters, handed = self.parameters(node, namespace)
        if name in TIMED:
            seconds = ast.parse("float | None", mode="eval").body
            node.args.kwonlyargs.append(ast.arg("timeout", seconds))
            node.args.kw_defaults.append(ast.Constant(None))
            parameters = ast.unparse(node.args)
        if name == "follow":
            handed = handed.removeprefix("source, ")
        head = f"def {name}(self{', ' if parameters else ''}{parameters}) -> {returned}:"
        body = BY_HAND.get(name)
        if is_property:
            head, body = f"@property\n{head}", f"return self.{part}.{name}"
        elif body is None:
            is_waiting = isinstance(node, ast.AsyncFunctionDef) or inspect.iscoroutinefunction(
                function
            )
            caller = "caller" if "caller." in handed else "_"
            comma = ", " if handed else ""
            body = (
                f"return self._portal.wait(lambda {caller}: self.{part}.{name}({handed}))"
                if is_waiting
                else f"return self._portal.call(self.{part}.{name}{comma}{handed})"
            )
        body = textwrap.dedent(body.replace("ARGUMENTS", handed)).strip()
        body = body.replace(f"{name}, )", f"{name})")
        body = textwrap.indent(body, "    ")
        return textwrap.indent(f"{head}\n{as_docstring(doc)}\n{body}", "    ")

    def imports(self, written: str) -> str:
        """The imports for all that was used."""
        own = {name for names in FIXED_IMPORTS.values() for name in names.split(", ")}
        own |= {"A", "Control", "Aircraft"}  # what is declared here
        lines = {
            f"from {home(name, what)} import {name}"
            for name, what in self.used.items()
            if not hasattr(builtins, name) and name not in own and is_used(name, written)
        }
        for module, names in FIXED_IMPORTS.items():
            lines |= {
                f"from {module} import {name}"
                for name in names.split(", ")
                if is_used(name.split(" as ")[-1], written)
            }
        return "\n".join(sorted(lines))


def is_used(name: str, text: str) -> bool:
    """Whether a word is in a text."""
    return re.search(rf"\b{name}\b", text) is not None


FIXED_IMPORTS = {
    "collections.abc": "Callable",
    "functools": "partial",
    "types": "TracebackType",
    "typing": "Any, Self, TypeVar",
    "m100link.errors": "M100Error",
    "m100link.flight.missions.hotpoint": "Target",
    "m100link.flight.pacing": "Tick",
    "m100link.sync.portal": "Portal",
    "m100link.sync.signals": "SIGNALS",
    "m100link.sync.steering": "FollowFlight, GimbalRates, Hold, HotpointFlight, Ticks, "
    "WaypointFlight, asked",
    "m100link.sync.subscription": "Subscription",
}
"""The names that the text above uses, by their module."""


def home(name: str, what: Any) -> str:
    """The module that a name is imported from."""
    if getattr(typing, name, None) is what:
        return "typing"
    own = getattr(what, "__module__", "")
    if own and getattr(sys.modules.get(own), name, None) is what and own != "typing":
        return str(own)
    modules = [found for found in sorted(sys.modules) if found.startswith("m100link.")]
    holding = [module for module in modules if vars(sys.modules[module]).get(name) is what]
    declared = re.compile(rf"^{name}\b.* = ", re.MULTILINE)  # the others import it
    declaring = [m for m in holding if declared.search(inspect.getsource(sys.modules[m]))]
    for module in [*declaring, *holding]:
        return module
    raise LookupError(name)


def as_docstring(text: str) -> str:
    """Indented and quoted."""
    lines = f'"""{text}' + ('\n"""' if "\n" in text else '"""')
    return textwrap.indent(lines, "    ", lambda line: bool(line.strip()))


def aircraft_source() -> str:
    """The module of the aircraft, and of connecting to it."""
    writer = Writer()
    parts = [AIRCRAFT_HEAD]
    parts += [writer.method("_aircraft", name, member) for name, member in functions(Aircraft)]
    connect = definition(m100link.aircraft.connect)
    parameters, handed = writer.parameters(connect, dict(vars(m100link.aircraft.connecting)))
    tail = TAIL.replace("CONNECT_PARAMETERS", f"    {parameters},")
    tail = tail.replace("CONNECT_ARGUMENTS", handed)
    doc = without_await(ast.get_docstring(connect) or "")
    parts.append(tail.replace("CONNECT_DOC", as_docstring(doc)))
    exports = '["Aircraft", "connect"]'
    own = (
        "from m100link import aircraft as aio\n"
        "from m100link.flight.authority import Authority\n"
        "from m100link.sim.ports.driver import clock_of\n"
        "from m100link.sync.control import Control\n"
        "from m100link.sync.payload import AircraftCamera, AircraftGimbal\n"
    )
    return whole("The aircraft without ``await``.", exports, own, writer, parts)


def control_source() -> str:
    """The module of the control block."""
    writer = Writer()
    parts = [CONTROL_HEAD]
    parts += [
        writer.method("_control", name, member)
        for name, member in functions(Control)
        if name not in ("is_flying", "is_over", "interrupt")  # they stand in the head
    ]
    own = "from m100link.flight import control as aio\n"
    return whole("The control block without ``await``.", '["Control"]', own, writer, parts)


def payload_source() -> str:
    """The module of what hangs below."""
    writer = Writer()
    parts = [GIMBAL_HEAD]
    parts += [writer.method("_gimbal", name, member) for name, member in functions(AircraftGimbal)]
    parts.append(CAMERA_HEAD)
    parts += [writer.method("_camera", name, member) for name, member in functions(AircraftCamera)]
    own = "from m100link.aircraft import payload\n"
    exports = '["AircraftCamera", "AircraftGimbal"]'
    return whole("Gimbal and camera without ``await``.", exports, own, writer, parts)


def whole(summary: str, exports: str, own: str, writer: Writer, parts: list[str]) -> str:
    """A module."""
    body = "\n".join(parts)
    head = HEAD.replace("SUMMARY", summary).replace("EXPORTS", exports)
    return head.replace("IMPORTS", own + writer.imports(body)) + body


SOURCES = {
    "aircraft.py": aircraft_source,
    "control.py": control_source,
    "payload.py": payload_source,
}


def tidied(text: str) -> str:
    """Sorted and formatted as the rest of the project."""
    for arguments in (["check", "--select", "I", "--fix"], ["format"]):
        command = ["ruff", *arguments, "--quiet", f"--stdin-filename={FOLDER / 'aircraft.py'}", "-"]
        text = subprocess.run(
            command, input=text, capture_output=True, text=True, check=True, cwd=FOLDER.parents[1]
        ).stdout
    return text


if __name__ == "__main__":
    for name, made in SOURCES.items():
        (FOLDER / name).write_text(tidied(made()), encoding="utf-8")
