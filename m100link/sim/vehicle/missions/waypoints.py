"""A waypoint mission in flight: from wherever the aircraft is, past its points, to what follows."""

from __future__ import annotations

import math
from enum import Enum

from m100link.protocol.commands.missions import Finished, Reached, WaypointEvent, WaypointStatus
from m100link.sim.vehicle.dynamics import (
    STEP_S,
    Airframe,
    Dynamics,
    DynamicsInput,
    ModelYaw,
    wrapped,
)
from m100link.sim.vehicle.missions.actions import ActionRunner, MissionPayload, aim_gimbal
from m100link.sim.vehicle.missions.plan import FinishAction, StoredPlan, YawMode
from m100link.sim.vehicle.missions.route import (
    BRAKING,
    LocalPlace,
    MissionSettings,
    MissionSteering,
    Nose,
    RouteLeg,
    stopping_speed,
)
from m100link.sim.vehicle.remote import Sticks

BEFORE_ACTIONS, AFTER_ACTIONS = 4, 6  # status in the event that a waypoint was reached

_STICK_DEAD_ZONE = 0.05
_MOMENT_S = 0.2  # how long the status shows that a point was reached, or its actions are done
_STICK_APPROACH = 5.0  # m/s to the first point, where only the stick gives speed
_SHARP_TURN = 0.8  # m/s past a corner without a curve
_SIDE_FORCE = 2.0  # m/s² in curves
_TIGHT_M = 1.5  # and less in tighter ones
_TURNED = math.radians(2.0)
_GIMBAL_EVERY_S = 0.5


class WaypointPhase(Enum):
    """A phase of the mission; the value is the status that the push shows."""

    CLIMB = "climbs to the height of the first point", 0
    APPROACH = "flies to the first point", 0
    FLY = "flies", 1
    TURN = "turns to the heading of the point", 2
    BEGIN = "begins an action", 3
    ACT = "does what the point asks for", 4
    DONE = "has reached the first point, or finished the actions", 5
    REACHED = "has reached a point", 6
    RETURN_CLIMB = "climbs to the height of the first point, to end there", 1
    RETURN = "flies to the first point, to end there", 1
    WAIT = "waits at the last point", 6
    OVER = "is over", 6

    @property
    def status(self) -> int:
        """Byte 2 of the status push (docs/explanation/simulator-limits.md)."""
        return self.value[1]


class WaypointExecution:
    """One waypoint mission under way; :meth:`guide` once per step of the dynamics."""

    KIND = 1  # first byte of its status push

    def __init__(
        self,
        plan: StoredPlan,
        motion: Dynamics,
        airframe: Airframe,
        payload: MissionPayload,
        settings: MissionSettings,
    ) -> None:
        mission = plan.mission
        self.plan = plan
        self.phase = WaypointPhase.CLIMB
        self.index = 0  # the waypoint it flies to, or is at
        # M/s while nobody touches the stick; a command may change it on the way.
        self.idle_speed = mission.idle_speed
        # The events that nobody fetched yet, oldest first.
        self.events: list[WaypointEvent] = []
        self.then = FinishAction.NONE  # what comes after a mission that is over
        self._motion = motion
        self._payload = payload
        self._settings = settings
        self._steering = MissionSteering(motion, airframe)
        self._yaw_limit = math.radians(airframe.yaw_rate_deg)
        self._nose = Nose(motion.yaw, settings.turn_rate_deg)
        self._locked = motion.yaw  # the heading at the start, for the yaw mode that keeps it
        self._legs = plan.legs()
        self._leg = 0  # which of them it flies
        self._s = 0.0  # how far along, metres
        self._way: RouteLeg | None = None  # to the first point
        self._from = self._steering.here  # where it climbs before that
        self._furthest = 0  # the last waypoint whose actions were done in this run
        self._runs_left = mission.repeat
        self._moment = 0.0  # seconds left in a phase that lasts a while
        self._actions: ActionRunner | None = None
        self._since_aimed = 0.0  # seconds since the gimbal was aimed last
        self._steps = {
            WaypointPhase.CLIMB: self._climb,
            WaypointPhase.RETURN_CLIMB: self._climb,
            WaypointPhase.APPROACH: self._approach,
            WaypointPhase.RETURN: self._approach,
            WaypointPhase.FLY: self._fly,
            WaypointPhase.REACHED: self._stand,
            WaypointPhase.DONE: self._stand,
            WaypointPhase.TURN: self._turn,
            WaypointPhase.BEGIN: self._act,
            WaypointPhase.ACT: self._act,
            WaypointPhase.WAIT: self._wait,
            WaypointPhase.OVER: self._stay,
        }

    # --- what others see --------------------------------------------------------------------

    def status(self, is_paused: bool) -> WaypointStatus:
        return WaypointStatus(index=self.index, status=self.phase.status, error=0)

    @property
    def doing(self) -> str:
        return self.phase.value[0]

    @property
    def is_over(self) -> bool:
        return self.phase is WaypointPhase.OVER

    @property
    def flies_without_rc(self) -> bool:
        return self.plan.mission.rc_lost_action == 1

    # --- each step --------------------------------------------------------------------------

    def guide(self, sticks: Sticks) -> DynamicsInput:
        return self._steps[self.phase](sticks)

    def resume(self) -> None:
        """Go on after a pause, from wherever the aircraft was taken meanwhile."""
        if self.phase in (WaypointPhase.APPROACH, WaypointPhase.RETURN) and self._way is not None:
            self._way = RouteLeg.straight(self._steering.here, self.plan.places[0], 0, 0)
            self._s = 0.0
        elif self.phase is WaypointPhase.FLY:
            self._s = self._legs[self._leg].nearest(self._steering.here, self._s)

    def _climb(self, sticks: Sticks) -> DynamicsInput:
        first = self.plan.places[0]
        if self._motion.height >= first.up - 0.3:
            self._way = RouteLeg.straight(self._steering.here, first, 0, 0)
            self._s = 0.0
            is_end = self.phase is WaypointPhase.RETURN_CLIMB
            self.phase = WaypointPhase.RETURN if is_end else WaypointPhase.APPROACH
            return self._approach(sticks)
        return self._steering.hold(self._from._replace(up=first.up), *self._yaw(sticks))

    def _approach(self, sticks: Sticks) -> DynamicsInput:
        assert self._way is not None
        first = self.plan.places[0]
        if self._steering.is_at(first):
            if self.phase is WaypointPhase.RETURN:
                self.phase = WaypointPhase.OVER
            else:
                self._arrive(0)
            return self._stand(sticks)
        speed = self.idle_speed if self.idle_speed > 0.0 else _STICK_APPROACH
        return self._follow(self._way, min(speed, self.plan.mission.max_speed), sticks)

    def _fly(self, sticks: Sticks) -> DynamicsInput:
        leg = self._legs[self._leg]
        speed = self._wanted_speed(sticks)
        if speed >= 0.0 and self._has_come_to(leg.length):
            is_stop = not self.plan.is_curved or leg.last == len(self.plan.points) - 1
            if leg.last > self._furthest and is_stop:
                self._arrive(leg.last)
                return self._stand(sticks)
            if self._leg < len(self._legs) - 1:
                self._enter(self._leg + 1, 0.0)
                leg = self._legs[self._leg]
            elif speed > 0.0:  # again at the end of a route that was flown already
                is_endless = self.plan.mission.finish_action == FinishAction.ENDLESS
                self.phase = WaypointPhase.WAIT if is_endless else WaypointPhase.FLY
        elif speed < 0.0 and self._leg > 0 and self._has_come_to(0.0):
            leg = self._legs[self._leg - 1]
            self._enter(self._leg - 1, leg.length)
        before, after, share = leg.between(self._s)
        self.index = after if speed >= 0.0 else before
        guidance = self._follow(leg, speed, sticks)
        if self.plan.mission.gimbal_pitch_mode == 1:
            self._aim(before, after, share, abs(speed) / max(leg.length, 1.0))
        return guidance

    def _stand(self, sticks: Sticks) -> DynamicsInput:
        self._moment -= STEP_S
        if self._moment <= 0.0 and self.phase is WaypointPhase.REACHED:
            self._begin_actions()
        elif self._moment <= 0.0 and self.phase is WaypointPhase.DONE:
            self._leave()
        return self._stay(sticks)

    def _turn(self, sticks: Sticks) -> DynamicsInput:
        off = abs(wrapped(self._motion.yaw - self._nose.heading))
        if self._nose.has_turned and off < _TURNED:
            self._start_actions()
        return self._stay(sticks)

    def _act(self, sticks: Sticks) -> DynamicsInput:
        assert self._actions is not None
        self.phase = WaypointPhase.ACT if self._moment <= 0.0 else WaypointPhase.BEGIN
        self._moment -= STEP_S
        if self._actions.step():
            self._actions = None
            self._finish_point()
        return self._stay(sticks)

    def _wait(self, sticks: Sticks) -> DynamicsInput:
        if sticks.pitch < -_STICK_DEAD_ZONE:  # back from the end of the last leg, where it is
            self.phase = WaypointPhase.FLY
        return self._stay(sticks)

    def _stay(self, sticks: Sticks) -> DynamicsInput:
        return self._steering.hold(self.plan.places[self.index], *self._yaw(sticks))

    # --- from point to point ----------------------------------------------------------------

    def _arrive(self, index: int) -> None:
        self.index = index
        self._furthest = index
        self.events.append(WaypointEvent(Reached(index=index, status=BEFORE_ACTIONS)))
        self.phase, self._moment = WaypointPhase.REACHED, _MOMENT_S
        if index == 0 and self.plan.mission.gimbal_pitch_mode == 1:
            aim_gimbal(self._payload.gimbal, self.plan.points[0].gimbal_pitch, 1.0)

    def _begin_actions(self) -> None:
        point = self.plan.points[self.index]
        if self.plan.is_curved:
            self._finish_point()
        elif self.plan.mission.yaw_mode == YawMode.BY_POINT:
            self._nose.turn_to(math.radians(point.yaw), point.turn_mode)
            self.phase = WaypointPhase.TURN
        else:
            self._nose.look(self._motion.yaw)
            self._start_actions()

    def _start_actions(self) -> None:
        point = self.plan.points[self.index]
        actions = ActionRunner(point, self._payload, self._motion, self._nose, self._settings)
        if actions.has_actions:
            self._actions = actions
            self.phase, self._moment = WaypointPhase.BEGIN, _MOMENT_S
        else:
            self._finish_point()

    def _finish_point(self) -> None:
        self.events.append(WaypointEvent(Reached(index=self.index, status=AFTER_ACTIONS)))
        self.phase, self._moment = WaypointPhase.DONE, _MOMENT_S

    def _leave(self) -> None:
        if self.index < len(self.plan.points) - 1:
            leg = next(k for k, leg in enumerate(self._legs) if leg.first == self.index)
            self._enter(leg, 0.0)
            self.phase = WaypointPhase.FLY
            return
        self._runs_left -= 1
        self.events.append(WaypointEvent(Finished(repeat=self._runs_left)))
        finish = self.plan.mission.finish_action
        self._from = self._steering.here
        if self._runs_left > 0:
            self.index = 0
            self.phase = WaypointPhase.CLIMB
        elif finish == FinishAction.FIRST_POINT:
            self.index = 0
            self.phase = WaypointPhase.RETURN_CLIMB
        elif finish == FinishAction.ENDLESS:
            self.phase = WaypointPhase.WAIT
        else:
            self.then = finish
            self.phase = WaypointPhase.OVER

    def _enter(self, leg: int, s: float) -> None:
        self._leg, self._s = leg, s

    def _has_come_to(self, s: float) -> bool:
        leg = self._legs[self._leg]
        place = leg.at(s).place
        index = leg.last if s > 0.0 else leg.first
        if self._is_passed(index):
            return abs(self._s - s) < 0.3 and math.dist(self._steering.here, place) < 1.0
        return abs(self._s - s) < 0.3 and self._steering.is_at(place)

    def _is_passed(self, index: int) -> bool:
        """Whether the aircraft only slows down at the end of a leg, at a corner without a curve."""
        inner = 0 < index < len(self.plan.points) - 1
        return inner and (self.plan.is_curved or index <= self._furthest)

    # --- speed and direction ----------------------------------------------------------------

    def _wanted_speed(self, sticks: Sticks) -> float:
        most = self.plan.mission.max_speed
        stick = sticks.pitch if abs(sticks.pitch) > _STICK_DEAD_ZONE else 0.0
        return max(-most, min(most, self.idle_speed + stick * most))

    def _follow(self, leg: RouteLeg, speed: float, sticks: Sticks) -> DynamicsInput:
        """Fly along a leg as fast as wanted and its end and curves allow."""
        steering = self._steering
        self._s = s = leg.nearest(steering.here, self._s)
        on = leg.at(s)
        most = min(abs(speed), steering.steepest(on.tangent))
        forward = speed >= 0.0
        left = leg.length - s if forward else s
        is_passed = leg is not self._way and self._is_passed(leg.last if forward else leg.first)
        stopping = stopping_speed(left)
        if is_passed:
            stopping = math.hypot(stopping, _SHARP_TURN)
        gain = 0.0
        if stopping < most:
            most = stopping
            gain = -min(BRAKING, 0.8 * most)
        for start, end, radius in leg.curves:
            ahead = start - s if forward else s - end
            if ahead > 0.0 or start <= s <= end:
                slow = math.sqrt(_SIDE_FORCE * radius * min(1.0, radius / _TIGHT_M))
                allowed = math.sqrt(slow * slow + 2.0 * BRAKING * max(0.0, ahead))
                if allowed < most:
                    most, gain = allowed, -BRAKING if ahead > 0.0 else 0.0
        sign = 1.0 if forward else -1.0
        ahead_on = leg.at(s + sign * steering.lead(most))
        yaw = self._yaw(sticks, leg, s, ahead_on.tangent)
        return steering.along(on, ahead_on, sign * most, sign * gain, *yaw)

    def _yaw(
        self,
        sticks: Sticks,
        leg: RouteLeg | None = None,
        s: float = 0.0,
        tangent: LocalPlace | None = None,
    ) -> tuple[ModelYaw, float]:
        mode, nose = self.plan.mission.yaw_mode, self._nose
        if mode == YawMode.BY_RC and self._actions is None:
            nose.look(self._motion.yaw)
            return ModelYaw.RATE, sticks.yaw * self._yaw_limit
        if leg is None or tangent is None:
            return ModelYaw.ANGLE, nose.step()
        if mode == YawMode.AS_AT_START:
            nose.turn_to(self._locked)
        elif mode != YawMode.BY_POINT:  # along the path, and DJI's 4
            if math.hypot(tangent.north, tangent.east) > 0.1:
                nose.look(math.atan2(tangent.east, tangent.north))
        elif leg is not self._way:
            self._turn_evenly(leg, s)
        return ModelYaw.ANGLE, nose.step()

    def _turn_evenly(self, leg: RouteLeg, s: float) -> None:
        """From the heading of one point to that of the next, in the direction of the latter."""
        before, after, share = leg.between(s)
        points = self.plan.points
        turn = wrapped(math.radians(points[after].yaw - points[before].yaw))
        if points[after].turn_mode == 0 and turn < -1e-3:
            turn += 2.0 * math.pi
        elif points[after].turn_mode == 1 and turn > 1e-3:
            turn -= 2.0 * math.pi
        self._nose.turn_to(math.radians(points[before].yaw) + share * turn)

    def _aim(self, before: int, after: int, share: float, rate: float) -> None:
        """Let the gimbal's pitch change evenly from point to point."""
        self._since_aimed += STEP_S
        if self._since_aimed < _GIMBAL_EVERY_S:
            return
        self._since_aimed = 0.0
        share = min(1.0, share + rate * _GIMBAL_EVERY_S)
        start, end = (self.plan.points[index].gimbal_pitch for index in (before, after))
        aim_gimbal(self._payload.gimbal, start + share * (end - start), _GIMBAL_EVERY_S)
