"""The virtual aircraft as one object: autopilot, remote control, app, server and line.

Whatever a pilot, an app user, the weather or a loose plug can do to a Matrice 100 is a plain method
here. Tests call them, ``m100link sim`` binds them to keys, ``m100link sim ctl`` and scenario files
name them.
"""

from __future__ import annotations

from dataclasses import replace
from random import Random
from typing import Any

from m100link.protocol.codes import ActivationCode
from m100link.protocol.commands.activation import Activate, Credentials
from m100link.protocol.firmware import FirmwareProfile, profile
from m100link.protocol.records import RcMode
from m100link.sim.autopilot import Autopilot
from m100link.sim.line import NO_FAULTS, Line, LineFaults
from m100link.sim.vehicle.activation import DEMO_APP_ID, DEMO_KEY, ActivationServer, MobileApp
from m100link.sim.vehicle.remote import PilotRemote
from m100link.sim.vehicle.settings import AircraftSettings, AssistantSettings
from m100link.sim.vehicle.vehicle import Vehicle
from m100link.wire import Key


class VirtualAircraft:
    """A Matrice 100 that exists in memory.

    It stands ready to fly: API control enabled, mode switch in F (moved there after power-on), the
    app connected with Internet, GPS good, motors off. ``cold=True`` is the state after power-on
    instead: API control not enabled, switch in P, no app, no GPS yet.

    Args:
        seed: Of everything random. Equal seeds and equal inputs give equal flights.
        firmware: Name of the firmware profile, or the profile.
        app_id, key, level: The app registered at the server.
        cold: See above.
        activated: Activated for that app already, as by an earlier program.
        settings: The aircraft, its site and the open questions of the protocol.
        assistant: Settings of the PC assistant.
        faults: The faults of the line.
        paced: Bytes take the time that they need at the assistant's baud rate, in both directions.
            By default they take none: exact times for tests. ``m100link sim`` is paced.
        server: A registry to share among aircraft; by default one of its own.
        serial_number: Of the autopilot; by default drawn from the seed.

    Attributes:
        autopilot: The autopilot at the other end of the cable.
        vehicle: The aircraft itself, without the autopilot that answers on its line.
        line: The cable.
        remote, app, server: The remote control, the mobile app, the registry.
        credentials: The onboard device's credentials for activation.
        seed: As given.
    """

    # Without a dictionary `virtual.wind = 3` is refused: a test of wind would pass in a calm.
    __slots__ = (
        "__weakref__",
        "app",
        "autopilot",
        "credentials",
        "line",
        "remote",
        "seed",
        "server",
        "vehicle",
    )

    def __init__(
        self,
        *,
        seed: int = 0,
        firmware: str | FirmwareProfile = "1.0",
        app_id: int = DEMO_APP_ID,
        key: Key | bytes | str = DEMO_KEY,
        level: int = 2,
        cold: bool = False,
        activated: bool = False,
        settings: AircraftSettings | None = None,
        assistant: AssistantSettings | None = None,
        faults: LineFaults = NO_FAULTS,
        paced: bool = False,
        server: ActivationServer | None = None,
        serial_number: str | None = None,
    ) -> None:
        self.seed = seed
        random = Random(seed)
        self.server = server or ActivationServer()
        self.server.register(app_id, key, level=level)
        self.credentials = Credentials(app_id, key, level=level)
        self.remote = PilotRemote()
        self.app = MobileApp(is_connected=not cold, has_internet=not cold)
        settings = settings or AircraftSettings()
        if assistant is None:
            assistant = AssistantSettings(api_control_enabled=not cold)
        if not cold:
            self.remote.set_mode(RcMode.F)
        self.vehicle = Vehicle(
            random,
            profile(firmware),
            settings=settings,
            assistant=assistant,
            remote=self.remote,
            app=self.app,
            server=self.server,
            serial_number=serial_number,
        )
        self.autopilot = Autopilot(self.vehicle)
        if cold:
            self.vehicle.search_gps(settings.gps_seconds)
        if activated:
            self.activate()
        # The line has a generator of its own, so that faults do not change the weather.
        self.line = Line(
            Random(random.getrandbits(64)),
            faults,
            baud_rate=assistant.baud_rate if paced else None,
        )

    def activate(self) -> None:
        """Activate it for its app at once, as an earlier program would have.

        Raises:
            ValueError: The server would not allow the app, or it asks for another level.
        """
        self.vehicle.activation.allow(self.credentials.app_id)
        request = Activate.from_credentials(self.credentials, self.autopilot.profile)
        code = self.autopilot.activate(request)
        if code != ActivationCode.SUCCESS:
            raise ValueError(f"app {self.credentials.app_id} cannot be activated: {code.meaning}")

    # --- the pilot --------------------------------------------------------------------------

    def set_rc_mode(self, mode: RcMode | str) -> None:
        """Turn the mode switch to P, A or F."""
        self.remote.set_mode(mode)
        self.vehicle.refresh()

    def leave_f(self) -> None:
        """The pilot takes over: mode switch to P."""
        self.set_rc_mode(RcMode.P)

    def return_to_f(self) -> None:
        """The pilot gives the aircraft back: mode switch to F."""
        self.set_rc_mode(RcMode.F)

    def move_stick(
        self,
        *,
        roll: float | None = None,
        pitch: float | None = None,
        yaw: float | None = None,
        throttle: float | None = None,
    ) -> None:
        """Deflect sticks, -1 to 1; see :meth:`PilotRemote.move_stick`."""
        self.remote.move_stick(roll=roll, pitch=pitch, yaw=yaw, throttle=throttle)

    def release_sticks(self) -> None:
        """Let all sticks go."""
        self.remote.release_sticks()

    def rc_lost(self) -> None:
        """Switch the remote control off; three seconds later the aircraft goes home."""
        self.remote.is_switched_on = False
        self.vehicle.refresh()

    def rc_back(self) -> None:
        """Switch the remote control on again."""
        self.remote.is_switched_on = True
        self.vehicle.refresh()

    def pilot_takes_off(self) -> None:
        """The pilot takes off by hand (automatic take-off of the app)."""
        self.vehicle.flight.take_off()

    def pilot_lands(self) -> None:
        """The pilot lands."""
        self.vehicle.flight.land()

    # --- the app ----------------------------------------------------------------------------

    def connect_app(self, *, internet: bool = True) -> None:
        """Plug the phone in, with or without Internet."""
        self.app.connect(internet=internet)
        self.vehicle.refresh()

    def disconnect_app(self) -> None:
        """Unplug the phone."""
        self.app.disconnect()
        self.vehicle.refresh()

    def app_takes_control(self) -> bool:
        """The app asks for control, and gets it unless it is unplugged or the API kept out."""
        if not self.app.is_connected or self.vehicle.authority.obstacle() is not None:
            return False
        self.app.wants_control = True
        self.vehicle.refresh()
        return True

    def app_releases_control(self) -> None:
        """The app gives control back."""
        self.app.wants_control = False
        self.vehicle.refresh()

    def send_from_mobile(self, data: bytes) -> None:
        """The app sends data to the onboard device."""
        self.autopilot.queue_from_mobile(data)

    def server_refuses(self, refuses: bool = True) -> None:
        """Let the server refuse every new activation, or stop refusing."""
        self.server.is_refusing = refuses

    def change_key(self, key: Key | bytes | str) -> None:
        """The key at the server changes; a program with the old one is not understood any more.

        The aircraft takes the new key when it is activated the next time.
        """
        old = self.server.apps[self.credentials.app_id]
        self.server.register(old.app_id, key, level=old.level, device_limit=old.device_limit)
        self.vehicle.activation.known.pop(old.app_id, None)

    # --- the assistant ----------------------------------------------------------------------

    def enable_api(self, enabled: bool = True) -> None:
        """Tick or untick *enable API control*."""
        self._configure(api_control_enabled=enabled)

    def set_ioc(self, on: bool = True) -> None:
        """Switch intelligent orientation control on or off."""
        self._configure(ioc_on=on)

    def set_rates(self, **rates_hz: int) -> None:
        """Set telemetry rates by item name: 0, 1, 10, 50 or 100 Hz."""
        self._configure(rates_hz=self.vehicle.assistant.rates_hz | rates_hz)

    def set_acceleration(self, mode: str) -> None:
        """Send acceleration ``raw`` or ``fused``."""
        self._configure(acceleration=mode)

    def _configure(self, **changes: Any) -> None:
        self.autopilot.configure(replace(self.vehicle.assistant, **changes))

    # --- nature and decay -------------------------------------------------------------------

    @property
    def gps_health(self) -> int:
        """GPS health, 0 to 5; below 3, velocity and position setpoints are ignored."""
        return self.vehicle.flight.gps_health

    @gps_health.setter
    def gps_health(self, health: int) -> None:
        self.vehicle.set_gps_health(health)

    @property
    def battery_percent(self) -> float:
        """Charge of the battery, 0 to 100."""
        return self.vehicle.flight.battery_percent

    @battery_percent.setter
    def battery_percent(self, percent: float) -> None:
        if not 0.0 <= percent <= 100.0:
            raise ValueError(f"charge is 0 to 100 percent, not {percent}")
        self.vehicle.flight.battery_percent = percent

    def set_wind(self, north: float, east: float) -> None:
        """Velocity of the air in m/s; gusts come on top of it."""
        settings = self.vehicle.settings
        self.vehicle.settings = replace(settings, wind_north=north, wind_east=east)

    def reboot(self) -> None:
        """Restart the autopilot, in the air too."""
        self.autopilot.reboot()

    def set_faults(
        self, faults: LineFaults = NO_FAULTS, *, to_aircraft: LineFaults | None = None
    ) -> None:
        """Change the faults of the line; without arguments there are none."""
        self.line.set_faults(faults, to_aircraft=to_aircraft)

    def stall_line(self, stalled: bool = True) -> None:
        """Stop the line both ways, or let it go on."""
        self.line.stall(to_host=stalled, to_aircraft=stalled)

    def unplug(self) -> None:
        """Pull the plug: the peer's port goes away."""
        self.line.unplug()

    def replug(self) -> None:
        """Put the plug back: the port can be opened again."""
        self.line.replug()

    # --- views ------------------------------------------------------------------------------

    @property
    def height(self) -> float:
        """Metres above the ground."""
        return self.vehicle.flight.dynamics.height

    @property
    def position(self) -> tuple[float, float]:
        """Metres north and east of where it was switched on."""
        motion = self.vehicle.flight.dynamics
        return motion.north, motion.east

    def __repr__(self) -> str:
        vehicle = self.vehicle
        return (
            f"<VirtualAircraft firmware={vehicle.profile} seed={self.seed} "
            f"{vehicle.flight.phase.name} height={self.height:.1f} "
            f"control={vehicle.authority.device.name}>"
        )
