"""The simple tasks of DJI's node of 2015: what ``/sdk_request_simple_task`` flies.

======  ==========================================================================================
Number  What it does
======  ==========================================================================================
0       legs of 5 s in angle mode: right, left, back, forward, up, down, clockwise, anticlockwise
1       the same legs in velocity mode, starting north
2       take-off, landing, take-off, go-home, over and over
3       random commands: refused here
4       take-off, 28 s of task 0, 40 s of task 1, go-home
5       one activation
6       one version query
======  ==========================================================================================
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable

from m100link.apps.agent.flying import Pattern
from m100link.apps.agent.steering import ANGLE_MODE, VELOCITY_MODE, setpoint_of
from m100link.errors import UsageError
from m100link.flight.control import Control
from m100link.protocol.setpoint import Setpoint

__all__ = ["LEG_TIME", "pattern"]

LEG_TIME = 5.0
"""Seconds of each leg: 250 ticks of the node's 50 Hz timer."""

Send = Callable[[Setpoint], None]


def _legs(mode: int) -> list[Setpoint]:
    """Eight legs in DJI's order; first and second value, climb rate, yaw rate."""
    reach = 2.0 if mode == ANGLE_MODE else 0.5
    moves = [
        (reach, 0.0, 0.0, 0.0),
        (-reach, 0.0, 0.0, 0.0),
        (0.0, reach, 0.0, 0.0),
        (0.0, -reach, 0.0, 0.0),
        (0.0, 0.0, 0.5, 0.0),
        (0.0, 0.0, -0.5, 0.0),
        (0.0, 0.0, 0.0, 90.0),
        (0.0, 0.0, 0.0, -90.0),
    ]
    return [setpoint_of(mode, y, x, yaw, up) for x, y, up, yaw in moves]


async def _fly_legs(control: Control, send: Send, mode: int, seconds: float) -> None:
    legs = _legs(mode)
    async for tick in control.ticks():
        if tick.elapsed >= seconds:
            return
        send(legs[int(tick.elapsed / LEG_TIME) % len(legs)])


async def _legs_for_ever(control: Control, send: Send, mode: int) -> None:
    await _fly_legs(control, send, mode, float("inf"))


async def _commands(control: Control, send: Send) -> None:
    while True:
        await control.take_off()
        await control.land()
        await control.take_off()
        await control.go_home()


async def _everything(control: Control, send: Send) -> None:
    await control.take_off()
    await _fly_legs(control, send, ANGLE_MODE, 28.0)
    await _fly_legs(control, send, VELOCITY_MODE, 40.0)
    await asyncio.sleep(0.5)  # neutral goes out before the autopilot takes over
    await control.go_home()


def pattern(number: int) -> Pattern:
    """The program behind a number.

    Raises:
        UsageError: There is none, or it is not flown here.
    """
    if number == 3:
        raise UsageError(
            "task 3 sends random commands every 20 ms, take-off and landing among them",
            cause="it was made to test a protocol, not to fly",
            remedy="use a test rig; see the virtual aircraft's line faults",
        )
    programs: dict[int, Pattern] = {
        0: lambda control, send: _legs_for_ever(control, send, ANGLE_MODE),
        1: lambda control, send: _legs_for_ever(control, send, VELOCITY_MODE),
        2: _commands,
        4: _everything,
    }
    if number not in programs:
        raise UsageError(f"there is no simple task {number}", remedy="tasks are 0 to 6")
    return programs[number]
