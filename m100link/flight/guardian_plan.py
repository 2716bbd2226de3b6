"""The frames that the guardian of a flight sends: the stop path without acks."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import count, islice
from typing import TYPE_CHECKING, Any, NamedTuple

from m100link.flight.mission_state import MissionKind
from m100link.flight.missions.orders import ORDERS
from m100link.flight.sticks import CENTRED, SETTINGS_INTERVAL_S
from m100link.protocol.command import Request
from m100link.protocol.commands.control import RequestAuthority, StartTask, Task
from m100link.protocol.commands.virtual_rc import VirtualRcSettings
from m100link.protocol.setpoint import Setpoint

if TYPE_CHECKING:
    from m100link.flight.tasks import Commander

__all__ = ["NOTHING", "GuardianPlan", "Step", "Wanted", "control_plan", "virtual_rc_plan"]

_SESSION = 31  # the program takes the lowest that is free: this one only with thirty under way
_NEUTRALS, _NEUTRAL_GAP_MS = 15, 20
_REPEATS, _REPEAT_GAP_MS = 2, 20  # of the same bytes, which are carried out once
_LANDINGS, _LANDING_GAP_MS = 8, 1500  # a task that is under way refuses it; a take-off takes 6 s
_LANDING_MS = 60_000  # as long as the stop path waits for one
_RELEASES = 3  # firmware that wants two may have answered one already
_RELEASE_GAP_MS = 50
_STICKS_GAP_MS = 100


class Step(NamedTuple):
    """One frame.

    Attributes:
        frame: Its bytes.
        gap_ms: Pause before it, and between its repetitions.
        times: How often.
    """

    frame: bytes
    gap_ms: int = 0
    times: int = 1


class GuardianPlan(NamedTuple):
    """The frames for both cases.

    Attributes:
        stalled: For a program that is blocked for longer than a setpoint lives.
        last: For a program that is gone, or is blocked for too long.
    """

    stalled: tuple[Step, ...] = ()
    last: tuple[Step, ...] = ()


class Wanted(NamedTuple):
    """The actions that the aircraft needs if the program ends now.

    Attributes:
        neutral: The neutral of what is being sent, None in silence.
        mission: The mission to stop.
        land: Land.
        release: Give authority back.
    """

    neutral: Setpoint | None = None
    mission: MissionKind | None = None
    land: bool = False
    release: bool = False


NOTHING = Wanted()


class _Orders:
    """Frames of requests, on a session that the program hardly uses, each with its own number.

    An aircraft remembers the last number of a session, and answers it again without carrying it
    out: a repetition may follow at once, and no other order may have the same number.
    """

    def __init__(self, commander: Commander, first_sequence: int) -> None:
        self._requests = commander.requests
        self._sequence = count(first_sequence)

    def frame(self, request: Request[Any]) -> bytes:
        sequence = next(self._sequence) & 0xFFFF
        return self._requests.prepared(request, session=_SESSION, sequence=sequence)

    def steps(self, request: Request[Any], gap_ms: int) -> Iterator[Step]:
        """One order: a pause, then the same bytes a few times."""
        frame = self.frame(request)
        yield Step(frame, gap_ms)
        yield Step(frame, _REPEAT_GAP_MS, _REPEATS - 1)


def control_plan(commander: Commander, wanted: Wanted, first_sequence: int) -> GuardianPlan:
    """The plan for a control block: mission stop, neutral, landing, release.

    The guardian reads no acks. So the plan repeats orders that the aircraft may refuse, and gives a
    landing as much time as the stop path before the release, which would end it in the air.

    Args:
        commander: The aircraft.
        wanted: What is to be done.
        first_sequence: First number of the orders.
    """
    orders = _Orders(commander, first_sequence)
    neutrals: tuple[Step, ...] = ()
    if wanted.neutral is not None:
        frame = commander.requests.prepared(wanted.neutral)
        neutrals = (Step(frame), Step(frame, _NEUTRAL_GAP_MS, _NEUTRALS - 1))
    last: list[Step] = []
    if wanted.mission is not None:
        for _ in range(2):
            last += orders.steps(ORDERS[wanted.mission].stop, _REPEAT_GAP_MS)
    last += neutrals
    release_gap = _REPEAT_GAP_MS
    if wanted.land:
        numbers = islice(commander.task_sequences, _LANDINGS)
        for index, number in enumerate(numbers):
            gap = _LANDING_GAP_MS if index else _REPEAT_GAP_MS
            last += orders.steps(StartTask(number, Task.LAND), gap)
        release_gap = _LANDING_MS - (_LANDINGS - 1) * _LANDING_GAP_MS
    if wanted.release:
        for _ in range(_RELEASES):
            last += orders.steps(RequestAuthority(obtain=False), release_gap)
            release_gap = _RELEASE_GAP_MS
    return GuardianPlan(neutrals, tuple(last))


def virtual_rc_plan(commander: Commander, *, falls_back: bool) -> GuardianPlan:
    """The plan for a virtual remote control that is on: centred sticks, then off.

    It is switched off once, and not before settings may come again, whenever the last ones came.
    """
    centred = commander.requests.prepared(CENTRED.encoded())
    off = commander.requests.prepared(VirtualRcSettings(False, falls_back))
    times = round(SETTINGS_INTERVAL_S * 1000) // _STICKS_GAP_MS
    last = (Step(centred), Step(centred, _STICKS_GAP_MS, times), Step(off, _STICKS_GAP_MS))
    return GuardianPlan((Step(centred), Step(centred, _STICKS_GAP_MS, 3)), last)
