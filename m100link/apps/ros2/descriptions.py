"""What the types of the node are, for who asks: the service of each node of rclcpp (REP 2016)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from m100link.apps.ros2.ends import Ends
from m100link.apps.ros2.graph import Names
from m100link.log.cdr import describe, full_name, type_hash
from m100link.log.ros2_definitions import DEFINITIONS, SERVICES

__all__ = ["serve_descriptions"]

_KIND = "type_description_interfaces/srv/GetTypeDescription"
_NOTHING: Mapping[str, Any] = {
    "type_description": {
        "type_description": {"type_name": "", "fields": []},
        "referenced_type_descriptions": [],
    },
    "type_sources": [],
    "extra_information": [],
}
_NAMES = {full_name(one): one for one in DEFINITIONS}


def serve_descriptions(ends: Ends, names: Names) -> None:
    """Offer the service.

    Args:
        ends: Where it is offered.
        names: Names of the node.
    """
    ends.serve(names.full("~/get_type_description"), _KIND, _answer)


async def _answer(asked: dict[str, Any]) -> Mapping[str, Any]:
    name, known = asked["type_name"], _NAMES.get(asked["type_name"])
    if known is None:
        return _refused(f"this node has no type {name!r}")
    if asked["type_hash"] not in ("", type_hash(known)):
        return _refused(f"{name} has the hash {type_hash(known)} here")
    described = describe(known)
    types = [described["type_description"], *described["referenced_type_descriptions"]]
    for one in types:
        for each in one["fields"]:
            each["default_value"] = ""
    sources = [_source(one["type_name"]) for one in types] if asked["include_type_sources"] else []
    return {
        "successful": True,
        "failure_reason": "",
        "type_description": described,
        "type_sources": sources,
        "extra_information": [],
    }


def _source(name: str) -> Mapping[str, str]:
    """The text that a type is made of; parts of services and actions have none of their own."""
    known = _NAMES[name]
    if known in SERVICES:
        request, response = SERVICES[known]
        text, encoding = f"{request}\n---\n{response}\n", "srv"
    elif name.split("/")[1] == "msg":
        text, encoding = f"{DEFINITIONS[known]}\n", "msg"
    else:
        text, encoding = "", "implicit"
    return {"type_name": name, "encoding": encoding, "raw_file_contents": text}


def _refused(why: str) -> Mapping[str, Any]:
    return {"successful": False, "failure_reason": why, **_NOTHING}
