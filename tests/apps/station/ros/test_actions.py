"""Navigation as actionlib has it over rosbridge: five topics, and however it ends, a hover."""

from __future__ import annotations

import math
from typing import Any

import anyio
import pytest

from m100link.apps.station.ros.actions import _seconds
from tests.apps.agent.conftest import task_of
from tests.apps.station.conftest import FakeClient, Rig

pytestmark = pytest.mark.anyio

PREEMPTED, SUCCEEDED, ABORTED, REJECTED = 2, 3, 4, 5  # of actionlib_msgs/GoalStatus
LOCAL = "/dji_sdk/local_position_navigation_action"
GLOBAL = "/dji_sdk/global_position_navigation_action"
WAYPOINTS = "/dji_sdk/waypoint_navigation_action"
TASK = "/dji_sdk/drone_task_action"
PAGE = "/dji_sdk_web_groundstation"
WEB = f"{PAGE}/web_waypoint_receive_action"
LATITUDE, LONGITUDE = 22.5431, 113.9589  # where the virtual aircraft stands
METRE_NORTH = math.degrees(1 / 6_378_137.0)
METRE_EAST = METRE_NORTH / math.cos(math.radians(LATITUDE))


def listen(client: FakeClient, action: str) -> None:
    client.subscribe(f"{action}/status", f"{action}/feedback", f"{action}/result")


def send(client: FakeClient, action: str, name: str, **goal: Any) -> None:
    client.send("publish", topic=f"{action}/goal", msg={"goal_id": {"id": name}, "goal": goal})


def of(client: FakeClient, action: str, part: str) -> list[Any]:
    return [one["msg"] for one in client.read() if one.get("topic") == f"{action}/{part}"]


def results(client: FakeClient, action: str) -> list[tuple[str, int, bool]]:
    return [
        (one["status"]["goal_id"]["id"], one["status"]["status"], one["result"]["result"])
        for one in of(client, action, "result")
    ]


async def flying(rig: Rig, action: str) -> FakeClient:
    client = await rig.airborne()
    listen(client, action)
    return client


async def at_rest(rig: Rig) -> None:
    """Its place changes by less than 5 cm in half a second."""
    with anyio.fail_after(10.0):
        before = (math.inf, math.inf)
        while math.dist(before, rig.aircraft.position) > 0.05:
            before = rig.aircraft.position
            await anyio.sleep(0.5)


async def test_a_local_goal_is_flown_and_reported(rig: Rig) -> None:
    client = await flying(rig, LOCAL)
    send(client, LOCAL, "there", x=6.0, y=-4.0, z=5.0)
    await rig.until(lambda: bool(results(client, LOCAL)))
    assert results(client, LOCAL) == [("there", SUCCEEDED, True)]
    assert rig.aircraft.position == pytest.approx((6.0, -4.0), abs=0.6)
    assert rig.aircraft.height == pytest.approx(5.0, abs=0.4)
    feedback = [one["feedback"] for one in of(client, LOCAL, "feedback")]
    x = [one["x_progress"] for one in feedback]
    assert x == sorted(x)
    assert x[0] < 20
    assert feedback[-1] == {"x_progress": 100, "y_progress": 100, "z_progress": 100}
    states = [one["status_list"] for one in of(client, LOCAL, "status")]
    assert {one["status"] for some in states for one in some} >= {1, SUCCEEDED}
    await anyio.sleep(3.0)
    [last] = of(client, LOCAL, "status")[-1]["status_list"]
    assert last["status"] == SUCCEEDED
    await anyio.sleep(3.0)
    client.read().clear()
    await anyio.sleep(0.3)
    assert [one["status_list"] for one in of(client, LOCAL, "status")][-1] == []  # after 5 s


@pytest.mark.parametrize("is_stopped", [False, True])
async def test_a_goal_during_take_off_is_flown_after_it_unless_a_stop_comes(
    rig: Rig, is_stopped: bool
) -> None:
    """DJI's node sends its setpoints at once, and the aircraft ignores them until it hovers."""
    client = await rig.open()
    listen(client, LOCAL)
    client.call("/dji_sdk/drone_task_control", task=4)
    await rig.until(lambda: task_of(rig.agent) is not None)
    send(client, LOCAL, "there", x=3.0, y=0.0, z=4.0)
    await anyio.sleep(0.3)
    if is_stopped:
        client.call("/m100link/stop")
    await rig.until(lambda: bool(results(client, LOCAL)))
    assert results(client, LOCAL) == [("there", *((4, False) if is_stopped else (3, True)))]
    assert rig.aircraft.position[0] == pytest.approx(0.0 if is_stopped else 3.0, abs=0.6)


async def test_a_global_goal_is_flown_to_its_place_and_height(rig: Rig) -> None:
    client = await flying(rig, GLOBAL)
    place = {"latitude": LATITUDE + 8 * METRE_NORTH, "longitude": LONGITUDE + 3 * METRE_EAST}
    send(client, GLOBAL, "there", **place, altitude=4.0)
    await rig.until(lambda: bool(results(client, GLOBAL)))
    assert results(client, GLOBAL) == [("there", SUCCEEDED, True)]
    assert rig.aircraft.position == pytest.approx((8.0, 3.0), abs=0.6)
    assert rig.aircraft.height == pytest.approx(4.0, abs=0.4)


def waypoints(*places: tuple[float, float, float, int, int]) -> dict[str, Any]:
    return {
        "waypoint_list": [
            {
                "latitude": LATITUDE + north * METRE_NORTH,
                "longitude": LONGITUDE + east * METRE_EAST,
                "altitude": height,
                "heading": heading,
                "staytime": stay,
            }
            for north, east, height, heading, stay in places
        ]
    }


async def test_waypoints_are_flown_in_order_with_their_headings_and_stays(rig: Rig) -> None:
    client = await flying(rig, WAYPOINTS)
    there = waypoints((4.0, 0.0, 3.0, 90, 3), (4.0, 5.0, 4.0, -90, 0))
    send(client, WAYPOINTS, "round", waypoint_list=there)
    await rig.until(lambda: bool(results(client, WAYPOINTS)))
    assert results(client, WAYPOINTS) == [("round", SUCCEEDED, True)]
    assert rig.aircraft.position == pytest.approx((4.0, 5.0), abs=0.6)
    heading = math.degrees(rig.aircraft.vehicle.flight.dynamics.yaw)
    assert math.remainder(heading + 90.0, 360.0) == pytest.approx(0.0, abs=6.0)
    indices = [one["feedback"]["index_progress"] for one in of(client, WAYPOINTS, "feedback")]
    assert indices == sorted(indices)
    assert set(indices) == {0, 1}


async def cancel(client: FakeClient, action: str) -> None:
    client.send("publish", topic=f"{action}/cancel", msg={})


async def replace(client: FakeClient, action: str) -> None:
    send(client, action, "elsewhere", x=0.0, y=0.0, z=500.0)  # higher than the guards allow


async def leave(client: FakeClient, action: str) -> None:
    client.leave()


@pytest.mark.parametrize("end", [cancel, replace, leave])
async def test_however_a_flight_ends_the_aircraft_hovers(rig: Rig, end: Any) -> None:
    client = await flying(rig, LOCAL)
    watcher = rig.client("watcher")
    listen(watcher, LOCAL)
    send(client, LOCAL, "far", x=60.0, y=0.0, z=5.0)
    await rig.until(lambda: rig.aircraft.position[0] > 5.0)
    await end(client, LOCAL)
    ended_at = rig.agent.now
    await at_rest(rig)
    assert rig.agent.now - ended_at < 6.0
    north = rig.aircraft.position[0]
    await anyio.sleep(3.0)
    assert rig.aircraft.position[0] == pytest.approx(north, abs=0.5)
    assert results(watcher, LOCAL)[0] == ("far", PREEMPTED, False)
    if end is replace:
        assert results(watcher, LOCAL)[1] == ("elsewhere", ABORTED, False)


async def test_a_newer_goal_is_flown_behind_the_hover_of_the_one_before(rig: Rig) -> None:
    client = await flying(rig, LOCAL)
    send(client, LOCAL, "far", x=60.0, y=0.0, z=5.0)
    await rig.until(lambda: rig.aircraft.position[0] > 5.0)
    send(client, LOCAL, "back", x=2.0, y=0.0, z=5.0)
    await rig.until(lambda: len(results(client, LOCAL)) == 2)
    assert results(client, LOCAL) == [("far", PREEMPTED, False), ("back", SUCCEEDED, True)]
    assert rig.aircraft.position == pytest.approx((2.0, 0.0), abs=0.6)


async def test_behind_a_stop_no_goal_of_before_goes_on_and_a_new_one_flies_anew(rig: Rig) -> None:
    client = await flying(rig, WAYPOINTS)
    stays = waypoints((2.0, 0.0, 3.0, 0, 10), (9.0, 0.0, 3.0, 0, 0))
    send(client, WAYPOINTS, "stays", waypoint_list=stays)
    await rig.until(lambda: rig.aircraft.position[0] > 1.5)
    await anyio.sleep(2.0)  # it waits at the first one, between two orders
    watcher = rig.client("watcher")
    watcher.call("/m100link/stop")
    await rig.until(lambda: bool(watcher.answers()))
    listen(client, LOCAL)
    send(client, LOCAL, "unheard", x=9.0, y=0.0, z=3.0)
    await rig.until(lambda: bool(results(client, LOCAL)))
    assert results(client, LOCAL) == [("unheard", ABORTED, False)]
    client.call("/dji_sdk/sdk_control_authority", control_enable=1)  # it begins anew
    await rig.until(lambda: bool(results(client, WAYPOINTS)), within=20.0)
    assert results(client, WAYPOINTS) == [("stays", ABORTED, False)]
    assert rig.aircraft.position[0] == pytest.approx(2.0, abs=0.6)
    send(client, LOCAL, "anew", x=5.0, y=0.0, z=3.0)
    await rig.until(lambda: len(results(client, LOCAL)) == 2)
    assert results(client, LOCAL)[1] == ("anew", SUCCEEDED, True)


async def test_a_stay_at_a_waypoint_can_be_cancelled(rig: Rig) -> None:
    client = await flying(rig, WAYPOINTS)
    send(client, WAYPOINTS, "long", waypoint_list=waypoints((2.0, 0.0, 3.0, 0, 60000)))
    await rig.until(lambda: rig.aircraft.position[0] > 1.5)
    await anyio.sleep(10.0)
    client.send("publish", topic=f"{WAYPOINTS}/cancel", msg={"id": "long"})
    await rig.until(lambda: bool(results(client, WAYPOINTS)), within=1.0)
    assert results(client, WAYPOINTS) == [("long", PREEMPTED, False)]


def test_a_stamp_is_seconds_and_billionths() -> None:
    assert _seconds({"secs": 7, "nsecs": 250_000_000}) == 7.25


async def test_a_cancel_of_another_goal_or_an_earlier_time_ends_nothing(rig: Rig) -> None:
    client = await flying(rig, LOCAL)
    send(client, LOCAL, "far", x=20.0, y=0.0, z=5.0)
    await anyio.sleep(0.5)
    client.send("publish", topic=f"{LOCAL}/cancel", msg={"id": "other"})
    client.send("publish", topic=f"{LOCAL}/cancel", msg={"stamp": {"secs": 5, "nsecs": 999}})
    await rig.until(lambda: bool(results(client, LOCAL)))
    assert results(client, LOCAL) == [("far", SUCCEEDED, True)]


async def test_a_goal_without_control_is_aborted_and_says_why(rig: Rig) -> None:
    client = rig.client()
    listen(client, LOCAL)
    send(client, LOCAL, "", x=5.0, y=0.0, z=5.0)
    await rig.until(lambda: bool(of(client, LOCAL, "result")))
    [result] = of(client, LOCAL, "result")
    assert (result["status"]["status"], result["result"]["result"]) == (ABORTED, False)
    assert "has no control" in result["status"]["text"]
    assert result["status"]["goal_id"]["id"]  # the server gives one where the client did not
    assert not rig.moves


async def test_a_client_that_sends_goals_without_end_is_refused_them(rig: Rig) -> None:
    client = rig.client()
    listen(client, LOCAL)
    for number in range(40):
        send(client, LOCAL, str(number), x=5.0, y=0.0, z=5.0)
    await anyio.sleep(0.5)
    found = [state for _, state, _ in results(client, LOCAL)]
    assert len(found) == 40
    assert found.count(REJECTED) >= 25
    assert len(of(client, LOCAL, "status")[-1]["status_list"]) == 16


async def test_setpoints_of_the_same_client_end_its_navigation(rig: Rig) -> None:
    client = await flying(rig, LOCAL)
    send(client, LOCAL, "far", x=60.0, y=0.0, z=5.0)
    await rig.until(lambda: rig.aircraft.position[0] > 3.0)
    client.call("/dji_sdk/velocity_control", frame=1, vx=0.0, vy=1.0, vz=0.0)
    await rig.until(lambda: bool(results(client, LOCAL)))
    assert results(client, LOCAL) == [("far", ABORTED, False)]


@pytest.mark.parametrize(
    ("number", "state", "task"), [(1, SUCCEEDED, "take off"), (7, ABORTED, None)]
)
async def test_a_task_is_done_when_it_is_accepted(
    rig: Rig, number: int, state: int, task: str | None
) -> None:
    client = await rig.open()
    listen(client, TASK)
    send(client, TASK, "task", task=number)
    await rig.until(lambda: bool(results(client, TASK)))
    assert results(client, TASK) == [("task", state, state == SUCCEEDED)]
    assert task_of(rig.agent) == task


async def test_rosapi_knows_the_action_servers(rig: Rig) -> None:
    client = rig.client()
    client.call("/rosapi/action_servers")
    [answer] = client.answers()
    assert answer["action_servers"] == sorted([TASK, LOCAL, GLOBAL, WAYPOINTS, WEB])


# -- DJI's page -----------------------------------------------------------------------------------


async def uploaded(rig: Rig, number: int = 1_480_000_000_123) -> FakeClient:
    """What the page sends when its buttons are pressed, up to *Start mission*."""
    await rig.activated()
    page = rig.client("page")
    listen(page, WEB)
    page.publish(f"{PAGE}/map_nav_srv/ctrl", data=True)
    await rig.until(lambda: rig.agent.holding.has_authority)
    page.send("publish", topic=f"{PAGE}/map_nav_srv/cmd", msg={"cmdCode": ord("n"), "tid": number})
    there = waypoints((5.0, 0.0, 3.0, 0, 0), (5.0, 5.0, 3.0, 0, 0))
    send(page, WEB, "goal_1", waypoint_list=there, tid=number)
    await anyio.sleep(0.5)
    return page


def command(page: FakeClient, letter: str, number: int = 1_480_000_000_123) -> None:
    message = {"cmdCode": ord(letter), "tid": number}
    page.send("publish", topic=f"{PAGE}/map_nav_srv/cmd", msg=message)


def stages(page: FakeClient) -> list[int]:
    return [one["feedback"]["stage"] for one in of(page, WEB, "feedback")]


async def test_djis_map_page_takes_off_and_flies_its_waypoints(rig: Rig) -> None:
    page = await uploaded(rig)
    assert stages(page) == [1]
    assert rig.aircraft.height < 0.1
    command(page, "s")
    await rig.until(lambda: bool(results(page, WEB)))
    assert results(page, WEB) == [("goal_1", SUCCEEDED, True)]
    assert rig.aircraft.position == pytest.approx((5.0, 5.0), abs=0.6)
    assert set(stages(page)) == {1, 2}


async def test_a_start_counts_from_its_press(rig: Rig) -> None:
    """A STOP behind the upload ends with control asked for anew; one behind the start does not."""
    page = await uploaded(rig)
    await rig.agent.stop()
    page.publish(f"{PAGE}/map_nav_srv/ctrl", data=True)
    await anyio.sleep(0.5)
    command(page, "s")
    await rig.until(lambda: rig.aircraft.height > 0.3)
    await rig.agent.stop()
    page.publish(f"{PAGE}/map_nav_srv/ctrl", data=True)
    await rig.until(lambda: bool(results(page, WEB)))
    assert results(page, WEB) == [("goal_1", ABORTED, False)]
    await anyio.sleep(10.0)
    assert rig.aircraft.position == pytest.approx((0.0, 0.0), abs=0.5)


async def test_a_start_of_other_waypoints_starts_nothing(rig: Rig) -> None:
    page = await uploaded(rig)
    command(page, "s", 17)
    await anyio.sleep(5.0)
    assert stages(page) == [1]
    assert rig.aircraft.height < 0.1
    assert page.statuses()


@pytest.mark.parametrize(("letter", "number"), [("c", 1_480_000_000_123), ("c", 5), ("n", 5)])
async def test_abort_or_newer_waypoints_end_in_a_hover(rig: Rig, letter: str, number: int) -> None:
    page = await uploaded(rig)
    command(page, "s")
    await rig.until(lambda: rig.aircraft.position[0] > 2.0)
    command(page, letter, number)
    await at_rest(rig)
    assert results(page, WEB) == [("goal_1", PREEMPTED, False)]
    assert rig.aircraft.height > 1.0


async def test_a_page_that_is_closed_leaves_a_hover_and_no_authority(rig: Rig) -> None:
    page = await uploaded(rig)
    command(page, "s")
    await rig.until(lambda: rig.aircraft.position[0] > 2.0)
    page.leave()
    await at_rest(rig)
    assert not rig.agent.holding.has_authority
