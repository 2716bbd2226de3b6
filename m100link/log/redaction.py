"""What must not get into a log: the app id, which an activation carries in clear.

The key never travels. The checksum is made anew with the bytes: with the old one, four unknown
bytes would be found by trying.
"""

from __future__ import annotations

import math

from m100link.link import Direction
from m100link.wire import encode_frame
from m100link.wire.crc import header_crc16
from m100link.wire.frame import CRC32_SIZE, HEADER_SIZE, MAX_SESSION, OVERHEAD, SOF

__all__ = ["ECHO_S", "Redaction", "may_hold_secret"]

_ACTIVATION = b"\x00\x01"  # set and id
_IS_ACK, _SEALED = 0x20, 0xE0  # bits of the fourth and of the fifth byte
_SHORTEST = 4  # bytes of an app id
_LEFT_TELLING = 2
_TELLING = 3  # of them not zero: such four bytes do not come by chance


ECHO_S = 30.0
"""What was sent may come back for so long, s."""


def may_hold_secret(direction: Direction, data: bytes) -> bool:
    """Whether these bytes may be an activation of ours."""
    return direction is Direction.SENT and _ACTIVATION in data


class Redaction:
    """Takes app ids out of what was sent, and out of what comes back of it.

    A line that is joined with itself brings our own activation back, whole or with bytes lost. So
    for a time the app id and the checksum of what was taken out are looked for in what is
    received, too. An app id of few bytes that are not zero is looked for beside its neighbours
    alone, for telemetry is full of such numbers.

    Attributes:
        count: Places where something was taken out.
    """

    def __init__(self) -> None:
        self.count = 0
        self._sent_at = -math.inf
        # What must not be written down, the longest first, and what is written in its place.
        self._secrets: dict[bytes, bytes] = {}

    def sent(self, data: bytes, now: float) -> bytes:
        """A write, which is some whole frames, without the app id."""
        if _ACTIVATION not in data:
            return data
        at = 0
        pieces = []
        while at < len(data):
            start = at
            size = _size_of_frame(data, at)
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


def _size_of_frame(data: bytes, at: int) -> int:
    """Of the frame that begins there; 0 when none does."""
    header = data[at : at + HEADER_SIZE]
    if len(header) < HEADER_SIZE or header[0] != SOF:
        return 0
    if header_crc16(header[:-2]) != int.from_bytes(header[-2:], "little"):
        return 0
    size = header[1] | (header[2] & 3) << 8
    return size if size >= HEADER_SIZE else 0
