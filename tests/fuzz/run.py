"""Mutated inputs for everything that reads bytes of others: `nox -s fuzz`.

Seeds are golden vectors and files that people write; what is done to them follows from one number,
so a finding is repeated by its seed. A finding is an error that the reader does not promise, memory
that stays, or an input that costs far more CPU time than inputs of its length do.
"""

from __future__ import annotations

import argparse
import gc
import importlib.util
import os
import subprocess
import sys
import time
from contextlib import suppress
from dataclasses import dataclass
from random import Random

from tests.fuzz.mutation import changed
from tests.fuzz.targets import TARGETS, Target

__all__ = ["Finding", "Told", "execute"]

_BLOCKS_KEPT = 50_000  # what is remembered of the last 256 flag words comes and goes
_BLOCKS_PER_EXECUTION = 0.05  # a leak keeps at least one each
SLOW_S = 0.05
"""CPU time beyond which 4 kB are slow; what a collection of garbage took does not repeat."""


class Finding(Exception):
    """An input that a reader did not take as it promises."""


@dataclass
class Told:
    """What came of a target.

    Attributes:
        executions: Inputs read.
        refused: Those with an error that the reader promises.
        slowest: CPU time of the dearest input, s.
        stayed: Blocks of memory that stayed, since half of the inputs.
    """

    executions: int = 0
    refused: int = 0
    slowest: float = 0.0
    stayed: int = 0


def _cost(target: Target, data: bytes) -> float:
    """CPU time of one input, s."""
    target.ready()
    begin = time.thread_time()
    with suppress(*target.refuses):
        target.read(data)
    return time.thread_time() - begin


def execute(name: str, target: Target, executions: int, seed: int) -> Told:
    """Read that many mutated inputs.

    Raises:
        Finding: With the input.
    """
    dice, seeds, told = Random(f"{seed} {name}"), target.seeds(), Told()
    target.begin()
    for one in seeds[:: max(1, len(seeds) // max(1, executions))]:
        target.read(one)
    settled = sys.getallocatedblocks()
    for number in range(executions):
        data = changed(dice, seeds, target.tokens)
        target.ready()
        begin = time.thread_time()
        try:
            target.read(data)
        except target.refuses:
            told.refused += 1
        except Exception as error:
            raise Finding(f"{name}, seed {seed}, {number}: {error!r} for {data!r}") from error
        cost = time.thread_time() - begin
        if cost > told.slowest:
            # By itself: what the processor did for others, and garbage, come by chance.
            cost = min(cost, _cost(target, data), _cost(target, data))
            told.slowest = max(told.slowest, cost)
            if cost > SLOW_S:
                raise Finding(f"{name}, seed {seed}: {cost:.3f} s of CPU for {data!r}")
        if number == executions // 2:  # what is remembered of every kind has been by then
            gc.collect()
            settled = sys.getallocatedblocks()
    gc.collect()
    told.executions = executions
    target.begin()
    told.stayed = sys.getallocatedblocks() - settled
    if told.stayed > _BLOCKS_KEPT + _BLOCKS_PER_EXECUTION * executions:
        raise Finding(f"{name}, seed {seed}: {told.stayed} blocks of memory stayed")
    return told


def _guide(names: list[str], seconds: int, seed: int) -> int:
    """Let atheris look for inputs, a process for each target; 1 when one ended with a finding."""
    if importlib.util.find_spec("atheris") is None:
        sys.stdout.write("atheris is not installed: pip install atheris (Python 3.11 to 3.13)\n")
        return 1
    status = 0
    for name in names:
        sys.stdout.write(f"{name}:\n")
        sys.stdout.flush()
        words = (
            sys.executable,
            "-m",
            "tests.fuzz.guided",
            name,
            str(seconds),
            str(seed & 0x7FFFFFFF),
        )
        done = subprocess.run(words, check=False, capture_output=True, text=True)
        said, lines = done.stdout.splitlines(), done.stderr.splitlines()
        shown = [one for one in lines if one.startswith("stat::") or " DONE " in one]
        # The engine prints Python's traceback of a finding to its output, libFuzzer the bytes of it
        # to the other one; both stand at the end.
        report = [*said[-60:], *lines[-60:]] if done.returncode else shown
        sys.stdout.write("\n".join(report) + "\n")
        status |= done.returncode != 0
    return status


def main() -> int:
    """Run all targets, or some; 1 when there was a finding."""
    parser = argparse.ArgumentParser(prog="nox -s fuzz --", description=__doc__)
    parser.add_argument("targets", nargs="*", metavar="TARGET", help=", ".join(TARGETS))
    parser.add_argument("--executions", type=int, default=10_000_000, help="of all together")
    parser.add_argument("--seed", type=int, default=int.from_bytes(os.urandom(4)))
    parser.add_argument("--engine", choices=("own", "atheris"), default="own")
    parser.add_argument("--seconds", type=int, default=60, help="of atheris, for each target")
    options = parser.parse_args()
    unknown = [name for name in options.targets if name not in TARGETS]
    if unknown:
        parser.error(f"there is no target {unknown[0]!r}: {', '.join(TARGETS)}")
    sys.stdout.write(f"seed {options.seed}\n")
    chosen = options.targets or list(TARGETS)
    if options.engine == "atheris":
        return _guide(chosen, options.seconds, options.seed)
    shares = sum(TARGETS[name].share for name in chosen)
    status = 0
    for name in chosen:
        target = TARGETS[name]
        begin = time.process_time()
        try:
            told = execute(
                name, target, max(1, options.executions * target.share // shares), options.seed
            )
        except Finding as finding:
            sys.stdout.write(f"{finding}\n")
            status = 1
            continue
        cost = (time.process_time() - begin) / told.executions
        sys.stdout.write(
            f"{name:18} {told.executions:9,} inputs, "
            f"{told.refused / told.executions:4.0%} refused, {cost * 1e6:6.0f} µs each, "
            f"dearest {told.slowest * 1e3:6.2f} ms, {told.stayed:5} blocks stayed\n"
        )
        sys.stdout.flush()
    return status


if __name__ == "__main__":
    sys.exit(main())
