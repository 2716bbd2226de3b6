"""A station with a virtual aircraft, and programs for rospy that run beside it."""

from __future__ import annotations

import asyncio
import contextlib
import os
import sys
import textwrap
from collections.abc import AsyncIterator
from pathlib import Path

import pytest

pytest.importorskip("uvicorn")

from m100link.apps.station.config import Settings
from m100link.apps.station.run import RunningStation, running
from m100link.sim.virtual import VirtualAircraft
from tests.waiting import PATIENCE, until


@pytest.fixture
def anyio_backend() -> str:
    return "asyncio"  # real time: sockets are not virtual


EXAMPLE = Path(__file__).parents[2] / "examples/rospy"


class Programs:
    """Runs programs for rospy on one station."""

    def __init__(self, one: RunningStation, folder: Path, aircraft: VirtualAircraft) -> None:
        self.station, self.folder, self.aircraft = one, folder, aircraft
        self.address = f"ws://127.0.0.1:{one.sockets.port('rosbridge')}"

    async def begin(self, source: str, *arguments: str) -> asyncio.subprocess.Process:
        program = self.folder / "program.py"
        program.write_text(textwrap.dedent(source), encoding="utf-8")
        return await self.begin_file(program, *arguments)

    async def begin_file(self, program: Path, *arguments: str) -> asyncio.subprocess.Process:
        own = (*arguments, "--station", self.address)
        command = ("-u", str(EXAMPLE), str(program), *own)
        return await asyncio.create_subprocess_exec(
            sys.executable,
            *command,
            stdout=asyncio.subprocess.PIPE,
            stderr=asyncio.subprocess.PIPE,
            env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},
        )

    async def run(self, source: str, *arguments: str, status: int = 0) -> list[str]:
        """The lines that a program prints; what else it says, when it ends otherwise."""
        return await self._end(await self.begin(source, *arguments), status)

    async def run_file(self, program: Path, *arguments: str, status: int = 0) -> list[str]:
        """The same of a file that is there."""
        return await self._end(await self.begin_file(program, *arguments), status)

    async def _end(self, process: asyncio.subprocess.Process, status: int) -> list[str]:
        async with asyncio.timeout(PATIENCE):
            out, error = await process.communicate()
        assert process.returncode == status, error.decode()
        self.error = error.decode()
        return out.decode().splitlines()


@contextlib.asynccontextmanager
async def programs(folder: Path, **options: object) -> AsyncIterator[Programs]:
    virtual = VirtualAircraft(seed=5, firmware="3.1")
    settings = Settings(sim=True, port=0, firmware="3.1", **options)  # type: ignore[arg-type]
    async with running(settings, virtual=virtual) as one:
        await until(lambda: one.agent.connection.aircraft is not None)
        yield Programs(one, folder, virtual)
