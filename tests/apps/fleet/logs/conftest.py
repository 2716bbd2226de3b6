"""Logs on board: what is in them does not matter to who fetches them."""

from __future__ import annotations

import random
from pathlib import Path
from typing import Any

import pytest

from m100link.apps.fleet.asking import Asker
from m100link.apps.fleet.keys import Keys
from m100link.apps.fleet.logs.fetching import LogFetcher
from m100link.apps.fleet.logs.service import LogService
from tests.apps.bus.memory import MemoryBus, MemoryNetwork
from tests.apps.fleet.conftest import UTC

FIRST, SECOND = "m100link-20260101-000000.mcap", "m100link-20260101-000001.mcap"
KEYS = Keys("field", "a1")


def bytes_of(size: int) -> bytes:
    """Some bytes, the same ones each time."""
    return random.Random(size).randbytes(size)


@pytest.fixture
def directory(tmp_path: Path) -> Path:
    """The folder on board, with one log."""
    folder = tmp_path / "board"
    folder.mkdir()
    (folder / FIRST).write_bytes(bytes_of(300_000))
    return folder


class Road:
    """An aircraft's logs at one end of a network, and who fetches at the other."""

    def __init__(self, directory: Path) -> None:
        self.network = MemoryNetwork(seed=3)
        self.directory = directory
        self.onboard = self.network.session()
        self.here = self.network.session()
        self.token = self.onboard.declare(KEYS.live_by(self.onboard.session))

    def service(self, **options: Any) -> LogService:
        return LogService(self.onboard, KEYS, self.directory, **options)

    def asker(self, bus: MemoryBus | None = None, **options: Any) -> Asker:
        return Asker(bus or self.here, KEYS, "anna", **{"utc": lambda: UTC} | options)

    def fetcher(self, **options: object) -> LogFetcher:
        return LogFetcher(self.asker(self.network.session(), **options))


@pytest.fixture
async def road(directory: Path) -> Road:
    return Road(directory)
