"""``m100link replay``: recorded flights in the console, as they were."""

from __future__ import annotations

import asyncio
import contextlib
import math
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any, Literal

from cyclopts import Parameter

from m100link.apps.agent import orders
from m100link.apps.cli.common import err
from m100link.apps.cli.serve import (
    AS_CONFIGURED,
    IN_BROWSER,
    PageOptions,
    StationOptions,
    aircraft_of,
    run_station,
)
from m100link.apps.cli.terminal import keys_pressed
from m100link.apps.station.config import namespace_of
from m100link.errors import M100Error, UsageError

KEYS = {
    " ": "toggle",
    "LEFT": "by -10",
    "RIGHT": "by 10",
    "<": "by -60",
    ">": "by 60",
    "+": "faster",
    "-": "slower",
    "1": "speed 1",
    "m": "speed max",
    "0": "seek 0",
}

_HELP = "keys: space pauses, ← → 10 s, < > a minute, + - speed, 1 real speed, 0 begin, q quits"


async def replay(
    *file: Path,
    speed: Annotated[float | Literal["max"], Parameter()] = 1.0,
    from_: Annotated[float, Parameter(name="--from")] = 0.0,
    to: float | None = None,
    options: StationOptions = AS_CONFIGURED,
    page: PageOptions = IN_BROWSER,
) -> int:
    """Replay flights in the console: pause, seek, change the speed.

    Nothing flies: the page says REPLAY and gives no control. Two files are two aircraft of one
    station, each with its own page.

    Args:
        file: Flight logs of `m100link record`, `serve`, `console`, `demo` or connect(record=…).
        speed: Speed of the replay, 0.1 to 100 times the flight's, or max.
        from_: Where to begin, in seconds from the first byte.
        to: Where to end, in seconds from the first byte.
    """
    if not file:
        raise UsageError("no flight log was named", remedy="m100link replay flight.mcap")
    end = "" if to is None else f"&to={to!r}"
    urls = [f"replay://{path.absolute()}?speed={speed}&from={from_!r}{end}" for path in file]
    words = urls
    if len(urls) > 1:
        names = _names(file)
        words = [f"{name}={url}" for name, url in zip(names, urls, strict=True)]
    aircraft = aircraft_of(options, words, page=page, launch=options.launch, no_record=True)
    return await run_station(
        aircraft, options.run, with_console=True, open_browser=page.open_browser, keys=_keys
    )


def _names(files: tuple[Path, ...]) -> list[str]:
    """Names of the aircraft: those of their files, each only once."""
    names: list[str] = []
    for path in files:
        stem = re.sub(r"[^A-Za-z0-9_]+", "_", path.stem).strip("_") or "flight"
        stem = stem if stem[0].isalpha() else f"flight_{stem}"
        name, number = stem, 1
        while namespace_of(name) in map(namespace_of, names):
            number += 1
            name = f"{stem}_{number}"
        names.append(name)
    return names


@contextlib.contextmanager
def _keys(station: Any, ended: asyncio.Event) -> Iterator[None]:
    """Let keys of the terminal, if there is one, control the replay."""
    tasks: set[asyncio.Task[None]] = set()

    def pressed(key: str) -> None:
        if key == "q":
            ended.set()
        elif key in KEYS:
            task = asyncio.get_running_loop().create_task(_order(station, KEYS[key]))
            tasks.add(task)
            task.add_done_callback(tasks.discard)

    with keys_pressed(pressed) as is_terminal:
        if is_terminal:
            err.print(_HELP, markup=False)
        yield


async def _order(station: Any, text: str) -> None:
    agents = getattr(station, "agents", None)
    try:
        if agents is None:
            await station.agent.ask(orders.OrderReplay(text))
            now = station.agent.replay.progress()
        else:
            for agent in agents.values():
                await agent.ask(orders.OrderReplay(text))
            now = next(iter(agents.values())).state.replay
    except M100Error as error:
        err.print(error.seen, style="yellow", markup=False)
        return
    if now is not None:
        speed = "max" if not now.speed else f"{now.speed:g} ×"
        state = "at its end" if now.is_at_end else "paused" if now.is_paused else speed
        err.print(f"{_clock(now.position_s)} of {_clock(now.duration_s)}, {state}", markup=False)


def _clock(seconds: float) -> str:
    whole = math.floor(seconds)
    return f"{whole // 60}:{whole % 60:02d}"
