"""A node of ROS 2 without a ROS installation, by the bytes of rmw_zenoh. Not promised."""

from __future__ import annotations

from pathlib import Path

__all__ = ["MESSAGES"]

MESSAGES = Path(__file__).parent / "m100_msgs"  # the package, as colcon builds it
