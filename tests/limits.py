"""Numbers of modules (times, sizes, speeds), stated a second time in ``tests/limits.toml``.

Many tests take a limit from the module that they test, and hold whatever it says. So each number of
the package stands in that table, too, that a module gives a name in capitals, with rows and short
tables of words, and what a field or an argument has by default, words and switches, too, but
nothing that is 0, off or empty. A change of one is a change of two files, and a reader sees it.
Behaviour at a limit is a test of its module.

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

ROOMS = (
    *("aircraft", "apps/agent", "apps/bus", "apps/cli", "apps/doctor", "apps/fleet"),
    *("apps/mavlink", "apps/ros2", "apps/station", "errors", "flight", "geodesy", "link", "log"),
    *("missions", "protocol", "session", "sim", "sync", "telemetry", "wire"),
)

LONGEST = 300
"""Characters of a table: a longer one is a page of texts."""

Defaults = Iterator[tuple[str, ast.expr | None]]


@cache
def agreed() -> dict[str, dict[str, object]]:
    """The table: module below the package, name, number."""
    return tomllib.loads(Path(__file__).with_name("limits.toml").read_text(encoding="utf-8"))


def numbers(module: Path) -> dict[str, object]:
    """Each number that the module names or has by default; rows of numbers as lists."""
    loaded, program = importlib.import_module(name_of(module)), tree(module)
    named = {name: as_list(getattr(loaded, name)) for name in capitals(program)}
    named |= dict(tables(program))
    said = {name: literal(value) for name, value in defaults(program)}
    by_default = {name: value for name, value in said.items() if value}
    return {name: value for name, value in named.items() if value is not None} | by_default


def capitals(program: ast.Module) -> Iterator[str]:
    for node in program.body:
        if isinstance(node, ast.Assign | ast.AnnAssign) and node.value is not None:
            for target in node.targets if isinstance(node, ast.Assign) else [node.target]:
                for one in target.elts if isinstance(target, ast.Tuple) else [target]:
                    if isinstance(one, ast.Name) and one.id.isupper():
                        yield one.id


def tables(program: ast.Module) -> Iterator[tuple[str, object]]:
    """Short rows of words, and tables of words and numbers, that are written out."""
    for node in program.body:
        if isinstance(node, ast.Assign | ast.AnnAssign) and isinstance(
            node.value, ast.Dict | ast.Tuple
        ):
            target = node.targets[0] if isinstance(node, ast.Assign) else node.target
            try:
                found = ast.literal_eval(node.value)
            except ValueError:  # it has names
                continue
            if found and len(str(found)) < LONGEST and isinstance(target, ast.Name):
                yield target.id, as_toml(found)


def as_toml(value: object) -> object:
    if isinstance(value, dict):
        return {str(key): as_toml(part) for key, part in value.items()}
    if isinstance(value, bytes):
        return value.hex()  # TOML has none
    return [as_toml(part) for part in value] if isinstance(value, tuple | list) else value


def defaults(program: ast.AST, within: str = "") -> Defaults:
    """Those of fields, as ``Class.field``, and of arguments, as ``function(argument)``.

    A keyword of a class line is a field of the class; its words are texts.
    """
    for node in ast.iter_child_nodes(program):
        if isinstance(node, ast.ClassDef):
            for data in node.keywords:
                if not isinstance(getattr(data.value, "value", None), str):
                    yield f"{within}{node.name}.{data.arg}", data.value
            is_enum = any("Enum" in ast.unparse(base) for base in node.bases)  # names, not limits
            for one in [] if is_enum else node.body:
                if isinstance(one, ast.Assign | ast.AnnAssign):
                    target = one.targets[0] if isinstance(one, ast.Assign) else one.target
                    yield f"{within}{node.name}.{ast.unparse(target)}", one.value
            yield from defaults(node, f"{within}{node.name}.")
        elif isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            given = node.args
            by_place = [*given.posonlyargs, *given.args][::-1]
            pairs = [*zip(by_place, given.defaults[::-1], strict=False)]
            for argument, value in [*pairs, *zip(given.kwonlyargs, given.kw_defaults, strict=True)]:
                yield f"{within}{node.name}({argument.arg})", value


def literal(value: ast.expr | None) -> object:
    """What an expression of numbers alone says, or a word; None of any other."""
    signs = (ast.Constant, ast.BinOp, ast.UnaryOp, ast.operator, ast.unaryop)
    if value is None or not all(isinstance(part, signs) for part in ast.walk(value)):
        return None
    return eval(compile(ast.Expression(value), "a default", "eval"))


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
    file = PACKAGE / f"{room}.py"
    for path in [file] if file.exists() else sorted((PACKAGE / room).rglob("*.py")):
        if found := numbers(path):
            seen[name_of(path).removeprefix("m100link.")] = found
    begin = f"{room.replace('/', '.')}."
    stated = {name: rows for name, rows in agreed().items() if f"{name}.".startswith(begin)}
    tables = (*seen.items(), *stated.items())
    pairs = {(module, name) for module, rows in tables for name in rows}
    return [
        f"{module}: {name} = {now!r}, agreed {then!r}"
        for module, name in sorted(pairs)
        if (now := seen.get(module, {}).get(name)) != (then := stated.get(module, {}).get(name))
        or type(now) is not type(then)
    ]


if __name__ == "__main__":
    for each in ROOMS:
        sys.stdout.write("".join(f"{line}\n" for line in differences(each)))
