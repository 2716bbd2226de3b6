"""The peers at the other end of datagrams: known by a heartbeat, few, and forgotten soon."""

from __future__ import annotations

from dataclasses import dataclass

Address = tuple[str, int]  # host and port

LOST_AFTER = 3.0  # seconds without a heartbeat after which a ground station counts as lost
FORGOTTEN_AFTER = 10.0  # seconds after which nothing is sent to it any more
MOST_PEERS = 16  # ground stations and programs at once: each costs the telemetry of every aircraft


@dataclass(frozen=True, slots=True)
class Peer:
    address: Address  # where its datagrams come from
    system: int
    component: int

    @property
    def name(self) -> str:
        return f"MAVLink {self.system} at {self.address[0]}:{self.address[1]}"

    @property
    def target(self) -> dict[str, int]:
        """The fields of a message that is for it alone."""
        return {"target_system": self.system, "target_component": self.component}


class Peers:
    """Those that have been heard, by address and system id."""

    def __init__(self, always: tuple[Address, ...] = ()) -> None:
        self._always = always
        self._heard: dict[Peer, float] = {}
        # Those whose heartbeat nobody else can have sent, and when.
        self._trusted: dict[Peer, float] = {}
        self.refused = 0

    def heartbeat(self, peer: Peer, now: float, *, is_trusted: bool = True) -> None:
        """It is there, and one of the peers unless these are too many.

        ``now``: s. One that is trusted keeps a flight going: with a key only what is signed by it.
        """
        if peer not in self._heard and len(self._heard) >= MOST_PEERS:
            self.forget(now)
            if len(self._heard) >= MOST_PEERS and not (is_trusted and self._make_room()):
                self.refused += 1
                return
        self._heard[peer] = now
        if is_trusted:
            self._trusted[peer] = now

    def _make_room(self) -> bool:
        """An untrusted peer makes room for a trusted one: a heartbeat needs no key."""
        found = next((one for one in self._heard if one not in self._trusted), None)
        if found is not None:
            del self._heard[found]
        return found is not None

    def knows(self, peer: Peer, now: float) -> bool:
        """Whether it has been heard lately: others are not obeyed, and not answered."""
        return now - self._heard.get(peer, -FORGOTTEN_AFTER) < FORGOTTEN_AFTER

    def is_lost(self, peer: Peer, now: float) -> bool:
        """Whether its heartbeat fails to come."""
        return now - self._trusted.get(peer, -LOST_AFTER) >= LOST_AFTER

    def is_known(self, address: Address) -> bool:
        """Whether somebody there has been heard, and was not forgotten."""
        return any(one.address == address for one in self._heard)

    def forget(self, now: float) -> None:
        for peer, at in tuple(self._heard.items()):
            if now - at >= FORGOTTEN_AFTER:
                del self._heard[peer]
                self._trusted.pop(peer, None)

    def audience(self, now: float) -> dict[Address, tuple[Peer, ...]]:
        """Where telemetry goes, with the peers that are there."""
        self.forget(now)
        found: dict[Address, tuple[Peer, ...]] = dict.fromkeys(self._always, ())
        for peer in self._heard:
            found[peer.address] = (*found.get(peer.address, ()), peer)
        return found
