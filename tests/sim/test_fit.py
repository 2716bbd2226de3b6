"""The ruler: hidden constants are found, and residuals are those of hand-made signals."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise
from random import Random
from types import SimpleNamespace
from typing import Any, cast

import pytest

from m100link.errors import UsageError
from m100link.protocol.records import Device
from m100link.protocol.setpoint import (
    ControlMode,
    Horizontal,
    ReceivedMove,
    ReferenceFrame,
    Vertical,
    Yaw,
)
from m100link.sim import AircraftSettings, Airframe, PilotRemote
from m100link.sim.fit import (
    _STAGES,
    FlightRecording,
    Found,
    ReplayedSpans,
    Series,
    SpanFlight,
    _at,
    _correlation,
    _is_shown,
    _moved,
    _nearest,
    _newest,
    _noises,
    _Replay,
    _solve,
    _standard_errors,
    _with_limits,
    fit,
    noise_of,
    residuals,
    spans,
)
from m100link.sim.vehicle.flight import FlightController

BY_TILT = ControlMode(Horizontal.TILT, Vertical.THRUST, Yaw.RATE)
BY_VELOCITY = ControlMode(Horizontal.VELOCITY, Vertical.VELOCITY, Yaw.RATE)
STEP = 0.01


def recorded(
    airframe: Airframe,
    moves: list[tuple[float, ReceivedMove]],
    *,
    begin_s: float = 100.0,
    battery: tuple[float, float] = (100.0, 100.0),  # from, to
    noise: Random | None = None,  # 0.1 degrees, 0.02 m/s and the sensors of the airframe
) -> FlightRecording:
    """What an aircraft with that airframe does; its clock begins anywhere."""
    control = FlightController(AircraftSettings(height_limit=1e6), airframe)
    motion, remote = control.dynamics, PilotRemote()
    motion.place(0.0, 0.0, 500.0)
    found = FlightRecording(name="made")
    steps, waiting = round(moves[-1][0] / STEP), list(moves)

    def off(deviation: float) -> float:
        return noise.gauss(0.0, deviation) if noise else 0.0

    for step in range(steps):
        while waiting and waiting[0][0] <= step * STEP:
            at, move = waiting.pop(0)
            control.move(move)
            found.moves.append((begin_s + at, move))
        control.battery_percent = battery[0] + (battery[1] - battery[0]) * step / steps
        control.step((step + 1) * STEP, Device.ONBOARD, remote)
        at = begin_s + (step + 1) * STEP
        angles = motion.roll, motion.pitch, motion.yaw
        found.attitude.append((at, *(one + off(math.radians(0.1)) for one in angles)))
        velocity = motion.velocity_north, motion.velocity_east, motion.velocity_up
        found.velocity.append((at, *(one + off(0.02) for one in velocity)))
        rates = motion.rate_x, motion.rate_y, motion.rate_z
        found.rates.append((at, *(one + off(airframe.gyro_noise) for one in rates)))
        found.battery.append((at, float(math.ceil(control.battery_percent))))
    return found


def steering(
    seed: int, seconds: float, mode: ControlMode, most: float, middle: float, beside: float
) -> list[tuple[float, ReceivedMove]]:
    """Drawn steps of all values at 50 Hz: horizontal up to most, vertical around the middle."""
    print("seed", seed)  # noqa: T201 (for a test that fails)
    chance = Random(seed)
    moves = []
    x = y = yaw = 0.0
    z = middle
    for number in range(round(seconds * 50)):
        if number % 40 == 0:
            x, y = chance.uniform(-most, most), chance.uniform(-most, most)
        if number % 60 == 0:
            z, yaw = middle + chance.uniform(-beside, beside), chance.uniform(-60.0, 60.0)
        moves.append((number / 50, ReceivedMove(mode, x, y, z, yaw, ReferenceFrame.BODY)))
    return moves


HIDDEN = Airframe(
    command_delay=0.13,
    tilt_frequency=7.0,
    tilt_damping=0.6,
    maximum_tilt_deg=33.0,
    hover_thrust=41.0,
    thrust_exponent=0.8,
    vertical_drag=0.2,
    drag=0.15,
    yaw_time_constant=0.3,
    gyro_noise=0.002,
)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2])
def test_hidden_constants_are_found_from_tilt_and_thrust(seed: int) -> None:
    moves = steering(seed, 20.0, BY_TILT, 45.0, 46.0, 6.0)
    seen = recorded(HIDDEN, moves, noise=Random(seed))
    found = fit(ReplayedSpans([seen]), Airframe())
    for name, near in {
        **{"command_delay": 0.006, "tilt_frequency": 0.2, "tilt_damping": 0.02},
        **{"maximum_tilt_deg": 0.2, "hover_thrust": 0.2, "thrust_exponent": 0.03},
        **{"vertical_drag": 0.03, "drag": 0.01, "yaw_time_constant": 0.02},
    }.items():
        value = getattr(found.airframe, name)
        assert value == pytest.approx(getattr(HIDDEN, name), abs=near), name
    assert {one.name for one in found.found} >= {"drag", "tilt_damping", "yaw_time_constant"}
    # What nothing in the recording shows is that of the start, and is not told as found.
    assert found.airframe.velocity_gain == 1.6
    assert "velocity_gain" not in {one.name for one in found.found}
    for one in residuals(ReplayedSpans([seen]).fly(found.airframe)):
        assert one.rms < (0.3 if one.unit == "°" else 0.1), one.signal


@pytest.mark.slow
def test_hidden_constants_are_found_from_velocities() -> None:
    hidden = Airframe(
        command_delay=0.2, velocity_gain=1.1, vertical_time_constant=0.6, horizontal_speed=6.0
    )
    seen = recorded(hidden, steering(3, 20.0, BY_VELOCITY, 8.0, 0.0, 3.0), noise=Random(3))
    found = {one.name: one for one in fit(ReplayedSpans([seen]), Airframe()).found}
    # Twenty seconds with noise: each is as near as its own standard error says, and that is small.
    for name, most in {
        **{"command_delay": 0.03, "velocity_gain": 0.2},
        **{"vertical_time_constant": 0.1, "horizontal_speed": 0.4},
    }.items():
        one = found[name]
        assert abs(one.value - getattr(hidden, name)) < 2 * one.error < 2 * most, name


@pytest.mark.slow
def test_thrust_by_battery_is_found_where_the_battery_empties() -> None:
    hidden = replace(HIDDEN, hover_thrust=39.0, empty_hover_thrust=45.0)
    moves = steering(4, 20.0, BY_TILT, 20.0, 43.0, 6.0)
    begin = replace(HIDDEN, hover_thrust=43.0, empty_hover_thrust=43.0)
    found = fit(ReplayedSpans([recorded(hidden, moves, battery=(100.0, 10.0))]), begin).airframe
    assert found.hover_thrust == pytest.approx(39.0, abs=0.3)
    assert found.empty_hover_thrust == pytest.approx(45.0, abs=0.5)
    full = fit(ReplayedSpans([recorded(hidden, moves)]), begin)
    assert "empty_hover_thrust" not in {one.name for one in full.found}


def test_a_limit_that_no_command_reaches_is_not_found() -> None:
    seen = recorded(HIDDEN, steering(5, 3.0, BY_TILT, 20.0, 46.0, 0.0))
    found = fit(ReplayedSpans([seen]), replace(HIDDEN, maximum_tilt_deg=30.0, drag=0.25))
    assert found.airframe.maximum_tilt_deg == 30.0
    assert "maximum_tilt_deg" not in {one.name for one in found.found}
    [drag] = [one for one in found.found if one.name == "drag"]
    assert drag.before == 0.25
    assert drag.value == pytest.approx(0.15, abs=0.01)
    assert 0.0 < drag.error < 0.05


class Linear:
    """Spans of 36 rows, in which drag makes 10 m/s north, and thrust_exponent 0.2 m/s up.

    The recorded ones have 0.6 and 0.8 of them, and 5 m/s more and less to the north in turn. A step
    of vertical_drag makes 0.009 m/s rms: too little to show.
    """

    tilts_over_ground, kinds = False, frozenset({"Horizontal.TILT", "Vertical.THRUST"})

    def __init__(self) -> None:
        self.asked = list[Airframe]()
        self.recorded: list[list[tuple[float, ...]]] = [
            [(0.0, 0.0, 0.0, 1.0 + 10.0 * (n % 6 < 3), 0.0, 0.16) for n in range(36)]
        ]
        self.recordings = [FlightRecording(name="rests")]
        chance = Random(9)
        for step in range(300):
            self.recordings[0].attitude.append((step * STEP, 0.0, 0.0, 0.0))
            noise = [chance.gauss(0.0, 0.3) for _ in "xyz"]
            self.recordings[0].acceleration.append((step * STEP, *noise))

    def fly(self, airframe: Airframe) -> list[SpanFlight]:
        self.asked.append(airframe)
        north = 10.0 * airframe.drag + 0.3 * (airframe.vertical_drag - START.vertical_drag)
        row = 0.0, 0.0, 0.0, north, 0.0, 0.2 * airframe.thrust_exponent
        return [SpanFlight([], self.recorded[0], [row] * 36)]


START = Airframe(drag=0.3)


def test_what_a_recording_shows_well_enough_is_found_with_its_standard_error() -> None:
    """Of 12 rows, of which each has 25 m²/s² in one signal of three."""
    (airframe, found), variance = fit(cast(Any, Linear()), START), 12 * 25.0 / 36
    drag, noise = found
    error = near_to(math.sqrt(variance / (12 * 10.0**2)), rel=1e-4)
    assert drag == Found("drag", 0.3, near_to(0.6), error)
    # That of thrust_exponent is 4.2, and ten of its steps are 1.
    assert airframe == replace(START, drag=drag.value, accelerometer_noise=noise.value)
    value = near_to(0.3, rel=0.1)
    assert noise == Found("accelerometer_noise", 0.05, value, near_to(0.1 * noise.value))


def test_the_nearest_airframe_is_sought_by_damped_steps_and_ever_finer_derivatives() -> None:
    linear, constants = Linear(), [one for one in _STAGES[2][1] if one.name.endswith("drag")]
    _nearest(cast(Any, linear), START, constants, slice(3, 6))
    off = [one.vertical_drag - START.vertical_drag for one in linear.asked]
    # Finer once a round makes it less than 2 % better, and no finer than a hundredth of 0.05.
    assert [one for one in off if one] == near_to([0.05, 0.05, 0.0125, 0.003125, 0.00078125])
    first = 0.3 + 0.3 / (1.0 + 1e-3)
    second = first + (0.6 - first) / (1.0 + 1e-4)
    drags = [one.drag for one, moved in zip(linear.asked, off, strict=True) if not moved]
    assert drags[:5] == near_to([0.3, 0.35, first, first + 0.05, second])


def test_the_same_airframe_flies_the_same_flight() -> None:
    """From the recorded state, with the commands that were under way, on any clock."""
    seen = recorded(HIDDEN, steering(6, 6.0, BY_TILT, 30.0, 46.0, 4.0), begin_s=1.7e9)
    for one in residuals(ReplayedSpans([seen]).fly(HIDDEN)):
        assert one.rms < (0.6 if one.unit == "°" else 0.1), one
        assert abs(one.delay_s) <= 0.01 or one.deviation < 0.5, one


# -- residuals by hand -----------------------------------------------------------------------------


def sines(delay_s: float, size: float) -> list[tuple[float, ...]]:
    values = [size * math.sin(math.pi * (step * STEP - delay_s)) for step in range(1000)]
    return [(value, 0.0, value, value, value, 7.0) for value in values]


def test_residuals_tell_size_and_delay() -> None:
    """A sine of 3° that comes 0.1 s later than a sine of 2°, over five of its periods."""
    roll, pitch, yaw, *_, up = residuals([SpanFlight([], sines(0.1, 3.0), sines(0.0, 2.0))])
    assert (roll.signal, roll.unit, up.unit) == ("roll", "°", "m/s")
    assert roll.delay_s == pytest.approx(0.10)
    assert roll.deviation == pytest.approx(3.0 / math.sqrt(2.0), rel=0.001)
    # |3 e^(-0.1 pi i) - 2|² = 9 + 4 - 12 cos 0.1 pi, half of it in the mean
    angle = 0.1 * math.pi
    assert roll.rms == pytest.approx(math.sqrt((13.0 - 12.0 * math.cos(angle)) / 2.0), rel=0.001)
    assert roll.correlation == pytest.approx(math.cos(angle), abs=0.001)
    assert (pitch.rms, pitch.delay_s) == (0.0, 0.0)
    assert math.isnan(pitch.correlation)
    assert yaw.delay_s == roll.delay_s
    assert (up.deviation, up.rms) == (0.0, 0.0), "about its mean, and that is 7"
    for delay_s in (-0.5, 0.5):
        flight = SpanFlight([], sines(delay_s, 1.0)[:200], sines(0.0, 1.0)[:200])
        assert residuals([flight])[0].delay_s == pytest.approx(delay_s)


def test_spans_are_correlated_where_both_have_a_row_and_no_span_with_the_next() -> None:
    pairs = [([9.0, 1.0, 2.0, 4.0], [1.0, 2.0, 4.0, 7.0]), ([5.0], [6.0])]
    assert _correlation(pairs, 1) == pytest.approx(1.0)
    # Of 9, 1, 2 and 2, 4, 7: the products about their means sum to -16, the squares to 38, 38/3.
    assert _correlation(pairs, -1) == pytest.approx(-16.0 / math.sqrt(38.0 * 38.0 / 3.0))


def test_a_dead_time_between_two_steps_is_between_two_flights() -> None:
    def fly(airframe: Airframe) -> list[tuple[float, ...]]:
        return [(airframe.command_delay, -4.0 * airframe.command_delay)]

    for delay_s in (0.13, 0.137):
        replay = cast(Any, SimpleNamespace(_fly=fly))
        [row] = _Replay.fly(replay, replace(HIDDEN, command_delay=delay_s))
        assert row == near_to((delay_s, -4.0 * delay_s))


def test_a_command_is_taken_before_the_step_that_begins_with_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """On a clock whose seconds and hundredths of them are rounded each in its way."""
    taken, felt = list[float](), dict[float, float]()

    def step(_: object, now: float, *__: object) -> None:
        felt.update(dict.fromkeys(taken, now))
        taken.clear()

    monkeypatch.setattr(FlightController, "move", lambda one, _: taken.append(one.now))
    monkeypatch.setattr(FlightController, "step", step)
    [replay] = ReplayedSpans([level_flight(4.0)])._replays
    replay.fly(replace(HIDDEN, command_delay=0.0))
    gaps = [now - at for at, now in felt.items() if at > replay.times[0] - 1.5 * STEP]
    assert gaps == pytest.approx([STEP] * 198)


def test_noise_is_that_at_rest() -> None:
    chance = Random(7)
    rows: Series = []
    attitude: Series = []
    for step in range(3000):
        moves = math.sin(step / 30.0) if step < 2000 else 0.0
        rows.append((step * STEP, moves + chance.gauss(0.0, 0.02)))
        attitude.append((step * STEP, 0.1 * moves, 0.0, 3.0))
    assert noise_of(rows, attitude) == pytest.approx(0.02, rel=0.1)
    twice = [one for row in rows for one in (row, (row[0] + 0.005, row[1]))]
    assert noise_of(twice, attitude) == pytest.approx(0.02, rel=0.1)
    assert noise_of(rows[:1900], attitude[:1900]) is None, "it never rests"
    assert noise_of(rows[::6], attitude) is None, "fewer than 50 rows in two seconds"
    assert noise_of([], attitude) is None


# -- spans by hand ---------------------------------------------------------------------------------


def level_flight(seconds: float) -> FlightRecording:
    """North at 3 m/s, level, with commands at 50 Hz."""
    found = FlightRecording(name="level")
    for step in range(round(seconds * 50)):
        at = step / 50
        found.moves.append((at, ReceivedMove(BY_VELOCITY, 3.0, 0.0, 0.0, 0.0)))
        found.attitude.append((at, 0.0, 0.0, 0.0))
        found.velocity.append((at, 3.0, 0.0, 0.0))
    return found


def near_to(expected: Any, rel: float = 1e-7) -> Any:
    return pytest.approx(expected, rel=rel)


def near(*expected: tuple[float, float]) -> Any:
    return [pytest.approx(pair, abs=0.05) for pair in expected]


def test_a_flight_is_one_span() -> None:
    assert spans(level_flight(10.0)) == near((0.02, 9.98))


def test_touches_of_the_ground_part_spans_and_a_short_one_is_none() -> None:
    seen = level_flight(10.0)
    for place, (at, *_) in enumerate(seen.velocity):
        seen.velocity[place] = (at, 3.0, 0.0, -2.0 + sum(at >= touch for touch in (4.0, 5.0, 9.0)))
    assert spans(seen) == near((0.02, 3.98), (5.02, 8.98))


def test_a_hard_climb_parts_nothing() -> None:
    """12 m/s² is more than full thrust gives; a bounce is 20 m/s² and more."""
    seen = level_flight(10.0)
    for place, (at, *_) in enumerate(seen.velocity):
        seen.velocity[place] = (at, 3.0, 0.0, 12.0 * min(0.3, max(0.0, at - 4.0)))
    assert spans(seen) == near((0.02, 9.98))


def test_no_span_goes_on_while_it_stands_pauses_or_nothing_is_heard() -> None:
    stands, pauses, deaf, blind, grounded = (level_flight(10.0) for _ in range(5))
    stands.velocity = [(at, 0.0 if 4 < at < 6 else 3.0, 0.0, 0.0) for at, *_ in stands.velocity]
    pauses.moves = [one for one in pauses.moves if not 4 < one[0] < 6]
    deaf.velocity = [one for one in deaf.velocity if not 4 < one[0] < 6]
    blind.attitude = [one for one in blind.attitude if not 4 < one[0] < 6]
    grounded.flying = [(0.0, 1.0), (4.0, 0.0), (6.0, 1.0)]
    assert spans(stands) == near((0.02, 4.5), (6.0, 9.98))
    assert spans(pauses) == near((0.02, 4.5), (6.0, 9.98))
    assert spans(deaf) == near((0.02, 4.0), (6.02, 9.98))
    assert spans(blind) == near((0.02, 4.5), (6.0, 9.98))
    assert spans(grounded) == near((0.02, 4.0), (6.0, 9.98))


def test_a_short_flight_and_an_empty_recording_are_refused() -> None:
    with pytest.raises(UsageError, match="no flight under movement commands in level"):
        ReplayedSpans([level_flight(1.0)])
    with pytest.raises(UsageError, match="no flight under movement commands in empty"):
        ReplayedSpans([FlightRecording(name="empty")])


# -- what a span is made of, by hand ---------------------------------------------------------------


def test_a_heading_that_passes_south_goes_on() -> None:
    """Turning right at 60°/s from 150°: recorded from −180° to 180°, the signal passes 180°."""
    moves = [(n / 50, ReceivedMove(BY_VELOCITY, 0.5, 0.0, 0.0, 60.0)) for n in range(150)]
    first = [(at, move._replace(yaw=-60.0)) for at, move in moves]
    for steered, sign in ((moves, 1.0), (first, -1.0)):
        seen = recorded(HIDDEN, steered)
        turned: Series = [
            (at, roll, pitch, math.remainder(yaw + sign * math.radians(150.0), math.tau))
            for at, roll, pitch, yaw in seen.attitude
        ]
        assert max(abs(b[3] - a[3]) for a, b in pairwise(turned)) > 6.0, "it jumps"
        seen.attitude = turned
        [flight] = ReplayedSpans([seen]).fly(HIDDEN)
        for rows in (flight.recorded, flight.flown):
            headings = [row[2] for row in rows]
            assert max(abs(b - a) for a, b in pairwise(headings)) < 1.0
            # 2.98 s without the dead time and the lag, 0.43 s.
            assert sign * (headings[-1] - headings[0]) == pytest.approx(153.0, abs=6.0)
        yaw = residuals([flight])[2]
        assert (yaw.signal, yaw.rms < 3.0) == ("yaw", True)


@pytest.mark.parametrize(
    ("now", "expected"),
    [
        (1.0, (10.0, -4.0)),  # before the first row
        (2.0, (10.0, -4.0)),
        (2.5, (12.0, -3.0)),  # a quarter of the way
        (4.0, (18.0, 0.0)),
        (4.75, (19.5, 7.5)),
        (5.0, (20.0, 10.0)),
        (9.0, (20.0, 10.0)),  # after the last
    ],
)
def test_between_two_rows_values_are_in_proportion(
    now: float, expected: tuple[float, float]
) -> None:
    series: Series = [(2.0, 10.0, -4.0), (4.0, 18.0, 0.0), (5.0, 20.0, 10.0)]
    assert _at(series, now) == pytest.approx(expected)
    newest = {1.0: 7.0, 2.0: 10.0, 4.75: 18.0}.get(now, 10.0 if now < 4 else series[-1][1])
    if now != 4.0:
        assert _newest(series, now, 7.0) == newest


def test_a_span_has_the_commands_before_it_the_height_and_the_charge() -> None:
    """Of the two seconds before: what was commanded then is under way; no height is 1000 m."""
    by_height = ControlMode(Horizontal.VELOCITY, Vertical.HEIGHT, Yaw.RATE)
    starts = {}
    for mode in (BY_VELOCITY, by_height):
        seen = level_flight(10.0)
        seen.moves = [(at, ReceivedMove(mode, 3.0, 0.0, 40.0, 0.0)) for at, _ in seen.moves]
        seen.velocity = [row for row in seen.velocity if row[0] >= 5.0]
        seen.attitude = [(at, 0.2 * at, -0.1 * at, 0.3 * at) for at, *_ in seen.attitude]
        seen.height = [(0.0, 30.0), (4.0, 40.0), (6.0, 50.0)]
        seen.battery = [(0.0, 80.0), (7.0, 60.0)]
        [replay] = ReplayedSpans([seen])._replays
        assert replay.times[:2] == pytest.approx([5.03, 5.04])  # it begins at 5.02
        assert replay.moves[0][0] == pytest.approx(3.02, abs=0.021)
        assert replay.moves[-1][0] == pytest.approx(9.96, abs=0.021)
        starts[mode.vertical] = replay._height
        assert (replay._battery[0], replay._battery[-1]) == (80.0, 60.0)
        angles = [math.degrees(rate * 5.03) for rate in (0.2, -0.1, 0.3)]
        assert replay.recorded[0] == pytest.approx((*angles, 3.0, 0.0, 0.0))
        assert replay._turning == pytest.approx((0.2, -0.1, 0.3))
    assert starts == {Vertical.VELOCITY: 1000.0, Vertical.HEIGHT: 40.0}


# -- the arithmetic of the fit, by hand ------------------------------------------------------------


def test_equations_are_solved_and_a_row_of_nothing_gives_0() -> None:
    # 2a + b = 1 and a - 3b = 11 are a = 2, b = -3; the first pivot is 0 in the second.
    assert _solve([[2.0, 1.0], [1.0, -3.0]], [1.0, 11.0]) == pytest.approx([2.0, -3.0])
    assert _solve([[0.0, 2.0], [4.0, 1.0]], [6.0, 11.0]) == pytest.approx([2.0, 3.0])
    assert _solve([[4.0, 0.0], [0.0, 0.0]], [8.0, 5.0]) == [2.0, 0.0]


@pytest.mark.parametrize(
    ("now", "width", "variance"),
    [
        # The mean square is 1; the next one is alike by 1/4: (1 + 1/4) / (1 - 1/4) of it.
        ([1.0, 1.0, -1.0, -1.0], 1, 5.0 / 3.0),
        ([1.0, -1.0, 1.0, -1.0], 1, 1.0),  # unlike: as if by chance
        ([1.0, -1.0, 1.0, -1.0], 2, 3.0),  # of two signals in turn: alike by 1/2
    ],
)
def test_residuals_that_resemble_each_other_count_less(
    now: list[float], width: int, variance: float
) -> None:
    found = _standard_errors(["drag", "tilt_damping"], [[4.0, 0.0], [0.0, 9.0]], now, width)
    wanted = {"drag": math.sqrt(variance) / 2.0, "tilt_damping": math.sqrt(variance) / 3.0}
    assert found == pytest.approx(wanted)


@pytest.mark.parametrize(
    ("name", "value", "step", "moved"),
    [
        ("command_delay", 0.5, 0.03, 0.53),
        ("command_delay", 0.5, -0.03, 0.47),
        ("command_delay", 1.99, 0.03, 2.0),  # 0 to 2 s
        ("command_delay", 2.0, 0.03, 1.97),  # at its end the other way
        ("command_delay", 0.0, -0.03, 0.03),
        ("maximum_tilt_deg", 1.5, -1.0, 1.0),
    ],
)
def test_a_step_stays_in_the_range(name: str, value: float, step: float, moved: float) -> None:
    there = _moved(replace(Airframe(), **{name: value}), name, step)
    assert getattr(there, name) == pytest.approx(moved)


def test_a_limit_is_searched_from_the_99th_percentile_of_what_was_flown() -> None:
    """Either way: 400 rows from −20° to 20° of roll, less of pitch, and 3 m/s north."""
    seen = level_flight(4.1)
    seen.attitude = [(at, math.radians(10.0 * (at - 2.05)), 0.05, 0.0) for at, *_ in seen.attitude]
    seen.velocity = [(at, 3.0, -7.0, -1.25) for at, *_ in seen.velocity]
    names = ["maximum_tilt_deg", "horizontal_speed", "vertical_speed", "drag"]
    found = _with_limits(ReplayedSpans([seen]), Airframe(), names)
    assert found.maximum_tilt_deg == pytest.approx(20.0, abs=0.5)
    assert (found.horizontal_speed, found.vertical_speed) == (7.0, 1.25)
    assert found.drag == 0.30
    unknown = _with_limits(ReplayedSpans([seen]), Airframe(), ["drag"])
    assert unknown.maximum_tilt_deg == 30.0


@pytest.mark.parametrize(
    ("charges", "is_shown"), [([], False), ([90, 81], False), ([90, 80], True), ([20, 80], True)]
)
def test_thrust_by_battery_is_shown_by_ten_percent(charges: list[int], is_shown: bool) -> None:
    seen = level_flight(2.0)
    thrust = ReceivedMove(BY_TILT, 0.0, 0.0, 45.0, 0.0)
    seen.moves = [(at, thrust) for at, _ in seen.moves]
    seen.battery = [(float(at), float(charge)) for at, charge in enumerate(charges)]
    replays = ReplayedSpans([seen])
    shown = {one.name for _, row in _STAGES for one in row if _is_shown(one, replays)}
    assert ("empty_hover_thrust" in shown) is is_shown
    assert shown - {"empty_hover_thrust"} == {
        *("command_delay", "tilt_frequency", "tilt_damping", "maximum_tilt_deg", "drag"),
        *("yaw_time_constant", "yaw_rate_deg"),
        *("hover_thrust", "thrust_exponent", "vertical_drag"),
    }


def test_noise_is_that_of_the_middle_recording_and_at_most_5() -> None:
    """An aircraft that rests with its nose to the south jumps from 180° to −180°, and does rest."""
    chance = Random(8)
    recordings = []
    for gyro, accelerometer in ((0.001, 9.0), (0.004, 8.0), (0.002, 7.0)):
        one = FlightRecording(name="rests")
        for step in range(500):
            at = step * STEP
            one.rates.append((at, *(chance.gauss(0.0, gyro) for _ in range(3))))
            one.acceleration.append((at, *(chance.gauss(0.0, accelerometer) for _ in range(3))))
            one.attitude.append((at, 0.0, 0.0, math.pi if step % 2 else -math.pi))
        recordings.append(one)
    empty = FlightRecording(name="empty")
    found = dict(_noises([*recordings, empty]))
    assert list(found) == ["gyro_noise", "accelerometer_noise"]
    assert found["gyro_noise"] == pytest.approx(0.002, rel=0.1)
    assert found["accelerometer_noise"] == 5.0
    assert dict(_noises([empty])) == {}
