"""Plans by chance, for tests that want any of them."""

from __future__ import annotations

from typing import Any

from hypothesis import strategies as st

from m100link import (
    AtEnd,
    GimbalPitch,
    Heading,
    OnRCLoss,
    StartVideo,
    Stay,
    StopVideo,
    TakePhoto,
    Trace,
    TurnTo,
    Waypoint,
    WaypointPlan,
)
from m100link.geodesy import destination

__all__ = ["plans", "waypoints"]

ACTIONS = st.one_of(
    st.builds(Stay, st.floats(0, 32.767)),
    st.builds(TakePhoto),
    st.builds(StartVideo),
    st.builds(StopVideo),
    st.builds(TurnTo, st.integers(-180, 180)),
    st.builds(GimbalPitch, st.integers(-90, 0)),
)


@st.composite
def waypoints(draw: st.DrawFn, trace: Trace) -> list[Waypoint]:
    """Points that lie near enough and far enough from each other, anywhere on the Earth."""
    place = draw(st.tuples(st.floats(-85, 85), st.floats(-180, 180)))
    found = []
    height = draw(st.floats(-150, 450))
    for _ in range(draw(st.integers(2, 12))):
        stops = trace is Trace.STOP_AT_POINTS
        found.append(
            Waypoint(
                *place,
                height,
                heading_deg=draw(st.integers(-180, 180)),
                damping=draw(st.one_of(st.just(0.0), st.floats(0.2, 1.0))),
                gimbal_pitch_deg=draw(st.integers(-90, 0)),
                turn_clockwise=draw(st.booleans()),
                actions=draw(st.lists(ACTIONS, max_size=15)) if stops else (),
                action_repeat=draw(st.integers(0, 15)),
                action_time_limit=draw(st.one_of(st.none(), st.integers(0, 999))),
            )
        )
        north = draw(st.floats(3, 1000)) * draw(st.sampled_from((-1, 1)))
        east = draw(st.floats(-1000, 1000))
        place = destination(*place, north, east)
        height = min(450.0, max(-150.0, height + draw(st.floats(-50, 50))))
    return found


@st.composite
def plans(draw: st.DrawFn) -> WaypointPlan:
    """Any plan that can be flown."""
    trace = draw(st.sampled_from(Trace))
    max_speed = draw(st.floats(2, 15))
    values: dict[str, Any] = {
        "max_speed": max_speed,
        "speed": draw(st.floats(-max_speed, max_speed)),
        "heading": draw(st.sampled_from(Heading)),
        "at_end": draw(st.sampled_from(AtEnd)),
        "on_rc_loss": draw(st.sampled_from(OnRCLoss)),
        "gimbal_by_waypoint": draw(st.booleans()),
        "repeat": draw(st.integers(1, 2)),
        "take_off": draw(st.booleans()),
    }
    return WaypointPlan(draw(waypoints(trace)), trace=trace, **values)
