"""The simulated fleet: against arithmetic in small sizes, and against itself."""

from __future__ import annotations

import pytest

from benchmarks.growth import COSTS, Fleet, line, main


def test_shares_are_what_arithmetic_says() -> None:
    """200 aircraft at one site, half of them at each router, with one state in five seconds."""
    found = Fleet(200, seconds=12.0).run()
    assert (found.aircraft, found.sites, found.answered) == (200, 1, 200)
    assert found.router == pytest.approx(100 * (5 + 0.2) * COSTS.route, rel=0.07)
    assert found.wall == pytest.approx(200 * (5 + 0.2) * COSTS.take, rel=0.07)
    assert found.left_router == pytest.approx(2 * found.router, rel=0.15)


def test_what_nobody_delays_is_as_old_as_its_way() -> None:
    found = Fleet(10, seconds=12.0).run()
    way = COSTS.publish + COSTS.hop + COSTS.route + COSTS.hop + COSTS.take
    assert found.median_s == pytest.approx(way, rel=0.01)
    assert found.worst_s < way + 10 * COSTS.route


def test_to_stop_all_takes_the_messages_that_one_has_to_send() -> None:
    """One process sends them one after the other, and nothing waits for an answer."""
    for count in (50, 400):
        found = Fleet(count, seconds=6.0).run()
        assert found.answered == count
        least = count * COSTS.publish + 2 * COSTS.hop
        assert least < found.reached_s < least + count * COSTS.route + 1e-3
        assert found.reached_s < found.known_s


def test_a_region_is_on_the_way_where_there_are_several_sites() -> None:
    alone, several = Fleet(60, seconds=6.0).run(), Fleet(60, seconds=6.0, site=20).run()
    assert (alone.sites, several.sites) == (1, 3)
    assert several.reached_s == pytest.approx(alone.reached_s + COSTS.far, abs=1e-3)
    assert several.known_s == pytest.approx(alone.known_s + 2 * COSTS.far, abs=2e-3)
    assert several.median_s == pytest.approx(alone.median_s, rel=0.02), "a wall is at its site"
    assert several.answered == 60


def test_a_client_that_lost_a_router_is_silent_until_it_was_noticed_and_no_longer() -> None:
    found = Fleet(40, seconds=12.0).run()
    longest = COSTS.lost_after + COSTS.spread + 40 * COSTS.join + 2 * 0.2
    assert COSTS.lost_after < found.silent_s < longest


def test_a_wall_that_has_more_than_it_can_take_falls_behind() -> None:
    """2000 aircraft at 50 Hz ask for 1.08 cores: what is shown gets older all the time."""
    busy = Fleet(2000, seconds=1.5, hz=50, site=2000).run()
    assert busy.worst_s > 20 * Fleet(500, seconds=1.5, hz=50).run().worst_s


def test_the_same_seed_is_the_same_fleet() -> None:
    # As they are written: what was not measured is nan, which equals nothing, itself neither.
    first, again, other = (repr(Fleet(50, seconds=3.0, seed=seed).run()) for seed in (1, 1, 2))
    assert first == again
    assert first != other


def test_the_program_prints_a_row_for_each_size(capsys: pytest.CaptureFixture[str]) -> None:
    main(["--aircraft", "5", "20", "--seconds", "3", "--seed", "7"])
    told, head, *rows = capsys.readouterr().out.splitlines()
    assert told.endswith("seed 7")
    assert head.split()[0] == "aircraft"
    assert rows == [line(Fleet(count, seconds=3.0, seed=7).run()) for count in (5, 20)]
