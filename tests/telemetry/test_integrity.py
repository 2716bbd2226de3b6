"""What telemetry may say of a place, and what it may not, by hand and by seeded flights."""

from __future__ import annotations

import math
import random
from dataclasses import dataclass, field

import pytest

from m100link.protocol import encode_telemetry, profile
from m100link.protocol.firmware import FirmwareProfile
from m100link.protocol.packet import telemetry_size
from m100link.telemetry.integrity import GATE_M, Integrity, IntegrityMonitor, IntegrityState, _Fix
from m100link.telemetry.sample import Sample
from m100link.telemetry.state import AircraftState

EARTH_M = 6_378_137.0
FLYING, STANDING, TAKING_OFF = 3, 1, 2
S = IntegrityState


@dataclass
class Flight:
    """An aircraft as a source of packages; whatever is set is sent from the next one on.

    Attributes:
        bearing: Which way it flies, and says that it does, rad clockwise from north. By default
            neither of its parts is 0, and they have different signs and sizes.
        latitude, longitude: Of where it began, rad; by default in the south, before the line of
            the date.
        way, height: How far it is, m; moved by the velocities.
        speed, climb: To that bearing and up, m/s.
        offset: Of the place that it tells, m to that bearing.
        told_speed, told_climb: What it tells, where that is not so.
        rates: Packages between two of an item.
    """

    firmware: str = "1.0"
    step_s: float = 0.02
    has_time: bool = True
    has_velocity: bool = True
    vouches: bool = True
    health: int = 5
    status: int | None = FLYING
    bearing: float = 2.2
    told_bearing: float | None = None
    latitude: float = -0.7
    longitude: float = math.pi - 1e-6
    way: float = 0.0
    height: float = 20.0
    speed: float = 0.0
    climb: float = 0.0
    offset: float = 0.0
    told_speed: float | None = None
    told_climb: float | None = None
    tick_rate: float = 1.0
    delay: float = 0.0
    every: dict[str, int] = field(default_factory=dict)
    now: float = 100.0
    device: float = 7.0
    state: AircraftState = field(init=False)
    count: int = 0

    def __post_init__(self) -> None:
        self.state = AircraftState(lambda: self.now)

    @property
    def profile(self) -> FirmwareProfile:
        return profile(self.firmware)

    def package(self) -> Sample:
        items: dict[str, tuple[float, ...]] = {}
        tick = int(self.device * self.profile.tick_hz) & 0xFFFFFFFF
        if self.has_time:
            items["time"] = (tick, 0, 0) if self.firmware == "3.1" else (tick,)
        if self.has_velocity:
            told = self.speed if self.told_speed is None else self.told_speed
            climb = self.climb if self.told_climb is None else self.told_climb
            to = self.bearing if self.told_bearing is None else self.told_bearing
            velocity = told * math.cos(to), told * math.sin(to), climb
            items["velocity"] = velocity if self.firmware == "1.0" else (*velocity, self.vouches)
        north = (self.way + self.offset) * math.cos(self.bearing)
        east = (self.way + self.offset) * math.sin(self.bearing)
        latitude = self.latitude + north / EARTH_M
        longitude = self.longitude + east / (EARTH_M * math.cos(self.latitude))
        longitude = math.remainder(longitude, 2 * math.pi) if math.isfinite(east) else east
        items["position"] = latitude, longitude, 400.0, self.height, self.health
        if self.status is not None:
            items["flight_status"] = (self.status,)
        self.count += 1
        kept = {
            name: value
            for name, value in items.items()
            if self.count % self.every.get(name, 1) == 0
        }
        return Sample(encode_telemetry(kept, self.profile), self.profile, self.now + self.delay)

    def move(self) -> None:
        self.now += self.step_s
        self.device += self.step_s * self.tick_rate
        self.way += self.speed * self.step_s
        self.height += self.climb * self.step_s

    def fly(self, seconds: float) -> Integrity:
        """Fly and tell; what is said of it at the end."""
        for _ in range(round(seconds / self.step_s)):
            self.move()
            self.state.update(self.package())
            found = self.state.integrity
        return found

    def until(self, wanted: IntegrityState, within: float = 10.0) -> float:
        """Seconds until that is said, and nothing else before."""
        begun = self.now
        while self.now - begun < within:
            found = self.fly(self.step_s)
            if found.state is wanted:
                assert found.seen
                return self.now - begun
            assert found.state is S.GOOD, found
        raise AssertionError(f"{wanted} was not said within {within} s")


# -- what is legal --------------------------------------------------------------------------------


def accelerate(flight: Flight) -> None:
    """Back and forth with 7 m/s², which is more than a Matrice does."""
    for _ in range(6):
        for change in (+7.0, -7.0, -7.0, +7.0):
            for _ in range(round(1.4 / flight.step_s)):
                flight.speed += change * flight.step_s
                assert flight.fly(flight.step_s).state is S.GOOD


@pytest.mark.parametrize("firmware", ["1.0", "2.3", "3.1"])
@pytest.mark.parametrize("step_s", [0.01, 0.02, 0.1, 1.0])
def test_a_flight_agrees_with_itself_at_each_rate(firmware: str, step_s: float) -> None:
    flight = Flight(firmware=firmware, step_s=step_s)
    assert flight.fly(5.0).state is S.GOOD
    accelerate(flight)
    flight.climb = 3.0
    found = flight.fly(5.0)
    assert found.state is S.GOOD
    assert found.test_ratio < 1.0
    assert found.height_test_ratio < 1.0


@pytest.mark.parametrize(
    "every",
    [
        {"velocity": 50},
        {"position": 50},
        {"time": 50},
        {"velocity": 50, "position": 50},
        {"velocity": 50, "position": 50, "time": 50},
        {"position": 5, "velocity": 7},
        {"flight_status": 50},
    ],
    ids=str,
)
def test_items_at_1_hz_and_at_rates_that_never_meet_agree(every: dict[str, int]) -> None:
    flight = Flight(every=every)
    flight.fly(3.0)
    accelerate(flight)


@pytest.mark.parametrize("firmware", ["1.0", "3.1"])
def test_at_rest_a_place_may_stay_to_the_bit(firmware: str) -> None:
    assert Flight(firmware=firmware).fly(600.0).state is S.GOOD


def test_the_sources_do_not_settle_the_sign_of_a_climb() -> None:
    flight = Flight()
    flight.climb, flight.told_climb = 3.0, -3.0
    assert flight.fly(20.0).state is S.GOOD
    flight.height += 1.0  # as little as that is forgotten
    assert flight.fly(20.0).state is S.GOOD


def test_without_velocity_or_time_a_flight_agrees() -> None:
    for flight in (Flight(has_velocity=False), Flight(has_time=False)):
        flight.fly(3.0)
        accelerate(flight)


def test_a_velocity_that_the_aircraft_does_not_vouch_for_says_nothing() -> None:
    flight = Flight(firmware="3.1", vouches=False)
    flight.told_speed = 9.0
    assert flight.fly(10.0).state is S.GOOD


def test_a_velocity_of_more_than_a_second_ago_says_nothing() -> None:
    """It flew 9 m/s when its velocity came last, and hovers by now."""
    flight = Flight(speed=9.0)
    flight.fly(5.0)
    flight.has_velocity = False
    flight.fly(1.2)
    flight.speed = 0.0
    assert flight.fly(10.0).state is S.GOOD


@pytest.mark.parametrize("status", [STANDING, TAKING_OFF])
def test_before_it_flies_a_place_may_jump(status: int) -> None:
    flight = Flight(status=status)
    flight.fly(3.0)
    flight.offset = 500.0
    assert flight.fly(0.1).state is S.UNKNOWN
    flight.status = FLYING
    assert flight.fly(5.0).state is S.GOOD


def test_when_reception_becomes_good_a_place_may_jump() -> None:
    flight = Flight(health=2)
    assert flight.fly(3.0).state is S.UNKNOWN
    flight.offset, flight.health = 60.0, 3
    assert flight.fly(5.0).state is S.GOOD


def test_an_aircraft_that_restarts_in_flight_begins_anew() -> None:
    flight = Flight()
    flight.fly(10.0)
    flight.device = 0.0
    assert flight.fly(5.0).state is S.GOOD


def test_the_tick_may_wrap() -> None:
    flight = Flight()
    flight.device = (1 << 32) / 600 - 5.0
    flight.speed = 5.0
    assert flight.fly(10.0).state is S.GOOD


def test_a_gap_and_what_waited_in_it_are_legal() -> None:
    flight = Flight(speed=8.0)
    flight.fly(5.0)
    for gap in (0.3, 0.9, 1.5, 4.0):
        waited = []
        for _ in range(round(gap / flight.step_s)):
            flight.move()
            waited.append(flight.package())
        for sample in waited:
            flight.state.update(Sample(sample.value, sample.profile, flight.now))
            assert flight.state.integrity.state is S.GOOD, gap
        assert flight.fly(5.0).state is S.GOOD


@pytest.mark.parametrize("tick_rate", [0.5, 0.667, 1.5, 10.0])
def test_a_clock_that_runs_otherwise_than_its_profile_says_is_not_believed(
    tick_rate: float,
) -> None:
    """Simulators at another speed, and a firmware that nobody has measured."""
    flight = Flight(tick_rate=tick_rate, speed=8.0)
    assert flight.fly(30.0).state is S.GOOD


@pytest.mark.parametrize(("first", "then"), [("1.0", "3.1"), ("3.1", "1.0")])
def test_a_profile_that_is_corrected_has_another_tick_and_faults_are_noticed(
    first: str, then: str
) -> None:
    flight = Flight(firmware=first, speed=8.0)
    flight.fly(5.0)
    flight.firmware = then
    assert flight.fly(10.0).state is S.GOOD
    for _ in range(round(2.0 / flight.step_s)):
        flight.delay += 0.48 * flight.step_s
        found = flight.fly(flight.step_s)
    assert found.state is S.LATE


def test_it_is_judged_for_those_who_ask_once_a_second() -> None:
    flight = Flight(speed=8.0)
    for _ in range(30):
        flight.move()
        flight.state.update(flight.package())
    for _ in range(60):
        for _ in range(50):
            flight.move()
            flight.state.update(flight.package())
        assert flight.state.integrity.state is S.GOOD


def test_seeded_flights_with_noise_loss_repeats_and_overtaking_agree() -> None:
    """Noise as GPS and its filter make it; 200 flights of a minute."""
    for seed in range(200):
        chance = random.Random(seed)
        flight = Flight(
            firmware=chance.choice(["1.0", "2.3", "3.1"]),
            step_s=chance.choice([0.01, 0.02, 0.1]),
            has_time=chance.random() < 0.8,
            every={"velocity": chance.choice([1, 2, 10]), "position": chance.choice([1, 5])},
        )
        loss, repeats = chance.choice([0.0, 0.1, 0.4]), chance.choice([0.0, 0.1])
        held: Sample | None = None
        lag = 0.0
        for _ in range(round(20.0 / flight.step_s)):
            pull = chance.gauss(0.0, 3.0) - 0.3 * flight.speed
            flight.speed += max(-7.0, min(7.0, pull)) * flight.step_s
            lag += (-lag / 60.0) * flight.step_s + chance.gauss(0, 0.2) * math.sqrt(
                2 * flight.step_s / 60.0
            )
            flight.offset, flight.told_speed = lag, flight.speed + chance.gauss(0.0, 0.05)
            flight.move()
            sample = flight.package()
            if chance.random() < loss:
                continue
            for one in (sample, held) if held is not None else (sample,):
                flight.state.update(Sample(one.value, one.profile, flight.now))
                found = flight.state.integrity
                assert found.state in (S.GOOD, S.UNKNOWN), (seed, found)
            held = sample if chance.random() < repeats else None


# -- what is not ----------------------------------------------------------------------------------


@pytest.mark.parametrize("speed", [2.0, 3.0, 5.0, 10.0])
def test_a_velocity_without_a_way_is_noticed(speed: float) -> None:
    flight = Flight(speed=speed)
    flight.fly(5.0)
    flight.speed, flight.told_speed = 0.0, speed
    flight.offset += 0.0
    seconds = 0.0
    while (found := flight.fly(flight.step_s)).state is S.GOOD:
        seconds += flight.step_s
    assert found.state in (S.FROZEN, S.INCONSISTENT)
    assert seconds <= 1.1


@pytest.mark.parametrize(("speed", "within"), [(2.0, 2.4), (3.0, 1.2), (5.0, 0.7), (10.0, 0.4)])
def test_a_way_without_a_velocity_is_noticed(speed: float, within: float) -> None:
    flight = Flight(speed=speed)
    flight.fly(5.0)
    flight.told_speed = 0.0
    assert flight.until(S.INCONSISTENT) <= within


def test_a_way_to_another_side_than_the_velocity_says_is_noticed() -> None:
    """The same speed to a wrong side: 6 m/s and 0.7 rad off is a lie of 4.1 m/s."""
    seed = random.randrange(1 << 32)
    chance = random.Random(seed)
    for _ in range(12):
        bearing, latitude = chance.uniform(-3.1, 3.1), chance.uniform(-1.2, 1.2)
        off = chance.choice([-1.0, 1.0]) * chance.uniform(0.7, 3.1)
        flight = Flight(bearing=bearing, latitude=latitude, speed=6.0)
        assert flight.fly(5.0).state is S.GOOD, f"seed {seed}"
        flight.told_bearing = bearing + off
        assert flight.until(S.INCONSISTENT) <= 1.2, f"seed {seed}: {bearing}, {latitude}, {off}"


@pytest.mark.parametrize(("off", "found"), [(2.4, S.GOOD), (3.2, S.JUMPED)])
def test_a_place_may_be_off_by_the_gate_to_any_side(off: float, found: IntegrityState) -> None:
    """25 m/s fly half a metre between two packages."""
    for bearing in (0.0, 1.5, 2.5, -2.5, -1.5):
        for latitude in (-1.2, 0.0, 1.2):
            flight = Flight(bearing=bearing, latitude=latitude, has_velocity=False)
            flight.fly(5.0)
            flight.offset = off
            assert flight.fly(0.02).state is found, (bearing, latitude)


def test_a_height_that_stands_while_it_climbs_is_noticed() -> None:
    flight = Flight(climb=2.0)
    flight.fly(5.0)
    flight.climb, flight.told_climb = 0.0, 2.0
    assert flight.until(S.FROZEN) <= 1.1


@pytest.mark.parametrize("jump", [4.0, -30.0, 1000.0, -2.5e6])
@pytest.mark.parametrize("has_velocity", [True, False])
def test_a_jump_is_noticed_at_once(jump: float, has_velocity: bool) -> None:
    flight = Flight(has_velocity=has_velocity)
    flight.fly(5.0)
    flight.offset = jump
    assert flight.until(S.JUMPED) <= 2 * flight.step_s


def test_a_jump_with_packages_at_1_hz_is_noticed_with_the_next() -> None:
    flight = Flight(step_s=1.0)
    flight.fly(10.0)
    flight.offset = 100.0
    assert flight.until(S.JUMPED) <= 1.0


def test_the_same_package_for_ever_is_a_clock_that_stands() -> None:
    flight = Flight(speed=5.0)
    flight.fly(5.0)
    last = flight.package()
    for _ in range(60):
        flight.now += flight.step_s
        flight.state.update(Sample(last.value, last.profile, flight.now))
        found = flight.state.integrity
    assert found.state is S.CLOCK_STOPPED
    assert "has not advanced for 1." in found.seen
    flight.device += 1.2
    flight.way += 6.0
    assert flight.fly(0.1).state is S.GOOD, "it was the line, and that is over"


@pytest.mark.parametrize("steps", [(-10.0,), (10.0, -10.0), (-0.02,)], ids=str)
def test_a_clock_that_goes_back_and_forth_does_not_advance(steps: tuple[float, ...]) -> None:
    flight = Flight()
    flight.fly(5.0)
    found = S.GOOD
    for number in range(60):
        flight.device += steps[number % len(steps)] - flight.step_s
        found = flight.fly(flight.step_s).state
    assert found is S.CLOCK_STOPPED


@pytest.mark.parametrize(("growth", "within"), [(0.48, 1.4), (0.13, 4.6), (0.02, 27.0)])
def test_packages_that_come_ever_later_are_noticed(growth: float, within: float) -> None:
    flight = Flight()
    flight.fly(10.0)
    begun = flight.now
    while flight.state.integrity.state is S.GOOD:
        flight.delay += growth * flight.step_s
        flight.fly(flight.step_s)
        assert flight.now - begun <= within
    found = flight.state.integrity
    assert found.state is S.LATE
    assert found.delay_s > 0.5


def test_a_delay_that_was_always_there_is_not_seen() -> None:
    assert Flight(delay=0.9).fly(20.0).state is S.GOOD


def test_what_was_wrong_is_believed_again_after_three_good_seconds() -> None:
    flight = Flight()
    flight.fly(5.0)
    flight.offset = 50.0
    assert flight.until(S.JUMPED) <= 0.1
    assert flight.fly(2.5).state is S.JUMPED
    flight.offset = 0.0
    assert flight.fly(2.5).state is S.JUMPED
    assert flight.fly(1.0).state is S.GOOD


def test_what_stays_wrong_is_not() -> None:
    flight = Flight(speed=5.0)
    flight.fly(5.0)
    flight.told_speed = 0.0
    flight.until(S.INCONSISTENT)
    assert flight.fly(20.0).state is S.INCONSISTENT


@pytest.mark.parametrize("place", [math.nan, math.inf, 2.0])
def test_what_is_no_place_is_no_fault_of_this_kind(place: float) -> None:
    flight = Flight(bearing=0.0, latitude=0.0)
    flight.fly(5.0)
    flight.way = place * EARTH_M
    assert flight.fly(0.1).state is S.UNKNOWN


def test_what_is_true_of_each_state_is_said_of_it() -> None:
    timely = {state for state in S if Integrity(state).is_timely}
    assert timely == set(S) - {S.CLOCK_STOPPED, S.LATE}
    plausible = {state for state in S if Integrity(state).is_plausible}
    assert plausible == {S.UNKNOWN, S.GOOD, S.CLOCK_STOPPED, S.LATE}


def test_whatever_comes_nothing_raises() -> None:
    """The watchdog asks before each frame: an exception there would end the watch, not the lie."""
    for seed in range(300):
        chance = random.Random(seed)
        firmware = profile(chance.choice(["1.0", "2.3", "3.1", "1.0-document"]))
        state, now = AircraftState(lambda: 0.0), 0.0
        for _ in range(40):
            now += chance.choice([0.0, 0.02, 0.02, 1.5, 1e6, -1.0])
            flags = chance.getrandbits(16) & firmware.item_flags
            size = telemetry_size(flags, firmware) - 2
            kind = chance.randrange(3)
            body = chance.randbytes(size) if kind else bytes(size)
            if kind == 2:
                body = bytes(chance.choice([0x00, 0x7F, 0x80, 0xFF]) for _ in range(size))
            state.update(Sample(flags.to_bytes(2, "little") + body, firmware, now))
            found = state.integrity
            assert not math.isnan(found.test_ratio), seed
            assert not math.isnan(found.height_test_ratio), seed
            assert math.isfinite(found.delay_s), seed


def test_one_wrong_status_of_standing_ends_no_finding() -> None:
    flight = Flight()
    flight.fly(5.0)
    flight.offset = 500.0
    assert flight.fly(0.2).state is S.JUMPED
    for _ in range(5):
        flight.status = STANDING
        flight.fly(0.04)
        flight.status = FLYING
        assert flight.fly(0.1).state is S.JUMPED


# -- figures ---------------------------------------------------------------------------------------


def steady(step_s: float = 0.1, **values: object) -> Flight:
    """Ten good seconds: its clock is trusted."""
    flight = Flight(step_s=step_s, **values)  # type: ignore[arg-type]
    assert flight.fly(10.0).state is S.GOOD
    return flight


def test_ratios_are_what_is_left_of_differences_by_their_gate() -> None:
    """In 0.1 s, e^(-0.1/1.667) = 0.9418 of one is left; the gates are 2.5 and 5 m, and 3.5 cm."""
    flight = steady()
    flight.told_speed, flight.told_climb = 4.0, 3.0
    first, second = flight.fly(0.1), flight.fly(0.1)
    assert first.test_ratio == pytest.approx(0.2 / 2.535, abs=1e-3)
    assert first.height_test_ratio == pytest.approx(0.15 / 5.035, abs=1e-3)
    assert second.test_ratio == pytest.approx((0.2 * 0.9418 + 0.4) / 2.535, abs=1e-3)
    assert second.height_test_ratio == pytest.approx((0.15 * 0.9418 + 0.3) / 5.035, abs=1e-3)


@pytest.mark.parametrize(
    ("change", "state", "seen"),
    [
        ({"offset": 50.0}, S.JUMPED, "the position jumped by 50 m within 0.10 s"),
        ({"height": 70.0}, S.JUMPED, "the position jumped by 50 m within 0.10 s"),
        ({"told_speed": 0.36}, S.FROZEN, "the position stood still for 1.1 s at a velocity of 0.4"),
        ({"told_speed": 0.25}, S.GOOD, ""),
        ({"told_climb": -2.0}, S.FROZEN, "the height stood still for 1.1 s at a velocity of 2.0"),
        ({"told_climb": 0.25}, S.GOOD, ""),
        ({"speed": 1.4, "told_speed": 0.0}, S.GOOD, ""),
        ({"speed": 1.7, "told_speed": 0.0}, S.INCONSISTENT, "the position is 2.5 m from where"),
        ({"climb": 4.0, "told_climb": 6.9}, S.GOOD, ""),
        ({"climb": 4.0, "told_climb": 7.2}, S.INCONSISTENT, "the height is 5.1 m from where"),
        ({"delay": 0.48}, S.GOOD, ""),
        ({"delay": 0.55}, S.LATE, "telemetry comes 0.5 s late"),
        ({"tick_rate": 0.0}, S.CLOCK_STOPPED, "has not advanced for 1.1 s"),
    ],
    ids=str,
)
def test_a_finding_begins_at_its_limit_and_names_its_figures(
    change: dict[str, float], state: IntegrityState, seen: str
) -> None:
    flight = steady()
    for name, value in change.items():
        setattr(flight, name, value)
    found = next(
        (one for one in (flight.fly(0.1) for _ in range(100)) if one.state is not S.GOOD), None
    )
    assert (found.state if found else S.GOOD) is state
    assert found is None or seen in found.seen


@pytest.mark.parametrize(("rate", "found"), [(0.96, S.LATE), (0.94, S.GOOD), (1.04, S.GOOD)])
def test_a_clock_is_trusted_that_is_right_to_five_percent(
    rate: float, found: IntegrityState
) -> None:
    """One that loses 4 % is half a second late after 13 s."""
    assert Flight(step_s=0.1, tick_rate=rate).fly(20.0).state is found


def test_how_late_packages_come_is_known_once_the_clock_is_and_lasts_for_a_moment() -> None:
    flight = Flight(step_s=0.02)
    flight.fly(0.5)
    flight.delay = 0.3
    assert flight.fly(1.0).delay_s == 0.0
    flight = steady(0.02)
    flight.delay = 0.3
    assert flight.fly(0.1).delay_s == pytest.approx(0.3, abs=5e-3)
    flight.delay = 0.6
    assert flight.fly(0.2).state is S.GOOD, "what waited is read in a moment"
    assert flight.fly(0.06).state is S.LATE


@pytest.mark.parametrize(("silent", "delay"), [(0.1, 0.8), (0.3, 0.0)])
def test_after_a_second_of_silence_delays_count_anew(silent: float, delay: float) -> None:
    flight = steady(0.02)
    flight.now, flight.device = flight.now + silent, flight.device + silent
    flight.delay = 0.8
    assert flight.fly(0.1).delay_s == pytest.approx(delay, abs=5e-3)


@pytest.mark.parametrize(("gap", "found"), [(2.3, S.JUMPED), (2.6, S.GOOD)])
def test_after_two_and_a_half_seconds_nobody_knows_where_it_may_be(
    gap: float, found: IntegrityState
) -> None:
    flight = steady(has_velocity=False)
    flight.now, flight.device = flight.now + gap, flight.device + gap
    flight.offset = 70.0
    assert flight.fly(0.1).state is found


@pytest.mark.parametrize(("leap", "found"), [(1.8, S.JUMPED), (2.2, S.GOOD)])
def test_a_clock_that_leaps_by_more_than_two_seconds_began_anew(
    leap: float, found: IntegrityState
) -> None:
    flight = steady(has_velocity=False)
    flight.device += leap
    flight.offset = 70.0
    assert flight.fly(0.1).state is found


@pytest.mark.parametrize(("off", "found"), [(29.0, S.GOOD), (31.0, S.JUMPED)])
def test_without_a_clock_arrivals_may_be_off_by_a_second(off: float, found: IntegrityState) -> None:
    """25 m/s fly 27.5 m in 1.1 s, and places may be off by 2.5 m."""
    flight = steady(has_velocity=False, has_time=False)
    flight.offset = off
    assert flight.fly(0.1).state is found


def test_a_place_is_believed_again_after_three_seconds() -> None:
    flight = steady()
    flight.offset = 50.0
    assert flight.fly(0.1).state is S.JUMPED
    assert flight.fly(2.8).state is S.JUMPED
    assert flight.fly(0.3).state is S.GOOD


@pytest.mark.parametrize(("epoch", "allowed_m"), [(0, 3.5), (-1, 13.5)])
def test_where_only_arrivals_tell_the_time_a_second_of_flight_more_is_allowed(
    epoch: int, allowed_m: float
) -> None:
    """North 10 m/s for 1 s at up to 7 m/s2, and 2 m from where that leads."""
    monitor = IntegrityMonitor(lambda _: None, lambda: None, None)
    monitor._joint = _Fix(0.0, epoch, 0.0, 0.0, 20.0, (10.0, 0.0, 0.0))
    monitor._innovate(_Fix(1.0, epoch, 12.0 / EARTH_M, 0.0, 20.0, (10.0, 0.0, 0.0)), 1.0)
    assert monitor._ratio == pytest.approx(2.0 / (GATE_M + allowed_m), rel=1e-3)
