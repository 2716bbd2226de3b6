"""The topics of the node: made of the agent's telemetry, for as long as somebody listens."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from enum import IntEnum
from typing import Any, TypeVar

from m100link.apps.agent.client import AgentClient, Hearing, VehicleView
from m100link.apps.agent.messages import Event, MissionReport
from m100link.apps.ros2.endpoints import PublishedTopic
from m100link.apps.ros2.graph import Names
from m100link.apps.ros2.topics import DJI_OUTPUTS, OUTPUTS, dji_makers
from m100link.geodesy import LocalFrame
from m100link.log.cdr import encode
from m100link.log.ros2 import Deviations, Messages, Stamp
from m100link.protocol import records
from m100link.telemetry.device_clock import DeviceClock
from m100link.telemetry.integrity import has_fix
from m100link.telemetry.sample import Sample

R = TypeVar("R", bound=tuple[Any, ...])

ALL_OUTPUTS = {**OUTPUTS, **DJI_OUTPUTS}  # with those that are there when they are asked for

Place = tuple[float, float, float]  # east, north, up, m

_Make = Callable[[Sample, Stamp], bytes | None]

_EARLY = 0.2  # part of the time between two messages by which a package may be early
_STATE_S, _LOOK_S = 1.0, 0.1
_LEVELS = {"info": 20, "warning": 30, "error": 40}
_UNKNOWN = 255
_UNREAD: Any = object()
_HERE = (0.0, 0.0, 0.0)
# Turned by nothing from east, north, up.
_EAST = records.Attitude(math.sqrt(0.5), 0.0, 0.0, math.sqrt(0.5))


class Places:
    def __init__(self) -> None:
        self.origin: LocalFrame | None = None  # that place; None before

    def local(self, position: records.Position) -> Place | None:
        """East, north, up in metres; up from the take-off point. None before the first fix."""
        if not position.is_possible:
            return None
        if self.origin is None:
            if not has_fix(position):
                return None
            self.origin = LocalFrame(position.latitude_deg, position.longitude_deg)
        north, east = self.origin.to_local(position.latitude_deg, position.longitude_deg)
        return east, north, position.height_m


class _Rate:
    """When topics of one rate send: of the same package, so that their stamps are equal."""

    __slots__ = ("due_at", "hz", "number", "pause")

    def __init__(self, hz: float) -> None:
        self.hz = hz  # messages per second at most; 0 for each that there is
        self.pause = 1.0 / hz if hz else 0.0  # seconds between two messages
        self.due_at = 0.0  # from when on the next ones are sent, s
        self.number = 0  # how often it was so

    def begin(self, now: float) -> None:
        """From when it was due, so that the rate holds; not from long ago, and a little early."""
        self.due_at = max(self.due_at + self.pause, now + (1.0 - _EARLY) * self.pause)
        self.number += 1


class _Source:
    """A topic that is made of packages of telemetry.

    ``make``: makes a message of a package; None where that has nothing for it.
    """

    __slots__ = ("_sent", "make", "name", "rate", "topic")

    def __init__(self, name: str, topic: PublishedTopic, make: _Make, rate: _Rate) -> None:
        self.name, self.topic, self.make = name, topic, make
        self.set_rate(rate)

    def set_rate(self, rate: _Rate) -> None:
        self.rate, self._sent = rate, -1

    def is_due(self, now: float) -> bool:
        """Whether it has not sent since its rate was due, of a package that had nothing for it."""
        return now >= self.rate.due_at or self._sent != self.rate.number

    def report(self, now: float) -> None:
        if now >= self.rate.due_at:
            self.rate.begin(now)
        self._sent = self.rate.number


class MessageMaker:
    def __init__(
        self,
        agent: AgentClient,
        names: Names,  # frames of the node, and its own name
        # Where the topics of the table go; those that are missing are not published.
        topics: Mapping[str, PublishedTopic],
        utc: Callable[[], float],  # POSIX time, s
        own: Callable[[], Status],  # how the node itself is
    ) -> None:
        self._agent, self._names = agent, names
        self._named = names.full("~/x")[1:-2]
        self._topics, self._own = topics, own
        self._stamps = Stamps(lambda: agent.now, utc)
        self.places = Places()  # where it is
        # Messages per second at most, by topic; 0 for each that there is.
        self.hz = {name: row.hz for name, row in OUTPUTS.items()}
        self._placed: tuple[Sample, Place | None] | None = None
        self._read_of: Sample | None = None
        self._records: dict[type[Any], Any] = {}
        self.deviations = Deviations()  # in the covariances
        self._messages = Messages(names.frame("odom"), names.frame("base_link"))
        self._due: dict[str, float] = {}
        self._status: dict[str, Any] = {}
        self._looks_at = agent.now
        self._ground: records.Position | None = None  # where it stands, before it takes off
        makers: dict[str, _Make] = {
            "~/imu": self._imu,
            "~/fix": _of(records.Position, self._messages.fix),
            "~/odom": self._odometry,
            "~/pose": self._of_pose(self._messages.pose),
            "~/velocity": _of(records.Velocity, self._messages.velocity),
            "~/battery": _of(records.Battery, self._messages.battery),
            "~/magnetic_field": _of(records.Magnetometer, self._messages.magnetometer),
            "~/joy": _of(records.RemoteControl, self._messages.joy),
            "~/gimbal": _of(records.Gimbal, self._messages.gimbal),
            "/tf": self._of_pose(self._messages.transform),
            "/clock": lambda _, stamp: encode("rosgraph_msgs/Clock", {"clock": _time(stamp)}),
        }
        makers |= dji_makers()
        rates = {row.hz: _Rate(row.hz) for row in ALL_OUTPUTS.values()}
        self._sources = [
            _Source(name, topics[name], make, rates[ALL_OUTPUTS[name].hz])
            for name, make in makers.items()
            if name in topics
        ]
        agent.on_event.append(self._event)
        agent.on_mission_report.append(self._mission)

    def time_now(self) -> dict[str, int]:
        return _time(self._stamps.at(self._agent.now))

    # -- with each package -----------------------------------------------------------------------

    def hear(self, sample: Sample) -> None:
        now = sample.received_at
        self._stamps.hear(sample)
        due = [one for one in self._sources if one.topic.is_wanted and one.is_due(now)]
        if not due:
            return
        stamp = self._stamps.of(sample)
        made = [(one, one.make(sample, stamp)) for one in due]
        # All at once: the first one wakes a thread of zenoh's, which sends the others with it.
        # Each with its own work before it woke that thread anew, at five times the cost.
        for source, message in made:
            if message is not None:
                source.report(now)
                source.topic.put(message)

    def set_hz(self, name: str, hz: float) -> None:
        """Let a topic have so many messages per second at most; 0 for each that there is."""
        self.hz[name] = hz
        rates = {source.rate.hz: source.rate for source in self._sources}
        for source in self._sources:
            if source.name == name:
                source.set_rate(rates.get(hz) or _Rate(hz))

    def set_deviation(self, name: str, value: float) -> None:
        self.deviations = self.deviations._replace(**{name: value})
        self._messages.deviate(self.deviations)

    def _read(self, record: type[R], sample: Sample) -> R | None:
        """An item of this package; several topics ask for the same."""
        if self._read_of is not sample:
            self._read_of, self._records = sample, {}
        found: R | None = self._records.get(record, _UNREAD)
        if found is _UNREAD:
            found = self._records[record] = sample.get(record)
        return found

    def _near(self, record: type[R], sample: Sample) -> R | None:
        """An item of this package, or of one just before."""
        found = self._read(record, sample)
        return self._agent.view.together(record) if found is None else found

    def _imu(self, sample: Sample, stamp: Stamp) -> bytes | None:
        attitude, rates = (
            self._read(records.Attitude, sample),
            self._read(records.AngularVelocity, sample),
        )
        if attitude is None and rates is None:
            return None
        return self._messages.imu(stamp, attitude, rates, sample.acceleration)

    def _place(self, sample: Sample) -> Place | None:
        if self._placed is None or self._placed[0] is not sample:
            position = self._near(records.Position, sample)
            found = None if position is None else self.places.local(position)
            self._placed = sample, found
        return self._placed[1]

    def _odometry(self, sample: Sample, stamp: Stamp) -> bytes | None:
        attitude, place = self._read(records.Attitude, sample), self._place(sample)
        velocity, rates = (
            self._near(records.Velocity, sample),
            self._near(records.AngularVelocity, sample),
        )
        if attitude is None or place is None or velocity is None or rates is None:
            return None
        return self._messages.odometry(stamp, place, attitude, velocity, rates)

    def _of_pose(self, make: Callable[[Stamp, Place, records.Attitude], bytes]) -> _Make:
        def made(sample: Sample, stamp: Stamp) -> bytes | None:
            attitude, place = self._read(records.Attitude, sample), self._place(sample)
            return None if attitude is None or place is None else make(stamp, place, attitude)

        return made

    # -- with time -------------------------------------------------------------------------------

    def begin(self) -> None:
        """Say what does not change, and what has happened."""
        ground = Messages(self._names.frame("map"), self._names.frame("odom"))
        still = ground.transform(self._stamps.at(self._agent.now), _HERE, _EAST)
        self._topics["/tf_static"].put(still)
        for event in self._agent.events:
            self._event(event)

    def advance(self) -> None:
        """Say how it stands, if that has changed or was not said for a while."""
        now = self._agent.now
        if now < self._looks_at:
            return
        self._looks_at = now + _LOOK_S
        self._look_for_home()
        status = self._flight_status()
        if status != self._status or now >= self._due.get("~/flight_status", now):
            self._status = status
            self._due["~/flight_status"] = now + _STATE_S
            message = {"header": self._header(self._stamps.at(now)), **status}
            self._topics["~/flight_status"].say(message)
        is_wanted = self._topics["/diagnostics"].is_wanted
        if is_wanted and now >= self._due.get("/diagnostics", now):
            self._due["/diagnostics"] = now + _STATE_S
            message = {"stamp": _time(self._stamps.at(now)), "frame_id": ""}
            found = diagnostics(self._agent.view, self._stamps.clock)
            status_of = [one.status(self._named) for one in (*found, self._own())]
            self._topics["/diagnostics"].say({"header": message, "status": status_of})

    def _look_for_home(self) -> None:
        """The last place on the ground, once it is left: there the aircraft takes its home point.

        A node that begins in the air cannot know it.
        """
        view = self._agent.view
        position = view.get(records.Position)
        if view.is_on_ground and position is not None and has_fix(position):
            self._ground = position
        elif view.is_airborne and self._ground is not None:
            stamp = self._stamps.at(self._agent.now)
            self._topics["~/home"].put(self._messages.fix(stamp, self._ground))
            self._ground = None

    def _header(self, stamp: Stamp) -> dict[str, Any]:
        return {"stamp": _time(stamp), "frame_id": self._names.frame("base_link")}

    def _flight_status(self) -> dict[str, Any]:
        view = self._agent.view
        status, switch = view.status, view.switch
        position, battery = view.get(records.Position), view.get(records.Battery)
        health = None if position is None else position.gps_health
        return {
            "phase": _UNKNOWN if status is None else status.status,
            "has_authority": view.has_authority,
            "holder": view.holder.name,
            "task": view.state.task,
            "mode_switch": "" if switch is None else switch.name,
            "gps_health": _UNKNOWN if health is None else health,
            "battery_percent": battery.percent if battery else _UNKNOWN,
            "firmware": view.state.firmware,
            "connection": view.connection,
        }

    def _event(self, event: Event) -> None:
        said = {
            "stamp": _time(self._stamps.at(event.at)),
            "level": _LEVELS.get(event.level, 20),
            "name": self._named.replace("/", "."),
            "msg": event.text,
            "file": "",
            "function": "",
            "line": 0,
        }
        self._topics["/rosout"].say(said)

    def _mission(self, report: MissionReport) -> None:
        header = self._header(self._stamps.at(self._agent.now))
        data = list(report.data[:5].ljust(5, b"\0"))
        self._topics["~/mission_event"].say({"header": header, "event": report.event, "data": data})


def _time(stamp: Stamp) -> dict[str, int]:
    return {"sec": stamp[0], "nanosec": stamp[1]}


def _of(record: type[R], make: Callable[[Stamp, R], bytes]) -> _Make:
    def made(sample: Sample, stamp: Stamp) -> bytes | None:
        found = sample.get(record)
        return None if found is None else make(stamp, found)

    return made


# -- what is wrong, for /diagnostics: line, clock, place, control, battery, and the node itself ----


_LOW_PERCENT = 30
_BOUND_S = 0.05


class DiagnosticLevel(IntEnum):
    OK = 0
    WARN = 1
    ERROR = 2
    STALE = 3


@dataclass(frozen=True, slots=True)
class Status:
    name: str
    level: DiagnosticLevel
    message: str  # in a few words
    values: Mapping[str, object] = field(default_factory=dict)  # numbers, by name

    def status(self, node: str) -> dict[str, Any]:
        return {
            "level": self.level,
            "name": f"{node}: {self.name}",
            "message": self.message,
            "hardware_id": "DJI Matrice 100",
            "values": [{"key": key, "value": str(one)} for key, one in self.values.items()],
        }


def diagnostics(view: VehicleView, clock: DeviceClock | None) -> list[Status]:
    """How the aircraft is. ``clock``: its clock; None before its first tick."""
    return [_line(view), _clock(clock), _navigation(view), _control(view), _battery(view)]


def _line(view: VehicleView) -> Status:
    state = view.state
    values = {
        "firmware": state.firmware,
        "round trip ms": "" if state.round_trip is None else round(1000 * state.round_trip, 2),
        "damaged frames": state.discards,
        "late acks": state.late_acks,
        "dropped writes": state.dropped_writes,
        "packages that do not fit": state.mismatches,
    }
    if not view.is_connected:
        unheard = {Hearing.SILENT: "the agent is silent", Hearing.GONE: "the agent has gone"}
        message = unheard.get(view.hearing, state.connection)
        return Status("line", DiagnosticLevel.ERROR, message, values)
    if not view.is_heard:
        return Status("line", DiagnosticLevel.STALE, "no telemetry", values)
    return Status("line", DiagnosticLevel.OK, "connected", values)


def _clock(clock: DeviceClock | None) -> Status:
    if clock is None:
        return Status("clock", DiagnosticLevel.STALE, "no tick of the aircraft yet")
    bound = clock.uncertainty_s
    values = {
        "bound of stamps ms": round(1000 * bound, 2) if math.isfinite(bound) else "unknown",
        "skew ppm": round(clock.skew_ppm, 2),
        "jumps": clock.resets,
    }
    if not bound <= _BOUND_S:
        return Status("clock", DiagnosticLevel.WARN, "stamps are uncertain", values)
    return Status("clock", DiagnosticLevel.OK, "stamps are by the clock of the aircraft", values)


def _navigation(view: VehicleView) -> Status:
    """Whether what comes can be true; on the ground there is nothing to judge."""
    if not view.is_heard:
        return Status("navigation", DiagnosticLevel.STALE, "unknown")
    found = view.integrity
    values = {
        "position test ratio": round(found.test_ratio, 2),
        "height test ratio": round(found.height_test_ratio, 2),
        "delay ms": round(1000 * found.delay_s, 1),
    }
    if found.is_plausible and found.is_timely:
        return Status("navigation", DiagnosticLevel.OK, found.state.name.lower(), values)
    return Status("navigation", DiagnosticLevel.ERROR, found.seen, values)


def _control(view: VehicleView) -> Status:
    values = {"lease": view.holder.name, "task": view.state.task}
    held = "programs have control" if view.has_authority else "the pilot flies"
    return Status("control", DiagnosticLevel.OK, held, values)


def _battery(view: VehicleView) -> Status:
    battery = view.get(records.Battery)
    if battery is None:
        return Status("battery", DiagnosticLevel.STALE, "unknown")
    values = {"percent": battery.percent}
    if battery.percent <= _LOW_PERCENT:
        return Status("battery", DiagnosticLevel.WARN, "low", values)
    return Status("battery", DiagnosticLevel.OK, "charged", values)


# -- when packages were made, for the headers of messages: by the clock of the aircraft ------------
# The clock is asked a few times a second and not for each package: in between, time goes on as its
# ticks do.


_ASKED_S = 0.25
"""Seconds for which one answer of the clock holds: its skew makes 50 µs of them at most."""


class Stamps:
    """Times of packages as POSIX time.

    ``now``: time of the event loop, s. ``utc``: POSIX time, s.
    """

    def __init__(self, now: Callable[[], float], utc: Callable[[], float]) -> None:
        self._now, self._utc = now, utc
        self.clock: DeviceClock | None = None  # of the aircraft; None before its first tick
        # A tick, and when that was on the event loop's clock; None while nobody knows.
        self._known: tuple[int, float] | None = None

    def at(self, at: float) -> Stamp:
        """POSIX time of a time of the event loop."""
        nanoseconds = max(0, round((at - self._now() + self._utc()) * 1e9))
        return divmod(nanoseconds, 10**9)

    def hear(self, sample: Sample) -> None:
        """Let the clock know of a package; each has to come by here."""
        time = sample.get(records.Time)
        if time is None:
            return
        tick_hz = sample.profile.tick_hz
        if self.clock is None or self.clock.tick_hz != tick_hz:
            self.clock, self._known = DeviceClock(tick_hz), None
        self.clock.update(time.tick, sample.received_at)

    def of(self, sample: Sample) -> Stamp:
        """When the newest package was made: never later than it came."""
        return self.at(min(self._taken_at(sample), sample.received_at))

    def _taken_at(self, sample: Sample) -> float:
        time, clock = sample.get(records.Time), self.clock
        if time is None or clock is None:
            return sample.received_at
        tick_hz = clock.tick_hz
        if self._known is not None:
            tick, at = self._known
            # Ticks that went back, or far ahead, are asked about at once.
            if 0 <= time.tick - tick < _ASKED_S * tick_hz:
                return at + (time.tick - tick) / tick_hz
        found = clock.host_time(time.tick)
        if found is None or not math.isfinite(found.uncertainty_s):
            self._known = None
            return sample.received_at
        self._known = time.tick, found.time
        return found.time
