"""The parameters, their values and ranges as a table: what may be set bounds what is flown."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from m100link.apps.mavlink.translator.parameters import PARAMETERS

# At first, least and most. A turn of more than 100 °/s, a tilt of more than 30°, a climb of more
# than 4 m/s or a speed of more than 10 m/s is no setpoint of the M100.
TABLE: dict[str, tuple[float | None, float, float]] = {
    "MAV_SYS_ID": (None, 0.0, 0.0),
    "MIS_TAKEOFF_ALT": (2.5, 1.5, 100.0),
    "RTL_RETURN_ALT": (-1.0, 0.0, 0.0),
    "BAT1_V_CHARGED": (-1.0, 0.0, 0.0),
    "BAT1_V_EMPTY": (-1.0, 0.0, 0.0),
    "BAT1_V_LOAD_DROP": (-1.0, 0.0, 0.0),
    "RTL_DESCEND_ALT": (-1.0, 0.0, 0.0),
    "RTL_LAND_DELAY": (0.0, 0.0, 0.0),
    "COM_RC_LOSS_T": (0.5, 0.0, 0.0),
    "COM_OF_LOSS_T": (0.5, 0.1, 2.0),
    "MPC_XY_CRUISE": (5.0, 0.5, 10.0),
    "MPC_XY_VEL_MAX": (5.0, 0.5, 10.0),
    "MPC_Z_VEL_MAX_UP": (2.0, 0.2, 4.0),
    "MPC_Z_VEL_MAX_DN": (1.5, 0.2, 3.0),
    "MPC_MAN_Y_MAX": (60.0, 5.0, 100.0),
    "MPC_MAN_TILT_MAX": (15.0, 1.0, 30.0),
    "GF_MAX_HOR_DIST": (None, 0.0, 0.0),
    "GF_MAX_VER_DIST": (None, 0.0, 0.0),
    "COM_ARM_BAT_MIN": (None, 0.0, 0.0),
}

# What QGroundControl 5 reads of a PX4 quadrotor: in order, the parameters that its dialog
# "Parameters are missing from firmware" listed for a vehicle without any. The conditions are those
# of setupComplete of its components: airframe, sensors, radio (whose channels count unless
# COM_RC_IN_MODE is 1), power (voltages and cells). By BAT1_N_CELLS QGroundControl 4 tells PX4's
# newer names from BAT_N_CELLS, BAT_V_CHARGED and others, which it then misses.
SETUP: dict[str, Callable[[float], bool]] = {
    "SYS_AUTOSTART": lambda value: value != 0,
    "CAL_GYRO0_ID": lambda value: value != 0,
    "COM_RC_IN_MODE": lambda value: value == 1,
    "RC_MAP_ROLL": lambda value: value == 1,  # the channels of RC_CHANNELS
    "SYS_AUTOCONFIG": lambda value: value == 0,
    "MAV_SYS_ID": lambda value: True,
    "CAL_ACC0_ID": lambda value: value != 0,
    "CAL_MAG2_ID": lambda value: value == 0,  # is not shown
    "CAL_MAG1_ID": lambda value: value == 0,
    "CAL_MAG0_ID": lambda value: value != 0,
    "RC_MAP_AUX2": lambda value: value == 0,
    "RC_MAP_AUX1": lambda value: value == 0,
    "RC_MAP_FLAPS": lambda value: value == 0,
    "RC_MAP_THROTTLE": lambda value: value == 3,
    "RC_MAP_YAW": lambda value: value == 4,
    "RC_MAP_PITCH": lambda value: value == 2,
    **{f"COM_FLTMODE{number}": lambda value: value == -1 for number in range(1, 7)},  # unassigned
    "BAT1_SOURCE": lambda value: value == 1,  # external
    "BAT1_N_CELLS": lambda value: value == 6,  # of DJI's TB47D (22.2 V) and TB48D (22.8 V)
    "BAT1_V_CHARGED": lambda value: value == -1,
    "BAT1_V_EMPTY": lambda value: value == -1,
    "BAT1_V_LOAD_DROP": lambda value: value == -1,
    "RTL_LAND_DELAY": lambda value: value == 0,  # lands at once
    "RTL_DESCEND_ALT": lambda value: value == -1,
    "RTL_RETURN_ALT": lambda value: value == -1,
    "NAV_DLL_ACT": lambda value: value == 1,  # hold
    "COM_RC_LOSS_T": lambda value: value == 0.5,
    "NAV_RCL_ACT": lambda value: value == -1,
    "COM_LOW_BAT_ACT": lambda value: value == -1,
}
INTEGERS = {"MAV_SYS_ID", *(name for name in SETUP if name not in TABLE)}


@pytest.mark.parametrize("name", SETUP)
def test_a_ground_station_for_px4_finds_a_vehicle_that_is_set_up(name: str) -> None:
    """QGroundControl's first words were two warnings, and it opened its setup."""
    one = PARAMETERS[name]
    assert name == "MAV_SYS_ID" or (one.value is not None and SETUP[name](one.value))
    assert not one.is_settable, "nothing here can be calibrated"
    assert one.is_whole is (name in INTEGERS)


def test_no_parameter_is_missing() -> None:
    assert set(PARAMETERS) == set(TABLE) | set(SETUP)


@pytest.mark.parametrize("name", TABLE)
def test_values_and_ranges(name: str) -> None:
    one = PARAMETERS[name]
    assert (one.value, one.least, one.most) == TABLE[name]
    assert one.is_settable is (TABLE[name][2] > 0.0)
