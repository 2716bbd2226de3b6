"""What the bytes of a line look like: an aircraft's, another program's, or no program's at all.

Pure: bytes go in, a description comes out.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import cache
from itertools import pairwise

from m100link.link.uart import read_inverted
from m100link.wire.frame import HEADER_SIZE, Frame, FrameDecoder
from m100link.wire.hunt import right_headers

__all__ = ["RATES", "Heard", "Likeness", "hear"]

RATES = (230_400, 115_200, 921_600, 460_800, 1_000_000, 57_600)
"""Baud rates that aircraft are found at, the commonest first."""

_SHOWN = 64
_LENGTH_MASK = 0x3FF
_FEW_CUT = 3
_START = b"\xaa"
_INVERTED_SIZE = 5  # bytes of an inverted frame that its length alone decides
_TEXT_SHARE = 0.9
_NMEA = re.compile(rb"\$(?:G[NPLAB]|BD)[A-Z]{3},")
_SERVER = re.compile(rb"HTTP/\d|SSH-\d")
_LOGIN = re.compile(rb"login:|password:|U-Boot|Linux version|systemd\[|\[ +\d+\.\d{6}\]", re.I)
_MAVLINK_STARTS = {0xFE: 8, 0xFD: 12}  # version: bytes of a frame beside its data


@dataclass(frozen=True, slots=True)
class Likeness:
    """What bytes without one valid frame look like.

    Attributes:
        name: One word for programs.
        seen: A sentence.
        causes: What it may come from, the likeliest first.
        commands: What to do.
    """

    name: str
    seen: str
    causes: tuple[str, ...]
    commands: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Heard:
    """What was on the line for a while.

    Attributes:
        data: Every byte.
        frames: Those with good checksums.
        discarded_bytes: Bytes that belong to no frame.
        discards: Why, by cause.
    """

    data: bytes
    frames: tuple[Frame, ...]
    discarded_bytes: int
    discards: dict[str, int]

    @property
    def damaged_share(self) -> float:
        """How much of it belongs to no frame, 0 to 1."""
        return self.discarded_bytes / len(self.data) if self.data else 0.0

    def count(self, address: bytes) -> int:
        """Frames of a command set and id, acks not counted."""
        return sum(not one.is_ack and one.data[:2] == address for one in self.frames)

    def details(self) -> dict[str, object]:
        """For programs, and for whoever reads a report."""
        return {
            "bytes": len(self.data),
            "frames": len(self.frames),
            "discarded_bytes": self.discarded_bytes,
            "discards": self.discards,
            "first_bytes": self.data[:_SHOWN].hex(" "),
        }

    def cut_frames(self) -> int:
        """Frames whose bytes end before their length says so: the next one begins in them."""
        starts = list(right_headers(self.data, 0, max(0, len(self.data) - HEADER_SIZE + 1)))
        return sum(after < at + _length(self.data, at) for at, after in pairwise(starts))

    def likeness(self) -> Likeness | None:
        """What it looks like; None for nothing known, which a wrong baud rate looks like."""
        for look in (_constant, _text, _mavlink, _inverted):
            found = look(self.data)
            if found is not None:
                return found
        return _cut(self.cut_frames())


def hear(data: bytes) -> Heard:
    """Look for frames in what a port gave."""
    decoder = FrameDecoder()
    frames = decoder.feed(data)
    whole = decoder.discarded_bytes  # what is cut off at the end is no damage
    frames += decoder.close()
    discards = {str(cause): count for cause, count in decoder.discards.items() if count}
    return Heard(data, tuple(frames), whole, discards)


def _length(data: bytes, at: int) -> int:
    """What the header there says that the frame's length is (document 1.3.1)."""
    return int.from_bytes(data[at + 1 : at + 3], "little") & _LENGTH_MASK


def _cut(count: int) -> Likeness | None:
    if count < _FEW_CUT:
        return None
    return Likeness(
        "cut",
        f"{count} frames begin well and end too early: bytes are missing",
        (
            "another program reads from this port, too, and gets the other bytes",
            "an adapter, radio or computer that is too slow, and loses bytes",
        ),
        (
            "m100link ports",
            "another adapter; lower the baud rate or the telemetry rates in the PC assistant",
        ),
    )


def _constant(data: bytes) -> Likeness | None:
    if len(set(data)) != 1:
        return None
    value = data[0]
    if value == 0:
        return Likeness(
            "held low",
            f"all {len(data)} bytes are 00",
            (
                "the line is held low: RX joined to ground, or a transmitter without power",
                "levels of RS-232, which are inverted",
            ),
            ("measure RX against ground: an idle line is at 3.3 V",),
        )
    return Likeness(
        "one value",
        f"all {len(data)} bytes are {value:02x}",
        ("no aircraft: something that repeats one byte, or a broken adapter",),
        ("join TX and RX of the adapter, nothing else connected, and run this again",),
    )


def _text(data: bytes) -> Likeness | None:
    printable = sum(32 <= byte < 127 or byte in b"\r\n\t\x1b" for byte in data)
    if printable < _TEXT_SHARE * len(data):
        return None
    shown = data[:40].decode("ascii", "replace").strip()
    if _NMEA.search(data):
        return Likeness(
            "a GPS receiver",
            f"it is NMEA text: {shown!r}",
            ("a GPS receiver is on this port, not the aircraft",),
            ("m100link ports", "choose the aircraft's port"),
        )
    if _SERVER.search(data):
        return Likeness(
            "a server",
            f"it is text: {shown!r}",
            ("another program listens there: a web server, or one for logins",),
            ("check host and port: the one where the aircraft's bytes are served",),
        )
    cause = (
        "a boot console or a login prompt of another computer, or of this one"
        if _LOGIN.search(data)
        else "another device that talks text"
    )
    return Likeness(
        "text",
        f"it is text: {shown!r}",
        (cause,),
        ("m100link ports", "switch that console off: m100link docs connect-hardware"),
    )


def _mavlink(data: bytes) -> Likeness | None:
    """Frames that follow each other by their lengths, three in a row."""
    for start, overhead in _MAVLINK_STARTS.items():
        at = data.find(start)
        while at >= 0:
            end, links = at, 0
            while links < 3 and end + 1 < len(data) and data[end] == start:
                end += data[end + 1] + overhead
                links += 1
            if links == 3 and (end >= len(data) or data[end] == start):
                return Likeness(
                    "MAVLink",
                    f"it is MAVLink {1 if start == 0xFE else 2}",
                    ("an autopilot that speaks MAVLink is on this port, not an M100",),
                    ("m100link ports", "choose the aircraft's port"),
                )
            at = data.find(start, at + 1)
    return None


@cache
def _inverted_starts() -> frozenset[bytes]:
    """How frames begin on an inverted line, for each length that an aircraft sends."""
    return frozenset(
        read_inverted(_START + bytes([length]) + bytes(6))[:_INVERTED_SIZE]
        for length in range(HEADER_SIZE + 1, 256)
    )


def _inverted(data: bytes) -> Likeness | None:
    starts = _inverted_starts()
    count = sum(
        data[at : at + _INVERTED_SIZE] in starts for at in range(len(data) - _INVERTED_SIZE)
    )
    if count < 3:
        return None
    return Likeness(
        "inverted",
        f"{count} frames are in it whose levels are inverted",
        (
            "an adapter for RS-232, or a radio or level shifter that inverts",
            "an FTDI adapter whose lines were set to inverted",
        ),
        ("use an adapter with 3.3 V TTL levels that does not invert",),
    )
