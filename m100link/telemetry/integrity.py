"""Whether the position that the aircraft reports can be true.

A position counts as fresh when it arrives. That does not make it true: a relay may repeat one
package for ever, a congested radio may deliver packages ever later, a receiver may jump or freeze.
So the monitor compares each position with the velocity of its package and with the time that passed
by the aircraft's clock. Repeated and late packages cannot fake that clock.

The monitor works only when asked, once for each newer package.
"""

from __future__ import annotations

import math
from enum import Enum
from typing import TYPE_CHECKING, Any, NamedTuple

from m100link.protocol.records import FlightPhase, FlightStatus, Position, Time, Velocity

if TYPE_CHECKING:
    from collections.abc import Callable

    from m100link.telemetry.sample import Sample

__all__ = ["Integrity", "IntegrityState"]


# -- the limits of warnings, which the console and the story of a flight share ---------------------


BATTERY_LOW = 25
"""Charge, %, from which down the aircraft warns. Set in the pilot's app; no command reads it, and
this is what the virtual aircraft has."""

BATTERY_CRITICAL = 10  # charge, %, from which down it lands by itself; the same holds for it

MAX_TELEMETRY_AGE = 1.0  # seconds without telemetry after which the aircraft counts as silent

GOOD_GPS = 3  # from this health on the autopilot holds a position (document 2.2.3.1)

_BATTERY_GAP = 2


def has_fix(position: Position) -> bool:
    """Whether GPS knows the place: it can be one, and its health is good or unknown."""
    health = position.gps_health
    return position.is_possible and (health is None or health >= GOOD_GPS)


def is_low(charge: int | None, limit: int) -> bool | None:
    """Whether a charge is below a limit; None between the two lines, or when it is not known.

    Between them lies a gap, so that a charge at the edge rings once.

    ``charge``: charge, %. ``limit``: from it down it is low, %.
    """
    if charge is None:
        return None
    return True if charge <= limit else False if charge >= limit + _BATTERY_GAP else None


# -- integrity -------------------------------------------------------------------------------------

GATE_M = 2.5
"""Metres by which position and velocity may disagree: PX4 lets GPS be off by 0.5 m
(EKF2_GPS_P_NOISE) and rejects what is more than five times as far off (EKF2_GPS_P_GATE)."""

_HEIGHT_GATE_M = 5.0  # barometers err more: ArduPilot takes 2 m for the noise (EK3_ALT_M_NSE)
# The same five times 0.3 m/s of velocity (EKF2_GPS_V_NOISE, EKF2_GPS_V_GATE): velocities that
# disagree for ever by more than 1.5 m/s reach the gate, smaller ones are forgotten faster.
_MEMORY_S = GATE_M / (5 * 0.3)
# The most that a trapezoid misses: the recorded flights of a Matrice 100 in
# caomuqing/mav_system_identification-DJI_M100_sysID accelerate with up to 7.4 m/s² (99 %), and a
# trapezoid over one second of them was off by 2.2 m at most.
_ACCELERATION_M_S2 = 7.0
_FASTEST_M_S = 25.0  # 22 m/s without wind, says the maker; and height changes slower than that
_MOVING_M_S = 0.3  # in those flights no velocity above it came twice
_DEAD_RECKONING_S = 1.0  # for so long a place may stand still although the aircraft says it moves
_UNCHECKED_S = 2.5  # after a longer gap nothing can be said about where it may be
_PROBATION_S = 3.0  # without a contradiction, before a place is believed again
_LATE_S = 0.5  # closed loops steer by nothing older
_LATE_FOR_S = 0.2  # what waited while this program was busy is read in a moment
_MAX_SKEW = 200e-6  # two crystals, each good to 100 ppm
_RATE_SEEN_S = 2.0  # in so many seconds the rate of a clock shows
_RATE_ERROR = 0.05
_LEAP_S = 2.0  # further no clock advances between two packages beyond what passed
_JITTER_S = 1.0  # by which arrivals may be off, where only they tell the time
_EARTH_M = 6_378_137.0
_MASK = (1 << 32) - 1
_HALF = 1 << 31
# Before it flies, heights have no meaning yet, and a receiver may still find its place.
_DOWN = (FlightPhase.STANDBY, FlightPhase.TAKING_OFF, FlightPhase.FINISHING_LANDING)


class IntegrityState(Enum):
    """The findings about telemetry as a whole."""

    UNKNOWN = "no place to judge: on the ground, poor GPS, or no position"
    GOOD = "the position agrees with velocity and time"
    CLOCK_STOPPED = "packages come, and the clock of the aircraft does not advance"
    LATE = "packages come later and later"
    JUMPED = "the position jumped further than the aircraft can fly"
    FROZEN = "the position stands still, and the aircraft says that it moves"
    INCONSISTENT = "position and velocity contradict each other"


class Integrity(NamedTuple):
    """Whether telemetry can be believed."""

    state: IntegrityState  #: The finding.
    seen: str = ""  #: The finding with its figures; empty while nothing is wrong.
    #: Horizontal distance between the position and where the velocity leads, divided by its limit;
    #: below 1 is fine (PX4 calls it innovation test ratio).
    test_ratio: float = 0.0
    height_test_ratio: float = 0.0  #: The same of the height.
    #: Delay of the newest package compared with the earliest ones, s; 0 while the aircraft's clock
    #: is not known.
    delay_s: float = 0.0

    @property
    def is_timely(self) -> bool:
        """Whether telemetry is new, and did not merely arrive just now."""
        return self.state not in (IntegrityState.CLOCK_STOPPED, IntegrityState.LATE)

    @property
    def is_plausible(self) -> bool:
        """Whether nothing contradicts the position."""
        return not self.is_timely or self.state in (IntegrityState.UNKNOWN, IntegrityState.GOOD)


class _Clock:
    """The clock of the aircraft: does it advance, and how late are its packages?

    A :class:`~m100link.telemetry.device_clock.DeviceClock` takes a delay that lasts for five
    seconds for a step of the clock. Here it stays a delay: until the line was silent for a second,
    which ends a flight anyway, or the aircraft restarted.

    ``stood_still_s``: for how long packages have come without an advance. ``late_for_s``: for how
    long that has been too much.
    """

    def __init__(self) -> None:
        self.now = 0.0  # seconds by it, unwrapped; what they count from changes with ``epoch``
        self.epoch = 0  # changes when times before and after cannot be compared
        self.is_trusted = False  # it runs as fast as the profile says
        self.stood_still_s = self.delay_s = self.late_for_s = 0.0
        self._sample: Sample | None = None
        self._tick = 0
        self._tick_hz = 1
        self._came_at = self._advanced_at = 0.0
        self._began: tuple[float, float] | None = None  # its time and ours
        self._floor = math.inf
        self._late_since: float | None = None

    def look(self, sample: Sample) -> None:
        """The newest package with a time."""
        if sample is self._sample:
            return
        is_first = self._sample is None
        self._sample = sample
        time, at = sample[Time], sample.received_at
        if is_first or time.tick_hz != self._tick_hz:
            self._tick, self._tick_hz = time.tick, time.tick_hz
            self._begin(at)
            self._advanced_at = at
            return
        step = self._step(time.tick)
        if 0.0 < step <= at - self._came_at + _LEAP_S:
            self._advance(step, time.tick, at)
            return
        if step < -1.0 or step > 0.0:  # it restarted, or is no clock: the next step will tell
            self._tick = time.tick
            self._begin(at)
        # Otherwise it was repeated, or overtaken on its way.
        self.stood_still_s = at - self._advanced_at

    def _step(self, tick: int) -> float:
        """Seconds from the newest tick to another one."""
        step = (tick - self._tick) & _MASK
        return ((step ^ _HALF) - _HALF) / self._tick_hz  # 32 bits with a sign

    def _begin(self, at: float) -> None:
        self.epoch += 1
        self.is_trusted = False
        self._began = (self.now, at)
        self._came_at = at
        self._expect_anew()

    def _expect_anew(self) -> None:
        self._floor = math.inf
        self._late_since = None

    def _advance(self, step: float, tick: int, at: float) -> None:
        if at - self._came_at > MAX_TELEMETRY_AGE:
            self._expect_anew()
        self.now += step
        self._tick = tick
        self._came_at = self._advanced_at = at
        self.stood_still_s = 0.0
        offset = at - self.now
        self._floor = min(self._floor + _MAX_SKEW * step, offset)
        self.delay_s = offset - self._floor
        if self.delay_s <= _LATE_S:
            self._late_since = None
        elif self._late_since is None:
            self._late_since = at
        self.late_for_s = 0.0 if self._late_since is None else at - self._late_since
        if not self.is_trusted:
            self._compare(at)

    def _compare(self, at: float) -> None:
        """A profile may be wrong about the rate, and nobody has measured it on each firmware."""
        began = self._began
        if began is None or at - began[1] < _RATE_SEEN_S:
            return
        rate = (self.now - began[0]) / (at - began[1])
        self.is_trusted = abs(rate - 1.0) < _RATE_ERROR
        if not self.is_trusted:
            self._began = (self.now, at)
            self._expect_anew()

    def time_of(self, sample: Sample) -> tuple[float, int]:
        """When a package was made, s, and in which epoch; by its arrival where it does not say."""
        if self.is_trusted:
            time = sample.get(Time)
            if time is not None and time.tick_hz == self._tick_hz:
                return self.now + self._step(time.tick), self.epoch
        return sample.received_at, -1


class _Fix(NamedTuple):
    """A place with its time and the velocity there, north, east and up."""

    at: float
    epoch: int
    latitude: float
    longitude: float
    height: float
    velocity: tuple[float, float, float] | None

    def to(self, later: _Fix) -> tuple[float, float, float]:
        """Metres north, east and up."""
        turn = math.remainder(later.longitude - self.longitude, 2 * math.pi)
        return (
            (later.latitude - self.latitude) * _EARTH_M,
            turn * _EARTH_M * math.cos(later.latitude),
            later.height - self.height,
        )


class IntegrityMonitor:
    """Compares items of telemetry with each other.

    ``first``: the first package with a time that ever came; None: none did.
    """

    def __init__(
        self,
        newest: Callable[[type[Any]], Sample | None],
        status: Callable[[], FlightStatus | None],  # the one that is believed
        first: Sample | None,
    ) -> None:
        self._newest = newest  # the newest package with an item
        self._status = status
        self._clock = _Clock()
        if first is not None:
            self._clock.look(first)
        self._looked_at: float | None = None
        self._integrity = Integrity(IntegrityState.UNKNOWN)
        self._placed: Sample | None = None
        self._moved: Sample | None = None
        self._fix: _Fix | None = None  # the newest place
        self._joint: _Fix | None = None  # the newest one with a velocity of its own
        # Where the place is, seen from where velocities lead: what is left of each difference
        # after _MEMORY_S is a third. Of the height for both signs of its velocity, which the
        # sources do not settle.
        self._north = self._east = self._up = self._down = 0.0
        self._ratio = self._height_ratio = 0.0
        self._still_s = self._level_s = 0.0  # for how long nothing moved that should have
        self._fault: tuple[IntegrityState, str] | None = None
        self._fault_ends_at = 0.0

    def look(self, newest_at: float | None) -> Integrity:
        """Return the finding at this moment; the newest package came then."""
        if newest_at == self._looked_at:
            return self._integrity
        self._looked_at = newest_at
        timed = self._newest(Time)
        if timed is not None:
            self._clock.look(timed)
        placed = self._newest(Position)
        if placed is not None and placed is not self._placed:
            self._placed = placed
            self._look_at_place(placed)
        self._integrity = self._found()
        return self._integrity

    def _found(self) -> Integrity:
        clock = self._clock
        found, seen = IntegrityState.GOOD, ""
        if clock.stood_still_s > MAX_TELEMETRY_AGE:
            found = IntegrityState.CLOCK_STOPPED
            seen = f"the clock of the aircraft has not advanced for {clock.stood_still_s:.1f} s"
        elif clock.is_trusted and clock.late_for_s > _LATE_FOR_S:
            found, seen = IntegrityState.LATE, f"telemetry comes {clock.delay_s:.1f} s late"
        elif self._fault is not None:
            found, seen = self._fault
        elif self._fix is None:
            found = IntegrityState.UNKNOWN
        delay = clock.delay_s if clock.is_trusted else 0.0
        return Integrity(found, seen, self._ratio, self._height_ratio, delay)

    def _look_at_place(self, sample: Sample) -> None:
        position = sample[Position]
        status = self._status()
        if not has_fix(position) or (status is not None and status.status in _DOWN):
            self._forget()
            self._fault = None
            return
        at, epoch = self._clock.time_of(sample)
        velocity = self._velocity(sample.received_at)
        here = _Fix(
            at, epoch, position.latitude_rad, position.longitude_rad, position.height_m, velocity
        )
        before = self._fix
        if before is None or before.epoch != epoch or not -1.0 < at - before.at < _UNCHECKED_S:
            self._forget()
            self._fix = self._joint = here
        else:
            self._compare(before, here, sample.received_at)
        if self._fault is not None and sample.received_at >= self._fault_ends_at:
            self._fault = None

    def _forget(self) -> None:
        self._fix = self._joint = None
        self._north = self._east = self._up = self._down = 0.0
        self._ratio = self._height_ratio = 0.0
        self._still_s = self._level_s = 0.0

    def _velocity(self, now: float) -> tuple[float, float, float] | None:
        """The velocity that the aircraft reports, while it vouches for it."""
        sample = self._newest(Velocity)
        if sample is None or now - sample.received_at > MAX_TELEMETRY_AGE:
            return None
        velocity = sample[Velocity]
        if velocity.is_valid is False or not all(map(math.isfinite, velocity[:3])):
            return None
        return velocity[0], velocity[1], velocity[2]

    def _compare(self, before: _Fix, here: _Fix, now: float) -> None:
        passed = max(0.0, here.at - before.at)
        north, east, up = before.to(here)
        way = math.hypot(north, east, up)
        if way > _FASTEST_M_S * (passed + (_JITTER_S if here.epoch < 0 else 0.0)) + GATE_M:
            jump = f"the position jumped by {way:.0f} m within {passed:.2f} s"
            self._blame(here, now, IntegrityState.JUMPED, jump)
            return
        if here.at <= before.at:
            return  # a package that was repeated, or overtaken
        self._fix = here
        velocity = here.velocity
        if velocity is None:
            self._joint = None
            self._still_s = self._level_s = 0.0
            return
        speed, climb = math.hypot(velocity[0], velocity[1]), abs(velocity[2])
        self._still_s = self._still_s + passed if north == east == 0.0 < speed else 0.0
        self._still_s *= speed > _MOVING_M_S
        self._level_s = self._level_s + passed if up == 0.0 and climb > _MOVING_M_S else 0.0
        if max(self._still_s, self._level_s) > _DEAD_RECKONING_S:
            what, said = ("position", speed) if self._still_s else ("height", climb)
            still = max(self._still_s, self._level_s)
            seen = f"the {what} stood still for {still:.1f} s at a velocity of {said:.1f} m/s"
            self._blame(here, now, IntegrityState.FROZEN, seen, is_still=True)
            return
        moved = self._newest(Velocity)
        if moved is not self._moved or self._joint is None:
            self._moved = moved
            self._innovate(here, now)

    def _innovate(self, here: _Fix, now: float) -> None:
        """Compare the way with the velocities at its ends."""
        joint, self._joint = self._joint, here
        if joint is None or joint.velocity is None or here.velocity is None:
            return
        passed = here.at - joint.at
        kept = math.exp(-passed / _MEMORY_S)
        way = joint.to(here)
        flown = [(a + b) / 2 * passed for a, b in zip(joint.velocity, here.velocity, strict=True)]
        self._north = self._north * kept + way[0] - flown[0]
        self._east = self._east * kept + way[1] - flown[1]
        self._up = self._up * kept + way[2] - flown[2]
        self._down = self._down * kept + way[2] + flown[2]
        more = _ACCELERATION_M_S2 * passed * passed / 2
        if here.epoch < 0:
            more += _JITTER_S * math.hypot(*here.velocity)
        apart = math.hypot(self._north, self._east)
        apart_up = min(abs(self._up), abs(self._down))
        self._ratio = apart / (GATE_M + more)
        self._height_ratio = apart_up / (_HEIGHT_GATE_M + more)
        if max(self._ratio, self._height_ratio) > 1.0:
            what, off = ("position", apart) if self._ratio > 1.0 else ("height", apart_up)
            seen = f"the {what} is {off:.1f} m from where the velocity leads"
            self._blame(here, now, IntegrityState.INCONSISTENT, seen)

    def _blame(
        self, here: _Fix, now: float, found: IntegrityState, seen: str, *, is_still: bool = False
    ) -> None:
        """Something is wrong, and stays so until nothing was for a while."""
        ratios, still = (self._ratio, self._height_ratio), (self._still_s, self._level_s)
        self._forget()
        self._fix = self._joint = here
        self._ratio, self._height_ratio = ratios
        if is_still:
            self._still_s, self._level_s = still
        self._fault = found, seen
        self._fault_ends_at = now + _PROBATION_S
