"""The numbers of the flight model.

They are chosen to look like a Matrice 100 (velocity lag of about a second, 17 m/s at most), they
are not measured on one.
"""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["Airframe"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Airframe:
    """The numbers of the model. Replace some of them to fly a heavier or livelier aircraft."""

    tilt_frequency: float = 10.0
    """Natural frequency of the critically damped attitude response, rad/s."""
    maximum_tilt_deg: float = 30.0
    """Limit of commanded tilt (document 3.2)."""
    cruise_tilt_deg: float = 25.0
    """Tilt that velocity and position control allow themselves."""
    steepest_tilt_deg: float = 35.0
    """Tilt that missions may take, as in the tight circles of a hotpoint (DJI's data sheet)."""
    drag: float = 0.30
    """Horizontal deceleration per m/s of airspeed, 1/s."""
    vertical_drag: float = 0.35
    """Vertical deceleration per m/s in thrust control, 1/s."""
    smooth_braking: float = 2.5
    """Deceleration that stable mode allows itself, m/s²."""
    velocity_gain: float = 1.6
    """Horizontal acceleration asked for per m/s of velocity error, 1/s."""
    position_gain: float = 0.8
    """Velocity asked for per metre of position error, 1/s."""
    position_speed: float = 3.0
    """Fastest approach in position control, m/s. Users of the real one report about this value."""
    vertical_time_constant: float = 0.35
    """First-order lag of vertical velocity, s."""
    vertical_acceleration: float = 5.0
    """Limit of vertical acceleration in velocity and height control, m/s²."""
    height_gain: float = 1.2
    """Vertical velocity asked for per metre of height error, 1/s."""
    vertical_speed: float = 4.0
    """Limit of vertical velocity in velocity and height control, m/s (document 3.2)."""
    yaw_time_constant: float = 0.15
    """First-order lag of the yaw rate, s."""
    yaw_gain: float = 2.0
    """Yaw rate asked for per radian of yaw error, 1/s."""
    yaw_rate_deg: float = 100.0
    """Limit of the yaw rate, degrees per second (document 3.2)."""
    hover_thrust: float = 45.0
    """Percent of full thrust that carries the aircraft."""
