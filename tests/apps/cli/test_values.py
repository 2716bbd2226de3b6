"""What commands show and refuse, as values in and words out: without a process, without real time.

Times are seconds inside the library and milliseconds where the title of a column says so.
"""

from __future__ import annotations

import asyncio
import io
import json
import math
import signal
import sys
import time
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, nullcontext
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest
from rich.console import Console
from rich.table import Table

from m100link import AckTimeout, GuardRefused, LinkError, UsageError
from m100link.apps.agent.messages import RemoteError
from m100link.apps.cli import (
    common,
    configuration,
    connection,
    decode,
    demo,
    fleet_plans,
    fleet_verbs,
    flight,
    log,
    mission,
    serve,
    sim,
    telemetry,
)
from m100link.apps.cli.mission import event_name, event_words
from m100link.apps.cli.terminal import ExitCode, OutputFormat, ReaderGone
from m100link.apps.doctor import Finding, Stage, Verdict
from m100link.apps.doctor.first_contact import Observation, Topic
from m100link.apps.fleet.logs.fetching import Fetched
from m100link.apps.fleet.payloads import Card, MissionCard, MissionStage
from m100link.apps.station.config import Settings
from m100link.flight.mission_state import MissionKind
from m100link.flight.missions.events import (
    Aborted,
    ActionsDone,
    Finished,
    MissionProgress,
    Reached,
    Started,
    Uploaded,
    Uploading,
)
from m100link.flight.tasks import TaskProgress
from m100link.geodesy import LocalFrame
from m100link.link.statistics import RoundTrips
from m100link.missions.plan import AtEnd, WaypointPlan
from m100link.missions.waypoint import Waypoint
from m100link.protocol import Battery, FlightPhase, FlightStatus, Position, Velocity
from m100link.protocol.commands.control import Task
from m100link.protocol.firmware import PROFILES
from m100link.protocol.items import BY_RECORD
from m100link.sim import VirtualClockEventLoop
from m100link.sim.vehicle.activation import DEMO_APP_ID
from m100link.telemetry.state import ItemStatistics
from tests import limits
from tests.apps.cli.conftest import CommandLine
from tests.flight.missions.foreign import plan as short_plan
from tests.known import position
from tests.rig import rig

pytestmark = pytest.mark.anyio


@pytest.fixture
def anyio_backend() -> object:
    return "asyncio", {"loop_factory": VirtualClockEventLoop}


# -- tables ---------------------------------------------------------------------------------------


def rows(table: Table) -> dict[str, list[str]]:
    """Cells of each row behind its first one, as they are printed; the caption by its last line."""
    written = io.StringIO()
    Console(file=written, width=200, markup=False).print(table)
    lines = [line.split() for line in written.getvalue().splitlines() if line.strip()]
    return {line[0]: line[1:] for line in lines} | {"last": lines[-1]}


def measured(age_s: float = 0.25) -> Any:
    """An aircraft that sends the battery alone: each number is another one."""

    def statistics(record: type[Any]) -> ItemStatistics:
        name = BY_RECORD[record].name
        if record is not Battery:
            return ItemStatistics(name, 0, None, None, 0.0)
        return ItemStatistics(name, 321, 49.5, 0.00123, 0.0756)

    return SimpleNamespace(
        state=SimpleNamespace(
            statistics=statistics,
            get=lambda record: Battery(87) if record is Battery else None,
            age=lambda record: age_s if record is Battery else None,
        ),
        device_clock=SimpleNamespace(
            tick_hz=600, offset_s=1.5, skew_ppm=12.34, uncertainty_s=0.0042, resets=2
        ),
        telemetry_mismatches=5,
        statistics=lambda: SimpleNamespace(frames_received=1001, discarded_bytes=17),
        link=SimpleNamespace(name="here"),
        firmware="3.1",
    )


@pytest.fixture
def wide(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(telemetry, "out", Console(width=200, file=io.StringIO(), markup=False))


@pytest.mark.usefixtures("wide")
def test_hz_shows_milliseconds_and_parts_in_a_million() -> None:
    shown = rows(telemetry._rates_table(telemetry._rates(measured())))
    assert shown["item"] == ["Hz", "count", "jitter", "ms", "longest", "gap", "ms"]
    assert shown["battery"] == ["49.5", "321", "1.23", "75.6"]
    assert shown["position"] == ["0", "0"]
    caption = "device clock 600 Hz, skew 12.3 ppm, known to 4.2 ms"
    assert " ".join(shown["last"]) == caption


@pytest.mark.parametrize(("count", "gap_s"), [(0, None), (1, None), (2, 0.0756)])
def test_one_package_has_no_gap_behind_it(count: int, gap_s: float | None) -> None:
    statistics = ItemStatistics("battery", count, None, None, 0.0756)
    aircraft = measured()
    aircraft.state.statistics = lambda _: statistics
    assert telemetry._rates(aircraft)["items"]["battery"]["longest_gap_s"] == gap_s


def test_echo_says_when_in_posix_time(cli: CommandLine) -> None:
    """Seconds since 1970, and the clock of the event loop, which counts from anywhere."""
    for line in cli("echo", "sim://", "position", "--json", "--packages", "3").objects:
        assert line["utc"] == pytest.approx(time.time(), abs=300.0)
        assert list(line)[:2] == ["received_at", "utc"]


@pytest.mark.usefixtures("wide")
@pytest.mark.parametrize(
    ("age_s", "shown"),
    [(0.25, ["250", "ms"]), (1.999, ["1999", "ms"]), (2.0, ["2.0", "s"]), (75.0, ["75.0", "s"])],
)
def test_monitor_shows_ages_below_two_seconds_in_milliseconds(
    age_s: float, shown: list[str]
) -> None:
    found = rows(telemetry._table(measured(age_s)))
    assert found["battery"] == ["87", "%", *shown, "49.5", "1.2", "ms"]
    assert " ".join(found["last"]) == "1001 frames, 17 bytes discarded, 5 packages refused"


# -- what is sent ---------------------------------------------------------------------------------


async def test_rates_are_packages_a_second(capsys: pytest.CaptureFixture[str]) -> None:
    async with rig(firmware="3.1") as flown:
        await asyncio.sleep(2.0)  # over so long they are counted

        @asynccontextmanager
        async def connect() -> AsyncIterator[Any]:
            yield flown.aircraft

        place = SimpleNamespace(connect=connect)
        link: Any = SimpleNamespace(place_among=lambda words, is_one: (place, words))
        await flight.rates("attitude=10", "battery=1", "rc=0", link=link)
    assert '"quaternion": 10.0,' in (told := capsys.readouterr().out)
    assert '"position": 100.0,' in told
    assert '"rc": 0.0,' in told


@pytest.mark.parametrize(
    ("words", "limit"), [(("151", "0", "0"), "150"), (("-90", "-121", "1"), "150")]
)
async def test_a_place_outside_is_refused_before_a_port_is_opened(
    words: tuple[str, ...], limit: str
) -> None:
    def opened() -> None:
        raise AssertionError("nothing is opened for what cannot be flown")

    place = SimpleNamespace(is_virtual=False, connect=opened, credentials=opened)
    options: Any = SimpleNamespace(place=lambda url: place)
    with pytest.raises(GuardRefused, match=f"the envelope ends at {limit} m"):
        await flight.fly(*words, options=options, yes=True)


@pytest.mark.parametrize("answer", ["", "n", "no", "j", "yess", "1"])
async def test_whatever_is_not_yes_is_no(answer: str, monkeypatch: pytest.MonkeyPatch) -> None:
    async def read_line() -> str:
        return answer

    monkeypatch.setattr(sys, "stdin", SimpleNamespace(isatty=lambda: True))
    monkeypatch.setattr(flight, "read_line", read_line)
    with pytest.raises(UsageError, match="take off was not confirmed"):
        await flight.confirm(measured(), "take off")


@pytest.mark.parametrize("answer", ["y", "Y", "yes", "YES"])
async def test_yes_is_yes(answer: str, monkeypatch: pytest.MonkeyPatch) -> None:
    async def read_line() -> str:
        return answer

    monkeypatch.setattr(sys, "stdin", SimpleNamespace(isatty=lambda: True))
    monkeypatch.setattr(flight, "read_line", read_line)
    await flight.confirm(measured(), "take off")


@pytest.mark.parametrize("answer", ["y", "Y", "yes", "YES", "", "n", "no", "j", "yess", "1"])
@pytest.mark.parametrize(
    ("take_off", "question"),
    [(True, "take off and fly this mission?"), (False, "fly this mission?")],
)
def test_a_mission_of_a_fleet_is_flown_by_a_yes_alone(
    monkeypatch: pytest.MonkeyPatch, answer: str, take_off: bool, question: str
) -> None:
    asked: list[str] = []

    def answered(text: str) -> str:
        asked.append(text)
        return answer

    monkeypatch.setattr("builtins.input", answered)
    plan = WaypointPlan([Waypoint(52.0, 4.3, height=20.0), Waypoint(52.001, 4.3, height=20.0)])
    monkeypatch.setattr(sys, "stdin", SimpleNamespace(isatty=lambda: False))
    with pytest.raises(UsageError, match="no terminal to ask whether kite may fly this"):
        fleet_plans._confirm("kite", plan, take_off=take_off)
    assert asked == []
    monkeypatch.setattr(sys, "stdin", SimpleNamespace(isatty=lambda: True))
    is_yes = answer.lower() in ("y", "yes")
    with nullcontext() if is_yes else pytest.raises(UsageError, match="nothing was begun"):
        fleet_plans._confirm("kite", plan, take_off=take_off)
    assert asked == [f"{question} [y/N] "]


@pytest.mark.parametrize(
    ("verb", "last"), [(flight.land, "land"), (flight.home, "go_home")], ids=["land", "home"]
)
async def test_the_mission_ends_before_it_is_ordered_down(
    verb: Any, last: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The aircraft ignores everything else until a mission is over or stopped."""
    done: list[str] = []

    def noting(name: str, found: object = None) -> Any:
        async def note(**_: object) -> object:
            done.append(name)
            return found

        return note

    control = SimpleNamespace(
        stop_mission=noting("stop_mission", MissionKind.WAYPOINT),
        land=noting("land"),
        go_home=noting("go_home"),
    )
    aircraft = SimpleNamespace(mission=SimpleNamespace(is_running=True))

    @asynccontextmanager
    async def in_control(*_: object, **__: object) -> AsyncIterator[tuple[Any, Any]]:
        yield aircraft, control

    monkeypatch.setattr(flight, "in_control", in_control)
    await verb(options=SimpleNamespace(place=lambda url: None))
    assert done == ["stop_mission", last]


# -- what a mission in flight is waited for -------------------------------------------------------


@pytest.mark.parametrize(
    ("firmware", "known_after", "waits"),
    [("3.1", 0.0, 0.0), ("3.1", 0.32, 0.35), ("3.1", 9.0, 1.0), ("1.0", 9.0, 0.0)],
)
async def test_a_second_is_enough_to_hear_of_a_mission(
    firmware: str, known_after: float, waits: float
) -> None:
    """Firmware that knows missions says which one it flies; older firmware never does."""
    loop, began = asyncio.get_running_loop(), asyncio.get_running_loop().time()

    class Aircraft(SimpleNamespace):
        @property
        def mission(self) -> Any:
            is_known = loop.time() - began >= known_after
            kind = MissionKind.NONE if is_known else MissionKind.UNKNOWN
            return SimpleNamespace(kind=kind, is_running=False)

    await flight.hear_of_mission(cast("Any", Aircraft(firmware=PROFILES[firmware])))
    assert loop.time() - began == pytest.approx(waits, abs=0.026)


# -- the line -------------------------------------------------------------------------------------


def test_round_trips_are_told_in_milliseconds() -> None:
    """Bounds of 1, 2, 5 ... 2000 ms; half of these took up to 2 ms, the slowest 500."""
    trips = RoundTrips((4, 6, 0, 0, 9, 0, 0, 0, 1, 0, 0, 0), 0.9)
    told = connection._described(trips)
    assert (told["count"], told["mean_ms"]) == (20, 45.0)
    assert told["within_ms"] == {"50%": 2.0, "95%": 20.0, "99%": 500.0}
    assert told["up_to_ms"]["20"] == 9
    assert list(told["up_to_ms"]) == [
        *("1", "2", "5", "10", "20", "50", "100", "200", "500", "1000", "2000", "more")
    ]
    assert connection._described(RoundTrips())["mean_ms"] is None


def test_rates_that_arrive_are_told_in_hertz() -> None:
    told = connection._arriving({"telemetry": {"battery": 1.0, "rc": 49.5, "gimbal": None}})
    assert told == "battery 1 Hz, rc 49.5 Hz, gimbal"
    assert connection._arriving({"telemetry": {}}) == "nothing arrives"
    assert connection.telemetry_rates(measured()) == {"battery": 49.5}


STAGES = [
    ("PORT PERMISSION OWNER INTERFERENCE OPENING", ExitCode.PORT, ExitCode.PORT),
    ("BYTES FRAMES TELEMETRY VERSION FIRMWARE ACCELERATION", ExitCode.NO_LINK, ExitCode.NO_LINK),
    ("ACTIVATION KEY", ExitCode.ACTIVATION, ExitCode.NO_LINK),
    ("MODE_SWITCH AUTHORITY", ExitCode.AUTHORITY, ExitCode.NO_LINK),
]


@pytest.mark.parametrize(("names", "status", "when_silent"), STAGES)
def test_the_exit_status_is_that_of_the_stage_or_of_the_line(
    names: str, status: int, when_silent: int
) -> None:
    for name in names.split():
        for error, expected in (
            (None, status),
            (AckTimeout("no answer"), when_silent),
            (LinkError("it went away"), when_silent),
            (UsageError("something else"), status),
        ):
            failure = SimpleNamespace(stage=Stage[name], error=error)
            report: Any = SimpleNamespace(failure=failure)
            assert connection.exit_status(report) == expected, (name, error)
    assert connection.exit_status(cast("Any", SimpleNamespace(failure=None))) == ExitCode.OK


DIAGNOSED = [
    ("tcp://a:1", None, {}),
    ("tcp://a:1 --app-id 7 --key " + "0f" * 32, 7, {}),
    ("sim://", DEMO_APP_ID, {}),
    ("tcp://a:1 --authority", None, {"authority": True}),
    (
        "tcp://a:1 --firmware 2.3 --baud 115200 --acceleration raw",
        None,
        {"firmware": "2.3", "baud_rate": 115_200, "acceleration": "raw"},
    ),
]


@pytest.mark.parametrize(("words", "app", "how"), DIAGNOSED)
def test_what_the_doctor_is_asked(
    cli: CommandLine,
    monkeypatch: pytest.MonkeyPatch,
    words: str,
    app: int | None,
    how: dict[str, Any],
) -> None:
    """In a pipe it asks nobody, and says nothing but its report."""
    asked: list[tuple[str, dict[str, Any]]] = []

    async def diagnose(url: str, **options: Any) -> Any:
        asked.append((url, options))
        return SimpleNamespace(to_json=lambda: {"ok": True}, failure=None, doubts=(), findings=())

    monkeypatch.setattr(connection, "diagnose", diagnose)
    outcome = cli("doctor", *words.split())
    assert (outcome.status, outcome.objects) == (0, [{"ok": True, "exit_status": 0}])
    [(url, options)] = asked
    assert url == words.split()[0]
    credentials = options.pop("credentials")
    assert (credentials and credentials.app_id) == app
    usual = dict.fromkeys(("firmware", "baud_rate", "acceleration")) | {"authority": False}
    assert options == usual | how


@pytest.mark.parametrize("answer", ["n", "y"])
@pytest.mark.parametrize("may_be_tried", [False, True])
def test_the_doctor_tries_authority_only_after_a_yes(
    cli: CommandLine, monkeypatch: pytest.MonkeyPatch, may_be_tried: bool, answer: str
) -> None:
    asked: list[bool] = []
    finding = Finding(
        Stage.AUTHORITY,
        Verdict.SKIPPED,
        "not tried",
        details={"may_be_tried": may_be_tried},
    )

    async def diagnose(_: str, *, authority: bool, **__: Any) -> Any:
        asked.append(authority)
        return SimpleNamespace(to_json=dict, failure=None, doubts=(), findings=[finding])

    async def read_line() -> str:
        return answer

    monkeypatch.setattr(connection, "diagnose", diagnose)
    monkeypatch.setattr(connection, "read_line", read_line)
    monkeypatch.setattr(sys, "stdin", SimpleNamespace(isatty=lambda: True))
    outcome = cli("doctor", "tcp://a:1", "--table")
    assert outcome.status == 0
    tries = may_be_tried and answer == "y"
    assert asked == ([False, True] if tries else [False])
    assert ("Obtain control authority" in outcome.err) is may_be_tried
    assert outcome.out.count("not tried") == (1 if tries else 0)


@pytest.mark.parametrize(
    ("given", "status"), [((True, False), 0), ((True, True), 4), ((False, False), 6)]
)
def test_a_first_contact_says_whether_control_went_back(
    cli: CommandLine, monkeypatch: pytest.MonkeyPatch, given: tuple[bool, bool], status: int
) -> None:
    is_given_back, is_cut_off = given

    async def meet(url: str, **how: Any) -> Any:
        named = {name: how[name] for name in ("firmware", "baud_rate", "timeout")}
        assert (url, named) == (
            "tcp://a:1",
            {"firmware": "2.3", "baud_rate": 115_200, "timeout": 2.5},
        )
        assert how["credentials"] is None
        return SimpleNamespace(is_given_back=is_given_back, is_cut_off=is_cut_off)

    monkeypatch.setattr(connection, "meet", meet)
    words = "first-contact tcp://a:1 --firmware 2.3 --baud 115200 --timeout 2.5"
    assert cli(*words.split()).status == status


# -- a mission on the screen ----------------------------------------------------------------------


def shown_mission(at_end: AtEnd = AtEnd.HOVER) -> Any:
    """The display of a mission, on which an aircraft hovers at 9.96 m."""
    state = SimpleNamespace(
        believed_status=FlightStatus(FlightPhase.IN_AIR), position=SimpleNamespace(height_m=9.96)
    )
    return mission._Show(short_plan(at_end=at_end), cast("Any", SimpleNamespace(state=state)))


OVER, FLIES = SimpleNamespace(is_over=True), SimpleNamespace(is_over=False)
STOPPED: list[tuple[list[Any], AtEnd, Any, bool, str]] = [
    ([], AtEnd.HOVER, OVER, False, "mission not started; the aircraft hovers at 10.0 m"),
    ([], AtEnd.HOVER, OVER, True, "mission not started; the aircraft stands on the ground"),
    (
        [Started()],
        AtEnd.HOVER,
        OVER,
        False,
        "mission stopped before waypoint 0; the aircraft hovers at ",
    ),
    (
        [Reached(0), Reached(2)],
        AtEnd.HOVER,
        OVER,
        False,
        "mission stopped after waypoint 2; the aircraft hovers at ",
    ),
    ([Reached(0)], AtEnd.HOVER, FLIES, False, "nothing confirmed the stop, the mission may fly"),
    ([Finished()], AtEnd.HOVER, OVER, False, "mission finished; the aircraft hovers at 10.0 m"),
    ([Finished()], AtEnd.LAND, OVER, True, "mission finished; the aircraft stands on the ground"),
    ([Finished()], AtEnd.LAND, FLIES, False, "all waypoints are flown; the aircraft lands"),
    ([Finished()], AtEnd.GO_HOME, FLIES, False, "all waypoints are flown; the aircraft lands"),
    ([Finished()], AtEnd.HOVER, FLIES, False, "nothing confirmed the stop, the mission may fly"),
]


@pytest.mark.parametrize(("events", "at_end", "flown", "on_ground", "told"), STOPPED)
@pytest.mark.usefixtures("capsys")
def test_a_mission_that_was_left_early_is_told_as_it_is(
    events: list[Any], at_end: AtEnd, flown: Any, on_ground: bool, told: str
) -> None:
    show = shown_mission(at_end)
    if on_ground:
        show._aircraft.state.believed_status = FlightStatus(FlightPhase.STANDBY)
    for event in events:
        show.tell(event, flown)
    assert show.stopped(flown).startswith(told)
    assert ("m100link land" in show.stopped(flown)) is ("hovers" in told)


def test_events_have_few_words_and_the_bar_its_share() -> None:
    show = shown_mission()
    assert [show._bar(done).count("█") for done in range(5)] == [0, 5, 10, 15, 20]
    assert {len(show._bar(done)) for done in range(5)} == {20}
    show.uploading(Uploading(1, 4))
    assert show._line == f"uploading {show._bar(2)} 2 of 4"
    assert event_name(Reached(1)) == "reached"
    assert event_name(ActionsDone(1)) == "actions_done"
    assert event_words(Reached(3)) == "reached 3"
    assert event_words(Uploaded(4, 61.6)) == "uploaded: 4 waypoints, about 62 s"
    assert event_words(Aborted(7, "no GPS", 2)) == "aborted 2: no GPS"


async def test_a_track_has_a_point_every_twenty_centimetres() -> None:
    """Where nobody knows the place, there is none."""
    show = shown_mission()
    first = short_plan().waypoints[0]
    frame = LocalFrame(first.latitude_deg, first.longitude_deg)

    def place(latitude: float, longitude: float) -> Position:
        return position(latitude=latitude, longitude=longitude)

    places: list[Any] = [
        place(*frame.to_geodetic(0.0, east)) for east in (0.0, 0.15, 0.25, 0.3, 0.5)
    ]
    places[1:1] = [None, place(math.nan, 0.0)]

    async def telemetry(kind: type, *, policy: Any, rate_hz: float) -> AsyncIterator[Any]:
        assert (kind, type(policy).__name__, rate_hz) == (Position, "Latest", 4.0)
        for one in places:
            yield SimpleNamespace(get=lambda _, one=one: one)

    show._aircraft.telemetry = telemetry
    await show._follow()
    assert [round(east, 2) for _, east in show._track] == [0.0, 0.25, 0.5]


# -- the simulator on the screen ------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "address"),
    [
        ("7000", ("127.0.0.1", 7000)),
        ("0.0.0.0:0", ("0.0.0.0", 0)),
        ("x:65535", ("x", 65_535)),
        ("x:65536", None),
        ("x:-1", None),
        ("x", None),
    ],
)
def test_where_a_simulator_listens(text: str, address: tuple[str, int] | None) -> None:
    if address is None:
        with pytest.raises(UsageError, match=r"is not \[HOST:\]PORT"):
            sim._read_address(text)
    else:
        assert sim._read_address(text) == address


@pytest.mark.parametrize(
    ("link", "tcp", "ports"),
    [
        (None, None, ["pty0", "pty1"]),
        ("/x/m", None, ["/x/m0", "/x/m1"]),
        (None, ("h", 7000), ["tcp://h:7000", "tcp://h:7001"]),
        (None, ("h", 0), ["tcp://h:9", "tcp://h:9"]),
        ("/x/m", ("h", 7000), ["/x/m0", "/x/m1"]),
    ],
)
async def test_each_simulated_aircraft_has_a_port(
    monkeypatch: pytest.MonkeyPatch,
    link: str | None,
    tcp: tuple[str, int] | None,
    ports: list[str],
) -> None:
    """Numbered from 0, and TCP ports counted up from the one that was named."""
    served: list[int] = []

    async def serve_tcp(_: object, host: str, number: int) -> Any:
        assert host == "h"
        served.append(number)
        return SimpleNamespace(port=number or 9)

    def pty(driver: object, *, link: Path | None) -> Any:
        return SimpleNamespace(name=str(link) if link else f"pty{driver}")

    monkeypatch.setattr(sim, "serve_tcp", serve_tcp)
    monkeypatch.setattr(sim, "PtyPort", pty)
    plan: Any = SimpleNamespace(link=link and Path(link), tcp=tcp)
    servers: list[Any] = []
    assert await sim._open_ports(plan, cast("Any", [0, 1]), servers) == ports
    assert len(served) == len(servers) == (2 if tcp else 0)
    assert served == ([7000, 7001] if tcp == ("h", 7000) else [0, 0] if tcp else [])


async def test_a_port_of_a_simulator_that_is_taken_is_named(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    async def serve_tcp(*_: object) -> Any:
        raise OSError(98, "it is taken")

    monkeypatch.setattr(sim, "serve_tcp", serve_tcp)
    monkeypatch.setattr(sim, "PtyPort", lambda *_, **__: SimpleNamespace(name="pty"))
    plan: Any = SimpleNamespace(link=None, tcp=("h", 7000))
    with pytest.raises(UsageError, match="cannot listen on h:7000: it is taken"):
        await sim._open_ports(plan, cast("Any", [0]), [])


@pytest.mark.parametrize("speed", [0.0, -1.0, 1000.5])
def test_a_clock_that_cannot_be_is_refused(cli: CommandLine, speed: float) -> None:
    outcome = cli("sim", "--speed", f"{speed:g}")
    assert outcome.status == ExitCode.USAGE
    assert f"the speed is {speed:g}\n  what to do:   above 0 and at most 1000" in outcome.err
    assert "'x' is not [HOST:]PORT" in cli("sim", "--speed", "1000", "--tcp", "x").err


def test_the_screen_of_a_simulator_has_degrees_metres_and_signs() -> None:
    assert sim._degrees(math.radians(-12.34)) == "-12.3°"
    assert sim._degrees(math.radians(7.0)) == "+7.0°"
    assert sim._app(True, True, 7) == "connected, app 7 active"
    assert sim._app(True, False, None) == "connected, no Internet, not activated"
    assert sim._app(False, False, None) == "not connected, not activated"
    flown = {"kind": "waypoint", "is_paused": False, "doing": "flying"}
    assert sim._mission(flown) == ("waypoint: flying", "", "")
    flown |= {"is_paused": True, "waypoint": 2, "waypoints": 5}
    assert sim._mission(flown) == ("waypoint: paused", "waypoint", "2 of 0 to 4")


# -- a fleet on the screen ------------------------------------------------------------------------


def test_cards_are_told_with_their_units(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(time, "time", lambda: 0.0)  # else their clocks are told to be behind
    cards = {
        "a1": Card(
            "a1", "run", 0.0, "connected", holder="anna", task="land", phase="in air",
            height_m=12.34, battery_percent=63, lost="land", lost_after=2.5,
        ),
        "a2": Card("a2", "", 0.0, "lost", fault=RemoteError("M100-X", "no port")),
    }  # fmt: skip
    found = rows(fleet_verbs._table(["a1", "a2", "a3"], cards))
    assert found["a1"] == [
        *("connected", "in", "air", "12.3", "m", "63", "%", "land", "anna", "land", "after"),
        *("2.5", "s"),
    ]
    assert found["a2"] == ["lost:", "no", "port"]
    assert found["a3"] == ["no", "answer"]


class HeardState:
    """What was heard of an aircraft: each number is another one."""

    newest_at = 50.0

    def __init__(self, newest_age: float | None, *items: Any) -> None:
        self.newest_age = newest_age
        self._items = {type(item): item for item in items}

    def fresh(self, kind: type[Any], *, now: float) -> Any:
        assert now == 50.0, "as it was when it was heard last"
        return self._items.get(kind)


def heard_fleet() -> tuple[Any, Any]:
    """Three aircraft: one in the air, one that is there and says little, one that has gone."""
    velocity = Velocity(3.0, -4.0, 1.5, None)
    flown = position(latitude=52.1, longitude=-4.3)
    states = {
        "a1": HeardState(0.26, flown, velocity, Battery(63), FlightStatus(FlightPhase.IN_AIR)),
        "a2": HeardState(2.04),
        "a3": HeardState(75.4, Battery(9)),
    }
    fleet = SimpleNamespace(present={"a1", "a2", "a4"})
    return fleet, SimpleNamespace(states=states, received={"a1": 7, "a2": 8, "a3": 9, "a4": 0})


def test_a_fleet_is_shown_with_the_age_of_what_was_heard() -> None:
    table = fleet_verbs._wall(*heard_fleet())
    found = rows(table)
    assert found["name"] == ["age", "phase", "height", "speed", "battery", "place"]
    assert found["a1"] == [
        *("0.3", "s", "in", "air", "12.3", "m", "5.0", "m/s", "63", "%", "52.100000", "-4.300000")
    ]
    assert found["a2"] == ["2.0", "s"]
    assert found["a3"] == ["gone,", "75", "s", "9", "%"]
    assert found["a4"] == ["never", "heard"]
    assert [str(row.style or "") for row in table.rows] == ["", "red", "red", ""]


def test_a_fleet_is_printed_with_what_was_heard() -> None:
    fleet, heard = heard_fleet()
    one, two, gone, never = (
        fleet_verbs._facts(fleet, heard, name) for name in ("a1", "a2", "a3", "a4")
    )
    assert one["position"]["latitude_rad"] == pytest.approx(math.radians(52.1))
    assert (one["velocity"]["north_m_s"], one["velocity"]["east_m_s"]) == (3.0, -4.0)
    assert (one["battery"], one["flight_status"]) == ({"percent": 63}, {"status": 3})
    assert (one["name"], one["is_there"], one["received"], one["age"]) == ("a1", True, 7, 0.26)
    assert (two["battery"], two["age"], gone["is_there"]) == (None, 2.04, False)
    assert never == {"name": "a4", "is_there": True, "received": 0}


@pytest.mark.parametrize(
    ("came", "is_written", "told"),
    [
        (9000, False, "9,000 bytes"),
        (4000, False, "9,000 bytes, of which 5,000 were here already"),
        (9000, True, "9,000 bytes; the log is still being written, and this is its part so far"),
    ],
)
def test_a_log_that_is_here_says_how_much_of_it_came(
    capsys: pytest.CaptureFixture[str],
    came: int,
    is_written: bool,
    told: str,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(OutputFormat, "json", False)
    shown = fleet_verbs._Shown()
    shown.listener("a1")(4000, 9000)
    shown.listener("a2")(1000, 9000)
    shown.done(Fetched("a1", "one.mcap", Path("a1-one.mcap"), 9000, came, is_written))
    assert capsys.readouterr().out == f"a1: a1-one.mcap: {told}\n"
    shown.interrupted()
    left = "a2: 1,000 of 9,000 bytes are here; the same command continues"
    assert capsys.readouterr().err.split() == left.split()


MISSIONS = [
    ({}, "no mission"),
    ({"kind": "no mission"}, "no mission"),
    ({"kind": "hotpoint"}, "a hotpoint, which no operator of the fleet started"),
    ({"stage": "uploaded", "points": 3}, "uploaded, 0 of 3 waypoints"),
    (
        {"stage": "flying", "points": 3, "reached": b"\0\0\1", "elapsed_s": 61.6, "index": 2}
        | {"distance_m": 12.6},
        "flying, 2 of 3 waypoints, 62 s, 13 m to waypoint 2",
    ),
    (
        {"stage": "flying", "points": 3, "is_paused": True},
        "flying, 0 of 3 waypoints, paused, 0 s",
    ),
    (
        {"stage": "over", "points": 3, "fault": RemoteError("M100-X", "it was stopped")},
        "over, 0 of 3 waypoints: it was stopped",
    ),
]


@pytest.mark.parametrize(("card", "told"), MISSIONS)
def test_how_far_a_mission_is_in_words(card: dict[str, Any], told: str) -> None:
    if "stage" in card:
        card = card | {"stage": MissionStage(card["stage"])}
    assert fleet_plans._progress(MissionCard("a1", "run", **card)) == told


LEFT: list[tuple[list[Any], Any, AtEnd, str]] = [
    ([], None, AtEnd.HOVER, "mission not started"),
    ([], {"has_begun": False}, AtEnd.HOVER, "mission not started"),
    ([Reached(0)], {"is_over": False}, AtEnd.HOVER, "the stop was not confirmed; it ends with"),
    ([Reached(0), Reached(1)], {}, AtEnd.HOVER, "mission stopped after 2 of 4 waypoints; it"),
    ([Finished()], {}, AtEnd.HOVER, "every waypoint was flown"),
    ([Finished()], {}, AtEnd.LAND, "every waypoint was flown; it was landing"),
    ([Finished()], {}, AtEnd.GO_HOME, "every waypoint was flown; it was landing"),
]


@pytest.mark.parametrize(("events", "flown", "at_end", "told"), LEFT)
def test_what_a_command_leaves_of_a_mission_of_a_fleet(
    events: list[Any], flown: Any, at_end: AtEnd, told: str, capsys: pytest.CaptureFixture[str]
) -> None:
    show = fleet_plans._Show("a1", short_plan(at_end=at_end))
    for event in events:
        show.tell(event)
    assert capsys.readouterr().out.count('"name": "a1"') == len(events)
    if flown is not None:
        usual = {"has_begun": True, "is_over": True}
        show.mission = cast("Any", SimpleNamespace(**(usual | flown)))
    found = show.stopped()
    assert found.startswith(f"a1: {told}")
    assert (found == f"a1: {told}") is ("waypoint was flown" in told or "not started" in told)


def test_the_commonest_round_trip_has_40_blocks_and_the_others_their_share(
    capsys: pytest.CaptureFixture[str],
) -> None:
    counts = {"10": 20, "50": 40, "100": 0, "more": 10}
    connection._print_trips({"count": 70, "mean_ms": 31.5, "up_to_ms": counts})
    head, *rows = capsys.readouterr().out.splitlines()
    assert head == "answers after 31.5 ms on average; up to"
    assert [(*row.split()[:-1], row.count("█")) for row in rows] == [
        ("10", "ms", "20", 20),
        ("50", "ms", "40", 40),
        ("more", "10", 10),
    ]


def test_the_way_of_the_demo_is_all_its_legs_and_ends_beside_its_first_place() -> None:
    flight = demo._Flight(track=[(1.0, 2.0), (4.0, 6.0), (4.0, 2.0)])  # north, east, m
    assert (flight.path_length_m, flight.returned_within_m) == (9.0, 3.0)
    flight.heights = [(0.0, 1.0), (1.0, 7.0), (2.0, 3.25)]
    assert "height  3.25 m   north   4.00 m   east   2.00 m" in demo._progress(flight).renderables


async def test_a_stage_of_the_demo_takes_the_seconds_between_its_ends() -> None:
    flight = demo._Flight()
    await asyncio.sleep(3.0)
    with flight.during("square"):
        await asyncio.sleep(2.0)
    assert flight.stages == pytest.approx({"square": 2.0})


def test_an_order_to_a_simulator_that_is_refused_is_an_error(
    monkeypatch: pytest.MonkeyPatch, cli: CommandLine
) -> None:
    answer = {"ok": False, "error": "there is no such order", "status": {}}
    monkeypatch.setattr(sim, "send_order", lambda *_, **__: answer)
    outcome = cli("sim", "ctl", "fall")
    assert (outcome.status, outcome.out) == (ExitCode.USAGE, "")
    assert "there is no such order" in outcome.err


def test_a_key_of_a_simulator_is_in_one_place() -> None:
    both = sim.RegisteredAppOptions(key="0f" * 32, key_file=Path("/none"))
    with pytest.raises(UsageError, match="exclude each other") as caught:
        both.secret()
    assert caught.value.remedy == "give one of them"


# -- what a terminal shows, and what is refused in words ------------------------------------------


@pytest.fixture
def said(monkeypatch: pytest.MonkeyPatch) -> Any:
    """What verbs print on both streams, at a terminal of 200 columns, line by line."""
    written = io.StringIO()
    screen = Console(file=written, width=200, highlight=False, markup=False)
    for module in (connection, flight, mission, telemetry):
        monkeypatch.setattr(module, "out", screen, raising=False)
        monkeypatch.setattr(module, "err", screen, raising=False)
    monkeypatch.setattr(sys, "stdin", SimpleNamespace(isatty=lambda: True))
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True, raising=False)
    return lambda: [line.rstrip() for line in written.getvalue().replace("\r", "\n").splitlines()]


@pytest.mark.parametrize(
    ("phase", "height_m", "shown"),
    [
        (FlightPhase.TAKING_OFF, 0.456, " 12.3 s  taking off          0.46 m"),
        (None, None, " 12.3 s"),
    ],
)
def test_how_far_a_task_is(said: Any, phase: Any, height_m: Any, shown: str) -> None:
    flight._show(TaskProgress(Task.TAKE_OFF, 12.34, phase, height_m, None))
    assert said() == [shown]


def test_nothing_is_shown_where_nobody_looks(said: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys.stderr, "isatty", lambda: False, raising=False)
    flight._show(TaskProgress(Task.LAND, 1.0, None, None, None))
    assert said() == []


@pytest.mark.parametrize(
    ("words", "seen"),
    [
        ((), "no action was given"),
        (("sim://",), "no action was given"),
        (("explode",), "the camera has no action 'explode'"),
        (("sim://", "explode", "now"), "the camera has no action 'explode'"),
        (("photo", "photo"), "2 actions were given: photo photo"),
        (("photo", "sim://"), "'photo sim://' is not an aircraft and an action"),
        (("a", "b", "photo"), "'a b photo' is not an aircraft and an action"),
    ],
)
async def test_what_is_no_action_of_the_camera(words: tuple[str, ...], seen: str) -> None:
    with pytest.raises(UsageError) as caught:
        await flight.camera(*words)
    assert caught.value.seen == seen
    assert caught.value.remedy.endswith("one of: photo, start-video, stop-video")


@pytest.mark.parametrize(
    ("words", "found"),
    [
        (["attitude=50", "battery=1"], {"attitude": 50, "battery": 1}),
        (["rc=0"], {"rc": 0}),
        ([], {}),
        (["rc"], "'rc' is not a rate"),
        (["rc="], "'rc=' is not a rate"),
        (["rc=-1"], "'rc=-1' is not a rate"),
        (["rc=²"], "'rc=²' is not a rate"),
        (["rc=1", "rc=10"], "two rates were given for rc"),
    ],
)
def test_rates_are_pairs(words: list[str], found: Any) -> None:
    if isinstance(found, dict):
        assert common.pairs(words) == found
        return
    with pytest.raises(UsageError) as caught:
        common.pairs(words)
    assert caught.value.seen == found


@pytest.mark.parametrize(
    ("word", "is_rate"), [("rc=1", True), ("rc", False), ("sim://?firmware=3.1", False)]
)
def test_a_place_is_no_rate(word: str, is_rate: bool) -> None:
    assert flight._is_rate(word) is is_rate


@pytest.mark.parametrize(
    "wrong",
    [
        {"rates": True},
        {"rates": True, "relative": True, "yaw": 1.0},
        {"pitch": 30.1},
        {"roll": -36.0},
    ],
)
async def test_a_gimbal_is_refused_before_a_port_is_opened(wrong: dict[str, Any]) -> None:
    def opened() -> None:
        raise AssertionError("nothing is opened for what cannot be")

    place = SimpleNamespace(is_virtual=False, connect=opened, credentials=opened)
    options: Any = SimpleNamespace(place=lambda url: place)
    with pytest.raises(UsageError):
        await flight.gimbal(options=options, **wrong)


def waypoint_flight(ended_by: BaseException | None) -> Any:
    """A mission that reaches waypoint 1, is over, and ends so."""

    class Mission:
        is_over = True

        async def __aenter__(self) -> Mission:
            return self

        async def __aexit__(self, *_: object) -> None:
            return None

        async def __aiter__(self) -> AsyncIterator[Any]:
            yield Reached(1)
            if ended_by is not None:
                raise ended_by

    return Mission()


@pytest.mark.parametrize(
    ("ended_by", "status", "told"),
    [
        (None, ExitCode.OK, []),
        (ReaderGone(), ExitCode.FAILED, ["output closed: mission stopped after waypoint 1; the"]),
        (asyncio.CancelledError(), None, ["mission stopped after waypoint 1; the aircraft hovers"]),
    ],
)
async def test_a_mission_that_is_left_says_where_once_control_went_back(
    said: Any, capsys: pytest.CaptureFixture[str], ended_by: Any, status: Any, told: list[str]
) -> None:
    order: list[str] = []

    async def telemetry(*_: object, **__: object) -> AsyncIterator[Any]:
        await asyncio.sleep(100)
        yield None

    state = shown_mission()._aircraft.state
    aircraft = SimpleNamespace(telemetry=telemetry, state=state)
    control = SimpleNamespace(waypoint_mission=lambda *_, **__: waypoint_flight(ended_by))

    @asynccontextmanager
    async def controlled() -> AsyncIterator[Any]:
        try:
            yield aircraft, control
        finally:
            order.extend([*said(), "control went back"])

    flying = mission._fly(controlled(), short_plan(), take_off=False, allow_far=False)
    if status is None:
        with pytest.raises(asyncio.CancelledError):
            await flying
    else:
        assert await flying == status
    assert order == ["control went back"]
    assert len(said()) == len(told)
    assert all(line.startswith(begin) for line, begin in zip(said(), told, strict=True))
    assert '"event": "reached"' in capsys.readouterr().out


def test_a_terminal_has_a_map_and_the_progress_in_metres_and_seconds(
    said: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys.stdout, "isatty", lambda: True, raising=False)
    show = shown_mission()
    show.tell(Reached(1), FLIES)
    assert said() == ["reached 1"]
    show.tell(MissionProgress(61.4, 2, None, 12.6, 10.0), FLIES)
    assert show._line == f"{show._bar(2)} 2 of 4  13 m to waypoint 2, 61 s"
    assert said() == ["reached 1"], "progress is drawn, and no line of its own"
    show._track = [(0.0, 0.0), (5.0, 5.0)]
    assert "".join(show._map()).count("@") == 1
    show.end()
    assert len(said()) > 10


@pytest.mark.parametrize(
    ("firmware", "phase", "waits", "is_refused"),
    [
        ("3.1", FlightPhase.STANDBY, 0.0, True),
        ("3.1", FlightPhase.IN_AIR, 0.0, False),
        ("3.1", None, 1.0, False),
        ("1.0", FlightPhase.STANDBY, 0.0, False),  # it is refused for its firmware later
    ],
)
async def test_a_mission_from_the_ground_is_refused_if_the_aircraft_says_that_it_stands_there(
    firmware: str, phase: FlightPhase | None, waits: float, is_refused: bool
) -> None:
    status = None if phase is None else FlightStatus(phase)
    aircraft: Any = SimpleNamespace(
        firmware=PROFILES[firmware], state=SimpleNamespace(believed_status=status)
    )
    loop = asyncio.get_running_loop()
    began = loop.time()
    if is_refused:
        with pytest.raises(UsageError, match="the aircraft stands on the ground"):
            await mission._require_airborne(aircraft)
    else:
        await mission._require_airborne(aircraft)
    assert loop.time() - began == pytest.approx(waits, abs=0.051)


ROWS = {
    "bytes_received": 1000,
    "frames_received": 99,
    "bytes_sent": 500,
    "frames_sent": 44,
    "discarded_bytes": 7,
    "discards": {"frame_crc": 3},
    "repeats": 4,
    "acks": 33,
    "late_acks": 5,
    "duplicate_acks": 6,
    "foreign_acks": 8,
    "dropped_writes": 9,
}


def test_a_line_is_told_with_each_count_at_its_name(said: Any) -> None:
    connection._print(
        {
            "line": ROWS,
            "asked": 20,
            "unanswered": 2,
            "telemetry": {"battery": 1.0, "time": None},
            "telemetry_mismatches": 11,
            "latency": "slow line",
            "round_trips": {"count": 0},
        }
    )
    assert [" ".join(line.split()) for line in said()] == [
        "received 1000 bytes, 99 frames",
        "sent 500 bytes, 44 frames",
        "discarded 7 bytes, frame_crc 3",
        "questions 20, 2 without an answer, 4 repeats",
        "acks 33; late 5, twice 6, to no question 8",
        "not written 9 frames",
        "telemetry battery 1 Hz, time",
        "latency slow line",
        "warning 11 telemetry packages do not fit this firmware",
    ]


@pytest.mark.parametrize("is_known", [True, False])
def test_an_aircraft_is_told_with_what_it_does_not_say(said: Any, is_known: bool) -> None:
    connection._print_info(
        {
            "version": "M100",
            "serial": "0123" if is_known else None,
            "activated": is_known,
            "firmware": "3.1",
            "firmware_is_forced": not is_known,
            "firmware_summary": "summary",
            "acceleration": "raw" if is_known else None,
            "telemetry": {},
            "telemetry_mismatches": 0,
            "latency": "",
            "line": ROWS,
        }
    )
    assert [" ".join(line.split()) for line in said()] == [
        "version M100",
        "serial 0123" if is_known else "serial this firmware does not report it",
        "activated yes" if is_known else "activated no",
        "firmware 3.1 (by its version)" if is_known else "firmware 3.1 (forced)",
        "summary",
        "acceleration raw" if is_known else "acceleration raw or fused: not known yet",
        "telemetry nothing arrives",
        "line 1000 bytes, 99 frames, 7 bytes discarded {'frame_crc': 3}",
    ]


@pytest.mark.parametrize(
    ("verdict", "shown"),
    [
        (Verdict.GOOD, ["✓ the port exists               it is there"]),
        (
            Verdict.DOUBTFUL,
            [
                "! the port exists               it is there",
                "    likely 1. a loose plug",
                "           2. no power",
                "    to do  1. m100link ports",
            ],
        ),
    ],
)
def test_a_finding_is_told_and_a_doubt_has_its_causes(
    said: Any, verdict: Verdict, shown: list[str]
) -> None:
    finding = Finding(
        Stage.PORT, verdict, "it is there", ("a loose plug", "no power"), ("m100link ports",)
    )
    connection._tell(finding)
    assert said() == shown


@pytest.mark.parametrize(
    ("observation", "shown"),
    [
        (Observation(Topic.RELEASE, "released", "3 of 3"), "✓ {} released: 3 of 3"),
        (Observation(Topic.RELEASE, "", "no app id"), "– {} not seen: no app id"),
        (
            Observation(Topic.RELEASE, "refused", "3 of 3"),
            "! {} refused: 3 of 3 (the virtual aircraft: released)",
        ),
    ],
)
def test_an_observation_is_told_beside_what_the_virtual_aircraft_does(
    said: Any, observation: Observation, shown: str
) -> None:
    connection._tell_observation(observation)
    assert [" ".join(line.split()) for line in said()] == [shown.format("answers to releasing")]


def test_a_fault_ends_the_report_with_its_causes_and_what_to_do(said: Any) -> None:
    failure = SimpleNamespace(causes=("a [cable]", "b"), commands=("ls [a-z]",))
    connection._conclude(cast("Any", SimpleNamespace(failure=failure, doubts=())))
    assert said() == [
        *("    likely 1. a [cable]", "           2. b", "    to do  1. ls [a-z]"),
        "more: m100link docs silent-line",
    ]


@pytest.mark.parametrize(
    ("answer", "agrees"), [("y", True), ("YES", True), ("", False), ("n", False), ("yess", False)]
)
@pytest.mark.parametrize("ask", [connection._agrees, lambda: connection._asked("Lift it.")])
async def test_a_person_agrees_by_yes_alone(
    said: Any, monkeypatch: pytest.MonkeyPatch, ask: Any, answer: str, agrees: bool
) -> None:
    async def read_line() -> str:
        return answer

    monkeypatch.setattr(connection, "read_line", read_line)
    assert await ask() is agrees
    assert "[y/N]" in said()[0]


@pytest.mark.parametrize("ask", [connection._agrees, lambda: connection._asked("Lift it.")])
async def test_without_a_terminal_nobody_agrees(
    said: Any, monkeypatch: pytest.MonkeyPatch, ask: Any
) -> None:
    monkeypatch.setattr(sys, "stdin", SimpleNamespace(isatty=lambda: False))
    assert await ask() is False


@pytest.mark.parametrize(
    ("field", "seen", "remedy"),
    [
        ("battery", "battery is an item, not a column", "one of: battery.percent"),
        (
            "position.hight_m",
            "no column is called 'position.hight_m'",
            "did you mean position.height_m? col",
        ),
        ("xyzzy", "no column is called 'xyzzy'", "columns: "),
    ],
)
async def test_a_column_that_there_is_not_is_named_with_those_that_are(
    field: str, seen: str, remedy: str
) -> None:
    with pytest.raises(UsageError) as caught:
        await telemetry.plot("sim://", field)
    assert caught.value.seen == seen
    assert remedy in caught.value.remedy


@pytest.mark.parametrize(
    ("found", "url", "named"),
    [
        (["/dev/ttyUSB0"], None, "/dev/ttyUSB0"),
        ([], None, None),
        (["/dev/ttyUSB0"], "sim://", None),
        (["/dev/ttyUSB0", "/dev/ttyUSB1"], "sim://", None),
    ],
)
def test_the_doctor_takes_the_only_port(
    monkeypatch: pytest.MonkeyPatch, found: list[str], url: str | None, named: str | None
) -> None:
    monkeypatch.delenv("M100LINK_URL", raising=False)
    monkeypatch.setattr(connection, "serial_ports", lambda: found)
    assert connection._only_port(cast("Any", SimpleNamespace(url=url))) == named


@pytest.mark.parametrize(
    ("name", "good", "bad"),
    [
        ("baud", (1, 230400), (0, -1, "9600", 9600.0)),
        ("timeout", (0.1, 3, 1e9), (0, -1.0, math.inf, math.nan, "3", True)),
        ("firmware", ("3.1",), ("9.9", 3.1)),
        ("acceleration", ("raw", "fused"), ("half", 1)),
        ("seen", ({},), ("", 1)),
    ],
)
def test_what_a_configuration_may_say(name: str, good: Any, bad: Any) -> None:
    assert [configuration._wrong(name, value) for value in good] == [""] * len(good)
    assert all(configuration._wrong(name, value) for value in bad)


async def test_an_end_is_an_event_and_cancels_what_began_it_until_it_is_waited_for() -> None:
    """A verb may wait for a router that never answers. A second signal ends nothing sooner."""
    waited: list[bool] = []
    ended_in_order: list[bool] = []

    async def verb(*, waits: bool) -> None:
        ended = common.ended_by_signal()
        for after_s in (1.0, 1.1, 1.9):
            asyncio.get_running_loop().call_later(after_s, ended.end)
        if waits:
            waited.append(await ended.wait())
            return
        try:
            await asyncio.sleep(1000)
        finally:
            await asyncio.sleep(1.0)  # a landing, or the end of a process
            ended_in_order.append(True)

    loop = asyncio.get_running_loop()
    numbers: list[int] = []
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(loop, "add_signal_handler", lambda number, _: numbers.append(number))
        await asyncio.create_task(verb(waits=True))
        with pytest.raises(asyncio.CancelledError):
            await asyncio.create_task(verb(waits=False))
    assert (waited, ended_in_order) == ([True], [True])
    assert numbers[:2] == [signal.SIGINT, signal.SIGTERM]


async def test_a_duration_ends_a_verb_and_an_error_of_its_own_does_too() -> None:
    loop = asyncio.get_running_loop()
    began = loop.time()
    await common.until(2.5, asyncio.sleep(100))
    assert loop.time() - began == pytest.approx(2.5)
    await common.until(None, asyncio.sleep(1))

    async def fails() -> None:
        raise TimeoutError("of its own")

    with pytest.raises(TimeoutError, match="of its own"):
        await common.until(2.5, fails())


@pytest.mark.parametrize(
    ("words", "found"),
    [
        (["5", "-3.5", "1e1"], (5.0, -3.5, 10.0)),
        (["5", "x", "0"], "'x' is not a number"),
        (["5", "nan", "0"], "'nan' is not a number"),
        (["inf", "0", "0"], "'inf' is not a number"),
        (["5", "0"], "2 numbers were given"),
        (["5", "0", "0", "1"], "4 numbers were given"),
        ([], "0 numbers were given"),
    ],
)
def test_a_flight_has_three_numbers(words: list[str], found: Any) -> None:
    if isinstance(found, tuple):
        assert flight._metres(words) == found
        return
    with pytest.raises(UsageError, match=found):
        flight._metres(words)


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("aa0B", b"\xaa\x0b"),
        ("0xAA 0Xbb:cc,dd\tee\n", b"\xaa\xbb\xcc\xdd\xee"),
        ("", b""),
        ("aa b", None),
        ("zz", None),
    ],
)
def test_hex_is_read_as_people_write_it(text: str, found: bytes | None) -> None:
    with nullcontext() if found is not None else pytest.raises(UsageError, match="not hex"):
        assert decode._from_hex(text) == found


def test_two_flights_are_compared_in_words(monkeypatch: pytest.MonkeyPatch) -> None:
    """A difference has its sign; a number that neither flight has is left out."""

    def value(name: str, first: float | None, second: float | None, by: float | None) -> Any:
        return SimpleNamespace(name=name, first=first, second=second, by=by)

    written = io.StringIO()
    monkeypatch.setattr(log, "out", Console(file=written, width=200, markup=False))
    values = [value("way, m", 12.0, 10.5, -1.5), value("photos", None, 3.0, None)]
    values += [value("none", None, None, None), value("alarms", 1.0, 3.0, 2.0)]
    log._print_comparison(
        cast(
            "Any",
            SimpleNamespace(
                values=values, most_apart=(61.25, 7.06), mean_apart_m=2.04, commands=[],
                alarms=["only in a: [low battery]"],
            ),
        ),
        *("a", "b"),
    )  # fmt: skip
    assert [line.split() for line in written.getvalue().splitlines()] == [
        *(["a", "b", "difference"], ["way,", "m", "12", "10.5", "-1.5"], ["photos", "3"]),
        ["alarms", "1", "3", "+2"],
        [
            "apart",
            "over",
            "ground:",
            "2.0",
            "m",
            "on",
            "average,",
            "at",
            "most",
            "7.1",
            "m,",
            "61.2",
            "s",
            "after",
            "take-off",
        ],
        ["commands:", "the", "same"],
        *(["alarms:"], ["only", "in", "a:", "[low", "battery]"]),
    ]


# -- what a station tells -------------------------------------------------------------------------


@pytest.mark.parametrize("level", ["info", "warning", "error"])
@pytest.mark.parametrize("is_named", [True, False])
def test_an_event_is_told_with_its_aircraft_in_the_log_or_in_words(
    level: str, is_named: bool, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    written = io.StringIO()
    monkeypatch.setattr(serve, "err", Console(file=written, width=20, markup=False))
    teller: Any = SimpleNamespace(do=lambda work: work())
    event: Any = SimpleNamespace(level=level, text="a very long [text] of what happened")
    words: Any = SimpleNamespace(log_json=False)
    serve.tell_event(teller, words, "kite", event, is_named=is_named)
    assert written.getvalue() == ("kite: " if is_named else "") + f"{event.text}\n"
    assert caplog.records == []
    with caplog.at_level("INFO"):
        serve.tell_event(teller, cast("Any", SimpleNamespace(log_json=True)), "kite", event)
    [record] = caplog.records
    assert (record.levelname, record.getMessage()) == (level.upper(), event.text)
    assert cast("Any", record).aircraft == "kite"


@pytest.mark.parametrize(
    ("given", "says"),
    [
        ({}, ""),
        ({"host": "0.0.0.0"}, "without TLS everybody on this network can read the token"),
        ({"allow_origin": ("null",)}, "--allow-origin null admits pages"),
        ({"allow_origin": ("https://a.b",)}, ""),
        ({"unused": ("[x]", "y")}, "has parameters that nothing reads: [x], y"),
    ],
)
def test_settings_that_are_dangerous_are_told(
    given: dict[str, Any], says: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    written = io.StringIO()
    monkeypatch.setattr(serve, "err", Console(file=written, width=300, markup=False))
    serve.warn_of(Settings(**given))
    assert says in written.getvalue()
    assert bool(written.getvalue()) is bool(says)


class Virtual:
    """As much of a virtual aircraft as the line for programs has."""

    autopilot = SimpleNamespace(profile=PROFILES["3.1"])
    credentials = SimpleNamespace(app_id=9, level=1)
    vehicle = SimpleNamespace(serial_number="S1")

    def __init__(self, name: str) -> None:
        self.name = name

    def __str__(self) -> str:
        return self.name


@pytest.mark.parametrize("fails", [False, True])
@pytest.mark.parametrize("has_scenario", [False, True])
async def test_a_simulator_ends_all_that_it_began(
    fails: bool,
    has_scenario: bool,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Seconds of the clock of the loop; the line for programs has who it is."""
    steps: list[str] = []
    drivers: list[Any] = []

    def driver(aircraft: str) -> Any:
        made = SimpleNamespace(scenario=None, stop=lambda: steps.append(f"stop {aircraft}"))
        drivers.append(made)
        return made

    async def open_ports(_: object, __: object, servers: list[Any]) -> list[str]:
        servers.append(SimpleNamespace(stop=noted("server")))
        if fails:
            raise UsageError("no port")
        return ["/dev/pts/1", "/dev/pts/2"]

    def noted(name: str) -> Any:
        async def note() -> None:
            steps.append(name)

        return note

    control = SimpleNamespace(start=noted("start"), stop=noted("stop"), path=Path("/x/ctl"))
    read = SimpleNamespace(read=lambda path: f"scenario of {path}")
    for name, fake in (
        *(("Driver", driver), ("_open_ports", open_ports), ("Scenario", read)),
        *(("CtlServer", lambda _: control), ("when_signalled", lambda *_: None)),
    ):
        monkeypatch.setattr(sim, name, fake)

    aircraft = [Virtual(one) for one in ("one", "two")]
    plan: Any = SimpleNamespace(
        aircraft=aircraft, seed=5, duration=3.0, scenario=Path("s") if has_scenario else None
    )
    loop = asyncio.get_running_loop()
    began = loop.time()
    monkeypatch.setattr(OutputFormat, "json", True)
    with nullcontext() if not fails else pytest.raises(UsageError):
        assert await sim._serve(plan) == 0
    assert steps == [*([] if fails else ["start"]), "stop", "server", "stop one", "stop two"]
    if fails:
        return
    assert loop.time() - began == pytest.approx(3.0)
    assert [one.scenario for one in drivers] == ["scenario of s" if has_scenario else None] * 2
    told = json.loads(capsys.readouterr().out)
    assert told | {"pid": 0} == {
        **{"port": "/dev/pts/1", "ports": ["/dev/pts/1", "/dev/pts/2"], "firmware": "3.1"},
        **{"seed": 5, "app_id": 9, "level": 1, "serial_number": "S1", "pid": 0},
        "control_socket": "/x/ctl",
    }


@pytest.mark.parametrize("with_rosbridge", [True, False])
@pytest.mark.parametrize("with_console", [True, False])
async def test_packages_are_looked_for_where_pages_are_served(
    with_rosbridge: bool, with_console: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    def missing() -> None:
        raise UsageError("a package is missing")

    def began(*_: object) -> Any:
        raise LinkError("it begins")

    monkeypatch.setattr(serve, "require_packages", missing)
    monkeypatch.setattr(serve, "_running", began)
    monkeypatch.setattr(serve, "ended_by_signal", lambda: None)
    options: Any = SimpleNamespace(show_config=False, log=None)
    with pytest.raises(UsageError if with_rosbridge or with_console else LinkError):
        await serve.run_station(
            {"m100": Settings()}, options, with_rosbridge=with_rosbridge, with_console=with_console
        )


@pytest.mark.parametrize(("duration", "ends_at"), [(1.0, None), (None, 0.5), (1.0, 0.5)])
async def test_the_screen_of_a_simulator_is_drawn_ten_times_a_second_until_its_end(
    duration: float | None, ends_at: float | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    drawn: list[float] = []
    loop, ended = asyncio.get_running_loop(), asyncio.Event()
    began = loop.time()

    class Live(nullcontext[Any]):
        def __init__(self, *_: object, **__: object) -> None:
            super().__init__(self)

        def update(self, *_: object, **__: object) -> None:
            drawn.append(loop.time() - began)

    monkeypatch.setattr("rich.live.Live", Live)
    monkeypatch.setattr(sim, "keys_pressed", lambda _: nullcontext())
    view = SimpleNamespace(render=str, press=None)
    monkeypatch.setattr(sim, "LiveView", lambda *_: view)
    if ends_at is not None:
        loop.call_later(ends_at, ended.set)
    await sim._show(cast("Any", SimpleNamespace(aircraft=[0], duration=duration)), ["p"], ended)
    until_s = ends_at or duration or math.inf
    assert loop.time() - began == pytest.approx(until_s, abs=0.11)
    assert drawn == pytest.approx([n / 10 for n in range(len(drawn))], abs=0.02)
    assert len(drawn) == pytest.approx(10 * until_s, abs=1)


@pytest.mark.parametrize(
    ("width", "columns", "rows"), [(10, 20, 6), (30, 30, 10), (60, 60, 16), (200, 80, 16)]
)
def test_a_map_of_a_mission_fits_its_terminal(
    width: int, columns: int, rows: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[dict[str, Any]] = []

    def plot(track: Any, **how: Any) -> list[str]:
        asked.append(how | {"track": list(track)})
        return []

    monkeypatch.setattr(mission, "track_plot", plot)
    monkeypatch.setattr(mission, "out", SimpleNamespace(width=width))
    show = shown_mission()
    show._map()
    show._track.append((1.0, 2.0))
    show._map()
    assert [(one["columns"], one["rows"]) for one in asked] == [(columns, rows)] * 2
    assert [one["marks"][0][1] for one in asked] == ["0", "@"]
    assert asked[1]["marks"][0][0] == (1.0, 2.0)


def test_each_limit_is_as_agreed() -> None:
    assert limits.differences("apps/cli") == []
