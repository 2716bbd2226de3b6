"""The findings of a diagnosis, and the stages that need no byte of the aircraft.

A finding is a stage, its observation, and the remedy. Those stages are the port, its rights, and
other programs on it.
"""

from __future__ import annotations

import asyncio
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from enum import Enum, StrEnum
from typing import Any, Final, cast

from m100link.apps.doctor.machine import Machine
from m100link.errors import M100Error
from m100link.link.transport import open_transport, serial_ports
from m100link.link.url import ConnectionString

Lines = tuple[str, ...]
Details = Mapping[str, Any]


class Stage(Enum):
    """The stages of a diagnosis: conditions, in the order in which they are looked at."""

    PORT = "the port exists"
    PERMISSION = "it may be opened"
    OWNER = "nobody else uses it"
    INTERFERENCE = "no console, no ModemManager"
    LATENCY = "the adapter delivers at once"
    OPENING = "it opens"
    BYTES = "bytes arrive"
    FRAMES = "they are frames"
    TELEMETRY = "telemetry arrives"
    VERSION = "the aircraft answers"
    FIRMWARE = "its firmware is known"
    ACCELERATION = "its acceleration is understood"
    ACTIVATION = "it is activated"
    KEY = "the key is the aircraft's"
    MODE_SWITCH = "the mode switch is in F"
    AUTHORITY = "it gives control"

    @property
    def title(self) -> str:
        return self.value

    def good(self, seen: str, details: Details | None = None) -> Finding:
        return Finding(self, Verdict.GOOD, seen, details=details or {})

    def skipped(self, why: str, details: Details | None = None) -> Finding:
        return Finding(self, Verdict.SKIPPED, why, details=details or {})

    def doubtful(
        self,
        seen: str,
        causes: Lines = (),
        commands: Lines = (),
        details: Details | None = None,
        error: M100Error | None = None,
    ) -> Finding:
        return Finding(self, Verdict.DOUBTFUL, seen, causes, commands, details or {}, error)

    def failed(
        self,
        seen: str,
        causes: Lines = (),
        commands: Lines = (),
        details: Details | None = None,
        error: M100Error | None = None,
    ) -> Finding:
        return Finding(self, Verdict.FAILED, seen, causes, commands, details or {}, error)


class Verdict(StrEnum):
    """The outcome of a stage."""

    GOOD = "good"
    DOUBTFUL = "doubtful"
    """It works, and may be the cause of something else."""
    FAILED = "failed"
    """Nothing behind it can work, so the diagnosis ends here."""
    SKIPPED = "skipped"
    """It was not looked at, for the reason that is given."""


@dataclass(frozen=True, slots=True)
class Finding:
    """One stage as it was found."""

    stage: Stage  #: which
    verdict: Verdict  #: what became of it
    seen: str  #: the observation, in one sentence
    causes: Lines = ()  #: the likeliest first
    commands: Lines = ()  #: what to run or do, in this order
    #: Numbers and names behind it, for programs.
    details: Details = field(default_factory=dict)
    error: M100Error | None = None  #: the typed error that a program would get, if one was raised

    def to_json(self) -> dict[str, Any]:
        found: dict[str, Any] = {
            "stage": self.stage.name.lower(),
            "asked": self.stage.title,
            "verdict": self.verdict.value,
            "seen": self.seen,
        }
        for name in ("causes", "commands", "details"):
            if getattr(self, name):
                value = getattr(self, name)
                found[name] = dict(value) if name == "details" else list(value)
        if self.error is not None:
            found["error"] = type(self.error).__name__
            found["error_code"] = self.error.error_code
        return found


@dataclass(frozen=True, slots=True)
class Report:
    """The findings, in order; the last one failed if one did."""

    place: str  #: where the aircraft was looked for, without secrets
    findings: tuple[Finding, ...]  #: one for each stage that was reached

    @property
    def failure(self) -> Finding | None:
        """The stage at which it ends, or None."""
        return next((one for one in self.findings if one.verdict is Verdict.FAILED), None)

    @property
    def doubts(self) -> tuple[Finding, ...]:
        """The findings that work and may still be a cause."""
        return tuple(one for one in self.findings if one.verdict is Verdict.DOUBTFUL)

    def to_json(self) -> dict[str, Any]:
        failure = self.failure
        return {
            "url": self.place,
            "ok": failure is None,
            "failed": None if failure is None else failure.stage.name.lower(),
            "stages": [one.to_json() for one in self.findings],
        }


# -- the port, its rights, and other programs on it ------------------------------------------------

MOST_LATENCY_MS: Final = 4
"""The longest time for which an FTDI adapter may collect bytes; its default is 16."""


def failed(stage: Stage, error: M100Error, *commands: str) -> Finding:
    """A stage at which a typed error came up: its cause, and its remedy before the commands."""
    return stage.failed(
        error.seen,
        (error.cause,) if error.cause else (),
        tuple(filter(None, (error.remedy, *commands))),
        error=error,
    )


def look_at_port(device: str, machine: Machine) -> Iterator[Finding]:
    """The machine's findings on a port, without opening it; ends with the first failure."""
    for look in (_exists, _permission, _owner, _interference):
        finding = look(device, machine)
        yield finding
        if finding.verdict is Verdict.FAILED:
            return


def _exists(device: str, machine: Machine) -> Finding:
    path = str(machine.device(device))
    try:
        is_terminal = machine.is_terminal_device(path)
    except PermissionError as error:
        return Stage.PORT.failed(
            f"nobody can tell whether there is a device {device}: {error.strerror}",
            ("a folder on the way to it belongs to somebody else",),
            (f"ls -ld {machine.device(device).parent}", "m100link ports"),
        )
    except OSError as error:
        ports = serial_ports()
        causes = ["the adapter is not plugged in, or has another name"]
        if machine.is_container:
            causes.insert(0, f"this is a container, and it was not given: --device={device}")
        return Stage.PORT.failed(
            f"there is no device {device}",
            tuple(causes),
            ("m100link ports", "plug it in, then: dmesg | tail"),
            {"ports": ports, "reason": error.strerror or ""},
        )
    if not is_terminal:
        return Stage.PORT.failed(
            f"{device} is not a serial port",
            ("a file or a folder of that name",),
            ("m100link ports",),
        )
    adapter = machine.adapter(device)
    names = machine.stable_names(device)
    seen = device if path == device else f"{device} → {path}"
    if adapter.name or adapter.driver:
        seen += f": {adapter.name or adapter.driver}"
    details = {"device": path, "adapter": adapter.name, "driver": adapter.driver}
    return Stage.PORT.good(seen, details={**details, "stable_names": list(names)})


def _permission(device: str, machine: Machine) -> Finding:
    path = str(machine.device(device))
    try:
        permission = machine.permission(path)
    except OSError as error:
        return Stage.PERMISSION.failed(f"{device} went away: {error.strerror}")
    details = {"mode": permission.mode, "owner": permission.owner, "group": permission.group}
    if permission.is_granted:
        return Stage.PERMISSION.good(str(permission), details=details)
    if permission.is_member:
        cause = f"you were added to the group {permission.group} after you logged in"
        commands = ("log out and in again", f"at once, in this shell: newgrp {permission.group}")
    elif permission.group in ("root", "0"):
        cause = "no rule gives the device to a group of users"
        commands = ("m100link udev --install", "plug the adapter in again")
    else:
        cause = f"you are not in the group {permission.group}"
        commands = (f"sudo usermod -aG {permission.group} $USER", "log out and in again")
    return Stage.PERMISSION.failed(
        f"you may not read and write {device}: {permission}", (cause,), commands, details
    )


def _owner(device: str, machine: Machine) -> Finding:
    holders = machine.holders(device)
    if not holders:
        return Stage.OWNER.good("no other program has it open")
    names = ", ".join(map(str, holders))
    return Stage.OWNER.failed(
        f"in use by {names}",
        ("two programs on one port each get half of the bytes",),
        (
            f"end it: kill {' '.join(str(one.pid) for one in holders)}",
            "or share the aircraft: m100link serve, and connect to that",
        ),
        {"holders": [{"pid": one.pid, "name": one.name} for one in holders]},
    )


def _interference(device: str, machine: Machine) -> Finding:
    name = machine.device(device).name
    logins = machine.login_programs(device)
    if logins:
        return Stage.INTERFERENCE.failed(
            f"a login prompt runs on it: {', '.join(map(str, logins))}",
            ("the system offers a console on this port and answers what the aircraft says",),
            (f"sudo systemctl disable --now serial-getty@{name}.service",),
        )
    if machine.is_kernel_console(device):
        return Stage.INTERFERENCE.failed(
            "the kernel writes its messages to it",
            (f"console={name} is on the kernel's command line",),
            ("remove it there (Raspberry Pi: cmdline.txt), then restart the computer",),
        )
    manager = machine.modem_manager()
    if manager is not None and machine.adapter(device).is_usb and not machine.is_left_alone(device):
        return Stage.INTERFERENCE.doubtful(
            f"{manager} speaks to new serial ports, and no rule keeps it away from this one",
            ("it may send AT commands to the aircraft in the first half minute after plugging in",),
            ("m100link udev --install",),
        )
    return Stage.INTERFERENCE.good("nothing of the system talks on it")


def look_at_latency(device: str, machine: Machine) -> Finding:
    """How long the adapter keeps bytes back."""
    latency = machine.adapter(device).latency_ms
    if latency is None:
        return Stage.LATENCY.good("it has no timer that keeps bytes back")
    if latency <= MOST_LATENCY_MS:
        return Stage.LATENCY.good(f"latency timer {latency} ms")
    name = machine.device(device).name
    return Stage.LATENCY.doubtful(
        f"latency timer {latency} ms: each ack and each package is late by up to that",
        ("an FTDI adapter as it comes",),
        (
            "m100link udev --install",
            (
                f"until it is unplugged: echo 1 | sudo tee "
                f"/sys/bus/usb-serial/devices/{name}/latency_timer"
            ),
        ),
        {"latency_ms": latency},
    )


class Ear(asyncio.Protocol):
    def __init__(self) -> None:
        self.data = bytearray()  # all of it
        self.is_lost = False
        self.lost: Exception | None = None  # why the line ended; None while it has not
        self.transport: asyncio.Transport | None = None
        self._ended = asyncio.Event()
        self.made = asyncio.Event()

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self.transport = cast(asyncio.Transport, transport)  # it is a stream, whatever its class
        self.made.set()

    def data_received(self, data: bytes) -> None:
        self.data += data

    def connection_lost(self, exc: Exception | None) -> None:
        self.is_lost, self.lost = True, exc
        self._ended.set()

    async def listen(self, seconds: float) -> None:
        """Keep bytes that come in so many seconds, or until the line ends."""
        with suppress(TimeoutError):
            async with asyncio.timeout(seconds):
                await self._ended.wait()

    def say(self, data: bytes) -> None:
        if self.transport is not None and not self.is_lost:
            self.transport.write(data)

    async def close(self) -> None:
        if self.transport is not None:
            self.transport.abort()
            # A longer closing ends by itself; the next program that opens it reports it as busy.
            await self.listen(1.0)


async def open_ear(address: ConnectionString) -> Ear:
    """Open a line to listen.

    Raises:
        BadURL, PortNotFound, PortPermissionDenied, PortBusy, PortFailed: See each class.
    """
    ear = Ear()
    await open_transport(address, ear)
    await ear.made.wait()  # an opener may return before the line is open
    return ear
