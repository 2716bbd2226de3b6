"""Obtaining and releasing control authority (document 2.2.2.1, errata 24)."""

from __future__ import annotations

import asyncio
import logging
from typing import TYPE_CHECKING

from m100link.authority import AuthorityInput, AuthorityState
from m100link.errors import AuthorityLost, AuthorityRefused, M100Error
from m100link.protocol.codes import AuthorityCode
from m100link.protocol.control import RequestAuthority

if TYPE_CHECKING:
    from m100link.tasks import Commander

__all__ = ["authority_lost", "obtain_authority", "release_authority"]

_logger = logging.getLogger("m100link.authority")

_PAUSE_S = 0.05  # between requests; DJI's C library waits as long
_MAX_REQUESTS = 10
_RELEASE_DEADLINE_S = 2.0


def _requests(commander: Commander) -> int:
    """How often to ask: firmware that wants two requests answers the first "in progress"."""
    return _MAX_REQUESTS if commander.firmware.authority_requests > 1 else 1


async def _request(commander: Commander, *, obtain: bool) -> AuthorityCode:
    return AuthorityCode(
        await commander.execute(
            RequestAuthority(obtain=obtain), timeout=0.5, tries=2, refusal=AuthorityRefused
        )
    )


async def obtain_authority(commander: Commander) -> None:
    """Ask until authority is ours.

    Raises:
        AuthorityRefused: With cause and remedy.
        NotActivated, LevelTooLow, KeyRejected, AckTimeout, LinkError: See each class.
    """
    authority = commander.authority
    authority.feed(AuthorityInput.OBTAIN)
    code = AuthorityCode.NOT_CHANGED
    try:
        for attempt in range(_requests(commander)):
            if attempt:
                await asyncio.sleep(_PAUSE_S)
            code = await _request(commander, obtain=True)
            if code != AuthorityCode.NOT_CHANGED:
                break
        if code == AuthorityCode.OBTAINED:
            authority.feed(AuthorityInput.OBTAINED)
            _logger.info("control authority obtained")
            return
    finally:
        if authority.state is AuthorityState.OBTAINING:
            authority.feed(AuthorityInput.REFUSED)
    situation = commander.state.situation()
    raise AuthorityRefused(
        f"the aircraft did not give control authority: {code.meaning or code.name} "
        f"(code 0x{code:04X}; mode switch {situation['mode_switch'] or 'unknown'})",
        command=RequestAuthority.NAME,
        code=int(code),
        cause=code.cause,
        remedy=code.remedy,
    )


async def release_authority(commander: Commander) -> None:
    """Give authority back, within two seconds. What goes wrong is logged, not raised.

    The control block ends all the same: without setpoints the aircraft hovers.
    """
    authority = commander.authority
    authority.feed(AuthorityInput.RELEASE)
    try:
        async with asyncio.timeout(_RELEASE_DEADLINE_S):
            for attempt in range(_requests(commander)):
                if attempt:
                    await asyncio.sleep(_PAUSE_S)
                code = await _request(commander, obtain=False)
                if code not in (AuthorityCode.NOT_CHANGED, AuthorityCode.RELEASING):
                    break
        _logger.info("control authority released")
    except (M100Error, TimeoutError) as error:
        _logger.warning("control authority may not be released: %s", error)
    finally:
        authority.feed(AuthorityInput.RELEASED)


def authority_lost(reason: str) -> AuthorityLost:
    """The error for a loss of authority with that reason."""
    meaning, remedy = {
        "mode_switch": (
            "the pilot moved the mode switch out of F",
            "the pilot has the aircraft; back in F, start a new control block",
        ),
        "app": (
            "the mobile app took control",
            "let the app release control, then start a new control block",
        ),
    }.get(reason, ("the aircraft says that authority passed away", "ask the pilot what happened"))
    return AuthorityLost(meaning, reason=reason, remedy=remedy)
