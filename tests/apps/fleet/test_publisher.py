"""What a wall shows is what the aircraft said, and what cannot be read is counted."""

from __future__ import annotations

import random
from collections import Counter

import anyio
import pytest

from m100link.apps.fleet.keys import Keys
from m100link.apps.fleet.payloads import unpack_message
from m100link.apps.fleet.publisher import FleetTelemetry, Thinner
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


async def test_what_fronts_elsewhere_hear_comes_again_lest_it_was_lost(rig: Rig) -> None:
    """The state four times a second, lease and counters each second, the plan each five."""
    heard: Counter[str] = Counter()

    def take(_: str, payload: bytes) -> None:
        heard[type(unpack_message(payload)).__name__] += 1

    rig.network.session().subscribe(Keys(SITE, "a1").told, take)
    await rig.served("a1")
    await anyio.sleep(1.0)
    heard.clear()
    await anyio.sleep(10.0)
    often = {"State": 40, "Hello": 10, "LeaseChanged": 10, "LinkCounted": 10, "PlanChanged": 2}
    assert heard == often


# -- An overview gets each item at its own rate or five times a second -----------------------------


FAST, MIDDLE, TENTH, SLOW = 1 << 1, 1 << 5, 1 << 9, 1 << 10
EVERY = {FAST: 1, MIDDLE: 2, TENTH: 10, SLOW: 100}
"""Items at 100, 50, 10 and 1 Hz, as an aircraft can be set to send them."""


def told_of(shifts: dict[int, int], *, jitter: float = 0.0, seed: int = 0) -> Counter[str]:
    """Packages and items in ten seconds, each item at a phase of its own."""
    thinner, told, chance = Thinner(5.0), Counter[str](), random.Random(seed)
    for tick in range(1000):
        flags = sum(
            item for item, every in EVERY.items() if tick % every == shifts.get(item, 0) % every
        )
        if flags and thinner.goes_on(flags, tick / 100 + jitter * chance.random()):
            told["packages"] += 1
            told.update(bin(item) for item in EVERY if flags & item)
    return told


def test_one_package_tells_all_items_where_one_has_all_of_them() -> None:
    told = told_of({})
    assert told["packages"] == 50
    assert told[bin(FAST)] == told[bin(MIDDLE)] == told[bin(TENTH)] == 50
    assert told[bin(SLOW)] == 10


@pytest.mark.parametrize("jitter", [0.0, 0.004, 0.012])
@pytest.mark.parametrize("shift", range(10))
def test_each_item_at_five_hertz_or_its_own_rate(shift: int, jitter: float) -> None:
    """With phases of their own, too; and with the jitter of a busy machine."""
    chance = random.Random(shift)
    shifts = {item: chance.randrange(100) for item in EVERY} | {SLOW: shift}
    told = told_of(shifts, jitter=jitter, seed=shift)
    about = f"seed {shift}: {shifts} {told}"
    assert told[bin(SLOW)] == 10, about
    for item in (FAST, MIDDLE, TENTH):
        # One that comes without the others is sent by itself, with the fast ones as company.
        assert 48 <= told[bin(item)] <= told["packages"], about
    assert told["packages"] <= 115, about


def test_what_has_nothing_new_does_not_go_on() -> None:
    thinner = Thinner(5.0)
    assert thinner.goes_on(FAST, 0.0)
    assert not thinner.goes_on(FAST, 0.01)
    assert thinner.goes_on(FAST | SLOW, 0.02)
    assert not thinner.goes_on(0, 0.03)


def test_what_was_silent_goes_on_at_once() -> None:
    thinner = Thinner(5.0)
    for tick in range(3):
        thinner.goes_on(FAST, tick / 100)
    assert thinner.goes_on(FAST, 3.0)
    assert not thinner.goes_on(FAST, 3.01)


def test_two_that_were_read_at_once_are_reported_once() -> None:
    thinner = Thinner(5.0)
    told = [at for at in range(100) for _ in range(2) if thinner.goes_on(FAST, at / 100)]
    assert told == [0, *range(20, 100, 20)]
