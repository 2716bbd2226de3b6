"""The aircraft as programs have it, and how they come to it."""

from __future__ import annotations

from m100link.aircraft.aircraft import Aircraft, AuthorityEvent, ConnectionEvent
from m100link.aircraft.connecting import Connecting, connect

__all__ = ["Aircraft", "AuthorityEvent", "Connecting", "ConnectionEvent", "connect"]
