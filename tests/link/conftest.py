"""Event loops of the link's tests."""

from __future__ import annotations

from typing import Any

import pytest

from m100link.sim.clock import VirtualClockEventLoop


@pytest.fixture
def anyio_backend(request: pytest.FixtureRequest) -> tuple[str, dict[str, Any]]:
    """asyncio: on virtual time, except for tests marked ``pty``."""
    options: dict[str, Any] = {}
    if request.node.get_closest_marker("pty") is None:
        options["loop_factory"] = VirtualClockEventLoop
    return "asyncio", options
