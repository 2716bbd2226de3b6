"""``m100link doctor``, ``ports`` and ``udev``: why is the line silent?"""

from __future__ import annotations

import asyncio
import contextlib
import json as json_text
import os
import platform
import sys
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Any

from rich.table import Table

from m100link import __version__
from m100link.apps.cli.common import AS_SET, AircraftOptions, LinkOptions, Place, Url, err, out
from m100link.apps.cli.options import offered
from m100link.apps.cli.outcome import ExitCode, finite, print_json
from m100link.apps.cli.terminal import read_line
from m100link.apps.doctor import Finding, Machine, Report, Stage, Verdict, diagnose
from m100link.apps.doctor.diagnosis import ignore
from m100link.apps.doctor.machine import RULES_FILE, rule
from m100link.errors import AckTimeout, LinkError, PortNotFound, UsageError
from m100link.link.transport import serial_ports

_MARKS = {
    Verdict.GOOD: "[green]✓[/]",
    Verdict.DOUBTFUL: "[yellow]![/]",
    Verdict.FAILED: "[bold red]✗[/]",
    Verdict.SKIPPED: "[dim]–[/]",
}

_EXIT_CODES = {
    **dict.fromkeys(
        (Stage.PORT, Stage.PERMISSION, Stage.OWNER, Stage.INTERFERENCE, Stage.OPENING),
        ExitCode.PORT,
    ),
    **dict.fromkeys((Stage.BYTES, Stage.FRAMES, Stage.TELEMETRY), ExitCode.NO_LINK),
    **dict.fromkeys((Stage.VERSION, Stage.FIRMWARE), ExitCode.NO_LINK),
    **dict.fromkeys((Stage.ACTIVATION, Stage.KEY), ExitCode.ACTIVATION),
    **dict.fromkeys((Stage.MODE_SWITCH, Stage.AUTHORITY), ExitCode.AUTHORITY),
}
"""The exit status of the stage that failed."""

_BEHIND_THE_LINE = (Stage.ACTIVATION, Stage.KEY, Stage.MODE_SWITCH, Stage.AUTHORITY)


def doctor(
    url: Url = None,
    /,
    *,
    options: AircraftOptions = AS_SET,
    authority: bool = False,
    report: Path | None = None,
    json: bool = False,
) -> int:
    """Find out why the line is silent: stage by stage, the first that fails with its cause.

    Nothing moves. With app id and key the aircraft is activated, as by every program.

    Args:
        url: Where the aircraft is; without one, the only serial port of this machine.
        authority: Obtain control authority for a moment, without asking at a terminal: only on
            the ground with its motors off, and given back at once.
        report: Write what was found into this file, to attach to a question; no secret is in it.
        json: One JSON object instead of talk.
    """
    place = options.place(url or _only_port(options.link))
    as_json = json or not sys.stdout.isatty()
    try:
        found = _diagnosed(_Patient(place), authority=authority, as_json=as_json)
    except KeyboardInterrupt:
        err.print("interrupted")
        return ExitCode.INTERRUPTED
    status = exit_status(found)
    described = {**found.to_json(), "exit_status": status}
    if as_json:
        print_json(described)
    else:
        _conclude(found)
    if report is not None:
        _write_report(report, described)
        err.print(f"written: {report}", markup=False)
    return status


def exit_status(found: Report) -> int:
    """The exit status: a line that goes away or falls silent is of one class at every stage."""
    failure = found.failure
    if failure is None:
        return ExitCode.OK
    if failure.stage in _BEHIND_THE_LINE and isinstance(failure.error, LinkError | AckTimeout):
        return ExitCode.NO_LINK
    return _EXIT_CODES[failure.stage]


def _only_port(link: LinkOptions) -> str | None:
    """The port, where there is one and nobody says which."""
    if link.url is not None or os.environ.get("M100LINK_URL"):
        return None
    found = serial_ports()
    if len(found) > 1:
        raise UsageError(
            f"several ports could be the aircraft's: {', '.join(found)}",
            remedy=f"m100link doctor {found[0]}",
        )
    return found[0] if found else None


class _Patient:
    """What is diagnosed, once or twice."""

    def __init__(self, place: Place) -> None:
        app = place.settings
        has_app = app.app_id is not None or (
            place.is_virtual and app.key is None and app.key_file is None
        )
        self._url = place.url
        self._arguments: dict[str, Any] = {
            "credentials": place.credentials() if has_app else None,
            "firmware": app.firmware,
            "baud_rate": app.baud_rate,
        }

    async def diagnose(self, tell: Callable[[Finding], None], *, authority: bool) -> Report:
        return await diagnose(self._url, tell=tell, authority=authority, **self._arguments)


def _diagnosed(patient: _Patient, *, authority: bool, as_json: bool) -> Report:
    if as_json:
        return asyncio.run(patient.diagnose(ignore, authority=authority))
    found = asyncio.run(patient.diagnose(_tell, authority=authority))
    if found.findings[-1].details.get("may_be_tried") and asyncio.run(_agrees()):
        # A second time, because a person may take long, and an open port is nobody else's.
        found = asyncio.run(patient.diagnose(ignore, authority=True))
        _tell(found.findings[-1])
    return found


def _tell(finding: Finding) -> None:
    out.print(f"{_MARKS[finding.verdict]} {finding.stage.title:<29} ", end="")
    out.print(finding.seen, markup=False, soft_wrap=True)
    if finding.verdict is Verdict.DOUBTFUL:
        _advise(finding)


def _advise(finding: Finding) -> None:
    for title, lines in (("likely", finding.causes), ("to do", finding.commands)):
        for number, line in enumerate(lines, start=1):
            out.print(
                f"    {title if number == 1 else '':<7}{number}. {line}",
                markup=False,
                soft_wrap=True,
            )


def _conclude(found: Report) -> None:
    failure = found.failure
    if failure is not None:
        _advise(failure)
        out.print("more: m100link docs silent-line")
    elif found.doubts:
        out.print("[yellow]it works; see what is doubtful above[/]")
    else:
        out.print("[green]nothing is wrong as far as this looked[/]")


async def _agrees() -> bool:
    """Whether the person at the terminal wants control authority to be tried.

    Asked where the loop runs: a Ctrl-C as soon as the question stands there finds it in place.
    """
    if not sys.stdin.isatty():
        return False
    out.print(
        "Obtain control authority for a moment? The aircraft stands on the ground and does not "
        "move; authority is given back at once. [y/N] ",
        end="",
        markup=False,
    )
    answer = await read_line()
    if not answer:  # Ctrl-D leaves the cursor behind the question
        out.print()
    return answer.lower() in ("y", "yes")


def _write_report(path: Path, described: dict[str, Any]) -> None:
    """What was found, and on what: neither key nor app id nor token is in it."""
    content = {
        "m100link": __version__,
        "python": platform.python_version(),
        "system": platform.platform(),
        "at": datetime.now(UTC).isoformat(timespec="seconds"),
        **described,
    }
    try:
        path.write_text(json_text.dumps(finite(content), indent=2, default=str) + "\n", "utf-8")
    except OSError as error:
        raise UsageError(f"{path} cannot be written: {error.strerror}") from error


def ports(*, json: bool = False) -> int:
    """List serial ports: adapter, who may open it, who has it open.

    Args:
        json: One JSON object per port instead of a table.
    """
    machine = Machine()
    rows = [_described(device, machine) for device in serial_ports()]
    if json or not sys.stdout.isatty():
        for row in rows:
            print_json(row)
        return ExitCode.OK
    if not rows:
        err.print("no serial port here: plug the adapter in, then: dmesg | tail")
        return ExitCode.OK
    table = Table(box=None, pad_edge=False)
    for title in ("port", "adapter", "may open", "used by", "latency", "stable name"):
        table.add_column(title, overflow="fold")
    for row in rows:
        may = "yes" if row["may_open"] else f"no: {row['permission']}"
        latency = "" if row["latency_ms"] is None else f"{row['latency_ms']} ms"
        users = ", ".join(one["name"] for one in row["used_by"])
        names = "\n".join(row["stable_names"])
        table.add_row(row["port"], row["adapter"] or row["driver"], may, users, latency, names)
    out.print(table)
    return ExitCode.OK


def _described(device: str, machine: Machine) -> dict[str, Any]:
    adapter = machine.adapter(device)
    described: dict[str, Any] = {
        "port": device,
        "adapter": adapter.name,
        "driver": adapter.driver,
        "usb": f"{adapter.vendor}:{adapter.product}" if adapter.is_usb else "",
        "serial": adapter.serial,
        "latency_ms": adapter.latency_ms,
        "stable_names": list(machine.stable_names(device)),
        "may_open": False,
        "permission": "gone",
        "used_by": [{"pid": one.pid, "name": one.name} for one in machine.holders(device)],
    }
    with contextlib.suppress(OSError):  # it was pulled out meanwhile
        permission = machine.permission(device)
        described |= {"may_open": permission.is_granted, "permission": str(permission)}
    return described


def udev(
    port: Annotated[str | None, offered(serial_ports)] = None,
    /,
    *,
    name: str = "m100",
    group: str = "dialout",
    by_serial: bool = False,
    install: bool = False,
) -> int:
    """Print a udev rule for the adapter: a stable name, its group, no ModemManager, no delay.

    Args:
        port: The adapter's port; without one, the only one that is on USB.
        name: The name that the port gets in /dev.
        group: Whose members may open it.
        by_serial: For this very adapter, where several of a kind are plugged in.
        install: Write it where udev reads it; needs root.
    """
    machine = Machine()
    device = port or _only_adapter(machine)
    if port is not None and not Path(port).exists():
        known = ", ".join(serial_ports()) or "none"
        raise PortNotFound(
            f"there is no device {device}",
            cause="the adapter is not plugged in, or has another name",
            remedy=f"ports on this machine: {known}",
        )
    text = rule(machine.adapter(device), name, group=group, by_serial=by_serial)
    if not install:
        sys.stdout.write(text)
        return ExitCode.OK
    try:
        RULES_FILE.write_text(text, encoding="utf-8")
    except OSError as error:
        raise UsageError(
            f"{RULES_FILE} cannot be written: {error.strerror}",
            cause="only root may",
            remedy=f"m100link udev {device} | sudo tee {RULES_FILE}",
        ) from error
    err.print(f"written: {RULES_FILE}; now: sudo udevadm control --reload", markup=False)
    err.print(f"and plug the adapter in again: it is /dev/{name}", markup=False)
    return ExitCode.OK


def _only_adapter(machine: Machine) -> str:
    found = [device for device in serial_ports() if machine.adapter(device).is_usb]
    if len(found) == 1:
        return found[0]
    if not found:
        raise UsageError("no adapter on USB is plugged in", remedy="plug it in, then again")
    raise UsageError(
        f"several adapters are plugged in: {', '.join(found)}",
        remedy=f"m100link udev {found[0]}; --by-serial where they are of one kind",
    )
