"""The line to the aircraft: opened, watched, and opened again when it was lost."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from enum import Enum

from m100link.agent.journal import Journal
from m100link.aircraft import Aircraft
from m100link.errors import LinkError, M100Error
from m100link.protocol.commands.activation import Version
from m100link.telemetry.sample import Sample
from m100link.telemetry.subscription import Newest

__all__ = ["Connect", "Connection", "ConnectionState"]

RECONNECT_PAUSE = 1.0
"""Seconds between two attempts to open the line."""

ROUND_TRIP_INTERVAL = 2.0
"""Seconds between two measurements of the way to the aircraft and back."""

Connect = Callable[[], Awaitable[Aircraft]]
"""Opens the aircraft; raises :class:`M100Error` when it cannot."""


class ConnectionState(Enum):
    """State of the line."""

    CONNECTING = "connecting"  # being opened, for the first time or again
    CONNECTED = "connected"  # the aircraft answered
    LOST = "lost"  # it was connected; the next attempt comes after a pause


class Connection:
    """Keeps an aircraft connected.

    Args:
        connect: Opens the aircraft.
        journal: Where it is told what happens.

    Attributes:
        aircraft: The aircraft while it is connected, else None.
        state: State of the line.
        version: What the connected aircraft answered last.
        error: Why it is not connected.
        round_trip: Seconds for a question to the aircraft and its answer, None when unanswered.
        on_aircraft: Called when the aircraft was connected, and with None when it was lost.
        on_sample: Called with each telemetry package.
    """

    def __init__(self, connect: Connect, journal: Journal) -> None:
        self._connect = connect
        self._journal = journal
        self._clock = asyncio.get_running_loop().time
        self.aircraft: Aircraft | None = None
        self.state = ConnectionState.CONNECTING
        self.version: Version | None = None
        self.error: M100Error | None = None
        self.round_trip: float | None = None
        self.on_aircraft: list[Callable[[Aircraft | None], None]] = []
        self.on_sample: list[Callable[[Sample], None]] = []

    async def keep(self) -> None:
        """Open the line again and again, until cancelled."""
        while True:
            self.state = ConnectionState.CONNECTING
            try:
                aircraft = await self._connect()
            except M100Error as error:
                is_news = str(error) != str(self.error)
                self.error = error
                if is_news:
                    self._journal.note(f"not connected: {error.seen}", "warning")
            else:
                await self._watch(aircraft)
            await asyncio.sleep(RECONNECT_PAUSE)

    async def _watch(self, aircraft: Aircraft) -> None:
        try:
            version = await aircraft.version()
            self.aircraft, self.version, self.error = aircraft, version, None
            self.state = ConnectionState.CONNECTED
            self._journal.note(
                f"connected to {aircraft.link.name}: {version.name} ({aircraft.firmware})"
            )
            self._tell_aircraft(aircraft)
            async with aircraft.telemetry(policy=Newest(50)) as samples:
                async for sample in samples:
                    for callback in self.on_sample:
                        callback(sample)
        except M100Error as error:
            self.error = error
        finally:
            self.state = ConnectionState.LOST
            self.aircraft, self.round_trip = None, None
            if self.error is not None:
                self._journal.note(f"connection lost: {self.error.seen}", "error")
            self._tell_aircraft(None)
            await aircraft.aclose()

    def _tell_aircraft(self, aircraft: Aircraft | None) -> None:
        for callback in self.on_aircraft:
            callback(aircraft)

    async def measure(self) -> None:
        """Measure the round trip again and again, until cancelled."""
        while True:
            await asyncio.sleep(ROUND_TRIP_INTERVAL)
            aircraft = self.aircraft
            if aircraft is None:
                continue
            asked_at = self._clock()
            try:
                self.version = await aircraft.version()
                self.round_trip = self._clock() - asked_at
            except M100Error:
                self.round_trip = None

    def require_aircraft(self) -> Aircraft:
        """The aircraft.

        Raises:
            LinkError: It is not connected; the error says why.
        """
        if self.aircraft is None:
            why = f": {self.error.seen}" if self.error else ""
            raise LinkError(
                f"the aircraft is not connected{why}",
                remedy=self.error.remedy if self.error else "",
            )
        return self.aircraft
