"""A session of ROS 2: configured from where rmw_zenoh takes it."""

from __future__ import annotations

import os
from collections.abc import Mapping
from contextlib import AbstractAsyncContextManager

from m100link.apps.bus.session import LARGEST, Opening, ZenohBus, open_session
from m100link.errors import UsageError

__all__ = ["MOST_BYTES", "open_ros2"]

MOST_BYTES = 32768
"""Of a payload that is read: a mission of 500 places has 20,000."""

_SESSION = {
    "mode": '"peer"',
    "connect/endpoints": '["tcp/localhost:7447"]',
    "connect/exit_on_failure": "false",
    "listen/endpoints": '["tcp/localhost:0"]',
    "scouting/multicast/enabled": "false",
    "timestamping/enabled": '{"router": true, "peer": true, "client": true}',
    # As rmw_zenoh's, and not below that of its router: who stands still for longer than ours and
    # shorter than the router's gives up this session and is told of no way back to it.
    "transport/link/tx/lease": "60000",
    # Nothing that a node hears is longer, and zenoh would put a gigabyte together.
    "transport/link/rx/max_message_size": str(LARGEST),
}
"""rmw_zenoh's session, where it differs from zenoh's default."""

_CONFIG, _OVERRIDE = "ZENOH_SESSION_CONFIG_URI", "ZENOH_CONFIG_OVERRIDE"


def _overrides(told: str) -> dict[str, str]:
    found = {}
    for rule in told.split(";"):
        name, sign, value = rule.partition("=")
        if rule.strip() and not sign:
            raise UsageError(f"{_OVERRIDE}: {rule!r} is not name=value")
        if sign:
            found[name.strip()] = value.strip()
    return found


def open_ros2(
    environment: Mapping[str, str] = os.environ,
) -> AbstractAsyncContextManager[ZenohBus]:
    """A session while the block runs, configured as rmw_zenoh's are.

    Without a router it waits for one; who listens is found when that is there.

    Args:
        environment: Has ``ZENOH_SESSION_CONFIG_URI`` and ``ZENOH_CONFIG_OVERRIDE``.

    Raises:
        UsageError: The package is missing, or the configuration cannot be.
    """
    path = environment.get(_CONFIG)
    options = ({} if path else _SESSION) | _overrides(environment.get(_OVERRIDE, ""))
    return open_session(
        Opening(
            "ROS 2",
            "ros2",
            options,
            file=(path, _CONFIG) if path else None,
            largest=MOST_BYTES,
            remedies={"": f"check {_CONFIG} and {_OVERRIDE}, and that the port is free"},
        )
    )
