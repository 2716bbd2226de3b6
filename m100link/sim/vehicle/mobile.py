"""The mobile app on the remote control and, behind it, the server that knows registered apps.

An aircraft has no Internet of its own: activation goes through the app (document, *General System
Description*). The AES key travels to the aircraft on that way only, never over the serial line.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from enum import Enum

from m100link.wire.cipher import Key

__all__ = [
    "DEFAULT_DEVICE_LIMIT",
    "DEMO_APP_ID",
    "DEMO_KEY",
    "ActivationServer",
    "Grant",
    "MobileApp",
    "Refusal",
    "RegisteredApp",
]

DEFAULT_DEVICE_LIMIT = 5
"""Autopilots that may be activated for a new app id (document, *Device Available Number*)."""

DEMO_APP_ID = 10086
DEMO_KEY = Key(bytes(range(32)))
"""The key of the demo app: the bytes 00 01 02 ... 1f. Known to everybody, so no secret."""


@dataclass(slots=True)
class RegisteredApp:
    """One entry of the server's registry.

    Attributes:
        app_id: The number handed out at registration.
        key: The AES key handed out with it.
        level: Authorization level 0, 1 or 2 (document, *Command Authorization Levels*).
        device_limit: Device Available Number: how many autopilots may be activated.
        autopilots: Serial numbers of those that were.
    """

    app_id: int
    key: Key
    level: int = 2
    device_limit: int = DEFAULT_DEVICE_LIMIT
    autopilots: set[str] = field(default_factory=set)


class Refusal(Enum):
    """Why the server did not activate an autopilot."""

    UNKNOWN_APP = "no such app id"
    LIMIT_REACHED = "device limit reached"
    LEVEL = "level above the registered one"
    REFUSING = "server refuses everybody"


@dataclass(frozen=True, slots=True)
class Grant:
    """What an autopilot learns when the server says yes."""

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
        received_bytes: All bytes it received.
        lost_messages: Messages sent while no app was connected.
    """

    __slots__ = (
        "has_internet",
        "is_connected",
        "lost_messages",
        "received",
        "received_bytes",
        "wants_control",
    )

    def __init__(self, *, is_connected: bool = False, has_internet: bool = False) -> None:
        self.is_connected = is_connected
        self.has_internet = has_internet
        self.wants_control = False
        self.received: deque[bytes] = deque(maxlen=1000)
        self.received_bytes = 0
        self.lost_messages = 0

    def receive(self, message: bytes) -> None:
        """A message from the onboard device arrives, or is lost for want of an app."""
        if not self.is_connected:
            self.lost_messages += 1
            return
        self.received.append(message)
        self.received_bytes += len(message)

    def connect(self, *, internet: bool = True) -> None:
        """Plug the phone in."""
        self.is_connected = True
        self.has_internet = internet

    def disconnect(self) -> None:
        """Unplug the phone; control that it held goes with it."""
        self.is_connected = False
        self.has_internet = False
        self.wants_control = False
