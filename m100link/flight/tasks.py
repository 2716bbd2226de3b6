"""Take-off, landing and going home: begun by an ack, done when seen to be done."""

from __future__ import annotations

import asyncio
import logging
import os
from collections.abc import Callable, Coroutine, Iterator
from dataclasses import dataclass, field
from itertools import cycle, islice
from typing import TYPE_CHECKING, Any, NamedTuple

from m100link.errors import (
    AckTimeout,
    BadAck,
    CommandRefused,
    NotObserved,
    TaskFailed,
    TaskRefused,
    TelemetryStalled,
    UsageError,
)
from m100link.flight.guards import GuardKeeper, known
from m100link.protocol.codes import ArmCode, TaskResultCode, TaskStartCode
from m100link.protocol.commands.control import Arm, QueryTask, StartTask, Task
from m100link.protocol.commands.virtual_rc import CENTRE, TRAVEL, VirtualRcData, VirtualRcSettings
from m100link.protocol.records import FlightPhase, FlightStatus, Position

if TYPE_CHECKING:
    from m100link.flight.authority import Authority
    from m100link.flight.mission_state import MissionWatch
    from m100link.link import Link
    from m100link.link.requests import Requests
    from m100link.telemetry.state import AircraftState

__all__ = ["TaskProgress"]

_logger = logging.getLogger(__name__)

_POLL_S = 0.25
_SHOWN_POLL_S = 0.02
_SHOWN_WITHIN_S = 1.2  # more than one period of an item that is sent once a second
_STANDS_WITHIN_S = 2.5  # more than two of them: after three statuses of standing it counts
_QUERY_INTERVAL_S = 1.0
_TAKEN_OFF_HEIGHT_M = 1.0
_SETTLED_S = 1.0
_SETTLED_M_S = 0.15
_DOWN = (FlightPhase.LANDING, FlightPhase.FINISHING_LANDING)
_PHASES: dict[tuple[Task, TaskResultCode], tuple[FlightPhase | None, ...]] = {
    (Task.TAKE_OFF, TaskResultCode.EXECUTING): (FlightPhase.TAKING_OFF, FlightPhase.IN_AIR, None),
    (Task.LAND, TaskResultCode.EXECUTING): (*_DOWN, None),
    (Task.GO_HOME, TaskResultCode.EXECUTING): (FlightPhase.IN_AIR, *_DOWN, None),
    (Task.TAKE_OFF, TaskResultCode.SUCCEEDED): (FlightPhase.IN_AIR,),
    (Task.LAND, TaskResultCode.SUCCEEDED): (FlightPhase.STANDBY,),
    (Task.GO_HOME, TaskResultCode.SUCCEEDED): (FlightPhase.STANDBY,),
}
"""Flight phases that telemetry shows during a task and after it; None: it shows none."""

_MOST_UNANSWERED = 4  # orders of a task that are asked for; the aircraft knows its newest one

_UNANSWERED = 3  # queries in a row, after which what telemetry shows must do

TIMEOUTS_S = {Task.TAKE_OFF: 20.0, Task.LAND: 60.0, Task.GO_HOME: 300.0}
"""Seconds to wait for the end of each task unless the caller says otherwise."""


@dataclass(frozen=True, slots=True)
class Commander:
    """The parts of an aircraft that flying needs."""

    link: Link
    requests: Requests  # the road by which commands are sent
    authority: Authority  # who controls the aircraft
    state: AircraftState
    missions: MissionWatch  # which mission flies it, as the aircraft tells
    task_sequences: Iterator[int]  # a number for each task: see :func:`task_sequences`
    # Numbers of the orders of a task that brought no answer: one may be flown.
    unanswered: dict[Task, tuple[int, ...]] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class TaskProgress:
    """How far a take-off, landing or go-home is."""

    task: Task  #: Which one.
    elapsed: float  #: Seconds since it was accepted.
    phase: FlightPhase | None  #: Flight phase by telemetry, None when unknown.
    height_m: float | None  #: Height by telemetry, None when unknown.
    result: TaskResultCode | None  #: Newest answer to the result query, None before the first.


TaskListener = Callable[[TaskProgress], None]  # called about four times a second


def task_sequences() -> Iterator[int]:
    """A number for each take-off, landing or go-home, 0 to 255 and round again."""
    # From a random one: the program before may have used the first numbers, and a query by number
    # would be answered about its order.
    return islice(cycle(range(256)), os.urandom(1)[0], None)


def task_name(task: Task) -> str:
    """The task in words."""
    return task.name.lower().replace("_", " ")


def describe_situation(situation: dict[str, object]) -> str:
    """A situation in one line; what was never received is left out."""
    seen = {name: value for name, value in situation.items() if value is not None}
    return ", ".join(f"{name} {value}" for name, value in seen.items()) or "no telemetry"


def run_task(
    commander: Commander,
    task: Task,
    *,
    timeout: float | None = None,
    progress: TaskListener | None = None,
) -> Coroutine[Any, Any, None]:
    """Begin a task and wait until it is done; it raises as :meth:`Control.take_off`."""
    if timeout is None:
        timeout = TIMEOUTS_S[task] + commander.link.latency.slack_s
    return _Watch(commander, task, progress).run(timeout)


async def _begin(commander: Commander, task: Task) -> int:
    """Order a task; returns the number under which it is flown."""
    sequence = next(commander.task_sequences)
    numbers = (*commander.unanswered.pop(task, ()), sequence)[-_MOST_UNANSWERED:]
    try:
        code = await commander.requests.execute(
            StartTask(sequence, task), timeout=0.5, tries=3, refusal=TaskRefused
        )
    except AckTimeout:
        flown = await _flown_of(commander, task, numbers)
        if flown is None:
            commander.unanswered[task] = numbers
            raise
        return flown
    if code == TaskStartCode.STARTED:
        return sequence
    # It may be flown all the same: an earlier answer was lost, or the aircraft forgot what it had
    # answered and took the repeat for another order. So it is asked by number.
    flown = await _flown_of(commander, task, numbers)
    if flown is not None:
        return flown
    raise _refused(task_name(task), commander, code, f"0x{code:04X}")


async def _flown_of(commander: Commander, task: Task, numbers: tuple[int, ...]) -> int | None:
    """Which order of a task the aircraft flies or flew; None: none of them, or nobody knows."""
    for number in reversed(numbers):
        try:
            query = QueryTask(number)
            result = await commander.requests.execute(query, timeout=0.2, tries=2)
        except (AckTimeout, BadAck, CommandRefused) as error:
            _logger.debug("nobody knows whether %s is flown: %s", task_name(task), error)
            return None
        # Some firmware may answer about whatever it executes, and another program may have used the
        # number: what is shown has to fit.
        phases = _PHASES.get((task, result), ())
        if phases and await _phase_shown(commander.state) in phases:
            return number
    return None


async def _phase_shown(state: AircraftState) -> FlightPhase | None:
    """The phase of the next status from here on, since the last one may be old; None: none."""
    clock = asyncio.get_running_loop().time
    since = clock()
    while (status := known(state, FlightStatus, within=clock() - since)) is None:
        if clock() - since >= _SHOWN_WITHIN_S:
            return None
        await asyncio.sleep(_SHOWN_POLL_S)
    return status.phase


class _Watch:
    """Waits for the end of one task: by result query, and by what telemetry shows."""

    def __init__(self, commander: Commander, task: Task, progress: TaskListener | None) -> None:
        self._commander = commander
        self._state = commander.state
        self._task = task
        self._sequence = 0
        self._progress = progress
        self._result: TaskResultCode | None = None
        self._unanswered = 0
        self._observed_since: float | None = None

    async def run(self, timeout: float) -> None:
        self._sequence = await _begin(self._commander, self._task)
        clock = asyncio.get_running_loop().time
        began_at = clock()
        next_query_at = began_at + _QUERY_INTERVAL_S
        while True:
            if clock() >= next_query_at:
                next_query_at = clock() + _QUERY_INTERVAL_S
                await self._query()
            elapsed = clock() - began_at
            self._report(elapsed)
            if self._is_done():
                return
            if elapsed >= timeout:
                raise NotObserved(
                    f"{task_name(self._task)} was accepted {timeout:g} s ago and is not seen done "
                    f"({describe_situation(self._state.situation())})",
                    situation=self._state.situation(),
                    cause="flight status or position is not among the telemetry items, "
                    "or something holds the aircraft",
                    remedy="watch the aircraft; the task may still be running",
                )
            await asyncio.sleep(_POLL_S)

    async def _query(self) -> None:
        """Ask for the result. One answer that is lost does not change what the last one said."""
        query = QueryTask(self._sequence)
        try:
            self._result = await self._commander.requests.execute(query, timeout=0.2, tries=2)
        except (AckTimeout, CommandRefused) as error:
            _logger.debug("no result of the task: %s", error)
            self._unanswered += 1
            if isinstance(error, CommandRefused) or self._unanswered >= _UNANSWERED:
                self._result = TaskResultCode.NOT_CURRENT
        else:
            self._unanswered = 0
        if self._result == TaskResultCode.FAILED:
            await asyncio.sleep(_POLL_S)  # a loss of control, which is why, may arrive behind it

    def _is_done(self) -> bool:
        result = self._result
        if result == TaskResultCode.SUCCEEDED:
            # Not against telemetry: some firmware answers about another order.
            if known(self._state, FlightStatus) is None:
                return True
            status = self._state.believed_status
            return status is not None and status.phase in (None, *_PHASES[self._task, result])
        if result == TaskResultCode.FAILED:
            raise TaskFailed(
                f"{task_name(self._task)} began and failed",
                command=task_name(self._task),
                code=int(result),
                situation=self._state.situation(),
                cause=result.cause,
                remedy=result.remedy,
            )
        # Observation decides when the query brought nothing. While the aircraft says that it is
        # executing, it would ignore what comes next; before the first query nobody knows.
        return result is not None and self._is_observed() and result != TaskResultCode.EXECUTING

    def _is_observed(self) -> bool:
        """Whether telemetry shows the end, for a while: at 1 m a take-off is still climbing."""
        # By a status that is not old: one that stopped on the ground would end a landing at any
        # height, and the release behind it would leave the aircraft in the air.
        if self._task is not Task.TAKE_OFF:
            return is_on_ground(self._state) is True
        if not self._hovers():
            self._observed_since = None
            return False
        now = asyncio.get_running_loop().time()
        if self._observed_since is None:
            self._observed_since = now
        return now - self._observed_since >= _SETTLED_S

    def _hovers(self) -> bool:
        status = known(self._state, FlightStatus)
        if status is None or status.status != FlightPhase.IN_AIR:
            return False
        position, velocity = known(self._state, Position), self._state.velocity
        return (
            position is not None
            and position.height_m >= _TAKEN_OFF_HEIGHT_M
            and (velocity is None or abs(velocity.up_m_s) < _SETTLED_M_S)
        )

    def _report(self, elapsed: float) -> None:
        if self._progress is None:
            return
        status, position = self._state.get(FlightStatus), self._state.get(Position)
        phase = status.phase if status else None
        height = position.height_m if position else None
        self._progress(TaskProgress(self._task, elapsed, phase, height, self._result))


# -- the sticks of a virtual remote control, and when its settings may be sent ---------------------


# Between two settings; faster than every 2 s they lock the aircraft (DJI's header). The rest is
# for frames that are late: a second one may catch up with the first.
SETTINGS_INTERVAL_S = 2.2
_ROUNDING_S = 1e-3  # timers are that exact
# Always P: in A centred sticks drift with the wind, and DJI does not recommend it.
_GEAR_DOWN, _MODE_P = 1324, 1552
_CORNER = 0.9


class Deflections(NamedTuple):
    """Deflections, -1 (left or down) to 1 (right or up)."""

    roll: float = 0.0
    pitch: float = 0.0
    throttle: float = 0.0
    yaw: float = 0.0

    @property
    def are_in_corner(self) -> bool:
        """Both sticks down and to one side each: that starts and stops the motors."""
        down = self.pitch < -_CORNER and self.throttle < -_CORNER
        return down and abs(self.roll) > _CORNER and abs(self.yaw) > _CORNER

    def encoded(self) -> VirtualRcData:
        """The channels."""
        sticks = (round(CENTRE + TRAVEL * deflection) for deflection in self)
        return VirtualRcData((*sticks, _GEAR_DOWN, CENTRE, _MODE_P, *[CENTRE] * 9))


CENTRED = Deflections()
GESTURE = Deflections(roll=-1.0, pitch=-1.0, throttle=-1.0, yaw=1.0)


class SettingsPace:
    """Lets the settings of one aircraft out, and never two within two seconds."""

    def __init__(self, clock: Callable[[], float]) -> None:
        self._clock = clock
        # The program before may have sent some just before this one connected.
        self.free_at = clock() + SETTINGS_INTERVAL_S

    async def wait(self) -> None:
        """Wait until the next may be sent."""
        await asyncio.sleep(max(0.0, self.free_at - self._clock()))

    def send(self, commander: Commander, command: VirtualRcSettings) -> bool:
        """Send it, or ``UsageError``: it is too soon. False when the line does not drain."""
        now = self._clock()
        if now < self.free_at - _ROUNDING_S:
            raise UsageError(
                f"virtual RC settings are not sent: it is {self.free_at - now:.1f} s too soon",
                cause="faster than every 2 s they lock the aircraft (DJI's header warns of it)",
                remedy="await wait() first",
            )
        if not commander.requests.push(command):
            return False
        self.free_at = now + SETTINGS_INTERVAL_S
        return True


# -- starting and stopping the motors on the ground, without taking off (firmware 3.1) -------------


def is_on_ground(state: AircraftState) -> bool | None:
    """Whether it stands, as several flight statuses tell; None when nobody knows."""
    status = state.believed_status if known(state, FlightStatus) is not None else None
    return None if status is None else status.status == FlightPhase.STANDBY


async def stands(state: AircraftState) -> bool | None:
    """The same, after statuses that say so could become several; None, too: it contradicts them."""
    clock = asyncio.get_running_loop().time
    until = clock() + _STANDS_WITHIN_S
    # No event tells of it, and a status that never becomes believed is an answer, too.
    while state.flight_status != state.believed_status and clock() < until:  # noqa: ASYNC110
        await asyncio.sleep(_SHOWN_POLL_S)
    return is_on_ground(state) if state.flight_status == state.believed_status else None


async def switch_motors(commander: Commander, *, on: bool) -> None:
    """Start or stop them; that they run, or stand, already is no error.

    Raises ``TaskRefused``: with the code. Raises ``CommandNotSupported, NotActivated, LevelTooLow,
    KeyRejected, AckTimeout, LinkError``: see each class.
    """
    code = await commander.requests.execute(Arm(on), timeout=0.2, tries=3, refusal=TaskRefused)
    if code not in (ArmCode.DONE, ArmCode.ALREADY):
        raise _refused("arm" if on else "disarm", commander, code, str(int(code)))


def _refused(
    what: str, commander: Commander, code: ArmCode | TaskStartCode, number: str, seen: str = ""
) -> TaskRefused:
    situation = commander.state.situation()
    return TaskRefused(
        f"{what} was refused: {seen or code.meaning} (code {number}; "
        f"{describe_situation(situation)})",
        command=what,
        code=int(code),
        situation=situation,
        cause=code.cause,
        remedy=code.remedy,
    )


class Motors:
    """The motors of the aircraft of one control block."""

    def __init__(
        self,
        commander: Commander,
        guards: GuardKeeper,  # asked before the motors start, as before a take-off
        # Called before either; raises when something else is flying, and ends setpoints.
        make_way: Callable[[str], None],
        # Told when they may run because of this block, and when they do not.
        on_armed: Callable[[bool], None],
    ) -> None:
        self._commander = commander
        self._guards = guards
        self._make_way = make_way
        self._on_armed = on_armed

    async def arm(self) -> None:
        """Start the motors on the ground; they idle, and the aircraft stays where it is.

        Only for programs that take off by setpoints of their own: a setpoint with thrust, height or
        a climb rate lifts it from there. ``take_off()`` starts the motors itself, and **fails while
        they run** (seen on an M100). With nothing commanded they stop by themselves after about
        20 s; when the block ends on the ground they are stopped. Firmware 3.1.

        Raises:
            NoAuthority: Authority is not held.
            GuardRefused: As for a take-off.
            TaskRefused: With the code; or another task, or a closed loop, is under way.
            CommandNotSupported: The firmware is older; nothing was sent.
            AckTimeout: Nobody knows whether they run.
        """
        await self._guards.admit_take_off()
        self._make_way("arm")
        self._on_armed(True)  # whatever becomes of the ack
        await switch_motors(self._commander, on=True)

    async def disarm(self) -> None:
        """Stop the motors on the ground; landing stops them by itself.

        **In the air nothing is sent**: the aircraft would refuse it, and this does not
        rely on that.

        Raises:
            NoAuthority: Authority is not held.
            TaskRefused: It is in the air (code 3), or another task is under way.
            TelemetryStalled: Nobody knows whether it is on the ground; nothing was sent.
            CommandNotSupported: The firmware is older; nothing was sent.
            AckTimeout: Nobody knows whether they stand.
            NotObserved: It took the order, and telemetry shows that it does not stand.
        """
        self._make_way("disarm")
        on_ground = await stands(self._commander.state)
        if on_ground is None:
            raise TelemetryStalled(
                "disarm was not sent: nobody knows whether the aircraft is on the ground",
                cause="the flight status is not sent, or old, or velocity or height contradicts it",
                remedy="set_telemetry_rates(flight_status=10), or in the PC assistant",
            )
        if not on_ground:
            code, seen = ArmCode.IN_THE_AIR, "the aircraft is in the air"
            raise _refused("disarm", self._commander, code, str(int(code)), seen)
        await switch_motors(self._commander, on=False)
        phase = await _phase_shown(self._commander.state)
        if phase not in (None, FlightPhase.STANDBY):
            raise NotObserved(
                f"the aircraft took the order to stop its motors, and tells of {phase.name}",
                situation=self._commander.state.situation(),
                cause="it answered about another order, or took off meanwhile",
                remedy="look at the aircraft; the motors may run",
            )
        self._on_armed(False)
