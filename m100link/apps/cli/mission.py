"""``m100link mission``: let the aircraft fly a plan, and act on a mission that flies already."""

from __future__ import annotations

import asyncio
import math
import sys
from collections.abc import AsyncIterator, Awaitable, Callable, Coroutine
from contextlib import AbstractAsyncContextManager, asynccontextmanager, nullcontext
from dataclasses import asdict
from typing import Annotated, Any

from rich.console import Group
from rich.live import Live
from rich.text import Text

from m100link.aircraft import Aircraft
from m100link.apps.cli.common import (
    AS_SET,
    WITHIN_DEFAULTS,
    AircraftOptions,
    EnvelopeOptions,
    Url,
    err,
    out,
)
from m100link.apps.cli.display import Point, track_plot
from m100link.apps.cli.flight import activated, in_control
from m100link.apps.cli.options import OUTPUT, Force, Yes, group
from m100link.apps.cli.plan import (
    File,
    FileOptions,
    PlanFile,
    TakeOff,
    read_plan,
    require_free,
    write_plan,
)
from m100link.apps.cli.terminal import ExitCode, ReaderGone, as_json, tell
from m100link.errors import UsageError
from m100link.flight.control import Control
from m100link.flight.guards import Guards
from m100link.flight.mission_state import MissionKind
from m100link.flight.missions.context import check_envelope
from m100link.flight.missions.events import (
    Finished,
    MissionEvent,
    MissionProgress,
    Reached,
    Uploaded,
    Uploading,
)
from m100link.flight.missions.waypoint import WaypointFlight
from m100link.geodesy import LocalFrame
from m100link.missions.plan import AtEnd, WaypointPlan
from m100link.protocol.commands.missions import MissionStatus
from m100link.protocol.records import FlightPhase, Position
from m100link.telemetry.subscription import Latest

app = group("mission", "Let the aircraft fly a plan by itself (firmware 3.1).")


_STATUS_S = 1.0  # in which an aircraft that tells of its flight status has done so
_TRACK_HZ = 4.0


@app.command
def fly(
    plan: PlanFile,
    url: Url = None,
    /,
    *,
    file: FileOptions | None = None,
    options: AircraftOptions = AS_SET,
    take_off: TakeOff = False,
    allow_far: bool = False,
    limits: EnvelopeOptions = WITHIN_DEFAULTS,
    yes: Yes = False,
) -> Coroutine[Any, Any, int]:
    """Upload a plan, let the aircraft fly it, and watch. Ctrl-C stops it: the aircraft hovers.

    A terminal shows a map; a pipe gets one JSON object per event. On Linux, a guardian stops the
    mission when this program is killed. `m100link mission stop` ends a mission left in flight.

    Args:
        allow_far: Allow a first waypoint more than 500 m from the aircraft.
    """
    # First, as it tells of arguments that are exchanged; and while Ctrl-C ends a wait for a pipe.
    found = read_plan(plan, file)
    take_off = take_off or found.take_off
    place = options.place(url)
    check_envelope(limits.envelope, found)  # before the aircraft is asked anything
    credentials = place.credentials()

    err.print(
        f"{announced(found)}. Ctrl-C stops it. On Linux, a guardian stops it if this program is "
        "killed.",
    )
    flight = in_control(
        place,
        f"{'take off and ' if take_off else ''}fly this mission",
        is_sure=yes,
        is_reported=False,
        look=None if take_off else _require_airborne,
        begins="a waypoint mission",
        guards=Guards(envelope=limits.envelope),
        credentials=credentials,
    )
    return _fly(flight, found, take_off=take_off, allow_far=allow_far)


_InControl = AbstractAsyncContextManager[tuple[Aircraft, Control]]


async def _fly(flight: _InControl, plan: WaypointPlan, *, take_off: bool, allow_far: bool) -> int:
    left: list[Callable[[], str]] = []
    try:
        async with flight as (aircraft, control):
            show = _Show(plan, aircraft)
            mission = control.waypoint_mission(
                plan, take_off=take_off, allow_far=allow_far, progress=show.uploading
            )
            left.append(lambda: show.stopped(mission))
            async with show.watching(), mission:
                async for event in mission:
                    show.tell(event, mission)
            show.end()
    except (asyncio.CancelledError, ReaderGone) as error:
        # Printed when the control block has ended: with Ctrl-C that is what stops the mission.
        gone = "output closed: " if isinstance(error, ReaderGone) else ""
        for words in left:
            err.print(gone + words(), soft_wrap=True)
        if gone:  # elsewhere that is success; here it ended a flight
            return ExitCode.FAILED
        raise
    return ExitCode.OK


class _Show:
    """The display of a mission: a map and a line that says how far it is; or JSON lines."""

    def __init__(self, plan: WaypointPlan, aircraft: Aircraft) -> None:
        first = plan.waypoints[0]
        self._frame = LocalFrame(first.latitude_deg, first.longitude_deg)
        self._places = [
            (self._frame.to_local(point.latitude_deg, point.longitude_deg), str(index))
            for index, point in enumerate(plan.waypoints)
        ]
        self._lands = plan.at_end in (AtEnd.GO_HOME, AtEnd.LAND)
        self._aircraft = aircraft
        self._track: list[Point] = []
        self._reached = -1
        self._has_begun = self._is_finished = False
        self._line = "uploading"
        shows = sys.stdout.isatty() and not as_json()
        self._live = Live(console=out, refresh_per_second=4, transient=True) if shows else None

    @asynccontextmanager
    async def watching(self) -> AsyncIterator[None]:
        """The map follows the aircraft in here."""
        follower = asyncio.create_task(self._follow())
        try:
            with self._live or nullcontext():
                yield
        finally:
            follower.cancel()

    async def _follow(self) -> None:
        samples = self._aircraft.telemetry(Position, policy=Latest(), rate_hz=_TRACK_HZ)
        async for sample in samples:
            position = sample.get(Position)
            if position is None or not position.is_possible:
                continue
            here = self._frame.to_local(position.latitude_deg, position.longitude_deg)
            if not self._track or math.dist(self._track[-1], here) > 0.2:
                self._track.append(here)
            self._draw()

    def uploading(self, event: Uploading) -> None:
        self._line = f"uploading {self._bar(event.index + 1)} {event.index + 1} of {event.total}"
        self._draw()

    def tell(self, event: MissionEvent, mission: WaypointFlight) -> None:
        self._has_begun = True
        self._is_finished = self._is_finished or isinstance(event, Finished)
        if isinstance(event, Reached):
            self._reached = event.index
        total, done = len(self._places), self._reached + 1
        words = event_words(event)
        self._line = f"{self._bar(done)} {done} of {total}  {words}"
        if self._live is None:
            tell({"event": event_name(event)} | asdict(event), words)
        elif isinstance(event, MissionProgress):
            self._draw()
        else:
            self._live.console.print(words)

    def _bar(self, done: int) -> str:
        width = 20
        filled = round(width * done / len(self._places))
        return "█" * filled + "░" * (width - filled)

    def _draw(self) -> None:
        if self._live is not None:
            self._live.update(Group(Text("\n".join(self._map())), Text(self._line)))

    def _map(self) -> list[str]:
        here = [(self._track[-1], "@")] if self._track else []
        width = max(20, min(out.width, 80))
        return track_plot(
            self._track, columns=width, rows=min(16, width // 3), marks=[*here, *self._places]
        )

    def stopped(self, mission: WaypointFlight) -> str:
        """The end of a mission that this program left early, in words."""
        state = self._aircraft.state
        status, position = state.believed_status, state.position
        if self._has_begun and not mission.is_over:
            if self._is_finished and self._lands:
                return "all waypoints are flown; the aircraft lands, as planned"
            return "nothing confirmed the stop, the mission may fly on: m100link mission stop"
        words = "mission not started"
        if self._is_finished:
            words = "mission finished"
        elif self._has_begun:
            reached = f"after waypoint {self._reached}"
            words = f"mission stopped {reached if self._reached >= 0 else 'before waypoint 0'}"
        if status is not None and status.status == FlightPhase.STANDBY:
            return f"{words}; the aircraft stands on the ground"
        height = "" if position is None else f" at {position.height_m:z.1f} m"
        return f"{words}; the aircraft hovers{height}: m100link land"

    def end(self) -> None:
        """The track stays in the terminal."""
        if self._live is not None:
            for line in self._map():
                out.print(line)


def announced(plan: WaypointPlan) -> str:
    """A plan in words, for an operator who confirms it."""
    at_end = plan.at_end.name.lower().replace("_", " ")
    many = f"{len(plan.waypoints)} waypoints, about {plan.estimate()}"
    return f"{many}; at the end {at_end}, without RC {plan.on_rc_loss.name.lower()}"


def event_name(event: MissionEvent) -> str:
    """Reached is "reached", ActionsDone "actions_done"."""
    name = type(event).__name__
    return "".join(f"_{c.lower()}" if c.isupper() else c for c in name).removeprefix("_")


def event_words(event: MissionEvent) -> str:
    """An event in a few words."""
    words = event_name(event).replace("_", " ")
    if isinstance(event, MissionProgress) and event.distance_m is not None:
        return f"{event.distance_m:.0f} m to waypoint {event.index}, {event.elapsed:.0f} s"
    if isinstance(event, Uploaded):
        time = "" if event.estimated_time is None else f", about {event.estimated_time:.0f} s"
        return f"{words}: {event.points} waypoints{time}"
    index, reason = getattr(event, "index", None), getattr(event, "reason", "")
    return words + (f" {index}" if index is not None else "") + (f": {reason}" if reason else "")


async def _require_airborne(aircraft: Aircraft) -> None:
    """Refuse a mission on the ground, if the aircraft reports it. Raises UsageError: it does."""
    if not MissionStatus.is_known_to(aircraft.firmware):
        return  # refused for that, and not for where it stands
    clock = asyncio.get_running_loop().time
    until = clock() + _STATUS_S
    # No status is an answer here, where wait_for would raise.
    while aircraft.state.believed_status is None and clock() < until:  # noqa: ASYNC110
        await asyncio.sleep(0.05)
    status = aircraft.state.believed_status
    if status is not None and status.status == FlightPhase.STANDBY:
        raise UsageError(
            "the aircraft stands on the ground",
            cause="a mission that starts there may take off by itself",
            remedy="give --takeoff, or m100link takeoff first",
        )


@app.command
async def stop(url: Url = None, /, *, options: AircraftOptions = AS_SET) -> None:
    """Stop the mission that flies, also one of another program; the aircraft hovers."""
    async with in_control(options.place(url)) as (_, control):
        kind = await control.stop_mission()
        is_none = kind is MissionKind.NONE
        words = "no mission flies" if is_none else f"stopped: {kind.value}"
        tell({"stopped": None if is_none else kind.value}, words)


async def _going_on(
    flight: _InControl, act: Callable[[Control], Awaitable[MissionKind]], done: str
) -> None:
    async with flight as (_, control):
        kind = await act(control)
        control.detach_mission()  # giving authority back would break it off
        tell({done.partition(":")[0]: kind.value}, done.format(kind.value))


@app.command
async def pause(url: Url = None, /, *, options: AircraftOptions = AS_SET) -> None:
    """Pause the mission that flies; the aircraft hovers. Does not release authority."""
    await _going_on(in_control(options.place(url)), Control.pause_mission, "paused: {}")


@app.command
async def resume(
    url: Url = None, /, *, options: AircraftOptions = AS_SET, yes: Yes = False
) -> None:
    """Let a paused mission fly on by itself. Does not release authority."""
    ask = "let the mission go on"
    flight = in_control(options.place(url), ask, is_sure=yes, is_reported=False)
    await _going_on(flight, Control.resume_mission, "resumed: {}; it flies on by itself")


@app.command
async def download(
    url: Url = None,
    /,
    *,
    options: AircraftOptions = AS_SET,
    output: Annotated[File, OUTPUT] = "-",
    force: Force = False,
) -> None:
    """Download the plan that the aircraft has stored.

    Args:
        output: File to write, for QGroundControl if its name ends in .plan; - prints JSON.
    """
    place = options.place(url)
    if output != "-":
        require_free(output, force=force)

    async with activated(place) as aircraft:
        plan = await aircraft.download_waypoint_plan()
    write_plan(plan, output)
