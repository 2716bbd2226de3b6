"""A Matrice 100 without a line: it flies, obeys, measures and decides who may give orders.

::

    vehicle.step()                  let one hundredth of a second pass
    vehicle.refresh()               somebody moved a switch: decide anew who holds control
    vehicle.sensors                 its measurements

It knows values of the protocol (setpoints, codes, records), but nothing of frames, sessions or
peers: that is :mod:`m100link.sim.autopilot`, which looks at it after each step.
Everything that chance decides comes from the one :class:`random.Random` that is passed in.
"""

from __future__ import annotations

import logging
import math
from collections import deque
from random import Random
from typing import NamedTuple

from m100link.protocol.codes import ActivationCode, AuthorityCode
from m100link.protocol.commands.activation import Activate
from m100link.protocol.commands.virtual_rc import VirtualRcSettings
from m100link.protocol.firmware import FirmwareProfile
from m100link.protocol.records import Device, RcMode
from m100link.sim.vehicle.activation import ActivationServer, ActivationState, MobileApp
from m100link.sim.vehicle.dynamics import STEP_S, airframe_for
from m100link.sim.vehicle.flight import FlightController
from m100link.sim.vehicle.gimbal import Camera, GimbalMount
from m100link.sim.vehicle.missions.actions import MissionPayload
from m100link.sim.vehicle.missions.computer import MissionComputer
from m100link.sim.vehicle.remote import ControlArbiter, PilotRemote
from m100link.sim.vehicle.sensors import Sensors
from m100link.sim.vehicle.settings import AircraftSettings, AssistantSettings

_logger = logging.getLogger(__name__)


_SLOW_STEPS = 5  # switches and time-outs are looked at every 50 ms
_GUST_MEMORY_S = 2.0


class LogEntry(NamedTuple):
    """Something that happened to the aircraft, for people."""

    time: float
    text: str


class Vehicle:
    """The aircraft, the remote control and the phone, and the settings of all three."""

    def __init__(
        self,
        random: Random,  # source of the sensor noise, the gusts and the serial number
        profile: FirmwareProfile,
        *,
        settings: AircraftSettings | None = None,
        assistant: AssistantSettings | None = None,  # settings of the PC assistant
        remote: PilotRemote | None = None,  # by default in F, moved there after power-on
        app: MobileApp | None = None,  # the mobile app; by default connected, with Internet
        server: ActivationServer | None = None,  # the registry of apps; by default an empty one
        serial_number: str | None = None,  # ten characters; by default drawn from ``random``
    ) -> None:
        self.profile = profile
        self.settings = settings or AircraftSettings()
        self.assistant = assistant or AssistantSettings()
        self.remote = remote or _remote_in_f()
        self.app = app or MobileApp(is_connected=True, has_internet=True)
        self.server = server or ActivationServer()
        self.serial_number = serial_number or f"041D{random.randrange(16**6):06X}"
        self.flight = FlightController(self.settings, airframe_for(profile))
        self.gimbal = GimbalMount(self.flight.dynamics.yaw, follows=self.settings.gimbal_follows)
        self.camera = Camera(self.log)  # what hangs below
        self.activation = ActivationState(
            profile,
            self.serial_number,
            server=self.server,
            app=self.app,
            server_delay=self.settings.server_delay,
        )
        self.authority = ControlArbiter(
            profile, self.settings, self.assistant, self.remote, self.app
        )
        below = MissionPayload(self.gimbal, self.camera, self.flight, self.log)
        self.missions = MissionComputer(self.flight, self.settings, self.authority, below, self.log)
        self.sensors = Sensors(
            profile,
            self.settings,
            random,
            flight=self.flight,
            authority=self.authority,
            remote=self.remote,
            gimbal=self.gimbal,
            step_s=_SLOW_STEPS * STEP_S,
        )
        self.time = 0.0  # seconds since power-on; a restart does not set it back
        self.events: deque[LogEntry] = deque(maxlen=200)  # last 200 things that happened
        # Times that control passed away from the onboard device; the owner of the line reports it.
        self.authority_losses = 0
        self._random = random
        self._steps = 0
        # Deviation of the wind from its mean now, m/s: gusts remember, so it is a state.
        self._gust_north = self._gust_east = 0.0
        # Until then the autopilot restarts: it keeps the aircraft up, and says and hears nothing.
        self._silent_until = -math.inf
        # When the remote control was last heard, as long as it is not; the failsafe counts from it.
        self._rc_lost_since: float | None = None
        # A mission goes on without the remote control; the failsafe acts when it has ended.
        self._failsafe_waits = False
        # When GPS reception becomes good after a cold start; None once it was set by hand.
        self._gps_good_at: float | None = None

    # --- time -------------------------------------------------------------------------------

    def step(self) -> None:
        """Let one step of the dynamics pass."""
        self._steps += 1
        self.sensors.ticks += 1
        self.time = now = self._steps * STEP_S
        self.remote.now = now
        if self.missions.running is not None:
            self.missions.advance()
        self.flight.step(now, self.authority.device, self.remote)
        yaw = self.flight.dynamics.yaw
        if yaw != self.gimbal.heading:
            self.gimbal.carry(yaw)
        if self._steps % _SLOW_STEPS == 0:
            self._look_around(now)

    def _look_around(self, now: float) -> None:
        """Whatever need not be looked at a hundred times a second."""
        settings, flight = self.settings, self.flight
        if settings.gusts:
            self._blow()
        else:
            flight.dynamics.wind_north = settings.wind_north
            flight.dynamics.wind_east = settings.wind_east
        self.gimbal.advance(now, _SLOW_STEPS * STEP_S)
        self.sensors.advance()
        if self._gps_good_at is not None and now >= self._gps_good_at:
            self._gps_good_at = None
            flight.gps_health = 5
        if flight.battery_percent <= settings.critical_battery_percent and flight.force_landing():
            self.log("battery nearly empty: landing")
        self._watch_remote(now)
        self.refresh()

    def _blow(self) -> None:
        """Gusts: wind with a short memory."""
        settings, motion = self.settings, self.flight.dynamics
        keep = math.exp(-_SLOW_STEPS * STEP_S / _GUST_MEMORY_S)
        kick = settings.gusts * math.sqrt(1.0 - keep * keep)
        self._gust_north = keep * self._gust_north + kick * self._random.gauss(0.0, 1.0)
        self._gust_east = keep * self._gust_east + kick * self._random.gauss(0.0, 1.0)
        motion.wind_north = settings.wind_north + self._gust_north
        motion.wind_east = settings.wind_east + self._gust_east

    def _watch_remote(self, now: float) -> None:
        authority = self.authority
        flies_on = self.missions.flies_without_rc
        if self.remote.is_connected:
            if authority.device is Device.RC and self.remote.makes_gesture():
                self.flight.toggle_motors()
            self._rc_lost_since = None
            if authority.failsafe:
                authority.failsafe = False
                self.refresh()
                if not (flies_on and authority.device is Device.ONBOARD):
                    self.flight.interrupt()
                self.log("remote control is back")
            return
        if self._rc_lost_since is None:
            self._rc_lost_since = now
            self.log("remote control lost")
        elif not authority.failsafe and now - self._rc_lost_since > self.settings.rc_lost_after:
            authority.failsafe = self._failsafe_waits = True
            self.refresh()
        if authority.failsafe and self._failsafe_waits and not flies_on:
            self._failsafe_waits = False
            self.flight.interrupt()
            if not self.flight.dynamics.on_ground:
                self.log("failsafe: going home")
                self.flight.go_home()

    def refresh(self) -> None:
        """Decide anew who holds control, after anything that may change it."""
        before = self.authority.device
        lost = self.authority.update()
        if self.authority.device is not before:
            self.log(f"control: {before.name} to {self.authority.device.name}")
        if lost:
            self.authority_losses += 1
            if not (self.authority.failsafe and self.missions.flies_without_rc):
                self.flight.interrupt()

    # --- what the onboard device asks for ---------------------------------------------------

    def activate(self, request: Activate) -> ActivationCode:
        """Carry an activation request out; on success its app is ``activation.active``."""
        code = self.activation.request(request, self.time)
        self.log(f"activation: {code.meaning}")
        return code

    def request_authority(self, obtain: bool) -> AuthorityCode:
        """Carry a request for control authority out."""
        before = self.authority.device
        code = self.authority.request(obtain)
        if self.authority.device is not before:
            self.log(f"control: {before.name} to {self.authority.device.name}")
            if not obtain:
                self.flight.interrupt()
        return code

    def switch_virtual_rc(self, command: VirtualRcSettings) -> None:
        """Switch the virtual remote control on or off."""
        virtual = self.remote.virtual
        virtual.switch(command, self.time)
        self.log(f"virtual remote control {'on' if command.is_on else 'off'}")
        if virtual.is_locked:
            self.log("virtual remote control: settings within 2 s lock the autopilot in checks")
        self.refresh()

    # --- what people and nature do ----------------------------------------------------------

    def configure(self, assistant: AssistantSettings) -> None:
        """Change the assistant's settings."""
        self.assistant = self.authority.assistant = assistant
        self.refresh()

    def search_gps(self, seconds: float) -> None:
        """No GPS now, good reception after some seconds."""
        self.flight.gps_health = 0
        self._gps_good_at = self.time + seconds

    def set_gps_health(self, health: int) -> None:
        """Set GPS health, 0 to 5, for good.

        Raises:
            ValueError: It is not 0 to 5.
        """
        if not 0 <= health <= 5:
            raise ValueError(f"GPS health is 0 to 5, not {health}")
        self._gps_good_at = None
        self.flight.gps_health = health

    def restart(self) -> None:
        """Restart the autopilot: silence, then a fresh start with nobody active or in control.

        In the air the motors keep it up meanwhile. Permissions from the server stay known.
        """
        self.log("autopilot restarts")
        self._silent_until = self.time + self.settings.reboot_seconds
        self.authority.is_requested = self.authority.is_pending = False
        self.authority.device = Device.RC
        self.flight.interrupt()
        self.missions.power_off()
        self.activation.power_off()
        self.remote.moved_since_power_on = False
        self.remote.virtual.reset()
        self.sensors.ticks = 0

    # --- views ------------------------------------------------------------------------------

    @property
    def is_restarting(self) -> bool:
        """Whether it says and hears nothing because it restarts."""
        return self.time < self._silent_until

    @property
    def heading_deg(self) -> float:
        """Where the nose points, -180 to 180 degrees."""
        return math.degrees(self.flight.dynamics.yaw)

    def log(self, text: str) -> None:
        """Note something that happened."""
        self.events.append(LogEntry(self.time, text))
        _logger.info("virtual aircraft at %.2f s: %s", self.time, text)


def _remote_in_f() -> PilotRemote:
    remote = PilotRemote()
    remote.set_mode(RcMode.F)
    return remote
