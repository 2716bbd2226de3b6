"""What stands on a terminal after everything that was written to it."""

from __future__ import annotations

import re

__all__ = ["settled"]


def settled(text: str) -> str:
    """The lines as they stand in the end, where a display was drawn over itself."""
    lines: list[str] = []
    row = 0
    for part in re.split(r"(\x1b\[\d*A|\n)", text.replace("\r", "")):
        up = re.fullmatch(r"\x1b\[(\d*)A", part)
        if up is not None:
            row = max(0, row - int(up[1] or 1))
        elif part == "\n":
            row += 1
        else:
            lines += [""] * (row + 1 - len(lines))
            clean = re.sub(r"\x1b\[\?\d+[hl]|\x1b\[\d*K", "", part)
            lines[row] = clean if clean or "\x1b[2K" in part else lines[row]
    return "\n".join(lines)
