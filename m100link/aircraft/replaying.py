"""``replay://`` URLs: a recorded flight as an :class:`Aircraft` that obeys nobody."""

from __future__ import annotations

import math
import os
from pathlib import Path
from typing import Any, NamedTuple
from urllib.parse import parse_qsl, unquote

from m100link.aircraft.aircraft import Aircraft
from m100link.errors import BadURL, UsageError
from m100link.errors.texts import read_path
from m100link.flight.authority import TRANSITIONS, Authority, AuthorityInput, AuthorityState
from m100link.link import Tap
from m100link.link.statistics import TapListener
from m100link.log.player import (
    FASTEST,
    SLOWEST,
    Begin,
    PlaybackTarget,
    Player,
    ReplayedLink,
    begin_of,
)
from m100link.log.reading import read
from m100link.protocol.firmware import FirmwareProfile
from m100link.protocol.records import AccelerationMode

SCHEME = "replay://"

_OPTIONS = ("speed", "from", "to")
_EXAMPLE = f"{SCHEME}flight.mcap?speed=2&from=30&to=90"
_I = AuthorityInput

# The inputs of a program; all others follow from the bytes of the line, in a replay as in flight.
_OURS = (_I.OBTAIN, _I.OBTAINED, _I.REFUSED, _I.RELEASE, _I.RELEASED, _I.NOT_RELEASED)


class ReplayURL(NamedTuple):
    """A parsed ``replay://`` URL."""

    path: Path
    speed: float = 1.0  # times as fast as it was flown; infinity for max
    from_s: float = 0.0  # from where to where, seconds from its first byte
    to_s: float = math.inf


def parse_replay(url: str) -> ReplayURL:
    """Read a ``replay://`` URL: a path, and options behind a ``?``; ``BadURL`` if it is none."""
    target = url.strip().removeprefix(SCHEME)
    name, mark, options = target.rpartition("?")
    if not mark or ("=" not in options and options):
        name, options = target, ""
    if not name:
        raise _bad(url, "names no file")
    path = read_path(name)
    if "%" in name and not os.path.exists(path):
        path = read_path(unquote(name))
    values: dict[str, float] = {}
    for option, text in parse_qsl(options, keep_blank_values=True):
        if option not in _OPTIONS:
            raise _bad(url, f"has the option {option!r}; there are {', '.join(_OPTIONS)}")
        values[option] = _number(url, option, text)
    begin, end = values.get("from", 0.0), values.get("to", math.inf)
    if begin >= end:
        raise _bad(url, "ends before it begins")
    return ReplayURL(path, values.get("speed", 1.0), begin, end)


def _number(url: str, option: str, text: str) -> float:
    if option == "speed" and text == "max":
        return math.inf
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if option == "speed" and not SLOWEST <= value <= FASTEST:
        raise _bad(url, f"has the speed {text!r}, which is not {SLOWEST:g} to {FASTEST:g} or max")
    if not 0.0 <= value < math.inf:
        raise _bad(url, f"has {option}={text!r}, which is not a number of seconds")
    return value


def _bad(url: str, why: str) -> BadURL:
    return BadURL(f"{url!r} {why}", remedy=f"write it like {_EXAMPLE}")


async def open_replay(
    url: str | ReplayURL,  # which, from where, and how fast
    *,
    # By which telemetry is read; by default that of the flight.
    firmware: FirmwareProfile | None = None,
    tap: Tap | None = None,  # hears the bytes of both directions
    holds: bool = False,  # stand still at the end, instead of ending with :class:`ReplayEnded`
    acceleration: AccelerationMode | None = None,  # by default as the recording shows
    begin: Begin | None = None,  # the facts of the recording, if they were read before
) -> Aircraft:
    """The aircraft of a recording, played from the next turn of the event loop on."""
    wanted = parse_replay(url) if isinstance(url, str) else url
    flight = read(wanted.path, acceleration=acceleration)
    is_moved = holds or wanted.from_s > 0.0
    begin = begin or await begin_of(flight, is_moved=is_moved, holds=holds, firmware=firmware)
    if wanted.from_s > begin.duration_s:
        raise UsageError(
            f"{flight.path} is {begin.duration_s:.1f} s long and cannot be played from "
            f"{wanted.from_s:g} s on",
            remedy="begin earlier",
        )
    known = firmware or begin.firmware
    if known is None:
        raise flight.nameless("firmware='1.0'")
    player = Player(
        flight, begin, speed=wanted.speed, from_s=wanted.from_s, to_s=wanted.to_s, holds=holds
    )
    link = ReplayedLink(player)
    aircraft = Aircraft(link, firmware=firmware, acceleration=begin.acceleration)
    aircraft._requests.take_recorded(begin.version, known)
    telemetry = aircraft._telemetry
    telemetry.utc_offset_s = player.utc_offset_s
    player.play(
        PlaybackTarget(
            decode=link.decode,
            deliver=link.deliver,
            tell=lambda event: _tell(aircraft.authority, event),
            forget=lambda: _forget(aircraft),
            end=link.end,
            has_consumers=lambda: telemetry.hub.has_consumers,
            room=lambda: telemetry.hub.room,
            tap=None if tap is None else TapListener(tap).hear,
        )
    )
    return aircraft


def _forget(aircraft: Aircraft) -> None:
    authority = aircraft.authority
    aircraft._telemetry.forget()
    if authority.state is not AuthorityState.NONE:
        authority.feed(_I.RELEASE)
        authority.feed(_I.RELEASED)


def _tell(authority: Authority, event: dict[str, Any]) -> None:
    """Repeat a change of authority in the log that the line does not show: the program made it."""
    if event.get("event") != "authority":
        return
    try:
        after = AuthorityState(event.get("after"))
    except ValueError:
        return  # of a later version
    if after is authority.state:
        return
    ways = [what for what, state in TRANSITIONS[authority.state].items() if state is after]
    ways.sort(key=lambda what: what not in _OURS)
    if ways:
        authority.feed(ways[0])
