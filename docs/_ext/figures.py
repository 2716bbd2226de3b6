"""The page on performance is made of one run of the benchmarks, kept as JSON beside it.

Each directive takes its figures from ``docs/explanation/performance.json``, which is what
``python -m benchmarks --json`` prints::

    ```{benchmark-machine}                when, and on what
    ```{benchmark-rows} frames            the rows of one program, held against their goals
    ```{benchmark-rows}                   of all programs
    ```{benchmark-costs} frames           what each side of that program cost
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective
from tables import TableDirective

from benchmarks.program import PROGRAMS
from benchmarks.report import SCHEMA, cells, drop_before, spread

RUN = Path(__file__).parents[1] / "explanation" / "performance.json"


def run() -> dict[str, Any]:
    """The run that the page shows."""
    found: dict[str, Any] = json.loads(RUN.read_text(encoding="utf-8"))
    if found["schema"] != SCHEMA:
        raise ValueError(f"{RUN.name} has schema {found['schema']}, this page is made for {SCHEMA}")
    return found


class Machine(SphinxDirective):
    """When the run was, and what its figures depend on."""

    def run(self) -> list[nodes.Node]:
        """One sentence."""
        self.env.note_dependency(str(RUN))
        of = run()["environment"]
        rivals = "pymavlink with fastcrc" if of["fastcrc"] else "pymavlink without fastcrc"
        text = (
            f"Measured on {of['date']}: {of['cpu']}, {of['cores']} cores, {of['system']}, "
            f"{of['python']}, {rivals if of['pymavlink'] else 'no pymavlink'}, "
            f"{of['compiler'] or 'no C compiler'}; "
            f"{of['load']} processes wanted a CPU when it began."
        )
        if of["before"]:
            text += f" The column “before” is commit {of['before']}, by turns in the same rounds."
        if "note" in of:
            text += f" {of['note']}"
        return [nodes.paragraph(text=text)]


class FiguresDirective(TableDirective):
    """A table of figures; subclasses give the rows of the run."""

    optional_arguments = 1

    def run(self) -> list[nodes.Node]:
        """The table, made anew when the run is another one."""
        self.env.note_dependency(str(RUN))
        return super().run()

    def chosen(self, kind: str) -> list[dict[str, Any]]:
        """What the run has of that kind, of one program or of all."""
        if self.arguments and self.arguments[0] not in PROGRAMS:
            raise self.error(f"there is no program {self.arguments[0]!r}")
        return [one for one in run()[kind] if self.arguments in ([], [one["program"]])]


class Rows(FiguresDirective):
    """Goals and figures."""

    def rows(self) -> Iterable[Sequence[str]]:
        """One row each; the other tree only where there was one."""
        found = self.chosen("rows")
        lines: list[tuple[str, ...]] = [
            ("", "Must", "Aim", "Before", "Quartiles", "Now", "Quartiles", "Goal")
        ]
        lines += [cells(row) for row in found]
        has_before = any(row["before"] for row in found)
        return lines if has_before else [drop_before(line) for line in lines]


class CostsTable(FiguresDirective):
    """What each side cost."""

    def rows(self) -> Iterable[Sequence[str]]:
        """One row per side."""
        yield "", "Median", "Quartiles", "Unit"
        costs = self.chosen("costs")
        for cost in costs:
            yield (cost["name"], *spread(cost["now"]), cost["unit"])
        if not costs:
            yield "not in the run shown", "", "", ""


def setup(app: Sphinx) -> dict[str, Any]:
    """Called by Sphinx."""
    app.add_directive("benchmark-machine", Machine)
    app.add_directive("benchmark-rows", Rows)
    app.add_directive("benchmark-costs", CostsTable)
    return {"version": "1", "parallel_read_safe": True, "parallel_write_safe": True}
