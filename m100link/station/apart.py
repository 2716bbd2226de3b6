"""The station in two processes: here who flies, in the other who talks to strangers.

This process owns the port, control authority, the lease and the log, and listens to nobody but its
fronts. Those run in a child at a lower priority, behind a Unix socket in a private directory. The
listening sockets are opened here and given to the child: when it dies, clients wait for the next
one, which is started beside the flying agent. A child that hangs or dies costs a hover.
"""

from __future__ import annotations

import asyncio
import json
import os
import signal
import sys
from collections.abc import AsyncIterator, Callable
from contextlib import AsyncExitStack, asynccontextmanager, suppress
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

from m100link.agent.agent import Agent
from m100link.agent.carriers.unix import private_directory, serve_unix
from m100link.agent.fault import Fault
from m100link.errors import M100Error
from m100link.sim.orders.ctl import CtlServer
from m100link.sim.virtual import VirtualAircraft
from m100link.station.config import Settings
from m100link.station.fronts import Sockets, open_sockets
from m100link.station.run import Owner, owning

__all__ = ["FrontProcess", "RunningApart", "running_apart"]

START_TIMEOUT = 60.0
"""Seconds in which the fronts have to serve: a small computer imports slowly."""

RESTART_PAUSES = (0.5, 1.0, 2.0, 5.0, 10.0)
"""Seconds before a child that ended is started again; one that served begins anew."""

_END_TIMEOUT = 5.0
_NOT_FOR_FRONTS = ("url", "key", "key_file", "app_id", "token_file", "origins", "unused")


class FrontProcess:
    """The child with the fronts, started again when it ends.

    Args:
        agent: Whose journal tells what happens.
        request: What :mod:`m100link.station.front` is told.
        sockets: Listening sockets to hand over.

    Attributes:
        pid: Process id of the present child, None between two.
        console_path: Path that opens the console in a browser.
        on_restart: Called when it serves again: the console has another path then.
    """

    def __init__(self, agent: Agent, request: dict[str, Any], sockets: Sockets) -> None:
        self._agent = agent
        self._request = request
        self._sockets = sockets
        self._process: asyncio.subprocess.Process | None = None
        self.console_path = "/"
        self.on_restart: list[Callable[[], None]] = []

    @property
    def pid(self) -> int | None:
        """Process id of the present child."""
        return None if self._process is None else self._process.pid

    async def start(self) -> None:
        """Start it, and wait until it serves.

        Raises:
            M100Error: What the child met, or that it did not start.
        """
        numbers = [one.fileno() for one in self._sockets.rosbridge]
        console = None if self._sockets.console is None else self._sockets.console.fileno()
        clean = {name: one for name, one in os.environ.items() if not name.startswith("M100LINK_")}
        self._process = await asyncio.create_subprocess_exec(
            *(sys.executable, "-m", "m100link.station.front"),
            stdin=asyncio.subprocess.PIPE,
            stdout=asyncio.subprocess.PIPE,
            pass_fds=[*numbers, *([] if console is None else [console])],
            env=clean,
            start_new_session=True,  # Ctrl-C is for the agent, which ends its child in order
        )
        try:
            async with asyncio.timeout(START_TIMEOUT):
                self._take_answer(await self._ask(self._process, numbers, console))
        except TimeoutError:
            await self.end()
            raise M100Error(
                f"the process of the fronts did not serve within {START_TIMEOUT:g} s",
                remedy="try --single-process, which shows more",
            ) from None
        except BaseException:
            await self.end()
            raise

    async def _ask(
        self, process: asyncio.subprocess.Process, numbers: list[int], console: int | None
    ) -> bytes:
        assert process.stdin is not None
        assert process.stdout is not None
        request = self._request | {"rosbridge": numbers, "console": console}
        process.stdin.write(json.dumps(request).encode() + b"\n")
        with suppress(ConnectionError):  # it has ended: its answer says why, if there is one
            await process.stdin.drain()
        return await process.stdout.readline()

    def _take_answer(self, line: bytes) -> None:
        try:
            answer = json.loads(line)
        except ValueError:
            raise M100Error(
                "the process of the fronts ended before it served",
                remedy="see what it wrote above; try --single-process, which shows more",
            ) from None
        if "fault" in answer:
            raise Fault(**answer["fault"]).error()
        self.console_path = answer["console_path"]

    async def keep(self) -> None:
        """Start it again whenever it ends, until cancelled."""
        failures = 0
        while True:
            if self._process is not None:
                code = await self._process.wait()
                how = signal.Signals(-code).name if code < 0 else f"status {code}"
                self._agent.journal.note(
                    f"the fronts ended ({how}); they are started again", "error"
                )
                self._process = None
            await asyncio.sleep(RESTART_PAUSES[min(failures, len(RESTART_PAUSES) - 1)])
            try:
                await self.start()
            except (M100Error, OSError) as error:
                failures += 1
                self._agent.journal.note(f"the fronts do not start: {error}", "error")
            else:
                failures = 0
                self._agent.journal.note("the fronts serve again")
                for callback in self.on_restart:
                    callback()

    async def end(self) -> None:
        """End the child, in order if it listens. May be called any number of times."""
        process, self._process = self._process, None
        if process is None or process.returncode is not None:
            return
        with suppress(ProcessLookupError):
            process.terminate()
        try:
            async with asyncio.timeout(_END_TIMEOUT):
                await process.wait()
        except TimeoutError:
            with suppress(ProcessLookupError):
                process.kill()
            await process.wait()


@dataclass(frozen=True, slots=True)
class RunningApart:
    """A station in two processes.

    Attributes:
        owner: What owns the aircraft, in this process.
        front: The other process.
        sockets: Where the fronts listen.
    """

    owner: Owner
    front: FrontProcess
    sockets: Sockets

    @property
    def agent(self) -> Agent:
        """The aircraft and its lease."""
        return self.owner.agent

    @property
    def ports(self) -> list[int]:
        """Ports of rosbridge, in the order of the settings."""
        return self.sockets.ports

    @property
    def console_port(self) -> int | None:
        """Port of the console, None without it."""
        return self.sockets.console_port

    def console_path(self) -> str:
        """Path that opens the console in a browser, with a code that works once where needed."""
        return self.front.console_path


def front_settings(settings: Settings) -> dict[str, Any]:
    """What the fronts have to know, as JSON takes it: nothing of the app and its key.

    Raises:
        UsageError: The token cannot be one.
    """
    given = {
        one.name: getattr(settings, one.name)
        for one in fields(settings)
        if one.name not in _NOT_FOR_FRONTS
    }
    given["token"] = settings.access_token()
    return {
        name: str(value) if isinstance(value, Path) else value
        for name, value in given.items()
        if value is not None
    }


@asynccontextmanager
async def running_apart(
    settings: Settings, *, with_console: bool = False, virtual: VirtualAircraft | None = None
) -> AsyncIterator[RunningApart]:
    """Run a station while the block runs, with its fronts in a process of their own.

    Args:
        settings: What it needs to know.
        with_console: Serve the console, too.
        virtual: The virtual aircraft to use with ``sim``; by default one that stands ready.

    Raises:
        UsageError, PortBusy, PortFailed: Something in the settings cannot be, or a port is taken.
    """
    request: dict[str, Any] = {"settings": front_settings(settings)}
    settings.niceness()  # before anything is bound
    async with AsyncExitStack() as stack:
        sockets = open_sockets(stack, settings, with_console=with_console)
        owner = await stack.enter_async_context(owning(settings, virtual))
        directory = stack.enter_context(private_directory())
        agent_path = directory / "agent.sock"
        await stack.enter_async_context(serve_unix(agent_path, owner.service.attach))
        request["agent"] = str(agent_path)
        if owner.virtual is not None and with_console:
            orders = CtlServer([owner.virtual], directory / "orders.sock")
            await orders.start()
            stack.push_async_callback(orders.stop)
            request["orders"] = str(orders.path)
        front = FrontProcess(owner.agent, request, sockets)
        await front.start()
        stack.push_async_callback(front.end)
        keeping = asyncio.create_task(front.keep(), name="m100link station: fronts")
        stack.push_async_callback(_ended, keeping)
        # Before the child is waited for: one that hangs must not fly on until its lease ends.
        stack.callback(owner.service.close)
        yield RunningApart(owner, front, sockets)


async def _ended(task: asyncio.Task[None]) -> None:
    task.cancel()
    with suppress(asyncio.CancelledError):
        await task
