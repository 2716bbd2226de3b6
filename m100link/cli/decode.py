"""``m100link decode``: hex in, frames and their meaning out."""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator
from typing import Annotated, Any

from cyclopts import Parameter
from rich.table import Table

from m100link.cli.common import ExitCode, Firmware, complain, out, print_json
from m100link.errors import BadAck, M100Error, UsageError
from m100link.protocol.command import Command, Request, Unrecognised, plain
from m100link.protocol.commands.activation import Version
from m100link.protocol.commands.registry import COMMANDS, parse_command
from m100link.protocol.firmware import FirmwareProfile, profile
from m100link.protocol.packet import fitting_profiles
from m100link.wire import Cipher, Frame, FrameDecoder

__all__ = ["decode", "decode_stream"]

_TELEMETRY = b"\x02\x00"


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
                print_json({"error": error.seen})
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
            cause="an odd number of digits, or a character that is no hex digit",
            remedy="give pairs of 0-9 and a-f; spaces and colons are fine",
        ) from None


def decode_stream(
    stream: bytes, *, profile: FirmwareProfile, cipher: Cipher | None = None
) -> dict[str, Any]:
    """Everything that can be said about a stream of bytes, ready for JSON.

    An ack does not say what it answers; it is decoded when the stream holds its command too.
    """
    decoder = FrameDecoder(cipher)
    frames = decoder.feed(stream) + decoder.close()
    asked: dict[tuple[int, int], type[Command]] = {}
    return {
        "frames": [_describe(frame, profile, asked) for frame in frames],
        "discarded_bytes": decoder.discarded_bytes,
        "discards": {str(cause): count for cause, count in decoder.discards.items() if count},
    }


def _describe(
    frame: Frame, profile: FirmwareProfile, asked: dict[tuple[int, int], type[Command]]
) -> dict[str, Any]:
    described: dict[str, Any] = {
        "session": frame.session,
        "is_ack": frame.is_ack,
        "sequence": frame.sequence,
        "encrypted": frame.encrypted,
        "padding": frame.padding,
        "data": frame.data.hex(),
    }
    address = (frame.session, frame.sequence)
    if frame.is_ack:
        command = asked.get(address)
        return described | (_ack(command, frame.data) if command else {"command": None})
    if not frame.data:
        return described | {"command": None}
    parsed = parse_command(frame.data, profile)
    if isinstance(parsed, Unrecognised):
        known = COMMANDS.get(parsed.address) if parsed.address else None
        described |= {
            "command": known.NAME if known else None,
            "address": str(parsed.address) if parsed.address else None,
            "problem": parsed.reason,
        }
        if frame.data[:2] == _TELEMETRY:
            described["fitting_firmware"] = fitting_profiles(frame.data[2:])
        return described
    asked[address] = type(parsed)
    return described | {"command": parsed.NAME} | parsed.fields()


def _ack(command: type[Command], payload: bytes) -> dict[str, Any]:
    described: dict[str, Any] = {"command": command.NAME}
    if not issubclass(command, Request):
        return described
    try:
        answer = command.parse_ack(payload)
    except BadAck as error:
        return described | {"problem": error.seen}
    if isinstance(answer, Version):
        return described | {
            "ack": plain(answer.code),
            "version": answer.name,
            "serial": answer.serial,
            "crc": answer.crc,
            "crc_matches": answer.crc_matches,
            "firmware": str(answer.profile) if answer.profile else None,
        }
    return described | {"ack": plain(answer)}


_COMMON = ("session", "is_ack", "sequence", "encrypted", "padding", "data", "command")


def _print_table(decoded: dict[str, Any]) -> None:
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
            frame["data"],
            meaning,
        )
    out.print(table)
    out.print(f"{decoded['discarded_bytes']} bytes discarded {decoded['discards'] or ''}")
