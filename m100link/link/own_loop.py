"""Whose event loop a connection is: another one, or a thread, would break it for its owner."""

from __future__ import annotations

import asyncio
from asyncio import _get_running_loop  # the other one raises where none runs

from m100link.errors.usage import of_another_loop

__all__ = ["require_loop"]


def require_loop(own: asyncio.AbstractEventLoop, name: str = "aircraft.link.loop") -> None:
    """Refuse a call when another event loop runs here, or its own elsewhere or nowhere.

    Args:
        own: The event loop in which the connection was made.
        name: What a program calls that one.

    Raises:
        UsageError: It is another one.
    """
    here = _get_running_loop()
    # Between two runs of its loop, as at a prompt, none runs here.
    if here is not own and (here or own.is_running() or own.is_closed()):
        raise of_another_loop(name)
