"""The other end of the cable for tests: synchronous, in its own time, nothing hidden."""

from __future__ import annotations

from typing import Any, NamedTuple

from m100link.protocol import (
    Activate,
    ActivationCode,
    Command,
    Credentials,
    Request,
    RequestAuthority,
    Setpoint,
    StartTask,
    Task,
    TelemetryPacket,
)
from m100link.protocol.records import Device, FlightPhase
from m100link.sim import AircraftSettings, AssistantSettings, VirtualAircraft
from m100link.wire import Cipher, Frame, FrameDecoder, encode_frame


class Received(NamedTuple):
    """A frame and when it came."""

    time: float
    frame: Frame


class Host:
    """A program on the onboard device, and the time of both ends.

    Attributes:
        aircraft: The aircraft.
        now: The time; it passes in :meth:`wait` only.
        frames: Every frame received.
        wire: Every byte received and sent, for looking for what must not be there.
    """

    def __init__(self, aircraft: VirtualAircraft | None = None, **options: Any) -> None:
        self.aircraft = aircraft or VirtualAircraft(**options)
        print(self.aircraft)  # noqa: T201 (the seed, for tests that fail)
        self.autopilot = self.aircraft.autopilot
        self.vehicle = self.aircraft.vehicle
        self.profile = self.autopilot.profile
        self.now = 0.0
        self.frames: list[Received] = []
        self.wire = bytearray()
        self.cipher: Cipher | None = None
        self.decoder = FrameDecoder()
        self._sequence = 1000
        self.autopilot.advance(self.now)

    # --- bytes ------------------------------------------------------------------------------

    def send(
        self,
        data: bytes,
        *,
        session: int = 2,
        sequence: int | None = None,
        cipher: Cipher | None = None,
    ) -> int:
        """Send one frame; returns its sequence number."""
        if sequence is None:
            self._sequence += 1
            sequence = self._sequence & 0xFFFF
        self.send_raw(encode_frame(data, session=session, sequence=sequence, cipher=cipher))
        return sequence

    def send_raw(self, wire: bytes) -> None:
        """Send bytes as they are."""
        self.wire += wire
        self.autopilot.receive_data(wire, self.now)
        self.receive()

    def receive(self) -> None:
        """Take what the aircraft has to say."""
        data = self.autopilot.data_to_send()
        self.wire += data
        self.frames += [Received(self.now, frame) for frame in self.decoder.feed(data)]

    def wait(self, seconds: float, step: float = 0.01) -> None:
        """Let time pass."""
        end = self.now + seconds
        while self.now < end - 1e-9:
            self.now = min(end, self.now + step)
            self.autopilot.advance(self.now)
            self.receive()

    def acks(self, session: int, sequence: int) -> list[Frame]:
        """The acks of one command, in order."""
        return [
            received.frame
            for received in self.frames
            if received.frame.is_ack
            and (received.frame.session, received.frame.sequence) == (session, sequence)
        ]

    # --- commands ---------------------------------------------------------------------------

    def ask(self, command: Command, *, encrypted: bool | None = None, session: int = 2) -> Any:
        """Send a command and return its parsed ack, None if there is none."""
        ack = self.ask_raw(command.encode(self.profile), encrypted=encrypted, session=session)
        return command.parse_ack(ack.data) if ack and isinstance(command, Request) else None

    def ask_raw(
        self, data: bytes, *, encrypted: bool | None = None, session: int = 2
    ) -> Frame | None:
        """Send data and return the ack frame, None if there is none."""
        if encrypted is None:
            encrypted = self.cipher is not None and data[:1] == b"\x01"
        cipher = self.cipher if encrypted else None
        sequence = self.send(data, session=session, cipher=cipher)
        acks = self.acks(session, sequence)
        assert len(acks) <= 1
        return acks[0] if acks else None

    def activation(self, **changes: Any) -> Activate:
        """An activation request for the registered app, with changes."""
        credentials = self.aircraft.credentials
        options: dict[str, Any] = {
            "app_id": credentials.app_id,
            "level": credentials.level,
            "version": self.profile.activation_version or 1,
            "bundle_id": credentials.bundle_id,
        }
        return Activate(**(options | changes))

    def activate(self, credentials: Credentials | None = None) -> None:
        """Activate, as often as a new aircraft needs; from then on there is a key."""
        credentials = credentials or self.aircraft.credentials
        request = Activate.from_credentials(credentials, self.profile)
        codes = [self.ask(request), self.ask(request)]
        assert codes[-1] == ActivationCode.SUCCESS, codes
        self.use_key(Cipher(credentials.key))

    def use_key(self, cipher: Cipher) -> None:
        """Encrypt and decrypt with this key."""
        self.cipher = self.decoder.cipher = cipher

    def obtain(self) -> None:
        """Obtain control authority, with as many requests as the firmware needs."""
        for _ in range(self.profile.authority_requests):
            code = self.ask(RequestAuthority(True))
        assert code == 2, code

    def ready(self) -> Host:
        """Activate and obtain authority."""
        self.activate()
        self.obtain()
        return self

    def take_off(self) -> None:
        """Take off and hover."""
        assert self.ask(StartTask(1, Task.TAKE_OFF)) == 2
        self.wait(8.0)
        assert self.phase() is FlightPhase.IN_AIR

    def flying(self) -> Host:
        """Activate, obtain, take off."""
        self.ready()
        self.take_off()
        return self

    def move(self, setpoint: Setpoint) -> None:
        """Send one movement command."""
        data = setpoint.to_move(self.profile).encode(self.profile)
        self.send(data, session=0, cipher=self.cipher)

    def fly(self, setpoint: Setpoint, seconds: float, rate_hz: float = 50.0) -> None:
        """Send a movement command again and again."""
        for _ in range(round(seconds * rate_hz)):
            self.move(setpoint)
            self.wait(1.0 / rate_hz)

    # --- views ------------------------------------------------------------------------------

    @property
    def motion(self) -> Any:
        """The motion of the aircraft."""
        return self.vehicle.flight.dynamics

    def phase(self) -> FlightPhase:
        """Flight status."""
        return self.vehicle.flight.phase

    def device(self) -> Device:
        """Who is in control."""
        return self.vehicle.authority.device

    def packets(self, since: float = 0.0) -> list[TelemetryPacket]:
        """Telemetry received after a time."""
        return [
            TelemetryPacket(frame.data[2:], self.profile)
            for time, frame in self.frames
            if not frame.is_ack and frame.data[:2] == b"\x02\x00" and time > since
        ]

    def pushes(self, command_id: int) -> list[Received]:
        """Pushes of set 0x02 with that command id."""
        wanted = bytes((0x02, command_id))
        return [r for r in self.frames if not r.frame.is_ack and r.frame.data[:2] == wanted]


def aircraft(
    *,
    settings: dict[str, Any] | None = None,
    assistant: dict[str, Any] | None = None,
    **options: Any,
) -> VirtualAircraft:
    """A virtual aircraft with some settings changed."""
    if assistant is not None:
        options["assistant"] = AssistantSettings(**assistant)
    return VirtualAircraft(settings=AircraftSettings(**(settings or {})), **options)
