"""What is recorded is what somebody else saw at the port, on real sockets."""

from __future__ import annotations

import asyncio
import contextlib
from pathlib import Path

import pytest

from m100link import connect
from m100link.errors import AckTimeout
from m100link.link import Direction
from m100link.log import read
from m100link.log.channels import RX, TX
from m100link.sim import Driver, VirtualAircraft
from m100link.sim.line import LineFaults
from m100link.sim.ports.driver import serve_tcp

pytestmark = pytest.mark.anyio


@pytest.fixture
def anyio_backend() -> str:
    return "asyncio"


async def test_an_outside_witness_at_the_port_saw_the_same_bytes(tmp_path: Path) -> None:
    """A proxy before the simulator's port, which knows nothing of m100link."""
    heard: dict[Direction, list[bytes]] = {one: [] for one in Direction}
    driver = Driver(VirtualAircraft(seed=11, faults=LineFaults(loss=0.05, damage=0.02)))
    server = await serve_tcp(driver)
    driver.start()

    async def carry(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        there, back = await asyncio.open_connection("127.0.0.1", server.port)

        async def one_way(
            from_: asyncio.StreamReader, to: asyncio.StreamWriter, way: Direction
        ) -> None:
            # Who closes first leaves the other with what is on its way to nobody.
            with contextlib.suppress(ConnectionError):
                while data := await from_.read(4096):
                    heard[way].append(data)
                    to.write(data)
                    await to.drain()
            to.close()

        await asyncio.gather(
            one_way(reader, back, Direction.SENT), one_way(there, writer, Direction.RECEIVED)
        )

    proxy = await asyncio.start_server(carry, "127.0.0.1", 0)
    port = proxy.sockets[0].getsockname()[1]
    path = tmp_path / "flight.mcap"
    async with connect(f"tcp://127.0.0.1:{port}", record=path) as aircraft:
        for _ in range(20):
            with contextlib.suppress(AckTimeout):
                await aircraft.version()
            await asyncio.sleep(0.05)
    proxy.close()
    driver.stop()
    await server.stop()
    for direction, topic in ((Direction.RECEIVED, RX), (Direction.SENT, TX)):
        joined = b"".join(message.data for message in read(path).messages(topic))
        outside = b"".join(heard[direction])
        assert len(joined) > 300
        # What was on its way when the line was closed was read by nobody here.
        assert outside.startswith(joined) if direction is Direction.RECEIVED else outside == joined
