"""How far the virtual aircraft is from a recorded one, and the airframe that comes nearest to it.

The recorded movement commands are flown by the flight controller of the virtual aircraft, on
virtual time, from the recorded state at the beginning of each span of flight. A span ends where the
commands pause, where the aircraft stands or touches the ground, and where telemetry has a gap: a
virtual aircraft that is a little lower would touch the ground at another time.
"""

from __future__ import annotations

import math
from bisect import bisect_left, bisect_right
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from operator import mul
from statistics import median, pstdev
from typing import NamedTuple

from m100link.errors import UsageError
from m100link.protocol.records import Device
from m100link.protocol.setpoint import Horizontal, ReceivedMove, ReferenceFrame, Vertical, Yaw
from m100link.sim.vehicle.dynamics import RANGES, STEP_S, Airframe
from m100link.sim.vehicle.flight import FlightController
from m100link.sim.vehicle.remote import PilotRemote
from m100link.sim.vehicle.settings import AircraftSettings

# -- recordings ------------------------------------------------------------------------------------

Series = list[tuple[float, ...]]
"""Rows in order of time: seconds, then values."""


@dataclass(slots=True, kw_only=True)
class FlightRecording:
    """A flight as it was commanded and measured. Axes and signs are those of the document.

    Times are seconds of any one clock.
    """

    name: str  #: For people.
    #: Movement commands, and when they were sent.
    moves: list[tuple[float, ReceivedMove]] = field(default_factory=list)
    attitude: Series = field(default_factory=list)  #: Roll, pitch and yaw, rad.
    velocity: Series = field(default_factory=list)  #: North, east and up, m/s.
    rates: Series = field(default_factory=list)  #: Angular velocity about the body axes, rad/s.
    #: Three axes of any frame, m/s². Only its noise is looked at.
    acceleration: Series = field(default_factory=list)
    height: Series = field(default_factory=list)  #: Metres above take-off; may be empty.
    battery: Series = field(default_factory=list)  #: Percent; may be empty.
    flying: Series = field(default_factory=list)  #: 1 in the air and 0 elsewhere; may be empty.


_GAP_S = 0.5  # as long as the aircraft flies on without a movement command
_SHORTEST_S = 1.5
_STILL = 0.02  # m/s: slower in all axes for longer than a gap, it stands
_BOUNCE, _BOUNCE_RATE = 0.3, 20.0  # m/s and m/s²: upwards so fast no thrust changes it
_SAME_S = 1e-6  # two times that differ less are one, whatever the clock
_HIGH = 1000.0  # metres: where the height of a recording is not known, no drift reaches the ground


class TimeSpan(NamedTuple):
    """A part of a recording in which movement commands fly the aircraft, s."""

    begin: float
    end: float


def _time(row: tuple[float, ...]) -> float:
    return row[0]


def spans(recording: FlightRecording) -> list[TimeSpan]:
    """The parts of a recording that can be flown again."""
    sent = [at for at, _ in recording.moves]
    seen = [row[0] for row in recording.attitude]
    found: list[TimeSpan] = []
    begin = end = math.nan
    still_since = math.inf
    for before, row in pairwise(recording.velocity):
        now, past = row[0], row[0] - before[0]
        is_still = max(map(abs, row[1:4])) < _STILL
        still_since = min(still_since, now) if is_still else math.inf
        rises = row[3] - before[3]
        is_flown = (
            0.0 < past < _GAP_S
            and not (rises > _BOUNCE and rises > _BOUNCE_RATE * past)
            and now - still_since < _GAP_S
            and _is_near(sent, now)
            and _is_near(seen, now)
            and _newest(recording.flying, now, 1.0) != 0.0
        )
        if is_flown and begin == begin:
            end = now
            continue
        if end - begin >= _SHORTEST_S:
            found.append(TimeSpan(begin, end))
        begin, end = (now, now) if is_flown else (math.nan, math.nan)
    if end - begin >= _SHORTEST_S:
        found.append(TimeSpan(begin, end))
    return found


def _is_near(times: Sequence[float], now: float) -> bool:
    """Whether something came within a gap before."""
    place = bisect_right(times, now)
    return place > 0 and now - times[place - 1] < _GAP_S


def _newest(series: Series, now: float, without: float) -> float:
    place = bisect_right(series, now, key=_time)
    return series[place - 1][1] if place else without


def _at(series: Series, now: float) -> tuple[float, ...]:
    """The values at a time, between two rows in proportion; an angle takes the short way."""
    place = min(max(1, bisect_left(series, now, key=_time)), len(series) - 1)
    before, after = series[place - 1], series[place]
    share = min(1.0, max(0.0, (now - before[0]) / ((after[0] - before[0]) or 1.0)))
    return tuple(one + share * (two - one) for one, two in zip(before[1:], after[1:], strict=True))


def _unwrapped(attitude: Series) -> Series:
    """The same attitude with a yaw that does not jump."""
    found: Series = []
    for at, roll, pitch, yaw in attitude:
        if found:
            yaw = found[-1][3] + math.remainder(yaw - found[-1][3], math.tau)
        found.append((at, roll, pitch, yaw))
    return found


# -- the same commands, flown by the virtual aircraft ----------------------------------------------

SIGNALS = {
    **{"roll": "°", "pitch": "°", "yaw": "°"},
    **{"north": "m/s", "east": "m/s", "up": "m/s"},
}
"""The compared signals and their units: attitude, and velocity over ground."""

Row = tuple[float, ...]  # one value of each signal


class SpanFlight(NamedTuple):
    """A span as it was recorded and as the virtual aircraft flies it, a row for each step."""

    times: list[float]  # of the rows, s by the recording
    recorded: list[Row]
    flown: list[Row]


class _Replay:
    """One span, prepared once and flown with many airframes."""

    def __init__(self, recording: FlightRecording, attitude: Series, span: TimeSpan) -> None:
        self.times = [
            span.begin + step * STEP_S for step in range(1, int((span.end - span.begin) / STEP_S))
        ]
        self._start = _at(attitude, span.begin)
        around = [step * STEP_S for step in range(-5, 6)]
        rows = [_at(attitude, span.begin + one) for one in around]
        square = sum(map(mul, around, around))
        self._turning = tuple(
            sum(map(mul, around, axis)) / square for axis in zip(*rows, strict=True)
        )
        self._velocity = _at(recording.velocity, span.begin)
        first = bisect_left(recording.moves, span.begin - 2.0, key=lambda move: move[0])
        last = bisect_left(recording.moves, span.end, key=lambda move: move[0])
        self.moves = recording.moves[first:last]
        by_height = any(move.mode.vertical is Vertical.HEIGHT for _, move in self.moves)
        self._height = _HIGH
        if by_height and recording.height:
            self._height = _newest(recording.height, span.begin, recording.height[0][1])
        self._battery = [_newest(recording.battery, now, 100.0) for now in self.times]
        self.recorded: list[Row] = []
        for now in self.times:
            angles, velocity = _at(attitude, now), _at(recording.velocity, now)
            self.recorded.append((*map(math.degrees, angles), *velocity[:3]))

    def fly(self, airframe: Airframe) -> list[Row]:
        """The signals, a row for each step; dead time between steps is between two flights."""
        steps = airframe.command_delay / STEP_S
        whole = math.floor(steps + _SAME_S)
        rows = self._fly(replace(airframe, command_delay=whole * STEP_S))
        share = steps - whole
        if share <= _SAME_S:
            return rows
        later = self._fly(replace(airframe, command_delay=(whole + 1) * STEP_S))
        return [
            tuple(a + share * (b - a) for a, b in zip(one, two, strict=True))
            for one, two in zip(rows, later, strict=True)
        ]

    def _fly(self, airframe: Airframe) -> list[Row]:
        control = FlightController(AircraftSettings(height_limit=math.inf), airframe)
        motion, remote = control.dynamics, PilotRemote()
        motion.place(0.0, 0.0, self._height)
        motion.resume(self._start, self._turning, self._velocity)  # type: ignore[arg-type] # three each
        moves, place, rows = self.moves, 0, []
        heading = self._start[2]
        for now, battery in zip(self.times, self._battery, strict=True):
            while place < len(moves) and moves[place][0] <= now - STEP_S + _SAME_S:
                control.now, move = moves[place]
                control.move(move)
                place += 1
            control.battery_percent = battery
            control.step(now, Device.ONBOARD, remote)
            heading += math.remainder(motion.yaw - heading, math.tau)
            angles = motion.roll, motion.pitch, heading
            velocity = motion.velocity_north, motion.velocity_east, motion.velocity_up
            rows.append((*map(math.degrees, angles), *velocity))
        return rows


def _kind(mode: Horizontal | Vertical | Yaw) -> str:
    return f"{type(mode).__name__}.{mode.name}"


class ReplayedSpans:
    """All spans of some recordings, to be flown with one airframe or another.

    Raises:
        UsageError: None of them has a span that can be flown.
    """

    def __init__(self, recordings: Iterable[FlightRecording]) -> None:
        self._replays: list[_Replay] = []
        self.recordings = list(recordings)
        for recording in self.recordings:
            attitude = _unwrapped(recording.attitude)
            for span in spans(recording):
                self._replays.append(_Replay(recording, attitude, span))
        if not self._replays:
            names = ", ".join(one.name for one in self.recordings)
            raise UsageError(
                f"no flight under movement commands in {names}",
                cause="commands, attitude or velocity are missing, or the aircraft never moved",
                remedy="record a flight by setpoints, with attitude and velocity",
            )
        moves = [move for one in self._replays for _, move in one.moves]
        # By name, for values of the three enumerations are equal as numbers.
        self.tilts_over_ground = any(
            one.mode.horizontal is Horizontal.TILT and one.frame is ReferenceFrame.GROUND
            for one in moves
        )
        self.kinds = frozenset(_kind(mode) for move in moves for mode in move.mode)

    @property
    def recorded(self) -> list[list[Row]]:
        """The recorded signals of each span, a row for each step."""
        return [one.recorded for one in self._replays]

    def fly(self, airframe: Airframe) -> list[SpanFlight]:
        """Fly all spans."""
        return [SpanFlight(one.times, one.recorded, one.fly(airframe)) for one in self._replays]


# -- residuals -------------------------------------------------------------------------------------

_MOST_LAG = round(0.5 / STEP_S)


class Residual(NamedTuple):
    """How far one signal of the virtual aircraft is from the recorded one."""

    signal: str  #: Its name, of :data:`SIGNALS`.
    unit: str  #: Of the two next.
    rms: float  #: Root of the mean square of the difference.
    deviation: float  #: Standard deviation of the recorded signal.
    correlation: float  #: Between the two, −1 to 1; NaN where one of them never changes.
    delay_s: float  #: The recorded signal is best correlated when it is taken so much later, s.


def residuals(flights: Sequence[SpanFlight]) -> list[Residual]:
    """The residual of each signal over all spans."""
    found = []
    for place, (signal, unit) in enumerate(SIGNALS.items()):
        pairs = [
            ([row[place] for row in one.recorded], [row[place] for row in one.flown])
            for one in flights
        ]
        count = sum(len(recorded) for recorded, _ in pairs)
        square = sum(math.dist(*pair) ** 2 for pair in pairs)
        recorded = [value for one, _ in pairs for value in one]
        mean = math.fsum(recorded) / count
        deviation = math.sqrt(sum((value - mean) ** 2 for value in recorded) / count)
        best = max(
            range(-_MOST_LAG, _MOST_LAG + 1),
            key=lambda lag: (_correlation(pairs, lag), -abs(lag)),
        )
        rms, alike = math.sqrt(square / count), _correlation(pairs, 0)
        found.append(Residual(signal, unit, rms, deviation, alike, best * STEP_S))
    return found


def _correlation(pairs: Sequence[tuple[list[float], list[float]]], lag: int) -> float:
    """Of all pairs together, the first of each taken so many steps later."""
    one: list[float] = []
    two: list[float] = []
    for recorded, flown in pairs:
        length = len(recorded) - abs(lag)
        if length > 0:
            one += recorded[max(0, lag) :][:length]
            two += flown[max(0, -lag) :][:length]
    count = len(one) or 1
    mean_one, mean_two = sum(one) / count, sum(two) / count
    together = sum(map(mul, one, two)) - count * mean_one * mean_two
    alone = (sum(map(mul, one, one)) - count * mean_one**2) * (
        sum(map(mul, two, two)) - count * mean_two**2
    )
    return together / math.sqrt(alone) if alone > 1e-12 else math.nan


_STRETCH_S, _LEAST_ROWS = 2.0, 50
_TURNS = math.radians(1.0)  # more, and motion is in the noise


def noise_of(series: Series, attitude: Series) -> float | None:
    """Standard deviation of the noise of a sensor; None where the aircraft never rests.

    That of stretches of two seconds in which no angle changes by a degree, in the middle. Rows that
    repeat the last one are left out, because telemetry may be faster than the sensor.
    """
    rows = [two for one, two in pairwise(series) if one[1:] != two[1:]]
    found: list[float] = []
    begin = 0
    while begin < len(rows):
        since = rows[begin][0]
        end = bisect_left(rows, since + _STRETCH_S, key=_time)
        first, last = (bisect_left(attitude, at, key=_time) for at in (since, since + _STRETCH_S))
        turns = attitude[first:last]
        rests = len(turns) > 1 and all(
            max(axis) - min(axis) < _TURNS for axis in list(zip(*turns, strict=True))[1:]
        )
        if rests and end - begin >= _LEAST_ROWS:
            found += map(pstdev, list(zip(*rows[begin:end], strict=True))[1:])
        begin = end
    return median(found) if found else None


# -- the fit ---------------------------------------------------------------------------------------
# Gauss and Newton with the damping of Levenberg and Marquardt, a stage at a time. Derivatives are
# differences, with a step for each constant.

_ATTITUDE, _YAW, _VELOCITY = slice(0, 2), slice(2, 3), slice(3, 6)
_EVERY = 3  # steps from one row of the fit to the next
_MOST_ROUNDS = 25
_SETTLED = 0.02  # after a round that improves by less, the steps of derivatives are smaller
_FINEST = 0.01  # of the steps of the table


class _Constant(NamedTuple):
    name: str
    step: float
    kinds: tuple[Horizontal | Vertical | Yaw, ...]  # the commands that show it


_STAGES: tuple[tuple[slice, tuple[_Constant, ...]], ...] = (
    (
        _ATTITUDE,
        (
            _Constant("command_delay", 0.03, (Horizontal.TILT,)),
            _Constant("tilt_frequency", 0.5, (Horizontal.TILT,)),
            _Constant("tilt_damping", 0.05, (Horizontal.TILT,)),
            _Constant("maximum_tilt_deg", 1.0, (Horizontal.TILT,)),
        ),
    ),
    (
        _YAW,
        (
            _Constant("yaw_time_constant", 0.03, (Yaw.RATE,)),
            _Constant("yaw_gain", 0.2, (Yaw.ANGLE,)),
            _Constant("yaw_rate_deg", 5.0, (Yaw.RATE, Yaw.ANGLE)),
        ),
    ),
    (
        _VELOCITY,
        (
            _Constant("hover_thrust", 1.0, (Vertical.THRUST,)),
            _Constant("empty_hover_thrust", 2.0, (Vertical.THRUST,)),
            _Constant("thrust_exponent", 0.1, (Vertical.THRUST,)),
            _Constant("vertical_drag", 0.05, (Vertical.THRUST,)),
            _Constant("drag", 0.05, (Horizontal.TILT,)),
            _Constant("velocity_gain", 0.2, (Horizontal.VELOCITY,)),
            _Constant("horizontal_speed", 1.0, (Horizontal.VELOCITY,)),
            _Constant("position_gain", 0.1, (Horizontal.POSITION_OFFSET,)),
            _Constant("position_speed", 0.5, (Horizontal.POSITION_OFFSET,)),
            _Constant("vertical_time_constant", 0.05, (Vertical.VELOCITY, Vertical.HEIGHT)),
            _Constant("vertical_speed", 0.5, (Vertical.VELOCITY, Vertical.HEIGHT)),
            _Constant("height_gain", 0.2, (Vertical.HEIGHT,)),
        ),
    ),
)
_DELAY = _Constant("command_delay", 0.03, (Horizontal.VELOCITY, Vertical.VELOCITY))
_LIMITS: dict[str, tuple[int, ...]] = {
    **{"maximum_tilt_deg": (0, 1), "horizontal_speed": (3, 4), "vertical_speed": (5,)}
}
"""Limits, and the signals that stay below them: their search begins where these end."""
_BLUNT = 10.0  # steps: a constant with a larger error is not known
_SENSITIVE = 0.01  # degrees or m/s, rms, for one step of a constant: less, and nothing shows it
_BATTERY_SPAN = 10.0  # percent: with less in a recording, thrust by battery cannot be seen


class Found(NamedTuple):
    """A constant of the airframe as the recordings show it."""

    name: str  #: Field of the airframe.
    before: float  #: Its value at the start.
    value: float  #: Its value now.
    error: float  #: Standard error, by the residuals and how they hang together.


class Fit(NamedTuple):
    """The airframe that comes nearest to some recordings."""

    airframe: Airframe  #: All its numbers; those that nothing showed are those of the start.
    found: list[Found]  #: The others.


def fit(
    replays: ReplayedSpans, start: Airframe, progress: Callable[[str], None] | None = None
) -> Fit:
    """Find the constants that the recordings show, from those of an airframe.

    Args:
        replays: The recordings.
        start: The airframe that has all else.
        progress: Hears the name of each stage.
    """
    airframe = start
    found: list[Found] = []
    # Tilt in the ground frame turns with the nose: its stage comes again when yaw is known.
    stages = (*_STAGES[:2], *_STAGES) if replays.tilts_over_ground else _STAGES
    for signals, constants in stages:
        found = [one for one in found if one.name not in {each.name for each in constants}]
        names = [one for one in constants if _is_shown(one, replays)]
        if signals is _VELOCITY and all(one.name != "command_delay" for one in found):
            names += [_DELAY] if _is_shown(_DELAY, replays) else []
        if progress is not None and names:
            progress(", ".join(one.name for one in names))
        begin = airframe
        errors: dict[str, float] = {}
        while names:
            guess = _with_limits(replays, begin, [one.name for one in names])
            airframe, errors = _nearest(replays, guess, names, signals)
            shown = [one for one in names if errors.get(one.name, math.inf) < _BLUNT * one.step]
            if len(shown) == len(names):
                break
            airframe, names, errors = begin, shown, {}  # without those that nothing shows
        found += [
            Found(name, getattr(start, name), getattr(airframe, name), error)
            for name, error in errors.items()
        ]
    for name, value in _noises(replays.recordings):
        airframe = replace(airframe, **{name: value})
        found.append(Found(name, getattr(start, name), value, 0.1 * value))
    return Fit(airframe, found)


def _with_limits(replays: ReplayedSpans, airframe: Airframe, names: Sequence[str]) -> Airframe:
    for name in names:
        if name in _LIMITS:
            seen = sorted(
                abs(row[place])
                for one in replays.recorded
                for row in one
                for place in _LIMITS[name]
            )
            low, high = RANGES[name]
            most = seen[len(seen) * 99 // 100]
            airframe = replace(airframe, **{name: min(high, max(low, most))})
    return airframe


def _is_shown(constant: _Constant, replays: ReplayedSpans) -> bool:
    if constant.name == "empty_hover_thrust":
        charges = [row[1] for one in replays.recordings for row in one.battery]
        if not charges or max(charges) - min(charges) < _BATTERY_SPAN:
            return False
    return not replays.kinds.isdisjoint(map(_kind, constant.kinds))


def _noises(recordings: Sequence[FlightRecording]) -> Iterator[tuple[str, float]]:
    for name, rows in (("gyro_noise", "rates"), ("accelerometer_noise", "acceleration")):
        values = [noise_of(getattr(one, rows), _unwrapped(one.attitude)) for one in recordings]
        known = [value for value in values if value is not None]
        if known:
            yield name, min(RANGES[name][1], median(known))


def _nearest(
    replays: ReplayedSpans, airframe: Airframe, constants: Sequence[_Constant], signals: slice
) -> tuple[Airframe, dict[str, float]]:
    """The nearest airframe by some constants, and the standard errors of those that show."""

    def difference(candidate: Airframe) -> list[float]:
        return [
            flown - recorded
            for one in replays.fly(candidate)
            for seen, made in zip(one.recorded[::_EVERY], one.flown[::_EVERY], strict=True)
            for recorded, flown in zip(seen[signals], made[signals], strict=True)
        ]

    now = difference(airframe)
    error = sum(map(mul, now, now))
    damping, scale = 1e-3, 1.0
    errors: dict[str, float] = {}
    for _ in range(_MOST_ROUNDS if constants else 0):
        slopes: dict[str, list[float]] = {}
        for one in constants:
            moved = _moved(airframe, one.name, scale * one.step)
            step = getattr(moved, one.name) - getattr(airframe, one.name)
            slope = [(new - old) / step for new, old in zip(difference(moved), now, strict=True)]
            if math.sqrt(sum(map(mul, slope, slope)) / len(slope)) * one.step > _SENSITIVE:
                slopes[one.name] = slope
        if not slopes:
            break
        normal = [[sum(map(mul, a, b)) for b in slopes.values()] for a in slopes.values()]
        pull = [-sum(map(mul, slope, now)) for slope in slopes.values()]
        errors = _standard_errors(list(slopes), normal, now, len(range(*signals.indices(6))))
        before = error
        while damping < 1e6:
            damped = [
                [value * (1.0 + damping) if i == j else value for j, value in enumerate(row)]
                for i, row in enumerate(normal)
            ]
            candidate = airframe
            for name, step in zip(slopes, _solve(damped, pull), strict=True):
                candidate = _moved(candidate, name, step)
            there = difference(candidate)
            new = sum(map(mul, there, there))
            if new < error:
                airframe, now, error, damping = candidate, there, new, damping / 10.0
                break
            damping *= 10.0
        if before - error < _SETTLED * before:
            scale, damping = scale / 4.0, 1e-3
            if scale < _FINEST:
                break
    return airframe, errors


def _moved(airframe: Airframe, name: str, step: float) -> Airframe:
    low, high = RANGES[name]
    value = getattr(airframe, name)
    if value + step > high or value + step < low:
        step = min(high, max(low, value + step)) - value or -step
    return replace(airframe, **{name: value + step})


def _standard_errors(
    names: Sequence[str], normal: list[list[float]], now: list[float], width: int
) -> dict[str, float]:
    """Of residuals that resemble the one before, as many count as would be independent."""
    square = sum(map(mul, now, now)) or 1e-12
    alike = min(0.999, max(0.0, sum(map(mul, now, now[width:])) / square))
    variance = square / len(now) * (1.0 + alike) / (1.0 - alike)
    found = {}
    for place, name in enumerate(names):
        unit = [float(place == other) for other in range(len(names))]
        found[name] = math.sqrt(max(0.0, _solve(normal, unit)[place] * variance))
    return found


def _solve(matrix: list[list[float]], right: list[float]) -> list[float]:
    """A small symmetric system, by elimination; a row of nothing gives 0."""
    rows = [[*row, value] for row, value in zip(matrix, right, strict=True)]
    size = len(rows)
    for place in range(size):
        pivot = max(range(place, size), key=lambda row: abs(rows[row][place]))
        rows[place], rows[pivot] = rows[pivot], rows[place]
        if abs(rows[place][place]) < 1e-12:
            continue
        for other in range(size):
            if other != place:
                share = rows[other][place] / rows[place][place]
                rows[other] = [a - share * b for a, b in zip(rows[other], rows[place], strict=True)]
    return [
        row[-1] / row[place] if abs(row[place]) >= 1e-12 else 0.0 for place, row in enumerate(rows)
    ]
