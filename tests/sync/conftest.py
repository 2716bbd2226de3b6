"""Aircraft in threads of their own, whose time passes while the test waits for them."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack

import pytest

from m100link import sync
from m100link.sim import LockstepEventLoop
from m100link.sync import aircraft as module
from m100link.sync.portal import Portal


@pytest.fixture
def connect(monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[..., sync.Aircraft]]:
    """Connects to a virtual aircraft."""
    monkeypatch.setattr(module, "Portal", lambda _: Portal(LockstepEventLoop))
    with ExitStack() as opened:
        yield lambda line="sim://": opened.enter_context(sync.connect(line))
