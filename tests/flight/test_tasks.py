"""Take-off, landing, going home: done when seen done; refused, failed and unseen with reasons."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Iterable
from itertools import chain, count, islice, pairwise, repeat
from types import SimpleNamespace
from typing import Any, cast

import pytest

from m100link import (
    AckTimeout,
    AuthorityLost,
    FlightPhase,
    Guards,
    LinkLost,
    NoAuthority,
    NotObserved,
    TaskFailed,
    TaskProgress,
    TaskRefused,
    TaskResultCode,
)
from m100link.flight.tasks import Commander, run_task, task_sequences
from m100link.protocol import encode_telemetry, profile
from m100link.protocol.codes import TaskStartCode
from m100link.protocol.commands.control import QueryTask, StartTask, Task
from m100link.sim import AircraftSettings, LineFaults
from m100link.telemetry.sample import Sample
from m100link.telemetry.state import AircraftState
from tests.rig import FIRMWARES, Rig, put_in_the_air, rig, wrong_standing

pytestmark = pytest.mark.anyio

each_firmware = pytest.mark.parametrize("firmware", FIRMWARES)


def started(flown: Rig) -> list[StartTask]:
    commands = (c.command for c in flown.virtual.autopilot.received_commands)
    return [c for c in commands if isinstance(c, StartTask)]


@each_firmware
async def test_take_off_and_landing_return_when_they_are_done_not_when_they_begin(
    firmware: str,
) -> None:
    async with rig(firmware=firmware) as flown, flown.aircraft.control() as control:
        start = flown.now
        await control.take_off()
        assert flown.now - start > 2.0
        assert flown.phase is FlightPhase.IN_AIR
        assert flown.virtual.height == pytest.approx(1.2, abs=0.15)
        await control.land()
        assert flown.virtual.height == 0.0
        assert not flown.is_running


@each_firmware
async def test_go_home_flies_home_and_lands(firmware: str) -> None:
    guards = Guards(integrity=False)  # it is put where it could not have flown to
    async with rig(firmware=firmware) as flown, flown.aircraft.control(guards=guards) as control:
        await control.take_off()
        flown.virtual.vehicle.flight.dynamics.place(60.0, 0.0, 5.0)
        await control.go_home()
        assert flown.virtual.height == 0.0
        assert abs(flown.virtual.position[0]) < 2.0


async def test_progress_tells_phase_height_and_result() -> None:
    seen: list[TaskProgress] = []
    async with rig() as flown, flown.aircraft.control() as control:
        await control.take_off(progress=seen.append)
        assert len(seen) > 8
        assert [p.elapsed for p in seen] == sorted(p.elapsed for p in seen)
        assert {p.task for p in seen} == {Task.TAKE_OFF}
        assert seen[0].result is None
        assert {p.phase for p in seen} >= {FlightPhase.TAKING_OFF, FlightPhase.IN_AIR}
        heights = [p.height_m for p in seen if p.height_m is not None]
        assert heights[0] == pytest.approx(0.0, abs=0.05)
        assert heights[-1] == pytest.approx(1.2, abs=0.15)
        assert seen[-1].result in (TaskResultCode.SUCCEEDED, TaskResultCode.EXECUTING)


async def test_each_task_has_a_number_of_its_own_and_is_asked_for_by_it() -> None:
    async with rig() as flown, flown.aircraft.control() as control:
        await control.take_off()
        await control.land()
        first, second = started(flown)
        assert second.task_sequence == (first.task_sequence + 1) & 0xFF
        asked = {
            c.command.task_sequence
            for c in flown.virtual.autopilot.received_commands
            if isinstance(c.command, QueryTask)
        }
        assert asked <= {first.task_sequence, second.task_sequence}
        assert asked


async def test_a_task_number_wraps_at_256() -> None:
    numbers = list(islice(task_sequences(), 600))
    assert set(numbers) == set(range(256))
    assert all(after == (before + 1) & 0xFF for before, after in pairwise(numbers))


@each_firmware
async def test_take_off_in_the_air_is_refused_with_the_situation(firmware: str) -> None:
    async with rig(firmware=firmware) as flown, flown.aircraft.control() as control:
        await control.take_off()
        with pytest.raises(
            TaskRefused, match="take off was refused: received and rejected"
        ) as caught:
            await control.take_off()
        error = caught.value
        assert error.code == 1
        assert error.situation["flight_status"] == "IN_AIR"
        assert error.situation["battery_percent"] == 100
        assert error.situation["gps_health"] == 5
        assert error.situation["mode_switch"] == "F"
        assert "in the air leave take-off out" in error.remedy


@pytest.mark.parametrize("task", ["take_off", "land", "go_home"])
async def test_an_answer_that_it_is_done_does_not_count_against_telemetry(task: str) -> None:
    async with rig() as flown, flown.aircraft.control() as control:
        if task != "take_off":
            await control.take_off()
        flight, phase = flown.virtual.vehicle.flight, flown.phase
        with pytest.MonkeyPatch.context() as patched:
            patched.setattr(flight, "start_task", lambda *_: TaskStartCode.STARTED)
            patched.setattr(flight.tasks, "query", lambda _: TaskResultCode.SUCCEEDED)
            with pytest.raises(NotObserved, match=f"not seen done .flight_status {phase.name}"):
                await getattr(control, task)(timeout=5.0)


async def test_landing_on_the_ground_is_refused() -> None:
    async with rig() as flown, flown.aircraft.control() as control:
        with pytest.raises(TaskRefused, match="land was refused"):
            await control.land()


@pytest.mark.parametrize("is_asked", [False, True])
async def test_a_task_that_the_pilot_interrupts_ends_the_block_as_a_loss(
    monkeypatch: pytest.MonkeyPatch, is_asked: bool
) -> None:
    """Also where the aircraft is asked for the result in that moment, and says that it failed."""
    async with rig() as flown:
        tasks = flown.virtual.vehicle.flight.tasks
        query = tasks.query

        def asked(number: int) -> TaskResultCode:
            flown.virtual.leave_f()
            return query(number)

        with pytest.raises(AuthorityLost, match="the pilot moved the mode switch out of F"):
            async with flown.aircraft.control() as control:
                if is_asked:
                    monkeypatch.setattr(tasks, "query", asked)
                else:
                    asyncio.get_running_loop().call_later(2.005, flown.virtual.leave_f)
                await control.take_off()


async def test_a_task_that_the_aircraft_gives_up_is_a_failure() -> None:
    """The battery runs down to the point where the aircraft lands by itself."""
    async with rig() as flown:
        guards = Guards(battery_floor_percent=None, integrity=False)  # it is put elsewhere
        async with flown.aircraft.control(guards=guards) as control:
            await control.take_off()
            flown.virtual.vehicle.flight.dynamics.place(200.0, 0.0, 30.0)

            def run_down() -> None:
                flown.virtual.battery_percent = 9.0

            asyncio.get_running_loop().call_later(3.0, run_down)
            with pytest.raises(TaskFailed, match="go home began and failed") as caught:
                await control.go_home()
            assert caught.value.situation["flight_status"] == "LANDING"


async def test_one_task_at_a_time() -> None:
    async with rig() as flown, flown.aircraft.control() as control:
        take_off = asyncio.create_task(control.take_off())
        await asyncio.sleep(0.5)
        with pytest.raises(TaskRefused, match="land was asked for during take off"):
            await control.land()
        await take_off
        assert len(started(flown)) == 1, "the second was not even sent"


async def test_tasks_need_authority() -> None:
    async with rig() as flown:
        control = flown.aircraft.control()
        for work in (control.take_off, control.land, control.go_home):
            with pytest.raises(NoAuthority, match="nothing was sent"):
                await work()
        assert started(flown) == []


async def test_without_telemetry_items_the_result_query_decides() -> None:
    async with rig() as flown:
        flown.virtual.set_rates(flight_status=0, position=0)
        async with flown.virtual.connect() as blind:
            blind.use_key(flown.virtual.credentials)
            guards = Guards(gps=False, envelope=None)
            async with blind.control(guards=guards) as control:
                await control.take_off()
                assert blind.state.flight_status is None
                assert flown.virtual.height > 1.0
                await control.land()
                assert flown.virtual.height == 0.0


async def test_without_the_result_query_what_telemetry_shows_decides() -> None:
    """Some firmware answers only the newest query; here none comes through."""
    async with rig() as flown, flown.aircraft.control() as control:
        handlers = flown.virtual.autopilot._commands._handlers
        handlers[QueryTask] = lambda query: TaskResultCode.NOT_CURRENT
        await control.take_off()
        assert flown.virtual.height > 1.0
        await control.land()
        assert flown.virtual.height == 0.0


async def test_an_old_standby_does_not_show_that_a_landing_is_done() -> None:
    """The item stopped on the ground, and the result query brings nothing."""
    async with rig() as flown:
        flown.virtual.set_rates(flight_status=0)
        async with flown.aircraft.control() as control:
            await control.take_off()
            handlers = flown.virtual.autopilot._commands._handlers
            handlers[QueryTask] = lambda query: TaskResultCode.NOT_CURRENT
            flown.virtual.vehicle.flight.dynamics.place(0.0, 0.0, 15.0)
            with pytest.raises(NotObserved):
                await control.land(timeout=4.0)
            assert flown.virtual.height > 1.0


async def test_neither_seen_nor_reported_is_not_observed_and_says_that_it_may_still_run() -> None:
    async with rig() as flown, flown.aircraft.control() as control:
        start = flown.now
        with pytest.raises(
            NotObserved, match=r"accepted 1\.5 s ago and is not seen done"
        ) as caught:
            await control.take_off(timeout=1.5)
        assert flown.now - start < 2.5
        assert isinstance(caught.value, TimeoutError)
        assert "may still be running" in caught.value.remedy


async def test_no_ack_of_the_start_leaves_the_outcome_unknown() -> None:
    async with rig() as flown, flown.aircraft.control() as control:
        flown.virtual.set_faults(LineFaults(), to_aircraft=LineFaults(loss=1.0))
        with pytest.raises(AckTimeout, match="outcome is unknown") as caught:
            await control.take_off()
        assert caught.value.command == "start_task"
        flown.virtual.set_faults()


NO_GUARDS = Guards(stale_telemetry_s=None, gps=False, envelope=None, battery_floor_percent=None)


async def test_a_take_off_whose_answers_were_lost_is_asked_for_by_its_number() -> None:
    async with rig() as flown, flown.aircraft.control(guards=NO_GUARDS) as control:
        flown.virtual.set_faults(LineFaults(loss=1.0), to_aircraft=LineFaults())
        asyncio.get_running_loop().call_later(1.55, flown.virtual.set_faults)
        await control.take_off()
        assert flown.phase is FlightPhase.IN_AIR
        assert len(started(flown)) == 1


@pytest.mark.parametrize("orders", [1, 2])
async def test_an_order_that_is_given_again_while_the_first_is_flown_is_not_refused(
    orders: int,
) -> None:
    """Nobody knew that it was flown. The aircraft rejects the others, during it and after it."""
    async with rig() as flown, flown.aircraft.control(guards=NO_GUARDS) as control:
        flown.virtual.set_faults(LineFaults(loss=1.0), to_aircraft=LineFaults())
        for _ in range(orders):
            with pytest.raises(AckTimeout, match="outcome is unknown"):
                await control.take_off()
        flown.virtual.set_faults()
        await control.take_off()
        assert flown.phase is FlightPhase.IN_AIR
        assert len(started(flown)) == orders + 1
        with pytest.raises(TaskRefused, match="received and rejected"):
            await control.take_off()  # of this one nobody can think that it is flown


async def test_a_repeat_that_the_aircraft_took_for_another_order_does_not_refuse_the_first() -> (
    None
):
    async with rig(settings=AircraftSettings(forget_acks_after=0.2)) as flown:
        async with flown.aircraft.control(guards=NO_GUARDS) as control:
            flown.virtual.set_faults(LineFaults(loss=1.0), to_aircraft=LineFaults())
            asyncio.get_running_loop().call_later(0.3, flown.virtual.set_faults)
            await control.take_off()
            assert flown.phase is FlightPhase.IN_AIR
            assert len(started(flown)) == 2


async def test_an_aircraft_that_executes_something_else_refused_this_task() -> None:
    """Some firmware may tell of whatever it executes, whichever number is asked for."""
    async with rig() as flown, flown.aircraft.control() as control:
        handlers = flown.virtual.autopilot._commands._handlers
        handlers[QueryTask] = lambda query: TaskResultCode.EXECUTING
        with pytest.raises(TaskRefused):
            await control.land()
        with pytest.raises(TaskRefused):
            await control.go_home()


@pytest.mark.parametrize("seed", range(12))
async def test_a_lossy_line_starts_no_task_twice_and_blames_no_key(seed: int) -> None:
    """An answer that does not come after all tries is an unknown outcome, and nothing else."""
    async with rig(seed=seed) as flown:
        guards = Guards(stale_telemetry_s=None)
        async with flown.aircraft.control(guards=guards) as control:
            flown.virtual.set_faults(LineFaults(loss=0.25, duplicate=0.2, jitter=0.05))
            with contextlib.suppress(AckTimeout):
                await control.take_off()
                await control.land()
            flown.virtual.set_faults()
        tasks = [command.task for command in started(flown)]
        assert tasks in ([Task.TAKE_OFF], [Task.TAKE_OFF, Task.LAND])


async def test_unplugged_during_a_task() -> None:
    async with rig() as flown:
        with pytest.raises(LinkLost):
            async with flown.aircraft.control() as control:
                asyncio.get_running_loop().call_later(2.0, flown.virtual.unplug)
                await control.take_off()


async def test_setpoints_stop_while_a_task_flies() -> None:
    async with rig() as flown, flown.aircraft.control() as control:
        await control.take_off()
        await flown.fly(control, 1.0)
        count = len(flown.moves)
        await control.land()
        assert all(map(flown.is_neutral, list(flown.moves)[count + 1 :]))
        assert len(flown.moves) <= count + 20  # the neutral of 0.3 s


# -- what counts as done --------------------------------------------------------------------------

HOVERING: dict[str, tuple[float, ...]] = {
    "flight_status": (FlightPhase.IN_AIR,),
    "position": (0.8, 0.1, 400.0, 1.2, 5),
    "velocity": (0.0, 0.0, 0.0, 5),
}
STANDING: dict[str, tuple[float, ...]] = {"flight_status": (FlightPhase.STANDBY,)}
SILENCE, EXECUTING, NOT_CURRENT = None, TaskResultCode.EXECUTING, TaskResultCode.NOT_CURRENT


class Told:
    """Accepts any task, shows the same items for ever and answers queries in the order given.

    Attributes:
        queries: How many were asked.
    """

    def __init__(
        self, items: dict[str, tuple[float, ...]], answers: Iterable[TaskResultCode | None]
    ) -> None:
        self.queries = 0
        self._items = items
        self._answers = iter(answers)
        self._state = AircraftState(asyncio.get_running_loop().time)

    async def execute(self, command: object, **_: object) -> TaskStartCode | TaskResultCode:
        if isinstance(command, StartTask):
            return TaskStartCode.STARTED
        self.queries += 1
        answer = next(self._answers)
        if answer is None:
            raise AckTimeout("no answer")
        return answer

    async def run(self, task: Task, *, timeout: float) -> None:
        """Begin the task and wait for its end."""
        numbers = {"task_sequences": count(), "unanswered": {}}
        parts = SimpleNamespace(requests=self, state=self._state, **numbers)
        telling = asyncio.create_task(self._tell())
        try:
            await run_task(cast(Commander, parts), task, timeout=timeout)
        finally:
            telling.cancel()

    async def _tell(self) -> None:
        firmware = profile("3.1")
        while True:
            data = encode_telemetry(self._items, firmware)
            self._state.update(Sample(data, firmware, asyncio.get_running_loop().time()))
            await asyncio.sleep(0.1)


@pytest.mark.parametrize(
    ("answers", "asked"),
    [
        ([SILENCE] * 3, 3),
        ([SILENCE, SILENCE, EXECUTING, SILENCE, SILENCE, SILENCE], 6),
        ([EXECUTING, SILENCE, EXECUTING, SILENCE, SILENCE, EXECUTING, NOT_CURRENT], 7),
    ],
    ids=str,
)
async def test_three_queries_in_a_row_without_an_answer_leave_it_to_telemetry(
    answers: list[TaskResultCode | None], asked: int
) -> None:
    """A landing that is seen done from the start: only what the last answer says keeps it."""
    told = Told(STANDING, chain(answers, repeat(TaskResultCode.FAILED)))
    await told.run(Task.LAND, timeout=20)
    assert told.queries == asked


@pytest.mark.parametrize(
    ("shown", "is_done"),
    [
        ({}, True),
        ({"velocity": (3.0, 0.0, 0.1, 5)}, True),
        ({"velocity": (0.0, 0.0, 0.2, 5)}, False),
        ({"velocity": (0.0, 0.0, -0.2, 5)}, False),
        ({"velocity": None}, True),
        ({"position": (0.8, 0.1, 400.0, 0.9, 5)}, False),
        ({"position": None}, False),
        ({"flight_status": (FlightPhase.TAKING_OFF,)}, False),
        ({"flight_status": (FlightPhase.LANDING,)}, False),
        ({"flight_status": None}, False),
    ],
    ids=str,
)
async def test_a_take_off_is_seen_done_when_it_hovers_a_metre_up_or_more(
    shown: dict[str, Any], is_done: bool
) -> None:
    items = {name: values for name, values in (HOVERING | shown).items() if values is not None}
    told, loop = Told(items, repeat(NOT_CURRENT)), asyncio.get_running_loop()
    began_at = loop.time()
    with contextlib.nullcontext() if is_done else pytest.raises(NotObserved):
        await told.run(Task.TAKE_OFF, timeout=5)
    # Asked after a second, and it has to be seen for another one: it may climb through a metre.
    assert 0.0 <= loop.time() - began_at - (2.0 if is_done else 5.0) <= 0.3


@each_firmware
@pytest.mark.parametrize("bring_down", ["land", "go_home"])
@pytest.mark.parametrize("answer", [NOT_CURRENT, TaskResultCode.SUCCEEDED])
async def test_wrong_statuses_of_standing_end_no_landing(
    firmware: str, bring_down: str, answer: TaskResultCode
) -> None:
    async with rig(firmware=firmware) as flown, flown.aircraft.control() as control:
        flown.virtual.autopilot._commands._handlers[QueryTask] = lambda _: answer
        put_in_the_air(flown.virtual, 5.0)
        await asyncio.sleep(1.0)
        with wrong_standing():
            await asyncio.sleep(1.0)
            await getattr(control, bring_down)()
            assert flown.virtual.height == 0.0
            assert not flown.is_running
