"""The names of DJI's later ``dji_sdk`` node, with standard ROS messages.

Frames follow REP 103: the ground is east-north-up, the body forward-left-up, angles are radians,
yaw counter-clockwise from east. (Two exceptions, as in DJI's node: gimbal angles are the degrees of
the wire, and the mode and gear channels of ``rc`` are raw.) Set-points are given in the same
frames and expire like those of any program. Services answer when the aircraft has answered; a task
answers as soon as it is accepted, as DJI's does, and the events report its failure.
"""

from __future__ import annotations

import math
from functools import partial

from m100link.apps.agent import orders
from m100link.apps.agent.client import AgentClient
from m100link.apps.agent.latency import MAX_LATE, ClockEstimate
from m100link.apps.agent.orders import CameraUse
from m100link.apps.station.ros.graph import Graph, GraphListener, RosTopic, ServiceCall, stamped
from m100link.apps.station.ros.leases import TASKS, Clients
from m100link.apps.station.ros.messages import Message
from m100link.apps.station.ros.missions import MissionTopics
from m100link.apps.station.ros.node_2016 import Node2016
from m100link.errors import GuardRefused, M100Error, UsageError
from m100link.geodesy import LocalFrame
from m100link.log.ros2 import DJI_TOPICS, DjiTopic, battery_state, joy_move
from m100link.protocol.commands.control import Arm
from m100link.protocol.commands.gimbal import (
    GIMBAL_LIMITS_DEG,
    GimbalAngle,
    GimbalAngleMode,
    GimbalSpeed,
)
from m100link.protocol.firmware import FIRMWARE_3_1
from m100link.protocol.records import Position
from m100link.telemetry.integrity import has_fix
from m100link.telemetry.sample import Sample
from m100link.telemetry.subscription import Newest

_WAY = "way of setpoints"
_YAW_RATE = 0x08  # in the control flag


class DjiSdk:
    def __init__(self, agent: AgentClient, graph: Graph, clients: Clients) -> None:
        self._agent, self._graph, self._clients = agent, graph, clients
        self._origin: tuple[LocalFrame, float] | None = None
        self._topics: list[tuple[RosTopic, DjiTopic]] = []
        self._node_2016 = Node2016(agent, graph, clients)
        self._add_telemetry()
        self._add_setpoints()
        self._add_services()
        self._from_mobile = graph.add_topic("/dji_sdk/from_mobile_data", "dji_sdk/MobileData")
        PayloadTopics(agent, graph, clients)
        MissionTopics(agent, graph, clients)
        agent.background.spawn(self._watch(), "dji_sdk topics")
        agent.background.spawn(self._watch_mobile(), "mobile data")

    # -- telemetry -------------------------------------------------------------------------------

    def _add_telemetry(self) -> None:
        local = DjiTopic("geometry_msgs/PointStamped", "/local", self._local_position)
        earlier = self._node_2016.topics
        # In this order: a client that names no type gets that of the later node.
        for name, convert in (
            *DJI_TOPICS.items(),
            ("local_position", local),
            *earlier.items(),
        ):
            topic = self._graph.add_topic(f"/dji_sdk/{name}", convert.kind)
            self._topics.append((topic, convert))
        standard = DJI_TOPICS["battery_state"]._replace(make=_battery)
        topic = self._graph.add_topic("/m100link/battery_state", standard.kind)
        self._topics.append((topic, standard))

    async def _watch(self) -> None:
        async with self._agent.samples(Newest(20)) as samples:
            async for sample in samples:
                for topic, convert in self._topics:
                    # Nobody pays for a topic that nobody reads.
                    made = convert.make(sample) if topic.subscribers else None
                    if made is not None:
                        # ROS 1 has fewer fields than ROS 2, and a number in each header.
                        message = topic.type.default()
                        message |= {name: made[name] for name in made if name in message}
                        if convert.frame is not None:
                            message["header"] = stamped(convert.frame)
                        self._graph.publish(topic, message, sample.received_at)

    async def _watch_mobile(self) -> None:
        async with self._agent.from_mobile(Newest(50)) as messages:
            async for data in messages:
                self._graph.publish(self._from_mobile, {"data": data}, self._agent.now)
                self._node_2016.tell_from_mobile(data)

    def _local_position(self, sample: Sample) -> Message | None:
        position = sample.position
        if position is None or self._origin is None or not position.is_possible:
            return None
        frame, altitude = self._origin
        north, east = frame.to_local(position.latitude_deg, position.longitude_deg)
        return {"point": {"x": east, "y": north, "z": position.altitude_m - altitude}}

    # -- setpoints -------------------------------------------------------------------------------

    def _add_setpoints(self) -> None:
        for name, flag in (
            ("ENUvelocity_yawrate", 0x48),
            ("ENUposition_yaw", 0x90),
            ("rollpitch_yawrate_zposition", 0x1A),
            ("generic", None),
        ):
            self._graph.add_topic(
                f"/dji_sdk/flight_control_setpoint_{name}",
                "sensor_msgs/Joy",
                partial(self._on_setpoint, flag),
            )

    def _on_setpoint(
        self, flag: int | None, session: GraphListener, message: Message, now: float
    ) -> None:
        axes = message["axes"]
        least = 5 if flag is None else 3
        try:
            _check_way(session, message["header"]["stamp"], now)
            if len(axes) < least:
                raise UsageError(f"this topic takes {max(4, least)} axes, not {len(axes)}")
            if flag is None:
                if not (math.isfinite(axes[4]) and 0 <= axes[4] <= 255):
                    raise UsageError("the fifth axis is the control flag, 0 to 255")
                flag = int(axes[4])
            if len(axes) == 3:
                # DJI's node reads what lies behind the message, often zeros. The nose stays.
                flag, axes = flag | _YAW_RATE, [*axes, 0.0]
            self._clients.fly(session, joy_move(flag, *axes[:4]))
        except M100Error as error:
            self._clients.complain(session, error)

    # -- services --------------------------------------------------------------------------------

    def _add_services(self) -> None:
        for name, kind, handler in (
            ("activation", "Activation", self._activate),
            ("sdk_control_authority", "SDKControlAuthority", self._authority),
            ("sdk_permission_control", "SDKPermissionControl", self._authority),
            ("drone_task_control", "DroneTaskControl", self._task),
            ("query_drone_version", "QueryDroneVersion", self._version),
            ("set_local_pos_ref", "SetLocalPosRef", self._set_origin),
            ("send_data_to_mobile", "SendMobileData", self._send_to_mobile),
        ):
            self._clients.offer(name, kind, handler)

    async def _activate(self, call: ServiceCall) -> Message:
        return await self._clients.order(call, orders.Activate()) | {"cmd_set": 0, "cmd_id": 1}

    async def _authority(self, call: ServiceCall) -> Message:
        wanted = call.request["control_enable"]
        if wanted > 1:
            raise UsageError("control_enable is 1 to obtain and 0 to release")
        await self._clients.switch(call.session, on=bool(wanted), activates=True)
        return {"result": True, "cmd_set": 1, "cmd_id": 0, "ack_data": 2 if wanted else 1}

    async def _task(self, call: ServiceCall) -> Message:
        number = call.request["task"]
        if number not in TASKS:
            raise UsageError("tasks are 4 (take-off), 6 (landing) and 1 (go-home)")
        session = self._clients.session(call.session)
        await self._agent.background.begin(
            lambda begun: session.ask(TASKS[number], begun.set), f"task {number}"
        )
        return {"result": True, "cmd_set": 1, "cmd_id": 1, "ack_data": 2}

    async def _version(self, call: ServiceCall) -> Message:
        version, hardware = dji_version((await self._agent.ask(orders.AskVersion())).text)
        return {"version": version, "hardware": hardware}

    async def _set_origin(self, call: ServiceCall) -> Message:
        position = self._agent.view.get(Position)
        if position is None:
            return {"result": False}
        holder = self._agent.holder
        if holder.number and not self._clients.session(call.session).has_lease:
            raise UsageError(f"{holder.name} has control: the origin of its flight stays")
        if not has_fix(position):
            return {"result": False}
        frame = LocalFrame(position.latitude_deg, position.longitude_deg)
        self._origin = (frame, position.altitude_m)
        return {"result": True}

    async def _send_to_mobile(self, call: ServiceCall) -> Message:
        return await self._clients.order(call, orders.SendToMobile(call.request["data"]))


def _battery(sample: Sample) -> Message | None:
    """As the standard has it: a percentage of 0 to 1."""
    return None if sample.battery is None else battery_state(sample.battery)


def dji_version(text: str) -> tuple[int, str]:
    """Version and hardware as DJI's node reads them: 0x03010A00, M100 of ``… M100-03.01.01.00``.

    The aircraft says 01 for the 10 of version 3.1.10: DJI's library multiplies it by ten.
    """
    before, _, numbers = text.rpartition("-")
    hardware = before.rpartition(" ")[2]
    found = [int(one) if one.isdecimal() else 0 for one in numbers.split(".")[:4]]
    major, minor, third, build = found + [0] * (4 - len(found))
    if hardware == "M100":
        third *= 10
    return int.from_bytes(bytes(one & 0xFF for one in (major, minor, third, build))), hardware


def _check_way(session: GraphListener, stamp: Message, now: float) -> None:
    """Refuse a setpoint that waited on its way; one without a stamp counts as new.

    Raises ``GuardRefused``: its stamp is old, against the newest of that client.
    """
    sent_at = stamp["secs"] + stamp["nsecs"] * 1e-9
    if not sent_at:
        return
    way: ClockEstimate = session.data.setdefault(_WAY, ClockEstimate())
    late = way.late(sent_at, now)
    if late > MAX_LATE:
        raise GuardRefused(
            f"a setpoint arrived {late:.1f} s late; it was not flown",
            guard="way_late",
            measured=late,
            limit=MAX_LATE,
            cause="the network is slow or blocked, or the stamps are not send times",
            remedy="stamp each setpoint when you send it, or omit the stamp",
        )


# -- gimbal, camera and motors ---------------------------------------------------------------------
# Gimbal and camera need no control authority. They need the lease, or that nobody holds it: the
# client that flies also looks. Nothing answers these commands, so ``result`` says "sent".

_KEPT = {
    "yaw": GimbalAngleMode.KEEP_YAW,
    "roll": GimbalAngleMode.KEEP_ROLL,
    "pitch": GimbalAngleMode.KEEP_PITCH,
}
_SHORTEST_S = 0.1


class PayloadTopics:
    """The topics and services of what hangs below, and of the motors."""

    def __init__(self, agent: AgentClient, graph: Graph, clients: Clients) -> None:
        self._agent, self._clients = agent, clients
        clients.hear("/dji_sdk/gimbal_angle_cmd", "dji_sdk/Gimbal", self._on_angles)
        clients.hear("/dji_sdk/gimbal_speed_cmd", "geometry_msgs/Vector3Stamped", self._on_rates)
        for name, kind, handler in (
            ("camera_action", "CameraAction", self._camera),
            ("camera_action_control", "CameraActionControl", self._camera),
            ("gimbal_angle_control", "GimbalAngleControl", self._angles),
            ("gimbal_speed_control", "GimbalSpeedControl", self._rates),
            ("drone_arm_control", "DroneArmControl", self._arm),
        ):
            clients.offer(name, kind, handler)

    async def _on_angles(self, session: GraphListener, message: Message) -> None:
        """Radians, as DJI's node has them; seconds are whole."""
        command = GimbalAngle(
            yaw_deg=math.degrees(message["yaw"]),
            roll_deg=math.degrees(message["roll"]),
            pitch_deg=math.degrees(message["pitch"]),
            mode=message["mode"],
            duration_s=max(_SHORTEST_S, float(message["ts"])),
        )
        await self._clients.session(session).ask(_gimbal(command))

    async def _on_rates(self, session: GraphListener, message: Message) -> None:
        """Radians per second: roll, pitch, yaw. One message turns it for half a second."""
        vector = message["vector"]
        command = GimbalSpeed(
            yaw_deg_s=math.degrees(vector["z"]),
            roll_deg_s=math.degrees(vector["x"]),
            pitch_deg_s=math.degrees(vector["y"]),
        )
        await self._clients.session(session).ask(_gimbal(command))

    async def _angles(self, call: ServiceCall) -> Message:
        """Tenths of a degree and of a second."""
        asked = call.request
        mode = GimbalAngleMode(asked["absolute_or_incremental"])
        for axis, bit in _KEPT.items():
            if asked[f"{axis}_cmd_ignore"]:
                mode |= bit
        # DJI's demo asks for 180°: the gimbal goes as far as it can.
        yaw, roll, pitch = (
            max(low, min(high, asked[axis] / 10.0))
            for axis, (low, high) in GIMBAL_LIMITS_DEG.items()
        )
        command = GimbalAngle(
            yaw_deg=yaw,
            roll_deg=roll,
            pitch_deg=pitch,
            mode=mode,
            duration_s=max(_SHORTEST_S, asked["duration"] / 10.0),
        )
        return await self._clients.order(call, _gimbal(command))

    async def _rates(self, call: ServiceCall) -> Message:
        """Tenths of a degree per second; one call turns it for half a second."""
        asked = call.request
        command = GimbalSpeed(
            yaw_deg_s=asked["yaw_rate"] / 10.0,
            roll_deg_s=asked["roll_rate"] / 10.0,
            pitch_deg_s=asked["pitch_rate"] / 10.0,
        )
        return await self._clients.order(call, _gimbal(command))

    async def _camera(self, call: ServiceCall) -> Message:
        number = call.request["camera_action"]
        if number >= len(CameraUse):  # in the order of its members
            raise UsageError("camera_action is 0 (photo), 1 (start video) or 2 (stop video)")
        return await self._clients.order(call, orders.UseCamera(tuple(CameraUse)[number]))

    async def _arm(self, call: ServiceCall) -> Message:
        wanted = call.request["arm"]
        if wanted > 1:
            raise UsageError("arm is 1 (start the motors) or 0 (stop them)")
        answer = await self._clients.order(
            call, orders.StartMotors() if wanted else orders.StopMotors()
        )
        return answer | {"cmd_set": Arm.ADDRESS[0], "cmd_id": Arm.ADDRESS[1]}


def _gimbal(command: GimbalAngle | GimbalSpeed) -> orders.Order:
    """The order that sends a command. Raises M100Error: it cannot be sent, and nobody is asked."""
    command.value(FIRMWARE_3_1)
    if isinstance(command, GimbalSpeed):
        return orders.TurnGimbal(command)
    return orders.PointGimbal(command)
