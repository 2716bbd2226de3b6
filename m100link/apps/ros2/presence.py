"""Who is in the graph: which nodes could have asked for something, and whether they still are."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from m100link.apps.bus.network import DEPTH, Inbox, TokenChange
from m100link.apps.ros2.graph import End, Seen, read_token

__all__ = ["Presence"]

_MOST = 4 * DEPTH
"""Tokens that are known: a graph of hundreds of nodes has fewer."""


class Presence:
    """The ends of others.

    Args:
        watch: Begins to see tokens come and go, those first that are there.
    """

    def __init__(self, watch: Callable[[], Inbox[TokenChange]]) -> None:
        self._watch = watch
        self._inbox = watch()
        self._seen: dict[str, Seen] = {}

    def look(self) -> None:
        """Take what has changed. Of a flood some is lost: then all of them count as gone."""
        changes = self._inbox.take()
        if len(changes) >= DEPTH:
            self._seen.clear()
            self._inbox = self._watch()
            return
        for change in changes:
            if not change.is_there:
                self._seen.pop(change.key, None)
                continue
            seen = read_token(change.key)
            if seen is not None and len(self._seen) < _MOST:
                self._seen.setdefault(change.key, seen)

    def clients(self, service: str) -> Mapping[str, Seen]:
        """Those who can call a service, by their tokens."""
        return {
            key: one
            for key, one in self._seen.items()
            if one.end is End.CLIENT and one.topic == service
        }

    def has_namesake(self, name: str, session: str) -> bool:
        """Whether a node of another session is called so, too: calls reach both."""
        return any(
            one.end is End.NODE and one.node_name == name and one.node[0] != session
            for one in self._seen.values()
        )

    def missing(self, clients: Mapping[str, Seen]) -> bool:
        """Whether any of them is gone, or was: who is back within a step is another one."""
        return any(self._seen.get(key) is not one for key, one in clients.items())
