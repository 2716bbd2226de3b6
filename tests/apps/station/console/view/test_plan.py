"""A plan that is drawn: changes, undoing them, checks beside the point, and files."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import pytest

from m100link import (
    AtEnd,
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
from m100link.apps.station.console.view.plan import (
    Draft,
    DraftHistory,
    actions_of,
    checked,
    drawing,
    figures_of,
    profile,
    profile_options,
    row_of,
    summary_of,
    text_of,
    upload_of,
)
from m100link.apps.station.console.view.texts import METRIC, Language, LengthUnit, Translator, Units
from m100link.geodesy import LocalFrame
from m100link.missions.waypoint import StartVideo, StopVideo

FRAME = LocalFrame(52.1, 4.31)


def at(north: float, east: float = 0.0) -> tuple[float, float]:
    return FRAME.to_geodetic(north, east)


def drawn(*norths: float) -> Draft:
    draft = Draft()
    for north in norths:
        draft = draft.added(at(north), 20.0)
    return draft


def norths(draft: Draft) -> list[int]:
    places = [FRAME.to_local(one.latitude_deg, one.longitude_deg) for one in draft.points]
    return [round(north) for north, _ in places]


def test_points_are_added_moved_put_elsewhere_and_removed() -> None:
    draft = drawn(0, 20, 40)
    assert norths(draft) == [0, 20, 40]
    assert norths(draft.added(at(10), 5.0, after=0)) == [0, 10, 20, 40]
    assert norths(draft.moved(1, at(25))) == [0, 25, 40]
    assert norths(draft.put(2, 0)) == [40, 0, 20]
    assert norths(draft.removed(0)) == [20, 40]
    assert draft.changed(1, height=33.0).points[1].height == 33.0


@pytest.mark.parametrize("index", [-1, 3, 99])
def test_a_point_that_is_not_there_changes_nothing(index: int) -> None:
    draft = drawn(0, 20, 40)
    assert draft.moved(index, at(1)) == draft
    assert draft.put(index, 0) == draft
    assert draft.put(0, index) == draft, "no place to put it"
    assert draft.corner_moved(index, at(1)) == draft


def test_every_change_can_be_undone_and_done_again() -> None:
    history = DraftHistory()
    for north in range(5):
        history = history.done(history.draft.added(at(20 * north), 20.0))
    assert history.done(history.draft) is history
    for left in (4, 3, 2):
        history = history.undo()
        assert len(history.draft.points) == left
    for more in (3, 4, 5):
        history = history.redo()
        assert len(history.draft.points) == more
    history = history.undo().undo()
    history = history.done(history.draft.removed(0))
    assert history.redo() is history  # what was undone is gone with another change
    for _ in range(9):
        history = history.undo()
    assert history.draft == Draft()
    assert history.undo() is history


def test_a_long_history_is_bounded() -> None:
    history = DraftHistory()
    for speed in range(1, 300):
        history = history.done(replace(history.draft, speed=speed / 100))
    assert len(history.before) == 100


def test_what_is_wrong_stands_beside_its_point() -> None:
    found = checked(drawn(0, 20, 40).changed(1, height=900.0).changed(2, gimbal_pitch_deg=30))
    assert found.plan is None
    assert [(note.point, note.is_error) for note in found.notes] == [(1, True), (2, True)]
    assert "500 m" in found.at(1)[0].text
    assert found.at(0) == ()


def test_what_may_surprise_stands_beside_its_point_too() -> None:
    draft = drawn(0, 20).changed(1, actions=(Stay(20.0),), action_time_limit=5)
    found = checked(replace(draft, speed=0.0))
    assert found.plan is not None
    assert any(note.point is None and "stick" in note.text for note in found.notes)
    (note,) = found.at(1)
    assert not note.is_error
    assert "cut off" in note.text


def test_an_empty_draft_is_not_wrong_and_a_single_point_is() -> None:
    assert checked(Draft()).notes == ()
    (note,) = checked(drawn(0)).notes
    assert note.is_error
    assert note.point is None


def test_the_estimate_counts_from_home() -> None:
    near, far = checked(drawn(0, 50)), checked(drawn(0, 50), home=at(-300))
    assert near.estimate is not None
    assert far.estimate is not None
    assert far.estimate.duration_s > near.estimate.duration_s + 50


def test_the_profile_is_by_distance() -> None:
    draft = drawn(0, 30, 80).changed(2, height=45.0)
    found = profile(draft.points)
    assert [(round(far), height) for far, height in found] == [(0, 20.0), (30, 20.0), (80, 45.0)]
    assert profile(()) == []


def test_a_plan_becomes_a_draft_and_the_same_plan_again() -> None:
    plan = replace(
        drawn(0, 20, 60), at_end=AtEnd.GO_HOME, heading=Heading.BY_WAYPOINT, speed=4.5
    ).plan()
    assert Draft.of(plan).plan() == plan
    assert Draft.of(WaypointPlan.parse(plan.to_qgroundcontrol())).plan() == plan
    assert Draft.of(WaypointPlan.parse(plan.to_json())).plan() == plan


def test_lines_over_an_area_take_the_place_of_the_points() -> None:
    draft = drawn(0, 20)
    for corner in (at(0), at(60), at(60, 40), at(0, 41)):
        draft = draft.cornered(corner)
    draft = draft.corner_moved(3, at(0, 40))
    lines = draft.surveyed(
        height=25.0, spacing=10.0, angle_deg=0.0, photo_every=None, start=at(60, 40)
    )
    assert len(lines.points) == 8
    assert lines.area == draft.area
    assert {point.height for point in lines.points} == {25.0}
    with pytest.raises(UsageError):
        Draft().surveyed(height=25.0, spacing=10.0, angle_deg=0.0, photo_every=None, start=None)


ACTIONS = (GimbalPitch(-60), TakePhoto(), Stay(2.5), TurnTo(-90), StartVideo(), StopVideo())


def test_actions_are_a_line_of_text_and_come_back() -> None:
    assert text_of(ACTIONS) == "pitch -60, photo, stay 2.5, turn -90, video, cut"
    assert actions_of(text_of(ACTIONS)) == ACTIONS
    assert actions_of(" photo ,, ") == (TakePhoto(),)
    assert actions_of("") == ()


@pytest.mark.parametrize(
    "text", ["dance", "photo 3", "stay", "stay x", "stay nan", "stay inf", "pitch -6 0"]
)
def test_what_is_not_an_action_is_reported(text: str) -> None:
    with pytest.raises(UsageError, match="is not an action"):
        actions_of(text)


def test_a_draft_takes_whatever_number_and_the_checks_say_it() -> None:
    found = checked(drawn(0, 20).changed(0, height=math.nan))
    assert found.plan is None
    assert found.at(0)[0].is_error


# -- what the Plan view says of a draft, and of what is uploaded -----------------------------------

SAY = Translator()
DRAFT = Draft().added((52.1, 4.31), 20.0).added((52.101, 4.31), 30.0)


def said(draft: Draft, speaker: Translator = SAY) -> str:
    return speaker(summary_of(draft, checked(draft)))


def test_a_draft_in_one_line() -> None:
    assert said(Draft()) == "No points yet"
    assert said(DRAFT) == (
        "2 waypoints, 112 m, 20 m to 30 m; 0:26 min, 3 % of a battery; at the end: hover"
    )
    feet = Translator(Language.GERMAN, Units(LengthUnit.FOOT))
    assert said(DRAFT, feet).startswith("2 Wegpunkte, 367 ft, 66 ft bis 98 ft; 0:26 min")
    assert said(replace(DRAFT, speed=0.0)).endswith("as fast as the pilot's stick")
    assert "would refuse" in said(DRAFT.changed(0, height=900.0))


# Home, 30 m north of it A and 130 m B, 20 m high, at 5 m/s. A stop costs 2 + 0.3·5 = 3.5 s.
# A to B: 100 m, 20 s, a stop. Home to A: 30 m in 6 s, a stop, 20 m of climb in 20/3 s.
# Landing: 20 m in 20/1.5 s. Home from B: 130 m in 130/8 s, and 2 s. Of a battery: s/10.2 %.
@pytest.mark.parametrize(
    ("at_end", "is_home_known", "words"),
    [
        (AtEnd.HOVER, True, "150 m, 20 m to 20 m; 0:40 min, 4 % of a battery; at the end: hover"),
        (AtEnd.LAND, True, "170 m, 20 m to 20 m; 0:53 min, 5 % of a battery; at the end: land"),
        (
            AtEnd.GO_HOME,
            True,
            "300 m, 20 m to 20 m; 1:11 min, 7 % of a battery; at the end: go home and land",
        ),
        (AtEnd.HOVER, False, "100 m, 20 m to 20 m; 0:24 min, 2 % of a battery; at the end: hover"),
        (AtEnd.LAND, False, "120 m, 20 m to 20 m; 0:37 min, 4 % of a battery; at the end: land"),
    ],
)
def test_a_drawn_and_an_uploaded_plan_have_the_same_length_time_and_battery(
    at_end: AtEnd, is_home_known: bool, words: str
) -> None:
    draft, home = replace(drawn(30, 130), at_end=at_end), at(0) if is_home_known else None
    uploaded = WaypointPlan.from_wire(*draft.plan().to_wire())
    assert SAY(summary_of(draft, checked(draft, home))) == f"2 waypoints, {words}"
    assert SAY(figures_of(uploaded, uploaded.estimate(home=home))) == f"2 waypoints, {words}"


def test_two_corners_are_a_rectangle_and_one_is_the_centre_of_an_orbit() -> None:
    draft = Draft().cornered(at(0, 0)).cornered(at(60, 40))
    sides = [FRAME.to_local(*corner) for corner in draft.outline]
    wanted = [(0, 0), (60, 0), (60, 40), (0, 40)]
    assert sides == [pytest.approx(corner, abs=0.01) for corner in wanted]
    how: dict[str, Any] = {"height": 30.0, "photo_every": None, "start": at(0)}
    lines = draft.surveyed(spacing=21.0, angle_deg=0.0, **how)
    places = [FRAME.to_local(one.latitude_deg, one.longitude_deg) for one in lines.points]
    wanted = [(0, 10), (60, 10), (60, 30), (0, 30)]
    assert places == [pytest.approx(place, abs=0.01) for place in wanted]
    chosen = Draft(take_off=False, repeat=2, at_end=AtEnd.LAND)
    around = chosen.cornered(at(50)).orbited(radius=20.0, **how)
    assert (around.repeat, around.at_end) == (2, AtEnd.LAND)
    plan = around.plan()
    assert (plan.heading, plan.trace, plan.take_off) == (
        Heading.BY_WAYPOINT,
        Trace.COORDINATED_TURNS,
        False,
    )
    far = [
        math.dist(FRAME.to_local(p.latitude_deg, p.longitude_deg), (50, 0)) for p in plan.waypoints
    ]
    assert far == [pytest.approx(20.0, abs=0.01)] * 25
    again = replace(around, area=draft.area).surveyed(spacing=20.0, angle_deg=0.0, **how)
    assert again.plan().trace is Trace.STOP_AT_POINTS  # of a survey nothing of the orbit is left
    for corners in ((), draft.area):
        with pytest.raises(UsageError, match="an orbit has one centre"):
            replace(draft, area=corners).orbited(radius=20.0, **how)


def test_a_waypoint_in_one_line() -> None:
    point = Waypoint(52.1, 4.31, height=20.5, actions=[TakePhoto()])
    assert SAY(row_of(3, point)) == "3: 20.5 m, photo"
    assert SAY(row_of(4, replace(point, actions=()))) == "4: 20.5 m"


def told(plan: WaypointPlan | None, uploaded: WaypointPlan | None) -> str:
    return SAY(upload_of(plan, uploaded, "tower"))


def test_whether_start_flies_what_is_drawn_here() -> None:
    plan = DRAFT.plan()
    mission, points = plan.to_wire()
    as_told = WaypointPlan.from_wire(mission, points)  # single precision, whole degrees
    assert told(plan, None) == "Not uploaded"
    assert (
        told(plan, as_told) == "Uploaded: start flies this plan, and takes off first on the ground"
    )
    in_the_air = replace(plan, take_off=False)
    assert told(in_the_air, as_told) == "Uploaded: start flies this plan in the air"
    assert told(replace(plan, speed=3.0), as_told).endswith("tower uploaded another plan")
    assert told(None, as_told).endswith("tower uploaded another plan")


def test_what_the_map_draws_says_which_points_are_wrong() -> None:
    draft = DRAFT.changed(1, height=900.0).cornered((52.0, 4.0))
    assert drawing(draft, checked(draft), 1) == {
        "points": [[52.1, 4.31, False], [52.101, 4.31, True]],
        "area": [[52.0, 4.0]],
        "outline": [[52.0, 4.0]],
        "chosen": 1,
    }


@pytest.mark.parametrize("points", [[], [(0.0, 20.0), (112.34, 30.0)]])
def test_the_chart_has_each_waypoint(points: list[tuple[float, float]]) -> None:
    found: Any = profile_options(points, METRIC)
    [series] = found["series"]
    assert series["data"] == [[round(far, 1), height] for far, height in points]


def test_the_chart_is_in_the_unit_that_was_chosen() -> None:
    found: Any = profile_options([(100.0, 30.48)], Units(LengthUnit.FOOT))
    assert found["series"][0]["data"] == [[328.1, 100.0]]
    assert found["yAxis"]["axisLabel"]["formatter"] == "{value} ft"
