"""The virtual autopilot: bytes in, bytes out, time as an argument; no I/O, no clock, no chance.

::

    autopilot.receive_data(data, now)        bytes from the onboard device
    autopilot.advance(now)                   let time pass: flight, telemetry, time-outs
    autopilot.data_to_send() -> bytes        what it has to say
    autopilot.next_wakeup() -> float         call advance again at the latest then

``now`` is seconds of any clock that does not run backwards; power-on is the first call. Everything
that chance decides comes from the one :class:`random.Random` that is passed in.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

from m100link.protocol.codes import ActivationCode, AuthorityCode, SystemCode, VersionCode
from m100link.protocol.command import encode_code
from m100link.protocol.commands.activation import Activate, Version
from m100link.protocol.commands.control import Move
from m100link.protocol.commands.monitor import AuthorityChanged, FromMobile
from m100link.protocol.firmware import FirmwareProfile, profile
from m100link.protocol.records import Device, RcMode
from m100link.session import Endpoint, Received
from m100link.sim.commands import Commands, LastCommand
from m100link.sim.telemetry import Sensors, TelemetryPusher
from m100link.sim.vehicle.activation import Activation
from m100link.sim.vehicle.authority import ControlArbiter
from m100link.sim.vehicle.dynamics import STEP_S
from m100link.sim.vehicle.flight import FlightController
from m100link.sim.vehicle.gimbal import Camera, GimbalMount
from m100link.sim.vehicle.mobile import ActivationServer, MobileApp
from m100link.sim.vehicle.remote import PilotRemote
from m100link.sim.vehicle.settings import AircraftSettings, AssistantSettings, Undecodable
from m100link.wire.cipher import Cipher
from m100link.wire.crc import frame_crc32
from m100link.wire.frame import Frame, encode_frame

if TYPE_CHECKING:
    from random import Random

__all__ = ["Autopilot", "Counters", "LogEntry"]

_MOBILE_BYTES_PER_S = 1000.0  # document 2.2.3.3: around 1 KB/s from the mobile device
_PUSH_TIMEOUT_S, _PUSH_TRIES = 0.5, 10
_SLOW_TICKS = 5  # switches and time-outs are looked at every 50 ms


class LogEntry(NamedTuple):
    """Something that happened to the aircraft, for people."""

    time: float
    text: str


@dataclass(slots=True)
class Counters:
    """What went over the line and what became of it.

    Attributes:
        movements: Movement commands received.
        ignored_movements: Those without effect: no authority, illegal, on the ground, no GPS.
        undecodable: Encrypted frames that could not be read as a command.
        authority_losses: Times that control passed away from the onboard device.
        dropped_frames: Frames that nobody fetched in time.
    """

    movements: int = 0
    ignored_movements: int = 0
    undecodable: int = 0
    authority_losses: int = 0
    dropped_frames: int = 0


class _NoKey(Cipher):
    """Stands in for the cipher while there is no key, so that encrypted frames are noticed."""

    __slots__ = ()

    def __init__(self) -> None:
        """There is nothing to set up."""

    def decrypt(self, data: bytes) -> bytes:
        """Leave the data as they are: nobody will be able to read them."""
        return data


class Autopilot:
    """The N1 autopilot of a virtual Matrice 100, with everything it is connected to.

    Args:
        random: Source of the sensor noise, the gusts and the serial number.
        firmware: Name of the firmware profile, or the profile.
        settings: The aircraft, its site and the open questions of the protocol.
        assistant: Settings of the PC assistant.
        remote: The remote control; by default in F, moved there after power-on.
        app: The mobile app; by default connected, with Internet.
        server: The registry of apps; by default an empty one.
        serial_number: Ten characters; by default drawn from ``random``.

    Attributes:
        activation, authority, flight, gimbal, camera, remote, app, server: The parts.
        endpoint: Decoder, sender and receiver; ``endpoint.statistics`` counts frames.
        received_movements: Last 10000 movement commands as they came.
        received_commands: Last 1000 other commands, with their answers.
        events: Last 200 things that happened.
        counters: Counts since it was made.
        time: Seconds since power-on.
    """

    OUTBOX_LIMIT = 4096

    def __init__(
        self,
        random: Random,
        *,
        firmware: str | FirmwareProfile = "1.0",
        settings: AircraftSettings | None = None,
        assistant: AssistantSettings | None = None,
        remote: PilotRemote | None = None,
        app: MobileApp | None = None,
        server: ActivationServer | None = None,
        serial_number: str | None = None,
    ) -> None:
        self.profile = profile(firmware)
        self.settings = settings or AircraftSettings()
        self.assistant = assistant or AssistantSettings()
        self.remote = remote or _remote_in_f()
        self.app = app or MobileApp(is_connected=True, has_internet=True)
        self.server = server or ActivationServer()
        self.serial_number = serial_number or f"041D{random.randrange(16**6):06X}"
        self.flight = FlightController(self.settings)
        self.gimbal = GimbalMount()
        self.camera = Camera()
        self.activation = Activation(
            self.profile,
            self.serial_number,
            server=self.server,
            app=self.app,
            server_delay=self.settings.server_delay,
        )
        self.authority = ControlArbiter(
            self.profile, self.settings, self.assistant, self.remote, self.app
        )
        self._sensors = self._make_sensors(random)
        self._telemetry = TelemetryPusher(self.profile, self._sensors, self.assistant.rates_hz)
        self._random = random
        self._gust_north = self._gust_east = 0.0
        self.counters = Counters()
        self.received_movements: deque[Move] = deque(maxlen=10_000)
        self.received_commands: deque[LastCommand] = deque(maxlen=1000)
        self.events: deque[LogEntry] = deque(maxlen=200)
        self.endpoint = Endpoint(forget_after=self.settings.forget_acks_after)
        self.endpoint.decoder.cipher = _NoKey()
        self._commands = Commands(self)
        self._outbox: deque[bytes] = deque()
        self._from_mobile: deque[bytes] = deque()
        self._mobile_free_at = 0.0
        self._sequence = 0
        self._has_requests = False
        self._power_on: float | None = None
        self._ticks = 0
        self._silent_until = -math.inf
        self._rc_lost_since: float | None = None
        self._gps_good_at: float | None = None
        self.time = 0.0

    def _make_sensors(self, random: Random) -> Sensors:
        return Sensors(
            self.profile,
            self.settings,
            random,
            flight=self.flight,
            authority=self.authority,
            remote=self.remote,
            gimbal=self.gimbal,
        )

    # --- the line ---------------------------------------------------------------------------

    def receive_data(self, data: bytes, now: float) -> None:
        """Take bytes from the onboard device. Whatever they are, nothing raises."""
        self.advance(now)
        if self.is_rebooting:
            return
        self.endpoint.receive_data(data, now)
        for event in self.endpoint.events():
            if isinstance(event, Received):
                self._execute(event.frame, now)
        # Acks go out before the telemetry that is made after them.
        self._collect()

    def advance(self, now: float) -> None:
        """Let time pass until ``now``."""
        if self._power_on is None:
            self._power_on = now
        # Half a microsecond: a timer that fires exactly on time must find its tick due.
        while self._power_on + (self._ticks + 1) * STEP_S <= now + 5e-7:
            self._tick()
        if self._has_requests:
            self._repeat_requests(now)

    def next_wakeup(self) -> float | None:
        """When :meth:`advance` should be called at the latest; None before power-on."""
        if self._power_on is None:
            return None
        return self._power_on + (self._ticks + 1) * STEP_S

    def skip(self, now: float) -> None:
        """Let the time until ``now`` not have been: the computer slept, the aircraft did, too."""
        if self._power_on is not None:
            self._power_on = now - self._ticks * STEP_S

    def frames_to_send(self) -> list[bytes]:
        """Take the frames that wait to be sent, oldest first."""
        outbox = self._outbox
        if len(outbox) == 1:
            return [outbox.popleft()]
        frames = list(outbox)
        outbox.clear()
        return frames

    def data_to_send(self) -> bytes:
        """Take the bytes that wait to be sent."""
        return b"".join(self.frames_to_send())

    def _collect(self) -> None:
        for frame in self.endpoint.output():
            self._send(frame)

    def _repeat_requests(self, now: float) -> None:
        wakeup = self.endpoint.next_wakeup()
        if wakeup is None:
            self._has_requests = False
        elif wakeup <= now:
            self.endpoint.handle_timer(now)
            self._collect()

    def _execute(self, frame: Frame, now: float) -> None:
        if frame.encrypted and not self._is_readable(frame):
            self._answer_undecodable(frame, now)
        else:
            reply = self._commands.execute(frame)
            if reply is not None:
                encrypted = frame.encrypted and not reply.plain
                self.endpoint.acknowledge(frame, reply.payload, now=now, encrypted=encrypted)

    def _is_readable(self, frame: Frame) -> bool:
        return self._has_key and self._commands.knows(frame.data)

    @property
    def _has_key(self) -> bool:
        return self.endpoint.receiver.cipher is not None  # the decoder's may be the stand-in

    def _answer_undecodable(self, frame: Frame, now: float) -> None:
        self.counters.undecodable += 1
        code: int = SystemCode.NOT_SUPPORTED
        if not self._has_key and len(frame.data) == _ACTIVATION_SIZE:
            code = ActivationCode.ENCRYPTED  # unreadable, but no other command is that long
        elif self.settings.undecodable is Undecodable.SILENCE:
            return
        self.log("an encrypted frame could not be read: the keys differ")
        self.endpoint.acknowledge(frame, encode_code(code), now=now, encrypted=False)

    def _push(self, data: bytes) -> None:
        self._send(encode_frame(data, session=0, sequence=self._next_sequence()))

    def _send(self, frame: bytes) -> None:
        self._outbox.append(frame)
        if len(self._outbox) > self.OUTBOX_LIMIT:
            self._outbox.popleft()
            self.counters.dropped_frames += 1

    def _next_sequence(self) -> int:
        sequence = self._sequence
        self._sequence = (sequence + 1) & 0xFFFF
        return sequence

    # --- time -------------------------------------------------------------------------------

    def _tick(self) -> None:
        self._ticks += 1
        self._sensors.ticks += 1
        self.time = now = self._ticks * STEP_S
        flight = self.flight
        self.remote.now = now
        flight.step(now, self.authority.device, self.remote)
        if self._ticks % _SLOW_TICKS == 0:
            self._look_around(now)
        if now < self._silent_until:
            return
        frame = self._telemetry.frame(self._sequence)
        if frame is not None:
            self._next_sequence()
            self._send(frame)

    def _look_around(self, now: float) -> None:
        """Whatever need not be looked at a hundred times a second."""
        settings, flight = self.settings, self.flight
        if settings.gusts:
            self._blow()
        else:
            flight.dynamics.wind_north = settings.wind_north
            flight.dynamics.wind_east = settings.wind_east
        self.gimbal.advance(now, _SLOW_TICKS * STEP_S)
        if self._gps_good_at is not None and now >= self._gps_good_at:
            self._gps_good_at = None
            flight.gps_health = 5
        if flight.battery_percent <= settings.critical_battery_percent and flight.force_landing():
            self.log("battery nearly empty: landing")
        self._watch_remote(now)
        self.refresh()
        if self._from_mobile and now >= max(self._mobile_free_at, self._silent_until):
            message = self._from_mobile.popleft()
            self._mobile_free_at = now + len(message) / _MOBILE_BYTES_PER_S
            self._push(FromMobile(message).encode(self.profile))

    def _blow(self) -> None:
        """Gusts: wind with a memory of two seconds."""
        settings, motion = self.settings, self.flight.dynamics
        keep = math.exp(-_SLOW_TICKS * STEP_S / 2.0)
        kick = settings.gusts * math.sqrt(1.0 - keep * keep)
        self._gust_north = keep * self._gust_north + kick * self._random.gauss(0.0, 1.0)
        self._gust_east = keep * self._gust_east + kick * self._random.gauss(0.0, 1.0)
        motion.wind_north = settings.wind_north + self._gust_north
        motion.wind_east = settings.wind_east + self._gust_east

    def _watch_remote(self, now: float) -> None:
        authority = self.authority
        if self.remote.is_connected:
            if self.authority.device is Device.RC:
                self.flight.corner_gesture(self.remote.sticks().are_in_corner)
            self._rc_lost_since = None
            if authority.failsafe:
                authority.failsafe = False
                self.flight.interrupt()
                self.log("remote control is back")
            return
        if self._rc_lost_since is None:
            self._rc_lost_since = now
            self.log("remote control lost")
        elif not authority.failsafe and now - self._rc_lost_since > self.settings.rc_lost_after:
            authority.failsafe = True
            self.refresh()
            self.flight.interrupt()
            if not self.flight.dynamics.on_ground:
                self.log("failsafe: going home")
                self.flight.go_home()

    def refresh(self) -> None:
        """Decide anew who holds control; tell the onboard device if it is no longer the one."""
        before = self.authority.device
        lost = self.authority.update()
        if self.authority.device is not before:
            self.log(f"control: {before.name} to {self.authority.device.name}")
        if lost:
            self.counters.authority_losses += 1
            self.flight.interrupt()
            if not self.is_rebooting:
                self._notify_authority_change()

    def _notify_authority_change(self) -> None:
        data = AuthorityChanged().encode(self.profile)
        if self.settings.authority_push_session == 0:
            self._push(data)
            return
        assert self._power_on is not None
        now = self._power_on + self.time
        self.endpoint.request(data, now=now, timeout=_PUSH_TIMEOUT_S, tries=_PUSH_TRIES)
        self._has_requests = True
        self._collect()

    # --- what commands do -------------------------------------------------------------------

    def version(self, code: VersionCode) -> Version:
        """The answer to a version query."""
        name = self.profile.version_name
        crc = frame_crc32(name.encode("latin-1") + b"\0")
        serial = self.serial_number if self.profile.has_serial else None
        return Version(code, crc, name, serial)

    def activate(self, request: Activate) -> ActivationCode:
        """Carry an activation request out; on success the key is in use at once."""
        code = self.activation.request(request, self.time)
        active = self.activation.active
        if code == ActivationCode.SUCCESS and active is not None:
            self.endpoint.cipher = Cipher(active.key)
        self.log(f"activation of app {request.app_id}: {code.meaning}")
        return code

    def request_authority(self, obtain: bool) -> AuthorityCode:
        """Carry a request for control authority out."""
        before = self.authority.device
        code = self.authority.request(obtain)
        if self.authority.device is not before:
            self.log(f"control: {before.name} to {self.authority.device.name}")
            if not obtain:
                self.flight.interrupt()
        return code

    def set_rates(self, rates_hz: dict[str, int]) -> None:
        """Change telemetry rates."""
        self._telemetry.set_rates(rates_hz)

    @property
    def rates_hz(self) -> dict[str, int]:
        """Telemetry rates in force."""
        return self._telemetry.rates_hz

    @property
    def heading_deg(self) -> float:
        """Where the nose points, -180 to 180 degrees."""
        return math.degrees(self.flight.dynamics.yaw)

    # --- what people do ---------------------------------------------------------------------

    def configure(self, assistant: AssistantSettings) -> None:
        """Change the assistant's settings."""
        self.assistant = self.authority.assistant = assistant
        self._telemetry.set_rates(assistant.rates_hz)
        self.refresh()

    def queue_from_mobile(self, data: bytes) -> None:
        """Messages of the mobile app to the onboard device, in pieces of 100 bytes, 1 KB/s."""
        self._from_mobile.extend(data[at : at + 100] for at in range(0, len(data), 100))

    def search_gps(self, seconds: float) -> None:
        """No GPS now, good reception after some seconds."""
        self.flight.gps_health = 0
        self._gps_good_at = self.time + seconds

    def set_gps_health(self, health: int) -> None:
        """Set GPS health, 0 to 5, for good."""
        if not 0 <= health <= 5:
            raise ValueError(f"GPS health is 0 to 5, not {health}")
        self._gps_good_at = None
        self.flight.gps_health = health

    @property
    def is_rebooting(self) -> bool:
        """Whether it is silent because it restarts."""
        return self.time < self._silent_until

    def reboot(self) -> None:
        """Restart the autopilot: silence, then a fresh start with nobody active or in control.

        In the air the motors keep it up meanwhile. What the server allowed stays known.
        """
        self.log("autopilot restarts")
        self._silent_until = self.time + self.settings.reboot_seconds
        self.authority.is_requested = self.authority.is_pending = False
        self.authority.device = Device.RC
        self.flight.interrupt()
        self.activation.power_off()
        self.remote.moved_since_power_on = False
        self.remote.virtual.reset()
        self.endpoint = Endpoint(forget_after=self.settings.forget_acks_after)
        self.endpoint.decoder.cipher = _NoKey()
        self._outbox.clear()
        self._from_mobile.clear()
        self._mobile_free_at = 0.0
        self._sequence = 0
        self._sensors.ticks = 0
        self._telemetry.set_rates(self.assistant.rates_hz)

    def log(self, text: str) -> None:
        """Note something that happened."""
        self.events.append(LogEntry(self.time, text))


_ACTIVATION_SIZE = 2 + 44


def _remote_in_f() -> PilotRemote:
    remote = PilotRemote()
    remote.set_mode(RcMode.F)
    return remote
