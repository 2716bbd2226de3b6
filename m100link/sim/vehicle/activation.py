"""Activation as the aircraft sees it: request, app, server, key (document 2.2.1.2)."""

from __future__ import annotations

import math

from m100link.protocol.codes import ActivationCode
from m100link.protocol.commands.activation import Activate
from m100link.protocol.firmware import FirmwareProfile
from m100link.sim.vehicle.mobile import ActivationServer, Grant, MobileApp, Refusal

__all__ = ["Activation"]

_SERVER_CODES = {
    Refusal.UNKNOWN_APP: ActivationCode.SERVER_REFUSED,
    Refusal.LIMIT_REACHED: ActivationCode.SERVER_REFUSED,
    Refusal.REFUSING: ActivationCode.SERVER_REFUSED,
    Refusal.LEVEL: ActivationCode.LEVEL_TOO_HIGH,
}

_MOST_ASKED = 16
"""Apps that the server is asked about at once; ids that nobody knows may come without end."""


class Activation:
    """What this aircraft knows about apps: who is active, who was allowed before.

    The first request of an app that this aircraft does not know is answered 3 while the server is
    asked through the mobile app; the next one, ``server_delay`` or more later, is answered 0. An
    app that the server does not know is answered 3 at first as well, as DJI's own test of it
    expects (facts-later-commands 4), then 6. An app that was allowed once is remembered, over
    power-off too, and needs neither phone nor Internet again.

    Attributes:
        active: The grant in force, None before activation.
        known: Grants by app id.
        last_refusal: Why the server refused last, None when it did not.
    """

    __slots__ = (
        "_app",
        "_asking",
        "_delay",
        "_profile",
        "_serial_number",
        "_server",
        "active",
        "known",
        "last_refusal",
    )

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
        self.active: Grant | None = None
        self.known: dict[int, Grant] = {}
        self.last_refusal: Refusal | None = None

    def request(self, request: Activate, now: float) -> ActivationCode:
        """Answer an activation request of the right length that came unencrypted."""
        self.last_refusal = None
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
            self.last_refusal = verdict
            self._asking.pop(request.app_id, None)
            return _SERVER_CODES[verdict]
        del self._asking[request.app_id]
        self._server.activate(request.app_id, self._serial_number, level)
        self.known[request.app_id] = self._server_grant(verdict)
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

        Raises:
            ValueError: The server would not allow it.
        """
        verdict = self._server.activate(app_id, self._serial_number, None)
        if isinstance(verdict, Refusal):
            raise ValueError(f"the server does not allow app {app_id}: {verdict.value}")
        self.known[app_id] = verdict

    def _server_grant(self, verdict: Grant) -> Grant:
        """What is remembered: the registered level, so that a later request may ask for it."""
        return Grant(verdict.app_id, verdict.key, self._server.apps[verdict.app_id].level)

    def power_off(self) -> None:
        """Nobody is active any more; what the server allowed stays known."""
        self.active = None
        self._asking.clear()
