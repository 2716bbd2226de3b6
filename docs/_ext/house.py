"""The layers of the package, as the import contract of pyproject.toml has them.

    ```{layer-list}                       the layers from the top down, and what each one is
    ```{contract-list}                    the other contracts that `lint-imports` holds

What a layer is stands in the first sentence of its own docstring.
"""

from __future__ import annotations

import importlib
import inspect
import tomllib
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective
from tables import TableDirective

PYPROJECT = Path(__file__).parents[2] / "pyproject.toml"


def contracts() -> list[dict[str, Any]]:
    """The import contracts; the first is that of the layers."""
    settings = tomllib.loads(PYPROJECT.read_text(encoding="utf-8"))["tool"]["importlinter"]
    found: list[dict[str, Any]] = settings["contracts"]
    return found


def summary(module: str) -> str:
    """The first sentence of a module's docstring, which its rules for style keep on one line."""
    first, *_ = inspect.cleandoc(importlib.import_module(module).__doc__ or "").splitlines()
    return first


class LayerList(TableDirective):
    """The layers from the top down; each may import those below it."""

    def rows(self) -> Iterable[Sequence[str]]:
        """One row per layer."""
        layers = contracts()[0]["layers"]
        yield "Floor", "Layer", "What it is"
        for floor, layer in zip(range(len(layers), 0, -1), layers, strict=True):
            yield str(floor), f"``{layer}``", summary(layer)


class ContractList(SphinxDirective):
    """The names of all contracts but that of the layers: each is a sentence that holds."""

    def run(self) -> list[nodes.Node]:
        """A bullet list."""
        items = nodes.bullet_list()
        for contract in contracts()[1:]:
            items += nodes.list_item("", nodes.paragraph(text=contract["name"]))
        return [items]


def setup(app: Sphinx) -> dict[str, Any]:
    """Called by Sphinx."""
    app.add_directive("layer-list", LayerList)
    app.add_directive("contract-list", ContractList)
    app.setup_extension("tables")
    return {"version": "1", "parallel_read_safe": True, "parallel_write_safe": True}
