"""A lease that one command of a pilot holds, and others of the same account order under.

The proof of it lies in a file that nobody else can read, as long as the command runs that holds it.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

from m100link.apps.fleet.keys import check_name
from m100link.errors import UsageError
from m100link.errors.texts import read_json
from m100link.log.folder import state_folder

__all__ = ["borrowed", "lease_file", "shared"]


def lease_file(site: str, name: str, environment: Mapping[str, str] | None = None) -> Path:
    """Where the proof lies: in the folder of the user's session, else in that of the state."""
    known = os.environ if environment is None else environment
    session = known.get("XDG_RUNTIME_DIR", "")
    base = Path(session) / "m100link" if Path(session).is_absolute() else state_folder(known)
    return base / "leases" / check_name(site, "a site") / f"{check_name(name)}.json"


@contextmanager
def shared(site: str, name: str, proof: tuple[int, str]) -> Iterator[None]:
    """Let other commands of this account order under a lease while the block runs.

    Args:
        site: Of the fleet.
        name: Of the aircraft.
        proof: Number and secret of the lease.

    Raises:
        UsageError: The file cannot be written.
    """
    path = lease_file(site, name)
    fence, token = proof
    text = json.dumps({"fence": fence, "token": token})
    try:
        path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        path.unlink(missing_ok=True)  # of one that was killed
        handle = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW, 0o600)
        with os.fdopen(handle, "w", encoding="ascii") as file:
            file.write(text)
    except OSError as error:
        raise UsageError(f"{path}: {error.strerror or error}") from error
    try:
        yield
    finally:
        if path.is_file() and path.read_text(encoding="ascii") == text:  # else it is another's
            path.unlink(missing_ok=True)


def borrowed(site: str, name: str) -> tuple[int, str]:
    """Number and secret of the lease that another command of this account holds.

    Raises:
        UsageError: There is none.
    """
    path = lease_file(site, name)
    try:
        found = read_json(path.read_bytes())
        return int(found["fence"]), str(found["token"])
    except FileNotFoundError:
        raise UsageError(
            f"no command of this account has control of {name}",
            cause="orders to a mission come under the lease of who flies",
            remedy=f"m100link fleet lease {name}, or fleet mission fly {name} FILE, in another "
            f"shell; m100link fleet stop {name} needs no lease",
        ) from None
    except (OSError, ValueError, KeyError, TypeError, OverflowError) as error:
        raise UsageError(f"{path} cannot be read: {error}", remedy="remove it") from error
