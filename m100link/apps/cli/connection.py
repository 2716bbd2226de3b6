"""``m100link info``, ``activate``, ``link``, ``doctor``, ``ports`` and ``udev``."""

from __future__ import annotations

import asyncio
import contextlib
import dataclasses
import json as json_text
import os
import platform
import sys
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Annotated, Any

from rich.table import Table
from rich.text import Text

from m100link import __version__
from m100link.aircraft import Aircraft
from m100link.aircraft.activation import ActivationProgress
from m100link.apps.cli.common import (
    AS_SET,
    BY_LINK,
    AircraftOptions,
    ConnectionOptions,
    LinkOptions,
    Url,
    err,
    out,
)
from m100link.apps.cli.configuration import (
    Configuration,
    check_name,
    read_configuration,
    remember,
    shown,
)
from m100link.apps.cli.options import Above0, Duration, offered
from m100link.apps.cli.terminal import (
    ExitCode,
    as_json,
    finite,
    print_json,
    read_line,
    tell,
    tell_text,
)
from m100link.apps.doctor import Finding, Machine, Report, Stage, Verdict, diagnose
from m100link.apps.doctor.first_contact import Contact, Observation, Topic
from m100link.apps.doctor.first_contact import first_contact as meet
from m100link.apps.doctor.machine import RULES_FILE, rule
from m100link.errors import AckTimeout, LinkError, PortNotFound, UsageError
from m100link.link.statistics import ROUND_TRIP_BOUNDS_S, RoundTrips
from m100link.link.transport import serial_ports
from m100link.link.url import parse_url
from m100link.protocol.items import BY_RECORD


async def info(
    url: Url = None, /, *, link: LinkOptions = BY_LINK, duration: Duration = 1.1
) -> None:
    """Show version, firmware profile, telemetry items and line quality."""
    place = link.place(url)
    async with place.connect() as aircraft:
        version = await aircraft.version()
        await asyncio.sleep(duration)
        described: dict[str, Any] = {
            "url": place.url,
            "version": version.name,
            "serial": version.serial,
            "version_crc_matches": version.crc_matches,
            "activated": version.is_activated,
            "firmware": aircraft.firmware.name,
            "firmware_is_forced": place.settings.firmware is not None,
            "firmware_summary": aircraft.firmware.summary,
            "acceleration": aircraft.acceleration_mode,
            "telemetry": telemetry_rates(aircraft),
            "telemetry_mismatches": aircraft.telemetry_mismatches,
            "latency": _latency(aircraft),
            "line": dataclasses.asdict(aircraft.statistics()),
        }
    tell(described, lambda: _print_info(described))


def _print_info(described: dict[str, Any]) -> None:
    forced = " (forced)" if described["firmware_is_forced"] else " (by its version)"
    rows = {
        "version": described["version"],
        "serial": described["serial"] or "this firmware does not report it",
        "activated": "yes" if described["activated"] else "no",
        "firmware": described["firmware"] + forced,
        "": described["firmware_summary"],
        "acceleration": described["acceleration"] or "raw or fused: not known yet",
        "telemetry": _arriving(described),
    }
    line = described["line"]
    if latency := described["latency"]:
        rows["latency"] = latency
    rows["line"] = (
        f"{line['bytes_received']} bytes, {line['frames_received']} frames, "
        f"{line['discarded_bytes']} bytes discarded {line['discards'] or ''}"
    )
    _print_rows(rows, described)


def _arriving(described: dict[str, Any]) -> str:
    rates = (
        f"{name} {'' if rate is None else f'{rate:g} Hz'}".strip()
        for name, rate in described["telemetry"].items()
    )
    return ", ".join(rates) or "nothing arrives"


def _print_rows(rows: dict[str, str], described: dict[str, Any]) -> None:
    table = Table(box=None, show_header=False, pad_edge=False)
    if mismatches := described["telemetry_mismatches"]:
        rows["warning"] = f"{mismatches} telemetry packages do not fit this firmware"
    for name, value in rows.items():
        table.add_row(Text(name, "bold"), value)
    out.print(table)


async def activate(
    url: Url = None,
    /,
    *,
    options: AircraftOptions = AS_SET,
    wait: Annotated[float, Above0] = 60.0,
) -> None:
    """Activate the aircraft for an app; wait for DJI's server.

    Args:
        wait: Seconds to wait for the activation.
    """
    place = options.place(url)
    credentials = place.credentials()
    attempts = 0

    def show(progress: ActivationProgress) -> None:
        nonlocal attempts
        attempts = progress.attempt
        if progress.next_attempt_in is not None:
            err.print(
                f"attempt {progress.attempt}: {progress.code.meaning}; "
                f"again in {progress.next_attempt_in:.0f} s, {progress.remaining:.0f} s left "
                f"({progress.code.remedy})"
            )

    async with place.connect() as aircraft:
        version = await aircraft.activate(credentials, timeout=wait, progress=show)
    facts = {
        "activated": True,
        "app_id": credentials.app_id,
        "attempts": attempts,
        "version": version.name,
        "firmware": aircraft.firmware.name,
    }
    tell(facts, f"activated for app {credentials.app_id}: {version.name}")


# -- ``m100link link``: how good is the line? ------------------------------------------------------


_BAR = 40
_SHARES = (0.5, 0.95, 0.99)


async def link(
    url: Url = None,
    /,
    *,
    options: LinkOptions = BY_LINK,
    duration: Duration = 5.0,
    rate: Annotated[float, Above0] = 10.0,
) -> None:
    """Measure the line: damage, its causes, round trips, item rates.

    The command only requests the version, again and again: nothing moves.

    Args:
        rate: Requests per second; each waits for the previous answer.
    """
    place = options.place(url)
    async with place.connect() as aircraft:
        loop = asyncio.get_running_loop()
        end, asked, unanswered = loop.time() + duration, 0, 0
        while (now := loop.time()) < end:
            asked += 1
            try:
                await aircraft.version()
            except AckTimeout:
                unanswered += 1
            await asyncio.sleep(max(0.0, min(now + 1.0 / rate, end) - loop.time()))
        measured = _measured(aircraft) | {"asked": asked, "unanswered": unanswered}
    tell(measured, lambda: _print(measured))


def telemetry_rates(aircraft: Aircraft) -> dict[str, float | None]:
    """Arrivals per second of each item that ever came; None where it came once."""
    rates = {}
    for record, item in BY_RECORD.items():
        statistics = aircraft.state.statistics(record)
        if statistics.count:
            rate = statistics.rate_hz
            rates[item.name] = None if rate is None else round(rate, 1)
    return rates


def _latency(aircraft: Aircraft) -> str:
    """How slow the line is; empty for a quick one."""
    latency = aircraft.link.latency
    return str(latency) if latency.is_slow else ""


def _measured(aircraft: Aircraft) -> dict[str, Any]:
    counted = aircraft.statistics()
    counters = dataclasses.asdict(counted)
    del counters["round_trips"]
    return {
        "link": aircraft.link.name,
        "line": counters,
        "round_trips": _described(counted.round_trips),
        "latency": _latency(aircraft),
        "telemetry": telemetry_rates(aircraft),
        "telemetry_mismatches": aircraft.telemetry_mismatches,
    }


def _described(trips: RoundTrips) -> dict[str, Any]:
    bounds = [*(f"{1000 * bound:g}" for bound in ROUND_TRIP_BOUNDS_S), "more"]
    mean = trips.mean_s
    return {
        "count": trips.count,
        "mean_ms": None if mean is None else round(1000 * mean, 3),
        "within_ms": {
            f"{100 * share:g}%": None if bound is None else 1000 * bound
            for share, bound in ((share, trips.within_s(share)) for share in _SHARES)
        },
        "up_to_ms": dict(zip(bounds, trips.counts, strict=True)),
    }


def _print(measured: dict[str, Any]) -> None:
    line = measured["line"]
    rows = {
        "received": f"{line['bytes_received']} bytes, {line['frames_received']} frames",
        "sent": f"{line['bytes_sent']} bytes, {line['frames_sent']} frames",
        "discarded": f"{line['discarded_bytes']} bytes"
        + "".join(f", {cause} {count}" for cause, count in line["discards"].items()),
        "questions": f"{measured['asked']}, {measured['unanswered']} without an answer, "
        f"{line['repeats']} repeats",
        "acks": f"{line['acks']}; late {line['late_acks']}, twice {line['duplicate_acks']}, "
        f"to no question {line['foreign_acks']}",
        "not written": f"{line['dropped_writes']} frames",
        "telemetry": _arriving(measured),
    }
    if latency := measured["latency"]:
        rows["latency"] = latency
    _print_rows(rows, measured)
    _print_trips(measured["round_trips"])


def _print_trips(trips: dict[str, Any]) -> None:
    if not trips["count"]:
        return
    out.print(f"answers after {trips['mean_ms']:g} ms on average; up to")
    most = max(trips["up_to_ms"].values())
    for bound, count in trips["up_to_ms"].items():
        if count:
            bar = "█" * max(1, round(_BAR * count / most))
            unit = "" if bound == "more" else " ms"
            out.print(f"{bound + unit:>9} {count:>6} {bar}")


# -- ``m100link doctor``, ``ports`` and ``udev``: why is the line silent? --------------------------


_MARKS = {
    Verdict.GOOD: Text("✓", "green"),
    Verdict.DOUBTFUL: Text("!", "yellow"),
    Verdict.FAILED: Text("✗", "bold red"),
    Verdict.SKIPPED: Text("–", "dim"),
}

_EXIT_CODES = {
    **dict.fromkeys((Stage.PORT, Stage.PERMISSION, Stage.OWNER), ExitCode.PORT),
    **dict.fromkeys((Stage.INTERFERENCE, Stage.OPENING), ExitCode.PORT),
    **dict.fromkeys((Stage.BYTES, Stage.FRAMES, Stage.TELEMETRY), ExitCode.NO_LINK),
    **dict.fromkeys((Stage.VERSION, Stage.FIRMWARE, Stage.ACCELERATION), ExitCode.NO_LINK),
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
) -> int:
    """Find out why the line is silent, stage by stage.

    Nothing moves. With an app id and a key, the command activates the aircraft.

    Args:
        authority: Also obtain control authority, and give it back at once; only on the ground with
            the motors off. Without this option a terminal asks.
        report: Write the findings into a new file, without secrets, to attach to a question.
    """
    if report is not None:
        _check_report(report)
    place = options.place(url or _only_port(options))
    found = _diagnosed(place, authority=authority)
    status = exit_status(found)
    described = {**found.to_json(), "exit_status": status}
    tell(described, lambda: _conclude(found))
    if report is not None:
        _write_report(report, described)
        err.print(f"written: {report}")
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
    if link.url is not None or os.environ.get("M100LINK_URL"):
        return None
    found = serial_ports()
    if len(found) > 1:
        raise UsageError(
            f"several ports could be the aircraft's: {', '.join(found)}",
            remedy=f"m100link doctor {found[0]}",
        )
    return found[0] if found else None


def _diagnosed(place: ConnectionOptions, *, authority: bool) -> Report:
    app = place.settings
    has_app = app.app_id is not None or (
        place.is_virtual and app.key is None and app.key_file is None
    )
    look = partial(
        diagnose,
        place.url,
        credentials=place.credentials() if has_app else None,
        firmware=app.firmware,
        baud_rate=app.baud_rate,
        acceleration=app.acceleration,
    )
    if as_json():
        return asyncio.run(look(authority=authority))
    found = asyncio.run(look(tell=_tell, authority=authority))
    if found.findings[-1].details.get("may_be_tried") and asyncio.run(_agrees()):
        # A second time: a person may take long, and an open port shuts out other programs.
        found = asyncio.run(look(authority=True))
        _tell(found.findings[-1])
    return found


def _tell(finding: Finding) -> None:
    out.print(_MARKS[finding.verdict], f"{finding.stage.title:<29} ", end="")
    out.print(finding.seen, soft_wrap=True)
    if finding.verdict is Verdict.DOUBTFUL:
        _advise(finding)


def _advise(finding: Finding) -> None:
    for title, lines in (("likely", finding.causes), ("to do", finding.commands)):
        for number, line in enumerate(lines, start=1):
            out.print(
                f"    {title if number == 1 else '':<7}{number}. {line}",
                soft_wrap=True,
            )


def _conclude(found: Report) -> None:
    failure = found.failure
    if failure is not None:
        _advise(failure)
        out.print("more: m100link docs silent-line")
    elif found.doubts:
        out.print("it works, with the doubts above", style="yellow")
    else:
        out.print("no stage found a fault", style="green")


async def _agrees() -> bool:
    """Ask whether to try control authority; in the loop, so that Ctrl-C ends the question."""
    return sys.stdin.isatty() and await _asked(
        "Obtain control authority for a moment? The aircraft stays on the ground and does not "
        "move; m100link gives authority back at once."
    )


# -- ``m100link first-contact``: the first hour with an aircraft -----------------------------------


async def first_contact(
    url: Url = None,
    /,
    *,
    options: AircraftOptions = AS_SET,
    name: str | None = None,
    report: Path | None = None,
) -> int:
    """Find out how your aircraft differs from the virtual one, in its first hour, propellers off.

    Nothing moves. The command tells you what to do by hand: lift the aircraft, switch the remote
    control off, turn its switch. With an app id and a key it also asks for control authority, after
    you agreed, and gives it back at once.

    Args:
        name: Name of the aircraft in the configuration file, which keeps what was found; by default
            the one that was given.
        report: Write the findings into a new file, without secrets, to attach to a question.
    """
    configuration = read_configuration()
    word = url or options.url or os.environ.get("M100LINK_URL") or configuration.default
    place = options.place(url)
    name = name or (word if word in configuration.aircraft else None)
    # Before half an hour of work, not behind it.
    if name is not None:
        check_name(configuration.path, name)
    if report is not None:
        _check_report(report)
    app = place.settings
    address = parse_url(place.url, baud_rate=app.baud_rate)  # nobody's business but its kind
    rate = f", {address.number} baud" if address.scheme == "serial" else ""

    def keep(contact: Contact) -> None:
        described = {"line": address.scheme + rate, **contact.to_json()}
        if as_json():
            print_json(described)
        try:
            if report is not None:
                _write_report(report, described)
                err.print(f"written: {report}")
        finally:  # no error of the one costs the other
            if name is not None and contact.found:
                _remember(configuration, name, place.url, contact)
        if contact.ended_by:
            err.print(f"it ended early: {contact.ended_by}")

    contact: Contact = await meet(
        place.url,
        ask=_asked,
        credentials=place.credentials() if app.app_id is not None or place.is_virtual else None,
        firmware=app.firmware,
        baud_rate=app.baud_rate,
        timeout=app.timeout,
        tell=(lambda _: None) if as_json() else _tell_observation,
        say=lambda text: err.print(text, style="bold"),
        keep=keep,
    )
    if not contact.is_given_back:
        return ExitCode.AUTHORITY
    return ExitCode.NO_LINK if contact.is_cut_off else ExitCode.OK


def _remember(configuration: Configuration, name: str, url: str, contact: Contact) -> None:
    found: dict[str, str | dict[str, str]] = {}
    mode = contact.get(Topic.ACCELERATION)
    if mode is not None and mode.is_seen:
        found["acceleration"] = mode.found
    found["seen"] = {"on": f"{datetime.now(UTC):%Y-%m-%d}", **contact.found}
    remember(configuration, name, url, found)
    err.print(f"kept in {shown(configuration.path)} [aircraft.{name}]")


def _tell_observation(one: Observation) -> None:
    seen = Verdict.GOOD if one.is_seen else Verdict.SKIPPED
    mark = _MARKS[Verdict.DOUBTFUL if one.differs else seen]
    out.print(mark, f"{one.topic.question:<42} ", end="")
    what = f"{one.found}: {one.seen}" if one.is_seen else f"not seen: {one.seen}"
    if one.differs:
        what += f" (the virtual aircraft: {one.topic.assumed})"
    out.print(what, soft_wrap=True)


async def _asked(text: str) -> bool:
    """Have the person do something; without a terminal nobody does."""
    if not sys.stdin.isatty():
        err.print(f"{text} No: there is no terminal to answer on.")
        return False
    err.print(f"{text} [y/N] ", end="")
    return (await read_line()).lower() in ("y", "yes")


def _check_report(path: Path) -> None:
    """Raises UsageError: no report can be written there, or one is there already."""
    if path.exists():
        raise UsageError(
            f"{path} is there already", remedy="name another file with --report, or remove it"
        )
    if not os.access(path.parent, os.W_OK):
        raise UsageError(f"{path} cannot be written", remedy="name a file in a folder of yours")


def _write_report(path: Path, described: dict[str, Any]) -> None:
    """The findings and the machine, without key, app id or token."""
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
        raise UsageError(
            f"{path} cannot be written: {error.strerror}", remedy="name another file"
        ) from error


def ports() -> int:
    """List serial ports with their adapters, permissions and users."""
    machine = Machine()
    rows = [_described_port(device, machine) for device in serial_ports()]
    if as_json():
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


def _described_port(device: str, machine: Machine) -> dict[str, Any]:
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
    link: Path = Path("m100"),
    group: str = "dialout",
    by_serial: bool = False,
    install: bool = False,
) -> int:
    """Print a udev rule: name, group, low latency, no ModemManager.

    Args:
        port: The adapter's port; by default the only one on USB.
        link: Name of the port: a symbolic link in /dev.
        group: Group whose members may open the port.
        by_serial: Match the adapter's serial number, where several of a kind are plugged in.
        install: Write the rule where udev reads it; needs root.
    """
    machine = Machine()
    device = port or _only_adapter(machine)
    if port is not None and not os.path.exists(port):
        known = ", ".join(serial_ports()) or "none"
        raise PortNotFound(
            f"there is no device {device}",
            cause="the adapter is not plugged in, or its port has another name",
            remedy=f"ports on this machine: {known}",
        )
    text = rule(machine.adapter(device), link.name, group=group, by_serial=by_serial)
    if not install:
        return tell_text(text)
    try:
        RULES_FILE.write_text(text, encoding="utf-8")
    except OSError as error:
        raise UsageError(
            f"{RULES_FILE} cannot be written: {error.strerror}",
            cause="only root may write there",
            remedy=f"m100link udev {device} | sudo tee {RULES_FILE}",
        ) from error
    err.print("now: sudo udevadm control --reload")
    err.print(f"then plug the adapter in again: its port is /dev/{link.name}")
    return tell({"file": str(RULES_FILE), "port": f"/dev/{link.name}"}, f"written: {RULES_FILE}")


def _only_adapter(machine: Machine) -> str:
    found = [device for device in serial_ports() if machine.adapter(device).is_usb]
    if len(found) == 1:
        return found[0]
    if not found:
        raise UsageError("no adapter on USB is plugged in", remedy="plug it in and try again")
    raise UsageError(
        f"several adapters are plugged in: {', '.join(found)}",
        remedy=f"m100link udev {found[0]}; --by-serial where they are of one kind",
    )
