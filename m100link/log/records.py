"""The records of an MCAP file, as far as they are whole: of one that was cut off or damaged, too.

Lost records are counted and passed over, and the reader looks for those behind them: a process is
killed while it writes, and disks turn bits over. No length that a file states is believed before it
is seen to fit. A part that a checksum covers is passed on when that is right, and never in pieces:
which messages of a part a wrong one spoilt, nobody can say.
"""

from __future__ import annotations

import re
import struct
from collections import Counter
from collections.abc import Collection, Iterator
from importlib import import_module
from typing import IO, Any, NamedTuple
from zlib import crc32

from m100link.errors.usage import of_extra
from m100link.log.channels import RX, SCHEMAS, TX
from m100link.log.damage import Losses

MAGIC = b"\x89MCAP0\r\n"

PART_SIZE = 32 << 10
"""Bytes of messages in a part, half a second of a flight: a bad sector costs no more."""

_MAX_RECORD = 64 << 20  # bytes; a damaged length must not ask for gigabytes
_WINDOW = 4 << 20  # bytes in which the next part is looked for at once

_HEADER, _FOOTER, _SCHEMA, _CHANNEL, _MESSAGE, _CHUNK = 0x01, 0x02, 0x03, 0x04, 0x05, 0x06
_INDEX, _STATISTICS, _METADATA, _OFFSET, _DATA_END = 0x07, 0x0B, 0x0C, 0x0E, 0x0F
_READ = frozenset(
    {_HEADER, _FOOTER, _SCHEMA, _CHANNEL, _MESSAGE, _CHUNK, _STATISTICS, _METADATA, _DATA_END}
)
_LENGTHS = {_FOOTER: 20, _OFFSET: 17, _DATA_END: 4}  # of those that are always as long
_LAST_KIND = 0x0F

_HEAD = struct.Struct("<BQ")
_head = _HEAD.unpack_from
_message = struct.Struct("<BQHIQQ").unpack_from  # with its kind and length
_message_head = struct.Struct("<HIQQ").unpack_from
_MESSAGE_HEAD = 22
_chunk_head = struct.Struct("<QQQII").unpack_from  # with the length of the name of the compression
_CHUNK_HEAD = 32
_footer = struct.Struct("<BQQQI").unpack_from  # with its kind and length
_FOOTER_SIZE = 9 + 20 + len(MAGIC)  # with the end of the file behind it
_counts = struct.Struct("<HQ").iter_unpack
_COUNTS = 46  # where they begin in the statistics, behind their size
_ZSTD = b"\x28\xb5\x2f\xfd"
_ALL_AT_ONCE = 1 << 20

# A part as writers begin one: its compression by name, and lengths below four gigabytes. Or the end
# of all parts, behind which the summary stands.
_PART = re.compile(
    rb"\x06[\s\S]{4}\0{4}[\s\S]{20}\0{4}[\s\S]{4}(?:\x04\0\0\0zstd|\x03\0\0\0lz4|\0{4})[\s\S]{4}\0{4}"
    rb"|\x0f\x04\0{7}"
)
_LONGEST_PART_HEAD = 9 + _CHUNK_HEAD + 4 + 8


class Header(NamedTuple):
    """The file's data on its writer."""

    profile: str
    library: str


class RecordedSchema(NamedTuple):
    """The schema of the messages on some channels."""

    id: int
    name: str
    encoding: str
    data: bytes


class RecordedChannel(NamedTuple):
    """Messages of one topic."""

    id: int
    schema_id: int
    topic: str
    message_encoding: str


class RawMessage(NamedTuple):
    """A message; its times are in ns."""

    channel_id: int
    sequence: int
    log_time: int
    publish_time: int
    data: bytes


class Metadata(NamedTuple):
    """Names and values beside the messages."""

    name: str
    metadata: dict[str, str]


class EndOfLog(NamedTuple):
    """The writer ended the file."""


Record = Header | RecordedSchema | RecordedChannel | RawMessage | Metadata | EndOfLog


def registered(writer: Any, topic: str) -> int:
    """Begin a channel of ours in a file that is written; returns its number."""
    schema = SCHEMAS.get(topic)
    if schema is None:
        return int(writer.register_channel(topic, "application/octet-stream", 0))
    number = writer.register_schema(schema.name, "jsonschema", schema.text.encode())
    return int(writer.register_channel(topic, "json", number))


def mcap_module(name: str) -> Any:
    """A module of the package that writes the files, and brings what unpacks them.

    Raises ``UsageError``: it is not installed.
    """
    return of_extra(f"mcap.{name}", "a flight log", "log")


def records(
    stream: IO[bytes],  # the file, from anywhere
    topics: Collection[str] = (),  # messages of these alone; of all without any
    since_ns: int = 0,  # parts that end before it are passed over, POSIX time in ns
    # Counts the missing messages of all topics when all were read.
    losses: Losses | None = None,
    pause_ns: int = 0,  # parts that end so soon after one that was read are passed over
) -> Iterator[Record]:
    """Every record of a file that can be read, in the order in which they were written."""
    return _Reader(stream, topics, losses).records(since_ns, pause_ns)


def by_index(stream: IO[bytes], topic: str) -> tuple[list[RawMessage], Any] | None:
    """Messages of a topic, from the parts that hold one, and the statistics of ``mcap``.

    None without an index, or where it does not fit. Damaged ones raise anything.
    """
    summary = mcap_module("reader").make_reader(stream).get_summary()
    size = stream.seek(0, 2)
    reader = _Reader(stream, (topic,))
    footer = reader._read(size - _FOOTER_SIZE, _FOOTER_SIZE)
    _, _, begin, _, checksum = _footer(footer)
    if summary is None or reader._checksum(begin, size - _FOOTER_SIZE + 25) != checksum:
        return None
    for one in summary.channels.values():
        reader._channel(RecordedChannel(one.id, one.schema_id, one.topic, one.message_encoding))
    counts, found = summary.statistics.channel_message_counts, []
    parts = {one.chunk_start_offset + _HEAD.size: one for one in summary.chunk_indexes}
    for at, part in parts.items():  # each once, however often it is named
        if reader._wanted & part.message_index_offsets.keys():
            body = reader._read(at, part.chunk_length)  # it says itself where it ends
            inside = reader._inside(_unpacked(body))
            found += [one for one in inside if isinstance(one, RawMessage)]
    if len(found) != sum(counts.get(channel, 0) for channel in reader._wanted):
        return None
    return found, summary.statistics


def holds_parts(stream: IO[bytes]) -> bool:
    """Whether a file that does not begin as one begins may be one, damaged where it begins."""
    return any(kind == _CHUNK for _, kind, _ in _Reader(stream, ())._outer())


class _Reader:
    def __init__(
        self, stream: IO[bytes], topics: Collection[str], losses: Losses | None = None
    ) -> None:
        self._stream = stream
        # Nothing behind it is read: a file that is being written grows.
        self._size = stream.seek(0, 2)
        self._topics = topics
        self._losses = losses or Losses()
        # Channels that the file declares, and which of them are passed on.
        self._known: set[int] = set()
        self._wanted: set[int] = set()
        self._is_searched = False  # for channels that no part declares
        self._has_parts = False
        self._data_end = 0  # where all parts have ended
        self._head = self._size, b""  # the newest that was asked for, and its place
        self._is_summary_whole = False
        self._counted: dict[int, int] = {}

    def records(self, since_ns: int, pause_ns: int = 0) -> Iterator[Record]:
        for at, kind, body in self._outer():
            if kind != _CHUNK:
                yield from self._outside(at, kind, body)
                continue
            self._has_parts = True
            if len(body) >= _CHUNK_HEAD and _chunk_head(body)[1] < since_ns:
                continue
            try:
                inside = _unpacked(body)
            except Exception:  # noqa: BLE001 - whatever unpacking bytes of chance raises
                self._losses.place(at, at + _HEAD.size + len(body))
                continue  # the next one may be whole
            if pause_ns:
                since_ns = _chunk_head(body)[1] + pause_ns
            yield from self._inside(inside)

    def _outer(self) -> Iterator[tuple[int, int, bytes]]:
        """Place, kind and body of each record outside of parts."""
        at = len(MAGIC)
        if not self._head_at(0).startswith(MAGIC):
            self._losses.place(0, at)
        while len(head := self._head_at(at)) >= _HEAD.size:
            if head.startswith(MAGIC):  # two files in one
                at += len(MAGIC)
                continue
            kind, length = _head(head)
            end = at + _HEAD.size + length
            is_part = kind == _CHUNK
            goes_on = _fits(head) and self._goes_on(end)
            is_there = goes_on or (_fits(head) and not is_part and end <= self._size)
            if is_there and kind in _READ:
                yield at, kind, self._read(at + _HEAD.size, length)
            if goes_on:
                at = end
                continue
            # A part whose own length is damaged may stand here, or behind this record.
            place = end if _fits(head) and not is_part else at
            search = at + 1
            part = self._part_at(place)
            if part is not None:
                self._losses.place(place, place + _HEAD.size)
                yield place, _CHUNK, part
                # The length inside may be the damaged one, and reach over the parts behind it.
                search = place + 1
                stated = place + _HEAD.size + _head(self._head_at(place))[1]
                place += _HEAD.size + len(part)
                inside = range(search, self._size + 1)
                ends = [end for end in (stated, place) if end in inside and self._goes_on(end)]
                if ends:
                    at = min(ends)
                    continue
            next_at = self._next_part(search)
            if next_at is None:
                self._tail(at if end > self._size else place)
                return
            self._losses.place(place if next_at >= place else at, next_at)
            at = next_at
        if head and not head.startswith(MAGIC):
            self._tail(at)

    def _tail(self, at: int) -> None:
        """Nothing more can be read: it was cut off within a record, or is damaged to its end."""
        head = self._head_at(at)
        is_cut = any(head) and len(head) < _LONGEST_PART_HEAD
        if not is_cut and len(head) >= _HEAD.size and _fits(head):
            is_cut = at + _HEAD.size + _head(head)[1] > self._size
        if is_cut and self._read(max(0, self._size - len(MAGIC)), len(MAGIC)) != MAGIC:
            self._losses.cut_bytes = self._size - at
        else:
            self._losses.place(at, self._size)

    def _read(self, at: int, size: int) -> bytes:
        if at >= self._size:  # a damaged length leads where no system seeks to
            return b""
        self._stream.seek(at)
        return self._stream.read(min(size, self._size - at))

    def _checksum(self, begin: int, end: int) -> int:
        found = 0
        for at in range(begin, end, _ALL_AT_ONCE):
            found = crc32(self._read(at, min(_ALL_AT_ONCE, end - at)), found)
        return found

    def _outside(self, at: int, kind: int, body: bytes) -> Iterator[Record]:
        """A record that no part holds: checksums cover it only together with all others."""
        losses, end = self._losses, at + _HEAD.size + len(body)
        if kind == _MESSAGE and self._has_parts:  # nobody writes both: it is an index, damaged
            losses.place(at, end)
        elif kind == _DATA_END:
            self._data_end = end
            checksum = int.from_bytes(body, "little")
            losses.is_changed |= bool(checksum) and self._checksum(0, at) != checksum
        elif kind == _STATISTICS and self._data_end:
            size = (len(body) - _COUNTS) // 10 * 10
            self._counted = dict(_counts(body[_COUNTS : _COUNTS + size]))
        elif kind == _FOOTER and self._data_end:
            checksum = int.from_bytes(body[16:], "little")
            if checksum and self._checksum(self._data_end, end - 4) != checksum:
                losses.place(self._data_end, end)
            else:
                self._is_summary_whole = True
                losses.counts = self._counted
        try:
            record = None if kind == _MESSAGE and self._has_parts else _parsed(kind, body)
        except (struct.error, UnicodeDecodeError, LookupError):
            losses.place(at, end)
            return
        if isinstance(record, Header):
            losses.is_numbered = record.library.startswith("m100link")
        elif isinstance(record, EndOfLog):
            losses.is_ended = True
        if isinstance(record, RawMessage):
            yield from self._message(record)
        elif record is not None:
            yield self._channel(record) if isinstance(record, RecordedChannel) else record

    def _message(self, record: RawMessage) -> Iterator[Record]:
        is_known = record.channel_id in self._known
        self._losses.hear(record.channel_id, record.sequence, record.log_time, is_known)
        if record.channel_id in self._wanted:
            yield record

    def _head_at(self, at: int) -> bytes:
        """Kind and length of a record, and enough of its body to see whether they fit it."""
        if at != self._head[0]:  # each is asked for twice
            self._head = at, self._read(at, _LONGEST_PART_HEAD)
        return self._head[1]

    def _goes_on(self, at: int) -> bool:
        """Whether another record begins there, or the file ends as it should."""
        head = self._head_at(at)
        if head.startswith(MAGIC) or at == self._size:
            return True
        return len(head) >= _HEAD.size and _fits(head)

    def _part_at(self, at: int) -> bytes | None:
        """A part that is whole by its checksum, whatever is said of it and stands behind it."""
        head = self._head_at(at)
        length = _length_of_part(head)
        if length is None or head[0] != _CHUNK:
            return None
        body = self._read(at + _HEAD.size, length)
        try:
            _unpacked(body)
        except Exception:  # noqa: BLE001 - whatever unpacking bytes of chance raises
            return None
        return body

    def _next_part(self, at: int) -> int | None:
        """Where the next part begins whose lengths fit each other."""
        while True:
            window = self._read(at, _WINDOW)
            for found in _PART.finditer(window):
                if _fits(window[found.start() : found.start() + _LONGEST_PART_HEAD]):
                    return at + found.start()
            if len(window) < _WINDOW:
                return None
            at += _WINDOW - _LONGEST_PART_HEAD

    def _lost_channels(self) -> Iterator[Record]:
        """Channels whose own record is lost: by what stands outside of all parts.

        Whole files repeat schemas and channels at their end; ours name them at the beginning, where
        no checksum covers them: a number that two topics have is that of neither.
        """
        if self._is_searched:
            return
        self._is_searched = True
        named: dict[str, str] = {}
        repeated: list[RecordedSchema | RecordedChannel] = []
        apart = _Reader(self._stream, ())
        apart._has_parts = True
        for at, kind, body in apart._outer():
            for record in () if kind == _CHUNK else apart._outside(at, kind, body):
                if isinstance(record, RecordedSchema | RecordedChannel) and apart._data_end:
                    repeated.append(record)
                elif isinstance(record, Metadata):
                    named = record.metadata
        for one in repeated if apart._is_summary_whole else ():
            yield self._channel(one) if isinstance(one, RecordedChannel) else one
        numbers = Counter(named.values())
        for topic, number in named.items():
            if topic not in (RX, TX, *SCHEMAS) or numbers[number] > 1 or not number.isdecimal():
                continue
            if int(number) not in self._known:
                encoding = "json" if topic in SCHEMAS else ""
                yield self._channel(RecordedChannel(int(number), 0, topic, encoding))

    def _channel(self, channel: RecordedChannel) -> RecordedChannel:
        self._known.add(channel.id)
        self._losses.topics[channel.id] = channel.topic
        if not self._topics or channel.topic in self._topics:
            self._wanted.add(channel.id)
        return channel

    def _inside(self, data: bytes) -> list[Record]:
        # Every message of every log passes here, so this is written for speed.
        found: list[Record] = []
        at, size, wanted, known = 0, len(data), self._wanted, self._known
        hear = self._losses.hear
        make = tuple.__new__
        data += bytes(_MESSAGE_HEAD)  # the head of a message can be read wherever a record begins
        while at + _HEAD.size <= size:
            kind, length, channel, number, log_time, publish_time = _message(data, at)
            begin = at + _HEAD.size
            at = begin + length
            if at > size:
                break
            if kind == _MESSAGE and length >= _MESSAGE_HEAD:
                if channel not in known:
                    found += self._lost_channels()
                hear(channel, number, log_time, channel in known)
                if channel in wanted:
                    content = data[begin + _MESSAGE_HEAD : at]
                    raw = channel, number, log_time, publish_time, content
                    found.append(make(RawMessage, raw))
            else:
                try:
                    record = _parsed(kind, data[begin:at])
                except (struct.error, UnicodeDecodeError, LookupError):
                    continue  # of a part without a checksum
                if isinstance(record, RecordedChannel):
                    self._channel(record)
                if record is not None:
                    found.append(record)
        return found


def _fits(head: bytes) -> bool:
    """Whether a record may begin so; of the frequent ones, whether their lengths agree."""
    kind, length = _head(head)
    if not 0 < kind <= _LAST_KIND or length > _MAX_RECORD:
        return False
    if kind == _CHUNK:
        return bool(length == _length_of_part(head))
    if length != _LENGTHS.get(kind, length):
        return False
    if kind == _INDEX and len(head) >= _HEAD.size + 6:
        return bool(length == 6 + int.from_bytes(head[_HEAD.size + 2 : _HEAD.size + 6], "little"))
    return True


def _length_of_part(head: bytes) -> int | None:
    """How long the body of a part is by what it says of its inside; None: it is not a part."""
    if len(head) < _HEAD.size + _CHUNK_HEAD:
        return None
    name_size = _chunk_head(head, _HEAD.size)[-1]
    at = _HEAD.size + _CHUNK_HEAD + name_size
    held = head[at : at + 8]
    length = _CHUNK_HEAD + name_size + 8 + int.from_bytes(held, "little")
    return length if len(held) == 8 and length <= _MAX_RECORD else None


def _unpacked(body: bytes) -> bytes:
    """The content of a part, whole by its checksum."""
    _, _, size, checksum, name_size = _chunk_head(body)
    compression = body[_CHUNK_HEAD : _CHUNK_HEAD + name_size].decode(errors="replace")
    at = _CHUNK_HEAD + name_size + 8
    length = int.from_bytes(body[at - 8 : at], "little")
    packed = body[at : at + length]
    if len(packed) != length:
        raise ValueError(f"a part of {size} bytes")
    if compression == "zstd" or (checksum and packed.startswith(_ZSTD)):
        zstd = import_module("zstandard")
        if max(zstd.frame_content_size(packed), 0) > _MAX_RECORD:
            raise ValueError("a part that asks for more than it says")
        data = zstd.ZstdDecompressor().decompress(packed, max_output_size=min(size, _MAX_RECORD))
    elif compression == "lz4":
        # By pieces: a frame of lz4 need not say how much it holds.
        unpacker = import_module("lz4.frame").LZ4FrameDecompressor()
        data = unpacker.decompress(packed, max_length=min(size, _MAX_RECORD) + 1)
    else:
        data = packed
    # Bytes with the right checksum are those that were written, whatever size the head states.
    if crc32(data) != checksum if checksum else len(data) != size:
        raise ValueError("its checksum is wrong")
    return bytes(data)


def _parsed(kind: int, body: bytes) -> Record | None:
    if kind == _MESSAGE:
        return RawMessage._make((*_message_head(body), body[_MESSAGE_HEAD:]))
    if kind == _HEADER:
        profile, at = _text(body, 0)
        return Header(profile, _text(body, at)[0])
    if kind == _SCHEMA:
        name, at = _text(body, 2)
        encoding, at = _text(body, at)
        data, _ = _bytes(body, at)
        return RecordedSchema(int.from_bytes(body[:2], "little"), name, encoding, data)
    if kind == _CHANNEL:
        topic, at = _text(body, 4)
        encoding, _ = _text(body, at)
        number, schema = struct.unpack_from("<HH", body)
        return RecordedChannel(number, schema, topic, encoding)
    if kind == _METADATA:
        name, at = _text(body, 0)
        pairs, _ = _bytes(body, at)
        values, at = {}, 0
        while at < len(pairs):
            key, at = _text(pairs, at)
            values[key], at = _text(pairs, at)
        return Metadata(name, values)
    return EndOfLog() if kind == _FOOTER else None


def _bytes(body: bytes, at: int) -> tuple[bytes, int]:
    (length,) = struct.unpack_from("<I", body, at)
    end = at + 4 + length
    if end > len(body):
        raise IndexError("a text that does not end")
    return body[at + 4 : end], end


def _text(body: bytes, at: int) -> tuple[str, int]:
    data, end = _bytes(body, at)
    return data.decode(), end
