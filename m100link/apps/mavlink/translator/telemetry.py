"""The telemetry of the aircraft: one function for each message, and how often each is sent.

A value that nobody knows is the definition's "unknown", and where there is none the message is not
sent. Nothing here makes a number up.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from m100link.apps.agent.background import TokenBucket, ignore
from m100link.apps.agent.orders import FlyAround, FlyTo
from m100link.apps.mavlink.translator import codec
from m100link.apps.mavlink.translator.numbers import (
    Estimator,
    LandedState,
    MavFrame,
    Sensor,
    Severity,
)
from m100link.apps.mavlink.translator.payload import CAMERA_MESSAGES, GIMBAL_MESSAGES, Made
from m100link.apps.mavlink.translator.vehicle_state import CAMERA, LOWEST_BATTERY, VehicleState
from m100link.protocol import records
from m100link.telemetry.integrity import GOOD_GPS

Fields = dict[str, Any]

_U16, _U8, _U32 = 0xFFFF, 0xFF, 0xFFFFFFFF
_LANDED = {
    records.FlightPhase.STANDBY: LandedState.ON_GROUND,
    records.FlightPhase.TAKING_OFF: LandedState.TAKEOFF,
    records.FlightPhase.IN_AIR: LandedState.IN_AIR,
    records.FlightPhase.LANDING: LandedState.LANDING,
    records.FlightPhase.FINISHING_LANDING: LandedState.LANDING,
}


def _ms(now: float) -> int:
    return int(now * 1000) & _U32


def _cm(value: float) -> int:
    return max(-0x7FFF, min(0x7FFF, round(value * 100)))


def _sys_status(world: VehicleState, now: float) -> Fields:
    view = world.known.view
    place, present, health = view.place, 0, 0
    for record, bit in (
        (records.AngularVelocity, Sensor.GYRO),
        (records.Acceleration, Sensor.ACCELEROMETER),
        (records.Magnetometer, Sensor.MAGNETOMETER),
        (records.Position, Sensor.GPS),
        (records.RemoteControl, Sensor.RC),
    ):
        if view.age(record) is not None:
            present |= bit
        is_true = bit is not Sensor.GPS or (place and view.integrity.is_plausible)
        if view.get(record) is not None and is_true:
            health |= bit
    is_fenced = world.is_fenced()
    present |= 0 if is_fenced is None else Sensor.GEOFENCE
    health |= 0 if is_fenced is False else Sensor.GEOFENCE  # without it MAVProxy says "breach"
    battery = view.get(records.Battery)
    percent = battery.percent if battery is not None else -1
    remote = view.get(records.RemoteControl)
    if place and remote is not None and remote.is_in_f and percent >= LOWEST_BATTERY:
        health |= Sensor.PREARM
    present |= Sensor.PREARM
    return {
        "onboard_control_sensors_present": present,
        "onboard_control_sensors_enabled": present,
        "onboard_control_sensors_health": health,
        "voltage_battery": _U16,
        "current_battery": -1,
        "battery_remaining": percent,
        "drop_rate_comm": 0,
        "errors_comm": min(_U16, view.state.discards),
    }


def _extended(world: VehicleState, now: float) -> Fields:
    phase = world.known.view.phase
    landed = LandedState.UNDEFINED if phase is None else _LANDED[phase]
    return {"vtol_state": 0, "landed_state": landed}


def _attitude(world: VehicleState, now: float) -> Fields | None:
    view = world.known.view
    attitude, rates = view.get(records.Attitude), view.get(records.AngularVelocity)
    if attitude is None:
        return None
    return {
        "time_boot_ms": _ms(now),
        "roll": math.radians(attitude.roll_deg),
        "pitch": math.radians(attitude.pitch_deg),
        "yaw": math.radians(attitude.yaw_deg),
    } | _rates(rates)


def _rates(rates: records.AngularVelocity | None) -> Fields:
    given = rates or (math.nan,) * 3
    return dict(zip(("rollspeed", "pitchspeed", "yawspeed"), given, strict=True))


def _quaternion(world: VehicleState, now: float) -> Fields | None:
    view = world.known.view
    attitude, rates = view.get(records.Attitude), view.get(records.AngularVelocity)
    if attitude is None:
        return None
    parts = zip(("q1", "q2", "q3", "q4"), attitude, strict=True)
    return {"time_boot_ms": _ms(now)} | dict(parts) | _rates(rates)


def _global(world: VehicleState, now: float) -> Fields | None:
    view = world.known.view
    position, velocity, yaw = view.place, view.get(records.Velocity), world.yaw_deg
    if position is None or velocity is None or (world.home is None and view.is_on_ground):
        return None
    return {
        "time_boot_ms": _ms(now),
        "lat": round(position.latitude_deg * 1e7),
        "lon": round(position.longitude_deg * 1e7),
        "alt": round(position.altitude_m * 1000),
        "relative_alt": round((world.height or 0.0) * 1000),
        "vx": _cm(velocity.north_m_s),
        "vy": _cm(velocity.east_m_s),
        "vz": _cm(-velocity.up_m_s),
        "hdg": _U16 if yaw is None else round((yaw % 360.0) * 100) % 36000,
    }


def _local(world: VehicleState, now: float) -> Fields | None:
    place, velocity = world.local, world.known.view.get(records.Velocity)
    if place is None or velocity is None:
        return None
    north, east, up = place
    return {
        "time_boot_ms": _ms(now),
        **{"x": north, "y": east, "z": -up},
        **{"vx": velocity.north_m_s, "vy": velocity.east_m_s, "vz": -velocity.up_m_s},
    }


def _home(world: VehicleState, now: float) -> Fields | None:
    home = world.home
    if home is None:
        return None
    return {
        "latitude": round(home.frame.latitude_deg * 1e7),
        "longitude": round(home.frame.longitude_deg * 1e7),
        "altitude": round(home.altitude_m * 1000),
        "q": (math.nan,) * 4,
        **dict.fromkeys(("approach_x", "approach_y", "approach_z"), math.nan),
        "time_usec": int(now * 1e6),
    }


def _gps(world: VehicleState, now: float) -> Fields | None:
    view = world.known.view
    position, velocity = view.get(records.Position), view.get(records.Velocity)
    if position is None or position.gps_health is None:
        return None
    health = position.gps_health
    fields: Fields = {
        "time_usec": int(now * 1e6),
        "fix_type": 3 if health >= GOOD_GPS else 2 if health else 0,
        "eph": _U16,
        "epv": _U16,
        "vel": _U16,
        "cog": _U16,
        "satellites_visible": _U8,
        "lat": round(position.latitude_deg * 1e7),
        "lon": round(position.longitude_deg * 1e7),
        "alt": round(position.altitude_m * 1000),
    }
    if velocity is not None:
        fields["vel"] = min(_U16 - 1, round(velocity.ground_speed_m_s * 100))
    return fields


def _battery(world: VehicleState, now: float) -> Fields | None:
    battery = world.known.view.get(records.Battery)
    if battery is None:
        return None
    return {
        "temperature": 0x7FFF,
        "voltages": (_U16,) * 10,
        "current_battery": -1,
        "current_consumed": -1,
        "energy_consumed": -1,
        "battery_remaining": battery.percent,
        "voltages_ext": (0,) * 4,
    }


def _rc(world: VehicleState, now: float) -> Fields | None:
    remote = world.known.view.get(records.RemoteControl)
    if remote is None:
        return None
    given = (remote.roll, remote.pitch, remote.throttle, remote.yaw, remote.mode, remote.gear)
    known = [one for one in given if one is not None]
    channels = {f"chan{place}_raw": _U16 for place in range(1, 19)}
    for place, value in enumerate(known, 1):
        channels[f"chan{place}_raw"] = round(1500 + max(-10000, min(10000, value)) / 20)
    return {"time_boot_ms": _ms(now), "chancount": len(known), "rssi": _U8, **channels}


def _vfr(world: VehicleState, now: float) -> Fields | None:
    view = world.known.view
    position, velocity, yaw = view.place, view.get(records.Velocity), world.yaw_deg
    if position is None or velocity is None or yaw is None:
        return None
    return {
        "airspeed": math.nan,
        "groundspeed": velocity.ground_speed_m_s,
        "alt": position.altitude_m,
        "climb": velocity.up_m_s,
        "heading": round(yaw % 360.0) % 360,
        "throttle": _U16,  # nobody tells it
    }


def _altitude(world: VehicleState, now: float) -> Fields | None:
    position, height = world.known.view.get(records.Position), world.height
    if position is None or height is None:
        return None
    return {
        "time_usec": int(now * 1e6),
        "altitude_monotonic": math.nan,
        "altitude_amsl": position.altitude_m,
        "altitude_local": height,
        "altitude_relative": height,
        "altitude_terrain": math.nan,
        "bottom_clearance": math.nan,
    }


def _estimator(world: VehicleState, now: float) -> Fields | None:
    view = world.known.view
    integrity, velocity = view.integrity, view.get(records.Velocity)
    flags = Estimator.ATTITUDE if view.get(records.Attitude) is not None else Estimator(0)
    if not integrity.is_plausible:
        flags |= Estimator.GPS_GLITCH
    elif integrity.is_timely:
        if view.place is not None:
            flags |= Estimator.POS_HORIZ_ABS | Estimator.POS_VERT_ABS
        if velocity is not None:
            flags |= Estimator.VELOCITY_HORIZ | Estimator.VELOCITY_VERT
    unknown = ("vel_ratio", "mag_ratio", "hagl_ratio", "tas_ratio")
    return {
        "time_usec": int(now * 1e6),
        **dict.fromkeys((*unknown, "pos_horiz_accuracy", "pos_vert_accuracy"), math.nan),
        "pos_horiz_ratio": integrity.test_ratio,
        "pos_vert_ratio": integrity.height_test_ratio,
        "flags": int(flags),
    }


def _imu(world: VehicleState, now: float) -> Fields | None:
    view = world.known.view
    rates, attitude = view.get(records.AngularVelocity), view.get(records.Attitude)
    acceleration = view.get(records.Acceleration)
    if rates is None:
        return None
    names = ("zacc", "yacc", "xacc", "xmag", "ymag", "zmag", "abs_pressure", "diff_pressure")
    fields: Fields = dict.fromkeys((*names, "pressure_alt", "temperature"), math.nan)
    fields |= {"time_usec": int(now * 1e6), "fields_updated": 0b111_000}
    fields |= dict(zip(("xgyro", "ygyro", "zgyro"), rates, strict=True))
    if acceleration is not None and attitude is not None:
        fields |= dict(zip(("xacc", "yacc", "zacc"), _felt(acceleration, attitude), strict=True))
        fields["fields_updated"] |= 0b111
    return fields


def _felt(
    acceleration: records.Acceleration, attitude: records.Attitude
) -> tuple[float, float, float]:
    """The reading of an accelerometer in the body: without gravity nobody takes it for one."""
    north, east, down = acceleration.ned
    return records.in_body(attitude.xyzw, (north, east, down - 9.80665))


_PLACE_ONLY, _AND_YAW = 0b1101_1111_1000, 0b1001_1111_1000  # type_mask: what is not to be read


def _target(world: VehicleState, now: float) -> Fields | None:
    leg, ground = world.target(), world.ground_altitude
    if not isinstance(leg, FlyTo) or ground is None:
        return None
    return {
        "time_boot_ms": _ms(now),
        "coordinate_frame": MavFrame.GLOBAL_INT,
        "type_mask": _PLACE_ONLY if leg.yaw_deg is None else _AND_YAW,
        "lat_int": round(leg.latitude_deg * 1e7),
        "lon_int": round(leg.longitude_deg * 1e7),
        "alt": ground + leg.height,
        "yaw": math.radians(leg.yaw_deg or 0.0),
    }


def _orbit(world: VehicleState, now: float) -> Fields | None:
    leg, ground = world.target(), world.ground_altitude
    if not isinstance(leg, FlyAround) or ground is None:
        return None
    return {
        "time_usec": int(now * 1e6),
        "radius": leg.radius if leg.clockwise else -leg.radius,
        "frame": MavFrame.GLOBAL,
        "x": round(leg.latitude_deg * 1e7),
        "y": round(leg.longitude_deg * 1e7),
        "z": ground + leg.height,
    }


def _if_there(made: Made) -> Made:
    """The message with its time, of an aircraft that has camera and gimbal."""

    def fields(world: VehicleState, now: float) -> Fields | None:
        found = made(world, now) if world.has_payload else None
        return None if found is None else {"time_boot_ms": _ms(now)} | found

    return fields


@dataclass(frozen=True, slots=True)
class Stream:
    hz: float  # how often it is sent; 0 until somebody asks
    group: int  # MAV_DATA_STREAM of REQUEST_DATA_STREAM
    # Makes it; None where what it says is not known.
    fields: Callable[[VehicleState, float], Fields | None]
    source: str  # what it is made of, for the manual
    component: int = 1  # that sends it

    @property
    def is_of_payload(self) -> bool:
        return self.group == _PAYLOAD


_PAYLOAD = -1  # of no group
_SENSORS, _STATUS, _STICKS, _PLACE, _EXTRA1, _EXTRA2, _EXTRA3 = 1, 2, 3, 6, 10, 11, 12

STREAMS: Mapping[str, Stream] = {
    "SYS_STATUS": Stream(2, _STATUS, _sys_status, "arriving items, GPS health, battery, fence"),
    "EXTENDED_SYS_STATE": Stream(2, _STATUS, _extended, "flight status"),
    "GLOBAL_POSITION_INT": Stream(20, _PLACE, _global, "position, velocity, heading"),
    "LOCAL_POSITION_NED": Stream(20, _PLACE, _local, "the same, from home"),
    "ATTITUDE": Stream(20, _EXTRA1, _attitude, "attitude, angular velocity"),
    "ATTITUDE_QUATERNION": Stream(20, _EXTRA1, _quaternion, "attitude, angular velocity"),
    "HOME_POSITION": Stream(1, _PLACE, _home, "where it last stood with GPS health 3"),
    "GPS_RAW_INT": Stream(5, _SENSORS, _gps, "GPS health; no satellites, no accuracy"),
    "BATTERY_STATUS": Stream(1, _STATUS, _battery, "percent; no voltage, no current"),
    "ESTIMATOR_STATUS": Stream(1, _STATUS, _estimator, "whether the position can be true"),
    "RC_CHANNELS": Stream(5, _STICKS, _rc, "sticks, mode switch, gear"),
    "POSITION_TARGET_GLOBAL_INT": Stream(
        1, _PLACE, _target, "during a flight to a place: the place"
    ),
    "ORBIT_EXECUTION_STATUS": Stream(
        1, _PLACE, _orbit, "during a flight around a place: the circle"
    ),
    "VFR_HUD": Stream(4, _EXTRA2, _vfr, "velocity, altitude; no airspeed"),
    "ALTITUDE": Stream(0, _EXTRA3, _altitude, "barometric altitude, height"),
    "HIGHRES_IMU": Stream(0, _SENSORS, _imu, "angular velocity, acceleration"),
    "SYSTEM_TIME": Stream(
        0, _EXTRA3, lambda _, now: {"time_boot_ms": _ms(now)}, "time of the bridge"
    ),
    **{
        name: Stream(hz, _PAYLOAD, _if_there(made), source, component)
        for component, table in ((CAMERA, CAMERA_MESSAGES), (1, GIMBAL_MESSAGES))
        for name, (hz, made, source) in table.items()
    },
}
"""By the name of the message."""


NUMBERS = {
    codec.LAYOUTS[name].number: name for name in STREAMS
}  # names by the number of the message


# -- who is sent which message of telemetry, and how often: each peer what it asked for ------------
# Rates belong to the peer that asked. Peers behind one address share a path: each message goes
# there at the highest rate that any of them asked for. A message for many peers is made once.


MOST_HZ = 50.0  # how often a message is sent at most; who asks for more gets this

_MOST_ASKED = 2 * codec.MOST_PEERS  # peers whose rates are known; a silent one may come back
_ALL = 0  # the group of REQUEST_DATA_STREAM that has all others
_USUAL = {name: stream.hz for name, stream in STREAMS.items()}

Audience = Mapping[codec.Address, tuple[codec.Peer, ...]]
"""Where telemetry goes, and which peers are there; none are where nobody was heard yet."""


class Rates:
    def __init__(self, world: VehicleState) -> None:
        self._world = world
        self._asked: dict[codec.Peer, dict[str, float]] = {}
        # The rates of each address: made anew, once a step, when rates or addresses changed.
        self.audience: Audience | None = None
        self.due_at = 0.0  # when something is due for that audience
        self._present: set[codec.Peer] = set()
        self._tables: dict[codec.Address, dict[str, float]] = {}
        self.is_often = False  # whether anything is sent more often than usual telemetry ever is
        self._due: dict[codec.Address, dict[str, float]] = {}

    def hz(self, name: str, peer: codec.Peer) -> float:
        return self._asked.get(peer, {}).get(name, _USUAL[name])

    def set_hz(self, name: str, hz: float | None, peer: codec.Peer) -> None:
        """Send it to a peer so often; None as often as to everybody."""
        asked = self._asked.pop(peer, {})
        asked.pop(name, None)
        if hz is not None:
            asked[name] = min(MOST_HZ, max(0.0, hz))
        self._asked[peer] = asked  # the newest is the last that is forgotten
        if len(self._asked) > _MOST_ASKED:
            del self._asked[next(one for one in self._asked if one not in self._present)]
        self._due.get(peer.address, {}).pop(name, None)  # at once, then at its rate
        self.audience = None

    def set_group(self, group: int, hz: float, peer: codec.Peer) -> None:
        """Send the messages of a group of REQUEST_DATA_STREAM so often."""
        for name, stream in STREAMS.items():
            if group in (_ALL, stream.group) and not stream.is_of_payload:
                self.set_hz(name, hz, peer)

    def _arrange(self, audience: Audience, now: float) -> None:
        self.audience = audience
        self._present = {peer for peers in audience.values() for peer in peers}
        self._tables = {
            address: {
                name: max((self.hz(name, peer) for peer in peers), default=usual)
                for name, usual in _USUAL.items()
            }
            for address, peers in audience.items()
        }
        fastest = max((hz for table in self._tables.values() for hz in table.values()), default=0.0)
        self.is_often = fastest > max(_USUAL.values())
        # Nobody waits for the end of an interval that somebody wanted who has gone.
        self._due = {
            address: {
                name: min(at, now + 1 / table[name])
                for name, at in self._due.get(address, {}).items()
                if table[name] > 0.0
            }
            for address, table in self._tables.items()
        }

    def message(self, name: str, now: float) -> codec.MavlinkMessage | None:
        stream = STREAMS[name]
        fields = stream.fields(self._world, now)
        if fields is None:
            return None
        return codec.MavlinkMessage(name, fields, component=stream.component)

    def due(
        self, now: float, audience: Audience
    ) -> Iterator[tuple[codec.MavlinkMessage, tuple[codec.Address, ...]]]:
        if audience != self.audience:
            self._arrange(audience, now)
        wanted: dict[str, list[codec.Address]] = {}
        for address, table in self._tables.items():
            due = self._due[address]
            for name, hz in table.items():
                if hz <= 0.0 or now < due.get(name, now):
                    continue
                # From when it was due, so that the rate holds; not from long ago.
                due[name] = max(due.get(name, now) + 1 / hz, now)
                wanted.setdefault(name, []).append(address)
        times = (at for due in self._due.values() for at in due.values())
        self.due_at = min(times, default=math.inf)
        for name, addresses in wanted.items():
            message = self.message(name, now)
            if message is not None:
                yield message, tuple(addresses)


# -- texts for people: why something was refused, and what happened by itself ----------------------


_SIZE = 50
_MOST_PARTS = 4
_PER_S, _AT_ONCE = 10.0, 20.0
_AGAIN_S = 2.0

_SEVERITIES = {"info": Severity.INFO, "warning": Severity.WARNING, "error": Severity.ERROR}


def severity_of(level: str) -> Severity:
    return _SEVERITIES.get(level, Severity.INFO)


class Texts:
    """Texts on their way out: few at once, and none twice in two seconds.

    ``log``: takes those of the bridge itself; the agent has logged those of its own.
    """

    def __init__(self, log: Callable[[str], None] = ignore) -> None:
        self._log = log
        self.waiting: deque[tuple[Severity, str]] = deque(maxlen=int(_AT_ONCE))
        self._logged: deque[str] = deque(maxlen=int(_AT_ONCE))  # by the agent itself
        self._reported: dict[str, float] = {}
        self._count = 0
        self._allowed = TokenBucket(_PER_S, _AT_ONCE)

    def tell(self, severity: Severity, text: str, *, is_own: bool = True) -> None:
        self.waiting.append((severity, text))
        if not is_own:
            self._logged.append(text)

    def due(self, now: float) -> Iterator[codec.MavlinkMessage]:
        """The messages; a long text comes in parts of 50 characters, four at most."""
        self._reported = {text: at for text, at in self._reported.items() if now - at < _AGAIN_S}
        while self.waiting:
            severity, text = one = self.waiting.popleft()
            if text in self._reported:
                continue
            if not self._allowed.take(now):
                self.waiting.appendleft(one)
                return
            self._reported[text] = now
            if text not in self._logged:
                self._log(text)
            yield from self._parts(severity, text)

    def _parts(self, severity: Severity, text: str) -> Iterator[codec.MavlinkMessage]:
        plain = " ".join(text.encode("ascii", "replace").decode().split())
        if len(plain) <= _SIZE:
            yield codec.MavlinkMessage("STATUSTEXT", {"severity": severity, "text": plain})
            return
        self._count = self._count % 0xFFFF + 1  # 0 is a text in one part
        for number in range(_MOST_PARTS):
            part = plain[number * _SIZE : (number + 1) * _SIZE]
            fields = {"severity": severity, "text": part, "id": self._count, "chunk_seq": number}
            yield codec.MavlinkMessage("STATUSTEXT", fields)
            if len(part) < _SIZE:
                return  # a part that is not full is the last one
