"""Setpoints on their way to an agent, stamped by its clock."""

from __future__ import annotations

import asyncio
import math

from m100link.apps.agent.messages import Steer
from m100link.apps.bus.network import Bus
from m100link.apps.fleet.clock import AgentClock
from m100link.apps.fleet.keys import Keys
from m100link.apps.fleet.payloads import pack_steer
from m100link.errors import UsageError
from m100link.protocol.setpoint import Setpoint

__all__ = ["MOST_CLOCK_BOUND_S", "SetpointSender"]

MOST_CLOCK_BOUND_S = 0.1
"""Seconds by which the agent's clock may be wrong; setpoints older than 0.2 s are not flown."""

_PAUSE_S = 0.5
"""Seconds after which whoever sends again has decided so anew."""


class SetpointSender:
    """Sends to one aircraft until it is closed.

    Args:
        bus: The network.
        keys: Of the aircraft.
        clock: Its agent's, as far as is known.
    """

    def __init__(self, bus: Bus, keys: Keys, clock: AgentClock) -> None:
        self._keys, self._agent_clock = keys, clock
        self._clock = asyncio.get_running_loop().time
        self._outlet = bus.publish(keys.setpoint)
        self._sent_at = -math.inf

    def close(self) -> None:
        """Send no more."""
        self._outlet.close()

    def send(
        self,
        fence: int,
        token: str,
        setpoint: Setpoint,
        lifetime: float,
        *,
        made_at: float | None = None,
        begins: bool | None = None,
    ) -> None:
        """Send one; never waits.

        Args:
            fence: Number of the lease.
            token: Proof of it.
            setpoint: What to fly.
            lifetime: Seconds that it lasts at the agent.
            made_at: When it was decided, on this event loop's clock, s; now by default.
            begins: Whether a stream begins with it; by default when none was sent for half a
                second.

        Raises:
            UsageError: The agent's clock is not known well enough to say how old a setpoint is.
        """
        bound, now = self._agent_clock.bound_s, self._clock()
        if bound is None or bound > MOST_CLOCK_BOUND_S:
            raise UsageError(
                f"the clock of {self._keys.name} is not known to {MOST_CLOCK_BOUND_S:g} s",
                cause="the way there and back takes too long for setpoints",
                remedy="fly by tasks and fly_to(), whose loops are closed on board",
            )
        if begins is None:
            begins = now - self._sent_at > _PAUSE_S
        self._sent_at = now
        stamp = self._agent_clock.its(now if made_at is None else made_at)
        steer = Steer(fence, stamp, lifetime, setpoint)
        self._outlet.put(pack_steer(steer, token, begins=begins))
