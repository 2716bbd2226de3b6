"""The user's configuration file: aircraft by name, and what holds for all of them.

Reading: :func:`read_configuration` gives a :class:`Configuration` of the file, checked; without a
file it is empty. :meth:`Configuration.sources` is what the file says of one aircraft, as the
weakest sources of :func:`m100link.apps.station.config.resolve`, which converts the values.
"""

from __future__ import annotations

import contextlib
import json
import math
import os
import re
import stat
import sys
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, fields
from difflib import get_close_matches
from pathlib import Path
from typing import Any

from m100link.apps.station.config import Settings
from m100link.errors import BadURL, UsageError
from m100link.errors.texts import read_path, read_toml
from m100link.link.keyfile import mode_of, replace_file
from m100link.link.url import EXAMPLES, parse_url
from m100link.protocol.firmware import PROFILES
from m100link.protocol.records import AccelerationMode
from m100link.telemetry.columns import ITEM_NAMES

FILE = "m100link.toml"

_OF_ALL = (
    *("firmware", "baud", "timeout", "acceleration"),
    *("app_id", "key_file", "level", "app_version", "bundle_id"),
)
_SEEN = "seen"
"""The findings of a first contact, beside the settings: a table that people read."""

_OF_ONE = ("url", _SEEN, *_OF_ALL)
_ELSEWHERE = ("url", "sim", "key", "token", "origins", "unused")
_OF_STATION = tuple(one.name for one in fields(Settings) if one.name not in _ELSEWHERE)
_PATHS = [one.name for one in fields(Settings) if str(one.type).startswith("Path")]
"""Beside the file, when they are not absolute."""

_SECRETS = {"key": "key_file", "token": "token_file"}
"""Secrets have no place in a file that users show and copy."""

_CALLED: dict[str, str] = {"baud": "baud_rate"}
"""The setting of a key, where it is not called so: keys are called as options are."""

_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_-]*")


@dataclass(frozen=True, slots=True, kw_only=True)
class Configuration:
    """The content of the file."""

    path: Path  # where it is, or would be
    exists: bool = False  # whether it is there
    default: str | None = None  # name of the default aircraft
    # Settings of every aircraft that is not a virtual one.
    defaults: Mapping[str, Any] = field(default_factory=dict)
    # Settings of one aircraft, by its name; ``url`` is always among them.
    aircraft: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    # Settings of ``serve`` and ``console``.
    station: Mapping[str, Any] = field(default_factory=dict)

    def sources(self, word: str | None) -> list[tuple[str, Mapping[str, Any]]]:
        """Settings of an aircraft by source, strongest first; ``url`` is what the word stands for.

        The defaults are a real aircraft's: they do not hold for ``sim://`` and ``replay://``.
        The word is a name or a URL; None: nobody says which.
        Raises BadURL: it is neither; the error lists names that are near.
        """
        name = self.default if word is None else word
        named = None if name is None else self.aircraft.get(name)
        found: list[tuple[str, Mapping[str, Any]]] = []
        if named is not None:
            settings = {one: value for one, value in named.items() if one != _SEEN}
            found.append((f"{shown(self.path)} [aircraft.{name}]", settings))
        elif word is not None:
            self._refuse_strange(word)
        url = word or "" if named is None else named["url"]
        if not url.startswith(("sim:", "replay:")):
            found.append((f"{shown(self.path)} [defaults]", self.defaults))
        return found

    def sources_of_station(self, word: str | None) -> list[tuple[str, Mapping[str, Any]]]:
        """The same for ``serve`` and ``console``, which have settings of their own."""
        return [(f"{shown(self.path)} [station]", self.station), *self.sources(word)]

    def _refuse_strange(self, word: str) -> None:
        try:
            parse_url(word)
        except BadURL as error:
            if "://" in word:
                raise
            examples = "".join(f"\n      {example}" for example in EXAMPLES)
            there = f", and {shown(self.path)} has no aircraft of that name" if self.exists else ""
            near = _near(word, self.aircraft)
            names = f"; it has {', '.join(self.aircraft)}" if self.aircraft and not near else ""
            raise BadURL(
                f"{error.seen}{there}{names}",
                remedy=f"{f'{near} Or ' if near else ''}write it like one of these:{examples}",
            ) from None


def configuration_path(
    environment: Mapping[str, str] | None = None, platform: str = sys.platform
) -> Path:
    """Where the file belongs: in XDG_CONFIG_HOME, else where the platform has such files."""
    environment = os.environ if environment is None else environment
    # The standard has a relative path there passed over.
    for variable in ("XDG_CONFIG_HOME", "APPDATA" if platform == "win32" else ""):
        folder = environment.get(variable, "")
        if Path(folder).is_absolute():
            return Path(folder) / FILE
    folders = {"darwin": "Library/Application Support", "win32": "AppData/Roaming"}
    return Path.home() / folders.get(platform, ".config") / FILE


def read_configuration(path: Path | None = None) -> Configuration:
    """The user's file, or an empty one. Raises UsageError: it is unsafe or wrong, and where."""
    path = configuration_path() if path is None else path
    try:
        with path.open("rb") as file:
            mode = mode_of(file)
            tables = read_toml(file.read())
    except FileNotFoundError:
        return Configuration(path=path)
    except (OSError, ValueError) as error:
        why = error.strerror if isinstance(error, OSError) else str(error)
        raise UsageError(
            f"{shown(path)} cannot be read: {why}", remedy="mend it, or let your account read it"
        ) from error
    if mode & stat.S_IWOTH:
        raise UsageError(
            f"{shown(path)} can be written by everybody (mode {mode:o})",
            cause="every user could change which aircraft a name means",
            remedy=f"chmod o-w {path}",
        )
    _check_keys(path, "", tables, ("defaults", "aircraft", "station"))
    defaults = _table(path, "defaults", tables.get("defaults", {}), ("aircraft", *_OF_ALL))
    named = _table(path, "aircraft", tables.get("aircraft", {}), None)
    aircraft = {}
    for name, table in named.items():
        check_name(path, name)
        aircraft[name] = _table(path, f"aircraft.{name}", table, _OF_ONE)
        if not isinstance(aircraft[name].get("url"), str):
            raise UsageError(
                f"{shown(path)} [aircraft.{name}]: no url says where it is",
                remedy='give it a url, such as url = "/dev/ttyUSB0"',
            )
    default = defaults.pop("aircraft", None)
    if default is not None and (not isinstance(default, str) or default not in aircraft):
        raise UsageError(
            f"{shown(path)} [defaults]: there is no aircraft {default!r}",
            remedy=_near(str(default), aircraft) or f"there are: {', '.join(aircraft) or 'none'}",
        )
    return Configuration(
        path=path,
        exists=True,
        default=default,
        defaults=defaults,
        aircraft=aircraft,
        station=_table(path, "station", tables.get("station", {}), _OF_STATION),
    )


def remember(
    configuration: Configuration,
    name: str,
    url: str,
    found: Mapping[str, str | Mapping[str, str]],
) -> None:
    """Write settings of an aircraft into the user's file; everything else in it stays as it is.

    ``name``: the aircraft, which the file may not have yet. ``found``: settings by their keys. A
    reader sees the file before the change or after it, whole. The file is read anew, for a person
    may have changed it since. Findings that are not among these stay, too.
    Raises UsageError: the name cannot be one, or the file cannot be changed so; it stays.
    """
    path = configuration.path
    check_name(path, name)
    added = [f"{key} = {_written(value)}" for key, value in found.items()]
    try:
        text, mode = "", 0o600
        with contextlib.suppress(FileNotFoundError):
            text, mode = path.read_bytes().decode(), stat.S_IMODE(path.stat().st_mode)
            if not mode & stat.S_IWUSR:
                raise PermissionError("it may be read only")
        wanted = read_toml(text)
        table = wanted.setdefault("aircraft", {}).setdefault(name, {"url": url})
        seen = found.get(_SEEN)
        if isinstance(seen, Mapping):
            found = {**found, _SEEN: {**table.get(_SEEN, {}), **seen}}
            added = [f"{key} = {_written(value)}" for key, value in found.items()]
        table.update(found)
        new = _with_lines(text, name, url, set(found), added)
        if read_toml(new) != wanted:
            raise ValueError("it is laid out in another way than m100link can change")
        path.parent.mkdir(parents=True, exist_ok=True)
        replace_file(path.resolve(), new.encode(), mode=mode)
    except (OSError, ValueError, TypeError, AttributeError) as error:
        raise UsageError(
            f"{shown(path)} was not changed: {error}",
            remedy=f"write this into its table [aircraft.{name}]: {'; '.join(added)}",
        ) from error


def _with_lines(text: str, name: str, url: str, keys: set[str], added: list[str]) -> str:
    """The text with these lines in the table of an aircraft, in the place of those keys."""
    end_of_line = "\r\n" if "\r\n" in text else "\n"
    lines = text.removesuffix(end_of_line).split(end_of_line) if text else []
    heads = [place for place, line in enumerate(lines) if line.startswith("[")]
    is_head = re.compile(rf"\[\s*aircraft\s*\.\s*\"?{name}\"?\s*\]\s*(#.*)?").fullmatch
    at = next((place for place in heads if is_head(lines[place])), None)
    if at is None:
        apart = [""] if lines else []
        lines += [*apart, f"[aircraft.{name}]", f"url = {json.dumps(url)}", *added]
    else:
        end = next((place for place in heads if place > at), len(lines))
        kept = [line for line in lines[at:end] if line.partition("=")[0].strip() not in keys]
        blank = next((n for n, line in enumerate(reversed(kept)) if line.strip()), 0)
        place = len(kept) - blank
        lines[at:end] = [*kept[:place], *added, *kept[place:]]
    return end_of_line.join(lines) + end_of_line


def _written(value: str | Mapping[str, str]) -> str:
    """A value as TOML has it: a text in quotes is written as in JSON."""
    if isinstance(value, str):
        return json.dumps(value)
    return f"{{ {', '.join(f'{key} = {json.dumps(one)}' for key, one in value.items())} }}"


def shown(path: Path) -> str:
    """The path as people write it."""
    try:
        return f"~/{path.relative_to(Path.home())}"
    except ValueError:
        return str(path)


def _near(word: str, known: Iterable[str]) -> str:
    near = get_close_matches(word.lower(), list(known), n=3)
    return f"did you mean {' or '.join(near)}?" if near else ""


def _check_keys(path: Path, where: str, table: Mapping[str, Any], known: Iterable[str]) -> None:
    for name in table:
        if name in known:
            continue
        place = f"{shown(path)}{f' [{where}]' if where else ''}"
        if name in _SECRETS:
            raise UsageError(
                f"{place}: a {name} does not belong in this file",
                cause="`m100link config` shows this file, and users copy it with other settings",
                remedy=f"put it into a file of its own that only you can read, and give its path "
                f"as {_SECRETS[name]}",
            )
        raise UsageError(
            f"{place}: there is no {'setting' if where else 'table'} {name!r}",
            remedy=_near(name, known) or f"there are: {', '.join(known)}",
        )


def check_name(path: Path, name: str) -> None:
    """Raises UsageError: no aircraft of the file can be called so."""
    if not _NAME.fullmatch(name) or re.match(r"COM\d", name):
        raise UsageError(
            f"{shown(path)}: an aircraft cannot be called {name!r}",
            remedy="a letter, then letters, digits, - and _",
        )
    if name.lower() in ITEM_NAMES:
        raise UsageError(
            f"{shown(path)}: an aircraft cannot be called {name!r}: a telemetry item is",
            remedy="give it another name, such as its place or its number",
        )


def _table(path: Path, where: str, table: Any, known: Iterable[str] | None) -> dict[str, Any]:
    """A table of the file with its keys known and its numbers possible, as settings."""
    if not isinstance(table, dict):
        raise UsageError(
            f"{shown(path)}: {where} is no table", remedy=f"[{where}{'.NAME' * (known is None)}]"
        )
    if known is None:
        return table
    _check_keys(path, where, table, known)
    made: dict[str, Any] = {}
    for name, value in table.items():
        if why := _wrong(name, value):
            raise UsageError(f"{shown(path)} [{where}]: {name} cannot be {value!r}", remedy=why)
        if name in _PATHS and isinstance(value, str):
            value = path.parent / read_path(value)
        made[str(_CALLED.get(name, name))] = value
    return made


def _wrong(name: str, value: Any) -> str:
    """The value wanted instead; empty when it can be right."""
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    if name in ("baud", "baud_rate") and not (isinstance(value, int) and value >= 1):
        return "bits per second, such as 230400"
    if name == "timeout" and not (is_number and 0.0 < value < math.inf):
        return "seconds, above 0"
    if name == "firmware" and value not in PROFILES:
        return f"one of {', '.join(PROFILES)}, as text"
    if name == _SEEN and not isinstance(value, dict):
        return "a table, which m100link first-contact writes"
    if name == "acceleration" and value not in tuple(AccelerationMode):
        return f"one of {', '.join(AccelerationMode)}, as text"
    return ""
