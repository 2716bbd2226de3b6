"""Sticks of a ground station: MANUAL_CONTROL, as velocities (POSCTL) or as tilts (ALTCTL)."""

from __future__ import annotations

from m100link.apps.mavlink.codec import Message
from m100link.apps.mavlink.parameters import Parameters
from m100link.apps.mavlink.world import World
from m100link.protocol.setpoint import Setpoint

__all__ = ["STICKS_LIFETIME", "Manual"]

STICKS_LIFETIME = 0.5
"""Seconds after which sticks that are not told any more are let go."""

_FULL = 1000.0
_DEAD = 0.03


def _stick(value: float) -> float:
    """-1 to 1, with nothing around the middle, and where there is no such axis.

    What is out of range is no axis, as PX4 has it: INT16_MAX, by which the definitions say so, and
    nonsense, which nobody means as a full stick.
    """
    found = value / _FULL
    return found if _DEAD <= abs(found) <= 1.0 else 0.0


class Manual:
    """The newest sticks of the operator.

    Args:
        world: The aircraft.
        parameters: Speeds.
        is_tilt: Whether sticks are tilts.
    """

    def __init__(self, world: World, parameters: Parameters, *, is_tilt: bool) -> None:
        self._world = world
        self._parameters = parameters
        self._is_tilt = is_tilt
        self._sticks = (0.0, 0.0, 0.0, 0.0)
        self._at = float("-inf")

    def receive(self, message: Message, now: float) -> None:
        """Take sticks over: pitch, roll, climb (0 to 1000, 500 stays), turn."""
        x, y, z, r = (message[axis] for axis in "xyzr")
        first, second, third, fourth = map(_stick, (x, y, (z - _FULL / 2) * 2, r))
        self._sticks, self._at = (first, second, third, fourth), now

    def is_fresh(self, now: float) -> bool:
        """Whether sticks came lately."""
        return now - self._at <= STICKS_LIFETIME

    def wants_up(self, now: float) -> bool:
        """Sticks do not leave the ground: a take-off is asked for."""
        return False

    def setpoint(self, now: float) -> Setpoint | None:
        """What to fly now; None when nobody holds the sticks."""
        if not self.is_fresh(now):
            return None
        pitch, roll, climb, turn = self._sticks
        values = self._parameters
        up = climb * values["MPC_Z_VEL_MAX_UP" if climb > 0 else "MPC_Z_VEL_MAX_DN"]
        yaw_rate = turn * values["MPC_MAN_Y_MAX"]
        if self._is_tilt:
            tilt = values["MPC_MAN_TILT_MAX"]
            return Setpoint.tilt(
                roll_deg=roll * tilt, pitch_deg=-pitch * tilt, up=up, yaw_rate_deg_s=yaw_rate
            )
        limit = self._world.known.state.limits.max_speed_m_s
        speed = min(values["MPC_XY_VEL_MAX"], 10.0 if limit is None else limit)
        scale = max(1.0, (pitch * pitch + roll * roll) ** 0.5)
        return Setpoint.velocity(
            forward=pitch * speed / scale,
            right=roll * speed / scale,
            up=up,
            yaw_rate_deg_s=yaw_rate,
        )
