"""The newest value of every item, its age, and how it arrives."""

from __future__ import annotations

import random
from itertools import pairwise

import pytest

from m100link.protocol import Attitude, Battery, Position, encode_telemetry, profile
from m100link.protocol.items import ITEMS
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


@pytest.mark.parametrize("hertz", [1.0, 5.0, 100.0])
def test_what_no_rate_is_made_of_any_more_is_forgotten(state: AircraftState, hertz: float) -> None:
    """A wall holds a thousand of these, and runs for months."""
    for number in range(3000):
        state.update(sample(100.0 + number / hertz, **ATTITUDE))
    [cell] = {one for one in state._cells.values() if one.count}
    assert len(cell.arrivals) <= 2.5 * hertz + 2
    assert state.statistics(Attitude).rate_hz == pytest.approx(hertz)
    assert state.statistics(Attitude).count == 3000
