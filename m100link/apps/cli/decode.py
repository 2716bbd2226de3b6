"""``m100link decode``: hex in, frames and their meaning out."""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator
from functools import partial
from typing import Any

from m100link.apps.cli.options import Firmware
from m100link.apps.cli.terminal import ExitCode, as_json, complain, print_json, tell
from m100link.errors import UsageError
from m100link.protocol.describing import Describer
from m100link.protocol.firmware import FirmwareProfile, profile
from m100link.wire import Cipher


def decode(*streams: str, key: str | None = None, firmware: Firmware = "1.0") -> int:
    """Decode frames from hex: a stream per argument or input line.

    It prints one JSON object per stream: frames with decoded fields, the number of bytes outside
    frames, and why it discarded starts of frames. On a terminal it prints a table.

    Args:
        streams: Hex digits; spaces, colons and 0x are ignored.
        key: AES key, 64 hex digits, to decrypt frame data.
        firmware: Firmware profile with which to read telemetry and movement.
    """
    cipher = Cipher(key) if key else None
    status = ExitCode.OK
    for text in streams or _lines():
        try:
            stream = _from_hex(text)
        except UsageError as error:
            status = complain(error)
            if as_json():
                print_json({"error": error.seen, "error_code": error.error_code})
            continue
        decoded = decode_stream(stream, cipher=cipher, profile=profile(firmware))
        tell(decoded, partial(_print_table, decoded))
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


def decode_stream(
    stream: bytes, *, profile: FirmwareProfile, cipher: Cipher | None = None
) -> dict[str, Any]:
    """Everything that can be said about a stream of bytes, ready for JSON."""
    describer = Describer(profile, cipher)
    frames = describer.feed(stream) + describer.close()
    decoder = describer.decoder
    return {
        "frames": frames,
        "discarded_bytes": decoder.discarded_bytes,
        "discards": {str(cause): count for cause, count in decoder.discards.items() if count},
    }


_COMMON = ("session", "is_ack", "sequence", "encrypted", "padding", "data", "command", "raw")


def _print_table(decoded: dict[str, Any]) -> None:
    # For people only: a program that pipes frames through waits for the frames alone.
    from rich.table import Table

    from m100link.apps.cli.common import out

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
