"""Following a target that moves, at the distance that it had when this began."""

from __future__ import annotations

import asyncio
import logging
import math
from collections.abc import AsyncIterable, AsyncIterator, Awaitable, Callable
from typing import TYPE_CHECKING, Any, NamedTuple

from m100link.errors import M100Error, UsageError
from m100link.flight.known import known
from m100link.flight.mission_state import MissionKind
from m100link.flight.missions.checks import check_way, require_airborne
from m100link.flight.missions.deck import Deck, Over
from m100link.flight.missions.events import Aborted, MissionEvent, MissionProgress
from m100link.flight.missions.flight import MissionFlight
from m100link.flight.missions.keeper import MissionKeeper
from m100link.flight.missions.run import MissionRun
from m100link.flight.missions.waypoint_track import broken_off
from m100link.geodesy import distance_m
from m100link.protocol.commands import missions as wire
from m100link.protocol.commands.follow import FollowStart, FollowTarget
from m100link.protocol.fields import Layout, Number
from m100link.protocol.records import Position

if TYPE_CHECKING:
    from m100link.telemetry.state import AircraftState

__all__ = ["FollowFlight", "FollowTrack", "Target", "TargetSource"]

_logger = logging.getLogger(__name__)

_INTERVAL_S = 0.1  # targets are sent at 10 Hz at most (facts F3)
_LOWEST_M = 5.0  # what the aircraft refuses to follow below (facts F2, inferred number)
_JUMP_M = 200.0
"""A target that is so far from the one before is ignored by the aircraft (facts F3, inferred)."""


class Target(NamedTuple):
    """Where a target is.

    Attributes:
        latitude_deg: WGS 84.
        longitude_deg: WGS 84.
        altitude_m: Above the sea, whole metres: the aircraft follows its changes. 0, the default:
            it keeps its height.
    """

    latitude_deg: float
    longitude_deg: float
    altitude_m: float = 0.0


_PLACE = Layout(
    Number("latitude_deg", "d", -90, 90, "°"),
    Number("longitude_deg", "d", -180, 180, "°"),
    Number("altitude_m", "d", 0, 0xFFFF, "m"),
)
"""What a target may be: that of the wire, in the units of the program."""

TargetSource = Target | AsyncIterable[Target]
"""The first target, to be renewed by :meth:`FollowFlight.set_target`; or all of them."""


class FollowTrack:
    """Reads the pushes of a follow mission, which tell only that it flies.

    Attributes:
        target: The newest one.
        poll: Nothing can be asked.
    """

    poll = None
    ends_by_landing = False

    def __init__(self) -> None:
        self.target: Target | None = None
        self._is_seen = False

    def take(self, push: wire.MissionStatus | wire.WaypointEvent) -> list[MissionEvent | Over]:
        """A push came."""
        told = push.status if isinstance(push, wire.MissionStatus) else None
        if isinstance(told, wire.FollowStatus):
            self._is_seen = True
        elif not self._is_seen or told is None:
            pass  # older than ours
        elif isinstance(told, wire.IdleStatus | wire.IocStatus):
            return [broken_off(told)]
        elif isinstance(told, wire.WaypointStatus | wire.HotpointStatus):
            return [Aborted(None, "another mission flies the aircraft")]
        return []

    def polled(self, answer: Any) -> list[MissionEvent | Over]:
        """Nothing is asked."""
        return []

    def progress(self, elapsed: float, state: AircraftState) -> MissionProgress:
        """How far the target is."""
        position = known(state, Position)
        distance = None
        if position is not None and self.target is not None:
            here = position.latitude_deg, position.longitude_deg
            distance = distance_m(*here, self.target.latitude_deg, self.target.longitude_deg)
        height = None if position is None else position.height_m
        return MissionProgress(elapsed, distance_m=distance, height_m=height)


class FollowFlight(MissionFlight):
    """Following a target: ``async with control.follow_target(source) as mission``.

    It is stopped when its source ends, and the aircraft hovers. When nothing new comes for 6 s the
    aircraft waits, and goes on with the next target; after about half a minute it gives up.
    """

    _FIRST = FollowStart

    def __init__(
        self,
        deck: Deck,
        keeper: MissionKeeper,
        source: TargetSource,
        *,
        make_way: Callable[[str], Awaitable[None]],
        face_target: bool,
        allow_far: bool,
    ) -> None:
        self._track = FollowTrack()
        super().__init__(deck, keeper, MissionRun(deck, MissionKind.FOLLOW, self._track))
        self._source = source
        self._make_way = make_way
        self._face_target = face_target
        self._allow_far = allow_far
        self._feeding: asyncio.Task[None] | None = None

    def __repr__(self) -> str:
        return f"<FollowFlight {self._run.state.name.lower()}, {self._track.target}>"

    @property
    def target(self) -> Target | None:
        """The newest target that was sent."""
        return self._track.target

    async def _begin(self) -> None:
        targets: AsyncIterator[Target] | None = None
        await require_airborne(self._deck, "the follow mission")
        self._require_height()
        if isinstance(self._source, Target):
            first = self._source
        else:
            targets = aiter(self._source)
            try:
                first = await anext(targets)
            except StopAsyncIteration:
                raise UsageError("the source of targets ended before the first one") from None
        self._check(first)
        place = first.latitude_deg, first.longitude_deg
        check_way(
            self._deck.commander.state, "the follow mission", place, allow_far=self._allow_far
        )
        await self._make_way("the follow mission")
        self._track.target = first
        request = FollowStart(*_on_wire(first), yaw_mode=int(self._face_target))
        await self._run.start(request, int)
        if targets is not None:
            self._feeding = asyncio.create_task(self._feed(targets), name="m100link targets")

    def _require_height(self) -> None:
        position = known(self._deck.commander.state, Position)
        if position is not None and position.height_m < _LOWEST_M:
            raise UsageError(
                f"the follow mission was asked for at a height of {position.height_m:.1f} m; "
                "nothing was sent",
                cause=f"the aircraft refuses to follow below {_LOWEST_M:g} m",
                remedy=f"await control.climb_to({_LOWEST_M + 1:g}) first",
            )

    def _check(self, target: Target) -> None:
        """Whether it may be followed: its values, the envelope, and how far it is from the last."""
        for problem in _PLACE.problems(target):
            raise problem.error("the target")
        place = target.latitude_deg, target.longitude_deg
        self._deck.guards.check_target("the target", place)
        before = self._track.target
        if before is not None:
            jump = distance_m(before.latitude_deg, before.longitude_deg, *place)
            if jump > _JUMP_M:
                raise UsageError(
                    f"a target {jump:.0f} m from the one before was not sent",
                    cause="the aircraft ignores jumps of more than 200 m",
                    remedy="check the source; for another target begin another mission",
                )

    def set_target(self, target: Target) -> bool:
        """Tell where the target is now. Not acknowledged: tell again, once to ten times a second.

        Returns:
            False when the line does not drain.

        Raises:
            UsageError: No such place, or more than 200 m from the one before; nothing was sent.
            GuardRefused: It is outside the envelope; nothing was sent.
            MissionAborted, NoAuthority: See :meth:`pause`.
        """
        self._run.require_in_the_air("another target")
        self._check(target)
        self._track.target = target
        return self._deck.commander.requests.push(FollowTarget(*_on_wire(target)))

    async def _feed(self, targets: AsyncIterator[Target]) -> None:
        """Send every target until there is none, then stop."""
        clock = self._deck.commander.link.loop.time
        failure: M100Error | None = None
        try:
            async for target in targets:
                if not self._run.is_in_the_air:
                    return
                sent_at = clock()
                self.set_target(target)
                await asyncio.sleep(sent_at + _INTERVAL_S - clock())
        except asyncio.CancelledError as error:
            task = asyncio.current_task()
            if task is None or task.cancelling():
                raise
            failure = M100Error("the source of targets was cancelled")  # within, by somebody else
            failure.__cause__ = error
        except M100Error as error:
            failure = error
        except Exception as error:  # noqa: BLE001 (of the source: the program gets it, wrapped)
            failure = M100Error(f"the source of targets failed: {error!r}")
            failure.__cause__ = error
        await self._run.end_by_program(failure)

    async def __aexit__(self, *exc_info: Any) -> None:
        try:
            await super().__aexit__(*exc_info)
        finally:
            if self._feeding is not None:
                self._feeding.cancel()


def _on_wire(target: Target) -> tuple[float, float, int]:
    """Radians and whole metres."""
    latitude, longitude = math.radians(target.latitude_deg), math.radians(target.longitude_deg)
    return latitude, longitude, round(target.altitude_m)
