"""The mission on the console: its plan, how far it is, and four buttons."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from typing import Any

from nicegui import events, ui

from m100link.agent.client import AgentClient
from m100link.agent.messages import Action
from m100link.missions.plan import WaypointPlan
from m100link.station.console.tab import Tab

__all__ = ["MissionCard"]

_MAX_PLAN = 1_000_000

AddButton = Callable[[str, str, Callable[[], Awaitable[Any]]], None]


class MissionCard:
    """A card of the page.

    Args:
        agent: The agent that owns the aircraft.
        tab: Who looks at it.
    """

    def __init__(self, agent: AgentClient, tab: Tab) -> None:
        self._agent, self._tab = agent, tab

    def build(self, button: AddButton) -> None:
        """Lay it out; ``button`` adds one that works like those of the page."""
        tab = self._tab
        upload = ui.upload(
            label="plan: JSON or QGroundControl .plan",
            auto_upload=True,
            max_files=1,
            max_file_size=_MAX_PLAN,
            on_upload=self._uploaded,
        )
        upload.props("flat dense accept=.json,.plan id=plan-file").classes("w-full")
        self._plan = ui.label("no plan").props("id=plan")
        with ui.row().classes("gap-2"):
            button("mission_start", "Start (hold)", lambda: tab.order_mission(Action.MISSION_START))
            button("mission_pause", "Pause", lambda: tab.order_mission(Action.MISSION_PAUSE))
            button("mission_resume", "Resume", lambda: tab.order_mission(Action.MISSION_RESUME))
            button("mission_stop", "Stop", lambda: tab.order_mission(Action.MISSION_STOP))
        self._progress = ui.linear_progress(0.0, show_value=False).props("id=mission-progress")
        self._state = ui.label("").props("id=mission")

    async def _uploaded(self, event: events.UploadEventArguments) -> None:
        content = await event.file.read()
        await self._tab.attempt(lambda: self._tab.upload_plan(content))

    def update(self) -> None:
        """Show what is."""
        plan, state = self._tab.plan, self._agent.state
        self._plan.set_text(summary(plan))
        text, part = progress(plan, state.mission, state.mission_index)
        self._state.set_text(text)
        self._progress.set_value(part)


def summary(plan: WaypointPlan | None) -> str:
    """A plan in one line."""
    if plan is None:
        return "no plan"
    lowest, highest = plan.heights
    return (
        f"{len(plan.waypoints)} waypoints, {plan.length_m:.0f} m at {plan.speed:g} m/s, "
        f"height {lowest:.0f} to {highest:.0f} m"
    )


def progress(plan: WaypointPlan | None, mission: str, index: int) -> tuple[str, float]:
    """What flies, in words and as a part of 1."""
    if mission in ("", "no mission"):
        return mission or "nothing is known of missions", 0.0
    if index < 0:
        return mission, 0.0
    if plan is None or index >= len(plan.waypoints):
        return f"{mission}: to waypoint {index + 1}", 0.0
    count = len(plan.waypoints)
    return f"{mission}: to waypoint {index + 1} of {count}", index / count
