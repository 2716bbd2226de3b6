"""The modules ``cv_bridge`` and ``message_filters`` of a program. Images need numpy."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Sequence
from typing import Any

from rospy_stand_in import node
from rospy_stand_in.genpy import message_class

_ENCODINGS = {
    "mono8": ("u1", 1), "8UC1": ("u1", 1), "bgr8": ("u1", 3), "rgb8": ("u1", 3),
    "8UC3": ("u1", 3), "bgra8": ("u1", 4), "rgba8": ("u1", 4), "mono16": ("u2", 1),
    "16UC1": ("u2", 1), "32FC1": ("f4", 1),
}  # fmt: skip
_SWAPPED = {("bgr8", "rgb8"), ("rgb8", "bgr8")}


class CvBridgeError(TypeError):
    """An image is of an encoding that is not converted here."""


class CvBridge:
    """Images of ROS as arrays, and back."""

    def imgmsg_to_cv2(self, message: Any, desired_encoding: str = "passthrough") -> Any:
        """Raises ``CvBridgeError``: no such conversion."""
        import numpy

        kind, channels = _encoding(message.encoding)
        flat = numpy.frombuffer(message.data, dtype=kind).reshape(message.height, -1)
        image = flat[:, : message.width * channels]
        shape = (message.height, message.width, channels)[: 2 + (channels > 1)]
        image = image.reshape(shape)
        if desired_encoding in ("passthrough", "", message.encoding):
            return image
        if (message.encoding, desired_encoding) in _SWAPPED:
            return image[:, :, ::-1]
        if channels == 3 and desired_encoding in ("mono8", "8UC1"):
            red, blue = (0, 2) if message.encoding == "rgb8" else (2, 0)
            weighed = 0.299 * image[..., red] + 0.587 * image[..., 1] + 0.114 * image[..., blue]
            return weighed.astype("u1")
        if channels == 1 and desired_encoding in ("bgr8", "rgb8"):
            return numpy.repeat(image[:, :, None], 3, axis=2)
        raise CvBridgeError(f"{message.encoding} is not converted to {desired_encoding} here")

    def cv2_to_imgmsg(self, image: Any, encoding: str = "passthrough", header: Any = None) -> Any:
        """Raises ``CvBridgeError``: no such encoding."""
        channels = 1 if image.ndim == 2 else image.shape[2]
        if encoding == "passthrough":
            letter = {"u": "U", "f": "F"}[image.dtype.kind]
            encoding = f"{8 * image.dtype.itemsize}{letter}C{channels}"
        if _encoding(encoding)[1] != channels:
            raise CvBridgeError(f"{encoding} does not have {channels} channels")
        made: Any = message_class("sensor_msgs/Image")()
        made.height, made.width = image.shape[:2]
        made.encoding = encoding
        made.step, made.data = image.nbytes // image.shape[0], image.tobytes()
        made.header = header or made.header
        return made


def _encoding(name: str) -> tuple[str, int]:
    if name not in _ENCODINGS:
        raise CvBridgeError(f"the encoding {name} is not converted here")
    return _ENCODINGS[name]


# -- message_filters -------------------------------------------------------------------------------


class SimpleFilter:
    """Passes messages on to callbacks."""

    def __init__(self) -> None:
        self._callbacks: list[tuple[Callable[..., Any], tuple[Any, ...]]] = []

    def registerCallback(self, callback: Callable[..., Any], *extra: Any) -> int:
        self._callbacks.append((callback, extra))
        return len(self._callbacks)

    def signalMessage(self, *messages: Any) -> None:
        for callback, extra in self._callbacks:
            callback(*messages, *extra)


class Subscriber(SimpleFilter):
    """A topic."""

    def __init__(self, name: str, data_class: Any, queue_size: int | None = None, **_: Any) -> None:
        super().__init__()
        self.topic, self.sub = name, node.Subscriber(name, data_class, self.signalMessage)

    def unregister(self) -> None:
        self.sub.unregister()


class ApproximateTimeSynchronizer(SimpleFilter):
    """Passes on one message of each filter where all are within ``slop`` seconds."""

    def __init__(
        self,
        fs: Sequence[SimpleFilter],
        queue_size: int,
        slop: float,
        allow_headerless: bool = False,
        reset: bool = False,
    ) -> None:
        super().__init__()
        self._slop, self._allows, self._lock = slop, allow_headerless, threading.Lock()
        self._waiting: list[deque[tuple[float, Any]]] = [deque(maxlen=queue_size) for _ in fs]
        for number, one in enumerate(fs):
            one.registerCallback(self._take, number)

    def _take(self, message: Any, number: int) -> None:
        has_header = hasattr(message, "header")
        if not has_header and not self._allows:
            node.logwarn("message_filters: a message without a header is dropped")
            return
        at = message.header.stamp.to_sec() if has_header else node.get_time()
        with self._lock:
            self._waiting[number].append((at, message))
            if not all(self._waiting):
                return
            nearest = [min(queue, key=lambda one: abs(one[0] - at)) for queue in self._waiting]
            if max(one[0] for one in nearest) - min(one[0] for one in nearest) > self._slop:
                return
            for queue, (limit, _) in zip(self._waiting, nearest, strict=True):
                while queue and queue[0][0] <= limit:
                    queue.popleft()
        self.signalMessage(*(one[1] for one in nearest))


class TimeSynchronizer(ApproximateTimeSynchronizer):
    """Passes on messages of the same stamp."""

    def __init__(self, fs: Sequence[SimpleFilter], queue_size: int, reset: bool = False) -> None:
        super().__init__(fs, queue_size, 1e-9)


class Cache(SimpleFilter):
    """Keeps the newest messages of a filter."""

    def __init__(
        self, f: SimpleFilter, cache_size: int = 1, allow_headerless: bool = False
    ) -> None:
        super().__init__()
        self._kept: deque[Any] = deque(maxlen=cache_size)
        f.registerCallback(self._take)

    def _take(self, message: Any) -> None:
        self._kept.append(message)
        self.signalMessage(message)

    def getLast(self) -> Any:
        return self._kept[-1] if self._kept else None
