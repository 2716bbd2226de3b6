"""Signed orders: what is let through, and the right reason for everything that is not."""

from __future__ import annotations

import hmac
import math
import random
import time
from collections import defaultdict
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import pytest

from m100link.apps.agent import orders
from m100link.apps.agent.orders import Right
from m100link.apps.fleet.identity import (
    BadRights,
    Gate,
    OrderRefused,
    Reason,
    Rights,
    Signer,
)
from m100link.apps.fleet.payloads import LeaveShow, OrderMessage, StartShow, TakePlace, pack
from m100link.errors import UsageError

NOW = 1_800_000_000.0
ANNA, BERT = Signer("anna", b"a" * 32), Signer("bert", b"b" * 32)
RIGHTS = Rights.parse(
    f"""
[identity.anna]
public_key = "{ANNA.public_key.hex()}"
fly = ["a1"]
[identity.bert]
public_key = "{BERT.public_key.hex()}"
stop = ["*"]
[identity.wall]
watch = ["*"]
"""
)


NEEDS = {Right.WATCH: orders.AskVersion(), Right.STOP: orders.Stop(), Right.FLY: orders.TakeOff()}
"""An order for each right."""


def order(number: str = "1", **changes: Any) -> OrderMessage:
    made = OrderMessage(number, "field", "a1", "anna", 7, NOW, orders.TakeOff(), signer="anna")
    return replace(made, **changes)


def signed(made: OrderMessage, signer: Signer = ANNA) -> OrderMessage:
    return made.sealed(signature=signer.sign(made))


def gate(aircraft: str = "a1") -> Gate:
    return Gate(RIGHTS, aircraft, began_at=NOW - 60)


def reason(
    made: OrderMessage,
    signature: bytes | None = None,
    *,
    right: Right | None = None,
    now: float = NOW,
    at: Gate | None = None,
) -> Reason | None:
    """Why it is refused; None if it is let through."""
    made = made if right is None else replace(made, order=NEEDS[right])
    signer = BERT if made.signer == "bert" else ANNA
    made = made.sealed(signature=signer.sign(made) if signature is None else signature)
    try:
        (at or gate()).check(made, now)
    except OrderRefused as error:
        return error.reason
    return None


def test_a_refusal_names_who_says_to_have_signed() -> None:
    with pytest.raises(OrderRefused) as caught:
        gate().check(order(signer="eve"), NOW)
    assert caught.value.signer == "eve"


def test_an_order_of_somebody_who_may_is_let_through() -> None:
    assert reason(order()) is None
    assert reason(order(signer="bert"), right=Right.STOP) is None
    assert reason(order(signer="bert"), right=Right.WATCH) is None


# -- bytes ----------------------------------------------------------------------------------------


def test_what_is_signed_is_as_the_manual_says() -> None:
    document = (
        b'{"id":"1","site":"field","aircraft":"a1","by":"anna","fence":7,"at":1800000000.0,'
        b'"order":{"kind":"TakeOff"},"clock":0.0,"boot":"","signer":"anna","key":"","since":0.0}'
    )
    assert order().signed() == b"m100link order 4\n" + bytes(16) + document
    proof = hmac.digest(b"secret", document, "sha256")[:16]
    made = order().under("secret")
    assert made.signed() == b"m100link order 4\n" + proof + document
    assert pack(signed(made)) == b"\4" + ANNA.sign(made) + proof + document


@pytest.mark.parametrize(
    "field", [one.name for one in fields(OrderMessage) if one.name != "signature"]
)
def test_whatever_is_changed_breaks_the_signature(field: str) -> None:
    changes: dict[str, Any] = {
        **{"id": "2", "site": "wood", "aircraft": "a2", "by": "bert", "fence": 8, "at": NOW + 1},
        **{"order": orders.Land(), "clock": 1.0, "signer": "bert", "key": b"1", "proof": b"1" * 16},
        **{"since": 1.0, "boot": "5c0f8b1e"},
    }
    changed = order(**{field: changes[field]})
    assert reason(changed, ANNA.sign(order())) is Reason.BAD_SIGNATURE


@pytest.mark.parametrize("seed", range(3))
def test_no_damaged_signature_is_taken(seed: int) -> None:
    chance, signature = random.Random(seed), ANNA.sign(order())
    for bad in (b"", signature[:-1], signature + b"\0", bytes(64)):
        assert reason(order(), bad) is Reason.BAD_SIGNATURE
    for _ in range(50):
        one = bytearray(signature)
        one[chance.randrange(64)] ^= 1 << chance.randrange(8)
        assert reason(order(), bytes(one)) is Reason.BAD_SIGNATURE


def test_texts_that_are_no_text_break_nothing() -> None:
    assert reason(order(id="\ud800"), bytes(64)) is Reason.BAD_SIGNATURE


# -- who ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("signer", ["", "eve", "wall"])
def test_keys_that_nobody_knows(signer: str) -> None:
    """The wall is known, and has no key."""
    assert reason(order(signer=signer), bytes(64)) is Reason.UNKNOWN_KEY


def test_one_signs_for_oneself_alone() -> None:
    with pytest.raises(UsageError, match="anna cannot sign for bert"):
        ANNA.sign(order(signer="bert"))
    assert reason(order(signer="bert"), ANNA.sign(order())) is Reason.BAD_SIGNATURE
    with pytest.raises(UsageError, match="32 bytes"):
        Signer("anna", b"short")


def test_an_order_to_another_aircraft_is_sent_on_by_somebody() -> None:
    assert reason(order(), at=gate("a2")) is Reason.WRONG_AIRCRAFT


def test_an_operator_without_the_right_is_refused() -> None:
    assert reason(order(signer="bert"), right=Right.FLY) is Reason.NOT_ALLOWED
    assert reason(order(aircraft="b1"), at=gate("b1"), right=Right.WATCH) is Reason.NOT_ALLOWED


# -- when -----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("right", "window"),
    [(Right.WATCH, 5.0), (Right.STOP, 600.0), (Right.FLY, 5.0)],
)
@pytest.mark.parametrize("sense", [-1, 1])
def test_orders_are_fresh(right: Right, window: float, sense: int) -> None:
    for age, expected in ((1.0, None), (1.01, Reason.EXPIRED)):
        long_there = Gate(RIGHTS, "a1", began_at=NOW - 10_000)
        made = order(at=NOW - sense * age * window)
        assert reason(made, right=right, at=long_there) is expected


# A calendar that is a day behind; the agent's clock, its run, and what comes of it (the table of
# ``clock`` and ``boot`` in docs/reference/fleet-wire.md).
FRESH, OLD = None, Reason.EXPIRED
BY_ITS_CLOCK = [
    (orders.Stop(), 100.0, "", FRESH),  # what stops needs no run
    (orders.Halt(), 100.0, "", FRESH),
    (orders.Stop(), 95.0, "", FRESH),
    (orders.Stop(), 105.0, "", FRESH),
    (orders.Stop(), 94.9, "", OLD),
    (orders.Stop(), 105.1, "", OLD),
    (orders.Stop(), 0.0, "", OLD),  # no time
    (orders.Land(), 100.0, "run", FRESH),
    (orders.Land(), 100.0, "another", OLD),
    (orders.Land(), 100.0, "", OLD),
    (orders.Land(), 94.9, "run", OLD),
    (orders.AskVersion(), 100.0, "run", FRESH),
    (orders.PauseMission(), 100.0, "run", FRESH),
    (orders.AcquireLease("anna"), 100.0, "run", FRESH),
    (orders.GoHome(), 100.0, "run", FRESH),  # it moves, and ends a flight
    (orders.TakeOff(), 100.0, "run", OLD),  # what moves needs the calendar
    (orders.Activate(), 100.0, "run", OLD),
    (TakePlace(""), 100.0, "run", OLD),
    (StartShow("", "", 0.0, 0.0), 100.0, "run", OLD),
    (LeaveShow(""), 100.0, "run", FRESH),
]


@pytest.mark.parametrize(("asked", "clock", "boot", "expected"), BY_ITS_CLOCK)
@pytest.mark.parametrize("calendar", [-86_400.0, 86_400.0])
def test_where_calendars_differ_the_clock_of_the_agent_says_what_is_fresh(
    asked: Any, clock: float, boot: str, expected: Reason | None, calendar: float
) -> None:
    one = Gate(RIGHTS, "a1", began_at=NOW - 1e6)
    made = signed(order(at=NOW + calendar, order=asked, clock=clock, boot=boot))
    if expected is None:
        one.check(made, NOW, 100.0, "run")
        # It is known for as long as its repetition could be let through.
        assert list(one._seen.values()) == [max(NOW, NOW + calendar) + 600.0]
        with pytest.raises(OrderRefused) as caught:
            one.check(made, NOW, 100.0, "run")
        assert caught.value.reason is Reason.REPLAYED
        return
    with pytest.raises(OrderRefused) as caught:
        one.check(made, NOW, 100.0, "run")
    assert caught.value.reason is expected
    assert not one._seen
    with pytest.raises(OrderRefused):
        Gate(RIGHTS, "a1", began_at=NOW - 1e6).check(made, NOW)  # no clock, no run


def test_an_agent_without_a_run_takes_no_order_of_an_empty_one() -> None:
    one = Gate(RIGHTS, "a1", began_at=NOW - 1e6)
    with pytest.raises(OrderRefused):
        one.check(signed(order(at=NOW - 1e4, order=orders.Land(), clock=100.0)), NOW, 100.0, "")


@pytest.mark.parametrize(
    ("at", "seen"),
    [(-7.25, "is 7.2 s old"), (7.25, "is from 7.2 s ahead"), (-3.0, "3.0 s old, and older than")],
)
def test_a_refusal_says_how_old_the_order_is(at: float, seen: str) -> None:
    with pytest.raises(OrderRefused, match=seen):
        Gate(RIGHTS, "a1", began_at=NOW - 1.0).check(signed(order(at=NOW + at)), NOW)


@pytest.mark.parametrize("at", [math.nan, math.inf, -math.inf])
def test_an_order_has_a_time(at: float) -> None:
    timeless = order(at=at, order=orders.Stop()).sealed(b"nobody can write it")
    assert reason(timeless) is Reason.EXPIRED


def test_what_was_signed_before_the_agent_began_is_refused_but_a_stop_is_not() -> None:
    anew = Gate(RIGHTS, "a1", began_at=NOW)
    assert reason(order(at=NOW - 1), at=anew) is Reason.EXPIRED
    assert reason(order(at=NOW - 1), at=anew, right=Right.STOP) is None
    assert reason(order("2", at=NOW), at=anew) is None


def test_a_revoked_name_hears_so_but_only_with_its_proof() -> None:
    revoked = defaultdict(str, anna="2026-11-22").__getitem__
    at = Gate(RIGHTS, "a1", began_at=NOW - 60, revoked=revoked)
    for right in Right:
        assert reason(order(), at=at, right=right) is Reason.REVOKED
    assert reason(order(), bytes(64), at=at) is Reason.BAD_SIGNATURE
    assert reason(order(signer="bert"), at=at, right=Right.STOP) is None
    with pytest.raises(OrderRefused, match="anna is revoked since 2026-11-22"):
        at.check(signed(order()), NOW)


# -- once -----------------------------------------------------------------------------------------


def test_a_recorded_order_is_not_obeyed_again() -> None:
    one = gate()
    assert reason(order(), at=one) is None
    assert reason(order(), at=one) is Reason.REPLAYED
    assert reason(order(order=orders.Land()), at=one) is Reason.REPLAYED
    assert reason(order(signer="bert"), at=one, right=Right.STOP) is None, "an id of his own"
    assert reason(order("2"), at=one) is None


def test_what_was_refused_uses_up_no_id() -> None:
    one = gate()
    assert reason(order(), bytes(64), at=one) is Reason.BAD_SIGNATURE
    assert reason(order(at=NOW - 6), at=one) is Reason.EXPIRED
    assert reason(order(), at=one) is None


@pytest.mark.parametrize("seed", range(3))
def test_nothing_is_obeyed_twice_whatever_is_repeated_when(seed: int) -> None:
    """A recorder repeats anything at any time; its memory is not the agent's."""
    chance, one, now = random.Random(seed), gate(), NOW
    recorded: list[OrderMessage] = []
    obeyed: set[str] = set()
    for number in range(1500):
        now += chance.expovariate(2)
        if not recorded or chance.random() < 0.3:
            what = NEEDS[chance.choice([Right.FLY, Right.STOP])]
            recorded.append(order(str(number), at=now + chance.uniform(-4, 4), order=what))
        made = chance.choice(recorded[-20:])
        if reason(made, at=one, now=now) is None:
            assert made.id not in obeyed
            obeyed.add(made.id)
    assert len(obeyed) > 100


def test_what_is_remembered_is_forgotten_when_it_has_expired() -> None:
    """All at once, and not before there are a thousand of them, or twice as many as were young."""
    one = gate()
    one._seen = {("anna", f"old {number}"): NOW + number - 100.5 for number in range(1024)}
    for number, at, right, until in (
        ("1", NOW - 2.0, Right.FLY, NOW + 3.0),
        ("2", NOW - 2.0, Right.STOP, NOW + 598.0),
        ("3", NOW, Right.WATCH, NOW + 5.0),
    ):
        assert reason(order(number, at=at), right=right, at=one) is None
        assert reason(order(number, at=at), right=right, at=one) is Reason.REPLAYED
        assert one._seen["anna", number] == until
    assert (len(one._seen), one._purged_at) == (1024 - 101 + 3, 2 * (1024 - 101))


# -- the file of rights: who may do what, and every mistake in it by its name ----------------------


FILE = """
site = "field"

[aircraft.a1]
[aircraft.a2]
[aircraft.b1]

[identity.anna]
public_key = "{key}"
fly = ["a1"]
stop = ["*"]

[identity.wall]
watch = ["a*"]
""".format(key="0a" * 32)

WATCH, STOP, FLY = Right


# Who, which aircraft, and the most that is allowed; by hand from the file above.
TABLE = [
    ("anna", "a1", FLY),
    ("anna", "a2", STOP),
    ("anna", "b1", STOP),
    ("anna", "later", STOP),
    ("wall", "a1", WATCH),
    ("wall", "a2", WATCH),
    ("wall", "b1", None),
    ("wall", "a", WATCH),
]


@pytest.mark.parametrize(("who", "aircraft", "most"), TABLE)
@pytest.mark.parametrize("right", Right)
def test_the_rights_of_each_name(who: str, aircraft: str, most: Right | None, right: Right) -> None:
    identity = Rights.parse(FILE).identities.get(who)
    assert identity is not None
    assert identity.may(right, aircraft) == (most is not None and right <= most)


def test_names_and_keys_are_as_the_file_says() -> None:
    rights = Rights.parse(FILE)
    assert rights.site == "field"
    assert rights.aircraft == ("a1", "a2", "b1")
    assert rights.identities.get("nobody") is None
    anna, wall = rights.identities.values()
    assert (anna.name, anna.public_key) == ("anna", b"\x0a" * 32)
    assert (wall.name, wall.public_key) == ("wall", None)
    assert anna.allowed(Right.WATCH) == ("*", "a1")
    assert anna.allowed(Right.FLY) == ("a1",)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("site = ", "is not TOML"),
        ('sight = "x"', "the file: there is no field 'sight'"),
        ('site = "a/b"', "site is 'a/b'"),
        ("aircraft = 3", "aircraft is not a table of tables"),
        ("[identity]\nanna = 3", "identity is not a table of tables"),
        ('[aircraft."a*"]', "aircraft is 'a*'"),
        ("[aircraft.a1]\nname = 3", "aircraft a1: there is no field 'name'"),
        ("[identity.anna]\nflies = []", "identity anna: there is no field 'flies'"),
        ('[identity.anna]\nfly = "a1"', "fly of anna is 'a1'"),
        ('[identity.anna]\nfly = ["a**"]', "fly of anna is 'a**'"),
        ('[identity.anna]\nfly = ["a/b"]', "fly of anna is 'a/b'"),
        ("[identity.anna]\nfly = [1]", "fly of anna is 1"),
        ('[identity.anna]\npublic_key = "12"', "public_key of anna is '12'"),
        ("[aircraft.a1]\n[identity.a1]", "two entries are named a1"),
        ("[router.x]\nhosts = ['x']\n[identity.x]", "line 3: two entries are named x"),
        ("[aircraft.console]", "line 1: an aircraft is named console"),
        ("[router.console]\nhosts = ['x']", "line 1: a router is named console"),
        ("[aircraft.ca]", "two entries are named ca"),
        ("[aircraft.a1]\n[aircraft.A1]", "line 2: two entries are named A1"),  # a disk of macOS
        ("[aircraft.a1]\n[identity.A1]", "two entries are named A1"),
        ('[aircraft."../../x"]', "line 1: aircraft is '../../x'"),
        ('[aircraft."a\\u001b[2J"]', "line 1: aircraft is 'a\\x1b[2J'"),
        ("\n[aircraft.a1]\n\nlost = 'fall'", "line 4: lost of a1 is 'fall'"),
        ("[aircraft]\na1 = {lost_after = -1}", "line 2: lost_after of a1 is -1"),
        ("[aircraft]\na1.max_height = nan", "line 2: max_height of a1 is nan"),
        ("[aircraft.a1]\nmax_radius = true", "line 2: max_radius of a1 is True"),
        ("[aircraft.a1]\nfirmware = '9'", "line 2: firmware of a1 is '9'"),
        ("[aircraft.a1]\nbaud_rate = 0", "line 2: baud_rate of a1 is 0"),
        ("[defaults]\nurl = '/dev/x'", "line 2: defaults: there is no field 'url'"),
        ("defaults = 3", "line 1: defaults is not a table"),
        ("[router.base]", "line 1: hosts of base is None"),
        ("[router.base]\nhosts = ['a b']", "line 2: hosts of base is ['a b']"),
        ("[router.base]\nhosts = ['::1']\nport = 70000", "line 3: port of base is 70000"),
        ("[console]\nidentity = 'eve'", "line 2: identity of the console is 'eve'"),
        ("[console]\nidentity = ['eve']", "line 2: identity of the console is ['eve']"),
        ("[aircraft.a1]\n[aircraft.a1]", "is not TOML"),
    ],
)
def test_every_mistake_is_named(text: str, said: str) -> None:
    with pytest.raises(BadRights) as caught:
        Rights.parse(text)
    assert said in caught.value.seen
    assert caught.value.line
    assert caught.value.remedy


def test_a_file_of_the_greatest_size_costs_a_moment() -> None:
    text = "aircraft = {" + ", ".join(f"a{number} = {{}}" for number in range(8000)) + "}"
    began = time.process_time()
    assert len(Rights.parse(text).aircraft) == 8000
    assert time.process_time() - began < 1.0  # 3 s where each name is compared with each


def test_a_fleet_file_has_routers_settings_and_a_console() -> None:
    found = Rights.parse(
        """
[router.base]
hosts = ["base.local", "10.0.0.1"]
port = 7000
[router.near]
hosts = ["127.0.0.1"]
[defaults]
lost = "land"
max_height = 30
[aircraft.a1]
url = "/dev/ttyUSB0"
max_height = 40
[aircraft.a2]
[identity.anna]
[console]
identity = "anna"
"""
    )
    assert found.endpoints == ("tls/base.local:7000", "tls/127.0.0.1:7447")
    listening = [one.listen for one in found.routers.values()]
    assert listening == ["tls/0.0.0.0:7000", "tls/127.0.0.1:7447"]
    assert found.settings["a1"] == {"lost": "land", "max_height": 40, "url": "/dev/ttyUSB0"}
    assert found.settings["a2"] == {"lost": "land", "max_height": 30}
    assert list(found.without({"near", "a2"}).routers) == ["base"]


def test_a_public_key_lies_beside_the_file(tmp_path: Path) -> None:
    (tmp_path / "fleet.toml").write_text("[identity.anna]\nfly = ['*']\n[identity.bert]\n")
    (tmp_path / "pki").mkdir()
    (tmp_path / "pki/anna.pub").write_text("0a" * 32 + "\n")
    anna, bert = Rights.read(tmp_path / "fleet.toml").identities.values()
    assert (anna.public_key, bert.public_key) == (b"\x0a" * 32, None)
    before = Rights.read(tmp_path / "fleet.toml").digest
    (tmp_path / "pki/anna.pub").write_text("0b" * 32)
    assert Rights.read(tmp_path / "fleet.toml").digest != before
    (tmp_path / "pki/anna.pub").write_text("no key")
    with pytest.raises(BadRights, match=r"anna\.pub has no public key"):
        Rights.read(tmp_path / "fleet.toml")
    (tmp_path / "pki/bert.pub").mkdir()
    (tmp_path / "pki/anna.pub").unlink()
    with pytest.raises(BadRights, match=r"bert\.pub cannot be read: Is a directory"):
        Rights.read(tmp_path / "fleet.toml")


def test_files_that_cannot_be_read_are_named(tmp_path: Path) -> None:
    with pytest.raises(BadRights, match=r"nowhere\.toml cannot be read"):
        Rights.read(tmp_path / "nowhere.toml")
    (tmp_path / "rights.toml").write_bytes(b"\xff")
    with pytest.raises(BadRights, match="is not text"):
        Rights.read(tmp_path / "rights.toml")
    (tmp_path / "rights.toml").write_text(FILE)
    assert Rights.read(tmp_path / "rights.toml") == Rights.parse(FILE)
    (tmp_path / "rights.toml").chmod(0o646)
    with pytest.raises(BadRights, match="can be written by everybody"):
        Rights.read(tmp_path / "rights.toml")
    (tmp_path / "rights.toml").chmod(0o644)
    (tmp_path / "rights.toml").write_bytes(b"#" * (1024 * 1024 + 1))
    with pytest.raises(BadRights, match="too large"):
        Rights.read(tmp_path / "rights.toml")


def test_without_somebody_nothing_is_left_of_him() -> None:
    rights = Rights.parse(
        """
[aircraft.a1]
[aircraft.a2]
[identity.anna]
fly = ["*"]
[identity.bert]
stop = ["*"]
"""
    )
    for names, aircraft, people in (
        ({"anna"}, {"a1", "a2"}, {"bert"}),
        ({"a2", "bert"}, {"a1"}, {"anna"}),
        ({"eve"}, {"a1", "a2"}, {"anna", "bert"}),
        ((), {"a1", "a2"}, {"anna", "bert"}),
    ):
        left = rights.without(names)
        assert (set(left.aircraft), set(left.identities)) == (aircraft, people)
