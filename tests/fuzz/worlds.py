"""Readers with a virtual aircraft behind them, on virtual time: no stranger moves it.

Each world hovers, or stands, under somebody's control, and a stranger sends the inputs. A world is
begun anew when a stranger did what everybody may: let it land.
"""

from __future__ import annotations

import asyncio
import json
import logging
import math
import os
import socket
import struct
import tempfile
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import AbstractAsyncContextManager, AsyncExitStack, asynccontextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import crcmod

from m100link.apps.agent import orders
from m100link.apps.agent.codec import encode as encode_message
from m100link.apps.agent.lease import Lease
from m100link.apps.agent.messages import VERSION as MESSAGES_VERSION
from m100link.apps.agent.messages import (
    Ask,
    Event,
    Hello,
    JournalNote,
    LeaseChanged,
    MessageError,
    State,
    Steer,
    Telemetry,
)
from m100link.apps.agent.orders import (
    AskVersion,
    LeaseOrder,
    Right,
)
from m100link.apps.agent.server.server import AgentServer
from m100link.apps.agent.transports import UnixChannel
from m100link.apps.bus.network import Question, Received
from m100link.apps.fleet.asking import Asker
from m100link.apps.fleet.keys import Keys
from m100link.apps.fleet.logs.service import LogService
from m100link.apps.fleet.logs.words import unpack_reply
from m100link.apps.fleet.payloads import (
    VERSION,
    Asked,
    AskShow,
    Card,
    LeaveShow,
    LoadTrack,
    LogQuestion,
    MissionCard,
    OrderMessage,
    OrderReply,
    Outcome,
    Progress,
    SendTrack,
    StartShow,
    TakePlace,
    What,
    pack,
    pack_steer,
    unpack,
)
from m100link.apps.fleet.publisher import FleetTelemetry
from m100link.apps.fleet.show.plan.conflicts import ConflictMonitor
from m100link.apps.fleet.show.service import ShowService
from m100link.apps.mavlink.translator.codec import LAYOUTS, MavlinkMessage, write_frame
from m100link.apps.mavlink.translator.numbers import MavCommand
from m100link.apps.mavlink.translator.vehicle_state import Mode
from m100link.apps.ros2.graph import data_key, write_attachment
from m100link.apps.ros2.topics import INPUTS, SERVICES
from m100link.errors import M100Error
from m100link.log.cdr import encode as encode_cdr
from m100link.protocol.setpoint import Setpoint
from m100link.sim.clock import VirtualClockEventLoop
from m100link.sim.virtual import VirtualAircraft
from tests.apps.agent.conftest import task_of
from tests.apps.agent.examples import EXAMPLES as ORDERS
from tests.apps.fleet.conftest import SITE
from tests.apps.fleet.conftest import Rig as FleetRig
from tests.apps.fleet.show.shows import track
from tests.apps.fleet.test_agent import in_the_air
from tests.apps.mavlink.conftest import Ground
from tests.apps.mavlink.conftest import Rig as MavlinkRig
from tests.apps.ros2.conftest import Program
from tests.apps.ros2.conftest import Rig as Ros2Rig
from tests.apps.station.conftest import Rig as StationRig
from tests.apps.station.console.test_tab import Browser

__all__ = [
    "Spoiled",
    "Still",
    "Take",
    "World",
    "agent_seeds",
    "datagrams",
    "fleet_seeds",
    "on_board",
    "on_bridge",
    "on_console",
    "on_node",
    "on_pilot",
    "on_socket",
    "page_seeds",
    "pilot_seeds",
    "ros2_seeds",
    "station",
]

Take = Callable[[bytes], Awaitable[None]]

_INPUTS_PER_WORLD = 500
_NEAR_M = 1.0
"""What a hover wanders without wind, with room."""


class Spoiled(Exception):
    """The input did what everybody may, and the next one needs another world."""


class _Errors(logging.Handler):
    """Errors of other kinds than the package's that were logged instead of raised."""

    def __init__(self) -> None:
        super().__init__(logging.WARNING)
        self.found: list[BaseException] = []

    def emit(self, record: logging.LogRecord) -> None:
        error = record.exc_info[1] if record.exc_info else None
        if error is not None and not isinstance(error, M100Error):
            self.found.append(error)

    def of_loop(self, _: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
        error = context.get("exception")
        if error is None:
            self.found.append(AssertionError(context["message"]))
        elif not isinstance(error, M100Error):
            self.found.append(error)


class World:
    """A reader on an event loop of its own.

    Args:
        running: Gives what takes an input, while the block runs.
    """

    def __init__(self, running: Callable[[], AbstractAsyncContextManager[Take]]) -> None:
        self._running = running
        self._loop: asyncio.AbstractEventLoop | None = None
        self._left = 0

    def begin(self) -> None:
        """Begin anew with the next input."""
        loop, self._loop = self._loop, None
        if loop is not None:
            self._over.set()
            with suppress(M100Error):
                loop.run_until_complete(self._serving)
            loop.close()
            logging.getLogger("m100link").removeHandler(self._errors)

    def ready(self) -> None:
        """Start if need be, so that no input is charged with a take-off."""
        if self._left <= 0 or self._loop is None:
            self.begin()
            self._start()

    def __call__(self, data: bytes) -> None:
        """Take an input; raises what went wrong anywhere."""
        self.ready()
        assert self._loop is not None
        self._left -= 1
        try:
            self._loop.run_until_complete(self._take(data))
        except Spoiled:
            self._left = 0
        if self._errors.found:  # all of this input: none is that of the next one
            found, self._errors.found = self._errors.found, []
            raise found[0]

    def _start(self) -> None:
        self._loop = loop = VirtualClockEventLoop()
        self._left, self._over = _INPUTS_PER_WORLD, asyncio.Event()
        self._errors = _Errors()
        loop.set_exception_handler(self._errors.of_loop)
        logging.getLogger("m100link").addHandler(self._errors)
        is_ready = loop.create_future()
        self._serving = loop.create_task(self._serve(is_ready))
        loop.run_until_complete(
            asyncio.wait((is_ready, self._serving), return_when=asyncio.FIRST_COMPLETED)
        )
        if not is_ready.done():
            self._serving.result()  # raises why it did not begin
        self._take: Take = is_ready.result()

    async def _serve(self, is_ready: asyncio.Future[Take]) -> None:
        async with self._running() as take:
            is_ready.set_result(take)
            await self._over.wait()


class Still:
    """Where an aircraft hovers, or that it stands."""

    def __init__(self, aircraft: VirtualAircraft) -> None:
        self._aircraft = aircraft
        self._place, self._height = aircraft.position, aircraft.height
        self._is_running = aircraft.vehicle.flight.dynamics.motors_on

    @property
    def off_m(self) -> float:
        """How far it is from there."""
        place = math.dist(self._aircraft.position, self._place)
        return max(place, abs(self._aircraft.height - self._height))

    @property
    def has_moved(self) -> bool:
        """Whether it did, or its motors run that did not."""
        is_running = self._aircraft.vehicle.flight.dynamics.motors_on
        return self.off_m >= _NEAR_M or is_running != self._is_running

    def check(self) -> None:
        """Fail if it did."""
        is_running = self._aircraft.vehicle.flight.dynamics.motors_on
        seen = f"moved {self.off_m:.1f} m, motors on: {is_running}, and nobody wanted it"
        assert not self.has_moved, seen


# -- MAVLink --------------------------------------------------------------------------------------

_crc = crcmod.mkCrcFun(0x11021, initCrc=0xFFFF, rev=True, xorOut=0)
_BY_NUMBER = {layout.number: layout for layout in LAYOUTS.values()}
_ANYBODY = (Mode.LAND, Mode.RTL)


def _right(data: bytes) -> bytes:
    """The same with right checksums, as far as one frame follows another."""
    made, at = bytearray(data), 0
    while at + 12 <= len(made) and made[at] == 0xFD:
        end = at + 10 + made[at + 1] + 2
        layout = _BY_NUMBER.get(int.from_bytes(made[at + 7 : at + 10], "little"))
        if layout is not None and end <= len(made):
            made[end - 2 : end] = struct.pack(
                "<H", _crc(bytes(made[at + 1 : end - 2]) + bytes([layout.crc_extra]))
            )
        at = end
    return bytes(made)


def datagrams() -> list[bytes]:
    """Every message that there is, as a ground station sends it."""
    aim = {"target_system": 1, "target_component": 1}
    seeds = [
        write_frame(MavlinkMessage(name, {}), system=250, sequence=number)
        for number, name in enumerate(LAYOUTS)
    ]
    place = {"x": 521_000_000, "y": 43_100_000, "z": 10.0, "frame": 6, "autocontinue": 1} | aim
    route: list[tuple[str, Any]] = [("MISSION_COUNT", {"count": 2} | aim)]
    route += [("MISSION_ITEM_INT", {"seq": at, "command": 16} | place) for at in range(2)]
    seeds.append(
        b"".join(
            write_frame(MavlinkMessage(name, fields), system=250, sequence=at)
            for at, (name, fields) in enumerate(route)
        )
    )
    for name in ("MPC_XY_CRUISE", "COM_OF_LOSS_T"):
        given = MavlinkMessage(
            "PARAM_SET", {"param_id": name, "param_value": 5.0, "param_type": 9} | aim
        )
        seeds.append(write_frame(given, system=250, sequence=0))
    for command in MavCommand:
        asked = MavlinkMessage("COMMAND_LONG", {"command": int(command), "param1": 1.0} | aim)
        seeds.append(write_frame(asked, system=250, sequence=0))
    return seeds


@asynccontextmanager
async def on_bridge() -> AsyncIterator[Take]:
    """One ground station hovers, and another one sends datagrams."""
    async with MavlinkRig().running() as rig:
        await rig.ground.fly(3.0)
        other = Ground(rig, ("127.0.0.1", 7000), 250)
        other.beat()
        await asyncio.sleep(2.0)
        still = Still(rig.aircraft)

        async def take(data: bytes) -> None:
            rig.bridge.received(data, other.address)
            rig.bridge.received(_right(data), other.address)
            await asyncio.sleep(0.02)
            for ground in rig.grounds:
                ground.heard.clear()
            rig.sent.clear()
            assert not rig.work.done(), "the bridge has ended"
            if rig.vehicle.manager.mode in _ANYBODY:
                raise Spoiled
            still.check()

        yield take


# -- the agent's socket ---------------------------------------------------------------------------


def _framed(*bodies: bytes) -> bytes:
    return b"".join(struct.pack("<I", len(body)) + body for body in bodies)


_HELLO = _framed(encode_message(Hello(MESSAGES_VERSION, "a front", 1.0)))
_NORTH = Setpoint.velocity(north=3.0, east=0.0, up=0.0, yaw_rate_deg_s=0.0)


def agent_seeds() -> list[bytes]:
    """Messages of a front, alone and in a row."""
    messages: list[Any] = [
        Steer(1, 12.0, 0.3, _NORTH),
        JournalNote("warning", "a note"),
        *(Ask(5, order, 1) for order in ORDERS),
    ]
    bodies = [encode_message(one) for one in messages]
    return [_framed(one) for one in bodies] + [_framed(*bodies[:6])]


class _Wire(asyncio.Transport):
    """A connection of this user whose bytes go nowhere."""

    def __init__(self, end: socket.socket) -> None:
        super().__init__({"socket": end})
        self.is_closed = False

    def pause_reading(self) -> None:
        """Nothing is read by it."""

    resume_reading = pause_reading

    def get_write_buffer_size(self) -> int:
        return 0

    def write(self, data: object) -> None:
        """It has gone out."""

    def close(self) -> None:
        self.is_closed = True

    abort = close


async def _held(rig: StationRig) -> Lease:
    """Control of the aircraft, kept as long as the world is."""
    front = rig.front
    lease = await front.acquire("the pilot")
    await front.ask(orders.Activate(), lease)
    await front.ask(orders.Obtain(), lease)

    async def keep() -> None:
        while True:
            front.keep(lease)
            await asyncio.sleep(0.2)

    front.background.spawn(keep(), "the pilot")
    return lease


@asynccontextmanager
async def station() -> AsyncIterator[StationRig]:
    async with StationRig(VirtualAircraft(seed=5)).running() as rig:
        yield rig


@asynccontextmanager
async def on_socket() -> AsyncIterator[Take]:
    """One front hovers, and another one sends messages."""
    ours, theirs = socket.socketpair()
    async with station() as rig:
        lease = await _held(rig)
        await rig.front.ask(orders.TakeOff(), lease)
        await rig.until(lambda: task_of(rig.agent) is None)
        still = Still(rig.aircraft)
        service = AgentServer(rig.agent)

        async def take(data: bytes) -> None:
            channel = UnixChannel(service.attach)
            wire = _Wire(ours)
            channel.connection_made(wire)
            rest = _HELLO + data
            while rest and not wire.is_closed:
                room = channel.get_buffer(-1)
                size = min(len(room), len(rest))
                assert size, "no room for what comes, and nothing is refused"
                room[:size], rest = rest[:size], rest[size:]
                channel.buffer_updated(size)
            await asyncio.sleep(0.02)
            channel.connection_lost(None)
            still.check()

        yield take
    ours.close()
    theirs.close()


# -- the console's page ---------------------------------------------------------------------------


def page_seeds() -> list[bytes]:
    """What a page says."""
    beat: dict[str, Any] = {"op": "beat", "n": 1, "at": 1000.0, "mode": 1}
    beat |= {"x": 0, "y": 0, "z": 0, "w": 0}
    told: dict[str, Any] = {"told": 1.0, "held": 20.0}
    said = [
        beat,
        beat | told | {"n": 2, "x": 0.5},
        *(more | {"op": op, "n": 3, "at": 1e3} for more in (told, {}) for op in ("alive", "rest")),
        {"op": "stop", "n": 4, "at": 1e3, "press": 1},
    ]
    return [json.dumps(one).encode() for one in said]


@asynccontextmanager
async def on_console() -> AsyncIterator[Take]:
    """A tab with control stands on the ground, another one has none; both say the same."""
    async with station() as rig:
        mine, other = Browser(rig), Browser(rig, "another")
        await mine.tab.session.ask(orders.Activate())
        await mine.tab.session.obtain()
        still = Still(rig.aircraft)

        async def take(data: bytes) -> None:
            for tab in (mine.tab, other.tab):
                for one in (data, data.decode("utf-8", "replace")):
                    json.dumps(tab.receive(one), allow_nan=False)
            if not mine.tab.session.has_lease:
                raise Spoiled
            # Numbers of messages rise: what was sent once would be passed over for ever.
            mine.tab._last_number = other.tab._last_number = -1
            await asyncio.sleep(0.02)
            still.check()

        yield take


# -- ROS 2 ----------------------------------------------------------------------------------------

_CALLED = tuple(name for name in SERVICES if name != "~/obtain_control")
"""Without control none of them moves anything."""


def ros2_seeds() -> list[bytes]:
    """An end by its number, whether its attachment is right, and CDR."""
    empty: dict[str, Any] = {
        "~/cmd_vel": {"header": _STAMP, "twist": _TWIST},
        "~/cmd_vel_unstamped": _TWIST,
        "~/setpoint_position": {
            "header": _STAMP,
            "pose": {"position": _ZEROS, "orientation": _ZEROS | {"w": 1.0}},
        },
        "~/gimbal_speed": {"header": _STAMP, "vector": _ZEROS},
    }
    seeds = [
        bytes([number, 1]) + encode_cdr(INPUTS[name].kind, empty[name])
        for number, name in enumerate(INPUTS)
    ]
    plain = write_attachment(1, 1_800_000_000_000_000_000, b"\1" * 16)
    seeds += [bytes([one[0], 0]) + plain + one[2:] for one in seeds]
    seeds += [bytes([len(INPUTS) + number, 1]) + _HEAD + bytes(4) for number in range(len(_CALLED))]
    return seeds


_HEAD = b"\0\1\0\0"
_ZEROS = {"x": 0.5, "y": 0.0, "z": 0.0}
_TWIST = {"linear": _ZEROS, "angular": _ZEROS}
_STAMP = {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": "base_link"}


@asynccontextmanager
async def on_node() -> AsyncIterator[Take]:
    """Programs publish and call, and none of them has control."""
    async with Ros2Rig().running() as rig:
        still = Still(rig.aircraft)

        async def take(data: bytes) -> None:
            program = Program(rig, 2)
            number, is_right = (data + b"\0\0")[:2]
            rest, attachment = data[2:], program.attachment()
            if not is_right:
                attachment, rest = rest[: len(attachment)], rest[len(attachment) :]
            number %= len(INPUTS) + len(_CALLED)
            if number < len(INPUTS):
                name = list(INPUTS)[number]
                rig.inbox(name, INPUTS[name].kind).waiting.append(Received(rest, attachment))
            else:
                name = _CALLED[number - len(INPUTS)]
                kind = SERVICES[name].kind
                key = data_key(0, rig.names.full(name), kind)
                asked = Question(key, rest, lambda *_: None, lambda: None, attachment)
                rig.inbox(name, kind).waiting.append(asked)
            await asyncio.sleep(0.02)
            assert not rig.work.done(), "the node has ended"
            for outlet in rig.bus.outlets.values():
                outlet.sent.clear()
            still.check()

        yield take


# -- a fleet --------------------------------------------------------------------------------------

_KEYS = Keys(SITE, "a1")
_ASKED = (_KEYS.command, _KEYS.lease, _KEYS.show, _KEYS.log, _KEYS.revoked)
_TOLD = (_KEYS.setpoint, _KEYS.state, _KEYS.place)


def _order(asked: Asked) -> bytes:
    head = ("0" * 32, SITE, "a1", "anna", 1, 1.8e9)
    return pack(OrderMessage(*head, asked, 20.0, proof=b"0" * 16))


def fleet_seeds() -> list[bytes]:
    """A key by its number, and what is asked or sent under it."""
    seeds = [(b"\1" if isinstance(one, LeaseOrder) else b"\0") + _order(one) for one in ORDERS]
    flown = track("a1", (0, 0, 0, 4), (8, 12, 0, 5))
    shown: list[Asked] = [
        SendTrack("r", 0, flown.to_bytes()),
        LoadTrack("r", "hover", "s", 3.0, 1),
        StartShow("r", flown.digest, 30.0, 0.1),
        *(AskShow("r"), TakePlace("r"), LeaveShow("r")),
    ]
    seeds += [b"\2" + _order(one) for one in shown]
    questions = [LogQuestion(What.LIST), LogQuestion(What.PIECE, _LOG_NAME, 0, 100)]
    questions.append(LogQuestion(What.DIGEST, _LOG_NAME, 0, 100))
    seeds += [b"\3" + _order(one) for one in questions]
    seeds.append(b"\5" + pack_steer(Steer(1, 20.0, 0.3, _NORTH), "0" * 64, begins=True))
    seeds.append(b"\6" + pack(Card("a1", "boot", 1.8e9)))
    ahead = ConflictMonitor("s", "a2", 1.0, ((0.0, 1.0, 2.0), (1.0, 1.0, 2.0)), 9.0)
    seeds.append(b"\7" + bytes([VERSION]) + ahead.to_bytes())
    return seeds


_LOG_NAME = "m100link-20260101-000000.mcap"


@asynccontextmanager
async def on_board() -> AsyncIterator[Take]:
    """A pilot hovers; whatever a stranger asks has an answer that can be read, or none."""
    rig = FleetRig()
    async with AsyncExitStack() as stack:
        await stack.enter_async_context(rig.stack)
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        (folder / _LOG_NAME).write_bytes(bytes(1000))
        one = await rig.aircraft("a1")
        lease = await in_the_air(rig, one)
        await asyncio.sleep(2.0)
        still, spawn = Still(one.aircraft), one.agent.background.spawn
        spawn(ShowService(one.client, one.bus, _KEYS, "run").run(), "shows")
        spawn(LogService(one.bus, _KEYS, folder).run(), "logs")
        await asyncio.sleep(0.01)
        stranger = rig.network.session()
        answers: list[bytes] = []

        async def send(key: str, payload: bytes) -> None:
            if key in _TOLD:
                stranger.publish(key).put(payload)
            else:
                answers.extend(
                    answer.payload for answer in await stranger.ask(key, payload, timeout=0.6)
                )
            await asyncio.sleep(0.02)

        async def take(data: bytes) -> None:
            key = (*_ASKED, *_TOLD)[(data[0] if data else 0) % (len(_ASKED) + len(_TOLD))]
            await send(key, data[1:])
            for payload in answers:
                unpack_reply(payload) if key == _KEYS.log else unpack(OrderReply, payload)
            answers.clear()
            assert not one.work.done(), "the agent of the fleet has ended"
            if one.client.holder.number != lease.number or _is_for_anybody(data[1:]):
                raise Spoiled
            still.check()
            # The same of who has the lease: it may move, and has to be answered.
            try:
                order: OrderMessage = unpack(OrderMessage, data[1:])
            except MessageError:
                return
            now = asyncio.get_running_loop().time()
            proved = replace(order, fence=lease.number, clock=now, id=os.urandom(16).hex())
            await send(key, pack(proved.under(lease.token)))
            answers.clear()
            if still.off_m > _NEAR_M / 2 or one.client.holder.number != lease.number:
                raise Spoiled

        yield take


def _is_for_anybody(payload: bytes) -> bool:
    """Whether it is an order that needs no lease: to stop and to land."""
    try:
        order: OrderMessage = unpack(OrderMessage, payload)
        return order.order.right is Right.STOP
    except MessageError:
        return False


# -- a pilot of a fleet ---------------------------------------------------------------------------


def pilot_seeds(packages: list[bytes]) -> list[bytes]:
    """What an agent tells or answers.

    Args:
        packages: Values of telemetry.
    """
    reply = OrderReply("", "a1", "boot", Progress.DONE, Outcome.OK, clock=3.0, number=1)
    told: list[Any] = [
        Hello(MESSAGES_VERSION, "boot", 3.0),
        State(at=3.0),
        LeaseChanged(1, "anna"),
        Event(1, 2.0, "info", "text"),
        *(Telemetry(value, "1.0", 3.0) for value in packages[:5]),
        Card("a1", "boot", 1.8e9, height_m=3.0),
        MissionCard("a1", "boot"),
        reply,
        replace(reply, progress=Progress.RUNNING),
    ]
    return [pack(one) for one in told]


@asynccontextmanager
async def on_pilot() -> AsyncIterator[Take]:
    """A pilot asks and hears an agent that says anything."""
    rig = FleetRig()
    async with rig.stack:
        network = rig.network
        hostile, bus = network.session(), network.session()
        said = b""
        hostile.declare(_KEYS.live_by(hostile.session))

        def answer(question: Question) -> None:
            question.answer(question.key, said)

        def greet(question: Question) -> None:
            now = asyncio.get_running_loop().time()
            question.answer(_KEYS.told, pack(Hello(MESSAGES_VERSION, "boot", now)))

        hostile.serve(_KEYS.told, greet)
        for key in (_KEYS.state, _KEYS.mission, _KEYS.command, _KEYS.lease):
            hostile.serve(key, answer)
        fleet = await rig.pilot()
        walls = [FleetTelemetry(bus, Keys(SITE), full=full) for full in (True, False)]

        async def take(data: bytes) -> None:
            nonlocal said
            said = data
            channel = await fleet.reach("a1")
            channel.open(lambda message: None, lambda why: None)
            for key in (_KEYS.told, _KEYS.event, _KEYS.telemetry, _KEYS.thinned):
                hostile.publish(key).put(said)
            await asyncio.sleep(0.01)
            with suppress(M100Error):
                json.dumps([repr(one) for one in (await fleet.cards()).values()])
            with suppress(M100Error):
                repr(await fleet["a1"].mission())
            with suppress(M100Error):
                await Asker(bus, _KEYS, "anna", patience=0.5).ask(AskVersion())
            channel.close()

        yield take
        for wall in walls:
            wall.close()
