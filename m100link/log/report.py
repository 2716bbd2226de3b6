"""A flight in sentences: the holder of control, each wish and its outcome, and how it ended."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import suppress
from operator import attrgetter
from typing import Any, NamedTuple, TypeVar

from m100link.errors.texts import printable
from m100link.log.channels import EVENT
from m100link.log.reading import FlightLog, Message, Packages
from m100link.log.story import FlightSummary
from m100link.protocol.firmware import FirmwareProfile, profile
from m100link.protocol.items import BY_RECORD
from m100link.protocol.records import Battery, Position, RemoteControl, Velocity
from m100link.protocol.setpoint import (
    ControlMode,
    Horizontal,
    ReceivedMove,
    ReferenceFrame,
    Vertical,
    Yaw,
)
from m100link.telemetry.integrity import MAX_TELEMETRY_AGE, has_fix
from m100link.telemetry.sample import Sample

R = TypeVar("R", bound=tuple[Any, ...])

_AT = attrgetter("at_s")
_LOOK_S = 0.05  # movement is looked into so often
_MOVES_M_S, _STILL_S = 0.3, 0.5  # faster, it moves; slower for so long, it stands still


class Odometry(NamedTuple):
    """The newest telemetry of a moment; None for a value that was not heard until then."""

    #: Place over ground, from the take-off point, or from the first place.
    north_m: float | None = None
    #: Place over ground, from the take-off point, or from the first place.
    east_m: float | None = None
    height_m: float | None = None  #: Above the take-off point.
    north_m_s: float | None = None  #: Velocity over ground.
    east_m_s: float | None = None  #: Velocity over ground.
    up_m_s: float | None = None  #: Velocity over ground.
    battery_percent: int | None = None  #: Charge.
    gps_health: int | None = None  #: 0 to 5; from 3 on the aircraft holds its place.

    def __str__(self) -> str:
        said = ("{:+z.1f} m north", "{:+z.1f} m east", "{:z.1f} m high", "{:+z.1f} m/s north",
                "{:+z.1f} m/s east", "{:+z.1f} m/s up", "battery {} %",
                "GPS health {}")  # fmt: skip
        known = zip(said, self, strict=True)
        return ", ".join(text.format(value) for text, value in known if value is not None)


class Sentence(NamedTuple):
    """Something that happened."""

    at_s: float  #: When, s after the beginning of the log; less than 0 for what was before it.
    #: Its subject, one of ``client``, ``lease``, ``control``, ``order``, ``setpoints``, ``plan``,
    #: ``limits``, ``journal``, ``text``, ``flight``, ``obeyed``, ``switch``, ``motion``, ``alarm``,
    #: ``sent`` or ``line``.
    kind: str
    who: str  #: The client or person that acted; empty where the log does not say it.
    text: str  #: The sentence.
    flown: Odometry = Odometry()  #: Place, velocity, battery and GPS of that moment.


def report(
    flight: FlightLog, story: FlightSummary, *, firmware: str | None = None
) -> list[Sentence]:
    """The sentences about a flight, in the order of time.

    Args:
        flight: The log. One of an earlier release has no names of clients.
        story: Its summary.
        firmware: Profile to read telemetry by; by default that of the flight.
    """
    first = next(flight.messages(), None)
    began_at = 0.0 if first is None else first.at
    notes = _NoteReader()
    found = list(happened(story))
    for message in flight.messages(EVENT):
        # Of another writer, or with a bit turned over: ours holds what is looked for.
        with suppress(ValueError, LookupError, TypeError, AttributeError):
            note = message.content()
            at_s = message.at - began_at - float(note.get("earlier_s", 0.0))
            for kind, who, text in notes.read(note):
                found.append(Sentence(at_s, kind, printable(who), printable(text)))
    known = flight.firmware if firmware is None else profile(firmware)
    telemetry = _TelemetryReader(story, known, sorted(found, key=_AT))
    for packages in flight.heard(firmware=known):
        if not isinstance(packages, Message):
            telemetry.hear(packages, began_at)
    return sorted(telemetry.end(), key=_AT)


def happened(story: FlightSummary) -> Iterator[Sentence]:
    """The sentences of a summary, in no order: those that need no notes."""
    for phase in story.phases:
        yield Sentence(phase.begin_s, "flight", "", f"The aircraft was in phase {phase.name}.")
    for owner in story.control:
        yield Sentence(owner.begin_s, "obeyed", "", f"The aircraft obeyed the {owner.name}.")
    for alarm in story.alarms:
        seconds = alarm.end_s - alarm.begin_s
        lasted = f" for {seconds:.1f} s" if seconds >= 0.1 else ""
        text = printable(f"Alarm {alarm.name}{lasted}: {alarm.text}.")
        yield Sentence(alarm.begin_s, "alarm", "", text)
    for command in story.commands:
        yield Sentence(command.at_s, "sent", "", printable(f"Sent to the aircraft: {command}."))
    for stream in story.streams:
        text = f"Sent for {stream.end_s - stream.begin_s:.1f} s: {stream.text}."
        yield Sentence(stream.begin_s, "sent", "", text)


class _TelemetryReader:
    """Adds the odometry of its moment to each sentence, and the sentences of telemetry alone."""

    def __init__(
        self, story: FlightSummary, firmware: FirmwareProfile | None, waiting: list[Sentence]
    ) -> None:
        self._frame, self._firmware = story.path.frame, firmware
        self._waiting, self._told = waiting, 0  # in order of time, and how many of them have it
        self._found: list[Sentence] = []
        self._newest: dict[type[Any], tuple[bytes, float]] = {}
        shown = (Position, Velocity, Battery, RemoteControl)
        self._bits = [(1 << BY_RECORD[one].bit, one) for one in shown]
        self._switch = ""
        self._motion: tuple[float, float, float] | None = None  # since, last at, s; way, m
        self._looked_at = -math.inf

    def hear(self, packages: Packages, began_at: float) -> None:
        """Packages in order of time; ``began_at``: clock of the first message of the log, s."""
        for value, received_at in packages:
            at = received_at - began_at
            self._tell(until=at)
            flags = value[0] | value[1] << 8
            for bit, record in self._bits:
                if flags & bit:
                    self._newest[record] = value, at
            if at - self._looked_at >= _LOOK_S:
                self._look(at)

    def end(self) -> list[Sentence]:
        self._tell(until=math.inf)
        if self._motion is not None:
            self._say(self._motion[1], "motion", "It was moving when telemetry ended.")
        return self._found

    def _tell(self, until: float) -> None:
        while self._told < len(self._waiting) and self._waiting[self._told].at_s < until:
            one = self._waiting[self._told]
            self._found.append(one._replace(flown=self._flown(one.at_s)))
            self._told += 1

    def _get(self, record: type[R], at: float, most_s: float = MAX_TELEMETRY_AGE) -> R | None:
        value, received_at = self._newest.get(record, (b"", -math.inf))
        if self._firmware is None or at - received_at > most_s:
            return None
        return Sample(value, self._firmware, received_at).get(record)

    def _flown(self, at: float) -> Odometry:
        flown = Odometry()
        position, velocity = self._get(Position, at), self._get(Velocity, at)
        battery = self._get(Battery, at, 1e9)
        if velocity is not None:
            north, east, up = velocity[:3]
            flown = flown._replace(north_m_s=north, east_m_s=east, up_m_s=up)
        if battery is not None:
            flown = flown._replace(battery_percent=battery.percent)
        if position is not None:
            flown = flown._replace(height_m=position.height_m, gps_health=position.gps_health)
            if self._frame is not None and has_fix(position):
                place = self._frame.to_local(position.latitude_deg, position.longitude_deg)
                flown = flown._replace(north_m=place[0], east_m=place[1])
        return flown

    def _look(self, at: float) -> None:
        """Note when it began to move, last moved, and how far it came; and the mode switch."""
        if at - self._looked_at > MAX_TELEMETRY_AGE and self._motion is not None:
            self._say(self._looked_at, "motion", "It was moving when telemetry fell silent.")
            self._motion = None
        self._looked_at = at
        remote, velocity = self._get(RemoteControl, at), self._get(Velocity, at)
        if remote is not None and remote.is_heard and remote.mode_switch.name != self._switch:
            self._switch = remote.mode_switch.name
            self._say(at, "switch", f"The pilot's mode switch was in {self._switch}.")
        if velocity is None:
            return
        speed = math.hypot(*velocity[:3])
        if speed >= _MOVES_M_S:
            if self._motion is None:
                self._say(at, "motion", "The aircraft began to move.")
            since, last, way = self._motion or (at, at, 0.0)
            self._motion = since, at, way + speed * min(at - last, MAX_TELEMETRY_AGE)
        elif self._motion is not None and at - self._motion[1] > _STILL_S:
            since, last, way = self._motion
            self._motion = None
            text = f"The aircraft stood still; it had moved {way:.1f} m in {last - since:.1f} s."
            self._say(last, "motion", text)

    def _say(self, at: float, kind: str, text: str) -> None:
        self._found.append(Sentence(at, kind, "", text, self._flown(at)))


class _NoteReader:
    def __init__(self) -> None:
        self._holder, self._limits = "", ""
        self._readers: dict[str, Callable[[dict[str, Any]], tuple[str, str]]] = {
            "client": self._client,
            "lease": self._lease,
            "control": self._control,
            "order": self._order,
            "setpoints": self._setpoints,
            "plan": self._plan,
            "state": self._state,
            "text": lambda note: (note["client"], note["text"] + "."),
            "journal": lambda note: ("", note["text"] + "."),
            "connection": self._connection,
        }

    def read(self, note: dict[str, Any]) -> Iterator[tuple[str, str, str]]:
        """Kind, actor and text; none for a note that adds nothing."""
        reader = self._readers.get(note["event"])
        if reader is None:
            return
        who, text = reader(note)
        if text:
            kind: str = note["event"]
            yield {"connection": "line", "state": "limits"}.get(kind, kind), who, text

    def _client(self, note: dict[str, Any]) -> tuple[str, str]:
        name = note["name"]
        why = note.get("reason") or "its connection ended"
        return name, f"{name} came." if note["is_there"] else f"{name} left: {why}."

    def _lease(self, note: dict[str, Any]) -> tuple[str, str]:
        before, self._holder = self._holder, note["holder"]
        if self._holder:
            whom = f" from {before}" if before and note["why"] == "taken over" else ""
            return self._holder, f"{self._holder} has the lease ({note['why']}{whom})."
        return before, f"{before} has the lease no more ({note['why']})." if before else ""

    def _control(self, note: dict[str, Any]) -> tuple[str, str]:
        if note["after"] == "held":
            return self._holder, f"Control authority was obtained for {self._holder or 'nobody'}."
        if note["before"] == "held":
            return self._holder, f"Control authority ended: {note['why']}."
        return "", ""

    def _order(self, note: dict[str, Any]) -> tuple[str, str]:
        who, what, stage = note["by"] or note["client"], note["order"], note["stage"]
        said = ", ".join(
            f"{name} {value}" for name, value in note.get("arguments", {}).items() if value != ""
        )
        what += f" ({said})" if said else ""
        if stage == "failed":
            return who, f"{who}'s order failed: {what}: {note['seen']}."
        ends = {"asked": " ordered", "accepted": "'s order began:", "done": "'s order ended:"}
        return who, f"{who}{ends[stage]} {what}."

    def _setpoints(self, note: dict[str, Any]) -> tuple[str, str]:
        who = note["by"] or note["client"]
        if note.get("stage") == "refused":
            return who, f"Setpoints of {who} were refused: {note['seen']}."
        one = note["setpoint"]
        horizontal, vertical, turn = (name.upper() for name in one["mode"].values())
        mode = ControlMode(Horizontal[horizontal], Vertical[vertical], Yaw[turn])
        frame = ReferenceFrame[one["frame"].upper()]
        wanted = ReceivedMove(mode, one["x"], one["y"], one["z"], one["yaw"], frame).in_words()
        return who, f"{who} began to send setpoints ({wanted})."

    def _plan(self, note: dict[str, Any]) -> tuple[str, str]:
        count, name = len(note["waypoints"]), note["name"]
        return name, f"{name} uploaded a plan of {count} waypoints." if count else ""

    def _state(self, note: dict[str, Any]) -> tuple[str, str]:
        words = {
            "max_height_m": "at most {:g} m high",
            "max_radius_m": "{:g} m from where control is obtained",
            "max_speed_m_s": "{:g} m/s",
            "battery_floor_percent": "battery at least {:g} %",
        }
        limits = note.get("limits", {})
        found = [
            said.format(limits[name])
            for name, said in words.items()
            if limits.get(name) is not None
        ]
        before, self._limits = self._limits, ", ".join(found) or self._limits
        return "", f"In force: {self._limits}." if self._limits != before else ""

    def _connection(self, note: dict[str, Any]) -> tuple[str, str]:
        seen = str(note.get("error") or "").partition("\n")[0]
        return "", "" if note["is_connected"] else f"The connection ended: {seen}."
