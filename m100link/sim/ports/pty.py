"""An aircraft behind a pseudo-terminal: to other programs a serial port like any other.

The slave side stays open here, so that programs may open and close it as often as they like. Nobody
may be reading: what the terminal cannot hold waits a moment in a bounded backlog; when nothing at
all has been read for a second, stale bytes are thrown away, so that a program that opens the port
gets fresh ones, as from a real UART.
"""

from __future__ import annotations

import contextlib
import os
import struct
import sys
from pathlib import Path

from m100link.errors import PortBusy, PortFailed
from m100link.sim.ports.driver import Backlog, Driver

if sys.platform != "win32":
    import fcntl
    import termios
    import tty

_STALE_S = 1.0
_FULL = 4000  # the line discipline holds 4095 bytes
_SPEEDS = {
    getattr(termios, f"B{rate}"): rate
    for rate in (
        *(1200, 2400, 4800, 9600, 19_200, 38_400, 57_600, 115_200, 230_400, 460_800),
        *(500_000, 576_000, 921_600, 1_000_000, 1_500_000, 2_000_000),
    )
    if sys.platform != "win32" and hasattr(termios, f"B{rate}")
}


def open_terminal() -> tuple[int, int, str]:
    """Open a raw pseudo-terminal: its two ends, of which the first one does not block, its device.

    Raises ``PortFailed``: this is Windows.
    """
    if sys.platform == "win32":
        raise PortFailed(
            "Windows has no pseudo-terminals",
            cause="a virtual aircraft was to stand behind a serial port",
            remedy="use `m100link sim --tcp 7000` and tcp://127.0.0.1:7000, or sim://",
        )
    master, slave = os.openpty()
    tty.setraw(slave)
    os.set_blocking(master, False)
    return master, slave, os.ttyname(slave)


class PtyPort:
    """A pseudo-terminal, optionally under a name of one's choice.

    Args:
        driver: Of the aircraft.
        link: Path of a symbolic link to the terminal. One that is there already is replaced only
            if it is a link to nothing; it is removed at the end.
        follow_baud_rate: Garble both directions while the program has set another baud rate than
            the aircraft's, as a real line would.

    Raises:
        PortBusy: There is something else at ``link``.
        PortFailed: The link cannot be made, or this is Windows.

    Attributes:
        device: Path of the terminal, such as ``/dev/pts/3``.
        name: The path to open: the link if there is one, else the device.
        backlog: Frames that wait for the reader.
        flushes: How often a full terminal was emptied because nobody had read for a second.
    """

    def __init__(
        self, driver: Driver, *, link: str | Path | None = None, follow_baud_rate: bool = True
    ) -> None:
        self._driver = driver
        self._link = None if link is None else Path(link)
        self._follow_baud_rate = follow_baud_rate
        self._partial = b""
        self._blocked_since: float | None = None
        self._full_since: float | None = None
        self.flushes = 0
        self.backlog = Backlog()
        self._open()
        driver.attach(self)

    @property
    def name(self) -> str:
        """The path that a program opens."""
        return self.device if self._link is None else str(self._link)

    def _open(self) -> None:
        self._master, self._slave, self.device = open_terminal()
        self._set_speed()
        if self._link is not None:
            try:
                self._make_link(self._link)
            except BaseException:
                self._close_files()
                raise
        self._driver.loop.add_reader(self._master, self._on_readable)

    def _set_speed(self) -> None:
        """A fresh terminal has the aircraft's rate; a program that says nothing fits."""
        wanted = self._driver.aircraft.vehicle.assistant.baud_rate
        codes = [code for code, rate in _SPEEDS.items() if rate == wanted]
        attributes = termios.tcgetattr(self._slave)
        if codes:
            attributes[4] = attributes[5] = codes[0]
            termios.tcsetattr(self._slave, termios.TCSANOW, attributes)

    def _make_link(self, link: Path) -> None:
        if link.is_symlink():
            target = link.readlink()
            if target.exists() and str(target) != self.device:
                raise PortBusy(
                    f"{link} leads to {target} already",
                    cause="another simulator uses this name",
                    remedy=f"end it, or remove the link: rm {link}",
                )
        elif link.exists():
            raise PortBusy(
                f"{link} exists and is not a symbolic link",
                cause="a real device or file has this name",
                remedy="choose another name; it is not replaced",
            )
        temporary = link.with_name(f".{link.name}.{os.getpid()}")
        try:
            temporary.symlink_to(self.device)
            temporary.replace(link)
        except OSError as error:
            with contextlib.suppress(OSError):
                temporary.unlink()
            raise PortFailed(
                f"the link {link} cannot be made: {error.strerror}",
                cause="a directory that does not exist, or no right to write there",
                remedy="name a file in a folder that you may write",
            ) from error

    def _remove_link(self) -> None:
        link = self._link
        with contextlib.suppress(OSError):
            if link is not None and link.is_symlink() and str(link.readlink()) == self.device:
                link.unlink()

    # --- bytes ------------------------------------------------------------------------------

    def _on_readable(self) -> None:
        try:
            data = os.read(self._master, 65_536)
        except (BlockingIOError, InterruptedError):
            return
        except OSError:
            return  # a program closed the terminal at this moment; the slave here keeps it alive
        if data:
            self._driver.receive(self._garbled(data) if self._is_wrong_rate() else data)

    def write(self, frames: list[bytes]) -> None:
        """Send frames; what does not fit waits, bounded, in the backlog."""
        if self._master < 0:
            return
        if self._is_wrong_rate():
            frames = [self._garbled(frame) for frame in frames]
        self.backlog.extend(frames)
        self._throw_stale_away()
        self._drain()

    def _throw_stale_away(self) -> None:
        """Empty a terminal that nobody has read from for a while.

        The system keeps some 70 kB for a reader who may never come: six seconds of telemetry.
        """
        if self.unread < _FULL:
            self._full_since = None
            return
        # Looked at with each write: a reader that is a tenth of a second behind now and then finds
        # it full, too, and is not to lose what it is about to read.
        now = self._driver.loop.time()
        if self._full_since is None:
            self._full_since = now
        elif now - self._full_since > _STALE_S:
            termios.tcflush(self._slave, termios.TCIFLUSH)
            self.flushes += 1
            self._full_since = None

    def _drain(self) -> None:
        pieces = self.backlog.take()
        if self._partial:
            pieces.insert(0, self._partial)
        data = b"".join(pieces)
        try:
            written = os.write(self._master, data)
        except (BlockingIOError, InterruptedError):
            written = 0
        except OSError:
            written = len(data)  # going down
        if written == len(data):
            self._partial = b""
            if self._blocked_since is not None:
                self._blocked_since = None
                self._driver.loop.remove_writer(self._master)
            return
        self._hold_back(pieces, written)

    def _hold_back(self, pieces: list[bytes], written: int) -> None:
        now = self._driver.loop.time()
        if self._blocked_since is None:
            self._blocked_since = now
            self._driver.loop.add_writer(self._master, self._drain)
        elif written:
            self._blocked_since = now
        elif now - self._blocked_since > _STALE_S:
            # Nobody reads. The bytes in the terminal are old: throw them away, begin afresh.
            termios.tcflush(self._slave, termios.TCIFLUSH)
            self._blocked_since = now
            self._partial = b""
            self.backlog.dropped += len(pieces)
            return
        while written >= len(pieces[0]):
            written -= len(pieces.pop(0))
        # A frame that is half written must be finished, or it spoils the next one, too.
        self._partial = pieces.pop(0)[written:] if written or self._partial else b""
        self.backlog.extend(pieces)

    def _is_wrong_rate(self) -> bool:
        if not self._follow_baud_rate:
            return False
        try:
            code = termios.tcgetattr(self._slave)[5]
        except termios.error:
            return False
        rate = _SPEEDS.get(code)
        return rate is not None and rate != self._driver.aircraft.vehicle.assistant.baud_rate

    def _garbled(self, data: bytes) -> bytes:
        """The bytes that a UART receives at the wrong rate: as many, and nonsense."""
        return bytes((byte * 0x1D ^ 0xE6 ^ index * 7) & 0xFF for index, byte in enumerate(data))

    @property
    def unread(self) -> int:
        """Bytes in the terminal that no program has read yet."""
        buffer = fcntl.ioctl(self._slave, termios.FIONREAD, b"\0" * 4)
        count: int = struct.unpack("i", buffer)[0]
        return count

    # --- the plug ---------------------------------------------------------------------------

    def unplug(self) -> None:
        """The terminal goes away: programs that have it open get an end of file or an error."""
        self._remove_link()
        self._close_files()

    def replug(self) -> None:
        """A new terminal, under the same link but (usually) with another device name."""
        if self._master < 0:
            self._open()

    def _close_files(self) -> None:
        if self._master < 0:
            return
        loop = self._driver.loop
        if not loop.is_closed():
            loop.remove_reader(self._master)
            loop.remove_writer(self._master)
        os.close(self._master)
        os.close(self._slave)
        self._master = self._slave = -1
        self._partial = b""
        self._blocked_since = None
        self.backlog.clear()

    def close(self) -> None:
        """Remove the link and the terminal."""
        self._remove_link()
        self._close_files()
        self._driver.detach(self)
