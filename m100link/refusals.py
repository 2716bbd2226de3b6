"""Which error an answer, or the lack of one, becomes."""

from __future__ import annotations

from typing import TYPE_CHECKING

from m100link.errors import (
    CommandNotSupported,
    CommandRefused,
    KeyRejected,
    LevelTooLow,
    NoAnswer,
    NotActivated,
    NoValidFrame,
    SilentLine,
)
from m100link.protocol.codes import AckCode, SystemCode

if TYPE_CHECKING:
    from m100link.link import Link

__all__ = ["key_rejected", "no_aircraft", "system_error"]


def no_aircraft(link: Link, timeout: float) -> SilentLine | NoValidFrame | NoAnswer:
    """Nobody answered the version query; says how far the line reaches."""
    numbers = link.statistics()
    where = f"{link.name}, {timeout:g} s"
    received = {
        "bytes_received": numbers.bytes_received,
        "frames_received": numbers.frames_received,
    }
    if not numbers.bytes_received:
        return SilentLine(
            f"not one byte arrived ({where})",
            cause="no power, TX and RX swapped, no common ground, or the wrong port",
            remedy="swap TX and RX, check ground and the port name; docs: howto/silent-line",
            **received,
        )
    if not numbers.frames_received:
        return NoValidFrame(
            f"{numbers.bytes_received} bytes arrived and not one valid frame ({where})",
            cause="another baud rate than the one set in the PC assistant, or noise",
            remedy="try 230400, 115200, 921600; docs: howto/silent-line",
            **received,
        )
    return NoAnswer(
        f"{numbers.frames_received} frames arrived, but no answer to a version query ({where})",
        cause="the wire from our TX to the aircraft's RX, or two programs on one port",
        remedy="check that wire; docs: howto/silent-line",
        **received,
    )


def key_rejected(name: str) -> KeyRejected:
    """Encrypted and without a usable answer, while plain requests are answered."""
    return KeyRejected(
        f"{name} was encrypted and got no usable answer, while plain requests are answered",
        command=name,
        cause="the key of this program is not the one that the aircraft was activated with",
        remedy="check the enc key of the app id, and activate again",
    )


def system_error(
    name: str, code: AckCode, encrypted: bool, refusal: type[CommandRefused]
) -> CommandRefused | KeyRejected:
    """The error for a system code."""
    if code == SystemCode.NOT_SUPPORTED and encrypted:
        return key_rejected(name)
    kind = {
        SystemCode.NOT_SUPPORTED: CommandNotSupported,
        SystemCode.NOT_ACTIVATED: NotActivated,
        SystemCode.LEVEL_TOO_LOW: LevelTooLow,
    }.get(SystemCode(int(code)), refusal)
    return kind(
        f"{name} was refused: {code.meaning} (code 0x{code:04X})",
        command=name,
        code=int(code),
        cause=code.cause,
        remedy=code.remedy,
    )
