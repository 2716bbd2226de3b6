"""Readers of files and of single values, without an aircraft: what is read is written again.

Where there is a writer, what it makes of what was read is read as the same.
"""

from __future__ import annotations

import asyncio
import base64
import json
import math
import os
import tempfile
from collections.abc import Callable, Mapping
from contextlib import suppress
from datetime import UTC, datetime
from functools import cache
from io import BytesIO
from pathlib import Path
from typing import Any
from unittest.mock import MagicMock, Mock, patch
from zlib import crc32

from cryptography import x509
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.hashes import SHA256
from cryptography.hazmat.primitives.serialization import load_pem_private_key
from mcap.writer import CompressionType, Writer

from m100link.apps.agent import orders
from m100link.apps.agent.messages import RemoteError, Steer
from m100link.apps.bus.network import QueryAnswer
from m100link.apps.cli.decode import _from_hex
from m100link.apps.cli.fleet import borrowed
from m100link.apps.doctor.line import hear
from m100link.apps.doctor.machine import Machine
from m100link.apps.fleet.asking import believed, clocks_of
from m100link.apps.fleet.keys import Keys, name_in, session_in
from m100link.apps.fleet.logs.words import (
    LogReply,
    pack_entries,
    pack_reply,
    unpack_entries,
    unpack_reply,
)
from m100link.apps.fleet.order_log import AuditLog, FileOrderLog, Mark, seal
from m100link.apps.fleet.payloads import (
    Card,
    MissionCard,
    OrderMessage,
    OrderReply,
    Progress,
    ShowCard,
    ShowStage,
    pack,
    pack_steer,
    unpack,
    unpack_steer,
)
from m100link.apps.fleet.pki import init
from m100link.apps.fleet.revocations import AUTHORITY, LIST, Revocations, Revoked, sign_revoked
from m100link.apps.fleet.show.conductor import _part
from m100link.apps.fleet.show.plan.conflicts import ConflictMonitor
from m100link.apps.fleet.show.plan.document import Show, imported
from m100link.apps.fleet.show.plan.track import TimedTrack
from m100link.apps.fleet.signing import Seal, audited
from m100link.apps.mavlink.bridge import SignatureMemory, Snapshot
from m100link.apps.mavlink.translator.codec import (
    LAYOUTS,
    MavlinkMessage,
    MessageReader,
    PacketSigner,
    ending_command,
    write_frame,
)
from m100link.apps.ros2.graph import read_attachment, write_attachment
from m100link.apps.ros2.graph import read_token as read_ros2_token
from m100link.apps.station.config import resolve
from m100link.apps.station.console.view.texts import DisplaySettings
from m100link.apps.station.foxglove import FoxgloveChannel, Viewer
from m100link.apps.station.web.access_control import Access, AccessControl
from m100link.errors import M100Error, UsageError
from m100link.flight.guardian_process import HALF_SIZE, opened, sealed
from m100link.link.keyfile import read_key, read_token
from m100link.log import read, recover
from m100link.log.cdr import DEFINITIONS
from m100link.log.cdr import decode as decode_cdr
from m100link.log.cdr import encode as encode_cdr
from m100link.log.channels import (
    CHUNKS,
    COMMAND,
    EVENT,
    FIX,
    LINK,
    RX,
    TELEMETRY,
    TX,
    FrameInterpreter,
)
from m100link.log.folder import LogEntry, _is_ours
from m100link.log.pcapng import read_frames, write_pcapng
from m100link.log.picture import page
from m100link.log.recorder import Redaction
from m100link.log.records import registered
from m100link.log.ros2 import write_bag
from m100link.log.story import read_story
from m100link.protocol.firmware import PROFILES
from m100link.protocol.setpoint import Setpoint
from m100link.sim.orders import CtlServer
from m100link.sim.virtual import VirtualAircraft
from tests.apps.fleet.show.shows import track

__all__ = [
    "answers",
    "audit",
    "audit_seeds",
    "cdr_seeds",
    "events",
    "fleet_values",
    "foxglove",
    "frames_seeds",
    "gate",
    "guardian_page",
    "hex_lines",
    "keys",
    "ledger",
    "ledger_seeds",
    "log_seeds",
    "logs",
    "machine",
    "mavlink",
    "of_file",
    "page_seeds",
    "place",
    "read_cdr",
    "read_lease_file",
    "read_show",
    "read_signatures",
    "revoked",
    "revoked_seeds",
    "sim_orders",
    "station_environment",
    "tokens",
    "value_seeds",
    "witnessed",
]

_UTC = 1_800_000_000.0


@cache
def folder() -> Path:
    """A folder of this process, in memory where the system has a place for that."""
    memory = Path("/dev/shm")
    where = memory if os.access(memory, os.W_OK) else None
    made = tempfile.TemporaryDirectory(prefix="m100link-fuzz-", dir=where)
    _FOLDERS.append(made)
    return Path(made.name)


_FOLDERS: list[tempfile.TemporaryDirectory[str]] = []  # removed with the process


def place() -> Path:
    """The file in it whose content is the input."""
    return folder() / "input"


def of_file(reader: Callable[[Path], object]) -> Callable[[bytes], object]:
    """A reader of the content of a file, as one of bytes."""

    def work(data: bytes) -> object:
        path = place()
        path.write_bytes(data)
        path.chmod(0o600)
        return reader(path)

    return work


def _same(one: object, other: object) -> None:
    """By their texts: NaN is not equal to itself."""
    assert repr(one) == repr(other), f"{one!r} was written, and {other!r} was read again"


# -- MAVLink --------------------------------------------------------------------------------------

_KEY = bytes(range(32))


def frames_seeds() -> list[bytes]:
    """Every message, signed and not."""
    seeds = []
    for number, name in enumerate(LAYOUTS):
        signer = PacketSigner(_KEY) if number % 2 else None
        message = MavlinkMessage(name, {})
        seeds.append(write_frame(message, system=9, sequence=number, signer=signer, now=10**9))
    seeds.append(b"\xfe\x09\x00\x09\xbe\x00" + bytes(11))  # a frame of version 1, damaged
    return seeds


def mavlink(data: bytes) -> None:
    """A datagram, by one that knows a key and one that does not, and by a flood's look at it."""
    ending_command(data)
    for signer in (PacketSigner(_KEY), None):
        for message in MessageReader(data, signer=signer, now=10**9):
            frame = write_frame(message, system=message.system, sequence=0)
            [again] = MessageReader(frame)
            _same(again.fields, message.fields)


def read_signatures(data: bytes) -> None:
    """The memory of signatures."""
    signer = PacketSigner(_KEY)
    memory = SignatureMemory(folder(), signer)
    memory.path.write_bytes(data)
    if not memory.recall(10**9):
        memory.write(Snapshot(signer.sent, dict(signer.newest)))
        again = PacketSigner(_KEY)
        assert not SignatureMemory(folder(), again).recall(10**9)
        assert again.sent >= signer.sent


# -- CDR ------------------------------------------------------------------------------------------

_TYPES = tuple(DEFINITIONS)


def _small(kind: str) -> Any:
    """A value of a type, with one value in each sequence."""
    if kind not in DEFINITIONS:
        return "a" if kind == "string" else 0
    made: dict[str, Any] = {}
    for line in DEFINITIONS[kind].splitlines():
        of, name = line.split()
        of, bracket, count = of.partition("[")
        one = _small(of.partition("<=")[0])
        count = count.rstrip("]")
        made[name] = [one] * (int(count) if count.isdigit() else 1) if bracket else one
    return made


def cdr_seeds() -> list[bytes]:
    """The number of a type, and a message of it; the attachment of one."""
    return [
        bytes([number]) + encode_cdr(kind, _small(kind)) for number, kind in enumerate(_TYPES)
    ] + [b"\xff" + write_attachment(1, 2, bytes(16))]


def read_cdr(data: bytes) -> None:
    """A message of any type, and an attachment."""
    if data[:1] == b"\xff":
        found = read_attachment(data[1:])
        again = write_attachment(found.sequence, found.at_ns, found.gid)
        _same(read_attachment(again), found)
        return
    kind = _TYPES[(data[0] if data else 0) % len(_TYPES)]
    message = decode_cdr(kind, data[1:])
    _same(decode_cdr(kind, encode_cdr(kind, message)), message)


def tokens(data: bytes) -> None:
    """Keys and tokens, which are texts of others."""
    text = data.decode("utf-8", "replace")
    read_ros2_token(text)
    name_in(text)
    session_in(text)


# -- flight logs ----------------------------------------------------------------------------------


@cache
def log_seeds(streams: tuple[bytes, ...]) -> list[bytes]:
    """Short logs: packed, and as they are without a checksum, so that content is reached.

    Args:
        streams: What was received.
    """
    told: dict[str, Any] = {
        LINK: {"firmware": "1.0", "received_frames": 1},
        EVENT: {"level": "info", "text": "connected"},
        COMMAND: {"command": "get_version", "is_ack": False, "direction": "tx"},
        TELEMETRY: {"time_tick": 1},
        FIX: {"latitude": 52.1, "longitude": 4.3, "altitude": 1.0},
    }
    seeds = []
    for compression in (CompressionType.NONE, CompressionType.ZSTD):
        is_plain = compression is CompressionType.NONE
        stream = BytesIO()
        writer = Writer(stream, compression=compression, enable_crcs=not is_plain)
        writer.start(library="m100link")

        def put(topic: str, data: bytes, writer: Writer = writer) -> None:
            at = int(_UTC * 1e9)
            writer.add_message(registered(writer, topic), at, data, at)

        for topic, content in told.items():
            put(topic, json.dumps(content).encode())
        for data in streams:
            for topic, direction in ((RX, "rx"), (TX, "tx")):
                put(topic, data)
                chunk = {"direction": direction, "offset_us": [0], "length": [len(data)]}
                put(CHUNKS, json.dumps(chunk).encode())
        writer.finish()  # type: ignore[no-untyped-call]  # mcap has no annotation there
        seeds.append(stream.getvalue())
    return [*seeds, seeds[0][:-200]]


def logs(data: bytes) -> None:
    """A flight log by everything that reads one, and mended."""
    path, mended = place(), folder() / "mended"
    path.write_bytes(data)
    _is_ours(path)
    kept = _all_of(path)
    mended.unlink(missing_ok=True)
    assert recover(path, mended) == kept
    assert _all_of(mended) == kept, "what was mended holds other messages"


def _all_of(path: Path) -> int:
    flight = read(path)
    count = sum(1 for _ in flight.messages())
    for work in (
        flight.summary,
        lambda: list(flight.moments()),
        lambda: list(flight.samples(firmware="1.0")),
        lambda: list(read_frames(flight, firmware="1.0")),
        lambda: page(read_story(flight, firmware="1.0")),
        lambda: write_bag(flight, BytesIO(), firmware="1.0"),
        lambda: write_pcapng(flight, BytesIO(), firmware="1.0"),
    ):
        with suppress(M100Error):
            work()
    return count


# -- what agents of a fleet keep ------------------------------------------------------------------


def ledger_seeds() -> list[bytes]:
    """A ledger, sealed and without checksums, with its mark or without."""
    words: list[dict[str, Any]] = [
        {"fence": 1000},
        {"id": "0" * 32, "boot": "boot", "up": 5.0},
        {"flies": 7, "at": _UTC, "boot": "boot", "up": 6.0},
    ]
    sealed = "".join(seal(number, 1, word) for number, word in enumerate(words, 1))
    older = "".join(json.dumps(word) + "\n" for word in words)
    mark = bytes(Mark(3, 1))
    return [mark + sealed.encode(), bytes(len(mark)) + older.encode(), mark + older.encode()]


def ledger(data: bytes) -> None:
    """A ledger with its mark, twice: what was kept is there again."""
    path = folder() / "a1.jsonl"
    size = len(bytes(Mark(0, 0)))
    mark, lines = data[:size], data[size:]
    for one in (lines, _sealed(lines)):
        path.write_bytes(one)
        path.with_suffix(".lock").write_bytes(b"" if not any(mark) else mark)
        known = None
        for _ in range(2):
            opened = FileOrderLog(path, lambda: _UTC, lambda: ("boot", 10.0))
            opened.close()
            found = opened.begun, opened.last_flight
            assert known is None or found == known, "another start knows something else"
            known = found
            assert all(type(at) is float for at in opened.begun.values())


def _sealed(data: bytes) -> bytes:
    """The JSON of each line with a right seal: a disk does not lie so, an older release may."""
    made = []
    for number, line in enumerate(data.split(b"\n"), 1):
        with suppress(ValueError, RecursionError, OverflowError):
            made.append(seal(number, 1, json.loads(line[line.index(b"{") :])).encode())
    return b"".join(made)


@cache
def _authority() -> tuple[x509.Certificate, ec.EllipticCurvePrivateKey, bytes]:
    where = folder() / "pki"
    if not where.exists():
        init(where, now=datetime(2026, 11, 22, 14, 0, tzinfo=UTC))
    key = load_pem_private_key((where / "ca.key").read_bytes(), None)
    assert isinstance(key, ec.EllipticCurvePrivateKey)
    pem = (where / AUTHORITY).read_bytes()
    return x509.load_pem_x509_certificate(pem), key, pem


def audit_seeds() -> list[bytes]:
    """A log of an aircraft with three orders, as it writes it."""
    log = AuditLog(None, _seal().audit, lambda: _UTC)
    for number in range(3):
        log.add({"order": f"Land {number}", "signer": "anna", "by": "a1", "outcome": "ok"})
    return [log.since(1, 1 << 20)]


def audit(data: bytes) -> None:
    """An audit log on board, which goes on, and its copy, which is verified."""
    path = folder() / "a1.audit"
    path.write_bytes(data)

    async def goes_on() -> None:
        AuditLog(path, _seal().audit, lambda: _UTC)

    asyncio.run(goes_on())
    found, wrong = audited(data, "a1", _authority()[0])
    repr((found, wrong)).encode()  # they are printed


@cache
def _seal() -> Seal:
    certificate, key, _ = _authority()
    return Seal(key, certificate)


def tracks(data: bytes) -> None:
    """A track of others: Skybrush's, or CSV."""
    path = place()
    path.write_bytes(data)
    imported([path], (22.5, 114.0))


def revoked_seeds() -> list[bytes]:
    """A list, and the certificate of who signs it."""
    _, key, pem = _authority()
    return [b"l" + sign_revoked(3, {"anna": "2026-11-22", "a9": "2026-11-23"}, key), b"c" + pem]


def revoked(data: bytes) -> None:
    """A list as it is, the same line signed, and a certificate, each in its folder."""
    certificate, key, pem = _authority()
    kind, rest = data[:1], data[1:]
    where = folder() / "revoked"
    where.mkdir(exist_ok=True)
    (where / AUTHORITY).write_bytes(rest if kind == b"c" else pem)
    (where / LIST).write_bytes(revoked_seeds()[0][1:] if kind == b"c" else rest)
    line = rest.partition(b"\n")[0] + b"\n"
    signed = line + base64.b64encode(key.sign(line, ec.ECDSA(SHA256()))) + b"\n"
    with suppress(UsageError):
        found = Revoked.verified(signed, certificate)
        again = Revoked.verified(sign_revoked(found.number, found.names, key), certificate)
        assert (again.number, again.names) == (found.number, found.names)
    Revocations.of_folder(where)


def keys(path: Path) -> None:
    """A key; a token where it is none."""
    with suppress(UsageError):
        read_token(path).encode()
    key = read_key(path)
    assert "0a0a" not in repr(key), "a key is shown"


def read_show(data: bytes) -> None:
    """A show; its tracks are written and read again."""
    for flown in Show.parse(data).tracks:
        assert TimedTrack.from_bytes(flown.to_bytes()) == flown, "another track is read"
        flown.moment(flown.begin + 1.0)
        assert min(flown.fastest) >= 0.0


def read_lease_file(data: bytes) -> None:
    """The lease that commands of one account share."""
    with patch("m100link.apps.cli.fleet.lease_file", lambda *_: place()):
        of_file(lambda _: borrowed("site", "a1"))(data)


# -- values of a fleet ----------------------------------------------------------------------------

_KEYS = Keys("field", "a1")
_VALUES = (OrderMessage, OrderReply, Card, MissionCard)
_TRACK = track("a1", (0, 0, 0, 4), (8, 12, 0, 5))


def value_seeds() -> list[bytes]:
    """A value by the number of its kind."""
    stands = ShowCard(ShowStage.FLYING, "0", 0.1, "")
    fault = RemoteError.of(UsageError("seen", remedy="do"))
    reply = OrderReply("0" * 32, "a1", "boot", Progress.DONE, fault=fault, show=stands)
    values: list[Any] = [
        OrderMessage("0" * 32, "field", "a1", "anna", 1, _UTC, orders.Land()),
        reply,
        Card("a1", "boot", _UTC, height_m=3.0),
        MissionCard("a1", "boot"),
    ]
    seeds = [bytes([number]) + pack(value) for number, value in enumerate(values)]
    entry = LogEntry("m100link-20260101-000000.mcap", 100, _UTC, is_written=False)
    seeds.append(b"\4" + pack_entries([entry]))
    seeds.append(b"\5" + pack_reply(LogReply("0" * 32, "a1", offset=0, size=5), b"bytes"))
    seeds.append(b"\6" + ConflictMonitor("s", "a2", 1.0, ((0.0, 1.0, 2.0),) * 2, 9.0).to_bytes())
    seeds.append(b"\7" + _TRACK.to_bytes())
    north = Setpoint.velocity(north=3.0, east=0.0, up=0.0, yaw_rate_deg_s=0.0)
    seeds.append(b"\x08" + pack_steer(Steer(1, 2.0, 0.3, north), "token", begins=True))
    return seeds


def fleet_values(data: bytes) -> None:
    """A value of any kind, which is written and read again."""
    number, rest = (data[0] if data else 0) % 9, data[1:]
    if number < len(_VALUES):
        found = unpack(_VALUES[number], rest)
        _same(unpack(_VALUES[number], pack(found)), found)
        repr(found).encode()  # it is printed, and logged
        if isinstance(found, OrderMessage):
            found.proves("token")
            assert found.order.right
        if isinstance(found, OrderReply):
            _part(found)
    elif number == 4:
        entries = unpack_entries(rest)
        _same(unpack_entries(pack_entries(entries)), entries)
    elif number == 5:
        reply, held = unpack_reply(rest)
        _same(unpack_reply(pack_reply(reply, held)), (reply, held))
    elif number == 6:
        ahead = ConflictMonitor.from_bytes(rest)
        ConflictMonitor.from_bytes(ahead.to_bytes())
        ahead.stands()
        assert math.isfinite(ahead.way)
    elif number == 7:
        assert TimedTrack.from_bytes(rest).to_bytes() == rest
    else:
        unpack_steer(rest, lambda fence: "token")


def answers(data: bytes) -> None:
    """Two answers to one question, of the aircraft and of a stranger."""
    first, _, second = data.partition(b"\n")
    given = [
        QueryAnswer(_KEYS.command, first, "1"),
        QueryAnswer(_KEYS.command, second or first, "2"),
    ]
    clocks_of(given, "a1")
    for sessions in (["1"], ["1", "2"]):
        with suppress(M100Error):
            believed(given, _KEYS, "0" * 32, sessions)


# -- the guardian ---------------------------------------------------------------------------------


def page_seeds() -> list[bytes]:
    """A half of its page with the end of a setpoint and that of a flight."""
    return [sealed(3, 900, [(0, 20, 2, b"frame"), (1, 500, 1, bytes(40)), (1, 0, 3, b"")])]


def guardian_page(data: bytes) -> None:
    """A half of its page: as it is, and with the checksum and the size that are right."""
    rest = data[4:HALF_SIZE].ljust(12, b"\0")
    rest = rest[:8] + (len(rest) - 12).to_bytes(4, "little") + rest[12:]
    for half in (data.ljust(16, b"\0"), crc32(rest).to_bytes(4, "little") + rest):
        found = opened(half)
        if found is None:
            continue
        generation, patience, *steps = found
        frames = [(end, gap, 1, one) for end in range(2) for gap, one in steps[end]]
        with suppress(ValueError):  # written out, they are too long
            assert opened(sealed(generation, patience, frames)) == found


# -- what is asked of servers ---------------------------------------------------------------------


def sim_orders(data: bytes) -> None:
    """A line to the simulator's socket."""
    server = CtlServer([VirtualAircraft(seed=1)], folder() / "ctl")
    json.dumps(server.answer(data))


def foxglove(data: bytes) -> None:
    """What a viewer says, in texts and in bytes."""
    viewer = Viewer(
        [FoxgloveChannel(1, "/m100/fix", "fix", "{}"), FoxgloveChannel(2, "/tf", "tf", "{}")], "one"
    )
    for number, one in enumerate(data.split(b"\n\n")[:8]):
        viewer.receive(one.decode("utf-8", "replace") if number % 3 < 2 else one, number * 0.1)
        for channel in (1, 2):
            viewer.publish(channel, 10**18, b"{}")
    for frame in viewer.next_frames(1 << 20):
        if isinstance(frame, str):
            json.loads(frame)


def gate(data: bytes) -> None:
    """The head of a request: path, query and headers, by lines."""
    # The parser of heads lets nothing else through.
    printable = bytes(one for one in data if one >= 0x20 or one == 0x0A)
    first, *lines = printable.split(b"\n")
    path, _, query = first.partition(b"?")
    headers = [tuple(line.partition(b": ")[::2]) for line in lines if b": " in line]
    asked = AccessControl(_nowhere, hosts=["station"], access=Access("0123456789abcdefXY"))
    open_to_all = AccessControl(_nowhere, hosts=["station"])
    for kind, scheme in (("http", "http"), ("websocket", "wss")):
        scope = {
            "type": kind,
            "scheme": scheme,
            "method": "GET",
            "path": path.decode("latin-1"),
            "raw_path": path,
            "query_string": query,
            "headers": headers,
        }
        for one in (asked, open_to_all):
            work = one(scope, _nothing, _sent)
            with suppress(StopIteration):
                work.send(None)


async def _nowhere(scope: Any, receive: Any, send: Any) -> None:
    """The application behind the gate."""


async def _nothing() -> dict[str, Any]:
    return {"type": "websocket.connect"}


async def _sent(message: Mapping[str, Any]) -> None:
    for name, value in message.get("headers", ()):
        assert b"\n" not in name + value, "a header in a header"
        assert b"\r" not in value, "a header in a header"


def events(data: bytes) -> None:
    """What the page's script emits, by everything that hears it."""
    from m100link.apps.station.console.components import component
    from m100link.apps.station.console.components.header import ReplayPart
    from m100link.apps.station.console.components.map import ClickPart
    from m100link.apps.station.console.components.plan import PlanPart

    DisplaySettings.from_text(data.decode("utf-8", "replace"))
    event = Mock(args=json.loads(data))
    with patch.object(component, "ui"):
        component.answer(event)
    for hear_it in (
        *(ClickPart._clicked, ClickPart._dragged, ReplayPart._held),
        *(PlanPart._clicked, PlanPart._moved, PlanPart._picked, PlanPart._opened),
    ):
        hear_it(MagicMock(), event)


# -- the rest -------------------------------------------------------------------------------------


def machine(data: bytes) -> None:
    """What other programs and devices say of themselves."""
    root = folder() / "machine"
    process = root / "proc" / "77"
    process.mkdir(parents=True, exist_ok=True)
    for name in ("comm", "cmdline"):
        (process / name).write_bytes(data)
    (root / "proc" / "consoles").write_bytes(data)
    one = Machine(root)
    one.modem_manager()
    one.is_kernel_console("/dev/null")
    one.login_programs("/dev/null")


def hex_lines(data: bytes) -> None:
    """A line of hex digits, and what was heard on a port."""
    hear(data)
    _from_hex(data.decode("utf-8", "replace"))


def witnessed(data: bytes) -> None:
    """What goes over a line, as logs keep it and tell it."""
    profile = PROFILES[sorted(PROFILES)[len(data) % len(PROFILES)]]
    witness, redaction = FrameInterpreter(5.0), Redaction()
    for told in (witness.sent(data, None, profile), witness.received(data, 1.0, None, profile)):
        json.dumps(list(told), default=repr)
    assert len(redaction.sent(data, 1.0)) == len(data)
    assert len(redaction.received(data, 1.1)) == len(data)


def station_environment(data: bytes) -> None:
    """The station's settings: one value for each variable of the environment."""
    text = data.decode("utf-8", "replace")
    for name in ("M100LINK_PORT", "M100LINK_APP_ID", "M100LINK_LEVEL", "M100LINK_URL"):
        with suppress(M100Error):
            resolve({}, {name: text})
