"""The telemetry push (document 2.2.3.1): layouts, rates, tick, what the items say."""

from __future__ import annotations

import math
from collections import Counter
from itertools import pairwise
from random import Random
from typing import Any

import pytest
from geographiclib.geodesic import Geodesic

from m100link.protocol import PROFILES, Setpoint, SetTelemetryRates, TelemetryPacket
from m100link.protocol.items import BY_NAME, ITEMS
from m100link.protocol.packet import encode_telemetry
from m100link.sim import DEFAULT_RATES_HZ, AssistantSettings, VirtualAircraft
from m100link.sim.autopilot import Autopilot
from m100link.sim.line import is_telemetry
from m100link.wire import FrameDecoder, encode_frame
from tests.protocol.test_firmware import TOTALS

from .host import Host, aircraft

ALL = dict.fromkeys(BY_NAME, 100)
NORTH_EAST = Setpoint.velocity(north=4, east=3, up=1, yaw_deg=60)


def counts(host: Host) -> Counter[str]:
    found: Counter[str] = Counter()
    for packet in host.packets():
        for bit, name in enumerate(BY_NAME):
            found[name] += packet.flags >> bit & 1
    return found


# --- rates ----------------------------------------------------------------------------------


@pytest.mark.parametrize("firmware", ["1.0", "2.3", "3.1"])
def test_default_rates_over_a_simulated_minute(firmware: str) -> None:
    host = Host(firmware=firmware)
    host.wait(60.0)
    found = counts(host)
    sent = host.profile.items.keys()
    assert found == {name: 60 * DEFAULT_RATES_HZ[name] * (name in sent) for name in BY_NAME}
    assert len(host.packets()) == 6000


@pytest.mark.parametrize(
    ("rates", "packets"),
    [
        ({"rc": 50, "battery": 1}, 50),
        ({"flight_status": 10, "battery": 1}, 10),
        ({"battery": 1}, 1),
        ({}, 0),
    ],
)
def test_packets_go_out_at_the_highest_rate_and_carry_what_is_due(
    rates: dict[str, int], packets: int
) -> None:
    all_rates = dict.fromkeys(BY_NAME, 0) | rates
    host = Host(aircraft(assistant={"rates_hz": all_rates}))
    host.wait(10.0)
    assert len(host.packets()) == 10 * packets
    assert counts(host) == Counter({name: 10 * rate for name, rate in all_rates.items()})


def test_a_1_hz_battery_is_in_each_100th_packet() -> None:
    host = Host()
    host.wait(5.0)
    places = [index for index, packet in enumerate(host.packets()) if packet.battery]
    assert [after - before for before, after in pairwise(places)] == [100] * 4


def test_packets_are_evenly_spaced() -> None:
    host = Host()
    host.wait(1.0, step=0.001)
    times = [time for time, _ in host.frames]
    gaps = {round(b - a, 6) for a, b in pairwise(times)}
    assert gaps == {0.01}


def test_rates_command_of_3_1_code_0() -> None:
    host = Host(firmware="3.1")
    assert host.ask(SetTelemetryRates({"time": 1, "rc": 0, "control_device": 10})) == 0
    host.frames.clear()
    host.wait(10.0)
    found = counts(host)
    assert (found["time"], found["rc"], found["control_device"]) == (10, 0, 100)
    assert found["velocity"] == 1000, "not named, so kept"


def test_r1_5_keeps_a_rate_and_the_next_package_has_the_others() -> None:
    """As DJI's programs do: bytes without an item mean nothing; it works before activation."""
    host = Host(firmware="3.1")
    host.wait(0.1)
    asked_at = host.now
    without_item = b"\xff\x07\x06\xaa"[: 16 - len(ITEMS)]
    ack = host.ask_raw(b"\x00\x10" + bytes((0, 5)).ljust(len(ITEMS), b"\0") + without_item)
    assert ack is not None
    assert ack.data == b"\x00\x00"
    host.wait(0.5)
    kept = BY_NAME["quaternion"].bit
    assert {packet.flags for packet in host.packets(asked_at)} == {1 << kept}


def test_r1_one_rate_that_does_not_exist_changes_nothing() -> None:
    host = Host(firmware="3.1")
    for place in range(12):
        codes = bytearray(16)
        codes[place] = 6
        ack = host.ask_raw(b"\x00\x10" + codes)
        assert ack is not None
        assert ack.data == b"\x01\x00"
    assert host.autopilot.rates_hz == DEFAULT_RATES_HZ


def test_r1_rates_are_forgotten_at_power_off() -> None:
    host = Host(aircraft(firmware="3.1", assistant={"rates_hz": {"battery": 10}}))
    assert host.ask(SetTelemetryRates({"battery": 50, "time": 1})) == 0
    assert host.autopilot.rates_hz["battery"] == 50
    host.aircraft.reboot()
    host.wait(3.0)
    assert host.autopilot.rates_hz == DEFAULT_RATES_HZ | {"battery": 10}


@pytest.mark.parametrize("firmware", ["1.0", "2.3"])
def test_k1_before_3_1_there_is_no_such_command(firmware: str) -> None:
    ack = Host(firmware=firmware).ask_raw(b"\x00\x10" + bytes(16))
    assert ack is not None
    assert ack.data == b"\x00\xff"


@pytest.mark.parametrize("value", [bytes(15), bytes(17), b"\x06" + bytes(15), b"\xff" * 16])
def test_rates_command_of_3_1_code_1_parameter_error(value: bytes) -> None:
    host = Host(firmware="3.1")
    ack = host.ask_raw(b"\x00\x10" + value)
    assert ack is not None
    assert ack.data == b"\x01\x00"
    assert host.autopilot.rates_hz == DEFAULT_RATES_HZ


@pytest.mark.parametrize("rates", [{"battery": 2}, {"fuel": 1}, {"battery": -1}])
def test_the_assistant_refuses_what_cannot_be(rates: dict[str, int]) -> None:
    with pytest.raises(ValueError, match=r"battery|fuel"):
        AssistantSettings(rates_hz=rates)


# --- tick -----------------------------------------------------------------------------------


@pytest.mark.parametrize(("firmware", "tick_hz"), [("1.0", 600), ("2.3", 600), ("3.1", 400)])
def test_tick_rate(firmware: str, tick_hz: int) -> None:
    host = Host(firmware=firmware)
    host.wait(10.0)
    times = [packet.time for packet in host.packets()]
    first, last = times[0], times[-1]
    assert first is not None
    assert last is not None
    assert last.tick - first.tick == tick_hz * 999 // 100
    assert last.seconds == pytest.approx(10.0)
    if firmware == "3.1":
        assert first.nanoseconds == 10_000_000
        assert last.nanoseconds == 0


# --- layouts --------------------------------------------------------------------------------


@pytest.mark.parametrize(("firmware", "size"), TOTALS.items())
def test_size_with_all_items(firmware: str, size: int) -> None:
    host = Host(aircraft(firmware=firmware, assistant={"rates_hz": ALL}))
    host.wait(0.01)
    (frame,) = [frame for _, frame in host.frames if frame.data[:2] == b"\x02\x00"]
    assert len(frame.data) - 2 == size


def wild(firmware: str, **settings: Any) -> Host:
    """A flight in which no two items are alike."""
    host = Host(aircraft(firmware=firmware, assistant={"rates_hz": ALL}, settings=settings))
    host.ready()
    host.take_off()
    host.fly(NORTH_EAST, 3.0)
    return host


@pytest.mark.parametrize("firmware", PROFILES)
def test_the_quick_encoder_agrees_with_the_ordinary_one(firmware: str) -> None:
    """For every flag word: same bytes as encode_telemetry and encode_frame make."""
    host = wild(firmware)
    sensors, pusher = host.autopilot.vehicle.sensors, host.autopilot._telemetry
    random = Random(3)
    every = host.profile.item_flags
    single = [1 << item.bit for item in ITEMS if every >> item.bit & 1]
    for flags in [every, *single, *random.sample(range(1, every), 200)]:
        names = [item.name for item in ITEMS if flags >> item.bit & 1]
        pusher.set_rates({name: 100 if name in names else 0 for name in BY_NAME})
        sequence = random.randrange(65536)
        items = {}
        for name in names:
            said = dict(zip(BY_NAME[name].fields, sensors.reader(name)(), strict=True))
            items[name] = [said[field] for field in host.profile.items[name].fields]
        value = encode_telemetry(items, host.profile)
        expected = encode_frame(b"\x02\x00" + value, session=0, sequence=sequence)
        assert pusher.frame(sequence) == expected


@pytest.mark.parametrize("firmware", ["1.0", "2.3", "3.1"])
def test_items_say_what_the_aircraft_does(firmware: str) -> None:
    host = wild(firmware)
    packet, motion = host.packets()[-1], host.motion
    attitude, velocity, position = packet.attitude, packet.velocity, packet.position
    assert attitude is not None
    assert velocity is not None
    assert position is not None
    assert attitude.yaw_deg == pytest.approx(math.degrees(motion.yaw), abs=1e-4)
    assert velocity[:3] == pytest.approx(
        (motion.velocity_north, motion.velocity_east, motion.velocity_up), rel=1e-6
    )
    assert velocity.status == {"1.0": None, "2.3": 7, "3.1": 1}[firmware]
    assert position.height_m == pytest.approx(motion.height, rel=1e-6)
    assert position.altitude_m == pytest.approx(motion.height, rel=1e-6)
    assert position.gps_health == 5
    line = Geodesic.WGS84.Inverse(22.5431, 113.9589, position.latitude_deg, position.longitude_deg)
    assert line["s12"] == pytest.approx(math.hypot(motion.north, motion.east), abs=1e-4)
    assert packet.flight_status is not None
    assert packet.flight_status.status == 3
    assert packet.remote_control is not None
    assert packet.remote_control.is_in_f


def test_mode_byte_of_3_1_is_the_number_of_the_control_mode() -> None:
    host = wild("3.1")
    item = host.packets()[-1].control_device
    assert item is not None
    assert item.mode == 3
    host.wait(2.0)
    item = host.packets()[-1].control_device
    assert item is not None
    assert item.mode == 0


def test_document_profile_is_longitude_first_without_health_and_gear() -> None:
    host = wild("1.0-document")
    raw = host.packets()[-1].raw_items()
    assert list(raw["position"]) == ["longitude_rad", "latitude_rad", "altitude", "height"]
    assert raw["position"]["longitude_rad"] == pytest.approx(math.radians(113.9589), abs=1e-4)
    assert list(raw["rc"])[-1] == "mode"


def test_track_velocity_and_acceleration_agree_in_what_is_sent() -> None:
    """Differences of the sent values, at the resolution of their 32-bit floats."""
    host = wild("2.3")
    packets = host.packets(host.now - 3.0)
    for before, after in pairwise(packets):
        v0, v1, a1 = before.velocity, after.velocity, after.acceleration
        p0, p1 = before.position, after.position
        assert v0 is not None
        assert v1 is not None
        assert a1 is not None
        assert p0 is not None
        assert p1 is not None
        changes = v1.north_m_s - v0.north_m_s, v1.east_m_s - v0.east_m_s, v1.up_m_s - v0.up_m_s
        assert changes == pytest.approx([value * 0.01 for value in a1], abs=2e-6)
        assert p1.height_m - p0.height_m == pytest.approx(
            (v0.up_m_s + v1.up_m_s) / 2 * 0.01, abs=2e-6
        )
        north = (p1.latitude_rad - p0.latitude_rad) * 6_344_800
        assert north == pytest.approx((v0.north_m_s + v1.north_m_s) / 2 * 0.01, abs=1e-4)


def test_vertical_values_may_be_sent_positive_downwards() -> None:
    host = wild("1.0", vertical_down=True)
    packet = host.packets()[-1]
    assert packet.velocity is not None
    assert packet.velocity.up_m_s == pytest.approx(-host.motion.velocity_up)
    assert packet.acceleration is not None
    assert host.motion.acceleration_up != 0.0
    assert packet.acceleration.up_m_s2 == pytest.approx(-host.motion.acceleration_up)


def test_without_gps_the_position_is_zero_and_the_velocity_not_valid() -> None:
    host = wild("2.3")
    host.aircraft.gps_health = 0
    host.wait(0.02)
    packet = host.packets()[-1]
    assert packet.position is not None
    assert packet.velocity is not None
    assert packet.position.latitude_rad == packet.position.longitude_rad == 0.0
    assert packet.velocity.status == 0


def test_the_magnetometer_turns_with_the_aircraft() -> None:
    host = Host(aircraft(assistant={"rates_hz": ALL}))
    readings = []
    for heading in (0, 90, 180, -90):
        host.motion.place(0, 0, 0, heading)
        host.wait(0.01)
        reading = host.packets()[-1].magnetometer
        assert reading is not None
        readings.append(reading)
        assert math.hypot(*reading) == pytest.approx(1500, abs=2)
    assert [round(r.x) for r in readings] == [1100, 0, -1100, 0]
    assert [round(r.y) for r in readings] == [0, -1100, 0, 1100]


# --- noise ----------------------------------------------------------------------------------


def test_noise_has_no_bias_and_comes_from_the_seed() -> None:
    hosts = [Host(aircraft(seed=seed, settings={"noise": 1.0})) for seed in (1, 1, 2)]
    values = []
    for host in hosts:
        host.wait(60.0)
        values.append([p.velocity.north_m_s for p in host.packets() if p.velocity])
    assert values[0] == values[1] != values[2]
    assert sum(values[0]) / len(values[0]) == pytest.approx(0.0, abs=0.02)


def test_gusts_push_and_come_from_the_seed() -> None:
    places = []
    for seed in (1, 1, 2):
        host = Host(aircraft(seed=seed, settings={"gusts": 3.0})).flying()
        host.wait(20.0)
        places.append((host.motion.north, host.motion.east))
    assert places[0] == places[1] != places[2]
    assert 0.001 < math.hypot(*places[0]) < 3.0


# --- nobody listens -------------------------------------------------------------------------


def test_what_nobody_fetches_is_bounded() -> None:
    autopilot = VirtualAircraft().autopilot
    for second in range(120):
        autopilot.advance(float(second))
    frames = autopilot.frames_to_send()
    assert len(frames) == Autopilot.OUTBOX_LIMIT
    assert autopilot.counters.dropped_frames == 119 * 100 - Autopilot.OUTBOX_LIMIT


def test_is_telemetry_tells_pushes_from_the_rest() -> None:
    host = Host()
    host.autopilot.advance(0.01)
    (push,) = host.autopilot.frames_to_send()
    assert is_telemetry(push)
    assert not is_telemetry(encode_frame(b"\x02\x01\x04", session=0, sequence=1))
    assert not is_telemetry(encode_frame(b"\x02\x00\x04", session=2, sequence=1))
    assert not is_telemetry(encode_frame(b"\x02\x00", session=0, sequence=1, is_ack=True))
    (frame,) = FrameDecoder().feed(push)
    TelemetryPacket(frame.data[2:], host.profile)
