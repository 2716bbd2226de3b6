"""Programs reach a virtual aircraft by TCP, as through a serial server."""

from __future__ import annotations

import asyncio
import contextlib

from m100link.sim.ports.driver import Driver, StreamPort

__all__ = ["TcpServer", "serve_tcp", "stop_listening"]


async def stop_listening(server: asyncio.Server) -> None:
    """Close a listening server without losing a connection on the way in.

    A connection that the event loop has accepted, but not yet made a transport for, would be left
    open by closing the server (CPython 3.11: an assertion fails inside the transport). So nothing
    new is accepted first, then what was accepted gets its transport, then the server is closed.
    """
    loop = asyncio.get_running_loop()
    for listening in server.sockets:
        loop.remove_reader(listening.fileno())
    for _ in range(3):
        await asyncio.sleep(0)
    server.close()


class TcpServer:
    """Listens for one aircraft, like a serial server: a new connection replaces the last."""

    def __init__(self, driver: Driver) -> None:
        self._driver = driver
        self._server: asyncio.Server | None = None
        self._current: StreamPort | None = None
        self.port = 0

    async def start(self, host: str, port: int) -> None:
        """Listen; port 0 chooses a free one (see ``port``)."""
        self._server = await self._driver.loop.create_server(self._make_port, host, port)
        self.port = self._server.sockets[0].getsockname()[1]
        self._driver.start()

    def _make_port(self) -> StreamPort:
        if self._current is not None:
            self._current.close()
        self._current = StreamPort(self._driver)
        return self._current

    async def stop(self) -> None:
        """Stop listening and hang up."""
        if self._server is not None:
            await stop_listening(self._server)
            if self._current is not None:
                self._current.close()
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(1.0):
                    await self._server.wait_closed()
            self._server = None


async def serve_tcp(driver: Driver, host: str = "127.0.0.1", port: int = 0) -> TcpServer:
    """Let programs reach an aircraft by ``tcp://host:port``."""
    server = TcpServer(driver)
    await server.start(host, port)
    return server
