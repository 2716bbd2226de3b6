"""Options that verbs share, and options made from the library's own dataclasses.

A setting is declared once: its name, type and default as a field, its sentence in the docstring of
its class. :func:`options_of` makes a dataclass to derive from.
"""

from __future__ import annotations

import dataclasses
import inspect
import math
import re
from collections.abc import Callable, Iterable, Mapping
from functools import cache, partial
from typing import TYPE_CHECKING, Annotated, Any, Literal, get_type_hints

from cyclopts import App, Group, Parameter, validators

from m100link.apps.cli.terminal import shown_default
from m100link.protocol.firmware import PROFILES

if TYPE_CHECKING:
    Firmware = str
else:
    Firmware = Literal[tuple(PROFILES)]  # checkers want it spelt out, people want them all offered


def _above_0(_: object, value: float | None) -> None:
    if value is not None and not 0.0 < value < math.inf:
        raise ValueError("must be a number above 0")


Above0 = Parameter(validator=_above_0)
"""Seconds and rates: this refuses 0, negative numbers, NaN and infinity."""

Counted = Parameter(validator=validators.Number(gte=1))
"""A count: at least one."""

# -- options that several verbs have: one spelling and one sentence each ---------------------------

_DURATION = Parameter(validator=_above_0, help="Seconds until the command ends by itself.")
AtMost = Annotated[float | None, _DURATION]
Duration = Annotated[float, _DURATION]

Simulated = Annotated[Firmware, Parameter(help="Firmware of the virtual aircraft.")]

On = Annotated[bool, Parameter(negative_bool="no-")]  # on by default

Force = Annotated[bool, Parameter(help="Overwrite a file that exists.")]
Yes = Annotated[bool, Parameter(name=("--yes", "-y"), help="Do not ask for confirmation.")]
OUTPUT = Parameter(name=("--output", "-o"))


def group(name: str, text: str) -> App:
    """A verb that has verbs of its own."""
    return App(name=name, help=text, version_flags=())


def offered(candidates: Iterable[str] | Callable[[], Iterable[str]]) -> Any:
    """Words that a shell offers when Tab is pressed."""
    return Parameter(completer=lambda _: list(candidates() if callable(candidates) else candidates))


@cache
def attribute_texts(source: type) -> dict[str, str]:
    """The sentences of the docstring's section "Attributes", by attribute."""
    _, _, section = (inspect.getdoc(source) or "").partition("\nAttributes:\n")
    texts: dict[str, str] = {}
    name = ""
    for line in section.splitlines():
        begin = re.match(r"    (\w+): (.*)", line)
        if begin is not None:
            name = begin[1]
            texts[name] = begin[2]
        elif line.startswith("        ") and name:
            texts[name] += f" {line.strip()}"
        elif line.strip():
            break
    return texts


_hints = cache(get_type_hints)  # a station makes six sets of options of one class


def options_of(
    source: type,
    names: Iterable[str] | Mapping[str, str],  # a mapping has their names as options
    *,
    environment: Mapping[str, str] | None = None,
    called: Mapping[str, str] | None = None,
    defaults: Mapping[str, Any] | None = None,
    panels: Mapping[str, Group] | None = None,
    extras: Mapping[str, Any] | None = None,  # more annotations, by field
    is_layer: bool = False,
) -> Any:
    """A dataclass with an option for each of these fields.

    A layer is one of several sources: an option that was not given is None or empty. Another
    module reads the environment; the texts name its variables.
    """
    if isinstance(names, Mapping):
        called = {name: f"--{option}" for name, option in names.items()}
    texts, hints = attribute_texts(source), _hints(source)
    fields = {field.name: field for field in dataclasses.fields(source)}
    made = []
    for name in names:
        variable = (environment or {}).get(name)
        text = texts.get(name)
        if text is None:
            raise LookupError(f"Attributes of {source.__name__} has no line for {name}")
        kind, default = hints[name], (defaults or {}).get(name, fields[name].default)
        own = default
        # Only an option that is on, or that another source may switch on, can be switched off.
        is_switch = kind is bool and (is_layer or default) and not name.startswith("no_")
        if is_layer:
            is_tuple = isinstance(default, tuple)
            kind, default = (kind, ()) if is_tuple else (kind | None, None)
            if variable is not None:
                text = f"{text.removesuffix('.')} ({variable})."
        parameter = Parameter(
            name=(called or {}).get(name),
            help=text,
            negative_bool="no-" if is_switch else (),
            # A layer shows what holds if no source has a value.
            show_default=partial(lambda own, _: shown_default(own), own),
        )
        # A group that is None would hide the option.
        group = Parameter(group=panels[name]) if panels and name in panels else Parameter()
        extra = (extras or {}).get(name, Parameter())
        field = dataclasses.field(default=default)
        made.append((name, Annotated[kind, parameter, group, extra], field))
    return dataclasses.make_dataclass(f"{source.__name__}Options", made, frozen=True)
