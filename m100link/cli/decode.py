"""``m100link decode``: hex in, frames and their meaning out."""

from __future__ import annotations

import re
import sys
from collections import deque
from collections.abc import Iterable, Iterator
from typing import Annotated, Any

from cyclopts import Parameter

from m100link.cli.options import Firmware
from m100link.cli.outcome import ExitCode, complain, print_json
from m100link.errors import BadAck, M100Error, UsageError
from m100link.protocol.command import Acknowledged, Command, Problem, Unrecognised, plain
from m100link.protocol.commands.monitor import PushTelemetry
from m100link.protocol.commands.registry import COMMANDS, address_of, parse_command
from m100link.protocol.firmware import FirmwareProfile, Generation, profile
from m100link.protocol.packet import fitting_profiles
from m100link.wire import Cipher, Frame, FrameDecoder, encode_frame

__all__ = ["decode", "decode_stream"]


def decode(
    *streams: str,
    key: str | None = None,
    firmware: Firmware = "1.0",
    json: Annotated[bool | None, Parameter(negative="--table")] = None,
) -> int:
    """Decode frames from hex: one stream per argument, or per line of standard input.

    Each stream gives one JSON object on a line (or a table on a terminal): its frames with their
    decoded fields, the number of bytes that were part of no frame, and why starts were discarded.

    Args:
        streams: Hex digits; spaces, colons and 0x are ignored.
        key: AES key, 64 hex digits, to decrypt frame data.
        firmware: Firmware profile by which telemetry and movement are read.
        json: JSON lines instead of tables; the default when output is not a terminal.
    """
    try:
        cipher = Cipher(key) if key else None
    except M100Error as error:
        return complain(error)
    as_json = (not sys.stdout.isatty()) if json is None else json
    status = ExitCode.OK
    for text in streams or _lines():
        try:
            stream = _from_hex(text)
        except UsageError as error:
            status = complain(error)
            if as_json:
                print_json({"error": error.seen, "error_code": error.error_code})
            continue
        decoded = decode_stream(stream, cipher=cipher, profile=profile(firmware))
        if as_json:
            print_json(decoded)
        else:
            _print_table(decoded)
    return status


def _lines() -> Iterator[str]:
    for line in sys.stdin:
        if line.strip():
            yield line


def _from_hex(text: str) -> bytes:
    digits = re.sub(r"0x|[\s:,]", "", text, flags=re.IGNORECASE)
    try:
        return bytes.fromhex(digits)
    except ValueError:
        shown = text.strip()[:40]
        raise UsageError(
            f"this is not hex: {shown!r}",
            cause="an odd number of digits, or a character that is not a hex digit",
            remedy="give pairs of 0-9 and a-f; spaces and colons are fine",
        ) from None


class _Opener(Cipher):
    """Opens encrypted frames if there is a key, and keeps what it opened as it was.

    Without a key the decoder would pass encrypted frames over.
    """

    def __init__(self, cipher: Cipher | None) -> None:
        # No key is set up: what encrypts and decrypts is overridden.
        self._cipher = cipher
        self.sealed: deque[bytes] = deque()

    def decrypt(self, data: bytes) -> bytes:
        """Called once for each encrypted frame with data, in their order."""
        self.sealed.append(data)
        return self._cipher.decrypt(data) if self._cipher else data


class _Seal(Cipher):
    """Puts data back into a frame that are encrypted already."""

    def __init__(self, sealed: bytes, padding: int) -> None:
        self._sealed = sealed, padding

    def encrypt(self, data: bytes) -> tuple[bytes, int]:
        """What travelled."""
        return self._sealed


def decode_stream(
    stream: bytes, *, profile: FirmwareProfile, cipher: Cipher | None = None
) -> dict[str, Any]:
    """Everything that can be said about a stream of bytes, ready for JSON.

    An ack does not say what it answers; it is decoded when the stream holds its command too. Of an
    encrypted frame without a key everything but its data is told. Commands of later firmware are
    read whatever the profile, with their fields as on the wire under ``raw``.
    """
    opener = _Opener(cipher)
    decoder = FrameDecoder(opener)
    frames = decoder.feed(stream) + decoder.close()
    asked: dict[tuple[int, int], type[Command]] = {}
    described = []
    for frame in frames:
        is_sealed = frame.encrypted and bool(frame.data or frame.padding)
        sealed = opener.sealed.popleft() if is_sealed else b""
        if sealed and cipher is None:
            described.append(_describe_sealed(frame, sealed, stream))
        else:
            described.append(_describe(frame, profile, asked))
    return {
        "frames": described,
        "discarded_bytes": decoder.discarded_bytes,
        "discards": {str(cause): count for cause, count in decoder.discards.items() if count},
    }


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


def _describe(
    frame: Frame, profile: FirmwareProfile, asked: dict[tuple[int, int], type[Command]]
) -> dict[str, Any]:
    described = _outside(frame) | {"data": frame.data.hex()}
    exchange = (frame.session, frame.sequence)
    if frame.is_ack:
        return described | _ack(asked.get(exchange), frame.data, profile)
    address = address_of(frame.data)
    kind = COMMANDS.get(address) if address else None
    if kind is not None:  # whatever its value, it may be answered
        asked[exchange] = kind
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


def _later(
    name: str, kind: type[Command], raw: dict[str, Any], profile: FirmwareProfile
) -> dict[str, Any]:
    """The name, and what is told of commands that the document does not have."""
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


_COMMON = ("session", "is_ack", "sequence", "encrypted", "padding", "data", "command", "raw")


def _print_table(decoded: dict[str, Any]) -> None:
    # For people only: whoever pipes frames through waits for nothing but the frames.
    from rich.table import Table

    from m100link.cli.common import out

    table = Table(box=None, pad_edge=False)
    for title in ("session", "seq", "kind", "command", "data", "meaning"):
        table.add_column(title, overflow="fold")
    for frame in decoded["frames"]:
        meaning = ", ".join(
            f"{name}={value}" for name, value in frame.items() if name not in _COMMON
        )
        kind = ("ack" if frame["is_ack"] else "command") + (" aes" if frame["encrypted"] else "")
        table.add_row(
            str(frame["session"]),
            str(frame["sequence"]),
            kind,
            frame["command"] or "?",
            frame["data"] if frame["data"] is not None else "?",
            meaning,
        )
    out.print(table)
    out.print(f"{decoded['discarded_bytes']} bytes discarded {decoded['discards'] or ''}")
