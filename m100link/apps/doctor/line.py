"""The stages at which bytes are listened to: do any arrive, and are they an aircraft's?"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, replace
from functools import cache
from itertools import pairwise

from m100link.apps.doctor.port import Ear, Finding, Stage, Verdict, failed, open_ear
from m100link.errors import LinkError, M100Error, UsageError
from m100link.link.requests import FIRST_BYTES_S
from m100link.link.serial_transport import read_inverted
from m100link.link.url import ConnectionString
from m100link.protocol.commands.activation import GetVersion
from m100link.protocol.commands.monitor import PushTelemetry
from m100link.protocol.firmware import FIRMWARE_1_0
from m100link.wire.frame import HEADER_SIZE, Frame, FrameDecoder, encode_frame, right_headers

LISTEN_S = 1.2
"""Seconds in which the slowest usual telemetry comes several times."""

ANSWER_S = 0.4
"""Seconds in which an answer to a version query comes, twice."""

SCAN_S = 0.5
"""Seconds at each other baud rate."""

_ENOUGH_FRAMES_SHARE = 0.5
"""Good frames below this share of the bytes may have been left in the port by somebody before."""

_LEFT_BEHIND = 8192
"""Bytes of frames that a port may hold from before: what its driver and the kernel keep."""

_PICKED_UP = 200
"""Bytes in the time of listening that a wire which is joined to nothing picks up."""

_DAMAGE = ("header_crc", "frame_crc")
_MOST_PIECES, _NOISE_SHARE, _DISCARDED_SHARE = 3, 0.02, 0.05
_SESSION, _SEQUENCE = 2, 0xD0C
_TELEMETRY = bytes(PushTelemetry.ADDRESS)
_QUERY = encode_frame(GetVersion().encode(FIRMWARE_1_0), session=_SESSION, sequence=_SEQUENCE)


async def look_at_line(address: ConnectionString) -> tuple[Finding, ...]:
    """Listen, and ask for the version to hear whether anything comes back.

    Opens the port, and closes it again. Ends with the first failure.

    Raises:
        UsageError: The options of a URL cannot be: that is no matter of the line.
    """
    try:
        ear = await open_ear(address)
    except UsageError:
        raise
    except M100Error as error:
        return (failed(Stage.OPENING, error),)
    opened = Stage.OPENING.good(str(address))
    try:
        heard = await _listen(ear)
        if not heard.data and address.scheme != "serial":
            heard = await _listen_on(ear)
        was_lost = ear.is_lost  # by the other side: closing it here comes next
    finally:
        await ear.close()
    if was_lost:
        return (opened, _went_away(address, ear))
    if not heard.data:
        return (opened, _silence(address))
    arrived = Stage.BYTES.good(
        f"{len(heard.data)} bytes in {LISTEN_S + 2 * ANSWER_S:g} s",
        details={"bytes": len(heard.data)},
    )
    if _is_echo(heard):
        return (opened, arrived, _echo(heard))
    if not heard.frames or _may_be_left_behind(heard):
        frames = await _no_frames(address, heard)
    else:
        frames = _frames(heard)
    if frames.verdict is Verdict.FAILED:
        return (opened, arrived, frames)
    return (opened, arrived, frames, _telemetry(heard))


async def _listen(ear: Ear, seconds: float = LISTEN_S) -> Heard:
    await ear.listen(seconds)
    for _ in range(2):
        ear.say(_QUERY)
        await ear.listen(ANSWER_S)
    return hear(bytes(ear.data))


async def _listen_on(ear: Ear) -> Heard:
    """The first bytes of a slow network may take seconds."""
    for _ in range(math.ceil(FIRST_BYTES_S / LISTEN_S)):
        await ear.listen(LISTEN_S)
        if ear.data:
            await ear.listen(LISTEN_S)
            break
    return hear(bytes(ear.data))


def _went_away(address: ConnectionString, ear: Ear) -> Finding:
    after = f" after {len(ear.data)} bytes" if ear.data else " at once"
    why = f": {ear.lost}" if ear.lost is not None else ""
    if address.scheme != "serial":
        return Stage.BYTES.failed(
            f"the other end closed the connection{after}{why}",
            (
                "the program that listens there has another client, and takes one only",
                "it has lost its aircraft",
            ),
            ("end the other client, or look at what that program says",),
        )
    return Stage.BYTES.failed(
        f"the port went away while it was listened to{after}{why}",
        ("the adapter was unplugged, lost power, or its cable has a bad contact",),
        ("plug it in again and look: dmesg | tail",),
    )


def _silence(address: ConnectionString) -> Finding:
    if address.scheme == "tcp":
        return Stage.BYTES.failed(
            "it is open, and not one byte comes",
            (
                "the program that listens there has no aircraft",
                "the aircraft has no power, or the wire from its TX carries nothing",
            ),
            ("run m100link doctor on the computer that the cable is plugged into",),
        )
    return Stage.BYTES.failed(
        f"not one byte in {LISTEN_S + 2 * ANSWER_S:g} s, and no answer to two version queries",
        (
            "TX and RX are swapped",
            "the aircraft has no power, or is still starting",
            "no common ground, or the wire from the aircraft's TX is broken",
            "another port than the aircraft's",
        ),
        (
            "swap TX and RX at one end, and run this again",
            "m100link ports",
            (
                "join TX and RX of the adapter, nothing else connected, and run this again: if "
                "that is silent, too, the adapter or its cable is broken"
            ),
        ),
    )


def _is_echo(heard: Heard) -> bool:
    """Whether the only frames are those that were sent."""
    asked = GetVersion().encode(FIRMWARE_1_0)
    return bool(heard.frames) and all(
        not one.is_ack and (one.session, one.sequence, one.data) == (_SESSION, _SEQUENCE, asked)
        for one in heard.frames
    )


def _echo(heard: Heard) -> Finding:
    return Stage.FRAMES.failed(
        "what was sent comes back, and nothing else",
        (
            (
                "TX and RX of this adapter are joined: adapter and cable are good, and no aircraft "
                "is connected"
            ),
            "the two wires touch each other",
        ),
        ("part them, and connect TX to the aircraft's RX and RX to its TX",),
        heard.details(),
    )


def _may_be_left_behind(heard: Heard) -> bool:
    """Whether the few frames among much else waited in the port: of another rate, or before."""
    good = len(heard.data) - heard.discarded_bytes
    return heard.damaged_share > _ENOUGH_FRAMES_SHARE and good <= _LEFT_BEHIND


async def _no_frames(address: ConnectionString, heard: Heard) -> Finding:
    seen = f"{len(heard.data)} bytes, and not one valid frame"
    if heard.frames:
        seen = (
            f"{heard.discarded_bytes} of {len(heard.data)} bytes are part of no frame; the "
            f"{len(heard.frames)} that are valid may have waited in the port"
        )
    likeness = heard.likeness()
    if likeness is not None:
        return Stage.FRAMES.failed(
            f"{seen}: {likeness.seen}",
            likeness.causes,
            likeness.commands,
            {**heard.details(), "likeness": likeness.name},
        )
    if len(heard.data) < _PICKED_UP and not heard.frames:
        return _picked_up(seen, heard)
    details = heard.details()
    if address.scheme == "serial" and address.number is not None:
        found = await _scan(address)
        details["rates_tried"] = [rate for rate in RATES if rate != address.number]
        if found is not None:
            place = f"{address.target}:{found}"
            return Stage.FRAMES.failed(
                f"{seen} at {address.number} baud; at {found} baud they are frames",
                (f"the aircraft is set to {found} baud in the PC assistant",),
                (f"m100link doctor {place}", f"or set {address.number} baud in the PC assistant"),
                {**details, "rate_found": found},
            )
        seen += f" at {address.number} baud, nor at any other usual rate"
    return Stage.FRAMES.failed(
        seen,
        (
            "noise: no common ground, wires along a motor cable, 5 V levels on a 3.3 V port",
            "a baud rate of its own: look into the PC assistant",
            "another device than an M100",
        ),
        (
            "check the ground wire, and that the adapter's levels are 3.3 V",
            f"the rate as the PC assistant shows it: m100link doctor {address.target}:RATE",
        ),
        details,
    )


def _picked_up(seen: str, heard: Heard) -> Finding:
    return Stage.FRAMES.failed(
        f"{seen}: an aircraft sends far more",
        (
            (
                "RX is joined to nothing and picks up noise: TX and RX are swapped, or the wire "
                "from the aircraft's TX is broken"
            ),
            "the aircraft has no power, or is still starting",
            "no common ground",
        ),
        (
            "swap TX and RX at one end, and run this again",
            "check the ground wire, and that the adapter's levels are 3.3 V",
        ),
        heard.details(),
    )


async def _scan(address: ConnectionString) -> int | None:
    for rate in RATES:
        if rate == address.number:
            continue
        try:
            ear = await open_ear(replace(address, number=rate))
        except LinkError:
            continue  # an adapter that does not know this rate
        try:
            heard = await _listen(ear, SCAN_S)
        finally:
            await ear.close()
        if heard.frames and heard.damaged_share < _ENOUGH_FRAMES_SHARE:
            return rate
    return None


def _frames(heard: Heard) -> Finding:
    good = len(heard.frames)
    seen = f"{good} frames with good checksums"
    damaged = sum(heard.discards.get(cause, 0) for cause in _DAMAGE)
    # A port that is opened in the middle of a frame has a piece of it at the beginning.
    few = damaged <= max(_MOST_PIECES, _NOISE_SHARE * good)
    if few and heard.damaged_share <= _DISCARDED_SHARE:
        return Stage.FRAMES.good(seen, details=heard.details())
    return Stage.FRAMES.doubtful(
        f"{seen}, and {damaged} damaged ones; {heard.discarded_bytes} of {len(heard.data)} bytes "
        "are part of no frame",
        (
            "noise: no common ground, wires along a motor cable, 5 V levels on a 3.3 V port",
            "a half-duplex radio that is busy with telemetry",
            "a cable that is too long for the baud rate",
        ),
        (
            "check the ground wire and keep the cable away from those of the motors",
            "lower the baud rate or the telemetry rates in the PC assistant",
        ),
        heard.details(),
    )


def _telemetry(heard: Heard) -> Finding:
    count = heard.count(_TELEMETRY)
    if count:
        return Stage.TELEMETRY.good(f"{count} packages of telemetry", details={"packages": count})
    if not any(one.is_ack for one in heard.frames):
        return Stage.TELEMETRY.doubtful(
            f"{len(heard.frames)} frames, and among them neither telemetry nor an answer",
            (
                "RX is joined to the TX of another computer, not to the aircraft's",
                "all telemetry rates are 0, and the aircraft does not hear this program",
            ),
            ("follow the wire from RX to the aircraft's TX",),
        )
    return Stage.TELEMETRY.doubtful(
        "answers come, and no telemetry",
        ("all telemetry rates are 0 in the PC assistant",),
        ("set them in the PC assistant; with firmware 3.1: m100link rates PORT attitude=50",),
    )


# -- what the bytes of a line look like: an aircraft's, another program's, or nobody's -------------
# Pure: bytes go in, a description comes out.


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
    """A kind of bytes without one valid frame, and its likely causes."""

    name: str  # one word for programs
    seen: str
    causes: tuple[str, ...]  # the likeliest first
    commands: tuple[str, ...]  # what to do


@dataclass(frozen=True, slots=True)
class Heard:
    data: bytes
    frames: tuple[Frame, ...]  # those with good checksums
    discarded_bytes: int  # bytes that belong to no frame
    discards: dict[str, int]  # why, by cause

    @property
    def damaged_share(self) -> float:
        """How much of it belongs to no frame, 0 to 1."""
        return self.discarded_bytes / len(self.data) if self.data else 0.0

    def count(self, address: bytes) -> int:
        """Frames of a command set and id, acks not counted."""
        return sum(not one.is_ack and one.data[:2] == address for one in self.frames)

    def details(self) -> dict[str, object]:
        """The values for programs, and for readers of a report."""
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
        """The kind of its bytes; None for none known, which a wrong baud rate looks like."""
        for look in (_constant, _text, _mavlink, _inverted):
            found = look(self.data)
            if found is not None:
                return found
        return _cut(self.cut_frames())


def hear(data: bytes) -> Heard:
    """Look for frames in the bytes of a port."""
    decoder = FrameDecoder()
    frames = decoder.feed(data)
    whole = decoder.discarded_bytes  # what is cut off at the end is no damage
    frames += decoder.close()
    discards = {str(cause): count for cause, count in decoder.discards.items() if count}
    return Heard(data, tuple(frames), whole, discards)


def _length(data: bytes, at: int) -> int:
    """The frame's length that the header there states (document 1.3.1)."""
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
    """How frames begin on an inverted line, for each length."""
    return frozenset(
        read_inverted(_START + bytes([length]) + bytes(6))[:_INVERTED_SIZE] for length in range(256)
    )


def _inverted(data: bytes) -> Likeness | None:
    starts = _inverted_starts()
    count = sum(data[at : at + _INVERTED_SIZE] in starts for at in range(len(data)))
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
