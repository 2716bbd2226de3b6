"""What an agent answers to questions about a show, whatever they are."""

from __future__ import annotations

import asyncio
import json
from dataclasses import replace
from typing import Any

import anyio
import pytest

from m100link.apps.fleet.keys import Keys
from m100link.apps.fleet.payloads import SHOW, Order, Outcome, Reply, pack, unpack
from m100link.apps.fleet.show.plan.conflicts import Neighbours
from m100link.apps.fleet.show.service import Beside, ShowService
from m100link.sim.vehicle.settings import AircraftSettings
from m100link.sim.virtual import VirtualAircraft
from tests.apps.fleet.conftest import SITE, Rig, anyio_backend, rig
from tests.apps.fleet.show.shows import ORIGIN, track

__all__ = ["anyio_backend", "rig"]

pytestmark = pytest.mark.anyio

FLOWN = track("a1", (0, 0, 0, 4), (8, 12, 0, 5))
PIECE = {"do": "piece", "at": 0, "data": FLOWN.to_bytes().hex()}
LOAD = {"do": "load", "leave": "hover"}


class Asked:
    """A service, and somebody who asks it."""

    def __init__(self, rig: Rig) -> None:
        self.rig = rig
        self.bus = rig.network.session()

    async def come(self) -> None:
        settings = AircraftSettings(latitude_deg=ORIGIN[0], longitude_deg=ORIGIN[1])
        one = await self.rig.aircraft("a1", virtual=VirtualAircraft(seed=5, settings=settings))
        self.service = ShowService(one.client, one.bus, Keys(SITE, "a1"))
        self.running = asyncio.ensure_future(self.service.run())
        await anyio.sleep(0.1)

    async def ask(self, payload: bytes) -> Reply:
        [answer] = await self.bus.ask(f"m100/{SITE}/a1/show", payload, timeout=1.0)
        reply: Reply = unpack(Reply, answer.payload)
        return reply

    async def order(self, wanted: Any, number: int = 1, name: str = "a1") -> Reply:
        message = wanted if isinstance(wanted, bytes) else SHOW + json.dumps(wanted).encode()
        made = Order(f"{number:032x}", name, "anna", 0, 0.0, message, anyio.current_time())
        return await self.ask(pack(made))


@pytest.fixture
async def asked(rig: Rig) -> Any:
    made = Asked(rig)
    await made.come()
    yield made
    made.running.cancel()


async def test_where_it_stands_is_told_with_every_answer(asked: Asked) -> None:
    reply = await asked.order({"do": "tell"})
    assert reply.outcome is Outcome.OK
    assert json.loads(reply.text) == {"stage": "empty", "digest": "", "farthest_m": 0.0, "why": ""}
    assert (await asked.order(PIECE, 3)).outcome is Outcome.OK
    reply = await asked.order(LOAD, 2)
    told = json.loads(reply.text)
    assert (told["stage"], told["digest"]) == ("loaded", FLOWN.digest)
    assert reply.clock == pytest.approx(anyio.current_time(), abs=0.1)


async def test_an_order_that_the_network_brings_twice_is_done_once(asked: Asked) -> None:
    await asked.order(PIECE, 4)
    await asked.order(LOAD, 1)
    assert (await asked.order({"do": "place"}, 2)).outcome is Outcome.OK
    again = await asked.order({"do": "place"}, 2)
    assert (again.outcome, json.loads(again.text)["stage"]) == (Outcome.OK, "placing")
    assert (await asked.order({"do": "place"}, 3)).outcome is Outcome.REFUSED
    assert (await asked.order({"do": "place"}, 3)).outcome is Outcome.REFUSED


async def test_another_order_of_an_id_that_was_heard_is_an_order_of_its_own(asked: Asked) -> None:
    """A stranger hears the id of an order; the answer to what he asks by it is not the other's."""
    await asked.order(PIECE, 4)
    assert (await asked.order({"do": "tell"}, 1)).outcome is Outcome.OK
    assert json.loads((await asked.order(LOAD, 1)).text)["stage"] == "loaded"


@pytest.mark.parametrize(
    "wanted",
    [
        b"",
        b"show",
        SHOW + b"{",
        SHOW + b"[1]",
        SHOW + b"\xff",
        SHOW + b"[" * 2000,
        {},
        {"do": None},
        {"do": ["load"]},
        {"do": "dance"},
        {"do": "load"},
        {"do": "load", "leave": "land"},
        {"do": "piece"},
        {**PIECE, "data": 3},
        {**PIECE, "data": "xy"},
        {**PIECE, "at": 1},
        {**PIECE, "at": -1},
        {**LOAD, "leave": "home"},
        {**LOAD, "leave": []},
        {"do": "start", "digest": "", "at": "soon", "bound": 0},
        {"do": "start", "digest": "", "at": 10**400, "bound": 0},
    ],
)
async def test_nonsense_is_refused_and_breaks_nothing(asked: Asked, wanted: Any) -> None:
    assert (await asked.order(wanted)).outcome is Outcome.REFUSED
    assert (await asked.order({"do": "tell"}, 2)).outcome is Outcome.OK


async def test_a_track_comes_in_pieces_in_their_order(asked: Asked) -> None:
    data, numbers = FLOWN.to_bytes(), iter(range(100))

    async def piece(at: int, end: int) -> Outcome:
        wanted = {"do": "piece", "at": at, "data": data[at:end].hex()}
        return (await asked.order(wanted, next(numbers))).outcome

    assert await piece(0, 50) is Outcome.OK
    assert await piece(60, 70) is Outcome.REFUSED, "something is missing before it"
    assert await piece(50, 80) is Outcome.OK
    assert await piece(50, 90) is Outcome.OK, "sent anew: its answer was lost"
    assert await piece(90, len(data)) is Outcome.OK
    reply = await asked.order(LOAD, next(numbers))
    assert json.loads(reply.text)["digest"] == FLOWN.digest
    far = {"do": "piece", "at": 0, "data": "00" * 900}
    assert (await asked.order(far, next(numbers))).outcome is Outcome.OK
    assert (await asked.order(LOAD, next(numbers))).outcome is Outcome.REFUSED


async def test_what_is_no_order_or_for_another_aircraft_is_refused(asked: Asked) -> None:
    assert (await asked.ask(b"\x01{}")).outcome is Outcome.REFUSED
    assert (await asked.ask(b"")).outcome is Outcome.REFUSED
    assert (await asked.order({"do": "tell"}, name="a2")).outcome is Outcome.NOT_ALLOWED


async def test_what_it_remembers_has_an_end(asked: Asked) -> None:
    for number in range(1100):
        await asked.order({"do": "tell"}, number)
    assert len(asked.service._known) == 1024


@pytest.mark.parametrize("made_at", [0.0, None])
async def test_a_take_off_that_nobody_waits_for_is_not_begun(
    asked: Asked, made_at: float | None
) -> None:
    """It waited before a frozen agent, or does not say since when."""
    await asked.order(PIECE, 4)
    await asked.order(LOAD, 1)
    clock = anyio.current_time() if made_at is None else made_at
    late = Order(f"{9:032x}", "a1", "anna", 0, 0.0, SHOW + b'{"do": "place"}', clock)
    await anyio.sleep(6.0)
    reply = await asked.ask(pack(late))
    assert reply.outcome is Outcome.REFUSED
    assert reply.fault is not None
    assert "nobody waits" in reply.fault.seen
    assert json.loads(reply.text)["stage"] == "loaded"
    assert (await asked.order({"do": "place"}, 10)).outcome is Outcome.OK


@pytest.mark.parametrize("how", ["leave", "stop"])
async def test_what_was_ordered_before_it_ended_and_comes_later_does_not_take_off(
    asked: Asked, how: str
) -> None:
    """Each try of a conductor is an order of its own: all it sent may come behind its last word."""
    await asked.order(PIECE, 1)
    made = anyio.current_time()
    if how == "leave":
        await asked.order({"do": "leave"}, 2)
    else:
        await (await asked.rig.pilot("anybody"))["a1"].stop()
    await anyio.sleep(1.0)
    for number, wanted in enumerate((LOAD, {"do": "place"}), start=10):
        message = SHOW + json.dumps(wanted).encode()
        late = Order(f"{number:032x}", "a1", "anna", 0, 0.0, message, made - 0.01)
        reply = await asked.ask(pack(late))
        assert reply.fault is not None
        assert "was asked for after it was made" in reply.fault.seen
    await asked.order(LOAD, 20)
    reply = await asked.ask(pack(replace(late, id=f"{30:032x}")))
    assert json.loads(reply.text)["stage"] == "loaded"
    assert (await asked.order({"do": "place"}, 21)).outcome is Outcome.OK


async def test_who_conducts_another_show_does_nothing_to_it(asked: Asked) -> None:
    """Not even that it waits for the second one where the first one has gone."""
    await asked.order(PIECE | {"run": "a"}, 1)
    await asked.order(LOAD | {"run": "a"}, 2)
    others: list[dict[str, Any]] = [PIECE, LOAD, {"do": "place"}, {"do": "leave"}]
    for number, wanted in enumerate(others, start=3):
        reply = await asked.order(wanted | {"run": "b"}, number)
        assert reply.fault is not None
        assert "in a show that another one conducts" in reply.fault.seen
    assert (await asked.order({"do": "place", "run": "a"}, 10)).outcome is Outcome.OK
    for number in range(20, 28):
        await anyio.sleep(1.4)
        reply = await asked.order({"do": "tell", "run": "b"}, number)
        assert reply.outcome is Outcome.OK
    assert "whoever conducts was silent" in json.loads(reply.text)["why"]
    assert (await asked.order(PIECE | {"run": "b"}, 30)).outcome is Outcome.OK


async def test_a_track_whose_conductor_is_gone_keeps_nobody_out(asked: Asked) -> None:
    await asked.order(PIECE | {"run": "a"}, 1)
    await asked.order(LOAD | {"run": "a"}, 2)
    assert (await asked.order(PIECE | {"run": "b"}, 3)).outcome is Outcome.REFUSED
    await anyio.sleep(11.0)
    assert (await asked.order(PIECE | {"run": "b"}, 4)).outcome is Outcome.OK
    assert (await asked.order(LOAD | {"run": "b"}, 5)).outcome is Outcome.OK
    assert (await asked.order({"do": "place", "run": "a"}, 6)).outcome is Outcome.REFUSED


async def test_two_that_one_process_serves_hear_each_other(asked: Asked) -> None:
    """By one session, which does not hear itself: in a show they did not look at each other."""
    beside, bus = Beside(), asked.rig.network.session()
    settings = AircraftSettings(latitude_deg=ORIGIN[0], longitude_deg=ORIGIN[1])
    services = []
    for name in ("b1", "b2"):
        one = await asked.rig.aircraft(name, virtual=VirtualAircraft(seed=5, settings=settings))
        services.append(ShowService(one.client, bus, Keys(SITE, name), beside=beside))
    running = [asyncio.ensure_future(one.run()) for one in services]
    await anyio.sleep(0.1)
    for service, name in zip(services, ("b1", "b2"), strict=True):
        service.performer.load(
            track(name, (0, 0, 0, 4), (8, 12, 0, 5)).to_bytes(),
            "hover",
            Neighbours("show", name, 3.0, 1),
        )
    services[0].performer._start_at = anyio.current_time() + 60.0
    await anyio.sleep(1.0)
    missing = [one.performer.neighbours for one in services]
    assert [each and each.missing(anyio.current_time()) for each in missing] == [1, 0]
    for work in running:
        work.cancel()


async def test_what_is_too_long_for_a_piece_is_not_read(asked: Asked) -> None:
    long = Order(f"{9:032x}", "a1", "x" * 5000, 0, 0.0, SHOW + b'{"do": "tell"}')
    assert await asked.bus.ask(f"m100/{SITE}/a1/show", pack(long), timeout=1.0) == []
