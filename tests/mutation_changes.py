"""What mutation testing changes: places in the code, and what else could stand there."""

from __future__ import annotations

import ast
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

from cosmic_ray.ast import ast_nodes, get_ast
from cosmic_ray.mutating import mutate_code
from cosmic_ray.operators.operator import Example, Operator
from cosmic_ray.plugins import get_operator, operator_names

if TYPE_CHECKING:
    from cosmic_ray.ast import Node

__all__ = ["Change", "changes_of"]

ROOT = Path(__file__).parent.parent

COMPARISONS = {
    "Eq": ("NotEq",),
    "NotEq": ("Eq",),
    "Lt": ("LtE", "GtE"),
    "LtE": ("Lt", "Gt"),
    "Gt": ("GtE", "LtE"),
    "GtE": ("Gt", "Lt"),
    "Is": ("IsNot",),
    "IsNot": ("Is",),
}
"""Its limit and its opposite. The other ones make noise: members of an enum are one object each, so
``==`` says what ``is`` says, and where a value cannot pass another ``!=`` says what ``<`` says."""

ARITHMETIC = {
    "Add": "Sub",
    "Sub": "Add",
    "Mul": "Div",
    "Div": "Mul",
    "FloorDiv": "Mul",
    "Mod": "Mul",
    "Pow": "Mul",
    "LShift": "RShift",
    "RShift": "LShift",
    "BitAnd": "BitOr",
    "BitOr": "BitAnd",
    "BitXor": "BitAnd",
}
"""One of the dozen that each can become tells enough."""

UNARY = ("Delete_Not", "Delete_USub", "Delete_Invert")

OTHERS = (
    "AddNot",
    "ExceptionReplacer",
    "NumberReplacer",
    "RemoveDecorator",
    "ReplaceAndWithOr",
    "ReplaceBreakWithContinue",
    "ReplaceContinueWithBreak",
    "ReplaceFalseWithTrue",
    "ReplaceOrWithAnd",
    "ReplaceTrueWithFalse",
    "ZeroIterationForLoop",
)


class RemoveStatement(Operator):
    """A call, a raise, or an assignment to an attribute outside ``__init__`` is left out.

    cosmic-ray has nothing like it, and what is forgotten is the most usual mistake. Lines of the
    log are no behaviour.
    """

    def mutation_positions(self, node: Node) -> Iterator[tuple[tuple[int, int], tuple[int, int]]]:
        if node.type != "simple_stmt":
            return
        statement = node.children[0]
        code = statement.get_code(include_prefix=False)  # without the comment before it
        is_call = statement.type in ("atom_expr", "power") and not code.startswith("_logger.")
        is_kept = statement.type == "expr_stmt" and code.startswith("self.")
        if is_call or is_kept or statement.type == "raise_stmt":
            yield statement.start_pos, statement.end_pos

    def mutate(self, node: Node, index: int) -> Node:
        node.children[0] = get_ast(node.children[0].get_first_leaf().prefix + "pass")
        return node

    @classmethod
    def examples(cls) -> Iterable[Example]:
        return (Example("self.stop()\n", "pass\n"),)


def operators() -> dict[str, Operator]:
    """What changes code, by name."""
    wanted = {f"ReplaceComparisonOperator_{a}_{b}" for a in COMPARISONS for b in COMPARISONS[a]}
    wanted |= {f"ReplaceBinaryOperator_{a}_{b}" for a, b in ARITHMETIC.items()}
    wanted |= {f"ReplaceUnaryOperator_{name}" for name in UNARY} | set(OTHERS)
    theirs = {name.removeprefix("core/"): name for name in operator_names()}
    found = {name: get_operator(theirs[name])() for name in sorted(wanted)}
    return {**found, "RemoveStatement": RemoveStatement()}


OPERATORS = operators()


@cache
def text_of(module: str) -> str:
    """Source of a module, which outlives an edit while the session runs."""
    return (ROOT / module).read_text(encoding="utf-8")


@cache
def functions(module: str) -> list[tuple[range, str]]:
    """Lines and name of each function, the shortest first."""
    found = [
        (range(node.lineno, (node.end_lineno or 0) + 1), node.name)
        for node in ast.walk(ast.parse(text_of(module)))
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)
    ]
    return sorted(found, key=lambda function: len(function[0]))


@dataclass(frozen=True, slots=True)
class Change:
    """One place, said differently."""

    module: str
    operator: str
    occurrence: int
    line: int

    @property
    def source(self) -> str:
        """The line of the change, which outlives its number."""
        return text_of(self.module).splitlines()[self.line - 1].strip()

    @property
    def function(self) -> str:
        """Name of the innermost function around it, "" outside."""
        return next((name for lines, name in functions(self.module) if self.line in lines), "")

    def text(self) -> str:
        """The module with the change."""
        changed = mutate_code(text_of(self.module), OPERATORS[self.operator], self.occurrence)
        assert changed is not None, self
        return changed

    def __str__(self) -> str:
        return f"{self.module}:{self.line}: {self.operator}#{self.occurrence}: {self.source}"


def meaningless(module: str) -> list[tuple[tuple[int, int], tuple[int, int]]]:
    """Spans where a change cannot mean anything to a test.

    Annotations, which nobody evaluates, and ``if TYPE_CHECKING``; arguments of the log.
    """
    spans = []
    for node in ast.walk(ast.parse(text_of(module))):
        found = [getattr(node, name, None) for name in ("annotation", "returns")]
        if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING":
            found.append(node.test)
        if isinstance(node, ast.Call) and ast.unparse(node.func).startswith("_logger."):
            found.append(node)
        for part in found:
            if isinstance(part, ast.expr):
                start = (part.lineno, part.col_offset)
                spans.append((start, (part.end_lineno or 0, part.end_col_offset or 0)))
    return spans


def changes_of(module: str) -> list[Change]:
    """Every change to a module that is worth a try, from its first line to its last."""
    skipped, lines = meaningless(module), text_of(module).splitlines()
    constructors = [
        range(node.lineno, (node.end_lineno or 0) + 1)
        for node in ast.walk(ast.parse(text_of(module)))
        if isinstance(node, ast.FunctionDef) and node.name == "__init__"
    ]
    nodes = list(ast_nodes(get_ast(text_of(module))))
    found = []
    for name, operator in OPERATORS.items():
        places = [place for node in nodes for place in operator.mutation_positions(node)]
        for occurrence, (start, end) in enumerate(places):
            code = lines[start[0] - 1][start[1] :]
            is_marker = code.startswith("*,")  # of keyword arguments
            # cosmic-ray breaks on an exception with a dot in its name.
            is_dotted = name == "ExceptionReplacer" and "." in code[: end[1] - start[1]]
            if is_marker or is_dotted or any(begin <= start < until for begin, until in skipped):
                continue
            # Without an attribute that its constructor sets, a class fails in every test.
            is_made = name == "RemoveStatement" and any(start[0] in made for made in constructors)
            if not is_made:
                found.append(Change(module, name, occurrence, start[0]))
    return sorted(found, key=lambda change: (change.line, change.operator, change.occurrence))


def statement(change: Change) -> range:
    """Lines of the statement that is changed; of a compound one, those before its body."""
    best = range(change.line, change.line + 1)
    for node in ast.walk(ast.parse(text_of(change.module))):
        if isinstance(node, ast.stmt):
            body = getattr(node, "body", None)
            end = body[0].lineno if body else (node.end_lineno or node.lineno) + 1
            if node.lineno <= change.line < end:
                best = range(node.lineno, end)
    return best
