"""Clients on WebSockets that wait for the machine: the library gives up after 10 and 20 seconds."""

from __future__ import annotations

from typing import Any

from websockets.asyncio import client

from tests.waiting import PATIENCE


class connect(client.connect):  # noqa: N801 - as the library calls it
    """The same, with patience for a handshake; it answers pings and sends none."""

    def __init__(self, uri: str, **options: Any) -> None:
        super().__init__(uri, **{"open_timeout": PATIENCE, "ping_interval": None} | options)
