"""The payload: gimbal and camera.

The gimbal is pointed by angles, or by angular rates for as long as somebody wants them. It needs no
control authority and flies nothing. Nothing answers these commands; telemetry shows the angles.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import TYPE_CHECKING

from m100link.errors import LinkError, NotObserved, TelemetryStalled, UsageError
from m100link.geodesy import normalize_degrees
from m100link.protocol.command import in_range
from m100link.protocol.commands.gimbal import (
    GimbalAngle,
    GimbalAngleMode,
    GimbalSpeed,
    StartVideo,
    StopVideo,
    TakePhoto,
)
from m100link.protocol.records import Gimbal

if TYPE_CHECKING:
    from m100link.link.requests import Requests
    from m100link.telemetry.subscription import TelemetryStream

_logger = logging.getLogger(__name__)


_REPEAT_S = 0.1  # a rate holds for 0.5 s; DJI's sample repeats it at 10 Hz
_FIRST_VALUE_S = 1.5  # an item that is sent at all, at 1 Hz or more, has come by then
_TOLERANCE_DEG = 1.5
_MARGIN_S = 3.0  # the gimbal turns at 400 degrees per second at most, whatever the order
_STRAIGHT_DOWN_DEG = -85.0  # beyond, roll and yaw of the telemetry mean nothing

_KEEP = {
    "yaw": GimbalAngleMode.KEEP_YAW,
    "roll": GimbalAngleMode.KEEP_ROLL,
    "pitch": GimbalAngleMode.KEEP_PITCH,
}


class GimbalRates:
    """Angular rates that are being repeated; :meth:`set` replaces them."""

    def __init__(self, *, yaw: float, pitch: float, roll: float) -> None:
        self.command = rates_command(yaw=yaw, pitch=pitch, roll=roll)  #: what goes out next

    def set(self, *, yaw: float = 0.0, pitch: float = 0.0, roll: float = 0.0) -> None:
        """Turn at these rates from the next repetition on, within 0.1 s.

        Raises:
            UsageError: Beyond 180 degrees per second, or not a number.
        """
        self.command = rates_command(yaw=yaw, pitch=pitch, roll=roll)


class AircraftGimbal:
    """The gimbal of a connected aircraft: ``aircraft.gimbal``. Firmware 2.3 on, level 1.

    Commands return when they are sent: the aircraft acknowledges none of them. ``wait=True`` waits
    for telemetry to show the angles.
    """

    def __init__(self, requests: Requests, telemetry: TelemetryStream) -> None:
        self._requests = requests
        self._telemetry = telemetry

    def __repr__(self) -> str:
        seen = self._telemetry.state.gimbal
        if seen is None:
            return "<AircraftGimbal, angles unknown>"
        return (
            f"<AircraftGimbal yaw {seen.yaw_deg:z.1f}°, pitch {seen.pitch_deg:z.1f}°, "
            f"roll {seen.roll_deg:z.1f}°>"
        )

    async def set_angles(
        self,
        *,
        yaw: float | None = None,
        pitch: float | None = None,
        roll: float | None = None,
        seconds: float = 1.0,
        relative: bool = False,
        wait: bool = False,
        timeout: float | None = None,
    ) -> None:
        """Point it within a time; an axis that is not named is left alone.

        ::

            await aircraft.gimbal.set_angles(pitch=-45, yaw=0, seconds=1.5)

        Args:
            yaw: -320 to 320 degrees, clockwise from north (errata 52: fixed to the ground, whatever
                the app's gimbal mode).
            pitch: -90 (straight down) to 30 degrees.
            roll: -35 to 35 degrees.
            seconds: 0.1 to 25.5; it turns at 400 degrees per second at most.
            relative: The angles count from the present ones.
            wait: Return when telemetry shows the angles within 1.5 degrees, and not when they are
                sent. Straight down, roll and yaw of the telemetry mean nothing: only the pitch is
                waited for.
            timeout: Seconds to wait; by default 3 more than ``seconds``, and on a slow line more.

        Raises:
            UsageError: No angle, or one beyond its limit; nothing was sent.
            TelemetryStalled: With ``wait``: the gimbal item does not come; nothing was sent.
            NotObserved: With ``wait``: the angles did not show in time.
            NotActivated, LevelTooLow, CommandNotSupported, LinkError: Nothing was sent.
        """
        command = angles_command(
            yaw=yaw, pitch=pitch, roll=roll, seconds=seconds, relative=relative
        )
        angles = _named(yaw=yaw, pitch=pitch, roll=roll)
        if not wait:
            await self._requests.send(command)
            return
        present = await self._angles()
        if relative:
            angles = {axis: present[axis] + angle for axis, angle in angles.items()}
        sent_at = asyncio.get_running_loop().time()
        await self._requests.send(command)
        if timeout is None:
            timeout = seconds + _MARGIN_S + self._requests.latency.slack_s
        await self._reach(angles, sent_at, timeout)

    async def _angles(self) -> dict[str, float]:
        """The present angles, ° by axis; ``TelemetryStalled`` when none comes for 1.5 s."""
        state = self._telemetry.state

        def is_there(_: object) -> bool:
            return state.fresh(Gimbal, within=_FIRST_VALUE_S) is not None

        try:
            await self._telemetry.wait_for(is_there, _FIRST_VALUE_S, "the gimbal item")
        except TelemetryStalled:
            age = state.age(Gimbal)
            raise TelemetryStalled(
                "the angles cannot be waited for, nothing was sent: the gimbal item "
                + ("has never come" if age is None else f"came {age:.1f} s ago for the last time"),
                cause="its rate is 0 Hz, or telemetry does not arrive",
                remedy="set_telemetry_rates(gimbal=50) on firmware 3.1, before that in the PC "
                "assistant; or do without wait=True",
            ) from None
        seen = state.gimbal
        assert seen is not None
        return _by_axis(seen)

    async def _reach(self, angles: dict[str, float], sent_at: float, timeout: float) -> None:
        """Wait until telemetry shows these angles, or raise ``NotObserved``."""
        state = self._telemetry.state
        if angles.get("pitch", 0.0) < _STRAIGHT_DOWN_DEG:
            angles = {"pitch": angles["pitch"]}

        def are_shown(_: object) -> bool:
            seen, seen_at = state.gimbal, state.received_at(Gimbal)
            return (
                seen is not None
                and seen_at is not None
                and seen_at > sent_at
                and all(
                    abs(normalize_degrees(_by_axis(seen)[axis] - angle)) <= _TOLERANCE_DEG
                    for axis, angle in angles.items()
                )
            )

        try:
            await self._telemetry.wait_for(are_shown, timeout, "the gimbal")
        except TelemetryStalled:
            raise _not_shown(angles, state.gimbal, state.age(Gimbal), timeout) from None

    async def set_angular_rates(
        self,
        *,
        yaw: float = 0.0,
        pitch: float = 0.0,
        roll: float = 0.0,
        seconds: float | None = None,
    ) -> None:
        """Turn it, -180 to 180 degrees per second for each axis.

        Args:
            yaw: Degrees per second, clockwise.
            pitch: Degrees per second, upwards.
            roll: Degrees per second.
            seconds: Repeat for so long, then stop. Without it one command is sent, which holds for
                half a second (inferred).

        Raises:
            UsageError: A rate beyond its limit, or a time that is not one; nothing was sent.
            NotActivated, LevelTooLow, CommandNotSupported, LinkError: See each class.
        """
        command = rates_command(yaw=yaw, pitch=pitch, roll=roll, seconds=seconds)
        if seconds is None:
            await self._requests.send(command)
            return
        async with self.hold_angular_rates(yaw=yaw, pitch=pitch, roll=roll):
            await asyncio.sleep(seconds)

    @asynccontextmanager
    async def hold_angular_rates(
        self, *, yaw: float = 0.0, pitch: float = 0.0, roll: float = 0.0
    ) -> AsyncIterator[GimbalRates]:
        """Keep turning it while the block runs; a task repeats the rates ten times a second.

        ::

            async with aircraft.gimbal.hold_angular_rates(pitch=-10) as rates:
                await asyncio.sleep(2)
                rates.set(yaw=5)
                await asyncio.sleep(2)

        Leaving the block stops it; a program that dies leaves it turning for half a second.

        Raises: as :meth:`set_angular_rates`.
        """
        rates = GimbalRates(yaw=yaw, pitch=pitch, roll=roll)
        await self._requests.send(rates.command)
        repeating = asyncio.create_task(self._repeat(rates), name="m100link gimbal")
        try:
            yield rates
            if repeating.done():
                repeating.result()  # the line is gone
        finally:
            if not repeating.cancel() and not repeating.cancelled():
                repeating.exception()  # raised above, unless the program has an error of its own
            try:
                self._requests.push(GimbalSpeed())
            except LinkError as error:
                _logger.debug("the gimbal could not be stopped: %s", error.seen)

    async def _repeat(self, rates: GimbalRates) -> None:
        while True:
            await asyncio.sleep(_REPEAT_S)
            self._requests.push(rates.command)


def angles_command(
    *,
    yaw: float | None = None,
    pitch: float | None = None,
    roll: float | None = None,
    seconds: float = 1.0,
    relative: bool = False,
) -> GimbalAngle:
    """The command of :meth:`AircraftGimbal.set_angles`; ``UsageError`` as there."""
    angles = _named(yaw=yaw, pitch=pitch, roll=roll)
    if not angles:
        raise UsageError("no angle was given", remedy="set_angles(pitch=-45)")
    in_range("seconds", seconds, 0.1, 25.5, "s")
    mode = 0 if relative else int(GimbalAngleMode.ABSOLUTE)
    for axis, keep in _KEEP.items():
        mode |= 0 if axis in angles else keep
    command = GimbalAngle(yaw or 0.0, roll or 0.0, pitch or 0.0, mode, seconds)
    command.check()
    return command


def rates_command(
    *, yaw: float = 0.0, pitch: float = 0.0, roll: float = 0.0, seconds: float | None = None
) -> GimbalSpeed:
    """What :meth:`AircraftGimbal.set_angular_rates` repeats; ``UsageError`` as there."""
    if seconds is not None:
        in_range("seconds", seconds, 0.0, 3600.0, "s")
    for axis, rate in (("yaw", yaw), ("pitch", pitch), ("roll", roll)):
        in_range(f"{axis} rate", rate, -180.0, 180.0, "°/s")
    return GimbalSpeed(yaw_deg_s=yaw, roll_deg_s=roll, pitch_deg_s=pitch)


def _named(*, yaw: float | None, pitch: float | None, roll: float | None) -> dict[str, float]:
    """The angles that were given, by axis."""
    wanted = {"yaw": yaw, "roll": roll, "pitch": pitch}  # in the order of the wire
    return {axis: angle for axis, angle in wanted.items() if angle is not None}


def _by_axis(seen: Gimbal) -> dict[str, float]:
    return {"yaw": seen.yaw_deg, "roll": seen.roll_deg, "pitch": seen.pitch_deg}


def _not_shown(
    angles: dict[str, float], seen: Gimbal | None, age: float | None, timeout: float
) -> NotObserved:
    """The error for angles that did not show, with those that did."""
    found = {} if seen is None else {axis: round(by, 1) for axis, by in _by_axis(seen).items()}
    named = ", ".join(f"{axis} {angle:.1f}°" for axis, angle in angles.items())
    shown = ", ".join(f"{axis} {found[axis]:g}°" for axis in angles if axis in found)
    cause = "an axis is at its stop, the gimbal is busy or missing, or the command was lost"
    if seen is not None and seen.limits:
        names = ("pitch", "roll", "yaw")
        stops = [name for bit, name in enumerate(names) if seen.limits >> bit & 1]
        cause = f"at its stop: {', '.join(stops)}"
    if age is not None and age > _FIRST_VALUE_S:
        cause = f"the gimbal item stopped {age:.1f} s ago"
    return NotObserved(
        f"the gimbal was ordered to {named} and does not show it within {timeout:g} s"
        + (f"; it shows {shown}" if shown else ""),
        situation={"gimbal": found, "age_s": age},
        cause=cause,
        remedy="look at the gimbal item: m100link echo gimbal; nobody acknowledges the "
        "command, so it may be sent again",
    )


# -- the camera's shutter and recorder, as far as commands reach them ------------------------------


class AircraftCamera:
    """The camera of a connected aircraft: ``aircraft.camera``. Firmware 2.3 on, level 1.

    **Sent, and nobody confirms.** Each method returns when its command is sent. No firmware says
    whether a picture was taken or a video runs: not by an ack, not by telemetry. A lost command is
    lost in silence, so look at the card, or at the app's picture.
    """

    def __init__(self, requests: Requests) -> None:
        self._requests = requests

    async def take_photo(self) -> None:
        """Take one photograph: sent, nobody confirms. It takes about a second.

        Raises:
            NotActivated, LevelTooLow, CommandNotSupported, UsageError, LinkError: Nothing was sent.
        """
        await self._requests.send(TakePhoto())

    async def start_video(self) -> None:
        """Start recording: sent, nobody confirms. While it records, this changes nothing.

        Raises: as :meth:`take_photo`.
        """
        await self._requests.send(StartVideo())

    async def stop_video(self) -> None:
        """Stop recording: sent, nobody confirms. While it does not record, this changes nothing.

        Raises: as :meth:`take_photo`.
        """
        await self._requests.send(StopVideo())
