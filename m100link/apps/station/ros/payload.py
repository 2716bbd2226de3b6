"""Gimbal, camera and motors under the names of DJI's later ``dji_sdk`` node, and of 3.1's.

Gimbal and camera need no control authority. They need the lease, or that nobody holds it: whoever
flies also looks where it flies. Nothing answers these commands, so ``result`` says "sent".
"""

from __future__ import annotations

import math

from m100link.apps.agent.client import AgentClient
from m100link.apps.agent.messages import Action
from m100link.apps.station.ros.graph import Call, Graph, Listener
from m100link.apps.station.ros.leases import Clients
from m100link.apps.station.ros.messages import Message
from m100link.errors import M100Error, UsageError
from m100link.protocol.commands.control import Arm
from m100link.protocol.commands.gimbal import GimbalAngle, GimbalAngleMode, GimbalSpeed
from m100link.protocol.firmware import FIRMWARE_3_1

__all__ = ["Payload"]

_CAMERA = (Action.TAKE_PHOTO, Action.START_VIDEO, Action.STOP_VIDEO)
"""By the number that ``camera_action`` has for each."""

_KEPT = {
    "yaw": GimbalAngleMode.KEEP_YAW,
    "roll": GimbalAngleMode.KEEP_ROLL,
    "pitch": GimbalAngleMode.KEEP_PITCH,
}
_SHORTEST_S = 0.1


class Payload:
    """The topics and services of what hangs below, and of the motors.

    Args:
        agent: The agent that owns the aircraft.
        graph: Where they are offered.
        clients: Who holds the lease.
    """

    def __init__(self, agent: AgentClient, graph: Graph, clients: Clients) -> None:
        self._agent, self._clients = agent, clients
        graph.add_topic("/dji_sdk/gimbal_angle_cmd", "dji_sdk/Gimbal", self._on_angles)
        graph.add_topic("/dji_sdk/gimbal_speed_cmd", "geometry_msgs/Vector3Stamped", self._on_rates)
        for name, kind, handler in (
            ("camera_action", "CameraAction", self._camera),
            ("camera_action_control", "CameraActionControl", self._camera),
            ("gimbal_angle_control", "GimbalAngleControl", self._angles),
            ("gimbal_speed_control", "GimbalSpeedControl", self._rates),
            ("drone_arm_control", "DroneArmControl", self._arm),
        ):
            graph.add_service(
                f"/dji_sdk/{name}", f"dji_sdk/{kind}", clients.answering(name, handler)
            )

    def _on_angles(self, session: Listener, message: Message, now: float) -> None:
        """Radians, as DJI's node has them; seconds are whole."""
        try:
            command = GimbalAngle(
                yaw_deg=math.degrees(message["yaw"]),
                roll_deg=math.degrees(message["roll"]),
                pitch_deg=math.degrees(message["pitch"]),
                mode=message["mode"],
                duration_s=max(_SHORTEST_S, float(message["ts"])),
            )
            data = command.value(FIRMWARE_3_1)
        except M100Error as error:
            self._clients.complain(session, error)
        else:
            self._send(session, Action.GIMBAL_ANGLES, data)

    def _on_rates(self, session: Listener, message: Message, now: float) -> None:
        """Radians per second: roll, pitch, yaw. One message turns it for half a second."""
        vector = message["vector"]
        try:
            command = GimbalSpeed(
                yaw_deg_s=math.degrees(vector["z"]),
                roll_deg_s=math.degrees(vector["x"]),
                pitch_deg_s=math.degrees(vector["y"]),
            )
            data = command.value(FIRMWARE_3_1)
        except M100Error as error:
            self._clients.complain(session, error)
        else:
            self._send(session, Action.GIMBAL_RATES, data)

    async def _angles(self, call: Call) -> Message:
        """Tenths of a degree and of a second."""
        asked = call.request
        mode = GimbalAngleMode(asked["absolute_or_incremental"])
        for axis, bit in _KEPT.items():
            if asked[f"{axis}_cmd_ignore"]:
                mode |= bit
        command = GimbalAngle(
            yaw_deg=asked["yaw"] / 10.0,
            roll_deg=asked["roll"] / 10.0,
            pitch_deg=asked["pitch"] / 10.0,
            mode=mode,
            duration_s=max(_SHORTEST_S, asked["duration"] / 10.0),
        )
        return await self._turn(call, Action.GIMBAL_ANGLES, command)

    async def _rates(self, call: Call) -> Message:
        """Tenths of a degree per second; one call turns it for half a second."""
        asked = call.request
        command = GimbalSpeed(
            yaw_deg_s=asked["yaw_rate"] / 10.0,
            roll_deg_s=asked["roll_rate"] / 10.0,
            pitch_deg_s=asked["pitch_rate"] / 10.0,
        )
        return await self._turn(call, Action.GIMBAL_RATES, command)

    async def _turn(
        self, call: Call, action: Action, command: GimbalAngle | GimbalSpeed
    ) -> Message:
        data = command.value(FIRMWARE_3_1)
        await self._agent.ask(action, self._clients.lease(call.session), data=data)
        return {"result": True}

    def _send(self, session: Listener, action: Action, data: bytes) -> None:
        async def send() -> None:
            await self._agent.ask(action, self._clients.lease(session), data=data)

        self._clients.run(session, send, action.value)

    async def _camera(self, call: Call) -> Message:
        number = call.request["camera_action"]
        if number >= len(_CAMERA):
            raise UsageError("camera_action is 0 (photo), 1 (start video) or 2 (stop video)")
        await self._agent.ask(_CAMERA[number], self._clients.lease(call.session))
        return {"result": True}

    async def _arm(self, call: Call) -> Message:
        wanted = call.request["arm"]
        if wanted > 1:
            raise UsageError("arm is 1 (start the motors) or 0 (stop them)")
        action = Action.ARM if wanted else Action.DISARM
        await self._agent.ask(action, self._clients.held(call.session))
        command_set, command_id = Arm.ADDRESS
        return {"result": True, "cmd_set": command_set, "cmd_id": command_id}
