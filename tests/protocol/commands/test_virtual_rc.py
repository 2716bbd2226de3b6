"""Virtual remote control: channels by name, ranges before anything is sent."""

from __future__ import annotations

import pytest

from m100link.errors import UsageError
from m100link.protocol import PROFILES
from m100link.protocol.commands.virtual_rc import VirtualRcData, VirtualRcSettings

FIRMWARE = PROFILES["3.1"]


def test_uninitialised_bits_of_djis_programs_mean_nothing() -> None:
    assert VirtualRcSettings.parse(b"\x72", FIRMWARE) == VirtualRcSettings(
        is_on=False, falls_back=True
    )
    assert VirtualRcSettings.parse(b"\xfd", FIRMWARE) == VirtualRcSettings(
        is_on=True, falls_back=False
    )
    assert VirtualRcSettings.parse(b"\x72", FIRMWARE).fields() == {
        "is_on": False,
        "falls_back": True,
    }


def test_channels_have_the_names_of_the_document() -> None:
    fields = VirtualRcData((1684, 364, 1024, 1000, 1324, 1024, 1552, *[1024] * 9)).fields()
    assert (fields["roll"], fields["pitch"], fields["mode"]) == (1684, 364, 1552)
    assert len(fields["channels"]) == 16


@pytest.mark.parametrize("channels", [(1024,) * 15, (1024,) * 15 + (1685,), (363,) + (1024,) * 15])
def test_channels_that_no_remote_has_are_refused(channels: tuple[int, ...]) -> None:
    with pytest.raises(UsageError, match="cannot be sent"):
        VirtualRcData(channels).encode(FIRMWARE)
