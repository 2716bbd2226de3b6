"""What ends or disturbs a flight, at every front: one table of what is to follow.

Each cell flies the virtual aircraft to the north by the hand of one front, lets one thing happen,
and goes on sending setpoints as a held key or a program does. Judged is what the aircraft did, by
whom control is held then, and what the user of that front heard. Kills are of a channel here,
on virtual time; :data:`BY_PROCESSES` names the tests that kill processes.
"""

from __future__ import annotations

import random
import re
from collections import Counter
from contextlib import nullcontext
from enum import Enum
from pathlib import Path
from typing import Any, ClassVar, NamedTuple
from unittest.mock import patch

import pytest

from m100link.apps.agent.orders import GoHome, Land
from m100link.protocol.records import Device
from m100link.sim.clock import virtual_clock_loop
from tests.apps import every_front
from tests.apps.every_front import (
    OTHER,
    Console,
    FarConsole,
    FleetPilot,
    Front,
    Mavlink,
    Performer,
    Ros2,
    Rosbridge,
    Rosbridge2015,
    Rosbridge2016,
    Sync,
)
from tests.rig import wrong_standing

pytestmark = pytest.mark.anyio

FRONTS: tuple[type[Front], ...] = (
    *(Console, Rosbridge, Mavlink, Ros2, FleetPilot, FarConsole, Performer, Sync),
)


@pytest.fixture
def anyio_backend() -> tuple[str, dict[str, Any]]:
    return "asyncio", {"loop_factory": virtual_clock_loop}


class Event(Enum):
    """What happens."""

    STOP = "STOP at this front"
    STOP_ELSEWHERE = "STOP at another front"
    FLOOD = "STOP at this front, behind more of its own messages than it may send"
    TOO_FAST = "for seconds, this front's program sends more setpoints than it may"
    LAND = "this front lands it"
    LAND_WRONG = "the same, while in the air two flight statuses of three say that it stands"
    TAKE_OVER = "another client takes the lease over"
    LEAVE_F = "the pilot leaves F and is back after 2 s"
    TAKE_OVER_OUT_OF_F = "another client takes the lease over while the pilot is out of F"
    CALL_OFF = "control is given back, and asked for and called off again and again"
    ORDER_LATE = "an order to go home comes later than it may"
    SILENCE = "no setpoint any more; the sender is there"
    HANG = "the sender hangs"
    HANG_STOP = "the sender hangs, and seconds later comes a STOP at another front"
    HANG_LAND = "the sender hangs, and seconds later another client takes over and lands it"
    HANG_LEAVE_F = "the sender hangs, and seconds later the pilot leaves F for 2 s"
    KILL = "the front is killed"
    LOSE_AGENT = "the agent is killed"
    LOSE_LINK = "the cable is pulled"
    STALE = "setpoints come a second late"
    HOLD_UP = "setpoints come late to the agent"
    STOP_UNHEARD = "STOP between two steps of a request for control; its front hears of none"
    STEP_UNHEARD = "STOP between two steps of the user's program, which hears of none"
    HOVER_ELSEWHERE = "somebody without the lease orders a hover"
    JUNK = "bytes that mean nothing"


class Does(Enum):
    """What the aircraft does."""

    HOVERS = "hovers"
    LANDS = "lands and stops its motors"
    GOES_ON = "flies on as before"


class Has(Enum):
    """Who has control afterwards: the lease, and whom the aircraft obeys."""

    FRONT = "this front, as before"
    OTHER = "the other"
    LEASE_ONLY = "the other has the lease, and the pilot the sticks: nobody asked for authority"
    NOBODY = "nobody: the pilot has the sticks"
    UNHEARD = "the aircraft heard nothing; it obeys nobody's setpoints, and the pilot out of F"


class End(NamedTuple):
    """A cell."""

    does: Does
    within: float  # seconds
    has: Has
    told: str  # what the user reads, as a pattern; empty where nothing is to be reported
    # How the user flies again: "let go" of everything for a second, or by control taken anew;
    # empty where that is another test's.
    again: str = ""


class Cannot(NamedTuple):
    """A cell that cannot be, and why."""

    why: str


# A setpoint lasts 0.2 s (rosbridge, fleets, programs), 0.3 s (console, ROS 2) or 0.5 s (MAVLink);
# the virtual aircraft waits 0.5 s for the next one. Braking from 2 m/s takes about a second.
BRAKES, LASTS_02, LASTS_03, LASTS_05 = 1.2, 1.4, 1.5, 1.7
LANDED = 7.0
H, L, G = Does
FRONT, OTHERS, LEASE_ONLY, NOBODY, UNHEARD = Has
PAD_HELD = "you still hold a key or stick; it was not flown"
UNTOLD = ""

TABLE: dict[Event, dict[type[Front], End | Cannot]] = {
    Event.STOP: {
        Console: End(H, BRAKES, FRONT, f"STOP was pressed, and {PAD_HELD}", "let go"),
        Rosbridge: End(H, BRAKES, FRONT, "STOP was pressed", "control"),
        Mavlink: End(H, BRAKES, FRONT, "is in HOLD", "control"),
        Ros2: End(H, BRAKES, FRONT, r"it was stopped: call ~/obtain_control", "control"),
        FleetPilot: End(H, BRAKES, FRONT, "STOP was pressed; setpoints that go on", "control"),
        FarConsole: End(H, BRAKES, FRONT, f"STOP was pressed, and {PAD_HELD}", "let go"),
        Performer: End(H, BRAKES, NOBODY, "had to take off: a1; those in the air hover"),
        Sync: End(H, BRAKES, NOBODY, "is over with this block", "control"),
    },
    Event.STOP_ELSEWHERE: {
        Console: End(H, BRAKES, FRONT, f"STOP was pressed, and {PAD_HELD}", "let go"),
        Rosbridge: End(H, BRAKES, FRONT, "STOP was pressed", "control"),
        Mavlink: End(H, BRAKES, FRONT, "Offboard: STOP was pressed", "control"),
        Ros2: End(H, BRAKES, FRONT, r"it was stopped: call ~/obtain_control", "control"),
        FleetPilot: End(H, BRAKES, FRONT, "STOP was pressed; setpoints that go on", "control"),
        FarConsole: End(H, BRAKES, FRONT, f"STOP was pressed, and {PAD_HELD}", "let go"),
        Performer: End(H, BRAKES, NOBODY, "a1 left: a1 was stopped"),
        Sync: Cannot("a program without an agent is the only one at its line"),
    },
    # As Event.STOP, whatever a front drops of the rest.
    Event.FLOOD: {
        Console: End(H, BRAKES, FRONT, f"STOP was pressed, and {PAD_HELD}", "let go"),
        Rosbridge: End(H, BRAKES, FRONT, "STOP was pressed", "control"),
        Mavlink: End(H, BRAKES, FRONT, "is in HOLD", "control"),
        Ros2: End(H, BRAKES, FRONT, r"it was stopped: call ~/obtain_control", "control"),
        FleetPilot: End(H, BRAKES, FRONT, "STOP was pressed; setpoints that go on", "control"),
        FarConsole: End(H, BRAKES, FRONT, f"STOP was pressed, and {PAD_HELD}", "let go"),
        Performer: Cannot("its conductor sends no stream"),
        Sync: Cannot("there is no way between a program and its own control"),
    },
    Event.TOO_FAST: {
        **dict.fromkeys(FRONTS, End(G, 0.0, FRONT, UNTOLD)),
        Rosbridge: End(G, 0.0, FRONT, "more than 200 frames per second: frame dropped"),
        Performer: Cannot("its conductor sends no stream"),
    },
    Event.LAND: {
        Console: End(L, LANDED, FRONT, "a setpoint was sent during land; nothing was sent"),
        Rosbridge: End(L, LANDED, FRONT, "a setpoint was sent during land; nothing was sent"),
        Mavlink: End(L, LANDED, NOBODY, "is in LAND"),
        Ros2: End(L, LANDED, NOBODY, "~/cmd_vel: land flies"),
        FleetPilot: End(L, LANDED, FRONT, "a setpoint was sent during land; nothing was sent"),
        FarConsole: End(L, LANDED, FRONT, "a setpoint was sent during land; nothing was sent"),
        Performer: End(L, LANDED, NOBODY, "a1 left: .*landing for pilot has control"),
        Sync: End(L, LANDED, FRONT, UNTOLD),
    },
    Event.TAKE_OVER: {
        Console: End(H, BRAKES, OTHERS, f"{OTHER} has control .taken over"),
        Rosbridge: End(H, BRAKES, OTHERS, f"{OTHER} has control; nothing was sent"),
        Mavlink: End(H, BRAKES, OTHERS, f"{OTHER} has control .taken over"),
        Ros2: End(H, BRAKES, OTHERS, "ROS has no control: call ~/obtain_control"),
        FleetPilot: End(H, BRAKES, OTHERS, f"StaleLease: .*{OTHER} has control"),
        FarConsole: End(H, BRAKES, OTHERS, f"{OTHER} has control .taken over"),
        Performer: End(H, BRAKES, OTHERS, f"a1 left: .*{OTHER} has control"),
        Sync: Cannot("without an agent there is no lease; the app takes control as the pilot does"),
    },
    Event.LEAVE_F: {
        Console: End(H, BRAKES, FRONT, f"control was lost meanwhile, and {PAD_HELD}", "let go"),
        Rosbridge: End(H, BRAKES, FRONT, "control was lost meanwhile", "let go"),
        Mavlink: End(H, BRAKES, FRONT, "is in POSCTL", "control"),
        Ros2: End(H, BRAKES, NOBODY, "the pilot moved the mode switch out of F", "control"),
        FleetPilot: End(H, BRAKES, FRONT, "control was lost meanwhile", "let go"),
        FarConsole: End(H, BRAKES, FRONT, f"control was lost meanwhile, and {PAD_HELD}", "let go"),
        Performer: End(H, BRAKES, NOBODY, "a1 left: the pilot moved the mode switch out of F"),
        Sync: End(H, BRAKES, NOBODY, "AuthorityLost: the pilot moved the mode switch", "control"),
    },
    Event.TAKE_OVER_OUT_OF_F: {
        **dict.fromkeys(FRONTS, End(H, BRAKES, LEASE_ONLY, UNTOLD)),
        Sync: Cannot("without an agent there is no lease"),
    },
    Event.CALL_OFF: {
        **dict.fromkeys(FRONTS, End(H, BRAKES, NOBODY, UNTOLD)),
        Mavlink: Cannot("a command to arm is not called off; in the air nobody may disarm"),
        Performer: Cannot("the conductor calls it off by STOP"),
        Sync: Cannot("a call without await is over before the next one"),
    },
    Event.ORDER_LATE: {
        **dict.fromkeys(FRONTS, Cannot("its orders do not say when they were made")),
        Console: End(G, 0.0, FRONT, "a pressed button arrived 3.* late; nothing was done"),
        FleetPilot: End(G, 0.0, FRONT, "not carried out: it is older than 5 s"),
        FarConsole: End(G, 0.0, FRONT, "a pressed button arrived 3.* late; nothing was done"),
    },
    Event.SILENCE: {
        Console: End(H, LASTS_03, FRONT, UNTOLD, "let go"),
        Rosbridge: End(H, LASTS_02, FRONT, UNTOLD, "let go"),
        Mavlink: End(H, LASTS_05, FRONT, "Offboard: setpoints stopped", "control"),
        Ros2: End(H, LASTS_03, FRONT, UNTOLD, "let go"),
        FleetPilot: End(H, LASTS_02, FRONT, UNTOLD, "let go"),
        FarConsole: End(H, LASTS_03, FRONT, UNTOLD, "let go"),
        Performer: Cannot("no setpoint comes over the network: it flies its track on board"),
        Sync: End(H, LASTS_02, FRONT, UNTOLD, "let go"),
    },
    Event.HANG: {
        Console: End(H, LASTS_03, NOBODY, r"lost control \(expired\)"),
        Rosbridge: End(H, LASTS_02, NOBODY, UNTOLD),
        Mavlink: End(H, LASTS_05, FRONT, "is lost", "control"),
        Ros2: End(H, LASTS_03, FRONT, UNTOLD, "let go"),
        FleetPilot: End(H, LASTS_02, NOBODY, "OutcomeUnknown: a1 gave no answer"),
        FarConsole: End(H, LASTS_03, NOBODY, UNTOLD),
        Performer: End(G, 0.0, FRONT, UNTOLD),
        Sync: End(H, LASTS_02, FRONT, UNTOLD, "let go"),
    },
    # MAVLink and ROS 2 keep control in the air without end; nobody needs the hung sender to end it.
    Event.HANG_STOP: {
        **dict.fromkeys(FRONTS, End(H, 0.0, NOBODY, UNTOLD)),
        Mavlink: End(H, 0.0, FRONT, UNTOLD),  # its next request is refused, and says why
        Ros2: End(H, 0.0, FRONT, UNTOLD, "control"),
        Performer: End(H, BRAKES, NOBODY, UNTOLD),
        Sync: Cannot("without an agent nobody else can press STOP"),
    },
    Event.HANG_LAND: {
        **dict.fromkeys(FRONTS, End(L, LANDED, OTHERS, UNTOLD)),
        Sync: Cannot("without an agent there is no lease"),
    },
    Event.HANG_LEAVE_F: {
        **dict.fromkeys(FRONTS, End(H, BRAKES, NOBODY, UNTOLD)),
        Mavlink: End(H, BRAKES, FRONT, UNTOLD, "control"),
        Sync: End(H, BRAKES, NOBODY, UNTOLD, "control"),
    },
    Event.KILL: {
        Console: End(H, BRAKES, NOBODY, UNTOLD),
        Rosbridge: End(H, BRAKES, NOBODY, UNTOLD),
        Mavlink: End(H, BRAKES, NOBODY, UNTOLD),
        Ros2: End(H, BRAKES, NOBODY, UNTOLD),
        FleetPilot: End(H, LASTS_02, NOBODY, UNTOLD),
        FarConsole: End(H, LASTS_03, NOBODY, UNTOLD),
        Performer: End(G, 0.0, FRONT, UNTOLD),
        Sync: Cannot("a line in memory has no guardian, and dies with the program"),
    },
    Event.LOSE_AGENT: {
        Console: End(H, LASTS_05, UNHEARD, "the pad shows no_control"),
        Rosbridge: End(H, LASTS_05, UNHEARD, "the agent that owns the aircraft has gone"),
        Mavlink: End(H, LASTS_05, UNHEARD, "no heartbeat"),
        Ros2: End(H, LASTS_05, UNHEARD, "line: the agent has gone"),
        FleetPilot: End(H, LASTS_05, UNHEARD, "OutcomeUnknown: a1 gave no answer for 3 s"),
        FarConsole: End(H, LASTS_05, UNHEARD, "the agent .* has said nothing for"),
        Performer: End(H, LASTS_05, UNHEARD, UNTOLD),  # reported after 7 s: see its own tests
        Sync: Cannot("it has no agent: the program is the owner of the line"),
    },
    Event.LOSE_LINK: {
        Console: End(H, LASTS_05, UNHEARD, "connection lost"),
        Rosbridge: End(H, LASTS_05, UNHEARD, "connection lost"),
        Mavlink: End(H, LASTS_05, UNHEARD, "no heartbeat"),
        Ros2: End(H, LASTS_05, UNHEARD, "connection lost"),
        FleetPilot: End(H, LASTS_05, UNHEARD, "the aircraft is not connected"),
        FarConsole: End(H, LASTS_05, UNHEARD, "connection lost"),
        Performer: End(H, LASTS_05, UNHEARD, "a1 left: the position of a1 is unknown"),
        Sync: End(H, LASTS_05, UNHEARD, "LinkLost"),
    },
    Event.STALE: {
        Console: End(H, 0.0, FRONT, "a key press arrived 1.0 s late"),
        Rosbridge: End(H, 0.0, FRONT, "a setpoint arrived 1.0 s late"),
        Mavlink: End(H, 0.0, FRONT, "Offboard: setpoints stopped"),  # they fly nothing in Hold
        Ros2: End(H, 0.0, FRONT, "~/cmd_vel: "),
        FleetPilot: End(H, 0.0, FRONT, UNTOLD),
        FarConsole: End(H, 0.0, FRONT, "a key press arrived 1.0 s late"),
        Performer: End(G, 0.0, FRONT, "a1 is flying and cannot place"),
        Sync: Cannot("there is no way between a program and its own control"),
    },
    Event.HOLD_UP: {
        **dict.fromkeys(FRONTS, End(H, 0.0, FRONT, UNTOLD)),
        Performer: Cannot("no setpoint is on its way while it flies its track"),
        Sync: Cannot("there is no way between a program and its own control"),
    },
    Event.STOP_UNHEARD: {
        **dict.fromkeys(FRONTS, End(H, BRAKES, NOBODY, UNTOLD)),
        Performer: Cannot("a show takes no aircraft back that left it"),
        Sync: Cannot("without an agent nobody else can press STOP"),
    },
    Event.STEP_UNHEARD: {
        **dict.fromkeys(FRONTS, Cannot("a person sees the STOP: each press begins anew")),
        Rosbridge: End(H, 0.0, FRONT, "STOP was pressed; go home that is asked", "control"),
        Mavlink: End(H, 0.0, FRONT, "Return: STOP was pressed; go home that is asked", "control"),
        Ros2: End(H, 0.0, FRONT, "~/go_home: False STOP was pressed; go home", "control"),
        FleetPilot: End(H, 0.0, FRONT, "GuardRefused: STOP was pressed; go home", "control"),
        Performer: Cannot("its orders are steps of one request: see STOP_UNHEARD"),
        Sync: Cannot("without an agent nobody else can press STOP"),
    },
    Event.HOVER_ELSEWHERE: {
        Console: End(H, BRAKES, FRONT, f"a hover was ordered, and {PAD_HELD}", "let go"),
        Rosbridge: End(H, BRAKES, FRONT, "a hover was ordered", "control"),
        Mavlink: End(H, BRAKES, FRONT, "is in HOLD", "control"),
        Ros2: End(H, BRAKES, FRONT, r"it was stopped: call ~/obtain_control", "control"),
        FleetPilot: End(H, BRAKES, FRONT, "a hover was ordered; setpoints that go on", "control"),
        FarConsole: End(H, BRAKES, FRONT, f"a hover was ordered, and {PAD_HELD}", "let go"),
        Performer: End(H, BRAKES, NOBODY, "a1 left"),
        Sync: Cannot("without an agent nobody else can order a hover"),
    },
    Event.JUNK: dict.fromkeys(FRONTS, End(G, 0.0, FRONT, UNTOLD)),
}
"""By hand, from safety.md, the page of each front and agent.md."""

TABLE[Event.LAND_WRONG] = TABLE[Event.LAND]


BY_PROCESSES: dict[type[Front], tuple[str, ...]] = {
    Console: (
        "browser.long.test_disturbances.test_browser_killed",
        "browser.long.test_disturbances.test_front_killed",
        "browser.long.test_disturbances.test_agent_killed",
    ),
    Rosbridge: ("attacks.test_attacks.test_a_lost_client_costs_a_hover_and_the_next_flies_on",),
    Mavlink: (
        "interop.mavlink.test_programs.test_a_program_that_is_killed_leaves_a_hover",
        "interop.mavlink.test_programs.test_a_front_that_is_killed_leaves_a_hover_and_comes_back",
        "interop.mavlink.test_programs.test_a_bridge_that_is_ended_leaves_a_hover",
    ),
    Ros2: (
        "interop.ros2.test_programs.test_the_commander_is_killed",
        "interop.ros2.test_programs.test_the_node_is_killed",
        "interop.ros2.test_programs.test_all_of_m100link_is_killed",
    ),
    FleetPilot: ("attacks.test_fleet.test_it_hovers_then_does_what_was_configured",),
    FarConsole: ("attacks.test_fleet.test_it_hovers_then_does_what_was_configured",),
    Performer: ("attacks.test_fleet_show.test_of_five_who_is_attacked_hovers_and_is_named",),
    Sync: (
        "flight.test_processes.test_after_sigkill_the_guardian_stops_it_and_gives_authority_back",
    ),
}
"""Tests that kill processes of each front, or of what stands for it on the same way."""


async def let_it_happen(front: Any, event: Event) -> None:
    """What is not a verb of the front itself."""
    if event is Event.SILENCE:
        front.is_sending = False
    elif event is Event.STALE:
        front.let_go()
        await front.passes(2.5)
        for _ in range(20):
            front.send_late()
    elif event is Event.LAND_WRONG:
        await front.land()
    elif event is Event.JUNK:
        for _ in range(10):
            front.send_junk()
            await front.passes(0.1)
    else:
        await getattr(front, event.name.lower())()


HANGING = (Event.HANG_STOP, Event.HANG_LAND, Event.HANG_LEAVE_F)
LONGER_S = {Event.HANG: 5.0, Event.LOSE_AGENT: 4.0}
"""Seconds that are watched behind the end, where a lease has to end: it lasts 3 s."""


def assert_does(front: Front, end: End, since: float) -> None:
    seen = [one for one in front.samples if one.time > since]
    still = [one for one in seen if one.time > since + end.within]
    assert still
    if end.does is Does.LANDS:
        assert not seen[-1].runs
        assert seen[-1].height < 0.1
        return
    assert all(one.runs for one in seen)
    assert min(one.height for one in seen) > seen[0].height - 1.0, "it went down"
    if end.does is Does.GOES_ON:
        assert min(one.speed for one in seen) > 1.0
    else:
        assert max(one.speed for one in still) < 0.3, "it moves"


async def assert_has(front: Front, end: End) -> None:
    device = front.aircraft.vehicle.authority.device
    is_pilots = end.has in (Has.NOBODY, Has.LEASE_ONLY)
    assert (device is Device.RC) == is_pilots or end.has is Has.OTHER
    holder = await front.holder()
    if holder is None or end.has is Has.UNHEARD:
        return
    if end.has is Has.FRONT:
        assert holder not in ("", OTHER)
    else:
        assert holder == (OTHER if end.has in (Has.OTHER, Has.LEASE_ONLY) else "")


async def begin_again(front: Front, how: str) -> None:
    """It can be flown again, and by nothing less."""
    front.is_there = True
    front.let_go()
    await front.passes(1.5)
    if how == "control":
        front.is_sending = True
        await front.passes(1.0)
        assert front.samples[-1].speed < 0.3, "a pause was enough"
        front.let_go()
        await front.passes(0.5)
    assert front.samples[-1].speed < 0.3
    if how == "control":
        await front.take_control()
    front.is_sending = True
    await front.passes(4.0, lambda: front.samples[-1].speed > 1.0)
    assert front.samples[-1].speed > 1.0, front.words()


async def at_once(front: Any, chance: random.Random) -> None:
    """One thing after which nobody's stream may go on, for as long as it happens to last."""
    match chance.choice(("stop", "stop elsewhere", "take over", "F", "plug", "app")):
        case "stop":
            await front.stop()
        case "stop elsewhere" if front.has_agent:
            await front.stop_elsewhere()
        case "take over" if front.has_agent:
            await front.take_over_and_give_back()
        case "plug":
            front.aircraft.unplug()
            await front.passes(chance.choice((0.1, 1.0, 4.0)))
            front.aircraft.replug()
        case "app":
            front.aircraft.app_takes_control()
            await front.passes(chance.uniform(0.1, 2.0))
            front.aircraft.app_releases_control()
        case _:
            front.aircraft.leave_f()
            await front.passes(chance.choice((0.05, 0.3, 1.0, 3.0)))
            front.aircraft.return_to_f()


CLIENTS: tuple[type[Any], ...] = (
    *(Console, Rosbridge, Rosbridge2015, Rosbridge2016, Mavlink, Ros2, FarConsole),
)
"""Those whose user is not the block of control: a program that leaves its block has said how."""


@pytest.mark.slow
@pytest.mark.parametrize("phase", ["taking off", "flying", "landing"])
@pytest.mark.parametrize("order", ["land", "go home", "STOP"])
@pytest.mark.parametrize("one", CLIENTS, ids=lambda front: front.__name__)
async def test_an_order_that_ends_a_flight_outlives_its_client(
    one: type[Any], order: str, phase: str
) -> None:
    """Its client leaves at once; the aircraft comes down, or hovers, and obeys nobody then."""
    chance, front = random.Random(f"{one.__name__} {order} {phase}"), one()
    on_ground = patch.object(every_front, "put_in_the_air", lambda *_: None)
    with on_ground if phase == "taking off" else nullcontext():
        async with front.open():
            if phase == "taking off":
                await front.take_off()
                await front.passes(chance.uniform(0.1, 6.0))
                assert front.samples[-1].obeys is Device.ONBOARD, front.words()
            else:
                await front.take_control()
            if phase == "landing":
                await front.land()
                await front.passes(chance.uniform(0.1, 1.0))
            if order == "STOP":
                await front.stop()
            else:
                front.order(GoHome() if order == "go home" else Land())
            await front.passes(0.1)
            await front.leave()
            await front.passes(
                10.0 if order == "STOP" else 90.0, lambda: not front.samples[-1].runs
            )
            await front.passes(5.0)
            last = front.samples[-1]
            assert last.speed < 0.3
            if order == "STOP" and phase != "taking off":
                assert last.runs, "it was to hover"
            elif order != "STOP":
                assert not last.runs, front.words()
                assert last.height < 0.1
            if order != "STOP" or one not in (Mavlink, Ros2):  # which keep control in the air
                assert last.obeys is Device.RC, front.words()
                assert await front.holder() == "", front.words()


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(12))
@pytest.mark.parametrize("one", FRONTS, ids=lambda front: front.__name__)
async def test_no_order_of_events_lets_a_stream_go_on(one: type[Front], seed: int) -> None:
    """Whatever comes behind whatever: who goes on sending moves nothing until it begins anew."""
    chance, front = random.Random(seed), one()
    async with front.open():
        await front.begin()
        for _ in range(chance.randint(1, 4)):
            await at_once(front, chance)
            await front.passes(chance.choice((0.05, 0.2, 1.0, 3.0)))
        await front.passes(2.0)
        since = front.now()
        await front.passes(5.0)
        assert max(one.speed for one in front.samples if one.time > since) < 0.3, front.words()


class Cells:
    """The events at one front; a class for each front, so that none of its tests is slow."""

    front: ClassVar[type[Front]]

    async def judge(self, event: Event) -> None:
        end = TABLE[event][self.front]
        if isinstance(end, Cannot):
            pytest.skip(end.why)
        front = self.front()
        with wrong_standing() if event is Event.LAND_WRONG else nullcontext():
            await self._judge(front, event, end)

    async def _judge(self, front: Front, event: Event, end: End) -> None:
        async with front.open():
            await front.begin()
            heard = Counter(front.words().split("\n"))
            since = front.now()
            await let_it_happen(front, event)
            if event in (Event.STALE, Event.HOLD_UP, Event.STEP_UNHEARD, *HANGING):
                since = front.now()
            await front.passes(end.within + LONGER_S.get(event, 2.0))
            # The sticks' time is not counted.
            out_of_f = (Event.LEAVE_F, Event.TAKE_OVER_OUT_OF_F)
            since += 2.0 * (event in out_of_f)
            told = "\n".join((Counter(front.words().split("\n")) - heard).elements())
            assert_does(front, end, since)
            await assert_has(front, end)
            assert re.search(end.told, told), told
            if end.again:
                await begin_again(front, end.again)

    async def test_stop(self) -> None:
        await self.judge(Event.STOP)

    async def test_stop_elsewhere(self) -> None:
        await self.judge(Event.STOP_ELSEWHERE)

    async def test_flood(self) -> None:
        await self.judge(Event.FLOOD)

    async def test_too_fast(self) -> None:
        await self.judge(Event.TOO_FAST)

    async def test_land(self) -> None:
        await self.judge(Event.LAND)

    async def test_land_wrong(self) -> None:
        await self.judge(Event.LAND_WRONG)

    async def test_take_over(self) -> None:
        await self.judge(Event.TAKE_OVER)

    async def test_leave_f(self) -> None:
        await self.judge(Event.LEAVE_F)

    async def test_take_over_out_of_f(self) -> None:
        await self.judge(Event.TAKE_OVER_OUT_OF_F)

    async def test_call_off(self) -> None:
        await self.judge(Event.CALL_OFF)

    async def test_order_late(self) -> None:
        await self.judge(Event.ORDER_LATE)

    async def test_silence(self) -> None:
        await self.judge(Event.SILENCE)

    async def test_hang(self) -> None:
        await self.judge(Event.HANG)

    async def test_hang_stop(self) -> None:
        await self.judge(Event.HANG_STOP)

    async def test_hang_land(self) -> None:
        await self.judge(Event.HANG_LAND)

    async def test_hang_leave_f(self) -> None:
        await self.judge(Event.HANG_LEAVE_F)

    async def test_kill(self) -> None:
        await self.judge(Event.KILL)

    async def test_lose_agent(self) -> None:
        await self.judge(Event.LOSE_AGENT)

    async def test_lose_link(self) -> None:
        await self.judge(Event.LOSE_LINK)

    async def test_stale(self) -> None:
        await self.judge(Event.STALE)

    async def test_hold_up(self) -> None:
        await self.judge(Event.HOLD_UP)

    async def test_stop_unheard(self) -> None:
        await self.judge(Event.STOP_UNHEARD)

    async def test_step_unheard(self) -> None:
        await self.judge(Event.STEP_UNHEARD)

    async def test_hover_elsewhere(self) -> None:
        await self.judge(Event.HOVER_ELSEWHERE)

    async def test_junk(self) -> None:
        await self.judge(Event.JUNK)


class TestConsole(Cells):
    front = Console


class TestRosbridge(Cells):
    front = Rosbridge


class TestMavlink(Cells):
    front = Mavlink


class TestRos2(Cells):
    front = Ros2


class TestFleetPilot(Cells):
    front = FleetPilot


class TestFarConsole(Cells):
    front = FarConsole


class TestPerformer(Cells):
    front = Performer


class TestSync(Cells):
    front = Sync


def test_every_pair_is_in_the_table() -> None:
    pairs = {(event, front) for event, row in TABLE.items() for front in row}
    assert pairs == {(event, front) for event in Event for front in FRONTS}
    assert {one.front for one in Cells.__subclasses__()} == set(FRONTS) == set(BY_PROCESSES)
    flown = {name.removeprefix("test_") for name in vars(Cells) if name.startswith("test_")}
    assert flown == {event.name.lower() for event in Event}


@pytest.mark.parametrize("front", FRONTS, ids=lambda front: front.__name__)
def test_processes_of_each_front_are_killed_elsewhere(front: type[Front]) -> None:
    for path in BY_PROCESSES[front]:
        *module, function = path.split(".")
        text = Path(__file__).parents[1].joinpath(*module).with_suffix(".py").read_text("utf-8")
        assert f"def {function}(" in text, path
