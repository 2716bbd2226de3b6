"""Two flights beside each other, against what is known of both."""

from __future__ import annotations

import pytest

from m100link.log.picture import Comparison, compare
from m100link.log.story import FlightSummary, Moment, Span


def flown(*, waits_s: float, to_m: float, **values: float) -> FlightSummary:
    """Waits on the ground, takes off, flies so far north in 10 s, lands."""
    story = FlightSummary("flight.mcap", 0.0, waits_s + 20.0)
    story.phases = [
        Span("ground", 0.0, waits_s),
        Span("flight", waits_s, waits_s + 15.0),
        Span("ground", waits_s + 15.0, waits_s + 20.0),
    ]
    story.track.add(0.0, 0.0, 0.0)
    for step in range(101):
        story.track.add(waits_s + step / 10, to_m * step / 100, 0.0)
    for name, value in values.items():
        setattr(story.maxima, name, value)
    return story


def by(found: Comparison, name: str) -> float | None:
    return next(one.by for one in found.values if one.name == name)


def test_tracks_are_laid_over_each_other_at_take_off() -> None:
    found = compare(flown(waits_s=5.0, to_m=20.0), flown(waits_s=60.0, to_m=50.0))
    apart = dict(found.apart)
    assert apart[0.0] == pytest.approx(0.0, abs=0.5)
    assert apart[5.0] == pytest.approx(15.0, abs=0.6)
    assert found.most_apart is not None
    assert found.most_apart[1] == pytest.approx(30.0, abs=0.6)
    assert max(apart) == 15.0
    lands = flown(waits_s=60.0, to_m=50.0)
    lands.phases[1:] = [Span("flight", 60.0, 72.0), Span("ground", 72.0, 80.0)]
    longer = flown(waits_s=5.0, to_m=20.0)
    for found_also in (compare(lands, longer), compare(longer, lands)):
        assert max(found_also.apart).after_s == 12.0, "until the first of them stands"
    assert by(found, "duration_s") == 55.0
    assert by(found, "flight_s") == 0.0


def test_values_that_one_flight_does_not_have_have_no_difference() -> None:
    found = compare(flown(waits_s=1, to_m=1, height_m=5.0), FlightSummary("ground.mcap", 0.0, 3.0))
    assert by(found, "height_m") is None
    assert found.apart == []
    assert (found.mean_apart_m, found.most_apart) == (None, None)


def test_commands_and_alarms_differ_by_lines() -> None:
    first, second = flown(waits_s=1, to_m=1), flown(waits_s=1, to_m=1)
    land = Moment(9.0, "start_task", {"task": "land"}, "STARTED", 0.1)
    first.commands = [land]
    second.commands = [land._replace(at_s=12.0), land._replace(outcome=None)]
    second.alarms = [Span("gps", 3.0, 4.0, "GPS health 1")]
    found = compare(first, second)
    assert found.commands == ["+ start_task task=land: no answer"]
    assert found.alarms == ["+ gps"]
    assert compare(first, first).commands == []


def at_places(*places: tuple[float, float, float], ends: bool = True) -> FlightSummary:
    """Takes off at 2 s, is at these places (time, north, east), and lands at 12 s or never."""
    story = FlightSummary("flight.mcap", 0.0, 20.0)
    story.phases = [Span("ground", 0.0, 2.0), Span("take-off", 2.0, 5.0)]
    story.phases += [Span("flight", 5.0, 12.0)] + ([Span("ground", 12.0, 20.0)] if ends else [])
    for place in places:
        story.track.add(*place)
    return story


def test_how_far_apart_counts_north_and_east_each_with_its_sign() -> None:
    first = at_places((2.0, 0.0, 0.0), (4.0, 3.0, -2.0))
    second = at_places((2.0, 0.0, 0.0), (4.0, -1.0, 1.0))
    found = compare(first, second)
    assert [one.after_s for one in found.apart] == [step / 2 for step in range(21)]
    assert {one.metres for one in found.apart[:4]} == {0.0}
    assert {one.metres for one in found.apart[4:]} == {5.0}, "4 m north and 3 m east"
    assert found.mean_apart_m == pytest.approx(17 * 5.0 / 21)
    assert found.most_apart == (2.0, 5.0)
    flies_on = compare(first, at_places((2.0, 0.0, 0.0), ends=False))
    assert flies_on.apart[-1].after_s == 10.0, "until the first of them stands again"


def test_values_are_the_second_less_the_first_in_their_units() -> None:
    first, second = at_places((2.0, 0.0, 0.0)), at_places((2.0, 0.0, 0.0))
    first.packages, second.packages = 2000, 500
    first.discarded_bytes, second.discarded_bytes = 7, 3
    first.repeats, second.repeats = 1, 12
    for at, trip in ((1.0, 20.0), (2.0, 40.0)):
        first.curves.round_trip_ms.add(at, trip)
    second.curves.round_trip_ms.add(1.0, 75.0)
    second.phases[1] = Span("take-off", 2.0, 4.5)
    found = compare(first, second)
    assert by(found, "packages") == -1500
    assert by(found, "packages_per_s") == pytest.approx(-75.0)
    assert (by(found, "discarded_bytes"), by(found, "repeats")) == (-4, 11)
    assert by(found, "round_trip_ms") == pytest.approx(45.0)
    assert (by(found, "take-off_s"), by(found, "ground_s")) == (-0.5, 0.0)
    never = compare(FlightSummary("empty.mcap", 0.0, 0.0), second)
    assert (by(never, "packages_per_s"), by(never, "round_trip_ms")) == (None, None)
