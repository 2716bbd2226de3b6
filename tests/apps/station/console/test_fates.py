"""What a page says of its orders while any hop refuses, delays or drops: only what is so.

The page is its own socket, steering and orders, in a process of node without a screen, on virtual
time. Its operator holds W, or lets the aircraft fly to a point. Each draw disturbs one hop at a
time, for a time: from the page to the station, from there to the agent, from there to the aircraft,
and back. Or the pilot, another operator, a STOP, the fence or a reload of the page comes between.
Nothing that pad, target, status line, problem and the list of unanswered orders claim may differ
from the virtual aircraft's own state for longer than 300 ms and the usual delay of the hops.
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
from m100link.apps.agent.orders import Life
from m100link.apps.agent.server.server import STATE_INTERVAL
from m100link.apps.station.console import page as console_page
from m100link.apps.station.console.tab import Fate, Tab
from m100link.apps.station.console.view.fly import live
from m100link.apps.station.console.view.header import Cause, status_line
from m100link.apps.station.console.view.map import Pointed, click_of
from m100link.apps.station.console.view.situation import Inputs, situation_of
from m100link.geodesy import LocalFrame
from m100link.protocol.records import Device, Position
from m100link.sim.virtual import VirtualAircraft
from tests.apps.station.conftest import Rig

pytestmark = [
    pytest.mark.anyio,
    pytest.mark.skipif(shutil.which("node") is None, reason="node is not installed"),
]

HERE = Path(__file__).parent
STATIC = Path(console_page.__file__).parent / "static"

BEAT_S, LOOK_S, ANSWER_S = 0.05, 0.02, 3.0
VIEW_S = 0.25 + STATE_INTERVAL
"""Seconds by which what the station shows of the agent's state may be older than telemetry."""

MOVEMENT_TIMEOUT_S, NOISE_M_S = 0.5, 0.05
PATIENCE_S = 0.3
"""For which a claim may differ from what is so, beside the usual delay of its way."""

SPEED_M_S = 0.5
FOLLOWED = 0.3
"""Part of what is held that the aircraft has to fly before anything is called flown."""

NEAR_M = 3.0
"""From its target, where a flight was flown to its end."""

ELSEWHERE = (Fate.NO_CONTROL, Fate.OTHER, Fate.PILOT)
OTHERS = (Cause.SWITCH, Cause.OTHER, Cause.RC, Cause.FREE_RC)
NOT_FLOWN = frozenset(Fate) - {Fate.SENT, Fate.ACCEPTED, Fate.FLOWN, Fate.OLD, Fate.IGNORED}
OVER = (Life.REFUSED, Life.DONE, Life.ENDED)


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

    def empty(self) -> None:
        self._waiting.clear()

    def clear(self) -> None:
        self.delay_s, self.is_stalled, self.drops = self.usual_s, False, False
        self._waiting = deque((0.0, one) for _, one in self._waiting)


class Page:
    """The page's own scripts, on the time of this loop: see ``page.mjs``."""

    def __init__(self, kept: str = "[]") -> None:
        command = ["node", str(HERE / "page.mjs"), str(STATIC), kept]
        self._node = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        self.heard: list[Any] = []
        self.shown: dict[str, Any] = {}

    def do(self, *done: tuple[str, Any]) -> None:
        """What the operator does now."""
        assert self._node.stdin is not None
        assert self._node.stdout is not None
        step = {"at": 1000 * anyio.current_time(), "heard": self.heard, "done": done}
        print(json.dumps(step), file=self._node.stdin, flush=True)
        self.heard = []
        self.shown = json.loads(self._node.stdout.readline())

    def close(self) -> None:
        self._node.kill()
        self._node.communicate()


class View(NamedTuple):
    """What the station shows of its own, four times a second."""

    cause: Cause | None = None  # of the status line
    age: float = math.inf  # that stands beside it, s
    target: Life | None = None  # of the flight that is drawn on the map; None for none
    has_problem: bool = False


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
        self.deaf_at, self.disturbed_at = -math.inf, -math.inf
        self.view, self.view_at = View(), -math.inf
        self.is_holding = False
        self.names: dict[int, str] = {}  # of presses
        self.waiting: dict[str, float] = {}  # presses without an answer, and since when
        self.has_problem: bool | None = None  # None: either is right
        self.goal: tuple[float, float] | None = None  # of the last flight; None after keys

    @property
    def is_disturbed(self) -> bool:
        line = self.rig.aircraft.line
        hops = any(
            hop.is_stalled or hop.drops or hop.delay_s > hop.usual_s for hop in self.hops.values()
        )
        return hops or line.to_host.is_stalled or line.to_aircraft.is_stalled

    @property
    def usual_s(self) -> float:
        return sum(hop.usual_s for hop in self.hops.values())

    @asynccontextmanager
    async def running(self) -> AsyncIterator[None]:
        slow = self.chance.uniform
        async with self.rig.running():
            self.tab, self.page = Tab(self.rig.front, "page"), Page()
            ours, its = self.rig.channels
            self.hops = {
                "page to station": Hop(slow(0.001, 0.03), self._at_station),
                "station to agent": Hop(slow(0.001, 0.02), ours.send),
                "agent to station": Hop(slow(0.001, 0.02), its.send),
                "station to page": Hop(slow(0.001, 0.03), self._at_page),
            }
            for end, name in ((ours, "station to agent"), (its, "agent to station")):
                setattr(end, "send", self.hops[name].put)  # noqa: B010 (mypy refuses the other)
            try:
                async with anyio.create_task_group() as self.group:
                    self.group.start_soon(self._run)
                    yield
                    self.group.cancel_scope.cancel()
            finally:
                self.page.close()

    async def _run(self) -> None:
        ticks = 0
        while True:
            for hop in self.hops.values():
                hop.step()
            if ticks % 10 == 0 and self.rig.front.view.hearing is Hearing.HEARD:
                self.hops["station to page"].put(live(self.rig.front.view))
            if ticks % 50 == 0:
                self.hops["station to page"].put(self._look())
            if ticks % 4 == 0:
                self.do()
                self._note()
            ticks += 1
            await anyio.sleep(0.005)

    # -- the page and its operator ---------------------------------------------------------------

    def do(self, *done: tuple[str, Any]) -> None:
        self.page.do(*done)
        for text in self.page.shown["sent"]:
            self.hops["page to station"].put(text)

    def order(self, what: str, order: orders.Order | None = None) -> None:
        """Press a button; STOP goes by the socket, all others by the page's other connection."""
        now = anyio.current_time()
        name = f"{what} {len(self.names)}"
        self.do(("press", name))
        [press] = self.page.shown["results"]
        self.names[press], self.waiting[name], self.has_problem = name, now, None
        if order is not None:
            told = {"press": press, "at": 1000 * now, "order": order}
            self.hops["page to station"].put(told)

    async def ready(self) -> None:
        """Have control, and be in the air, with nothing held."""
        await self.let_go()
        self.do()
        told = self.page.shown["unanswered"].split(", ")
        self.do(("seen", None))
        self.waiting = {name: at for name, at in self.waiting.items() if name not in told}
        while not self.tab.session.has_control:
            await self.tab.attempt(self.tab.session.obtain)
            await anyio.sleep(0.5)
        if self.rig.front.view.is_on_ground is not False:
            await self.tab.attempt(lambda: self.tab.ask(orders.TakeOff()))

    async def fly(self) -> None:
        """Hold the key anew."""
        await self.ready()
        self.has_problem, self.goal, self.is_holding = None, None, True
        self.do(("down", "KeyW"))
        await anyio.sleep(self.chance.uniform(0.5, 2.0))

    async def go(self) -> None:
        """Let it fly to a point."""
        await self.ready()
        north = self.chance.uniform(20.0, 60.0)
        self.goal = self._at[0] + north, self._at[1]
        self.order("go", orders.FlyTo(*self.place(north), height=5.0))
        await anyio.sleep(self.chance.uniform(0.5, 4.0))

    @property
    def _at(self) -> tuple[float, float]:
        motion = self.rig.aircraft.vehicle.flight.dynamics
        return motion.north, motion.east

    def place(self, north: float) -> tuple[float, float]:
        here = self.rig.front.view.get(Position)
        assert here is not None
        return LocalFrame(here.latitude_deg, here.longitude_deg).to_geodetic(north, 0.0)

    async def let_go(self) -> None:
        self.is_holding = False
        self.do(("up", "KeyW"))
        await anyio.sleep(0.6)

    def load_anew(self) -> None:
        """The socket is gone, and what was under way with it; the new page knows what was kept."""
        self.tab.lost()
        for name in ("page to station", "station to page"):
            self.hops[name].empty()
        kept = self.page.shown["kept"]
        self.page.close()
        self.page, self.tab = Page(kept), Tab(self.rig.front, "page")
        self.is_holding, self.view, self.names = False, View(), {}
        self.waiting, self.has_problem = dict.fromkeys(self.waiting, -math.inf), None
        self.do()

    # -- the station -----------------------------------------------------------------------------

    def _at_station(self, message: Any) -> None:
        if isinstance(message, dict):
            self.hops["station to page"].put({"op": "answered", "press": message["press"]})
            self.group.start_soon(self._carry_out, message)
            return
        answer = self.tab.receive(message)
        if answer is not None and self.rig.front.view.hearing is Hearing.HEARD:
            self.hops["station to page"].put(answer)

    async def _carry_out(self, message: dict[str, Any]) -> None:
        tab = self.tab

        async def work() -> None:
            tab.check_order(message["at"])
            await tab.ask(message["order"])

        await tab.attempt(work)

    def _look(self) -> View:
        view, session = self.rig.front.view, self.tab.session
        line = status_line(situation_of(Inputs(vehicle=view, has_lease=session.has_lease)))
        click = click_of(
            Pointed(), None, view.state.guided, has_control=True, own=self.tab.shown_flight()
        )
        target = click.flown.life if click.flown.place is not None else None
        age = live(view).get("age", math.inf)
        return View(line.cause, age, target, self.tab.refusal is not None)

    def _at_page(self, message: Any) -> None:
        if isinstance(message, View):
            self.view, self.view_at = message, anyio.current_time()
            return
        if (press := message.get("press")) is not None:
            self.waiting.pop(self.names[press], None)
        if message["op"] == "answered":
            self.do(("answered", press))
        else:
            self.page.heard.append(message)

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
        if aircraft.line.to_aircraft.is_stalled:
            self.deaf_at = now
        if self.is_disturbed:
            self.disturbed_at = now
        if now - self.deaf_at <= MOVEMENT_TIMEOUT_S:  # it flies by what it has: nobody can know
            extra += MOVEMENT_TIMEOUT_S
        so = So(
            now,
            pad=self.page.shown.get("pad") or "",
            view=self.view,
            is_view_new=self.view.age + now - self.view_at <= PATIENCE_S,
            is_ours=is_onboard and lease is not None,
            goes_out=flying is not None and flying.is_steered,
            is_driven=is_onboard and is_ours and now - self.moved_at <= MOVEMENT_TIMEOUT_S,
            moves=motion.velocity_north >= FOLLOWED * SPEED_M_S - NOISE_M_S,
            is_guided=flying is not None and flying.guiding.current() is not None,
            is_calm=now - self.disturbed_at > 1.0,
            far_m=0.0 if self.goal is None else math.dist(self.goal, self._at),
            allowed_s=PATIENCE_S + self.usual_s + BEAT_S + LOOK_S + extra,
        )
        self.shown[so.pad] += 1
        if so.is_view_new and so.view.target is not None:
            self.shown[f"target {so.view.target.value}"] += 1
        self.allowed_s = max(so.allowed_s, self.allowed_s - LOOK_S)
        self._judge(so, self._claims(so) | self._claims_of_orders(now))
        self._judge(so, self._claims_of_view(so), VIEW_S)

    def _claims(self, so: So) -> dict[str, bool]:
        """Of the pad and the status line, whether each differs from what is so."""
        is_ours = so.pad in (Fate.ACCEPTED, Fate.FLOWN, Fate.IGNORED)
        cause = so.view.cause
        return {
            "it moves so": so.pad == Fate.FLOWN and not so.moves,
            "it is sent that": is_ours and not so.goes_out,
            "it is not flown": so.pad in NOT_FLOWN and so.is_driven and so.moves,
            "nobody has answered": so.pad in (Fate.SENT, Fate.OLD) and so.is_calm,
            "something is held": so.pad not in ("", Fate.LET_GO) and not self.is_holding,
            "as its words": so.pad != "" and self.page.shown["did"] != f"fate_{so.pad}",
            "you have control": so.is_view_new and cause is Cause.YOURS and not so.is_ours,
            "others have it": so.is_view_new and cause in OTHERS and so.is_ours,
            "as the banner": is_ours and cause is not Cause.YOURS,
            "the banner, too": so.pad in ELSEWHERE and cause is Cause.YOURS,
        }

    def _claims_of_view(self, so: So) -> dict[str, bool]:
        """The same of the target on the map, and of the problem."""
        target, is_asked = so.view.target, self.has_problem is not None
        differs = {
            "it flies there": target in (Life.ACCEPTED, Life.FLOWN) and not so.is_guided,
            "it is over": target in OVER and so.is_guided,
            "it was reached": target is Life.DONE and so.far_m > NEAR_M,
            "a problem": is_asked and so.view.has_problem is not self.has_problem,
            "flown, and a problem": so.pad == Fate.FLOWN and so.view.has_problem,
            "refused without a problem": so.pad == Fate.REFUSED and not so.view.has_problem,
        }
        return {claim: does and so.is_view_new for claim, does in differs.items()}

    def _claims_of_orders(self, now: float) -> dict[str, bool]:
        """The same of what the page says by itself of presses without an answer."""
        told = {one for one in self.page.shown["unanswered"].split(", ") if one}
        late = {name for name, at in self.waiting.items() if now - at > ANSWER_S}
        return {"all is answered": not late <= told, "unanswered": not told <= set(self.waiting)}

    def _judge(self, so: So, differs: dict[str, bool], more_s: float = 0.0) -> None:
        """Each claim may differ from what is so, but not for longer than is allowed."""
        for claim, does in differs.items():
            since = self.since.setdefault(claim, so.at) if does else self.since.pop(claim, so.at)
            if so.at - since > self.allowed_s + more_s:
                self.lies.append(f"{claim}, since {since:.2f}, during {self.what}: {so}")


class So(NamedTuple):
    """What was said and what was so at one moment."""

    at: float
    pad: str
    view: View
    is_view_new: bool  # the age that stands beside it says so
    is_ours: bool  # the aircraft obeys the agent, under the lease of the page
    goes_out: bool  # the agent sends it the setpoint of the page
    is_driven: bool  # it got that lately, and obeys
    moves: bool  # to the north, as is held
    is_guided: bool  # the agent flies it to a point
    is_calm: bool  # no hop was slow, or lost anything, for a second
    far_m: float  # from that point; 0 for none
    allowed_s: float


Disturbance = Callable[[World], Awaitable[None]]


async def meanwhile(world: World) -> None:
    """While nothing can be known, a button is pressed, and the pilot may take the aircraft."""
    if world.chance.random() < 0.5:
        world.order("activate", orders.Activate())
    await anyio.sleep(world.chance.uniform(0.05, 1.0))
    if world.chance.random() < 0.6:
        world.rig.aircraft.leave_f()
    await anyio.sleep(world.chance.uniform(0.2, 4.0))
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
    world.order("stop")
    world.has_problem = False
    await anyio.sleep(world.chance.uniform(0.3, 2.0))


async def too_far(world: World) -> None:
    """A flight that the fence refuses; beats go on without a problem."""
    is_quiet = not world.is_holding
    world.order("far", orders.FlyTo(*world.place(9000.0), height=5.0))
    world.has_problem = True if is_quiet else None
    await anyio.sleep(world.chance.uniform(0.3, 2.0))


async def reload(world: World) -> None:
    world.load_anew()
    await anyio.sleep(world.chance.uniform(1.0, 3.0))


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
    **{one.__name__: one for one in (pilot, stop, take_over, own_stop, too_far, reload, nothing)},
}


@pytest.mark.parametrize("seed", [*range(16), 56])  # 56 loses the outcome of a flight
async def test_whatever_a_hop_does_the_page_says_what_is_so(seed: int) -> None:
    world = World(seed)
    async with world.running():
        await world.fly()
        for what in world.chance.sample(sorted(DISTURBANCES), 7):
            world.what = what
            await DISTURBANCES[what](world)
            await anyio.sleep(world.chance.uniform(0.0, 1.5))
            await world.chance.choice([world.fly, world.go])()
    assert world.lies == [], f"seed {seed}"
    assert world.shown[Fate.FLOWN] > 50


# -- one thing after the other, and when it is shown --------------------------------------------
# What a draw allows for, 300 ms and slow ways, hides mistakes. Here each way takes 10 ms.

LOOKS_S = 0.04
"""Between two looks at the page: a beat and both ways take as long."""


class Scene:
    """One thing happens on a page with fast ways, and each change that its operator then sees."""

    def __init__(self, world: World) -> None:
        self.world, self._before = world, dict[str, Any]()
        self._wrong: list[str] = []

    @classmethod
    @asynccontextmanager
    async def begun(cls, *, is_ready: bool = True) -> AsyncIterator[Scene]:
        world = World(1)
        async with world.running():
            for one in world.hops.values():
                one.usual_s = one.delay_s = 0.01
            if is_ready:
                await world.ready()
            scene = cls(world)
            scene._before = scene._look()
            yield scene
        assert not scene._wrong, "\n".join(scene._wrong)

    def _look(self) -> dict[str, Any]:
        view, shown = self.world._look(), self.world.page.shown
        seen = {"pad": shown.get("pad") or "", "told": shown.get("unanswered") or ""}
        return seen | {"cause": view.cause, "target": view.target, "problem": view.has_problem}

    async def shows(self, seconds: float, /, **wanted: list[tuple[Any, float, float]]) -> None:
        """Each change of these within so many seconds: to what, and between which times, s."""
        began, seen = anyio.current_time(), dict[str, list[tuple[Any, float]]]()
        while (at := anyio.current_time() - began) < seconds:
            look = self._look()
            for what, value in look.items():
                if value != self._before[what]:
                    seen.setdefault(what, []).append((value, at))
            self._before = look
            await anyio.sleep(LOOKS_S)
        for what, changes in wanted.items():
            came = seen.get(what, [])
            is_so = [value for value, _ in came] == [value for value, *_ in changes] and all(
                first <= at <= last + 2 * LOOKS_S
                for (_, at), (_, first, last) in zip(came, changes, strict=True)
            )
            if not is_so:
                self._wrong.append(f"{what}: {came}, wanted {changes}")

    def key(self, what: str, code: str = "KeyW") -> None:
        self.world.is_holding = what == "down"
        self.world.do((what, code))

    def way(self, name: str, **how: Any) -> None:
        for what, value in how.items():
            setattr(self.world.hops[name], what, value)

    async def is_flown(self) -> None:
        """Hold W anew, until it is flown."""
        self.key("up")
        await self.world.ready()
        self.key("down")
        await self.shows(1.5)
        if self._before["pad"] != Fate.FLOWN:
            self._wrong.append(f"a held key: {self._before}")

    def flies(self, north: float, name: str = "go") -> None:
        self.world.order(name, orders.FlyTo(*self.world.place(north), height=5.0))


SEEN = [(Fate.SENT, 0.0, 0.0), (Fate.ACCEPTED, 0.05, 0.25), (Fate.FLOWN, 0.3, 0.8)]
"""A key: an agent reports ten times a second, and 0.15 m/s of 0.5 are enough."""


@pytest.mark.slow
async def test_a_key_is_green_while_it_is_flown_and_not_longer() -> None:
    async with Scene.begun() as scene:
        scene.key("down")
        await scene.shows(1.5, pad=SEEN, problem=[], cause=[], told=[])
        scene.key("up")
        await scene.shows(0.4, pad=[("", 0.0, 0.0)])
        scene.way("page to station", drops=True)
        scene.key("down")
        await scene.shows(1.0, pad=[(Fate.SENT, 0.0, 0.0), (Fate.OLD, 0.7, 0.75)])
        scene.way("page to station", drops=False)
        # A press of which the agent knows nothing: what goes out is that of the one before.
        await scene.is_flown()
        scene.way("station to agent", is_stalled=True)
        await scene.shows(0.16)
        scene.key("up")
        await scene.shows(0.04)
        scene.key("down")
        await scene.shows(0.25, pad=[(Fate.SENT, 0.0, 0.0)])
        scene.way("station to agent", is_stalled=False)
        scene.key("up")
        # It still moves so, and what the page heard of the press before says nothing of this one.
        scene.way("station to page", delay_s=0.25)
        await scene.shows(0.5)
        scene.key("down")
        await scene.shows(1.5)
        scene.key("up")
        await scene.shows(0.04)
        scene.key("down")
        late = [(Fate.SENT, 0.0, 0.04), (Fate.FLOWN, 0.25, 0.5)]
        await scene.shows(1.5, pad=late)
        # The other way round: it moves, but against what is held.
        scene.way("station to page", delay_s=0.01)
        scene.key("up")
        scene.key("down", "KeyS")
        await scene.shows(2.0)
        scene.key("up", "KeyS")
        scene.key("down")
        await scene.shows(1.5, pad=[SEEN[0], SEEN[1], (Fate.FLOWN, 0.5, 1.2)])


@pytest.mark.slow
async def test_where_news_stay_out_the_pad_is_old_in_a_third_of_a_second() -> None:
    async with Scene.begun() as scene:
        for name in ("station to page", "agent to station"):
            await scene.is_flown()
            scene.way(name, drops=True)
            told = Cause.AIRCRAFT_SILENT if name == "agent to station" else None
            await scene.shows(
                1.3, pad=[(Fate.OLD, 0.25, 0.4)], cause=[(told, 0.9, 1.1)] * bool(told)
            )
            scene.way(name, drops=False)
            await scene.shows(0.5)
        await scene.is_flown()
        scene.key("down", "KeyS")  # so it is held where it is, which no telemetry has to show
        await scene.shows(1.0, pad=[(Fate.ACCEPTED, 0.0, 0.5)])
        scene.way("agent to station", drops=True)
        await scene.shows(0.9, pad=[(Fate.OLD, 0.25, 0.4)])
        scene.way("agent to station", drops=False)
        scene.key("up", "KeyS")
        await scene.is_flown()
        scene.world.rig.aircraft.line.stall(to_aircraft=False)
        await scene.shows(0.9, pad=[(Fate.OLD, 0.25, 0.4)])


@pytest.mark.slow
async def test_what_the_aircraft_does_not_follow_is_no_longer_green() -> None:
    async with Scene.begun() as scene:
        await scene.is_flown()
        scene.world.rig.aircraft.line.stall(to_host=False)  # it brakes after half a second
        await scene.shows(2.0, pad=[(Fate.ACCEPTED, 0.5, 1.7)])
        await scene.shows(3.0, pad=[(Fate.IGNORED, 2.3, 2.8)])
        scene.world.rig.aircraft.line.stall(to_aircraft=False, to_host=False)
        await scene.shows(1.0, pad=[(Fate.FLOWN, 0.2, 0.8)])


@pytest.mark.slow
async def test_whoever_else_flies_is_named_and_a_held_key_flies_no_more() -> None:
    async with Scene.begun(is_ready=False) as scene:
        rig = scene.world.rig
        await scene.shows(1.0)  # a page that was just loaded takes no key
        scene.key("down")
        await scene.shows(0.4, pad=[(Fate.SENT, 0.0, 0.0), (Fate.NO_CONTROL, 0.02, 0.1)])
        await scene.is_flown()
        rig.aircraft.leave_f()
        await scene.shows(0.6, pad=[(Fate.PILOT, 0.05, 0.2)], cause=[(Cause.SWITCH, 0.0, 0.1)])
        rig.aircraft.return_to_f()
        again = [(Fate.LET_GO, 0.05, 0.2)]
        await scene.shows(0.6, pad=again, cause=[(Cause.YOURS, 0.0, 0.1)])
        await scene.is_flown()
        await rig.agent.stop()
        await scene.shows(0.6, pad=again, problem=[(True, 0.0, 0.1)])
        await scene.is_flown()
        leases, now = rig.agent.leases, rig.agent.now
        lease = leases.confirm(leases.ask_take_over("other", now).token, now)
        other = [(Fate.OTHER, 0.02, 0.2)]
        await scene.shows(0.6, pad=other, cause=[(Cause.OTHER, 0.0, 0.1)])
        leases.release(lease.token, rig.agent.now)
        free = [(Fate.NO_CONTROL, 0.02, 0.2)]
        await scene.shows(0.6, pad=free, cause=[(Cause.FREE, 0.0, 0.1)])


@pytest.mark.slow
async def test_a_target_is_what_becomes_of_its_flight_and_goes_ten_seconds_after() -> None:
    begins = [(Life.SENT, 0.0, 0.02), (Life.ACCEPTED, 0.06, 0.15), (Life.FLOWN, 0.5, 1.2)]
    async with Scene.begun() as scene:
        scene.way("agent to station", delay_s=0.05)
        scene.flies(3.0)
        await scene.shows(7.0, target=[*begins, (Life.DONE, 2.0, 6.0)], problem=[])
        refused = [(Life.SENT, 0.0, 0.02), (Life.REFUSED, 0.06, 0.15)]
        scene.flies(9000.0)
        await scene.shows(11.0, target=[*refused, (None, 9.9, 10.2)], problem=[(True, 0.02, 0.1)])
        scene.flies(60.0)
        await scene.shows(1.5, target=begins, problem=[(False, 0.0, 0.1)])
        scene.world.rig.aircraft.leave_f()
        await scene.shows(1.0, target=[(Life.ENDED, 0.0, 0.3)], problem=[])
        scene.world.rig.aircraft.return_to_f()
        await scene.world.ready()
        scene.flies(60.0)
        await scene.shows(1.5)
        scene.way("agent to station", drops=True)  # and so the outcome of the flight is lost
        await scene.world.rig.agent.stop()
        await scene.shows(0.8)
        scene.way("agent to station", drops=False)
        await scene.shows(1.5, target=[(Life.FLOWN, 0.0, 0.1), (Life.SENT, 0.5, 0.8)])


@pytest.mark.slow
async def test_a_press_is_told_after_three_seconds_without_its_own_answer() -> None:
    async with Scene.begun() as scene:
        world = scene.world
        scene.way("page to station", drops=True)
        world.order("lost", orders.Activate())
        world.order("stop")
        await scene.shows(1.0, told=[])
        scene.way("page to station", drops=False)
        world.order("heard", orders.Activate())  # which answers nothing but itself
        await scene.shows(3.0, told=[("lost 0, stop 1", 1.96, 2.04)])
        world.do(("seen", None))
        await scene.shows(0.1, told=[("", 0.0, 0.0)])
        scene.way("station to page", is_stalled=True)
        await scene.shows(1.3)
        world.order("at once", orders.Activate())  # to a station that is not heard
        await scene.shows(0.3, told=[("at once 3", 0.0, 0.04)])
        scene.way("station to page", is_stalled=False)
        await scene.shows(0.3, told=[("", 0.0, 0.06)])
        scene.way("page to station", drops=True)
        world.order("gone", orders.Activate())
        await scene.shows(0.1)
        scene.way("page to station", drops=False)
        world.load_anew()
        await scene.shows(0.2, told=[("gone 4", 0.0, 0.0)])
        world.do(("seen", None))
        world.load_anew()  # what somebody has seen is over
        await scene.shows(0.2, told=[("", 0.0, 0.0)])
