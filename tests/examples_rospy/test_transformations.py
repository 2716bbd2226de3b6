"""Quaternions and angles as ``tf.transformations`` has them: x, y, z, w; radians."""

from __future__ import annotations

import math
import random

import pytest

numpy = pytest.importorskip("numpy")

from rospy_stand_in import transformations as tf  # noqa: E402 - needs numpy

HALF = math.sqrt(0.5)
ORDERS = [a + b for a in "sr" for b in (
    ["xyz", "xyx", "xzy", "xzx", "yzx", "yzy", "yxz", "yxy", "zxy", "zxz", "zyx", "zyz"]
)]  # fmt: skip


@pytest.mark.parametrize(
    ("angles", "quaternion"),
    [
        ((0.0, 0.0, 0.0), (0, 0, 0, 1)),
        ((math.pi / 2, 0.0, 0.0), (HALF, 0, 0, HALF)),
        ((0.0, math.pi / 2, 0.0), (0, HALF, 0, HALF)),
        ((0.0, 0.0, math.pi / 2), (0, 0, HALF, HALF)),
        # Roll first, then pitch, then yaw, about fixed axes: by hand.
        ((math.pi / 2, 0.0, math.pi / 2), (0.5, 0.5, 0.5, 0.5)),
    ],
)
def test_angles_as_quaternions(
    angles: tuple[float, float, float], quaternion: tuple[float, ...]
) -> None:
    assert tf.quaternion_from_euler(*angles) == pytest.approx(quaternion)
    assert tf.euler_from_quaternion(quaternion) == pytest.approx(angles)


@pytest.mark.parametrize("order", ORDERS)
def test_each_order_of_axes_there_and_back(order: str) -> None:
    chance = random.Random(order)
    for _ in range(20):
        angles = [chance.uniform(-3.0, 3.0) for _ in range(3)]
        matrix = tf.euler_matrix(angles[0], angles[1], angles[2], order)
        first, second, third = tf.euler_from_matrix(matrix, order)
        again = tf.euler_matrix(first, second, third, order)
        assert again == pytest.approx(matrix, abs=1e-9), angles
        quaternion = tf.quaternion_from_matrix(matrix)
        assert tf.quaternion_matrix(quaternion) == pytest.approx(matrix, abs=1e-9), angles


def test_a_turned_order_is_the_other_one_backwards() -> None:
    """Turns about the axes of the body, first z, are those about fixed axes, first x."""
    fixed = tf.quaternion_from_euler(0.1, 0.2, 0.3, "sxyz")
    assert tf.quaternion_from_euler(0.3, 0.2, 0.1, "rzyx") == pytest.approx(fixed)


def test_products_inverses_and_turns() -> None:
    east, up = tf.quaternion_about_axis(0.5, (2, 0, 0)), tf.quaternion_about_axis(0.7, (0, 0, 1))
    product = tf.quaternion_multiply(up, east)  # east first
    matrix = tf.quaternion_matrix(up).dot(tf.quaternion_matrix(east))
    assert tf.quaternion_matrix(product) == pytest.approx(matrix)
    rest = tf.quaternion_multiply(product, tf.quaternion_inverse(product))
    assert rest == pytest.approx([0, 0, 0, 1])
    assert tf.quaternion_slerp((0, 0, 0, 1), up, 0.5) == pytest.approx(
        tf.quaternion_about_axis(0.35, (0, 0, 1))
    )
    moved = tf.concatenate_matrices(
        tf.translation_matrix((1, 2, 3)), tf.rotation_matrix(0.7, (0, 0, 1))
    )
    assert tf.translation_from_matrix(moved) == pytest.approx([1, 2, 3])
    assert tf.concatenate_matrices(moved, tf.inverse_matrix(moved)) == pytest.approx(numpy.eye(4))
    assert tf.unit_vector([3.0, 4.0]) == pytest.approx([0.6, 0.8])
    assert tf.vector_norm([3.0, 4.0]) == pytest.approx(5.0)
