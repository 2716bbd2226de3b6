"""Telemetry rates: asked for, then seen (firmware 3.1)."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping
from typing import TYPE_CHECKING

from m100link.errors import CommandRefused, NotObserved, UsageError
from m100link.protocol.commands.activation import RATES_HZ, SetTelemetryRates
from m100link.protocol.items import ITEMS, Item
from m100link.telemetry.columns import ITEM_NAMES, snake

if TYPE_CHECKING:
    from m100link.link.requests import Requests
    from m100link.telemetry.state import AircraftState


_SETTLING_S = 0.3  # what was on its way, and the ack
_WATCH_S = 1.2
_WATCH_SLOW_S = 3.2  # three packages of an item at 1 Hz
_TOLERANCE = 0.3  # a lossy line still sends at that rate


async def set_telemetry_rates(
    requests: Requests, state: AircraftState, rates_hz: Mapping[str, int]
) -> dict[str, float]:
    """See :meth:`m100link.Aircraft.set_telemetry_rates`."""
    wanted = rates_by_item(rates_hz)
    code = await requests.execute(
        SetTelemetryRates({item.name: rate for item, rate in wanted.values()}),
        timeout=0.3,
        tries=3,
    )
    if code:
        raise CommandRefused(
            f"the rates were refused: {code.meaning} (code 0x{code:04X}); nothing has changed",
            command=SetTelemetryRates.NAME,
            code=int(code),
            cause=code.cause,
            remedy=code.remedy,
        )
    return await _observe(state, wanted)


def rates_by_item(rates_hz: Mapping[str, int]) -> dict[str, tuple[Item, int]]:
    """The requested rates by the program's names for items, checked without an aircraft.

    Raises ``UsageError``: nothing, no such item, one item twice, or a rate that the wire does not
    have.
    """
    if not rates_hz:
        raise UsageError("no rate was given", remedy="set_telemetry_rates(attitude=50)")
    found: dict[str, tuple[Item, int]] = {}
    for name, rate in rates_hz.items():
        item = ITEM_NAMES.get(name)
        if item is None:
            raise UsageError(
                f"no telemetry item is called {name!r}",
                remedy=f"items: {', '.join(dict.fromkeys(snake(item.record) for item in ITEMS))}",
            )
        if item in (other for other, _ in found.values()):
            seen = f"two rates were given for one item: {name} is {item.name}"
            raise UsageError(seen, remedy="give one")
        if isinstance(rate, bool) or rate not in RATES_HZ:
            raise UsageError(
                f"{name} cannot be sent at {rate} Hz",
                remedy=f"rates: {', '.join(map(str, RATES_HZ))} Hz",
            )
        found[name] = item, int(rate)
    return found


async def _observe(
    state: AircraftState, wanted: Mapping[str, tuple[Item, int]]
) -> dict[str, float]:
    """The rates at which these items arrive, Hz; ``NotObserved`` if they are others."""
    await asyncio.sleep(_SETTLING_S)
    clock = asyncio.get_running_loop().time
    before = {name: state.statistics(item.record).count for name, (item, _) in wanted.items()}
    began_at = clock()
    slow = any(rate == 1 for _, rate in wanted.values())
    await asyncio.sleep(_WATCH_SLOW_S if slow else _WATCH_S)
    seconds = clock() - began_at
    observed = {
        name: (state.statistics(item.record).count - before[name]) / seconds
        for name, (item, _) in wanted.items()
    }
    others = [
        f"{name} arrives at {observed[name]:.1f} Hz instead of {rate}"
        for name, (_, rate) in wanted.items()
        if abs(observed[name] - rate) > _TOLERANCE * rate + 1.0 / seconds
    ]
    if others:
        raise NotObserved(
            f"the rates were accepted, but {', '.join(others)}",
            situation={"observed_hz": observed},
            cause="the line does not carry so much at its baud rate, or another program set others",
            remedy="see what arrives: m100link hz; fewer items, or a higher baud rate",
        )
    return observed
