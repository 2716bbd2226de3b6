"""The question whether to take control from somebody."""

from __future__ import annotations

from nicegui import ui
from nicegui.events import GenericEventArguments

from m100link.apps.agent.lease import LeaseHeld
from m100link.apps.station.console.parts.buttons import ORDER, answer
from m100link.apps.station.console.parts.wording import Wording
from m100link.apps.station.console.tab import Tab
from m100link.apps.station.console.view.words import Text, say
from m100link.errors import M100Error

__all__ = ["TakeOverDialog"]


class TakeOverDialog:
    """Obtains control, and asks when somebody has it.

    Args:
        tab: Who wants control.
        wording: Asks in the operator's language.
    """

    def __init__(self, tab: Tab, wording: Wording) -> None:
        self._tab, self._wording = tab, wording
        # The order runs in the background, where no element can be made.
        self._is_wanted = False

    async def obtain(self) -> None:
        """Obtain control; if somebody has it, ask with the next update."""
        try:
            await self._tab.obtain()
        except LeaseHeld:
            self._is_wanted = True

    def update(self) -> None:
        """Ask, if that is wanted."""
        if self._is_wanted:
            self._is_wanted = False
            ui.timer(0.0, self._ask, once=True)

    async def _ask(self) -> None:
        try:
            wanted = await self._tab.ask_take_over()
        except M100Error:
            return  # it is free by now
        with ui.dialog() as dialog, ui.card():
            asked = self._wording(say("page.take_over", name=wanted.from_name))
            ui.label(asked).props("id=take-over")
            ui.label(self._wording(say("page.take_over.effect")))
            with ui.row():

                async def confirm(event: GenericEventArguments) -> None:
                    said = answer(event)
                    dialog.close()

                    async def order() -> None:
                        self._tab.check_order(said.get("at"))
                        await self._tab.confirm_take_over(wanted)

                    await self._tab.attempt(order)

                for name, kind in (("confirm", "danger"), ("leave", "plain")):
                    with ui.element("button").classes(f"act {kind}") as button:
                        ui.label(self._wording(Text(f"page.take_over.{name}")))
                    button.props(f"type=button id={name}")
                    if name == "confirm":
                        button.on("click", confirm, js_handler=ORDER)
                    else:
                        button.on("click", dialog.close, args=[])
        dialog.open()
