"""Services to the API pages.

Every name in ``m100link.__all__`` must be described somewhere in the manual, because only described
names are public. A name that is not fails the build.

Docstrings name things as their module knows them; the manual describes them where users import them
from. References are led from the one to the other, and only if exactly one thing has the name.
"""

from __future__ import annotations

import ast
import importlib
import inspect
import re
from typing import Any

from docutils import nodes
from sphinx.addnodes import pending_xref
from sphinx.application import Sphinx
from sphinx.environment import BuildEnvironment
from sphinx.util import logging
from sphinx.util.nodes import make_refnode

import m100link

logger = logging.getLogger(__name__)

_FIELDS = re.compile(
    r"^(?P<indent>\s*):(?P<field>raises|ivar|param) (?P<names>[\w.]+(?:, [\w.]+)+):(?P<text>.*)$"
)


def split_fields(
    app: Sphinx, what: str, name: str, obj: object, options: object, lines: list[str]
) -> None:
    """Turn ``:raises A, B: text`` into one field per name, so that each one is understood."""
    for index in reversed(range(len(lines))):
        match = _FIELDS.match(lines[index])
        if match is not None:
            lines[index : index + 1] = [
                f"{match['indent']}:{match['field']} {one}:{match['text']}"
                for one in match["names"].split(", ")
            ]


def undo_guessed_types(
    app: Sphinx, what: str, name: str, obj: object, options: object, lines: list[str]
) -> None:
    """Put back the words before a colon that napoleon took for a type; types are annotations."""
    for index in reversed(range(len(lines))):
        kind, colon, words = lines[index].strip().partition("type: ")
        if not colon or kind not in (":", ":r"):
            continue
        if kind == ":" and what == "property":
            lines[0] = f"{words}: {lines[0]}"
            del lines[index]
        elif kind == ":r" and index and lines[index - 1].startswith(":returns:"):
            lines[index - 1] = lines[index - 1].replace(":returns:", f":returns: {words}:", 1)
            del lines[index]


def resolve_moved(
    app: Sphinx, env: BuildEnvironment, node: pending_xref, contnode: nodes.TextElement
) -> nodes.reference | None:
    """Find what a reference means by the longest end of its name that describes one thing."""
    if node.get("refdomain") != "py":
        return None
    parts = node["reftarget"].split(".")
    for start in range(len(parts)):
        end = "." + ".".join(parts[start:])
        homes = {
            (entry.docname, entry.node_id)
            for name, entry in env.domains.python_domain.objects.items()
            if name.endswith(end)
        }
        if len(homes) == 1:
            docname, node_id = homes.pop()
            return make_refnode(app.builder, node["refdoc"], docname, node_id, contnode)
        if homes:
            return None
    return None


def skip_field_aliases(
    app: Sphinx, what: str, name: str, obj: object, skip: bool, options: object
) -> bool | None:
    """Fields of a NamedTuple are described by their class; Python's own text says nothing."""
    return True if (getattr(obj, "__doc__", "") or "").startswith("Alias for field") else None


def check_public_names(app: Sphinx, env: BuildEnvironment) -> list[str]:
    """Warn about public names that no page describes."""
    described = env.domains.python_domain.objects
    for name in getattr(m100link, "__all__", ()):
        target = getattr(m100link, name)
        home = f"{getattr(target, '__module__', '')}.{getattr(target, '__qualname__', name)}"
        if f"m100link.{name}" not in described and home not in described:
            logger.warning("m100link.%s is public and no page describes it", name)
    return []


def load_annotations(app: Sphinx) -> None:
    """Give the aircraft the names of its annotations, which it loads only when they are asked for.

    autodoc asks the module for them, and would leave the names as they are written.
    """
    module = importlib.import_module("m100link.aircraft.aircraft")
    for node in ast.parse(inspect.getsource(module)).body:
        if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING":
            code = compile(ast.Module(node.body, []), module.__name__, "exec")
            exec(code, vars(module))


def setup(app: Sphinx) -> dict[str, Any]:
    """Called by Sphinx."""
    app.connect("builder-inited", load_annotations)
    # After napoleon (priority 500), which writes the fields.
    app.connect("autodoc-process-docstring", split_fields, priority=900)
    app.connect("autodoc-process-docstring", undo_guessed_types, priority=901)
    app.connect("missing-reference", resolve_moved)
    app.connect("autodoc-skip-member", skip_field_aliases)
    app.connect("env-get-updated", check_public_names)
    return {"version": "1", "parallel_read_safe": True, "parallel_write_safe": True}
