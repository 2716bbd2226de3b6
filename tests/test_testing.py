"""The fixtures of :mod:`m100link.testing`."""

from __future__ import annotations

import asyncio
import contextlib
import math
import re
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from unittest.mock import MagicMock

import pytest
import serial

from m100link import errors, testing
from m100link.protocol import Setpoint
from m100link.sim import LineFaults, VirtualClockEventLoop
from m100link.testing import ConnectableAircraft, VirtualClock, VirtualPort, VirtualSerialPair
from tests.waiting import PATIENCE

PAGE = Path(__file__).parent.parent / "docs" / "howto" / "test-your-program.md"
NORTH = Setpoint.velocity(north=1.0, east=0.0, up=0.0, yaw_rate_deg_s=0.0)


def test_without_pytest_it_says_what_it_needs() -> None:
    # A module that is None cannot be imported, as one that is not installed.
    program = (
        "import sys, runpy; sys.modules['pytest'] = None\n"
        "runpy.run_module('m100link.testing', run_name='__main__')"
    )
    ended = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=False
    )
    assert ended.returncode == 1
    assert ended.stdout == ""
    assert ended.stderr.endswith(
        "ModuleNotFoundError: m100link.testing is fixtures for pytest, which is not installed\n"
        "  what to do:   pip install pytest\n"
    )


def test_run_as_a_program_it_says_how_it_is_used() -> None:
    ended = subprocess.run(
        [sys.executable, "-W", "error", "-m", "m100link.testing"],
        capture_output=True,
        text=True,
        check=True,
    )
    assert "pytest_plugins" in ended.stdout


@pytest.mark.anyio
async def test_virtual_clock_runs_the_test_on_virtual_time(virtual_clock: VirtualClock) -> None:
    assert isinstance(asyncio.get_running_loop(), VirtualClockEventLoop)
    await virtual_clock.sleep_until(3600.0)
    assert virtual_clock.now == pytest.approx(3600.0)
    await virtual_clock.sleep_until(5.0)
    assert virtual_clock.now == pytest.approx(3600.0)


@pytest.mark.anyio
async def test_without_it_time_is_real() -> None:
    assert not isinstance(asyncio.get_running_loop(), VirtualClockEventLoop)


@pytest.mark.anyio
@pytest.mark.aircraft(firmware="3.1", seed=42, level=1)
async def test_the_marker_sets_what_the_aircraft_is(
    virtual_aircraft: ConnectableAircraft,
) -> None:
    assert virtual_aircraft.autopilot.profile.name == "3.1"
    assert virtual_aircraft.seed == 42
    assert virtual_aircraft.credentials.level == 1


@pytest.mark.anyio
async def test_virtual_aircraft_flies_with_the_library(
    virtual_aircraft: ConnectableAircraft,
) -> None:
    async with virtual_aircraft.connect() as aircraft:
        await aircraft.activate(virtual_aircraft.credentials)
        async with aircraft.control() as control:
            await control.take_off()
            async for tick in control.ticks(rate_hz=50):
                if tick.elapsed > 5.0:
                    break
                control.send(Setpoint.velocity(north=2, east=0, up=0, yaw_rate_deg_s=0))
            await control.land()
    assert virtual_aircraft.position[0] > 6.0
    assert virtual_aircraft.height == 0.0


@pytest.mark.anyio
async def test_it_is_waited_for_and_taken_for_what_the_test_says(
    virtual_aircraft: ConnectableAircraft,
) -> None:
    clock = asyncio.get_running_loop().time
    async with virtual_aircraft.connect(firmware="2.3") as aircraft:
        assert aircraft.firmware.name == "2.3"
    virtual_aircraft.set_faults(LineFaults(mute=True))
    began_at = clock()
    with pytest.raises(errors.NoAircraft):
        async with virtual_aircraft.connect(timeout=7.0):
            pytest.fail("it said nothing")
    assert clock() - began_at == pytest.approx(7.0, abs=0.5)


def test_a_test_that_flies_in_real_time_is_told_so() -> None:
    """As one that pytest-asyncio runs: it passes, and takes as long as the flight."""
    aircraft = ConnectableAircraft()
    asyncio.run(aircraft.open_link())
    with pytest.warns(UserWarning, match="in real time.*mark it pytest.mark.anyio.*at strict"):
        testing._end(aircraft)


def happenings() -> Iterator[tuple[str, str, float]]:
    """The table of the manual: what a test does, the error of the program, within how many s."""
    table = PAGE.read_text("utf-8").partition("| The test does | The program gets |")[2]
    for does, gets in re.findall(r"^\| (`.*) \| (.*) \|$", table.partition("\n\n")[0], re.M):
        error = re.search(r"errors\.(\w+)`, .*?within ([\d.]+) s", gets)
        assert error or gets == "nothing"
        name, within = error.groups() if error else ("", "10")
        yield from ((one, name, float(within)) for one in re.findall("`(.+?)`(?:, | |$)", does))


def test_the_table_of_the_manual_is_read() -> None:
    assert {name for _, name, _ in happenings()} >= {"AuthorityLost", "SetpointsIgnored", ""}


@pytest.mark.anyio
@pytest.mark.parametrize("by_ticks", [True, False])
@pytest.mark.parametrize(("happens", "seen", "within"), list(happenings()))
async def test_what_happens_to_the_aircraft_is_what_the_manual_says_a_program_sees(
    virtual_aircraft: ConnectableAircraft, happens: str, seen: str, within: float, by_ticks: bool
) -> None:
    clock = asyncio.get_running_loop().time
    at, heard_at = math.inf, math.nan

    def act() -> None:
        nonlocal at
        at = clock()
        exec(f"one.{happens}", {"one": virtual_aircraft, "LineFaults": LineFaults})

    raises = pytest.raises(getattr(errors, seen)) if seen else contextlib.nullcontext()
    async with virtual_aircraft.connect() as aircraft:
        await aircraft.activate(virtual_aircraft.credentials)
        with raises:
            async with aircraft.control() as control:
                await control.take_off()
                asyncio.get_running_loop().call_later(3.0, act)
                try:
                    if not by_ticks:
                        await control.fly_to(north=40.0, east=0.0, up=2.0)
                    async for tick in control.ticks():
                        if tick.elapsed > 10.0:
                            break
                        control.send(NORTH)
                finally:
                    heard_at = clock()
    assert at <= heard_at
    assert not seen or heard_at - at <= within


@pytest.mark.parametrize("name", ["wind", "battery", "battery_percents"])
def test_what_the_aircraft_does_not_have_cannot_be_set(name: str) -> None:
    with pytest.raises(AttributeError):
        setattr(ConnectableAircraft(), name, 12)


def test_virtual_serial_pair_carries_bytes_both_ways(
    virtual_serial_pair: VirtualSerialPair,
) -> None:
    with (
        serial.Serial(virtual_serial_pair.first, 230400, timeout=PATIENCE) as first,
        serial.Serial(virtual_serial_pair.second, 230400, timeout=PATIENCE) as second,
    ):
        first.write(bytes(range(256)))
        assert second.read(256) == bytes(range(256))
        second.write(b"\xaa\r\n\x03")
        assert first.read(4) == b"\xaa\r\n\x03"


def test_virtual_serial_pair_may_be_closed_twice() -> None:
    pair = VirtualSerialPair()
    pair.close()
    pair.close()


def test_virtual_aircraft_port_serves_synchronous_programs(
    virtual_aircraft_port: VirtualPort,
) -> None:
    with serial.Serial(virtual_aircraft_port.name, 230400, timeout=PATIENCE) as port:
        assert b"\xaa" in port.read(300)
    virtual_aircraft_port.call("set_rc_mode", "P")
    assert virtual_aircraft_port.call("app_takes_control") is False
    with pytest.raises(ValueError, match="stick"):
        virtual_aircraft_port.call("move_stick", roll=2.0)


def test_virtual_port_may_be_closed_twice() -> None:
    port = VirtualPort(seed=1)
    port.close()
    port.close()


def test_a_port_that_was_closed_left_no_thread(monkeypatch: pytest.MonkeyPatch) -> None:
    """However long its aircraft takes to stop."""
    begun, may_stop = threading.Event(), threading.Event()

    def stop() -> None:
        begun.set()
        may_stop.wait(PATIENCE)

    def let_stop() -> None:
        begun.wait(PATIENCE)
        may_stop.set()

    driver = MagicMock()
    driver.return_value.stop = stop
    monkeypatch.setattr(testing, "PtyPort", MagicMock())
    monkeypatch.setattr(testing, "Driver", driver)
    port = testing.VirtualPort(seed=1)
    threading.Thread(target=let_stop).start()
    port.close()
    assert may_stop.is_set()
    assert not port._thread.is_alive()
