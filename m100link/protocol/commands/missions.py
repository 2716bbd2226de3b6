"""Command set 0x03 of later firmware: missions, which neither side flies yet.

Its acks begin with a code of one byte, where all others have two. An aircraft that knows no
missions must refuse them in that shape, whatever its firmware: of 0xFF00, "not supported"
elsewhere, DJI's programs read the first byte, and 0 is success.
"""

from __future__ import annotations

__all__ = ["COMMAND_SET", "NOT_SUPPORTED", "refusal"]

COMMAND_SET = 0x03

NOT_SUPPORTED = 0xC8
"""Ack code: this mission is not supported."""

_ADD_WAYPOINT, _FOLLOW_TARGET = 0x11, 0x33
_TAILS = {
    _ADD_WAYPOINT: 1,  # its index
    0x14: 51,  # the downloaded mission
    0x15: 90,  # the downloaded waypoint
    0x16: 4,  # the speed in force, as a float
    0x17: 4,
    0x20: 4,  # the largest radius
    0x26: 51,  # the downloaded hotpoint
}
"""Bytes behind the code of the ack, by command id; the other acks are the code alone."""


def refusal(command_id: int, value: bytes) -> bytes | None:
    """The ack that refuses a mission command as not supported; None for the one that has no ack."""
    if command_id == _FOLLOW_TARGET:
        return None
    tail = bytes(_TAILS.get(command_id, 0))
    if command_id == _ADD_WAYPOINT and value:
        tail = value[:1]
    return bytes((NOT_SUPPORTED,)) + tail
