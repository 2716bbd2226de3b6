"""Parameters: what a ground station may look up and set, under the names that it knows from PX4.

The M100 has no parameters on its wire. These are the settings of the bridge, the known limits of
the aircraft, and those that QGroundControl reads of every PX4 vehicle. All but settings are
read-only, and answered with their value.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from zlib import crc32

from m100link.apps.mavlink.translator.codec import MavlinkMessage
from m100link.apps.mavlink.translator.numbers import ParamError
from m100link.apps.mavlink.translator.offboard import STICKS_LIFETIME
from m100link.apps.mavlink.translator.vehicle_state import VehicleState

_REAL32, _INT32 = 9, 6


@dataclass(frozen=True, slots=True)
class ParamRow:
    value: float | None  # at first; of one that tells of the aircraft, None
    meaning: str  # for the manual
    least: float = 0.0  # what it may be set to
    most: float = 0.0  # likewise; where both are the same it is read-only
    # The value as aircraft or agent report it, for the parameters that show it.
    get: Callable[[VehicleState, int], float | None] | None = None
    is_whole: bool = False  # whether it is an integer

    @property
    def is_settable(self) -> bool:
        return self.most > self.least


_BY_DJI = "1: DJI's autopilot calibrates it, not a ground station"
_OF_DJI = "DJI's own setting, unknown here: -1"
_NO_SWITCH = "-1: the mode switch is DJI's"

_SETUP: Mapping[str, tuple[int, str]] = {
    "SYS_AUTOSTART": (4001, "4001: a quadrotor"),
    "SYS_AUTOCONFIG": (0, "0: nothing to set up"),
    "CAL_GYRO0_ID": (1, _BY_DJI),
    "CAL_ACC0_ID": (1, _BY_DJI),
    "CAL_MAG0_ID": (1, _BY_DJI),
    "CAL_MAG1_ID": (0, "0: no second compass is known"),
    "CAL_MAG2_ID": (0, "0: no third one"),
    "COM_RC_IN_MODE": (1, "1: sticks by MANUAL_CONTROL; those of the pilot go to DJI's autopilot"),
    "RC_MAP_ROLL": (1, "channel of RC_CHANNELS"),
    "RC_MAP_PITCH": (2, "channel of RC_CHANNELS"),
    "RC_MAP_THROTTLE": (3, "channel of RC_CHANNELS"),
    "RC_MAP_YAW": (4, "channel of RC_CHANNELS"),
    "RC_MAP_FLAPS": (0, "0: none"),
    "RC_MAP_AUX1": (0, "0: none"),
    "RC_MAP_AUX2": (0, "0: none"),
    **{f"COM_FLTMODE{number}": (-1, _NO_SWITCH) for number in range(1, 7)},
    "BAT1_SOURCE": (1, "1: the aircraft reports its battery"),
    "BAT1_N_CELLS": (6, "6, as TB47D and TB48D have"),
    "NAV_DLL_ACT": (1, "1: a lost ground station is a hold"),
    "NAV_RCL_ACT": (-1, _OF_DJI),
    "COM_LOW_BAT_ACT": (-1, _OF_DJI),
}
"""Integers that QGroundControl reads of every PX4 vehicle. Without one it says that the firmware
has a bug; by one that reads as "not set up" it opens its setup instead of its map."""

PARAMETERS: Mapping[str, ParamRow] = {
    "MAV_SYS_ID": ParamRow(
        None, "system id of this aircraft", get=lambda _, system: system, is_whole=True
    ),
    "MIS_TAKEOFF_ALT": ParamRow(2.5, "height of a take-off without one, m", 1.5, 100.0),
    "RTL_RETURN_ALT": ParamRow(-1.0, _OF_DJI),
    "RTL_DESCEND_ALT": ParamRow(-1.0, _OF_DJI),
    **dict.fromkeys(
        ("BAT1_V_CHARGED", "BAT1_V_EMPTY", "BAT1_V_LOAD_DROP"),
        ParamRow(-1.0, "of a cell: the aircraft does not report it: -1"),
    ),
    "RTL_LAND_DELAY": ParamRow(0.0, "0: the autopilot lands at once"),
    "COM_RC_LOSS_T": ParamRow(STICKS_LIFETIME, "s without MANUAL_CONTROL until Position holds"),
    "COM_OF_LOSS_T": ParamRow(0.5, "s without a setpoint until OFFBOARD holds", 0.1, 2.0),
    "MPC_XY_CRUISE": ParamRow(5.0, "speed of flights to a place and of missions, m/s", 0.5, 10.0),
    "MPC_XY_VEL_MAX": ParamRow(5.0, "greatest speed of OFFBOARD and of sticks, m/s", 0.5, 10.0),
    "MPC_Z_VEL_MAX_UP": ParamRow(2.0, "greatest climb of OFFBOARD and of sticks, m/s", 0.2, 4.0),
    "MPC_Z_VEL_MAX_DN": ParamRow(1.5, "greatest descent of them, m/s", 0.2, 3.0),
    "MPC_MAN_Y_MAX": ParamRow(60.0, "greatest turn of sticks, degrees/s", 5.0, 100.0),
    "MPC_MAN_TILT_MAX": ParamRow(15.0, "greatest tilt of sticks in ALTCTL, degrees", 1.0, 30.0),
    "GF_MAX_HOR_DIST": ParamRow(
        None,
        "the agent's envelope: m from where control was obtained; 0 without",
        get=lambda world, _: world.known.view.state.limits.max_radius_m,
    ),
    "GF_MAX_VER_DIST": ParamRow(
        None,
        "the agent's envelope: m above the take-off point; 0 without",
        get=lambda world, _: world.known.view.state.limits.max_height_m,
    ),
    "COM_ARM_BAT_MIN": ParamRow(
        None,
        "the agent's floor of the battery, 0 to 1",
        get=lambda world, _: (world.known.view.state.limits.battery_floor_percent or 0) / 100,
    ),
    **{name: ParamRow(value, meaning, is_whole=True) for name, (value, meaning) in _SETUP.items()},
}
"""By name."""

_NAMES = tuple(PARAMETERS)


# -- component metadata: what a ground station shows beside the values -----------------------------


_OF_PARAMETERS = 1  # COMP_METADATA_TYPE


def _metadata() -> Mapping[str, bytes]:
    described = [
        {"name": name, "type": "Int32" if one.is_whole else "Float", "shortDesc": one.meaning}
        | {"group": name.partition("_")[0]}
        | ({"min": one.least, "max": one.most} if one.is_settable else {"readOnly": True})
        | ({} if one.value is None else {"default": one.value})
        for name, one in PARAMETERS.items()
    ]
    # QGroundControl reads version 1 of both, whatever the schema of MAVLink says.
    parameters = json.dumps({"version": 1, "parameters": described}).encode()
    uri = {"uri": "mftp:///parameter.json", "fileCrc": crc32(parameters)}
    general = {"version": 1, "metadataTypes": [{"type": _OF_PARAMETERS} | uri]}
    return {"general.json": json.dumps(general).encode(), "parameter.json": parameters}


METADATA = _metadata()
"""Files for MAVLink FTP, by path; COMPONENT_METADATA names the first."""


def component_metadata() -> MavlinkMessage:
    crc = crc32(METADATA["general.json"])
    return MavlinkMessage("COMPONENT_METADATA", {"uri": "mftp:///general.json", "file_crc": crc})


class ParameterProtocol:
    def __init__(self, world: VehicleState, system: int) -> None:
        self._world = world
        self._system = system
        # Those of the bridge itself, by name, as they are set now: what flies reads them here.
        self.values = {name: one.value for name, one in PARAMETERS.items() if one.value is not None}

    def _value(self, name: str) -> float:
        one = PARAMETERS[name]
        value = self.values[name] if one.get is None else one.get(self._world, self._system)
        return 0.0 if value is None else value

    def message(self, name: str) -> MavlinkMessage:
        one, value = PARAMETERS[name], self._value(name)
        if one.is_whole:  # an integer travels as its bits
            (value,) = struct.unpack("<f", struct.pack("<i", int(value)))
        fields = {
            "param_value": value,
            "param_count": len(_NAMES),
            "param_index": _NAMES.index(name),
            "param_id": name,
            "param_type": _INT32 if one.is_whole else _REAL32,
        }
        return MavlinkMessage("PARAM_VALUE", fields)

    def receive(
        self, message: MavlinkMessage, *, is_others: bool
    ) -> tuple[list[MavlinkMessage], str]:
        """The answers to a question or a new value, and why that one was not taken.

        ``is_others``: whether somebody else flies, whose values these are.
        """
        if message.name == "PARAM_REQUEST_LIST":
            return [self.message(name) for name in _NAMES], ""
        name, index = str(message["param_id"]), message.fields.get("param_index", -1)
        if index >= 0:
            name = _NAMES[index] if index < len(_NAMES) else ""
        error, why = None, f"there is no parameter {name}"
        if name not in PARAMETERS:
            error = ParamError.DOES_NOT_EXIST
        elif message.name == "PARAM_SET":
            error, why = self._refusal(name, message["param_value"], is_others=is_others)
            if error is None and PARAMETERS[name].is_settable:
                self.values[name] = message["param_value"]
        answers = [self.message(name)] if name in PARAMETERS else []
        if error is not None:
            fields = {"param_id": name, "param_index": index, "error": error}
            answers.append(MavlinkMessage("PARAM_ERROR", fields))
        return answers, why if error is not None and message.name == "PARAM_SET" else ""

    def _refusal(
        self, name: str, value: float, *, is_others: bool
    ) -> tuple[ParamError | None, str]:
        one = PARAMETERS[name]
        if one.is_settable:
            if not one.least <= value <= one.most:  # which no NaN is
                return ParamError.VALUE_OUT_OF_RANGE, f"{name} is {one.least:g} to {one.most:g}"
        else:
            given = struct.unpack("<i", struct.pack("<f", value))[0] if one.is_whole else value
            if given != self._value(name):
                return ParamError.READ_ONLY, f"{name} is read-only"
        if is_others:
            return ParamError.PERMISSION_DENIED, "a parameter: somebody else flies"
        return None, ""
