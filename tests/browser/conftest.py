"""A console in a process of its own, Chromium, and a rosbridge client that sees what is flown."""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import shutil
import sys
from collections.abc import AsyncIterator, Awaitable, Callable
from typing import Any

import pytest

playwright = pytest.importorskip("playwright.async_api", reason="playwright is not installed")
pytest.importorskip("nicegui", reason="the extra `station` is not installed")
from websockets.asyncio.client import ClientConnection  # noqa: E402 - after the skips
from websockets.exceptions import ConnectionClosed  # noqa: E402 - as above

from tests.sockets import connect  # noqa: E402 - after the skips
from tests.waiting import PATIENCE  # noqa: E402 - as above

CHROMIUM = os.environ.get("CHROMIUM") or shutil.which("chromium") or shutil.which("google-chrome")
ARGUMENTS = ["--no-sandbox", "--enable-unsafe-swiftshader"]


@pytest.fixture(scope="session")
def anyio_backend() -> str:
    return "asyncio"


@pytest.fixture(scope="session")
async def browser() -> AsyncIterator[Any]:
    """Chromium, started once; each test has a context of its own in it."""
    if CHROMIUM is None:
        pytest.skip("there is no chromium: apt-get install chromium, or set CHROMIUM")
    async with playwright.async_playwright() as started:
        running = await started.chromium.launch(executable_path=CHROMIUM, args=ARGUMENTS)
        yield running
        await running.close()


@pytest.fixture(scope="session")
async def address() -> AsyncIterator[str]:
    """The address of a console for tests that need no page."""
    async with running_console() as (report, _):
        yield report["console"]


class Watch:
    """Telemetry of a virtual aircraft, by rosbridge.

    Args:
        prefix: Of its topics, where it is not the first of a station.
    """

    def __init__(self, prefix: str = "") -> None:
        self._prefix = f"{prefix}/dji_sdk/"
        self.newest: dict[str, Any] = {}

    async def run(self, url: str) -> None:
        """Watch until cancelled; a connection that was given up is followed by another."""
        async for socket in connect(url, ping_interval=None):
            with contextlib.suppress(ConnectionClosed):
                await self._watch(socket)

    async def _watch(self, socket: ClientConnection) -> None:
        for topic in ("velocity", "height_above_takeoff", "flight_status", "attitude"):
            await socket.send(
                json.dumps(
                    {"op": "subscribe", "topic": f"{self._prefix}{topic}", "throttle_rate": 20}
                )
            )
        async for text in socket:
            message = json.loads(text)
            self.newest[message["topic"].removeprefix(self._prefix)] = message["msg"]

    @property
    def speed(self) -> tuple[float, float, float]:
        """East, north, up, m/s."""
        vector = self.newest["velocity"]["vector"]
        return vector["x"], vector["y"], vector["z"]

    @property
    def height(self) -> float:
        return float(self.newest["height_above_takeoff"]["data"])

    @property
    def status(self) -> int:
        return int(self.newest["flight_status"]["data"])


class Console:
    """A running console, its context of a browser, and what a page did that it should not."""

    def __init__(self, url: str, process: asyncio.subprocess.Process, context: Any) -> None:
        self.url = url
        self.process = process
        self.context = context
        self.foreign: list[str] = []
        self.errors: list[str] = []
        self.watch: Watch

    async def open(self, script: str = "") -> Any:
        page = await self.context.new_page()
        page.on("request", self._note_request)
        page.on("pageerror", lambda error: self.errors.append(str(error)))
        if script:
            await page.add_init_script(script)
        await page.goto(self.url)
        await page.wait_for_function("window.m100?.steering && window.m100.socket.heardAt > 0")
        return page

    def _note_request(self, request: Any) -> None:
        if not request.url.startswith((self.url, self.url.replace("http", "ws"), "data:", "blob:")):
            self.foreign.append(request.url)


async def until(
    predicate: Callable[[], bool | Awaitable[bool]], within: float = PATIENCE, what: str = ""
) -> None:
    """Wait until the predicate holds."""
    loop = asyncio.get_running_loop()
    deadline = loop.time() + within
    while True:
        result = predicate()
        if result if isinstance(result, bool) else await result:
            return
        assert loop.time() < deadline, f"not within {within} s: {what or predicate}"
        await asyncio.sleep(0.03)


@contextlib.asynccontextmanager
async def running_console(
    *options: str, aircraft: tuple[str, ...] = ("--sim",)
) -> AsyncIterator[tuple[dict[str, Any], Any]]:
    """The command, as a user starts it; yields what it printed, and its process."""
    process = await asyncio.create_subprocess_exec(
        sys.executable,
        *("-c", "from m100link.apps.cli import main; main()"),
        *(
            "console",
            *aircraft,
            "--port",
            "0",
            "--console-port",
            "0",
            "--no-open-browser",
            "--json",
        ),
        *options,
        stdout=asyncio.subprocess.PIPE,
        stderr=asyncio.subprocess.PIPE,
        env={**os.environ, "PYTHONUNBUFFERED": "1"},
    )
    assert process.stdout is not None
    assert process.stderr is not None
    try:
        async with asyncio.timeout(PATIENCE):
            line = await process.stdout.readline()
        assert line, (await process.stderr.read()).decode()
        yield json.loads(line), process
    finally:
        if process.returncode is None:
            process.terminate()
        talk = asyncio.create_task(process.stderr.read())
        try:
            async with asyncio.timeout(PATIENCE):
                await process.wait()
        except TimeoutError:
            process.kill()
            await process.wait()
            raise
        finally:
            print((await talk).decode())  # noqa: T201 - shown when a test fails


@contextlib.asynccontextmanager
async def context_of(browser: Any, **options: Any) -> AsyncIterator[Any]:
    """A context of the browser, with nothing that another test left."""
    context = await browser.new_context(**{"viewport": {"width": 1500, "height": 1100}} | options)
    context.set_default_timeout(1000 * PATIENCE)
    try:
        yield context
    finally:  # a page of a test that failed would go on calling for its station
        await context.close()


@contextlib.asynccontextmanager
async def console_in_browser(browser: Any, *options: str) -> AsyncIterator[Console]:
    async with (
        running_console(*options) as (report, process),
        context_of(browser) as context,
    ):
        console = Console(report["console"], process, context)
        console.watch = Watch()
        watching = asyncio.create_task(console.watch.run(report["rosbridge"][0]))
        await until(lambda: len(console.watch.newest) == 4)
        yield console
        watching.cancel()
        await asyncio.gather(watching, return_exceptions=True)
        assert console.errors == []
        assert console.foreign == []  # the console works without Internet


@pytest.fixture
async def console(browser: Any) -> AsyncIterator[Console]:
    async with console_in_browser(browser) as one:
        yield one
