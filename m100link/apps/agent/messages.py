"""What an agent and its fronts tell each other: a few typed messages.

A front is what strangers reach: rosbridge, the console. It owns nothing of the aircraft. What it
knows comes in these messages, what it wants goes out in them (``m100link.apps.agent.transports``).

==================  ========================================================================
Both ways           Hello, Goodbye
From the agent      Telemetry, FromMobile, Event, State, LinkCounted, LeaseChanged,
                    LeaseGranted, TakeOverOffered, Activating, AuthorityTaken, MissionTold,
                    PlanTold, SteerRefused, Outcome
From a front        LeaseAsk, Steer, Ask, Note; FlyTo, FlyAround, ChangeHeight,
                    ChangeHeading (``m100link.apps.agent.guided``)
==================  ========================================================================

What a carrier makes of them is in ``m100link.apps.agent.codec``.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum
from typing import Any

from m100link.apps.agent.guided import (
    ChangeHeading,
    ChangeHeight,
    FlyAround,
    FlyTo,
    GuidedFlight,
)
from m100link.apps.agent.lease import Flown, LeaseChange
from m100link.apps.agent.remote_error import Fault
from m100link.protocol.setpoint import Setpoint

__all__ = [
    "TAKE_OFF_FIRST",
    "UNTIL_OVER",
    "VERSION",
    "Action",
    "Activating",
    "Ask",
    "AuthorityTaken",
    "Event",
    "FromMobile",
    "Goodbye",
    "Hello",
    "LeaseAction",
    "LeaseAsk",
    "LeaseChanged",
    "LeaseGranted",
    "Limits",
    "LinkCounted",
    "Message",
    "MissionTold",
    "Note",
    "Outcome",
    "PlanTold",
    "Replay",
    "Stage",
    "State",
    "Steer",
    "SteerRefused",
    "TakeOverOffered",
    "Telemetry",
    "Topic",
]


VERSION = 10
"""Of these messages. Both ends name theirs in :class:`Hello` and part when they differ."""

# -- both ways ------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Hello:
    """The first message of each end.

    Attributes:
        version: :data:`VERSION` of the sender.
        name: Who it is, for people.
        at: Time of the sender's clock, s; both are on one machine and share the clock.
    """

    version: int
    name: str
    at: float


@dataclass(frozen=True, slots=True)
class Goodbye:
    """The last message of an end, where the carrier does not say it by itself.

    Attributes:
        reason: Why it closes, for people.
    """

    reason: str


# -- from the agent -------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Telemetry:
    """One telemetry package, as it came.

    Attributes:
        value: Flag word and items.
        profile: Name of the firmware profile that reads them.
        received_at: When it arrived, s.
    """

    value: bytes
    profile: str
    received_at: float


@dataclass(frozen=True, slots=True)
class FromMobile:
    """Data of the app on the pilot's phone.

    Attributes:
        data: Up to 100 bytes.
    """

    data: bytes


class Topic(Enum):
    """What an event is about, where programs have to know it."""

    NONE = ""
    STOPPED = "stopped"  # somebody pressed STOP
    # A front that does not hold the lease had it hover: whoever flies has not asked for that.
    HALTED = "halted"
    # The aircraft, a guard, or a loss of control or of the line ended it before its end.
    MISSION_ABORTED = "mission aborted"


@dataclass(frozen=True, slots=True)
class Event:
    """Something that happened, for people.

    Attributes:
        number: Counts events from 1.
        at: Time on the agent's clock, s.
        level: ``"info"``, ``"warning"`` or ``"error"``.
        text: What happened.
        topic: What it is about, for programs.
    """

    number: int
    at: float
    level: str
    text: str
    topic: Topic = Topic.NONE


@dataclass(frozen=True, slots=True)
class Limits:
    """What the guards of the agent allow; None where one is off.

    Attributes:
        max_height_m: Height above the take-off point, m.
        max_radius_m: Horizontal distance from where control was obtained, m.
        max_speed_m_s: Horizontal speed, m/s.
        battery_floor_percent: Below it no take-off and no setpoints.
        latitude_deg: Where control was obtained; None without control, or without GPS.
        longitude_deg: The same.
    """

    max_height_m: float | None = None
    max_radius_m: float | None = None
    max_speed_m_s: float | None = None
    battery_floor_percent: int | None = None
    latitude_deg: float | None = None
    longitude_deg: float | None = None


@dataclass(frozen=True, slots=True)
class State:
    """Where the agent stands: after each change, and a few times a second.

    Attributes:
        at: When it was so, s.
        connection: ``"connecting"``, ``"connected"`` or ``"lost"``.
        connection_fault: Why it is not connected.
        firmware: Firmware profile in use; empty when not connected.
        is_activated: Whether the aircraft is active and its key in use.
        activation_code: Last answer to an activation.
        activation_fault: Why the last activation failed.
        holding: State of control authority, a
            :class:`~m100link.apps.agent.server.authority.HoldingState`.
        has_authority: Whether setpoints and tasks are obeyed.
        task: What the aircraft flies by itself; empty for nothing.
        pattern: Name of the program that flies; empty for none.
        guided: The flight to where somebody points, with what remains of it; None for none.
        mission: The kind of mission that the aircraft says it flies, whoever started it, by the
            names of :class:`~m100link.flight.mission_state.MissionKind`; empty when nobody knows.
        mission_index: Waypoint that it flies to, counted from 0; -1 when nobody knows.
        mission_status: Status of the mission as on the wire; -1 when nobody knows.
        lease_remaining: Seconds until the lease ends if nobody renews it.
        round_trip: Seconds to the aircraft and back.
        discards: Damaged frames.
        late_acks: Acks that came late or belong to nobody.
        dropped_writes: Frames that were not written.
        mismatches: Telemetry packages that do not fit the firmware.
        limits: What the guards allow.
        replay: Where the replay is; None for an aircraft, real or virtual.
    """

    at: float
    connection: str = "connecting"
    connection_fault: Fault | None = None
    firmware: str = ""
    is_activated: bool = False
    activation_code: int | None = None
    activation_fault: Fault | None = None
    holding: str = "none"
    has_authority: bool = False
    task: str = ""
    pattern: str = ""
    guided: GuidedFlight | None = None
    mission: str = ""
    mission_index: int = -1
    mission_status: int = -1
    lease_remaining: float = 0.0
    round_trip: float | None = None
    discards: int = 0
    late_acks: int = 0
    dropped_writes: int = 0
    mismatches: int = 0
    limits: Limits = Limits()
    replay: Replay | None = None

    def flight_time(self, now: float) -> float:
        """What telemetry is received by when the agent's clock says ``now``, s."""
        return now if self.replay is None else self.replay.time(now - self.at)


@dataclass(frozen=True, slots=True)
class LinkCounted:
    """What was counted on the line to the aircraft since it was opened, once a second.

    Attributes:
        at: When it was so, s.
        counters: Numbers of :class:`~m100link.LinkStatistics` by their names.
        discards: Discarded starts and frames by their causes.
        loop_lag: Seconds that the agent was late at worst in the last second.
        round_trips: Answered requests by the upper bound of their class, s, ``inf`` for the last;
            see :class:`~m100link.RoundTrips`.
        round_trips_s: How long they took together, s.
    """

    at: float
    counters: Mapping[str, Any]
    discards: Mapping[str, Any]
    loop_lag: float
    round_trips: Mapping[str, Any] = field(default_factory=dict)
    round_trips_s: float = 0.0


@dataclass(frozen=True, slots=True)
class LeaseChanged:
    """Who has the lease.

    Attributes:
        number: Number of the lease in force, 0 for none.
        name: Who holds it; empty for nobody.
        why: Why it changed hands; None when a front is told for the first time.
        flown: What was flown for whoever had it before. A task goes on in the autopilot as long as
            control authority is kept; everything else is stopped.
    """

    number: int
    name: str
    why: LeaseChange | None = None
    flown: Flown = Flown.NOTHING


@dataclass(frozen=True, slots=True)
class LeaseGranted:
    """Answer to :class:`LeaseAsk`: the lease.

    Attributes:
        id: Of the question.
        name: Who holds it, as others see it.
        token: Proof of it, for whoever holds it and nobody else.
        number: Fence of its setpoints: a later lease has a greater one.
    """

    id: int
    name: str
    token: str = field(repr=False)
    number: int


@dataclass(frozen=True, slots=True)
class TakeOverOffered:
    """Answer to the first step of a take-over.

    Attributes:
        id: Of the question.
        name: Who wants the lease.
        from_name: Who would lose it.
        token: What the second step takes.
        number: Number of the lease that would end.
        expires_at: Time after which it is void, s.
    """

    id: int
    name: str
    from_name: str
    token: str = field(repr=False)
    number: int
    expires_at: float


@dataclass(frozen=True, slots=True)
class Activating:
    """An answer of the aircraft to an activation.

    Attributes:
        code: :class:`~m100link.protocol.codes.ActivationCode`.
    """

    code: int


@dataclass(frozen=True, slots=True)
class AuthorityTaken:
    """Somebody else took control authority.

    Attributes:
        fault: An :class:`~m100link.errors.AuthorityLost`, with its reason.
    """

    fault: Fault


@dataclass(frozen=True, slots=True)
class MissionTold:
    """Something happened to the mission that this agent flies, as DJI's push 0x02/0x04 says it.

    Attributes:
        event: 0 uploaded, 1 finished, 2 waypoint reached.
        data: The five bytes behind it.
    """

    event: int
    data: bytes


@dataclass(frozen=True, slots=True)
class PlanTold:
    """The plan that waits to be started, or flies: told when it is whole, and when it is void.

    Attributes:
        name: Who uploaded it, for people; empty for none.
        mission: The command 0x03/0x10, as on the wire; empty for none.
        points: The commands 0x03/0x11, in order.
    """

    name: str = ""
    mission: bytes = b""
    points: tuple[bytes, ...] = ()


@dataclass(frozen=True, slots=True)
class SteerRefused:
    """A setpoint was not flown; what flew before is stopped, or expires.

    Attributes:
        fence: Of the setpoint.
        fault: Why.
    """

    fence: int
    fault: Fault


@dataclass(frozen=True, slots=True)
class Outcome:
    """What became of an :class:`Ask` or a :class:`LeaseAsk`.

    Attributes:
        id: Of the question.
        stage: How far it came.
        fault: Why it failed.
        text: What was asked for, where that is a text.
        number: What was asked for, where that is a number.
    """

    id: int
    stage: Stage
    fault: Fault | None = None
    text: str = ""
    number: int = 0


# -- from a front ---------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class LeaseAsk:
    """Something about the lease.

    Attributes:
        id: Comes back in the answer; 0 asks for none.
        action: What is wanted.
        name: Who wants it, for people (acquire, take over).
        token: Proof of the lease, or of the take-over that is confirmed.
    """

    id: int
    action: LeaseAction
    name: str = ""
    token: str = field(default="", repr=False)


@dataclass(frozen=True, slots=True)
class Steer:
    """A setpoint for as long as its lifetime.

    Attributes:
        fence: Number of the lease it is sent under, granted over this connection.
        sent_at: When the sender decided it, s. What was long on its way is refused.
        lifetime: Seconds that it lasts when it is not renewed.
        setpoint: What to fly.
    """

    fence: int
    sent_at: float
    lifetime: float
    setpoint: Setpoint


@dataclass(frozen=True, slots=True)
class Ask:
    """Something to be done, with an :class:`Outcome`.

    Attributes:
        id: Comes back in each outcome; 0 asks for none.
        action: What.
        fence: Number of the lease it is asked under; 0 for none.
        number: Of the simple task; how a mission is to start (``actions``); a speed in mm/s, a
            radius in mm, a rate in thousandths of a degree per second (clockwise positive).
        data: For the app on the pilot's phone; else the value of a command, as on the wire.
        text: Why, for people (halt).
    """

    id: int
    action: Action
    fence: int = 0
    number: int = 0
    data: bytes = b""
    text: str = ""


@dataclass(frozen=True, slots=True)
class Note:
    """Something that happened in the front, for the journal.

    Attributes:
        level: ``"info"``, ``"warning"`` or ``"error"``.
        text: What happened.
    """

    level: str
    text: str


Message = (
    Hello
    | Goodbye
    | Telemetry
    | FromMobile
    | Event
    | State
    | LinkCounted
    | LeaseChanged
    | LeaseGranted
    | TakeOverOffered
    | Activating
    | AuthorityTaken
    | MissionTold
    | PlanTold
    | SteerRefused
    | Outcome
    | LeaseAsk
    | Steer
    | Ask
    | FlyTo
    | FlyAround
    | ChangeHeight
    | ChangeHeading
    | Note
)
"""Any of them."""


# -- what a front can ask for, and how far it came: the words of messages --------------------------


TAKE_OFF_FIRST, UNTIL_OVER = 1, 2
"""Bits of the number with which a mission is started: take off before it; the question is accepted
when the mission has begun, and done when it is over."""


class Action(Enum):
    """What the agent can be asked to do."""

    ACTIVATE = "activate"
    OBTAIN = "obtain"  # control authority
    RELEASE = "release"
    TAKE_OFF = "take_off"
    LAND = "land"
    GO_HOME = "go_home"
    PATTERN = "pattern"  # the simple task of that number
    HALT = "halt"  # no motion, no guided flight; a task goes on
    STOP = "stop"  # no motion, and no task
    GIMBAL_ANGLES = "gimbal_angles"
    GIMBAL_RATES = "gimbal_rates"
    TAKE_PHOTO = "take_photo"
    START_VIDEO = "start_video"
    STOP_VIDEO = "stop_video"
    ARM = "arm"
    DISARM = "disarm"
    MISSION_PLAN = "mission_plan"  # a new plan, of which the points follow
    MISSION_POINT = "mission_point"
    MISSION_START = "mission_start"
    HOTPOINT_START = "hotpoint_start"
    HOTPOINT_RADIUS = "hotpoint_radius"
    HOTPOINT_RATE = "hotpoint_rate"
    HOTPOINT_HEADING = "hotpoint_heading"  # back to where it is to point
    MISSION_STOP = "mission_stop"  # of whatever kind, like the next two
    MISSION_PAUSE = "mission_pause"
    MISSION_RESUME = "mission_resume"
    MISSION_SPEED = "mission_speed"
    VERSION = "version"
    SEND_TO_MOBILE = "send_to_mobile"
    REPLAY = "replay"  # an order to a recording; the data says which, in words


class LeaseAction(Enum):
    """What a front may want of the lease."""

    ACQUIRE = "acquire"
    RENEW = "renew"
    RELEASE = "release"
    TAKE_OVER = "take_over"  # first step: who would lose it?
    CONFIRM = "confirm"  # second step: take it from exactly that one


class Stage(Enum):
    """How far something that was asked for has come."""

    ACCEPTED = "accepted"  # the aircraft has begun; another outcome follows
    DONE = "done"
    FAILED = "failed"


# -- what fronts are told of a replay --------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Replay:
    """Where the replay of a recorded flight is.

    Attributes:
        name: Of the file.
        utc: POSIX time of then, s.
        clock: By which its telemetry is received, s.
        rate: Seconds by which that clock goes on in a second; 0 while it stands.
        position_s: Seconds that were played.
        duration_s: Of the whole.
        speed: Times as fast as it was flown; 0: as fast as it can be.
        is_paused: Whether it stands still on purpose.
        is_at_end: Whether everything was played.
        is_cut_off: Whether the file was not ended.
    """

    name: str
    utc: float
    clock: float
    rate: float
    position_s: float
    duration_s: float
    speed: float
    is_paused: bool
    is_at_end: bool
    is_cut_off: bool

    def time(self, since: float) -> float:
        """Its clock so many seconds after this was told, s."""
        return self.clock + since * self.rate
