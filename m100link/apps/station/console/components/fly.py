"""The Fly view: over the map, what is needed to fly."""

from __future__ import annotations

import json
import math
import time
from dataclasses import dataclass
from functools import partial
from typing import Any

from nicegui import events, ui

from m100link.apps.agent.orders import (
    CameraUse,
    GoHome,
    Land,
    PauseMission,
    PointGimbal,
    TurnGimbal,
    UseCamera,
)
from m100link.apps.station.config import Video
from m100link.apps.station.console.components import component
from m100link.apps.station.console.components.map import ClickPart
from m100link.apps.station.console.view import fly
from m100link.apps.station.console.view.texts import QuantityKind, Text, tr
from m100link.apps.station.console.view.view_model import ViewModel
from m100link.protocol.commands.gimbal import GimbalAngle, GimbalAngleMode, GimbalSpeed
from m100link.protocol.records import Attitude, Gimbal

_TOOLS = (("horizon", "explore"), ("sticks", "gamepad"), ("camera", "photo_camera"))
_VIDEO = (("video", "videocam"),)
"""The panels that fold: the page does it by itself, and keeps what was chosen."""


class PreparedPart:
    """One thing is prepared at a time: a take-off, or a flight to a point."""

    def __init__(self, page: component.PageContext) -> None:
        with _place("tools") as tools:
            for name, icon in (*_TOOLS, *(_VIDEO if page.video is not None else ())):
                page.wording.tool(f"page.fold.{name}", icon, f"data-fold={name}")
        with _place("prepared"):
            self._click, self._ground = ClickPart(page, tools), GroundPart(page)

    def update(self, view: ViewModel) -> None:
        self._click.update(view)
        self._ground.update(view, is_covered=self._click.is_open)


def _place(name: str) -> ui.element:
    """Where it stands is said by the style sheet, for every size."""
    return ui.element("div").classes(f"place {name}")


# -- what one steers with --------------------------------------------------------------------------
# The pad. ``static/steer.js`` makes beats of it while something is held, and fills in the legend
# between the sticks: what keys do, and what the last one just did.


class SticksPart:
    def __init__(self, page: component.PageContext) -> None:
        wording = page.wording
        with _place("steering"), ui.element("div").props("id=pad tabindex=0 role=group") as pad:
            _build_stick(wording, "climb", "turn,up")
            with ui.element("div").classes("between"):
                _build_legend(wording)
            _build_stick(wording, "move", "right,forward")
        wording.put(component.attribute(pad), "page.steering")

    def update(self, view: ViewModel) -> None:
        """Nothing of it comes with the view."""


def _build_stick(wording: component.Wording, name: str, axes: str) -> None:
    key = f"page.stick.{name}"
    with ui.element("div").classes(f"stick {name}").props(f"data-axes={axes} role=img") as stick:
        wording.label(key)
    wording.put(component.attribute(stick), "page.stick", what=Text(key))


def _build_legend(wording: component.Wording) -> None:
    with ui.element("div").classes("legend"):
        wording.label("page.legend.idle").classes("idle by-keys")
        wording.label("page.legend.idle.finger").classes("idle by-finger")
        ui.element("div").props("id=did role=status")
        wording.label("page.legend.keys").classes("keys")
        with ui.element("div").classes("choices"):
            _build_step(wording, "slower", "−")
            wording.label("page.legend.speed").classes("hint")
            ui.element("output").props("data-level")
            _build_step(wording, "faster", "+")
            with ui.element("button").props("type=button data-steer=mode"):
                ui.element("span").props("data-mode")
                ui.element("span").classes("hint").props("data-hint")


def _build_step(wording: component.Wording, what: str, sign: str) -> None:
    with ui.element("button").props(f"type=button data-steer={what}") as step:
        ui.label(sign).props("aria-hidden=true")
    wording.put(component.attribute(step), f"page.legend.{what}")


# -- camera and gimbal -----------------------------------------------------------------------------
# No firmware confirms an order to the camera. So the page says what was asked for and when, and
# never that a video runs. Of the gimbal it says what telemetry shows.

_TURN_DEG_S = 40.0  # of the gimbal, while the place to drag is dragged to its edge
_LOOK_S = 0.5  # in which the gimbal comes to an angle
_PITCH_DEG = (-90.0, 30.0)


_NOTED_S = 1.0  # between two notes of one page in the log


def _build_video(page: component.PageContext, video: Video) -> None:
    """The frame in which the smaller of map and video stands; a tap lets them change places."""
    with ui.element("button").props("id=video type=button aria-pressed=false") as frame:
        pass
    page.wording.put(component.attribute(frame), "page.video_swap")
    asked = json.dumps({"kind": video.kind, "url": video.url})
    ui.run_javascript(f'import("/console/pictures.js").then((one) => one.showVideo({asked}))')
    noted = [-math.inf]

    def note(event: events.GenericEventArguments) -> None:
        """The log has the origin alone: what follows it may be secret."""
        now = time.monotonic()
        said = _VIDEO_STATES.get(str(event.args))
        if said is not None and now - noted[0] >= _NOTED_S:
            noted[0] = now
            page.agent.note(f"video of {video.origin}: {said}")

    ui.on("video_told", note)


_VIDEO_STATES = {
    "live": "a page shows it",
    "undated": "a page shows it, its age is unknown",
    "old": "a page gets no picture",
}


class HudPart:
    """The drawing of attitude, speed and height, which the socket feeds, and the camera."""

    def __init__(self, page: component.PageContext) -> None:
        self._page = page
        self._is_held = False  # a finger moves the slider
        self._asked: tuple[str, float] | None = None  # the last order to the camera, and when
        wording, add = page.wording, page.buttons.add
        # It scrolls where a phone has no room for both: by keys, too, with all its buttons grey.
        with _place("hud").props("tabindex=0 role=group") as hud:
            if page.video is not None:
                _build_video(page, page.video)
            horizon = ui.element("canvas").props("id=horizon role=img")
        wording.put(component.attribute(hud), "page.fold.horizon")
        wording.put(component.attribute(horizon), "instruments.horizon")
        photo = partial(self._use, "photo", CameraUse.PHOTO)
        with _place("shutter"):  # on the map: one tap, whatever is folded
            add("photo", "camera.photo", photo, kind="plain")
        self._card = ui.element("div").classes("card camera").props("id=camera")
        self._card.move(hud)
        with self._card:
            with ui.element("div").classes("acts"):
                for name, use in _VIDEO_USES.items():
                    add(name, f"camera.{name}", partial(self._use, name, use), kind="plain")
                add("gimbal_centre", "camera.centre", self._centre, kind="plain")
            look = ui.element("div").classes("stick look").props('data-axes="yaw,pitch" role=img')
            with look:
                wording.label("camera.look")
            wording.put(component.attribute(look), "camera.look.hint")
            low, high = _PITCH_DEG
            self._pitch = ui.slider(min=low, max=high, step=1.0, value=0.0)
            self._pitch.props("id=gimbal-pitch").on("change", self._pitched)
            self._pitch.on("pan", self._held)
            wording.put(component.attribute(self._pitch), "camera.pitch")
            self._state = ui.label().props("id=camera-state role=status")
        ui.on("looked", self._looked)
        ui.on("photo_pressed", lambda: page.buttons.ask("photo", photo), args=[])

    async def _use(self, name: str, use: CameraUse) -> None:
        await self._page.tab.ask(UseCamera(use))
        self._asked = name, self._page.agent.now
        self._page.agent.note(f"{self._page.tab.session.name}: {use.value.replace('_', ' ')}, sent")

    async def _centre(self) -> None:
        """To the nose and the horizon."""
        attitude = self._page.agent.view.get(Attitude)
        yaw = 0.0 if attitude is None else attitude.yaw_deg
        keep = GimbalAngleMode.KEEP_YAW if attitude is None else 0
        await self._point(GimbalAngle(yaw, 0.0, 0.0, GimbalAngleMode.ABSOLUTE | keep, _LOOK_S))

    async def _point(self, angle: GimbalAngle) -> None:
        await self._page.tab.ask(PointGimbal(angle))

    def _held(self, event: events.GenericEventArguments) -> None:
        self._is_held = event.args == "start"

    def _pitched(self) -> None:
        self._is_held = False
        kept = GimbalAngleMode.KEEP_YAW | GimbalAngleMode.KEEP_ROLL | GimbalAngleMode.ABSOLUTE
        pitch = float(self._pitch.value or 0.0)
        self._page.buttons.ask(
            "gimbal", lambda: self._point(GimbalAngle(0, 0, pitch, kept, _LOOK_S))
        )

    def _looked(self, event: events.GenericEventArguments) -> None:
        """The place is dragged: the gimbal turns for half a second, as long as that goes on."""
        found = event.args if isinstance(event.args, dict) else {}
        if all(isinstance(found.get(one), int | float) for one in ("yaw", "pitch")):
            yaw, pitch = (_TURN_DEG_S * max(-1.0, min(1.0, found[one])) for one in ("yaw", "pitch"))
            turn = TurnGimbal(GimbalSpeed(yaw_deg_s=yaw, pitch_deg_s=pitch))
            self._page.buttons.ask("gimbal", lambda: self._page.tab.ask(turn))

    def update(self, view: ViewModel) -> None:
        reading, said = view.instruments.readings["gimbal"], self._page.wording
        gimbal = self._page.agent.view.get(Gimbal)
        is_offered = "gimbal" in view.actions
        self._pitch.set_enabled(is_offered)
        if gimbal is not None and not self._is_held:
            self._pitch.set_value(round(gimbal.pitch_deg))
        text = said(reading.text)
        if self._asked is not None:
            name, at = self._asked
            ago = round(self._page.agent.now - at)
            is_new = ago < _SAID_S
            self._card.classes(add="asked" if is_new else "", remove="" if is_new else "asked")
            text += " · " + said(tr(f"camera.{name}.asked", seconds=ago))
        self._state.set_text(text if is_offered or self._asked else said(Text("camera.none")))


_SAID_S = 10.0  # for which a folded card says what was asked of the camera
_VIDEO_USES = {
    "video_start": CameraUse.START_VIDEO,
    "video_stop": CameraUse.STOP_VIDEO,
}

# -- before take-off -------------------------------------------------------------------------------

_SHAPES = {fly.ItemState.RIGHT: "✔", fly.ItemState.WRONG: "✖", fly.ItemState.UNKNOWN: "?"}


@dataclass(slots=True)
class _Row:
    box: Any
    shape: Any
    state: Any
    seen: Any
    remedy: Any
    shown: fly.ItemState | None = None


class ChecklistPart:
    """What :class:`~m100link.apps.station.console.view.fly.Checklist` says."""

    def __init__(self, page: component.PageContext) -> None:
        self._page = page
        wording, checklist = page.wording, page.memory.checklist
        with wording.card("checklist.title"):
            self._summary = ui.label().classes("summary").props("id=check-summary role=status")
            with ui.element("ul").classes("checks").props("id=checks"):
                self._rows = {item: self._build_row(item) for item in fly.ITEMS}
            self._free = FreeBox(page)
            self._why = ui.input(on_change=lambda event: checklist.say_why(str(event.value or "")))
            self._why.props("for=why outlined maxlength=200").classes("w-full")
            wording.put(lambda text: self._why.props(f'label="{text}"'), "checklist.why")
            wording.put(lambda text: self._why.props(f'hint="{text}"'), "checklist.why.note")

    def _build_row(self, item: fly.ChecklistItem) -> _Row:
        wording = self._page.wording
        with ui.element("li").classes("check").props(f"data-check={item.value}") as box:
            shape = ui.label().classes("shape").props("aria-hidden=true")
            with ui.element("div"):
                with ui.element("div").classes("check-head"):
                    wording.label(f"checklist.{item.value}").classes("name")
                    state = ui.label().classes("unseen")
                    seen = ui.label().classes("seen")
                    if fly.ITEMS[item]:
                        wording.label("checklist.needed").classes("needed")
                remedy = ui.label().classes("remedy")
        return _Row(box, shape, state, seen, remedy)

    def update(self, view: ViewModel) -> None:
        checklist, wording = view.checklist, self._page.wording
        for check in checklist.checks:
            self._show(self._rows[check.item], check)
        self._summary.set_text(wording(_summary(checklist)))
        self._free.update(checklist)
        self._why.set_visibility(not checklist.is_green and checklist.is_possible)
        if not checklist.reason and self._why.value and view.checklist.is_green:
            self._why.set_value("")

    def _show(self, row: _Row, check: fly.Check) -> None:
        wording = self._page.wording
        row.seen.set_text(wording(check.seen))
        row.remedy.set_text(wording(check.remedy) if check.remedy is not None else "")
        row.state.set_text(wording(Text(f"checklist.state.{check.state.value}")))
        if check.state is not row.shown:
            row.box.classes(remove=row.shown.value if row.shown else "", add=check.state.value)
            row.shape.set_text(_SHAPES[check.state])
            row.shown = check.state


def _summary(checklist: fly.Checklist) -> Text:
    if checklist.is_green:
        return tr("checklist.green")
    if not checklist.is_possible:
        return tr("checklist.impossible")
    return tr("checklist.missing", count=len(checklist.missing))


class FreeBox:
    """The operator's word that the place is free; it stands wherever a take-off is prepared."""

    def __init__(self, page: component.PageContext) -> None:
        self._page = page
        self._box = ui.checkbox(on_change=lambda event: self._say(is_free=bool(event.value)))
        page.wording.put(self._box.classes("free").set_text, "checklist.free.box")

    def _say(self, *, is_free: bool) -> None:
        checklist, now = self._page.memory.checklist, self._page.agent.now
        if is_free is checklist.is_free(now):
            return  # the box follows what was said, and says nothing by itself
        checklist.say_free(now, is_free=is_free)

    def update(self, checklist: fly.Checklist) -> None:
        if bool(self._box.value) is not checklist.is_free_said:
            self._box.set_value(checklist.is_free_said)


_HEIGHTS = (fly.TAKE_OFF_HEIGHT, 120.0)  # to which a take-off is offered, m


class GroundPart:
    """The take-off is prepared here, above the strip, while the aircraft stands."""

    def __init__(self, page: component.PageContext) -> None:
        self._wording, checklist = page.wording, page.memory.checklist

        def choose(height: float | None) -> None:
            low, high = _HEIGHTS
            checklist.height = min(max(height or low, low), high)

        with ui.element("div").classes("card ground").props("id=ground") as self._card:
            component.NumberField(
                page.wording,
                "actions.height",
                "for=take-off-height",
                kind=QuantityKind.LENGTH,
                limits=_HEIGHTS,
                value=checklist.height,
                changed=choose,
            )
            with ui.element("button").props("type=button data-go=check id=why-not") as why_not:
                self._why_not = ui.label()
            self._button = why_not.classes("see")
            why_not.on("click", lambda: page.show("check"), args=[])
            self._free = FreeBox(page)

    def update(self, view: ViewModel, *, is_covered: bool) -> None:
        checklist, now = view.checklist, view.situation
        self._card.set_visibility(
            now.is_on_ground is not False and not now.is_replay and not is_covered
        )
        self._free.update(checklist)
        self._button.set_visibility(not checklist.may_take_off)
        self._why_not.set_text(self._wording(tr("actions.why_not", count=len(checklist.missing))))


# -- the buttons that one flies with: in every view, and where a thumb is --------------------------


class StripPart:
    def __init__(self, page: component.PageContext) -> None:
        self._page = page
        tab, add = page.tab, page.buttons.add
        with ui.element("div").props("id=strip role=group") as strip:
            add("take_off", "actions.take_off", page.take_off)
            add("land", "actions.land", lambda: tab.ask(Land()))
            add("go_home", "actions.go_home", lambda: tab.ask(GoHome()))
            add("pause", "actions.pause", self._pause, kind="plain")
        page.wording.put(component.attribute(strip), "actions.title")

    async def _pause(self) -> None:
        """The aircraft hovers: a mission waits, a flight to a point ends."""
        agent, session = self._page.agent, self._page.tab.session
        if agent.state.guided is None:
            await session.ask(PauseMission())
        else:
            agent.hover(f"{session.name}: pause", session.lease)
