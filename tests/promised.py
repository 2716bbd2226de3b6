"""What is promised, as text: ``tests/promised.txt``, a line each.

Programs and scripts may rely on these: public names of the library with signatures and defaults,
verbs and options of the command line, codes of errors with their exit status, fields of JSON, and
versions on the wire. ``docs/project/compatibility.md`` says it in words.

``python -m tests.promised`` writes the file anew after a change, once a new line of CHANGELOG.md
in its newest section names each thing that changed.
"""

from __future__ import annotations

import enum
import importlib
import inspect
import re
import subprocess
import sys
from collections.abc import Collection, Iterable, Iterator
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, Union, get_args, get_origin

import m100link

ROOT = Path(__file__).parent.parent
FILE = Path(__file__).with_suffix(".txt")
CHANGES = ROOT / "CHANGELOG.md"

Promises = dict[str, str]
"""By name, what is promised of it."""

OF_ONE_RELEASE = ("m100link.apps.agent.", "m100link.apps.bus.")
"""Rooms that pages describe and that promise nothing: both ends are of one release."""

_UNIONS = (Union, UnionType)  # which Python 3.14 writes alike

_DOCUMENTED = re.compile(
    r"^\.\. auto(module|class|exception|function|data):: (m100link[\w.]*)", re.M
)


def read(text: str) -> Promises:
    """The promises of a file."""
    return dict(re.findall(r"^(.+?) := (.*)$", text, re.MULTILINE))


def written(promises: Promises) -> str:
    """The file with these."""
    return "".join(f"{name} := {promises[name]}\n" for name in sorted(promises))


# -- the library ----------------------------------------------------------------------------------


def library() -> Promises:
    """Names that the reference describes, with what their signatures say."""
    told: dict[int, tuple[str, Any]] = {}
    for name in documented():
        value = found(name)
        held = told.setdefault(id(value), (name, value))
        if len(name) < len(held[0]):  # under the name that users import
            told[id(value)] = name, value
    return {
        key: text
        for name, value in told.values()
        for key, text in described(name, value, told.keys())
    }


def documented() -> Iterator[str]:
    """As the pages write them."""
    yield from (f"m100link.{name}" for name in m100link.__all__ if not name.startswith("_"))
    for page in sorted((ROOT / "docs" / "reference").glob("*.md")):
        for kind, name in _DOCUMENTED.findall(page.read_text(encoding="utf-8")):
            if f"{name}.".startswith(OF_ONE_RELEASE):
                continue
            if kind == "module":
                yield from (f"{name}.{one}" for one in public(importlib.import_module(name)))
            else:
                yield name


def public(module: Any) -> Iterable[str]:
    """The names of a module that a page describes as a whole."""
    own = (
        name
        for name, value in vars(module).items()
        if not name.startswith("_") and getattr(value, "__module__", "") == module.__name__
    )
    return getattr(module, "__all__", None) or own


def found(name: str) -> Any:
    """The value of this name."""
    module, _, last = name.rpartition(".")
    try:
        return getattr(importlib.import_module(module), last)
    except ModuleNotFoundError:
        return getattr(found(module), last)


def described(name: str, value: Any, others: Collection[int]) -> Iterator[tuple[str, str]]:
    """A name and its members, without those that it inherits from one of the others."""
    if not inspect.isclass(value):
        # crcmod makes a function with or without its extension in C, which have other arguments.
        is_ours = inspect.isroutine(value) and value.__module__.startswith("m100link")
        yield name, signature(value) if is_ours else constant(value)
        return
    line = [kind for kind in value.__mro__ if kind.__module__.startswith("m100link")]
    bases = ", ".join(base.__name__ for base in value.__bases__ if base is not object)
    made = any({"__init__", "__new__"} & vars(kind).keys() for kind in line)
    is_enum = isinstance(value, enum.EnumMeta)
    yield name, f"class({bases})" + (signature(value) if made and not is_enum else "")
    members: Promises = {}
    for kind in reversed(line):
        if kind is value or id(kind) not in others:
            members |= {one: member(value, one, what) for one, what in vars(kind).items()}
            hints = inspect.get_annotations(kind)
            members |= {one: named(hint) for one, hint in hints.items() if not is_enum}
    if isinstance(value, enum.EnumMeta):
        own: dict[str, Any] = dict(value.__members__)
        members |= {one: repr(each.value) for one, each in own.items()}
    for one, text in members.items():
        # No private name, no sentence for people, and what failures() has.
        if not one.startswith(("_", "usual_", "own", "error_code")):
            yield f"{name}.{one}", text


def member(kind: type, name: str, value: Any) -> str:
    """What is promised of one member."""
    if isinstance(value, property):
        return f"property{signature(value.fget)}"
    if isinstance(value, staticmethod | classmethod):
        return f"{type(value).__name__}{signature(getattr(kind, name))}"
    return signature(value) if callable(value) else constant(value)


def signature(value: Any) -> str:
    """Arguments with types and defaults, as they are written."""
    try:
        asked = inspect.signature(value)
    except (TypeError, ValueError):  # a union of types, or a class of another library
        return constant(value)
    words, star = [], False
    for one in asked.parameters.values():
        mark = {"VAR_POSITIONAL": "*", "VAR_KEYWORD": "**"}.get(one.kind.name, "")
        if one.kind is one.KEYWORD_ONLY and not star:
            words.append("*")
        star = star or one.kind in (one.KEYWORD_ONLY, one.VAR_POSITIONAL)
        hint = "" if one.annotation is one.empty else f": {named(one.annotation)}"
        default = "" if one.default is one.empty else f" = {constant(one.default)}"
        words.append(f"{mark}{one.name}{hint}{default}")
    back = asked.return_annotation
    makes = "" if inspect.isclass(value) or back is asked.empty else f" -> {named(back)}"
    begin = "async " if inspect.iscoroutinefunction(value) else ""
    return f"{begin}({', '.join(words)}){makes}"


def named(annotation: Any) -> str:
    """A type without modules and as every Python writes it."""
    if get_origin(annotation) in _UNIONS:
        parts = get_args(annotation)
        return " | ".join("None" if one is NoneType else named(one) for one in parts)
    text = getattr(annotation, "__forward_arg__", annotation)
    text = text if isinstance(text, str) else inspect.formatannotation(text)
    return re.sub(r"Optional\[(.*)\]", r"\1 | None", re.sub(r"\b(?:\w+\.)+(?=\w)", "", text))


def constant(value: Any) -> str:
    """A default or a constant; of what is no plain value, its type."""
    if get_origin(value) in _UNIONS:
        return named(value)
    if isinstance(value, enum.Enum):
        return f"{type(value).__name__}.{value.name}"
    shown = " ".join(repr(value).split())
    is_plain = " at 0x" not in shown and len(shown) <= 200 and not shown.startswith("<")
    return shown if is_plain or shown == "<factory>" else type(value).__qualname__


# -- the command line ------------------------------------------------------------------------------


def command_line() -> Promises:
    """Verbs with their arguments and options, and each option with types, defaults and verbs."""
    from m100link.apps.cli.app import app

    def verbs(above: Any, words: str) -> Iterator[tuple[str, Any]]:
        for name in above:
            if not name.startswith("-"):
                yield f"{words} {name}".lstrip(), above[name]
                yield from verbs(above[name], f"{words} {name}".lstrip())

    told: Promises = {}
    for verb, command in verbs(app, ""):
        if command.default_command is None:
            continue
        parts, options = list[str](), set[str]()
        for one in command.assemble_argument_collection(default_parameter=app.default_parameter):
            if one.children:  # a group of options, which stand for themselves
                continue
            default = one.field_info.default
            held = "" if default is inspect.Parameter.empty else f" = {constant(default)}"
            text = f"{', '.join(one.names)}: {named(one.hint)}{held}"
            if one.names[0].startswith("--"):
                options.add(one.names[0])
                told[f"option {text}"] = f"{told.get(f'option {text}', '')} {verb},".strip()
            else:
                parts.append(text)
        told[f"m100link {verb}"] = " ".join([*parts, *sorted(options)])
    return {name: text.rstrip(",") for name, text in told.items()}


# -- errors, and what goes over a wire -------------------------------------------------------------


def failures() -> Promises:
    """Codes of errors, and the exit status of each class."""
    from m100link.apps.cli.manual import error_classes
    from m100link.apps.cli.terminal import exit_code

    return {
        kind.error_code: f"{kind.__name__}, exit status {exit_code(kind.__new__(kind))}"
        for kind in error_classes()
    }


def wires() -> Promises:
    """Versions that both ends have to share, and the profiles of firmware."""
    from m100link.apps.agent.messages import VERSION
    from m100link.apps.fleet.payloads import VERSION as OF_FLEETS

    return {
        "version of the agent's messages": str(VERSION),
        "version of a fleet's messages": str(OF_FLEETS),
        "firmware profiles": " ".join(m100link.PROFILES),
    }


def promises() -> Promises:
    """All of them, as the code has them now."""
    return {**library(), **command_line(), **failures(), **wires()}


# -- a change, and the line that tells users of it -------------------------------------------------


def changes(before: Promises, now: Promises) -> list[str]:
    """Each name that came, went or says something else."""
    return sorted({name for name, _ in before.items() ^ now.items()})


def unnamed(before: Promises, now: Promises, log_before: str, log_now: str) -> list[str]:
    """Names that changed and that no new line of the change log has."""
    lines = set(newest(log_now)) - set(newest(log_before))
    words = set(re.findall(r"[\w-]+", "\n".join(lines)))
    return [
        name
        for name in changes(before, now)
        if not said(name, before.get(name, ""), now.get(name, "")) & words
    ]


def newest(log: str) -> list[str]:
    """The lines of the newest section: *Unreleased*, or a version that is being prepared."""
    found = re.search(r"\n## (?:Unreleased|\d.*)\n((?:.*\n)*?)(?=## |\Z)", log)
    return found[1].splitlines() if found else []


def said(name: str, before: str, now: str) -> set[str]:
    """Words of which a line for users has one: the name, or the options that its verb changes."""
    if name.startswith("option"):  # which verbs have it: one that comes or goes names itself
        verbs = set(before.split(", ")) ^ set(now.split(", "))
        return set(re.findall(r"--[\w-]+", name)) | {verb.split()[-1] for verb in verbs if verb}
    if name.startswith("m100link "):
        options = (set(re.findall(r"--[\w-]+", text)) for text in (before, now))
        if changed := set.symmetric_difference(*options):
            return changed
    return set(re.findall(r"[\w-]+", name)[-1:])


def committed(path: Path) -> str:
    """A file as the last commit has it; empty if it has none."""
    asked = ("git", "show", f"HEAD:{path.relative_to(ROOT)}")
    return subprocess.run(asked, cwd=ROOT, capture_output=True, text=True, check=False).stdout


def main() -> str | None:
    """Write the file; why it was not written."""
    before, now = read(committed(FILE)), promises()
    log = CHANGES.read_text(encoding="utf-8")
    if before and (missing := unnamed(before, now, committed(CHANGES), log)):
        return "CHANGELOG.md: no new line of its newest section names\n  " + "\n  ".join(missing)
    FILE.write_text(written(now), encoding="utf-8")
    return None


if __name__ == "__main__":
    sys.exit(main())
