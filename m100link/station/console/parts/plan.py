"""The Plan view: the mission, its plan, how far it is, and four buttons."""

from __future__ import annotations

from functools import partial

from nicegui import events, ui

from m100link.agent.messages import Action
from m100link.station.console.parts.fields import card
from m100link.station.console.parts.part import Deck
from m100link.station.console.view.view import View

__all__ = ["PlanPart"]

_MAX_PLAN = 1_000_000


class PlanPart:
    """A card over the map, which shows the route.

    Args:
        deck: What it stands on.
    """

    def __init__(self, deck: Deck) -> None:
        self._deck = deck

    def build(self) -> None:
        """Lay it out."""
        tab, add = self._deck.tab, self._deck.buttons.add
        with card("Mission"):
            upload = ui.upload(
                label="plan: JSON or QGroundControl .plan",
                auto_upload=True,
                max_files=1,
                max_file_size=_MAX_PLAN,
                on_upload=self._uploaded,
            )
            upload.props("flat dense accept=.json,.plan id=plan-file").classes("w-full")
            self._plan = ui.label("no plan").props("id=plan")
            with ui.element("div").classes("acts"):
                for name, label, action in (
                    ("mission_start", "Start (hold)", Action.MISSION_START),
                    ("mission_pause", "Pause", Action.MISSION_PAUSE),
                    ("mission_resume", "Resume", Action.MISSION_RESUME),
                    ("mission_stop", "Stop", Action.MISSION_STOP),
                ):
                    is_start = action is Action.MISSION_START
                    add(name, label, partial(tab.order_mission, action), hold=is_start)
            self._progress = ui.linear_progress(0.0, show_value=False).props(
                'id=mission-progress aria-label="how far the mission is"'
            )
            self._state = ui.label("").props("id=mission")

    async def _uploaded(self, event: events.UploadEventArguments) -> None:
        content = await event.file.read()
        await self._deck.tab.attempt(lambda: self._deck.tab.upload_plan(content))

    def update(self, view: View) -> None:
        """Show what is."""
        self._plan.set_text(view.mission.plan)
        self._state.set_text(view.mission.state)
        self._progress.set_value(view.mission.part)
