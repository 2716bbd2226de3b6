"""Buttons that give orders."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Set
from functools import partial
from typing import Any

from nicegui import ui
from nicegui.events import GenericEventArguments

from m100link.apps.agent.client import AgentClient
from m100link.apps.station.console.parts.wording import Wording
from m100link.apps.station.console.tab import Tab
from m100link.apps.station.console.view.actions import HELD
from m100link.apps.station.console.view.catalogue import CATALOGUE
from m100link.errors import GuardRefused

__all__ = ["ORDER", "Buttons", "answer"]

_ENDS = frozenset({"stop", "release", "mission_pause", "mission_stop"})
"""What ends a motion is done however late it comes."""


ORDER = "(event) => emit(window.m100?.order(event) ?? {})"
"""What the page sends of a press, with the number of it that is to be answered."""

_STOP = "(event) => emit({press: event.detail})"


async def _stood_still() -> None:
    raise GuardRefused(
        "the page stood still while the button was held; nothing was done",
        guard="order_late",
        cause="nobody knows whether it was held: the browser was busy with something else",
        remedy="look at the aircraft, then hold it again",
    )


async def _withdrawn() -> None:
    raise GuardRefused(
        "the order was withdrawn while its button was held; nothing was done",
        guard="not_offered",
        cause="the checklist, the task or who has control changed in that second",
        remedy="see what the page says, then hold it again",
    )


async def _shifted() -> None:
    raise GuardRefused(
        "the page shifted as the button was pressed; nothing was done",
        guard="page_shifted",
        cause="where the finger came down, another button had been just before",
        remedy="see which button is under the finger, then hold it again",
    )


_NOT_TAKEN = {"shifted": _shifted, "withdrawn": _withdrawn, "unsure": _stood_still}
"""What the page makes of a hold that gives no order."""


def answer(event: GenericEventArguments) -> dict[str, Any]:
    """Tell the page that its press has come; returns what it said of it."""
    said = event.args if isinstance(event.args, dict) else {}
    press = said.get("press")
    if type(press) is int:
        ui.run_javascript(f"m100.answered({press})")
    return said


class Buttons:
    """The buttons of a page, by the names of the orders that they give.

    Args:
        agent: The agent that owns the aircraft.
        tab: Who presses them.
        wording: Says what stands on them.
    """

    def __init__(self, agent: AgentClient, tab: Tab, wording: Wording) -> None:
        self._agent, self._tab, self._wording = agent, tab, wording
        self._buttons: dict[str, list[tuple[Any, bool]]] = {}
        self._enabled: dict[Any, bool] = {}

    def add(
        self,
        name: str,
        label: str,
        work: Callable[..., Awaitable[Any]],
        *,
        kind: str = "",
        check: Callable[[object], None] | None = None,
    ) -> Any:
        """A button in the present element; several may give the same order.

        Args:
            name: Of the order, as in ``view.actions``, which says whether it has to be held.
            label: What stands on it, or the key of that in the catalogue.
            work: What is done; what goes wrong is the tab's problem. STOP is given the number of
                its press.
            kind: ``"stop"`` or ``"plain"``, else a usual one.
            check: Called first, with what ``data-shown`` of the button was when the press began;
                raises what refuses it.
        """
        button = ui.element("button").classes(f"act {kind}").props(f"type=button data-act={name}")
        with button:
            text = ui.label(label)
        if label in CATALOGUE:
            self._wording.put(text.set_text, label)
        is_held = name in HELD
        if is_held:
            button.classes("hold")
            for what, refuse in _NOT_TAKEN.items():
                button.on(what, partial(self._refuse, refuse), js_handler=ORDER)

        async def pressed(event: GenericEventArguments) -> None:
            said = answer(event)

            async def order() -> None:
                if name not in _ENDS:
                    self._tab.check_order(said.get("at"))
                if check is not None:
                    check(said.get("shown"))
                await (work(said.get("press")) if name == "stop" else work())

            # The page goes on while the aircraft flies.
            self._agent.background.spawn(self._tab.attempt(order), f"{name} of {self._tab.name}")
            await asyncio.sleep(0)

        # A tap with a second finger makes no click: STOP is told by what the page makes of it.
        button.on(
            {"stop": "stopped"}.get(name, "held" if is_held else "click"),
            pressed,
            js_handler=_STOP if name == "stop" else ORDER,
        )
        self._buttons.setdefault(name, []).append((button, True))
        return button

    async def _refuse(
        self, why: Callable[[], Awaitable[None]], event: GenericEventArguments
    ) -> None:
        """A hold that gives no order: answered as one, or a lost connection would hide its end."""
        answer(event)
        await self._tab.attempt(why)

    def update(self, offered: Set[str]) -> None:
        """Let those be pressed whose order is offered."""
        for name, buttons in self._buttons.items():
            is_on = name in offered
            for number, (button, was_on) in enumerate(buttons):
                if was_on is not is_on:
                    buttons[number] = (button, is_on)
                    button.props(remove="disabled") if is_on else button.props("disabled")
