"""Rows for the eye: few, and none of the items that come rarely is missing."""

from __future__ import annotations

from pathlib import Path

import pytest

from m100link.log import read
from m100link.log.channels import RateLimiter, row_of
from m100link.protocol.firmware import FIRMWARE_1_0, FIRMWARE_3_1
from m100link.protocol.records import Battery
from tests.log.flight import flown

pytestmark = pytest.mark.anyio


async def test_what_comes_once_a_second_is_in_a_row_of_ten_a_second(tmp_path: Path) -> None:
    await flown(tmp_path / "flight.mcap")
    flight = read(tmp_path / "flight.mcap")
    samples = list(flight.samples())
    thinning = RateLimiter(0.1)
    rows = [
        told.row
        for one in samples
        if (told := thinning.hear(one.value, one.profile, one.received_at)) is not None
    ]
    seconds = samples[-1].received_at - samples[0].received_at
    assert 9.5 * seconds < len(rows) < 10.5 * seconds
    charges = [b.percent for one in samples if (b := one.get(Battery)) is not None]
    assert [row["battery.percent"] for row in rows if "battery.percent" in row] == charges
    # And the log has them, too.
    logged = [message.content() for message in flight.messages("/m100/telemetry")]
    assert [row["battery.percent"] for row in logged if "battery.percent" in row] == charges
    assert sum("flight_status.status" in row for row in logged) > 5 * seconds


async def test_a_row_ends_with_the_items_of_its_own_package(tmp_path: Path) -> None:
    await flown(tmp_path / "flight.mcap")
    samples = list(read(tmp_path / "flight.mcap").samples())
    thinning = RateLimiter(0.1)
    for one in samples:
        told = thinning.hear(one.value, one.profile, one.received_at)
        if told is not None:
            sample, row = told.packages[-1], told.row
            assert row["received_at"] == sample.received_at
            assert row_of(sample).items() <= row.items()


async def test_every_package_is_let_through_when_asked(tmp_path: Path) -> None:
    await flown(tmp_path / "flight.mcap")
    thinning = RateLimiter(0.0)
    samples = list(read(tmp_path / "flight.mcap").samples())
    assert all(thinning.hear(one.value, one.profile, one.received_at) for one in samples)


def test_what_does_not_fit_is_passed_over() -> None:
    thinning = RateLimiter(0.1)
    for value in (b"", b"\x01", b"\x01\x00", b"\xff\xff" + bytes(20)):
        assert thinning.hear(value, FIRMWARE_3_1, 0.0) is None
    assert thinning.hear(b"\x01\x00" + bytes(4), FIRMWARE_1_0, 0.0) is not None


def test_a_row_comes_as_often_as_its_interval_and_not_more_often() -> None:
    """Packages at 50 Hz whose clock is a hair early: each fifth of them is a row at 10 Hz."""
    thinning, value = RateLimiter(0.1), b"\x01\x00" + bytes(4)
    rows = [
        number
        for number in range(26)
        if thinning.hear(value, FIRMWARE_1_0, 100.0 + number * 0.019_999) is not None
    ]
    assert rows == [0, 5, 10, 15, 20, 25]
    early = RateLimiter(0.1)  # a twentieth too early is no hair
    often = [early.hear(value, FIRMWARE_1_0, 100.0 + n * 0.095) is not None for n in range(4)]
    assert often == [True, False, True, False]
    told = RateLimiter(1.0).hear(value, FIRMWARE_1_0, 123.25)
    assert told is not None
    assert told[1]["received_at"] == 123.25
