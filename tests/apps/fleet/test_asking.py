"""Silence is no answer: orders through a network that loses, repeats, delays and reorders."""

from __future__ import annotations

from collections import Counter
from typing import cast

import anyio
import pytest

from m100link.apps.agent.lease import Lease
from m100link.apps.agent.messages import Action, Ask, Message
from m100link.apps.bus.network import Answer, Bus
from m100link.apps.fleet.asking import PATIENCE_S, Asker
from m100link.apps.fleet.keys import Keys
from m100link.apps.fleet.payloads import Outcome, outcome_of
from m100link.errors import M100Error, OutcomeUnknown, Unreachable
from tests.apps.bus.memory import MemoryBus, Weather
from tests.apps.fleet.conftest import SITE, Rig, with_camera

pytestmark = pytest.mark.anyio

NOT_DONE = (Outcome.REFUSED, Outcome.STALE_LEASE, Outcome.NOT_ALLOWED, Outcome.UNREACHABLE)


async def asked(one: Asker, message: Message, lease: Lease) -> Outcome:
    try:
        await one.ask(message, fence=lease.number, token=lease.token)
    except M100Error as error:
        return outcome_of(error)
    return Outcome.OK


@pytest.mark.parametrize("seed", range(2))
async def test_at_most_once_and_never_a_false_ok(rig: Rig, seed: int) -> None:
    """Forty orders; the aircraft itself counts what was done."""
    one, pilot = await rig.aircraft("a1", virtual=with_camera()), await rig.pilot(patience=2.0)
    await one.agent.activate()
    camera, outcomes, wrong = one.aircraft.vehicle.camera, Counter[Outcome](), []
    asker = pilot["a1"].asker
    rig.network.seed(seed)
    for _ in range(40):
        rig.network.weather = Weather()
        await anyio.sleep(4.0)  # what was late has come, the camera is ready, the lease has ended
        lease, _ = await asker.take_lease(asker.lease_request())
        before = camera.photos
        rig.network.weather = Weather(loss=0.2, repeat=0.3, delay_s=0.01, jitter_s=0.3)
        outcome = await asked(asker, Ask(0, Action.TAKE_PHOTO), lease)
        rig.network.weather = Weather()
        await anyio.sleep(2.0)
        done = camera.photos - before
        outcomes[outcome] += 1
        is_lie = (outcome is Outcome.OK) > done or (done and outcome in NOT_DONE)
        if done > 1 or is_lie:
            wrong.append((outcome, done))
    assert wrong == [], f"seed {seed}"
    assert outcomes[Outcome.OK] > 25, f"seed {seed}: {outcomes}"


async def test_a_way_that_is_cut_is_unknown_and_what_is_not_there_unreachable(rig: Rig) -> None:
    one, pilot = await rig.aircraft("a1"), await rig.pilot()
    rig.network.cut(one.bus)
    began = anyio.current_time()
    with pytest.raises(OutcomeUnknown):
        await pilot["a1"].stop()
    assert PATIENCE_S <= anyio.current_time() - began < PATIENCE_S + 1.0
    await anyio.sleep(2.0)
    with pytest.raises(Unreachable):
        await pilot["a1"].stop()


async def test_an_outcome_is_found_again_when_the_way_is_whole_again(rig: Rig) -> None:
    one, pilot = await rig.aircraft("a1"), await rig.pilot()

    async def cut() -> None:
        await anyio.sleep(3.5)  # in the middle of the take-off
        rig.network.cut(one.bus)
        await anyio.sleep(1.0)
        rig.network.join(one.bus)

    async with anyio.create_task_group() as group:
        group.start_soon(cut)
        await pilot["a1"].take_off()
    assert one.height > 1.0


class OnlyStatus:
    """A router whose rules let one ask what became of an order, and give none."""

    def __init__(self, bus: MemoryBus) -> None:
        self._bus = bus

    async def ask(self, key: str, payload: bytes = b"", *, timeout: float) -> list[Answer]:
        if "/status/" in key:
            return await self._bus.ask(key, payload, timeout=timeout)
        return []

    async def tokens(self, pattern: str, *, timeout: float) -> list[str]:
        return await self._bus.tokens(pattern, timeout=timeout)


async def test_an_order_that_never_arrives_is_not_sent_for_ever(rig: Rig) -> None:
    await rig.aircraft("a1")
    bus = cast(Bus, OnlyStatus(rig.network.session()))
    asker = Asker(bus, Keys(SITE, "a1"), "pilot", patience=3.0)
    began = anyio.current_time()
    with pytest.raises(OutcomeUnknown, match="has not heard of the order"):
        await asker.take_lease(asker.lease_request())
    assert 3.0 <= anyio.current_time() - began < 6.0


async def test_an_answer_that_cannot_be_read_is_no_refusal(rig: Rig) -> None:
    """The one who gives it may have done what was asked, as here."""
    one, pilot = await rig.aircraft("a1", virtual=with_camera()), await rig.pilot()
    await one.agent.activate()
    asker = pilot["a1"].asker
    lease, _ = await asker.take_lease(asker.lease_request())
    other = rig.network.session()
    other.serve("m100/*/a1/cmd", lambda question: question.answer("m100/x/a1/cmd", b"\x09{}"))
    photo = Ask(0, Action.TAKE_PHOTO)
    assert await asked(pilot["a1"].asker, photo, lease) is Outcome.OK, "one of two can be read"
    for outlet in list(rig.network.takers("serve", "m100/*/a1/cmd")):
        if outlet.session is one.bus:
            outlet.close()
    assert await asked(pilot["a1"].asker, photo, lease) is Outcome.UNKNOWN, "nothing else came"


async def test_a_take_off_that_is_broken_off_is_unknown_to_who_asked(rig: Rig) -> None:
    one, pilot, other = await rig.aircraft("a1"), await rig.pilot(), await rig.pilot("other")
    results: list[Outcome] = []

    async def take_off() -> None:
        results.append((await pilot.each(lambda a: a.take_off(), ["a1"]))["a1"].outcome)

    async with anyio.create_task_group() as group:
        group.start_soon(take_off)
        await rig.until(lambda: one.height > 0.3)
        assert (await other.stop())["a1"].is_ok
    assert results == [Outcome.UNKNOWN], "it is in the air"
    assert one.height > 0.3


async def test_an_order_is_as_old_as_the_slowest_clock_would_have_it(rig: Rig) -> None:
    """Two clocks part by 100 µs in a second at most; no order is made younger than it is."""
    asker = Asker(rig.network.session(), Keys(SITE, "a1"), "pilot")
    assert asker.lease_request().order.clock == 0.0, "it never answered"
    asker.heard_at, asker.its_clock = anyio.current_time(), 500.0
    await anyio.sleep(1000.0)
    assert asker.lease_request().order.clock == pytest.approx(1499.9, abs=0.001)
