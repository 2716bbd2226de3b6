"""The bytes of a fleet: a version, strict values, and proofs."""

from __future__ import annotations

import contextlib
import json
import math
import random
from dataclasses import replace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from m100link.apps.agent.lease import LeaseHeld, LeaseRefused
from m100link.apps.agent.messages import MessageError, RemoteError, Steer, Telemetry
from m100link.apps.agent.orders import (
    AcquireLease,
    Land,
    Right,
    SetMissionSpeed,
    Stop,
    TakeOff,
    UploadPlan,
)
from m100link.apps.bus.network import Question
from m100link.apps.fleet.identity import Gate, Rights, Signer
from m100link.apps.fleet.payloads import (
    VERSION,
    Asked,
    AskShow,
    Card,
    LeaveShow,
    LogQuestion,
    OrderMessage,
    OrderReply,
    Outcome,
    Progress,
    Result,
    SendTrack,
    ShowOrder,
    TakePlace,
    What,
    body,
    ends,
    outcome_of,
    pack,
    pack_steer,
    unpack,
    unpack_message,
    unpack_steer,
)
from m100link.errors import (
    AckTimeout,
    AuthorityLost,
    GuardRefused,
    LinkClosed,
    LinkError,
    LinkLost,
    M100Error,
    NotAllowed,
    NotObserved,
    OutcomeUnknown,
    StaleLease,
    Unreachable,
)
from m100link.protocol.setpoint import Setpoint
from tests.apps.agent.examples import EXAMPLES
from tests.fuzz.mutation import changed

ORDER = OrderMessage("ab" * 16, "field", "a1", "pilot", 3, 1.8e9, TakeOff())
NORTH = Setpoint.velocity(north=1.0, east=0.0, up=0.0, yaw_rate_deg_s=0.0)


@pytest.mark.parametrize(
    "value",
    [
        ORDER,
        ORDER.under("secret"),
        OrderReply("id", "a1", "boot", Progress.RUNNING),
        OrderReply(
            "id",
            "a1",
            "b",
            Progress.DONE,
            Outcome.REFUSED,
            RemoteError("GuardRefused", "low"),
            "t",
            4,
        ),
        Card("a1", "boot", 1.8e9, battery_percent=50, latitude_deg=47.0),
    ],
)
def test_what_goes_in_comes_out(value: OrderMessage | OrderReply | Card) -> None:
    payload = pack(value)
    assert payload[0] == VERSION
    assert unpack(type(value), payload) == value


def test_what_is_not_said_is_nothing_or_the_least() -> None:
    card = Card("a1", "boot", 1.8e9)
    assert (card.connection, card.fence, card.has_authority) == ("connecting", 0, False)
    assert (card.lost, card.lost_after) == ("hover", 10.0)
    reply = OrderReply("0" * 32, "a1", "boot", Progress.DONE)
    assert (reply.outcome, reply.is_repeated) == (Outcome.UNKNOWN, False)
    assert (reply.number, reply.clock) == (0, 0.0)


def test_what_is_no_number_cannot_be_sent() -> None:
    with pytest.raises(MessageError, match="Card cannot be sent"):
        pack(Card("a1", "boot", math.nan))


def test_telemetry_is_the_wire_value_and_fourteen_bytes() -> None:
    value = bytes(range(134))
    payload = pack(Telemetry(value, "1.0", 12.5))
    assert payload.endswith(value)
    assert len(payload) == 134 + 14
    assert unpack_message(payload) == Telemetry(value, "1.0", 12.5)


def test_another_version_is_reported() -> None:
    payload = bytes([VERSION + 1]) + pack(ORDER)[1:]
    with pytest.raises(MessageError, match=f"version {VERSION + 1}") as caught:
        unpack(OrderMessage, payload)
    assert "same release" in caught.value.remedy


def test_a_proof_is_of_one_lease_and_of_every_byte() -> None:
    order = ORDER.under("secret")
    assert order.proves("secret")
    assert not order.proves("other")
    assert not replace(order, fence=4).proves("secret")
    assert not replace(order, aircraft="a2").proves("secret")
    assert not replace(order, order=Land()).proves("secret")
    assert not replace(order, id="cd" * 16).proves("secret")
    assert not ORDER.proves("secret")


def test_a_setpoint_is_proved_as_well() -> None:
    steer = Steer(7, 1.0, 0.2, NORTH)
    payload = pack_steer(steer, "secret", begins=True)
    assert unpack_steer(payload, {7: "secret"}.get) == (steer, True)
    assert unpack_steer(payload, {7: "other"}.get) is None
    assert unpack_steer(payload, {8: "secret"}.get) is None
    goes_on = pack_steer(steer, "secret", begins=False)
    assert unpack_steer(goes_on, {7: "secret"}.get) == (steer, False)
    assert unpack_steer(goes_on[:17] + b"\x01" + goes_on[18:], {7: "secret"}.get) is None


@given(st.binary(max_size=300))
def test_whatever_comes_nothing_but_a_message_error_is_raised(data: bytes) -> None:
    for payload in (data, bytes([VERSION]) + data):
        for kind in (OrderMessage, OrderReply, Card):
            with pytest.raises(MessageError):
                unpack(kind, payload)
        with contextlib.suppress(MessageError):
            unpack_steer(payload, {0: ""}.get)


# -- one order, one meaning -----------------------------------------------------------------------

ANNA = Signer("anna", b"a" * 32)
RIGHTS = Rights.parse(
    f"""
    [identity.anna]
    public_key = "{ANNA.public_key.hex()}"
    fly = ["a1"]
    """
)
PLAN = UploadPlan(b"mission", (b"one", b"two"))
GIVEN: list[Asked] = [
    *(TakeOff(), Land(), Stop(), AcquireLease("anna"), SetMissionSpeed(2.5), PLAN),
    *(LogQuestion(What.PIECE, "x.mcap", 5, 7), SendTrack("r", 3, b"data"), TakePlace("r")),
]


def signed_order(number: int = 0) -> OrderMessage:
    """Signed, and under a lease."""
    order = replace(ORDER, order=GIVEN[number % len(GIVEN)], id=f"{number:032x}", clock=83.25)
    return ANNA(order, "secret")


def changed_document(old: str, new: str) -> bytes:
    """A payload whose signature is right: of a pilot who wants two readers to differ."""
    document = signed_order().document
    assert document.count(old.encode()) == 1
    order = signed_order().sealed(document.replace(old.encode(), new.encode()))
    return pack(order.sealed(signature=ANNA.sign(order)))


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('"fence":3,', '"fence":3,"fence":4,'),
        ('"fence":3,', '"fence":4,"fence":3,'),
        ('"order":{', '"order":{"kind":"Land"},"order":{'),
        ('{"kind":"TakeOff"}', '{"kind":"TakeOff","kind":"TakeOff"}'),
        ('{"kind":"TakeOff"}', '{"kind":"Halt","why":"","why":""}'),
        ('{"kind":"TakeOff"}', '{"kind":"TakeOff","token":""}'),
        ('{"kind":"TakeOff"}', '{"Kind":"TakeOff"}'),
        ('{"kind":"TakeOff"}', '{"kind":"takeoff"}'),
        ('{"kind":"TakeOff"}', '{"kind":"TakeOff\\u0000"}'),
        ('{"kind":"TakeOff"}', '{"kind":"Order"}'),
        ('{"kind":"TakeOff"}', '{"kind":"Ask","id":1,"order":{"kind":"TakeOff"},"fence":0}'),
        ('{"kind":"TakeOff"}', '"eyJraW5kIjoiVGFrZU9mZiJ9"'),
        ('{"kind":"TakeOff"}', '[{"kind":"TakeOff"}]'),
        ('{"kind":"TakeOff"}', "null"),
        ('"by":"pilot"', '"by":"pilot","message":""'),
        ('"by":"pilot"', '"by":"pilot","BY":"eve"'),
        ('"by":"pilot"', '"by":"\\ud800"'),
        ('"by":"pilot",', ""),
        ('"fence":3', '"fence":9007199254740993'),
        ('"fence":3', '"fence":18446744073709551619'),
        ('"fence":3', '"fence":3.0'),
        ('"fence":3', '"fence":3e0'),
        ('"fence":3', '"fence":true'),
        ('"fence":3', '"fence":"3"'),
        ('"fence":3', '"fence":03'),
        ('"fence":3', '"fence":0x3'),
        ('"clock":83.25', '"clock":NaN'),
        ('"clock":83.25', '"clock":-Infinity'),
        ('"clock":83.25', '"clock":1e400'),
        ('"clock":83.25', '"clock":' + "9" * 400),
        ('"clock":83.25', '"clock":.5'),
        ('"key":""', '"key":"AAE"'),
        ('"key":""', '"key":"AAF="'),
        ('"key":""', '"key":"AA E="'),
        ('"key":""', '"key":"AAE=AAE="'),
        ('"key":""', '"key":"_-8="'),
        ('"since":0.0}', '"since":0.0}{}'),
        ('"since":0.0}', '"since":0.0}\0'),
        ('"since":0.0}', '"since":0.0,}'),
        ('{"id"', '\ufeff{"id"'),
        ('{"id"', '/**/{"id"'),
    ],
)
def test_what_two_readers_could_understand_differently_is_refused(old: str, new: str) -> None:
    with pytest.raises(MessageError):
        unpack(OrderMessage, changed_document(old, new))


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('{"kind":"TakeOff"}', '{ "kind" :\t"Take\\u004fff"\n}'),
        ('"clock":83.25', '"clock":8.325e+1'),
        ('"at":1800000000.0', '"at":1800000000'),
    ],
)
def test_another_writer_writes_as_it_likes_and_its_bytes_are_what_is_signed(
    old: str, new: str
) -> None:
    payload = changed_document(old, new)
    order: OrderMessage = unpack(OrderMessage, payload)
    assert order == signed_order().sealed(signature=order.signature)
    assert pack(order) == payload
    gate().check(order, 1.8e9)
    assert order.digest != signed_order().digest, "a reply names the bytes that came"


def gate() -> Gate:
    return Gate(RIGHTS, "a1", began_at=0.0)


def first_wins(pairs: list[tuple[str, object]]) -> dict[str, object]:
    return dict(reversed(pairs))


def meaning(document: bytes) -> str:
    """What one reader understands that takes the first of two, and knows no numbers but doubles."""
    value = json.loads(
        document, object_pairs_hook=first_wins, parse_int=lambda one: float(one) + 0.0
    )
    return json.dumps(value, sort_keys=True)


WORDS = [
    *(
        b'"order":',
        b'{"kind":"Land"}',
        b'"kind":"Stop",',
        b'"fence":4,',
        b'"clock":',
        b'"proof":"",',
    ),
    *(
        b"NaN",
        b"-0",
        b"0.1e1",
        b"9007199254740993",
        b"1e308",
        b"\\u0061",
        b"\\",
        b"A==",
        b" ",
        b"\t",
    ),
    *(b'"signer":"bert",', b'"by":"', b",", b":", b"true", b"}", b"{"),
]


@pytest.mark.parametrize("seed", range(2))
def test_no_changed_order_is_obeyed_or_proved_and_what_is_read_has_one_meaning(seed: int) -> None:
    chance = random.Random(seed)
    seeds = [pack(signed_order(number)) for number in range(len(GIVEN))]
    read = 0
    for number in range(3000):
        payload = changed(chance, seeds, WORDS)
        if number % 2:  # the JSON alone
            one = chance.choice(seeds)
            payload = one[:81] + changed(chance, [one[81:]], WORDS)
        try:
            order: OrderMessage = unpack(OrderMessage, payload)
        except MessageError:
            continue
        read += 1
        ours = json.dumps(json.loads(replace(order).document, parse_int=float), sort_keys=True)
        assert meaning(order.document) == ours
        if payload in seeds:
            continue
        with pytest.raises(NotAllowed):
            gate().check(order, 1.8e9)
        is_same = order.document in {one[81:] for one in seeds}
        assert is_same or not order.proves("secret")
    assert read > 200


# -- releases that speak another version ----------------------------------------------------------

# As a release wrote them that spoke version 2: bytes, not what this code would write.
OLD_ORDERS = {
    "cmd": b'\x02{"id":"0b0b0b0b0b0b0b0b0b0b0b0b0b0b0b0b","aircraft":"a1","by":"anna","fence":0,'
    b'"at":1800000000.0,"message":"eyJraW5kIjoiU3RvcCJ9","clock":0.0,"proof":"","signer":"",'
    b'"signature":"","key":""}',
    "lease": b'\x02{"id":"0b0b0b0b0b0b0b0b0b0b0b0b0b0b0b0b","aircraft":"a1","by":"anna","fence":0,'
    b'"at":1800000000.0,"message":"eyJraW5kIjoiQWNxdWlyZUxlYXNlIiwibmFtZSI6ImFubmEifQ==",'
    b'"clock":0.0,"proof":"","signer":"anna","signature":"roJ0Xvxniyo1DuNXOEmv4C5ZYGqsp2j+abk/'
    b'jGNNzFFGoGN7dZ67YCuS7kNqcUobCM2ApuOa0GS1BM/9COufCg==","key":"AAECAwQFBgcICQoLDA0ODxAREhMU'
    b'FRYXGBkaGxwdHh8="}',
    "log": b'\x02{"id":"0b0b0b0b0b0b0b0b0b0b0b0b0b0b0b0b","aircraft":"a1","by":"anna","fence":0,'
    b'"at":1800000000.0,"message":"bG9nCnsid2hhdCI6Imxpc3QiLCJsb2ciOiIiLCJvZmZzZXQiOjAsImxlbmd0'
    b'aCI6MH0=","clock":0.0,"proof":"","signer":"","signature":"","key":""}',
    "show": b'\x02{"id":"0b0b0b0b0b0b0b0b0b0b0b0b0b0b0b0b","aircraft":"a1","by":"anna","fence":0,'
    b'"at":1800000000.0,"message":"c2hvdwp7ImRvIjogInRlbGwiLCAicnVuIjogInIifQ==","clock":0.0,'
    b'"proof":"","signer":"","signature":"","key":""}',
}
OLD_REPLY = (
    b'\x02{"id":"","name":"a1","boot":"5c0f8b1e","progress":"done","outcome":"refused","fault":'
    b'{"kind":"MessageError","seen":"it speaks version 3 of the fleet\'s messages, this side 2",'
    b'"cause":"an old agent and a new pilot, or the other way round","remedy":"install the same '
    b'release on both","details":{}},"text":"","number":0,"offer":"","key":"","clock":12.5,'
    b'"is_repeated":false,"order":""}'
)
OLD_CARD = (
    b'\x02{"name":"a1","boot":"5c0f8b1e","at":1800000000.0,"connection":"connecting","fault":null,'
    b'"firmware":"","holder":"","fence":0,"has_authority":false,"task":"","phase":"",'
    b'"height_m":null,"latitude_deg":null,"longitude_deg":null,"battery_percent":null,'
    b'"lost":"hover","lost_after":10.0,"version":""}'
)
OLD_LOGS = (
    b'\x02{"id":"","name":"a1","outcome":"refused","fault":null,"again_s":0.0,"offset":0,"size":0,'
    b'"is_written":false}\n'
)
OLD_HELLO = b'\x02{"kind":"Hello","version":1,"name":"5c0f8b1e","at":12.5}'
BOTH = "version 2 of the fleet's messages came to a program that reads version 4"


@pytest.mark.parametrize(
    ("kind", "payload"),
    [
        *((OrderMessage, one) for one in OLD_ORDERS.values()),
        (OrderReply, OLD_REPLY),
        (Card, OLD_CARD),
    ],
)
def test_what_an_old_release_wrote_is_reported_with_both_versions(
    kind: Any, payload: bytes
) -> None:
    with pytest.raises(MessageError, match=BOTH) as caught:
        unpack(kind, payload)
    assert caught.value.remedy == "install the same release on both"


# -- what an error means for the client ------------------------------------------------------------


@pytest.mark.parametrize(
    ("error", "outcome"),
    [
        (None, Outcome.OK),
        (GuardRefused("low", guard="battery"), Outcome.REFUSED),
        (LeaseHeld("held", holder="other"), Outcome.REFUSED),
        (LeaseRefused("ended"), Outcome.STALE_LEASE),
        (StaleLease("ended"), Outcome.STALE_LEASE),
        (NotAllowed("no"), Outcome.NOT_ALLOWED),
        (Unreachable("nobody"), Outcome.UNREACHABLE),
        (OutcomeUnknown("silence"), Outcome.UNKNOWN),
        # The aircraft itself gave no answer: it may have done it.
        (AckTimeout("no ack", tries=3), Outcome.UNKNOWN),
        # It had begun: the aircraft may have done it, or do it yet.
        (NotObserved("not seen to be done"), Outcome.UNKNOWN),
        (AuthorityLost("the pilot left F"), Outcome.UNKNOWN),
        (LinkLost("unplugged"), Outcome.UNKNOWN),
        (LinkClosed("closed by this side"), Outcome.UNKNOWN),
        (LinkError("not connected: nothing was sent"), Outcome.REFUSED),
    ],
)
def test_each_error_has_one(error: M100Error | None, outcome: Outcome) -> None:
    assert outcome_of(error) is outcome
    assert Result.of("a1", error).is_ok is (error is None)


def test_a_result_says_why() -> None:
    assert Result.of("a1", None, 7) == Result("a1", Outcome.OK, None, 7)
    assert str(Result.of("a1", None)) == "ok"
    assert str(Result.of("a1", StaleLease("it ended"))) == "stale_lease (it ended)"


@pytest.mark.parametrize("order", [*EXAMPLES, LeaveShow("run"), TakePlace("run"), AskShow("run")])
def test_an_order_that_ends_something_is_known_before_it_is_read(order: Asked) -> None:
    asked = OrderMessage("0b" * 16, "field", "kite", "anna", 17, 1.0, order)
    question = Question("key", pack(asked.under("secret")), lambda *_: None, lambda: None)
    assert ends(question) is (isinstance(order, LeaveShow) or getattr(order, "ends", False))


def test_nobody_passes_an_order_off_as_one_that_ends() -> None:
    name = '","order":{"kind":"Stop"}'
    asked = OrderMessage("0b" * 16, "field", name, name, 17, 1.0, AcquireLease(name))
    for payload in (pack(asked), b"", b"Stop", pack(replace(asked, order=Stop(), by="b" * 2048))):
        assert not ends(Question("key", payload, lambda *_: None, lambda: None))


# -- values: bounds, defaults and times of what goes over the network ------------------------------


@pytest.mark.parametrize(
    ("size", "is_read"), [(0, False), (1, True), (65_536, True), (65_537, False)]
)
def test_a_payload_has_a_byte_at_least_and_64_kib_at_most(size: int, is_read: bool) -> None:
    payload = bytes([4] * size)
    if is_read:
        assert body(payload) == payload[1:]
        return
    with pytest.raises(MessageError, match=f"{size} bytes are no payload of a fleet"):
        body(payload)


@pytest.mark.parametrize(
    ("clock", "since", "wanted_at"),
    [(0.0, 0.0, None), (83.25, 0.0, 83.25), (83.25, 80.5, 80.5), (0.0, 80.5, 80.5)],
)
def test_an_order_was_wanted_as_its_request_began(
    clock: float, since: float, wanted_at: float | None
) -> None:
    assert replace(ORDER, clock=clock, since=since).wanted_at == wanted_at


def test_what_is_asked_needs_a_right() -> None:
    """A show flies the aircraft; a log may be read by all who may watch."""
    assert (LogQuestion.right, ShowOrder.right) == (Right.WATCH, Right.FLY)


def test_a_reply_to_what_is_over_has_all_that_it_was_given() -> None:
    refused = OrderReply.done("id", "a1", "boot", GuardRefused("low", guard="battery"), clock=7.5)
    told = (refused.progress, refused.outcome, refused.clock, refused.id, refused.name)
    assert told == (Progress.DONE, Outcome.REFUSED, 7.5, "id", "a1")
    assert refused.fault is not None
    assert (refused.fault.kind, refused.fault.seen) == ("GuardRefused", "low")
    done = OrderReply.done("id", "a1", "boot", None, text="words", number=3)
    assert done == OrderReply("id", "a1", "boot", Progress.DONE, Outcome.OK, text="words", number=3)


def test_without_a_secret_nothing_is_proved_and_no_other_message_is_a_setpoint() -> None:
    assert ORDER.under("") is ORDER
    proved = pack_steer(Steer(7, 1.0, 0.2, NORTH), "secret", begins=True)
    telemetry = pack(Telemetry(bytes(134), "1.0", 12.5))
    with pytest.raises(MessageError, match="Telemetry is no setpoint"):
        unpack_steer(proved[:18] + telemetry[1:], {7: "secret"}.get)
