"""Following on the wire."""

from __future__ import annotations

import pytest

from m100link.errors import BadValue
from m100link.protocol import PROFILES
from m100link.protocol.commands.follow import FollowStart, FollowTarget

FIRMWARE = PROFILES["3.1"]


def test_the_target_of_the_start_is_that_of_the_updates() -> None:
    start = FollowStart(0.9, 0.1, altitude=30).value(FIRMWARE)
    target = FollowTarget(0.9, 0.1, altitude=30).value(FIRMWARE)
    assert (len(start), len(target)) == (23, 20)
    assert start[2:22] == target


def test_one_turns_the_nose_to_the_target() -> None:
    """DJI's header has it the other way round; its documents and the phone's library agree."""
    assert FollowStart(0.9, 0.1).yaw_mode == 1
    assert FollowStart(0.9, 0.1, yaw_mode=1).fields()["yaw_mode"] == "to_target"
    assert FollowStart(0.9, 0.1, yaw_mode=0).fields()["yaw_mode"] == "by_rc"


@pytest.mark.parametrize(
    ("command", "field"),
    [
        (FollowTarget(0.9, 0.1, altitude=-1), "altitude"),
        (FollowTarget(0.9, 0.1, altitude=65536), "altitude"),
        (FollowTarget(0.9, 0.1, angle=1), "angle"),
        (FollowTarget(1.6, 0.1), "latitude"),
        (FollowStart(0.9, 0.1, mode=1), "mode"),
    ],
)
def test_what_a_target_is_not_is_refused(command: FollowTarget | FollowStart, field: str) -> None:
    with pytest.raises(BadValue) as caught:
        command.encode(FIRMWARE)
    assert caught.value.field == field
