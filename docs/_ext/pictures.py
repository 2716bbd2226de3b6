"""Pictures that are made of the code they show, so that they cannot differ from it.

They take the page's own colours, light and dark, and are left out where a builder makes no HTML::

    ```{state-picture} authority          transitions of control authority
    ```{state-picture} block              transitions of a control block
    ```{layer-picture}                    the layers of the import contract
    ```{frame-picture}                    a frame, made by the encoder, field by field
    ```{exchange-picture} lost-ack        a request, played by two real endpoints
    ```{axes-picture}                     where the axes point
    ```{mode-picture}                     what a positive value does in each of the fourteen modes
    ```{wiring-picture}                   aircraft, adapter, computer

State pictures need `dot` of Graphviz; without it the table beside them stands alone.
"""

from __future__ import annotations

import re
import shutil
import subprocess
from collections.abc import Iterable, Iterator
from enum import Enum
from typing import Any, ClassVar

from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util import logging
from sphinx.util.docutils import SphinxDirective
from svg import STYLE, Drawing, picture
from tables import import_contracts

from m100link.flight import authority, lifecycle
from m100link.protocol import firmware
from m100link.protocol.commands.activation import GetVersion
from m100link.protocol.setpoint import ControlMode, Horizontal, Vertical, Yaw
from m100link.session.endpoint import Endpoint
from m100link.wire import Frame, FrameDecoder, encode_frame

_logger = logging.getLogger(__name__)

Transitions = dict[Any, dict[Any, Any]]


class PictureDirective(SphinxDirective):
    """A picture; subclasses draw it."""

    def drawn(self) -> tuple[str, str]:
        """The SVG element, and what it shows in words."""
        raise TypeError(f"{type(self).__name__} draws nothing")

    def run(self) -> list[nodes.Node]:
        """The picture as a document node."""
        return [picture(*self.drawn())]


# -- states --------------------------------------------------------------------------------------


def _words(member: Enum) -> str:
    return member.name.lower().replace("_", " ")


def _edges(transitions: Transitions) -> Iterator[tuple[Enum, Enum, str]]:
    """One edge from each state to each other, with all that leads along it."""
    causes = set(lifecycle.StopCause)
    for before, ways in transitions.items():
        along: dict[Enum, list[Any]] = {}
        for what, after in ways.items():
            along.setdefault(after, []).append(what)
        for after, inputs in along.items():
            is_any_cause = causes <= set(inputs)
            named = [_words(what) for what in inputs if not (is_any_cause and what in causes)]
            yield before, after, "\\n".join([*named, *(["any cause"] if is_any_cause else [])])


def dot_of(transitions: Transitions) -> str:
    """A table of states as a graph in the language of `dot`."""
    lines = ["digraph {", "bgcolor=transparent; nodesep=0.12; ranksep=0.5"]
    lines.append('node [shape=box, style="rounded,filled", fillcolor=lightgrey]')
    lines.append('node [fontname="sans-serif", fontsize=11]')
    lines.append('edge [fontname="sans-serif", fontsize=9, arrowsize=0.7]')
    lines += [f'{state.name} [label="{_words(state)}"]' for state in transitions]
    lines += [
        f'{before.name} -> {after.name} [label="{words}"]'
        for before, after, words in _edges(transitions)
    ]
    return "\n".join([*lines, "}"])


def _in_page_colours(svg: str) -> str:
    svg = re.sub(r"^.*?(?=<svg)", "", svg, flags=re.DOTALL)
    svg = re.sub(r"<title>.*?</title>", "", svg)  # names of nodes, shown when the mouse rests
    svg = re.sub(r'width="([\d.]+)pt" height="[\d.]+pt"', r'width="\1pt"', svg)
    svg = svg.replace("lightgrey", "var(--color-background-secondary)")
    svg = re.sub(r'(fill|stroke)="black"', r'\1="currentColor"', svg)
    svg = svg.replace("<text ", '<text fill="currentColor" ')
    return svg.replace("<svg ", f'<svg style="{STYLE}" ', 1)


class StatePicture(PictureDirective):
    """States and what leads from one to another."""

    required_arguments = 1
    TABLES: ClassVar[dict[str, Transitions]] = {
        "authority": authority.TRANSITIONS,
        "block": lifecycle.TRANSITIONS,
    }

    def run(self) -> list[nodes.Node]:
        """The picture, or nothing and a remark where there is no Graphviz."""
        if shutil.which("dot") is None:
            _logger.info("no `dot` of Graphviz: the picture of %s is left out", self.arguments[0])
            return []
        return super().run()

    def drawn(self) -> tuple[str, str]:
        """Laid out by Graphviz."""
        name = self.arguments[0]
        transitions = self.TABLES[name]
        made = subprocess.run(
            ["dot", "-Tsvg"], input=dot_of(transitions), capture_output=True, text=True, check=True
        )
        said = "; ".join(
            f"from {_words(before)} to {_words(after)}" for before, after, _ in _edges(transitions)
        )
        return _in_page_colours(made.stdout), f"States of {name}: {said}"


# -- the house -----------------------------------------------------------------------------------


class LayerPicture(PictureDirective):
    """The layers, the highest on top."""

    def drawn(self) -> tuple[str, str]:
        """A box for each layer; those of a folder are wider than those of one file."""
        layers = [layer.removeprefix("m100link.") for layer in import_contracts()[0]["layers"]]
        height = 30
        drawing = Drawing(430, height * len(layers) + 10)
        for index, layer in enumerate(layers):
            y = 5 + index * height
            drawing.box(5, y, 300, height - 6)
            drawing.text(155, y + 17, layer, code=True)
        drawing.arrow(330, 10, 330, height * len(layers) - 4)
        drawing.text(342, height * len(layers) / 2, "may import", at="start")
        return drawing.svg(), f"Layers from the top down: {', '.join(layers)}"


# -- frames and sessions -------------------------------------------------------------------------

# Bytes and names as the reference has them; the sum is checked against a frame of the encoder.
_FIELDS = (
    (1, "SOF"),
    (2, "LEN, VER"),
    (1, "SESSION, A"),
    (1, "PAD, ENC"),
    (3, "reserved"),
    (2, "SEQ"),
    (2, "CRC16"),
)


class FramePicture(PictureDirective):
    """One frame, byte by byte."""

    def drawn(self) -> tuple[str, str]:
        """The version query, as the encoder makes it."""
        data = GetVersion().encode(firmware.PROFILES["3.1"])
        wire = encode_frame(data, session=2, sequence=0)
        [frame] = FrameDecoder().feed(wire)
        fields = [*_FIELDS, (len(frame.data), "DATA"), (4, "CRC32")]
        if sum(size for size, _ in fields) != len(wire):
            raise self.error("the fields do not make a frame")
        unit = 38
        drawing = Drawing(unit * len(wire) + 10, 112)
        at = 0
        for size, name in fields:
            x = 5 + at * unit
            drawing.box(x, 24, size * unit, 34, soft=name not in ("DATA", "CRC32"))
            for index, byte in enumerate(wire[at : at + size]):
                drawing.text(x + (index + 0.5) * unit, 46, f"{byte:02x}", code=True)
            drawing.text(x + 3, 16, str(at), at="start", size=10)
            # Names that are wider than their byte stand on two lines in turns.
            for row, part in enumerate(name.split(", ")):
                drawing.text(x + size * unit / 2, 76 + 14 * row, part, size=10, bold=True)
            at += size
        covered = 10 * unit + 5
        drawing.line(5, 104, covered, 104, dashed=True)
        drawing.text(
            covered + 6, 108, "CRC16 covers this; CRC32 all before it", at="start", size=10
        )
        return drawing.svg(), f"A frame of {len(wire)} bytes: {', '.join(n for _, n in fields)}"


class ExchangePicture(PictureDirective):
    """A reliable request with something lost on the way."""

    required_arguments = 1
    LOST: ClassVar[dict[str, tuple[int, ...]]] = {"lost-command": (0,), "lost-ack": (1,)}

    def drawn(self) -> tuple[str, str]:
        """What two endpoints send each other, with the time-out of one try."""
        messages = list(self._played(self.LOST[self.arguments[0]]))
        step, left, right = 44, 130, 470
        drawing = Drawing(600, 56 + step * len(messages))
        for x, name in ((left, "program"), (right, "aircraft")):
            drawing.text(x, 18, name, bold=True)
            drawing.line(x, 28, x, 50 + step * len(messages))
        for index, (is_ack, text, arrives, effect) in enumerate(messages):
            y = 52 + index * step
            start, end = (right, left) if is_ack else (left, right)
            reached = end if arrives else start + (end - start) * 0.6
            drawing.arrow(start, y, reached, y + 14, dashed=not arrives)
            if not arrives:
                drawing.text(reached + (12 if not is_ack else -12), y + 20, "✕", bold=True)
            drawing.text((left + right) / 2, y - 2, text, size=11)
            side = ("end", left - 8) if is_ack else ("start", right + 8)
            drawing.text(side[1], y + 18, effect, at=side[0], size=11)
        said = "; ".join(f"{text}, {effect or 'lost'}" for _, text, _, effect in messages)
        return drawing.svg(), f"A request on a reliable session: {said}"

    @staticmethod
    def _played(lost: Iterable[int]) -> Iterator[tuple[bool, str, bool, str]]:
        """Whether it is an ack, what it is, whether it arrives, and what it does there."""
        host, aircraft = Endpoint(first_sequence=7), Endpoint()
        host.request(b"\x00\x00", now=0.0, timeout=0.5, tries=3)
        now, count = 0.0, 0
        while True:
            for wire in host.output():
                arrives, count = count not in lost, count + 1
                effect = ""
                if arrives:
                    new = aircraft.receive_data(wire, now)
                    for event in new:
                        assert isinstance(event, Frame)
                        aircraft.acknowledge(event, b"\x00", now=now)
                    effect = "executed" if new else "from memory"
                yield False, f"session 2, number 7, {now:g} s", arrives, effect
            for wire in aircraft.output():
                arrives, count = count not in lost, count + 1
                effect = ""
                if arrives:
                    effect = "answered" if host.receive_data(wire, now) else "counted"
                yield True, "ack of 7", arrives, effect
                if arrives:
                    return
            now = host.next_wakeup() or now
            host.handle_timer(now)


# -- axes and modes ------------------------------------------------------------------------------


def _aircraft_from_above(drawing: Drawing, x: float, y: float, size: float) -> None:
    arm = size * 0.7
    drawing.line(x - arm, y - arm, x + arm, y + arm)
    drawing.line(x - arm, y + arm, x + arm, y - arm)
    for dx in (-arm, arm):
        for dy in (-arm, arm):
            drawing.circle(x + dx, y + dy, size * 0.38)
    drawing.path(
        f"M{x - size * 0.2} {y + size * 0.1}L{x} {y - size * 0.35}L{x + size * 0.2} "
        f"{y + size * 0.1}"
    )  # its nose


class AxesPicture(PictureDirective):
    """From above and from the left."""

    def drawn(self) -> tuple[str, str]:
        """Ground frame, body frame, turning; climbing and pitching."""
        drawing = Drawing(720, 250)
        _aircraft_from_above(drawing, 130, 130, 34)
        for dx, dy, name, at, tx, ty in (
            (0, -85, "north / forward", "middle", 0, -92),
            (100, 0, "east / right", "start", 60, 18),
        ):
            drawing.arrow(130, 130, 130 + dx, 130 + dy)
            drawing.text(130 + tx, 130 + ty, name, at=at, size=11)
        drawing.path("M95 205A80 80 0 0 1 60 100", head=True)
        drawing.text(48, 226, "yaw, positive clockwise from above", at="start", size=11)
        drawing.text(130, 16, "from above, heading north", bold=True)
        self._from_the_left(drawing, 400, "up, height: positive upwards", tilted=False)
        self._from_the_left(drawing, 600, "pitch negative: nose down, flies forward", tilted=True)
        said = (
            "From above: north or forward is up, east or right is right, yaw is positive "
            "clockwise. From the left: climb rate and height are positive upwards; a negative "
            "pitch lowers the nose and flies forward."
        )
        return drawing.svg(), said

    @staticmethod
    def _from_the_left(drawing: Drawing, x: float, words: str, *, tilted: bool) -> None:
        drawing.text(x, 16, "from the left" + (", tilted" if tilted else ""), bold=True)
        lean = 16 if tilted else 0
        # The nose is on the left.
        drawing.line(x - 60, 130 + lean, x + 60, 130 - lean)
        for side in (-55, 55):
            y = 130 - lean * side / 60
            drawing.line(x + side, y, x + side, y - 16)
            drawing.line(x + side - 24, y - 16, x + side + 24, y - 16)
        if tilted:
            drawing.arrow(x - 70, 175, x - 120, 175)
            drawing.text(x - 60, 179, "flies this way", at="start", size=11)
        else:
            drawing.arrow(x, 118, x, 50)
        drawing.text(x, 226, words, size=11)


_HORIZONTAL = {
    # What the constructor calls it, and where a positive value goes: right and up on paper.
    Horizontal.TILT: (("roll +", (1, 0)), ("pitch +", (0, -1))),
    Horizontal.VELOCITY: (("north +", (0, 1)), ("east +", (1, 0))),
    Horizontal.POSITION_OFFSET: (("north +", (0, 1)), ("east +", (1, 0))),
}
_VERTICAL = {
    Vertical.VELOCITY: "up +",
    Vertical.HEIGHT: "height",
    Vertical.THRUST: "thrust %",
}
_YAW = {Yaw.ANGLE: "yaw °", Yaw.RATE: "yaw rate +"}


class ModePicture(PictureDirective):
    """The fourteen modes side by side."""

    def drawn(self) -> tuple[str, str]:
        """One cell per mode in the document's order, seen from above, heading north."""
        modes = sorted(
            (
                m
                for h in Horizontal
                for v in Vertical
                for y in Yaw
                if (m := ControlMode(h, v, y)).is_legal
            ),
            key=lambda mode: mode.number,
        )
        columns, width, height = 4, 178, 148
        drawing = Drawing(columns * width, height * -(-len(modes) // columns))
        for index, mode in enumerate(modes):
            x, y = index % columns * width, index // columns * height
            self._cell(drawing, mode, x, y, width, height)
        names = ", ".join(f"{mode.number} {_words(mode.horizontal)}" for mode in modes)
        return drawing.svg(), f"What a positive value does in each control mode: {names}"

    @staticmethod
    def _cell(
        drawing: Drawing, mode: ControlMode, x: float, y: float, width: float, height: float
    ) -> None:
        drawing.box(x + 4, y + 4, width - 8, height - 8)
        title = f"{mode.number} {_words(mode.horizontal)}"
        drawing.text(x + 12, y + 22, title, at="start", size=12, bold=True)
        cx, cy = x + 62, y + 88
        _aircraft_from_above(drawing, cx, cy, 14)
        for name, (dx, dy) in _HORIZONTAL[mode.horizontal]:
            drawing.arrow(cx, cy, cx + 40 * dx, cy - 40 * dy)
            if dx:
                drawing.text(cx + 22, cy - 6, name, at="start", size=9)
            else:
                drawing.text(cx - 6, cy - 34 * dy + 3, name, at="end", size=9)
        vx = x + width - 44
        if mode.vertical is Vertical.HEIGHT:
            drawing.line(vx - 12, y + 52, vx + 12, y + 52)
            drawing.line(vx, y + 52, vx, y + 92, dashed=True)
        else:
            drawing.arrow(vx, y + 92, vx, y + 52)
        drawing.text(vx, y + 106, _VERTICAL[mode.vertical], size=10)
        sweep = f"M{vx - 12:g} {y + 126:g}A14 10 0 0 1 {vx + 12:g} {y + 126:g}"
        drawing.path(sweep, head=mode.yaw is Yaw.RATE)
        drawing.text(vx - 18, y + 130, _YAW[mode.yaw], at="end", size=10)


class WiringPicture(PictureDirective):
    """Three wires."""

    def drawn(self) -> tuple[str, str]:
        """Aircraft, adapter, computer."""
        drawing = Drawing(640, 180)
        drawing.box(5, 30, 170, 140)
        drawing.text(90, 22, "Matrice 100, UART_CAN2", bold=True)
        drawing.box(345, 30, 130, 140)
        drawing.text(410, 22, "adapter, 3.3 V", bold=True)
        drawing.box(545, 70, 90, 60)
        drawing.text(590, 104, "computer")
        drawing.line(475, 100, 545, 100)
        drawing.text(510, 92, "USB", size=11)
        for y, left, right in ((65, "TX", "RX"), (100, "RX", "TX"), (135, "GND", "GND")):
            drawing.text(165, y + 4, left, at="end", code=True)
            drawing.text(355, y + 4, right, at="start", code=True)
            if left == "TX":
                drawing.arrow(175, y, 345, y)
            elif left == "RX":
                drawing.arrow(345, y, 175, y)
            else:
                drawing.line(175, y, 345, y)
        drawing.text(260, 165, "no 5 V, no 3.3 V", size=11)
        said = "TX of the aircraft goes to RX of the adapter, RX to TX, and GND to GND; no supply."
        return drawing.svg(), said


def link_to_full_size(_app: Sphinx, document: nodes.document) -> None:
    """Sphinx links an image that has a width to its file, where a phone can enlarge it."""
    for image in document.findall(nodes.image):
        image.setdefault("width", "100%")


def setup(app: Sphinx) -> dict[str, Any]:
    """Register the directives."""
    app.connect("doctree-read", link_to_full_size)
    for name, directive in {
        "axes-picture": AxesPicture,
        "exchange-picture": ExchangePicture,
        "frame-picture": FramePicture,
        "layer-picture": LayerPicture,
        "mode-picture": ModePicture,
        "state-picture": StatePicture,
        "wiring-picture": WiringPicture,
    }.items():
        app.add_directive(name, directive)
    return {"parallel_read_safe": True}
