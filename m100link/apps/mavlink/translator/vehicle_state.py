"""The state of one vehicle: its phase and flight mode, what they admit, and their messages.

The tables of modes decide about each mode request. Everything else is read from the view of the
moment.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum

from m100link.apps.agent.client import AgentClient
from m100link.apps.agent.control_session import ControlSession
from m100link.apps.agent.orders import GuidedOrder
from m100link.apps.mavlink.translator.codec import MavlinkMessage
from m100link.apps.mavlink.translator.numbers import BaseMode, SystemStatus
from m100link.geodesy import LocalFrame
from m100link.protocol.commands.gimbal import TakePhoto
from m100link.protocol.firmware import PROFILES
from m100link.protocol.records import Attitude, Battery, Position, RcMode

# -- flight modes: their names and numbers, and the mode requests that each phase takes ------------
# The numbers of ``custom_mode`` are those of PX4, because ground stations know them; the protocol
# of standard modes names the same modes for programs that ask instead of knowing.


class Mode(Enum):
    HOLD = "Hold"
    TAKEOFF = "Takeoff"
    MISSION = "Mission"
    RTL = "Return"
    LAND = "Land"
    OFFBOARD = "Offboard"
    POSCTL = "Position"
    ALTCTL = "Altitude"
    ORBIT = "Orbit"
    # Not a mode of MAVLink: hold, with a place to fly to first.
    GOTO = "Go to"


@dataclass(frozen=True, slots=True)
class ModeRow:
    main: int  # main mode of PX4
    sub: int  # its sub mode
    standard: int  # MAV_STANDARD_MODE; 0 for none
    base: BaseMode  # what else the heartbeat says of it
    is_selectable: bool  # whether a ground station may ask for it by its number
    meaning: str  # what the M100 does, for the manual

    @property
    def number(self) -> int:
        """``custom_mode``."""
        return self.main << 16 | self.sub << 24


_AUTO = BaseMode.AUTO | BaseMode.GUIDED

MODES: dict[Mode, ModeRow] = {
    Mode.HOLD: ModeRow(4, 3, 0, _AUTO, True, "hovers; also flies to a commanded place"),
    Mode.TAKEOFF: ModeRow(4, 2, 8, _AUTO, True, "the autopilot's take-off, then a climb"),
    Mode.MISSION: ModeRow(4, 4, 6, _AUTO, True, "flies the uploaded mission"),
    Mode.RTL: ModeRow(4, 5, 5, _AUTO, True, "the autopilot's return home, and landing"),
    Mode.LAND: ModeRow(4, 6, 7, _AUTO, True, "the autopilot's landing in place"),
    Mode.OFFBOARD: ModeRow(6, 0, 0, BaseMode.GUIDED, True, "setpoints of a program"),
    Mode.POSCTL: ModeRow(3, 0, 1, BaseMode.MANUAL, True, "sticks are velocities; the pilot in P"),
    Mode.ALTCTL: ModeRow(2, 0, 4, BaseMode.MANUAL, True, "sticks are tilts; the pilot in A"),
    Mode.ORBIT: ModeRow(3, 1, 2, _AUTO, False, "circles a place, looking at it"),
}


class VehiclePhase(Enum):
    """Where the flight stands by what aircraft and agent report, never by a mode request."""

    AWAY = "no aircraft is heard"
    OTHER = "another client of the station has control"
    DISARMED = "on the ground, control authority is not held"
    ARMED = "on the ground, control authority is held"
    AIRBORNE = "in the air, control authority is held"
    FREE = "in the air, the mode switch is in F, and nobody has control authority"
    PILOT = "the pilot flies"


REMEDIES: dict[VehiclePhase, str] = {
    VehiclePhase.DISARMED: "on the ground: arm, and take off first",
    VehiclePhase.ARMED: "on the ground: take off first",
    VehiclePhase.FREE: "control authority is not held: arm first",
}
"""Why a mode request is refused in a phase that a ground station can change."""


class ModeVerdict(Enum):
    START = "it begins"
    OBTAIN = "control authority is obtained, then it begins"
    REMEMBER = "it begins when the aircraft is armed, if that is soon"
    NOTHING = "it is so already"
    DENY = "it cannot be: asking again changes nothing"
    REJECT = "not now"


_V, _M = ModeVerdict, Mode

_FROM_THE_AIR = (_M.POSCTL, _M.ALTCTL, _M.ORBIT, _M.GOTO)
_REMEMBERED = (_M.TAKEOFF, _M.MISSION, _M.OFFBOARD)
_ENDS = (_M.HOLD, _M.LAND, _M.RTL)

VERDICTS: dict[VehiclePhase, dict[Mode, ModeVerdict]] = {
    VehiclePhase.AWAY: dict.fromkeys(_M, _V.REJECT),
    VehiclePhase.OTHER: dict.fromkeys(_M, _V.REJECT),
    # QGroundControl asks for a take-off or a mission first, and arms when that was accepted.
    VehiclePhase.DISARMED: dict.fromkeys(_REMEMBERED, _V.REMEMBER)
    | dict.fromkeys(_ENDS, _V.NOTHING)
    | dict.fromkeys(_FROM_THE_AIR, _V.DENY),
    VehiclePhase.ARMED: dict.fromkeys(_REMEMBERED, _V.START)
    | dict.fromkeys(_ENDS, _V.NOTHING)
    | dict.fromkeys(_FROM_THE_AIR, _V.DENY),
    VehiclePhase.AIRBORNE: dict.fromkeys(_M, _V.START) | {_M.TAKEOFF: _V.DENY},
    # A station that wants more than an end of the flight arms first.
    VehiclePhase.FREE: dict.fromkeys(_M, _V.REJECT) | dict.fromkeys(_ENDS, _V.OBTAIN),
    VehiclePhase.PILOT: dict.fromkeys(_M, _V.REJECT),
}
"""Phase of the flight, mode request, verdict."""


class FlightSource(Enum):
    NOTHING = "nothing"
    TAKE_OFF = "the autopilot's take-off"
    LAND = "the autopilot's landing"
    GO_HOME = "the autopilot's way home"
    FLIGHT = "a flight of the agent: a place, a height, a circle, a mission"
    MISSION = "a mission that the aircraft flies by itself"
    PAUSED = "a mission of the aircraft that hovers until it goes on"
    STREAM = "setpoints of a program or of sticks"


class ModeTransition(Enum):
    """How a mode request that begins takes over from what flies."""

    REPLACE = "what flies ends at once, the mode request begins"
    WAIT = "it begins when what flies has ended; the newest waits, but a way to the ground stays"
    INTERRUPT = "authority goes back and is obtained again, which ends what flies; then it begins"
    KEEP = "it is what flies; a mission that was changed is stopped, and begins anew"
    PAUSE = "the aircraft hovers and keeps its mission"
    RESUME = "the aircraft goes on with its mission; one that was changed is stopped, and begins"
    STOP = "the bridge stops the mission of the aircraft; then the mode request begins"
    REFUSE = "what flies goes on"


_S, _R = ModeTransition, FlightSource
_LANDING = dict.fromkeys(_M, _S.REFUSE) | {_M.HOLD: _S.INTERRUPT}

RUNNING: dict[FlightSource, dict[Mode, ModeTransition]] = {
    _R.NOTHING: dict.fromkeys(_M, _S.REPLACE),
    # The aircraft ignores setpoints until its take-off is over, and refuses a landing.
    _R.TAKE_OFF: dict.fromkeys(_M, _S.WAIT) | {_M.TAKEOFF: _S.KEEP},
    _R.LAND: _LANDING | {_M.LAND: _S.KEEP, _M.RTL: _S.INTERRUPT},
    _R.GO_HOME: _LANDING | {_M.RTL: _S.KEEP, _M.LAND: _S.INTERRUPT},
    _R.FLIGHT: dict.fromkeys(_M, _S.REPLACE),
    # The aircraft ignores setpoints and tasks as long as it has a mission.
    _R.MISSION: dict.fromkeys(_M, _S.STOP) | {_M.HOLD: _S.PAUSE, _M.MISSION: _S.KEEP},
    _R.PAUSED: dict.fromkeys(_M, _S.STOP) | {_M.HOLD: _S.KEEP, _M.MISSION: _S.RESUME},
    _R.STREAM: dict.fromkeys(_M, _S.REPLACE),
}
"""Flight source, mode request, transition."""

ARM_VERDICTS: dict[VehiclePhase, ModeVerdict] = {
    VehiclePhase.AWAY: _V.REJECT,
    VehiclePhase.OTHER: _V.REJECT,
    VehiclePhase.DISARMED: _V.START,  # a second request gets the answer of the first
    VehiclePhase.ARMED: _V.NOTHING,
    VehiclePhase.AIRBORNE: _V.NOTHING,
    VehiclePhase.FREE: _V.START,
    VehiclePhase.PILOT: _V.REJECT,
}
"""The verdict on the mode request to arm: to obtain control authority."""

DISARM_VERDICTS: dict[VehiclePhase, ModeVerdict] = {
    VehiclePhase.AWAY: _V.REJECT,
    VehiclePhase.OTHER: _V.REJECT,
    VehiclePhase.DISARMED: _V.NOTHING,  # but for a request to arm, which ends
    VehiclePhase.ARMED: _V.START,
    # The M100 has no command that stops motors in the air, forced or not.
    VehiclePhase.AIRBORNE: _V.DENY,
    VehiclePhase.FREE: _V.DENY,
    VehiclePhase.PILOT: _V.DENY,
}
"""The verdict on the mode request to disarm: to give control authority back."""


# -- where the flight stands, by the view of the moment --------------------------------------------
# Home is kept here: the wire has no item for it.

_MISSIONS = ("waypoint mission", "hotpoint", "follow mission")  # flown by the aircraft itself
_TASKS = {"take off": Mode.TAKEOFF, "land": Mode.LAND, "go home": Mode.RTL}
_BY_SWITCH = {RcMode.P: Mode.POSCTL, RcMode.F: Mode.POSCTL, RcMode.A: Mode.ALTCTL}


@dataclass(frozen=True, slots=True)
class Home:
    """Where the aircraft stood last, with a position by GPS."""

    frame: LocalFrame  # whose origin it is
    altitude_m: float  # barometric altitude, as the wire has it


CAMERA = 100  # MAV_COMP_ID_CAMERA


@dataclass(slots=True)
class PayloadState:
    """Camera and gimbal as they were ordered here: the aircraft confirms nothing."""

    is_recording: bool = False
    interval_s: float = 0.0  # between photos; 0 where none is set
    is_locked: bool = True  # whether the gimbal's yaw stays with north
    primary: tuple[int, int] = (0, 0)  # system and component with control of the gimbal, 0 for none
    secondary: tuple[int, int] = (0, 0)


class VehicleState:
    def __init__(self, known: AgentClient, session: ControlSession) -> None:
        self.known = known
        self.session = session  # control by the bridge
        # Whether a take-off was called off, and the aircraft may fly it all the same.
        self.may_take_off = False
        self.home: Home | None = None  # where it stood last; None while nobody knows
        # The leg of a flight that is under way; None without one.
        self.target: Callable[[], GuidedOrder | None] = lambda: None
        # Whether it is known to be inside of the fence; None without one.
        self.is_fenced: Callable[[], bool | None] = lambda: None
        self.payload = PayloadState()

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

    @property
    def has_payload(self) -> bool:
        """Whether the firmware has orders for camera and gimbal; nothing shows what hangs there."""
        profile = PROFILES.get(self.known.view.state.firmware)
        return profile is not None and TakePhoto.is_known_to(profile)

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
        if phase is VehiclePhase.OTHER:
            return f"{self.known.view.holder.name} has control"
        if phase is VehiclePhase.PILOT:
            switch = self.known.view.switch
            place = "unknown" if switch is None else f"in {switch.name}"
            return f"the pilot flies: the mode switch is {place}"
        return REMEDIES.get(phase, str(phase.value))

    @property
    def flies_mission(self) -> bool:
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


# -- phase and mode as messages: HEARTBEAT; AVAILABLE_MODES and CURRENT_MODE for those that ask ----

LOWEST_BATTERY = 20  # percent below which the agent refuses to take off: not ready to arm

_ADVANCED, _NOT_SELECTABLE = 1, 2


def mode_of_number(main: int, sub: int) -> Mode | None:
    """The mode of that ``custom_mode``; None where the M100 has none, or it is not asked for so."""
    return _selectable(lambda row: (row.main, row.sub) == (main, sub))


def mode_of_standard(number: int) -> Mode | None:
    return _selectable(lambda row: row.standard == number != 0)


def _selectable(is_it: Callable[[ModeRow], bool]) -> Mode | None:
    return next((one for one, row in MODES.items() if is_it(row) and row.is_selectable), None)


def available(index: int) -> list[MavlinkMessage]:
    """AVAILABLE_MODES: one by its number from 1, all of them for 0; empty where there is none."""
    return [_available(one, mode) for one, mode in enumerate(MODES, 1) if index in (0, one)]


def _available(index: int, mode: Mode) -> MavlinkMessage:
    row = MODES[mode]
    properties = 0 if row.is_selectable else _NOT_SELECTABLE
    if mode is Mode.OFFBOARD:
        properties |= _ADVANCED
    return MavlinkMessage(
        "AVAILABLE_MODES",
        {
            "number_modes": len(MODES),
            "mode_index": index,
            "standard_mode": row.standard,
            "custom_mode": row.number,
            "properties": properties,
            "mode_name": mode.value,
        },
    )


def current(mode: Mode) -> MavlinkMessage:
    row = MODES[mode]
    fields = {
        "standard_mode": row.standard,
        "custom_mode": row.number,
        "intended_custom_mode": row.number,
    }
    return MavlinkMessage("CURRENT_MODE", fields)


def heartbeat(world: VehicleState, mode: Mode, autopilot: int) -> MavlinkMessage:
    row, is_armed = MODES[mode], world.is_armed
    battery = world.known.view.get(Battery)
    is_low = battery is not None and battery.percent < LOWEST_BATTERY and is_armed
    status = SystemStatus.ACTIVE if is_armed else SystemStatus.STANDBY
    fields = {
        "custom_mode": row.number,
        "type": 2,
        "autopilot": autopilot,
        "base_mode": BaseMode.CUSTOM | row.base | (BaseMode.ARMED if is_armed else 0),
        "system_status": SystemStatus.CRITICAL if is_low else status,
        "mavlink_version": 3,
    }
    return MavlinkMessage("HEARTBEAT", fields)
