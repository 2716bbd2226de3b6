"""The bridge's knowledge of one aircraft: fresh telemetry, home, and where the flight stands.

Everything is read from the view of the moment. Home is kept here: the wire has no item for it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from m100link.apps.agent.client import AgentClient
from m100link.apps.agent.control_session import ControlSession
from m100link.apps.mavlink.translator.modes import REMEDIES, Mode, VehiclePhase
from m100link.geodesy import LocalFrame
from m100link.protocol.records import Attitude, Position, RcMode

_MISSIONS = ("waypoint mission", "hotpoint", "follow mission")
"""Kinds of which the aircraft tells and that it flies by itself."""

_TASKS = {"take off": Mode.TAKEOFF, "land": Mode.LAND, "go home": Mode.RTL}
_BY_SWITCH = {RcMode.P: Mode.POSCTL, RcMode.F: Mode.POSCTL, RcMode.A: Mode.ALTCTL}


@dataclass(frozen=True, slots=True)
class Home:
    """Where the aircraft stood last, with a position by GPS."""

    frame: LocalFrame  # whose origin it is
    altitude_m: float  # barometric altitude, as the wire has it


class VehicleState:
    def __init__(self, known: AgentClient, session: ControlSession) -> None:
        self.known = known
        self.session = session  # control by the bridge
        # Whether a take-off was called off, and the aircraft may fly it all the same.
        self.may_take_off = False
        self.home: Home | None = None  # where it stood last; None while nobody knows

    # -- telemetry -------------------------------------------------------------------------------

    @property
    def height(self) -> float | None:
        """Metres above the take-off point; 0 where it stands."""
        view = self.known.view
        position = view.get(Position)
        if position is None:
            return None
        return 0.0 if view.is_on_ground else position.height_m

    @property
    def ground_altitude(self) -> float | None:
        """Barometric altitude of the take-off point, m."""
        position, height = self.known.view.get(Position), self.height
        if position is None or height is None:
            return None
        return position.altitude_m - height

    @property
    def local(self) -> tuple[float, float, float] | None:
        """Metres north, east and up of home."""
        position, height = self.known.view.place, self.height
        if position is None or height is None or self.home is None:
            return None
        place = self.home.frame.to_local(position.latitude_deg, position.longitude_deg)
        return (*place, height)

    @property
    def yaw_deg(self) -> float | None:
        """Heading, °."""
        attitude = self.known.view.get(Attitude)
        return None if attitude is None else attitude.yaw_deg

    def look(self) -> None:
        view = self.known.view
        if not view.is_on_ground or (position := view.place) is None:
            return
        home = self.home
        if home is not None and abs(home.altitude_m - position.altitude_m) < 0.5:
            north, east = home.frame.to_local(position.latitude_deg, position.longitude_deg)
            if math.hypot(north, east) < 1.0:
                return  # the origin of the local frame does not follow the noise of GPS
        frame = LocalFrame(position.latitude_deg, position.longitude_deg)
        self.home = Home(frame, position.altitude_m)

    # -- the flight ------------------------------------------------------------------------------

    @property
    def is_armed(self) -> bool:
        """Whether the motors may turn: they do, nobody knows, or a program has control.

        People who read this put a hand to the propellers: an unknown state counts as armed.
        """
        view = self.known.view
        is_standing = view.is_on_ground is True and not self.may_take_off
        return not is_standing or view.has_authority

    @property
    def phase(self) -> VehiclePhase:
        view = self.known.view
        if not view.is_heard:
            return VehiclePhase.AWAY
        on_ground = view.is_on_ground
        if self.session.is_obeyed:
            return VehiclePhase.ARMED if on_ground else VehiclePhase.AIRBORNE
        if self.session.is_others:
            return VehiclePhase.OTHER
        if on_ground:
            return VehiclePhase.DISARMED
        return VehiclePhase.FREE if view.switch is RcMode.F else VehiclePhase.PILOT

    def explain(self, phase: VehiclePhase) -> str:
        """Why a mode request is refused in a phase."""
        if phase is VehiclePhase.OTHER:
            return f"{self.known.view.holder.name} has control"
        if phase is VehiclePhase.PILOT:
            switch = self.known.view.switch
            place = "unknown" if switch is None else f"in {switch.name}"
            return f"the pilot flies: the mode switch is {place}"
        return REMEDIES.get(phase, str(phase.value))

    @property
    def flies_mission(self) -> bool:
        """Whether the aircraft reports that it flies a mission of any program."""
        view = self.known.view
        return view.state.mission in _MISSIONS and view.is_connected

    def mode_of_others(self) -> Mode:
        """The mode in which others fly, when the bridge does not."""
        view, phase = self.known.view, self.phase
        if phase is VehiclePhase.OTHER and view.has_authority:
            if view.state.task in _TASKS:
                return _TASKS[view.state.task]
            if self.flies_mission:
                return Mode.MISSION
            return Mode.HOLD if view.state.guided is not None else Mode.POSCTL
        if phase is VehiclePhase.FREE and self.flies_mission:
            return Mode.MISSION  # of a program that is gone, or a phone
        switch = view.switch
        if phase in (VehiclePhase.DISARMED, VehiclePhase.ARMED) and switch in (None, RcMode.F):
            return Mode.HOLD
        return Mode.POSCTL if switch is None else _BY_SWITCH[switch]
