"""A mission without ``await``: the same events, the same stop; and each call as it was made."""

from __future__ import annotations

import asyncio
import inspect
import time
from types import SimpleNamespace
from typing import Any

import pytest

import m100link
from m100link import Finished, MissionProgress, MissionRunning, Reached, Uploading
from m100link.aircraft import payload
from m100link.flight import setpoints
from m100link.flight.missions import hotpoint, waypoint
from m100link.sync import steering
from tests.flight.foreign_aircraft import APP_ID, KEY, ForeignAircraft, foreign_aircraft
from tests.flight.missions.foreign import plan
from tests.rig import NORTH
from tests.waiting import PATIENCE

pty = pytest.mark.pty

SHORT = plan([(3.0, 0.0), (6.0, 0.0)], speed=10.0)


def connect(there: ForeignAircraft) -> m100link.sync.Aircraft:
    aircraft = m100link.sync.connect(there.name)
    aircraft.activate(m100link.Credentials(app_id=APP_ID, key=KEY))
    aircraft.wait_for(lambda state: state.flight_status is not None, timeout=PATIENCE)
    return aircraft


@pty
@pytest.mark.smoke
def test_it_is_flown_in_a_with_block_and_reported_in_a_loop() -> None:
    with foreign_aircraft("3.1") as there, connect(there) as aircraft:
        uploading: list[Uploading] = []
        with aircraft.control() as control:
            with control.waypoint_mission(SHORT, progress=uploading.append) as mission:
                events = [e for e in mission if not isinstance(e, MissionProgress)]
        assert [event.index for event in events if isinstance(event, Reached)] == [0, 1]
        assert events[-1] == Finished()
        assert len(uploading) == 2
        assert mission.is_over


@pty
def test_an_exception_in_the_block_stops_it_and_setpoints_are_refused_before() -> None:
    with foreign_aircraft("3.1") as there, connect(there) as aircraft:
        with pytest.raises(ZeroDivisionError), aircraft.control() as control:
            with control.waypoint_mission(plan(speed=1.0)) as mission:
                assert mission.plan == plan(speed=1.0)
                with pytest.raises(MissionRunning):
                    control.send(NORTH)
                mission.pause()
                assert mission.is_paused
                mission.resume()
                assert mission.set_speed(2.0) == 2.0
                raise ZeroDivisionError
        assert not there.missions.flying


@pty
def test_one_that_is_detached_flies_on() -> None:
    with foreign_aircraft("3.1") as there, connect(there) as aircraft:
        with aircraft.control() as control, control.waypoint_mission(plan(speed=1.0)) as mission:
            mission.detach()
        time.sleep(0.2)
        assert there.missions.flying
        with aircraft.control() as control:
            assert control.stop_mission() is m100link.MissionKind.WAYPOINT


# -- what is passed on -----------------------------------------------------------------------------

PAIRS: list[tuple[type[Any], type[Any]]] = [
    (steering.Hold, setpoints.Hold),
    (steering.GimbalRates, payload.GimbalRates),
    (steering.WaypointFlight, waypoint.WaypointFlight),
    (steering.HotpointFlight, hotpoint.HotpointFlight),
    (steering.FollowFlight, hotpoint.FollowFlight),
]
"""Each class here, and the one with ``await``."""


class _Noted:
    """Takes every call, and notes how it was made."""

    def __init__(self) -> None:
        self.calls: list[tuple[str, tuple[Any, ...], dict[str, Any]]] = []

    def __getattr__(self, name: str) -> Any:
        return lambda *args, **kwargs: self.calls.append((name, args, kwargs))


def _made(kind: type[Any], inner: object) -> Any:
    made: Any = object.__new__(kind)

    def call(function: Any, *args: Any, **kwargs: Any) -> Any:
        return function(*args, **kwargs)

    made._portal = SimpleNamespace(call=call, wait=lambda make: make(SimpleNamespace(begin=call)))
    made._entered = inner
    return made


def _public(kind: type[Any], *, is_property: bool) -> list[str]:
    return [
        name
        for name, one in inspect.getmembers(kind)
        if not name.startswith("_") and isinstance(one, property) is is_property
    ]


@pytest.mark.parametrize(("kind", "real"), PAIRS, ids=lambda one: one.__name__)
def test_each_argument_goes_where_it_was_given(kind: type[Any], real: type[Any]) -> None:
    for name in _public(kind, is_property=False):
        inner = _Noted()
        method = getattr(_made(kind, inner), name)
        given = {parameter: object() for parameter in inspect.signature(method).parameters}
        method(**given)
        [(called, args, kwargs)] = inner.calls
        taken = inspect.signature(getattr(real, called)).bind(None, *args, **kwargs).arguments
        assert called == name
        assert {key: value for key, value in taken.items() if key != "self"} == given, name


@pytest.mark.parametrize(("kind", "real"), PAIRS, ids=lambda one: one.__name__)
def test_each_property_is_that_of_the_one_with_await(kind: type[Any], real: type[Any]) -> None:
    del real  # mypy knows that it has them
    names = _public(kind, is_property=True)
    inner = SimpleNamespace(**{name: object() for name in names})
    made = _made(kind, inner)
    for name in names:
        assert getattr(made, name) is getattr(inner, name), name


@pytest.mark.parametrize(("kind", "real"), PAIRS, ids=lambda one: one.__name__)
def test_how_a_block_ends_is_passed_on(kind: type[Any], real: type[Any]) -> None:
    """A mission whose program failed is stopped, and one that was left is not."""
    del real
    ends: list[tuple[Any, ...]] = []

    class Holding:
        async def __aexit__(self, *end: Any) -> None:
            ends.append(end)

    failed = KeyError()
    for end in ((KeyError, failed, None), (None, None, None)):
        made = _made(kind, None)
        made._holding = Holding()
        made._portal.wait = lambda make: asyncio.run(make(None))
        made.__exit__(*end)
    assert ends == [(KeyError, failed, None), (None, None, None)]
