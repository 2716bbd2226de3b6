"""A rule for udev: a stable name, the right group, no ModemManager, no delay."""

from __future__ import annotations

import re
from pathlib import Path

from m100link.apps.doctor.machine import Adapter
from m100link.errors import UsageError

__all__ = ["RULES_FILE", "rule"]

RULES_FILE = Path("/etc/udev/rules.d/70-m100.rules")
"""Where a rule for the aircraft's port belongs: before those of ModemManager (77)."""

_NAME = re.compile(r"[A-Za-z][\w-]{0,30}")
_LATENCY = 'ACTION=="add", SUBSYSTEM=="usb-serial", DRIVER=="ftdi_sio", ATTR{latency_timer}="1"'


def rule(adapter: Adapter, name: str, *, group: str = "dialout", by_serial: bool = False) -> str:
    """The text of a rules file for one adapter.

    Args:
        adapter: On USB.
        name: The name that the port gets in ``/dev``: letters, digits, ``-`` and ``_``.
        group: Whose members may open it.
        by_serial: For this very adapter, where several of a kind are plugged in.

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
