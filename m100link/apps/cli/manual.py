"""``m100link docs``: the manual, from the package itself.

Reading: pages stand under ``m100link/manual``, in a source tree under ``docs``. rich shows them,
after :func:`_plain` has said in words what only the builder of the manual can make.
"""

from __future__ import annotations

import importlib
import inspect
import io
import os
import re
import shutil
import sys
from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from difflib import get_close_matches
from itertools import groupby
from pathlib import Path
from types import SimpleNamespace
from typing import Annotated, Any, Literal

from cyclopts import Parameter
from rich.console import Console
from rich.markdown import Markdown, TableElement
from rich.table import Table
from rich.text import Text

import m100link
from m100link.apps.cli.common import err, out
from m100link.apps.cli.configuration import Configuration, read_configuration, shown
from m100link.apps.cli.options import offered
from m100link.apps.cli.terminal import ExitCode, OutputFormat, as_json, tell, tell_text
from m100link.apps.station.config import resolve
from m100link.errors import M100Error, UsageError

_FOLDERS = ("tutorial", "howto", "explanation", "reference")
_CONTENTS = re.compile(r"^# (.+)|^## (.+)|\(([\w-]+)\.md\)", re.MULTILINE)  # of an index
_WIDEST = 100  # longer lines are hard to read


class _Table(TableElement):
    """A table that cuts no word: columns of single words, such as types, keep their width."""

    def __rich_console__(self, *given: Any) -> Iterator[Table]:
        for table in super().__rich_console__(*given):
            assert isinstance(table, Table)
            for one in table.columns:
                one.no_wrap = not any(" " in str(cell) for cell in one.cells)
                one.overflow = "fold"
            yield table


@dataclass(frozen=True)
class _Page:
    path: Path
    heading: str = ""  # what the index of its folder lists it under

    @property
    def topic(self) -> str:
        return self.path.stem

    @property
    def text(self) -> str:
        return self.path.read_text(encoding="utf-8")

    @property
    def title(self) -> str:
        return self.text.lstrip().partition("\n")[0].removeprefix("# ")

    def printed(self, width: int, *, in_colour: bool) -> str:
        """The page as it is read, in lines of this width."""
        to = io.StringIO()
        console = Console(file=to, width=width, force_terminal=in_colour, no_color=not in_colour)
        page = Markdown(_plain(self.text, self.path.parents[1]), hyperlinks=False)
        page.elements = {**page.elements, "table_open": _Table}  # type: ignore[misc] # this page alone
        console.print(page)
        return "\n".join(line.rstrip() for line in to.getvalue().splitlines()) + "\n"


def _pages() -> list[_Page]:
    """All of them, in the order of the index of each folder."""
    package = Path(m100link.__file__).parent
    root = next(
        (one for one in (package / "manual", package.parent / "docs") if one.is_dir()), package
    )
    pages = []
    for folder in _FOLDERS:
        found = {path.stem: path for path in sorted((root / folder).glob("*.md"))}
        index = found.pop("index", None)
        kind = heading = folder.capitalize()
        for title, section, topic in _CONTENTS.findall(index.read_text("utf-8") if index else ""):
            kind = title or kind
            heading = f"{kind}: {section}" if section else heading
            if topic in found:
                pages.append(_Page(found.pop(topic), heading))
        pages += [_Page(path, kind) for path in found.values()]
    return pages


def docs(
    topic: Annotated[
        str | None,
        Parameter(help="A page, or an error code (M100-LINK-LOST); by default, list the pages."),
        offered(lambda: [page.topic for page in _pages()]),
    ] = None,
    /,
    *,
    find: str | None = None,
) -> int:
    """Read a page of the manual, or list them; needs no network.

    Args:
        find: List the lines of paragraphs that have all these words, with page and heading.
    """
    if topic is not None and topic.upper().startswith("M100-"):
        return _show_error(topic)
    pages = _pages()
    if not pages:
        raise UsageError(
            "this installation has no manual", remedy="install m100link from a wheel or its source"
        )
    if find is not None:
        return _find(pages, topic, find)
    if topic is None:
        return _list(pages)
    _show(_page_of(pages, topic))
    return ExitCode.OK


def _page_of(pages: list[_Page], topic: str) -> _Page:
    """The page of a topic. Raises UsageError: there is none; it names those that are near."""
    wanted = topic.lower().rpartition("/")[2].removesuffix(".md")
    for page in pages:
        if page.topic == wanted:
            return page
    near = [page.topic for page in pages if wanted in f"{page.topic} {page.title.lower()}"]
    near += get_close_matches(wanted, [page.topic for page in pages], n=3)
    raise UsageError(
        f"no page of the manual is called {topic!r}",
        remedy=f"did you mean {' or '.join(dict.fromkeys(near))}?"
        if near
        else f"m100link docs lists them; m100link docs --find {topic} looks into them",
    )


def _list(pages: list[_Page]) -> int:
    for heading, below in groupby(pages, lambda page: page.heading):
        head = f"\n{heading}\n"
        for page in below:
            facts = {"topic": page.topic, "title": page.title, "part": page.heading}
            tell(facts, f"{head}  {page.topic:<22}{page.title}")
            head = ""
    if not as_json():
        out.print("\nm100link docs TOPIC shows a page, docs --find WORD searches all of them.")
    return ExitCode.OK


def _find(pages: list[_Page], topic: str | None, wanted: str) -> int:
    words, found = wanted.lower().split(), list[tuple[str, str, str]]()
    for page in pages if topic is None else [_page_of(pages, topic)]:
        heading = page.title
        for block in re.split(r"\n\s*\n", page.text):  # words of a sentence stand on several lines
            headed = re.match(r"#+ (.+)|(.+)\n[*=-]{3,}$", block)
            heading = (headed[1] or headed[2]) if headed else heading
            if all(word in block.lower() for word in words):
                lines = [one for one in block.splitlines() if any(w in one.lower() for w in words)]
                found += [(page.topic, line.strip(), heading) for line in lines]
    for where, line, heading in found:
        facts = {"topic": where, "line": line, "heading": heading}
        tell(facts, f"{where}: {line} [{heading}]")
    if not found:
        where = "that page" if topic else "the manual"
        err.print(f"no paragraph of {where} has {wanted!r}")
    return ExitCode.OK if found else ExitCode.FAILED


def _show(page: _Page) -> None:
    if not sys.stdout.isatty() or OutputFormat.json:
        tell_text(page.printed(_WIDEST, in_colour=False))
        return
    import pydoc

    # less shows colours with -R; other pagers may not.
    in_colour = "PAGER" not in os.environ and shutil.which("less") is not None
    if in_colour:
        os.environ.setdefault("LESS", "-R")
    pydoc.pager(page.printed(min(out.width, _WIDEST), in_colour=in_colour))


# -- errors ---------------------------------------------------------------------------------------


def error_classes() -> list[type[M100Error]]:
    """Every class of errors of the package, each before those that derive from it."""
    for elsewhere in (
        "m100link.apps.agent.messages",
        "m100link.apps.fleet.pki",
        "m100link.apps.fleet.show.plan.steering",
        "m100link.sim.orders",
    ):
        importlib.import_module(elsewhere)
    return list(_derived(M100Error))


def _derived(base: type[M100Error]) -> Iterator[type[M100Error]]:
    yield base
    for kind in base.__subclasses__():
        if kind.__module__.startswith("m100link."):  # programs have their own
            yield from _derived(kind)


def _show_error(code: str) -> int:
    kinds = {kind.error_code: kind for kind in error_classes()}
    kind = kinds.get(code.upper())
    if kind is None:
        near = get_close_matches(code.upper(), kinds, n=3)
        raise UsageError(
            f"no error has the code {code}",
            remedy=f"did you mean {' or '.join(near)}?" if near else "m100link docs errors",
        )
    facts = {
        "code": code.upper(),
        "class": f"{kind.__name__}, a kind of {kind.__bases__[0].__name__}",
        "says": (inspect.getdoc(kind) or "").partition("\n\n")[0].replace("\n", " "),
        "usual_cause": kind.usual_cause,
        "what_to_do": kind.usual_remedy,
    }
    return tell(facts, *(f"{one.replace('_', ' ')}: {text}" for one, text in facts.items()))


# -- what only the builder of the manual can make, in words ---------------------------------------

_FENCE = re.compile(r"^```\{([\w-]+)\} *(.*?)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
_ROLE = re.compile(r"\{[\w:]+\}`~?(?:m100link\.)?([^`]*)`")
_LINK = re.compile(r"\[([^\]]+)\]\((?:[\w./-]*/)?([\w-]+)\.md(?:#[\w-]*)?\)")
_CODE = ("doctest", "testcode", "testoutput")
_TALK = ("warning", "caution", "note")
_SILENT = ("testsetup", "toctree")


def _plain(text: str, root: Path) -> str:
    """MyST as plain Markdown."""
    return _LINK.sub(
        _named, _ROLE.sub(r"`\1`", _FENCE.sub(lambda found: _unfenced(found, root), text))
    )


def _named(found: re.Match[str]) -> str:
    text, topic = found.groups()
    return text if topic in ("index", text.lower()) else f"{text} (→ {topic})"


def _unfenced(found: re.Match[str], root: Path) -> str:
    name, argument, body = found.groups()
    if name == "literalinclude":
        programs = (one / "examples" / Path(argument).name for one in (root, root.parent))
        program = next((one for one in programs if one.exists()), None)
        return f"`{argument}`" if program is None else f"```python\n{program.read_text('utf-8')}```"
    if name in _SILENT:
        return ""
    if name in _CODE:
        return f"```python\n{body}```"
    if name in _TALK:
        said = " ".join(body.split())
        return f"> **{name.capitalize()}.** {said}"
    if name == "eval-rst":
        return "\n".join(_described(body))
    if table := _rows(name, argument, root):
        table.insert(1, ["---"] * len(table[0]))
        return "\n".join(f"| {' | '.join(row)} |" for row in table)
    what = " ".join([*name.split("-"), argument]).strip()
    return f"*({what}: made of the code, see the manual that `nox -s manual` builds)*"


def _rows(name: str, argument: str, root: Path) -> list[list[str]]:
    """Head and body of a table that the builder makes of the code; none of what is no table."""
    folder, made = str(root / "_ext"), dict[str, Any]()
    builder = SimpleNamespace(add_directive=made.__setitem__, connect=lambda *_: None)
    sys.path.insert(0, folder)
    try:
        for path in sorted(Path(folder).glob("*tables.py")):
            with suppress(ImportError):  # an extra is not installed
                importlib.import_module(path.stem).setup(builder)
    finally:
        sys.path.remove(folder)
    table = made.get(name, object)
    if hasattr(table, "rows"):
        directive = table.__new__(table)
        directive.arguments = argument.split()
        with suppress(OSError):  # it is made of a file that a wheel has not
            rows: Iterable[Iterable[str]] = directive.rows()
            return [[one.replace("``", "`").replace("|", "\\|") for one in row] for row in rows]
    return []


def _described(body: str) -> Iterator[str]:
    """Names that the builder would describe, each with its first sentence."""
    for dotted in re.findall(r"^\.\. (?:auto|py:)\w+:: ([\w.]+)", body, re.MULTILINE):
        module, _, name = dotted.rpartition(".")
        try:
            described = getattr(importlib.import_module(module), name)
        except (ImportError, AttributeError):  # a method, or what is described in place
            yield f"- `{dotted}`"
            continue
        sentence = (inspect.getdoc(described) or "").partition("\n\n")[0].replace("\n", " ")
        yield f"- `{dotted}`: {sentence}"
    yield "\n`python -m pydoc NAME` shows all of it."


# -- ``m100link completion``: what a shell needs to complete this command --------------------------


Shell = Literal["bash", "zsh", "fish"]


def completion(
    shell: Annotated[
        Shell | None, Parameter(help="The shell; by default the one that you type in.")
    ] = None,
    /,
    *,
    install: bool = False,
) -> int:
    """Print or install shell completion: verbs, options, aircraft.

    Args:
        install: Install it where the shell looks for it; bash and zsh load it by a line in
            ~/.bashrc or ~/.zshrc.
    """
    from m100link.apps.cli.app import app

    shell = shell or _detected()
    if not install:
        return tell_text(app.generate_completion(shell=shell))
    place = app.install_completion(shell=shell)
    words = f"written to {place}; the next {shell} completes m100link"
    return tell({"file": str(place), "shell": shell}, words)


def _detected() -> Shell:
    from cyclopts.completion import ShellDetectionError, detect_shell

    try:
        found = detect_shell()
    except ShellDetectionError:
        found = None
    for shell in ("bash", "zsh", "fish"):
        if shell == found:
            return shell
    raise UsageError("m100link does not know this shell", remedy="name it: bash, zsh or fish")


# -- ``m100link config``: the user's configuration file, and what is in force ----------------------


_EXAMPLE = """\
[defaults]
aircraft = "lab-m100"      # unless you name another one
app_id = 1022384           # real aircraft only: sim:// has an app of its own
key_file = "m100.key"      # beside this file; chmod 600

[aircraft.lab-m100]
url = "/dev/ttyUSB0"
baud = 921600
firmware = "3.1"
"""

_SHOWN = (
    *("url", "firmware", "baud_rate", "timeout", "acceleration"),
    *("app_id", "key_file", "key", "level", "app_version", "bundle_id"),
)
_CALLED = {"baud_rate": "baud"}


def config(
    aircraft: Annotated[
        str | None,
        Parameter(help="Name or URL of an aircraft; by default that of M100LINK_URL or the file."),
        offered(lambda: read_configuration().aircraft),
    ] = None,
    /,
) -> int:
    """Show the configuration file and the settings in force."""
    configuration = read_configuration()
    for name in configuration.aircraft:  # tell mistakes now, not before a flight
        resolve({"url": name}, {}, of_aircraft=configuration.sources_of_station)
    in_force = _in_force(configuration, aircraft)
    facts = {
        "path": str(configuration.path),
        "exists": configuration.exists,
        "default": configuration.default,
        "aircraft": {name: one["url"] for name, one in configuration.aircraft.items()},
        "in_force": in_force,
    }
    return tell(facts, lambda: _print(configuration, in_force))


def _in_force(configuration: Configuration, aircraft: str | None) -> dict[str, dict[str, Any]]:
    """Value and source of each setting by its name; a key is only said to be set."""
    settings = resolve({"url": aircraft}, os.environ, of_aircraft=configuration.sources)
    values = {}
    for name in _SHOWN:
        value = getattr(settings, name)
        if value is not None:
            values[_CALLED.get(name, name)] = {
                "value": "(set)" if name == "key" else value,
                "source": settings.origins.get(name, "default"),
            }
    return values


def _print(configuration: Configuration, in_force: dict[str, dict[str, Any]]) -> None:
    out.print(shown(configuration.path), style="bold", end="")
    if not configuration.exists:
        out.print(" does not exist. An example:\n")
        out.print(_EXAMPLE)
    else:
        out.print()
        names = Table(box=None, pad_edge=False, show_header=False)
        for name, table in configuration.aircraft.items():
            is_default = name == configuration.default
            names.add_row(name, Text(table["url"]), Text("by default" if is_default else "", "dim"))
        out.print(names)
    values = Table("in force", "", "from", box=None, pad_edge=False)
    for name, one in in_force.items():
        if one["source"] != "default":
            source = one["source"].removeprefix(f"{shown(configuration.path)} ")
            values.add_row(name, Text(str(one["value"])), Text(source, style="dim"))
    if values.rows:
        out.print(values)
