"""Tables of commands and their codes, made of the declarations themselves.

```{ack-codes} ActivationCode         an enum in m100link.protocol.codes
```{command-table}                    m100link.protocol.commands.registry.COMMANDS
```{command-classes}                  the classes of all of them
```{command-layouts}                  their fields, where the layout is fixed
```{answer-codes}                     the codes that answer them, a table for each
"""

from __future__ import annotations

import inspect
from collections.abc import Iterable, Sequence
from contextlib import suppress
from typing import TYPE_CHECKING, Any

from tables import SphinxDirective, TableDirective, home, sentence, table

from m100link.protocol import codes
from m100link.protocol.command import Command, Movement, Notification, Push, Request
from m100link.protocol.commands.missions import Answer
from m100link.protocol.commands.registry import COMMANDS
from m100link.protocol.fields import Laid, Layout

if TYPE_CHECKING:
    from sphinx.application import Sphinx
with suppress(ImportError):  # `m100link docs` shows the rows of tables without the builder
    from docutils import nodes
    from docutils.statemachine import StringList

_TYPES = {
    "B": "u8",
    "b": "i8",
    "H": "u16",
    "h": "i16",
    "I": "u32",
    "f": "f32",
    "d": "f64",
    "x": "u8",
}


class AckCodes(TableDirective):
    """Codes of one enum with meaning, cause and remedy."""

    required_arguments = 1

    def rows(self) -> Iterable[Sequence[str]]:
        """One row per member."""
        return _code_rows(getattr(codes, self.arguments[0]))


def _code_rows(enum: type[codes.AckCode]) -> Iterable[Sequence[str]]:
    yield "Code", "Name", "Meaning", "Likely cause", "What to do"
    for code in enum:
        number = f"``0x{code:04X}``" if code > 9 else f"``{int(code)}``"
        yield (
            number,
            f"``{code.name}``",
            sentence(code.meaning),
            sentence(code.cause),
            sentence(code.remedy),
        )


class AnswerCodes(SphinxDirective):
    """A section for each request that is answered by a code and nothing else."""

    def run(self) -> list[nodes.Node]:
        """In the order of the addresses."""
        return [
            self._section(command)
            for _, command in sorted(COMMANDS.items())
            if issubclass(command, Request) and issubclass(command.ANSWER, codes.AckCode)
            # Missions share theirs, which have a list of their own.
            if command.ANSWER is not codes.MissionCode
        ]

    @staticmethod
    def _section(request: type[Request[Any]]) -> nodes.section:
        name = f"codes-{request.NAME.replace('_', '-')}"
        section = nodes.section(ids=[name], names=[name])
        section += nodes.title(text=sentence(request.NAME.replace("_", " ")))
        section += table(_code_rows(request.ANSWER))
        return section


def _kind(command: type[Command]) -> str:
    kinds = {Request: "request", Push: "push", Movement: "movement", Notification: "notification"}
    return next(word for kind, word in kinds.items() if issubclass(command, kind))


def _summary(command: type[Command]) -> str:
    text = (inspect.getdoc(command) or "").split("\n\n")[0].replace("\n", " ")
    return sentence(text.removeprefix(f"{command.ADDRESS}, ").removesuffix("."))


class CommandTable(TableDirective):
    """Every command and push, as it declares itself."""

    def rows(self) -> Iterable[Sequence[str]]:
        """One row per address."""
        yield "Set/id", "Name", "Kind", "What it is", "Ack", "Level", "Since"
        for address, command in sorted(COMMANDS.items()):
            ack = f"``{command.ANSWER.__name__}``" if issubclass(command, Request) else "none"
            level = "" if issubclass(command, Notification) else str(command.LEVEL)
            yield (
                *(f"``{address}``", f"``{command.NAME}``", _kind(command), _summary(command)),
                *(ack, level, str(command.SINCE)),
            )


_DESCRIBED_BY_THE_KIND = (
    "ack_fields, encode_ack, fields, name, of, parse, parse_ack, problems, raw, record, shown, "
    "tail, unreadable, value"
)


class CommandClasses(SphinxDirective):
    """The classes of all commands, set by set."""

    def run(self) -> list[nodes.Node]:
        """What autodoc makes of each."""
        lines = ["```{eval-rst}"]
        command_set = None
        described: set[type] = set()
        for address, command in sorted(COMMANDS.items()):
            if address.command_set != command_set:
                command_set = address.command_set
                lines += [f".. rubric:: Set 0x{command_set:02X}", ""]
            answer = command.ANSWER if issubclass(command, Request) else object
            # Codes that stand beside their command; the others have a list of their own.
            is_beside = answer.__module__ == command.__module__ and answer not in described
            if is_beside and issubclass(answer, codes.AckCode | Answer):
                described.add(answer)
                lines += [f".. autoclass:: {home(answer)}", ""]
            lines += [f".. autoclass:: {home(command)}", "   :members:"]
            lines += [f"   :exclude-members: {_DESCRIBED_BY_THE_KIND}", ""]
        parsed = nodes.Element()
        source = "m100link.protocol.commands.registry"
        self.state.nested_parse(StringList([*lines, "```"], source=source), 0, parsed)
        return parsed.children


class Layouts(SphinxDirective):
    """Where the fields of each command with a fixed layout stand, and what they may be."""

    def run(self) -> list[nodes.Node]:
        """A rubric and a table each, in the order of the addresses."""
        return [
            node
            for address, command in sorted(COMMANDS.items())
            if issubclass(command, Laid) and command.LAYOUT.size > 1
            for node in (
                nodes.rubric(text=f"{command.NAME}, {address}, {command.LAYOUT.size} bytes"),
                table(self._rows(command.LAYOUT)),
            )
        ]

    @staticmethod
    def _rows(layout: Layout) -> Iterable[Sequence[str]]:
        yield "Offset", "Type", "Field", "Documented range"
        for offset, part in layout.offsets():
            names = ", ".join(f"``{name}``" for name in part.names)
            kind = (
                _TYPES.get(part.format)
                or f"{part.format[:-1]} × {_TYPES.get(part.format[-1], 'u8')}"
            )
            yield str(offset), kind, names or "reserved", part.limit


def setup(app: Sphinx) -> dict[str, Any]:
    """Called by Sphinx."""
    app.add_directive("ack-codes", AckCodes)
    app.add_directive("command-table", CommandTable)
    app.add_directive("command-classes", CommandClasses)
    app.add_directive("command-layouts", Layouts)
    app.add_directive("answer-codes", AnswerCodes)
    return {"version": "1", "parallel_read_safe": True, "parallel_write_safe": True}
