"""A request and its ack over a pseudo-terminal: CPU time and the median from one to the other.

    python -m benchmarks.request [ROW …] [--rounds 15] [--json] [--beside TREE]

The other end is a process of its own that acks every request: in C where a compiler is, so that
little of what is timed is its own; in Python otherwise. Beside it in the same rounds: the same link
on pyserial-asyncio's transport, on uvloop where it is installed, and a loop in C of `poll`, `read`
and `write`, which is the floor: two processes that wake each other. All of them keep to one CPU: to
wake another one that sleeps takes longer, on a virtual machine, than all that is compared here.
"""

from __future__ import annotations

import asyncio
import importlib
import importlib.util
import os
import subprocess
import sys
import time
import tty
from collections.abc import Awaitable, Callable, Iterable
from contextlib import ExitStack
from typing import Any

import serial
import serial_asyncio

from benchmarks.compiled import compiled
from benchmarks.program import main
from benchmarks.rows import (
    Absent,
    NotMeasured,
    Program,
    Row,
    Setting,
    Side,
    at_most,
    beside_today,
    percentile,
    ratio,
)
from m100link.link import Link, open_link
from m100link.wire import FrameDecoder, encode_frame

COUNT = 500
DATA = bytes(9)
REQUEST = "request → ack over a pty"
PYSERIAL, UVLOOP, FLOOR = f"{REQUEST}, pyserial-asyncio", f"{REQUEST}, uvloop", f"{REQUEST}, C"
SOURCE = "peer.c"

Opener = Callable[[str], Awaitable[Link]]


# -- the other end ---------------------------------------------------------------------------------


def answer() -> None:
    """The other end where there is no compiler: prints the name of its terminal, acks requests."""
    master, slave = os.openpty()
    tty.setraw(slave)
    print(os.ttyname(slave), flush=True)
    decoder = FrameDecoder()
    while True:
        for frame in decoder.feed(os.read(master, 4096)):
            if frame.session:
                ack = encode_frame(
                    b"\0\0", session=frame.session, sequence=frame.sequence, is_ack=True
                )
                os.write(master, ack)


def process(command: list[str], stack: ExitStack) -> subprocess.Popen[str]:
    """A process that is asked line by line, and ends with the stack."""
    started = stack.enter_context(
        subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    )
    stack.callback(started.terminate)
    return started


def read_line(started: subprocess.Popen[str]) -> str:
    """The next line of its output."""
    assert started.stdout is not None
    return started.stdout.readline().strip()


def other_end(stack: ExitStack) -> str:
    """Path of a terminal whose other end acks what it gets."""
    try:
        command = [str(compiled(SOURCE, stack)), "answer"]
    except NotMeasured:
        command = [sys.executable, "-c", "from benchmarks.request import answer; answer()"]
    return read_line(process(command, stack))


# -- sides -----------------------------------------------------------------------------------------


def requesting(name: str, count: int, stack: ExitStack, opener: Opener, loop: Any = None) -> Side:
    """Requests one after the other over an open link."""
    runner = stack.enter_context(asyncio.Runner(loop_factory=loop))
    link = runner.run(opened(opener, other_end(stack)))
    stack.callback(lambda: runner.run(link.close()))

    async def ask() -> dict[str, float]:
        took = []
        spent = time.thread_time()
        for _ in range(count):
            began = time.perf_counter()
            await link.request(DATA)
            took.append(time.perf_counter() - began)
        return {
            "CPU": (time.thread_time() - spent) / count,
            "p50": percentile(took, 0.5),
        }

    return Side(name, lambda: runner.run(ask()))


async def opened(opener: Opener, path: str) -> Link:
    """A link, as its opener makes it."""
    return await opener(path)


async def over_pyserial(path: str) -> Link:
    """The same link on pyserial-asyncio's own transport."""
    link = Link()
    port = serial.Serial(path, baudrate=115_200, exclusive=True, timeout=0)
    serial_asyncio.SerialTransport(asyncio.get_running_loop(), link, port)
    await link.wait_connected()
    return link


def floor(count: int, stack: ExitStack) -> Side:
    """The loop in C."""
    program = compiled(SOURCE, stack)
    started = process([str(program), "ask", other_end(stack)], stack)

    def run() -> dict[str, float]:
        print(count, file=started.stdin, flush=True)
        spent, middle = map(float, read_line(started).split())
        return {"CPU": spent, "p50": middle}

    return Side(FLOOR, run)


def ours(setting: Setting, stack: ExitStack) -> Iterable[Side]:
    """The link on its own transport."""
    yield requesting(REQUEST, setting.count(COUNT), stack, open_link)


def others(setting: Setting, stack: ExitStack) -> Iterable[Side | Absent]:
    """Another transport, another event loop, no event loop."""
    count = setting.count(COUNT)
    yield requesting(PYSERIAL, count, stack, over_pyserial)
    if importlib.util.find_spec("uvloop") is None:
        yield Absent(UVLOOP, "uvloop is not installed")
    else:
        new_loop = importlib.import_module("uvloop").new_event_loop
        yield requesting(UVLOOP, count, stack, open_link, new_loop)
    try:
        yield floor(count, stack)
    except NotMeasured as reason:
        yield Absent(FLOOR, str(reason))


PROGRAM = Program(
    name="request",
    rows=(
        Row(
            f"{REQUEST} ÷ the other tree's, CPU",
            beside_today(f"{REQUEST}, CPU"),
            at_most(0.6, 0.5),
        ),
        Row(
            f"{REQUEST} ÷ the other tree's, p50",
            beside_today(f"{REQUEST}, p50"),
            at_most(0.6, 0.5),
        ),
        Row(
            f"{REQUEST} ÷ over pyserial-asyncio, CPU", ratio(f"{REQUEST}, CPU", f"{PYSERIAL}, CPU")
        ),
        Row(
            f"{REQUEST} ÷ over pyserial-asyncio, p50", ratio(f"{REQUEST}, p50", f"{PYSERIAL}, p50")
        ),
        Row(f"{REQUEST}, on uvloop ÷ asyncio, CPU", ratio(f"{UVLOOP}, CPU", f"{REQUEST}, CPU")),
        Row(f"{REQUEST} ÷ a C loop's, CPU", ratio(f"{REQUEST}, CPU", f"{FLOOR}, CPU")),
        Row(f"{REQUEST} ÷ a C loop's, p50", ratio(f"{REQUEST}, p50", f"{FLOOR}, p50")),
    ),
    ours=ours,
    others=others,
)

if __name__ == "__main__":
    main(PROGRAM)
