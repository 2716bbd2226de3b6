"""Calls that are wrong, whatever the aircraft says."""

from __future__ import annotations

from m100link.errors.base import M100Error

__all__ = [
    "BadKey",
    "BadSetpoint",
    "BadURL",
    "PayloadTooLarge",
    "UsageError",
]


class UsageError(M100Error, ValueError):
    """The call itself is wrong; nothing was sent."""


class BadURL(UsageError):
    """The connection string names no transport that exists."""


class BadKey(UsageError):
    """A key is 32 bytes or 64 hex digits. The message never contains the key."""


class BadSetpoint(UsageError):
    """A setpoint value is not finite or lies outside the range of its control mode."""


class PayloadTooLarge(UsageError):
    """The data do not fit into one frame (document 1.2) or one transparent message (2.2.1.3)."""
