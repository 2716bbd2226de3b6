"""A command on a pseudo-terminal of its own, as a person has it in front of them."""

from __future__ import annotations

import contextlib
import fcntl
import os
import pty
import select
import struct
import subprocess
import sys
import termios
import time
from collections.abc import Iterator, Mapping

from tests.apps.cli.conftest import ROOT
from tests.waiting import PATIENCE


class Terminal:
    """A command, what it has shown so far, and keys for it.

    Attributes:
        shown: What arrived on the terminal.
    """

    def __init__(
        self, *arguments: str, columns: int = 100, environment: Mapping[str, str] | None = None
    ) -> None:
        self.shown = ""
        self._main, side = pty.openpty()
        fcntl.ioctl(side, termios.TIOCSWINSZ, struct.pack("HHHH", 24, columns, 0, 0))
        kept = {k: v for k, v in os.environ.items() if not k.startswith("M100LINK_")}
        kept.pop("COLUMNS", None)
        self._process = subprocess.Popen(
            [sys.executable, "-m", "m100link", *arguments],
            stdin=side,
            stdout=side,
            stderr=side,
            cwd=ROOT,
            env=kept | {"TERM": "xterm", "NO_COLOR": "1"} | dict(environment or {}),
            start_new_session=True,
            # Keys such as Ctrl-C are signals only on a controlling terminal.
            preexec_fn=lambda: fcntl.ioctl(0, termios.TIOCSCTTY, 0),
        )
        os.close(side)

    def read_until(self, text: str) -> None:
        """Wait until it was shown."""
        end = time.monotonic() + PATIENCE
        while text not in self.shown:
            goes_on = time.monotonic() < end and self._read()
            assert goes_on, f"no {text!r} in {self.shown}"

    def type(self, text: str) -> None:
        """Press these keys."""
        os.write(self._main, text.encode())

    def end(self) -> int:
        """Wait until it ends; its exit status."""
        end = time.monotonic() + PATIENCE
        while time.monotonic() < end and self._read():
            pass
        return self._process.wait(PATIENCE)

    def close(self) -> None:
        """End it, if it runs."""
        if self._process.poll() is None:
            self._process.kill()
            self._process.wait(PATIENCE)
        os.close(self._main)

    def _read(self) -> bool:
        has_ended = self._process.poll() is not None  # before the look: then it showed all
        ready, _, _ = select.select([self._main], [], [], 0.2)
        if not ready:
            return not has_ended
        try:
            data = os.read(self._main, 65536)
        except OSError:  # so Linux says that the other side was closed
            return False
        self.shown += data.decode(errors="replace")
        return bool(data)


@contextlib.contextmanager
def terminal(
    *arguments: str, columns: int = 100, environment: Mapping[str, str] | None = None
) -> Iterator[Terminal]:
    """A command on a terminal of so many columns."""
    running = Terminal(*arguments, columns=columns, environment=environment)
    try:
        yield running
    finally:
        running.close()
