"""The virtual autopilot: bytes in, bytes out, time as an argument; no I/O, no clock, no chance.

::

    autopilot.receive_data(data, now)        bytes from the onboard device
    autopilot.advance(now)                   let time pass: flight, telemetry, time-outs
    autopilot.data_to_send() -> bytes        the bytes for the line
    autopilot.next_wakeup() -> float         call advance again at the latest then

``now`` is seconds of any clock that does not run backwards; power-on is the first call. Here meet
the aircraft, a :class:`~m100link.sim.vehicle.vehicle.Vehicle`, and the session layer, an
:class:`~m100link.session.Endpoint`; commands and telemetry stand between the two.
"""

from __future__ import annotations

from collections import deque

from m100link.protocol.codes import ActivationCode, SystemCode, VersionCode
from m100link.protocol.command import Notification, encode_code
from m100link.protocol.commands.activation import Activate, Version
from m100link.protocol.commands.control import Move
from m100link.protocol.commands.monitor import AuthorityChanged, FromMobile
from m100link.protocol.firmware import Generation
from m100link.session import Endpoint, SessionMode
from m100link.sim.commands import CommandTable, Counters, LastCommand
from m100link.sim.line import TelemetryPusher
from m100link.sim.vehicle.dynamics import STEP_S
from m100link.sim.vehicle.settings import AssistantSettings, Undecodable
from m100link.sim.vehicle.vehicle import Vehicle
from m100link.wire.cipher import Cipher
from m100link.wire.crc import frame_crc32
from m100link.wire.frame import Frame, encode_frame

_MOBILE_BYTES_PER_S = 1000.0  # document 2.2.3.3: around 1 KB/s from the mobile device
_PUSH_TIMEOUT_S, _PUSH_TRIES = 0.5, 10


class _NoKey(Cipher):
    """Stands in for the cipher while there is no key, so that encrypted frames are noticed."""

    __slots__ = ()

    def __init__(self) -> None:
        """There is nothing to set up."""

    def decrypt_blocks(self, data: bytes) -> bytes:
        """Leave the data as they are: nobody will be able to read them."""
        return data


class Autopilot:
    """The N1 autopilot of a virtual Matrice 100: the aircraft, and what answers on its line.

    Args:
        vehicle: The aircraft.

    Attributes:
        profile: The firmware that speaks.
        vehicle: As given.
        endpoint: Decoder, sender and receiver; ``endpoint.statistics`` counts frames.
        received_movements: Last 10000 movement commands as they came.
        received_commands: Last 1000 other commands, with their answers.
        counters: Counts since it was made.
    """

    OUTBOX_LIMIT = 4096

    def __init__(self, vehicle: Vehicle) -> None:
        self.profile = vehicle.profile
        self.vehicle = vehicle
        self._telemetry = TelemetryPusher(self.profile, vehicle.sensors, vehicle.assistant.rates_hz)
        self.counters = Counters()
        self.received_movements: deque[Move] = deque(maxlen=10_000)
        self.received_commands: deque[LastCommand] = deque(maxlen=1000)
        self.endpoint = self._fresh_endpoint()
        self._commands = CommandTable(self)
        # Whole frames, so that faults of the line strike frames.
        self._outbox: deque[bytes] = deque()
        # Messages of the app that wait for their turn at about 1 KB/s, and when the next may go.
        self._from_mobile: deque[bytes] = deque()
        self._mobile_free_at = 0.0
        # Of the pushes; the endpoint numbers its own requests.
        self._sequence = 0
        # A notification waits for its ack: the only time that the endpoint's timer matters.
        self._has_requests = False
        # The caller's clock at the first call; steps are counted from there, so no error adds up.
        self._power_on: float | None = None
        self._ticks = 0
        # Losses of authority reported to the onboard device, out of vehicle.authority_losses.
        self._pushed_losses = 0

    def _fresh_endpoint(self) -> Endpoint:
        endpoint = Endpoint(forget_after=self.vehicle.settings.forget_acks_after)
        endpoint.decoder.cipher = _NoKey()
        return endpoint

    # --- the line ---------------------------------------------------------------------------

    def receive_data(self, data: bytes, now: float) -> None:
        """Take bytes from the onboard device. Whatever they are, nothing raises."""
        self.advance(now)
        if self.vehicle.is_restarting:
            return
        for event in self.endpoint.receive_data(data, now):
            if isinstance(event, Frame):
                self._execute(event, now)
        # Acks go out before the telemetry that is made after them.
        if self.endpoint.has_output:
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
        if self._pushed_losses < self.vehicle.authority_losses:
            self._tell_of_losses()  # a switch was moved between two steps
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
        if frame.encrypted and not (self._has_key and self._commands.knows(frame.data)):
            self._answer_undecodable(frame, now)
        else:
            reply = self._commands.execute(frame)
            if reply is not None:
                encrypted = frame.encrypted and not reply.plain
                self.endpoint.acknowledge(frame, reply.payload, now=now, encrypted=encrypted)
                if reply.begins_anew:
                    self.endpoint.receiver.forget_answered()

    @property
    def _has_key(self) -> bool:
        return self.endpoint.receiver.cipher is not None  # the decoder's may be the stand-in

    def _answer_undecodable(self, frame: Frame, now: float) -> None:
        self.counters.undecodable += 1
        code: int = SystemCode.NOT_SUPPORTED
        if not self._has_key and len(frame.data) == _ACTIVATION_SIZE:
            code = ActivationCode.ENCRYPTED  # unreadable, but no other command is that long
        elif self.vehicle.settings.undecodable is Undecodable.SILENCE:
            return
        self.vehicle.log("an encrypted frame could not be read: the keys differ")
        self.endpoint.acknowledge(frame, encode_code(code), now=now, encrypted=False)

    def _push(self, frame: bytes) -> None:
        self._sequence = (self._sequence + 1) & 0xFFFF
        self._send(frame)

    def _send(self, frame: bytes) -> None:
        self._outbox.append(frame)
        if len(self._outbox) > self.OUTBOX_LIMIT:
            self._outbox.popleft()
            self.counters.dropped_frames += 1

    # --- time -------------------------------------------------------------------------------

    def _tick(self) -> None:
        self._ticks += 1
        vehicle = self.vehicle
        vehicle.step()
        if vehicle.is_restarting:
            return
        if self._pushed_losses < vehicle.authority_losses:
            self._tell_of_losses()
        if self._from_mobile and vehicle.time >= self._mobile_free_at:
            message = self._from_mobile.popleft()
            self._mobile_free_at = vehicle.time + len(message) / _MOBILE_BYTES_PER_S
            self.notify(FromMobile(message))
        if vehicle.missions.is_active and self.profile.generation >= Generation.V3_1:
            for notification in vehicle.missions.news(vehicle.time):
                self.notify(notification)
        frame = self._telemetry.frame(self._sequence)
        if frame is not None:
            self._push(frame)

    def _tell_of_losses(self) -> None:
        """Notify the onboard device of each loss of authority not reported to it yet."""
        while self._pushed_losses < self.vehicle.authority_losses:
            self._pushed_losses += 1
            wants_ack = self.vehicle.settings.authority_push_session != 0
            mode = SessionMode.RELIABLE if wants_ack else SessionMode.NO_ACK
            self.notify(AuthorityChanged(), mode)

    def notify(self, notification: Notification, mode: SessionMode | None = None) -> None:
        """Send a notification as it declares or in another mode, repeated where it wants an ack."""
        data = notification.encode(self.profile)
        if (mode or notification.SESSION_MODE) is SessionMode.NO_ACK:
            self._push(encode_frame(data, session=0, sequence=self._sequence))
            return
        assert self._power_on is not None
        now = self._power_on + self.vehicle.time
        self.endpoint.request(data, now=now, timeout=_PUSH_TIMEOUT_S, tries=_PUSH_TRIES)
        self._has_requests = True
        self._collect()

    # --- what commands do -------------------------------------------------------------------

    def version(self, code: VersionCode) -> Version:
        """The answer to a version query."""
        name = self.profile.version_name
        crc = frame_crc32(name.encode("latin-1") + b"\0")
        serial = self.vehicle.serial_number if self.profile.has_serial else None
        return Version(code, crc, name, serial)

    def activate(self, request: Activate) -> ActivationCode:
        """Carry an activation request out; on success the key is in use at once."""
        code = self.vehicle.activate(request)
        active = self.vehicle.activation.active
        if code == ActivationCode.SUCCESS and active is not None:
            self.endpoint.cipher = Cipher(active.key)
        return code

    def set_rates(self, rates_hz: dict[str, int]) -> None:
        """Change telemetry rates."""
        self._telemetry.set_rates(rates_hz)

    @property
    def rates_hz(self) -> dict[str, int]:
        """Telemetry rates in force."""
        return self._telemetry.rates_hz

    # --- what people do ---------------------------------------------------------------------

    def configure(self, assistant: AssistantSettings) -> None:
        """Change the assistant's settings."""
        self.vehicle.configure(assistant)
        self._telemetry.set_rates(assistant.rates_hz)

    def queue_from_mobile(self, data: bytes) -> None:
        """Messages of the mobile app to the onboard device, in pieces of 100 bytes, 1 KB/s."""
        self._from_mobile.extend(data[at : at + 100] for at in range(0, len(data), 100))

    def reboot(self) -> None:
        """Restart: silence, then a fresh start with nobody active or in control.

        In the air the motors keep it up meanwhile. Permissions from the server stay known.
        """
        self.vehicle.restart()
        self.endpoint = self._fresh_endpoint()
        self._outbox.clear()
        self._from_mobile.clear()
        self._mobile_free_at = 0.0
        self._sequence = 0
        self._pushed_losses = self.vehicle.authority_losses
        self._telemetry.set_rates(self.vehicle.assistant.rates_hz)


_ACTIVATION_SIZE = 2 + 44
