"""Topics of a flight log, and the schemas of their messages.

Names and fields of ``foxglove.*`` are Foxglove's, so that its panels know them.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

from m100link.errors import BadAck, LayoutMismatch
from m100link.errors.texts import read_json
from m100link.protocol.command import Acknowledged, Command, Unrecognised
from m100link.protocol.commands.activation import Activate
from m100link.protocol.commands.monitor import PushTelemetry
from m100link.protocol.commands.registry import COMMANDS, address_of, parse_command
from m100link.protocol.firmware import FirmwareProfile
from m100link.protocol.records import Position
from m100link.telemetry.sample import AccelerationReader, Sample
from m100link.wire import Cipher, Frame, FrameDecoder

RX, TX = "/m100/raw/rx", "/m100/raw/tx"
"""The bytes as they were read and written: all messages of a topic joined are the whole stream."""

CHUNKS = "/m100/raw/chunks"
"""How the bytes of the raw message of the same time came: times and lengths of reads or writes."""

FIX, TELEMETRY = "/m100/fix", "/m100/telemetry"
COMMAND, EVENT, LINK = "/m100/command", "/m100/event", "/m100/link"

TRANSFORM, MESSAGE, STATE = "/tf", "/m100/log", "/m100/state"
"""The topics that a client that watches a flight gets live besides."""

Entry = tuple[str, dict[str, Any]]  # a topic, and a message on it


class Schema(NamedTuple):
    """The schema of the messages on a topic."""

    name: str
    text: str  # JSON schema


def _schema(called: str, /, **properties: dict[str, Any]) -> Schema:
    text = json.dumps(
        {"title": called, "type": "object", "properties": properties, "required": list(properties)}
    )
    return Schema(called, text)


_NUMBER, _TEXT = {"type": "number"}, {"type": "string"}
_WHOLE = {"type": "integer"}
_TIME = {
    "type": "object",
    "title": "time",
    "properties": {"sec": {"type": "integer", "minimum": 0}, "nsec": {"type": "integer"}},
    "required": ["sec", "nsec"],
}


def _numbers(*names: str) -> dict[str, Any]:
    return {
        "type": "object",
        "properties": dict.fromkeys(names, _NUMBER),
        "required": list(names),
    }


SCHEMAS = {
    CHUNKS: _schema(
        "m100.Chunks",
        direction={"type": "string", "enum": ["rx", "tx"]},
        offset_us={"type": "array", "items": _WHOLE},
        length={"type": "array", "items": _WHOLE},
    ),
    FIX: _schema(
        "foxglove.LocationFix",
        timestamp=_TIME,
        frame_id=_TEXT,
        latitude=_NUMBER,
        longitude=_NUMBER,
        altitude=_NUMBER,
        position_covariance={"type": "array", "items": _NUMBER},
        position_covariance_type=_WHOLE,
    ),
    TELEMETRY: _schema("m100.Telemetry", received_at=_NUMBER),
    COMMAND: _schema("m100.Command", command=_TEXT, is_ack={"type": "boolean"}),
    EVENT: _schema("m100.Event", event=_TEXT),
    LINK: _schema("m100.Link", firmware=_TEXT),
    TRANSFORM: _schema(
        "foxglove.FrameTransform",
        timestamp=_TIME,
        parent_frame_id=_TEXT,
        child_frame_id=_TEXT,
        translation=_numbers("x", "y", "z"),
        rotation=_numbers("x", "y", "z", "w"),
    ),
    MESSAGE: _schema(
        "foxglove.Log",
        timestamp=_TIME,
        level=_WHOLE,
        message=_TEXT,
        name=_TEXT,
        file=_TEXT,
        line=_WHOLE,
    ),
    STATE: _schema("m100.State", connection=_TEXT, has_authority={"type": "boolean"}, task=_TEXT),
}


# -- telemetry for the eye: a few rows a second, each with every item that came since the last -----


R = TypeVar("R", bound=tuple[Any, ...])


def row_of(sample: Sample) -> dict[str, float]:
    """The numbers of a package by their columns; a NaN stays one, which JSON tells as null."""
    return dict(zip(sample.columns, sample.row(), strict=True))


class Thinned(NamedTuple):
    """A row that the limiter lets through."""

    packages: list[Sample]  # those whose items are in the row; the last one is that which was due
    row: dict[str, float]  # its numbers by their columns, and when it was received

    def get(self, record: type[R]) -> R | None:
        """The newest record of that class, None when no package brought one."""
        found = (one.get(record) for one in reversed(self.packages))
        return next((one for one in found if one is not None), None)


class RateLimiter:
    """Lets some packages through.

    Items come at rates of their own: every tenth package may never have the battery. So a row
    begins with the items of the packages that were not let through, and ends with those of its own.
    """

    def __init__(self, interval_s: float) -> None:
        self._interval_s = 0.999 * interval_s  # between two rows, at least; 0: every package
        self._at = -math.inf
        self._packages: list[Sample] = []  # one for each item at most
        self._flags = 0

    def hear(self, value: bytes, profile: FirmwareProfile, now: float) -> Thinned | None:
        """Take a package, given by its value; returns a row when one is due.

        Packages that do not fit the profile are passed over: the link counts them.
        """
        is_due = now - self._at >= self._interval_s
        flags = int.from_bytes(value[:2], "little")
        if not is_due and not flags & ~self._flags:
            return None  # its items will come once more
        try:
            sample = Sample(value, profile, now)
        except (LayoutMismatch, IndexError):
            return None
        self._packages.append(sample)
        self._flags |= flags
        if not is_due:
            return None
        packages, self._packages, self._flags = self._packages, [], 0
        self._at = now
        row: dict[str, float] = {"received_at": now}
        for one in packages:
            row |= row_of(one)
        return Thinned(packages, row)


# -- values over time in few points, however long the flight: peaks and holes stay -----------------


_MOST_BUCKETS = 800


class Curve:
    """One value over time: its least and its largest in each of at most 800 spans.

    Args:
        gap_s: A pause longer than this leaves a hole.
    """

    __slots__ = ("_buckets", "_gap_s", "_width_s")

    def __init__(self, gap_s: float = 2.0) -> None:
        self._gap_s = gap_s
        self._width_s = 0.02
        # By number of the span: first and last time, and time and value of the least and largest.
        self._buckets: dict[int, tuple[float, float, float, float, float, float]] = {}

    def __len__(self) -> int:
        return len(self._buckets)

    def add(self, at_s: float, value: float) -> None:
        """A value later than those before it; a number that is not finite is passed over."""
        if not math.isfinite(value):
            return
        self._put(int(at_s / self._width_s), (at_s, at_s, at_s, value, at_s, value))
        if len(self._buckets) > _MOST_BUCKETS:
            self._width_s *= 2.0
            before, self._buckets = self._buckets, {}
            for bucket in before.values():
                self._put(int(bucket[0] / self._width_s), bucket)

    def _put(self, number: int, new: tuple[float, float, float, float, float, float]) -> None:
        old = self._buckets.get(number)
        if old is not None:
            least = new[2:4] if new[3] < old[3] else old[2:4]
            largest = new[4:6] if new[5] > old[5] else old[4:6]
            new = (old[0], new[1], *least, *largest)
        self._buckets[number] = new

    def points(self) -> Iterator[tuple[float, float]]:
        """Time, s, and value, in order; NaN stands in a hole."""
        last = math.inf
        for first, end, least_at, least, largest_at, largest in self._buckets.values():
            if first - last > max(self._gap_s, 2.0 * self._width_s):
                yield (first + last) / 2.0, math.nan
            both = sorted({(least_at, least), (largest_at, largest)})
            yield from both
            last = end


# -- a layout of panels for Foxglove and Lichtblick, for recorded flights and live ones ------------


def layout() -> dict[str, Any]:
    """Map, height, speed, battery, attitude and events for Foxglove and Lichtblick.

    ``/tf`` and ``/m100/log`` are there while a flight is watched, ``/m100/event`` in its log.
    """
    found: dict[str, Any] = read_json(Path(__file__).with_name("layout.json").read_bytes())
    return found


# -- the witness: reads what goes over a line as somebody else would, and says what it means -------


_TELEMETRY = bytes(PushTelemetry.ADDRESS)


def is_telemetry(frame: Frame) -> bool:
    """Whether the frame is a package of telemetry, whose value stands behind two bytes."""
    return frame.data.startswith(_TELEMETRY) and not frame.is_ack


def fix_of(position: Position) -> dict[str, Any]:
    """A position as ``foxglove.LocationFix``, without its time."""
    return {
        "frame_id": "m100",
        "latitude": position.latitude_deg,
        "longitude": position.longitude_deg,
        "altitude": position.altitude_m,
        "position_covariance": [0.0] * 9,
        "position_covariance_type": 0,  # unknown
    }


class FrameInterpreter:
    """Two decoders, one for each direction, and the requests.

    ``rate_hz``: telemetry at most so often; 0: every package. ``acceleration``: by which packages
    are read; a caller that knows the mode fixes it.
    """

    def __init__(self, rate_hz: float) -> None:
        self._sent, self._received = FrameDecoder(), FrameDecoder()
        self._thinning = RateLimiter(1.0 / rate_hz if rate_hz else 0.0)
        self.acceleration = AccelerationReader()
        # The requests by session and sequence; the answer does not say it. A number is used again
        # within 65536 requests, so there are never more.
        self._asked: dict[tuple[int, int, bool], type[Command]] = {}

    def sent(self, data: bytes, cipher: Cipher | None, profile: FirmwareProfile) -> Iterator[Entry]:
        """The messages in the bytes of a write."""
        self._sent.cipher = cipher
        for frame in self._sent.feed(data):
            yield from self._frame(frame, profile, is_ours=True)

    def received(
        self, data: bytes, now: float, cipher: Cipher | None, profile: FirmwareProfile
    ) -> Iterator[Entry]:
        """The messages in the bytes of a read."""
        self._received.cipher = cipher
        for frame in self._received.feed(data):
            if is_telemetry(frame):
                yield from self._telemetry(frame.data[2:], now, profile)
            else:
                yield from self._frame(frame, profile, is_ours=False)

    def _telemetry(self, value: bytes, now: float, profile: FirmwareProfile) -> Iterator[Entry]:
        if not self.acceleration.is_idle:
            value = self.acceleration.read(value, profile, now)
        thinned = self._thinning.hear(value, profile, now)
        if thinned is None:
            return
        yield TELEMETRY, thinned.row
        position = thinned.get(Position)
        if position is not None and position.is_possible:
            yield FIX, fix_of(position)

    def _frame(self, frame: Frame, profile: FirmwareProfile, *, is_ours: bool) -> Iterator[Entry]:
        if not frame.data:
            return
        head = {
            "is_ack": frame.is_ack,
            "direction": "tx" if is_ours else "rx",
            "session": frame.session,
            "sequence": frame.sequence,
        }
        exchange = frame.session, frame.sequence, frame.is_ack is not is_ours
        if frame.is_ack:
            yield COMMAND, head | self._answer(self._asked.get(exchange), frame.data)
            return
        address = address_of(frame.data)
        kind = COMMANDS.get(address) if address else None
        if kind is not None and frame.session:
            self._asked[exchange] = kind
        command = parse_command(frame.data, profile)
        if isinstance(command, Unrecognised):
            word = kind.NAME if kind else str(address)
            known: dict[str, Any] = {"command": word, "problem": command.reason}
            if kind is Activate:  # why it cannot be read may say what is in it
                known = {"command": word, "problem": "unreadable", "redacted": True}
        elif isinstance(command, Activate):
            known = {"command": command.name, "redacted": True}
        else:
            known = {"command": command.name, **command.fields()}
        yield COMMAND, head | known

    @staticmethod
    def _answer(asked: type[Command] | None, payload: bytes) -> dict[str, Any]:
        if asked is None or not issubclass(asked, Acknowledged):
            return {"command": "?", "data": payload.hex()}
        try:
            answer = asked.parse_ack(payload)
        except BadAck as error:
            return {"command": asked.NAME, "problem": error.seen}
        return {"command": asked.NAME, **asked.ack_fields(answer)}
