"""The one road up: the aircraft's own messages, read by their class and acknowledged."""

from __future__ import annotations

import logging
from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Any, TypeVar, cast

from m100link.protocol.command import Address, Notification, encode_code
from m100link.protocol.commands.monitor import PushTelemetry
from m100link.protocol.commands.registry import COMMANDS

if TYPE_CHECKING:
    from m100link.link import Link
    from m100link.link.requests import Requests
    from m100link.protocol.firmware import FirmwareProfile
    from m100link.wire.frame import Frame

__all__ = ["Notifications"]

_logger = logging.getLogger(__name__)

_TELEMETRY = bytes(PushTelemetry.ADDRESS)

N = TypeVar("N", bound=Notification)


class Notifications:
    """Hands each notification to its takers; the link's ``on_received`` feeds it.

    Telemetry, which comes a hundred times a second, goes on as the bytes of its value. It is passed
    over until the firmware is known by which it is read.
    """

    __slots__ = ("_link", "_on_telemetry", "_requests", "_takers")

    def __init__(
        self,
        link: Link,
        requests: Requests,
        # Gets the value of each telemetry package, its firmware, and the time of its arrival.
        on_telemetry: Callable[[bytes, FirmwareProfile, float], None],
    ) -> None:
        self._link = link
        self._requests = requests
        self._on_telemetry = on_telemetry
        self._takers: dict[bytes, Callable[[Frame, float], None]] = {}
        link.on_received = self._on_received

    def subscribe(self, kind: type[N], handler: Callable[[N, float], None]) -> None:
        """Call the handler with each notification of that class and the time of its arrival."""
        self._takers[bytes(kind.ADDRESS)] = partial(self._take, kind, handler)

    def subscribe_at(self, address: Address, handler: Callable[[Any, float], None]) -> None:
        """The same by the address: its class is loaded when the first one comes."""

        def take_first(frame: Frame, now: float) -> None:
            kind = cast("type[Notification]", COMMANDS[address])
            self.subscribe(kind, handler)
            self._take(kind, handler, frame, now)

        self._takers[bytes(address)] = take_first

    def _on_received(self, frame: Frame, now: float) -> None:
        data = frame.data
        address = data[:2]
        if address == _TELEMETRY:
            requests = self._requests
            if requests.knows_layout:
                receive = self._on_telemetry
                receive(data[2:], requests.firmware, now)
            return
        taker = self._takers.get(address)
        if taker is not None:
            taker(frame, now)
        else:
            _logger.debug("a push that is not a push of the document: %s", data[:16].hex())

    def _take(
        self,
        kind: type[Notification],
        handler: Callable[[Any, float], None],
        frame: Frame,
        now: float,
    ) -> None:
        self._link.acknowledge(frame, encode_code(0))  # nothing is sent where no ack is wanted
        try:
            notification: Notification | None = kind.parse(frame.data[2:], self._requests.firmware)
        except ValueError as error:
            notification = kind.when_unreadable()
            _logger.warning("a notification that cannot be read: %s", error)
        if notification is not None:
            handler(notification, now)
