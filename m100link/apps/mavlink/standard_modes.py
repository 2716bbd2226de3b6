"""The modes for programs that ask instead of knowing: AVAILABLE_MODES and CURRENT_MODE."""

from __future__ import annotations

from m100link.apps.mavlink.codec import Message
from m100link.apps.mavlink.modes import MODES, Mode

__all__ = ["available", "current", "mode_of_number", "mode_of_standard"]

_ADVANCED, _NOT_SELECTABLE = 1, 2

_SHOWN = tuple(MODES)


def mode_of_number(main: int, sub: int) -> Mode | None:
    """The mode of that ``custom_mode``; None where the M100 has none, or it is not asked for so."""
    for mode, row in MODES.items():
        if row.main == main and row.sub == sub:
            return mode if row.is_selectable else None
    return None


def mode_of_standard(number: int) -> Mode | None:
    """The mode of that MAV_STANDARD_MODE."""
    for mode, row in MODES.items():
        if number and row.standard == number:
            return mode if row.is_selectable else None
    return None


def available(index: int) -> list[Message]:
    """AVAILABLE_MODES: one by its number from 1, all of them for 0; empty where there is none."""
    wanted = range(1, len(_SHOWN) + 1) if index == 0 else [index]
    return [_available(one) for one in wanted if 1 <= one <= len(_SHOWN)]


def _available(index: int) -> Message:
    mode = _SHOWN[index - 1]
    row = MODES[mode]
    properties = 0 if row.is_selectable else _NOT_SELECTABLE
    if mode is Mode.OFFBOARD:
        properties |= _ADVANCED
    return Message(
        "AVAILABLE_MODES",
        {
            "number_modes": len(_SHOWN),
            "mode_index": index,
            "standard_mode": row.standard,
            "custom_mode": row.number,
            "properties": properties,
            "mode_name": mode.value,
        },
    )


def current(mode: Mode) -> Message:
    """CURRENT_MODE."""
    row = MODES[mode]
    fields = {
        "standard_mode": row.standard,
        "custom_mode": row.number,
        "intended_custom_mode": row.number,
    }
    return Message("CURRENT_MODE", fields)
