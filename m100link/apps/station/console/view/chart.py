"""What is drawn on the map besides what moves."""

from __future__ import annotations

from dataclasses import dataclass

from m100link.apps.station.console.view.inputs import Inputs

__all__ = ["Chart", "Fence", "chart_of"]


@dataclass(frozen=True, slots=True)
class Fence:
    """The circle of the envelope: beyond it nothing is flown.

    Attributes:
        latitude_deg: Its middle: where control was obtained.
        longitude_deg: The same.
        radius_m: Its radius, m.
    """

    latitude_deg: float
    longitude_deg: float
    radius_m: float


@dataclass(frozen=True, slots=True)
class Chart:
    """What stands on the map.

    Attributes:
        fence: The envelope; None without control, without GPS, or with that guard off.
        route: Latitude and longitude of the plan's waypoints, degrees.
    """

    fence: Fence | None
    route: tuple[tuple[float, float], ...]


def chart_of(inputs: Inputs) -> Chart:
    """The chart as it is now."""
    points = inputs.plan.waypoints if inputs.plan is not None else ()
    return Chart(
        _fence(inputs), tuple((point.latitude_deg, point.longitude_deg) for point in points)
    )


def _fence(inputs: Inputs) -> Fence | None:
    limits = inputs.state.limits
    latitude, longitude, radius = limits.latitude_deg, limits.longitude_deg, limits.max_radius_m
    if latitude is None or longitude is None or radius is None or not inputs.is_heard:
        return None
    return Fence(latitude, longitude, radius)
