"""DJI's node of 2015-12 to 2017 (versions 2.3 and 3.1): its topics, services and navigation.

Its frames are those of the wire: the ground north-east with heights and climb rates **upwards**,
the body forward-right-down, quaternions scalar first, angles in degrees, yaw clockwise from north.
:class:`~m100link.apps.station.ros.dji_sdk.DjiSdk` publishes :data:`TOPICS` with its own.

What differs from DJI's source, for safety or because the source is wrong:

* A setpoint expires after 0.2 s, and one that was not flown is answered with ``result`` false.
* ``global_position_control`` flies to the place that it names. DJI's code subtracts the local
  position from an offset that is one already.
* Navigation ends by the height above take-off, in which it is flown, not by the altitude. Cancel
  works for each action. At the end, and however it ends, the aircraft hovers.
* ``local_position`` is silent until GPS has fixed its origin.
"""

from __future__ import annotations

import asyncio
import ctypes
import math
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

from m100link.apps.agent import orders
from m100link.apps.agent.client import PRESSED_AT, AgentClient
from m100link.apps.station.ros.actions import ActionServer, Tell
from m100link.apps.station.ros.graph import Graph, GraphListener, ServiceCall
from m100link.apps.station.ros.leases import Clients
from m100link.apps.station.ros.messages import Message
from m100link.errors import M100Error, NotObserved, UsageError
from m100link.log.ros2 import DjiTopic
from m100link.protocol.commands.control import Move
from m100link.protocol.records import Position
from m100link.protocol.setpoint import ReceivedMove
from m100link.telemetry.integrity import has_fix
from m100link.telemetry.sample import Sample

EARTH_M = 6_378_137.0
"""Radius of the sphere on which DJI's node measures, m."""

POSITION_FLAG = 0x90  # offset over ground (m), height above take-off (m), heading (°)
GROUND_VELOCITY_FLAG, BODY_VELOCITY_FLAG = 0x49, 0x4B  # m/s, m/s, °/s; both in stable mode

_HEALTH = 3  # of GPS; a better one fixes the origin of local positions
_FEEDBACK_S = 0.1
_NEAR_DEG, _NEAR_M, _NEAR_HEIGHT_M = 0.00001, 0.1, 0.12


def local_of(origin: tuple[float, float], place: tuple[float, float]) -> tuple[float, float]:
    """North and east of an origin, m, as DJI's node reckons; places are latitude, longitude, °."""
    north, east = (math.radians(b - a) * EARTH_M for a, b in zip(origin, place, strict=True))
    return north, east * math.cos(math.radians(place[0]))


def place_of(origin: tuple[float, float], north: float, east: float) -> tuple[float, float]:
    """Latitude and longitude, °, of what is so far north and east of an origin, m."""
    latitude = origin[0] + math.degrees(north / EARTH_M)
    narrow = EARTH_M * math.cos(math.radians(latitude))
    return latitude, origin[1] + math.degrees(east / narrow)


# -- topics ----------------------------------------------------------------------------------------


def _ts(sample: Sample) -> int:
    tick = sample.time.tick if sample.time is not None else 0
    return ctypes.c_int32(tick).value  # as the node casts it


def _row(kind: str, frame: str | None, read: Callable[[Sample], dict[str, Any] | None]) -> DjiTopic:
    def make(sample: Sample) -> dict[str, Any] | None:
        made = read(sample)
        return None if made is None else {"ts": _ts(sample)} | made

    return DjiTopic(kind if "/" in kind else f"dji_sdk/{kind}", frame, make)


def _time(sample: Sample) -> dict[str, Any] | None:
    time = sample.time
    if time is None:
        return None
    return {"time": time.tick, "time_ns": time.nanoseconds or 0, "sync_flag": time.sync or 0}


def _attitude(sample: Sample) -> dict[str, Any] | None:
    if sample.attitude is None or sample.angular_velocity is None:
        return None
    names = ("q0", "q1", "q2", "q3", "wx", "wy", "wz")
    return dict(zip(names, (*sample.attitude, *sample.angular_velocity), strict=True))


def _global_position(sample: Sample) -> dict[str, Any] | None:
    position = sample.position
    if position is None:
        return None
    return {
        "latitude": position.latitude_deg,
        "longitude": position.longitude_deg,
        "altitude": position.altitude_m,
        "height": position.height_m,
        "health": position.gps_health or 0,
    }


def _velocity(sample: Sample) -> dict[str, Any] | None:
    velocity = sample.velocity
    if velocity is None:
        return None
    values = dict(zip(("vx", "vy", "vz"), velocity[:3], strict=True))
    return values | {"health_flag": int(bool(velocity.is_valid))}


def _acceleration(sample: Sample) -> dict[str, Any] | None:
    found = sample.acceleration
    return None if found is None else dict(zip(("ax", "ay", "az"), found[:3], strict=True))


def _gimbal(sample: Sample) -> dict[str, Any] | None:
    found = sample.gimbal
    if found is None:
        return None
    return {"roll": found.roll_deg, "pitch": found.pitch_deg, "yaw": found.yaw_deg}


def _channels(sample: Sample) -> dict[str, Any] | None:
    found = sample.remote_control
    if found is None:
        return None
    made = {name: float(getattr(found, name)) for name in ("roll", "pitch", "yaw", "throttle")}
    return made | {"mode": float(found.mode), "gear": float(found.gear or 0)}


def _compass(sample: Sample) -> dict[str, Any] | None:
    """The lowest byte of each number: its message has no room for more."""
    found = sample.magnetometer
    if found is None or not all(map(math.isfinite, found)):
        return None
    return {axis: ctypes.c_int8(int(one)).value for axis, one in zip("xyz", found, strict=True)}


def _power(sample: Sample) -> dict[str, Any] | None:
    return None if sample.battery is None else {"percentage": sample.battery.percent}


def _device(sample: Sample) -> dict[str, Any] | None:
    found = sample.control_device
    if found is None:
        return None
    return {
        "control_mode": found.mode or 0,
        "cur_ctrl_dev_in_navi_mode": found.control & 0x07,
        "serial_req_status": int(found.is_requested),
        "virtual_rc_status": int(found.is_virtual_rc),
    }


WORLD = "/world"

TOPICS: Mapping[str, DjiTopic] = {
    "time_stamp": _row("TimeStamp", "/time", _time),
    "attitude_quaternion": _row("AttitudeQuaternion", WORLD, _attitude),
    "global_position": _row("GlobalPosition", WORLD, _global_position),
    "velocity": _row("Velocity", WORLD, _velocity),
    "acceleration": _row("Acceleration", WORLD, _acceleration),
    "gimbal": _row("Gimbal", "/gimbal", _gimbal),
    "rc_channels": _row("RCChannels", "/rc", _channels),
    "compass": _row("Compass", WORLD, _compass),
    "power_status": _row("PowerStatus", None, _power),
    "flight_control_info": _row("FlightControlInfo", None, _device),
}
"""The topics that a package of telemetry fills alone, by the name below ``dji_sdk/``."""


# -- services and navigation -----------------------------------------------------------------------

_NOT_HERE = {
    "virtual_rc_enable_control": "VirtualRCEnableControl",
    "virtual_rc_data_control": "VirtualRCDataControl",
    "sync_flag_control": "SyncFlagControl",
    "message_frequency_control": "MessageFrequencyControl",
    "mission_followme_upload": "MissionFmUpload",
    "mission_followme_set_target": "MissionFmSetTarget",
}
"""Services of that node that are answered with ``result`` false, and their types."""

_WHY_NOT = (
    "the station has its own rates, sends no synchronisation signal, replaces no remote control, "
    "and flies no follow-me mission"
)

_ARE_SILENT = {"A3_GPS": "A3GPS", "A3_RTK": "A3RTK"}  # an A3 has these; the M100 does not


class Node2016:
    """The node of 2016 without the telemetry of :data:`TOPICS`."""

    def __init__(self, agent: AgentClient, graph: Graph, clients: Clients) -> None:
        self._agent, self._graph, self._clients = agent, graph, clients
        #: Latitude and longitude, °, from which local positions count; None before a good fix.
        self.origin: tuple[float, float] | None = None
        agent.on_sample.append(self._fix_origin)
        self.topics: dict[str, DjiTopic] = {
            **TOPICS,
            "local_position": _row("LocalPosition", WORLD, self._local_position),
            "odometry": _row("nav_msgs/Odometry", WORLD, self._odometry),
            "activation": _row(
                "std_msgs/UInt8", None, lambda _: {"data": int(agent.state.is_activated)}
            ),
        }
        """Every topic that a package of telemetry fills, by the name below ``dji_sdk/``."""
        for name, kind in _ARE_SILENT.items():
            graph.add_topic(f"/dji_sdk/{name}", f"dji_sdk/{kind}")
        self._from_mobile = graph.add_topic(
            "/dji_sdk/data_received_from_remote_device", "dji_sdk/TransparentTransmissionData"
        )
        self._add_services()
        for name, kind, work in (
            ("drone_task_action", "DroneTask", self._do_task),
            ("local_position_navigation_action", "LocalPositionNavigation", self._go_local),
            ("global_position_navigation_action", "GlobalPositionNavigation", self._go_global),
            ("waypoint_navigation_action", "WaypointNavigation", self._go_waypoints),
        ):
            ActionServer(agent, graph, clients, f"/dji_sdk/{name}", f"dji_sdk/{kind}", work)
        WebGroundStation(agent, graph, clients, self._go_waypoints)

    def tell_from_mobile(self, data: bytes) -> None:
        """The pilot's app has sent data."""
        self._graph.publish(self._from_mobile, {"data": data}, self._agent.now)

    # -- local positions -------------------------------------------------------------------------

    def _fix_origin(self, sample: Sample) -> None:
        position = sample.position
        if self.origin is not None or position is None or not has_fix(position):
            return
        if position.gps_health is None or position.gps_health > _HEALTH:
            self.origin = (position.latitude_deg, position.longitude_deg)

    def _local(self, position: Position) -> tuple[float, float]:
        if self.origin is None:
            raise NotObserved(
                "local positions have no origin yet",
                cause=f"GPS has not been better than {_HEALTH} of 5 since the station started",
                remedy="wait for GPS",
            )
        return local_of(self.origin, (position.latitude_deg, position.longitude_deg))

    def _local_position(self, sample: Sample) -> dict[str, Any] | None:
        position = sample.position
        if position is None or self.origin is None or not position.is_possible:
            return None
        north, east = self._local(position)
        return {"x": north, "y": east, "z": position.height_m}

    def _odometry(self, sample: Sample) -> dict[str, Any] | None:
        place, attitude = self._local_position(sample), sample.attitude
        velocity, rates = sample.velocity, sample.angular_velocity
        if place is None or attitude is None or velocity is None or rates is None:
            return None
        q0, q1, q2, q3 = attitude
        pose = {"position": place, "orientation": {"x": q1, "y": q2, "z": q3, "w": q0}}
        twist = {
            "linear": dict(zip("xyz", velocity[:3], strict=True)),
            "angular": dict(zip("xyz", rates, strict=True)),
        }
        unknown = [0.0] * 36
        return {
            "child_frame_id": "",
            "pose": {"pose": pose, "covariance": unknown},
            "twist": {"twist": twist, "covariance": unknown},
        }

    # -- services --------------------------------------------------------------------------------

    def _add_services(self) -> None:
        for name, kind, make in (
            ("attitude_control", "AttitudeControl", self._raw),
            ("velocity_control", "VelocityControl", self._velocity),
            ("local_position_control", "LocalPositionControl", self._to_local),
            ("global_position_control", "GlobalPositionControl", self._to_global),
        ):
            on_call = partial(self._steer, make)
            self._graph.add_service(f"/dji_sdk/{name}", f"dji_sdk/{kind}", on_call)
        for name, kind in _NOT_HERE.items():
            self._graph.add_service(f"/dji_sdk/{name}", f"dji_sdk/{kind}", self._decline)
        self._clients.offer("version_check", "VersionCheck", self._check_version)
        self._clients.offer("send_data_to_remote_device", "SendDataToRemoteDevice", self._send)

    def _steer(self, make: Callable[[Message], ReceivedMove], call: ServiceCall) -> None:
        """Fly a setpoint for its lifetime; programs call this at 50 Hz."""
        try:
            self._clients.fly(call.session, make(call.request))
        except M100Error as error:
            self._clients.complain(call.session, error)
            call.respond({"result": False})
        else:
            call.respond({"result": True})

    def _move(self, flag: int, x: float, y: float, z: float, yaw: float) -> ReceivedMove:
        return ReceivedMove.read(Move(flag, x, y, z, yaw), self._clients.profile)

    def _raw(self, asked: Message) -> ReceivedMove:
        return self._move(asked["flag"], asked["x"], asked["y"], asked["z"], asked["yaw"])

    def _velocity(self, asked: Message) -> ReceivedMove:
        flag = GROUND_VELOCITY_FLAG if asked["frame"] else BODY_VELOCITY_FLAG
        return self._move(flag, asked["vx"], asked["vy"], asked["vz"], asked["yawRate"])

    def _to_local(self, asked: Message) -> ReceivedMove:
        north, east = self._local(self._position())
        offset = (asked["x"] - north, asked["y"] - east)
        return self._move(POSITION_FLAG, *offset, asked["z"], asked["yaw"])

    def _to_global(self, asked: Message) -> ReceivedMove:
        position = self._position()
        here = (position.latitude_deg, position.longitude_deg)
        offset = local_of(here, (asked["latitude"], asked["longitude"]))
        return self._move(POSITION_FLAG, *offset, asked["altitude"], asked["yaw"])

    def _position(self) -> Position:
        position = self._agent.view.to_steer_by(Position)
        if position is None or not has_fix(position):
            raise NotObserved(
                "the position is not known well enough to fly by",
                cause="GPS is weak, or telemetry does not arrive",
                remedy="wait for GPS of at least 3 of 5",
            )
        return position

    def _decline(self, call: ServiceCall) -> None:
        name = call.service.name
        self._clients.complain(call.session, UsageError(f"{name} does nothing here: {_WHY_NOT}"))
        call.respond({"result": False})

    async def _check_version(self, call: ServiceCall) -> Message:
        await self._agent.ask(orders.AskVersion())
        return {"result": True}

    async def _send(self, call: ServiceCall) -> Message:
        return await self._clients.order(call, orders.SendToMobile(call.request["data"]))

    # -- navigation ------------------------------------------------------------------------------

    async def _do_task(self, client: GraphListener, goal: Message, tell: Tell) -> None:
        """Done when the aircraft has accepted it, as in DJI's node."""
        tasks = {1: orders.TakeOff(), 2: orders.Land(), 3: orders.GoHome()}
        order = tasks.get(goal["task"])
        if order is None:
            raise UsageError("tasks of this action are 1 (take-off), 2 (landing) and 3 (go-home)")
        session = self._clients.session(client)
        await self._agent.background.begin(lambda begun: session.ask(order, begun.set), order.label)
        tell(progress=1)

    async def _go_local(self, client: GraphListener, goal: Message, tell: Tell) -> None:
        self._local(self._position())  # there is an origin
        assert self.origin is not None
        origin, target = self.origin, (goal["x"], goal["y"], goal["z"])

        def measured(position: Position) -> tuple[float, ...]:
            return (*self._local(position), position.height_m)

        names = ("x_progress", "y_progress", "z_progress")
        near = (_NEAR_M, _NEAR_M, _NEAR_M)
        place = place_of(origin, goal["x"], goal["y"])
        order = orders.FlyTo(*place, height=goal["z"], yaw_deg=0.0)
        await self._fly(client, order, _Progress(names, near, target, measured, tell))

    async def _go_global(self, client: GraphListener, goal: Message, tell: Tell) -> None:
        await self._go(client, goal, 0.0, tell)

    async def _go(self, client: GraphListener, to: Message, yaw: float, tell: Tell) -> None:
        target = (to["latitude"], to["longitude"], to["altitude"])

        def measured(position: Position) -> tuple[float, ...]:
            return (position.latitude_deg, position.longitude_deg, position.height_m)

        names = ("latitude_progress", "longitude_progress", "altitude_progress")
        near = (_NEAR_DEG, _NEAR_DEG, _NEAR_HEIGHT_M)
        order = orders.FlyTo(*target[:2], height=target[2], yaw_deg=yaw)
        await self._fly(client, order, _Progress(names, near, target, measured, tell))

    async def _go_waypoints(self, client: GraphListener, goal: Message, tell: Tell) -> None:
        for index, one in enumerate(goal["waypoint_list"]["waypoint_list"]):
            await self._go(client, one, float(one["heading"]), partial(tell, index_progress=index))
            await asyncio.sleep(one["staytime"])

    async def _fly(self, client: GraphListener, order: orders.FlyTo, progress: _Progress) -> None:
        progress.begin(self._position())
        while self._agent.state.task == orders.TakeOff.label:  # noqa: ASYNC110 - a state has no event
            await asyncio.sleep(_FEEDBACK_S)  # the aircraft ignores DJI's node meanwhile
        session = self._clients.session(client)
        flying = self._agent.background.spawn(session.ask(order), f"navigation of {client.name}")
        try:
            while not (await asyncio.wait({flying}, timeout=_FEEDBACK_S))[0]:
                progress.tell(self._agent.view.get(Position))
        finally:
            flying.cancel()
        flying.result()  # or its error
        progress.tell_all()


class _Progress:
    """The feedback of a flight: percent of each axis, 100 where it is near enough."""

    def __init__(
        self,
        names: tuple[str, ...],
        near: tuple[float, ...],  # distances that count as there, in the units of the target
        target: tuple[float, ...],
        measured: Callable[[Position], tuple[float, ...]],
        tell: Tell,
    ) -> None:
        self._names, self._near, self._target = names, near, target
        self._measured, self._tell = measured, tell
        self._start = target

    def begin(self, position: Position) -> None:
        self._start = self._measured(position)

    def tell(self, position: Position | None) -> None:
        if position is not None:
            axes = zip(self._start, self._measured(position), self._target, self._near, strict=True)
            self._tell(**dict(zip(self._names, (percent(*axis) for axis in axes), strict=True)))

    def tell_all(self) -> None:
        self._tell(**dict.fromkeys(self._names, 100))


def percent(start: float, now: float, target: float, near: float) -> int:
    """How much of a way is done, 0 to 100; 100 within ``near`` of its end."""
    rest, whole = abs(target - now), abs(target - start)
    if rest < near:
        return 100
    return max(0, min(99, 100 - int(100 * rest / whole))) if whole else 0


# -- DJI's web ground station of 2016 --------------------------------------------------------------

_WEB = "/dji_sdk_web_groundstation"
_WAITING, _UNDER_WAY = 1, 2
_START, _CANCEL, _NEWER = b"scn"


class WebGroundStation:
    """The program ``map_nav_srv`` behind DJI's map page: its action and two topics.

    The page uploads waypoints as a goal, and starts or cancels it by its number. The aircraft takes
    off first, if it stands. DJI's program has no pause in flight either.
    """

    def __init__(
        self,
        agent: AgentClient,
        graph: Graph,
        clients: Clients,
        fly: Callable[[GraphListener, Message, Tell], Any],  # flies a list of waypoints
    ) -> None:
        self._agent, self._clients, self._fly = agent, clients, fly
        self._number = 0  # of the task that waits or flies
        self._started: asyncio.Future[float] | None = None  # when its start was pressed, s
        name = f"{_WEB}/web_waypoint_receive_action"
        kind = f"{_WEB[1:]}/WebWaypointReceive"
        self._server = ActionServer(agent, graph, clients, name, kind, self._work)
        clients.hear(f"{_WEB}/map_nav_srv/ctrl", "std_msgs/Bool", self._switch)
        graph.add_topic(f"{_WEB}/map_nav_srv/cmd", f"{_WEB[1:]}/MapNavSrvCmd", self._on_command)

    async def _switch(self, client: GraphListener, message: Message) -> None:
        await self._clients.switch(client, on=message["data"], activates=True)

    def _on_command(self, client: GraphListener, message: Message, now: float) -> None:
        code, is_ours = message["cmdCode"], message["tid"] == self._number
        if code == _CANCEL:
            self._server.cancel_all("it was cancelled on the page", client)
        elif code == _NEWER and not is_ours:
            self._server.cancel_all("newer waypoints come")
        elif code == _START and is_ours:
            if self._started is not None and not self._started.done():
                self._started.set_result(now)
        elif code != _NEWER:
            why = f"command {code} does nothing here: 115 (start) of the newest upload, 99 (cancel)"
            self._clients.complain(client, UsageError(why))

    async def _work(self, client: GraphListener, goal: Message, tell: Tell) -> None:
        self._number = goal["tid"]
        self._started = asyncio.get_running_loop().create_future()
        tell(stage=_WAITING)
        PRESSED_AT.set(await self._started)
        tell(stage=_UNDER_WAY)
        session = self._clients.session(client)
        if self._agent.view.is_on_ground is True:
            await session.ask(orders.TakeOff())
        await self._fly(client, goal, partial(tell, stage=_UNDER_WAY))
