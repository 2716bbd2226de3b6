"""Results of the benchmarks as JSON and as one table."""

from __future__ import annotations

import importlib.util
import os
import platform
import subprocess
import time
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from benchmarks.compiled import compiler
from benchmarks.rows import Goal, Quartiles, Row, quartiles

SCHEMA = 1
"""Version of the JSON; raised when a reader must change."""

LOAD = os.getloadavg()[0]
"""Processes that wanted a CPU before there was anything to measure."""

UNITS = (("s", 1.0), ("ms", 1e3), ("µs", 1e6), ("ns", 1e9))


def processor() -> str:
    """The model of the CPU, as it names itself."""
    try:
        for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    except OSError:
        pass
    return platform.processor() or platform.machine()


def commit(tree: Path) -> str | None:
    """Which state of the project a checkout has."""
    command = ["git", "-C", str(tree), "describe", "--always", "--dirty"]
    try:
        asked = subprocess.run(command, capture_output=True, text=True, check=True)
    except (OSError, subprocess.CalledProcessError):
        return None
    return asked.stdout.strip()


def environment(before: Path | None = None) -> dict[str, Any]:
    """What the figures depend on, and nothing that names the machine.

    Args:
        before: The other tree.
    """
    found = compiler()
    version = ""
    if found is not None:
        command = [found, "-dumpfullversion"]
        version = subprocess.run(command, capture_output=True, text=True, check=False).stdout
    return {
        "date": time.strftime("%Y-%m-%d", time.gmtime()),
        "cpu": processor(),
        "cores": os.cpu_count(),
        "system": f"{platform.system()} {platform.release()}",
        "python": f"{platform.python_implementation()} {platform.python_version()}",
        "compiler": f"{Path(found).name} {version.strip()}".strip() if found else None,
        "pymavlink": importlib.util.find_spec("pymavlink") is not None,
        "fastcrc": importlib.util.find_spec("fastcrc") is not None,
        "commit": commit(Path(__file__).parent),
        "before": None if before is None else commit(before) or "of another tree",
        "load": round(LOAD, 1),
    }


def three(found: Quartiles) -> dict[str, float]:
    """Median and quartiles with the digits that mean something."""
    return {name: float(f"{value:.4g}") for name, value in found._asdict().items()}


def row_result(
    program: str, row: Row, figures: list[float], before: list[float] | None, missing: str | None
) -> dict[str, Any]:
    """One line of the table.

    Args:
        program: Whose row it is.
        row: What was to be measured.
        figures: Of each round that has one.
        before: The same for the other tree; None without one.
        missing: Why rounds have no figure.
    """
    goal = row.goal
    now = quartiles(figures) if figures else None
    return {
        "program": program,
        "name": row.name,
        "unit": row.unit,
        "must": goal.must,
        "aim": goal.aim,
        "is_floor": goal.is_floor,
        "rounds": len(figures),
        "now": three(now) if now else None,
        "before": three(quartiles(before)) if before else None,
        "verdict": goal.verdict(now.median) if now else "",
        "missing": missing,
    }


def result(
    rows: Iterable[dict[str, Any]],
    costs: Iterable[dict[str, Any]],
    *,
    before: Path | None = None,
) -> dict[str, Any]:
    """The whole, ready for JSON; ``before`` is the other tree."""
    return {
        "schema": SCHEMA,
        "environment": environment(before),
        "rows": list(rows),
        "costs": list(costs),
    }


def cost_result(
    program: str, name: str, unit: str, values: list[float], before: list[float] | None
) -> dict[str, Any]:
    """What one side cost over the rounds; seconds are told in the unit that fits them."""
    middle = quartiles(values).median
    factor = 1.0
    if unit == "s":
        fits = (one for one in UNITS if middle * one[1] >= 1)
        unit, factor = next(fits, UNITS[-1]) if middle else (unit, factor)
    parts = [[value * factor for value in one] for one in (values, before or [])]
    return {
        "program": program,
        "name": name,
        "unit": unit,
        "now": three(quartiles(parts[0])),
        "before": three(quartiles(parts[1])) if before else None,
    }


# -- for people ------------------------------------------------------------------------------------


def number(value: float) -> str:
    """Three digits that mean something."""
    if value == 0 or abs(value) >= 100:
        return f"{value:.0f}"
    return f"{value:.2f}" if abs(value) < 10 else f"{value:.1f}"


def goal_text(row: dict[str, Any]) -> tuple[str, str]:
    """Must and aim as the table shows them."""
    sign = "≥" if row["is_floor"] else "≤"
    goal = Goal(row["must"], row["aim"], row["is_floor"])
    return (
        "" if goal.must is None else f"{sign} {goal.must:g}",
        "" if goal.aim is None else f"{goal.aim:g}",
    )


def spread(found: dict[str, float] | None) -> tuple[str, str]:
    """Median, and the quartiles beside it."""
    if found is None:
        return "", ""
    return number(found["median"]), f"{number(found['low'])} to {number(found['high'])}"


def cells(row: dict[str, Any]) -> tuple[str, ...]:
    """A row of the table: name, must, aim, before, its quartiles, now, its quartiles, verdict."""
    name = f"{row['name']}, {row['unit']}" if row["unit"] else row["name"]
    verdict = row["verdict"]
    if row["now"] is None:
        verdict = f"not measured: {row['missing']}"
    return (name, *goal_text(row), *spread(row["before"]), *spread(row["now"]), verdict)


HEAD = ("", "must", "aim", "before", "quartiles", "now", "quartiles", "")


def table(found: dict[str, Any]) -> str:
    """Machine, costs and rows as text of fixed columns."""
    about = ", ".join(f"{name} {value}" for name, value in found["environment"].items())
    costs: list[tuple[str, ...]] = [("", "before", "", "now", "quartiles")]
    for cost in found["costs"]:
        name = ", ".join(filter(None, (cost["name"], cost["unit"])))
        texts = [*spread(cost["before"]), *spread(cost["now"])]
        costs.append((f"{cost['program']}: {name}", *texts))
    has_before = any(row["before"] for row in found["rows"])
    lines = [(*HEAD[:3], *HEAD[5:]), *(drop_before(cells(row)) for row in found["rows"])]
    if has_before:
        lines = [HEAD, *map(cells, found["rows"])]
    return "\n".join([about, "", *columns(costs), "", *columns(lines)])


def drop_before(row: tuple[str, ...]) -> tuple[str, ...]:
    """A row without the columns of the other tree."""
    return (*row[:3], *row[5:])


def columns(lines: list[tuple[str, ...]]) -> list[str]:
    """Lines of text with the first and last column to the left and the others to the right."""
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    made = []
    for line in lines:
        name, *middle, last = (text.rjust(width) for text, width in zip(line, widths, strict=True))
        made.append("  ".join([name.strip().ljust(widths[0]), *middle, last.strip()]).rstrip())
    return made
