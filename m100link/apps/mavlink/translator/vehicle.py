"""One aircraft as a MAVLink vehicle: messages in, messages out, the time as an argument."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from pathlib import Path

from m100link import __version__
from m100link.apps.agent.client import AgentClient
from m100link.apps.agent.control_session import ControlSession
from m100link.apps.agent.messages import LOG_ONLY, Event, EventTopic
from m100link.apps.agent.orders import FlyAround, FlyTo
from m100link.apps.mavlink.files import FileService
from m100link.apps.mavlink.order_executor import MissionFlights
from m100link.apps.mavlink.translator import telemetry
from m100link.apps.mavlink.translator.codec import LAYOUTS, Address, MavlinkMessage, Peer
from m100link.apps.mavlink.translator.commands import CommandProtocol
from m100link.apps.mavlink.translator.flight_mode_manager import FlightModeManager
from m100link.apps.mavlink.translator.missions import MissionProtocol
from m100link.apps.mavlink.translator.numbers import (
    BaseMode,
    Capability,
    MavCommand,
    MavResult,
    MissionType,
    Severity,
    SystemStatus,
)
from m100link.apps.mavlink.translator.offboard import Manual, Offboard
from m100link.apps.mavlink.translator.orders import Asked, read_command
from m100link.apps.mavlink.translator.parameters import (
    METADATA,
    ParameterProtocol,
    component_metadata,
)
from m100link.apps.mavlink.translator.payload import Payload
from m100link.apps.mavlink.translator.vehicle_state import (
    CAMERA,
    FlightSource,
    Mode,
    VehiclePhase,
    VehicleState,
    available,
    current,
    heartbeat,
    mode_of_number,
)
from m100link.errors import M100Error
from m100link.geodesy import LocalFrame
from m100link.protocol.records import Position, Velocity

COMPONENT = 1  # MAV_COMP_ID_AUTOPILOT1
_HEARTBEAT_S = 1.0
_PROGRESS_S = 0.3
_UNKNOWN_PROGRESS = 255
_VENDOR, _PRODUCT = 0x2CA3, 0x0100  # DJI's number at the USB forum; the product is ours
_TO_ALL = (0, COMPONENT)
_GREETING = "DJI M100: modes of PX4, no programs for ArduPilot"
# So far ahead the fence is looked at, s, and by so much more per m/s: it needs them to stop, from
# 25 m/s at a tilt of 35 degrees, too.
_AHEAD_S, _AHEAD_S2_M = 1.9, 0.042
_AWAY_M = 0.3  # so far it may be ordered to move away from the fence while it stands

_FLIGHTS = (FlightSource.FLIGHT, FlightSource.MISSION, FlightSource.PAUSED)
"""Flights that lead back into the fence by themselves, if they lead there."""

_COMMANDS = ("COMMAND_LONG", "COMMAND_INT")
_CAMERA_BEAT = MavlinkMessage(
    "HEARTBEAT",
    # MAV_TYPE_CAMERA, MAV_AUTOPILOT_INVALID
    {"type": 30, "autopilot": 8, "system_status": SystemStatus.ACTIVE, "mavlink_version": 3},
    component=CAMERA,
)
_QUESTIONS = ("REQUEST_", "GET_", "SET_MESSAGE_")  # begins of the names of commands that only ask
_PARAMETER_MESSAGES = ("PARAM_REQUEST_LIST", "PARAM_REQUEST_READ", "PARAM_SET")
_MISSION_MESSAGES = (
    *("MISSION_COUNT", "MISSION_ITEM_INT", "MISSION_REQUEST_LIST", "MISSION_REQUEST_INT"),
    *("MISSION_REQUEST", "MISSION_CLEAR_ALL", "MISSION_ACK"),
)


class MavlinkVehicle:
    """The vehicle, with a system id of 1 to 250."""

    def __init__(
        self,
        known: AgentClient,
        session: ControlSession,
        system: int,
        autopilot: int,
        logs: Path | None = None,  # the folder of its flight logs; None where nothing is recorded
    ) -> None:
        self.system, self._autopilot = system, autopilot
        # Messages to send: to which peer, to which addresses, or None for everybody.
        self.outbox: list[tuple[MavlinkMessage, Peer | tuple[Address, ...] | None]] = []
        self.world = VehicleState(known, session)  # what is known of the aircraft
        self._texts = telemetry.Texts(self._note)
        self._parameters = ParameterProtocol(self.world, system)
        settings, tell = self._parameters.values, self._texts.tell
        self._offboard = Offboard(self.world, settings)
        self._manual = {
            mode: Manual(self.world, settings, is_tilt=mode is Mode.ALTCTL)
            for mode in (Mode.POSCTL, Mode.ALTCTL)
        }
        streams: dict[Mode, Offboard | Manual] = {Mode.OFFBOARD: self._offboard, **self._manual}
        self.manager = FlightModeManager(self.world, tell, streams)
        self.manager.on_armed = self._armed
        self._rates = telemetry.Rates(self.world)
        self._payload = Payload(self.world, self.manager, tell, self._answer, self._camera_changed)
        self._commands = CommandProtocol(
            self.world,
            self.manager,
            settings,
            self._rates,
            tell=tell,
            request=self._request,
            mission=lambda peer, first: self.flights.mission_request(peer, first),
            payload=self._payload,
            fence=self._may_fly_to,
        )
        self._missions = MissionProtocol(
            self._send,
            tell,
            ground=lambda: self.world.ground_altitude,
            speed=lambda: settings["MPC_XY_CRUISE"],
            may_change=self._may_change,
            refusal_of=self._commands.refusal_of,
        )
        self._missions.on_upload = self._log_items
        self.flights = MissionFlights(self.world, self.manager, self._missions, tell)
        self.files = FileService(logs, self._send, known)
        self.files.made |= METADATA
        self.world.is_fenced = self._is_fenced
        self._breach_m: float | None = None  # the least since it is outside; None inside
        # Peers that wait for the answer to arming, and when each last heard that it takes time.
        self._arming: dict[Peer, float] = {}
        self._in_force: dict[int, str] = {}  # uploads, for the flight log
        self._was_connected, self._beaten_at, self._camera_beaten_at = True, 0.0, -math.inf
        self._beaten: tuple[object, ...] = ()
        self._handlers = self._by_name()

    def _by_name(self) -> dict[str, Callable[[MavlinkMessage, Peer, float], None]]:
        return {
            **dict.fromkeys(_COMMANDS, self._command),
            "SET_MODE": self._set_mode,
            **dict.fromkeys(_PARAMETER_MESSAGES, self._parameter),
            "SET_POSITION_TARGET_LOCAL_NED": self._setpoint,
            "SET_ATTITUDE_TARGET": self._setpoint,
            "MANUAL_CONTROL": self._sticks,
            **dict.fromkeys(_MISSION_MESSAGES, self._missions.receive),
            "MISSION_SET_CURRENT": self._set_current,
            "REQUEST_DATA_STREAM": self._data_stream,
            "PING": self._ping,
            "TIMESYNC": self._timesync,
            **self._payload.handlers,
            **self.files.handlers,
            "LOG_ERASE": self._no_erasing,
        }

    @property
    def is_busy(self) -> bool:
        """Whether it cannot wait: orders, setpoints, or telemetry that comes often."""
        is_streaming = self.manager.running is FlightSource.STREAM
        return any((self.manager.orders, is_streaming, self._rates.is_often))

    # -- what comes in ---------------------------------------------------------------------------

    def receive(self, message: MavlinkMessage, peer: Peer, now: float) -> None:
        """A message of a peer that is known by its heartbeat."""
        handler = self._handlers.get(message.name)
        if handler is not None and self._is_for_us(message):
            handler(message, peer, now)

    def _is_for_us(self, message: MavlinkMessage) -> bool:
        system = message.fields.get("target_system", message.fields.get("target", 0))
        component = message.fields.get("target_component", 0)
        is_ours = component in _TO_ALL
        if component == CAMERA and message.name in _COMMANDS:
            is_ours = self.world.has_payload
        return system in (0, self.system) and is_ours

    def _send(self, message: MavlinkMessage, to: Peer | tuple[Address, ...] | None = None) -> None:
        self.outbox.append((message, to))

    def _command(self, message: MavlinkMessage, peer: Peer, now: float) -> None:
        asked = read_command(message, peer)
        result = self._commands.carry_out(asked, now)
        if result is not None:
            self._answer(asked, result)
        elif asked.command == MavCommand.COMPONENT_ARM_DISARM:
            if peer in self._arming:
                self._acknowledge(asked.command, MavResult.IN_PROGRESS, peer)
                return
            self._arming[peer] = now
            self._log(asked, MavResult.IN_PROGRESS)

    def _answer(self, asked: Asked, result: MavResult) -> None:
        component = CAMERA if asked.component == CAMERA else COMPONENT
        self._acknowledge(asked.command, result, asked.peer, component)
        self._log(asked, result)

    def _log(self, asked: Asked, result: MavResult) -> None:
        """Let the flight log say who asked for what; programs ask in vain for each message."""
        if not str(asked).startswith(_QUESTIONS):
            self._note(f"{asked.peer.name}: {asked}: {result.name}")

    def _log_items(
        self, peer: Peer, kind: int, items: Sequence[MavlinkMessage], refusal: str
    ) -> None:
        """Let the flight log have the mission or the fence that is in force, or why it is not."""
        name = f"a {MissionType(kind).name.lower()} of {len(items)} items"
        said = "; ".join(str(read_command(one, peer)) for one in items)
        if refusal:
            self._note(f"{peer.name} did not get {name}: {refusal}")
        else:
            self._in_force[kind] = f"{peer.name} uploaded {name}: {said}"
            self._note(self._in_force[kind])

    def _note(self, text: str) -> None:
        self.world.known.note(text, LOG_ONLY)

    def _acknowledge(
        self, command: int, result: MavResult, peer: Peer, component: int = COMPONENT
    ) -> None:
        fields = {
            "command": command,
            "result": result,
            "progress": _UNKNOWN_PROGRESS if result is MavResult.IN_PROGRESS else 0,
        }
        self._send(MavlinkMessage("COMMAND_ACK", fields | peer.target, component=component), peer)

    def _armed(self, error: M100Error | None) -> None:
        result = MavResult.ACCEPTED if error is None else MavResult.TEMPORARILY_REJECTED
        waiting, self._arming = self._arming, {}
        for peer in waiting:
            self._acknowledge(MavCommand.COMPONENT_ARM_DISARM, result, peer)

    def _set_mode(self, message: MavlinkMessage, peer: Peer, now: float) -> None:
        """SET_MODE, which older programs send; it has no answer but the heartbeat."""
        number = message["custom_mode"]
        main, sub = number >> 16 & 0xFF, number >> 24
        if mode_of_number(main, sub) is None or not message["base_mode"] & BaseMode.CUSTOM:
            self._texts.tell(Severity.WARNING, f"mode 0x{number:08x} is not one of this aircraft")
            return
        asked = Asked(MavCommand.DO_SET_MODE, (BaseMode.CUSTOM, main, sub, math.nan), peer)
        result = self._commands.carry_out(asked, now)
        self._acknowledge(LAYOUTS["SET_MODE"].number, result or MavResult.ACCEPTED, peer)
        self._log(asked, result or MavResult.ACCEPTED)

    def _parameter(self, message: MavlinkMessage, peer: Peer, now: float) -> None:
        is_others = self.manager.other_operator(peer) is not None
        answers, refusal = self._parameters.receive(message, is_others=is_others)
        if message.name == "PARAM_SET":
            wanted = f"{message['param_id']} = {message['param_value']:g}"
            self._note(f"{peer.name}: {wanted}: {(refusal and f'refused: {refusal}') or 'taken'}")
        if refusal:
            self._texts.tell(Severity.WARNING, refusal)
        for one in answers:
            to = peer.target if one.name == "PARAM_ERROR" else {}
            self._send(MavlinkMessage(one.name, {**one.fields, **to}), peer)

    def _may_steer(self, peer: Peer) -> bool:
        return self.manager.operator in (None, peer)

    def _setpoint(self, message: MavlinkMessage, peer: Peer, now: float) -> None:
        if self._may_steer(peer):
            self.manager.steering = peer
            refusal = self._offboard.receive(message, now)
            if refusal:
                self._texts.tell(Severity.WARNING, f"setpoint: {refusal}")

    def _sticks(self, message: MavlinkMessage, peer: Peer, now: float) -> None:
        if self._may_steer(peer):
            self.manager.steering = peer
            for manual in self._manual.values():
                manual.receive(message, now)

    def _data_stream(self, message: MavlinkMessage, peer: Peer, now: float) -> None:
        """The request of older programs for telemetry: it has no answer."""
        hz = message["req_message_rate"] if message["start_stop"] else 0
        self._rates.set_group(message["req_stream_id"], hz, peer)

    def _ping(self, message: MavlinkMessage, peer: Peer, now: float) -> None:
        if message["target_system"] == 0:
            self._send(MavlinkMessage("PING", dict(message.fields) | peer.target), peer)

    def _timesync(self, message: MavlinkMessage, peer: Peer, now: float) -> None:
        if message["tc1"] == 0:
            self._send(
                MavlinkMessage("TIMESYNC", {"tc1": int(now * 1e9), "ts1": message["ts1"]}), peer
            )

    def _no_erasing(self, message: MavlinkMessage, peer: Peer, now: float) -> None:
        self._texts.tell(Severity.WARNING, "logs are not erased: the folder keeps its newest ones")

    # -- missions --------------------------------------------------------------------------------

    def _set_current(self, message: MavlinkMessage, peer: Peer, now: float) -> None:
        number = (float(message["seq"]), math.nan, math.nan, math.nan)
        self._commands.carry_out(Asked(MavCommand.DO_SET_MISSION_CURRENT, number, peer), now)
        self._send(self._missions.current_message(is_flying=self.manager.flies_mission))

    def _may_change(self, peer: Peer, kind: int) -> str:
        if kind == MissionType.FENCE and not self.world.is_armed:
            return ""
        if self.manager.flies_mission and kind == MissionType.MISSION:
            return "it is flown: hold first"
        if self.world.is_armed and self.manager.operator not in (None, peer):
            return f"{self.manager.operator.name} flies" if self.manager.operator else ""
        return ""

    def _may_fly_to(
        self, begin: tuple[float, float] | None, end: tuple[float, float], radius: float
    ) -> str:
        """Why the fence refuses a flight to a place or around it; empty if it does not.

        ``begin``: None for where the aircraft is.
        """
        fence, position = self._missions.fence, self.world.known.view.place
        why = fence.refusal(*end, radius)
        if why or not fence.areas:
            return why
        if begin is not None:
            return fence.on_the_way(begin, end)
        if position is None:
            return ""
        here = position.latitude_deg, position.longitude_deg
        depth = fence.depth_m(*here)
        frame = LocalFrame(*here)
        north, east = frame.to_local(*end)
        step = 1.0 / max(math.hypot(north, east), 1.0)
        if depth and fence.depth_m(*frame.to_geodetic(north * step, east * step)) >= depth:
            return f"{fence.refusal(*here)}: it does not lead out straight"
        return fence.on_the_way(here, end)

    def _is_fenced(self) -> bool | None:
        """Whether it is known to be inside of the fence; None without one."""
        fence, place = self._missions.fence, self.world.known.view.place
        if not fence.areas:
            return None
        return place is not None and not fence.depth_m(place.latitude_deg, place.longitude_deg)

    def _watch_fence(self) -> None:
        """Hold before the fence; from outside only flights lead back, not setpoints.

        A flight that is begun again and again flies a little each time: from outside, none may lead
        farther away than it was at its least. A mission that is to pause may still fly. Where it is
        now follows from the newest report, and nobody flies on who does not know that.
        """
        fence = self._missions.fence
        if not fence.areas or self.manager.phase is not VehiclePhase.AIRBORNE:
            self._breach_m = None
            return
        if self.manager.running not in (*_FLIGHTS, FlightSource.STREAM):
            self._breach_m = math.inf  # what begins outside has been asked for its direction
            return
        view = self.world.known.view
        position, velocity = view.place, view.get(Velocity)
        if position is None or velocity is None:
            self.manager.hold("hold: the distance to the fence is unknown")
            return
        here = position.latitude_deg, position.longitude_deg
        speed = complex(velocity.north_m_s, velocity.east_m_s)
        late = _AHEAD_S + _AHEAD_S2_M * abs(speed)
        late += max(view.age(one) or 0.0 for one in (Position, Velocity))
        late += self.world.known.state.round_trip or 0.0  # what is seen is old, and a hold is late
        way = speed * late
        ahead = self._ahead(LocalFrame(*here), way)
        depth, least = fence.depth_m(*here), self._breach_m
        if not depth:
            self._breach_m, why = None, fence.on_the_way(here, ahead)
        else:
            self._breach_m = depth if least is None else min(depth, least)
            is_deeper = least is None or fence.depth_m(*ahead) > least + _AWAY_M
            leads_back = self.manager.running in _FLIGHTS and not is_deeper
            why = "" if leads_back and not fence.enters(here, ahead) else fence.refusal(*here)
        if why:
            self.manager.hold(f"hold: {why}")

    def _ahead(self, frame: LocalFrame, way: complex) -> tuple[float, float]:
        """Where it will be; a flight of the agent stops at its place, or turns around it.

        ``way``: m north, and east as the imaginary part, if it flies straight on.
        """
        leg = self.flights.target() if self.manager.running is FlightSource.FLIGHT else None
        if isinstance(leg, FlyTo | FlyAround) and way:
            to = complex(*frame.to_local(leg.latitude_deg, leg.longitude_deg))
            past, share = way - to, to / way
            if isinstance(leg, FlyAround):
                is_on_it = abs(to) < leg.radius + 0.5 < abs(past) + 0.5
                way = to + past * leg.radius / abs(past) if is_on_it else way
            elif 0.0 < share.real < 1.0 and abs(share.imag * abs(way)) < 1.0:  # straight there
                way = to
        return frame.to_geodetic(way.real, way.imag)

    # -- what is asked for -----------------------------------------------------------------------

    def _request(
        self, number: int, parameter: float, peer: Peer, now: float, component: int
    ) -> bool:
        """Send a message of a component, 0 for any, by its number; False where it has none."""
        name = telemetry.NUMBERS.get(number)
        if name is not None:
            message = self._rates.message(name, now)
            if message is not None and component not in (0, message.component):
                return False
            if message is not None:
                self._send(message, peer)
            return message is not None
        made = {
            LAYOUTS["AUTOPILOT_VERSION"].number: lambda: [self._version()],
            LAYOUTS["AVAILABLE_MODES"].number: lambda: available(_whole(parameter)),
            LAYOUTS["MISSION_CURRENT"].number: lambda: [
                self._missions.current_message(is_flying=self.manager.flies_mission)
            ],
            LAYOUTS["CURRENT_MODE"].number: lambda: [current(self.manager.mode)],
            LAYOUTS["COMPONENT_METADATA"].number: lambda: [component_metadata()],
            LAYOUTS["HEARTBEAT"].number: lambda: [self._heartbeat()],
            LAYOUTS["MESSAGE_INTERVAL"].number: lambda: [self._interval(_whole(parameter), peer)],
        }.get(number)
        messages = [] if made is None else made()
        for one in messages:
            self._send(one, peer)
        return bool(messages)

    def _version(self) -> MavlinkMessage:
        major, minor, patch = map(int, re.findall(r"\d+", __version__)[:3])  # 1.0.0rc1, too
        capabilities = (
            Capability.COMMAND_INT
            | Capability.PARAM_ENCODE_BYTEWISE
            | Capability.SET_ATTITUDE_TARGET
            | Capability.SET_POSITION_TARGET_LOCAL_NED
            | Capability.MAVLINK2
            | Capability.MISSION_INT
            | Capability.MISSION_FENCE
            | Capability.FTP
        )
        # Ground stations warn of a PX4 below 1.4.1, and of an official one (type 255) that is not
        # the newest: it is one of development (0), and the version of m100link the vendor's.
        fields = {
            "capabilities": capabilities,
            "flight_sw_version": 0x010F_0000,
            "vendor_id": _VENDOR,
            "product_id": _PRODUCT,
            "flight_custom_version": (0, 0, 0, 0, 0, patch & 0xFF, minor & 0xFF, major & 0xFF),
        }
        return MavlinkMessage("AUTOPILOT_VERSION", fields)

    def _interval(self, number: int, peer: Peer) -> MavlinkMessage:
        interval = 0  # of what is not there, by the definition; -1 of what nobody asked for
        if number in telemetry.NUMBERS:
            hz = self._rates.hz(telemetry.NUMBERS[number], peer)
            interval = round(1e6 / hz) if hz > 0 else -1
        return MavlinkMessage("MESSAGE_INTERVAL", {"message_id": number, "interval_us": interval})

    # -- time passes -----------------------------------------------------------------------------

    def event(self, event: Event) -> None:
        """An event of the agent becomes a text for people."""
        self._texts.tell(telemetry.severity_of(event.level), event.text, is_own=False)
        if event.topic in (EventTopic.STOPPED, EventTopic.HALTED):
            is_stop = event.topic is EventTopic.STOPPED
            self.manager.stopped("STOP was pressed" if is_stop else event.text)

    def greet(self, peer: Peer) -> None:
        """Say to a new peer that this is no ArduPilot: programs for that wait for its messages."""
        self._send(
            MavlinkMessage("STATUSTEXT", {"severity": Severity.INFO, "text": _GREETING}), peer
        )

    def tell(self, text: str) -> None:
        self._texts.tell(Severity.WARNING, text)

    def advance(
        self, now: float, audience: telemetry.Audience, lost: Callable[[Peer, float], bool]
    ) -> None:
        """Let time pass: steer, and send what is due.

        ``now``: s. ``lost``: whether a peer is, at a time.
        """
        self.world.look()
        operator = self.manager.operator
        if operator is not None and lost(operator, now):
            self.manager.operator_lost()
        self._watch_fence()
        if self._payload.is_at_work:
            self._payload.advance(now, lost, audience.values())
        if self.files.transfers:
            self.files.forget_gone(audience.values())
        self.manager.advance(now)
        for peer, told_at in self._arming.items():
            if now - told_at >= _PROGRESS_S:
                self._arming[peer] = now
                self._acknowledge(MavCommand.COMPONENT_ARM_DISARM, MavResult.IN_PROGRESS, peer)
        if self._texts.waiting:
            for text in self._texts.due(now):
                self._send(text)
        # A vehicle that nobody hears is silent: a ground station has to see that it is lost.
        view = self.world.known.view
        if view.is_connected is not self._was_connected:
            self._was_connected = view.is_connected
            # A new connection has a log of its own, which has to have what is in force, too.
            for upload in self._in_force.values() if self._was_connected else ():
                self._note(f"in force: {upload}")
        if view.is_heard:
            self._tell_state(now, audience)

    def _camera_changed(self) -> None:
        message = self._rates.message("CAMERA_CAPTURE_STATUS", self.world.known.now)
        if message is not None:
            self._send(message)

    def _heartbeat(self) -> MavlinkMessage:
        return heartbeat(self.world, self.manager.mode, self._autopilot)

    def _tell_state(self, now: float, audience: telemetry.Audience) -> None:
        beat = self._heartbeat()
        fields = tuple(beat.fields.values())
        if now - self._camera_beaten_at >= _HEARTBEAT_S:
            self._camera_beaten_at = now
            if self.world.has_payload:
                self._send(_CAMERA_BEAT)
        if fields != self._beaten or now - self._beaten_at >= _HEARTBEAT_S:
            if fields[:1] != self._beaten[:1]:
                self._send(current(self.manager.mode))
            self._beaten, self._beaten_at = fields, now
            self._send(beat)
        if now >= self._rates.due_at or audience != self._rates.audience:
            self.outbox += self._rates.due(now, audience)
        if now >= self._missions.due_at:
            for message in self._missions.due(now, is_flying=self.manager.flies_mission):
                self._send(message)


def _whole(value: float) -> int:
    return int(value) if math.isfinite(value) else 0
