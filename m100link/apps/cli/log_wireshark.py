"""``m100link log wireshark``: a log for Wireshark, and the plugin that reads it."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from m100link.apps.cli.common import out
from m100link.apps.cli.log_plot import cannot_write, new_file
from m100link.apps.cli.options import Firmware
from m100link.apps.cli.outcome import ExitCode
from m100link.apps.cli.progress import reading, status
from m100link.errors import UsageError
from m100link.link.keyfile import read_key
from m100link.log.dissector import dissector
from m100link.log.pcapng import write_pcapng
from m100link.wire import Cipher

__all__ = ["wireshark"]

_PLUGIN = "m100.lua"


def wireshark(
    file: Path | None = None,
    /,
    *,
    output: Annotated[Path | None, Parameter(name=("--output", "-o"))] = None,
    key_file: Path | None = None,
    firmware: Firmware | None = None,
    install: bool = False,
    plugin: Path | None = None,
) -> int:
    """Write a log as pcapng, a packet per frame, and the plugin by which Wireshark reads it.

    With a key, each encrypted frame is followed by what it says on a second interface.

    Args:
        file: The log; none with ``--install`` or ``--plugin`` alone.
        output: A new file; by default FILE with .pcapng.
        key_file: File with the AES key.
        firmware: Profile that the plugin reads by; by default that of the flight.
        install: Write the plugin to where Wireshark looks for it; an older one is replaced.
        plugin: Write the plugin into this new file: ``tshark -X lua_script:FILE -r …``.
    """
    if file is None and not install and plugin is None:
        raise UsageError("no log is named", remedy="FILE, or --install for the plugin alone")
    cipher = None if key_file is None else Cipher(read_key(key_file))
    if plugin is not None:
        with new_file(plugin) as stream:
            stream.write(dissector().encode())
        out.print(f"plugin in {plugin}", soft_wrap=True)
    if install:
        out.print(f"plugin in {_install()}; Wireshark: Analyze, Reload Lua Plugins", soft_wrap=True)
    if file is not None:
        target = output or file.with_suffix(".pcapng")
        with reading(file) as flight, new_file(target) as stream:
            count = write_pcapng(flight, stream, firmware=firmware, cipher=cipher)
        out.print(f"{count} packets in {target}", soft_wrap=True)
        return status(flight)
    return ExitCode.OK


def _install() -> Path:
    place = Path.home() / ".local/lib/wireshark/plugins" / _PLUGIN
    try:
        place.parent.mkdir(parents=True, exist_ok=True)
        place.write_text(dissector(), encoding="utf-8")
    except OSError as error:
        raise cannot_write(place, error) from error
    return place
