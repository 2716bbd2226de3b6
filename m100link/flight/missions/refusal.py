"""What an aircraft that says no to a mission is reported as."""

from __future__ import annotations

from m100link.errors import MissionRefused
from m100link.protocol.codes import MissionCode

__all__ = ["mission_refused"]

_REMEDIES = {
    MissionCode.RUNNING: "stop it first: await control.stop_mission()",
    MissionCode.OTHER_RUNNING: "stop that one first: await control.stop_mission()",
}
"""What to do about it here, where a program is asked and not a pilot."""


def mission_refused(
    what: str, code: MissionCode, *, point: int | None = None, remedy: str = ""
) -> MissionRefused:
    """The refusal of an order, with what the code says.

    Args:
        what: The order, in words.
        code: What the aircraft answered.
        point: The waypoint that it is about, counted from 0.
        remedy: What to do about it, if what the code says does not fit the order.
    """
    where = "" if point is None else f", waypoint {point}"
    return MissionRefused(
        f"{what} was refused{where}: {code.meaning} (code 0x{code:02X})",
        command=what,
        code=int(code),
        point=point,
        cause=code.cause,
        remedy=remedy or _REMEDIES.get(code, code.remedy),
    )
