"""The aircraft as programs have it, and how they come to it."""

from __future__ import annotations

from m100link.aircraft.aircraft import Aircraft, AuthorityEvent, ConnectionEvent
from m100link.aircraft.connecting import Connecting, connect
from m100link.aircraft.payload import AircraftCamera, AircraftGimbal, GimbalRates

__all__ = [
    "Aircraft",
    "AircraftCamera",
    "AircraftGimbal",
    "AuthorityEvent",
    "Connecting",
    "ConnectionEvent",
    "GimbalRates",
    "connect",
]
