"""What a bad line makes of reliable commands, as a table: `nox -s faults`.

Thirty tasks send commands that carry their number, on the sessions 2 to 31; the other end counts
how often it executes each and answers with that number, at once or later. Printed is what may not
be: answers of another command, commands executed twice, frames that arrived and were not read, and
sessions that are not free in the end.
"""

from __future__ import annotations

import argparse
import asyncio
import csv
import sys
from collections import Counter
from collections.abc import Iterable
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from random import Random
from typing import TextIO

from m100link.errors import AckTimeout
from m100link.link import Link
from m100link.sim import VirtualClockEventLoop
from m100link.wire import Frame
from tests.faults.ends import Line, over_memory, over_terminal
from tests.faults.wire import Faults

__all__ = ["BEYOND", "CASES", "Outcome", "run_case"]

CASES: dict[str, Faults] = {
    "a good line": Faults(),
    "5 % lost": Faults(loss=0.05),
    "20 % lost": Faults(loss=0.2),
    "40 % lost": Faults(loss=0.4),
    "bit errors of 1e-5": Faults(bit_errors=1e-5),
    "bit errors of 1e-4": Faults(bit_errors=1e-4),
    "bit errors of 1e-3": Faults(bit_errors=1e-3),
    "20 % twice": Faults(duplicates=0.2),
    "delay spikes": Faults(spikes=0.02),
    "stalls": Faults(stall_s=1.5),
    "all of it": Faults(
        loss=0.2, bit_errors=3e-4, duplicates=0.1, spikes=0.01, spike_s=0.8, stall_s=1.5
    ),
}
"""What a cable can do: bytes are lost, damaged, late or there twice, and keep their order."""

BEYOND: dict[str, Faults] = {
    "copies that overtake": Faults(
        loss=0.2, duplicates=0.2, spikes=0.2, spike_s=4.0, overtaking=True
    ),
}
"""Beyond the protocol: an aircraft remembers one number per session, so an old copy that comes
after a newer command of its session is a new command to it."""

_TASKS = 30
_TIMEOUT_S = 0.5
_LATE_ANSWERS = 0.1  # one of ten, within two time-outs
_PATIENCE_S = 20.0  # longer than any request, and than the aircraft remembers
_FLUSH = 60  # pushes that end what a damaged length swallowed
_FREE = b"free"  # no command of the table
_TERMINAL_SCALE = 0.1  # real time is dear


@dataclass(frozen=True, slots=True)
class Outcome:
    """A line of the table.

    Attributes:
        line: What is between the ends.
        case: What it does.
        commands: Commands sent.
        answered: Those whose ack came.
        unknown: Those that ran out of tries.
        repeats: Transmissions beyond the first.
        missed: Answered, and not executed exactly once.
        twice: Executed more than once, whatever was reported of them.
        crossed: Answered with the answer of another one.
        unread: Frames that arrived whole and were not read, at both ends.
        busy: Sessions that do not answer at once when the line is good again.
    """

    line: str
    case: str
    commands: int
    answered: int
    unknown: int
    repeats: int
    missed: int
    twice: int
    crossed: int
    unread: int
    busy: int

    @property
    def wrong(self) -> int:
        """How much of it no cable may do."""
        return self.missed + self.twice + self.crossed + self.unread + self.busy


class _Aircraft:
    """Executes, counts and answers."""

    def __init__(self, dice: Random, answer_within: float) -> None:
        self._loop = asyncio.get_running_loop()
        self._dice = dice
        self._within = answer_within
        self.executed: Counter[bytes] = Counter()
        self.link = Link(on_received=self._execute, first_sequence=0)

    def _execute(self, frame: Frame, now: float) -> None:
        if not frame.session:
            return
        number = frame.data[:4]
        if number != _FREE:
            self.executed[number] += 1
        if self._dice.random() < _LATE_ANSWERS:
            wait = self._dice.random() * self._within
            self._loop.call_later(wait, self.link.acknowledge, frame, number)
        else:
            self.link.acknowledge(frame, number)


async def _ask_all(
    line: Line, commands: int, dice: Random, timeout: float
) -> tuple[set[bytes], int, int]:
    """Send all commands; returns who was answered, how many were not, and how many wrongly."""
    numbers = iter(range(commands))
    answered: set[bytes] = set()
    unknown = crossed = 0

    async def ask() -> None:
        nonlocal unknown, crossed
        for value in numbers:
            number = value.to_bytes(4, "little")
            try:
                answer = await line.host.request(
                    number + dice.randbytes(dice.randrange(24)), timeout=timeout
                )
            except AckTimeout:
                unknown += 1
                continue
            crossed += answer != number
            answered.add(number)

    async with asyncio.TaskGroup() as group:
        for _ in range(_TASKS):
            group.create_task(ask())
    return answered, unknown, crossed


async def _busy_sessions(line: Line, settle: float) -> int:
    """How many of the thirty sessions are not free when everything has ended."""
    await asyncio.sleep(settle)
    asked = [
        asyncio.create_task(line.host.request(_FREE + bytes((n,)), timeout=settle, tries=1))
        for n in range(_TASKS)
    ]
    done, waiting = await asyncio.wait(asked, timeout=0.9 * settle)
    for task in waiting:
        task.cancel()
    await asyncio.gather(*asked, return_exceptions=True)
    return len(waiting) + sum(task.exception() is not None for task in done)


async def run_case(
    case: str, faults: Faults, *, commands: int, seed: int, is_terminal: bool = False
) -> Outcome:
    """Run one line of the table.

    Args:
        case: Its name.
        faults: Of both directions.
        commands: How many to send.
        seed: Of every choice.
        is_terminal: Over a pseudo-terminal in real time, where time-outs are a tenth.
    """
    dice = Random(f"{seed} {case}")
    scale = _TERMINAL_SCALE if is_terminal else 1.0
    timeout, settle = _TIMEOUT_S * scale, _PATIENCE_S * scale
    aircraft = _Aircraft(dice, 2 * timeout)
    over = over_terminal if is_terminal else over_memory
    async with over(aircraft.link, dice, faults.scaled(scale)) as line:
        answered, unknown, crossed = await _ask_all(line, commands, dice, timeout)
        repeats = line.host.statistics().repeats
        line.repair()
        busy = await _busy_sessions(line, settle)
        for _ in range(_FLUSH):
            line.host.push(bytes(20))
            line.aircraft.push(bytes(20))
            await asyncio.sleep(0.002)
        await asyncio.sleep(settle / 20)
        executed = aircraft.executed
        return Outcome(
            line="pseudo-terminal" if is_terminal else "memory",
            case=case,
            commands=commands,
            answered=len(answered),
            unknown=unknown,
            repeats=repeats,
            missed=sum(executed[number] != 1 for number in answered),
            twice=sum(count > 1 for count in executed.values()),
            crossed=crossed,
            unread=line.there.intact
            + line.back.intact
            - line.aircraft.statistics().frames_received
            - line.host.statistics().frames_received,
            busy=busy,
        )


def _print(outcomes: Iterable[Outcome], out: TextIO) -> None:
    table = csv.writer(out, lineterminator="\n")
    table.writerow(one.name for one in fields(Outcome))
    for outcome in outcomes:
        table.writerow(asdict(outcome).values())
        out.flush()


def main() -> int:
    """Run the whole table and print it; 1 when a cable did what may not be."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--commands", type=int, default=100_000, help="for each line")
    parser.add_argument("--terminal-commands", type=int, default=100_000)
    parser.add_argument("--seed", type=int, default=20151121)
    parser.add_argument("--csv", type=Path, help="write the table there, too")
    options = parser.parse_args()
    sys.stderr.write(f"seed {options.seed}\n")
    outcomes = []
    for is_terminal in (False, True):
        commands = options.terminal_commands if is_terminal else options.commands
        for case, faults in (CASES | BEYOND).items():
            factory = None if is_terminal else VirtualClockEventLoop
            with asyncio.Runner(loop_factory=factory) as runner:
                work = run_case(
                    case, faults, commands=commands, seed=options.seed, is_terminal=is_terminal
                )
                outcomes.append(runner.run(work))
            sys.stderr.write(f"{outcomes[-1]}\n")
    _print(outcomes, sys.stdout)
    if options.csv:
        with options.csv.open("w", encoding="utf-8") as out:
            _print(outcomes, out)
    return any(one.wrong for one in outcomes if one.case in CASES)


if __name__ == "__main__":
    sys.exit(main())
