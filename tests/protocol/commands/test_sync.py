"""Pulses, in the form of the earlier and of the later libraries of DJI."""

from __future__ import annotations

import pytest

from m100link.errors import BadValue
from m100link.protocol import PROFILES
from m100link.protocol.commands.sync import Sync

FIRMWARE = PROFILES["3.1"]


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
