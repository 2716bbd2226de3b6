"""What the aircraft does when something goes wrong between it and a hand that steers.

A key at a desk, a stick on a phone and on a tablet.

The virtual aircraft stands in this process, behind TCP, and is asked itself: when the last frame
came that was not neutral, when it hovered, how far it had gone, who has authority then. Each row of
the table in the manual is a test here; ``-s`` prints what it measured.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import math
import os
import signal
import sys
import uuid
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from m100link.protocol.records import Device
from m100link.sim.ports.driver import Driver, serve_tcp
from m100link.sim.vehicle.activation import DEMO_APP_ID, DEMO_KEY
from m100link.sim.virtual import VirtualAircraft
from tests.browser.conftest import ARGUMENTS, CHROMIUM, playwright, until
from tests.browser.operator import Fingers, fold, hold_key, steer
from tests.waiting import PATIENCE

pytestmark = [pytest.mark.anyio, pytest.mark.skipif(CHROMIUM is None, reason="no Chromium here")]

STEERED_S = 1.0
"""Seconds after which nothing that was steered may still arrive: a beat lasts 0.3 s, the rest is
what a busy machine takes."""

HOVERS_M_S = 0.15
SETTLE_S = 5.0


SAYS_LOST = "document.body.classList.contains('station-lost')"
"""Every value on the page is shown as old."""


TOUCH = {"has_touch": True, "is_mobile": True}
SCREENS: dict[str, dict[str, Any]] = {
    "desk": {"viewport": {"width": 1280, "height": 800}},
    "phone": {"viewport": {"width": 390, "height": 844}, **TOUCH},
    "tablet": {"viewport": {"width": 820, "height": 1180}, **TOUCH},
}


class Line(Driver):
    """The aircraft's end of the line; notes when each movement frame came that is not neutral."""

    def __init__(self, aircraft: VirtualAircraft) -> None:
        super().__init__(aircraft)
        self.steered_at = -math.inf

    def receive(self, data: bytes) -> None:
        """Bytes from the station."""
        moves = self.aircraft.autopilot.received_movements
        before = self.aircraft.autopilot.counters.movements
        super().receive(data)
        new = self.aircraft.autopilot.counters.movements - before
        if any(move.roll_or_x or move.pitch_or_y for move in list(moves)[len(moves) - new :]):
            self.steered_at = self.loop.time()


@dataclass
class Measured:
    """What the aircraft did.

    Attributes:
        steered_s: Seconds until the last frame that was not neutral.
        hovers_s: Seconds until it stood still in the air.
        moved_m: Metres until then.
        authority: Who has control a few seconds later.
    """

    steered_s: float
    hovers_s: float
    moved_m: float
    authority: Device


class Flight:
    """A page that steers the aircraft to the north, and whatever can be done to both."""

    def __init__(self, line: Line, station: Any, page: Any, mark: str, *, by_touch: bool) -> None:
        self.line = line
        self.station = station
        self.page = page
        self._mark = mark
        self._by_touch = by_touch
        self._loop = asyncio.get_running_loop()

    @property
    def aircraft(self) -> VirtualAircraft:
        return self.line.aircraft

    @property
    def speed(self) -> float:
        motion = self.aircraft.vehicle.flight.dynamics
        return math.hypot(motion.velocity_north, motion.velocity_east)

    @property
    def place(self) -> tuple[float, float]:
        motion = self.aircraft.vehicle.flight.dynamics
        return motion.north, motion.east

    @property
    def front(self) -> int:
        """Process of the fronts."""
        named = b"m100link.apps.station.process\0fronts"  # a guardian is a child, too
        (front,) = (
            one
            for one in children(self.station.pid)
            if named in Path(f"/proc/{one}/cmdline").read_bytes()
        )
        return front

    @property
    def browser_processes(self) -> list[int]:
        """Chromium and all that it started."""
        whole = next(one for one in processes() if self._mark in command_line(one))
        return [whole, *descendants(whole)]

    async def steer(self) -> None:
        """Hold a key, or the right stick forward, until it flies."""
        if not self._by_touch:
            await self.page.click("#pad")
            await self.page.keyboard.press("Digit4")
            return await hold_key(self.page, "w", lambda: self.speed > 0.8)
        await fold(self.page, "sticks", is_shown=True)
        for _ in range(3):
            await self.page.tap("[data-steer=faster]")
        hand = await Fingers.at(self.page)

        async def push() -> None:
            await hand.down(1, ".stick.move")
            await hand.move(1, 0, -60)

        await steer(self.page, push, hand.up, lambda: self.speed > 0.8)

    async def after(self, disturb: Callable[[], Awaitable[Any]]) -> Measured:
        """What it does from this disturbance on."""
        began, at = self._loop.time(), self.place
        await disturb()
        await until(lambda: self.speed < HOVERS_M_S, what="it does not hover")
        hovers_s, moved_m = self._loop.time() - began, math.dist(at, self.place)
        await asyncio.sleep(SETTLE_S)
        assert self.aircraft.height > 1.0, "it did not stay in the air"
        assert self.speed < HOVERS_M_S, "it began to move again"
        steered_s = max(0.0, self.line.steered_at - began)
        found = Measured(steered_s, hovers_s, moved_m, self.aircraft.vehicle.authority.device)
        print(f"\n{os.environ.get('PYTEST_CURRENT_TEST')}: {found}")  # noqa: T201 - for the manual
        return found

    async def stays(self, what: str) -> None:
        """Nothing that is still held moves anything."""
        frames = self.line.steered_at
        await asyncio.sleep(2.0)
        assert self.line.steered_at == frames, what
        assert self.speed < HOVERS_M_S, what


def processes() -> Iterator[int]:
    """Processes of this machine."""
    return (int(path.name) for path in Path("/proc").iterdir() if path.name.isdigit())


def command_line(process: int) -> str:
    """What a process was started by; empty when it has gone."""
    with contextlib.suppress(OSError):
        return Path(f"/proc/{process}/cmdline").read_text(errors="replace")
    return ""


def children(process: int) -> list[int]:
    """Processes that a process has started, by any of its threads."""
    found: list[int] = []
    for path in Path(f"/proc/{process}/task").glob("*/children"):
        with contextlib.suppress(OSError):
            found += map(int, path.read_text().split())
    return found


def descendants(process: int) -> list[int]:
    """Those, and theirs."""
    return [one for child in children(process) for one in (child, *descendants(child))]


@contextlib.asynccontextmanager
async def console_of(line: Line) -> AsyncIterator[tuple[str, asyncio.subprocess.Process]]:
    """A console for that aircraft, as a user starts it; yields its address and process."""
    server = await serve_tcp(line)
    station = await asyncio.create_subprocess_exec(
        *(sys.executable, "-m", "m100link", "console", f"tcp://127.0.0.1:{server.port}"),
        *("--port", "0", "--console-port", "0", "--no-open-browser", "--json"),
        stdout=asyncio.subprocess.PIPE,
        stderr=asyncio.subprocess.DEVNULL,
        env=os.environ
        | {"M100LINK_APP_ID": str(DEMO_APP_ID), "M100LINK_KEY": DEMO_KEY.reveal().hex()},
    )
    try:
        assert station.stdout is not None
        async with asyncio.timeout(PATIENCE):
            told = await station.stdout.readline()
        yield json.loads(told)["console"], station
    finally:
        fronts = children(station.pid) if station.returncode is None else []
        with contextlib.suppress(ProcessLookupError):
            station.terminate()
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(15.0):
                await station.wait()
        for one in fronts:
            with contextlib.suppress(ProcessLookupError):
                os.kill(one, signal.SIGKILL)
        await server.stop()


async def page_of(context: Any, url: str) -> Any:
    page = await context.new_page()
    page.set_default_timeout(1000 * PATIENCE)
    await page.add_init_script(DELAY)
    await page.goto(url)
    await page.wait_for_function("window.m100?.steering && window.m100.socket.heardAt > 0")
    return page


@pytest.fixture(params=SCREENS)
async def flight(request: pytest.FixtureRequest) -> AsyncIterator[Flight]:
    """A virtual aircraft that the pilot has taken off with, and a page that has control of it."""
    line, mark = Line(VirtualAircraft(seed=5)), f"--m100link-{uuid.uuid4()}"
    line.start()
    async with console_of(line) as (url, station), playwright.async_playwright() as started:
        browser = await started.chromium.launch(executable_path=CHROMIUM, args=[*ARGUMENTS, mark])
        try:
            screen = SCREENS[request.param]
            page = await page_of(await browser.new_context(**screen), url)
            line.aircraft.pilot_takes_off()
            vehicle = line.aircraft.vehicle
            await until(lambda: line.aircraft.height > 1.1)
            await page.click("[data-act=obtain]:not([disabled])")
            await until(lambda: vehicle.authority.device is Device.ONBOARD)
            one = Flight(line, station, page, mark, by_touch="has_touch" in screen)
            await one.steer()
            front = one.front
            yield one
        finally:
            with contextlib.suppress(Exception):  # it may have been killed
                async with asyncio.timeout(5.0):
                    await browser.close()
            with contextlib.suppress(ProcessLookupError, UnboundLocalError):
                os.kill(front, signal.SIGTERM)
    line.stop()


# What the steering socket says and hears comes so many milliseconds later.
DELAY = """
window.delayMs = 0;
const Native = WebSocket;
window.WebSocket = class extends Native {
  constructor(url, ...rest) {
    super(url, ...rest);
    this.isSteering = String(url).includes("/steer/");
  }
  send(data) {
    if (this.isSteering && window.delayMs) setTimeout(() => super.send(data), window.delayMs);
    else super.send(data);
  }
  set onmessage(handler) {
    super.onmessage = !this.isSteering ? handler : (event) =>
      window.delayMs ? setTimeout(() => handler(event), window.delayMs) : handler(event);
  }
};
"""


async def test_reload(flight: Flight) -> None:
    """Motion ends with the page, and control goes back: the new page has none."""
    did = await flight.after(flight.page.reload)
    assert did.steered_s < STEERED_S
    assert did.authority is not Device.ONBOARD


async def test_hidden_tab(flight: Flight) -> None:
    """The key counts no more; control stays with the page, which goes on to be heard."""

    async def hide() -> None:
        await flight.page.evaluate(
            """() => {
                Object.defineProperty(document, 'hidden', {get: () => true});
                document.dispatchEvent(new Event('visibilitychange'));
            }"""
        )

    did = await flight.after(hide)
    assert did.steered_s < STEERED_S
    assert did.authority is Device.ONBOARD


async def test_slept_laptop(flight: Flight) -> None:
    """Every process of the browser stands still for longer than a lease lasts, then goes on."""
    stopped = flight.browser_processes

    async def sleep() -> None:
        for one in stopped:
            os.kill(one, signal.SIGSTOP)

    try:
        did = await flight.after(sleep)
    finally:
        for one in stopped:
            os.kill(one, signal.SIGCONT)
    assert did.steered_s < STEERED_S
    assert did.authority is not Device.ONBOARD
    await flight.stays("it flew on by itself when it woke")  # with the key still down


async def test_delay_of_300_ms_each_way(flight: Flight) -> None:
    """Nobody steers by a picture that is so old; control stays, and the page says why."""

    async def delay() -> None:
        await flight.page.evaluate("window.delayMs = 300")

    did = await flight.after(delay)
    assert did.steered_s < STEERED_S + 0.6
    assert did.authority is Device.ONBOARD
    assert "it was not flown" in await flight.page.inner_text("body")


async def test_pilot_takes_over(flight: Flight) -> None:
    """The mode switch: what is still held counts no more when it is back in F."""

    async def leave_f() -> None:
        flight.aircraft.leave_f()

    did = await flight.after(leave_f)
    assert did.steered_s < STEERED_S
    assert did.authority is Device.RC
    assert "mode switch" in await flight.page.inner_text("#banner")
    flight.aircraft.return_to_f()
    await until(lambda: flight.aircraft.vehicle.authority.device is Device.ONBOARD)
    await flight.stays("it flew on as the pilot gave it back")


async def test_cable_pulled_and_plugged_in_again(flight: Flight) -> None:
    async def pull() -> None:
        flight.aircraft.unplug()

    did = await flight.after(pull)
    assert did.steered_s < STEERED_S
    await flight.page.wait_for_selector("#banner:not(.good)")
    flight.aircraft.replug()
    await flight.page.wait_for_selector("#banner.good, [data-act=obtain]:not([disabled])")
    await flight.stays("it flew on with the cable")


async def test_another_tab_takes_over(flight: Flight) -> None:
    """Two tabs of one browser: a hand on the first one moves nothing any more."""
    other = await page_of(flight.page.context, flight.page.url.partition("#")[0])
    if flight.speed < HOVERS_M_S:  # the first one is hidden now: it may have let go
        await flight.page.bring_to_front()
        await flight.steer()

    async def take_over() -> None:
        await other.bring_to_front()
        await other.click("[data-act=obtain]:not([disabled])")
        await other.click("#confirm")

    did = await flight.after(take_over)
    assert did.authority is Device.ONBOARD
    assert "You have control" in await other.inner_text("#banner")
    await flight.page.bring_to_front()
    await flight.stays("the first tab steers on")
    assert "has control" in await flight.page.inner_text("#banner")


async def test_browser_killed(flight: Flight) -> None:
    killed = flight.browser_processes

    async def kill() -> None:
        for one in killed:
            with contextlib.suppress(ProcessLookupError):
                os.kill(one, signal.SIGKILL)

    did = await flight.after(kill)
    assert did.steered_s < STEERED_S
    assert did.authority is not Device.ONBOARD


async def test_front_killed(flight: Flight) -> None:
    front = flight.front

    async def kill() -> None:
        os.kill(front, signal.SIGKILL)

    # The fronts are started again, and the page comes back: it may have been lost for a second.
    lost = asyncio.create_task(flight.page.wait_for_function(SAYS_LOST))
    did = await flight.after(kill)
    assert did.steered_s < STEERED_S
    assert did.authority is not Device.ONBOARD
    await lost
    await until(lambda: flight.front != front, what="the fronts are not started again")
    await flight.page.wait_for_selector("[data-act=obtain]:not([disabled])")
    await flight.stays("the page that came back steers")


async def test_agent_killed(flight: Flight) -> None:
    """Its guardian brakes the aircraft and gives authority back at once (explanation/safety.md of
    the manual, first table). Every value on the page is shown as old."""

    async def kill() -> None:
        flight.station.kill()

    did = await flight.after(kill)
    assert did.steered_s < STEERED_S
    assert did.authority is Device.RC
    await flight.page.wait_for_function(SAYS_LOST)
