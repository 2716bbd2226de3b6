"""The newest value of every item, its age, and how it arrives."""

from __future__ import annotations

import random
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import pytest

from m100link.protocol import Attitude, Battery, Position, encode_telemetry, profile
from m100link.protocol.items import ITEMS, ItemLayout
from m100link.protocol.packet import telemetry_size
from m100link.telemetry.sample import Sample
from m100link.telemetry.state import AircraftState

FIRMWARE = profile("1.0")
ATTITUDE = {"quaternion": (1.0, 0.0, 0.0, 0.0)}


class Clock:
    def __init__(self) -> None:
        self.now = 100.0

    def __call__(self) -> float:
        return self.now


def sample(at: float, **items: tuple[float, ...]) -> Sample:
    return Sample(encode_telemetry(items, FIRMWARE), FIRMWARE, at)


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def state(clock: Clock) -> AircraftState:
    return AircraftState(clock)


def test_what_never_arrived_is_none_and_has_no_age(state: AircraftState) -> None:
    assert state.get(Position) is None
    assert state.age(Position) is None
    assert state.received_at(Position) is None
    assert state.newest_age is None
    assert state.fresh(Position, within=1e9) is None
    assert set(state.situation().values()) == {None}


def test_each_item_keeps_its_newest_value_and_its_own_age(
    state: AircraftState, clock: Clock
) -> None:
    state.update(sample(100.0, battery=(90,), **ATTITUDE))
    state.update(sample(100.5, battery=(80,)))
    clock.now = 101.0
    assert state.get(Battery) == Battery(80)
    assert state.age(Battery) == pytest.approx(0.5)
    assert state.age(Attitude) == pytest.approx(1.0)
    assert state.newest_age == pytest.approx(0.5)


def test_fresh_is_what_is_not_older_than_asked_for(state: AircraftState, clock: Clock) -> None:
    state.update(sample(100.0, battery=(90,)))
    clock.now = 102.0
    assert state.fresh(Battery, within=2.0) == Battery(90)
    assert state.fresh(Battery, within=1.9) is None


def test_what_came_far_in_the_future_is_as_unknown_as_what_is_old(
    state: AircraftState, clock: Clock
) -> None:
    """A replay that is moved back asks by an earlier time than that of what is known."""
    state.update(sample(100.0, battery=(90,)))
    for now, known in ((98.0, Battery(90)), (97.9, None), (102.0, Battery(90)), (102.1, None)):
        assert state.fresh(Battery, within=2.0, now=now) == known, now
    clock.now = 94.9  # a battery is known for 5 s
    assert state.fresh(Battery) is None


def test_rate_jitter_and_longest_gap_are_those_of_the_item(state: AircraftState) -> None:
    assert state.statistics(Battery).rate_hz is None
    for at in (100.0, 101.0, 102.0):
        state.update(sample(at, battery=(90,)))
        state.update(sample(at + 0.5, **ATTITUDE))
    state.update(sample(104.0, **ATTITUDE))
    battery, attitude = state.statistics(Battery), state.statistics(Attitude)
    assert (battery.count, battery.rate_hz, battery.jitter_s) == (3, 1.0, 0.0)
    assert (attitude.count, attitude.longest_gap_s) == (4, 1.5)
    # Of the last 2.5 s: gaps of 1 and 1.5 s.
    assert attitude.rate_hz == pytest.approx(0.8)
    assert attitude.jitter_s == pytest.approx(0.25)


SENT = [item for item in ITEMS if item.name in FIRMWARE.items]


@pytest.mark.parametrize("seed", range(20))
def test_items_that_came_together_and_part_each_keep_their_own(seed: int, clock: Clock) -> None:
    """Against a model that keeps the arrivals of each item by itself."""
    dice = random.Random(seed)
    state = AircraftState(clock)
    arrivals: dict[str, list[float]] = {item.name: [] for item in ITEMS}
    newest: dict[str, Sample] = {}
    combinations = [
        dice.sample(SENT, dice.randint(0, len(SENT))) for _ in range(dice.choice((1, 3, 30)))
    ]
    for _ in range(300):
        clock.now += dice.choice((0.0, 0.01, 0.1, 1.0))
        carried = dice.choice(combinations)
        values = {item.name: (dice.randrange(9),) for item in carried}
        package = sample(
            clock.now,
            **{name: value * len(FIRMWARE.items[name].fields) for name, value in values.items()},
        )
        state.update(package)
        for item in carried:
            arrivals[item.name].append(clock.now)
            newest[item.name] = package
        item = dice.choice(ITEMS)
        found = state.statistics(item.record)
        expected = newest[item.name].get(item.record) if item.name in newest else None
        gaps = [later - earlier for earlier, later in pairwise(arrivals[item.name])]
        assert state.get(item.record) == expected
        assert state.received_at(item.record) == next(reversed(arrivals[item.name]), None)
        assert (found.count, found.longest_gap_s) == (
            len(arrivals[item.name]),
            max(gaps, default=0.0),
        )


def test_a_line_that_sends_every_flag_word_is_not_remembered_whole(state: AircraftState) -> None:
    for flags in range(1, FIRMWARE.item_flags + 1):
        value = flags.to_bytes(2, "little") + bytes(telemetry_size(flags, FIRMWARE) - 2)
        state.update(Sample(value, FIRMWARE, 100.0 + flags / 100))
    assert len(state._cells_of) <= 256
    assert state.battery == Battery(0)
    assert state.received_at(Battery) == 100.0 + FIRMWARE.item_flags / 100


def test_it_shows_itself_at_a_prompt(clock: Clock) -> None:
    state = AircraftState(clock)
    assert repr(state) == "<AircraftState no telemetry>"
    state.update(sample(clock.now, battery=(87,)))
    clock.now += 0.25
    assert repr(state) == "<AircraftState 0.25 s old, battery_percent 87>"


def test_a_notebook_shows_every_item_with_its_age(clock: Clock, state: AircraftState) -> None:
    state.update(sample(100.0, battery=(90,), **ATTITUDE))
    clock.now = 101.5
    html = state._repr_html_()
    assert "<td>battery</td><td>percent 90</td><td>1.50 s</td><td></td>" in html
    assert "<td>quaternion</td><td>q0 1, q1 0, q2 0, q3 0</td>" in html
    assert "<td>position</td><td></td><td>never</td>" in html
    assert html.count("<tr>") == 1 + len(ITEMS)
    state.update(sample(100.0, velocity=(0.1234567, -2.0, 3.0)))
    assert "0.123457, east_m_s -2, up_m_s 3, status None</td>" in state._repr_html_()


@pytest.mark.parametrize("hertz", [1.0, 5.0, 100.0])
def test_what_no_rate_is_made_of_any_more_is_forgotten(state: AircraftState, hertz: float) -> None:
    """A wall holds a thousand of these, and runs for months."""
    for number in range(3000):
        state.update(sample(100.0 + number / hertz, **ATTITUDE))
    [cell] = {one for one in state._cells.values() if one.count}
    assert len(cell.arrivals) <= 2.5 * hertz + 2 + 16
    assert state.statistics(Attitude).rate_hz == pytest.approx(hertz)
    assert state.statistics(Attitude).count == 3000


# -- when a status of standing is believed ---------------------------------------------------------

STANDS, LANDS, FLIES = 1, 4, 3


def told(state: AircraftState, at: float, status: int, **items: tuple[float, ...]) -> int | None:
    """A status arrives, and perhaps more; returns the one that is believed then."""
    state.update(sample(at, flight_status=(status,), **items))
    believed = state.believed_status
    return None if believed is None else believed.status


@pytest.mark.parametrize("rate_hz", [1.0, 5.0, 10.0, 50.0, 100.0])
def test_standing_is_believed_after_three_statuses_over_half_a_second(
    state: AircraftState, rate_hz: float
) -> None:
    assert told(state, 100.0, LANDS) == LANDS
    at, count = 100.0 + 1 / rate_hz, 1
    first = at
    while told(state, at, STANDS) == LANDS:
        assert count < 3 or at - first < 0.5, "too late"
        at, count = at + 1 / rate_hz, count + 1
    assert count >= 3
    assert 0.5 <= at - first < 0.5 + 2 / rate_hz or rate_hz == 1.0
    assert told(state, at + 1 / rate_hz, FLIES) == FLIES  # which a single one is enough for


@pytest.mark.parametrize("seed", range(20))
def test_no_drawing_of_wrong_statuses_makes_what_flies_stand(
    state: AircraftState, seed: int
) -> None:
    """Up to four of them in a row, at any rate, of which half a second holds at least one true."""
    chance = random.Random(seed)
    at, rate_hz = 100.0, chance.choice((1.0, 5.0, 10.0))
    believed = {told(state, at, FLIES)}
    for _ in range(200):
        for status in [STANDS] * chance.randint(0, 2 if rate_hz < 10.0 else 4) + [FLIES]:
            at += chance.uniform(0.9, 1.1) / rate_hz
            believed.add(told(state, at, status))
    assert believed == {FLIES}, f"seed {seed}"


WIDE = replace(
    FIRMWARE, items=dict(FIRMWARE.items) | {"flight_status": ItemLayout("H", ("status",))}
)


@pytest.mark.parametrize("seed", range(20))
def test_a_status_is_believed_as_if_each_was_looked_at(clock: Clock, seed: int) -> None:
    """Most say what the one before said, and are not read; under any firmware, beside any items."""
    chance = random.Random(seed)
    state, looking = AircraftState(clock), AircraftState(clock)
    at, status = 100.0, FLIES
    for _ in range(400):
        at += chance.choice((0.01, 0.1, 0.1, 1.0))
        status = status if chance.random() < 0.7 else chance.choice((STANDS, LANDS, FLIES, 7))
        firmware = chance.choice((FIRMWARE, WIDE))
        items: dict[str, Sequence[float]] = {"flight_status": (status + 256 * (firmware is WIDE),)}
        items |= ATTITUDE if chance.random() < 0.5 else {}
        items |= {"velocity": (0.0, 0.0, chance.choice((0.1, 0.6)))}
        if chance.random() < 0.1:
            del items["flight_status"]
        package = Sample(encode_telemetry(items, firmware), firmware, at)
        state.update(package)
        looking._standing = looking._standing or (0, at, at, None)  # the same as none: it looks
        looking.update(package)
        assert state.believed_status == looking.believed_status, f"seed {seed}"


def test_what_has_only_been_told_once_is_not_known(state: AircraftState) -> None:
    assert [told(state, at, STANDS) for at in (100.0, 100.3, 100.5, 100.6)] == [*[None] * 2, 1, 1]


@pytest.mark.parametrize(
    "moving",
    [
        {"velocity": (0.0, 0.0, 0.6)},
        {"velocity": (0.0, 0.0, -0.6)},
        {"velocity": (1.5, 1.5, 0.0)},
    ],
)
def test_what_moves_does_not_stand_however_often_it_is_told(
    state: AircraftState, moving: dict[str, tuple[float, ...]]
) -> None:
    still = {"velocity": (0.1, 0.1, 0.1)}
    ats = [100.0 + step / 10 for step in range(20)]
    assert {told(state, at, STANDS, **moving) for at in ats} == {None}
    assert told(state, 103.0, FLIES) == FLIES
    assert {told(state, at + 4.0, STANDS, **moving) for at in ats} == {FLIES}
    assert [told(state, at + 7.0, STANDS, **still) for at in ats][-1] == STANDS
    assert told(state, 109.1, STANDS, **moving) is None  # it stood, and nobody knows any more


def test_a_height_that_changes_contradicts_where_no_velocity_comes(state: AircraftState) -> None:
    def at_height(height: float) -> dict[str, tuple[float, ...]]:
        return {"position": (0.4, 2.0, 100.0, height, 5)}

    told(state, 100.0, LANDS)
    sinking = [told(state, 100.1 + n / 10, STANDS, **at_height(9.0 - n / 10)) for n in range(30)]
    assert set(sinking) == {LANDS}
    down = [told(state, 103.1 + n / 10, STANDS, **at_height(-20.0)) for n in range(10)]
    assert down[-1] == STANDS
    # A barometer drifts for as long as it stands.
    drifts = [told(state, 104.1 + n / 10, STANDS, **at_height(n / 10 - 20)) for n in range(30)]
    assert set(drifts) == {STANDS}


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("rate_hz", [1.0, 10.0, 50.0])
def test_the_noise_of_a_barometer_keeps_no_motors_running(
    state: AircraftState, rate_hz: float, seed: int
) -> None:
    """It stands by its velocity: a landing has ended, and the motors may be stopped, in time."""
    chance, still = random.Random(seed), (0.05, -0.05, 0.1)
    told(state, 100.0, LANDS)
    for number in range(max(3, round(0.6 * rate_hz))):
        place = (0.4, 2.0, 100.0, chance.gauss(0.0, 0.3), 5)
        at = 100.1 + number / rate_hz
        believed = told(state, at, STANDS, velocity=still, position=place)
    assert believed == STANDS, f"seed {seed}"


def test_a_silence_of_the_status_is_no_word_for_standing(state: AircraftState) -> None:
    told(state, 100.0, FLIES)
    assert [told(state, at, STANDS) for at in (101.0, 104.0, 107.0, 110.0)] == [FLIES] * 4
    assert [told(state, at, STANDS) for at in (111.0, 112.0)] == [FLIES, STANDS]
    assert told(state, 115.0, STANDS) is None


# -- which values: the tables of the library and of refusals ---------------------------------------


@pytest.mark.parametrize(
    ("name", "value", "seconds"),
    [("velocity", (1.0, 2.0, 3.0), 1.2), ("flight_status", (3,), 2.5), ("battery", (63,), 5.0)],
)
def test_a_value_is_known_for_the_time_of_its_item(
    state: AircraftState, clock: Clock, name: str, value: tuple[float, ...], seconds: float
) -> None:
    state.update(sample(100.0, **{name: value}))
    record = next(item.record for item in ITEMS if item.name == name)
    known = []
    for off in (seconds - 0.01, seconds + 0.01):
        for clock.now in (100.0 - off, 100.0 + off):
            known.append(state.fresh(record) is not None)
    assert known == [True, True, False, False]


@pytest.mark.parametrize(("status", "shown"), [(1, "STANDBY"), (3, "IN_AIR"), (99, 99)])
@pytest.mark.parametrize(("mode", "switch"), [(8000, "F"), (0, "A"), (-8000, "P")])
def test_a_refusal_names_what_was_known(
    state: AircraftState, status: int, shown: object, mode: int, switch: str
) -> None:
    state.update(
        sample(
            100.0,
            flight_status=(status,),
            position=(0.5, 0.25, 80.0, 12.346, 4),
            battery=(63,),
            rc=(1000, -2000, 3000, -4000, mode, -4545),
            control_device=(2,),
        )
    )
    assert state.situation() == {
        "flight_status": shown,
        "height_m": 12.35,
        "battery_percent": 63,
        "gps_health": 4,
        "mode_switch": switch,
        "control_device": "ONBOARD",
    }
    state.update(sample(100.1, rc=(0,) * 6, position=(0.5, 0.25, 80.0, -0.001, 4)))
    assert state.situation()["mode_switch"] is None, "it is off"
    assert str(state.situation()["height_m"]) == "0.0"
