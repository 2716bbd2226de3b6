"""Virtual remote control: channels by name, ranges before anything is sent."""

from __future__ import annotations

import pytest

from m100link.errors import BadValue, UsageError
from m100link.protocol import PROFILES
from m100link.protocol.commands.virtual_rc import Sync, VirtualRcData, VirtualRcSettings

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


# -- pulses, in the form of the earlier and of the later libraries of DJI --------------------------


def test_later_libraries_send_a_tag_behind_the_frequency() -> None:
    command = Sync.parse(b"\x32\0\0\0\x34\x12", FIRMWARE)
    assert command == Sync(50, tag=0x1234)
    assert command.value(FIRMWARE) == b"\x32\0\0\0\x34\x12"
    assert command.raw() == Sync(50).raw() == {"frequency": 50}
    assert command.fields() == {"frequency_hz": 50}


@pytest.mark.parametrize("size", [0, 3, 5, 7])
def test_another_size_is_not_read(size: int) -> None:
    with pytest.raises(ValueError, match="sync takes 4"):
        Sync.parse(bytes(size), FIRMWARE)


@pytest.mark.parametrize("frequency", [-1, 1 << 32])
def test_a_frequency_that_does_not_fit_is_refused(frequency: int) -> None:
    with pytest.raises(BadValue, match="frequency"):
        Sync(frequency).encode(FIRMWARE)
