"""``m100link fleet mission`` and ``fleet show``: plans and formations."""

from __future__ import annotations

import asyncio
import json
import sys
from collections.abc import Awaitable, Callable
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter

from m100link.apps.agent.orders import AskVersion, Order, Right
from m100link.apps.cli.common import EnvelopeOptions, ended_by_signal, err, out, run_async
from m100link.apps.cli.fleet import (
    NO_OPTIONS,
    FleetOptions,
    Left,
    Name,
    TakeOver,
    borrowed,
    say,
    shared,
    tell_each,
    write_out,
)
from m100link.apps.cli.mission import announced, event_name, event_words
from m100link.apps.cli.options import Above0, Force, Yes, group
from m100link.apps.cli.plan import File, FileOptions, PlanFile, TakeOff, degrees, read_plan
from m100link.apps.cli.terminal import ExitCode, ReaderGone, as_json, print_json, tell
from m100link.apps.fleet.client import FleetAircraft
from m100link.apps.fleet.missions.flight import FleetMission, MissionOrders
from m100link.apps.fleet.payloads import MissionCard, MissionStage, OrderReply, ShowStage
from m100link.apps.fleet.show.conductor import Conductor
from m100link.apps.fleet.show.plan.document import Report, Show, imported, svg
from m100link.apps.fleet.show.plan.document import check as report_on
from m100link.apps.fleet.show.plan.track import BadShow
from m100link.apps.fleet.show.track_executor import Leave
from m100link.errors import UsageError
from m100link.flight.guards import Envelope
from m100link.flight.missions.events import Finished, MissionEvent, MissionProgress, Reached
from m100link.missions.plan import AtEnd, WaypointPlan

missions = group(
    "mission",
    "Let an aircraft fly a plan by itself, and act on a mission in flight (firmware 3.1).",
)


@missions.command
def fly(
    name: Name,
    plan: PlanFile,
    /,
    *,
    file: FileOptions | None = None,
    take_off: TakeOff = False,
    take_over: TakeOver = False,
    yes: Yes = False,
    options: FleetOptions = NO_OPTIONS,
) -> int:
    """Upload a plan, let the aircraft fly it, and watch. Ctrl-C stops it, and the aircraft hovers.

    The mission flies as long as this command holds the lease. If the command is killed or cut off
    from the network, the lease ends within three seconds: the agent stops the mission, and its
    --lost says what follows. `pause`, `resume` and `stop` act on the mission from another shell.
    """
    found = read_plan(plan, file)
    show = _Show(name, found)
    if not yes:
        _confirm(name, found, take_off=take_off or found.take_off)

    async def run() -> int:
        ended_by_signal()
        try:
            async with options.open() as fleet, fleet[name].control(take_over=take_over) as control:
                with shared(options.place, name, control.proof):
                    mission = control.waypoint_mission(found, take_off=take_off)
                    show.mission = mission
                    async with mission:
                        async for event in mission:
                            show.tell(event)
        except (asyncio.CancelledError, ReaderGone) as error:  # by a signal, or by its pipe
            say(show.stopped(), to=err)
            # Elsewhere a closed pipe is success; here it ended a flight.
            return ExitCode.FAILED if isinstance(error, ReaderGone) else ExitCode.INTERRUPTED
        return ExitCode.OK

    return run_async(run())


def _confirm(name: str, plan: WaypointPlan, *, take_off: bool) -> None:
    err.print(f"{name}: {announced(plan)}. Ctrl-C stops it.")
    _ask(f"{name} may fly this", f"{'take off and ' if take_off else ''}fly this mission?")


def _ask(what: str, question: str) -> None:
    """Whether it may begin. Raises UsageError: nobody says so."""
    if not sys.stdin.isatty():
        raise UsageError(f"no terminal to ask whether {what}", remedy="--yes")
    if input(f"{question} [y/N] ").lower() not in ("y", "yes"):
        raise UsageError("nothing was begun", remedy="answer y, or give --yes")


class _Show:
    def __init__(self, name: str, plan: WaypointPlan) -> None:
        self._name, self._plan = name, plan
        self._reached: set[int] = set()
        self._is_finished = False
        self.mission: FleetMission | None = None

    def tell(self, event: MissionEvent) -> None:
        if isinstance(event, Reached):
            self._reached.add(event.index)
        self._is_finished = self._is_finished or isinstance(event, Finished)
        if as_json():
            print_json({"name": self._name, "event": event_name(event)} | asdict(event))
            return
        words = event_words(event)
        if isinstance(event, MissionProgress) and event.distance_m is None:
            return
        done = f"{len(self._reached)} of {len(self._plan.waypoints)}"
        out.print(f"{self._name}: {done}  {words}")

    def stopped(self) -> str:
        """The outcome of a mission that this program left before its end."""
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
_END = f"{_SEE}; after m100link fleet stop {{name}} the aircraft hovers"
_PAUSE = Left("the mission may be paused, or fly on", _END)
_RESUME = Left("the mission may still be paused, or fly on", _END)
_STOP = Left("it stops if the order arrived", f"{_SEE}, m100link fleet mission stop {{name}} again")


async def _ordering(
    name: str, options: FleetOptions, left: Left, do: Callable[[MissionOrders], Awaitable[None]]
) -> int:
    fence, token = borrowed(options.place, name)

    async def act(it: FleetAircraft) -> None:
        async def ask(order: Order) -> OrderReply:
            return await it.asker.ask(order, fence=fence, token=token)

        it.asker.require(Right.FLY, ends=do is MissionOrders.pause)
        await it.asker.ask(AskVersion())  # its clock says how old an order is
        await do(MissionOrders(ask))

    return await tell_each((name,), False, options, act, left)


@missions.command
async def pause(name: Name, /, *, options: FleetOptions = NO_OPTIONS) -> int:
    """Pause the mission in flight; the aircraft hovers."""
    return await _ordering(name, options, _PAUSE, MissionOrders.pause)


@missions.command
async def resume(name: Name, /, *, options: FleetOptions = NO_OPTIONS) -> int:
    """Resume a paused mission."""
    return await _ordering(name, options, _RESUME, MissionOrders.resume)


# -- without a lease -------------------------------------------------------------------------------


@missions.command
async def stop(name: Name, /, *, options: FleetOptions = NO_OPTIONS) -> int:
    """Stop any mission, also one that somebody else started; the aircraft hovers. Needs no lease.

    Args:
        name: Name of the aircraft.
    """
    return await tell_each((name,), False, options, FleetAircraft.stop, _STOP)


@missions.command
async def progress(name: Name, /, *, options: FleetOptions = NO_OPTIONS) -> int:
    """Show the progress of the mission."""
    async with options.open() as fleet:
        card = await fleet[name].mission()
    facts = asdict(card) | {"stage": card.stage.value, "reached": list(card.reached)}
    return tell(facts, f"{name}: {_progress(card)}")


def _progress(card: MissionCard) -> str:
    if card.stage is MissionStage.NONE:
        is_none = card.kind in ("", "no mission")
        return "no mission" if is_none else f"a {card.kind}, which no operator of the fleet started"
    words = f"{card.stage.value}, {len(set(card.reached))} of {card.points} waypoints"
    if card.is_paused:
        words += ", paused"
    if card.stage is MissionStage.FLYING:
        words += f", {card.elapsed_s:.0f} s"
        if card.distance_m is not None:
            words += f", {card.distance_m:.0f} m to waypoint {card.index}"
    return words if card.fault is None else f"{words}: {card.fault.seen}"


# -- ``m100link fleet show``: check, draw and fly formations ---------------------------------------


shows = group("show", "Check, draw and fly formations, whose aircraft fly timed tracks.")

ShowFile = Annotated[File, Parameter(help="A file of JSON; - is standard input.")]


@Parameter(name="*")
@dataclass(frozen=True)
class ShowEnvelopeOptions(EnvelopeOptions):
    """How far the agents' guards let each aircraft fly.

    Attributes:
        max_speed: Greatest horizontal speed, m/s; tracks may use four fifths of it.
    """

    max_speed: Annotated[float, Above0] = Envelope().max_speed_m_s

    @property
    def envelope(self) -> Envelope:
        """With its speed."""
        return replace(super().envelope, max_speed_m_s=self.max_speed)


def _read(file: File) -> Show:
    if str(file) == "-":
        return Show.parse(sys.stdin.buffer.read())
    return Show.read(file)


@shows.command
def check(show: ShowFile, /, *, guards: ShowEnvelopeOptions = ShowEnvelopeOptions()) -> int:
    """Check a show: the limits of each aircraft, and when which two come too near to each other.

    The exit status is 0 if the show may be flown, 2 if not.
    """
    try:
        found = _read(show)
    except BadShow as error:
        if not as_json():
            raise
        print_json({"ok": False, "problems": [_problem(error)]})
        return ExitCode.USAGE
    report = report_on(found, guards.envelope)
    status = ExitCode.OK if report.ok else ExitCode.USAGE
    if as_json():
        print_json(_facts(found, report))
        return status
    lines = [f"✗ {one.seen}\n  {one.remedy}" for one in report.problems]
    lines += [f"! {remark}" for remark in report.remarks]
    mark = "✓" if report.ok else "✗"
    lines.append(f"{mark} {len(found.tracks)} aircraft, {found.duration:g} s")
    if (nearest := report.closest) is not None:
        lines.append(
            f"  nearest: {nearest.first} and {nearest.second}, {nearest.distance_m:.2f} m at "
            f"{nearest.at:.2f} s; {nearest.needed_m:.2f} m are needed"
        )
    lines += [f"  {track.name} {track.digest[:16]}" for track in found.tracks]
    say(*lines)
    return status


def _facts(show: Show, report: Report) -> dict[str, Any]:
    return {
        "ok": report.ok,
        "problems": [_problem(problem) for problem in report.problems],
        "remarks": list(report.remarks),
        "duration_s": show.duration,
        "closest": None if report.closest is None else asdict(report.closest),
        "tracks": {track.name: track.digest for track in show.tracks},
    }


def _problem(error: BadShow) -> dict[str, Any]:
    names = ("aircraft", "at", "measured", "limit", "seen", "remedy")
    return {name: getattr(error, name) for name in names}


@shows.command(name="import")
def import_tracks(
    show: File,
    /,
    *tracks: Annotated[Path, Parameter(help="A file for each aircraft, called like it.")],
    origin: str,
    orientation: float = 0.0,
    force: Force = False,
) -> int:
    """Make a show of tracks of other programs: .skyb of Skybrush, or CSV.

    An aircraft takes off and lands by itself: its track begins and ends at rest, 1 m or more above
    the ground. Lights are left out. `check` says whether the show may be flown.

    Args:
        show: The file to write; - is standard output.
        origin: LATITUDE,LONGITUDE of the zero of all tracks, degrees.
        orientation: Where their x axis points, degrees clockwise from north; y points to its left.
    """
    found = imported(tracks, degrees("--origin", origin), orientation_deg=orientation)
    write_out(show, json.dumps(found) + "\n", force=force)
    return ExitCode.OK


@shows.command
def preview(
    show: ShowFile,
    picture: File,
    /,
    *,
    guards: ShowEnvelopeOptions = ShowEnvelopeOptions(),
    force: Force = False,
) -> int:
    """Draw a show: its tracks from above, and the least distance of any two over time.

    It also draws a show that must not be flown, prints its problems on standard error, and exits
    with 2.

    Args:
        picture: An SVG file to write; - is standard output.
    """
    found = _read(show)
    report = report_on(found, guards.envelope)
    write_out(picture, svg(found, report), force=force)
    for problem in report.problems:
        sys.stderr.write(f"✗ {problem.seen}\n")
    return ExitCode.OK if report.ok else ExitCode.USAGE


@shows.command(name="fly")
def fly_show(
    show: ShowFile,
    /,
    *,
    leave: Leave = "land",
    yes: Yes = False,
    guards: ShowEnvelopeOptions = ShowEnvelopeOptions(),
    options: FleetOptions = NO_OPTIONS,
) -> int:
    """Let the aircraft of a fleet fly a show: either all begin, or none.

    The command checks the show first. An aircraft that has to leave its track hovers or lands by
    itself; the command names it, and the others fly on. After Ctrl-C before the beginning, or
    when one cannot begin, all leave: they hover or land. After Ctrl-C later they fly on: m100link
    fleet stop --all stops them. The exit status is 0 if all flew to the end and landed, where they
    were to.

    Args:
        leave: Action of each aircraft after its track, and when it has to leave: hover or land.
    """
    found = _read(show)
    report = report_on(found, guards.envelope)
    for problem in report.problems:
        say(f"✗ {problem.seen}", to=err)
    if not report.ok:
        raise UsageError("this show must not be flown", remedy=f"m100link fleet show check {show}")
    if not yes:
        names = ", ".join(track.name for track in found.tracks)
        question = f"{names} take off and fly for {found.duration:g} s. Go on?"
        _ask(f"{names} may take off", question)

    async def run() -> int:
        ended_by_signal()
        how: dict[str, Any] = {"leave": leave, "sign": options.credentials.get("sign")}
        try:
            async with options.open() as fleet:
                conductor = Conductor(
                    fleet.bus, options.place, options.who, found, tell=partial(say, to=err), **how
                )
                parts = await conductor.fly()
        except asyncio.CancelledError:  # by a signal
            return ExitCode.INTERRUPTED
        for part in parts.values():
            stage = "silent" if part.stage is None else part.stage.value
            words = part.why or f"at most {part.farthest_m:.2f} m from its track"
            facts = {"name": part.name, "stage": stage, "why": part.why}
            tell(facts, f"{part.name}: {stage}, {words}")
        is_flown = all(one.stage is ShowStage.FLOWN and not one.why for one in parts.values())
        return ExitCode.OK if is_flown else ExitCode.FAILED

    return run_async(run())
