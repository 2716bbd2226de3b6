"""Reads flight logs back, whole ones and those of a process that was killed."""

from __future__ import annotations

import json
import os
import struct
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from importlib import import_module
from pathlib import Path
from typing import IO, Any, NamedTuple

from m100link.errors import LayoutMismatch, UsageError
from m100link.link import Direction
from m100link.log.channels import CHUNKS, LINK, RX, TX
from m100link.log.recorder import mcap_module
from m100link.log.witness import is_telemetry
from m100link.protocol.firmware import FirmwareProfile, profile
from m100link.telemetry.columns import Columns, Table
from m100link.telemetry.sample import Sample
from m100link.wire import FrameDecoder

__all__ = ["Chunk", "FlightLog", "Message", "Summary", "read", "recover"]

_MAX_RECORD = 64 << 20  # bytes; a damaged length must not ask for gigabytes
_MAGIC = b"\x89MCAP0\r\n"


class Message(NamedTuple):
    """One message of a log.

    Attributes:
        topic: What it is about, see ``docs: howto/flight-logs``.
        at: The event loop's clock when it was written, s.
        utc: The same as POSIX time, s.
        data: Its bytes; JSON, except on the raw topics.
    """

    topic: str
    at: float
    utc: float
    data: bytes

    def content(self) -> dict[str, Any]:
        """What it says."""
        content: dict[str, Any] = json.loads(self.data)
        return content


class Chunk(NamedTuple):
    """The bytes of one read or write.

    Attributes:
        direction: Which way they went.
        at: When, on the event loop's clock of that time, s.
        utc: The same as POSIX time, s.
        data: The bytes.
    """

    direction: Direction
    at: float
    utc: float
    data: bytes


@dataclass(frozen=True)
class Summary:
    """What a log holds.

    Attributes:
        began_utc: POSIX time of the first message, s; None when there is none.
        duration_s: From the first message to the last, s.
        messages: How many, by topic.
        bytes_received, bytes_sent: Raw bytes of the line.
        is_whole: Whether the file was ended; else the process was killed, or it is written still.
        firmware: Name of the firmware profile; None when it was never known.
    """

    began_utc: float | None
    duration_s: float
    messages: dict[str, int]
    bytes_received: int
    bytes_sent: int
    is_whole: bool
    firmware: str | None


class FlightLog:
    """A log on disk. Each iterator reads it from its beginning.

    Args:
        path: The file.

    Attributes:
        path: The file.
    """

    def __init__(self, path: Path) -> None:
        self.path = path

    def __repr__(self) -> str:
        return f"<flight log {self.path}>"

    def messages(self, *topics: str) -> Iterator[Message]:
        """All messages, or those of some topics, in the order in which they were written.

        A file that was cut off ends with the last that is whole; parts whose checksum is wrong are
        passed over.
        """
        names: dict[int, str] = {}
        for record in _records(self.path):
            kind = type(record).__name__
            if kind == "Channel":
                names[record.id] = record.topic
            elif kind == "Message":
                topic = names.get(record.channel_id)
                if topic is not None and (not topics or topic in topics):
                    at, utc = record.publish_time / 1e9, record.log_time / 1e9
                    yield Message(topic, at, utc, record.data)

    def chunks(self) -> Iterator[Chunk]:
        """What was read and written, in order of time within each tenth of a second."""
        raw_by_time: dict[tuple[str, float], Message] = {}
        ready: list[Chunk] = []
        for message in self.messages(RX, TX, CHUNKS):
            if message.topic != CHUNKS:
                raw_by_time[message.topic, message.at] = message
                continue
            told = message.content()
            direction = Direction(told["direction"])
            topic = RX if direction is Direction.RECEIVED else TX
            raw = raw_by_time.pop((topic, message.at), None)
            if raw is None:  # it stood in a part of the file that is damaged
                continue
            at = 0
            found = []
            for offset_us, length in zip(told["offset_us"], told["length"], strict=True):
                after = offset_us / 1e6
                data = raw.data[at : at + length]
                found.append(Chunk(direction, raw.at + after, raw.utc + after, data))
                at += length
            if ready and found[0].at > ready[-1].at + 1.0:
                yield from ready
                ready = []
            ready = sorted([*ready, *found], key=lambda one: one.at)
            while len(ready) > 1 and ready[0].at < found[-1].at - 1.0:
                yield ready.pop(0)
        yield from ready

    @cached_property
    def firmware(self) -> FirmwareProfile | None:
        """The firmware profile by which telemetry was read; None when it was never known."""
        for message in self.messages(LINK):
            return profile(message.content()["firmware"])
        return None

    def samples(self, *, firmware: str | FirmwareProfile | None = None) -> Iterator[Sample]:
        """Every telemetry package, decoded from the bytes.

        Args:
            firmware: Profile to read them by; by default that of the flight.

        Raises:
            UsageError: The flight's was never known, and none is given.
        """
        chosen = self.firmware if firmware is None else profile(firmware)
        if chosen is None:
            raise UsageError(
                f"{self.path} does not say which firmware it is of",
                cause="the aircraft never answered",
                remedy="name the profile: samples(firmware='1.0')",
            )
        decoder = FrameDecoder()
        for chunk in self.chunks():
            if chunk.direction is not Direction.RECEIVED:
                continue
            for frame in decoder.feed(chunk.data):
                if is_telemetry(frame):
                    try:
                        yield Sample(frame.data[2:], chosen, chunk.at)
                    except LayoutMismatch:
                        continue  # as in flight: counted by the link, read by nobody

    def table(self, *records: type[Any], firmware: str | FirmwareProfile | None = None) -> Table:
        """All packages as rows of numbers: see :class:`m100link.Columns`.

        Args:
            records: Record classes; none at all: every item.
            firmware: As for :meth:`samples`.
        """
        columns = Columns(*records, utc_offset_s=self._utc_offset_s)
        return Table(columns.names, [columns.row(one) for one in self.samples(firmware=firmware)])

    def summary(self) -> Summary:
        """What it holds; reads the whole file."""
        counts: dict[str, int] = defaultdict(int)
        sizes = {RX: 0, TX: 0}
        first = last = None
        for message in self.messages():
            counts[message.topic] += 1
            if message.topic in sizes:
                sizes[message.topic] += len(message.data)
            first = message.utc if first is None else min(first, message.utc)
            last = message.utc if last is None else max(last, message.utc)
        known = self.firmware
        return Summary(
            began_utc=first,
            duration_s=0.0 if first is None or last is None else last - first,
            messages=dict(counts),
            bytes_received=sizes[RX],
            bytes_sent=sizes[TX],
            is_whole=any(type(one).__name__ == "Footer" for one in _records(self.path)),
            firmware=None if known is None else known.name,
        )

    @cached_property
    def _utc_offset_s(self) -> float:
        for message in self.messages():
            return message.utc - message.at
        return 0.0


def read(path: str | os.PathLike[str]) -> FlightLog:
    """Open a flight log.

    ::

        flight = m100link.log.read("flight.mcap")
        for sample in flight.samples():
            print(sample.received_at, sample.position)

    Raises:
        UsageError: There is no such file, it is not an MCAP file, or the extra ``log`` is missing.
    """
    place = Path(path).expanduser()
    try:
        with place.open("rb") as stream:
            is_mcap = stream.read(len(_MAGIC)) == _MAGIC
    except OSError as error:
        raise UsageError(f"{place} cannot be read: {error.strerror}") from error
    if not is_mcap:
        raise UsageError(
            f"{place} is not a flight log",
            cause="it does not begin as MCAP files do",
            remedy="name a file that `m100link record` or connect(record=…) wrote",
        )
    mcap_module("stream_reader")
    return FlightLog(place)


def recover(path: str | os.PathLike[str], target: str | os.PathLike[str]) -> int:
    """Write a whole file from one that was cut off; the old one stays as it is.

    Returns:
        How many messages were saved.

    Raises:
        UsageError: As :func:`read`; or the target is there already or cannot be written.
    """
    source = read(path)
    try:
        stream = Path(target).expanduser().open("xb")
    except OSError as error:
        raise UsageError(
            f"{target} cannot be written: {error.strerror}", remedy="name a new file"
        ) from error
    try:
        with stream:
            return _copy(source, stream)
    except OSError as error:
        raise UsageError(
            f"{target} could not be written to its end: {error.strerror}",
            remedy="make room there, or name a new file elsewhere",
        ) from error


def _copy(source: FlightLog, stream: IO[bytes]) -> int:
    writer = mcap_module("writer").Writer(stream)
    writer.start(library="m100link log recover")
    channels: dict[int, int] = {}
    schemas = {0: 0}
    saved = 0
    for record in _records(source.path):
        kind = type(record).__name__
        if kind == "Schema":
            if record.id not in schemas:
                schemas[record.id] = writer.register_schema(
                    record.name, record.encoding, record.data
                )
        elif kind == "Channel":
            if record.id not in channels:
                channels[record.id] = writer.register_channel(
                    record.topic, record.message_encoding, schemas.get(record.schema_id, 0)
                )
        elif kind == "Metadata":
            writer.add_metadata(record.name, record.metadata)
        elif kind == "Message" and record.channel_id in channels:
            writer.add_message(
                channel_id=channels[record.channel_id],
                log_time=record.log_time,
                publish_time=record.publish_time,
                sequence=record.sequence,
                data=record.data,
            )
            saved += 1
    writer.finish()
    return saved


def _records(path: Path) -> Iterator[Any]:
    """The records of a file, as far as they are whole."""
    # What reading a file that ends anywhere, or was changed, was seen to raise.
    damage = (
        mcap_module("exceptions").McapError,
        import_module("zstandard").ZstdError,  # comes with mcap
        struct.error,
        ValueError,
        RuntimeError,
        EOFError,
        OverflowError,
        LookupError,
    )
    reading = mcap_module("stream_reader")
    is_told = False  # by the end of the file, which channels there are
    with path.open("rb") as stream:
        records = reading.StreamReader(
            _Bounded(stream), emit_chunks=True, record_size_limit=_MAX_RECORD
        ).records
        while True:
            try:
                record = next(records)
            except (StopIteration, *damage):
                return
            if type(record).__name__ != "Chunk":
                yield record
                continue
            try:
                _check_size(record)
                inside = reading.breakup_chunk(record, validate_crc=True)
            except damage:  # the next one may be whole
                if not is_told:  # the names of what follows may have stood in this one alone
                    is_told = True
                    yield from _channels_at_end(path, damage)
                continue
            yield from inside


def _channels_at_end(path: Path, damage: tuple[type[Exception], ...]) -> list[Any]:
    """Schemas and channels as the end of a whole file repeats them."""
    with path.open("rb") as stream:
        try:
            summary = (
                mcap_module("reader")
                .SeekingReader(_Bounded(stream), record_size_limit=_MAX_RECORD)
                .get_summary()
            )
        except damage:
            return []
    return [] if summary is None else [*summary.schemas.values(), *summary.channels.values()]


def _check_size(chunk: Any) -> None:
    size = chunk.uncompressed_size
    if chunk.compression == "zstd":
        size = max(size, import_module("zstandard").frame_content_size(chunk.data))
    if size > _MAX_RECORD:
        raise ValueError(f"a part of {size} bytes")


class _Bounded:
    """A file never read by more at once than a record may have: lengths are damaged, too."""

    def __init__(self, stream: IO[bytes]) -> None:
        self._stream = stream
        self.seek, self.tell = stream.seek, stream.tell

    def read(self, size: int = -1) -> bytes:
        if size > _MAX_RECORD:
            raise ValueError(f"a record of {size} bytes")
        return self._stream.read(size)
