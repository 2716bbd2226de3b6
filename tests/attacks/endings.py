"""Endings of a flight beside what the system has lost: ``python -m tests.attacks.endings``.

Each draw is a flight, how it ends, and what is lost by then: file descriptors, the disk, the log,
stderr. Most are flown in this process on virtual time, every hundredth by a process of its own in
real time, all against the aircraft that shares no line with the library. It is judged by what that
one received: the neutral last, a landing where one was asked for, the release. The first draw that
is not so ends the program and prints its seed.

    python -m tests.attacks.endings --draws 10000 --seed 1
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import logging
import math
import os
import signal
import subprocess
import sys
import threading
import time
from collections import Counter
from collections.abc import Callable
from itertools import product
from pathlib import Path
from random import Random
from types import FrameType
from typing import Literal, NamedTuple, cast

from m100link import Aircraft, Control, M100Error
from m100link.flight import reserves as log_thread
from m100link.flight.cancellation import NUMBERS
from m100link.sim import VirtualClockEventLoop
from tests.flight.ending_programs import ASKED_FOR, LOG, default_signals, refuse_tasks
from tests.flight.foreign_aircraft import (
    ONBOARD,
    RC,
    STANDBY,
    ForeignAircraft,
    ForeignInMemory,
    foreign_aircraft,
)
from tests.flight.missions.foreign import foreign, plan
from tests.rig import NORTH
from tests.waiting import PATIENCE, blocking_until

__all__ = ["FORKS", "PROCESSES", "Draw", "draw_in_memory", "end_a_process", "fork_a_process"]

ROOT = Path(__file__).parents[2]
LAND = 6
STOP_MISSION = 0x12, b"\1"
QUESTIONS = 0x14, 0x15, 0x17, 0x26  # about a mission; a stop that nobody answered leads to one


class Draw(NamedTuple):
    """A flight, how it ends, and what the system has lost by then."""

    flight: str
    ending: str
    loss: str


FLIGHTS = ("hover", "land", "mission", "sync")
LOSSES = ("nothing", "sealed", "table", "memory", "log", "stderr")
ENDINGS = ("raise", "exit", "leave", "pilot", "stall", *(number.name for number in NUMBERS))

PROCESSES = (
    *(Draw(*one) for one in product(FLIGHTS, ENDINGS, LOSSES)),
    *(Draw(flight, "timeout", loss) for flight in ("hover", "mission") for loss in LOSSES),
    *(Draw("hover", "land", loss) for loss in LOSSES),
    *(Draw(*one) for one in product(("hover", "land", "mission"), ("fall",), LOSSES)),
    *(Draw(flight, "SIGTERM", "tasks") for flight in ("hover", "land", "mission")),
)
"""Every flight that a process of its own can end."""

FORKS = tuple(
    Draw(flight, f"fork {way}", "nothing")
    for flight in ("hover", "land", "mission")
    for way in ("exit", "raise", "return", "_exit", "SIGTERM", "stay")
)
"""Every flight beside which a child is born and ends, or stays, and the parent flies on."""


_SILENT = ("leave", "exit", "land", "fall", "SIGTERM", "SIGHUP", "SIGQUIT")
"""Endings of which Python says nothing by itself."""


class Program:
    """The process that flies, and the aircraft that it flies."""

    def __init__(self, draw: Draw, there: ForeignAircraft) -> None:
        self.draw, self.there = draw, there
        self.said = b""
        command = (sys.executable, "-m", "tests.flight.ending_programs", there.name, *draw)
        environment = dict(os.environ)
        if draw.loss == "memory":  # which counting lines takes, too, and raises where there is none
            environment = {k: v for k, v in environment.items() if not k.startswith("COVERAGE")}
        self.process = subprocess.Popen(
            command,
            cwd=ROOT,
            env=environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            process_group=0,
        )

    def wait_flying(self) -> None:
        """Until it flies, and has lost what it is to lose."""
        assert self.process.stdout is not None
        self.said = self.process.stdout.readline()
        assert self.said == b"flying\n", f"{self.draw}: {self.said!r}"

    def wait_ended(self) -> None:
        """Until it is gone, and the aircraft has read its last bytes."""
        if self.draw.loss == "stderr" and self.draw.ending not in _SILENT:
            # What Python says of an error goes to stderr, and waits there for ever.
            blocking_until(lambda: self.there.releases > 0 and self.there.device == RC)
            time.sleep(1.0 if self.draw.flight == "land" else 0.3)
            os.killpg(self.process.pid, signal.SIGKILL)
        self.process.wait(timeout=PATIENCE)
        self.kill()  # a child of it may hold its stdout open
        self.said += self.process.communicate(timeout=PATIENCE)[0]
        if self.draw.flight == "land" and self.draw.ending != "pilot":
            blocking_until(lambda: self.there.status == STANDBY, within=5.0)
        time.sleep(0.1)

    def kill(self) -> None:
        """End it and the children that it left behind."""
        with contextlib.suppress(ProcessLookupError):  # none is left
            os.killpg(self.process.pid, signal.SIGKILL)
        self.process.wait()

    def troubles(self) -> list[str]:
        """What is not as it should be; empty when all is in order."""
        there, flight, ending, _ = self.there, *self.draw
        moves = [move.values for move in there.movements]
        wrong = {
            "the aircraft is not released": there.device != RC or not there.releases,
            f"it asked for {self.said!r}": self.said != b"flying\n",
        }
        if ending == "pilot":
            return [name for name, is_so in wrong.items() if is_so]
        if flight == "mission":
            orders = [one for one in there.missions.orders if one.number not in QUESTIONS]
            wrong["the mission flies on"] = bool(there.missions.flying)
            wrong["no stop was its last order"] = orders[-1][:2] != STOP_MISSION
        else:
            wrong["nothing was flown"] = (2.0, 0.0, 0.0, 0.0) not in moves
            is_still = moves[-1:] == [(0.0, 0.0, 0.0, 0.0)]
            wrong[f"the last movement is {moves[-1:]}"] = not is_still and ending != "land"
        if flight == "land" or ending == "land":
            wrong[f"it is not on the ground: {there.tasks}"] = there.status != STANDBY
        return [name for name, is_so in wrong.items() if is_so]


def _firmware(draw: Draw) -> str:
    return "3.1" if draw.flight == "mission" else "1.0"


def end_a_process(draw: Draw) -> list[str]:
    """Fly it, end it, and return what is not as it should be."""
    with foreign_aircraft(_firmware(draw)) as there:
        program = Program(draw, there)
        try:
            program.wait_flying()
            if draw.ending == "pilot":
                there.leave_f()
            elif draw.ending == "stall":
                there.is_mute = True
            program.wait_ended()
            return program.troubles()
        except subprocess.TimeoutExpired:
            return ["the process does not end", *program.troubles()]
        finally:
            program.kill()


def fork_a_process(draw: Draw) -> list[str]:
    """Fly it, have it have a child that ends, and see that it flies on, and ends in order."""
    with foreign_aircraft(_firmware(draw)) as there:
        program = Program(draw, there)
        try:
            program.wait_flying()
            time.sleep(0.5)  # a child that ends is gone, or as good as gone
            moves, flown = len(there.movements), there.missions.flown_m

            def goes_on() -> bool:
                if draw.flight == "mission":
                    return there.missions.flown_m > flown + 0.2
                # A busy machine lets setpoints expire in between.
                return [move.values[0] for move in there.movements[moves:]].count(2.0) > 5

            blocking_until(goes_on, within=10.0)
            program.process.send_signal(signal.SIGTERM)
            program.wait_ended()
            return program.troubles()
        except AssertionError:
            return ["the parent does not fly on", *program.troubles()]
        except subprocess.TimeoutExpired:
            return ["the process does not end", *program.troubles()]
        finally:
            program.kill()


# -- in this process, on virtual time --------------------------------------------------------------

IN_MEMORY = {
    "flight": ("hover", "land", "mission", "by hand", "hold"),
    "ending": (
        *("raise", "exit", "leave", "land", "timeout", "cancel", "cancel all", "stop", "pilot"),
        *("app", "mute", "unplug", *(number.name for number in NUMBERS)),
    ),
    "loss": ("nothing", "sealed", "log", "slow log", "blocked log", "tasks", "stack", "clock"),
}
"""What the draws on virtual time are made of."""

_UNWANTED = ("pilot", "app", "unplug")
"""Endings behind which no landing is ours to order."""


class Bug(Exception):
    """What a program raises."""


class Handler(logging.Handler):
    """Of a program's log: raises, is slow, or blocks until it is freed."""

    def __init__(self, what: str) -> None:
        super().__init__()
        self.what = what
        self.is_free = threading.Event()

    def emit(self, record: logging.LogRecord) -> None:
        if self.what == "log":
            raise Bug
        self.is_free.wait(0.001 if self.what == "slow log" else 5.0)


class Flight:
    """One draw, flown in this process on virtual time.

    Args:
        draw: What to fly.
        chance: When and where.
    """

    def __init__(self, draw: Draw, chance: Random) -> None:
        self.draw, self.chance = draw, chance
        self.ends_at = chance.uniform(0.02, 1.5)
        self.acted: list[signal.Signals] = []
        self.asked_for: list[str] = []
        self.there: ForeignInMemory | None = None
        self._task: asyncio.Task[None] | None = None
        self._is_stuck = False
        self._host: asyncio.Task[object] | None = None  # stands for the test, not the program
        self._handler = Handler(draw.loss)
        self._limit = sys.getrecursionlimit()

    def fly(self) -> list[str]:
        """Fly it, end it, and return what is not as it should be."""
        before = {number: signal.getsignal(number) for number in NUMBERS}
        default_signals()
        try:
            with (
                contextlib.suppress(Bug, SystemExit, KeyboardInterrupt, RuntimeError, M100Error),
                asyncio.Runner(loop_factory=VirtualClockEventLoop) as runner,
            ):
                runner.get_loop().set_exception_handler(lambda *_: None)
                runner.run(self._main())
        finally:
            _refusing.discard(self)
            self._handler.is_free.set()
            logging.getLogger("m100link").removeHandler(self._handler)
            sys.setrecursionlimit(self._limit)
            for number, handler in before.items():
                signal.signal(number, handler)
        return self._troubles()

    async def _main(self) -> None:
        self._host = asyncio.current_task()
        async with foreign("3.1") as (there, aircraft):
            self.there = there
            self._task = asyncio.create_task(self._program(aircraft))
            await asyncio.wait([self._task], timeout=200.0)
            self._is_stuck = not self._task.done()
            await asyncio.sleep(0.5)

    # -- the program -----------------------------------------------------------------------------

    async def _program(self, aircraft: Aircraft) -> None:
        stop: Literal["hover", "land"] = "land" if self.draw.flight == "land" else "hover"
        block = aircraft.control(stop=stop)
        try:
            if self.draw.flight == "by hand":
                control = await block.obtain()
                async with asyncio.timeout(self._time_out):
                    await self._fly(control)
                await block.release()
            elif self.draw.loss == "stack":
                await self._deep(150, block)
            else:
                async with block as control, asyncio.timeout(self._time_out):
                    await self._fly(control)
        finally:
            _refusing.discard(self)

    @property
    def _time_out(self) -> float | None:
        return self.ends_at + 0.01 if self.draw.ending == "timeout" else None

    async def _deep(self, frames: int, block: Control) -> None:
        """Fly so deep in the stack, and end where hardly any of it is left."""
        if frames:
            await self._deep(frames - 1, block)
            return
        async with block as control, asyncio.timeout(self._time_out):
            try:
                await self._fly(control)
            finally:
                here, frame = 0, cast("FrameType | None", sys._getframe())
                while frame is not None:
                    here, frame = here + 1, frame.f_back
                with contextlib.suppress(RecursionError):  # not so little
                    sys.setrecursionlimit(here + self.chance.randrange(4, 60))

    async def _fly(self, control: Control) -> None:
        loop = asyncio.get_running_loop()
        loop.call_later(self.ends_at, self._lose)
        loop.call_later(self.ends_at, self._end_from_outside)
        began_at = loop.time()
        if self.draw.flight == "mission":
            async with control.waypoint_mission(plan(speed=1.0)):
                await asyncio.sleep(self.ends_at + 0.001)
                await self._end(control)
                await asyncio.sleep(math.inf)
        if self.draw.flight == "hold":
            async with control.hold(NORTH, lifetime=1.0) as hold:
                while loop.time() < began_at + self.ends_at:
                    hold.set(NORTH)
                    await asyncio.sleep(0.1)
                if await self._end(control):
                    return
                while True:
                    hold.set(NORTH)
                    await asyncio.sleep(0.1)
        async for tick in control.ticks():
            control.send(NORTH)
            if tick.elapsed > self.ends_at and await self._end(control):
                return

    async def _end(self, control: Control) -> bool:
        """End it here, where that is how it ends."""
        ending = self.draw.ending
        if ending == "raise":
            raise Bug
        if ending == "exit":
            raise SystemExit(3)
        if ending == "land" and self.draw.flight not in ("mission", "hold"):
            await control.land()
            return True
        if ending in ("leave", "land"):
            if self.draw.flight == "mission":
                raise Bug  # its block has no other way out
            return True
        return False

    def _lose(self) -> None:
        loss = self.draw.loss
        if loss == "sealed":
            _refusing.add(self)
        elif loss.endswith("log"):
            logging.getLogger("m100link").addHandler(self._handler)
        elif loss == "tasks":
            refuse_tasks()
        elif loss == "clock":
            time.time = lambda: 0.0  # 1970, as without a battery

    def _end_from_outside(self) -> None:
        assert self._task is not None
        assert self.there is not None
        ending, there = self.draw.ending, self.there
        if ending in signal.Signals.__members__:
            number = signal.Signals[ending]
            handler = signal.getsignal(number)
            if callable(handler):
                handler(number, None)
        elif ending == "cancel":
            self._task.cancel()
        elif ending == "cancel all":
            for task in asyncio.all_tasks() - {self._host}:
                task.cancel()
        elif ending == "mute":
            there.is_mute = True
        elif ending in _ENDINGS_THERE:
            _ENDINGS_THERE[ending](there)
        elif ending == "stop":
            asyncio.get_running_loop().stop()

    # -- what became of it -----------------------------------------------------------------------

    def _troubles(self) -> list[str]:
        there, (flight, ending, _) = self.there, self.draw
        assert there is not None
        moves = [move.values for move in there.movements if move.is_obeyed]
        wrong = {
            "the program does not end": self._is_stuck,
            f"it asked for {self.asked_for}": bool(self.asked_for),
        }
        if ending == "unplug":  # nobody can hear it
            return [name for name, is_so in wrong.items() if is_so]
        wrong["the aircraft is not released"] = there.device == ONBOARD
        if flight == "mission":
            wrong["the mission flies on"] = bool(there.missions.flying)
        elif moves and ending not in (*_UNWANTED, "land"):  # that one ends what was flown
            wrong[f"the last movement is {moves[-1]}"] = moves[-1] != (0.0, 0.0, 0.0, 0.0)
        if flight == "land" and ending not in _UNWANTED:
            wrong["it was not ordered to land"] = LAND not in there.tasks
        if ending in signal.Signals.__members__:
            wrong[f"signals acted: {self.acted}"] = self.acted != [signal.Signals[ending]]
        return [name for name, is_so in wrong.items() if is_so]


_ENDINGS_THERE: dict[str, Callable[[ForeignInMemory], None]] = {
    "pilot": ForeignInMemory.leave_f,
    "app": ForeignInMemory.take_by_app,
    "unplug": ForeignInMemory.unplug,
}


_refusing: set[Flight] = set()
"""Flights in which nothing is to be asked of the system."""


def _on_audit(event: str, args: tuple[object, ...]) -> None:
    if _refusing and event in ASKED_FOR and threading.current_thread().name != LOG:
        for flight in _refusing:
            flight.asked_for.append(f"{event} {args[0]!r}")
        raise OSError(5, "Input/output error")


_hooks: list[object] = []  # an audit hook stays to the end of its process


def draw_in_memory(seed: int, number: int) -> tuple[Draw, list[str]]:
    """Fly draw ``number``; returns it, and what is not as it should be."""
    if not _hooks:
        _hooks.append(_on_audit)
        sys.addaudithook(_on_audit)
    chance = Random(f"{seed}:{number}")
    draw = Draw(*(chance.choice(choices) for choices in IN_MEMORY.values()))
    if draw.flight in ("mission", "by hand") and draw.loss == "stack":
        draw = draw._replace(loss="nothing")
    flight = Flight(draw, chance)
    before = signal.raise_signal, time.time, log_thread.FLUSH_S
    signal.raise_signal = lambda number: flight.acted.append(signal.Signals(number))
    log_thread.FLUSH_S = 0.02
    try:
        return draw, flight.fly()
    finally:
        signal.raise_signal, time.time, log_thread.FLUSH_S = before


def say(text: str) -> None:
    """One line, at once."""
    sys.stdout.write(f"{text}\n")
    sys.stdout.flush()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--draws", type=int, default=10_000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--first", type=int, default=0, help="number of the first draw")
    options = parser.parse_args()
    chance = Random(options.seed)
    began_at, processes, counted = time.monotonic(), 0, Counter[str]()
    for number in range(options.first, options.first + options.draws):
        if number % 100 == 99:
            draw = chance.choice(PROCESSES + FORKS)
            troubles = (fork_a_process if draw in FORKS else end_a_process)(draw)
            processes += 1
        else:
            draw, troubles = draw_in_memory(options.seed, number)
        counted[draw.loss] += 1
        if troubles:
            sys.exit(f"seed {options.seed}, draw {number}, {draw}: {'; '.join(troubles)}")
        if number % 500 == 499:
            say(f"{number + 1} endings after {time.monotonic() - began_at:.0f} s")
    say(
        f"{options.draws} endings in order, {processes} of them processes, in "
        f"{time.monotonic() - began_at:.0f} s: {dict(sorted(counted.items()))}"
    )


if __name__ == "__main__":
    main()
