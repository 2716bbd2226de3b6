"""How a program can end, and what the aircraft then received last and did: one table.

The manual's page is made of it (``{ending-table}``), and each cell is flown by
``tests/flight/test_endings.py``.
"""

from __future__ import annotations

from enum import Enum
from typing import NamedTuple

__all__ = ["ENDINGS", "MODES", "Ending", "Outcome"]

MODES = ("hover", "land", "mission")
"""A block with ``stop="hover"``, one with ``stop="land"``, and one whose mission flies."""


class Outcome(NamedTuple):
    """What an aircraft received last, and what it did.

    Attributes:
        received: What came last.
        did: What the aircraft did.
    """

    received: str
    did: str


HOVERS = Outcome("0.3 s of neutral, then the release", "hovers; the pilot flies on")
LANDS = Outcome("neutral, the landing, then the release", "lands and stops its motors")
STOPS = Outcome("the mission's stop, then the release", "stops where it is and hovers")
SILENCE = Outcome(
    "the last setpoint, then nothing", "hovers, with nobody in control until the pilot leaves F"
)
LANDS_BY_GUARDIAN = Outcome(
    "neutral, the landing, and a minute later the release", "lands and stops its motors"
)
FLIES_ON = Outcome(
    "nothing more", "flies the mission to its end; the pilot or the next program stops it"
)
GOES_ON = Outcome("what the parent sends", "flies as before: the child has no part in the line")

IN_ORDER = (HOVERS, LANDS, STOPS)
"""Whatever leaves the program time to act."""

BY_GUARDIAN = (HOVERS, LANDS_BY_GUARDIAN, STOPS)
"""The program can no longer act; the guardian does, and does not read the aircraft's answers."""

CUT_OFF = (SILENCE, SILENCE, FLIES_ON)
"""Nobody can send anything any more; a landing that was asked for does not happen."""


class Ending(Enum):
    """What ends a program, in words."""

    EXCEPTION = "an exception in the block"
    CANCELLATION = "its task is cancelled"
    CTRL_C = "Ctrl-C"
    CTRL_C_TWICE = "Ctrl-C twice"
    CTRL_C_THRICE = "Ctrl-C three times"
    SIGTERM = "SIGTERM"
    SIGHUP = "SIGHUP: its terminal is closed"
    SIGQUIT = "SIGQUIT: Ctrl and the backslash"
    SIGXCPU = "SIGXCPU: its processor time is used up"
    EXIT = "`sys.exit()`: the interpreter ends"
    COLLECTED = "an abandoned generator is collected (GC)"
    FALLS_OFF = "its last line, with an open block and an event loop that runs no more"
    OUT_OF_RESOURCES = (
        "any of these when the system has no file descriptor, disk, thread or task left, or "
        "beside a log whose handler raises or blocks"
    )
    FORK = "the child of a fork ends: `sys.exit()`, `os._exit()`, an exception, `return`, SIGTERM"
    HANG = "the event loop is blocked for 2 s: `time.sleep()`, a debugger"
    STOPPED = "the process is stopped for 2 s (SIGSTOP), or the computer sleeps as long"
    KILL = "`kill -9`, a signal that nobody handles (SIGUSR1, SIGALRM), the system is out of memory"
    CRASH = "a crash (SIGSEGV, SIGABRT), `os._exit()`, `os.execv()`"
    UNPLUGGED = "the cable is pulled, the computer loses power"
    UNGUARDED = "a hang, a stop, a kill or a crash with `control(guardian=False)`"


ENDINGS: dict[Ending, tuple[Outcome, Outcome, Outcome]] = {
    Ending.EXCEPTION: IN_ORDER,
    Ending.CANCELLATION: IN_ORDER,
    Ending.CTRL_C: IN_ORDER,
    Ending.CTRL_C_TWICE: IN_ORDER,
    Ending.CTRL_C_THRICE: IN_ORDER,
    Ending.SIGTERM: IN_ORDER,
    Ending.SIGHUP: IN_ORDER,
    Ending.SIGQUIT: IN_ORDER,
    Ending.SIGXCPU: IN_ORDER,
    Ending.EXIT: IN_ORDER,
    Ending.COLLECTED: IN_ORDER,
    Ending.FALLS_OFF: IN_ORDER,
    Ending.OUT_OF_RESOURCES: IN_ORDER,
    Ending.FORK: (GOES_ON, GOES_ON, GOES_ON),
    Ending.HANG: BY_GUARDIAN,
    Ending.STOPPED: BY_GUARDIAN,
    Ending.KILL: BY_GUARDIAN,
    Ending.CRASH: BY_GUARDIAN,
    Ending.UNPLUGGED: CUT_OFF,
    Ending.UNGUARDED: CUT_OFF,
}
"""What becomes of the aircraft, in the order of :data:`MODES`."""
