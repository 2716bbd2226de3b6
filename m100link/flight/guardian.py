"""The program's side of the guardian: a process that ends the flight when this program cannot.

The program keeps a plan of prepared frames in a page of memory that both share, and renews a token
in it ten times a second by a timer of its event loop. The guardian itself is
:mod:`m100link.flight.guardian_process`, which knows nothing of this package.
"""

from __future__ import annotations

import asyncio
import logging
import mmap
import os
import socket
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import suppress
from itertools import count, islice
from typing import TYPE_CHECKING, Any, Generic, NamedTuple, TypeVar

from m100link.errors import GuardianFailed, GuardianTookOver, UsageError
from m100link.flight import guardian_process as page
from m100link.flight.mission_state import MissionKind
from m100link.flight.missions.events import ORDERS
from m100link.flight.tasks import CENTRED, SETTINGS_INTERVAL_S
from m100link.protocol.command import Request
from m100link.protocol.commands.control import RequestAuthority, StartTask, Task
from m100link.protocol.commands.virtual_rc import VirtualRcSettings
from m100link.protocol.setpoint import Setpoint

if TYPE_CHECKING:
    from m100link.flight.tasks import Commander
    from m100link.link import Link


_logger = logging.getLogger(__name__)


# -- the frames that the guardian of a flight sends: the stop path without acks --------------------


_SESSION = 31  # the program takes the lowest that is free: this one only with thirty under way
# 0.3 s at 50 Hz, as the stop path sends it: NEUTRAL_TIME of flight/setpoints.py.
_NEUTRALS, _NEUTRAL_GAP_MS = 15, 20
_REPEATS, _REPEAT_GAP_MS = 2, 20  # of the same bytes, which are carried out once
_LANDINGS, _LANDING_GAP_MS = 8, 1500  # a task that is under way refuses it; a take-off takes 6 s
_LANDING_MS = 60_000  # as long as the stop path waits for one
_RELEASES = 3  # firmware that wants two may have answered one already
_RELEASE_GAP_MS = 50
_STICKS_GAP_MS = 100


class GuardianStep(NamedTuple):
    """One frame."""

    frame: bytes  # its bytes
    gap_ms: int = 0  # pause before it, and between its repetitions
    times: int = 1


class GuardianPlan(NamedTuple):
    """The frames for both cases."""

    stalled: tuple[
        GuardianStep, ...
    ] = ()  # for a program that is blocked for longer than a setpoint lives
    last: tuple[GuardianStep, ...] = ()  # for a program that is gone, or is blocked for too long


class Wanted(NamedTuple):
    """The actions that the aircraft needs if the program ends now."""

    neutral: Setpoint | None = None  # the neutral of the present setpoint, None in silence
    mission: MissionKind | None = None  # the mission to stop
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

    def steps(self, request: Request[Any], gap_ms: int) -> Iterator[GuardianStep]:
        """One order: a pause, then the same bytes a few times."""
        sequence = next(self._sequence) & 0xFFFF
        frame = self._requests.prepared(request, session=_SESSION, sequence=sequence)
        yield GuardianStep(frame, gap_ms)
        yield GuardianStep(frame, _REPEAT_GAP_MS, _REPEATS - 1)


def control_plan(commander: Commander, wanted: Wanted, first_sequence: int) -> GuardianPlan:
    """The plan for a control block: mission stop, neutral, landing, release."""
    orders = _Orders(commander, first_sequence)
    neutrals: tuple[GuardianStep, ...] = ()
    if wanted.neutral is not None:
        frame = commander.requests.prepared(wanted.neutral)
        neutrals = (GuardianStep(frame), GuardianStep(frame, _NEUTRAL_GAP_MS, _NEUTRALS - 1))
    last: list[GuardianStep] = []
    if wanted.mission is not None:
        # The guardian reads no acks: orders that the aircraft may refuse go out again, each under a
        # number of its own, because a repeated number is answered from memory (document 1.4).
        for _ in range(2):
            last += orders.steps(ORDERS[wanted.mission].stop, _REPEAT_GAP_MS)
    last += neutrals
    release_gap = _REPEAT_GAP_MS
    if wanted.land:
        numbers = islice(commander.task_sequences, _LANDINGS)
        for index, number in enumerate(numbers):
            gap = _LANDING_GAP_MS if index else _REPEAT_GAP_MS
            last += orders.steps(StartTask(number, Task.LAND), gap)
        # As long as the stop path waits: the release would end the landing in the air.
        release_gap = _LANDING_MS - (_LANDINGS - 1) * _LANDING_GAP_MS
    if wanted.release:
        for _ in range(_RELEASES):
            last += orders.steps(RequestAuthority(obtain=False), release_gap)
            release_gap = _RELEASE_GAP_MS
    return GuardianPlan(neutrals, tuple(last))


def virtual_rc_plan(commander: Commander, *, falls_back: bool) -> GuardianPlan:
    """The plan for a virtual remote control that is on: centred sticks, then off."""
    centred = commander.requests.prepared(CENTRED.encoded())
    off = commander.requests.prepared(VirtualRcSettings(False, falls_back))
    # Off once, and not before settings may come again, whenever the last ones came: two within 2 s
    # lock the aircraft (DJI's header).
    times = round(SETTINGS_INTERVAL_S * 1000) // _STICKS_GAP_MS
    last = (
        GuardianStep(centred),
        GuardianStep(centred, _STICKS_GAP_MS, times),
        GuardianStep(off, _STICKS_GAP_MS),
    )
    return GuardianPlan((GuardianStep(centred), GuardianStep(centred, _STICKS_GAP_MS, 3)), last)


# -- guardian --------------------------------------------------------------------------------------

PATIENCE_S = 2.0  # seconds that the event loop may stand still before the guardian ends the flight

_SHORTEST_S, _LONGEST_S = 0.5, 60.0
_RENEWAL_S = 0.1
_START_S = 15.0  # it takes 0.02 s, and 10 s on a machine that gives it a fiftieth of a core
_ACTS_WITHIN_S = 1.0  # after a program came back too late, by when the guardian has to show itself
_LEAVES_WITHIN_S = 2.0
_ENDS_WITHIN_S = 120.0  # a landing, on a line that is full now and then

_HAS_ALL_IT_NEEDS = sys.platform == "linux" and hasattr(os, "memfd_create")

W = TypeVar("W")


def patience_of(guardian: bool | float) -> float | None:
    """Return the seconds that ``control(guardian=…)`` means, 0.5 to 60; None: no guardian."""
    if guardian is True or guardian is False:
        return PATIENCE_S if guardian else None
    if not _SHORTEST_S <= guardian <= _LONGEST_S:
        raise UsageError(
            f"guardian={guardian!r} is not {_SHORTEST_S:g} to {_LONGEST_S:g} s",
            remedy="True, False, or how long the event loop may stand still",
        )
    return float(guardian)


class Guardian(Generic[W]):
    """The program's side of one guardian: from before authority is asked for to the end of a block.

    Nothing happens on a line without a descriptor (in memory, a replay), nor outside Linux.
    """

    def __init__(
        self,
        link: Link,
        # Returns the actions needed if the program ends now; called ten times a second.
        wanted: Callable[[], W],
        # Makes the frames for these actions; called when they changed.
        plan: Callable[[W], GuardianPlan],
        # Called once when the guardian ended the flight, with the error that says so.
        on_taken_over: Callable[[GuardianTookOver], None],
        patience_s: float | None,  # how long the event loop may be blocked, s; None: no guardian
    ) -> None:
        self._link = link
        self._loop = link.loop
        self._wanted = wanted
        self._plan = plan
        self._on_taken_over = on_taken_over
        self._patience_s = patience_s or 0.0
        self._is_asked_for = patience_s is not None
        self._pid = os.getpid()  # the child of a fork has no part in it
        self._process: subprocess.Popen[bytes] | None = None
        self._socket: socket.socket | None = None
        self._map: mmap.mmap | None = None
        self._words: memoryview | None = None  # None before it watches, and when it is gone
        self._generation = 0
        self._published: object = self  # what the plan in the page is for; at first nothing
        self._renewed = 0
        self._timers: tuple[asyncio.TimerHandle, ...] = ()
        self._overdue_since: float | None = None
        self._is_over = False  # the program has dismissed it
        self._has_taken_over = False
        self._gone = asyncio.Event()

    @property
    def is_watching(self) -> bool:
        """Whether the guardian would end the flight if the program could not."""
        return self._words is not None

    # -- start -----------------------------------------------------------------------------------

    async def start(self) -> None:
        """Start it, or raise ``GuardianFailed``; wait until it watches, with an empty plan."""
        descriptor = self._link.descriptor
        if not self._is_asked_for or descriptor is None:
            return
        if not _HAS_ALL_IT_NEEDS:
            _logger.warning("no guardian watches this flight: it needs Linux")
            return
        try:
            self._spawn(descriptor)
            assert self._socket is not None
            async with asyncio.timeout(_START_S):
                said = await self._loop.sock_recv(self._socket, 1)
            if said != page.READY:
                raise OSError("it ended at once")
        except (OSError, ValueError, subprocess.SubprocessError) as error:
            self._tear_down()
            raise GuardianFailed(
                f"the guardian of this flight did not start: {str(error) or 'not ready in time'}"
            ) from error
        except BaseException:
            self._tear_down()
            raise
        assert self._map is not None
        self._words = memoryview(self._map).cast("I")
        self._loop.add_reader(self._socket, self._on_word)
        # From here on each write asks: only one of the two processes may write at a time.
        self._link.gate = self
        self.update()
        self._renew()

    def _spawn(self, descriptor: int) -> None:
        # In a frozen program sys.executable is the program: it would start a second time, and fly.
        if not sys.executable or getattr(sys, "frozen", False):
            raise OSError("nobody knows where Python is (sys.executable)")
        shared = os.memfd_create("m100link guardian")
        try:
            os.ftruncate(shared, page.PAGE_SIZE)
            self._map = mmap.mmap(shared, page.PAGE_SIZE)
            self._socket, other = socket.socketpair()
            with other:
                self._socket.setblocking(False)
                passed = descriptor, other.fileno(), shared
                if min(passed) <= 2:  # in the guardian these are /dev/null
                    raise OSError(
                        "standard input, output or error was closed, and the line or the guardian "
                        "has its number: open /dev/null in its place"
                    )
                # -I and -S: neither variables nor packages of the program can break it. A session
                # of its own: Ctrl-C and a closed terminal are for the program alone.
                self._process = subprocess.Popen(
                    (sys.executable, "-I", "-S", page.__file__, *map(str, passed), str(self._pid)),
                    stdin=subprocess.DEVNULL,
                    stdout=subprocess.DEVNULL,
                    stderr=subprocess.DEVNULL,
                    pass_fds=passed,
                    start_new_session=True,
                )
        finally:
            os.close(shared)

    # -- while the program flies -----------------------------------------------------------------

    def update(self) -> None:
        """Publish a new plan if the needed actions have changed."""
        if self._words is None or self._map is None or os.getpid() != self._pid:
            return
        wanted = self._wanted()
        if wanted == self._published:
            return
        self._write(self._plan(wanted))
        self._published = wanted

    def _write(self, plan: GuardianPlan) -> None:
        assert self._map is not None
        steps = [
            (end, step.gap_ms, step.times, step.frame)
            for end, case in enumerate(plan)
            for step in case
            if step.times
        ]
        self._generation += 1
        half = page.sealed(self._generation, int(self._patience_s * 1000), steps)
        # In turns: a program that is killed while it writes leaves the other half, which is whole.
        at = page.HALVES_AT + self._generation % 2 * page.HALF_SIZE
        self._map[at : at + len(half)] = half
        self._say(page.WAKE)

    def _say(self, word: bytes) -> None:
        if self._socket is not None:
            with suppress(OSError):  # full of the same word, or gone: then on_word hears of it
                self._socket.send(word)

    def _renew(self) -> None:
        """The event loop lives."""
        # Two timers: a KeyboardInterrupt between two lines of the loop loses the one that is due,
        # and the flight would end for want of a token.
        for timer in self._timers:
            timer.cancel()
        self._timers = tuple(self._loop.call_later(_RENEWAL_S, self._renew) for _ in range(2))
        words = self._words
        if words is None or os.getpid() != self._pid:
            return
        if words[page.HOLD] == page.TAKEN:
            self._tell()
            return
        now = page.milliseconds()
        # Too late: no new token calls the guardian back, and the flight ends for good.
        if self._overdue_since is not None or self._is_late(now):
            self._wait_for_it()
            return
        words[page.TOKEN] = self._renewed = now
        self.update()

    def _is_late(self, now: int) -> bool:
        late_by = (now - self._renewed) & 0xFFFFFFFF
        return self._renewed > 0 and late_by >= self._patience_s * 1000

    def _wait_for_it(self) -> None:
        """The program stood still for too long, and was faster than the guardian."""
        now = self._loop.time()
        if self._overdue_since is None:
            self._overdue_since = now
            self._say(page.WAKE)
        elif now - self._overdue_since > _ACTS_WITHIN_S and self._process is not None:
            _logger.warning("the guardian stands still: it is ended")
            self._process.kill()

    def _tell(self) -> None:
        if self._has_taken_over:
            return
        self._has_taken_over = True
        self._on_taken_over(
            GuardianTookOver(
                f"the guardian ended this flight: the event loop stood still for more than "
                f"{self._patience_s:g} s"
            )
        )

    def _on_word(self) -> None:
        """The guardian says nothing but that it is gone."""
        assert self._socket is not None
        try:
            if self._socket.recv(64):
                return
        except BlockingIOError:
            return
        except OSError as error:
            _logger.debug("the guardian's socket: %s", error)
        words = self._words
        if words is not None and words[page.HOLD] == page.TAKEN:
            self._tell()
        is_expected = self._is_over or self._has_taken_over
        self._tear_down()
        if not is_expected:
            _logger.warning(
                "the guardian of this flight is gone: the flight goes on without one, and nobody "
                "ends it if this program cannot"
            )

    # -- the gate in front of the line -----------------------------------------------------------

    def opens(self, size: int) -> bool:
        """Whether the program may write so many bytes now; they count as missing until written."""
        words = self._words
        if words is None:
            return True
        if words[page.HOLD] or self._is_late(page.milliseconds()):
            return False
        # Before the write: killed in the middle of it, the guardian fills up the frame cut off.
        words[page.UNSENT] += size
        return True

    def wrote(self, waiting: int) -> None:
        """Note how many bytes the system has not taken yet."""
        if self._words is not None:
            self._words[page.UNSENT] = waiting

    # -- end -------------------------------------------------------------------------------------

    async def end(self) -> None:
        """Dismiss the guardian; where it has taken over, wait until it has ended the flight.

        You may call it again, and when the guardian never started.
        """
        if self._process is None or os.getpid() != self._pid:
            return
        if self._words is not None and self._words[page.HOLD] == page.TAKEN:
            self._tell()
        if not self._has_taken_over and self._words is not None:
            self._is_over = True
            # An empty plan too: a guardian that misses the word then has nothing to send.
            self._write(GuardianPlan())
            self._say(page.OVER)
        try:
            async with asyncio.timeout(
                _ENDS_WITHIN_S if self._has_taken_over else _LEAVES_WITHIN_S
            ):
                await self._gone.wait()
        except TimeoutError:
            _logger.warning("the guardian did not end in time: it is killed")
            self._tear_down()

    def _tear_down(self) -> None:
        """Let go of everything; kill a process that still runs."""
        for timer in self._timers:
            timer.cancel()
        self._timers = ()
        if self._link.gate is self:
            self._link.gate = None
        words, self._words = self._words, None
        if words is not None:
            words.release()
        if self._socket is not None:
            if words is not None:
                self._loop.remove_reader(self._socket)
            self._socket.close()
            self._socket = None
        if self._map is not None:
            self._map.close()
            self._map = None
        if self._process is not None:
            self._process.kill()  # nothing happens where it has ended
            with suppress(subprocess.TimeoutExpired):
                self._process.wait(timeout=1.0)
            self._process = None
        self._gone.set()
