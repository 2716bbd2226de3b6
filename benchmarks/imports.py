"""What it costs until the work begins: importing, and the shortest commands.

    python -m benchmarks.imports [ROW …] [--rounds 15] [--json] [--beside TREE]

Each figure comes from a fresh interpreter. An import is timed from after ``import asyncio`` on,
because programs on m100link need that anyway. The package loads what it names when it is asked for
it, so the names that a program begins with are imported in a row of their own. A command is timed
whole, as the system counts the CPU time of the process. Bytecode is there when timing begins, also
where the environment forbids to write it.
"""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable, Iterable
from contextlib import ExitStack

from benchmarks import peers
from benchmarks.frames import telemetry_frames
from benchmarks.program import main
from benchmarks.rows import Absent, Program, Row, Setting, Side, at_most, times

PACKAGE, WIRE = "import m100link beyond asyncio", "import m100link.wire beyond asyncio"
NAMES = "from m100link import connect, Setpoint, beyond asyncio"
HELP, DECODE = "m100link --help", "m100link decode of one frame"
TIMED_IMPORT = """
import asyncio, time
began = time.process_time()
{statement}
print(time.process_time() - began)
"""


def environment() -> dict[str, str]:
    """As a user's: with bytecode."""
    return {key: text for key, text in os.environ.items() if key != "PYTHONDONTWRITEBYTECODE"}


def child(*arguments: str) -> tuple[str, float]:
    """What a fresh interpreter printed, and the CPU seconds that the system counted for it."""
    command = [sys.executable, *arguments]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=environment()) as process:
        assert process.stdout is not None
        printed = process.stdout.read()
        _, status, used = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        raise subprocess.CalledProcessError(process.returncode, command)
    return printed, used.ru_utime + used.ru_stime


def importing(statement: str) -> Callable[[], float]:
    """CPU time of an import, by the interpreter that does it."""
    program = TIMED_IMPORT.format(statement=statement)
    return lambda: float(child("-c", program)[0])


def command(*arguments: str) -> Callable[[], float]:
    """CPU time of a whole process."""
    return lambda: child(*arguments)[1]


def warm(setting: Setting, runs: dict[str, Callable[[], float]]) -> Iterable[Side]:
    """Sides that find bytecode, because each has run once."""
    for name, run in runs.items():
        if not setting.is_quick:
            run()
        yield Side(name, run)


def ours(setting: Setting, stack: ExitStack) -> Iterable[Side]:
    """Package, its lowest room, and two commands."""
    frame = telemetry_frames(1)[0].hex()
    runs = {
        PACKAGE: importing("import m100link"),
        NAMES: importing("from m100link import connect, Setpoint"),
        WIRE: importing("import m100link.wire"),
        HELP: command("-m", "m100link", "--help"),
        DECODE: command("-m", "m100link", "decode", frame),
    }
    return warm(setting, runs)


def others(setting: Setting, stack: ExitStack) -> Iterable[Side | Absent]:
    """An interpreter that does nothing, and pymavlink's messages."""
    runs = {
        "an interpreter that does nothing": command("-c", "pass"),
        "an interpreter that imports asyncio": command("-c", "import asyncio"),
    }
    name = "import pymavlink's common messages beyond asyncio"
    if peers.dialect() is None:
        yield Absent(name, peers.MISSING)
    else:
        runs[name] = importing("import pymavlink.dialects.v20.common")
    yield from warm(setting, runs)


PROGRAM = Program(
    name="imports",
    rows=(
        Row("import of m100link beyond asyncio", times(PACKAGE, 1e3), at_most(20, 12), "ms"),
        Row("the same with connect and Setpoint", times(NAMES, 1e3), at_most(20, 12), "ms"),
        Row("import of m100link.wire alone", times(WIRE, 1e3), at_most(8, 5), "ms"),
        Row("m100link --help, CPU", times(HELP, 1.0), at_most(0.2), "s"),
        Row("m100link decode of one frame, CPU", times(DECODE, 1.0), at_most(0.15), "s"),
    ),
    ours=ours,
    others=others,
)

if __name__ == "__main__":
    main(PROGRAM)
