"""Gimbal and camera without ``await``."""

from __future__ import annotations

from typing import Any

from m100link.aircraft import payload as aio
from m100link.sync.portal import Handed, like, waits
from m100link.sync.steering import GimbalRates

__all__ = ["AircraftCamera", "AircraftGimbal"]


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
