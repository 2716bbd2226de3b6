"""A layout of panels for Foxglove and Lichtblick, for recorded flights and live ones."""

from __future__ import annotations

from typing import Any

from m100link.log.channels import EVENT, FIX, MESSAGE, TELEMETRY

__all__ = ["layout"]


def _path(column: str) -> str:
    """A column as the panels write it: its name has a dot, so it stands in quotes."""
    return f'{TELEMETRY}."{column}"'


def _plot(title: str, **lines: str) -> dict[str, Any]:
    return {
        "title": title,
        "paths": [
            {
                "value": path,
                "label": label.replace("_", " "),
                "enabled": True,
                "timestampMethod": "receiveTime",
            }
            for label, path in lines.items()
        ],
        "showXAxisLabels": True,
        "showYAxisLabels": True,
        "showLegend": True,
        "legendDisplay": "floating",
        "showPlotValuesInLegend": True,
        "isSynced": True,
        "xAxisVal": "timestamp",
        "sidebarDimension": 240,
    }


def _split(direction: str, first: Any, second: Any, percent: int) -> dict[str, Any]:
    return {
        "direction": direction,
        "first": first,
        "second": second,
        "splitPercentage": percent,
    }


def layout() -> dict[str, Any]:
    """Map, height, speed, battery, attitude and events, ready for JSON.

    ``/tf`` and ``/m100/log`` are there while a flight is watched, ``/m100/event`` in its log.
    """
    panels = {
        "map!m100": {"enabledTopics": [FIX], "followTopic": FIX, "zoomLevel": 18},
        "Plot!height": _plot("Height, m", height=_path("position.height")),
        "Plot!speed": _plot(
            "Speed, m/s",
            north=_path("velocity.x"),
            east=_path("velocity.y"),
            up=_path("velocity.z"),
        ),
        "Plot!battery": _plot("Battery, %", charge=_path("battery.percent")),
        "Gauge!battery": {
            "path": _path("battery.percent"),
            "minValue": 0,
            "maxValue": 100,
            "colorMode": "colormap",
            "colorMap": "red-yellow-green",
            "gradient": ["#0000ff", "#ff00ff"],
            "reverse": False,
        },
        "Plot!attitude": _plot(
            "Attitude, quaternion",
            **{name: _path(f"quaternion.{name}") for name in ("q0", "q1", "q2", "q3")},
        ),
        "3D!attitude": {
            "followTf": "takeoff",
            "followMode": "follow-pose",
            "scene": {"transforms": {"axisScale": 1.5, "showLabel": True}},
            "transforms": {"frame:m100": {"visible": True}},
            "topics": {},
            "layers": {"grid": {"layerId": "foxglove.Grid", "visible": True, "size": 20}},
        },
        "StateTransitions!status": {
            "paths": [
                {"value": _path("flight_status.status"), "timestampMethod": "receiveTime"},
                {"value": f"{EVENT}.after", "timestampMethod": "receiveTime"},
            ],
            "isSynced": True,
        },
        "RawMessages!event": {"topicPath": EVENT, "diffEnabled": False},
        "RosOut!log": {"topicToRender": MESSAGE, "minLogLevel": 1},
    }
    left = _split("column", "map!m100", _split("row", "3D!attitude", "Gauge!battery", 65), 60)
    plots = _split(
        "column",
        _split("column", "Plot!height", "Plot!speed", 50),
        _split("column", "Plot!battery", "Plot!attitude", 50),
        50,
    )
    told = _split("row", "RawMessages!event", "RosOut!log", 50)
    right = _split("column", plots, _split("column", "StateTransitions!status", told, 35), 70)
    return {
        "configById": panels,
        "globalVariables": {},
        "userNodes": {},
        "playbackConfig": {"speed": 1},
        "layout": _split("row", left, right, 45),
    }
