"""A log comes whole or goes on where it was cut off, whatever happens to network and aircraft."""

from __future__ import annotations

import asyncio
import fcntl
from pathlib import Path

import anyio
import pytest

from m100link.apps.agent.messages import MessageError
from m100link.apps.bus.network import Question
from m100link.apps.fleet.asking import PATIENCE_S
from m100link.apps.fleet.logs.fetching import PIECE, Fetched, LogFetcher
from m100link.apps.fleet.logs.words import LogReply, pack_entries, pack_reply
from m100link.apps.fleet.payloads import VERSION, LogQuestion, OrderMessage, unpack
from m100link.errors import FleetError, Unreachable, UsageError
from m100link.log.folder import LogEntry
from tests.apps.bus.memory import Weather
from tests.apps.fleet.logs.conftest import FIRST, KEYS, SECOND, Road, bytes_of
from tests.apps.fleet.logs.test_service import serving

pytestmark = pytest.mark.anyio

WHOLE = f"a1-{FIRST}"


class Steps:
    """How far a fetch was, and what ends it."""

    def __init__(self, cut_at: int = 1 << 60, do: object = None) -> None:
        self.told: list[tuple[int, int]] = []
        self._cut_at, self._do = cut_at, do

    def __call__(self, at: int, size: int) -> None:
        self.told.append((at, size))
        if at >= self._cut_at:
            self._cut_at = 1 << 60
            assert callable(self._do)
            self._do()


async def test_the_newest_comes_whole_by_default(road: Road, tmp_path: Path) -> None:
    steps, fetcher, asked = Steps(), road.fetcher(), list[int]()

    real = fetcher._piece

    async def piece(log: str, at: int, length: int) -> bytes:
        asked.append(length)
        return await real(log, at, length)

    fetcher._piece = piece  # type: ignore[method-assign]
    async with serving(road):
        fetched = await fetcher.fetch(to=tmp_path / "here", progress=steps)
    assert asked == [PIECE] * 4 + [300_000 - 4 * PIECE]
    assert fetched == Fetched("a1", FIRST, tmp_path / "here" / WHOLE, 300_000, 300_000, False)
    assert fetched.path.read_bytes() == bytes_of(300_000)
    assert [path.name for path in (tmp_path / "here").iterdir()] == [WHOLE]
    assert steps.told[0] == (0, 300_000)
    assert steps.told[-1] == (300_000, 300_000)
    assert [at for at, _ in steps.told] == sorted({at for at, _ in steps.told})


async def test_it_goes_on_where_a_cancelled_one_ended(road: Road, tmp_path: Path) -> None:
    async with serving(road):
        with anyio.CancelScope() as scope:
            steps = Steps(2 * PIECE, scope.cancel)
            await road.fetcher().fetch(to=tmp_path, progress=steps)
        assert scope.cancelled_caught
        part = tmp_path / f"{WHOLE}.part"
        there = part.stat().st_size
        assert there == 2 * PIECE
        steps = Steps()
        fetched = await road.fetcher().fetch(to=tmp_path, progress=steps)
    assert steps.told[0] == (there, 300_000)
    assert fetched.came == 300_000 - there
    assert fetched.path.read_bytes() == bytes_of(300_000)
    assert not part.exists()


async def test_bad_weather_delays_it_and_changes_nothing(road: Road, tmp_path: Path) -> None:
    road.network.weather = Weather(loss=0.2, repeat=0.2, delay_s=0.05, jitter_s=0.3)
    async with serving(road):
        fetched = await road.fetcher().fetch(to=tmp_path)
    assert fetched.path.read_bytes() == bytes_of(300_000)


async def test_an_agent_that_is_gone_for_a_while_is_waited_for(road: Road, tmp_path: Path) -> None:
    def cut() -> None:
        road.network.cut(road.onboard)
        asyncio.get_running_loop().call_later(3.0, road.network.join, road.onboard)

    async with serving(road):
        fetched = await road.fetcher().fetch(to=tmp_path, progress=Steps(PIECE, cut))
    assert fetched.path.read_bytes() == bytes_of(300_000)


async def test_one_that_does_not_come_back_leaves_what_came(road: Road, tmp_path: Path) -> None:
    async with serving(road):
        cut = Steps(2 * PIECE, lambda: road.network.cut(road.onboard))
        began = anyio.current_time()
        with pytest.raises(Unreachable, match=f"131,072 of 300,000 bytes are in .*{FIRST}.part"):
            await road.fetcher().fetch(to=tmp_path, progress=cut)
        assert anyio.current_time() - began < PATIENCE_S + 5.0
        road.network.join(road.onboard)
        fetched = await road.fetcher().fetch(to=tmp_path)
    assert fetched.came == 300_000 - 2 * PIECE


async def test_nobody_there_is_said_at_once(road: Road) -> None:
    road.token.close()
    with pytest.raises(Unreachable, match="no agent named a1"):
        await road.fetcher().logs()


async def test_an_agent_that_knows_no_logs_is_said_with_what_to_do(road: Road) -> None:
    with pytest.raises(Unreachable, match="no answer about its logs"):
        await road.fetcher().logs()


async def test_a_log_that_is_removed_meanwhile_is_reported(road: Road, tmp_path: Path) -> None:
    async with serving(road):
        gone = Steps(2 * PIECE, (road.directory / FIRST).unlink)
        with pytest.raises(UsageError, match=r"No such file.*131,072 of"):
            await road.fetcher().fetch(to=tmp_path, progress=gone)


async def test_a_log_that_is_written_still_comes_as_what_is_there(
    road: Road, tmp_path: Path
) -> None:
    path = road.directory / SECOND
    path.write_bytes(bytes_of(100_000))
    name, writing = path.name, path.open("rb")
    fcntl.flock(writing, fcntl.LOCK_EX)  # as who records has it
    async with serving(road):
        fetched = await road.fetcher().fetch(name, to=tmp_path)
        assert (fetched.size, fetched.is_written) == (100_000, True)
        with path.open("ab") as stream:
            stream.write(b"more")
        writing.close()
        assert (await road.fetcher().logs())[0].log == name
        fetched = await road.fetcher().fetch(name, to=tmp_path)
        assert (fetched.size, fetched.came, fetched.is_written) == (100_004, 4, False)
        assert fetched.path.read_bytes() == bytes_of(100_000) + b"more"
        fetched = await road.fetcher().fetch(name, to=tmp_path)
        assert fetched.came == 0


async def test_a_file_of_that_name_that_is_another_is_left_alone(
    road: Road, tmp_path: Path
) -> None:
    for other in (bytes_of(500_000), b"mine"):
        (tmp_path / WHOLE).write_bytes(other)
        async with serving(road):
            with pytest.raises(UsageError, match="is another log"):
                await road.fetcher().fetch(to=tmp_path)
        assert (tmp_path / WHOLE).read_bytes() == other


async def test_a_part_of_something_else_is_noticed_and_fetched_anew(
    road: Road, tmp_path: Path
) -> None:
    for wrong in (b"x" * 1000, b"x" * 400_000):
        (tmp_path / f"{WHOLE}.part").write_bytes(wrong)
        async with serving(road):
            fetched = await road.fetcher().fetch(to=tmp_path)
        assert fetched.came == 300_000
        assert fetched.path.read_bytes() == bytes_of(300_000)
        fetched.path.unlink()


async def test_a_log_that_changes_on_board_is_not_said_to_be_whole(
    road: Road, tmp_path: Path
) -> None:
    def change() -> None:
        (road.directory / FIRST).write_bytes(b"y" * 300_000)

    async with serving(road):
        with pytest.raises(FleetError, match="differs from the log of a1"):
            await road.fetcher().fetch(to=tmp_path, progress=Steps(2 * PIECE, change))
    assert not any((tmp_path / name).exists() for name in (WHOLE, f"{WHOLE}.part"))


async def test_a_log_that_becomes_shorter_is_reported(road: Road, tmp_path: Path) -> None:
    def cut() -> None:
        (road.directory / FIRST).write_bytes(bytes_of(300_000)[: PIECE + 5])

    async with serving(road):
        with pytest.raises(UsageError, match="ends at 65541 bytes"):
            await road.fetcher().fetch(to=tmp_path, progress=Steps(PIECE, cut))


@pytest.mark.parametrize(("offset", "size"), [(PIECE + 1, 10), (0, 10), (PIECE, 11), (PIECE, 0)])
async def test_a_piece_of_another_place_or_length_is_not_taken(
    road: Road, offset: int, size: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def answered(question: object) -> tuple[LogReply, bytes]:
        return LogReply("", "a1", offset=offset, size=300_000), bytes(size)

    fetcher = road.fetcher()
    monkeypatch.setattr(fetcher, "_ask", answered)
    with pytest.raises(UsageError, match="ends at 300000 bytes"):
        await fetcher._piece(FIRST, PIECE, 10)


async def test_lines_of_an_audit_are_asked_for_behind_those_that_came(
    road: Road, monkeypatch: pytest.MonkeyPatch
) -> None:
    lines, asked = {7: b"a\nb\n", 9: b"c\n", 10: b""}, list[int]()

    async def answered(question: LogQuestion) -> tuple[LogReply, bytes]:
        asked.append(question.offset)
        return LogReply("", "a1"), lines[question.offset]

    fetcher = road.fetcher()
    monkeypatch.setattr(fetcher, "_ask", answered)
    assert await fetcher.audit(7) == b"a\nb\nc\n"
    assert asked == [7, 9, 10]


@pytest.mark.parametrize("size", [1, 9, 10])
async def test_a_piece_may_be_shorter_than_it_was_asked_for(
    road: Road, size: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The last byte of a log may come alone."""

    async def answered(question: object) -> tuple[LogReply, bytes]:
        return LogReply("", "a1", offset=PIECE, size=PIECE + size), b"x" * size

    fetcher = road.fetcher()
    monkeypatch.setattr(fetcher, "_ask", answered)
    assert await fetcher._piece(FIRST, PIECE, 10) == b"x" * size


async def test_several_fetch_at_once_and_a_slow_one_holds_up_nobody(
    road: Road, tmp_path: Path
) -> None:
    (road.directory / SECOND).write_bytes(bytes_of(200_000))
    ends: dict[str, float] = {}

    async def fetch(log: str, folder: str) -> None:
        fetched = await road.fetcher().fetch(log, tmp_path / folder)
        assert fetched.path.read_bytes() == (road.directory / log).read_bytes()
        ends[folder] = anyio.current_time()

    async with serving(road):
        slow = road.fetcher()
        with anyio.move_on_after(100.0):
            async with anyio.create_task_group() as group:
                group.start_soon(fetch, FIRST, "one")
                group.start_soon(fetch, SECOND, "two")
                group.start_soon(fetch, FIRST, "three")

                async def crawl() -> None:
                    for _ in range(3):
                        await slow.logs()
                        await anyio.sleep(20.0)
                    ends["slow"] = anyio.current_time()

                group.start_soon(crawl)
    assert sorted(ends, key=ends.__getitem__)[-1] == "slow"
    assert len(ends) == 4


async def test_what_an_aircraft_names_does_not_lead_out_of_the_folder(
    road: Road, tmp_path: Path
) -> None:
    def answer(question: Question) -> None:
        order: OrderMessage = unpack(OrderMessage, question.payload)
        entries = [LogEntry("../../evil.mcap", 3, 9e9, False), LogEntry("/tmp/x", 3, 9e9, False)]
        question.answer(KEYS.log, pack_reply(LogReply(order.id, "a1"), pack_entries(entries)))

    road.onboard.serve(KEYS.log, answer)
    assert await road.fetcher().logs() == []
    with pytest.raises(UsageError, match="has no logs"):
        await road.fetcher().fetch(to=tmp_path)
    with pytest.raises(UsageError, match="no name of a log"):
        await road.fetcher().fetch("../../evil.mcap", to=tmp_path)


async def test_a_name_that_is_not_there_is_reported_with_what_to_do(road: Road) -> None:
    async with serving(road):
        with pytest.raises(UsageError) as caught:
            await road.fetcher().fetch(SECOND)
    assert caught.value.remedy == "m100link fleet log list a1"


async def test_junk_in_place_of_answers_is_said_and_never_believed(road: Road) -> None:
    junk = bytes([VERSION]) + b"junk\n"
    road.onboard.serve(KEYS.log, lambda question: question.answer(KEYS.log, junk))
    with pytest.raises(MessageError, match="not a LogReply: this is not JSON"):
        await LogFetcher(road.asker()).logs()
