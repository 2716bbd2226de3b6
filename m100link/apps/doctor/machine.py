"""The facts of a serial port on this machine, without opening it (Linux; elsewhere little).

Everything is read below a root folder, so that a test can bring a machine of its own.
"""

from __future__ import annotations

import os
import re
import stat
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from m100link.errors import UsageError
from m100link.errors.texts import read_path
from m100link.link.transport import port_owners


@dataclass(frozen=True, slots=True)
class Process:
    pid: int
    name: str

    def __str__(self) -> str:
        return f"{self.name} (process {self.pid})"


@dataclass(frozen=True, slots=True)
class Permission:
    mode: str  # as ``ls -l`` shows it
    owner: str  # name of the owner, or the number
    group: str  # name of the group, or the number
    is_granted: bool  # whether this program may read and write
    is_member: bool  # whether the user belongs to the group by the user database

    def __str__(self) -> str:
        return f"{self.mode} {self.owner} {self.group}"


@dataclass(frozen=True, slots=True)
class Adapter:
    driver: str  # name of its kernel driver, empty if unknown
    vendor: str = ""  # USB vendor id, four hex digits; empty for what is not on USB
    product: str = ""  # USB product id
    name: str = ""  # as it names itself
    serial: str = ""  # its serial number, empty for many
    latency_ms: int | None = None  # for how long an FTDI adapter collects bytes; None for others

    @property
    def is_usb(self) -> bool:
        return bool(self.vendor)


class Machine:
    """This machine, or a copy of what it shows of itself.

    Args:
        root: Below which ``sys``, ``proc``, ``run`` and ``dev`` are.
    """

    def __init__(self, root: Path = Path("/")) -> None:
        self._root = root

    def device(self, path: str) -> Path:
        """The device behind a name: links are followed."""
        return Path(os.path.realpath(read_path(path)))

    def permission(self, path: str) -> Permission:
        """The rights to open it.

        Raises:
            OSError: There is no such device.
        """
        place = Path(path)
        state = place.stat()
        group = _named(place.group, state.st_gid)
        return Permission(
            mode=stat.filemode(state.st_mode),
            owner=_named(place.owner, state.st_uid),
            group=group,
            is_granted=os.access(path, os.R_OK | os.W_OK),
            is_member=_is_member(group, state.st_gid),
        )

    def is_terminal_device(self, path: str) -> bool:
        """Whether it is a device of characters, as every serial port is."""
        return stat.S_ISCHR(Path(path).stat().st_mode)

    @property
    def is_container(self) -> bool:
        """Whether this program runs in a container, to which devices must be given."""
        return (self._root / ".dockerenv").exists() or (self._root / "run/.containerenv").exists()

    # -- who else uses it ------------------------------------------------------------------------

    def holders(self, path: str) -> tuple[Process, ...]:
        """Other programs that have the device open, where the system tells."""
        found = port_owners(str(self.device(path)), str(self._root / "proc"))
        return tuple(Process(*one) for one in found if one[0] != os.getpid())

    def login_programs(self, path: str) -> tuple[Process, ...]:
        """Programs that ask for a login on it: they name the port and belong to root."""
        wanted = self.device(path).name
        found = []
        for process in self._processes():
            # A program that names itself anew has blanks between.
            words = _text(process / "cmdline").replace("\0", " ").split()
            if words and "getty" in Path(words[0]).name and wanted in words[1:]:
                found.append(_described(process))
        return tuple(found)

    def is_kernel_console(self, path: str) -> bool:
        """Whether the kernel writes its messages to it."""
        name = self.device(path).name
        lines = _text(self._root / "proc/consoles").splitlines()
        return any(line.split()[:1] == [name] for line in lines)

    def modem_manager(self) -> Process | None:
        """ModemManager, if it runs: it speaks to every new serial port to see whether it is one."""
        running = map(_described, self._processes())
        return next((one for one in running if one.name == "ModemManager"), None)

    def is_left_alone(self, path: str) -> bool:
        """Whether a rule keeps ModemManager away from the device."""
        try:
            state = Path(path).stat()
            numbers = f"c{os.major(state.st_rdev)}:{os.minor(state.st_rdev)}"
            stored = (self._root / "run/udev/data" / numbers).read_text("utf-8", "replace")
        except OSError:
            return False
        return "E:ID_MM_DEVICE_IGNORE=1" in stored.splitlines()

    def _processes(self) -> Iterator[Path]:
        yield from sorted((self._root / "proc").glob("[0-9]*"))

    # -- the adapter -----------------------------------------------------------------------------

    def adapter(self, path: str) -> Adapter:
        port = self._root / "sys/class/tty" / self.device(path).name / "device"
        try:
            place = port.resolve(strict=True)
        except OSError:
            return Adapter("")
        driver = (
            Path(os.path.realpath(place / "driver")).name if (place / "driver").exists() else ""
        )
        latency = _text(place / "latency_timer")
        usb = next((one for one in (place, *place.parents) if (one / "idVendor").exists()), None)
        return Adapter(
            driver=driver,
            vendor=_text(usb / "idVendor") if usb else "",
            product=_text(usb / "idProduct") if usb else "",
            name=" ".join(filter(None, (_text(usb / word) for word in ("manufacturer", "product"))))
            if usb
            else "",
            serial=_text(usb / "serial") if usb else "",
            latency_ms=int(latency) if latency.isdecimal() else None,
        )

    def stable_names(self, path: str) -> tuple[str, ...]:
        """Names of the device that stay when the order of plugging changes."""
        wanted = self.device(path)
        folder = self._root / "dev/serial/by-id"
        try:
            return tuple(sorted(str(name) for name in folder.iterdir() if name.resolve() == wanted))
        except OSError:
            return ()


def _described(process: Path) -> Process:
    return Process(int(process.name), _text(process / "comm"))


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8", errors="replace").strip()
    except OSError:
        return ""


def _named(name: Callable[[], str], number: int) -> str:
    try:
        return name()
    except (KeyError, NotImplementedError):  # a number without a name, or Windows
        return str(number)


def _is_member(group: str, number: int) -> bool:
    """Whether the user is in the group, in this session or from the next login on."""
    try:
        import grp
        import pwd

        user = pwd.getpwuid(os.getuid())
        return user.pw_gid == number or user.pw_name in grp.getgrnam(group).gr_mem
    except (ImportError, KeyError):
        return False


# -- A rule for udev: a stable name, the right group, no ModemManager, no delay --------------------


RULES_FILE = Path("/etc/udev/rules.d/70-m100.rules")
"""Where a rule for the aircraft's port belongs: before those of ModemManager (77)."""

_NAME = re.compile(r"[A-Za-z][\w-]{0,30}")
_LATENCY = 'ACTION=="add", SUBSYSTEM=="usb-serial", DRIVER=="ftdi_sio", ATTR{latency_timer}="1"'


def rule(adapter: Adapter, name: str, *, group: str = "dialout", by_serial: bool = False) -> str:
    """The text of a rules file for one adapter, whose port gets a name in ``/dev``.

    ``group``: whose members may open it. ``by_serial``: for this very adapter, where several of a
    kind are plugged in.

    Raises:
        UsageError: The name cannot be one, or the adapter is not on USB or has no serial number.
    """
    if not _NAME.fullmatch(name):
        raise UsageError(
            f"{name!r} cannot be the name of a port",
            remedy="letters, digits, - and _, a letter first",
        )
    if not adapter.is_usb:
        raise UsageError(
            f"a port that is not on USB ({adapter.driver or 'unknown'}) has no rule",
            cause="a rule knows an adapter by its USB vendor and product",
            remedy="m100link ports shows what there is",
        )
    if by_serial and not adapter.serial:
        raise UsageError(
            f"{adapter.name or 'the adapter'} tells no serial number",
            cause="many cheap adapters have none",
            remedy="plug in one of that kind only, and leave --by-serial out",
        )
    words = [
        'SUBSYSTEM=="tty"',
        f'ATTRS{{idVendor}}=="{adapter.vendor}"',
        f'ATTRS{{idProduct}}=="{adapter.product}"',
        *([f'ATTRS{{serial}}=="{adapter.serial}"'] if by_serial else []),
        f'SYMLINK+="{name}"',
        f'GROUP="{group}"',
        'MODE="0660"',
        'ENV{ID_MM_DEVICE_IGNORE}="1"',
    ]
    lines = [f"# {adapter.name or 'the adapter'} of the aircraft: /dev/{name}", ", ".join(words)]
    if adapter.driver == "ftdi_sio":
        lines.append(_LATENCY)
    return "\n".join(lines) + "\n"
