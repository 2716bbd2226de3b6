"""The supervisor of a station: processes that it starts, and starts again when they end.

A child reads its settings as one line of JSON on its standard input, and answers by one line when
it runs, or with the fault that kept it from it. Its standard input stays open as long as the
supervisor lives.
"""

from __future__ import annotations

import asyncio
import gc
import json
import os
import signal
import sys
from collections.abc import AsyncIterator, Awaitable, Callable, Mapping, Sequence
from contextlib import AsyncExitStack, asynccontextmanager, suppress
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any

from m100link.apps.agent.background import Ended
from m100link.apps.station.config import MOST_AIRCRAFT, Settings
from m100link.apps.station.listeners import FRONTS, Sockets, open_sockets
from m100link.apps.station.log_output import LogOutput, in_force, writing_log
from m100link.errors import M100Error, UsageError
from m100link.errors.texts import read_json

START_TIMEOUT = 60.0  # seconds in which a child has to run: a small computer imports slowly

RESTART_PAUSES = (0.5, 1.0, 2.0, 5.0, 10.0)
"""Seconds before a child that ended is started again; one that ran begins anew."""

END_TIMEOUT = 5.0  # seconds that a child has to end in order

FRONT_NICENESS = 5  # a third of the agent's share of a busy processor: it still serves


class ChildProcess:
    def __init__(
        self,
        role: str,  # which of those of :mod:`m100link.apps.station.process` it is
        called: str,  # who it is, for people
        # The settings for it; ``starts``, how often it was started before, and ``log``, how it
        # logs, are added.
        request: dict[str, Any],
        note: Callable[[str, str], None],  # takes a text and a level: what happens to it
        *,
        inherited: Sequence[int] = (),  # file descriptors that it gets
        loads: Sequence[Any] = (),  # loaded before the request comes: see `process`
    ) -> None:
        self._role = role
        self._called = called
        self.request = request
        self.note = note
        self._inherited, self._loads = inherited, loads
        self._waiting: asyncio.subprocess.Process | None = None  # for its request
        self._process: asyncio.subprocess.Process | None = None
        self._starts = 0
        self.answer: dict[str, Any] = {}  # when it ran
        self.on_restart: list[Callable[[], object]] = []  # called when it runs again

    @property
    def pid(self) -> int | None:
        return None if self._process is None else self._process.pid

    async def begin(self) -> None:
        """Let it load what it needs, while its request is not known yet.

        Raises ``UsageError``: this is Windows.
        """
        if sys.platform == "win32":
            raise UsageError(
                f"{self._called}: no process of its own can be had on Windows",
                cause="processes of a station reach each other by Unix sockets",
                remedy="start one station for each aircraft, or run it on Linux or macOS",
            )
        loads = [json.dumps(self._loads)] if self._loads else []
        clean = {name: one for name, one in os.environ.items() if not name.startswith("M100LINK_")}
        clean["PYDANTIC_DISABLE_PLUGINS"] = "__all__"  # it would look into every package for some
        self._waiting = await asyncio.create_subprocess_exec(
            *(sys.executable, "-m", "m100link.apps.station.process", self._role, *loads),
            stdin=asyncio.subprocess.PIPE,
            stdout=asyncio.subprocess.PIPE,
            pass_fds=self._inherited,
            env=clean,
            start_new_session=True,  # Ctrl-C is for the parent, which ends its children in order
        )

    async def start(self) -> None:
        """Start it, and wait until it runs.

        Raises ``M100Error``: the child met an error, or did not start.
        """
        if self._waiting is None:
            await self.begin()
        assert self._waiting is not None
        self._process, self._waiting = self._waiting, None
        try:
            async with asyncio.timeout(START_TIMEOUT):
                self._take_answer(await self._ask(self._process))
        except TimeoutError:
            await self.end()
            raise M100Error(
                f"{self._called}: the process did not serve within {START_TIMEOUT:g} s",
                remedy="try --single-process, which shows more",
            ) from None
        except BaseException:
            await self.end()
            raise

    async def _ask(self, process: asyncio.subprocess.Process) -> bytes:
        assert process.stdin is not None
        assert process.stdout is not None
        log = in_force() or LogOutput()  # warnings: the package by itself prints nothing
        request = self.request | {"starts": self._starts, "log": asdict(log)}
        self._starts += 1
        process.stdin.write(json.dumps(request).encode() + b"\n")
        with suppress(ConnectionError):  # it has ended: its answer says why, if there is one
            await process.stdin.drain()
        return await process.stdout.readline()

    def _take_answer(self, line: bytes) -> None:
        try:
            answer = read_json(line)
        except ValueError:
            raise M100Error(
                f"{self._called}: the process ended before it served",
                remedy="read its output above; try --single-process, which shows more",
            ) from None
        if "fault" in answer:
            from m100link.apps.agent.messages import RemoteError  # a child begins before it

            raise RemoteError(**answer["fault"]).error()
        self.answer = answer

    async def keep(self) -> None:
        """Start it again whenever it ends, until cancelled."""
        failures = 0
        while True:
            if self._process is not None:
                code = await self._process.wait()
                how = signal.Signals(-code).name if code < 0 else f"status {code}"
                self.note(f"{self._called} ended ({how}), to be started again", "error")
                self._process = None
            await asyncio.sleep(RESTART_PAUSES[min(failures, len(RESTART_PAUSES) - 1)])
            try:
                await self.start()
            except Exception as error:  # noqa: BLE001 (noted): no memory, or no thread to wait for it
                failures += 1
                self.note(f"{self._called}: not started: {error}", "error")
            else:
                failures = 0
                self.note(f"{self._called}: serving again", "info")
                for callback in self.on_restart:
                    callback()

    async def end(self, timeout: float | None = None) -> None:
        """End the child, in order if it listens. May be called any number of times."""
        process, self._process, self._waiting = self._process or self._waiting, None, None
        if process is None or process.returncode is not None:
            return
        with suppress(ProcessLookupError):
            process.terminate()
        try:
            async with asyncio.timeout(END_TIMEOUT if timeout is None else timeout):
                await process.wait()
        except TimeoutError:
            with suppress(ProcessLookupError):
                process.kill()
            await process.wait()


@asynccontextmanager
async def supervised(
    *children: ChildProcess,
    timeout: float | None = None,  # seconds that they have to end in order
) -> AsyncIterator[None]:
    """Start them all at once, start again whichever ends, and end them all at once.

    Raises ``M100Error``: one of them met an error. None of the others runs on then.
    """
    try:
        for met in await asyncio.gather(*(one.start() for one in children), return_exceptions=True):
            if met is not None:
                raise met
        keeping = [
            asyncio.create_task(one.keep(), name="m100link station: child") for one in children
        ]
        try:
            yield
        finally:
            for task in keeping:
                task.cancel()
            await asyncio.gather(*keeping, return_exceptions=True)
    finally:
        await asyncio.gather(*(one.end(timeout) for one in children))


# -- the process of the fronts ---------------------------------------------------------------------

BegunFronts = tuple[Sockets, ChildProcess]

_NOT_FOR_FRONTS = ("url", "key", "key_file", "app_id", "token_file", "origins", "unused")


def front_settings(settings: Settings) -> dict[str, Any]:
    """The settings for the fronts, as JSON takes it: nothing of the app and its key.

    Raises ``UsageError``: the token cannot be one.
    """
    given = {
        one.name: getattr(settings, one.name)
        for one in fields(settings)
        if one.name not in _NOT_FOR_FRONTS
    }
    given |= {"token": settings.access_token(), "sim": settings.is_virtual}
    if not (settings.mavlink or settings.mavlink_to):  # they alone give logs away
        given["record"] = None
    return as_json(given)


def as_json(given: Mapping[str, Any]) -> dict[str, Any]:
    """Settings by name, as JSON takes them and :mod:`m100link.apps.station.config` reads them."""
    return {
        name: str(value) if isinstance(value, Path) else value
        for name, value in given.items()
        if value is not None
    }


@asynccontextmanager
async def beginning_fronts(
    aircraft: Mapping[str, Settings],  # the first has those of access and of services
    *,
    with_console: bool = False,
    with_rosbridge: bool = True,
    recordings: Sequence[tuple[str, str]] = (),  # files that pages will show, and their firmware
) -> AsyncIterator[BegunFronts]:
    """Open the sockets, and let the process of the fronts load while agents do, and connect.

    Raises ``UsageError, PortBusy, PortFailed``: something in the settings cannot be, or a port is
    taken.
    """
    if not 1 <= len(aircraft) <= MOST_AIRCRAFT:
        raise UsageError(
            f"{len(aircraft)} aircraft are too many for one station",
            remedy=f"one station has at most {MOST_AIRCRAFT}: start another one beside it",
        )
    settings = next(iter(aircraft.values()))
    request: dict[str, Any] = {"settings": front_settings(settings)}
    if settings.ros2 and len(aircraft) > 1:
        FRONTS["ros2"].load().check_ros2(settings, list(aircraft))  # all before anything is bound
    async with AsyncExitStack() as stack:
        sockets = open_sockets(
            stack, settings, with_console=with_console, with_rosbridge=with_rosbridge
        )
        descriptors = request["sockets"] = sockets.descriptors()
        front = ChildProcess(
            "fronts",
            "the fronts",
            request,
            lambda *_: None,  # of what happens before there is an agent the block ends
            inherited=[number for row in descriptors.values() for number in row],
            loads=(FRONT_NICENESS, list(descriptors), list(recordings)),
        )
        stack.push_async_callback(front.end)
        await front.begin()
        yield sockets, front


# -- the child's side -----------------------------------------------------------------------------


def run_child(work: Callable[[dict[str, Any], Ended], Awaitable[None]]) -> int:
    """Be such a process: do ``work`` with what the line says, until a signal sets the event."""
    line = sys.stdin.readline()
    if not line:
        return 0  # the supervisor has gone
    request = read_json(line)

    async def run() -> None:
        ended = Ended()
        try:
            await work(request, ended)
        except asyncio.CancelledError:
            if not ended.is_set():
                raise

    try:
        with writing_log(LogOutput(**request["log"])):  # as the parent does
            asyncio.run(run())
    except M100Error as error:
        from m100link.apps.agent.messages import RemoteError

        answer(fault=asdict(RemoteError.of(error)))
        return 1
    return 0


def answer(**values: Any) -> None:
    """Report to the supervisor that this process runs, or the fault that kept it from it."""
    with suppress(BrokenPipeError):  # it has gone, and this process ends for that
        os.write(1, json.dumps(values).encode() + b"\n")


def leave_what_stays() -> None:
    """Let the collector of garbage run, and leave alone what there is now.

    To walk through all that was loaded takes it 65 ms where one aircraft is flown and a third of a
    second where hundreds are, and nothing flies meanwhile. The garbage of loading, 2,000 objects,
    is not worth one such walk.
    """
    gc.freeze()
    gc.enable()


def end_with_parent(end: Callable[[], object]) -> None:
    """Call this when standard input ends: nobody writes to it, so its holder has gone."""
    loop = asyncio.get_running_loop()
    number = sys.stdin.fileno()

    def readable() -> None:
        loop.remove_reader(number)
        end()

    loop.add_reader(number, readable)
