"""The aircraft as programs have it, and how they come to it.

A name is loaded when it is first asked for: :func:`connect` loads the rest when it connects.
"""

from __future__ import annotations

TYPE_CHECKING = False
if TYPE_CHECKING:
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

if not TYPE_CHECKING:  # a checker that saw it would take every misspelt name for a name
    from m100link.errors.usage import loads

    __getattr__ = loads(__name__, "connecting", "aircraft", "payload")
