"""What every mission is for the program that flies it: a block, events, orders."""

from __future__ import annotations

from abc import ABC, abstractmethod
from types import TracebackType
from typing import ClassVar, Self

from m100link.errors import UsageError
from m100link.flight.missions.context import Deck
from m100link.flight.missions.events import MissionEvent, RunState
from m100link.flight.missions.keeper import MissionKeeper
from m100link.flight.missions.run import MissionRun
from m100link.protocol.command import Command

__all__ = ["MissionFlight"]


class MissionFlight(ABC):
    """A mission for the time of a block; ``async for event in mission`` tells of it until its end.

    Leaving the block stops it if it still flies; then the aircraft hovers. **It flies on when this
    program is killed, loses its power or its cable**: it lives in the aircraft, and only the pilot,
    its own end or a stop ends it.
    """

    _FIRST: ClassVar[type[Command]]  # sent to begin it: firmware without it knows no such mission

    def __init__(self, deck: Deck, keeper: MissionKeeper, run: MissionRun) -> None:
        self._deck = deck
        self._keeper = keeper
        self._run = run

    @abstractmethod
    async def _begin(self) -> None:
        """Check, upload, start."""

    async def __aenter__(self) -> Self:
        run = self._run
        with self._deck.block.waiting(run.name):
            try:
                self._deck.commander.requests.require_support(self._FIRST)
                self._deck.block.require_flying(f"a {run.name}")
                if run.state is not RunState.READY:
                    raise UsageError("this mission was entered before; ask for a new one")
                self._keeper.claim(run)
                await self._begin()
            except BaseException as error:
                await run.leave(error)
                self._keeper.give_back(run)
                raise
        return self

    async def __aexit__(
        self,
        exc_type: type[BaseException] | None,
        exc: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        await self._run.leave(exc)

    def __aiter__(self) -> Self:
        return self

    async def __anext__(self) -> MissionEvent:
        return await self._run.next_event()

    @property
    def is_over(self) -> bool:
        """Whether it does not fly any more, or the program let go of it."""
        return self._run.state in (RunState.OVER, RunState.DETACHED)

    @property
    def is_paused(self) -> bool:
        """Whether it hovers by order of the program."""
        return self._run.state is RunState.PAUSED

    async def pause(self) -> None:
        """Hover in place until :meth:`resume`; setpoints are ignored all the same.

        Raises:
            MissionRefused: With the aircraft's reason.
            MissionAborted: It was broken off meanwhile.
            AckTimeout: Nobody knows whether it hovers.
            UsageError: It is over.
        """
        await self._run.pause()

    async def resume(self) -> None:
        """Go on where it was paused. Raises as :meth:`pause`."""
        await self._run.resume()

    async def stop(self) -> None:
        """Stop it for good: the aircraft hovers and forgets the mission.

        Raises:
            AckTimeout, MissionRefused: It may be flying on; leaving the block tries again.
        """
        await self._run.stop()

    def detach(self) -> None:
        """Let it fly on by itself when this block, and this program, end.

        Nothing here watches it any more: no guard, no stop path. Authority is **not** given back
        when the control block ends, because that would break the mission off. It flies on after a
        ``kill -9`` as well. Whoever connects later finds it as :attr:`m100link.Aircraft.mission`,
        and ends it by :meth:`m100link.Control.stop_mission`. A warning is logged.

        Raises:
            UsageError: It does not fly.
        """
        self._run.detach()
