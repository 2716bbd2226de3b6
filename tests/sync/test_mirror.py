"""Each member of a class with ``await`` has its namesake without, with the same arguments."""

from __future__ import annotations

import inspect
import sys
from typing import Any

import pytest

from m100link import aircraft, sync
from m100link.aircraft import payload
from m100link.flight import control, setpoints
from m100link.flight.missions import hotpoint, waypoint
from m100link.sync import aircraft as sync_aircraft
from m100link.sync import control as sync_control
from m100link.sync.portal import Reads
from m100link.telemetry import subscription
from tests import limits

LEFT_OUT = {
    "aclose",  # close() is the word here
    "note_from",  # the log asks in the event loop of the aircraft, ten times a second
    "push",  # for experts, who await
    "virtual_rc",  # its sticks are renewed twice a second by a program that awaits
    "send_raw_move_as_expert",  # for experts, who await
}

PAIRS: list[tuple[type[Any], type[Any]]] = [
    (sync.Aircraft, aircraft.Aircraft),
    (sync.Control, control.Control),
    (sync.Subscription, subscription.Subscription),
    (sync.Hold, setpoints.Hold),
    (sync_aircraft.AircraftGimbal, payload.AircraftGimbal),
    (sync_aircraft.AircraftCamera, payload.AircraftCamera),
    (sync_control.GimbalRates, payload.GimbalRates),
    (sync_control.WaypointFlight, waypoint.WaypointFlight),
    (sync_control.HotpointFlight, hotpoint.HotpointFlight),
    (sync_control.FollowFlight, hotpoint.FollowFlight),
]


@pytest.mark.parametrize(("here", "there"), PAIRS, ids=lambda one: one.__name__)
def test_nothing_is_missing_and_everything_takes_the_same_arguments(
    here: type[Any], there: type[Any]
) -> None:
    for name, member in inspect.getmembers(there):
        if name.startswith("_") or name in LEFT_OUT:
            continue
        assert hasattr(here, name), f"{here.__name__} has no {name}"
        if isinstance(member, property):
            assert isinstance(inspect.getattr_static(here, name), property), name
        elif callable(member):
            wanted = dict(inspect.signature(member).parameters)
            found = dict(inspect.signature(getattr(here, name)).parameters)
            also = {"timeout"} - wanted.keys()  # of iterating
            shown = {key: (one.kind, one.default) for key, one in found.items() if key not in also}
            assert shown == {key: (one.kind, one.default) for key, one in wanted.items()}, name


@pytest.mark.parametrize(("here", "there"), PAIRS, ids=lambda one: one.__name__)
def test_a_property_is_said_to_have_the_type_that_it_has(here: type[Any], there: type[Any]) -> None:
    for name, member in inspect.getmembers(here, lambda one: isinstance(one, Reads)):
        real = inspect.getattr_static(there, name).fget
        names = vars(sys.modules[real.__module__]) | vars(sys.modules[here.__module__])
        assert member.__orig_class__.__args__ == (eval(real.__annotations__["return"], names),), (
            name
        )


@pytest.mark.parametrize(
    ("method", "words", "other"),
    [
        (sync.connect, "with m100link.sync.connect(", "await"),
        (sync.connect, "print(aircraft.version())", "async with"),
        (sync.Control.obtain, "control = aircraft.control().obtain()", "await"),
        (sync_aircraft.AircraftGimbal.hold_angular_rates, "time.sleep(2)", "asyncio"),
        (sync.Control.take_off, "GuardRefused: Battery below its floor", "await"),
        (sync.Control.is_paused, "the pilot took the aircraft", "await"),
    ],
)
def test_help_shows_what_a_program_without_await_writes(
    method: object, words: str, other: str
) -> None:
    text = inspect.getdoc(method) or ""
    assert words in text
    assert other not in text
    assert not inspect.iscoroutinefunction(method)


def test_each_limit_is_as_agreed() -> None:
    assert limits.differences("sync") == []
