"""The module ``tf.transformations`` of a program: quaternions x, y, z, w; Euler angles in radians.

The names of the 24 orders of axes are those of that module: ``sxyz`` is about fixed x, y and z.
Needs numpy, as that module does.
"""

from __future__ import annotations

import math
from typing import Any

_NEXT = (1, 2, 0, 1)
_TINY = 1e-12


def _orders() -> dict[str, tuple[int, int, int, int]]:
    """First axis, parity, repetition and frame of each order of axes."""
    found = {}
    for first in range(3):
        for parity in range(2):
            for repetition in range(2):
                second, third = _NEXT[first + parity], _NEXT[first - parity + 1]
                axes = [first, second, first if repetition else third]
                names = "".join("xyz"[one] for one in axes)
                found[f"s{names}"] = (first, parity, repetition, 0)
                found[f"r{names[::-1]}"] = (first, parity, repetition, 1)
    return found


_AXES = _orders()


def _array(values: Any) -> Any:
    import numpy

    return numpy.array(values, dtype=float)


def _order(axes: Any) -> tuple[int, int, int, int]:
    return _AXES[axes.lower()] if isinstance(axes, str) else tuple(axes)


def identity_matrix() -> Any:
    return _array([[float(i == j) for j in range(4)] for i in range(4)])


def translation_matrix(direction: Any) -> Any:
    matrix = identity_matrix()
    matrix[:3, 3] = list(direction)[:3]
    return matrix


def translation_from_matrix(matrix: Any) -> Any:
    return _array(matrix)[:3, 3].copy()


def quaternion_multiply(quaternion1: Any, quaternion0: Any) -> Any:
    x0, y0, z0, w0 = quaternion0
    x1, y1, z1, w1 = quaternion1
    return _array(
        (
            x1 * w0 + y1 * z0 - z1 * y0 + w1 * x0,
            -x1 * z0 + y1 * w0 + z1 * x0 + w1 * y0,
            x1 * y0 - y1 * x0 + z1 * w0 + w1 * z0,
            -x1 * x0 - y1 * y0 - z1 * z0 + w1 * w0,
        )
    )


def quaternion_conjugate(quaternion: Any) -> Any:
    x, y, z, w = quaternion
    return _array((-x, -y, -z, w))


def quaternion_inverse(quaternion: Any) -> Any:
    return quaternion_conjugate(quaternion) / sum(one * one for one in quaternion)


def quaternion_about_axis(angle: float, axis: Any) -> Any:
    length = math.sqrt(sum(one * one for one in axis)) or 1.0
    sine = math.sin(angle / 2.0) / length
    return _array((*(one * sine for one in list(axis)[:3]), math.cos(angle / 2.0)))


def quaternion_matrix(quaternion: Any) -> Any:
    x, y, z, w = quaternion
    norm = x * x + y * y + z * z + w * w
    matrix = identity_matrix()
    if norm < _TINY:
        return matrix
    s = 2.0 / norm
    matrix[:3, :3] = [
        [1 - s * (y * y + z * z), s * (x * y - z * w), s * (x * z + y * w)],
        [s * (x * y + z * w), 1 - s * (x * x + z * z), s * (y * z - x * w)],
        [s * (x * z - y * w), s * (y * z + x * w), 1 - s * (x * x + y * y)],
    ]
    return matrix


def quaternion_from_matrix(matrix: Any) -> Any:
    m = _array(matrix)
    w = math.sqrt(max(0.0, 1 + m[0, 0] + m[1, 1] + m[2, 2])) / 2
    sizes = [w]
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        sizes.append(math.sqrt(max(0.0, 1 + m[i, i] - m[j, j] - m[k, k])) / 2)
    largest = max(range(4), key=sizes.__getitem__)
    s = 4 * sizes[largest]
    if largest == 0:
        return _array(
            ((m[2, 1] - m[1, 2]) / s, (m[0, 2] - m[2, 0]) / s, (m[1, 0] - m[0, 1]) / s, w)
        )
    i = largest - 1
    j, k = (i + 1) % 3, (i + 2) % 3
    found = [0.0] * 4
    found[i] = sizes[largest]
    found[j], found[k] = (m[i, j] + m[j, i]) / s, (m[i, k] + m[k, i]) / s
    found[3] = (m[k, j] - m[j, k]) / s
    return _array(found)


def _turn(axis: int, angle: float) -> Any:
    return quaternion_about_axis(angle, [float(axis == one) for one in range(3)])


def quaternion_from_euler(ai: float, aj: float, ak: float, axes: Any = "sxyz") -> Any:
    first, parity, repetition, frame = _order(axes)
    second, third = _NEXT[first + parity], _NEXT[first - parity + 1]
    angles = (ak, aj, ai) if frame else (ai, aj, ak)
    found = _turn(first, angles[0])
    for axis, angle in ((second, angles[1]), (first if repetition else third, angles[2])):
        found = quaternion_multiply(_turn(axis, angle), found)
    return found


def euler_matrix(ai: float, aj: float, ak: float, axes: Any = "sxyz") -> Any:
    return quaternion_matrix(quaternion_from_euler(ai, aj, ak, axes))


def euler_from_matrix(matrix: Any, axes: Any = "sxyz") -> tuple[float, float, float]:
    first, parity, repetition, frame = _order(axes)
    i, j, k = first, _NEXT[first + parity], _NEXT[first - parity + 1]
    m = _array(matrix)[:3, :3]
    if repetition:
        sine = math.hypot(m[i, j], m[i, k])
        if sine > _TINY:
            found = (
                math.atan2(m[i, j], m[i, k]),
                math.atan2(sine, m[i, i]),
                math.atan2(m[j, i], -m[k, i]),
            )
        else:
            found = math.atan2(-m[j, k], m[j, j]), math.atan2(sine, m[i, i]), 0.0
    else:
        cosine = math.hypot(m[i, i], m[j, i])
        if cosine > _TINY:
            found = (
                math.atan2(m[k, j], m[k, k]),
                math.atan2(-m[k, i], cosine),
                math.atan2(m[j, i], m[i, i]),
            )
        else:
            found = math.atan2(-m[j, k], m[j, j]), math.atan2(-m[k, i], cosine), 0.0
    if parity:
        found = -found[0], -found[1], -found[2]
    return (found[2], found[1], found[0]) if frame else found


def euler_from_quaternion(quaternion: Any, axes: Any = "sxyz") -> tuple[float, float, float]:
    return euler_from_matrix(quaternion_matrix(quaternion), axes)


def quaternion_slerp(quat0: Any, quat1: Any, fraction: float) -> Any:
    first, second = (_array(one) / math.sqrt(sum(x * x for x in one)) for one in (quat0, quat1))
    dot = float((first * second).sum())
    if dot < 0.0:
        second, dot = -second, -dot
    angle = math.acos(min(1.0, dot))
    if angle < _TINY:
        return first
    weights = (math.sin((1.0 - fraction) * angle), math.sin(fraction * angle))
    return (first * weights[0] + second * weights[1]) / math.sin(angle)


def concatenate_matrices(*matrices: Any) -> Any:
    found = identity_matrix()
    for one in matrices:
        found = found.dot(one)
    return found


def inverse_matrix(matrix: Any) -> Any:
    import numpy

    return numpy.linalg.inv(matrix)


def rotation_matrix(angle: float, direction: Any, point: Any = None) -> Any:
    matrix = quaternion_matrix(quaternion_about_axis(angle, direction))
    if point is not None:
        place = _array(list(point)[:3])
        matrix[:3, 3] = place - matrix[:3, :3].dot(place)
    return matrix


def unit_vector(data: Any, axis: int | None = None, out: Any = None) -> Any:
    import numpy

    values = _array(data)
    return values / numpy.linalg.norm(values, axis=axis, keepdims=axis is not None)


def vector_norm(data: Any, axis: int | None = None, out: Any = None) -> Any:
    import numpy

    return numpy.linalg.norm(_array(data), axis=axis)
