"""Parameters: what a ground station may look up and set, under the names that it knows from PX4.

The M100 has no parameters on its wire. These are the settings of the bridge, and what it knows of
the aircraft's limits; what cannot be set here is read-only, and answered with its value.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from m100link.apps.mavlink.translator.codec import MavlinkMessage
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


PARAMETERS: Mapping[str, ParamRow] = {
    "MAV_SYS_ID": ParamRow(
        None, "system id of this aircraft", get=lambda _, system: system, is_whole=True
    ),
    "MIS_TAKEOFF_ALT": ParamRow(2.5, "height of a take-off without one, m", 1.5, 100.0),
    "RTL_RETURN_ALT": ParamRow(-1.0, "DJI's own setting, unknown here: -1"),
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
}
"""By name."""

_NAMES = tuple(PARAMETERS)


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
        """PARAM_VALUE."""
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

    def receive(self, message: MavlinkMessage) -> list[MavlinkMessage]:
        """The answers to a question, or to a value that nobody refuses (:meth:`refusal`)."""
        if message.name == "PARAM_REQUEST_LIST":
            return [self.message(name) for name in _NAMES]
        name = str(message["param_id"])
        if message.name == "PARAM_REQUEST_READ":
            index = message["param_index"]
            if index >= 0:
                name = _NAMES[index] if index < len(_NAMES) else ""
            return [self.message(name)] if name in PARAMETERS else []
        if PARAMETERS[name].is_settable:
            self.values[name] = message["param_value"]
        return [self.message(name)]

    def refusal(self, message: MavlinkMessage) -> str:
        """Why a value was not taken; empty where it was."""
        name, value = str(message["param_id"]), message["param_value"]
        one = PARAMETERS.get(name)
        if one is None:
            return f"there is no parameter {name}"
        if one.is_settable:
            is_right = one.least <= value <= one.most  # which no NaN is
            return "" if is_right else f"{name} is {one.least:g} to {one.most:g}"
        given = struct.unpack("<i", struct.pack("<f", value))[0] if one.is_whole else value
        return "" if given == self._value(name) else f"{name} is read-only"
