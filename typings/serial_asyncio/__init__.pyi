import asyncio
from collections.abc import Callable
from typing import Any

import serial

class SerialTransport(asyncio.Transport):
    _loop: asyncio.AbstractEventLoop | None
    _serial: serial.Serial | None
    _protocol: asyncio.BaseProtocol | None
    _closing: bool
    _max_read_size: int
    def __init__(
        self,
        loop: asyncio.AbstractEventLoop,
        protocol: asyncio.BaseProtocol,
        serial_instance: serial.Serial,
    ) -> None: ...
    @property
    def serial(self) -> serial.Serial | None: ...
    def _abort(self, exc: BaseException | None) -> None: ...
    def _fatal_error(self, exc: BaseException, message: str = ...) -> None: ...
    def _call_connection_lost(self, exc: BaseException | None) -> None: ...
