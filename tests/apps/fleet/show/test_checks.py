"""What is wrong with a show: every rule by a show that breaks this one."""

from __future__ import annotations

import math

import pytest

from m100link.apps.fleet.show.plan.document import SKEW_S, Show, check, distances, needed_m
from m100link.flight.guards import Envelope
from tests.apps.fleet.show.shows import FIVE, show_of, track

HERE = track("a1", (0, 0, 0, 5), (20, 20, 0, 5))


def said(show: Show, envelope: Envelope | None = None) -> list[str]:
    report = check(show, envelope)
    assert report.ok == (not report.problems)
    return [problem.seen for problem in report.problems]


def test_the_example_may_be_flown() -> None:
    report = check(Show.read(FIVE))
    assert report.ok
    assert report.remarks == ()
    assert report.closest is not None
    assert {report.closest.first, report.closest.second} <= {"a1", "a2", "a3", "a4", "a5"}
    assert report.closest.distance_m == pytest.approx(10.0, abs=2e-3)
    assert report.closest.needed_m < 7


def test_one_alone_comes_near_to_nobody() -> None:
    assert check(show_of(HERE)).closest is None
    assert distances(show_of(HERE)) == []


@pytest.mark.parametrize(
    ("points", "words"),
    [
        ([(0, 0, 0, 5), (60, 0, 0, 60)], "a height of 60.0 m was refused"),
        ([(0, 0, 0, 5), (200, 160, 0, 5)], "160 m from the start was refused"),
        ([(0, 0, 0, 5), (20, 20, 0, 0.5)], "flies 0.5 m above its take-off point"),
        ([(0, 0, 0, 5), (15, 90, 0, 5)], "flies 9.0 m/s between 0 and 15 s"),
        ([(0, 0, 0, 5), (10, 0, 0, 25)], "climbs or descends at 3.0 m/s between 0 and 10 s"),
        ([(0, 0, 0, 5), (2, 3, 0, 5)], "accelerates by 4.5 m/s² between 0 and 2 s"),
    ],
)
def test_limits_of_one_aircraft(
    points: list[tuple[float, float, float, float]], words: str
) -> None:
    assert words in "\n".join(said(show_of(track("a1", *points))))


def test_what_is_advised_is_enough() -> None:
    """A leg that gets the time which the message names passes."""
    for points, field in (
        ([(0.0, 0.0, 0.0, 5.0), (15.0, 90.0, 0.0, 5.0)], "flies"),
        ([(0.0, 0.0, 0.0, 5.0), (2.0, 3.0, 0.0, 5.0)], "accelerates"),
    ):
        [problem] = [p for p in check(show_of(track("a1", *points))).problems if field in p.seen]
        seconds = float(problem.remedy.removeprefix("give it ").split(" s")[0])
        slower = [points[0], (seconds + 0.1, *points[1][1:])]
        assert not [one for one in said(show_of(track("a1", *slower))) if field in one]


def test_heights_are_those_above_its_own_take_off_point() -> None:
    points = (0, 0, 0, 5), (60, 0, 0, 45)
    assert said(show_of(track("a1", *points))) == []
    assert "a height of 55.0 m" in said(show_of(track("a1", *points, ground_m=-10)))[0]
    assert "-5.0 m above its take-off" in said(show_of(track("a1", *points, ground_m=10)))[0]


def test_the_envelope_may_be_another_one() -> None:
    far = show_of(track("a1", (0, 0, 0, 5), (100, 160, 0, 5)))
    assert len(said(far)) == 1
    assert said(far, Envelope(max_radius_m=200)) == []
    assert "1.6 m/s may be flown" in said(far, Envelope(max_radius_m=200, max_speed_m_s=2))[0]


# -- together -------------------------------------------------------------------------------------


def test_take_off_spots_and_ends_are_far_enough_apart() -> None:
    over = track("a2", (0, 0, 5, 20), (20, 40, 5, 20))
    assert (
        "a1 and a2 take off 5.0 m from each other, seen from above; 6.0 m"
        in said(show_of(HERE, over))[0]
    )
    ending = track("a2", (0, 60, 0, 20), (60, 25, 0, 20))
    assert "a1 and a2 end 5.0 m from each other" in said(show_of(HERE, ending))[0]


def test_two_that_come_too_near_are_named_with_the_time_and_the_distance() -> None:
    first = track("a1", (0, 0, 0, 5), (20, 30, 0, 5))
    second = track("a2", (0, 30, 3, 5), (20, 0, 3, 5))
    [problem] = check(show_of(first, second)).problems
    assert "a1 and a2 come as near as 3.0 m at 10.00 s; 6.2 m are needed" in problem.seen
    assert problem.aircraft == ("a1", "a2")
    assert problem.at == pytest.approx(10.0, abs=0.1)
    assert problem.measured == pytest.approx(3.0, abs=2e-3)
    assert check(show_of(first, track("a2", (0, 30, 7, 5), (20, 0, 7, 5)))).ok


def test_what_two_need_is_their_tubes_and_what_clocks_are_wrong_by() -> None:
    first = track("a1", (0, 0, 0, 5), (20, 40, 0, 5), tube_m=2.0)  # 3 m/s in the middle
    second = track("a2", (0, 0, 9, 5), (20, 0, 9, 15), tube_m=1.0)  # 0.75 m/s
    expected = 4.0 + 2.0 + 1.0 + SKEW_S * (3.0 + 0.75)
    assert needed_m(show_of(first, second, least=4.0), first, second) == pytest.approx(
        expected, abs=0.01
    )


def test_who_is_above_whom_is_remarked() -> None:
    lower = track("a1", (0, 0, 0, 5), (20, 30, 0, 5))
    upper = track("a2", (0, 30, 0, 20), (20, 0, 0, 20))
    report = check(show_of(lower, upper))
    assert report.ok
    [remark] = report.remarks
    assert remark.startswith("a2 is above a1 at ")
    assert remark.endswith("if it has to land there, it comes down on it")


def test_the_curve_of_distances_never_goes_below_the_nearest() -> None:
    show = Show.read(FIVE)
    nearest = check(show).closest
    assert nearest is not None
    found = distances(show)
    assert (found[0][0], found[-1][0]) == (0, 36)
    assert min(distance for _, distance in found) >= nearest.distance_m - 1e-3
    assert all(math.isfinite(distance) for _, distance in found)
