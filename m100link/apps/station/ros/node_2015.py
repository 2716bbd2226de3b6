"""DJI's ROS node of June 2015, reborn: its topics, its numbers, its web page.

Everything a program of 2015 sees is the same: names, types, numbers and rates. What differs is for
safety, and none of it shows while a program behaves:

* **One client steers.** Opening control takes the lease if it is free. Others hear by a ``status``
  who has it; closing control or the socket gives it back.
* **A setpoint expires.** DJI's node sends one movement frame per message and leaves the rest to the
  aircraft. Here the setpoint of a message is sent at 50 Hz until it is renewed, replaced or its
  lifetime ends. A held key sends one message when it goes down, nothing for up to half a second,
  then about thirty a second: so a setpoint *different from the one before* (a key went down or up)
  lasts :data:`PRESS_LIFETIME`, a *repeated* one :data:`REPEAT_LIFETIME`. Letting go sends zeros,
  which stop at once; a lost socket stops at once; a page that hangs stops within the lifetime.
* **Nothing is repeated without end.** DJI's node repeats a command every 20 ms until it is
  acknowledged; here requests have a number of tries.
* **Numbers without meaning are refused.** The document allows commands 1, 4 and 6 only; control
  modes other than 1 and 2 would turn the aircraft to the north.
* **No value is invented.** While the aircraft is not connected, flight status and battery are 0, as
  before the first package.
"""

from __future__ import annotations

import asyncio
import math

from m100link.apps.agent import orders
from m100link.apps.agent.client import AgentClient
from m100link.apps.agent.lease import LeaseHeld
from m100link.apps.agent.orders import ANGLE_MODE, VELOCITY_MODE, setpoint_of
from m100link.apps.station.ros.graph import Graph, GraphListener, Publication, RosTopic
from m100link.apps.station.ros.leases import TASKS, Clients
from m100link.apps.station.ros.messages import Message
from m100link.errors import (
    ActivationRefused,
    AuthorityRefused,
    CommandNotSupported,
    CommandRefused,
    KeyRejected,
    LevelTooLow,
    M100Error,
    NotActivated,
    UsageError,
)
from m100link.protocol.codes import AuthorityCode
from m100link.protocol.records import Battery, FlightStatus
from m100link.telemetry.subscription import Newest

PRESS_LIFETIME = 0.7
"""Seconds of a setpoint that differs from the one before: longer than the wait before a held key
repeats (250 to 660 ms by system)."""

REPEAT_LIFETIME = 0.2  # seconds of a setpoint that was repeated: held keys repeat every 25 to 40 ms

NO_AUTHORITY = 8.0
"""On ``/activation_status``: an answer said that something is missing (codes 0xFF00 to 0xFF02)."""

_CLOSED_BY_APP = 4.0
_VERSION_PAUSE = 10.0
_MODE, _LAST = "control mode", "last setpoint"
_NEEDS_MORE = (NotActivated, LevelTooLow, CommandNotSupported, KeyRejected)


class Node2015:
    def __init__(self, agent: AgentClient, graph: Graph, clients: Clients) -> None:
        self._agent, self._graph, self._clients = agent, graph, clients
        number = "std_msgs/Float32"
        for name, work in (
            ("/sdk_request_cmd", self._command),
            ("/nav_open_close_request", self._open_or_close),
            ("/sdk_request_simple_task", self._simple_task),
            ("/sdk_request_activation", self._activate),
        ):
            clients.hear(name, number, work)
        graph.add_topic("/sdk_request_ctrl", "geometry_msgs/Quaternion", self._on_control)
        graph.add_topic("/sdk_request_ctrl_mode", number, self._on_mode)
        self._battery = graph.add_topic("/battery_status", number)
        self._open_close = graph.add_topic("/nav_open_close_status", number)
        self._flight_status = graph.add_topic("/flight_status", number)
        self._activation = graph.add_topic("/activation_status", number)
        self._test_fre = graph.add_topic("/test_fre", number)
        agent.on_activating.append(lambda code: self._tell(self._activation, float(code)))
        agent.on_authority_taken.append(lambda _: self._tell(self._open_close, _CLOSED_BY_APP))
        self._version_sent_at = float("-inf")
        agent.background.spawn(self._watch(), "/test_fre")
        agent.background.spawn(self._publish_each_second(), "1 Hz topics")

    # -- what the node publishes -----------------------------------------------------------------

    async def _publish_each_second(self) -> None:
        while True:
            await asyncio.sleep(1.0)
            view = self._agent.view
            status, battery = view.get(FlightStatus), view.get(Battery)
            self._tell(self._flight_status, float(status.status) if status else 0.0)
            self._tell(self._battery, float(battery.percent) if battery else 0.0)

    async def _watch(self) -> None:
        async with self._agent.samples(Newest(50)) as samples:
            async for sample in samples:
                device = sample.control_device
                if device is not None:
                    message: Message = {"data": float(device.control)}
                    self._graph.publish(self._test_fre, message, sample.received_at)

    def _tell(self, topic: RosTopic, number: float) -> None:
        self._graph.publish(topic, {"data": number}, self._agent.now)

    # -- what the node is asked ------------------------------------------------------------------

    async def _activate(self, session: GraphListener, _: Message) -> None:
        try:
            await self._clients.session(session).ask(orders.Activate())
        except ActivationRefused:
            pass  # its code was published, and the reason is in the events
        except CommandRefused:
            self._tell(self._activation, NO_AUTHORITY)
            raise

    async def _open_or_close(self, session: GraphListener, message: Message) -> None:
        wanted = _byte(message["data"])
        if wanted not in (0, 1):
            raise UsageError(f"/nav_open_close_request takes 1 (open) or 0 (close), not {wanted}")
        try:
            await self._clients.switch(session, on=bool(wanted))
            code = AuthorityCode.OBTAINED if wanted else AuthorityCode.RELEASED
            self._tell(self._open_close, float(code))
        except AuthorityRefused as error:
            self._tell(self._open_close, float(error.code))
            raise
        except LeaseHeld:
            # Only this client is refused; the others still see it open.
            refused = Publication(self._open_close, {"data": float(AuthorityCode.NOT_IN_F)})
            if session in self._open_close.subscribers:
                session.deliver(refused, self._agent.now)
            raise
        except _NEEDS_MORE:
            self._tell(self._activation, NO_AUTHORITY)
            raise

    async def _command(self, session: GraphListener, message: Message) -> None:
        number = _byte(message["data"])
        if number not in TASKS:
            raise UsageError(
                f"/sdk_request_cmd takes 4 (take-off), 6 (landing) and 1 (go-home), not {number}",
                cause="the document allows these three; no firmware carries out the others",
            )
        try:
            await self._clients.session(session).ask(TASKS[number])
        except _NEEDS_MORE:
            self._tell(self._activation, NO_AUTHORITY)
            raise

    def _on_mode(self, session: GraphListener, message: Message, now: float) -> None:
        if message["data"] in (ANGLE_MODE, VELOCITY_MODE):
            self._graph.known(session)[_MODE] = int(message["data"])
        else:
            error = UsageError(f"there is no control mode {message['data']}: 1 or 2")
            self._clients.complain(session, error)

    def _on_control(self, session: GraphListener, message: Message, now: float) -> None:
        mode = self._graph.known(session).get(_MODE, ANGLE_MODE)
        values = (message["x"], message["y"], message["z"], message["w"])
        try:
            setpoint = setpoint_of(mode, *values)
            is_repeated = self._graph.known(session).get(_LAST) == (mode, values)
            self._graph.known(session)[_LAST] = (mode, values)
            is_short = is_repeated or not any(values)  # zeros need no lifetime: they stop
            lifetime = REPEAT_LIFETIME if is_short else PRESS_LIFETIME
            self._clients.session(session).steer(setpoint, lifetime)
        except M100Error as error:
            self._clients.complain(session, error)

    async def _simple_task(self, session: GraphListener, message: Message) -> None:
        if not math.isfinite(message["data"]):
            raise UsageError("/sdk_request_simple_task takes a number")
        number = int(message["data"])
        if number < 0:  # by anybody, as a STOP
            self._agent.hover(f"{session.name} stopped it", self._clients.session(session).lease)
        elif number == 5:
            await self._activate(session, message)
        elif number == 6:
            await self._tell_version(session)
        else:
            await self._clients.session(session).ask(orders.FlyPattern(number))

    async def _tell_version(self, session: GraphListener) -> None:
        version = await self._agent.ask(orders.AskVersion())
        text = f"version: {version.text} (CRC {version.number:08X})"
        session.status("info", text)
        # People hear it at most once in a while: it must not push out the events of others.
        now = self._agent.now
        if now - self._version_sent_at >= _VERSION_PAUSE:
            self._version_sent_at = now
            self._agent.note(text)


def _byte(data: float) -> int:
    """A float as the C program casts it to a byte."""
    if not math.isfinite(data):
        raise UsageError(f"{data} is not a number")
    return int(data) & 0xFF
