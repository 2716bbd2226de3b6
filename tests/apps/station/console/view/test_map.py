"""What was pointed at becomes an order, with what it takes and why it is refused beside it."""

from __future__ import annotations

import math

import pytest

from m100link.apps.agent.messages import GuardLimits, State
from m100link.apps.agent.orders import (
    ChangeHeading,
    ChangeHeight,
    FlyAround,
    FlyTo,
    GuidedFlight,
    Life,
)
from m100link.apps.agent.preview import Preview
from m100link.apps.station.console.tab import IssuedOrder
from m100link.apps.station.console.view.map import (
    Drawing,
    GuidedKind,
    Pointed,
    Shown,
    chart_of,
    click_of,
)
from m100link.apps.station.console.view.situation import Inputs
from m100link.apps.station.console.view.texts import Language, Text, Translator
from m100link.errors import GuardRefused, LinkError, M100Error, NotObserved, UsageError
from m100link.geodesy import LocalFrame
from m100link.missions.plan import WaypointPlan
from m100link.missions.waypoint import Waypoint
from tests.known import seen

HERE = 52.1, 4.31
SAY = Translator()


def said(text: Text | None, language: Language = Language.ENGLISH) -> str:
    assert text is not None
    return Translator(language)(text)


FORESEEN = Preview(distance_m=83.2, climb_m=5.0, turn_deg=90.0, seconds=75.0, battery_percent=7.4)


def test_a_point_becomes_a_flight_there() -> None:
    assert Pointed().order is None
    pointed = Pointed().at(*HERE).changed("height", 12).changed("speed", 3.5)
    assert pointed.order == FlyTo(*HERE, height=12.0, speed=3.5)


def test_a_hold_confirms_what_the_preview_showed_when_it_began() -> None:
    shown = Shown()
    first = Pointed().at(*HERE)
    number = shown.show(first)
    assert shown.show(first) == number
    shown.check(str(number), first)  # as it comes back from an attribute of the page
    moved = first.at(HERE[0] + 0.0001, HERE[1])
    with pytest.raises(GuardRefused, match="the point changed while the button was held"):
        shown.check(str(number), moved)  # the preview does not show it yet
    assert shown.show(moved) != number
    with pytest.raises(GuardRefused) as refused:
        shown.check(str(number), moved)  # it does, but not when the hold began
    assert refused.value.guard == "order_changed"
    shown.show(first)
    with pytest.raises(GuardRefused):
        shown.check(str(number), first)  # there and back again is a change, too
    nothing: object
    for nothing in (None, "", 7.5, {}):
        with pytest.raises(GuardRefused):
            shown.check(nothing, first)


def test_around_it_up_and_round() -> None:
    circle = Pointed(GuidedKind.CIRCLE, radius=20.0, turns=2.0, clockwise=False).at(*HERE)
    assert circle.order == FlyAround(
        *HERE, height=10.0, radius=20.0, speed=5.0, turns=2.0, clockwise=False
    )
    assert Pointed(GuidedKind.HEIGHT).changed("height", 30).order == ChangeHeight(30.0)
    assert Pointed(GuidedKind.HEADING).changed("yaw_deg", -90).order == ChangeHeading(270.0)


def test_pointing_again_is_a_flight_there_but_a_circle_stays_one() -> None:
    assert Pointed(GuidedKind.HEIGHT).at(*HERE).kind is GuidedKind.PLACE
    assert Pointed(GuidedKind.CIRCLE).at(*HERE).kind is GuidedKind.CIRCLE


@pytest.mark.parametrize(
    ("name", "value", "kept"),
    [("height", 1e9, 120.0), ("height", -5, 2.0), ("speed", 99, 10.0), ("turns", 0, 0.25)],
)
def test_numbers_stay_within_what_is_offered(name: str, value: float, kept: float) -> None:
    assert getattr(Pointed().changed(name, value), name) == kept


@pytest.mark.parametrize("value", [None, "", "12", math.nan, math.inf])
def test_nonsense_from_the_page_changes_nothing(value: object) -> None:
    assert Pointed().changed("height", value) == Pointed()
    assert Pointed().at(math.nan, 0.0) == Pointed()
    assert Pointed().at(95.0, 0.0) == Pointed()


def test_an_operator_who_cannot_point_gives_distance_and_bearing() -> None:
    for bearing, expected in ((90.0, (0.0, 100.0)), (210.0, (-86.6025, -50.0))):
        pointed = Pointed().by_distance(HERE, 100.0, bearing)
        assert pointed.place is not None
        assert LocalFrame(*HERE).to_local(*pointed.place) == pytest.approx(expected, abs=1e-3)


def test_the_preview_is_said_in_the_words_and_units_of_the_operator() -> None:
    view = click_of(Pointed().at(*HERE), FORESEEN, None, has_control=True)
    assert said(view.preview) == "83 m, about 1:15 min, 7.4 % of a battery"
    assert said(view.preview, Language.GERMAN) == "83 m, etwa 1:15 min, 7,4 % eines Akkus"
    assert view.may_fly
    assert view.refusals == ()
    assert view.pointed == Drawing(HERE)
    climb = click_of(Pointed(GuidedKind.HEIGHT), FORESEEN, None, has_control=True)
    assert said(climb.preview).startswith("+5.0 m, about")
    turn = click_of(Pointed(GuidedKind.HEADING, yaw_deg=90.0), FORESEEN, None, has_control=True)
    assert said(turn.preview).startswith("90°, about")
    assert turn.pointed == Drawing(yaw_deg=90.0)


def test_without_a_point_or_control_nothing_can_be_held() -> None:
    nothing = click_of(Pointed(), None, None, has_control=True)
    assert not nothing.may_fly
    assert nothing.preview is None
    view = click_of(Pointed().at(*HERE), FORESEEN, None, has_control=False)
    assert not view.may_fly
    (refusal,) = view.refusals
    assert not isinstance(refusal.remedy, str)
    assert SAY(refusal.remedy) == "Obtain control first."


@pytest.mark.parametrize(
    ("error", "remedy"),
    [
        (GuardRefused("too far", guard="envelope", measured=1, limit=2), "orange circle"),
        (GuardRefused("empty", guard="battery_floor_percent", measured=1, limit=2), "Land"),
        (GuardRefused("none", guard="gps", measured=1, limit=2), "Wait for GPS"),
        (GuardRefused("old", guard="way_late", measured=1, limit=2, remedy="wait"), "wait"),
        (UsageError("fly_to was asked for on the ground", remedy="await take_off()"), "Take off"),
        (UsageError("too fast a circle", remedy="at most 3 m/s"), "at most 3 m/s"),
        (LinkError("gone"), "Wait for the position"),
    ],
)
def test_a_refusal_has_its_reason_and_a_remedy_for_the_pointing_operator(
    error: M100Error, remedy: str
) -> None:
    foreseen = Preview(refusals=(error,))
    view = click_of(Pointed().at(*HERE), foreseen, None, has_control=True)
    assert not view.may_fly
    (refusal,) = view.refusals
    assert said(refusal.reason) == error.seen
    remedies = refusal.remedy if isinstance(refusal.remedy, str) else SAY(refusal.remedy)
    assert remedy in remedies


@pytest.mark.parametrize(
    ("guided", "told"),
    [
        (GuidedFlight("flight to a place"), "Flight to the point"),
        (GuidedFlight("change of heading", seconds=3.0), "Turn: 0:03 min to go"),
        (
            GuidedFlight("flight around a place", *HERE, 10.0, 15.0, None, 94.0, 47.0),
            "Flight around the point: 94 m, 0:47 min to go",
        ),
        (GuidedFlight("change of height", distance_m=4.0, seconds=2.0), "Change of height: 4 m,"),
    ],
)
def test_what_flies_is_said_to_everybody(guided: GuidedFlight, told: str) -> None:
    view = click_of(Pointed(), None, guided, has_control=False)
    assert said(view.flying).startswith(told)
    if guided.latitude_deg is not None:
        assert view.flown == Drawing(HERE, 15.0)


FLIES = GuidedFlight("flight to a place", *HERE, 10.0, 0.0, None, 94.0, 47.0)
ORDER = FlyTo(*HERE, 10.0)


@pytest.mark.parametrize(
    ("life", "guided", "english", "german"),
    [
        (Life.SENT, None, "Flight to the point: asked", "Flug zum Punkt: verlangt"),
        (Life.ACCEPTED, FLIES, "47 min to go. Accepted, not flown yet", "noch nicht geflogen"),
        (Life.FLOWN, FLIES, "Flight to the point: 94 m, 0:47 min to go", "noch 94 m, 0:47 min"),
        (Life.OLD, FLIES, "to go. No news of the aircraft", "ist nichts zu hören"),
        (Life.DONE, None, "Flight to the point: reached", "Flug zum Punkt: erreicht"),
        (Life.REFUSED, None, "Flight to the point: refused", "Flug zum Punkt: verweigert"),
        (Life.ENDED, None, "Flight to the point: ended. stop", "Flug zum Punkt: beendet. "),
    ],
)
def test_the_target_shows_how_far_its_order_has_come(
    life: Life, guided: GuidedFlight | None, english: str, german: str
) -> None:
    own = IssuedOrder(3, 0.0, ORDER, life=life, why=NotObserved("stop"))
    view = click_of(Pointed(), None, guided, has_control=True, own=own)
    assert view.flown == Drawing(HERE, life=life)
    assert said(view.flying).endswith(english)
    assert german in said(view.flying, Language.GERMAN)


def test_a_flight_of_another_page_is_drawn_after_the_end_of_ones_own() -> None:
    over = IssuedOrder(3, 0.0, FlyTo(1.0, 2.0, 10.0), life=Life.ENDED, why=NotObserved("stop"))
    view = click_of(Pointed(), None, FLIES, has_control=True, own=over)
    assert view.flown == Drawing(HERE, life=Life.FLOWN)
    assert said(view.flying).startswith("Flight to the point: 94 m")
    asked = IssuedOrder(4, 0.0, FlyTo(1.0, 2.0, 10.0))
    view = click_of(Pointed(), None, FLIES, has_control=True, own=asked)
    assert view.flown == Drawing((1.0, 2.0), life=Life.SENT)


# -- what stands on the map ------------------------------------------------------------------------

LIMITS = GuardLimits(max_radius_m=150.0, latitude_deg=22.5, longitude_deg=113.9)


def test_the_envelope_lies_around_where_control_was_obtained() -> None:
    state = State(0.0, "connected", limits=LIMITS)
    assert chart_of(Inputs(vehicle=seen(None, state=state))).fence == ((22.5, 113.9), 150.0)
    assert chart_of(Inputs(vehicle=seen(None, state=state, heard_at=-9.0))).fence is None
    assert (
        chart_of(
            Inputs(vehicle=seen(None, state=State(0.0, limits=GuardLimits(max_radius_m=150.0))))
        ).fence
        is None
    )
    assert chart_of(Inputs(vehicle=seen(None, state=State(at=0.0)))).fence is None


def test_the_route_is_that_of_the_plan() -> None:
    places = [(22.54325, 113.9589), (22.54325, 113.95905)]
    plan = WaypointPlan([Waypoint(*place, height=6) for place in places], speed=5)
    assert chart_of(Inputs(vehicle=seen(None, state=State(at=0.0)), plan=plan)).route == tuple(
        places
    )
    assert chart_of(Inputs(vehicle=seen(None, state=State(at=0.0)))).route == ()
