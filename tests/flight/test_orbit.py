"""Circles: on them from the first quarter on, whatever the speed, the wind and the direction."""

from __future__ import annotations

import math
from itertools import pairwise
from random import Random
from typing import Any

import pytest

from m100link import Guards, UsageError
from m100link.flight.guidance import GuidanceProgress
from m100link.flight.loops import Orbit
from m100link.sim import AircraftSettings
from tests.rig import FIRMWARES, rig

pytestmark = pytest.mark.anyio


class Flown:
    """What a circle looked like, measured on the virtual aircraft itself.

    Attributes:
        off: Distance from the circle at each tick, as a part of the radius.
        bearings: From the centre, °.
        done_deg: How much of the circle was done at each tick.
        closing_m: From the end to the beginning.
        facing_deg: Between the nose and the centre at the end.
    """

    def __init__(self) -> None:
        self.off: list[float] = []
        self.bearings: list[float] = []
        self.done_deg: list[float] = []
        self.closing_m = self.facing_deg = math.nan

    @property
    def turned_deg(self) -> float:
        return sum(math.remainder(later - before, 360) for before, later in pairwise(self.bearings))

    def assert_round(self) -> None:
        """Within 5 % after the first quarter and 10 % always."""
        assert max(map(abs, self.off)) < 0.10
        late = [off for off, done in zip(self.off, self.done_deg, strict=True) if done >= 90]
        assert max(map(abs, late)) < 0.05


async def circle(
    *,
    radius: float,
    speed: float,
    direction_deg: float = 0.0,
    clockwise: bool = True,
    turns: float = 1.0,
    guards: Guards | None = None,
    firmware: str = "1.0",
    **settings: Any,
) -> Flown:
    """Fly one from a hover, around a centre in that direction."""
    found = Flown()
    guards = guards or Guards(envelope=None)
    options = AircraftSettings(**settings)
    async with rig(settings=options, firmware=firmware) as flown:
        async with flown.aircraft.control(guards=guards) as control:
            await control.take_off()
            start = flown.virtual.position
            north = radius * math.cos(math.radians(direction_deg))
            east = radius * math.sin(math.radians(direction_deg))

            def watch(progress: GuidanceProgress) -> None:
                here = flown.virtual.position
                from_centre = here[0] - start[0] - north, here[1] - start[1] - east
                found.off.append(math.hypot(*from_centre) / radius - 1)
                found.bearings.append(math.degrees(math.atan2(from_centre[1], from_centre[0])))
                found.done_deg.append(360 * turns - progress.heading_error_deg)

            await control.orbit(
                center_north=north,
                center_east=east,
                speed=speed,
                turns=turns,
                clockwise=clockwise,
                progress=watch,
            )
            found.closing_m = math.dist(start, flown.virtual.position)
            nose = math.degrees(flown.virtual.vehicle.flight.dynamics.yaw)
            found.facing_deg = abs(math.remainder(nose - direction_deg, 360))
    return found


@pytest.mark.parametrize("firmware", FIRMWARES)
@pytest.mark.parametrize("clockwise", [True, False])
async def test_it_goes_round_once_and_ends_where_it_began_looking_at_the_centre(
    firmware: str, clockwise: bool
) -> None:
    found = await circle(radius=8, speed=2, clockwise=clockwise, firmware=firmware)
    assert found.turned_deg == pytest.approx(360 if clockwise else -360, abs=3)
    assert found.closing_m < 0.5
    assert found.facing_deg < 5
    found.assert_round()


@pytest.mark.parametrize("wind", [(0.0, 0.0), (1.5, 0.0), (0.0, -1.5), (-1.06, 1.06)], ids=str)
@pytest.mark.parametrize("clockwise", [True, False])
async def test_from_a_standing_start_at_3_m_s_on_6_m_it_stays_on_the_circle(
    wind: tuple[float, float], clockwise: bool
) -> None:
    found = await circle(
        radius=6, speed=3, clockwise=clockwise, wind_north=wind[0], wind_east=wind[1]
    )
    found.assert_round()


@pytest.mark.parametrize(
    ("speed", "radius"),
    [(0.7, 1.0), (0.3, 5.0), (1.4, 2.0), (3.5, 5.0), (6.0, 10.2), (8.0, 18.0), (10.0, 28.5)],
    ids=str,
)
@pytest.mark.parametrize("seed", range(3))
async def test_what_the_airframe_can_fly_is_round_in_every_direction_and_in_wind(
    speed: float, radius: float, seed: int
) -> None:
    random = Random(seed)
    wind = math.radians(random.uniform(0, 360))
    found = await circle(
        radius=radius,
        speed=speed,
        direction_deg=random.uniform(-180, 180),
        clockwise=random.random() < 0.5,
        heading_deg=random.uniform(-180, 180),
        wind_north=1.5 * math.cos(wind),
        wind_east=1.5 * math.sin(wind),
    )
    found.assert_round()


@pytest.mark.parametrize("turns", [0.5, 2.5])
async def test_parts_and_many_turns(turns: float) -> None:
    found = await circle(radius=5, speed=2, turns=turns)
    assert found.turned_deg == pytest.approx(360 * turns, abs=3)
    found.assert_round()


async def test_the_speed_of_the_envelope_is_kept_although_corrections_come_on_top() -> None:
    found = await circle(radius=28.5, speed=10, guards=Guards(), wind_north=1.5)
    found.assert_round()


@pytest.mark.parametrize(
    ("options", "why"),
    [
        ({"radius": 0.5}, "0.5 m radius"),
        ({"speed": 0.0}, "0 m/s"),
        ({"speed": 11.0}, "11 m/s"),
        ({"speed": -0.5}, "-0.5 m/s"),
        ({"turns": 0.0}, "0 turns"),
        ({"turns": -0.5}, "-0.5 turns"),
        ({"radius": math.nan}, "nan m radius"),
        ({"turns": math.nan}, "nan turns"),
        ({"speed": math.nan}, "nan m/s"),
    ],
    ids=str,
)
def test_an_orbit_that_is_none_is_refused(options: dict[str, float], why: str) -> None:
    wanted = {"radius": 5.0, "speed": 2.0, "turns": 1.0} | options
    with pytest.raises(UsageError, match="cannot be flown") as caught:
        Orbit(**wanted, clockwise=True, max_speed=10.0)
    assert why in caught.value.seen


@pytest.mark.parametrize(
    "options",
    [
        {"radius": 1.0, "speed": 0.5},
        {"radius": 40.0, "speed": 10.0},
        {"speed": 0.1},
        {"turns": 0.01},
    ],
    ids=str,
)
def test_the_smallest_the_fastest_and_a_piece_can_be_flown(options: dict[str, float]) -> None:
    wanted = {"radius": 5.0, "speed": 2.0, "turns": 1.0} | options
    orbit = Orbit(**wanted, clockwise=True, max_speed=10.0)
    assert orbit.steer((wanted["radius"], 0.0), None, None, 0.02).off_m == pytest.approx(0)


def test_an_orbit_that_needs_more_tilt_than_there_is_is_refused_with_what_can_be_flown() -> None:
    with pytest.raises(UsageError) as caught:
        Orbit(radius=10, speed=8, turns=1, clockwise=True, max_speed=10)
    assert "v²/r is 6.4 m/s², a tilt of 33°, and 20° are left for it" in caught.value.seen
    assert caught.value.remedy == "at most 6.0 m/s on this radius, or at least 17.9 m of radius"


def test_an_orbit_that_turns_faster_than_the_aircraft_follows_is_refused() -> None:
    with pytest.raises(UsageError, match=r"turns by 72°/s.* follows up to 40°/s") as caught:
        Orbit(radius=1.2, speed=1.5, turns=1, clockwise=True, max_speed=10)
    assert caught.value.remedy == "at most 0.8 m/s on this radius, or at least 2.1 m of radius"


@pytest.mark.parametrize(
    ("place", "yaw_deg"),
    [((10.0, 0.0), 180.0), ((0.0, 10.0), -90.0), ((-10.0, 0.0), 0.0), ((0.0, -13.0), 90.0)],
)
def test_the_nose_is_turned_to_the_centre(place: tuple[float, float], yaw_deg: float) -> None:
    orbit = Orbit(radius=10, speed=2, turns=1, clockwise=True, max_speed=5)
    steering = orbit.steer(place, (0.0, 0.0), yaw_deg, 0.02)
    assert math.remainder(steering.yaw_deg - yaw_deg, 360) == pytest.approx(0, abs=1e-9)
    assert steering.off_m == pytest.approx(abs(math.hypot(*place) - 10))
    assert steering.to_go_deg == 360


@pytest.mark.parametrize(
    ("off_deg", "moves"), [(0.0, True), (4.9, True), (-4.9, True), (5.1, False), (-5.1, False)]
)
def test_it_begins_to_move_when_the_nose_is_within_5_degrees_of_the_centre(
    off_deg: float, moves: bool
) -> None:
    orbit = Orbit(radius=10, speed=2, turns=1, clockwise=True, max_speed=5)
    steering = orbit.steer((10.0, 0.0), (0.0, 0.0), 180.0 + off_deg, 0.02)
    assert (steering.east > 0) is moves


def test_far_from_the_circle_most_of_the_speed_leads_to_it() -> None:
    for north, wanted in ((1.0, 4.0), (40.0, -4.0)):
        orbit = Orbit(radius=10, speed=2, turns=1, clockwise=True, max_speed=5)
        steering = orbit.steer((north, 0.0), None, None, 0.02)
        assert steering.north == pytest.approx(wanted)
        assert math.hypot(steering.north, steering.east) <= 5
    orbit = Orbit(radius=10, speed=3, turns=1, clockwise=True, max_speed=3.2)
    for _ in range(40):
        steering = orbit.steer((14.0, 0.0), None, None, 0.1)
    assert (steering.north, steering.east) == pytest.approx((-2.56, 1.92), abs=1e-5)
    assert math.hypot(steering.north, steering.east) <= 3.2, "more is no setpoint"


def turned(vector: tuple[float, float], angle: float) -> tuple[float, float]:
    cos, sin = math.cos(angle), math.sin(angle)
    return vector[0] * cos - vector[1] * sin, vector[0] * sin + vector[1] * cos


def test_a_circle_is_the_same_on_each_bearing_and_the_mirror_of_the_other_sense() -> None:
    """No side is another one's: places, velocities and headings are turned or mirrored together."""
    seed = Random().randrange(1 << 32)
    chance = Random(seed)
    for _ in range(20):
        places = [(chance.uniform(7, 13), chance.uniform(-2, 2)) for _ in range(4)]
        flown = [(chance.uniform(-2, 2), chance.uniform(-2, 2)) for _ in range(4)]
        angle = chance.uniform(-3, 3)
        circles = [
            Orbit(radius=10, speed=3, turns=2, clockwise=clockwise, max_speed=8)
            for clockwise in (True, True, False)
        ]
        for place, velocity in zip(places, flown, strict=True):
            first, other, mirrored = (
                circle.steer(*moved, None, 0.1)
                for circle, moved in zip(
                    circles,
                    [
                        (place, velocity),
                        (turned(place, angle), turned(velocity, angle)),
                        ((place[0], -place[1]), (velocity[0], -velocity[1])),
                    ],
                    strict=True,
                )
            )
            asked = turned((first.north, first.east), angle)
            assert (other.north, other.east) == pytest.approx(asked), f"seed {seed}"
            assert (mirrored.north, mirrored.east) == pytest.approx((first.north, -first.east))
            assert other.to_go_deg == pytest.approx(first.to_go_deg)
            assert mirrored.to_go_deg == pytest.approx(first.to_go_deg)
            assert math.remainder(mirrored.yaw_deg + first.yaw_deg, 360) == pytest.approx(0)


def test_what_is_asked_for_leads_the_velocity_by_its_lag() -> None:
    """0.65 s: while it speeds up by 0.8 m/s², and inwards by the centripetal acceleration."""
    orbit = Orbit(radius=10, speed=3, turns=1, clockwise=True, max_speed=8)
    began = orbit.steer((10.0, 0.0), (0.0, 0.0), 180.0, 0.1)
    assert (began.north, began.east) == pytest.approx((0.0, 0.08 + 0.65 * 0.8))
    for _ in range(40):
        steady = orbit.steer((10.0, 0.0), (0.0, 3.0), 180.0, 0.1)
    assert (steady.north, steady.east) == pytest.approx((-0.65 * 3 * 3 / 10, 3.0))
    outward = orbit.steer((10.0, 0.0), (1.0, 3.0), 180.0, 0.1)
    assert outward.north == pytest.approx(-0.65 * 3 * 3 / 10 - 0.5)
    assert outward.east == pytest.approx(3.0 - 0.65 * 3 * 1 / 10)
    outside = orbit.steer((11.0, 0.0), (0.0, 0.0), 180.0, 0.1)
    assert (outside.north, outside.off_m) == pytest.approx((-1.2, 1.0))
    again = orbit.steer((10.0, 0.0), (0.0, 3.0), 180.0, 0.0)
    assert (again.north, again.east) == pytest.approx((steady.north, 3.0)), "in no time"


async def test_what_is_refused_moves_nothing() -> None:
    async with rig() as flown, flown.aircraft.control() as control:
        await control.take_off()
        with pytest.raises(UsageError):
            await control.orbit(center_north=1.0, center_east=0.0, speed=3.0)
        assert len(flown.moves) == 0
