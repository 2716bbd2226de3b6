"""Files that people write: one reader and one policy for keys and tokens.

A secret that others can read is not used: the error names the file and the command that closes it.
A file is read only as far as a secret can be long, so that a wrong path costs nothing.

A program replaces a file by :func:`replace_file`.
"""

from __future__ import annotations

import os
import secrets
import stat
import sys
from pathlib import Path
from typing import IO

from m100link.errors import UsageError
from m100link.errors.texts import read_path
from m100link.errors.usage import unread
from m100link.wire.cipher import Key

MAX_SECRET_SIZE = 4096  # longest file with a secret, bytes

_RAW_KEY_SIZE = 32


def read_key(path: Path) -> Key:
    """The key in a file: 64 hex digits, white space around them ignored, or 32 raw bytes.

    Raises ``UsageError``: it cannot be read, is too long, or others can read it. Raises ``BadKey``:
    what is there is not a key; it is not quoted.
    """
    data = _read(path, "key")
    if len(data) == _RAW_KEY_SIZE:
        return Key(data)
    return Key(_text(data, path, "key"))


def read_token(path: Path) -> str:
    """The text in a file, without the white space around it.

    Raises ``UsageError``: it cannot be read, is too long, others can read it, or it is not ASCII.
    """
    return _text(_read(path, "token"), path, "token").strip()


def mode_of(file: IO[bytes]) -> int:
    """Return who may do what with an open file, as POSIX has it; on Windows it says nothing: 0."""
    return 0 if sys.platform == "win32" else stat.S_IMODE(os.fstat(file.fileno()).st_mode)


def replace_file(path: Path, data: bytes, *, mode: int = 0o600) -> None:
    """Put a file in the place of another one; done when the disk has it, and its name.

    A reader sees the one before or this one, whole, also after a loss of power.

    ``mode``: its permissions from the first moment on, less the umask. Raises ``OSError``: the disk
    does not take it; as a rule the one before is there.
    """
    beside = path.with_name(f".{path.name}.{secrets.token_hex(4)}")
    file = open(beside, "xb", opener=lambda name, flags: os.open(name, flags, mode))  # noqa: SIM115
    try:
        with file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        beside.replace(path)
    except BaseException:
        beside.unlink(missing_ok=True)  # of a full disk it would take what is left
        raise
    keep_names(path.parent)


def locks(handle: int) -> bool:
    """Have an open file alone until it is closed, or the process ends; False: another program has.

    Raises ``UsageError``: this is Windows. Raises ``OSError``: the file system has no locks.
    """
    if sys.platform == "win32":
        raise UsageError(
            "on Windows m100link cannot keep two programs from writing the same files",
            cause="it knows the file locks of POSIX alone",
            remedy="run this part of a fleet on Linux or macOS",
        )
    import fcntl

    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True


def is_at(handle: int, path: Path) -> bool:
    """Whether an open file is the one that stands there."""
    try:
        return os.path.samestat(os.fstat(handle), path.stat())
    except FileNotFoundError:
        return False


def keep_names(folder: Path) -> None:
    """Wait until the disk has the names of the files in a folder, as they are now.

    Raises ``OSError``: it does not take them.
    """
    if sys.platform == "win32":
        return  # which opens no folder
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def _read(path: Path, what: str) -> bytes:
    place = read_path(path)
    try:
        with place.open("rb") as file:
            # The open file is looked at, not the path: that may lead elsewhere by now.
            mode = mode_of(file)
            data = file.read(MAX_SECRET_SIZE + 1)
    except OSError as error:
        raise unread(f"the {what} file {path}", error) from error
    if mode & 0o077:
        raise UsageError(
            f"the {what} file {path} can be read by others (mode {mode:o})",
            remedy=f"chmod 600 {path}",
        )
    if len(data) > MAX_SECRET_SIZE:
        raise UsageError(
            f"{path} has more than {MAX_SECRET_SIZE} bytes", remedy=f"name the {what} file"
        )
    return data


def _text(data: bytes, path: Path, what: str) -> str:
    try:
        return data.decode("ascii")
    except UnicodeDecodeError as error:
        raise UsageError(
            f"the {what} file {path} is not ASCII text", remedy=f"name the {what} file"
        ) from error
