"""The layout shows what there is: each path is a column, each panel has its place."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest

from m100link.log import read
from m100link.log.channels import SCHEMAS, layout
from tests.log.flight import fly

# Panels that Foxglove and Lichtblick both have, by the type in the panel's name.
PANELS = {"map", "Plot", "Gauge", "3D", "StateTransitions", "RawMessages", "RosOut"}


def leaves(node: Any) -> list[str]:
    if isinstance(node, str):
        return [node]
    assert node.keys() == {"direction", "first", "second", "splitPercentage"}
    assert node["direction"] in ("row", "column")
    assert 0 < node["splitPercentage"] < 100
    return leaves(node["first"]) + leaves(node["second"])


def test_every_panel_has_one_place_and_its_settings() -> None:
    made = layout()
    assert made.keys() == {
        "configById",
        "globalVariables",
        "userNodes",
        "playbackConfig",
        "layout",
    }
    placed = leaves(made["layout"])
    assert sorted(placed) == sorted(made["configById"])
    assert {name.split("!")[0] for name in placed} <= PANELS
    assert json.loads(json.dumps(made)) == made


@pytest.mark.anyio
async def test_every_path_is_a_column_that_a_flight_has(tmp_path: Path) -> None:
    await fly(tmp_path / "flight.mcap")
    flight = read(tmp_path / "flight.mcap")
    columns = {name for one in flight.messages("/m100/telemetry") for name in one.content()}
    text = json.dumps(layout())
    paths = set(re.findall(r'(/m100/\w+)\.(?:\\"([\w.]+)\\"|(\w+))', text))
    assert len(paths) > 8
    for topic, quoted, plain in paths:
        assert topic in SCHEMAS
        if topic == "/m100/telemetry":
            assert quoted in columns
        else:
            assert any(plain in one.content() for one in flight.messages(topic))
