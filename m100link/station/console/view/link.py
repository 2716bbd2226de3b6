"""The link in numbers."""

from __future__ import annotations

from dataclasses import dataclass

from m100link.station.console.view.inputs import Inputs

__all__ = ["LINK_ITEMS", "LinkView", "link_of"]

LINK_ITEMS = (
    ("connection", "Connection"),
    ("firmware", "Firmware"),
    ("aircraft_ms", "Aircraft and back"),
    ("discards", "Damaged frames"),
    ("late", "Late and foreign acks"),
    ("dropped", "Frames not written"),
    ("mismatches", "Packages refused"),
    ("clients", "Lease"),
)
"""Name and label of each number, in the order of the page."""


@dataclass(frozen=True, slots=True)
class LinkView:
    """How the link does.

    Attributes:
        texts: A text by the name of each of :data:`LINK_ITEMS`.
        reason: Why there is no connection; empty when there is.
    """

    texts: dict[str, str]
    reason: str


def link_of(inputs: Inputs) -> LinkView:
    """The numbers as they are now; a dash for what nobody knows."""
    state, holder, trip = inputs.state, inputs.holder, inputs.state.round_trip
    texts = {name: "–" for name, _ in LINK_ITEMS}
    texts["connection"] = "silent" if inputs.is_silent else state.connection
    texts["clients"] = f"{holder.name}, {state.lease_remaining:.0f} s" if holder.number else "free"
    if inputs.telemetry is not None:
        texts |= {
            "firmware": state.firmware,
            "aircraft_ms": "no answer" if trip is None else f"{1000 * trip:.0f} ms",
            "discards": str(state.discards),
            "late": str(state.late_acks),
            "dropped": str(state.dropped_writes),
            "mismatches": str(state.mismatches),
        }
    fault = state.connection_fault
    return LinkView(texts, str(fault.error()) if fault is not None else "")
