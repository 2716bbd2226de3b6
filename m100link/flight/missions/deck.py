"""What a mission stands on, and what its kind has to know."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

from m100link.errors import M100Error
from m100link.flight.lifecycle import StopCause
from m100link.flight.mission_state import MissionWatch
from m100link.flight.missions.events import MissionEvent, MissionProgress
from m100link.protocol.command import Request
from m100link.protocol.commands.missions import MissionStatus, WaypointEvent

if TYPE_CHECKING:
    from m100link.flight.guards import GuardKeeper
    from m100link.flight.tasks import Commander
    from m100link.telemetry.state import AircraftState

__all__ = ["Block", "Deck", "Over", "Track"]


class Over(NamedTuple):
    """The aircraft says that it does not fly the mission any more."""


class Track(Protocol):
    """What is known of one kind of mission: reads its pushes, and what the aircraft is asked."""

    @property
    def poll(self) -> Request[Any] | None:
        """What is asked when nothing is pushed; None: nothing can be."""
        ...

    @property
    def ends_by_landing(self) -> bool:
        """Whether the aircraft goes home or lands behind :class:`Finished`."""
        ...

    def take(self, push: MissionStatus | WaypointEvent) -> Sequence[MissionEvent | Over]:
        """A push came."""
        ...

    def polled(self, answer: Any) -> Sequence[MissionEvent | Over]:
        """The answer to ``poll`` came."""
        ...

    def progress(self, elapsed: float, state: AircraftState) -> MissionProgress:
        """How far it is."""
        ...


class Block(Protocol):
    """What a mission needs of the control block around it."""

    @property
    def is_open(self) -> bool:
        """Whether the program is in it, and nothing has ended it."""
        ...

    def require_flying(self, what: str) -> None:
        """Raise unless it may send."""
        ...

    def waiting(self, what: str) -> AbstractContextManager[None]:
        """What waits in here ends with it."""
        ...

    def end(self, cause: StopCause, failure: M100Error | None = None) -> None:
        """End it: its stop path begins."""
        ...


@dataclass(frozen=True, slots=True)
class Deck:
    """What a mission stands on.

    Attributes:
        commander: The aircraft.
        guards: Asked before it begins and while it flies.
        block: The control block around it.
    """

    commander: Commander
    guards: GuardKeeper
    block: Block

    @property
    def watch(self) -> MissionWatch:
        """Where pushes arrive."""
        return self.commander.missions
