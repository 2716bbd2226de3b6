"""Damage drawn at random to what is stored: is every loss reported?

::

    python -m tests.faults.damaged_files                      # 10,000 of each kind
    python -m tests.faults.damaged_files --files 500 log      # of one

Of a file that was written as ever a copy is damaged as disks do: bits turn over, runs are zeroed or
filled with junk, sectors change places, the end is cut off. The judge knows what the file held, and
asks what a reader says of the copy. It may refuse it with a typed error. What it passes on must be
what was written; what it does not pass on must be reported.
"""

from __future__ import annotations

import argparse
import random
import sys
import tempfile
from collections import Counter
from collections.abc import Callable
from pathlib import Path

SEED = 20261123
SECTOR = 512

Judge = Callable[[bytes, bytes], str]
"""Takes what was written and the damaged copy; says what the reader did not tell, or nothing."""


def damaged(whole: bytes, chance: random.Random) -> tuple[str, bytes]:
    """A copy with one kind of damage, and its name; now and then it is the same."""
    data = bytearray(whole)
    kind = chance.choice(("bit", "bits", "zeroed", "junk", "sector", "swapped", "cut", "tail"))
    at = chance.randrange(len(data))
    size = chance.randrange(1, 2 * SECTOR)
    if kind in ("bit", "bits"):
        for _ in range(1 if kind == "bit" else chance.randrange(2, 9)):
            data[chance.randrange(len(data))] ^= 1 << chance.randrange(8)
    elif kind == "zeroed":
        data[at : at + size] = bytes(len(data[at : at + size]))
    elif kind == "junk":
        data[at : at + size] = chance.randbytes(len(data[at : at + size]))
    elif kind == "sector":
        at -= at % SECTOR
        data[at : at + SECTOR] = bytes(len(data[at : at + SECTOR]))
    elif kind == "swapped":
        sectors = len(data) // SECTOR
        if sectors > 1:
            one, other = (number * SECTOR for number in chance.sample(range(sectors), 2))
            first, second = data[one : one + SECTOR], data[other : other + SECTOR]
            data[one : one + SECTOR], data[other : other + SECTOR] = second, first
    elif kind == "cut":
        del data[at:]
    else:  # as file systems leave what they had no time to write
        data[at:] = bytes(len(data) - at)
    return kind, bytes(data)


def run(name: str, wholes: list[bytes], judge: Judge, files: int, seed: int) -> Counter[str]:
    """Damage and judge; returns how many there were of each kind, and of those untold."""
    chance = random.Random(f"{name} {seed}")
    found: Counter[str] = Counter()
    for number in range(files):
        whole = wholes[number % len(wholes)]
        kind, copy = damaged(whole, chance)
        untold = judge(whole, copy)
        found[kind] += 1
        if untold:
            found["untold"] += 1
            print(f"{name} {number} ({kind}, seed {seed}): {untold}", flush=True)  # noqa: T201
    return found


def main(arguments: list[str] | None = None) -> int:
    """Draw, and say what was not reported."""
    from tests.faults.damaged_kinds import KINDS

    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("kinds", nargs="*", default=[])
    parser.add_argument("--files", type=int, default=10_000)
    parser.add_argument("--seed", type=int, default=SEED)
    asked = parser.parse_args(arguments)
    untold = 0
    for name in asked.kinds or KINDS:
        with tempfile.TemporaryDirectory() as folder:
            wholes, judge = KINDS[name](Path(folder))
            found = run(name, wholes, judge, asked.files, asked.seed)
        untold += found["untold"]
        print(f"{name}: {asked.files} files, {dict(found)}", flush=True)  # noqa: T201 - a program
    return 1 if untold else 0


if __name__ == "__main__":
    sys.exit(main())
