"""The ruler: hidden constants are found, and residuals are those of hand-made signals."""

from __future__ import annotations

import math
from dataclasses import replace
from random import Random
from typing import Any

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
    FlightRecording,
    ReplayedSpans,
    Series,
    SpanFlight,
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
    seen = recorded(HIDDEN, steering(5, 5.0, BY_TILT, 20.0, 46.0, 0.0))
    found = fit(ReplayedSpans([seen]), replace(HIDDEN, maximum_tilt_deg=30.0))
    assert found.airframe.maximum_tilt_deg == 30.0
    assert "maximum_tilt_deg" not in {one.name for one in found.found}


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
    roll, pitch, yaw, *_, up = residuals([SpanFlight(0.0, sines(0.1, 3.0), sines(0.0, 2.0))])
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
    early = residuals([SpanFlight(0.0, sines(-0.05, 1.0), sines(0.0, 1.0))])[0]
    assert early.delay_s == pytest.approx(-0.05)


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


def near(*expected: tuple[float, float]) -> Any:
    return [pytest.approx(pair, abs=0.05) for pair in expected]


def test_a_flight_is_one_span() -> None:
    assert spans(level_flight(10.0)) == near((0.02, 9.98))


def test_a_touch_of_the_ground_parts_two_spans() -> None:
    seen = level_flight(10.0)
    for place, (at, *_) in enumerate(seen.velocity):
        seen.velocity[place] = (at, 3.0, 0.0, -2.0 if at < 4.0 else 0.5)
    assert spans(seen) == near((0.02, 3.98), (4.02, 9.98))


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
