"""Somebody loses a laptop: from the list on, nothing that is signed by it is obeyed."""

from __future__ import annotations

import asyncio
import base64
import json
import os
import shutil
import subprocess
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from typing import Any
from unittest.mock import AsyncMock, MagicMock, call

import anyio
import pytest
from cryptography import x509
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from cryptography.hazmat.primitives.hashes import SHA256
from cryptography.hazmat.primitives.serialization import load_pem_private_key

from m100link.apps.agent.messages import MessageError
from m100link.apps.bus.network import Question
from m100link.apps.fleet import revocations
from m100link.apps.fleet.client import Fleet, FleetAircraft
from m100link.apps.fleet.identity import Rights, nobody
from m100link.apps.fleet.keys import Keys
from m100link.apps.fleet.lost_link import LostLinkPlan
from m100link.apps.fleet.payloads import VERSION, OrderReply, Outcome, unpack
from m100link.apps.fleet.pki import init, revoke
from m100link.apps.fleet.revocations import (
    LARGEST,
    LIST,
    BadRevoked,
    Revocations,
    RevocationService,
    Revoked,
    in_force,
    sign_revoked,
)
from m100link.apps.fleet.show.service import ShowService
from m100link.apps.fleet.signing import verifying
from m100link.errors import M100Error, NotAllowed, OutcomeUnknown, Unreachable, UsageError
from m100link.link.keyfile import replace_file
from m100link.protocol.setpoint import Setpoint
from tests.apps.fleet.conftest import SITE, OnBoard, Rig
from tests.apps.fleet.test_signing import ANNA, BERT

pytestmark = pytest.mark.anyio

NOW = datetime(2026, 11, 22, 14, 0, tzinfo=UTC)
NORTH = Setpoint.velocity(north=3.0, east=0.0, up=0.0, yaw_rate_deg_s=0.0)
RIGHTS = Rights.parse(
    f"""
[identity.anna]
public_key = "{ANNA.public_key.hex()}"
fly = ["a1"]
[identity.bert]
public_key = "{BERT.public_key.hex()}"
fly = ["a1"]
"""
)


class Site:
    """An authority, one aircraft that believes its lists, and two pilots."""

    def __init__(self, rig: Rig, folder: Path) -> None:
        self.rig, self.ca = rig, folder / "ca"
        init(self.ca, now=NOW)
        self.onboard = folder / "board"
        self.onboard.mkdir()
        (self.onboard / "ca.pem").write_bytes((self.ca / "ca.pem").read_bytes())
        self.revocations = Revocations.of_folder(self.onboard)

    async def begin(self, **options: Any) -> None:
        since = self.revocations.since
        verify = verifying(RIGHTS, ["a1"], self.rig.utc, since)
        self.one: OnBoard = await self.rig.aircraft("a1", verify=verify, revoked=since, **options)
        one, keys = self.one, Keys(SITE, "a1")
        show = ShowService(one.client, one.bus, keys, one.fleet_agent.boot, verify=verify)
        self.show = show
        self.service = RevocationService(
            one.bus,
            keys,
            one.fleet_agent.boot,
            self.revocations,
            shut_out=(one.fleet_agent.shut_out, lambda: show.shut_out(since)),
            note=one.client.note,
        )
        one.agent.background.spawn(self.service.run(), "revoked")
        one.agent.background.spawn(show.run(), "show")
        self.anna = await self.rig.pilot("anna", sign=ANNA)
        self.bert = await self.rig.pilot("bert", sign=BERT)

    def revoked(self, *names: str) -> bytes:
        return revoke(self.ca, names, now=NOW).data

    async def push(self, data: bytes, by: Fleet | None = None) -> int:
        return (await in_force((by or self.bert).bus, Keys(SITE, "a1"), data)).number

    @property
    def told(self) -> list[str]:
        return [event.text for event in self.one.client.events]


@pytest.fixture
async def site(rig: Rig, tmp_path: Path) -> Site:
    return Site(rig, tmp_path)


@pytest.mark.parametrize("way", ["network", "file"])
async def test_what_is_flown_hovers_and_nothing_more_is_obeyed(site: Site, way: str) -> None:
    await site.begin()
    rig, one, refused = site.rig, site.one, []

    async def fly() -> None:
        with pytest.raises(NotAllowed, match="anna is revoked since 2026-11-22") as caught:
            async with site.anna["a1"].control() as control:
                await control.take_off()
                async with control.hold(NORTH):
                    await anyio.sleep(60.0)
        refused.append(caught.value)

    async with anyio.create_task_group() as group:
        group.start_soon(fly)
        await rig.until(lambda: one.speed > 2.5)
        data = site.revoked("anna")
        if way == "network":
            assert await site.push(data) == 1
        else:
            (site.onboard / LIST).write_bytes(data)
        began = anyio.current_time()
        await rig.until(lambda: one.speed < 0.3, within=2.0 + (way == "file"))
        await rig.until(lambda: one.client.holder.number == 0, within=5.0)
        assert anyio.current_time() - began < 5.0
    assert refused, "the operator heard why"
    await anyio.sleep(5.0)
    assert one.speed < 0.3
    for do in (FleetAircraft.take_off, FleetAircraft.land, FleetAircraft.stop):
        result = (await site.anna.each(do, ["a1"]))["a1"]
        assert result.outcome is Outcome.NOT_ALLOWED
        assert result.error is not None
        assert "anna is revoked since 2026-11-22" in result.error.seen
        assert "another name" in result.error.remedy
    assert "anna is revoked: this aircraft hovers" in site.told
    assert any(text.startswith("list 1 of revoked names is in force") for text in site.told)
    await site.bert["a1"].land()
    assert one.height < 0.1, "another one lands it"


async def test_what_was_lost_with_the_laptop_is_brought_down_as_configured(site: Site) -> None:
    """The lease ends as if its holder fell silent, so that what follows is what follows that."""
    await site.begin(lost=LostLinkPlan("land", 3.0))
    one = site.one

    async def fly() -> None:
        with pytest.raises(NotAllowed):
            async with site.anna["a1"].control() as control:
                await control.take_off()
                async with control.hold(NORTH):
                    await anyio.sleep(60.0)

    async with anyio.create_task_group() as group:
        group.start_soon(fly)
        await site.rig.until(lambda: one.speed > 2.5)
        await site.push(site.revoked("anna"))
        await site.rig.until(lambda: one.height < 0.1, within=30.0)


async def test_of_another_one_nothing_ends(site: Site) -> None:
    await site.begin()
    one = site.one
    async with site.bert["a1"].control(stop="land") as control:
        await control.take_off()
        async with control.hold(NORTH):
            await site.rig.until(lambda: one.speed > 2.5)
            await site.push(site.revoked("anna"))
            await anyio.sleep(2.0)
            assert one.speed > 2.5


@pytest.mark.parametrize("task", ["take_off", "land"])
async def test_a_task_of_who_is_revoked_ends(site: Site, task: str) -> None:
    await site.begin()
    one, fleet = site.one, site.anna
    if task == "land":
        async with site.bert["a1"].control() as control:
            await control.take_off()
            here = await site.bert["a1"].card()
            assert here.latitude_deg is not None
            assert here.longitude_deg is not None
            await control.fly_to(
                latitude_deg=here.latitude_deg, longitude_deg=here.longitude_deg, height=20.0
            )
    do: Callable[[FleetAircraft], Any] = getattr(FleetAircraft, task)
    found = []

    async def order() -> None:
        found.append((await fleet.each(do, ["a1"]))["a1"])

    async with anyio.create_task_group() as group:
        group.start_soon(order)
        await anyio.sleep(2.0)
        await site.push(site.revoked("anna"))
    assert found[0].outcome is not Outcome.OK
    await anyio.sleep(3.0)
    stays = one.height
    await anyio.sleep(10.0)
    assert one.height == pytest.approx(stays, abs=0.3)


async def test_a_lease_that_is_being_granted_is_granted_to_nobody(
    site: Site, monkeypatch: pytest.MonkeyPatch
) -> None:
    await site.begin()
    orders = site.one.fleet_agent._orders
    acquire = site.one.client.acquire

    async def slow(name: str, asked_at: float) -> Any:
        lease = await acquire(name, asked_at)
        site.revocations.take_in(site.revoked("anna"))
        return lease

    monkeypatch.setattr(site.one.client, "acquire", slow)  # the list comes in between
    with pytest.raises(NotAllowed, match="anna is revoked"):
        async with site.anna["a1"].control():
            pass
    await anyio.sleep(0.1)
    assert (orders.leases, site.one.client.holder.number) == ({}, 0)


# -- which list is in force -----------------------------------------------------------------------


async def test_a_newer_list_counts_and_an_older_one_never_again(site: Site, tmp_path: Path) -> None:
    await site.begin()
    first = site.revoked("eve")
    shutil.copytree(site.ca, tmp_path / "copy")
    second, beside = site.revoked("anna"), revoke(tmp_path / "copy", ["bert"], now=NOW).data
    assert await site.push(b"") == 0, "it is asked which one is in force"
    assert await site.push(second) == 2
    with pytest.raises(UsageError, match=r"list 1 .* list 2 is in force"):
        await site.push(first)
    with pytest.raises(UsageError, match=r"list 2 .* list 2 is in force"):
        await site.push(beside)  # somebody else made it from list 1, too
    assert await site.push(second) == 2, "brought again it is no mistake"
    assert await site.push(b"") == 2
    assert (site.onboard / LIST).read_bytes() == second
    again = Revocations.of_folder(site.onboard)
    assert (again.number, again.since("anna"), again.since("bert")) == (2, "2026-11-22", "")
    (site.onboard / LIST).write_bytes(first)
    await anyio.sleep(3.0)
    assert site.revocations.number == 2
    assert any("list 1 of revoked names came, and list 2" in text for text in site.told)


async def test_a_list_that_nobody_of_authority_signed_changes_nothing(
    site: Site, tmp_path: Path
) -> None:
    await site.begin()
    init(tmp_path / "other", now=NOW)
    said = f"{LIST}: the signature of a list of revoked names is not that of the authority"
    others = (revoke(tmp_path / "other", ["bert"], now=NOW).data, b"{}\nAAAA\n", b"\x00" * 999)
    for number, other in enumerate(others, 1):
        with pytest.raises(M100Error, match="list of revoked names"):
            await site.push(other)
        (site.onboard / LIST).write_bytes(other)
        await anyio.sleep(5.0)
        assert site.told.count(said) == number, "reported once, however often it is looked at"
    assert site.revocations.number == 0
    await site.bert["a1"].stop()
    with pytest.raises(BadRevoked):
        Revocations.of_folder(site.onboard)  # an agent does not begin without its list
    (site.onboard / LIST).unlink()
    assert Revocations.of_folder(site.onboard).number == 0


async def test_a_flood_of_lists_is_not_read(site: Site) -> None:
    await site.begin()
    flood = [bytes([1]) + b"x" * 40_000, bytes([1]) + bytes(33_000)]
    key = Keys(SITE, "a1").revoked
    assert [await site.bert.bus.ask(key, one, timeout=0.5) for one in flood] == [[], []]
    assert await site.push(site.revoked("eve")) == 1


async def test_a_disk_that_does_not_take_it_is_reported_and_the_list_is_in_force(
    site: Site,
) -> None:
    await site.begin()
    (site.onboard / LIST).mkdir()
    with pytest.raises(UsageError, match=LIST):
        await site.push(site.revoked("anna"))
    assert site.revocations.since("anna")
    (site.onboard / LIST).rmdir()
    assert await site.push(site.revoked("anna")) == 1, "brought once more it is kept"
    assert (site.onboard / LIST).exists()


async def test_an_agent_that_does_not_know_lists_is_reported(rig: Rig) -> None:
    await rig.aircraft("a1")
    pilot = await rig.pilot()
    with pytest.raises(OutcomeUnknown, match="which list"):
        await in_force(pilot.bus, Keys(SITE, "a1"), b"")
    with pytest.raises(M100Error, match="no agent named b1"):
        await in_force(pilot.bus, Keys(SITE, "b1"), b"")


def test_a_folder_without_an_authority_is_none(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"ca\.pem"):
        Revocations.of_folder(tmp_path)
    (tmp_path / "ca.pem").write_text("nothing")
    with pytest.raises(UsageError, match="no certificate"):
        Revocations.of_folder(tmp_path)


async def test_a_revoked_operator_that_placed_an_aircraft_places_it_no_more(
    site: Site, monkeypatch: pytest.MonkeyPatch
) -> None:
    await site.begin()
    left: list[M100Error] = []
    monkeypatch.setattr(site.show.performer, "give_way", left.append)
    site.show._placed_by = "anna"
    await site.push(site.revoked("eve"))
    assert left == []
    await site.push(site.revoked("anna"))
    assert [error.seen for error in left] == ["anna is revoked since 2026-11-22"]


# -- lists of revoked names: whose signature counts, and what no list can say ----------------------


NAMES = {"anna": "2026-11-22", "a9": "2026-11-23"}


class Authority:
    def __init__(self, folder: Path) -> None:
        init(folder, now=NOW)
        self.folder = folder
        key = load_pem_private_key((folder / "ca.key").read_bytes(), None)
        assert isinstance(key, ec.EllipticCurvePrivateKey)
        self.key = key
        self.certificate = x509.load_pem_x509_certificate((folder / "ca.pem").read_bytes())

    def signed(self, told: object) -> bytes:
        """Whatever it is, with a signature that fits."""
        line = json.dumps(told).encode() + b"\n"
        return line + base64.b64encode(self.key.sign(line, ec.ECDSA(SHA256())))


@pytest.fixture
def authority(tmp_path: Path) -> Authority:
    return Authority(tmp_path / "pki")


def test_what_the_authority_signed_is_read(authority: Authority) -> None:
    data = sign_revoked(3, NAMES, authority.key)
    found = Revoked.verified(data, authority.certificate)
    assert (found.number, found.names, found.data) == (3, NAMES, data)
    assert nobody("anna") == ""


def test_of_another_authority_or_changed_it_is_refused(
    authority: Authority, tmp_path: Path
) -> None:
    data = sign_revoked(3, NAMES, authority.key)
    other = Authority(tmp_path / "other")
    with pytest.raises(BadRevoked, match="not that of the authority"):
        Revoked.verified(data, other.certificate)
    without: Any = MagicMock(public_key=Ed25519PrivateKey.generate().public_key)
    with pytest.raises(BadRevoked, match="has no key that signs lists"):
        Revoked.verified(data, without)
    line_end = data.index(b"\n")
    for place in range(line_end + 1):  # each bit that is signed, the line feed, too
        changed = bytearray(data)
        changed[place] ^= 1
        with pytest.raises(BadRevoked):
            Revoked.verified(bytes(changed), authority.certificate)
    signature = base64.b64decode(data[line_end:])
    for place in range(len(signature)):
        wrong = bytearray(signature)
        wrong[place] ^= 1
        with pytest.raises(BadRevoked):
            changed_signature = data[: line_end + 1] + base64.b64encode(wrong)
            Revoked.verified(changed_signature, authority.certificate)
    with pytest.raises(BadRevoked):  # with a letter more that base64 does not have
        Revoked.verified(data.rstrip() + b"!\n", authority.certificate)


def test_a_list_has_32_kilobytes_at_most(authority: Authority) -> None:
    """Blanks behind the signature count, and mean nothing."""
    data = sign_revoked(3, NAMES, authority.key).ljust(32 * 1024, b"\n")
    assert Revoked.verified(data, authority.certificate).names == NAMES
    with pytest.raises(BadRevoked, match="at most 32768 bytes"):
        Revoked.verified(data + b"\n", authority.certificate)


@pytest.mark.parametrize("cut", [b"", b"\n", b"{}", b"\n\n\n", b"\xff" * 100, bytes(LARGEST + 1)])
def test_what_is_no_list_is_refused(authority: Authority, cut: bytes) -> None:
    with pytest.raises(BadRevoked):
        Revoked.verified(cut, authority.certificate)


@pytest.mark.parametrize(
    "told",
    [
        {"m100link": "revoked 2", "number": 1, "names": {}},
        {"m100link": "revoked 1", "number": 0, "names": {}},
        {"m100link": "revoked 1", "number": True, "names": {}},
        {"m100link": "revoked 1", "number": 1 << 60, "names": {}},
        {"m100link": "revoked 1", "number": 1, "names": ["anna"]},
        {"m100link": "revoked 1", "number": 1, "names": {"an na": "2026-11-22"}},
        {"m100link": "revoked 1", "number": 1, "names": {"anna": 2026}},
        {"m100link": "revoked 1", "number": 1, "names": {"anna": "x" * 33}},
        {"number": 1, "names": {}},
        [],
        7,
    ],
)
def test_what_is_signed_and_says_what_cannot_be_is_refused(
    authority: Authority, told: object
) -> None:
    with pytest.raises(BadRevoked, match="cannot read"):
        Revoked.verified(authority.signed(told), authority.certificate)


def test_too_many_names_are_reported_as_the_list_is_made(authority: Authority) -> None:
    many = {f"pilot-{number}-{'x' * 20}": "2026-11-22" for number in range(800)}
    with pytest.raises(BadRevoked, match="too many"):
        sign_revoked(1, many, authority.key)


@pytest.mark.skipif(shutil.which("openssl") is None, reason="needs openssl")
def test_openssl_verifies_a_list(authority: Authority, tmp_path: Path) -> None:
    line, signature = revoke(authority.folder, ["anna"], now=NOW).data.splitlines(keepends=True)
    (tmp_path / "line").write_bytes(line)
    (tmp_path / "signature").write_bytes(base64.b64decode(signature))
    certificate = str(authority.folder / "ca.pem")
    key = subprocess.run(
        ["openssl", "x509", "-in", certificate, "-pubkey", "-noout"],
        check=True,
        capture_output=True,
    ).stdout
    (tmp_path / "key").write_bytes(key)
    words = ["-sha256", "-verify", "key", "-signature", "signature", "line"]
    ended = subprocess.run(
        ["openssl", "dgst", *words], check=False, capture_output=True, cwd=tmp_path
    )
    assert ended.returncode == 0, ended.stderr


async def test_a_look_without_memory_is_not_the_last_one(
    site: Site, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Who is revoked by a file would steer on."""
    await site.begin()
    look, lacking = site.revocations.look, [MemoryError(), RuntimeError("can't start new thread")]

    async def lacks() -> bool:
        if lacking:
            raise lacking.pop()
        return await look()

    monkeypatch.setattr(site.revocations, "look", lacks)
    (site.onboard / LIST).write_bytes(site.revoked("anna"))
    await anyio.sleep(4.0)
    assert not lacking
    assert site.revocations.number == 1


# -- values: how often somebody looks, asks and waits ----------------------------------------------

KITE = Keys("field", "kite")
REPLY = OrderReply.done("", "kite", "boot", None, number=3)
NO_ROOM = OrderReply.done("", "kite", "boot", UsageError("no room"), number=3)


@pytest.mark.parametrize(
    ("replies", "asked", "seconds", "outcome"),
    [
        ([REPLY], 1, 0.0, 3),
        ([None, REPLY], 2, 0.2, 3),
        ([None, None, None, REPLY], 4, 1.2, 3),  # after 0, 0.2, 0.4 and 0.6 s
        ([None, None, None, None], 4, 1.2, OutcomeUnknown),
        ([NO_ROOM], 1, 0.0, UsageError),
        ([None, MessageError("another version")], 2, 0.2, MessageError),
    ],
)
async def test_a_list_is_brought_four_times_at_most(
    replies: list[Any], asked: int, seconds: float, outcome: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    bus: Any = MagicMock(
        tokens=AsyncMock(return_value=["m100-live/field/kite/beef"]),
        ask=AsyncMock(return_value=[]),
    )
    remaining = iter(replies)
    believed = MagicMock(side_effect=lambda *_: next(remaining))  # an error is given, not raised
    monkeypatch.setattr(revocations, "believed", believed)
    clock = asyncio.get_running_loop().time
    began = clock()
    if outcome == 3:
        assert (await in_force(bus, KITE, b"list")).number == 3
    else:
        with pytest.raises(outcome):
            await in_force(bus, KITE, b"list")
    assert clock() - began == pytest.approx(seconds)
    assert bus.tokens.mock_calls == [call("m100-live/field/kite/*", timeout=1.5)]
    told = call("m100/field/kite/revoked", bytes([VERSION]) + b"list", timeout=1.5)
    assert bus.ask.mock_calls == [told] * asked
    assert believed.mock_calls[0] == call([], KITE, "", {"beef"})


async def test_an_agent_that_comes_back_behind_its_router_gets_the_list(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Its router has just read a new list, and lets everybody come anew."""
    token = "m100-live/field/kite/beef"
    bus: Any = MagicMock(
        tokens=AsyncMock(side_effect=[[], [], [token]]), ask=AsyncMock(return_value=[])
    )
    monkeypatch.setattr(revocations, "believed", MagicMock(return_value=REPLY))
    assert (await in_force(bus, KITE, b"list")).number == 3
    bus.tokens = AsyncMock(return_value=[])
    with pytest.raises(Unreachable):
        await in_force(bus, KITE, b"list")
    assert bus.tokens.await_count == 4


class Served:
    """The service of one aircraft, its list, and questions to it."""

    def __init__(self) -> None:
        self.bus, self.cut_off, self.notes = MagicMock(), list[int](), list[tuple[str, str]]()
        self.list: Any = MagicMock(
            number=3, rights=None, on_change=[], keep=AsyncMock(), look=AsyncMock()
        )
        shut_out = [lambda: self.cut_off.append(1), lambda: self.cut_off.append(2)]
        self.service = RevocationService(
            *(self.bus, KITE, "boot", self.list),
            shut_out=shut_out,
            note=lambda text, level: self.notes.append((text, level)),
        )
        self.answers: list[OrderReply] = []
        self.dropped = 0

    def ask(self, payload: bytes) -> None:
        def answer(key: str, data: bytes) -> None:
            assert key == KITE.revoked
            self.answers.append(unpack(OrderReply, data))

        def drop() -> None:
            self.dropped += 1

        self.service._on_question(Question(KITE.revoked, payload, answer, drop))


async def test_eight_lists_wait_at_most_and_a_long_one_is_not_read() -> None:
    one, disk = Served(), asyncio.Event()
    one.list.keep.side_effect = disk.wait
    for number in range(9):
        one.ask(bytes([VERSION, number]))
    await asyncio.sleep(0.1)
    assert (one.dropped, len(one.answers)) == (1, 0)
    disk.set()
    await asyncio.sleep(0.1)
    assert one.list.take_in.mock_calls == [call(bytes([number])) for number in range(8)]
    assert [reply.number for reply in one.answers] == [3] * 8
    one.ask(bytes([VERSION] * 32_770))
    assert one.dropped == 2
    one.ask(bytes([VERSION] * 32_769))
    await asyncio.sleep(0.1)
    assert (one.dropped, len(one.answers)) == (2, 9)


@pytest.mark.parametrize(
    ("payload", "error", "kind"),
    [
        (bytes([VERSION]), None, None),  # which one is in force is asked
        (bytes([VERSION + 1]) + b"list", None, "MessageError"),
        (bytes([VERSION]) + b"list", BadRevoked("an older one"), "UsageError"),
        (bytes([VERSION]) + b"list", UsageError("no room"), "UsageError"),
    ],
)
async def test_the_answer_to_a_list_says_why_it_is_not_in_force(
    payload: bytes, error: M100Error | None, kind: str | None
) -> None:
    one = Served()
    one.list.keep.side_effect = error
    one.ask(payload)
    await asyncio.sleep(0.1)
    [reply] = one.answers
    told = (reply.id, reply.name, reply.boot, reply.number)
    assert told == ("", "kite", "boot", 3)
    assert (reply.fault.kind if reply.fault else None) == kind
    assert one.list.take_in.called is (error is not None)


async def test_an_agent_looks_for_a_list_each_second_and_leaves_nothing_behind() -> None:
    one, disk = Served(), asyncio.Event()
    one.list.look.side_effect = [False, UsageError("it cannot be read"), True, False]
    one.list.keep.side_effect = disk.wait
    running = asyncio.create_task(one.service.run())
    await asyncio.sleep(3.5)
    assert one.list.look.await_count == 3
    assert one.notes == [("revoked.list: it cannot be read", "error")]
    assert one.bus.serve.mock_calls[0] == call(
        "m100/field/kite/revoked", one.service._on_question, depth=8
    )
    one.list.revoked = Revoked(7, {"anna": "2026-11-22", "bert": "2026-11-23"})
    [changed] = one.list.on_change
    changed()
    assert one.cut_off == [1, 2], "each that may give orders"
    assert one.notes[1:] == [("list 7 of revoked names is in force: anna, bert", "warning")]
    one.ask(bytes([VERSION]) + b"list")
    await asyncio.sleep(0.1)
    running.cancel()
    await asyncio.wait([running])
    await asyncio.sleep(0.1)
    disk.set()
    await asyncio.sleep(0.1)
    assert one.list.on_change == []
    assert one.answers == [], "what waited is ended with it"
    one.bus.serve.return_value.close.assert_called_once_with()


async def test_a_file_is_read_when_it_was_written_anew_and_kept_for_all_to_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, written = tmp_path / LIST, MagicMock(wraps=replace_file)
    monkeypatch.setattr(revocations, "replace_file", written)
    assert Revocations(MagicMock())._written() is None, "it is kept nowhere"
    with pytest.raises(UsageError, match=f"{tmp_path} cannot be read: Is a directory"):
        Revocations(MagicMock(), tmp_path)._written()
    one = Revocations(MagicMock(), path)
    assert one._written() is None
    path.write_bytes(b"first")
    assert (one._written(), one._written()) == (b"first", None)
    at = path.stat().st_mtime_ns
    path.write_bytes(b"again")  # as long, in the same file
    os.utime(path, ns=(at, at + 1))
    assert one._written() == b"again"
    path.write_bytes(b"x" * 40_000)
    assert one._written() == b"x" * 32_769, "one byte more than a list may have"
    one.revoked = Revoked(1, {}, b"in force")
    for _ in range(2):
        await one.keep()
    written.assert_called_once_with(path, b"in force", mode=0o666)
    assert path.read_bytes() == b"in force"
    mask = os.umask(0)
    os.umask(mask)
    assert path.stat().st_mode & 0o777 == 0o666 & ~mask, "it has no secret"


def test_a_newer_list_alone_comes_into_force_and_once(tmp_path: Path) -> None:
    authority, path = Authority(tmp_path / "ca"), tmp_path / LIST
    first, second = (revoke(authority.folder, [name], now=NOW).data for name in ("eve", "anna"))
    one, told = Revocations(authority.certificate, path), list[int]()
    one.on_change.append(lambda: told.append(one.number))
    assert (one.read(), one.number) == (False, 0)
    path.write_bytes(second)
    assert (one.read(), one.read(), one.take_in(second), one.number) == (True, False, False, 2)
    beside = sign_revoked(2, {"bert": "2026-11-22"}, authority.key)
    for older in (first, beside):
        with pytest.raises(BadRevoked, match="list 2 is in force"):
            one.take_in(older)
    assert told == [2]
    assert [one.since(name) for name in ("anna", "eve", "bert")] == ["2026-11-22"] * 2 + [""]


async def test_a_list_is_brought_to_nobody_where_no_agent_is_present() -> None:
    bus: Any = MagicMock(tokens=AsyncMock(return_value=[]), ask=AsyncMock(return_value=[]))
    with pytest.raises(Unreachable, match="no agent named kite"):
        await in_force(bus, KITE, b"list")
    assert not bus.ask.called
