"""Command set 0x02 beyond telemetry."""

from __future__ import annotations

from m100link.protocol import AuthorityChanged, FromMobile, PushTelemetry, TelemetryPacket, profile
from tests.support import load_vectors


def test_the_notification_of_lost_authority_is_a_fixed_4() -> None:
    assert AuthorityChanged().encode(profile("1.0")) == b"\x02\x01\x04"


def test_the_fields_of_a_telemetry_push_are_those_of_the_golden_vectors() -> None:
    for vector in load_vectors("telemetry"):
        packet = TelemetryPacket(bytes.fromhex(vector["value"]), profile(vector["firmware"]))
        assert PushTelemetry(packet).fields() == {
            "telemetry": vector["items"],
            "flags": vector["flags"],
        }


def test_of_notifications_only_a_loss_means_something_when_it_cannot_be_read() -> None:
    """To believe in authority that is gone is the worse error."""
    assert AuthorityChanged.when_unreadable() == AuthorityChanged()
    assert FromMobile.when_unreadable() is None
    assert PushTelemetry.when_unreadable() is None
