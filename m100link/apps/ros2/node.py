"""The node: its topics and services on a bus, what comes in by them, and what is said."""

from __future__ import annotations

import asyncio
import os
import time
from collections.abc import Callable, Mapping
from contextlib import AbstractAsyncContextManager
from typing import Any

from m100link.apps.agent import orders
from m100link.apps.agent.client import AgentClient
from m100link.apps.agent.orders import CameraUse, StartMotors, StopMotors, UseCamera
from m100link.apps.bus.network import PolledBus
from m100link.apps.bus.session import LARGEST, Opening, ZenohBus, open_session
from m100link.apps.ros2.actions import Actions
from m100link.apps.ros2.control import (
    LIFETIME,
    Frames,
    GimbalServices,
    Parameters,
    RosControl,
    angles_of,
    mission_services,
    speed,
    toward,
)
from m100link.apps.ros2.endpoints import (
    Call,
    Endpoints,
    Heartbeat,
    Input,
    answering,
    serve_descriptions,
    trigger,
)
from m100link.apps.ros2.graph import ADMIN, GraphDiscovery, Names, NodeName
from m100link.apps.ros2.publishers import ALL_OUTPUTS, DiagnosticLevel, MessageMaker, Status
from m100link.apps.ros2.topics import DJI_OUTPUTS, INPUTS, SERVICES
from m100link.errors import M100Error, UsageError
from m100link.protocol.records import Position
from m100link.protocol.setpoint import Setpoint
from m100link.telemetry.sample import Sample

STEP_S = 0.02
"""Seconds between two looks at what has come, with telemetry: it has the process awake anyway."""

_STEP_WITHOUT_S = 0.025  # the same without telemetry, and while that is late
_STEP_SOONEST_S = 0.015

_STOOD_STILL_S = 1.0  # seconds without a step after which what waits is old
_DEAF_S = 0.3  # seconds after such a standstill in which what comes was sent before
_LOOK_S = 0.5
_TELL_S = 2.0
_MOST_REPORTED = 16
_ALONE_S, _AGAIN_S = 2.0, 60.0  # seconds of trouble with the graph before a report, and the next

_ALONE = (
    "no router of ROS 2 answers, and nobody sees this node: start rmw_zenohd, "
    "or name its place by ZENOH_CONFIG_OVERRIDE"
)

_REFUSED = {
    "other": "another publisher is active, or this one was cut off while it published; "
    "pause for half a second, then publish again",
    "late": "too late, by the time stamps of its attachments or headers",
}

Make = Callable[[dict[str, Any]], Setpoint]


class Node:
    def __init__(
        self,
        agent: AgentClient,  # the agent of the aircraft
        bus: PolledBus,  # where it is
        names: Names,  # its name, its namespace, and what is called otherwise
        *,
        domain: int = 0,
        number: int = 0,  # its number within the session
        has_clock: bool = False,  # whether it publishes ``/clock``, as for a virtual aircraft
        has_dji_names: bool = False,  # whether it publishes by the names of DJI's node, too
        utc: Callable[[], float] = time.time,  # POSIX time, s
    ) -> None:
        self._agent, self._names = agent, names
        self.name = NodeName(domain, bus.session, names.namespace, names.node, number)
        self.ends = Endpoints(bus, self.name, agent.background, utc)  # its topics and services
        self.control = RosControl(agent)  # what ROS programs want of the aircraft
        self._bus, self._presence = bus, GraphDiscovery(lambda: bus.changes(f"{ADMIN}/{domain}/**"))
        # The trouble with the graph, when it is reported next, and whether it was.
        self._trouble, self._tells_at, self._is_told = "", agent.now, False
        self._looked_at = self._ran_at = self._deaf_until = agent.now
        self._reported: dict[str, float] = {}
        self._has_come = asyncio.Event()  # a package of telemetry, since the last step
        # Services are many, and looked at in every second step.
        self._is_even = False
        # Plain names are understood in a namespace, too: nothing else can be meant.
        ground = ("odom", "map", names.frame("odom"), names.frame("map"))
        self._frames = Frames(ground, ("base_link", names.frame("base_link")))
        topics = {
            name: self.ends.publish(names.full(name), out.kind, out.qos)
            for name, out in ALL_OUTPUTS.items()
            if (has_clock or name != "/clock") and (has_dji_names or name not in DJI_OUTPUTS)
        }
        self.teller = MessageMaker(agent, names, topics, utc, self._status)  # what is published
        takes: dict[str, Make] = {
            "~/cmd_vel": self._stamped,
            "~/cmd_vel_unstamped": lambda message: speed(message, is_body=True),
            "~/setpoint_position": self._place,
        }
        inputs = {
            name: self.ends.subscribe(names.full(name), row.kind) for name, row in INPUTS.items()
        }
        self._inputs = [(name, inputs[name], make) for name, make in takes.items()]
        self._payload = GimbalServices(agent, self.control, inputs["~/gimbal_speed"], self._tell)
        for name, call in (self._calls() | mission_services(self.control)).items():
            row = SERVICES[name]
            self.ends.serve(names.full(name), row.kind, call, ends=row.ends)
        self.actions = Actions(
            agent,
            self.control,
            self.ends,
            names,
            self._presence,
            Heartbeat(bus),
            self.teller.time_now,
        )
        Parameters(agent, self.teller, self.ends, names)
        serve_descriptions(self.ends, names)

    @property
    def counted(self) -> dict[str, int]:
        """Setpoints and payloads that were refused, by the reason."""
        refused = {f"setpoints {why}": count for why, count in self.control.mux.refused.items()}
        return {"payloads that could not be read": self.ends.refused, **refused}

    def _status(self) -> Status:
        level = DiagnosticLevel.WARN if self._trouble else DiagnosticLevel.OK
        seen = self._trouble or "no failures since the start"
        return Status("node", level, seen, self.counted)

    def _look_at_graph(self) -> None:
        """Say that programs cannot find it, or would reach another one as well; again and again."""
        now, name, trouble = self._agent.now, self.name, ""
        if self._presence.has_duplicate(name.full, name.session):
            trouble = f"two nodes are called {name.full}: end one, or give it another name"
        elif self._bus.is_alone():
            trouble = _ALONE
        if trouble != self._trouble:
            if self._is_told and not trouble:
                self._agent.note("programs of ROS find this node, and no other of its name")
            self._trouble, self._tells_at, self._is_told = trouble, now + _ALONE_S, False
        if trouble and now >= self._tells_at:
            self._tells_at, self._is_told = now + _AGAIN_S, True
            self._agent.note(trouble, "warning")

    # -- setpoints -------------------------------------------------------------------------------

    def _stamped(self, message: dict[str, Any]) -> Setpoint:
        frame = message["header"]["frame_id"]
        return speed(message["twist"], is_body=self._frames.is_body(frame, "a speed"))

    def _place(self, message: dict[str, Any]) -> Setpoint:
        frame = message["header"]["frame_id"]
        if self._frames.is_body(frame, "a place") and frame:
            raise UsageError("a place in the body frame", remedy="give it in odom or map")
        position = self._agent.view.to_steer_by(Position)
        here = None if position is None else self.teller.places.local(position)
        if here is None:
            raise UsageError("a place, while the position of the aircraft is unknown")
        fastest = self._agent.state.limits.max_speed_m_s
        return toward(message["pose"], here, fastest=fastest)

    def _hear(self, name: str, source: Input, make: Make) -> None:
        """Fly the newest setpoint of the active publisher."""
        newest: dict[str, Any] | None = None
        now = self._agent.now
        for attachment, message in source.take():
            sent_at, made_at = attachment.at_ns / 1e9, 0.0
            if "header" in message:
                stamp = message["header"]["stamp"]
                made_at = stamp["sec"] + stamp["nanosec"] / 1e9
            why = self.control.mux.hear(attachment.gid, sent_at, now, attachment.sequence, made_at)
            if why:
                refused = self.control.refusal() if why == "closed" else _REFUSED[why]
                self._tell(f"{name}: {refused}", "warning")
            elif now >= self._deaf_until:
                newest = message
        if newest is None:
            return
        why = self.control.refusal()
        if why:
            self._tell(f"{name}: {why}", "info")
            return
        try:
            self.control.session.steer(make(newest), LIFETIME)
        except M100Error as error:
            self._tell(f"{name}: {error.seen}", "warning")

    def _tell(self, text: str, level: str) -> None:
        """Say why something is not done, now and then."""
        now = self._agent.now
        if now >= self._reported.get(text, now):
            if len(self._reported) >= _MOST_REPORTED:
                self._reported.clear()
            self._reported[text] = now + _TELL_S
            self._agent.note(text, level)

    def _calls(self) -> dict[str, Call]:
        control = self.control
        return {
            "~/obtain_control": trigger(self._obtain, "ROS has control"),
            "~/release_control": trigger(control.release, "control is given back"),
            "~/takeoff": trigger(lambda: control.fly(orders.TakeOff()), "it takes off"),
            "~/land": trigger(lambda: self._end(orders.Land()), "it lands"),
            "~/go_home": trigger(lambda: self._end(orders.GoHome()), "it flies home"),
            "~/arm": trigger(lambda: control.do(StartMotors()), "the motors run"),
            "~/disarm": trigger(lambda: control.do(StopMotors()), "the motors stand"),
            "~/stop": trigger(control.session.stop, "stopped"),
            "~/take_photo": trigger(lambda: control.do(UseCamera(CameraUse.PHOTO)), "sent"),
            "~/start_video": trigger(lambda: control.do(UseCamera(CameraUse.START_VIDEO)), "sent"),
            "~/stop_video": trigger(lambda: control.do(UseCamera(CameraUse.STOP_VIDEO)), "sent"),
            "~/point_gimbal": answering(
                lambda request: control.do(orders.PointGimbal(angles_of(request))), "sent"
            ),
        }

    async def _obtain(self) -> None:
        if self._presence.has_duplicate(self.name.full, self.name.session):
            raise UsageError(
                f"two nodes are called {self.name.full}",
                cause="another m100link runs in this domain: calls reach both",
                remedy="end one of them, or give it another namespace or node name",
            )
        await self.control.obtain()

    async def _end(self, order: orders.Order) -> None:
        self.control.session.held()
        self.actions.end(f"{order.label} was requested")
        await self.control.fly(order)

    # -- time passes -----------------------------------------------------------------------------

    def step(self) -> None:
        """Take what has come, and say what is due."""
        now = self._agent.now
        if now - self._ran_at >= _STOOD_STILL_S:
            self._deaf_until = now + _DEAF_S
            self.actions.end("this node stood still")
        self._ran_at = now
        self._presence.look()
        for name, source, make in self._inputs:
            self._hear(name, source, make)
        self._is_even = not self._is_even
        if self._is_even:
            self.ends.take_requests(is_deaf=now < self._deaf_until)
        self._payload.advance(is_deaf=now < self._deaf_until)
        self.control.advance()
        self.actions.advance()
        if now - self._looked_at >= _LOOK_S:
            self._looked_at = now
            self.ends.look()
            self._look_at_graph()
            if self.ends.refusal:
                self._tell(self.ends.refusal, "warning")
                self.ends.refusal = ""
        self.teller.advance()

    async def run(self) -> None:
        """Step for ever, until cancelled; then control is given back."""
        loop, self._ran_at = asyncio.get_running_loop(), self._agent.now
        self.teller.begin()
        self._agent.on_sample.append(self._hear_sample)
        try:
            while True:
                self.step()
                self._has_come.clear()
                # Fifty times a second: a third of the calls of asyncio.timeout().
                timer = loop.call_later(_STEP_WITHOUT_S, self._has_come.set)
                await self._has_come.wait()
                timer.cancel()
        finally:
            self._agent.on_sample.remove(self._hear_sample)
            await self.control.release()

    def _hear_sample(self, sample: Sample) -> None:
        self.teller.hear(sample)
        if self._agent.now - self._ran_at >= _STEP_SOONEST_S:
            self._has_come.set()


# -- A session of ROS 2: configured from where rmw_zenoh takes it ----------------------------------


MOST_BYTES = 32768  # of a payload that is read: a mission of 500 places has 20,000

_SESSION = {
    "mode": '"peer"',
    "connect/endpoints": '["tcp/localhost:7447"]',
    "connect/exit_on_failure": "false",
    "listen/endpoints": '["tcp/localhost:0"]',
    "scouting/multicast/enabled": "false",
    "timestamping/enabled": '{"router": true, "peer": true, "client": true}',
    # As rmw_zenoh's, and not below that of its router: who stands still for longer than ours and
    # shorter than the router's gives up this session and hears of no way back to it.
    "transport/link/tx/lease": "60000",
    # Nothing that a node hears is longer, and zenoh would put a gigabyte together.
    "transport/link/rx/max_message_size": str(LARGEST),
}
"""rmw_zenoh's session, where it differs from zenoh's default."""

_CONFIG, _OVERRIDE = "ZENOH_SESSION_CONFIG_URI", "ZENOH_CONFIG_OVERRIDE"


def _overrides(text: str) -> dict[str, str]:
    found = {}
    for rule in text.split(";"):
        name, sign, value = rule.partition("=")
        if rule.strip() and not sign:
            raise UsageError(f"{_OVERRIDE}: {rule!r} is not name=value")
        if sign:
            found[name.strip()] = value.strip()
    return found


def open_ros2(environment: Mapping[str, str] = os.environ) -> AbstractAsyncContextManager[ZenohBus]:
    """A session while the block runs, configured as rmw_zenoh's are.

    Without a router it waits for one; who listens is found when that is there. Raises UsageError:
    the package is missing, or the configuration cannot be.
    """
    path = environment.get(_CONFIG)
    options = ({} if path else _SESSION) | _overrides(environment.get(_OVERRIDE, ""))
    return open_session(
        Opening(
            "ROS 2",
            "ros2",
            options,
            file=(path, _CONFIG) if path else None,
            largest=MOST_BYTES,
            remedies={"": f"check {_CONFIG} and {_OVERRIDE}, and that the port is free"},
        )
    )
