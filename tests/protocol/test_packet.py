"""Layouts per firmware, records, the views they give, and packets that do not fit."""

from __future__ import annotations

import math
import struct
from dataclasses import replace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from m100link.errors import LayoutMismatch, TelemetryError
from m100link.protocol import (
    PROFILES,
    Acceleration,
    AngularVelocity,
    Attitude,
    Battery,
    ControlDevice,
    Device,
    FirmwareProfile,
    FlightPhase,
    FlightStatus,
    Gimbal,
    Magnetometer,
    Position,
    RcMode,
    RemoteControl,
    TelemetryPacket,
    Time,
    Velocity,
    encode_telemetry,
    profile,
)
from m100link.protocol.items import BY_RECORD, ITEMS, RecordViews
from m100link.protocol.packet import _plan, fitting_profiles, plan_of, telemetry_size
from m100link.protocol.records import in_body, quaternion
from tests.support import load_vectors

VECTORS = load_vectors("telemetry")
FLAGS = st.integers(0, 0x0FFF)
FIRMWARES = st.sampled_from(list(PROFILES.values()))


def packet(firmware: str, **items: list[float]) -> TelemetryPacket:
    """A packet off the wire with these raw items."""
    return TelemetryPacket(encode_telemetry(items, profile(firmware)), profile(firmware))


# -- golden vectors and layouts --------------------------------------------------------------------


@pytest.mark.parametrize("vector", VECTORS, ids=range(len(VECTORS)))
def test_golden_telemetry_both_ways(vector: dict[str, Any]) -> None:
    firmware, value = profile(vector["firmware"]), bytes.fromhex(vector["value"])
    found = TelemetryPacket(value, firmware)
    assert found.flags == vector["flags"]
    assert found.raw_items() == vector["items"]
    rows = {name: list(fields.values()) for name, fields in vector["items"].items()}
    assert encode_telemetry(rows, firmware) == value
    read = plan_of(value, firmware).tick  # alone, for the clock
    assert (read and read(value)[0]) == vector["items"].get("time", {"tick": None})["tick"]


@pytest.mark.parametrize("vector", VECTORS, ids=range(len(VECTORS)))
def test_golden_records_carry_the_raw_values(vector: dict[str, Any]) -> None:
    found = TelemetryPacket(bytes.fromhex(vector["value"]), profile(vector["firmware"]))
    records = found.records()
    assert [type(record) for record in records] == [
        item.record for item in ITEMS if item.name in vector["items"]
    ]
    for record in records:
        assert found.get(type(record)) == record
        name = BY_RECORD[type(record)].name
        wanted = sorted(vector["items"][name].values())
        carried = [value for value in record if value is not None]
        if name == "time":
            assert carried.pop() == profile(vector["firmware"]).tick_hz
        assert sorted(carried) == wanted


@pytest.mark.parametrize(
    ("firmware", "total"), [("1.0", 116), ("2.3", 117), ("3.1", 124), ("1.0-document", 119)]
)
def test_all_items_together_have_the_size_of_their_firmware(firmware: str, total: int) -> None:
    assert telemetry_size(0x0FFF, profile(firmware)) == total
    assert telemetry_size(0, profile(firmware)) == 2


@given(FLAGS, FIRMWARES)
def test_items_follow_in_bit_order_without_gaps(flags: int, firmware: FirmwareProfile) -> None:
    offset, wanted = 2, {}
    for item in ITEMS:
        if flags >> item.bit & 1:
            wanted[item.name] = offset
            offset += firmware.items[item.name].size
    assert telemetry_size(flags, firmware) == offset
    # Every byte holds its own place, so an item read from elsewhere shows other bytes.
    value = struct.pack("<H", flags) + bytes(range(2, offset))
    items = TelemetryPacket(value, firmware).raw_items()
    assert list(items) == list(wanted)
    for name, at in wanted.items():
        layout = firmware.items[name]
        raw = struct.pack("<" + layout.format, *items[name].values())
        assert raw == bytes(range(at, at + layout.size))


@pytest.mark.parametrize("firmware", PROFILES)
@pytest.mark.parametrize("flags", [0x0FFF, 0x0F80, 0x0800, 0x0AAA, 0x0555])
def test_the_span_of_a_field_is_where_its_value_is(firmware: str, flags: int) -> None:
    """A value made of such spans alone is the value of the whole."""
    speaks = profile(firmware)
    numbers = iter(range(1, 200))
    items = {
        item.name: [next(numbers) for _ in speaks.items[item.name].fields]
        for item in ITEMS
        if item.name in speaks.items and flags >> item.bit & 1
    }
    value = encode_telemetry(items, speaks)
    found: set[int] = set()
    for item in ITEMS:
        for field in item.fields:
            span = _plan(flags & speaks.item_flags, speaks).span(item.record, field)
            layout = speaks.items.get(item.name)
            if item.name not in items or layout is None or field not in layout.fields:
                assert span == slice(0, 0)
                continue
            alone = bytearray(len(value))
            alone[:2], alone[span] = value[:2], value[span]
            raw = TelemetryPacket(bytes(alone), speaks).raw_items()
            assert raw[item.name][field] == items[item.name][layout.fields.index(field)]
            assert not found & set(range(span.start, span.stop))
            found |= set(range(span.start, span.stop))
    assert found == set(range(2, len(value)))


def test_the_document_profile_reads_longitude_first_and_lacks_what_its_table_lacks() -> None:
    value = struct.pack("<H2d2f3f5h", 0x00E0, 1.0, 0.5, 10, 20, 1, 2, 3, 1, 2, 3, 4, 8000)
    found = TelemetryPacket(value, profile("1.0-document"))
    assert found.position == Position(0.5, 1.0, 10, 20, None)
    assert found.magnetometer == Magnetometer(1, 2, 3)
    assert found.remote_control == RemoteControl(1, 2, 3, 4, 8000, None)


def test_items_that_a_firmware_lacks_are_none_in_its_records() -> None:
    first = packet("1.0", time=[6000], velocity=[1, 2, 3], gimbal=[4, 5, 6], control_device=[2])
    assert first.time == Time(6000, None, None, 600)
    assert first.velocity == Velocity(1, 2, 3, None)
    assert first.gimbal == Gimbal(4, 5, 6, None)
    assert first.control_device == ControlDevice(2, None)
    third = packet(
        "3.1", time=[400, 7, 1], velocity=[1, 2, 3, 1], gimbal=[4, 5, 6, 2], control_device=[4, 10]
    )
    assert third.time == Time(400, 7, 1, 400)
    assert third.velocity == Velocity(1, 2, 3, 1)
    assert third.gimbal == Gimbal(4, 5, 6, 2)
    assert third.control_device == ControlDevice(control=10, mode=4)


def test_a_packet_without_an_item_answers_none() -> None:
    empty = packet("3.1")
    views = [name for name, view in vars(RecordViews).items() if isinstance(view, property)]
    assert [getattr(empty, view) for view in views] == [None] * len(ITEMS)
    assert empty.records() == []
    assert [empty.get(item.record) for item in ITEMS] == [None] * len(ITEMS)


def test_a_packet_shows_its_records() -> None:
    assert repr(packet("3.1", battery=[88])) == "TelemetryPacket(Battery(percent=88))"


def test_an_item_that_does_not_exist_cannot_be_encoded() -> None:
    with pytest.raises(KeyError, match="speed"):
        encode_telemetry({"speed": [1]}, profile("3.1"))


# -- packets that do not fit -----------------------------------------------------------------------


@given(FLAGS, st.integers(0, 140), FIRMWARES)
def test_a_length_that_does_not_fit_the_flags_is_refused_and_others_are_not(
    flags: int, size: int, firmware: FirmwareProfile
) -> None:
    value = struct.pack("<H", flags) + bytes(size)
    if len(value) == telemetry_size(flags, firmware):
        TelemetryPacket(value, firmware)
    else:
        with pytest.raises(LayoutMismatch, match=f"there are {len(value)}"):
            TelemetryPacket(value, firmware)


@pytest.mark.parametrize(
    ("speaks", "expected"), [("1.0", "3.1"), ("2.3", "1.0"), ("3.1", "1.0"), ("3.1", "2.3")]
)
def test_a_mismatch_names_the_firmware_that_would_fit(speaks: str, expected: str) -> None:
    value = struct.pack("<H", 0x0FFF) + bytes(telemetry_size(0x0FFF, profile(speaks)) - 2)
    with pytest.raises(LayoutMismatch) as caught:
        TelemetryPacket(value, profile(expected))
    assert f"firmware {speaks}" in caught.value.cause
    assert speaks in caught.value.remedy
    assert isinstance(caught.value, TelemetryError)


@pytest.mark.parametrize("value", [b"", b"\x00"])
def test_a_value_without_a_flag_word_is_refused(value: bytes) -> None:
    assert fitting_profiles(value) == []
    with pytest.raises(LayoutMismatch, match="flag word") as caught:
        TelemetryPacket(value, profile("3.1"))
    assert (caught.value.cause, caught.value.remedy) == ("", "compare the firmware version")


@pytest.mark.parametrize("bit", range(len(ITEMS), 16))
def test_reserved_flag_bits_are_refused(bit: int) -> None:
    with pytest.raises(LayoutMismatch, match="reserved"):
        TelemetryPacket(struct.pack("<H", 1 << bit), profile("3.1"))


def test_packets_without_a_changed_item_fit_every_firmware_of_the_air() -> None:
    value = encode_telemetry({"quaternion": [1, 0, 0, 0], "battery": [9]}, profile("1.0"))
    assert fitting_profiles(value) == ["1.0", "2.3", "3.1", "1.0-document"]


# -- attitude --------------------------------------------------------------------------------------

H = math.sqrt(0.5)
# Scalar first; roll, pitch and yaw in degrees (z-y-x, north-east-down to forward-right-down).
ATTITUDES = [
    ((1, 0, 0, 0), (0, 0, 0)),
    ((H, 0, 0, H), (0, 0, 90)),  # facing east
    ((0, 0, 0, 1), (0, 0, 180)),
    ((H, 0, 0, -H), (0, 0, -90)),  # facing west
    ((H, H, 0, 0), (90, 0, 0)),  # right side down
    ((math.cos(math.pi / 12), 0, math.sin(math.pi / 12), 0), (0, 30, 0)),  # nose up
    ((math.cos(math.pi / 12), 0, -math.sin(math.pi / 12), 0), (0, -30, 0)),  # flying forward
]


@pytest.mark.parametrize(("quaternion", "angles"), ATTITUDES)
def test_euler_angles_of_known_attitudes(
    quaternion: tuple[float, ...], angles: tuple[float, ...]
) -> None:
    attitude = Attitude(*quaternion)
    found = (attitude.roll_deg, attitude.pitch_deg, attitude.yaw_deg)
    assert found == pytest.approx(angles, abs=1e-9)


def _quaternion(roll: float, pitch: float, yaw: float) -> Attitude:
    """The product of three half-angle rotations about z, y and x."""
    (cr, sr), (cp, sp), (cy, sy) = (
        (math.cos(math.radians(angle) / 2), math.sin(math.radians(angle) / 2))
        for angle in (roll, pitch, yaw)
    )
    return Attitude(
        cr * cp * cy + sr * sp * sy,
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
    )


ANGLE = st.floats(-179, 179)


@given(ANGLE, st.floats(-89, 89), ANGLE)
def test_euler_angles_are_those_that_made_the_quaternion(
    roll: float, pitch: float, yaw: float
) -> None:
    attitude = _quaternion(roll, pitch, yaw)
    found = (attitude.roll_deg, attitude.pitch_deg, attitude.yaw_deg)
    assert found == pytest.approx((roll, pitch, yaw), abs=1e-5)


def _rotate(quaternion: tuple[float, ...], vector: tuple[float, ...]) -> tuple[float, ...]:
    """Turn a vector by a scalar-last quaternion."""
    x, y, z, w = quaternion
    a, b, c = vector
    tx, ty, tz = 2 * (y * c - z * b), 2 * (z * a - x * c), 2 * (x * b - y * a)
    return (
        a + w * tx + y * tz - z * ty,
        b + w * ty + z * tx - x * tz,
        c + w * tz + x * ty - y * tx,
    )


@given(ANGLE, st.floats(-89, 89), ANGLE)
def test_ros_sees_the_nose_where_the_aircraft_has_it(roll: float, pitch: float, yaw: float) -> None:
    attitude = _quaternion(roll, pitch, yaw)
    for ned_frd, enu_flu in (
        ((1, 0, 0), (1, 0, 0)),
        ((0, 1, 0), (0, -1, 0)),
        ((0, 0, 1), (0, 0, -1)),
    ):
        north, east, down = _rotate(attitude.xyzw, ned_frd)
        seen = _rotate(attitude.enu_flu_xyzw, enu_flu)
        assert seen == pytest.approx((east, north, -down), abs=1e-6)


@pytest.mark.parametrize("angles", [(10.0, -20.0, 170.0), (-35.0, 50.0, -75.0)])
def test_a_vector_turns_into_the_body_by_yaw_then_pitch_then_roll(
    angles: tuple[float, float, float],
) -> None:
    roll, pitch, yaw = map(math.radians, angles)
    north, east, down = 3.0, -5.0, 7.0
    x = north * math.cos(yaw) + east * math.sin(yaw)
    y = east * math.cos(yaw) - north * math.sin(yaw)
    x, z = (
        x * math.cos(pitch) - down * math.sin(pitch),
        x * math.sin(pitch) + down * math.cos(pitch),
    )
    y, z = y * math.cos(roll) + z * math.sin(roll), z * math.cos(roll) - y * math.sin(roll)
    attitude = Attitude(*quaternion(roll, pitch, yaw))
    assert in_body(attitude.xyzw, (north, east, down)) == pytest.approx((x, y, z))
    assert (attitude.roll_deg, attitude.pitch_deg, attitude.yaw_deg) == pytest.approx(angles)


def test_the_scalar_stands_first_on_the_wire_and_last_for_ros() -> None:
    attitude = packet("3.1", quaternion=[0.5, 0.25, -0.25, 0.125]).attitude
    assert attitude is not None
    assert attitude.wxyz == (0.5, 0.25, -0.25, 0.125)
    assert attitude.xyzw == (0.25, -0.25, 0.125, 0.5)


def test_a_quaternion_that_rounding_made_too_long_still_has_a_pitch() -> None:
    assert Attitude(H + 1e-6, 0, H + 1e-6, 0).pitch_deg == 90


# -- other views -----------------------------------------------------------------------------------


@pytest.mark.parametrize("record", [Acceleration(1.0, 2.0, 3.0), Velocity(1.0, 2.0, 3.0, None)])
def test_up_is_positive_and_the_ned_view_turns_it_down(record: Acceleration | Velocity) -> None:
    assert record.ned == (1.0, 2.0, -3.0)
    assert record.enu == (2.0, 1.0, 3.0)


def test_the_velocity_status_has_a_valid_bit_and_a_sensor() -> None:
    gps = Velocity(3.0, 4.0, 9.0, 0b0000_0111)
    assert (gps.is_valid, gps.sensor, gps.ground_speed_m_s) == (True, 3, 5.0)
    assert Velocity(0, 0, 0, 0b0000_1000).is_valid is False
    assert Velocity(0, 0, 0, 0b0000_1000).sensor == 4
    silent = Velocity(0, 0, 0, None)
    assert (silent.is_valid, silent.sensor) == (None, None)


def test_angular_velocity_is_rad_per_second_about_body_axes() -> None:
    turning = AngularVelocity(math.pi, math.pi / 2, math.pi / 4)
    found = (turning.roll_rate_deg_s, turning.pitch_rate_deg_s, turning.yaw_rate_deg_s)
    assert found == pytest.approx((180, 90, 45))


def test_position_is_radian_on_the_wire_and_degrees_in_its_view() -> None:
    place = Position(math.radians(22.5), math.radians(113.9), 10, 1.5, 5)
    assert (place.latitude_deg, place.longitude_deg) == pytest.approx((22.5, 113.9))


@pytest.mark.parametrize(
    ("tick", "firmware", "seconds"), [(600, "1.0", 1.0), (600, "2.3", 1.0), (400, "3.1", 1.0)]
)
def test_the_tick_is_a_six_or_four_hundredth_of_a_second(
    tick: int, firmware: str, seconds: float
) -> None:
    row: list[float] = [tick, 0, 0] if firmware == "3.1" else [tick]
    time = packet(firmware, time=row).time
    assert time is not None
    assert time.seconds == seconds


@pytest.mark.parametrize(
    ("mode", "switch"),
    [
        *((-8000, RcMode.P), (-7990, RcMode.P), (0, RcMode.A), (3999, RcMode.A), (8000, RcMode.F)),
        # Half-way belongs to the middle, from both sides: neither is where a program may fly.
        *((-4001, RcMode.P), (-4000, RcMode.A), (4000, RcMode.A), (4001, RcMode.F)),
    ],
)
def test_the_mode_switch_is_its_nearest_position(mode: int, switch: RcMode) -> None:
    remote = RemoteControl(0, 0, 0, 0, mode, None)
    assert remote.mode_switch is switch
    assert remote.is_in_f == (switch is RcMode.F)


def test_flight_status_keeps_unknown_numbers() -> None:
    phases = [FlightStatus(number).phase for number in range(7)]
    assert phases == [None, *FlightPhase, None]
    airborne = [number for number in range(256) if FlightStatus(number).is_airborne]
    assert airborne == [FlightPhase.IN_AIR, FlightPhase.LANDING]


@pytest.mark.parametrize(
    ("control", "device", "requested", "virtual_rc"),
    [
        (0, Device.RC, False, False),
        (1, Device.APP, False, False),
        (2, Device.ONBOARD, False, False),
        (0x0A, Device.ONBOARD, True, False),
        (0x18, Device.RC, True, True),
        (7, None, False, False),
    ],
)
def test_the_control_byte_tells_device_request_and_virtual_remote(
    control: int, device: Device | None, requested: bool, virtual_rc: bool
) -> None:
    found = ControlDevice(control, None)
    assert (found.device, found.is_requested, found.is_virtual_rc) == (
        device,
        requested,
        virtual_rc,
    )


@given(FLAGS, st.data())
def test_records_and_single_reads_agree(flags: int, data: st.DataObject) -> None:
    firmware = data.draw(FIRMWARES)
    size = telemetry_size(flags, firmware) - 2
    value = struct.pack("<H", flags) + bytes(n * 37 & 0x3F for n in range(size))
    found = TelemetryPacket(value, firmware)
    single = [record for kind in BY_RECORD if (record := found.get(kind)) is not None]
    assert found.records() == single
    assert all(type(a) is type(b) for a, b in zip(found.records(), single, strict=True))


def test_battery_is_a_percentage() -> None:
    assert packet("1.0", battery=[55]).battery == Battery(55)


@pytest.mark.parametrize("vector", VECTORS, ids=range(len(VECTORS)))
def test_the_row_has_every_raw_value_under_its_column(vector: dict[str, Any]) -> None:
    packet = TelemetryPacket(bytes.fromhex(vector["value"]), profile(vector["firmware"]))
    flat = {
        f"{item}.{field}": value
        for item, fields in packet.raw_items().items()
        for field, value in fields.items()
    }
    assert dict(zip(packet.columns, packet.row(), strict=True)) == flat
    assert [ITEMS[bit].name for bit in packet.indices] == list(packet.raw_items())


# -- what is remembered ----------------------------------------------------------------------------


def test_what_is_no_record_is_an_error_and_not_an_item_that_is_missing() -> None:
    nothing = packet("1.0")
    assert nothing.get(Battery) is None
    with pytest.raises(KeyError):
        nothing.get(tuple[int])


def test_a_profile_made_of_another_reads_by_its_own_layouts() -> None:
    """What was worked out for the one is not taken over by the other."""
    plain = profile("1.0")
    value = encode_telemetry({"time": [7], "battery": [80]}, plain)
    assert TelemetryPacket(value, plain).records() == [Time(7, None, None, 600), Battery(80)]
    other = replace(plain, name="mine", tick_hz=50)
    assert TelemetryPacket(value, other).records() == [Time(7, None, None, 50), Battery(80)]
    assert TelemetryPacket(value, plain).get(Time) == Time(7, None, None, 600)


def test_flags_that_do_not_fit_are_not_remembered() -> None:
    """Whatever comes in, a profile knows at most one plan for each set of its own items."""
    firmware = replace(profile("1.0-document"), name="mine")
    for flags in range(0, 0x10000, 13):
        with pytest.raises(LayoutMismatch):
            TelemetryPacket(flags.to_bytes(2, "little") + bytes(200), firmware)
    assert all(flags & ~firmware.item_flags == 0 for flags in firmware.plans)


def test_a_line_that_sends_every_flag_word_is_not_remembered_whole() -> None:
    """With readers for all of them a profile took 26 MB."""
    firmware = replace(profile("1.0"), name="mine")
    for flags in range(1, firmware.item_flags + 1):
        value = flags.to_bytes(2, "little") + bytes(telemetry_size(flags, firmware) - 2)
        assert len(TelemetryPacket(value, firmware).row()) > 0
    assert len(firmware.plans) <= 256
    value = encode_telemetry({"battery": [80]}, firmware)
    assert TelemetryPacket(value, firmware).records() == [Battery(80)]
