"""Parts of a plan of waypoints: points, the actions at them, and the choices for the whole.

Degrees, metres and seconds. Each value is kept as the wire will carry it (whole degrees, single
precision, milliseconds), so that a plan compares equal to itself after a download.
:mod:`m100link.missions.checks` decides for the plan as a whole whether it may be flown.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import KW_ONLY, dataclass
from enum import IntEnum
from itertools import pairwise
from struct import Struct
from typing import Any, Self

from m100link.errors import UsageError
from m100link.geodesy import LocalFrame

_SINGLE = Struct("<f")
_COORDINATE_DECIMALS = 12  # 0.1 µm, far enough apart that radians and back give the same degrees


class Heading(IntEnum):
    """Where the nose points during the mission; the numbers of the wire."""

    ALONG_PATH = 0
    """To where it flies."""
    AS_AT_START = 1
    """As it was when the mission started."""
    BY_RC = 2
    """As the pilot's yaw stick says."""
    BY_WAYPOINT = 3
    """From the heading of one waypoint to that of the next."""


class Trace(IntEnum):
    """How waypoints are passed; the numbers of the wire."""

    STOP_AT_POINTS = 0
    """It stops at each, turns, and does the actions."""
    COORDINATED_TURNS = 1
    """It rounds each by its ``damping``, never flies through it, and does no actions."""


class AtEnd(IntEnum):
    """The action of the aircraft after the last waypoint; the numbers of the wire."""

    HOVER = 0
    """It hovers there; the mission is over."""
    GO_HOME = 1
    """It flies home and lands."""
    LAND = 2
    """It lands there."""
    FIRST_POINT = 3
    """It flies straight to the first waypoint and hovers."""
    ENDLESS = 4
    """It stays in the mission, and the pilot's stick pulled back flies the way again, backwards."""


class OnRCLoss(IntEnum):
    """The action of a mission when the aircraft loses the RC; the numbers of the wire."""

    FAILSAFE = 0
    """It is broken off, and the aircraft returns home."""
    CONTINUE = 1
    """It goes on to its end, without a pilot who could take over."""


CHOICES: dict[str, type[IntEnum]] = {
    "heading": Heading,
    "trace": Trace,
    "at_end": AtEnd,
    "on_rc_loss": OnRCLoss,
}
"""The choices for the whole, by the names of their fields."""


def number(value: object) -> float | None:
    """A value as a number; None if it is not one (text is not, True is not)."""
    if isinstance(value, str | bytes | bool):
        return None
    try:
        return float(value)  # type: ignore[arg-type] # what cannot be converted is what is asked
    except (TypeError, ValueError, OverflowError):
        return None


def single(value: float) -> float:
    """The nearest number of single precision, or ``OverflowError``."""
    nearest: float = _SINGLE.unpack(_SINGLE.pack(value))[0]
    return nearest


def as_single(value: Any) -> Any:
    """The shortest decimal number that means the same in single precision: 52.3, not 52.29999924.

    It keeps a value that is no number, or too large: the checks of the plan report it.
    """
    found = number(value)
    if found is None or not math.isfinite(found):
        return value
    try:
        wanted = single(found)
    except OverflowError:
        return value
    # Nine digits tell every number of single precision apart.
    shortened = (float(f"{wanted:.{digits}g}") for digits in range(6, 10))
    return next(short for short in shortened if single(short) == wanted)


def as_rounded(value: Any, decimals: int = 0) -> Any:
    """A number with so many decimals, an int for 0 of them; anything else as it is."""
    found = number(value)
    if found is None or not math.isfinite(found):
        return value
    return round(found, decimals) if decimals else round(found)


def as_whole(value: Any) -> Any:
    """A whole number as an int, 3.0 as 3; anything else as it is."""
    found = number(value)
    return int(found) if found is not None and found.is_integer() else value


class WaypointAction:
    """An action at a waypoint: the base of six classes, and so the type of their lists."""

    __slots__ = ()


@dataclass(frozen=True, slots=True)
class Stay(WaypointAction):
    """Hover at the waypoint."""

    seconds: float  #: 0 to 32.767, to the millisecond.

    def __post_init__(self) -> None:
        object.__setattr__(self, "seconds", as_rounded(self.seconds, 3))


@dataclass(frozen=True, slots=True)
class TakePhoto(WaypointAction):
    """Take one photograph."""


@dataclass(frozen=True, slots=True)
class StartVideo(WaypointAction):
    """Start recording video."""


@dataclass(frozen=True, slots=True)
class StopVideo(WaypointAction):
    """Stop recording video."""


@dataclass(frozen=True, slots=True)
class TurnTo(WaypointAction):
    """Turn the nose, in the direction that the waypoint names."""

    heading_deg: float  #: -180 to 180°, 90 is east; whole degrees.

    def __post_init__(self) -> None:
        object.__setattr__(self, "heading_deg", as_rounded(self.heading_deg))


@dataclass(frozen=True, slots=True)
class GimbalPitch(WaypointAction):
    """Turn the camera up or down."""

    pitch_deg: float  #: -90 (straight down) to 0° (level); whole degrees.

    def __post_init__(self) -> None:
        object.__setattr__(self, "pitch_deg", as_rounded(self.pitch_deg))


ACTIONS: dict[str, type[Any]] = {
    "stay": Stay,
    "take_photo": TakePhoto,
    "start_video": StartVideo,
    "stop_video": StopVideo,
    "turn_to": TurnTo,
    "gimbal_pitch": GimbalPitch,
}
"""By their names in files, in the order of their numbers on the wire. Those that have a parameter
have one, of which ``__match_args__`` is the name."""


@dataclass(frozen=True, slots=True)
class Waypoint:
    """A place that the aircraft flies to, and its actions there."""

    latitude_deg: float  #: -89 to 89°, WGS 84, to 1e-12° (0.1 µm).
    longitude_deg: float  #: -180 to 180°, likewise.
    height: float  #: Above the take-off point, -200 to 500 m; single precision.
    _: KW_ONLY
    #: Where the nose points there, -180 to 180°, 90 is east; whole degrees. Flown if the plan says
    #: :attr:`Heading.BY_WAYPOINT`.
    heading_deg: float = 0
    #: How far from the point its corner begins and ends, 0.2 to 1000 m, or 0 for a corner without a
    #: curve. Flown if the plan says :attr:`Trace.COORDINATED_TURNS`, and not at the first and last
    #: point.
    damping: float = 0.0
    #: Of the camera, -90 (straight down) to 0°; whole degrees. Flown if the plan says
    #: ``gimbal_by_waypoint``.
    gimbal_pitch_deg: float = 0
    turn_clockwise: bool = True  #: Direction of the turns at this point, seen from above.
    actions: Sequence[WaypointAction] = ()  #: Actions there, in this order, 15 at most.
    #: How many times the list of actions is gone through, 0 to 15; 0 is once.
    action_repeat: int = 1
    #: Seconds after which what is left of the actions is given up, 0 to 999; None is no limit.
    action_time_limit: float | None = 999

    def __post_init__(self) -> None:
        kept = {
            "latitude_deg": as_rounded(self.latitude_deg, _COORDINATE_DECIMALS),
            "longitude_deg": as_rounded(self.longitude_deg, _COORDINATE_DECIMALS),
            "height": as_single(self.height),
            "heading_deg": as_rounded(self.heading_deg),
            "damping": as_single(self.damping),
            "gimbal_pitch_deg": as_rounded(self.gimbal_pitch_deg),
            "action_repeat": as_whole(self.action_repeat),
            "action_time_limit": as_rounded(self.action_time_limit),
        }
        if isinstance(self.actions, Sequence):
            kept["actions"] = tuple(self.actions)
        for name, value in kept.items():
            object.__setattr__(self, name, value)

    @classmethod
    def along(
        cls,
        track: Iterable[tuple[float, float, float]],
        *,
        frame: LocalFrame,
        every: float | None = None,
        actions: Sequence[WaypointAction] = (),
        damping: float = 0.0,
    ) -> list[Self]:
        """Waypoints along a track such as :func:`m100link.missions.patterns.survey` makes.

        >>> from m100link import TakePhoto, Waypoint
        >>> from m100link.geodesy import LocalFrame
        >>> from m100link.missions.patterns import survey
        >>> lines = survey([(0, 0), (0, 30), (20, 30), (20, 0)], spacing=15, height=12)
        >>> frame = LocalFrame(52.1, 4.31)
        >>> points = Waypoint.along(lines, frame=frame, every=10, actions=[TakePhoto()])
        >>> len(points)
        7

        Args:
            track: North and east in metres in ``frame``, height above the take-off point.
            frame: Where the track counts from, such as ``control.local_frame()``.
            every: Legs are divided evenly into parts of so many metres at most; by default there
                is a waypoint at each point of the track and nowhere else.
            actions: Actions at each of them.
            damping: Of each corner, m.

        Raises:
            UsageError: ``every`` is not more than 0, a point is not three numbers, or ``frame`` is
                not a frame.
        """
        if not isinstance(frame, LocalFrame):
            raise UsageError(
                f"frame is {frame!r}",
                remedy="m100link.geodesy.LocalFrame(latitude_deg, longitude_deg), or "
                "control.local_frame()",
            )
        places = _places(track)
        if every is not None:
            places = _divided(places, every)
        return [
            cls(*frame.to_geodetic(north, east), height, damping=damping, actions=actions)
            for north, east, height in places
        ]


def _places(track: Iterable[tuple[float, float, float]]) -> list[tuple[float, float, float]]:
    if not isinstance(track, Iterable):
        raise UsageError(f"the track is {track!r}", remedy="points (north, east, height) in metres")
    made = []
    for index, point in enumerate(track):
        try:
            north, east, up = point
            made.append((float(north), float(east), float(up)))
        except (TypeError, ValueError):
            raise UsageError(
                f"point {index} of the track is {point!r}",
                remedy="metres north and east in the frame, and height: (0, 30, 12)",
            ) from None
    return made


def _divided(
    places: Sequence[tuple[float, float, float]], every: float
) -> list[tuple[float, float, float]]:
    if not 0.0 < every < math.inf:
        raise UsageError(f"waypoints cannot be {every:g} m apart", remedy="more than 0")
    made = list(places[:1])
    for here, there in pairwise(places):
        parts = max(1, math.ceil(math.dist(here, there) / every - 1e-9))
        for part in range(1, parts + 1):
            share = part / parts
            north, east, up = (a + share * (b - a) for a, b in zip(here, there, strict=True))
            made.append((north, east, up))
    return made


@dataclass(frozen=True, slots=True)
class PlanValues:
    """The values of a plan, to be read only; see :class:`m100link.WaypointPlan`."""

    waypoints: Sequence[Waypoint]
    _: KW_ONLY
    speed: float = 5.0
    max_speed: float = 10.0
    heading: Heading = Heading.ALONG_PATH
    trace: Trace = Trace.STOP_AT_POINTS
    at_end: AtEnd = AtEnd.HOVER
    on_rc_loss: OnRCLoss = OnRCLoss.FAILSAFE
    gimbal_by_waypoint: bool = False
    repeat: int = 1
    take_off: bool = False
