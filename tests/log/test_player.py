"""A player stands still, goes on, and changes its speed; its clock never jumps."""

from __future__ import annotations

import asyncio
import json
import math
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from m100link.errors import UsageError
from m100link.link import Direction
from m100link.log import read
from m100link.log.damage import Damage
from m100link.log.player import RUN_UP_S, Begin, PlaybackTarget, Player, begin_of
from m100link.log.reading import Chunk, Message
from m100link.sim import VirtualClockEventLoop
from m100link.wire import Frame, FrameDecoder
from tests.log.flight import flown

pytestmark = pytest.mark.anyio


class Heard:
    """Who is played to, and what came."""

    def __init__(self, player: Player) -> None:
        self.player = player
        self.frames: list[tuple[float, float]] = []  # when it came then, and when now
        self.ends: list[str] = []
        self._decoder = FrameDecoder()
        self._clock = asyncio.get_running_loop().time

    def deliver(self, frame: Frame, now: float) -> None:
        self.frames.append((now, self._clock()))

    def stage(self) -> PlaybackTarget:
        return PlaybackTarget(
            decode=lambda data, _: self._decoder.feed(data),
            deliver=self.deliver,
            tell=lambda _: None,
            forget=lambda: None,
            end=lambda error: self.ends.append(error.cause),
            has_consumers=lambda: True,
            room=lambda: float("inf"),
            tap=None,
        )


@pytest.fixture
async def player(tmp_path: Path) -> Player:
    path = tmp_path / "flight.mcap"
    await flown(path)
    log = read(path)
    return Player(log, await begin_of(log))


@pytest.mark.parametrize("from_s", [0.0, 5.0])
async def test_its_clock_begins_where_that_of_the_event_loop_stands(
    player: Player, from_s: float
) -> None:
    now = asyncio.get_running_loop().time()
    begun = Player(player.flight, player.begin, from_s=from_s)
    assert (begun.time(), begun.position_s) == pytest.approx((now, from_s))
    assert begun.utc_offset_s == pytest.approx(player.begin.utc + from_s - now, abs=0.001)
    begun.seek(7.0)
    moved = begun.position_s, begun.time()
    assert moved == pytest.approx((7.0, now + 2.501)), "before it is played: behind its run-up"
    player.flight.path.unlink()
    with pytest.raises(UsageError, match="cannot be read: No such file"):
        await begin_of(player.flight)


async def test_its_clock_is_so_many_times_as_fast_and_stops_where_something_is_due(
    player: Player,
) -> None:
    """Before it plays: a clock that its own timers wait for would never end the test."""
    loop, end = asyncio.get_running_loop(), player.begin.duration_s
    for speed in (0.1, 0.5, 1.0, 4.0, 100.0):
        now, begun = loop.time(), Player(player.flight, player.begin, speed=speed, from_s=2.0)
        await asyncio.sleep(0.03)
        assert begun.position_s == pytest.approx(2.0 + 0.03 * speed)
        assert begun.time() == pytest.approx(now + 0.03 * speed)
        begun.pause()
        await asyncio.sleep(5.0)
        assert begun.position_s == pytest.approx(2.0 + 0.03 * speed)
        begun.resume()
        await asyncio.sleep(2.0 * end / speed)
        assert begun.position_s == pytest.approx(end)
        assert begun.time() == pytest.approx(now + end - 2.0)


async def test_it_wakes_when_something_is_due_and_not_again_and_again_before(
    player: Player, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A timer that comes too early and is set anew for less each time would never let time pass."""
    wakes, go = 0, Player._go
    reads = sum(1 for _ in player.flight.moments())

    def counted(one: Player) -> None:
        nonlocal wakes
        wakes += 1
        one.stop() if wakes > 3 * reads else go(one)

    monkeypatch.setattr(Player, "_go", counted)
    for speed in (0.5, 4.0):
        wakes, played = 0, Player(player.flight, player.begin, speed=speed)
        played.play(Heard(player).stage())
        await asyncio.sleep(player.begin.duration_s / speed - 0.01)
        ends = [played.is_at_end]
        await asyncio.sleep(0.02)
        assert [*ends, played.is_at_end] == [False, True]
        assert wakes <= 2 * reads + 2


async def test_it_stands_still_and_goes_on_where_it_stood(player: Player) -> None:
    heard = Heard(player)
    player.play(heard.stage())
    await asyncio.sleep(1.0)
    player.pause()
    count, at = len(heard.frames), player.time()
    await asyncio.sleep(5.0)
    assert len(heard.frames) == count
    assert player.time() == at
    assert player.position_s == pytest.approx(1.0)
    player.resume()
    await asyncio.sleep(1.0)
    assert player.time() == pytest.approx(at + 1.0)
    assert len(heard.frames) == pytest.approx(2 * count, rel=0.05)


async def test_each_speed_takes_its_time_and_the_clock_does_not_jump(player: Player) -> None:
    heard = Heard(player)
    player.play(heard.stage())
    at = player.time()
    for speed in (2.0, 0.1, 50.0, 100.0, 1.0):
        player.set_speed(speed)
        assert player.time() == pytest.approx(at)
        await asyncio.sleep(0.1)
        assert player.time() == pytest.approx(at + 0.1 * speed)
        at = player.time()
    player.set_speed(float("inf"))
    await asyncio.sleep(0.1)
    assert heard.ends == ["everything was played"]
    assert player.is_at_end
    assert player.position_s == pytest.approx(player.begin.duration_s)
    times = [then for then, _ in heard.frames]
    assert times == sorted(times)
    for speed in (0.0, -1.0, 0.05, 101.0, float("nan")):
        with pytest.raises(UsageError):
            player.set_speed(speed)


async def test_changes_in_a_silence_keep_the_silence_as_long_as_it_was(tmp_path: Path) -> None:
    from m100link import connect

    path = tmp_path / "flight.mcap"
    async with connect("sim://?seed=5", record=path) as aircraft:
        await asyncio.sleep(1)
        aircraft.link._transport.pause_reading()  # type: ignore[union-attr]
        await asyncio.sleep(10)
        aircraft.link._transport.resume_reading()  # type: ignore[union-attr]
        await asyncio.sleep(1)
    log = read(path)
    player = Player(log, await begin_of(log))
    heard = Heard(player)
    player.play(heard.stage())
    await asyncio.sleep(3)  # two seconds into the silence
    count = len(heard.frames)
    player.set_speed(4.0)
    await asyncio.sleep(1.0)
    player.pause()
    await asyncio.sleep(1.0)
    player.resume()
    player.set_speed(0.5)
    await asyncio.sleep(7.9)  # of the four seconds that are left
    assert len(heard.frames) == count
    await asyncio.sleep(0.2)
    assert len(heard.frames) > count


async def test_one_that_holds_stands_at_its_end(player: Player) -> None:
    begin, flight = player.begin, player.flight
    holding = Player(flight, begin, speed=100.0, from_s=3.0, to_s=8.0, holds=True)
    heard = Heard(holding)
    holding.play(heard.stage())
    await asyncio.sleep(1.0)
    assert holding.is_at_end
    assert holding.position_s == pytest.approx(8.0)
    at = holding.time()
    await asyncio.sleep(1.0)
    assert holding.time() == at
    assert heard.ends == []
    first = heard.frames[0][0] - at
    assert -5.0 - 2.5 <= first <= -5.0 - 2.4, "what came just before comes at once"


@pytest.mark.parametrize("speed", [1.0, 3.0, float("inf")])
@pytest.mark.parametrize("is_paused", [False, True])
async def test_it_is_moved_and_its_clock_goes_on(
    player: Player, speed: float, is_paused: bool
) -> None:
    player = Player(player.flight, player.begin, holds=True)
    heard = Heard(player)
    player.play(heard.stage())
    await asyncio.sleep(4.0)
    player.set_speed(speed)
    if is_paused:
        player.pause()
    for place in (12.0, 1.0, -5.0, 1e9):
        at = player.time()
        player.seek(place)
        place = min(max(0.0, place), player.begin.duration_s)
        run_up = at + 0.001, at + 0.001 + RUN_UP_S
        assert run_up[0] - 1e-6 <= player.time() <= run_up[1] + 1e-6, "later than all before"
        assert player.position_s == pytest.approx(place)
        count = len(heard.frames)
        await asyncio.sleep(0.0)
        await asyncio.sleep(0.05)
        if place > 0.0:
            assert len(heard.frames) > count, "where it was moved to is seen, while paused, too"
        if is_paused:
            assert player.position_s == pytest.approx(place)
            assert player.time() == pytest.approx(run_up[1])
        elif speed < 10 and not player.is_at_end:
            assert player.position_s == pytest.approx(place + 0.05 * speed)
    player.seek(0.0)
    player.resume()
    player.set_speed(1.0)
    await asyncio.sleep(1.0)
    assert not player.is_at_end, "it goes on after its end"
    assert player.position_s == pytest.approx(1.0)


async def test_a_listener_that_raises_does_not_end_it(player: Player) -> None:
    heard = Heard(player)
    errors: list[object] = []
    asyncio.get_running_loop().set_exception_handler(lambda _, told: errors.append(told))

    def deliver(frame: Frame, now: float) -> None:
        heard.deliver(frame, now)
        if len(heard.frames) == 3:
            raise RuntimeError("a bad callback")

    player.play(heard.stage()._replace(deliver=deliver))
    await asyncio.sleep(2.0)
    assert len(errors) == 1
    assert len(heard.frames) > 100
    player.stop()
    count = len(heard.frames)
    await asyncio.sleep(1.0)
    assert len(heard.frames) == count


# -- values: which moment comes when, and why it ends ----------------------------------------------

RX, TX = Direction.RECEIVED, Direction.SENT
UTC = 1_795_420_800.0


def event(second: float, text: str) -> Message:
    told = json.dumps({"text": text}).encode()
    return Message("/m100/event", 40.0 + second, UTC + second, told)


def chunk(second: float, direction: Direction = RX) -> Chunk:
    return Chunk(direction, 40.0 + second, UTC + second, bytes([round(10 * second)]))


class Played:
    """A recording of ten seconds by hand, and what a stage was given of it and when."""

    def __init__(self, moments: list[Any] | None = None, **changed: Any) -> None:
        self.asked: list[float] = []
        self.told: list[tuple[float, Any]] = []
        self.taps: list[tuple[Direction, float]] = []
        self.ends: list[tuple[str, str]] = []
        self.forgotten = 0
        self.has_consumers, self.room = True, math.inf
        self.moments = moments or [
            *(event(0.5, "early"), chunk(1.0), chunk(2.0), event(2.25, "run-up"), chunk(3.0)),
            Message("/m100/link", 43.5, UTC + 3.5, b"{}"),
            *(chunk(4.5, TX), chunk(5.0), event(6.0, "later"), chunk(9.0)),
        ]
        self.clock = asyncio.get_running_loop().time
        self.begin = Begin(
            *(40.0, UTC, 10.0, changed.pop("damage", Damage()), None, None),
            events=tuple(one for one in self.moments if isinstance(one, Message)),
        )
        flight: Any = SimpleNamespace(path=Path("logs/flight.mcap"), moments=self._moments)
        self.player = Player(flight, self.begin, **changed)
        self.began = self.clock()
        self.player.play(
            PlaybackTarget(
                decode=lambda data, _: [data],  # type: ignore[list-item]  # it stands for a frame
                deliver=lambda one, at: self._tell(("frame", one[0], at)),
                tell=lambda content: self._tell(content.get("text")),
                forget=self._forget,
                end=lambda error: self.ends.append((error.seen, error.cause)),
                has_consumers=lambda: self.has_consumers,
                room=lambda: self.room,
                tap=lambda way, _, at: self.taps.append((way, at - self.began)),
            )
        )

    def _moments(self, since_utc: float) -> Iterator[Any]:
        self.asked.append(since_utc - UTC)
        for one in self.moments:
            if isinstance(one, OSError):
                raise one
            yield one

    def _forget(self) -> None:
        self.forgotten += 1
        assert self.told == []

    def _tell(self, what: Any) -> None:
        now = self.clock() - self.began
        self.told.append((round(now, 3), what))

    @property
    def order(self) -> list[Any]:
        return [one[1] if isinstance(one, tuple) else one for _, one in self.told]


async def test_what_was_before_and_the_run_up_come_at_once_and_the_rest_in_its_time() -> None:
    """From the fourth second at double speed: the run-up begins at 1.5 s."""
    one = Played(speed=2.0, from_s=4.0, to_s=8.0)
    assert one.player.utc_offset_s == pytest.approx(UTC + 4.0 - one.began, abs=0.001)
    await asyncio.sleep(0.01)
    assert (one.asked, one.forgotten) == ([0.5], 1), "a second before the run-up, by the calendar"
    assert one.order == ["early", 20, "run-up", 30]
    await asyncio.sleep(1.98)
    assert one.ends == [], "four seconds at double speed, silence at the end or not"
    await asyncio.sleep(3.0)
    times = {str(what[1] if isinstance(what, tuple) else what): now for now, what in one.told}
    assert times["30"] < 0.01
    assert (times["50"], times["later"]) == pytest.approx((0.5, 1.0), abs=0.002)
    assert one.order == ["early", 20, "run-up", 30, 50, "later"], "nothing from behind its end"
    frames = [what for _, what in one.told if isinstance(what, tuple)]
    shifted = [at - one.began for *_, at in frames]
    assert shifted == pytest.approx([-2.0, -1.0, 1.0]), "as old as it was then"
    assert one.taps == [(RX, -2.0), (RX, -1.0), (TX, 0.5), (RX, 1.0)]
    seen = "the recording flight.mcap has ended, after 8.0 s"
    assert one.ends == [(seen, "it was played to where its end was asked for")]


@pytest.mark.parametrize(
    ("busy_s", "times"), [(0.2, (0.6, 1.0)), (1.0, (1.4, 1.9))], ids=["caught up", "not caught up"]
)
async def test_what_a_busy_computer_delays_by_more_than_a_quarter_second_stays_later(
    busy_s: float, times: tuple[float, float]
) -> None:
    """At double speed the fifth second is due after half a second, the sixth after one."""
    loop = asyncio.get_running_loop()
    assert isinstance(loop, VirtualClockEventLoop)
    await asyncio.sleep(500.0)
    one = Played(speed=2.0, from_s=4.0)
    await asyncio.sleep(0.4)
    loop._jumping.now += busy_s
    await asyncio.sleep(4.0)
    at = {str(what[1] if isinstance(what, tuple) else what): now for now, what in one.told}
    assert (at["50"], at["later"]) == pytest.approx(times, abs=0.002)


@pytest.mark.parametrize(
    ("changed", "cause"),
    [
        ({}, "everything was played"),
        ({"damage": Damage(is_ended=False)}, "the file is not whole: "),
        ({"damage": Damage(missing={"": 1})}, "the file is not whole: "),
        ({"to_s": 99.0}, "everything was played"),
        ({"to_s": 9.5}, "it was played to where its end was asked for"),
        ({"moments": [chunk(1.0), OSError(5, "bad disk")]}, "it cannot be read any further: bad"),
    ],
)
async def test_why_it_ends(changed: dict[str, Any], cause: str) -> None:
    one = Played(speed=math.inf, **changed)
    await asyncio.sleep(0.5)
    [(seen, why)] = one.ends
    assert why.startswith(cause)
    assert (one.player.is_at_end, len(one.ends)) == (True, 1)
    broken = "moments" in changed
    assert seen.endswith(f"{1.0 if broken else one.player._to:.1f} s")


@pytest.mark.parametrize(("comes_after", "begins_after"), [(0.0, 0.0), (0.5, 0.5), (9.0, 1.0)])
async def test_as_fast_as_it_is_taken_waits_a_second_for_its_taker(
    comes_after: float, begins_after: float
) -> None:
    one = Played(speed=math.inf)
    one.has_consumers = comes_after == 0.0
    asyncio.get_running_loop().call_later(comes_after, setattr, one, "has_consumers", True)
    await asyncio.sleep(2.0)
    assert one.told[0][0] == pytest.approx(begins_after, abs=0.02)


async def test_as_fast_as_it_is_taken_overtakes_no_taker() -> None:
    one, asked, rooms = Played(speed=math.inf), list[float](), list[float]()

    def room() -> float:
        asked.append(one.clock())
        return rooms.pop() if rooms else one.room

    assert one.player._stage is not None
    one.player._stage, one.room = one.player._stage._replace(room=room), 0.0
    await asyncio.sleep(2.0)
    assert one.order == ["early"], "telemetry waits, events before it do not"
    assert one.player.position_s == pytest.approx(1.0), "nor does its clock go on"
    assert asked.count(asked[0]) == 21, "turns of the event loop in which it may be taken"
    rooms.append(3.0)
    await asyncio.sleep(0.1)
    assert one.order == ["early", 10, 20, "run-up", 30]
    one.room = 1.0
    await asyncio.sleep(0.1)
    assert one.order == ["early", 10, 20, "run-up", 30, 50, "later", 90]
    assert one.ends
