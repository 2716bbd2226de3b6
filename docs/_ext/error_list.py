"""Every class of errors, made of the classes: code, what it says, usual cause and remedy.

::

    ```{error-list}

An entry's anchor is its code in small letters, which errors have as :attr:`M100Error.manual`.
"""

from __future__ import annotations

import inspect
from typing import Any

from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

from m100link.apps.cli.manual import error_classes


def first_sentences(kind: type) -> str:
    """The first paragraph of a docstring."""
    return (inspect.getdoc(kind) or "").partition("\n\n")[0].replace("\n", " ")


class ErrorList(SphinxDirective):
    """One entry per class, in the order of the tree."""

    def run(self) -> list[nodes.Node]:
        """A definition list."""
        entries = nodes.definition_list()
        for kind in error_classes():
            name = kind.error_code.lower()
            target = nodes.term("", "", ids=[name], names=[name])
            target += nodes.literal(text=kind.error_code)
            target += nodes.Text(f" {kind.__name__}, a kind of {_bases(kind)}")
            definition = nodes.definition()
            definition += nodes.paragraph("", "", *self.parse_inline(first_sentences(kind))[0])
            for title, text in (
                ("Usual cause", kind.usual_cause),
                ("What to do", kind.usual_remedy),
            ):
                words = self.parse_inline(text.replace("`", "``"))[0]
                definition += nodes.paragraph("", f"{title}: ", *words)
            entries += nodes.definition_list_item("", target, definition)
        return [entries]


def _bases(kind: type) -> str:
    return " and ".join(base.__name__ for base in kind.__bases__)


def setup(app: Sphinx) -> dict[str, Any]:
    """Called by Sphinx."""
    app.add_directive("error-list", ErrorList)
    return {"version": "1", "parallel_read_safe": True, "parallel_write_safe": True}
