"""The bar of a replay: above every view, in the place of what one flies with."""

from __future__ import annotations

from functools import partial

from nicegui import events, ui

from m100link.apps.agent.messages import Action
from m100link.apps.station.console.parts.part import Deck
from m100link.apps.station.console.parts.wording import attribute
from m100link.apps.station.console.view.replay import SPEEDS, ReplayView
from m100link.apps.station.console.view.view import View
from m100link.apps.station.console.view.words import Text

__all__ = ["ReplayPart"]

_STEP = 0.1  # of the place, s


class ReplayPart:
    """Says that it is a replay, and moves it. It is not there for an aircraft.

    Args:
        deck: What it stands on.
    """

    def __init__(self, deck: Deck) -> None:
        self._deck = deck
        self._is_showing = False  # what is set then was not chosen
        self._is_held = False  # a finger moves the place
        self._duration_s = -1.0
        self._is_marked = False  # the page: what one flies with is hidden

    def build(self) -> None:
        """Lay it out."""
        put = self._deck.wording.put
        with ui.element("section").props("id=replay") as self._bar:
            put(attribute(self._bar), "replay.bar")
            with ui.element("div").classes("said"):
                self._title = ui.label().classes("title").props("id=replay-title")
                put(ui.label().classes("nothing").set_text, "replay.nothing")
                self._place = ui.label().props("id=replay-place")
                self._note = ui.label().props("id=replay-note")
            with ui.element("div").classes("moves"):
                self._button("back", "replay.back", "by -10")
                self._toggle = self._button("toggle", "replay.pause", "toggle")
                self._button("on", "replay.on", "by 10")
                self._slider = ui.slider(min=0.0, max=1.0, step=_STEP, value=0.0)
                self._slider.props("id=replay-slider")
                put(attribute(self._slider), "replay.place")
                self._slider.on("pan", self._held)
                self._slider.on("change", self._moved)
                choices = {speed: f"{speed:g} ×" for speed in SPEEDS}
                self._speed = ui.select(choices, value=1.0).props("dense outlined for=replay-speed")
                put(attribute(self._speed, "label"), "replay.speed")
                self._speed.on_value_change(self._sped)
        self._bar.set_visibility(False)

    def _button(self, name: str, key: str, order: str) -> ui.label:
        button = ui.element("button").classes("act plain")
        button.props(f"type=button data-replay={name}")
        with button:
            text = ui.label()
        self._deck.wording.put(text.set_text, key)
        button.on("click", partial(self._order, order), args=[])
        return text

    def _order(self, text: str) -> None:
        agent, tab = self._deck.agent, self._deck.tab

        async def order() -> None:
            await agent.ask(Action.REPLAY, data=text.encode())

        agent.background.spawn(tab.attempt(order), f"{text} of {tab.name}")

    def _held(self, event: events.GenericEventArguments) -> None:
        self._is_held = event.args == "start"

    def _moved(self) -> None:
        self._is_held = False
        self._order(f"seek {float(self._slider.value or 0.0):.1f}")

    def _sped(self, event: events.ValueChangeEventArguments[float]) -> None:
        if not self._is_showing and event.value is not None:
            self._order(f"speed {event.value:g}")

    def update(self, view: View) -> None:
        """Show what is."""
        shown = view.replay
        self._bar.set_visibility(shown is not None)
        if shown is not None:
            self._is_showing = True
            self._show(shown)
            self._is_showing = False

    def _show(self, shown: ReplayView) -> None:
        say = self._deck.wording
        if not self._is_marked:
            self._is_marked = True
            ui.run_javascript('document.body.dataset.replay = "yes"')
        self._title.set_text(say(shown.title))
        self._place.set_text(say(shown.place))
        self._note.set_text("" if shown.note is None else say(shown.note))
        self._toggle.set_text(say(Text("replay.pause" if shown.is_running else "replay.resume")))
        if shown.duration_s != self._duration_s:
            self._duration_s = shown.duration_s
            self._slider.props(f"max={max(_STEP, shown.duration_s):.1f}")
        if not self._is_held:
            self._slider.set_value(round(shown.position_s, 1))
        if shown.speed in SPEEDS:
            self._speed.set_value(shown.speed)
