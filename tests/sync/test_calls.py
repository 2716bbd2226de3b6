"""Each call without ``await`` reaches its namesake with ``await``, with what it was given."""

from __future__ import annotations

import asyncio
import inspect
from types import SimpleNamespace
from typing import Any

import pytest

from m100link import aircraft as aio
from m100link import sync
from m100link.aircraft import payload
from m100link.flight import control, pacing, setpoints
from m100link.flight.missions import hotpoint, waypoint
from m100link.sync import aircraft
from m100link.sync import control as sync_control
from m100link.telemetry import subscription

PAIRS: list[tuple[type[Any], type[Any]]] = [
    (sync.Aircraft, aio.Aircraft),
    (sync.Control, control.Control),
    (aircraft.AircraftGimbal, payload.AircraftGimbal),
    (aircraft.AircraftCamera, payload.AircraftCamera),
    (sync_control.Subscription, subscription.Subscription),
    (sync_control.Ticks, pacing.Ticker),
    (sync_control.Hold, setpoints.Hold),
    (sync_control.GimbalRates, payload.GimbalRates),
    (sync_control.WaypointFlight, waypoint.WaypointFlight),
    (sync_control.HotpointFlight, hotpoint.HotpointFlight),
    (sync_control.FollowFlight, hotpoint.FollowFlight),
]
"""Each class here, and the one with ``await``."""

ELSEWHERE = ("interrupt", "obtain", "release", "get")
"""Methods that do more than to hand on; they have tests of their own."""


class _Noted:
    """Takes every call and notes how it was made; each attribute is a number of its own."""

    def __init__(self) -> None:
        self.calls: list[tuple[str, tuple[Any, ...], dict[str, Any]]] = []

    def __getattr__(self, name: str) -> Any:
        return lambda *args, **kwargs: self.calls.append((name, args, kwargs))


class _Read:
    """Gives a number for each attribute, and notes which was asked for."""

    def __init__(self) -> None:
        self.asked: list[str] = []

    def __getattr__(self, name: str) -> float:
        self.asked.append(name)
        return 7.0


def _made(kind: type[Any], inner: object) -> Any:
    made: Any = object.__new__(kind)

    def call(function: Any, *args: Any, **kwargs: Any) -> Any:
        return function(*args, **kwargs)

    here = SimpleNamespace(begin=call)
    made._portal = SimpleNamespace(call=call, wait=lambda make: make(here), is_open=True)
    holder = "_entered" if issubclass(kind, sync_control._Block) else "_aio"
    setattr(made, holder, inner)
    return made


def _public(kind: type[Any], *, is_property: bool) -> list[str]:
    return [
        name
        for name, one in inspect.getmembers(kind)
        if not name.startswith("_") and isinstance(one, property) is is_property
    ]


def _given(method: Any) -> tuple[dict[str, Any], list[Any], dict[str, Any]]:
    """An object of its own for each argument: by its name, and as it is passed."""
    bound: dict[str, Any] = {}
    args: list[Any] = []
    kwargs: dict[str, Any] = {}
    for name, one in inspect.signature(method).parameters.items():
        if one.kind is one.VAR_POSITIONAL:
            bound[name] = (object(), object())
            args += bound[name]
        elif one.kind is one.VAR_KEYWORD:
            bound[name] = {"attitude": object(), "battery": object()}
            kwargs |= bound[name]
        elif one.kind is one.KEYWORD_ONLY:
            bound[name] = kwargs[name] = object()
        else:
            bound[name] = object()
            args.append(bound[name])
    return bound, args, kwargs


@pytest.mark.parametrize(("kind", "real"), PAIRS, ids=lambda one: one.__name__)
def test_each_argument_goes_where_it_was_given(kind: type[Any], real: type[Any]) -> None:
    for name in _public(kind, is_property=False):
        if name in ELSEWHERE:
            continue
        inner = _Noted()
        method = getattr(_made(kind, inner), name)
        given, args, kwargs = _given(method)
        returned = method(*args, **kwargs)
        if isinstance(returned, sync_control._Block):  # it is asked for when it is entered
            caller: Any = SimpleNamespace(begin=lambda one, *a, **k: one(*a, **k))
            returned._make(caller)
        if isinstance(returned, sync_control.Subscription):
            assert returned.timeout is given.pop("timeout"), name
        if name == "follow":
            assert inner.calls.pop(0) == ("ticks", (given["rate_hz"],), {})
            [(_, (source,), _)] = inner.calls
            assert source.ag_frame.f_locals["source"] is given.pop("source")
            given["source"] = source
        [(called, taken, named)] = inner.calls
        found = inspect.signature(getattr(real, called)).bind(None, *taken, **named).arguments
        assert called == name
        assert {key: value for key, value in found.items() if key != "self"} == given, name


@pytest.mark.parametrize(("kind", "real"), PAIRS, ids=lambda one: one.__name__)
def test_each_property_is_that_of_the_one_with_await(kind: type[Any], real: type[Any]) -> None:
    del real  # mypy knows that it has them
    for name in _public(kind, is_property=True):
        inner = _Read()
        assert getattr(_made(kind, inner), name) in (7, True), name
        assert inner.asked == [name]


@pytest.mark.parametrize("handle_signals", [True, False])
def test_a_control_block_handles_signals_as_it_was_told(handle_signals: bool) -> None:
    inner = _Noted()
    made = _made(sync.Aircraft, inner).control(handle_signals=handle_signals, stop="land")
    assert made._handles_signals is handle_signals
    assert inner.calls == [("control", (), {"handle_signals": handle_signals, "stop": "land"})]


@pytest.mark.parametrize(("kind", "real"), PAIRS[6:], ids=lambda one: one.__name__)
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


@pytest.mark.parametrize("seconds", [None, 0.25])
def test_iterating_waits_as_long_as_the_subscription_was_told(seconds: float | None) -> None:
    """:meth:`get` waits as long as its own argument says."""
    waited: list[float | None] = []

    class Told(sync_control.Subscription[int]):
        def get(self, timeout: float | None = None) -> int:
            waited.append(timeout)
            return len(waited)

    made = _made(Told, None)
    made.timeout = seconds
    assert (next(made), made.get(3.0)) == (1, 2)
    assert waited == [seconds, 3.0]
