"""The page of what is on the network says enough: a program is written here by it alone."""

from __future__ import annotations

import base64
import hashlib
import hmac
import json
import re
import struct
import uuid
from collections.abc import Callable
from dataclasses import fields
from enum import Enum
from pathlib import Path
from typing import Any

import anyio
import pytest
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from cryptography.hazmat.primitives.asymmetric.x25519 import X25519PrivateKey, X25519PublicKey

from m100link.apps.agent import orders
from m100link.apps.agent.messages import RemoteError
from m100link.apps.agent.orders import ORDERS, AskVersion, EndingOrder, LeaseOrder
from m100link.apps.bus.network import Bus
from m100link.apps.fleet.identity import Rights
from m100link.apps.fleet.keys import Keys
from m100link.apps.fleet.logs.words import LogReply
from m100link.apps.fleet.payloads import (
    VERSION,
    Asked,
    OrderMessage,
    OrderReply,
    Outcome,
    Progress,
    ShowCard,
    ShowStage,
    What,
    pack,
    unpack,
)
from m100link.apps.fleet.pki import router_config
from m100link.apps.fleet.signing import verifying
from m100link.log.folder import LogEntry
from tests.apps.bus.memory import fits
from tests.apps.fleet.conftest import SITE, Rig
from tests.apps.fleet.test_signing import RIGHTS

pytestmark = pytest.mark.anyio

PAGE = Path(__file__).parents[3] / "docs" / "reference" / "fleet-wire.md"
EXAMPLE = Path(__file__).parents[3] / "examples" / "fleet" / "plain_zenoh.py"
KEY = Ed25519PrivateKey.from_private_bytes(b"a" * 32)


class Foreigner:
    """Knows keys and bytes, and nothing of this package."""

    def __init__(self, bus: Bus, utc: Callable[[], float], signer: str) -> None:
        self._bus, self._utc, self._signer = bus, utc, signer

    async def ask(self, what: str, payload: bytes = b"") -> dict[str, Any]:
        [answer] = await self._bus.ask(f"m100/{SITE}/a1/{what}", payload, timeout=2.0)
        assert answer.payload[0] == 4
        found: dict[str, Any] = json.loads(answer.payload[1:])
        return found

    async def clock(self) -> float:
        told = await self.ask(f"status/{uuid.uuid4().hex}")
        assert told["progress"] == "never"
        return float(told["clock"])

    def order(
        self,
        asked: dict[str, Any],
        lease: tuple[int, str] = (0, ""),
        clock: float = 0.0,
        key: bytes = b"",
    ) -> tuple[str, bytes]:
        fence, token = lease
        told: dict[str, Any] = {"order": asked, "signer": self._signer, "by": "Jürgen"}
        told |= {"id": uuid.uuid4().hex, "site": SITE, "aircraft": "a1", "fence": fence}
        told |= {"at": self._utc(), "clock": clock, "key": base64.b64encode(key).decode()}
        told |= {"boot": "", "since": 0.0}
        # Its own order of names, its own spaces, and letters as they are.
        self.document = document = json.dumps(told, indent=1, ensure_ascii=False).encode()
        proof = hmac.digest(token.encode(), document, "sha256")[:16] if token else bytes(16)
        signed = b"m100link order 4\n" + proof + document
        signature = KEY.sign(signed) if self._signer else bytes(64)
        return told["id"], b"\x04" + signature + proof + document

    async def do(self, what: str, asked: dict[str, Any], **around: Any) -> dict[str, Any]:
        identity, payload = self.order(asked, **around)
        told = await self.ask(what, payload)
        while told["progress"] == "running":
            told = await self.ask(f"status/{identity}")
        digest = hashlib.sha256(self.document).digest()[:16]
        assert told["order"] in ("", base64.b64encode(digest).decode())
        return told

    async def lease(self, message: dict[str, Any]) -> tuple[int, str]:
        half = X25519PrivateKey.generate()
        told = await self.do("lease", message, key=half.public_key().public_bytes_raw())
        agents = base64.b64decode(told["key"])
        shared = half.exchange(X25519PublicKey.from_public_bytes(agents))
        about = b"m100link lease 4\n" + agents + self.document
        return told["number"], hmac.digest(shared, about, "sha256").hex()


async def test_by_the_page_alone_somebody_flies_and_stops(rig: Rig) -> None:
    one = await rig.aircraft("a1", verify=verifying(RIGHTS, ["a1"], rig.utc))
    session = rig.network.session()
    nobody, anna = (Foreigner(session, rig.utc, name) for name in ("", "anna"))
    assert (await anna.ask("state"))["connection"] == "connected"
    refused = await nobody.do("cmd", {"kind": "Stop"})
    assert (refused["outcome"], refused["fault"]["kind"]) == ("not_allowed", "NotAllowed")
    assert (await anna.do("cmd", {"kind": "Stop"}))["outcome"] == "ok"
    lease = await anna.lease({"kind": "AcquireLease", "name": "Jürgen"})
    for name in ("Activate", "Obtain", "TakeOff"):
        clock = await anna.clock()
        await anna.do("lease", {"kind": "RenewLease", "token": ""}, lease=lease, clock=clock)
        told = await anna.do("cmd", {"kind": name}, lease=lease, clock=clock)
        assert told["outcome"] == "ok", told
        # A take-off takes longer than a lease that nobody renews.
        if name == "Obtain":
            one.agent.leases.lifetime = 30.0
    setpoints = session.publish(f"m100/{SITE}/a1/setpoint")
    ahead = await anna.clock() - anyio.current_time()
    for number in range(60):
        values = (anyio.current_time() + ahead, 0.2, 0x40, 3.0, 0.0, 0.0, 0.0)
        data = bytes([number == 0]) + struct.pack("<BQddB4d", 1, lease[0], *values)
        assert len(data) == 59
        setpoints.put(b"\x04" + hmac.digest(lease[1].encode(), data, "sha256")[:16] + data)
        await anyio.sleep(0.05)
    assert one.speed > 2.5
    assert (await anna.do("cmd", {"kind": "Stop"}))["outcome"] == "ok"
    late = await anna.do("cmd", {"kind": "Land"})
    assert late["outcome"] == "refused", "by no clock"
    told = await anna.do("cmd", {"kind": "Land"}, clock=await anna.clock())
    assert told["outcome"] == "ok"
    assert one.height < 0.1


def test_the_example_of_the_page_is_an_order_that_is_proved_and_signed() -> None:
    text = PAGE.read_text(encoding="utf-8")
    [block] = re.findall(r"```text\n(signature .*?)```", text, re.DOTALL)
    names = re.split(r"^(\w+) +", block, flags=re.MULTILINE)[1:]
    parts = {
        name: re.sub(r"\s", "", part) for name, part in zip(names[::2], names[1::2], strict=True)
    }
    document = parts["document"].encode()
    payload = b"\x04" + bytes.fromhex(parts["signature"] + parts["proof"]) + document
    assert f"The payload has {len(payload)} bytes" in text
    order: OrderMessage = unpack(OrderMessage, payload)
    assert order.order == orders.TakeOff()
    assert order.proves("5e" * 32)
    KEY.public_key().verify(order.signature, b"m100link order 4\n" + order.proof + document)
    assert f"`{order.digest.hex()}`" in text
    assert pack(order) == payload


async def test_telemetry_is_what_the_page_says(rig: Rig) -> None:
    await rig.aircraft("a1")
    session, heard = rig.network.session(), []
    session.subscribe(f"m100/{SITE}/a1/tel", lambda key, payload: heard.append(payload))
    await rig.until(lambda: len(heard) > 20)
    for payload in heard:
        version, kind, _, length = struct.unpack_from("<BBdB", payload)
        assert (version, kind, payload[11 : 11 + length]) == (4, 2, b"1.0")


def keys() -> dict[str, str]:
    """What stands behind the name of an aircraft, by the name that it has in code."""
    one = Keys(SITE, "a1")
    found = {name: getattr(one, name) for name in dir(Keys) if not name.startswith("_")}
    of_one = f"m100/{SITE}/a1/"
    return {
        name: key.removeprefix(of_one)
        for name, key in found.items()
        if isinstance(key, str) and key.startswith(of_one)
    }


def names(*kinds: type[Any]) -> list[str]:
    """Fields of what is written as JSON, and the words of choices."""
    found: list[str] = []
    for kind in kinds:
        is_choice = issubclass(kind, Enum)
        found += [one.value for one in kind] if is_choice else [one.name for one in fields(kind)]
    return found


BESIDE = [one for one in Asked.__args__ if one is not orders.Order]
"""What is asked of a fleet alone."""

# A token is no key to ask or to hear by; the page tells of tokens in words.
TOLD = {
    **{f"the key Keys.{name}": f"`{key}`" for name, key in keys().items() if key != "live"},
    "the key Keys.status": "`status/<id>`",
    **{
        f"{kind.__name__} {name}": name
        for kind in (OrderMessage, OrderReply, RemoteError, LogReply, LogEntry, ShowCard, *BESIDE)
        for name in names(kind)
        if name not in ("name", "id")  # words of the page whatever it tells
    },
    **{
        f"{kind.__name__} {name}": name
        for kind in (Outcome, Progress, What, ShowStage)
        for name in names(kind)
    },
    **{f"the order {one.__name__}": one.__name__ for one in BESIDE},
    # The page on the agent lists the others.
    **{
        f"the order {name}": name
        for name, one in ORDERS.items()
        if issubclass(one, LeaseOrder | EndingOrder | AskVersion)
    },
}


def missing(text: str) -> list[str]:
    """What a message or a key has, and the page does not name in code."""
    code = "\n".join(re.findall(r"`[^`\n]+`|```.*?```|`[^`]+`", text, re.DOTALL))
    return [
        what
        for what, name in TOLD.items()
        if not re.search(rf"(?<!\w){re.escape(name)}(?!\w)", code)
    ]


def test_the_page_names_every_key_and_field() -> None:
    text = PAGE.read_text(encoding="utf-8")
    assert len(keys()) == 14
    lacks = missing(text)
    assert not lacks, f"docs/reference/fleet-wire.md does not name {', '.join(lacks)}"


def test_the_page_and_the_example_have_the_version_that_is_read() -> None:
    """The example only flew where nobody saw it: an agent had refused its STOP for weeks."""
    text = EXAMPLE.read_text(encoding="utf-8")
    functions = text.partition("\nconfig = ")[0].replace("\nimport zenoh\n", "\n")
    example: dict[str, Any] = {}
    exec(functions.replace("zenoh.Session", "object"), example)
    payload = example["order"]("a1", example["STOP"])
    sent = unpack(OrderMessage, payload)
    assert (sent.aircraft, sent.order, sent.fence) == ("a1", orders.Stop(), 0)
    version = re.search(r"the version: `0x([0-9A-F]{2})`", PAGE.read_text(encoding="utf-8"))
    assert version is not None
    assert payload[0] == int(version[1], 16) == VERSION


@pytest.mark.parametrize(
    ("word", "what"),
    [
        ("revoked", "the key Keys.revoked"),
        ("is_repeated", "OrderReply is_repeated"),
        ("AskTakeOver", "the order AskTakeOver"),
        ("again_s", "LogReply again_s"),
    ],
)
def test_what_the_page_leaves_out_is_reported_by_name(word: str, what: str) -> None:
    text = PAGE.read_text(encoding="utf-8")
    assert what in missing(re.sub(rf"(?<!\w){word}(?!\w)", "other", text))


def test_a_router_has_a_rule_for_every_key() -> None:
    """A rule too few looks as if nobody were there."""
    rights = Rights.parse("""
        [aircraft.a1]
        [identity.anna]
        fly = ["a1"]
    """)
    config = router_config(rights)
    for who in ("agent a1", "identity anna"):
        rules = {
            key for one in config["rules"] if one["id"].startswith(who) for key in one["key_exprs"]
        }
        for name, words in (keys() | {"status": "status/*"}).items():
            key = Keys("site", "a1").of(words)
            is_there = any(fits(rule, key) for rule in rules)
            # Where it will be in a show an aircraft tells the others, and nobody else.
            assert is_there or (who, name) == ("identity anna", "place"), f"{who}: {name}"
