"""Messages of MAVLink 2 that the bridge speaks: a row each, as the public definitions have them.

``number NAME: fields``, in the order of the wire; what stands behind ``|`` are extensions, which
older programs leave out. The extra byte of the checksum follows from names and types
(``m100link.apps.mavlink.translator.codec``), so a field that is wrong here is a message that nobody
understands.
"""

from __future__ import annotations

import hashlib
import hmac
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from struct import Struct
from typing import Any, NamedTuple

import crcmod

from m100link.apps.mavlink.translator.numbers import MavCommand

DEFINITIONS = """
0 HEARTBEAT: u32 custom_mode, u8 type, u8 autopilot, u8 base_mode, u8 system_status, u8
    mavlink_version
1 SYS_STATUS: u32 onboard_control_sensors_present, u32 onboard_control_sensors_enabled, u32
    onboard_control_sensors_health, u16 load, u16 voltage_battery, i16 current_battery, u16
    drop_rate_comm, u16 errors_comm, u16 errors_count1, u16 errors_count2, u16 errors_count3,
    u16 errors_count4, i8 battery_remaining | u32 onboard_control_sensors_present_extended, u32
    onboard_control_sensors_enabled_extended, u32 onboard_control_sensors_health_extended
2 SYSTEM_TIME: u64 time_unix_usec, u32 time_boot_ms
4 PING: u64 time_usec, u32 seq, u8 target_system, u8 target_component
11 SET_MODE: u32 custom_mode, u8 target_system, u8 base_mode
20 PARAM_REQUEST_READ: i16 param_index, u8 target_system, u8 target_component, char[16] param_id
21 PARAM_REQUEST_LIST: u8 target_system, u8 target_component
22 PARAM_VALUE: f32 param_value, u16 param_count, u16 param_index, char[16] param_id, u8
    param_type
23 PARAM_SET: f32 param_value, u8 target_system, u8 target_component, char[16] param_id, u8
    param_type
24 GPS_RAW_INT: u64 time_usec, i32 lat, i32 lon, i32 alt, u16 eph, u16 epv, u16 vel, u16 cog, u8
    fix_type, u8 satellites_visible | i32 alt_ellipsoid, u32 h_acc, u32 v_acc, u32 vel_acc, u32
    hdg_acc, u16 yaw
30 ATTITUDE: u32 time_boot_ms, f32 roll, f32 pitch, f32 yaw, f32 rollspeed, f32 pitchspeed, f32
    yawspeed
31 ATTITUDE_QUATERNION: u32 time_boot_ms, f32 q1, f32 q2, f32 q3, f32 q4, f32 rollspeed, f32
    pitchspeed, f32 yawspeed | f32[4] repr_offset_q
32 LOCAL_POSITION_NED: u32 time_boot_ms, f32 x, f32 y, f32 z, f32 vx, f32 vy, f32 vz
33 GLOBAL_POSITION_INT: u32 time_boot_ms, i32 lat, i32 lon, i32 alt, i32 relative_alt, i16 vx,
    i16 vy, i16 vz, u16 hdg
40 MISSION_REQUEST: u16 seq, u8 target_system, u8 target_component | u8 mission_type
41 MISSION_SET_CURRENT: u16 seq, u8 target_system, u8 target_component
42 MISSION_CURRENT: u16 seq | u16 total, u8 mission_state, u8 mission_mode
43 MISSION_REQUEST_LIST: u8 target_system, u8 target_component | u8 mission_type
44 MISSION_COUNT: u16 count, u8 target_system, u8 target_component | u8 mission_type
45 MISSION_CLEAR_ALL: u8 target_system, u8 target_component | u8 mission_type
46 MISSION_ITEM_REACHED: u16 seq
47 MISSION_ACK: u8 target_system, u8 target_component, u8 type | u8 mission_type
51 MISSION_REQUEST_INT: u16 seq, u8 target_system, u8 target_component | u8 mission_type
65 RC_CHANNELS: u32 time_boot_ms, u16 chan1_raw, u16 chan2_raw, u16 chan3_raw, u16 chan4_raw,
    u16 chan5_raw, u16 chan6_raw, u16 chan7_raw, u16 chan8_raw, u16 chan9_raw, u16 chan10_raw,
    u16 chan11_raw, u16 chan12_raw, u16 chan13_raw, u16 chan14_raw, u16 chan15_raw, u16
    chan16_raw, u16 chan17_raw, u16 chan18_raw, u8 chancount, u8 rssi
66 REQUEST_DATA_STREAM: u16 req_message_rate, u8 target_system, u8 target_component, u8
    req_stream_id, u8 start_stop
69 MANUAL_CONTROL: i16 x, i16 y, i16 z, i16 r, u16 buttons, u8 target | u16 buttons2, u8
    enabled_extensions, i16 s, i16 t, i16 aux1, i16 aux2, i16 aux3, i16 aux4, i16 aux5, i16 aux6
73 MISSION_ITEM_INT: f32 param1, f32 param2, f32 param3, f32 param4, i32 x, i32 y, f32 z, u16
    seq, u16 command, u8 target_system, u8 target_component, u8 frame, u8 current, u8
    autocontinue | u8 mission_type
74 VFR_HUD: f32 airspeed, f32 groundspeed, f32 alt, f32 climb, i16 heading, u16 throttle
75 COMMAND_INT: f32 param1, f32 param2, f32 param3, f32 param4, i32 x, i32 y, f32 z, u16
    command, u8 target_system, u8 target_component, u8 frame, u8 current, u8 autocontinue
76 COMMAND_LONG: f32 param1, f32 param2, f32 param3, f32 param4, f32 param5, f32 param6, f32
    param7, u16 command, u8 target_system, u8 target_component, u8 confirmation
77 COMMAND_ACK: u16 command, u8 result | u8 progress, i32 result_param2, u8 target_system, u8
    target_component
82 SET_ATTITUDE_TARGET: u32 time_boot_ms, f32[4] q, f32 body_roll_rate, f32 body_pitch_rate, f32
    body_yaw_rate, f32 thrust, u8 target_system, u8 target_component, u8 type_mask
84 SET_POSITION_TARGET_LOCAL_NED: u32 time_boot_ms, f32 x, f32 y, f32 z, f32 vx, f32 vy, f32 vz,
    f32 afx, f32 afy, f32 afz, f32 yaw, f32 yaw_rate, u16 type_mask, u8 target_system, u8
    target_component, u8 coordinate_frame
86 SET_POSITION_TARGET_GLOBAL_INT: u32 time_boot_ms, i32 lat_int, i32 lon_int, f32 alt, f32 vx,
    f32 vy, f32 vz, f32 afx, f32 afy, f32 afz, f32 yaw, f32 yaw_rate, u16 type_mask, u8
    target_system, u8 target_component, u8 coordinate_frame
87 POSITION_TARGET_GLOBAL_INT: u32 time_boot_ms, i32 lat_int, i32 lon_int, f32 alt, f32 vx, f32 vy,
    f32 vz, f32 afx, f32 afy, f32 afz, f32 yaw, f32 yaw_rate, u16 type_mask, u8 coordinate_frame
105 HIGHRES_IMU: u64 time_usec, f32 xacc, f32 yacc, f32 zacc, f32 xgyro, f32 ygyro, f32 zgyro,
    f32 xmag, f32 ymag, f32 zmag, f32 abs_pressure, f32 diff_pressure, f32 pressure_alt, f32
    temperature, u16 fields_updated | u8 id
110 FILE_TRANSFER_PROTOCOL: u8 target_network, u8 target_system, u8 target_component, u8[251]
    payload
111 TIMESYNC: i64 tc1, i64 ts1
117 LOG_REQUEST_LIST: u16 start, u16 end, u8 target_system, u8 target_component
118 LOG_ENTRY: u32 time_utc, u32 size, u16 id, u16 num_logs, u16 last_log_num
119 LOG_REQUEST_DATA: u32 ofs, u32 count, u16 id, u8 target_system, u8 target_component
120 LOG_DATA: u32 ofs, u16 id, u8 count, u8[90] data
121 LOG_ERASE: u8 target_system, u8 target_component
122 LOG_REQUEST_END: u8 target_system, u8 target_component
141 ALTITUDE: u64 time_usec, f32 altitude_monotonic, f32 altitude_amsl, f32 altitude_local, f32
    altitude_relative, f32 altitude_terrain, f32 bottom_clearance
147 BATTERY_STATUS: i32 current_consumed, i32 energy_consumed, i16 temperature, u16[10]
    voltages, i16 current_battery, u8 id, u8 battery_function, u8 type, i8 battery_remaining |
    i32 time_remaining, u8 charge_state, u16[4] voltages_ext, u8 mode, u32 fault_bitmask
148 AUTOPILOT_VERSION: u64 capabilities, u64 uid, u32 flight_sw_version, u32
    middleware_sw_version, u32 os_sw_version, u32 board_version, u16 vendor_id, u16 product_id,
    u8[8] flight_custom_version, u8[8] middleware_custom_version, u8[8] os_custom_version |
    u8[18] uid2
230 ESTIMATOR_STATUS: u64 time_usec, f32 vel_ratio, f32 pos_horiz_ratio, f32 pos_vert_ratio, f32
    mag_ratio, f32 hagl_ratio, f32 tas_ratio, f32 pos_horiz_accuracy, f32 pos_vert_accuracy, u16
    flags
242 HOME_POSITION: i32 latitude, i32 longitude, i32 altitude, f32 x, f32 y, f32 z, f32[4] q, f32
    approach_x, f32 approach_y, f32 approach_z | u64 time_usec
244 MESSAGE_INTERVAL: i32 interval_us, u16 message_id
245 EXTENDED_SYS_STATE: u8 vtol_state, u8 landed_state
253 STATUSTEXT: u8 severity, char[50] text | u16 id, u8 chunk_seq
259 CAMERA_INFORMATION: u32 time_boot_ms, u32 firmware_version, f32 focal_length, f32
    sensor_size_h, f32 sensor_size_v, u32 flags, u16 resolution_h, u16 resolution_v, u16
    cam_definition_version, u8[32] vendor_name, u8[32] model_name, u8 lens_id, char[140]
    cam_definition_uri | u8 gimbal_device_id, u8 camera_device_id
260 CAMERA_SETTINGS: u32 time_boot_ms, u8 mode_id | f32 zoomLevel, f32 focusLevel, u8
    camera_device_id
261 STORAGE_INFORMATION: u32 time_boot_ms, f32 total_capacity, f32 used_capacity, f32
    available_capacity, f32 read_speed, f32 write_speed, u8 storage_id, u8 storage_count, u8
    status | u8 type, char[32] name, u8 storage_usage
262 CAMERA_CAPTURE_STATUS: u32 time_boot_ms, f32 image_interval, u32 recording_time_ms, f32
    available_capacity, u8 image_status, u8 video_status | i32 image_count, u8 camera_device_id
280 GIMBAL_MANAGER_INFORMATION: u32 time_boot_ms, u32 cap_flags, f32 roll_min, f32 roll_max, f32
    pitch_min, f32 pitch_max, f32 yaw_min, f32 yaw_max, u8 gimbal_device_id
281 GIMBAL_MANAGER_STATUS: u32 time_boot_ms, u32 flags, u8 gimbal_device_id, u8
    primary_control_sysid, u8 primary_control_compid, u8 secondary_control_sysid, u8
    secondary_control_compid
282 GIMBAL_MANAGER_SET_ATTITUDE: u32 flags, f32[4] q, f32 angular_velocity_x, f32
    angular_velocity_y, f32 angular_velocity_z, u8 target_system, u8 target_component, u8
    gimbal_device_id
283 GIMBAL_DEVICE_INFORMATION: u64 uid, u32 time_boot_ms, u32 firmware_version, u32
    hardware_version, f32 roll_min, f32 roll_max, f32 pitch_min, f32 pitch_max, f32 yaw_min, f32
    yaw_max, u16 cap_flags, u16 custom_cap_flags, char[32] vendor_name, char[32] model_name,
    char[32] custom_name | u8 gimbal_device_id, u32 cap_flags2
285 GIMBAL_DEVICE_ATTITUDE_STATUS: u32 time_boot_ms, f32[4] q, f32 angular_velocity_x, f32
    angular_velocity_y, f32 angular_velocity_z, u32 failure_flags, u16 flags, u8 target_system,
    u8 target_component | f32 delta_yaw, f32 delta_yaw_velocity, u8 gimbal_device_id
287 GIMBAL_MANAGER_SET_PITCHYAW: u32 flags, f32 pitch, f32 yaw, f32 pitch_rate, f32 yaw_rate, u8
    target_system, u8 target_component, u8 gimbal_device_id
288 GIMBAL_MANAGER_SET_MANUAL_CONTROL: u32 flags, f32 pitch, f32 yaw, f32 pitch_rate, f32
    yaw_rate, u8 target_system, u8 target_component, u8 gimbal_device_id
345 PARAM_ERROR: i16 param_index, u8 target_system, u8 target_component, char[16] param_id, u8
    error
360 ORBIT_EXECUTION_STATUS: u64 time_usec, f32 radius, i32 x, i32 y, f32 z, u8 frame
397 COMPONENT_METADATA: u32 time_boot_ms, u32 file_crc, char[100] uri
435 AVAILABLE_MODES: u32 custom_mode, u32 properties, u8 number_modes, u8 mode_index, u8
    standard_mode, char[35] mode_name
436 CURRENT_MODE: u32 custom_mode, u32 intended_custom_mode, u8 standard_mode
"""
"""All of them; each row may go on in lines that are indented."""


# -- MAVLink 2 as bytes: a datagram into messages, a message into a frame, with signatures ---------
# A codec of our own because every datagram has to be read by itself: a reader of streams that meets
# a false start byte swallows the valid command behind it. No I/O and no clock: the time of
# signatures is an argument.


_crc = crcmod.mkCrcFun(0x11021, initCrc=0xFFFF, rev=True, xorOut=0)

_V1, _V2 = 0xFE, 0xFD
_HEADER_V1, _HEADER_V2 = Struct("<BBBBBB"), Struct("<BBBBBBBHB")
_START = re.compile(rb"[\xfd\xfe]")
_CHECKSUM = Struct("<H")
_SIGNED = 0x01
_SIGNATURE = 13
_MOST_SENDERS = 64

NEW_WITHIN = 60_000_00
"""How old a sender may be that is heard first: one minute in the unit of signatures, 10 us."""

LAST_SIGNATURE = 2**48 - 2**40
"""Time of a signature that is still taken: its field is not counted to its end by mistake."""

Sender = tuple[int, int, int]  # system, component and link of who signs

_TYPES = {
    "u8": ("uint8_t", "B"),
    "i8": ("int8_t", "b"),
    "u16": ("uint16_t", "H"),
    "i16": ("int16_t", "h"),
    "u32": ("uint32_t", "I"),
    "i32": ("int32_t", "i"),
    "u64": ("uint64_t", "Q"),
    "i64": ("int64_t", "q"),
    "f32": ("float", "f"),
    "char": ("char", "s"),
}


@dataclass(frozen=True, slots=True)
class MavlinkMessage:
    name: str  # as in the definitions
    fields: Mapping[str, Any]  # values by name; a text for characters, a tuple for other arrays
    system: int = 0  # who sent it; 0 for what is to be sent
    component: int = 0  # which part of that system

    def __getitem__(self, name: str) -> Any:
        return self.fields[name]


Address = tuple[str, int]  # host and port
MOST_PEERS = 16  # ground stations and programs at once: each costs the telemetry of every aircraft


@dataclass(frozen=True, slots=True)
class Peer:
    address: Address  # where its datagrams come from
    system: int
    component: int

    @property
    def name(self) -> str:
        return f"MAVLink {self.system} at {self.address[0]}:{self.address[1]}"

    @property
    def target(self) -> dict[str, int]:
        """The fields of a message that is for it alone."""
        return {"target_system": self.system, "target_component": self.component}


@dataclass(frozen=True, slots=True)
class _Field:
    """A field: name, whether it is text, and how many values it has (0: it is not an array)."""

    name: str
    is_text: bool
    count: int


@dataclass(frozen=True, slots=True)
class MessageLayout:
    number: int
    name: str
    # The byte that its checksum ends with: two ends with different definitions do not understand
    # each other.
    crc_extra: int
    _struct: Struct
    _fields: tuple[_Field, ...]

    @property
    def fields(self) -> tuple[str, ...]:
        """Names, in the order of the wire."""
        return tuple(one.name for one in self._fields)

    @property
    def size(self) -> int:
        return self._struct.size

    def write(self, values: Mapping[str, Any]) -> bytes:
        """The payload; what is not named is 0."""
        flat: list[Any] = []
        for one in self._fields:
            value = values.get(one.name)
            if one.is_text:
                flat.append(b"" if value is None else value.encode("ascii", "replace"))
            elif one.count:
                given = () if value is None else value
                flat += [*given, *(0,) * (one.count - len(given))]
            else:
                flat.append(0 if value is None else value)
        return self._struct.pack(*flat)

    def read(self, payload: bytes) -> dict[str, Any]:
        """The fields; zeros at the end may have been left out, and more than we know is ignored."""
        whole = payload[: self._struct.size].ljust(self._struct.size, b"\0")
        flat = iter(self._struct.unpack(whole))
        found: dict[str, Any] = {}
        for one in self._fields:
            if one.is_text:
                found[one.name] = next(flat).split(b"\0", 1)[0].decode("ascii", "replace")
            elif one.count:
                found[one.name] = tuple(next(flat) for _ in range(one.count))
            else:
                found[one.name] = next(flat)
        return found


def _layout(row: str) -> MessageLayout:
    number, name, columns = re.fullmatch(r"(\d+) (\w+): (.+)", row).groups()  # type: ignore[union-attr]  # a row of ours
    basic, _, extensions = columns.partition(" | ")
    extra, codes, fields = f"{name} ".encode(), "<", []
    for is_extension, part in ((False, basic), (True, extensions)):
        for one in filter(None, part.split(", ")):
            kind, called = one.split(" ")
            base, count = re.fullmatch(r"(\w+?)(?:\[(\d+)\])?", kind).groups()  # type: ignore[union-attr]  # likewise
            full, code = _TYPES[base]
            size = int(count or 0)
            if not is_extension:
                extra += f"{full} {called} ".encode() + (bytes([size]) if size else b"")
            codes += f"{size or ''}{code}"
            fields.append(_Field(called, base == "char", size))
    crc = _crc(extra)
    return MessageLayout(int(number), name, (crc & 0xFF) ^ (crc >> 8), Struct(codes), tuple(fields))


LAYOUTS: dict[str, MessageLayout] = {
    layout.name: layout
    for layout in map(_layout, DEFINITIONS.replace("\n    ", " ").strip().splitlines())
}
"""By name."""

_BY_NUMBER = {layout.number: layout for layout in LAYOUTS.values()}


@dataclass
class PacketSigner:
    """A secret that both ends know: who has it not is not obeyed.

    A frame is taken once: its time has to be later than that of any frame before it from the same
    sender, which is noted only when the signature is right.
    """

    key: bytes = field(repr=False)  # 32 bytes
    link: int = 0  # which of several links signs
    refused: int = 0  # frames that were not taken
    sent: int = 0  # newest time that was signed or taken; later starts begin with it
    # Newest time that was taken of each sender.
    newest: dict[Sender, int] = field(default_factory=dict)
    oldest: int = 0  # what is not later is not taken from anybody who is heard first

    def sign(self, frame: bytes, now: int) -> bytes:
        """The signature of a frame that ends with its checksum; ``now`` in 10 µs since 2015."""
        self.sent = max(self.sent + 1, now)
        stamp = bytes([self.link]) + self.sent.to_bytes(6, "little")
        return stamp + self._digest(frame + stamp)

    def takes(self, frame: bytes, sender: tuple[int, int], now: int) -> bool:
        """Whether the signature at the end is right, and the frame not an old one."""
        stamp = frame[-_SIGNATURE:-6]
        when = int.from_bytes(stamp[1:], "little")
        stream = (*sender, stamp[0])
        # A sender that is heard first may not be more than a minute behind.
        since = max(now, self.sent) - NEW_WITHIN
        newest = self.newest.get(stream, max(since, self.oldest))
        is_right = hmac.compare_digest(self._digest(frame[:-6]), frame[-6:])
        if not is_right or not newest < when <= LAST_SIGNATURE:
            return False
        if stream not in self.newest and len(self.newest) >= _MOST_SENDERS:
            # A forgotten sender counts as new: frames as old as its last one are refused.
            self.newest = {one: at for one, at in self.newest.items() if at > since}
            if len(self.newest) >= _MOST_SENDERS:
                return False
        self.newest[stream] = when
        # A peer with a later clock would refuse frames that are signed by ours.
        self.sent = max(self.sent, when)
        return True

    def _digest(self, data: bytes) -> bytes:
        return hashlib.sha256(self.key + data).digest()[:6]


def write_frame(
    message: MavlinkMessage,
    *,
    system: int,
    sequence: int,
    signer: PacketSigner | None = None,
    now: int = 0,
) -> bytes:
    """A frame of version 2 from component 1 of a system, 1 to 255; ``now`` in 10 µs since 2015."""
    layout = LAYOUTS[message.name]
    payload = layout.write(message.fields).rstrip(b"\0") or b"\0"
    number = layout.number
    header = _HEADER_V2.pack(
        *(_V2, len(payload), 0 if signer is None else _SIGNED, 0, sequence & 0xFF),
        *(system, message.component or 1, number & 0xFFFF, number >> 16),
    )
    body = header + payload
    frame = body + _CHECKSUM.pack(_crc(body[1:] + bytes([layout.crc_extra])))
    return frame if signer is None else frame + signer.sign(frame, now)


class MessageReader:
    """The valid messages of a datagram, each searched from the end of the one before.

    With a signer nothing is taken without a signature: by a HEARTBEAT alone anybody could look, or
    have all telemetry sent to a third party. ``now`` is the time of signatures, 10 µs since 2015.
    When :attr:`checked` is ``most``, the rest is left unread: a datagram can be made to look like
    many overlapping frames, each of which is checked to its end.
    """

    def __init__(
        self,
        data: bytes,
        *,
        signer: PacketSigner | None = None,
        now: int = 0,
        most: int | None = None,
    ) -> None:
        # Bytes that looked like a frame, so far, counted again where such frames overlap: what
        # reading cost. Bytes between frames are skipped and cost next to nothing.
        self.checked = 0
        self._data = data
        self._signer = signer
        self._now = now
        self._most = most

    def __iter__(self) -> Iterator[MavlinkMessage]:
        data, signer = self._data, self._signer
        start = _START.search(data)
        while start is not None:
            at = start.start()
            if data[at] == _V2:
                found = _frame_v2(data, at, signer, self._now)
            else:
                found = _frame_v1(data, at, is_signed=signer is not None)
            self.checked += found.checked
            if found.message is not None:
                yield found.message
            if self._most is not None and self.checked > self._most:
                return
            # A byte looked like a start and was none: the next one may be one.
            start = _START.search(data, found.end or at + 1)


# Where the sender, the number and the payload of a frame begin, by its first byte.
_PLACES = {_V2: (5, 7, _HEADER_V2.size), _V1: (3, 5, _HEADER_V1.size)}
# Bytes of a datagram with one command: SET_MODE of version 1, and a command with its signature.
_SHORTEST_COMMAND, LONGEST_COMMAND = 14, 64
_ENDING = frozenset(
    (
        *(MavCommand.NAV_LAND, MavCommand.NAV_RETURN_TO_LAUNCH, MavCommand.COMPONENT_ARM_DISARM),
        *(MavCommand.DO_SET_MODE, MavCommand.DO_SET_STANDARD_MODE),
        *(MavCommand.DO_PAUSE_CONTINUE, MavCommand.DO_REPOSITION),
    )
)


def ending_command(data: bytes) -> tuple[int, int, int, int] | None:
    """System, component, target and number of a command that may end a flight; None of any other.

    Nothing is read or checked: it costs less than a microsecond, in a flood as well.
    """
    if not _SHORTEST_COMMAND <= len(data) <= LONGEST_COMMAND or data[0] not in _PLACES:
        return None
    sender, number, begin = _PLACES[data[0]]
    payload = data[begin : begin + data[1]].ljust(32, b"\0")  # zeros at its end are left out
    command = int.from_bytes(payload[28:30], "little")
    if data[number] == 11:  # SET_MODE
        return data[sender], data[sender + 1], payload[4], MavCommand.DO_SET_MODE
    if data[number] in (75, 76) and command in _ENDING:
        return data[sender], data[sender + 1], payload[30], command
    return None


class _Found(NamedTuple):
    message: MavlinkMessage | None  # the message, if it is one for us
    end: int  # where the frame ends; 0 if there is none
    checked: int  # bytes that were looked at


_NO_FRAME = _Found(None, 0, _HEADER_V2.size)


def _frame_v2(data: bytes, at: int, signer: PacketSigner | None, now: int) -> _Found:
    begin = at + _HEADER_V2.size
    if begin + 2 > len(data):
        return _NO_FRAME
    _, size, incompatible, _, _, system, component, low, high = _HEADER_V2.unpack_from(data, at)
    layout = _BY_NUMBER.get(low | high << 16)
    end = begin + size + 2
    is_signed = bool(incompatible & _SIGNED)
    whole = end + (_SIGNATURE if is_signed else 0)
    if incompatible & ~_SIGNED or whole > len(data) or layout is None:
        return _NO_FRAME
    if not _is_whole(data, at, end, layout):
        return _Found(None, 0, end - at)
    if signer is not None:
        sender = system, component
        if not (is_signed and signer.takes(data[at:whole], sender, now)):
            signer.refused += 1
            return _Found(None, whole, whole - at)
    fields = layout.read(data[begin : begin + size])
    message = MavlinkMessage(layout.name, fields, system, component)
    return _Found(message, whole, whole - at)


def _frame_v1(data: bytes, at: int, *, is_signed: bool) -> _Found:
    begin = at + _HEADER_V1.size
    if begin + 2 > len(data):
        return _NO_FRAME
    _, size, _, system, component, number = _HEADER_V1.unpack_from(data, at)
    layout = _BY_NUMBER.get(number)
    end = begin + size + 2
    if layout is None or end > len(data):
        return _NO_FRAME
    if not _is_whole(data, at, end, layout):
        return _Found(None, 0, end - at)
    if is_signed:
        return _Found(None, end, end - at)
    fields = layout.read(data[begin : begin + size])
    message = MavlinkMessage(layout.name, fields, system, component)
    return _Found(message, end, end - at)


def _is_whole(data: bytes, at: int, end: int, layout: MessageLayout) -> bool:
    (checksum,) = _CHECKSUM.unpack_from(data, end - 2)
    return bool(checksum == _crc(data[at + 1 : end - 2] + bytes([layout.crc_extra])))
