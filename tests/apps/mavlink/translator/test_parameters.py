"""The parameters, their values and ranges as a table: what may be set bounds what is flown."""

from __future__ import annotations

import pytest

from m100link.apps.mavlink.translator.parameters import PARAMETERS

# At first, least and most. A turn of more than 100 °/s, a tilt of more than 30°, a climb of more
# than 4 m/s or a speed of more than 10 m/s is no setpoint of the M100.
TABLE: dict[str, tuple[float | None, float, float]] = {
    "MAV_SYS_ID": (None, 0.0, 0.0),
    "MIS_TAKEOFF_ALT": (2.5, 1.5, 100.0),
    "RTL_RETURN_ALT": (-1.0, 0.0, 0.0),
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


def test_no_parameter_is_missing() -> None:
    assert set(PARAMETERS) == set(TABLE)


@pytest.mark.parametrize("name", TABLE)
def test_values_and_ranges(name: str) -> None:
    one = PARAMETERS[name]
    assert (one.value, one.least, one.most) == TABLE[name]
    assert one.is_settable is (TABLE[name][2] > 0.0)
