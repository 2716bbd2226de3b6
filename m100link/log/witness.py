"""Reads what goes over a line as somebody else would, and says what it means."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from m100link.errors import BadAck
from m100link.log.channels import COMMAND, FIX, TELEMETRY, Thinning, Told
from m100link.protocol.command import Acknowledged, Command, Unrecognised
from m100link.protocol.commands.activation import Activate
from m100link.protocol.commands.monitor import PushTelemetry
from m100link.protocol.commands.registry import COMMANDS, address_of, parse_command
from m100link.protocol.firmware import FirmwareProfile
from m100link.protocol.records import Position
from m100link.wire import Cipher, Frame, FrameDecoder

_TELEMETRY = bytes(PushTelemetry.ADDRESS)


def is_telemetry(frame: Frame) -> bool:
    """Whether the frame is a package of telemetry, whose value stands behind two bytes."""
    return frame.data.startswith(_TELEMETRY) and not frame.is_ack


def fix_of(position: Position) -> dict[str, Any]:
    """A position as ``foxglove.LocationFix``, without its time."""
    return {
        "frame_id": "m100",
        "latitude": position.latitude_deg,
        "longitude": position.longitude_deg,
        "altitude": position.altitude_m,
        "position_covariance": [0.0] * 9,
        "position_covariance_type": 0,  # unknown
    }


class Witness:
    """Two decoders, one for each direction, and what was asked.

    ``rate_hz``: telemetry at most so often; 0: every package.
    """

    def __init__(self, rate_hz: float) -> None:
        self._sent, self._received = FrameDecoder(), FrameDecoder()
        self._thinning = Thinning(1.0 / rate_hz if rate_hz else 0.0)
        # What was asked by session and sequence; the answer does not say it. A number is used again
        # within 65536 requests, so there are never more.
        self._asked: dict[tuple[int, int, bool], type[Command]] = {}

    def sent(self, data: bytes, cipher: Cipher | None, profile: FirmwareProfile) -> Iterator[Told]:
        """What the bytes of a write say."""
        self._sent.cipher = cipher
        for frame in self._sent.feed(data):
            yield from self._frame(frame, profile, is_ours=True)

    def received(
        self, data: bytes, now: float, cipher: Cipher | None, profile: FirmwareProfile
    ) -> Iterator[Told]:
        """What the bytes of a read say."""
        self._received.cipher = cipher
        for frame in self._received.feed(data):
            if is_telemetry(frame):
                yield from self._telemetry(frame.data[2:], now, profile)
            else:
                yield from self._frame(frame, profile, is_ours=False)

    def _telemetry(self, value: bytes, now: float, profile: FirmwareProfile) -> Iterator[Told]:
        told = self._thinning.hear(value, profile, now)
        if told is None:
            return
        yield TELEMETRY, told.row
        position = told.get(Position)
        if position is not None and position.is_possible:
            yield FIX, fix_of(position)

    def _frame(self, frame: Frame, profile: FirmwareProfile, *, is_ours: bool) -> Iterator[Told]:
        if not frame.data:
            return
        head = {
            "is_ack": frame.is_ack,
            "direction": "tx" if is_ours else "rx",
            "session": frame.session,
            "sequence": frame.sequence,
        }
        exchange = frame.session, frame.sequence, frame.is_ack is not is_ours
        if frame.is_ack:
            yield COMMAND, head | self._answer(self._asked.get(exchange), frame.data)
            return
        address = address_of(frame.data)
        kind = COMMANDS.get(address) if address else None
        if kind is not None and frame.session:
            self._asked[exchange] = kind
        command = parse_command(frame.data, profile)
        if isinstance(command, Unrecognised):
            word = kind.NAME if kind else str(address)
            known: dict[str, Any] = {"command": word, "problem": command.reason}
            if kind is Activate:  # why it cannot be read may say what is in it
                known = {"command": word, "problem": "unreadable", "redacted": True}
        elif isinstance(command, Activate):
            known = {"command": command.name, "redacted": True}
        else:
            known = {"command": command.name, **command.fields()}
        yield COMMAND, head | known

    @staticmethod
    def _answer(asked: type[Command] | None, payload: bytes) -> dict[str, Any]:
        if asked is None or not issubclass(asked, Acknowledged):
            return {"command": "?", "data": payload.hex()}
        try:
            answer = asked.parse_ack(payload)
        except BadAck as error:
            return {"command": asked.NAME, "problem": error.seen}
        return {"command": asked.NAME, **asked.ack_fields(answer)}
