"""Parameters of the node, by the services of rcl_interfaces: rates to set, guards to read."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

from m100link.apps.agent.client import AgentClient
from m100link.apps.ros2.endpoints import Endpoints
from m100link.apps.ros2.graph import Names
from m100link.apps.ros2.publishers import MessageMaker
from m100link.apps.ros2.topics import OUTPUTS
from m100link.errors import UsageError

MOST_HZ = 100.0  # of a topic; the aircraft says nothing more often
_MOST_NAMES = 64  # of one request, which has to be answered within a step

# Types of rcl_interfaces/msg/ParameterType.
_NOT_SET, _BOOL, _DOUBLE = 0, 1, 3
_FIELDS = {_BOOL: "bool_value", _DOUBLE: "double_value"}
_EMPTY: Mapping[str, Any] = {
    "type": _NOT_SET,
    "bool_value": False,
    "integer_value": 0,
    "double_value": 0.0,
    "string_value": "",
    **{f"{kind}_array_value": [] for kind in ("byte", "bool", "integer", "double", "string")},
}


@dataclass(frozen=True, slots=True)
class Parameter:
    kind: int
    text: str  # what it is
    value: Callable[[], float | bool | None]  # its value now; None where there is none
    # Takes a new value; None for one that cannot be set.
    take: Callable[[float], None] | None = None


class Parameters:
    def __init__(
        self, agent: AgentClient, teller: MessageMaker, ends: Endpoints, names: Names
    ) -> None:
        self._rows: dict[str, Parameter] = {
            "use_sim_time": Parameter(
                _BOOL, "stamps are POSIX time here; /clock is for other nodes", lambda: False
            )
        }
        for name in ("max_height_m", "max_radius_m", "max_speed_m_s", "battery_floor_percent"):
            self._rows[f"guards.{name}"] = Parameter(
                _DOUBLE,
                "a limit of the agent's guards; set where the aircraft is",
                lambda name=name: getattr(agent.state.limits, name),  # type: ignore[misc] # keeps its name
            )
        for topic, row in OUTPUTS.items():
            if row.hz:
                self._add_rate(topic, teller)
        services: dict[str, Callable[[dict[str, Any]], Mapping[str, Any]]] = {
            "list_parameters": self._list,
            "get_parameters": lambda asked: {"values": [*map(self._value, asked["names"])]},
            "get_parameter_types": lambda asked: {
                "types": [self._value(one)["type"] for one in asked["names"]]
            },
            "describe_parameters": lambda asked: {
                "descriptors": [*map(self._described, asked["names"])]
            },
            "set_parameters": lambda asked: {
                "results": [self._set([one]) for one in asked["parameters"]]
            },
            "set_parameters_atomically": lambda asked: {"result": self._set(asked["parameters"])},
        }
        for name, answer in services.items():
            kind = "".join(word.capitalize() for word in name.split("_"))
            ends.serve(names.full(f"~/{name}"), f"rcl_interfaces/srv/{kind}", _at_once(answer))

    def _add_rate(self, topic: str, teller: MessageMaker) -> None:
        take = partial(teller.set_hz, topic)
        word = topic.rpartition("/")[2]
        text = f"most messages per second of {topic}, 0 to {MOST_HZ:g}; 0 for all"
        self._rows[f"rates.{word}"] = Parameter(_DOUBLE, text, lambda: teller.hz[topic], take)

    def _list(self, asked: dict[str, Any]) -> Mapping[str, Any]:
        prefixes = asked["prefixes"]
        names = [
            one
            for one in self._rows
            if not prefixes or any(one == p or one.startswith(f"{p}.") for p in prefixes)
        ]
        found = sorted({one.partition(".")[0] for one in names if "." in one})
        return {"result": {"names": names, "prefixes": found}}

    def _value(self, name: str) -> Mapping[str, Any]:
        row = self._rows.get(name)
        value = None if row is None else row.value()
        if row is None or value is None:
            return _EMPTY
        return {**_EMPTY, "type": row.kind, _FIELDS[row.kind]: value}

    def _described(self, name: str) -> Mapping[str, Any]:
        row = self._rows.get(name)
        is_set = row is not None and row.take is not None
        span = {"from_value": 0.0, "to_value": MOST_HZ, "step": 0.0}
        return {
            "name": name,
            "type": _NOT_SET if row is None else row.kind,
            "description": "" if row is None else row.text,
            "additional_constraints": "",
            "read_only": not is_set,
            "dynamic_typing": False,
            "floating_point_range": [span] if is_set else [],
            "integer_range": [],
        }

    def _set(self, parameters: list[dict[str, Any]]) -> Mapping[str, Any]:
        for one in parameters:
            refusal = self._refusal(one["name"], one["value"])
            if refusal:
                return {"successful": False, "reason": refusal}
        for one in parameters:
            take = self._rows[one["name"]].take
            if take is not None:
                take(one["value"]["double_value"])
        return {"successful": True, "reason": ""}

    def _refusal(self, name: str, value: Mapping[str, Any]) -> str:
        row = self._rows.get(name)
        if row is None:
            return f"there is no parameter {name}"
        if row.take is None:
            is_same = row.value() == value.get(_FIELDS[row.kind]) and value["type"] == row.kind
            return "" if is_same else f"{name} cannot be set here: {row.text}"
        number = value["double_value"]
        if value["type"] != _DOUBLE or not math.isfinite(number) or not 0.0 <= number <= MOST_HZ:
            return f"{name} is a double, 0 to {MOST_HZ:g}"
        return ""


def _at_once(
    answer: Callable[[dict[str, Any]], Mapping[str, Any]],
) -> Callable[[dict[str, Any]], Any]:
    async def call(asked: dict[str, Any]) -> Mapping[str, Any]:
        for what in asked.values():
            if isinstance(what, list) and len(what) > _MOST_NAMES:
                raise UsageError(f"{len(what)} parameters", remedy=f"ask for {_MOST_NAMES} at most")
        return answer(asked)

    return call
