"""The typed messages between an agent and its fronts.

A front serves strangers: rosbridge, the console. It owns nothing of the aircraft. State reaches it
and its orders leave it in these messages alone (``m100link.apps.agent.transports``).

==================  ========================================================================
Both ways           Hello, Goodbye
From the agent      Telemetry, MobileMessage, Event, State, LinkCounted, LeaseChanged,
                    Activating, AuthorityTaken, MissionReport, PlanChanged, SteerRefused,
                    OrderOutcome
From a front        Ask (around an order of ``m100link.apps.agent.orders``), Steer, JournalNote
==================  ========================================================================

``m100link.apps.agent.codec`` makes bytes of them; the agent keeps its events in a journal.
"""

from __future__ import annotations

import logging
from collections import deque
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from enum import Enum
from typing import TYPE_CHECKING, Any

from m100link import errors
from m100link.apps.agent.background import call_each
from m100link.apps.agent.lease import Flown, Lease, LeaseChange, LeaseHeld, LeaseRefused, TakeOver
from m100link.apps.agent.orders import GuidedFlight, Order, UploadPlan
from m100link.errors import LinkError, LinkLost, M100Error
from m100link.errors.usage import renamed
from m100link.protocol.setpoint import Setpoint

JOURNAL_LOG = __name__
"""Name of the log that has every event, for programs that show events in another way."""

_logger = logging.getLogger(JOURNAL_LOG)

VERSION = 17
"""Of these messages. Both ends name theirs in :class:`Hello` and part when they differ."""

LEVELS = ("info", "warning", "error")
"""How grave an event or a note is."""

LOG_ONLY = "log"
"""Level of a note that is for the flight log alone."""

# -- both ways ------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Hello:
    """The first message of each end."""

    version: int  #: :data:`VERSION` of the sender
    name: str  #: its name, for people
    at: float  #: time of the sender's clock, s; both are on one machine and share the clock


@dataclass(frozen=True, slots=True)
class Goodbye:
    """The last message of an end, where the carrier does not say it by itself."""

    reason: str  #: why it closes, for people


# -- from the agent -------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Telemetry:
    """One telemetry package, as it came."""

    value: bytes  #: flag word and items
    profile: str  #: name of the firmware profile that reads them
    received_at: float  #: when it arrived, s


@dataclass(frozen=True, slots=True)
class MobileMessage:
    """Data of the app on the pilot's phone."""

    data: bytes  #: up to 100 bytes


class EventTopic(Enum):
    """The subject of an event, where programs have to know it."""

    NONE = ""
    STOPPED = "stopped"  # somebody pressed STOP
    # A front that does not hold the lease had it hover: the holder has not asked for that.
    HALTED = "halted"
    # The aircraft, a guard, or a loss of control or of the line ended it before its end.
    MISSION_ABORTED = "mission aborted"


@dataclass(frozen=True, slots=True)
class Event:
    """Something that happened, for people."""

    number: int  #: counts events from 1
    at: float  #: time on the agent's clock, s
    level: str  #: ``"info"``, ``"warning"`` or ``"error"``
    text: str  #: what happened
    topic: EventTopic = EventTopic.NONE  #: its subject, for programs


@dataclass(frozen=True, slots=True)
class GuardLimits:
    """The limits of the agent's guards; None where one is off."""

    max_height_m: float | None = None  #: height above the take-off point, m
    max_radius_m: float | None = None  #: horizontal distance from where control was obtained, m
    max_speed_m_s: float | None = None  #: horizontal speed, m/s
    battery_floor_percent: int | None = None  #: below it no take-off and no setpoints
    #: Where control was obtained; None without control, or without GPS.
    latitude_deg: float | None = None
    longitude_deg: float | None = None  #: the same


@dataclass(frozen=True, slots=True)
class State:
    """Where the agent stands: after each change, and a few times a second."""

    at: float  #: when it was so, s
    connection: str = "connecting"  #: ``"connecting"``, ``"connected"`` or ``"lost"``
    connection_fault: RemoteError | None = None  #: why it is not connected
    firmware: str = ""  #: firmware profile in use; empty when not connected
    is_activated: bool = False  #: whether the aircraft is active and its key in use
    activation_code: int | None = None  #: last answer to an activation
    activation_fault: RemoteError | None = None  #: why the last activation failed, or each will
    #: State of control authority, a :class:`~m100link.apps.agent.server.authority.HoldingState`.
    holding: str = "none"
    has_authority: bool = False  #: whether setpoints and tasks are obeyed
    #: Seconds since its sender decided on the setpoint that the aircraft is being sent; None while
    #: it is sent none of the holder of the lease.
    setpoint_age: float | None = None
    task: str = ""  #: the task that the autopilot flies; empty for none
    pattern: str = ""  #: name of the program that flies; empty for none
    #: The flight to where somebody points, with the rest of it; None for none.
    guided: GuidedFlight | None = None
    #: The kind of mission that the aircraft says it flies, started by anybody, by the names of
    #: :class:`~m100link.flight.mission_state.MissionKind`; empty when nobody knows.
    mission: str = ""
    mission_index: int = -1  #: waypoint that it flies to, counted from 0; -1 when nobody knows
    mission_status: int = -1  #: status of the mission as on the wire; -1 when nobody knows
    lease_remaining: float = 0.0  #: seconds until the lease ends if nobody renews it
    round_trip: float | None = None  #: seconds to the aircraft and back
    discards: int = 0  #: damaged frames
    late_acks: int = 0  #: acks that came late or belong to nobody
    dropped_writes: int = 0  #: frames that were not written
    mismatches: int = 0  #: telemetry packages that do not fit the firmware
    limits: GuardLimits = GuardLimits()  #: the limits of the guards
    replay: Replay | None = None  #: where the replay is; None for an aircraft, real or virtual


@dataclass(frozen=True, slots=True)
class LinkCounted:
    """Counters of the line to the aircraft since it was opened, once a second."""

    at: float  #: when it was so, s
    counters: Mapping[str, Any]  #: numbers of :class:`~m100link.LinkStatistics` by their names
    discards: Mapping[str, Any]  #: discarded starts and frames by their causes
    loop_lag: float  #: seconds that the agent was late at worst in the last second
    #: Answered requests by the upper bound of their class, s, ``inf`` for the last; see
    #: :class:`~m100link.RoundTrips`.
    round_trips: Mapping[str, Any] = field(default_factory=dict)
    round_trips_s: float = 0.0  #: how long they took together, s


@dataclass(frozen=True, slots=True)
class LeaseChanged:
    """The lease has a new holder, or none."""

    number: int  #: number of the lease in force, 0 for none
    name: str  #: who holds it; empty for nobody
    #: Why it changed hands; None in the first message to a front.
    why: LeaseChange | None = None
    #: The flight of the holder before. A task goes on in the autopilot as long as control
    #: authority is kept; the agent stops everything else.
    flown: Flown = Flown.NOTHING


@dataclass(frozen=True, slots=True)
class Activating:
    """An answer of the aircraft to an activation."""

    code: int  #: :class:`~m100link.protocol.codes.ActivationCode`


@dataclass(frozen=True, slots=True)
class AuthorityTaken:
    """Somebody else took control authority."""

    fault: RemoteError  #: an :class:`~m100link.errors.AuthorityLost`, with its reason


@dataclass(frozen=True, slots=True)
class MissionReport:
    """Something happened to the mission that this agent flies, as DJI's push 0x02/0x04 says it."""

    event: int  #: 0 uploaded, 1 finished, 2 waypoint reached
    data: bytes  #: the five bytes behind it


@dataclass(frozen=True, slots=True)
class PlanChanged:
    """The plan that waits to be started, or flies: sent when it is whole, and when it is void."""

    name: str = ""  #: the name of its uploader, for people; empty for none
    plan: UploadPlan | None = None  #: as it came; None for none


@dataclass(frozen=True, slots=True)
class SteerRefused:
    """A setpoint was not flown; the one before is stopped, or expires."""

    fence: int  #: of the setpoint
    fault: RemoteError  #: why


@dataclass(frozen=True, slots=True)
class OrderOutcome:
    """The outcome of an :class:`Ask`."""

    id: int  #: of the question
    stage: Stage  #: how far it came
    fault: RemoteError | None = None  #: why it failed
    text: str = ""  #: the answer, where that is a text
    number: int = 0  #: the answer, where that is a number
    lease: Lease | None = None  #: the lease that was asked for, for its holder and nobody else
    offer: TakeOver | None = None  #: the present holder, and the token that takes the lease


# -- from a front ---------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Steer:
    """A setpoint for as long as its lifetime."""

    fence: int  #: number of the lease it is sent under, granted over this connection
    sent_at: float  #: when the sender decided it, s. What was long on its way is refused
    lifetime: float  #: seconds that it lasts when it is not renewed
    setpoint: Setpoint  #: the setpoint to fly


@dataclass(frozen=True, slots=True)
class Ask:
    """An order, which has an :class:`OrderOutcome`."""

    id: int  #: comes back in each outcome; 0 asks for none
    order: Order  #: the order
    fence: int = 0  #: number of the lease it is asked under; 0 for none
    sent_at: float | None = None  #: when it was asked in s, None where nobody says
    hears_begin: bool = False  #: whether an outcome tells the begin, too


@dataclass(frozen=True, slots=True)
class JournalNote:
    """Something that happened in the front, for the journal."""

    level: str  #: ``"info"``, ``"warning"``, ``"error"``, or :data:`LOG_ONLY`
    text: str  #: what happened


Message = (
    Hello
    | Goodbye
    | Telemetry
    | MobileMessage
    | Event
    | State
    | LinkCounted
    | LeaseChanged
    | Activating
    | AuthorityTaken
    | MissionReport
    | PlanChanged
    | SteerRefused
    | OrderOutcome
    | Steer
    | Ask
    | JournalNote
)
"""Any of them."""


# -- how far an order came, and where a replay is -------------------------------------------------


class Stage(Enum):
    """How far something that was asked for has come."""

    ACCEPTED = "accepted"  # the aircraft has begun; another outcome follows
    DONE = "done"
    FAILED = "failed"


@dataclass(frozen=True, slots=True)
class Replay:
    """Where the replay of a recorded flight is."""

    path: str  #: of the file, on the agent's computer
    utc: float  #: POSIX time of the flight that it shows, s
    clock: float  #: by which its telemetry is received, s
    since: float  #: s by that clock; telemetry from before it is void, since the replay was moved
    newest_at: float | None  #: when the newest package that was played was received, s
    position_s: float  #: seconds that were played
    duration_s: float  #: of the whole
    speed: float  #: times as fast as it was flown; 0 for as fast as it can be
    is_paused: bool  #: whether it stands still on purpose
    is_at_end: bool  #: whether everything was played
    is_cut_off: bool  #: whether the file was not ended
    is_written: bool = False  #: whether it was still being recorded when the replay began

    def time(self, newest_at: float | None) -> float:
        """Its clock for a front whose newest package is of that time, s.

        It never goes on by the front's own clock, and not while played packages are on their way:
        nothing grows old because a computer is busy.
        """
        if newest_at is None:
            return self.clock
        is_whole = self.newest_at is None or newest_at >= self.newest_at
        return max(self.clock, newest_at) if is_whole else newest_at

    def utc_at(self, now: float) -> float:
        """POSIX time of the flight at that time of its clock, s."""
        return self.utc + now - self.clock


# -- events, for people ----------------------------------------------------------------------------

_MAX_EVENTS = 200
_LEVELS = {"info": logging.INFO, "warning": logging.WARNING, "error": logging.ERROR}


class Journal:
    """The newest events, and the callbacks for each."""

    def __init__(self, clock: Callable[[], float]) -> None:  # s
        self._clock = clock
        self._count = 0
        self.events: deque[Event] = deque(maxlen=_MAX_EVENTS)
        self.on_event: list[Callable[[Event], None]] = []  # called with each event
        self.untold = 0  # over how many events the log, or a callback, failed

    def note(self, text: str, level: str = "info", topic: EventTopic = EventTopic.NONE) -> None:
        """Add an event. Raises nothing: what comes after it may end a flight."""
        try:
            event = self._add(text, level, topic)
            call_each((_log, *self.on_event), event)
        except Exception as error:  # noqa: BLE001 (whatever it is; the next event says so)
            self.untold += 1
            if self.untold == 1:
                with suppress(Exception):
                    self._add(f"a listener failed at an event: {error!r}", "error", EventTopic.NONE)

    def _add(self, text: str, level: str, topic: EventTopic) -> Event:
        self._count += 1
        event = Event(self._count, self._clock(), level, text, topic)
        self.events.append(event)
        return event


def _log(event: Event) -> None:
    _logger.log(_LEVELS[event.level], "%s", event.text)


# -- errors of this package as values, so that a front raises what the agent met -------------------


class MessageError(
    M100Error,
    code="M100-MESSAGE",
    cause="a front and an agent of different versions",
    remedy="run both from the same installation",
):
    """Bytes that are not a message, or a message that cannot be sent."""


_ERRORS: dict[str, type[M100Error]] = {
    name: found
    for name in vars(errors)["__all__"]
    if isinstance(found := getattr(errors, name), type) and issubclass(found, M100Error)
} | {kind.__name__: kind for kind in (LeaseRefused, LeaseHeld, MessageError)}

_FAULT_TEXTS = ("seen", "cause", "remedy", "off")  # the last is for a program of the library

_WIDER = {
    f"control(guards=Guards(envelope=Envelope(max_{one}_m=…)))": (
        f", or a larger --max-{one} of its agent (max_{one} in a fleet file)"
    )
    for one in ("height", "radius")
}
"""The remedy for the client of an agent."""


@dataclass(frozen=True, slots=True)
class RemoteError:
    """An error of this package on its way."""

    kind: str  #: name of its class
    seen: str  #: the observation
    cause: str = ""  #: the most likely cause
    remedy: str = ""  #: the remedy
    #: Its other attributes that are texts, numbers, truth values or None.
    details: Mapping[str, Any] = field(default_factory=dict)

    @classmethod
    def of(cls, error: M100Error) -> RemoteError:
        """The error as a value."""
        known = next(kind for kind in type(error).__mro__ if _ERRORS.get(kind.__name__) is kind)
        details = {
            name: _plain(value)
            for name, value in vars(error).items()
            if name not in _FAULT_TEXTS and isinstance(value, str | int | float | None)
        }
        remedy = error.remedy + _WIDER.get(getattr(error, "off", ""), "")
        return cls(known.__name__, error.seen, error.cause, remedy, details)

    def error(self) -> M100Error:
        """The error again: an object of its class, or of the base when the class is unknown."""
        kind = _ERRORS.get(self.kind, M100Error)
        error = kind(self.seen, cause=self.cause, remedy=self.remedy)
        # The attributes of every error stay as they are, whatever details a peer sends.
        for name, value in self.details.items():
            if name not in _FAULT_TEXTS and (name in kind.own or not hasattr(error, name)):
                vars(error)[name] = value  # no descriptor of the class, such as OSError's, is asked
        return error


def fault_of(error: M100Error | None) -> RemoteError | None:
    """The error as a value, None for none."""
    return None if error is None else RemoteError.of(error)


def _plain(value: object) -> object:
    return value.value if isinstance(value, Enum) else value


OTHER_RELEASE = "install the same release of m100link at both ends"


def agent_gone(reason: str, remedy: str = "") -> LinkError:
    """The error for an agent that has gone for good."""
    why = f": {reason}" if reason else ""
    remedy = remedy or "start it again; until then nothing here is up to date"
    return LinkError(f"the agent that owns the aircraft has gone{why}", remedy=remedy)


def agent_lost(gone: M100Error) -> LinkLost:
    """The error for an agent that goes before it has answered a question."""
    return LinkLost(
        f"{gone.seen}; it had been asked, and may have done it",
        cause="it was ended or killed, or the way to it was cut",
        remedy="look at the aircraft, and start the agent again",
    )


if not TYPE_CHECKING:
    __getattr__ = renamed(
        __name__, FromMobile="MobileMessage", Note="JournalNote", Outcome="OrderOutcome"
    )
