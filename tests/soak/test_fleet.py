"""The short form of a large fleet; `nox -s thousand` is the long one."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from importlib.metadata import version
from typing import Any

import pytest

from tests.soak.fleet import Measured, measure
from tests.soak.run import Level

GOOD = Measured(
    seconds=10.0,
    told=2,
    flying=0,
    sent=Counter({"5hz": 100, "tel": 500, "state": 20}),
    heard=Counter({"5hz": 100, "tel": 500, "state": 21}),
    slowest=5.0,
    agents_us=10.0,
    router_us=10.0,
    watcher_us=9.0,
    bare_us=(14.0, 16.0),
    alone_s=0.1,
    flying_s=0.0,
    levels={"router": [Level(0, 50_000, 0, 9)] * 6},
    load=1.0,
)


@pytest.mark.pty
def test_a_dozen_aircraft_are_heard_and_counted() -> None:
    pytest.importorskip("zenoh", reason="the extra fleet is not installed")
    told: list[str] = []
    measured = measure(11, 1, 3.0, told.append, alone_s=1.0, bare_s=1.0)
    text = "\n".join((*told, measured.text))
    assert measured.received == 1.0, text
    assert set(measured.sent) == {"5hz", "tel", "state"}, text
    assert measured.heard["tel"] == measured.sent["tel"] > 20, text
    assert set(measured.levels) == {"router", "told 0", "told 1", "flying", "watcher"}
    assert measured.router_us >= 0 < measured.watcher_us, text
    assert min(measured.bare_us) > 0, text
    assert f"zenoh {version('eclipse-zenoh')}, Python 3." in text


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"heard": Counter({"5hz": 99, "tel": 500, "state": 30})}, "received"),
        ({"router_us": 12.0}, "µs for a message"),
        ({"slowest": 4.8}, "packages/s"),
        ({"sent": Counter({"5hz": 100, "tel": 400, "state": 20})}, "the one looked at"),
        ({"levels": {"router": [Level(0, 9_000 * n, 0, 9) for n in range(6)]}}, "router: memory"),
    ],
)
def test_what_is_not_as_it_is_to_be_is_reported(change: dict[str, Any], told: str) -> None:
    assert GOOD.faults() == []
    [fault] = replace(GOOD, **change).faults()
    assert told in fault
