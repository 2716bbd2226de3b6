"""Tables that are made of the code they describe, so that they cannot differ from it.

Each directive takes its rows from one object of the package::

    ```{profile-table}                    m100link.protocol.firmware.PROFILES
    ```{item-table}                       sizes of the telemetry items per profile
    ```{item-fields} 3.1                  fields of the telemetry items under one profile
    ```{records}                          the records of telemetry and their enumerations
    ```{mode-table}                       the fourteen control modes and their ranges
    ```{discard-table}                    causes for which the decoder discards
    ```{url-examples}                     connection strings that work
    ```{authority-table}                  transitions of control authority
    ```{supervision-table}                transitions of a connection that is kept
    ```{stop-table}                       what the stop path does for each cause
    ```{block-table}                      transitions of a control block
    ```{ending-table}                     what becomes of the aircraft when a program ends
    ```{cli-help}                         what `m100link … --help` says, for every verb
    ```{option-table}                     every option of the command, with its verbs
    ```{layer-list}                       the layers of the import contract, and what each one is
    ```{contract-list}                    the other contracts that `lint-imports` holds
    ```{errata-index}                     links to the numbered errata
"""

from __future__ import annotations

import dataclasses
import importlib
import inspect
import io
import re
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from enum import Enum
from pathlib import Path
from struct import calcsize
from typing import TYPE_CHECKING, Any

import endings
from cyclopts import App
from rich.console import Console

from m100link import protocol
from m100link.aircraft import supervising as supervision
from m100link.apps.cli.app import app as cli
from m100link.flight import lifecycle
from m100link.flight.authority import TRANSITIONS
from m100link.link.url import EXAMPLES
from m100link.protocol import firmware, records, setpoint
from m100link.protocol.items import ITEMS
from m100link.protocol.packet import telemetry_size
from m100link.wire import Discard

if TYPE_CHECKING:
    from sphinx.application import Sphinx
try:
    from docutils import nodes
    from docutils.statemachine import StringList
    from sphinx.util.docutils import SphinxDirective as SphinxDirective
except ImportError:  # `m100link docs` shows the rows of tables where the builder is not installed
    SphinxDirective = object  # type: ignore[assignment,misc]  # it has rows all the same

PROFILES = tuple(firmware.PROFILES.values())
_PYPROJECT = Path(__file__).parents[2] / "pyproject.toml"


class TableDirective(SphinxDirective):
    """A table of inline text; subclasses give the rows."""

    has_content = False

    def rows(self) -> Iterable[Sequence[str]]:
        """The head row, then the body rows. Double backquotes make code."""
        raise TypeError(f"{type(self).__name__} has no rows")

    def run(self) -> list[nodes.Node]:
        """The table as document nodes."""
        return [table(self.rows())]


def table(rows: Iterable[Sequence[str]]) -> nodes.table:
    """A table from its head row and its body rows."""
    head, *body = rows
    table = nodes.table(classes=["colwidths-auto"])
    group = nodes.tgroup(cols=len(head))
    table += group
    for column in zip(head, *body, strict=True):
        # Browsers see to the widths themselves; builders for text need some.
        group += nodes.colspec(colwidth=min(40, max(map(len, column)) + 1))
    group += nodes.thead("", _row(head))
    group += nodes.tbody("", *map(_row, body))
    return table


def _row(cells: Sequence[str]) -> nodes.row:
    return nodes.row("", *(nodes.entry("", _paragraph(cell)) for cell in cells))


def _paragraph(text: str) -> nodes.paragraph:
    paragraph = nodes.paragraph()
    for index, part in enumerate(re.split(r"``(.+?)``", text)):
        if part:
            paragraph += nodes.literal(text=part) if index % 2 else nodes.Text(part)
    return paragraph


def sentence(text: str) -> str:
    """The text with a capital, or a dash for none."""
    return text[:1].upper() + text[1:] if text else "—"


def _yes(value: bool) -> str:
    return "yes" if value else "no"


def home(described: type) -> str:
    """Where users import it from."""
    is_exported = getattr(protocol, described.__name__, None) is described
    return f"{protocol.__name__ if is_exported else described.__module__}.{described.__name__}"


class ProfileTable(TableDirective):
    """What the firmware profiles say, one column each."""

    def rows(self) -> Iterable[Sequence[str]]:
        """One row per attribute in which a profile can differ."""
        yield "", *(f"``{profile.name}``" for profile in PROFILES)
        for field in dataclasses.fields(firmware.FirmwareProfile):
            if field.init and field.name not in ("name", "items"):
                values = (getattr(profile, field.name) for profile in PROFILES)
                yield f"``{field.name}``", *(_value(field.name, value) for value in values)


def _value(name: str, value: object) -> str:
    if isinstance(value, bool):
        return _yes(value)
    if isinstance(value, firmware.Generation):
        return f"those of {value}"
    if isinstance(value, Enum):
        return str(value.value)
    if isinstance(value, tuple):
        return ", ".join(f"``{text}``" if text else "none in the text" for text in value) or "—"
    if name == "activation_version":
        return "the app's own" if value is None else f"``0x{value:08X}``"
    return f"``{value}``" if name == "version_name" else str(value)


class ItemTable(TableDirective):
    """Bytes per telemetry item and profile."""

    def rows(self) -> Iterable[Sequence[str]]:
        """One row per item in the order of the flag bits, and the whole."""
        yield "Bit", "Item", "Record", *(f"``{profile.name}``" for profile in PROFILES)
        for item in ITEMS:
            layouts = (profile.items.get(item.name) for profile in PROFILES)
            sizes = ("—" if layout is None else str(layout.size) for layout in layouts)
            yield str(item.bit), f"``{item.name}``", f"``{item.record.__name__}``", *sizes
        totals = (str(telemetry_size(profile.item_flags, profile)) for profile in PROFILES)
        yield "", "all, with the flag word", "", *totals


_C_TYPES = {"B": "u8", "h": "i16", "I": "u32", "f": "f32", "d": "f64"}


class ItemFields(TableDirective):
    """Fields of every telemetry item under one profile."""

    required_arguments = 1

    def rows(self) -> Iterable[Sequence[str]]:
        """One row per field, with its offset inside the item."""
        yield "Item", "Offset", "Type", "Field"
        profile = firmware.profile(self.arguments[0])
        for name, layout in profile.items.items():
            counted = re.findall(r"(\d*)([a-zA-Z])", layout.format)
            letters = "".join(letter * int(count or 1) for count, letter in counted)
            for index, (letter, field) in enumerate(zip(letters, layout.fields, strict=True)):
                offset = calcsize("<" + letters[:index])
                item = f"``{name}``" if index == 0 else ""
                yield item, str(offset), _C_TYPES[letter], f"``{field}``"


class Records(SphinxDirective):
    """Every record of telemetry, in the order of the flag bits, each before what it enumerates."""

    def run(self) -> list[nodes.Node]:
        """One description per public class."""
        lines: list[str] = []
        enumerations: list[str] = []
        for name, kind in vars(records).items():
            if name not in records.__all__:
                continue
            described = [f".. autoclass:: m100link.{name}", "   :members:"]
            if issubclass(kind, Enum):
                enumerations += [*described, "   :undoc-members:", ""]
                continue
            if kind.__base__ is not tuple:
                described.append("   :inherited-members: tuple")
            lines += [*described, "", *enumerations]
            enumerations = []
        whole = nodes.Element()
        text = ["```{eval-rst}", *lines, *enumerations, "```"]
        self.state.nested_parse(StringList(text, source=records.__name__), 0, whole)
        return whole.children


class ModeTable(TableDirective):
    """The fourteen control modes."""

    def rows(self) -> Iterable[Sequence[str]]:
        """One row per mode, in the document's order."""
        yield "No", "Constructor", "Vertical", "Horizontal", "Yaw", "Flag"
        modes = [
            setpoint.ControlMode(horizontal, vertical, yaw)
            for horizontal in setpoint.Horizontal
            for vertical in setpoint.Vertical
            for yaw in setpoint.Yaw
        ]
        for mode in sorted((mode for mode in modes if mode.is_legal), key=lambda m: m.number):
            yield (
                str(mode.number),
                f"``Setpoint.{mode.horizontal.name.lower()}``",
                _ranged(mode.vertical, setpoint.VERTICAL_LIMITS[mode.vertical]),
                _ranged(mode.horizontal, setpoint.LIMITS[mode.horizontal]),
                _ranged(mode.yaw, setpoint.YAW_LIMITS[mode.yaw]),
                f"``0x{mode.flag:02X}``",
            )


_HUGE = 1e30  # beyond it stands the largest number of the wire, which limits no flight


def _ranged(way: Enum, limit: Any) -> str:
    name = way.name.lower().replace("_", " ")
    if limit.low < -_HUGE:
        return f"{name}, {limit.unit}"
    low, high = (f"{value:g}".replace("-", "−") for value in (limit.low, limit.high))
    if limit.high > _HUGE:
        return f"{name}, {low} {limit.unit} and more"
    return f"{name}, {low} to {high} {limit.unit}"


DISCARD_MEANINGS = {
    Discard.HEADER_CRC: "A start byte 0xAA that begins no frame: its CRC16 is wrong. In noise and "
    "in encrypted data that is the ordinary case.",
    Discard.FRAME_CRC: "A good header, and a wrong CRC32 over the frame.",
    Discard.LENGTH: "A good CRC16 over a length that no frame has: below 12, or 13 to 15.",
    Discard.RESERVED_BITS: "A good CRC16 over reserved bits that are not zero.",
    Discard.VERSION: "A good CRC16 over a version field that is not 0.",
    Discard.PADDING: "A good frame that claims more padding than it has data, or more than 16.",
    Discard.NO_KEY: "A good frame that is encrypted, and there is no key.",
    Discard.TRUNCATED: "The stream ended inside a frame.",
}


class DiscardTable(TableDirective):
    """Causes for which the decoder discards bytes."""

    def rows(self) -> Iterable[Sequence[str]]:
        """One row per cause; a cause without a meaning fails the build."""
        yield "Cause", "Meaning"
        for cause in Discard:
            yield f"``{cause}``", DISCARD_MEANINGS[cause]


class TransitionTable(TableDirective):
    """The transitions of a machine with states; subclasses say of which."""

    transitions: Mapping[Any, Mapping[Any, Any]] = {}

    def rows(self) -> Iterable[Sequence[str]]:
        """One row per state and input."""
        yield "State", "What happens", "Next state"
        for state, transitions in self.transitions.items():
            for index, (what, after) in enumerate(transitions.items()):
                name = f"``{state.name}``" if index == 0 else ""
                yield name, sentence(what.value), f"``{after.name}``"


class AuthorityTable(TransitionTable):
    """The transitions of control authority."""

    transitions = TRANSITIONS


class SupervisionTable(TransitionTable):
    """The transitions of a connection that is kept."""

    transitions = supervision.TRANSITIONS


class StopTable(TableDirective):
    """What the stop path of a control block does."""

    def rows(self) -> Iterable[Sequence[str]]:
        """One row per cause."""
        yield "What ends the block", *(sentence(step) for step in lifecycle.StopPlan._fields)
        for cause, plan in lifecycle.STOP_PLANS.items():
            yield sentence(cause.value), *map(_yes, plan)


class EndingTable(TableDirective):
    """What the aircraft received last and did, for each ending of a program."""

    def rows(self) -> Iterable[Sequence[str]]:
        """One row per ending."""
        yield "What ends the program", '``stop="hover"``', '``stop="land"``', "a mission flies"
        for ending, outcomes in endings.ENDINGS.items():
            actions = (f"{one.received}: {one.did}" for one in outcomes)
            yield sentence(ending.value.replace("`", "``")), *map(sentence, actions)


class BlockTable(TableDirective):
    """The transitions of a control block."""

    def rows(self) -> Iterable[Sequence[str]]:
        """One row per state and next state."""
        yield "State", "What happens", "Next state"
        for state, transitions in lifecycle.TRANSITIONS.items():
            ways: dict[lifecycle.BlockState, list[str]] = {}
            for what, after in transitions.items():
                ways.setdefault(after, []).append(what.value)
            name = f"``{state.name}``: {state.value}"
            for after, happenings in ways.items():
                yield name, sentence("; or: ".join(happenings)), f"``{after.name}``"
                name = ""
            if not ways:
                yield name, "—", "—"


class ErrataIndex(SphinxDirective):
    """The numbers of the errata as links, in their order; each number must be there once."""

    def run(self) -> list[nodes.Node]:
        """One paragraph."""
        text = Path(self.env.doc2path(self.env.docname)).read_text(encoding="utf-8")
        headings = {int(number) for number in re.findall(r"^### (\d+)\. ", text, re.MULTILINE)}
        rows = {int(number) for number in re.findall(r"^\| (\d+) \|", text, re.MULTILINE)}
        if headings & rows or headings | rows != set(range(1, 74)):
            raise self.error("the errata are not the numbers 1 to 73, each once")
        paragraph = nodes.paragraph(text="By number: ")
        for number in range(1, 74):
            anchor = f"errata-{number}" if number in headings else "errata-missions"
            paragraph += nodes.reference(text=str(number), refuri=f"#{anchor}")
            paragraph += nodes.Text(" ")
        return [paragraph]


class UrlExamples(SphinxDirective):
    """The connection strings that error messages show."""

    def run(self) -> list[nodes.Node]:
        """A literal block."""
        lines = StringList(list(EXAMPLES), source="m100link.link.url")
        return [nodes.literal_block(text="\n".join(lines))]


class CliHelp(SphinxDirective):
    """The help text of every verb, as the terminal shows it."""

    def run(self) -> list[nodes.Node]:
        """One section per verb and subcommand, in alphabetical order."""
        verbs = [verb for verb in sorted(cli) if not verb.startswith("-")]
        return [self._section(*words) for verb in verbs for words in self._below(cli[verb], verb)]

    def _below(self, app: App, *words: str) -> Iterable[tuple[str, ...]]:
        """A command, and all that stand below it."""
        yield words
        for name in sorted(app):
            if not name.startswith("-"):
                yield from self._below(app[name], *words, name)

    @staticmethod
    def _section(*words: str) -> nodes.section:
        text = io.StringIO()
        console = Console(file=text, width=92, force_terminal=False, color_system=None)
        cli.help_print(list(words), console=console)
        lines = [line.rstrip() for line in text.getvalue().strip().splitlines()]
        name = f"verb-{'-'.join(words)}"
        section = nodes.section(ids=[name], names=[name])
        section += nodes.title(text=" ".join(words))
        section += nodes.literal_block(text="\n".join(lines), language="text")
        return section


class OptionTable(TableDirective):
    """Every option of the command line, as the parser has it."""

    def rows(self) -> Iterable[Sequence[str]]:
        """A row for each sentence of an option, with the verbs that say it."""
        told: dict[tuple[str, str], list[str]] = {}
        for verb, command in self._verbs(cli):
            found = command.assemble_argument_collection(
                default_parameter=cli.default_parameter, parse_docstring=True
            )
            for one in found:
                if one.names[0].startswith("--") and not one.children:
                    names = ", ".join(f"``{name}``" for name in one.names)
                    text = " ".join((one.parameter.help or "").replace("`", "``").split())
                    told.setdefault((names, text), []).append(verb)
        every = max(map(len, told.values()))  # those of --json: nobody reads them in each row
        yield "Option", "Meaning", "Verbs"
        for (names, text), verbs in sorted(told.items()):
            several = f"{len(verbs)} verbs, {verbs[0]} among them"
            is_all = "all" if len(verbs) == every else ""
            yield names, sentence(text), is_all or (", ".join(verbs) if len(verbs) < 9 else several)

    def _verbs(self, above: App, *words: str) -> Iterable[tuple[str, App]]:
        for name in sorted(name for name in above if not name.startswith("-")):
            if above[name].default_command is not None:
                yield " ".join((*words, name)), above[name]
            yield from self._verbs(above[name], *words, name)


def import_contracts() -> list[dict[str, Any]]:
    """The import contracts; the first is that of the layers."""
    settings = tomllib.loads(_PYPROJECT.read_text(encoding="utf-8"))["tool"]["importlinter"]
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
        layers = import_contracts()[0]["layers"]
        yield "Floor", "Layer", "What it is"
        for floor, layer in zip(range(len(layers), 0, -1), layers, strict=True):
            yield str(floor), f"``m100link.{layer}``", summary(f"m100link.{layer}")


class ContractList(SphinxDirective):
    """The names of all contracts but that of the layers: each is a sentence that holds."""

    def run(self) -> list[nodes.Node]:
        """A bullet list."""
        items = nodes.bullet_list()
        for contract in import_contracts()[1:]:
            items += nodes.list_item("", nodes.paragraph(text=contract["name"]))
        return [items]


_PHONE = 54  # characters side by side on a phone, with the margins of cells; a few may stand out
_WORDS = 16  # characters from which a cell is words, not a value


def mark_words(_app: Sphinx, document: nodes.document) -> None:
    """Give the class `words` to cells that a phone would squeeze to their longest word.

    Browsers do that to every cell that can be broken, in a table that is too wide anyhow.
    """
    for group in document.findall(nodes.tgroup):
        rows = [[*row.findall(nodes.entry)] for row in group.findall(nodes.row)]
        longest = (max(map(_longest_word, column)) + 2 for column in zip(*rows, strict=False))
        if sum(longest) > _PHONE:
            for entry in group.findall(nodes.entry):
                if len(entry.astext()) >= _WORDS:
                    entry["classes"].append("words")


def _longest_word(entry: nodes.entry) -> int:
    return max(map(len, re.split(r"[\s-]", entry.astext())))


def setup(app: Sphinx) -> dict[str, Any]:
    """Called by Sphinx."""
    app.connect("doctree-read", mark_words)
    app.add_directive("profile-table", ProfileTable)
    app.add_directive("item-table", ItemTable)
    app.add_directive("item-fields", ItemFields)
    app.add_directive("records", Records)
    app.add_directive("mode-table", ModeTable)
    app.add_directive("discard-table", DiscardTable)
    app.add_directive("url-examples", UrlExamples)
    app.add_directive("cli-help", CliHelp)
    app.add_directive("option-table", OptionTable)
    app.add_directive("authority-table", AuthorityTable)
    app.add_directive("supervision-table", SupervisionTable)
    app.add_directive("stop-table", StopTable)
    app.add_directive("block-table", BlockTable)
    app.add_directive("ending-table", EndingTable)
    app.add_directive("errata-index", ErrataIndex)
    app.add_directive("layer-list", LayerList)
    app.add_directive("contract-list", ContractList)
    return {"version": "1", "parallel_read_safe": True, "parallel_write_safe": True}
