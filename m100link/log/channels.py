"""Topics of a flight log, and the schemas of what stands on them.

Names and fields of ``foxglove.*`` are Foxglove's, so that its panels know them.
"""

from __future__ import annotations

import json
from typing import Any, NamedTuple

__all__ = [
    "CHUNKS",
    "COMMAND",
    "EVENT",
    "FIX",
    "LINK",
    "MESSAGE",
    "RX",
    "SCHEMAS",
    "STATE",
    "TELEMETRY",
    "TRANSFORM",
    "TX",
    "Schema",
    "Told",
]

RX, TX = "/m100/raw/rx", "/m100/raw/tx"
"""The bytes as they were read and written: all messages of a topic joined are the whole stream."""

CHUNKS = "/m100/raw/chunks"
"""How the bytes of the raw message of the same time came: times and lengths of reads or writes."""

FIX, TELEMETRY = "/m100/fix", "/m100/telemetry"
COMMAND, EVENT, LINK = "/m100/command", "/m100/event", "/m100/link"

TRANSFORM, MESSAGE, STATE = "/tf", "/m100/log", "/m100/state"
"""What is told live besides, to who watches a flight."""

Told = tuple[str, dict[str, Any]]
"""A topic, and what is said on it."""


class Schema(NamedTuple):
    """What stands on a topic.

    Attributes:
        name: Its name.
        text: JSON schema.
    """

    name: str
    text: str


def _schema(called: str, /, **properties: dict[str, Any]) -> Schema:
    text = json.dumps(
        {"title": called, "type": "object", "properties": properties, "required": list(properties)}
    )
    return Schema(called, text)


_NUMBER, _TEXT = {"type": "number"}, {"type": "string"}
_WHOLE = {"type": "integer"}
_TIME = {
    "type": "object",
    "title": "time",
    "properties": {"sec": {"type": "integer", "minimum": 0}, "nsec": {"type": "integer"}},
    "required": ["sec", "nsec"],
}


def _numbers(*names: str) -> dict[str, Any]:
    return {
        "type": "object",
        "properties": dict.fromkeys(names, _NUMBER),
        "required": list(names),
    }


SCHEMAS = {
    CHUNKS: _schema(
        "m100.Chunks",
        direction={"type": "string", "enum": ["rx", "tx"]},
        offset_us={"type": "array", "items": _WHOLE},
        length={"type": "array", "items": _WHOLE},
    ),
    FIX: _schema(
        "foxglove.LocationFix",
        timestamp=_TIME,
        frame_id=_TEXT,
        latitude=_NUMBER,
        longitude=_NUMBER,
        altitude=_NUMBER,
        position_covariance={"type": "array", "items": _NUMBER},
        position_covariance_type=_WHOLE,
    ),
    TELEMETRY: _schema("m100.Telemetry", received_at=_NUMBER),
    COMMAND: _schema("m100.Command", command=_TEXT, is_ack={"type": "boolean"}),
    EVENT: _schema("m100.Event", event=_TEXT),
    LINK: _schema("m100.Link", firmware=_TEXT),
    TRANSFORM: _schema(
        "foxglove.FrameTransform",
        timestamp=_TIME,
        parent_frame_id=_TEXT,
        child_frame_id=_TEXT,
        translation=_numbers("x", "y", "z"),
        rotation=_numbers("x", "y", "z", "w"),
    ),
    MESSAGE: _schema(
        "foxglove.Log",
        timestamp=_TIME,
        level=_WHOLE,
        message=_TEXT,
        name=_TEXT,
        file=_TEXT,
        line=_WHOLE,
    ),
    STATE: _schema("m100.State", connection=_TEXT, has_authority={"type": "boolean"}, task=_TEXT),
}
