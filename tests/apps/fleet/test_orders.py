"""A landing that needs no lease: whatever flies, the aircraft comes down."""

from __future__ import annotations

import anyio
import pytest

from m100link.apps.agent.guided import FlyTo
from m100link.apps.agent.messages import Action, Ask, LeaseAction, LeaseAsk, Message
from m100link.apps.fleet.client import Fleet, FleetAircraft
from m100link.apps.fleet.orders import acquires, is_kept, lands, moves, renews, revokes, takes
from m100link.apps.fleet.payloads import Outcome
from m100link.errors import M100Error
from tests.apps.fleet.conftest import OnBoard, Rig

pytestmark = pytest.mark.anyio


DOES = {
    "lands": lands,
    "revokes": revokes,
    "moves": moves,
    "takes": takes,
    "acquires": acquires,
    "renews": renews,
    "is_kept": is_kept,
}


def does(message: Message, *asked: str) -> set[str]:
    """Which of these `m100link/apps/fleet/orders.py` says of it."""
    return {name for name in asked if DOES[name](message)}


@pytest.mark.parametrize(
    ("message", "expected"),
    [
        (Ask(1, Action.LAND), {"lands", "revokes"}),
        (Ask(1, Action.STOP), {"revokes"}),
        (Ask(1, Action.HALT), {"revokes"}),
        (Ask(1, Action.TAKE_OFF), {"moves"}),
        (Ask(1, Action.GO_HOME), {"moves"}),
        (Ask(1, Action.MISSION_START), {"moves"}),
        (FlyTo(52.0, 4.3, 10.0), {"moves"}),
        (LeaseAsk(1, LeaseAction.ACQUIRE), {"moves", "acquires"}),
        (LeaseAsk(1, LeaseAction.TAKE_OVER), {"moves"}),
        (LeaseAsk(1, LeaseAction.CONFIRM), {"moves", "takes"}),
        (LeaseAsk(1, LeaseAction.RENEW), {"renews"}),
        (LeaseAsk(1, LeaseAction.RELEASE), set()),
    ],
)
def test_what_a_message_does(message: Message, expected: set[str]) -> None:
    asked = ("lands", "revokes", "moves", "takes", "acquires", "renews")
    assert does(message, *asked) == expected


# What m100link/apps/fleet/orders.py says of an order that needs no lease.
WITHOUT_LEASE = {
    Action.STOP: {"revokes"},
    Action.HALT: {"revokes"},
    Action.LAND: {"lands", "revokes"},
    Action.VERSION: set[str](),
}


@pytest.mark.parametrize("action", Action, ids=lambda one: one.name)
def test_an_action_moves_and_is_done_once_unless_it_is_named(action: Action) -> None:
    """By hand: what nobody thought of is treated as the most dangerous order."""
    found = does(Ask(1, action), "lands", "revokes", "moves", "is_kept")
    assert found == WITHOUT_LEASE.get(action, {"moves", "is_kept"}), (
        f"orders.py says that {action.name} {sorted(found)}: WITHOUT_LEASE of this file says not"
    )


async def take_off(pilot: Fleet, outcomes: list[Outcome]) -> None:
    results = await pilot.each(FleetAircraft.take_off, ["a1"])
    outcomes.append(results["a1"].outcome)


@pytest.mark.parametrize("after", [0.0, 0.02, 0.1, 0.3, 0.6, 1.0, 1.5, 2.0, 3.0])
async def test_who_takes_off_is_landed(rig: Rig, after: float) -> None:
    """As the order is heard, as the motors start, and in the climb."""
    one, pilot, other = await rig.aircraft("a1"), await rig.pilot(), await rig.pilot("other")
    await one.agent.activate()
    await anyio.sleep(1.0)
    outcomes: list[Outcome] = []
    async with anyio.create_task_group() as group:
        group.start_soon(take_off, pilot, outcomes)
        await rig.until(lambda: one.client.holder.number)
        await anyio.sleep(after)
        assert (await other.land())["a1"].outcome is Outcome.OK
    assert Outcome.OK not in outcomes
    for _ in range(100):
        await anyio.sleep(0.1)
        assert one.height < 0.1, "it stays where it is wanted"


async def test_who_lands_already_is_left_to_land(rig: Rig) -> None:
    one, pilot, other = await rig.aircraft("a1"), await rig.pilot(), await rig.pilot("other")

    async def fly() -> None:
        with pytest.raises(M100Error):  # its lease is taken over
            async with pilot["a1"].control() as control:
                await control.take_off()
                await control.land()

    async with anyio.create_task_group() as group:
        group.start_soon(fly)
        await rig.until(lambda: one.client.state.task == "land")
        assert (await other.land())["a1"].outcome is Outcome.OK
        assert one.height < 0.1


async def going_home(rig: Rig, one: OnBoard, pilot: Fleet) -> None:
    with pytest.raises(M100Error):
        async with pilot["a1"].control() as control:
            await control.take_off()
            await control.go_home()


async def test_who_flies_home_is_landed_where_it_is(rig: Rig) -> None:
    one, pilot, other = await rig.aircraft("a1"), await rig.pilot(), await rig.pilot("other")
    async with anyio.create_task_group() as group:
        group.start_soon(going_home, rig, one, pilot)
        await rig.until(lambda: one.client.state.task == "go home")
        await anyio.sleep(1.0)
        assert (await other.land())["a1"].outcome is Outcome.OK
    assert one.height < 0.1
    assert any("land is done" in event.text for event in one.client.events)
