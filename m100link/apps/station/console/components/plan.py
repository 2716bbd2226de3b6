"""The Plan view: draw a plan over the map, check it, keep it in files, and fly it."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from enum import IntEnum
from functools import partial
from typing import Any

from nicegui import events, ui

from m100link.apps.agent import orders
from m100link.apps.station.console.components import component
from m100link.apps.station.console.view.plan import (
    Draft,
    DraftHistory,
    PlanNote,
    actions_of,
    checked,
    drawing,
    figures_of,
    is_same,
    profile,
    profile_options,
    row_of,
    summary_of,
    text_of,
    upload_of,
)
from m100link.apps.station.console.view.texts import QuantityKind, tr
from m100link.apps.station.console.view.view_model import ViewModel
from m100link.errors import M100Error, UsageError
from m100link.missions.plan import WaypointPlan
from m100link.missions.survey import line_spacing
from m100link.missions.waypoint import AtEnd, Heading, Trace, Waypoint

_FIRST_HEIGHT_M = 20.0
_PATTERNS = (0, 1, 4)  # the simple tasks that are offered

Place = tuple[float, float]


class PlanPart:
    """Cards beside the map, which shows the way; what flies a plan stays in sight below them."""

    def __init__(self, page: component.PageContext) -> None:
        self._page = page
        self._say = page.wording
        self._history = DraftHistory()
        self._chosen: int | None = None
        self._is_area = False  # clicks make corners of the area, and not points
        self._found = checked(Draft())
        self._figured: tuple[object, ...] = ()  # plan and take-off point of the figures
        self._build()

    @property
    def _draft(self) -> Draft:
        return self._history.draft

    # -- layout ----------------------------------------------------------------------------------

    def _build(self) -> None:
        self._page.load("overlays.js")
        ui.on("map_pointed", self._clicked)
        ui.on("plan_moved", self._moved)
        ui.on("plan_chosen", self._picked)
        with ui.element("div").classes("drawn"):
            self._build_draft()
        self._build_mission()
        self._page.wording.follow(self._show)

    def _build_draft(self) -> None:
        wording = self._page.wording
        with wording.card("plan.title"):
            wording.label("plan.hint").classes("hint")
            self._build_tools()
            self._problem = ui.label().classes("problem").props("id=plan-problem role=alert")
            self._summary = ui.label().props("id=plan-summary role=status")
            self._notes = ui.element("ul").props("id=plan-notes").classes("notes")
            self._rows = ui.element("ol").props("id=plan-rows").classes("rows")
        self._waypoint = WaypointPart(wording, self._change_point, self._move_point, self._refuse)
        with wording.card("plan.profile"):
            self._chart = ui.echart({}).classes("profile")
            self._chart.props("id=plan-profile role=img")
            wording.put(component.attribute(self._chart), "plan.profile")
            wording.label("plan.terrain").classes("hint")
        self._whole = WholePart(wording, self._change, self._pattern)
        self._build_files()

    def _build_tools(self) -> None:
        with ui.element("div").classes("choices").props("role=group"):
            self._modes = {
                is_area: self._tool(word, partial(self._mode, is_area=is_area))
                for word, is_area in (("points", False), ("area", True))
            }
            self._tool("undo", lambda: self._go(self._history.undo()))
            self._tool("redo", lambda: self._go(self._history.redo()))
            self._tool("clear", lambda: self._change(Draft()))
            self._tool("add", self._add_point)
            self._tool("fit", lambda: _run("map.fit()"))

    def _tool(self, word: str, work: Callable[[], None]) -> ui.element:
        return self._page.wording.button(f"plan.{word}", f"data-plan={word}", work, looks="")

    def _build_files(self) -> None:
        with self._page.wording.card("plan.file"):
            # A label that looks like a button: a screen reader makes nothing of what Quasar has.
            chosen = ui.element("input").classes("unseen")
            chosen.props('type=file accept=".json,.plan" id=plan-file')
            chosen.on(
                "change",
                js_handler='(event) => import("/console/overlays.js")'
                ".then((map) => map.open(event.target))",
            )
            with ui.element("label").classes("act plain").props("for=plan-file"):
                self._page.wording.label("plan.open")
            ui.on("plan_opened", self._opened)
            with ui.element("div").classes("choices"):
                self._tool("export_plan", lambda: self._save("plan"))
                self._tool("export_json", lambda: self._save("json"))

    def _build_mission(self) -> None:
        add, wording = self._page.buttons.add, self._page.wording
        with ui.element("section").classes("card mission") as box:
            self._uploaded = ui.label().props("id=plan-uploaded")
            self._plan = ui.label().props("id=plan")
            self._progress = ui.linear_progress(0.0, show_value=False)
            self._progress.props("id=mission-progress")
            self._state = ui.label().props("id=mission role=status")
            with ui.element("div").classes("acts"):
                add("mission_upload", "plan.upload", self._upload)
                add("mission_start", "plan.start", self._start)
                add("mission_resume", "plan.resume", partial(self._order, orders.ResumeMission()))
                add("mission_stop", "plan.stop", partial(self._order, orders.StopMission()))
                add("simple_task", "actions.simple_task", self._fly_pattern)
                self._number = ui.select(list(_PATTERNS), value=0).classes("task-number")
                self._number.props("dense outlined id=task-number")
        wording.options(self._number, {number: f"page.simple.{number}" for number in _PATTERNS})
        for element, key in (
            (box, "plan.mission"),
            (self._progress, "plan.progress"),
            (self._number, "page.which_task"),
        ):
            wording.put(component.attribute(element), key)

    # -- what the operator does ------------------------------------------------------------------

    def _change(self, draft: Draft) -> None:
        self._go(self._history.done(draft))

    def _go(self, history: DraftHistory) -> None:
        self._history = history
        self._refuse("")
        if self._chosen is not None and self._chosen >= len(history.draft.points):
            self._chosen = None
        self._show()

    def _refuse(self, problem: str) -> None:
        self._problem.set_text(problem)

    def _mode(self, *, is_area: bool) -> None:
        self._is_area = is_area
        self._show()

    def _clicked(self, event: events.GenericEventArguments) -> None:
        place = _place(event.args)
        if place is None or event.args.get("view") != "plan":
            return
        if self._is_area:
            self._change(self._draft.cornered(place))
        else:
            self._add(place)

    def _add(self, place: Place) -> None:
        points, chosen = self._draft.points, self._chosen
        after = len(points) - 1 if chosen is None else chosen
        height = points[after].height if points else _FIRST_HEIGHT_M
        draft = self._draft.added(place, height, after)
        self._chosen = after + 1
        self._change(draft)

    def _add_point(self) -> None:
        """Without pointing: beside the last one, or where the aircraft is; numbers move it."""
        points = self._draft.points
        if points:
            after = points[-1 if self._chosen is None else self._chosen]
            self._add((after.latitude_deg + 2e-4, after.longitude_deg))
        elif (here := self._page.here()) is not None:
            self._add(here)
        else:
            self._add((0.0, 0.0))

    def _moved(self, event: events.GenericEventArguments) -> None:
        place = _place(event.args)
        index = event.args.get("index") if place is not None else None
        if place is None or type(index) is not int:
            return
        if event.args.get("kind") == "corner":
            self._change(self._draft.corner_moved(index, place))
        else:
            self._chosen = index
            self._change(self._draft.moved(index, place))

    def _picked(self, event: events.GenericEventArguments) -> None:
        index = event.args.get("index") if isinstance(event.args, dict) else None
        if type(index) is int:
            self._choose(index)

    def _choose(self, index: int) -> None:
        self._chosen = index if 0 <= index < len(self._draft.points) else None
        self._show()

    def _change_point(self, **values: object) -> None:
        if self._chosen is not None:
            self._change(self._draft.changed(self._chosen, **values))

    def _move_point(self, by: int) -> None:
        """Earlier or later in the order; 0 removes it."""
        if self._chosen is None:
            return
        if by == 0:
            self._change(self._draft.removed(self._chosen))
            return
        to = self._chosen + by
        draft = self._draft.put(self._chosen, to)
        if draft != self._draft:
            self._chosen = to
            self._change(draft)

    def _pattern(self, **how: Any) -> None:
        """Lines over the area, or with a radius an orbit around its only corner."""
        make = self._draft.orbited if "radius" in how else self._draft.surveyed
        try:
            draft = make(start=self._page.here(), **how)
        except UsageError as error:
            self._refuse(str(error))
        else:
            self._chosen = None
            self._change(draft)

    def _opened(self, event: events.GenericEventArguments) -> None:
        content = event.args.get("text") if isinstance(event.args, dict) else None
        try:
            if not isinstance(content, str):
                raise UsageError("this file is too large to be a plan", remedy="choose another one")
            plan = WaypointPlan.parse(content)
        except M100Error as error:
            self._refuse(str(error))
            return
        self._chosen = None
        self._change(Draft.of(plan, self._draft.area))
        _run("map.fit()")

    def _save(self, kind: str) -> None:
        plan = self._found.plan
        if plan is None:
            self._refuse(self._say(summary_of(self._draft, self._found)))
            return
        text = plan.to_qgroundcontrol() if kind == "plan" else plan.to_json()
        ui.download.content(text, f"m100link.{kind}", "application/json")

    async def _upload(self) -> None:
        await self._order(orders.UploadPlan.of(self._draft.plan()))

    async def _start(self) -> None:
        """Fly the plan that this operator uploaded, and none that somebody else uploaded since."""
        drawn, uploaded = self._found.plan, self._page.agent.plan
        # As the page says beside the button: of a plan that is not drawn here nobody sees it.
        takes_off = is_same(drawn, uploaded) and drawn.take_off
        if not takes_off and self._page.memory.situation.is_on_ground:
            raise UsageError(
                "the aircraft stands on the ground, and the plan has no take-off; nothing was sent",
                remedy="take off, or tick Take off first and upload the plan",
            )
        await self._order(orders.StartMission(self._page.tab.session.uploaded, takes_off))

    async def _fly_pattern(self) -> None:
        await self._order(orders.FlyPattern(int(self._number.value)))

    async def _order(self, order: orders.Order) -> None:
        await self._page.tab.ask(order)

    # -- what is shown ---------------------------------------------------------------------------

    def _show(self) -> None:
        """Show the draft: after each change of it or of the settings, and only then."""
        draft = self._draft
        self._figured = ()
        self._show_figures()
        found = self._found
        for is_area, mode in self._modes.items():
            mode.props(f"aria-pressed={'true' if is_area is self._is_area else 'false'}")
        self._notes.clear()
        with self._notes:
            for note in found.notes:
                if note.point is None:
                    _tell(note)
        self._show_rows()
        chosen = None if self._chosen is None else draft.points[self._chosen]
        self._waypoint.show(self._chosen, chosen)
        self._whole.show(draft)
        units = self._page.wording.settings.units
        self._chart.options.update(profile_options(profile(draft.points), units))
        self._chart.update()
        # The row that was pressed is another one by now, and no place for a script to run in.
        with self._rows:
            _run(f"map.drawPlan({json.dumps(drawing(draft, found, self._chosen))})")

    def _show_figures(self) -> None:
        """Length, time and battery, of the drawn and the uploaded plan alike."""
        plan, home = self._page.agent.plan, self._page.home()
        if self._figured == (figured := (plan, home)):
            return
        self._figured = figured
        self._found = found = checked(self._draft, home)
        self._summary.set_text(self._say(summary_of(self._draft, found)))
        figures = (
            tr("mission.no_plan") if plan is None else figures_of(plan, plan.estimate(home=home))
        )
        self._plan.set_text(self._say(figures))

    def _show_rows(self) -> None:
        self._rows.clear()
        with self._rows:
            for index, point in enumerate(self._draft.points):
                with ui.element("li"):
                    pressed = "true" if index == self._chosen else "false"
                    row = ui.element("button").props(
                        f"type=button data-point={index} aria-pressed={pressed}"
                    )
                    with row:
                        ui.label(self._say(row_of(index + 1, point)))
                        for note in self._found.at(index):
                            _tell(note, "span")
                    row.on("click", partial(self._choose, index), args=[])

    def update(self, view: ViewModel) -> None:
        agent = self._page.agent
        uploaded = upload_of(self._found.plan, agent.plan, agent.plan_by)
        self._uploaded.set_text(self._say(uploaded))
        self._show_figures()
        self._state.set_text(self._say(view.mission.state))
        self._progress.set_value(view.mission.part)


def _tell(note: PlanNote, tag: str = "li") -> None:
    with ui.element(tag).classes("note wrong" if note.is_error else "note"):
        ui.label(note.text)


def _run(code: str) -> None:
    ui.run_javascript(f'import("/console/overlays.js").then((map) => {code})')


def _place(args: Any) -> Place | None:
    """The place in a message of the page; None if there is none."""
    place = args.get("place") if isinstance(args, dict) else None
    if not isinstance(place, list) or len(place) != 2:
        return None
    if not all(isinstance(one, int | float) and abs(one) <= 360 for one in place):
        return None
    return float(place[0]), float(place[1])


# -- the chosen waypoint of a plan -----------------------------------------------------------------


class WaypointPart:
    def __init__(
        self,
        wording: component.Wording,  # says what stands there
        change: Callable[..., None],  # takes the fields of :class:`~m100link.Waypoint` that change
        move: Callable[[int], None],  # puts it earlier (-1) or later (1), or removes it (0)
        refuse: Callable[[str], None],  # takes what is not an action
    ) -> None:
        self._change, self._refuse = change, refuse
        self._numbers: dict[str, component.NumberField] = {}
        self._is_showing = False  # what is set then was not typed
        with ui.element("div").classes("card w-full").props("id=waypoint") as self._card:
            self._title = ui.label().classes("title")
            with ui.element("div").classes("numbers"):
                for name, word, step, kind in (
                    ("height", "height", 1.0, QuantityKind.LENGTH),
                    ("heading_deg", "heading", 5.0, None),
                    ("gimbal_pitch_deg", "pitch", 5.0, None),
                    ("latitude_deg", "latitude", 1e-5, None),
                    ("longitude_deg", "longitude", 1e-5, None),
                ):
                    self._numbers[name] = component.NumberField(
                        wording,
                        f"plan.{word}",
                        f"debounce=300 for=waypoint-{word}",
                        kind=kind,
                        step=step,
                        changed=partial(self._typed, name),
                    )
            self._actions = ui.input()
            self._actions.props("dense outlined debounce=500 for=waypoint-actions")
            wording.put(component.attribute(self._actions, "label"), "plan.actions")
            wording.put(component.attribute(self._actions, "hint"), "plan.actions_hint")
            self._actions.on_value_change(self._acted)
            with ui.element("div").classes("choices"):
                for word, by in (("earlier", -1), ("later", 1), ("remove", 0)):
                    props = f"data-plan={word}"
                    wording.button(f"plan.{word}", props, partial(move, by), looks="")
        self._card.set_visibility(False)

    def show(self, index: int | None, point: Waypoint | None) -> None:
        self._card.set_visibility(point is not None)
        if index is None or point is None:
            return
        self._is_showing = True
        self._title.set_text(str(index + 1))
        for name, number in self._numbers.items():
            number.set(getattr(point, name))
        if not self._is_same_text(point):
            self._actions.set_value(text_of(point.actions))
        self._is_showing = False

    def _is_same_text(self, point: Waypoint) -> bool:
        """Whether what stands there means these actions: nobody's typing is rewritten."""
        try:
            return actions_of(self._actions.value or "") == tuple(point.actions)
        except UsageError:
            return False

    def _typed(self, name: str, value: float | None) -> None:
        if value is not None:
            self._change(**{name: value})

    def _acted(self, event: events.ValueChangeEventArguments[Any]) -> None:
        if self._is_showing:
            return
        try:
            actions = actions_of(str(event.value or ""))
        except UsageError as error:
            self._refuse(str(error))
        else:
            self._change(actions=actions)


# -- what holds for a plan as a whole --------------------------------------------------------------

X3_DEG = 81.0
"""Field of view of a Zenmuse X3 across its pictures, °: 20 mm in terms of 35 mm film, at 4 to 3."""

_CHOICES: tuple[tuple[str, str, type[IntEnum]], ...] = (
    ("at_end", "at_end", AtEnd),
    ("heading", "nose", Heading),
    ("trace", "trace", Trace),
)

_LINES: tuple[tuple[str, float | None, float, float, QuantityKind | None], ...] = (
    ("height", 30.0, 2, 1, QuantityKind.LENGTH),
    ("overlap", 70.0, 0, 5, None),
    ("spacing", None, 1, 1, QuantityKind.LENGTH),
    ("angle", 0.0, -180, 5, None),
    ("photo_every", None, 2, 1, QuantityKind.LENGTH),
    ("radius", 30.0, 5, 5, QuantityKind.LENGTH),
)
"""Of the patterns: the name, what stands there at first, the least, the step of the arrows, and the
quantity."""


class WholePart:
    def __init__(
        self,
        wording: component.Wording,  # says what stands there
        change: Callable[[Draft], None],  # takes another draft
        pattern: Callable[..., None],  # makes lines over the area, or an orbit
    ) -> None:
        self._change, self._pattern = change, pattern
        self._draft = Draft()
        self._selects: dict[str, ui.select] = {}
        self._lines: dict[str, component.NumberField] = {}
        self._is_showing = False  # what is set then was not chosen
        with ui.element("div").classes("card w-full"), ui.element("div").classes("numbers"):
            self._speed = component.NumberField(
                wording,
                "plan.speed",
                "debounce=300 for=plan-speed",
                kind=QuantityKind.SPEED,
                limits=(0, 15),
                step=0.5,
                changed=self._sped,
            )
            for name, word, kind in _CHOICES:
                select = ui.select([one.value for one in kind])
                said = {one.value: f"plan.{word}.{one.name.lower()}" for one in kind}
                wording.options(select, said)
                wording.put(component.attribute(select, "label"), f"plan.{word}")
                select.props(f"dense outlined for=plan-{word}")
                select.on_value_change(partial(self._selected, name, kind))
                self._selects[name] = select
            self._take_off = ui.checkbox().props("id=plan-take-off")
            self._take_off.on_value_change(partial(self._selected, "take_off", bool))
            wording.put(self._take_off.set_text, "plan.take_off")
        with wording.card("plan.pattern"):
            wording.label("plan.pattern_hint").classes("hint")
            with ui.element("div").classes("numbers"):
                for name, value, low, step, measure in _LINES:
                    self._lines[name] = component.NumberField(
                        wording,
                        f"plan.{name}",
                        f"clearable for=survey-{name}",
                        kind=measure,
                        limits=(low, None),
                        step=step,
                        value=value,
                    )
            with ui.element("div").classes("choices"):
                wording.button("plan.lines", "data-plan=lines", self._make_lines, looks="")
                wording.button("plan.orbit", "data-plan=orbit", self._make_orbit, looks="")

    def show(self, draft: Draft) -> None:
        self._draft, self._is_showing = draft, True
        self._speed.set(draft.speed)
        for name, select in self._selects.items():
            select.set_value(int(getattr(draft, name)))
        self._take_off.set_value(draft.take_off)
        self._is_showing = False

    def _sped(self, speed: float | None) -> None:
        if speed is not None:
            self._change(replace(self._draft, speed=speed, max_speed=max(10.0, speed)))

    def _selected(
        self, name: str, kind: Callable[[Any], Any], event: events.ValueChangeEventArguments[Any]
    ) -> None:
        if not self._is_showing:
            self._change(replace(self._draft, **{name: kind(event.value)}))

    def _make_lines(self) -> None:
        values = {name: number.value for name, number in self._lines.items()}
        height, every = float(values["height"] or 0.0), values["photo_every"]
        spacing = values["spacing"]
        if spacing is None:  # from the overlap
            try:
                spacing = line_spacing(height, (values["overlap"] or 0.0) / 100.0, X3_DEG)
            except UsageError:
                spacing = 0.0  # which is refused with its remedy
        self._pattern(
            height=height,
            spacing=float(spacing),
            angle_deg=float(values["angle"] or 0.0),
            photo_every=every,
        )

    def _make_orbit(self) -> None:
        self._pattern(
            height=self._lines["height"].value or 0.0,
            radius=self._lines["radius"].value or 0.0,
            photo_every=self._lines["photo_every"].value,
        )
