"""The map behind the Fly and Plan views, and the flight to a point of it."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any, TypeGuard

from nicegui import events, ui

from m100link.apps.agent.preview import preview
from m100link.apps.station.console.components.component import NumberField, PageContext, attribute
from m100link.apps.station.console.view.map import (
    OFFERED,
    Chart,
    ClickView,
    Drawing,
    GuidedKind,
    MapRefusal,
    Pointed,
    Shown,
    click_of,
)
from m100link.apps.station.console.view.texts import DisplaySettings, QuantityKind, Text
from m100link.apps.station.console.view.view_model import ViewModel
from m100link.apps.station.web.tiles import Pictures
from m100link.protocol.records import Position

# -- the map ---------------------------------------------------------------------------------------

_TOOLS = (("in", "add"), ("out", "remove"), ("follow", "my_location"), ("turn", "navigation"))
"""The action of each, ``page.map.<action>`` is its name for people; its icon."""


class FlightMap(ui.leaflet):
    """A map whose place the page alone decides: where it was moved to is not kept here."""

    def _handle_move_or_zoom_end(self, e: object) -> None:
        """Nothing comes back: it would be sent to the page again, five times a second."""


class MapPart:
    """One map for both views; drawn on by ``static/map.js``."""

    def __init__(self, page: PageContext) -> None:
        self._page = page
        self._shown = Chart(None, ())
        self._pictures: Pictures | None = None  # that the page has
        self._track: Any = None  # home, cursor and other flight that the page has
        self._version: Any = None  # of it, with how many of its places
        options = {"zoomControl": False, "attributionControl": False, "maxZoom": 22}
        with ui.element("div").props("id=map-frame"):
            self.leaflet = FlightMap(zoom=18, options=options | {"keyboard": False})
            self.leaflet.props(f"id=map data-vue={self.leaflet.id}").classes("map")
            self.leaflet.clear_layers()  # the tiles of the Internet
        if page.video is not None:
            ui.element("div").props("id=picture")
        with ui.element("div").classes("map-tools"):
            for what, icon in _TOOLS:
                page.wording.tool(f"page.map.{what}", icon, f"data-map={what}")
        ui.label().props("id=map-home").classes("map-home")
        ui.label().props("id=map-source").classes("map-source")
        page.load("pictures.js")
        page.agent.background.spawn(page.tiles.look(), "map tiles")

    def update(self, view: ViewModel) -> None:
        """Show plan, envelope and track when they are others; what moves comes by the socket."""
        self._update_track(view)
        pictures = self._page.tiles.pictures
        if pictures is not None and pictures != self._pictures:
            self._pictures = pictures
            tiles = pictures._asdict() | {"version": str(pictures.version)}
            ui.run_javascript(
                f'import("/console/pictures.js").then((map) => map.showTiles({json.dumps(tiles)}))'
            )
        chart = view.chart
        if chart != self._shown:
            self._shown = chart
            ui.run_javascript(
                'import("/console/shell.js").then(({m100}) => m100.onMap('
                f"(map) => map.setChart({json.dumps(chart.route)}, {json.dumps(chart.fence)})))"
            )

    def _update_track(self, view: ViewModel) -> None:
        """Send the places that the page does not have. It keeps no track of its own."""
        recorded, until = view.flight, None if view.flight is None else view.flight.at
        path = self._page.history.path if recorded is None else recorded.story.path
        version = id(path), path.version
        before, count = self._version if self._version is not None else (None, 0)
        sent = count if before == version else 0
        points = path.points(sent)
        self._version = version, sent + len(points)
        home = path.home(time.time() if until is None else until)
        other = None if recorded is None else recorded.other
        state = (home, until, id(other), before == version)
        if points or state != self._track:
            is_other = self._track is None or self._track[2] != id(other)
            self._track = state
            given: dict[str, object] = {
                "version": repr(version),
                "from": sent,
                "points": [
                    (round(at, 2), round(lat, 7), round(lon, 7), round(high, 1), joined)
                    for at, lat, lon, high, joined in points
                ],
                "home": None if home is None else (home.latitude_deg, home.longitude_deg),
                "until": until,
            }
            if is_other:
                given["other"] = [] if other is None else other.path.points()
            ui.run_javascript(
                'import("/console/shell.js").then(({m100}) => m100.onMap('
                f"(map) => map.setTrack({json.dumps(given, separators=(',', ':'))})))"
            )


# -- click to fly ----------------------------------------------------------------------------------

# The fields that the panel shows for each kind.
_SHOWN: dict[GuidedKind, tuple[str, ...]] = {
    GuidedKind.PLACE: ("way", "height", "speed"),
    GuidedKind.CIRCLE: ("way", "height", "speed", "radius", "turns", "clockwise"),
    GuidedKind.HEIGHT: ("height",),
    GuidedKind.HEADING: ("yaw_deg",),
}


# Which numbers have handles on the map, and to how many digits a hand sets them.
_DRAGGED = {"radius": 1, "yaw_deg": 0}


class ClickPart:
    """Flies to a point of the map, around it, to a height, to a heading."""

    def __init__(
        self,
        page: PageContext,
        tools: ui.element,  # the place of the button that opens it
    ) -> None:
        self._page = page
        self._say = page.wording
        self._pointed = Pointed()
        self._shown = Shown()
        self.is_open = False
        self._drawn = ""
        self._reported: tuple[tuple[MapRefusal, ...], DisplaySettings] | None = (
            None  # and what it was said in
        )
        self._fields: dict[str, ui.element] = {}
        self._numbers: dict[str, NumberField] = {}
        with tools:
            self._opener = self._say.tool("click.title", "place", "id=point-open")
        self._opener.on("click", lambda: self._open(is_open=not self.is_open), args=[])
        self._build()

    # -- layout ----------------------------------------------------------------------------------

    def _build(self) -> None:
        wording = self._page.wording
        self._page.load("overlays.js")
        ui.on("map_pointed", self._clicked)
        ui.on("map_dragged", self._dragged)
        self._flying = ui.label().props("id=guided-flying role=status")
        with ui.element("div").classes("card click").props("id=click role=region") as self._card:
            wording.put(attribute(self._card), "click.title")
            with ui.element("div").classes("choice"):
                wording.label("click.hint").classes("hint")
                with ui.element("div").classes("choices").props("role=group"):
                    self._kinds = {kind: self._build_kind(kind) for kind in GuidedKind}
                self._build_fields()
            # Never scrolled away.
            with ui.element("div").classes("confirm"):
                self._preview = ui.label().props("id=click-preview role=status")
                self._refusals = ui.element("div").props("id=click-refusals role=alert")
                add = self._page.buttons.add
                with ui.element("div").classes("acts"):
                    self._fly_button = add("guide", "click.fly", self._fly, check=self._check_shown)
                    close = partial(self._open, is_open=False)
                    wording.button("click.close", "id=point-close", close)
        self._open(is_open=False)

    def _build_kind(self, kind: GuidedKind) -> ui.element:
        key, props = f"click.{kind.value}", f"data-kind={kind.value}"
        return self._page.wording.button(key, props, partial(self._kind, kind), looks="")

    def _build_fields(self) -> None:
        with ui.element("div").classes("numbers") as self._fields["way"]:
            far = {"kind": QuantityKind.LENGTH, "limits": (0, 5000)}
            self._distance = self._number("distance", self._by_distance, **far)
            self._bearing = self._number("bearing", self._by_distance, limits=(0, 360))
        for name, word, step, kind in (
            ("height", "height_m", 0.5, QuantityKind.LENGTH),
            ("speed", "speed", 0.5, QuantityKind.SPEED),
            ("radius", "radius", 1.0, QuantityKind.LENGTH),
            ("turns", "turns", 0.25, None),
            ("yaw_deg", "yaw", 1, None),
        ):
            with ui.element("div").classes("dragged") as self._fields[name]:
                self._numbers[name] = self._number(
                    word,
                    partial(self._changed, name),
                    kind=kind,
                    limits=OFFERED.get(name, (0, 359)),
                    step=step,
                    value=getattr(self._pointed, name),
                )
                self._build_slider(word, self._numbers[name], step)

        with ui.element("div") as self._fields["clockwise"]:
            box = ui.checkbox(value=self._pointed.clockwise)
            box.props("id=click-clockwise").on_value_change(self._turned)
            self._page.wording.put(box.set_text, "click.clockwise")

    def _turned(self, event: events.ValueChangeEventArguments[Any]) -> None:
        self._pointed = replace(self._pointed, clockwise=bool(event.value))

    def _build_slider(self, word: str, number: NumberField, step: float) -> None:
        """The handle to drag; the number and the arrow keys do the same."""
        low, high = number.shown_limits
        slider = ui.slider(min=low or 0.0, max=high or 0.0, step=step)
        slider.bind_value(number.element)
        unit = {} if number.kind is None else {"unit": number.kind}
        self._page.wording.put(attribute(slider), f"click.{word}", **unit)

        def follow() -> None:
            low, high = number.shown_limits
            slider.props(f"min={low} max={high}")

        self._page.wording.follow(follow)

    def _number(self, word: str, changed: Callable[[Any], None], **options: Any) -> NumberField:
        wording, props = self._page.wording, f"for=click-{word}"
        return NumberField(wording, f"click.{word}", props, changed=changed, **options)

    # -- what the operator does ------------------------------------------------------------------

    def _open(self, *, is_open: bool) -> None:
        self.is_open = is_open
        self._card.set_visibility(is_open)
        self._opener.props(f"aria-pressed={'true' if is_open else 'false'}")
        if is_open:
            self._kind(self._pointed.kind)
        else:
            self._pointed = replace(self._pointed, place=None)

    def _kind(self, kind: GuidedKind) -> None:
        self._pointed = replace(self._pointed, kind=kind)
        for one, choice in self._kinds.items():
            choice.props(f"aria-pressed={'true' if one is kind else 'false'}")
        for name, field in self._fields.items():
            field.set_visibility(name in _SHOWN[kind])

    def _clicked(self, event: events.GenericEventArguments) -> None:
        if not isinstance(event.args, dict) or event.args.get("view") != "fly":
            return
        place = event.args.get("place")
        if isinstance(place, list) and len(place) == 2 and all(map(_is_number, place)):
            position = self._page.agent.view.get(Position)
            # A flight to a point keeps the height that the aircraft has, unless somebody says so.
            if not self.is_open and position and position.height_m > OFFERED["height"][0]:
                self._pointed = self._pointed.changed("height", round(position.height_m))
                self._numbers["height"].set(self._pointed.height)
            self._pointed = self._pointed.at(*place)
            self._open(is_open=True)

    def _dragged(self, event: events.GenericEventArguments) -> None:
        """A handle on the map was let go: the radius of a circle, or a heading."""
        found = event.args if isinstance(event.args, dict) else {}
        name, value = found.get("name"), found.get("value")
        if not isinstance(name, str) or name not in _DRAGGED:
            return
        if _is_number(value) and self.is_open and self._page.tab.session.has_lease:
            self._pointed = self._pointed.changed(name, round(value, _DRAGGED[name]))
            self._numbers[name].set(getattr(self._pointed, name))

    def _changed(self, name: str, value: float | None) -> None:
        self._pointed = self._pointed.changed(name, value)

    def _by_distance(self, _: float | None) -> None:
        here, distance, bearing = (self._page.here(), self._distance.value, self._bearing.value)
        if here is None or distance is None or bearing is None:
            return
        self._pointed = self._pointed.by_distance(here, distance, bearing)

    def _check_shown(self, shown: object) -> None:
        self._shown.check(shown, self._pointed)

    async def _fly(self) -> None:
        if (order := self._pointed.order) is not None:
            await self._page.tab.ask(order, self._begun)

    def _begun(self) -> None:
        """It flies: what is pointed at now would be the next one."""
        if not self._card.is_deleted:
            with self._card:
                self._open(is_open=False)

    # -- what is shown ---------------------------------------------------------------------------

    def update(self, view: ViewModel) -> None:
        agent = self._page.agent
        order = self._pointed.order if self.is_open else None
        has_control = self._page.tab.session.has_control
        foreseen = None
        if order is not None:
            foreseen = preview(order, agent.telemetry, agent.state.limits)
        found = click_of(
            self._pointed if self.is_open else Pointed(),
            foreseen,
            agent.state.guided,
            has_control=has_control,
            own=self._page.tab.shown_flight(),
        )
        self._preview.set_text(self._said(found.preview))
        self._fly_button.set_visibility(found.may_fly)
        self._fly_button.props(f"data-shown={self._shown.show(self._pointed)}")
        self._flying.set_text(self._said(found.flying))
        self._tell(found.refusals)
        self._draw(found, has_control=has_control)

    def _said(self, text: Text | None) -> str:
        return "" if text is None else self._say(text)

    def _tell(self, refusals: tuple[MapRefusal, ...]) -> None:
        reported = refusals, self._page.wording.settings
        if reported == self._reported:
            return
        self._reported = reported
        self._refusals.clear()
        with self._refusals:
            for refusal in refusals:
                with ui.element("div").classes("problem"):
                    if refusal.reason is not None:
                        ui.label(self._say(refusal.reason))
                    remedy = refusal.remedy
                    ui.label(self._say(remedy) if isinstance(remedy, Text) else remedy)

    def _draw(self, found: ClickView, *, has_control: bool) -> None:
        drawings = {"pointed": _drawing(found.pointed), "flown": _drawing(found.flown)}
        wanted = json.dumps(drawings | {"handles": has_control and self.is_open})
        if wanted != self._drawn:
            self._drawn = wanted
            draw = f"map.drawPointed({wanted})"
            ui.run_javascript(f'import("/console/overlays.js").then((map) => {draw})')


def _drawing(one: Drawing) -> dict[str, object]:
    life = one.life.value
    return {"place": one.place, "radius": one.radius, "yaw": one.yaw_deg, "life": life}


def _is_number(value: object) -> TypeGuard[float]:
    return isinstance(value, int | float) and not isinstance(value, bool)
