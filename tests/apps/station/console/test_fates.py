"""What the pad and the status line say while any hop refuses, delays or drops: only what is so.

An operator holds W through everything. Each draw disturbs one hop at a time, for a time: from the
page to the station, from there to the agent, from there to the aircraft, and back. Or it lets the
pilot, another operator, a STOP, the fence or the ground refuse. Nothing that the page claims may
differ from the virtual aircraft's own state for longer than 300 ms and the usual delay of the hops.
"""

from __future__ import annotations

import json
import math
import random
import shutil
import subprocess
from collections import Counter, deque
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any, NamedTuple

import anyio
import pytest

from m100link.apps.agent import orders
from m100link.apps.agent.client import Hearing
from m100link.apps.agent.latency import MAX_ROUND_TRIP
from m100link.apps.station.console import page as console_page
from m100link.apps.station.console.tab import Fate, Tab
from m100link.apps.station.console.view.fly import live
from m100link.apps.station.console.view.header import Cause, status_line
from m100link.apps.station.console.view.situation import Inputs, situation_of
from m100link.protocol.records import Device
from m100link.sim.virtual import VirtualAircraft
from tests.apps.station.conftest import Rig

pytestmark = pytest.mark.anyio

STATIC = Path(console_page.__file__).parent / "static"

BEAT_S, LOOK_S, TOLD_S, OLDEST_S = 0.05, 0.02, 0.3, 0.7
MOVEMENT_TIMEOUT_S, NOISE_M_S = 0.5, 0.05
PATIENCE_S = 0.3
"""For which a claim may differ from what is so, beside the usual delay of its way."""

SPEED_M_S = 0.5
FOLLOWED = 0.3
"""Part of what is held that the aircraft has to fly before anything is called flown."""

ELSEWHERE = (Fate.NO_CONTROL, Fate.OTHER, Fate.PILOT)
OTHERS = (Cause.SWITCH, Cause.OTHER, Cause.RC, Cause.FREE_RC)
NOT_FLOWN = frozenset(Fate) - {Fate.SENT, Fate.ACCEPTED, Fate.FLOWN, Fate.OLD, Fate.IGNORED}


class Hop:
    """A way of messages: each comes in order, after its delay, not while it stalls, or never."""

    def __init__(self, delay_s: float, arrive: Callable[[Any], None]) -> None:
        self.usual_s = self.delay_s = delay_s
        self.is_stalled = self.drops = False
        self._arrive, self._waiting = arrive, deque[tuple[float, Any]]()

    def put(self, message: Any) -> None:
        if not self.drops:
            self._waiting.append((anyio.current_time() + self.delay_s, message))

    def step(self) -> None:
        now = anyio.current_time()
        while self._waiting and not self.is_stalled and self._waiting[0][0] <= now:
            self._arrive(self._waiting.popleft()[1])

    def clear(self) -> None:
        self.delay_s, self.is_stalled, self.drops = self.usual_s, False, False
        self._waiting = deque((0.0, one) for _, one in self._waiting)


class World:
    """A page, its station, an agent and a virtual aircraft, with a hop between any two of them."""

    def __init__(self, seed: int) -> None:
        self.chance = random.Random(seed)
        self.rig = Rig(VirtualAircraft(seed=seed))
        self.since: dict[str, float] = {}  # when a claim began to differ from what is so
        self.allowed_s = 0.0
        self.shown: Counter[str] = Counter()
        self.lies: list[str] = []
        self.what = "take-off"
        self.moves, self.moved_at = 0, -math.inf
        self.banner: Cause | None = None
        self.banner_at, self.age = -math.inf, math.inf
        self.told: dict[str, float] | None = None
        self.heard_at = -math.inf
        self.fate: tuple[str, float, float] | None = None  # what, of which beat, heard at
        self.began_at = math.inf
        self.count = 0
        self.is_holding = False

    @property
    def usual_s(self) -> float:
        return sum(hop.usual_s for hop in self.hops.values())

    @asynccontextmanager
    async def running(self) -> AsyncIterator[None]:
        slow = self.chance.uniform
        async with self.rig.running():
            self.tab = Tab(self.rig.front, "page")
            ours, its = self.rig.channels
            self.hops = {
                "page to station": Hop(slow(0.001, 0.03), self._at_station),
                "station to agent": Hop(slow(0.001, 0.02), ours.send),
                "agent to station": Hop(slow(0.001, 0.02), its.send),
                "station to page": Hop(slow(0.001, 0.03), self._at_page),
            }
            for end, name in ((ours, "station to agent"), (its, "agent to station")):
                setattr(end, "send", self.hops[name].put)  # noqa: B010 (mypy refuses the other)
            async with anyio.create_task_group() as group:
                group.start_soon(self._run)
                yield
                group.cancel_scope.cancel()

    async def _run(self) -> None:
        ticks = 0
        while True:
            for hop in self.hops.values():
                hop.step()
            if ticks % 10 == 0:
                self._page_tick()
            if ticks % 50 == 0:
                self._look()
            if ticks % 4 == 0:
                self._note()
            ticks += 1
            await anyio.sleep(0.005)

    # -- the page --------------------------------------------------------------------------------

    def _page_tick(self) -> None:
        now, held = anyio.current_time(), self.is_holding
        self.count += 1
        known = (
            {} if self.told is None else {"told": self.told, "held": 1000 * (now - self.heard_at)}
        )
        message = {"n": self.count, "at": 1000 * now, **known}
        beat = {"op": "beat", "mode": 2, "x": 0, "y": SPEED_M_S, "z": 0, "w": 0}
        self.hops["page to station"].put(json.dumps(message | (beat if held else {"op": "alive"})))

    async def fly(self) -> None:
        """Have control, be in the air, and hold the key anew."""
        await self.let_go()
        while not self.tab.session.has_control:
            await self.tab.attempt(self.tab.session.obtain)
            await anyio.sleep(0.5)
        if self.rig.front.view.is_on_ground is not False:
            await self.tab.attempt(lambda: self.tab.ask(orders.TakeOff()))
        await self.press()
        await anyio.sleep(self.chance.uniform(0.5, 2.0))

    async def press(self) -> None:
        self.began_at, self.is_holding = anyio.current_time(), True

    async def let_go(self) -> None:
        self.is_holding = False
        self.count += 1
        message = {"op": "rest", "n": self.count, "at": 1000 * anyio.current_time()}
        self.hops["page to station"].put(json.dumps(message | ({"told": self.told, "held": 0})))
        await anyio.sleep(0.6)

    def _at_station(self, text: str) -> None:
        answer = self.tab.receive(text)
        if answer is not None and self.rig.front.view.hearing is Hearing.HEARD:
            self.hops["station to page"].put(json.loads(json.dumps(answer)))

    def _at_page(self, message: dict[str, Any]) -> None:
        now = anyio.current_time()
        if message["op"] == "banner":
            self.banner, self.age, self.banner_at = message["cause"], message["age"], now
            return
        self.told, self.heard_at = message["told"], now
        if "fate" in message:
            self.fate = message["fate"], message["at"] / 1000, now

    @property
    def pad(self) -> str:
        return fate_since(self.fate, self.began_at, anyio.current_time())

    # -- the station's view, four times a second -------------------------------------------------

    def _look(self) -> None:
        view, session = self.rig.front.view, self.tab.session
        line = status_line(situation_of(Inputs(vehicle=view, has_lease=session.has_lease)))
        told = {"op": "banner", "cause": line.cause, "age": live(view).get("age", math.inf)}
        self.hops["station to page"].put(told)

    # -- what is so ------------------------------------------------------------------------------

    def _note(self) -> None:
        aircraft, agent, now = self.rig.aircraft, self.rig.agent, anyio.current_time()
        autopilot, motion = aircraft.autopilot, aircraft.vehicle.flight.dynamics
        if autopilot.counters.movements != self.moves:
            self.moves, self.moved_at = autopilot.counters.movements, now
        newest = autopilot.received_movements[-1] if autopilot.received_movements else None
        is_onboard = aircraft.vehicle.authority.device is Device.ONBOARD
        is_ours = newest is not None and newest.roll_or_x != 0.0
        lease, flying = self.tab.session.lease, agent.holding.flying
        extra = min(MAX_ROUND_TRIP, sum(one.delay_s - one.usual_s for one in self.hops.values()))
        if aircraft.line.to_aircraft.is_stalled:  # it flies on by what it has: nobody can know
            extra += MOVEMENT_TIMEOUT_S
        so = So(
            now,
            pad=self.pad if self.is_holding else "",
            banner=self.banner,
            is_banner_new=self.age + now - self.banner_at <= PATIENCE_S,
            is_ours=is_onboard and lease is not None,
            goes_out=flying is not None and flying.is_steered,
            is_driven=is_onboard and is_ours and now - self.moved_at <= MOVEMENT_TIMEOUT_S,
            moves=motion.velocity_north >= FOLLOWED * SPEED_M_S - NOISE_M_S,
            allowed_s=PATIENCE_S + self.usual_s + BEAT_S + LOOK_S + extra,
        )
        self.shown[so.pad] += 1
        self._judge(so)

    def _judge(self, so: So) -> None:
        """Each claim may differ from what is so, but not for longer than is allowed."""
        is_ours = so.pad in (Fate.ACCEPTED, Fate.FLOWN, Fate.IGNORED)
        differs = {
            "it moves so": so.pad == Fate.FLOWN and not so.moves,
            "it is sent that": is_ours and not so.goes_out,
            "it is not flown": so.pad in NOT_FLOWN and so.is_driven and so.moves,
            "you have control": so.is_banner_new and so.banner is Cause.YOURS and not so.is_ours,
            "others have it": so.is_banner_new and so.banner in OTHERS and so.is_ours,
            "as the banner": is_ours and so.banner is not Cause.YOURS,
            "the banner, too": so.pad in ELSEWHERE and so.banner is Cause.YOURS,
        }
        self.allowed_s = max(so.allowed_s, self.allowed_s - LOOK_S)
        for claim, does in differs.items():
            since = self.since.setdefault(claim, so.at) if does else self.since.pop(claim, so.at)
            if so.at - since > self.allowed_s:
                self.lies.append(f"{claim}, since {since:.2f}, during {self.what}: {so}")


class So(NamedTuple):
    """What was said and what was so at one moment."""

    at: float
    pad: str
    banner: Cause | None
    is_banner_new: bool  # the age that stands beside it says so
    is_ours: bool  # the aircraft obeys the agent, under the lease of the page
    goes_out: bool  # the agent sends it the setpoint of the page
    is_driven: bool  # it got that lately, and obeys
    moves: bool  # to the north, as is held
    allowed_s: float


def fate_since(told: tuple[str, float, float] | None, began_at: float, now: float) -> str:
    """As ``fateSince`` of static/socket.js."""
    if told is None or told[1] < began_at:
        return "old" if now - began_at > OLDEST_S else "sent"
    return "old" if now - told[2] > TOLD_S or now - told[1] > OLDEST_S else told[0]


def test_the_page_says_of_a_press_what_is_assumed_here() -> None:
    if shutil.which("node") is None:
        pytest.skip("node is not installed")
    chance, draws = random.Random(3), []
    for _ in range(300):
        now, of = 10.0, chance.uniform(8.0, 10.0)
        told = None if chance.random() < 0.1 else ("flown", of, chance.uniform(of, now))
        draws.append((told, chance.uniform(8.0, 10.0), now))
    script = f"""
      import {{Socket}} from {json.dumps(str(STATIC / "socket.js"))};
      const draws = {json.dumps(draws)};
      console.log(JSON.stringify(draws.map(([told, began, now]) => {{
        globalThis.performance = {{now: () => 1000 * now}};
        const fate = told && {{fate: told[0], of: 1000 * told[1], at: 1000 * told[2]}};
        return Socket.prototype.fateSince.call({{fate}}, 1000 * began);
      }})));
    """
    node = ["node", "--input-type=module", "-e", script]
    found = subprocess.run(node, capture_output=True, text=True, check=True).stdout
    assert json.loads(found) == [fate_since(*draw) for draw in draws]


Disturbance = Callable[[World], Awaitable[None]]


async def meanwhile(world: World) -> None:
    """While nothing can be known, the pilot may take the aircraft."""
    await anyio.sleep(world.chance.uniform(0.05, 1.0))
    if world.chance.random() < 0.6:
        world.rig.aircraft.leave_f()
    await anyio.sleep(world.chance.uniform(0.2, 3.0))
    world.rig.aircraft.return_to_f()


def hop(name: str, how: str) -> Disturbance:
    async def disturb(world: World) -> None:
        one = world.hops[name]
        one.is_stalled, one.drops = how == "stalls", how == "drops"
        if how == "delays":
            one.delay_s += world.chance.uniform(0.05, 1.0)
        await meanwhile(world)
        one.clear()

    return disturb


def line(**which: bool) -> Disturbance:
    async def disturb(world: World) -> None:
        world.rig.aircraft.line.stall(**which)
        await meanwhile(world)
        world.rig.aircraft.line.stall(to_host=False, to_aircraft=False)

    return disturb


async def pilot(world: World) -> None:
    world.rig.aircraft.leave_f()
    await anyio.sleep(world.chance.uniform(0.3, 2.0))
    world.rig.aircraft.return_to_f()
    await anyio.sleep(world.chance.uniform(0.3, 2.0))


async def stop(world: World) -> None:
    await world.rig.agent.stop()
    await anyio.sleep(world.chance.uniform(0.3, 2.0))


async def take_over(world: World) -> None:
    leases, agent = world.rig.agent.leases, world.rig.agent
    lease = leases.confirm(leases.ask_take_over("other", agent.now).token, agent.now)
    await anyio.sleep(world.chance.uniform(0.3, 2.0))
    leases.release(lease.token, agent.now)


async def own_stop(world: World) -> None:
    world.count += 1
    stop = {"op": "stop", "n": world.count, "at": 1000 * anyio.current_time()}
    world.hops["page to station"].put(json.dumps(stop))
    await anyio.sleep(world.chance.uniform(0.3, 2.0))


async def nothing(world: World) -> None:
    await anyio.sleep(world.chance.uniform(0.3, 2.0))


DISTURBANCES: dict[str, Disturbance] = {
    **{
        f"{name} {how}": hop(name, how)
        for name in ("page to station", "station to agent", "agent to station", "station to page")
        for how in ("stalls", "delays", "drops")
    },
    "agent to aircraft stalls": line(to_host=False),
    "aircraft to agent stalls": line(to_aircraft=False),
    "the line stalls": line(),
    **{one.__name__: one for one in (pilot, stop, take_over, own_stop, nothing)},
}


@pytest.mark.parametrize("seed", range(16))
async def test_whatever_a_hop_does_the_page_says_what_is_so(seed: int) -> None:
    world = World(seed)
    async with world.running():
        await world.fly()
        for what in world.chance.sample(sorted(DISTURBANCES), 7):
            world.what = what
            await DISTURBANCES[what](world)
            await anyio.sleep(world.chance.uniform(0.0, 1.5))
            await world.fly()
    assert world.lies == [], f"seed {seed}"
    assert world.shown[Fate.FLOWN] > 100
