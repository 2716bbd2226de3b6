"""The remote controls, the pilot's and the virtual one of firmware 3.1, and who has control.

Channels as the telemetry item has them (document 2.2.3.1, item RC): sticks -10000 to 10000, mode
-8000 for P, 0 for A and 8000 for F, gear -10000 up and -4545 down.
"""

from __future__ import annotations

import math
from enum import Enum
from typing import NamedTuple

from m100link.protocol.codes import AuthorityCode
from m100link.protocol.commands.virtual_rc import CENTRE, TRAVEL, VirtualRcData, VirtualRcSettings
from m100link.protocol.firmware import FirmwareProfile
from m100link.protocol.records import Device, RcMode
from m100link.sim.vehicle.activation import MobileApp
from m100link.sim.vehicle.settings import AircraftSettings, AssistantSettings

GEAR_UP = -10_000
GEAR_DOWN = -4_545
_FULL = 10_000
_DEAD_ZONE = 0.05
_CORNER = 0.95
_CORNER_S = 2.0  # for how long the sticks are held there; our estimate


class Sticks(NamedTuple):
    """The input that the autopilot receives from a remote control."""

    roll: float  #: Deflection, -1 (left or down) to 1 (right or up).
    pitch: float  #: Deflection, -1 (left or down) to 1 (right or up).
    yaw: float  #: Deflection, -1 (left or down) to 1 (right or up).
    throttle: float  #: Deflection, -1 (left or down) to 1 (right or up).
    mode: RcMode  #: Position of the mode switch.
    gear_down: bool  #: Position of the landing gear switch.

    @property
    def are_moved(self) -> bool:
        """Whether any stick is off its centre by more than the dead zone of 5 %."""
        return max(map(abs, self[:4])) > _DEAD_ZONE

    @property
    def are_in_corner(self) -> bool:
        """Both sticks down and to one side each: the gesture that starts and stops the motors."""
        down = self.pitch < -_CORNER and self.throttle < -_CORNER
        return down and abs(self.roll) > _CORNER and abs(self.yaw) > _CORNER


class VirtualRemote:
    """Remote control by commands 0x05/0x00 and 0x05/0x01 of firmware 3.1.

    It ends one second after the last channels came. Then the real remote control flies, or, as the
    request chose, the aircraft behaves as if the remote control were lost. The real mode switch
    leaving F ends it, too.

    Two requests within two seconds lock the autopilot in a loop of checks in which even the mode
    switch does nothing (DJI's header): nobody steers any more until a restart.

    ``is_on``: switched on by the last request. ``is_locked``: whether requests came too fast.
    """

    TIMEOUT_S = 1.0
    SETTINGS_INTERVAL_S = 2.0

    def __init__(self) -> None:
        self.is_on = self.is_locked = False
        self._falls_back = True
        self._sticks: Sticks | None = None
        self._switched_at = -math.inf
        self._until = 0.0

    def switch(self, command: VirtualRcSettings, now: float) -> None:
        """Switch it on or off."""
        if now - self._switched_at < self.SETTINGS_INTERVAL_S - _ON_TIME_S:
            self.is_locked = True
        self._switched_at = now
        self.is_on = command.is_on
        self._falls_back = command.falls_back
        self._sticks = None
        self._until = now + self.TIMEOUT_S

    def feed(self, command: VirtualRcData, now: float) -> None:
        """Move sticks and switches; nothing happens while it is not switched on."""
        if not self.is_on:
            return
        channels = command.channels
        roll, pitch, throttle, yaw = (
            max(-1.0, min(1.0, (channel - CENTRE) / TRAVEL)) for channel in channels[:4]
        )
        mode = min(_VIRTUAL_MODES, key=lambda position: abs(position - channels[6]))
        gear_down = channels[4] < 1500
        self._sticks = Sticks(roll, pitch, yaw, throttle, _VIRTUAL_MODES[mode], gear_down)
        self._until = now + self.TIMEOUT_S

    def sticks(self, now: float) -> Sticks | None:
        """The sticks in force, None while this remote control says nothing."""
        if now > self._until:
            self._sticks = None
            self.is_on = self.is_on and not self._falls_back
        return self._sticks if self.is_on else None

    def counts_as_lost(self, now: float) -> bool:
        """Switched on without falling back, and silent: as if the remote control were lost."""
        return self.is_on and not self._falls_back and now > self._until

    def end(self) -> None:
        """The pilot took over by the real mode switch."""
        self.is_on = False
        self._sticks = None

    def reset(self) -> None:
        """As at power-on."""
        self.end()
        self.is_locked = False
        self._switched_at = -math.inf


_ON_TIME_S = 0.01  # one step: what comes exactly two seconds later is not too fast
_VIRTUAL_MODES = {1552: RcMode.P, 1024: RcMode.A, 496: RcMode.F}


class PilotRemote:
    """Switches and sticks in the pilot's hands, and the virtual remote control beside them.

    Attributes:
        mode: Position of the mode switch: P and A give the aircraft to the pilot, F lets the
            onboard device or the mobile app fly.
        roll, pitch, yaw, throttle: Stick deflection, -1 (left or down) to 1 (right or up).
        gear_down: Position of the landing gear switch.
        is_switched_on: Off, the autopilot has lost its remote control.
        moved_since_power_on: Whether the mode switch was moved since the autopilot started.
        virtual: The virtual remote control (firmware 3.1).
        now: Time by which the virtual one is judged, seconds since power-on.
    """

    def __init__(self, mode: RcMode = RcMode.P) -> None:
        self.mode = mode
        self.is_switched_on = True
        self.gear_down = True
        self.moved_since_power_on = False
        self.roll = self.pitch = self.yaw = self.throttle = 0.0
        self.virtual = VirtualRemote()
        self.now = 0.0
        # Since when both sticks are in the corner: None when they are not, infinite when the
        # gesture was made, which counts once.
        self._corner_since: float | None = None

    def set_mode(self, mode: RcMode | str) -> None:
        """Turn the mode switch. Naming the position it is in already moves nothing."""
        mode = RcMode[mode] if isinstance(mode, str) else mode
        if self.mode is RcMode.F and mode is not RcMode.F:
            self.virtual.end()
        if mode is not self.mode:
            self.mode = mode
            self.moved_since_power_on = True

    def move_stick(
        self,
        *,
        roll: float | None = None,
        pitch: float | None = None,
        yaw: float | None = None,
        throttle: float | None = None,
    ) -> None:
        """Deflect sticks, -1 to 1 each; the ones not named stay where they are.

        Raises:
            ValueError: A deflection beyond -1...1.
        """
        wanted = {"roll": roll, "pitch": pitch, "yaw": yaw, "throttle": throttle}
        for name, value in wanted.items():
            if value is not None and not -1.0 <= value <= 1.0:
                raise ValueError(f"{name} stick: {value} lies outside -1...1")
        for name, value in wanted.items():
            if value is not None:
                setattr(self, name, float(value))

    def release_sticks(self) -> None:
        """Let all sticks go back to the centre."""
        self.roll = self.pitch = self.yaw = self.throttle = 0.0

    @property
    def is_connected(self) -> bool:
        """Whether the autopilot hears a remote control, real or virtual."""
        if self.virtual.is_on:
            if self.virtual.sticks(self.now) is not None:
                return True
            if self.virtual.counts_as_lost(self.now):
                return False
        return self.is_switched_on

    def sticks(self) -> Sticks:
        """The autopilot's input: the virtual remote control's channels before the real ones.

        A remote control that is lost reads as centred sticks.
        """
        if self.virtual.is_locked:
            return Sticks(0.0, 0.0, 0.0, 0.0, RcMode.P, self.gear_down)
        virtual = self.virtual.sticks(self.now) if self.virtual.is_on else None
        if virtual is not None:
            return virtual
        if not self.is_connected:
            return Sticks(0.0, 0.0, 0.0, 0.0, self.mode, self.gear_down)
        return Sticks(self.roll, self.pitch, self.yaw, self.throttle, self.mode, self.gear_down)

    def makes_gesture(self) -> bool:
        """Whether both sticks have been in the corner for two seconds: true once."""
        if not self.sticks().are_in_corner:
            self._corner_since = None
        elif self._corner_since is None:
            self._corner_since = self.now
        elif self.now - self._corner_since >= _CORNER_S:
            self._corner_since = math.inf
            return True
        return False

    def channels(self) -> tuple[int, int, int, int, int, int]:
        """The RC item: roll, pitch, yaw, throttle, mode, gear."""
        sticks = self.sticks()
        return (
            round(sticks.roll * _FULL),
            round(sticks.pitch * _FULL),
            round(sticks.yaw * _FULL),
            round(sticks.throttle * _FULL),
            int(sticks.mode),
            GEAR_DOWN if sticks.gear_down else GEAR_UP,
        )


# -- who has control: pilot, mobile app or onboard device ------------------------------------------


class Obstacle(Enum):
    """Why the API is kept out."""

    API_DISABLED = "API control is not enabled in the assistant"
    RC_LOST = "the remote control is lost"
    NOT_IN_F = "the mode switch is not in F"
    F_NOT_TOGGLED = "the mode switch stood in F at power-on and was not moved since"
    IOC_ON = "IOC is on"
    APP_HOLDS = "the mobile app holds control"


class ControlArbiter:
    """The state of control authority; :meth:`update` after anything that may change it.

    ``is_requested``: the onboard device has obtained control and not given it back. Leaving F keeps
    this, so that coming back to F needs no new request. ``is_pending``: a first request of two was
    answered "in progress". ``failsafe``: the flight controller has taken over for want of a remote
    control.
    """

    def __init__(
        self,
        profile: FirmwareProfile,
        settings: AircraftSettings,
        assistant: AssistantSettings,
        remote: PilotRemote,
        app: MobileApp,
    ) -> None:
        self._profile = profile
        self._settings = settings
        self.remote = remote
        self._app = app
        self.assistant = assistant
        self.device = Device.RC  # who holds control now
        self.is_requested = self.is_pending = self.is_releasing = self.failsafe = False

    def obstacle(self) -> Obstacle | None:
        """The reason that keeps the API out, or None; the app is not looked at."""
        if not self.assistant.api_control_enabled:
            return Obstacle.API_DISABLED
        if self.failsafe or not self.remote.is_connected:
            return Obstacle.RC_LOST
        if self.remote.sticks().mode is not RcMode.F:
            return Obstacle.NOT_IN_F
        if self._profile.needs_f_toggle and not self.remote.moved_since_power_on:
            return Obstacle.F_NOT_TOGGLED
        if self._profile.ioc_must_be_off and self.assistant.ioc_on:
            return Obstacle.IOC_ON
        return None

    def update(self) -> bool:
        """Decide anew. Returns True when the onboard device has just lost control to another."""
        obstacle = self.obstacle()
        if obstacle is Obstacle.RC_LOST and not self.failsafe:
            return False  # the link to the remote may come back; the failsafe decides
        before = self.device
        if obstacle is not None:
            self.device = Device.RC
            self.is_pending = False
        elif self._app.wants_control:
            self.device = Device.APP
            if not self._settings.authority_resumes_after_app:
                self.is_requested = self.is_pending = False
        elif self.is_requested:
            self.device = Device.ONBOARD
        else:
            self.device = Device.RC
        return before is Device.ONBOARD and self.device is not before

    def request(self, obtain: bool) -> AuthorityCode:
        """Answer a request of the onboard device (0x01/0x00)."""
        code = self._obtain() if obtain else self._release()
        self.update()
        return code

    def _obtain(self) -> AuthorityCode:
        two_requests = self._profile.authority_requests > 1
        obstacle = self.obstacle()
        if obstacle is None and self._app.wants_control:
            obstacle = Obstacle.APP_HOLDS
        self.is_releasing = False
        if obstacle is not None:
            self.is_pending = False
            if not self._profile.authority_refusal_has_reason:
                return AuthorityCode.NOT_CHANGED
            is_ioc = obstacle is Obstacle.IOC_ON
            return AuthorityCode.IOC_ON if is_ioc else AuthorityCode.NOT_IN_F
        if two_requests and not self.is_requested and not self.is_pending:
            self.is_pending = True
            return AuthorityCode.NOT_CHANGED  # 3: in progress, ask again
        self.is_pending = False
        self.is_requested = True
        return AuthorityCode.OBTAINED

    def _release(self) -> AuthorityCode:
        two_requests = self._profile.authority_requests > 1
        self.is_pending = False
        if two_requests and self.is_requested and not self.is_releasing:
            self.is_releasing = True
            return AuthorityCode.RELEASING
        self.is_releasing = False
        self.is_requested = False
        return AuthorityCode.RELEASED
