"""The sticks of a virtual remote control, and when its settings may be sent."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import NamedTuple

from m100link.errors import UsageError
from m100link.flight.tasks import Commander
from m100link.protocol.commands.virtual_rc import (
    CENTRE,
    TRAVEL,
    VirtualRcData,
    VirtualRcSettings,
)

__all__ = ["CENTRED", "GESTURE", "SETTINGS_INTERVAL_S", "SettingsPace", "Sticks"]

SETTINGS_INTERVAL_S = 2.2
"""Between two settings; faster than every 2 s they lock the aircraft (facts V2, DJI's header). The
rest is for frames that are late: a second one may catch up with the first."""

_ROUNDING_S = 1e-3  # timers are that exact
_GEAR_DOWN, _MODE_P = 1324, 1552
_CORNER = 0.9


class Sticks(NamedTuple):
    """Deflections, -1 (left or down) to 1 (right or up)."""

    roll: float = 0.0
    pitch: float = 0.0
    throttle: float = 0.0
    yaw: float = 0.0

    @property
    def are_in_corner(self) -> bool:
        """Both sticks down and to one side each: that starts and stops the motors."""
        down = self.pitch < -_CORNER and self.throttle < -_CORNER
        return down and abs(self.roll) > _CORNER and abs(self.yaw) > _CORNER

    def encoded(self) -> VirtualRcData:
        """The channels. The mode is always P, in which centred sticks hover."""
        sticks = (round(CENTRE + TRAVEL * deflection) for deflection in self)
        return VirtualRcData((*sticks, _GEAR_DOWN, CENTRE, _MODE_P, *[CENTRE] * 9))


CENTRED = Sticks()
GESTURE = Sticks(roll=-1.0, pitch=-1.0, throttle=-1.0, yaw=1.0)


class SettingsPace:
    """Lets the settings of one aircraft out, and never two within two seconds.

    The program before may have sent some just before this one connected: that counts.
    """

    def __init__(self, clock: Callable[[], float]) -> None:
        self._clock = clock
        self.free_at = clock() + SETTINGS_INTERVAL_S

    async def wait(self) -> None:
        """Wait until the next may be sent."""
        await asyncio.sleep(max(0.0, self.free_at - self._clock()))

    def send(self, commander: Commander, command: VirtualRcSettings) -> bool:
        """Send it. False when the line does not drain.

        Raises:
            UsageError: Too soon; nothing was sent.
        """
        now = self._clock()
        if now < self.free_at - _ROUNDING_S:
            raise UsageError(
                f"virtual RC settings are not sent: it is {self.free_at - now:.1f} s too soon",
                cause="faster than every 2 s they lock the aircraft (DJI's header warns of it)",
                remedy="await wait() first",
            )
        if not commander.requests.push(command):
            return False
        self.free_at = now + SETTINGS_INTERVAL_S
        return True
