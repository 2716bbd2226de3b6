"""What happened on a flight: its phases, who had control, alarms, commands, maxima, curves."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from m100link.geodesy import LocalFrame
from m100link.log.curves import Curve, Track
from m100link.log.reading import FlightLog
from m100link.log.told import Moment, Span, Told, read_told
from m100link.protocol.firmware import FirmwareProfile
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
from m100link.telemetry.limits import (
    BATTERY_CRITICAL,
    BATTERY_LOW,
    GOOD_GPS,
    MAX_TELEMETRY_AGE,
    has_fix,
    is_low,
)
from m100link.telemetry.sample import Sample

__all__ = ["Curves", "Maxima", "Story", "read_story"]

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
    """The largest of what a flight had; None of what was never heard.

    Attributes:
        height_m: Height above the take-off point.
        distance_m: Horizontal distance from it.
        ground_speed_m_s: Horizontal speed.
        climb_m_s, descent_m_s: Vertical speed, both positive.
        tilt_deg: Of the body against the vertical.
        silence_s: Between two packages of telemetry.
        battery_first_percent, battery_last_percent: Charge when it was first and last heard.
        track_m: Length of the way over ground.
        airborne_s: Time off the ground.
    """

    height_m: float | None = None
    distance_m: float | None = None
    ground_speed_m_s: float | None = None
    climb_m_s: float | None = None
    descent_m_s: float | None = None
    tilt_deg: float | None = None
    silence_s: float | None = None
    battery_first_percent: int | None = None
    battery_last_percent: int | None = None
    track_m: float | None = None
    airborne_s: float = 0.0

    def note(self, name: str, value: float) -> None:
        """Keep the larger one."""
        old = getattr(self, name)
        if math.isfinite(value) and (old is None or value > old):
            setattr(self, name, value)


@dataclass
class Curves:
    """Values over time, thinned: see :class:`m100link.log.curves.Curve`.

    Attributes:
        height_m, ground_speed_m_s, climb_m_s, battery_percent: As in telemetry.
        packages_per_s: Telemetry packages that came in each second.
        discarded_bytes_per_s, round_trip_ms: Of the line.
    """

    height_m: Curve = field(default_factory=Curve)
    ground_speed_m_s: Curve = field(default_factory=Curve)
    climb_m_s: Curve = field(default_factory=Curve)
    battery_percent: Curve = field(default_factory=lambda: Curve(gap_s=10.0))
    packages_per_s: Curve = field(default_factory=Curve)
    discarded_bytes_per_s: Curve = field(default_factory=Curve)
    round_trip_ms: Curve = field(default_factory=Curve)


@dataclass
class Story:
    """What happened; times are s after the beginning of the log.

    Attributes:
        name: Name of the file.
        began_utc: POSIX time of the beginning, s; None when nothing is in the log.
        duration_s: How long it is.
        firmware: Name of the profile; None when it was never known: there is no telemetry then.
        packages: Telemetry packages.
        phases: ``ground``, ``take-off``, ``flight``, ``landing``, ``unknown``.
        control: Who had control: ``pilot``, ``app``, ``program``.
        alarms: What the console would have told, by the same names.
        commands: What was asked for, and the answers; setpoints and questions apart.
        streams: When setpoints and the like were sent.
        repeats: Commands that were sent again because no answer came.
        discarded_bytes: Received bytes that belonged to no frame.
        ended: Why the connection ended; None when the log does not say it.
        maxima: The largest of everything.
        curves: Values over time.
        track: Metres over the take-off point, or over the first place without one.
    """

    name: str
    began_utc: float | None = None
    duration_s: float = 0.0
    firmware: str | None = None
    packages: int = 0
    phases: list[Span] = field(default_factory=list)
    control: list[Span] = field(default_factory=list)
    alarms: list[Span] = field(default_factory=list)
    commands: list[Moment] = field(default_factory=list)
    streams: list[Span] = field(default_factory=list)
    repeats: int = 0
    discarded_bytes: int = 0
    ended: str | None = None
    maxima: Maxima = field(default_factory=Maxima)
    curves: Curves = field(default_factory=Curves)
    track: Track = field(default_factory=Track)

    @property
    def took_off_s(self) -> float | None:
        """When it first left the ground; None when it did not."""
        return next((s.begin_s for s in self.phases if s.name in ("take-off", "flight")), None)


def read_story(flight: FlightLog, *, firmware: str | FirmwareProfile | None = None) -> Story:
    """Read a whole log, twice; 10 s for an hour of flight at full rates.

    Args:
        flight: The log.
        firmware: As for :meth:`FlightLog.samples`.
    """
    told = read_told(flight)
    story = Story(flight.path.name, told.began_utc, told.duration_s)
    known = flight.firmware if firmware is None else firmware
    reader = _Reader(story, told)
    if known is not None:
        story.firmware = str(known)
        for sample in flight.samples(firmware=known):
            reader.hear(sample.received_at - told.began_at, sample)
    reader.end()
    return story


class _Reader:
    """Hears each package once."""

    def __init__(self, story: Story, told: Told) -> None:
        self._story = story
        self._told = told
        self._frame: LocalFrame | None = None
        self._home, self._is_home_known = (0.0, 0.0), False
        self._place: tuple[float, float] | None = None
        self._last_at: float | None = None
        self._second = (0, 0)  # number, and packages in it
        self._phase = ""
        self._phases: list[tuple[float, str]] = []
        self._control: list[tuple[float, str]] = []
        self._ringing: dict[str, tuple[float, str]] = {}
        self._left_ground_at: float | None = None

    def hear(self, at: float, sample: Sample) -> None:
        story, curves, most = self._story, self._story.curves, self._story.maxima
        story.packages += 1
        self._count(at)
        status = sample.get(FlightStatus)
        if status is not None:
            self._hear_phase(at, status)
        position = sample.get(Position)
        if position is not None:
            self._hear_position(at, position)
        velocity = sample.get(Velocity)
        if velocity is not None:
            speed = velocity.ground_speed_m_s
            curves.ground_speed_m_s.add(at, speed)
            curves.climb_m_s.add(at, velocity.up_m_s)
            most.note("ground_speed_m_s", speed)
            most.note("climb_m_s", velocity.up_m_s)
            most.note("descent_m_s", -velocity.up_m_s)
        attitude = sample.get(Attitude)
        if attitude is not None:
            upright = 1.0 - 2.0 * (attitude.q1**2 + attitude.q2**2)
            if math.isfinite(upright):
                most.note("tilt_deg", math.degrees(math.acos(max(-1.0, min(1.0, upright)))))
        battery = sample.get(Battery)
        if battery is not None:
            self._hear_battery(at, battery.percent)
        device = sample.get(ControlDevice)
        if device is not None and device.device is not None:
            name = _DEVICES[device.device]
            if not self._control or self._control[-1][1] != name:
                self._control.append((at, name))

    def _count(self, at: float) -> None:
        last, self._last_at = self._last_at, at
        if last is not None:
            self._note_silence(last, at)
        number, count = self._second
        if int(at) != number:
            self._story.curves.packages_per_s.add(number + 0.5, count)
            for empty in range(number + 1, min(int(at), number + 4)):
                self._story.curves.packages_per_s.add(empty + 0.5, 0.0)
            number, count = int(at), 0
        self._second = number, count + 1

    def _note_silence(self, last: float, at: float) -> None:
        self._story.maxima.note("silence_s", at - last)
        if at - last > MAX_TELEMETRY_AGE:
            text = f"no telemetry for {at - last:.1f} s"
            self._story.alarms.append(Span("link_old", last, at, text))

    def _hear_phase(self, at: float, status: FlightStatus) -> None:
        phase = "unknown" if status.phase is None else _PHASES[status.phase]
        if phase == self._phase:
            return
        if phase == "landing" and not self._is_asked_down(at):
            self._ring("lands_itself", True, at, "the aircraft lands, and nobody here asked for it")
        elif self._phase == "landing":
            self._ring("lands_itself", False, at, "")
        self._phase = phase
        self._phases.append((at, phase))
        if phase == "ground":
            self._left_ground_at = None
        elif self._left_ground_at is None:
            self._left_ground_at = at
            self._start_at_home()

    def _is_asked_down(self, at: float) -> bool:
        """Whether a command explains that it lands."""
        return any(
            (self._left_ground_at or 0.0) <= command.at_s <= at
            if command.arguments.get("task") in _WAYS_DOWN
            else command.at_s <= at and command.command in _MISSIONS
            for command in self._told.commands
        )

    def _start_at_home(self) -> None:
        """Home is where it takes off first; what was noted before was noise of the place."""
        if self._place is not None and not self._is_home_known:
            self._is_home_known = True
            self._home = self._place
            self._story.track = Track()
            self._story.maxima.distance_m = 0.0

    def _hear_position(self, at: float, position: Position) -> None:
        story = self._story
        if math.isfinite(position.height_m):
            story.curves.height_m.add(at, position.height_m)
            story.maxima.note("height_m", position.height_m)
        health = position.gps_health
        if health is not None:
            is_bad = health < GOOD_GPS if self._is_in_air else False
            self._ring("gps", is_bad, at, f"GPS health {health}: it cannot hold its place")
        if not has_fix(position):
            return
        if self._frame is None:
            self._frame = LocalFrame(position.latitude_deg, position.longitude_deg)
        place = self._frame.to_local(position.latitude_deg, position.longitude_deg)
        self._place = place
        north, east = place[0] - self._home[0], place[1] - self._home[1]
        story.track.add(at, north, east)
        story.maxima.note("distance_m", math.hypot(north, east))

    @property
    def _is_in_air(self) -> bool:
        return self._phase in ("flight", "landing")

    def _hear_battery(self, at: float, charge: int) -> None:
        most = self._story.maxima
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
            self._story.alarms.append(Span(name, began, at, said))

    def end(self) -> None:
        story, told, most = self._story, self._told, self._story.maxima
        if self._last_at is not None:
            self._note_silence(self._last_at, story.duration_s)
        for name in list(self._ringing):
            self._ring(name, False, story.duration_s, "")
        story.alarms = sorted([*story.alarms, *told.alarms], key=lambda one: one.begin_s)
        story.phases = _spans(self._phases, story.duration_s)
        story.control = _spans(self._control, story.duration_s) or told.control
        story.commands, story.streams, story.repeats = told.commands, told.streams, told.repeats
        story.discarded_bytes, story.ended = told.discarded_bytes, told.ended
        story.curves.discarded_bytes_per_s = told.discarded
        story.curves.round_trip_ms = told.round_trip_ms
        most.airborne_s = sum(
            span.end_s - span.begin_s
            for span in story.phases
            if span.name != "ground" and span.name != "unknown"
        )
        if self._place is not None:
            most.track_m = story.track.length_m


def _spans(names: list[tuple[float, str]], end_s: float) -> list[Span]:
    """What was so until it was something else."""
    spans: list[Span] = []
    for at, name in names:
        if spans:
            spans[-1] = spans[-1]._replace(end_s=at)
        spans.append(Span(name, at, end_s))
    return spans
