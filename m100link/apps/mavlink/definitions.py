"""Messages of MAVLink 2 that the bridge speaks: a row each, as the public definitions have them.

``number NAME: fields``, in the order of the wire; what stands behind ``|`` are extensions, which
older programs leave out. The extra byte of the checksum follows from names and types
(``m100link.apps.mavlink.codec``), so a field that is wrong here is a message that nobody
understands.
"""

from __future__ import annotations

__all__ = ["DEFINITIONS"]

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
105 HIGHRES_IMU: u64 time_usec, f32 xacc, f32 yacc, f32 zacc, f32 xgyro, f32 ygyro, f32 zgyro,
    f32 xmag, f32 ymag, f32 zmag, f32 abs_pressure, f32 diff_pressure, f32 pressure_alt, f32
    temperature, u16 fields_updated | u8 id
110 FILE_TRANSFER_PROTOCOL: u8 target_network, u8 target_system, u8 target_component, u8[251]
    payload
111 TIMESYNC: i64 tc1, i64 ts1
117 LOG_REQUEST_LIST: u16 start, u16 end, u8 target_system, u8 target_component
118 LOG_ENTRY: u32 time_utc, u32 size, u16 id, u16 num_logs, u16 last_log_num
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
435 AVAILABLE_MODES: u32 custom_mode, u32 properties, u8 number_modes, u8 mode_index, u8
    standard_mode, char[35] mode_name
436 CURRENT_MODE: u32 custom_mode, u32 intended_custom_mode, u8 standard_mode
"""
"""All of them; each row may go on in lines that are indented."""
