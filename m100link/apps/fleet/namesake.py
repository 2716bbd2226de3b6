"""Whether another agent has the name of this one (pure logic, ``now`` is an argument).

Each looks before it begins, but two behind routers that were joined later have both begun. What is
told of one aircraft is then told of two, and one order reaches both.
"""

from __future__ import annotations

from m100link.errors import UsageError

__all__ = ["GONE_S", "Namesakes"]

GONE_S = 5.0
"""Seconds without a word of the other one after which it is taken for gone."""

_SURE_S = 0.5
"""Seconds from its first word to its last that show that it lives: each tells once a second, and
one word alone may be the last of an agent that was killed."""
_MOST = 16


class Namesakes:
    """What one agent hears under its own name.

    Args:
        name: Of the aircraft.
        boot: Which run of the agent this is.
    """

    def __init__(self, name: str, boot: str) -> None:
        self._name, self._boot = name, boot
        # When each other run was heard first and last.
        self._heard: dict[str, tuple[float, float]] = {}

    def hear(self, boot: str, now: float) -> None:
        """Something was told under this name.

        Args:
            boot: By which run of an agent.
            now: s.
        """
        if boot == self._boot:
            return
        self._heard = {one: at for one, at in self._heard.items() if now - at[1] <= GONE_S}
        if boot in self._heard or len(self._heard) < _MOST:
            first, _ = self._heard.get(boot, (now, now))
            self._heard[boot] = first, now

    def is_there(self, now: float) -> bool:
        """Whether there is another one."""
        return any(
            last - first >= _SURE_S and now - last <= GONE_S for first, last in self._heard.values()
        )

    def require_none(self, now: float) -> None:
        """Whether what is asked of this name is asked of one aircraft.

        Raises:
            UsageError: It is not.
        """
        if self.is_there(now):
            raise UsageError(
                f"two agents are named {self._name}: neither moves its aircraft",
                cause="they began behind different routers, which were joined later",
                remedy="end one of them, and give its aircraft another --name; stop and land are "
                "done by both",
            )
