"""A node of ROS 2 without a ROS installation: what rmw_zenoh has on the wire, made here.

Attributes:
    MESSAGES: Where the package ``m100_msgs`` is, as colcon builds it.
"""

from __future__ import annotations

from pathlib import Path

__all__ = ["MESSAGES"]

MESSAGES = Path(__file__).parent / "m100_msgs"
