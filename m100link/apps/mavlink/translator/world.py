"""What the bridge knows of one aircraft: fresh telemetry, home, and where the flight stands.

Everything is read from what the agent tells, each time it is asked for; an item that is old is
known to nobody. Home is kept here: the wire has no item for it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Protocol, TypeVar

from m100link.apps.agent.lease import Lease
from m100link.apps.agent.messages import LeaseChanged, State
from m100link.apps.mavlink.translator.modes import REMEDIES, Mode, Phase
from m100link.geodesy import LocalFrame
from m100link.protocol.records import (
    Attitude,
    Battery,
    FlightPhase,
    FlightStatus,
    Position,
    RcMode,
    RemoteControl,
    Velocity,
)
from m100link.telemetry.integrity import Integrity, IntegrityState
from m100link.telemetry.state import AircraftState

R = TypeVar("R", bound=tuple[Any, ...])

GPS_NEEDED = 3  # GPS health from which a position is one (document 2.2.3.1)

_FRESH: dict[type[Any], float] = {FlightStatus: 2.5, Battery: 5.0}
_FRESH_S = 1.2

_MISSIONS = ("waypoint mission", "hotpoint", "follow mission")
"""Kinds of which the aircraft tells and that it flies by itself."""

_TASKS = {"take off": Mode.TAKEOFF, "land": Mode.LAND, "go home": Mode.RTL}
_BY_SWITCH = {RcMode.P: Mode.POSCTL, RcMode.F: Mode.POSCTL, RcMode.A: Mode.ALTCTL}


class Known(Protocol):
    """What is read of an :class:`~m100link.apps.agent.client.AgentClient`."""

    state: State
    holder: LeaseChanged
    telemetry: AircraftState | None

    @property
    def is_connected(self) -> bool:
        """Whether the aircraft is connected."""
        ...

    @property
    def has_authority(self) -> bool:
        """Whether setpoints and tasks are obeyed."""
        ...


@dataclass(frozen=True, slots=True)
class Home:
    """Where the aircraft stood last, with a position by GPS."""

    latitude_deg: float
    longitude_deg: float
    altitude_m: float  # barometric altitude, as the wire has it
    frame: LocalFrame  # origin of the local frame


class World:
    """One aircraft as it is now."""

    def __init__(self, known: Known) -> None:
        self.known = known
        self.lease: Lease | None = None  # the lease that the bridge has taken; None for none
        self.is_arming = False  # whether control authority is being obtained for the bridge
        # Whether a take-off was called off, and the aircraft may fly it all the same.
        self.may_take_off = False
        self.home: Home | None = None  # where it stood last; None while nobody knows

    # -- telemetry -------------------------------------------------------------------------------

    def fresh(self, record: type[R]) -> R | None:
        """The newest value of an item; None when it is old, or cannot be."""
        telemetry = self.known.telemetry
        if telemetry is None or not self.known.is_connected:
            return None
        value = telemetry.fresh(record, within=_FRESH.get(record, _FRESH_S))
        if value is None or not all(math.isfinite(one) for one in value if one is not None):
            return None
        return value

    @property
    def is_heard(self) -> bool:
        """Whether the aircraft is heard: anything of it is younger than a second or so."""
        telemetry = self.known.telemetry
        age = None if telemetry is None else telemetry.newest_age
        return self.known.is_connected and age is not None and age <= _FRESH_S

    @property
    def position(self) -> Position | None:
        """Where it is, if GPS is good enough to say so."""
        found = self.fresh(Position)
        if found is None or not found.is_possible or (found.gps_health or 0) < GPS_NEEDED:
            return None
        return found

    @property
    def integrity(self) -> Integrity:
        """Whether that can be true."""
        telemetry = self.known.telemetry
        return Integrity(IntegrityState.UNKNOWN) if telemetry is None else telemetry.integrity

    @property
    def is_on_ground(self) -> bool | None:
        """Whether the motors stand; None when nobody knows."""
        status = self.fresh(FlightStatus)
        return None if status is None else status.status == FlightPhase.STANDBY

    @property
    def height(self) -> float | None:
        """Metres above the take-off point; 0 where it stands."""
        position = self.fresh(Position)
        if position is None:
            return None
        return 0.0 if self.is_on_ground else position.height_m

    @property
    def ground_altitude(self) -> float | None:
        """Barometric altitude of the take-off point, m."""
        position, height = self.fresh(Position), self.height
        if position is None or height is None:
            return None
        return position.altitude_m - height

    @property
    def local(self) -> tuple[float, float, float] | None:
        """Metres north, east and up of home."""
        position, height = self.position, self.height
        if position is None or height is None or self.home is None:
            return None
        place = self.home.frame.to_local(position.latitude_deg, position.longitude_deg)
        return (*place, height)

    @property
    def yaw_deg(self) -> float | None:
        """Heading, °."""
        attitude = self.fresh(Attitude)
        return None if attitude is None else attitude.yaw_deg

    @property
    def velocity(self) -> Velocity | None:
        """Velocity over ground."""
        return self.fresh(Velocity)

    def look(self) -> None:
        """Note where it stands, for home."""
        position = self.position
        if position is None or not self.is_on_ground:
            return
        home = self.home
        if home is not None and abs(home.altitude_m - position.altitude_m) < 0.5:
            north, east = home.frame.to_local(position.latitude_deg, position.longitude_deg)
            if math.hypot(north, east) < 1.0:
                return  # the origin of the local frame does not follow the noise of GPS
        place = position.latitude_deg, position.longitude_deg
        self.home = Home(*place, position.altitude_m, LocalFrame(*place))

    # -- the flight ------------------------------------------------------------------------------

    @property
    def has_lease(self) -> bool:
        """Whether the lease is the bridge's."""
        return self.lease is not None and self.lease.number == self.known.holder.number

    @property
    def has_authority(self) -> bool:
        """Whether the aircraft obeys the bridge."""
        return self.has_lease and self.known.has_authority

    @property
    def is_armed(self) -> bool:
        """Whether the motors may turn: they do, nobody knows, or a program has control.

        Who reads this puts a hand to the propellers, so what is unknown counts as armed.
        """
        is_standing = self.is_on_ground is True and not self.may_take_off
        return not is_standing or self.known.has_authority

    @property
    def switch(self) -> RcMode | None:
        """The pilot's mode switch; None when nobody knows."""
        remote = self.fresh(RemoteControl)
        return None if remote is None else remote.mode_switch

    @property
    def phase(self) -> Phase:
        """Where the flight stands."""
        if not self.is_heard:
            return Phase.AWAY
        if self.known.holder.number and not self.has_lease:
            return Phase.OTHER
        on_ground = self.is_on_ground
        if self.has_authority:
            return Phase.ARMED if on_ground else Phase.AIRBORNE
        if self.is_arming:
            return Phase.ARMING if on_ground else Phase.OBTAINING
        if on_ground:
            return Phase.DISARMED
        return Phase.FREE if self.switch is RcMode.F else Phase.PILOT

    def explain(self, phase: Phase) -> str:
        """Why a wish is refused in a phase."""
        if phase is Phase.OTHER:
            return f"{self.known.holder.name} has control"
        if phase is Phase.PILOT:
            place = "unknown" if self.switch is None else f"in {self.switch.name}"
            return f"the pilot flies: the mode switch is {place}"
        return REMEDIES.get(phase, str(phase.value))

    @property
    def flies_mission(self) -> bool:
        """Whether the aircraft tells that it flies a mission by itself, whoever started it."""
        return self.known.is_connected and self.known.state.mission in _MISSIONS

    def mode_of_others(self) -> Mode:
        """What flies when the bridge does not."""
        state, phase = self.known.state, self.phase
        if phase is Phase.OTHER and self.known.has_authority:
            if state.task in _TASKS:
                return _TASKS[state.task]
            if self.flies_mission:
                return Mode.MISSION
            return Mode.HOLD if state.guided is not None else Mode.POSCTL
        if phase in (Phase.FREE, Phase.OBTAINING) and self.flies_mission:
            return Mode.MISSION  # of a program that is gone, or a phone
        if phase in (Phase.DISARMED, Phase.ARMING, Phase.ARMED) and self.switch in (None, RcMode.F):
            return Mode.HOLD
        return Mode.POSCTL if self.switch is None else _BY_SWITCH[self.switch]
