"""The part of the flight controller that holds a mission, judges orders about it and flies it.

::

    upload, add                     a waypoint mission and its points
    start, stop, pause, resume      waypoints; the same for hotpoint and follow
    advance()                       once per step of the dynamics, before it
    news(now)                       the notifications for the onboard device, oldest first

A mission lives here and not with who ordered it: it goes on when the program ends or the line
breaks (DJI's samples leave after the start). It ends when the flight controller does something
else, whatever wanted that (inferred): :meth:`MissionComputer.advance` notices.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeAlias

from m100link.protocol.codes import MissionCode
from m100link.protocol.command import Notification
from m100link.protocol.commands.hotpoint import FollowStart, HotpointStart
from m100link.protocol.commands.missions import IdleStatus, MissionStatus, Reached, WaypointEvent
from m100link.protocol.commands.waypoint import WaypointMission, WaypointPoint
from m100link.sim.vehicle.dynamics import DynamicsInput, ModelVertical
from m100link.sim.vehicle.flight import GOOD_GPS, FlightController, Maneuver
from m100link.sim.vehicle.missions.actions import Conditions, MissionPayload
from m100link.sim.vehicle.missions.hotpoint import (
    LARGEST_RADIUS,
    FollowExecution,
    HotpointExecution,
    follow_code,
    hotpoint_code,
)
from m100link.sim.vehicle.missions.plan import (
    CIRCLE_REFUSALS,
    WAYPOINT_REFUSALS,
    FinishAction,
    MissionOrder,
    MissionPhase,
    WaypointUpload,
)
from m100link.sim.vehicle.missions.route import LocalPlace, Site, distance, is_on_earth
from m100link.sim.vehicle.missions.waypoints import BEFORE_ACTIONS, WaypointExecution
from m100link.sim.vehicle.remote import ControlArbiter
from m100link.sim.vehicle.settings import AircraftSettings

Flown: TypeAlias = WaypointExecution | HotpointExecution | FollowExecution

_OK = MissionCode.SUCCESS
_TAKES_OFF = (Maneuver.SPIN_UP, Maneuver.TAKE_OFF)
_BROKEN_OFF = 1
_DEAD_ZONE = 0.05
_NAMES = {0: "none", 1: "waypoint", 2: "hotpoint", 3: "follow"}


class MissionComputer:
    """Missions of one aircraft.

    ``is_active``: whether there is anything to do each step: a mission was uploaded or started
    since power-on. Until then nothing here costs time. ``running``: the mission, paused or not.
    """

    def __init__(
        self,
        flight: FlightController,  # flies where the missions guide it
        settings: AircraftSettings,  # the aircraft and its site
        authority: ControlArbiter,  # who may give orders, and where the pilot's sticks are
        payload: MissionPayload,
        log: Callable[[str], None],  # notes what happens, for people
    ) -> None:
        self._flight = flight
        self._settings = settings
        self._missions = settings.missions
        self._payload = payload
        self._authority = authority
        self._log = log
        self._site = Site(
            settings.latitude_deg, settings.longitude_deg, settings.height_limit, settings.missions
        )
        self._conditions = Conditions(flight, settings, authority, self._site)
        # The waypoint mission that is there, flown or not.
        self.upload = WaypointUpload(self._missions, self._site)
        self.arrivals: list[int] = []  # waypoints reached since power-on, oldest first
        self.power_off()

    def power_off(self) -> None:
        self.running: Flown | None = None
        self.is_paused = False
        self.is_active = self._missions.status_when_idle
        self.upload.forget()
        self._events: list[WaypointEvent] = []
        self._next_status = 0.0
        self.last = IdleStatus()  # how the last mission ended
        self._hover = DynamicsInput()
        # The flight controller takes off for the mission.
        self._is_taking_off = False
        # The pilot flies meanwhile; the mission waits, paused, for control to come back.
        self._is_suspended = False
        # Its count when the mission started: one more, and somebody else has taken over.
        self._interruptions = 0

    # --- waypoints --------------------------------------------------------------------------

    @property
    def stage(self) -> MissionPhase:
        if isinstance(self.running, WaypointExecution):
            return MissionPhase.PAUSED if self.is_paused else MissionPhase.FLYING
        if self.upload.plan is not None:
            return MissionPhase.READY
        return MissionPhase.EMPTY if self.upload.mission is None else MissionPhase.PLANNED

    def begin_upload(self, mission: WaypointMission) -> MissionCode:
        """Take 0x03/0x10."""
        code = self._conditions.control() or self.refusal(WaypointExecution, MissionOrder.UPLOAD)
        if not code:
            code = self.upload.begin(mission)
            self.is_active = True
        return code

    def add(self, point: WaypointPoint) -> MissionCode:
        """Take 0x03/0x11."""
        code = self.refusal(WaypointExecution, MissionOrder.ADD)
        if code:
            return code
        code, notification = self.upload.add(point, self._home)
        if notification is not None:
            self._events.append(WaypointEvent(notification))
        return code

    def start(self) -> MissionCode:
        """Fly the mission that was uploaded; on the ground, take off for it."""
        code = self.refusal(WaypointExecution, MissionOrder.START)
        if code:
            return code
        plan = self.upload.plan
        assert plan is not None
        if self.running is not None:
            return MissionCode.OTHER_RUNNING
        code = self._conditions.waypoints(plan)
        if code:
            return code
        motion, airframe = self._flight.dynamics, self._flight.dynamics.airframe
        return self._begin(WaypointExecution(plan, motion, airframe, self._payload, self._missions))

    def set_idle_speed(self, speed: float) -> MissionCode:
        """Change the speed without the stick, on the way as well."""
        code = self.refusal(WaypointExecution, MissionOrder.SPEED) or self.upload.set_idle_speed(
            speed
        )
        if not code and isinstance(self.running, WaypointExecution):
            self.running.idle_speed = speed
        return code

    # --- hotpoint and follow ----------------------------------------------------------------

    def start_hotpoint(self, command: HotpointStart) -> MissionCode:
        here = self._conditions.here
        code = (
            self.refusal(HotpointExecution, MissionOrder.START)
            or self._conditions.in_the_air()
            or hotpoint_code(command, self._site, here, self._conditions.home)
        )
        if code:
            return code
        centre = self._site.place(command.latitude, command.longitude, command.altitude)
        motion, airframe = self._flight.dynamics, self._flight.dynamics.airframe
        return self._begin(HotpointExecution(command, centre, motion, airframe, self._missions))

    def largest_radius(self, command: HotpointStart) -> float:
        """How large a circle around that point may be; 0 around none."""
        if not is_on_earth(command.latitude, command.longitude):
            return 0.0
        home = self._conditions.home
        centre = self._site.place(command.latitude, command.longitude, 0.0)
        left = self._site.radius_limit - distance(home, centre)
        return max(0.0, min(LARGEST_RADIUS, left))

    def start_follow(self, command: FollowStart) -> MissionCode:
        here, home = self._conditions.here, self._conditions.home
        code = (
            self.refusal(FollowExecution, MissionOrder.START)
            or self._conditions.in_the_air()
            or follow_code(command, self._site, here, home)
        )
        if code:
            return code
        motion, airframe = self._flight.dynamics, self._flight.dynamics.airframe
        return self._begin(FollowExecution(command, motion, airframe, self._missions, self._site))

    def _circle_stage(self, kind: type[Flown]) -> MissionPhase:
        if self.running is None:
            return MissionPhase.EMPTY
        if not isinstance(self.running, kind):
            return MissionPhase.OTHER
        return MissionPhase.PAUSED if self.is_paused else MissionPhase.FLYING

    # --- any mission ------------------------------------------------------------------------

    def refusal(self, kind: type[Flown], order: MissionOrder) -> MissionCode:
        """Whether a mission of that kind is at a stage which refuses an order."""
        if kind is WaypointExecution:
            return WAYPOINT_REFUSALS.get((order, self.stage), _OK)
        return CIRCLE_REFUSALS.get((order, self._circle_stage(kind)), _OK)

    def stop(self, kind: type[Flown]) -> MissionCode:
        """End a mission of that kind and hover."""
        code = self.refusal(kind, MissionOrder.STOP)
        if not code:
            self._flight.interrupt()
            self._end()
        return code

    def pause(self, kind: type[Flown]) -> MissionCode:
        code = self.refusal(kind, MissionOrder.PAUSE)
        if not code:
            self.is_paused = True
            self._hover_here()
            self._log(f"{self.name} mission paused")
        return code

    def _hover_here(self) -> None:
        height = self._flight.dynamics.height
        self._hover = DynamicsInput(vertical=ModelVertical.HEIGHT, up=height)

    def resume(self, kind: type[Flown]) -> MissionCode:
        code = self.refusal(kind, MissionOrder.RESUME)
        running = self.running
        if code or running is None:
            return code
        if self._is_suspended:
            return self._conditions.control() or MissionCode.UNKNOWN
        if isinstance(running, HotpointExecution) and running.is_out_of_reach:
            return MissionCode.TOO_FAR_FROM_CIRCLE
        self.is_paused = False
        running.resume()
        self._log(f"{self.name} mission resumed")
        return _OK

    @property
    def name(self) -> str:
        return "no" if self.running is None else _NAMES[self.running.KIND]

    def summary(self) -> dict[str, Any] | None:
        """The mission under way as JSON can carry it; else how the last one ended, if one did."""
        running, last = self.running, self.last
        if running is not None:
            values: dict[str, Any] = {
                "kind": self.name,
                "doing": running.doing,
                "is_paused": self.is_paused,
            }
            if isinstance(running, WaypointExecution):
                values |= {"waypoint": running.index, "waypoints": len(running.plan.points)}
            return values
        if not last.last_mission:
            return None
        kind, ended = _NAMES[last.last_mission], "ended"
        if last.flags & _BROKEN_OFF:
            ended = f"broken off: {MissionCode(last.reason).meaning}"
        return {"kind": kind, "doing": ended, "is_paused": False}

    @property
    def flies_without_rc(self) -> bool:
        """Whether a mission flies that goes on when the remote control is lost."""
        running = None if self._is_suspended else self.running
        return running is not None and running.flies_without_rc

    def _begin(self, flight: Flown) -> MissionCode:
        self.running = flight
        self.is_paused = False
        self.is_active = True
        self._hover = DynamicsInput()
        self._interruptions = self._flight.interruptions
        self._is_taking_off = self._flight.dynamics.on_ground
        self._log(f"{self.name} mission begins")
        if self._is_taking_off:
            self._flight.take_off()
        else:
            self._flight.fly_mission(self._hover)
        return _OK

    def _end(self, reason: MissionCode | None = None) -> None:
        """The mission is over; with a reason, it was broken off."""
        assert self.running is not None
        broken_off = 0 if reason is None else _BROKEN_OFF
        self.last = IdleStatus(self.running.KIND, broken_off, int(reason or 0))
        because = "ends" if reason is None else f"broken off: {reason.meaning}"
        self._log(f"{self.name} mission {because}")
        if isinstance(self.running, WaypointExecution):
            self.upload.forget()
        self.running = None
        self.is_paused = self._is_suspended = False

    # --- each step --------------------------------------------------------------------------

    def advance(self) -> None:
        """Notice an end that others made, or tell the aircraft what to do next."""
        running, flight = self.running, self._flight
        if running is None:
            return
        if self._is_taking_off and flight.maneuver in _TAKES_OFF:
            if flight.interruptions != self._interruptions:
                self._end(self._why())
            return
        expected = Maneuver.NONE if self._is_taking_off else Maneuver.MISSION
        if flight.maneuver is not expected or flight.interruptions != self._interruptions:
            self._yield_or_end()
            return
        if self._is_taking_off:
            self._is_taking_off = False
            self._hover_here()  # where a pause that came meanwhile takes place
        reason = self._unable(running)
        if reason is not None:
            self._end(reason)
            flight.interrupt()
            if reason is MissionCode.BATTERY_LOW:
                flight.go_home()
            return
        self._heed_sticks(running)
        if not self.is_paused:
            self._hover = running.guide(self._authority.remote.sticks())
        flight.fly_mission(self._hover)
        if running.events:
            self._take_events(running)
        if running.is_over:
            self._finish(running)

    def _yield_or_end(self) -> None:
        """Somebody else has taken over: end, or where that was chosen wait for the pilot."""
        flight, reason = self._flight, self._why()
        is_pilots = flight.maneuver is Maneuver.NONE and not flight.dynamics.on_ground
        if not (self._missions.leaving_f_pauses and is_pilots and not self._is_taking_off):
            self._end(reason)
        elif not self._conditions.control():
            self._is_suspended = False
            self._interruptions = flight.interruptions
            self._hover_here()
            flight.fly_mission(self._hover)
        elif reason is MissionCode.RC_NOT_IN_F:
            self.is_paused = self._is_suspended = True
        elif not self._is_suspended:
            self._end(reason)

    def _heed_sticks(self, running: Flown) -> None:
        """Pause for the pilot's roll and throttle, where that was chosen."""
        if self._missions.stick_pauses and not self.is_paused:
            sticks = self._authority.remote.sticks()
            is_moved = max(abs(sticks.roll), abs(sticks.throttle)) > _DEAD_ZONE
            if is_moved and isinstance(running, WaypointExecution):
                self.pause(WaypointExecution)

    def _take_events(self, running: Flown) -> None:
        for event in running.events:
            self._events.append(event)
            if isinstance(event.event, Reached) and event.event.status == BEFORE_ACTIONS:
                self.arrivals.append(event.event.index)
                self._log(f"waypoint {event.event.index} reached")
        running.events.clear()

    def _finish(self, running: Flown) -> None:
        then, flight = running.then, self._flight
        self._end()
        flight.interrupt()
        if then == FinishAction.GO_HOME:
            flight.go_home()
        elif then == FinishAction.LAND:
            flight.land()

    def _unable(self, running: Flown) -> MissionCode | None:
        flight, settings = self._flight, self._settings
        if flight.gps_health < GOOD_GPS:
            return MissionCode.GPS_TOO_WEAK
        low = settings.low_battery_percent if self._missions.low_battery_returns else 0.0
        if flight.battery_percent <= low:
            return MissionCode.BATTERY_LOW
        if flight.dynamics.on_ground and flight.maneuver is Maneuver.MISSION:
            return MissionCode.TOO_LOW  # it was led to the ground, or into it
        if isinstance(running, HotpointExecution) and running.is_out_of_reach:
            return MissionCode.TOO_FAR_FROM_CIRCLE
        if isinstance(running, FollowExecution) and running.is_lost:
            return MissionCode.TARGET_LOST
        return None

    def _why(self) -> MissionCode:
        """The code of the break-off: the flight controller flies a manoeuvre of its own."""
        flight = self._flight
        if self._authority.failsafe:
            return _OK
        if flight.is_forced:
            return MissionCode.BATTERY_LOW
        if flight.maneuver in (Maneuver.DESCEND, Maneuver.FINISH):
            return MissionCode.LANDING
        if flight.maneuver in (Maneuver.CLIMB_HOME, Maneuver.FLY_HOME):
            return MissionCode.GOING_HOME
        return self._conditions.control() or MissionCode.UNKNOWN

    def news(self, now: float) -> list[Notification]:
        """The notifications for the onboard device, once per step."""
        rate = self._missions.status_hz
        if rate <= 0.0:
            self._events.clear()
            return []
        pending: list[Notification] = []
        if self._events:
            pending += self._events
            self._events.clear()
        if now >= self._next_status - 1e-9:
            self._next_status = max(self._next_status, now - 1.0 / rate) + 1.0 / rate
            pending.append(self.status())
        return pending

    def status(self) -> MissionStatus:
        running = self.running
        return MissionStatus(self.last if running is None else running.status(self.is_paused))

    @property
    def _home(self) -> LocalPlace | None:
        home = self._flight.home
        return None if home is None else LocalPlace(*home, 0.0)
