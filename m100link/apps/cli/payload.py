"""``m100link gimbal``, ``m100link camera`` and ``m100link rates``."""

from __future__ import annotations

import asyncio
import re
import sys
from collections.abc import Sequence
from typing import Annotated, Any

from cyclopts import Parameter
from rich.table import Table

from m100link.aircraft import Aircraft, connect
from m100link.aircraft.gimbal import angles_command, rates_command
from m100link.aircraft.rates import rates_by_item
from m100link.apps.cli.common import AppOptions, LinkOptions, Place, Url, out, places, run_async
from m100link.apps.cli.flight import activate_app
from m100link.apps.cli.options import Above0, offered
from m100link.apps.cli.outcome import print_json
from m100link.errors import UsageError
from m100link.protocol.commands.activation import RATES_HZ
from m100link.protocol.items import BY_RECORD
from m100link.protocol.records import Gimbal
from m100link.telemetry.names import ITEM_NAMES

__all__ = ["camera", "gimbal", "rates"]

Degrees = Annotated[float | None, Parameter(allow_leading_hyphen=True)]

_CAMERA = ("photo", "start-video", "stop-video")
_WATCH_S = 2.2  # two packages of an item at 1 Hz


def gimbal(
    url: Url = None,
    /,
    *,
    yaw: Degrees = None,
    pitch: Degrees = None,
    roll: Degrees = None,
    seconds: Annotated[float, Above0] = 1.0,
    relative: bool = False,
    rates: bool = False,
    wait: bool = True,
    app: AppOptions | None = None,
    link: LinkOptions | None = None,
    json: bool = False,
) -> int:
    """Point the gimbal, and show where it looks; without an angle it only shows that.

    Args:
        url: Where the aircraft is.
        yaw: Degrees clockwise from north, -320 to 320; an axis that is not named is left alone.
        pitch: Degrees, -90 (straight down) to 30.
        roll: Degrees, -35 to 35.
        seconds: Time in which it gets there, or for which it turns.
        relative: Angles count from the present ones.
        rates: The numbers are degrees per second, -180 to 180, not angles.
        wait: Wait until telemetry shows the angles.
        app: The app that is registered with DJI.
        link: How to talk to it.
        json: One JSON object; the default in a pipe.
    """
    place = (link or LinkOptions()).place(url, app)
    named = {"yaw": yaw, "pitch": pitch, "roll": roll}
    angles = {axis: angle for axis, angle in named.items() if angle is not None}
    if rates and (relative or not angles):
        raise UsageError("--rates goes with --yaw, --pitch or --roll, and not with --relative")
    if rates:  # what cannot be sent is refused before a port is opened
        rates_command(**angles, seconds=seconds)
    elif angles:
        angles_command(**angles, seconds=seconds, relative=relative)

    async def point(aircraft: Aircraft) -> None:
        if rates:
            await aircraft.gimbal.set_angular_rates(**angles, seconds=seconds)
        elif angles:
            await aircraft.gimbal.set_angles(
                **angles, seconds=seconds, relative=relative, wait=wait
            )

    return run_async(_gimbal(place, point if angles else None, json or not sys.stdout.isatty()))


async def _gimbal(place: Place, point: Any, as_json: bool) -> None:
    credentials = place.credentials() if point else None
    async with connect(place.url, **place.arguments()) as aircraft:
        if credentials is not None:
            await activate_app(aircraft, credentials)
            await point(aircraft)
        state = aircraft.state
        await aircraft.wait_for(
            lambda _: state.fresh(Gimbal, within=1.5) is not None,
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
    if as_json:
        print_json(described)
    else:
        out.print(
            f"yaw {seen.yaw_deg:.1f}°, pitch {seen.pitch_deg:.1f}°, roll {seen.roll_deg:.1f}°"
        )


def camera(
    *words: Annotated[
        str,
        Parameter(name=["[URL] photo|start-video|stop-video"]),
        offered(lambda: [*_CAMERA, *places()]),
    ],
    app: AppOptions | None = None,
    link: LinkOptions | None = None,
    json: bool = False,
) -> int:
    """Take a photograph, start or stop video. It is sent; nobody confirms it.

    Args:
        words: Where the aircraft is (else that of --url or M100LINK_URL), and what to do.
        app: The app that is registered with DJI.
        link: How to talk to it.
        json: One JSON object; the default in a pipe.
    """
    actions = [word for word in words if word in _CAMERA]
    if len(actions) != 1 or words[-1] != actions[0] or len(words) > 2:
        raise UsageError(
            _not_an_action(words),
            remedy=f"the aircraft, if it is named at all, then one of: {', '.join(_CAMERA)}",
        )
    place, _ = (link or LinkOptions()).place_among(words, lambda word: word in _CAMERA, app)
    return run_async(_camera(place, actions[0], json or not sys.stdout.isatty()))


def _not_an_action(words: Sequence[str]) -> str:
    """What is wrong with words that are not an aircraft and one action."""
    actions = [word for word in words if word in _CAMERA]
    if len(actions) > 1:
        return f"{len(actions)} actions were given: {' '.join(actions)}"
    if actions:
        return f"{' '.join(words)!r} is not an aircraft and an action"
    strange = words[1:] or [word for word in words if not re.search(r"[:/]", word)]
    return f"the camera has no action {strange[0]!r}" if strange else "no action was given"


async def _camera(place: Place, action: str, as_json: bool) -> None:
    credentials = place.credentials()
    async with connect(place.url, **place.arguments()) as aircraft:
        await activate_app(aircraft, credentials)
        commands = {
            "photo": aircraft.camera.take_photo,
            "start-video": aircraft.camera.start_video,
            "stop-video": aircraft.camera.stop_video,
        }
        await commands[action]()
    if as_json:
        print_json({"sent": action, "confirmed": None})
    else:
        out.print(f"sent: {action} (nobody confirms it: look at the card)")


def rates(
    *words: Annotated[
        str,
        Parameter(name=["[URL] ITEM=HZ..."]),
        offered(lambda: [*(f"{name}=" for name in ITEM_NAMES), *places()]),
    ],
    link: LinkOptions | None = None,
    json: bool = False,
) -> int:
    """Set telemetry rates (firmware 3.1), and show how items arrive; without any only that.

    Args:
        words: Where the aircraft is (else that of --url or M100LINK_URL), and rates, such as:
            attitude=50 battery=1. 0, 1, 10, 50 or 100 Hz.
        link: How to talk to it.
        json: One JSON object; the default in a pipe.
    """
    place, asked = (link or LinkOptions()).place_among(words, _is_rate)
    return run_async(_rates(place, _pairs(asked), json or not sys.stdout.isatty()))


def _is_rate(word: str) -> bool:
    return "=" in word and "/" not in word  # sim://?firmware=3.1 is a place


def _pairs(words: Sequence[str]) -> dict[str, int]:
    """Rates by item.

    Raises:
        UsageError: A word is not ITEM=HZ.
    """
    found: dict[str, int] = {}
    for word in words:
        name, _, rate = word.partition("=")
        if not rate.isascii() or not rate.isdigit():
            raise UsageError(
                f"{word!r} is not a rate",
                remedy=f"ITEM=HZ, such as attitude=50; rates: {', '.join(map(str, RATES_HZ))}",
            )
        if name in found:
            raise UsageError(f"two rates were given for {name}")
        found[name] = int(rate)
    if found:  # what cannot be is refused before a port is opened
        rates_by_item(found)
    return found


async def _rates(place: Place, wanted: dict[str, int], as_json: bool) -> None:
    async with connect(place.url, **place.arguments()) as aircraft:
        if wanted:
            await aircraft.set_telemetry_rates(**wanted)
        state = aircraft.state
        before = {record: state.statistics(record).count for record in BY_RECORD}
        await asyncio.sleep(_WATCH_S)
        seen = {
            item.name: round((state.statistics(record).count - before[record]) / _WATCH_S, 1)
            for record, item in BY_RECORD.items()
        }
    if as_json:
        print_json({"rates_hz": seen})
        return
    table = Table(box=None, pad_edge=False)
    table.add_column("item")
    table.add_column("Hz", justify="right")
    for name, rate in seen.items():
        table.add_row(name, f"{rate:g}" if rate else "-")
    out.print(table)
