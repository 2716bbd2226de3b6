"""One browser tab of the console: its control session, and its beats.

A tab steers by *beats*: twenty a second while a key is held, with the numbers of the stick. A beat
lasts :data:`BEAT_LIFETIME`; without the next one the aircraft stops, whatever the reason: key
released, focus lost, tab closed, socket gone, browser hanging. Between times the tab tells that it
is alive, which keeps its lease.

The time at which the key was held counts, not the time at which that became known: each message
has the page's time, and the station's time that the page heard last. A beat that waited on its
way is refused, and nobody steers by a picture that is old.
"""

from __future__ import annotations

import asyncio
import math
import re
from collections.abc import Awaitable, Callable
from contextvars import ContextVar
from dataclasses import dataclass
from enum import StrEnum
from operator import mul
from typing import Any, TypeGuard

from m100link.apps.agent import orders
from m100link.apps.agent.background import ignore
from m100link.apps.agent.client import PRESSED_AT, AgentClient, VehicleView
from m100link.apps.agent.control_session import ControlSession, ControlState, Terms
from m100link.apps.agent.latency import (
    MAX_LATE,
    MAX_ORDER_LATE,
    MAX_ROUND_TRIP,
    MAX_UNHEARD,
    PAGE_GRAIN,
    ClockEstimate,
)
from m100link.apps.agent.messages import OrderOutcome
from m100link.apps.agent.orders import LIVES, Life, News, setpoint_of
from m100link.apps.station.config import ONLY_NAME
from m100link.errors import GuardRefused, M100Error, NotObserved, SetpointsIgnored
from m100link.errors.texts import read_json
from m100link.protocol.records import AngularVelocity, Attitude, RcMode, Velocity
from m100link.protocol.setpoint import Horizontal, Setpoint

BEAT_LIFETIME = 0.3  # seconds that a beat lasts

SPENT_AFTER = 1.0
"""Seconds of the page without a beat after which it has let go of everything by itself."""

TERMS = Terms(begins_anew=True, who="this page", remedy="obtain control first")

# Why a hand that still holds a key has to let go, by the state of control.
_HAS_TO_LET_GO = {
    ControlState.OBTAINING: "control was obtained meanwhile",
    ControlState.STOPPED: "STOP was pressed",
    ControlState.SUSPENDED: "control was lost meanwhile",
}

# The order that the present task carries out.
_ISSUED: ContextVar[IssuedOrder] = ContextVar("issued")

MAX_BEAT = 2000
_COMPLAINT_PAUSE = 1.0


class Tab:
    def __init__(
        self,
        agent: AgentClient,
        name: str,  # who looks at it, for people
        aircraft: str = ONLY_NAME,
        # Control of other aircraft and perhaps of this one, which came along from another page.
        kept: dict[str, ControlSession] | None = None,
    ) -> None:
        self._agent = self.agent = agent
        self.aircraft = aircraft
        self.kept = {} if kept is None else kept  # lasts as long as this tab is heard
        self.refusal: M100Error | None = None  # the last one; None for nothing
        self.beats = 0  # beats that were sent on
        self.refused = 0  # messages that could not be used
        self.dropped = 0  # pictures of telemetry that its page did not get because it is slow
        self._last_number = -1
        self.way = ClockEstimate(PAGE_GRAIN)
        self._count = 0  # of orders and presses
        self._press = self._issue()
        # The newest order of this tab that moves the aircraft or ends a motion, and was not
        # refused; presses count. An order that it replaced did not fail.
        self._newest = self._press
        self.flight: IssuedOrder | None = None  # the newest one to where its operator points
        self._refused_until, self._why = -math.inf, Fate.REFUSED  # the newest beat that was refused
        self._complained_at = -math.inf
        self._stopping: asyncio.Task[Any] | None = None  # one at a time, however often it is said
        # Why a hand that holds a key moves nothing until it lets go. Empty when it may.
        self._has_to_let_go = ""
        self._beat_at = -math.inf  # the last one, flown or refused, by the page's clock
        self._late_since: float | None = None  # the first late one since one was in time
        self._stop_press: object = None  # which press of STOP the task above answers
        self.session = self._have(self.kept.pop(aircraft, None), name)

    def _have(self, session: ControlSession | None, name: str) -> ControlSession:
        session = session or ControlSession(self._agent, name, TERMS)
        session.name = name
        session.on_change, session.on_refused = self._control_changed, self._refused
        self._control_changed(session.state)
        return session

    def hand_on(self) -> dict[str, ControlSession]:
        """Control that goes along to the page of another aircraft; this one has none any more."""
        kept, self.kept = self.kept, {}
        if (session := self.session).has_lease:
            session.on_change = session.on_refused = ignore
            kept[self.aircraft] = session
            self.session = self._have(None, session.name)
        return kept

    @property
    def has_spoken(self) -> bool:
        """Whether its page ever said anything that could be used."""
        return self._last_number >= 0

    # -- what the buttons do ---------------------------------------------------------------------

    async def attempt(self, work: Callable[[], Awaitable[Any]], *, replaces: bool = True) -> bool:
        """Do something for the operator; a failure is kept as the problem.

        Work that a later order of this tab ended, such as STOP, is no failure. ``replaces``:
        whether this is such an order.
        """
        self.refusal, before, mine = None, self._newest, self._issue()
        if replaces:
            self._newest = mine
        answered = _ISSUED.set(mine)
        try:
            await work()
        except M100Error as error:
            mine.hear(News.FAILED, self._agent.now, error)
            is_replaced = replaces and mine is not self._newest
            # The map says what ended a flight, which hovers then: no problem.
            is_told = mine is self.flight and mine.life is Life.ENDED
            is_told = is_told and not isinstance(error, SetpointsIgnored)
            if isinstance(error, NotObserved) and (is_replaced or is_told):
                return False
            self.refusal = error
            if mine.order is not None and mine.life is Life.REFUSED:
                what = f"order {mine.number}, {mine.order.label}"
                self._agent.note(
                    f"{self.session.name}: {what}, was refused: {error.seen}", "warning"
                )
            if mine is self._newest:
                self._newest = before  # it was refused: what flew before goes on
            return False
        finally:
            _ISSUED.reset(answered)
        mine.hear(News.DONE, self._agent.now)
        return True

    async def ask(self, order: orders.Order, accepted: Callable[[], None] = ignore) -> OrderOutcome:
        """Ask as the session does. In :meth:`attempt`, this is the order whose life is shown."""
        mine = _ISSUED.get(None)
        if mine is not None:
            mine.order = order
            self.flight = mine if isinstance(order, orders.GuidedOrder) else self.flight

        def begun() -> None:
            if mine is not None:
                mine.hear(News.TAKEN, self._agent.now)
            accepted()

        return await self.session.ask(order, begun)

    def shown_flight(self) -> IssuedOrder | None:
        """The newest flight to where the operator points, until its end was shown for long."""
        flight, now = self.flight, self._agent.now
        if flight is None or now - flight.over_at > TOLD_S:
            return None
        flight.look(self._agent.view, now)
        return flight

    def _issue(self) -> IssuedOrder:
        self._count += 1
        return IssuedOrder(self._count, self._agent.now)

    async def stop(self, press: object = None) -> None:
        """Stop. Any tab may."""
        await self._stop_now(press)

    def _stop_now(self, press: object) -> asyncio.Task[Any]:
        """STOP by either way, that of the socket or of the page's other events: once a press."""
        task, is_known = self._stopping, type(press) is int and press == self._stop_press
        if task is None or (
            task.done() and not (is_known and not task.cancelled() and task.result())
        ):
            work = self.attempt(self.session.stop)
            task = self._agent.background.spawn(work, f"stop of {self.session.name}")
        self._stopping, self._stop_press = task, press
        return task

    def check_order(self, said_at: object) -> None:
        """Refuse a button that was pressed too long ago, or nobody knows when.

        ``said_at``: the page's time at the press, ms.

        Raises ``GuardRefused``: it waited on its way for more than 2 s, or a STOP overtook it.
        """
        at = said_at / 1000.0 if _is_number(said_at) else math.inf
        now = self._agent.now
        late = self.way.oldest(at, now)
        if late > MAX_ORDER_LATE or now - late <= self._agent.stopped_at:
            waited = f"arrived {late:.1f} s late" if late < math.inf else "has no time"
            if late <= MAX_ORDER_LATE:
                waited += ", and STOP came first"
            # A page that is loaded anew when the network is back does not show the problem.
            self._agent.note(
                f"{self.session.name}: a pressed button {waited}; nothing was done", "warning"
            )
            raise GuardRefused(
                f"a pressed button {waited}; nothing was done",
                guard="order_late",
                measured=late,
                limit=MAX_ORDER_LATE,
                cause="the network between the browser and the station was slow or blocked",
                remedy="look at the aircraft, then press again",
            )
        PRESSED_AT.set(now - late)  # what the task of this press asks for was wanted then

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
            self._stop_now(press)  # be it old, or a second time
        number = message["n"]
        if number <= self._last_number:
            self.refused += 1  # an old message again
            return None
        self._last_number = number
        now, session, at = self._agent.now, self.session, message["at"] / 1000.0
        for kept in self.kept.values():
            kept.heard()
        held = message.get("held", math.inf) / 1000.0
        late = self.way.late(at, now, message["told"] + held if "told" in message else None)
        if message["op"] == "beat":
            if session.has_lease:
                self._steer(message, at, late, held, now)
            self._beat_at = at
            answer["fate"], answer["order"] = self._fate(now), self._press.number
        elif session.has_lease:
            if message["op"] == "rest":
                self._press, self._refused_until = self._issue(), -math.inf
                self._let_go(message)
            session.heard()
        return answer | {"told": now}

    def _let_go(self, message: dict[str, Any]) -> None:
        """The hand let go of everything, unless a STOP came after that.

        The message may have waited on its way: its page let go after the time of the station that
        it had heard then.
        """
        if self.session.begin_anew(at=message.get("told", 0.0)):  # no time: before any STOP
            self._has_to_let_go, self._late_since = "", None

    def _heard_beat(self, message: dict[str, Any], at: float) -> None:
        """After a gap of the page's own a beat is a new press.

        ``at``: when the beat was sent, s of the page's clock: beats that wait on their way leave a
        gap here as well, with the key held all the time.
        """
        if at - self._beat_at > SPENT_AFTER:
            if self.session.state is ControlState.STOPPED:
                self._let_go(message)
            else:
                self._has_to_let_go, self._late_since = "", None

    def _check(self, at: float, late: float, held: float) -> None:
        """Refuse an order decided too long ago, by an old picture, or by a hand that has to let go.

        An operator whose beats were late for a second has to let go first: the aircraft stood
        meanwhile, and perhaps nobody looks when the way is fast again.

        Raises ``GuardRefused``: it was.
        """
        trip = self.way.round_trip
        for guard, measured, limit, seen in (
            ("way_late", late, MAX_LATE, "a key press arrived {:.1f} s late"),
            ("way_unheard", held, MAX_UNHEARD, "the page did not hear the station for {:.1f} s"),
            (
                "way_round_trip",
                math.inf if trip is None else trip,
                MAX_ROUND_TRIP,
                "the round trip to the page takes {:.1f} s",
            ),
        ):
            if measured > limit:
                self._late_since = at if self._late_since is None else self._late_since
                if at - self._late_since > SPENT_AFTER:
                    self._has_to_let_go = self._has_to_let_go or "the network was too slow"
                raise GuardRefused(
                    f"{seen.format(measured)}; it was not flown",
                    guard=guard,
                    measured=measured,
                    limit=limit,
                    cause="the network between the browser and the station is slow or blocked",
                    remedy="wait, or let go and let the pilot fly",
                )
        self._late_since = None
        if self._has_to_let_go:
            raise GuardRefused(
                f"{self._has_to_let_go}, and you still hold a key or stick; it was not flown",
                guard="let_go",
                measured=None,
                limit=None,
                remedy="let go of keys, sticks and shoulder buttons, then press again",
            )

    def _steer(
        self, message: dict[str, Any], at: float, late: float, held: float, now: float
    ) -> None:
        try:
            self._heard_beat(message, at)
            self._check(at, late, held)
            setpoint = setpoint_of(
                message["mode"], message["x"], message["y"], message["z"], message["w"]
            )
            self.session.steer(setpoint, BEAT_LIFETIME)
            self._press.wanted = setpoint
            if self._agent.state.guided is not None:
                self._newest = self._press
            self.beats += 1
            if now > self._refused_until:  # the agent, too, refused no beat of the newest
                self.refusal = None
        except M100Error as error:
            self.session.heard()  # the operator is there
            self._refused(error, lasting=0.0)

    def _refused(self, error: M100Error, lasting: float = BEAT_LIFETIME) -> None:
        """A beat was refused: by the agent, which answers later beats later, or at once here."""
        self.refused += 1
        if self.refusal is None or _worded(self.refusal) != _worded(error):
            self.refusal = error  # else its line stands: it is read out once, not with each beat
        if isinstance(error, GuardRefused) and error.guard == "stopped":
            self._has_to_let_go = error.seen.partition(";")[0]  # STOP, or somebody else's hover
        guard = error.guard if isinstance(error, GuardRefused) else ""
        now = self._agent.now
        self._why, self._refused_until = _GUARDS.get(guard, Fate.REFUSED), now + lasting
        if now - self._complained_at >= _COMPLAINT_PAUSE:
            self._complained_at = now
            self._agent.note(f"{self.session.name}: {error.seen}", "warning")

    def _fate(self, now: float) -> Fate:
        """The display of the page for the keys and sticks that are held."""
        view, press = self._agent.view, self._press
        why = self._obstacle(view, now)
        if why is not None:
            press.hear(News.FAILED, now, why)
            return why
        if press.is_over:  # what was in its way is gone
            wanted, press = press.wanted, self._issue()
            self._press, press.wanted = press, wanted
        press.look(view, now)
        is_ignored = press.life is Life.ACCEPTED and now - press.shown_at > IGNORED_S
        return Fate.IGNORED if is_ignored and _moves(press.wanted) else Fate(press.life.value)

    def _obstacle(self, view: VehicleView, now: float) -> Fate | None:
        """Why nothing of what is held can be flown; None while nothing is known of the kind."""
        if not self.session.has_lease:
            return Fate.OTHER if view.holder.number else Fate.NO_CONTROL
        if not view.has_authority:
            return Fate.NO_CONTROL if view.switch in (None, RcMode.F) else Fate.PILOT
        if view.is_on_ground:
            return Fate.ON_GROUND
        return self._why if now <= self._refused_until else None

    def _control_changed(self, state: ControlState) -> None:
        if why := _HAS_TO_LET_GO.get(state):
            is_weaker = state is ControlState.OBTAINING and self._has_to_let_go
            self._has_to_let_go = self._has_to_let_go if is_weaker else why

    def lost(self) -> None:
        """The socket is gone: stop, or land as was asked for, and let others have control."""
        self.way = ClockEstimate(PAGE_GRAIN)  # the next one may take another way
        self.session.leave()
        kept, self.kept = self.kept, {}
        for session in kept.values():
            session.close()

    def close(self) -> None:
        self.lost()
        self.session.close()


_NUMBERS: dict[str, tuple[str, ...]] = {
    **dict.fromkeys(("rest", "alive", "stop"), ("at",)),
    "beat": ("at", "x", "y", "z", "w"),
}


def _read(text: str | bytes) -> dict[str, Any] | None:
    """A message with every field of the right type, or None."""
    if len(text) > MAX_BEAT:
        return None
    try:
        message = read_json(text)
    except ValueError:
        return None
    op = message.get("op") if isinstance(message, dict) else None
    if type(op) is not str or op not in _NUMBERS or type(message.get("n")) is not int:
        return None
    numbers = _NUMBERS[op]
    if "told" in message or "held" in message:  # both times of the station, or none
        numbers += ("told", "held")
    for name in numbers:
        value = message.get(name, math.nan)
        # Neither a truth, nor NaN, nor what overflows when it is reckoned with.
        if type(value) not in (int, float) or not -1e15 < value < 1e15:
            return None
    return message if op != "beat" or type(message.get("mode")) is int else None


def _worded(error: M100Error) -> str:
    """Its text but for the numbers, which are others with each beat."""
    return re.sub(r"[\d.]+", "", error.seen)


def _moves(wanted: Setpoint | None) -> bool:
    return wanted is not None and wanted != wanted.neutral()


def _is_number(value: Any) -> TypeGuard[float]:
    return type(value) in (int, float) and -1e15 < value < 1e15


# -- the life of a press and of a button -----------------------------------------------------------
# A page shows this, and not what it sends. The agent reports whether the setpoints of this tab go
# out to the aircraft, and telemetry whether it moves as they want: without both nothing is flown.

OLD_S = 0.3
"""Seconds without news of the agent, or of the motion, after which nobody knows what is flown."""

IGNORED_S = 3.0
"""Seconds for which the aircraft may show nothing of what goes out to it: it brakes before."""

LOST_S = 0.5
"""Seconds for which an agent may fly nothing before the outcome of a flight arrives."""

TOLD_S = 10.0
"""Seconds for which the end of a flight is shown."""

_FOLLOWED = 0.3  # part of what is wanted that telemetry has to show
_NEARER_S = 0.2  # by which the rest of a flight has to become shorter


class Fate(StrEnum):
    """The display of the page for a held key, stick or gamepad: its life, or why none."""

    SENT = Life.SENT.value
    ACCEPTED = Life.ACCEPTED.value
    FLOWN = Life.FLOWN.value
    OLD = Life.OLD.value
    NO_CONTROL = "no_control"  # this tab has none, or the aircraft obeys somebody unknown
    OTHER = "other"  # another client has it
    PILOT = "pilot"  # the mode switch is out of F
    ON_GROUND = "on_ground"  # it stands: setpoints move nothing
    SLOW = "slow"
    LET_GO = "let_go_first"
    FENCE = "fence"
    IGNORED = "ignored"  # they go out, and the aircraft does not follow
    REFUSED = "refused"  # the line of problems says why


_GUARDS = {
    "way_late": Fate.SLOW,
    "way_unheard": Fate.SLOW,
    "way_round_trip": Fate.SLOW,
    "setpoint_age": Fate.SLOW,
    "let_go": Fate.LET_GO,
    "stopped": Fate.LET_GO,
    "envelope": Fate.FENCE,
}


def follows(wanted: Setpoint, view: VehicleView) -> bool | None:
    """Whether telemetry shows motion in each direction that a beat wants; None: nobody knows."""
    speed, rates, across = view.together(Velocity), view.together(AngularVelocity), None
    if wanted.mode.horizontal is Horizontal.TILT:
        if (attitude := view.together(Attitude)) is not None:
            across = attitude.roll_deg, attitude.pitch_deg
    elif speed is not None:
        across = speed.north_m_s, speed.east_m_s
    found: bool | None = False  # nothing is wanted
    for want, shown in (
        ((wanted.x, wanted.y), across),
        ((wanted.z,), None if speed is None else (speed.up_m_s,)),
        ((wanted.yaw,), None if rates is None else (rates.yaw_rate_deg_s,)),
    ):
        if any(want):
            if shown is None:
                return None
            found = sum(map(mul, want, shown)) >= _FOLLOWED * sum(map(mul, want, want))
            if not found:
                break
    return found


@dataclass(slots=True, eq=False)
class IssuedOrder:
    """One order of a tab, or one press of keys and sticks, and how far it has come."""

    number: int
    begun_at: float  # s
    order: orders.Order | None = None  # None: keys and sticks, or nothing that an agent does
    wanted: Setpoint | None = None  # by keys and sticks, if anything moves
    life: Life = Life.SENT
    why: M100Error | Fate | None = None  # it was refused, or ended
    over_at: float = math.inf  # s
    shown_at: float = math.inf  # when telemetry showed it last, or it was accepted, s
    left_s: float = math.inf  # seconds that a flight has left at least
    nearer_at: float = -math.inf  # when that became less, s
    guided_at: float = -math.inf  # when the agent flew it last, or accepted it, s

    @property
    def is_over(self) -> bool:
        return not LIVES[self.life]

    def hear(self, news: News, now: float, why: M100Error | Fate | None = None) -> None:
        before, self.life = self.life, LIVES[self.life].get(news, self.life)
        if before is Life.SENT is not self.life:
            self.shown_at = self.guided_at = now
        elif news is News.SEEN:
            self.shown_at = now
        if self.is_over and LIVES[before]:
            self.over_at, self.why = now, why

    def look(self, view: VehicleView, now: float) -> None:
        """Hear the newest view of the aircraft."""
        is_taken, is_shown = self._of_flight(view) if self.order else self._of_press(view)
        if is_taken and now - view.heard_at <= OLD_S and is_shown is not None:
            self.hear(News.TAKEN, now)
            self.hear(News.SEEN if is_shown else News.UNSEEN, now)
        else:
            self.hear(News.SILENCE if is_taken else News.LEFT, now)

    def _of_press(self, view: VehicleView) -> tuple[bool, bool | None]:
        """Whether its setpoints go out to the aircraft, and what telemetry shows of them."""
        state, age = view.state, view.state.setpoint_age
        if self.wanted is None or age is None or state.at - age < self.begun_at - PAGE_GRAIN:
            return False, None
        return True, follows(self.wanted, view)

    def _of_flight(self, view: VehicleView) -> tuple[bool, bool | None]:
        """The same of a flight to where somebody points. It left where its outcome was lost."""
        if view.is_heard and (guided := view.state.guided) is not None:
            self.guided_at = view.at
            left_s = math.inf if guided.seconds is None else guided.seconds
            if left_s < self.left_s - _NEARER_S:
                self.nearer_at = view.at if self.left_s < math.inf else -math.inf
                self.left_s = left_s
        is_nearer = view.at - self.nearer_at <= IGNORED_S  # it comes in steps
        is_taken = self.life is not Life.SENT and view.at - self.guided_at <= LOST_S
        return is_taken, is_nearer if view.is_heard else None
