"""Ctrl-C between any two lines of the link: what waited ends, and the line goes on.

The loop runs on afterwards, as it does at a prompt or in a notebook.
"""

from __future__ import annotations

import asyncio
import contextlib
import sys
from collections.abc import Callable, Coroutine, Iterator
from types import FrameType
from typing import Any

import pytest

from m100link.errors import AckTimeout, LinkClosed, LinkError, LinkLost
from m100link.link import Link, MemoryTransport, connect_in_memory
from m100link.link import link as link_module
from m100link.session import Endpoint
from m100link.sim.clock import VirtualClockEventLoop
from m100link.wire import Frame


class Interrupt:
    """Raises KeyboardInterrupt before the line of that number in the link.

    Attributes:
        came_in: Where that was; "" if there are not so many lines.
        came_at: When.
    """

    def __init__(self, number: int) -> None:
        self.left = number
        self.came_in = ""
        self.came_at = 0.0

    def __enter__(self) -> None:
        self._before = sys.gettrace()  # what measures coverage has to go on
        sys.settrace(self._enter)

    def __exit__(self, *_: object) -> None:
        sys.settrace(self._before)

    def _enter(self, frame: FrameType, event: str, _: object) -> Any:
        return self._trace if frame.f_code.co_filename == link_module.__file__ else None

    def _trace(self, frame: FrameType, event: str, _: object) -> Any:
        if event == "line" and not self.came_in:
            self.left -= 1
            if self.left < 0:
                self.came_in = f"{frame.f_code.co_name}:{frame.f_lineno}"
                raise KeyboardInterrupt
        return self._trace


class OtherEnd(asyncio.Protocol):
    """Plays the aircraft without a link: what is cut off is the one that is looked at.

    Attributes:
        answers: Whether it acknowledges.
        received: What came, with its time.
    """

    def __init__(self) -> None:
        self.answers = True
        self.received: list[tuple[bytes, float]] = []
        self.endpoint = Endpoint()
        self.transport: MemoryTransport

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        assert isinstance(transport, MemoryTransport)
        self.transport = transport

    def data_received(self, data: bytes) -> None:
        now = asyncio.get_running_loop().time()
        for frame in self.endpoint.receive_data(data, now):
            assert isinstance(frame, Frame)
            self.received.append((frame.data, now))
            if self.answers:
                self.endpoint.acknowledge(frame, b"ack of " + frame.data, now=now)
        self.write()

    def write(self) -> None:
        self.transport.write(b"".join(self.endpoint.output()))

    def push(self, *data: bytes) -> None:
        """All of them in one chunk."""
        for one in data:
            self.endpoint.push(one)
        self.write()


class Life:
    """A link on a loop that one KeyboardInterrupt leaves and that runs on.

    Attributes:
        taken: Data of what the link handed on.
        ended: Why, each time that the link reported its end.
    """

    def __init__(self, loop: asyncio.AbstractEventLoop, interrupt: Interrupt) -> None:
        self.loop = loop
        self.interrupt = interrupt
        self.taken: list[bytes] = []
        self.ended: list[LinkError] = []
        self.link: Link
        self.peer = OtherEnd()

    async def connect(self) -> None:
        self.link = Link(
            on_received=lambda frame, now: self.taken.append(frame.data),
            on_lost=self.ended.append,
            first_sequence=0,
        )
        connect_in_memory(self.link, self.peer)
        await self.link.wait_connected()

    def run(self, program: Coroutine[Any, Any, Any]) -> Any:
        """Run it to its end, whatever leaves the loop meanwhile; what it returns or raised."""
        task = self.loop.create_task(program)
        give_up_at = self.loop.time() + 100.0
        while not task.done():
            assert self.loop.time() < give_up_at, "it waits for ever"
            with contextlib.suppress(KeyboardInterrupt), self.interrupt:
                self.loop.run_until_complete(asyncio.wait([task], timeout=100.0))
            if self.interrupt.came_in and not self.interrupt.came_at:
                self.interrupt.came_at = self.loop.time()
        return task.exception() or task.result()


def asking(life: Life) -> None:
    """A request, cut off, does not leave later than at once, and leaves nothing behind."""
    life.run(life.link.request(b"one"))
    life.run(asyncio.sleep(5.0))
    times = [at for data, at in life.peer.received if data == b"one"]
    assert len(times) <= 1
    assert times <= [life.interrupt.came_at]


def asking_side_by_side(life: Life) -> None:
    """Who waits for another request gets its answer, or learns that it is unknown."""

    async def both() -> list[Any]:
        requests = [life.link.request(data, timeout=0.5, tries=2) for data in (b"one", b"two")]
        return await asyncio.gather(*requests, return_exceptions=True)

    began_at = life.loop.time()
    for answer, data in zip(life.run(both()), (b"one", b"two"), strict=True):
        assert answer == b"ack of " + data or isinstance(answer, AckTimeout | KeyboardInterrupt)
    assert life.loop.time() - began_at <= 1.0 + 1e-6


def asking_in_vain(life: Life) -> None:
    """Time-outs come, each to whom it belongs."""

    async def ask() -> list[Any]:
        requests = [
            life.link.request(data, timeout=timeout, tries=2)
            for data, timeout in ((b"one", 0.5), (b"two", 0.2), (b"three", 0.8))
        ]
        return await asyncio.gather(*requests, return_exceptions=True)

    life.peer.answers = False
    began_at = life.loop.time()
    answers = life.run(ask())
    assert all(isinstance(answer, AckTimeout | KeyboardInterrupt) for answer in answers)
    assert life.loop.time() - began_at <= 1.6 + 1e-6
    life.peer.answers = True


def listening(life: Life) -> None:
    """At most the chunk that was cut off is lost, and nothing comes twice."""
    chunks = [[b"a", b"b"], [b"c"], [b"d", b"e", b"f"]]
    for chunk in chunks:
        life.peer.push(*chunk)
        life.run(asyncio.sleep(0.1))
    sent = [data for chunk in chunks for data in chunk]
    missing = [data for data in sent if data not in life.taken]
    assert life.taken == [data for data in sent if data not in missing]
    assert any(set(missing) <= set(chunk) for chunk in chunks)


def pushing(life: Life) -> None:
    """What did not leave at once never leaves."""
    for data in (b"one", b"two", b"three"):
        with contextlib.suppress(KeyboardInterrupt), life.interrupt:
            life.link.push(data)
        life.run(asyncio.sleep(1.0))
    times = dict(life.peer.received)
    assert len(times) == len(life.peer.received) >= 2
    began_at = life.loop.time() - 3.0
    for number, data in enumerate((b"one", b"two", b"three")):
        assert times.get(data, began_at + number) == pytest.approx(began_at + number)


def ends(reason: type[LinkError], end: Callable[[Life], None]) -> Callable[[Life], None]:
    def live(life: Life) -> None:
        life.peer.answers = False
        waiting = [
            life.loop.create_task(life.link.request(data, timeout=9.0)) for data in (b"one", b"two")
        ]
        life.run(asyncio.sleep(0.1))
        end(life)
        life.run(asyncio.sleep(2.0))
        for task in waiting:
            assert task.done()
            assert isinstance(task.exception(), reason | KeyboardInterrupt)
        assert not life.link.is_open
        assert isinstance(life.link.failure, reason)
        assert life.ended
        assert set(map(type, life.ended)) == {reason}
        assert life.peer.transport.is_closing()
        with pytest.raises(reason):
            life.link.push(b"more")

    return live


def close(life: Life) -> None:
    """Who was cut off does it again."""
    if isinstance(life.run(life.link.close()), KeyboardInterrupt):
        life.run(life.link.close())


def lose(life: Life) -> None:
    """The transport tells it once; again only where not even the first line of that was begun."""

    async def tell() -> None:
        life.peer.transport.break_off(None)
        await asyncio.sleep(0)

    life.run(tell())
    begin = Link.connection_lost.__code__.co_firstlineno + 2
    if life.interrupt.came_in == f"connection_lost:{begin}":
        life.link.connection_lost(None)


def goes_on(live: Callable[[Life], None]) -> Callable[[Life], None]:
    def live_and_go_on(life: Life) -> None:
        live(life)
        for _ in range(2):
            answer = life.run(life.link.request(b"more"))
            assert answer == b"ack of more" or life.interrupt.came_at == life.loop.time()
        life.run(asyncio.sleep(5.0))
        assert all(future.done() for future, _ in life.link._pending.values())
        assert life.link._endpoint.sender.busy_sessions == 0
        assert life.link._endpoint.next_wakeup() is None

    return live_and_go_on


LIVES = {
    "asking": goes_on(asking),
    "asking side by side": goes_on(asking_side_by_side),
    "asking in vain": goes_on(asking_in_vain),
    "listening": goes_on(listening),
    "pushing": goes_on(pushing),
    "closing": ends(LinkClosed, close),
    "losing": ends(LinkLost, lose),
}


def interrupted_everywhere(live: Callable[[Life], None]) -> Iterator[str]:
    """Live once per line with a KeyboardInterrupt before it."""
    for number in range(10_000):
        loop = VirtualClockEventLoop()
        asyncio.set_event_loop(loop)
        never, interrupt = Interrupt(10**9), Interrupt(number)
        life = Life(loop, never)
        try:
            life.run(life.connect())
            life.interrupt = interrupt
            live(life)
        except BaseException as error:
            error.add_note(f"interrupted in {interrupt.came_in}")
            raise
        finally:
            loop.close()
        if not interrupt.came_in:
            return
        yield interrupt.came_in
    raise AssertionError("it has no end")


@pytest.mark.parametrize("life", LIVES)
def test_ctrl_c_between_any_two_lines(life: str) -> None:
    places = list(interrupted_everywhere(LIVES[life]))
    assert len(places) > 10
