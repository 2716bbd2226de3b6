"""Gimbal and camera without ``await``. Written by ``nox -s sync``: do not edit.

It has the one with ``await`` and hands every call to the thread in which that lives.
"""

from __future__ import annotations

from m100link.aircraft import payload
from m100link.sync.portal import Portal
from m100link.sync.steering import GimbalRates

__all__ = ["AircraftCamera", "AircraftGimbal"]


class AircraftGimbal:
    """The gimbal of a connected aircraft, without ``await``: ``aircraft.gimbal``."""

    def __init__(self, portal: Portal, gimbal: payload.AircraftGimbal) -> None:
        self._portal = portal
        self._gimbal = gimbal

    def __repr__(self) -> str:
        return repr(self._gimbal)

    def set_angles(
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

            aircraft.gimbal.set_angles(pitch=-45, yaw=0, seconds=1.5)

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
        return self._portal.wait(
            lambda _: self._gimbal.set_angles(
                yaw=yaw,
                pitch=pitch,
                roll=roll,
                seconds=seconds,
                relative=relative,
                wait=wait,
                timeout=timeout,
            )
        )

    def set_angular_rates(
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
        return self._portal.wait(
            lambda _: self._gimbal.set_angular_rates(
                yaw=yaw, pitch=pitch, roll=roll, seconds=seconds
            )
        )

    def hold_angular_rates(
        self, *, yaw: float = 0.0, pitch: float = 0.0, roll: float = 0.0
    ) -> GimbalRates:
        """Keep turning it while the block runs; a task repeats the rates ten times a second.

        ::

            with aircraft.gimbal.hold_angular_rates(pitch=-10) as rates:
                time.sleep(2)
                rates.set(yaw=5)
                time.sleep(2)

        Leaving the block stops it; a program that dies leaves it turning for half a second.

        Raises: as :meth:`set_angular_rates`.
        """
        return GimbalRates(
            self._portal, self._gimbal.hold_angular_rates(yaw=yaw, pitch=pitch, roll=roll)
        )


class AircraftCamera:
    """The camera of a connected aircraft, without ``await``: ``aircraft.camera``.

    **Sent, and nobody confirms**: no firmware says whether a picture was taken or a video runs.
    """

    def __init__(self, portal: Portal, camera: payload.AircraftCamera) -> None:
        self._portal = portal
        self._camera = camera

    def take_photo(self) -> None:
        """Take one photograph: sent, nobody confirms. It takes about a second.

        Raises:
            NotActivated, LevelTooLow, CommandNotSupported, UsageError, LinkError: Nothing was sent.
        """
        return self._portal.wait(lambda _: self._camera.take_photo())

    def start_video(self) -> None:
        """Start recording: sent, nobody confirms. While it records, this changes nothing.

        Raises: as :meth:`take_photo`.
        """
        return self._portal.wait(lambda _: self._camera.start_video())

    def stop_video(self) -> None:
        """Stop recording: sent, nobody confirms. While it does not record, this changes nothing.

        Raises: as :meth:`take_photo`.
        """
        return self._portal.wait(lambda _: self._camera.stop_video())
