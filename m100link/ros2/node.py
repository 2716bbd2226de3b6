"""The node: its topics and services on a bus, what comes in by them, and what is said."""

from __future__ import annotations

import asyncio
import os
import time
from collections.abc import Awaitable, Callable, Mapping
from typing import Any

from m100link.agent.client import AgentClient
from m100link.agent.messages import Action
from m100link.errors import M100Error, UsageError
from m100link.log.cdr import decode, encode
from m100link.protocol.commands.control import Task
from m100link.protocol.records import Position
from m100link.protocol.setpoint import Setpoint
from m100link.ros2.bus import Bus, Inbox, Outlet, Received, Request
from m100link.ros2.graph import (
    GID_SIZE,
    Attachment,
    End,
    Names,
    NodeName,
    data_key,
    read_attachment,
)
from m100link.ros2.helm import Helm
from m100link.ros2.setpoints import Frames, speed, toward
from m100link.ros2.telling import Teller
from m100link.ros2.topics import INPUTS, OUTPUTS, RELIABLE, SERVICES
from m100link.telemetry.subscription import Newest

__all__ = ["STEP_S", "Node"]

STEP_S = 0.01
"""Seconds between two looks at what has come."""

_DEPTH = 8
"""Messages of a topic, and requests to a service, that wait for a step."""

_STOOD_STILL_S = 1.0
"""Seconds without a step after which what waits is old."""

_DEAF_S = 0.3
"""Seconds after such a standstill in which what comes was sent before."""

_LOOK_S = 0.5
_POSITION_S = 1.0
_TELL_S = 2.0
_MOST_CALLS = 16

_REFUSED = {
    "other": "another publisher has the stick; be silent for a moment, and begin anew",
    "late": "too long on its way",
}

Answer = Mapping[str, Any]
_Call = Callable[[dict[str, Any]], Awaitable[Answer]]


class _Topic:
    """A topic out.

    Attributes:
        outlet: Where it goes.
        gid: Id of the publisher.
        sequence: Counts what was sent.
        is_wanted: Whether anybody listens, as of the last look.
    """

    __slots__ = ("gid", "is_wanted", "outlet", "sequence")

    def __init__(self, outlet: Outlet) -> None:
        self.outlet = outlet
        self.gid = os.urandom(GID_SIZE)
        self.sequence = 0
        self.is_wanted = outlet.is_wanted()


class Node:
    """A node for one aircraft.

    Args:
        agent: The agent of the aircraft.
        bus: Where it is.
        names: Its name, its namespace, and what is called otherwise.
        domain: ROS_DOMAIN_ID.
        number: Its number within the session.
        utc: POSIX time, s.

    Attributes:
        helm: What ROS programs want of the aircraft.
        teller: What is published.
        refused: Payloads that could not be read.
    """

    def __init__(
        self,
        agent: AgentClient,
        bus: Bus,
        names: Names,
        *,
        domain: int = 0,
        number: int = 0,
        utc: Callable[[], float] = time.time,
    ) -> None:
        self._agent, self._bus, self._names, self._utc = agent, bus, names, utc
        self._domain = domain
        self.name = NodeName(domain, bus.session, names.namespace, names.node, number)
        self._ends = 0
        self.helm = Helm(agent)
        self.refused = 0
        self._topics: dict[str, _Topic] = {}
        self._inputs: list[tuple[str, Inbox[Received], Callable[[dict[str, Any]], Setpoint]]] = []
        self._services: list[tuple[str, str, Inbox[Request], _Call]] = []
        self._calls = 0
        self._looked_at = self._ran_at = agent.now
        self._deaf_until = agent.now
        self._told: dict[str, float] = {}
        ground = (names.frame("odom"), names.frame("map"))
        self._frames = Frames(ground, (names.frame("base_link"),))
        self._declare()
        self.teller = Teller(agent, names, self._publish, self._is_wanted, utc)

    # -- what is offered -------------------------------------------------------------------------

    def _declare(self) -> None:
        self._bus.declare(self.name.token)
        for name, out in OUTPUTS.items():
            topic = self._names.full(name)
            kept = out.qos.depth if out.qos.is_latched else 0
            outlet = self._bus.publish(data_key(self._domain, topic, out.kind), kept=kept)
            self._topics[name] = _Topic(outlet)
            self._show(End.PUBLISHER, topic, out.kind, out.qos)
        takes: dict[str, Callable[[dict[str, Any]], Setpoint]] = {
            "~/cmd_vel": self._stamped,
            "~/cmd_vel_unstamped": lambda message: speed(message, is_body=True),
            "~/setpoint_position": self._place,
        }
        for name, row in INPUTS.items():
            topic = self._names.full(name)
            inbox = self._bus.subscribe(data_key(self._domain, topic, row.kind), _DEPTH)
            self._inputs.append((name, inbox, takes[name]))
            self._show(End.SUBSCRIBER, topic, row.kind, RELIABLE)
        calls = self._triggers()
        for name, service in SERVICES.items():
            topic = self._names.full(name)
            requests = self._bus.serve(data_key(self._domain, topic, service.kind), _DEPTH)
            self._services.append((name, service.kind, requests, calls[name]))
            self._show(End.SERVER, topic, service.kind, RELIABLE)

    def _show(self, end: End, topic: str, kind: str, qos: Any) -> None:
        self._ends += 1
        self._bus.declare(self.name.token_of(self._ends, end, topic, kind, qos))

    def _publish(self, name: str, message: bytes) -> None:
        topic = self._topics[name]
        topic.sequence += 1
        at_ns = round(self._utc() * 1e9)
        topic.outlet.put(message, bytes(Attachment(topic.sequence, at_ns, topic.gid)))

    def _is_wanted(self, name: str) -> bool:
        return self._topics[name].is_wanted

    # -- setpoints -------------------------------------------------------------------------------

    def _stamped(self, message: dict[str, Any]) -> Setpoint:
        frame = message["header"]["frame_id"]
        return speed(message["twist"], is_body=self._frames.is_body(frame, "a speed"))

    def _place(self, message: dict[str, Any]) -> Setpoint:
        frame = message["header"]["frame_id"]
        if self._frames.is_body(frame, "a place") and frame:
            raise UsageError("a place in the frame of the body", remedy="give it in odom or map")
        telemetry = self._agent.telemetry
        position = None if telemetry is None else telemetry.fresh(Position, within=_POSITION_S)
        here = None if position is None else self.teller.places.local(position)
        if here is None:
            raise UsageError("a place, and nobody knows where the aircraft is")
        fastest = self._agent.state.limits.max_speed_m_s
        return toward(message["pose"], here, fastest=fastest)

    def _hear(
        self, name: str, inbox: Inbox[Received], make: Callable[[dict[str, Any]], Setpoint]
    ) -> None:
        """Fly the newest setpoint of whoever has the stick."""
        newest: dict[str, Any] | None = None
        for one in inbox.take():
            try:
                attachment = read_attachment(one.attachment)
                message = decode(INPUTS[name].kind, one.payload)
            except ValueError:
                self.refused += 1
                continue
            now = self._agent.now
            why = self.helm.stick.hear(attachment.gid, attachment.at_ns / 1e9, now)
            if why:
                refused = self.helm.refusal() if why == "closed" else _REFUSED[why]
                self._tell(f"{name}: {refused}", "warning")
            elif now >= self._deaf_until:
                newest = message
        if newest is None:
            return
        why = self.helm.refusal()
        if why:
            self._tell(f"{name}: {why}", "info")
            return
        try:
            self.helm.steer(make(newest))
        except M100Error as error:
            self._tell(f"{name}: {error.seen}", "warning")

    def _tell(self, text: str, level: str) -> None:
        """Say why something is not done, now and then."""
        now = self._agent.now
        if now >= self._told.get(text, now):
            if len(self._told) >= _MOST_CALLS:
                self._told.clear()
            self._told[text] = now + _TELL_S
            self._agent.note(text, level)

    # -- services --------------------------------------------------------------------------------

    def _triggers(self) -> dict[str, _Call]:
        helm = self.helm
        return {
            "~/obtain_control": _trigger(lambda: helm.obtain("ROS 2"), "ROS has control"),
            "~/release_control": _trigger(helm.release, "control is given back"),
            "~/takeoff": _trigger(lambda: helm.fly(Task.TAKE_OFF), "it takes off"),
            "~/land": _trigger(lambda: helm.fly(Task.LAND), "it lands"),
            "~/go_home": _trigger(lambda: helm.fly(Task.GO_HOME), "it flies home"),
            "~/arm": _trigger(lambda: helm.do(Action.ARM), "the motors run"),
            "~/disarm": _trigger(lambda: helm.do(Action.DISARM), "the motors stand"),
            "~/stop": _trigger(helm.stop, "stopped"),
            "~/take_photo": _trigger(lambda: helm.do(Action.TAKE_PHOTO), "sent"),
            "~/start_video": _trigger(lambda: helm.do(Action.START_VIDEO), "sent"),
            "~/stop_video": _trigger(lambda: helm.do(Action.STOP_VIDEO), "sent"),
        }

    def _serve(self, name: str, kind: str, request: Request, call: _Call) -> None:
        try:
            attachment = read_attachment(request.attachment)
            message = decode(f"{kind}_Request", request.payload)
        except ValueError:
            self.refused += 1
            request.drop()
            return
        if self._agent.now < self._deaf_until or self._calls >= _MOST_CALLS:
            self._tell(f"{name}: not done: this node stood still, or too many wait", "warning")
            request.drop()
            return
        self._calls += 1
        work = self._answer(kind, message, attachment, request, call)
        self._agent.background.spawn(work, f"ROS {name}")

    async def _answer(
        self,
        kind: str,
        message: dict[str, Any],
        attachment: Attachment,
        request: Request,
        call: _Call,
    ) -> None:
        try:
            answer = encode(f"{kind}_Response", await call(message))
            at_ns = round(self._utc() * 1e9)
            ours = Attachment(attachment.sequence, at_ns, attachment.gid)
            request.answer(answer, bytes(ours))
        finally:
            self._calls -= 1

    # -- time passes -----------------------------------------------------------------------------

    def step(self) -> None:
        """Take what has come, and say what is due."""
        now = self._agent.now
        if now - self._ran_at >= _STOOD_STILL_S:
            self._deaf_until = now + _DEAF_S
        self._ran_at = now
        for name, inbox, make in self._inputs:
            self._hear(name, inbox, make)
        for name, kind, requests, call in self._services:
            for request in requests.take():
                self._serve(name, kind, request, call)
        self.helm.advance()
        if now - self._looked_at >= _LOOK_S:
            self._looked_at = now
            for topic in self._topics.values():
                topic.is_wanted = topic.outlet.is_wanted()
        self.teller.advance()

    async def run(self) -> None:
        """Step for ever, until cancelled; then control is given back."""
        self._ran_at = self._agent.now
        self.teller.begin()
        self._agent.background.spawn(self._listen(), "ROS topics")
        try:
            while True:
                self.step()
                await asyncio.sleep(STEP_S)
        finally:
            await self.helm.release()

    async def _listen(self) -> None:
        async with self._agent.samples(Newest(20)) as samples:
            async for sample in samples:
                self.teller.hear(sample)


def _trigger(doing: Callable[[], Awaitable[None]], done: str) -> _Call:
    """A service without a question: done, or why not, with cause and remedy."""

    async def call(message: dict[str, Any]) -> Answer:
        try:
            await doing()
        except M100Error as error:
            return {"success": False, "message": str(error)}
        return {"success": True, "message": done}

    return call
