"""A flight of the virtual aircraft on virtual time, recorded."""

from __future__ import annotations

from typing import Any

import pytest

from m100link.sim import VirtualClockEventLoop

# The thread that opens a log would load it beside a virtual clock, whose loop never rests.
pytest.importorskip("mcap.writer", reason="the extra `log` is not installed")


@pytest.fixture
def anyio_backend() -> tuple[str, dict[str, Any]]:
    return "asyncio", {"loop_factory": VirtualClockEventLoop}
