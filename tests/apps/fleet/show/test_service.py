"""What an agent answers to questions about a show, whatever they are."""

from __future__ import annotations

import asyncio
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import anyio
import pytest

from m100link.apps.agent.messages import MessageError
from m100link.apps.fleet import payloads
from m100link.apps.fleet.keys import Keys
from m100link.apps.fleet.payloads import (
    Asked,
    AskShow,
    LeaveShow,
    LoadTrack,
    OrderMessage,
    OrderReply,
    Outcome,
    SendTrack,
    ShowCard,
    ShowStage,
    TakePlace,
    pack,
    unpack,
)
from m100link.apps.fleet.show.plan.conflicts import Neighbours, by_speed
from m100link.apps.fleet.show.service import Beside, ShowService
from m100link.sim.vehicle.settings import AircraftSettings
from m100link.sim.virtual import VirtualAircraft
from tests.apps.fleet.conftest import SITE, Rig, anyio_backend, rig
from tests.apps.fleet.show.shows import ORIGIN, track

__all__ = ["anyio_backend", "rig"]

pytestmark = pytest.mark.anyio

FLOWN = track("a1", (0, 0, 0, 4), (8, 12, 0, 5))
PIECE = SendTrack("", 0, FLOWN.to_bytes())
LOADS = '{"kind":"LoadTrack","run":"","leave":%s,"show":"%s","least_m":%s,"others":0}'
LOAD, PLACE = LoadTrack("", "hover"), TakePlace("")


def an_order(wanted: Asked, number: int, clock: float, name: str = "a1") -> OrderMessage:
    return OrderMessage(f"{number:032x}", SITE, name, "anna", 0, 0.0, wanted, clock)


def stage(reply: OrderReply) -> ShowStage | None:
    return None if reply.show is None else reply.show.stage


class Conductor:
    """A service, and somebody who asks it."""

    def __init__(self, rig: Rig) -> None:
        self.rig = rig
        self.bus = rig.network.session()

    async def come(self) -> None:
        settings = AircraftSettings(latitude_deg=ORIGIN[0], longitude_deg=ORIGIN[1])
        one = await self.rig.aircraft("a1", virtual=VirtualAircraft(seed=5, settings=settings))
        self.service = ShowService(one.client, one.bus, Keys(SITE, "a1"), "run")
        self.running = asyncio.ensure_future(self.service.run())
        await anyio.sleep(0.1)

    async def ask(self, payload: bytes) -> OrderReply:
        [answer] = await self.bus.ask(f"m100/{SITE}/a1/show", payload, timeout=1.0)
        reply: OrderReply = unpack(OrderReply, answer.payload)
        return reply

    async def order(self, wanted: Asked, number: int = 1, name: str = "a1") -> OrderReply:
        return await self.ask(pack(an_order(wanted, number, anyio.current_time(), name)))


@pytest.fixture
async def asked(rig: Rig) -> Any:
    made = Conductor(rig)
    await made.come()
    yield made
    made.running.cancel()


async def test_where_it_stands_is_reported_with_every_answer(asked: Conductor) -> None:
    reply = await asked.order(AskShow(""))
    assert reply.outcome is Outcome.OK
    assert reply.show == ShowCard(ShowStage.EMPTY, "", 0.0, "")
    assert (await asked.order(PIECE, 3)).outcome is Outcome.OK
    reply = await asked.order(LOAD, 2)
    assert stage(reply) is ShowStage.LOADED
    assert reply.show is not None
    assert reply.show.digest == FLOWN.digest
    assert reply.clock == pytest.approx(anyio.current_time(), abs=0.1)


@pytest.mark.parametrize(
    ("is_landing", "expected"), [(True, ShowStage.FLYING), (False, ShowStage.FLOWN)]
)
async def test_a_show_is_flown_when_its_landing_has_ended(
    asked: Conductor, monkeypatch: pytest.MonkeyPatch, is_landing: bool, expected: ShowStage
) -> None:
    performer = asked.service.performer
    performer.stage = ShowStage.FLOWN
    monkeypatch.setattr(type(performer), "is_landing", property(lambda _: is_landing))
    assert stage(await asked.order(AskShow(""))) is expected


async def test_an_order_that_the_network_brings_twice_is_done_once(asked: Conductor) -> None:
    await asked.order(PIECE, 4)
    await asked.order(LOAD, 1)
    assert (await asked.order(PLACE, 2)).outcome is Outcome.OK
    again = await asked.order(PLACE, 2)
    assert (again.outcome, stage(again)) == (Outcome.OK, ShowStage.PLACING)
    assert (await asked.order(PLACE, 3)).outcome is Outcome.REFUSED
    assert (await asked.order(PLACE, 3)).outcome is Outcome.REFUSED


async def test_another_order_of_an_id_that_was_heard_is_an_order_of_its_own(
    asked: Conductor,
) -> None:
    """A stranger hears the id of an order; the answer to what he asks by it is not the other's."""
    await asked.order(PIECE, 4)
    assert (await asked.order(AskShow(""), 1)).outcome is Outcome.OK
    assert stage(await asked.order(LOAD, 1)) is ShowStage.LOADED


@pytest.mark.parametrize(
    "wanted",
    [
        "",
        "show",
        "{",
        "[1]",
        "\xff",
        "[" * 1500,
        "{}",
        '{"kind": null}',
        '{"kind": ["LoadTrack"]}',
        '{"kind": "Dance", "run": ""}',
        '{"kind": "ShowOrder", "run": ""}',
        '{"kind": "LoadTrack"}',
        '{"kind": "TakeOff"}',
        '{"kind": "SendTrack", "run": "", "at": 0, "data": 3}',
        '{"kind": "SendTrack", "run": "", "at": 0, "data": "xy"}',
        '{"kind": "StartShow", "run": "", "digest": "", "at": "soon", "bound": 0}',
        '{"kind": "StartShow", "run": "", "digest": "", "at": 1e400, "bound": 0}',
        '{"kind": "StartShow", "run": "", "digest": "", "at": 1e300, "bound": 1e300}',
        LOADS % ("[]", "", "0"),
        LOADS % ('"home"', "", "0"),
        LOADS % ('"land"', "s", "-1e300"),
        '{"kind": "SendTrack", "run": "", "at": 1, "data": "AAAA"}',
        '{"kind": "SendTrack", "run": "", "at": -1, "data": "AAAA"}',
        '{"kind": "SendTrack", "run": "", "at": 9007199254740991, "data": "AAAA"}',
    ],
)
async def test_nonsense_is_refused_and_breaks_nothing(asked: Conductor, wanted: str) -> None:
    good = an_order(PLACE, 1, anyio.current_time())
    document = good.document.replace(b'{"kind":"TakePlace","run":""}', wanted.encode("latin-1"))
    assert (await asked.ask(pack(good.sealed(document)))).outcome is Outcome.REFUSED
    assert (await asked.order(AskShow(""), 2)).outcome is Outcome.OK


async def test_a_track_comes_in_pieces_in_their_order(asked: Conductor) -> None:
    data, numbers = FLOWN.to_bytes(), iter(range(100))

    async def piece(at: int, end: int) -> Outcome:
        return (await asked.order(SendTrack("", at, data[at:end]), next(numbers))).outcome

    assert await piece(0, 50) is Outcome.OK
    assert await piece(60, 70) is Outcome.REFUSED, "something is missing before it"
    assert await piece(50, 80) is Outcome.OK
    assert await piece(50, 90) is Outcome.OK, "sent anew: its answer was lost"
    assert await piece(90, len(data)) is Outcome.OK
    reply = await asked.order(LOAD, next(numbers))
    assert reply.show is not None
    assert reply.show.digest == FLOWN.digest
    far = SendTrack("", 0, bytes(900))
    assert (await asked.order(far, next(numbers))).outcome is Outcome.OK
    assert (await asked.order(LOAD, next(numbers))).outcome is Outcome.REFUSED


@pytest.mark.parametrize(
    ("at", "size", "is_taken"),
    [
        (0, 10, True),
        (100, 10, True),
        (50, 1, True),
        (101, 1, False),
        (-1, 10, False),
        (0, 321_024, True),
        (0, 321_025, False),
        (100, 320_925, False),
    ],
)
async def test_a_piece_of_a_track_joins_those_before_it(at: int, size: int, is_taken: bool) -> None:
    """A track of 10,000 points has 320,000 bytes, and what stands before them."""
    service = object.__new__(ShowService)
    service._pieces = bytearray(range(100))
    if is_taken:
        service._take_piece(at, b"\xff" * size)
        assert service._pieces == bytes(range(100))[:at] + b"\xff" * size
    else:
        with pytest.raises(MessageError, match=rf"at {at} comes behind 100 bytes"):
            service._take_piece(at, b"\xff" * size)
        assert service._pieces == bytes(range(100))


@pytest.mark.parametrize(
    ("key", "version", "is_heard"),
    [
        ("m100/field/a2/place", payloads.VERSION, True),
        ("m100/field/a3/place", payloads.VERSION, False),  # somebody else tells it
        ("m100/field/a2/place", payloads.VERSION - 1, False),
        ("m100/field/a2/place", payloads.VERSION + 1, False),
    ],
)
async def test_a_place_counts_by_who_tells_it(key: str, version: int, is_heard: bool) -> None:
    heard: list[tuple[str, float]] = []
    service = object.__new__(ShowService)
    hear = SimpleNamespace(
        neighbours=object(), hear=lambda ahead: heard.append((ahead.name, service._client.now))
    )
    service.performer = cast(Any, hear)
    service._client = cast(Any, SimpleNamespace(now=7.5))
    place = by_speed("show", "a2", 1.0, (1.0, 2.0, 3.0), (0.0, 0.0, 0.0)).to_bytes()
    service._on_place(key, bytes([version]) + place)
    service._on_place(key, bytes([version]) + b"[]")
    assert heard == [("a2", 7.5)] * is_heard


async def test_what_is_no_order_or_for_another_aircraft_is_refused(asked: Conductor) -> None:
    assert (await asked.ask(b"\x01{}")).outcome is Outcome.REFUSED
    assert (await asked.ask(b"")).outcome is Outcome.REFUSED
    assert (await asked.order(AskShow(""), name="a2")).outcome is Outcome.NOT_ALLOWED


async def test_what_it_remembers_has_an_end(asked: Conductor) -> None:
    for number in range(1100):
        await asked.order(AskShow(""), number)
    assert len(asked.service._known) == 1024


@pytest.mark.parametrize("made_at", [0.0, None])
async def test_a_take_off_that_nobody_waits_for_is_not_begun(
    asked: Conductor, made_at: float | None
) -> None:
    """It waited before a frozen agent, or does not say since when."""
    await asked.order(PIECE, 4)
    await asked.order(LOAD, 1)
    clock = anyio.current_time() if made_at is None else made_at
    late = an_order(PLACE, 9, clock)
    await anyio.sleep(6.0)
    reply = await asked.ask(pack(late))
    assert reply.outcome is Outcome.REFUSED
    assert reply.fault is not None
    assert ("older than 5 s" if made_at is None else "of unknown age") in reply.fault.seen
    assert stage(reply) is ShowStage.LOADED
    assert (await asked.order(PLACE, 10)).outcome is Outcome.OK


@pytest.mark.parametrize("how", ["leave", "stop"])
async def test_what_was_ordered_before_it_ended_and_comes_later_does_not_take_off(
    asked: Conductor, how: str
) -> None:
    """Each try of a conductor is an order of its own: all it sent may come behind its last word."""
    await asked.order(PIECE, 1)
    made = anyio.current_time()
    if how == "leave":
        await asked.order(LeaveShow(""), 2)
    else:
        await (await asked.rig.pilot("anybody"))["a1"].stop()
    await anyio.sleep(1.0)
    orders: list[Asked] = [LOAD, PLACE]
    for number, wanted in enumerate(orders, start=10):
        late = an_order(wanted, number, made - 0.01)
        reply = await asked.ask(pack(late))
        assert reply.fault is not None
        assert "was asked for after it was made" in reply.fault.seen
    await asked.order(LOAD, 20)
    reply = await asked.ask(pack(replace(late, id=f"{30:032x}")))
    assert stage(reply) is ShowStage.LOADED
    assert (await asked.order(PLACE, 21)).outcome is Outcome.OK


async def test_the_conductor_of_another_show_does_nothing_to_it(asked: Conductor) -> None:
    """Not even that it waits for the second one where the first one has gone."""
    await asked.order(replace(PIECE, run="a"), 1)
    await asked.order(replace(LOAD, run="a"), 2)
    others: list[Asked] = [replace(PIECE, run="b"), replace(LOAD, run="b")]
    for number, wanted in enumerate([*others, TakePlace("b"), LeaveShow("b")], start=3):
        reply = await asked.order(wanted, number)
        assert reply.fault is not None
        assert "in a show of another conductor" in reply.fault.seen
    assert (await asked.order(TakePlace("a"), 10)).outcome is Outcome.OK
    for number in range(20, 28):
        await anyio.sleep(1.4)
        reply = await asked.order(AskShow("b"), number)
        assert reply.outcome is Outcome.OK
    assert reply.show is not None
    assert "the conductor was silent" in reply.show.why
    assert (await asked.order(replace(PIECE, run="b"), 30)).outcome is Outcome.OK


async def test_a_track_whose_conductor_is_gone_keeps_nobody_out(asked: Conductor) -> None:
    await asked.order(replace(PIECE, run="a"), 1)
    await asked.order(replace(LOAD, run="a"), 2)
    assert (await asked.order(replace(PIECE, run="b"), 3)).outcome is Outcome.REFUSED
    await anyio.sleep(11.0)
    assert (await asked.order(replace(PIECE, run="b"), 4)).outcome is Outcome.OK
    assert (await asked.order(replace(LOAD, run="b"), 5)).outcome is Outcome.OK
    assert (await asked.order(TakePlace("a"), 6)).outcome is Outcome.REFUSED


async def test_two_that_one_process_serves_hear_each_other(asked: Conductor) -> None:
    """By one session, which does not hear itself: in a show they did not look at each other."""
    beside, bus = Beside(), asked.rig.network.session()
    settings = AircraftSettings(latitude_deg=ORIGIN[0], longitude_deg=ORIGIN[1])
    services = []
    for name in ("b1", "b2"):
        one = await asked.rig.aircraft(name, virtual=VirtualAircraft(seed=5, settings=settings))
        services.append(ShowService(one.client, bus, Keys(SITE, name), "run", beside=beside))
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


async def test_what_is_too_long_for_a_piece_is_not_read(asked: Conductor) -> None:
    long = replace(an_order(AskShow(""), 9, 0.0), by="x" * 4096)
    assert await asked.bus.ask(f"m100/{SITE}/a1/show", pack(long), timeout=1.0) == []


async def test_a_place_that_cannot_be_told_ends_no_service(
    asked: Conductor, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its end would take the aircraft out of this show and, in silence, out of all later ones."""

    def fail() -> None:
        raise MemoryError

    monkeypatch.setattr(asked.service.performer, "ahead", fail)
    await anyio.sleep(1.0)
    assert (await asked.order(AskShow(""))).outcome is Outcome.OK
    assert not asked.running.done()
