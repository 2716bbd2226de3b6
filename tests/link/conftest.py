"""Event loops of the link's tests."""

from __future__ import annotations

import os
from typing import Any

import pytest

from m100link.link import transport
from m100link.sim.clock import VirtualClockEventLoop
from tests.waiting import PATIENCE


@pytest.fixture
def owners_are_found(monkeypatch: pytest.MonkeyPatch) -> None:
    """The search for a port's owners has a second, which other processes may take up."""
    monkeypatch.setattr(transport, "_LOOK_S", PATIENCE)


@pytest.fixture
def anyio_backend(request: pytest.FixtureRequest) -> tuple[str, dict[str, Any]]:
    """asyncio: on virtual time, except for tests marked ``pty``.

    With ``M100LINK_TESTS_ON_UVLOOP`` in the environment those run on uvloop.
    """
    if request.node.get_closest_marker("pty") is None:
        return "asyncio", {"loop_factory": VirtualClockEventLoop}
    return "asyncio", {"use_uvloop": "M100LINK_TESTS_ON_UVLOOP" in os.environ}
