"""Activation as the aircraft sees it: request, app, server, key (document 2.2.1.2)."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field, replace
from enum import Enum

from m100link.protocol.codes import ActivationCode
from m100link.protocol.commands.activation import Activate
from m100link.protocol.firmware import FirmwareProfile
from m100link.wire.cipher import Key

# -- the mobile app on the remote control and, behind it, the server that knows registered apps ----
# An aircraft has no Internet of its own: activation goes through the app (document, *General System
# Description*). The AES key travels to the aircraft on that way only, never over the serial line.


DEFAULT_DEVICE_LIMIT = 5
"""Autopilots that may be activated for a new app id (document, *Device Available Number*)."""

DEMO_APP_ID = 10086
DEMO_KEY = Key(bytes(range(32)))
"""The key of the demo app: the bytes 00 01 02 ... 1f. Known to everybody, so no secret."""


@dataclass(slots=True)
class RegisteredApp:
    """One entry of the server's registry."""

    app_id: int  #: The number handed out at registration.
    key: Key  #: The AES key handed out with it.
    level: int = 2  #: Authorization level 0, 1 or 2 (document, *Command Authorization Levels*).
    #: Autopilots that may be activated at most (Device Available Number).
    device_limit: int = DEFAULT_DEVICE_LIMIT
    autopilots: set[str] = field(default_factory=set)  #: Serial numbers of those that were.


class Refusal(Enum):
    """Why the server did not activate an autopilot."""

    UNKNOWN_APP = "no such app id"
    LIMIT_REACHED = "device limit reached"
    LEVEL = "level above the registered one"
    REFUSING = "server refuses everybody"


@dataclass(frozen=True, slots=True)
class Grant:
    """The server's permission for an app, as the autopilot keeps it."""

    app_id: int
    key: Key
    level: int


class ActivationServer:
    """The registry that stands in the place of DJI's server. One may serve many aircraft.

    Attributes:
        apps: Registered apps by id.
        is_refusing: True makes it refuse every request (code 6).
    """

    def __init__(self) -> None:
        self.apps: dict[int, RegisteredApp] = {}
        self.is_refusing = False

    def register(
        self,
        app_id: int,
        key: Key | bytes | str,
        *,
        level: int = 2,
        device_limit: int = DEFAULT_DEVICE_LIMIT,
    ) -> RegisteredApp:
        """Register an app, or change a registration (its activated autopilots stay counted).

        Raises:
            ValueError: The level is not 0, 1 or 2, or the app id does not fit into 32 bits.
            BadKey: The key is not one.
        """
        if level not in (0, 1, 2):
            raise ValueError(f"level {level} does not exist: 0, 1 or 2")
        if not 0 <= app_id <= 0xFFFFFFFF:
            raise ValueError(f"app id {app_id} does not fit into 32 bits")
        counted = self.apps[app_id].autopilots if app_id in self.apps else set()
        app = RegisteredApp(app_id, Key(key), level, device_limit, counted)
        self.apps[app_id] = app
        return app

    def activate(self, app_id: int, serial_number: str, level: int | None) -> Grant | Refusal:
        """Decide about one autopilot and, if new to this app id, count it.

        Args:
            app_id: As the activation command has it.
            serial_number: Of the autopilot.
            level: The level asked for, or None where the firmware does not send one.
        """
        verdict = self.judge(app_id, serial_number, level)
        if isinstance(verdict, Grant):
            self.apps[app_id].autopilots.add(serial_number)
        return verdict

    def judge(self, app_id: int, serial_number: str, level: int | None) -> Grant | Refusal:
        """The same decision without counting the autopilot."""
        if self.is_refusing:
            return Refusal.REFUSING
        app = self.apps.get(app_id)
        if app is None:
            return Refusal.UNKNOWN_APP
        if serial_number not in app.autopilots and len(app.autopilots) >= app.device_limit:
            return Refusal.LIMIT_REACHED
        if level is not None and level > app.level:
            return Refusal.LEVEL
        return Grant(app_id, app.key, app.level if level is None else level)


class MobileApp:
    """The app (DJI Pilot, later DJI GO) on the phone at the remote control.

    Attributes:
        is_connected: The phone is plugged in and the app runs.
        has_internet: The phone reaches the server.
        wants_control: The app has asked for control over the mobile interface.
        received: Messages from the onboard device (0x00/0xFE), newest last, 1000 kept.
        lost_messages: Messages sent while no app was connected.
    """

    def __init__(self, *, is_connected: bool = False, has_internet: bool = False) -> None:
        self.is_connected = is_connected
        self.has_internet = has_internet
        self.wants_control = False
        self.received: deque[bytes] = deque(maxlen=1000)
        self.lost_messages = 0

    def receive(self, message: bytes) -> None:
        """A message from the onboard device arrives, or is lost for want of an app."""
        if not self.is_connected:
            self.lost_messages += 1
            return
        self.received.append(message)

    def connect(self, *, internet: bool = True) -> None:
        """Plug the phone in."""
        self.is_connected = True
        self.has_internet = internet

    def disconnect(self) -> None:
        """Unplug the phone; control that it held goes with it."""
        self.is_connected = False
        self.has_internet = False
        self.wants_control = False


# -- activation ------------------------------------------------------------------------------------

_MOST_ASKED = 16
"""Apps that the server is asked about at once; ids that nobody knows may come without end."""


class ActivationState:
    """The apps that this aircraft knows: the active one, and those that were allowed before.

    The first request of an app that this aircraft does not know is answered 3 while the server is
    asked through the mobile app; the next one, ``server_delay`` or more later, is answered 0. An
    app that the server does not know is answered 3 at first as well, as DJI's own test of it
    expects, then 6. An app that was allowed once is remembered, over
    power-off too, and needs neither phone nor Internet again.
    """

    def __init__(
        self,
        profile: FirmwareProfile,
        serial_number: str,
        *,
        server: ActivationServer,
        app: MobileApp,
        server_delay: float,
    ) -> None:
        self._profile = profile
        self._serial_number = serial_number
        self._server = server
        self._app = app
        self._delay = server_delay
        self._asking: dict[int, float] = {}
        self.active: Grant | None = None  # the grant in force, None before activation
        self.known: dict[int, Grant] = {}  # grants by app id

    def request(self, request: Activate, now: float) -> ActivationCode:
        """Answer an activation request of the right length that came unencrypted."""
        version = self._profile.activation_version
        if version is not None and request.version != version:
            return ActivationCode.VERSION_MISMATCH
        level = request.level if self._profile.has_level else None
        if level is not None and level > 2:
            return ActivationCode.LEVEL_TOO_HIGH
        known = self.known.get(request.app_id)
        if known is not None and (level is None or level <= known.level):
            self.active = Grant(known.app_id, known.key, known.level if level is None else level)
            return ActivationCode.SUCCESS
        if not self._app.is_connected:
            return ActivationCode.APP_NOT_CONNECTED
        if not self._app.has_internet:
            return ActivationCode.NO_INTERNET
        verdict = self._server.judge(request.app_id, self._serial_number, level)
        is_asked = not isinstance(verdict, Refusal) or verdict is Refusal.UNKNOWN_APP
        if is_asked and now < self._answer_at(request.app_id, now):
            return ActivationCode.NEW_DEVICE
        if isinstance(verdict, Refusal):
            self._asking.pop(request.app_id, None)
            is_level = verdict is Refusal.LEVEL
            return ActivationCode.LEVEL_TOO_HIGH if is_level else ActivationCode.SERVER_REFUSED
        del self._asking[request.app_id]
        self._server.activate(request.app_id, self._serial_number, level)
        # The aircraft remembers the registered level: a later request may ask for it.
        self.known[request.app_id] = replace(verdict, level=self._server.apps[request.app_id].level)
        self.active = verdict
        return ActivationCode.SUCCESS

    def _answer_at(self, app_id: int, now: float) -> float:
        """When the server answers; it is asked now if it was not before."""
        answer_at = self._asking.get(app_id)
        if answer_at is None:
            if len(self._asking) >= _MOST_ASKED:
                del self._asking[next(iter(self._asking))]
            # The request that asks never gets the answer, however fast the server is.
            self._asking[app_id] = now + self._delay
            return math.inf
        return answer_at

    def allow(self, app_id: int) -> None:
        """Know an app as one that the server allowed before: its next request is answered 0.

        Raises ``ValueError``: the server would not allow it.
        """
        verdict = self._server.activate(app_id, self._serial_number, None)
        if isinstance(verdict, Refusal):
            raise ValueError(f"the server does not allow app {app_id}: {verdict.value}")
        self.known[app_id] = verdict

    def power_off(self) -> None:
        """Nobody is active any more; permissions from the server stay known."""
        self.active = None
        self._asking.clear()
