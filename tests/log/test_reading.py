"""Logs are read back: whole ones, those that were cut off anywhere, and what is none."""

from __future__ import annotations

import errno
import json
import random
import tracemalloc
from collections import Counter
from itertools import pairwise
from operator import itemgetter
from pathlib import Path
from typing import Any

import pytest
from mcap.reader import SeekingReader
from mcap.writer import Writer

from m100link import Attitude, Position
from m100link.errors import UsageError
from m100link.log import read, recorder, recover
from m100link.log.channels import CHUNKS, EVENT, LINK, RX
from m100link.log.damage import Damage
from m100link.log.reading import FlightLog, Message
from m100link.protocol.records import Battery
from tests import known
from tests.log.flight import URL, flown, fly
from tests.support import raw_frame

pytestmark = pytest.mark.anyio

SEED = 20261122


async def test_a_cut_anywhere_raises_nothing_and_keeps_what_was_whole(tmp_path: Path) -> None:
    path = tmp_path / "flight.mcap"
    seen = await flown(path)
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
    seen = await flown(path)
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
    await flown(path)
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
    await flown(path)
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
    seen = await flown(path)
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
    await flown(path)
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
    await flown(path)

    def finish(_: Writer) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(Writer, "finish", finish)
    with pytest.raises(UsageError, match="No space left on device"):
        recover(path, tmp_path / "mended.mcap")


# -- a log of messages by hand ---------------------------------------------------------------------

UTC = 1_800_000_000.0
"""POSIX time of the loop's zero."""


def made(path: Path, *messages: tuple[float, str, Any], part_size: int = 1 << 20) -> Path:
    """Messages in this order: time of the loop, topic, and bytes or what becomes JSON."""
    with path.open("wb") as stream:
        writer: Any = Writer(stream, chunk_size=part_size)
        writer.start(library="m100link 9")
        channels: dict[str, int] = {}
        numbers: Counter[str] = Counter()  # of each topic its own
        for at, topic, content in messages:
            if topic not in channels:
                channels[topic] = writer.register_channel(topic, "json", 0)
            data = content if isinstance(content, bytes) else json.dumps(content).encode()
            log_time, publish_time = round((UTC + at) * 1e9), round(at * 1e9)
            writer.add_message(channels[topic], log_time, data, publish_time, numbers[topic])
            numbers[topic] += 1
        writer.add_metadata("m100link", {RX: "77", "began": "once"})
        writer.finish()
    return path


def came(
    at: float, way: str, data: bytes, *pieces: tuple[int, int]
) -> list[tuple[float, str, Any]]:
    """Raw bytes, and how they came: µs after the first, and lengths."""
    offsets, lengths = [one for one, _ in pieces], [one for _, one in pieces]
    content = {"direction": way, "offset_us": offsets, "length": lengths}
    return [(at, f"/m100/raw/{way}", data), (at, CHUNKS, content)]


def test_reads_and_writes_come_in_order_of_time_with_their_own_times(tmp_path: Path) -> None:
    """Sent bytes stand before received ones of the same time; up to a second lies between them."""
    log = read(
        made(
            tmp_path / "flight.mcap",
            *came(10.5, "tx", b"abcdef", (0, 1), (250_000, 5)),
            *came(10.25, "rx", b"12345", (0, 2), (500, 0), (400_000, 3)),
            (10.6, "/m100/event", {"event": "b"}),
            (10.3, "/m100/event", {"event": "a"}),
            *came(11.5, "rx", b"67", (0, 2)),
            (
                12.5,
                CHUNKS,
                {"direction": "tx", "offset_us": [0], "length": [4]},
            ),  # its bytes are lost
            *came(13.0, "rx", b"89", (0, 2)),
        )
    )
    chunks = [(one.direction.value, round(one.at, 6), one.data) for one in log.chunks()]
    assert chunks == [
        *(("rx", 10.25, b"12"), ("rx", 10.2505, b""), ("tx", 10.5, b"a"), ("rx", 10.65, b"345")),
        *(("tx", 10.75, b"bcdef"), ("rx", 11.5, b"67"), ("rx", 13.0, b"89")),
    ]
    assert [one.utc - one.at for one in log.chunks()] == pytest.approx([UTC] * 7, abs=1e-6)
    moments = [
        one.content()["event"] if isinstance(one, Message) else one.data for one in log.moments()
    ]
    assert moments == [b"12", b"", "a", b"a", "b", b"345", b"bcdef", b"67", b"89"]


def test_a_summary_begins_with_the_first_moment_and_ends_with_the_last(tmp_path: Path) -> None:
    log = read(
        made(
            tmp_path / "flight.mcap",
            *came(10.5, "tx", b"abcdef", (0, 6)),
            *came(10.25, "rx", b"12345", (0, 5)),
            (14.75, "/m100/event", {}),
            *came(12.0, "rx", b"67", (0, 2)),
            (11.0, LINK, {"firmware": "3.1", "acceleration": "raw"}),
        )
    )
    found = log.summary()
    assert found.began_utc == pytest.approx(UTC + 10.25, abs=1e-6)
    assert found.duration_s == pytest.approx(4.5, abs=1e-6)
    assert (found.bytes_received, found.bytes_sent) == (7, 6)
    assert found.messages == {RX: 2, "/m100/raw/tx": 1, CHUNKS: 3, "/m100/event": 1, LINK: 1}
    assert (found.firmware, found.acceleration, found.is_whole) == ("3.1", "raw", True)
    assert read(log.path, acceleration="fused").summary().acceleration == "fused"
    empty = read(made(tmp_path / "empty.mcap"))
    with pytest.raises(UsageError, match="does not say which firmware"):
        empty.samples()
    nothing = empty.summary()
    assert (nothing.began_utc, nothing.duration_s, nothing.firmware) == (None, 0.0, None)


def test_samples_have_the_times_of_their_reads_and_columns_the_calendar(tmp_path: Path) -> None:
    first, second = known.package("3.1"), known.package("3.1", changed=[Battery(7)])
    frames = [raw_frame(b"\x02\x00" + one, sequence=n) for n, one in enumerate((first, second))]
    size = len(frames[0])
    data = b"".join(frames) + raw_frame(b"\x02\x00", is_ack=True, session=2)
    rest = len(data) - size - 9
    log = read(
        made(
            tmp_path / "flight.mcap",
            (20.0, LINK, {"firmware": "3.1", "acceleration": "fused"}),
            *came(20.5, "rx", data, (0, size), (40_000, 9), (75_000, rest)),
            *came(20.9, "tx", frames[0], (0, size)),
        )
    )
    samples = list(log.samples())
    assert [one.received_at for one in samples] == pytest.approx([20.5, 20.575])
    assert [one[Battery].percent for one in samples] == [63, 7]
    names, rows = log.rows(Battery)
    assert names == ("received_at", "utc", "battery.percent")
    assert [list(row) for row in rows] == [
        pytest.approx([20.5, UTC + 20.5, 63.0], abs=1e-5),
        pytest.approx([20.575, UTC + 20.575, 7.0], abs=1e-5),
    ]
    assert [type(one).__name__ for one in log.heard(LINK, firmware=None)] == ["Message"]


def test_what_is_mended_keeps_times_numbers_topics_and_metadata(tmp_path: Path) -> None:
    source = made(
        tmp_path / "flight.mcap",
        (9.0, "/mine", b"own"),
        *came(10.5, "tx", b"abcdef", (0, 6)),
        (11.0, LINK, {"firmware": "3.1"}),
        part_size=64,
    )
    target = tmp_path / "mended.mcap"
    assert recover(source, target) == 4
    with source.open("rb") as one, target.open("rb") as other:
        before, after = ([*SeekingReader(each).iter_messages()] for each in (one, other))
        assert [(c.topic, vars(m)) for _, c, m in before] == [
            (c.topic, vars(m) | {"channel_id": old.channel_id})
            for (_, c, m), (_, _, old) in zip(after, before, strict=True)
        ]
        other.seek(0)
        [kept] = SeekingReader(other).iter_metadata()
        channels = {c.topic: c.id for _, c, _ in after}
        assert kept.metadata["began"] == "once"
        assert kept.metadata[RX] not in ("77", *map(str, channels.values()))
    assert read(target).summary() == read(source).summary()


def test_parts_that_end_before_a_time_are_passed_over(tmp_path: Path) -> None:
    rows = [one for n in range(40) for one in came(float(n), "rx", bytes(60), (0, 60))]
    log = read(made(tmp_path / "flight.mcap", *rows, part_size=200))
    assert len(list(log.moments())) == 40
    late = [one.at for one in log.moments(since_utc=UTC + 30.0)]
    assert late[-1] == 39.0
    assert 9 <= len(late) <= 14
    assert not log.damage


def test_parts_soon_after_one_that_was_read_are_passed_over(tmp_path: Path) -> None:
    rows = [(0.1 * n, RX, bytes([n]) * 50) for n in range(200)]
    log = read(made(tmp_path / "long.mcap", *rows, part_size=400))  # half a second
    assert len(list(log.messages(RX, pause_s=0.0))) == 200
    times = [one.at for one in log.messages(RX, pause_s=2.0)]
    pauses = [after - before for before, after in pairwise(times)]
    # The next part that is read ends two seconds later or more.
    assert all(pause == pytest.approx(0.1) or 1.5 <= pause <= 2.1 for pause in pauses)
    assert 6 <= sum(pause > 1.0 for pause in pauses) <= 10
    assert not log.damage  # what was passed over is not missing


def test_rare_messages_are_found_by_the_index_or_by_reading_all(tmp_path: Path) -> None:
    """With bits turned over anywhere: what the index gives is right, or it gives nothing."""
    notes = [(float(n), EVENT, {"event": "note", "number": n}) for n in (3, 40, 41, 90)]
    rows = [(float(n), RX, bytes(range(n))) for n in range(100)]
    path = made(tmp_path / "whole.mcap", *sorted([*notes, *rows], key=itemgetter(0)), part_size=200)
    whole = path.read_bytes()
    truth = tuple(read(path).messages(EVENT)), Damage(began_utc=UTC, ended_utc=UTC + 99.0)
    assert read(path).indexed(EVENT) == truth
    assert read(path).damage == truth[1]
    assert read(path).indexed(LINK) == ((), truth[1])
    chance, found = random.Random(SEED), 0
    for _ in range(300):
        damaged = bytearray(whole)
        damaged[chance.randrange(len(whole))] ^= 1 << chance.randrange(8)
        path.write_bytes(damaged)
        indexed = FlightLog(path).indexed(EVENT)
        assert indexed in (None, truth)
        found += indexed is not None
    assert found > 30  # parts without a note are not looked into
    for cut in (len(whole) - 1, len(whole) // 2):  # of a process that was killed
        path.write_bytes(whole[:cut])
        assert read(path).indexed(EVENT) is None
