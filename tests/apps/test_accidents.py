"""Ten accidents with two stations each, and twelve questions of an investigator to the file alone.

Answers are read as a user reads them: the sentences of ``m100link log report`` and the numbers of
``m100link log info``. The truth beside them is that of the virtual aircraft, seen a hundred times a
second, and of the script that staged the accident; it never comes from a reader of logs.
"""

from __future__ import annotations

import asyncio
import json
import math
import re
import sys
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, redirect_stdout, suppress
from io import StringIO
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from m100link.apps.agent import orders
from m100link.apps.agent.server import connection as agent_connection
from m100link.apps.cli.app import run
from m100link.apps.mavlink.translator.numbers import MissionResult, MissionType
from m100link.apps.mavlink.translator.vehicle_state import Mode
from m100link.link import Direction
from m100link.log import Recorder
from m100link.protocol.commands.control import Move
from m100link.protocol.records import Device, FlightPhase
from m100link.sim.clock import virtual_clock_loop
from m100link.sim.line import LineDirection, LineFaults
from tests.apps.every_front import (
    OTHER,
    BesideAnAgent,
    Console,
    FleetPilot,
    Mavlink,
    Ros2,
    Rosbridge,
)
from tests.apps.mavlink.translator.test_missions import Exchange, item, waypoint
from tests.rig import TimedMoves

pytest.importorskip("mcap.writer", reason="the extra `log` is not installed")

pytestmark = pytest.mark.slow

GCS = "MAVLink 245 at 127.0.0.1:14540"
LIMITS = "at most 50 m high, 150 m from where control is obtained, 10 m/s, battery at least 20 %"
"""Of an agent's guards without options (docs/reference/guards.md)."""
SEEN_S = 0.01  # the aircraft is looked at so often
PHASES = {
    FlightPhase.STANDBY: "ground",
    FlightPhase.TAKING_OFF: "take-off",
    FlightPhase.IN_AIR: "flight",
    FlightPhase.LANDING: "landing",
    FlightPhase.FINISHING_LANDING: "landing",
}


# -- the truth -------------------------------------------------------------------------------------


class Seen(NamedTuple):
    """The virtual aircraft at one moment of the event loop's clock, s; metres, m/s, %."""

    at: float
    place: tuple[float, float, float]  # north, east, height
    velocity: tuple[float, float, float]  # north, east, up
    obeys: Device
    phase: str
    switch: str
    battery: float
    gps: int
    frames: int  # on the line to the host, and of them those that did not come whole
    lost: int
    damaged_bytes: int

    @property
    def speed(self) -> float:
        return math.hypot(*self.velocity)


class Truth:
    """What the aircraft did, and what the script did and expects."""

    def __init__(self, front: BesideAnAgent) -> None:
        self.front = front
        self.seen: list[Seen] = []
        self.moves = TimedMoves()  # as they came to the aircraft
        self.damaged_bytes = 0  # of frames that were damaged on their way to the host
        self.holders: list[tuple[float, str]] = []
        self.caused_at = self.cut_at = math.nan
        self.silent_at = math.inf  # from then on nothing comes to the host
        # What the script did, or had done: patterns, in their order.
        self.changes: list[str] = []  # why control changed
        self.last_order = ("", "")  # before the cause: by whom, which
        self.ended_by = ""
        self.refused: list[tuple[str, str]] = []  # whose wish, and why
        self.asked: list[str] = []  # changes of the mode, and who asked for them
        self.in_force = [LIMITS]
        self.lost_front: str | None = None
        self.silence_s = 0.0

    def now(self) -> float:
        return asyncio.get_running_loop().time()

    def holds(self, name: str, why: str) -> None:
        """From now on this client holds the lease; empty for nobody."""
        self.holders.append((self.now(), name))
        self.changes.append(why)

    def cause(self) -> None:
        """Now it happens."""
        self.caused_at = self.now()

    async def watch(self) -> None:
        aircraft = self.front.aircraft
        aircraft.autopilot.received_movements = self.moves
        line, flight = aircraft.line.to_host, aircraft.vehicle.flight
        damage = LineDirection._damage

        def damaged(piece: bytes) -> bytes:
            self.damaged_bytes += len(piece)
            return damage(line, piece)

        line._damage = damaged  # type: ignore[method-assign]
        while True:
            motion = flight.dynamics
            seen = Seen(
                self.now(),
                (motion.north, motion.east, motion.height),
                (motion.velocity_north, motion.velocity_east, motion.velocity_up),
                aircraft.vehicle.authority.device,
                PHASES[flight.phase],
                aircraft.remote.mode.name,
                aircraft.battery_percent,
                aircraft.gps_health,
                line.frames,
                line.lost + line.damaged,
                self.damaged_bytes,
            )
            self.seen.append(seen)
            await asyncio.sleep(SEEN_S)

    def at(self, at: float) -> Seen:
        return min(self.seen, key=lambda one: abs(one.at - at))


class Filed(Recorder):
    """A recorder whose process may be killed; the script knows when its file begins."""

    began_at: float | None = None

    def tap(self, direction: Direction, data: bytes, now: float) -> None:
        if self.began_at is None:
            self.began_at = now
        super().tap(direction, data, now)

    async def kill(self) -> None:
        """Nothing more is written, and the file has no end, as after SIGKILL."""
        self._hand_over()
        self._is_ended = True
        self._look = tuple
        self._log._writer.finish = self._log.flush


# -- the accidents ---------------------------------------------------------------------------------


class Staged:
    """A flight at one front, with somebody else at another station of the same aircraft."""

    front: type[BesideAnAgent]
    name: str  # of the client that flies, as it calls itself
    after_s = 5.0  # watched after the accident
    faults = LineFaults()

    async def fly(self, front: Any, truth: Truth) -> None:
        """Until it flies north with 2 m/s."""
        task = asyncio.ensure_future(front.take_control())
        while not task.done():
            await front.passes(0.05)
        await task
        truth.holds(self.name, "gave|acquired")
        truth.last_order = self.name, "obtain"
        front.is_sending = True
        await front.passes(3.0)

    async def happen(self, front: Any, truth: Truth) -> None:
        """The accident."""
        raise NotImplementedError


class Killed(Staged):
    """The operator's program dies in flight."""

    front, name = Mavlink, GCS

    async def happen(self, front: Any, truth: Truth) -> None:
        truth.cause()
        await front.kill()
        truth.holds("", "ended: the lease has ended.\n.*its front has gone")
        truth.ended_by = "mavlink left: its connection ended"
        truth.lost_front = "mavlink"


class Climbing(Rosbridge):
    axes = (-1.0, 2.0, 0.5, 0.0)


class TakenOver(Staged):
    """A second station takes control over in a climb, on a line that damages frames."""

    front, name, faults = Climbing, "program", LineFaults(damage=0.05)

    async def happen(self, front: Any, truth: Truth) -> None:
        truth.refused.append(("another station", "program has control"))
        front.other.call("/dji_sdk/sdk_control_authority", control_enable=1)
        await front.passes(1.0)
        truth.cause()
        assert await front.take_over()
        truth.cause()
        truth.holds(OTHER, f"taken over from {self.name}")
        truth.last_order = "another station", "confirm take over"
        truth.ended_by = f"{OTHER} has the lease .taken over from {self.name}"
        truth.refused.append((self.name, f"{OTHER} has control"))


class PilotTakes(Staged):
    """The pilot takes over by the mode switch."""

    front, name = Ros2, "ROS 2"

    async def happen(self, front: Any, truth: Truth) -> None:
        truth.cause()
        front.aircraft.leave_f()
        truth.holds("", "the pilot (left F|moved the mode switch)")
        truth.last_order = self.name, "release lease"  # as its page says
        truth.asked.append("The pilot's mode switch was in P")
        truth.ended_by = "lost: the pilot left F"


class Unplugged(Staged):
    """The cable is pulled."""

    front, name = Console, "tab"

    async def happen(self, front: Any, truth: Truth) -> None:
        truth.cause()
        front.aircraft.unplug()
        truth.holds("", "went away|link")
        truth.ended_by = "The connection ended: sim:// went away"
        truth.refused.append((self.name, "the aircraft is not connected"))
        truth.silent_at = truth.now()


class MissionRefused(Staged):
    """A mission is refused, another one flown; then somebody at the other station presses STOP."""

    front, name = Mavlink, GCS
    after_s = 6.0

    async def fly(self, front: Any, truth: Truth) -> None:
        ground = front.rig.ground
        found = await Exchange(ground).upload([waypoint(500.0, 0.0), waypoint(520.0, 0.0)])
        assert found is not MissionResult.ACCEPTED
        truth.refused.append((self.name, "the envelope ends at 150 m"))
        truth.refused.append(("mission", "the envelope ends at 150 m"))  # the text at the station
        given = [waypoint(30.0, 0.1, z=4.0), waypoint(30.0, 30.0, z=4.0)]
        assert await Exchange(ground).upload(given) is MissionResult.ACCEPTED
        await ground.arm()
        truth.holds(self.name, "gave|acquired")
        await ground.set_mode(Mode.MISSION)
        truth.asked.append(f"{self.name}: DO_SET_MODE.1, 4, 4.*ACCEPTED")
        flown = "uploaded a mission of 2 items: NAV_WAYPOINT.*22.5433.*; NAV_WAYPOINT.*113.959"
        truth.in_force.append(f"{self.name} {flown}")
        await front.passes(8.0)

    async def happen(self, front: Any, truth: Truth) -> None:
        truth.cause()
        await front.stop_elsewhere()
        truth.last_order = self.name, "hover"  # the bridge takes Hold for its station
        truth.ended_by = f"{OTHER}: STOP"
        truth.refused.append((self.name, "the flight to a place was ended, and .* hovers: stop"))


class FenceHit(Staged):
    """A fence is hit."""

    front, name = Mavlink, GCS
    after_s = 8.0

    async def fly(self, front: Any, truth: Truth) -> None:
        fence = [item(5003, 0.01, 0.01, param1=15.0)]
        found = await Exchange(front.rig.ground).upload(fence, MissionType.FENCE)
        assert found is MissionResult.ACCEPTED
        fenced = "uploaded a fence of 1 items: NAV_FENCE_CIRCLE_INCLUSION.15.*22.543"
        truth.in_force.append(f"{self.name} {fenced}")
        await super().fly(front, truth)

    async def happen(self, front: Any, truth: Truth) -> None:
        aircraft = front.aircraft
        await front.passes(20.0, lambda: aircraft.vehicle.flight.dynamics.speed < 1.8)
        truth.cause()
        truth.last_order = self.name, "hover"
        truth.ended_by = "outside of the fence"
        truth.asked.append(f"{self.name}'s order ended: hover .*outside of the fence")


class BatteryLow(Staged):
    """The battery falls below the floor, and the operator lets it return home."""

    front, name = Console, "tab"
    after_s = 25.0

    async def happen(self, front: Any, truth: Truth) -> None:
        truth.cause()
        front.aircraft.battery_percent = 17.0
        truth.ended_by = "battery"
        truth.refused.append((self.name, "battery"))
        await front.passes(3.0)
        front.let_go()
        tab = front.page.tab
        front.spawn(tab.attempt(lambda: tab.session.ask(orders.GoHome())))
        truth.asked.append(f"{self.name} ordered go home")


class Stopped(Staged):
    """Somebody of the fleet presses STOP."""

    front, name = FleetPilot, "pilot"

    async def happen(self, front: Any, truth: Truth) -> None:
        truth.cause()
        await front.stop_elsewhere()
        truth.ended_by = "anybody: STOP"
        truth.last_order = "fleet", "stop"
        truth.refused.append((self.name, "STOP was pressed"))


class HeartbeatLost(Staged):
    """The ground station falls silent."""

    front, name = Mavlink, GCS

    async def happen(self, front: Any, truth: Truth) -> None:
        truth.cause()
        await front.hang()
        truth.ended_by = "Offboard: setpoints stopped"
        truth.asked.append(f"{self.name} is lost: hold")
        truth.lost_front = f"{self.name} is lost"


class AgentKilled(Staged):
    """The agent is killed, and its file has no end."""

    front, name = Console, "tab"

    async def happen(self, front: Any, truth: Truth) -> None:
        truth.cause()
        await front.lose_agent()
        truth.ended_by = "telemetry ended"
        truth.silent_at = truth.cut_at = truth.now()


ACCIDENTS = (
    Killed, TakenOver, PilotTakes, Unplugged, MissionRefused, FenceHit, BatteryLow, Stopped,
    HeartbeatLost, AgentKilled,
)  # fmt: skip


class Flight(NamedTuple):
    """A staged accident, its file and its truth."""

    staged: Staged
    truth: Truth
    path: Path
    began_at: float
    ended_at: float  # until then somebody watched

    def control(self, until: float) -> list[tuple[float, str]]:
        """Who had control, and since when, s after the beginning of the file; empty for nobody."""
        found = [(0.0, "")]
        for seen in self.truth.seen:
            at = seen.at - self.began_at
            held = [name for since, name in self.truth.holders if since <= seen.at]
            name = held[-1] if held and seen.obeys is Device.ONBOARD else ""
            if at <= until and name != found[-1][1]:
                found.append((at, name))
        return found


async def stage(one: type[Staged], folder: Path) -> Flight:
    recorders: list[Filed] = []

    @asynccontextmanager
    async def recording(_: object) -> AsyncIterator[Recorder]:
        recorders.append(Filed(folder))
        yield recorders[-1]

    staged = one()
    front = staged.front()
    truth = Truth(front)
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(agent_connection, "_recording", recording)
        async with front.open():
            front.aircraft.set_faults(staged.faults)
            watching = asyncio.ensure_future(truth.watch())
            await staged.fly(front, truth)
            await staged.happen(front, truth)
            if not math.isnan(truth.cut_at):
                await recorders[0].kill()
            await front.passes(staged.after_s)
            ended_at = truth.now()
            watching.cancel()
    assert recorders[0].began_at is not None
    return Flight(staged, truth, recorders[0].path, recorders[0].began_at, ended_at)


def m100link(*words: str) -> list[dict[str, Any]]:
    """The objects that a command prints."""
    with pytest.MonkeyPatch.context() as patched, redirect_stdout(StringIO()) as said:
        patched.setattr(sys, "argv", ["m100link", *words])
        with suppress(SystemExit):
            run()
    return [json.loads(line) for line in said.getvalue().splitlines()]


# -- the questions ---------------------------------------------------------------------------------


class Investigator:
    """Answers from a file, about the time of an accident, s after the beginning of the file."""

    def __init__(self, path: Path, at_s: float, end_s: float) -> None:
        said = m100link("log", "report", str(path), "--json")
        [self.info] = m100link("log", "info", str(path), "--json")
        self.at_s, self.end_s = at_s, min(end_s, self.info["duration_s"] + 0.01)
        self.said = [one for one in said if one["at_s"] <= self.end_s]

    def of(self, *kinds: str) -> list[dict[str, Any]]:
        return [one for one in self.said if one["kind"] in kinds]

    def texts(self, since: float, until: float, *kinds: str) -> str:
        return "\n".join(
            one["text"]
            for one in (self.of(*kinds) if kinds else self.said)
            if since <= one["at_s"] <= until
        )

    def control(self) -> list[tuple[float, str]]:
        """Who had control, and since when; empty for nobody."""
        holder, is_held = "", False
        found = [(0.0, "")]
        for one in self.of("lease", "control", "alarm"):
            if one["kind"] == "lease":
                holder = one["who"] if " has the lease (" in one["text"] else ""
            elif one["kind"] == "control":
                is_held = "was obtained" in one["text"]
            elif "authority_lost" in one["text"]:
                is_held = False
            now = holder if is_held else ""
            if now != found[-1][1]:
                found.append((one["at_s"], now))
        return found

    def last_order(self) -> tuple[str, str]:
        """Of whom, and which, at the moment of the accident or before."""
        before = [one for one in self.of("order") if one["at_s"] <= self.at_s + 0.05]
        found = re.search(r"(ordered|order began:|order ended:) (.+?)( \(|\.$)", before[-1]["text"])
        assert found is not None, before[-1]
        return before[-1]["who"], found[2]

    def setpoint(self) -> tuple[float, str] | None:
        """When the last one with motion was sent, and its values."""
        for one in reversed(self.of("sent")):
            found = re.search(r"last with motion at ([0-9.]+) s: (.*)\.", one["text"])
            if found is not None and one["at_s"] <= self.at_s:
                return float(found[1]), found[2]
        return None

    def near(self) -> dict[str, Any]:
        """The sentence next to the accident that knows what flew."""
        known = [one for one in self.said if one["flown"]["north_m_s"] is not None]
        return min(known, key=lambda one: abs(one["at_s"] - self.at_s))

    def refusals(self) -> list[str]:
        """The sentences that say so, with names and reasons."""
        is_refusal = re.compile("order failed|refused").search
        return [one["text"] for one in self.said if is_refusal(one["text"])]

    def rest(self) -> dict[str, Any] | None:
        """The sentence that the aircraft stood still, after the accident; None: none says it."""
        found = [one for one in self.of("motion") if one["at_s"] > self.at_s]
        return found[0] if found and "stood still" in found[0]["text"] else None


@pytest.fixture(scope="module", params=ACCIDENTS, ids=lambda one: one.__name__)
def flight(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Flight:
    folder = tmp_path_factory.mktemp(request.param.__name__)
    loop = virtual_clock_loop()
    try:
        return loop.run_until_complete(stage(request.param, folder))
    finally:
        loop.close()


@pytest.fixture(scope="module")
def asked(flight: Flight) -> Investigator:
    at_s, end_s = flight.truth.caused_at - flight.began_at, flight.ended_at - flight.began_at
    return Investigator(flight.path, at_s, end_s - 0.01)


def test_who_had_control_when(flight: Flight, asked: Investigator) -> None:
    found, true = asked.control(), flight.control(until=asked.end_s)
    assert [name for _, name in found] == [name for _, name in true]
    assert [at for at, _ in found] == pytest.approx([at for at, _ in true], abs=0.5)


def test_why_did_control_change(flight: Flight, asked: Investigator) -> None:
    times = [at for at, _ in asked.control()[1:]]
    assert len(times) == len(flight.truth.changes)
    for at, why in zip(times, flight.truth.changes, strict=True):
        assert re.search(why, asked.texts(at - 0.2, at + 0.3)), why


def test_what_was_the_last_order(flight: Flight, asked: Investigator) -> None:
    assert asked.last_order() == flight.truth.last_order


def test_what_setpoint_was_sent_last(flight: Flight, asked: Investigator) -> None:
    moving = [
        (at - flight.began_at, move)
        for at, move in zip(flight.truth.moves.times, flight.truth.moves, strict=True)
        if (move.roll_or_x, move.pitch_or_y, move.throttle_or_z, move.yaw) != (0.0,) * 4
    ]
    found, (at, move) = asked.setpoint(), moving[-1]
    assert found is not None
    assert found[0] == pytest.approx(at, abs=0.06)
    assert found[1] == in_words(move)


def in_words(move: Move) -> str:
    """By the control flag (document 3.2), for setpoints by velocity in the horizontal."""
    assert move.control_flag >> 6 == 1
    axes = ("forward", "right") if move.control_flag & 2 else ("north", "east")
    up = "m height" if move.control_flag >> 4 & 3 == 1 else "m/s up"
    turn = "°/s yaw rate" if move.control_flag & 8 else "° yaw"
    sent = move.roll_or_x, move.pitch_or_y, move.throttle_or_z, move.yaw
    values = [round(one, 3) + 0.0 for one in sent]  # to a millimetre
    units = (f"m/s {axes[0]}", f"m/s {axes[1]}", up, turn)
    return ", ".join(f"{value:g} {unit}" for value, unit in zip(values, units, strict=True))


def test_what_did_it_fly_then(flight: Flight, asked: Investigator) -> None:
    near = asked.near()
    assert abs(near["at_s"] - asked.at_s) < 1.0
    flown, seen = near["flown"], flight.truth.at(near["at_s"] + flight.began_at)
    for name, true in zip(("north_m_s", "east_m_s", "up_m_s"), seen.velocity, strict=True):
        assert flown[name] == pytest.approx(true, abs=0.25), name
    assert flown["height_m"] == pytest.approx(seen.place[2], abs=0.3)


def test_why_did_it_end(flight: Flight, asked: Investigator) -> None:
    said = asked.texts(asked.at_s - 0.6, asked.at_s + 1.0)
    assert re.search(flight.truth.ended_by, said), said


def test_what_was_refused_to_whom_and_why(flight: Flight, asked: Investigator) -> None:
    found = asked.refusals()
    for who, why in flight.truth.refused:
        assert [one for one in found if who in one and re.search(why, one)], (who, why)
    for one in found:  # and nobody else
        assert any(who in one or re.search(why, one) for who, why in flight.truth.refused), one


def test_was_the_line_good(flight: Flight, asked: Investigator) -> None:
    truth, line = flight.truth, asked.info["line"]
    last = truth.at(min(asked.end_s + flight.began_at, truth.silent_at) - 0.02)
    counted = truth.at(last.at - 1.0)  # at latest: the counters come once a second
    # Not all of a damaged frame: what another frame may begin with is looked into.
    assert 0.9 * counted.damaged_bytes <= line["discarded_bytes"] <= last.damaged_bytes
    assert asked.info["lost_share"] == pytest.approx(last.lost / last.frames, abs=0.005)
    silence = asked.info["maxima"]["silence_s"]
    assert silence == pytest.approx(truth.silence_s or 0.05, abs=0.3 if truth.silence_s else 0.15)


def test_what_changed_the_mode_and_who_asked(flight: Flight, asked: Investigator) -> None:
    truth = flight.truth
    whole = asked.texts(0.0, asked.end_s)
    for one in truth.asked:
        assert re.search(one, whole), one
    true = [(seen.at - flight.began_at, seen.phase, seen.switch) for seen in truth.seen]
    true = [one for one in true if 1.5 < one[0] < asked.end_s - 0.2]
    for column, kind in ((1, "flight"), (2, "switch")):
        names = [(one["at_s"], one["text"].rstrip(".").split()[-1]) for one in asked.of(kind)]
        for row in true[::20]:
            told = [name for at, name in names if at <= row[0] + 0.15]
            assert row[column] in (told[-1], *told[-2:-1]), row


def test_what_was_in_force(flight: Flight, asked: Investigator) -> None:
    whole = asked.texts(-9.0, asked.end_s)
    for one in flight.truth.in_force:
        assert re.search(one, whole), one
    assert whole.count("uploaded a") == len(flight.truth.in_force) - 1


def test_how_were_battery_and_gps(flight: Flight, asked: Investigator) -> None:
    near = asked.near()
    flown, seen = near["flown"], flight.truth.at(near["at_s"] + flight.began_at - 0.02)
    assert flown["battery_percent"] == pytest.approx(math.ceil(seen.battery), abs=1)
    assert flown["gps_health"] == seen.gps
    least = min(one.battery for one in flight.truth.seen if one.at < flight.began_at + asked.end_s)
    assert asked.info["maxima"]["battery_last_percent"] == pytest.approx(least, abs=1.5)


def test_how_far_did_it_move_and_who_was_lost(flight: Flight, asked: Investigator) -> None:
    truth, near, rest = flight.truth, asked.near(), asked.rest()
    gone = [one["text"] for one in asked.said if re.search(r" left: | is lost", one["text"])
            and one["at_s"] < flight.ended_at - flight.began_at - 0.1]  # fmt: skip
    assert bool(gone) == (truth.lost_front is not None), gone
    assert truth.lost_front is None or re.search(truth.lost_front, gone[0])
    if rest is None:  # as far as the file goes
        assert truth.at(truth.silent_at).speed > 0.3
        assert "It was moving when telemetry" in asked.texts(0.0, asked.end_s, "motion")
        return
    after = [one for one in truth.seen if one.at >= truth.caused_at]
    still = next(n for n in range(len(after)) if all(one.speed < 0.3 for one in after[n : n + 50]))
    stopped = after[still]
    assert rest["at_s"] + flight.began_at == pytest.approx(stopped.at, abs=0.3)
    begin, end = near["flown"], rest["flown"]
    true = truth.at(near["at_s"] + flight.began_at).place, stopped.place
    for axis, name in enumerate(("north_m", "east_m", "height_m")):
        assert end[name] - begin[name] == pytest.approx(true[1][axis] - true[0][axis], abs=0.5)
