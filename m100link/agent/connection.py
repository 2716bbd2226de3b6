"""The line to the aircraft: opened, watched, and opened again when it was lost."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from enum import Enum

from m100link.agent.journal import Journal
from m100link.aircraft import Aircraft
from m100link.errors import LinkError, M100Error
from m100link.protocol.commands.activation import Credentials

__all__ = ["Connect", "Connected", "Connection"]

RECONNECT_PAUSE = 1.0
"""Seconds between two attempts to open the line."""

ROUND_TRIP_INTERVAL = 2.0
"""Seconds between two measurements of the way to the aircraft and back."""

Connect = Callable[[], Awaitable[Aircraft]]
"""Opens the aircraft; raises :class:`M100Error` when it cannot."""


class Connection(Enum):
    """State of the line."""

    CONNECTING = "connecting"
    CONNECTED = "connected"
    LOST = "lost"


class Connected(Journal):
    """Keeps an aircraft connected.

    Args:
        connect: Opens the aircraft.
        credentials: What activation needs; without them the station can only watch.

    Attributes:
        aircraft: The aircraft while it is connected, else None.
        connection: State of the line.
        connection_error: Why it is not connected.
        round_trip: Seconds for a question to the aircraft and its answer, None when unanswered.
        on_aircraft: Called when the aircraft was connected, and with None when it was lost.
    """

    def __init__(self, connect: Connect, credentials: Credentials | None) -> None:
        super().__init__()
        self._connect = connect
        self.credentials = credentials
        self.aircraft: Aircraft | None = None
        self.connection = Connection.CONNECTING
        self.connection_error: M100Error | None = None
        self.round_trip: float | None = None
        self.on_aircraft: list[Callable[[Aircraft | None], None]] = []

    async def _keep_connected(self) -> None:
        while True:
            self.connection = Connection.CONNECTING
            try:
                aircraft = await self._connect()
            except M100Error as error:
                if str(error) != str(self.connection_error):
                    self.note(f"not connected: {error.seen}", "warning")
                self.connection_error = error
                await asyncio.sleep(RECONNECT_PAUSE)
                continue
            await self._stay_connected(aircraft)
            await asyncio.sleep(RECONNECT_PAUSE)

    async def _stay_connected(self, aircraft: Aircraft) -> None:
        try:
            version = await aircraft.version()
            self.aircraft, self.connection_error = aircraft, None
            self.connection = Connection.CONNECTED
            self.note(f"connected to {aircraft.link.name}: {version.name} ({aircraft.firmware})")
            if version.is_activated and self.credentials is not None:
                # As DJI's node does: an aircraft that is active needs no new activation.
                aircraft.use_key(self.credentials)
            self._tell_aircraft(aircraft)
            async with aircraft.telemetry() as samples:
                async for _ in samples:
                    pass
        except M100Error as error:
            self.connection_error = error
            self.note(f"connection lost: {error.seen}", "error")
        finally:
            self.connection = Connection.LOST
            self.aircraft, self.round_trip = None, None
            self._tell_aircraft(None)
            await aircraft.aclose()

    def _tell_aircraft(self, aircraft: Aircraft | None) -> None:
        for callback in self.on_aircraft:
            callback(aircraft)

    async def _measure(self) -> None:
        while True:
            await asyncio.sleep(ROUND_TRIP_INTERVAL)
            aircraft = self.aircraft
            if aircraft is None:
                continue
            asked_at = self.now
            try:
                await aircraft.version()
                self.round_trip = self.now - asked_at
            except M100Error:
                self.round_trip = None

    def require_aircraft(self) -> Aircraft:
        """The aircraft.

        Raises:
            LinkError: It is not connected; the error says why.
        """
        if self.aircraft is None:
            why = f": {self.connection_error.seen}" if self.connection_error else ""
            raise LinkError(
                f"the aircraft is not connected{why}",
                remedy=self.connection_error.remedy if self.connection_error else "",
            )
        return self.aircraft
