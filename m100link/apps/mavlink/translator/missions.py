"""The mission protocol: upload, download, clear, current item, progress; of missions and fences.

An upload is one transaction of one peer, and others may upload beside it. The stored
plan stays until the last item is there, so an upload that breaks off changes nothing.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import lru_cache

from m100link.apps.agent.background import ignore
from m100link.apps.mavlink.translator.codec import MavlinkMessage, Peer
from m100link.apps.mavlink.translator.numbers import (
    MavCommand,
    MissionResult,
    MissionType,
    Severity,
)
from m100link.apps.mavlink.translator.route import Refused, Route, read_route
from m100link.geodesy import WGS84_FLATTENING, WGS84_SEMI_MAJOR_AXIS_M, LocalFrame
from m100link.missions.qgroundcontrol import command_name

MOST_ITEMS = 1000  # of a mission or a fence
_AGAIN_S, _MOST_TRIES = 0.25, 30
_CURRENT_S = 1.0
_LATE_S = 5.0
_NOT_STARTED, _ACTIVE, _PAUSED, _COMPLETE, _NONE = 2, 3, 4, 5, 1


@dataclass(slots=True)
class _Upload:
    kind: int
    count: int
    asked_at: float  # when the next one was asked for last, or the last one was answered, s
    items: list[MavlinkMessage] = field(default_factory=list)  # those that are there
    tries: int = 0
    # The answer to the last one: it may be lost, and that item comes again.
    result: MissionResult | None = None


class MissionProtocol:
    def __init__(
        self,
        # Sends a message to a peer, None for everybody.
        send: Callable[[MavlinkMessage, Peer | None], None],
        tell: Callable[[Severity, str], None],  # takes what people have to know
        *,
        ground: Callable[[], float | None],  # altitude of the take-off point above sea level, m
        speed: Callable[[], float],  # of missions that do not say it, m/s
        # Why a peer may not change the mission now; empty where it may.
        may_change: Callable[[Peer, int], str],
        # Why nobody may fly a mission, as far as is known before its start; empty where one may.
        refusal_of: Callable[[Route], str],
    ) -> None:
        self._send = send
        self._tell = tell
        self._ground = ground
        self._speed = speed
        self._may_change = may_change
        self._refusal_of = refusal_of
        # The last upload of each kind.
        self._stored: dict[int, tuple[MavlinkMessage, ...]] = dict.fromkeys(
            (MissionType.MISSION, MissionType.FENCE, MissionType.RALLY), ()
        )
        # One of each peer: a slow one keeps nobody else from uploading.
        self._uploads: dict[Peer, _Upload] = {}
        # Called with who uploaded or cleared a mission, a fence or rally points, its items, and why
        # they are refused; empty where they are not.
        self.on_upload: Callable[[Peer, int, Sequence[MavlinkMessage], str], None] = ignore
        self.fence = Fence()  # what was uploaded last
        self.edition = 0  # counts what was uploaded, cleared, or set to begin elsewhere
        self.due_at = float("-inf")  # the next of :meth:`due`
        self.restart()

    @property
    def items(self) -> tuple[MavlinkMessage, ...]:
        return self._stored[MissionType.MISSION]

    def route(self) -> Route | None:
        """The mission as it is flown; None without one.

        Raises Refused: it cannot be flown any more: the ground is another one.
        """
        if not self.items:
            return None
        return read_route(self.items, ground=self._ground(), speed=self._speed())

    # -- what comes in ---------------------------------------------------------------------------

    def receive(self, message: MavlinkMessage, peer: Peer, now: float) -> None:
        kind = message.fields.get("mission_type", MissionType.MISSION)
        if message.name == "MISSION_COUNT":
            self._begin(message["count"], kind, peer, now)
        elif message.name == "MISSION_ITEM_INT":
            self._take(message, kind, peer, now)
        elif message.name == "MISSION_REQUEST_LIST":
            count = len(self._stored.get(kind, ()))
            self._send(MavlinkMessage("MISSION_COUNT", {"count": count} | _to(peer, kind)), peer)
        elif message.name in ("MISSION_REQUEST_INT", "MISSION_REQUEST"):
            self._give(message["seq"], kind, peer)
        elif message.name == "MISSION_CLEAR_ALL":
            self._clear(kind, peer)
        elif message["type"] != MissionResult.ACCEPTED:
            self._uploads.pop(peer, None)  # MISSION_ACK: it does not want to go on

    def _acknowledge(self, result: MissionResult, kind: int, peer: Peer) -> None:
        self._send(MavlinkMessage("MISSION_ACK", {"type": result} | _to(peer, kind)), peer)

    def _begin(self, count: int, kind: int, peer: Peer, now: float) -> None:
        upload = self._uploads.get(peer)
        if upload and (upload.kind, upload.count, upload.result) == (kind, count, None):
            self._ask(upload, peer, now)  # the question that came before was lost
            return
        why = self._may_change(peer, kind)
        if why:
            self._tell(Severity.WARNING, f"mission: {why}")
            self._acknowledge(MissionResult.DENIED, kind, peer)
        elif kind not in self._stored:
            self._acknowledge(MissionResult.UNSUPPORTED, kind, peer)
        elif count > MOST_ITEMS:
            self._acknowledge(MissionResult.NO_SPACE, kind, peer)
        elif count == 0:
            self._clear(kind, peer)
        else:
            self._uploads[peer] = _Upload(kind, count, now)
            self._ask(self._uploads[peer], peer, now)

    def _ask(self, upload: _Upload, peer: Peer, now: float) -> None:
        upload.asked_at = now
        self.due_at = min(self.due_at, now + _AGAIN_S)
        fields = {"seq": len(upload.items)} | _to(peer, upload.kind)
        self._send(MavlinkMessage("MISSION_REQUEST_INT", fields), peer)

    def _take(self, item: MavlinkMessage, kind: int, peer: Peer, now: float) -> None:
        upload = self._uploads.get(peer)
        if upload is None or upload.kind != kind:
            return
        if upload.result is not None:
            if now - upload.asked_at < _LATE_S:
                self._acknowledge(upload.result, kind, peer)
            return
        if item["seq"] != len(upload.items):
            return  # one that came twice, or too early: the next one is asked for again
        upload.items.append(item)
        upload.tries = 0
        if len(upload.items) < upload.count:
            self._ask(upload, peer, now)
            return
        upload.result, upload.asked_at = self._store(kind, tuple(upload.items), peer), now
        self._acknowledge(upload.result, kind, peer)

    def _store(self, kind: int, items: tuple[MavlinkMessage, ...], peer: Peer) -> MissionResult:
        try:
            why = self._may_change(peer, kind)
            if why:
                raise Refused(why, MissionResult.DENIED)
            if kind == MissionType.FENCE:
                self.fence = read_fence(items)
                if any(item["command"] == MavCommand.NAV_FENCE_RETURN_POINT for item in items):
                    text = "fence: its return point is only stored: at the fence the aircraft holds"
                    self._tell(Severity.WARNING, text)
            elif kind == MissionType.RALLY:
                # Kept for programs that want them back; nobody may believe in them.
                self._tell(Severity.WARNING, "rally points are only stored: return goes home")
            else:
                ground = self._ground()
                route = read_route(items, ground=ground or 0.0, speed=self._speed())
                if ground is not None and (why := self._refusal_of(route)):
                    raise Refused(why)
                named = [command_name(one) for one in dict.fromkeys(route.left_out)]
                for at in range(0, len(named), 4):  # as many as a text holds
                    text = f"mission: without effect: {', '.join(named[at : at + 4])}"
                    self._tell(Severity.NOTICE, text)
        except Refused as refused:
            self._tell(Severity.WARNING, f"mission refused: {refused.why}")
            self.on_upload(peer, kind, items, refused.why)
            return refused.result
        self._stored[kind] = items
        self.on_upload(peer, kind, items, "")
        if kind == MissionType.MISSION:
            self.edition += 1
            self.restart()
        return MissionResult.ACCEPTED

    def _give(self, number: int, kind: int, peer: Peer) -> None:
        items = self._stored.get(kind, ())
        if number >= len(items):
            self._acknowledge(MissionResult.INVALID_SEQUENCE, kind, peer)
            return
        fields = dict(items[number].fields) | _to(peer, kind)
        fields["current"] = int(kind == MissionType.MISSION and number == self.current)
        self._send(MavlinkMessage("MISSION_ITEM_INT", fields), peer)

    def _clear(self, kind: int, peer: Peer) -> None:
        kinds = list(self._stored) if kind == MissionType.ALL else [kind]
        for one in kinds:
            why = self._may_change(peer, one)
            if why:
                self._tell(Severity.WARNING, f"mission: {why}")
                self._acknowledge(MissionResult.DENIED, kind, peer)
                return
        for one in kinds:
            if one in self._stored:
                self._stored[one] = ()
                self.on_upload(peer, one, (), "")
            if one == MissionType.FENCE:
                self.fence = Fence()
            elif one == MissionType.MISSION:
                self.edition += 1
                self.restart()
        self._acknowledge(MissionResult.ACCEPTED, kind, peer)

    # -- progress --------------------------------------------------------------------------------

    def restart(self) -> None:
        self.current, self._reached = 0, -1  # item that is flown to, or would be; and the last one
        self._sent_at = self.due_at = float("-inf")  # MISSION_CURRENT

    def begin_at(self, number: int) -> None:
        """Somebody wants it flown from that item on."""
        self.edition += 1
        self._reached = -1
        self.flies_to(number)

    def flies_to(self, number: int) -> None:
        if number != self.current:
            self.current = number
            self._sent_at = self.due_at = float("-inf")

    def reached(self, number: int) -> None:
        self._reached = number
        self._send(MavlinkMessage("MISSION_ITEM_REACHED", {"seq": number}), None)

    def over(self) -> None:
        """The last one is done: items behind it have no place to be reached."""
        last = len(self.items) - 1
        if self._reached != last:
            self.reached(last)
        self.flies_to(last)

    @property
    def is_over(self) -> bool:
        return bool(self.items) and self._reached == len(self.items) - 1

    def due(self, now: float, *, is_flying: bool) -> Iterator[MavlinkMessage]:
        """The request that has to be repeated, and MISSION_CURRENT."""
        for peer, upload in tuple(self._uploads.items()):
            is_over, since = upload.result is not None, now - upload.asked_at
            if is_over and since >= _LATE_S:
                del self._uploads[peer]
            elif not is_over and since >= _AGAIN_S:
                upload.tries += 1
                if upload.tries <= _MOST_TRIES:
                    self._ask(upload, peer, now)
                    continue
                del self._uploads[peer]
                self._acknowledge(MissionResult.OPERATION_CANCELLED, upload.kind, peer)
                self._tell(Severity.WARNING, "mission: the upload broke off, nothing was changed")
        if now - self._sent_at >= _CURRENT_S:
            self._sent_at = now
            yield self.current_message(is_flying=is_flying)
        asked = [one.asked_at + _AGAIN_S for one in self._uploads.values() if one.result is None]
        self.due_at = min([self._sent_at + _CURRENT_S, *asked])

    def current_message(self, *, is_flying: bool) -> MavlinkMessage:
        if not self.items:
            state = _NONE
        elif is_flying:
            state = _ACTIVE
        elif self.is_over:
            state = _COMPLETE
        else:
            state = _PAUSED if self.current else _NOT_STARTED
        fields = {"seq": self.current, "total": len(self.items), "mission_state": state}
        return MavlinkMessage("MISSION_CURRENT", fields)


def _to(peer: Peer, kind: int) -> dict[str, int]:
    return peer.target | {"mission_type": kind}


# -- the fence of a ground station: areas to stay in, and areas to stay out of ---------------------
# It comes on top of the agent's envelope and never widens it. Each target has to lie inside;
# an aircraft that is about to leave is held, and setpoints are not flown while it is outside.


_POLYGONS = {
    MavCommand.NAV_FENCE_POLYGON_VERTEX_INCLUSION: True,
    MavCommand.NAV_FENCE_POLYGON_VERTEX_EXCLUSION: False,
}
_CIRCLES = {
    MavCommand.NAV_FENCE_CIRCLE_INCLUSION: True,
    MavCommand.NAV_FENCE_CIRCLE_EXCLUSION: False,
}
_AROUND_M = 2.0  # between the places of a circle that are looked at; at most 256
_FAR_M = 10_000.0  # from here on the distance of an area is that of the circle around it
_EARTH_M, _E2 = 6_371_000.0, WGS84_FLATTENING * (2.0 - WGS84_FLATTENING)
_Local = tuple[float, float]  # north and east, m


@lru_cache(1024)
def _space(latitude_deg: float, longitude_deg: float) -> tuple[float, float, float]:
    """Where a place is in space, m: straight distances are quick, also at 180 degrees and poles."""
    latitude, longitude = math.radians(latitude_deg), math.radians(longitude_deg)
    across = WGS84_SEMI_MAJOR_AXIS_M / math.sqrt(1.0 - _E2 * math.sin(latitude) ** 2)
    out = across * math.cos(latitude)
    up = across * (1.0 - _E2) * math.sin(latitude)
    return out * math.cos(longitude), out * math.sin(longitude), up


@lru_cache(1024)
def _local(frame: LocalFrame, latitude_deg: float, longitude_deg: float) -> _Local:
    """Areas that share a frame ask for the same places."""
    return frame.to_local(latitude_deg, longitude_deg)


@dataclass(frozen=True, slots=True)
class _Area:
    is_inside: bool  # whether to stay in it
    frame: LocalFrame  # of the edges
    middle: tuple[float, float, float]  # of a circle, or the last corner: in space, m
    radius: float  # m; of a polygon, how far from that corner it lies at most
    edges: tuple[tuple[_Local, _Local], ...] = ()  # north and east, m; empty for a circle

    def away_m(self, latitude_deg: float, longitude_deg: float) -> float:
        """How far its middle is away on the Earth: to 1 cm in 100 km."""
        straight = math.dist(_space(latitude_deg, longitude_deg), self.middle)
        return 2.0 * _EARTH_M * math.asin(min(1.0, straight / (2.0 * _EARTH_M)))

    def has(self, latitude_deg: float, longitude_deg: float) -> bool:
        if math.dist(_space(latitude_deg, longitude_deg), self.middle) > self.radius:
            return False  # straight through the Earth it is never farther than around it
        if not self.edges:
            return self.away_m(latitude_deg, longitude_deg) <= self.radius
        north, east = _local(self.frame, latitude_deg, longitude_deg)
        is_in = False
        for (begin_north, begin_east), (end_north, end_east) in self.edges:
            if (begin_east > east) != (end_east > east):
                share = (east - begin_east) / (end_east - begin_east)
                is_in ^= north < begin_north + share * (end_north - begin_north)
        return is_in

    def edge_m(self, latitude_deg: float, longitude_deg: float) -> float:
        beyond = self.away_m(latitude_deg, longitude_deg) - self.radius
        if not self.edges or beyond > _FAR_M:
            return abs(beyond)
        place = _local(self.frame, latitude_deg, longitude_deg)
        return min(_distance(place, *edge) for edge in self.edges)

    def is_entered(self, begin: tuple[float, float], end: tuple[float, float]) -> bool:
        """Whether a straight way leads into it: from outside, or again after it has led out."""
        here = _space(*begin)
        to_begin, length = math.dist(here, self.middle), math.dist(here, _space(*end))
        if to_begin > self.radius + 1.001 * length + 1.0:  # what curves is a little longer
            return False
        if self.edges:
            way = _local(self.frame, *begin), _local(self.frame, *end)
            return sum(_cross(*way, *edge) for edge in self.edges) > self.has(*begin)
        if to_begin <= self.radius or not length:
            return False
        sagitta = length * length / (8.0 * _EARTH_M)  # so deep is the way below the ground
        to_end = math.dist(_space(*end), self.middle)
        foot = (to_begin**2 + length**2 - to_end**2) / (2.0 * length)
        beside = to_begin**2 - foot**2 + (foot - min(max(foot, 0.0), length)) ** 2
        return beside <= (self.radius + sagitta) ** 2


def _distance(place: _Local, begin: _Local, end: _Local) -> float:
    """How far a place is from a straight way, m."""
    north, east = end[0] - begin[0], end[1] - begin[1]
    to_north, to_east = place[0] - begin[0], place[1] - begin[1]
    length = north * north + east * east
    share = (to_north * north + to_east * east) / length if length else 0.0
    share = min(max(share, 0.0), 1.0)
    return math.hypot(to_north - share * north, to_east - share * east)


def _cross(a: _Local, b: _Local, c: _Local, d: _Local) -> bool:
    def side(begin: _Local, end: _Local, place: _Local) -> float:
        north, east = end[0] - begin[0], end[1] - begin[1]
        return north * (place[1] - begin[1]) - east * (place[0] - begin[0])

    return side(a, b, c) * side(a, b, d) <= 0.0 and side(c, d, a) * side(c, d, b) <= 0.0


@dataclass(frozen=True, slots=True)
class Fence:
    """All areas; without any it refuses nothing."""

    areas: tuple[_Area, ...] = ()  # to stay in, or out of

    def refusal(self, latitude_deg: float, longitude_deg: float, radius: float = 0.0) -> str:
        """Why nobody may be there, empty where one may.

        ``radius``: of a circle around the place, m.
        """
        if not self.areas:
            return ""
        places = [(latitude_deg, longitude_deg)]
        if radius:
            frame = LocalFrame(latitude_deg, longitude_deg)
            many = min(max(8, math.ceil(math.tau * radius / _AROUND_M)), 256)
            turns = (math.tau * place / many for place in range(many))
            places += [
                frame.to_geodetic(radius * math.cos(turn), radius * math.sin(turn))
                for turn in turns
            ]
        inside = [area for area in self.areas if area.is_inside]
        for place in places:
            if inside and not any(area.has(*place) for area in inside):
                return "outside of the fence"
            if any(area.has(*place) for area in self.areas if not area.is_inside):
                return "inside of an area that the fence excludes"
        return ""

    def enters(self, begin: tuple[float, float], end: tuple[float, float]) -> bool:
        """Whether a straight way leads into an excluded area, or again into the one around it."""
        return any(area.is_entered(begin, end) for area in self.areas if not area.is_inside)

    def on_the_way(self, begin: tuple[float, float], end: tuple[float, float]) -> str:
        """Why nobody may fly straight from a place to another.

        Of areas to stay in only the end is asked for: several may lie side by side.
        """
        if self.enters(begin, end):
            return "an excluded area is on the path"
        return self.refusal(*end)

    def depth_m(self, latitude_deg: float, longitude_deg: float) -> float:
        """How far it is at least to a place that the fence allows; 0 at one."""
        place = latitude_deg, longitude_deg
        inside = [area for area in self.areas if area.is_inside]
        excluded = [area for area in self.areas if not area.is_inside and area.has(*place)]
        away = [area.edge_m(*place) for area in excluded]
        if inside and not any(area.has(*place) for area in inside):
            away.append(min(area.edge_m(*place) for area in inside))
        return max(away, default=0.0)


def read_fence(items: Sequence[MavlinkMessage]) -> Fence:
    """The fence of these items.

    Raises Refused: it has what is not an area: a fence that is kept in part would be believed in.
    """
    areas: list[_Area] = []
    waiting: list[tuple[float, float]] = []
    frames: dict[tuple[int, int], LocalFrame] = {}  # polygons nearby share one
    wanted, kind = 0, 0
    for number, item in enumerate(items):
        command, place = item["command"], (item["x"] / 1e7, item["y"] / 1e7)
        if command in _POLYGONS:
            if not waiting:
                count, kind = item["param1"], command
                if not 3 <= count <= 1000 or count != int(count):
                    raise Refused(f"fence item {number}: a polygon of {count:g} corners")
                wanted = int(count)
            if command != kind or item["param1"] != wanted:
                raise Refused(f"fence item {number}: another polygon begins")
            _frame(number, place)  # a place at all
            waiting.append(place)
            if len(waiting) == wanted:
                cell = round(place[0] * 50.0), round(place[1] * 50.0)  # of 2 km, or less
                frame = frames.setdefault(cell, _frame(number, place))
                corners = tuple(frame.to_local(*corner) for corner in waiting)
                reach = 1.0 + 1.001 * max(math.dist(corners[-1], corner) for corner in corners)
                edges = tuple(zip(corners, (*corners[1:], corners[0]), strict=True))
                areas.append(_Area(_POLYGONS[command], frame, _space(*place), reach, edges))
                waiting = []
            continue
        if command == MavCommand.NAV_FENCE_RETURN_POINT and not waiting:
            continue  # no area: the first item of each fence of MAVProxy and Mission Planner
        if waiting or command not in _CIRCLES:
            why = f"fence item {number}, {command_name(command)}: it is no area, take it out"
            raise Refused(why, MissionResult.UNSUPPORTED)
        radius = float(item["param1"])
        if not math.isfinite(radius) or radius < 0.0:
            raise Refused(f"fence item {number}: radius {radius:g} m")
        if radius > 0.0:  # how programs write "none"
            areas.append(_Area(_CIRCLES[command], _frame(number, place), _space(*place), radius))
    if waiting:
        raise Refused("a polygon of the fence is incomplete")
    return Fence(tuple(areas))


def _frame(number: int, place: tuple[float, float]) -> LocalFrame:
    try:
        return LocalFrame(*place)
    except ValueError:
        raise Refused(f"fence item {number}: no such place") from None
