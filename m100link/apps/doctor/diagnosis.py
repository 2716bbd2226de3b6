"""All stages, in order, until one fails."""

from __future__ import annotations

from collections.abc import AsyncGenerator, Callable
from contextlib import aclosing

from m100link.apps.doctor.answers import look_at_aircraft
from m100link.apps.doctor.findings import Finding, Report, Verdict
from m100link.apps.doctor.line import look_at_line
from m100link.apps.doctor.machine import Machine
from m100link.apps.doctor.port import look_at_latency, look_at_port
from m100link.link.url import ConnectionString, parse_url
from m100link.protocol.commands.activation import Credentials
from m100link.protocol.firmware import FirmwareProfile


def ignore(_: Finding) -> None:
    """Nobody wants to know before the end."""


async def diagnose(
    url: str,
    *,
    credentials: Credentials | None = None,
    firmware: str | FirmwareProfile | None = None,
    baud_rate: int | None = None,
    authority: bool = False,
    tell: Callable[[Finding], None] = ignore,
    machine: Machine | None = None,
) -> Report:
    """Find out why a line is silent, stage by stage; the first that fails ends it.

    Nothing moves: commands that it sends are version queries, the activation if credentials are
    given, and a request for control authority, with its release, if that is wanted.

    Args:
        url: Where the aircraft is, as :func:`m100link.connect` takes it.
        credentials: App id and key: the aircraft is activated for them, as by every program.
        firmware: Force a firmware profile.
        baud_rate: Rate when the URL has none; 230400 by default.
        authority: Obtain control authority for a moment, when all else is right and the aircraft
            stands on the ground with its motors off.
        tell: Gets each finding at once.
        machine: What to look at the port with.

    Raises:
        BadURL: Not a connection string.
    """
    address = parse_url(url, baud_rate=baud_rate)
    findings = []
    stages = _stages(
        url,
        address,
        machine or Machine(),
        credentials=credentials,
        firmware=firmware,
        authority=authority,
    )
    async with aclosing(stages):
        async for finding in stages:
            findings.append(finding)
            tell(finding)
            if finding.verdict is Verdict.FAILED:
                break
    return Report(str(address), tuple(findings))


async def _stages(
    url: str,
    address: ConnectionString,
    machine: Machine,
    *,
    credentials: Credentials | None,
    firmware: str | FirmwareProfile | None,
    authority: bool,
) -> AsyncGenerator[Finding, None]:
    if address.scheme == "serial":
        for finding in look_at_port(address.target, machine):
            yield finding
        yield look_at_latency(address.target, machine)
    for finding in await look_at_line(address):
        yield finding
    talk = look_at_aircraft(
        url,
        baud_rate=address.number if address.scheme == "serial" else None,
        firmware=firmware,
        credentials=credentials,
        authority=authority,
    )
    async with aclosing(talk):
        async for finding in talk:
            yield finding
