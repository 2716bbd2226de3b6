"""A node of ROS 2 without a ROS installation: what rmw_zenoh has on the wire, made here."""

from __future__ import annotations

from pathlib import Path

__all__ = ["MESSAGES"]

MESSAGES = Path(__file__).parent / "m100_msgs"  # the package, as colcon builds it
