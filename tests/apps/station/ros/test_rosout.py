"""Events are a topic."""

from __future__ import annotations

import pytest

from tests.apps.station.conftest import Rig

pytestmark = pytest.mark.anyio


async def test_each_event_is_told_with_its_level(rig: Rig) -> None:
    client = rig.client()
    client.subscribe("/rosout")
    rig.agent.journal.note("a thing happened")
    rig.agent.journal.note("a bad thing happened", "error")
    await rig.until(lambda: len(client.read()) == 2)
    first, second = (one["msg"] for one in client.read())
    assert (first["level"], first["msg"], first["name"]) == (2, "a thing happened", "/m100link")
    assert (second["level"], second["msg"]) == (8, "a bad thing happened")
    assert second["header"]["seq"] == first["header"]["seq"] + 1
