"""Missions for tests: points in metres from the aircraft, flown to their end on virtual time."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import Any

from m100link.geodesy import LocalFrame
from m100link.protocol.codes import MissionCode
from m100link.protocol.commands.hotpoint import HotpointStart
from m100link.protocol.commands.missions import Finished, Reached, Uploaded, WaypointEvent
from m100link.protocol.commands.waypoint import WaypointMission, WaypointPoint, WaypointStartStop
from m100link.sim.vehicle.missions.route import MissionSettings
from tests.sim.host import Host, aircraft

SITE = LocalFrame(22.5431, 113.9589)
OK = MissionCode.SUCCESS
SQUARE = [(0.0, 0.0, 10.0), (20.0, 0.0, 10.0), (20.0, 20.0, 15.0), (0.0, 20.0, 12.0)]

Track = list[tuple[float, float, float]]


def host(settings: dict[str, Any] | None = None, **missions: Any) -> Host:
    """An aircraft of firmware 3.1 that is activated and gave control away, with some settings."""
    changed = (settings or {}) | {"missions": MissionSettings(**missions)}
    return Host(aircraft(firmware="3.1", settings=changed)).ready()


def radians_at(north: float, east: float) -> tuple[float, float]:
    latitude, longitude = SITE.to_geodetic(north, east)
    return math.radians(latitude), math.radians(longitude)


def point(index: int, north: float, east: float, up: float, **fields: Any) -> WaypointPoint:
    return WaypointPoint(index, *radians_at(north, east), up, **fields)


def doing(*actions: tuple[int, int], limit: int = 999, repeat: int = 1) -> dict[str, Any]:
    """The fields of a point that does something."""
    numbers, parameters = ([pair[k] for pair in actions] for k in (0, 1))
    spare = [0] * (16 - len(actions))
    return {
        "has_action": 1,
        "action_count": len(actions),
        "action_repeat": repeat,
        "action_time_limit": limit,
        "actions": tuple(numbers + spare),
        "parameters": tuple(parameters + spare),
    }


def hotpoint(north: float = 0.0, east: float = 0.0, **fields: Any) -> HotpointStart:
    latitude, longitude = radians_at(north, east)
    changed: dict[str, Any] = {"altitude": 20.0, "radius": 10.0, "angular_rate": 15.0} | fields
    return HotpointStart(latitude, longitude, **changed)


def upload(
    host: Host, points: list[WaypointPoint], **fields: Any
) -> tuple[MissionCode, list[MissionCode]]:
    """Upload a mission; its code and those of the points."""
    changed: dict[str, Any] = {"max_speed": 10.0, "idle_speed": 5.0}
    mission = WaypointMission(len(points), **changed | fields)
    return host.ask(mission), [host.ask(point).code for point in points]


def begin(host: Host, points: list[WaypointPoint], **fields: Any) -> None:
    """Upload a mission and start it."""
    assert upload(host, points, **fields) == (OK, [OK] * len(points))
    assert host.ask(WaypointStartStop(0)) == OK


def fly(host: Host, seconds: float = 600.0, step: float = 0.05) -> Track:
    """Let the mission fly to its end; where the aircraft was."""
    track = []
    end = host.now + seconds
    while host.vehicle.missions.running is not None:
        assert host.now < end, "the mission does not end"
        host.wait(step, step)
        track.append(where(host))
    return track


def where(host: Host) -> tuple[float, float, float]:
    motion = host.motion
    return motion.north, motion.east, motion.height


def nearest(track: Track, place: tuple[float, float, float]) -> float:
    """How near a track came to a place."""
    return min(math.dist(place, at) for at in track)


def farthest_beside(track: Track, line: Sequence[tuple[float, float, float]]) -> float:
    """How far a track went from a broken line."""
    return max(min(_beside(at, a, b) for a, b in pairwise(line)) for at in track)


def _beside(
    at: tuple[float, float, float], a: tuple[float, float, float], b: tuple[float, float, float]
) -> float:
    # Written out: it is asked a million times.
    x, y, z = at[0] - a[0], at[1] - a[1], at[2] - a[2]
    u, v, w = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    square = u * u + v * v + w * w
    share = max(0.0, min(1.0, (x * u + y * v + z * w) / square)) if square else 0.0
    return math.dist((x, y, z), (share * u, share * v, share * w))


def events(host: Host) -> list[Uploaded | Finished | Reached]:
    """The waypoint events that were pushed."""
    found = []
    for received in host.pushes(0x04):
        event = WaypointEvent.parse(received.frame.data[2:], host.profile).event
        assert isinstance(event, Uploaded | Finished | Reached)
        found.append(event)
    return found


def reached(host: Host) -> list[tuple[int, int]]:
    """Index and status of each event that a point was reached."""
    return [(event.index, event.status) for event in events(host) if isinstance(event, Reached)]
