"""One package and its time of arrival."""

from __future__ import annotations

import pytest

from m100link.errors import LayoutMismatch
from m100link.protocol import Attitude, Battery, encode_telemetry, profile
from m100link.telemetry.sample import Sample

FIRMWARE = profile("3.1")


def test_an_item_is_read_by_its_class_or_asked_for_by_its_name() -> None:
    sample = Sample(encode_telemetry({"battery": (73,)}, FIRMWARE), FIRMWARE, 12.5)
    assert sample.received_at == 12.5
    assert sample[Battery] == sample.battery == Battery(73)
    assert sample.attitude is None
    with pytest.raises(KeyError, match="Attitude"):
        sample[Attitude]


def test_a_package_of_another_length_than_its_flags_say_is_not_a_sample() -> None:
    value = encode_telemetry({"battery": (73,)}, FIRMWARE)
    for wrong in (value[:-1], value + b"\0", b""):
        with pytest.raises(LayoutMismatch):
            Sample(wrong, FIRMWARE, 0.0)
