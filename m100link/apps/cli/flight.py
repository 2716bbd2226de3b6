"""``m100link takeoff``, ``land``, ``home``, ``fly`` and ``release``.

A person in a hurry lands: ``land`` asks nothing, and both ``land`` and ``home`` end a mission that
flies. Verbs that lift or move the aircraft refuse to act beside one.
"""

from __future__ import annotations

import asyncio
import math
import re
import sys
from collections.abc import AsyncIterator, Awaitable, Callable, Sequence
from contextlib import asynccontextmanager
from typing import Annotated

from cyclopts import Parameter

from m100link.aircraft import Aircraft
from m100link.aircraft.activation import ActivationProgress
from m100link.aircraft.payload import angles_command, rates_command
from m100link.aircraft.rates import rates_by_item
from m100link.apps.cli.common import (
    AS_SET,
    BY_LINK,
    WITHIN_DEFAULTS,
    AircraftOptions,
    ConnectionOptions,
    EnvelopeOptions,
    LinkOptions,
    Url,
    err,
    pairs,
    places,
)
from m100link.apps.cli.options import Above0, On, Yes, offered
from m100link.apps.cli.terminal import read_line, tell
from m100link.errors import AckTimeout, MissionRefused, MissionRunning, NotObserved, UsageError
from m100link.flight.control import Control
from m100link.flight.guards import Guards
from m100link.flight.guidance import GuidanceProgress
from m100link.flight.mission_state import MissionKind
from m100link.flight.tasks import TaskProgress, describe_situation
from m100link.protocol.commands.activation import Credentials
from m100link.protocol.commands.missions import MissionStatus
from m100link.protocol.items import BY_RECORD
from m100link.protocol.records import Gimbal
from m100link.telemetry.columns import ITEM_NAMES

_NotAsked = Annotated[Yes, Parameter(help="Not needed: m100link does not ask before a landing.")]

_PUSHES_S = 1.0  # in which an aircraft that tells of its mission has done so


async def takeoff(
    url: Url = None, /, *, options: AircraftOptions = AS_SET, yes: Yes = False
) -> None:
    """Start the motors, climb to about 1.2 m and hover."""
    flight = in_control(options.place(url), "take off", is_sure=yes, begins="take off")
    async with flight as (_, control):
        await control.take_off(progress=_show)


async def land(
    url: Url = None, /, *, options: AircraftOptions = AS_SET, yes: _NotAsked = False
) -> None:
    """Land in place and stop the motors.

    The command does not ask, and first stops any mission. Ctrl-C ends the landing: the aircraft
    hovers.
    """
    async with in_control(options.place(url), "land", is_sure=True) as (aircraft, control):
        await _end_mission(aircraft, control)
        await control.land(progress=_show)


async def home(url: Url = None, /, *, options: AircraftOptions = AS_SET, yes: Yes = False) -> None:
    """Stop any mission, fly to the home point and land there."""
    flight = in_control(options.place(url), "go home", is_sure=yes, look=_mission_that_ends)
    async with flight as (aircraft, control):
        await _end_mission(aircraft, control)
        await control.go_home(progress=_show)


async def fly(
    *place: Annotated[
        str, Parameter(name=["[URL] NORTH EAST UP"], allow_leading_hyphen=True), offered(places)
    ],
    options: AircraftOptions = AS_SET,
    limits: EnvelopeOptions = WITHIN_DEFAULTS,
    yes: Yes = False,
) -> None:
    """Fly the given metres north, east and up, and hover there.

    Args:
        place: The aircraft, if no --url or M100LINK_URL names it; then metres north, east
            and up, such as -5 0 1.5.
    """
    has_place = bool(place) and not _is_number(place[0])
    north, east, up = _metres(place[1:] if has_place else place)
    where = options.place(place[0] if has_place else None)
    if where.is_virtual:
        err.print("each command gets a new sim:// on the ground; `m100link sim` keeps one running")
    limits.envelope.check("fly", far=math.hypot(north, east))

    def progress(found: GuidanceProgress) -> None:
        if sys.stderr.isatty():
            err.print(
                f"{found.distance_m:7.1f} m to go, {found.height_error_m:+z6.1f} m of height",
                end="\r",
            )

    what = f"fly {north:g} m north, {east:g} m east, {up:g} m up"
    flight = in_control(
        where, what, is_sure=yes, begins=what, guards=Guards(envelope=limits.envelope)
    )
    async with flight as (_, control):
        await control.fly_to(north=north, east=east, up=up, progress=progress)


def _is_number(word: str) -> bool:
    try:
        return math.isfinite(float(word))
    except ValueError:
        return False


def _metres(words: Sequence[str]) -> tuple[float, float, float]:
    """Metres north, east and up. Raises UsageError: not three numbers."""
    strange = [word for word in words if not _is_number(word)]
    if strange or len(words) != 3:
        seen = f"{strange[0]!r} is not a number" if strange else f"{len(words)} numbers were given"
        raise UsageError(
            seen,
            remedy="name the aircraft first, if at all, then metres north, east and up: "
            "m100link fly /dev/ttyUSB0 5 0 1.5",
        )
    north, east, up = map(float, words)
    return north, east, up


async def release(url: Url = None, /, *, options: AircraftOptions = AS_SET) -> None:
    """Give control back: the aircraft hovers, and the pilot flies on."""
    async with activated(options.place(url)) as aircraft:
        if not await aircraft.release_authority():
            raise NotObserved(
                "the aircraft did not report that it has control authority back",
                situation=aircraft.state.situation(),
                cause="the release or its answer was lost, or the aircraft refused it: see the log",
                remedy="try again; the aircraft hovers, and the mode switch gives it to the pilot",
            )
        tell({"done": "release"}, "released")


Look = Callable[[Aircraft], Awaitable[str | None]]


@asynccontextmanager
async def activated(
    place: ConnectionOptions,
    *,
    credentials: Credentials | None = None,  # by default those of the place
    ask: str | None = None,  # the question to a person; a virtual aircraft needs none
    # Raises what would be refused anyway, before anybody is asked; may tell what else is asked for.
    look: Look | None = None,
) -> AsyncIterator[Aircraft]:
    """Connect and activate; the terminal shows why that takes time."""

    def show(progress: ActivationProgress) -> None:
        if progress.next_attempt_in is not None:
            err.print(f"activation: {progress.code.meaning}; again in a moment")

    # A mistake in them is an error before a port is opened.
    credentials = credentials or place.credentials()
    async with place.connect() as aircraft:
        if ask is not None and not place.is_virtual:
            also = None if look is None else await look(aircraft)
            await confirm(aircraft, (also or "") + ask)
        await aircraft.activate(credentials, progress=show)
        yield aircraft


@asynccontextmanager
async def in_control(
    place: ConnectionOptions,
    what: str | None = None,  # the deed, for the question and the report
    *,
    is_sure: bool = False,
    look: Look | None = None,
    begins: str | None = None,  # refused while a mission flies, before control is obtained
    guards: Guards | None = None,
    credentials: Credentials | None = None,
    is_reported: bool = True,
) -> AsyncIterator[tuple[Aircraft, Control]]:
    """Connect, ask, activate, obtain control."""
    ask = None if is_sure else what
    async with activated(place, credentials=credentials, ask=ask, look=look) as aircraft:
        if begins is None:
            await hear_of_mission(aircraft)
        else:
            await require_no_mission(aircraft, begins)
        async with aircraft.control(guards=guards) as control:
            yield aircraft, control
        if what is not None and is_reported:
            situation = aircraft.state.situation()
            tell(
                {"done": what, "situation": situation},
                f"done: {what} ({describe_situation(situation)})",
            )


async def _mission_that_ends(aircraft: Aircraft) -> str:
    """The words of the question for a mission that the order ends, too; empty without one."""
    await hear_of_mission(aircraft)
    mission = aircraft.mission
    return f"end the {mission.kind.value} and " if mission.is_running else ""


async def _end_mission(aircraft: Aircraft, control: Control) -> None:
    """Stop a mission that flies; if that fails, say so and let the landing break it off."""
    if not aircraft.mission.is_running:
        return
    try:
        kind = await control.stop_mission()
    except (MissionRefused, AckTimeout) as error:
        err.print(f"{error}\nlanding all the same")
        return
    if kind is not MissionKind.NONE:
        err.print(f"stopped: {kind.value}")


async def hear_of_mission(aircraft: Aircraft) -> None:
    """Wait a moment for an aircraft that knows missions to report the one it flies."""
    if not MissionStatus.is_known_to(aircraft.firmware):
        return
    clock = asyncio.get_running_loop().time
    until = clock() + _PUSHES_S
    # A push sets it, and none may ever come: there is no event to wait for.
    while aircraft.mission.kind is MissionKind.UNKNOWN and clock() < until:  # noqa: ASYNC110
        await asyncio.sleep(0.05)


async def require_no_mission(aircraft: Aircraft, what: str) -> None:
    """Refuse before control is asked for, if a mission flies. Raises MissionRunning: one does."""
    await hear_of_mission(aircraft)
    mission = aircraft.mission
    if mission.is_running:
        raise MissionRunning(
            f"{what} was asked for while a {mission.kind.value} flies the aircraft; nothing was "
            "sent, and it flies on",
            cause="a phone or another program started it, perhaps one that has ended",
            remedy="`m100link mission stop` first: the aircraft then hovers; in danger "
            "`m100link land`, or the pilot takes control with the mode switch",
        )


async def confirm(aircraft: Aircraft, what: str) -> None:
    """Ask at the terminal. Raises UsageError: there is none, or the answer is no."""
    if not sys.stdin.isatty():
        raise UsageError(f"{what} was not confirmed", remedy="give --yes where no terminal can ask")
    err.print(f"{aircraft.link.name}: firmware {aircraft.firmware}")
    err.print(f"Clear of people? Really {what}? [y/N] ", end="")
    if (await read_line()).lower() not in ("y", "yes"):
        raise UsageError(f"{what} was not confirmed", remedy="answer y, or give --yes")


def _show(progress: TaskProgress) -> None:
    if sys.stderr.isatty():
        height = "" if progress.height_m is None else f"{progress.height_m:z5.2f} m"
        phase = "" if progress.phase is None else progress.phase.name.lower().replace("_", " ")
        err.print(f"{progress.elapsed:5.1f} s  {phase:<18} {height}", end="\r")


# -- ``m100link gimbal``, ``m100link camera`` and ``m100link rates`` -------------------------------


Degrees = Annotated[float | None, Parameter(allow_leading_hyphen=True)]

_CAMERA = ("photo", "start-video", "stop-video")
_WATCH_S = 2.2  # two packages of an item at 1 Hz


async def gimbal(
    url: Url = None,
    /,
    *,
    yaw: Degrees = None,
    pitch: Degrees = None,
    roll: Degrees = None,
    seconds: Annotated[float, Above0] = 1.0,
    relative: bool = False,
    rates: bool = False,
    observe: On = True,
    options: AircraftOptions = AS_SET,
) -> None:
    """Show the angles of the gimbal, and point it.

    Args:
        yaw: Degrees clockwise from north, -320 to 320; axes without an angle stay as they are.
        pitch: Degrees, -90 (straight down) to 30.
        roll: Degrees, -35 to 35.
        seconds: Time to reach the angles, or to turn.
        relative: Count angles from the present ones.
        rates: Turn instead: the numbers are degrees per second, -180 to 180.
        observe: Wait until telemetry shows the angles.
    """
    place = options.place(url)
    named = {"yaw": yaw, "pitch": pitch, "roll": roll}
    angles = {axis: angle for axis, angle in named.items() if angle is not None}
    if rates and (relative or not angles):
        raise UsageError(
            "--rates has no axis, or --relative beside it",
            remedy="give --yaw, --pitch or --roll, without --relative",
        )
    if rates:  # refuse before a port is opened
        rates_command(**angles, seconds=seconds)
    elif angles:
        angles_command(**angles, seconds=seconds, relative=relative)

    async with activated(place) if angles else place.connect() as aircraft:
        if rates:
            await aircraft.gimbal.set_angular_rates(**angles, seconds=seconds)
        elif angles:
            await aircraft.gimbal.set_angles(
                **angles, seconds=seconds, relative=relative, wait=observe
            )
        state = aircraft.state
        await aircraft.wait_for(
            lambda _: state.fresh(Gimbal) is not None,
            timeout=_WATCH_S,
            what="the gimbal item",
        )
        seen = state.gimbal
    assert seen is not None
    described = {
        "yaw_deg": round(seen.yaw_deg, 1),
        "pitch_deg": round(seen.pitch_deg, 1),
        "roll_deg": round(seen.roll_deg, 1),
        "limits": seen.limits,
    }
    tell(
        described,
        f"yaw {seen.yaw_deg:z.1f}°, pitch {seen.pitch_deg:z.1f}°, roll {seen.roll_deg:z.1f}°",
    )


async def camera(
    *words: Annotated[
        str,
        Parameter(name=["[URL] photo|start-video|stop-video"]),
        offered(lambda: [*_CAMERA, *places()]),
    ],
    options: AircraftOptions = AS_SET,
) -> None:
    """Take a photo, start or stop video; the aircraft confirms neither.

    Args:
        words: The aircraft, if no --url or M100LINK_URL names it; then the action.
    """
    actions = [word for word in words if word in _CAMERA]
    if len(actions) != 1 or words[-1] != actions[0] or len(words) > 2:
        raise UsageError(
            _not_an_action(words),
            remedy=f"name the aircraft, if at all, then one of: {', '.join(_CAMERA)}",
        )
    place, _ = options.place_among(words, lambda word: word in _CAMERA)
    [action] = actions
    async with activated(place) as aircraft:
        commands = {
            "photo": aircraft.camera.take_photo,
            "start-video": aircraft.camera.start_video,
            "stop-video": aircraft.camera.stop_video,
        }
        await commands[action]()
    text = f"sent: {action} (the aircraft does not confirm it: look at the memory card)"
    tell({"sent": action, "confirmed": None}, text)


def _not_an_action(words: Sequence[str]) -> str:
    """The mistake in words that are not an aircraft and one action."""
    actions = [word for word in words if word in _CAMERA]
    if len(actions) > 1:
        return f"{len(actions)} actions were given: {' '.join(actions)}"
    if actions:
        return f"{' '.join(words)!r} is not an aircraft and an action"
    strange = words[1:] or [word for word in words if not re.search(r"[:/]", word)]
    return f"the camera has no action {strange[0]!r}" if strange else "no action was given"


async def rates(
    *words: Annotated[
        str,
        Parameter(name=["[URL] ITEM=HZ..."]),
        offered(lambda: [*(f"{name}=" for name in ITEM_NAMES), *places()]),
    ],
    link: LinkOptions = BY_LINK,
) -> None:
    """Show at which rate each item arrives, and set rates (firmware 3.1).

    Args:
        words: The aircraft, if no --url or M100LINK_URL names it; then rates, such as
            attitude=50 battery=1, each 0, 1, 10, 50 or 100 Hz.
    """
    place, asked = link.place_among(words, _is_rate)
    if wanted := pairs(asked):  # refuse before a port is opened
        rates_by_item(wanted)
    async with place.connect() as aircraft:
        if wanted:
            await aircraft.set_telemetry_rates(**wanted)
        state = aircraft.state
        before = {record: state.statistics(record).count for record in BY_RECORD}
        await asyncio.sleep(_WATCH_S)
        seen = {
            item.name: round((state.statistics(record).count - before[record]) / _WATCH_S, 1)
            for record, item in BY_RECORD.items()
        }
    lines = (f"{name:16} {rate or '-':>6}" for name, rate in seen.items())
    tell({"rates_hz": seen}, f"{'item':16} {'Hz':>6}", *lines)


def _is_rate(word: str) -> bool:
    return "=" in word and "/" not in word  # sim://?firmware=3.1 is a place
