"""The virtual Matrice 100: the other end of the cable, as far as the document describes it.

:class:`VirtualAircraft` is the aircraft as one object, :class:`Driver` lets time pass for it on an
event loop. ``m100link sim`` runs it for people and other programs, :mod:`m100link.testing` hands it
to test suites.
"""

from m100link.sim.autopilot import Autopilot
from m100link.sim.clock import (
    LockstepEventLoop,
    ScaledEventLoop,
    VirtualClockEventLoop,
    loop_factory,
)
from m100link.sim.commands import Counters, LastCommand
from m100link.sim.line import NO_FAULTS, Line, LineFaults
from m100link.sim.ports.driver import Driver, TcpServer, open_sim, serve_tcp
from m100link.sim.ports.pty import PtyPort
from m100link.sim.vehicle.activation import (
    DEMO_APP_ID,
    DEMO_KEY,
    ActivationServer,
    MobileApp,
    RegisteredApp,
)
from m100link.sim.vehicle.dynamics import AIRFRAMES, Airframe, Dynamics, read_airframe
from m100link.sim.vehicle.missions.route import MissionSettings, NoFlyZone
from m100link.sim.vehicle.remote import PilotRemote
from m100link.sim.vehicle.settings import (
    DEFAULT_RATES_HZ,
    AircraftSettings,
    AssistantSettings,
    Undecodable,
)
from m100link.sim.vehicle.vehicle import LogEntry, Vehicle
from m100link.sim.virtual import VirtualAircraft

__all__ = [
    "AIRFRAMES",
    "DEFAULT_RATES_HZ",
    "DEMO_APP_ID",
    "DEMO_KEY",
    "NO_FAULTS",
    "ActivationServer",
    "AircraftSettings",
    "Airframe",
    "AssistantSettings",
    "Autopilot",
    "Counters",
    "Driver",
    "Dynamics",
    "LastCommand",
    "Line",
    "LineFaults",
    "LockstepEventLoop",
    "LogEntry",
    "MissionSettings",
    "MobileApp",
    "NoFlyZone",
    "PilotRemote",
    "PtyPort",
    "RegisteredApp",
    "ScaledEventLoop",
    "TcpServer",
    "Undecodable",
    "Vehicle",
    "VirtualAircraft",
    "VirtualClockEventLoop",
    "loop_factory",
    "open_sim",
    "read_airframe",
    "serve_tcp",
]
