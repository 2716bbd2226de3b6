"""A description of a stream of bytes, frame by frame, ready for JSON and for people.

An ack does not name its command; it is read when the command was seen, too. Without a key, the
description of an encrypted frame lacks its data. Commands of later firmware are read whatever the
profile, with their fields as on the wire under ``raw``.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from typing import Any

from m100link.errors import BadAck
from m100link.protocol.command import Acknowledged, Command, Problem, Unrecognised, plain
from m100link.protocol.commands.monitor import PushTelemetry
from m100link.protocol.commands.registry import COMMANDS, address_of, parse_command
from m100link.protocol.firmware import FirmwareProfile, Generation
from m100link.protocol.packet import fitting_profiles
from m100link.wire import Cipher, Frame, FrameDecoder, encode_frame

Asked = dict[tuple[int, int], type[Command]]  # what was asked, by session and sequence number

_LONGEST_FRAME = 1023


class _Opener(Cipher):
    """Opens encrypted frames if there is a key, and keeps what it opened as it was.

    Without a key the decoder would pass encrypted frames over.
    """

    def __init__(self, cipher: Cipher | None) -> None:
        # No key is set up: what encrypts and decrypts is overridden.
        self._cipher = cipher
        self.sealed: deque[bytes] = deque()
        self.decrypt_blocks = self.decrypt  # which the decoder asks for whole blocks

    def decrypt(self, data: bytes) -> bytes:
        """Called once for each encrypted frame with data, in their order."""
        self.sealed.append(data)
        return self._cipher.decrypt(data) if self._cipher else data


class _Seal(Cipher):
    """Puts data back into a frame that are encrypted already."""

    def __init__(self, sealed: bytes, padding: int) -> None:
        self._sealed = sealed, padding

    def encrypt(self, data: bytes) -> tuple[bytes, int]:
        """The bytes and the padding of the wire."""
        return self._sealed


class Describer:
    """Describes the frames of one stream.

    ``cipher``: what decrypts; None without a key.
    """

    def __init__(self, profile: FirmwareProfile, cipher: Cipher | None = None) -> None:
        self.asked: Asked = {}  # what was asked in this stream
        # The requests that the acks of this stream answer: its own, unless it is one direction of
        # two.
        self.answered = self.asked
        self._profile = profile  # firmware profile by which telemetry and movement are read
        self._has_key = cipher is not None
        self._opener = _Opener(cipher)
        self._recent = b""
        self.decoder = FrameDecoder(self._opener)  # what finds the frames, with its counters

    def feed(self, data: bytes) -> list[dict[str, Any]]:
        """The frames that these bytes end, described."""
        # A frame that ends here may have begun before.
        self._recent = self._recent[-_LONGEST_FRAME:] + data
        return [self._described(frame) for frame in self.decoder.feed(data)]

    def close(self) -> list[dict[str, Any]]:
        """The frames that are found when no bytes follow."""
        return [self._described(frame) for frame in self.decoder.close()]

    def _described(self, frame: Frame) -> dict[str, Any]:
        is_sealed = frame.encrypted and bool(frame.data or frame.padding)
        sealed = self._opener.sealed.popleft() if is_sealed else b""
        if sealed and not self._has_key:
            return _describe_sealed(frame, sealed, self._recent)
        return self._describe(frame)

    def _describe(self, frame: Frame) -> dict[str, Any]:
        profile = self._profile
        described = _outside(frame) | {"data": frame.data.hex()}
        exchange = (frame.session, frame.sequence)
        if frame.is_ack:
            return described | _ack(self.answered.get(exchange), frame.data, profile)
        address = address_of(frame.data)
        kind = COMMANDS.get(address) if address else None
        if kind is not None:  # whatever its value, it may be answered
            self.asked[exchange] = kind
        if not frame.data:
            return described | {"command": None}
        command = parse_command(frame.data, profile)
        if isinstance(command, Unrecognised):
            return described | _unrecognised(command)
        return (
            described
            | _later(command.name, type(command), command.raw(), profile)
            | (command.fields() | _note(command.problems()))
        )


def _outside(frame: Frame) -> dict[str, Any]:
    return {
        "session": frame.session,
        "is_ack": frame.is_ack,
        "sequence": frame.sequence,
        "encrypted": frame.encrypted,
        "padding": frame.padding,
    }


def _describe_sealed(frame: Frame, sealed: bytes, stream: bytes) -> dict[str, Any]:
    raw = encode_frame(
        sealed,
        session=frame.session,
        sequence=frame.sequence,
        is_ack=frame.is_ack,
        cipher=_Seal(sealed, frame.padding),
    )
    # The header has three bits for encryption; any but 0 counts as AES, and what we build has 1.
    is_as_sent = raw in stream
    return _outside(frame) | {
        "data": None,
        "command": None,
        "length": len(raw),
        "data_length": len(sealed) - frame.padding,
        "header_crc": f"0x{int.from_bytes(raw[10:12], 'little'):04X}" if is_as_sent else None,
        "frame_crc": f"0x{int.from_bytes(raw[-4:], 'little'):08X}" if is_as_sent else None,
        "ciphertext": sealed.hex(),
        "problem": "encrypted, and no key was given",
    }


def _later(
    name: str, kind: type[Command], raw: dict[str, Any], profile: FirmwareProfile
) -> dict[str, Any]:
    """The name, and further keys of commands that the document does not have."""
    described: dict[str, Any] = {"command": name}
    if kind.SINCE > Generation.V1_0:
        described["raw"] = raw
    if not kind.is_known_to(profile):
        since = f"it came with {kind.SINCE}"
        described["firmware_note"] = f"firmware {profile} does not know this command: {since}"
    return described


def _note(problems: Iterable[Problem]) -> dict[str, Any]:
    text = "; ".join(map(str, problems))
    return {"note": text} if text else {}


def _unrecognised(command: Unrecognised) -> dict[str, Any]:
    known = COMMANDS.get(command.address) if command.address else None
    described: dict[str, Any] = {
        "command": known.NAME if known else None,
        "address": str(command.address) if command.address else None,
        "problem": command.reason,
    }
    if known is PushTelemetry:
        described["fitting_firmware"] = fitting_profiles(command.value)
    return described


def _ack(asked: type[Command] | None, payload: bytes, profile: FirmwareProfile) -> dict[str, Any]:
    if asked is None or not issubclass(asked, Acknowledged):
        return {"command": None}
    try:
        answer = asked.parse_ack(payload)
    except BadAck as error:
        return {"command": asked.NAME, "problem": error.seen}
    if asked.SINCE > Generation.V1_0 and len(payload) < len(asked.encode_ack(answer)):
        code = asked.code_of(answer)
        described = _later(asked.NAME, asked, {"code": code}, profile)
        return described | {"ack": plain(code), "note": "its code alone: the rest did not come"}
    return _later(asked.NAME, asked, asked.ack_raw(answer), profile) | (
        asked.ack_fields(answer) | _note(asked.ack_problems(answer))
    )
