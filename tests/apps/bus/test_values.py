"""Values in and out of the bus, over a session of zenoh that a test answers by hand."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any, cast

import pytest

from m100link.apps.bus.network import Question
from m100link.apps.bus.session import Opening, ZenohBus, _refused
from m100link.errors import M100Error, NoRouter, PortBusy, UsageError
from m100link.sim.clock import virtual_clock_loop
from tests import limits

zenoh: Any = pytest.importorskip("zenoh", reason="zenoh is not installed")


def sample(key: str, payload: bytes | None, attachment: bytes | None = None) -> Any:
    """What zenoh hands over: bytes that are copied when they are asked for."""

    class Bytes(bytes):
        def to_bytes(self) -> bytes:
            return bytes(self)

    made = [None if data is None else Bytes(data) for data in (payload, attachment)]
    return SimpleNamespace(key_expr=key, payload=made[0], attachment=made[1], kind="put")


class Declared:
    """A publisher, or what hears; ``sent`` are payload and attachment of each message."""

    def __init__(self) -> None:
        self.sent: list[tuple[bytes, bytes | None]] = []
        self.waiting: list[Any] = []  # in its ring
        self.ended = 0
        self.error: Exception | None = None
        self.matching_status = SimpleNamespace(matching=False)
        self.listener = SimpleNamespace(undeclare=lambda: None)
        self.matching: Callable[[Any], None] = lambda _: None

    def declare_matching_listener(self, matching: Callable[[Any], None]) -> Any:
        self.matching = matching
        return self.listener

    def put(self, payload: bytes, *, attachment: bytes | None) -> None:
        if self.error is not None:
            raise self.error
        self.sent.append((payload, attachment))

    def try_recv(self) -> Any:
        return self.waiting.pop(0) if self.waiting else None

    def undeclare(self) -> None:
        self.ended += 1


class Wire:
    """As much of a session as the bus asks for; what it was asked, and replies at their times."""

    def __init__(self, *replies: tuple[float, Any], ends_at: float | None = None) -> None:
        self.asked: list[tuple[str, str, dict[str, Any]]] = []
        self.heard: Callable[[Any], None] = lambda _: None
        self.publisher, self.held = Declared(), Declared()
        self.info = SimpleNamespace(routers_zid=list[str], peers_zid=list[str])
        self._replies, self._ends_at = replies, ends_at

    def get(self, key: str, handler: Any, **how: Any) -> None:
        self.asked.append(("get", key, how))
        loop = asyncio.get_running_loop()
        heard, end = handler
        for at, reply in self._replies:
            loop.call_later(at, heard, reply)
        if self._ends_at is not None:
            loop.call_later(self._ends_at, end)

    def liveliness(self) -> Any:
        return self

    def declare_subscriber(self, key: str, heard: Any, **how: Any) -> Any:
        self.asked.append(("subscribe", key, how))
        self.heard = heard
        return self.held

    def declare_queryable(self, key: str, heard: Any, **how: Any) -> Any:
        self.asked.append(("serve", key, how))
        self.heard = heard
        return Declared()

    def declare_publisher(self, key: str, **how: Any) -> Any:
        self.asked.append(("publish", key, how))
        return self.publisher


def run(wire: Wire, use: Callable[[ZenohBus], Any], largest: int = 8) -> tuple[Any, float]:
    """What comes of a bus over it, and the virtual seconds that it takes."""

    async def used() -> tuple[Any, float]:
        bus = ZenohBus(wire, largest)  # type: ignore[arg-type]
        handlers = SimpleNamespace(
            Callback=lambda *both: both, RingChannel=lambda depth: ("ring", depth)
        )
        kinds = {name: getattr(zenoh, name) for name in ("QueryTarget", "ConsolidationMode")}
        kinds |= {"CongestionControl": zenoh.CongestionControl, "Locality": zenoh.Locality}
        bus._zenoh = SimpleNamespace(  # type: ignore[assignment]
            handlers=handlers, ZError=zenoh.ZError, SampleKind=SimpleNamespace(PUT="put"), **kinds
        )
        loop = asyncio.get_running_loop()
        begin = loop.time()
        return await use(bus), loop.time() - begin

    with asyncio.Runner(loop_factory=virtual_clock_loop) as runner:
        found: tuple[Any, float] = runner.run(used())
        return found


def reply(key: str, payload: bytes, session: str | None = "z1") -> Any:
    who = None if session is None else SimpleNamespace(zid=session)
    return SimpleNamespace(ok=sample(key, payload), replier_id=who)


REFUSAL = SimpleNamespace(ok=None, replier_id=None)


@pytest.mark.parametrize(
    ("settling", "ends_at", "keys", "took_s"),
    [
        (b"", 3.0, ["a", "b", "c", "d"], 3.0),  # until zenoh says that no more come
        (b"", None, ["a", "b", "c", "d"], 8.0),  # or it does not say so, a second after its time
        (b"B", 3.0, ["a", "b", "c"], 0.6),  # 0.1 s behind the one that settles it
        (b"D", 3.0, ["a", "b", "c", "d"], 2.1),
        (b"D", 2.05, ["a", "b", "c", "d"], 2.05),
        (b"X", 3.0, ["a", "b", "c", "d"], 3.0),
    ],
)
def test_answers_are_waited_for_until_zenoh_ends_them_or_one_settles_it(
    settling: bytes, ends_at: float | None, keys: list[str], took_s: float
) -> None:
    replies = [
        (0.2, reply("a", b"A", None)),
        (0.4, REFUSAL),
        (0.5, reply("b", b"B")),
        (0.55, reply("c", b"123456789", "z2")),
        (2.0, reply("d", b"D")),
    ]
    wire = Wire(*replies, ends_at=ends_at)
    found, seconds = run(
        wire,
        lambda bus: bus.ask(
            "m/*",
            b"q",
            timeout=7.0,
            settles=(lambda one: one.payload == settling) if settling else None,
        ),
    )
    assert [one.key for one in found] == keys
    assert seconds == pytest.approx(took_s)
    assert [(one.payload, one.session) for one in found][:3] == [
        (b"A", ""),
        (b"B", "z1"),
        (b"", "z2"),  # longer than it reads
    ]


def test_what_zenoh_is_asked() -> None:
    """All who serve a key, and each of their answers."""

    async def ask(bus: ZenohBus) -> Any:
        await bus.ask("m/a", b"q", timeout=2.5, attachment=b"x")
        await bus.ask("m/a", timeout=2.5)
        return await bus.tokens("m/*", timeout=1.5)

    wire = Wire((0.1, reply("m/b", b"")), (0.2, reply("m/a", b"")), ends_at=0.3)
    assert run(wire, ask)[0] == ["m/b", "m/a"]
    every = {"target": zenoh.QueryTarget.ALL, "consolidation": zenoh.ConsolidationMode.NONE}
    assert wire.asked == [
        ("get", "m/a", {"payload": b"q", "attachment": b"x", "timeout": 2.5} | every),
        ("get", "m/a", {"payload": b"", "attachment": None, "timeout": 2.5} | every),
        ("get", "m/*", {"timeout": 1.5}),
    ]


def test_a_session_that_has_ended_is_not_asked() -> None:
    class Ended(Wire):
        def get(self, *_: Any, **__: Any) -> None:
            raise zenoh.ZError("closed")

    assert run(Ended(), lambda bus: bus.ask("m/a", timeout=2.5)) == ([], 0.0)


def test_an_outlet_sends_until_it_is_closed_and_knows_who_listens() -> None:
    async def publish(bus: ZenohBus) -> None:
        bus.publish("m/b", within=0.02).put_later(bytes, b"0")
        assert wire.publisher.sent == []
        await asyncio.sleep(0.021)
        assert wire.publisher.sent == [(b"0", None)]
        wire.publisher = Declared()
        outlet, declared = bus.publish("m/a"), wire.publisher
        wanted = []
        outlet.put(b"1", b"x")
        for is_matching in (True, False):
            wanted.append(outlet.is_wanted())
            declared.matching(SimpleNamespace(matching=is_matching))
        wanted.append(outlet.is_wanted())
        declared.matching(SimpleNamespace(matching=True))
        declared.error = zenoh.ZError("the session has ended")
        outlet.put(b"2")
        outlet.close()
        outlet.close()
        outlet.put(b"3")
        assert (declared.sent, declared.ended) == ([(b"1", b"x")], 1)
        assert [*wanted, outlet.is_wanted()] == [False, True, False, False]

    wire = Wire()
    run(wire, publish)
    drop = zenoh.CongestionControl.DROP
    elsewhere = {"congestion_control": drop, "allowed_destination": zenoh.Locality.REMOTE}
    assert wire.asked == [("publish", key, elsewhere) for key in ("m/b", "m/a")]


def test_an_outlet_knows_who_listened_before_it() -> None:
    class Listened(Wire):
        def declare_publisher(self, key: str, **how: Any) -> Any:
            self.publisher.matching_status.matching = True
            return self.publisher

    async def publish(bus: ZenohBus) -> bool:
        return bus.publish("m/a").is_wanted()

    assert run(Listened(), publish)[0] is True


def test_what_is_heard_is_handed_over_with_its_key_up_to_its_greatest_length() -> None:
    found: list[Any] = []

    async def hear(bus: ZenohBus) -> None:
        bus.subscribe("m/*", lambda key, payload: found.append((key, payload)))
        for number in (0, 8, 9):
            wire.heard(sample("m/a", bytes(number)))
        bus.watch("m/*/live", lambda key, is_there: found.append((key, is_there)))
        for kind in ("put", "delete"):
            wire.heard(SimpleNamespace(key_expr="m/b/live", kind=kind))
        bus.serve("m/c", found.append, is_first=lambda one: one.payload == b"stop")
        for payload in (b"go", b"stop"):
            wire.heard(
                SimpleNamespace(
                    key_expr="m/c",
                    payload=sample("", payload).payload,
                    attachment=sample("", b"a").payload,
                    drop=lambda: found.append("dropped"),
                    reply=lambda *what, **more: found.append((*what, more)),
                )
            )
        await asyncio.sleep(0.01)
        asked = [one for one in found if isinstance(one, Question)]
        assert [(one.key, one.payload, one.attachment) for one in asked] == [
            ("m/c", b"stop", b"a"),
            ("m/c", b"go", b"a"),
        ]
        asked[0].answer("m/c", b"yes", b"z")

    wire = Wire()
    run(wire, hear)
    assert [what for what in found if not isinstance(what, Question)] == [
        *(("m/a", b""), ("m/a", bytes(8)), ("m/a", b"")),
        *(("m/b/live", True), ("m/b/live", False)),
        *(("m/c", b"yes", {"attachment": b"z"}), "dropped"),
    ]
    assert wire.asked[1] == ("subscribe", "m/*/live", {"history": True}), "also who is there before"


def test_what_may_wait_is_taken_from_a_ring_every_so_often() -> None:
    found: list[Any] = []

    async def hear(bus: ZenohBus) -> None:
        held = bus.subscribe("m/*", lambda *what: found.append(what), depth=4, within=0.02)
        wire.held.waiting = [sample("m/a", b"1"), sample("m/b", bytes(9))]
        await asyncio.sleep(0.019)
        assert found == []
        await asyncio.sleep(0.002)
        assert found == [("m/a", b"1"), ("m/b", b"")]
        held.close()
        wire.held.waiting = [sample("m/a", b"2")]
        await asyncio.sleep(0.1)
        assert (len(found), wire.held.ended) == (2, 1)

    wire = Wire()
    run(wire, hear)
    assert cast(Any, wire.heard) == ("ring", 4)


@pytest.mark.parametrize(
    ("routers", "peers", "is_alone"), [([], [], True), (["r"], [], False), ([], ["p"], False)]
)
def test_a_session_without_router_and_peer_is_alone(
    routers: list[str], peers: list[str], is_alone: bool
) -> None:
    async def look(bus: ZenohBus) -> bool:
        return bus.is_alone()

    wire = Wire()
    wire.info = SimpleNamespace(routers_zid=lambda: routers, peers_zid=lambda: peers)
    assert run(wire, look)[0] is is_alone


@pytest.mark.parametrize(
    ("mode", "text", "kind", "seen", "remedy"),
    [
        ("client", "nobody at /src/a.rs:7", NoRouter, "no router answered: nobody", "start one"),
        ("router", "no such host", UsageError, "no router can be here: no such host", "look"),
        ("router", "address in use", PortBusy, "no router can be here: address in use", "look"),
        ("peer", "address in use", UsageError, "no session of zenoh: address in use", "look"),
        ("client", "in use", NoRouter, "no router answered: in use", "start one"),
    ],
)
def test_a_session_is_refused_by_its_mode_with_its_remedy(
    mode: str, text: str, kind: type[M100Error], seen: str, remedy: str
) -> None:
    opening = Opening("a test", "x", {}, remedies={"client": "start one", "": "look"})
    error = _refused(ValueError(text), mode, opening)
    assert (type(error), error.seen, error.remedy) == (kind, seen, remedy)


def test_each_limit_is_as_agreed() -> None:
    assert limits.differences("apps/bus") == []
