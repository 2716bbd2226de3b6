"""Endings of a flight beside what the system has lost: ``python -m tests.attacks.endings``.

Each draw is a flight, how it ends, and what is lost by then: file descriptors, the disk, the log,
stderr. Most are flown in this process on virtual time, every hundredth by a process of its own in
real time, all against the aircraft that shares no line with the library. It is judged by what that
one received: the neutral last, a landing where one was asked for, the release. The first draw that
is not so ends the program and prints its seed.

    python -m tests.attacks.endings --draws 10000 --seed 1
"""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from itertools import product
from pathlib import Path
from typing import NamedTuple

from tests.flight.foreign_aircraft import RC, STANDBY, ForeignAircraft, foreign_aircraft
from tests.waiting import PATIENCE, blocking_until

__all__ = ["FORKS", "PROCESSES", "Draw", "end_a_process", "fork_a_process"]

ROOT = Path(__file__).parents[2]
STOP_MISSION = 0x12


class Draw(NamedTuple):
    """A flight, how it ends, and what the system has lost by then."""

    flight: str
    ending: str
    loss: str


FLIGHTS = ("hover", "land", "mission", "sync")
LOSSES = ("nothing", "sealed", "table", "log", "stderr")
ENDINGS = ("raise", "exit", "leave", "SIGTERM", "SIGINT", "SIGHUP", "SIGQUIT", "pilot", "stall")

PROCESSES = (
    *(Draw(*one) for one in product(FLIGHTS, ENDINGS, LOSSES)),
    *(Draw(flight, "timeout", loss) for flight in ("hover", "mission") for loss in LOSSES),
    *(Draw("hover", "land", loss) for loss in LOSSES),
    *(Draw("hover", "fall", loss) for loss in LOSSES),
    *(Draw(flight, "SIGTERM", "tasks") for flight in ("hover", "land", "mission")),
)
"""Every flight that a process of its own can end."""

FORKS = tuple(
    Draw(flight, f"fork {way}", "nothing")
    for flight in ("hover", "land", "mission")
    for way in ("exit", "raise", "return", "_exit", "SIGTERM")
)
"""Every flight beside which a child is born and ends, and the parent flies on."""


_SILENT = ("leave", "exit", "land", "SIGTERM", "SIGHUP", "SIGQUIT")
"""Endings of which Python says nothing by itself."""


class Program:
    """The process that flies, and the aircraft that it flies."""

    def __init__(self, draw: Draw, there: ForeignAircraft) -> None:
        self.draw, self.there = draw, there
        self.said = b""
        command = (sys.executable, "-m", "tests.flight.ending_programs", there.name, *draw)
        self.process = subprocess.Popen(
            command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL
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
            self.process.kill()
        rest, _ = self.process.communicate(timeout=PATIENCE)
        self.said += rest
        if self.draw.flight == "land" and self.draw.ending != "pilot":
            blocking_until(lambda: self.there.status == STANDBY, within=5.0)
        time.sleep(0.1)

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
            orders = there.missions.orders
            wrong["the mission flies on"] = bool(there.missions.flying)
            wrong["no stop was its last order"] = orders[-1].number != STOP_MISSION
        else:
            wrong["nothing was flown"] = (2.0, 0.0, 0.0, 0.0) not in moves
            wrong[f"the last movement is {moves[-1:]}"] = moves[-1:] != [(0.0, 0.0, 0.0, 0.0)]
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
            program.process.kill()
            program.process.wait()


def fork_a_process(draw: Draw) -> list[str]:
    """Fly it, have it have a child that ends, and see that it flies on, and ends in order."""
    with foreign_aircraft(_firmware(draw)) as there:
        program = Program(draw, there)
        try:
            program.wait_flying()
            time.sleep(0.5)
            moves, flown = len(there.movements), there.missions.flown_m
            time.sleep(0.7)
            goes_on = there.missions.flown_m > flown
            if draw.flight != "mission":
                new = {move.values for move in there.movements[moves:]}
                goes_on = new == {(2.0, 0.0, 0.0, 0.0)}
            program.process.send_signal(signal.SIGTERM)
            program.wait_ended()
            return program.troubles() + ["the parent does not fly on"] * (not goes_on)
        except subprocess.TimeoutExpired:
            return ["the process does not end", *program.troubles()]
        finally:
            program.process.kill()
            program.process.wait()
