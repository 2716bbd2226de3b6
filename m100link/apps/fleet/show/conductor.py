"""Conducts a show of a fleet: either all aircraft begin, or none.

Every aircraft confirms the hash of its track, takes its place, and gets the time to begin by its
own clock, which is measured here. From then on the conductor is not needed: it reports aircraft
that leave, and the others fly on.
"""

from __future__ import annotations

import asyncio
import math
import time
import uuid
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from m100link.apps.agent import orders
from m100link.apps.agent.messages import MessageError
from m100link.apps.bus.network import Bus
from m100link.apps.fleet import payloads
from m100link.apps.fleet.asking import Asker, Sign, unsigned
from m100link.apps.fleet.keys import Keys
from m100link.apps.fleet.show.plan.document import SKEW_S, Show
from m100link.apps.fleet.show.plan.steering import ShowRefused, Why
from m100link.apps.fleet.show.plan.track import BadShow, TimedTrack
from m100link.apps.fleet.show.track_executor import Leave
from m100link.errors import M100Error, Unreachable

_ANSWER_S = 1.0
_TRIES = 5
_PLACING_S = 180.0
_ROUND_TRIPS = 12
_COUNTDOWN_S = 5.0
_LOOK_S = 0.5
_ATTENDING_S = 2.0
_GONE_S = 5.0
_PIECE = 800
"""Bytes of a track that are sent at once: an order has room for 2048 with all that is around."""


@dataclass(frozen=True, slots=True)
class Part:
    """The state of one aircraft in a show."""

    name: str  #: the aircraft
    stage: payloads.ShowStage | None  #: its stage; None when unknown, because it does not answer
    digest: str = ""  #: digest of its track
    farthest_m: float = 0.0  #: greatest distance from its track, by its own telemetry
    why: str = ""  #: why it left, did not land behind its track, or does not report
    clock: float = 0.0  #: its own clock as it answered, s


class Conductor:
    """Conducts one show.

    Args:
        bus: The network.
        site: Name of the site.
        who: Name of the operator who conducts, shown to other people.
        show: The show; the caller has checked it.
        leave: Action of each aircraft at the end, and when it has to leave.
        sign: Signs orders; without it only the router decides who may give them.
        tell: Called with progress reports for people.
        utc: POSIX time, s.
    """

    def __init__(
        self,
        bus: Bus,
        site: str,
        who: str,
        show: Show,
        *,
        leave: Leave = "land",
        sign: Sign | None = None,
        tell: Callable[[str], None] = lambda _text: None,
        utc: Callable[[], float] = time.time,
    ) -> None:
        self._tracks = {track.name: track for track in show.tracks}
        how: dict[str, Any] = {"sign": sign or unsigned, "patience": _ANSWER_S, "utc": utc}
        self._askers = {name: Asker(bus, Keys(site, name), who, **how) for name in self._tracks}
        self._least = show.least_distance_m
        self._leave = leave
        # Orders of nobody else are carried out until this show is over, and none of ours behind it.
        # It also names the show: a place that was recorded when it was flown before is of another.
        self._run = uuid.uuid4().hex
        self._tell = tell
        self._up: set[str] = set()  # those that were asked to take off
        self._flying = set(self._tracks)  # those of which no end is known
        self._clock = asyncio.get_running_loop().time
        self._began_at = self._clock()  # a STOP since then overtakes each step

    async def fly(self) -> dict[str, Part]:
        """Fly it.

        Returns:
            How it ended for each: ``FLOWN``, ``LEFT``, or None for one that fell silent.

        Raises:
            M100Error: One of them could not begin. None has begun; all that flew hover or land, as
                ``leave`` says.
        """
        for asker in self._askers.values():
            asker.require(orders.Right.FLY)
        self._began_at = self._clock()
        attending = asyncio.create_task(self._attend(), name="m100link: conductor of a show")
        try:
            await self._each(self._load)
            self._tell("all have their tracks")
            await self._each(self._place)
            self._tell("all are at their places")
            await self._each(self._measure)
            start_at = self._clock() + _COUNTDOWN_S
            await self._each(lambda track: self._start(track, start_at))
            self._tell(f"the show begins in {start_at - self._clock():.1f} s")
            await asyncio.sleep(start_at - self._clock())  # until then all may leave again
        except BaseException:
            await asyncio.wait([asyncio.ensure_future(self.leave())])
            raise
        finally:
            attending.cancel()
        try:
            return dict(zip(self._tracks, await self._each(self._watch), strict=True))
        except asyncio.CancelledError:
            if names := ", ".join(sorted(self._flying)):
                self._tell(f"{names}: the show goes on; m100link fleet stop --all stops them")
            raise

    async def _attend(self) -> None:
        """Be heard by those that are ready while others are not: they would leave."""
        while True:
            await asyncio.sleep(_ATTENDING_S)
            asked = map(self._look, self._tracks.values())
            await asyncio.gather(*asked, return_exceptions=True)

    async def leave(self) -> None:
        """Let all of them leave, at any stage; name those that fly, or did not confirm it."""

        async def leave(track: TimedTrack) -> None:
            try:
                await self._ask(track, payloads.LeaveShow(self._run))
                if track.name in self._up:
                    left.append(track.name)
            except M100Error as error:
                self._tell(f"{track.name} did not confirm that it leaves: {error.seen}")

        left: list[str] = []
        await asyncio.gather(*map(leave, self._tracks.values()), return_exceptions=True)
        if left:
            does = "land" if self._leave == "land" else "hover, and nobody has control of them"
            self._tell(f"had to take off: {', '.join(sorted(left))}; those in the air {does}")

    async def _each(self, do: Callable[[TimedTrack], Any]) -> list[Any]:
        """Something with each at once; the first that fails is named, and raised behind all."""
        found = await asyncio.gather(*map(do, self._tracks.values()), return_exceptions=True)
        for name, one in zip(self._tracks, found, strict=True):
            if isinstance(one, M100Error) and name not in one.seen:
                one.seen = f"{name}: {one.seen}"
            if isinstance(one, BaseException):
                raise one
        return found

    # -- one of them -----------------------------------------------------------------------------

    async def _look(self, track: TimedTrack) -> Part:
        return await self._ask(track, payloads.AskShow(self._run))

    async def _ask(self, track: TimedTrack, asked: payloads.AboutShow) -> Part:
        """One question; each try is an order of its own, which the stage admits once."""
        asker = self._askers[track.name]
        for _ in range(_TRIES):
            reply = await asker.once(
                asker.keys.show, asked, within=_ANSWER_S, began_at=self._began_at
            )
            if reply is not None:
                if reply.fault is not None:
                    raise reply.fault.error()
                return _part(reply)
            await asyncio.sleep(0.1)
        raise Unreachable(
            f"{track.name} does not answer",
            cause="no agent of that name is present, or the router lets nothing pass to it",
            remedy="m100link fleet list; m100link fleet acl check FILE",
        )

    async def _do(
        self, track: TimedTrack, asked: payloads.AboutShow, *done: payloads.ShowStage
    ) -> Part:
        """An order; one that was done although its answer was lost is refused and yet done."""
        try:
            return await self._ask(track, asked)
        except Unreachable:
            raise
        except M100Error:
            part = await self._look(track)
            if part.stage in done:
                return part
            raise

    async def _load(self, track: TimedTrack) -> None:
        await self._look(track)  # from then on each order says when it was made
        data = track.to_bytes()
        for at in range(0, len(data), _PIECE):
            await self._ask(track, payloads.SendTrack(self._run, at, data[at : at + _PIECE]))
        how = (self._leave, self._run[:16], self._least, len(self._tracks) - 1)
        part = await self._ask(track, payloads.LoadTrack(self._run, *how))
        if part.digest != track.digest:
            raise BadShow(
                f"{track.name} has another track than was sent to it",
                aircraft=(track.name,),
                remedy="look for another program that conducts a show, and begin again",
            )

    async def _place(self, track: TimedTrack) -> None:
        self._up.add(track.name)
        await self._do(
            track,
            payloads.TakePlace(self._run),
            payloads.ShowStage.PLACING,
            payloads.ShowStage.READY,
        )
        began = self._clock()
        while (part := await self._look(track)).stage is not payloads.ShowStage.READY:
            took = self._clock() - began
            if part.stage is not payloads.ShowStage.PLACING or took > _PLACING_S:
                raise ShowRefused(
                    f"{track.name} did not take its place: {part.why or f'not in {took:.0f} s'}",
                    why=Why.PLACE,
                    measured=took,
                    limit=_PLACING_S,
                    remedy=f"m100link fleet list shows {track.name}; mend that, and begin again",
                )
            await asyncio.sleep(_LOOK_S)

    async def _measure(self, track: TimedTrack) -> None:
        """Learn what its clock shows: the most that several round trips have in common."""
        for _ in range(_ROUND_TRIPS):
            await self._look(track)

    async def _start(self, track: TimedTrack, start_at: float) -> None:
        found = self._askers[track.name].its_clock.offset(self._clock())
        if found is None or not found.bound <= SKEW_S:
            bound = math.inf if found is None else found.bound
            raise ShowRefused(
                f"the clock of {track.name} may be wrong by {bound * 1000:.0f} ms",
                why=Why.CLOCK,
                measured=bound,
                limit=SKEW_S,
                remedy="conduct from a computer with a quicker link to it",
            )
        start = payloads.StartShow(self._run, track.digest, start_at + found.seconds, found.bound)
        await self._do(track, start, payloads.ShowStage.FLYING)

    def _rest(self, name: str) -> str:
        self._flying.discard(name)
        return "; the others fly on" if self._flying else ""

    async def _watch(self, track: TimedTrack) -> Part:
        """Until it has flown its track and landed, if it is to, has left, or is silent."""
        heard_at = self._clock()
        while True:
            try:
                part = await self._look(track)
                heard_at = self._clock()
            except M100Error as error:
                if self._clock() - heard_at >= _GONE_S:
                    # One that answers and tells nothing flies on: that is no cable.
                    why = "" if isinstance(error, Unreachable) else error.seen
                    refuses = f"reports nothing more: {why}" if why else "is silent"
                    self._tell(f"{track.name} {refuses}{self._rest(track.name)}")
                    return Part(track.name, None, why=why)
                await asyncio.sleep(_LOOK_S)
                continue
            if part.stage is payloads.ShowStage.FLOWN:
                why = part.why and f", and did not land: {part.why}"
                self._rest(track.name)
                self._tell(f"{track.name} has flown its track{why}")
                return part
            if part.stage is not payloads.ShowStage.FLYING:
                why = part.why and f": {part.why}"  # none where it was ordered to leave
                self._tell(f"{track.name} left{why}{self._rest(track.name)}")
                return part
            await asyncio.sleep(_LOOK_S)


def _part(reply: payloads.OrderReply) -> Part:
    show = reply.show
    if show is None:
        raise MessageError(f"{reply.name} does not report its stage in the show")
    return Part(reply.name, show.stage, show.digest, show.farthest_m, show.why, reply.clock)
