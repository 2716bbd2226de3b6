"""One package and its time of arrival, and its acceleration in one frame whatever its mode."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from random import Random
from typing import Any

import pytest

from m100link.errors import LayoutMismatch, UsageError
from m100link.log import read
from m100link.log.channels import LINK, TELEMETRY
from m100link.protocol import Attitude, Battery, TelemetryPacket, encode_telemetry, profile
from m100link.protocol.firmware import PROFILES
from m100link.protocol.records import Acceleration, AccelerationMode
from m100link.telemetry.columns import Columns, Table
from m100link.telemetry.sample import AccelerationReader, Sample, acceleration_mode
from m100link.telemetry.subscription import TelemetryStream
from tests.log.flight import URL, fly

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


# -- acceleration, raw or fused --------------------------------------------------------------------
# Raw: body axes (forward, right, down), in g, gravity included, as recordings of a real aircraft
# have it at rest: (0, 0, -1). Fused: north, east, up, m/s², without gravity.

G = 9.80665
RAW, FUSED = AccelerationMode.RAW, AccelerationMode.FUSED


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


LEVEL = turned(0, 0, 0)
STILL = {"velocity": (0.0, 0.0, 0.0, 1)}


def heard(
    stream: TelemetryStream,
    seconds: float,
    acceleration: tuple[float, ...] | Callable[[float], tuple[float, ...]],
    *,
    begin: float = 10.0,
    hz: float = 50.0,
    **items: Any,
) -> Acceleration | None:
    """Let packages come; returns the acceleration that is known at the end."""
    for number in range(round(seconds * hz) + 1):
        now = number / hz
        given = {name: one(now) if callable(one) else one for name, one in items.items()}
        value = acceleration(now) if callable(acceleration) else acceleration
        made = encode_telemetry({"quaternion": LEVEL, "acceleration": value} | given, FIRMWARE)
        stream.receive(made, FIRMWARE, begin + now)
    return stream.state.get(Acceleration)


def stream(mode: AccelerationMode | None = None) -> TelemetryStream:
    return TelemetryStream(lambda _: None, lambda: 0.0, AccelerationReader(mode))


@pytest.mark.parametrize(
    ("items", "seconds"),
    [
        ({"flight_status": (1,)}, 1.1),  # standing
        ({"flight_status": (1,), "velocity": (0.2, 0.0, -0.1, 0)}, 1.1),  # and GPS drifts
        (STILL | {"flight_status": (3,)}, 3.3),  # hovering
        ({"flight_status": (3,)}, 6.5),  # in the air, and nobody knows how fast
        ({}, 6.5),
    ],
)
@pytest.mark.parametrize("mode", [RAW, FUSED])
def test_rest_shows_the_mode(mode: AccelerationMode, items: dict[str, Any], seconds: float) -> None:
    one = stream()
    value = (0.02, -0.01, -0.999) if mode is RAW else (0.05, -0.02, 0.1)
    assert heard(one, 0.9, value, **items) is None, "unknown, rather than wrong"
    found = heard(one, seconds, value, begin=10.92, **items)
    assert one.acceleration.mode is one.acceleration.seen is mode
    expected = (0.02 * G, -0.01 * G, 0.999 * G - G) if mode is RAW else value
    assert found == pytest.approx(expected, abs=1e-5)


@pytest.mark.parametrize("hz", [1, 10, 50, 100])
def test_every_rate_of_the_assistant_shows_it(hz: float) -> None:
    one = stream()
    heard(one, 4.0, (0.0, 0.0, -1.0), hz=hz, flight_status=(1,))
    assert one.acceleration.mode is RAW


@pytest.mark.parametrize("slope", [(20.0, 0.0, 0.0), (0.0, 30.0, 50.0), (-25.0, 20.0, 170.0)])
def test_a_slope_is_a_stand_too(slope: tuple[float, float, float]) -> None:
    roll, pitch = (math.radians(one) for one in slope[:2])
    up = -math.sin(pitch), math.sin(roll) * math.cos(pitch), math.cos(roll) * math.cos(pitch)
    raw = tuple(-one for one in up)  # what holds it points up; these are the down axis in the body
    one = stream()
    found = heard(one, 1.1, raw, quaternion=turned(*slope), flight_status=(1,))
    assert one.acceleration.mode is RAW
    assert found == pytest.approx((0.0, 0.0, 0.0), abs=1e-5)


@pytest.mark.parametrize(
    ("what", "acceleration", "items"),
    [
        (  # fused, at the begin of a descent: as long and as directed as raw values at rest
            "sinking ever faster",
            (0.0, 0.0, -1.0),
            {"velocity": lambda now: (0.0, 0.0, -now, 1), "flight_status": (4,)},
        ),
        (  # the same in a hand, motors off
            "lowered by hand",
            (0.0, 0.0, -1.0),
            {"velocity": lambda now: (0.0, 0.0, -now, 1), "flight_status": (1,)},
        ),
        ("upside down in a hand", (0.0, 0.0, 1.0), {"flight_status": (1,)}),
        ("on its side", (0.0, -1.0, 0.0), {"flight_status": (1,)}),
        ("turning hard", (1.5, -2.5, 0.7), STILL),
        ("no number", (math.nan, 0.0, -1.0), {"flight_status": (1,)}),
        ("no sensor reaches it", (3e38, 0.0, -1.0), {"flight_status": (1,)}),
        ("a short descent without a velocity", (0.0, 0.0, -1.0), {"flight_status": (4,)}),
    ],
)
def test_what_shows_no_mode_is_unknown(
    what: str, acceleration: tuple[float, ...], items: dict[str, Any]
) -> None:
    one = stream()
    assert heard(one, 3.0, acceleration, **items) is None
    assert one.acceleration.mode is None
    assert one.acceleration.has_arrived
    assert one.mismatches == 0


def test_one_second_of_a_flood_is_bounded_and_shows_the_mode() -> None:
    one = stream()
    heard(one, 0.99, (0.0, 0.0, -1.0), hz=5000.0, flight_status=(1,))
    assert len(one.acceleration._felt) == 1000
    heard(one, 0.1, (0.0, 0.0, -1.0), begin=11.0, flight_status=(1,))
    assert one.acceleration.mode is RAW


@pytest.mark.parametrize("wrong", [math.nan, math.inf, -math.inf])
def test_a_second_with_a_value_that_is_none_shows_no_mode(wrong: float) -> None:
    one = stream()
    heard(one, 1.1, lambda now: (wrong if now == 0.5 else 0.0, 0.0, -1.0), flight_status=(1,))
    assert one.acceleration.mode is None
    heard(one, 1.1, (0.0, 0.0, -1.0), begin=11.12, flight_status=(1,))
    assert one.acceleration.mode is RAW


def test_raw_values_are_turned_by_the_attitude_and_loose_gravity() -> None:
    # Nose to the east, 2 m/s² to the north: that is to its left, and gravity is below.
    one = stream(RAW)
    raw = (0.0, -2.0 / G, -1.0)
    assert heard(one, 0.0, raw, quaternion=turned(0, 0, 90)) == pytest.approx(
        (2.0, 0.0, 0.0), abs=1e-5
    )
    # Falling freely, whatever the attitude.
    found = heard(one, 0.0, (0.0, 0.0, 0.0), quaternion=turned(10, 20, 30))
    assert found == pytest.approx((0.0, 0.0, -G), abs=1e-5)


@pytest.mark.parametrize("attitude", [(0.0, 0.0, 0.0, 0.0), (math.nan, 0, 0, 0), (3, 0, 0, 0)])
def test_raw_values_without_an_attitude_are_unknown(attitude: tuple[float, ...]) -> None:
    one = stream(RAW)
    assert heard(one, 0.5, (0.0, 0.0, -1.0), quaternion=attitude) is None
    # One of a package before serves for a moment, and no longer.
    heard(one, 0.0, (0.0, 0.0, -1.0))
    alone = encode_telemetry({"acceleration": (0.5, 0.0, -1.0)}, FIRMWARE)
    for later, is_known in ((0.2, True), (0.4, False)):
        sample = Sample(one.acceleration.read(alone, FIRMWARE, 10.0 + later), FIRMWARE, 0.0)
        assert (sample.acceleration is not None) is is_known


@pytest.mark.parametrize("firmware", PROFILES)
@pytest.mark.parametrize("mode", [None, RAW, FUSED])
def test_every_other_item_stays_as_it_is(mode: AccelerationMode | None, firmware: str) -> None:
    """Drawn: packages of all kinds, damaged ones among them."""
    draw, made = Random(firmware), profile(firmware)
    reader = AccelerationReader(mode)
    for _ in range(300):
        items = {
            name: [draw.randrange(0, 9)] * len(layout.fields)
            for name, layout in made.items.items()
            if draw.random() < 0.7
        }
        value = encode_telemetry(items, made)
        given = value if draw.random() < 0.8 else value[: draw.randrange(len(value))]
        read = reader.read(given, made, draw.uniform(0, 100))
        if given != value:
            assert read == given, "its reader refuses it"
            continue
        before, after = (TelemetryPacket(one, made).raw_items() for one in (value, read))
        kept = after.pop("acceleration", None)
        assert before.pop("acceleration", None) is not None or kept is None
        assert after == before


def test_a_lift_that_looked_raw_is_overturned_by_rest_and_a_fall_is_not(
    caplog: pytest.LogCaptureFixture,
) -> None:
    """A fused aircraft in a hand, braked with 1 m/s², and without a velocity."""
    caplog.set_level("INFO")
    one = stream()
    standing: dict[str, Any] = {"flight_status": (1,)}
    heard(one, 1.1, (0.0, 0.0, -1.0), **standing)
    assert one.acceleration.mode is RAW
    heard(one, 3.3, (0.0, 0.0, 0.05), begin=12.0, **standing)
    assert one.acceleration.mode is one.acceleration.seen is FUSED
    assert "comes fused" in caplog.text
    # A raw one that falls for two seconds is raw.
    one = stream()
    heard(one, 1.1, (0.0, 0.0, -1.0), **standing)
    heard(one, 2.2, (0.0, 0.0, 0.0), begin=12.0, **standing)
    heard(one, 1.1, (0.0, 0.0, -1.0), begin=14.3, **standing)
    heard(one, 2.2, (0.0, 0.0, 0.0), begin=15.5, **standing)
    assert one.acceleration.mode is RAW
    # A mode that somebody fixed stays.
    one = stream(RAW)
    heard(one, 1.1, (0.0, 0.0, -1.0), **standing)
    heard(one, 3.3, (0.0, 0.0, 0.05), begin=12.0, **standing)
    assert one.acceleration.mode is RAW
    assert one.acceleration.seen is FUSED


def test_a_mode_that_somebody_fixed_stays_and_what_is_seen_is_told(
    caplog: pytest.LogCaptureFixture,
) -> None:
    one = stream(FUSED)
    assert heard(one, 0.1, (0.0, 0.0, -1.0), flight_status=(1,)) == (0.0, 0.0, -1.0)
    heard(one, 3.0, (0.0, 0.0, -1.0), flight_status=(1,))
    assert (one.acceleration.mode, one.acceleration.seen) == (FUSED, RAW)
    [warning] = [record for record in caplog.records if record.levelname == "WARNING"]
    assert "is read as fused, and its values at rest are raw" in warning.getMessage()
    with pytest.raises(UsageError, match="'g'"):
        acceleration_mode("g")


@pytest.mark.anyio
@pytest.mark.parametrize("mode", ["raw", "fused"])
async def test_a_flight_has_the_same_accelerations_in_both_modes(mode: str, tmp_path: Path) -> None:
    """The truth is the change of the velocities that the aircraft reports, without noise."""
    pytest.importorskip("mcap", reason="the extra `log` is not installed")
    place = tmp_path / "flight.mcap"
    seen = await fly(place, f"{URL}&acceleration={mode}", acceleration=None)
    log = read(place)
    assert log.acceleration_by(profile("1.0")) == log.summary().acceleration == mode
    told = {message.content()["acceleration"] for message in log.messages(LINK)}
    assert told == {None, mode}, "the log says which was in force, and when it became known"
    assert seen[0].acceleration is None
    assert seen[0].attitude is not None
    hardest = 0.0
    columns = Columns(utc_offset_s=0.0)
    for table in (Table(columns.names, [columns.row(one) for one in seen]), log.table()):
        at = table.column("received_at")
        for axis in ("north", "east", "up"):
            speed = table.column(f"velocity.{axis}_m_s")
            found = table.column(f"acceleration.{axis}_m_s2")
            for here in range(1, len(at) - 1):
                around, passed = found[here - 1 : here + 2], at[here + 1] - at[here - 1]
                if math.isnan(sum(around)) or not 0.015 < passed < 0.025:
                    continue
                truth = (speed[here + 1] - speed[here - 1]) / passed
                if abs(truth) > 20.0:  # it touches the ground, which takes no time
                    continue
                assert min(around) - 0.05 <= truth <= max(around) + 0.05, (axis, at[here])
                hardest = max(hardest, abs(truth))
    assert hardest > 1.5, "it did accelerate"
    rows = [message.content().get("acceleration.z") for message in log.messages(TELEMETRY)]
    assert rows[0] is None, "not known yet"
    assert rows[-1] == pytest.approx(0.0, abs=0.05), "fused, though the bytes beside it may be raw"
