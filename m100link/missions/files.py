"""Plans in files: reading, writing, and which kind a file is."""

from __future__ import annotations

import os
import stat
from pathlib import Path

from m100link.errors import BadPlan
from m100link.missions.document import load_object
from m100link.missions.qgroundcontrol import FILE_TYPE

_LARGEST = 16 * 1024 * 1024
"""Bytes; a survey of thousands of photographs has not half a megabyte."""


def read(path: str | Path) -> bytes:
    """What a file holds.

    Raises ``BadPlan``: it cannot be read, is a device, or is far too large for a plan.
    """
    found = b""
    try:
        is_device = stat.S_ISCHR(Path(path).stat().st_mode)
        if not is_device:  # a serial port would be read for ever
            with Path(path).open("rb") as file:
                found = file.read(_LARGEST + 1)
    except (OSError, ValueError) as error:
        raise _unusable(path, "read", error) from error
    if is_device:
        raise BadPlan(f"{os.fspath(path)!r} is a device, not a file", remedy="name a file")
    if len(found) > _LARGEST:
        raise BadPlan(f"{os.fspath(path)} is too large for a plan", remedy="16 MiB at most")
    return found


def write(path: str | Path, text: str) -> None:
    """Put a text into a file.

    Raises ``BadPlan``: it cannot be written.
    """
    try:
        Path(path).write_text(text, encoding="utf-8")
    except (OSError, ValueError) as error:
        raise _unusable(path, "written", error) from error


def _unusable(path: str | Path, done: str, error: Exception) -> BadPlan:
    reason = getattr(error, "strerror", None) or error
    remedy = "name a file"
    if isinstance(error, FileNotFoundError):
        remedy = "check its name" if done == "read" else "make its folder first"
    elif isinstance(error, PermissionError):
        remedy = f"see who may {'read' if done == 'read' else 'write'} it"
    return BadPlan(f"{os.fspath(path)!r} cannot be {done}: {reason}", remedy=remedy)


def is_named_plan(path: str | Path) -> bool:
    """Whether a file by its name is one of QGroundControl."""
    return os.fspath(path).lower().endswith(".plan")


def is_qgroundcontrol(text: str | bytes) -> bool:
    """Whether a text is one of QGroundControl's files.

    Raises ``BadPlan``: it is not JSON.
    """
    return load_object(text).get("fileType") == FILE_TYPE
