"""What a command draws on a terminal, as an SVG that moves.

The terminal is recorded as it is written to, with its times. Each line that ever stood there is in
the picture once; a frame is a list of them, and a style sheet shows one frame after the other.
"""

from __future__ import annotations

import os
import pty
import re
import select
import subprocess
import time
from collections.abc import Sequence
from html import escape
from itertools import pairwise
from pathlib import Path

from rich.text import Text

from tests.browser.screen import settled

__all__ = ["film", "record"]

_QUIET_S = 0.05  # a terminal on which nothing is written for so long shows a whole drawing
_COLUMN, _LINE, _MARGIN = 8.4, 17, 14
_COLOURS = {1: ("r", "#ef2929"), 2: ("g", "#8ae234"), 3: ("y", "#fce94f")}
"""What is used of a terminal's colours, by number: a class, and how it looks on dark ground."""

_WORDS = re.compile("[^ \u2800]+(?: [^ \u2800]+)*")
"""A braille character without dots is a blank, too."""

Frame = tuple[float, list[str]]
"""When it appeared, s, and its lines, with the escape sequences of their colours."""


def record(
    command: Sequence[str], *, columns: int, lines: int, folder: Path | None = None
) -> list[Frame]:
    """Run a command on a terminal of that size, and in that folder, until it ends."""
    master, slave = pty.openpty()
    size = {"COLUMNS": str(columns), "LINES": str(lines), "TERM": "xterm-256color"}
    frames: list[Frame] = []
    text = b""
    environment = os.environ | size
    with subprocess.Popen(
        command, stdout=slave, stderr=slave, env=environment, cwd=folder
    ) as running:
        os.close(slave)
        began_at = time.monotonic()
        is_open = True
        while is_open:
            readable, _, _ = select.select([master], [], [], _QUIET_S)
            if readable:
                try:
                    text += os.read(master, 65_536)
                except OSError:  # the other end was closed
                    is_open = False
            if not readable or not is_open:
                shown = settled(text.decode(errors="replace")).rstrip("\n").split("\n")
                if not frames or frames[-1][1] != shown:
                    frames.append((time.monotonic() - began_at, shown))
        assert running.wait() == 0
    os.close(master)
    return frames


def film(frames: Sequence[Frame], *, title: str, columns: int, hold_s: float) -> str:
    """The frames as one SVG, again and again; the last one stands for ``hold_s``."""
    known: dict[str, int] = {}
    height = 1 + max(len(lines) for _, lines in frames)
    pictures = []
    for number, (_, lines) in enumerate(frames):
        uses = []
        for row, line in enumerate([f"\x1b[2m$\x1b[0m {title}", *lines]):
            if Text.from_ansi(line).plain.strip():
                name = known.setdefault(line, len(known))
                uses.append(f'<use href="#l{name}" y="{(number * height + row) * _LINE}"/>')
        pictures.append("".join(uses))
    defined = "".join(f'<g id="l{name}">{_drawn(line)}</g>' for line, name in known.items())
    width, tall = columns * _COLUMN + 2 * _MARGIN, height * _LINE + 2 * _MARGIN
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width:.0f} {tall}" '
        f'width="{width:.0f}" height="{tall}"><title>{escape(title)}</title>'
        f"<style>{_sheet([at for at, _ in frames], hold_s, height * _LINE)}</style>"
        f"<defs>{defined}</defs>"
        f'<rect width="100%" height="100%" rx="8" fill="#1d1f21"/>'
        f'<svg x="{_MARGIN}" y="{_MARGIN}" width="{columns * _COLUMN:.0f}" '
        f'height="{height * _LINE}"><g class="film">{"".join(pictures)}</g></svg></svg>\n'
    )


def _sheet(times: Sequence[float], hold_s: float, step: int) -> str:
    whole = times[-1] + hold_s
    stops = [(0.0, 0), *((100 * at / whole, number) for number, at in enumerate(times) if number)]
    keys = "".join(f"{at:.2f}%{{transform:translateY(-{n * step}px)}}" for at, n in stops)
    assert all(earlier < later for (earlier, _), (later, _) in pairwise(stops))
    last = f"transform:translateY(-{(len(times) - 1) * step}px)"
    return (
        "text{font:14px monospace;fill:#d3d7cf;white-space:pre}.b{font-weight:bold}.d{opacity:.6}"
        + "".join(f".{name}{{fill:{colour}}}" for name, colour in _COLOURS.values())
        + f"@keyframes film{{{keys}100%{{{last}}}}}"
        + f".film{{animation:film {whole:.1f}s step-end infinite}}"
        + f"@media (prefers-reduced-motion){{.film{{animation:none;{last}}}}}"
    )


def _drawn(line: str) -> str:
    """A line, each of its pieces at its columns whatever the font is."""
    text = Text.from_ansi(line)
    styled = [""] * len(text.plain)
    for span in text.spans:
        style = span.style if not isinstance(span.style, str) else None
        number = style.color.number if style is not None and style.color is not None else None
        words = [_COLOURS[number][0]] if number in _COLOURS else []
        words += ["b"] * bool(style is not None and style.bold)
        words += ["d"] * bool(style is not None and style.dim)
        for at in range(span.start, min(span.end, len(styled))):
            styled[at] = " ".join(words)
    pieces = []
    begin = 0
    for end in range(1, len(styled) + 1):
        if end == len(styled) or styled[end] != styled[begin]:
            pieces.append(_piece(text.plain[begin:end], begin, styled[begin]))
            begin = end
    return f'<text y="{_LINE - 4}">{"".join(pieces)}</text>'


def _piece(text: str, column: int, classes: str) -> str:
    """Words of one style; what blanks separate stands at columns of its own."""
    named = f' class="{classes}"' if classes else ""
    return "".join(
        f'<tspan x="{(column + found.start()) * _COLUMN:.1f}" '
        f'textLength="{len(found[0]) * _COLUMN:.1f}"{named}>{escape(found[0], quote=False)}</tspan>'
        for found in _WORDS.finditer(text)
    )
