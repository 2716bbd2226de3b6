"""The stop path of a control block: what the plan of its cause says, step by step."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Literal

from m100link.errors import (
    AckTimeout,
    AuthorityLost,
    AuthorityRefused,
    LossReason,
    M100Error,
    NotActivated,
    TaskRefused,
)
from m100link.flight.authority import AuthorityInput, AuthorityState
from m100link.flight.guardian import NOTHING, Wanted
from m100link.flight.guards import known
from m100link.flight.lifecycle import STOP_PLANS, BlockState, Lifecycle, StopCause
from m100link.flight.missions.keeper import MissionKeeper
from m100link.flight.setpoints import NEUTRAL_TIME, SetpointLoop
from m100link.flight.tasks import Commander, is_on_ground, run_task, switch_motors
from m100link.protocol.codes import AuthorityCode
from m100link.protocol.commands.control import RequestAuthority, Task
from m100link.protocol.records import (
    Battery,
    ControlDevice,
    Device,
    FlightPhase,
    FlightStatus,
    RemoteControl,
)

if TYPE_CHECKING:
    from m100link.flight.tasks import Commander
    from m100link.protocol.firmware import FirmwareProfile
    from m100link.telemetry.state import AircraftState

__all__ = [
    "StopAction",
    "StopPath",
    "authority_lost",
    "explained_loss",
    "is_unexplained",
    "obtain_authority",
    "release_authority",
]

_logger = logging.getLogger(__name__)


StopAction = Literal["hover", "land"]
"""What the stop path does after the neutral setpoint."""

_LANDING_DEADLINE_S = 60.0
_LANDING_RETRY_S = 0.5
_STATUS_POLL_S = 0.1
_STATUS_CONFIRMED_S = 0.25  # in which a second flight status comes, unless it is sent seldom
_LEAVES_THE_GROUND_S = 1.0  # after a take-off was commanded, if it does at all


class StopPath:
    """Stop of a mission, neutral, hover or land, release, as far as the cause leaves it possible.

    Args:
        commander: The aircraft.
        life: Of the control block; its plan says what is to be done.
        setpoints: What the block sends.
        missions: What the block lets the aircraft fly by itself.
        action: What the program asked for.
    """

    def __init__(
        self,
        commander: Commander,
        life: Lifecycle,
        setpoints: SetpointLoop,
        missions: MissionKeeper,
        action: StopAction,
    ) -> None:
        self._commander = commander
        self._life = life
        self._setpoints = setpoints
        self._missions = missions
        self._action: StopAction = action
        self._clock = commander.link.loop.time
        self._take_off_at: float | None = None  # the last one of this block that was not refused
        self._is_armed = False  # this block started the motors, and did not stop them

    @contextmanager
    def taking_off(self) -> Iterator[None]:
        """A take-off is commanded: while no flight status is newer, it counts as flown."""
        before, self._take_off_at = self._take_off_at, self._clock()
        try:
            yield
        except TaskRefused:
            self._take_off_at = before
            raise

    def armed(self, is_armed: bool) -> None:
        """The block starts the motors, or has stopped them."""
        self._is_armed = is_armed

    @property
    def wanted(self) -> Wanted:
        """What a guardian would have to do for the aircraft if this program ended now."""
        state, life, missions = self._commander.authority.state, self._life, self._missions
        if state is AuthorityState.NONE or life.state in (BlockState.NEW, BlockState.OVER):
            return NOTHING
        plan = STOP_PLANS[life.cause or StopCause.LEFT]
        if not self._has_authority:  # the pilot's, the app's, or nobody knows: only a release helps
            is_ours = state is AuthorityState.OBTAINING
            return Wanted(release=plan.release and not (is_ours and missions.is_of_another))
        is_kept = missions.is_detached or missions.is_of_another
        is_airborne = self._may_be_airborne(says_why=False)
        lands = plan.land and self._action == "land" and not is_kept and is_airborne
        flies_home = missions.lands_by_plan and is_airborne and not lands
        current = self._setpoints.current if plan.neutral else None
        return Wanted(
            neutral=None if current is None else current.neutral(),
            mission=missions.to_stop if plan.mission and not plan.explain else None,
            land=lands,
            release=plan.release and not is_kept and not flies_home,
        )

    def let_go(self) -> None:
        """At once: the neutral instead of the setpoint that is being sent, or nothing."""
        if self._life.plan.neutral:
            self._setpoints.neutralise()
        else:
            self._setpoints.silence()

    def _surely(self, send: Callable[[], None]) -> None:
        """A neutral that cannot be sent must not keep the steps after it from their turn."""
        try:
            send()
        except Exception as error:  # noqa: BLE001 (whatever it is: the stop path must go on)
            self._setpoints.silence()
            _logger.error("no neutral was sent, and nothing more will be: %s", error)

    async def run(self) -> None:
        """Every step in its turn, however the one before ended; every wait is bounded.

        The plan is read before each step, because the line may be lost meanwhile. May be begun
        again.
        """
        self._surely(self.let_go)  # what ended the block may have had no room on its stack for it
        failed: Exception | None = None
        steps = (
            self._explain,
            self._stop_mission,
            self._end_setpoints,
            self._land,
            self._disarm,
            self._release,
        )
        for step in steps:
            try:
                await step()
            except Exception as error:  # noqa: BLE001 (raised below: the release must come first)
                failed = failed or error
        if failed is not None:
            raise failed

    @property
    def _has_authority(self) -> bool:
        return self._commander.authority.state is AuthorityState.HELD

    async def _stop_mission(self) -> None:
        """Whether authority is held is for the aircraft to say: the stop is sent all the same.

        Except where somebody else took the aircraft: they fly it, and a failsafe on its way home is
        not to be called off. Then only a mission that demonstrably flies on is stopped.

        One that is not answered does not keep the other steps from their turn; the landing and the
        release break a mission off as well.
        """
        life = self._life
        if life.plan.mission and (
            not life.plan.explain or await self._missions.flies_on(life.failure)
        ):
            failure = await self._missions.stop()
            life.failure = life.failure or failure
        if life.cause is StopCause.GUARDIAN:
            self._missions.ended_elsewhere(life.failure)
        elif not life.plan.mission:  # perhaps only since the line was lost meanwhile
            self._missions.give_up(life.failure, "nobody can be told to stop it")
        if self._missions.left_in_flight and life.failure is not None:
            life.failure.remedy = (
                f"the {self._missions.left_in_flight} flies on by itself: take the aircraft by the "
                "mode switch, or connect again and stop it"
            )

    async def _explain(self) -> None:
        failure = self._life.failure
        if self._life.plan.explain and isinstance(failure, AuthorityLost):
            self._life.failure = await explained_loss(self._commander, failure)

    async def _end_setpoints(self) -> None:
        self._surely(self.let_go)  # when it was begun again, the task that sends may be gone
        if self._has_authority and self._setpoints.current is not None:
            await asyncio.sleep(NEUTRAL_TIME)
        if self._has_authority and self._life.plan.neutral:
            self._surely(self._setpoints.pay)  # nothing, unless this process stood still meanwhile
        await self._setpoints.stop()
        if self._is_armed and self._setpoints.sent:
            self._take_off_at = self._clock()  # any of them may have lifted it, up to now

    async def _land(self) -> None:
        """Land, although another task may be under way: the aircraft rejects it until that ended.

        A landing that was under way already ends here too. Releasing authority in the middle of
        either would leave the aircraft in the air.
        """
        if self._action != "land":
            return
        await self._missions.settled()
        if self._missions.is_detached:
            return
        if self._missions.is_of_another:
            _logger.error(
                "stop='land' did not land: a %s flies that this block did not start",
                self._missions.flying,
            )
            return
        deadline = self._clock() + _LANDING_DEADLINE_S
        while self._life.plan.land and self._has_authority and not await self._stands():
            try:
                await run_task(
                    self._commander, Task.LAND, timeout=max(1.0, deadline - self._clock())
                )
            except TaskRefused as error:
                if self._clock() < deadline:
                    await asyncio.sleep(_LANDING_RETRY_S)
                    continue
                _logger.error("the stop path could not land: %s", error)
            except M100Error as error:
                _logger.error("the stop path could not land: %s", error)
            return

    def _may_be_airborne(self, *, says_why: bool = True) -> bool:
        """What the newest status says; while nobody knows, whether a take-off was commanded."""
        state, take_off_at = self._commander.state, self._take_off_at
        status, status_at = state.flight_status, state.received_at(FlightStatus)
        if status is not None and status.status != FlightPhase.STANDBY:
            return True
        if take_off_at is not None:  # "standby" of before it left the ground proves nothing
            return status_at is None or status_at < take_off_at + _LEAVES_THE_GROUND_S
        if says_why and known(state, FlightStatus) is None:
            _logger.error(
                "stop='land' did not land: the flight status is %s, and no take-off was commanded",
                "unknown" if status is None else "old",
            )
        return False

    async def _disarm(self) -> None:
        """Blades that were started and never flew do not run on with nobody to answer for them."""
        if not self._is_armed or not self._has_authority or not self._life.plan.neutral:
            return
        deadline = self._clock() + 2 * _LEAVES_THE_GROUND_S
        while is_on_ground(self._commander) and self._may_be_airborne():
            if self._clock() >= deadline:
                break
            await asyncio.sleep(_STATUS_POLL_S)
        if not await self._stands() or not is_on_ground(self._commander):
            return  # in the air nothing of the kind is ever sent
        try:
            await switch_motors(self._commander, on=False)
        except M100Error as error:
            _logger.error("the stop path could not stop the motors: %s", error)

    async def _stands(self) -> bool:
        """Whether it is not in the air, as two flight statuses tell: one alone may be wrong."""
        state, until = self._commander.state, self._clock() + _STATUS_CONFIRMED_S
        first_at = state.received_at(FlightStatus)
        if self._may_be_airborne():
            return False
        while state.received_at(FlightStatus) == first_at:
            if self._clock() >= until:
                break
            await asyncio.sleep(0.02)
        return not self._may_be_airborne()

    async def _lands_by_plan(self) -> bool:
        """Whether it goes home or lands at the end of a mission, and not by a landing of ours."""
        return self._missions.lands_by_plan and not await self._stands()

    async def _release(self) -> None:
        if not self._life.plan.release:
            return
        await self._missions.settled()
        if self._leaves_another_in_flight():
            return
        if self._has_authority and (self._missions.is_detached or await self._lands_by_plan()):
            _logger.warning(
                "authority is kept: what the aircraft flies by itself would end without it"
            )
            return
        await release_authority(self._commander)

    def _leaves_another_in_flight(self) -> bool:
        """Whether authority is kept because the release would break off somebody else's mission.

        Also when the block could not be entered: the program that is gone may have obtained what
        this one would give back.
        """
        may_have_it = self._has_authority or self._life.cause is StopCause.NOT_ENTERED
        if not may_have_it or not self._missions.is_of_another:
            return False
        _logger.warning(
            "authority is not given back: a %s flies that this block did not start, and would be "
            "broken off; stop_mission() ends it, or the pilot's mode switch",
            self._missions.flying,
        )
        return True


# -- obtaining and releasing control authority (document 2.2.2.1, errata 24) -----------------------


_PAUSE_S = 0.05  # between requests; DJI's C library waits as long
_MAX_REQUESTS = 10
_RELEASE_DEADLINE_S = 2.0
_RELEASE_TIMEOUT_S = 0.4  # two requests of two tries each fit into the deadline
_EXPLANATION_S = 0.15  # seven RC items, or one or two control device items at 10 Hz
_EXPLANATION_STEP_S = 0.01
_EMPTY_PERCENT = 10  # DJI's level at which an aircraft lands by itself


def _needed(commander: Commander) -> int:
    """How many requests the firmware wants; one that is unknown may be one that wants two."""
    requests = commander.requests
    return requests.firmware.authority_requests if requests.knows_firmware else 2


def _most(commander: Commander) -> int:
    """How often to ask: firmware that wants two requests answers the first "in progress"."""
    return _MAX_REQUESTS if _needed(commander) > 1 else 1


async def _request(commander: Commander, *, obtain: bool, timeout: float = 0.5) -> AuthorityCode:
    return await commander.requests.execute(
        RequestAuthority(obtain=obtain), timeout=timeout, tries=2, refusal=AuthorityRefused
    )


async def _request_release(commander: Commander, *, is_last: bool) -> AuthorityCode:
    """Ask once. Unanswered, it may have arrived all the same: the second is sent nevertheless."""
    try:
        return await _request(commander, obtain=False, timeout=_RELEASE_TIMEOUT_S)
    except AckTimeout:
        if is_last:
            raise
        return AuthorityCode.RELEASING


async def obtain_authority(commander: Commander) -> None:
    """Ask until authority is ours.

    Raises:
        AuthorityRefused: With cause and remedy.
        NotActivated, LevelTooLow, KeyRejected, AckTimeout, LinkError: See each class.
    """
    authority = commander.authority
    code = AuthorityCode.NOT_CHANGED
    try:
        for attempt in range(_most(commander)):
            if attempt:
                await asyncio.sleep(_PAUSE_S)
            authority.feed(AuthorityInput.OBTAIN)
            code = await _request(commander, obtain=True)
            if code != AuthorityCode.NOT_CHANGED:
                break
        if code == AuthorityCode.OBTAINED:
            authority.feed(AuthorityInput.OBTAINED)
            _logger.info("control authority obtained")
            return
    finally:
        authority.feed(AuthorityInput.REFUSED)  # no news once it was obtained
    raise _refused(commander, code)


def _refused(commander: Commander, code: AuthorityCode) -> AuthorityRefused:
    """The refusal with everything that can be behind it, as far as profile and telemetry tell.

    One code stands for most obstacles (document 2.2.2.1, errata 24, 25).
    """
    state, firmware = commander.state, commander.requests.firmware
    switch = state.situation()["mode_switch"] or "unknown"
    what, obstacles = "", [(code.cause, code.remedy)]
    if code in (AuthorityCode.NOT_IN_F, AuthorityCode.NOT_CHANGED):
        obstacles = _obstacles(state, firmware)
    else:
        what = f": {code.meaning or code.name}"
    return AuthorityRefused(
        f"the aircraft did not give control authority{what} "
        f"(code 0x{code:04X}; mode switch {switch})",
        command=RequestAuthority.NAME,
        code=int(code),
        cause=", or ".join(cause for cause, _ in obstacles if cause),
        remedy="; ".join(remedy for _, remedy in obstacles if remedy),
    )


def _obstacles(state: AircraftState, firmware: FirmwareProfile) -> list[tuple[str, str]]:
    """What can keep the onboard device out, with what to do about it; what is seen comes first."""
    device = known(state, ControlDevice)
    app = ("the mobile app holds control", "let the mobile app release control")
    if device is not None and device.device is Device.APP:
        return [app]
    found = []
    battery = known(state, Battery)
    if battery is not None and battery.percent <= _EMPTY_PERCENT:
        found.append(
            (f"the battery is at {battery.percent} %, and it may not fly any more", "change it")
        )
    rc = known(state, RemoteControl)
    if rc is None:
        found.append(("the mode switch is not in F", "move the mode switch to F"))
    elif not rc.is_in_f:
        found.append(
            (f"the mode switch is in {rc.mode_switch.name}, not in F", "move the mode switch to F")
        )
    if firmware.needs_f_toggle and (rc is None or rc.is_in_f):
        found.append(
            (
                "F stands since power-on and was not chosen anew",
                "move the mode switch out of F and back",
            )
        )
    found += [
        ("API control is not enabled", "tick 'enable API control' in the PC assistant"),
        # Its item goes on as it was, in F: nothing in telemetry tells it.
        ("the remote control is off or out of reach", "switch it on, or go nearer"),
    ]
    if firmware.ioc_must_be_off and not firmware.authority_refusal_has_reason:
        found.append(("IOC is on", "turn IOC off in the DJI app"))
    if device is None:
        found.append(app)
    return found


async def release_authority(commander: Commander) -> bool:
    """Give authority back, within two seconds. What goes wrong is logged, not raised.

    The control block ends all the same: without setpoints the aircraft hovers.

    Returns:
        Whether the aircraft said that it has it back.
    """
    authority = commander.authority
    authority.feed(AuthorityInput.RELEASE)
    outcome = AuthorityInput.NOT_RELEASED
    try:
        async with asyncio.timeout(_RELEASE_DEADLINE_S):
            for attempt in range(_most(commander)):
                if attempt:
                    await asyncio.sleep(_PAUSE_S)
                is_last = attempt + 1 >= _needed(commander)
                code = await _request_release(commander, is_last=is_last)
                if code not in (AuthorityCode.NOT_CHANGED, AuthorityCode.RELEASING):
                    break
        if code == AuthorityCode.RELEASED:
            outcome = AuthorityInput.RELEASED
            _logger.info("control authority released")
        else:
            _logger.error("control authority may not be released: code 0x%04X", code)
    except NotActivated:
        outcome = AuthorityInput.RELEASED  # nobody has it before an activation
    except (M100Error, TimeoutError) as error:
        _logger.error("control authority may not be released: %s", error)
    finally:
        authority.feed(outcome)
    return outcome is AuthorityInput.RELEASED


async def explained_loss(commander: Commander, loss: AuthorityLost) -> AuthorityLost:
    """The loss with its reason, as far as the items that follow a notification tell it.

    The notification does not say who took control and overtakes the items that do (2.2.3.2).
    """
    if loss.reason is not LossReason.UNKNOWN:
        return loss
    authority = commander.authority
    clock = asyncio.get_running_loop().time
    deadline = clock() + _EXPLANATION_S
    while authority.reason is LossReason.UNKNOWN and clock() < deadline:  # noqa: ASYNC110 (15 times)
        await asyncio.sleep(_EXPLANATION_STEP_S)
    if authority.reason not in (LossReason.NONE, LossReason.UNKNOWN):
        return authority_lost(authority.reason)
    remote_control = commander.state.remote_control
    if remote_control is None or not remote_control.is_in_f:
        return loss
    return AuthorityLost(
        "authority passed away while the mode switch is still in F",
        reason=LossReason.UNKNOWN,
        cause="the mobile app took control, or the aircraft itself: remote controller lost, "
        "API control switched off",
        remedy="ask the pilot; the CTRL_DEVICE item would tell (0 Hz by default, PC assistant)",
    )


def is_unexplained(error: BaseException | None) -> bool:
    """Whether a call of the program met a loss before it could be explained.

    One that falls on the instant of the notification does, ahead of the block's cancellation.
    """
    return isinstance(error, AuthorityLost) and error.reason is LossReason.UNKNOWN


def authority_lost(reason: LossReason) -> AuthorityLost:
    """The error for a loss of authority with that reason."""
    meaning, remedy = {
        LossReason.MODE_SWITCH: (
            "the pilot moved the mode switch out of F",
            "the pilot has the aircraft; back in F, start a new control block",
        ),
        LossReason.APP: (
            "the mobile app took control",
            "let the app release control, then start a new control block",
        ),
    }.get(reason, ("the aircraft says that authority passed away", "ask the pilot what happened"))
    return AuthorityLost(meaning, reason=reason, remedy=remedy)
