"""Programs of Python 2, which most programs for ROS 1 are, in the Python that runs.

A source that Python 3 reads runs as it is. Another one is rewritten in the places where the
languages differ, so that it does what it did: an integer divided by an integer stays one, ``map``
gives a list. A source that neither can read is a SyntaxError, as Python 3 says it.
"""

from __future__ import annotations

import ast
import builtins
import functools
import re
from collections.abc import Callable, Iterator
from typing import Any

_TOKEN = re.compile(
    r"""
    (?P<comment>\#[^\n]*)
  | (?P<text>(?P<prefix>[bBuUrR]{0,2})(?:\"\"\"(?:\\.|[^\\])*?\"\"\"|'''(?:\\.|[^\\])*?'''
        |"(?:\\.|[^"\\\n])*"|'(?:\\.|[^'\\\n])*'))
  | (?P<joined>\\\n)
  | (?P<newline>\n)
  | (?P<space>[ \t\f\r]+)
  | (?P<number>0[0-7]+[lL]?\b|0[xX][0-9a-fA-F]+[lL]\b|\d+[lL]\b)
  | (?P<name>[^\W\d]\w*|\d[\w.]*)
  | (?P<other><>|>>|.)
    """,
    re.VERBOSE | re.DOTALL,
)
_OPEN, _CLOSE = "([{", ")]}"
_TAB = 8  # columns of a tab in Python 2


_SIGNS = re.compile(
    r"#!.*\bpython2|^[^#\n]*(?:\b(?:xrange|raw_input|unicode|basestring|unichr)\("
    r"|\.(?:iteritems|itervalues|has_key)\(|^\s*(?:import|from) (?:Queue|ConfigParser|Tkinter"
    r"|urllib2|StringIO|cPickle|thread|commands)\b)",
    re.MULTILINE,
)


def is_python2(source: str) -> bool:
    """Whether a source asks for Python 2, uses what only that has, or is not Python 3."""
    if _SIGNS.search(source):
        return True
    try:
        ast.parse(source)
    except SyntaxError:
        return True
    return False


def compiled(source: str, name: str, *, is_old: bool) -> Any:
    """The code of a source, of Python 2 if ``is_old``.

    Raises ``SyntaxError``: it cannot be read as that.
    """
    source = source.replace("\r\n", "\n").replace("\r", "\n")
    if not is_old:
        return compile(source, name, "exec", dont_inherit=True)
    tree = ast.parse(rewritten(source), name)
    tree = ast.fix_missing_locations(_Semantics(source).visit(tree))
    return compile(tree, name, "exec", dont_inherit=True)


# -- the grammar of Python 2 ---------------------------------------------------------------------


def rewritten(source: str) -> str:
    """The text of Python 2 in the grammar of Python 3."""
    return "".join(_statement(tokens) for tokens in _statements(source))


def _statements(source: str) -> Iterator[list[tuple[str, str]]]:
    """Statements as kinds and texts of tokens, with what separates them at their end."""
    found: list[tuple[str, str]] = []
    depth = 0
    for match in _TOKEN.finditer(source):
        kind, text = str(match.lastgroup), match.group()
        if match.group("text") is not None:
            kind = "text"
        depth += (text in _OPEN) - (text in _CLOSE) if kind == "other" else 0
        found.append((kind, text))
        if depth > 0:
            continue
        is_end = kind == "newline" or (kind == "other" and text == ";")
        if is_end or (text == ":" and _opens_a_block(found)):
            yield found
            found, depth = [], 0
    if found:
        yield found


_BLOCKS = {"if", "else", "elif", "while", "for", "try", "except", "finally", "with", "def", "class"}


def _opens_a_block(tokens: list[tuple[str, str]]) -> bool:
    words = [text for kind, text in tokens if kind not in ("space", "comment", "newline", "joined")]
    # ``lambda x: …`` in a condition has a colon of its own.
    return bool(words) and words[0] in _BLOCKS and words.count("lambda") < words.count(":")


def _statement(tokens: list[tuple[str, str]]) -> str:
    tokens = [(kind, _token(kind, text)) for kind, text in tokens]
    start = next(
        (i for i, (kind, _) in enumerate(tokens) if kind not in ("space", "newline", "comment")),
        len(tokens),
    )
    end = len(tokens)
    while end > start and (
        tokens[end - 1][0] in ("newline", "comment", "space") or tokens[end - 1][1] in (";", ":")
    ):
        end -= 1
    before = "".join(text for _, text in tokens[:start]).expandtabs(_TAB)
    inside, after = tokens[start:end], "".join(text for _, text in tokens[end:])
    if not inside:
        return before + after
    make = _REWRITTEN.get(inside[0][1])
    body = make(inside[1:]) if make is not None and inside[0][0] == "name" else None
    return before + (_join(inside) if body is None else body) + after


def _token(kind: str, text: str) -> str:
    if kind == "number":
        text = text.rstrip("lL")
        return f"0o{text[1:]}" if text.isdigit() and len(text) > 1 and text[0] == "0" else text
    if kind == "text" and text[:2].lower() == "ur":
        return text[1:]
    return "!=" if text == "<>" else text


def _join(tokens: list[tuple[str, str]]) -> str:
    """As written; what stands in backquotes becomes a call of repr."""
    parts, is_open = [], False
    for kind, text in tokens:
        if kind == "other" and text == "`":
            text, is_open = (")" if is_open else "repr("), not is_open
        parts.append(text)
    return "".join(parts)


def _split(tokens: list[tuple[str, str]]) -> list[list[tuple[str, str]]]:
    """The parts between commas outside of brackets."""
    parts: list[list[tuple[str, str]]] = [[]]
    depth = 0
    for kind, text in tokens:
        depth += (text in _OPEN) - (text in _CLOSE) if kind == "other" else 0
        if kind == "other" and text == "," and not depth:
            parts.append([])
        else:
            parts[-1].append((kind, text))
    return parts


def _is_blank(tokens: list[tuple[str, str]]) -> bool:
    return all(kind in ("space", "joined", "comment") for kind, _ in tokens)


def _print(tokens: list[tuple[str, str]]) -> str | None:
    """``print a, b,`` and ``print >>f, a`` as calls; an assignment to ``print`` is none."""
    words = [one for one in tokens if one[0] not in ("space", "joined")]
    if words and words[0][1] in ("=", "."):
        return None
    parts = _split(tokens)
    stays = len(parts) > 1 and _is_blank(parts[-1])
    parts = [one for one in parts if not _is_blank(one)]
    more = []
    if words[:1] == [("other", ">>")] and parts:
        place = next(i for i, one in enumerate(parts[0]) if one[1] == ">>")
        more.append(f"file={_join(parts.pop(0)[place + 1 :]).strip()}")
    if stays:
        more.append("end=' '")
    return f"print({', '.join([_join(one).strip() for one in parts] + more)})"


def _except(tokens: list[tuple[str, str]]) -> str | None:
    parts = _split(tokens)
    if len(parts) != 2:
        return None
    return f"except {_join(parts[0]).strip()} as {_join(parts[1]).strip()}"


def _raise(tokens: list[tuple[str, str]]) -> str | None:
    parts = [_join(one).strip() for one in _split(tokens)]
    if len(parts) < 2:
        return None
    more = f".with_traceback({parts[2]})" if len(parts) > 2 else ""
    return f"raise {parts[0]}({parts[1]}){more}"


def _exec(tokens: list[tuple[str, str]]) -> str | None:
    text = _join(tokens).strip()
    if text.startswith("("):
        return None
    code, _, where = text.partition(" in ")
    return f"exec({code}{', ' if where else ''}{where})"


_REWRITTEN: dict[str, Callable[[list[tuple[str, str]]], str | None]] = {
    "print": _print,
    "except": _except,
    "raise": _raise,
    "exec": _exec,
}


# -- the semantics of Python 2 -------------------------------------------------------


class _Semantics(ast.NodeTransformer):
    def __init__(self, source: str) -> None:
        self._divides = not re.search(r"^from __future__ import .*\bdivision\b", source, re.M)

    def visit_BinOp(self, node: ast.BinOp) -> ast.AST:
        self.generic_visit(node)
        if isinstance(node.op, ast.Div) and self._divides:
            return _call("divide", node.left, node.right)
        return node

    def visit_AugAssign(self, node: ast.AugAssign) -> ast.AST:
        self.generic_visit(node)
        if not (isinstance(node.op, ast.Div) and self._divides):
            return node
        read = ast.parse(ast.unparse(node.target), mode="eval").body
        return ast.Assign(targets=[node.target], value=_call("divide", read, node.value))

    def visit_Call(self, node: ast.Call) -> ast.AST:
        self.generic_visit(node)
        if not isinstance(node.func, ast.Attribute) or node.keywords:
            return node
        name, of = node.func.attr, node.func.value
        if name in _METHODS and len(node.args) == _METHODS[name]:
            return _call("method", of, ast.Constant(name), *node.args)
        return node


_METHODS = {"iteritems": 0, "iterkeys": 0, "itervalues": 0, "has_key": 1, "next": 0, "keys": 0,
            "values": 0, "items": 0}  # fmt: skip
_HERE = "__python2__"


def _call(name: str, *values: ast.expr) -> ast.Call:
    place = ast.Attribute(value=ast.Name(_HERE, ast.Load()), attr=name, ctx=ast.Load())
    return ast.Call(func=place, args=list(values), keywords=[])


class _Helpers:
    """The functions that a rewritten program calls."""

    @staticmethod
    def divide(left: Any, right: Any) -> Any:
        if isinstance(left, int) and isinstance(right, int):
            return left // right
        return left / right

    @staticmethod
    def method(of: Any, name: str, *values: Any) -> Any:
        own = getattr(of, name, None)
        if name == "has_key" and own is None:
            return values[0] in of
        if name == "next" and own is None:
            return next(of)
        if name.startswith("iter") and own is None:
            return iter(getattr(of, name[4:])())
        found = own(*values) if own is not None else getattr(of, name)(*values)
        is_view = isinstance(of, dict) and name in ("keys", "values", "items")
        return list(found) if is_view else found


def _listed(function: Callable[..., Any]) -> Callable[..., Any]:
    @functools.wraps(function, updated=())
    def made(*values: Any, **named: Any) -> Any:
        return list(function(*values, **named))

    return made


def _input(prompt: str = "") -> Any:
    """Python 2 evaluates what is typed: only a value is taken here."""
    text = builtins.input(prompt)
    try:
        return ast.literal_eval(text)
    except (SyntaxError, ValueError):
        return text


NAMES: dict[str, Any] = {
    _HERE: _Helpers,
    "xrange": range,
    "range": _listed(range),
    "map": _listed(map),
    "filter": _listed(filter),
    "zip": _listed(zip),
    "raw_input": input,
    "input": _input,
    "unicode": str,
    "basestring": str,
    "long": int,
    "unichr": chr,
    "reduce": functools.reduce,
    "reload": lambda module: module,
    "cmp": lambda a, b: (a > b) - (a < b),
    "file": open,
}
"""Names that a program of Python 2 knows, besides those of Python 3."""

MODULES = {
    "Queue": "queue",
    "ConfigParser": "configparser",
    "StringIO": "io",
    "cStringIO": "io",
    "cPickle": "pickle",
    "thread": "_thread",
    "Tkinter": "tkinter",
    "tkMessageBox": "tkinter.messagebox",
    "urllib2": "urllib.request",
    "urlparse": "urllib.parse",
    "SocketServer": "socketserver",
    "commands": "subprocess",
    "__builtin__": "builtins",
    "exceptions": "builtins",
}
"""Modules of Python 2, and where they are now."""
