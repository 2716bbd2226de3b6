"""Real pseudo-terminals in real time: few, because they wait."""

from __future__ import annotations

import asyncio
import contextlib
import gc
import os
import pty
import random
import threading
import time
import tty
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import serial

from m100link.errors import LinkClosed, LinkError, LinkLost, PortBusy
from m100link.link import Link, open_link, transport
from m100link.link.link import CLOSE_TIMEOUT
from m100link.wire import FrameDecoder, encode_frame
from tests.waiting import PATIENCE, until

pytestmark = [pytest.mark.anyio, pytest.mark.pty, pytest.mark.usefixtures("owners_are_found")]


class Terminal:
    """A pseudo-terminal: its path for the link, its master side for the test."""

    def __init__(self) -> None:
        self.master, slave = pty.openpty()
        tty.setraw(slave)
        self.path = os.ttyname(slave)
        self._slave = slave  # held: a pty without any slave open reports a hang-up to its master
        os.set_blocking(self.master, False)
        self.drained = 0

    def unplug(self) -> None:
        """Close the master side, which is what pulling a USB adapter looks like."""
        if self.master >= 0:
            os.close(self.master)
            self.master = -1

    def close(self) -> None:
        """Close both sides."""
        self.unplug()
        os.close(self._slave)

    def drain(self) -> None:
        """Read what there is."""
        with contextlib.suppress(BlockingIOError):
            self.drained += len(os.read(self.master, 65536))

    def answer_everything(self) -> Callable[[], None]:
        """Acknowledge each command on the running loop; call the result to stop."""
        decoder, loop = FrameDecoder(), asyncio.get_running_loop()

        def read() -> None:
            for frame in decoder.feed(os.read(self.master, 4096)):
                if frame.session:
                    ack = encode_frame(
                        b"ack of " + frame.data,
                        session=frame.session,
                        sequence=frame.sequence,
                        is_ack=True,
                    )
                    os.write(self.master, ack)

        loop.add_reader(self.master, read)

        def stop() -> None:
            loop.remove_reader(self.master)

        return stop


@pytest.fixture
def terminal() -> Iterator[Terminal]:
    terminal = Terminal()
    yield terminal
    terminal.close()


@pytest.fixture
def complaints() -> list[dict[str, Any]]:
    """What reached the loop's exception handler, once ``watch`` was called."""
    return []


def watch(complaints: list[dict[str, Any]]) -> None:
    """Collect what reaches the exception handler of the running loop."""
    asyncio.get_running_loop().set_exception_handler(lambda _, context: complaints.append(context))


async def fill(link: Link) -> None:
    """Push until the line takes no more."""
    for _ in range(1000):
        if not link.push(bytes(500)):
            return
        await asyncio.sleep(0)
    raise AssertionError("half a megabyte went into a line that nobody reads")


def open_descriptors() -> int:
    """How many files this process holds open."""
    return len(list(Path("/proc/self/fd").iterdir()))


@pytest.mark.smoke
async def test_requests_are_answered_over_a_pty(terminal: Terminal) -> None:
    link = await open_link(f"serial://{terminal.path}:230400")
    stop = terminal.answer_everything()
    answers = await asyncio.gather(*(link.request(b"%d" % n) for n in range(50)))
    assert answers == [b"ack of %d" % n for n in range(50)]
    stop()
    await link.close()


async def test_where_a_loop_can_watch_a_port_nobody_polls(
    terminal: Terminal, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delattr(transport, "_PolledTransport")
    await (await open_link(terminal.path)).close()


@pytest.mark.parametrize("fault", [KeyboardInterrupt, RuntimeError])
async def test_a_port_that_cannot_be_attached_is_free_again(
    terminal: Terminal, monkeypatch: pytest.MonkeyPatch, fault: type[BaseException]
) -> None:
    def fail(loop: asyncio.AbstractEventLoop, protocol: object, port: serial.Serial) -> None:
        loop.add_reader(port.fileno(), print)
        raise fault

    with monkeypatch.context() as patched:
        patched.setattr(transport, "SerialTransport", fail)
        before = open_descriptors()
        with pytest.raises(fault):
            await open_link(terminal.path)
        assert open_descriptors() == before
    link = await open_link(terminal.path)
    stop = terminal.answer_everything()
    assert await link.request(b"x") == b"ack of x"
    stop()
    await link.close()


@pytest.mark.parametrize("writing", [False, True], ids=["idle", "writing"])
async def test_where_no_loop_can_watch_a_port_the_transport_of_pyserial_does(
    terminal: Terminal,
    complaints: list[dict[str, Any]],
    monkeypatch: pytest.MonkeyPatch,
    writing: bool,
) -> None:
    """On Windows; elsewhere only here."""
    monkeypatch.setattr(transport, "_CAN_WATCH_PORTS", False)
    watch(complaints)
    for _ in range(2):
        link = await open_link(terminal.path)
        stop = terminal.answer_everything()
        assert await link.request(b"x") == b"ack of x"
        stop()
        await link.close()
    lost = asyncio.get_running_loop().create_future()
    link = await open_link(terminal.path, on_lost=lost.set_result)
    terminal.unplug()
    if writing:
        for _ in range(20):
            link.push(bytes(100))
    assert isinstance(await asyncio.wait_for(lost, PATIENCE), LinkLost)
    await link.close()
    gc.collect()
    assert complaints == []


async def test_closing_is_quick_may_be_repeated_and_frees_the_port(terminal: Terminal) -> None:
    begun = time.monotonic()
    for _ in range(20):
        link = await open_link(terminal.path)
        await asyncio.gather(link.close(), link.close())
        await link.close()
        with pytest.raises(LinkClosed):
            link.push(b"x")
    assert time.monotonic() - begun < 20 * CLOSE_TIMEOUT, "nothing was there to wait for"


async def test_what_was_written_before_closing_arrives(terminal: Terminal) -> None:
    link = await open_link(terminal.path, first_sequence=0)
    link.push(b"last words")
    await link.close()
    (frame,) = FrameDecoder().feed(os.read(terminal.master, 4096))
    assert frame.data == b"last words"


async def test_a_peer_that_does_not_drain_cannot_hang_the_link(terminal: Terminal) -> None:
    link = await open_link(terminal.path)
    begun = time.monotonic()
    for _ in range(100):
        for _ in range(10):
            link.push(bytes(500))
        await asyncio.sleep(0)
    await asyncio.sleep(0.1)
    statistics = link.statistics()
    assert link._transport is not None
    assert link._transport.get_write_buffer_size() < 4096
    assert statistics.dropped_writes > 900 - 64
    assert statistics.frames_sent + statistics.dropped_writes == 1000
    await link.close()
    assert time.monotonic() - begun < PATIENCE, "it hung"


async def test_a_line_that_drains_again_takes_pushes_again(terminal: Terminal) -> None:
    link = await open_link(terminal.path)
    await fill(link)
    async with asyncio.timeout(PATIENCE):
        while not link.push(b"fresh"):
            terminal.drain()
            await asyncio.sleep(0.001)
    while link.statistics().bytes_sent > terminal.drained:
        terminal.drain()
        await asyncio.sleep(0.001)
    await link.close()


@pytest.mark.parametrize("writing", [False, True], ids=["idle", "writing"])
async def test_unplugging_fails_every_request_long_before_its_time(
    terminal: Terminal, writing: bool, complaints: list[dict[str, Any]]
) -> None:
    watch(complaints)
    lost: list[LinkError] = []
    link = await open_link(terminal.path, on_lost=lost.append)
    tasks = [asyncio.ensure_future(link.request(b"x", timeout=1000)) for _ in range(35)]
    await asyncio.sleep(0.05)
    terminal.unplug()
    if writing:
        for _ in range(20):
            link.push(bytes(100))
    async with asyncio.timeout(PATIENCE):
        results = await asyncio.gather(*tasks, return_exceptions=True)
    assert {type(result) for result in results} == {LinkLost}
    assert all(isinstance(result, LinkLost) and result.__cause__ for result in results)
    assert [type(error) for error in lost] == [LinkLost]
    with pytest.raises(LinkLost):
        link.push(b"x")
    await link.close()
    gc.collect()
    await asyncio.sleep(0)
    assert complaints == []


async def test_unplugging_a_line_that_does_not_drain_is_noticed_too(
    terminal: Terminal, complaints: list[dict[str, Any]]
) -> None:
    watch(complaints)
    lost = asyncio.get_running_loop().create_future()
    link = await open_link(terminal.path, on_lost=lost.set_result)
    await fill(link)
    terminal.unplug()
    error = await asyncio.wait_for(lost, PATIENCE)
    assert isinstance(error, LinkLost)
    await link.close()
    assert complaints == []


async def test_unplugging_while_closing_is_no_trouble(
    terminal: Terminal, complaints: list[dict[str, Any]]
) -> None:
    watch(complaints)
    link = await open_link(terminal.path)
    await fill(link)
    closing = asyncio.ensure_future(link.close())
    await asyncio.sleep(0.05)
    terminal.unplug()
    async with asyncio.timeout(PATIENCE):
        await closing
    assert complaints == []


async def test_a_second_open_is_refused_and_names_the_first(terminal: Terminal) -> None:
    link = await open_link(terminal.path)
    with pytest.raises(PortBusy, match="is in use") as caught:
        await open_link(terminal.path)
    assert [pid for pid, _ in caught.value.owners] == [os.getpid()], "and nobody else"
    assert "by this program itself" in caught.value.seen
    await link.close()
    await (await open_link(terminal.path)).close()


async def test_opening_and_closing_leaks_no_files(terminal: Terminal) -> None:
    await (await open_link(terminal.path)).close()
    gc.collect()
    before = open_descriptors()
    for _ in range(20):
        await (await open_link(terminal.path)).close()
    gc.collect()
    assert open_descriptors() == before


async def test_a_cancelled_open_leaves_the_port_free(terminal: Terminal) -> None:
    for delay in (0.0, 0.0001, 0.001, 0.01):
        task = asyncio.ensure_future(open_link(terminal.path))
        await asyncio.sleep(delay)
        task.cancel()
        try:
            link: Link | None = await task
        except asyncio.CancelledError:
            link = None
        if link is not None:
            await link.close()
        await asyncio.sleep(0.05)
        await (await open_link(terminal.path)).close()


@pytest.mark.parametrize("seconds", [0.0, 0.02])
async def test_an_open_that_was_cancelled_has_let_go_of_the_port(
    terminal: Terminal, monkeypatch: pytest.MonkeyPatch, seconds: float
) -> None:
    """However long the thread takes that opens, and whenever the cancellation comes."""
    opened: list[serial.Serial] = []

    class SlowPort(serial.Serial):
        def open(self) -> None:
            time.sleep(seconds)
            super().open()
            opened.append(self)

    monkeypatch.setattr(serial, "Serial", SlowPort)
    for number in range(20):
        task = asyncio.ensure_future(open_link(terminal.path))
        for _ in range(number % 5):
            await asyncio.sleep(0)
        await asyncio.sleep(seconds * number / 20)
        task.cancel()
        try:
            await (await task).close()
        except asyncio.CancelledError:
            assert not any(port.is_open for port in opened)
        await (await open_link(terminal.path)).close()
        opened.clear()


async def test_a_second_cancellation_does_not_wait_for_the_port(
    terminal: Terminal, monkeypatch: pytest.MonkeyPatch
) -> None:
    may_open = threading.Event()
    opened: list[serial.Serial] = []

    class StuckPort(serial.Serial):
        def open(self) -> None:
            may_open.wait()
            super().open()
            opened.append(self)

    monkeypatch.setattr(serial, "Serial", StuckPort)
    task = asyncio.ensure_future(open_link(terminal.path))
    try:
        await asyncio.sleep(0.01)
        task.cancel()
        await asyncio.sleep(0.01)
        assert not task.done()
        task.cancel()
        with pytest.raises(asyncio.CancelledError):
            await task
    finally:
        may_open.set()  # or the thread would keep the program from ending
    await until(lambda: bool(opened) and not opened[0].is_open)


async def test_unplugging_at_any_moment_ends_the_link_and_leaves_nothing(
    complaints: list[dict[str, Any]],
) -> None:
    """Amid requests, pushes, junk from the line, a line that takes nothing, and a close."""
    watch(complaints)
    dice = random.Random(10)
    before = open_descriptors()
    for _ in range(60):
        terminal = Terminal()
        lost: list[LinkError] = []
        link = await open_link(terminal.path, on_lost=lost.append)
        stop = terminal.answer_everything() if dice.random() < 0.6 else None
        os.write(terminal.master, dice.randbytes(dice.randrange(1, 4000)))
        tasks = [asyncio.create_task(link.request(b"x", timeout=1000)) for _ in range(5)]
        for _ in range(dice.randrange(30)):
            link.push(dice.randbytes(dice.randrange(1, 900)))
            await asyncio.sleep(0)
        closing = asyncio.create_task(link.close()) if dice.random() < 0.3 else None
        await asyncio.sleep(dice.choice((0.0, 0.001, 0.003)))
        if stop is not None:
            stop()
        terminal.unplug()
        async with asyncio.timeout(PATIENCE):
            results = await asyncio.gather(*tasks, return_exceptions=True)
            await (closing or link.close())
        assert {type(result) for result in results} <= {bytes, LinkLost, LinkClosed}
        assert len(lost) == 1
        terminal.close()
    gc.collect()
    await asyncio.sleep(0)
    assert open_descriptors() == before
    assert complaints == []
