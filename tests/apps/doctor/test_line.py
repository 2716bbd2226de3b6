"""Each limit by which a line is judged, from both sides of it.

Limits are those of the manual (docs/reference/diagnoses.md) and of what is known of adapters: a
frame in fifty may be damaged, and a twentieth of the bytes; a wire that is joined to nothing picks
up less than 200 bytes; a port keeps at most 8 KiB from before.
"""

from __future__ import annotations

import random
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from m100link.apps.doctor import diagnosis, line
from m100link.apps.doctor.line import Heard, hear
from m100link.apps.doctor.port import Stage, Verdict
from m100link.link.serial_transport import read_inverted
from m100link.link.url import ConnectionString, parse_url
from m100link.wire import Frame
from m100link.wire.frame import encode_frame
from tests.apps.doctor.bench import CONSOLE, GPS, TELEMETRY, mavlink

pytestmark = pytest.mark.anyio

GOOD, DOUBTFUL, FAILED = Verdict.GOOD, Verdict.DOUBTFUL, Verdict.FAILED
[FRAME] = hear(TELEMETRY).frames


def heard(
    frames: int, *, damaged: int = 0, discarded: int = 0, size: int = 10_000, frame: Frame = FRAME
) -> Heard:
    half = damaged // 2
    causes = {"header_crc": half, "frame_crc": damaged - half, "no_key": 1000, "length": 1000}
    return Heard(bytes(size), (frame,) * frames, discarded, causes)


@pytest.mark.parametrize(
    ("found", "verdict"),
    [
        (heard(100), GOOD),
        # Three pieces are nothing, however few frames there are.
        (heard(10, damaged=3), GOOD),
        (heard(10, damaged=4), DOUBTFUL),
        # Beyond that: 2 % of the good ones.
        (heard(1000, damaged=20), GOOD),
        (heard(1000, damaged=21), DOUBTFUL),
        # Of the bytes 5 % may be part of no frame.
        (heard(100, discarded=500), GOOD),
        (heard(100, discarded=501), DOUBTFUL),
    ],
)
def test_how_much_damage_is_a_doubt(found: Heard, verdict: Verdict) -> None:
    told = line._frames(found)
    assert (told.stage, told.verdict) == (Stage.FRAMES, verdict)
    assert bool(told.causes) is (verdict is DOUBTFUL)


@pytest.mark.parametrize(
    ("size", "discarded", "is_left"),
    [
        (1000, 500, False),  # half of the bytes are frames
        (1000, 501, True),
        (20_000, 11_808, True),  # 8192 bytes of frames
        (20_000, 11_807, False),
    ],
)
def test_few_frames_among_much_else_may_have_waited_in_the_port(
    size: int, discarded: int, is_left: bool
) -> None:
    assert line._may_be_left_behind(heard(5, discarded=discarded, size=size)) is is_left


@pytest.mark.parametrize(
    ("size", "seen"), [(199, "an aircraft sends far more"), (200, "not one valid frame")]
)
async def test_how_few_bytes_are_picked_up_from_the_air(size: int, seen: str) -> None:
    noise = bytes((n * 89 + 130) % 251 | 0x80 for n in range(size))
    told = await line._no_frames(parse_url("tcp://127.0.0.1:9"), hear(noise))
    assert told.verdict is FAILED
    assert seen in told.seen
    assert ("an aircraft sends far more" in told.seen) is (size < 200)


class _Ear:
    """A port at which the same bytes come at once."""

    lost, is_lost = None, False

    def __init__(self, data: bytes) -> None:
        self.data = bytearray(data)

    async def listen(self, seconds: float) -> None:
        pass

    def say(self, data: bytes) -> None:
        pass

    async def close(self) -> None:
        pass


@pytest.mark.parametrize(
    ("damaged", "found"),
    [(0, 115_200), (1, 115_200), (2, None), (5, None)],  # among two good frames
)
async def test_a_rate_at_which_half_is_damage_is_not_named(
    damaged: int, found: int | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What waited in the port from before, or came by chance, names no rate."""
    spoilt = TELEMETRY[:40] + b"\x00" + TELEMETRY[41:]
    heard = {115_200: TELEMETRY + spoilt * damaged + TELEMETRY}

    async def open_ear(address: ConnectionString) -> _Ear:
        return _Ear(heard.get(address.number or 0, b"\x91" * 100))

    monkeypatch.setattr(line, "open_ear", open_ear)
    assert await line._scan(parse_url("serial:///dev/ttyUSB9:230400")) == found


@pytest.mark.parametrize("count", [2, 3])
def test_three_frames_that_end_too_early_are_bytes_that_another_reader_took(count: int) -> None:
    cut = TELEMETRY[:60] * count + TELEMETRY[:13]
    likeness = hear(cut).likeness()
    assert (likeness is not None and likeness.name == "cut") is (count >= 3)


@pytest.mark.parametrize(("printable", "is_text"), [(90, True), (89, False)])
def test_nine_bytes_of_ten_that_can_be_printed_are_text(printable: int, is_text: bool) -> None:
    data = bytes(33 + n % 60 for n in range(printable)) + bytes(
        128 + n for n in range(100 - printable)
    )
    likeness = hear(data).likeness()
    assert (likeness is not None and likeness.name == "text") is is_text


def test_how_long_it_is_listened_to() -> None:
    """The slowest item comes once a second, and an answer within 0.1 s."""
    assert 1.0 < line.LISTEN_S < 2.0
    assert 0.2 <= line.ANSWER_S <= 0.5
    assert 0.2 <= line.SCAN_S <= 1.0
    assert 1.0 < diagnosis.TELEMETRY_S < 2.0


# -- what bytes look like that are no frames -------------------------------------------------------


def test_frames_are_counted_and_what_is_cut_off_at_the_end_is_no_damage() -> None:
    heard = hear(TELEMETRY * 10 + TELEMETRY[:30])
    assert (len(heard.frames), heard.discarded_bytes, heard.damaged_share) == (10, 0, 0.0)
    assert heard.count(bytes([2, 0])) == 10
    assert heard.details()["frames"] == 10


def test_damage_is_counted() -> None:
    spoilt = TELEMETRY[:40] + b"\x00" + TELEMETRY[41:]
    heard = hear(TELEMETRY + spoilt * 2 + TELEMETRY)
    assert len(heard.frames) == 2
    assert heard.discards["frame_crc"] == 2
    assert heard.damaged_share == pytest.approx(0.5)


@pytest.mark.parametrize(
    ("data", "name"),
    [
        (bytes(300), "held low"),
        (b"\xff" * 300, "one value"),
        (GPS, "a GPS receiver"),
        (CONSOLE, "text"),
        (mavlink(0xFE, 8), "MAVLink"),
        (b"\x01\x02" + mavlink(0xFD, 12), "MAVLink"),
        (read_inverted(TELEMETRY) * 5, "inverted"),
    ],
)
def test_what_it_looks_like(data: bytes, name: str) -> None:
    likeness = hear(data).likeness()
    assert likeness is not None
    assert likeness.name == name
    assert likeness.causes
    assert likeness.commands


def test_a_frame_cut_in_reads_of_an_inverted_line_is_recognised() -> None:
    """Each burst is a frame; what stands before it is noise."""
    noise = random.Random(3).randbytes(500)
    likeness = hear(noise + read_inverted(TELEMETRY) * 4).likeness()
    assert likeness is not None
    assert likeness.name == "inverted"


@pytest.mark.parametrize("seed", range(20))
def test_noise_looks_like_nothing(seed: int) -> None:
    assert hear(random.Random(seed).randbytes(8000)).likeness() is None


def test_a_wrong_baud_rate_looks_like_nothing() -> None:
    garbled = bytes((byte * 0x1D ^ 0xE6 ^ index * 7) & 0xFF for index, byte in enumerate(TELEMETRY))
    assert hear(garbled * 50).likeness() is None


def name_of(data: bytes) -> str | None:
    likeness = hear(data).likeness()
    return None if likeness is None else likeness.name


def text_of(share: float) -> bytes:
    """A hundred bytes, so many of them printable, the others unlike each other."""
    printable = round(100 * share)
    return b"T" * printable + bytes(range(128, 228 - printable))


@pytest.mark.parametrize(
    ("least", "fewer"),
    [
        (TELEMETRY[:40] * 3 + TELEMETRY, TELEMETRY[:40] * 2 + TELEMETRY),
        (text_of(0.90), text_of(0.89)),
        (mavlink(0xFE, 8)[: 3 * 17], mavlink(0xFE, 8)[: 2 * 17]),
        (mavlink(0xFD, 12)[: 3 * 21], mavlink(0xFD, 12)[: 2 * 21]),
        (read_inverted(TELEMETRY) * 3, read_inverted(TELEMETRY) * 2),
        (b"\x00\x00", b"\x00\x01"),
    ],
    ids=["cut", "text", "MAVLink 1", "MAVLink 2", "inverted", "held low"],
)
def test_how_much_of_it_is_enough(least: bytes, fewer: bytes) -> None:
    """Three frames that are cut, of MAVLink or inverted, nine printable bytes of ten, one value."""
    assert name_of(least) is not None
    assert name_of(fewer) is None


@pytest.mark.parametrize(
    ("data", "seen", "cause"),
    [
        (bytes(7), "all 7 bytes are 00", "held low"),
        (b"\xff" * 7, "all 7 bytes are ff", "repeats one byte"),
        (TELEMETRY[:40] * 5 + TELEMETRY, "5 frames begin well", "another program reads"),
        (b"SSH-2.0-OpenSSH_9.2p1 Debian\r\n", "'SSH-2.0-OpenSSH", "another program listens"),
        (b"Ubuntu 24.04 tty1\r\nPassword: ", "'Ubuntu", "a login prompt"),
        (b"T=23.5 RH=40\r\n" * 9, "'T=23.5", "another device that talks text"),
        (mavlink(0xFE, 8), "it is MAVLink 1", "an autopilot"),
        (b"\x01\x02" + mavlink(0xFD, 12), "it is MAVLink 2", "an autopilot"),
        # Half a message at the end is no reason to doubt those before it.
        (mavlink(0xFD, 12)[: 3 * 21 + 9], "it is MAVLink 2", "an autopilot"),
        (read_inverted(TELEMETRY) * 4, "4 frames are in it", "RS-232"),
    ],
)
def test_what_is_said_of_it(data: bytes, seen: str, cause: str) -> None:
    likeness = hear(data).likeness()
    assert likeness is not None
    assert seen in likeness.seen
    assert cause in likeness.causes[0]


def test_frames_that_follow_each_other_are_not_cut() -> None:
    """Of any length that a frame can have: ten bits of the header say it (document 1.3.1)."""
    long = encode_frame(bytes([2, 0, *(n % 251 for n in range(700))]), session=0, sequence=1)
    short = encode_frame(b"\x02\x00", session=0, sequence=2)
    assert hear((long + short) * 5).cut_frames() == 0
    assert hear(long[:600] + short + long).cut_frames() == 1
    assert hear(long[:-1] + short).cut_frames() == 1


def test_acks_are_no_packages() -> None:
    package = bytes([2, 0, *range(9)])
    heard = hear(
        encode_frame(package, session=0, sequence=1)
        + encode_frame(package, session=0, sequence=2, is_ack=True)
        + encode_frame(bytes([2, 1]), session=0, sequence=3)
    )
    assert len(heard.frames) == 3
    assert heard.count(bytes([2, 0])) == 1


def test_nothing_at_all_is_no_damage() -> None:
    assert hear(b"").damaged_share == 0.0
    assert hear(b"").details() == {
        "bytes": 0,
        "frames": 0,
        "discarded_bytes": 0,
        "discards": {},
        "first_bytes": "",
    }
    assert hear(bytes(range(200))).details()["first_bytes"] == bytes(range(64)).hex(" ")


@given(st.binary(min_size=1, max_size=600))
def test_no_bytes_raise(data: bytes) -> None:
    heard = hear(data)
    heard.likeness()
    assert heard.details()["bytes"] == len(data)


@pytest.mark.parametrize(
    ("url", "least"), [("/dev/ttyUSB0", 2.0), ("tcp://h:1", 2.0 + 8.0), ("udp://h:1", 10.0)]
)
async def test_a_network_that_is_silent_is_listened_to_for_longer_and_a_port_is_not(
    url: str, least: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    heard_for: list[float] = []

    class Ear(_Ear):
        async def listen(self, seconds: float) -> None:
            heard_for.append(seconds)

    async def opened(_: ConnectionString) -> Any:
        return Ear(b"")

    monkeypatch.setattr(line, "open_ear", opened)
    await line.look_at_line(parse_url(url))
    assert least <= sum(heard_for) < least + line.LISTEN_S
