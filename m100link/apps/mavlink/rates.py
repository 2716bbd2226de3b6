"""Who is sent which message of telemetry, and how often: each peer what it asked for.

Rates belong to whoever asked. Peers behind one address share a way: each message goes there as
often as the one of them wants that wants it most. What many want at once is made once.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from m100link.apps.mavlink.codec import Message
from m100link.apps.mavlink.peers import MOST_PEERS, Address, Peer
from m100link.apps.mavlink.telemetry import STREAMS
from m100link.apps.mavlink.world import World

__all__ = ["MOST_HZ", "Rates"]

MOST_HZ = 50.0
"""How often a message is sent at most; who asks for more gets this."""

_MOST_ASKED = 2 * MOST_PEERS
"""Peers whose rates are known, those included that are silent and may come back."""

_ALL = 0
"""The group of REQUEST_DATA_STREAM that has all others."""

_USUAL = {name: stream.hz for name, stream in STREAMS.items()}

Audience = Mapping[Address, tuple[Peer, ...]]
"""Where telemetry goes, and which peers are there; none are where nobody was heard yet."""


class Rates:
    """How often each is sent to whom.

    Args:
        world: The aircraft.

    Attributes:
        is_often: Whether anything is sent more often than usual telemetry ever is.
    """

    def __init__(self, world: World) -> None:
        self._world = world
        self._asked: dict[Peer, dict[str, float]] = {}
        # What follows for each address: made anew, once a step, when rates or addresses changed.
        self._audience: Audience | None = None
        self._present: set[Peer] = set()
        self._tables: dict[Address, dict[str, float]] = {}
        self.is_often = False
        self._due: dict[Address, dict[str, float]] = {}

    def hz(self, name: str, peer: Peer) -> float:
        """How often a peer is sent a message."""
        return self._asked.get(peer, {}).get(name, _USUAL[name])

    def set_hz(self, name: str, hz: float | None, peer: Peer) -> None:
        """Send it to a peer so often; None as often as to everybody."""
        asked = self._asked.pop(peer, {})
        asked.pop(name, None)
        if hz is not None:
            asked[name] = min(MOST_HZ, max(0.0, hz))
        self._asked[peer] = asked  # the newest is the last that is forgotten
        if len(self._asked) > _MOST_ASKED:
            del self._asked[next(one for one in self._asked if one not in self._present)]
        self._due.get(peer.address, {}).pop(name, None)  # at once, then at its rate
        self._audience = None

    def set_group(self, group: int, hz: float, peer: Peer) -> None:
        """Send the messages of a group of REQUEST_DATA_STREAM so often."""
        for name, stream in STREAMS.items():
            if group in (_ALL, stream.group):
                self.set_hz(name, hz, peer)

    def _arrange(self, audience: Audience, now: float) -> None:
        self._audience = audience
        self._present = {peer for peers in audience.values() for peer in peers}
        self._tables = {
            address: {
                name: max((self.hz(name, peer) for peer in peers), default=usual)
                for name, usual in _USUAL.items()
            }
            for address, peers in audience.items()
        }
        fastest = max((hz for table in self._tables.values() for hz in table.values()), default=0.0)
        self.is_often = fastest > max(_USUAL.values())
        # Nobody waits for the end of an interval that somebody wanted who has gone.
        self._due = {
            address: {
                name: min(at, now + 1 / table[name])
                for name, at in self._due.get(address, {}).items()
                if table[name] > 0.0
            }
            for address, table in self._tables.items()
        }

    def message(self, name: str, now: float) -> Message | None:
        """One of them as it is now."""
        fields = STREAMS[name].fields(self._world, now)
        return None if fields is None else Message(name, fields)

    def due(self, now: float, audience: Audience) -> Iterator[tuple[Message, tuple[Address, ...]]]:
        """Those whose time has come, and where they go."""
        if audience != self._audience:
            self._arrange(audience, now)
        wanted: dict[str, list[Address]] = {}
        for address, table in self._tables.items():
            due = self._due[address]
            for name, hz in table.items():
                if hz <= 0.0 or now < due.get(name, now):
                    continue
                # From when it was due, so that the rate holds; not from long ago.
                due[name] = max(due.get(name, now) + 1 / hz, now)
                wanted.setdefault(name, []).append(address)
        for name, addresses in wanted.items():
            message = self.message(name, now)
            if message is not None:
                yield message, tuple(addresses)
