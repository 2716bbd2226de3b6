"""Control by rosbridge clients: whose it is, and that it ends with their sockets."""

from __future__ import annotations

import asyncio
from random import Random
from types import SimpleNamespace
from typing import Any

import anyio
import pytest

from m100link.apps.agent.background import TaskSet
from m100link.apps.agent.server.server import AgentServer
from m100link.apps.agent.transports import memory_channels
from m100link.apps.station.ros import graph
from m100link.apps.station.ros.graph import Graph
from m100link.apps.station.ros.leases import Clients
from m100link.errors import LinkError
from tests.apps.agent.conftest import pattern_of
from tests.apps.station.conftest import FakeClient, Rig

pytestmark = pytest.mark.anyio

OPEN = "/nav_open_close_request"


def holder(rig: Rig) -> str:
    lease = rig.agent.leases.holder(rig.agent.now)
    return "" if lease is None else lease.name


async def ask(client: FakeClient, action: str, **fields: Any) -> Any:
    """What the service of leases answers."""
    client.call("/m100link/lease", action=action, **fields)
    await anyio.sleep(0.1)
    return client.answers()[-1]


def renewals() -> list[str]:
    names = [task.get_name().removeprefix("m100link: ") for task in asyncio.all_tasks()]
    return [name for name in names if name.startswith("lease of")]


async def test_a_lease_lasts_as_long_as_its_socket_and_has_one_task(rig: Rig) -> None:
    before = len(rig.front.on_lease)
    client = await rig.open("page")
    await anyio.sleep(10.0)  # more than three lifetimes of a lease
    assert holder(rig) == "page"
    assert renewals() == ["lease of page"]
    client.leave()
    await anyio.sleep(0.6)
    assert holder(rig) == ""
    assert renewals() == []
    assert len(rig.front.on_lease) == before


async def test_a_client_that_leaves_at_any_moment_of_its_request_holds_nothing(rig: Rig) -> None:
    await rig.activated()
    for turns in range(16):
        client = rig.client(f"page {turns}")
        if turns % 2:
            client.publish(OPEN, data=1)
        else:
            client.call("/m100link/lease", action="acquire")
        for _ in range(turns // 2):
            await asyncio.sleep(0.0)
        client.leave()
        await anyio.sleep(0.6)
        assert holder(rig) == "", turns
        assert not rig.agent.holding.has_authority, turns
        assert renewals() == [], turns


@pytest.mark.parametrize("who", ["first", "second"])
async def test_of_two_clients_that_share_a_token_either_ends_it_for_both(
    rig: Rig, who: str
) -> None:
    clients = {"first": await rig.open("first"), "second": rig.client("second")}
    token = rig.agent.leases.holder(rig.agent.now).token  # type: ignore[union-attr]
    assert (await ask(clients["second"], "renew", token=token))["success"]
    await anyio.sleep(4.0)
    assert holder(rig) == "first"
    clients.pop(who).leave()
    await anyio.sleep(0.1)
    assert holder(rig) == ""
    assert not rig.agent.holding.has_authority
    (left,) = clients.values()
    assert any("not in force" in said for said in left.statuses())
    answer = await ask(left, "renew", token=token)
    assert not answer["success"]


async def test_a_client_taken_over_hears_by_whom_and_one_that_let_go_hears_nothing(
    rig: Rig,
) -> None:
    client, other = await rig.open("page"), rig.client("other")
    wanted = await ask(other, "take_over")
    confirmed = await ask(other, "confirm", token=wanted["token"])
    assert holder(rig) == "other"
    assert any("other has control" in said for said in client.statuses())
    assert (await ask(other, "release", token=confirmed["token"]))["success"]
    assert holder(rig) == ""
    assert other.statuses() == []


async def test_closing_ends_an_opening_that_is_under_way(rig: Rig) -> None:
    await rig.activated()
    client = rig.client("page")
    client.publish(OPEN, data=1)
    await asyncio.sleep(0.0)
    client.publish(OPEN, data=0)
    await anyio.sleep(1.0)
    assert holder(rig) == ""
    assert not rig.agent.holding.has_authority


class Crowd:
    """Three clients who say anything of control at any moment, beside an agent that dies."""

    def __init__(self, rig: Rig, seed: int) -> None:
        self.rig, self.draw = rig, Random(seed)
        self.clients = [rig.client(f"client {number}") for number in range(3)]
        self.tokens = ["none"]

    async def step(self) -> None:
        draw, number = self.draw, self.draw.randrange(3)
        client, what = self.clients[number], self.draw.randrange(9)
        if what < 4:
            action = draw.choice(["acquire", "renew", "release", "take_over", "confirm"])
            client.call("/m100link/lease", action=action, token=draw.choice(self.tokens))
        elif what < 6:
            client.publish(OPEN, data=draw.choice([1, 1, 0]))
        elif what == 6:
            client.leave()
            self.clients[number] = self.rig.client(client.session.name)
        elif what == 7:
            client.publish("/sdk_request_ctrl", x=-1.0, y=0.0, z=0.0, w=0.0)
        elif draw.random() < 0.3:
            self.reopen()
        for _ in range(draw.randrange(6)):
            await asyncio.sleep(draw.choice([0.0, 0.0, 0.0, 0.02]))
        answers = [one.get("token", "") for one in client.answers() if "success" in one]
        self.tokens = [*self.tokens, *filter(None, answers)][-6:]

    def reopen(self) -> None:
        front = self.rig.front
        front._channel.close("killed")
        front._closed("killed")
        ours, its = memory_channels(as_bytes=True)
        AgentServer(self.rig.agent).attach(its)
        front.reopen(ours)


@pytest.mark.parametrize("seed", range(3))
async def test_in_whatever_order_a_crowd_that_has_left_holds_nothing(rig: Rig, seed: int) -> None:
    await rig.activated()
    before = len(rig.front.on_lease)
    for attempt in range(3):
        crowd = Crowd(rig, 100 * seed + attempt)
        for _ in range(40):
            await crowd.step()
        for client in crowd.clients:
            client.leave()
        await anyio.sleep(1.0)
        assert holder(rig) == "", (seed, attempt)
        assert not rig.agent.holding.has_authority, (seed, attempt)
        assert renewals() == [], (seed, attempt)
        assert len(rig.front.on_lease) == before, (seed, attempt)
        again = await rig.open("again")
        again.leave()
        await anyio.sleep(1.0)


async def test_stop_waits_behind_no_other_calls_of_its_client(rig: Rig) -> None:
    rig.graph.add_service("/never", "std_srvs/Trigger", lambda call: None)
    client = await rig.airborne("page")
    for _ in range(20):
        client.call("/never")
    client.publish("/sdk_request_simple_task", data=1)
    await rig.until(lambda: pattern_of(rig.agent) is not None)
    client.call("/m100link/stop")
    await anyio.sleep(0.5)
    assert pattern_of(rig.agent) is None
    assert client.answers()[-1] == {"success": True, "message": ""}


ENDING: tuple[tuple[str, dict[str, Any]], ...] = (
    ("/m100link/stop", {}),
    ("/m100link/lease", {"action": "release", "token": ""}),
    ("/dji_sdk/sdk_control_authority", {"control_enable": 0}),
    ("/dji_sdk/sdk_permission_control", {"control_enable": 0}),
    ("/dji_sdk/drone_task_control", {"task": 6}),
    ("/dji_sdk/drone_task_control", {"task": 1}),
    ("/dji_sdk/drone_arm_control", {"arm": 0}),
    ("/dji_sdk/mission_waypoint_action", {"action": 1}),
    ("/dji_sdk/mission_waypoint_action", {"action": 2}),
    ("/dji_sdk/mission_hotpoint_action", {"action": 1}),
    ("/dji_sdk/mission_hotpoint_action", {"action": 2}),
    ("/dji_sdk/mission_pause", {"pause": 0}),
    ("/dji_sdk/mission_cancel", {}),
    ("/nav_open_close_request", {"data": 0.0}),
    ("/sdk_request_cmd", {"data": 6.0}),
    ("/sdk_request_cmd", {"data": 1.0}),
    ("/sdk_request_simple_task", {"data": -1.0}),
    ("/sdk_request_ctrl", {"x": 0.0, "y": 0.0, "z": 0.0, "w": 0.0}),
    ("/dji_sdk/drone_task_action/goal", {"goal": {"task": 2}}),
    ("/dji_sdk/drone_task_action/goal", {"goal": {"task": 3}}),
    ("/dji_sdk/drone_task_action/cancel", {}),
    ("/dji_sdk/local_position_navigation_action/cancel", {}),
    ("/dji_sdk/global_position_navigation_action/cancel", {}),
    ("/dji_sdk/waypoint_navigation_action/cancel", {}),
    ("/dji_sdk_web_groundstation/web_waypoint_receive_action/cancel", {}),
    ("/dji_sdk_web_groundstation/map_nav_srv/ctrl", {"data": False}),
    ("/dji_sdk_web_groundstation/map_nav_srv/cmd", {"cmdCode": 99, "tid": 7}),
)
"""What stops, lands or gives control back, by hand from the pages of DJI's nodes."""

MOVING: tuple[tuple[str, dict[str, Any]], ...] = (
    ("/m100link/lease", {"action": "acquire"}),
    ("/dji_sdk/sdk_control_authority", {"control_enable": 1}),
    ("/dji_sdk/drone_task_control", {"task": 4}),
    ("/dji_sdk/drone_arm_control", {"arm": 1}),
    ("/dji_sdk/mission_waypoint_action", {"action": 0}),
    ("/dji_sdk/mission_waypoint_action", {"action": 3}),
    ("/dji_sdk/mission_pause", {"pause": 1}),
    ("/nav_open_close_request", {"data": 1.0}),
    ("/sdk_request_cmd", {"data": 4.0}),
    ("/sdk_request_simple_task", {"data": -0.5}),
    ("/sdk_request_simple_task", {"data": 1.0}),
    ("/sdk_request_ctrl", {"x": 0.0, "y": 1.0, "z": 0.0, "w": 0.0}),
    ("/dji_sdk/drone_task_action/goal", {"goal": {"task": 1}}),
    ("/dji_sdk_web_groundstation/map_nav_srv/ctrl", {"data": True}),
    ("/dji_sdk_web_groundstation/map_nav_srv/cmd", {"cmdCode": 115, "tid": 7}),
)


def say(rig: Rig, client: FakeClient, name: str, message: dict[str, Any]) -> None:
    if name in rig.graph.services:
        client.call(name, **message)
    else:
        client.send("publish", topic=name, msg=message)


def flooded(rig: Rig) -> FakeClient:
    """A client that has used up all that it may: frames, calls without an answer, orders."""
    if "/never" not in rig.graph.services:
        rig.graph.add_service("/never", "std_srvs/Trigger", lambda call: None)
    client = rig.client("flood")
    for _ in range(20):
        client.call("/never")
        client.send("publish", topic="/sdk_request_cmd", msg={"data": 4.0})
    for _ in range(450):
        client.send("publish", topic="/sdk_request_ctrl", msg={"x": 1.0})
    client.read()
    client.inbox.clear()
    return client


@pytest.mark.slow
async def test_no_limit_of_frames_drops_what_ends_a_flight(rig: Rig) -> None:
    """A client that floods is heard when it stops, lands or lets go, and with nothing else."""
    for name, message in (*ENDING, *MOVING):
        client = flooded(rig)
        refused = client.session.refused
        say(rig, client, name, message)
        is_dropped = client.session.refused > refused
        assert is_dropped is ((name, message) in MOVING), (name, message)
        client.leave()


@pytest.mark.slow
async def test_no_limit_of_calls_or_orders_refuses_what_ends_a_flight(rig: Rig) -> None:
    """Without control, in which a client may order as often as it likes."""
    for name, message in (*ENDING, *MOVING):
        client = flooded(rig)
        await anyio.sleep(1.1)
        for _ in range(20):
            client.send("publish", topic="/sdk_request_cmd", msg={"data": 4.0})
        await anyio.sleep(0.1)
        client.read()
        client.inbox.clear()
        say(rig, client, name, message)
        await anyio.sleep(1.1)
        said = str(client.read())
        is_refused = any(one in said for one in ("more than", "more orders", "calls wait"))
        if (name, message) in ENDING:
            assert not is_refused, (name, message, said)
        elif name in rig.graph.services:
            assert is_refused, (name, message, said)
        client.leave()


async def test_the_table_of_what_ends_a_flight_is_whole(rig: Rig) -> None:
    """Each row is a topic or service that is there, and tells what ends from what does not."""
    ends = {name for name, _ in ENDING}
    cancels = {one.name for one in rig.graph.all_topics() if one.name.endswith("/cancel")}
    assert len(cancels) == 5
    assert set(graph.ENDING) | cancels == ends
    assert ends <= {*rig.graph.topics, *rig.graph.services}


async def test_a_client_that_floods_stops_what_it_flies(rig: Rig) -> None:
    client = await rig.airborne("page")
    client.publish("/sdk_request_simple_task", data=1)
    await rig.until(lambda: pattern_of(rig.agent) is not None)
    for _ in range(500):
        client.send("publish", topic="/sdk_request_ctrl_mode", msg={"data": 1.0})
    client.call("/m100link/stop")
    await anyio.sleep(0.5)
    assert pattern_of(rig.agent) is None


async def test_a_simple_task_of_minus_one_needs_no_control(rig: Rig) -> None:
    """DJI's page has it as its stop: the aircraft hovers for every client."""
    client = await rig.airborne("page")
    client.publish("/sdk_request_simple_task", data=1)
    await rig.until(lambda: pattern_of(rig.agent) is not None)
    rig.client("other").publish("/sdk_request_simple_task", data=-1)
    await anyio.sleep(0.5)
    assert pattern_of(rig.agent) is None
    assert any("other stopped it" in one.text for one in rig.agent.journal.events)


async def test_a_cancel_finds_its_goal_behind_any_number_of_refused_ones(rig: Rig) -> None:
    client = await rig.airborne("page")
    action = "/dji_sdk/local_position_navigation_action"
    goal = {"x": 50.0, "y": 0.0, "z": 5.0}
    client.send("publish", topic=f"{action}/goal", msg={"goal_id": {"id": "far"}, "goal": goal})
    await rig.until(lambda: rig.aircraft.vehicle.flight.dynamics.speed > 1.0)
    for name in range(3):
        stranger = rig.client(f"stranger {name}")
        for _ in range(30):
            stranger.send("publish", topic=f"{action}/goal", msg={"goal": goal})
    # A stranger's goal that was admitted has replaced it, and was refused for want of control.
    client.send("publish", topic=f"{action}/goal", msg={"goal_id": {"id": "far"}, "goal": goal})
    await rig.until(lambda: rig.aircraft.vehicle.flight.dynamics.speed > 1.0)
    for _ in range(30):
        stranger.send("publish", topic=f"{action}/goal", msg={"goal": goal})
    client.send("publish", topic=f"{action}/cancel", msg={"id": "far"})
    await anyio.sleep(3.0)
    assert rig.aircraft.vehicle.flight.dynamics.speed < 0.3


async def test_a_cancel_without_a_goal_is_answered(rig: Rig) -> None:
    client = rig.client("page")
    client.send("set_level", level="warning")
    action = "/dji_sdk/local_position_navigation_action"
    client.send("publish", topic=f"{action}/cancel", msg={"id": "none"})
    assert f"{action}: no such goal is active, nothing was cancelled" in client.statuses()


async def test_the_service_of_leases_answers_each_action_with_its_values(rig: Rig) -> None:
    await rig.activated()
    one, other = rig.client("page"), rig.client("other")
    free = await ask(one, "status")
    assert free == {"success": True, "message": "", "holder": "", "token": "", "remaining": 0.0}
    taken = await ask(one, "acquire", name="Anna")
    token = taken.pop("token")
    assert taken.pop("remaining") == 3.0
    assert taken == {"success": True, "message": "", "holder": "Anna"}
    lease = rig.agent.leases.holder(rig.agent.now)
    assert lease is not None
    assert lease.token == token
    await anyio.sleep(1.0)
    assert 1.0 < (await ask(other, "status"))["remaining"] <= 3.0
    assert (await ask(one, "renew", token=token))["remaining"] == 3.0
    held = await ask(other, "acquire")
    assert (held["success"], held["holder"]) == (False, "Anna")
    assert "Anna has control" in held["message"]
    wanted = await ask(other, "take_over")
    assert wanted["message"] == "Anna would lose control; confirm with this token"
    confirmed = await ask(other, "confirm", token=wanted["token"])
    assert (confirmed["success"], confirmed["holder"]) == (True, "other")
    assert not (await ask(one, "release", token=token))["success"]
    assert holder(rig) == "other"
    assert confirmed["remaining"] == 3.0
    released = await ask(one, "release", token=confirmed["token"])  # a token is enough
    assert (released["success"], released["remaining"], released["holder"]) == (True, 0.0, "")
    assert holder(rig) == ""
    unknown = await ask(one, "seize" * 9)
    said = f"there is no action {('seize' * 9)[:32]!r}"
    assert unknown["result"] is False
    assert unknown["values"] == f"{said}: status, acquire, renew, release, take_over, confirm"


class Agent(SimpleNamespace):
    """As much of a front's agent as limits ask for; its clock is the test's."""

    def __init__(self) -> None:
        self.noted: list[tuple[str, str]] = []
        super().__init__(now=100.0, background=TaskSet())

    def note(self, text: str, level: str = "info") -> None:
        self.noted.append((text, level))


class Talker:
    """A client that notes what it is told."""

    def __init__(self, name: str) -> None:
        self.name, self.data = name, dict[str, Any]()
        self.told: list[tuple[str, str]] = []

    def status(self, level: str, text: str) -> None:
        self.told.append((level, text))


def test_orders_of_a_client_without_control_are_two_a_second_and_ten_at_once() -> None:
    agent: Any = Agent()
    clients, client = Clients(agent, Graph()), Talker("page")
    one: Any = client
    control = SimpleNamespace(has_lease=False)
    clients.session = lambda _: control  # type: ignore[method-assign,assignment,return-value]
    assert [clients.admits(one) for _ in range(12)] == [True] * 10 + [False] * 2
    agent.now += 0.5
    assert [clients.admits(one) for _ in range(2)] == [True, False]
    assert [text for _, text in client.told] == ["more than 2 orders per second: not done"]
    control.has_lease = True
    assert all(clients.admits(one) for _ in range(100)), "a pilot may always give control back"


def test_a_client_is_told_once_a_second_and_people_once_in_ten() -> None:
    """Others' notes count, too: four at once, and one in five seconds."""
    agent: Any = Agent()
    clients, client = Clients(agent, Graph()), Talker("loud")
    loud: Any = client
    error = LinkError("no line", remedy="plug it in")
    for _ in range(42):
        clients.complain(loud, error)
        agent.now += 0.25
    assert client.told == [("error", str(error))] * 11
    said = "loud is refused: no line"
    assert agent.noted == [(said, "warning"), (f"{said} (41 times so far)", "warning")]
    agent.noted.clear()
    agent.now += 20.0
    for number in range(9):
        clients.complain(Talker(f"client {number}"), ValueError("what"))  # type: ignore[arg-type]
        agent.now += 5.0 if number == 7 else 0.0
    assert agent.noted == [
        (f"client {number} is refused: what", "warning") for number in (0, 1, 2, 3, 8)
    ]
