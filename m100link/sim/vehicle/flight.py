"""The flight controller: take-off, landing, go-home, hovering, setpoints.

It owns the motion (:mod:`m100link.sim.vehicle.dynamics`), the battery and the flight status, and
decides each step which guidance the aircraft follows. It does not judge the right to give orders
(:mod:`m100link.sim.vehicle.remote`).
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import replace
from enum import Enum
from math import radians

from m100link.protocol import setpoint as wire
from m100link.protocol.codes import ArmCode, TaskResultCode, TaskStartCode
from m100link.protocol.commands.control import Task
from m100link.protocol.records import Device, FlightPhase, RcMode
from m100link.sim.vehicle.dynamics import (
    STEP_S,
    Airframe,
    Dynamics,
    DynamicsInput,
    ModelHorizontal,
    ModelVertical,
    ModelYaw,
)
from m100link.sim.vehicle.remote import PilotRemote, Sticks
from m100link.sim.vehicle.settings import AircraftSettings

# -- the flight mode commands: one at a time, the result kept (document 2.2.2.2) -------------------
# ::
#
#     IDLE       --start, conditions met--> EXECUTING   answer 2; not met: answer 1, nothing changes
#     EXECUTING  --start-->                 EXECUTING   answer 1
#     EXECUTING  --query-->                 EXECUTING   answer 3; another sequence number: 1
#     EXECUTING  --end-->                   SUCCEEDED or FAILED
#     ended      --query-->                 ended       answer 5 or 4; another sequence number: 1
#     ended      --start-->                 like IDLE


class TaskState(Enum):
    """The state of the current task, and the answer to a query of it."""

    IDLE = TaskResultCode.NOT_CURRENT
    EXECUTING = TaskResultCode.EXECUTING
    SUCCEEDED = TaskResultCode.SUCCEEDED
    FAILED = TaskResultCode.FAILED


class TaskMachine:
    """The one task that is or was executed last."""

    def __init__(self) -> None:
        self.state = TaskState.IDLE
        self.task: Task | None = None  # which, or None before the first
        self.task_sequence: int | None = None  # the number that the onboard device gave it

    @property
    def is_executing(self) -> bool:
        """Whether a task is under way."""
        return self.state is TaskState.EXECUTING

    def start(self, task_sequence: int, task: Task | None, conditions_met: bool) -> TaskStartCode:
        """Answer 0x01/0x01. ``task`` is None for a number that is not a task."""
        if self.is_executing or task is None or not conditions_met:
            return TaskStartCode.REJECTED
        self.state = TaskState.EXECUTING
        self.task = task
        self.task_sequence = task_sequence
        return TaskStartCode.STARTED

    def query(self, task_sequence: int) -> TaskResultCode:
        """Answer 0x01/0x02; the result may be asked for any number of times."""
        if task_sequence != self.task_sequence:
            return TaskResultCode.NOT_CURRENT
        return TaskResultCode(self.state.value)

    def end(self, succeeded: bool) -> None:
        """Keep the result of the task under way; without one, nothing happens."""
        if self.is_executing:
            self.state = TaskState.SUCCEEDED if succeeded else TaskState.FAILED


# -- flight ----------------------------------------------------------------------------------------

GOOD_GPS = 3  # GPS health from which position and velocity can be controlled

_SPIN_UP_S = 1.0
_FINISHING_S = 2.0  # flight status 5 lasts two seconds, say DJI's later documents
_GROUND_IDLE_S = 1.0
_GO_HOME_SPEED = 8.0
_STILL = 0.01  # m/s: a velocity below it asks to stop


class Maneuver(Enum):
    """A manoeuvre of the flight controller's own; the onboard device's setpoints wait meanwhile."""

    NONE = "follows orders"
    SPIN_UP = "starts the motors"
    TAKE_OFF = "climbs to the take-off height"
    CLIMB_HOME = "climbs to the go-home height"
    FLY_HOME = "flies home"
    DESCEND = "descends to land"
    FINISH = "stops the motors"
    MISSION = "flies a mission"


# Python 3.11 finds no member in its class in less than 0.07 µs, and each step asks for these.
_FOLLOWS, _ONBOARD, _RC = Maneuver.NONE, Device.ONBOARD, Device.RC
_NOT_YET_UP = FlightPhase.STANDBY, FlightPhase.TAKING_OFF
_TILT, _, _OFFSET = wire.Horizontal
_HORIZONTALS, _VERTICALS, _YAWS = tuple(ModelHorizontal), tuple(ModelVertical), tuple(ModelYaw)
_BODY, _HEIGHT, _THRUST = wire.ReferenceFrame.BODY, wire.Vertical.HEIGHT, wire.Vertical.THRUST


class FlightController:
    """Flight status, tasks, setpoints, battery and home point of one aircraft.

    ``timeouts``: how often movement commands stopped coming in the air. ``interruptions``: how
    often :meth:`interrupt` ended what it did; a mission that sees another number than at its start
    is over.
    """

    def __init__(self, settings: AircraftSettings, airframe: Airframe) -> None:
        self._settings = settings
        # That of the firmware, unless the settings name another.
        self.dynamics = Dynamics(settings.airframe or airframe, yaw_deg=settings.heading_deg)
        self.tasks = TaskMachine()  # the flight mode command of the onboard device
        self.phase = FlightPhase.STANDBY  # flight status as telemetry shows it
        self.maneuver = Maneuver.NONE  # under way, of its own
        self.gps_health = 5  # 0 to 5
        self.battery_percent = 100.0  # 0 to 100, a float
        # Metres north and east of the origin, None while not recorded.
        self.home: tuple[float, float] | None = None
        # The last movement command that was accepted.
        self.setpoint: wire.ReceivedMove | wire.Setpoint | None = None
        self.timeouts = self.interruptions = 0
        self.now = 0.0
        # The guidance of the setpoint in effect, those that take effect later and when, and until
        # when the first counts.
        self._guidance = self._hover = self._mission_guidance = DynamicsInput()
        self._delayed: deque[tuple[float, DynamicsInput]] = deque()
        self._setpoint_until = -math.inf
        # Without GPS it cannot hold a place: level, it drifts with the wind.
        self._level = DynamicsInput(ModelHorizontal.TILT)
        # When the maneuver goes over to its next; infinite for those that end by what they reach.
        self._maneuver_until = math.inf
        # Since when it stands with running motors and no order to take off.
        self._idle_since: float | None = None
        # The battery is nearly empty: it lands, and nobody can stop that.
        self.is_forced = False

    # --- orders -----------------------------------------------------------------------------

    def move(self, setpoint: wire.ReceivedMove | wire.Setpoint) -> bool:
        """Follow a setpoint for a while, as far as the airframe can, after its dead time.

        Returns False where the aircraft ignores it.
        """
        if self.maneuver is not _FOLLOWS or not self.dynamics.motors_on:
            return False
        if setpoint.mode.horizontal is not _TILT and self.gps_health < GOOD_GPS:
            return False
        begins = self.now + self.dynamics.airframe.command_delay
        if self._delayed and self._delayed[-1][0] == begins:
            self._delayed.pop()  # overtaken within a step
        self._delayed.append((begins, self._guidance_for(setpoint)))
        self.setpoint = setpoint
        return True

    def _guidance_for(self, setpoint: wire.ReceivedMove | wire.Setpoint) -> DynamicsInput:
        horizontal, vertical, yaw_mode = setpoint.mode
        body = setpoint.frame is _BODY
        a, b, up = setpoint.x, setpoint.y, setpoint.z
        if horizontal is _TILT:
            a, b = radians(a), radians(b)
        elif horizontal is _OFFSET:
            motion = self.dynamics
            if body:
                cosine, sine = math.cos(motion.yaw), math.sin(motion.yaw)
                a, b = a * cosine - b * sine, a * sine + b * cosine
            a, b, body = motion.north + a, motion.east + b, False
        else:
            fastest = self.dynamics.airframe.horizontal_speed
            a, b = min(fastest, max(-fastest, a)), min(fastest, max(-fastest, b))
        if vertical is _HEIGHT:
            up = min(max(0.0, up), self._settings.height_limit)
        elif vertical is _THRUST:
            up = max(up, self._settings.minimum_thrust)
        kind = _HORIZONTALS[horizontal]
        smooth = setpoint.stable and kind is ModelHorizontal.VELOCITY and math.hypot(a, b) < _STILL
        if smooth:
            kind = ModelHorizontal.BRAKE
        return DynamicsInput(
            kind,
            a,
            b,
            body=body,
            vertical=_VERTICALS[vertical],
            up=up,
            yaw_mode=_YAWS[yaw_mode],
            yaw=radians(min(180.0, max(-180.0, setpoint.yaw))),
            smooth=smooth,
        )

    def start_task(self, task_sequence: int, number: int, has_authority: bool) -> TaskStartCode:
        """Begin take-off, landing or go-home for the onboard device, or reject it."""
        task = Task(number) if number in Task.__members__.values() else None
        code = self.tasks.start(task_sequence, task, has_authority and self._can(task))
        if code == TaskStartCode.STARTED:
            if task is Task.TAKE_OFF and self.dynamics.motors_on:
                # An owner saw it: accepted, announced, and it stays where it is.
                self.tasks.end(succeeded=False)
            elif task is Task.TAKE_OFF:
                self.take_off()
            elif task is Task.LAND:
                self.land()
            elif self.dynamics.on_ground:
                self.tasks.end(succeeded=True)  # it stands at home already
            else:
                self.go_home()
        return code

    def _can(self, task: Task | None) -> bool:
        if self.maneuver not in (Maneuver.NONE, Maneuver.MISSION):
            return False
        if task is Task.TAKE_OFF:
            enough = self.battery_percent > self._settings.critical_battery_percent
            return self.phase is FlightPhase.STANDBY and enough
        if task is Task.LAND:
            return self.phase is FlightPhase.IN_AIR
        if self.home is None or self.gps_health < GOOD_GPS:
            return False
        at_home = self.distance_home <= self._settings.go_home_radius
        return self.phase is FlightPhase.IN_AIR or (self.phase is FlightPhase.STANDBY and at_home)

    def arm(self, on: bool, has_authority: bool) -> ArmCode:
        """Start or stop the motors (firmware 3.1, 0x01/0x05)."""
        if not has_authority:
            return ArmCode.AUTHORITY_NEEDED
        if on == self.dynamics.motors_on:
            return ArmCode.ALREADY
        if not on and not self.dynamics.on_ground:
            return ArmCode.IN_THE_AIR
        if on:
            self.start_motors()
        else:
            self.stop_motors()
        return ArmCode.DONE

    def start_motors(self) -> None:
        """Motors idle on the ground; the home point is recorded."""
        self.dynamics.motors_on = True
        self._idle_since = None
        if self.gps_health >= GOOD_GPS:
            self.home = self.dynamics.north, self.dynamics.east

    def stop_motors(self) -> None:
        """Motors off. In the air this is a crash."""
        self.dynamics.motors_on = False
        self._forget_setpoints()
        self._begin(Maneuver.NONE)
        self.is_forced = False
        if self.dynamics.on_ground:
            self.phase = FlightPhase.STANDBY

    def toggle_motors(self) -> None:
        """The gesture of the sticks: starts the motors, or stops them, on the ground only."""
        if not self.dynamics.on_ground:
            return
        if self.dynamics.motors_on:
            self.stop_motors()
        else:
            self.start_motors()

    def take_off(self) -> None:
        """Start the motors and climb to the take-off height, on anybody's order."""
        self.start_motors()
        self.phase = FlightPhase.TAKING_OFF
        self._begin(Maneuver.SPIN_UP, self.now + _SPIN_UP_S)

    def land(self) -> None:
        """Descend where it is and stop the motors."""
        if self.dynamics.motors_on and self.phase is not FlightPhase.FINISHING_LANDING:
            self.phase = FlightPhase.LANDING
            self._begin(Maneuver.DESCEND)

    def go_home(self) -> None:
        """Climb, fly to the home point, land. Near home, or without a way there, land here."""
        motion = self.dynamics
        far = self.distance_home > self._settings.go_home_radius
        if not far or self.gps_health < GOOD_GPS:
            self.land()
        elif motion.height < self._settings.go_home_height:
            self._begin(Maneuver.CLIMB_HOME)
        else:
            self._begin(Maneuver.FLY_HOME)

    def force_landing(self) -> bool:
        """Land because the battery is nearly empty; nothing interrupts it. False when it need not.

        A landing that is under way already becomes one.
        """
        if self.is_forced or self.dynamics.on_ground or not self.dynamics.motors_on:
            return False
        if self.phase is not FlightPhase.LANDING:
            self.tasks.end(succeeded=False)
        self.is_forced = True
        self.land()
        return True

    def fly_mission(self, guidance: DynamicsInput) -> None:
        """Follow a mission, which says each step where to; setpoints wait meanwhile."""
        self._mission_guidance = guidance
        if self.maneuver is not Maneuver.MISSION:
            self._forget_setpoints()
            self._begin(Maneuver.MISSION)

    def interrupt(self) -> None:
        """End its own manoeuvre and hover: control passed to somebody else."""
        self.interruptions += 1
        self.tasks.end(succeeded=False)
        self._forget_setpoints()
        if self.is_forced or self.maneuver in (Maneuver.NONE, Maneuver.FINISH):
            return
        if self.dynamics.on_ground:
            self.stop_motors()
            return
        self.phase = FlightPhase.IN_AIR
        self._begin(Maneuver.NONE)

    def _forget_setpoints(self) -> None:
        self.setpoint = None
        self._delayed.clear()
        self._setpoint_until = -math.inf

    @property
    def distance_home(self) -> float:
        """Metres to the home point; 0 while there is none."""
        if self.home is None:
            return 0.0
        return math.hypot(self.home[0] - self.dynamics.north, self.home[1] - self.dynamics.east)

    def _begin(self, maneuver: Maneuver, until: float = math.inf) -> None:
        self.maneuver = maneuver
        self._maneuver_until = until

    # --- each step --------------------------------------------------------------------------

    def step(self, now: float, device: Device, remote: PilotRemote) -> None:
        """Move on by one step of the dynamics.

        ``now``: seconds since power-on at the end of the step. ``remote``: the pilot's sticks, used
        while the pilot holds control.
        """
        self.now = now
        motion = self.dynamics
        self._drain()
        if not motion.motors_on:
            self._fall()
            return
        if self.maneuver is _FOLLOWS:
            guidance = self._orders(device, remote)
        else:
            guidance = self._own_guidance()
        if (
            motion.height > self._settings.height_limit
            and guidance.vertical != ModelVertical.HEIGHT
        ):
            guidance = self._held_down(guidance)
        motion.step(guidance)
        if motion.on_ground:
            self._on_ground(is_idle=guidance is self._hover or guidance is self._level)
        elif self.phase in _NOT_YET_UP:
            self.phase = FlightPhase.IN_AIR

    def _fall(self) -> None:
        if not self.dynamics.on_ground:
            self.dynamics.step(self._hover)
        elif self.phase is not FlightPhase.STANDBY:
            self.phase = FlightPhase.STANDBY

    def _drain(self) -> None:
        motion = self.dynamics
        if self.battery_percent <= 0.0:
            if motion.motors_on:
                self.tasks.end(succeeded=False)
                self.stop_motors()
            return
        airframe, full = motion.airframe, motion.airframe.hover_thrust
        motion.hover_thrust = full + (airframe.empty_hover_thrust - full) * (
            1.0 - 0.01 * self.battery_percent
        )
        rate = 100.0 / (60.0 * airframe.hover_minutes)
        if not motion.motors_on:
            rate *= 0.03
        elif motion.on_ground:
            rate *= 0.25
        else:
            rate *= 0.7 + 0.3 * motion.thrust / motion.hover_thrust
        left = self.battery_percent - rate * STEP_S
        self.battery_percent = left if left > 0.0 else 0.0

    def _orders(self, device: Device, remote: PilotRemote) -> DynamicsInput:
        if device is _ONBOARD:
            while self._delayed and self._delayed[0][0] <= self.now - 0.5 * STEP_S:
                begins, self._guidance = self._delayed.popleft()
                self._setpoint_until = begins + self._settings.movement_timeout
            if self.now <= self._setpoint_until:
                return self._guidance
            if self._setpoint_until > -math.inf:
                self._setpoint_until = -math.inf
                if not self._delayed:
                    self.setpoint = None
                if not self.dynamics.on_ground:
                    self.timeouts += 1
        elif device is _RC:
            sticks = remote.sticks()
            if sticks.are_moved:
                return by_sticks(sticks, self.dynamics.airframe, self.gps_health >= GOOD_GPS)
        return self._hover if self.gps_health >= GOOD_GPS else self._level

    def _own_guidance(self) -> DynamicsInput:
        maneuver = self.maneuver
        if maneuver is Maneuver.MISSION:
            return self._mission_guidance
        if maneuver is Maneuver.TAKE_OFF:
            return self._climb_to_take_off_height()
        if maneuver is Maneuver.CLIMB_HOME or maneuver is Maneuver.FLY_HOME:
            return self._homewards()
        if maneuver is Maneuver.DESCEND:
            up = -1.5 if self.dynamics.height > 3.0 else -0.6
            return self._vertically(ModelVertical.VELOCITY, up)
        if maneuver is Maneuver.SPIN_UP and self.now >= self._maneuver_until:
            self._begin(Maneuver.TAKE_OFF)
        elif maneuver is Maneuver.FINISH and self.now >= self._maneuver_until:
            self.stop_motors()
            self.tasks.end(succeeded=True)
        return self._vertically(ModelVertical.VELOCITY, 0.0)

    def _vertically(self, vertical: ModelVertical, up: float) -> DynamicsInput:
        blind = self.gps_health < GOOD_GPS
        horizontal = ModelHorizontal.TILT if blind else ModelHorizontal.BRAKE
        return DynamicsInput(horizontal, vertical=vertical, up=up)

    def _climb_to_take_off_height(self) -> DynamicsInput:
        motion, height = self.dynamics, self._settings.take_off_height
        if abs(motion.height - height) < 0.05 and abs(motion.velocity_up) < 0.1:
            self._begin(Maneuver.NONE)
            self.tasks.end(succeeded=True)
        return self._vertically(ModelVertical.HEIGHT, height)

    def _homewards(self) -> DynamicsInput:
        motion = self.dynamics
        if self.home is None or self.gps_health < GOOD_GPS:
            self.tasks.end(succeeded=False)
            self._begin(Maneuver.NONE)
            return self._level
        north, east = self.home[0] - motion.north, self.home[1] - motion.east
        distance = math.hypot(north, east)
        bearing = math.atan2(east, north)
        speed = min(_GO_HOME_SPEED, 0.6 * distance)
        height = max(self._settings.go_home_height, motion.height)
        if self.maneuver is Maneuver.CLIMB_HOME:
            speed = 0.0
            if motion.height > self._settings.go_home_height - 0.3:
                self._begin(Maneuver.FLY_HOME)
        elif distance < 0.3 and motion.speed < 0.3:
            self.land()
        return DynamicsInput(
            ModelHorizontal.VELOCITY,
            speed * math.cos(bearing),
            speed * math.sin(bearing),
            vertical=ModelVertical.HEIGHT,
            up=height,
            yaw_mode=ModelYaw.ANGLE if distance > 3.0 else ModelYaw.RATE,
            yaw=bearing if distance > 3.0 else 0.0,
        )

    def _held_down(self, guidance: DynamicsInput) -> DynamicsInput:
        if guidance.vertical == ModelVertical.VELOCITY and guidance.up <= 0.0:
            return guidance
        return replace(
            guidance,
            vertical=ModelVertical.HEIGHT,
            up=self._settings.height_limit,
            smooth=False,
            steep=False,
        )

    def _on_ground(self, *, is_idle: bool) -> None:
        """With running motors on the ground: just landed, or about to take off."""
        if self.maneuver is Maneuver.DESCEND:
            self._touch_down()
        elif self.maneuver is Maneuver.NONE and self.phase is FlightPhase.IN_AIR:
            # Flown to the ground by setpoints or sticks: the motors stop after a moment there.
            if self._rests_for(_GROUND_IDLE_S):
                self._touch_down()
            return
        elif self.maneuver is Maneuver.NONE and is_idle:  # armed, and nothing commanded
            if self._rests_for(self._settings.armed_idle_seconds):
                self.stop_motors()
            return
        self._idle_since = None

    def _rests_for(self, seconds: float) -> bool:
        """Whether it has stood there for so long; then that begins anew."""
        if self._idle_since is None:
            self._idle_since = self.now
        if self.now - self._idle_since < seconds:
            return False
        self._idle_since = None
        return True

    def _touch_down(self) -> None:
        self.phase = FlightPhase.FINISHING_LANDING
        self._begin(Maneuver.FINISH, self.now + _FINISHING_S)


# -- what the pilot's sticks ask the aircraft for --------------------------------------------------


_FASTEST = 10.0  # m/s at full deflection


def by_sticks(sticks: Sticks, airframe: Airframe, has_gps: bool) -> DynamicsInput:
    """Velocity along the nose; in mode A, or without GPS, tilt."""
    up = sticks.throttle * airframe.vertical_speed
    yaw = sticks.yaw * radians(airframe.yaw_rate_deg)
    if sticks.mode is RcMode.A or not has_gps:
        tilt = radians(airframe.maximum_tilt_deg)
        roll, pitch = sticks.roll * tilt, -sticks.pitch * tilt
        return DynamicsInput(ModelHorizontal.TILT, roll, pitch, body=True, up=up, yaw=yaw)
    forward, right = sticks.pitch * _FASTEST, sticks.roll * _FASTEST
    return DynamicsInput(ModelHorizontal.VELOCITY, forward, right, body=True, up=up, yaw=yaw)
