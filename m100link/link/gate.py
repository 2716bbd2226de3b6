"""A gate that can hold back writes on a line that another process shares."""

from __future__ import annotations

import asyncio
import os
from typing import Protocol

__all__ = ["GUARDIAN_NAME", "Gate", "descriptor_of"]

GUARDIAN_NAME = "m100link-guard"
"""What the system calls the process that ends the flight of a program that cannot."""


class Gate(Protocol):
    """The line asks it before each write, and reports to it afterwards."""

    def opens(self, size: int) -> bool:
        """Return whether the line may write so many bytes now."""
        ...

    def wrote(self, waiting: int) -> None:
        """Note a write, and how many bytes still wait in this process."""


def descriptor_of(transport: asyncio.BaseTransport | None) -> int | None:
    """The open file behind a transport, None where another process could not write to it."""
    if transport is None or os.name != "posix":
        return None
    for name in ("serial", "socket"):
        if (line := transport.get_extra_info(name)) is not None:
            number = line.fileno()
            return number if isinstance(number, int) and number >= 0 else None
    return None
