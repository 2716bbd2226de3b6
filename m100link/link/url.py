"""Connection strings."""

from __future__ import annotations

import re
from dataclasses import dataclass

from m100link.errors import BadURL

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
    """A parsed connection string.

    Attributes:
        scheme: ``serial``, ``tcp``, or the name of another transport.
        target: Device path, host, or whatever stands behind ``scheme://``.
        number: Baud rate or port number; None for other schemes.
    """

    scheme: str
    target: str
    number: int | None = None

    def __str__(self) -> str:
        if self.scheme == "serial":
            return f"{self.target} at {self.number} baud"
        number = "" if self.number is None else f":{self.number}"
        # This is what errors and logs show, and the options of a virtual aircraft may have its key.
        target = _SECRET.sub(r"\1…", self.target)
        return f"{self.scheme}://{target}{number}"


def _bad(url: str, why: str) -> BadURL:
    return BadURL(f"{url!r} {why}", remedy=LIKE_THESE)


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
