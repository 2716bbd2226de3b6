"""A remote control made of commands (firmware 3.1): it flies without control authority.

So it is movement, and watched over like a control block: one at a time beside those, ended by
whatever ends them, and its sticks go back to the centre when nobody renews them.
"""

from __future__ import annotations

import asyncio
import logging
from functools import partial
from typing import Self

from m100link.errors import (
    AuthorityLost,
    AuthorityRefused,
    GuardRefused,
    LinkClosed,
    LinkError,
    LossReason,
    M100Error,
    NoAuthority,
    NotObserved,
    TaskRefused,
    UsageError,
)
from m100link.flight.cancellation import SIGNALS, ProgramTask, ShieldedTask
from m100link.flight.guardian import Guardian, GuardianPlan, patience_of, virtual_rc_plan
from m100link.flight.guards import FIRST_VALUES_S, GuardKeeper, Guards, known
from m100link.flight.lifecycle import (
    STOP_PLANS,
    BlockClaim,
    BlockInput,
    BlockState,
    Lifecycle,
    StopCause,
)
from m100link.flight.reserves import free, reserve
from m100link.flight.tasks import (
    CENTRED,
    GESTURE,
    Commander,
    Deflections,
    SettingsPace,
    is_on_ground,
    stands,
)
from m100link.flight.watchdog import TelemetryWatchdog
from m100link.protocol.command import in_range
from m100link.protocol.commands.virtual_rc import VirtualRcSettings
from m100link.protocol.records import ControlDevice, RcMode, RemoteControl

_logger = logging.getLogger(__name__)

DEAD_MAN_S = 0.5  # seconds that sticks stay where they were put; then they go back to the centre

ABANDONED_S = 3.0
"""Seconds without renewal after which it is switched off: the pilot's sticks fly again."""

_PERIOD_S = 0.1
_NEUTRAL_S = 0.3
_AIRCRAFT_WAITS_S = 0.9  # after a second without channels the aircraft has ended it
_SHOWN_S = 1.2
_GESTURE_S = 2.3  # the aircraft wants 2 s (our estimate)

_HOPELESS = frozenset(cause for cause, plan in STOP_PLANS.items() if not plan.release)
"""Where it is not switched off here: nobody hears it, or the guardian does it."""

_SILENT = _HOPELESS | {cause for cause, plan in STOP_PLANS.items() if plan.explain}
"""Where no centred sticks are sent any more: there, and where somebody else has the aircraft."""


class VirtualRc:
    """A remote control made of commands: ``async with aircraft.virtual_rc() as rc``.

    **It moves the aircraft without control authority.** The pilot's way out is the mode switch:
    leaving F ends it, so it does not begin unless the switch is seen in F. A task sends the sticks
    ten times a second. Sticks that are not renewed for 0.5 s go back to the centre, in which the
    aircraft hovers; after 3 s it is switched off, the block is cancelled, and the pilot's own
    sticks fly.

    Leaving, in whatever way, centres the sticks and switches it off; that takes up to 2.2 s,
    because settings that come faster than every 2 s lock the aircraft. A program that dies leaves
    the sticks where they were for up to a second; then the pilot's own remote control
    flies, unless ``fall_back=False`` was named: then the aircraft acts as if its remote control
    were lost, and goes home.

    Args:
        commander: The aircraft.
        claim: One thing flies at a time.
        pace: When settings may be sent.
        fall_back: Whether the pilot's own remote control flies when the channels stop.
        guards: Safety guards; all on by default.
        handle_signals: Let signals that end programs take the stop path first.
        guardian: As of ``aircraft.control()``.
    """

    def __init__(
        self,
        commander: Commander,
        claim: BlockClaim,
        pace: SettingsPace,
        *,
        fall_back: bool = True,
        guards: Guards | None = None,
        handle_signals: bool = True,
        guardian: bool | float = True,
    ) -> None:
        self._commander = commander
        self._requests = commander.requests
        self._claim = claim
        self._pace = pace
        self._falls_back = fall_back
        self._handles_signals = handle_signals
        self._loop = commander.link.loop
        self._clock = self._loop.time
        self._life = Lifecycle()
        self._program = ProgramTask(self._loop)
        self._stopping = ShieldedTask(self._stop, self._on_stopped)
        self._guardian = Guardian(
            commander.link,
            self._is_to_end,
            self._guardian_plan,
            partial(self._end, StopCause.GUARDIAN),
            patience_of(guardian),
        )
        self._on_signal = partial(self._end, StopCause.SIGNALLED)
        state, latency = commander.state, commander.link.latency
        self._guards = GuardKeeper(guards or Guards(), state, latency=latency)
        self._watchdog = TelemetryWatchdog(
            state, self._guards.guards, self._end, self._loop, latency=latency
        )
        self._sticks = CENTRED
        self._renewed_at = 0.0
        self._sent_at = 0.0  # the newest channels
        self._timer: asyncio.TimerHandle | None = None
        self._is_on = False  # settings that switch it on were sent, and none that switch it off
        self._was_shown = False  # telemetry said that it is on
        self._refused: GuardRefused | None = None  # why the sticks were centred

    def __repr__(self) -> str:
        return f"<VirtualRc {self._life.state.name.lower()}, sticks {tuple(self._sticks)}>"

    @property
    def is_flying(self) -> bool:
        """Whether sticks are sent, and nothing has ended that."""
        return self._life.state is BlockState.FLYING

    # -- in and out ------------------------------------------------------------------------------

    async def __aenter__(self) -> Self:
        self._commander.link.require_loop()
        if self._life.state is not BlockState.NEW:
            raise UsageError("this virtual RC was entered before; ask for a new one")
        settings = VirtualRcSettings(True, self._falls_back)
        await self._requests.admit(settings)  # firmware, activation: before anything is claimed
        self._claim.take(self._close)  # first: what flies already keeps its firmware
        try:
            self._requests.fix_firmware()
            reserve("virtual RC", self._close)
        except M100Error:
            self._claim.give_back()
            self._requests.free_firmware()
            raise
        self._stopping.park(partial(self._end, StopCause.LEFT))
        self._life.feed(BlockInput.ENTER)
        self._program.enter()
        if self._handles_signals:
            SIGNALS.join(self._on_signal)
        try:
            await self._guardian.start()
            await self._switch_on(settings)
        except BaseException as error:
            self._end(StopCause.NOT_ENTERED)
            await self._leave(error)
            raise
        if not self._life.is_open:  # ended between the settings and here
            await self._leave(None)
            raise asyncio.CancelledError
        return self

    async def __aexit__(self, kind: object, exc: BaseException | None, traceback: object) -> bool:
        self._end(StopCause.LEFT)
        return await self._leave(exc)

    async def _leave(self, error: BaseException | None) -> bool:
        self._program.leave()
        try:
            await self._stopping.ended()
        finally:
            is_ours = self._program.take_back(error)
        failure = self._life.failure
        if failure is not None and (error is None or is_ours):
            raise failure.again() from failure.__cause__
        # After a signal the program does not go on behind the block as if it had flown.
        return is_ours and self._life.cause is not StopCause.SIGNALLED

    async def _switch_on(self, settings: VirtualRcSettings) -> None:
        await self._pace.wait()
        # After the wait of up to 2.2 s, in which the pilot may have left F.
        await self._require_f()
        if self._life.state is not BlockState.ENTERING:
            return
        if not self._pace.send(self._commander, settings):
            raise LinkError(
                "virtual RC was not switched on: the line does not drain",
                cause="more is sent than the baud rate carries, or the other end stands still",
            )
        self._is_on = True
        self._guardian.update()
        self._guards.start()
        self._watchdog.start()
        self._renewed_at = self._sent_at = self._clock()
        self._life.feed(BlockInput.OBTAINED)
        self._beat()
        await self._see_it_on()

    async def _require_f(self) -> None:
        """``AuthorityRefused`` unless the switch is seen in F: the pilot ends it by leaving F."""
        deadline = self._clock() + FIRST_VALUES_S
        while (rc := known(self._commander.state, RemoteControl)) is None:
            if self._clock() >= deadline:
                break
            await asyncio.sleep(_PERIOD_S)
        if rc is None or rc.mode_switch is not RcMode.F:
            where = "nobody knows where" if rc is None else f"in {rc.mode_switch.name}"
            raise AuthorityRefused(
                f"virtual RC was not switched on: the mode switch is {where}",
                command=VirtualRcSettings.NAME,
                cause="leaving F is how the pilot ends it, so it begins in F alone",
                remedy="move the mode switch to F; the rc item must be sent",
            )

    async def _see_it_on(self) -> None:
        """Raise ``NotObserved`` unless the control item shows it on, where that is sent."""
        deadline = self._clock() + _SHOWN_S + self._commander.link.latency.slack_s
        while self._life.is_open and not self._was_shown:
            await asyncio.sleep(_PERIOD_S)
            self._renewed_at = self._clock()  # no program can renew the sticks while it enters
            if self._renewed_at < deadline:
                continue
            if known(self._commander.state, ControlDevice) is None:
                _logger.warning(
                    "the control_device item is not sent: nobody knows whether virtual RC is on"
                )
                return
            raise NotObserved(
                "virtual RC was switched on, and telemetry does not show it",
                situation=self._commander.state.situation(),
                cause="the command was lost, or the aircraft does not obey it",
                remedy="look at the control_device item; try again",
            )

    def _end(self, cause: StopCause, failure: M100Error | None = None) -> None:
        """Something ends it: the sticks are centred at once, the rest is a task of its own."""
        is_first = self._life.state is not BlockState.STOPPING
        if not self._life.feed(cause, failure):
            return
        self._sticks = CENTRED
        if self._timer is not None:
            self._timer.cancel()
        if is_first:
            self._stopping.begin()  # first: it takes less of the stack than a frame that is sent
            self._say_neutral()
            if cause not in (StopCause.LEFT, StopCause.NOT_ENTERED):
                self._program.cancel()

    async def _close(self) -> None:
        """The connection is about to be closed."""
        error = LinkClosed("the aircraft was disconnected while a virtual RC was flying it")
        self._end(StopCause.CLOSED, error)
        await self._stopping.ended()

    def _say_neutral(self) -> None:
        """Centred sticks, where they can help; not after the pilot has ended it."""
        if not self._is_on or self._life.cause in _SILENT:
            return
        try:
            self._requests.push(CENTRED.encoded())
        except Exception as error:  # noqa: BLE001 (whatever it is: switching off must come)
            _logger.error("no centred sticks were sent: %s", error)

    def _is_to_end(self) -> bool:
        """Whether the guardian would have to end it if this program ended now."""
        return self._is_on and self._life.cause not in _SILENT

    def _guardian_plan(self, is_to_end: bool) -> GuardianPlan:
        if not is_to_end:
            return GuardianPlan()
        return virtual_rc_plan(self._commander, falls_back=self._falls_back)

    async def _stop(self) -> None:
        """Switch it off, and let the guardian go. May be begun again."""
        try:
            await self._centre_and_switch_off()
        finally:
            await self._guardian.end()

    async def _centre_and_switch_off(self) -> None:
        """Centred sticks until it may be switched off, then off."""
        # Settings within 2 s of the last ones lock the aircraft, so that even the mode switch does
        # nothing (DJI's header): until then centred sticks go out, in which the aircraft hovers.
        settle_until = self._clock() + _NEUTRAL_S
        while self._is_on and self._life.cause not in _HOPELESS:
            if self._clock() >= max(settle_until, self._pace.free_at):
                self._switch_off()
                return
            await asyncio.sleep(_PERIOD_S)
            self._say_neutral()

    def _switch_off(self) -> None:
        try:
            if self._pace.send(self._commander, VirtualRcSettings(False, self._falls_back)):
                self._is_on = False
                return
        except LinkError as error:
            _logger.error("virtual RC was not switched off: %s", error.seen)
        self._is_on = False  # silence: the aircraft ends it after a second
        _logger.error("virtual RC was not switched off; it ends a second after the last channels")

    def _on_stopped(self) -> None:
        self._life.feed(BlockInput.STOPPED)
        self._watchdog.stop()
        self._requests.free_firmware()
        self._claim.give_back()
        free(self._close)
        SIGNALS.leave(self._on_signal)  # last: a signal that came may end the process here

    # -- sticks ----------------------------------------------------------------------------------

    def set(
        self, *, roll: float = 0.0, pitch: float = 0.0, yaw: float = 0.0, throttle: float = 0.0
    ) -> None:
        """Put the sticks there for 0.5 s, unless they are put there again.

        Args:
            roll: -1 (left) to 1 (right).
            pitch: -1 (back) to 1 (forward).
            yaw: -1 (turn left) to 1 (turn right).
            throttle: -1 (down) to 1 (up).

        The guards are asked, now and before each frame: full deflection is taken for 17 m/s.

        Raises:
            UsageError: Beyond -1...1, or the corner that starts and stops motors.
            GuardRefused: A guard said no, now or since the last call; the sticks are centred.
            NoAuthority: Outside its block; or what ended it.
        """
        self._require_flying()
        sticks = Deflections(roll, pitch, throttle, yaw)
        for name, deflection in sticks._asdict().items():
            in_range(f"{name} stick", deflection, -1.0, 1.0)
        if sticks.are_in_corner:
            raise UsageError(
                "these sticks start and stop the motors",
                remedy="say so by its name: await rc.toggle_motors()",
            )
        refused, self._refused = self._refused, None
        if refused is not None:
            raise refused.again()
        if sticks != CENTRED:
            try:
                self._guards.check_sticks(sticks.roll, sticks.pitch, sticks.throttle, sticks.yaw)
            except GuardRefused:
                self._sticks = CENTRED
                raise
        self._sticks = sticks
        self._renewed_at = self._clock()

    async def hold(
        self,
        seconds: float,
        *,
        roll: float = 0.0,
        pitch: float = 0.0,
        yaw: float = 0.0,
        throttle: float = 0.0,
    ) -> None:
        """Keep the sticks there for so long, then centre them.

        Raises: as :meth:`set`.
        """
        in_range("seconds", seconds, 0.0, 3600.0, "s")
        end_at = self._clock() + seconds
        try:
            while (rest := end_at - self._clock()) > 0:
                self.set(roll=roll, pitch=pitch, yaw=yaw, throttle=throttle)
                await asyncio.sleep(min(_PERIOD_S, rest))
        finally:
            if self.is_flying:
                self._sticks = CENTRED
                self._renewed_at = self._clock()

    async def toggle_motors(self) -> None:
        """Start or stop the motors, by both sticks in the corner for 2.3 s. On the ground alone.

        Raises:
            TaskRefused: It is in the air, or nobody knows; nothing was sent.
            GuardRefused: As for a take-off.
            NoAuthority: Outside its block; or what ended it.
        """
        self._require_flying()
        await self._guards.admit_take_off()
        # Again: the guards may have waited 1.5 s for their values.
        self._require_flying()
        if not await stands(self._commander.state):
            raise TaskRefused(
                "the motors were not toggled: the aircraft is not known to be on the ground",
                command="toggle_motors",
                situation=self._commander.state.situation(),
                remedy="land first; the flight_status item must be sent",
            )
        end_at = self._clock() + _GESTURE_S
        # Off the ground it ends: the gesture that starts motors stops them, too.
        try:
            while self._clock() < end_at and is_on_ground(self._commander.state):
                self._require_flying()
                self._sticks = GESTURE
                self._renewed_at = self._clock()
                await asyncio.sleep(_PERIOD_S)
        finally:
            self._sticks = CENTRED

    def _require_flying(self) -> None:
        self._commander.link.require_loop()
        if self.is_flying and self._watchdog.is_quiet():
            return
        if self._life.failure is not None:
            raise self._life.failure.again()
        raise NoAuthority(
            "sticks were moved while this virtual RC is not on; nothing was sent",
            remedy="move them inside `async with aircraft.virtual_rc()`",
        )

    def _beat(self) -> None:
        """Send what is due, and come again. Whatever happens here ends it, and never in silence."""
        try:
            self._send()
        except LinkError as error:
            self._end(StopCause.LINK_LOST, error.again())
        except M100Error as error:
            self._end(StopCause.SENDING_FAILED, error)
        except Exception as error:  # noqa: BLE001 (reported with its cause)
            failure = M100Error(f"the sticks cannot be sent: {error!r}")
            failure.__cause__ = error
            self._end(StopCause.SENDING_FAILED, failure)
        if self._life.state is BlockState.FLYING:
            now = self._clock()
            # Sticks that expire between two beats go back then, and not a tenth of a second later.
            expires_at = self._renewed_at + DEAD_MAN_S
            is_soon = self._sticks != CENTRED and now < expires_at < now + _PERIOD_S
            self._timer = self._loop.call_at(expires_at if is_soon else now + _PERIOD_S, self._beat)

    def _send(self) -> None:
        now = self._clock()
        self._require_wanted(now)
        if not self._watchdog.is_quiet() or not self.is_flying:
            return
        why = ""
        if now >= self._renewed_at + DEAD_MAN_S - 1e-6 and self._sticks != CENTRED:
            self._sticks, why = CENTRED, "they were not renewed in time"
        if self._sticks not in (CENTRED, GESTURE):
            try:
                self._guards.check_sticks(*self._sticks)
            except GuardRefused as error:
                self._refused, self._sticks, why = error, CENTRED, error.seen
        if self._requests.push(self._sticks.encoded()):
            self._sent_at = now
        if why:  # centred first: a log can take its time
            _logger.warning("the sticks are centred: %s", why)

    def _require_wanted(self, now: float) -> None:
        """Raise what ends it besides the program; looked at before each frame."""
        if now - self._sent_at > _AIRCRAFT_WAITS_S:
            raise NotObserved(
                f"no channels could be sent for {now - self._sent_at:.1f} s: virtual RC has ended",
                cause="this program was blocked, or the line does not drain",
                remedy="a program that blocks must not fly",
            )
        if now - self._renewed_at > ABANDONED_S:
            raise AuthorityLost(
                f"the sticks were not renewed for {ABANDONED_S:g} s: virtual RC was switched off",
                reason=LossReason.RELEASED,
                remedy="call set() at least every 0.5 s, or hold()",
            )
        shown = known(self._commander.state, ControlDevice)
        shown_at = self._commander.state.received_at(ControlDevice)
        if shown is None or shown_at is None:
            return
        if shown.is_virtual_rc:
            self._was_shown = True
        elif self._was_shown:
            failure = AuthorityLost(
                "telemetry shows that virtual RC is off",
                reason=LossReason.MODE_SWITCH,
                cause="the pilot left F, or no channels arrived for a second",
            )
            self._end(StopCause.AUTHORITY_LOST, failure)
