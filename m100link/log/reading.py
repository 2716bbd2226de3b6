"""Reads flight logs back, whole ones and those of a process that was killed."""

from __future__ import annotations

import logging
import math
import os
from bisect import bisect_left, insort
from collections import defaultdict
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import accumulate, islice
from operator import itemgetter
from pathlib import Path
from typing import IO, Any, NamedTuple

from m100link.errors import UsageError
from m100link.errors.texts import read_json, read_path
from m100link.errors.usage import of_extra, unread
from m100link.link import Direction
from m100link.log.channels import CHUNKS, EVENT, LINK, RX, SCHEMAS, TX, is_telemetry
from m100link.log.damage import Damage, Losses
from m100link.log.recorder import is_being_written
from m100link.log.records import (
    MAGIC,
    PART_SIZE,
    Metadata,
    RawMessage,
    RecordedChannel,
    RecordedSchema,
    by_index,
    holds_parts,
    mcap_module,
    records,
    registered,
)
from m100link.protocol.firmware import PROFILES, FirmwareProfile, profile
from m100link.protocol.packet import fits
from m100link.protocol.records import AccelerationMode
from m100link.telemetry.columns import Columns, Table
from m100link.telemetry.sample import AccelerationReader, Sample, acceleration_mode
from m100link.wire import FrameDecoder

_logger = logging.getLogger(__name__)

_APART_S = 1.0  # at most between the two directions of one time in a file

_MOST_PLAUSIBLE = 10**9  # µs after a message, or bytes in it: far more than a recorder writes

_AT = itemgetter(1)
_OF_WRITES = b'{"direction":"tx"'


class Message(NamedTuple):
    """One message of a log."""

    topic: str  #: The subject, as in the page on logs.
    at: float  #: The event loop's clock when it was written, s.
    utc: float  #: The same as POSIX time, s.
    data: bytes  #: Its bytes; JSON, except on the raw topics.

    def content(self) -> dict[str, Any]:
        """The content of the message.

        Raises:
            UsageError: It is not JSON, or not an object: another program wrote it.
        """
        try:
            content = read_json(self.data)
        except ValueError:
            content = None
        if not isinstance(content, dict):
            raise _foreign(self.topic)
        return content


Packages = list[tuple[bytes, float]]
"""Values of telemetry packages, and when they arrived on the event loop's clock, s."""


class Chunk(NamedTuple):
    """The bytes of one read or write."""

    direction: Direction  #: Which way they went.
    at: float  #: When, on the event loop's clock of that time, s.
    utc: float  #: The same as POSIX time, s.
    data: bytes  #: The bytes.


@dataclass(frozen=True)
class Summary:
    """The content of a log in numbers."""

    began_utc: float | None  #: POSIX time of the first message, s; None when there is none.
    duration_s: float  #: From the first message to the last, s.
    messages: dict[str, int]  #: How many, by topic.
    bytes_received: int  #: Raw bytes of the line.
    bytes_sent: int  #: Raw bytes of the line.
    is_whole: bool  #: Whether the file was ended, and nothing of it is damaged or missing.
    firmware: str | None  #: Name of the firmware profile; None when it was never known.
    #: The mode in which acceleration was sent; None when it was never known.
    acceleration: AccelerationMode | None
    damage: Damage  #: The parts damaged or missing.


_MOST_MISSING = 3000  # half a minute; a larger step is a count that begins anew
_ANSWERED_S = 20  # counters come once a second; until the version is known they have a default


class FrameLoss:
    """Counts the frames that never came whole, by the numbers that the aircraft gives its frames.

    Attributes:
        came: Numbered frames that came; acks have the number of their command, and do not count.
        lost: Numbers that are missing between them.
    """

    def __init__(self) -> None:
        self.came = self.lost = self._following = 0
        self._last: int | None = None

    def hear(self, sequence: int) -> None:
        """The number of the next frame, 0 to 65535."""
        step = 1 if self._last is None else (sequence - self._last) & 0xFFFF
        self.came += 1
        self._following += step == 1
        self.lost += step - 1 if 1 < step < _MOST_MISSING else 0
        self._last = sequence

    @property
    def share(self) -> float | None:
        """The lost part of all, 0 to 1; None where most numbers do not follow each other."""
        if self.came == 0 or self._following < self.came / 2:
            return None
        return self.lost / (self.came + self.lost)


def profile_of(counters: Message) -> FirmwareProfile | None:
    """The firmware profile that a message of counters names; None: none that is known."""
    name = counters.content().get("firmware")
    return PROFILES.get(name) if isinstance(name, str) else None


class FlightLog:
    """A log on disk. Each iterator reads it from its beginning.

    Damaged parts are passed over. The first iterator that comes to the end warns of them, and of an
    end that is missing; :attr:`damage` has it, too.

    Args:
        path: The file.
        acceleration: The mode by which acceleration is read; by default as the recording shows.

    Attributes:
        path: The file.
        loss: Frames that came, and that were lost, as far as telemetry was read last.
    """

    def __init__(self, path: Path, acceleration: AccelerationMode | None = None) -> None:
        self.path = path
        self._acceleration = acceleration
        self._damage: Damage | None = None
        self.loss = FrameLoss()

    def __repr__(self) -> str:
        return f"<flight log {self.path}>"

    def messages(self, *topics: str, pause_s: float = 0.0) -> Iterator[Message]:
        """All messages, or those of some topics, in the order in which they were written.

        A file that was cut off ends with the last that is whole; parts whose checksum is wrong are
        passed over, which :attr:`damage` tells.

        Args:
            topics: Which; none at all: every topic.
            pause_s: Pass over the parts, each of half a second, that end within so many s after
                one that was read.
        """
        return self._messages(topics, pause_s=pause_s)

    @property
    def damage(self) -> Damage:
        """The parts damaged or missing in the file; reads all of it when nobody did so far."""
        if self._damage is None:
            for _ in self.messages(LINK):
                pass
        assert self._damage is not None
        return self._damage

    def _messages(
        self, topics: Sequence[str], since_utc: float = 0.0, pause_s: float = 0.0
    ) -> Iterator[Message]:
        """The same; parts of the file that end before a time are passed over."""
        names: dict[int, str] = {}
        losses = Losses()
        make = tuple.__new__
        with self._open() as stream:
            since_ns, pause_ns = round(since_utc * 1e9), round(pause_s * 1e9)
            for record in records(stream, topics, since_ns, losses, pause_ns):
                if type(record) is RawMessage:
                    channel, _, utc_ns, at_ns, data = record
                    yield make(Message, (names[channel], at_ns / 1e9, utc_ns / 1e9, data))
                elif type(record) is RecordedChannel:
                    names[record.id] = record.topic
        if self._damage is None and since_utc <= 0.0 and pause_s <= 0.0:
            damage = losses.damage()
            is_written = not damage.is_ended and is_being_written(self.path)
            self._damage = replace(damage, is_written=is_written)
            if self._damage or not self._damage.is_ended:
                _logger.warning("%s: %s", self.path, self._damage)

    def indexed(self, topic: str) -> tuple[tuple[Message, ...], Damage] | None:
        """Messages of a rare topic, and when the flight began and ended, by the index of the file.

        Parts without such a message are not read, so their damage is not found. None: the file has
        no index, or one that does not fit it.
        """
        with self._open() as stream, suppress(Exception):  # whatever an index of chance raises
            if (found := by_index(stream, topic)) is not None:
                raw, whole = found
                begin, end = whole.message_start_time / 1e9, whole.message_end_time / 1e9
                return tuple(
                    Message(topic, one.publish_time / 1e9, one.log_time / 1e9, one.data)
                    for one in raw
                ), Damage(began_utc=begin, ended_utc=end)
        return None

    def _open(self) -> IO[bytes]:
        """The file; a caller that shows the progress puts its own in its place."""
        return self.path.open("rb")

    def chunks(self) -> Iterator[Chunk]:
        """The bytes read and written, in order of time."""
        return (one for one in self.moments() if isinstance(one, Chunk))

    def moments(self, *, since_utc: float = 0.0) -> Iterator[Chunk | Message]:
        """Bytes read and written, events, and counters, in order of time.

        Args:
            since_utc: Not before that POSIX time, s, give or take a second.
        """
        raw_by_time: dict[tuple[str, float], Message] = {}
        ready: list[Chunk | Message] = []
        for message in self._messages((RX, TX, CHUNKS, EVENT, LINK), since_utc):
            if message.topic in (EVENT, LINK):
                insort(ready, message, key=_AT)
                continue
            if message.topic != CHUNKS:
                raw_by_time[message.topic, message.at] = message
                continue
            content = _chunks(message)
            direction = Direction(content["direction"])
            topic = RX if direction is Direction.RECEIVED else TX
            raw = raw_by_time.pop((topic, message.at), None)
            if raw is None:  # it stood in a part of the file that is damaged
                continue
            ready += _pieces(direction, raw, content["offset_us"], content["length"])
            ready.sort(key=_AT)  # nearly sorted it is, which takes no time
            done = bisect_left(ready, message.at - _APART_S, key=_AT)
            if done:
                yield from ready[:done]
                del ready[:done]
        yield from ready

    @cached_property
    def firmware(self) -> FirmwareProfile | None:
        """The firmware profile by which telemetry was read; None when it was never known."""
        found = None
        for message in islice(self.messages(LINK), _ANSWERED_S):
            found = profile_of(message)
            if found is None:
                raise _foreign(message.topic)
        return found

    def acceleration_by(self, firmware: FirmwareProfile) -> AccelerationMode | None:
        """The mode in which acceleration was sent; None when it was never known.

        The log has it; of a log that an earlier version wrote, the values at rest show it.
        """
        if self._acceleration is not None:
            return self._acceleration
        for message in self.messages(LINK):
            content = message.content()
            if "acceleration" not in content:
                break
            if content["acceleration"] in tuple(AccelerationMode):
                return AccelerationMode(content["acceleration"])
        reader = AccelerationReader()
        for one in self._heard(()):
            for value, at in () if isinstance(one, Message) else one:
                reader.read(value, firmware, at)
                if reader.mode is not None:
                    return reader.mode
        return reader.mode

    def nameless(self, remedy: str) -> UsageError:
        """The error of a reader that needs the firmware profile of a log that never names it."""
        return UsageError(
            f"{self.path} does not say which firmware it is of",
            cause=f"damage: {self.damage}" if self.damage else "the aircraft never answered",
            remedy=f"name the profile: {remedy}",
        )

    def samples(self, *, firmware: str | FirmwareProfile | None = None) -> Iterator[Sample]:
        """Every telemetry package, decoded from the bytes.

        Args:
            firmware: Profile to read them by; by default that of the flight.

        Raises:
            UsageError: The flight's was never known, and none is given.
        """
        chosen = self.firmware if firmware is None else profile(firmware)
        if chosen is None:
            raise self.nameless("samples(firmware='1.0')")
        return (
            Sample(value, chosen, at)
            for found in self.heard(firmware=chosen)
            if not isinstance(found, Message)
            for value, at in found
        )

    def heard(self, *topics: str, firmware: FirmwareProfile | None) -> Iterator[Message | Packages]:
        """Telemetry packages, and the messages of some topics, while the file is read once.

        Packages are in order of time, and messages, too; a message may stand a second beside the
        packages of its time. Those that do not fit the profile are left out, as in flight.
        ``firmware``: profile to read packages by; None: none is read.
        """
        acceleration = AccelerationReader()
        if firmware is not None:
            acceleration.fix(self.acceleration_by(firmware))
        for one in self._heard(topics):
            if isinstance(one, Message):
                yield one
            elif firmware is not None:
                if not acceleration.is_idle:
                    one = [(acceleration.read(value, firmware, at), at) for value, at in one]
                yield [pair for pair in one if fits(pair[0], firmware)]

    def _heard(self, topics: Sequence[str]) -> Iterator[Message | Packages]:
        """The same without a look into packages; those of some reads come together."""
        feed = FrameDecoder().feed
        self.loss = FrameLoss()
        count = self.loss.hear
        received: dict[float, Message] = {}
        for message in self._messages((RX, CHUNKS, *topics)):
            topic = message.topic
            if topic == RX:
                received[message.at] = message
            elif topic != CHUNKS:
                yield message
            elif message.data.startswith(_OF_WRITES):
                continue
            elif (content := _chunks(message))["direction"] == "rx":
                raw = received.pop(message.at, None)
                if raw is None:  # it stood in a part of the file that is damaged
                    continue
                found: Packages = []
                began_at, data, begin = raw.at, raw.data, 0
                for offset_us, end in zip(
                    content["offset_us"], accumulate(content["length"]), strict=True
                ):
                    for frame in feed(data[begin:end]):
                        if not frame.is_ack:
                            count(frame.sequence)
                        if is_telemetry(frame):
                            found.append((frame.data[2:], began_at + offset_us / 1e6))
                    begin = end
                yield found

    def rows(
        self, *records: type[Any], firmware: str | FirmwareProfile | None = None
    ) -> tuple[tuple[str, ...], Iterator[tuple[float, ...]]]:
        """Names of the columns, and a row of numbers per package while the file is read.

        Args:
            records: Record classes; none at all: every item.
            firmware: As for :meth:`samples`.
        """
        columns = Columns(*records, utc_offset_s=self._utc_offset_s)
        return columns.names, map(columns.row, self.samples(firmware=firmware))

    def table(self, *records: type[Any], firmware: str | FirmwareProfile | None = None) -> Table:
        """All packages as rows of numbers: see :class:`m100link.Columns`.

        Args:
            records: Record classes; none at all: every item.
            firmware: As for :meth:`samples`.
        """
        names, rows = self.rows(*records, firmware=firmware)
        return Table(names, list(rows))

    def summary(self) -> Summary:
        """The content in numbers; reads the whole file."""
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
            is_whole=self.damage.is_ended and not self.damage,
            firmware=None if known is None else known.name,
            acceleration=None if known is None else self.acceleration_by(known),
            damage=self.damage,
        )

    @cached_property
    def _utc_offset_s(self) -> float:
        for message in self.messages():
            return message.utc - message.at
        return 0.0


def read(path: str | os.PathLike[str], *, acceleration: str | None = None) -> FlightLog:
    """Open a flight log.

    ::

        flight = m100link.log.read("flight.mcap")
        for sample in flight.samples():
            print(sample.received_at, sample.position)

    Args:
        path: The file.
        acceleration: ``"raw"`` or ``"fused"``, for a log that does not show it.

    Raises:
        UsageError: There is no such file, it is not an MCAP file, or the extra ``log`` is missing.
    """
    place = read_path(path)
    try:
        with place.open("rb") as stream:
            is_mcap = stream.read(len(MAGIC)) == MAGIC or holds_parts(stream)
    except OSError as error:
        raise unread(place, error) from error
    if not is_mcap:
        raise UsageError(
            f"{place} is not a flight log",
            cause="it does not begin as MCAP files do",
            remedy="name a file that `m100link record` or connect(record=…) wrote",
        )
    mcap_module("writer")
    return FlightLog(place, acceleration_mode(acceleration))


def recover(path: str | os.PathLike[str], target: str | os.PathLike[str]) -> int:
    """Write a whole file from one that was cut off or damaged; the old one stays as it is.

    Messages that the old one lost stay lost: ``read(path).damage`` reports them, and so does that
    of the new one, as far as messages are missing.

    Returns:
        How many messages were saved.

    Raises:
        UsageError: As :func:`read`; or the target is there already or cannot be written.
    """
    source = read(path)
    try:
        stream = read_path(target).open("xb")
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


def _foreign(topic: str) -> UsageError:
    return UsageError(
        f"{topic} does not hold what m100link writes there",
        cause="another program wrote the file, or a later version of this one",
        remedy="name a file that `m100link record` or connect(record=…) wrote",
    )


def _chunks(message: Message) -> dict[str, Any]:
    """How raw bytes were read or written. Raises ``UsageError``: it does not tell."""
    content = message.content()
    offsets, lengths = content.get("offset_us"), content.get("length")
    if not (
        content.get("direction") in ("rx", "tx")
        and isinstance(offsets, list)
        and isinstance(lengths, list)
        and len(offsets) == len(lengths)
        and set(map(type, numbers := offsets + lengths)) <= {int}
        and min(numbers, default=0) >= 0
        and max(numbers, default=0) <= _MOST_PLAUSIBLE
    ):
        raise _foreign(message.topic)
    return content


def _pieces(
    direction: Direction, raw: Message, offsets: list[int], lengths: list[int]
) -> list[Chunk]:
    """The reads or writes that one raw message holds."""
    found = []
    at, data = 0, raw.data
    for offset_us, length in zip(offsets, lengths, strict=True):
        after = offset_us / 1e6
        found.append(Chunk(direction, raw.at + after, raw.utc + after, data[at : at + length]))
        at += length
    return found


def _copy(source: FlightLog, stream: IO[bytes]) -> int:
    """Write what can be read, in parts as small as those of a recorder."""
    writer = mcap_module("writer").Writer(stream, chunk_size=PART_SIZE, enable_data_crcs=True)
    writer.start(library="m100link log recover")
    channels: dict[str, int] = {}
    schemas = {0: 0}
    saved = 0
    topics: dict[int, str] = {}
    with source.path.open("rb") as cut:
        for record in records(cut):
            if type(record) is RawMessage:
                writer.add_message(
                    channel_id=channels[topics[record.channel_id]],
                    log_time=record.log_time,
                    publish_time=record.publish_time,
                    sequence=record.sequence,
                    data=record.data,
                )
                saved += 1
            elif type(record) is RecordedSchema and record.id not in schemas:
                schemas[record.id] = writer.register_schema(*record[1:])
            elif type(record) is RecordedChannel:
                topics[record.id] = topic = record.topic
                if topic in (RX, TX, *SCHEMAS) and topic not in channels:
                    channels[topic] = registered(writer, topic)
                elif topic not in channels:
                    schema = schemas.get(record.schema_id, 0)
                    channels[topic] = writer.register_channel(*record[2:], schema)
            elif type(record) is Metadata:
                writer.add_metadata(record.name, _renumbered(record.metadata, channels, writer))
    writer.finish()
    return saved


def _renumbered(content: dict[str, str], channels: dict[str, int], writer: Any) -> dict[str, str]:
    """The recording's data on itself, with the numbers that its topics have in the new file."""
    for topic in (RX, TX, *SCHEMAS):
        if topic in content and topic not in channels:
            channels[topic] = registered(writer, topic)
    return content | {topic: str(number) for topic, number in channels.items() if topic in content}


# -- telemetry as a Parquet file, by pyarrow: for DuckDB, pandas, polars, Spark --------------------


_ROWS = 50_000  # of a part of the file, about 14 MB while it is made


def write_parquet(
    flight: FlightLog,
    stream: IO[bytes],
    *records: type[Any],
    firmware: str | FirmwareProfile | None = None,
) -> int:
    """Write a row per package, a column per number; null is what the package does not have.

    Args:
        flight: The log.
        stream: The file that takes the bytes.
        records: Record classes; none at all: every item.
        firmware: As for :meth:`FlightLog.samples`.

    Returns:
        How many rows.

    Raises:
        UsageError: pyarrow is not installed; no firmware is known.
    """
    instead = "; m100link log csv needs nothing"
    arrow = of_extra("pyarrow", "a Parquet file", "analysis", instead)
    parquet = of_extra("pyarrow.parquet", "a Parquet file", "analysis", instead)
    names, rows = flight.rows(*records, firmware=firmware)
    number = arrow.float64()
    schema = arrow.schema([(name, number) for name in names])
    count = 0
    with parquet.ParquetWriter(stream, schema, compression="zstd") as writer:
        while part := list(islice(rows, _ROWS)):
            count += len(part)
            columns = [
                arrow.array([None if math.isnan(value) else value for value in column], number)
                for column in zip(*part, strict=True)
            ]
            writer.write_table(arrow.table(columns, schema=schema))
    return count
