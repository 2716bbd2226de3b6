"""``m100link fleet mission``: plans that an aircraft of a fleet flies by itself."""

from __future__ import annotations

import asyncio
import signal
import sys
from collections.abc import Awaitable, Callable
from dataclasses import asdict
from typing import Annotated

import cyclopts
from cyclopts import Parameter

from m100link.apps.agent.messages import Action, Ask, Message
from m100link.apps.cli.common import err, out, run_async
from m100link.apps.cli.fleet import (
    NO_OPTIONS,
    FleetOptions,
    Left,
    borrowed,
    shared,
    told_when_interrupted,
)
from m100link.apps.cli.mission import event_name, event_words
from m100link.apps.cli.outcome import ExitCode, print_json
from m100link.apps.cli.plan import File, FileOptions, read_plan
from m100link.apps.cli.terminal import ReaderGone
from m100link.apps.fleet.client import FleetAircraft
from m100link.apps.fleet.missions.flight import FleetMission, MissionOrders
from m100link.apps.fleet.payloads import MissionCard, MissionStage, Reply
from m100link.errors import UsageError
from m100link.flight.missions.events import Finished, MissionEvent, MissionProgress, Reached
from m100link.missions.plan import AtEnd, WaypointPlan

app = cyclopts.App(
    name="mission",
    help="Let an aircraft fly a plan by itself, and act on a mission that flies (firmware 3.1).",
    version_flags=(),
)

Yes = Annotated[bool, Parameter(name=["--yes", "-y"], negative=())]
TakeOff = Annotated[bool, Parameter(negative=())]


@app.command
def fly(
    name: str,
    plan: File,
    /,
    *,
    file: FileOptions | None = None,
    take_off: TakeOff = False,
    take_over: Annotated[bool, Parameter(negative=())] = False,
    yes: Yes = False,
    options: FleetOptions = NO_OPTIONS,
) -> int:
    """Upload a plan, let the aircraft fly it, and watch. Ctrl-C stops it, and the aircraft hovers.

    It flies as long as this command holds the lease. Killed, or cut off from the network, it loses
    that within three seconds: the mission is stopped, and the agent's --lost says what follows.
    Meanwhile `pause`, `resume` and `stop` act on it from another shell.

    Args:
        name: Which aircraft.
        plan: A file, JSON or .plan; - is standard input.
        take_off: Take off first, from the ground.
        take_over: Take control from whoever has it.
        yes: Do not ask.
    """
    found = read_plan(plan, file)
    show = _Show(name, found, as_json=options.json_output)
    if not yes:
        _confirm(name, found, take_off=take_off)

    async def run() -> int:
        loop, here = asyncio.get_running_loop(), asyncio.current_task()
        assert here is not None
        loop.add_signal_handler(signal.SIGTERM, here.cancel)
        try:
            async with options.open() as fleet, fleet[name].control(take_over=take_over) as control:
                with shared(options.site, name, control.proof):
                    mission = control.waypoint_mission(found, take_off=take_off)
                    show.mission = mission
                    async with mission:
                        async for event in mission:
                            show.tell(event)
        except (asyncio.CancelledError, ReaderGone):
            err.print(show.stopped(), markup=False, soft_wrap=True)
            raise
        return ExitCode.OK

    try:
        return run_async(run())
    except ReaderGone:  # elsewhere that is success; here it ended a flight
        return ExitCode.FAILED
    except asyncio.CancelledError:  # by SIGTERM
        return ExitCode.INTERRUPTED


def _confirm(name: str, plan: WaypointPlan, *, take_off: bool) -> None:
    """Whether it may fly.

    Raises:
        UsageError: Nobody says so.
    """
    err.print(
        f"{name}: {len(plan.waypoints)} waypoints, about {plan.estimate()}; at the end "
        f"{plan.at_end.name.lower().replace('_', ' ')}, without RC {plan.on_rc_loss.name.lower()}. "
        "Ctrl-C stops it.",
        markup=False,
    )
    if not sys.stdin.isatty():
        raise UsageError(f"nobody can be asked whether {name} may fly this", remedy="--yes")
    what = "take off and fly" if take_off else "fly"
    if input(f"{what} this mission? [y/N] ").lower() != "y":
        raise UsageError("nothing was begun")


class _Show:
    """What a person sees of a mission, and what became of it."""

    def __init__(self, name: str, plan: WaypointPlan, *, as_json: bool) -> None:
        self._name, self._plan = name, plan
        self._is_json = as_json or not sys.stdout.isatty()
        self._reached: set[int] = set()
        self._is_finished = False
        self.mission: FleetMission | None = None

    def tell(self, event: MissionEvent) -> None:
        """Something happened."""
        if isinstance(event, Reached):
            self._reached.add(event.index)
        self._is_finished = self._is_finished or isinstance(event, Finished)
        if self._is_json:
            print_json({"name": self._name, "event": event_name(event)} | asdict(event))
            return
        words = event_words(event)
        if isinstance(event, MissionProgress):
            if event.distance_m is None:
                return
            words = f"{event.distance_m:.0f} m to waypoint {event.index}, {event.elapsed:.0f} s"
        done = f"{len(self._reached)} of {len(self._plan.waypoints)}"
        out.print(f"{self._name}: {done}  {words}", markup=False)

    def stopped(self) -> str:
        """What became of a mission that this program left before its end."""
        mission, name = self.mission, self._name
        if mission is None or not mission.has_begun:
            return f"{name}: mission not started"
        if not mission.is_over:
            return f"{name}: the stop was not confirmed; it ends with the lease, within 3 s"
        done = f"{len(self._reached)} of {len(self._plan.waypoints)} waypoints"
        if self._is_finished:
            lands = self._plan.at_end in (AtEnd.LAND, AtEnd.GO_HOME)
            return f"{name}: every waypoint was flown" + ("; it was landing" if lands else "")
        return f"{name}: mission stopped after {done}; it hovers: m100link fleet land {name}"


# -- under a lease that another command holds -----------------------------------------------------


_SEE = "m100link fleet mission progress {name} shows it"
_END = f"{_SEE}, m100link fleet stop {{name}} ends it: it hovers"
_UPLOAD = Left("the plan may be on board; it does not fly", _SEE)
_START = Left("a mission that it has heard of flies while the lease lasts", _END)
_PAUSE = Left("it may be paused, or fly on", _END)
_RESUME = Left("it may be paused still, or fly on", _END)
_STOP = Left(
    "it stops if it has heard of it", f"{_SEE}, m100link fleet mission stop {{name}} again"
)


def _ordering(
    name: str,
    options: FleetOptions,
    left: Left,
    do: Callable[[MissionOrders, FleetAircraft], Awaitable[str]],
) -> int:
    async def run() -> int:
        fence, token = borrowed(options.site, name)
        async with options.open() as fleet:
            aircraft = fleet[name]
            asker = aircraft.asker
            await asker.ask(Ask(0, Action.VERSION))  # its clock says how old an order is

            async def ask(message: Message) -> Reply:
                return await asker.ask(message, fence=fence, token=token)

            with told_when_interrupted(name, left):
                told = await do(MissionOrders(name, ask), aircraft)
        if options.json_output:
            print_json({"name": name, "outcome": "ok", "told": told})
        else:
            out.print(f"{name}: {told}", markup=False)
        return ExitCode.OK

    return run_async(run())


@app.command
def upload(
    name: str, plan: File, /, *, file: FileOptions | None = None, options: FleetOptions = NO_OPTIONS
) -> int:
    """Bring a plan on board, where it waits for its start. Control is that of `fleet lease`.

    Args:
        name: Which aircraft.
        plan: A file, JSON or .plan; - is standard input.
    """
    found = read_plan(plan, file)

    async def do(orders: MissionOrders, _: FleetAircraft) -> str:
        digest = await orders.upload(found)
        return f"{len(found.waypoints)} waypoints are on board: {digest[:16]}"

    return _ordering(name, options, _UPLOAD, do)


@app.command
def start(name: str, /, *, take_off: TakeOff = False, options: FleetOptions = NO_OPTIONS) -> int:
    """Let the plan fly that is on board; it goes on while `fleet lease` runs.

    Args:
        name: Which aircraft.
        take_off: Take off first, from the ground.
    """

    async def do(orders: MissionOrders, aircraft: FleetAircraft) -> str:
        card = await aircraft.mission()
        if not card.digest:
            raise UsageError(
                f"there is no plan on board {name}",
                remedy=f"m100link fleet mission upload {name} FILE",
            )
        await orders.start(card.digest, take_off=take_off)
        return f"the mission of {card.points} waypoints flies"

    return _ordering(name, options, _START, do)


@app.command
def pause(name: str, /, *, options: FleetOptions = NO_OPTIONS) -> int:
    """Pause the mission that flies; the aircraft hovers in it.

    Args:
        name: Which aircraft.
    """

    async def do(orders: MissionOrders, _: FleetAircraft) -> str:
        await orders.pause()
        return "paused"

    return _ordering(name, options, _PAUSE, do)


@app.command
def resume(name: str, /, *, options: FleetOptions = NO_OPTIONS) -> int:
    """Let a mission that is paused go on.

    Args:
        name: Which aircraft.
    """

    async def do(orders: MissionOrders, _: FleetAircraft) -> str:
        await orders.resume()
        return "it goes on"

    return _ordering(name, options, _RESUME, do)


# -- for everybody --------------------------------------------------------------------------------


@app.command
def stop(name: str, /, *, options: FleetOptions = NO_OPTIONS) -> int:
    """Stop whatever mission flies, whoever started it; the aircraft hovers. Needs no lease.

    Args:
        name: Which aircraft.
    """

    async def run() -> int:
        async with options.open() as fleet:
            with told_when_interrupted(name, _STOP):
                await fleet[name].stop()
        if options.json_output:
            print_json({"name": name, "outcome": "ok"})
        else:
            out.print(f"{name}: stopped", markup=False)
        return ExitCode.OK

    return run_async(run())


@app.command
def progress(name: str, /, *, options: FleetOptions = NO_OPTIONS) -> int:
    """Say how far the mission is.

    Args:
        name: Which aircraft.
    """

    async def run() -> int:
        async with options.open() as fleet:
            card = await fleet[name].mission()
        if options.json_output:
            print_json(asdict(card) | {"stage": card.stage.value, "reached": list(card.reached)})
        else:
            out.print(f"{name}: {_told(card)}", markup=False, soft_wrap=True)
        return ExitCode.OK

    return run_async(run())


def _told(card: MissionCard) -> str:
    """Where a mission is, in words."""
    if card.stage is MissionStage.NONE:
        is_none = card.kind in ("", "no mission")
        return "no mission" if is_none else f"a {card.kind}, which no pilot of the fleet started"
    words = f"{card.stage.value}, {len(set(card.reached))} of {card.points} waypoints"
    if card.is_paused:
        words += ", paused"
    if card.stage is MissionStage.FLYING:
        words += f", {card.elapsed_s:.0f} s"
        if card.distance_m is not None:
            words += f", {card.distance_m:.0f} m to waypoint {card.index}"
    return words if card.fault is None else f"{words}: {card.fault.seen}"
