"""Signed orders from a pilot to an agent: who may, and what a recorder can do with them."""

from __future__ import annotations

import base64
import json
import uuid
from collections.abc import Awaitable, Callable
from dataclasses import replace
from datetime import UTC as ZULU
from datetime import datetime, timedelta
from itertools import product
from pathlib import Path
from typing import Any

import anyio
import pytest
from cryptography import x509
from cryptography.hazmat.primitives.serialization import Encoding

from m100link.apps.agent import orders
from m100link.apps.agent.orders import Right
from m100link.apps.fleet.asking import Sign
from m100link.apps.fleet.client import Fleet, FleetAircraft
from m100link.apps.fleet.identity import STOP_WINDOW_S, Rights, Signer
from m100link.apps.fleet.keys import Keys
from m100link.apps.fleet.payloads import (
    AboutShow,
    AskShow,
    LeaveShow,
    LogQuestion,
    OrderMessage,
    OrderReply,
    Outcome,
    Progress,
    What,
    pack,
    unpack,
)
from m100link.apps.fleet.pki import Kind, init, issue
from m100link.apps.fleet.revocations import read_certificate
from m100link.apps.fleet.signing import _issued, read_signer, tls_options, verifying
from m100link.errors import M100Error, NotAllowed, OutcomeUnknown, UsageError
from tests.apps.fleet.conftest import SITE, UTC, Rig

pytestmark = pytest.mark.anyio

ANNA, BERT, EVE = (Signer(name, name[0].encode() * 32) for name in ("anna", "bert", "eve"))
RIGHTS = Rights.parse(
    f"""
[identity.anna]
public_key = "{ANNA.public_key.hex()}"
fly = ["a1"]
[identity.bert]
public_key = "{BERT.public_key.hex()}"
stop = ["*"]
"""
)


async def fleet_of(rig: Rig) -> dict[str, Fleet]:
    """Two aircraft that verify, and pilots that sign, or do not."""
    for name in ("a1", "a2"):
        await rig.aircraft(name, verify=verifying(RIGHTS, [name], rig.utc))
    signs: dict[str, Sign | None] = {one.name: one for one in (ANNA, BERT, EVE)}
    return {name: await rig.pilot(name, sign=sign) for name, sign in {**signs, "": None}.items()}


async def test_each_does_what_the_file_of_rights_says(rig: Rig) -> None:
    pilots = await fleet_of(rig)
    found = {}
    for who, fleet in pilots.items():
        for what, do in (("fly", FleetAircraft.take_off), ("stop", FleetAircraft.stop)):
            for name, result in (await fleet.each(do, ["a1", "a2"])).items():
                found[who, what, name] = result.outcome
    allowed = {("anna", "fly", "a1"), ("anna", "stop", "a1")}
    allowed |= {("bert", "stop", "a1"), ("bert", "stop", "a2")}
    assert {what for what, outcome in found.items() if outcome is Outcome.OK} == allowed
    others = {outcome for what, outcome in found.items() if what not in allowed}
    assert others == {Outcome.NOT_ALLOWED}


async def test_the_reason_is_what_the_pilot_reads(rig: Rig) -> None:
    pilots = await fleet_of(rig)
    for who, name, said in (
        ("bert", "a1", "bert may not fly a1"),
        ("anna", "a2", "anna may not fly a2"),
        ("eve", "a1", "signed by eve, whose key a1 does not know"),
        ("", "a1", "signed by nobody, whose key a1 does not know"),
    ):
        with pytest.raises(NotAllowed) as caught:
            await pilots[who][name].take_off()
        assert said in caught.value.seen
        assert caught.value.remedy


def order(message: orders.Order, at: float, name: str = "a1", number: int = 1) -> OrderMessage:
    return OrderMessage(f"{number:032x}", SITE, name, "anna", 0, at, message)


async def asked(fleet: Fleet, given: OrderMessage, name: str = "a1") -> OrderReply:
    [answer] = await fleet.bus.ask(f"m100/{SITE}/{name}/cmd", pack(given), timeout=2.0)
    reply: OrderReply = unpack(OrderReply, answer.payload)
    return reply


async def test_what_a_recorder_sends_on_changes_or_keeps_is_refused(rig: Rig) -> None:
    pilots = await fleet_of(rig)
    recorder, sign = pilots[""], ANNA
    given = sign(order(orders.AskVersion(), rig.utc()), "")
    assert (await asked(recorder, given)).outcome is Outcome.OK
    again = await asked(recorder, given)  # the agent tells what became of it, and does nothing
    assert (again.outcome, again.is_repeated) == (Outcome.OK, True)
    await anyio.sleep(10.0)
    late = sign(order(orders.Land(), rig.utc(), number=9), "")  # by no clock of the agent
    for is_repeated in (False, True):  # a network brings it twice: it is late, not forbidden
        refused = await asked(recorder, late)
        assert (refused.outcome, refused.is_repeated) == (Outcome.REFUSED, is_repeated)
    fresh = sign(order(orders.AskVersion(), rig.utc(), number=2), "")
    for changed, name in (
        (replace(fresh, order=orders.TakeOff()), "a1"),
        (replace(fresh, at=fresh.at + 1), "a1"),
        (replace(fresh, by="eve"), "a1"),
        (replace(fresh, fence=9), "a1"),
        (replace(fresh, id=f"{3:032x}"), "a1"),
        (replace(fresh, signer="bert"), "a1"),
        (replace(fresh, aircraft="a2"), "a2"),
        (fresh, "a2"),
    ):
        assert (await asked(recorder, changed, name)).outcome is Outcome.NOT_ALLOWED
    await anyio.sleep(6.0)
    assert (await asked(recorder, fresh)).outcome is Outcome.NOT_ALLOWED, "too old by now"


async def test_an_attacker_that_takes_the_proof_away_and_is_first_uses_up_no_order(
    rig: Rig,
) -> None:
    pilots = await fleet_of(rig)
    async with pilots["anna"]["a1"].control() as control:
        number, token = control.proof
        clock = control._asker.its_clock.at_least(control._clock())
        given = replace(order(orders.Obtain(), rig.utc()), fence=number, clock=clock)
        signed = ANNA(given, token)
        for proof in (bytes(16), signed.under("guessed").proof):
            stripped = signed.sealed(proof=proof)
            assert (await asked(pilots[""], stripped)).outcome is Outcome.NOT_ALLOWED
        reply = await asked(pilots[""], signed)
        assert (reply.outcome, reply.is_repeated) == (Outcome.OK, False)


async def test_an_order_to_an_aircraft_of_that_name_elsewhere_is_refused(rig: Rig) -> None:
    pilots = await fleet_of(rig)
    elsewhere = replace(order(orders.Stop(), rig.utc()), site="wood")
    reply = await asked(pilots[""], ANNA(elsewhere, ""))
    assert (reply.outcome, reply.fault and reply.fault.seen) == (
        Outcome.NOT_ALLOWED,
        "an order to wood/a1 came to field/a1",
    )


async def test_a_wrong_clock_keeps_nobody_from_stopping(rig: Rig) -> None:
    pilots = await fleet_of(rig)
    for number, (action, off, outcome) in enumerate(
        (
            (orders.AskVersion(), -60.0, Outcome.NOT_ALLOWED),
            (orders.Stop(), -60.0, Outcome.OK),
            (orders.Stop(), 60.0, Outcome.OK),
            (orders.Stop(), STOP_WINDOW_S + 60, Outcome.NOT_ALLOWED),
        )
    ):
        given = ANNA(order(action, UTC + rig.utc() - UTC + off, number=number), "")
        reply = await asked(pilots[""], given)
        assert (reply.progress, reply.outcome) == (Progress.DONE, outcome)


@pytest.mark.parametrize("years", [-56.0, -0.001, 0.001, 1.0])
async def test_a_calendar_that_is_wrong_by_years_keeps_nobody_from_ending_a_flight(
    rig: Rig, years: float
) -> None:
    """On board without a battery, or set in flight: orders say the time by the agent's clock."""
    off = 0.0
    one = await rig.aircraft("a1", verify=verifying(RIGHTS, ["a1"], lambda: rig.utc() + off))
    anna = await rig.pilot("anna", sign=ANNA)
    await anna["a1"].take_off()
    off = years * 365 * 86_400
    with pytest.raises(NotAllowed):  # a router may show a later clock, and deliver it then
        await anna["a1"].take_off()
    await anna["a1"].stop()
    # A program of its own each, so that none knows the time there from the one before.
    await (await rig.pilot("anna", sign=ANNA))["a1"].land()
    assert one.aircraft.height == 0.0


ENDS = (orders.Stop(), orders.Halt(), orders.Land(), orders.ReleaseLease())


@pytest.mark.parametrize("given", ENDS, ids=lambda one: one.label)
@pytest.mark.parametrize("is_of_this_run", [True, False])
async def test_by_the_agents_clock_a_recorded_order_is_fresh_for_five_seconds_of_one_run(
    rig: Rig, given: orders.Order, *, is_of_this_run: bool
) -> None:
    """The same clock may be shown again when the computer was restarted."""
    one = await rig.aircraft("a1", verify=verifying(RIGHTS, ["a1"], lambda: rig.utc() + 1e8))
    anna = await rig.pilot("anna", sign=ANNA)
    boot = one.fleet_agent.boot if is_of_this_run else "5c0f8b1e"
    is_let_through = is_of_this_run or isinstance(given, orders.Stop | orders.Halt)
    for late_s in (4.9, 5.1):
        made = replace(order(given, rig.utc()), clock=anyio.current_time(), boot=boot)
        recorded = ANNA(replace(made, id=uuid.uuid4().hex), "")
        await anyio.sleep(late_s)
        outcome = (await asked(anna, recorded)).outcome
        assert (outcome is not Outcome.NOT_ALLOWED) is (is_let_through and late_s < 5.0)


async def test_a_calendar_that_is_set_in_flight_costs_nobody_control(rig: Rig) -> None:
    off = [0.0]
    await rig.aircraft("a1", verify=verifying(RIGHTS, ["a1"], lambda: rig.utc() + off[0]))
    anna = await rig.pilot("anna", sign=ANNA)
    async with anna["a1"].control() as control:
        await control.take_off()
        off[0] = 86_400.0
        await anyio.sleep(10.0)  # a lease lasts 3 s
        await control.land()


def test_keys_and_certificates_are_those_of_the_folder(tmp_path: Path) -> None:
    (tmp_path / "anna.signing.key").write_text((b"a" * 32).hex())
    (tmp_path / "anna.signing.key").chmod(0o600)
    assert read_signer(tmp_path, "anna").public_key == ANNA.public_key
    (tmp_path / "anna.signing.key").chmod(0o644)
    with pytest.raises(UsageError, match="can be read by others"):
        read_signer(tmp_path, "anna")
    with pytest.raises(UsageError, match="has no signing key of anne") as caught:
        read_signer(tmp_path, "anne")
    assert caught.value.remedy == "name one of anna"
    with pytest.raises(UsageError, match="has no signing key of anne") as caught:
        read_signer(tmp_path / "other", "anne")
    assert caught.value.remedy == "m100link fleet make FILE makes it: name that folder by --pki"
    pilot = json.loads(tls_options(tmp_path, "anna")["transport/link/tls"])
    assert pilot["connect_private_key"] == str(tmp_path / "anna.key")
    assert "listen_certificate" not in pilot
    router = json.loads(tls_options(tmp_path, "base", listens=True)["transport/link/tls"])
    assert router["listen_certificate"] == str(tmp_path / "base.pem")
    assert router["enable_mtls"] is True


async def test_the_right_to_watch_allows_to_fetch_logs_and_nothing_else_does(rig: Rig) -> None:
    verify = verifying(RIGHTS, ["a1", "a2"], rig.utc)

    def question(signer: Signer | None, aircraft: str) -> OrderMessage:
        head = (uuid.uuid4().hex, SITE, aircraft, "x", 0, rig.utc())
        order = OrderMessage(*head, LogQuestion(What.LIST))
        return order if signer is None else signer(order, "")

    for signer, aircraft in ((ANNA, "a1"), (BERT, "a1"), (BERT, "a2")):
        verify(question(signer, aircraft), "")
    for other, aircraft in ((ANNA, "a2"), (EVE, "a1"), (None, "a1")):
        with pytest.raises(NotAllowed):
            verify(question(other, aircraft), "")


@pytest.mark.parametrize(
    ("left_days", "said"), [(-1.0, "expired on"), (2.9, "expires on"), (3.1, "")]
)
def test_a_certificate_that_ends_soon_is_named_before_it_lets_nobody_in(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, left_days: float, said: str
) -> None:
    """A router that refuses it gives no reason, and an agent may run for days."""
    made = datetime.now(ZULU) - timedelta(days=30.0 - left_days)
    init(tmp_path, now=made)
    issue(tmp_path, Kind.AGENT, "a1", now=made)
    tls_options(tmp_path, "a1")
    assert said in caplog.text
    assert (f"the certificate of a1 {said}" in caplog.text) is bool(said)
    assert ("renew it by m100link fleet make" in caplog.text) is bool(said)


def test_a_certificate_of_a_version_that_is_none_belongs_to_nobody(tmp_path: Path) -> None:
    """The byte of its version, of DER: [0] EXPLICIT INTEGER, which cryptography refuses apart."""
    now = datetime.now(ZULU)
    init(tmp_path, now=now)
    authority = x509.load_pem_x509_certificate((tmp_path / "ca.pem").read_bytes())
    made = x509.load_pem_x509_certificate(
        issue(tmp_path, Kind.AGENT, "a1", now=now).certificate.read_bytes()
    )
    data = made.public_bytes(Encoding.DER)
    broken = data.replace(bytes.fromhex("a003020102"), bytes.fromhex("a003020122"), 1)
    assert _issued("a1", data, authority) is not None
    assert _issued("a1", broken, authority) is None
    pem = b"-----BEGIN CERTIFICATE-----\n%s\n-----END CERTIFICATE-----\n" % base64.b64encode(broken)
    with pytest.raises(ValueError, match="version"):
        read_certificate(pem)


# -- what the fleet file here does not allow is said before anything is sent ----------------------


def once(what: AboutShow) -> Callable[[FleetAircraft], Awaitable[object]]:
    return lambda one: one.asker.once(one.keys.show, what, within=1.0)


NEEDED: dict[str, tuple[Right, bool, Callable[[FleetAircraft], Awaitable[object]]]] = {
    "take_off": (Right.FLY, False, FleetAircraft.take_off),
    "control": (Right.FLY, False, lambda one: one.control().__aenter__()),
    "land": (Right.STOP, True, FleetAircraft.land),
    "stop": (Right.STOP, True, FleetAircraft.stop),
    "logs": (Right.WATCH, False, FleetAircraft.logs),
    "fetch_log": (Right.WATCH, False, FleetAircraft.fetch_log),
    "audit": (Right.WATCH, False, FleetAircraft.audit),
    "mission": (Right.WATCH, False, FleetAircraft.mission),
    "card": (Right.WATCH, False, FleetAircraft.card),
    "look at a show": (Right.FLY, False, once(AskShow("r"))),
    "leave a show": (Right.FLY, True, once(LeaveShow("r"))),
    "lease": (Right.FLY, False, lambda one: one.asker.take_lease(one.asker.lease_request())),
}
"""By method: its right, whether it ends a flight, and a call of it."""

FILE = """
[aircraft.a1]
[identity.anna]
{} = ["a1"]
[identity.bo]
fly = ["*"]
"""


def note(bus: Any, asked: list[str]) -> None:
    """Note what a session asks the network."""
    ask, tokens = bus.ask, bus.tokens

    def noted(real: Callable[..., Any]) -> Callable[..., Any]:
        def call(key: str, *more: Any, **how: Any) -> Any:
            asked.append(key)
            return real(key, *more, **how)

        return call

    bus.ask, bus.tokens = noted(ask), noted(tokens)


def test_each_method_of_an_aircraft_has_a_right() -> None:
    methods = {name for name, one in vars(FleetAircraft).items() if callable(one)}
    assert {name for name in methods if not name.startswith("_")} <= NEEDED.keys()


@pytest.mark.parametrize("method", NEEDED)
async def test_a_missing_right_is_named_at_once_and_what_ends_a_flight_goes_out(
    rig: Rig, method: str, caplog: pytest.LogCaptureFixture
) -> None:
    """Each right, an aircraft of the file and another one, and a name that is revoked."""
    needed, ends, call = NEEDED[method]
    for right, name, since in product(Right, ("a1", "z9"), ("", "2026-11-22")):
        case = right, name, since
        file = Rights.parse(FILE.format(right.name.lower()))
        rights = replace(file, path=Path("fleet.toml"))
        sign = Signer("anna", b"a" * 32, rights, {"anna": since}.__getitem__)
        bus, asked = rig.network.session(), list[str]()

        note(bus, asked)
        fleet = Fleet(bus, site=SITE, name="anna", sign=sign, utc=rig.utc, patience=1.0)
        caplog.clear()
        began = anyio.current_time()
        is_allowed = right >= needed and name == "a1" and not since
        why = f"anna may not {needed.name.lower()} {name}"
        why = f"anna is revoked since {since}" if since else why
        try:
            await call(fleet[name])
        except M100Error as error:
            caught: M100Error | None = error
        else:
            caught = None
        if is_allowed or ends:
            assert not isinstance(caught, NotAllowed), case
            assert asked, case
            said = [one.getMessage().partition(":")[0] for one in caplog.records]
            assert said == ([] if is_allowed else [why]), case
            continue
        assert (anyio.current_time(), asked) == (began, []), case
        assert caught is not None, case
        assert isinstance(caught, NotAllowed), case
        assert caught.seen == f"{why}; nothing was sent", case
        line = f"write [identity.anna] {needed.name.lower()} = [{name!r}] there, and bring the file"
        line += " to routers and boards; or ask bo, who may"
        assert since or caught.remedy == line, case
        assert since or caught.cause == "fleet.toml does not allow it", case


def test_without_a_fleet_file_the_agent_alone_decides() -> None:
    assert [ANNA.refusal(right, "a1") for right in Right] == [None] * 3


async def test_of_an_order_that_nobody_answers_a_missing_right_is_a_cause(rig: Rig) -> None:
    """So it looks where a router lets none of a name's orders pass, and no fleet file is here."""
    board = rig.network.session()
    board.declare(Keys(SITE, "a1").live_by(board.session))
    anna = await rig.pilot("anna", sign=ANNA, patience=1.0)
    with pytest.raises(OutcomeUnknown) as caught:
        await anna["a1"].take_off()
    assert "it has no right to fly" in caught.value.cause
    assert "m100link fleet acl check FILE --who NAME" in caught.value.remedy
