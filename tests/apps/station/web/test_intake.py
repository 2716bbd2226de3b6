"""What connections sent is parsed a piece at a time, in turn, and within a budget of each."""

from __future__ import annotations

import asyncio
import random
from itertools import pairwise
from typing import Any

import pytest

from m100link.apps.station.web.intake import (
    BYTES_AT_ONCE,
    BYTES_RATE,
    EVENTS_AT_ONCE,
    EVENTS_RATE,
    LONGEST_PAUSE,
    PIECE,
    READ,
    Intake,
    Metered,
)
from m100link.sim.clock import virtual_clock_loop

pytestmark = pytest.mark.anyio


@pytest.fixture
def anyio_backend() -> tuple[str, dict[str, Any]]:
    return "asyncio", {"loop_factory": virtual_clock_loop}


class Line(asyncio.Transport):
    """A transport, and what its peer has still to send."""

    def __init__(self) -> None:
        super().__init__()
        self.metered: Metered | None = None
        self.unread = b""
        self.reads = True
        self.ended = ""
        self.written = b""

    def get_extra_info(self, name: str, default: Any = None) -> Any:
        return ("192.0.2.1", 4242) if name == "peername" else default

    def deliver(self, data: bytes = b"") -> None:
        """As a selector does: as much as there is room for, whenever it is read."""
        self.unread += data
        assert self.metered is not None
        while self.reads and self.unread and not self.ended:
            space = self.metered.get_buffer(-1)
            count = min(len(space), len(self.unread))
            space[:count], self.unread = self.unread[:count], self.unread[count:]
            self.metered.buffer_updated(count)

    def pause_reading(self) -> None:
        self.reads = False

    def resume_reading(self) -> None:
        self.reads = True
        asyncio.get_running_loop().call_soon(self.deliver)

    def write(self, data: Any) -> None:
        self.written += bytes(data)

    def is_closing(self) -> bool:
        return bool(self.ended)

    def close(self) -> None:
        self.ended = self.ended or "closed"

    def abort(self) -> None:
        self.ended = "aborted"


class Speaker(asyncio.Protocol):
    """What speaks on a connection: each byte is an event, unless the test says otherwise."""

    def __init__(self, told: list[str], name: str, *, steers: bool = False) -> None:
        self.told, self.name, self.steers = told, name, steers
        self.events, self.events_per_byte = 0, 0.0
        self.count = 0
        self.pieces: list[bytes] = []
        self.transport: Any = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self.transport = transport

    def data_received(self, data: bytes) -> None:
        self.told.append(self.name)
        self.pieces.append(data)
        self.count += len(data)
        self.events += int(self.events_per_byte * len(data))
        if data.startswith(b"raise"):
            raise RuntimeError("a parser with a fault")


def connected(intake: Intake, speaker: Speaker) -> Line:
    line = Line()
    line.metered = Metered(intake, speaker)
    line.metered.connection_made(line)
    return line


async def test_whatever_is_sent_is_parsed_in_pieces_with_turns_of_the_loop_between() -> None:
    intake, told = Intake(), []  # type: ignore[var-annotated]
    speaker = Speaker(told, "flood")
    line = connected(intake, speaker)
    line.deliver(bytes(10 * READ))
    assert told == []  # not in the callback of the transport
    most_in_a_turn = 0
    for _ in range(4000):
        before = len(told)
        await asyncio.sleep(0)
        most_in_a_turn = max(most_in_a_turn, len(told) - before)
    await asyncio.sleep(1.0)
    assert b"".join(speaker.pieces) == bytes(10 * READ)
    assert max(map(len, speaker.pieces)) <= PIECE == 256
    assert most_in_a_turn <= READ // PIECE  # and no more than was read at once


async def test_connections_take_turns() -> None:
    intake = Intake()
    told: list[str] = []
    lines = [connected(intake, Speaker(told, str(number))) for number in range(4)]
    for line in lines:
        line.deliver(bytes(3 * PIECE))
    await asyncio.sleep(1.0)
    assert told == ["0", "1", "2", "3"] * 3


async def test_a_connection_that_steers_goes_before_any_number_of_others() -> None:
    work = 0.0

    def worked() -> float:
        nonlocal work
        work += 0.05  # whatever strangers sent: it took long
        return work

    intake = Intake(worked)
    told: list[str] = []
    for number in range(100):
        connected(intake, Speaker(told, f"stranger {number}")).deliver(bytes(READ))
    await asyncio.sleep(0.2)
    told.clear()
    connected(intake, Speaker(told, "pilot", steers=True)).deliver(b"stop")
    await asyncio.sleep(0)
    await asyncio.sleep(0)
    assert told[:1] == ["pilot"]


@pytest.mark.parametrize("work", [0.0, 0.004, 0.04, 5.0])
async def test_the_others_pause_as_long_as_the_process_has_worked(work: float) -> None:
    loop = asyncio.get_running_loop()
    worked = 0.0

    def working() -> float:
        return worked

    intake, began = Intake(working), loop.time()
    turns: list[float] = []

    class Dear:
        steers, is_dear = False, True

        def step(self) -> None:
            nonlocal worked
            worked += work  # now, or in what it began
            turns.append(loop.time() - began)
            intake.put(self)

    one = Dear()
    intake.put(one)
    while len(turns) < 20:
        await asyncio.sleep(0)
        await asyncio.sleep(work / 4)
    gaps = [later - earlier for earlier, later in pairwise(turns)]
    assert min(gaps) >= min(work, LONGEST_PAUSE) - 1e-9


@pytest.mark.parametrize(
    ("per_byte", "rate", "at_once"),
    [(0.0, BYTES_RATE, BYTES_AT_ONCE), (1 / 6, 6 * EVENTS_RATE, 6 * EVENTS_AT_ONCE)],
    ids=["bytes", "frames of six bytes"],
)
async def test_a_connection_has_a_budget_and_is_cut_off_when_it_wants_more_for_long(
    per_byte: float, rate: float, at_once: float
) -> None:
    loop, told = asyncio.get_running_loop(), []  # type: ignore[var-annotated]
    speaker = Speaker(told, "greedy")
    speaker.events_per_byte = per_byte
    line = connected(Intake(lambda: 0.0), speaker)
    began = loop.time()
    line.deliver(bytes(5_000_000))
    while not line.ended and loop.time() < began + 60.0:
        await asyncio.sleep(0.01)
        allowed = at_once + rate * (loop.time() - began)
        assert speaker.count <= allowed + READ + PIECE
    assert line.ended == "aborted"
    assert 5.0 <= loop.time() - began < 15.0


@pytest.mark.parametrize(
    ("per_byte", "rate", "times", "is_cut_off"),
    [
        (1 / 6, 6 * EVENTS_RATE, 4.5, False),
        (1 / 6, 6 * EVENTS_RATE, 9.0, True),
        (0.0, BYTES_RATE, 1.5, False),
    ],
)
async def test_a_connection_that_steers_may_send_five_times_as_much(
    per_byte: float, rate: float, times: float, is_cut_off: bool
) -> None:
    speaker = Speaker([], "pilot", steers=True)
    speaker.events_per_byte = per_byte
    line = connected(Intake(lambda: 0.0), speaker)
    for _ in range(1000):
        if line.ended:
            break
        line.deliver(bytes(round(times * rate / 100)))
        await asyncio.sleep(1 / 100)
    assert bool(line.ended) is is_cut_off


async def test_within_its_budget_it_stays() -> None:
    speaker = Speaker([], "pilot")
    line = connected(Intake(lambda: 0.0), speaker)
    speaker.events_per_byte = 1 / 10
    for _ in range(3000):
        line.deliver(bytes(10))
        await asyncio.sleep(1 / 200)
    assert not line.ended
    assert sum(map(len, speaker.pieces)) == 30_000


@pytest.mark.parametrize("end", ["close", "abort"])
async def test_what_waits_when_it_is_closed_is_never_parsed(end: str) -> None:
    told: list[str] = []
    speaker = Speaker(told, "refused")
    line = connected(Intake(), speaker)
    line.deliver(bytes(2_400_000))
    for _ in range(5):
        await asyncio.sleep(0)
    getattr(speaker.transport, end)()
    count = len(told)
    await asyncio.sleep(5.0)
    assert len(told) == count
    assert len(line.unread) >= 2_400_000 - 10 * READ


async def test_a_fault_of_a_parser_costs_its_connection_alone() -> None:
    intake = Intake()
    told: list[str] = []
    bad, good = Speaker(told, "bad"), Speaker(told, "good")
    bad_line, good_line = connected(intake, bad), connected(intake, good)
    bad_line.deliver(b"raise" + bytes(READ))
    good_line.deliver(bytes(READ))
    await asyncio.sleep(1.0)
    assert bad_line.ended == "aborted"
    assert not good_line.ended
    assert told.count("bad") == 1
    assert b"".join(good.pieces) == bytes(READ)


async def test_what_is_put_back_is_for_the_next_speaker() -> None:
    class Upgraded(Speaker):
        def data_received(self, data: bytes) -> None:
            super().data_received(data[:3])
            self.transport.set_protocol(after)
            self.transport.put_back(len(data) - 3)

    after = Speaker([], "after")
    before = Upgraded([], "before")
    line = connected(Intake(), before)
    line.deliver(b"GETframes")
    await asyncio.sleep(1.0)
    assert before.pieces == [b"GET"]
    assert after.pieces == [b"frames"]


@pytest.mark.parametrize("seed", range(20))
async def test_nothing_is_lost_nor_turned_round(seed: int) -> None:
    """Drawn: many connections, of which each pauses when it likes."""
    drawn = random.Random(seed)
    intake = Intake(lambda: 0.0)
    told: list[str] = []
    loop = asyncio.get_running_loop()

    class Moody(Speaker):
        def data_received(self, data: bytes) -> None:
            assert not self.is_held
            super().data_received(data)
            self.steers = drawn.random() < 0.3
            if drawn.random() < 0.3:
                self.is_held = True
                self.transport.pause_reading()
                loop.call_later(drawn.random() / 10, self.go_on)

        is_held = False

        def go_on(self) -> None:
            self.is_held = False
            self.transport.resume_reading()

    speakers = [Moody(told, str(number)) for number in range(10)]
    lines = [connected(intake, one) for one in speakers]
    sent = [drawn.randbytes(drawn.randrange(20_000)) for _ in lines]
    left = list(sent)
    while any(left):
        place = drawn.randrange(len(left))
        count = drawn.randrange(5000)
        lines[place].deliver(left[place][:count])
        left[place] = left[place][count:]
        await asyncio.sleep(drawn.choice((0.0, 0.001)))
    await asyncio.sleep(60.0)
    assert [b"".join(one.pieces) for one in speakers] == sent
