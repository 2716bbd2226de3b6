"""A program that flies, ends somehow, and has lost something by then, of ``test_reserves.py``.

    python -m tests.flight.ending_programs PORT FLIGHT ENDING LOSS

It flies the foreign aircraft, which is in the air already, north for ever, until it is ended. Then
something of the system is lost first: file descriptors, the disk, stderr, a handler of its log. On
stdout it says when it flies, and names each file, module, socket and thread that it asked for
between its loss and its end.
"""

from __future__ import annotations

import asyncio
import contextlib
import fcntl
import logging
import os
import resource
import signal
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal

import m100link
from m100link import sync
from m100link.flight.cancellation import NUMBERS
from tests.flight.foreign_aircraft import APP_ID, KEY
from tests.flight.missions.foreign import plan
from tests.rig import NORTH
from tests.waiting import PATIENCE

CREDENTIALS = m100link.Credentials(app_id=APP_ID, key=KEY)
GUARDS = m100link.Guards(envelope=m100link.Envelope(max_radius_m=10_000.0))

# -- what is lost ---------------------------------------------------------------------------------

ASKED_FOR = {"import", "open", "socket.__new__", "_thread.start_new_thread", "os.listdir"}
ASKED_FOR |= {"os.scandir", "os.fork", "subprocess.Popen"}
LOG = "m100link log"
"""The thread that may ask, in vain: it writes the log, tracebacks with lines of files in it."""

_sealed = threading.Event()


def _refuse(event: str, args: tuple[Any, ...]) -> None:
    if event in ASKED_FOR and _sealed.is_set():
        if threading.current_thread().name != LOG:
            os.write(1, f"asked for {event} {args[0]!r}\n".encode())
        raise OSError(5, "Input/output error")


def seal() -> None:
    """No file, module, socket or thread any more."""
    _sealed.set()


def fill_the_table() -> None:
    """No file descriptor any more."""
    resource.setrlimit(resource.RLIMIT_NOFILE, (100, 100))
    with contextlib.suppress(OSError):
        while True:
            os.open(os.devnull, os.O_RDONLY)


class Raising(logging.Handler):
    """Raises, as one whose window or socket is gone."""

    def emit(self, record: logging.LogRecord) -> None:
        raise ZeroDivisionError("a handler of the program")


def log_to_what_raises() -> None:
    logging.getLogger("m100link").addHandler(Raising())
    logging.getLogger("m100link.flight").addHandler(Raising())


def block_stderr() -> None:
    """It takes no more, as a pipe that nobody reads."""
    reader, writer = os.pipe()
    os.dup2(writer, 2)
    os.set_inheritable(reader, True)  # kept open, and never read
    fcntl.fcntl(writer, fcntl.F_SETPIPE_SZ, 4096)
    os.set_blocking(2, False)
    with contextlib.suppress(BlockingIOError):
        while True:
            os.write(2, bytes(64))
    os.set_blocking(2, True)
    logging.basicConfig(level=logging.DEBUG)


def use_memory_up() -> None:
    """No page of memory more than there is."""
    pages = Path("/proc/self/statm").read_text(encoding="ascii").split()[0]
    in_use = int(pages) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (in_use, in_use))


def refuse_tasks() -> None:
    """A task factory raises."""

    def factory(*_: object, **__: object) -> None:
        raise RuntimeError("a task factory of the program")

    asyncio.get_running_loop().set_task_factory(factory)  # type: ignore[arg-type] # it is wrong


LOSSES: dict[str, Callable[[], None]] = {
    "nothing": lambda: None,
    "sealed": seal,
    "table": fill_the_table,
    "log": log_to_what_raises,
    "stderr": block_stderr,
    "memory": use_memory_up,
    "tasks": refuse_tasks,
}


# -- how it ends ----------------------------------------------------------------------------------


def is_left_by_a_child(way: str) -> bool:
    """Have a child that ends as ordered. Returns whether this is one that is to return."""
    if os.fork() != 0:
        return False
    if way == "exit":
        sys.exit(3)
    if way == "raise":
        raise ZeroDivisionError("in the child")
    if way == "SIGTERM":
        signal.raise_signal(signal.SIGTERM)
        time.sleep(60.0)
    if way == "_exit":
        os._exit(0)
    if way == "stay":
        signal.pthread_sigmask(signal.SIG_BLOCK, NUMBERS)
        while True:
            signal.pause()
    return True


def end(ending: str) -> bool:
    """Begin to end, where the flight is. Returns whether its function is to be left."""
    if ending.startswith("fork "):
        return is_left_by_a_child(ending.removeprefix("fork "))
    if ending.startswith("SIG"):
        os.kill(os.getpid(), signal.Signals[ending])
    if ending == "raise":
        raise ZeroDivisionError("a bug of the program")
    if ending == "exit":
        sys.exit(3)
    return ending == "leave"  # what the pilot and the line do is not begun here


def _say(text: str) -> None:
    os.write(1, f"{text}\n".encode())


async def fly(control: m100link.Control, ending: str, loss: str) -> None:
    """North for ever, or until it ends."""
    async for tick in control.ticks():
        control.send(NORTH)
        if tick.index < 20:
            continue
        if not _flies.is_set():
            _flies.set()
            LOSSES[loss]()
            _say("flying")
            if ending == "land":
                await control.land()
                return
            if end(ending):
                return


_flies = threading.Event()


async def watch(control: m100link.Control, ending: str, loss: str) -> None:
    """The aircraft flies a mission."""
    async with control.waypoint_mission(plan(speed=1.0)) as mission:
        async for _ in mission:
            if not _flies.is_set():
                _flies.set()
                LOSSES[loss]()
                _say("flying")
                if end(ending):
                    return


async def main(port: str, flight: str, ending: str, loss: str) -> None:
    stop: Literal["hover", "land"] = "land" if flight == "land" else "hover"
    async with m100link.connect(port) as aircraft:
        await aircraft.activate(CREDENTIALS)
        await aircraft.wait_for(lambda state: state.flight_status is not None, timeout=PATIENCE)
        try:
            async with aircraft.control(stop=stop, guards=GUARDS) as control:
                do = watch if flight == "mission" else fly
                limit = 1.0 if ending == "timeout" else None
                async with asyncio.timeout(limit):
                    await do(control, ending, loss)
        finally:
            _sealed.clear()


def main_without_await(port: str, ending: str, loss: str) -> None:
    with sync.connect(port) as aircraft:
        aircraft.activate(CREDENTIALS)
        aircraft.wait_for(lambda state: state.flight_status is not None, timeout=PATIENCE)
        try:
            with aircraft.control(guards=GUARDS) as control:
                for tick in control.ticks():
                    control.send(NORTH)
                    if tick.index == 20:
                        LOSSES[loss]()
                        _say("flying")
                        if end(ending):
                            return
        finally:
            _sealed.clear()


def fall_off_the_end(port: str, flight: str, loss: str) -> None:
    """The event loop runs no more, nobody closes it, and the program ends."""
    loop = asyncio.new_event_loop()
    flying = loop.create_task(main(port, flight, "nothing", loss))

    async def see_it_fly() -> None:
        while not _flies.is_set():  # noqa: ASYNC110 (an event of threads)
            await asyncio.sleep(0.01)

    loop.run_until_complete(see_it_fly())
    assert not flying.done()


def default_signals() -> None:
    """As in a program that is begun at a prompt: a shell lets those in the background ignore some.

    What is ignored is left alone.
    """
    for number in NUMBERS:
        is_ctrl_c = number == signal.SIGINT
        signal.signal(number, signal.default_int_handler if is_ctrl_c else signal.SIG_DFL)


if __name__ == "__main__":
    default_signals()
    sys.addaudithook(_refuse)
    own_port, own_flight, own_ending, own_loss = sys.argv[1:]
    if own_ending == "fall":
        fall_off_the_end(own_port, own_flight, own_loss)
    elif own_flight == "sync":
        main_without_await(own_port, own_ending, own_loss)
    else:
        asyncio.run(main(own_port, own_flight, own_ending, own_loss))
