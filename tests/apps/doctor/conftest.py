"""Virtual time, and a machine of files."""

from __future__ import annotations

from pathlib import Path

import pytest

from m100link.sim import VirtualClockEventLoop
from tests.apps.doctor.bench import FakeMachine


@pytest.fixture
def anyio_backend() -> object:
    return "asyncio", {"loop_factory": VirtualClockEventLoop}


@pytest.fixture
def machine(tmp_path: Path) -> FakeMachine:
    return FakeMachine(tmp_path)
