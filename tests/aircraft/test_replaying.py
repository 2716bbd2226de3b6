"""A recorded flight is an aircraft as it was then, and obeys nobody."""

from __future__ import annotations

import asyncio
import math
from contextlib import suppress
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from mcap.writer import Writer

from m100link import (
    AuthorityEvent,
    Battery,
    ConnectionEvent,
    Credentials,
    Latest,
    Lossless,
    Newest,
    Position,
    Sample,
    connect,
)
from m100link.errors import (
    BadURL,
    CommandNotSupported,
    LinkClosed,
    LinkLost,
    OnlyRecorded,
    ReplayEnded,
    UsageError,
)
from m100link.link import Direction
from m100link.link.url import parse_replay
from m100link.log import read, recorder
from m100link.log.channels import COMMAND, RX, TX
from m100link.protocol.commands.activation import SendToMobile
from m100link.sim import VirtualClockEventLoop
from tests.log.flight import APP_ID, KEY, URL, flown, fly

pytest.importorskip("mcap", reason="the extra `log` is not installed")
pytestmark = pytest.mark.anyio


def copied(path: Path, name: str, size: int | None = None) -> Path:
    place = path.with_name(name)
    place.write_bytes(path.read_bytes()[:size])
    return place


@pytest.fixture
def anyio_backend() -> tuple[str, dict[str, Any]]:
    return "asyncio", {"loop_factory": VirtualClockEventLoop}


@pytest.fixture
async def path(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The log of a short flight, in many parts."""
    monkeypatch.setattr(recorder, "FLUSH_S", 0.0)  # of the wall clock: a part for each batch
    place = tmp_path / "flight.mcap"
    await flown(place)
    return place


async def played(url: str, **options: Any) -> tuple[list[Sample], ReplayEnded]:
    """Every package of a replay, and how it ended."""
    seen: list[Sample] = []
    aircraft = await connect(url, **options)
    try:
        async for sample in aircraft.telemetry(policy=Lossless(100)):
            seen.append(sample)
    except ReplayEnded as error:
        return seen, error
    raise AssertionError("it has no end")


async def test_telemetry_comes_again_as_it_came(tmp_path: Path) -> None:
    place = tmp_path / "flight.mcap"
    seen = await fly(place, URL + "&loss=0.05")
    now = asyncio.get_running_loop().time()
    again, _ = await played(f"replay://{place}")
    every = list(read(place).samples())
    assert [one.value for one in again] == [one.value for one in every]
    assert [one.value for one in again[-len(seen) :]] == [one.value for one in seen]
    shift = again[0].received_at - every[0].received_at
    assert now <= again[0].received_at <= now + 0.1
    assert [one.received_at - shift for one in again] == pytest.approx(
        [one.received_at for one in every], abs=1e-9
    )


async def test_what_the_line_lost_is_lost_again_for_the_same_causes(tmp_path: Path) -> None:
    place = tmp_path / "flight.mcap"
    lossy = "sim://?seed=5&loss=0.02&damage=0.05"
    async with connect(lossy, record=place) as aircraft:
        await asyncio.sleep(20)
        before = aircraft.statistics()
        gap = aircraft.state.statistics(Position).longest_gap_s
    assert before.discards
    replay = await connect(f"replay://{place}?speed=max")
    await replay.wait_closed()
    after = replay.statistics()
    assert after.discards == before.discards
    assert after.bytes_received == before.bytes_received
    assert after.frames_received == before.frames_received
    assert replay.state.statistics(Position).longest_gap_s == pytest.approx(gap, abs=2e-6)


@pytest.mark.parametrize("speed", ["0.5", "1", "2", "100", "max"])
async def test_a_silence_is_as_long_as_it_was_by_the_clock_of_the_flight(
    tmp_path: Path, speed: str
) -> None:
    place = tmp_path / "flight.mcap"
    async with connect("sim://?seed=5", record=place) as aircraft:
        await asyncio.sleep(2)
        aircraft.link._transport.pause_reading()  # type: ignore[union-attr]
        await asyncio.sleep(10)
        aircraft.link._transport.resume_reading()  # type: ignore[union-attr]
        await asyncio.sleep(2)
    clock = asyncio.get_running_loop().time
    began = clock()
    oldest, gaps = 0.0, []
    async with connect(f"replay://{place}?speed={speed}") as replay:
        samples = replay.telemetry(policy=Lossless(5000))
        while replay.is_connected:
            await asyncio.sleep(0.001)
            oldest = max(oldest, replay.state.newest_age or 0.0)
        times = [one.received_at for one in iter(samples.get_nowait, None)]
        gaps = [later - earlier for earlier, later in pairwise(times)]
    assert max(gaps) == pytest.approx(10.0, abs=0.02)
    if speed != "max":
        assert clock() - began == pytest.approx(14.0 / float(speed), rel=0.02)
        assert oldest == pytest.approx(10.0, abs=0.2)


async def test_the_holder_of_control_is_reported_as_it_was(path: Path) -> None:
    async with connect(f"replay://{path}?speed=10") as replay:
        events = replay.events()
        told = []
        with suppress(ReplayEnded):
            async for event in events:
                told.append(event)
    changes = [one.after.value for one in told if isinstance(one, AuthorityEvent)]
    assert changes == ["obtaining", "held", "releasing", "none"]
    end = told[-1]
    assert isinstance(end, ConnectionEvent)
    assert isinstance(end.error, ReplayEnded)


async def test_a_reader_that_begins_in_flight_sees_who_has_control(path: Path) -> None:
    async with connect(f"replay://{path}?from=8&until=9") as replay:
        assert replay.authority.state.value == "held"
        await asyncio.sleep(0.01)
        battery = replay.state.battery
        assert battery is not None, "items of 1 Hz are known at once"
        age = replay.state.age(Battery)
        assert age is not None
        assert 0.0 <= age < 1.1
        await replay.wait_closed()
        assert replay.link.clock() == pytest.approx(asyncio.get_running_loop().time(), abs=1e-3), (
            "at speed 1 the clocks are the same"
        )


async def test_an_order_is_refused_with_nothing_sent(path: Path) -> None:
    heard: list[Direction] = []
    async with connect(f"replay://{path}", tap=lambda way, *_: heard.append(way)) as replay:
        assert (await replay.version()).name.startswith("SDK-v1.0")
        credentials = Credentials(app_id=APP_ID, key=KEY)
        for order in (
            lambda: replay.activate(credentials),
            lambda: replay.control().__aenter__(),
            lambda: replay.execute(SendToMobile(b"hello")),
            lambda: replay.send_to_mobile(b"hello"),
            lambda: replay.gimbal.set_angular_rates(yaw=1.0),
            lambda: replay.camera.take_photo(),
        ):
            with pytest.raises(
                (OnlyRecorded, CommandNotSupported), match="nothing was sent"
            ) as refused:
                await order()
            assert refused.value.remedy
        with pytest.raises(OnlyRecorded):
            replay.link.push(b"\x01\x03")
        assert not await replay.release_authority()
        assert replay.statistics().frames_sent == 0
        await asyncio.sleep(5)
        assert {Direction.SENT, Direction.RECEIVED} == set(heard), "of then, in both directions"
        replay.use_key(credentials)  # what was encrypted can be read with it


async def test_the_end_is_distinguished_from_a_lost_cable(path: Path) -> None:
    async with connect(f"replay://{path}?speed=max") as replay:
        error = await replay.wait_closed()
        assert isinstance(error, ReplayEnded)
        assert not isinstance(error, LinkLost | LinkClosed)
        assert "everything was played" in str(error)
        with pytest.raises(ReplayEnded):
            await replay.send_to_mobile(b"late")
    closed = await connect(f"replay://{path}")
    await closed.aclose()
    with pytest.raises(LinkClosed):
        async for _ in closed.telemetry():
            pass


async def test_a_file_that_was_not_ended_plays_what_is_there_and_says_so(path: Path) -> None:
    cut = copied(path, "cut.mcap", 40_000)
    seen, ended = await played(f"replay://{cut}?speed=max")
    assert len(seen) > 100
    assert "the file is not whole: it ended without being closed" in ended.cause


@pytest.mark.parametrize("policy", [Latest(), Newest(3), Lossless(1), Lossless(50)], ids=repr)
@pytest.mark.parametrize("pause", [0.0, 0.001, 0.3])
async def test_as_fast_as_it_is_taken_loses_nothing(path: Path, policy: Any, pause: float) -> None:
    count = sum(1 for _ in read(path).samples())
    aircraft = await connect(f"replay://{path}?speed=max&until=4")
    wanted = sum(1 for one in read(path).samples() if one.received_at <= 4.0)
    assert 0 < wanted < count
    got = []
    with suppress(ReplayEnded):
        async for sample in aircraft.telemetry(policy=policy):
            got.append(sample.received_at)
            if pause:
                await asyncio.sleep(pause)
    assert len(got) == wanted
    assert got == sorted(got)


async def test_as_fast_as_it_is_taken_begins_with_its_taker(path: Path) -> None:
    aircraft = await connect(f"replay://{path}?speed=max")
    await asyncio.sleep(0.5)
    assert aircraft.state.newest_age is None
    first = await anext(aircraft.telemetry())
    assert first.value == next(read(path).samples()).value
    alone = await connect(f"replay://{path}?speed=max")
    await asyncio.sleep(1.5)
    assert not alone.is_connected, "without anybody it plays all the same"
    assert alone.state.position is not None


async def test_rows_are_collected_by_the_clock_of_the_flight(path: Path) -> None:
    for speed in ("max", "5", "1"):
        async with connect(f"replay://{path}?speed={speed}") as replay:
            table = await replay.collect(Position, seconds=3.0)
        assert len(table) == pytest.approx(300, abs=3)
        began = read(path).summary().began_utc
        assert began is not None
        assert table.column("utc")[0] == pytest.approx(began, abs=0.1)


async def test_what_cannot_be_played_is_refused_with_what_it_is(
    path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    text, empty, foreign = (tmp_path / one for one in ("notes.txt", "empty.mcap", "other.mcap"))
    text.write_text("none")
    empty.touch()
    with foreign.open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        channel = writer.register_channel("/chatter", "json", 0)
        writer.add_message(channel, 1, b"{}", 1)
        writer.finish()  # type: ignore[no-untyped-call] # of mcap
    bare = copied(path, "bare.mcap", 8)
    for place, why in (
        (tmp_path / "missing.mcap", "No such file"),
        (tmp_path, "Is a directory"),
        (text, "not a flight log"),
        (empty, "not a flight log"),
        (foreign, "no bytes of a line"),
        (bare, "no bytes of a line"),
    ):
        with pytest.raises(UsageError, match=why) as refused:
            await connect(f"replay://{place}")
        assert refused.value.remedy or "cannot be read" in refused.value.seen
    for query in ("speed=0", "speed=nan", "speed=-1", "speed=101", "speed=fast", "sped=2"):
        with pytest.raises(BadURL):
            await connect(f"replay://{path}?{query}")
    for query in ("from=-1", "from=inf", "from=nan", "from=2&until=1", "from=2&until=2"):
        with pytest.raises(BadURL):
            await connect(f"replay://{path}?{query}")
    with pytest.raises(UsageError, match="long"):
        await connect(f"replay://{path}?from=1e6")
    with pytest.raises(BadURL, match="no file"):
        await connect("replay://")
    with pytest.raises(UsageError, match="not recorded again"):
        await connect(f"replay://{path}", record=tmp_path)


def test_paths_are_written_as_people_write_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))
    odd = tmp_path / "a flight 50%20?.mcap"
    odd.touch()
    for url, place in {
        "replay://flight.mcap": Path("flight.mcap"),
        "replay:///logs/flight.mcap?speed=2": Path("/logs/flight.mcap"),
        "replay://../a b/flight.mcap": Path("../a b/flight.mcap"),
        "replay://a%20b.mcap": Path("a b.mcap"),
        "replay://~/flight.mcap": tmp_path / "flight.mcap",
        f"replay://{'x' * 300}%20": Path("x" * 300 + " "),  # too long to be a file
        f"replay://{odd}": odd,
        f"replay://{odd}?speed=3": odd,
    }.items():
        assert parse_replay(url).path == place, url
    assert parse_replay("replay://f?speed=max&from=1.5&until=2") == (Path("f"), math.inf, 1.5, 2.0)


async def test_two_replays_of_one_file_do_not_know_of_each_other(path: Path) -> None:
    first, second = await asyncio.gather(
        played(f"replay://{path}?speed=2"), played(f"replay://{path}?speed=max")
    )
    recorded = [one.value for one in read(path).samples()]
    assert len(recorded) > 100
    assert [one.value for one in first[0]] == recorded
    assert [one.value for one in second[0]] == recorded


async def test_a_file_that_goes_away_or_is_cut_while_it_is_played_ends_it_well(path: Path) -> None:
    count = sum(1 for _ in read(path).samples())
    gone = copied(path, "gone.mcap")
    aircraft = await connect(f"replay://{gone}")
    gone.unlink()
    await aircraft.wait_closed()
    assert aircraft.state.statistics(Position).count > count // 3
    cut = copied(path, "cut.mcap")
    async with connect(f"replay://{cut}") as aircraft:
        await asyncio.sleep(1)
        with cut.open("r+b") as stream:
            stream.truncate(100)
        assert isinstance(await aircraft.wait_closed(), ReplayEnded)


async def test_what_was_sent_is_in_the_log(path: Path) -> None:
    log = read(path)
    assert [one for one in log.chunks() if one.direction is Direction.SENT]
    assert list(log.messages(COMMAND))
    assert list(log.messages(RX, TX))
