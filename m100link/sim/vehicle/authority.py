"""Control authority: remote control before mobile app before onboard device.

(Document, *Remote Controller, Onboard API & Mobile API*, and 2.2.2.1.) The remote control decides
whether the other two may ask at all; the mobile app may take control from the onboard device.
"""

from __future__ import annotations

from enum import Enum

from m100link.protocol.codes import AuthorityCode
from m100link.protocol.firmware import FirmwareProfile
from m100link.protocol.records import Device, RcMode
from m100link.sim.vehicle.activation import MobileApp
from m100link.sim.vehicle.remote import PilotRemote
from m100link.sim.vehicle.settings import AircraftSettings, AssistantSettings


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
