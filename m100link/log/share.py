"""A copy of a flight log for strangers: its place is moved, names and serial numbers are out.

The copy is made anew from a list of content that may be in it. Anything else stays out.
"""

from __future__ import annotations

import math
import re
import struct
from collections import Counter
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import fields
from typing import IO, Any

from m100link.errors import LayoutMismatch, UsageError
from m100link.geodesy import LocalFrame
from m100link.link import Direction
from m100link.link.statistics import LinkStatistics
from m100link.log.channels import COMMAND, EVENT, LINK, Entry
from m100link.log.reading import FlightLog, Message, profile_of
from m100link.log.recorder import Batch, LogWriter
from m100link.protocol import codes
from m100link.protocol.commands.monitor import PushTelemetry
from m100link.protocol.commands.registry import COMMANDS
from m100link.protocol.firmware import PROFILES, FirmwareProfile, profile
from m100link.protocol.items import BY_RECORD
from m100link.protocol.packet import fitting_profiles, plan_of
from m100link.protocol.records import AccelerationMode, Position
from m100link.telemetry.integrity import has_fix
from m100link.telemetry.sample import Sample
from m100link.wire import encode_frame
from m100link.wire.frame import Discard

_TARGETS = ((0.0, -30.0), (0.0, 150.0))  # degrees, in two oceans: one is far from everywhere
_FARTHEST_M = 30_000.0  # a place farther away would show how far the flight was moved
_POSITION = BY_RECORD[Position].bit
_ERROR = re.compile(r"M100-[A-Z-]{1,40}")
# All words that the library and its agent write into such fields. Whatever else stands there may be
# a name: a host in the reason of a lost connection, or a place in a note of the user's program.
_VOCABULARY = frozenset(
    """none|obtaining|contested|held|taken|paused|resuming|lost|releasing|unreleased|
    unknown|link|app|mode_switch|released|acquired|expired|taken over|its front has gone|
    in force|nothing|setpoints|guided flight|program|mission|no mission|waypoint mission|
    hotpoint|follow mission|IOC|asked|accepted|done|failed|refused|velocity|height|
    thrust|tilt|position_offset|angle|rate|ground|body|take_off|go_home|acquire lease|
    activate|ask take over|ask version|change of heading|change of height|confirm take over|
    flight around a place|flight to a place|fly pattern|go home|hover|land|obtain|
    order replay|pause mission|point gimbal|release|release lease|renew lease|
    reset hotpoint heading|resume mission|send to mobile|set hotpoint radius|
    set hotpoint rate|set mission speed|start hotpoint|start mission|start motors|stop|
    stop mission|stop motors|take off|turn gimbal|upload plan|use camera|
    a client with the lease asks for authority|the aircraft gave it|the aircraft refused it|
    not activated, no answer, or another error|a client gives it back, or the lease has ended|
    another client took the lease over|lost: the pilot left F|lost: nobody knows to whom|
    lost: the app took it|the link is gone|the mode switch is not in F|the mode switch is in F|
    the control block was left|the link was closed by this side|the connection ended""".replace(
        "\n    ", ""
    ).split("|")
) | {"", *(f"simple task {number}" for number in range(7))}
_ACKS = {
    one.name
    for kind in vars(codes).values()
    if isinstance(kind, type) and issubclass(kind, codes.AckCode)
    for one in kind
}
_COMMANDS = {kind.NAME for kind in COMMANDS.values()}
_COUNTED = {one.value for one in Discard} | {"counts", "total_s"}
_COUNTERS = {one.name for one in fields(LinkStatistics)} | {"log_dropped_bytes"}
_WORDS = ("before", "after", "why", "reason", "task", "pattern", "guided", "mission", "flown")
_SAID = ("order", "stage", "error", "horizontal", "vertical", "frame")
_MOVES = ("control_flag", "roll_or_x", "pitch_or_y", "throttle_or_z", "x", "y", "z")
_NUMBERS = ("number", "waypoint", "id", "lease", "left_out", "session", "sequence")
_LIMITS = ("max_height_m", "max_radius_m", "max_speed_m_s", "battery_floor_percent")
_FLAGS = ("is_there", "is_connected", "steered", "is_ack", "obtain", "stable")
_WORD_OR_NUMBER = float | str
_KEPT = {
    **dict.fromkeys((*_WORDS, *_SAID), str),
    **dict.fromkeys((*_MOVES, *_LIMITS, "earlier_s"), float),
    **dict.fromkeys(_NUMBERS, int),
    "yaw": _WORD_OR_NUMBER,
    **dict.fromkeys(_FLAGS, bool),
    **dict.fromkeys(("setpoint", "mode", "limits", "movement"), dict),
}
_NAMES = ("client", "by", "holder", "name")
_NOTED = ("clients", "journal", "mission", "text")
_EVENTS = ("authority", "connection", "client", "lease", "control", "order", "setpoints", "state")


class _Moved:
    """The places of a flight, moved: the first becomes a place in an ocean."""

    def __init__(self) -> None:
        self._frame: LocalFrame | None = None
        self._target = LocalFrame(*_TARGETS[0])

    def place(self, latitude_deg: float, longitude_deg: float) -> tuple[float, float]:
        if self._frame is None:
            self._frame = LocalFrame(latitude_deg, longitude_deg)
            is_near = abs(latitude_deg) < 30.0 and -60.0 < longitude_deg < 0.0
            self._target = LocalFrame(*_TARGETS[is_near])
        north, east = self._frame.to_local(latitude_deg, longitude_deg)
        if not abs(complex(north, east)) < _FARTHEST_M:
            north = east = 0.0
        return self._target.to_geodetic(north, east)


class _Cleaner:
    def __init__(self) -> None:
        self.moved = _Moved()
        self.removed: Counter[str] = Counter()
        self._names: dict[str, str] = {}

    def package(self, value: bytes, known: FirmwareProfile, at: float) -> bytes | None:
        """The value of a telemetry package elsewhere; None where it does not fit the profile."""
        try:
            items = plan_of(value, known).items
            position = Sample(value, known, at).get(Position)
        except (LayoutMismatch, IndexError):
            return None
        if position is None or _POSITION not in items:
            return value
        offset = items[_POSITION][0]
        if _has_place_elsewhere(value, offset, at):
            self.removed["packages of more than one layout"] += 1
            return None
        first = struct.unpack_from("<d", value, offset)[0]
        place = (0.0, 0.0)
        if has_fix(position):
            moved = self.moved.place(position.latitude_deg, position.longitude_deg)
            place = moved[0], moved[1]
        radians = [math.radians(one) for one in place]
        if first != position.latitude_rad:
            radians.reverse()
        self.removed["positions, moved"] += 1
        height = value[offset + 20 : offset + 24]  # also in the place of the altitude
        return value[:offset] + struct.pack("<2d", *radians) + height + value[offset + 20 :]

    def note(self, content: dict[str, Any]) -> dict[str, Any] | None:
        """An event without places, names and texts; None for one that is left out."""
        event = content["event"]
        if event == "plan":
            places = content["waypoints"]
            self.removed["places of plans, moved"] += len(places)
            moved = [[*self.moved.place(one[0], one[1]), float(one[2])] for one in places]
            return {"event": event, "name": self._name(content["name"]), "waypoints": moved}
        if event not in _EVENTS:
            self.removed[f"notes of {event if event in _NOTED else 'other events'}"] += 1
            return None
        if event == "connection" and content.get("error", "") not in _VOCABULARY:
            content = content | {"error": "the connection ended"}
        if content.get("seen"):
            content = content | {"seen": "left out"}
            self.removed["reasons in words"] += 1
        return {"event": event, "seen": content.get("seen", "")} | self._kept(content)

    def command(self, content: dict[str, Any]) -> dict[str, Any]:
        """A command with its movement and answer, without everything else."""
        name, ack = content.get("command"), content.get("ack")
        kept = {"command": name if name in _COMMANDS else "?"}
        kept["direction"] = "tx" if content.get("direction") == "tx" else "rx"
        if isinstance(ack, dict) and ack.get("name") in _ACKS:
            kept["ack"] = {"name": ack["name"]}
        self.removed["other fields of commands"] += 1
        return kept | {"is_ack": bool(content.get("is_ack"))} | self._kept(content)

    def counters(self, content: dict[str, Any]) -> dict[str, Any]:
        found = {name: content[name] for name in _COUNTERS if _is_counted(content.get(name))}
        firmware = content["firmware"] if content["firmware"] in tuple(PROFILES) else ""
        return found | {"firmware": firmware, "acceleration": AccelerationMode.FUSED.value}

    def _kept(self, content: dict[str, Any]) -> dict[str, Any]:
        found: dict[str, Any] = {}
        for name, value in content.items():
            kind: Any = _KEPT.get(name)
            if name in _NAMES:
                found[name] = self._name(value)
            elif kind is dict and isinstance(value, dict):
                found[name] = self._kept(value)
            elif _fits(kind, value):
                found[name] = value
            else:
                self.removed["fields of notes"] += name not in ("event", "seen")
        return found

    def _name(self, name: object) -> str:
        if not name:
            return ""
        self.removed["names, replaced"] += 1
        return self._names.setdefault(str(name), f"client {len(self._names) + 1}")


def _fits(kind: object, value: object) -> bool:
    """Whether a value is one that the library writes into such a field."""
    if isinstance(value, bool):
        return kind is bool
    if isinstance(value, str):
        is_known = value in _VOCABULARY or _ERROR.fullmatch(value) is not None
        return kind in (str, _WORD_OR_NUMBER) and is_known
    if isinstance(value, int):
        return kind in (int, float, _WORD_OR_NUMBER) and abs(value) < 1_000_000
    return kind in (float, _WORD_OR_NUMBER) and isinstance(value, float)


def _is_counted(value: object) -> bool:
    if isinstance(value, dict):
        return all(name in _COUNTED and _is_counted(one) for name, one in value.items())
    if isinstance(value, list):
        return all(map(_is_counted, value))
    return isinstance(value, int | float)


def _has_place_elsewhere(value: bytes, offset: int, at: float) -> bool:
    """Whether another firmware would send such a package, with a place at another offset."""
    for other in map(profile, fitting_profiles(value)):
        if plan_of(value, other).items[_POSITION][0] != offset:
            position = Sample(value, other, at).get(Position)
            if position is not None and has_fix(position):
                return True
    return False


def share(flight: FlightLog, stream: IO[bytes], *, firmware: str | None = None) -> dict[str, int]:
    """Write a copy for strangers: see :mod:`m100link.log.share`.

    Args:
        flight: The log.
        stream: A new file.
        firmware: Profile to read telemetry by; by default that of the flight.

    Returns:
        How often each kind of content was moved, replaced or left out.

    Raises:
        UsageError: The firmware was never known, and none is given; nothing of the log may be in a
            copy; mcap is not installed.
    """
    known = None if firmware is None else profile(firmware)
    for message in flight.messages(LINK) if known is None else ():
        known = profile_of(message) or known  # the last one
    if known is None:
        raise flight.nameless("--firmware 1.0")
    cleaner, log = _Cleaner(), LogWriter(stream, 10.0)
    first = next(flight.messages(), None)
    log.utc_offset_s = 0.0 if first is None else first.utc - first.at
    # The flight's own first place, for a plan that is noted before may be of another site.
    positions = (one.get(Position) for one in flight.samples(firmware=known))
    place = next((one for one in positions if one is not None and has_fix(one)), None)
    if place is not None:
        cleaner.moved.place(place.latitude_deg, place.longitude_deg)
    for one in flight.heard(COMMAND, EVENT, LINK, firmware=known):
        batch = Batch(profile=known, acceleration=AccelerationMode.FUSED)
        if isinstance(one, Message):
            batch.entries = [(one.at, entry) for entry in _entries(cleaner, one)]
        else:
            for value, at in one:
                if (moved := cleaner.package(value, known, at)) is not None:
                    data = bytes(PushTelemetry.ADDRESS) + moved
                    # Numbers would say that no frame was lost.
                    frame = encode_frame(data, session=0, sequence=0)
                    batch.chunks.append((Direction.RECEIVED, frame, at))
        log.write(batch)
    if not log.finish():
        raise UsageError(
            f"{flight.path} has nothing that a copy may have; nothing was written",
            remedy="name the log of a flight with telemetry",
        )
    return dict(cleaner.removed)


def _entries(cleaner: _Cleaner, message: Message) -> Iterator[Entry]:
    # Of another writer, or with a bit turned over: its content is unknown.
    with suppress(ValueError, LookupError, TypeError, AttributeError):
        content = message.content()
        if message.topic == EVENT:
            note = cleaner.note(content)
            if note is not None:
                yield EVENT, note
        elif message.topic == COMMAND:
            yield COMMAND, cleaner.command(content)
        else:
            yield LINK, cleaner.counters(content)
