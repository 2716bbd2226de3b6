"""Messages of ROS 2 made of telemetry, beside rosbags' generated code, which is what others use.

    python -m benchmarks.ros2 [ROW …] [--rounds 15] [--json]

What is timed is the CPU of one thread: an Imu filled into its template, the same with its numbers
turned into the frames of ROS, and rosbags making the same bytes of a message with NumPy arrays.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from contextlib import ExitStack
from importlib.util import find_spec
from typing import Any

from benchmarks.program import main
from benchmarks.rows import (
    Absent,
    Program,
    Row,
    Setting,
    Side,
    at_least,
    at_most,
    ratio,
    timed,
    times,
)
from m100link.log.cdr import Template, full_name
from m100link.log.ros2 import Messages
from m100link.protocol.records import Acceleration, AngularVelocity, Attitude

IMU = "sensor_msgs/Imu"
COUNT = 20_000
FILLED, MADE, ROSBAGS = "an Imu filled in", "an Imu from records", "an Imu by rosbags"

VECTOR = {"x": 0.1, "y": 0.2, "z": 0.3}
UNKNOWN = [0.0] * 9
PARTS = ("orientation", "angular_velocity", "linear_acceleration")
MESSAGE: dict[str, Any] = {
    "header": {"stamp": {"sec": 7, "nanosec": 8}, "frame_id": "base_link"},
    "orientation": {**VECTOR, "w": 0.9},
    "angular_velocity": VECTOR,
    "linear_acceleration": VECTOR,
    **{f"{name}_covariance": UNKNOWN for name in PARTS},
}


def repeated(name: str, count: int, make: Callable[[], bytes]) -> Side:
    """A side that makes a message again and again."""
    return timed(name, count, lambda: sum(len(make()) > 0 for _ in range(count)))


def ours(setting: Setting, stack: ExitStack) -> Iterable[Side | Absent]:
    """The template alone, and what leads to it."""
    count = setting.count(COUNT)
    template = Template(IMU, MESSAGE, "header.stamp", *PARTS)
    stamp, turned, vector = (7, 8), (0.1, 0.2, 0.3, 0.9), (0.1, 0.2, 0.3)
    yield repeated(FILLED, count, lambda: template.fill(stamp, turned, vector, vector))
    messages = Messages("odom", "base_link")
    attitude, rates = Attitude(0.9, 0.1, 0.2, 0.3), AngularVelocity(*vector)
    felt = Acceleration(*vector)
    yield repeated(MADE, count, lambda: messages.imu(stamp, attitude, rates, felt))


def others(setting: Setting, stack: ExitStack) -> Iterable[Side | Absent]:
    """rosbags, with the message ready made."""
    if find_spec("rosbags") is None:
        yield Absent(ROSBAGS, "needs rosbags")
        return
    import numpy as np
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.LATEST)
    made = store.types

    def of(kind: str, **fields: Any) -> Any:
        return made[full_name(kind)](**fields)

    vector, turned = (of("geometry_msgs/Vector3", **VECTOR), MESSAGE["orientation"])
    header = of(
        "std_msgs/Header",
        stamp=of("builtin_interfaces/Time", sec=7, nanosec=8),
        frame_id="base_link",
    )
    message = of(
        IMU,
        header=header,
        orientation=of("geometry_msgs/Quaternion", **turned),
        angular_velocity=vector,
        linear_acceleration=vector,
        **{f"{name}_covariance": np.zeros(9) for name in PARTS},
    )
    count = setting.count(COUNT // 10)
    name = full_name(IMU)
    yield repeated(ROSBAGS, count, lambda: bytes(store.serialize_cdr(message, name)))


PROGRAM = Program(
    name="ros2",
    rows=(
        Row("an Imu for ROS 2, rosbags ÷ ours", ratio(ROSBAGS, FILLED), at_least(2)),
        Row("an Imu for ROS 2 filled in", times(FILLED, 1e6), at_most(3), "µs"),
        Row("the same from records, with its frames turned", times(MADE, 1e6), unit="µs"),
    ),
    ours=ours,
    others=others,
)

if __name__ == "__main__":
    main(PROGRAM)
