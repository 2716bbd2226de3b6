"""What is asked for and does not begin, and what is only slow, tired or blown about."""

from __future__ import annotations

import math
import random
from typing import Any, cast

import pytest

from m100link.errors import SetpointsIgnored
from m100link.flight.watchdog import FOLLOW_S, FollowCheck
from m100link.protocol.records import (
    Attitude,
    FlightPhase,
    FlightStatus,
    Position,
    Velocity,
)
from m100link.protocol.setpoint import ReferenceFrame, Setpoint
from m100link.sim import AircraftSettings, LineFaults
from m100link.telemetry.state import AircraftState
from tests.rig import rig

STEP_S = 0.05


class Stand:
    """A check, and an aircraft that shows what it is set to.

    Attributes:
        north, east, up: Velocity, m/s; None: the item is not sent.
        roll, pitch, yaw: Attitude, °; None: the item is not sent.
        moved: Metres to the north.
        place: Latitude and longitude of the position without that, rad.
    """

    def __init__(self) -> None:
        self.now = 50.0
        self.setpoint: Setpoint | None = None
        self.velocity: tuple[float, float, float] | None = (0.0, 0.0, 0.0)
        self.attitude: tuple[float, float, float] | None = (0.0, 0.0, 0.0)
        self.phase: FlightPhase | None = FlightPhase.IN_AIR
        self.height = 10.0
        self.moved = 0.0
        self.place = 0.4, 2.0
        self.check = FollowCheck(cast(AircraftState, self), lambda: self.setpoint, lambda: self.now)

    def fresh(self, record: type[Any], *, within: float) -> Any:
        del within
        if record is FlightStatus:
            return None if self.phase is None else FlightStatus(self.phase)
        if record is Velocity:
            return None if self.velocity is None else Velocity(*self.velocity, None)
        if record is Attitude:
            return None if self.attitude is None else attitude(*self.attitude)
        assert record is Position
        latitude, longitude = self.place
        return Position(latitude + self.moved / 6_378_137.0, longitude, 400.0, self.height, 5)

    def fly(self, seconds: float) -> str:
        """What does not follow within that time; empty: nothing."""
        for _ in range(round(seconds / STEP_S)):
            self.now += STEP_S
            found = self.check.look()
            if found:
                return found
        return ""


def attitude(roll: float, pitch: float, yaw: float) -> Attitude:
    r, p, y = (math.radians(angle) / 2 for angle in (roll, pitch, yaw))
    cr, sr, cp, sp, cy, sy = *cis(r), *cis(p), *cis(y)
    return Attitude(
        cr * cp * cy + sr * sp * sy,
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
    )


def cis(angle: float) -> tuple[float, float]:
    return math.cos(angle), math.sin(angle)


def velocity(**values: float) -> Setpoint:
    given: dict[str, Any] = {"up": 0.0, "yaw_rate_deg_s": 0.0, **values}
    return Setpoint.velocity(**given)


NORTH = velocity(north=3.0, east=0.0)
IGNORED = {
    "velocity": NORTH,
    "backwards": velocity(north=-3.0, east=0.0),
    "body frame": velocity(forward=0.0, right=2.0),
    "offset": Setpoint.position_offset(north=0, east=8, up=0, yaw_rate_deg_s=0),
    "climb": velocity(north=0.0, east=0.0, up=1.0),
    "descent": velocity(north=0.0, east=0.0, up=-1.0),
    "turn": velocity(north=0.0, east=0.0, yaw_rate_deg_s=30.0),
    "heading": Setpoint.velocity(north=0, east=0, up=0, yaw_deg=90),
    "tilt": Setpoint.tilt(roll_deg=0, pitch_deg=-10, up=0, yaw_rate_deg_s=0),
}


@pytest.mark.parametrize("asked", IGNORED)
def test_what_does_not_begin_in_time_is_ignored(asked: str) -> None:
    stand = Stand()
    stand.setpoint = IGNORED[asked]
    assert stand.fly(FOLLOW_S - 0.1) == ""
    assert stand.fly(0.3) != ""


@pytest.mark.parametrize(
    ("setpoint", "change"),
    [
        (NORTH, {"velocity": (1.6, 0.0, 0.0)}),
        (NORTH, {"attitude": (0.0, -9.0, 0.0)}),  # leans against the wind
        (velocity(north=0.0, east=3.0), {"attitude": (9.0, 0.0, 0.0)}),
        (velocity(north=0.0, east=3.0), {"attitude": (0.0, -9.0, 90.0)}),
        (velocity(north=0.9, east=0.0), {}),  # too slow to be distinguished from gusts
        (velocity(north=0.0, east=0.0), {"velocity": (-3.0, 2.0, 0.0)}),
        (IGNORED["offset"], {"velocity": (0.0, 0.9, 0.0)}),
        (Setpoint.position_offset(north=2, east=0, up=0, yaw_rate_deg_s=0), {}),
        (IGNORED["climb"], {"velocity": (0.0, 0.0, 0.6)}),
        (IGNORED["climb"], {"velocity": (0.0, 0.0, -0.6)}),  # the sign is not settled
        (IGNORED["climb"], {"velocity": None}),
        (IGNORED["descent"], {"height": 2.0}),  # it lands as it likes
        (IGNORED["heading"], {"attitude": (0.0, 0.0, 80.0)}),
        (IGNORED["heading"], {"attitude": None}),
        (IGNORED["tilt"], {"attitude": (0.0, -6.0, 0.0)}),
        (NORTH, {"phase": FlightPhase.STANDBY}),
        (NORTH, {"phase": FlightPhase.LANDING}),
        (NORTH, {"phase": None}),
        (None, {}),
    ],
    ids=str,
)
def test_what_follows_or_need_not_is_no_fault(
    setpoint: Setpoint | None, change: dict[str, Any]
) -> None:
    stand = Stand()
    stand.setpoint = setpoint
    for name, value in change.items():
        setattr(stand, name, value)
    assert stand.fly(10.0) == ""


def tilted(degrees: float, to: float, heading: float) -> tuple[float, float, float]:
    """Roll, pitch and yaw of an aircraft that leans to a bearing: nose down flies forward, °."""
    forward, right = cis(math.radians(to - heading))
    return degrees * right, -degrees * forward, heading


def along(bearing: float, size: float) -> tuple[float, float]:
    north, east = cis(math.radians(bearing))
    return north * size, east * size


def asked_for(kind: str, bearing: float, heading: float) -> Setpoint:
    """3 m/s, or 6 m, to a bearing, in one of the frames."""
    way = along(bearing, 3.0 if "velocity" in kind else 6.0)
    if "body" in kind:
        way = along(bearing - heading, math.hypot(*way))
    names = ("forward", "right") if "body" in kind else ("north", "east")
    make: Any = Setpoint.velocity if "velocity" in kind else Setpoint.position_offset
    made: Setpoint = make(**dict(zip(names, way, strict=True)), up=0.0, yaw_rate_deg_s=0.0)
    return made


@pytest.mark.parametrize("kind", ["velocity", "body velocity", "offset", "body offset"])
def test_each_bearing_counts_from_north_at_each_heading(kind: str) -> None:
    """A quarter of the speed follows: of 3 m/s, and of the 1.5 m/s of an offset."""
    seed = random.randrange(1 << 32)
    chance, quarter = random.Random(seed), 0.75 if "velocity" in kind else 0.375
    for _ in range(12):
        bearing, heading = chance.uniform(-180, 180), chance.uniform(-180, 180)
        off = chance.choice([90.0, 180.0, 270.0])
        for to, speed, lean, is_followed in [
            (bearing, quarter + 0.05, 0.0, True),
            (bearing, quarter - 0.05, 0.0, False),
            (bearing + off, 2.0, 0.0, False),
            (bearing, 0.0, 8.2, True),  # the wind is in the way
            (bearing, 0.0, 7.8, False),
            (bearing + off, 0.0, 12.0, False),
        ]:
            stand = Stand()
            stand.setpoint = asked_for(kind, bearing, heading)
            stand.velocity = *along(to, speed), 0.0
            stand.attitude = tilted(lean, to, heading)
            found = stand.fly(FOLLOW_S + 0.2)
            case = f"seed {seed}, to {bearing} at heading {heading}: {to}, {speed}, {lean}"
            assert (found == "") is is_followed, case


def test_leaning_more_than_before_is_a_begin_at_each_heading() -> None:
    """Three degrees, towards what is asked for; away from it, or less, is none."""
    seed = random.randrange(1 << 32)
    chance = random.Random(seed)
    for _ in range(12):
        bearing, heading = chance.uniform(-180, 180), chance.uniform(-180, 180)
        for more, is_begun in [(3.3, True), (2.7, False), (-3.3, False)]:
            stand = Stand()
            stand.setpoint = asked_for("velocity", bearing, heading)
            stand.attitude = tilted(-4.0, bearing, heading)
            assert stand.fly(1.0) == ""
            stand.attitude = tilted(-4.0 + more, bearing, heading)
            case = f"seed {seed}, to {bearing} at heading {heading}: {more}° more"
            assert (stand.fly(1.1) == "") is is_begun, case


def test_a_tilt_counts_along_its_own_direction() -> None:
    seed = random.randrange(1 << 32)
    chance = random.Random(seed)
    for _ in range(12):
        to = chance.uniform(-180, 180)
        for turned, degrees, is_followed in [(0, 2.6, True), (0, 2.4, False), (90, 10, False)]:
            stand = Stand()
            pitch, roll = along(to, 10.0)
            stand.setpoint = Setpoint.tilt(roll_deg=roll, pitch_deg=pitch, up=0, yaw_rate_deg_s=0)
            pitch, roll = along(to + turned, degrees)
            stand.attitude = roll, pitch, chance.uniform(-180, 180)
            case = f"seed {seed}, tilt to {to}: {degrees}° at {turned}°"
            assert (stand.fly(FOLLOW_S + 0.2) == "") is is_followed, case


def heading_of(degrees: float) -> Setpoint:
    return Setpoint.velocity(north=0, east=0, up=0, yaw_deg=degrees)


def offset(north: float) -> Setpoint:
    return Setpoint.position_offset(north=north, east=0, up=0, yaw_rate_deg_s=0)


def to_height(height: float) -> Setpoint:
    return Setpoint.velocity(north=0, east=0, height=height, yaw_rate_deg_s=0)


def tilt(roll: float) -> Setpoint:
    return Setpoint.tilt(roll_deg=roll, pitch_deg=0, up=0, yaw_rate_deg_s=0)


@pytest.mark.parametrize(
    ("setpoint", "change", "is_judged"),
    [
        (velocity(north=0.95, east=0.0), {}, False),  # from 1 m/s on
        (velocity(north=0.0, east=-1.05), {}, True),
        (velocity(north=0.0, east=0.0, up=0.45), {}, False),  # from 0.5 m/s on
        (velocity(north=0.0, east=0.0, up=0.55), {}, True),
        (velocity(north=0.0, east=0.0, up=2.0), {"velocity": (0.0, 0.0, 0.45)}, True),
        (velocity(north=0.0, east=0.0, up=2.0), {"velocity": (0.0, 0.0, 0.55)}, False),
        (velocity(north=0.0, east=0.0, up=-1.0), {"height": 2.9}, False),  # above 3 m
        (velocity(north=0.0, east=0.0, up=-1.0), {"height": 3.1}, True),
        (velocity(north=0.0, east=0.0, yaw_rate_deg_s=-9.5), {}, False),  # from 10 °/s on
        (velocity(north=0.0, east=0.0, yaw_rate_deg_s=-10.5), {}, True),
        (heading_of(90), {"attitude": (0.0, 0.0, 109.5)}, False),  # from 20° on
        (heading_of(90), {"attitude": (0.0, 0.0, 110.5)}, True),
        (heading_of(-170), {"attitude": (0.0, 0.0, 170.5)}, False),  # across the south
        (heading_of(-170), {"attitude": (0.0, 0.0, 169.0)}, True),
        (offset(2.9), {}, False),  # from 3 m on
        (offset(-3.1), {}, True),
        (to_height(12.9), {}, False),  # from 3 m on, up and down
        (to_height(6.9), {}, True),
        (to_height(5.9), {"height": 2.8}, True),
        (tilt(4.9), {}, False),  # from 5° on
        (tilt(-5.1), {}, True),
    ],
    ids=str,
)
def test_what_is_too_small_to_judge(
    setpoint: Setpoint, change: dict[str, Any], is_judged: bool
) -> None:
    stand = Stand()
    stand.setpoint = setpoint
    for name, value in change.items():
        setattr(stand, name, value)
    assert (stand.fly(FOLLOW_S + 0.2) != "") is is_judged


@pytest.mark.parametrize(("gained", "is_begun"), [(0.8, False), (1.2, True)])
@pytest.mark.parametrize(
    ("asked", "item", "place", "before", "fifth"),
    [
        # What gains g of what was missing has 1 - g left: a quarter of that is a fifth.
        (NORTH, "velocity", 0, -3.0, 1.2),
        (velocity(north=0.0, east=0.0, up=-4.0), "velocity", 2, 0.0, -0.8),
        (IGNORED["tilt"], "attitude", 1, 8.0, -3.6),
    ],
    ids=["way", "descent", "tilt"],
)
def test_a_begin_is_a_quarter_of_what_is_missing(
    asked: Setpoint,
    item: str,
    place: int,
    before: float,
    fifth: float,
    gained: float,
    is_begun: bool,
) -> None:
    stand = Stand()
    stand.setpoint, stand.attitude = asked, None
    for now, seconds in ((before, 0.6), (before + gained * fifth, 1.1)):
        shown = [0.0, 0.0, 0.0]
        shown[place] = now
        setattr(stand, item, tuple(shown))
        found = stand.fly(seconds)
    assert (found == "") is is_begun


@pytest.mark.parametrize(("turn", "is_ignored"), [(80.0, True), (100.0, False)])
def test_a_direction_that_goes_back_has_its_time_anew(turn: float, is_ignored: bool) -> None:
    seed = random.randrange(1 << 32)
    chance = random.Random(seed)
    for _ in range(8):
        stand, bearing, found = Stand(), chance.uniform(-180, 180), ""
        for number in range(5):
            stand.setpoint = asked_for("velocity", bearing + number % 2 * turn, 0.0)
            found = found or stand.fly(0.5)
        assert (found != "") is is_ignored, f"seed {seed}"


def test_each_side_of_a_square_has_its_time_anew() -> None:
    stand = Stand()
    for side in [(3.0, 0.0), (0.0, 3.0), (-3.0, 0.0), (0.0, -3.0)] * 2:
        stand.setpoint = velocity(north=side[0], east=side[1])
        assert stand.fly(1.1) == "", side


@pytest.mark.parametrize("place", [(0.4, 2.0), (-1.0472, 0.5), (1.0472, math.pi)])
@pytest.mark.parametrize(("apart_m", "is_still"), [(0.45, True), (0.55, False)])
def test_without_a_velocity_half_a_metre_to_any_side_is_a_move(
    place: tuple[float, float], apart_m: float, is_still: bool
) -> None:
    """On both hemispheres, and across the line of the date."""
    latitude, longitude = place
    for north, east in [(1, 0), (0, 1), (0, -1), (0.6, 0.8), (-0.6, -0.8)]:
        stand, found = Stand(), ""
        stand.setpoint, stand.velocity = NORTH, None
        for step in range(16):
            moved = apart_m * (step % 2) / 6_378_137.0
            there = longitude + moved * east / math.cos(latitude)
            stand.place = latitude + moved * north, math.remainder(there, 2 * math.pi)
            found = found or stand.fly(0.25)
        assert (found != "") is is_still, (north, east)


@pytest.mark.parametrize(
    ("setpoint", "seconds"),
    [
        (velocity(north=10.0, east=0.0), 2.5),  # 10 m, and not before 2.5 s
        (velocity(north=0.0, east=-2.0), 5.0),
        (velocity(forward=1.2, right=-1.6), 5.0),
        (offset(4.0), 5.0),  # it may be flown at half of it per second
        (Setpoint.position_offset(north=0, east=-5, up=0, yaw_rate_deg_s=0), 4.0),
    ],
    ids=str,
)
def test_without_a_velocity_10_m_are_flown_before_it_is_said(
    setpoint: Setpoint, seconds: float
) -> None:
    stand = Stand()
    stand.setpoint, stand.velocity = setpoint, None
    began = stand.now
    assert "did not change" in stand.fly(8.0)
    assert stand.now - began == pytest.approx(seconds, abs=0.12)


def test_one_that_is_slow_begins() -> None:
    stand = Stand()
    stand.setpoint, stand.attitude = velocity(north=10.0, east=0.0), None
    north = -10.0
    while north < 10.0:
        stand.velocity = north, 0.0, 0.0
        assert stand.fly(STEP_S) == ""
        north += 4.5 * STEP_S


@pytest.mark.parametrize("rate", [3.0, 100.0])
def test_one_that_turns_begins(rate: float) -> None:
    stand = Stand()
    stand.setpoint = velocity(north=0.0, east=0.0, yaw_rate_deg_s=max(10.0, rate))
    for step in range(400):
        stand.attitude = 0.0, 0.0, (step * rate * STEP_S + 180.0) % 360.0 - 180.0
        assert stand.fly(STEP_S) == ""


def test_gusts_that_shake_one_that_hears_nothing_are_no_begin() -> None:
    stand = Stand()
    stand.setpoint = NORTH
    found = ""
    for step in range(100):
        gust = 0.3 * math.sin(step)
        stand.velocity, stand.attitude = (gust, -gust, 0.0), (2 * gust, 3 * gust, 0.0)
        found = found or stand.fly(STEP_S)
    assert found


def test_one_that_stops_hearing_in_flight_is_noticed_when_it_has_braked() -> None:
    stand = Stand()
    stand.setpoint = velocity(north=5.0, east=0.0)
    stand.velocity = 5.0, 0.0, 0.0
    assert stand.fly(5.0) == ""
    north, seconds, found = 5.0, 0.0, ""
    while not found:
        north, seconds = max(0.0, north - 4.0 * STEP_S), seconds + STEP_S
        stand.velocity = north, 0.0, 0.0
        stand.attitude = 0.0, 20.0 if north else 0.0, 0.0
        found = stand.fly(STEP_S)
    assert seconds < 3.5


def test_without_a_velocity_the_place_has_to_change_within_10_m() -> None:
    stand = Stand()
    stand.setpoint, stand.velocity = NORTH, None
    assert stand.fly(3.0) == ""
    assert "did not change" in stand.fly(1.0)
    moving = Stand()
    moving.setpoint, moving.velocity = NORTH, None
    for _ in range(400):
        moving.moved += 0.5 * STEP_S  # a sixth of what is asked for
        assert moving.fly(STEP_S) == ""


@pytest.mark.parametrize("item", ["with a velocity", "without a velocity"])
@pytest.mark.parametrize("asked", IGNORED.values(), ids=list(IGNORED))
def test_to_and_fro_faster_than_it_can_be_flown_is_no_fault(asked: Setpoint, item: str) -> None:
    """A tracker that hunts around its target sends this, and nothing has to move."""
    seed = random.randrange(1 << 32)
    chance = random.Random(seed)
    back = Setpoint(asked.mode, -asked.x, -asked.y, -asked.z, -asked.yaw, asked.frame)
    for _ in range(20):
        stand, half_s = Stand(), chance.uniform(STEP_S, 0.9)
        if item == "without a velocity":
            stand.velocity = None
        for number in range(round(20.0 / half_s)):
            stand.setpoint = back if number % 2 else asked
            assert stand.fly(half_s) == "", f"seed {seed}, {half_s:.2f} s"


def test_turning_round_at_speed_without_a_velocity_is_no_fault_and_standing_is() -> None:
    """It is within half a metre of where it turns for 1.2 to 1.6 s; 8 m/s fly 10 m meanwhile."""
    stand = Stand()
    stand.velocity = None
    stand.setpoint = Setpoint.velocity(north=8.0, east=0.0, up=0.0, yaw_rate_deg_s=0.0)
    turns_at, half_s = stand.now + 2.0, 0.8
    while stand.now < turns_at + 2.0:
        since = stand.now - turns_at
        stand.moved = 1.5 * max(0.0, abs(since) - half_s) ** 2 + 0.2 * min(1.0, abs(since) / half_s)
        assert stand.fly(STEP_S) == "", f"{since:.2f} s"
    began = stand.now
    while not (found := stand.fly(STEP_S)):
        assert stand.now < began + 4.0
    assert "position did not change" in found
    assert stand.now - began >= 2.0


def test_ground_frame_tilt_is_not_judged() -> None:
    stand = Stand()
    stand.setpoint = Setpoint.tilt(
        roll_deg=0, pitch_deg=-10, up=0, yaw_rate_deg_s=0, frame=ReferenceFrame.GROUND
    )
    assert stand.fly(10.0) == ""


@pytest.mark.anyio
@pytest.mark.parametrize("setpoint", IGNORED.values(), ids=list(IGNORED))
@pytest.mark.parametrize("firmware", ["1.0", "3.1"])
async def test_the_virtual_aircraft_follows_each_of_them(setpoint: Setpoint, firmware: str) -> None:
    """Through noise, gusts, and changes of direction each second."""
    opposite = Setpoint(
        setpoint.mode, -setpoint.x, -setpoint.y, -setpoint.z, -setpoint.yaw, setpoint.frame
    )
    settings = AircraftSettings(wind_north=4.0, gusts=1.0, noise=1.0)
    async with rig(firmware=firmware, settings=settings) as flown:
        async with flown.aircraft.control() as control:
            await control.take_off()
            await control.climb_to(12.0)
            async for tick in control.ticks():
                if tick.elapsed > 12.0:
                    break
                control.send(setpoint if int(tick.elapsed / 2) % 2 == 0 else opposite)


@pytest.mark.anyio
async def test_the_error_says_what_is_asked_for_and_what_is_flown() -> None:
    async with rig() as flown:
        with pytest.raises(
            SetpointsIgnored, match=r"3\.0 m/s are asked for, and 0\.0 m/s"
        ) as found:
            async with flown.aircraft.control() as control:
                await control.take_off()
                flown.virtual.set_faults(LineFaults(deaf=True))
                async for _ in control.ticks():
                    control.send(NORTH)
        assert "no-fly zone" in str(found.value)


@pytest.mark.parametrize("asked", ["velocity", "climb", "turn", "tilt", "without a velocity"])
def test_a_slow_line_has_its_time_besides(asked: str) -> None:
    """What an order takes to show is no disobedience: here 0.8 s more."""
    stand = Stand()
    stand.check = FollowCheck(
        cast(AircraftState, stand), lambda: stand.setpoint, lambda: stand.now, lambda: 0.8
    )
    stand.setpoint, usual_s = IGNORED.get(asked), FOLLOW_S
    if stand.setpoint is None:  # 10 m, and not before 2.5 s
        stand.setpoint, stand.velocity, usual_s = velocity(north=10.0, east=0.0), None, 2.5
    assert stand.fly(usual_s + 0.7) == ""
    assert stand.fly(0.3) != ""


def test_a_pause_between_two_looks_counts_as_half_a_second_without_a_velocity() -> None:
    """A program that stood still for ten seconds has sent no setpoint meanwhile."""
    stand = Stand()
    stand.setpoint, stand.velocity = NORTH, None  # 3 m/s: half a second of it are 1.5 m
    assert stand.check.look() == ""
    for _ in range(6):
        stand.now += 10.0
        assert stand.check.look() == ""
    stand.now += 10.0
    assert stand.check.look() != "", "ten metres"
