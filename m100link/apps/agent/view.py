"""The view of the aircraft that a front may believe at one moment: an old item is unknown.

A front takes :attr:`~m100link.apps.agent.client.AgentClient.view` where a step begins, and asks it
alone. Silence of the agent, an agent that is gone and values that are old are decided here and
nowhere else. How old an item may be stands in :data:`~m100link.telemetry.state.FRESH_S`, for the
agent's guards as well. Unknown is None, never an old number.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import Enum
from functools import partial
from typing import Any, TypeVar

from m100link.apps.agent.messages import LeaseChanged, State
from m100link.protocol.records import FlightPhase, FlightStatus, Position, RcMode, RemoteControl
from m100link.telemetry.integrity import GOOD_GPS, Integrity, IntegrityState
from m100link.telemetry.state import FRESH_S, STEER_S, AircraftState, is_possible

R = TypeVar("R", bound=tuple[Any, ...])

# Seconds without a word after which the agent counts as silent; it tells its state at 4 Hz.
MAX_SILENCE = 2.0
# Seconds for which an aircraft is heard that tells anything once a second.
HEARD_S = 1.2
# Seconds for which an item of another package belongs to this one.
TOGETHER_S = 0.3
# Seconds that a view is of one moment, if nothing arrives: no step of a front is shorter.
MOMENT_S = 0.005

_NOT_ASKED: Any = object()


class Hearing(Enum):
    """How a front hears the agent that owns the aircraft."""

    HEARD = "heard"
    SILENT = "silent"  # for more than 2 s; it may hang, and may speak again
    GONE = "gone"  # for good


@dataclass(frozen=True, slots=True)
class VehicleView:
    """One aircraft, as it may be believed to be at one moment; it does not change afterwards."""

    at: float  # the moment on the clock of the front, s
    heard_at: float  # when anything of the agent was heard last, by the same clock, s
    is_gone: bool  # whether the agent has gone
    state: State  # where the agent stands, as it reported last
    holder: LeaseChanged  # the holder of the lease, as reported last
    # Every arrival, however old: for statistics, and for previews of refusals. None while no
    # aircraft is connected.
    telemetry: AircraftState | None
    now: float = field(init=False)  # the moment on the clock of telemetry, s: a replay's own
    hearing: Hearing = field(init=False)
    is_connected: bool = field(init=False)  # the aircraft, by an agent that is heard
    has_authority: bool = field(init=False)  # whether setpoints and tasks are obeyed, by the same
    is_heard: bool = field(init=False)  # whether any telemetry is younger than a second or so
    _known: dict[Any, Any] = field(init=False, compare=False, repr=False)

    def __post_init__(self) -> None:
        say, state = partial(object.__setattr__, self), self.state
        replay, telemetry = state.replay, self.telemetry
        now = self.at if replay is None else replay.time(self.at - state.at)
        # A time that is none, and one that is to come, is no word of anybody.
        is_there = not self.is_gone and abs(self.at - self.heard_at) <= MAX_SILENCE
        is_connected = is_there and state.connection == "connected"
        newest_at = None if telemetry is None else telemetry.newest_at
        say("now", now)
        heard = Hearing.HEARD if is_there else Hearing.SILENT
        say("hearing", Hearing.GONE if self.is_gone else heard)
        say("is_connected", is_connected)
        say("has_authority", is_there and state.has_authority)
        is_new = newest_at is not None and abs(now - newest_at) <= HEARD_S
        say("is_heard", is_connected and is_new)
        say("_known", {})

    @property
    def connection(self) -> str:
        """As the agent reported it, or ``"silent"`` while the agent may hang."""
        return "silent" if self.hearing is Hearing.SILENT else self.state.connection

    # -- its items -------------------------------------------------------------------------------

    def get(self, record: type[R]) -> R | None:
        """The newest value of an item; None when it is old, impossible, or the agent is silent."""
        known: R | None = self._known.get(record, _NOT_ASKED)
        if known is _NOT_ASKED:
            known = self._known[record] = self._within(record, FRESH_S[record])
        return known

    def to_steer_by(self, record: type[R]) -> R | None:
        """The same where a loop is closed over it: none that is older than half a second."""
        return self._within(record, STEER_S)

    def together(self, record: type[R]) -> R | None:
        """The same where it is shown together with another item that has just arrived."""
        return self._within(record, TOGETHER_S)

    def _within(self, record: type[R], seconds: float) -> R | None:
        if self.telemetry is None or not self.is_connected:
            return None
        found = self.telemetry.fresh(record, within=seconds, now=self.now)
        return found if found is not None and is_possible(found) else None

    def age(self, record: type[Any]) -> float | None:
        """Seconds since an item arrived, None when it never did."""
        at = None if self.telemetry is None else self.telemetry.received_at(record)
        return None if at is None else self.now - at

    def is_new(self, record: type[Any]) -> bool:
        """Whether an item arrives, whatever it says."""
        age = self.age(record)
        return self.is_connected and age is not None and abs(age) <= FRESH_S[record]

    def rate_hz(self, record: type[Any]) -> float:
        """How often an item arrives, per second; 0 where it does not any more."""
        age = self.age(record)
        if self.telemetry is None or age is None or not abs(age) <= HEARD_S:
            return 0.0
        return self.telemetry.statistics(record).rate_hz or 0.0

    @property
    def telemetry_at(self) -> float | None:
        """When any telemetry arrived, by the clock of telemetry, s; None when none ever did."""
        return None if self.telemetry is None else self.telemetry.newest_at

    @property
    def integrity(self) -> Integrity:
        """Whether the reported navigation can be true."""
        if self.telemetry is None:
            return Integrity(IntegrityState.UNKNOWN)
        return self.telemetry.integrity

    # -- conclusions -----------------------------------------------------------------------------

    @property
    def phase(self) -> FlightPhase | None:
        """On the ground or in the air; None when nobody knows."""
        status = self.get(FlightStatus)
        return None if status is None else status.phase

    @property
    def is_on_ground(self) -> bool | None:
        """Whether the motors stand; None when nobody knows, which counts as in the air."""
        known: bool | None = self._known.get("ground", _NOT_ASKED)
        if known is _NOT_ASKED:
            status = self.get(FlightStatus)
            known = None if status is None else status.status == FlightPhase.STANDBY
            self._known["ground"] = known
        return known

    @property
    def is_airborne(self) -> bool:
        """Whether it is seen to be off the ground: setpoints move it."""
        status = self.get(FlightStatus)
        return status is not None and status.is_airborne

    @property
    def place(self) -> Position | None:
        """Where it is, if GPS says that it is good enough; where it says nothing, it is not."""
        found = self.get(Position)
        return found if found is not None and (found.gps_health or 0) >= GOOD_GPS else None

    @property
    def switch(self) -> RcMode | None:
        """The pilot's mode switch; None when nobody knows."""
        remote = self.get(RemoteControl)
        return None if remote is None else remote.mode_switch
