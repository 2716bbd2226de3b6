"""Telemetry of a fleet as a pilot sees it: the newest values of each aircraft."""

from __future__ import annotations

import asyncio
from collections import Counter
from collections.abc import Callable

from m100link.apps.agent.fault import MessageError
from m100link.apps.agent.messages import Telemetry
from m100link.apps.bus.network import Bus
from m100link.apps.fleet.keys import Keys, name_in
from m100link.apps.fleet.payloads import unpack_message
from m100link.apps.fleet.thinning import WALL_WITHIN_S
from m100link.errors import LayoutMismatch
from m100link.protocol.firmware import PROFILES
from m100link.telemetry.sample import Sample
from m100link.telemetry.state import AircraftState

__all__ = ["FleetTelemetry"]

_DEPTH = 20_000


class FleetTelemetry:
    """Hears aircraft until it is closed.

    Args:
        bus: The network.
        keys: Of one aircraft, or of all.
        full: Every package; else what suffices for each item five times a second.
        on_sample: Called with the name and each package, whose time is that of its arrival here.

    Attributes:
        states: Newest values by name; ages count from their arrival here.
        received: Packages by name.
        unread: Packages that this version cannot read.
    """

    def __init__(
        self,
        bus: Bus,
        keys: Keys,
        *,
        full: bool = False,
        on_sample: Callable[[str, Sample], None] | None = None,
    ) -> None:
        self._clock = asyncio.get_running_loop().time
        self._on_sample = on_sample
        self.states: dict[str, AircraftState] = {}
        self.received: Counter[str] = Counter()
        self.unread = 0
        key = keys.telemetry if full else keys.thinned
        # Whoever looks at one aircraft may fly it; a wall of a thousand is looked at by people.
        within = 0.0 if full else WALL_WITHIN_S
        self._held = bus.subscribe(key, self._heard, depth=_DEPTH, within=within)

    def close(self) -> None:
        """Hear no more: what nobody hears is not sent."""
        self._held.close()

    def _heard(self, key: str, payload: bytes) -> None:
        name = name_in(key)
        try:
            message = unpack_message(payload)
            if not isinstance(message, Telemetry):
                raise MessageError(f"{type(message).__name__} is no telemetry")
            sample = Sample(message.value, PROFILES[message.profile], self._clock())
        except (MessageError, LayoutMismatch, KeyError):
            self.unread += 1
            return
        self.received[name] += 1
        if name not in self.states:
            self.states[name] = AircraftState(self._clock)
        self.states[name].update(sample)
        if self._on_sample is not None:
            self._on_sample(name, sample)
