"""``m100link fleet``: the list, orders to many aircraft at once, and the verbs of other files."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Awaitable, Callable
from dataclasses import asdict
from typing import Annotated

from cyclopts import Parameter
from rich.table import Table

from m100link.apps.cli.common import err, out
from m100link.apps.cli.fleet import (
    NO_OPTIONS,
    All,
    Begun,
    FleetOptions,
    Left,
    Name,
    Names,
    results_of,
    tell_results,
)
from m100link.apps.cli.fleet_plans import missions, shows
from m100link.apps.cli.fleet_setup import acl, agent, console, make, pki, router, up
from m100link.apps.cli.fleet_watch import app as log
from m100link.apps.cli.fleet_watch import lease, monitor, watch
from m100link.apps.cli.options import Above0, group
from m100link.apps.cli.terminal import print_json
from m100link.apps.fleet.client import FleetAircraft
from m100link.apps.fleet.identity import WINDOW_S
from m100link.apps.fleet.keys import in_order
from m100link.apps.fleet.payloads import Card

app = group(
    "fleet", "Fly many aircraft on many machines: a router, agents on board, operators, formations."
)


# -- who is there ---------------------------------------------------------------------------------


@app.command(name="list")
async def list_(*, options: FleetOptions = NO_OPTIONS) -> None:
    """List the aircraft that are present: the state of each, and who has control."""
    async with options.open() as fleet:
        names, cards = await fleet.names(), await fleet.cards()
    # An agent of an older release shows another token, but publishes its state all the same.
    names = in_order({*names, *cards})
    if options.json_output:
        for name in names:
            print_json(asdict(cards[name]) if name in cards else {"name": name})
        return
    if not names:
        err.print(f"there is no agent at site {options.place}")
    else:
        out.print(_table(names, cards))


def _table(names: list[str], cards: dict[str, Card]) -> Table:
    titles = ("name", "link", "phase", "height", "battery", "flies", "control", "when lost")
    table = Table(*titles, box=None, pad_edge=False)
    for name in names:
        card = cards.get(name)
        if card is None:
            table.add_row(name, "no answer")
            continue
        if card.fault is not None and not card.boot:
            table.add_row(name, _link(card))
            continue
        height = "" if card.height_m is None else f"{card.height_m:z.1f} m"
        battery = "" if card.battery_percent is None else f"{card.battery_percent} %"
        lost = f"{card.lost} after {card.lost_after:g} s"
        row = (name, _link(card), card.phase, height, battery, card.task, card.holder, lost)
        table.add_row(*row)
    return table


def _link(card: Card) -> str:
    """The state of the link, and what would refuse an order: credentials, or the calendar."""
    said = card.connection if card.fault is None else f"{card.connection}: {card.fault.seen}"
    ahead = card.at - time.time()
    if abs(ahead) <= WINDOW_S or not card.boot:
        return said
    side = "ahead of" if ahead > 0 else "behind"
    return f"{said}; clock {abs(ahead):.0f} s {side} this one"


# -- what they are asked --------------------------------------------------------------------------

_GOES_BACK = "control goes back, within 3 s at the latest: "
_TAKE_OFF = Left(
    f"{_GOES_BACK}an aircraft in the air hovers",
    "m100link fleet list shows it, m100link fleet land {name} lands it",
)
_LANDING = Left(
    "a landing goes on if the order arrived",
    "m100link fleet list shows it; after m100link fleet stop {name} the aircraft hovers",
)
_STOP = Left(
    "it stops if the order arrived",
    "m100link fleet list shows it, m100link fleet stop {name} again",
)
_GOTO = Left(
    f"{_GOES_BACK}it brakes and hovers",
    "m100link fleet list shows it, m100link fleet land {name} lands it",
)


async def _each(
    names: tuple[str, ...],
    everybody: bool,
    options: FleetOptions,
    do: Callable[[FleetAircraft], Awaitable[object]],
    left: Left,
) -> int:
    begun = Begun(do, left)
    try:
        return tell_results(await results_of(names, everybody, options, begun), options)
    except asyncio.CancelledError:
        if begun.results:
            tell_results(begun.results, options)
        raise


@app.command
async def takeoff(*names: Names, everybody: All = False, options: FleetOptions = NO_OPTIONS) -> int:
    """Let aircraft take off, all at once; each hovers at about 1.2 m, and control goes back."""
    return await _each(names, everybody, options, FleetAircraft.take_off, _TAKE_OFF)


@app.command
async def land(*names: Names, everybody: All = False, options: FleetOptions = NO_OPTIONS) -> int:
    """Land aircraft, all at once, without a question, even while others control them."""
    return await _each(names, everybody, options, FleetAircraft.land, _LANDING)


@app.command
async def stop(*names: Names, everybody: All = False, options: FleetOptions = NO_OPTIONS) -> int:
    """Stop aircraft, all at once, even while others control them: each hovers."""
    return await _each(names, everybody, options, FleetAircraft.stop, _STOP)


@app.command
async def goto(
    name: Name,
    latitude: Annotated[float, Parameter(allow_leading_hyphen=True)],
    longitude: Annotated[float, Parameter(allow_leading_hyphen=True)],
    height: Annotated[float, Above0],
    /,
    *,
    speed: Annotated[float, Above0] = 5.0,
    options: FleetOptions = NO_OPTIONS,
) -> int:
    """Let one aircraft fly straight to a position and hover there; its agent steers on board.

    Args:
        latitude: Degrees, WGS 84.
        longitude: Degrees, WGS 84.
        height: Metres above the take-off point.
        speed: Greatest horizontal speed, m/s.
    """

    async def fly(aircraft: FleetAircraft) -> None:
        async with aircraft.control() as control:
            await control.fly_to(
                latitude_deg=latitude, longitude_deg=longitude, height=height, speed=speed
            )

    return await _each((name,), False, options, fly, _GOTO)


# -- in the order of their help --------------------------------------------------------------------

for _verb in (
    make,
    up,
    router,
    agent,
    console,
    monitor,
    watch,
    lease,
    missions,
    log,
    shows,
    pki,
    acl,
):
    app.command(_verb)
