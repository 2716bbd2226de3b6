"""Orders of the console's panel, in this process and through a socket."""

from __future__ import annotations

from pathlib import Path

import pytest

from m100link.apps.station.console.orders import (
    SimulatorOrders,
    orders_by_socket,
    orders_in_process,
)
from m100link.errors import M100Error
from m100link.sim.orders import CtlServer
from m100link.sim.virtual import VirtualAircraft

pytestmark = pytest.mark.anyio


@pytest.fixture
def anyio_backend() -> str:
    return "asyncio"


async def is_obeyed(orders: SimulatorOrders, virtual: VirtualAircraft) -> None:
    assert orders.status["rc_mode"] == "F"
    await orders.give("rc-mode P", "gps 2")
    assert virtual.remote.mode.name == "P"
    assert (orders.status["rc_mode"], orders.status["gps_health"]) == ("P", 2)
    with pytest.raises(M100Error, match="no action"):
        await orders.give("dance")
    await orders.give("rc-mode F")
    assert orders.status["rc_mode"] == "F"


async def test_in_this_process() -> None:
    virtual = VirtualAircraft(seed=5)
    await is_obeyed(orders_in_process(virtual), virtual)


async def test_through_a_socket(tmp_path: Path) -> None:
    virtual = VirtualAircraft(seed=5)
    server = CtlServer([virtual], tmp_path / "orders.sock")
    await server.start()
    try:
        await is_obeyed(await orders_by_socket(server.path), virtual)
    finally:
        await server.stop()
    with pytest.raises(M100Error):
        await orders_by_socket(tmp_path / "none.sock")
