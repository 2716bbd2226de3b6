"""A stranger hears all that goes over the network, may answer, and flies nothing by it."""

from __future__ import annotations

import hashlib
import hmac
import json
from dataclasses import replace
from typing import Any

import anyio
import pytest
from cryptography.hazmat.primitives.asymmetric.x25519 import X25519PrivateKey, X25519PublicKey

from m100link.apps.agent import orders
from m100link.apps.agent.messages import MessageError, Steer
from m100link.apps.bus.network import QueryAnswer, Question
from m100link.apps.fleet.agent import FleetAgent
from m100link.apps.fleet.keys import Keys
from m100link.apps.fleet.payloads import (
    Half,
    LeaseRequest,
    OrderMessage,
    OrderReply,
    Outcome,
    Progress,
    agree,
    pack,
    pack_steer,
    unpack,
)
from m100link.apps.fleet.signing import verifying
from m100link.protocol.setpoint import Setpoint
from tests.apps.fleet.conftest import SITE, OnBoard, Rig
from tests.apps.fleet.test_agent import keep, lease, order, send
from tests.apps.fleet.test_signing import ANNA, BERT, RIGHTS

pytestmark = pytest.mark.anyio

KEYS = Keys(SITE, "a1")
NORTH = Setpoint.velocity(north=3.0, east=0.0, up=0.0, yaw_rate_deg_s=0.0)


def an_order(key: bytes) -> OrderMessage:
    return OrderMessage(
        "ab" * 16, SITE, "a1", "anna", 0, 1.8e9, orders.AcquireLease(), 2.5, key=key
    )


def test_both_sides_find_the_secret_of_the_page_and_nobody_else() -> None:
    half = Half()
    order = an_order(half.public)
    agents, secret = agree(order)
    reply = OrderReply(order.id, "a1", "boot", Progress.DONE, Outcome.OK, number=7, key=agents)
    lease = LeaseRequest(order, half).lease(reply)
    assert (lease.number, lease.token) == (7, secret)
    assert secret not in repr(lease)
    other = Half()
    assert LeaseRequest(order, other).lease(reply).token != secret
    for changed in (replace(order, by="bert"), replace(order, fence=1), replace(order, at=0.0)):
        assert LeaseRequest(changed, half).lease(reply).token != secret


def test_the_secret_is_what_the_page_says() -> None:
    ours = X25519PrivateKey.generate()
    order = an_order(ours.public_key().public_bytes_raw())
    agents, secret = agree(order)
    shared = ours.exchange(X25519PublicKey.from_public_bytes(agents))
    told = b"m100link lease 4\n" + agents + order.document
    assert secret == hmac.new(shared, told, hashlib.sha256).hexdigest()


@pytest.mark.parametrize("key", [b"", b"short", bytes(32), b"\x01" + bytes(31), b"x" * 33])
def test_what_is_no_half_is_refused(key: bytes) -> None:
    """Of some points everybody knows the secret."""
    with pytest.raises(MessageError, match="X25519 public key"):
        agree(an_order(key))


class Listener:
    """Behind a router without rules: hears orders, asks what became of them, says them again."""

    def __init__(self, rig: Rig) -> None:
        self.bus = rig.network.session()
        self.heard: list[tuple[str, bytes]] = []
        self.told: list[bytes] = []
        for key in (KEYS.command, KEYS.lease):
            self.bus.serve(key, self._question)
        self.bus.subscribe(KEYS.setpoint, lambda key, payload: self.heard.append((key, payload)))

    def _question(self, question: Question) -> None:
        self.heard.append((question.key, question.payload))
        question.drop()

    def orders(self) -> list[tuple[str, OrderMessage]]:
        found = [(key, data) for key, data in self.heard if key != KEYS.setpoint]
        return [(key, unpack(OrderMessage, data)) for key, data in found]

    async def ask(self, key: str, payload: bytes = b"") -> list[bytes]:
        found = [one.payload for one in await self.bus.ask(key, payload, timeout=2.0)]
        self.told += found
        return found


def words(document: bytes) -> Any:
    """Each text in it, at any depth."""

    def within(value: Any) -> Any:
        if isinstance(value, str):
            yield value
        for one in value.values() if isinstance(value, dict) else ():
            yield from within(one)

    return list(within(json.loads(document)))


async def test_a_listener_hears_no_secret_and_flies_nothing_with_what_it_hears(
    rig: Rig,
) -> None:
    """Agents verify signatures, and bert may watch and stop."""
    one = await rig.aircraft("a1", verify=verifying(RIGHTS, ["a1"], rig.utc))
    anna, listener = await rig.pilot("anna", sign=ANNA), Listener(rig)
    control = anna["a1"].control()
    async with control:
        await control.take_off()
        async with control.hold(NORTH):
            await anyio.sleep(1.0)
        await rig.until(lambda: one.speed < 0.2)
        heard = list(listener.heard)
        sent = listener.orders()
        said = {type(order.order) for _, order in sent}
        assert {orders.AcquireLease, orders.RenewLease} <= said
        for key, order in sent:
            await listener.ask(KEYS.status(order.id))
            await listener.ask(key, pack(order))
        moves = one.aircraft.vehicle.flight.dynamics
        place = moves.north, moves.east
        number, secret = control.proof
        # Whatever word was sent or heard is tried as if it were the secret.
        told = {word for payload in listener.told for word in words(payload[1:])}
        asked = {word for _, order in sent for word in words(order.document)}
        assert secret not in told | asked
        assert all(secret.encode() not in data for _, data in heard)
        outlet = listener.bus.publish(KEYS.setpoint)
        for word in told | asked | {word[:22] for word in told}:
            steer = Steer(number, one.client.now, 0.2, NORTH)
            outlet.put(pack_steer(steer, word, begins=True))
            await anyio.sleep(0.01)
        for key, payload in heard:  # and what was heard, again
            if key == KEYS.setpoint:
                outlet.put(payload)
                await anyio.sleep(0.01)
        await anyio.sleep(2.0)
        assert one.speed < 0.2
        assert (moves.north, moves.east) == pytest.approx(place, abs=0.5)
        assert one.client.holder.number == number


async def test_renewals_that_were_heard_renew_nothing_when_the_pilot_is_gone(rig: Rig) -> None:
    one = await rig.aircraft("a1")
    got, said = await lease(rig), []
    for _ in range(6):
        said.append(order(orders.RenewLease(), got.number, got.token))
        assert (await send(rig, said[-1], KEYS.lease)).outcome is Outcome.OK
        await anyio.sleep(0.5)
    gone_at = anyio.current_time()
    while one.client.holder.number and anyio.current_time() < gone_at + 20.0:
        for renewal in said:
            await send(rig, renewal, KEYS.lease)
        await anyio.sleep(0.1)
    assert anyio.current_time() - gone_at < 3.1


async def test_a_renewal_of_long_ago_renews_nothing_when_its_id_is_forgotten(rig: Rig) -> None:
    one = await rig.aircraft("a1")
    got = await lease(rig)
    old = order(orders.RenewLease(), got.number, got.token)
    for _ in range(12):
        await anyio.sleep(0.5)
        assert (await keep(rig, got)).outcome is Outcome.OK
    reply = await send(rig, old, KEYS.lease)
    assert (reply.outcome, reply.fault and reply.fault.kind) == (Outcome.REFUSED, "GuardRefused")
    assert one.client.holder.number == got.number


async def test_renewal_and_release_need_the_proof(rig: Rig) -> None:
    one = await rig.aircraft("a1")
    got = await lease(rig)
    for ask in (orders.RenewLease(got.token), orders.ReleaseLease(got.token)):
        for fence, token in (
            (got.number, ""),
            (got.number, "guessed"),
            (got.number + 1, got.token),
        ):
            reply = await send(rig, order(ask, fence, token), KEYS.lease)
            assert reply.outcome is Outcome.STALE_LEASE
    assert one.client.holder.number == got.number
    await anyio.sleep(4.0)
    assert one.client.holder.number == 0, "none of them renewed it"


# -- who is believed ------------------------------------------------------------------------------


def forged(agent: FleetAgent, payload: bytes) -> bytes:
    """What a stranger answers who has learned the public number of the agent's run."""
    found: OrderMessage = unpack(OrderMessage, payload)
    done = OrderReply(
        found.id, "a1", agent.boot, Progress.DONE, Outcome.OK, number=1, key=Half().public
    )
    return pack(replace(done, clock=agent.client.now))


async def flying(rig: Rig) -> OnBoard:
    one = await rig.aircraft("a1", verify=verifying(RIGHTS, ["a1"], rig.utc))
    await (await rig.pilot("anna", sign=ANNA))["a1"].take_off()
    return one


async def test_a_strangers_answer_is_not_believed_and_the_aircraft_lands(rig: Rig) -> None:
    one = await flying(rig)
    stranger = rig.network.session()
    for key in (KEYS.command, KEYS.lease):
        stranger.serve(key, lambda q: q.answer(q.key, forged(one.fleet_agent, q.payload)))
    anna = await rig.pilot("anna", sign=ANNA)
    assert (await anna.land(["a1"]))["a1"].outcome is Outcome.OK
    assert one.height < 0.1, "ok is what the aircraft did"
    bert = await rig.pilot("bert", sign=BERT)
    results = await bert.each(lambda aircraft: aircraft.take_off(), ["a1"])
    assert results["a1"].outcome is Outcome.NOT_ALLOWED
    rig.network.cut(one.bus)  # the agent is gone, and its token is seen still
    assert (await anna.stop(["a1"]))["a1"].outcome is Outcome.UNKNOWN


@pytest.mark.parametrize("shows", ["its own token", "the session of the agent"])
async def test_of_two_that_answer_nobody_is_believed(
    rig: Rig, monkeypatch: pytest.MonkeyPatch, shows: str
) -> None:
    one = await flying(rig)
    stranger = rig.network.session()
    if shows == "its own token":
        stranger.declare(KEYS.live_by(stranger.session))
    else:
        monkeypatch.setattr(stranger, "_number", one.bus._number)
    stranger.serve(
        KEYS.command,
        lambda q: q.answer("m100/x/a1/cmd", forged(one.fleet_agent, q.payload)),
    )
    anna = await rig.pilot("anna", sign=ANNA)
    assert (await anna.land(["a1"]))["a1"].outcome is Outcome.UNKNOWN
    await rig.until(lambda: one.height < 0.1)


@pytest.mark.parametrize("is_first", [True, False])
async def test_another_order_of_the_same_id_gives_no_outcome(rig: Rig, is_first: bool) -> None:
    """Bert may stop. He hears the id of a landing whose way to the agent is longer than his."""
    one = await flying(rig)
    anna = await rig.pilot("anna", sign=ANNA)
    heard: list[OrderMessage] = []
    asks = rig.network.session()

    async def squat(found: OrderMessage) -> None:
        mine = OrderMessage(found.id, SITE, "a1", "bert", 0, rig.utc(), orders.Stop())
        signed = BERT(mine, "")
        await asks.ask(KEYS.command, pack(signed), timeout=2.0)

    sent = anna.bus.ask

    async def ask(key: str, payload: bytes = b"", *, timeout: float) -> list[QueryAnswer]:
        if key == KEYS.command and not heard:
            heard.append(unpack(OrderMessage, payload))
            await squat(heard[0])
            if not is_first:  # the order itself is lost
                return []
        return await sent(key, payload, timeout=timeout)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(anna.bus, "ask", ask)
        told = (await anna.land(["a1"]))["a1"].outcome
    if is_first:
        assert told is Outcome.REFUSED
        assert one.height > 1.0, "it was not carried out, as reported"
    else:
        assert told is Outcome.UNKNOWN
        await anyio.sleep(10.0)  # it is asked for again, under another id
        assert one.height > 1.0, "the stop is newer than the landing, and Bert may stop"
