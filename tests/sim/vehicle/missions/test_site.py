from __future__ import annotations

import pytest

from m100link.sim.vehicle.missions.route import LocalPlace, MissionSettings, NoFlyZone, Site
from tests.sim.vehicle.missions.flights import SITE, radians_at


def site(**settings: object) -> Site:
    return Site(22.5431, 113.9589, 120.0, MissionSettings(**settings))  # type: ignore[arg-type] # by name


def test_a_place_is_in_metres_from_the_origin() -> None:
    assert site().place(*radians_at(30.0, -40.0), 12.0) == pytest.approx(LocalPlace(30, -40, 12))


def test_limits_as_set_and_those_of_an_app_without_a_login() -> None:
    assert (site().height_limit, site().radius_limit) == (120.0, 500.0)
    assert site(radius_limit=300.0).radius_limit == 300.0
    strict = site(never_logged_in=True, radius_limit=300.0)
    assert (strict.height_limit, strict.radius_limit) == (30.0, 50.0)
    assert strict.is_within_radius(LocalPlace(30, 40, 10), None)
    assert not strict.is_within_radius(LocalPlace(31, 40, 10), (0.0, 0.0))
    assert strict.is_within_radius(LocalPlace(31, 40, 10), (1.0, 0.0))
    assert strict.is_within_radius(LocalPlace(30, 41, 10), (0.0, 1.0))


def test_a_zone_forbids_places_and_ways_through_it() -> None:
    latitude, longitude = SITE.to_geodetic(100.0, 0.0)
    closed = site(no_fly_zones=(NoFlyZone(latitude, longitude, 20.0),))
    for start, end, is_forbidden in (
        (LocalPlace(0, 0, 5), LocalPlace(0, 0, 5), False),
        (LocalPlace(90, 0, 5), LocalPlace(90, 0, 5), True),
        (LocalPlace(0, 0, 5), LocalPlace(200, 0, 5), True),
        (LocalPlace(0, 0, 5), LocalPlace(79, 0, 5), False),
        (LocalPlace(0, 30, 5), LocalPlace(200, 30, 5), False),
        (LocalPlace(0, 15, 5), LocalPlace(200, 15, 5), True),
    ):
        assert closed.is_forbidden(start, end) is is_forbidden
        assert not site().is_forbidden(start, end)
    aside = site(no_fly_zones=(NoFlyZone(*SITE.to_geodetic(100.0, 60.0), 20.0),))
    # 4.5 m from its centre, and 22.4 m beside it.
    assert aside.is_forbidden(LocalPlace(160, 85, 5), LocalPlace(60, 35, 5))
    assert not aside.is_forbidden(LocalPlace(160, 65, 5), LocalPlace(60, 15, 5))
