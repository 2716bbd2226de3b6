"""Components as tables: what is pressed, typed and pointed at in, and orders, values and words out.

The elements are those of the page, without a browser: their handlers are called as its events do.
"""

from __future__ import annotations

import inspect
import json
import math
import re
import time
from collections.abc import Callable, Generator, Iterator
from contextlib import suppress
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import pytest

pytest.importorskip("nicegui")

from nicegui import Client, ui
from nicegui.events import GenericEventArguments
from nicegui.page import page as page_of_nicegui

from m100link.apps.agent import orders
from m100link.apps.agent.lease import LeaseHeld
from m100link.apps.station.config import Video
from m100link.apps.station.console.components import data, fly, header, plan, settings
from m100link.apps.station.console.components.component import (
    Buttons,
    NumberField,
    PageContext,
    Wording,
)
from m100link.apps.station.console.components.map import ClickPart, MapPart
from m100link.apps.station.console.kept import PlotHistory
from m100link.apps.station.console.view import fly as view_of_fly
from m100link.apps.station.console.view.alarms import ActiveAlarm, AlarmName, AlarmState
from m100link.apps.station.console.view.data import LINK_ITEMS, EventLine
from m100link.apps.station.console.view.fly import HELD
from m100link.apps.station.console.view.header import FleetRow
from m100link.apps.station.console.view.plan import Draft, row_of
from m100link.apps.station.console.view.situation import AlarmLevel, Situation
from m100link.apps.station.console.view.texts import (
    DisplaySettings,
    LengthUnit,
    QuantityKind,
    SpeedUnit,
    Text,
    Theme,
    tr,
)
from m100link.apps.station.console.view.view_model import Memory
from m100link.apps.station.web.tiles import MapTiles, Pictures
from m100link.errors import GuardRefused, UsageError
from m100link.geodesy import distance_m
from m100link.missions.plan import WaypointPlan
from m100link.protocol.commands.gimbal import GimbalAngle, GimbalAngleMode, GimbalSpeed
from m100link.protocol.records import Attitude, Position
from m100link.sim.clock import virtual_clock_loop
from tests.known import LATITUDE, LONGITUDE, position, quaternion
from tests.known import seen as known_view

pytestmark = pytest.mark.anyio


@pytest.fixture
def anyio_backend() -> tuple[str, dict[str, Any]]:
    return "asyncio", {"loop_factory": virtual_clock_loop}


class Here:
    """A page without a browser, of an aircraft that notes what it is asked for."""

    def __init__(self) -> None:
        self.client = Client(page_of_nicegui("/here"), request=None)
        self.notes: list[tuple[Any, ...]] = []
        self.works: list[Any] = []
        self.whose: list[str] = []
        self.replaces: bool | None = None  # whether the last order ends what flies
        self.place: Position | None = position()
        self.wording = Wording()
        self.raises: Exception | None = None
        session = SimpleNamespace(
            name="anna", lease="the lease", uploaded="the digest", has_lease=True, has_control=True,
            ask=self._async("ask"), obtain=self._async("obtain"),
            give_back=self._async("give_back"),
        )  # fmt: skip
        self.tab = SimpleNamespace(
            session=session, aircraft="m100", refusal=None,
            attempt=self._attempt, check_order=self._note("check_order"),
            ask=session.ask, shown_flight=lambda: None,
            stop=self._async("stop"), has_ended=lambda *_: False,
        )  # fmt: skip
        self.agent = SimpleNamespace(
            now=12.34, asked_at=12.34, plan=None, plan_by="", telemetry=None,
            note=self._note("note"), ask=self._async("agent"), hover=self._note("hover"),
            view=SimpleNamespace(get=lambda kind: self.place if kind is Position else None),
            background=SimpleNamespace(spawn=self._spawn),
            state=SimpleNamespace(guided=None, limits=SimpleNamespace(max_height_m=None)),
        )  # fmt: skip
        tab, agent = cast(Any, self.tab), cast(Any, self.agent)
        history = PlotHistory()
        self.page = PageContext(
            agent, tab, None, Buttons(agent, tab, self.wording), Memory(), self.wording,
            cast(Any, SimpleNamespace(set_value=self._note("dark"))), self._async("show"),
            MapTiles(), lambda _: history, cast(Any, SimpleNamespace(agents=())),
        )  # fmt: skip

    def _note(self, name: str) -> Callable[..., None]:
        return lambda *values: self.notes.append((name, *values))

    def _async(self, name: str) -> Callable[..., Any]:
        async def call(*values: Any) -> None:
            self.notes.append((name, *(one for one in values if not callable(one))))
            if self.raises is not None:
                raise self.raises

        return call

    async def _attempt(self, work: Callable[[], Any], *, replaces: bool = True) -> None:
        self.replaces = replaces
        await work()

    def _spawn(self, work: Any, whose: str) -> None:
        self.works.append(work)
        self.whose.append(whose)

    def make(self, part: Callable[[PageContext], Any]) -> Any:
        """A part of the page."""
        with self.client:
            return part(self.page)

    def find(self, **props: object) -> Any:
        """The element with these properties, whose hyphens are underscores here."""
        wanted = {name.rstrip("_").replace("_", "-"): value for name, value in props.items()}
        [found] = [
            one
            for one in self.client.elements.values()
            if all(one.props.get(name) == value for name, value in wanted.items())
        ]
        return found

    async def event(self, element: Any, kind: str, args: Any = None) -> None:
        """As the browser sends it; work that it began is done afterwards."""
        listeners = [one for one in element._event_listeners.values() if one.type == kind]
        assert listeners, f"nobody listens for {kind}"
        for one in listeners:
            given = GenericEventArguments(sender=element, client=self.client, args=args)
            handler = one.handler
            takes = [
                each
                for each in inspect.signature(handler).parameters.values()
                if each.default is each.empty and each.kind is not each.KEYWORD_ONLY
            ]
            with element if element.parent_slot else self.client:
                done = handler(given) if takes else handler()
                if inspect.isawaitable(done):
                    await done
        works, self.works = self.works, []
        for work in works:
            await work

    async def say(self, kind: str, /, **args: Any) -> None:
        """An event of the page as a whole."""
        await self.event(self.client.layout, kind, args)

    async def press(self, element: Any, **said: Any) -> None:
        kinds = {one.type for one in element._event_listeners.values()}
        [kind] = kinds & {"click", "held", "stopped"}
        await self.event(element, kind, said or None)

    def type(self, name: str, value: Any) -> None:
        """Into the field of that name."""
        field = self.find(for_=name)
        with self.client:
            field.set_value(value)


@pytest.fixture
def here(monkeypatch: pytest.MonkeyPatch) -> Iterator[Here]:
    made = Here()
    monkeypatch.setattr(ui, "run_javascript", lambda code: made.notes.append(("script", code)))
    monkeypatch.setattr(ui.download, "content", lambda *what: made.notes.append(("saved", *what)))
    monkeypatch.setattr(ui, "timer", lambda *_, **__: None)
    yield made
    Client.instances.pop(made.client.id, None)


# -- a number is typed in the operator's unit, and kept in that of the protocol --------------------


def height_field(here: Here, **options: Any) -> tuple[NumberField, list[float | None]]:
    """Of a height in m, of at most 120 m, and what somebody typed into it so far."""
    typed: list[float | None] = []
    options = {"kind": QuantityKind.LENGTH, "limits": (2.0, 120.0), "value": 30.0, **options}
    with here.client:
        field = NumberField(here.wording, "actions.height", "", changed=typed.append, **options)
    return field, typed


def test_a_number_is_typed_from_the_first_on_in_the_unit_that_is_shown(here: Here) -> None:
    """A foot is 0.3048 m. What the page shows by itself was typed by nobody."""
    field, typed = height_field(here)
    with here.client:
        assert (field.element.value, field.value) == (30.0, 30.0)
        field.element.set_value(25.0)
        assert (field.value, typed) == (25.0, [25.0])
        here.wording.choose(replace(here.wording.settings, length=LengthUnit.FOOT))
        assert (field.element.value, field.value) == (82.02, 25.0)
        assert field.shown_limits == (6.56, 393.7)
        assert (field.element.min, field.element.max) == (6.56, 393.7)
        field.element.set_value(100.0)
        assert field.value == typed.pop() == pytest.approx(30.48)
        field.set(91.44)  # 300 ft are more than the limit as a number of metres
        here.wording.choose(replace(here.wording.settings, length=LengthUnit.METRE))
        assert (field.element.value, field.value, typed) == (91.44, 91.44, [25.0])
        here.wording.choose(replace(here.wording.settings, length=LengthUnit.FOOT))
        field.set(3.048)
        assert (field.element.value, field.value) == (10.0, 3.048)
        here.wording.choose(replace(here.wording.settings, length=LengthUnit.METRE))
        assert (field.element.value, field.value) == (3.05, 3.048)
        assert typed == [25.0]
        field.element.set_value(None)
        assert (field.value, typed) == (None, [25.0, None])
        field.element.set_value(3.05)
        assert (field.value, typed) == (3.05, [25.0, None, 3.05])


def test_a_number_without_a_unit_is_the_same_in_every_unit(here: Here) -> None:
    field, typed = height_field(here, kind=None, limits=(None, 8.0), value=None)
    with here.client:
        here.wording.choose(replace(here.wording.settings, length=LengthUnit.FOOT))
        field.element.set_value(7)
    assert (field.value, typed, field.shown_limits) == (7, [7], (None, 8.0))


# -- plots: the page gets each point once, and all of them anew when what is drawn changes ---------


def test_a_plot_is_sent_whole_and_then_what_is_new(here: Here) -> None:
    """Milliseconds since 1970. A paused chart stands still, and is whole when it goes on."""
    history = here.page.history

    def add(*times: float) -> None:
        for utc in times:
            history.add(utc, known_view(None))

    def sent() -> list[tuple[int, list[int], int]]:
        """Which drawing, the times of its points, and how long its range is, ms."""
        here.notes.clear()
        part.update(SimpleNamespace(replay=None, flight=None))
        rows = [code for kind, code in here.notes if kind == "script" and "addRows" in code]
        found = []
        for code in rows:
            chart, _, given = code.partition("addRows(")[2][:-2].partition(",...")
            which, drawn, range_ms = json.loads(given)
            assert int(chart) == part._chart.id
            found.append((which, [at for at, *_ in drawn], range_ms))
        return found

    add(1.0, 1.1)
    part = here.make(data.PlotsPart)
    assert sent() == [(1, [1000, 1100], 60_000)]
    assert sent() == []
    add(1.2)
    assert sent() == [(1, [1200], 60_000)]
    part._set_range(SimpleNamespace(value=120))
    add(1.3)
    assert sent() == [(2, [1000, 1100, 1200, 1300][::2], 120_000)]
    part._set_range(SimpleNamespace(value=30))
    part._toggle()
    add(1.4)
    assert sent() == [(3, [1000, 1100, 1200, 1300], 30_000)]
    assert sent() == []
    part._toggle()
    assert sent() == [(4, [1000, 1100, 1200, 1300, 1400], 30_000)]
    part._choose(SimpleNamespace(value=["line.discards"]))
    add(1.5)
    assert sent() == [(5, [1000, 1100, 1200, 1300, 1400, 1500], 30_000)]
    add(*(2.0 + number / 10 for number in range(301)))  # more than the range: nobody sees the rest
    [(which, times, _)] = sent()
    assert (which, len(times), times[-1]) == (6, 300, 32_000)
    add(32.1, 32.2, 32.3, 32.4)
    assert sent() == [(6, [32_100, 32_200, 32_300, 32_400], 30_000)]


# -- the pad: mode 2, the left stick climbs and turns ----------------------------------------------


def test_the_pad_has_the_sticks_of_mode_2_and_a_button_for_each_step_of_speed(here: Here) -> None:
    """Each axis is positive to the right, or up, as docs/howto/console.md says."""
    here.make(fly.SticksPart)
    shown = [one.props for one in here.client.elements.values()]
    sticks = [(one["data-axes"], one["aria-label"]) for one in shown if "data-axes" in one]
    assert sticks == [
        ("turn,up", "stick: climb and turn"),
        ("right,forward", "stick: move"),
    ]
    steps = [
        (
            one.props["data-steer"],
            one.props["aria-label"],
            cast(Any, one.default_slot.children[0]).text,
        )
        for one in here.client.elements.values()
        if one.props.get("data-steer") in ("slower", "faster")
    ]
    assert steps == [("slower", "slower", "−"), ("faster", "faster", "+")]


# -- orders ---------------------------------------------------------------------------------------

ENDS = {"stop", "pause", "release", "mission_stop"}
STAYS = {"obtain", "photo", "video_start", "video_stop", "gimbal_centre"}


def click_part(page: PageContext) -> ClickPart:
    return ClickPart(page, ui.element("div"))


ORDERS: list[tuple[Any, str, tuple[Any, ...]]] = [
    (header.StatusPart, "obtain", ("obtain",)),
    (header.StatusPart, "release", ("give_back",)),
    (fly.StripPart, "land", ("ask", orders.Land())),
    (fly.StripPart, "go_home", ("ask", orders.GoHome())),
    (fly.StripPart, "pause", ("ask", orders.PauseMission())),
    (plan.PlanPart, "simple_task", ("ask", orders.FlyPattern(0))),
    (plan.PlanPart, "mission_start", ("ask", orders.StartMission("the digest"))),
    (plan.PlanPart, "mission_resume", ("ask", orders.ResumeMission())),
    (plan.PlanPart, "mission_stop", ("ask", orders.StopMission())),
    (fly.HudPart, "photo", ("ask", orders.UseCamera(orders.CameraUse.PHOTO))),
    (fly.HudPart, "video_start", ("ask", orders.UseCamera(orders.CameraUse.START_VIDEO))),
    (fly.HudPart, "video_stop", ("ask", orders.UseCamera(orders.CameraUse.STOP_VIDEO))),
]


@pytest.mark.parametrize(("part", "name", "asked"), ORDERS)
async def test_each_button_gives_its_order_and_late_ones_end_motions_only(
    here: Here, part: Any, name: str, asked: tuple[Any, ...]
) -> None:
    here.make(part)
    button = here.find(data_act=name)
    here.notes.clear()
    await here.press(button, press=3, at=12.0)
    assert ("script", "m100.answered(3)") in here.notes
    done = [note for note in here.notes if note[0] not in ("script", "note")]
    assert done == ([asked] if name in ENDS else [("check_order", 12.0), asked])
    kinds = {one.type for one in button._event_listeners.values()}
    assert ("held" in kinds, "click" in kinds) == (name in HELD, name not in HELD)
    assert here.whose == [f"{name} of anna"]
    assert here.replaces is (name not in STAYS)


async def test_a_pause_of_a_flight_to_a_point_is_a_hover(here: Here) -> None:
    here.make(fly.StripPart)
    here.agent.state.guided = "a flight"
    await here.press(here.find(data_act="pause"), press=3)
    assert here.notes[-1] == ("hover", "anna: pause", "the lease")


@pytest.mark.parametrize(
    ("said", "speeds"),
    [
        ({"yaw": 1, "pitch": -0.5}, (40.0, -20.0)),
        ({"yaw": -3.0, "pitch": 9}, (-40.0, 40.0)),
        ({"yaw": "1", "pitch": 0}, None),
        ({"yaw": 1}, None),
    ],
)
async def test_the_gimbal_turns_up_to_forty_degrees_a_second(
    here: Here, said: dict[str, Any], speeds: tuple[float, float] | None
) -> None:
    here.make(fly.HudPart)
    await here.say("looked", **said)
    asked = [note for note in here.notes if note[0] == "ask"]
    if speeds is None:
        assert asked == []
        return
    turn = orders.TurnGimbal(GimbalSpeed(yaw_deg_s=speeds[0], pitch_deg_s=speeds[1]))
    assert asked == [("ask", turn)]
    assert here.whose == ["gimbal of anna"]


async def test_the_slider_pitches_the_gimbal_and_nothing_else(here: Here) -> None:
    """Degrees, in half a second; heading and roll stay."""
    part = here.make(fly.HudPart)
    with here.client:
        part._pitch.set_value(-45.0)
    await here.event(part._pitch, "change")
    keep = GimbalAngleMode.KEEP_YAW | GimbalAngleMode.KEEP_ROLL | GimbalAngleMode.ABSOLUTE
    angle = GimbalAngle(0, 0, -45.0, keep, 0.5)
    assert here.notes[-1] == ("ask", orders.PointGimbal(angle))
    assert (part._pitch.props["min"], part._pitch.props["max"]) == (-90.0, 30.0)
    part._asked = "photo", here.agent.now - 3.4
    readings = {"gimbal": SimpleNamespace(text=Text("camera.none"))}
    part.update(SimpleNamespace(instruments=SimpleNamespace(readings=readings), actions=()))
    asked = here.wording(tr("camera.photo.asked", seconds=3))
    assert part._state.text == f"{here.wording(Text('camera.none'))} · {asked}"


@pytest.mark.parametrize(
    ("attitude", "angle"),
    [
        (
            Attitude(*quaternion(5.0, -3.0, 117.0)),
            GimbalAngle(117.0, 0, 0, GimbalAngleMode.ABSOLUTE, 0.5),
        ),
        (None, GimbalAngle(0, 0, 0, GimbalAngleMode.ABSOLUTE | GimbalAngleMode.KEEP_YAW, 0.5)),
    ],
)
async def test_centred_the_gimbal_looks_where_the_nose_does_as_far_as_that_is_known(
    here: Here, attitude: Attitude | None, angle: GimbalAngle
) -> None:
    """Its heading is absolute: 0 would be north."""
    here.make(fly.HudPart)
    here.agent.view = SimpleNamespace(get=lambda kind: attitude if kind is Attitude else None)
    await here.press(here.find(data_act="gimbal_centre"), press=3)
    [given] = [note[1].angles for note in here.notes if note[0] == "ask"]
    assert (given.yaw_deg, given.roll_deg, given.pitch_deg) == pytest.approx(
        (angle.yaw_deg, 0, 0), abs=1e-6
    )
    assert (given.mode, given.duration_s) == (angle.mode, 0.5)


async def test_stop_is_given_by_its_own_event_and_hears_of_its_press(here: Here) -> None:
    with here.client:
        stop = here.page.buttons.add("stop", "actions.stop", here.tab.stop, kind="stop")
    await here.press(stop, press=4)
    assert here.notes == [("script", "m100.answered(4)"), ("stop", 4)]
    assert {one.type for one in stop._event_listeners.values()} == {"stopped"}


@pytest.mark.parametrize(
    ("what", "guard"),
    [("shifted", "page_shifted"), ("withdrawn", "not_offered"), ("unsure", "order_late")],
)
async def test_a_hold_that_gives_no_order_says_why(here: Here, what: str, guard: str) -> None:
    here.make(fly.StripPart)
    await here.event(here.find(data_act="land"), what, {"press": 5})
    assert here.notes[-1] == ("script", "m100.answered(5)")
    assert not any(note[0] == "ask" for note in here.notes)
    refusal: Any = here.tab.refusal
    assert refusal.guard == guard


@pytest.mark.parametrize("said", [None, {}, {"press": "3"}, {"press": True}, ["x"]])
async def test_a_press_without_a_number_is_not_answered(here: Here, said: Any) -> None:
    here.make(fly.StripPart)
    here.notes.clear()
    await here.event(here.find(data_act="land"), "held", said)
    assert [note[0] for note in here.notes] == ["check_order", "ask"]
    assert here.notes[0] == ("check_order", None)


def test_a_button_is_grey_unless_it_is_offered(here: Here) -> None:
    here.make(fly.StripPart)
    grey = []
    for offered in (set[str](), {"land"}, {"land"}, {"pause"}):
        here.page.buttons.update(offered)
        names = ("land", "pause", "go_home")
        grey.append([bool(here.find(data_act=name).props.get("disabled")) for name in names])
    land, pause = [False, True, True], [True, False, True]
    assert grey == [[True] * 3, land, land, pause]


async def test_the_simple_task_is_the_one_that_was_chosen(here: Here) -> None:
    part = here.make(plan.PlanPart)
    with here.client:
        part._number.set_value(4)
    await here.press(here.find(data_act="simple_task"), at=1.0)
    assert here.notes[-1] == ("ask", orders.FlyPattern(4))
    assert list(part._number.options) == [0, 1, 4]


# -- a plan is drawn ------------------------------------------------------------------------------

A, B, C = [52.1, 4.3], [52.2, 4.4], [52.3, 4.5]


def drawn(here: Here) -> tuple[Any, Any]:
    """The part, and what reads its draft."""
    part = here.make(plan.PlanPart)
    return part, lambda: [
        (round(p.latitude_deg, 5), round(p.longitude_deg, 5), p.height) for p in part._draft.points
    ]


async def test_what_is_pointed_at_becomes_points_behind_the_chosen_one(here: Here) -> None:
    """The first is 20 m high, the others as high as the one before."""
    part, points = drawn(here)
    for place in (A, B):
        await here.say("map_pointed", view="plan", place=place)
    await here.say("map_pointed", view="fly", place=C)
    await here.say("map_pointed", view="plan", place=[52.1])
    await here.say("map_pointed", view="plan", place=[52.1, 361])
    assert points() == [(*A, 20.0), (*B, 20.0)]
    assert (part._chosen, part._waypoint._title.text) == (1, "2")
    labels = [one.text for one in here.client.elements.values() if isinstance(one, ui.label)]
    rows = [here.wording(row_of(n, point)) for n, point in enumerate(part._draft.points, 1)]
    assert [text for text in labels if text in rows] == rows
    await here.say("plan_chosen", index=0)
    here.type("waypoint-height", 7.5)
    await here.say("map_pointed", view="plan", place=C)
    assert points() == [(*A, 7.5), (*C, 7.5), (*B, 20.0)]
    assert part._chosen == 1


async def test_points_are_moved_put_elsewhere_and_removed(here: Here) -> None:
    part, points = drawn(here)
    for place in (A, B, C):
        await here.say("map_pointed", view="plan", place=place)
    names = dict(zip(map_(points()), "abc", strict=True))

    def order() -> str:
        return "".join(names[one] for one in map_(points()))

    steps = [("earlier", "acb", 1), ("earlier", "cab", 0), ("earlier", "cab", 0)]
    steps += [("later", "acb", 1), ("remove", "ab", 1), ("undo", "acb", 1), ("redo", "ab", 1)]
    for tool, after, chosen in steps:
        await here.press(here.find(data_plan=tool))
        assert (order(), part._chosen) == (after, chosen), tool
    await here.say("plan_moved", index=0, place=[50.0, 3.0], kind="point")
    assert points()[0][:2] == (50.0, 3.0)
    assert part._chosen == 0
    await here.say("plan_moved", index="0", place=[51.0, 3.0], kind="point")
    assert points()[0][:2] == (50.0, 3.0)
    await here.press(here.find(data_plan="clear"))
    assert (points(), part._chosen) == ([], None)


def map_(points: list[tuple[float, ...]]) -> list[tuple[float, ...]]:
    return [one[:2] for one in points]


@pytest.mark.parametrize(
    ("is_known", "first"), [(True, (LATITUDE, LONGITUDE)), (False, (0.0, 0.0))]
)
async def test_a_point_is_added_where_the_aircraft_is_and_then_to_the_north(
    here: Here, is_known: bool, first: tuple[float, float]
) -> None:
    """22 m, which are two ten-thousandths of a degree."""
    if not is_known:
        here.place = None
    part, points = drawn(here)
    add = here.find(data_plan="add")
    for _ in range(3):
        await here.press(add)
        part._chosen = None  # so the last one counts
    (one, two, three) = map_(points())
    assert one == pytest.approx(first, abs=1e-5)
    assert two == pytest.approx((one[0] + 2e-4, one[1]), abs=1e-5)
    assert three == pytest.approx((one[0] + 4e-4, one[1]), abs=1e-5)


async def test_clicks_make_corners_while_an_area_is_drawn(here: Here) -> None:
    part, points = drawn(here)

    def pressed(word: str) -> object:
        return here.find(data_plan=word).props["aria-pressed"]

    assert (pressed("points"), pressed("area")) == ("true", "false")
    await here.press(here.find(data_plan="area"))
    assert (pressed("points"), pressed("area")) == ("false", "true")
    for place in (A, B, C):
        await here.say("map_pointed", view="plan", place=place)
    await here.say("plan_moved", index=1, place=[50.0, 3.0], kind="corner")
    assert [tuple(one) for one in part._draft.area] == [tuple(A), (50.0, 3.0), tuple(C)]
    assert points() == []


FIELDS = [
    ("waypoint-height", 33.0, "height", 33.0),
    ("waypoint-heading", -90.0, "heading_deg", -90.0),
    ("waypoint-pitch", -45.0, "gimbal_pitch_deg", -45.0),
    ("waypoint-latitude", 51.5, "latitude_deg", 51.5),
    ("waypoint-longitude", -3.25, "longitude_deg", -3.25),
]


@pytest.mark.parametrize(("field", "typed", "name", "value"), FIELDS)
async def test_what_is_typed_of_a_point(
    here: Here, field: str, typed: float, name: str, value: float
) -> None:
    part, _ = drawn(here)
    for place in (A, B):
        await here.say("map_pointed", view="plan", place=place)
    here.type(field, typed)
    assert getattr(part._draft.points[1], name) == value
    assert getattr(part._draft.points[0], name) != value
    # The fields show the point that is chosen, and showing types nothing.
    before = part._draft
    await here.say("plan_chosen", index=0)
    assert here.find(for_=field).value == pytest.approx(getattr(before.points[0], name))
    assert part._draft is before


async def test_feet_are_metres_in_the_plan(here: Here) -> None:
    part, points = drawn(here)
    await here.say("map_pointed", view="plan", place=A)
    with here.client:
        here.wording.choose(
            replace(here.wording.settings, length=LengthUnit.FOOT, speed=SpeedUnit.KM_H)
        )
    assert here.find(for_="waypoint-height").value == pytest.approx(65.62)
    here.type("waypoint-height", 100.0)
    assert points()[0][2] == pytest.approx(30.48)
    here.type("plan-speed", 18.0)
    assert part._draft.speed == pytest.approx(5.0)


@pytest.mark.parametrize(("speed", "at_most"), [(4.0, 10.0), (12.0, 12.0)])
def test_the_stick_may_be_as_fast_as_the_plan(here: Here, speed: float, at_most: float) -> None:
    part, _ = drawn(here)
    here.type("plan-speed", speed)
    assert (part._draft.speed, part._draft.max_speed) == (speed, at_most)


@pytest.mark.parametrize("name", ["at_end", "nose", "trace"])
def test_what_holds_for_the_whole_plan_is_chosen(here: Here, name: str) -> None:
    part, _ = drawn(here)
    field = {"nose": "heading"}.get(name, name)
    usual = getattr(part._draft, field)
    other = next(one for one in type(usual) if one is not usual)
    here.type(f"plan-{name}", int(other))
    assert getattr(part._draft, field) is other
    assert not any(note[0] == "ask" for note in here.notes)


@pytest.mark.parametrize("takes_off", [True, False])
@pytest.mark.parametrize("stands", [True, False, None])
async def test_a_start_on_the_ground_takes_off_only_for_a_plan_that_begins_so(
    here: Here, monkeypatch: pytest.MonkeyPatch, *, takes_off: bool, stands: bool | None
) -> None:
    part, _ = drawn(here)
    for place in (A, [52.1001, 4.3]):
        await here.say("map_pointed", view="plan", place=place)
    with here.client:
        here.find(id="plan-take-off").set_value(takes_off)
    assert part._draft.take_off is takes_off
    here.agent.plan = WaypointPlan.from_wire(*part._draft.plan().to_wire())
    monkeypatch.setattr(Situation, "is_on_ground", stands)
    start = here.find(data_act="mission_start")
    before = list(here.notes)

    async def press() -> list[Any]:
        here.notes[:] = before
        with suppress(UsageError):
            await here.event(start, "held", {"at": 1.0, "press": 1})
        return [note[1] for note in here.notes if note[0] == "ask"]

    refused = stands is True and not takes_off
    assert await press() == ([] if refused else [orders.StartMission("the digest", takes_off)])
    # What is drawn here is another plan by now: nobody sees whether that one takes off.
    here.type("plan-speed", 3.0)
    assert await press() == ([] if stands else [orders.StartMission("the digest", take_off=False)])


async def test_an_orbit_is_made_around_the_only_corner(here: Here) -> None:
    _, points = drawn(here)
    await here.press(here.find(data_plan="orbit"))
    assert "one centre" in here.find(id="plan-problem").text
    await here.press(here.find(data_plan="area"))
    await here.say("map_pointed", view="plan", place=A)
    here.type("survey-radius", 12.0)
    here.type("survey-height", 22.0)
    await here.press(here.find(data_plan="orbit"))
    assert {one[2] for one in points()} == {22.0}
    away = [distance_m(*A, *one[:2]) for one in points()]
    assert away == [pytest.approx(12.0, abs=0.6)] * 25


SURVEYS: list[tuple[dict[str, Any], dict[str, Any]]] = [
    # 30 m high an X3 sees 51.2 m across; 70 % overlap leave 15.4 m.
    ({}, {"height": 30.0, "spacing": 15.37, "angle_deg": 0.0, "photo_every": None}),
    (
        {"height": 60.0, "overlap": 50.0, "angle": -30.0, "photo_every": 8.0},
        {"height": 60.0, "spacing": 51.24, "angle_deg": -30.0, "photo_every": 8.0},
    ),
    ({"spacing": 12.0}, {"height": 30.0, "spacing": 12.0, "angle_deg": 0.0, "photo_every": None}),
]


@pytest.mark.parametrize(("typed", "how"), SURVEYS)
async def test_lines_are_as_far_apart_as_the_overlap_says(
    here: Here, monkeypatch: pytest.MonkeyPatch, typed: dict[str, float], how: dict[str, Any]
) -> None:
    asked: list[dict[str, Any]] = []
    draft = Draft

    def surveyed(self: Any, **options: Any) -> Any:
        asked.append(options)
        return self

    monkeypatch.setattr(draft, "surveyed", surveyed)
    drawn(here)
    for name, value in typed.items():
        here.type(f"survey-{name}", value)
        assert here.find(for_=f"survey-{name}").min <= value
    await here.press(here.find(data_plan="lines"))
    [found] = asked
    assert found.pop("start") == pytest.approx((LATITUDE, LONGITUDE))
    assert found == {
        name: value if value is None else pytest.approx(value, abs=0.01)
        for name, value in how.items()
    }


async def test_actions_are_typed_in_words_and_what_is_none_is_refused(here: Here) -> None:
    part, _ = drawn(here)
    await here.say("map_pointed", view="plan", place=A)
    here.type("waypoint-actions", "stay 3, photo")
    assert len(part._draft.points[0].actions) == 2
    here.type("waypoint-actions", "dance")
    assert "dance" in here.find(id="plan-problem").text
    assert len(part._draft.points[0].actions) == 2


@pytest.mark.parametrize("kind", ["plan", "json"])
async def test_a_plan_is_saved_and_opened_again(here: Here, kind: str) -> None:
    part, points = drawn(here)
    save = here.find(data_plan=f"export_{kind}")
    await here.press(save)
    assert not any(note[0] == "saved" for note in here.notes)
    assert here.find(id="plan-problem").text
    for place in (A, [52.1001, 4.3]):
        await here.say("map_pointed", view="plan", place=place)
    before = points()
    await here.press(save)
    [(_, text, name, media)] = [note for note in here.notes if note[0] == "saved"]
    assert (name, media) == (f"m100link.{kind}", "application/json")
    assert ('"fileType"' in text) is (kind == "plan")
    assert len(WaypointPlan.parse(text).waypoints) == 2
    await here.press(here.find(data_plan="clear"))
    await here.say("plan_opened", text=text)
    assert [one[2] for one in points()] == [one[2] for one in before]
    assert part._chosen is None
    for bad in ("{}", None):
        await here.say("plan_opened", text=bad)
        assert here.find(id="plan-problem").text
        assert len(points()) == 2


async def test_what_is_drawn_is_uploaded_and_shown(here: Here) -> None:
    part, _ = drawn(here)
    for place in (A, [52.1001, 4.3]):
        await here.say("map_pointed", view="plan", place=place)
    await here.press(here.find(data_act="mission_upload"), at=1.0)
    assert here.notes[-1] == ("ask", orders.UploadPlan.of(part._draft.plan()))
    rows = [here.find(data_point=str(number)) for number in (0, 1)]
    assert [row.props["aria-pressed"] for row in rows] == ["false", "true"]
    await here.press(rows[0])
    assert part._chosen == 0
    here.agent.plan = WaypointPlan.from_wire(*part._draft.plan().to_wire())  # as it came back
    mission = SimpleNamespace(state=Text("mission.waypoint"), part=0.25)
    part.update(SimpleNamespace(mission=mission))
    shown = here.find(id="plan").text, here.find(id="mission").text
    assert shown == (here.find(id="plan-summary").text, "waypoint mission")
    assert shown[0].startswith("2 waypoints, ")
    before = shown[0]
    here.place = position(latitude=A[0] + 1.0)  # it stands elsewhere: the way is longer
    part.update(SimpleNamespace(mission=mission))
    assert before != here.find(id="plan").text == here.find(id="plan-summary").text
    assert here.find(id="mission-progress").value == 0.25


# -- a point of the map is flown to ---------------------------------------------------------------


async def shown(here: Here) -> Any:
    """The part, open at a point."""
    part = here.make(click_part)
    await here.say("map_pointed", view="fly", place=A)
    return part


async def test_a_flight_to_a_point_keeps_the_height_that_the_aircraft_has(here: Here) -> None:
    """12.34 m are 12; while it stands on the ground, the usual height."""
    part = await shown(here)
    assert part._pointed.order == orders.FlyTo(A[0], A[1], height=12.0, speed=5.0)
    assert here.find(for_="click-height_m").value == 12.0
    here.type("click-height_m", 30.0)
    await here.say("map_pointed", view="fly", place=B)  # it is open: what was typed stays
    assert part._pointed.order == orders.FlyTo(B[0], B[1], height=30.0, speed=5.0)
    for place, view in ((C, "plan"), ([52.1], "fly"), (["52", 4.3], "fly"), ([True, 4.3], "fly")):
        await here.say("map_pointed", view=view, place=place)
    assert part._pointed.place == tuple(B)


async def test_on_the_ground_the_usual_height_is_offered(here: Here) -> None:
    here.place = position(height=2.0)
    part = await shown(here)
    assert part._pointed.height == 10.0


TYPED = [
    ("height_m", 33.0, "height", 33.0),
    ("height_m", 500.0, "height", 120.0),
    ("speed", 0.1, "speed", 0.5),
    ("radius", 25.0, "radius", 25.0),
    ("turns", 2.5, "turns", 2.5),
    ("yaw", -90.0, "yaw_deg", 270.0),
]


@pytest.mark.parametrize(("word", "typed", "name", "value"), TYPED)
async def test_what_is_typed_of_a_point_of_the_map(
    here: Here, word: str, typed: float, name: str, value: float
) -> None:
    part = await shown(here)
    here.type(f"click-{word}", typed)
    assert getattr(part._pointed, name) == value


async def test_a_point_is_named_by_its_distance_and_bearing(here: Here) -> None:
    """100 m to the east of the aircraft."""
    part = await shown(here)
    here.type("click-distance", 100.0)
    assert part._pointed.place == tuple(A)
    here.type("click-bearing", 90.0)
    latitude, longitude = part._pointed.place
    assert latitude == pytest.approx(LATITUDE, abs=1e-5)
    east = (longitude - LONGITUDE) * 111_319.5 * math.cos(math.radians(LATITUDE))
    assert east == pytest.approx(100.0, abs=0.5)


@pytest.mark.parametrize(
    ("name", "value", "has_lease", "changed"),
    [
        ("radius", 20.26, True, 20.3),
        ("yaw_deg", 90.6, True, 91.0),
        ("radius", 20.26, False, None),
        ("height", 50.0, True, None),
        ("radius", "20", True, None),
        ("radius", True, True, None),
    ],
)
async def test_handles_on_the_map_are_for_the_pilot(
    here: Here, name: str, value: object, has_lease: bool, changed: float | None
) -> None:
    part = await shown(here)
    here.tab.session.has_lease = has_lease
    before = part._pointed
    await here.say("map_dragged", name=name, value=value)
    if changed is None:
        assert part._pointed == before
    else:
        assert getattr(part._pointed, name) == changed
        word = {"yaw_deg": "yaw"}.get(name, name)
        assert here.find(for_=f"click-{word}").value == changed


async def test_a_hold_flies_the_point_that_was_shown(here: Here) -> None:
    part = await shown(here)
    fly_button = here.find(data_act="guide")
    number = part._shown.show(part._pointed)
    here.notes.clear()
    await here.press(fly_button, at=1.0, shown=number)
    assert here.notes == [("check_order", 1.0), ("ask", part._pointed.order)]
    here.type("click-height_m", 50.0)
    with pytest.raises(GuardRefused, match="changed while the button was held"):
        await here.press(fly_button, at=1.0, shown=number)
    assert here.notes[-1] == ("check_order", 1.0)


async def test_a_flight_that_begins_closes_the_card(here: Here) -> None:
    part = await shown(here)
    opened: list[bool] = []

    async def ask(order: object, begun: Callable[[], None]) -> None:
        opened.append(part.is_open)
        begun()
        opened.append(part.is_open)

    here.tab.ask = ask
    await part._fly()
    assert opened == [True, False]
    assert part._pointed.order is None


async def test_the_card_of_a_point_is_closed_and_forgets_it(here: Here) -> None:
    part = await shown(here)
    opener = here.find(id="point-open")
    seen = []
    for button in (None, here.find(id="point-close"), opener, opener):
        if button is not None:
            await here.press(button)
        seen.append((part._card.visible, opener.props["aria-pressed"]))
    assert seen == [(True, "true"), (False, "false"), (True, "true"), (False, "false")]
    assert part._pointed.place is None


def test_the_map_shows_another_plan_and_other_tiles_once(here: Here) -> None:
    part = here.make(MapPart)
    assert part.leaflet.props["options"]["maxZoom"] == 22, "as its layers have"
    here.works.pop().close()  # the look at the tiles
    here.notes.clear()
    here.page.tiles.pictures = Pictures((14, 19), "© Anna", 2**60)
    chart = SimpleNamespace(route=((1.0, 2.0),), fence={"radius": 3})
    path = here.page.history.path
    path.hear_phase(1.0, is_off_ground=True)
    for at in (1.0, 2.0, 3.0):
        path.add(at, position()._replace(latitude_rad=0.1 * at))
        part.update(SimpleNamespace(chart=chart, flight=None))
    sent = [re.findall(r'"from":(\d+).*?"points":\[\[(.*?),', code) for _, code in here.notes]
    assert [one for one in sent if one] == [[("0", "1.0")], [("1", "2.0")], [("2", "3.0")]]
    [chart_code] = [code for _, code in here.notes if "setChart" in code]
    assert 'map.setChart([[1.0, 2.0]], {"radius": 3})' in chart_code
    [tiles_code] = [code for _, code in here.notes if "showTiles" in code]
    given = json.loads(tiles_code.partition("showTiles(")[2].removesuffix("))"))
    # A number of the browser would not hold the version.
    version = "1152921504606846976"
    assert given == {"zooms": [14, 19], "licence": "© Anna", "version": version, "fault": None}


# -- a replay -------------------------------------------------------------------------------------


async def test_a_replay_is_moved_by_seconds_and_times(here: Here) -> None:
    part = here.make(header.ReplayPart)
    here.notes.clear()
    for what in ("back", "on", "toggle"):
        await here.press(here.find(data_replay=what))
    with here.client:
        part._slider.set_value(12.34)
    await here.event(part._slider, "change")
    with here.client:
        part._speed.set_value(0.5)
    for work in here.works:
        await work
    said = [order.text for _, order in here.notes]
    assert said == ["by -10", "by 10", "toggle", "seek 12.3", "speed 0.5"]


def test_a_replay_is_shown_where_it_is_unless_a_finger_moves_it(here: Here) -> None:
    part = here.make(header.ReplayPart)
    source = SimpleNamespace(duration_s=61.26, position_s=7.26, speed=2.0)
    view = SimpleNamespace(
        replay=SimpleNamespace(
            title=said("a title"),
            place=said("a place"),
            note=None,
            is_running=True,
            source=source,
            alarm_before=None,
            alarm_after=None,
        )
    )
    part.update(SimpleNamespace(replay=None))
    visible = [part._bar.visible]
    part.update(view)
    part.update(view)
    assert [*visible, part._bar.visible] == [False, True]
    assert (part._slider.value, part._slider.props["max"], part._speed.value) == (7.3, "61.3", 2.0)
    assert sum("dataset.replay" in note[1] for note in here.notes) == 1
    assert here.works == []  # what is shown was not chosen
    part._held(SimpleNamespace(args="start"))
    source.position_s, source.duration_s = 9.0, 0.0
    part.update(view)
    assert (part._slider.value, part._slider.props["max"]) == (7.3, "0.1")
    part._held(SimpleNamespace(args="end"))
    part.update(view)
    assert part._slider.value == 9.0
    toggles = [part._toggle.text]
    view.replay.is_running, view.replay.note = False, said("at its end")
    part.update(view)
    assert [*toggles, part._toggle.text] == ["Pause", "Play"]
    assert part._note.text == "at its end"


def said(text: str) -> Text:
    """Words that stand for themselves."""
    return Text("errors.usage", {"original": text})


# -- the head of the page -------------------------------------------------------------------------


def status(**changed: Any) -> Any:
    line: dict[str, Any] = {
        "text": said("said"), "remedy": None, "flies": None, "is_virtual": False,
        "level": AlarmLevel.GOOD, "since": None,
    }  # fmt: skip
    usual: dict[str, Any] = {"problem": None, "replay": None, "actions": set()}
    shown_by = {name: changed.pop(name, value) for name, value in usual.items()}
    reading = SimpleNamespace(text=said("a value"), note=said("old"), is_stale=True)
    names = ("battery", "gps", "height", "climb", "speed", "flight_time")
    readings = dict.fromkeys(names, reading) | {
        "flight_status": SimpleNamespace(text=said("in the air"), note=None, is_stale=False)
    }
    return SimpleNamespace(
        status=SimpleNamespace(**(line | changed)),
        instruments=SimpleNamespace(readings=readings),
        **shown_by,
    )


def test_the_status_line_shows_what_there_is(here: Here) -> None:
    part = here.make(header.StatusPart)
    part.update(status())
    assert here.find(id="phase").text == "in the air"
    assert (here.find(data_field="battery").text, "stale" in part._rows["gps"]._row.classes) == (
        "a value",
        True,
    )
    offered = []
    for actions in (set[str](), {"obtain"}, {"release"}):
        part.update(status(actions=actions))
        offered.append([part._controls[name].visible for name in ("obtain", "release")])
    assert offered == [[False, False], [True, False], [False, True]]
    assert (here.find(id="said").text, here.find(id="remedy").text) == ("said", "")
    assert here.find(id="task").text == here.find(id="problem").text == ""
    assert not here.find(id="virtual").visible
    assert (part._shape.text, "good" in part._banner.classes) == ("●", True)
    assert here.find(id="view-beat").props["data-at"] == "12.3"
    danger = {"level": AlarmLevel.DANGER, "since": 4.26, "is_virtual": True}
    part.update(status(**danger, remedy=said("so"), flies=said("land"), problem=said("no")))
    found = [here.find(id=name).text for name in ("remedy", "task", "problem")]
    assert found == ["so", "land", "no"]
    assert here.find(id="phase").text == ""  # what it carries out says more
    assert here.find(id="virtual").visible
    assert (part._shape.text, "good" in part._banner.classes) == ("◆", False)
    assert part._counter.props["data-since"] == "4.3"
    part.update(status(**danger, replay="a replay"))  # its clock is another one
    assert part._counter.props["data-since"] == ""
    shapes = []
    for level in (AlarmLevel.NEUTRAL, AlarmLevel.WARNING):
        part.update(status(level=level))
        shapes.append(part._shape.text)
    assert shapes == ["○", "▲"]


FIRST = next(iter(AlarmName))


def alarm(state: AlarmState, at: float = 1.0, name: AlarmName = FIRST) -> ActiveAlarm:
    return ActiveAlarm(name, AlarmLevel.WARNING, state, said("a bird"), at)


def alarmed(*alarms: ActiveAlarm, sounding: AlarmLevel | None = None) -> Any:
    return SimpleNamespace(alarms=alarms, sounding=sounding, at=7.5)


@pytest.mark.parametrize("speech", [True, False])
@pytest.mark.parametrize("sound", [True, False])
def test_an_alarm_is_shown_and_spoken_once(here: Here, speech: bool, sound: bool) -> None:
    part = here.make(header.AlarmsPart)
    here.wording.choose(replace(here.wording.settings, speech=speech, sound=sound))
    raised = alarm(AlarmState.RAISED)
    row = part._rows[raised.name]
    part.update(alarmed())
    assert not row.box.visible
    loud, spoken = [], []
    for one in (raised, raised, alarm(AlarmState.RAISED, at=2.0), alarm(AlarmState.ACKNOWLEDGED)):
        part._loud.set_text("")
        part._sound.props["data-say"] = "[]"
        part.update(alarmed(one, sounding=AlarmLevel.WARNING))
        loud.append(part._loud.text)
        spoken.append(part._sound.props["data-say"] != "[]")
        assert (row.box.visible, row.shape.text, row.text.text) == (True, "▲", "a bird")
        assert row.button.visible is (one.state is AlarmState.RAISED)
    assert loud == ["a bird", "", "a bird", ""]
    assert spoken == [speech, False, speech, False]
    assert part._sound.props["data-level"] == ("warning" if sound else "")
    part.update(alarmed(sounding=None))
    assert part._sound.props["data-level"] == ""
    assert not row.box.visible


async def test_an_alarm_is_acknowledged_in_the_log(here: Here) -> None:
    part = here.make(header.AlarmsPart)
    seen: list[AlarmName] = []

    def acknowledge(name: AlarmName) -> Text | None:
        seen.append(name)
        return said("a bird") if len(seen) == 1 else None

    object.__setattr__(here.page, "memory", SimpleNamespace(acknowledge=acknowledge))
    name = next(iter(AlarmName))
    part.update(alarmed(alarm(AlarmState.RAISED)))
    for _ in range(2):
        await here.press(here.find(data_see=name.value))
    assert seen == [name, name]
    notes = [note for note in here.notes if note[0] == "note"]
    assert notes == [("note", "anna acknowledged: a bird")]


def ship(**changed: Any) -> FleetRow:
    usual: dict[str, Any] = {
        "name": "left", "is_shown": False, "kind": "free", "control": said("free"),
        "flies": said("5 m"), "battery": said("63 %"), "is_low": False,
    }  # fmt: skip
    return FleetRow(**(usual | changed))


async def test_a_fleet_has_a_row_for_each_and_each_can_be_stopped(here: Here) -> None:
    async def stop(name: str) -> None:
        here.notes.append(("stop", f"left by {name}"))

    agent = SimpleNamespace(background=here.agent.background, stop=stop)
    tabs = SimpleNamespace(agents={"left": agent}, move=lambda tab, name: f"/{name}?x")
    object.__setattr__(here.page, "tabs", tabs)
    part = here.make(header.FleetPart)
    part.update(SimpleNamespace(fleet=()))
    visible = [part._place.visible]
    part.update(SimpleNamespace(fleet=(ship(),)))
    assert [*visible, part._place.visible] == [False, True]
    part.update(SimpleNamespace(fleet=(ship(), ship(name="m100", is_shown=True))))
    turn = here.find(data_ship="left")
    currents = [here.find(data_ship=name).props["aria-current"] for name in ("left", "m100")]
    assert currents == ["false", "page"]
    row = part._rows["left"]
    part.update(SimpleNamespace(fleet=(ship(is_low=True, kind="mine", flies=said("land")),)))
    assert ("low" in row._battery.classes, "mine" in row._box.classes) == (True, True)
    assert (row._flies.text, "free" in row._box.classes) == ("land", False)
    part.update(SimpleNamespace(fleet=(ship(),)))
    assert "low" not in row._battery.classes
    here.notes.clear()
    await here.press(here.find(data_stop="left"), press=2)
    assert here.notes == [("script", "m100.answered(2)"), ("stop", "left by anna")]
    assert (here.whose[-1], here.replaces) == ("stop of anna", False)
    await here.press(turn)
    await here.press(here.find(data_ship="m100"))
    assert here.notes[2:] == [("script", 'location.replace("/left?x")')]


# -- settings -------------------------------------------------------------------------------------


async def test_the_card_of_the_gamepad_is_filled_by_the_page(here: Here) -> None:
    here.make(settings.SettingsPart)
    assert here.find(id="gamepad")
    [script] = [note[1] for note in here.notes if "gamepad.js" in str(note)]
    assert 'build(document.querySelector("#gamepad"))' in script
    assert [here.find(data_axes=one) is not None for one in ("turn,up", "right,forward")]


async def test_a_button_of_a_gamepad_takes_a_photograph(here: Here) -> None:
    here.make(fly.HudPart)
    await here.say("photo_pressed")
    assert ("ask", orders.UseCamera(orders.CameraUse.PHOTO)) in here.notes


async def test_what_is_chosen_is_kept_and_said(here: Here) -> None:
    here.make(settings.SettingsPart)
    for name, value in (("language", "de"), ("length", "ft"), ("speed", "kn"), ("theme", "dark")):
        here.type(name, value)
    here.type("name", "b" * 70)
    with here.client:
        here.find(id="sound").set_value(False)
    chosen = here.wording.settings
    assert (chosen.language.value, chosen.length.value, chosen.speed.value) == ("de", "ft", "kn")
    assert (chosen.theme.value, chosen.name, chosen.sound) == ("dark", "b" * 64, False)
    assert here.tab.session.name == "b" * 64
    kept = [note[1] for note in here.notes if "localStorage.setItem" in str(note)]
    assert len(kept) == 6
    text = json.loads(kept[-1].partition(", ")[2].removesuffix(")"))
    assert DisplaySettings.from_text(text) == chosen
    assert ("dark", True) in here.notes
    here.type("theme", "dark")
    assert len([note for note in here.notes if "localStorage.setItem" in str(note)]) == 6


@pytest.mark.parametrize(
    ("theme", "dark", "is_sun"),
    [
        ("auto", None, "false"),
        ("dark", True, "false"),
        ("light", False, "false"),
        ("sun", False, "true"),
    ],
)
def test_looks_are_as_they_were_chosen(
    here: Here, theme: str, dark: bool | None, is_sun: str
) -> None:
    settings.apply_settings(here.page, replace(here.wording.settings, theme=Theme(theme)))
    assert ("dark", dark) in here.notes
    assert f"toggle('sun', {is_sun})" in here.notes[-1][1]


@pytest.mark.parametrize(
    ("ahead", "minutes"), [(120, 120), (-840, -840), (841, 0), (1.5, 0), (None, 0)]
)
async def test_the_clock_of_the_operator_is_within_fourteen_hours(
    here: Here, monkeypatch: pytest.MonkeyPatch, ahead: Any, minutes: int
) -> None:
    kept = replace(DisplaySettings(), name="bert").to_text()

    class Answer:
        def __await__(self) -> Generator[Any, None, Any]:
            yield from ()
            return [kept, ahead]

    monkeypatch.setattr(ui, "run_javascript", lambda *_, **__: Answer())
    await settings.load_settings(here.page)
    assert (here.wording.utc_offset_min, here.tab.session.name) == (minutes, "bert")


SIMULATED: list[tuple[str, Any, tuple[str, ...]]] = [
    ("sim-mode", "P", ("rc-mode P",)),
    ("sim-rc", False, ("rc-off",)),
    ("sim-app", True, ("app-takes-control",)),
    ("sim-plug", False, ("unplug",)),
    ("sim-stall", True, ("stall on",)),
    ("sim-refuse", True, ("server-refuses on",)),
    ("sim-line", "lost_5", ("no-faults", "faults loss=0.05")),
    ("sim-line", "lost_20", ("no-faults", "faults loss=0.2")),
    ("sim-line", "damaged", ("no-faults", "faults damage=0.02")),
    ("sim-line", "late", ("no-faults", "faults delay=0.08 jitter=0.02")),
    ("sim-line", "radio", ("no-faults", "faults radio=on")),
    ("sim-gps", 2, ("gps 2",)),
    ("sim-gps", 9, ("gps 5",)),
    ("sim-battery", 12, ("battery 12",)),
    ("sim-battery", 300, ("battery 100",)),
    ("sim-battery", -5, ("battery 0",)),
]


@pytest.mark.parametrize(("name", "value", "given"), SIMULATED)
async def test_the_panel_orders_what_it_says(
    here: Here, monkeypatch: pytest.MonkeyPatch, name: str, value: Any, given: tuple[str, ...]
) -> None:
    told: list[tuple[str, ...]] = []
    refused: list[str] = []
    monkeypatch.setattr(ui, "notify", refused.append)

    async def give(*words: str) -> None:
        told.append(words)
        raise UsageError("not now")

    status = {"rc_mode": "F", "rc_is_on": True, "control": "rc", "gps_health": 4}
    panel = SimpleNamespace(give=give, status=status | {"battery_percent": 63.4})
    with here.client:
        settings.SimPanel(cast("Any", panel), here.wording)
    found = here.find(id=name)
    usual = {"sim-mode": "F", "sim-rc": True, "sim-app": False, "sim-gps": 4, "sim-battery": 63}
    assert found.value == usual.get(name, found.value)
    with here.client:
        [handler] = found._change_handlers
        await handler(SimpleNamespace(value=value))
        await handler(SimpleNamespace(value=None))
    assert (told, refused) == ([given], ["not now"])


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("rc", "rc-on"),
        ("app", "app-releases-control"),
        ("plug", "replug"),
        ("stall", "stall off"),
        ("refuse", "server-refuses off"),
    ],
)
async def test_switches_order_both_ways(here: Here, name: str, words: str) -> None:
    told: list[tuple[str, ...]] = []

    async def give(*words: str) -> None:
        told.append(words)

    status = {"rc_mode": "F", "rc_is_on": False, "control": "app", "gps_health": 4}
    panel = SimpleNamespace(give=give, status=status | {"battery_percent": 63.4})
    with here.client:
        settings.SimPanel(cast("Any", panel), here.wording)
        [handler] = here.find(id=f"sim-{name}")._change_handlers
        await handler(SimpleNamespace(value=words in ("rc-on", "replug")))
    assert told == [(words,)]


# -- before take-off ------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("is_green", "may", "reason", "height", "most"),
    [
        (True, True, "", 1.2, None),
        (True, True, "", 5.0, 5.0),
        (False, True, "a test", 5.0, None),
        (False, False, "", 1.2, None),
        (True, False, "", 1.2, None),
        (True, True, "", 5.1, 5.0),
    ],
)
async def test_a_take_off_needs_the_checklist_or_a_reason_and_room_above(
    here: Here, is_green: bool, may: bool, reason: str, height: float, most: float | None
) -> None:
    missing = () if is_green else (SimpleNamespace(item=view_of_fly.ChecklistItem("battery")),)
    looked = SimpleNamespace(may_take_off=may, is_green=is_green, missing=missing, reason=reason)
    checklist = SimpleNamespace(look=lambda _: looked, height=height)
    memory = SimpleNamespace(checklist=checklist, situation=None)
    here.agent.state.limits.max_height_m = most
    object.__setattr__(here.page, "memory", memory)
    is_low = most is None or height <= most
    if not may or not is_low:
        why = "the limit is 5 m" if may else "take-off is not offered"
        with pytest.raises(UsageError, match=why):
            await here.page.take_off()
        assert here.notes == []
        return
    await here.page.take_off()
    asked = [note[1] for note in here.notes if note[0] == "ask"]
    assert asked == [orders.TakeOff(), *([orders.ChangeHeight(5.0)] if height == 5.0 else [])]
    noted = [note for note in here.notes if note[0] == "note"]
    assert bool(noted) is not is_green
    if noted:
        assert noted[0][2] == "warning"
        assert "a test" in noted[0][1]
        assert "anna" in noted[0][1]


def test_here_is_where_the_aircraft_is(here: Here) -> None:
    assert here.page.here() == pytest.approx((LATITUDE, LONGITUDE))
    here.place = None
    assert here.page.here() is None


def checks(*, is_green: bool, is_possible: bool, reason: str = "", free: bool = False) -> Any:
    item = next(iter(view_of_fly.ITEMS))
    check = SimpleNamespace(
        item=item, state=view_of_fly.ItemState.WRONG, seen=said("seen"), remedy=said("so")
    )
    checklist = SimpleNamespace(
        checks=(check,), is_green=is_green, is_possible=is_possible, reason=reason,
        is_free_said=free, missing=() if is_green else (check,),
    )  # fmt: skip
    return SimpleNamespace(checklist=checklist)


@pytest.mark.parametrize(
    ("is_green", "is_possible", "asks_why"),
    [(True, True, False), (False, True, True), (False, False, False)],
)
def test_why_is_asked_where_a_reason_would_do(
    here: Here, is_green: bool, is_possible: bool, asks_why: bool
) -> None:
    part = here.make(fly.ChecklistPart)
    part.update(checks(is_green=is_green, is_possible=is_possible))
    assert part._why.visible is asks_why
    row = part._rows[next(iter(view_of_fly.ITEMS))]
    assert (row.seen.text, row.remedy.text, row.shape.text) == ("seen", "so", "✖")
    assert "wrong" in row.box.classes
    found = part._summary.text
    assert ("1" in found) is (not is_green and is_possible)


def test_the_box_says_free_once_and_follows_what_was_said(here: Here) -> None:
    checklist = here.page.memory.checklist
    part = here.make(fly.ChecklistPart)
    with here.client:
        part._free._box.set_value(True)
        assert checklist.is_free(here.agent.now)
        part._free._box.set_value(False)
        assert not checklist.is_free(here.agent.now)
    checklist.say_free(here.agent.now, is_free=True)
    part.update(checks(is_green=False, is_possible=True, free=True))
    assert part._free._box.value is True


@pytest.mark.parametrize(
    ("is_on_ground", "is_replay", "is_covered", "is_shown"),
    [
        (True, False, False, True),
        (None, False, False, True),
        (False, False, False, False),
        (True, True, False, False),
        (True, False, True, False),
    ],
)
@pytest.mark.parametrize("may", [True, False])
def test_a_take_off_is_prepared_on_the_ground(
    here: Here,
    is_on_ground: bool | None,
    is_replay: bool,
    is_covered: bool,
    is_shown: bool,
    may: bool,
) -> None:
    part = here.make(fly.GroundPart)
    view = SimpleNamespace(
        checklist=SimpleNamespace(missing=(1, 2), may_take_off=may, is_free_said=False),
        situation=SimpleNamespace(is_on_ground=is_on_ground, is_replay=is_replay),
    )
    part.update(view, is_covered=is_covered)
    assert (part._card.visible, part._button.visible) == (is_shown, not may)
    assert "2" in part._why_not.text


@pytest.mark.parametrize(("typed", "height"), [(5.0, 5.0), (0.5, 1.2), (200.0, 120.0), (None, 1.2)])
def test_a_take_off_goes_to_the_height_that_was_typed(
    here: Here, typed: float | None, height: float
) -> None:
    """1.2 m, where the aircraft hovers by itself, to 120 m."""
    here.make(fly.GroundPart)
    here.type("take-off-height", 7.0)
    here.type("take-off-height", typed)
    assert here.page.memory.checklist.height == height


async def test_the_log_has_the_origin_of_a_video_and_few_words(
    here: Here, monkeypatch: pytest.MonkeyPatch
) -> None:
    here.page = replace(here.page, video=Video.of("http://camera.test:8080/s?key=secret"))
    here.make(fly.HudPart)
    now = 100.0
    monkeypatch.setattr(time, "monotonic", lambda: now)
    here.notes.clear()
    layout, name = here.client.layout, "video of http://camera.test:8080"
    for said in ("live", "old", "<b>", ["live"], None):  # all at once
        await here.event(layout, "video_told", said)
    assert here.notes == [("note", f"{name}: a page shows it")]
    now += 1.0
    await here.event(layout, "video_told", "old")
    assert here.notes[1:] == [("note", f"{name}: a page gets no picture")]
    assert here.find(id="video").tag == "button"


# -- the Data and Events views: numbers, tables, a recorded flight, and what happened --------------


def test_the_attitude_is_drawn_from_behind_and_told_to_be_old(here: Here) -> None:
    """The scene has x to the east and z up: the nose points north at a heading of 0."""
    part = here.make(data.TelemetryPart)
    scene = part._model.scene
    assert (scene.camera.x, scene.camera.y < -2.0, scene.camera.z > 1.0) == (0, True, True)
    made = list(scene.objects.values())
    rotors = {(one.x, one.y, one.color, one.R[2][1]) for one in made if one.type == "cylinder"}
    front, back = "#c62828", "#1565c0"  # each lies flat
    assert rotors == {(x, y, front if x > 0 else back, 1) for x in (0.57, -0.57) for y in (x, -x)}
    arms = {round(one.R[1][0], 2) for one in made if (one.type, one.color) == ("box", "#444")}
    assert arms == {0.71, -0.71}, "across, from rotor to rotor"
    turned: list[tuple[float, ...]] = []
    part._model = SimpleNamespace(rotate=lambda *angles: turned.append(angles))
    names = [one.name for one in view_of_fly.FIELDS]

    def update(attitude: tuple[float, float, float] | None, *, is_stale: bool) -> None:
        readings = {
            name: view_of_fly.FieldReading(Text("link.none"), is_stale=is_stale) for name in names
        }
        part.update(
            SimpleNamespace(instruments=SimpleNamespace(readings=readings, attitude=attitude))
        )

    for attitude, is_old in (((10.0, 20.0, 30.0), False), (None, True), ((0.0, 0.0, 90.0), False)):
        update(attitude, is_stale=is_old)
        assert ("stale" in part._frame._classes) is is_old
        assert bool(part._age.text) is is_old
        rows = [one._row._classes for one in part._rows.values()]
        assert all(("stale" in row) is is_old for row in rows)
    assert [tuple(map(math.degrees, one)) for one in turned] == [
        pytest.approx((10.0, -20.0, 60.0)),
        pytest.approx((0.0, 0.0, 0.0)),
    ]
    channels = [
        one.props["data-rc"] for one in here.client.elements.values() if "data-rc" in one.props
    ]
    assert channels == ["roll", "pitch", "yaw", "throttle"]


def test_tables_of_the_link_are_filled_anew_and_keep_their_cells(here: Here) -> None:
    part = here.make(data.LinkPart)

    def cells(name: str) -> list[Any]:
        table = here.find(id=f"link-{name}").default_slot.children[0]
        return list(table.default_slot.children)

    def update(rates: int, causes: Any = (), dropped: Any = ()) -> None:
        rows = [
            SimpleNamespace(
                name=Text("plots.item.battery"), rate=f"{n} Hz", jitter=f"{n} ms", longest_gap="2 s"
            )
            for n in range(rates)
        ]
        texts = dict.fromkeys(LINK_ITEMS, Text("link.none"))
        with here.client:
            part.update(
                SimpleNamespace(
                    link=SimpleNamespace(
                        texts=texts, reason="cut", causes=causes, rates=rows, dropped=dropped
                    )
                )
            )

    none = here.wording(Text("link.none"))
    update(1)
    assert [one.text for one in cells("causes")] == [none, ""]
    assert all(one.text == none for one in part._numbers.values())
    assert part._reason.text == "cut"
    before = cells("rates")
    battery = here.wording(Text("plots.item.battery"))
    assert [one.text for one in before][4:] == [battery, "0 Hz", "0 ms", "2 s"]
    assert len(before) == 8, "titles, and a row"
    table = here.find(id="link-rates").default_slot.children[0]
    assert table.style["grid-template-columns"] == "1fr auto auto auto"
    update(1, ((Text("link.none"), "7"), (Text("link.none"), "8")), (("anna", "9"),))
    assert cells("rates") == before, "nobody who reads or selects loses them"
    assert [one.text for one in cells("causes")] == [none, "7", none, "8"]
    assert [one.text for one in cells("dropped")][2:] == ["anna", "9"]
    update(2)
    assert [one.text for one in cells("rates")][8:] == [battery, "1 Hz", "1 ms", "2 s"]


class Flight(SimpleNamespace):
    """A recorded flight with a row each ten seconds: its values are 1, 2 and so on."""

    def __init__(self, began: float | None, took_off: float | None, *alarms: Any) -> None:
        story = {"began_utc": began, "took_off_s": took_off, "duration_s": 40.0, "alarms": alarms}
        super().__init__(story=SimpleNamespace(**story), asked=[])

    def between(self, names: Any, begin: float, end: float, most: int) -> list[tuple[float, ...]]:
        self.asked.append((tuple(names), begin, end, most))
        times = (at for at in (0.0, 10.0, 20.0, 30.0, 40.0) if begin <= at <= end)
        return [(at, *(float(n + 1) for n in range(len(names)))) for at in times]

    def near(self, names: Any, at: float) -> list[float]:
        return [at] * len(names)


async def test_a_recorded_flight_is_drawn_whole_or_in_part_beside_another(here: Here) -> None:
    """What was commanded and the other flight are dashed; the other one by its own take-off."""
    alarm = SimpleNamespace(begin_s=1.5, end_s=2.5)
    own, other = Flight(1000.0, 5.0, alarm), Flight(None, 12.0)
    history, compared = here.page.history, PlotHistory()
    history.recorded, compared.recorded = cast(Any, own), cast(Any, other)
    here.page = replace(here.page, history_of=lambda name: compared if name == "other" else history)
    here.page.memory.compared = "other"
    part = here.make(data.PlotsPart)
    part._names = ["velocity.north_m_s", "line.discards"]

    def update(at: float, *, is_beside: bool = False) -> list[Any]:
        here.notes.clear()
        flight = SimpleNamespace(story=own.story, at=at, other=object() if is_beside else None)
        with here.client:
            part.update(SimpleNamespace(replay=object(), flight=flight))
        codes = [code for kind, code in here.notes if kind == "script"]
        cursor = codes.pop().partition("setCursor(")[2].rstrip(")")
        rows = [json.loads(code.partition("...")[2][:-2]) for code in codes]
        return [[*map(int, cursor.split(", "))], *rows]

    cursor, row = update(20.0)
    assert cursor == [part._chart.id, 2, 1_020_000]
    version, drawn, range_ms = row
    assert (version, range_ms) == (1, 40_000)
    assert drawn[0] == [1_000_000, 1.0, 2.0, 3.0]
    assert own.asked == [
        (("velocity.north_m_s", "line.discards", "commanded.north_m_s"), 0.0, 40.0, 2000)
    ]
    assert not part._pause.visible
    lines = part._chart.options["series"]
    assert [line["lineStyle"].get("type") for line in lines] == [None, None, "dashed"]
    assert lines[0]["markArea"]["data"] == [[{"xAxis": 1_001_500.0}, {"xAxis": 1_002_500.0}]]
    assert update(21.0) == [[part._chart.id, 2, 1_021_000]], "the cursor alone"
    _, (version, drawn, _) = update(21.0, is_beside=True)
    assert (version, drawn[1]) == (2, [1_010_000, 1.0, 2.0, 3.0, 17.0, 17.0])
    colours = [line["color"] for line in part._chart.options["series"]]
    assert colours[2:] == ["#888", "#00897b", "#00897b"]
    part._set_range(SimpleNamespace(value=30))
    _, (_, drawn, range_ms) = update(21.0)
    assert (len(drawn), range_ms) == (3, 30_000)
    assert own.asked[-1][1:3] == (18.0, 48.0)
    here.notes.clear()
    part._download()
    [(_, text, name, kind)] = here.notes
    assert (name, kind) == ("m100link.csv", "text/csv")
    times = [f"1970-01-01T00:17:{at}.000Z,1,2" for at in ("00", "10", "20")]
    assert text.splitlines() == ["utc,velocity.north_m_s,line.discards", *times]
    here.agent.state.replay = SimpleNamespace(position_s=21.0, utc=1021.0)
    for args in (1_030_500.0, "1030500", None):
        part._pointed(SimpleNamespace(args=args))
    assert [type(one).__name__ for one in here.works] == ["coroutine"]
    for work in here.works:
        await work
    assert here.notes[-1] == ("agent", orders.OrderReplay("seek 30.50"))


def test_what_is_saved_of_a_live_chart_is_what_it_shows(here: Here) -> None:
    for utc in (1000.0, 1000.1):
        here.page.history.add(utc, known_view(None))
    part = here.make(data.PlotsPart)
    part._pointed(SimpleNamespace(args=1.0))
    part._toggle()
    here.page.history.add(1000.2, known_view(None))
    here.notes.clear()
    part._download()
    [(_, text, _, _)] = here.notes
    assert [line.partition(",")[0] for line in text.splitlines()] == [
        *("utc", "1970-01-01T00:16:40.000Z", "1970-01-01T00:16:40.100Z")
    ]
    assert here.works == []


def test_only_numbers_that_there_are_can_be_chosen(here: Here) -> None:
    part = here.make(data.PlotsPart)
    chosen: list[Any] = []
    part._chosen = SimpleNamespace(set_value=chosen.append)
    before = part._names
    part._choose(SimpleNamespace(value=["line.discards", "no.such", "line.discards"]))
    assert (chosen, part._names) == ([["line.discards"]], before)
    part._choose(SimpleNamespace(value=None))
    assert part._names == []


async def test_lines_are_placed_once_and_those_of_the_flight_lead_there(here: Here) -> None:
    part = here.make(data.EventsPart)
    lines: list[Any] = []

    def line(level: str, source: str, at: float) -> None:
        number = len(lines) + 1
        lines.append(EventLine(number, at, level, source, f"text {number}"))

    def update() -> list[Any]:
        here.notes.clear()
        with here.client:
            part.update(SimpleNamespace(events=tuple(lines)))
        return list(part._list.default_slot.children)

    line("info", "agent", 3600.0)
    line("error", "flight", 3661.0)
    first = update()
    assert [one.text[:10] for one in first] == ["01:00:00 ·", "01:01:01 ◆"]
    assert [("jump" in one._classes, one._event_listeners != {}) for one in first] == [
        *((False, False), (True, True))
    ]
    assert len(here.notes) == 1, "the newest is scrolled to"
    assert (update(), here.notes) == (first, [])
    line("warning", "agent", 3662.0)
    assert update()[:2] == first
    here.agent.state.replay = SimpleNamespace(position_s=5.0, utc=3600.0)
    await here.event(first[1], "click")
    assert ("agent", orders.OrderReplay("seek 66.00")) in here.notes
    part._choose(least="warning")
    assert [one.text[9:10] for one in update()] == ["◆", "▲"]
    for _ in range(250):
        line("error", "agent", 3700.0)
    assert len(update()) == 200
    assert "200" in part._count.text
    assert "253" in part._count.text


@pytest.mark.parametrize("is_free", [False, True])
async def test_a_take_over_is_asked_for_and_confirmed_by_its_own_press(
    here: Here, is_free: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    timers: list[Any] = []
    monkeypatch.setattr(ui, "timer", lambda _, work, **__: timers.append(work))
    dialog = header.TakeOverDialog(cast(Any, here.tab), here.wording)
    wanted = SimpleNamespace(from_name="bert")
    here.tab.session.confirm = here._async("confirm")

    async def ask_take_over() -> Any:
        if is_free:
            raise UsageError("nobody has it")
        return wanted

    here.tab.session.ask_take_over = ask_take_over
    await dialog.obtain()
    dialog.update()
    assert (timers, here.notes) == ([], [("obtain",)])
    here.raises = LeaseHeld("bert has it")
    await dialog.obtain()
    here.raises = None
    for _ in range(2):
        dialog.update()
    [ask] = timers
    here.notes.clear()
    with here.client:
        await ask()
    if is_free:
        with pytest.raises(ValueError, match="expected 1"):
            here.find(id="take-over")
        return
    assert "bert" in here.find(id="take-over").text
    [shown] = [one for one in here.client.elements.values() if isinstance(one, ui.dialog)]
    [leaves] = here.find(id="leave")._event_listeners.values()
    assert shown.value
    cast(Any, leaves.handler)()
    assert (shown.value, here.notes) == (False, [])
    await here.event(here.find(id="confirm"), "click", {"at": 5.0})
    assert here.notes == [("check_order", 5.0), ("confirm", wanted)]
