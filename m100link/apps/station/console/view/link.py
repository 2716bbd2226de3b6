"""The link in numbers: both ways, what was damaged and why, what arrives how often."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from m100link.apps.station.console.view.inputs import Inputs
from m100link.apps.station.console.view.words import Text, say
from m100link.protocol.items import ITEMS
from m100link.wire.frame import Discard

__all__ = ["LINK_ITEMS", "ItemRate", "LinkView", "link_of"]

_COUNTERS = (
    *("frames_received", "frames_sent", "bytes_received", "bytes_sent", "discarded_bytes"),
    *("acks", "repeats", "expired", "duplicate_acks", "late_acks", "foreign_acks"),
    "dropped_writes",
)

LINK_ITEMS = (
    *("connection", "firmware", "clients", "aircraft_ms", "page_ms", "agent_lag", "front_lag"),
    *("discards", "mismatches"),
    *_COUNTERS,
)
"""Names of the numbers, in the order of the page; ``link.<name>`` is what each is called."""


@dataclass(frozen=True, slots=True)
class ItemRate:
    """How a telemetry item arrives.

    Attributes:
        name: Of the item.
        rate: Arrivals per second lately.
        jitter: Mean deviation of their intervals, ms.
        longest_gap: Longest interval so far, s.
    """

    name: Text
    rate: str
    jitter: str
    longest_gap: str


@dataclass(frozen=True, slots=True)
class LinkView:
    """How the link does.

    Attributes:
        texts: A text by the name of each of :data:`LINK_ITEMS`; a dash for what nobody knows.
        causes: Causes of damaged frames, each with how many, the most first.
        rates: How each telemetry item arrives that ever did.
        dropped: Each client of the station with what it did not get, the most first.
        reason: Why there is no connection; empty when there is.
    """

    texts: dict[str, Text]
    causes: tuple[tuple[Text, str], ...]
    rates: tuple[ItemRate, ...]
    dropped: tuple[tuple[str, str], ...]
    reason: str


def link_of(inputs: Inputs) -> LinkView:
    """The numbers as they are now."""
    state, holder, counted = inputs.state, inputs.holder, inputs.link
    texts = dict.fromkeys(LINK_ITEMS, say("link.nothing"))
    texts["connection"] = Text(f"link.{'silent' if inputs.is_silent else state.connection}")
    texts["clients"] = (
        say("link.holder", name=holder.name, seconds=round(state.lease_remaining))
        if holder.number
        else say("link.free")
    )
    texts["front_lag"] = _ms(inputs.front_lag)
    if inputs.page_trip is not None:
        texts["page_ms"] = _ms(inputs.page_trip)
    if inputs.telemetry is not None:
        trip = state.round_trip
        texts |= {
            "firmware": _value(state.firmware),
            "aircraft_ms": say("link.no_answer") if trip is None else _ms(trip),
            "discards": _value(state.discards),
            "mismatches": _value(state.mismatches),
        }
    causes: dict[str, Any] = {}
    if counted is not None:
        texts["agent_lag"] = _ms(counted.loop_lag)
        texts |= {name: _value(counted.counters.get(name, "–")) for name in _COUNTERS}
        causes = dict(sorted(counted.discards.items(), key=lambda one: -one[1]))
    fault = state.connection_fault
    return LinkView(
        texts,
        tuple((_cause(cause), str(count)) for cause, count in causes.items()),
        _rates(inputs),
        tuple((name, str(count)) for name, count in sorted(inputs.dropped, key=_most_first)),
        str(fault.error()) if fault is not None else "",
    )


def _most_first(client: tuple[str, int]) -> tuple[int, str]:
    return -client[1], client[0]


def _ms(seconds: float) -> Text:
    return say("unit.ms", ms=round(1000.0 * seconds))


def _value(value: object) -> Text:
    return say("link.value", value=str(value))


def _cause(name: str) -> Text:
    return Text(f"link.cause.{name}") if name in set(Discard) else _value(name)


def _rates(inputs: Inputs) -> tuple[ItemRate, ...]:
    if inputs.telemetry is None:
        return ()
    told = [inputs.telemetry.statistics(item.record) for item in ITEMS]
    return tuple(
        ItemRate(
            Text(f"plots.item.{one.name}"),
            "–" if one.rate_hz is None else f"{one.rate_hz:.1f}",
            "–" if one.jitter_s is None else f"{1000.0 * one.jitter_s:.1f}",
            f"{one.longest_gap_s:.2f}",
        )
        for one in told
        if one.count
    )
