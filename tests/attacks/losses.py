"""Each process of a station killed or stopped at random: ``python -m tests.attacks.losses``.

The aircraft stands behind a pseudo-terminal in this process, the station is ``m100link serve`` in
two. A client flies to the east; at a random moment the front or the agent is killed (SIGKILL) or
stopped (SIGSTOP). Then the aircraft is asked whether it hovers and has control authority back, a
front without its agent whether it says so, and the next client whether it flies on: beside an
agent that went on, or with a new one. The first thing that is not so ends the program.
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import json
import os
import random
import signal
import subprocess
import sys
import urllib.error
import urllib.request
from collections.abc import AsyncIterator, Callable, Sequence
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

from websockets.asyncio.client import ClientConnection
from websockets.exceptions import WebSocketException

from m100link.sim.ports.driver import Driver
from m100link.sim.ports.pty import PtyPort
from m100link.sim.vehicle.activation import DEMO_APP_ID, DEMO_KEY
from m100link.sim.virtual import VirtualAircraft
from tests.attacks.common import publish
from tests.sockets import connect
from tests.waiting import until

__all__ = ["LOSSES", "lose_at_random"]

LOSSES = (
    ("front", signal.SIGKILL),
    ("front", signal.SIGSTOP),
    ("agent", signal.SIGKILL),
    ("agent", signal.SIGSTOP),
)
"""Which process, and how."""

_STICK = "/dji_sdk/flight_control_setpoint_ENUvelocity_yawrate"
_STILL = 0.15  # m/s: the wander of a hover


class Pilot:
    """A client that flies to the east and notes what it hears."""

    def __init__(self, client: ClientConnection) -> None:
        self._client = client
        self.answers: list[dict[str, Any]] = []

    async def call(self, service: str, **args: object) -> dict[str, Any]:
        """The answer to a call; by roslib's number or none, they come in order."""
        count = len(self.answers)
        frame = {"op": "call_service", "service": service, "args": args}
        await self._client.send(json.dumps(frame))
        await until(lambda: len(self.answers) > count)
        return self.answers[-1]

    async def listen(self) -> None:
        """Keep the answers until the connection ends."""
        with contextlib.suppress(WebSocketException):
            async for frame in self._client:
                message = json.loads(frame)
                if message["op"] == "service_response":
                    self.answers.append(message)

    async def fly(self) -> None:
        """A setpoint again and again, until the connection ends."""
        with contextlib.suppress(WebSocketException):
            while True:
                await self._client.send(publish(_STICK, axes=[1.0, 0.0, 0.0, 0.0]))
                await asyncio.sleep(0.05)

    async def take_control(self) -> None:
        """Activate where that is needed, take control, take off where that is needed."""
        for _ in range(100):  # the line may be open since a moment only
            answer = await self.call("/dji_sdk/sdk_control_authority", control_enable=1)
            if answer["result"] and answer["values"]["result"]:
                return
            await self.call("/dji_sdk/activation")
            await asyncio.sleep(0.2)
        raise AssertionError(f"no control: {answer}")


@asynccontextmanager
async def piloted(port: int) -> AsyncIterator[Pilot]:
    """A pilot who is connected, as soon as somebody serves."""
    for _ in range(600):
        try:
            async with asyncio.timeout(10):
                client = await connect(f"ws://127.0.0.1:{port}", close_timeout=0.1)
            break
        except (OSError, WebSocketException, TimeoutError):
            await asyncio.sleep(0.1)
    else:
        raise AssertionError("nobody serves")
    pilot = Pilot(client)
    listening = asyncio.create_task(pilot.listen())
    try:
        yield pilot
    finally:
        listening.cancel()
        client.transport.abort()  # a client that hangs does not say goodbye


@asynccontextmanager
async def served(url: str, *options: str) -> AsyncIterator[tuple[asyncio.subprocess.Process, int]]:
    """A station on that line, and its port."""
    environment = os.environ | {
        "M100LINK_APP_ID": str(DEMO_APP_ID),
        "M100LINK_KEY": DEMO_KEY.reveal().hex(),
    }
    agent = await asyncio.create_subprocess_exec(
        *(sys.executable, "-m", "m100link", "serve", url, "--port", "0", "--json", *options),
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        env=environment,
    )
    front: int | None = None
    try:
        assert agent.stdout is not None
        announced = json.loads(await agent.stdout.readline())
        front = front_of(agent)
        yield agent, int(announced["rosbridge"][0].rpartition(":")[2])
    finally:
        for one in (agent.pid if agent.returncode is None else None, front):
            if one is not None:
                with contextlib.suppress(ProcessLookupError):
                    os.kill(one, signal.SIGCONT)
                    os.kill(one, signal.SIGTERM)
        await agent.wait()


def front_of(agent: asyncio.subprocess.Process) -> int:
    """Process id of the fronts."""
    listed = Path(f"/proc/{agent.pid}/task/{agent.pid}/children").read_text(encoding="ascii")
    return int(listed.split()[0])


async def health(port: int) -> dict[str, Any]:
    """What a front says of the aircraft, to a program that asks by HTTP."""

    def get() -> bytes:
        try:
            with urllib.request.urlopen(f"http://127.0.0.1:{port}/health", timeout=5) as answer:
                return bytes(answer.read())
        except urllib.error.HTTPError as error:
            with error:
                return bytes(error.read())

    found: dict[str, Any] = json.loads(await asyncio.to_thread(get))
    return found


class Flight:
    """The aircraft, and what can be asked of it."""

    def __init__(self, seed: int) -> None:
        self.aircraft = VirtualAircraft(seed=seed)
        self.driver = Driver(self.aircraft)
        self.port = PtyPort(self.driver)
        self.driver.start()

    @property
    def url(self) -> str:
        """Where a station finds it."""
        return f"{self.port.device}:230400"

    def flies_east(self) -> bool:
        """Whether it does what the pilot wants."""
        return self.aircraft.vehicle.flight.dynamics.velocity_east > 0.7

    def hovers(self) -> bool:
        """Whether it stands in the air."""
        motion = self.aircraft.vehicle.flight.dynamics
        speed = max(abs(motion.velocity_east), abs(motion.velocity_north), abs(motion.velocity_up))
        return speed < _STILL and self.aircraft.height > 1.0

    def is_released(self) -> bool:
        """Whether control authority is back."""
        return not self.aircraft.vehicle.authority.is_requested

    async def take_off(self, pilot: Pilot) -> None:
        """Fly, if it does not."""
        await pilot.take_control()
        if self.aircraft.height < 1.0:
            await pilot.call("/dji_sdk/drone_task_control", task=4)
            await until(lambda: self.aircraft.height > 1.0)
            await asyncio.sleep(3.0)

    async def lose(self, which: str, how: signal.Signals, after: float) -> float:
        """One loss and what follows; returns the seconds until it hovered."""
        loop = asyncio.get_running_loop()
        async with served(self.url) as (agent, port), piloted(port) as pilot:
            await self.take_off(pilot)
            flying = asyncio.create_task(pilot.fly())
            await until(self.flies_east)
            await asyncio.sleep(after)
            victim = agent.pid if which == "agent" else front_of(agent)
            os.kill(victim, how)
            lost_at = loop.time()
            await until(self.hovers)
            took = loop.time() - lost_at
            if which == "front":
                await until(self.is_released)
                if how is signal.SIGSTOP:
                    os.kill(victim, signal.SIGKILL)
            else:
                await self._ask_front(how, port, pilot)
            flying.cancel()
            await asyncio.gather(flying, return_exceptions=True)
            if which == "front":  # it was started again beside the agent
                async with piloted(port) as next_pilot:
                    await self._fly_on(next_pilot)
        if which == "agent":
            async with served(self.url) as (_, port), piloted(port) as next_pilot:
                await self._fly_on(next_pilot)
        return took

    async def _ask_front(self, how: signal.Signals, port: int, pilot: Pilot) -> None:
        """A front whose agent has gone, or is silent, says so."""
        if how is signal.SIGKILL:
            answer = await pilot.call("/dji_sdk/query_drone_version")
            assert not answer["result"], answer
            assert "the agent that owns the aircraft has gone" in answer["values"], answer
            return
        async with asyncio.timeout(60):
            while (await health(port))["connection"] != "silent":  # noqa: ASYNC110 - by HTTP
                await asyncio.sleep(0.1)

    async def _fly_on(self, pilot: Pilot) -> None:
        await self.take_off(pilot)
        flying = asyncio.create_task(pilot.fly())
        await until(self.flies_east)
        flying.cancel()
        await asyncio.gather(flying, return_exceptions=True)
        await until(self.hovers)


async def lose_at_random(
    losses: Sequence[tuple[str, signal.Signals]],
    times: int,
    seed: int,
    tell: Callable[[str], None] = lambda text: None,
) -> list[tuple[str, float]]:
    """That many losses of each kind, at random moments of one flight.

    Returns:
        What was lost, and the seconds until the aircraft hovered.
    """
    chance, flight = random.Random(seed), Flight(seed)
    found = []
    try:
        for which, how in [*losses] * times:
            took = await flight.lose(which, how, chance.uniform(0.0, 1.0))
            found.append((f"{which} {how.name}", took))
            tell(f"{len(found)}: {found[-1][0]}: {took:.2f} s")
    finally:
        flight.driver.stop()
        flight.port.close()
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--times", type=int, default=13, help="of each kind")
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()

    def tell(text: str) -> None:
        print(text, file=sys.stderr, flush=True)

    found = asyncio.run(lose_at_random(LOSSES, options.times, options.seed, tell))
    print(f"{'lost':16}{'times':>7}{'s until it hovers, p50':>26}{'worst':>8}")
    for which in dict.fromkeys(name for name, _ in found):
        took = sorted(seconds for name, seconds in found if name == which)
        print(f"{which:16}{len(took):7}{took[len(took) // 2]:26.2f}{took[-1]:8.2f}")


if __name__ == "__main__":
    main()
