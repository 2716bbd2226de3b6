"""Activating an aircraft for an app (document 2.2.1.2)."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable
from dataclasses import dataclass

from m100link.errors import ActivationRefused
from m100link.link import Link
from m100link.link.requests import Requests
from m100link.protocol.codes import ActivationCode
from m100link.protocol.commands.activation import Activate, Credentials, Version
from m100link.wire.cipher import Cipher

__all__ = ["ActivationProgress"]

_logger = logging.getLogger(__name__)

_TIMEOUT, _TRIES = 1.0, 3
_PAUSE = 2.0


@dataclass(frozen=True, slots=True)
class ActivationProgress:
    """Where an activation stands."""

    attempt: int  #: Number of the attempt, from 1.
    code: ActivationCode  #: Answer of the aircraft to it.
    next_attempt_in: float | None  #: Seconds until the next one, None after the last.
    remaining: float  #: Seconds until the whole activation gives up.


async def activate(
    requests: Requests,
    link: Link,
    credentials: Credentials,
    *,
    timeout: float,
    progress: Callable[[ActivationProgress], None] | None,
) -> Version:
    """See :meth:`m100link.Aircraft.activate`."""
    clock = asyncio.get_running_loop().time
    version = await requests.query_version()
    deadline = clock() + timeout
    attempt = 0
    while True:
        attempt += 1
        request = Activate.from_credentials(credentials, requests.firmware)
        code = await requests.execute(
            request,
            timeout=_TIMEOUT,
            tries=_TRIES,
            refusal=ActivationRefused,
        )
        remaining = max(0.0, deadline - clock())
        again = code == ActivationCode.NEW_DEVICE and remaining > 0
        pause = min(_PAUSE, remaining) if again else None
        if progress is not None:
            progress(ActivationProgress(attempt, code, pause, remaining))
        if code == ActivationCode.SUCCESS or _is_active_without_app(version, code):
            link.cipher = Cipher(credentials.key, random_padding=True)
            # Firmware without a level in the request asks DJI's server for it.
            requests.level = credentials.level if requests.firmware.has_level else None
            _logger.info("activated")
            return version
        if pause is None:
            raise ActivationRefused(
                f"activation failed: {code.meaning} (code {int(code)}, attempt {attempt})",
                command=request.NAME,
                code=int(code),
                cause=code.cause,
                remedy=code.remedy,
            )
        await asyncio.sleep(pause)


def _is_active_without_app(version: Version, code: ActivationCode) -> bool:
    """An active aircraft stays active when the app that reached the server is gone."""
    unreachable = (ActivationCode.APP_NOT_CONNECTED, ActivationCode.NO_INTERNET)
    return version.is_activated and code in unreachable
