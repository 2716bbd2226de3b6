"""Control authority as a table of states and inputs.

Everything that can happen to authority is an input; what it leads to stands in one table. A pair
that is not in the table cannot happen or changes nothing: :meth:`Authority.feed` counts it.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable
from enum import Enum

from m100link.errors import LossReason
from m100link.protocol.records import ControlDevice, Device, RcMode, RemoteControl

__all__ = ["TRANSITIONS", "Authority", "AuthorityInput", "AuthorityState"]

_logger = logging.getLogger("m100link.flight")


class AuthorityState(Enum):
    """Who controls the aircraft, as this program knows it."""

    NONE = "none"  # never asked, refused, or released
    OBTAINING = "obtaining"  # a request is on its way
    HELD = "held"  # setpoints are obeyed
    PAUSED = "paused"  # the pilot left F; going back to F gives authority back
    LOST = "lost"  # the app took it, or the link is gone; a new request is needed
    RELEASING = "releasing"  # a release is on its way


class AuthorityInput(Enum):
    """What can happen."""

    OBTAIN = "we send a request"
    OBTAINED = "its ack says obtained"
    REFUSED = "its ack says refused, or none came"
    RELEASE = "we send a release"
    RELEASED = "its ack says released, or none came"
    NOTIFIED = "the aircraft notifies that authority passed away (0x02/0x01)"
    RC_LEFT_F = "the mode switch is not in F"
    RC_IN_F = "the mode switch is in F"
    DEVICE_RC = "CTRL_DEVICE says remote controller"
    DEVICE_APP = "CTRL_DEVICE says mobile app"
    DEVICE_ONBOARD = "CTRL_DEVICE says onboard device"
    LINK_LOST = "the link is gone"


_S, _I = AuthorityState, AuthorityInput

TRANSITIONS: dict[AuthorityState, dict[AuthorityInput, AuthorityState]] = {
    _S.NONE: {
        _I.OBTAIN: _S.OBTAINING,
        _I.RELEASE: _S.RELEASING,
    },
    _S.OBTAINING: {
        _I.OBTAINED: _S.HELD,
        _I.REFUSED: _S.NONE,
        _I.RELEASE: _S.RELEASING,
        _I.LINK_LOST: _S.LOST,
    },
    _S.HELD: {
        # The notification does not say who took it. Until the items tell, it is the pilot: that
        # is the usual case, and it too stops everything.
        _I.NOTIFIED: _S.PAUSED,
        _I.RC_LEFT_F: _S.PAUSED,
        _I.DEVICE_RC: _S.PAUSED,
        _I.DEVICE_APP: _S.LOST,
        _I.LINK_LOST: _S.LOST,
        _I.OBTAIN: _S.OBTAINING,
        _I.RELEASE: _S.RELEASING,
    },
    _S.PAUSED: {
        _I.DEVICE_ONBOARD: _S.HELD,
        _I.RC_IN_F: _S.HELD,
        _I.DEVICE_APP: _S.LOST,
        _I.LINK_LOST: _S.LOST,
        _I.OBTAIN: _S.OBTAINING,
        _I.RELEASE: _S.RELEASING,
    },
    _S.LOST: {
        _I.OBTAIN: _S.OBTAINING,
        _I.RELEASE: _S.RELEASING,
    },
    _S.RELEASING: {
        _I.RELEASED: _S.NONE,
        _I.LINK_LOST: _S.LOST,
    },
}
"""State, input, next state."""

_REASONS = {
    _I.NOTIFIED: LossReason.UNKNOWN,
    _I.RC_LEFT_F: LossReason.MODE_SWITCH,
    _I.DEVICE_RC: LossReason.MODE_SWITCH,
    _I.DEVICE_APP: LossReason.APP,
    _I.LINK_LOST: LossReason.LINK,
    _I.RELEASED: LossReason.RELEASED,
}


_DEVICE_INPUTS: dict[Device | None, AuthorityInput] = {
    Device.RC: _I.DEVICE_RC,
    Device.APP: _I.DEVICE_APP,
    Device.ONBOARD: _I.DEVICE_ONBOARD,
}


class Authority:
    """The authority of one connection: its state, how it came to it, and who wants to know.

    Attributes:
        state: The present state.
        reason: Why it was paused, lost or given back.
    """

    def __init__(self) -> None:
        self.state = AuthorityState.NONE
        self.reason = LossReason.NONE
        self._listeners: list[Callable[[AuthorityState, AuthorityState], None]] = []
        self._waiters: list[tuple[AuthorityState, asyncio.Future[None]]] = []
        self._was_in_f: bool | None = None
        self._was_ours = False

    def subscribe(
        self, listener: Callable[[AuthorityState, AuthorityState], None]
    ) -> Callable[[], None]:
        """Call ``listener`` after each change with the old and the new state.

        Returns:
            What ends that; may be called any number of times.
        """
        self._listeners.append(listener)

        def unsubscribe() -> None:
            if listener in self._listeners:
                self._listeners.remove(listener)

        return unsubscribe

    def feed(self, what: AuthorityInput) -> bool:
        """Something happened. Returns whether the state changed."""
        before = self.state
        after = TRANSITIONS[before].get(what)
        if after is None:
            if before in (_S.PAUSED, _S.LOST) and self.reason is LossReason.UNKNOWN:
                self.reason = _REASONS.get(what, self.reason)
            return False
        self.state = after
        is_gone = after in (_S.PAUSED, _S.LOST, _S.NONE)
        self.reason = _REASONS.get(what, LossReason.NONE) if is_gone else LossReason.NONE
        for wanted, waiter in self._waiters:
            if wanted is after and not waiter.done():
                waiter.set_result(None)
        if after is before:
            return False
        _logger.debug("authority: %s -> %s", before.value, after.value)
        for listener in tuple(self._listeners):
            listener(before, after)
        return True

    def observe_remote_control(self, rc: RemoteControl) -> None:
        """Cross-check with the mode switch.

        Only a switch that was seen to move counts: out of F after it was seen in F, and back in F
        after it was seen outside. A notification can overtake the channel values, and no source
        gives the values of the first firmware.
        """
        is_in_f = rc.mode_switch is RcMode.F
        if is_in_f != self._was_in_f and self._was_in_f is not None:
            self.feed(_I.RC_IN_F if is_in_f else _I.RC_LEFT_F)
        elif self.reason is LossReason.UNKNOWN and not is_in_f:
            self.reason = LossReason.MODE_SWITCH
        self._was_in_f = is_in_f

    def observe_control_device(self, item: ControlDevice) -> None:
        """Cross-check with the CTRL_DEVICE item (0 Hz by default: it may never come).

        Authority counts as taken by the pilot only after the item had shown it with us: a package
        made before our request was granted proves nothing.
        """
        what = _DEVICE_INPUTS.get(item.device)
        if what is None or (what is _I.DEVICE_RC and not self._was_ours):
            return
        self._was_ours = what is _I.DEVICE_ONBOARD
        self.feed(what)

    async def wait_for(self, state: AuthorityState) -> None:
        """Wait until the state is that one."""
        if self.state is state:
            return
        waiter: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        entry = (state, waiter)
        self._waiters.append(entry)
        try:
            await waiter
        finally:
            self._waiters.remove(entry)
