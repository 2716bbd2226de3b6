"""The child of a fork has no part in the line, the event loop and the signals of its parent.

Flights beside such children are in ``flight/test_reserves.py``.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import signal
import socket
import sys
import warnings
from collections.abc import Callable

import pytest

from m100link import LinkClosed
from m100link.flight.cancellation import SIGNALS
from m100link.flight.pacing import DeadlineTimer
from m100link.link import open_link
from tests.waiting import PATIENCE

pytestmark = pytest.mark.pty


def in_a_child(do: Callable[[], bool]) -> bool:
    """What that returns in the child of a fork."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # of forks beside threads
        child = os.fork()
    if child == 0:
        is_so = False
        try:
            is_so = do()
        finally:
            os._exit(0 if is_so else 1)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0


@pytest.mark.skipif(sys.platform != "linux", reason="other systems inherit no selector")
def test_what_the_child_does_with_line_loop_and_timers_harms_nobody() -> None:
    async def main() -> None:
        loop = asyncio.get_running_loop()
        heard: list[bytes] = []
        is_heard = asyncio.Event()

        class Other(asyncio.Protocol):
            def connection_made(self, transport: asyncio.BaseTransport) -> None:
                others.append(transport)

            def data_received(self, data: bytes) -> None:
                heard.append(data)
                is_heard.set()

        others: list[asyncio.BaseTransport] = []
        server = await loop.create_server(Other, "127.0.0.1", 0)
        port = server.sockets[0].getsockname()[1]
        link = await open_link(f"tcp://127.0.0.1:{port}")
        sock = link._transport.get_extra_info("socket")  # type: ignore[union-attr] # it is open
        with DeadlineTimer() as alarm:

            def misuse() -> bool:
                os.write(sock.fileno(), b"of the child")
                loop.remove_reader(alarm._fd)
                with contextlib.suppress(OSError):
                    socket.socket(fileno=os.dup(sock.fileno())).shutdown(socket.SHUT_RDWR)
                link._transport.abort()  # type: ignore[union-attr] # it is open
                return isinstance(link.failure, LinkClosed)

            assert in_a_child(misuse)
            began_at = loop.time()
            async with asyncio.timeout(PATIENCE):
                await alarm.sleep_until(began_at + 0.05)
                assert link.is_open
                assert link.push(b"\x01\x03" + bytes(17))
                await is_heard.wait()
            assert b"of the child" not in b"".join(heard)
        await link.close()
        server.close()

    asyncio.run(main())


def test_the_child_of_a_flight_is_ended_by_signals_as_ever() -> None:
    async def main() -> None:
        SIGNALS.join(print)
        try:
            assert signal.getsignal(signal.SIGTERM) == SIGNALS._on_signal
            assert in_a_child(lambda: signal.getsignal(signal.SIGTERM) is signal.SIG_DFL)
            assert in_a_child(lambda: SIGNALS._blocks == {})
        finally:
            SIGNALS.leave(print)

    asyncio.run(main())
