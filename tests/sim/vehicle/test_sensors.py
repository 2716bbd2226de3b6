"""What the aircraft believes about itself, with errors that wander as those of a real one."""

from __future__ import annotations

import itertools
import math
import statistics
from collections.abc import Iterator
from random import Random

import pytest

from m100link.protocol import Attitude
from m100link.protocol.firmware import PROFILES, profile
from m100link.protocol.items import BY_NAME
from m100link.protocol.records import FlightPhase
from m100link.sim import AircraftSettings, Vehicle
from m100link.sim.vehicle.dynamics import STEPS_PER_SECOND


def make(noise: float = 1.0, seed: int = 1, firmware: str = "2.3") -> Vehicle:
    return Vehicle(Random(seed), profile(firmware), settings=AircraftSettings(noise=noise))


def read(vehicle: Vehicle, name: str) -> tuple[float, ...]:
    return vehicle.sensors.reader(name)()


def watch(vehicle: Vehicle, name: str, seconds: float) -> Iterator[tuple[float, ...]]:
    """One reading per step."""
    for _ in range(round(seconds * STEPS_PER_SECOND)):
        vehicle.step()
        yield read(vehicle, name)


def take_off(vehicle: Vehicle) -> None:
    vehicle.flight.take_off()
    for _ in range(8 * STEPS_PER_SECOND):
        vehicle.step()
    assert vehicle.flight.phase is FlightPhase.IN_AIR


@pytest.mark.parametrize("firmware", PROFILES)
def test_every_item_of_every_firmware_can_be_read(firmware: str) -> None:
    vehicle = make(firmware=firmware)
    for name in vehicle.profile.items:
        assert len(read(vehicle, name)) == len(BY_NAME[name].fields)


@pytest.mark.parametrize(("scale", "health"), [(1.0, 5), (2.0, 5), (1.0, 2)])
def test_fused_values_wander_with_their_deviation(scale: float, health: int) -> None:
    vehicle = make(scale)
    vehicle.set_gps_health(health)
    vehicle.flight.start_motors()
    north, height, climb, heading = [], [], [], []
    for _ in range(60_000):  # fifty minutes of wandering, standing still
        vehicle.sensors.advance()
        position = read(vehicle, "position")
        north.append((position[0] - math.radians(22.5431)) * 6_344_800)
        height.append(position[3])
        climb.append(read(vehicle, "velocity")[2])
        heading.append(Attitude(*read(vehicle, "quaternion")).yaw_deg)
    worse = 20.0 if health < 3 else 1.0
    assert statistics.pstdev(north) == pytest.approx(0.2 * scale * worse, rel=0.3)
    assert statistics.pstdev(height) == pytest.approx(0.03 * scale, rel=0.5)
    assert statistics.pstdev(climb) == pytest.approx(0.03 * scale, rel=0.1)
    assert statistics.pstdev(heading) == pytest.approx(0.6 * scale, rel=0.3)
    steps = [abs(after - before) for before, after in itertools.pairwise(north)]
    assert max(steps) < 0.1 * scale * worse, "no jumps"


@pytest.mark.parametrize(
    ("item", "deviation"), [("acceleration", 0.05), ("angular_velocity", 0.005)]
)
def test_inertial_sensors_are_noisy_from_sample_to_sample(item: str, deviation: float) -> None:
    values = [reading[2] for reading in watch(make(), item, 20.0)]
    assert statistics.pstdev(values) == pytest.approx(deviation, rel=0.1)
    assert statistics.correlation(values[:-1], values[1:]) == pytest.approx(0.0, abs=0.1)


def test_the_magnetometer_wanders_around_the_field() -> None:
    vehicle = make()
    readings = []
    for _ in range(20_000):
        vehicle.sensors.advance()
        readings.append(read(vehicle, "magnetometer"))
    assert statistics.fmean(reading[0] for reading in readings) == pytest.approx(1100, abs=3)
    assert statistics.pstdev(reading[0] for reading in readings) == pytest.approx(6.0, rel=0.3)
    assert max(abs(a[0] - b[0]) for a, b in itertools.pairwise(readings)) <= 4


def test_without_noise_readings_are_exact() -> None:
    vehicle = make(0.0)
    take_off(vehicle)
    motion = vehicle.flight.dynamics
    assert read(vehicle, "velocity")[2] == motion.velocity_up
    assert read(vehicle, "position")[3] == motion.height
    assert read(vehicle, "quaternion") == pytest.approx(motion.quaternion())


@pytest.mark.parametrize("seed", range(5))
def test_djis_take_off_check_ends(seed: int) -> None:
    """OSDK 3.3 and 3.8 wait until the altitude changes by less than 9 mm in three seconds."""
    vehicle = make(seed=seed)
    take_off(vehicle)
    altitudes = [position[2] for position in watch(vehicle, "position", 15.0)][::300]
    changes = [abs(after - before) for before, after in itertools.pairwise(altitudes)]
    assert min(changes) < 0.009


def test_djis_landing_check_ends() -> None:
    """They wait until the altitude is exactly 0."""
    vehicle = make()
    assert read(vehicle, "position")[2:4] == (0.0, 0.0)
    take_off(vehicle)
    assert read(vehicle, "position")[2] != 0.0
    vehicle.flight.land()
    *_, position = watch(vehicle, "position", 12.0)
    assert vehicle.flight.phase is FlightPhase.STANDBY
    assert position[2:4] == (0.0, 0.0)


def test_the_ground_has_the_altitude_of_the_settings() -> None:
    settings = AircraftSettings(ground_altitude=12.0)
    vehicle = Vehicle(Random(1), profile("3.1"), settings=settings)
    assert read(vehicle, "position")[2:4] == (12.0, 0.0)


@pytest.mark.parametrize("noise", [0.0, 1.0])
@pytest.mark.parametrize("rate", [-100.0, 100.0])
def test_the_quaternion_does_not_jump_when_the_heading_passes_south(
    noise: float, rate: float
) -> None:
    vehicle = make(noise)
    take_off(vehicle)
    vehicle.remote.move_stick(yaw=rate / 100.0)
    readings = list(watch(vehicle, "quaternion", 15.0))  # four turns
    steps = [math.dist(before, after) for before, after in itertools.pairwise(readings)]
    assert max(steps) < 0.02
    assert min(reading[0] for reading in readings) < -0.9, "two turns are one turn of q"
