"""Tables of what goes into the link, its requests and its transports, and what comes out."""

from __future__ import annotations

import asyncio
import errno
import logging
import math
import socket
from dataclasses import asdict
from types import SimpleNamespace
from typing import Any, cast
from unittest.mock import Mock, call, patch

import pytest

from m100link import (
    AckTimeout,
    AuthorityRefused,
    BadAck,
    BadURL,
    CommandNotSupported,
    CommandRefused,
    KeyRejected,
    LevelTooLow,
    LinkClosed,
    NoAnswer,
    NotActivated,
    NoValidFrame,
    PortBusy,
    PortFailed,
    PortNotFound,
    PortPermissionDenied,
    SilentLine,
    UsageError,
)
from m100link.link import Link, open_link, transport
from m100link.link.gate import descriptor_of
from m100link.link.keyfile import is_at, read_token
from m100link.link.requests import Requests
from m100link.link.statistics import RoundTrips, excerpt
from m100link.link.url import ConnectionString, parse_url
from m100link.protocol import GetVersion, Move, RequestAuthority, Version
from m100link.protocol.codes import VersionCode
from m100link.protocol.command import Command
from m100link.protocol.commands.gimbal import TakePhoto
from m100link.protocol.firmware import PROFILES
from m100link.session.events import Expired, Latency
from m100link.wire import Cipher, Frame, FrameDecoder, encode_frame
from tests import limits
from tests.link.peer import connected, settle
from tests.support import KEY

pytestmark = pytest.mark.anyio

CIPHER = Cipher(KEY)
ACTIVE, INACTIVE = VersionCode.ACTIVATED, VersionCode(0xFF01)


def version(code: VersionCode = ACTIVE, firmware: str = "3.1") -> Version:
    known = PROFILES[firmware]
    return Version(code, 7, known.version_name, "041" if known.has_serial else None)


class Road:
    """A link that answers as the test says, and notes what it was asked."""

    is_recorded = is_serial = False
    name = "line"

    def __init__(self, *answers: bytes | Exception, cipher: Cipher | None = None) -> None:
        self.answers = list(answers)
        self.cipher = cipher
        self.asked: list[dict[str, Any]] = []
        self.pushed: list[tuple[bytes, bool]] = []
        self.heard = (0, 0, 0)  # bytes, frames, bytes of no frame

    async def request(self, data: bytes, **how: Any) -> bytes:
        self.asked.append({"data": data, **how})
        answer = self.answers.pop(0)
        if isinstance(answer, Exception):
            raise answer
        return answer

    def push(self, data: bytes, *, encrypted: bool) -> bool:
        self.pushed.append((data, encrypted))
        return True

    def statistics(self) -> Any:
        names = ("bytes_received", "frames_received", "discarded_bytes")
        return SimpleNamespace(**dict(zip(names, self.heard, strict=True)))


def requests(road: Road, firmware: str | None = "3.1") -> Requests:
    return Requests(cast(Any, road), None if firmware is None else PROFILES[firmware])


# -- requests --------------------------------------------------------------------------------------

PUSHED_CODES = {0xFF00: CommandNotSupported, 0xFF01: NotActivated, 0xFF02: LevelTooLow}
"""The document's system codes (2.2, "not supported", "not activated", "level too low")."""


@pytest.mark.parametrize(("code", "kind"), PUSHED_CODES.items())
async def test_a_system_code_has_its_own_error(code: int, kind: type[CommandRefused]) -> None:
    for refusal in (CommandRefused, AuthorityRefused):
        with pytest.raises(kind) as caught:
            await requests(Road(code.to_bytes(2, "little"))).execute(
                RequestAuthority(obtain=True), refusal=refusal
            )
        assert type(caught.value) is kind
        assert caught.value.code == code
        assert caught.value.command == RequestAuthority.NAME
        assert f"0x{code:04X}" in caught.value.seen


@pytest.mark.parametrize(
    ("cipher", "given", "encrypted"),
    [
        (None, None, False),
        (CIPHER, None, True),  # of set 1, as soon as there is a key
        (CIPHER, False, False),
        (CIPHER, True, True),
    ],
)
async def test_a_request_is_encrypted_once_there_is_a_key_and_asked_as_it_was_told(
    cipher: Cipher | None, given: bool | None, encrypted: bool
) -> None:
    road = Road(b"\x02\x00", version().encode(), cipher=cipher)
    made = requests(road)
    await made.execute(RequestAuthority(obtain=True), timeout=0.7, tries=5, encrypted=given)
    await made.execute(GetVersion())
    first, second = road.asked
    assert {key: first[key] for key in ("encrypted", "timeout", "tries", "name")} == {
        "encrypted": encrypted,
        "timeout": 0.7,
        "tries": 5,
        "name": RequestAuthority.NAME,
    }
    assert (second["encrypted"], second["timeout"], second["tries"]) == (False, 0.5, 3)


NO_ACK = AckTimeout("no ack")
OLD_KEY, UNSUPPORTED = b"\x02\x00", b"\x00\xff"


@pytest.mark.parametrize(
    ("answers", "encrypted", "kind"),
    [
        ([NO_ACK, version().encode()], None, KeyRejected),  # plain requests are answered
        ([NO_ACK, NO_ACK], None, AckTimeout),  # nor are they: the line is dead
        ([NO_ACK], False, AckTimeout),
        ([b"\x07"], None, KeyRejected),
        ([b"\x07"], False, BadAck),
        ([UNSUPPORTED], None, KeyRejected),
        ([UNSUPPORTED], False, CommandNotSupported),
        ([b"\x01\xff"], None, NotActivated),
        # A key that was understood once is right, whatever comes later.
        ([OLD_KEY, NO_ACK], None, AckTimeout),
        ([OLD_KEY, b"\x07"], None, BadAck),
        ([OLD_KEY, UNSUPPORTED], None, CommandNotSupported),
    ],
)
async def test_who_is_blamed_for_an_answer_that_cannot_be_used(
    answers: list[bytes | Exception], encrypted: bool | None, kind: type[Exception]
) -> None:
    road = Road(*answers, cipher=CIPHER)
    made = requests(road)
    if answers[0] == OLD_KEY:
        await made.execute(RequestAuthority(obtain=True))
    with pytest.raises(kind) as caught:
        await made.execute(RequestAuthority(obtain=True), encrypted=encrypted)
    assert type(caught.value) is kind
    assert not road.answers


@pytest.mark.parametrize(
    ("cipher", "known", "answer", "level", "kind"),
    [
        (CIPHER, None, None, None, None),
        (CIPHER, None, None, 1, None),
        (CIPHER, None, None, 2, None),
        (CIPHER, None, None, 0, LevelTooLow),
        (None, ACTIVE, None, None, None),  # another program activated it
        (None, ACTIVE, None, 0, LevelTooLow),
        (None, None, ACTIVE, None, None),
        (None, INACTIVE, ACTIVE, None, None),
        (None, None, INACTIVE, None, NotActivated),
        (None, INACTIVE, INACTIVE, 2, NotActivated),
    ],
)
async def test_what_would_be_ignored_in_silence_is_not_sent(
    cipher: Cipher | None,
    known: VersionCode | None,
    answer: VersionCode | None,
    level: int | None,
    kind: type[CommandRefused] | None,
) -> None:
    """Photographs want level 1 of an aircraft that is active (document 2.1)."""
    road = Road(*([] if answer is None else [version(answer).encode()]), cipher=cipher)
    made = requests(road)
    made.version = None if known is None else version(known)
    made.level = level
    if kind is None:
        await made.send(TakePhoto())
        assert [encrypted for _, encrypted in road.pushed] == [cipher is not None]
    else:
        with pytest.raises(kind, match=f"{TakePhoto.NAME} was not sent"):
            await made.send(TakePhoto())
        assert road.pushed == []
    assert not road.answers


@pytest.mark.parametrize(
    ("cipher", "command", "encrypted"),
    [
        (None, TakePhoto(), False),
        (CIPHER, TakePhoto(), True),
        (CIPHER, GetVersion(), False),
    ],
)
def test_what_a_guardian_sends_is_encrypted_as_its_command_says(
    cipher: Cipher | None, command: Command, encrypted: bool
) -> None:
    wire = requests(Road(cipher=cipher)).prepared(command, session=5, sequence=771)
    [frame] = FrameDecoder(CIPHER).feed(wire)
    assert (frame.session, frame.sequence, frame.encrypted) == (5, 771, encrypted)
    assert frame.data == command.encode(PROFILES["3.1"])


async def test_what_the_firmware_knows_is_asked_anew_for_each_firmware() -> None:
    road = Road(version(firmware="2.3").encode(), version(firmware="1.0").encode())
    made = requests(road, None)
    await made.query_version()
    assert made.push(TakePhoto())
    await made.query_version()
    with pytest.raises(CommandNotSupported, match=TakePhoto.NAME):
        made.push(TakePhoto())
    assert len(road.pushed) == 1


async def test_which_firmware_a_version_answer_chooses(caplog: pytest.LogCaptureFixture) -> None:
    for forced, fixed, found, chosen in (
        (None, None, "3.1", "3.1"),
        (None, None, "2.3", "2.3"),
        ("1.0", None, "3.1", "1.0"),
        (None, "2.3", "3.1", "2.3"),
    ):
        road = Road(version(firmware=found).encode())
        made = requests(road, forced)
        assert made.knows_layout is made.knows_firmware is (forced is not None)
        if fixed is not None:
            made._choose_firmware(version(firmware=fixed))
            made.fix_firmware()
        await made.query_version()
        assert made.firmware is PROFILES[chosen]
        assert made.knows_layout
        assert made.knows_firmware
        assert ("which is flying: kept" in caplog.text) is (fixed is not None)
        caplog.clear()


@pytest.mark.parametrize("serial", [None, "041"])
async def test_an_unknown_firmware_gets_telemetry_alone(serial: str | None) -> None:
    made = requests(Road(), None)
    made.version = Version(ACTIVE, 7, "SDK-v9.0 M999-09.09.09.09", serial)
    made._choose_firmware(made.version)
    assert not made.knows_firmware
    with pytest.raises(UsageError, match=r"unknown firmware \(SDK-v9\.0"):
        made.push(Move(0x4B, 1.0, 0.0, 0.0, 0.0))
    with pytest.raises(UsageError, match="control authority is not asked"):
        made.fix_firmware()


@pytest.mark.parametrize(("forced", "firmware"), [(None, "2.3"), ("3.1", "3.1")])
async def test_the_version_of_a_recording_is_that_of_then(
    forced: str | None, firmware: str
) -> None:
    road = Road()
    road.is_recorded = True
    made = requests(road, forced)
    made.take_recorded(version(firmware="2.3"), PROFILES["2.3"])
    assert made.firmware is PROFILES[firmware]
    assert made.knows_firmware
    assert made.knows_layout
    assert await made.query_version() == version(firmware="2.3")
    assert road.asked == []


@pytest.mark.parametrize(
    ("heard", "kind", "words"),
    [
        ((0, 0, 0), SilentLine, "not one byte arrived (line, "),
        ((640, 0, 640), NoValidFrame, "640 bytes arrived and not one valid frame (line, "),
        ((640, 3, 321), NoAnswer, "3 frames arrived, but no answer to a version query, and 321 of"),
        ((640, 3, 320), NoAnswer, "3 frames arrived, but no answer to a version query (line, "),
    ],
)
@pytest.mark.parametrize(
    ("is_serial", "timeout", "unheard_s", "heard_s"),
    [(True, None, 3.0, 15.0), (False, None, 8.0, 15.0), (True, 4.0, 4.0, 4.0), (False, 9, 9, 9)],
)
async def test_how_long_an_aircraft_is_looked_for_and_what_is_said_then(
    heard: tuple[int, int, int],
    kind: type[NoAnswer],
    words: str,
    is_serial: bool,
    timeout: float | None,
    unheard_s: float,
    heard_s: float,
) -> None:
    """As the manual has it: 15 s if it is heard within 3 s by a cable, within 8 s by a network."""
    road = Road()
    road.heard, road.is_serial = heard, is_serial
    asked: list[dict[str, Any]] = []

    async def waits(data: bytes, **how: Any) -> bytes:
        asked.append(how)
        await asyncio.sleep(60.0)
        raise AssertionError

    road.request = waits  # type: ignore[method-assign]  # nobody answers
    for never in (0.0, -1.0, math.inf, math.nan):
        with pytest.raises(UsageError, match=f"can answer within {never} s"):
            await requests(road, None).find_aircraft(never)
    await asyncio.sleep(100.0)
    loop = asyncio.get_running_loop()
    begun_at = loop.time()
    with pytest.raises(kind) as caught:
        await requests(road, None).find_aircraft(timeout)
    is_heard = 2 * heard[2] <= heard[0] > 0
    seconds = heard_s if is_heard else unheard_s
    assert loop.time() - begun_at == pytest.approx(seconds, abs=0.01)
    assert words in caught.value.seen
    assert f"(line, {seconds:.3g} s)" in caught.value.seen
    assert (caught.value.bytes_received, caught.value.frames_received) == heard[:2]
    # One question under one number for as long as it takes, every 0.3 s.
    [how] = asked
    assert how["timeout"] == 0.3
    assert (how["tries"] - 1) * 0.3 >= (heard_s if timeout is None else timeout)
    assert how["tries"] * 0.3 < (heard_s if timeout is None else timeout) + 0.61


# -- link ------------------------------------------------------------------------------------------


async def test_each_counter_stands_under_its_own_name() -> None:
    link = Link()
    names = ("acks", "duplicate_acks", "late_acks", "foreign_acks", "expired")
    counted = {name: number for number, name in enumerate(names, 11)}
    latency = Latency()
    latency.note(0.025)
    link._endpoint = cast(
        Any,
        SimpleNamespace(
            decoder=SimpleNamespace(
                bytes=1001, frames=102, discarded_bytes=503, discards={"header_crc": 4, "crc": 0}
            ),
            statistics=SimpleNamespace(**counted, requests=40, transmissions=47),
            sender=SimpleNamespace(latency=latency),
        ),
    )
    link._bytes_sent, link._frames_sent, link._dropped_writes = 901, 82, 23
    link._round_trips = RoundTrips().plus(0.03)
    link.missed(3)
    link.missed(5)
    assert asdict(link.statistics()) == {
        **counted,
        "bytes_received": 1001,
        "bytes_sent": 901,
        "frames_received": 102,
        "frames_sent": 82,
        "discards": {"header_crc": 4},
        "discarded_bytes": 503,
        "dropped_writes": 23,
        "repeats": 7,
        "round_trips": asdict(RoundTrips().plus(0.03)),
        "missed_setpoints": 8,
        "round_trip_s": 0.025,
    }


@pytest.mark.parametrize(
    ("trip_s", "silent_s", "writable", "cause"),
    [
        (0.02, 0.1, True, "the frame or its ack was lost, or the aircraft ignores the command"),
        (0.4, 0.1, True, "ignores the command; the line is slow: 0.4 s round trip"),
        (0.02, 1.5, True, "nothing has come from the aircraft for 1.5 s"),
        (0.4, 1.5, True, "nothing has come from the aircraft for 1.5 s"),
        (0.4, None, True, "nothing arrives from the aircraft at all"),
        (0.4, None, False, "the other end of the line does not take bytes"),
    ],
)
async def test_a_request_without_an_ack_names_the_likely_cause(
    trip_s: float, silent_s: float | None, writable: bool, cause: str
) -> None:
    link, _, _ = await connected()
    link.latency.note(trip_s)
    if silent_s is not None:
        link.last_received_at = link.loop.time()
        await asyncio.sleep(silent_s)
    if not writable:
        link.pause_writing()
    found = link._timeout("land", Expired(9, 4, 771, 3))
    assert cause in found.cause
    assert found.cause.endswith("round trip") is ("round trip" in cause)
    assert (found.command, found.session, found.sequence, found.tries) == ("land", 4, 771, 3)


class Port(asyncio.Transport):
    """A line with a file, of which nothing leaves."""

    def __init__(self, **extra: object) -> None:
        super().__init__(extra)
        self.written: list[bytes] = []

    def write(self, data: bytes | bytearray | memoryview[Any]) -> None:
        self.written.append(bytes(data))

    def get_write_buffer_size(self) -> int:
        return sum(map(len, self.written))

    def fileno(self) -> int:
        return 0

    def abort(self) -> None:
        pass


async def test_a_gate_hears_what_waits_and_the_counters_what_was_written() -> None:
    told: list[int] = []
    link, port = Link(first_sequence=0), Port()
    link.connection_made(port)
    link.gate = SimpleNamespace(opens=lambda size: size != 16 + 4, wrote=told.append)
    assert link.push(b"one")
    assert link.push(b"seven77")
    assert not link.push(b"four")  # held back
    assert told == [19, 19 + 23]
    statistics = link.statistics()
    assert (statistics.frames_sent, statistics.bytes_sent) == (2, 42)
    assert statistics.dropped_writes == 1
    link.connection_lost(None)


@pytest.mark.parametrize(
    ("extra", "number"),
    [
        ({}, None),
        ({"serial": SimpleNamespace(fileno=lambda: 0)}, 0),
        ({"serial": SimpleNamespace(fileno=lambda: 7)}, 7),
        ({"socket": SimpleNamespace(fileno=lambda: 8)}, 8),
        ({"serial": SimpleNamespace(fileno=lambda: -1)}, None),  # it is closed
        ({"serial": SimpleNamespace(fileno=lambda: None)}, None),
    ],
)
async def test_the_open_file_of_a_line_is_known_where_it_has_one(
    extra: dict[str, Any], number: int | None
) -> None:
    assert descriptor_of(Port(**extra)) == number
    link = Link()
    assert not link.is_serial
    link.connection_made(Port(**extra))
    assert link.descriptor == number
    assert link.is_serial is ("serial" in extra)
    link.connection_lost(None)
    assert link.descriptor is None


@pytest.mark.parametrize(
    ("key", "asked", "came_encrypted", "leaves_encrypted"),
    [
        (CIPHER, None, True, True),
        (CIPHER, None, False, False),
        (CIPHER, False, True, False),
        (CIPHER, True, False, True),
        (None, None, True, False),  # the key is gone: a plain answer is better than none
        (None, None, False, False),
        (None, False, True, False),
    ],
)
async def test_how_a_command_is_answered(
    key: Cipher | None, asked: bool | None, came_encrypted: bool, leaves_encrypted: bool
) -> None:
    came: list[Frame] = []
    link, port = Link(on_received=lambda frame, _: came.append(frame)), Port()
    link.connection_made(port)
    link.cipher = CIPHER
    cipher = CIPHER if came_encrypted else None
    link.data_received(encode_frame(b"question", session=2, sequence=7, cipher=cipher))
    [command] = came
    link.cipher = key
    link.acknowledge(command, b"answer", encrypted=asked)
    [answer] = FrameDecoder(CIPHER).feed(b"".join(port.written))
    assert (answer.is_ack, answer.session, answer.sequence) == (True, 2, 7)
    assert (answer.data, answer.encrypted) == (b"answer", leaves_encrypted)
    link.connection_lost(None)


@pytest.mark.parametrize(
    ("data", "data_at", "shown"),
    [
        (b"\x02\x00abc", 0, "0200616263"),
        (bytes(64), 0, "00" * 64),
        (bytes(65), 0, "00" * 64 + "…"),
        (b"\x00\x01\x99\x98", 0, "0001…"),  # an activation, whose app id follows
        (b"\x00\x01", 0, "0001"),
        (b"\xaa" * 12 + b"\x00\x01\x99\x98", 12, "aa" * 12 + "0001…"),
        (b"\xaa" * 12 + b"\x01\x00\x99\x98", 12, "aa" * 12 + "01009998"),
        (b"\x00\x01" * 6 + b"\x01\x00\x99", 12, "0001" * 6 + "010099"),
    ],
)
def test_what_the_log_shows_of_a_frame(data: bytes, data_at: int, shown: str) -> None:
    assert excerpt(data, data_at=data_at) == shown


async def test_the_log_cuts_an_activation_off_where_it_begins(
    caplog: pytest.LogCaptureFixture,
) -> None:
    """Behind a header of 12 bytes (document 1.2) stand set and id, and then the app id."""
    caplog.set_level(logging.DEBUG, "m100link")
    link, port = Link(first_sequence=0), Port()
    link.connection_made(port)
    link.push(b"\x00\x01\x02\x03\x04\x05")
    [line] = [record.getMessage() for record in caplog.records]
    assert line == f"> {port.written[0][:14].hex()}…"
    link.connection_lost(None)


# -- addresses and files ---------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("url", "baud_rate", "found"),
    [
        ("/dev/ttyUSB0", 57600, ("serial", "/dev/ttyUSB0", 57600)),
        ("/dev/serial/by-path/a:1.0-port0", 57600, ("serial", "/dev/serial/by-path/a:1.0-port0")),
        ("/dev/serial/by-id/usb-FTDI:115200", 57600, ("serial", "/dev/serial/by-id/usb-FTDI")),
        ("/dev/ttyUSB0:1", None, ("serial", "/dev/ttyUSB0", 1)),
        ("../tty", None, ("serial", "../tty", 230_400)),
        ("tcp://host:1", 57600, ("tcp", "host", 1)),
        ("tcp://host:65535", None, ("tcp", "host", 65_535)),
        ("replay://a.mcap?speed=2", 57600, ("replay", "a.mcap?speed=2", None)),
        ("x-1.y+z://", None, ("x-1.y+z", "", None)),
    ],
)
def test_an_address_is_read_as_it_is_written(
    url: str, baud_rate: int | None, found: tuple[Any, ...]
) -> None:
    seen = parse_url(url, baud_rate=baud_rate)
    rate = {"by-path": 57600, "by-id": 115_200}.get(url.partition("serial/")[2].partition("/")[0])
    assert seen == ConnectionString(*(found if len(found) == 3 else (*found, rate)))


def test_a_secret_may_be_as_long_as_it_is_read(tmp_path: Any) -> None:
    path = tmp_path / "token"
    path.write_bytes(b"x" * 4096)
    path.chmod(0o600)
    assert read_token(path) == "x" * 4096
    for mode in (0o610, 0o620, 0o601, 0o602):
        path.chmod(mode)
        with pytest.raises(UsageError, match=f"mode {mode:o}"):
            read_token(path)
    path.chmod(0o400)
    assert len(read_token(path)) == 4096


def test_whether_an_open_file_still_stands_there(tmp_path: Any) -> None:
    path, other = tmp_path / "one", tmp_path / "two"
    for file in (path, other):
        file.touch()
    with path.open() as file:
        assert is_at(file.fileno(), path)
        assert not is_at(file.fileno(), other)
        path.unlink()
        assert not is_at(file.fileno(), path)


# -- opening a line --------------------------------------------------------------------------------

ADDRESS = ConnectionString("serial", "/dev/ttyUSB0", 115_200)
GUARDIAN = ((17, "python"), (4711, "m100link-guard"))


@pytest.mark.parametrize(
    ("error", "owners", "is_ours", "kind", "seen", "cause"),
    [
        (OSError(2, "x"), (), False, PortNotFound, "there is no device /dev/ttyUSB0", "plugged"),
        (OSError(13, "x"), (), False, PortPermissionDenied, "this user may not open", "dialout"),
        (OSError(1, "x"), (), False, PortPermissionDenied, "this user may not open", "dialout"),
        (OSError(16, "x"), GUARDIAN, True, PortBusy, "by this program itself", "aclose()"),
        (OSError(16, "x"), GUARDIAN, False, PortBusy, "m100link-guard (process 4711)", "guardian"),
        (OSError(11, "x"), GUARDIAN[:1], False, PortBusy, "by python (process 17)", "only one"),
        (OSError(16, "x"), (), False, PortBusy, "/dev/ttyUSB0 is in use", "only one"),
        (OSError(25, "x"), (), False, PortFailed, "is not a serial port", "a file, or a device"),
        (OSError(21, "x"), (), False, PortFailed, "is not a serial port", "a folder"),
        (OSError(22, "x"), (), False, PortFailed, "at 115200 baud: ", "an adapter"),
        (ValueError("rate"), (), False, PortFailed, "at 115200 baud: rate", "an adapter"),
        (OSError(24, "many"), (), False, PortFailed, "cannot be opened: ", "leaks"),
        (OSError(23, "many"), (), False, PortFailed, "cannot be opened: ", "leaks"),
        (OSError(5, "gone"), (), False, PortFailed, "cannot be opened: ", ""),
    ],
)
def test_each_refusal_of_the_system_is_an_error_of_its_own(
    monkeypatch: pytest.MonkeyPatch,
    error: Exception,
    owners: tuple[tuple[int, str], ...],
    is_ours: bool,
    kind: type[Exception],
    seen: str,
    cause: str,
) -> None:
    """Numbers of Linux's errno.h, as every kernel there has them."""
    monkeypatch.setattr(transport, "port_owners", lambda _: owners)
    monkeypatch.setattr(transport, "serial_ports", lambda: ["/dev/ttyACM3"])
    monkeypatch.setattr(transport, "_is_ours", lambda _: is_ours)
    found = transport._translate("/dev/ttyUSB0", ADDRESS, error)
    assert type(found) is kind
    assert seen in found.seen
    assert cause in found.cause
    assert bool(found.cause) is bool(cause)
    if isinstance(found, PortBusy):
        assert found.owners == owners


def test_the_number_of_the_system_is_found_where_pyserial_left_it() -> None:
    plain, before = ValueError("cannot configure"), OSError(errno.ENOTTY, "x")
    assert transport._errno_of(before) == errno.ENOTTY
    assert transport._errno_of(plain) is None
    plain.__context__ = before
    assert transport._errno_of(plain) == errno.ENOTTY
    plain.__context__ = ValueError("no number")
    assert transport._errno_of(plain) is None


async def test_a_host_that_takes_no_connection_is_waited_for_twelve_seconds(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    async def never(*_: object, **__: object) -> None:
        await asyncio.sleep(600.0)

    loop = asyncio.get_running_loop()
    monkeypatch.setattr(loop, "create_connection", never)
    begun_at = loop.time()
    with pytest.raises(PortFailed, match="nothing answers at tcp://host:7: no connection in time"):
        await open_link("tcp://host:7")
    assert loop.time() - begun_at == pytest.approx(12.0)
    full = Mock(side_effect=OSError(errno.EMFILE, "Too many open files"))
    monkeypatch.setattr(loop, "create_connection", full)
    with pytest.raises(PortFailed, match="tcp://host:7 cannot be opened: ") as caught:
        await open_link("tcp://host:7")
    assert "leaks" in caught.value.cause
    with pytest.raises(BadURL, match="is a recorded flight, and not a line"):
        await open_link("replay://flight.mcap")


async def test_a_host_gets_setpoints_of_seconds_and_is_lost_after_twenty(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """What a host does not take must not become old, and one that is gone must be noticed."""
    asked: list[tuple[Any, ...]] = []
    limits: list[dict[str, int]] = []
    port = Port(socket=SimpleNamespace(setsockopt=lambda *how: asked.append(how)))
    port.set_write_buffer_limits = lambda **how: limits.append(how)  # type: ignore[method-assign]

    async def connect(make: Any, host: str, number: int) -> tuple[Port, Link]:
        assert (host, number) == ("192.168.1.5", 7000)
        link = make()
        link.connection_made(port)
        return port, link

    monkeypatch.setattr(asyncio.get_running_loop(), "create_connection", connect)
    link = await open_link("tcp://192.168.1.5:7000")
    assert limits == [{"high": 2048}]
    assert set(asked) == {
        (socket.IPPROTO_TCP, socket.TCP_NOTSENT_LOWAT, 4096),
        (socket.SOL_SOCKET, socket.SO_SNDBUF, 65_536),
        (socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, 20_000),  # ms
    }
    link.connection_lost(None)
    await settle()
    assert link.failure is not None
    assert not isinstance(link.failure, LinkClosed)


def test_each_limit_is_as_agreed() -> None:
    assert limits.differences("link") == []


@pytest.mark.parametrize("error", [None, OSError(errno.EIO, "gone")])
def test_a_polled_port_drops_what_it_did_not_send_and_ends(error: OSError | None) -> None:
    """Its base waits for the other end to read, on the event loop."""
    port, ended = Mock(), Mock()
    port.reset_output_buffer.side_effect = error
    polled = object.__new__(transport._PolledTransport)
    polled._serial = port
    base = "m100link.link.transport.serial_asyncio.SerialTransport._call_connection_lost"
    with patch(base, ended):
        polled._call_connection_lost(None)
        assert port.mock_calls == [call.reset_output_buffer()], "and not what came"
        ended.assert_called_once_with(None)
        polled._serial = None
        polled._call_connection_lost(None)
        ended.assert_called_once()
