"""``m100link fleet log``: the flight logs that lie on board."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Awaitable, Callable
from contextlib import nullcontext
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

import cyclopts
from cyclopts import Parameter
from rich.filesize import decimal
from rich.progress import BarColumn, DownloadColumn, Progress, TextColumn, TransferSpeedColumn

from m100link.apps.cli.common import err, out, run_async
from m100link.apps.cli.fleet import NO_OPTIONS, All, FleetOptions, Names, tell_results, wanted_names
from m100link.apps.cli.outcome import ExitCode, print_json
from m100link.apps.fleet.client import FleetAircraft
from m100link.apps.fleet.logs.fetching import Fetched
from m100link.apps.fleet.outcome import Result
from m100link.errors import UsageError

__all__ = ["app"]

app = cyclopts.App(
    name="log",
    help="List and fetch the flight logs that agents have recorded on board.",
    version_flags=(),
)


async def _each(
    names: tuple[str, ...],
    everybody: bool,
    options: FleetOptions,
    do: Callable[[FleetAircraft], Awaitable[object]],
) -> dict[str, Result]:
    wanted = wanted_names(names, everybody)
    async with options.open() as fleet:
        return await fleet.each(do, wanted)


def _failures(results: dict[str, Result], options: FleetOptions) -> int:
    """Tell what went wrong; the exit status."""
    if not results:
        err.print(f"no agent is there at site {options.site}")
        return ExitCode.NO_LINK
    bad = {name: one for name, one in results.items() if not one.is_ok}
    return tell_results(bad, as_json=options.json_output) if bad else ExitCode.OK


def _print(line: str) -> None:
    out.print(line, markup=False, soft_wrap=True)


@app.command(name="list")
def list_(*names: Names, everybody: All = False, options: FleetOptions = NO_OPTIONS) -> int:
    """List the flight logs on board, the newest first.

    Args:
        names: Which aircraft.
        everybody: All of them.
        options: Which fleet.
    """

    async def run() -> int:
        results = await _each(names, everybody, options, FleetAircraft.logs)
        rows = [
            (name, one)
            for name, result in sorted(results.items())
            if isinstance(result.value, list)
            for one in result.value
        ]
        if rows and not options.json_output:
            _print(f"{'name':12} {'log':32} {'size':>9}  last written (UTC)")
        for name, one in rows:
            if options.json_output:
                print_json({"name": name} | asdict(one))
                continue
            at = time.strftime("%Y-%m-%d %H:%M:%S", time.gmtime(one.at))
            is_written = ", and still" if one.is_written else ""
            _print(f"{name:12} {one.log:32} {decimal(one.size):>9}  {at}{is_written}")
        if results and not rows and not options.json_output:
            err.print("no logs")
        return _failures(results, options)

    return run_async(run())


@app.command
def fetch(
    *names: Names,
    everybody: All = False,
    last: Annotated[bool, Parameter(negative=())] = False,
    file: str = "",
    to: Path = Path(),
    options: FleetOptions = NO_OPTIONS,
) -> int:
    """Bring a flight log of each aircraft here, into a file NAME-LOG.

    What was cut off, by Ctrl-C or by the network, stays in a file that ends in .part; the same
    command goes on there. Of a log that is being written still comes what there is of it.

    Args:
        names: Of which aircraft.
        everybody: Of all of them.
        last: The newest log of each, as without --file.
        file: The log of that name, as `m100link fleet log list` shows it.
        to: Folder for it.
        options: Which fleet.
    """
    if last and file:
        raise UsageError("--last and --file name two logs", remedy="leave out one of them")
    shown = _Shown(is_quiet=options.json_output)

    async def one(aircraft: FleetAircraft) -> Fetched:
        fetched = await aircraft.fetch_log(file, to, shown.listener(aircraft.name))
        shown.done(fetched)
        return fetched

    async def run() -> int:
        try:
            with shown.bar:
                results = await _each(names, everybody, options, one)
        except asyncio.CancelledError:
            shown.interrupted()
            raise
        return _failures(results, options)

    return run_async(run())


class _Shown:
    """How far each log is: bars in a terminal, a line for each that is here."""

    def __init__(self, *, is_quiet: bool) -> None:
        self._is_json = is_quiet
        columns = (TextColumn("{task.description}"), BarColumn(), DownloadColumn())
        self._progress = Progress(*columns, TransferSpeedColumn(), console=err, transient=True)
        self._tasks: dict[str, Any] = {}
        self._at: dict[str, tuple[int, int]] = {}

    @property
    def bar(self) -> Any:
        """Is on the terminal while the block runs; a pipe has none."""
        return self._progress if err.is_terminal else nullcontext()

    def listener(self, name: str) -> Callable[[int, int], None]:
        """Takes how far the log of one aircraft is."""

        def tell(at: int, size: int) -> None:
            if name not in self._tasks:
                self._tasks[name] = self._progress.add_task(name, total=size, completed=at)
            self._at[name] = (at, size)
            self._progress.update(self._tasks[name], completed=at)

        return tell

    def done(self, fetched: Fetched) -> None:
        """One is here."""
        self._at.pop(fetched.name, None)
        if self._is_json:
            print_json(asdict(fetched) | {"path": str(fetched.path), "outcome": "ok"})
            return
        told = f"{fetched.size:,} bytes"
        if fetched.came < fetched.size:
            told += f", {fetched.size - fetched.came:,} of them were here"
        if fetched.is_written:
            told += "; it is being written still, and this is what there was of it"
        out.print(f"{fetched.name}: {fetched.path}: {told}", markup=False, soft_wrap=True)

    def interrupted(self) -> None:
        """What is here of those that were not finished."""
        for name, (at, size) in self._at.items():
            text = f"{name}: {at:,} of {size:,} bytes are here; the same command goes on there"
            err.print(text, markup=False, soft_wrap=True)
