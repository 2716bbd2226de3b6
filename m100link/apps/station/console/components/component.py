"""The base of every component: texts, buttons that give orders, fields, and their page."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Awaitable, Callable, Mapping, Set
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any, Protocol

from nicegui import events, ui
from nicegui.events import GenericEventArguments

from m100link.apps.agent.client import PRESSED_AT, AgentClient
from m100link.apps.agent.orders import ChangeHeight, OrderReplay, TakeOff
from m100link.apps.station.config import Video
from m100link.apps.station.console.kept import PlotHistory
from m100link.apps.station.console.tab import Tab
from m100link.apps.station.console.tabs import Tabs
from m100link.apps.station.console.view.fly import CAMERA, HELD, TAKE_OFF_HEIGHT, FieldReading
from m100link.apps.station.console.view.texts import (
    DisplaySettings,
    QuantityKind,
    Text,
    Translator,
    tr,
)
from m100link.apps.station.console.view.view_model import Memory, ViewModel
from m100link.apps.station.web.tiles import MapTiles
from m100link.errors import GuardRefused, UsageError
from m100link.protocol.records import Position

if TYPE_CHECKING:
    from m100link.sim.orders import SimulatorOrders

# -- the texts of a page, also when its language changes -------------------------------------------


class Wording:
    """Says texts, and says those again that stand on the page when another language is chosen."""

    def __init__(self) -> None:
        self.settings = DisplaySettings()  # what the operator chose
        self.utc_offset_min = 0  # minutes that the operator's clock is ahead of UTC
        self._followers: list[Callable[[], object]] = []

    def __call__(self, text: Text) -> str:
        return self.settings.speaker(text)

    def put(self, show: Callable[[str], object], key: str, **values: object) -> None:
        """Let a text stand on the page, now and after every change of the settings."""
        text = tr(key, **values)
        self.follow(lambda: show(self(text)))

    def label(self, key: str, **values: object) -> ui.label:
        label = ui.label()
        self.put(label.set_text, key, **values)
        return label

    def button(
        self,
        key: str,  # of what stands on it
        props: str,
        work: Callable[..., object] | None = None,  # what a click does; None where the page does it
        *,
        looks: str = "act plain",  # its classes
        **values: object,  # what is filled into the text
    ) -> ui.element:
        """A button in the present element that gives the aircraft no order."""
        with ui.element("button").classes(looks).props(f"type=button {props}") as made:
            self.label(key, **values)
        if work is not None:
            made.on("click", work, args=[])
        return made

    def tool(self, key: str, icon: str, props: str) -> ui.element:
        """A button with an icon, whose name is read aloud and shown by a mouse that rests on it."""
        with ui.element("button").props(f"type=button {props}") as made:
            ui.icon(icon).props("aria-hidden=true")
        for name in ("title", "aria-label"):
            self.put(attribute(made, name), key)
        return made

    def card(self, key: str) -> ui.element:
        """A box with a title; to be used as ``with``."""
        box = ui.element("section").classes("card w-full")
        with box, ui.element("h2"):
            self.label(key)
        self.put(attribute(box), key)
        return box

    def field(self, name: str, key: str) -> tuple[ui.element, ui.label, ui.label]:
        """A name and its value: the row, the value, the note below it."""
        with ui.element("div").classes("field") as row:
            self.label(key).classes("name")
            with ui.element("div"):
                value = ui.label("–").classes("value").props(f"data-field={name}")
                note = ui.label("").classes("note")
        return row, value, note

    def options(self, select: Any, keys: Mapping[Any, str]) -> None:
        """Let the options of a select be said in the operator's language."""
        self.follow(
            lambda: select.set_options({value: self(Text(key)) for value, key in keys.items()})
        )

    def follow(self, show: Callable[[], object]) -> None:
        """Call this now and after every change of the settings."""
        self._followers.append(show)
        show()

    def choose(self, settings: DisplaySettings) -> None:
        self.settings = settings
        for show in self._followers:
            show()


def attribute(element: ui.element, name: str = "aria-label") -> Callable[[str], None]:
    """A setter for an attribute of an element, where a text is not its content."""

    def show(text: str) -> None:
        if element.props.get(name) != text:
            element.props[name] = text
            element.update()

    return show


# -- buttons that give orders ----------------------------------------------------------------------

_STAYS = CAMERA | {"obtain", "mission_upload"}
"""Orders beside which everything that flies goes on."""

_ENDS = frozenset({"stop", "pause", "release", "mission_stop"})
"""Orders that end a motion: the page gives them however late they come."""


ORDER = "(event) => emit(window.m100?.order(event) ?? {})"
"""JavaScript that sends a press, with its number for :func:`answer`."""

_STOP = "(event) => emit({press: event.detail})"


_NOT_TAKEN = {
    "shifted": GuardRefused(
        "the page shifted during the press; nothing was done",
        guard="page_shifted",
        cause="another button had just been where the finger came down",
        remedy="check which button is under the finger, then hold it again",
    ),
    "withdrawn": GuardRefused(
        "the order was withdrawn while its button was held; nothing was done",
        guard="not_offered",
        cause="the checklist, the task or the operator changed in that second",
        remedy="read the page, then hold it again",
    ),
    "unsure": GuardRefused(
        "the page stood still while the button was held; nothing was done",
        guard="order_late",
        cause="the browser was busy, so it is unknown whether you held the button",
        remedy="look at the aircraft, then hold it again",
    ),
}
"""The errors of a hold that gives no order, by its event in the browser."""


def answer(event: GenericEventArguments) -> dict[str, Any]:
    """Tell the page that its press has come; returns what it said of it."""
    said = event.args if isinstance(event.args, dict) else {}
    press = said.get("press")
    if type(press) is int:
        ui.run_javascript(f"m100.answered({press})")
    return said


class Buttons:
    """The buttons of a page, by the names of the orders that they give."""

    def __init__(self, agent: AgentClient, tab: Tab, wording: Wording) -> None:
        self._agent, self._tab, self._wording = agent, tab, wording
        self._buttons: dict[str, list[tuple[Any, bool]]] = {}

    def add(
        self,
        name: str,  # of the order, as in ``view.actions``, which says whether it has to be held
        key: str,  # of what stands on it
        work: Callable[..., Awaitable[Any]],
        *,
        kind: str = "",  # ``"stop"`` or ``"plain"``, else a usual one
        check: Callable[[object], None] | None = None,
    ) -> Any:
        """A button in the present element; several may give the same order."""
        made = self._wording.button(key, f"data-act={name}", looks=f"act {kind}")
        is_held = name in HELD
        if is_held:
            made.classes("hold")
            for what in _NOT_TAKEN:
                made.on(what, partial(self._refuse, what), js_handler=ORDER)

        async def pressed(event: GenericEventArguments) -> None:
            said = answer(event)

            async def order() -> None:
                if name not in _ENDS:
                    self._tab.check_order(said.get("at"))
                if check is not None:
                    check(said.get("shown"))
                await (work(said.get("press")) if name == "stop" else work())

            self.ask(name, order)
            await asyncio.sleep(0)

        # A tap with a second finger makes no click: STOP has an event that the page makes of it.
        made.on(
            {"stop": "stopped"}.get(name, "held" if is_held else "click"),
            pressed,
            js_handler=_STOP if name == "stop" else ORDER,
        )
        self._buttons.setdefault(name, []).append((made, True))
        return made

    def ask(self, name: str, work: Callable[[], Awaitable[Any]]) -> None:
        """Give an order in the background: the page goes on while the aircraft flies."""
        attempt = self._tab.attempt(work, replaces=name not in _STAYS)
        self._agent.background.spawn(attempt, f"{name} of {self._tab.session.name}")

    def _refuse(self, what: str, event: GenericEventArguments) -> None:
        """A hold that gives no order: answered as one, or a lost connection would hide its end."""
        answer(event)
        self._tab.refusal = _NOT_TAKEN[what]

    def update(self, offered: Set[str]) -> None:
        for name, buttons in self._buttons.items():
            is_on = name in offered
            for number, (button, was_on) in enumerate(buttons):
                if was_on is not is_on:
                    buttons[number] = (button, is_on)
                    button.props(remove="disabled") if is_on else button.props("disabled")


# -- names with values -----------------------------------------------------------------------------

_DIGITS = 2  # of what was converted


class ReadingRow:
    """A row that shows a reading, struck through while it is stale."""

    def __init__(self, name: str, wording: Wording) -> None:
        self._wording = wording
        self._row, self._value, self._note = wording.field(name, f"instruments.{name}")
        self._is_stale = False

    def show(self, reading: FieldReading) -> None:
        self._value.set_text(self._wording(reading.text))
        self._note.set_text("" if reading.note is None else self._wording(reading.note))
        if reading.is_stale is not self._is_stale:
            self._is_stale = reading.is_stale
            self._row.classes(add="stale") if self._is_stale else self._row.classes(remove="stale")


class NumberField:
    """A number that is typed in the operator's unit; who asks gets it in that of the protocol."""

    def __init__(
        self,
        wording: Wording,  # says what it is called, and knows the units
        key: str,  # of its name in the catalogue, with ``{unit}`` in it where there is a kind
        props: str,
        *,
        kind: QuantityKind | None = None,  # what it measures; None where nobody chooses the unit
        # Least and greatest value that is offered, in the unit of the protocol.
        limits: tuple[float | None, float | None] = (None, None),
        step: float = 1.0,  # of its arrows, in the operator's unit
        value: float | None = None,  # at the beginning, in the unit of the protocol
        # Called with each value that somebody typed; None for none.
        changed: Callable[[float | None], None] | None = None,
    ) -> None:
        self._wording, self.kind, self._limits = wording, kind, limits
        self._value, self._changed = value, changed
        # The number on the page, in the operator's unit.
        self.element = ui.number(step=step).props(f"dense outlined {props}")
        self.element.on_value_change(self._typed)
        unit = {} if kind is None else {"unit": kind}
        wording.put(attribute(self.element, "label"), key, **unit)
        wording.follow(self._show)

    @property
    def value(self) -> float | None:
        """The number in the field, in the unit of the protocol; None for no number."""
        return self._value

    @property
    def shown_limits(self) -> tuple[float | None, float | None]:
        low, high = self._limits
        return self._to_shown(low), self._to_shown(high)

    def set(self, value: float | None) -> None:
        if value != self._value:
            self._value = value
            self._show()

    def _to_shown(self, value: float | None) -> float | None:
        if value is None or self.kind is None:
            return value
        return round(self._wording.settings.units.convert(value, self.kind), _DIGITS)

    def _show(self) -> None:
        self._is_showing = True  # what is set now was not typed
        low, high = self.shown_limits
        if low is not None:
            self.element.min = low
        if high is not None:
            self.element.max = high
        self.element.set_value(self._to_shown(self._value))
        self._is_showing = False

    def _typed(self, event: events.ValueChangeEventArguments[Any]) -> None:
        if self._is_showing:
            return
        value = event.value if isinstance(event.value, int | float) else None
        if value is not None and self.kind is not None:
            value = self._wording.settings.units.to_si(value, self.kind)
        self._value = value
        if self._changed is not None:
            self._changed(value)


# -- components ------------------------------------------------------------------------------------
# A component is a class of this folder, in the file of its topic, named in ``console/page.py``
# under the view that shows it (or in ``PreparedPart``, where one of several is shown):
#
#     class Clock:
#         def __init__(self, page: PageContext) -> None:
#             self._text = ui.label("–").props("id=clock")
#
#         def update(self, view: ViewModel) -> None:
#             self._text.set_text(f"{view.at:.0f} s")
#
# - The page makes it inside the element that holds it, where it lays itself out, in a turn of the
#   loop of its own: for the views other than Fly when an operator first looks at that view.
# - It calls ``update`` four times a second with one view model for the whole page, only while that
#   view is looked at. Setting a text that stands there already costs nothing: just set.
# - A rule about what is shown belongs to ``console/view/``: a test reads it without a browser.
# - A button that gives an order comes from ``page.buttons``: it is kept grey unless
#   ``view/fly.py`` offers it, and has to be held for a second where that says so.
# - Words stand in ``console/texts/``: ``page.wording.label(key)`` for what stands there always,
#   ``page.wording(text)`` for a text of the view model.
# - Code for the browser is a module in ``static/``, loaded by ``page.load``; it imports
#   ``m100`` from ``./shell.js`` (``m100.onLive``, ``m100.onMap``, ``m100.socket``).


class Component(Protocol):
    """A component of the page, laid out inside the element in which it was made."""

    def update(self, view: ViewModel) -> None:
        """Show what is."""


@dataclass(frozen=True, slots=True)
class PageContext:
    """The things that all components of a page share: one for each page."""

    agent: AgentClient  # the agent that owns the aircraft
    tab: Tab  # who looks at the page
    orders: SimulatorOrders | None  # what the panel does to a virtual aircraft, or None
    buttons: Buttons  # the buttons that give orders
    memory: Memory  # its alarms, its checklist, its events
    wording: Wording  # says everything in the operator's language and units
    dark: ui.dark_mode  # switches the dark looks of NiceGUI's own elements
    show: Callable[[str], Awaitable[None]]  # shows another view of the page, by its name
    tiles: MapTiles  # the pictures below the map, under ``/tiles/{zoom}/{column}/{row}``
    history_of: Callable[[str], PlotHistory]  # what was flown, by the name of an aircraft
    tabs: Tabs  # who looks at this and at other aircraft
    video: Video | None = None  # that is shown beside the map

    @property
    def history(self) -> PlotHistory:
        return self.history_of(self.tab.aircraft)

    def seek(self, utc: float) -> None:
        """Move the replay to a time of its flight, POSIX time in s."""
        replay = self.agent.state.replay
        if replay is not None:
            place = replay.position_s + utc - replay.utc
            work = self.agent.ask(OrderReplay(f"seek {place:.2f}"))
            self.agent.background.spawn(self.tab.attempt(lambda: work), "seek")

    async def take_off(self) -> None:
        """Take off to the chosen height; an event has why, if the checklist is not green.

        Raises ``UsageError``: it does not, or the limits end below that height. Raises
        ``M100Error``: what the agent tells.
        """
        checklist = self.memory.checklist.look(self.memory.situation)
        if not checklist.may_take_off:
            raise UsageError(
                "take-off is not offered: the checklist is not green",
                remedy="fix what it shows, or write there why you take off anyway",
            )
        height, most = self.memory.checklist.height, self.agent.state.limits.max_height_m
        if most is not None and height > most:
            raise UsageError(
                f"take-off to {height:g} m: the limit is {most:g} m", remedy="choose a lower height"
            )
        if not checklist.is_green:
            english = Translator()
            missing = ", ".join(
                english(Text(f"checklist.{check.item.value}")) for check in checklist.missing
            )
            said = tr(
                "checklist.event.although",
                name=self.tab.session.name,
                missing=missing,
                reason=checklist.reason,
            )
            self.agent.note(english(said), "warning")
        PRESSED_AT.set(self.agent.asked_at)  # a STOP since then ends the climb, too
        await self.tab.ask(TakeOff())
        if height > TAKE_OFF_HEIGHT:
            await self.tab.ask(ChangeHeight(height))

    def here(self) -> tuple[float, float] | None:
        """Where the aircraft is: latitude and longitude, °; None when nobody knows."""
        position = self.agent.view.get(Position)
        return None if position is None else (position.latitude_deg, position.longitude_deg)

    def home(self) -> tuple[float, float] | None:
        """The take-off point: where it stands, else where it took off, else where it is."""
        flown = None if self.memory.situation.is_on_ground else self.history.path.home(time.time())
        place = self.here() if flown is None else (flown.latitude_deg, flown.longitude_deg)
        # To about a metre: an estimate is no more exact, and a fix is never at rest.
        return None if place is None else (round(place[0], 5), round(place[1], 5))

    def load(self, module: str) -> None:
        """Load ``static/<module>`` into this page, also after it was built."""
        ui.run_javascript(f'import("/console/{module}")')
