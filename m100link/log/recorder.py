"""Writes a flight log beside a connection that flies.

The event loop only notes what it heard and when. A thread makes the file of it: it decodes,
compresses, writes and waits for the disk, so that a disk that is slow or full costs the log and
nothing else.
"""

from __future__ import annotations

import asyncio
import atexit
import json
import logging
import math
import os
import queue
import threading
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from importlib.metadata import version
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

from m100link.errors import UsageError
from m100link.errors.texts import read_path, without_nan
from m100link.link import Direction, Link
from m100link.link.keyfile import locks
from m100link.log.channels import CHUNKS, FIX, LINK, RX, SCHEMAS, TX, Entry, FrameInterpreter
from m100link.log.records import PART_SIZE, mcap_module, registered
from m100link.protocol.firmware import FirmwareProfile
from m100link.protocol.records import AccelerationMode
from m100link.wire import Cipher, encode_frame
from m100link.wire.frame import CRC32_SIZE, HEADER_SIZE, MAX_SESSION, OVERHEAD, frame_length

if TYPE_CHECKING:
    from mcap.writer import Writer


_logger = logging.getLogger(__name__)


# -- what must not get into a log: the app id, which an activation carries in clear ----------------
# The key never travels. The checksum is made anew with the bytes: with the old one, four unknown
# bytes would be found by trying.


_ACTIVATION = b"\x00\x01"  # set and id
_IS_ACK, _SEALED = 0x20, 0xE0  # bits of the fourth and of the fifth byte
_SHORTEST = 4  # bytes of an app id
_LEFT_TELLING = 2
_TELLING = 3  # of them not zero: such four bytes do not come by chance


ECHO_S = 30.0  # sent bytes may come back for so long, s


def may_hold_secret(direction: Direction, data: bytes) -> bool:
    """Whether these bytes may be an activation of ours."""
    return direction is Direction.SENT and _ACTIVATION in data


class Redaction:
    """Takes app ids out of sent bytes, and out of echoes of them.

    A line that is joined with itself brings our own activation back, whole or with bytes lost. So
    for a time the app id and the checksum of what was taken out are looked for in what is
    received, too. An app id of few bytes that are not zero is looked for beside its neighbours
    alone, for telemetry is full of such numbers.
    """

    def __init__(self) -> None:
        self.count = 0  # places where something was taken out
        self._sent_at = 0.0
        # Secrets that must not be written down, the longest first, and the text in their place.
        self._secrets: dict[bytes, bytes] = {}

    def sent(self, data: bytes, now: float) -> bytes:
        """A write, which is some whole frames, without the app id."""
        if _ACTIVATION not in data:
            return data
        at = 0
        pieces = []
        while at < len(data):
            start = at
            size = frame_length(data, at)
            at += size or 1
            pieces.append(self._without(data[start:at], now) if size else data[start:at])
        return b"".join(pieces)

    def received(self, data: bytes, now: float) -> bytes:
        """Bytes that were read; they must not end within a secret, see :meth:`is_within`."""
        if self._is_over(now):
            return data
        for secret, blank in self._secrets.items():
            if secret in data:
                self.count += data.count(secret)
                data = data.replace(secret, blank)
        return data

    def is_within(self, data: bytes, now: float) -> bool:
        """Whether the rest of a secret may follow these bytes."""
        return bool(self._begun(data, now))

    def last(self, data: bytes, now: float) -> bytes:
        """Bytes that were read, after which none come: a secret that began is not shown either.

        But for a single byte: that comes by chance at the end of one log in fifty, where it would
        cost the last package its checksum, and tells a quarter of an app id at most.
        """
        data = self.received(data, now)
        begun = self._begun(data, now)
        if begun < _LEFT_TELLING:
            return data
        return data[: len(data) - begun] + bytes(begun)

    def _begun(self, data: bytes, now: float) -> int:
        """How many of the last bytes may be the beginning of a secret."""
        if self._is_over(now):
            return 0
        lengths = (
            length
            for secret in self._secrets
            for length in range(min(len(secret) - 1, len(data)), 0, -1)
            if data.endswith(secret[:length])
        )
        return max(lengths, default=0)

    def _is_over(self, now: float) -> bool:
        if now - self._sent_at > ECHO_S:
            self._secrets.clear()
        return not self._secrets

    def _without(self, frame: bytes, now: float) -> bytes:
        body = frame[HEADER_SIZE:-CRC32_SIZE]
        is_plain = not (frame[3] & _IS_ACK or frame[4] & _SEALED)
        is_whole = len(frame) >= OVERHEAD + len(_ACTIVATION) + _SHORTEST
        if not (is_plain and is_whole and body.startswith(_ACTIVATION)):
            return frame
        blank = encode_frame(
            _ACTIVATION + bytes(len(body) - len(_ACTIVATION)),
            session=frame[3] & MAX_SESSION,
            sequence=int.from_bytes(frame[8:10], "little"),
        )
        self.count += 1
        self._is_over(now)
        self._sent_at = now
        app_id, after = body[2:6], body[6:8]
        secrets = {frame: blank, frame[-CRC32_SIZE:]: blank[-CRC32_SIZE:]}
        if len(app_id) - app_id.count(0) >= _TELLING:
            secrets[app_id] = bytes(len(app_id))
        else:
            secrets[_ACTIVATION + app_id] = _ACTIVATION + bytes(len(app_id))
            secrets[app_id + after] = bytes(len(app_id)) + after
        # An echo of which one byte of it is lost: what is left, by what stands beside it.
        lefts = [app_id[:lost] + app_id[lost + 1 :] for lost in range(len(app_id))]
        lefts = [left for left in lefts if len(left) - left.count(0) >= _LEFT_TELLING]
        secrets |= {_ACTIVATION + left: _ACTIVATION + bytes(len(left)) for left in lefts}
        secrets |= {left + after: bytes(len(left)) + after for left in lefts}
        together = self._secrets | secrets
        self._secrets = {one: together[one] for one in sorted(together, key=len, reverse=True)}
        return blank


# -- recorder --------------------------------------------------------------------------------------

BATCH_S = 0.1  # what the loop notes goes to the thread so often: reads of so long are one message

FLUSH_S = 0.5  # a process that is killed loses what it noted for so long, and a batch

FSYNC_S = 5.0  # a computer that loses its power loses so much

MAX_WAITING = 16_000_000
"""Bytes of memory for what waits for a disk that stands still; the rest is dropped and counted."""

# Besides its bytes: a tuple, a time and a bytes object; a dictionary of counters.
_EACH_CHUNK, _EACH_REPORTED = 150, 3000

HANGS_S = 3.0  # a disk that has taken nothing for so long
_JOIN_S = 0.1
END_TIMEOUT_S = 15.0
"""How long closing waits for the disk; one that others write to takes seconds for a last piece."""

_LOOKS, _LOOK_S = 10, 0.001


_Known = tuple[Cipher | None, FirmwareProfile | None, AccelerationMode | None]


@dataclass
class Batch:
    """The events of the loop since the last batch, and the link's state at that time."""

    chunks: list[tuple[Direction, bytes, float]] = field(default_factory=list)
    entries: list[tuple[float, Entry]] = field(default_factory=list)
    cipher: Cipher | None = None
    profile: FirmwareProfile | None = None
    acceleration: AccelerationMode | None = None
    dropped: int = 0

    @property
    def heard(self) -> int:
        """Bytes that were heard."""
        return sum(len(data) for _, data, _ in self.chunks)

    @property
    def size(self) -> int:
        """Bytes of memory that it holds, or more."""
        return self.heard + _EACH_CHUNK * len(self.chunks) + _EACH_REPORTED * len(self.entries)


class Recorder:
    """Writes one connection into one file. ``connect(url, record=…)`` makes and ends one.

    Args:
        path: The file, which must not be there yet; a folder gets one that is named by the time.
        rate_hz: Decoded telemetry at most so often, Hz; 0: every package. The bytes of every
            package are in the file whatever it is.

    Attributes:
        path: The file.
        failure: Why recording ended before the connection did; None while it did not.
        dropped: Bytes that are not in the file because the disk did not keep up.

    Raises:
        UsageError: The file is there already or cannot be written, or the extra ``log`` is not
            installed.
    """

    def __init__(self, path: str | os.PathLike[str], *, rate_hz: float = 10.0) -> None:
        if not 0 <= rate_hz < math.inf:
            raise UsageError(f"{rate_hz} Hz is not a rate", remedy="0 for every package")
        mcap_module("writer")  # before there is a file
        self.path, stream = _new_file(read_path(path))
        self.failure: Exception | None = None
        self.dropped = 0
        self._loop: asyncio.AbstractEventLoop | None = None
        self._look: Callable[[], Iterable[Entry]] = tuple
        self._known: Callable[[], _Known] = _nothing
        self._batch = Batch()
        self._timer: asyncio.TimerHandle | None = None
        self._is_taken = False  # by a connection
        self._is_ended = False
        self._alive_at = time.monotonic()  # when the thread last came back from the disk
        # Bytes of memory, each counted by one side alone: loop, thread.
        self._given = self._taken = 0
        self._queue: queue.SimpleQueue[Batch | None] = queue.SimpleQueue()
        self._log = LogWriter(stream, rate_hz)
        self._thread = threading.Thread(target=self._write, name=f"log {self.path}", daemon=True)
        self._thread.start()
        atexit.register(self._end)

    # -- on the event loop -------------------------------------------------------------------------

    def begin(self) -> None:
        """Be the log of one connection.

        Raises:
            UsageError: It is that of another, or ended: a log is of one line and one clock.
        """
        if self._is_taken or self._is_ended:
            raise UsageError(
                f"{self.path} is the log of another connection",
                cause="a Recorder writes one connection into one file",
                remedy="a Recorder for each; or the folder: each gets a file of its own",
            )
        self._is_taken = True

    def tap(self, direction: Direction, data: bytes, now: float) -> None:
        """Note bytes of the line: see :data:`m100link.link.Tap`."""
        if self._is_ended:
            return
        if self._timer is None:
            self._loop = asyncio.get_running_loop()
            self._log.utc_offset_s = time.time() - now
            self._timer = self._loop.call_later(BATCH_S, self._tick)
        self._batch.chunks.append((direction, data, now))

    def watch(
        self,
        link: Link,
        firmware: Callable[[], FirmwareProfile],
        look: Callable[[], Iterable[Entry]],
        acceleration: Callable[[], AccelerationMode | None] = lambda: None,
    ) -> None:
        """Log the state of a connection besides its bytes.

        Args:
            link: Whose key decrypts.
            firmware: By which telemetry and movement are read.
            look: Called ten times a second; its messages are written.
            acceleration: The mode by which acceleration is read; None while it is not known.
        """
        self._known = lambda: (link.cipher, firmware(), acceleration())
        self._look = look

    async def aclose(self) -> None:
        """End the file. May be called again.

        Waits up to 15 seconds for the disk, while it takes anything: what flies waits for none that
        hangs. The thread ends the file when it can, and the interpreter waits for it.
        """
        if self._timer is not None:
            self._timer.cancel()
        self._hand_over()
        self._is_ended = True
        self._queue.put(None)
        await asyncio.to_thread(self._wait_for_end)
        if self._thread.is_alive():
            _logger.warning("%s: the disk did not take the end of the log", self.path)
        else:
            atexit.unregister(self._end)

    def _wait_for_end(self) -> None:
        until = time.monotonic() + END_TIMEOUT_S
        while self._thread.is_alive() and time.monotonic() < min(until, self._alive_at + HANGS_S):
            self._thread.join(_JOIN_S)

    def _tick(self) -> None:
        assert self._loop is not None
        self._timer = self._loop.call_later(BATCH_S, self._tick)  # first: it goes on, come what may
        self._hand_over()

    def _hand_over(self) -> None:
        batch, self._batch = self._batch, Batch()
        if self.failure is not None:
            return
        try:
            if self._loop is not None:
                now = self._loop.time()
                batch.entries = [
                    (content.pop("at", now), (topic, content)) for topic, content in self._look()
                ]
            batch.cipher, batch.profile, batch.acceleration = self._known()
        except Exception:
            _logger.exception("%s: from here on only bytes are recorded", self.path)
            self._look, self._known = tuple, _nothing
        size = batch.size
        if self._given - self._taken + size > MAX_WAITING:
            # But not what an echo must be compared with, lest it shows an app id.
            self._batch.chunks = [one for one in batch.chunks if may_hold_secret(*one[:2])]
            self.dropped += batch.heard - self._batch.heard
            return
        batch.dropped = self.dropped
        self._given += size
        self._queue.put(batch)

    # -- in the thread ----------------------------------------------------------------------------

    def _write(self) -> None:
        log, pending = self._log, self._queue
        try:
            while True:
                self._alive_at = time.monotonic()
                try:
                    batch = pending.get(timeout=FLUSH_S)
                except queue.Empty:
                    log.flush()
                    continue
                if batch is None:
                    self._alive_at = time.monotonic()
                    break
                log.write(batch)
                self._taken += batch.size
                log.flush_in_time()
            if log.finish():
                log.sync()
            else:  # the port could not even be opened: nothing is left behind
                log.close()  # Windows removes no file that is open
                self.path.unlink()
        except Exception as error:  # noqa: BLE001 - whatever it is ends the log and nothing else
            self.failure = error
            _logger.warning(
                "%s: recording ended, the flight goes on: %s; what was written can be read, and "
                "mended by: m100link log recover",
                self.path,
                error,
            )
        log.close()

    def _end(self) -> None:
        """The interpreter ends and nobody closed: write the notes."""
        if not self._is_ended:
            self._hand_over()
            self._queue.put(None)
        self._thread.join(END_TIMEOUT_S)


def is_being_written(path: Path) -> bool:
    """Whether some program writes the log now, this one among them."""
    try:
        with path.open("rb") as stream:
            return not _lock(stream)
    except OSError:
        return True  # a caller leaves such a file alone


def _lock(stream: IO[bytes]) -> bool:
    """Have the file for ourselves until it is closed, or the process is killed."""
    try:
        return locks(stream.fileno())
    except (OSError, UsageError) as error:  # a file system without locks, or Windows
        _logger.debug("a log without a lock: %s", error)
    return True


def _nothing() -> _Known:
    return None, None, None


def _new_file(place: Path) -> tuple[Path, IO[bytes]]:
    names = [place]
    if os.path.isdir(place):
        stem = time.strftime("m100link-%Y%m%d-%H%M%S")
        names = [place / f"{stem}{mark}.mcap" for mark in ("", *(f"-{n}" for n in range(2, 1000)))]
    for path in names:
        try:
            stream = path.open("xb")
            for _ in range(_LOOKS):
                if _lock(stream):
                    break
                time.sleep(_LOOK_S)  # somebody looks at this very moment whether it is written
            return path, stream
        except FileExistsError:  # by another process perhaps, in this very moment
            continue
        except OSError as error:
            raise UsageError(
                f"{path} cannot be written: {error.strerror}",
                remedy="name a file in a folder that is there and may be written",
            ) from error
    raise UsageError(
        f"{names[-1]} is there already; nothing was recorded",
        remedy="another name, or the folder: a new file is named by the time",
    )


class LogWriter:
    """Makes a file of batches: of a recorder, in its thread alone, or of a log that is copied.

    Args:
        stream: The file. It is not closed but by :meth:`close`.
        rate_hz: As for a recorder.

    Attributes:
        utc_offset_s: POSIX time less the time of the event loop, s. It is set once: a wall clock
            that is set in flight must not bend the log.
    """

    def __init__(self, stream: IO[bytes], rate_hz: float) -> None:
        self.utc_offset_s = 0.0
        self._stream = stream
        self._redaction = Redaction()
        self._witness = FrameInterpreter(rate_hz)
        # Not all of it is typed. Its checksum of the whole covers what stands outside of parts.
        writer: type[Writer] = mcap_module("writer").Writer
        self._writer: Any = writer(stream, chunk_size=PART_SIZE, enable_data_crcs=True)
        self._channels: dict[str, int] = {}
        self._sequences: dict[str, int] = {}
        # Bytes that were read and may end within a secret, until more of them come.
        self._held: list[tuple[bytes, float]] = []
        self._flushed_at = self._synced_at = time.monotonic()
        self._is_begun = False

    def write(self, batch: Batch) -> None:
        """Add what was heard since the batch before."""
        if not self._is_begun:
            if not (batch.chunks or batch.entries):
                return
            self._begin()
        # Sent bytes first: an echo of them stands in the same batch.
        for direction in (Direction.SENT, Direction.RECEIVED):
            chunks = [(data, now) for way, data, now in batch.chunks if way is direction]
            if direction is Direction.RECEIVED:
                chunks = [*self._held, *chunks]
                self._held = []
                joined = b"".join(data for data, _ in chunks)
                if chunks and self._redaction.is_within(joined, chunks[0][1]):
                    self._held = chunks
                    continue
            self._raw(direction, chunks, self._redaction.received)
        # In their order, for an answer follows what was asked.
        self._witness.acceleration.fix(batch.acceleration)
        if batch.profile is not None:
            for way, data, now in batch.chunks:
                if way is Direction.SENT:
                    entries = self._witness.sent(data, batch.cipher, batch.profile)
                else:
                    entries = self._witness.received(data, now, batch.cipher, batch.profile)
                for topic, content in entries:
                    self._json(topic, content, now)
        for now, (topic, content) in batch.entries:
            extra = {"log_dropped_bytes": batch.dropped} if topic == LINK else {}
            self._json(topic, {**content, **extra}, now)

    def flush_in_time(self) -> None:
        """Flush, if it is due."""
        now = time.monotonic()
        if now - self._flushed_at >= FLUSH_S:
            self.flush()

    def flush(self) -> None:
        """Give all of it to the system, and to the disk, if that is due."""
        if not self._is_begun:
            return
        self._writer.flush()
        self._flushed_at = time.monotonic()
        if self._flushed_at - self._synced_at >= FSYNC_S:
            self.sync()

    def sync(self) -> None:
        """Wait until the disk has it."""
        self._stream.flush()
        os.fsync(self._stream.fileno())
        self._synced_at = self._flushed_at

    def finish(self) -> bool:
        """End the file. Returns whether anything is in it."""
        if self._is_begun:
            self._raw(Direction.RECEIVED, self._held, self._redaction.last)
            self._writer.finish()
        return self._is_begun

    def close(self) -> None:
        """Close the stream, whatever becomes of the rest."""
        try:
            self._stream.close()
        except OSError as error:  # it holds what the disk did not take
            _logger.debug("the end of a log: %s", error)

    def _begin(self) -> None:
        self._is_begun = True
        here = version("m100link")
        self._writer.start(profile="", library=f"m100link {here}")
        about = {
            "version": here,
            "utc_offset_s": repr(self.utc_offset_s),
            "began": time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()),
        }
        # Outside of all parts, so that a first part that is damaged costs itself alone.
        for topic in (RX, TX, *SCHEMAS):
            self._channels[topic] = registered(self._writer, topic)
            about[topic] = str(self._channels[topic])
        self._writer.add_metadata("m100link", about)

    def _raw(
        self,
        direction: Direction,
        chunks: list[tuple[bytes, float]],
        redact: Callable[[bytes, float], bytes],
    ) -> None:
        if not chunks:
            return
        first = chunks[0][1]
        if direction is Direction.SENT:
            # Each write is some whole frames, so that each may be looked at for itself.
            pieces = [self._redaction.sent(data, now) for data, now in chunks]
        else:
            joined = redact(b"".join(data for data, _ in chunks), first)
            pieces, at = [], 0
            for data, _ in chunks:  # what is blanked is as long as it was
                pieces.append(joined[at : at + len(data)])
                at += len(data)
        topic = RX if direction is Direction.RECEIVED else TX
        self._add(topic, b"".join(pieces), first)
        content = {
            "direction": direction.value,
            "offset_us": [round((now - first) * 1e6) for _, now in chunks],
            "length": [len(piece) for piece in pieces],
        }
        self._json(CHUNKS, content, first)

    def _json(self, topic: str, content: dict[str, Any], now: float) -> None:
        if topic == FIX:
            at = self._nanoseconds(now)
            content = {
                "timestamp": {"sec": at // 10**9, "nsec": at % 10**9},
                **content,
            }
        self._add(topic, json.dumps(without_nan(content), separators=(",", ":")).encode(), now)

    def _add(self, topic: str, data: bytes, now: float) -> None:
        channel = self._channels[topic]
        sequence = self._sequences[topic] = self._sequences.get(topic, -1) + 1
        self._writer.add_message(
            channel_id=channel,
            log_time=self._nanoseconds(now),
            publish_time=max(0, round(now * 1e9)),
            sequence=sequence,
            data=data,
        )

    def _nanoseconds(self, now: float) -> int:
        return max(0, round((now + self.utc_offset_s) * 1e9))
