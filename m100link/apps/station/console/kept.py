"""Control of aircraft that an operator keeps while the page shows another one.

A page shows and steers one aircraft: whoever turns to another gets another page. The leases go
along, so that what hovers or flies a mission stays in the same hand.
"""

from __future__ import annotations

from m100link.apps.agent.client import AgentClient
from m100link.apps.agent.lease import Lease

__all__ = ["KeptLeases"]

RENEWAL = 0.5
"""Seconds between two renewals: a lease lasts 3 s."""


class KeptLeases:
    """Leases by the name of their aircraft."""

    def __init__(self) -> None:
        self._leases: dict[str, tuple[AgentClient, Lease]] = {}
        self._renewed_at = float("-inf")

    def __contains__(self, name: str) -> bool:
        """Whether that aircraft's lease is kept and in force."""
        agent, lease = self._leases.get(name, (None, None))
        return agent is not None and agent.holds(lease)

    def __len__(self) -> int:
        """How many are kept and in force."""
        return sum(name in self for name in self._leases)

    def add(self, name: str, agent: AgentClient, lease: Lease) -> None:
        """Keep one."""
        self._leases[name] = agent, lease

    def take(self, name: str) -> Lease | None:
        """The lease of an aircraft that is turned to; it is kept here no more."""
        is_there = name in self
        _, lease = self._leases.pop(name, (None, None))
        return lease if is_there else None

    def renew(self, now: float) -> None:
        """Let all of them last another lifetime; called as often as the operator is heard."""
        if now - self._renewed_at < RENEWAL:
            return
        self._renewed_at = now
        for name, (agent, lease) in list(self._leases.items()):
            if name in self:
                agent.keep(lease)
            else:
                del self._leases[name]

    def let_go(self) -> None:
        """Give all of them back: those aircraft hover, and authority goes back."""
        leases, self._leases = self._leases, {}
        for agent, lease in leases.values():
            if agent.holds(lease):
                agent.let_go(lease)
