"""The summary of a flight: its phases, control authority, alarms, commands, maxima, curves."""

from __future__ import annotations

import math
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from m100link.errors import M100Error
from m100link.geodesy import LocalFrame, Track
from m100link.log.channels import COMMAND, EVENT, LINK, Curve
from m100link.log.reading import FlightLog, Message, Packages
from m100link.protocol.commands.control import Move
from m100link.protocol.firmware import FirmwareProfile, profile
from m100link.protocol.items import BY_RECORD
from m100link.protocol.records import (
    Attitude,
    Battery,
    ControlDevice,
    Device,
    FlightPhase,
    FlightStatus,
    Position,
    Velocity,
)
from m100link.protocol.setpoint import Horizontal, ReceivedMove, Vertical
from m100link.telemetry.integrity import (
    BATTERY_CRITICAL,
    BATTERY_LOW,
    GOOD_GPS,
    MAX_TELEMETRY_AGE,
    has_fix,
    is_low,
)
from m100link.telemetry.sample import Sample

# -- places of an aircraft, live or recorded -------------------------------------------------------


class HomePoint(NamedTuple):
    """A place of take-off: when, s, and where, degrees."""

    at_s: float
    latitude_deg: float
    longitude_deg: float


class FlightPath:
    """Where an aircraft flew and took off, live or recorded."""

    def __init__(self) -> None:
        self.track = Track()  #: metres over the first take-off, or over the first place before one
        self.homes: list[HomePoint] = []  #: the places of take-off, in order
        self.frame: LocalFrame | None = None  #: the plane of the track; None before any place
        self._is_off_ground = self._has_flown = False
        self._stood_once = False
        self._flights: list[tuple[float, float]] = []  # take-off and landing; infinite until then
        self._last: tuple[float, float] | None = None  # latitude and longitude, degrees

    def hear_phase(self, at_s: float, *, is_off_ground: bool) -> None:
        """It stands on the ground, or does not."""
        if is_off_ground and not self._is_off_ground and self._last is not None:
            if not self.homes:  # what was noted before was noise of the place
                self.frame, self.track = LocalFrame(*self._last), Track()
            self.homes.append(HomePoint(at_s, *self._last))
        if is_off_ground and not self._is_off_ground and self._stood_once:
            self._flights.append((at_s, math.inf))
        elif self._is_off_ground and not is_off_ground and self._flights:
            self._flights[-1] = self._flights[-1][0], at_s
        self._stood_once |= not is_off_ground
        self._is_off_ground = is_off_ground
        self._has_flown |= is_off_ground

    def airborne_s(self, at_s: float) -> float | None:
        """How long it has flown since the last take-off before that time, s; None: none was seen.

        Of a flight that is over, all of it.
        """
        begun = [flight for flight in self._flights if flight[0] <= at_s]
        return min(at_s, begun[-1][1]) - begun[-1][0] if begun else None

    @property
    def version(self) -> tuple[int, bool]:
        """Another one when the earlier places are void."""
        return self.track.thinned, bool(self.homes)

    def add(self, at_s: float, position: Position) -> tuple[float, float]:
        """Add a position with a fix; returns metres north and east in the track."""
        self._last = position.latitude_deg, position.longitude_deg
        if self.frame is None:
            self.frame = LocalFrame(*self._last)
        north, east = self.frame.to_local(*self._last)
        self.track.add(at_s, north, east, position.height_m)
        return north, east

    def home(self, at_s: float) -> HomePoint | None:
        """The take-off before a time, or else after it; where it stands, if it never flew."""
        known = [home for home in self.homes if home.at_s <= at_s] or self.homes[:1]
        if known or self._has_flown or self._last is None:
            return known[-1] if known else None
        return HomePoint(at_s, *self._last)

    def points(self, since: int = 0) -> list[tuple[float, float, float, float, bool]]:
        """The track without its first so many places, each with latitude and longitude, degrees."""
        frame, places = self.frame, self.track.places(since)
        if frame is None:
            return []
        return [
            (at, *frame.to_geodetic(*place), height, is_joined)
            for at, *place, height, is_joined in places
        ]


# -- what a flight's log tells beside telemetry: commands, answers, control, connection ------------


_STREAMS = {"move", "virtual_rc_data", "follow_target"}  # sent many times a second
_MOVE = b'"command":"move"'  # most commands are setpoints
_LOOKS = {"get_version", "query_task"}  # ask, and change nothing
_HEAD = {"is_ack", "direction", "session", "sequence", "command"}
_ASIDE = {"task_sequence", "redacted"}  # numbers that say nothing to anybody
_STREAM_GAP_S = 0.5
_STILL = b'"roll_or_x":0.0,"pitch_or_y":0.0,"throttle_or_z":0.0,"yaw":0.0'
_DRAWN_S = 0.1  # a setpoint is drawn so often
_CLOSED = "the link was closed by this side"


class Span(NamedTuple):
    """Something that lasted."""

    name: str  #: What.
    begin_s: float  #: From when to when, s after the beginning of the log.
    end_s: float  #: From when to when, s after the beginning of the log.
    text: str = ""  #: More about it, for people.


class Moment(NamedTuple):
    """A command that was sent, and what became of it."""

    at_s: float  #: When it was first sent, s after the beginning of the log.
    command: str  #: Its name.
    arguments: dict[str, Any]  #: The arguments of the request, by name.
    #: Name of the code it was answered with, or that it asks for no answer; None, no answer is in
    #: the log.
    outcome: str | None
    after_s: float | None  #: Until the answer came, s; None without one.

    def __str__(self) -> str:
        said = " ".join(f"{name}={value}" for name, value in self.arguments.items())
        return f"{self.command} {said}".rstrip() + f": {self.outcome or 'no answer'}"


# -- story -----------------------------------------------------------------------------------------

_PHASES = {
    FlightPhase.STANDBY: "ground",
    FlightPhase.TAKING_OFF: "take-off",
    FlightPhase.IN_AIR: "flight",
    FlightPhase.LANDING: "landing",
    FlightPhase.FINISHING_LANDING: "landing",
}
_DEVICES = {Device.RC: "pilot", Device.APP: "app", Device.ONBOARD: "program"}
_WAYS_DOWN = {"land", "go_home"}
_MISSIONS = {"waypoint_start_stop", "hotpoint_start", "follow_start"}  # may end with a landing


@dataclass
class Maxima:
    """The maxima of a flight; None for a value that was never heard."""

    height_m: float | None = None  #: Height above the take-off point.
    distance_m: float | None = None  #: Horizontal distance from it.
    ground_speed_m_s: float | None = None  #: Horizontal speed.
    climb_m_s: float | None = None  #: Vertical speed, both positive.
    descent_m_s: float | None = None  #: Vertical speed, both positive.
    tilt_deg: float | None = None  #: Of the body against the vertical.
    silence_s: float | None = None  #: Between two packages of telemetry.
    battery_first_percent: int | None = None  #: Charge when it was first and last heard.
    battery_last_percent: int | None = None  #: Charge when it was first and last heard.
    track_m: float | None = None  #: Length of the way over ground.
    airborne_s: float = 0.0  #: Time off the ground.

    def note(self, name: str, value: float) -> None:
        """Keep the larger one."""
        old = getattr(self, name)
        if math.isfinite(value) and (old is None or value > old):
            setattr(self, name, value)


@dataclass
class Curves:
    """Values over time, thinned: see :class:`m100link.log.channels.Curve`."""

    height_m: Curve = field(default_factory=Curve)  #: As in telemetry.
    ground_speed_m_s: Curve = field(default_factory=Curve)  #: As in telemetry.
    climb_m_s: Curve = field(default_factory=Curve)  #: As in telemetry.
    #: Of the setpoints that ask for such a value.
    sent_height_m: Curve = field(default_factory=lambda: Curve(_STREAM_GAP_S))
    #: Of the setpoints that ask for such a value.
    sent_speed_m_s: Curve = field(default_factory=lambda: Curve(_STREAM_GAP_S))
    #: Of the setpoints that ask for such a value.
    sent_climb_m_s: Curve = field(default_factory=lambda: Curve(_STREAM_GAP_S))
    battery_percent: Curve = field(default_factory=lambda: Curve(gap_s=10.0))  #: As in telemetry.
    #: Telemetry packages that came in each second.
    packages_per_s: Curve = field(default_factory=Curve)
    discarded_bytes_per_s: Curve = field(default_factory=Curve)  #: Of the line.
    round_trip_ms: Curve = field(default_factory=lambda: Curve(gap_s=10.0))  #: Of the line.


@dataclass
class FlightSummary:
    """The summary of a flight; times are s after the beginning of the log."""

    name: str  #: Name of the file.
    #: POSIX time of the beginning, s; None when nothing is in the log.
    began_utc: float | None = None
    duration_s: float = 0.0  #: How long it is.
    #: Name of the profile; None when it was never known, and no telemetry read.
    firmware: str | None = None
    packages: int = 0  #: Telemetry packages.
    #: ``ground``, ``take-off``, ``flight``, ``landing``, ``unknown``.
    phases: list[Span] = field(default_factory=list)
    #: The owner of control authority, ``pilot``, ``app``, ``program``.
    control: list[Span] = field(default_factory=list)
    #: The alarms that the console would have shown, by the same names.
    alarms: list[Span] = field(default_factory=list)
    #: The requests, and the answers; setpoints and questions apart.
    commands: list[Moment] = field(default_factory=list)
    streams: list[Span] = field(default_factory=list)  #: When setpoints and the like were sent.
    repeats: int = 0  #: Commands that were sent again because no answer came.
    discarded_bytes: int = 0  #: Received bytes that belonged to no frame.
    #: Part of the aircraft's frames that never came whole, 0 to 1; None if unknown.
    lost_share: float | None = None
    #: The last counters of the link, as :class:`~m100link.LinkStatistics` has them.
    line: dict[str, Any] = field(default_factory=dict)
    ended: str | None = None  #: Why the connection ended; None when the log does not say it.
    maxima: Maxima = field(default_factory=Maxima)  #: The largest of everything.
    curves: Curves = field(default_factory=Curves)  #: Values over time.
    path: FlightPath = field(default_factory=FlightPath)  #: Where it flew and took off.

    @property
    def track(self) -> Track:
        """Metres over the take-off point, or over the first place without one."""
        return self.path.track

    @property
    def took_off_s(self) -> float | None:
        """When it first left the ground; None when it did not."""
        return next((s.begin_s for s in self.phases if s.name in ("take-off", "flight")), None)


def read_story(
    flight: FlightLog,
    *,
    firmware: str | FirmwareProfile | None = None,
    interval_s: float = 0.0,
    listener: Callable[[FlightSummary, float, Sample | Message], None] | None = None,
) -> FlightSummary:
    """Read a whole log, once; 7 s of a processor for an hour of flight at full rates.

    Args:
        flight: The log.
        firmware: As for :meth:`FlightLog.samples`.
        interval_s: Look into items and setpoints only so often, which takes half the time. It
            counts every package, and finds every silence.
        listener: Called with the summary as far as it is, the time, s after the beginning of the
            log, and package or setpoint. Phases, control and most alarms come at the end.
    """
    story = FlightSummary(flight.path.name)
    first = next(flight.messages(), None)
    if first is None:
        return story
    story.began_utc = first.utc
    known = flight.firmware if firmware is None else profile(firmware)
    story.firmware = None if known is None else str(known)
    commands = _CommandReader(story, first.at, interval_s, listener, known)
    reader = _SampleReader(story, interval_s, listener)
    for one in flight.heard(COMMAND, EVENT, LINK, firmware=known):
        if not isinstance(one, Message):
            assert known is not None  # no packages without
            reader.hear(one, first.at, known)
        elif one.topic == COMMAND and _MOVE in one.data:
            commands.hear_move(one)
        else:
            # Of another writer: ours holds what is looked for.
            with suppress(ValueError, LookupError, TypeError, AttributeError):
                commands.hear(one)
    story.duration_s = max(story.duration_s, reader.last_at or 0.0)
    story.lost_share = flight.loss.share
    commands.end()
    reader.end()
    return story


class _CommandReader:
    """Hears each message once."""

    def __init__(
        self,
        story: FlightSummary,
        began_at: float,  # clock of the first message, s
        interval_s: float,
        listener: Callable[[FlightSummary, float, Message], None] | None,
        firmware: FirmwareProfile | None,
    ) -> None:
        self._began_at = began_at
        self._story, self._firmware = story, firmware
        self._interval_s, self._listener = interval_s, listener
        self._moved_at = self._drawn_at = -math.inf  # when a setpoint was looked into last, s
        self._asked: Message | None = None  # the last setpoint of this stream that asks for motion
        # Number in `commands` and time of what waits for its answer, by session and sequence.
        self._open: dict[tuple[int, int], tuple[int, float]] = {}
        self._streams: dict[str, list[Any]] = {}  # begin and end of each, s, and how many
        self._holder: tuple[str, float] = ("pilot", 0.0)
        self._cause = ""  # of the last loss of control, by the agent
        self._counted: tuple[float, dict[str, Any]] | None = None

    def hear_move(self, message: Message) -> None:
        """A setpoint, as most messages are: it is counted, and rarely looked into."""
        at = message.at - self._began_at
        if at > self._story.duration_s:
            self._story.duration_s = at
        self._count_stream(at, "move")
        if _STILL not in message.data:
            self._asked = message
        if at - self._drawn_at >= _DRAWN_S:
            self._drawn_at = at
            self._draw(at, message)
        if self._listener is not None and at - self._moved_at >= self._interval_s:
            self._moved_at = at
            self._listener(self._story, at, message)

    def _draw(self, at: float, message: Message) -> None:
        found, curves = read_move(message, self._firmware), self._story.curves
        if found is None:
            return
        if found.mode.horizontal is Horizontal.VELOCITY:
            curves.sent_speed_m_s.add(at, math.hypot(found.x, found.y))
        if found.mode.vertical is Vertical.VELOCITY:
            curves.sent_climb_m_s.add(at, found.z)
        elif found.mode.vertical is Vertical.HEIGHT:
            curves.sent_height_m.add(at, found.z)

    def hear(self, message: Message) -> None:
        at = message.at - self._began_at
        self._story.duration_s = max(self._story.duration_s, at)
        content = message.content()
        if message.topic == COMMAND:
            if content["is_ack"] and content["direction"] == "rx":
                self._answer(at, content)
            elif not content["is_ack"] and content["direction"] == "tx":
                self._command(at, content)
        elif message.topic == EVENT:
            self._event(at, content)
        else:
            self._count(at, content)

    def _command(self, at: float, content: dict[str, Any]) -> None:
        name = content["command"]
        if name in _STREAMS:
            self._count_stream(at, name)
        elif name not in _LOOKS:
            exchange = content["session"], content["sequence"]
            if exchange[0] and exchange in self._open:
                return  # the same once more
            self._open[exchange] = len(self._story.commands), at
            arguments = {key: value for key, value in content.items() if key not in _HEAD | _ASIDE}
            outcome = None if exchange[0] else "asks for no answer"
            self._story.commands.append(Moment(at, name, arguments, outcome, None))

    def _count_stream(self, at: float, name: str) -> None:
        stream = self._streams.get(name)
        if stream is None or at - stream[1] > _STREAM_GAP_S:
            self._stream(name)
            self._streams[name] = [at, at, 1]
        else:
            stream[1] = at
            stream[2] += 1

    def _stream(self, name: str) -> None:
        if name not in self._streams:
            return
        begin, last, count = self._streams[name]
        text, asked = f"{count} × {name}", self._asked if name == "move" else None
        if asked is not None and (wanted := read_move(asked, self._firmware)) is not None:
            at = asked.at - self._began_at
            text += f", the last with motion at {at:.2f} s: {wanted.in_words()}"
            self._asked = None
        self._story.streams.append(Span(name, begin, last, text))

    def _answer(self, at: float, content: dict[str, Any]) -> None:
        found = self._open.pop((content["session"], content["sequence"]), None)
        if found is None:
            return
        number, asked_at = found
        said = content.get("ack", content.get("problem"))
        outcome = said.get("name") if isinstance(said, dict) else said
        asked = self._story.commands[number]
        self._story.commands[number] = asked._replace(outcome=str(outcome), after_s=at - asked_at)

    def _event(self, at: float, content: dict[str, Any]) -> None:
        if content["event"] == "connection":
            error = content.get("error") or ""
            self._story.ended = None if content["is_connected"] else error
            if not content["is_connected"] and error != _CLOSED:
                self._story.alarms.append(Span("link_lost", at, at, error.partition("\n")[0]))
        elif content["event"] == "control" and content["before"] == "held":
            self._cause = content["why"].removeprefix("lost: ")
        elif content["event"] == "authority":
            before, after = content["before"], content["after"]
            if before == "held" and after not in ("held", "releasing"):
                reason = content.get("reason")
                if reason in (None, "", "unknown"):  # the connection learns it later
                    reason = self._cause or reason or after
                text = f"control was lost: {reason}"
                self._story.alarms.append(Span("authority_lost", at, at, text))
            holder = "program" if after in ("held", "releasing") else "pilot"
            if holder != self._holder[0]:
                self._hand_over(at)
                self._holder = holder, at

    def _hand_over(self, at: float) -> None:
        name, since = self._holder
        if at > since:
            self._story.control.append(Span(name, since, at))

    def _count(self, at: float, content: dict[str, Any]) -> None:
        shown = ("frames_received", "discarded_bytes", "repeats", "expired", "late_acks")
        causes = content.get("discards", {}).values()
        # Raises for counters of another writer.
        sum((*causes, *(content.get(name, 0) for name in (*shown, "dropped_writes"))))
        self._story.line = content
        if self._counted is not None:
            last, before = self._counted
            story = self._story
            seconds = max(at - last, 1e-3)
            lost = content["discarded_bytes"] - before["discarded_bytes"]
            story.curves.discarded_bytes_per_s.add(at, max(0, lost) / seconds)
            story.repeats = content["repeats"]
            story.discarded_bytes = content["discarded_bytes"]
            acks = content["acks"] - before["acks"]
            taken_s = content["round_trips"]["total_s"] - before["round_trips"]["total_s"]
            if acks > 0:
                story.curves.round_trip_ms.add(at, 1000.0 * taken_s / acks)
        self._counted = at, content

    def end(self) -> None:
        for name in self._streams:
            self._stream(name)
        self._story.streams.sort(key=lambda span: span.begin_s)
        self._hand_over(self._story.duration_s)


def read_move(message: Message, firmware: FirmwareProfile | None) -> ReceivedMove | None:
    """A setpoint by its meaning; None for one that has none, or of another writer."""
    with suppress(M100Error, LookupError, TypeError, ValueError):
        move = Move(**message.content()["movement"])
        return None if firmware is None else ReceivedMove.read(move, firmware)
    return None


class _SampleReader:
    """Hears each package once."""

    def __init__(
        self,
        story: FlightSummary,
        interval_s: float,
        listener: Callable[[FlightSummary, float, Sample], None] | None,
    ) -> None:
        self._story = story
        self._interval_s, self._listener = interval_s, listener
        self._due_at, self._flags = -math.inf, 0  # items that were looked into since the last time
        # The flag of each item that is looked into, and what hears it: the phase first.
        heard: dict[type[Any], Callable[[float, Any], None]] = {
            FlightStatus: self._hear_phase,
            Position: self._hear_position,
            Velocity: self._hear_velocity,
            Attitude: self._hear_attitude,
            Battery: self._hear_battery,
            ControlDevice: self._hear_device,
        }
        self._readers = [(1 << BY_RECORD[one].bit, one, hear) for one, hear in heard.items()]
        self._alarms: list[Span] = []
        self.last_at: float | None = None
        self._longest_s = 0.0  # without a package so far; a longer one is looked into
        self._second = self._count = 0  # its number, and packages in it so far
        self._phase = ""
        self._phases: list[tuple[float, str]] = []
        self._control: list[tuple[float, str]] = []
        self._ringing: dict[str, tuple[float, str]] = {}

    def hear(self, packages: Packages, began_at: float, firmware: FirmwareProfile) -> None:
        """Packages in order of time; ``began_at``: clock of the first message of the log, s."""
        self._story.packages += len(packages)
        last, due_at = self.last_at, self._due_at
        for value, received_at in packages:
            at = received_at - began_at
            if last is not None and at - last > self._longest_s:
                self._note_silence(last, at)
            last = at
            if not self._second <= at < self._second + 1:
                self._end_second(at)
            self._count += 1
            flags = value[0] | value[1] << 8
            if at >= due_at:
                due_at = at + 0.999 * self._interval_s
                self._flags = 0
            new = flags & ~self._flags
            if not new:
                continue  # its items come once more
            self._flags |= new
            sample = Sample(value, firmware, received_at)
            if self._listener is not None:
                self._listener(self._story, at, sample)
            for flag, record, hear in self._readers:
                if new & flag:
                    hear(at, sample[record])
        self.last_at, self._due_at = last, due_at

    def _hear_velocity(self, at: float, velocity: Velocity) -> None:
        curves, most = self._story.curves, self._story.maxima
        speed = velocity.ground_speed_m_s
        curves.ground_speed_m_s.add(at, speed)
        curves.climb_m_s.add(at, velocity.up_m_s)
        most.note("ground_speed_m_s", speed)
        most.note("climb_m_s", velocity.up_m_s)
        most.note("descent_m_s", -velocity.up_m_s)

    def _hear_attitude(self, _: float, attitude: Attitude) -> None:
        upright = 1.0 - 2.0 * (attitude.q1**2 + attitude.q2**2)
        if math.isfinite(upright):
            tilt_deg = math.degrees(math.acos(max(-1.0, min(1.0, upright))))
            self._story.maxima.note("tilt_deg", tilt_deg)

    def _hear_device(self, at: float, device: ControlDevice) -> None:
        name = None if device.device is None else _DEVICES[device.device]
        if name is not None and (not self._control or self._control[-1][1] != name):
            self._control.append((at, name))

    def _end_second(self, at: float) -> None:
        number, rates = self._second, self._story.curves.packages_per_s
        rates.add(number + 0.5, self._count)
        for empty in range(number + 1, min(int(at), number + 4)):
            rates.add(empty + 0.5, 0.0)
        self._second, self._count = int(at), 0

    def _note_silence(self, last: float, at: float) -> None:
        self._story.maxima.note("silence_s", at - last)
        self._longest_s = min(max(self._longest_s, at - last), MAX_TELEMETRY_AGE)
        if at - last > MAX_TELEMETRY_AGE:
            text = f"no telemetry for {at - last:.1f} s"
            self._alarms.append(Span("link_old", last, at, text))

    def _hear_phase(self, at: float, status: FlightStatus) -> None:
        phase = "unknown" if status.phase is None else _PHASES[status.phase]
        if phase == self._phase:
            return
        if phase == "landing":
            self._ring("lands_itself", True, at, "the aircraft lands, and nobody here asked for it")
        elif self._phase == "landing":
            self._ring("lands_itself", False, at, "")
        self._phase = phase
        self._phases.append((at, phase))
        path = self._story.path
        was_home_known = bool(path.homes)
        path.hear_phase(at, is_off_ground=phase != "ground")
        if path.homes and not was_home_known:
            self._story.maxima.distance_m = 0.0

    def _is_asked_down(self, at: float) -> bool:
        """Whether a command of this flight explains that it lands."""
        stood = [since for since, phase in self._phases if phase == "ground" and since <= at]
        return any(
            (stood or [0.0])[-1] <= command.at_s <= at
            if command.arguments.get("task") in _WAYS_DOWN
            else command.at_s <= at and command.command in _MISSIONS
            for command in self._story.commands
        )

    def _hear_position(self, at: float, position: Position) -> None:
        story = self._story
        if math.isfinite(position.height_m):
            story.curves.height_m.add(at, position.height_m)
            story.maxima.note("height_m", position.height_m)
        health = position.gps_health
        if health is not None:
            is_bad = health < GOOD_GPS if self._is_in_air else False
            self._ring("gps", is_bad, at, f"GPS health {health}: it cannot hold its place")
        if has_fix(position):
            story.maxima.note("distance_m", math.hypot(*story.path.add(at, position)))

    @property
    def _is_in_air(self) -> bool:
        return self._phase in ("flight", "landing")

    def _hear_battery(self, at: float, battery: Battery) -> None:
        charge, most = battery.percent, self._story.maxima
        self._story.curves.battery_percent.add(at, charge)
        if most.battery_first_percent is None:
            most.battery_first_percent = charge
        most.battery_last_percent = charge
        is_critical = is_low(charge, BATTERY_CRITICAL) if self._is_in_air else False
        self._ring("battery_low", is_low(charge, BATTERY_LOW), at, f"battery {charge} %")
        self._ring("battery_critical", is_critical, at, f"battery {charge} %")

    def _ring(self, name: str, is_so: bool | None, at: float, text: str) -> None:
        """An alarm begins, ends, or stays as it is."""
        if is_so and name not in self._ringing:
            self._ringing[name] = at, text
        elif is_so is False and name in self._ringing:
            began, said = self._ringing.pop(name)
            self._alarms.append(Span(name, began, at, said))

    def end(self) -> None:
        story, most = self._story, self._story.maxima
        if self.last_at is not None:
            self._note_silence(self.last_at, story.duration_s)
        for name in list(self._ringing):
            self._ring(name, False, story.duration_s, "")
        found = [  # a command may stand behind the package that shows its effect
            span
            for span in self._alarms
            if span.name != "lands_itself" or not self._is_asked_down(span.begin_s)
        ]
        story.alarms = sorted([*found, *story.alarms], key=lambda one: one.begin_s)
        story.phases = _spans(self._phases, story.duration_s)
        story.control = _spans(self._control, story.duration_s) or story.control
        most.airborne_s = sum(
            span.end_s - span.begin_s
            for span in story.phases
            if span.name != "ground" and span.name != "unknown"
        )
        if story.path.frame is not None:
            most.track_m = story.track.length_m


def _spans(names: list[tuple[float, str]], end_s: float) -> list[Span]:
    spans: list[Span] = []
    for at, name in names:
        if spans:
            spans[-1] = spans[-1]._replace(end_s=at)
        spans.append(Span(name, at, end_s))
    return spans
