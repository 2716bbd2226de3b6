"""Launch files: which programs a package starts, with which names and parameters.

The nodes that are Python programs of the packages around the file run, each as a process. A node
that is none is named and left out: the station stands for DJI's.
"""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from rospy_stand_in import node
from rospy_stand_in.bridge import address_of
from rospy_stand_in.modules import FOLDERS
from rospy_stand_in.packages import packages_of
from rospy_stand_in.parameters import value_of
from rospy_stand_in.peers import PARAMETERS, sharing

_SUBSTITUTION = re.compile(r"\$\((\w+)\s*([^()]*)\)")
_STEP_S = 0.1


class LaunchError(ValueError):
    """A launch file that cannot be carried out; the text names the place."""


@dataclass
class _Started:
    """A node of a launch file."""

    program: Path
    name: str
    namespace: str
    arguments: list[str]
    parameters: dict[str, Any]


@dataclass
class _Scope:
    """Names that a group or an included file can use."""

    file: Path
    arguments: dict[str, str]
    namespace: str = "/"
    remaps: list[str] = field(default_factory=list)


class LaunchFile:
    """The nodes of a launch file. Raises ``LaunchError``: it cannot be carried out."""

    def __init__(self, file: Path, arguments: Sequence[str] = ()) -> None:
        given = dict(one.split(":=", 1) for one in arguments if ":=" in one)
        self.parameters: dict[str, Any] = {}
        self.nodes: list[_Started] = []
        self.left_out: list[str] = []  # nodes that are no Python programs
        self._given = given
        FOLDERS.update(packages_of(file))
        self._read(file, {})

    def _read(self, file: Path, arguments: dict[str, str]) -> None:
        try:
            root = ElementTree.parse(file).getroot()
        except (OSError, ElementTree.ParseError) as error:
            raise LaunchError(f"{file}: {error}") from None
        self._walk(root, _Scope(file, arguments))

    def _walk(self, parent: ElementTree.Element, scope: _Scope) -> None:
        for element in parent:
            found = {key: self._text(value, scope) for key, value in element.attrib.items()}
            if _is_off(found):
                continue
            if element.tag == "arg":
                self._argument(found, scope)
            elif element.tag == "group":
                inner = _Scope(
                    scope.file,
                    dict(scope.arguments),
                    _joined(scope.namespace, found.get("ns", "")),
                    list(scope.remaps),
                )
                self._walk(element, inner)
            elif element.tag == "include":
                self._include(element, found, scope)
            elif element.tag == "remap":
                scope.remaps.append(f"{found['from']}:={found['to']}")
            elif element.tag == "node":
                self._node(element, found, scope)
            else:
                self._parameter(element, found, scope, scope.namespace)

    def _argument(self, found: dict[str, str], scope: _Scope) -> None:
        name = found["name"]
        default = found.get("value", self._given.get(name, found.get("default")))
        if default is None and name not in scope.arguments:
            raise LaunchError(f"{scope.file} needs {name}:=value")
        if name not in scope.arguments:
            scope.arguments[name] = str(default)

    def _include(self, element: ElementTree.Element, found: dict[str, str], scope: _Scope) -> None:
        file = Path(found["file"])
        if not file.is_file():
            self.left_out.append(str(file))
            return
        passed = {
            one.attrib["name"]: self._text(one.attrib.get("value", ""), scope)
            for one in element.iter("arg")
        }
        self._read(file, passed)

    def _node(self, element: ElementTree.Element, found: dict[str, str], scope: _Scope) -> None:
        program = _program(found["pkg"], found["type"])
        name = found["name"]
        if program is None:
            self.left_out.append(f"{found['pkg']}/{found['type']}")
            return
        namespace = _joined(scope.namespace, found.get("ns", ""))
        own = _joined(namespace, name)
        remaps = list(scope.remaps)
        for one in element:
            inner = {key: self._text(value, scope) for key, value in one.attrib.items()}
            if one.tag == "remap":
                remaps.append(f"{inner['from']}:={inner['to']}")
            else:
                self._parameter(one, inner, scope, own)
        arguments = [*found.get("args", "").split(), *remaps, f"__name:={name}"]
        self.nodes.append(_Started(program, name, namespace, arguments, self.parameters))

    def _parameter(
        self, element: ElementTree.Element, found: dict[str, str], scope: _Scope, below: str
    ) -> None:
        if element.tag == "param":
            if "value" in found:
                value = value_of(found["value"])
                value = found["value"] if found.get("type") in ("str", "string") else value
            elif "textfile" in found:
                value = Path(found["textfile"]).read_text(encoding="utf-8")
            else:
                raise LaunchError(f"{scope.file}: param {found['name']} has no value")
            self.parameters[_joined(below, found["name"].lstrip("~"))] = value
        elif element.tag == "rosparam" and found.get("command", "load") == "load":
            text = element.text or ""
            if "file" in found:
                try:
                    text = Path(found["file"]).read_text(encoding="utf-8")
                except OSError as error:
                    raise LaunchError(f"{scope.file}: {error}") from None
            value = _yaml(text, scope.file)
            below = _joined(below, found.get("ns", ""))
            if "param" in found:
                self.parameters[_joined(below, found["param"])] = value
            else:
                for key, one in (value or {}).items():
                    self.parameters[_joined(below, str(key))] = one

    def _text(self, text: str, scope: _Scope) -> str:
        """With its substitutions, such as ``$(arg name)``."""

        def put(match: re.Match[str]) -> str:
            kind, rest = match[1], match[2].strip()
            if kind == "arg" and rest in scope.arguments:
                return scope.arguments[rest]
            if kind == "find" and rest in FOLDERS:
                return str(FOLDERS[rest])
            if kind == "dirname":
                return str(scope.file.parent)
            if kind == "anon":
                return f"{rest}_{os.getpid()}"
            name, _, default = rest.partition(" ")
            if kind in ("env", "optenv") and (kind == "optenv" or name in os.environ):
                return os.environ.get(name, default)
            if kind == "find":
                return f"/no package {rest}"
            raise LaunchError(f"{scope.file}: $({kind} {rest}) is not known here")

        return _SUBSTITUTION.sub(put, text)


def _is_off(found: dict[str, str]) -> bool:
    condition, unless = found.get("if", "true"), found.get("unless", "false")
    return condition.lower() in ("false", "0") or unless.lower() in ("true", "1")


def _joined(namespace: str, name: str) -> str:
    if name.startswith("/"):
        return name
    return f"{namespace.rstrip('/')}/{name}" if name else namespace


def _yaml(text: str, file: Path) -> Any:
    if find_spec("yaml") is None:
        raise LaunchError(f"{file}: its rosparam needs PyYAML: pip install pyyaml")
    return import_module("yaml").safe_load(text)


def _program(package: str, name: str) -> Path | None:
    """The Python program of a package, if the package is here and it is one."""
    folder = FOLDERS.get(package)
    found: Iterator[Path] = iter(()) if folder is None else folder.rglob(name)
    for one in found:
        if one.is_file():
            with one.open("rb") as source:
                first = source.readline()
            if one.suffix == ".py" or (first.startswith(b"#!") and b"python" in first):
                return one
    return None


def run_launch(
    file: Path, arguments: Sequence[str], command: Sequence[str], station: str = ""
) -> int:
    """Run the nodes of a launch file until they have ended; the worst exit status.

    ``command`` runs a program of rospy: its path and arguments follow. Raises ``LaunchError``.
    """
    launch, station = LaunchFile(file.resolve(), arguments), address_of(station)
    for one in launch.left_out:
        node.loginfo("%s is no Python program of a package here: it is not started", one)
    if not launch.nodes:
        raise LaunchError(f"{file} starts no Python program of the packages around it")
    environment = os.environ | {PARAMETERS: json.dumps(launch.parameters)}
    running = []
    for each in launch.nodes:
        node.loginfo("%s: %s", each.name, each.program)
        own = {"ROS_NAMESPACE": each.namespace.strip("/")}
        whole = [*command, str(each.program), *each.arguments]
        running.append(subprocess.Popen(whole, env=environment | own))
    with sharing(station, launch.parameters):
        try:
            while any(process.poll() is None for process in running):
                time.sleep(_STEP_S)
        except KeyboardInterrupt:  # the terminal interrupts them, too
            for process in running:
                process.send_signal(signal.SIGINT)
        return max(abs(process.wait()) for process in running)


def command_of(options: Sequence[str]) -> list[str]:
    """The command that runs a program of rospy with these options of its own."""
    return [sys.executable, "-u", str(Path(__file__).parents[1]), *options]
