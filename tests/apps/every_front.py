"""Every front as its user drives it: messages in, words out, and the truth of the aircraft beside.

A driver knows a front by what a user of it knows: the messages of a page's socket, JSON of
rosbridge, frames of MAVLink, CDR, orders of a fleet. Each has the same verbs, so that
:mod:`tests.apps.test_every_front` does the same to all of them.
"""

from __future__ import annotations

import asyncio
import json
import math
import random
from abc import ABC, abstractmethod
from collections.abc import AsyncIterator, Callable, Coroutine
from contextlib import AsyncExitStack, ExitStack, asynccontextmanager, suppress
from types import SimpleNamespace
from typing import Any, ClassVar, NamedTuple
from unittest.mock import patch

import anyio

from m100link import sync
from m100link.apps.agent import orders
from m100link.apps.agent.client import AgentClient
from m100link.apps.agent.transports import memory_channels
from m100link.apps.bus.network import Received
from m100link.apps.fleet.keys import Keys
from m100link.apps.fleet.payloads import TakePlace
from m100link.apps.fleet.show.conductor import Conductor
from m100link.apps.fleet.show.plan.document import Show
from m100link.apps.fleet.show.service import ShowService
from m100link.apps.mavlink.translator.numbers import MavCommand
from m100link.apps.mavlink.translator.vehicle_state import Mode
from m100link.apps.station.fleet import Ships
from m100link.apps.station.ros.graph import Graph
from m100link.errors import BadSetpoint, M100Error
from m100link.protocol.records import Device
from m100link.protocol.setpoint import Setpoint
from m100link.sim.clock import LockstepEventLoop
from m100link.sim.ports import driver
from m100link.sim.vehicle.settings import AircraftSettings
from m100link.sim.virtual import VirtualAircraft
from m100link.sync import aircraft as sync_aircraft
from m100link.sync.portal import Portal
from tests.apps.bus.memory import Weather
from tests.apps.fleet import conftest as fleet
from tests.apps.fleet.show.shows import ORIGIN, track
from tests.apps.mavlink import conftest as mavlink
from tests.apps.mavlink.test_bridge import send_velocity
from tests.apps.ros2 import conftest as ros2
from tests.apps.station import conftest as station
from tests.apps.station.conftest import FakeClient, serve_rosbridge
from tests.apps.station.console.test_tab import Browser
from tests.rig import NORTH, put_in_the_air

HEIGHT_M = 2.4  # less than what counts as a jump of the position
STEP_S = 0.05
SPEED_M_S = 2.0
PINGED_WITHIN_S = 5.0
"""A ping each 2 s, and 3 s for its answer."""
OTHER = "the other"
HANGS_S = 4.0
"""Seconds for which a sender hangs: a lease lasts 3 s without it."""
FLOOD = 800
"""Setpoints in one moment: twice as many as rosbridge takes, three times as many as MAVLink."""


class Sample(NamedTuple):
    """What the aircraft really did at one moment."""

    time: float
    speed: float
    height: float
    runs: bool
    obeys: Device


class Front(ABC):
    """A front, its user, and the aircraft.

    Attributes:
        is_sending: Whether the user sends setpoints, 20 a second.
        is_there: Whether the user's program says anything at all.
    """

    name: ClassVar[str]
    has_agent = True

    def __init__(self) -> None:
        self.samples: list[Sample] = []
        self.is_sending, self.is_there = False, True
        self.chance = random.Random(31)
        self.heard: list[str] = []

    # -- what each is asked for --------------------------------------------------------------------

    aircraft: VirtualAircraft

    @abstractmethod
    def open(self) -> Any:
        """A context in which front and aircraft are there."""

    @abstractmethod
    async def take_control(self) -> None:
        """As its user does, once the aircraft is in the air."""

    @abstractmethod
    def send(self) -> None:
        """One setpoint: 2 m/s to the north."""

    def be_heard(self) -> None:  # noqa: B027 - most say nothing
        """What the user's program says 20 times a second besides."""

    @abstractmethod
    async def stop(self) -> None:
        """STOP as this front has it."""

    @abstractmethod
    async def land(self) -> None:
        """Land, while the program goes on sending."""

    async def hang(self) -> None:
        """The user's program stands still: it says nothing, and its socket stays open."""
        self.is_there = False

    async def hang_stop(self) -> None:
        await self.hang()
        await self.passes(HANGS_S)
        await self.stop_elsewhere()

    async def hang_leave_f(self) -> None:
        await self.hang()
        await self.passes(HANGS_S)
        await self.leave_f()

    async def stop_elsewhere(self) -> None:
        """STOP of somebody who has not this front."""
        raise NotImplementedError

    async def flood(self) -> None:
        """A program that lost its rate says all this in one moment, and then stops."""
        for _ in range(FLOOD):
            self.send()
        await self.stop()

    async def too_fast(self) -> None:
        """A program that lost its rate goes on so, 600 setpoints a second."""
        for _ in range(40):
            for _ in range(60):
                self.send()
            await self.passes(0.1)

    def let_go(self) -> None:
        """Keys are let go, or the program pauses."""
        self.is_sending = False

    @abstractmethod
    def send_late(self) -> None:
        """A setpoint of a second and more ago."""

    @abstractmethod
    def send_junk(self) -> None:
        """Bytes that mean nothing, or the wrong thing."""

    @abstractmethod
    async def kill(self) -> None:
        """The process of the front is gone, without a word."""

    @abstractmethod
    def words(self) -> str:
        """All that its user heard until now."""

    # -- what happens to all of them ---------------------------------------------------------------

    def now(self) -> float:
        return anyio.current_time()

    async def tick(self) -> None:
        await anyio.sleep(STEP_S)

    async def passes(self, seconds: float, until: Callable[[], bool] = lambda: False) -> None:
        """Time, in which the user goes on and the aircraft is watched."""
        for _ in range(round(seconds / STEP_S)):
            if self.is_there:
                self.be_heard()
                if self.is_sending:
                    self.send()
            await self.tick()
            motion = self.aircraft.vehicle.flight.dynamics
            self.samples.append(
                Sample(
                    self.now(),
                    motion.speed,
                    motion.height,
                    motion.motors_on,
                    self.aircraft.vehicle.authority.device,
                )
            )
            if until():
                return

    async def begin(self) -> None:
        """Take control and fly."""
        await self.take_control()
        self.is_sending = True
        await self.passes(6.0, lambda: self.samples[-1].speed > 0.8 * SPEED_M_S)
        assert self.samples[-1].speed > 0.8 * SPEED_M_S, f"it does not fly: {self.words()}"

    async def leave_f(self) -> None:
        self.aircraft.leave_f()
        await self.passes(2.0)
        assert self.samples[-1].obeys is Device.RC
        self.aircraft.return_to_f()

    async def lose_link(self) -> None:
        self.aircraft.unplug()

    async def holder(self) -> str | None:
        """By whom control is held, in words for people; empty for nobody, None without leases."""
        return None


class BesideAnAgent(Front):
    """Whose aircraft belongs to an agent, beside which somebody else may come."""

    rig: Any
    channels: Any
    agent: Any

    def __init__(self) -> None:
        super().__init__()
        self.tasks: list[asyncio.Task[Any]] = []

    def spawn(self, work: Coroutine[Any, Any, Any]) -> None:
        """What the user waits for while the test looks on; what it raises is kept."""

        async def told() -> None:
            try:
                await work
            except Exception as error:  # noqa: BLE001 - the user reads it, whatever it is
                self.heard.append(f"{type(error).__name__}: {error}")

        self.tasks.append(asyncio.ensure_future(told()))

    @asynccontextmanager
    async def beside(self, service: Any) -> AsyncIterator[None]:
        """Somebody else at a station of the same agent."""
        ours, its = memory_channels(as_bytes=True)
        service.attach(its)
        graph = Graph()
        async with AgentClient(ours, "another station") as client:
            serve_rosbridge(client, graph)
            seen: Any = SimpleNamespace(graph=graph, agent=self.agent)
            self.other = FakeClient(seen, OTHER)
            self.other_page = Browser(SimpleNamespace(front=client, agent=self.agent), OTHER)  # type: ignore[arg-type]
            yield
            for task in self.tasks:
                task.cancel()
            await asyncio.gather(*self.tasks, return_exceptions=True)

    async def _lease(self, **said: str) -> dict[str, Any]:
        count = len(self.other.answers())
        self.other.call("/m100link/lease", **said)
        await self.passes(1.0, lambda: len(self.other.answers()) > count)
        found: dict[str, Any] = self.other.answers()[-1]
        return found

    async def take_over(self) -> str:
        """The other takes the lease over, as an operator does; returns its proof."""
        offer = await self._lease(action="take_over", name=OTHER)
        if not offer.get("success"):
            return ""  # nobody has it
        return str((await self._lease(action="confirm", token=offer["token"]))["token"])

    async def take_over_and_give_back(self) -> None:
        proof = await self.take_over()
        await self.passes(0.5)
        await self._lease(action="release", token=proof)

    async def take_over_out_of_f(self) -> None:
        """The other takes the lease while the pilot flies, who comes back to F then."""
        self.aircraft.leave_f()
        await self.passes(1.0)
        if not await self.take_over():  # a front that gives way has given it back
            await self._lease(action="acquire", name=OTHER)
        await self.passes(0.5)
        self.aircraft.return_to_f()

    async def hang_land(self) -> None:
        """Somebody at the station takes it, by a button in two steps, and lands it."""
        await self.hang()
        await self.passes(HANGS_S)
        if not await self.take_over():
            await self._lease(action="acquire", name=OTHER)
        self.other.call("/dji_sdk/sdk_control_authority", control_enable=1)
        await self.passes(0.5)
        self.other.call("/dji_sdk/drone_task_control", task=6)

    def near(self) -> AgentClient:
        """The client beside the agent, by which this front's orders come."""
        found: AgentClient = self.rig.front
        return found

    async def stop_unheard(self) -> None:
        """STOP before the last step of a request for control, whose front hears of none."""
        await self.take_over_and_give_back()
        client, ask = self.near(), self.near().ask

        async def overtaken(order: orders.Order, *rest: Any, **more: Any) -> Any:
            if isinstance(order, orders.Obtain):
                await anyio.sleep(0.01)
                await self.agent.stop()
            return await ask(order, *rest, **more)

        with patch.object(client, "on_event", []), patch.object(client, "ask", overtaken):
            with suppress(M100Error, AssertionError):  # it is refused
                await self.take_control()
            await self.passes(0.5)

    async def hold_up(self) -> None:
        """What the front says is on its way to the agent for a second."""
        self.let_go()
        await self.passes(2.5)
        held: list[Any] = []
        with patch.object(self.channels[0], "send", held.append):
            for _ in range(10):
                self.send()
                await self.tick()
            await self.passes(1.0)
        for one in held:
            self.channels[0].send(one)

    def _give_up(self) -> None:
        """Control is given back, or a request for it is called off."""
        raise NotImplementedError

    def _ask_for_control(self) -> None:
        """Ask, and do not wait for the answer."""
        raise NotImplementedError

    async def call_off(self) -> None:
        """Give control back, and call requests for it off at several moments."""
        self._give_up()
        await self.passes(1.0)
        assert await self.holder() == "", "it was not given back"
        for seconds in (0.0, 0.001, 0.01, 0.03, 0.1):
            self._ask_for_control()
            await anyio.sleep(seconds)
            self._give_up()
            await self.passes(0.3)

    async def stop_elsewhere(self) -> None:
        """STOP at a page, which needs no control."""
        self.other_page.say("stop")

    async def hover_elsewhere(self) -> None:
        """The button *Hover* of a page that has no control."""
        tab = self.other_page.tab
        tab.agent.hover("hover", tab.session.lease)

    async def take_off(self) -> None:
        """Take control on the ground, and take off: not waited for."""
        await self.take_control()
        self.order(orders.TakeOff())

    async def land(self) -> None:
        self.order(orders.Land())

    def order(self, order: orders.Order) -> None:
        """Take off, land or go home, while the program goes on."""
        raise NotImplementedError

    async def leave(self) -> None:
        """The user's program or page has gone."""
        self.is_there = False

    async def step_unheard(self) -> None:
        """A program's next step, after a STOP between two that its front did not hear, either."""
        self.let_go()
        await self.passes(2.0)
        with patch.object(self.near(), "on_event", []):
            await self.agent.stop()
            await self.passes(0.5)
            self.order(orders.GoHome())
            await self.passes(0.5)

    async def holder(self) -> str:
        """By whom control is held, in words for people; empty for nobody."""
        found: str = (await self._lease(action="status"))["holder"]
        return found

    async def lose_agent(self) -> None:
        """Not a byte more from it, to the aircraft or to the front."""
        self.aircraft.stall_line()
        self.channels[1].close()


# -- the station: rosbridge and the console --------------------------------------------------------


class Page(BesideAnAgent):
    """A tab of a browser."""

    page: Browser

    async def take_control(self) -> None:
        self.page.say("alive")
        await self.page.tab.session.ask(orders.Activate())
        await self.page.tab.session.obtain()
        await self.passes(0.2)

    def send(self) -> None:
        answer = self.page.beat(2, y=SPEED_M_S)
        if answer is not None:
            self.heard += [f"the pad shows {answer['fate']}", self.page.problem]

    def be_heard(self) -> None:
        if not self.is_sending:
            self.page.say("alive")

    async def stop(self) -> None:
        self.page.say("stop")

    def order(self, order: orders.Order) -> None:
        tab = self.page.tab
        self.spawn(tab.attempt(lambda: tab.session.ask(order)))

    async def leave(self) -> None:
        await super().leave()
        self.page.tab.close()

    def _give_up(self) -> None:
        self.page.tab.session.let_go()

    def _ask_for_control(self) -> None:
        self.spawn(self.page.tab.session.obtain())

    async def order_late(self) -> None:
        """A button that was pressed three seconds ago."""
        tab, at = self.page.tab, 1000 * (self.page.now - 3.0)

        async def pressed() -> None:
            tab.check_order(at)
            await tab.session.ask(orders.GoHome())

        await tab.attempt(pressed)
        self.heard.append(self.page.problem)

    def let_go(self) -> None:
        super().let_go()
        self.page.say("rest")

    def send_late(self) -> None:
        """Said a second ago, when the station was heard a second ago as well."""
        page = self.page
        said = json.loads(page.message("beat", mode=2, x=0, y=SPEED_M_S, z=0, w=0))
        said["at"], said["told"] = said["at"] - 1000, said["told"] - 1.0
        page.hear(page.tab.receive(json.dumps(said)))
        self.heard.append(page.problem)

    def send_junk(self) -> None:
        for text in (
            self.chance.randbytes(40),
            "{",
            "[]",
            '{"op": "beat"}',
            '{"op": "beat", "n": 1e9, "at": null, "mode": "x"}',
            '{"op": "stap", "n": 100000, "at": 1}',
        ):
            self.page.tab.receive(text)

    def words(self) -> str:
        events = [one.text for one in self.page.tab.agent.events]
        return "\n".join([*self.heard, *events])


class Station(BesideAnAgent):
    @asynccontextmanager
    async def open(self) -> AsyncIterator[None]:
        self.aircraft = VirtualAircraft(seed=5)
        put_in_the_air(self.aircraft, HEIGHT_M)
        self.rig = station.Rig(self.aircraft)
        async with self.rig.running(), AsyncExitStack() as stack:
            self.agent, self.channels = self.rig.agent, self.rig.channels
            await stack.enter_async_context(self.beside(self.rig.service))
            await self.come()
            yield

    async def come(self) -> None:
        """The user opens a page, or connects."""

    async def kill(self) -> None:
        self.is_there = False
        self.channels[0].close()


class Console(Page, Station):
    """A page of the station."""

    name = "console"

    async def come(self) -> None:
        self.page = Browser(self.rig, "tab")


_JOY = "/dji_sdk/flight_control_setpoint_ENUvelocity_yawrate"


class Rosbridge(Station):
    """A program with roslib."""

    name = "rosbridge"
    axes: tuple[float, ...] = (0.0, SPEED_M_S, 0.0, 0.0)  # east, north, up, m/s; yaw rate

    async def come(self) -> None:
        self.client = self.rig.client("program")
        self.client.subscribe("/nav_open_close_status", "/rosout", "/flight_status")
        self.client.send("advertise", topic=_JOY, type="sensor_msgs/Joy")

    async def take_control(self) -> None:
        for service, said in (
            ("/dji_sdk/activation", {}),
            ("/dji_sdk/sdk_control_authority", {"control_enable": 1}),
        ):
            count = len(self.client.answers())
            self.client.call(service, **said)
            await self.passes(3.0, lambda count=count: len(self.client.answers()) > count)  # type: ignore[misc]
            assert self.client.answers()[-1]["result"], self.client.answers()[-1]

    def _joy(self, age: float = 0.0) -> None:
        secs, part = divmod(1e6 + self.now() - age, 1.0)
        header = {"stamp": {"secs": int(secs), "nsecs": int(part * 1e9)}}
        self.client.send("publish", topic=_JOY, msg={"header": header, "axes": self.axes})

    def send(self) -> None:
        self._joy()

    def _switch(self, enable: int) -> None:
        self.client.call("/dji_sdk/sdk_control_authority", control_enable=enable)

    def _give_up(self) -> None:
        self._switch(0)

    def _ask_for_control(self) -> None:
        self._switch(1)

    async def too_fast(self) -> None:
        await super().too_fast()
        assert self.client.session.close_reason is None

    async def stop(self) -> None:
        self.client.call("/m100link/stop")

    async def hang(self) -> None:
        """The station's WebSockets cut a client off that answers no ping, at latest after this."""
        await super().hang()
        asyncio.get_running_loop().call_later(PINGED_WITHIN_S, self.client.leave)

    def order(self, order: orders.Order) -> None:
        self.client.call("/dji_sdk/drone_task_control", task=self.number(order))

    @staticmethod
    def number(order: orders.Order) -> int:
        return {"take off": 4, "land": 6, "go home": 1}[order.label]

    async def leave(self) -> None:
        await super().leave()
        self.client.leave()

    def send_late(self) -> None:
        self._joy(age=1.0)

    def send_junk(self) -> None:
        session = self.client.session
        for text in (
            self.chance.randbytes(40).decode("latin-1"),
            "{",
            '{"op": "publish", "topic": "/sdk_request_cmd", "msg": {"data": "6"}}',
            '{"op": "publish", "topic": "/sdk_request_cmd", "msg": {"data": 1e999}}',
            '{"op": "call_service", "service": "/dji_sdk/activation", "args": {"task": []}}',
        ):
            session.receive(text, self.now())

    def words(self) -> str:
        said = []
        for one in self.client.read():
            message = one.get("msg")
            if one["op"] == "status":
                said.append(str(message))
            elif one["op"] == "service_response" and not one["result"]:
                said.append(str(one["values"]))
            elif one.get("topic") == "/rosout":
                said.append(str(message["msg"]))
            elif one.get("topic") in ("/nav_open_close_status", "/flight_status"):
                said.append(f"{one['topic']} {message['data']:g}")
        return "\n".join(said)


class Rosbridge2015(Rosbridge):
    """The same by the topic of 2015."""

    def order(self, order: orders.Order) -> None:
        self.client.send("publish", topic="/sdk_request_cmd", msg={"data": self.number(order)})


class Rosbridge2016(Rosbridge):
    """The same by the action of 2016."""

    def order(self, order: orders.Order) -> None:
        task = {"task": {4: 1, 6: 2, 1: 3}[self.number(order)]}
        self.client.send("publish", topic="/dji_sdk/drone_task_action/goal", msg={"goal": task})


# -- MAVLink and ROS 2 -----------------------------------------------------------------------------


class AloneWithAgent(BesideAnAgent):
    """A front with an agent of its own."""

    def near(self) -> AgentClient:
        found: AgentClient = self.rig.client
        return found

    @abstractmethod
    def make(self) -> Any:
        """The rig of its room."""

    @asynccontextmanager
    async def open(self) -> AsyncIterator[None]:
        self.rig = self.make()
        self.aircraft, self.agent = self.rig.aircraft, self.rig.agent
        async with self.rig.running(), AsyncExitStack() as stack:
            # The front has seen it on the ground, and so knows its home.
            put_in_the_air(self.aircraft, HEIGHT_M)
            self.channels = self.rig.channels
            await stack.enter_async_context(self.beside(self.rig.service))
            await anyio.sleep(0.5)
            yield

    async def kill(self) -> None:
        self.is_there = False
        self.rig.work.cancel()
        self.channels[0].close()


class Mavlink(AloneWithAgent):
    """A program with MAVSDK: setpoints in Offboard, heartbeats once a second."""

    name = "MAVLink"
    told, told_at = 0, 0.0  # how much the vehicle said, and when last

    def make(self) -> Any:
        return mavlink.Rig()

    async def _in_mode(self, mode: str) -> None:
        ground = self.rig.ground
        work = ground.set_mode(Mode[mode])
        result = await work
        self.heard.append(f"mode {mode}: {result.name}")

    async def take_control(self) -> None:
        if not self.rig.client.holder.number:
            await self.rig.ground.arm()
        self.send()
        await self._in_mode("OFFBOARD")

    def send(self) -> None:
        send_velocity(self.rig.ground, vx=SPEED_M_S)

    def be_heard(self) -> None:
        ground = self.rig.ground
        ground.is_silent = False
        if len(ground.heard) > self.told:
            self.told, self.told_at = len(ground.heard), self.now()

    async def hang(self) -> None:
        await super().hang()
        self.rig.ground.is_silent = True

    async def stop(self) -> None:
        self.spawn(self._in_mode("HOLD"))

    async def take_off(self) -> None:
        await self.rig.ground.arm()
        self.rig.ground.command(MavCommand.NAV_TAKEOFF)

    def order(self, order: orders.Order) -> None:
        self.spawn(self._in_mode({"land": "LAND", "go home": "RTL"}[order.label]))

    async def leave(self) -> None:
        await self.hang()

    def send_late(self) -> None:
        self.send()

    def send_junk(self) -> None:
        for data in (
            self.chance.randbytes(60),
            b"\xfd" + self.chance.randbytes(60),
            b"\xfd\x09\x00\x00\x00\xf5\xbe\x00\x00\x00" + self.chance.randbytes(11),
        ):
            self.rig.bridge.received(data, self.rig.ground.address)
            self.rig.bridge.received(data, ("127.0.0.1", 9))

    def words(self) -> str:
        ground = self.rig.ground
        modes = ["no heartbeat"] if self.now() - self.told_at > 2.0 else []
        modes += [
            f"is in {mavlink.MODE_OF[one['custom_mode']].name}" for one in ground.all("HEARTBEAT")
        ]
        return "\n".join([*modes, *self.heard, *ground.texts.split("\n")])


class Ros2(AloneWithAgent):
    """A program of ROS 2: cmd_vel 20 times a second."""

    name = "ROS 2"

    def make(self) -> Any:
        return ros2.Rig()

    async def _call(self, service: str) -> None:
        answer = await self.rig.program.call(service)
        self.heard.append(f"{service}: {answer['success']} {answer.get('message', '')}")

    async def take_control(self) -> None:
        await self._call("~/obtain_control")

    def send(self) -> None:
        self.rig.program.speed(SPEED_M_S)  # its nose points to the north

    def _give_up(self) -> None:
        self.spawn(self._call("~/release_control"))

    def _ask_for_control(self) -> None:
        self.spawn(self._call("~/obtain_control"))

    async def stop(self) -> None:
        self.spawn(self._call("~/stop"))

    def order(self, order: orders.Order) -> None:
        name = {"take off": "takeoff", "land": "land", "go home": "go_home"}[order.label]
        self.spawn(self._call(f"~/{name}"))

    def send_late(self) -> None:
        self.rig.program.late = 1.0
        self.send()
        self.rig.program.late = 0.0

    def send_junk(self) -> None:
        for name, inbox in self.rig.bus.inboxes.items():
            if "cmd_vel" in name:
                for size in (0, 3, 60):
                    data = self.chance.randbytes(size)
                    inbox.waiting.append(Received(data, self.chance.randbytes(size)))

    def words(self) -> str:
        wrong = [
            f"{one['name']}: {one['message']}"
            for message in self.rig.said("/diagnostics")
            for one in message["status"]
            if one["level"] not in (b"\0", 0)
        ]
        return "\n".join([*wrong, *self.heard, *self.rig.texts.split("\n")])


# -- a fleet ---------------------------------------------------------------------------------------


class OfAFleet(BesideAnAgent):
    """An aircraft of a fleet, flown from elsewhere over the network."""

    def near(self) -> AgentClient:
        found: AgentClient = self.one.client
        return found

    def make(self) -> VirtualAircraft:
        aircraft = VirtualAircraft(seed=5)
        put_in_the_air(aircraft, HEIGHT_M)
        return aircraft

    @asynccontextmanager
    async def open(self) -> AsyncIterator[None]:
        self.rig = fleet.Rig()
        self.aircraft = self.make()
        async with self.rig.stack:
            self.one = await self.rig.served("a1", virtual=self.aircraft)
            self.agent, self.channels = self.one.agent, self.one.channels
            self.pilot = await self.rig.pilot("pilot")
            async with self.beside(self.one.service), AsyncExitStack() as stack:
                await self.come(stack)
                yield

    async def come(self, stack: AsyncExitStack) -> None:
        """The user is there."""

    def junk_for(self, heard: str) -> None:
        """Under each key that the agent serves, and one that it hears."""
        bus, keys = self.rig.network.session(), Keys(fleet.SITE, "a1")
        for size in (0, 3, 60, 600):
            data = self.chance.randbytes(size)
            bus.publish(heard).put(data)
            for key in (keys.command, keys.lease, keys.show):
                self.spawn(bus.ask(key, data, timeout=0.1))

    async def stop_elsewhere(self) -> None:
        """Anybody of the fleet may."""
        anybody = await self.rig.pilot("anybody")
        self.spawn(anybody["a1"].stop())

    async def hang(self) -> None:
        """The whole process, the renewal of its lease with it."""
        await super().hang()
        self.rig.cut(self.pilot)

    async def kill(self) -> None:
        """The user's process, which is on the ground; the front on board dies with its agent."""
        await self.hang()

    async def lose_agent(self) -> None:
        self.aircraft.stall_line()
        self.rig.network.cut(self.one.bus)
        self.one.work.cancel()
        self.channels[1].close()


class FleetPilot(OfAFleet):
    """A program with ``fleet[name].control()``."""

    name = "fleet pilot"

    def __init__(self) -> None:
        super().__init__()
        self.is_over = asyncio.Event()
        self.control: Any = None

    async def take_control(self) -> None:
        """A block of control; the one before is left first."""
        self.is_over.set()
        await self.passes(0.5)
        self.is_over, self.control = asyncio.Event(), None
        self.spawn(self._fly())
        await self.passes(4.0, lambda: self.control is not None)

    async def _fly(self) -> None:
        async with self.pilot["a1"].control() as control:
            self.control = control
            await self.is_over.wait()

    def send(self) -> None:
        try:
            self.control.send(NORTH)
        except Exception as error:  # noqa: BLE001 - the user reads it, whatever it is
            self.heard.append(f"{type(error).__name__}: {error}")

    def _give_up(self) -> None:
        self.is_over.set()
        self.tasks[-1].cancel()

    def _ask_for_control(self) -> None:
        self.is_over = asyncio.Event()
        self.spawn(self._fly())

    async def order_late(self) -> None:
        """An order to go home of six seconds ago."""
        (fence, token), asker = self.control.proof, self.pilot.asker("a1")
        clock = self.agent.now - 6.0
        self.spawn(asker.ask(orders.GoHome(), fence=fence, token=token, clock=clock))
        await self.passes(0.5)

    async def stop(self) -> None:
        self.spawn(self.control.stop())

    def order(self, order: orders.Order) -> None:
        self.spawn(getattr(self.control, order.label.replace(" ", "_"))())

    def send_late(self) -> None:
        """It waits on its way for a second."""
        weather, self.rig.network.weather = self.rig.network.weather, Weather(delay_s=1.0)
        self.send()
        self.rig.network.weather = weather

    def send_junk(self) -> None:
        self.junk_for(Keys(fleet.SITE, "a1").setpoint)

    def words(self) -> str:
        return "\n".join(dict.fromkeys(self.heard))


class FarConsole(Page, OfAFleet):
    """A page of ``m100link fleet console``."""

    name = "far console"

    async def come(self, stack: AsyncExitStack) -> None:
        ships = Ships(self.pilot, stack)
        await ships.show("a1")
        far = ships.agents["a1"]
        await self.rig.until(lambda: far.is_connected)
        rig: Any = SimpleNamespace(front=far, agent=far)
        self.page = Browser(rig, "tab")


class Performer(OfAFleet):
    """A show of one, conducted from elsewhere."""

    name = "show"
    flown = track("a1", (0, 0, 0, 2), (30, 60, 0, 2))

    def make(self) -> VirtualAircraft:
        place = AircraftSettings(latitude_deg=ORIGIN[0], longitude_deg=ORIGIN[1])
        return VirtualAircraft(seed=5, settings=place)

    async def come(self, stack: AsyncExitStack) -> None:
        keys = Keys(fleet.SITE, "a1")
        self.service = ShowService(self.one.client, self.one.bus, keys, self.one.fleet_agent.boot)
        self.agent.background.spawn(self.service.run(), "show")
        self.conductor = Conductor(
            self.pilot.bus,
            fleet.SITE,
            "anna",
            Show("", (self.flown,)),
            leave="hover",
            tell=self.heard.append,
            utc=self.rig.utc,
        )

    async def take_control(self) -> None:
        self.spawn(self.conductor.fly())
        await self.passes(60.0, lambda: any("begins in" in one for one in self.heard))
        await self.passes(5.5)

    def send(self) -> None:
        """Nothing is sent while it flies."""

    async def stop(self) -> None:
        """The conductor lets all leave."""
        self.spawn(self.conductor.leave())

    async def land(self) -> None:
        self.spawn(self.pilot["a1"].land())

    def send_late(self) -> None:
        """The order to take its place, once more."""
        self.spawn(self.conductor._ask(self.flown, TakePlace(self.conductor._run)))

    def send_junk(self) -> None:
        self.junk_for(Keys(fleet.SITE).place)

    def words(self) -> str:
        return "\n".join(self.heard)


# -- a program without await -----------------------------------------------------------------------


class Sync(Front):
    """A program with ``m100link.sync``; its aircraft lives in a thread with a clock of its own."""

    name = "sync"
    has_agent = False

    @asynccontextmanager
    async def open(self) -> AsyncIterator[None]:
        self.aircraft = VirtualAircraft(seed=5)
        put_in_the_air(self.aircraft, HEIGHT_M)
        portals: list[Portal] = []

        def portal(_: object) -> Portal:
            portals.append(Portal(LockstepEventLoop))
            return portals[-1]

        with ExitStack() as stack:
            stack.enter_context(patch.object(sync_aircraft, "Portal", portal))
            stack.enter_context(patch.object(driver, "aircraft_of", lambda _: self.aircraft))
            # It flies on when its line is gone, as a real one.
            stack.enter_context(patch.object(driver, "_OwnedPort", driver.StreamPort))
            found = self.connected = stack.enter_context(sync.connect("sim://"))
            self.portal = portals[0]
            found.activate(self.aircraft.credentials)
            yield
            stack.callback(self._tried, lambda: self.control.release())

    def _tried(self, work: Callable[[], object]) -> None:
        try:
            work()
        except M100Error as error:
            self.heard.append(f"{type(error).__name__}: {error}")

    def now(self) -> float:
        return self.portal.call(lambda: asyncio.get_running_loop().time())

    async def tick(self) -> None:
        self.portal.wait(lambda _: asyncio.sleep(STEP_S))

    async def take_control(self) -> None:
        self.control = self.connected.control().obtain()

    def send(self) -> None:
        self._tried(lambda: self.control.send(NORTH))

    async def stop(self) -> None:
        self.control.interrupt()

    async def land(self) -> None:
        self._tried(self.control.land)

    def send_late(self) -> None:
        """There is no way on which one could be late."""

    def send_junk(self) -> None:
        for north in (math.nan, math.inf, 1e9):
            with suppress(BadSetpoint):
                self.control.send(
                    Setpoint.velocity(north=north, east=0.0, up=0.0, yaw_rate_deg_s=0.0)
                )

    async def kill(self) -> None:
        """Of a line in memory nobody is left: see where processes do it."""

    def words(self) -> str:
        return "\n".join(self.heard)
