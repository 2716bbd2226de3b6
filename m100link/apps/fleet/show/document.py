"""Shows as JSON: who flies where, and when.

What stands in a file and is not read would be flown without being seen, so nothing is passed over:
a field that does not exist, or stands there twice, is refused by its name.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

from m100link.apps.fleet.show.track import BadShow, TimedPoint, TimedTrack
from m100link.errors import BadPlan
from m100link.geodesy import LocalFrame
from m100link.missions.document import load_object
from m100link.missions.files import read as read_file

__all__ = ["FORMAT", "MAX_AIRCRAFT", "VERSION", "Show"]

FORMAT = "m100link show"
VERSION = 1
MAX_AIRCRAFT = 200
"""Every two of them are compared."""

_FIELDS = ("format", "version", "name", "origin", "least_distance_m", "tube_m", "aircraft")
_AIRCRAFT_FIELDS = ("name", "ground_m", "heading_deg", "waypoints")
_BY_METRES = ("at", "north", "east", "height")
_BY_DEGREES = ("at", "latitude_deg", "longitude_deg", "height")


@dataclass(frozen=True, slots=True)
class Show:
    """What several aircraft fly together.

    Attributes:
        name: For people.
        tracks: What each of them flies, in the file's order.
        least_distance_m: How near two aircraft may come to each other in the air, m, from centre
            to centre; what GPS is wrong by is not in it.
    """

    name: str
    tracks: tuple[TimedTrack, ...]
    least_distance_m: float = 3.0

    @property
    def duration(self) -> float:
        """Seconds from its beginning until the last aircraft is at its last point."""
        return max(track.end for track in self.tracks)

    @classmethod
    def read(cls, path: str | Path) -> Self:
        """Read a file.

        Raises:
            BadShow: It cannot be read, or is no show.
        """
        try:
            text = read_file(path)
        except BadPlan as error:
            raise BadShow(error.seen, cause=error.cause, remedy=error.remedy) from error
        return cls.parse(text)

    @classmethod
    def parse(cls, text: str | bytes) -> Self:
        """Read what such a file holds.

        Raises:
            BadShow: It is no show: not JSON, a field is missing, unknown or out of its range.
        """
        try:
            found = load_object(text)
        except BadPlan as error:
            raise BadShow(error.seen, cause=error.cause, remedy="give a show as JSON") from error
        return cls(**_values(found))


def _values(found: Mapping[str, Any]) -> dict[str, Any]:
    """Arguments of :class:`Show`."""
    kind = found.get("format"), found.get("version")
    if kind != (FORMAT, VERSION) or isinstance(kind[1], bool):
        raise BadShow(
            f"the format is {_short(kind[0])}, version {_short(kind[1])}",
            cause="the file is something else, or another version of m100link wrote it",
            remedy=f'"format": "{FORMAT}", "version": {VERSION}',
        )
    _refuse_unknown(found, _FIELDS, "the show")
    listed = found.get("aircraft")
    if not isinstance(listed, list) or not 1 <= len(listed) <= MAX_AIRCRAFT:
        raise BadShow(
            f"aircraft is {_short(listed)}",
            remedy=f'"aircraft": a list of 1 to {MAX_AIRCRAFT} objects',
        )
    least = _number(found, "least_distance_m", "the show", 3.0)
    if not 0 < least <= 1000:
        raise BadShow(f"least_distance_m is {least:g}", remedy="more than 0, up to 1000 m")
    name = found.get("name", "")
    if not isinstance(name, str):
        raise BadShow(f"name is {_short(name)}", remedy="a text")
    origin = _origin(found, listed)
    tube = _number(found, "tube_m", "the show", 1.5)
    tracks = tuple(_track(index, one, origin, tube) for index, one in enumerate(listed))
    names = [track.name for track in tracks]
    for one in names:
        if names.count(one) > 1:
            raise BadShow(
                f"{one} stands twice among the aircraft",
                aircraft=(one,),
                remedy="one track for each aircraft, by its name in the fleet",
            )
    return {"name": name, "tracks": tracks, "least_distance_m": least}


def _origin(found: Mapping[str, Any], listed: Sequence[Any]) -> tuple[float, float]:
    """Latitude and longitude where north and east are 0: the file's, else the first waypoint's."""
    origin = found.get("origin")
    if origin is None:
        first = listed[0].get("waypoints") if isinstance(listed[0], dict) else None
        origin = first[0] if isinstance(first, list) and first else None
        if not isinstance(origin, dict) or "latitude_deg" not in origin:
            raise BadShow(
                "the show has no origin",
                cause="where on the earth metres north and east count from is not said",
                remedy='"origin": {"latitude_deg": …, "longitude_deg": …}, or the first waypoint '
                "of the first aircraft in degrees",
            )
        origin = {name: origin.get(name) for name in ("latitude_deg", "longitude_deg")}
    if not isinstance(origin, dict):
        raise BadShow(f"origin is {_short(origin)}", remedy="an object of two numbers")
    _refuse_unknown(origin, ("latitude_deg", "longitude_deg"), "origin")
    latitude = _number(origin, "latitude_deg", "origin")
    longitude = _number(origin, "longitude_deg", "origin")
    if not (abs(latitude) <= 89 and abs(longitude) <= 180):
        raise BadShow(
            f"the origin is {latitude:g}° {longitude:g}°",
            remedy="latitude within ±89°, longitude within ±180°",
        )
    return latitude, longitude


def _track(index: int, found: Any, origin: tuple[float, float], tube: float) -> TimedTrack:
    where = f"aircraft {index}"
    if not isinstance(found, dict) or not isinstance(found.get("name"), str):
        raise BadShow(f"{where} is {_short(found)}", remedy='an object with "name" and "waypoints"')
    where = found["name"] or where
    _refuse_unknown(found, _AIRCRAFT_FIELDS, where)
    listed = found.get("waypoints")
    if not isinstance(listed, list):
        raise BadShow(
            f"{where}: waypoints is {_short(listed)}", remedy='"waypoints": a list of objects'
        )
    frame = LocalFrame(*origin)
    heading = found.get("heading_deg")
    return TimedTrack(
        found["name"],
        origin,
        tuple(_point(f"{where}, point {at}", point, frame) for at, point in enumerate(listed)),
        ground_m=_number(found, "ground_m", where, 0.0),
        heading_deg=None if heading is None else _number(found, "heading_deg", where),
        tube_m=tube,
    )


def _point(where: str, found: Any, frame: LocalFrame) -> TimedPoint:
    if not isinstance(found, dict):
        raise BadShow(f"{where} is {_short(found)}", remedy=f"an object of {', '.join(_BY_METRES)}")
    is_by_degrees = "latitude_deg" in found or "longitude_deg" in found
    _refuse_unknown(found, _BY_DEGREES if is_by_degrees else _BY_METRES, where)
    at, height = _number(found, "at", where), _number(found, "height", where)
    if not is_by_degrees:
        return TimedPoint(at, _number(found, "north", where), _number(found, "east", where), height)
    latitude = _number(found, "latitude_deg", where)
    longitude = _number(found, "longitude_deg", where)
    if not (abs(latitude) <= 89 and abs(longitude) <= 180):
        raise BadShow(
            f"{where} is at {latitude:g}° {longitude:g}°",
            remedy="latitude within ±89°, longitude within ±180°",
        )
    return TimedPoint(at, *frame.to_local(latitude, longitude), height)


def _number(found: Mapping[str, Any], name: str, where: str, default: float | None = None) -> float:
    value = found.get(name, default)
    try:
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise ValueError
        number = float(value)
    except (ValueError, OverflowError):
        number = math.nan
    if not math.isfinite(number):
        missing = "is missing" if name not in found else f"is {_short(value)}"
        raise BadShow(f"{where}: {name} {missing}", remedy="a number")
    return number


def _refuse_unknown(found: Mapping[str, Any], known: Sequence[str], where: str) -> None:
    for name in found:
        if name not in known:
            raise BadShow(
                f"{where}: there is no field {_short(name)}", remedy=f"one of {', '.join(known)}"
            )


def _short(value: object) -> str:
    text = json.dumps(value, ensure_ascii=False, default=repr)
    return text if len(text) <= 40 else f"{text[:37]}..."
