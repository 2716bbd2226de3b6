"""Values of waypoints are kept as the wire carries them."""

from __future__ import annotations

import math
from decimal import Decimal
from struct import pack, unpack
from typing import Any

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from m100link import (
    BadPlan,
    GimbalPitch,
    Stay,
    TakePhoto,
    TurnTo,
    UsageError,
    Waypoint,
    WaypointPlan,
)
from m100link.geodesy import LocalFrame
from m100link.missions.waypoint import as_single, number


def test_a_waypoint_is_kept_as_the_wire_carries_it() -> None:
    point = Waypoint(
        52.1000000000004,
        -4.31,
        52.123456789,
        heading_deg=90.4,
        damping=0.3,
        gimbal_pitch_deg=-59.6,
        action_time_limit=1.2,
        actions=[Stay(1.23456), TurnTo(-89.7), GimbalPitch(-45.2)],
    )
    assert (point.latitude_deg, point.longitude_deg) == (52.1, -4.31)
    assert point.height == 52.123455  # as a float of 32 bits has it
    assert (point.heading_deg, point.gimbal_pitch_deg) == (90, -60)
    assert point.damping == 0.3
    assert point.action_time_limit == 1
    assert point.actions == (Stay(1.235), TurnTo(-90), GimbalPitch(-45))


def digits(value: float) -> int:
    """Significant ones, in decimal notation."""
    return len(Decimal(repr(value)).normalize().as_tuple().digits)


@example(999999986991104.0)  # 1e15, which Python writes with all its zeros
@given(st.floats(width=32, allow_nan=False, allow_infinity=False))
def test_a_single_is_kept_as_the_decimal_that_means_it(value: float) -> None:
    kept = as_single(value)
    assert unpack("f", pack("f", kept)) == (value,)
    assert as_single(kept) == kept
    assert digits(kept) <= min(digits(value), 9)  # IEEE 754: nine tell each single from the others


@given(st.floats(-180, 180))
def test_a_coordinate_survives_radians_and_back(degrees: float) -> None:
    kept = Waypoint(0.0, degrees, 0.0).longitude_deg
    assert abs(kept - degrees) <= 1e-12
    again = Waypoint(0.0, math.degrees(math.radians(kept)), 0.0).longitude_deg
    assert again == kept


@pytest.mark.parametrize("value", [None, "5", b"5", True, [], 10**400, 1j])
def test_what_is_not_a_number_is_left_for_the_plan_to_name(value: object) -> None:
    assert number(value) is None
    assert Waypoint(value, 0.0, value).height is value  # type: ignore[arg-type]


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, 1e300])
def test_what_no_single_holds_is_left_for_the_plan_to_name(value: float) -> None:
    assert Waypoint(value, 0.0, value).height is value


def test_a_track_becomes_waypoints() -> None:
    frame = LocalFrame(52.1, 4.31)
    points = Waypoint.along([(0, 0, 10), (100, 0, 20)], frame=frame, damping=3)
    assert [point.height for point in points] == [10, 20]
    assert frame.to_local(points[1].latitude_deg, points[1].longitude_deg) == pytest.approx(
        (100, 0), abs=1e-4
    )
    assert {point.damping for point in points} == {3}


@pytest.mark.parametrize(("every", "count"), [(50, 3), (49.9, 4), (1000, 2), (100, 2), (33, 5)])
def test_legs_are_divided_evenly(every: float, count: int) -> None:
    frame = LocalFrame(52.1, 4.31)
    track = [(0.0, 0.0, 10.0), (100.0, 0.0, 10.0)]
    points = Waypoint.along(track, frame=frame, every=every, actions=[TakePhoto()])
    places = [frame.to_local(point.latitude_deg, point.longitude_deg)[0] for point in points]
    assert places == pytest.approx([100 * n / (count - 1) for n in range(count)], abs=1e-4)
    assert all(point.actions == (TakePhoto(),) for point in points)


def test_a_leg_of_seven_parts_has_seven() -> None:
    """2.1 by 0.3 is 7.000000000000001 of a computer."""
    assert 2.1 / 0.3 > 7.0
    points = Waypoint.along([(0, 0, 9), (2.1, 0, 9)], frame=LocalFrame(52, 4), every=0.3)
    assert len(points) == 8


@pytest.mark.parametrize("every", [0, -1, math.nan, math.inf])
def test_a_track_cannot_be_divided_into_nothing(every: float) -> None:
    with pytest.raises(UsageError, match="apart"):
        Waypoint.along([(0, 0, 1), (9, 0, 1)], frame=LocalFrame(0, 0), every=every)


@pytest.mark.parametrize("track", [[(0, 0), (1, 1)], [(0, 0, "x")], [5], 5])
def test_a_track_of_something_else_is_reported(track: Any) -> None:
    with pytest.raises(UsageError, match=r"track is ") as caught:
        Waypoint.along(track, frame=LocalFrame(0, 0))
    assert "height" in caught.value.remedy


def test_a_place_is_not_a_frame() -> None:
    frame: Any = (52.1, 4.31)
    with pytest.raises(UsageError, match="frame is") as caught:
        Waypoint.along([(0, 0, 1)], frame=frame)
    assert "LocalFrame" in caught.value.remedy


@pytest.mark.parametrize("action", [TakePhoto, Stay])
def test_the_class_of_an_action_is_not_one(action: Any) -> None:
    with pytest.raises(BadPlan, match=f"is the class {action.__name__}") as caught:
        WaypointPlan([Waypoint(0, 0, 1, actions=[action]), Waypoint(0, 0.001, 1)])
    assert f"{action.__name__}(…)" in caught.value.remedy


def test_a_whole_number_is_one_however_it_is_written() -> None:
    point = Waypoint(0.0, 0.0, 0.0, action_repeat=3.0)  # type: ignore[arg-type] # as JSON may be
    assert type(point.action_repeat) is int
    assert Waypoint(0.0, 0.0, 0.0, action_repeat=2.5).action_repeat == 2.5  # type: ignore[arg-type]
