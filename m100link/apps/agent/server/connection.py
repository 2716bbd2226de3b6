"""The line to the aircraft, kept by a supervision, and its changes for the agent."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from enum import Enum
from random import Random
from typing import TYPE_CHECKING

from m100link.aircraft import Aircraft, connect, supervising
from m100link.aircraft.connecting import be_recorded
from m100link.apps.agent.background import call_each, goes_on
from m100link.apps.agent.messages import Journal
from m100link.errors import LinkError, M100Error, PortNotFound
from m100link.flight.guards import Envelope
from m100link.link import Link
from m100link.link.statistics import TappedProtocol
from m100link.protocol.commands.activation import Version
from m100link.protocol.firmware import profile
from m100link.protocol.records import AccelerationMode
from m100link.telemetry.sample import Sample, acceleration_mode
from m100link.telemetry.subscription import Newest

if TYPE_CHECKING:
    from m100link.log.folder import Flights
    from m100link.log.recorder import Recorder
    from m100link.sim.ports.driver import Driver

RECONNECT_PAUSE = 1.0
"""Seconds between two attempts to open the line: somebody waits for it."""

_STEADY = supervising.BackOff(first=RECONNECT_PAUSE, factor=1.0, jitter=0.0)

Connect = Callable[[], Awaitable[Aircraft]]
"""Opens the aircraft; raises :class:`M100Error` when it cannot."""


class ConnectionState(Enum):
    CONNECTING = "connecting"  # being opened, for the first time or again
    CONNECTED = "connected"  # the aircraft answered
    LOST = "lost"  # it was connected; the next attempt comes after a pause


class AircraftConnection:
    def __init__(self, connect: Connect, journal: Journal) -> None:
        self._connect = connect
        self._journal = journal
        self._supervised = self._new()
        self.aircraft: Aircraft | None = None  # while it is connected
        self.state = ConnectionState.CONNECTING
        self.error: M100Error | None = None  # why it is not connected
        # Called when the aircraft was connected, and with None when it was lost.
        self.on_aircraft: list[Callable[[Aircraft | None], None]] = []
        self.on_sample: list[Callable[[Sample], None]] = []

    def _new(self) -> supervising.Supervised:
        return supervising.Supervised(
            self._connect, credentials=None, back_off=_STEADY, random=Random()
        )

    @property
    def version(self) -> Version | None:
        return self._supervised.version

    @property
    def round_trip(self) -> float | None:
        """Seconds for a question to the aircraft and its answer, None when unanswered."""
        return None if self.aircraft is None else self._supervised.round_trip

    async def keep(self) -> None:
        while True:
            with goes_on("the connection"):
                await self._keep_one()
            if (task := asyncio.current_task()) is not None and task.cancelling():
                return  # an error on the way out took the place of the cancellation
            await asyncio.sleep(RECONNECT_PAUSE)
            # A supervision ends when another aircraft answers. Nobody flies then, because a control
            # block ends with its line; the client that flew has to obtain control of the new one.
            self._supervised = self._new()

    async def _keep_one(self) -> None:
        try:
            async with self._supervised as one, asyncio.TaskGroup() as group:
                passing = group.create_task(self._pass_on(one))
                await self._follow(one)
                passing.cancel()
        finally:
            if self.aircraft is not None:
                self._lose(None)

    async def _follow(self, one: supervising.Supervised) -> None:
        async for event in one.events():
            self._take(event, one.aircraft)
            if event.after in supervising.ENDED:
                return

    def _take(self, event: supervising.SupervisionEvent, aircraft: Aircraft | None) -> None:
        if event.after is supervising.SupervisionState.CONNECTED:
            if aircraft is not None:  # it may be gone again by now
                self._gain(aircraft)
        elif event.before is supervising.SupervisionState.CONNECTED:
            self._lose(event.error)
        elif event.after is supervising.SupervisionState.CONNECTING:
            self.state = ConnectionState.CONNECTING
        elif event.error is not None:
            # An attempt fails each second: the same reason is one line of the journal.
            is_news = str(event.error) != str(self.error)
            self.error = event.error
            if is_news:
                self._journal.note(f"not connected: {event.error.seen}", "warning")

    async def _pass_on(self, one: supervising.Supervised) -> None:
        is_told = False
        try:
            async for sample in one.telemetry(policy=Newest(50)):
                if isinstance(sample, Sample):  # events report a gap and the end
                    with goes_on("the telling of telemetry"):
                        call_each(self.on_sample, sample)
                    here = self.aircraft
                    if not is_told and here and here.acceleration_mode is AccelerationMode.RAW:
                        is_told = True
                        self._journal.note("acceleration comes raw, and is shown without gravity")
        except M100Error:
            return

    def _gain(self, aircraft: Aircraft) -> None:
        self.aircraft, self.error = aircraft, None
        self.state = ConnectionState.CONNECTED
        version = self.version.name if self.version is not None else ""
        self._journal.note(f"connected to {aircraft.link.name}: {version} ({aircraft.firmware})")
        self._tell()

    def _lose(self, error: M100Error | None) -> None:
        self.aircraft, self.error = None, error or self.error
        self.state = ConnectionState.LOST
        if error is not None:
            self._journal.note(f"connection lost: {error.seen}", "error")
        self._tell()

    def _tell(self) -> None:
        with goes_on("the telling of the connection"):
            call_each(self.on_aircraft, self.aircraft)

    def require_aircraft(self) -> Aircraft:
        """The aircraft. Raises LinkError: it is not connected; the error says why."""
        if self.aircraft is None:
            why = f": {self.error.seen}" if self.error else ""
            raise LinkError(
                f"the aircraft is not connected{why}",
                remedy=self.error.remedy if self.error else "",
            )
        return self.aircraft


# -- how a station reaches its aircraft: by URL, or in memory when it brings its own -------------


def envelope_of(max_height: float, max_radius: float) -> Envelope:
    """The envelope of an agent: metres above the take-off point, and from where control began.

    Raises UsageError: one of them cannot be.
    """
    return Envelope(max_height_m=max_height, max_radius_m=max_radius)


def by_url(
    url: str,
    *,
    baud_rate: int | None = None,
    firmware: str | None = None,
    timeout: float | None = None,  # seconds until an aircraft has to answer
    flights: Flights | None = None,  # where connections are recorded
    acceleration: str | None = None,  # raw or fused; by default one second at rest shows it
) -> Connect:
    """Open a connection string. A profile or a mode that there is not is a UsageError at once."""
    forced = None if firmware is None else profile(firmware)
    acceleration_mode(acceleration)

    async def opened() -> Aircraft:
        async with _recording(flights) as log:
            return await connect(
                url,
                firmware=forced,
                baud_rate=baud_rate,
                timeout=timeout,
                record=log,
                acceleration=acceleration,
            )

    return opened


def by_driver(driver: Driver, *, flights: Flights | None = None) -> Connect:
    """Plug into a virtual aircraft of this process; it outlives the connection."""

    async def plugged_in() -> Aircraft:
        link = Link()
        async with _recording(flights) as log:
            try:
                driver.connect(link if log is None else TappedProtocol(link, log.tap, link.clock))
            except ConnectionRefusedError as error:
                raise PortNotFound(str(error), remedy="plug it in again") from error
            await link.wait_connected()
            link.name = "sim://"
            aircraft = await connect(link)
            if log is not None:
                be_recorded(aircraft, log)
            return aircraft

    return plugged_in


@asynccontextmanager
async def _recording(flights: Flights | None) -> AsyncIterator[Recorder | None]:
    """A log for what is connected meanwhile; attempts that fail leave none."""
    log = None if flights is None else await flights.begin()
    try:
        yield log
    except BaseException:
        if flights is not None and log is not None:
            await log.aclose()
            # In a thread: another aircraft may fly in this event loop, and a disk take its time.
            await asyncio.to_thread(flights.drop, log)
        raise
    if flights is not None and log is not None:
        flights.keep(log)
