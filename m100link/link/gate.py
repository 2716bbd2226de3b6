"""A gate that can hold back writes on a line that another process shares."""

from __future__ import annotations

import asyncio
import os
import select
import selectors
import signal
import threading
from typing import Protocol
from weakref import WeakSet

from m100link.errors import LinkClosed

GUARDIAN_NAME = "m100link-guard"
"""Process name of the guardian, which ends the flight of a program that cannot."""


class WriteGate(Protocol):
    """The line asks it before each write, and reports to it afterwards."""

    def opens(self, size: int) -> bool:
        """Return whether the line may write so many bytes now."""
        ...

    def wrote(self, waiting: int) -> None:
        """Note a write, and how many bytes still wait in this process."""


def descriptor_of(transport: asyncio.BaseTransport | None) -> int | None:
    """The open file behind a transport, None where another process could not write to it."""
    if transport is None:
        return None
    for name in ("serial", "socket"):
        if (line := transport.get_extra_info(name)) is not None:
            number = line.fileno() if os.name == "posix" else 0  # of no use to a guardian there
            return number if isinstance(number, int) and number >= 0 else None
    return None


# -- detach a forked child from the line and the event loop of its parent --------------------------
# A child shares the parent's open files. When it leaves the coroutine in which it was forked (an
# exception, ``sys.exit``, ``return``), its event loop would remove the line from the parent's
# epoll. The parent would then receive and send nothing, while its last setpoint stays in force.


_EPOLLS = (selectors.EpollSelector,) if hasattr(selectors, "EpollSelector") else ()  # Linux


class Inherited(Protocol):
    """A resource that a child inherits and must not use."""

    def after_fork(self) -> None:
        """Let go of it, in the child. Raises nothing."""


_inherited: WeakSet[Inherited] = WeakSet()


def lose_at_fork(inherited: Inherited) -> None:
    """Register a resource: the child of each fork lets go of it."""
    _inherited.add(inherited)


def _after_fork() -> None:
    for inherited in list(_inherited):
        inherited.after_fork()
    _inherited.clear()


def lose_line(
    transport: asyncio.BaseTransport, loop: asyncio.AbstractEventLoop, name: str
) -> LinkClosed:
    """Let go of a line and of its event loop, in the child; returns why it is closed there."""
    port = transport.get_extra_info("serial", transport.get_extra_info("socket"))
    if port is not None:
        _lose_file(port.fileno())
    _lose_loop(loop)
    return LinkClosed(
        f"{name} belongs to the process from which this one was forked",
        cause="a child has no part in the line of its parent",
        remedy="fork before connect(), and fly from one process",
    )


def _lose_file(descriptor: int) -> None:
    """Put a file that takes all and gives nothing in the place of one that is the parent's too."""
    try:
        nothing = os.open(os.devnull, os.O_RDWR)
    except OSError:  # no descriptor is left
        os.close(descriptor)
        return
    os.dup2(nothing, descriptor, inheritable=False)
    os.close(nothing)


def _lose_loop(loop: asyncio.AbstractEventLoop) -> None:
    """Give an event loop of asyncio a selector of its own, which nothing wakes but its timers.

    uvloop does that by itself.
    """
    # Neither has a public name; where they are called otherwise, the child is as it always was.
    selector = getattr(loop, "_selector", None)
    if selector is not None and isinstance(selector, _EPOLLS):
        try:
            with select.epoll() as own:
                os.dup2(own.fileno(), selector.fileno(), inheritable=False)
        except OSError:  # no descriptor is left
            selector.close()
    waker = getattr(loop, "_csock", None)
    if waker is not None and threading.current_thread() is threading.main_thread():
        before = signal.set_wakeup_fd(-1)
        if before != waker.fileno():
            signal.set_wakeup_fd(before)  # of somebody else


if hasattr(os, "register_at_fork"):  # not on Windows
    os.register_at_fork(after_in_child=_after_fork)
