"""The bytes of a fleet: a version, strict values, and proofs."""

from __future__ import annotations

import contextlib
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from m100link.apps.agent.lease import LeaseHeld, LeaseRefused
from m100link.apps.agent.messages import Steer, Telemetry
from m100link.apps.agent.orders import Land, TakeOff
from m100link.apps.agent.remote_error import Fault, MessageError
from m100link.apps.fleet.payloads import (
    VERSION,
    Card,
    Order,
    Outcome,
    Progress,
    Reply,
    Result,
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

ORDER = Order("ab" * 16, "field", "a1", "pilot", 3, 1.8e9, TakeOff())
NORTH = Setpoint.velocity(north=1.0, east=0.0, up=0.0, yaw_rate_deg_s=0.0)


@pytest.mark.parametrize(
    "value",
    [
        ORDER,
        ORDER.under("secret"),
        Reply("id", "a1", "boot", Progress.RUNNING),
        Reply(
            "id", "a1", "b", Progress.DONE, Outcome.REFUSED, Fault("GuardRefused", "low"), "t", 4
        ),
        Card("a1", "boot", 1.8e9, battery_percent=50, latitude_deg=47.0),
    ],
)
def test_what_goes_in_comes_out(value: Order | Reply | Card) -> None:
    payload = pack(value)
    assert payload[0] == VERSION
    assert unpack(type(value), payload) == value


def test_telemetry_is_the_wire_value_and_fourteen_bytes() -> None:
    value = bytes(range(134))
    payload = pack(Telemetry(value, "1.0", 12.5))
    assert payload.endswith(value)
    assert len(payload) == 134 + 14
    assert unpack_message(payload) == Telemetry(value, "1.0", 12.5)


def test_another_version_is_told() -> None:
    payload = bytes([VERSION + 1]) + pack(ORDER)[1:]
    with pytest.raises(MessageError, match=f"version {VERSION + 1}") as caught:
        unpack(Order, payload)
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
        for kind in (Order, Reply, Card):
            with pytest.raises(MessageError):
                unpack(kind, payload)
        with contextlib.suppress(MessageError):
            unpack_steer(payload, {0: ""}.get)


# -- what an error means for whoever asked ---------------------------------------------------------


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
        (LinkError("not connected: nothing was sent"), Outcome.REFUSED),
    ],
)
def test_each_error_has_one(error: M100Error | None, outcome: Outcome) -> None:
    assert outcome_of(error) is outcome
    assert Result.of("a1", error).is_ok is (error is None)


def test_a_result_says_why() -> None:
    assert str(Result.of("a1", None)) == "ok"
    assert str(Result.of("a1", StaleLease("it ended"))) == "stale_lease (it ended)"
