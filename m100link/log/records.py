"""The records of an MCAP file, as far as they are whole: of one that was cut off or damaged, too.

What was lost is passed over, and what stands behind it is looked for: a process is killed while it
writes, and disks turn bits over. No length that a file states is believed before it is seen to fit.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Collection, Iterator
from importlib import import_module
from typing import IO, Any, NamedTuple
from zlib import crc32

from m100link.errors import UsageError
from m100link.log.channels import SCHEMAS

__all__ = [
    "MAGIC",
    "Channel",
    "End",
    "Header",
    "Metadata",
    "Outline",
    "RawMessage",
    "Record",
    "Schema",
    "mcap_module",
    "outline",
    "records",
]

MAGIC = b"\x89MCAP0\r\n"
_MAX_RECORD = 64 << 20  # bytes; a damaged length must not ask for gigabytes
_WINDOW = 4 << 20  # bytes in which the next part is looked for at once

_HEADER, _FOOTER, _SCHEMA, _CHANNEL, _MESSAGE, _CHUNK = 0x01, 0x02, 0x03, 0x04, 0x05, 0x06
_INDEX, _METADATA = 0x07, 0x0C
_READ = frozenset({_HEADER, _FOOTER, _SCHEMA, _CHANNEL, _MESSAGE, _CHUNK, _METADATA})
_LAST_KIND = 0x0F

_HEAD = struct.Struct("<BQ")
_head = _HEAD.unpack_from
_message_head = struct.Struct("<HIQQ").unpack_from
_MESSAGE_HEAD = 22
_chunk_head = struct.Struct("<QQQII").unpack_from  # with the length of the name of the compression
_CHUNK_HEAD = 32

# A part as writers begin one: its compression by name, and lengths below four gigabytes.
_PART = re.compile(
    rb"\x06[\s\S]{4}\0{4}[\s\S]{20}\0{4}[\s\S]{4}(?:\x04\0\0\0zstd|\x03\0\0\0lz4|\0{4})[\s\S]{4}\0{4}"
)
_LONGEST_PART_HEAD = 9 + _CHUNK_HEAD + 4 + 8


class Header(NamedTuple):
    """What the file says of whoever wrote it."""

    profile: str
    library: str


class Schema(NamedTuple):
    """What stands on some channels."""

    id: int
    name: str
    encoding: str
    data: bytes


class Channel(NamedTuple):
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


class End(NamedTuple):
    """The file was ended by whoever wrote it."""


class Outline(NamedTuple):
    """What the parts of a file say of themselves; POSIX times in ns, 0 for none."""

    first_ns: int
    last_ns: int
    is_ended: bool


Record = Header | Schema | Channel | RawMessage | Metadata | End


def mcap_module(name: str) -> Any:
    """A module of the package that writes the files, and brings what unpacks them.

    Raises:
        UsageError: It is not installed.
    """
    try:
        return import_module(f"mcap.{name}")
    except ModuleNotFoundError as error:
        raise UsageError(
            f"a flight log needs {error.name}, which is not installed",
            remedy="pip install 'm100link[log]'",
        ) from None


def records(stream: IO[bytes], topics: Collection[str] = (), since_ns: int = 0) -> Iterator[Record]:
    """Every record of a file that can be read, in the order in which they were written.

    Args:
        stream: The file, from anywhere.
        topics: Messages of these alone; of all without any.
        since_ns: Parts that end before it are passed over, POSIX time in ns.
    """
    return _Reader(stream, topics).records(since_ns)


def outline(stream: IO[bytes]) -> Outline:
    """From when to when a file goes, without unpacking it."""
    return _Reader(stream, ()).outline()


class _Reader:
    def __init__(self, stream: IO[bytes], topics: Collection[str]) -> None:
        self._stream = stream
        self._topics = topics
        # Channels that were told, and which of them are passed on.
        self._known: set[int] = set()
        self._wanted: set[int] = set()
        self._is_searched = False  # for channels that no part told

    def records(self, since_ns: int) -> Iterator[Record]:
        for kind, body in self._outer():
            if kind != _CHUNK:
                yield from self._record(kind, body)
                continue
            if len(body) < _CHUNK_HEAD or _chunk_head(body)[1] < since_ns:
                continue
            try:
                inside = _unpacked(body)
            except Exception:  # noqa: BLE001 - whatever unpacking bytes of chance raises
                continue  # the next one may be whole
            yield from self._inside(inside)

    def outline(self) -> Outline:
        first, last, is_ended = 0, 0, False
        for kind, body in self._outer():
            if kind == _CHUNK and len(body) >= _CHUNK_HEAD:
                begin, end = _chunk_head(body)[:2]
                first, last = min(first or begin, begin), max(last, end)
            is_ended |= kind == _FOOTER
        return Outline(first, last, is_ended)

    def _outer(self) -> Iterator[tuple[int, bytes]]:
        """Kind and body of each record outside of parts."""
        stream, at = self._stream, len(MAGIC)
        while True:
            head = self._head_at(at)
            if len(head) < _HEAD.size:
                return
            kind, length = _head(head)
            end = at + _HEAD.size + length
            is_part = kind == _CHUNK
            if _fits(head) and (self._goes_on(end) or not is_part):
                if kind in _READ:
                    stream.seek(at + _HEAD.size)
                    body = stream.read(length)
                    if len(body) == length:  # an end that is cut off is not one
                        yield kind, body
                if self._goes_on(end):
                    at = end
                    continue
            # A part whose own length is damaged may stand here, or behind this record.
            place = end if _fits(head) and not is_part else at
            part = self._part_at(place)
            if part is not None:
                yield _CHUNK, part
            next_at = self._next_part(at + 1 if part is None else place + _HEAD.size + len(part))
            if next_at is None:
                return
            at = next_at

    def _head_at(self, at: int) -> bytes:
        """Kind and length of a record, and enough of its body to see whether they fit it."""
        self._stream.seek(at)
        return self._stream.read(_LONGEST_PART_HEAD)

    def _goes_on(self, at: int) -> bool:
        """Whether another record begins there, or the file ends as it should."""
        head = self._head_at(at)
        if head.startswith(MAGIC) or (not head and self._stream.seek(0, 2) == at):
            return True
        return len(head) >= _HEAD.size and _fits(head)

    def _part_at(self, at: int) -> bytes | None:
        """A part that is whole by its checksum, whatever is said of it and stands behind it."""
        head = self._head_at(at)
        length = _length_of_part(head)
        if length is None or head[0] != _CHUNK:
            return None
        self._stream.seek(at + _HEAD.size)
        body = self._stream.read(length)
        try:
            _unpacked(body)
        except Exception:  # noqa: BLE001 - whatever unpacking bytes of chance raises
            return None
        return body

    def _next_part(self, at: int) -> int | None:
        """Where the next part begins whose lengths fit each other."""
        while True:
            self._stream.seek(at)
            window = self._stream.read(_WINDOW)
            for found in _PART.finditer(window):
                if _fits(window[found.start() : found.start() + _LONGEST_PART_HEAD]):
                    return at + found.start()
            if len(window) < _WINDOW:
                return None
            at += _WINDOW - _LONGEST_PART_HEAD

    def _lost_channels(self) -> Iterator[Record]:
        """Channels whose own record is lost: by what stands outside of all parts.

        Whole files repeat schemas and channels at their end; ours name them at the beginning.
        """
        if self._is_searched:
            return
        self._is_searched = True
        named: dict[str, str] = {}
        for kind, body in self._outer():
            if kind in (_SCHEMA, _CHANNEL):
                yield from self._record(kind, body)
            elif kind == _METADATA:
                told = _parsed(kind, body)
                named = told.metadata if isinstance(told, Metadata) else named
        for topic, number in named.items():
            if topic.startswith("/") and number.isdecimal() and int(number) not in self._known:
                encoding = "json" if topic in SCHEMAS else ""
                yield self._channel(Channel(int(number), 0, topic, encoding))

    def _channel(self, channel: Channel) -> Channel:
        self._known.add(channel.id)
        if not self._topics or channel.topic in self._topics:
            self._wanted.add(channel.id)
        return channel

    def _record(self, kind: int, body: bytes) -> Iterator[Record]:
        try:
            record = _parsed(kind, body)
        except (struct.error, UnicodeDecodeError, LookupError):
            return
        if isinstance(record, Channel):
            yield self._channel(record)
        elif isinstance(record, RawMessage):
            if record.channel_id in self._wanted:
                yield record
        elif record is not None:
            yield record

    def _inside(self, data: bytes) -> Iterator[Record]:
        at, size, wanted, known = 0, len(data), self._wanted, self._known
        make = tuple.__new__
        while at + 9 <= size:
            kind, length = _head(data, at)
            begin = at + 9
            at = begin + length
            if at > size:
                return
            if kind == _MESSAGE and length >= _MESSAGE_HEAD:
                head = _message_head(data, begin)
                if head[0] not in known:
                    yield from self._lost_channels()
                if head[0] in wanted:
                    yield make(RawMessage, (*head, data[begin + _MESSAGE_HEAD : at]))
            else:
                yield from self._record(kind, data[begin:at])


def _fits(head: bytes) -> bool:
    """Whether a record may begin so; of the frequent ones, whether their lengths agree."""
    kind, length = _head(head)
    if not 0 < kind <= _LAST_KIND or length > _MAX_RECORD:
        return False
    if kind == _CHUNK:
        return bool(length == _length_of_part(head))
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
    """What a part holds, whole by its checksum."""
    _, _, size, checksum, name_size = _chunk_head(body)
    compression = body[_CHUNK_HEAD : _CHUNK_HEAD + name_size].decode()
    at = _CHUNK_HEAD + name_size + 8
    length = int.from_bytes(body[at - 8 : at], "little")
    packed = body[at : at + length]
    if len(packed) != length or size > _MAX_RECORD:
        raise ValueError(f"a part of {size} bytes")
    if compression == "zstd":
        zstd = import_module("zstandard")
        if zstd.frame_content_size(packed) > _MAX_RECORD:
            raise ValueError("a part that asks for more than it says")
        data = zstd.ZstdDecompressor().decompress(packed, max_output_size=size)
    elif compression == "lz4":
        # By pieces: a frame of lz4 need not say how much it holds.
        unpacker = import_module("lz4.frame").LZ4FrameDecompressor()
        data = unpacker.decompress(packed, max_length=size + 1)
    elif not compression:
        data = packed
    else:
        raise ValueError(f"the compression {compression!r}")
    if len(data) != size or (checksum and crc32(data) != checksum):
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
        return Schema(_short(body, 0), name, encoding, data)
    if kind == _CHANNEL:
        topic, at = _text(body, 4)
        encoding, _ = _text(body, at)
        return Channel(_short(body, 0), _short(body, 2), topic, encoding)
    if kind == _METADATA:
        name, at = _text(body, 0)
        pairs, _ = _bytes(body, at)
        values, at = {}, 0
        while at < len(pairs):
            key, at = _text(pairs, at)
            values[key], at = _text(pairs, at)
        return Metadata(name, values)
    return End() if kind == _FOOTER else None


def _short(body: bytes, at: int) -> int:
    return body[at] | body[at + 1] << 8


def _bytes(body: bytes, at: int) -> tuple[bytes, int]:
    (length,) = struct.unpack_from("<I", body, at)
    end = at + 4 + length
    if end > len(body):
        raise IndexError("a text that does not end")
    return body[at + 4 : end], end


def _text(body: bytes, at: int) -> tuple[str, int]:
    data, end = _bytes(body, at)
    return data.decode(), end
