"""What is damaged costs itself alone, and what stands behind it is found."""

from __future__ import annotations

import io
import itertools
import random
import struct
from pathlib import Path

import pytest
from mcap.writer import CompressionType, Writer

from m100link.log import read, recorder, recover
from m100link.log import records as records_module
from m100link.log.damage import Losses
from m100link.log.records import RawMessage, _bytes, _length_of_part, _unpacked, records
from tests.log.flight import flown

pytestmark = pytest.mark.anyio

SEED = 20261123
PART = 6


@pytest.fixture
async def whole(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> bytes:
    """A flight in many parts."""
    monkeypatch.setattr(recorder, "FLUSH_S", 0.0)  # of the wall clock: a part for each batch
    path = tmp_path / "flight.mcap"
    await flown(path)
    return path.read_bytes()


def parts(whole: bytes) -> list[tuple[int, int]]:
    """Where each part begins and ends."""
    found = []
    at = 8
    while at + 9 <= len(whole) and not whole.startswith(b"\x89MCAP", at):
        end = at + 9 + int.from_bytes(whole[at + 1 : at + 9], "little")
        if whole[at] == PART:
            found.append((at, end))
        at = end
    return found


def messages(data: bytes) -> list[RawMessage]:
    return [one for one in records(io.BytesIO(data)) if isinstance(one, RawMessage)]


def changed(data: bytes, at: int, value: int | None = None) -> bytes:
    byte = data[at] ^ 0x55 if value is None else value
    return data[:at] + bytes((byte,)) + data[at + 1 :]


@pytest.mark.parametrize("place", [1, 2, 8, 9 + 16, 9 + 32, 9 + 36, 9 + 37, 9 + 38, 9 + 40, 60])
@pytest.mark.parametrize("is_cut", [False, True], ids=["whole", "cut off"])
async def test_a_part_that_is_damaged_costs_itself_alone(
    whole: bytes, place: int, is_cut: bool
) -> None:
    found = parts(whole)
    assert len(found) > 5
    if is_cut:
        whole = whole[: found[-1][1]]
    every = messages(whole)
    for number in (0, 3, len(found) - 1):
        begin, end = found[number]
        others = messages(whole[:begin] + whole[end:])
        kept = messages(changed(whole, begin + place))
        assert len(kept) >= len(others) > 0.5 * len(every), f"part {number}"
        assert set(kept) <= set(every)


async def test_of_a_part_that_has_begun_before_nothing_is_passed_over(whole: bytes) -> None:
    every = messages(whole)
    drawn = random.Random(SEED).sample(every, 5)
    for since in [one.log_time for one in (*drawn, every[-1])]:
        stream = io.BytesIO(whole)
        found = [one for one in records(stream, (), since) if isinstance(one, RawMessage)]
        assert set(found) <= set(every)
        assert {one for one in every if one.log_time >= since} <= set(found), since
    assert len(found) < len(every) / 2, "parts that have ended are not read"


class Growing(io.BytesIO):
    """A file whose program writes more of it at each seek of its reader."""

    def __init__(self, data: bytes, size: int, step: int) -> None:
        super().__init__(data[:size])
        self._rest, self._step = data[size:], step

    def seek(self, at: int, whence: int = 0) -> int:
        found = super().seek(at, whence)
        new, self._rest = self._rest[: self._step], self._rest[self._step :]
        super().seek(0, 2)
        self.write(new)
        return super().seek(found)


async def test_a_file_that_grows_is_read_as_it_was_when_it_was_opened(whole: bytes) -> None:
    """Its reader went on for ever behind the end that it had seen."""
    drawn = random.Random(SEED)
    for _ in range(30):
        size = drawn.randrange(len(whole))
        growing = Growing(whole, size, step=drawn.choice((1, 40, 5_000, len(whole))))
        found = list(itertools.islice(records(growing), 100_000))
        assert found == list(records(io.BytesIO(whole[:size]))), f"{size} bytes"


@pytest.mark.parametrize("value", [0x01, 0x7F, 0xFF])
async def test_a_length_beyond_any_file_costs_one_part_at_most(
    whole: bytes, value: int, tmp_path: Path
) -> None:
    """The system seeks to no place beyond 2 to the 63, nor beyond its largest file."""
    begin, end = parts(whole)[3]
    (path := tmp_path / "flight.mcap").write_bytes(changed(whole, begin + 8, value))
    kept = list(read(path).messages())
    assert len(kept) >= len(messages(whole[:begin] + whole[end:]))


async def test_one_byte_anywhere_costs_one_part_at_most(whole: bytes) -> None:
    every = messages(whole)
    begins = [begin for begin, _ in parts(whole)]
    counts = [len(messages(whole[:begin])) for begin in begins] + [len(every)]
    largest = max(after - before for before, after in itertools.pairwise(counts))
    assert largest < 0.2 * len(every)
    chance = random.Random(SEED)
    print(f"seed {SEED}")  # noqa: T201 - shown when it fails
    for at in (chance.randrange(8, len(whole)) for _ in range(80)):
        kept = messages(changed(whole, at))
        assert len(kept) >= len(every) - largest, f"byte {at}"
        assert set(kept) <= set(every)


async def test_bytes_of_chance_in_the_middle_cost_what_they_cover(whole: bytes) -> None:
    found = parts(whole)
    every = messages(whole)
    chance = random.Random(SEED)
    print(f"seed {SEED}")  # noqa: T201 - shown when it fails
    begin, end = found[2][0], found[4][1]
    behind = messages(whole[:begin] + whole[end:])
    for size in (1, 100, end - begin, 3 * (end - begin)):
        junk = whole[:begin] + chance.randbytes(size) + whole[end:]
        kept = messages(junk)
        assert set(kept) <= set(every)
        assert len(kept) >= len(behind)
        assert kept[-1] == every[-1]


async def test_a_damaged_first_part_of_a_cut_file_is_mended_with_its_schemas(
    whole: bytes, tmp_path: Path
) -> None:
    found = parts(whole)
    cut, mended = tmp_path / "cut.mcap", tmp_path / "mended.mcap"
    cut.write_bytes(changed(whole[: found[-1][1]], found[0][0] + 60))
    saved = recover(cut, mended)
    assert saved > 0.5 * len(messages(whole))
    assert list(read(mended).samples()) != []
    assert read(mended).summary().messages == read(cut).summary().messages


async def test_cuts_anywhere_lose_no_part_that_is_whole(whole: bytes) -> None:
    found = parts(whole)
    counts = [len(messages(whole[:end])) for _, end in found]
    chance = random.Random(SEED)
    print(f"seed {SEED}")  # noqa: T201 - shown when it fails
    every = messages(whole)
    for _ in range(150):
        length = chance.randrange(8, len(whole))
        kept = messages(whole[:length])
        done = sum(end <= length for _, end in found)
        assert len(kept) == (counts[done - 1] if done else 0)
        assert kept == every[: len(kept)]


@pytest.mark.parametrize(("size", "is_whole"), [(4, True), (5, False), (3, False)])
def test_a_part_without_checksum_is_whole_by_its_size(size: int, is_whole: bool) -> None:
    """MCAP: a checksum of 0 is none, and the size is that of the records, uncompressed."""
    body = struct.pack("<QQQII", 0, 0, size, 0, 0) + struct.pack("<Q", 4) + b"abcd"
    if is_whole:
        assert _unpacked(body) == b"abcd"
    else:
        with pytest.raises(ValueError, match="checksum"):
            _unpacked(body)


def test_a_part_and_a_text_that_are_cut_and_one_that_grows_to_more_are_refused() -> None:
    head = struct.pack("<QQQI", 0, 0, 5, 0)
    with pytest.raises(ValueError, match="a part of 5 bytes"):
        _unpacked(head + bytes(4) + struct.pack("<Q", 5) + b"abcd")
    # zstd (RFC 8878): one segment, and a content size of 8 bytes: 2 GiB.
    frame = b"\x28\xb5\x2f\xfd\xe0" + struct.pack("<Q", 2 << 30) + b"\1\0\0"
    with pytest.raises(ValueError, match="asks for more than it says"):
        _unpacked(head + b"\4\0\0\0zstd" + struct.pack("<Q", len(frame)) + frame)
    with pytest.raises(IndexError, match="a text that does not end"):
        _bytes(b"\5\0\0\0abcd", 0)


@pytest.mark.parametrize(
    ("held", "length"),
    [(100, 144), ((64 << 20) - 44, 64 << 20), ((64 << 20) - 43, None), (1 << 62, None)],
)
def test_a_part_that_says_of_itself_more_than_64_mib_is_none(held: int, length: int | None) -> None:
    """A chunk (MCAP, op 6): times 16, size 8, CRC 4, name of the compression 4 + 4, size 8."""
    head = b"\x06" + bytes(8) + bytes(16) + bytes(8) + bytes(4) + b"\x04\0\0\0" + b"zstd"
    assert _length_of_part(head + held.to_bytes(8, "little")) == length


# -- twenty messages of a known size, two in each part: what exactly is kept and reported ----------


def small(compression: CompressionType = CompressionType.ZSTD) -> bytes:
    stream = io.BytesIO()
    writer = Writer(stream, chunk_size=150, compression=compression, enable_data_crcs=True)
    writer.start(library="m100link 9")
    channel = writer.register_channel("/a", "", 0)
    for number in range(20):
        writer.add_message(channel, number, bytes([number]) * 90, number, number)
    writer.finish()  # type: ignore[no-untyped-call] # of mcap
    return stream.getvalue()


def put(data: bytes, at: int, new: bytes) -> bytes:
    return data[:at] + new + data[at + len(new) :]


def longer(data: bytes, at: int, by: int) -> bytes:
    return put(data, at, (int.from_bytes(data[at : at + 8], "little") + by).to_bytes(8, "little"))


def kept(stream: io.BytesIO) -> tuple[list[int], tuple[tuple[int, int], ...], int]:
    """Numbers of the messages, the damaged places, and bytes of a record that was cut off."""
    losses = Losses()
    found = [one for one in records(stream, losses=losses) if isinstance(one, RawMessage)]
    damage = losses.damage()
    return [one.sequence for one in found], damage.places, damage.cut_bytes


def test_each_kind_of_damage_costs_and_is_reported_as_its_bytes_alone(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A part (MCAP, op 6): op 1, length 8, head 36 and its name 4, length of the records 8."""
    for kind in CompressionType:
        assert kept(io.BytesIO(small(kind))) == ([*range(20)], (), 0)
    whole = small()
    every, size = [*range(20)], len(whole)
    (begin, end), (behind, _), *_, (last, last_end) = parts(whole)[4:]
    others = [*range(8), *range(10, 20)]
    # The part says another length than its inside: it is read, and its head is a damaged place.
    wrong = [longer(whole, begin + 1, 3), put(whole, begin + 8, b"\x7f")]
    wrong.append(longer(whole, begin + 45, 200))  # of the inside: zstd knows where it ends
    for data in wrong:
        assert kept(io.BytesIO(data)) == (every, ((begin, begin + 9),), 0)
    data = put(wrong[0], end, bytes(9))
    assert kept(io.BytesIO(data)) == (every, ((begin, begin + 9), (end, behind)), 0)
    numbers, places, _ = kept(io.BytesIO(put(whole, end, bytes(9))))
    assert (numbers, places[-1]) == (every, (end, behind))
    data = put(whole, last + 8, b"\x7f")[:last_end]
    assert kept(io.BytesIO(data)) == (every, ((last, last + 9),), 0)
    first, first_end = parts(whole)[0]
    data = whole[:8] + put(whole, first + 8, b"\x7f")[first:first_end]
    assert kept(io.BytesIO(data)) == ([0, 1], ((8, 17),), 0)
    data = changed(whole, end - 10)
    assert kept(io.BytesIO(data)) == (others, ((begin, end),), 0)
    # The next part is found wherever it lies in what is looked through at once.
    data = put(whole, begin, bytes(end - begin))
    for window in (60, 80, 100):
        monkeypatch.setattr(records_module, "_WINDOW", window)
        assert kept(io.BytesIO(data)) == (others, ((begin, behind),), 0), window
    for cut in (begin + 12, begin + 60, end - 5):
        assert kept(io.BytesIO(whole[:cut])) == ([*range(8)], (), cut - begin)
    assert kept(io.BytesIO(whole[: end + 11])) == ([*range(10)], (), 11)
    head = longer(longer(whole, begin + 1, 1 << 20), begin + 45, 1 << 20)[: begin + 60]
    data = head + bytes(100) + whole[-8:]
    assert kept(io.BytesIO(data)) == ([*range(8)], ((begin, len(data)),), 0), "it has its end"
    # Statistics (op 11) of a strange length; the checksum of the summary covers them.
    summary = whole.index(b"\x0f\x04" + bytes(7)) + 13
    place = whole.index(b"\x0b" + (56).to_bytes(8, "little"), summary)
    data = longer(whole, place + 1, 3)
    data = data[: place + 65] + b"abc" + data[place + 65 :]
    assert kept(io.BytesIO(data)) == (every, ((summary, size + 3 - 8),), 0)
    growing = io.BytesIO(whole[: begin + 60])
    found = records(growing)
    started = [next(found)]
    growing.seek(0, 2)
    growing.write(whole[begin + 60 :])
    assert [*started, *found] == list(records(io.BytesIO(whole[: begin + 60])))
