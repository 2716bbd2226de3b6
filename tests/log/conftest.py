"""A flight of the virtual aircraft on virtual time, recorded."""

from __future__ import annotations

from typing import Any

import pytest

from m100link.sim import VirtualClockEventLoop

pytest.importorskip("mcap.writer", reason="the extra `log` is not installed")


@pytest.fixture
def anyio_backend() -> tuple[str, dict[str, Any]]:
    return "asyncio", {"loop_factory": VirtualClockEventLoop}
