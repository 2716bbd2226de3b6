"""One browser tab of the console: its lease, its beats, its name.

A tab steers by *beats*: twenty a second while a key is held, with the numbers of the stick. A beat
lasts :data:`BEAT_LIFETIME`; without the next one the aircraft stops, whatever the reason: key
released, focus lost, tab closed, socket gone, browser hanging. Between times the tab tells that it
is alive, which keeps its lease.

What counts is when the key was held, not when that became known: each message has the page's time,
and the station's time that the page heard last. A beat that waited on its way is refused, and
nobody steers by a picture that is old.
"""

from __future__ import annotations

import asyncio
import math
from collections.abc import Awaitable, Callable
from enum import StrEnum
from typing import Any, TypeGuard

from m100link.apps.agent import orders
from m100link.apps.agent.client import AgentClient
from m100link.apps.agent.latency import (
    MAX_LATE,
    MAX_ORDER_LATE,
    MAX_ROUND_TRIP,
    MAX_UNHEARD,
    PAGE_GRAIN,
    ClockEstimate,
)
from m100link.apps.agent.lease import Lease, TakeOver
from m100link.apps.agent.messages import Event, LeaseChanged, Topic
from m100link.apps.agent.orders import setpoint_of
from m100link.apps.station.config import ONLY_NAME
from m100link.apps.station.console.kept import LeaseKeeper
from m100link.errors import AuthorityLost, GuardRefused, LossReason, M100Error, NotObserved
from m100link.errors.texts import read_json
from m100link.missions.plan import WaypointPlan

BEAT_LIFETIME = 0.3  # seconds that a beat lasts

SPENT_AFTER = 1.0
"""Seconds of the page without a beat after which it has let go of everything by itself."""

_STOPPED, _OBTAINED = "STOP was pressed", "control was obtained meanwhile"

MAX_BEAT = 2000
_COMPLAINT_PAUSE = 1.0


class Tab:
    """What one tab may do, and has."""

    def __init__(self, agent: AgentClient, name: str, aircraft: str = ONLY_NAME) -> None:
        self._agent = self.agent = agent
        self.aircraft = aircraft
        self.kept = LeaseKeeper()  # control of other aircraft, kept as long as this tab is heard
        self.name = name  # as given; the operator may change it
        # Who looks at it, past a reload: see :mod:`~m100link.apps.station.console.kept`.
        self.person = ""
        self.lease: Lease | None = None  # its lease, in force or not
        self.refusal: M100Error | None = None  # what was refused last; None for nothing
        self.beats = 0  # beats that were sent on
        self.refused = 0  # messages that could not be used
        self.dropped = 0  # pictures of telemetry that its page did not get because it is slow
        # How the lease was lost, and to whom; None while the tab has it, gave it back or never had
        # it.
        self.lease_end: LeaseChanged | None = None
        # Who or what took authority while the tab had the lease; None when it is held again.
        self.loss: LossReason | None = None
        self._last_number = -1
        self._way = ClockEstimate(PAGE_GRAIN)
        self._press = Press()
        self._stopped_at = -math.inf
        self._complained_at = -math.inf
        self._stopping: asyncio.Task[Any] | None = None  # one at a time, however often it is said
        # What a hand that still holds something had no part in, whoever it was: until it has let go
        # it moves nothing. Empty when it may.
        self._has_to_let_go = ""
        self._beat_at = -math.inf  # the last one, flown or refused, by the page's clock
        self._late_since: float | None = None  # the first late one since one was in time
        self._stop_press: object = None  # which press of STOP the task above answers
        self._heard: list[tuple[list[Any], Callable[..., None]]] = [
            (agent.on_steer_refused, self._steer_refused),
            (agent.on_event, self._event),
            (agent.on_lease, self._lease_changed),
            (agent.on_authority_taken, self._authority_taken),
        ]
        for callbacks, callback in self._heard:
            callbacks.append(callback)

    @property
    def has_spoken(self) -> bool:
        """Whether its page ever said anything that could be used."""
        return self._last_number >= 0

    @property
    def round_trip(self) -> float | None:
        """Seconds to the page and back, None before it was measured."""
        return self._way.round_trip

    @property
    def problem(self) -> str:
        """What was refused last, in English; empty for nothing."""
        return "" if self.refusal is None else str(self.refusal)

    @property
    def has_lease(self) -> bool:
        """Whether this tab may steer."""
        return self._agent.holds(self.lease)

    # -- what the buttons do ---------------------------------------------------------------------

    async def attempt(self, work: Callable[[], Awaitable[Any]]) -> bool:
        """Do something for the operator; what goes wrong is kept as the problem.

        What this tab ended by its own STOP went as it was wished.
        """
        self.refusal, began = None, self._agent.now
        try:
            await work()
        except M100Error as error:
            if not self.has_ended(error, began):
                self.refusal = error
            return False
        return True

    def has_ended(self, error: M100Error, began: float) -> bool:
        """Whether an order of ``began``, on the agent's clock, ended by this tab's own STOP."""
        return isinstance(error, NotObserved) and self._stopped_at > began

    async def activate(self) -> None:
        """Activate the aircraft."""
        await self._agent.ask(orders.Activate(), self.lease if self.has_lease else None)

    async def obtain(self) -> None:
        """Take the lease and control authority.

        Raises ``LeaseHeld``: another client has the lease; see :meth:`ask_take_over`.
        """
        if not self.has_lease:
            self.lease = await self._agent.acquire(self.name)
        self.lease_end = None
        self._has_to_let_go = self._has_to_let_go or _OBTAINED
        try:
            await self._agent.ask(orders.Obtain(), self.lease)
        except M100Error:
            self.let_go()
            raise
        self.loss = None

    async def ask_take_over(self) -> TakeOver:
        """First step of a take-over."""
        return await self._agent.ask_take_over(self.name)

    async def confirm_take_over(self, wanted: TakeOver) -> None:
        """Second step: take the lease, and authority if the station does not hold it."""
        self.lease = await self._agent.confirm(wanted.token)
        self.lease_end = None
        self._has_to_let_go = self._has_to_let_go or _OBTAINED
        await self._agent.ask(orders.Obtain(), self.lease)
        self.loss = None

    async def release(self) -> None:
        """Give authority and lease back."""
        await self._agent.ask(orders.Release(), self.lease)
        self.let_go()

    def let_go(self) -> None:
        """Give the lease back, if this tab has it; motion stops."""
        lease, self.lease, self.loss = self.lease, None, None  # its end is no news to this tab
        if lease is not None and self._agent.holds(lease):
            self._agent.let_go(lease)

    async def ask(self, order: orders.Order) -> None:
        """Ask for something under the lease of this tab."""
        await self._agent.ask(order, self.lease)

    async def give_plan(self, plan: WaypointPlan) -> None:
        """Give the agent a plan; the aircraft gets it with the start.

        Raises ``LeaseRefused``: this tab has no control.
        """
        lease = self._agent.check(self.lease)
        await self._agent.ask(orders.UploadPlan.of(plan), lease)

    async def stop(self, press: object = None) -> None:
        """Stop. Any tab may."""
        if self._is_done(press):
            return
        self._stop_now(press)
        if self._stopping is not None:
            await self._stopping

    def _is_done(self, press: object) -> bool:
        """Whether this press was carried out, by the other of its ways."""
        task = self._stopping
        return (
            type(press) is int
            and press == self._stop_press
            and task is not None
            and task.done()
            and not task.cancelled()
            and task.result() is True
        )

    def check_order(self, said_at: object) -> None:
        """Refuse a button that was pressed too long ago, or nobody knows when.

        ``said_at``: the page's time at the press, ms.

        Raises ``GuardRefused``: it waited on its way for more than 2 s.
        """
        at = said_at / 1000.0 if _is_number(said_at) else math.inf
        late = self._way.oldest(at, self._agent.now)
        if late > MAX_ORDER_LATE:
            waited = f"was {late:.0f} s on its way" if late < math.inf else "has no time"
            # A page that is loaded anew when the network is back does not show the problem.
            self._agent.note(f"{self.name}: a pressed button {waited}; nothing was done", "warning")
            raise GuardRefused(
                f"a pressed button {waited}; nothing was done",
                guard="order_late",
                measured=late,
                limit=MAX_ORDER_LATE,
                cause="the network between the browser and the station was slow or blocked",
                remedy="look at the aircraft, then press again",
            )

    # -- what its socket says --------------------------------------------------------------------

    def receive(self, text: str | bytes) -> dict[str, Any] | None:
        """Take a message of the tab; returns what to answer. Never raises."""
        message = _read(text)
        if message is None:
            self.refused += 1
            return None
        answer = {"op": "echo", "at": message["at"]}
        if message["op"] == "stop":
            press = message.get("press")
            if type(press) is int:
                answer["press"] = press
            if not self._is_done(press):
                self._stop_now(press)  # be it old, or a second time
        number = message["n"]
        if number <= self._last_number:
            self.refused += 1  # an old message again
            return None
        self._last_number = number
        now = self._agent.now
        self.kept.renew(now)
        at, held = message["at"] / 1000.0, message.get("held", math.inf) / 1000.0
        late = self._way.late(at, now)
        if "told" in message:
            self._way.heard(message["told"] + held, at, now)
        if self.lease is not None and self.has_lease:
            if message["op"] == "beat":
                self._steer(self.lease, message, late, held)
            else:
                if message["op"] == "rest":
                    self._press = Press()
                    self._has_to_let_go, self._late_since = "", None
                    self._agent.halt(lease=self.lease)
                self._agent.keep(self.lease)
        elif message["op"] == "beat":
            self._beat_at = message["at"] / 1000.0
        if message["op"] == "beat":
            answer["fate"] = self._press.fate(self._agent, now, has_lease=self.has_lease)
        return answer | {"told": now}

    def _stop_now(self, press: object) -> None:
        """STOP by either way: that of the socket, or of the page's other events."""
        self._stop_press, self._stopped_at = press, self._agent.now
        if self._stopping is None or self._stopping.done():
            self._stopping = self._agent.background.spawn(
                self.attempt(self._agent.stop), f"stop of {self.name}"
            )

    def _check_way(self, late: float, held: float) -> None:
        """Refuse what was decided too long ago, or by a picture that was old.

        Raises ``GuardRefused``: it was.
        """
        trip = self._way.round_trip
        for guard, measured, limit, seen in (
            ("way_late", late, MAX_LATE, "a key press was {:.1f} s late on its way"),
            ("way_unheard", held, MAX_UNHEARD, "the page did not hear the station for {:.1f} s"),
            (
                "way_round_trip",
                math.inf if trip is None else trip,
                MAX_ROUND_TRIP,
                "to the page and back it takes {:.1f} s",
            ),
        ):
            if measured > limit:
                raise GuardRefused(
                    f"{seen.format(measured)}; it was not flown",
                    guard=guard,
                    measured=measured,
                    limit=limit,
                    cause="the network between the browser and the station is slow or blocked",
                    remedy="wait, or let go and let the pilot fly",
                )

    def _event(self, event: Event) -> None:
        if event.topic is Topic.STOPPED:
            self._has_to_let_go = _STOPPED

    def _heard_beat(self, lease: Lease, at: float) -> None:
        """Note a beat; after a gap of the page's own it is a new press.

        ``at``: when the beat was sent, s of the page's clock: beats that wait on their way leave a
        gap here as well, with the key held all the time.
        """
        if at - self._beat_at > SPENT_AFTER:
            if self._has_to_let_go == _STOPPED:
                self._agent.halt(lease=lease)
            self._has_to_let_go, self._late_since = "", None
        self._beat_at = at

    def _check_let_go(self) -> None:
        """Refuse what is held since before a STOP, a loss of control, or a way that was too slow.

        Raises ``GuardRefused``: it was not let go of since.
        """
        if self._has_to_let_go:
            raise GuardRefused(
                f"{self._has_to_let_go}, and something is still held; it was not flown",
                guard="let_go",
                measured=None,
                limit=None,
                remedy="let go of keys, sticks and shoulder buttons, then press again",
            )

    def _check_in_time(self, at: float, late: float, held: float) -> None:
        """Refuse what is old; who could not steer for a second has to let go of everything first.

        The aircraft stood meanwhile, and perhaps nobody looks when the way is fast again.

        Raises ``GuardRefused``: see :meth:`_check_way`.
        """
        try:
            self._check_way(late, held)
        except GuardRefused:
            self._late_since = at if self._late_since is None else self._late_since
            if at - self._late_since > SPENT_AFTER:
                self._has_to_let_go = self._has_to_let_go or "the way was too slow"
            raise
        self._late_since = None

    def _steer(self, lease: Lease, message: dict[str, Any], late: float, held: float) -> None:
        self.refusal, at = None, message["at"] / 1000.0
        try:
            self._heard_beat(lease, at)
            self._check_in_time(at, late, held)
            self._check_let_go()
            setpoint = setpoint_of(
                message["mode"], message["x"], message["y"], message["z"], message["w"]
            )
        except M100Error as error:
            self._agent.keep(lease)  # the operator is there
            self._steer_refused(lease.number, error)
        else:
            self.beats += 1
            self._press.passed(self._agent.now)
            self._agent.steer(lease, setpoint, BEAT_LIFETIME)

    def _steer_refused(self, fence: int, error: M100Error) -> None:
        if self.lease is None or self.lease.number != fence:
            return
        self.refused += 1
        self.refusal = error
        now = self._agent.now
        self._press.refused(error, now)
        if now - self._complained_at >= _COMPLAINT_PAUSE:
            self._complained_at = now
            self._agent.note(f"{self.name}: {error.seen}", "warning")

    # -- what others take ------------------------------------------------------------------------

    def _lease_changed(self, message: LeaseChanged) -> None:
        is_ours = self.lease is not None and message.number == self.lease.number
        if self.lease is not None and not is_ours and self.lease_end is None:
            self.lease_end, self.loss = message, None

    def _authority_taken(self, error: AuthorityLost) -> None:
        if self.has_lease:
            self.loss = LossReason(error.reason)  # a text once it has been a message
            self._has_to_let_go = "control was lost meanwhile"

    # -- the end ---------------------------------------------------------------------------------

    def lost(self) -> None:
        """The socket is gone: stop, and let others have control."""
        self._way = ClockEstimate(PAGE_GRAIN)  # the next one may take another way
        self.let_go()
        self.kept.let_go()

    def close(self) -> None:
        """The tab is gone for good."""
        self.lost()
        while self._heard:
            callbacks, callback = self._heard.pop()
            callbacks.remove(callback)


def _read(text: str | bytes) -> dict[str, Any] | None:
    """A message with every field of the right type, or None."""
    if len(text) > MAX_BEAT:
        return None
    try:
        message = read_json(text)
    except ValueError:
        return None
    if not isinstance(message, dict) or message.get("op") not in ("beat", "rest", "alive", "stop"):
        return None
    numbers, integers = ["at"], ["n"]
    if message["op"] == "beat":
        numbers += ["x", "y", "z", "w"]
        integers += ["mode"]
    if "told" in message or "held" in message:  # both times of the station, or none
        numbers += ["told", "held"]
    are_numbers = all(_is_number(message.get(name)) for name in numbers)
    return message if are_numbers and all(type(message.get(n)) is int for n in integers) else None


def _is_number(value: Any) -> TypeGuard[float]:
    if not isinstance(value, int | float) or isinstance(value, bool):
        return False
    return abs(value) < 1e15  # neither NaN nor what overflows when it is reckoned with


# -- the fate of the beats of a press --------------------------------------------------------------
# The page shows this fate instead of what it sent. A beat counts as flown once the agent took it.
# The agent answers only beats that it refuses, and reports its state all the time. So when it has
# reported since, and no refusal of a beat older than :data:`CERTAIN_AFTER` seconds came, that beat
# was flown.

CERTAIN_AFTER = 0.1  # seconds in which the agent would have refused

_TOLD_FOR = 0.3  # as long as a beat lasts: it was refused just now


class Fate(StrEnum):
    """What the page shows of a held key, stick or gamepad."""

    SENT = "sent"  # nobody knows yet
    FLOWN = "flown"
    NO_CONTROL = "no_control"  # this tab has none, or the aircraft obeys somebody else
    ON_GROUND = "on_ground"  # it stands: setpoints move nothing
    SLOW = "slow"
    LET_GO = "let_go_first"
    REFUSED = "refused"  # the line of problems says why


_GUARDS = {
    "way_late": Fate.SLOW,
    "way_unheard": Fate.SLOW,
    "way_round_trip": Fate.SLOW,
    "setpoint_age": Fate.SLOW,
    "let_go": Fate.LET_GO,
}


class Press:
    """One press of keys, sticks or a gamepad, and how much of it was carried out."""

    def __init__(self) -> None:
        # When it began to go on to the agent, when it last did, and when it was last refused.
        self._since = self._passed_at = self._refused_at = -math.inf
        self._why = Fate.REFUSED

    def passed(self, now: float) -> None:
        """Note that a beat went on to the agent."""
        if now - self._passed_at > _TOLD_FOR:
            self._since = now
        self._passed_at = now

    def refused(self, error: M100Error, now: float) -> None:
        """Note that a beat was refused, here or by the agent."""
        guard = error.guard if isinstance(error, GuardRefused) else ""
        self._why, self._refused_at = _GUARDS.get(guard, Fate.REFUSED), now
        self._passed_at = -math.inf  # what comes after it is another press

    def fate(self, agent: AgentClient, now: float, *, has_lease: bool) -> Fate:
        """Return its fate until now."""
        if not has_lease or not agent.has_authority:
            return Fate.NO_CONTROL
        if now - self._refused_at <= _TOLD_FOR:
            return self._why
        if agent.view.is_on_ground:
            return Fate.ON_GROUND
        if self._passed_at < self._since or agent.heard_at - self._since < CERTAIN_AFTER:
            return Fate.SENT
        return Fate.FLOWN
