"""Drawings on the map besides what moves, and click to fly."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from enum import Enum
from typing import Any

from m100link.apps.agent import orders
from m100link.apps.agent.client import Hearing
from m100link.apps.agent.orders import GuidedOrder, Life
from m100link.apps.agent.preview import Preview
from m100link.apps.station.console.tab import IssuedOrder
from m100link.apps.station.console.view.situation import Inputs
from m100link.apps.station.console.view.texts import Quantity, QuantityKind, Text, reason_text, tr
from m100link.errors import GuardRefused, LinkError, M100Error, TelemetryStalled, UsageError
from m100link.geodesy import LocalFrame

# -- what is drawn ---------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Chart:
    # The circle of the envelope, beyond which nothing is flown: latitude and longitude of its
    # middle, degrees, and its radius, m. None without control, without GPS, or with that guard off.
    fence: tuple[tuple[float, float], float] | None
    # Latitude and longitude of the plan's waypoints, degrees.
    route: tuple[tuple[float, float], ...]


def chart_of(inputs: Inputs) -> Chart:
    points = inputs.plan.waypoints if inputs.plan is not None else ()
    return Chart(
        _fence(inputs), tuple((point.latitude_deg, point.longitude_deg) for point in points)
    )


def _fence(inputs: Inputs) -> tuple[tuple[float, float], float] | None:
    limits, is_heard = inputs.vehicle.state.limits, inputs.vehicle.hearing is Hearing.HEARD
    latitude, longitude, radius = limits.latitude_deg, limits.longitude_deg, limits.max_radius_m
    if latitude is None or longitude is None or radius is None or not is_heard:
        return None
    return (latitude, longitude), radius


# -- click to fly ----------------------------------------------------------------------------------
# Pure: the caller holds a :class:`Pointed`, each change makes another one, and
# :func:`click_of` says what stands beside the point.

OFFERED = {
    "height": (2.0, 120.0),  # m
    "speed": (0.5, 10.0),  # m/s
    "radius": (3.0, 100.0),  # m
    "turns": (0.25, 20.0),
}
"""Least and most that the page offers; the guards say what of it is flown."""

_FARTHEST_M = 5000.0


class GuidedKind(Enum):
    PLACE = "place"
    CIRCLE = "circle"
    HEIGHT = "height"
    HEADING = "heading"


@dataclass(frozen=True, slots=True)
class Pointed:
    kind: GuidedKind = GuidedKind.PLACE  # what is wanted
    # Latitude and longitude, °; None before anything was pointed at.
    place: tuple[float, float] | None = None
    height: float = 10.0  # metres above the take-off point
    speed: float = 5.0  # m/s
    radius: float = 15.0  # of the circle, m
    turns: float = 1.0  # around the circle
    clockwise: bool = True  # seen from above
    yaw_deg: float = 0.0  # heading, 0 to 360°

    def at(self, latitude_deg: float, longitude_deg: float) -> Pointed:
        """Another point; what is no place changes nothing."""
        if not abs(latitude_deg) <= 89 or not math.isfinite(longitude_deg):
            return self
        kind = self.kind if self.kind is GuidedKind.CIRCLE else GuidedKind.PLACE
        return replace(self, place=(latitude_deg, longitude_deg), kind=kind)

    def by_distance(
        self, here: tuple[float, float], distance: float, bearing_deg: float
    ) -> Pointed:
        """The point so far from the aircraft, in that direction: for who does not point."""
        distance = min(abs(distance), _FARTHEST_M)
        angle = math.radians(bearing_deg)
        frame = LocalFrame(*here)
        return self.at(*frame.to_geodetic(distance * math.cos(angle), distance * math.sin(angle)))

    def changed(self, name: str, value: object) -> Pointed:
        """One number changed, kept within what the page offers; nonsense changes nothing."""
        if not isinstance(value, int | float) or not math.isfinite(value):
            return self
        if name == "yaw_deg":
            return replace(self, yaw_deg=value % 360.0)
        low, high = OFFERED[name]
        # One of four numbers, all of them floats.
        return replace(self, **{name: max(low, min(high, float(value)))})  # type: ignore[arg-type]

    @property
    def order(self) -> GuidedOrder | None:
        if self.kind is GuidedKind.HEIGHT:
            return orders.ChangeHeight(self.height)
        if self.kind is GuidedKind.HEADING:
            return orders.ChangeHeading(self.yaw_deg)
        if self.place is None:
            return None
        if self.kind is GuidedKind.CIRCLE:
            return orders.FlyAround(
                *self.place,
                height=self.height,
                radius=self.radius,
                speed=self.speed,
                turns=self.turns,
                clockwise=self.clockwise,
            )
        return orders.FlyTo(*self.place, height=self.height, speed=self.speed)


class Shown:
    """Which point the preview shows: a hold confirms that one, whatever moved since it began."""

    def __init__(self) -> None:
        self._number = 0
        self._pointed = Pointed()

    def show(self, pointed: Pointed) -> int:
        """The preview shows this one; returns its number, another one for each other point."""
        if pointed != self._pointed:
            self._number, self._pointed = self._number + 1, pointed
        return self._number

    def check(self, number: object, pointed: Pointed) -> None:
        """Refuse what was not shown when the hold began.

        Raises ``GuardRefused``: it is another one.
        """
        if str(number) != str(self._number) or pointed != self._pointed:
            raise GuardRefused(
                "the point changed while the button was held; nothing was done",
                guard="order_changed",
                cause="what the preview showed at the press is not what would be flown",
                remedy="look at the preview, then hold again",
            )


@dataclass(frozen=True, slots=True)
class MapRefusal:
    reason: Text | None  # what was seen; None where there is only a remedy
    remedy: Text | str  # for the operator; empty where none is known


@dataclass(frozen=True, slots=True)
class Drawing:
    # Latitude and longitude, °; None where the place stays.
    place: tuple[float, float] | None = None
    radius: float = 0.0  # of the circle, m; 0 for none
    yaw_deg: float | None = None  # heading; None for none
    life: Life = Life.FLOWN  # how far its order has come


@dataclass(frozen=True, slots=True)
class ClickView:
    preview: Text | None  # what it would take; None while there is no point
    # Why it would be refused, or was; empty while nothing stands against it.
    refusals: tuple[MapRefusal, ...]
    may_fly: bool  # whether the button can be held
    flying: Text | None  # what flies now, with what remains; None for nothing
    pointed: Drawing  # what is drawn of the point
    flown: Drawing  # what is drawn of the flight


def click_of(
    pointed: Pointed,
    foreseen: Preview | None,  # what that would take; None while there is no point
    guided: orders.GuidedFlight | None,
    *,
    has_control: bool,  # whether what this page wants is obeyed
    own: IssuedOrder | None = None,  # the newest flight that this page asked for
) -> ClickView:
    refusals = [] if foreseen is None else [_refusal(error) for error in foreseen.refusals]
    if foreseen is not None and not has_control:
        refusals.insert(0, MapRefusal(None, tr("click.remedy.control")))
    may_fly = foreseen is not None and not refusals
    return ClickView(
        preview=None if foreseen is None else _preview(pointed.kind, foreseen),
        refusals=tuple(refusals),
        may_fly=may_fly,
        flying=_said(guided, own),
        pointed=_pointed(pointed),
        flown=_flown(guided, own),
    )


def _is_shown(guided: orders.GuidedFlight | None, own: IssuedOrder | None) -> bool:
    """Whether the order of this page says more than what flies: before it flies, and at its end."""
    return own is not None and (own.life is Life.SENT or guided is None)


def _said(guided: orders.GuidedFlight | None, own: IssuedOrder | None) -> Text | None:
    if own is not None and own.order is not None and _is_shown(guided, own):
        what = tr("click.what." + own.order.label.replace(" ", "_"))
        why = reason_text(own.why) if isinstance(own.why, M100Error) else ""
        return tr(f"click.life.{own.life.value}", what=what, why=why)
    if guided is None:
        return None
    flies = _flying(guided)
    if own is None or own.is_over:
        return flies
    return tr(f"click.life.{own.life.value}", what=flies, why="")


def _pointed(pointed: Pointed) -> Drawing:
    if pointed.kind is GuidedKind.HEADING:
        return Drawing(yaw_deg=pointed.yaw_deg)
    if pointed.kind is GuidedKind.HEIGHT:
        return Drawing()
    return Drawing(pointed.place, pointed.radius if pointed.kind is GuidedKind.CIRCLE else 0.0)


def _flown(guided: orders.GuidedFlight | None, own: IssuedOrder | None) -> Drawing:
    flies: Any = own.order if own is not None and _is_shown(guided, own) else guided
    if flies is None:
        return Drawing()
    latitude, longitude = (getattr(flies, f"{one}_deg", None) for one in ("latitude", "longitude"))
    place = None if latitude is None or longitude is None else (latitude, longitude)
    life = Life.FLOWN if own is None or (own.is_over and flies is guided) else own.life
    return Drawing(place, getattr(flies, "radius", 0.0), getattr(flies, "yaw_deg", None), life)


def _preview(kind: GuidedKind, found: Preview) -> Text:
    time, battery = _time(found.seconds), max(0.1, found.battery_percent)
    if kind is GuidedKind.HEIGHT:
        climb = Quantity(found.climb_m, QuantityKind.LENGTH, 1, is_signed=True)
        return tr("click.climb", climb=climb, time=time, battery=battery)
    if kind is GuidedKind.HEADING:
        return tr("click.turn", turn=round(found.turn_deg), time=time, battery=battery)
    way = Quantity.length(found.distance_m)
    return tr("click.way", way=way, time=time, battery=battery)


def _flying(guided: orders.GuidedFlight) -> Text:
    what = tr("click.what." + guided.what.replace(" ", "_"))
    if guided.seconds is None:
        return tr("click.flying", what=what)
    if guided.distance_m is None:
        return tr("click.flying_time", what=what, time=_time(guided.seconds))
    far = Quantity.length(guided.distance_m)
    return tr("click.flying_way", what=what, way=far, time=_time(guided.seconds))


def _time(seconds: float) -> str:
    minutes, rest = divmod(round(seconds), 60)
    return f"{minutes}:{rest:02d}"


def _refusal(error: M100Error) -> MapRefusal:
    """With a remedy for an operator; those of errors are for programmers."""
    return MapRefusal(reason_text(error), _remedy(error))


def _remedy(error: M100Error) -> Text | str:
    if isinstance(error, GuardRefused):
        known = {
            "envelope": "click.remedy.envelope",
            "battery_floor_percent": "click.remedy.battery",
            "gps": "click.remedy.gps",
        }
        key = known.get(error.guard)
        return error.remedy if key is None else tr(key)
    if isinstance(error, UsageError) and "on the ground" in error.seen:
        return tr("click.remedy.ground")
    if isinstance(error, TelemetryStalled | LinkError):
        return tr("click.remedy.telemetry")
    return error.remedy
