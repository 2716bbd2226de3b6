"""Numbers that modules name (times, sizes, speeds), stated a second time in ``tests/limits.toml``.

Many tests take a limit from the module that they test, and hold whatever it says. So each number
that a module of these rooms gives a name in capitals stands in that table, too: who changes one
does so twice, and a reader of the change sees it. Behaviour at a limit is a test of its module.

``python -m tests.limits`` prints what the table lacks, for a reader to agree with.
"""

from __future__ import annotations

import ast
import importlib
import sys
import tomllib
from collections.abc import Iterator
from functools import cache
from pathlib import Path

from tests.test_house import PACKAGE, name_of, tree

__all__ = ["differences"]

ROOMS = ("apps/agent", "apps/bus", "apps/cli", "apps/doctor", "apps/station", "flight", "missions")


@cache
def agreed() -> dict[str, dict[str, object]]:
    """The table: module below the package, name, number."""
    return tomllib.loads(Path(__file__).with_name("limits.toml").read_text(encoding="utf-8"))


def named(module: Path) -> Iterator[tuple[str, object]]:
    """Each number, and each row of numbers, that the module names; rows as lists."""
    loaded = importlib.import_module(name_of(module))
    for node in tree(module).body:
        if not isinstance(node, ast.Assign | ast.AnnAssign) or node.value is None:
            continue
        for target in node.targets if isinstance(node, ast.Assign) else [node.target]:
            if isinstance(target, ast.Name) and target.id.isupper():
                number = as_list(getattr(loaded, target.id))
                if number is not None:
                    yield target.id, number


def as_list(value: object) -> object:
    """A number, or rows of numbers as TOML has them; None for anything else."""
    if type(value) in (int, float):
        return value
    if type(value) is tuple and value:
        parts = [as_list(part) for part in value]
        return None if None in parts else parts
    return None


def differences(room: str) -> list[str]:
    """Each number of a room that the table does not have, or has otherwise; and rows of none."""
    seen: dict[str, dict[str, object]] = {}
    for path in sorted((PACKAGE / room).rglob("*.py")):
        if found := dict(named(path)):
            seen[name_of(path).removeprefix("m100link.")] = found
    stated = {name: rows for name, rows in agreed().items() if is_of(name, room)}
    pairs = {
        (module, name) for table in (seen, stated) for module in table for name in table[module]
    }
    return [
        f"{module}.{name}: {now!r}, agreed {then!r}"
        for module, name in sorted(pairs)
        if (now := seen.get(module, {}).get(name)) != (then := stated.get(module, {}).get(name))
        or type(now) is not type(then)
    ]


def is_of(module: str, room: str) -> bool:
    return f"{module}.".startswith(f"{room.replace('/', '.')}.")


if __name__ == "__main__":
    for each in ROOMS:
        sys.stdout.write("".join(f"{line}\n" for line in differences(each)))
