"""What programs await: :func:`connect` and :class:`Aircraft`."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from dataclasses import dataclass
from typing import Any, TypeVar

from m100link.errors import (
    ActivationRefused,
    CommandRefused,
    LayoutMismatch,
    LinkError,
    TelemetryStalled,
    UsageError,
)
from m100link.flight.authority import Authority, AuthorityInput, AuthorityState
from m100link.flight.control import Control, PauseAction, StopAction
from m100link.flight.guards import Guards
from m100link.flight.handover import release_authority
from m100link.flight.tasks import Commander, task_sequences
from m100link.link import Link, LinkStatistics, open_link
from m100link.protocol.codes import ActivationCode
from m100link.protocol.command import Push, Request, encode_code
from m100link.protocol.commands.activation import (
    Activate,
    Credentials,
    SendToMobile,
    Version,
)
from m100link.protocol.commands.monitor import AuthorityChanged, FromMobile, PushTelemetry
from m100link.protocol.firmware import FirmwareProfile, profile
from m100link.protocol.items import ITEMS
from m100link.requests import Requests
from m100link.telemetry.device_clock import DeviceClock
from m100link.telemetry.sample import Sample
from m100link.telemetry.state import AircraftState
from m100link.telemetry.subscription import Hub, Latest, Newest, Policy, Subscription
from m100link.wire.cipher import Cipher
from m100link.wire.frame import Frame

__all__ = ["ActivationProgress", "Aircraft", "connect"]

_logger = logging.getLogger("m100link.aircraft")

_ACTIVATION_TIMEOUT, _ACTIVATION_TRIES = 1.0, 3
_ACTIVATION_PAUSE = 2.0
_MOBILE_TIMEOUT, _MOBILE_TRIES = 0.5, 2

A = TypeVar("A")


@dataclass(frozen=True, slots=True)
class ActivationProgress:
    """Where an activation stands.

    Attributes:
        attempt: Number of the attempt, from 1.
        code: What the aircraft answered to it.
        next_attempt_in: Seconds until the next one, None after the last.
        remaining: Seconds until the whole activation gives up.
    """

    attempt: int
    code: ActivationCode
    next_attempt_in: float | None
    remaining: float


class Aircraft:
    """A connected aircraft. Get one from :func:`connect`.

    Attributes:
        state: Newest value and age of every telemetry item.
        authority: Who controls the aircraft, as far as this program knows.
        telemetry_mismatches: Telemetry packages refused because they do not fit the firmware
            profile.
    """

    def __init__(self, *, firmware: FirmwareProfile | None = None) -> None:
        loop = asyncio.get_running_loop()
        self._clock = loop.time
        self._link: Link | None = None
        self._forced_firmware = firmware
        self._requests: Requests | None = None
        self._telemetry: Hub[Sample] = Hub()
        self._from_mobile: Hub[bytes] = Hub()
        self._control: Control | None = None
        self._task_sequences = task_sequences()
        self.state = AircraftState(self._clock)
        self.authority = Authority(self._clock)
        self.authority.subscribe(self._authority_changed)
        self.telemetry_mismatches = 0
        self._device_clock: DeviceClock | None = None
        self._handlers: dict[tuple[int, int], Callable[[Frame, float], None]] = {
            PushTelemetry.ADDRESS: self._on_telemetry,
            AuthorityChanged.ADDRESS: self._on_authority_changed,
            FromMobile.ADDRESS: self._on_from_mobile,
        }

    # -- connection ------------------------------------------------------------------------------

    async def open(self, url: str, *, baud_rate: int | None = None, timeout: float = 3.0) -> None:
        """Open the line and ask for the version. :func:`connect` does this and closes as well."""
        if self._link is not None:
            raise UsageError("this aircraft was opened before; connect() makes a new one")
        await self.attach(
            await open_link(
                url, baud_rate=baud_rate, on_received=self._on_received, on_lost=self._on_lost
            ),
            timeout=timeout,
        )

    async def attach(self, link: Link, *, timeout: float = 3.0) -> None:
        """Use a link that is open already, and ask for the version."""
        self._link = link
        self._requests = Requests(link, self._forced_firmware)
        link.on_received, link.on_lost = self._on_received, self._on_lost
        try:
            await self._requests.find_aircraft(timeout)
        except BaseException:
            await self.aclose()
            raise

    async def aclose(self) -> None:
        """Close the line. May be called any number of times."""
        if self._link is not None:
            await self._link.close()

    @property
    def link(self) -> Link:
        """The link underneath.

        Raises:
            UsageError: Not opened yet.
        """
        if self._link is None:
            raise UsageError("this aircraft is not connected", remedy="use `async with connect(…)`")
        return self._link

    def statistics(self) -> LinkStatistics:
        """Counters of the link."""
        return self.link.statistics()

    # -- version and activation ------------------------------------------------------------------

    @property
    def firmware(self) -> FirmwareProfile:
        """The firmware profile in use."""
        return self._sender.firmware

    @property
    def is_activated(self) -> bool:
        """Whether this program activated the aircraft, and so has its key in use."""
        return self.link.cipher is not None

    async def version(self) -> Version:
        """Ask for the version (document 2.2.1.1). Needs no activation.

        Raises:
            AckTimeout, LinkError, BadAck: See each class.
        """
        return await self._sender.query_version()

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
        version = await self.version()
        deadline = self._clock() + timeout
        attempt = 0
        while True:
            attempt += 1
            request = Activate.from_credentials(credentials, self.firmware)
            code = await self.execute(
                request,
                timeout=_ACTIVATION_TIMEOUT,
                tries=_ACTIVATION_TRIES,
                refusal=ActivationRefused,
            )
            remaining = max(0.0, deadline - self._clock())
            again = code == ActivationCode.NEW_DEVICE and remaining > 0
            pause = min(_ACTIVATION_PAUSE, remaining) if again else None
            if progress is not None:
                progress(ActivationProgress(attempt, code, pause, remaining))
            if code == ActivationCode.SUCCESS or self._is_active_without_app(version, code):
                self.link.cipher = Cipher(credentials.key, random_padding=True)
                _logger.info("activated for app %d", credentials.app_id)
                return version
            if pause is None:
                raise ActivationRefused(
                    f"activation of app {credentials.app_id} failed: {code.meaning} "
                    f"(code {int(code)}, attempt {attempt})",
                    command=request.NAME,
                    code=int(code),
                    cause=code.cause,
                    remedy=code.remedy,
                )
            await asyncio.sleep(pause)

    @staticmethod
    def _is_active_without_app(version: Version, code: ActivationCode) -> bool:
        """An active aircraft stays active when the app that reached the server is gone."""
        unreachable = (ActivationCode.APP_NOT_CONNECTED, ActivationCode.NO_INTERNET)
        return version.is_activated and code in unreachable

    def use_key(self, credentials: Credentials) -> None:
        """Encrypt with this key without activating: for a second program on an active aircraft."""
        self.link.cipher = Cipher(credentials.key, random_padding=True)

    @property
    def _sender(self) -> Requests:
        # Not public: by it, movement could leave without a control block.
        if self._requests is None:
            raise UsageError("this aircraft is not connected", remedy="use `async with connect(…)`")
        return self._requests

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
        """Send any request and return what its ack says: see :meth:`Requests.execute`."""
        return await self._sender.execute(
            request, timeout=timeout, tries=tries, encrypted=encrypted, refusal=refusal
        )

    def push(self, command: Push) -> bool:
        """Send any command without an ack. False when the line does not drain.

        Movement is not among them: it leaves through a control block alone.

        Raises:
            UsageError: Not such a command, or the firmware is unknown.
            LinkError: The line is gone.
        """
        if not isinstance(command, Push):
            raise UsageError(
                f"{command!r} cannot be pushed",
                remedy="movement is sent in `async with aircraft.control()`; what has an ack is "
                "executed",
            )
        return self._sender.push(command)

    def control(
        self,
        *,
        stop: StopAction = "hover",
        on_pause: PauseAction = "raise",
        guards: Guards | None = None,
        handle_signals: bool = True,
    ) -> Control:
        """Control authority for a block: ``async with aircraft.control() as control``.

        Args:
            stop: What to do when the block ends in any way: ``"hover"`` or ``"land"``.
            on_pause: When the pilot takes the aircraft: ``"raise"`` ends the block with
                :class:`AuthorityLost`; ``"wait"`` keeps it, see :meth:`Control.wait_resumable`.
            guards: Safety guards; all on by default.
            handle_signals: Let SIGTERM and SIGHUP (a closed terminal) take the stop path before
                they end the program.

        Raises (on entering):
            UsageError: Another control block of this program is running.
            AuthorityRefused: With cause and remedy.
            NotActivated, LevelTooLow, KeyRejected, AckTimeout, LinkError: See each class.
        """
        return Control(
            self._commander(),
            stop=stop,
            on_pause=on_pause,
            guards=guards,
            handle_signals=handle_signals,
            claim=self._claim,
        )

    async def release_authority(self) -> None:
        """Give control authority back that an earlier program left; a control block does it itself.

        The aircraft hovers and the pilot flies on. What goes wrong is logged, not raised.
        """
        await release_authority(self._commander())

    def _commander(self) -> Commander:
        return Commander(self._sender, self.authority, self.state, self._task_sequences)

    def _claim(self, control: Control) -> None:
        """One block at a time: the second would release what the first one holds."""
        if self._control is not None and self._control.is_active:
            raise UsageError(
                "another control block of this program is running",
                remedy="share its Control object, or leave that block first",
            )
        self._control = control

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
        wanted = 0
        for record in records:
            item = next((item for item in ITEMS if item.record is record), None)
            if item is None:
                raise UsageError(
                    f"{record!r} is not a telemetry record",
                    remedy="use m100link.Attitude, m100link.Position, …",
                )
            wanted |= 1 << item.bit
        if rate_hz is not None and not rate_hz > 0:
            raise UsageError(f"a rate of {rate_hz} Hz is no rate")
        return self._telemetry.subscribe(
            policy or Latest(),
            min_interval=1.0 / rate_hz if rate_hz else 0.0,
            accepts=(lambda sample: bool(sample.flags & wanted)) if wanted else None,
        )

    @property
    def device_clock(self) -> DeviceClock:
        """Relates the aircraft's tick to this computer's time, with offset, skew, uncertainty."""
        clock = self._device_clock
        tick_hz = self.firmware.tick_hz
        if clock is None or clock.tick_hz != tick_hz:
            clock = self._device_clock = DeviceClock(tick_hz)
        return clock

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
        if predicate(self.state):
            return
        try:
            async with asyncio.timeout(timeout), self.telemetry() as samples:
                async for _ in samples:
                    if predicate(self.state):
                        return
        except TimeoutError as error:
            if isinstance(error, LinkError):
                raise
            raise TelemetryStalled(
                f"{what} was not seen within {timeout:g} s; now: {self.state.situation()}",
                cause="it did not happen, or the items that show it are not sent",
                remedy="see which items arrive: m100link hz",
            ) from None

    async def send_to_mobile(self, data: bytes) -> None:
        """Send 1 to 100 bytes to the app on the mobile device (document 2.2.1.3).

        Raises:
            PayloadTooLarge, UsageError: Too many bytes, or none.
            NotActivated, AckTimeout, LinkError: See each class.
        """
        code = await self.execute(SendToMobile(data), timeout=_MOBILE_TIMEOUT, tries=_MOBILE_TRIES)
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

    def _on_received(self, frame: Frame, now: float) -> None:
        data = frame.data
        handler = self._handlers.get((data[0], data[1])) if len(data) >= 2 else None
        if handler is not None:
            handler(frame, now)
        else:
            _logger.debug("a push that is no push of the document: %s", data[:16].hex())

    def _on_telemetry(self, frame: Frame, now: float) -> None:
        requests = self._requests
        if requests is None or not requests.knows_layout:
            return
        try:
            sample = Sample(frame.data[2:], requests.firmware, now)
        except LayoutMismatch as error:
            self.telemetry_mismatches += 1
            if self.telemetry_mismatches == 1:
                _logger.warning("telemetry refused: %s", error)
            return
        self.state.update(sample)
        time = sample.time
        if time is not None:
            self.device_clock.update(time.tick, now)
        remote_control = sample.remote_control
        if remote_control is not None:
            self.authority.observe_remote_control(remote_control)
        control_device = sample.control_device
        if control_device is not None:
            self.authority.observe_control_device(control_device)
        self._telemetry.publish(sample, now)

    def _on_authority_changed(self, frame: Frame, now: float) -> None:
        self.link.acknowledge(frame, encode_code(0))
        _logger.info("the aircraft notifies that authority passed away")
        self.authority.feed(AuthorityInput.NOTIFIED)

    def _on_from_mobile(self, frame: Frame, now: float) -> None:
        self._from_mobile.publish(frame.data[2:], now)

    def _on_lost(self, error: LinkError) -> None:
        self._telemetry.fail(error)
        self._from_mobile.fail(error)
        if self._control is not None:
            self._control.fail(error)
        self.authority.feed(AuthorityInput.LINK_LOST)

    def _authority_changed(self, before: AuthorityState, after: AuthorityState) -> None:
        if self._control is not None:
            self._control.authority_changed(before, after, self.authority.reason)


@asynccontextmanager
async def connect(
    url: str,
    *,
    firmware: str | FirmwareProfile | None = None,
    baud_rate: int | None = None,
    timeout: float = 3.0,
) -> AsyncIterator[Aircraft]:
    """Connect to an aircraft for the time of a block.

    ::

        async with m100link.connect("serial:///dev/ttyUSB0:230400") as aircraft:
            print(await aircraft.version())

    Args:
        url: ``serial:///dev/ttyUSB0:230400``, a bare device path, ``tcp://host:port``, ``sim://``.
        firmware: Force a profile by name; by default the version answer chooses it.
        baud_rate: Rate when the URL has none; 230400 by default.
        timeout: Seconds until an aircraft has to answer.

    Raises:
        BadURL, UsageError: A wrong string or profile name.
        PortNotFound, PortPermissionDenied, PortBusy, PortFailed: The port cannot be opened.
        SilentLine, NoValidFrame, NoAnswer: It can, but no aircraft answers; each names the cause.
    """
    aircraft = Aircraft(firmware=None if firmware is None else profile(firmware))
    await aircraft.open(url, baud_rate=baud_rate, timeout=timeout)
    try:
        yield aircraft
    finally:
        await aircraft.aclose()
