"""An adversary on a router without rules makes no operator believe what no aircraft did.

It hears every byte, answers first and in any name, says again, changes, delays and drops what
others say. It has a certificate and key of the authority, of another aircraft. Everything that it
does is drawn.
"""

from __future__ import annotations

import asyncio
import random
import time
from collections.abc import Callable
from contextvars import ContextVar
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import anyio
import pytest
from cryptography import x509
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat

from m100link.apps.agent import orders
from m100link.apps.bus.network import QueryAnswer, Question
from m100link.apps.fleet import pki
from m100link.apps.fleet.client import Fleet
from m100link.apps.fleet.identity import Rights, Signer
from m100link.apps.fleet.keys import Keys
from m100link.apps.fleet.payloads import (
    VERSION,
    AskShow,
    Card,
    Half,
    MissionCard,
    OrderMessage,
    OrderReply,
    Outcome,
    Progress,
    ShowCard,
    ShowStage,
    pack,
    unpack,
)
from m100link.apps.fleet.revocations import Revocations, RevocationService, Revoked, in_force
from m100link.apps.fleet.show.plan.conflicts import ConflictMonitor, Neighbours
from m100link.apps.fleet.show.service import ShowService
from m100link.apps.fleet.signing import Seal, SealedBus, _parts, verifying
from m100link.errors import M100Error, OutcomeUnknown, UsageError
from tests.apps.bus.memory import MemoryBus, MemoryNetwork
from tests.apps.fleet.conftest import SITE, OnBoard, Rig

pytestmark = pytest.mark.anyio

OPERATORS = {name: Signer(name, name[0].encode() * 32) for name in ("ada", "bo", "cy", "di", "ed")}
RIGHTS = Rights.parse(
    "".join(
        f'[identity.{name}]\npublic_key = "{one.public_key.hex()}"\nfly = ["*"]\n'
        for name, one in OPERATORS.items()
    )
)
NAMES = ("a1", "a2")
ACT: ContextVar[list[OrderMessage]] = ContextVar("what one act of an operator sent")
AT_ONCE = 10
"""Acts of each operator in one round: what lasts is that the aircraft fly."""


@dataclass(frozen=True)
class Keyring:
    """Keys of a fleet, and what the adversary has: the key of a3, and an authority of its own."""

    authority: Revocations
    seals: dict[str, Seal]  # of a1, a2 and a3
    false: Seal  # of a1, of the adversary's authority
    certificates: dict[str, bytes]

    def certificate(self, name: str) -> x509.Certificate:
        return x509.load_der_x509_certificate(self.certificates[name])


def keyring(folder: Path) -> Keyring:
    now = datetime.now(UTC)
    for place, names in ((folder / "ours", ("a1", "a2", "a3")), (folder / "its", ("a1",))):
        pki.init(place, now=now)
        for name in names:
            pki.issue(place, pki.Kind.AGENT, name, now=now)
    seals = {name: Seal.read(folder / "ours", name) for name in ("a1", "a2", "a3")}
    authority = Revocations.of_folder(folder / "ours")
    certificates = {name: seal._certificate for name, seal in seals.items()}
    return Keyring(authority, seals, Seal.read(folder / "its", "a1"), certificates)


@pytest.fixture(scope="module")
def keys(tmp_path_factory: pytest.TempPathFactory) -> Keyring:
    return keyring(tmp_path_factory.mktemp("keys"))


# -- what the network does, by the adversary's will ------------------------------------------------


class HostileNetwork(MemoryNetwork):
    """Each message between two others may be lost, late, or come twice."""

    def __init__(self, seed: int) -> None:
        super().__init__(seed)
        self.chance = random.Random(seed)
        self.mine: set[MemoryBus] = set()  # sessions of the adversary: nothing of it is lost
        self.drops = self.delays = 0.0

    def carry(self, sender: MemoryBus, taker: MemoryBus, deliver: Callable[[], None]) -> None:
        if sender in self.mine or taker in self.mine or sender is taker:
            deliver() if sender in self.mine else super().carry(sender, taker, deliver)
            return
        if self.chance.random() < self.drops:
            return
        late = self.chance.uniform(0.0, 4.0) if self.chance.random() < self.delays else 0.0
        if self.chance.random() < 0.05:  # comes twice
            super().carry(sender, taker, deliver)
        if late:
            asyncio.get_running_loop().call_later(
                late, lambda: super(HostileNetwork, self).carry(sender, taker, deliver)
            )
        else:
            super().carry(sender, taker, deliver)


class Adversary:
    """Answers first, in the name of each aircraft; publishes in it; shows its tokens."""

    def __init__(self, network: HostileNetwork, keys: Keyring, seed: int) -> None:
        self.network, self.keys = network, keys
        self.chance = random.Random(seed)
        self.bus = network.session()
        network.mine.add(self.bus)
        self.answers: list[tuple[str, bytes]] = []  # of aircraft, as they went over the network
        self.said: list[tuple[str, bytes]] = []  # of aircraft, that nobody asked for
        self.boots: dict[str, str] = {}
        self.lies: set[bytes] = set()
        self.heard: list[bytes] = []
        self.agents: dict[str, MemoryBus] = {}  # sessions of the agents
        self.is_active = False
        for name in NAMES:
            own = Keys(SITE, name)
            for key in (
                own.command,
                own.lease,
                own.status(),
                own.state,
                own.mission,
                own.show,
                own.revoked,
            ):
                self.bus.serve(key, self._asked)
            for key in (own.state, own.event, own.told, own.place):
                self.bus.subscribe(key, lambda key, payload: self.said.append((key, payload)))

    def tap_bus(self, name: str, bus: MemoryBus) -> None:
        """Hear what an agent answers: the wire between it and the router is the adversary's."""
        self.agents[name] = bus
        serve = bus.serve

        def served(key: str, take: Callable[[Question], None], **more: Any) -> Any:
            def taken(question: Question) -> None:
                def answer(key: str, payload: bytes, *rest: Any) -> None:
                    self.answers.append((key, payload))
                    self.heard.append(payload)
                    question.answer(key, payload, *rest)

                take(replace(question, answer=answer))

            return serve(key, taken, **more)

        bus.serve = served  # type: ignore[method-assign] # its wire

    def _reply(self, key: str, question: Question) -> bytes:
        """What it would like to be believed, without a seal."""
        name, what = key.split("/")[2], key.split("/")[3]
        boot = self.boots.get(name, "")
        if self.chance.random() < 0.2:
            boot = "12345678"
        if what == "state":
            return pack(Card(name, boot, 2e9, "connected", phase="in air", height_m=99.0))
        if what == "mission":
            return pack(MissionCard(name, boot, digest="ff"))
        try:
            order: OrderMessage | None = unpack(OrderMessage, question.payload)
        except M100Error:
            order = None
        asked = question.key.rpartition("/")[2] if order is None else order.id
        outcome = self.chance.choice([Outcome.OK, Outcome.OK, Outcome.REFUSED])
        progress = self.chance.choice([Progress.DONE] * 6 + [Progress.RUNNING, Progress.NEVER])
        return pack(
            OrderReply(
                asked,
                name,
                boot,
                progress,
                outcome,
                number=self.chance.randint(1, 9),
                key=Half().public,
                clock=self.chance.choice([0.0, 1e6, asyncio.get_running_loop().time()]),
                order=b"" if order is None else order.digest,
                show=ShowCard(ShowStage.LEFT, "", 0.0, "forged") if what == "show" else None,
            )
        )

    def forged(self, key: str, question: Question | None, plain: bytes) -> list[tuple[str, bytes]]:
        """One lie under a key."""
        name = key.split("/")[2]
        other = "a2" if name == "a1" else "a1"
        old = [
            (was, payload)
            for was, payload in (self.answers if question is not None else self.said)[-60:]
            if was.split("/")[2] in (name, other)
        ]
        match self.chance.randrange(8):
            case 0:
                return [(key, plain)]
            case 1:  # by another authority
                return [(key, self.keys.false.seal(key, plain, question))]
            case 2:  # by the key of a3, which is inside the rules
                return [(key, self.keys.seals["a3"].seal(key, plain, question))]
            case 3:  # the certificate is right, and the key is not
                sealed = self.keys.seals["a3"].seal(key, plain, question)
                has, own = self.keys.certificates["a3"], self.keys.certificates[name]
                changed = sealed.replace(has, own)
                length = len(own).to_bytes(2, "big")
                return [(key, changed[:1] + length + changed[3:])]
            case 4 if old:  # said before, of either aircraft
                return [(key, self.chance.choice(old)[1])]
            case 5 if old:  # said before, and changed
                _, payload = self.chance.choice(old)
                inner = _parts(payload)[-1]
                return [(key, payload[: len(payload) - len(inner)] + plain)]
            case 6 if old:  # said before, with one bit of its other parts changed
                data = bytearray(self.chance.choice(old)[1])
                at = self.chance.randrange(len(data))
                data[at] ^= 1 << self.chance.randrange(8)
                return [(key, bytes(data))]
            case _:  # several at once
                sealed = self.keys.seals["a3"].seal(key, plain, question)
                return [(key, plain), (key, sealed), (key.replace(name, other), plain)]

    def _asked(self, question: Question) -> None:
        self.heard.append(question.payload)
        if not self.is_active or self.chance.random() < 0.2:
            # It holds the question open, or says nothing at once.
            question.drop() if self.chance.random() < 0.7 else None
            return
        keys = [question.key]
        if "*" in question.key:
            star = question.key.endswith("*")
            keys = [question.key.replace("*", name) for name in (["0" * 32] if star else NAMES)]
        if self.chance.random() < 0.5:  # under the session of the agent
            agent = self.agents.get(keys[0].split("/")[2])
            self.bus._number = agent._number if agent else self.bus._number
        for key in keys:
            for lie in self.forged(key, question, self._reply(key, question)):
                self.lies.add(lie[1])
                question.answer(*lie)

    async def publish(self) -> None:
        """States, events and places in the name of both, again and again, while it is active."""
        outlets = {
            key: self.bus.publish(key)
            for name in NAMES
            for own in (Keys(SITE, name),)
            for key in (own.state, own.event, own.told, own.place)
        }
        while True:
            await asyncio.sleep(self.chance.uniform(0.05, 0.5))
            if not self.is_active:
                continue
            key = self.chance.choice(list(outlets))
            name = key.split("/")[2]
            boot = self.chance.choice([self.boots.get(name, ""), "87654321"])
            plain = pack(Card(name, boot, 2e9, "connected", holder="eve", fence=77))
            for its, lie in self.forged(key, None, plain):
                if its in outlets:
                    outlets[its].put(lie)


# -- operators, and what they believe --------------------------------------------------------------


class Done:
    """What the agent of an aircraft did: outcome and height by the id of the order."""

    def __init__(self, one: OnBoard, done: dict[str, tuple[Outcome, float, str]]) -> None:
        agent = one.fleet_agent
        end = agent._order_cache.end

        def ended(reply: OrderReply, now: float) -> None:
            done[reply.id] = reply.outcome, one.height, agent.boot
            end(reply, now)

        agent._order_cache.end = ended  # type: ignore[method-assign] # what it really did


@dataclass
class Told:
    """What the draw found."""

    cases: int = 0
    ok: int = 0
    other: int = 0
    forged: int = 0  # lies that came to an operator
    false_ok: int = 0
    false_lease: int = 0
    false_card: int = 0
    unnamed: int = 0  # operators to whom lies came, and who were not told
    secrets: int = 0  # secrets of leases that went over the network


class Stage:
    """Two aircraft, five operators and the adversary."""

    def __init__(self, rig: Rig, keys: Keyring, seed: int, *, is_sealed: bool = True) -> None:
        self.rig, self.keys, self.is_sealed = rig, keys, is_sealed
        self.network = rig.network = HostileNetwork(seed)
        self.chance = random.Random(seed + 1)
        self.adversary = Adversary(self.network, keys, seed + 2)
        self.done: dict[str, tuple[Outcome, float, str]] = {}
        self.on_board: dict[str, OnBoard] = {}
        self.told = Told()
        self.granted: dict[str, set[tuple[int, str]]] = {name: set() for name in NAMES}
        self.boots: dict[str, set[str]] = {name: set() for name in NAMES}
        self.pilots: dict[str, Fleet] = {}
        self.came = dict.fromkeys(OPERATORS, 0)  # lies that came to each

    async def fly_in(self, name: str, before: OnBoard | None = None) -> None:
        options: dict[str, Any] = {"verify": verifying(RIGHTS, [name], self.rig.utc)}
        if self.is_sealed:
            options |= {"seal": self.keys.seals[name], "authority": self.keys.authority}
        network, session = self.network, MemoryNetwork.session

        def tapped() -> MemoryBus:
            bus = session(network)
            self.adversary.tap_bus(name, bus)
            return bus

        network.session = tapped  # type: ignore[method-assign] # of the agent that begins now
        try:
            made = await (
                self.rig.aircraft(name, **options) if before is None else before.next(**options)
            )
        finally:
            del network.session
        self.on_board[name] = made
        self.adversary.boots[name] = made.fleet_agent.boot
        self.boots[name].add(made.fleet_agent.boot)
        Done(made, self.done)

        service = ShowService(made.client, made.spoken, Keys(SITE, name), made.fleet_agent.boot)
        revoked = RevocationService(
            made.spoken,
            Keys(SITE, name),
            made.fleet_agent.boot,
            self.keys.authority,
            shut_out=(),
            note=lambda *_: None,
        )
        for work in (service.run(), revoked.run()):
            made.agent.background.spawn(work, "beside the agent")
        grant = made.fleet_agent._orders._granted

        async def granted(order: OrderMessage, asked: Any) -> Any:
            found = await grant(order, asked)
            lease = made.fleet_agent._orders.leases[found["number"]]
            self.granted[name].add((found["number"], lease.secret))
            return found

        made.fleet_agent._orders._granted = granted  # type: ignore[method-assign]

    async def operator(self, name: str) -> None:
        sign = OPERATORS[name]

        def signed(order: OrderMessage, token: str) -> OrderMessage:
            ACT.get().append(order)
            return sign(order, token)

        authority = self.keys.authority if self.is_sealed else None
        self.pilots[name] = fleet = await self.rig.pilot(
            name, authority=authority, sign=signed, patience=4.0
        )
        bus = fleet.bus
        inner = bus._bus if isinstance(bus, SealedBus) else bus
        assert isinstance(inner, MemoryBus)
        ask = inner.ask

        async def asked(key: str, payload: bytes = b"", **more: Any) -> Any:
            settles = more.get("settles")

            def hear(answer: Any) -> bool:
                self.came[name] += answer.payload in self.adversary.lies
                return bool(settles and settles(answer))

            return await ask(key, payload, **{**more, "settles": hear})

        inner.ask = asked  # type: ignore[method-assign] # what comes to an operator

    def _has_done(self, name: str, kind: type[orders.Order]) -> bool:
        """Whether an aircraft did what was asked of it in this act."""
        for one in ACT.get():
            outcome, height, _ = self.done.get(one.id, (Outcome.UNKNOWN, 0.0, ""))
            if one.aircraft == name and isinstance(one.order, kind) and outcome is Outcome.OK:
                if kind is orders.Land:
                    return height < 0.1
                return kind is not orders.TakeOff or height > 0.8
        return False

    async def act(self, who: str) -> None:
        """One operator asks for one thing, and what it believes is compared with what is so."""
        fleet, name = self.pilots[who], self.chance.choice(NAMES)
        ACT.set([])
        told, aircraft = self.told, fleet[name]
        told.cases += 1
        what = self.chance.choice(
            ["stop", "stop", "land", "take off", "lease", "card", "mission", "show", "revoked"]
        )
        try:
            match what:
                case "stop":
                    await aircraft.stop()
                    told.false_ok += not self._has_done(name, orders.Stop)
                case "land":
                    await aircraft.land()
                    told.false_ok += not self._has_done(name, orders.Land)
                case "take off":
                    await aircraft.take_off()
                    told.false_ok += not self._has_done(name, orders.TakeOff)
                case "lease":
                    async with aircraft.control() as control:
                        told.false_lease += control.proof not in self.granted[name]
                        await anyio.sleep(1.2)
                        told.false_lease += control.proof not in self.granted[name]
                case "card":
                    card = await aircraft.card()
                    late = self.rig.utc() - card.at
                    told.false_card += card.boot not in self.boots[name] or not 0.0 <= late < 8.0
                case "mission":
                    mission = await aircraft.mission()
                    told.false_card += bool(mission.digest) or mission.boot not in self.boots[name]
                case "show":
                    asked = AskShow("run of " + who)
                    reply = await fleet.asker(name).once(aircraft.keys.show, asked, within=2.0)
                    if reply is None or reply.outcome is not Outcome.OK:
                        raise OutcomeUnknown("no answer")
                    told.false_ok += reply.show is None or reply.show.stage is not ShowStage.EMPTY
                case "revoked":
                    told.false_ok += (await in_force(fleet.bus, aircraft.keys)).number != 0
            told.ok += 1
        except M100Error:
            told.other += 1

    async def round(self) -> None:
        """Each of the five asks once, and the adversary does its worst."""
        adversary, network, chance = self.adversary, self.network, self.chance
        network.drops = chance.choice([0.0, 0.0, 0.15])
        network.delays = chance.choice([0.0, 0.0, 0.2])
        adversary.is_active = True
        tokens = []
        for name in NAMES:
            if chance.random() < 0.2:
                whose = chance.choice([adversary.bus.session, adversary.agents[name].session])
                tokens.append(adversary.bus.declare(Keys(SITE, name).live_by(whose)))
        dead = chance.choice(NAMES) if chance.random() < 0.08 else ""
        if dead:
            self.on_board[dead].kill()
        before = {name: self.came[name] for name in OPERATORS}
        for fleet in self.pilots.values():
            if isinstance(fleet.bus, SealedBus):
                fleet.bus._warned_at.clear()
        try:
            async with asyncio.TaskGroup() as group:
                for who in list(OPERATORS) * AT_ONCE:
                    await anyio.sleep(chance.uniform(0.0, 0.1))
                    group.create_task(self.act(who))
        finally:
            adversary.is_active = False
            network.drops = network.delays = 0.0
            for token in tokens:
                token.close()
        for who, fleet in self.pilots.items():
            lies = self.came[who] - before[who]
            self.told.forged += lies
            is_named = isinstance(fleet.bus, SealedBus) and bool(fleet.bus._warned_at)
            self.told.unnamed += lies > 0 and not is_named
        heard = b"".join(adversary.heard)
        adversary.heard.clear()
        secrets = {secret for found in self.granted.values() for _, secret in found}
        self.told.secrets += sum(one.encode() in heard for one in secrets)
        if dead:
            await self.fly_in(dead, self.on_board[dead])


async def draw(rig: Rig, keys: Keyring, seed: int, cases: int, *, is_sealed: bool = True) -> Told:
    stage = Stage(rig, keys, seed, is_sealed=is_sealed)
    for name in NAMES:
        await stage.fly_in(name)
    for name in OPERATORS:
        await stage.operator(name)
    publishing = asyncio.create_task(stage.adversary.publish())
    try:
        while stage.told.cases < cases:
            await stage.round()
    finally:
        publishing.cancel()
    return stage.told


def clean(told: Told) -> None:
    """Nothing false was believed, no secret was told, and each operator who met a lie was told."""
    false = told.false_ok, told.false_lease, told.false_card, told.unnamed, told.secrets
    assert false == (0, 0, 0, 0, 0), told


@pytest.mark.parametrize("seed", [1])
async def test_no_operator_believes_an_adversary(rig: Rig, keys: Keyring, seed: int) -> None:
    told = await draw(rig, keys, seed, 50)
    clean(told)
    assert told.forged > 20
    assert told.ok >= 20, "and what aircraft do is believed"


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:Parsed a serial number which wasn't positive")  # of a lie
@pytest.mark.parametrize("seed", range(101, 121))
async def test_no_operator_believes_an_adversary_in_10_000_cases(
    rig: Rig, keys: Keyring, seed: int
) -> None:
    told = await draw(rig, keys, seed, 500)
    clean(told)
    assert told.ok > 200


@pytest.mark.slow
async def test_without_signatures_the_same_adversary_is_believed(rig: Rig, keys: Keyring) -> None:
    """What the draw is worth."""
    told = await draw(rig, keys, 1, 300, is_sealed=False)
    assert told.false_ok + told.false_card + told.false_lease > 0


# -- one by one -----------------------------------------------------------------------------------

A1 = Keys(SITE, "a1")


async def two(rig: Rig, keys: Keyring, **options: Any) -> tuple[OnBoard, Fleet]:
    """A sealed aircraft, and an operator who verifies."""
    seals: dict[str, Any] = {"seal": keys.seals["a1"], "authority": keys.authority}
    one = await rig.aircraft("a1", **seals, **options)
    return one, await rig.pilot("ada", authority=keys.authority)


async def test_who_has_the_key_and_disagrees_makes_the_outcome_unknown(
    rig: Rig, keys: Keyring
) -> None:
    one, ada = await two(rig, keys)
    thief = rig.network.session()

    def answer(question: Question) -> None:
        order: OrderMessage = unpack(OrderMessage, question.payload)
        boot = one.fleet_agent.boot
        said = OrderReply(order.id, "a1", boot, Progress.DONE, Outcome.REFUSED, order=order.digest)
        question.answer(A1.command, keys.seals["a1"].seal(A1.command, pack(said), question))

    thief.serve(A1.command, answer)
    assert (await ada.stop(["a1"]))["a1"].outcome is Outcome.UNKNOWN
    assert one.client.stopped_at > 0.0


async def test_a_revoked_aircraft_is_not_believed(
    rig: Rig, keys: Keyring, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    _, ada = await two(rig, keys)
    assert (await ada["a1"].card()).name == "a1"
    monkeypatch.setattr(keys.authority, "revoked", Revoked(1, {"a1": "2026-11-29"}))
    assert await ada.cards() == {}
    assert "somebody else speaks in the name of a1" in caplog.text
    assert "a1 is revoked since 2026-11-29" in caplog.text


async def test_a_stranger_who_is_silent_holds_up_no_answer(rig: Rig, keys: Keyring) -> None:
    _, ada = await two(rig, keys)
    rig.network.session().serve(A1.command, lambda _: None)
    began = anyio.current_time()
    assert (await ada.stop(["a1"]))["a1"].outcome is Outcome.OK
    assert anyio.current_time() - began < 0.2


async def test_a_state_that_was_heard_before_is_heard_once(rig: Rig, keys: Keyring) -> None:
    """Whatever the adversary recorded: of this run of the agent, or of one a year ago."""
    network, said, heard = rig.network, [], []
    a1, stranger = SealedBus(network.session(), {"a1": keys.seals["a1"]}), network.session()
    ada = SealedBus(network.session(), authority=keys.authority)
    stranger.subscribe(A1.state, lambda _key, payload: said.append(payload))
    outlet = a1.publish(A1.state)
    outlet.put(b"long ago")
    await anyio.sleep(0.1)
    a1.serve(A1.state, lambda question: question.answer(A1.state, b"now"))
    ada.subscribe(A1.state, lambda _key, payload: heard.append(payload))
    again = stranger.publish(A1.state)
    again.put(said[0])  # nothing is known of a1 yet: it is asked what is new
    await anyio.sleep(0.1)
    again.put(said[0])
    for text in (b"first", b"second"):
        outlet.put(text)
    await anyio.sleep(0.1)
    for old in list(said):
        again.put(old)
    await anyio.sleep(0.1)
    assert heard == [b"first", b"second"]


async def test_each_aircraft_is_asked_once_a_second_and_each_answer_may_settle_a_question(
    rig: Rig, keys: Keyring
) -> None:
    ada = SealedBus(rig.network.session(), authority=keys.authority)
    asked, outlets, settled = list[str](), list[Any](), list[bytes]()
    for name in NAMES:
        key = Keys(SITE, name).state
        bus = SealedBus(rig.network.session(), {name: keys.seals[name]})
        held = bus.serve(key, lambda question: asked.append(question.key))
        outlets.append((key, bus, bus.publish(key), held))
    ada.subscribe(Keys(SITE, "*").state, lambda *_: None)
    await anyio.sleep(2.0)
    for _ in range(3):
        for _, _, outlet, _ in outlets:
            outlet.put(b"of one that nobody knows")
            await anyio.sleep(0.02)
    assert asked == [Keys(SITE, name).state for name in NAMES]
    for key, bus, _, held in outlets:
        held.close()
        bus.serve(key, lambda question, key=key: question.answer(key, key.encode()))

    def settles(answer: QueryAnswer) -> bool:
        settled.append(answer.payload)
        return False

    await ada.ask(Keys(SITE, "*").state, timeout=1.0, settles=settles)
    assert sorted(settled) == [Keys(SITE, name).state.encode() for name in NAMES]
    [answer] = await SealedBus(rig.network.session()).ask(A1.state, timeout=1.0)
    assert answer.payload == A1.state.encode(), "without an authority it is believed"


async def test_an_agent_whose_calendar_was_set_back_is_heard_again(
    rig: Rig, keys: Keyring, monkeypatch: pytest.MonkeyPatch
) -> None:
    network, heard = rig.network, []
    ada = SealedBus(network.session(), authority=keys.authority)
    ada.subscribe(A1.state, lambda _key, payload: heard.append(payload))
    for year in (2026, 1970):  # a board without a battery for its clock
        monkeypatch.setattr(time, "time_ns", lambda: (year - 1969) * 10**16)  # noqa: B023
        seal = Seal(keys.seals["a1"]._key, keys.certificate("a1"))
        a1 = SealedBus(network.session(), {"a1": seal})
        served = a1.serve(A1.state, lambda question: question.answer(A1.state, b"now"))
        outlet = a1.publish(A1.state)
        for number in range(3):
            outlet.put(f"{year} {number}".encode())
            await anyio.sleep(1.1)
        served.close()
    assert heard == [b"2026 1", b"2026 2", b"1970 1", b"1970 2"]


async def test_an_answer_that_was_overtaken_lets_nothing_be_heard_twice(
    rig: Rig, keys: Keyring, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By less than two seconds; an answer that is older than that is of a calendar set back."""
    network, said, heard, now = rig.network, list[bytes](), list[bytes](), [10.0]
    monkeypatch.setattr(time, "time_ns", lambda: round(now[0] * 1e9))
    ada, stranger = SealedBus(network.session(), authority=keys.authority), network.session()
    stranger.subscribe(A1.state, lambda _key, payload: said.append(payload))
    ada.subscribe(A1.state, lambda _key, payload: heard.append(payload))

    def seal() -> Seal:  # that has signed nothing yet: the time of its words only grows
        return Seal(keys.seals["a1"]._key, keys.certificate("a1"))

    a1 = SealedBus(network.session(), {"a1": seal()})
    served = a1.serve(A1.state, lambda question: question.answer(A1.state, b"now"))
    outlet = a1.publish(A1.state)
    for at, text in ((10.0, b"first"), (20.0, b"second"), (21.0, b"third")):
        now[0] = at
        outlet.put(text)  # by the first one, ada asks for the time of a1
        await anyio.sleep(0.1)
    served.close()
    now[0] = 20.5
    late = SealedBus(network.session(), {"a1": seal()})
    late.serve(A1.state, lambda question: question.answer(A1.state, b"now"))
    [answer] = await ada.ask(A1.state, timeout=1.0)
    assert answer.is_proved
    stranger.publish(A1.state).put(said[-1])
    await anyio.sleep(0.1)
    assert heard == [b"second", b"third"]


async def test_a_strangers_state_is_no_second_agent_and_one_with_the_key_is(
    rig: Rig, keys: Keyring
) -> None:
    one, _ = await two(rig, keys)
    said: list[bytes] = []
    stranger = rig.network.session()
    stranger.subscribe(A1.state, lambda _key, payload: said.append(payload))
    outlet = stranger.publish(A1.state)
    forged = pack(Card("a1", "87654321", 2e9))
    for _ in range(4):
        outlet.put(forged)
        outlet.put(keys.seals["a3"].seal(A1.state, forged))
        await anyio.sleep(0.5)
    assert not one.fleet_agent.duplicates.is_there(one.client.now)
    await rig.aircraft("a1", seal=keys.seals["a1"], authority=keys.authority)
    await anyio.sleep(4.0)
    assert one.fleet_agent.duplicates.is_there(one.client.now)


async def test_a_strangers_place_ends_no_show(rig: Rig, keys: Keyring) -> None:
    one, _ = await two(rig, keys)
    service = ShowService(one.client, one.spoken, A1, one.fleet_agent.boot)
    one.agent.background.spawn(service.run(), "show")
    await anyio.sleep(0.1)
    others = service.performer.neighbours = Neighbours("run 2", "a1", 3.0, 1)
    place = Keys(SITE, "a2").place

    def at(show: str, moment: float) -> bytes:
        there = ConflictMonitor(show, "a2", moment, ((0.0, 0.0, 5.0),) * 2, 99.0)
        return bytes([VERSION]) + there.to_bytes()

    stranger = rig.network.session().publish(place)
    stranger.put(at("run 2", 50.0))
    stranger.put(keys.seals["a3"].seal(place, at("run 2", 50.0)))
    stranger.put(keys.seals["a2"].seal(place, at("run 1", 50.0)))  # recorded at an earlier run
    await anyio.sleep(0.1)
    assert others.missing(one.client.now) == 1, "none of them is believed"
    rig.network.session().publish(place).put(keys.seals["a2"].seal(place, at("run 2", 1.0)))
    await anyio.sleep(0.1)
    assert others.missing(one.client.now) == 0


async def test_an_aircraft_signs_by_a_certificate_of_its_own_name(tmp_path: Path) -> None:
    now = datetime.now(UTC)
    pki.init(tmp_path, now=now)
    with pytest.raises(UsageError, match="a1 has no certificate") as caught:
        Seal.read(tmp_path, "a1")
    assert caught.value.remedy == "make them: m100link fleet make fleet.toml"
    pki.issue(tmp_path, pki.Kind.AGENT, "a1", now=now)
    key = Ed25519PrivateKey.generate()
    pem = key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption())
    (tmp_path / "a1.key").write_bytes(pem)
    with pytest.raises(UsageError, match=f"{tmp_path}/a1.key is no key of this program"):
        Seal.read(tmp_path, "a1")
