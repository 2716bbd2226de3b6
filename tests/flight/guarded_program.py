"""A program that flies and comes to a bad end: python -m tests.flight.guarded_program URL MODE END.

For ``test_guardian.py``. The foreign aircraft is in the air already, and is flown north, or by a
mission. What ends the program from within comes while it flies; what is to be sent from outside is
waited for. Everything that an end needs is loaded before.
"""

from __future__ import annotations

import asyncio
import ctypes
import os
import resource
import signal
import sys
import time
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Literal

import m100link
from tests.flight.foreign_aircraft import APP_ID, KEY
from tests.flight.missions.foreign import plan
from tests.rig import NORTH
from tests.waiting import PATIENCE


def guardian_of(process: int) -> int:
    """The process of that name among its children."""
    for child in Path(f"/proc/{process}/task/{process}/children").read_text().split():
        if Path(f"/proc/{child}/comm").read_text().strip() == "m100link-guard":
            return int(child)
    raise AssertionError("it has no guardian")


def kill() -> None:
    """As the system does."""
    os.kill(os.getpid(), signal.SIGKILL)


def crash() -> None:
    """Read where there is nothing."""
    ctypes.string_at(0)


def use_up_memory() -> None:
    """Take what the process may have, and end as programs do that get no more."""
    resource.setrlimit(resource.RLIMIT_AS, (2**28, 2**28))
    kept = []
    for size in (2**24, 2**16, 2**8):
        try:
            while True:
                kept.append(bytearray(size))
        except MemoryError:
            continue
    os.abort()


def leave_a_child() -> None:
    """A child of a fork has the line, the page and the socket, and outlives this process."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        child = os.fork()
    if child == 0:
        time.sleep(20.0)
        os._exit(0)
    kill()


def use_up_descriptors() -> None:
    """Not one file can be opened any more."""
    try:
        while True:
            os.dup(0)
    except OSError:
        kill()


def lose_the_disk() -> None:
    """Not one file or module can be read any more."""

    def fail(event: str, _: object) -> None:
        if event in ("open", "import"):
            raise OSError(5, "Input/output error")

    sys.addaudithook(fail)
    kill()


def sleep() -> None:
    """What beginners write."""
    time.sleep(3.5)


def hold_everything() -> None:
    """A call in C that lets no other thread of Python run."""
    ctypes.PyDLL(None).usleep(3_500_000)


def stand_still() -> None:
    """As a debugger does."""
    os.kill(os.getpid(), signal.SIGSTOP)


def leave() -> None:
    """Without any clean-up."""
    os._exit(3)


def become_another() -> None:
    """The process lives on as another program."""
    os.execv(sys.executable, [sys.executable, "-c", "import time; time.sleep(20)"])


ENDS: dict[str, Callable[[], None]] = {
    "kill": kill,
    "segv": crash,
    "memory": use_up_memory,
    "fork": leave_a_child,
    "descriptors": use_up_descriptors,
    "disk": lose_the_disk,
    "sleep": sleep,
    "gil": hold_everything,
    "stopped": stand_still,
    "exit": leave,
    "execv": become_another,
}


async def main(url: str, mode: str, end: str) -> None:
    """Fly until then."""
    far = m100link.Guards(envelope=m100link.Envelope(max_radius_m=10_000.0))
    async with m100link.connect(url) as aircraft:
        await aircraft.activate(m100link.Credentials(app_id=APP_ID, key=KEY))
        await aircraft.wait_for(lambda state: state.flight_status is not None, timeout=PATIENCE)
        stop: Literal["hover", "land"] = "land" if mode == "land" else "hover"
        async with aircraft.control(stop=stop, guards=far, guardian=end != "unguarded") as control:
            if mode == "mission":
                async with control.waypoint_mission(plan(speed=1.0)):
                    await asyncio.sleep(1.0)
                    print("flying", flush=True)  # noqa: T201 (the test waits for it)
                    if end in ENDS:
                        ENDS[end]()
                    await asyncio.sleep(60.0)
            flown = 0
            async for _ in control.ticks():  # those that came too late are left out
                control.send(NORTH)
                flown += 1
                if flown == 20:
                    print("flying", flush=True)  # noqa: T201 (the test waits for it)
                if flown == 25 and end in ENDS:
                    ENDS[end]()


if __name__ == "__main__":
    asyncio.run(main(*sys.argv[1:]))
