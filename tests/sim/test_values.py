"""A line by chances that the test draws, pushes at their times, and the state that orders show.

8N1 is ten bits per byte. A byte that is late by half a second is dropped, telemetry that would wait
20 ms is not sent, and the radios of the document's quick start turn round in 2 ms.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from random import Random
from typing import Any, cast

import pytest

from m100link.protocol.commands.monitor import AuthorityChanged, FromMobile
from m100link.sim import NO_FAULTS, AircraftSettings, Line, LineFaults
from m100link.sim.fit import FlightRecording
from m100link.sim.line import LineDirection, TelemetryPusher, split_frames
from m100link.sim.orders import perform, status
from m100link.wire import FrameDecoder, encode_frame
from tests import limits
from tests.sim.host import Host


class Chance:
    """Draws the given numbers in order; a quarter of a second lies between two bursts of noise."""

    def __init__(self, shares: Iterable[float] = (), whole: Iterable[int] = ()) -> None:
        self.shares, self.whole = list(shares), list(whole)
        self.asked: list[tuple[int, ...]] = []

    def random(self) -> float:
        return self.shares.pop(0)

    def randint(self, low: int, high: int) -> int:
        self.asked.append((low, high))
        return self.whole.pop(0)

    def randrange(self, end: int) -> int:
        self.asked.append((end,))
        return self.whole.pop(0)

    def randbytes(self, count: int) -> bytes:
        return b"\x55" * count

    def expovariate(self, rate: float) -> float:
        return 1.0 / rate


def direction(chance: Chance, port: int | None = None, **faults: Any) -> LineDirection:
    return LineDirection(cast(Random, chance), LineFaults(**faults), baud_rate=port)


def arrivals(line: LineDirection) -> Any:
    return [(pytest.approx(at), piece) for at, piece in line._waiting]


# -- a line ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("faults", "shares", "arrive", "counts"),
    [
        # Chances are asked for in this order: loss, damage, twice, then jitter of each.
        ({"loss": 0.25}, [0.24], [], (1, 1, 0, 0)),
        ({"loss": 0.25}, [0.25], [7.0], (1, 0, 0, 0)),
        ({"duplicate": 0.5}, [0.49], [7.0, 7.0], (1, 0, 0, 1)),
        ({"duplicate": 0.5}, [0.5], [7.0], (1, 0, 0, 0)),
        ({"delay": 1.5}, [], [8.5], (1, 0, 0, 0)),
        ({"jitter": 0.2}, [0.75], [7.15], (1, 0, 0, 0)),
        ({"delay": 1.5, "jitter": 0.2}, [0.25], [8.55], (1, 0, 0, 0)),
        # The second copy draws less, and does not overtake the first.
        ({"duplicate": 0.5, "jitter": 0.2}, [0.1, 0.75, 0.25], [7.15, 7.15], (1, 0, 0, 1)),
        ({"baud_rate": 1000}, [], [7.1], (1, 0, 0, 0)),
        ({"baud_rate": 1000, "duplicate": 1.0}, [0.9], [7.1, 7.2], (1, 0, 0, 1)),
    ],
)
def test_a_frame_arrives_as_its_chances_say(
    faults: dict[str, Any],
    shares: list[float],
    arrive: list[float],
    counts: tuple[int, ...],
) -> None:
    chance = Chance(shares)
    line = direction(chance, **faults)
    line.put(b"0123456789", 7.0)
    assert [(at, b"0123456789") for at in arrive] == arrivals(line)
    assert (line.frames, line.lost, line.damaged, line.duplicated) == counts
    assert chance.shares == []


def test_damage_flips_one_to_four_bits_anywhere() -> None:
    chance = Chance([0.1], [3, 0, 15, 9])  # three of them: bits 0, 15 and 9 of 24
    line = direction(chance, damage=0.5)
    line.put(b"\x00\x00\x00", 0.0)
    assert line.take(0.0) == [b"\x01\x82\x00"]
    assert chance.asked == [(1, 4), (24,), (24,), (24,)]
    assert line.damaged == 1


def test_an_inverted_line_is_read_inverted_and_repeats_as_it_does() -> None:
    line = direction(Chance([0.0]), inverted=True, duplicate=0.5)
    line.put(b"\xaa\x0c\x00", 0.0)
    first, second = line.take(0.0)
    assert first == second
    assert first != b"\xaa\x0c\x00"


@pytest.mark.parametrize(
    ("own", "faults", "sent_by"),
    [
        (None, {}, None),
        (10_000, {}, 0.01),
        (10_000, {"baud_rate": 1000}, 0.1),  # the slowest counts
        (1000, {"baud_rate": 10_000}, 0.1),
        (None, {"radio": True}, 100 / 230_400),
        (None, {"radio": True, "baud_rate": 460_800}, 100 / 230_400),
    ],
)
def test_ten_bits_per_byte_at_the_slowest_rate(
    own: int | None, faults: dict[str, Any], sent_by: float | None
) -> None:
    line = direction(Chance(), own, **faults)
    line.put(b"0123456789", 3.0)
    assert arrivals(line) == [(3.0 + (sent_by or 0.0), b"0123456789")]
    assert line.busy_until == (-math.inf if sent_by is None else pytest.approx(3.0 + sent_by))


def test_what_would_wait_longer_than_half_a_second_is_dropped() -> None:
    line = direction(Chance(), 800)
    for _ in range(7):  # an eighth of a second each: the fifth begins after half a second
        line.put(b"0123456789", 2.0)
    assert (line.lost, len(line._waiting), line.busy_until) == (2, 5, 2.625)
    line.put(b"0123456789", 2.125)
    assert (line.lost, line.busy_until) == (2, 2.75)


@pytest.mark.parametrize(
    ("now", "chance", "arrives"),
    [
        (0.9, [0.49], None),  # the other side transmits until 1.0: half is lost
        (0.9, [0.5], 1.002),
        (1.0, [], 1.0),
        (0.4, [0.9], None),  # it would wait longer than half a second
    ],
)
def test_a_radio_hears_while_it_does_not_speak(
    now: float, chance: list[float], arrives: float | None
) -> None:
    other = direction(Chance())
    other.busy_until = 1.0
    line = direction(Chance(chance), radio=True)
    line.put(b"0123456789", now, other)
    took = 100 / 230_400
    wanted = [] if arrives is None else [(arrives + took, b"0123456789")]
    assert (arrivals(line), line.lost) == (wanted, int(arrives is None))


def test_a_stalled_line_keeps_51_pieces() -> None:
    line = direction(Chance())
    line.is_stalled = True
    for _ in range(60):
        line.put(b"x", 0.0)
    assert (len(line._waiting), line.lost, line.take(9.0)) == (51, 9, [])
    assert line.next_wakeup() is None
    line.is_cut = True
    line.put(b"x", 0.0)
    assert (len(line._waiting), line.lost) == (51, 10)


def test_noise_comes_between_frames_in_order_of_time() -> None:
    """At four a second, the first a quarter of a second after the line was looked at."""
    chance = Chance([], [3, 16])
    line = direction(chance, noise=4.0, noise_bytes=16, delay=0.3)
    assert line.take(10.0) == []
    assert line.next_wakeup() == 10.25
    line.put(b"early", 9.9)
    line.put(b"late", 10.1)
    assert line.next_wakeup() == pytest.approx(10.2)
    assert line.take(10.19) == []
    assert line.take(10.51) == [b"early", b"\x55" * 3, b"late", b"\x55" * 16]
    assert chance.asked == [(1, 16), (1, 16)]
    line.faults = NO_FAULTS
    assert (line.take(99.0), line.next_wakeup()) == ([], None)


def test_a_pulled_plug_forgets_what_is_under_way_and_how_late_it_was() -> None:
    line = direction(Chance(), 1000, delay=5.0)
    line.put(b"0123456789", 0.0)
    line.clear()
    assert (line.lost, line.take(99.0)) == (1, [])
    line.faults = LineFaults(delay=1.0)
    line.put(b"0123456789", 0.0)
    assert arrivals(line) == [(1.1, b"0123456789")]


def test_telemetry_does_not_wait_20_ms_and_answers_do() -> None:
    line = Line(Random(1), baud_rate=10_000)
    telemetry = encode_frame(b"\x02\x00" + bytes(2), session=0, sequence=1)
    answer = encode_frame(b"\x00\x00", session=2, sequence=1, is_ack=True)
    assert (len(telemetry), len(answer)) == (20, 18)
    assert line.from_aircraft([telemetry], 1.0) == []  # 20 ms
    line.from_aircraft([telemetry], 1.0)
    line.from_aircraft([telemetry], 1.0)  # would begin 40 ms from now
    assert (line.skipped, line.to_host.frames) == (1, 2)
    line.from_aircraft([answer], 1.0)
    assert (line.skipped, line.to_host.frames) == (1, 3)
    assert line.from_aircraft([], 1.0579) == [telemetry, telemetry]
    assert line.from_aircraft([], 1.0581) == [answer]
    assert line.next_wakeup() is None


@pytest.mark.parametrize(
    ("faults", "cuts_host", "cuts_aircraft"), [("mute", True, False), ("deaf", False, True)]
)
def test_one_wire_may_carry_nothing(faults: str, cuts_host: bool, cuts_aircraft: bool) -> None:
    line = Line(Random(1), LineFaults(**{faults: True}))
    assert (line.from_aircraft([b"a"], 0.0) == []) is cuts_host
    assert (line.from_host(b"b", 0.0) == []) is cuts_aircraft
    line.set_faults()
    assert (line.from_aircraft([b"a"], 0.0), line.from_host(b"b", 0.0)) == ([b"a"], [b"b"])
    line.set_faults(LineFaults(delay=1.0), to_aircraft=LineFaults(delay=2.0))
    assert (line.from_aircraft([b"a"], 0.0), line.from_host(b"b", 0.0)) == ([], [])
    assert line.next_wakeup() == 1.0
    assert (line.from_aircraft([], 1.0), line.next_wakeup()) == ([b"a"], 2.0)
    line.stall(to_host=True, to_aircraft=False)
    assert (line.to_host.is_stalled, line.to_aircraft.is_stalled) == (True, False)


def test_a_frame_is_cut_by_the_ten_bits_of_its_length() -> None:
    long = encode_frame(bytes(600), session=0, sequence=1)
    assert len(long) == 616
    assert split_frames(long + long + b"\xaa") == [long, long, b"\xaa"]
    version = long[:2] + bytes([long[2] | 0xFC]) + long[3:]  # the other six bits say something else
    assert split_frames(version) == [version]
    assert split_frames(version + b"\xaa") == [version, b"\xaa"]


# -- pushes ---------------------------------------------------------------------------------------


def pushed(host: Host, address: bytes) -> list[tuple[float, bytes]]:
    found = [one for one in host.frames if one.frame.data[:2] == address and not one.frame.is_ack]
    return [(round(one.time, 2), one.frame.data[2:]) for one in found]


def test_messages_of_the_app_come_in_pieces_of_100_at_1000_bytes_a_second() -> None:
    host = Host()
    host.wait(1.0)
    host.aircraft.send_from_mobile(bytes(range(250)))
    host.wait(0.5)
    pieces = pushed(host, bytes(FromMobile.ADDRESS))
    assert b"".join(data for _, data in pieces) == bytes(range(250))
    assert [len(data) for _, data in pieces] == [100, 100, 50]
    assert [at for at, _ in pieces] == pytest.approx([1.01, 1.11, 1.21], abs=0.011)
    host.aircraft.send_from_mobile(bytes(100))
    host.aircraft.send_from_mobile(bytes(1))
    host.aircraft.reboot()
    host.wait(3.0)
    assert len(pushed(host, bytes(FromMobile.ADDRESS))) == 3, "a restart forgets them"
    host.aircraft.send_from_mobile(b"again")
    host.wait(0.02)
    [(at, data)] = pushed(host, bytes(FromMobile.ADDRESS))[3:]
    assert data == b"again"
    assert at == pytest.approx(4.51, abs=0.011)


@pytest.mark.parametrize(
    ("session", "times"),
    [(0, 1), (2, 10)],  # repeated each half a second until it is acknowledged
)
def test_the_loss_of_authority_is_told_once_or_ten_times(session: int, times: int) -> None:
    host = Host(settings=AircraftSettings(authority_push_session=session)).flying()
    began = host.now
    host.aircraft.leave_f()
    host.wait(8.0, step=0.05)
    told = pushed(host, bytes(AuthorityChanged.ADDRESS))
    assert [data for _, data in told] == [b"\x04"] * times
    assert [at - began for at, _ in told] == pytest.approx(
        [0.5 * number for number in range(times)], abs=0.06
    )


def test_what_nobody_fetches_is_4096_frames_and_counted() -> None:
    host = Host()
    host.autopilot.advance(50.0)
    assert len(host.autopilot.frames_to_send()) == 4096
    assert host.autopilot.counters.dropped_frames == 5000 - 4096
    assert host.autopilot.next_wakeup() == pytest.approx(50.01)
    host.autopilot.skip(90.0)
    assert host.autopilot.next_wakeup() == pytest.approx(90.01)


@pytest.mark.parametrize(
    ("rates", "ticks"),
    [
        ({"time": 100}, range(100)),
        ({"time": 50}, range(0, 100, 2)),
        ({"time": 10, "battery": 0}, range(0, 100, 10)),
        ({"battery": 1}, [0]),
        ({"rc": 0}, []),
    ],
)
def test_a_rate_is_so_many_packages_in_the_hundred_steps_of_a_second(
    rates: dict[str, int], ticks: Iterable[int]
) -> None:
    vehicle = Host().vehicle
    pusher = TelemetryPusher(vehicle.profile, vehicle.sensors, rates)
    sent = []
    for vehicle.sensors.ticks in range(100, 200):
        if pusher.frame(7) is not None:
            sent.append(vehicle.sensors.ticks - 100)
    assert sent == list(ticks)
    assert pusher.packets == len(sent)
    pusher.set_rates({"time": 0, "battery": 0, "gimbal": 1})
    vehicle.sensors.ticks = 300
    made = pusher.frame(7)
    assert made is not None
    [frame] = FrameDecoder().feed(made)
    assert (frame.sequence, frame.session, frame.data[:2]) == (7, 0, b"\x02\x00")


# -- what an order shows and does -----------------------------------------------------------------


def test_the_status_has_each_value_in_its_place() -> None:
    host = Host(seed=7, firmware="3.1").flying()
    motion = host.vehicle.flight.dynamics
    motion.place(30.12345, -40.54321, 12.98765, yaw_deg=-90.0)
    motion.velocity_north, motion.velocity_east, motion.velocity_up = 1.23456, -2.34567, 0.45678
    host.vehicle.flight.battery_percent = 61.26
    line = host.aircraft.line
    line.to_host.frames, line.to_host.lost, line.to_aircraft.lost = 70, 3, 4
    perform(host.aircraft, "gps 4")
    shown = status(host.aircraft)
    assert {name: shown[name] for name in ("height", "north", "east", "heading_deg")} == {
        **{"height": 12.988, "north": 30.123, "east": -40.543, "heading_deg": -90.0}
    }
    assert shown["velocity"] == [1.235, -2.346, 0.457]
    assert {
        name: shown[name]
        for name in ("firmware", "seed", "battery_percent", "gps_health", "rc_mode", "control")
    } == {
        **{"firmware": "3.1", "seed": 7, "battery_percent": 61.3, "gps_health": 4},
        **{"rc_mode": "F", "control": "onboard"},
    }
    assert (shown["frames_sent"], shown["frames_lost"]) == (70, 7)
    flags = ("motors_on", "rc_is_on", "app_connected", "app_has_internet", "plugged")
    assert [shown[name] for name in flags] == [True] * 5
    assert shown["activated_app"] == host.aircraft.credentials.app_id
    assert shown["time"] == pytest.approx(host.now, abs=0.011)
    perform(host.aircraft, "wind 3.5 -2.25")
    assert (host.vehicle.settings.wind_north, host.vehicle.settings.wind_east) == (3.5, -2.25)


def test_a_recording_holds_nothing_of_another() -> None:
    one, two = FlightRecording(name="one"), FlightRecording(name="two")
    one.attitude.append((0.0, 0.0, 0.0, 0.0))
    assert two.attitude == []


def test_each_limit_is_as_agreed() -> None:
    assert limits.differences("sim") == []
