"""An aircraft without a line: it flies, obeys and decides, and nobody is connected."""

from __future__ import annotations

import math
from random import Random
from types import SimpleNamespace
from typing import Any, cast

import pytest

from m100link.protocol import AuthorityCode, Setpoint, profile
from m100link.protocol.records import Device, FlightPhase, RcMode
from m100link.sim import AircraftSettings, AssistantSettings, Vehicle
from m100link.sim.vehicle.dynamics import STEPS_PER_SECOND


def make(seed: int = 1, settings: AircraftSettings | None = None) -> Vehicle:
    return Vehicle(Random(seed), profile("1.0"), settings=settings)


def fly(vehicle: Vehicle, seconds: float) -> None:
    for _ in range(round(seconds * STEPS_PER_SECOND)):
        vehicle.step()


def airborne(settings: AircraftSettings | None = None) -> Vehicle:
    vehicle = make(settings=settings)
    assert vehicle.request_authority(True) == AuthorityCode.OBTAINED
    vehicle.flight.take_off()
    fly(vehicle, 8.0)
    assert vehicle.flight.phase is FlightPhase.IN_AIR
    return vehicle


def test_it_flies_without_a_line() -> None:
    vehicle = airborne()
    north = Setpoint.velocity(north=2.0, east=0.0, up=0.0, yaw_rate_deg_s=0.0)
    for _ in range(150):
        assert vehicle.flight.move(north)
        fly(vehicle, 0.02)
    assert vehicle.flight.dynamics.north == pytest.approx(4.5, abs=1.5)
    assert vehicle.time == pytest.approx(11.0)


def test_a_loss_of_authority_is_counted_and_ends_what_the_onboard_device_wanted() -> None:
    vehicle = airborne()
    vehicle.flight.move(Setpoint.velocity(north=2.0, east=0.0, up=0.0, yaw_rate_deg_s=0.0))
    vehicle.remote.set_mode(RcMode.P)
    vehicle.refresh()
    assert vehicle.authority_losses == 1
    assert vehicle.authority.device is Device.RC
    assert vehicle.flight.setpoint is None
    fly(vehicle, 1.0)
    assert vehicle.authority_losses == 1


@pytest.mark.parametrize("flies_on", [False, True])
@pytest.mark.parametrize("is_failsafe", [False, True])
def test_only_a_mission_that_may_fly_without_a_remote_outlives_the_failsafe(
    is_failsafe: bool, flies_on: bool
) -> None:
    """Every other change of control ends what the onboard device wanted, a mission too."""
    vehicle = airborne()
    vehicle.flight.move(Setpoint.velocity(north=2.0, east=0.0, up=0.0, yaw_rate_deg_s=0.0))
    vehicle.missions.running = cast(Any, SimpleNamespace(flies_without_rc=flies_on))
    before = vehicle.flight.interruptions
    if is_failsafe:
        vehicle.authority.failsafe = True
    else:
        vehicle.remote.set_mode(RcMode.P)
    vehicle.refresh()
    assert vehicle.authority.device is Device.RC
    assert vehicle.authority_losses == 1
    goes_on = is_failsafe and flies_on
    assert (vehicle.flight.setpoint is not None) is goes_on
    assert vehicle.flight.interruptions - before == (0 if goes_on else 1)


def test_equal_seeds_give_equal_weather_and_measurements() -> None:
    def run(seed: int) -> list[float]:
        vehicle = make(seed, AircraftSettings(gusts=2.0, noise=1.0))
        vehicle.flight.take_off()
        fly(vehicle, 6.0)
        return [vehicle.flight.dynamics.north, *vehicle.sensors.reader("position")()]

    assert run(3) == run(3)
    assert run(3) != run(4)


def test_a_restart_is_silent_and_forgets_who_was_in_control() -> None:
    vehicle = airborne(AircraftSettings(reboot_seconds=2.0))
    height = vehicle.flight.dynamics.height
    vehicle.restart()
    silent = vehicle.is_restarting
    assert silent
    assert not vehicle.authority.is_requested
    fly(vehicle, 2.1)
    silent = vehicle.is_restarting
    assert not silent
    assert vehicle.flight.dynamics.height == pytest.approx(height, abs=0.1)
    assert vehicle.authority_losses == 0  # nobody is left to hear it


def test_settings_of_the_assistant_take_effect_at_once() -> None:
    vehicle = airborne()
    vehicle.configure(AssistantSettings(api_control_enabled=False))
    assert vehicle.authority.device is Device.RC
    assert vehicle.authority_losses == 1


@pytest.mark.parametrize(
    ("kind", "settings", "words"),
    [
        (AssistantSettings, {"rates_hz": {"wings": 1}}, "no telemetry item is called 'wings'"),
        (AssistantSettings, {"rates_hz": {"velocity": 3}}, "velocity cannot be sent at 3 Hz"),
        (AssistantSettings, {"baud_rate": 0}, "0 baud carries nothing"),
        (AssistantSettings, {"acceleration": "felt"}, "not 'felt'"),
        (AircraftSettings, {"heading_deg": math.nan}, "heading_deg is finite, not nan"),
        (AircraftSettings, {"wind_east": -math.inf}, "wind_east is finite, not -inf"),
    ],
)
def test_settings_that_no_aircraft_has_are_refused(kind: Any, settings: Any, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        kind(**settings)


def test_gusts_are_drawn_every_50_ms_and_remembered_for_two_seconds() -> None:
    vehicle = make(settings=AircraftSettings(gusts=2.0, wind_north=3.0, wind_east=-1.0))
    draws = iter((1.0, -0.5, 0.0, 0.0))
    vehicle._random = cast(Any, SimpleNamespace(gauss=lambda mean, deviation: next(draws)))
    keep = math.exp(-0.05 / 2.0)
    kick = 2.0 * math.sqrt(1.0 - keep**2)
    for share in (1.0, keep):
        vehicle._blow()
        motion = vehicle.flight.dynamics
        wind = (3.0 + share * kick, -1.0 - 0.5 * share * kick)
        assert (motion.wind_north, motion.wind_east) == pytest.approx(wind)


def test_gps_comes_after_a_cold_start_unless_set_by_hand() -> None:
    vehicle = make()
    vehicle.search_gps(3.0)
    fly(vehicle, 2.9)
    assert vehicle.flight.gps_health == 0
    fly(vehicle, 0.2)
    assert vehicle.flight.gps_health == 5
    vehicle.search_gps(3.0)
    vehicle.set_gps_health(2)
    fly(vehicle, 4.0)
    assert vehicle.flight.gps_health == 2
    with pytest.raises(ValueError, match="0 to 5"):
        vehicle.set_gps_health(6)
