"""The modules ``tf`` and ``tf2_ros``: transforms of the program, and of others on its station.

The station publishes none. Of each frame the newest transform counts, whatever time is asked for.
"""

from __future__ import annotations

import threading
import time
from typing import Any, ClassVar

from rospy_stand_in import node
from rospy_stand_in import transformations as turn
from rospy_stand_in.genpy import RosTime, from_json, message_class, to_json

_STEP_S = 0.02
_KIND = "tf2_msgs/TFMessage"


class TransformException(Exception):
    """No transform leads from one frame to the other."""


_LOCK = threading.Lock()
_PARENTS: dict[
    str, tuple[str, Any, Any]
] = {}  # by frame: parent, matrix from frame to parent, time


def _put(one: Any) -> None:
    move, turned = one.transform.translation, one.transform.rotation
    matrix = turn.quaternion_matrix((turned.x, turned.y, turned.z, turned.w))
    matrix[:3, 3] = move.x, move.y, move.z
    with _LOCK:
        _PARENTS[one.child_frame_id.strip("/")] = (
            one.header.frame_id.strip("/"),
            matrix,
            one.header.stamp,
        )


def _take(message: Any) -> None:
    for one in message["transforms"]:
        _put(from_json(message_class("geometry_msgs/TransformStamped"), one))


def _listen() -> None:
    bridge = node.opened()
    if bridge is not None:
        for topic in ("/tf", "/tf_static"):
            bridge.subscribe(topic, _KIND, _take)


def _stamped(translation: Any, rotation: Any, stamp: Any, child: str, parent: str) -> Any:
    made: Any = message_class("geometry_msgs/TransformStamped")()
    made.header.frame_id, made.header.stamp, made.child_frame_id = parent, stamp, child
    move, turned = made.transform.translation, made.transform.rotation
    move.x, move.y, move.z = map(float, translation[:3])
    turned.x, turned.y, turned.z, turned.w = map(float, rotation)
    return made


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
    raise TransformException(f"no transform from {source} to {target} is known here")


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


def _broadcast(transforms: list[Any], topic: str = "/tf", *, latch: bool = False) -> None:
    for one in transforms:
        _put(one)
    bridge = node.opened()
    if bridge is not None:
        message = {"transforms": [to_json(one) for one in transforms]}
        bridge.publish(topic, message, latch=latch)


class Tf2Broadcaster:
    """``tf2_ros``: takes stamped transforms."""

    def sendTransform(self, transform: Any) -> None:
        _broadcast(transform if isinstance(transform, list) else [transform])


class StaticBroadcaster:
    """``tf2_ros``: the same, and a later listener gets them all."""

    _sent: ClassVar[dict[str, Any]] = {}  # of the program, by frame

    def sendTransform(self, transform: Any) -> None:
        several = transform if isinstance(transform, list) else [transform]
        self._sent.update({one.child_frame_id: one for one in several})
        _broadcast(list(self._sent.values()), "/tf_static", latch=True)


class TransformBroadcaster:
    """``tf``: takes the parts of a transform, or a stamped one."""

    def sendTransform(
        self, translation: Any, rotation: Any, time: Any, child: str, parent: str
    ) -> None:
        self.sendTransformMessage(_stamped(translation, rotation, time, child, parent))

    def sendTransformMessage(self, transform: Any) -> None:
        _broadcast([transform])


class Buffer:
    """``tf2_ros``: looks transforms up."""

    def __init__(self, *_: object, **__: object) -> None:
        _listen()  # its length and time do not matter here

    def lookup_transform(
        self, target_frame: str, source_frame: str, time: Any = None, timeout: Any = None
    ) -> Any:
        """Raises ``TransformException``."""
        _waited(target_frame, source_frame, timeout)
        translation, rotation, stamp = _between(target_frame, source_frame)
        return _stamped(translation, rotation, stamp, source_frame, target_frame)

    def can_transform(self, target_frame: str, source_frame: str, *rest: Any) -> bool:
        return _waited(target_frame, source_frame, rest[1] if len(rest) > 1 else None)


class Tf2Listener:
    """``tf2_ros``: fills a buffer, which fills itself."""

    def __init__(self, *_: object, **__: object) -> None:
        """Nothing is left to do."""


class TransformListener(Buffer):
    """``tf``: the same by its names."""

    def lookupTransform(self, target: str, source: str, at: object) -> Any:
        """Raises ``TransformException``."""
        translation, rotation, _ = _between(target, source)
        return list(map(float, translation)), list(map(float, rotation))

    def waitForTransform(
        self, target: str, source: str, time: object, timeout: Any, *_: object
    ) -> None:
        """Raises ``TransformException``."""
        if not _waited(target, source, timeout):
            _between(target, source)

    def canTransform(self, target: str, source: str, *_: object) -> bool:
        return _waited(target, source, None)

    def frameExists(self, frame: str) -> bool:
        return frame.strip("/") in _PARENTS

    def getLatestCommonTime(self, source: str, target: str) -> Any:
        """Raises ``TransformException``."""
        return _between(target, source)[2]
