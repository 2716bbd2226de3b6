"""Files with a secret: one reader and one policy for keys and tokens.

A secret that others can read is not used: the error names the file and the command that closes it.
A file is read only as far as a secret can be long, so that a wrong path costs nothing.
"""

from __future__ import annotations

import os
import stat
from pathlib import Path

from m100link.errors import UsageError
from m100link.wire.cipher import Key

__all__ = ["MAX_SECRET_SIZE", "read_key", "read_token"]

MAX_SECRET_SIZE = 4096
"""Longest file with a secret, bytes."""

_RAW_KEY_SIZE = 32


def read_key(path: Path) -> Key:
    """The key in a file: 64 hex digits, white space around them ignored, or 32 raw bytes.

    Raises:
        UsageError: It cannot be read, is too long, or others can read it.
        BadKey: What is there is not a key; it is not quoted.
    """
    data = _read(path, "key")
    if len(data) == _RAW_KEY_SIZE:
        return Key(data)
    return Key(_text(data, path, "key"))


def read_token(path: Path) -> str:
    """The text in a file, without the white space around it.

    Raises:
        UsageError: It cannot be read, is too long, others can read it, or it is not ASCII.
    """
    return _text(_read(path, "token"), path, "token").strip()


def _read(path: Path, what: str) -> bytes:
    place = path.expanduser()
    try:
        with place.open("rb") as file:
            # The open file is looked at, not the path: that may lead elsewhere by now.
            mode = stat.S_IMODE(os.fstat(file.fileno()).st_mode)
            data = file.read(MAX_SECRET_SIZE + 1)
    except OSError as error:
        raise UsageError(
            f"the {what} file {path} cannot be read: {error.strerror}",
            remedy="check the path, and who may read it",
        ) from error
    if mode & 0o077:
        raise UsageError(
            f"the {what} file {path} can be read by others (mode {mode:o})",
            remedy=f"chmod 600 {path}",
        )
    if len(data) > MAX_SECRET_SIZE:
        raise UsageError(f"{path} has more than {MAX_SECRET_SIZE} bytes: that is not a {what} file")
    return data


def _text(data: bytes, path: Path, what: str) -> str:
    try:
        return data.decode("ascii")
    except UnicodeDecodeError as error:
        raise UsageError(f"the {what} file {path} cannot be read: it is not ASCII text") from error
