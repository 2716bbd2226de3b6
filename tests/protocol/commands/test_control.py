"""The movement command on the wire."""

from __future__ import annotations

import struct
from typing import Any

import pytest

from m100link.protocol import Arm, Move, RequestAuthority, StartTask, Task, profile
from tests.support import load_vectors

VECTORS = load_vectors("movement")


def _move(vector: dict[str, Any]) -> Move:
    names = ("control_flag", "roll_or_x", "pitch_or_y", "throttle_or_z", "yaw")
    return Move(*(vector[name] for name in names))


@pytest.mark.parametrize("vector", VECTORS, ids=range(len(VECTORS)))
@pytest.mark.parametrize(
    ("firmware", "order"),
    [
        ("1.0", "value"),
        ("2.3", "value"),
        ("3.1", "value"),
        ("1.0-document", "value_in_document_order"),
    ],
)
def test_golden_movement_both_ways(vector: dict[str, Any], firmware: str, order: str) -> None:
    value = bytes.fromhex(vector[order])
    assert _move(vector).value(profile(firmware)) == value
    assert Move.parse(value, profile(firmware)) == _move(vector)


def test_throttle_comes_before_yaw_on_the_wire() -> None:
    """The order in which real aircraft read the two values.

    The V1.0.1 document prints yaw before throttle, in its table and in its listing. Every program
    that DJI shipped, the sample of the same month included, sends throttle first, and the document
    was corrected in September 2015. A swap would turn a climb of 0.5 m/s with a turn of 10 °/s into
    a climb of 10 m/s: hence this test spells the bytes out instead of encoding and decoding.
    """
    move = Move(0x48, roll_or_x=1.0, pitch_or_y=2.0, throttle_or_z=3.0, yaw=4.0)
    for firmware in ("1.0", "2.3", "3.1"):
        assert move.value(profile(firmware)) == b"\x48" + struct.pack("<4f", 1, 2, 3, 4)
    assert move.value(profile("1.0-document")) == b"\x48" + struct.pack("<4f", 1, 2, 4, 3)


def test_tasks_have_the_numbers_of_the_document() -> None:
    assert {task.name: int(task) for task in Task} == {"GO_HOME": 1, "TAKE_OFF": 4, "LAND": 6}
    assert StartTask(9, Task.LAND).value(profile("1.0")) == b"\x09\x06"


def test_1_obtains_and_arms_0_releases_and_disarms() -> None:
    for on in (True, False):
        assert RequestAuthority(on).value(profile("1.0")) == bytes((on,))
        assert Arm(on).value(profile("3.1")) == bytes((on,))
