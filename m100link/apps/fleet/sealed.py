"""Records in a file that reveals when records were changed or are missing.

A line has a checksum, its number, and the number of the first line of its file. Beside the file
is a mark: the number of the newest line. So a reader notices a changed line, a missing line, an end
that was cut off, and a file that was emptied or removed.
"""

from __future__ import annotations

import json
import re
from dataclasses import dataclass, field
from typing import Any
from zlib import crc32

from m100link.errors.texts import read_json

__all__ = ["Mark", "Words", "seal", "words"]

_LINE = re.compile(r"([0-9a-f]{8}) ((\d{1,18}) (\d{1,18}) (\{.*\}))", re.DOTALL)
_MARK = re.compile(r"([0-9a-f]{8}) ((\d{18}) (\d{18}))\n")


@dataclass(frozen=True, slots=True)
class Mark:
    """The mark: which records exist. Its file always has the same length.

    Attributes:
        newest: Number of the newest record; 0: none was written yet.
        first: Number of the first record of the file.
    """

    newest: int
    first: int

    def __bytes__(self) -> bytes:
        body = f"{self.newest:018d} {self.first:018d}"
        return f"{crc32(body.encode()):08x} {body}\n".encode()

    @staticmethod
    def read(data: bytes) -> Mark | None:
        """What was written; None when it is not what was."""
        found = _MARK.fullmatch(data.decode("ascii", "replace"))
        if found is None or crc32(found[2].encode()) != int(found[1], 16):
            return None
        return Mark(int(found[3]), int(found[4]))


def seal(number: int, first: int, content: dict[str, Any]) -> str:
    """Return a line of a file.

    Args:
        number: Its number; one more than that of the line before.
        first: Number of the first line of the file.
        content: Its content.
    """
    body = f"{number} {first} {json.dumps(content)}"
    return f"{crc32(body.encode()):08x} {body}\n"


@dataclass
class Words:
    """The content of a file.

    Attributes:
        kept: The readable records by number, in order.
        damaged: Number of records that are damaged or missing.
        sure_from: From this number on none is lost.
        newest: The greatest number that was ever written.
    """

    kept: dict[int, dict[str, Any]] = field(default_factory=dict)
    damaged: int = 0
    sure_from: int = 0
    newest: int = 0


def words(data: bytes, mark: bytes) -> Words:
    """Read a file and its mark.

    A file of an older version has lines of JSON alone, and no mark.

    Args:
        data: The file; nothing when there is none.
        mark: Its mark; nothing when there is none.
    """
    # What has no end was cut off by the loss of power as it was written: it had not begun.
    lines = data.decode("ascii", "replace").split("\n")[:-1]
    read = [_unsealed(line) for line in lines]
    known = {number: (first, content) for number, first, content in filter(None, read)}
    marked = Mark.read(mark)
    if not known and (not mark or (marked is not None and not marked.newest)):
        return _of_older_version(lines)
    first, newest = (0, 0) if marked is None else (marked.first, marked.newest)
    if known and max(known) >= newest:
        newest = max(known)
        first = known[newest][0]
    missing = [number for number in range(first, newest + 1) if number not in known]
    # A line of nonsense that stands for none, or a mark that is gone: nobody knows for what.
    is_odd = None in read or marked is None
    return Words(
        {number: known[number][1] for number in sorted(known)},
        len(missing) or int(is_odd),
        newest + 1 if is_odd and not missing else max(missing, default=-1) + 1,
        newest,
    )


def _of_older_version(lines: list[str]) -> Words:
    found = Words()
    for number, line in enumerate(lines, 1):
        content = _json(line)
        if content is None:
            found.damaged += 1
            found.sure_from = number + 1
        else:
            found.kept[number] = content
        found.newest = number
    return found


def _unsealed(line: str) -> tuple[int, int, dict[str, Any]] | None:
    found = _LINE.fullmatch(line)
    if found is None or crc32(found[2].encode()) != int(found[1], 16):
        return None
    content = _json(found[5])
    return None if content is None else (int(found[3]), int(found[4]), content)


def _json(line: str) -> dict[str, Any] | None:
    try:
        content = read_json(line)
    except ValueError:
        return None
    return content if isinstance(content, dict) else None
