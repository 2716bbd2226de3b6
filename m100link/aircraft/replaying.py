"""``replay://`` URLs: a recorded flight as an :class:`Aircraft` that obeys nobody."""

from __future__ import annotations

from typing import Any

from m100link.aircraft.aircraft import Aircraft
from m100link.errors import UsageError
from m100link.flight.authority import TRANSITIONS, Authority, AuthorityInput, AuthorityState
from m100link.link import Tap
from m100link.link.statistics import TapListener
from m100link.link.url import ReplayURL, parse_replay
from m100link.log.player import (
    Begin,
    PlaybackTarget,
    Player,
    ReplayedLink,
    begin_of,
)
from m100link.log.reading import read
from m100link.protocol.firmware import FirmwareProfile
from m100link.protocol.records import AccelerationMode

_I = AuthorityInput

# The inputs of a program; all others follow from the bytes of the line, in a replay as in flight.
_OURS = (_I.OBTAIN, _I.OBTAINED, _I.REFUSED, _I.RELEASE, _I.RELEASED, _I.NOT_RELEASED)


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
