"""What can be chosen about missions: the numbers and open questions of command set 0x03."""

from __future__ import annotations

import math
from dataclasses import dataclass

__all__ = ["MissionSettings", "NoFlyZone"]


@dataclass(frozen=True, slots=True)
class NoFlyZone:
    """A circle on the map that no mission may enter.

    Attributes:
        latitude_deg, longitude_deg: Its centre.
        radius: Metres.
    """

    latitude_deg: float
    longitude_deg: float
    radius: float


@dataclass(frozen=True, slots=True, kw_only=True)
class MissionSettings:
    """How the flight controller takes missions.

    What documents or real aircraft settle has no switch. The others have: their defaults are the
    best reading of sources that are silent or disagree (``docs/explanation/simulator-limits.md``
    tells which).

    Attributes:
        status_hz: Rate of the status push 0x02/0x03; 0 is the box *Ground Station Status* of the
            assistant not ticked, and then no mission pushes anything.
        status_when_idle: Push the status before the first mission, too.
        takes_off_by_itself: A waypoint mission started on the ground takes off; else it is refused.
        busy_is_one_code: Answer "conditions not met" for all of taking off, landing, going home
            and starting motors, instead of a code for each.
        closest_points: Neighbouring waypoints are at least so far apart, metres (0.5 in the
            documents of 2017).
        farthest_points: And at most so far, metres.
        longest_route: From the first waypoint to the last, metres.
        longest_way: The route with the ways from and to home, metres.
        farthest_start: A mission farther away than this does not start, metres.
        least_battery_percent: At this charge or below, no mission starts.
        low_battery_returns: At the low-battery level a mission is broken off for going home.
        leaving_f_pauses: When the pilot leaves F, the mission waits, paused, until control has come
            back and a program resumes it; else it is broken off.
        stick_pauses: The pilot's roll or throttle stick pauses a waypoint mission. (Pitch is its
            speed, and yaw its heading where the yaw mode says so.)
        radius_limit: Metres from home that no mission may leave; infinite when not set in the app.
        never_logged_in: Nobody ever logged in to the app: 30 m of height, 50 m around home.
        beginner_mode: The app's beginner mode, in which no mission starts.
        no_fly_zones: Circles that no mission may enter.
        turn_rate_deg: How fast a mission turns the nose on the spot, degrees per second.
        photo_seconds: How long a photo or video action takes, seconds.
        hotpoint_acks: Answer 0x03/0x23 to 0x25, which a real one does not.
        radial_speed: How fast a hotpoint's radius changes, m/s.
        hotpoint_reach: Farther than this outside its circle, a hotpoint mission cannot resume.
        follow_yaw_reversed: Yaw mode 0 looks at the target and 1 obeys the remote control.
        follow_silence: Seconds without a new target until the aircraft hovers.
        follow_lost: Seconds without a new target until the mission is broken off.
        follow_jump: A target that moved farther at once is ignored, metres.
        follow_speed: Fastest pursuit, m/s.
    """

    status_hz: float = 10.0
    status_when_idle: bool = False
    takes_off_by_itself: bool = True
    busy_is_one_code: bool = False
    closest_points: float = 2.0
    farthest_points: float = 2_000.0
    longest_route: float = 30_000.0
    longest_way: float = 60_000.0
    farthest_start: float = 2_000.0
    least_battery_percent: float = 30.0
    low_battery_returns: bool = True
    leaving_f_pauses: bool = False
    stick_pauses: bool = False
    radius_limit: float = math.inf
    never_logged_in: bool = False
    beginner_mode: bool = False
    no_fly_zones: tuple[NoFlyZone, ...] = ()
    turn_rate_deg: float = 45.0
    photo_seconds: float = 1.2
    hotpoint_acks: bool = False
    radial_speed: float = 3.0
    hotpoint_reach: float = 100.0
    follow_yaw_reversed: bool = False
    follow_silence: float = 6.0
    follow_lost: float = 30.0
    follow_jump: float = 200.0
    follow_speed: float = 10.0

    def __post_init__(self) -> None:
        """Check the rate."""
        if not 0.0 <= self.status_hz <= 100.0:
            raise ValueError(f"mission status is pushed at 0 to 100 Hz, not {self.status_hz}")
