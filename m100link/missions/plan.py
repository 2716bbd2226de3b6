"""A mission along waypoints, as a value."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import accumulate
from typing import TYPE_CHECKING, Any, Self

from m100link.geodesy import LocalFrame, MapView, distance_m, svg_dot, svg_line, svg_text
from m100link.geodesy import svg as drawing
from m100link.missions.checks import (
    HOVER_MINUTES,
    PlanEstimate,
    estimate,
    leg_lengths,
    problems,
    remarks,
    wrong,
)
from m100link.missions.waypoint import (
    AtEnd,
    GimbalPitch,
    Heading,
    OnRCLoss,
    PlanValues,
    StartVideo,
    Stay,
    StopVideo,
    TakePhoto,
    Trace,
    TurnTo,
    Waypoint,
    WaypointAction,
    as_single,
    as_whole,
)

if TYPE_CHECKING:
    from pathlib import Path

    from m100link.protocol.commands.waypoint import WaypointMission, WaypointPoint

__all__ = [
    "AtEnd",
    "GimbalPitch",
    "Heading",
    "OnRCLoss",
    "PlanEstimate",
    "StartVideo",
    "Stay",
    "StopVideo",
    "TakePhoto",
    "Trace",
    "TurnTo",
    "Waypoint",
    "WaypointAction",
    "WaypointPlan",
]


@dataclass(frozen=True, slots=True)
class WaypointPlan(PlanValues):
    """A mission along waypoints, checked as a whole; firmware 3.1 flies it by itself.

    >>> from m100link import AtEnd, GimbalPitch, TakePhoto, Waypoint, WaypointPlan
    >>> plan = WaypointPlan(
    ...     [
    ...         Waypoint(52.1, 4.31, height=20),
    ...         Waypoint(52.1003, 4.31, height=25, actions=[GimbalPitch(-60), TakePhoto()]),
    ...     ],
    ...     speed=5,
    ...     at_end=AtEnd.GO_HOME,
    ... )
    >>> round(plan.length_m, 1)
    33.8

    What cannot be flown is no plan:

    >>> WaypointPlan([Waypoint(52.1, 4.31, height=20), Waypoint(52.2, 4.31, height=900)])
    Traceback (most recent call last):
    ...
    m100link.errors.BadPlan: waypoint 1: height 900 is above 500 m
      what to do:   -200 to 500 m above the take-off point

    Attributes:
        waypoints: 2 to 99 of them, in the order in which they are flown. Neighbours are 2 to 2000 m
            apart, in three dimensions; the way is 30 km long at most.
        speed: Along the way, m/s, up to ``max_speed``. The pilot's pitch stick adds to it. With 0
            only the stick moves the aircraft; less than 0 lets it hover at the first waypoint until
            the stick gives speed.
        max_speed: Limit of speed and stick together, 2 to 15 m/s.
        heading: Where the nose points.
        trace: Whether it stops at the waypoints or rounds them.
        at_end: Action after the last waypoint.
        on_rc_loss: Action when the RC is lost. Nothing but the name flies on.
        gimbal_by_waypoint: Whether the camera's pitch changes from waypoint to waypoint.
        repeat: How many times the way is flown, 1 or 2.
        take_off: Whether its start on the ground takes off first. It is no part of the commands
            that upload a plan: one that was downloaded has False.

    Raises:
        BadPlan: The aircraft would refuse it; the first problem, with ``others``.
    """

    def __post_init__(self) -> None:
        if not isinstance(self.waypoints, Iterable):
            raise wrong("waypoints", self.waypoints, f"is {self.waypoints!r}", "a list of Waypoint")
        kept: dict[str, Any] = {
            "waypoints": tuple(self.waypoints),
            "speed": as_single(self.speed),
            "max_speed": as_single(self.max_speed),
            "repeat": as_whole(self.repeat),
        }
        for name, value in kept.items():
            object.__setattr__(self, name, value)
        found = list(problems(self))
        if found:
            found[0].others = tuple(found[1:])
            raise found[0]

    @property
    def length_m(self) -> float:
        """From the first waypoint to the last, once, climbs included, m."""
        return sum(leg_lengths(self.waypoints))

    @property
    def heights(self) -> tuple[float, float]:
        """The lowest and the highest, m above the take-off point."""
        found = [waypoint.height for waypoint in self.waypoints]
        return min(found), max(found)

    def farthest_m(self, latitude_deg: float, longitude_deg: float) -> float:
        """Horizontal distance of the waypoint that is farthest from a place, m."""
        return max(
            distance_m(latitude_deg, longitude_deg, point.latitude_deg, point.longitude_deg)
            for point in self.waypoints
        )

    def estimate(
        self, *, home: tuple[float, float] | None = None, hover_minutes: float = HOVER_MINUTES
    ) -> PlanEstimate:
        """How long it takes and how much of a battery, roughly; nothing of it is measured.

        It flies at ``speed``, climbs and descends at 3 m/s at most, turns at 45°/s; a stop costs
        2 s and 0.3 s for each m/s, a photograph 1.5 s. Flights of the virtual aircraft take as long
        within 15 %. A full battery lasts for ``hover_minutes``.

        Args:
            home: Latitude and longitude of the take-off point, °: with it the way to the first
                waypoint counts, and the way home if that is how the plan ends.
            hover_minutes: How long a full battery carries the aircraft: DJI says 22 for a TB47D and
                no payload, 17 with 500 g, 13 with 1 kg.

        Raises:
            UsageError: ``hover_minutes`` is not more than 0.
        """
        return estimate(self, home=home, hover_minutes=hover_minutes)

    def remarks(self) -> list[str]:
        """Legal surprises of the plan: values that are ignored, actions that are cut off."""
        return list(remarks(self))

    def _repr_svg_(self) -> str:
        """The picture for a notebook: the path from above, and its heights."""
        return svg(self)

    def to_json(self) -> str:
        """As JSON: ``"format"``, ``"version"`` and the fields by the names that they have here."""
        from m100link.missions import document

        return document.to_json(self)

    @classmethod
    def from_json(cls, text: str | bytes) -> Self:
        """Read what :meth:`to_json` wrote, or somebody by hand.

        Raises:
            BadPlan: It is not such a file, a field is unknown, or the aircraft would refuse it.
        """
        from m100link.missions import document

        return cls(**document.from_json(document.load_object(text)))

    def to_qgroundcontrol(self) -> str:
        """As a ``.plan`` of QGroundControl.

        Its items are the nearest that MAVLink has. The fields that MAVLink lacks (``max_speed``,
        ``on_rc_loss``, curves and more) stand beside them, for :meth:`from_qgroundcontrol`; other
        programs do not see them.
        """
        from m100link.missions import qgroundcontrol

        return qgroundcontrol.to_text(self)

    @classmethod
    def from_qgroundcontrol(
        cls,
        text: str | bytes,
        *,
        home_altitude: float | None = None,
        leave_out: Collection[int | str] = (),
    ) -> Self:
        """Read a ``.plan`` of QGroundControl: waypoints, photographs, videos, gimbal, surveys.

        A take-off becomes ``take_off`` and the first waypoint, return and landing become
        ``at_end``. It stops at every waypoint. A file of :meth:`to_qgroundcontrol` that
        nobody changed is read exactly.

        Args:
            text: The file.
            home_altitude: Of the take-off point above sea level, m, for heights that count from
                there; without it they are refused.
            leave_out: Items that may be left out: by their number in MAVLink (530 sets the camera),
                complex items by their name, ``"geoFence"`` and ``"rallyPoints"``.

        Raises:
            BadPlan: It is not such a file, or an item is nothing that the M100 flies; it is named
                by its number, such as ``item 3``, or ``item 3.12`` inside of a survey.
        """
        from m100link.missions import document, qgroundcontrol

        found = document.load_object(text)
        written = qgroundcontrol.extra_of(found)
        if written is not None:
            plan = cls(**written)
            made = qgroundcontrol.document_of(plan)
            # Of a file that was changed in QGroundControl the items count: its user saw those. A
            # fence that was drawn beside them is refused, because nothing here would keep it.
            if made["mission"] == found.get("mission"):
                qgroundcontrol.refuse_fences(found, leave_out)
                return plan
        return cls(
            **qgroundcontrol.from_document(found, home_altitude=home_altitude, leave_out=leave_out)
        )

    @classmethod
    def read(
        cls,
        path: str | Path,
        *,
        home_altitude: float | None = None,
        leave_out: Collection[int | str] = (),
    ) -> Self:
        """Read a file: JSON of :meth:`to_json` or a ``.plan``, whichever it is.

        Args:
            path: The file.
            home_altitude: See :meth:`from_qgroundcontrol`.
            leave_out: See :meth:`from_qgroundcontrol`.

        Raises:
            BadPlan: It cannot be read, is neither of them, or the aircraft would refuse it.
        """
        from m100link.missions import document

        return cls.parse(document.read(path), home_altitude=home_altitude, leave_out=leave_out)

    @classmethod
    def parse(
        cls,
        text: str | bytes,
        *,
        home_altitude: float | None = None,
        leave_out: Collection[int | str] = (),
    ) -> Self:
        """As :meth:`read`, of what such a file holds."""
        from m100link.missions import document

        if document.is_qgroundcontrol(text):
            return cls.from_qgroundcontrol(text, home_altitude=home_altitude, leave_out=leave_out)
        return cls.from_json(text)

    def write(self, path: str | Path) -> None:
        """Write a file: for QGroundControl if its name ends in ``.plan``, else JSON.

        Raises:
            BadPlan: It cannot be written.
        """
        from m100link.missions import document

        is_for_qgroundcontrol = document.is_named_plan(path)
        document.write(path, self.to_qgroundcontrol() if is_for_qgroundcontrol else self.to_json())

    def to_wire(self) -> tuple[WaypointMission, tuple[WaypointPoint, ...]]:
        """The commands 0x03/0x10 and 0x03/0x11 that upload it.

        Values are those that an aircraft reads out of the bytes: a download compares equal.
        """
        from m100link.missions import wire  # with its commands, which only a flight needs

        return wire.to_wire(self)

    @classmethod
    def from_wire(cls, mission: WaypointMission, points: Iterable[WaypointPoint]) -> Self:
        """The plan that such commands upload; points in any order.

        It leaves out values that the aircraft ignores: the focus, actions behind ``has_action`` 0,
        a ``yaw_mode`` of 4 (DJI's ROS demo; the same as 0).

        Raises:
            BadPlan: A point is missing, or the aircraft would refuse it.
        """
        from m100link.missions import wire

        return cls(**wire.from_wire(mission, points))


# -- a plan as a picture, for notebooks and pages; it takes the colours of what it stands in -------


_WIDTH, _MAP, _PROFILE, _EDGE = 480.0, 320.0, 90.0, 28.0
_NAMED = 30  # so many waypoints have room for their numbers


def svg(plan: PlanValues) -> str:
    """The way from above, north up and equal scales, and its heights over the way."""
    first = plan.waypoints[0]
    frame = LocalFrame(first.latitude_deg, first.longitude_deg)
    places = [frame.to_local(point.latitude_deg, point.longitude_deg) for point in plan.waypoints]
    parts = [*_from_above(plan, places), *_from_the_side(plan)]
    return drawing((_WIDTH, _MAP + _PROFILE), f"A plan of {len(places)} waypoints", parts)


def _scaled(values: Sequence[float], begin: float, end: float) -> list[float]:
    low, high = min(values), max(values)
    span = high - low or 1.0
    return [begin + (value - low) / span * (end - begin) for value in values]


def _from_above(plan: PlanValues, places: Sequence[tuple[float, float]]) -> Iterator[str]:
    view = MapView(places, (_WIDTH, _MAP), _EDGE)
    spots = [view.spot(*place) for place in places]
    yield svg_line(spots)
    for index, (spot, point) in enumerate(zip(spots, plan.waypoints, strict=True)):
        has_photo = any(isinstance(action, TakePhoto) for action in point.actions)
        fill = "currentColor" if has_photo else "none"
        yield svg_dot(spot, 4, fill, title=f"{index}: {point.height:g} m")
        if len(spots) <= _NAMED or index in (0, len(spots) - 1):
            yield svg_text((spot[0] + 6, spot[1] - 5), str(index))
    yield view.bar(8, _MAP - 2, 100)
    yield svg_text((_WIDTH - 8, 14), "N ↑", "end")
    if plan.trace is Trace.COORDINATED_TURNS:
        yield svg_text((8, 14), "corners are rounded")


def _from_the_side(plan: PlanValues) -> Iterator[str]:
    flown = list(accumulate(leg_lengths(plan.waypoints), initial=0.0))
    heights = [point.height for point in plan.waypoints]
    top, bottom = _MAP + 16, _MAP + _PROFILE - 18
    across = _scaled(flown, 44, _WIDTH - 8)
    up = _scaled(heights, bottom, top) if min(heights) < max(heights) else [top] * len(heights)
    yield svg_line(zip(across, up, strict=True))
    yield svg_text((40, top + 4), f"{max(heights):g} m", "end")
    if min(heights) < max(heights):
        yield svg_text((40, bottom + 4), f"{min(heights):g} m", "end")
    yield svg_text((_WIDTH - 8, _MAP + _PROFILE - 4), f"{flown[-1]:.0f} m", "end")
