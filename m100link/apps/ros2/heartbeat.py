"""Whether programs of others still run: a frozen one keeps its tokens for as long as its lease.

That is 10 s by zenoh's default and 60 s by rmw_zenoh's. Both have an answer at their admin space
though (rmw_zenoh's sessions by default), given by threads of zenoh's however busy the program is.
Who has answered once and does so no more is gone; of who never does, the lease tells.
"""

from __future__ import annotations

import math
import re
from collections.abc import Collection
from dataclasses import dataclass, field

from m100link.apps.bus.network import Inbox, PolledBus

__all__ = ["ASK_S", "SILENCE_S", "Heartbeat"]

ASK_S = 0.5
"""Seconds between two questions."""

SILENCE_S = 1.5
"""Seconds without an answer after which a session that had answered counts as gone."""

_ANSWER_S = 2.0
"""Seconds for which an answer of a session is waited for."""

_WAITING = 3
"""Questions whose answers are still looked for, beside the newest."""

_SESSION = re.compile(r"[0-9a-f]{1,32}")
_MOST = 16
"""Sessions that are asked."""


@dataclass(slots=True)
class _Session:
    """A session that is asked.

    Attributes:
        answered_at: When it answered last, s; infinitely long ago before it did.
        asked: Where its answers come.
    """

    answered_at: float = -math.inf
    asked: list[Inbox[bool]] = field(default_factory=list)


class Heartbeat:
    """Asks those sessions that something depends on.

    Args:
        bus: Where they are.
    """

    def __init__(self, bus: PolledBus) -> None:
        self._bus = bus
        self._sessions: dict[str, _Session] = {}
        self._asks_at = -math.inf

    def follow(self, sessions: Collection[str]) -> None:
        """Ask these from now on, and no others. What is no session's id is not asked."""
        known = [one for one in sorted(set(sessions)) if _SESSION.fullmatch(one)][:_MOST]
        self._sessions = {one: _Session() for one in known}
        self._asks_at = -math.inf

    def is_missing(self, now: float) -> bool:
        """Whether any of them has answered and does so no more. To be called at each step.

        Args:
            now: s.
        """
        for one in self._sessions.values():
            for inbox in one.asked:
                if any(inbox.take()):
                    one.answered_at = now
        if now >= self._asks_at:
            self._asks_at = now + ASK_S
            for name, one in self._sessions.items():
                asked = self._bus.probe(f"@/{name}/*", timeout=_ANSWER_S)  # its admin space
                one.asked = [*one.asked[-_WAITING:], asked]
        return any(-math.inf < one.answered_at < now - SILENCE_S for one in self._sessions.values())
