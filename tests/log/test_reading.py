"""Logs are read back: whole ones, those that were cut off anywhere, and what is none."""

from __future__ import annotations

import errno
import random
import tracemalloc
from pathlib import Path

import pytest
from mcap.reader import SeekingReader
from mcap.writer import Writer

from m100link import Attitude, Position
from m100link.errors import UsageError
from m100link.log import read, recorder, recover
from m100link.log.channels import CHUNKS, LINK, RX
from tests.log.flight import URL, fly

pytestmark = pytest.mark.anyio

SEED = 20261122


async def test_a_cut_anywhere_raises_nothing_and_keeps_what_was_whole(tmp_path: Path) -> None:
    path = tmp_path / "flight.mcap"
    seen = await fly(path)
    whole = path.read_bytes()
    messages = list(read(path).messages())
    chance = random.Random(SEED)
    print(f"seed {SEED}")  # noqa: T201 - shown when it fails
    last = 0
    in_its_end = [len(whole) - missing for missing in (30, 17, 10)]
    for length in sorted([*(chance.randrange(8, len(whole)) for _ in range(60)), *in_its_end]):
        cut = tmp_path / "cut.mcap"
        cut.write_bytes(whole[:length])
        kept = list(read(cut).messages())
        assert kept == messages[: len(kept)]
        assert len(kept) >= last, "a longer file holds less"
        last = len(kept)
        assert not read(cut).summary().is_whole or length > len(whole) - 9
        mended = tmp_path / "mended.mcap"
        assert recover(cut, mended) == len(kept)
        with mended.open("rb") as stream:  # as Foxglove does, which takes no file without an index
            found = SeekingReader(stream).iter_messages(log_time_order=False)
            assert [record.data for _, _, record in found] == [one.data for one in kept]
        assert sum(1 for _ in read(mended).samples(firmware="1.0")) <= len(seen) + 100
        mended.unlink()


async def test_junk_behind_the_beginning_raises_nothing(tmp_path: Path) -> None:
    path = tmp_path / "flight.mcap"
    seen = await fly(path)
    whole = bytearray(path.read_bytes())
    sound = read(path).summary()
    chance = random.Random(SEED)
    print(f"seed {SEED}")  # noqa: T201 - shown when it fails
    for _ in range(40):
        spoilt = bytearray(whole)
        for _ in range(chance.randrange(1, 20)):
            spoilt[chance.randrange(8, len(spoilt))] = chance.randrange(256)
        bad = tmp_path / "bad.mcap"
        bad.write_bytes(spoilt)
        summary = read(bad).summary()
        assert 0 <= summary.bytes_received <= sound.bytes_received + sound.bytes_sent
        assert sum(1 for _ in read(bad).samples(firmware="1.0")) <= len(seen) + 100


async def test_a_damaged_length_does_not_ask_for_memory(tmp_path: Path) -> None:
    path = tmp_path / "flight.mcap"
    await fly(path)
    whole = path.read_bytes()
    begin = first_part(whole)
    # Of the part, of what it is unpacked to, of its name of a compression, and of its data.
    for at in (begin + 1, begin + 9 + 16, begin + 9 + 28, begin + 9 + 36):
        for byte in range(8):
            bad = tmp_path / "bad.mcap"
            bad.write_bytes(whole[: at + byte] + b"\xfe" + whole[at + byte + 1 :])
            tracemalloc.start()
            try:
                read(bad).summary()
                assert tracemalloc.get_traced_memory()[1] < 80e6
            finally:
                tracemalloc.stop()


async def test_a_first_part_that_is_damaged_costs_itself_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(recorder, "FLUSH_S", 0.0)  # of the wall clock: a part for each batch
    path = tmp_path / "flight.mcap"
    await fly(path)
    whole = path.read_bytes()
    spoilt = bytearray(whole)
    spoilt[first_part(whole) + 100] ^= 1
    bad, mended = tmp_path / "bad.mcap", tmp_path / "mended.mcap"
    bad.write_bytes(spoilt)
    kept = list(read(bad).messages())
    every = list(read(path).messages())
    assert kept == every[-len(kept) :]
    assert 0.5 * len(every) < len(kept) < len(every)
    assert recover(bad, mended) == len(kept)
    assert list(read(mended).messages()) == kept


def first_part(whole: bytes) -> int:
    """Where the first chunk of messages begins."""
    at = 8
    while whole[at] != 6:
        at += 9 + int.from_bytes(whole[at + 1 : at + 9], "little")
    return at


async def test_tables_have_the_columns_of_the_library(tmp_path: Path) -> None:
    path = tmp_path / "flight.mcap"
    seen = await fly(path)
    table = read(path).table(Position, Attitude)
    assert len(table) >= len(seen)
    assert table.names[:3] == ("received_at", "utc", "position.latitude_rad")
    utc, at = table.column("utc"), table.column("received_at")
    assert {round(one - other, 4) for one, other in zip(utc, at, strict=True)} == {
        round(utc[0] - at[0], 4)
    }


async def test_what_is_lost_on_the_line_is_lost_again_when_it_is_read(tmp_path: Path) -> None:
    path = tmp_path / "flight.mcap"
    seen = await fly(path, URL + "&loss=0.05")
    samples = list(read(path).samples())
    assert [one.value for one in samples[-len(seen) :]] == [one.value for one in seen]


async def test_what_is_no_log_is_refused_with_what_it_is(tmp_path: Path) -> None:
    text = tmp_path / "notes.txt"
    text.write_text("none")
    for path, why in (
        (tmp_path / "missing.mcap", "No such file"),
        (tmp_path, "Is a directory"),
        (text, "not a flight log"),
    ):
        with pytest.raises(UsageError, match=why):
            read(path)
    path = tmp_path / "flight.mcap"
    await fly(path)
    with pytest.raises(UsageError, match="cannot be written"):
        recover(path, path)
    assert list(read(path).messages(RX))


@pytest.mark.parametrize(
    ("topic", "data"),
    [
        (CHUNKS, b"\x00cdr"),
        (CHUNKS, b"[]"),
        (CHUNKS, b"{}"),
        (CHUNKS, b'{"direction":"rx","offset_us":[0],"length":[]}'),
        (CHUNKS, b'{"direction":"up","offset_us":[0],"length":[1]}'),
        (CHUNKS, b'{"direction":"rx","offset_us":[-1],"length":[1]}'),
        (CHUNKS, b'{"direction":"rx","offset_us":[1e400],"length":[1]}'),
        (CHUNKS, b'{"direction":"rx","offset_us":[1' + b"0" * 400 + b'],"length":[1]}'),
        (CHUNKS, b'{"direction":"rx","offset_us":[0],"length":[-3]}'),
        (LINK, b"\x00cdr"),
        (LINK, b"{}"),
        (LINK, b'{"firmware":"9.9"}'),
    ],
)
async def test_what_another_program_wrote_under_our_names_is_a_typed_error(
    tmp_path: Path, topic: str, data: bytes
) -> None:
    path = tmp_path / "other.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        for number, (name, told) in enumerate(((RX, b"abc"), (topic, data)), 1):
            channel = writer.register_channel(name, "cdr", 0)
            writer.add_message(channel, 1, told, 1, number)
        writer.finish()  # type: ignore[no-untyped-call] # of mcap
    log = read(path)
    with pytest.raises(UsageError, match=f"{topic} does not hold what m100link writes"):
        list(log.samples(firmware=None if topic == LINK else "1.0"))


async def test_a_full_disk_ends_mending_with_what_to_do(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "flight.mcap"
    await fly(path)

    def finish(_: Writer) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(Writer, "finish", finish)
    with pytest.raises(UsageError, match="No space left on device"):
        recover(path, tmp_path / "mended.mcap")
