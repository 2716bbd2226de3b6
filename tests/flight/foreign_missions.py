"""Missions as the foreign aircraft flies them: from the documents' layouts, by straight lines.

It judges what a host sends and when, not how well an aircraft flies. No clock and no line.
"""

from __future__ import annotations

import math
import struct
from typing import NamedTuple

LATITUDE_DEG, LONGITUDE_DEG, EARTH_M = 47.0, 8.0, 6_378_137.0
COS_LATITUDE = math.cos(math.radians(LATITUDE_DEG))
CLIMB_M_S = 4.0
STANDBY = 1
NO_AUTHORITY, NOT_RUNNING, RUNNING, OTHER = 0xD1, 0xD4, 0xD5, 0xD7
BAD_MISSION, NO_MISSION, NO_POINTS, ALREADY, NOT_STARTED = 0xE0, 0xEA, 0xEB, 0xEC, 0xED


class Order(NamedTuple):
    """A command of set 0x03 that arrived, and what it was answered."""

    number: int
    value: bytes
    answer: int | None


class ForeignMissions:
    """What the aircraft flies by itself.

    Attributes:
        north, east, height: Where it is, m from the start.
        flying: ``"waypoint"``, ``"hotpoint"``, ``"follow"`` or nothing.
        is_paused: It hovers in its mission.
        orders: Every command of the set, oldest first.
        actions: Index, action and parameter of each that was done.
        reached: Waypoints in the order in which they were reached.
        flown_m: Metres flown by missions.
        is_pushing: Whether the box in the assistant is ticked.
        answers: Codes by command id that are answered whatever was asked.
    """

    def __init__(self) -> None:
        self.north = self.east = 0.0
        self.height = 5.0
        self.flying = ""
        self.is_paused = False
        self.orders: list[Order] = []
        self.actions: list[tuple[int, int, int]] = []
        self.reached: list[int] = []
        self.flown_m = 0.0
        self.is_pushing = True
        self.answers: dict[int, int] = {}
        self.mission = b""
        self.points: dict[int, bytes] = {}
        self.speed = 0.0
        self.target = 0
        self.waits = 0.0
        self.circle: tuple[float, ...] = ()
        self.angle = 0.0
        self.goal = self.offset = (0.0, 0.0)
        self._last = (0, 0, 0)  # kind, flags, reason of the one before
        self._pushes: list[bytes] = []
        self._steps = 0

    def place(self, latitude: float, longitude: float) -> tuple[float, float]:
        """Metres north and east of the start."""
        return (
            (latitude - math.radians(LATITUDE_DEG)) * EARTH_M,
            (longitude - math.radians(LONGITUDE_DEG)) * EARTH_M * COS_LATITUDE,
        )

    # -- orders ----------------------------------------------------------------------------------

    def execute(self, number: int, value: bytes, *, is_ours: bool, status: int) -> bytes | None:
        """Obey a command, and give its ack."""
        code = self.answers.get(number)
        if code is None:
            code = self._obey(number, value, is_ours=is_ours, status=status)
        self.orders.append(Order(number, value, code))
        if code is None:
            return None
        return bytes([code]) + self._tail(number, value)

    def _tail(self, number: int, value: bytes) -> bytes:
        if number == 0x11:
            return value[:1]
        if number == 0x14:
            return self.mission or bytes(51)
        if number == 0x15:
            return self.points.get(value[0], bytes(90))
        if number in (0x16, 0x17):
            return struct.pack("<f", self.speed)
        if number == 0x20:
            return struct.pack("<f", 500.0)
        if number == 0x26:
            return self._circle_bytes()
        return b""

    def _circle_bytes(self) -> bytes:
        if not self.circle:
            return bytes(51)
        return struct.pack("<BddddfBBB11x", 0, *self.circle[:5], 1, 4, 1)

    def _obey(self, number: int, value: bytes, *, is_ours: bool, status: int) -> int | None:
        if number in (0x14, 0x15, 0x17, 0x26):
            return self._look_up(number, value)
        if number in (0x23, 0x24, 0x25, 0x33):
            self._unconfirmed(number, value)
            return None
        if not is_ours and number not in (0x11, 0x16):
            return NO_AUTHORITY
        if number in (0x10, 0x11, 0x12, 0x13, 0x16):
            return self._waypoint(number, value, status)
        kind = "hotpoint" if number < 0x30 else "follow"
        if number in (0x20, 0x30):
            return self._begin(kind, value, status)
        if self.flying != kind:
            return NOT_RUNNING
        if number in (0x21, 0x31):
            self._end(0)
        else:
            self.is_paused = value == b"\0"
        return 0

    def _look_up(self, number: int, value: bytes) -> int:
        if number == 0x26:
            return 0 if self.flying == "hotpoint" else NOT_RUNNING
        if not self.mission:
            return NO_MISSION
        return NO_POINTS if number == 0x15 and value[0] not in self.points else 0

    def _waypoint(self, number: int, value: bytes, status: int) -> int:
        if number == 0x10:
            if self.flying:
                return RUNNING
            self.points.clear()
            is_good = 2 <= value[0] <= 99
            self.mission = value if is_good else b""
            self.speed = struct.unpack_from("<f", value, 5)[0]
            return 0 if is_good else BAD_MISSION
        if number == 0x11:
            return self._add_point(value)
        if number == 0x12 and value == b"\0":
            return self._start(status)
        if self.flying != "waypoint":
            return NO_MISSION if number == 0x16 else NOT_STARTED
        if number == 0x12:
            self._end(0)
            self.mission = b""
        elif number == 0x16:
            self.speed = struct.unpack("<f", value)[0]
        elif self.is_paused is (value == b"\0"):
            return ALREADY
        else:
            self.is_paused = value == b"\0"
        return 0

    def _add_point(self, value: bytes) -> int:
        if not self.mission:
            return NO_MISSION
        if value[0] >= self.mission[0]:
            return 0xE4
        self.points[value[0]] = value
        if len(self.points) == self.mission[0]:
            self._pushes.append(b"\x02\x04" + struct.pack("<BBHxx", 0, 1, 60))
        return 0

    def _start(self, status: int) -> int:
        if not self.mission or len(self.points) < self.mission[0]:
            return NO_POINTS
        if self.flying:
            return ALREADY if self.flying == "waypoint" else OTHER
        if status == STANDBY:
            return 0xDA
        self.flying, self.target, self.is_paused, self.waits = "waypoint", 0, False, 0.0
        return 0

    def _begin(self, kind: str, value: bytes, status: int) -> int:
        if self.flying:
            return RUNNING if self.flying == kind else OTHER
        if status == STANDBY:
            return 0xDA
        if kind == "hotpoint":
            _, *self_circle = struct.unpack_from("<Bddddf", value)
            self.circle = tuple(self_circle)
            self.angle = 0.0
        else:
            self.goal = self.place(*struct.unpack_from("<dd", value, 2))
            self.offset = self.north - self.goal[0], self.east - self.goal[1]
        self.flying, self.is_paused = kind, False
        return 0

    def _unconfirmed(self, number: int, value: bytes) -> None:
        if number == 0x33 and self.flying == "follow":
            self.goal = self.place(*struct.unpack_from("<dd", value))
        elif self.flying == "hotpoint" and number == 0x23:
            self.circle = (*self.circle[:4], struct.unpack_from("<f", value, 1)[0])
        elif self.flying == "hotpoint" and number == 0x24:
            radius = struct.unpack("<f", value)[0]
            self.circle = (*self.circle[:3], radius, self.circle[4])

    # -- flight ----------------------------------------------------------------------------------

    def break_off(self, reason: int) -> None:
        """Something ends what flies."""
        if self.flying:
            self._end(1, reason)

    def _end(self, flags: int, reason: int = 0) -> None:
        kind = {"waypoint": 1, "hotpoint": 2, "follow": 3}[self.flying]
        self._last = kind, flags, reason
        self.flying, self.is_paused = "", False

    def advance(self, seconds: float) -> str:
        """Time passes. Gives ``"land"`` when the plan ends so."""
        self._steps += 1
        if not self.flying or self.is_paused:
            return ""
        if self.flying == "waypoint":
            return self._fly_way(seconds)
        if self.flying == "hotpoint":
            latitude, longitude, height, radius, rate = self.circle
            north, east = self.place(latitude, longitude)
            self.angle += math.radians(rate) * seconds
            aim = north + radius * math.cos(self.angle), east + radius * math.sin(self.angle)
            self._move(*aim, height, 10.0 * seconds)
        else:
            aim = self.goal[0] + self.offset[0], self.goal[1] + self.offset[1]
            self._move(*aim, self.height, 10.0 * seconds)
        return ""

    def _move(self, north: float, east: float, height: float, most: float) -> bool:
        """Fly there, as far as it gets. Gives whether it is there."""
        way = north - self.north, east - self.east
        distance = math.hypot(*way)
        part = min(1.0, most / distance) if distance > 0 else 0.0
        self.north, self.east = self.north + part * way[0], self.east + part * way[1]
        self.flown_m += part * distance
        climb = height - self.height
        self.height += math.copysign(min(abs(climb), CLIMB_M_S * most / 5.0), climb)
        return distance <= most and abs(height - self.height) < 1e-6

    def _fly_way(self, seconds: float) -> str:
        if self.waits > 0.0:
            self.waits -= seconds
            if self.waits > 0.0:
                return ""
            self._tell_reached(6)
            return self._go_on()
        point = self.points[self.target]
        aim = self.place(*struct.unpack_from("<dd", point, 1))
        height = struct.unpack_from("<f", point, 17)[0]
        if self._move(*aim, height, abs(self.speed) * seconds):
            self.reached.append(self.target)
            self._tell_reached(4)
            self.waits = 0.2 + self._act(point)
        return ""

    def _act(self, point: bytes) -> float:
        """Do the actions. Gives the seconds that they take."""
        if not point[38]:
            return 0.0
        count, seconds = point[41] & 15, 0.0
        parameters = struct.unpack_from("<16h", point, 58)
        for action, parameter in zip(point[42 : 42 + count], parameters, strict=False):
            self.actions.append((self.target, action, parameter))
            seconds += parameter / 1000.0 if action == 0 else 0.5
        return seconds

    def _tell_reached(self, status: int) -> None:
        self._pushes.append(b"\x02\x04" + bytes([2, self.target, status, 0, 0, 0]))

    def _go_on(self) -> str:
        self.target += 1
        if self.target < self.mission[0]:
            return ""
        self._pushes.append(b"\x02\x04" + bytes([1, 0, 0, 0, 0, 0]))
        at_end = self.mission[9]
        self.target -= 1
        if at_end == 4:
            self.waits = math.inf
            return ""
        self._end(0)
        self.mission = b""
        return "land" if at_end in (1, 2) else ""

    # -- pushes ----------------------------------------------------------------------------------

    def pushes(self) -> list[bytes]:
        """The pushes that are due: events, and the status at 10 Hz."""
        waiting, self._pushes = self._pushes, []
        if self._steps % 5 == 0:
            waiting.append(b"\x02\x03" + self._status())
        return waiting if self.is_pushing else []

    def _status(self) -> bytes:
        if self.flying == "waypoint":
            return bytes([1, self.target, 1, 0, 0, 0])
        if self.flying == "hotpoint":
            north, east = self.place(*self.circle[:2])
            distance = math.hypot(self.north - north, self.east - east)
            status, rate = 2 if self.is_paused else 1, int(self.circle[4] * 10)
            return struct.pack("<BBHBB", 2, status, min(65535, int(distance * 100)), 0, rate)
        if self.flying == "follow":
            return bytes([3, 0, 0, 0, 0, 0])
        return bytes([0, *self._last, 0, 0])
