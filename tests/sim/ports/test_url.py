from __future__ import annotations

import asyncio

import pytest

import m100link
from m100link import BadURL, UsageError, sync
from m100link.sim import LockstepEventLoop, ScaledEventLoop, VirtualClockEventLoop, loop_factory
from m100link.sim.line import LineFaults
from m100link.sim.ports.url import (
    LINE_OPTIONS,
    MISSION_OPTIONS,
    SITE_OPTIONS,
    aircraft_of,
    clock_of,
    speed_of,
)
from m100link.sim.vehicle.settings import AircraftSettings


def test_every_option_arrives_where_it_belongs() -> None:
    aircraft = aircraft_of(
        "sim://?firmware=3.1&seed=7&cold&level=1&app-id=5&baud=115200"
        "&loss=0.25&line-baud=57600&radio=1&noise=2"
        "&latitude=-33.5&wind_north=-3&sensor-noise=0.5&gimbal-follows=yes"
    )
    assert aircraft.seed == 7
    assert aircraft.vehicle.profile.name == "3.1"
    assert (aircraft.credentials.app_id, aircraft.credentials.level) == (5, 1)
    assert not aircraft.app.is_connected
    assert aircraft.vehicle.assistant.baud_rate == 115_200
    assert aircraft.line.to_host.faults == LineFaults(
        loss=0.25, baud_rate=57_600, radio=True, noise=2.0
    )
    settings = aircraft.vehicle.settings
    assert (settings.latitude_deg, settings.wind_north, settings.noise) == (-33.5, -3.0, 0.5)
    assert settings.gimbal_follows


def test_without_options_it_is_the_aircraft_by_default() -> None:
    aircraft = aircraft_of("sim://")
    assert aircraft.vehicle.settings == AircraftSettings()
    assert aircraft.line.to_host.faults == LineFaults()
    assert aircraft.app.is_connected


def test_options_of_missions() -> None:
    url = (
        "sim://?firmware=3.1&mission-status-hz=2&mission-takes-off=0&hotpoint-acks&radius-limit=90"
    )
    missions = aircraft_of(url).vehicle.settings.missions
    assert (missions.status_hz, missions.takes_off_by_itself) == (2.0, False)
    assert (missions.hotpoint_acks, missions.radius_limit) == (True, 90.0)
    with pytest.raises(BadURL, match="0 to 100 Hz"):
        aircraft_of("sim://?mission-status-hz=101")


def test_no_two_options_have_the_same_name() -> None:
    names = [*LINE_OPTIONS.values(), *SITE_OPTIONS.values(), *MISSION_OPTIONS.values()]
    assert len(names) == len(set(names))


@pytest.mark.parametrize(
    ("query", "words"),
    [
        ("sped=10", "no option 'sped'; it has activated, "),
        ("seed=x", "seed is a number"),
        ("loss=much", "loss is a number"),
        ("loss=2", "loss is 0 to 1"),
        ("cold=maybe", "cold is 1 or 0"),
        ("firmware=9", "no firmware profile"),
        ("key=short", "key"),
        ("level=7", "level"),
    ],
)
def test_what_cannot_be_is_refused_with_an_example(query: str, words: str) -> None:
    with pytest.raises((BadURL, m100link.M100Error), match=words) as caught:
        aircraft_of(f"sim://?{query}")
    assert isinstance(caught.value, m100link.M100Error)
    assert caught.value.remedy


@pytest.mark.parametrize("speed", ["0", "-1", "fast", "nan"])
def test_a_speed_is_a_number_above_zero_or_max(speed: str) -> None:
    with pytest.raises(BadURL, match="speed is a number above 0, or max"):
        speed_of(f"sim://?speed={speed}")


def test_the_clock_that_a_url_asks_for() -> None:
    assert clock_of("sim://") is clock_of("/dev/ttyUSB0") is clock_of(object()) is None
    assert clock_of("sim://?speed=max") is LockstepEventLoop
    made = clock_of("sim://?speed=4")
    assert made is not None
    loop = made()
    assert isinstance(loop, ScaledEventLoop)
    assert loop.speed == 4.0
    loop.close()


def test_a_speed_that_the_event_loop_does_not_have_is_refused() -> None:
    async def connect() -> None:
        async with m100link.connect("sim://?speed=8"):
            pass

    with pytest.raises(UsageError, match="asks for a speed of 8") as caught:
        asyncio.run(connect())
    assert "loop_factory" in caught.value.remedy
    virtual = asyncio.Runner(loop_factory=VirtualClockEventLoop)
    with virtual, pytest.raises(UsageError, match="passes at inf"):
        virtual.run(connect())
    with asyncio.Runner(loop_factory=loop_factory(8.0)) as scaled:
        scaled.run(connect())


def test_without_await_the_speed_is_had() -> None:
    with sync.connect("sim://?speed=max") as aircraft:
        aircraft.activate(m100link.Credentials(app_id=10086, key=bytes(range(32))))
        with aircraft.control() as control:
            control.take_off()
            arrival = control.fly_to(north=50.0, east=0.0, up=0.0)
            control.land()
    assert arrival.elapsed > 5
