"""Calls that are wrong, whatever the aircraft says."""

from __future__ import annotations

import sys
from collections.abc import Callable
from importlib import import_module
from typing import Any
from warnings import warn

from m100link.errors.base import M100Error

__all__ = [
    "BadKey",
    "BadPlan",
    "BadSetpoint",
    "BadURL",
    "BadValue",
    "NoRouter",
    "OnlyRecorded",
    "PayloadTooLarge",
    "UsageError",
]


class UsageError(
    M100Error,
    ValueError,
    code="M100-USAGE",
    cause="an argument, an option or a file says what cannot be",
    remedy="read what was seen; nothing was sent, and as things are, the call is refused again",
):
    """The call itself is wrong; nothing was sent."""


def loads(room: str, *places: str) -> Callable[[str], Any]:
    """A ``__getattr__`` of a room that loads a public name from these modules when it is asked for.

    Its names are in the first of them that has it.
    """

    def load(name: str) -> Any:
        here = vars(sys.modules[room])
        for place in places if name in here["__all__"] else ():
            module = import_module(f"{room}.{place}")
            if hasattr(module, name):
                here[name] = getattr(module, name)
                return here[name]
        raise AttributeError(f"module {room!r} has no attribute {name!r}")

    return load


INSTALL = "pip install '.[{}]' in a clone of m100link"
"""How an extra is installed. Nobody owns the name m100link at PyPI: a release changes this line."""


def of_extra(module: str, purpose: str, extra: str, instead: str = "") -> Any:
    """A module that needs packages of an extra. Raises UsageError: one is not installed."""
    try:
        return import_module(module)
    except ModuleNotFoundError as error:
        raise UsageError(
            f"{purpose} needs {error.name}, which is not installed",
            remedy=INSTALL.format(extra) + instead,
        ) from None


class NoRouter(
    UsageError,
    code="M100-NO-ROUTER",
    cause="none runs there, a firewall is between, or it wants a certificate: nobody tells which",
    remedy="start the router, and see that both name the same endpoint",
):
    """No zenoh router answered; nothing was sent."""


def unread(name: object, error: OSError) -> UsageError:
    """The error of a file that cannot be read. ``name``: its path, or words with it."""
    remedy = "check the path, and who may read it"
    if isinstance(error, IsADirectoryError):
        remedy = "check the path: name a file in that folder"
    return UsageError(f"{name} cannot be read: {error.strerror or error}", remedy=remedy)


def of_another_loop(name: str = "aircraft.link.loop") -> UsageError:
    """The error of a call outside the event loop in which the connection was made."""
    return UsageError(
        "the connection belongs to another event loop than the one that runs here, if any",
        cause="another thread uses it, or it was made by an asyncio.run() that has ended",
        remedy="connect and fly in the same asyncio.run(); from another thread "
        f"asyncio.run_coroutine_threadsafe(..., {name}), or for what does not wait "
        f"{name}.call_soon_threadsafe(...); m100link.sync may be used by any thread",
    )


class BadURL(
    UsageError,
    code="M100-BAD-URL",
    cause="a typing error in where the aircraft is",
    remedy="write it as `serial:///dev/ttyUSB0:230400`, `tcp://host:port` or `sim://`",
):
    """The connection string names no transport that exists."""


class BadKey(
    UsageError,
    code="M100-BAD-KEY",
    cause="a key that was cut when it was copied, or an app id in its place",
    remedy="copy the enc key of your app again: 64 hex digits",
):
    """A key is 32 bytes or 64 hex digits. The message never contains the key."""


class BadValue(
    UsageError,
    code="M100-BAD-VALUE",
    cause="a field of a command is outside its documented range, or not a number",
    remedy="look at `field`, `value` and `limit` of the error",
):
    """A field of a command lies outside its documented range, or is not a number.

    Attributes:
        field: Name of the field on the wire.
        value: The value.
        limit: The permitted values, in words.
    """

    field: str = ""
    value: object = None
    limit: str = ""


class BadSetpoint(
    UsageError,
    code="M100-BAD-SETPOINT",
    cause="a division by zero in the program, or another unit than the mode takes",
    remedy="look at the ranges of the control modes in the reference of setpoints",
):
    """A setpoint value is not finite or lies outside the range of its control mode."""


class BadPlan(
    UsageError,
    code="M100-BAD-PLAN",
    cause="a plan made for another aircraft, or a file that is none",
    remedy="`m100link plan check FILE` names each point and what it may be",
):
    """A plan that the aircraft would refuse, or a file that is none.

    Attributes:
        point: Index of the waypoint, counted from 0 as in the plan's list; None if it is the whole.
        field: The wrong field, as the plan names it, such as ``"height"``.
        value: Its value.
        limit: Its permitted values: the lowest and highest number, a number, or the choices.
        others: The other faults of the same plan.
    """

    point: int | None = None
    field: str = ""
    value: object = None
    limit: object = None
    others: tuple[BadPlan, ...] = ()

    @property
    def problems(self) -> tuple[BadPlan, ...]:
        """Everything that is wrong, this first."""
        return (self, *self.others)


class OnlyRecorded(
    UsageError,
    code="M100-ONLY-RECORDED",
    cause="the aircraft of a replay is a recording: nobody is there who could obey",
    remedy="look at what was recorded; to fly, connect to an aircraft, or to `sim://`",
):
    """Something was asked of the aircraft of a replay; nothing was sent."""


class PayloadTooLarge(
    UsageError,
    code="M100-PAYLOAD-TOO-LARGE",
    cause="more data than a frame or a transparent message takes",
    remedy="send it in pieces",
):
    """The data do not fit into one frame (document 1.2) or one transparent message (2.2.1.3)."""


def renamed(module: str, **now: str) -> Callable[[str], object]:
    """The ``__getattr__`` of a module whose documented classes have other names now."""

    def look(name: str) -> object:
        if name not in now:
            raise AttributeError(f"module {module!r} has no attribute {name!r}")
        warn(f"{module}.{name} is {now[name]} now", DeprecationWarning, stacklevel=2)
        return getattr(sys.modules[module], now[name])

    return look
