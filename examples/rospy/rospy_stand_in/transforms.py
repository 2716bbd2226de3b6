"""The modules ``tf`` and ``tf2_ros`` of a program: the transforms that the program publishes.

The station publishes none. Of each frame the newest transform counts, whatever time is asked for.
"""

from __future__ import annotations

import threading
import time
from typing import Any

from rospy_stand_in import transformations as turn
from rospy_stand_in.genpy import RosTime, message_class

_STEP_S = 0.02


class TransformException(Exception):
    """No transform leads from one frame to the other."""


_LOCK = threading.Lock()
_PARENTS: dict[
    str, tuple[str, Any, Any]
] = {}  # by frame: parent, matrix from frame to parent, time


def _put(parent: str, child: str, translation: Any, rotation: Any, stamp: Any) -> None:
    matrix = turn.quaternion_matrix(rotation)
    matrix[:3, 3] = list(translation)[:3]
    with _LOCK:
        _PARENTS[child.strip("/")] = (parent.strip("/"), matrix, stamp)


def _climb(frame: str) -> list[tuple[str, Any, Any]]:
    """The frames above one, with the matrix from it and the newest stamp on the way."""
    found = [(frame, turn.identity_matrix(), RosTime())]
    while (above := _PARENTS.get(found[-1][0])) is not None and len(found) <= len(_PARENTS):
        parent, matrix, stamp = above
        _, so_far, newest = found[-1]
        found.append((parent, matrix @ so_far, max(newest, stamp)))
    return found


def _between(target: str, source: str) -> tuple[Any, Any, Any]:
    """Translation, quaternion and time of ``source`` in ``target``.

    Raises ``TransformException``: no transforms lead there.
    """
    target, source = target.strip("/"), source.strip("/")
    with _LOCK:
        below = {frame: (matrix, stamp) for frame, matrix, stamp in _climb(target)}
        for frame, matrix, stamp in _climb(source):
            if frame in below:
                back, other = below[frame]
                whole = turn.inverse_matrix(back) @ matrix
                return whole[:3, 3], turn.quaternion_from_matrix(whole), max(stamp, other)
    raise TransformException(f"no transform from {source} to {target} is known in this program")


def _waited(target: str, source: str, timeout: Any) -> bool:
    seconds = timeout.to_sec() if hasattr(timeout, "to_sec") else float(timeout or 0.0)
    ends_at = time.monotonic() + seconds
    while True:
        try:
            _between(target, source)
        except TransformException:
            if time.monotonic() >= ends_at:
                return False
            time.sleep(_STEP_S)
        else:
            return True


class Tf2Broadcaster:
    """``tf2_ros``: takes stamped transforms."""

    def sendTransform(self, transform: Any) -> None:  # noqa: N802 - tf's
        for one in transform if isinstance(transform, list) else [transform]:
            move, rotation = one.transform.translation, one.transform.rotation
            _put(
                one.header.frame_id,
                one.child_frame_id,
                (move.x, move.y, move.z),
                (rotation.x, rotation.y, rotation.z, rotation.w),
                one.header.stamp,
            )

    sendTransformMessage = sendTransform  # noqa: N815 - tf's


class TransformBroadcaster(Tf2Broadcaster):
    """``tf``: takes the parts of a transform."""

    def sendTransform(  # type: ignore[override]  # noqa: N802 - tf's
        self, translation: Any, rotation: Any, time: Any, child: str, parent: str
    ) -> None:
        _put(parent, child, translation, rotation, time)


class Buffer:
    """``tf2_ros``: looks transforms up."""

    def __init__(self, *_: object, **__: object) -> None:
        """Its length and time do not matter here."""

    def lookup_transform(
        self, target_frame: str, source_frame: str, time: Any = None, timeout: Any = None
    ) -> Any:
        """Raises ``TransformException``."""
        _waited(target_frame, source_frame, timeout)
        translation, rotation, stamp = _between(target_frame, source_frame)
        made: Any = message_class("geometry_msgs/TransformStamped")()
        made.header.frame_id, made.header.stamp, made.child_frame_id = (
            target_frame,
            stamp,
            source_frame,
        )
        move, turned = made.transform.translation, made.transform.rotation
        move.x, move.y, move.z = map(float, translation)
        turned.x, turned.y, turned.z, turned.w = map(float, rotation)
        return made

    def can_transform(self, target_frame: str, source_frame: str, *rest: Any) -> bool:
        return _waited(target_frame, source_frame, rest[1] if len(rest) > 1 else None)


class Tf2Listener:
    """``tf2_ros``: fills a buffer, which is full already."""

    def __init__(self, *_: object, **__: object) -> None:
        """Nothing has to be subscribed to."""


class TransformListener(Buffer):
    """``tf``: the same by its names."""

    def lookupTransform(self, target: str, source: str, at: object) -> Any:  # noqa: N802 - tf's
        """Raises ``TransformException``."""
        translation, rotation, _ = _between(target, source)
        return list(map(float, translation)), list(map(float, rotation))

    def waitForTransform(  # noqa: N802 - tf's
        self, target: str, source: str, time: object, timeout: Any, *_: object
    ) -> None:
        """Raises ``TransformException``."""
        if not _waited(target, source, timeout):
            _between(target, source)

    def canTransform(self, target: str, source: str, *_: object) -> bool:  # noqa: N802 - tf's
        return _waited(target, source, None)

    frameExists = lambda self, frame: frame.strip("/") in _PARENTS  # noqa: E731, N815 - tf's

    def getLatestCommonTime(self, source: str, target: str) -> Any:  # noqa: N802 - tf's
        """Raises ``TransformException``."""
        return _between(target, source)[2]
