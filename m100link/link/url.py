"""Connection strings."""

from __future__ import annotations

import math
import os
import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

from m100link.errors import BadURL

if TYPE_CHECKING:
    from pathlib import Path

DEFAULT_BAUD_RATE = 230_400
"""Rate of the document's launch file; the PC assistant can change it (errata 50)."""

EXAMPLES = (
    "serial:///dev/ttyUSB0:230400",
    "/dev/ttyUSB0",
    "tcp://192.168.1.5:7000",
    "sim://?firmware=3.1&seed=7",
    "replay://flight.mcap?speed=2",
)
LIKE_THESE = "write it like one of these:" + "".join(f"\n      {text}" for text in EXAMPLES)
"""The remedy that shows strings that work."""

_SECRET = re.compile(r"\b((?:key|app[-_]id)=)[^&]*", re.IGNORECASE)


@dataclass(frozen=True, slots=True)
class ConnectionString:
    """A parsed connection string."""

    scheme: str  #: ``serial``, ``tcp``, or the name of another transport.
    target: str  #: Device path, host, or whatever stands behind ``scheme://``.
    number: int | None = None  #: Baud rate or port number; None for other schemes.

    def __str__(self) -> str:
        if self.scheme == "serial":
            return f"{self.target} at {self.number} baud"
        number = "" if self.number is None else f":{self.number}"
        # This is what errors and logs show, and the options of a virtual aircraft may have its key.
        target = _SECRET.sub(r"\1…", self.target)
        return f"{self.scheme}://{target}{number}"


def _bad(url: str, why: str, remedy: str = LIKE_THESE) -> BadURL:
    return BadURL(f"{url!r} {why}", remedy=remedy)


def parse_url(url: str, *, baud_rate: int | None = None) -> ConnectionString:
    """Read a connection string.

    Accepted: ``serial:///dev/ttyUSB0:230400``, a bare device path or ``COM3`` with an optional
    ``:baud`` or ``,baud`` behind it, ``tcp://host:port``, and ``name://…`` of any other transport.

    Args:
        url: The string.
        baud_rate: Rate when the string has none; 230400 by default.

    Raises:
        BadURL: It is none of these; the message shows some that work.
    """
    text = url.strip()
    scheme, separator, rest = text.partition("://")
    if not separator:
        if not re.match(r"(/|\./|\.\./|~|COM\d)", text):
            raise _bad(url, "names neither a device path nor a transport")
        scheme, rest = "serial", text
    if scheme == "serial":
        return _serial(url, rest, baud_rate or DEFAULT_BAUD_RATE)
    if scheme == "tcp":
        return _tcp(url, text)
    if not re.fullmatch(r"[a-z][a-z0-9+.-]*", scheme):
        raise _bad(url, "has no readable scheme before ://")
    return ConnectionString(scheme, rest)


def _serial(url: str, rest: str, baud_rate: int) -> ConnectionString:
    match = re.fullmatch(r"(?P<device>[^:,].*?)(?:[:,](?P<baud>[^:,/]*))?", rest)
    if match is None:
        raise _bad(url, "has no device")
    device, baud = match["device"], match["baud"]
    if baud is not None and device.startswith("/dev/serial/") and not baud.isdecimal():
        return ConnectionString("serial", rest, baud_rate)  # names by path have colons of their own
    if baud is not None:
        if not baud.isdecimal() or int(baud) == 0:
            raise _bad(url, f"has the baud rate {baud!r}, which is not a number above 0")
        baud_rate = int(baud)
    return ConnectionString("serial", device, baud_rate)


def _tcp(url: str, text: str) -> ConnectionString:
    from urllib.parse import urlsplit  # which no other connection needs

    try:
        parts = urlsplit(text)
        host, port = parts.hostname, parts.port
    except ValueError:
        raise _bad(url, "has no port number of 1 to 65535") from None
    if not host or not port:
        raise _bad(url, f"has no {'host' if not host else 'port number'}")
    return ConnectionString("tcp", host, port)


# -- recorded flights ------------------------------------------------------------------------------

SLOWEST, FASTEST = 0.1, 100.0
"""Times as fast as it was flown; besides them, infinity: as fast as it is taken."""

_REPLAY = "replay://"
_OPTIONS = ("speed", "from", "until")
_LIKE_THIS = f"write it like {_REPLAY}flight.mcap?speed=2&from=30&until=90"


class ReplayURL(NamedTuple):
    """A parsed ``replay://`` URL."""

    path: Path
    speed: float = 1.0  # times as fast as it was flown; infinity for max
    from_s: float = 0.0  # from where to where, seconds from its first byte
    to_s: float = math.inf


def parse_replay(url: str) -> ReplayURL:
    """Read a ``replay://`` URL: a path, and options behind a ``?``; ``BadURL`` if it is none."""
    from urllib.parse import parse_qsl, unquote  # which no line needs

    from m100link.errors.texts import read_path

    target = url.strip().removeprefix(_REPLAY)
    name, mark, options = target.rpartition("?")
    if not mark or ("=" not in options and options):
        name, options = target, ""
    if not name:
        raise _bad(url, "names no file", _LIKE_THIS)
    path = read_path(name)
    if "%" in name and not os.path.exists(path):
        path = read_path(unquote(name))
    values: dict[str, float] = {}
    for option, text in parse_qsl(options, keep_blank_values=True):
        if option not in _OPTIONS:
            raise _bad(
                url, f"has the option {option!r}; there are {', '.join(_OPTIONS)}", _LIKE_THIS
            )
        values[option] = _number(url, option, text)
    begin, end = values.get("from", 0.0), values.get("until", math.inf)
    if begin >= end:
        raise _bad(url, "ends before it begins", _LIKE_THIS)
    return ReplayURL(path, values.get("speed", 1.0), begin, end)


def _number(url: str, option: str, text: str) -> float:
    if option == "speed" and text == "max":
        return math.inf
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if option == "speed" and not SLOWEST <= value <= FASTEST:
        limits = f"{SLOWEST:g} to {FASTEST:g} or max"
        raise _bad(url, f"has the speed {text!r}, which is not {limits}", _LIKE_THIS)
    if not 0.0 <= value < math.inf:
        raise _bad(url, f"has {option}={text!r}, which is not a number of seconds", _LIKE_THIS)
    return value
