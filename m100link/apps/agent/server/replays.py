"""A recorded flight in the place of an aircraft, as the agent of a replay owns it."""

from __future__ import annotations

import math

from m100link.aircraft import Aircraft
from m100link.aircraft.replaying import open_replay
from m100link.apps.agent.messages import Replay
from m100link.errors import OnlyRecorded, UsageError
from m100link.link.url import parse_replay
from m100link.log.player import Begin, Player, ReplayedLink
from m100link.protocol.firmware import profile


class Replays:
    """Plays one recording to a station, which stands still at its end.

    Args:
        url: A ``replay://`` URL.
        firmware: Force a firmware profile.

    Raises:
        BadURL, UsageError: It cannot be.
    """

    def __init__(self, url: str, firmware: str | None) -> None:
        self._url = parse_replay(url)
        self._firmware = None if firmware is None else profile(firmware)
        self._aircraft: Aircraft | None = None
        self._player: Player | None = None
        self._begin: Begin | None = None  # once it was looked at

    async def look(self) -> None:
        """See whether it can be played, before anything is served.

        Raises:
            UsageError: It cannot.
        """
        aircraft = await self.connect()
        assert self._player is not None
        self._begin, self._player = self._player.begin, None
        await aircraft.aclose()

    async def connect(self) -> Aircraft:
        """The aircraft of the recording.

        Raises:
            UsageError: The file cannot be played.
        """
        aircraft = await open_replay(
            self._url, firmware=self._firmware, holds=True, begin=self._begin
        )
        assert isinstance(aircraft.link, ReplayedLink)  # of a replay it is one
        self._player, self._aircraft = aircraft.link.player, aircraft
        return aircraft

    def progress(self) -> Replay | None:
        """Where it is; None before it plays."""
        player = self._player
        if player is None or self._aircraft is None:
            return None
        return Replay(
            path=str(self._url.path.absolute()),
            utc=player.time() + player.utc_offset_s,
            clock=player.time(),
            since=player.run_began_at,
            newest_at=self._aircraft.state.newest_at,
            position_s=player.position_s,
            duration_s=player.begin.duration_s,
            speed=player.speed if math.isfinite(player.speed) else 0.0,
            is_paused=player.is_paused,
            is_at_end=player.is_at_end,
            is_cut_off=not player.begin.is_ended,
            is_written=player.begin.damage.is_written,
        )

    async def order(self, text: str) -> None:
        """Do the order of a page.

        Args:
            text: ``pause``, ``resume``, ``toggle``, ``seek 30``, ``by -10``, ``speed 2`` or
                ``speed max``.

        Raises:
            UsageError: There is no such order, or it does not play.
        """
        player = self._player
        word, _, number = text.partition(" ")
        if player is None:
            raise UsageError("nothing is played yet", remedy="see why it is not connected")
        if word == "pause":
            player.pause()
        elif word == "resume":
            if player.is_at_end:
                player.seek(0.0)
            player.resume()
        elif word == "toggle":
            await self.order("resume" if player.is_paused or player.is_at_end else "pause")
        elif word == "speed":
            player.set_speed(math.inf if number == "max" else _number(number))
        elif word == "seek":
            player.seek(_number(number))
        elif word == "by":
            player.seek(player.position_s + _number(number))
        else:
            raise UsageError(
                f"a replay does not know {word!r}",
                remedy="pause, resume, toggle, seek, by, speed",
            )


def _number(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise UsageError(f"{text!r} is not a number", remedy="seconds, or a speed")
    return value


def refused() -> OnlyRecorded:
    return OnlyRecorded.usual("there is no control to be had: this is a replay, nothing flies")
