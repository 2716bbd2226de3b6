"""Keys and tokens to the letter, as rmw_zenoh's design document and its source have them."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from m100link.apps.bus.network import DEPTH, TokenChange
from m100link.apps.ros2.graph import (
    Attachment,
    EntityKind,
    GraphDiscovery,
    Names,
    NodeName,
    Qos,
    Seen,
    data_key,
    read_attachment,
    read_token,
    write_attachment,
)
from m100link.apps.station.config import Settings
from m100link.apps.station.ros2 import check_ros2
from m100link.errors import UsageError
from tests.apps.bus.memory import MemoryInbox

IMU = "RIHS01_7d9a00ff131080897a5ec7e26e315954b8eae3353c3f995c55faf71574000b5b"
TRIGGER = "RIHS01_eeff2cd6fa5ad9d27cdf4dec64818317839b62f212a91e6b5304b634b2062c5f"
NODE = NodeName(2, "aac3178e146ba6f1fc6e6a4085e77f21", "/", "m100")


def test_keys() -> None:
    key = data_key(0, "/m100/imu", "sensor_msgs/Imu")
    assert key == f"0/m100/imu/sensor_msgs::msg::dds_::Imu_/{IMU}"
    key = data_key(42, "/m100/takeoff", "std_srvs/srv/Trigger")
    assert key == f"42/m100/takeoff/std_srvs::srv::dds_::Trigger_/{TRIGGER}"


def test_tokens() -> None:
    session = NODE.session
    assert NODE.token == f"@ros2_lv/2/{session}/0/0/NN/%/%/m100"
    found = NODE.token_of(
        10, EntityKind.PUBLISHER, "/m100/imu", "sensor_msgs/Imu", Qos(is_reliable=False)
    )
    about = f"%m100%imu/sensor_msgs::msg::dds_::Imu_/{IMU}/2::,10:,:,:,,"
    assert found == f"@ros2_lv/2/{session}/0/10/MP/%/%/m100/{about}"
    inner = NodeName(2, session, "/drones/first", "a1", 3)
    assert inner.token == f"@ros2_lv/2/{session}/3/3/NN/%/%drones%first/a1"
    assert inner.full == "/drones/first/a1"


@pytest.mark.parametrize(
    ("qos", "text"),
    [
        (Qos(), "::,10:,:,:,,"),
        (Qos(is_reliable=False), "2::,10:,:,:,,"),
        (Qos(is_latched=True, depth=1), ":1:,1:,:,:,,"),
    ],
)
def test_qualities(qos: Qos, text: str) -> None:
    assert str(qos) == text


def test_tokens_are_read() -> None:
    assert read_token(NODE.token) == Seen((NODE.session, "0"), "/m100", EntityKind.NODE, "")
    other = "@ros2_lv/0/aac3/0/10/SC/%/%fleet/cli/%m100%land/std_srvs::srv::dds_::Trigger_/X/::,:"
    found = read_token(other + ",:,:,,")
    assert found == Seen(("aac3", "0"), "/fleet/cli", EntityKind.CLIENT, "/m100/land")


@given(st.text("@ros2_lvNMPSC/%", max_size=60))
def test_other_tokens_are_not_ours(key: str) -> None:
    read_token(key)
    assert read_token(f"@ros2_lv/0/1/2/3/XX/{key}") is None


def test_attachments() -> None:
    ours = Attachment(7, 8, bytes(range(16)))
    data = write_attachment(7, 8, bytes(range(16)))
    assert data == b"\7" + bytes(7) + b"\x08" + bytes(7) + b"\x10" + bytes(range(16))
    assert read_attachment(data) == ours
    for bad in (b"", data[:-1], data[:16], data.replace(b"\x10", b"\x0f")):
        with pytest.raises(ValueError, match="attachment"):
            read_attachment(bad)


def test_names_are_private_relative_or_full() -> None:
    names = Names.of("drones/first/", "a1", ("~/imu:=/imu", "tf:=~/tf"))
    assert names.namespace == "/drones/first"
    assert names.full("~/odom") == "/drones/first/a1/odom"
    assert names.full("/tf") == "/tf"
    assert names.full("~/imu") == "/imu"
    assert names.full("tf") == "/drones/first/a1/tf"
    assert names.frame("odom") == "drones/first/odom"
    assert Names.of("/", "m100").frame("odom") == "odom"


@pytest.mark.parametrize(
    ("namespace", "node", "remap", "seen"),
    [
        ("/", "m 100", (), "'m 100' cannot be part of a name in ROS"),
        ("/", "", (), "'' cannot be part of a name in ROS"),
        ("/1st", "m100", (), "'1st' cannot be part of a name in ROS"),
        ("/", "m100", ("~/imu",), "'~/imu' is not a rule"),
        ("/", "m100", ("~/imu:=",), "'~/imu:=' is not a rule"),
        ("/", "m100", ("~/imu:=/a b",), "'/a b' cannot be a name in ROS"),
    ],
)
def test_names_that_cannot_be(namespace: str, node: str, remap: tuple[str, ...], seen: str) -> None:
    with pytest.raises(UsageError) as refusal:
        Names.of(namespace, node, remap)
    assert refusal.value.seen == seen


# -- the names of whole stations ------------------------------------------------------------------


@pytest.mark.parametrize(
    ("rules", "aircraft", "seen"),
    [
        (("~/takeoff:=/x", "~/land:=/x"), [""], "~/takeoff and ~/land would both be /x"),
        (("~/take_off:=/m100/land",), [""], "~/land and ~/take_off would both be /m100/land"),
        (("~/cmd_vel:=/v",), ["a", "b"], "~/cmd_vel of a and ~/cmd_vel of b would both be /v"),
    ],
)
def test_nothing_that_moves_an_aircraft_has_the_name_of_something_else(
    rules: tuple[str, ...], aircraft: list[str], seen: str
) -> None:
    settings = Settings(ros2=True, ros2_remap=rules)
    with pytest.raises(UsageError) as refusal:
        check_ros2(settings, aircraft)
    assert refusal.value.seen == seen


def test_topics_may_come_together() -> None:
    check_ros2(Settings(ros2=True, ros2_remap=("~/imu:=/imu", "~/odom:=/imu")), ["a", "b"])


def test_a_middleware_is_one_of_two_and_dds_needs_rclpy(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(UsageError, match="no middleware 'cyclone'") as refusal:
        check_ros2(Settings(ros2=True, ros2_rmw="cyclone"))
    assert "zenoh or dds" in refusal.value.remedy
    monkeypatch.setattr("m100link.apps.station.ros2.find_spec", lambda _: None)
    with pytest.raises(UsageError, match="needs rclpy") as refusal:
        check_ros2(Settings(ros2=True, ros2_rmw="dds"))
    assert "pip install 'ros-jazzy-rclpy[fastrtps]'" in refusal.value.remedy
    monkeypatch.setattr("m100link.apps.station.ros2.find_spec", lambda _: "there")
    check_ros2(Settings(ros2=True, ros2_rmw="dds"))


# -- tokens that come and go -----------------------------------------------------------------------


TOPIC = "/m100/land"


def token(session: str, end: EntityKind = EntityKind.CLIENT, topic: str = TOPIC) -> str:
    node = NodeName(0, session, "/", f"node_{session}")
    return node.token_of(1, end, topic, "std_srvs/srv/Trigger", Qos())


def test_those_who_can_call_are_known_until_one_is_gone() -> None:
    inbox = MemoryInbox[TokenChange](99)
    presence = GraphDiscovery(lambda: inbox)
    others = (token("c", EntityKind.SERVER), token("d", topic="/other"), "@ros2_lv/junk")
    for key in (token("a"), token("b"), *others):
        inbox.waiting.append(TokenChange(key, True))
    presence.look()
    clients = presence.clients(TOPIC)
    assert set(clients) == {token("a"), token("b")}
    assert {one.node_name for one in clients.values()} == {"/node_a", "/node_b"}
    assert not presence.missing(clients)
    inbox.waiting.append(TokenChange(token("b"), False))
    presence.look()
    assert presence.missing(clients)
    assert set(presence.clients(TOPIC)) == {token("a")}


def test_a_node_that_went_and_is_back_within_a_step_was_gone() -> None:
    inbox = MemoryInbox[TokenChange](99)
    presence = GraphDiscovery(lambda: inbox)
    inbox.waiting.append(TokenChange(token("a"), True))
    presence.look()
    clients = presence.clients(TOPIC)
    inbox.waiting.append(TokenChange(token("a"), True))  # the router tells it, too
    presence.look()
    assert not presence.missing(clients)
    inbox.waiting.extend(TokenChange(token("a"), is_there) for is_there in (False, True))
    presence.look()
    assert presence.missing(clients)


def test_a_flood_of_tokens_is_not_kept() -> None:
    inbox = MemoryInbox[TokenChange](DEPTH)
    presence = GraphDiscovery(lambda: inbox)
    for number in range(10 * DEPTH):
        inbox.waiting.append(TokenChange(token(str(number)), True))
        if number % 1000 == 0:
            presence.look()
    assert len(presence.clients(TOPIC)) <= 4 * DEPTH


def test_of_a_flood_some_is_lost_and_then_all_count_as_gone() -> None:
    inboxes = [MemoryInbox[TokenChange](DEPTH), MemoryInbox[TokenChange](DEPTH)]
    waiting = iter(inboxes)
    presence = GraphDiscovery(lambda: next(waiting))
    inboxes[0].waiting.append(TokenChange(token("a"), True))
    presence.look()
    clients = presence.clients(TOPIC)
    for number in range(2 * DEPTH):
        inboxes[0].waiting.append(TokenChange(token(str(number)), True))
    presence.look()
    assert presence.missing(clients)
    inboxes[1].waiting.append(TokenChange(token("a"), True))  # sent once more
    presence.look()
    assert presence.clients(TOPIC) == clients
