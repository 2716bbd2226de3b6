"""From a front to the agent: how long a setpoint is on its way between two processes.

    python -m benchmarks.hop [ROW …] [--rounds 15] [--json] [--beside TREE]

A front's end of the carrier sends setpoints at 200 Hz; the agent's end, in a process of its own,
takes each and notes how long it was on its way, from just before it was sent until its handler has
it: encoding, two event loops, the socket and the wake-up of the other process are part of it. Both
have one clock. CPU is that of the agent's process, which reads and does nothing else. Beside it in
the same rounds: two processes without an event loop that pass as many bytes over a socket, which is
what the system takes for it.

All of them keep to one CPU, for the reason given in :mod:`benchmarks.request`.
"""

from __future__ import annotations

import asyncio
import json
import socket
import struct
import subprocess
import sys
import time
from collections.abc import Iterable
from contextlib import ExitStack
from pathlib import Path

import m100link
from benchmarks.program import main
from benchmarks.rows import NotMeasured, Program, Row, Setting, Side, percentile, ratio, times
from m100link.apps.agent.messages import Event, JournalNote, Message, Steer
from m100link.apps.agent.transports import (
    UnixChannel,
    connect_unix,
    private_directory,
    serve_unix,
)
from m100link.protocol import Setpoint

COUNT = 200
PERIOD_S = 0.005
PATIENCE_S = 60.0
SIZE = 64  # bytes, about those of a setpoint
HOP, SOCKET = "front → agent, send to handler", "a bare socket between two processes"
REPORT = "report"

# As in this process, the package may come from another tree than what measures it.
BOOT = """
import sys
tree, here, part, argument = sys.argv[1:]
sys.path.insert(0, tree)
import m100link
sys.path.insert(0, here)
from benchmarks import hop
getattr(hop, part)(argument)
"""
TREE, HERE = Path(m100link.__file__).parents[1], Path(__file__).parents[1]


# -- the other process -----------------------------------------------------------------------------


def agent(path: str) -> None:
    """The agent's end: takes setpoints, and tells about them when it is asked."""
    asyncio.run(_serve(Path(path)))


async def _serve(path: Path) -> None:
    loop = asyncio.get_running_loop()
    is_over = loop.create_future()
    late: list[float] = []
    began = 0.0

    def attach(channel: UnixChannel) -> None:
        def take(message: Message) -> None:
            nonlocal began
            if isinstance(message, Steer):
                late.append(loop.time() - message.sent_at)
            elif late:
                spent = (time.process_time() - began) / len(late)
                told = {"CPU": spent, "p50": percentile(late, 0.5), "p99": percentile(late, 0.99)}
                channel.send(Event(len(late), 0.0, "info", json.dumps(told)))
                late.clear()
            else:  # a round begins
                began = time.process_time()

        def end(reason: str) -> None:
            if not is_over.done():
                is_over.set_result(None)

        channel.open(take, end)

    async with serve_unix(path, attach):
        print("ready", flush=True)
        await is_over


def read(fd: str) -> None:
    """The floor's end: says for each round how late its stamps came."""
    with socket.socket(fileno=int(fd)) as end:
        late: list[float] = []
        began = time.process_time()
        while data := end.recv(SIZE, socket.MSG_WAITALL):
            (sent_at,) = struct.unpack_from("<d", data)
            if sent_at:
                late.append(time.monotonic() - sent_at)
                continue
            if late:
                spent = (time.process_time() - began) / len(late)
                print(json.dumps({"CPU": spent, "p50": percentile(late, 0.5)}), flush=True)
            late, began = [], time.process_time()


# -- sides -----------------------------------------------------------------------------------------


def started(
    stack: ExitStack, part: str, argument: str, fds: tuple[int, ...] = ()
) -> subprocess.Popen[str]:
    """A process with a line of output for each thing it has to say; ends with the stack.

    Args:
        stack: Ends it.
        part: Function of this module.
        argument: For that function.
        fds: Files that the process inherits.
    """
    command = [sys.executable, "-P", "-c", BOOT, str(TREE), str(HERE), part, argument]
    made = stack.enter_context(
        subprocess.Popen(command, stdout=subprocess.PIPE, text=True, pass_fds=fds)
    )
    stack.callback(made.terminate)
    return made


def told(process: subprocess.Popen[str]) -> str:
    """The next line of its output."""
    assert process.stdout is not None
    line = process.stdout.readline()
    if not line:
        raise NotMeasured(f"the other process ended with status {process.wait()}")
    return line


class Front:
    """A front's end of the carrier, and the agent behind it.

    Args:
        stack: Ends both.
    """

    def __init__(self, stack: ExitStack) -> None:
        path = stack.enter_context(private_directory()) / "agent.sock"
        told(started(stack, "agent", str(path)))
        self._runner = stack.enter_context(asyncio.Runner())
        self._channel = self._runner.run(connect_unix(path))
        self._answers: asyncio.Queue[Event] = asyncio.Queue()
        self._runner.run(self._open())
        stack.callback(lambda: self._runner.run(self._close()))

    async def _open(self) -> None:
        def take(message: Message) -> None:
            if isinstance(message, Event):
                self._answers.put_nowait(message)

        self._channel.open(take, lambda reason: None)

    async def _close(self) -> None:
        self._channel.close()

    def steer(self, count: int) -> dict[str, float]:
        """Send so many setpoints; returns what the agent says of them."""
        return self._runner.run(self._steer(count))

    async def _steer(self, count: int) -> dict[str, float]:
        loop = asyncio.get_running_loop()
        setpoint = Setpoint.velocity(north=1.0, east=2.0, up=0.5, yaw_rate_deg_s=10.0)
        self._channel.send(JournalNote("info", REPORT))
        for _ in range(count):
            await asyncio.sleep(PERIOD_S)
            self._channel.send(Steer(1, loop.time(), 0.2, setpoint))
        self._channel.send(JournalNote("info", REPORT))
        try:
            async with asyncio.timeout(PATIENCE_S):
                answer = await self._answers.get()
        except TimeoutError:
            raise NotMeasured(f"the agent did not answer within {PATIENCE_S:g} s") from None
        if answer.number != count:
            raise RuntimeError(f"{answer.number} of {count} setpoints came through")
        found: dict[str, float] = json.loads(answer.text)
        return found


def bare(count: int, stack: ExitStack) -> Side:
    """Bytes over a socket, read by a process that waits for nothing else."""
    ours, theirs = socket.socketpair()
    with theirs:
        reader = started(stack, "read", str(theirs.fileno()), (theirs.fileno(),))
    stack.callback(ours.close)

    def send(stamp: float) -> None:
        ours.sendall(struct.pack("<d", stamp).ljust(SIZE))

    def run() -> dict[str, float]:
        send(0.0)
        for _ in range(count):
            time.sleep(PERIOD_S)
            send(time.monotonic())
        send(0.0)
        found: dict[str, float] = json.loads(told(reader))
        return found

    return Side(SOCKET, run)


def ours(setting: Setting, stack: ExitStack) -> Iterable[Side]:
    """The carrier between two processes."""
    front, count = Front(stack), setting.count(COUNT)
    yield Side(HOP, lambda: front.steer(count))


def others(setting: Setting, stack: ExitStack) -> Iterable[Side]:
    """What the system takes for it."""
    yield bare(setting.count(COUNT), stack)


PROGRAM = Program(
    name="hop",
    rows=(
        Row(f"{HOP}, p50", times(f"{HOP}, p50", 1e3), unit="ms"),
        Row(f"{HOP}, p99", times(f"{HOP}, p99", 1e3), unit="ms"),
        Row(f"{HOP}, p50 ÷ a bare socket's", ratio(f"{HOP}, p50", f"{SOCKET}, p50")),
        Row("CPU of the agent for a setpoint taken", times(f"{HOP}, CPU", 1e6), unit="µs"),
    ),
    ours=ours,
    others=others,
)

if __name__ == "__main__":
    main(PROGRAM)
