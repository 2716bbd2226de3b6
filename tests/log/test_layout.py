"""The layout shows what there is: each path is a column, each panel has its place."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest

from m100link.log import read
from m100link.log.channels import SCHEMAS, layout
from tests.log.flight import flown

# Panels that Foxglove and Lichtblick both have, by the type in the panel's name, and the settings
# that both read: the types of Lichtblick 1.28, and foxglove.layouts of foxglove-sdk 0.30. Each
# ignores a setting that it does not know.
SETTINGS = {
    "map": "customTileUrl disabledTopics followTopic layer maxNativeZoom topicColors zoomLevel",
    "Plot": "paths minXValue maxXValue minYValue maxYValue showLegend legendDisplay isSynced"
    " showPlotValuesInLegend showXAxisLabels showYAxisLabels xAxisVal xAxisPath xAxisLabel"
    " yAxisLabel followingViewWidth sidebarDimension",
    "3D": "cameraState followTf followMode scene transforms topics layers publish",
    "StateTransitions": "paths isSynced xAxisMaxValue xAxisMinValue xAxisRange showPoints",
    "RawMessages": "diffEnabled diffMethod diffTopicPath expansion topicPath",
    "RosOut": "searchTerms minLogLevel topicToRender nameFilter",
}
SERIES = {"value", "label", "enabled", "color", "showLine", "lineSize", "timestampMethod"}
CHOICES = {
    "legendDisplay": {"floating", "top", "left"},
    "xAxisVal": {"timestamp", "index", "custom", "currentCustom"},
    "timestampMethod": {"receiveTime", "headerStamp"},
    "followMode": {"follow-pose", "follow-position", "follow-none"},
}
TITLES = {"foxglovePanelTitle", "lichtblickPanelTitle"}  # of Foxglove, and of Lichtblick
PATH = re.compile(r'(/[\w-]+)+(\.([\w-]+|"[^"\\]+"))*')  # their grammar, without slices and filters


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
    assert {name.split("!")[0] for name in placed} <= SETTINGS.keys()
    assert json.loads(json.dumps(made)) == made


@pytest.mark.parametrize("name", layout()["configById"])
def test_each_setting_is_one_that_both_programs_read(name: str) -> None:
    panel = layout()["configById"][name]
    titles = TITLES & panel.keys()
    assert not titles or len({panel[title] for title in TITLES}) == 1
    assert panel.keys() - titles <= set(SETTINGS[name.split("!")[0]].split())
    for one in (panel, *panel.get("paths", ())):
        for key, value in one.items():
            assert value in CHOICES.get(key, [value])
    for one in panel.get("paths", ()):
        assert one.keys() <= SERIES
        assert PATH.fullmatch(one["value"])
    for key in ("topicPath", "topicToRender", "followTopic"):
        assert PATH.fullmatch(panel.get(key, "/m100"))


@pytest.mark.anyio
async def test_every_path_is_a_column_that_a_flight_has(tmp_path: Path) -> None:
    await flown(tmp_path / "flight.mcap")
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
