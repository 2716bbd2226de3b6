"""Each rule of a plan, with a plan that breaks it and nothing else, and one at the very limit."""

from __future__ import annotations

import math
import pickle
from dataclasses import replace
from functools import partial
from typing import Any

import pytest

from m100link import (
    BadPlan,
    GimbalPitch,
    Heading,
    Stay,
    TakePhoto,
    Trace,
    TurnTo,
    UsageError,
    Waypoint,
    WaypointPlan,
)
from m100link.geodesy import destination
from m100link.protocol.commands.waypoint import (
    ACTION_PARAMETERS,
    USED_SLOTS,
    WaypointMission,
    WaypointPoint,
)
from m100link.protocol.fields import Number

PLACE = 52.1, 4.31
near: Any = partial(pytest.approx, rel=1e-6)
MISSION, POINT = WaypointMission.LAYOUT.numbers, WaypointPoint.LAYOUT.numbers


def at(north: float, east: float = 0.0, height: float = 20.0, **values: Any) -> Waypoint:
    return Waypoint(*destination(*PLACE, north, east), height, **values)


def plan(*, point: dict[str, Any] | None = None, **values: Any) -> WaypointPlan:
    """Three points 50 m apart; the values of the second, or of the whole, are changed."""
    middle = replace(at(50), **point or {})
    return WaypointPlan([at(0), middle, at(100)], **values)


def problem(*, point: dict[str, Any] | None = None, **values: Any) -> BadPlan:
    with pytest.raises(BadPlan) as caught:
        plan(point=point, **values)
    assert caught.value.others == ()
    return caught.value


def problems_of(points: list[Waypoint]) -> tuple[BadPlan, ...]:
    try:
        WaypointPlan(points)
    except BadPlan as error:
        return error.problems
    return ()


@pytest.mark.parametrize(
    ("field", "least", "most", "below", "above"),
    [
        ("heading_deg", -180, 180, -181, 181),
        ("gimbal_pitch_deg", -90, 0, -91, 1),
        ("damping", 0.2, 1000.0, 0.19, 1000.1),
        ("damping", 0.0, 0.2, -0.1, math.inf),
        ("height", -200.0, 500.0, -200.1, 500.1),
        ("latitude_deg", -89.0, 89.0, -89.1, 89.1),
        ("longitude_deg", -180.0, 180.0, -180.1, 181),
        ("action_repeat", 0, 15, -1, 16),
        ("action_time_limit", 0, 999, -1, 1000),
    ],
)
def test_a_value_of_a_point_is_named_with_its_limits(
    field: str, least: float, most: float, below: float, above: float
) -> None:
    for value in (below, above, math.nan, "5", True):
        error = problem(point={field: value})
        assert (error.point, error.field) == (1, field)
        assert error.value is value or error.value == value
        assert error.seen.startswith(f"waypoint 1: {field} ")
        assert isinstance(error.limit, tuple)
        assert error.remedy
    for value in (least, most):
        values: dict[str, Any] = {field: value}
        points = [at(0), replace(at(50), **values), at(100)]
        # Far away it has other problems, but not this one.
        assert {error.field for error in problems_of(points)} <= (
            {"waypoints"} if field in ("latitude_deg", "longitude_deg", "height") else set()
        )


@pytest.mark.parametrize(
    ("field", "least", "most", "below", "above"),
    [
        ("max_speed", 5.0, 15.0, 1.9, 15.1),
        ("speed", -10.0, 10.0, -10.1, 10.1),
        ("repeat", 1, 2, 0, 3),
    ],
)
def test_a_value_of_the_whole_is_named_with_its_limits(
    field: str, least: float, most: float, below: float, above: float
) -> None:
    for value in (below, above, math.nan, None, False):
        values: dict[str, Any] = {"speed": 1.5, field: value}
        error = problem(**values)
        assert (error.point, error.field) == (None, field)
    for value in (least, most):
        values = {field: value}
        assert getattr(plan(**values), field) == value


def test_the_speed_is_limited_by_max_speed_which_may_be_more() -> None:
    error = problem(speed=12.0)
    assert error.limit == (-10, 10)
    assert "which is max_speed; that may be up to 15 m/s" in error.remedy
    assert plan(speed=12, max_speed=12).speed == 12


def test_a_heading_from_0_to_360_is_reported_in_the_plans_way() -> None:
    assert "-90° is the same direction" in problem(point={"heading_deg": 270}).remedy
    assert problem(point={"actions": [TurnTo(270)]}).field == "actions[0].heading_deg"


@pytest.mark.parametrize("field", ["heading", "trace", "at_end", "on_rc_loss"])
@pytest.mark.parametrize("value", [None, 1, "GO_HOME", Heading])
def test_a_choice_is_a_member_of_its_enumeration(field: str, value: object) -> None:
    values: dict[str, Any] = {field: value}
    error = problem(**values)
    assert error.field == field
    assert error.remedy.startswith("one of ")


@pytest.mark.parametrize("value", [None, 1, "yes"])
def test_what_is_true_or_false_is_nothing_else(value: object) -> None:
    assert problem(gimbal_by_waypoint=value).field == "gimbal_by_waypoint"
    assert problem(point={"turn_clockwise": value}).field == "turn_clockwise"


@pytest.mark.parametrize(
    ("action", "field"),
    [
        (Stay(-0.001), "seconds"),
        (Stay(32.768), "seconds"),
        (Stay(math.nan), "seconds"),
        (TurnTo(-181), "heading_deg"),
        (GimbalPitch(1), "pitch_deg"),
        (GimbalPitch(-91), "pitch_deg"),
        (GimbalPitch("down"), "pitch_deg"),  # type: ignore[arg-type]
    ],
)
def test_an_action_is_named_by_its_place(action: object, field: str) -> None:
    error = problem(point={"actions": [TakePhoto(), action]})
    assert (error.point, error.field) == (1, f"actions[1].{field}")


@pytest.mark.parametrize("action", [None, TakePhoto, "photo", at(0)])
def test_what_is_not_an_action_is_none(action: object) -> None:
    error = problem(point={"actions": [action]})
    assert error.field == "actions[0]"
    assert "TakePhoto" in error.remedy


def test_fifteen_actions_fit() -> None:
    assert len(plan(point={"actions": [Stay(32.767)] * 15}).waypoints[1].actions) == 15
    assert problem(point={"actions": [Stay(0)] * 16}).value == 16
    assert problem(point={"actions": None}).field == "actions"


def test_actions_that_are_never_done_are_refused() -> None:
    error = problem(point={"actions": [TakePhoto()]}, trace=Trace.COORDINATED_TURNS)
    assert (error.point, error.field) == (1, "actions")
    assert "STOP_AT_POINTS" in error.remedy


@pytest.mark.parametrize("count", [0, 1, 100, 5000])
def test_a_plan_has_2_to_99_points(count: int) -> None:
    with pytest.raises(BadPlan, match=f"of {count} waypoint") as caught:
        WaypointPlan([at(3.0 * index) for index in range(count)])
    assert caught.value.others == ()
    assert len(WaypointPlan([at(3.0 * index) for index in range(99)]).waypoints) == 99
    assert len(WaypointPlan([at(0), at(3)]).waypoints) == 2


@pytest.mark.parametrize("waypoints", [None, 5, [None], [(52.1, 4.31, 20)], "ab"])
def test_points_are_waypoints(waypoints: Any) -> None:
    with pytest.raises(BadPlan) as caught:
        WaypointPlan(waypoints)
    assert {error.field for error in caught.value.problems} == {"waypoints"}


@pytest.mark.parametrize(
    ("second", "is_legal"),
    [
        (at(1.99), False),
        (at(2.01), True),
        (at(0.001, height=25.0), True),  # DJI's test: 6 mm apart on the map, 5 m in height
        (at(1999.9), True),
        (at(2000.1), False),
        (at(1980.0, height=320.0), False),  # 2002 m in three dimensions
    ],
)
def test_neighbours_are_2_to_2000_m_apart_in_three_dimensions(
    second: Waypoint, is_legal: bool
) -> None:
    if is_legal:
        assert WaypointPlan([at(0), second])
        return
    with pytest.raises(BadPlan, match="waypoint 1 is") as caught:
        WaypointPlan([at(0), second])
    assert caught.value.limit == (2.0, 2000.0)


def test_neighbours_across_the_date_line_are_neighbours() -> None:
    west, east = Waypoint(0.0, 179.9999, 20.0), Waypoint(0.0, -179.9999, 20.0)
    assert WaypointPlan([west, east]).length_m == pytest.approx(22.26, abs=0.01)


def test_a_way_is_30_km_long_at_most() -> None:
    assert WaypointPlan([at(1999.0 * (index % 2)) for index in range(16)])
    with pytest.raises(BadPlan, match=r"30\.0 km|32\.0 km") as caught:
        WaypointPlan([at(1999.0 * (index % 2)) for index in range(17)])
    assert caught.value.limit == 30_000


def test_corners_do_not_overlap() -> None:
    def corners(*dampings: float, trace: Trace = Trace.COORDINATED_TURNS) -> WaypointPlan:
        points = [at(50.0 * index, damping=size) for index, size in enumerate(dampings)]
        return WaypointPlan(points, trace=trace)

    assert corners(0, 24.9, 24.9, 0)
    assert corners(900, 49.9, 900), "the first and the last have no corner"
    assert corners(0, 40, 40, 0, trace=Trace.STOP_AT_POINTS)
    with pytest.raises(BadPlan, match=r"30 m and 25 m do not fit into the 50\.00 m") as caught:
        corners(0, 30, 25, 0)
    assert (caught.value.point, caught.value.field) == (2, "damping")
    with pytest.raises(BadPlan) as caught:
        corners(0, 50.1, 0)
    assert [error.point for error in caught.value.problems] == [1, 1]


def test_everything_that_is_wrong_is_reported_and_the_first_is_raised() -> None:
    with pytest.raises(UsageError) as caught:
        WaypointPlan([at(0, height=math.nan), at(0, heading_deg=500)], speed=99, repeat=7)
    error = caught.value
    assert isinstance(error, BadPlan)
    assert [one.field for one in error.problems] == ["repeat", "speed", "height", "heading_deg"]
    assert [one.point for one in error.problems] == [None, None, 0, 1]
    assert pickle.loads(pickle.dumps(error)).problems[3].value == 500


CORNERS = (
    "waypoint 2: corners of 30 m and 25 m do not fit into the 50.00 m from waypoint 1 to waypoint 2"
)
FAR = [at(1999.0 * (index % 2)) for index in range(17)]
WHOLE: list[tuple[dict[str, Any], str, int | None, str, Any, Any, str]] = [
    (
        {"point": {"height": 500.5}},
        "waypoint 1: height 500.5 is above 500 m",
        *(1, "height", 500.5, (-200, 500), "-200 to 500 m above the take-off point"),
    ),
    (
        {"point": {"gimbal_pitch_deg": -91}},
        "waypoint 1: gimbal_pitch_deg -91 is below -90°",
        *(1, "gimbal_pitch_deg", -91, (-90, 0), "-90 to 0°"),
    ),
    (
        {"point": {"heading_deg": -200}},
        "waypoint 1: heading_deg -200 is below -180°",
        *(1, "heading_deg", -200, (-180, 180), "-180 to 180°; 160° is the same direction"),
    ),
    (
        {"point": {"heading_deg": 361}},
        "waypoint 1: heading_deg 361 is above 180°",
        *(1, "heading_deg", 361, (-180, 180), "-180 to 180°"),
    ),
    (
        {"point": {"damping": 0.1}},
        "waypoint 1: damping 0.1 is below 0.2 m",
        *(1, "damping", 0.1, (0.2, 1000), "0.2 to 1000 m, or 0"),
    ),
    (
        {"point": {"action_time_limit": "x" * 50}},
        f"waypoint 1: action_time_limit is '{'x' * 36}..., not a finite number",
        *(1, "action_time_limit", "x" * 50, (0, 999), "0 to 999 s, or None"),
    ),
    (
        {"point": {"action_repeat": 1.5}},
        "waypoint 1: action_repeat is 1.5, not a whole number",
        *(1, "action_repeat", 1.5, (0, 15), "0 to 15"),
    ),
    (
        {"point": {"turn_clockwise": 1}},
        "waypoint 1: turn_clockwise is 1",
        *(1, "turn_clockwise", 1, (False, True), "True or False"),
    ),
    (
        {"repeat": 1.5},
        "repeat is 1.5, not a whole number",
        *(None, "repeat", 1.5, (1, 2), "1 to 2"),
    ),
    (
        {"take_off": "no"},
        "take_off is 'no'",
        *(None, "take_off", "no", (False, True), "True or False"),
    ),
    (
        {"trace": "straight"},
        "trace is 'straight'",
        *(None, "trace", "straight", tuple(Trace)),
        "one of Trace.STOP_AT_POINTS, Trace.COORDINATED_TURNS",
    ),
    (
        {"point": {"actions": [Stay(0)] * 16}},
        "waypoint 1 has 16 actions",
        *(1, "actions", 16, (0, 15), "15 at most"),
    ),
    (
        {"point": {"actions": 5}},
        "waypoint 1: actions is 5",
        *(1, "actions", 5, None),
        "a list of Stay, TakePhoto, StartVideo, StopVideo, TurnTo, GimbalPitch",
    ),
    (
        {"point": {"actions": [TakePhoto()]}, "trace": Trace.COORDINATED_TURNS},
        "waypoint 1 has actions that would never be done",
        *(1, "actions", (TakePhoto(),), None, "Trace.STOP_AT_POINTS, or no actions"),
    ),
    (
        {"point": {"actions": [TakePhoto]}},
        "waypoint 1: actions[0] is the class TakePhoto",
        *(1, "actions[0]", TakePhoto, None, "an action is made by calling it: TakePhoto(…)"),
    ),
    (
        {"waypoints": [at(0)]},
        "a plan of 1 waypoint cannot be flown",
        *(None, "waypoints", 1, (2, 99), "2 to 99 waypoints; fly more of them as several plans"),
    ),
    (
        {"waypoints": [at(0), 5]},
        "waypoint 1 is 5",
        *(1, "waypoints", 5, None, "a Waypoint"),
    ),
    (
        {"waypoints": [at(0), at(1)]},
        "waypoint 1 is 1.00 m from the one before it",
        *(1, "waypoints", near(1.0), (2, 2000)),
        "at least 2 m, measured in height too; leave one of them out",
    ),
    (
        {"waypoints": [at(0), at(2100)]},
        "waypoint 1 is 2100.00 m from the one before it",
        *(1, "waypoints", near(2100.0), (2, 2000), "at most 2000 m; put others between them"),
    ),
    (
        {"waypoints": FAR},
        "the way is 32.0 km long",
        *(None, "waypoints", near(31_984.0), 30_000, "at most 30 km; fly it as several plans"),
    ),
    (
        {"waypoints": [at(0), at(50, damping=30), at(100, damping=25), at(150)]}
        | {"trace": Trace.COORDINATED_TURNS},
        CORNERS,
        *(2, "damping", 55, near(50.0), "smaller dampings, together at most the distance"),
    ),
]


@pytest.mark.parametrize(("values", "seen", "point", "field", "value", "limit", "remedy"), WHOLE)
def test_a_problem_says_all_that_a_program_or_a_person_needs(
    values: dict[str, Any],
    seen: str,
    point: int | None,
    field: str,
    value: object,
    limit: object,
    remedy: str,
) -> None:
    with pytest.raises(BadPlan) as caught:
        WaypointPlan(**values) if "waypoints" in values else plan(**values)
    error = caught.value
    assert (error.seen, error.point, error.field, error.remedy) == (seen, point, field, remedy)
    assert error.value == value
    assert error.limit == limit
    assert len(error.problems) == 1


@pytest.mark.parametrize(
    ("beyond", "on_wire", "factor"),
    [
        ({"point": {"height": 1e9}}, POINT["altitude"], 1),
        ({"point": {"heading_deg": 1e9}}, POINT["yaw"], 1),
        ({"point": {"longitude_deg": 1e9}}, POINT["longitude"], 180 / math.pi),
        ({"point": {"damping": 1e9}}, POINT["damping"], 1),
        ({"point": {"action_time_limit": 1e9}}, POINT["action_time_limit"], 1),
        ({"point": {"action_repeat": 1e9}}, POINT["action_repeat"], 1),
        ({"point": {"actions": [Stay(1e9)]}}, ACTION_PARAMETERS["stay"], 0.001),
        ({"point": {"actions": [TurnTo(1e9)]}}, ACTION_PARAMETERS["turn_to"], 1),
        ({"point": {"actions": [GimbalPitch(1e9)]}}, ACTION_PARAMETERS["gimbal_pitch"], 1),
        # The 30° that a point may carry are those of later aircraft.
        ({"point": {"gimbal_pitch_deg": 1e9}}, ACTION_PARAMETERS["gimbal_pitch"], 1),
        ({"max_speed": 1e9}, MISSION["max_speed"], 1),
        ({"repeat": 1e9}, MISSION["repeat"], 1),
    ],
)
def test_a_plan_allows_what_its_commands_carry(
    beyond: dict[str, Any], on_wire: Number, factor: float
) -> None:
    """Its ranges are its own, because who plans loads no commands; here they are held together."""
    assert problem(**beyond).limit == pytest.approx((on_wire.low * factor, on_wire.high * factor))


def test_counts_are_those_of_the_commands() -> None:
    [too_few] = problems_of([at(0)])
    assert too_few.limit == (MISSION["count"].low, MISSION["count"].high)
    assert problem(point={"actions": [TakePhoto()] * 16}).limit == (0, USED_SLOTS)
