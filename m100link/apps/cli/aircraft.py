"""``m100link info`` and ``m100link activate``."""

from __future__ import annotations

import asyncio
import dataclasses
import sys
from typing import Annotated, Any

from rich.table import Table

from m100link.aircraft import connect
from m100link.aircraft.activation import ActivationProgress
from m100link.apps.cli.common import AppOptions, LinkOptions, Place, Url, err, out, run_async
from m100link.apps.cli.link import telemetry_rates
from m100link.apps.cli.options import Above0
from m100link.apps.cli.outcome import print_json

__all__ = ["activate", "info"]


def info(
    url: Url = None,
    /,
    *,
    link: LinkOptions | None = None,
    duration: Annotated[float, Above0] = 1.1,
    json: bool = False,
) -> int:
    """Show what is at the other end: version, firmware profile, telemetry items, line quality.

    Args:
        url: Where the aircraft is.
        link: How to talk to it.
        duration: Seconds to watch telemetry.
        json: One JSON object instead of tables.
    """
    link = link or LinkOptions()
    as_json = json or not sys.stdout.isatty()
    return run_async(_info(link.place(url), duration, as_json))


async def _info(place: Place, duration: float, as_json: bool) -> int:
    async with connect(place.url, **place.arguments()) as aircraft:
        version = await aircraft.version()
        await asyncio.sleep(duration)
        numbers = dataclasses.asdict(aircraft.statistics())
        described: dict[str, Any] = {
            "url": place.url,
            "version": version.name,
            "serial": version.serial,
            "version_crc_matches": version.crc_matches,
            "activated": version.is_activated,
            "firmware": aircraft.firmware.name,
            "firmware_is_forced": place.settings.firmware is not None,
            "firmware_summary": aircraft.firmware.summary,
            "telemetry": telemetry_rates(aircraft),
            "telemetry_mismatches": aircraft.telemetry_mismatches,
            "line": numbers,
        }
    if as_json:
        print_json(described)
    else:
        _print_info(described)
    return 0


def _print_info(described: dict[str, Any]) -> None:
    table = Table(box=None, show_header=False, pad_edge=False)
    forced = " (forced)" if described["firmware_is_forced"] else " (by its version)"
    rows = {
        "version": described["version"],
        "serial": described["serial"] or "not told by this firmware",
        "activated": "yes" if described["activated"] else "no",
        "firmware": described["firmware"] + forced,
        "": described["firmware_summary"],
        "telemetry": ", ".join(
            f"{name} {'' if rate is None else f'{rate:g} Hz'}".strip()
            for name, rate in described["telemetry"].items()
        )
        or "nothing arrives",
    }
    line = described["line"]
    rows["line"] = (
        f"{line['bytes_received']} bytes, {line['frames_received']} frames, "
        f"{line['discarded_bytes']} bytes discarded {line['discards'] or ''}"
    )
    if described["telemetry_mismatches"]:
        rows["warning"] = (
            f"{described['telemetry_mismatches']} telemetry packages do not fit this firmware"
        )
    for name, value in rows.items():
        table.add_row(f"[bold]{name}[/]", value)
    out.print(table)


def activate(
    url: Url = None,
    /,
    *,
    app: AppOptions | None = None,
    link: LinkOptions | None = None,
    wait: Annotated[float, Above0] = 60.0,
    json: bool = False,
) -> int:
    """Activate the aircraft for an app; waits while the aircraft asks DJI's server.

    Args:
        url: Where the aircraft is.
        app: The app that is registered with DJI.
        link: How to talk to it.
        wait: Seconds until it gives up.
        json: One JSON object instead of talk.
    """
    link = link or LinkOptions()
    return run_async(_activate(link.place(url, app), wait, json))


async def _activate(place: Place, wait: float, as_json: bool) -> int:
    credentials = place.credentials()
    attempts = 0

    def tell(progress: ActivationProgress) -> None:
        nonlocal attempts
        attempts = progress.attempt
        if progress.next_attempt_in is not None:
            err.print(
                f"attempt {progress.attempt}: {progress.code.meaning}; "
                f"again in {progress.next_attempt_in:.0f} s, {progress.remaining:.0f} s left "
                f"({progress.code.remedy})"
            )

    async with connect(place.url, **place.arguments()) as aircraft:
        version = await aircraft.activate(credentials, timeout=wait, progress=tell)
    if as_json or not sys.stdout.isatty():
        print_json(
            {
                "activated": True,
                "app_id": credentials.app_id,
                "attempts": attempts,
                "version": version.name,
                "firmware": aircraft.firmware.name,
            }
        )
    else:
        out.print(f"[green]activated[/] for app {credentials.app_id}: {version.name}")
    return 0
