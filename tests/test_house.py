"""What holds the whole together: sizes, rooms, arrows, and where the test of a module stands."""

from __future__ import annotations

import ast
import gc
import re
import tomllib
from collections import defaultdict
from collections.abc import Iterator, Mapping
from functools import cache
from pathlib import Path
from typing import NamedTuple

import pytest

from tests.speeds import CLOCK

ROOT = Path(__file__).parent.parent
PACKAGE = ROOT / "m100link"

# A longer one asks whether it is still one subject. At 500 the limit cut single subjects in two.
LINES_PER_FILE = 700
LINES_PER_FUNCTION = 60  # its docstring not counted
HOUSE = ROOT / "docs/explanation/house.md"


class Maximum(NamedTuple):
    """A row of the page's table."""

    most: int
    least: int  # what it once was
    why: str  # it is more than that


def rows(page: str) -> dict[str, Maximum]:
    found = re.findall(r"^\| ([a-z ]+) \| ([\d,]+) \| ([\d,]+) \|(.*)\|$", page, re.M)

    def number(text: str) -> int:
        return int(text.replace(",", ""))

    return {
        name: Maximum(number(most), number(least), why.strip()) for name, most, least, why in found
    }


@cache
def maxima() -> dict[str, Maximum]:
    """The most that there may be of each thing: the page says so, with the reason for a rise."""
    return rows(HOUSE.read_text(encoding="utf-8"))


def unexplained(table: Mapping[str, Maximum]) -> list[str]:
    """Rows whose numbers say something else than their last cell."""
    words = 3  # "more files" says nothing
    found = [name for name, one in table.items() if one.most < one.least]
    return found + [
        name
        for name, one in table.items()
        if (one.most > one.least and len(one.why.split()) < words)
        or (one.most == one.least and one.why)
    ]


def test_each_rise_has_its_reason() -> None:
    assert len(maxima()) == 7
    assert unexplained(maxima()) == [], f"say why in its row, or lower it: {HOUSE}"


def test_a_rise_without_a_reason_is_named() -> None:
    page = (
        "| files | 319 | 318 | |\n| rooms | 15 | 15 | |\n| lines | 9,010 | 9,000 | a new front |\n"
    )
    assert unexplained(rows(page)) == ["files"]
    assert unexplained(rows("| files | 317 | 318 | |")) == ["files"]


def few(what: str, counted: int, more: str = "") -> None:
    """Fail when there is more of it than the page allows, or much less than it still allows."""
    most = maxima()[what].most
    where = f"the row `{what}` of {HOUSE}"
    assert counted <= most, f"{counted} {what}, {where} allows {most}, or has a reason {more}"
    assert counted >= most * 0.97 - 2, f"{counted} {what}: lower the {most} in {where}"


@cache
def tree(path: Path) -> ast.Module:
    text = path.read_text(encoding="utf-8")
    gc.disable()  # it would look through all that was parsed before, again and again
    try:
        with CLOCK.left_out():  # the first test that reads a file parses it for all
            return ast.parse(text)
    finally:
        gc.freeze()
        gc.enable()


def statements(program: ast.AST) -> Iterator[ast.stmt]:
    """The statements of a tree at any depth: a tenth of its nodes, which are most of the time."""
    for name in ("body", "handlers", "orelse", "finalbody", "cases"):
        for inner in getattr(program, name, ()):
            if isinstance(inner, ast.stmt):
                yield inner
            yield from statements(inner)


def programs(*folders: str) -> list[Path]:
    return sorted(path for folder in folders for path in (ROOT / folder).rglob("*.py"))


def name_of(path: Path) -> str:
    """The dotted name of a module."""
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


MODULES = {name_of(path): path for path in programs("m100link")}


# -- sizes ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("folder", ["m100link", "benchmarks", "examples", "docs/_ext"])
def test_no_file_is_too_long_to_be_read_in_one_go(folder: str) -> None:
    counted = {
        str(path.relative_to(ROOT)): len(path.read_text(encoding="utf-8").splitlines())
        for path in programs(folder)
    }
    assert counted
    assert {path: lines for path, lines in counted.items() if lines > LINES_PER_FILE} == {}


def length(function: ast.FunctionDef | ast.AsyncFunctionDef) -> int:
    """Lines of a function without its docstring."""
    assert function.end_lineno is not None
    lines = function.end_lineno - function.lineno + 1
    if ast.get_docstring(function) is not None:
        text = function.body[0]
        assert text.end_lineno is not None
        lines -= text.end_lineno - text.lineno + 1
    return lines


def test_no_function_is_too_long_to_be_seen_at_once() -> None:
    too_long = {
        f"{path.relative_to(ROOT)}:{node.name}": length(node)
        for path in programs("m100link", "benchmarks", "examples", "docs/_ext", "tests")
        for node in statements(tree(path))
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)
        and length(node) > LINES_PER_FUNCTION
    }
    assert too_long == {}


# -- rooms and arrows -----------------------------------------------------------------------------


def is_for_annotations(node: ast.AST) -> bool:
    return isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING"


@cache
def imports(module: str, *, for_annotations: bool = False) -> frozenset[str]:
    """The modules of the package that a module imports when it runs, or names at all."""
    return frozenset(imported(tree(MODULES[module]), for_annotations=for_annotations))


def imported(program: ast.Module, *, for_annotations: bool) -> Iterator[str]:
    guards = [node for node in statements(program) if is_for_annotations(node)]
    skipped = {inner for node in guards for inner in statements(node)}
    for node in statements(program):
        if node in skipped and not for_annotations:
            continue
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names if alias.name in MODULES)
        elif isinstance(node, ast.ImportFrom) and node.module in MODULES:
            inner = {f"{node.module}.{alias.name}" for alias in node.names}
            yield from inner & MODULES.keys() or {node.module}


def arrows(*, between_rooms: bool, for_annotations: bool = False) -> dict[str, set[str]]:
    """Who imports whom, by module or by room: a file or folder right under the package."""
    found: dict[str, set[str]] = defaultdict(set)
    for module in MODULES:
        for target in imports(module, for_annotations=for_annotations):
            ends = [module, target]
            if between_rooms:
                ends = [name.split(".")[1] if "." in name else "" for name in ends]
            if "" not in ends and "__main__" not in ends and ends[0] != ends[1]:
                found[ends[0]].add(ends[1])
    return found


def reach(start: str, graph: dict[str, set[str]]) -> set[str]:
    """Whatever can be reached by arrows."""
    found: set[str] = set()
    waiting = [start]
    while waiting:
        new = graph.get(waiting.pop(), set()) - found
        found |= new
        waiting += new
    return found


@pytest.mark.parametrize("between_rooms", [True, False], ids=["rooms", "modules"])
def test_there_is_no_circle(between_rooms: bool) -> None:
    graph = arrows(between_rooms=between_rooms, for_annotations=True)
    # What a package hands on is not its own.
    graph = {
        name: {target for target in targets if between_rooms or not is_package(target)}
        for name, targets in graph.items()
        if between_rooms or not is_package(name)
    }
    assert [name for name in graph if name in reach(name, graph)] == []


def is_package(module: str) -> bool:
    return MODULES[module].name == "__init__.py"


def test_the_rooms_their_floors_and_their_arrows_stay_few() -> None:
    graph = arrows(between_rooms=True)

    @cache
    def floor(room: str) -> int:
        return 1 + max((floor(below) for below in graph.get(room, ())), default=0)

    rooms = set(graph).union(*graph.values())
    few("rooms", len(rooms))
    few("floors", max(map(floor, rooms)))
    few("arrows between rooms", sum(map(len, graph.values())))


def test_files_lines_and_contracts_stay_few() -> None:
    written = programs("m100link")
    few("files", len(written))
    few("lines", sum(len(path.read_text(encoding="utf-8").splitlines()) for path in written))
    text = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    contracts = text[text.index("[tool.importlinter]") :].split("\n[tool.")[0]
    few("lines of import contracts", len(contracts.splitlines()))


def test_the_manuals_house_names_places_that_exist() -> None:
    page = (ROOT / "docs/explanation/house.md").read_text(encoding="utf-8")
    named = set(re.findall(r"`((?:m100link|tests|benchmarks)/[\w/.]+)`", page))
    assert len(named) > 20
    assert {place for place in named if not (ROOT / place).exists()} == set()


# -- tests ----------------------------------------------------------------------------------------


def mirrored(module: Path) -> Path:
    place = module.relative_to(PACKAGE)
    return ROOT / "tests" / place.parent / f"test_{place.name}"


def test_the_test_of_a_module_is_found_where_its_name_says() -> None:
    elsewhere = {
        str(path.relative_to(PACKAGE))
        for path in programs("m100link")
        if path.name not in ("__init__.py", "__main__.py") and not mirrored(path).exists()
    }
    few("modules without a test file of their name", len(elsewhere), f"of these: {elsewhere}")


def test_a_test_that_traces_puts_back_what_traced_before() -> None:
    """Without that nothing behind it in its process is in the figures of coverage."""
    away = re.compile(r"settrace\(None\)")
    found = [path.name for path in programs("tests") if away.search(path.read_text("utf-8"))]
    assert found == []


def test_a_test_that_waits_for_a_process_has_patience() -> None:
    """A number of seconds is the machine's: tests/waiting.py says how long is never."""
    number = r"(?:timeout=)?[0-9.]+[,)]"
    waits = re.compile(
        rf"(?:communicate|process\.wait)\({number}|capture_output=True[^()]*timeout=[0-9.]+[,)]"
    )
    found = [path.name for path in programs("tests") if waits.search(path.read_text("utf-8"))]
    assert found == []


def holds_of_anything(test: ast.expr) -> bool:
    """A count of at least 0, a value that equals itself, and what is true as it stands."""
    if isinstance(test, ast.Compare):
        left, right = test.left, test.comparators[0]
        counts = isinstance(left, ast.Call) and ast.unparse(left.func) in ("len", "sum")
        if isinstance(test.ops[0], ast.GtE) and counts and ast.unparse(right) == "0":
            return True
        if type(left) is not type(right) or ast.dump(left) != ast.dump(right):
            return False
        return not any(isinstance(one, ast.Call | ast.Await) for one in ast.walk(left))
    return isinstance(test, ast.GeneratorExp | ast.Lambda | ast.JoinedStr | ast.Tuple) or (
        isinstance(test, ast.Constant) and bool(test.value)
    )


@pytest.mark.parametrize(
    ("code", "holds"),
    [
        *(("len(a) >= 0", True), ("sum(1 for _ in a) >= 0", True), ("a.b == a.b", True)),
        *(("(a, 'text')", True), ("(b for b in a)", True), ("f'{a}'", True), ("1", True)),
        *(("len(a) >= 1", False), ("a.b >= 0", False), ("a(1) == a(1)", False), ("a", False)),
    ],
)
def test_what_holds_of_anything_is_recognised(code: str, holds: bool) -> None:
    assert holds_of_anything(ast.parse(code, mode="eval").body) is holds


def test_no_assertion_holds_of_anything() -> None:
    found = [
        f"{path.relative_to(ROOT)}:{node.lineno}"
        for path in programs("tests")
        for node in statements(tree(path))
        if isinstance(node, ast.Assert) and holds_of_anything(node.test)
    ]
    assert found == []


def test_each_explained_mutation_is_of_a_line_that_is_there() -> None:
    """A change of such a line is to check whether the explanation is still right."""
    table = tomllib.loads((ROOT / "tests/mutation_survivors.toml").read_text("utf-8"))
    found = [
        f"{entry['module']}: {line}"
        for entries in table.values()
        for entry in entries
        for line in entry["lines"]
        if line not in map(str.strip, (ROOT / entry["module"]).read_text("utf-8").splitlines())
    ]
    assert found == []
