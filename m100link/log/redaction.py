"""What must not get into a log: the app id, which an activation carries in clear.

The key never travels. The checksum is made anew with the bytes: with the old one, four unknown
bytes would be found by trying.
"""

from __future__ import annotations

from m100link.wire import encode_frame
from m100link.wire.frame import CRC32_SIZE, HEADER_SIZE, MAX_SESSION, OVERHEAD, SOF

__all__ = ["Redaction"]

_ACTIVATION = b"\x00\x01"  # set and id
_IS_ACK, _SEALED = 0x20, 0xE0  # bits of the fourth and of the fifth byte
_SHORTEST = 4  # bytes of an app id


class Redaction:
    """Takes app ids out of what was sent, and out of what comes back of it.

    A line that is joined with itself brings our own activation back. So what was once taken out is
    looked for in what is received, too.

    Attributes:
        count: Places where something was taken out.
    """

    def __init__(self) -> None:
        self.count = 0
        # Whole frames as they were sent, and as they are written down.
        self._secrets: dict[bytes, bytes] = {}

    def sent(self, data: bytes) -> bytes:
        """A write, which is some whole frames, without the app id."""
        if _ACTIVATION not in data:
            return data
        at = 0
        pieces = []
        while len(data) - at >= HEADER_SIZE and data[at] == SOF:
            size = data[at + 1] | (data[at + 2] & 3) << 8
            if size < HEADER_SIZE:
                break
            frame = data[at : at + size]
            pieces.append(self._without(frame))
            at += size
        return b"".join((*pieces, data[at:]))

    def received(self, data: bytes) -> bytes:
        """Bytes that were read; they must not end within a secret, see :meth:`is_within`."""
        for secret, blank in self._secrets.items():
            if secret in data:
                self.count += data.count(secret)
                data = data.replace(secret, blank)
        return data

    def is_within(self, data: bytes) -> bool:
        """Whether the rest of a secret may follow these bytes."""
        return any(
            data.endswith(secret[:length])
            for secret in self._secrets
            for length in range(1, min(len(secret), len(data) + 1))
        )

    def _without(self, frame: bytes) -> bytes:
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
        self._secrets[frame] = blank
        return blank
