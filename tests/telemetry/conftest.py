"""Everything here runs on virtual time; tests that need a real port override ``anyio_backend``."""

from __future__ import annotations

import pytest

from m100link.sim import VirtualClockEventLoop


@pytest.fixture
def anyio_backend() -> object:
    return "asyncio", {"loop_factory": VirtualClockEventLoop}
