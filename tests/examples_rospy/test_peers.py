"""Programs on one station have topics, services and parameters of their own between them."""

from __future__ import annotations

import asyncio
import socket
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from rospy_stand_in import peers
from rospy_stand_in.peers import Peers, shared_parameters, sharing

from m100link.errors import LinkError, LinkLost
from tests.examples_rospy.conftest import programs
from tests.waiting import PATIENCE

STATION = "ws://station.example:1"


@pytest.fixture(autouse=True)
def folder(monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    with tempfile.TemporaryDirectory(dir="/tmp") as short:  # a socket's path is
        monkeypatch.setattr(tempfile, "tempdir", short)
        yield Path(short)


def test_where_the_path_is_too_long_a_program_is_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / ("long" * 20)))
    (tmp_path / ("long" * 20)).mkdir()
    alone = Peers(STATION, lambda *_: None)
    alone.hear("/a")
    assert not alone.listeners("/a")
    alone.close()


@pytest.fixture
def pair() -> Iterator[tuple[Peers, Peers, list[Any]]]:
    heard: list[Any] = []
    one = Peers(STATION, lambda *_: None)
    other = Peers(f"{STATION}/", lambda topic, message: heard.append((topic, message)))
    yield one, other, heard
    one.close()
    other.close()


def _soon(what: Callable[[], object]) -> None:
    ends_at = time.monotonic() + PATIENCE
    while not what():
        assert time.monotonic() < ends_at
        time.sleep(0.01)


def test_a_topic_reaches_who_hears_it_and_in_turn(pair: tuple[Peers, Peers, list[Any]]) -> None:
    one, other, heard = pair
    other.hear("/a")
    _soon(lambda: one.listeners("/a"))
    for number in range(20):
        one.publish("/a", {"data": number}, latch=False)
        one.publish("/b", {"data": number}, latch=False)
    _soon(lambda: len(heard) == 20)
    assert heard == [("/a", {"data": number}) for number in range(20)]


def test_who_comes_later_gets_what_was_latched(pair: tuple[Peers, Peers, list[Any]]) -> None:
    one, other, heard = pair
    one.publish("/a", {"data": 1}, latch=True)
    one.publish("/a", {"data": 2}, latch=True)
    other.hear("/a")
    _soon(lambda: heard)
    assert heard == [("/a", {"data": 2})]


def test_a_service_answers_refuses_and_goes(pair: tuple[Peers, Peers, list[Any]]) -> None:
    one, other, _ = pair

    def half(request: dict[str, Any]) -> dict[str, Any]:
        return {"half": 6 // request["of"]}

    one.offer("/half", half)
    _soon(lambda: other.offers("/half"))
    assert other.call("/half", {"of": 2}) == {"half": 3}
    with pytest.raises(LinkError, match="by zero"):
        other.call("/half", {"of": 0})
    one.close()
    with pytest.raises(LinkLost, match="/half has gone"):
        other.call("/half", {"of": 2})


def test_what_a_killed_program_left_behind_is_removed(
    pair: tuple[Peers, Peers, list[Any]], folder: Path
) -> None:
    one, other, _ = pair
    other.hear("/a")
    one._server.shutdown(socket.SHUT_RDWR)  # as if killed: its files stay
    _soon(lambda: one._server.fileno() < 0)
    _soon(lambda: other._others())
    other._send(other._others(), {"topic": "/b", "msg": {}})
    assert len(list(folder.rglob("*.card"))) == 1


JUNK = (
    *(b"", b"5\n", b"[]\n", b"{}\n", b"\xff{\n", b'"topic'),
    *(b'{"topic": "/a"}\n', b'{"service": []}\n'),
)


def test_junk_at_a_socket_costs_no_message(
    pair: tuple[Peers, Peers, list[Any]], folder: Path
) -> None:
    one, other, heard = pair
    other.hear("/a")
    _soon(lambda: one.listeners("/a"))
    for path in [place for place in folder.rglob("*") if place.is_socket()]:
        for junk in JUNK:
            with socket.socket(socket.AF_UNIX) as stranger:
                stranger.connect(str(path))
                stranger.sendall(junk)
    one.publish("/a", {"data": 1}, latch=False)
    _soon(lambda: heard)
    assert heard == [("/a", {"data": 1})]


@pytest.mark.parametrize("content", [None, "", "5", "{"])
def test_a_card_that_cannot_be_read_hides_no_other(
    pair: tuple[Peers, Peers, list[Any]], folder: Path, content: str | None
) -> None:
    one, other, _ = pair
    card = next(folder.rglob("*.card")).with_name("gone.card")
    if content is None:
        card.symlink_to(card.with_name("nowhere"))  # as one that is removed between two steps
    else:
        card.write_text(content, encoding="utf-8")
    other.hear("/a")
    _soon(lambda: one.listeners("/a") == 1)


def test_a_folder_of_another_user_is_not_used(folder: Path) -> None:
    inside = peers.folder_of(STATION)
    assert inside is not None
    inside.chmod(0o777)
    assert peers.folder_of(STATION) is None
    alone = Peers(STATION, lambda *_: None)
    alone.hear("/a")
    alone.publish("/a", {}, latch=True)
    alone.close()


def test_parameters_of_a_launch_file_are_those_of_programs_beside_it(folder: Path) -> None:
    with sharing(STATION, {"/rate": 5}):
        assert shared_parameters(STATION) == {"/rate": 5}
        assert shared_parameters("ws://other:1") == {}
    assert shared_parameters(STATION) == {}


OFFERS = """
    import rospy
    import tf2_ros
    from geometry_msgs.msg import TransformStamped
    from std_msgs.msg import String
    from std_srvs.srv import SetBool, SetBoolResponse
    rospy.init_node("one")
    rospy.Publisher("plan", String, latch=True).publish("north")
    fixed = TransformStamped()
    fixed.header.frame_id, fixed.child_frame_id = "base", "camera"
    fixed.transform.translation.x = fixed.transform.rotation.w = 1
    tf2_ros.StaticTransformBroadcaster().sendTransform(fixed)
    rospy.Service("go", SetBool, lambda request: SetBoolResponse(request.data, "gone"))
    rospy.Subscriber("end", String, lambda m: rospy.signal_shutdown(m.data))
    print("offers", flush=True)
    rospy.spin()
"""
USES = """
    import rospy
    import tf
    from std_msgs.msg import String
    from std_srvs.srv import SetBool
    rospy.init_node("other")
    print(rospy.wait_for_message("/plan", String).data)
    rospy.wait_for_service("go")
    answer = rospy.ServiceProxy("go", SetBool)(True)
    print(answer.success, answer.message)
    listener = tf.TransformListener()
    listener.waitForTransform("base", "camera", rospy.Time(0), rospy.Duration(30))
    print(listener.lookupTransform("base", "camera", rospy.Time(0))[0])
    end = rospy.Publisher("end", String)
    while not end.get_num_connections():
        rospy.sleep(0.05)
    end.publish("enough")
"""


@pytest.mark.anyio
@pytest.mark.slow
async def test_two_programs_talk_to_each_other(tmp_path: Path) -> None:
    async with programs(tmp_path) as here:
        one = await here.begin(OFFERS)
        assert one.stdout is not None
        async with asyncio.timeout(PATIENCE):
            async for line in one.stdout:
                if line == b"offers\n":
                    break
        said = await here.run(USES)
        async with asyncio.timeout(PATIENCE):
            assert await one.wait() == 0
    assert [line for line in said if "[INFO]" not in line] == [
        "north",
        "True gone",
        "[1.0, 0.0, 0.0]",
    ]
