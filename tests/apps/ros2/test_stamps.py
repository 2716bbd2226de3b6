"""Times of packages: by the clock of the aircraft, asked now and then."""

from __future__ import annotations

from random import Random

import pytest

from m100link.apps.ros2.publishers import Stamps
from m100link.protocol import encode_telemetry
from m100link.protocol.firmware import PROFILES, FirmwareProfile
from m100link.telemetry.sample import Sample

UTC = 1_800_000_000.0
PROFILE = PROFILES["1.0"]
HZ = PROFILE.tick_hz


def value(ticks: int, profile: FirmwareProfile) -> bytes:
    fields = (ticks, *[0] * (len(profile.items["time"].fields) - 1))
    return encode_telemetry({"time": fields}, profile)


class Line:
    """Packages that come with a delay that jumps about, and the clock of who listens."""

    def __init__(self) -> None:
        self.now = 100.0
        self.stamps = Stamps(lambda: self.now, lambda: UTC + self.now)

    def package(self, made_at: float, delay: float, *, reboots: float = 0.0) -> float:
        """A package comes; returns its stamp as a time of the listener's clock, s."""
        self.now = made_at + delay
        ticks = round((made_at - reboots) * HZ)
        sample = Sample(value(ticks, PROFILE), PROFILE, self.now)
        self.stamps.hear(sample)
        seconds, nanoseconds = self.stamps.of(sample)
        return seconds - UTC + nanoseconds * 1e-9

    def flight(self, count: int, chance: Random) -> None:
        for number in range(count):
            self.package(101.0 + number / 50, 0.004 + 0.01 * chance.random())


@pytest.fixture
def line() -> Line:
    made = Line()
    made.flight(500, Random(11))
    return made


def test_the_clock_says_when_it_was_made_whatever_the_delay(line: Line) -> None:
    chance = Random(3)
    for number in range(200):
        made_at = 111.0 + number / 50
        stamp = line.package(made_at, 0.004 + 0.08 * chance.random() ** 3)
        assert stamp == pytest.approx(made_at + 0.004, abs=0.002)


def test_it_is_never_later_than_it_came(line: Line) -> None:
    assert line.package(111.0, 0.0) <= 111.0


def test_before_the_clock_is_known_it_is_when_it_came() -> None:
    assert Line().package(101.0, 0.05) == pytest.approx(101.05, abs=1e-6)


def test_a_clock_that_begins_anew_is_asked_at_once(line: Line) -> None:
    line.package(111.0, 0.004)
    assert line.package(111.02, 0.03, reboots=111.0) == pytest.approx(111.05, abs=1e-6)


def test_ticks_far_ahead_are_asked_about(line: Line) -> None:
    line.package(111.0, 0.004)
    assert line.package(140.0, 0.2) == pytest.approx(140.004, abs=0.01)


def test_another_firmware_has_another_clock(line: Line) -> None:
    other = PROFILES["3.1"]
    assert other.tick_hz != HZ
    line.now = 120.0
    sample = Sample(value(7, other), other, 120.0)
    line.stamps.hear(sample)
    assert line.stamps.of(sample) == (round(UTC) + 120, 0)
    assert line.stamps.clock is not None
    assert line.stamps.clock.tick_hz == other.tick_hz
