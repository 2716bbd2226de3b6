"""What is wrong, for /diagnostics: line, clock, place, control, battery, and the node itself."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import IntEnum
from typing import Any

from m100link.apps.agent.client import AgentClient
from m100link.protocol.records import Battery
from m100link.telemetry.device_clock import DeviceClock

__all__ = ["Level", "Status", "diagnostics"]

_LOW_PERCENT = 30
_BOUND_S = 0.05
_OLD_S = 5.0


class Level(IntEnum):
    """As diagnostic_msgs/msg/DiagnosticStatus numbers them."""

    OK = 0
    WARN = 1
    ERROR = 2
    STALE = 3


@dataclass(frozen=True, slots=True)
class Status:
    """How one thing is.

    Attributes:
        name: What.
        level: How bad.
        message: In a few words.
        values: Numbers, by name.
    """

    name: str
    level: Level
    message: str
    values: Mapping[str, object] = field(default_factory=dict)

    def told(self, node: str) -> dict[str, Any]:
        """As diagnostic_msgs/msg/DiagnosticStatus."""
        return {
            "level": self.level,
            "name": f"{node}: {self.name}",
            "message": self.message,
            "hardware_id": "DJI Matrice 100",
            "values": [{"key": key, "value": str(one)} for key, one in self.values.items()],
        }


def diagnostics(
    agent: AgentClient, clock: DeviceClock | None, counted: Mapping[str, int]
) -> list[Status]:
    """How everything is.

    Args:
        agent: What is known of the aircraft.
        clock: Its clock; None before its first tick.
        counted: What the node did not do, by the reason.
    """
    return [
        _line(agent),
        _clock(clock),
        _navigation(agent),
        _control(agent),
        _battery(agent),
        _node(counted),
    ]


def _line(agent: AgentClient) -> Status:
    state = agent.state
    values = {
        "firmware": state.firmware,
        "round trip ms": "" if state.round_trip is None else round(1000 * state.round_trip, 2),
        "damaged frames": state.discards,
        "late acks": state.late_acks,
        "dropped writes": state.dropped_writes,
        "packages that do not fit": state.mismatches,
    }
    if not agent.is_connected:
        message = "the agent is silent" if agent.is_silent else state.connection
        return Status("line", Level.ERROR, message, values)
    age = None if agent.telemetry is None else agent.telemetry.newest_age
    if age is None or age > _OLD_S:
        return Status("line", Level.STALE, "no telemetry", values)
    return Status("line", Level.OK, "connected", values)


def _clock(clock: DeviceClock | None) -> Status:
    if clock is None:
        return Status("clock", Level.STALE, "no tick of the aircraft yet")
    bound = clock.uncertainty_s
    values = {
        "bound of stamps ms": round(1000 * bound, 2) if math.isfinite(bound) else "unknown",
        "skew ppm": round(clock.skew_ppm, 2),
        "jumps": clock.resets,
    }
    if not bound <= _BOUND_S:
        return Status("clock", Level.WARN, "stamps are uncertain", values)
    return Status("clock", Level.OK, "stamps are by the clock of the aircraft", values)


def _navigation(agent: AgentClient) -> Status:
    """Whether what comes can be true; on the ground there is nothing to judge."""
    if agent.telemetry is None:
        return Status("navigation", Level.STALE, "unknown")
    found = agent.telemetry.integrity
    values = {
        "position test ratio": round(found.test_ratio, 2),
        "height test ratio": round(found.height_test_ratio, 2),
        "delay ms": round(1000 * found.delay_s, 1),
    }
    if found.is_plausible and found.is_timely:
        return Status("navigation", Level.OK, found.state.name.lower(), values)
    return Status("navigation", Level.ERROR, found.seen, values)


def _control(agent: AgentClient) -> Status:
    values = {"lease": agent.holder.name, "task": agent.state.task}
    held = "programs have control" if agent.has_authority else "the pilot flies"
    return Status("control", Level.OK, held, values)


def _battery(agent: AgentClient) -> Status:
    telemetry = agent.telemetry
    battery = None if telemetry is None else telemetry.fresh(Battery, within=_OLD_S)
    if battery is None or not battery.is_possible:
        return Status("battery", Level.STALE, "unknown")
    values = {"percent": battery.percent}
    if battery.percent <= _LOW_PERCENT:
        return Status("battery", Level.WARN, "low", values)
    return Status("battery", Level.OK, "charged", values)


def _node(counted: Mapping[str, int]) -> Status:
    return Status("node", Level.OK, "what was not done since it began", counted)
