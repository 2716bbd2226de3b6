"""Which buttons can be pressed: the others are grey. The agent decides again when one is."""

from __future__ import annotations

from m100link.apps.station.console.view.checklist import Checklist
from m100link.apps.station.console.view.inputs import Inputs
from m100link.apps.station.console.view.situation import Situation

__all__ = ["ACTIONS", "FROM_GROUND", "actions_of"]

FLIGHTS = frozenset({"take_off", "land", "go_home", "simple_task", "mission_start", "guide"})
"""What the aircraft begins to fly by itself."""

MISSIONS = frozenset({"mission_pause", "mission_resume", "mission_stop"})

HELD = FLIGHTS | {"mission_resume"}
"""What has to be held for a second: all that makes the aircraft fly by itself, home and down too.
A click that nobody meant must not; a second costs an aircraft that hovers nothing. What ends a
motion is a single press."""

ACTIONS = FLIGHTS | MISSIONS | {"stop", "activate", "obtain", "release", "mission_upload", "hover"}
"""Every button that is an order."""


FROM_GROUND = frozenset({"take_off", "simple_task", "mission_start"})
"""What leaves the ground when it begins there."""


def actions_of(inputs: Inputs, now: Situation, checklist: Checklist) -> frozenset[str]:
    """The orders that can be given now; STOP always can, where something may fly.

    What leaves the ground is offered by the checklist. Where nobody knows whether the aircraft
    stands, it counts as standing. What flies does not take off.
    """
    if inputs.is_replay:
        return frozenset()  # nothing flies, and nothing would obey
    offered = {"stop"}
    if inputs.is_connected:
        offered.add("activate")
        if not inputs.has_control:
            offered.add("obtain")
    if inputs.has_lease:
        offered |= {"release", "mission_upload"}
    if inputs.state.guided is not None:
        offered.add("hover")  # anybody may
    if inputs.has_control and inputs.flies_mission:
        offered |= MISSIONS
    elif inputs.has_control and not inputs.state.task:
        offered |= FLIGHTS
        if now.is_on_ground is not False and not checklist.may_take_off:
            offered -= FROM_GROUND
        if now.is_on_ground is False:
            offered.discard("take_off")
    return frozenset(offered)
