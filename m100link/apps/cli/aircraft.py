"""``m100link info`` and ``m100link activate``."""

from __future__ import annotations

import asyncio
import dataclasses
import sys
from typing import Annotated, Any

from rich.table import Table

from m100link.aircraft import Aircraft, connect
from m100link.aircraft.activation import ActivationProgress
from m100link.apps.cli.common import (
    AS_SET,
    BY_LINK,
    AircraftOptions,
    LinkOptions,
    Place,
    Url,
    err,
    out,
    run_async,
)
from m100link.apps.cli.options import Above0
from m100link.apps.cli.outcome import ExitCode, print_json
from m100link.errors import AckTimeout
from m100link.link.statistics import ROUND_TRIP_BOUNDS_S, RoundTrips
from m100link.protocol.items import BY_RECORD


def info(
    url: Url = None,
    /,
    *,
    link: LinkOptions = BY_LINK,
    duration: Annotated[float, Above0] = 1.1,
    json: bool = False,
) -> int:
    """Show what is at the other end: version, firmware profile, telemetry items, line quality.

    Args:
        url: Where the aircraft is.
        duration: Seconds to watch telemetry.
        json: One JSON object instead of tables.
    """
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
    options: AircraftOptions = AS_SET,
    wait: Annotated[float, Above0] = 60.0,
    json: bool = False,
) -> int:
    """Activate the aircraft for an app; waits while the aircraft asks DJI's server.

    Args:
        url: Where the aircraft is.
        wait: Seconds until it gives up.
        json: One JSON object instead of talk.
    """
    return run_async(_activate(options.place(url), wait, json))


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


# -- ``m100link link``: how good is the line? ------------------------------------------------------


_BAR = 40
_SHARES = (0.5, 0.95, 0.99)


def link(
    url: Url = None,
    /,
    *,
    options: LinkOptions = BY_LINK,
    duration: Annotated[float, Above0] = 5.0,
    rate: Annotated[float, Above0] = 10.0,
    json: bool = False,
) -> int:
    """Measure the line: damage and its causes, how long answers take, rates of telemetry.

    It asks for the version again and again, and nothing else: nothing moves.

    Args:
        url: Where the aircraft is.
        duration: Seconds to measure.
        rate: Questions per second; the next one waits for the answer.
        json: One JSON object instead of tables.
    """
    as_json = json or not sys.stdout.isatty()
    return run_async(_link(options.place(url), duration, 1.0 / rate, as_json))


async def _link(place: Place, duration: float, interval: float, as_json: bool) -> int:
    async with connect(place.url, **place.arguments()) as aircraft:
        loop = asyncio.get_running_loop()
        end, asked, unanswered = loop.time() + duration, 0, 0
        while (now := loop.time()) < end:
            asked += 1
            try:
                await aircraft.version()
            except AckTimeout:
                unanswered += 1
            await asyncio.sleep(max(0.0, min(now + interval, end) - loop.time()))
        measured = _measured(aircraft) | {"asked": asked, "unanswered": unanswered}
    if as_json:
        print_json(measured)
    else:
        _print(measured)
    return ExitCode.OK


def telemetry_rates(aircraft: Aircraft) -> dict[str, float | None]:
    """Arrivals per second of each item that ever came; None where it came once."""
    rates = {}
    for record, item in BY_RECORD.items():
        statistics = aircraft.state.statistics(record)
        if statistics.count:
            rate = statistics.rate_hz
            rates[item.name] = None if rate is None else round(rate, 1)
    return rates


def _measured(aircraft: Aircraft) -> dict[str, Any]:
    counted = aircraft.statistics()
    counters = dataclasses.asdict(counted)
    del counters["round_trips"]
    return {
        "link": aircraft.link.name,
        "line": counters,
        "round_trips": _described(counted.round_trips),
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
    table = Table(box=None, show_header=False, pad_edge=False)
    rows = {
        "received": f"{line['bytes_received']} bytes, {line['frames_received']} frames",
        "sent": f"{line['bytes_sent']} bytes, {line['frames_sent']} frames",
        "discarded": f"{line['discarded_bytes']} bytes"
        + "".join(f", {cause} {count}" for cause, count in line["discards"].items()),
        "questions": f"{measured['asked']}, {measured['unanswered']} without an answer, "
        f"{line['repeats']} repeats",
        "acks": f"{line['acks']}; late {line['late_acks']}, twice {line['duplicate_acks']}, "
        f"of nothing {line['foreign_acks']}",
        "not written": f"{line['dropped_writes']} frames",
        "telemetry": ", ".join(
            f"{name} {'' if rate is None else f'{rate:g} Hz'}".strip()
            for name, rate in measured["telemetry"].items()
        )
        or "nothing arrives",
    }
    if measured["telemetry_mismatches"]:
        rows["warning"] = (
            f"{measured['telemetry_mismatches']} telemetry packages do not fit this firmware"
        )
    for name, value in rows.items():
        table.add_row(f"[bold]{name}[/]", value)
    out.print(table)
    _print_trips(measured["round_trips"])


def _print_trips(trips: dict[str, Any]) -> None:
    if not trips["count"]:
        return
    out.print(f"[bold]answers[/] after {trips['mean_ms']:g} ms on average; up to")
    most = max(trips["up_to_ms"].values())
    for bound, count in trips["up_to_ms"].items():
        if count:
            bar = "█" * max(1, round(_BAR * count / most))
            unit = "" if bound == "more" else " ms"
            out.print(f"{bound + unit:>9} {count:>6} {bar}", markup=False)
