"""What holds for the decoder whatever arrives (hypothesis)."""

from __future__ import annotations

import sys
import zlib
from collections.abc import Callable, Iterable
from types import FrameType

import pytest
from hypothesis import given
from hypothesis import strategies as st

from m100link.wire import Cipher, Discard, Frame, FrameDecoder, encode_frame
from m100link.wire import frame as frame_module
from tests.support import KEY, all_frames, crc16, encrypted_frame, frame_at, raw_frame

SESSIONS = st.integers(0, 31)
SEQUENCES = st.integers(0, 0xFFFF)


@st.composite
def frames(draw: st.DrawFn) -> bytes:
    """A valid frame, plain, encrypted or a header alone."""
    make: Callable[..., bytes] = draw(st.sampled_from((raw_frame, raw_frame, encrypted_frame)))
    return make(
        draw(st.binary(max_size=40)),
        session=draw(SESSIONS),
        is_ack=draw(st.booleans()),
        sequence=draw(SEQUENCES),
    )


@st.composite
def damaged(draw: st.DrawFn) -> bytes:
    """A frame with one flipped bit, cut short, or with fields that cannot be (checksums good)."""
    kind = draw(st.sampled_from(("flip", "cut", "fields", "nest")))
    if kind == "nest":
        inner = b"".join(draw(st.lists(frames(), min_size=1, max_size=3)))
        return raw_frame(draw(st.binary(max_size=5)) + inner, crc32_error=draw(st.integers(0, 3)))
    if kind == "fields":
        return raw_frame(
            draw(st.binary(min_size=1, max_size=40)),
            version=draw(st.sampled_from((0, 0, 1, 63))),
            reserved0=draw(st.integers(0, 3)),
            reserved1=draw(st.sampled_from((0, 0, 1, 0xFFFFFF))),
            padding=draw(st.integers(0, 31)),
            encryption=draw(st.integers(0, 7)),
            length=draw(st.one_of(st.none(), st.integers(0, 1023))),
        )
    frame = bytearray(draw(frames()))
    if kind == "cut":
        return bytes(frame[: draw(st.integers(1, len(frame) - 1))])
    bit = draw(st.integers(0, len(frame) * 8 - 1))
    frame[bit // 8] ^= 1 << bit % 8
    return bytes(frame)


NOISE = st.one_of(
    st.binary(max_size=30),
    st.integers(1, 40).map(lambda count: b"\xaa" * count),
    st.lists(st.sampled_from(b"\xaa\x00\x0c\x20"), max_size=30).map(bytes),
)
STREAMS = st.lists(st.one_of(frames(), damaged(), NOISE), max_size=10).map(b"".join)
GARBAGE = st.binary(max_size=60).map(lambda noise: noise.replace(b"\xaa", b"\x55"))


@st.composite
def cuts(draw: st.DrawFn, stream: bytes) -> list[bytes]:
    """A stream in pieces, empty ones among them."""
    places = sorted(draw(st.lists(st.integers(0, len(stream)), max_size=20)))
    return [stream[a:b] for a, b in zip([0, *places], [*places, len(stream)], strict=True)]


def run(decoder: FrameDecoder, chunks: Iterable[bytes]) -> list[Frame]:
    """Feed the chunks and end the stream, watching what must hold after each."""
    found: list[Frame] = []
    fed = delivered = 0
    for chunk in chunks:
        before = len(found)
        found += decoder.feed(chunk)
        fed += len(chunk)
        delivered += sum(map(wire_size, found[before:]))
        assert decoder.pending <= 1022
        assert decoder.bytes == fed == delivered + decoder.discarded_bytes + decoder.pending
        assert decoder.frames == len(found)
    before = len(found)
    found += decoder.close()
    delivered += sum(map(wire_size, found[before:]))
    assert decoder.pending == 0
    assert fed == delivered + decoder.discarded_bytes
    return found


def wire_size(frame: Frame) -> int:
    """Bytes of a frame on the wire."""
    if not (frame.data or frame.padding):
        return 12  # or 16, but see _is_ambiguous
    return 16 + len(frame.data) + (frame.padding if frame.encrypted else 0)


def _is_ambiguous(stream: bytes) -> bool:
    """Whether a 16-byte frame without data is in a stream; its size shows nowhere in a Frame."""
    return any(
        stream[at : at + 2] == b"\xaa\x10" and frame_at(stream, at, KEY)
        for at in range(len(stream))
    )


@given(st.data(), STREAMS)
def test_any_chunking_of_any_stream_gives_the_frames_of_the_simple_model(
    data: st.DataObject, stream: bytes
) -> None:
    chunks = data.draw(cuts(stream))
    decoder = FrameDecoder(Cipher(KEY))
    found = [frame for chunk in chunks for frame in decoder.feed(chunk)] + decoder.close()
    assert found == all_frames(stream)


@given(st.data(), STREAMS)
def test_every_byte_is_delivered_discarded_or_pending(data: st.DataObject, stream: bytes) -> None:
    if not _is_ambiguous(stream):
        run(FrameDecoder(Cipher(KEY)), data.draw(cuts(stream)))


@given(st.lists(st.binary(max_size=200), max_size=20))
def test_no_bytes_at_all_make_it_raise(chunks: list[bytes]) -> None:
    for cipher in (None, Cipher(KEY)):
        decoder = FrameDecoder(cipher)
        for chunk in chunks:
            decoder.feed(chunk)
            assert decoder.pending <= 1022
        decoder.close()


@given(STREAMS, STREAMS)
def test_counts_do_not_depend_on_the_chunking(first: bytes, second: bytes) -> None:
    whole, split = FrameDecoder(Cipher(KEY)), FrameDecoder(Cipher(KEY))
    whole.feed(first + second)
    for at in range(len(first)):
        split.feed(first[at : at + 1])
    split.feed(second)
    whole.close()
    split.close()
    assert whole.discards == split.discards
    assert whole.discarded_bytes == split.discarded_bytes


@given(GARBAGE, st.lists(frames(), min_size=1, max_size=5), GARBAGE)
def test_garbage_without_start_bytes_around_frames_costs_none(
    before: bytes, wires: list[bytes], after: bytes
) -> None:
    alone = all_frames(b"".join(wires))
    decoder = FrameDecoder(Cipher(KEY))
    assert decoder.feed(before + b"".join(wires) + after) == alone
    assert decoder.discarded_bytes == len(before) + len(after)


@given(st.binary(max_size=60), frames(), st.binary(max_size=1100))
def test_garbage_may_delay_a_frame_but_not_lose_it(
    before: bytes, wire: bytes, after: bytes
) -> None:
    stream = before + wire + after
    wanted = all_frames(wire)[0]
    if wanted in all_frames(stream):  # noise that makes a frame of its own over it is excluded
        decoder = FrameDecoder(Cipher(KEY))
        found = decoder.feed(stream)
        found += decoder.feed(bytes(1023))
        assert wanted in found


@given(st.data(), st.lists(frames(), min_size=1, max_size=3))
def test_a_flipped_bit_never_makes_another_frame_and_costs_only_its_own(
    data: st.DataObject, wires: list[bytes]
) -> None:
    hit = data.draw(st.integers(0, len(wires) - 1), label="frame hit")
    wire = bytearray(wires[hit])
    bit = data.draw(st.integers(0, len(wire) * 8 - 1), label="bit")
    wire[bit // 8] ^= 1 << bit % 8
    stream = b"".join([*wires[:hit], bytes(wire), *wires[hit + 1 :]])
    decoder = FrameDecoder(Cipher(KEY))
    found = decoder.feed(stream) + decoder.close()
    intact = [all_frames(w)[0] for index, w in enumerate(wires) if index != hit]
    assert found == intact


@given(st.integers(13, 1023), st.lists(frames(), min_size=1, max_size=4), st.integers(0, 31))
def test_frames_behind_a_false_header_survive_whatever_length_it_claims(
    length: int, wires: list[bytes], session: int
) -> None:
    false_header = raw_frame(b"", length=length, session=session)[:12]
    stream = false_header + b"".join(wires)
    decoder = FrameDecoder(Cipher(KEY))
    found = decoder.feed(stream + bytes(1023))
    assert found[: len(wires)] == all_frames(b"".join(wires))


@given(st.binary(max_size=991), SESSIONS, SEQUENCES, st.booleans(), st.booleans())
def test_what_is_encoded_decodes_to_itself(
    data: bytes, session: int, sequence: int, is_ack: bool, encrypted: bool
) -> None:
    cipher = Cipher(KEY) if encrypted else None
    wire = encode_frame(data, session=session, sequence=sequence, is_ack=is_ack, cipher=cipher)
    make = encrypted_frame if encrypted and data else raw_frame
    assert wire == make(data, session=session, sequence=sequence, is_ack=is_ack)
    (frame,) = FrameDecoder(Cipher(KEY)).feed(wire)
    assert (frame.session, frame.sequence, frame.is_ack) == (session, sequence, is_ack)
    assert frame.data == data


# -- cost ------------------------------------------------------------------------------------------


def overlapping(gap: int) -> bytes:
    """Start bytes everywhere; a header with a right CRC16 begins at every so many bytes."""
    made = bytearray(b"\xaa" * 10)
    while len(made) < 4096:
        made += crc16(bytes(made[-10:])).to_bytes(2, "little") + b"\xaa" * (gap - 2)
    return bytes(made[:4096])


VALID_BUT_ENDLESS = raw_frame(bytes(1007))[:12]
HOSTILE = {
    "random": bytes((n * n * 7919 >> 5) & 0xFF for n in range(4096)),
    "start bytes": b"\xaa" * 4096,
    "start bytes and others": b"\xaa\xaa\x00" * 1365,
    "false headers": (VALID_BUT_ENDLESS[:-1] + bytes((VALID_BUT_ENDLESS[-1] ^ 1,))) * 341,
    "changing false headers": b"".join(
        raw_frame(bytes(1007), sequence=n, session=n % 32, crc16_error=1)[:12] for n in range(341)
    ),
    "good headers, bad frames": VALID_BUT_ENDLESS * 341,
    "good headers of ever new kinds, bad frames": b"".join(
        raw_frame(bytes(900 + n % 108), sequence=n, session=n % 32)[:12] for n in range(341)
    ),
    "headers of other versions that overlap": overlapping(3),
    "bad versions": raw_frame(b"", version=1) * 341,
}


SCAN = FrameDecoder._search.__code__  # where more than one frame is looked for


class Meter:
    """Counts work instead of time: calls made, bytes looked at, bytes under a CRC32."""

    def __init__(self, stream: bytes, chunk: int) -> None:
        self.calls = self.crc_bytes = self.scanned = 0
        decoder = FrameDecoder(Cipher(KEY))
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(frame_module, "crc32", self._crc32)
            sys.setprofile(self._profile)
            try:
                for at in range(0, len(stream), chunk):
                    decoder.feed(stream[at : at + chunk])
            finally:
                sys.setprofile(None)

    def _crc32(self, data: bytes, start: int) -> int:
        self.crc_bytes += len(data)
        return zlib.crc32(data, start)

    def _profile(self, frame: FrameType, event: str, argument: object) -> None:
        if event in ("call", "c_call"):
            self.calls += 1
        if event == "return" and frame.f_code is SCAN:
            self.scanned += len(frame.f_locals["data"])


@pytest.mark.parametrize("chunk", [1, 16, 62, 1 << 20])
@pytest.mark.parametrize("name", HOSTILE)
def test_the_cost_of_hostile_input_is_linear(name: str, chunk: int) -> None:
    size = len(HOSTILE[name])
    once, twice = Meter(HOSTILE[name], chunk), Meter(HOSTILE[name] * 2, chunk)
    # Per byte: some calls, at most one CRC32 of 1023 bytes per 12-byte header, and a buffer that
    # is looked through again only when something can come of it.
    assert once.calls <= 25 * size  # the worst has 18 up to Python 3.13; 3.14 counts 21 of the same
    assert once.crc_bytes <= size * 1023 / 12
    assert once.scanned <= size * (1 + 1023 / 12)
    # Twice the input, twice the work, but for what a full buffer more or less makes.
    for kind in ("calls", "crc_bytes", "scanned"):
        doubled, single = getattr(twice, kind), getattr(once, kind)
        assert doubled <= 2 * single + 3 * 1023 * 1023 / 12, kind


def test_dribbled_bytes_of_a_long_frame_are_looked_through_once() -> None:
    meter = Meter(raw_frame(bytes(1007)), 1)
    assert meter.scanned <= 1023 + 12 + 1
    assert meter.crc_bytes == 1023


def test_the_memory_of_headers_is_bounded() -> None:
    decoder = FrameDecoder()
    for n in range(20_000):
        decoder.feed(raw_frame(b"", session=n % 32, reserved1=n, crc16_error=1))
    assert len(decoder._headers) <= 4096


def test_each_of_many_overlapping_headers_of_another_version_is_counted() -> None:
    stream = overlapping(3)
    decoder = FrameDecoder()
    decoder.feed(stream)
    decoder.close()
    good = [
        at
        for at in range(len(stream) - 11)
        if stream[at] == 0xAA and crc16(stream[at : at + 12]) == 0
    ]
    assert len(good) > 1000
    discards = decoder.discards
    counted = discards[Discard.VERSION] + discards[Discard.RESERVED_BITS] + discards[Discard.LENGTH]
    assert counted == len(good)
    assert discards[Discard.VERSION] == sum(stream[at + 2] >> 2 > 0 for at in good)
