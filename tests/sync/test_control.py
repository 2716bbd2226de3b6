from __future__ import annotations

import asyncio
import os
import signal
import sys
import threading
import time
from collections.abc import Callable
from contextlib import nullcontext, suppress
from itertools import count
from pathlib import Path
from random import Random
from types import FrameType, SimpleNamespace
from typing import Any, cast

import pytest

from m100link import (
    AckTimeout,
    AuthorityLost,
    AuthorityState,
    Credentials,
    Envelope,
    Finished,
    Guards,
    LinkLost,
    MissionKind,
    MissionProgress,
    MissionRunning,
    NoAuthority,
    Position,
    Reached,
    Setpoint,
    TaskProgress,
    TelemetryStalled,
    Uploading,
    UsageError,
    Waypoint,
    WaypointPlan,
    sync,
)
from m100link.flight.authority import AuthorityInput
from m100link.flight.stop_path import StopAction
from m100link.sync import control as control_module
from m100link.sync.control import Hold
from tests.flight.foreign_aircraft import APP_ID, KEY, ForeignAircraft, foreign_aircraft
from tests.flight.missions.foreign import plan
from tests.waiting import PATIENCE

Connect = Callable[..., sync.Aircraft]

NORTH = Setpoint.velocity(north=2.0, east=0.0, up=0.0, yaw_rate_deg_s=0.0)


def activated(connect: Connect, line: str = "sim://") -> sync.Aircraft:
    aircraft = connect(line)
    aircraft.activate(Credentials(app_id=10086, key=bytes(range(32))))
    return aircraft


def test_a_flight(connect: Connect) -> None:
    aircraft = activated(connect)
    seen: list[TaskProgress] = []
    with aircraft.control() as control:
        control.take_off(progress=seen.append)
        arrival = control.fly_to(north=5.0, east=0.0, up=1.0)
        assert arrival.distance_m < 0.5
        assert repr(control).startswith("<Control flying, authority held")
        control.land()
    assert seen
    assert control.is_over
    assert aircraft.authority.state is AuthorityState.NONE


def test_setpoints_are_repeated_while_this_thread_does_something_else(connect: Connect) -> None:
    aircraft = activated(connect)
    with aircraft.control() as control:
        control.take_off()
        with control.hold(NORTH, lifetime=1.0) as hold:
            for tick in control.ticks(10):
                hold.set(NORTH)
                if tick.elapsed > 2.0:
                    break
        assert control.setpoints_sent > 50
        velocity = aircraft.state.velocity
        assert velocity is not None
        assert velocity.north_m_s > 0.5
        control.stop()


def test_following_asks_in_this_thread(connect: Connect) -> None:
    aircraft = activated(connect)
    threads: set[int] = set()

    def source(tick: object) -> Setpoint | None:
        threads.add(threading.get_ident())
        return NORTH if control.setpoints_sent < 20 else None

    with aircraft.control() as control:
        control.take_off()
        control.follow(source, rate_hz=20, lifetime=1.0)
    assert threads == {threading.get_ident()}


@pytest.mark.parametrize("name", ["hold", "ticks", "hotpoint", "waypoint_mission"])
def test_a_misspelt_argument_is_an_error_of_the_call_and_not_of_its_block(
    connect: Connect, name: str
) -> None:
    with pytest.raises(TypeError):
        getattr(connect().control(), name)(1.0, hight=3.0)


def test_an_error_in_the_block_takes_the_stop_path(connect: Connect) -> None:
    aircraft = activated(connect)
    with pytest.raises(ZeroDivisionError), aircraft.control() as control:
        control.take_off()
        control.send(NORTH, lifetime=1.0)
        raise ZeroDivisionError
    assert control.is_over
    assert aircraft.authority.state is AuthorityState.NONE
    with pytest.raises(NoAuthority):
        control.send(NORTH)


def test_a_lost_authority_is_raised_by_the_call_that_waits(connect: Connect) -> None:
    aircraft = activated(connect)
    with pytest.raises(AuthorityLost), aircraft.control() as control:
        control.take_off()
        lose(aircraft)
        control.fly_to(north=100.0, east=0.0, up=0.0)
    assert control.is_over


def test_a_lost_authority_is_raised_by_the_block_if_no_call_did(connect: Connect) -> None:
    aircraft = activated(connect)
    with pytest.raises(AuthorityLost), aircraft.control() as control:
        lose(aircraft)
        while control.is_flying:
            pass


def lose(aircraft: sync.Aircraft) -> None:
    """As where the pilot leaves F."""
    aircraft._portal.soon(lambda: aircraft.authority.feed(AuthorityInput.RC_LEFT_F))


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_in_the_middle_of_a_call_takes_the_stop_path(
    connect: Connect, number: signal.Signals
) -> None:
    aircraft = activated(connect)
    before = signal.getsignal(number)

    def progress(_: object) -> None:
        os.kill(os.getpid(), number)

    with pytest.raises((KeyboardInterrupt, SystemExit)), aircraft.control() as control:
        control.take_off(progress=progress)
    assert control.is_over
    assert aircraft.authority.state is AuthorityState.NONE
    assert signal.getsignal(number) == before


@pytest.mark.parametrize(("stop", "height"), [("land", 0.0), ("hover", 5.0)])
def test_an_interrupt_in_a_later_cell_takes_the_stop_path(
    connect: Connect, stop: StopAction, height: float
) -> None:
    """ipykernel ignores SIGINT between two cells, and gives each one Python's own handler."""
    before = signal.getsignal(signal.SIGINT)
    aircraft = activated(connect)
    control = aircraft.control(stop=stop).obtain()
    control.take_off()
    control.climb_to(5.0)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGINT, signal.default_int_handler)

    def progress(_: object) -> None:
        os.kill(os.getpid(), signal.SIGINT)

    with pytest.raises(KeyboardInterrupt):
        control.fly_to(north=40.0, east=0.0, up=0.0, progress=progress)
    aircraft.collect(Position, seconds=20.0)
    assert control.is_over
    assert aircraft.authority.state is AuthorityState.NONE
    reached = aircraft.state.get(Position)
    assert reached is not None
    assert reached.height_m == pytest.approx(height, abs=0.5)
    aircraft.close()
    assert signal.getsignal(signal.SIGINT) == before


def test_control_by_hand_at_a_prompt(connect: Connect) -> None:
    aircraft = activated(connect)
    control = aircraft.control().obtain()
    assert control.has_authority
    control.release()
    control.release()
    assert aircraft.authority.state is AuthorityState.NONE


def test_control_that_is_asked_for_twice_by_mistake_is_kept(connect: Connect) -> None:
    control = activated(connect).control().obtain()
    for again in (control.obtain, control.__enter__):
        with pytest.raises(UsageError, match="entered before"):
            again()
    control.take_off()
    assert control.has_authority
    control.release()


# -- a signal handler of the program raises, wherever this thread is -------------------------------


class Alarm(Exception):
    """What the handler raises, as many do by ``signal.alarm``."""


class AlarmAt:
    """Raises at one line that the thread runs in ``m100link.sync``, as a signal handler may."""

    def __init__(self, number: int) -> None:
        self.left = number
        self.called: set[tuple[str, str]] = set()  # file and function

    def __enter__(self) -> AlarmAt:
        self.before = sys.gettrace()
        sys.settrace(self._called)
        return self

    def __exit__(self, *_: object) -> None:
        sys.settrace(self.before)

    def _called(self, frame: FrameType, event: str, arg: object) -> Any:
        file, name = Path(frame.f_code.co_filename), frame.f_code.co_name
        self.called.add((file.name, name))
        # Python itself looks for signals before the first line of an `__exit__`: there nobody helps
        # but the block around it.
        is_ours = file.parent == Path(sync.__file__).parent
        return self._ran if is_ours and name != "__exit__" else None

    def _ran(self, frame: FrameType, event: str, arg: object) -> Any:
        self.left -= event == "line"
        if not self.left:
            self.left = -1
            raise Alarm
        return self._ran


def fly_far(control: sync.Control) -> None:
    control.fly_to(north=20.0, east=0.0, up=0.0)


def fly_a_mission(control: sync.Control) -> None:
    place = control.state.position
    assert place is not None
    north = [place.latitude_deg + metres / 111_000.0 for metres in (20.0, 90.0)]
    points = [Waypoint(one, place.longitude_deg, height=10.0) for one in north]
    with control.waypoint_mission(WaypointPlan(points, speed=3.0)) as mission:
        next(mission)
        raise Alarm


@pytest.mark.parametrize(
    ("fly", "line", "step"),
    [(fly_far, "sim://", 1), (fly_a_mission, "sim://?firmware=3.1", 5)],
    ids=["flight", "mission"],
)
def test_wherever_a_handler_of_a_signal_raises_nothing_flies_on(
    fly: Callable[[sync.Control], None], line: str, step: int, connect: Connect
) -> None:
    """Or the program would hear that its call was broken off, and the aircraft carries it out."""
    first = Random(31).randint(1, step)
    aircraft = activated(connect, line)
    far = Guards(envelope=Envelope(max_radius_m=10_000.0))
    control = aircraft.control(handle_signals=False, guards=far).obtain()
    control.take_off()
    for number in count(first, step):
        with AlarmAt(number) as alarm, suppress(Alarm):
            fly(control)
            raise Alarm
        with pytest.raises(TelemetryStalled):
            aircraft.wait_for(lambda _: False, timeout=1.5)
        velocity = aircraft.state.velocity
        assert velocity is not None
        assert abs(velocity.north_m_s) < 0.3, (number, velocity)
        assert not aircraft.mission.is_running, number
        if alarm.left > 0:
            break
    assert number > 20
    control.release()


def test_no_lock_written_in_python_is_taken_by_the_thread_that_waits(connect: Connect) -> None:
    """One stays locked when a signal raises behind its taking: the event loop would hang, too."""
    aircraft = activated(connect)
    with aircraft.control() as control:
        with AlarmAt(-1) as alarm:
            control.send(NORTH.neutral())
            control.take_off()
    assert ("portal.py", "wait") in alarm.called
    locks = {name for file, name in alarm.called if file in ("threading.py", "_base.py")}
    # RLock makes one, such as for an import, and takes none.
    assert locks <= {"current_thread", "main_thread", "RLock"}


# -- a mission: the same events, the same stop -----------------------------------------------------

SHORT = plan([(3.0, 0.0), (6.0, 0.0)], speed=10.0)


def connected(there: ForeignAircraft) -> sync.Aircraft:
    aircraft = sync.connect(there.name)
    aircraft.activate(Credentials(app_id=APP_ID, key=KEY))
    aircraft.wait_for(lambda state: state.flight_status is not None, timeout=PATIENCE)
    return aircraft


# -- what a block does where its call ends otherwise: without an aircraft --------------------------


class Door(SimpleNamespace):
    """A portal whose waiting calls end as the test says; ``steps`` has what the block asked."""

    def __init__(self, *ends: BaseException | None) -> None:
        super().__init__(ends=list(ends), steps=list[str](), is_open=True)

    def wait(self, make: Callable[[Any], Any]) -> Any:
        self.steps.append("wait")
        end = self.ends.pop(0) if self.ends else None
        if end is not None:
            raise end
        return asyncio.run(self._of(make))

    @staticmethod
    async def _of(make: Callable[[Any], Any]) -> Any:
        return await make(None)

    def soon_await(self, make: Any) -> None:
        self.steps.append(f"soon {make.__name__}")

    def soon(self, function: Any) -> None:
        function()

    def call(self, function: Any, *what: Any) -> Any:
        return function(*what)


@pytest.mark.parametrize(
    ("end", "leaves"),
    [(None, False), (UsageError("no"), False), (KeyboardInterrupt(), True), (SystemExit(), True)],
)
def test_a_block_that_may_have_been_entered_all_the_same_is_left(
    end: BaseException | None, leaves: bool
) -> None:
    steps: list[str] = []

    class Made:
        async def __aenter__(self) -> str:
            steps.append("entered")
            return "one"

        async def __aexit__(self, *error: object) -> None:
            steps.append(f"left {error[0]}")

    door: Any = Door(end)
    block = Hold(door, lambda _: cast(Any, Made()))
    assert repr(block) == "<Hold, not entered>"
    if end is None:
        with block:
            assert repr(block) == "'one'"
        assert steps == ["entered", "left None"]
        with pytest.raises(ZeroDivisionError), block:
            raise ZeroDivisionError
        assert steps[2:] == ["entered", f"left {ZeroDivisionError}"]
        block.__enter__()
        door.ends = [KeyboardInterrupt()]
        with pytest.raises(KeyboardInterrupt):
            block.__exit__(None, None, None)
        assert door.steps[-1] == "soon _leave"
        return
    with pytest.raises(type(end)):
        block.__enter__()
    assert door.steps == ["wait", "soon _leave"][: 1 + leaves]


@pytest.mark.parametrize(
    ("call", "end", "interrupts", "leaves"),
    [
        *(("obtain", None, False, False), ("obtain", UsageError("no"), False, True)),
        *(("obtain", KeyboardInterrupt(), True, True), ("release", None, False, True)),
        *(("release", UsageError("no"), True, True), ("release", SystemExit(), True, True)),
    ],
)
@pytest.mark.parametrize("handles_signals", [True, False])
def test_control_that_may_be_held_all_the_same_is_ended(
    call: str,
    end: BaseException | None,
    interrupts: bool,
    leaves: bool,
    handles_signals: bool,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    steps: list[str] = []
    watched = SimpleNamespace(
        join=lambda _: steps.append("join"), leave=lambda _: steps.append("leave")
    )
    monkeypatch.setattr(control_module, "SIGNALS", watched)

    async def done() -> None:
        steps.append("done")

    held: Any = SimpleNamespace(
        obtain=done, release=done, interrupt=lambda: steps.append("interrupt")
    )
    door: Any = Door(end)
    control = control_module.Control(door, held, handle_signals=handles_signals)
    if end is None:
        assert getattr(control, call)() is (control if call == "obtain" else None)
    else:
        with pytest.raises(type(end)):
            getattr(control, call)()
    wanted = ["join"] if call == "obtain" and handles_signals else []
    wanted += ["done"] if end is None else []
    wanted += ["interrupt"] if interrupts else []
    assert steps == wanted + (["leave"] if leaves else [])


@pytest.mark.parametrize("met", [None, ZeroDivisionError()])
def test_the_end_of_a_block_hides_no_error_of_the_block(met: Exception | None) -> None:
    held: Any = SimpleNamespace(interrupt=lambda: None, is_flying=True)
    door: Any = Door(UsageError("no"))
    control = control_module.Control(door, held, handle_signals=False)
    with nullcontext() if met else pytest.raises(UsageError):
        control.__exit__(None, met, None)


def test_a_mission_tells_its_events_until_there_are_no_more() -> None:
    told = iter([Reached(0), Reached(1)])

    class Flight(SimpleNamespace):
        async def __anext__(self) -> Any:
            for event in told:
                return event
            raise StopAsyncIteration

    door: Any = Door()
    mission = control_module.MissionFlight(door, cast(Any, None))
    mission._entered = Flight()
    assert list(mission) == [Reached(0), Reached(1)]


@pytest.mark.parametrize(
    ("end", "raised", "seen"),
    [
        (TimeoutError(), TelemetryStalled, "no value came for 0.2 s"),
        (AckTimeout("of the link"), AckTimeout, "of the link"),
        (StopAsyncIteration(), StopIteration, "^$"),
        (LinkLost("gone"), LinkLost, "gone"),
    ],
)
def test_a_value_that_is_queued_is_not_waited_for_and_none_has_its_error(
    end: Exception, raised: type[Exception], seen: str
) -> None:
    queued = [7, None]
    values: Any = SimpleNamespace(get_nowait=lambda: queued.pop(0))
    door: Any = Door(end)
    subscription = control_module.Subscription[int](door, values, 0.2)
    assert next(subscription) == 7
    assert door.steps == []
    with pytest.raises(raised, match=seen):
        next(subscription)


@pytest.mark.pty
@pytest.mark.smoke
def test_it_is_flown_in_a_with_block_and_reported_in_a_loop() -> None:
    with foreign_aircraft("3.1") as there, connected(there) as aircraft:
        uploading: list[Uploading] = []
        with aircraft.control() as control:
            with control.waypoint_mission(SHORT, progress=uploading.append) as mission:
                events = [e for e in mission if not isinstance(e, MissionProgress)]
        assert [event.index for event in events if isinstance(event, Reached)] == [0, 1]
        assert events[-1] == Finished()
        # A callback that is late gets the newest step alone.
        assert uploading[-1] == Uploading(index=1, total=2)
        assert uploading[:-1] in ([], [Uploading(index=0, total=2)])
        assert mission.is_over


@pytest.mark.pty
def test_an_exception_in_the_block_stops_it_and_setpoints_are_refused_before() -> None:
    with foreign_aircraft("3.1") as there, connected(there) as aircraft:
        with pytest.raises(ZeroDivisionError), aircraft.control() as control:
            with control.waypoint_mission(plan(speed=1.0)) as mission:
                assert mission.plan == plan(speed=1.0)
                with pytest.raises(MissionRunning):
                    control.send(NORTH)
                mission.pause()
                assert mission.is_paused
                mission.resume()
                assert mission.set_speed(2.0) == 2.0
                raise ZeroDivisionError
        assert not there.missions.flying


@pytest.mark.pty
def test_one_that_is_detached_flies_on() -> None:
    with foreign_aircraft("3.1") as there, connected(there) as aircraft:
        with aircraft.control() as control, control.waypoint_mission(plan(speed=1.0)) as mission:
            mission.detach()
        time.sleep(0.2)
        assert there.missions.flying
        with aircraft.control() as control:
            assert control.stop_mission() is MissionKind.WAYPOINT
