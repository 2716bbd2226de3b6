"""Control authority as a table of states and inputs.

Everything that can happen to authority is an input; what it leads to stands in one table. A pair
that is not in the table cannot happen or changes nothing: :meth:`Authority.feed` counts it.
"""

from __future__ import annotations

import asyncio
import logging
import time
from collections.abc import Callable
from enum import Enum
from typing import TYPE_CHECKING, Any

from m100link.errors import LossReason
from m100link.protocol.packet import remember
from m100link.protocol.records import ControlDevice, Device, RcMode, RemoteControl

if TYPE_CHECKING:
    from m100link.protocol.packet import TelemetryPacket

__all__ = ["Authority", "AuthorityState"]

_logger = logging.getLogger(__name__)


class AuthorityState(Enum):
    """The state of control authority, as this program knows it."""

    NONE = "none"  # never asked, refused, or released
    OBTAINING = "obtaining"  # a request is on its way
    CONTESTED = "contested"  # meanwhile authority passed away: it was granted before, unheard
    HELD = "held"  # setpoints are obeyed
    PAUSED = "paused"  # the pilot left F; going back to F gives authority back
    LOST = "lost"  # the app took it, or the link is gone; a new request is needed
    RELEASING = "releasing"  # a release is on its way
    UNRELEASED = "unreleased"  # nobody said that the release arrived: it may still be ours


class AuthorityInput(Enum):
    """The inputs of the table."""

    OBTAIN = "we send a request"
    OBTAINED = "its ack says obtained"
    REFUSED = "its ack says refused, or none came"
    RELEASE = "we send a release"
    RELEASED = "its ack says released"
    NOT_RELEASED = "its ack says something else, or none came"
    NOTIFIED = "the aircraft notifies that authority passed away (0x02/0x01)"
    RC_LEFT_F = "the mode switch is not in F"
    RC_IN_F = "the mode switch is in F"
    DEVICE_RC = "CTRL_DEVICE says remote controller"
    DEVICE_APP = "CTRL_DEVICE says mobile app"
    DEVICE_ONBOARD = "CTRL_DEVICE says onboard device"
    LINK_LOST = "the link is gone"


_S, _I = AuthorityState, AuthorityInput

TRANSITIONS: dict[AuthorityState, dict[AuthorityInput, AuthorityState]] = {
    _S.NONE: {_I.OBTAIN: _S.OBTAINING, _I.RELEASE: _S.RELEASING},
    _S.OBTAINING: {
        _I.OBTAINED: _S.HELD,
        _I.REFUSED: _S.NONE,
        # Authority can only pass away after it was granted: that ack is lost or still to be read.
        _I.NOTIFIED: _S.CONTESTED,
        _I.RC_LEFT_F: _S.CONTESTED,
        _I.DEVICE_RC: _S.CONTESTED,
        _I.RELEASE: _S.RELEASING,
        _I.LINK_LOST: _S.LOST,
    },
    _S.CONTESTED: {
        # A repeated request is answered from memory: this ack may be older than the loss.
        _I.OBTAINED: _S.PAUSED,
        _I.REFUSED: _S.NONE,
        _I.RC_IN_F: _S.OBTAINING,
        _I.DEVICE_ONBOARD: _S.OBTAINING,
        _I.OBTAIN: _S.OBTAINING,
        _I.RELEASE: _S.RELEASING,
        _I.LINK_LOST: _S.LOST,
    },
    _S.HELD: {
        # The notification does not name its taker. Until the items do, it is the pilot: that is
        # the usual case, and it too stops everything.
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
    _S.LOST: {_I.OBTAIN: _S.OBTAINING, _I.RELEASE: _S.RELEASING},
    _S.RELEASING: {_I.RELEASED: _S.NONE, _I.NOT_RELEASED: _S.UNRELEASED, _I.LINK_LOST: _S.LOST},
    _S.UNRELEASED: {
        # The pilot who takes it may give it back by going back to F, so only an ack and the app,
        # behind which a new request is needed, make an end.
        _I.OBTAIN: _S.OBTAINING,
        _I.RELEASE: _S.RELEASING,
        _I.DEVICE_APP: _S.LOST,
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


_GONE = frozenset({_S.CONTESTED, _S.PAUSED, _S.LOST, _S.NONE})  # states that have a reason

_DEVICE_INPUTS: dict[Device | None, AuthorityInput] = {
    Device.RC: _I.DEVICE_RC,
    Device.APP: _I.DEVICE_APP,
    Device.ONBOARD: _I.DEVICE_ONBOARD,
}


_SETTLING_S = 0.3  # an item of 10 Hz or more, made after the grant, has arrived by then


class Authority:
    """The authority of one connection: its state, its reason and its listeners.

    ``clock``: seconds, by any clock that only goes forward.
    """

    __slots__ = (
        *("_clock", "_held_since", "_known", "_listeners", "_waiters", "_was_in_f", "_was_ours"),
        *("reason", "state"),
    )

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self.state = AuthorityState.NONE
        self.reason = LossReason.NONE  # why it was contested, paused, lost or given back
        self._clock = clock
        self._held_since = 0.0
        self._listeners: list[Callable[[AuthorityState, AuthorityState], None]] = []
        self._waiters: list[tuple[AuthorityState, asyncio.Future[None]]] = []
        self._was_in_f: bool | None = None  # the mode switch, when it was seen last
        self._was_ours = False  # CTRL_DEVICE has shown us since the last request
        # The bytes that show who controls, of the last package that changed nothing, by its plan.
        self._known: dict[Any, object] = {}

    def subscribe(
        self, listener: Callable[[AuthorityState, AuthorityState], None]
    ) -> Callable[[], None]:
        """Call ``listener`` after each change with the old and the new state.

        Returns:
            A function that ends that; may be called any number of times.
        """
        self._listeners.append(listener)

        def unsubscribe() -> None:
            if listener in self._listeners:
                self._listeners.remove(listener)

        return unsubscribe

    def feed(self, what: AuthorityInput) -> bool:
        """Something happened. Returns whether the state changed."""
        before = self.state
        if what is _I.OBTAIN:
            # Each request begins anew: an item that showed us before it says nothing of its grant.
            self._was_ours = False
            self._forget()
        after = TRANSITIONS[before].get(what)
        if after is None:
            # The notification does not name the taker (document 2.2.3.2); a later item may.
            if before in _GONE and self.reason is LossReason.UNKNOWN:
                self._explain(_REASONS.get(what, self.reason))
            return False
        self._forget()
        self.state = after
        if before is not _S.CONTESTED or after is not _S.PAUSED:  # there it is known already
            self.reason = self._reason_of(what) if after in _GONE else LossReason.NONE
        if after is _S.HELD:
            self._held_since = self._clock()
        for wanted, waiter in self._waiters:
            if wanted is after and not waiter.done():
                waiter.set_result(None)
        if after is before:
            return False
        _logger.debug("authority: %s -> %s", before.value, after.value)
        for listener in tuple(self._listeners):
            try:
                listener(before, after)
            except Exception:  # the control block may be behind it, and has to hear of a loss
                _logger.exception("a listener of authority failed")
        return True

    def _explain(self, reason: LossReason) -> None:
        """Note a better reason of a loss, and compare the next package anew."""
        if reason is not self.reason:
            self.reason = reason
            self._forget()

    def _reason_of(self, what: AuthorityInput) -> LossReason:
        if what is _I.DEVICE_RC and self._was_in_f:
            return LossReason.UNKNOWN  # not the switch: API control off, or something else
        return _REASONS.get(what, LossReason.NONE)

    @property
    def _is_settled(self) -> bool:
        """Whether the items that arrive now were made after authority was granted."""
        return self.state is _S.HELD and self._clock() - self._held_since >= _SETTLING_S

    def observe(self, package: TelemetryPacket) -> None:
        """Cross-check with a package: the mode switch, then CTRL_DEVICE, where it carries them."""
        plan, known = package._plan, self._known
        take = plan.control
        value = take(package.value)
        # Most packages say the same as the one before, and reading each was a third of its cost.
        # An observation follows from these bytes, this object's memory, and whether authority had
        # time to settle: where it changed nothing, the same bytes change nothing again.
        if known.get(plan) == value:
            return
        rc, device = package.remote_control, package.control_device
        if rc is not None:
            self.observe_remote_control(rc)
        if device is not None:
            self.observe_control_device(device)
        if self.state is not _S.HELD or self._is_settled:
            remember(known, plan, value)  # in what is forgotten already, if something changed

    def _forget(self) -> None:
        """Something changed by which an observation can differ from the last of the same bytes."""
        self._known = {}

    def observe_remote_control(self, rc: RemoteControl) -> None:
        """Cross-check with the mode switch.

        Out of F counts when the switch was seen to move there, and always from 0.3 s after the
        grant on; a notification can overtake the channel values. Back in F counts only when it was
        seen to move: in F, the app may have control.
        """
        is_in_f, was_in_f = rc.mode_switch is RcMode.F, self._was_in_f
        if is_in_f is not was_in_f:
            self._was_in_f = is_in_f
            self._forget()
        if (was_in_f is not None and is_in_f != was_in_f) or (not is_in_f and self._is_settled):
            self.feed(_I.RC_IN_F if is_in_f else _I.RC_LEFT_F)
        elif self.reason is LossReason.UNKNOWN and not is_in_f:
            self._explain(LossReason.MODE_SWITCH)

    def observe_control_device(self, item: ControlDevice) -> None:
        """Cross-check with the CTRL_DEVICE item (0 Hz by default: it may never come).

        The remote controller counts when the item had shown us before, and always from 0.3 s after
        the grant on: a package made before our request was granted proves nothing.
        """
        what = _DEVICE_INPUTS.get(item.device)
        if what is None or (what is _I.DEVICE_RC and not self._was_ours and not self._is_settled):
            return
        is_ours = what is _I.DEVICE_ONBOARD
        if is_ours is not self._was_ours:
            self._was_ours = is_ours
            self._forget()
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
