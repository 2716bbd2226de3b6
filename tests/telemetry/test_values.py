"""Tables of telemetry: what goes in and comes out, with sign, unit and frame."""

from __future__ import annotations

import math
import time
from collections.abc import Iterable
from typing import Any

import pytest

from m100link import Table
from m100link.protocol import encode_telemetry, profile
from m100link.telemetry.device_clock import DeviceClock
from m100link.telemetry.integrity import _Clock, _Fix
from m100link.telemetry.sample import AccelerationReader, Sample, fused_of
from m100link.telemetry.state import AircraftState
from m100link.telemetry.subscription import Hub, Lossless, Newest, TelemetryStream
from tests import limits

FIRMWARE = profile("3.1")
G = 9.80665  # standard gravity, m/s² (CGPM 1901)
STANDS, FLIES = 1, 3  # flight status (document 2.2.3.1)

Vector = tuple[float, float, float]


def turned(roll: float, pitch: float, yaw: float) -> tuple[float, float, float, float]:
    """The quaternion of a turn, degrees, by the textbook's order yaw, pitch, roll."""
    x, y, z = (math.radians(one) / 2 for one in (roll, pitch, yaw))
    (cx, cy, cz), (sx, sy, sz) = map(math.cos, (x, y, z)), map(math.sin, (x, y, z))
    return (
        cx * cy * cz + sx * sy * sz,
        sx * cy * cz - cx * sy * sz,
        cx * sy * cz + sx * cy * sz,
        cx * cy * sz - sx * sy * cz,
    )


def to_ground(vector: Vector, roll: float, pitch: float, yaw: float) -> Vector:
    """Forward, right, down as north, east, down: about one axis after the other."""
    x, y, z = vector
    (cr, cp, cy), (sr, sp, sy) = (
        [turn(math.radians(one)) for one in (roll, pitch, yaw)] for turn in (math.cos, math.sin)
    )
    y, z = y * cr - z * sr, y * sr + z * cr
    x, z = x * cp + z * sp, z * cp - x * sp
    return x * cy - y * sy, x * sy + y * cy, z


@pytest.mark.parametrize("angles", [(0, 0, 0), (20, 0, 0), (0, -30, 0), (0, 0, 75), (25, -40, 130)])
@pytest.mark.parametrize("raw", [(0.3, 0.0, 0.0), (0.0, -0.7, 0.0), (0.1, 0.25, -1.4)])
def test_raw_acceleration_becomes_north_east_up_without_gravity(raw: Vector, angles: Any) -> None:
    north, east, down = to_ground(raw, *angles)
    expected = pytest.approx((north * G, east * G, -down * G - G), abs=1e-9)
    assert fused_of(raw, turned(*angles)) == expected
    longer = tuple(1.1 * part for part in turned(*angles))  # rounding of the aircraft's
    assert fused_of(raw, longer) == expected


@pytest.mark.parametrize(
    ("raw", "length", "known"),
    [
        ((49.9, 0.0, 0.0), 1.0, True),
        ((-60.0, 0.0, 0.0), 1.0, False),  # no sensor has more than 50 g
        ((0.0, 30.0, -30.0), 1.0, False),
        ((20.0, -20.0, 9.0), 1.0, True),
        ((math.nan, 0.0, -1.0), 1.0, False),
        ((0.0, 0.0, -1.0), 0.6, False),
        ((0.0, 0.0, -1.0), 0.8, True),
        ((0.0, 0.0, -1.0), 1.4, True),
        ((0.0, 0.0, -1.0), 1.5, False),
    ],
)
def test_what_cannot_be_has_no_acceleration(raw: Vector, length: float, known: bool) -> None:
    attitude = (0.6 * length, 0.0, -0.8 * length, 0.0)
    assert (fused_of(raw, attitude) is not None) is known


def seen(packages: Iterable[tuple[float, dict[str, Any]]]) -> str | None:
    reader = AccelerationReader()
    for at, items in packages:
        reader.read(encode_telemetry(items, FIRMWARE), FIRMWARE, at)
    return reader.seen


def steady(vector: Vector, seconds: float = 1.2, **items: Any) -> list[tuple[float, Any]]:
    given = {"acceleration": vector, "flight_status": (STANDS,), **items}
    return [(10.0 + step / 10, given) for step in range(round(seconds * 10) + 1)]


@pytest.mark.parametrize(
    ("vector", "mode"),
    [
        ((0.0, 0.0, -0.87), "raw"),  # 0.15 g off
        ((0.0, 0.0, -0.83), None),
        ((0.0, 0.0, -1.13), "raw"),
        ((0.0, 0.0, -1.17), None),
        ((0.69, 0.0, -0.73), "raw"),  # a slope of 45 degrees, whichever way
        ((0.0, -0.69, -0.73), "raw"),
        ((0.75, 0.0, -0.66), None),
        ((0.85, 0.0, -0.745), None),  # 1.13 g, and 0.79 of it is the least along the axis
        ((0.0, 0.0, 1.0), None),
        ((0.16, -0.16, 0.16), "fused"),  # 0.3 m/s²
        ((0.18, -0.18, 0.18), None),
    ],
)
def test_which_mean_shows_a_mode_on_the_ground(vector: Vector, mode: str | None) -> None:
    assert seen(steady(vector)) == mode


@pytest.mark.parametrize(("axis", "sign"), [(0, 1), (1, -1), (2, 1), (2, -1)])
@pytest.mark.parametrize(("change", "mode"), [(0.25, "raw"), (0.4, None)])
def test_what_gains_speed_in_its_second_does_not_rest(
    axis: int, sign: int, change: float, mode: str | None
) -> None:
    packages = []
    for at, items in steady((0.0, 0.0, -1.0), 0.9 + 0.2):
        velocity = [0.0, 0.0, 0.0]
        velocity[axis] = sign * change * (at - 10.0)
        packages.append((at, {**items, "velocity": (*velocity, 1)}))
    assert seen(packages) == mode


@pytest.mark.parametrize(("status", "windows"), [(STANDS, 1), (FLIES, 3)])
def test_as_many_seconds_as_it_takes(status: int, windows: int) -> None:
    still = {"velocity": (0.0, 0.0, 0.0, 1), "flight_status": (status,)}
    for seconds, mode in ((windows - 0.2, None), (windows + 0.2, "raw")):
        assert seen(steady((0.0, 0.0, -1.0), seconds, **still)) == mode


def test_a_row_of_seconds_is_broken_by_a_gap_and_by_one_that_moves() -> None:
    level = {"acceleration": (0.0, 0.0, -1.0), "flight_status": (FLIES,)}
    still = {**level, "velocity": (0.0, 0.0, 0.0, 1)}
    moves = {**still, "acceleration": (0.9, 0.0, -1.0)}

    def row(*parts: tuple[float, float, dict[str, Any]]) -> list[tuple[float, Any]]:
        return [
            (begin + step / 10, items)
            for begin, seconds, items in parts
            for step in range(round(seconds * 10))
        ]

    assert seen(row((10.0, 3.6, still))) == "raw"
    assert seen(row((10.0, 2.4, still), (12.4, 1.1, moves), (13.5, 2.0, still))) is None
    assert seen(row((10.0, 2.4, still), (16.0, 2.4, still))) is None  # silent for 3.6 s


# -- places and times ------------------------------------------------------------------------------


def test_a_way_is_north_east_up_by_the_latitude_where_it_ends() -> None:
    """1e-5 rad are 63.78 m on a sphere of 6,378,137 m; east half of it at 60 degrees."""
    here = _Fix(0.0, 0, math.radians(-60.0), 2.0, 30.0, None)
    there = _Fix(1.0, 0, math.radians(-60.0) + 1e-5, 2.0 - 3e-5, 27.5, None)
    assert here.to(there) == pytest.approx((63.781, -95.67, -2.5), abs=0.01)
    east, west = here._replace(longitude=math.pi - 1e-5), here._replace(longitude=-math.pi + 1e-5)
    assert east.to(west)[1] == pytest.approx(2e-5 * 6_378_137.0 / 2, abs=0.01)


def test_the_time_of_a_package_is_told_by_its_tick_across_the_end_of_32_bits() -> None:
    clock, first = _Clock(), (1 << 32) - 1000  # 600 Hz: the ticks wrap after 1.67 s
    packages = [
        Sample(
            encode_telemetry({"time": (first + 60 * n & 0xFFFFFFFF,)}, profile("1.0")),
            profile("1.0"),
            50.0 + n / 10,
        )
        for n in range(31)
    ]
    for package in packages:
        clock.look(package)
    assert clock.now == pytest.approx(3.0)
    for n in (5, 25, 30):
        assert clock.time_of(packages[n]) == pytest.approx((n / 10, clock.epoch))


@pytest.mark.parametrize("tick_hz", [400, 600])
def test_as_far_before_the_first_package_as_behind_the_last_is_as_uncertain(tick_hz: int) -> None:
    clock, first = DeviceClock(tick_hz), 5000 * tick_hz
    for step in range(30 * 50 + 1):
        clock.update(first + step * tick_hz // 50, 700.0 + step / 50)
    before, after = (clock.host_time(first + seconds * tick_hz) for seconds in (-1000, 30 + 1000))
    assert before is not None
    assert after is not None
    assert before.time == pytest.approx(700.0 - 1000.0, abs=0.02)
    assert after.time == pytest.approx(700.0 + 1030.0, abs=0.02)
    assert before.uncertainty_s == pytest.approx(after.uncertainty_s, rel=0.05)
    assert before.uncertainty_s > 10 * clock.uncertainty_s
    assert clock.offset_s == pytest.approx(700.0 - 5000.0, abs=0.01)


def test_utc_is_the_loops_time_and_the_offset(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(time, "time", lambda: 1.7e9)
    stream = TelemetryStream(lambda _: None, lambda: 1234.5)
    assert stream.utc_offset_s + 1234.5 == 1.7e9


def test_a_velocity_of_more_than_half_a_second_ago_contradicts_no_stand() -> None:
    for velocity_at, believed in ((100.0, STANDS), (100.6, None)):
        state = AircraftState(lambda: 0.0)
        for at in (100.0, 100.6, 100.8, 101.0, 101.15):
            items: dict[str, Any] = {"flight_status": (STANDS,)}
            if at == velocity_at:
                items["velocity"] = (0.0, 0.0, -3.0, 1)
            state.update(Sample(encode_telemetry(items, FIRMWARE), FIRMWARE, at))
            if at == 101.0:
                status = state.believed_status
                assert (None if status is None else status.status) == believed


@pytest.mark.parametrize(("north", "is_valid", "known"), [(1.9, 1, 1), (2.1, 1, None), (2.1, 0, 1)])
def test_a_velocity_contradicts_a_stand_from_two_metres_per_second(
    north: float, is_valid: int, known: int | None
) -> None:
    """But one that the aircraft does not vouch for says nothing."""
    state = AircraftState(lambda: 0.0)
    for step in range(10):
        items = {"flight_status": (STANDS,), "velocity": (north, 0.0, 0.0, is_valid)}
        state.update(Sample(encode_telemetry(items, FIRMWARE), FIRMWARE, 100.0 + step / 10))
    status = state.believed_status
    assert (None if status is None else status.status) == known


# -- consumers -------------------------------------------------------------------------------------


def test_the_room_of_all_is_that_of_the_fullest() -> None:
    hub: Hub[int] = Hub()
    assert hub.room == math.inf
    narrow, wide = hub.subscribe(Newest(5)), hub.subscribe(Lossless(9))
    for value in range(3):
        hub.publish(value, 0.0)
    assert hub.room == 2
    for _ in range(3):
        narrow.get_nowait()
    assert hub.room == 5
    narrow.close()
    assert hub.room == 6
    wide.close()
    assert hub.room == math.inf
    assert not hub.has_consumers


def test_packages_that_do_not_fit_are_counted_and_the_first_is_logged(
    caplog: pytest.LogCaptureFixture,
) -> None:
    stream = TelemetryStream(lambda _: None, lambda: 0.0)
    value = encode_telemetry({"battery": (73,)}, FIRMWARE)
    for number in range(4):
        stream.receive(value + b"\0", FIRMWARE, 100.0 + number)
    stream.receive(value, FIRMWARE, 105.0)
    assert stream.mismatches == 4
    assert sum("refused" in record.message for record in caplog.records) == 1
    assert stream.state.newest_at == 105.0


def test_a_notebook_has_the_track_by_latitude_and_longitude_and_each_digit(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    drawn: list[list[tuple[float, ...]]] = []

    def draw(way: Iterable[tuple[float, ...]]) -> str:
        drawn.append(list(way))
        return ""

    monkeypatch.setattr("m100link.geodesy.track_svg", draw)
    names = ("position.longitude_deg", "position.latitude_deg", "position.latitude_rad")
    html = Table(names, [(113.912345678, -22.5, -0.392699081699)])._repr_html_()
    assert drawn == [[(-22.5, 113.912345678)]]
    assert "<td>113.912345678</td><td>-22.5</td><td>-0.392699081699</td>" in html


def test_each_limit_is_as_agreed() -> None:
    assert limits.differences("telemetry") == []
