"""What a wall shows is what the aircraft said, and what cannot be read is counted."""

from __future__ import annotations

import anyio
import pytest

from m100link.apps.fleet.keys import Keys
from m100link.apps.fleet.publisher import FleetTelemetry
from m100link.protocol.records import Attitude, Battery
from tests.apps.fleet.conftest import SITE, Rig

pytestmark = pytest.mark.anyio


async def test_a_wall_has_the_newest_values_of_all(rig: Rig) -> None:
    ones = [await rig.aircraft(name) for name in ("a1", "a2")]
    bus = rig.network.session()
    wall = FleetTelemetry(bus, Keys(SITE))
    await anyio.sleep(5.0)
    assert set(wall.states) == {"a1", "a2"}
    for one in ones:
        state = wall.states[one.name]
        assert one.client.telemetry is not None
        assert state.get(Battery) == one.client.telemetry.get(Battery)
        assert (state.age(Attitude) or 0.0) < 0.25
    assert 20 <= wall.received["a1"] <= 60
    wall.close()
    before = wall.received.total()
    await anyio.sleep(1.0)
    assert wall.received.total() == before


async def test_one_is_heard_in_full_and_each_package_handed_on(rig: Rig) -> None:
    await rig.aircraft("a1")
    values: list[bytes] = []
    full = FleetTelemetry(
        rig.network.session(),
        Keys(SITE, "a1"),
        full=True,
        on_sample=lambda _, sample: values.append(sample.value),
    )
    await anyio.sleep(2.0)
    assert len(values) == full.received["a1"] > 90


async def test_what_cannot_be_read_is_counted(rig: Rig) -> None:
    bus = rig.network.session()
    wall = FleetTelemetry(bus, Keys(SITE))
    outlet = rig.network.session().publish(Keys(SITE, "a1").thinned)
    for payload in (b"", b"\x02x", b"\x01{}", b"\x01\x02junk"):
        outlet.put(payload)
    await anyio.sleep(0.1)
    assert (wall.unread, wall.received.total()) == (4, 0)
