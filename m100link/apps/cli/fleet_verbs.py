"""``m100link fleet``: the list, orders to many aircraft, logs, and the verbs of other files."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter
from rich.filesize import decimal
from rich.live import Live
from rich.progress import BarColumn, DownloadColumn, Progress, TextColumn, TransferSpeedColumn
from rich.table import Table

from m100link.apps.agent.background import is_set_within
from m100link.apps.agent.orders import Right
from m100link.apps.cli.common import ended_by_signal, err, out
from m100link.apps.cli.fleet import (
    NO_OPTIONS,
    All,
    FleetOptions,
    Left,
    Name,
    Names,
    TakeOver,
    results_of,
    say,
    tell_each,
    tell_results,
)
from m100link.apps.cli.fleet_plans import missions, shows
from m100link.apps.cli.fleet_setup import acl, agent, console, doctor, make, pki, router, up
from m100link.apps.cli.options import OUTPUT, Above0, AtMost, group
from m100link.apps.cli.terminal import ExitCode, ReaderGone, as_json, print_json, tell
from m100link.apps.fleet.asking import RIGHTS
from m100link.apps.fleet.client import Fleet, FleetAircraft
from m100link.apps.fleet.identity import WINDOW_S
from m100link.apps.fleet.keys import check_name, in_order
from m100link.apps.fleet.logs.fetching import Fetched
from m100link.apps.fleet.payloads import Card, Result
from m100link.apps.fleet.publisher import FleetTelemetry
from m100link.apps.fleet.revocations import Revocations
from m100link.apps.fleet.signing import merge_audit
from m100link.errors import FleetError
from m100link.log.folder import state_folder
from m100link.protocol.items import BY_RECORD
from m100link.protocol.records import Battery, FlightStatus, Position, Velocity
from m100link.telemetry.sample import Sample

app = group(
    "fleet", "Fly many aircraft on many machines: a router, agents on board, operators, formations."
)


# -- who is there ---------------------------------------------------------------------------------


@app.command(name="list")
async def list_(*, options: FleetOptions = NO_OPTIONS) -> None:
    """List the aircraft that are present: the state of each, and who has control."""
    options.tell_left_out()
    async with options.open() as fleet:
        names, cards = await fleet.names(), await fleet.cards()
    # An agent of an older release shows another token, but publishes its state all the same.
    names = in_order({*names, *cards})
    if as_json():
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


@app.command
async def takeoff(*names: Names, everybody: All = False, options: FleetOptions = NO_OPTIONS) -> int:
    """Let aircraft take off, all at once; each hovers at about 1.2 m, and control goes back."""
    return await tell_each(names, everybody, options, FleetAircraft.take_off, _TAKE_OFF)


@app.command
async def land(*names: Names, everybody: All = False, options: FleetOptions = NO_OPTIONS) -> int:
    """Land aircraft, all at once, without a question, even while others control them."""
    return await tell_each(names, everybody, options, FleetAircraft.land, _LANDING)


@app.command
async def stop(*names: Names, everybody: All = False, options: FleetOptions = NO_OPTIONS) -> int:
    """Stop aircraft, all at once, even while others control them: each hovers."""
    return await tell_each(names, everybody, options, FleetAircraft.stop, _STOP)


@app.command
async def goto(
    name: Name,
    latitude: Annotated[float, Parameter(allow_leading_hyphen=True)],
    longitude: Annotated[float, Parameter(allow_leading_hyphen=True)],
    height: Annotated[float, Above0],
    /,
    *,
    cruise_speed: Annotated[float, Above0] = 5.0,
    options: FleetOptions = NO_OPTIONS,
) -> int:
    """Let one aircraft fly straight to a position and hover there; its agent steers on board.

    Args:
        latitude: Degrees, WGS 84.
        longitude: Degrees, WGS 84.
        height: Metres above the take-off point.
        cruise_speed: Horizontal speed, m/s.
    """

    async def fly(aircraft: FleetAircraft) -> None:
        async with aircraft.control() as control:
            await control.fly_to(
                latitude_deg=latitude, longitude_deg=longitude, height=height, speed=cruise_speed
            )

    return await tell_each((name,), False, options, fly, _GOTO)


# -- ``m100link fleet monitor``, ``watch`` and ``lease`` -------------------------------------------


_OLD_S = 2.0


async def monitor(*, duration: AtMost = None, options: FleetOptions = NO_OPTIONS) -> None:
    """Watch all aircraft until Ctrl-C: the newest values of each, and their age.

    Agents send each item five times a second for this, or at its own rate if that is lower. With
    --json the command prints one object for each aircraft and second.
    """
    ended = ended_by_signal()
    if duration is not None:
        asyncio.get_running_loop().call_later(duration, ended.set)
    options.tell_left_out()
    async with options.open() as fleet:
        heard = FleetTelemetry(fleet.bus, fleet.keys)
        if as_json():
            while not await is_set_within(ended, 1.0):
                for name in in_order(fleet.present | set(heard.states)):
                    print_json(_facts(fleet, heard, name))
            return
        with Live(console=out, auto_refresh=False) as live:
            while not await is_set_within(ended, 0.5):
                live.update(_wall(fleet, heard), refresh=True)


def _facts(fleet: Fleet, heard: FleetTelemetry, name: str) -> dict[str, Any]:
    state = heard.states.get(name)
    facts: dict[str, Any] = {"name": name, "is_there": name in fleet.present}
    facts["received"] = heard.received[name]
    if state is not None:
        facts["age"] = state.newest_age
        kinds: tuple[type[Any], ...] = (Position, Velocity, Battery, FlightStatus)
        for kind in kinds:
            value = state.fresh(kind, now=state.newest_at)
            facts[BY_RECORD[kind].name] = None if value is None else value._asdict()
    return facts


def _wall(fleet: Fleet, heard: FleetTelemetry) -> Table:
    titles = ("name", "age", "phase", "height", "speed", "battery", "place")
    table = Table(*titles, box=None, pad_edge=False)
    for name in in_order(fleet.present | set(heard.states)):
        state = heard.states.get(name)
        if state is None:
            table.add_row(name, "never heard")
            continue
        # The state when it was heard last: an item that was old by then tells nothing.
        at, age = state.newest_at, state.newest_age or 0.0
        status, position = state.fresh(FlightStatus, now=at), state.fresh(Position, now=at)
        velocity, battery = state.fresh(Velocity, now=at), state.fresh(Battery, now=at)
        phase = status.phase if status is not None else None
        row = [
            name,
            f"{age:.1f} s" if name in fleet.present else f"gone, {age:.0f} s",
            "" if phase is None else phase.name.lower().replace("_", " "),
            "" if position is None else f"{position.height_m:z.1f} m",
            "" if velocity is None else f"{velocity.ground_speed_m_s:.1f} m/s",
            "" if battery is None else f"{battery.percent} %",
            "" if position is None else f"{position.latitude_deg:.6f} {position.longitude_deg:.6f}",
        ]
        is_old = age > _OLD_S or name not in fleet.present
        table.add_row(*row, style="red" if is_old else "")
    return table


async def watch(
    name: Name, /, *, duration: AtMost = None, options: FleetOptions = NO_OPTIONS
) -> None:
    """Print every telemetry package of one aircraft until Ctrl-C: one JSON object for each."""
    ended = ended_by_signal()
    gone: ReaderGone | None = None

    def tell(_: str, sample: Sample) -> None:
        nonlocal gone
        if gone is not None:
            return
        try:
            print_json(_package(sample))
        except ReaderGone as error:
            # The subscription that calls this takes no error, and later samples would be lost.
            gone = error
            ended.set()

    if duration is not None:
        asyncio.get_running_loop().call_later(duration, ended.set)
    async with options.open() as fleet:
        asker = fleet.asker(name)
        asker.require(Right.WATCH)
        if not await asker.is_there():
            say(f"{name} is not there, or you have no right to watch it: waiting for it", to=err)
        heard = FleetTelemetry(fleet.bus, asker.keys, full=True, on_sample=tell)
        await ended.wait()
        heard.close()
        err.print(f"{heard.received[name]} packages")
    if gone is not None:
        raise gone
    if not heard.received[name]:
        raise FleetError(
            f"no package of {name} came that can be read",
            cause="it is not there, has no aircraft, or this identity has no right to watch it",
            remedy=f"m100link fleet list; {RIGHTS}",
        )


def _package(sample: Sample) -> dict[str, Any]:
    values: dict[str, Any] = {"received_at": sample.received_at}
    for kind, item in BY_RECORD.items():
        value = sample.get(kind)
        if value is not None:
            values[item.name] = value._asdict()
    return values


async def lease(
    name: Name, /, *, take_over: TakeOver = False, options: FleetOptions = NO_OPTIONS
) -> None:
    """Take control of one aircraft and hold it, hovering, until Ctrl-C."""
    ended = ended_by_signal()
    async with options.open() as fleet, fleet[name].control(take_over=take_over) as control:
        facts = {"name": name, "fence": control.fence}
        words = f"{name}: lease {control.fence}, until Ctrl-C"
        tell(facts, words)
        await ended.wait()
        if not as_json():
            err.print(f"{name}: control goes back: it hovers")


# -- ``m100link fleet log``: the flight logs that lie on board -------------------------------------


log = group("log", "List and fetch the flight logs that agents have recorded on board.")


def _failures(results: dict[str, Result], options: FleetOptions) -> int:
    """Tell what went wrong; the exit status."""
    bad = {name: one for name, one in results.items() if not one.is_ok}
    return ExitCode.OK if results and not bad else tell_results(bad, options)


@log.command(name="list")
async def logs(*names: Names, everybody: All = False, options: FleetOptions = NO_OPTIONS) -> int:
    """List the flight logs on board, the newest first."""
    results = await results_of(names, everybody, options, FleetAircraft.logs)
    rows = [
        (name, one)
        for name, result in sorted(results.items())
        if isinstance(result.value, list)
        for one in result.value
    ]
    if rows and not as_json():
        say(f"{'name':12} {'log':32} {'size':>9}  last written (UTC)")
    for name, one in rows:
        is_written = ", and still" if one.is_written else ""
        words = f"{name:12} {one.log:32} {decimal(one.size):>9}  {_day(one.at)}{is_written}"
        tell({"name": name} | asdict(one), words)
    if results and not rows and not as_json():
        err.print("no logs")
    return _failures(results, options)


def _day(at: float) -> str:
    return time.strftime("%Y-%m-%d %H:%M:%S", time.gmtime(at))


@log.command
async def audit(
    *names: Names,
    everybody: All = False,
    output: Annotated[Path | None, OUTPUT] = None,
    options: FleetOptions = NO_OPTIONS,
) -> int:
    """Merge the signed logs of orders: who ordered what of which aircraft, when, and the outcome.

    A line begins with the time of the order, by its sender's clock; then come the time of the
    outcome, by the clock on board, and the outcome. The lines stay in a file NAME.audit here, and
    the command fetches only newer ones. It names each line that somebody altered or removed, on
    board or here; the status is 1 then.

    Args:
        output: Folder of those files; by default audit/SITE in m100link of the user's state folder.
    """
    folder = output or state_folder() / "audit" / check_name(options.place, "a site")
    authority = Revocations.of_folder(options.folder).authority

    async def one(it: FleetAircraft) -> tuple[list[dict[str, Any]], list[str]]:
        return await merge_audit(folder / f"{it.name}.audit", it.name, it.audit, authority)

    results = await results_of(names, everybody, options, one)
    merged = {name: one.value for name, one in results.items() if isinstance(one.value, tuple)}
    rows = [(facts["at"], name, facts) for name, (lines, _) in merged.items() for facts in lines]
    for at, name, facts in sorted(rows, key=lambda row: row[0]):
        if "order" in facts:
            ordered = _day(facts["ordered_at"]) if "ordered_at" in facts else ""
            words = f"{ordered:19}  {name:8} {facts['signer'] or facts['by']:12} "
            words += f"{facts['order']:16} {_day(at)} {facts['outcome']}  {facts.get('why', '')}"
            tell({"name": name} | facts, words.rstrip())
    wrong = [f"{name}: {text}" for name, (_, texts) in merged.items() for text in texts]
    say(*wrong, to=err)
    return _failures(results, options) or (ExitCode.FAILED if wrong else ExitCode.OK)


@log.command
async def fetch(
    *names: Names,
    everybody: All = False,
    file: str = "",
    output: Annotated[Path, OUTPUT] = Path(),
    options: FleetOptions = NO_OPTIONS,
) -> int:
    """Fetch a flight log of each aircraft, by default the newest, into a file NAME-LOG.

    If Ctrl-C or the network cuts it off, the part stays in a file that ends in .part, and the same
    command continues. A log that is still being written is fetched up to its current end.

    Args:
        file: The log of that name, as `m100link fleet log list` shows it.
        output: Folder for the file.
    """
    shown = _Shown()

    async def one(aircraft: FleetAircraft) -> Fetched:
        fetched = await aircraft.fetch_log(file, output, shown.listener(aircraft.name))
        shown.done(fetched)
        return fetched

    try:
        with shown.bar:
            results = await results_of(names, everybody, options, one)
    except asyncio.CancelledError:
        shown.interrupted()
        raise
    return _failures(results, options)


class _Shown:
    """How far each log is: bars in a terminal, a line for each that is here."""

    def __init__(self) -> None:
        columns = (TextColumn("{task.description}"), BarColumn(), DownloadColumn())
        self._progress = Progress(*columns, TransferSpeedColumn(), console=err, transient=True)
        self._at: dict[str, tuple[int, int]] = {}

    @property
    def bar(self) -> Any:
        """Is on the terminal while the block runs; a pipe has none."""
        return self._progress if err.is_terminal else nullcontext()

    def listener(self, name: str) -> Callable[[int, int], None]:
        """Takes how far the log of one aircraft is."""
        bar = self._progress.add_task(name, total=None, visible=False)

        def tell(at: int, size: int) -> None:
            self._at[name] = (at, size)
            self._progress.update(bar, total=size, completed=at, visible=True)

        return tell

    def done(self, fetched: Fetched) -> None:
        self._at.pop(fetched.name, None)
        text = f"{fetched.size:,} bytes"
        if fetched.came < fetched.size:
            text += f", of which {fetched.size - fetched.came:,} were here already"
        if fetched.is_written:
            text += "; the log is still being written, and this is its part so far"
        facts = asdict(fetched) | {"path": str(fetched.path), "outcome": "ok"}
        tell(facts, f"{fetched.name}: {fetched.path}: {text}")

    def interrupted(self) -> None:
        """Say how much is here of each log that was not finished."""
        for name, (at, size) in self._at.items():
            text = f"{name}: {at:,} of {size:,} bytes are here; the same command continues"
            say(text, to=err)


# -- in the order of their help --------------------------------------------------------------------

_PARTS = make, up, doctor, router, agent, console
for _verb in (*_PARTS, monitor, watch, lease, missions, log, shows, pki, acl):
    app.command(_verb)
