"""``cv_bridge`` and ``message_filters``: values by hand."""

from __future__ import annotations

from typing import Any

import pytest
from rospy_stand_in import images
from rospy_stand_in.genpy import RosTime, message_class

numpy = pytest.importorskip("numpy")


def picture(encoding: str, data: bytes, step: int, width: int = 2) -> Any:
    made: Any = message_class("sensor_msgs/Image")()
    made.height, made.width, made.encoding, made.step, made.data = 1, width, encoding, step, data
    return made


def test_an_image_becomes_an_array_in_the_order_that_was_asked_for() -> None:
    bridge = images.CvBridge()
    message = picture("rgb8", bytes([1, 2, 3, 4, 5, 6, 99, 99]), 8)  # two bytes fill the row
    assert bridge.imgmsg_to_cv2(message).tolist() == [[[1, 2, 3], [4, 5, 6]]]
    assert bridge.imgmsg_to_cv2(message, "bgr8").tolist() == [[[3, 2, 1], [6, 5, 4]]]
    grey = bridge.imgmsg_to_cv2(picture("bgr8", bytes([0, 0, 200, 0, 100, 0]), 6), "mono8")
    assert grey.tolist() == [[59, 58]]  # 0.299 of red, 0.587 of green
    depth = picture("16UC1", bytes([1, 2, 0, 1]), 4)
    assert bridge.imgmsg_to_cv2(depth).tolist() == [[0x0201, 0x0100]]


def test_an_array_becomes_an_image_and_back() -> None:
    bridge = images.CvBridge()
    image = numpy.arange(12, dtype="u1").reshape(2, 2, 3)
    message = bridge.cv2_to_imgmsg(image, "bgr8")
    assert (message.height, message.width, message.step) == (2, 2, 6)
    assert bridge.imgmsg_to_cv2(message).tolist() == image.tolist()
    assert bridge.cv2_to_imgmsg(image).encoding == "8UC3"
    with pytest.raises(images.CvBridgeError, match="yuv422"):
        bridge.imgmsg_to_cv2(picture("yuv422", b"", 0))
    with pytest.raises(images.CvBridgeError, match="3 channels"):
        bridge.cv2_to_imgmsg(image, "mono8")


def stamped(seconds: float) -> Any:
    made: Any = message_class("geometry_msgs/PointStamped")()
    made.header.stamp = RosTime.from_sec(seconds)
    return made


@pytest.mark.parametrize(("slop", "pairs"), [(0.1, [(1.0, 1.05)]), (0.01, [])])
def test_messages_of_about_one_time_go_on_together(slop: float, pairs: list[Any]) -> None:
    first, second = images.SimpleFilter(), images.SimpleFilter()
    heard: list[tuple[float, float]] = []
    both = images.ApproximateTimeSynchronizer([first, second], 10, slop)
    both.registerCallback(
        lambda a, b: heard.append((a.header.stamp.to_sec(), b.header.stamp.to_sec()))
    )
    first.signalMessage(stamped(0.5))
    first.signalMessage(stamped(1.0))
    second.signalMessage(stamped(1.05))
    assert heard == [pytest.approx(one) for one in pairs]


def test_messages_of_the_same_time_alone_go_on_together() -> None:
    first, second = images.SimpleFilter(), images.SimpleFilter()
    heard: list[Any] = []
    images.TimeSynchronizer([first, second], 10).registerCallback(lambda *both: heard.append(both))
    first.signalMessage(stamped(1.0))
    second.signalMessage(stamped(1.001))
    assert heard == []
    second.signalMessage(stamped(1.0))
    assert len(heard) == 1
    newest = images.Cache(first, 2)
    first.signalMessage(message := stamped(3.0))
    assert newest.getLast() is message
