"""The aircraft without ``await``. Written by ``nox -s sync``: do not edit.

It has the one with ``await`` and hands every call to the thread in which that lives.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from os import PathLike
from types import TracebackType
from typing import Any, Self, TypeVar

from m100link import aircraft as aio
from m100link.aircraft.activation import ActivationProgress
from m100link.aircraft.aircraft import AuthorityEvent, ConnectionEvent
from m100link.aircraft.connecting import Recording
from m100link.errors import CommandRefused, LinkError
from m100link.flight.authority import Authority
from m100link.flight.block import PauseAction
from m100link.flight.guards import Guards
from m100link.flight.mission_state import MissionState
from m100link.flight.stop_path import StopAction
from m100link.link.link import Link
from m100link.link.statistics import LinkStatistics, Tap
from m100link.missions.plan import WaypointPlan
from m100link.protocol.command import Request
from m100link.protocol.commands.activation import Credentials, Version
from m100link.protocol.firmware import FirmwareProfile
from m100link.protocol.records import AccelerationMode
from m100link.sim.ports.driver import clock_of
from m100link.sync.control import Control
from m100link.sync.payload import AircraftCamera, AircraftGimbal
from m100link.sync.portal import Portal
from m100link.sync.signals import SIGNALS
from m100link.sync.subscription import Subscription
from m100link.telemetry.columns import Table
from m100link.telemetry.device_clock import DeviceClock
from m100link.telemetry.sample import Sample
from m100link.telemetry.state import AircraftState
from m100link.telemetry.subscription import Policy

__all__ = ["Aircraft", "connect"]

A = TypeVar("A")


class Aircraft:
    """A connected aircraft without ``await``. Get one from :func:`connect`.

    It lives in a thread of its own: telemetry is taken, setpoints are repeated and expire, and the
    stop path runs whatever the thread that called does meanwhile. May be used by several threads.
    """

    def __init__(self, portal: Portal, aircraft: aio.Aircraft) -> None:
        self._portal = portal
        self._aircraft = aircraft
        self.gimbal = AircraftGimbal(portal, aircraft.gimbal)
        self.camera = AircraftCamera(portal, aircraft.camera)
        SIGNALS.connected(portal)
        self.close = portal.close_after(aircraft.aclose, partial(SIGNALS.closed, portal))
        """End the control block that runs, then close the line. May be called again."""

    def __repr__(self) -> str:
        return repr(self._aircraft)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        exc_type: type[BaseException] | None,
        exc: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.close()

    @property
    def authority(self) -> Authority:
        """The state of control authority, as far as this program knows."""
        return self._aircraft.authority

    @property
    def is_connected(self) -> bool:
        """Whether the line is open; that it is silent is for :attr:`state` to tell."""
        return self._aircraft.is_connected

    def wait_closed(self) -> LinkError | None:
        """Wait until the line is gone, however long that takes.

        Returns:
            Why: :class:`LinkLost`, or :class:`LinkClosed` when the program closed it.
        """
        return self._portal.wait(lambda _: self._aircraft.wait_closed())

    def events(
        self, *, timeout: float | None = None
    ) -> Subscription[ConnectionEvent | AuthorityEvent]:
        """Events of the connection and of control authority from here on, as they happen.

        ::

            with aircraft.events() as events:
                for event in events:
                    print(event)

        Raises (while iterating):
            LinkLost, LinkClosed: The line is gone; a :class:`ConnectionEvent` comes first.

        Iterating waits up to ``timeout`` seconds for a value; None: for ever.
        """
        subscription = self._portal.call(self._aircraft.events)
        return Subscription(self._portal, subscription, timeout)

    def statistics(self) -> LinkStatistics:
        """Counters of the link."""
        return self._portal.call(self._aircraft.statistics)

    @property
    def firmware(self) -> FirmwareProfile:
        """The firmware profile in use."""
        return self._aircraft.firmware

    @property
    def is_activated(self) -> bool:
        """Whether this program activated the aircraft, and so has its key in use."""
        return self._aircraft.is_activated

    def version(self) -> Version:
        """Ask for the version (document 2.2.1.1). Needs no activation.

        It chooses the firmware profile, unless one is forced or a control block is flying.

        Raises:
            AckTimeout, LinkError, BadAck: See each class.
        """
        return self._portal.wait(lambda _: self._aircraft.version())

    def activate(
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
        return self._portal.wait(
            lambda caller: self._aircraft.activate(
                credentials, timeout=timeout, progress=caller.callback(progress)
            )
        )

    def use_key(self, credentials: Credentials) -> None:
        """Encrypt with this key without activating: for a second program on an active aircraft."""
        return self._portal.call(self._aircraft.use_key, credentials)

    def execute(
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
        return self._portal.wait(
            lambda _: self._aircraft.execute(
                request, timeout=timeout, tries=tries, encrypted=encrypted, refusal=refusal
            )
        )

    def control(
        self,
        *,
        stop: StopAction = "hover",
        on_pause: PauseAction = "raise",
        guards: Guards | None = None,
        handle_signals: bool = True,
        guardian: bool | float = True,
    ) -> Control:
        """Control authority for a block: ``with aircraft.control() as control``.

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
        return Control(
            self._portal,
            self._portal.call(
                self._aircraft.control,
                stop=stop,
                on_pause=on_pause,
                guards=guards,
                handle_signals=handle_signals,
                guardian=guardian,
            ),
            handle_signals=handle_signals,
        )

    def release_authority(self) -> bool:
        """Give control authority back that an earlier program left; a control block does it itself.

        The aircraft hovers and the pilot flies on. A failure is logged, not raised.

        Returns:
            Whether the aircraft said that it has it back.
        """
        return self._portal.wait(lambda _: self._aircraft.release_authority())

    def set_telemetry_rates(self, **rates_hz: int) -> dict[str, float]:
        """Set how often telemetry items are sent, and see that they are. Firmware 3.1.

        It takes 1.5 s, in which arriving items are counted; 3.5 s with a rate of 1 Hz.

        ::

            aircraft.set_telemetry_rates(attitude=50, battery=1)

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
        return self._portal.wait(lambda _: self._aircraft.set_telemetry_rates(**rates_hz))

    @property
    def mission(self) -> MissionState:
        """The mission that flies, also one that a phone or a program that is gone has started.

        As its pushes tell, firmware 3.1; the box "Ground Station Status" must be ticked in the PC
        assistant.
        """
        return self._aircraft.mission

    def download_waypoint_plan(self) -> WaypointPlan:
        """Read back the waypoint mission that the aircraft has stored, also one from a phone.

        Firmware 3.1. Behind the end of a mission there is none.

        Raises:
            MissionRefused: There is none (code 0xEA), or the aircraft's reason.
            BadPlan: The stored mission is no plan that could be uploaded.
            CommandNotSupported, NotActivated, AckTimeout, LinkError: See each class.
        """
        return self._portal.wait(lambda _: self._aircraft.download_waypoint_plan())

    def telemetry(
        self,
        *records: type[Any],
        policy: Policy | None = None,
        rate_hz: float | None = None,
        timeout: float | None = None,
    ) -> Subscription[Sample]:
        """Subscribe: ``with aircraft.telemetry(Attitude) as samples:``, then iterate.

        Args:
            records: Record classes; packages with none of them are left out. None at all: every
                package.
            policy: ``Latest()`` by default, ``Newest(n)`` or ``Lossless(n)``.
            rate_hz: At most so many samples per second.
            timeout: Seconds that iterating waits for a value; None: for ever.

        Raises (while iterating):
            LinkLost, LinkClosed: The line is gone; queued samples come first.
            TelemetryOverflow: A ``Lossless`` consumer fell behind.
        """
        subscription = self._portal.call(
            self._aircraft.telemetry, *records, policy=policy, rate_hz=rate_hz
        )
        return Subscription(self._portal, subscription, timeout)

    def collect(self, *records: type[Any], seconds: float, rate_hz: float | None = None) -> Table:
        """Take a row of numbers from every package with one of these records, for so long.

        Args:
            records: As in :meth:`telemetry`; they are the columns.
            seconds: How long, above 0. All rows are kept in memory.
            rate_hz: At most so many rows per second.

        Raises:
            TelemetryStalled, TelemetryOverflow: Nothing came; the program was blocked too long.
            UsageError, LinkLost, LinkClosed: See each class; no rows are handed out.
        """
        return self._portal.wait(
            lambda _: self._aircraft.collect(*records, seconds=seconds, rate_hz=rate_hz)
        )

    @property
    def utc_offset_s(self) -> float:
        """UTC (POSIX time, s) minus the event loop's time, taken when this connected."""
        return self._aircraft.utc_offset_s

    @property
    def state(self) -> AircraftState:
        """Newest value and age of every telemetry item."""
        return self._aircraft.state

    @property
    def telemetry_mismatches(self) -> int:
        """Telemetry packages refused because they do not fit the firmware profile."""
        return self._aircraft.telemetry_mismatches

    @property
    def acceleration_mode(self) -> AccelerationMode | None:
        """Raw or fused, as the aircraft sends acceleration: :attr:`state` has it fused.

        None while it is not known: then :attr:`state` has none. One second at rest shows it.
        """
        return self._aircraft.acceleration_mode

    @property
    def device_clock(self) -> DeviceClock:
        """Relates the aircraft's tick to this computer's time, with offset, skew, uncertainty."""
        return self._aircraft.device_clock

    def wait_for(
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
        return self._portal.wait(
            lambda _: self._aircraft.wait_for(predicate, timeout=timeout, what=what)
        )

    def send_to_mobile(self, data: bytes) -> None:
        """Send 1 to 100 bytes to the app on the mobile device (document 2.2.1.3).

        Raises:
            PayloadTooLarge, UsageError: Too many bytes, or none.
            NotActivated, AckTimeout, LinkError: See each class.
        """
        return self._portal.wait(lambda _: self._aircraft.send_to_mobile(data))

    def from_mobile(
        self, *, policy: Policy | None = None, timeout: float | None = None
    ) -> Subscription[bytes]:
        """Data from the app on the mobile device, 1 to 100 bytes each (document 2.2.3.3).

        Iterating waits up to ``timeout`` seconds for a value; None: for ever.
        """
        subscription = self._portal.call(self._aircraft.from_mobile, policy=policy)
        return Subscription(self._portal, subscription, timeout)


def connect(
    line: str | Link,
    *,
    firmware: str | FirmwareProfile | None = None,
    baud_rate: int | None = None,
    timeout: float | None = None,
    tap: Tap | None = None,
    record: str | PathLike[str] | Recording | None = None,
    acceleration: str | None = None,
) -> Aircraft:
    """Connect to an aircraft for the time of a block.

    ::

        with m100link.sync.connect("serial:///dev/ttyUSB0:230400") as aircraft:
            print(aircraft.version())

    At a prompt, or in a service, ``aircraft = m100link.sync.connect(...)`` connects until
    :meth:`Aircraft.close`.

    Args:
        line: ``serial:///dev/ttyUSB0:230400``, a bare device path, ``tcp://host:port``, ``sim://``,
            ``replay://flight.mcap`` for a recorded flight, or a link that is open already.
        firmware: Force a profile by name; by default the version answer chooses it.
        baud_rate: Rate when the URL has none; 230400 by default.
        timeout: Seconds until an aircraft has to answer. By default 15 if it is heard within 3 s,
            by a network within 8 s: the line may be slow.
        tap: Called with the bytes of every read and write, which way they went and when, on the
            event loop's clock: see :data:`m100link.link.Tap`. The activation carries the app id in
            clear.
        record: File for a flight log, or a folder for one that is named by the time; or a
            :class:`m100link.log.Recorder`. Needs the extra ``log``.
        acceleration: ``"raw"`` or ``"fused"``, as the PC assistant is set; by default one second at
            rest shows it. Telemetry has it fused in both cases: see :class:`AccelerationMode`.

    Raises:
        BadURL, UsageError: A wrong string or profile name; a tap on a link.
        PortNotFound, PortPermissionDenied, PortBusy, PortFailed: The port cannot be opened.
        SilentLine, NoValidFrame, NoAnswer: It can, but no aircraft answers; each names the cause.
    """
    portal = Portal(clock_of(line))
    try:
        aircraft = portal.wait(
            lambda _: _connected(
                aio.connect(
                    line,
                    firmware=firmware,
                    baud_rate=baud_rate,
                    timeout=timeout,
                    tap=tap,
                    record=record,
                    acceleration=acceleration,
                )
            )
        )
    except BaseException:
        portal.close()
        raise
    return Aircraft(portal, aircraft)


async def _connected(connecting: aio.Connecting) -> aio.Aircraft:
    return await connecting
