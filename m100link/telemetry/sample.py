"""One telemetry package with its time of arrival, as subscriptions deliver it."""

from __future__ import annotations

from typing import Any, TypeVar

from m100link.protocol.firmware import FirmwareProfile
from m100link.protocol.packet import TelemetryPacket, mismatch, plan_of

__all__ = ["Sample"]

R = TypeVar("R", bound=tuple[Any, ...])


class Sample(TelemetryPacket):
    """One telemetry package and when it arrived.

    Items are read when asked for: ``sample.attitude`` is None when the package has none,
    ``sample[Attitude]`` raises instead.

    Attributes:
        received_at: Time of arrival on the event loop's clock, s.
    """

    __slots__ = ("received_at",)

    def __init__(self, value: bytes, profile: FirmwareProfile, received_at: float) -> None:
        # What TelemetryPacket does, written out: a call less for what comes a hundred times a
        # second on each line.
        try:
            plan = profile.plans[value[0] | value[1] << 8]
        except LookupError:
            plan = plan_of(value, profile)
        if plan.size != len(value):
            raise mismatch(value, profile)
        self._plan = plan
        self.flags = plan.flags
        self.profile = profile
        self.value = value
        self.received_at = received_at

    def __getitem__(self, record: type[R]) -> R:
        """The record of that class; ``KeyError`` where the package does not carry it."""
        found = self.get(record)
        if found is None:
            raise KeyError(record.__name__)
        return found
