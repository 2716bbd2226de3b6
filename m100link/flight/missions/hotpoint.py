"""A circle around a place that the aircraft flies by itself: DJI's hotpoint, an orbit.

:meth:`m100link.Control.orbit` is another thing: a closed loop of this program, which ends with it.
"""

from __future__ import annotations

import asyncio
import math
from collections.abc import AsyncIterable, AsyncIterator, Callable, Iterator
from enum import IntEnum
from typing import TYPE_CHECKING, Any, NamedTuple

from m100link.errors import M100Error, MissionRefused, NotObserved, UsageError
from m100link.flight.guards import known
from m100link.flight.mission_state import MissionKind
from m100link.flight.missions.context import (
    MissionContext,
    MissionTracker,
    News,
    check_way,
    ended_by,
    height_of,
    metres_to,
    require_airborne,
)
from m100link.flight.missions.events import Aborted, MissionProgress
from m100link.flight.missions.mission_guard import MissionFlight, MissionGuard
from m100link.flight.missions.mission_session import MissionSession
from m100link.geodesy import bearing_deg, distance_m, normalize_degrees
from m100link.protocol.codes import MissionCode
from m100link.protocol.command import Problem
from m100link.protocol.commands import missions as wire
from m100link.protocol.commands.hotpoint import (
    FollowStart,
    FollowTarget,
    HotpointDownload,
    HotpointDownloadAnswer,
    HotpointResetYaw,
    HotpointSetRadius,
    HotpointSetRate,
    HotpointStart,
    HotpointStartAnswer,
)
from m100link.protocol.fields import Layout, Number
from m100link.protocol.records import Position

if TYPE_CHECKING:
    from m100link.telemetry.state import AircraftState

__all__ = ["CircleHeading", "CircleStart", "FollowFlight", "HotpointFlight", "Target"]


_NAME = "the hotpoint"
_CALLED = {
    "altitude": "height",
    "angular_rate": "rate_deg_s",
    "start_point": "start",
    "yaw_mode": "heading",
}  # fields of the wire, and a program's names for them

_DEGREES = {"latitude": ("latitude_deg", 90), "longitude": ("longitude_deg", 180)}
"""Likewise, with the largest value: on the wire they are radians."""

_MOST_DEG_S = 30.0
_MOST_M_S = 10.0  # along the circle
_REPEAT_S = 1.0  # between two transmissions of what is not acknowledged
_LOOK_S = 0.1
# The push tells tenths of a degree per second, and the distance as it is flown.
_RADIUS_SHOWN_M, _RATE_SHOWN_DEG_S = 1.0, 0.15


class CircleStart(IntEnum):
    """Where the circle is entered, seen from its centre; the numbers of the wire."""

    NORTH = 0
    SOUTH = 1
    WEST = 2
    EAST = 3
    NEAREST = 4


class CircleHeading(IntEnum):
    """Where the nose points on the circle; the numbers of the wire."""

    ALONG_PATH = 0
    TO_CENTRE = 1
    OUTWARDS = 2
    BY_RC = 3
    AS_AT_START = 4


def largest_rate(radius: float) -> float:
    """The largest angular rate on a circle, °/s: 30, and 10 m/s at most (DJI's libraries)."""
    return min(_MOST_DEG_S, math.degrees(_MOST_M_S / radius))


class HotpointTracker(MissionTracker):
    """Reads the pushes of one hotpoint. It has no end of its own: whatever ends it broke it off."""

    poll = HotpointDownload()

    def __init__(self, centre: tuple[float, float]) -> None:
        self._centre = centre  # latitude and longitude, °
        # Present distance from the centre as the aircraft says, m; None before it did.
        self.distance_m: float | None = None
        self.rate_deg_s: float | None = None  # present angular rate, °/s; likewise
        self.status: int | None = None  # 0 on the way to the circle, 1 circling, 2 paused

    def take(self, push: wire.MissionStatus | wire.WaypointEvent) -> News:
        """A push came."""
        newest = push.status if isinstance(push, wire.MissionStatus) else None
        if isinstance(newest, wire.HotpointStatus):
            self.distance_m, self.rate_deg_s = newest.radius_cm / 100, newest.rate / 10
            self.status = newest.status
            return []
        return [] if self.status is None else ended_by(newest)  # before that: older than ours

    def polled(self, answer: HotpointDownloadAnswer) -> News:
        """The stored circle was read."""
        if answer.code is MissionCode.NOT_RUNNING:
            return [Aborted(None, "it flies no circle any more, and gives no reason")]
        return []

    def progress(self, elapsed: float, state: AircraftState) -> MissionProgress:
        """Where it is."""
        distance = self.distance_m
        if distance is None:
            distance = metres_to(state, self._centre)
        height, rate = height_of(state), self.rate_deg_s
        return MissionProgress(elapsed, None, self.status, distance, height, rate)


class HotpointFlight(MissionFlight):
    """A circle around a place: ``async with control.hotpoint(…) as circle``.

    Entering checks and starts it; the rest is that of :class:`m100link.MissionFlight`. It flies
    until it is stopped. ``set_radius``, ``set_rate`` and ``reset_heading`` are not acknowledged by
    the aircraft: the first two are repeated until its pushes, or the circle that it says it flies,
    show them.
    """

    _FIRST = HotpointStart

    def __init__(
        self,
        context: MissionContext,
        guard: MissionGuard,
        request: HotpointStart,
        *,
        allow_far: bool,
    ) -> None:
        self._centre = math.degrees(request.latitude), math.degrees(request.longitude)
        self._track = HotpointTracker(self._centre)
        super().__init__(context, guard, MissionSession(context, MissionKind.HOTPOINT, self._track))
        self._request = request
        self._allow_far = allow_far
        self._radius, self._rate = request.radius, request.angular_rate
        self._is_clockwise = bool(request.clockwise)
        self._largest_radius: float | None = None

    def __repr__(self) -> str:
        return f"<HotpointFlight {self._run.state.name.lower()}, {self._track.distance_m} m>"

    async def _begin(self) -> None:
        _require_legal(self._request)
        _require_rate(self._rate, self._radius)
        await require_airborne(self._context, "the hotpoint")
        self._check(self._radius, self._rate)
        check_way(
            self._context.commander.state, "the hotpoint", self._centre, allow_far=self._allow_far
        )
        await self._context.make_way("the hotpoint")
        answer: HotpointStartAnswer = await self._run.start(self._request, lambda got: got.code)
        self._largest_radius = answer.largest_radius

    def _check(self, radius: float, rate: float) -> None:
        self._context.guards.check_target(
            "the hotpoint",
            self._centre,
            height=self._request.altitude,
            radius=radius,
            speed=math.radians(rate) * radius,
        )

    @property
    def distance_m(self) -> float | None:
        """Present distance from the centre as the aircraft says, m; None before it did."""
        return self._track.distance_m

    @property
    def rate_deg_s(self) -> float | None:
        """Present angular rate as the aircraft says, °/s; None before it did."""
        return self._track.rate_deg_s

    @property
    def largest_radius(self) -> float | None:
        """The largest radius that the aircraft allows here, m; None before the start."""
        return self._largest_radius

    async def set_radius(self, radius: float, *, wait: bool = True, timeout: float = 30.0) -> None:
        """Change the radius; the aircraft lowers a rate that is too large for it.

        Args:
            radius: 5 to 500 m.
            wait: Until the aircraft shows it; otherwise it is sent once and may be lost.
            timeout: Seconds to wait.

        Raises:
            UsageError: Not such a radius; nothing was sent.
            GuardRefused: The circle would leave the envelope; nothing was sent.
            NotObserved: The aircraft does not show it: it may fly the old circle.
            MissionAborted, NoAuthority: See :meth:`pause`.
        """
        request = HotpointSetRadius(radius)
        _require_legal(request)
        # The aircraft lowers a rate that is too large for the new radius: that speed is judged.
        self._check(radius, min(self._rate, largest_rate(radius)))

        def is_shown() -> bool:
            seen = self._track.distance_m
            return seen is not None and abs(seen - radius) <= _RADIUS_SHOWN_M

        await self._send(
            request, is_shown, lambda circle: abs(circle.radius - radius) < 0.01, wait, timeout
        )
        self._radius = radius

    async def set_rate(
        self,
        rate_deg_s: float,
        *,
        clockwise: bool | None = None,
        wait: bool = True,
        timeout: float = 30.0,
    ) -> None:
        """Change the angular rate, and the direction.

        Args:
            rate_deg_s: 0 to 30 °/s, and no more than 10 m/s along the circle.
            clockwise: Seen from above; None: as it is.
            wait: Until the aircraft shows it; otherwise it is sent once and may be lost.
            timeout: Seconds to wait.

        Raises: as :meth:`set_radius`.
        """
        direction = self._is_clockwise if clockwise is None else clockwise
        request = HotpointSetRate(int(direction), rate_deg_s)
        _require_legal(request)
        _require_rate(rate_deg_s, self._radius)
        self._check(self._radius, rate_deg_s)

        is_turned = direction is not self._is_clockwise and rate_deg_s > 0.0
        turns = self._turns()

        def is_shown() -> bool:
            seen, turn = self._track.rate_deg_s, next(turns)
            if is_turned and (turn == 0.0 or (turn > 0.0) is not direction):
                return False
            return seen is not None and abs(seen - rate_deg_s) < _RATE_SHOWN_DEG_S

        def is_confirmed(circle: HotpointStart) -> bool:
            return (
                abs(circle.angular_rate - rate_deg_s) < 0.01 and bool(circle.clockwise) is direction
            )

        await self._send(request, is_shown, is_confirmed, wait, timeout)
        self._rate, self._is_clockwise = rate_deg_s, direction

    def _turns(self) -> Iterator[float]:
        """Degrees flown around the centre since the look before, clockwise positive; 0 is unknown.

        By telemetry: the push does not tell the direction.
        """
        before: float | None = None
        while True:
            position = known(self._context.commander.state, Position)
            there = None
            if position is not None:
                place = position.latitude_deg, position.longitude_deg
                there = bearing_deg(*self._centre, *place)
            if before is None or there is None:
                yield 0.0
            else:
                yield normalize_degrees(there - before)
            before = there

    async def reset_heading(self) -> None:
        """Turn the nose back to where it is to point. Sent once; nothing shows that it arrived.

        Raises:
            MissionAborted, NoAuthority: See :meth:`pause`.
        """
        self._run.require_in_the_air("its heading")
        self._context.commander.requests.push(HotpointResetYaw())

    async def _send(
        self,
        request: HotpointSetRadius | HotpointSetRate,
        is_shown: Callable[[], bool],
        is_confirmed: Callable[[HotpointStart], bool],
        wait: bool,
        timeout: float,
    ) -> None:
        """Send it once, or again and again until a push or the download shows it (errata 58)."""
        self._run.require_in_the_air("its change")
        requests, clock = self._context.commander.requests, self._context.commander.link.loop.time
        give_up_at = clock() + timeout
        requests.push(request)
        with self._context.block.waiting(self._run.name):
            while wait:
                send_again_at = clock() + _REPEAT_S
                while clock() < send_again_at:
                    await asyncio.sleep(_LOOK_S)
                    if is_shown():
                        return
                self._run.require_in_the_air("its change")
                # Before the aircraft has flown there, only its stored circle shows that it heard.
                answer = await requests.execute(
                    HotpointDownload(), timeout=0.5, tries=3, refusal=MissionRefused
                )
                if answer.code is MissionCode.SUCCESS and is_confirmed(answer.hotpoint):
                    return
                if clock() >= give_up_at:
                    raise NotObserved(
                        f"{request.NAME} was sent for {timeout:g} s, and nothing shows it",
                        cause="it is not acknowledged, and the aircraft reports the old circle",
                        remedy="look at the aircraft: it may fly the old circle",
                    )
                requests.push(request)


def _require_legal(request: HotpointStart | HotpointSetRadius | HotpointSetRate) -> None:
    for problem in request.problems():
        if problem.field in _DEGREES:
            name, most = _DEGREES[problem.field]
            value = round(math.degrees(problem.value), 9)
            raise Problem(name, value, f"-{most} to {most} °").error(_NAME)
        name = _CALLED.get(problem.field, problem.field)
        raise problem._replace(field=name).error(_NAME)


def _require_rate(rate: float, radius: float) -> None:
    most = largest_rate(radius)
    if rate > most + 1e-6:
        raise UsageError(
            f"{rate:g} °/s on a circle of {radius:g} m would be {math.radians(rate) * radius:z.1f} "
            "m/s; nothing was sent",
            cause=f"the aircraft refuses more than {_MOST_M_S:g} m/s along the circle",
            remedy=f"stay within {most:.1f} °/s, or choose a smaller radius",
        )


# -- following a target that moves, at the distance that it had when this began --------------------


_INTERVAL_S = 0.1  # targets are sent at 10 Hz at most
_LOWEST_M = 5.0  # what the aircraft refuses to follow below (inferred number)
_JUMP_M = 200.0  # the aircraft ignores a target so far from the one before (inferred)


class Target(NamedTuple):
    """Where a target is."""

    latitude_deg: float  #: WGS 84.
    longitude_deg: float  #: WGS 84.
    #: Whole metres above the sea; the aircraft follows its changes. 0, the default, keeps its
    #: height.
    altitude_m: float = 0.0


_PLACE = Layout(
    Number("latitude_deg", "d", -90, 90, "°"),
    Number("longitude_deg", "d", -180, 180, "°"),
    Number("altitude_m", "d", 0, 0xFFFF, "m"),
)
"""The range of a target: that of the wire, in the units of the program."""

TargetSource = Target | AsyncIterable[Target]
"""The first target, to be renewed by :meth:`FollowFlight.set_target`; or all of them."""


class FollowTracker(MissionTracker):
    """Reads the pushes of a follow mission, which tell only that it flies."""

    def __init__(self) -> None:
        self.target: Target | None = None
        self._is_seen = False

    def take(self, push: wire.MissionStatus | wire.WaypointEvent) -> News:
        """A push came."""
        status = push.status if isinstance(push, wire.MissionStatus) else None
        if isinstance(status, wire.FollowStatus):
            self._is_seen = True
            return []
        return ended_by(status) if self._is_seen else []  # before that: older than ours

    def progress(self, elapsed: float, state: AircraftState) -> MissionProgress:
        """How far the target is."""
        distance = None if self.target is None else metres_to(state, self.target[:2])
        return MissionProgress(elapsed, distance_m=distance, height_m=height_of(state))


class FollowFlight(MissionFlight):
    """Following a target: ``async with control.follow_target(source) as mission``.

    It is stopped when its source ends, and the aircraft hovers. When nothing new comes for 6 s the
    aircraft waits, and goes on with the next target; after about half a minute it gives up.
    """

    _FIRST = FollowStart

    def __init__(
        self,
        context: MissionContext,
        guard: MissionGuard,
        source: TargetSource,
        *,
        face_target: bool,
        allow_far: bool,
    ) -> None:
        self._track = FollowTracker()
        super().__init__(context, guard, MissionSession(context, MissionKind.FOLLOW, self._track))
        self._source = source
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
        await require_airborne(self._context, "the follow mission")
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
            self._context.commander.state, "the follow mission", place, allow_far=self._allow_far
        )
        await self._context.make_way("the follow mission")
        self._track.target = first
        request = FollowStart(*_on_wire(first), yaw_mode=int(self._face_target))
        await self._run.start(request, int)
        if targets is not None:
            self._feeding = asyncio.create_task(self._feed(targets), name="m100link targets")

    def _require_height(self) -> None:
        position = known(self._context.commander.state, Position)
        if position is not None and position.height_m < _LOWEST_M:
            raise UsageError(
                f"the follow mission was asked for at a height of {position.height_m:z.1f} m; "
                "nothing was sent",
                cause=f"the aircraft refuses to follow below {_LOWEST_M:g} m",
                remedy=f"await control.climb_to({_LOWEST_M + 1:g}) first",
            )

    def _check(self, target: Target) -> None:
        """Whether it may be followed: its values, the envelope, and how far it is from the last."""
        for problem in _PLACE.problems(target):
            raise problem.error("the target")
        place = target.latitude_deg, target.longitude_deg
        self._context.guards.check_target("the target", place)
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
        return self._context.commander.requests.push(FollowTarget(*_on_wire(target)))

    async def _feed(self, targets: AsyncIterator[Target]) -> None:
        """Send every target until there is none, then stop."""
        clock = self._context.commander.link.loop.time
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
