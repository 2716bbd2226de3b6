"""``m100link log plot``: a flight as a page or a picture."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Annotated

from cyclopts import Parameter

from m100link.apps.cli.common import out
from m100link.apps.cli.options import Firmware
from m100link.apps.cli.progress import reading, status
from m100link.errors import UsageError
from m100link.log.story import Story, read_story

__all__ = ["cannot_write", "new_file", "plot", "write_new"]


def plot(
    file: Path,
    /,
    *,
    output: Annotated[Path | None, Parameter(name=("--output", "-o"))] = None,
    firmware: Firmware | None = None,
) -> int:
    """Draw a flight: track, height, speeds, battery, line, phases, alarms, commands.

    A page (.html) needs nothing but a browser, and no network; a picture (.png) needs matplotlib.

    Args:
        file: The log.
        output: A new file whose suffix, .html or .png, says which; by default FILE with .html.
        firmware: Profile to read it by; by default that of the flight.
    """
    target = output or file.with_suffix(".html")
    if target.suffix.lower() not in (".html", ".htm", ".png"):
        raise UsageError(
            f"{target} is neither a page nor a picture", remedy="a name that ends in .html or .png"
        )
    if target.exists():
        raise _is_there(target)
    with reading(file, passes=2) as flight:
        story = read_story(flight, firmware=firmware)
    write_new(target, _drawn(story, target))
    out.print(f"drawn into {target}", soft_wrap=True)
    return status(flight)


def _drawn(story: Story, target: Path) -> bytes:
    if target.suffix.lower() == ".png":
        from m100link.log.picture import picture  # loads matplotlib

        return picture(story)
    from m100link.log.page import page

    return page(story).encode()


def write_new(target: Path, data: bytes) -> None:
    """Write a file that must not be there yet.

    Raises:
        UsageError: It is, or it cannot be written.
    """
    with new_file(target) as stream:
        stream.write(data)


@contextlib.contextmanager
def new_file(target: Path) -> Iterator[IO[bytes]]:
    """A file that must not be there yet; half of one is not left behind.

    Raises:
        UsageError: It is, or it cannot be written.
    """
    try:
        stream = target.open("xb")
    except OSError as error:
        raise cannot_write(target, error) from error
    try:
        with stream:
            yield stream
    except OSError as error:
        target.unlink()
        raise cannot_write(target, error) from error
    except BaseException:
        target.unlink()
        raise


def cannot_write(target: Path, error: OSError) -> UsageError:
    """What is told of a file that cannot be written."""
    if isinstance(error, FileExistsError):
        return _is_there(target)
    return UsageError(
        f"{target} cannot be written: {error.strerror or error}", remedy="-o with another place"
    )


def _is_there(target: Path) -> UsageError:
    return UsageError(f"{target} is there already", remedy="-o with another name")
