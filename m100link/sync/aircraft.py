"""The aircraft without ``await``: it hands every call to the thread of the one with it."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, ParamSpec, Self

from m100link import aircraft as aio
from m100link.aircraft.aircraft import AuthorityEvent, ConnectionEvent
from m100link.flight.authority import Authority
from m100link.flight.mission_state import MissionState
from m100link.protocol.firmware import FirmwareProfile
from m100link.protocol.records import AccelerationMode
from m100link.sim.ports.driver import clock_of
from m100link.sync.control import Control, GimbalRates, Subscription
from m100link.sync.portal import Handed, Portal, Reads, calls, like, shown_as, waits
from m100link.sync.signals import SIGNALS
from m100link.telemetry.device_clock import DeviceClock
from m100link.telemetry.sample import Sample
from m100link.telemetry.state import AircraftState
from m100link.telemetry.subscription import Policy

__all__ = ["Aircraft", "AircraftCamera", "AircraftGimbal", "connect"]


P = ParamSpec("P")


class Aircraft(Handed):
    """A connected aircraft without ``await``. Get one from :func:`connect`.

    It lives in a thread of its own: telemetry is taken, setpoints are repeated and expire, and the
    stop path runs whatever the thread that called does meanwhile. May be used by several threads.
    """

    def __init__(self, portal: Portal, aircraft: aio.Aircraft) -> None:
        super().__init__(portal, aircraft)
        self.gimbal = AircraftGimbal(portal, aircraft.gimbal)
        self.camera = AircraftCamera(portal, aircraft.camera)
        SIGNALS.connected(portal)
        self.close = portal.close_after(aircraft.aclose, partial(SIGNALS.closed, portal))
        """End the control block that runs, then close the line. May be called again."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def authority(self) -> Authority:
        """The state of control authority, as far as this program knows."""
        authority: Authority = self._aio.authority
        return authority

    is_connected = Reads[bool](aio.Aircraft.is_connected)
    wait_closed = waits(aio.Aircraft.wait_closed)

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
        return self._subscribed(timeout, self._aio.events)

    def _subscribed(
        self, timeout: float | None, method: Callable[..., Any], *args: Any, **options: Any
    ) -> Subscription[Any]:
        subscription = self._portal.call(method, *args, **options)
        return Subscription(self._portal, subscription, timeout)

    statistics = calls(aio.Aircraft.statistics)
    note = calls(aio.Aircraft.note)
    firmware = Reads[FirmwareProfile](aio.Aircraft.firmware)
    is_activated = Reads[bool](aio.Aircraft.is_activated)
    version = waits(aio.Aircraft.version)
    activate = waits(aio.Aircraft.activate)
    use_key = calls(aio.Aircraft.use_key)
    execute = waits(aio.Aircraft.execute)

    @like(aio.Aircraft.control)
    def control(self, *, handle_signals: bool = True, **options: Any) -> Control:
        made = self._portal.call(self._aio.control, handle_signals=handle_signals, **options)
        return Control(self._portal, made, handle_signals=handle_signals)

    release_authority = waits(aio.Aircraft.release_authority)
    set_telemetry_rates = waits(aio.Aircraft.set_telemetry_rates)
    mission = Reads[MissionState](aio.Aircraft.mission)
    download_waypoint_plan = waits(aio.Aircraft.download_waypoint_plan)

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
        how = {"policy": policy, "rate_hz": rate_hz}
        return self._subscribed(timeout, self._aio.telemetry, *records, **how)

    collect = waits(aio.Aircraft.collect)
    utc_offset_s = Reads[float](aio.Aircraft.utc_offset_s)
    state = Reads[AircraftState](aio.Aircraft.state)
    telemetry_mismatches = Reads[int](aio.Aircraft.telemetry_mismatches)
    acceleration_mode = Reads[AccelerationMode | None](aio.Aircraft.acceleration_mode)
    device_clock = Reads[DeviceClock](aio.Aircraft.device_clock)
    wait_for = waits(aio.Aircraft.wait_for)
    send_to_mobile = waits(aio.Aircraft.send_to_mobile)

    def from_mobile(
        self, *, policy: Policy | None = None, timeout: float | None = None
    ) -> Subscription[bytes]:
        """Data from the app on the mobile device, 1 to 100 bytes each (document 2.2.3.3).

        Iterating waits up to ``timeout`` seconds for a value; None: for ever.
        """
        return self._subscribed(timeout, self._aio.from_mobile, policy=policy)


def _without_await(connect: Callable[P, aio.Connecting]) -> Callable[P, Aircraft]:
    def connected(*args: P.args, **kwargs: P.kwargs) -> Aircraft:
        connecting = connect(*args, **kwargs)
        portal = Portal(clock_of(args[0] if args else kwargs["line"]))
        try:
            return Aircraft(portal, portal.wait(lambda _: _awaited(connecting)))
        except BaseException:
            portal.close()
            raise

    shown_as(connected, connect, Aircraft)
    return connected


async def _awaited(connecting: aio.Connecting) -> aio.Aircraft:
    return await connecting


connect = _without_await(aio.connect)


# -- gimbal and camera -----------------------------------------------------------------------------


class AircraftGimbal(Handed):
    """The gimbal of a connected aircraft, without ``await``: ``aircraft.gimbal``."""

    set_angles = waits(aio.AircraftGimbal.set_angles)
    set_angular_rates = waits(aio.AircraftGimbal.set_angular_rates)

    @like(aio.AircraftGimbal.hold_angular_rates)
    def hold_angular_rates(self, **rates: Any) -> GimbalRates:
        return GimbalRates(self._portal, lambda _: self._aio.hold_angular_rates(**rates))


class AircraftCamera(Handed):
    """The camera of a connected aircraft, without ``await``: ``aircraft.camera``.

    **Sent, and nobody confirms**: no firmware says whether a picture was taken or a video runs.
    """

    take_photo = waits(aio.AircraftCamera.take_photo)
    start_video = waits(aio.AircraftCamera.start_video)
    stop_video = waits(aio.AircraftCamera.stop_video)
