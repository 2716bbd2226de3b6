"""The modules of ROS that a program imports, and how it is run.

``rospy``, ``actionlib``, ``tf`` and the like are made of the files beside this one; message
packages (``std_msgs.msg``, ``dji_sdk.srv``) of the types that the station speaks, and of the
``.msg``, ``.srv`` and ``.action`` files of packages around the program. A Python package of the
same name, such as ``dji_sdk/src/dji_sdk`` of DJI's node, is found as well.
"""

from __future__ import annotations

import importlib
import importlib.abc
import importlib.machinery
import importlib.util
import re
import sys
import time
import traceback
import types
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from m100link.apps.station.ros.messages import (
    MESSAGES,
    SERVICES,
    ServiceType,
    action_types,
    message_type,
    types_of,
)
from rospy_stand_in import dji_drone, node, python2
from rospy_stand_in.genpy import message_class, service_class
from rospy_stand_in.modules import FOLDERS, MADE, ROS_PACKAGES, copied

_DEPTH = 3  # folders below a workspace in which packages are looked for
_UP = 4  # folders above a program, one of which may be its package
_BUILTIN = re.compile(r"^(bool|byte|char|u?int(8|16|32|64)|float(32|64)|string|time|duration)$")


def run_program(
    program: Path,
    arguments: Sequence[str] = (),
    *,
    address: str = "",
    token: str = "",
    workspace: Path | None = None,
) -> None:
    """Run a program for rospy as ``__main__``, with its arguments.

    Raises ``SystemExit``: it ended itself, or by an error, whose traceback is printed.
    ``address`` and ``token``: of the station. ``workspace``: folder of its ROS packages; by default
    one above the program is found.
    """
    program = program.resolve()
    source = program.read_text(encoding="utf-8", errors="surrogateescape")
    is_old = python2.is_python2(source)
    folders = packages_of(program, workspace)
    FOLDERS.update(folders)
    read_types(folders)
    finder = Finder(folders, program.parent, is_old=is_old)
    sys.meta_path.insert(0, finder)
    sys.path[:0] = [str(program.parent), *(str(one / "src") for one in folders.values())]
    sys.argv = [str(program), *arguments]
    node.configure(address, token)
    if is_old:
        for module, name, value in (
            (sys, "maxint", sys.maxsize),
            (time, "clock", time.perf_counter),
        ):
            if not hasattr(module, name):
                setattr(module, name, value)
    main = types.ModuleType("__main__")
    main.__file__ = str(program)
    main.__dict__.update(python2.NAMES if is_old else {})
    sys.modules["__main__"] = main
    code = python2.compiled(source, str(program), is_old=is_old)
    try:
        exec(code, main.__dict__)
        node.wait_for_goals()
    except Exception as error:  # noqa: BLE001 - whatever the program raises
        error.__traceback__ = _of_program(error.__traceback__, str(program))
        traceback.print_exception(error)
        if isinstance(error, ModuleNotFoundError):
            sys.stderr.write(f"{_where_from(error)}\n")
        raise SystemExit(1) from None


def _of_program(trace: types.TracebackType | None, program: str) -> types.TracebackType | None:
    """The part of a traceback that the program knows."""
    while trace is not None and trace.tb_frame.f_code.co_filename != program:
        trace = trace.tb_next
    return trace


def _where_from(error: ModuleNotFoundError) -> str:
    """Where a module that is missing comes from."""
    package = str(error.name).partition(".")[0]
    lines = [one.line for one in traceback.extract_tb(error.__traceback__) if one.line]
    # The error names the package alone, the line of the program its part.
    is_of_ros = any(re.search(rf"\b{package}\.(msg|srv|cfg)\b", line) for line in lines)
    if is_of_ros or package in ROS_PACKAGES:
        return f"{package} is a package of ROS: name a folder that has it with --workspace"
    return f"{error.name} is a module of Python: install it into the environment of m100link"


# -- packages around a program ---------------------------------------------------------------------


def packages_of(program: Path, workspace: Path | None = None) -> dict[str, Path]:
    """The ROS packages that a program imports from, by name.

    They are that which it lies in, those of ``workspace``, and those beside its own.
    """
    found = {} if workspace is None else packages_in(workspace)
    for own in list(program.parents)[:_UP]:
        if (own / "package.xml").is_file():
            above = [one for one in own.parents if one.name == "src"][:1]
            return (found or packages_in(*above, own.parent)) | packages_in(own)
    return found


def packages_in(*folders: Path) -> dict[str, Path]:
    """The ROS packages in workspaces, by name: the folders with a ``package.xml``."""
    found: dict[str, Path] = {}
    for folder in folders:
        _look(folder, _DEPTH, found)
    return found


def _look(folder: Path, depth: int, found: dict[str, Path]) -> None:
    manifest = folder / "package.xml"
    try:
        if manifest.is_file():
            name = re.search(r"<name>\s*([\w-]+)\s*</name>", manifest.read_text(errors="replace"))
            if name:
                found.setdefault(name[1], folder)
            return
        inner = sorted(folder.iterdir()) if depth else []
        inner = [one for one in inner if one.is_dir() and not one.is_symlink()]
    except OSError:  # what may not be read is no package of this program
        return
    for one in inner:
        if not one.name.startswith("."):
            _look(one, depth - 1, found)


def read_types(folders: Mapping[str, Path]) -> None:
    """Know the types that packages define, unless the station has them.

    Raises ``SyntaxError``: a definition cannot be read.
    """
    messages, services = types_of(Path(__file__).with_name("types.txt"))
    for name, kind in messages.items():
        MESSAGES.setdefault(name, kind)
    for name, service in services.items():
        SERVICES.setdefault(name, service)
    for package, folder in folders.items():
        for path in sorted((folder / "msg").glob("*.msg")):
            name = f"{package}/{path.stem}"
            MESSAGES.setdefault(name, message_type(name, _definition(path.read_text(), package)))
        for path in sorted((folder / "srv").glob("*.srv")):
            name = f"{package}/{path.stem}"
            request, response = (_definition(one, package) for one in _parts(path, 2))
            halves = ((half, text) for half, text in (("request", request), ("response", response)))
            types_ = [message_type(f"{name} {half}", text) for half, text in halves]
            SERVICES.setdefault(name, ServiceType(name, *types_))
        for path in sorted((folder / "action").glob("*.action")):
            texts = [_definition(one, package) for one in _parts(path, 3)]
            for kind in action_types(f"{package}/{path.stem}", texts):
                MESSAGES.setdefault(kind.name, kind)


def _parts(path: Path, count: int) -> list[str]:
    parts = re.split(r"^-{3,}\s*$", path.read_text(errors="replace"), flags=re.M)
    if len(parts) != count:
        raise SyntaxError(f"{path} has {len(parts)} parts, {count} are needed")
    return parts


def _definition(text: str, package: str) -> str:
    """The text of a ``.msg`` file as ``types.txt`` writes it."""
    fields, constants = [], []
    for line in text.splitlines():
        line = line.partition("#")[0].strip()
        if not line:
            continue
        kind, _, rest = line.partition(" ")
        name, is_constant, value = rest.partition("=")
        if is_constant:
            value = value.strip()
            if kind != "string":
                shown = {"True": "1", "False": "0"}.get(value, value)
                constants.append(f"{name.strip()}={_number(shown)}")
            continue
        base, bracket, size = kind.partition("[")
        if base == "Header":
            base = "std_msgs/Header"
        elif not _BUILTIN.match(base) and "/" not in base:
            base = f"{package}/{base}"
        fields.append(f"{base}{bracket}{size} {rest.strip()}")
    return f"{', '.join(fields)} ; {' '.join(constants)}"


def _number(text: str) -> str:
    try:
        return str(int(text, 0))
    except ValueError:
        return str(float(text))


# -- modules ---------------------------------------------------------------------------------------


class Finder(importlib.abc.MetaPathFinder, importlib.abc.Loader):
    """Finds the modules of ROS, and those of the program that Python 3 cannot read."""

    def __init__(self, folders: Mapping[str, Path], own: Path, *, is_old: bool) -> None:
        self._folders, self._is_old = folders, is_old
        self._roots = [own, *folders.values()]
        self._packages = {name.partition("/")[0] for name in (*MESSAGES, *SERVICES)}

    def find_spec(
        self, fullname: str, path: Sequence[str] | None = None, target: object = None
    ) -> importlib.machinery.ModuleSpec | None:
        head, _, tail = fullname.partition(".")
        if fullname in MADE or (head in self._packages and tail in ("", "msg", "srv")):
            spec = importlib.machinery.ModuleSpec(fullname, self, is_package=tail == "")
            if not tail:
                spec.submodule_search_locations = self._places(head)
            return spec
        if fullname in python2.MODULES and self._is_old:
            return importlib.machinery.ModuleSpec(fullname, self)
        found = importlib.machinery.PathFinder.find_spec(fullname, path)
        if found is None and fullname == "dji_sdk.dji_drone":
            return importlib.machinery.ModuleSpec(fullname, self)
        if found is not None and self._is_of_program(found.origin):
            assert found.origin is not None
            found.loader = _ProgramLoader(fullname, found.origin, is_old=self._is_old)
            return found
        return None

    def _places(self, package: str) -> list[str]:
        """The folders of a Python package of the same name, which has modules of its own."""
        folder = self._folders.get(package)
        candidates = [] if folder is None else [folder / "src" / package, folder / package]
        return [str(one) for one in candidates if one.is_dir()]

    def _is_of_program(self, origin: str | None) -> bool:
        if origin is None or not origin.endswith(".py"):
            return False
        place = Path(origin).resolve()
        is_installed = "site-packages" in place.parts or "dist-packages" in place.parts
        return not is_installed and any(place.is_relative_to(root) for root in self._roots)

    def create_module(self, spec: importlib.machinery.ModuleSpec) -> types.ModuleType | None:
        """The module itself where it has another name here."""
        if spec.name == "dji_sdk.dji_drone":
            return copied(spec.name, vars(dji_drone))
        if spec.name in python2.MODULES:
            return importlib.import_module(python2.MODULES[spec.name])
        return None

    def exec_module(self, module: types.ModuleType) -> None:
        """Fill it."""
        name = module.__name__
        head, _, tail = name.partition(".")
        if name in MADE:
            module.__dict__.update(MADE[name]())
        elif tail == "msg":
            module.__dict__.update(_messages_of(head))
        elif tail == "srv":
            module.__dict__.update(_services_of(head))
        elif not tail and head in self._packages:
            # DJI's helper imports both, and programs rely on that.
            module.__dict__["__getattr__"] = partial(_part_of, head)
            for one in self._places(head):
                own = Path(one, "__init__.py")
                if own.is_file():
                    source = own.read_text(errors="surrogateescape")
                    code = python2.compiled(source, str(own), is_old=python2.is_python2(source))
                    exec(code, module.__dict__)


class _ProgramLoader(importlib.machinery.SourceFileLoader):
    """Loads a module of the program, of either Python."""

    def __init__(self, fullname: str, path: str, *, is_old: bool) -> None:
        super().__init__(fullname, path)
        source = Path(path).read_text(encoding="utf-8", errors="surrogateescape")
        self._source, self._is_old = source, is_old or python2.is_python2(source)

    def get_code(self, fullname: str) -> types.CodeType:
        """Not from a cache: that would be of Python 3."""
        code: types.CodeType = python2.compiled(self._source, self.path, is_old=self._is_old)
        return code

    def exec_module(self, module: types.ModuleType) -> None:
        """Run it, with the names of Python 2 where it is of that."""
        if self._is_old:
            module.__dict__.update(python2.NAMES)
        super().exec_module(module)


def _part_of(package: str, name: str) -> types.ModuleType:
    """A module of types, where a program has imported its package alone."""
    if name not in ("msg", "srv"):
        raise AttributeError(f"module {package!r} has no attribute {name!r}")
    return importlib.import_module(f"{package}.{name}")


def _messages_of(package: str) -> dict[str, Any]:
    names = [name for name in MESSAGES if name.startswith(f"{package}/")]
    found: dict[str, Any] = {name.partition("/")[2]: message_class(name) for name in names}
    return found | {"__all__": list(found)}


def _services_of(package: str) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for name in SERVICES:
        if name.startswith(f"{package}/"):
            kind, short = service_class(name), name.partition("/")[2]
            found |= {
                short: kind,
                f"{short}Request": kind._request_class,
                f"{short}Response": kind._response_class,
            }
    return found | {"__all__": list(found)}
