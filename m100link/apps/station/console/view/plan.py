"""A plan that is being drawn: each change makes another draft, and any can be undone.

Pure. A draft may be what the aircraft would refuse, such as one waypoint; :func:`checked` says what
is wrong with it, and at which point.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from itertools import accumulate, pairwise
from typing import Self, TypeGuard

from m100link.apps.station.console.view.texts import Quantity, QuantityKind, Text, Units, tr
from m100link.errors import BadPlan, UsageError
from m100link.geodesy import distance_m
from m100link.missions import waypoint
from m100link.missions.plan import PlanEstimate, WaypointPlan
from m100link.missions.survey import orbit, survey

Place = tuple[float, float]

_MOST_UNDONE = 100
_OF_POINT = re.compile(r"waypoint (\d+): ")


@dataclass(frozen=True, slots=True)
class Draft:
    """The plan as drawn so far. The fields are those of :class:`m100link.WaypointPlan`."""

    points: tuple[waypoint.Waypoint, ...] = ()  # waypoints, in the order in which they are flown
    speed: float = 5.0  # along the way, m/s
    max_speed: float = 10.0  # what speed and stick together never exceed, m/s
    heading: waypoint.Heading = waypoint.Heading.ALONG_PATH  # where the nose points
    trace: waypoint.Trace = waypoint.Trace.STOP_AT_POINTS  # whether it stops at the waypoints
    at_end: waypoint.AtEnd = waypoint.AtEnd.HOVER  # what happens after the last one
    on_rc_loss: waypoint.OnRCLoss = waypoint.OnRCLoss.FAILSAFE  # what happens when the RC is lost
    gimbal_by_waypoint: bool = False  # whether the camera's pitch changes from point to point
    repeat: int = 1  # how many times the way is flown
    take_off: bool = True  # whether a start on the ground takes off first
    area: tuple[Place, ...] = ()  # corners of the area for a survey, latitude and longitude, °

    @classmethod
    def of(cls, plan: WaypointPlan, area: tuple[Place, ...] = ()) -> Self:
        same = {name: getattr(plan, name) for name in _OF_A_PLAN}
        return cls(points=tuple(plan.waypoints), area=area, **same)

    def plan(self) -> WaypointPlan:
        """The plan. Raises ``BadPlan``: the aircraft would refuse it."""
        return WaypointPlan(self.points, **{name: getattr(self, name) for name in _OF_A_PLAN})

    def added(self, place: Place, height: float, after: int | None = None) -> Draft:
        """With a point more: at the end, or after another one."""
        at = len(self.points) if after is None else after + 1
        point = waypoint.Waypoint(*place, height=height)
        return replace(self, points=(*self.points[:at], point, *self.points[at:]))

    def moved(self, index: int, place: Place) -> Draft:
        return self.changed(index, latitude_deg=place[0], longitude_deg=place[1])

    def changed(self, index: int, **values: object) -> Draft:
        """With other values of one point; one that is not there changes nothing."""
        if not 0 <= index < len(self.points):
            return self
        # The plan says what is wrong with a value, whatever it is.
        point = replace(self.points[index], **values)  # type: ignore[arg-type]
        return replace(self, points=(*self.points[:index], point, *self.points[index + 1 :]))

    def removed(self, index: int) -> Draft:
        return replace(self, points=(*self.points[:index], *self.points[index + 1 :]))

    def put(self, index: int, to: int) -> Draft:
        """With a point earlier or later in the order."""
        if not 0 <= index < len(self.points) or not 0 <= to < len(self.points):
            return self
        points = list(self.points)
        points.insert(to, points.pop(index))
        return replace(self, points=tuple(points))

    def cornered(self, place: Place) -> Draft:
        return replace(self, area=(*self.area, place))

    def corner_moved(self, index: int, place: Place) -> Draft:
        if not 0 <= index < len(self.area):
            return self
        return replace(self, area=(*self.area[:index], place, *self.area[index + 1 :]))

    @property
    def outline(self) -> tuple[Place, ...]:
        """The corners of the area; two of them are opposite corners of a rectangle."""
        if len(self.area) != 2:
            return self.area
        (south, west), (north, east) = self.area
        return (south, west), (north, west), (north, east), (south, east)

    def surveyed(
        self,
        *,
        height: float,
        spacing: float,
        angle_deg: float,
        photo_every: float | None,
        start: Place | None,
    ) -> Draft:
        """With lines over the area in place of its points.

        Raises ``UsageError``: it makes no survey, or one that cannot be flown.
        """
        return self._flown_as(
            survey(
                self.outline,
                height=height,
                spacing=spacing,
                angle_deg=angle_deg,
                photo_every=photo_every,
                speed=self.speed,
                start=start,
            )
        )

    def orbited(
        self, *, height: float, radius: float, photo_every: float | None, start: Place | None
    ) -> Draft:
        """With an orbit around the only corner of the area in place of its points.

        Raises ``UsageError``: there is no such corner, or it cannot be flown.
        """
        if len(self.area) != 1:
            raise UsageError(
                f"an orbit has one centre, and the area has {len(self.area)} corners",
                remedy="clear the plan, choose Area, and click the centre",
            )
        return self._flown_as(
            orbit(
                self.area[0],
                height=height,
                radius=radius,
                photo_every=photo_every,
                speed=self.speed,
                start=start,
            )
        )

    def _flown_as(self, plan: WaypointPlan) -> Draft:
        """With the points of a pattern, and what they need."""
        changed = {name: getattr(plan, name) for name in ("heading", "trace", "gimbal_by_waypoint")}
        return replace(self, points=tuple(plan.waypoints), **changed)


_OF_A_PLAN = [one.name for one in fields(Draft) if one.name not in ("points", "area")]


@dataclass(frozen=True, slots=True)
class DraftHistory:
    draft: Draft = field(default_factory=Draft)  # as it is now
    before: tuple[Draft, ...] = ()  # earlier ones, the newest last
    undone: tuple[Draft, ...] = ()  # what can be done again, the newest last

    def done(self, draft: Draft) -> DraftHistory:
        """Another draft; what changes nothing is not remembered."""
        if draft == self.draft:
            return self
        return DraftHistory(draft, (*self.before[1 - _MOST_UNDONE :], self.draft))

    def undo(self) -> DraftHistory:
        if not self.before:
            return self
        return DraftHistory(self.before[-1], self.before[:-1], (*self.undone, self.draft))

    def redo(self) -> DraftHistory:
        if not self.undone:
            return self
        return DraftHistory(self.undone[-1], (*self.before, self.draft), self.undone[:-1])


# -- what is said of it ----------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class PlanNote:
    text: str
    point: int | None = None  # index of the waypoint, None for the whole
    is_error: bool = False  # whether the aircraft would refuse it; otherwise it may surprise


@dataclass(frozen=True, slots=True)
class Checked:
    plan: WaypointPlan | None  # the plan; None if the aircraft would refuse it
    notes: tuple[PlanNote, ...]  # what is wrong, and what may surprise
    estimate: PlanEstimate | None  # of the plan; None without one

    def at(self, point: int) -> tuple[PlanNote, ...]:
        return tuple(note for note in self.notes if note.point == point)


def checked(draft: Draft, home: Place | None = None) -> Checked:
    """The errors of a draft, its possible surprises, and the estimate of its flight from home.

    An empty draft is not wrong.
    """
    if not draft.points:
        return Checked(None, (), None)
    try:
        plan = draft.plan()
    except BadPlan as bad:
        return Checked(None, tuple(_error(one) for one in bad.problems), None)
    notes = []
    for text in plan.remarks():
        found = _OF_POINT.match(text)
        notes.append(PlanNote(text, None if found is None else int(found.group(1))))
    return Checked(plan, tuple(notes), plan.estimate(home=home))


def _error(problem: BadPlan) -> PlanNote:
    remedy = f" ({problem.remedy})" if problem.remedy else ""
    return PlanNote(f"{problem.seen}{remedy}", problem.point, is_error=True)


def profile(points: Sequence[waypoint.Waypoint]) -> list[tuple[float, float]]:
    """Metres along the way, and height above take-off, of each waypoint."""
    steps = [
        distance_m(here.latitude_deg, here.longitude_deg, there.latitude_deg, there.longitude_deg)
        for here, there in pairwise(points)
    ]
    far = accumulate(steps, initial=0.0)
    return [(way, float(point.height)) for way, point in zip(far, points, strict=False)]


# -- actions as a line of text ---------------------------------------------------------------------

_WORDS: dict[str, type[waypoint.WaypointAction]] = {
    "photo": waypoint.TakePhoto,
    "video": waypoint.StartVideo,
    "cut": waypoint.StopVideo,
    "stay": waypoint.Stay,
    "turn": waypoint.TurnTo,
    "pitch": waypoint.GimbalPitch,
}
_WITH_NUMBER = ("stay", "turn", "pitch")


def actions_of(text: str) -> tuple[waypoint.WaypointAction, ...]:
    """The actions that a line of text names: ``pitch -60, photo, stay 2``.

    Raises ``UsageError``: a word that is none, or a number too few or too many.
    """
    found = []
    for part in filter(None, (one.strip() for one in text.split(","))):
        word, _, rest = part.partition(" ")
        kind = _WORDS.get(word)
        try:
            if kind is None or (word in _WITH_NUMBER) != bool(rest):
                raise ValueError
            values = [float(rest)] if rest else []
            if not all(map(math.isfinite, values)):
                raise ValueError
        except ValueError:
            raise UsageError(
                f"{part!r} is not an action",
                remedy="photo, video, cut, stay SECONDS, turn DEGREES, pitch DEGREES, by commas",
            ) from None
        found.append(kind(*values))
    return tuple(found)


def text_of(actions: Sequence[waypoint.WaypointAction]) -> str:
    words = {kind: word for word, kind in _WORDS.items()}
    parts = []
    for action in actions:
        word = words[type(action)]
        match action:
            case waypoint.Stay(number) | waypoint.TurnTo(number) | waypoint.GimbalPitch(number):
                parts.append(f"{word} {number:g}")
            case _:
                parts.append(word)
    return ", ".join(parts)


# -- what the Plan view says of a draft, and of what is uploaded -----------------------------------


def summary_of(draft: Draft, found: Checked) -> Text:
    if not draft.points:
        return tr("plan.empty")
    if found.plan is None or found.estimate is None:
        return tr("plan.not_flown", count=len(draft.points))
    return figures_of(found.plan, found.estimate)


def figures_of(plan: WaypointPlan, estimate: PlanEstimate) -> Text:
    """The figures of a plan, in the same words for one that is drawn, is uploaded, or flies."""
    low, high = map(Quantity.length, plan.heights)
    count, length = len(plan.waypoints), Quantity.length(estimate.length_m)
    if math.isinf(estimate.duration_s):
        return tr("plan.by_stick", count=count, length=length, low=low, high=high)
    minutes, seconds = divmod(round(estimate.duration_s), 60)
    time, battery = f"{minutes}:{seconds:02d}", round(estimate.battery_percent)
    end = Text(f"plan.at_end.{plan.at_end.name.lower()}")
    return tr(
        "plan.summary",
        count=count,
        length=length,
        low=low,
        high=high,
        time=time,
        battery=battery,
        end=end,
    )


def upload_of(plan: WaypointPlan | None, uploaded: WaypointPlan | None, name: str) -> Text:
    """Whether start would fly what is drawn here."""
    if uploaded is None:
        return tr("plan.is_not_uploaded")
    if is_same(plan, uploaded):
        return tr("plan.is_uploaded" if plan.take_off else "plan.is_uploaded_for_the_air")
    return tr("plan.is_another", name=name)


def is_same(plan: WaypointPlan | None, uploaded: WaypointPlan | None) -> TypeGuard[WaypointPlan]:
    """Whether both are there and give the aircraft the same bytes, by which it flies the same."""
    return plan is not None and uploaded is not None and plan.to_wire() == uploaded.to_wire()


def row_of(number: int, point: waypoint.Waypoint) -> Text:
    actions = text_of(point.actions)
    height = Quantity.length(point.height, 1)
    return tr("plan.row", number=number, height=height, actions=f", {actions}" * bool(actions))


def drawing(draft: Draft, found: Checked, chosen: int | None) -> dict[str, object]:
    return {
        "points": [
            [point.latitude_deg, point.longitude_deg, any(n.is_error for n in found.at(index))]
            for index, point in enumerate(draft.points)
        ],
        "area": [list(corner) for corner in draft.area],
        "outline": [list(corner) for corner in draft.outline],
        "chosen": chosen,
    }


def profile_options(points: list[tuple[float, float]], units: Units) -> dict[str, object]:
    """The chart of heights by distance, as ECharts takes it. ``points``: way and height, m."""
    data = [[round(units.convert(one, QuantityKind.LENGTH), 1) for one in at] for at in points]
    axis = {
        "type": "value",
        "axisLabel": {
            "formatter": f"{{value}} {units.unit(QuantityKind.LENGTH)}",
            "hideOverlap": True,
        },
    }
    return {
        "animation": False,
        "grid": {"left": 52, "right": 14, "top": 12, "bottom": 28},
        "xAxis": axis,
        "yAxis": axis,
        "series": [{"type": "line", "data": data, "areaStyle": {"opacity": 0.15}}],
    }
