"""The API with ``await``: :class:`Aircraft`."""

from __future__ import annotations

import asyncio
import logging
from collections import deque
from collections.abc import Awaitable, Callable, Iterable
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

from m100link.aircraft.activation import ActivationProgress, activate
from m100link.aircraft.payload import AircraftCamera, AircraftGimbal
from m100link.aircraft.rates import set_telemetry_rates
from m100link.errors import CommandRefused, LinkError, LinkLost, LossReason, UsageError
from m100link.errors.base import of_the_system
from m100link.flight.authority import Authority, AuthorityInput, AuthorityState
from m100link.flight.handover import release_authority
from m100link.flight.lifecycle import BlockClaim
from m100link.flight.mission_state import MissionState, MissionWatch
from m100link.flight.tasks import Commander, SettingsPace, task_sequences
from m100link.link import Link, LinkStatistics
from m100link.link.requests import Requests
from m100link.protocol.command import Address, Push, Request
from m100link.protocol.commands.activation import Credentials, SendToMobile, Version
from m100link.protocol.commands.monitor import AuthorityChanged, FromMobile
from m100link.protocol.firmware import FirmwareProfile
from m100link.protocol.records import AccelerationMode
from m100link.telemetry.columns import Columns, Table
from m100link.telemetry.device_clock import DeviceClock
from m100link.telemetry.notifications import Notifications
from m100link.telemetry.sample import AccelerationReader, Sample
from m100link.telemetry.state import AircraftState
from m100link.telemetry.subscription import (
    Hub,
    Latest,
    Lossless,
    Newest,
    Policy,
    Subscription,
    TelemetryStream,
)
from m100link.wire.cipher import Cipher

if TYPE_CHECKING:
    from m100link.flight.block import PauseAction
    from m100link.flight.control import Control
    from m100link.flight.guards import Guards
    from m100link.flight.stop_path import StopAction
    from m100link.flight.virtual_rc import VirtualRc
    from m100link.missions.plan import WaypointPlan


_logger = logging.getLogger(__name__)


# -- events of a connection and of control authority -----------------------------------------------


class ConnectionEvent(NamedTuple):
    """Something happened to the connection."""

    is_connected: bool  #: Whether the line is open now.
    error: LinkError | None  #: Why it is not; None while it is.


class AuthorityEvent(NamedTuple):
    """Control authority passed from one state to another."""

    before: AuthorityState  #: State before.
    after: AuthorityState  #: State now.
    reason: LossReason  #: Why it was lost or paused.


# -- aircraft --------------------------------------------------------------------------------------

A = TypeVar("A")

# The modules that fly are loaded when a program asks for control, before it has any: a program that
# listens needs none of them. Addresses stand for missions until the aircraft reports one.
ENDS_S = 0.05  # the log of a lost line takes notes for so long
_MOST_NOTES = 500  # that wait for the log
_MISSION_STATUS, _WAYPOINT_EVENT = Address(0x02, 0x03), Address(0x02, 0x04)


class Aircraft:
    """A connected aircraft. Get one from :func:`connect`.

    Args:
        link: The line, open.
        firmware: Profile that the version answer does not change.
        acceleration: Mode of acceleration that telemetry does not change.

    Attributes:
        link: The line.
        authority: State of control authority, as far as this program knows.
        gimbal, camera: The payload below; they need no control authority.
    """

    def __init__(
        self,
        link: Link,
        *,
        firmware: FirmwareProfile | None = None,
        acceleration: AccelerationMode | None = None,
    ) -> None:
        self._requests = Requests(link, firmware)  # not public: by it, movement could leave
        self.authority = Authority(link.clock)
        reader = AccelerationReader(acceleration)
        self._telemetry = TelemetryStream(self.authority.observe, link.clock, reader)
        self._from_mobile: Hub[bytes] = Hub()
        self._events: Hub[ConnectionEvent | AuthorityEvent] = Hub()
        self._claim = BlockClaim()
        self._rc_settings = SettingsPace(link.loop.time)
        self.gimbal = AircraftGimbal(self._requests, self._telemetry)
        self.camera = AircraftCamera(self._requests)
        self.link = link
        self._notes: deque[dict[str, Any]] = deque(maxlen=_MOST_NOTES)  # that wait for the log
        self._noters: list[Callable[[], Iterable[dict[str, Any]]]] = [self._take_notes]
        self._at_end: list[Callable[[], Awaitable[None]]] = []  # such as of a log, after the line
        self.authority.subscribe(self._on_authority)
        self._missions = MissionWatch(link.clock)
        parts = link, self._requests, self.authority, self.state
        self._commander = Commander(*parts, self._missions, task_sequences())
        notifications = Notifications(link, self._requests, self._telemetry.receive)
        notifications.subscribe(AuthorityChanged, self._on_authority_changed)
        notifications.subscribe(FromMobile, self._on_from_mobile)
        notifications.subscribe_at(_MISSION_STATUS, self._missions.on_status)
        notifications.subscribe_at(_WAYPOINT_EVENT, self._missions.on_event)
        link.on_lost = self._on_lost

    def __repr__(self) -> str:
        if self.link.failure is not None:
            return f"<Aircraft {self.link.name}, gone: {self.link.failure.seen}>"
        age = self.state.newest_age
        telemetry = "no telemetry" if age is None else f"telemetry {age:.2f} s old"
        return (
            f"<Aircraft {self.link.name}, firmware {self.firmware}, "
            f"authority {self.authority.state.value}, {telemetry}>"
        )

    # -- connection ------------------------------------------------------------------------------

    async def aclose(self) -> None:
        """End the control block that runs, in whatever task, then close the line.

        Neutral and release take about 0.4 s, a landing that the block was to end with up to a
        minute and a half. May be called any number of times.
        """
        self.link.require_loop()
        try:
            await self._claim.close()
        finally:
            await self.link.close()
            try:
                if self._at_end and isinstance(self.link.failure, LinkLost):
                    # The program hears of it now, and its notes belong to the log of this line.
                    await asyncio.sleep(ENDS_S)
            finally:
                for end in self._at_end:
                    await end()

    @property
    def is_connected(self) -> bool:
        """Whether the line is open; that it is silent is for :attr:`state` to tell."""
        return self.link.is_open

    async def wait_closed(self) -> LinkError | None:
        """Wait until the line is gone, however long that takes.

        Returns:
            Why: :class:`LinkLost`, or :class:`LinkClosed` when the program closed it.
        """
        await self.link.wait_disconnected(timeout=None)
        return self.link.failure

    def events(self) -> Subscription[ConnectionEvent | AuthorityEvent]:
        """Events of the connection and of control authority from here on, as they happen.

        ::

            async with aircraft.events() as events:
                async for event in events:
                    print(event)

        Raises (while iterating):
            LinkLost, LinkClosed: The line is gone; a :class:`ConnectionEvent` comes first.
        """
        return self._events.subscribe(Newest(100))

    def statistics(self) -> LinkStatistics:
        """Counters of the link."""
        return self.link.statistics()

    def note(self, event: str, /, **values: Any) -> None:
        """Write an event of the program into the flight log; without a log this does nothing.

        It never waits. The log takes notes ten times a second; the newest 500 wait for it.

        Args:
            event: Its subject; ``authority`` and ``connection`` are the library's.
            values: More about it, as JSON takes it; anything else is written as text.
        """
        self._notes.append({"event": event, **values, "at": self.link.loop.time()})

    def note_from(self, take: Callable[[], Iterable[dict[str, Any]]]) -> None:
        """Let the flight log ask for notes ten times a second, for a program that has many.

        Each has its ``event``, and its time ``at``, s on the clock of the event loop.
        """
        self._noters.append(take)

    def _take_notes(self) -> Iterable[dict[str, Any]]:
        taken = list(self._notes)
        self._notes.clear()
        return taken

    # -- version and activation ------------------------------------------------------------------

    @property
    def firmware(self) -> FirmwareProfile:
        """The firmware profile in use."""
        return self._requests.firmware

    @property
    def is_activated(self) -> bool:
        """Whether this program activated the aircraft, and so has its key in use."""
        return self.link.cipher is not None

    async def version(self) -> Version:
        """Ask for the version (document 2.2.1.1). Needs no activation.

        It chooses the firmware profile, unless one is forced or a control block is flying.

        Raises:
            AckTimeout, LinkError, BadAck: See each class.
        """
        return await self._requests.query_version()

    async def activate(
        self,
        credentials: Credentials,
        *,
        timeout: float = 60.0,
        progress: Callable[[ActivationProgress], None] | None = None,
    ) -> Version:
        """Activate the aircraft for an app (document 2.2.1.2).

        Gets the version first, because the request depends on the firmware. "New device" means
        that the aircraft asks DJI's server: the attempt is repeated every two seconds. An
        aircraft that is active already answers with success. From then on commands of set 0x01
        are encrypted.

        Args:
            credentials: App id, key and level.
            timeout: Seconds for the whole of it.
            progress: Called after each attempt.

        Returns:
            The version of the aircraft.

        Raises:
            ActivationRefused: With code, cause and remedy.
            AckTimeout, LinkError: See each class.
        """
        return await activate(
            self._requests, self.link, credentials, timeout=timeout, progress=progress
        )

    def use_key(self, credentials: Credentials) -> None:
        """Encrypt with this key without activating: for a second program on an active aircraft."""
        self.link.cipher = Cipher(credentials.key, random_padding=True)

    # -- commands --------------------------------------------------------------------------------

    async def execute(
        self,
        request: Request[A],
        *,
        timeout: float = 0.5,
        tries: int = 3,
        encrypted: bool | None = None,
        refusal: type[CommandRefused] = CommandRefused,
    ) -> A:
        """Send any request and return what its ack says: see ``m100link.link.requests``.

        It stops and pauses a mission; a request that starts or resumes one needs a control block.

        Raises:
            UsageError: It would start or resume a mission, or is not a request.
        """
        if isinstance(request, Request) and request.sets_in_motion:
            raise UsageError(
                f"{request!r} sets the aircraft in motion; nothing was sent",
                remedy="fly missions in `async with aircraft.control()`",
            )
        return await self._requests.execute(
            request, timeout=timeout, tries=tries, encrypted=encrypted, refusal=refusal
        )

    def push(self, command: Push) -> bool:
        """Send any command without an ack. False when the line does not drain.

        Movement is not among them: it leaves through a control block alone.

        Raises:
            UsageError, CommandNotSupported: Not a push; unknown firmware, or one that lacks it.
            LinkError: The line is gone.
        """
        if not isinstance(command, Push):
            raise UsageError(
                f"{command!r} cannot be pushed",
                remedy="movement is sent in `async with aircraft.control()`; what has an ack is "
                "executed",
            )
        return self._requests.push(command)

    def control(
        self,
        *,
        stop: StopAction = "hover",
        on_pause: PauseAction = "raise",
        guards: Guards | None = None,
        handle_signals: bool = True,
        guardian: bool | float = True,
    ) -> Control:
        """Control authority for a block: ``async with aircraft.control() as control``.

        Args:
            stop: Action when the block ends in any way: ``"hover"`` or ``"land"``.
            on_pause: When the pilot takes the aircraft: ``"raise"`` AuthorityLost, or ``"wait"``,
                see :meth:`Control.wait_resumable`.
            guards: Safety guards; all on by default.
            handle_signals: Let signals that end programs take the stop path first.
            guardian: A process that ends the flight when this program cannot: it dies, or blocks
                its event loop for 2 s, or so many (0.5 to 60). None in memory, nor outside Linux.

        Raises (on entering):
            GuardianFailed: It cannot be started; authority was not requested.
            UsageError: Another control block of this program is running; the firmware is unknown.
            AuthorityRefused: With cause and remedy.
            NotActivated, KeyRejected, AckTimeout, OutOfResources, LinkError: See each class.
        """
        with of_the_system("control"):
            from m100link.flight.control import Control

        return Control(
            self._commander,
            self._claim,
            stop=stop,
            on_pause=on_pause,
            guards=guards,
            handle_signals=handle_signals,
            guardian=guardian,
        )

    def virtual_rc(
        self,
        *,
        fall_back: bool = True,
        guards: Guards | None = None,
        handle_signals: bool = True,
        guardian: bool | float = True,
    ) -> VirtualRc:
        """A remote control made of commands, for a block; it flies **without authority**.

        Firmware 3.1. Not beside a control block of this program. Read
        :class:`~m100link.flight.virtual_rc.VirtualRc` first.

        Args:
            fall_back: When the channels stop, the pilot's own remote control flies. False makes the
                aircraft act as if its remote control were lost, and go home.
            guards: Safety guards; all on by default.
            handle_signals: As for :meth:`control`.
            guardian: As for :meth:`control`.

        Raises (on entering):
            CommandNotSupported, NotActivated, GuardianFailed: Nothing was sent.
            AuthorityRefused: The pilot's mode switch is not seen in F.
            UsageError: A control block of this program is running; the firmware is unknown.
            NotObserved, TelemetryStalled, LinkError: Telemetry does not show it on; the line ended.
        """
        with of_the_system("virtual RC"):
            from m100link.flight.virtual_rc import VirtualRc

        return VirtualRc(
            self._commander,
            self._claim,
            self._rc_settings,
            fall_back=fall_back,
            guards=guards,
            handle_signals=handle_signals,
            guardian=guardian,
        )

    async def release_authority(self) -> bool:
        """Give control authority back that an earlier program left; a control block does it itself.

        The aircraft hovers and the pilot flies on. A failure is logged, not raised.

        Returns:
            Whether the aircraft said that it has it back.
        """
        self.link.require_loop()
        return await release_authority(self._commander)

    async def set_telemetry_rates(self, /, **rates_hz: int) -> dict[str, float]:
        """Set how often telemetry items are sent, and see that they are. Firmware 3.1.

        It takes 1.5 s, in which arriving items are counted; 3.5 s with a rate of 1 Hz.

        ::

            await aircraft.set_telemetry_rates(attitude=50, battery=1)

        Before 3.1 rates are set in the PC assistant. It works before activation; the aircraft
        forgets them when it is switched off. The items that the guards of a control block need
        (position, attitude, battery, flight status) should stay at 1 Hz or more.

        Args:
            rates_hz: By item, named as in :attr:`state` or as in ``m100link hz``: 0, 1, 10, 50 or
                100 Hz. An item that is not named keeps its rate.

        Returns:
            The rates that were observed, Hz.

        Raises:
            UsageError: No such item, or not such a rate; nothing was sent.
            CommandNotSupported: The firmware is older; nothing was sent.
            CommandRefused, AckTimeout, LinkError: See each class.
            NotObserved: Accepted, but the items arrive at other rates.
        """
        return await set_telemetry_rates(self._requests, self.state, rates_hz)

    @property
    def mission(self) -> MissionState:
        """The mission that flies, also one that a phone or a program that is gone has started.

        As its pushes tell, firmware 3.1; the box "Ground Station Status" must be ticked in the PC
        assistant.
        """
        return self._missions.state

    async def download_waypoint_plan(self) -> WaypointPlan:
        """Read back the waypoint mission that the aircraft has stored, also one from a phone.

        Firmware 3.1. Behind the end of a mission there is none.

        Raises:
            MissionRefused: There is none (code 0xEA), or the aircraft's reason.
            BadPlan: The stored mission is no plan that could be uploaded.
            CommandNotSupported, NotActivated, AckTimeout, LinkError: See each class.
        """
        from m100link.flight.missions.waypoint import download_waypoint_plan

        return await download_waypoint_plan(self._requests)

    # -- telemetry and mobile data ---------------------------------------------------------------

    def telemetry(
        self, *records: type[Any], policy: Policy | None = None, rate_hz: float | None = None
    ) -> Subscription[Sample]:
        """Subscribe: ``async with aircraft.telemetry(Attitude) as samples:``, then iterate.

        Args:
            records: Record classes; packages with none of them are left out. None at all: every
                package.
            policy: ``Latest()`` by default, ``Newest(n)`` or ``Lossless(n)``.
            rate_hz: At most so many samples per second.

        Raises (while iterating):
            LinkLost, LinkClosed: The line is gone; queued samples come first.
            TelemetryOverflow: A ``Lossless`` consumer fell behind.
        """
        return self._telemetry.subscribe(records, policy or Latest(), rate_hz)

    async def collect(
        self, *records: type[Any], seconds: float, rate_hz: float | None = None
    ) -> Table:
        """Take a row of numbers from every package with one of these records, for so long.

        Args:
            records: As in :meth:`telemetry`; they are the columns.
            seconds: How long, above 0. All rows are kept in memory.
            rate_hz: At most so many rows per second.

        Raises:
            TelemetryStalled, TelemetryOverflow: Nothing came; the program was blocked too long.
            UsageError, LinkLost, LinkClosed: See each class; no rows are handed out.
        """
        columns = Columns(*records, utc_offset_s=self.utc_offset_s)
        samples = self.telemetry(*records, policy=Lossless(2000), rate_hz=rate_hz)
        return await columns.collect(samples, seconds, self.link.clock)

    @property
    def utc_offset_s(self) -> float:
        """UTC (POSIX time, s) minus the event loop's time, taken when this connected."""
        return self._telemetry.utc_offset_s

    @property
    def state(self) -> AircraftState:
        """Newest value and age of every telemetry item."""
        return self._telemetry.state

    @property
    def telemetry_mismatches(self) -> int:
        """Telemetry packages refused because they do not fit the firmware profile."""
        return self._telemetry.mismatches

    @property
    def acceleration_mode(self) -> AccelerationMode | None:
        """Raw or fused, as the aircraft sends acceleration: :attr:`state` has it fused.

        None while it is not known: then :attr:`state` has none. One second at rest shows it.
        """
        return self._telemetry.acceleration.mode

    @property
    def device_clock(self) -> DeviceClock:
        """Relates the aircraft's tick to this computer's time, with offset, skew, uncertainty."""
        return self._telemetry.clock_of(self.firmware)

    async def wait_for(
        self,
        predicate: Callable[[AircraftState], bool],
        *,
        timeout: float | None = None,
        what: str = "the condition",
    ) -> None:
        """Wait until the predicate of :attr:`state` is true; it is tried at every package.

        Raises:
            TelemetryStalled: It was not in time.
            LinkLost, LinkClosed: The line is gone.
        """
        await self._telemetry.wait_for(predicate, timeout, what)

    async def send_to_mobile(self, data: bytes) -> None:
        """Send 1 to 100 bytes to the app on the mobile device (document 2.2.1.3).

        Raises:
            PayloadTooLarge, UsageError: Too many bytes, or none.
            NotActivated, AckTimeout, LinkError: See each class.
        """
        code = await self.execute(SendToMobile(data), timeout=0.5, tries=2)
        if code:
            raise CommandRefused(
                f"the aircraft did not take the data: code 0x{code:04X}",
                command=SendToMobile.NAME,
                code=code,
            )

    def from_mobile(self, *, policy: Policy | None = None) -> Subscription[bytes]:
        """Data from the app on the mobile device, 1 to 100 bytes each (document 2.2.3.3)."""
        return self._from_mobile.subscribe(policy or Newest(100))

    # -- what the link calls ---------------------------------------------------------------------

    def _on_authority_changed(self, notification: AuthorityChanged, now: float) -> None:
        _logger.info("the aircraft notifies that authority passed away")
        self.authority.feed(AuthorityInput.NOTIFIED)

    def _on_from_mobile(self, notification: FromMobile, now: float) -> None:
        self._from_mobile.publish(notification.data, now)

    def _on_lost(self, error: LinkError) -> None:
        self._telemetry.hub.fail(error)
        self._from_mobile.fail(error)
        self.authority.feed(AuthorityInput.LINK_LOST)
        self._events.publish(ConnectionEvent(is_connected=False, error=error), self.link.clock())
        self._events.fail(error)

    def _on_authority(self, before: AuthorityState, after: AuthorityState) -> None:
        event = AuthorityEvent(before, after, self.authority.reason)
        self._events.publish(event, self.link.clock())
