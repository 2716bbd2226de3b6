"""The settings of a virtual aircraft.

:class:`AssistantSettings` is what DJI's PC assistant sets on a real one (document, *Setup Steps*
and 2.2.3.1). :class:`AircraftSettings` is everything else: the physical aircraft and its site, and
a switch for each point on which the sources are silent or contradict each other
(docs/explanation/errata.md).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, fields
from enum import Enum
from typing import Literal

from m100link.protocol.commands.activation import RATES_HZ
from m100link.protocol.items import BY_NAME, ITEMS
from m100link.protocol.records import AccelerationMode
from m100link.sim.vehicle.dynamics import Airframe
from m100link.sim.vehicle.missions.route import MissionSettings

DEFAULT_RATES_HZ: dict[str, int] = {item.name: item.rate_hz for item in ITEMS}
"""Default frequency of each telemetry item (document 2.2.3.1)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class AssistantSettings:
    """The settings of the PC assistant; they survive power-off.

    Attributes:
        api_control_enabled: The box *enable API control*.
        ioc_on: Intelligent orientation control; on, it keeps the API out of the F position.
        baud_rate: Baud rate of the serial port, 8N1; a program that sets another one reads garbage.
        rates_hz: Rate per telemetry item: 0 (absent), 1, 10, 50 or 100 Hz.
        acceleration: How the PC assistant has acceleration sent: raw (body axes, in g, with
            gravity) or fused (ground axes, m/s²).
    """

    api_control_enabled: bool = True
    ioc_on: bool = False
    baud_rate: int = 230_400
    rates_hz: dict[str, int] = field(default_factory=DEFAULT_RATES_HZ.copy)
    acceleration: AccelerationMode = AccelerationMode.FUSED

    def __post_init__(self) -> None:
        """Complete the rates with the defaults and check them."""
        for name, rate in self.rates_hz.items():
            if name not in BY_NAME:
                raise ValueError(f"no telemetry item is called {name!r}: {', '.join(BY_NAME)}")
            if rate not in RATES_HZ:
                raise ValueError(f"{name} cannot be sent at {rate} Hz: {RATES_HZ}")
        if self.baud_rate <= 0:
            raise ValueError(f"a line of {self.baud_rate} baud carries nothing")
        if self.acceleration not in tuple(AccelerationMode):
            raise ValueError(
                f"acceleration is {' or '.join(AccelerationMode)}, not {self.acceleration!r}"
            )
        object.__setattr__(self, "rates_hz", DEFAULT_RATES_HZ | self.rates_hz)
        object.__setattr__(self, "acceleration", AccelerationMode(self.acceleration))


class Undecodable(Enum):
    """Answer to an encrypted command that cannot be read (the real one is not published)."""

    NOT_SUPPORTED = "0xFF00, not encrypted"
    SILENCE = "no answer"


@dataclass(frozen=True, slots=True, kw_only=True)
class AircraftSettings:
    """The aircraft, its site, and the open questions of the protocol.

    Attributes:
        airframe: Numbers of the flight model; None: those of the firmware.
        missions: How it takes waypoint, hotpoint and follow missions.
        latitude_deg: Where the aircraft stands when it is switched on, degrees north.
        longitude_deg: The same, degrees east.
        ground_altitude: Altitude of that place by the barometer, metres. DJI's flight sample waits
            for 0 after landing.
        heading_deg: Where the nose points then, degrees from north, clockwise.
        wind_north: Velocity of the air to the north, m/s.
        wind_east: Velocity of the air to the east, m/s.
        gusts: Standard deviation of the speed on top of the wind, m/s.
        noise: Scale of the sensor noise; 0 is none, 1 that of decent sensors. Place, height,
            velocity, attitude and magnetometer wander slowly; acceleration and angular velocity
            are noisy from sample to sample.
        take_off_height: Height of the hover that ends take-off, metres (not adjustable on the
            real one, "about 1.2 m").
        go_home_height: Go-home climbs to this height first, metres.
        go_home_radius: Nearer to the home point than this, go-home lands in place, metres.
        height_limit: Nothing climbs beyond it, metres.
        low_battery_percent: From here down the aircraft warns.
        critical_battery_percent: From here down it lands by itself.
        gps_seconds: Time from power-on to good GPS reception when started cold.
        movement_timeout: Seconds without a movement command until the aircraft brakes and hovers
            (undocumented; DJI's header says only that it hovers).
        rc_lost_after: Seconds without remote control until it goes home by itself.
        rc_lost_reads: RC channels in telemetry while the remote control is off: ``zeros`` (ETHZ's
            driver takes gear 0 for that), or ``kept``: centred sticks, and both switches as they
            stood.
        server_delay: Seconds that DJI's server takes to answer. A new aircraft answers the first
            attempt of an app with 3, and all others in this time.
        forget_acks_after: Seconds after which a stored ack is forgotten; None keeps it, as the
            document says (1.4). A version query forgets all of them in any case: it is what a
            program begins with, and DJI's begin with the same numbers each time.
        undecodable: Answer to encrypted commands that cannot be read.
        encrypted_control_only: Refuse plain commands of set 0x01, as the document's "should be
            encrypted" may be read; off by default because DJI's own sample moves plain.
        authority_push_session: Session of the notification 0x02/0x01: 0, or 2 with repeats until
            it is acknowledged.
        authority_resumes_after_app: Whether the onboard device gets authority back without a new
            request when the mobile app lets go.
        vertical_down: Send vertical velocity and acceleration positive downwards; the sources do
            not settle the sign.
        gimbal_follows: The gimbal's yaw turns with the nose, and absolute yaw counts from there. By
            default it stays fixed to the ground, and absolute yaw counts from north.
        minimum_thrust: Lowest thrust that thrust control accepts; later documents say 10.
        armed_idle_seconds: How long motors that were started run on the ground while nothing is
            commanded.
        reboot_seconds: How long the autopilot is silent while it restarts.
    """

    airframe: Airframe | None = None
    missions: MissionSettings = field(default_factory=MissionSettings)
    latitude_deg: float = 22.5431
    longitude_deg: float = 113.9589
    ground_altitude: float = 0.0
    heading_deg: float = 0.0
    wind_north: float = 0.0
    wind_east: float = 0.0
    gusts: float = 0.0
    noise: float = 0.0
    take_off_height: float = 1.2
    go_home_height: float = 20.0
    go_home_radius: float = 20.0
    height_limit: float = 120.0
    low_battery_percent: float = 25.0
    critical_battery_percent: float = 10.0
    gps_seconds: float = 30.0
    movement_timeout: float = 0.5
    rc_lost_after: float = 3.0
    rc_lost_reads: Literal["zeros", "kept"] = "zeros"
    server_delay: float = 0.0
    forget_acks_after: float | None = 5.0
    undecodable: Undecodable = Undecodable.NOT_SUPPORTED
    encrypted_control_only: bool = False
    authority_push_session: int = 0
    authority_resumes_after_app: bool = False
    vertical_down: bool = False
    gimbal_follows: bool = False
    minimum_thrust: float = 0.0
    armed_idle_seconds: float = 20.0
    reboot_seconds: float = 2.0

    def __post_init__(self) -> None:
        for one in fields(self):
            value = getattr(self, one.name)
            # A height without a limit is meant; any other such number would fly as a position.
            if isinstance(value, float) and not math.isfinite(value) and one.name != "height_limit":
                raise ValueError(f"{one.name} is finite, not {value}")
