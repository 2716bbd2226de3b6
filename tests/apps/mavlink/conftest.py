"""An agent on a virtual aircraft, the bridge, and ground stations: on virtual time."""

from __future__ import annotations

import asyncio
import math
from collections.abc import AsyncIterator, Callable
from contextlib import AsyncExitStack, asynccontextmanager
from pathlib import Path
from typing import Any, cast

import anyio
import pytest

from m100link.apps.agent.client import AgentClient
from m100link.apps.agent.control_session import ControlInput, ControlSession
from m100link.apps.agent.lease import Lease
from m100link.apps.agent.server.agent import Agent
from m100link.apps.agent.server.connection import by_driver
from m100link.apps.agent.server.server import AgentServer
from m100link.apps.agent.transports import MemoryChannel, memory_channels
from m100link.apps.mavlink.bridge import Bridge
from m100link.apps.mavlink.translator.codec import (
    Address,
    MavlinkMessage,
    MessageReader,
    PacketSigner,
    write_frame,
)
from m100link.apps.mavlink.translator.numbers import MavCommand, MavResult
from m100link.apps.mavlink.translator.vehicle_state import CAMERA, MODES, Mode, VehicleState
from m100link.protocol.records import FlightPhase, FlightStatus, Position
from m100link.sim.clock import virtual_clock_loop
from m100link.sim.ports.driver import Driver
from m100link.sim.vehicle.settings import AircraftSettings
from m100link.sim.virtual import VirtualAircraft
from tests.known import Known, position

GCS = ("127.0.0.1", 14540)
MODE_OF = {row.number: mode for mode, row in MODES.items()}


@pytest.fixture
def anyio_backend() -> tuple[str, dict[str, Any]]:
    return "asyncio", {"loop_factory": virtual_clock_loop}


class Ground:
    """A ground station: says its heartbeat while it is there, keeps what it hears."""

    def __init__(self, rig: Rig, address: Address = GCS, system: int = 245) -> None:
        self.rig, self.address, self.system = rig, address, system
        self.heard: list[MavlinkMessage] = []
        self.cameras: list[MavlinkMessage] = []  # heartbeats of the camera
        self.is_silent = False
        rig.grounds.append(self)

    def hear(self, data: bytes) -> None:
        for one in MessageReader(data, signer=self.rig.ground_signer, now=self.rig.stamp()):
            is_cameras = one.name == "HEARTBEAT" and one.component == CAMERA
            (self.cameras if is_cameras else self.heard).append(one)

    def send(self, message_name: str, **fields: Any) -> None:
        self.rig.sequence += 1
        frame = write_frame(
            MavlinkMessage(message_name, fields, component=190),
            system=self.system,
            sequence=self.rig.sequence,
            signer=self.rig.ground_signer,
            now=self.rig.stamp(),
        )
        self.rig.bridge.received(frame, self.address)

    def beat(self) -> None:
        if not self.is_silent:
            self.send("HEARTBEAT", type=6, autopilot=8)

    def command(
        self, command: int, *parameters: float, target: int = 1, component: int = 1
    ) -> None:
        given = (*parameters, *(math.nan,) * (7 - len(parameters)))
        named = {f"param{place}": value for place, value in enumerate(given, 1)}
        to = {"target_system": target, "target_component": component}
        self.send("COMMAND_LONG", command=command, **to, **named)

    def all(self, name: str) -> list[MavlinkMessage]:
        return [one for one in self.heard if one.name == name]

    def last(self, name: str) -> MavlinkMessage:
        return self.all(name)[-1]

    @property
    def texts(self) -> str:
        return "\n".join(str(one["text"]) for one in self.all("STATUSTEXT"))

    @property
    def mode(self) -> Mode:
        return MODE_OF[self.last("HEARTBEAT")["custom_mode"]]

    def armed(self) -> bool:
        return bool(self.last("HEARTBEAT")["base_mode"] & 128)

    async def ask(
        self, command: int, *parameters: float, target: int = 1, component: int = 1
    ) -> MavResult:
        """Give a command; what that component answered in the end."""
        known = len(self.heard)
        self.command(command, *parameters, target=target, component=component)

        def answers() -> list[MavResult]:
            return [
                MavResult(one["result"])
                for one in self.heard[known:]
                if (one.name, one.component) == ("COMMAND_ACK", component)
                and one["command"] == command
            ]

        await self.rig.until(lambda: any(one is not MavResult.IN_PROGRESS for one in answers()))
        return next(one for one in answers() if one is not MavResult.IN_PROGRESS)

    def set_mode_now(self, mode: Mode) -> None:
        self.command(MavCommand.DO_SET_MODE, 1, MODES[mode].main, MODES[mode].sub)

    async def set_mode(self, mode: Mode) -> MavResult:
        row = MODES[mode]
        return await self.ask(MavCommand.DO_SET_MODE, 1, row.main, row.sub)

    async def arm(self) -> None:
        assert await self.ask(MavCommand.COMPONENT_ARM_DISARM, 1) is MavResult.ACCEPTED

    async def fly(self, height: float = 5.0) -> None:
        """Arm, take off, wait for the height."""
        await self.arm()
        altitude = self.rig.ground_altitude + height
        args = (0, 0, 0, math.nan, math.nan, math.nan, altitude)
        assert await self.ask(MavCommand.NAV_TAKEOFF, *args) is MavResult.ACCEPTED
        await self.rig.until(lambda: abs(self.rig.height - height) < 0.4)
        await self.rig.until(lambda: self.mode is Mode.HOLD)


class Late(MemoryChannel):
    """An end of a way on which each message takes a while."""

    def __init__(self, late: float) -> None:
        super().__init__()
        self._late, self._count = late, 0

    def send(self, message: Any) -> None:
        self._count += 1  # none overtakes another
        late = self._late + 1e-7 * (self._count % 10000)
        asyncio.get_running_loop().call_later(late, super().send, message)


class Rig:
    """The whole: aircraft, agent, bridge."""

    def __init__(
        self,
        *,
        firmware: str = "1.0",
        signer: PacketSigner | None = None,
        settings: AircraftSettings | None = None,
        late: float = 0.0,
        logs: Path | None = None,
        **options: Any,
    ) -> None:
        self.aircraft = VirtualAircraft(seed=5, firmware=firmware, settings=settings)
        self.ground_altitude = self.aircraft.vehicle.settings.ground_altitude
        self.driver = Driver(self.aircraft)
        self.agent = Agent(by_driver(self.driver), credentials=self.aircraft.credentials, **options)
        self.grounds: list[Ground] = []
        self.sent: list[tuple[bytes, Address]] = []
        self.sequence = 0
        self.signer = signer
        self.logs = logs
        self.late = late  # s that each message to and from the agent is under way
        # Later than any real clock says.
        self.ground_signer = signer and PacketSigner(signer.key, sent=2**47)

    def stamp(self) -> int:
        return 0

    def _send(self, data: bytes, address: Address) -> None:
        self.sent.append((data, address))
        for ground in self.grounds:
            if ground.address == address:
                ground.hear(data)

    @asynccontextmanager
    async def running(self) -> AsyncIterator[Rig]:
        async with AsyncExitStack() as stack:
            await stack.enter_async_context(self.agent)
            self.service = AgentServer(self.agent)
            self.client = await stack.enter_async_context(AgentClient(self.way(), "mavlink"))
            self.bridge = Bridge({1: self.client}, self._send, signer=self.signer, logs=self.logs)
            self.vehicle = self.bridge.vehicles[0]
            self.work = self.agent.background.spawn(self.bridge.run(), "bridge")
            self.agent.background.spawn(self._beat(), "heartbeats")
            self.ground = Ground(self)
            self.ground.beat()
            await self.until(lambda: bool(self.ground.all("HOME_POSITION")))
            yield self
            assert self.bridge.unsent == 0, "a number did not fit into its field"
            self.work.cancel()
        self.driver.stop()

    def way(self) -> MemoryChannel:
        """A way to the agent."""
        ours, its = (Late(self.late), Late(self.late)) if self.late else memory_channels()
        ours.join(its)
        self.channels = ours, its
        self.service.attach(its)
        return ours

    async def _beat(self) -> None:
        while True:
            await anyio.sleep(1.0)
            for ground in self.grounds:
                ground.beat()

    async def until(self, predicate: Callable[[], bool], within: float = 60.0) -> None:
        with anyio.fail_after(within):
            while not predicate():  # noqa: ASYNC110 - virtual time: it costs nothing
                await anyio.sleep(0.01)

    @property
    def height(self) -> float:
        return float(self.aircraft.height)

    @property
    def speed(self) -> float:
        return float(self.aircraft.vehicle.flight.dynamics.speed)

    @property
    def motors_on(self) -> bool:
        return bool(self.aircraft.vehicle.flight.dynamics.motors_on)


@pytest.fixture
async def rig() -> AsyncIterator[Rig]:
    async with Rig().running() as one:
        yield one


@pytest.fixture
def ground(rig: Rig) -> Ground:
    return rig.ground


def world_of(known: Known, *, home: tuple[float, float, float] | None = None) -> VehicleState:
    """What the bridge makes of it.

    Args:
        known: What is reported.
        home: How far north, east and up of home it is, m; None where nobody knows.
    """
    world = VehicleState(cast(AgentClient, known), session_of(known))
    if home is not None:
        north, east, up = home
        here = position()
        latitude = here.latitude_deg - math.degrees(north / 6_371_000)
        across = 6_371_000 * math.cos(here.latitude_rad)
        longitude = here.longitude_deg - math.degrees(east / across)
        status = known.items[FlightStatus]
        known.items[Position] = position(latitude=latitude, longitude=longitude, altitude=10.5)
        known.items[FlightStatus] = FlightStatus(FlightPhase.STANDBY)
        world.look()
        known.items[FlightStatus] = status
        known.items[Position] = position(height=up)
    return world


class Told:
    """A client of that agent, as far as control needs one."""

    now, agents_before = 0.0, 0

    def __init__(self, known: Any) -> None:
        self._known = known
        self.on_lease: list[Any] = []
        self.on_authority_taken = self.on_event = self.on_steer_refused = self.on_lease

    def __getattr__(self, name: str) -> Any:
        return getattr(self._known, name)

    def let_go(self, lease: Lease) -> None:
        """It takes a while until the agent tells."""

    def holds(self, lease: Lease | None) -> bool:
        return lease is not None and lease.number == self._known.holder.number


def session_of(known: Any, *, number: int | None = None) -> ControlSession:
    """Control by the bridge, which was granted the lease of that number; 0 for none.

    By default it has the lease in force, if there is control authority.
    """
    told: Any = Told(known)
    session = ControlSession(told, "mavlink")
    if number is None:
        number = known.holder.number if known.has_authority else 0
    if number:
        session.adopt(Lease("mavlink", "token", number))
        session.feed(ControlInput.OBTAIN)
        session.feed(ControlInput.OBEYED)
    return session
