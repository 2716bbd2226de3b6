"""The gimbal: where the camera points, and how fast it turns. Nobody confirms what is sent."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

from m100link.apps.agent.client import AgentClient
from m100link.apps.agent.messages import Action
from m100link.apps.ros2.ends import Input
from m100link.apps.ros2.helm import Helm
from m100link.errors import M100Error
from m100link.protocol.commands.gimbal import GimbalAngle, GimbalAngleMode, GimbalSpeed
from m100link.protocol.firmware import FIRMWARE_3_1

__all__ = ["Payload", "angles_of", "rates_of"]

_SECONDS = 1.0
_PAUSE_S = 0.05
"""Seconds between two rates that are sent: one turns it for half a second."""


class Payload:
    """What ROS programs want of the gimbal.

    Args:
        agent: The agent of the aircraft.
        helm: Has the lease.
        rates: Where rates come in.
        tell: Says why something is not done: text and level.
    """

    def __init__(
        self, agent: AgentClient, helm: Helm, rates: Input, tell: Callable[[str, str], None]
    ) -> None:
        self._agent, self._helm, self._rates, self._tell = agent, helm, rates, tell
        self._due_at = agent.now
        self._is_busy = False

    async def point(self, request: Mapping[str, Any]) -> None:
        """m100_msgs/srv/PointGimbal.

        Raises:
            M100Error: An angle that it does not have, or nothing may be sent.
        """
        data = angles_of(request).value(FIRMWARE_3_1)
        await self._helm.do(Action.GIMBAL_ANGLES, data=data)

    def advance(self, *, is_deaf: bool) -> None:
        """Send the newest rates.

        Args:
            is_deaf: What comes now is old.
        """
        waiting, now = [message for _, message in self._rates.take()], self._agent.now
        if not waiting or is_deaf or self._is_busy or now < self._due_at:
            return
        self._due_at = now + _PAUSE_S
        self._is_busy = True
        self._agent.background.spawn(self._turn(waiting[-1]), "ROS gimbal")

    async def _turn(self, message: Mapping[str, Any]) -> None:
        try:
            data = rates_of(message["vector"]).value(FIRMWARE_3_1)
            await self._helm.do(Action.GIMBAL_RATES, data=data)
        except M100Error as error:
            self._tell(f"~/gimbal_speed: {error.seen}", "warning")
        finally:
            self._is_busy = False


def angles_of(request: Mapping[str, Any]) -> GimbalAngle:
    """The command of m100_msgs/srv/PointGimbal."""
    mode = GimbalAngleMode(0) if request["is_relative"] else GimbalAngleMode.ABSOLUTE
    for axis in ("yaw", "roll", "pitch"):
        if request[f"keep_{axis}"]:
            mode |= GimbalAngleMode[f"KEEP_{axis.upper()}"]
    return GimbalAngle(
        yaw_deg=request["yaw"],
        roll_deg=request["roll"],
        pitch_deg=request["pitch"],
        mode=mode,
        duration_s=request["duration"] or _SECONDS,
    )


def rates_of(vector: Mapping[str, float]) -> GimbalSpeed:
    """The command of rad/s about the axes forward, left, up (REP 103)."""
    return GimbalSpeed(
        roll_deg_s=math.degrees(vector["x"]),
        pitch_deg_s=-math.degrees(vector["y"]),
        yaw_deg_s=-math.degrees(vector["z"]),
    )
