"""What ground stations want to be flown, and where setpoints come from: values for the deck."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from m100link.apps.mavlink.modes import Mode
from m100link.apps.mavlink.orders import Order
from m100link.apps.mavlink.peers import Peer
from m100link.protocol.setpoint import Setpoint

__all__ = ["Stream", "Wish"]


class Stream(Protocol):
    """Where setpoints of a mode come from."""

    def setpoint(self, now: float) -> Setpoint | None:
        """What to fly now; None when nobody says it any more."""

    def is_fresh(self, now: float) -> bool:
        """Whether somebody says it."""
        ...

    def wants_up(self, now: float) -> bool:
        """Whether it asks to leave the ground."""
        ...


@dataclass(frozen=True, slots=True)
class Wish:
    """What somebody wants to be flown.

    Attributes:
        mode: In which mode.
        order: What the agent is asked for; None where setpoints fly.
        peer: Who wants it; None for the bridge itself.
        is_anew: Whether it is another mission than the one that flies or is paused.
    """

    mode: Mode
    order: Order | None
    peer: Peer | None = None
    is_anew: bool = False
