"""Transforms that a program publishes and looks up: values by hand, in the axes of REP 103."""

from __future__ import annotations

import math
from typing import Any

import pytest
from rospy_stand_in import transforms
from rospy_stand_in.genpy import RosDuration, RosTime, message_class

pytest.importorskip("numpy")

LEFT = (0.0, 0.0, math.sin(math.pi / 4), math.cos(math.pi / 4))  # a quarter to the left


@pytest.fixture(autouse=True)
def empty(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(transforms, "_PARENTS", {})


def published() -> None:
    send = transforms.TransformBroadcaster().sendTransform
    send((1.0, 2.0, 3.0), LEFT, RosTime(10), "base", "/world")
    send((0.5, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0), RosTime(12), "/camera", "base")


def test_a_transform_leads_down_up_and_across() -> None:
    published()
    listener = transforms.TransformListener()
    # The camera is half a metre ahead of the base, which looks along the world's y axis.
    moved, turned = listener.lookupTransform("world", "camera", RosTime(0))
    assert moved == pytest.approx([1.0, 2.5, 3.0])
    assert turned == pytest.approx(list(LEFT))
    # Seen from the camera the world's origin is 2.5 m behind it and 1 m to its left.
    moved, turned = listener.lookupTransform("camera", "world", RosTime(0))
    assert moved == pytest.approx([-2.5, 1.0, -3.0])
    assert turned == pytest.approx([0.0, 0.0, -LEFT[2], LEFT[3]])
    transforms.TransformBroadcaster().sendTransform(
        (0.0, 1.0, 0.0), (0.0, 0.0, 0.0, 1.0), RosTime(11), "gimbal", "base"
    )
    moved, _ = listener.lookupTransform("gimbal", "camera", RosTime(0))
    assert moved == pytest.approx([0.5, -1.0, 0.0])
    assert listener.getLatestCommonTime("world", "camera") == RosTime(12)


def test_tf2_takes_and_gives_stamped_transforms() -> None:
    sent: Any = message_class("geometry_msgs/TransformStamped")()
    sent.header.frame_id, sent.child_frame_id = "map", "tag"
    sent.transform.translation.x, sent.transform.rotation.w = 4.0, 1.0
    transforms.Tf2Broadcaster().sendTransform([sent])
    buffer = transforms.Buffer()
    transforms.Tf2Listener(buffer)
    found = buffer.lookup_transform("map", "tag", RosTime(0), RosDuration(1))
    assert (found.header.frame_id, found.child_frame_id) == ("map", "tag")
    assert found.transform.translation.x == pytest.approx(4.0)
    assert buffer.can_transform("tag", "map", RosTime(0))


def test_frames_that_nothing_joins_are_named() -> None:
    published()
    with pytest.raises(transforms.TransformException, match="from moon to world"):
        transforms.TransformListener().lookupTransform("world", "moon", RosTime(0))
    wait = transforms.TransformListener().waitForTransform
    with pytest.raises(transforms.TransformException):
        wait("world", "moon", RosTime(0), RosDuration(0, 1000))
    # A circle of frames ends, too.
    transforms.TransformBroadcaster().sendTransform(
        (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0), RosTime(1), "world", "camera"
    )
    assert not transforms.TransformListener().canTransform("world", "moon")
