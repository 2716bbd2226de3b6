"""The node of 2015 on a virtual aircraft: every topic, every number, and what stops the motion."""

from __future__ import annotations

from typing import Any

import anyio
import pytest

from m100link.aircraft import Aircraft
from m100link.apps.agent.server.connection import ConnectionState
from m100link.apps.agent.server.flight import pattern
from m100link.apps.station.ros.node_2015 import PRESS_LIFETIME, REPEAT_LIFETIME
from m100link.errors import UsageError
from m100link.protocol.commands.control import StartTask
from m100link.sim.vehicle.activation import MobileApp
from tests.apps.agent.conftest import pattern_of, task_of
from tests.apps.station.conftest import Rig

pytestmark = pytest.mark.anyio

ZERO = {"x": 0, "y": 0, "z": 0, "w": 0}


def flown(moves: list[Any]) -> list[tuple[Any, ...]]:
    """Flag and values of each frame, repeats of the same left out."""
    values = [
        (
            m.control_flag,
            *(round(v, 3) for v in (m.roll_or_x, m.pitch_or_y, m.throttle_or_z, m.yaw)),
        )
        for m in moves
    ]
    return [one for i, one in enumerate(values) if i == 0 or values[i - 1] != one]


async def test_status_and_battery_come_each_second_zero_before_any_telemetry(rig: Rig) -> None:
    page = rig.client()
    page.subscribe("/flight_status", "/battery_status")
    await anyio.sleep(5.5)
    assert page.values("/flight_status")[-1] == 1  # standby
    assert page.values("/battery_status")[-1] in (99, 100)
    assert 5 <= len(page.values("/flight_status")) <= 6
    rig.aircraft.unplug()
    await anyio.sleep(2.0)
    assert page.values("/flight_status")[-1] == page.values("/battery_status")[-1] == 0


async def test_activation_tells_every_code(rig: Rig) -> None:
    page = rig.client()
    page.subscribe("/activation_status")
    page.publish("/sdk_request_activation", data=1)
    await rig.until(lambda: 0 in page.values("/activation_status"))
    assert page.values("/activation_status") == [3, 0]  # a new device asks the server first


@pytest.mark.parametrize(
    ("app", "code"),
    [(MobileApp(is_connected=False), 4), (MobileApp(is_connected=True, has_internet=False), 5)],
)
async def test_activation_tells_why_not(rig: Rig, app: MobileApp, code: int) -> None:
    rig.aircraft.disconnect_app()
    if app.is_connected:
        rig.aircraft.connect_app(internet=app.has_internet)
    page = rig.client()
    page.subscribe("/activation_status")
    page.publish("/sdk_request_activation", data=1)
    await rig.until(lambda: code in page.values("/activation_status"))
    assert rig.agent.activation.error is not None


async def test_without_activation_8_says_that_something_is_missing(rig: Rig) -> None:
    page = rig.client()
    page.subscribe("/activation_status", "/nav_open_close_status")
    page.publish("/nav_open_close_request", data=1)
    await rig.until(lambda: page.values("/activation_status") == [8])
    assert page.values("/nav_open_close_status") == []
    assert rig.agent.leases.holder(rig.agent.now) is None


async def test_open_and_close(rig: Rig) -> None:
    page = await rig.open()
    assert page.values("/nav_open_close_status") == [2]
    page.publish("/nav_open_close_request", data=0)
    await rig.until(lambda: page.values("/nav_open_close_status") == [2, 1])
    assert not rig.agent.holding.has_authority
    assert rig.agent.leases.holder(rig.agent.now) is None


async def test_open_is_refused_out_of_f(rig: Rig) -> None:
    await rig.activated()
    rig.aircraft.leave_f()
    page = rig.client()
    page.subscribe("/nav_open_close_status")
    page.publish("/nav_open_close_request", data=1)
    await rig.until(lambda: bool(page.values("/nav_open_close_status")))
    assert page.values("/nav_open_close_status") == [3]  # what firmware 1.0 answers
    assert "mode switch" in page.statuses()[0]


async def test_take_off_and_landing(rig: Rig) -> None:
    page = await rig.airborne()
    page.subscribe("/flight_status")
    await anyio.sleep(1.1)
    page.publish("/sdk_request_cmd", data=6)
    await rig.until(lambda: task_of(rig.agent) is not None)
    await rig.until(lambda: task_of(rig.agent) is None)
    await anyio.sleep(1.1)
    seen = page.values("/flight_status")
    assert seen[0] == 3
    assert seen[-1] == 1
    assert page.statuses() == []


async def test_a_landing_during_a_take_off_waits_for_its_end(rig: Rig) -> None:
    """It is sent once the aircraft would obey it; a second take-off is refused."""
    page = await rig.open()
    for number in (4, 4, 6):
        page.publish("/sdk_request_cmd", data=number)

    def sent() -> list[int]:
        commands = [one.command for one in rig.aircraft.autopilot.received_commands]
        return [int(one.task) for one in commands if isinstance(one, StartTask)]

    await rig.until(lambda: task_of(rig.agent) == "take off")
    await rig.until(lambda: task_of(rig.agent) is None)
    assert sent() == [4]
    await rig.until(lambda: sent() == [4, 6], within=1.0)
    assert any("during take off" in text for text in page.statuses())


@pytest.mark.parametrize("number", [0, 2, 9, 21, 22, 260 - 1, -1, float("nan")])
async def test_numbers_that_are_no_command_are_not_sent(rig: Rig, number: float) -> None:
    page = await rig.open()
    page.publish("/sdk_request_cmd", data=number if number == number else None)  # type: ignore[arg-type]
    await anyio.sleep(0.5)
    assert len(page.statuses()) == 1
    sent = [one.command for one in rig.aircraft.autopilot.received_commands]
    assert not [c for c in sent if isinstance(c, StartTask)]


@pytest.mark.parametrize(
    ("keys", "mode", "message", "frame"),
    [
        ("W", 1, {"x": -2}, (0x0A, 0, -2, 0, 0)),
        ("S", 1, {"x": 2}, (0x0A, 0, 2, 0, 0)),
        ("A", 1, {"y": -2}, (0x0A, -2, 0, 0, 0)),
        ("D", 1, {"y": 2}, (0x0A, 2, 0, 0, 0)),
        ("E", 1, {"z": 6}, (0x0A, 0, 0, 0, 6)),
        ("Q", 1, {"z": -6}, (0x0A, 0, 0, 0, -6)),
        ("Z", 1, {"w": 0.3}, (0x0A, 0, 0, 0.3, 0)),
        ("C", 1, {"w": -0.3}, (0x0A, 0, 0, -0.3, 0)),
        ("W", 2, {"y": 0.1}, (0x48, 0.1, 0, 0, 0)),
        ("S", 2, {"y": -0.1}, (0x48, -0.1, 0, 0, 0)),
        ("A", 2, {"x": -0.1}, (0x48, 0, -0.1, 0, 0)),
        ("D", 2, {"x": 0.1}, (0x48, 0, 0.1, 0, 0)),
        ("W+D+E at 6", 1, {"x": -12, "y": 12, "z": 36}, (0x0A, 12, -12, 0, 36)),
    ],
)
async def test_keys_become_the_frames_of_djis_node(
    rig: Rig, keys: str, mode: int, message: dict[str, float], frame: tuple[float, ...]
) -> None:
    page = await rig.airborne()
    if mode == 2:
        page.publish("/sdk_request_ctrl_mode", data=2)
    page.publish("/sdk_request_ctrl", **(ZERO | message))
    await anyio.sleep(0.1)
    page.publish("/sdk_request_ctrl", **ZERO)
    await anyio.sleep(1.0)
    assert flown(rig.moves) == [frame, (frame[0], 0, 0, 0, 0)]


async def test_keys_move_the_aircraft_the_right_way(rig: Rig) -> None:
    page = await rig.airborne()
    page.publish("/sdk_request_ctrl_mode", data=2)

    async def hold(seconds: float, **message: float) -> tuple[float, float, float]:
        north, east = rig.aircraft.position
        height = rig.aircraft.height
        for _ in range(round(seconds / 0.033)):
            page.publish("/sdk_request_ctrl", **(ZERO | message))
            await anyio.sleep(0.033)
        page.publish("/sdk_request_ctrl", **ZERO)
        await anyio.sleep(2.0)
        after = rig.aircraft.position
        return after[0] - north, after[1] - east, rig.aircraft.height - height

    north, east, up = await hold(4, y=0.6, w=0.3)
    assert north > 1.5
    assert abs(east) < 0.2
    assert up > 0.8
    north, east, up = await hold(4, x=-0.6)
    assert east < -1.5
    assert abs(north) < 0.2
    assert abs(up) < 0.2


async def test_a_held_key_flies_on_through_the_wait_before_it_repeats(rig: Rig) -> None:
    page = await rig.airborne()
    w = ZERO | {"x": -4}
    page.publish("/sdk_request_ctrl", **w)
    await anyio.sleep(0.5)
    for _ in range(10):
        page.publish("/sdk_request_ctrl", **w)
        await anyio.sleep(0.033)
    assert flown(rig.moves) == [(0x0A, 0, -4, 0, 0)]  # never a neutral in between
    assert len(rig.moves) == pytest.approx(0.83 * 50, abs=3)


@pytest.mark.parametrize(
    ("repeats", "lifetime"), [(0, PRESS_LIFETIME), (1, REPEAT_LIFETIME), (9, REPEAT_LIFETIME)]
)
async def test_a_page_that_hangs_stops_within_the_lifetime(
    rig: Rig, repeats: int, lifetime: float
) -> None:
    page = await rig.airborne()
    for _ in range(1 + repeats):
        page.publish("/sdk_request_ctrl", **(ZERO | {"x": -4}))
        await anyio.sleep(0.033)
    hung_at = rig.agent.now - 0.033
    await rig.until(lambda: rig.moves[-1].pitch_or_y == 0)
    assert rig.agent.now - hung_at == pytest.approx(lifetime, abs=0.035)
    await anyio.sleep(1.0)
    count = len(rig.moves)
    await anyio.sleep(1.0)
    assert len(rig.moves) == count  # and then silence


async def test_letting_go_stops_at_once(rig: Rig) -> None:
    page = await rig.airborne()
    page.publish("/sdk_request_ctrl", **(ZERO | {"x": -4}))
    await anyio.sleep(0.1)
    page.publish("/sdk_request_ctrl", **ZERO)
    await anyio.sleep(0.03)
    assert rig.moves[-1].pitch_or_y == 0


async def test_a_lost_socket_stops_at_once_and_gives_control_back(rig: Rig) -> None:
    page = await rig.airborne()
    page.publish("/sdk_request_ctrl", **(ZERO | {"x": -4}))
    await anyio.sleep(0.1)
    page.leave()
    await anyio.sleep(0.03)
    assert rig.moves[-1].pitch_or_y == 0
    await rig.until(lambda: not rig.agent.holding.has_authority, within=1.0)
    assert rig.aircraft.height > 1.0  # it hovers


async def test_the_next_client_gets_authority_although_the_last_is_still_giving_it_back(
    rig: Rig,
) -> None:
    page = await rig.airborne("first")
    page.publish("/sdk_request_ctrl", **(ZERO | {"x": -4}))
    await anyio.sleep(0.1)
    page.leave()
    other = rig.client("second")
    other.subscribe("/nav_open_close_status")
    for _ in range(2):  # and a double click asks once
        other.publish("/nav_open_close_request", data=1)
    await rig.until(lambda: len(other.values("/nav_open_close_status")) == 2)
    await anyio.sleep(2.0)
    assert other.values("/nav_open_close_status") == [2, 2]
    assert rig.agent.holding.has_authority
    other.publish("/sdk_request_ctrl", **(ZERO | {"y": 2}))
    await anyio.sleep(0.1)
    assert rig.moves[-1].roll_or_x == 2


async def test_another_client_cannot_steer_open_or_stop(rig: Rig) -> None:
    page = await rig.airborne("first")
    other = rig.client("second")
    other.subscribe("/nav_open_close_status")
    other.publish("/nav_open_close_request", data=1)
    other.publish("/nav_open_close_request", data=0)
    other.publish("/sdk_request_ctrl", **(ZERO | {"x": -4}))
    other.publish("/sdk_request_cmd", data=6)
    other.publish("/sdk_request_simple_task", data=4)
    other.publish("/sdk_request_activation", data=1)
    await anyio.sleep(1.0)
    assert other.values("/nav_open_close_status") == [0, 0]
    assert page.values("/nav_open_close_status") == [2]  # the first sees no change
    assert rig.moves == []
    assert task_of(rig.agent) is None
    assert rig.agent.holding.has_authority
    assert other.statuses()
    assert all("first has control" in text for text in other.statuses())
    other.publish("/sdk_request_simple_task", data=-1)  # anybody may have it hover
    other.leave()
    await anyio.sleep(0.5)
    assert rig.agent.holding.has_authority


async def test_modes_other_than_1_and_2_change_nothing(rig: Rig) -> None:
    page = await rig.airborne()
    for mode in (0, 3, 1.5):
        page.publish("/sdk_request_ctrl_mode", data=mode)
    page.publish("/sdk_request_ctrl", **(ZERO | {"x": -4}))
    await anyio.sleep(0.1)
    assert rig.moves[-1].control_flag == 0x0A
    assert "no control mode" in page.statuses()[0]


@pytest.mark.parametrize("message", [{"x": -31}, {"z": 101}, {"w": 4.1}, {"x": None}])
async def test_values_out_of_range_are_not_sent(rig: Rig, message: dict[str, Any]) -> None:
    page = await rig.airborne()
    page.publish("/sdk_request_ctrl", **(ZERO | message))
    await anyio.sleep(0.1)
    assert rig.moves == []
    assert len(page.statuses()) == 1


async def test_complaints_about_keys_come_once_a_second(rig: Rig) -> None:
    page = rig.client()
    for _ in range(60):
        page.publish("/sdk_request_ctrl", **(ZERO | {"x": -4}))
        await anyio.sleep(0.033)
    assert len(page.statuses()) == 2


async def test_the_pilot_takes_over_and_gives_back(rig: Rig) -> None:
    page = await rig.airborne()
    page.publish("/sdk_request_ctrl", **(ZERO | {"x": -4}))
    await anyio.sleep(0.1)
    rig.aircraft.leave_f()
    await rig.until(lambda: page.values("/nav_open_close_status")[-1] == 4, within=1.0)
    count = len(rig.moves)
    page.publish("/sdk_request_ctrl", **(ZERO | {"x": -4}))
    await anyio.sleep(1.0)
    assert len(rig.moves) <= count + 1
    rig.aircraft.return_to_f()
    await rig.until(lambda: rig.agent.holding.has_authority, within=2.0)  # without a new request
    page.publish("/sdk_request_ctrl", **(ZERO | {"x": -4}))
    await anyio.sleep(0.1)
    assert len(rig.moves) > count + 1


async def test_the_app_takes_over_for_good(rig: Rig) -> None:
    page = await rig.airborne()
    assert rig.aircraft.app_takes_control()
    await rig.until(lambda: page.values("/nav_open_close_status")[-1] == 4, within=1.0)
    rig.aircraft.app_releases_control()
    await anyio.sleep(3.0)
    assert not rig.agent.holding.has_authority


async def test_simple_task_0_flies_its_legs_and_stops(rig: Rig) -> None:
    page = await rig.airborne()
    page.publish("/sdk_request_simple_task", data=0)
    await anyio.sleep(41.0)
    page.publish("/sdk_request_simple_task", data=-1)
    await anyio.sleep(1.0)
    assert flown(rig.moves) == [
        (0x0A, 2, 0, 0, 0),
        (0x0A, -2, 0, 0, 0),
        (0x0A, 0, 2, 0, 0),
        (0x0A, 0, -2, 0, 0),
        (0x0A, 0, 0, 0.5, 0),
        (0x0A, 0, 0, -0.5, 0),
        (0x0A, 0, 0, 0, 90),
        (0x0A, 0, 0, 0, -90),
        (0x0A, 2, 0, 0, 0),
        (0x0A, 0, 0, 0, 0),
    ]
    assert pattern_of(rig.agent) is None


async def test_simple_task_4_takes_off_flies_and_comes_home(rig: Rig) -> None:
    page = await rig.open()
    page.publish("/sdk_request_simple_task", data=4)
    await anyio.sleep(1.0)
    assert pattern_of(rig.agent) is not None
    await rig.until(lambda: pattern_of(rig.agent) is None, within=200.0)
    assert rig.aircraft.height == pytest.approx(0.0, abs=0.1)
    assert {move.control_flag for move in rig.moves} == {0x0A, 0x48}
    assert rig.agent.journal.events[-1].text == "simple task 4 is done"


async def test_a_key_ends_a_simple_task(rig: Rig) -> None:
    page = await rig.airborne()
    page.publish("/sdk_request_simple_task", data=1)
    await anyio.sleep(1.0)
    page.publish("/sdk_request_ctrl", **ZERO)  # letting go is not steering
    assert pattern_of(rig.agent) is not None
    page.publish("/sdk_request_ctrl", **(ZERO | {"y": 2}))
    await rig.until(lambda: pattern_of(rig.agent) is None, within=0.1)
    await anyio.sleep(0.1)
    assert flown(rig.moves)[-1] == (0x0A, 2, 0, 0, 0)


async def test_a_lost_socket_ends_a_simple_task(rig: Rig) -> None:
    page = await rig.airborne()
    page.publish("/sdk_request_simple_task", data=0)
    await anyio.sleep(1.0)
    page.leave()
    await anyio.sleep(0.03)
    assert flown(rig.moves)[-1] == (0x0A, 0, 0, 0, 0)


@pytest.mark.parametrize("number", [3, 7, None])
async def test_other_simple_tasks_are_refused(rig: Rig, number: int | None) -> None:
    page = await rig.open()
    page.publish("/sdk_request_simple_task", data=number)  # type: ignore[arg-type]
    await anyio.sleep(0.5)
    assert len(page.statuses()) == 1
    assert pattern_of(rig.agent) is None


@pytest.mark.parametrize(("number", "why"), [(3, "random commands"), (7, "no simple task 7")])
def test_why_a_simple_task_is_not_flown(number: int, why: str) -> None:
    with pytest.raises(UsageError, match=why):
        pattern(number)


async def test_simple_tasks_5_and_6_activate_and_ask_for_the_version(rig: Rig) -> None:
    page = rig.client()
    page.subscribe("/activation_status")
    page.publish("/sdk_request_simple_task", data=6)
    page.publish("/sdk_request_simple_task", data=5)
    await rig.until(lambda: 0 in page.values("/activation_status"))
    assert any(event.text.startswith("version: ") for event in rig.agent.journal.events)


async def test_test_fre_follows_the_control_device_item(rig: Rig) -> None:
    rig.aircraft.set_rates(control_device=10)
    page = rig.client()
    page.subscribe("/test_fre")
    await anyio.sleep(2.0)
    assert len(page.values("/test_fre")) == pytest.approx(20, abs=2)
    await rig.open("other")
    await anyio.sleep(0.5)
    assert page.values("/test_fre")[-1] == 2


async def test_the_line_is_opened_again_after_a_loss(rig: Rig) -> None:
    page = await rig.airborne()
    rig.aircraft.unplug()
    await rig.until(lambda: rig.agent.connection.state is not ConnectionState.CONNECTED, within=1.0)
    await rig.until(lambda: not rig.agent.holding.has_authority, within=1.0)
    rig.aircraft.replug()
    await rig.until(lambda: rig.agent.connection.state is ConnectionState.CONNECTED, within=5.0)
    # The aircraft is active still: the key is in use without a new activation.
    page.publish("/nav_open_close_request", data=1)
    await rig.until(lambda: page.values("/nav_open_close_status") == [2, 2])


async def test_a_flood_of_orders_reaches_neither_the_aircraft_nor_the_log(rig: Rig) -> None:
    pilot = await rig.open()
    spammer = rig.client("spammer")
    before = len(rig.agent.journal.events)
    for topic, value in (
        ("/sdk_request_simple_task", 6),
        ("/sdk_request_simple_task", 5),
        ("/sdk_request_activation", 1),
        ("/nav_open_close_request", 1),
        ("/nav_open_close_request", 0),
        ("/sdk_request_cmd", 4),
    ):
        spammer.send("advertise", topic=topic, type="std_msgs/Float32")
        for _ in range(50):
            spammer.send("publish", topic=topic, msg={"data": value})
            await anyio.sleep(0.02)
    assert len(rig.agent.journal.events) - before <= 15
    assert sum("orders per second" in text for text in spammer.statuses()) <= 8
    pilot.publish("/sdk_request_cmd", data=4)
    await rig.until(lambda: task_of(rig.agent) is not None)


async def test_asking_for_the_version_asks_the_aircraft_nothing(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    client = rig.client()
    client.send("set_level", level="info")
    asked: list[Aircraft] = []
    monkeypatch.setattr(Aircraft, "version", asked.append)
    for _ in range(5):
        client.publish("/sdk_request_simple_task", data=6)
        client.call("/dji_sdk/query_drone_version")
    await anyio.sleep(0.1)
    assert asked == []
    assert len([text for text in client.statuses() if text.startswith("version: ")]) == 5
    assert [event.text[:8] for event in rig.agent.journal.events].count("version:") == 1
    assert len(client.answers()) == 5


async def test_a_pilot_who_gave_many_orders_can_still_stop(rig: Rig) -> None:
    pilot = await rig.airborne()
    pilot.publish("/sdk_request_simple_task", data=1)
    await rig.until(lambda: any("1 begins" in e.text for e in rig.agent.journal.events))
    for _ in range(50):
        pilot.publish("/sdk_request_simple_task", data=6)
    pilot.publish("/sdk_request_simple_task", data=-1)
    await rig.until(lambda: any("stopped it" in e.text for e in rig.agent.journal.events))
    pilot.publish("/nav_open_close_request", data=0)
    await rig.until(lambda: rig.agent.leases.holder(rig.agent.now) is None)


async def test_after_stop_a_client_that_goes_on_publishing_has_to_open_control_anew(
    rig: Rig,
) -> None:
    page = await rig.airborne()
    page.publish("/sdk_request_ctrl_mode", data=2)

    async def publish(seconds: float) -> None:
        for _ in range(round(seconds / 0.03)):
            page.publish("/sdk_request_ctrl", **(ZERO | {"y": 1.0}))
            await anyio.sleep(0.03)

    await publish(0.5)
    assert rig.moves[-1].roll_or_x == 1.0
    await rig.front.stop()
    before = len(rig.moves)
    await publish(2.0)
    page.publish("/sdk_request_ctrl", **ZERO)  # a program that hovers for a while says so as well
    await publish(1.0)
    assert not any(move.roll_or_x for move in rig.moves[before + 1 :])
    assert any("STOP was pressed" in text for text in page.statuses())
    page.publish("/nav_open_close_request", data=1)
    await anyio.sleep(0.1)
    await publish(0.5)
    assert rig.moves[-1].roll_or_x == 1.0
