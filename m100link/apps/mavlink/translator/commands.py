"""MAV_CMD: what each command does, and its answer. One table; the manual is made from it."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from enum import Enum

from m100link.apps.agent import orders
from m100link.apps.agent.orders import GuidedOrder
from m100link.apps.agent.preview import preview, preview_plan, require_inside
from m100link.apps.mavlink.translator.codec import LAYOUTS, Peer
from m100link.apps.mavlink.translator.flight_mode_manager import FlightModeManager
from m100link.apps.mavlink.translator.numbers import (
    RELATIVE,
    SEA_LEVEL,
    BaseMode,
    MavCommand,
    MavFrame,
    MavResult,
    Severity,
)
from m100link.apps.mavlink.translator.orders import (
    Asked,
    FlightSequence,
    HoldPosition,
    LandInPlace,
    MissionCommand,
    ModeRequest,
    ReturnToLaunch,
    TakeOffAndClimb,
    VehicleOrder,
)
from m100link.apps.mavlink.translator.payload import CAMERA_MESSAGES, Payload
from m100link.apps.mavlink.translator.route import Route
from m100link.apps.mavlink.translator.telemetry import NUMBERS, STREAMS, Rates
from m100link.apps.mavlink.translator.vehicle_state import (
    CAMERA,
    Mode,
    VehiclePhase,
    VehicleState,
    mode_of_number,
    mode_of_standard,
)
from m100link.errors import GuardRefused, UsageError

_Place = tuple[float, float]  # latitude and longitude, degrees
_ORBIT_TURNS = 200.0


class CommandProtocol:
    def __init__(
        self,
        world: VehicleState,
        manager: FlightModeManager,  # what decides about flights
        settings: Mapping[str, float],  # heights and speeds that commands leave open
        rates: Rates,  # how often telemetry is sent, which each peer may ask for
        *,
        tell: Callable[[Severity, str], None],
        # Sends a message of a component (0: any) by its number to the peer; False if it has none.
        request: Callable[[int, float, Peer, float, int], bool],
        # Makes the mode request that flies the mission; None where there is none.
        mission: Callable[[Peer, int | None], ModeRequest | None],
        payload: Payload,  # camera and gimbal
        # Why nobody may fly from a place (None: from here) to another, or around it with a radius.
        fence: Callable[[_Place | None, _Place, float], str],
    ) -> None:
        self._world = world
        self._manager = manager
        self._settings = settings
        self._rates = rates
        self._tell = tell
        self._request = request
        self._mission = mission
        self.payload = payload
        self._fence = fence
        # What DO_CHANGE_SPEED said, until the next flight is over.
        self._speed: float | None = None

    def carry_out(self, asked: Asked, now: float) -> MavResult | None:
        """The answer; None while arming takes time."""
        row = COMMANDS.get(asked.command)
        if row is None or not self._is_of(row, asked.component):
            return MavResult.UNSUPPORTED
        if any(map(math.isinf, (*asked.parameters, asked.x, asked.y, asked.z))):
            # NaN says that nothing is said; infinity has no meaning in any command.
            self._tell(Severity.WARNING, f"command {asked.command}: a parameter is not finite")
            return MavResult.DENIED
        try:
            return row.handler(self, asked, now)
        except (UsageError, GuardRefused) as error:
            self._tell(Severity.WARNING, error.seen)
            return MavResult.DENIED

    def _is_of(self, row: CommandRow, component: int) -> bool:
        """Whether that component has the command, and the aircraft what it is for."""
        if row.part in (CommandPart.AUTOPILOT, CommandPart.GIMBAL) and component == CAMERA:
            return False
        return row.part in (CommandPart.AUTOPILOT, CommandPart.ALL) or self._world.has_payload

    # -- arming and modes ------------------------------------------------------------------------

    def arm(self, asked: Asked, now: float) -> MavResult | None:
        if asked.parameters[0] == 1.0:
            return self._manager.arm(asked.peer, now)
        if asked.parameters[0] == 0.0:
            return self._manager.disarm(asked.peer)
        return MavResult.DENIED

    def set_mode(self, asked: Asked, now: float) -> MavResult:
        """DO_SET_MODE, by the numbers of PX4."""
        base, main, sub, _ = asked.parameters
        if not (_is_byte(base) and _is_byte(main)):
            return MavResult.DENIED
        if not int(base) & BaseMode.CUSTOM:
            return self._no_mode(f"base mode {int(base)}")
        # Leaving the sub mode out is how ground stations ask for modes that have none.
        mode = mode_of_number(int(main), int(sub) if _is_byte(sub) else 0)
        if mode is None:
            return self._no_mode(f"mode {int(main)}.{int(sub) if _is_byte(sub) else 0}")
        return self.request_mode(mode, asked.peer, now)

    def set_standard_mode(self, asked: Asked, now: float) -> MavResult:
        number = asked.parameters[0]
        mode = mode_of_standard(int(number)) if _is_byte(number) else None
        if mode is None:
            return self._no_mode(f"standard mode {number:g}")
        return self.request_mode(mode, asked.peer, now)

    def _no_mode(self, what: str) -> MavResult:
        self._tell(Severity.WARNING, f"{what} does not exist here, or only the RC sets it")
        return MavResult.DENIED

    def request_mode(self, mode: Mode, peer: Peer, now: float) -> MavResult:
        """A mode by its name alone."""
        if mode is Mode.TAKEOFF:
            order = TakeOffAndClimb(self._take_off_height(math.nan))
            return self._manager.request_mode(ModeRequest(mode, order, peer), now)
        if mode is Mode.MISSION:
            return self._start(peer, None, mode.value, now)
        is_steered = mode in (Mode.OFFBOARD, Mode.POSCTL, Mode.ALTCTL)
        if is_steered and not self._manager.has_setpoint(mode, peer, now):
            if self._manager.is_others(peer, mode.value):
                return MavResult.TEMPORARILY_REJECTED
            self._tell(Severity.WARNING, f"{mode.value}: no setpoint came yet")
            return MavResult.DENIED
        order_of: dict[Mode, VehicleOrder] = {
            Mode.HOLD: HoldPosition(),
            Mode.LAND: LandInPlace(),
            Mode.RTL: ReturnToLaunch(),
        }
        return self._manager.request_mode(ModeRequest(mode, order_of.get(mode), peer), now)

    # -- flights ---------------------------------------------------------------------------------

    def take_off(self, asked: Asked, now: float) -> MavResult:
        """NAV_TAKEOFF: to an altitude above sea level, or to the height of the parameter."""
        altitude = math.nan if asked.z == 0.0 else asked.z
        if asked.frame not in (*SEA_LEVEL, *RELATIVE) and math.isfinite(altitude):
            raise UsageError(f"take-off: an altitude in frame {asked.frame} cannot be flown to")
        if asked.frame in RELATIVE and math.isfinite(altitude):
            altitude += self._ground()
        order = TakeOffAndClimb(self._take_off_height(altitude))
        return self._manager.request_mode(ModeRequest(Mode.TAKEOFF, order, asked.peer), now)

    def _ground(self) -> float:
        ground = self._world.ground_altitude
        if ground is None:
            raise UsageError("take-off: the altitude of the ground is unknown")
        return ground

    def _take_off_height(self, altitude: float) -> float:
        height = self._settings["MIS_TAKEOFF_ALT"]
        if math.isfinite(altitude):
            height = altitude - self._ground()
        if height <= 0.0:
            raise UsageError(f"take-off to {height:.1f} m above the ground")
        self._check(orders.ChangeHeight(height))
        return height

    def reposition(self, asked: Asked, now: float) -> MavResult:
        """DO_REPOSITION: a place, a height, a heading, or nothing of these, which is a pause."""
        if not self._is_place(asked) and math.isnan(asked.z):
            yaw = asked.parameters[3]
            if math.isnan(yaw):
                return self.request_mode(Mode.HOLD, asked.peer, now)
            return self._fly(orders.ChangeHeading(math.degrees(yaw)), Mode.GOTO, asked.peer, now)
        height = self._height_of(asked)
        if not self._is_place(asked):
            return self._fly(orders.ChangeHeight(height), Mode.GOTO, asked.peer, now)
        yaw = asked.parameters[3]
        order = orders.FlyTo(
            asked.x,
            asked.y,
            height,
            self._speed_of(asked.parameters[0]),
            None if math.isnan(yaw) else math.remainder(math.degrees(yaw), 360.0),
        )
        return self._fly(order, Mode.GOTO, asked.peer, now)

    def orbit(self, asked: Asked, now: float) -> MavResult:
        """DO_ORBIT around a place, or around where it is.

        The altitude is above sea level whatever the frame says, as PX4 takes it: MAVSDK leaves the
        frame at "relative" and means that.
        """
        radius, speed = asked.parameters[:2]
        position = self._world.known.view.place
        if not math.isfinite(radius) or radius == 0.0:
            self._tell(Severity.WARNING, f"orbit: a radius of {radius:g} m")
            return MavResult.DENIED
        if position is None:
            self._tell(Severity.WARNING, "orbit: the position of the aircraft is unknown")
            return MavResult.TEMPORARILY_REJECTED
        here = position.latitude_deg, position.longitude_deg
        place = (asked.x, asked.y) if self._is_place(asked) else here
        order = orders.FlyAround(
            *place,
            self._height_of(replace(asked, frame=MavFrame.GLOBAL)),
            abs(radius),
            speed if math.isfinite(speed) and speed > 0 else 2.0,
            _ORBIT_TURNS,
            clockwise=radius > 0,
        )
        return self._fly(order, Mode.ORBIT, asked.peer, now)

    def pause(self, asked: Asked, now: float) -> MavResult:
        """DO_PAUSE_CONTINUE: hold, or fly the mission on."""
        is_on = asked.parameters[0] == 1.0
        return self.request_mode(Mode.MISSION if is_on else Mode.HOLD, asked.peer, now)

    def start_mission(self, asked: Asked, now: float) -> MavResult:
        first = asked.parameters[0]
        number = int(first) if math.isfinite(first) and first > 0 else None
        return self._start(asked.peer, number, "mission", now)

    def _start(self, peer: Peer, first: int | None, what: str, now: float) -> MavResult:
        if self._manager.is_others(peer, what):
            return MavResult.TEMPORARILY_REJECTED
        request = self._mission(peer, first)
        if request is None:
            self._tell(Severity.WARNING, "there is no mission to fly")
            return MavResult.DENIED
        return self._fly_mission(request, now)

    def _fly_mission(self, request: ModeRequest, now: float) -> MavResult:
        """Check each place of it first, and each way from one to the next.

        Raises GuardRefused, UsageError: see :meth:`_check`.
        """
        if isinstance(request.order, FlightSequence):
            before = None
            for leg in request.order.legs:
                before = self._check(leg, before)
            if request.order.plan is not None:
                # On the ground, what the agent would refuse when it has taken off: outside of the
                # envelope, or the battery does not last.
                known = self._world.known.view
                for refusal in preview_plan(
                    request.order.plan, known.telemetry, known.state.limits
                ):
                    raise refusal
        return self._manager.request_mode(request, now)

    def set_current(self, asked: Asked, now: float) -> MavResult:
        """DO_SET_MISSION_CURRENT: the item to continue from, at once if the mission flies."""
        number = asked.parameters[0]
        if not math.isfinite(number) or number < 0:
            return MavResult.DENIED
        if self._manager.is_others(asked.peer, "mission"):
            return MavResult.TEMPORARILY_REJECTED
        request = self._mission(asked.peer, int(number))
        if request is None:
            return MavResult.DENIED
        return (
            self._fly_mission(request, now) if self._manager.flies_mission else MavResult.ACCEPTED
        )

    def change_speed(self, asked: Asked, now: float) -> MavResult:
        """DO_CHANGE_SPEED: of a mission that the aircraft flies, and of the flights that come."""
        speed = asked.parameters[1]
        if asked.parameters[0] not in (0.0, 1.0) or not 0.0 < speed <= 10.0:
            return MavResult.DENIED
        if self._manager.is_others(asked.peer, "speed"):
            return MavResult.TEMPORARILY_REJECTED
        self._speed = speed
        if self._manager.is_flown_by_aircraft:
            self._manager.orders.append(MissionCommand(orders.SetMissionSpeed(speed)))
        return MavResult.ACCEPTED

    def _speed_of(self, wanted: float) -> float:
        if wanted > 0:  # infinity is refused with its flight
            return wanted
        return self._settings["MPC_XY_CRUISE"] if self._speed is None else self._speed

    def _is_place(self, asked: Asked) -> bool:
        if math.isnan(asked.x) or math.isnan(asked.y):
            return False
        if asked.frame not in (*SEA_LEVEL, *RELATIVE):  # elsewhere they are metres
            raise UsageError(f"a place in frame {asked.frame} cannot be flown to")
        if not (abs(asked.x) <= 89.0 and abs(asked.y) <= 180.0) or (asked.x, asked.y) == (0, 0):
            raise UsageError(f"there is no place {asked.x:.6f} {asked.y:.6f}")
        return True

    def _height_of(self, asked: Asked) -> float:
        """Metres above the take-off point; the present one where none is said."""
        height = self._world.height
        if math.isnan(asked.z):
            if height is None:
                raise UsageError("the height is unknown")
            return height
        if asked.frame in RELATIVE:
            return asked.z
        ground = self._world.ground_altitude
        if asked.frame not in SEA_LEVEL or ground is None:
            raise UsageError(f"an altitude in frame {asked.frame} cannot be flown to")
        return asked.z - ground

    def _fly(self, order: GuidedOrder, mode: Mode, peer: Peer, now: float) -> MavResult:
        if self._manager.is_others(peer, mode.value):
            return MavResult.TEMPORARILY_REJECTED
        self._check(order)
        return self._manager.request_mode(ModeRequest(mode, FlightSequence((order,)), peer), now)

    def _check(self, order: GuidedOrder, begin: _Place | None = None) -> _Place | None:
        """Refuse now what the agent would refuse in flight; give the place where the order ends.

        ``begin``: where the order before it ends, None for where the aircraft is. Raises
        GuardRefused, UsageError: outside of the envelope or the fence, or not a flight at all.
        """
        end = begin
        if isinstance(order, orders.FlyTo | orders.FlyAround):
            radius = order.radius if isinstance(order, orders.FlyAround) else 0.0
            end = order.latitude_deg, order.longitude_deg
            why = self._fence(begin, end, radius)
            if why:
                raise UsageError(f"{order.label}: {why}")
        known = self._world.known.view
        is_standing = (
            known.is_on_ground is not False or self._manager.phase is VehiclePhase.DISARMED
        )
        for error in preview(order, known.telemetry, known.state.limits).refusals:
            if isinstance(error, GuardRefused) and error.guard == "envelope":
                raise error
            if isinstance(error, UsageError) and not is_standing:
                raise error
        return end

    def refusal_of(self, route: Route) -> str:
        """Why the envelope refuses a mission, with the item; empty if it does not."""
        known = self._world.known.view
        legs: list[tuple[str, GuidedOrder]] = [
            (route.labels[leg.item], leg.order) for leg in route.legs
        ]
        if route.height is not None:
            legs.insert(0, ("take-off", orders.ChangeHeight(route.height)))
        for what, order in legs:
            try:
                require_inside((order,), known.telemetry, known.state.limits)
            except GuardRefused as error:
                return f"{what}: {error.outside}; --max-radius, --max-height widen it"
        return ""

    # -- messages and rates ----------------------------------------------------------------------

    def set_interval(self, asked: Asked, now: float) -> MavResult:
        number, interval = asked.parameters[:2]
        name = NUMBERS.get(int(number)) if math.isfinite(number) else None
        if name is None:
            return MavResult.UNSUPPORTED
        if not math.isfinite(interval):
            return MavResult.DENIED
        hz = None if interval == 0 else 0.0 if interval < 0 else 1e6 / interval
        self._rates.set_hz(name, hz, asked.peer)
        return MavResult.ACCEPTED

    def get_interval(self, asked: Asked, now: float) -> MavResult:
        """GET_MESSAGE_INTERVAL: answered by MESSAGE_INTERVAL."""
        number = asked.parameters[0]
        is_sent = math.isfinite(number) and int(number) in NUMBERS
        wanted = LAYOUTS["MESSAGE_INTERVAL"].number
        if is_sent and self._request(wanted, number, asked.peer, now, 0):
            return MavResult.ACCEPTED
        return MavResult.UNSUPPORTED

    def request_message(self, asked: Asked, now: float) -> MavResult:
        number, parameter = asked.parameters[:2]
        if not math.isfinite(number):
            return MavResult.DENIED
        if self._request(int(number), parameter, asked.peer, now, asked.component):
            return MavResult.ACCEPTED
        # One that is known, and says nothing now, may be asked for again.
        stream = STREAMS.get(NUMBERS.get(int(number), ""))
        is_known = stream is not None and asked.component in (0, stream.component)
        if stream is not None and stream.is_of_payload and not self._world.has_payload:
            is_known = False
        return MavResult.TEMPORARILY_REJECTED if is_known else MavResult.UNSUPPORTED

    def request_home(self, asked: Asked, now: float) -> MavResult:
        wanted = LAYOUTS["HOME_POSITION"].number
        is_sent = self._request(wanted, 0.0, asked.peer, now, 0)
        return MavResult.ACCEPTED if is_sent else MavResult.TEMPORARILY_REJECTED

    def request_version(self, asked: Asked, now: float) -> MavResult:
        self._request(LAYOUTS["AUTOPILOT_VERSION"].number, 0.0, asked.peer, now, 0)
        return MavResult.ACCEPTED

    # -- camera and gimbal -----------------------------------------------------------------------

    def look_at(self, asked: Asked, now: float) -> MavResult | None:
        """DO_SET_ROI_LOCATION; the altitude as in :meth:`orbit`, which MAVSDK sends likewise."""
        if not self._is_place(asked):
            raise UsageError("gimbal: the place is missing")
        height = self._height_of(replace(asked, frame=MavFrame.GLOBAL))
        return self.payload.look_at(asked, (asked.x, asked.y, height), now)


def _is_byte(value: float) -> bool:
    return math.isfinite(value) and 0 <= value <= 255


def _mode(mode: Mode) -> Callable[[CommandProtocol, Asked, float], MavResult]:
    return lambda commands, asked, now: commands.request_mode(mode, asked.peer, now)


def _ask_for(name: str) -> Callable[[CommandProtocol, Asked, float], MavResult]:
    """An older command for one message of the camera."""
    wanted = (float(LAYOUTS[name].number), 0.0, math.nan, math.nan)
    return lambda commands, asked, now: commands.request_message(
        replace(asked, parameters=wanted), now
    )


class CommandPart(Enum):
    AUTOPILOT = "autopilot"
    CAMERA = "camera"  # of component 100, or of the autopilot for it
    GIMBAL = "gimbal"  # of the autopilot, as gimbal manager
    ALL = "all"


@dataclass(frozen=True, slots=True)
class CommandRow:
    handler: Callable[[CommandProtocol, Asked, float], MavResult | None]  # what carries it out
    meaning: str  # for the manual
    part: CommandPart = CommandPart.AUTOPILOT


COMMANDS: Mapping[int, CommandRow] = {
    MavCommand.COMPONENT_ARM_DISARM: CommandRow(
        CommandProtocol.arm, "control authority; no disarming in the air, forced or not"
    ),
    MavCommand.NAV_TAKEOFF: CommandRow(
        CommandProtocol.take_off,
        "the autopilot's take-off, then a climb; waits for arming up to 10 s",
    ),
    MavCommand.NAV_LAND: CommandRow(_mode(Mode.LAND), "lands in place, and ignores a named place"),
    MavCommand.NAV_RETURN_TO_LAUNCH: CommandRow(_mode(Mode.RTL), "the autopilot's return home"),
    MavCommand.DO_SET_MODE: CommandRow(CommandProtocol.set_mode, "the modes, by PX4's numbers"),
    MavCommand.DO_SET_STANDARD_MODE: CommandRow(
        CommandProtocol.set_standard_mode, "the standard modes"
    ),
    MavCommand.DO_REPOSITION: CommandRow(
        CommandProtocol.reposition, "flies to a place, changes height or heading; without any: hold"
    ),
    MavCommand.DO_ORBIT: CommandRow(
        CommandProtocol.orbit,
        "circles a place, looking at it; altitude above sea level in every frame",
    ),
    MavCommand.DO_PAUSE_CONTINUE: CommandRow(CommandProtocol.pause, "hold, or the mission"),
    MavCommand.DO_CHANGE_SPEED: CommandRow(
        CommandProtocol.change_speed,
        "of a mission that the aircraft flies, of later flights to a place",
    ),
    MavCommand.MISSION_START: CommandRow(CommandProtocol.start_mission, "flies the mission"),
    MavCommand.DO_SET_MISSION_CURRENT: CommandRow(
        CommandProtocol.set_current, "the item to continue from"
    ),
    MavCommand.SET_MESSAGE_INTERVAL: CommandRow(
        CommandProtocol.set_interval, "up to 50 Hz, for the sender", CommandPart.ALL
    ),
    MavCommand.GET_MESSAGE_INTERVAL: CommandRow(
        CommandProtocol.get_interval, "answers MESSAGE_INTERVAL", CommandPart.ALL
    ),
    MavCommand.REQUEST_MESSAGE: CommandRow(
        CommandProtocol.request_message,
        "telemetry, version, modes, camera, gimbal",
        CommandPart.ALL,
    ),
    MavCommand.GET_HOME_POSITION: CommandRow(CommandProtocol.request_home, "answers HOME_POSITION"),
    MavCommand.REQUEST_AUTOPILOT_CAPABILITIES: CommandRow(
        CommandProtocol.request_version, "answers AUTOPILOT_VERSION"
    ),
    MavCommand.DO_GIMBAL_MANAGER_PITCHYAW: CommandRow(
        lambda one, asked, now: one.payload.point(asked, now),
        "points or turns the gimbal: pitch -90 to 30 degrees; yaw from north or from the nose",
        CommandPart.GIMBAL,
    ),
    MavCommand.DO_GIMBAL_MANAGER_CONFIGURE: CommandRow(
        lambda one, asked, now: one.payload.configure(asked, now),
        "primary and secondary control of the gimbal; it ends when its holder has gone",
        CommandPart.GIMBAL,
    ),
    MavCommand.DO_SET_ROI_LOCATION: CommandRow(
        CommandProtocol.look_at,
        "the gimbal looks there until its next order; altitude above sea level in every frame",
        CommandPart.GIMBAL,
    ),
    MavCommand.DO_SET_ROI_NONE: CommandRow(
        lambda one, asked, now: one.payload.look_at_nothing(asked, now),
        "the gimbal stays as it is",
        CommandPart.GIMBAL,
    ),
    MavCommand.IMAGE_START_CAPTURE: CommandRow(
        lambda one, asked, now: one.payload.start_photos(asked, now),
        "one photo; a number of them, or photos until they are stopped, 1 s apart at least",
        CommandPart.CAMERA,
    ),
    MavCommand.IMAGE_STOP_CAPTURE: CommandRow(
        lambda one, asked, now: one.payload.stop_photos(asked, now),
        "no more photos",
        CommandPart.CAMERA,
    ),
    MavCommand.VIDEO_START_CAPTURE: CommandRow(
        lambda one, asked, now: one.payload.record(asked, now), "records video", CommandPart.CAMERA
    ),
    MavCommand.VIDEO_STOP_CAPTURE: CommandRow(
        lambda one, asked, now: one.payload.record(asked, now), "ends the video", CommandPart.CAMERA
    ),
    **{
        MavCommand[f"REQUEST_{name}"]: CommandRow(
            _ask_for(name), f"answers {name}", CommandPart.CAMERA
        )
        for name in CAMERA_MESSAGES
    },
}
"""By number; every other one is answered UNSUPPORTED."""
