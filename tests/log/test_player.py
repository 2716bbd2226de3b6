"""A player stands still, goes on, and changes its speed; its clock never jumps."""

from __future__ import annotations

import asyncio
from pathlib import Path

import pytest

from m100link.errors import UsageError
from m100link.log import read
from m100link.log.player import RUN_UP_S, PlaybackTarget, Player, begin_of
from m100link.wire import Frame, FrameDecoder
from tests.log.flight import fly

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
    await fly(path)
    log = read(path)
    return Player(log, await begin_of(log))


@pytest.mark.parametrize("from_s", [0.0, 5.0])
async def test_its_clock_begins_where_that_of_the_event_loop_stands(
    player: Player, from_s: float
) -> None:
    now = asyncio.get_running_loop().time()
    begun = Player(player.flight, player.begin, from_s=from_s)
    assert (begun.time(), begun.position_s) == pytest.approx((now, from_s))
    assert begun.utc_offset_s == pytest.approx(player.begin.utc + from_s - now)


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
    for speed in (2.0, 0.1, 50.0, 1.0):
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
