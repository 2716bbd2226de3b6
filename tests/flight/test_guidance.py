"""When a closed loop has settled, when nothing moves by its setpoints, and where it steers from.

Settled: half a second within tolerance, at less than 0.3 m/s either way. Nothing moves: for six
seconds less than half a metre, 0.3 m of height and 3°, while more than that is asked for.
"""

from __future__ import annotations

import asyncio
import math
from typing import Any, cast

import pytest

from m100link.errors import TelemetryStalled, UsageError
from m100link.flight import guidance
from m100link.flight.guidance import (
    Guidance,
    GuidanceProgress,
    _has_moved,
    _Settling,
    _Stillness,
    heading_of,
    position_of,
)
from m100link.protocol.records import Attitude, Position, Velocity, quaternion
from m100link.protocol.setpoint import Setpoint
from m100link.sim import VirtualClockEventLoop

METRE = 1.0 / 6_378_137.0


def flown(north: float = 0.0, east: float = 0.0) -> Setpoint:
    return Setpoint.velocity(north=north, east=east, up=0.0, yaw_rate_deg_s=0.0)


FAST, HOVER = flown(east=-5.0), flown()
OFFSET = Setpoint.position_offset(north=3, east=0, up=0, yaw_rate_deg_s=0)


def at(north: float = 0.0, east: float = 0.0, height: float = 10.0) -> Position:
    """Metres from a place at 60° north, where a degree of longitude is half as long."""
    latitude = math.radians(60.0)
    return Position(latitude + north * METRE, 1.0 + 2.0 * east * METRE, 99.0, height, 5)


def turned(degrees: float) -> Attitude:
    return Attitude(*quaternion(0.0, 0.0, math.radians(degrees)))


class State:
    """The newest record of each class, and how old all are."""

    def __init__(self, *records: Any, age: float = 0.0) -> None:
        self.records = {type(one): one for one in records}
        self.old = age

    def fresh(self, kind: type[Any], *, within: float | None = None) -> Any:
        return self.records.get(kind) if self.old <= (within or 1.0) else None

    def get(self, kind: type[Any]) -> Any:
        return self.records.get(kind)

    def age(self, kind: type[Any]) -> float | None:
        return self.old if kind in self.records else None


@pytest.mark.parametrize(
    ("after", "has_moved"),
    [
        ((at(), turned(170.0)), False),
        ((at(north=0.49), turned(170.0)), False),
        ((at(north=-0.51), turned(170.0)), True),
        ((at(east=0.49), turned(170.0)), False),
        ((at(east=0.51), turned(170.0)), True),
        ((at(north=0.4, east=-0.4), turned(170.0)), True),
        ((at(height=10.29), turned(170.0)), False),
        ((at(height=9.69), turned(170.0)), True),
        ((at(), turned(172.9)), False),
        ((at(), turned(166.9)), True),
        ((at(), turned(-177.5)), True),  # 12.5 degrees to the right, past south
        ((at(), None), False),
        ((None, turned(170.0)), False),
        ((None, None), True),  # nobody knows
    ],
)
def test_what_sensors_wander_is_no_movement(
    after: tuple[Position | None, Attitude | None], has_moved: bool
) -> None:
    assert _has_moved((at(), turned(170.0)), after) is has_moved


def missing(distance: float = 0.0, height: float = 0.0, heading: float = 0.0) -> GuidanceProgress:
    return GuidanceProgress(0.0, distance, height, heading)


@pytest.mark.parametrize(
    ("setpoint", "found", "slack", "after_s"),
    [
        (HOVER, missing(distance=1.0), 0.0, 6.0),
        (HOVER, missing(distance=0.99), 0.0, None),
        (HOVER, missing(height=-0.5), 0.0, 6.0),
        (HOVER, missing(height=0.49), 0.0, None),
        (HOVER, missing(heading=-6.0), 0.0, 6.0),
        (HOVER, missing(heading=5.9), 0.0, None),
        (HOVER, missing(distance=9.0), 2.5, 8.5),  # a slow line adds to it
        (FAST, missing(distance=9.0), 0.0, 6.0),
        # At 0.125 m/s a metre takes eight seconds, whichever way.
        (flown(north=0.125), missing(distance=9.0), 0.0, 8.0),
        (flown(east=-0.125), missing(distance=9.0), 0.0, 8.0),
        (OFFSET, missing(distance=9.0), 0.0, 6.0),
    ],
)
def test_nothing_moves_for_six_seconds_or_as_long_as_a_metre_takes(
    setpoint: Setpoint, found: GuidanceProgress, slack: float, after_s: float | None
) -> None:
    stillness = _Stillness(cast(Any, State(at(), turned(0.0))))
    over = [
        step / 8
        for step in range(100)
        if stillness.is_too_long(50.0 + step / 8, slack, setpoint, found)
    ]
    assert over[:1] == ([] if after_s is None else [after_s])


@pytest.mark.parametrize("pose", [(), (at(),), (turned(9.0),), (at(), turned(9.0))])
def test_the_first_look_begins_the_time_whatever_the_clock_says(pose: tuple[Any, ...]) -> None:
    """A loop that begins an hour after its computer has six seconds for its first metre."""
    stillness = _Stillness(cast(Any, State(*pose)))
    assert not stillness.is_too_long(3600.0, 0.0, FAST, missing(distance=9.0))
    assert not stillness.is_too_long(3605.9, 0.0, FAST, missing(distance=9.0))
    assert stillness.is_too_long(3606.0, 0.0, FAST, missing(distance=9.0)) is bool(pose)


def test_movement_and_arrival_begin_the_time_anew() -> None:
    state = State(at(), turned(0.0))
    stillness, far = _Stillness(cast(Any, state)), missing(distance=9.0)
    assert not stillness.is_too_long(0.0, 0.0, HOVER, far)
    assert not stillness.is_too_long(5.9, 0.0, HOVER, far)
    state.records[Position] = at(east=0.6)
    assert not stillness.is_too_long(6.0, 0.0, HOVER, far)
    assert not stillness.is_too_long(11.9, 0.0, HOVER, far)
    assert stillness.is_too_long(12.0, 0.0, HOVER, far)
    assert not stillness.is_too_long(12.1, 0.0, HOVER, missing(distance=0.5))
    assert not stillness.is_too_long(18.0, 0.0, HOVER, far)
    assert stillness.is_too_long(18.1, 0.0, HOVER, far)


@pytest.mark.parametrize(
    ("velocity", "settles"),
    [
        (None, True),  # the item may be switched off
        ((0.2, 0.2, 0.29), True),
        ((0.0, 0.0, -0.29), True),
        ((0.2, -0.25, 0.0), False),
        ((0.0, 0.0, -0.31), False),
        ((0.0, 0.0, 0.31), False),
        ((-0.31, 0.0, 0.0), False),
    ],
)
def test_it_has_settled_after_half_a_second_of_less_than_0_3_m_s(
    velocity: tuple[float, float, float] | None, settles: bool
) -> None:
    records = [] if velocity is None else [Velocity(*velocity, 1)]

    async def run() -> list[bool]:
        settling = _Settling(cast(Any, State(*records)))
        told = []
        for is_within in (True, True, False, True, True, True, True):
            told.append(settling.update(is_within))
            await asyncio.sleep(0.25)
        return told

    with asyncio.Runner(loop_factory=VirtualClockEventLoop) as runner:
        told = runner.run(run())
    assert told == [False, False, False, False, False, settles, settles]


@pytest.mark.parametrize(
    ("records", "age", "why"),
    [
        ([at(), turned(33.0)], 0.5, ""),
        ([at(), turned(33.0)], 0.6, "is 0.6 s old"),
        ([], 0.0, "was never received"),
        ([Position(math.nan, 0.0, 0.0, 0.0, 5)], 0.0, "is impossible"),
    ],
)
def test_where_it_is_has_to_be_known_since_half_a_second(
    records: list[Any], age: float, why: str
) -> None:
    state = cast(Any, State(*records, age=age))
    if not why:
        assert position_of(state) == at()
        assert heading_of(state) == pytest.approx(33.0)
        return
    with pytest.raises(TelemetryStalled, match=why):
        position_of(state)
    with pytest.raises(TelemetryStalled, match="heading"):
        heading_of(state)


@pytest.mark.anyio
@pytest.mark.parametrize(
    ("change", "why"),
    [
        ({"flying": "orbit"}, "another closed loop is flying: orbit"),
        ({"stands": True}, "it stands"),
        ({"old": 0.0}, ""),
        ({}, ""),  # no newer place in half a second: the loop says so
    ],
)
async def test_what_changes_while_a_loop_waits_for_its_place_refuses_it(
    change: dict[str, Any], why: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    def require_in_the_air(state: Any, name: str) -> None:
        if getattr(state, "stands", False):
            raise UsageError(f"{name}: it stands")

    async def hover() -> None:
        """Nobody asks for it."""

    monkeypatch.setattr(guidance, "require_in_the_air", require_in_the_air)
    clock = asyncio.get_running_loop().time
    state: Any = State(at(), age=0.6)
    flown_by = Guidance(state, steer=lambda _: None, hover=hover)
    begun_at, waiting = clock(), asyncio.create_task(flown_by.prepare("fly_to"))
    await asyncio.sleep(0.1)
    assert not waiting.done()
    for name, value in change.items():
        setattr(flown_by if name == "flying" else state, name, value)
    if "old" not in change:
        await asyncio.sleep(0.2)
        assert not waiting.done()
    if why:
        with pytest.raises(UsageError, match=why):
            await waiting
    else:
        await waiting
    assert clock() - begun_at == pytest.approx(0.1 if "old" in change else 0.5, abs=0.05)
