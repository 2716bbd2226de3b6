"""A page beside a MAVLink program that flies: who is obeyed, by the simulator's own truth."""

from __future__ import annotations

import asyncio
import json
import math
import signal
import socket
import subprocess
import sys
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress
from pathlib import Path
from typing import Any

import pytest

from m100link.apps.mavlink.translator.codec import MavlinkMessage, MessageReader, write_frame
from m100link.apps.mavlink.translator.numbers import MavCommand, MavResult
from m100link.sim.orders import send_order
from tests.browser.conftest import Console, Watch, context_of, running_console, until
from tests.browser.operator import banner, press_for, press_until

pytestmark = [pytest.mark.anyio]

OFFBOARD, HOLD, LAND, MISSION = (6, 0), (4, 3), (4, 6), (4, 4)
NORTH = 2.0


class Station:
    """A MAVLink program: says its heartbeat, and setpoints north while it streams."""

    def __init__(self, url: str) -> None:
        host, _, port = url.removeprefix("udp://").partition(":")
        self.line = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.line.connect((host, int(port)))
        self.line.setblocking(False)
        self.newest: dict[str, MavlinkMessage] = {}
        self.answers: list[tuple[int, int]] = []
        self.texts = ""
        self.sent = 0
        self.streams = False

    def say(self, message: str, **fields: float) -> None:
        self.sent += 1
        values = MavlinkMessage(message, {"target_system": 1, "target_component": 1} | fields)
        with suppress(OSError):
            self.line.send(write_frame(values, system=255, sequence=self.sent))

    async def run(self) -> None:
        for step in range(10**6):
            if step % 10 == 0:
                self.say("HEARTBEAT", type=6, autopilot=8)
            if self.streams:
                self.setpoint()
            with suppress(OSError):
                while True:
                    self._hear(self.line.recv(65536))
            await asyncio.sleep(0.05)

    def _hear(self, data: bytes) -> None:
        for message in MessageReader(data):
            self.newest[message.name] = message
            if message.name == "COMMAND_ACK":
                self.answers.append((message["command"], message["result"]))
            elif message.name == "STATUSTEXT":
                self.texts += message["text"]

    def setpoint(self) -> None:
        fields = {"coordinate_frame": 1, "type_mask": 0b1101_1100_0111, "vx": NORTH}
        self.say("SET_POSITION_TARGET_LOCAL_NED", **fields)

    async def ask(self, command: int, *parameters: float) -> MavResult:
        self.answers.clear()
        given = (*parameters, *(math.nan,) * (7 - len(parameters)))
        named = {f"param{place}": value for place, value in enumerate(given, 1)}
        self.say("COMMAND_LONG", command=command, **named)
        ends = (MavResult.IN_PROGRESS,)
        await until(lambda: any(one == command and r not in ends for one, r in self.answers))
        return MavResult(next(r for one, r in self.answers if one == command and r not in ends))

    async def mode(self, mode: tuple[int, int]) -> MavResult:
        return await self.ask(MavCommand.DO_SET_MODE, 1, *mode)

    @property
    def shown(self) -> tuple[int, int]:
        number = self.newest["HEARTBEAT"]["custom_mode"]
        return number >> 16 & 0xFF, number >> 24

    async def flies_north(self, truth: Truth) -> None:
        """Armed, in the air, and on its way by setpoints."""
        await until(lambda: "HOME_POSITION" in self.newest)
        assert await self.ask(MavCommand.COMPONENT_ARM_DISARM, 1) is MavResult.ACCEPTED
        assert await self.ask(MavCommand.NAV_TAKEOFF) is MavResult.ACCEPTED
        await until(lambda: truth.now["height"] > 2.0)
        await until(lambda: self.shown == HOLD)
        await self.again(truth)

    async def again(self, truth: Truth) -> None:
        self.streams = True
        await asyncio.sleep(0.2)
        assert await self.mode(OFFBOARD) is MavResult.ACCEPTED
        before = truth.now["north"]
        await until(lambda: truth.now["north"] > before + 2.0)


class Truth:
    """What the simulator says itself."""

    def __init__(self, place: str) -> None:
        self._place = Path(place)

    @property
    def now(self) -> dict[str, Any]:
        found: dict[str, Any] = send_order(["status"], path=self._place)["status"]
        return found

    async def stands(self, within: float = 5.0, for_s: float = 5.0) -> None:
        """It comes to rest in the air, and stays."""
        await asyncio.sleep(within)
        before = self.now
        await asyncio.sleep(for_s)
        after = self.now
        moved = math.hypot(after["north"] - before["north"], after["east"] - before["east"])
        assert moved < 0.4, (before, after)
        assert abs(after["height"] - before["height"]) < 0.4, (before, after)
        assert after["height"] > 1.0


class Beside:
    """A console with MAVLink, its page, and a program that flies."""

    def __init__(self, console: Console, station: Station, truth: Truth) -> None:
        self.console, self.station, self.truth = console, station, truth


@asynccontextmanager
async def beside(browser: Any, folder: Path) -> AsyncIterator[Beside]:
    key = folder / "key"
    key.write_text(bytes(range(32)).hex())
    key.chmod(0o600)
    words = ("sim", "--tcp", "127.0.0.1:0", "--json")
    command = [sys.executable, "-c", "from m100link.apps.cli import main; main()", *words]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as sim:  # noqa: ASYNC220 - it has begun when it says so
        assert sim.stdout is not None
        told = json.loads(sim.stdout.readline())
        options = ("--app-id", "10086", "--key-file", str(key), "--mavlink", "udp://127.0.0.1:0")
        try:
            async with (
                running_console(*options, "--no-record", aircraft=(told["port"],)) as (
                    report,
                    process,
                ),
                context_of(browser) as context,
            ):
                console = Console(report["console"], process, context)
                console.watch = Watch()
                station = Station(report["mavlink"][0])
                works = [
                    asyncio.create_task(console.watch.run(report["rosbridge"][0])),
                    asyncio.create_task(station.run()),
                ]
                yield Beside(console, station, Truth(told["control_socket"]))
                for work in works:
                    work.cancel()
                await asyncio.gather(*works, return_exceptions=True)
                station.line.close()
        finally:
            sim.terminate()


async def take_over(page: Any) -> None:
    await press_until(page, "obtain", lambda: page.is_visible("#confirm"))
    await page.click("#confirm")
    await banner(page, "You have control")


async def test_a_page_stops_takes_over_and_is_closed(browser: Any, tmp_path: Path) -> None:
    async with beside(browser, tmp_path) as one:
        station, truth = one.station, one.truth
        page = await one.console.open()
        await station.flies_north(truth)
        await page.click("[data-act=stop]")
        await truth.stands()
        assert station.shown == HOLD
        assert "STOP was pressed" in station.texts
        await station.again(truth)
        await take_over(page)
        await truth.stands()
        assert await station.mode(LAND) is MavResult.TEMPORARILY_REJECTED
        assert await station.mode(OFFBOARD) is MavResult.TEMPORARILY_REJECTED
        assert (
            await station.ask(MavCommand.COMPONENT_ARM_DISARM, 1) is MavResult.TEMPORARILY_REJECTED
        )
        assert station.newest["HEARTBEAT"]["base_mode"] & 128, "it flies"
        await page.close()
        await until(lambda: truth.now["control"] == "rc")
        await truth.stands()
        assert await station.ask(MavCommand.COMPONENT_ARM_DISARM, 1) is MavResult.ACCEPTED
        await truth.stands()
        assert await station.mode(LAND) is MavResult.ACCEPTED
        await until(lambda: truth.now["flight_status"] == "standby")


async def test_a_program_that_is_gone_leaves_a_hover_for_the_page(
    browser: Any, tmp_path: Path
) -> None:
    async with beside(browser, tmp_path) as one:
        station, truth = one.station, one.truth
        page = await one.console.open()
        await station.flies_north(truth)
        station.line.close()  # killed: neither setpoints nor heartbeats any more
        await truth.stands()
        await take_over(page)
        await truth.stands()
        await press_for(page, "release", "#banner", "Nobody has control")
        await truth.stands()


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM, signal.SIGSTOP])
async def test_an_agent_that_is_gone_leaves_a_hover(
    browser: Any, tmp_path: Path, number: signal.Signals
) -> None:
    async with beside(browser, tmp_path) as one:
        station, truth = one.station, one.truth
        await one.console.open()
        await station.flies_north(truth)
        one.console.process.send_signal(number)
        try:
            await truth.stands()
        finally:
            if number is signal.SIGSTOP:
                one.console.process.send_signal(signal.SIGCONT)
        if number is signal.SIGSTOP:
            await truth.stands()
