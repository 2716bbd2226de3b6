"""Each verb as a table: a command line, and the calls with their values and units.

Stand-ins note what a verb calls. No port is opened, and nothing takes real time.
"""

from __future__ import annotations

import asyncio
import inspect
import json
import shlex
import sys
import time
from collections.abc import AsyncIterator, Callable
from contextlib import AsyncExitStack, asynccontextmanager
from dataclasses import asdict, replace
from errno import ENOSPC, EPIPE
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest

from m100link.apps.cli import fleet_plans, fleet_setup, fleet_verbs, flight, log, serve, sim
from m100link.apps.cli.terminal import ExitCode, ReaderGone
from m100link.apps.fleet.logs.fetching import Fetched
from m100link.apps.fleet.lost_link import LostLinkPlan
from m100link.apps.fleet.payloads import Card, MissionCard, MissionStage, Result, ShowStage
from m100link.apps.fleet.show.conductor import Part
from m100link.apps.station.config import Settings
from m100link.apps.station.fleet import default_order_logs
from m100link.apps.station.fleet_file import FleetFault
from m100link.errors import LinkError, MissionRefused
from m100link.flight.control import Control
from m100link.flight.mission_state import MissionKind
from m100link.flight.missions.events import ActionsDone, Finished, Reached
from m100link.log.folder import LogEntry, default_folder
from m100link.protocol import Battery, FlightPhase, FlightStatus, Gimbal
from m100link.protocol.firmware import PROFILES
from m100link.sim.clock import VirtualClockEventLoop
from m100link.sim.vehicle.activation import DEMO_APP_ID, DEMO_KEY
from tests.apps.cli.conftest import CommandLine
from tests.apps.fleet.show.shows import FIVE
from tests.flight.missions.foreign import plan as short_plan

HERE, KEY = "tcp://127.0.0.1:9", "0f" * 32
CONNECT, ACTIVATE = f"connect({HERE!r})", "activate(7, level=2)"


class Notes(list[str]):
    """Calls as they are written in Python, without callbacks and without what is None."""

    def note(self, name: str, /, *values: object, **named: object) -> None:
        shown = [repr(one) for one in values if not callable(one)]
        shown += [f"{key}={one!r}" for key, one in named.items() if not callable(one)]
        self.append(f"{name}({', '.join(one for one in shown if not one.endswith('=None'))})")

    def awaited(self, answer: object, *names: str) -> dict[str, Callable[..., Any]]:
        """Coroutine functions of these names, which answer so."""

        def noting(name: str) -> Callable[..., Any]:
            async def call(*values: object, **named: object) -> object:
                self.note(name, *values, **named)
                return answer

            return call

        return {name: noting(name) for name in names}


# -- one aircraft ---------------------------------------------------------------------------------


class Flown(AsyncExitStack):
    """A mission that reports what happens."""

    async def __aiter__(self) -> AsyncIterator[Any]:
        for one in (Reached(0), ActionsDone(0), Reached(1), Finished()):
            yield one


def aircraft_of(notes: Notes) -> Any:
    """An aircraft of firmware 3.1 in the air that notes what it is asked for."""

    def waypoint_mission(plan: Any, **how: object) -> Any:
        assert plan == short_plan()
        notes.note("waypoint_mission", **how)
        return Flown()

    async def telemetry(*_: object, **__: object) -> AsyncIterator[Any]:
        for none in list[Any]():
            yield none

    missions = ("stop_mission", "pause_mission", "resume_mission")
    control = SimpleNamespace(
        **notes.awaited(None, "take_off", "land", "go_home", "fly_to"),
        **notes.awaited(MissionKind.WAYPOINT, *missions),
        detach_mission=lambda: notes.note("detach_mission"),
        waypoint_mission=waypoint_mission,
    )

    @asynccontextmanager
    async def in_control(*, guards: Any = None) -> AsyncIterator[Any]:
        envelope = None if guards is None else guards.envelope
        limits = {"height": "max_height_m", "radius": "max_radius_m"} if envelope else {}
        notes.note("control", **{name: getattr(envelope, at) for name, at in limits.items()})
        yield control
        notes.note("released")

    async def activate(credentials: Any, **how: object) -> Any:
        notes.note("activate", credentials.app_id, level=credentials.level, **how)
        assert credentials.key.reveal().hex() == KEY
        if (progress := cast(Any, how.get("progress"))) is not None:
            progress(SimpleNamespace(attempt=3, next_attempt_in=None))
        return SimpleNamespace(name="the version")

    return SimpleNamespace(
        firmware=PROFILES["3.1"],
        link=SimpleNamespace(name="a line"),
        mission=SimpleNamespace(is_running=False, kind=MissionKind.NONE),
        state=SimpleNamespace(
            situation=dict,
            fresh=lambda _: True,
            gimbal=Gimbal(1.04, -2.06, 3.0, 5),
            believed_status=FlightStatus(FlightPhase.IN_AIR),
        ),
        activate=activate,
        control=in_control,
        end=control,
        telemetry=telemetry,
        gimbal=SimpleNamespace(**notes.awaited(None, "set_angles", "set_angular_rates")),
        camera=SimpleNamespace(**notes.awaited(None, "take_photo", "start_video", "stop_video")),
        wait_for=notes.awaited(None, "wait_for")["wait_for"],
        **notes.awaited(True, "release_authority"),
        **notes.awaited(short_plan(), "download_waypoint_plan"),
    )


@pytest.fixture
def notes() -> Notes:
    return Notes()


@pytest.fixture
def aircraft(cli: CommandLine, monkeypatch: pytest.MonkeyPatch, notes: Notes) -> Any:
    """Who is at the other end of every line."""
    there = aircraft_of(notes)

    @asynccontextmanager
    async def connect(url: str, **how: object) -> AsyncIterator[Any]:
        notes.note("connect", url, **how)
        yield there

    for name, value in (("URL", HERE), ("APP_ID", "7"), ("KEY", KEY)):
        monkeypatch.setenv(f"M100LINK_{name}", value)
    monkeypatch.setattr("m100link.aircraft.connect", connect)
    monkeypatch.setattr(flight, "describe_situation", lambda _: "as it is")
    monkeypatch.setattr(asyncio.events, "new_event_loop", VirtualClockEventLoop)
    monkeypatch.setattr(sys, "stdin", SimpleNamespace(isatty=lambda: False))
    for verb in ("pause_mission", "resume_mission"):  # called as functions of the class

        async def act(control: Any, verb: str = verb) -> MissionKind:
            kind: MissionKind = await getattr(control, verb)()
            return kind

        monkeypatch.setattr(Control, verb, act)
    return there


SHOWN = {"yaw_deg": 3.0, "pitch_deg": -2.1, "roll_deg": 1.0, "limits": 5}
SEEN = "wait_for(timeout=2.2, what='the gimbal item')"
MOVES = [
    ("takeoff --yes", ["control()", "take_off()", "released()"], "done: take off (as it is)"),
    ("land", ["control()", "land()", "released()"], "done: land (as it is)"),
    ("home -y", ["control()", "go_home()", "released()"], "done: go home (as it is)"),
    (
        "fly 5 -3.5 1.25 --yes --max-height 30 --max-radius 20",
        [
            "control(height=30.0, radius=20.0)",
            "fly_to(north=5.0, east=-3.5, up=1.25)",
            "released()",
        ],
        "done: fly 5 m north, -3.5 m east, 1.25 m up (as it is)",
    ),
    ("release", ["release_authority()"], "released"),
    (
        "gimbal --yaw 10 --pitch -30 --roll 5 --seconds 2",
        [
            "set_angles(yaw=10.0, pitch=-30.0, roll=5.0, seconds=2.0, relative=False, wait=True)",
            SEEN,
        ],
        SHOWN,
    ),
    (
        "gimbal --pitch -10 --relative --no-observe --table",
        ["set_angles(pitch=-10.0, seconds=1.0, relative=True, wait=False)", SEEN],
        "yaw 3.0°, pitch -2.1°, roll 1.0°",
    ),
    (
        "gimbal --yaw -20 --rates --seconds 3",
        ["set_angular_rates(yaw=-20.0, seconds=3.0)", SEEN],
        SHOWN,
    ),
    ("camera photo", ["take_photo()"], {"sent": "photo", "confirmed": None}),
    ("camera start-video", ["start_video()"], {"sent": "start-video", "confirmed": None}),
    ("camera stop-video --table", ["stop_video()"], "sent: stop-video"),
    ("mission stop", ["control()", "stop_mission()", "released()"], "stopped: waypoint mission"),
    (
        "mission pause",
        ["control()", "pause_mission()", "detach_mission()", "released()"],
        "paused: waypoint mission",
    ),
    (
        "mission resume --yes",
        ["control()", "resume_mission()", "detach_mission()", "released()"],
        "resumed: waypoint mission; it flies on by itself",
    ),
    ("mission download", ["download_waypoint_plan()"], json.loads(short_plan().to_json())),
    ("activate --wait 12", ["timeout"], {"activated": True, "app_id": 7, "attempts": 3}),
]


@pytest.mark.parametrize(("words", "calls", "says"), MOVES, ids=[row[0] for row in MOVES])
def test_what_moves(
    aircraft: Any, cli: CommandLine, notes: Notes, words: str, calls: list[str], says: Any
) -> None:
    """Metres north, east and up; degrees and seconds. Nobody is asked."""
    form = ("--table",) if isinstance(says, str) and "--table" not in words else ()
    outcome = cli(*shlex.split(words), *form)
    assert outcome.status == 0, outcome
    activated = ACTIVATE if calls != ["timeout"] else "activate(7, level=2, timeout=12.0)"
    assert notes == [CONNECT, activated, *(call for call in calls if call != "timeout")]
    if isinstance(says, str):
        assert says in outcome.out
    else:
        assert json.loads(outcome.out) | says == json.loads(outcome.out)


ASKED = [
    ("takeoff", "", "take off"),
    ("home", "", "go home"),
    ("home", "a mission flies", "end the waypoint mission and go home"),
    ("fly 1 0 -2", "", "fly 1 m north, 0 m east, -2 m up"),
    ("mission resume", "", "let the mission go on"),
    ("mission fly PLAN", "", "fly this mission"),
    ("mission fly PLAN --takeoff", "", "take off and fly this mission"),
]


@pytest.mark.parametrize(("words", "first", "question"), ASKED)
def test_what_is_asked_before_it_begins(
    aircraft: Any,
    cli: CommandLine,
    notes: Notes,
    plan_file: str,
    words: str,
    first: str,
    question: str,
) -> None:
    """Without a terminal nobody says yes, and nothing is sent."""
    if first:
        aircraft.mission = SimpleNamespace(is_running=True, kind=MissionKind.WAYPOINT)
    outcome = cli(*shlex.split(words.replace("PLAN", plan_file)))
    assert (outcome.status, notes) == (ExitCode.USAGE, [CONNECT])
    assert f"{question} was not confirmed" in outcome.err
    assert "--yes" in outcome.err


BESIDE_A_MISSION = [
    ("takeoff --yes", ExitCode.AUTHORITY, []),
    ("fly 1 0 0 --yes", ExitCode.AUTHORITY, []),
    ("mission fly PLAN --yes", ExitCode.AUTHORITY, []),
    ("land", ExitCode.OK, ["control()", "stop_mission()", "land()", "released()"]),
    ("home --yes", ExitCode.OK, ["control()", "stop_mission()", "go_home()", "released()"]),
    ("release", ExitCode.OK, ["release_authority()"]),
]


@pytest.mark.parametrize(("words", "status", "calls"), BESIDE_A_MISSION)
def test_what_happens_beside_a_mission(
    aircraft: Any,
    cli: CommandLine,
    notes: Notes,
    plan_file: str,
    words: str,
    status: int,
    calls: list[str],
) -> None:
    aircraft.mission = SimpleNamespace(is_running=True, kind=MissionKind.WAYPOINT)
    outcome = cli(*shlex.split(words.replace("PLAN", plan_file)))
    assert (outcome.status, notes) == (status, [CONNECT, ACTIVATE, *calls]), outcome
    assert ("nothing was sent, and it flies on" in outcome.err) is (status != 0)
    assert ("stopped: waypoint mission" in outcome.err) is ("stop_mission()" in calls)


@pytest.mark.parametrize("verb", ["land", "home --yes"])
def test_a_mission_that_does_not_stop_delays_no_landing(
    aircraft: Any, cli: CommandLine, notes: Notes, monkeypatch: pytest.MonkeyPatch, verb: str
) -> None:
    aircraft.mission = SimpleNamespace(is_running=True, kind=MissionKind.WAYPOINT)

    async def refused(_: Any) -> None:
        raise MissionRefused("no such mission")

    monkeypatch.setattr(aircraft.end, "stop_mission", lambda: refused(None))
    outcome = cli(*verb.split())
    assert outcome.status == 0
    assert notes[-2:] == ["land()" if verb == "land" else "go_home()", "released()"]
    assert "no such mission" in outcome.err
    assert "landing all the same" in outcome.err


@pytest.fixture
def plan_file(tmp_path: Path) -> str:
    path = tmp_path / "plan.json"
    path.write_text(short_plan().to_json())
    return str(path)


@pytest.mark.parametrize("options", ["", "--takeoff", "--allow-far"])
def test_a_mission_is_flown_as_its_options_say(
    aircraft: Any, cli: CommandLine, notes: Notes, plan_file: str, options: str
) -> None:
    outcome = cli("mission", "fly", plan_file, "--yes", "--max-height", "40", *options.split())
    assert outcome.status == 0, outcome
    how = f"take_off={options == '--takeoff'}, allow_far={options == '--allow-far'}"
    assert notes == [
        CONNECT,
        ACTIVATE,
        "control(height=40.0, radius=150.0)",
        f"waypoint_mission({how})",
        "released()",
    ]
    told = [(one["event"], one.get("index")) for one in outcome.objects]
    assert told == [("reached", 0), ("actions_done", 0), ("reached", 1), ("finished", None)]
    assert "4 waypoints, about " in outcome.err
    assert "at the end hover, without RC " in outcome.err.replace("\n", " ")


def test_on_the_ground_a_mission_wants_to_take_off(
    aircraft: Any, cli: CommandLine, notes: Notes, plan_file: str
) -> None:
    aircraft.state.believed_status = FlightStatus(FlightPhase.STANDBY)
    outcome = cli("mission", "fly", plan_file)
    assert (outcome.status, notes) == (ExitCode.USAGE, [CONNECT])
    assert "the aircraft stands on the ground" in outcome.err


@pytest.mark.parametrize(
    ("words", "settings"),
    [
        ("--firmware 2.3 --baud 115200", "firmware='2.3', baud_rate=115200"),
        ("--timeout 2.5 --acceleration raw", "timeout=2.5, acceleration='raw'"),
    ],
)
def test_how_it_is_connected(
    aircraft: Any, cli: CommandLine, notes: Notes, words: str, settings: str
) -> None:
    assert cli("release", *words.split()).status == 0
    assert notes[0] == f"connect({HERE!r}, {settings})"


@pytest.mark.parametrize("words", ["hz", "monitor", "record", "record full"])
def test_what_watches_a_line_that_is_lost_ends_with_its_error(
    aircraft: Any,
    cli: CommandLine,
    notes: Notes,
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    words: str,
) -> None:
    """A script that records goes on by the exit status. Why nothing was written comes first."""
    lost, full = LinkError("it went away"), OSError("no space") if "full" in words else None
    aircraft.link = SimpleNamespace(is_open=False, failure=lost)
    aircraft.wait_closed = notes.awaited(lost, "wait_closed")["wait_closed"]
    recorder = SimpleNamespace(path=tmp_path / "x", failure=full, **notes.awaited(None, "aclose"))
    monkeypatch.setattr(log, "Recorder", lambda *_, **__: recorder)
    outcome = cli(*words.removesuffix(" full").split())
    assert outcome.status == (ExitCode.USAGE if full else ExitCode.PORT), outcome
    assert ("recording ended early: no space" if full else "it went away") in outcome.err


# -- a fleet --------------------------------------------------------------------------------------


def noted_asker(notes: Notes, name: str) -> Any:
    """Of somebody with every right."""
    how = notes.awaited(None, "ask") | notes.awaited(True, "is_there")
    return SimpleNamespace(require=lambda *_, **__: None, keys=SimpleNamespace(name=name), **how)


def noted_aircraft(notes: Notes, name: str) -> Any:
    @asynccontextmanager
    async def control(*, take_over: bool = False) -> AsyncIterator[Any]:
        notes.note(f"{name}.control", take_over=take_over)
        steps = notes.awaited(None, "fly_to")

        def waypoint_mission(plan: Any, **how: object) -> Any:
            assert plan == short_plan()
            notes.note(f"{name}.waypoint_mission", **how)
            return Flown()

        steps["waypoint_mission"] = waypoint_mission
        yield SimpleNamespace(fence=7, proof=(7, "secret"), **steps)
        notes.note(f"{name}.released")

    def fetch_log(log: str, to: Path, progress: Any) -> Any:
        progress(5, 9)
        path = Path(f"{name}-{log or 'newest'}")
        return notes.awaited(Fetched(name, log, path, 9, 4, True), f"{name}.fetch_log")[
            f"{name}.fetch_log"
        ](log, to)

    card = MissionCard(name, "run", MissionStage.FLYING, points=4, reached=b"\0\1\0")
    return SimpleNamespace(
        name=name,
        control=control,
        fetch_log=fetch_log,
        asker=noted_asker(notes, name),
        audit=f"the log of {name}",
        bus="bus",
        keys=f"keys of {name}",
        stop=notes.awaited(None, f"{name}.stop")[f"{name}.stop"],
        mission=notes.awaited(replace(card, index=2, elapsed_s=61.4, distance_m=12.6), "mission")[
            "mission"
        ],
    )


def fleet_of(notes: Notes) -> Any:
    """A fleet of two that notes what each is asked for."""

    async def each(do: Any, names: Any) -> dict[str, Any]:
        found = {}
        for name in names:
            order = inspect.getclosurevars(do).nonlocals.get("do", do)
            if order.__qualname__.startswith("FleetAircraft."):
                notes.note(f"{name}.{order.__name__}")
                value: Any = [LogEntry("one.mcap", 1_500_000, 1_700_000_000.0, name == "a2")]
            else:
                value = await do(noted_aircraft(notes, name))
            found[name] = Result.of(name, None, value)
        return found

    class There(SimpleNamespace):
        def __getitem__(self, name: str) -> Any:
            return noted_aircraft(notes, name)

    async def present() -> list[str]:
        return ["a1", "a2"]

    async def cards() -> dict[str, Card]:
        return {name: Card(name, "run", 0.0, "connected", height_m=9.96) for name in ("a2", "a10")}

    keys = SimpleNamespace(site="site")
    more: Any = {"present": {"a1"}, "asker": partial(noted_asker, notes)}
    return There(each=each, names=present, cards=cards, bus="bus", keys=keys, **more)


@pytest.fixture
def fleet(cli: CommandLine, monkeypatch: pytest.MonkeyPatch, notes: Notes) -> None:
    @asynccontextmanager
    async def connect(*places: str, **how: Any) -> AsyncIterator[Any]:
        notes.note("connect", *places, **{k: how[k] for k in ("site", "name", "patience")})
        yield fleet_of(notes)

    class Heard(SimpleNamespace):
        """The telemetry of a fleet, of which two packages come at once."""

        def __init__(
            self, bus: object, keys: Any, *, full: bool = False, on_sample: Any = None
        ) -> None:
            notes.note("hear", bus, getattr(keys, "name", "all"), full=full)
            super().__init__(states={"a3": None}, received={"a1": 2, "a3": 0})
            for _ in range(2 if on_sample else 0):
                on_sample("a1", SimpleNamespace(received_at=1.5, get={Battery: Battery(87)}.get))

        def close(self) -> None:
            notes.note("closed")

    monkeypatch.setattr("m100link.apps.cli.fleet.connect", connect)
    monkeypatch.setattr(fleet_verbs, "FleetTelemetry", Heard)
    monkeypatch.setattr(fleet_verbs, "ended_by_signal", Over)
    monkeypatch.setattr(fleet_setup, "ended_by_signal", Over)
    monkeypatch.setattr(fleet_plans, "borrowed", lambda *where: (len(where[0]), f"of {where[1]}"))
    monkeypatch.setattr(time, "time", lambda: 0.0)
    monkeypatch.setattr("getpass.getuser", lambda: "anna")
    monkeypatch.setattr("platform.node", lambda: "gcs")


def _order(at: float, order: str, outcome: str, **more: str) -> dict[str, Any]:
    return {"at": at, "order": order, "outcome": outcome, "by": "x", "signer": "anna"} | more


def settings_default(name: str) -> Any:
    return Settings.__dataclass_fields__[name].default


FLEET = "connect('tcp/127.0.0.1:7447', site='site', name='anna@gcs', patience=10.0)"
ORDERS = [
    ("takeoff a1", ["a1.take_off()"], "ok"),
    ("land --all", ["a1.land()", "a2.land()"], "ok"),
    ("stop a2 a1", ["a2.stop()", "a1.stop()"], "ok"),
    (
        "goto a1 -33.9 18.4 10 --cruise-speed 3",
        [
            "a1.control(take_over=False)",
            "fly_to(latitude_deg=-33.9, longitude_deg=18.4, height=10.0, speed=3.0)",
            "a1.released()",
        ],
        "ok",
    ),
    ("log list a1", ["a1.logs()"], "1.5 MB  2023-11-14 22:13:20\n"),
    ("log list a2", ["a2.logs()"], "2023-11-14 22:13:20, and still\n"),
    (
        "log fetch a1 --file x.mcap --output logs",
        ["a1.fetch_log('x.mcap', PosixPath('logs'))"],
        "a1: a1-x.mcap: 9 bytes, of which 5 were here already; the log is still being written",
    ),
    ("log fetch a1", ["a1.fetch_log('', PosixPath('.'))"], "a1: a1-newest: 9 bytes"),
    ("mission stop a1", ["a1.stop()"], "a1           ok"),
    (
        "mission progress a1",
        ["mission()"],
        "a1: flying, 2 of 4 waypoints, 61 s, 13 m to waypoint 2",
    ),
    (
        "mission pause a1",
        ["ask(AskVersion())", "ask(PauseMission(), fence=4, token='of a1')"],
        "a1           ok",
    ),
    (
        "mission resume a2 --site north",
        ["ask(AskVersion())", "ask(ResumeMission(), fence=5, token='of a2')"],
        "a2           ok",
    ),
    (
        "mission fly a1 PLAN --yes",
        ["a1.control(take_over=False)", "a1.waypoint_mission(take_off=False)", "a1.released()"],
        "a1: 2 of 4  finished",
    ),
    (
        "mission fly a1 PLAN --yes --takeoff --take-over",
        ["a1.control(take_over=True)", "a1.waypoint_mission(take_off=True)", "a1.released()"],
        "a1: 1 of 4  reached 0",
    ),
    (
        "lease a1 --take-over",
        ["a1.control(take_over=True)", "a1.released()"],
        "a1: lease 7, until Ctrl-C",
    ),
    ("list", [], "a10   connected         10.0 m"),
    ("list --json", [], '{"name": "a1"}\n'),
    (
        "watch a1 --json",
        ["is_there()", "hear('bus', 'a1', full=True)", "closed()"],
        '"battery": {"percent"',
    ),
    ("monitor --json", ["hear('bus', 'all', full=False)"], ""),
]


@pytest.mark.parametrize(("words", "calls", "says"), ORDERS, ids=[row[0] for row in ORDERS])
@pytest.mark.usefixtures("fleet")
def test_what_a_fleet_is_asked(
    cli: CommandLine, notes: Notes, plan_file: str, words: str, calls: list[str], says: str
) -> None:
    form = () if "--json" in words else ("--table",)
    outcome = cli("fleet", *words.replace("PLAN", plan_file).split(), *form)
    site = "north" if "north" in words else "site"
    assert (outcome.status, notes) == (0, [FLEET.replace("='site'", f"='{site}'"), *calls]), outcome
    assert says in outcome.out


@pytest.mark.usefixtures("fleet")
def test_whose_fleet_it_is(cli: CommandLine, notes: Notes) -> None:
    words = "--connect tcp/a:1 --connect tcp/b:2 --site north --operator bert --patience 2"
    assert cli("fleet", "land", "a1", *words.split()).status == 0
    assert notes[0] == "connect('tcp/a:1', 'tcp/b:2', site='north', name='bert', patience=2.0)"


@pytest.mark.usefixtures("fleet")
@pytest.mark.parametrize(
    ("words", "says"),
    [
        ("land", "no aircraft was named"),
        ("land a1 --all", "aircraft were named, and --all given"),
        ("goto a1 52 4 0", "must be a number above 0"),
        ("goto a1 52 4 10 --cruise-speed -1", "must be a number above 0"),
    ],
)
def test_what_no_fleet_is_asked(cli: CommandLine, notes: Notes, words: str, says: str) -> None:
    outcome = cli("fleet", *words.split())
    assert (outcome.status, notes) == (ExitCode.USAGE, [])
    assert says in outcome.err


@pytest.mark.usefixtures("fleet")
@pytest.mark.parametrize(
    ("name", "number", "status", "says"),
    [
        ("a1", EPIPE, ExitCode.OK, ""),
        ("a1", ENOSPC, ExitCode.FAILED, "standard output takes no more: it is so"),
        ("a3", None, ExitCode.FAILED, "no package of a3 came that can be read"),
    ],
)
def test_a_fleet_is_watched_until_nobody_reads_it(
    cli: CommandLine,
    monkeypatch: pytest.MonkeyPatch,
    name: str,
    number: int | None,
    status: int,
    says: str,
) -> None:
    printed: list[dict[str, Any]] = []

    def print_json(package: dict[str, Any]) -> None:
        printed.append(package)
        if number is not None:
            raise ReaderGone(number, "it is so")

    monkeypatch.setattr(fleet_verbs, "print_json", print_json)
    outcome = cli("fleet", "watch", name)
    assert (outcome.status, len(printed)) == (status, 2 if number is None else 1)
    assert says in outcome.err


AUDITED: list[tuple[dict[str, tuple[list[dict[str, Any]], list[str]]], int, list[str], list[str]]]
AUDITED = [
    (
        {
            "a1": ([_order(60.0, "land", "ok"), {"at": 10.0, "start": 1}], []),
            "a2": ([_order(0.0, "take_off", "refused", why="no GPS")], []),
        },
        ExitCode.OK,
        [
            # The time of the order, which these lack, and that of its outcome.
            f"{'':21}a2       anna         take_off         1970-01-01 00:00:00 refused  no GPS",
            f"{'':21}a1       anna         land             1970-01-01 00:01:00 ok",
        ],
        [],
    ),
    ({"a1": ([], ["line 3 is altered"])}, ExitCode.FAILED, [], ["a1: line 3 is altered"]),
]


@pytest.mark.parametrize(("merged", "status", "told", "wrong"), AUDITED)
@pytest.mark.usefixtures("fleet")
def test_orders_of_all_are_told_by_their_time_and_what_is_wrong_fails(
    cli: CommandLine,
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    merged: Any,
    status: int,
    told: list[str],
    wrong: list[str],
) -> None:
    async def merge(path: Path, name: str, fetch: object, authority: object) -> Any:
        assert (path, fetch) == (tmp_path / f"{name}.audit", f"the log of {name}")
        assert authority == f"authority of {tmp_path / 'pki'}"
        return merged[name]

    def of_folder(folder: Path) -> Any:
        return SimpleNamespace(authority=f"authority of {folder}")

    monkeypatch.setattr(fleet_verbs, "merge_audit", merge)
    monkeypatch.setattr(fleet_verbs, "Revocations", SimpleNamespace(of_folder=of_folder))
    words = ["--output", str(tmp_path), "--pki", str(tmp_path / "pki"), "--table"]
    outcome = cli("fleet", "log", "audit", *merged, *words)
    assert (outcome.status, outcome.out.splitlines()) == (status, told), outcome
    assert outcome.err.splitlines() == wrong


FLOWN = Part("a1", ShowStage.FLOWN, farthest_m=0.456)
SHOWN_PARTS: list[tuple[list[Part], int, list[str]]] = [
    ([FLOWN], ExitCode.OK, ["a1: flown, at most 0.46 m from its track"]),
    (
        [FLOWN, replace(FLOWN, name="a2", why="it did not land")],
        ExitCode.FAILED,
        ["a1: flown, at most 0.46 m from its track", "a2: flown, it did not land"],
    ),
    ([Part("a1", ShowStage.LEFT, why="wind")], ExitCode.FAILED, ["a1: left, wind"]),
    ([Part("a1", None, why="it is gone")], ExitCode.FAILED, ["a1: silent, it is gone"]),
]


@pytest.mark.parametrize(("parts", "status", "told"), SHOWN_PARTS)
@pytest.mark.usefixtures("fleet")
def test_a_show_is_success_if_all_flew_to_its_end(
    cli: CommandLine,
    monkeypatch: pytest.MonkeyPatch,
    parts: list[Part],
    status: int,
    told: list[str],
) -> None:
    leave = "land" if len(parts) > 1 else "hover"

    class Conducting:
        def __init__(self, bus: object, site: str, who: str, show: Any, **how: Any) -> None:
            assert (bus, site, who, how["leave"], how["sign"]) == (
                *("bus", "site", "anna@gcs", leave, None),
            )
            assert [track.name for track in show.tracks] == ["a1", "a2", "a3", "a4", "a5"]

        async def fly(self) -> dict[str, Part]:
            return {one.name: one for one in parts}

    monkeypatch.setattr(fleet_plans, "Conductor", Conducting)
    words = ["--yes", "--table", *(["--leave", "hover"] if leave == "hover" else [])]
    outcome = cli("fleet", "show", "fly", str(FIVE), *words)
    assert (outcome.status, outcome.out.splitlines()) == (status, told), outcome


FAULT = FleetFault("cut leg", "a2", "no agent named a2 is there", "look at the network")


@pytest.mark.parametrize("form", ["--json", "--table"])
@pytest.mark.parametrize("found", [[], [FAULT]])
def test_a_fleet_without_a_fault_is_success(
    cli: CommandLine,
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    found: list[FleetFault],
    form: str,
) -> None:
    async def examine(rights: Any, tell: Callable[[str], None]) -> list[FleetFault]:
        assert rights.aircraft == ("a1",)
        tell("anna by base: a1")
        return found

    monkeypatch.setattr(fleet_setup, "examine", examine)
    (path := tmp_path / "fleet.toml").write_text("[aircraft.a1]\n")
    outcome = cli("fleet", "doctor", str(path), form)
    assert outcome.status == (ExitCode.FAILED if found else ExitCode.OK)
    words = ["✓ anna by base: a1", *(f"✗ cut leg: {FAULT.seen}\n  {FAULT.remedy}" for _ in found)]
    facts = asdict(FAULT) if found else {"ok": True}
    told = [facts] if form == "--json" else "\n".join(words) + "\n"
    assert (outcome.objects if form == "--json" else outcome.out) == told


UP: list[tuple[str, list[str], dict[str, Any], str]] = [
    ("", ["base", "a1", "a2", "console"], {}, "virtual aircraft: a1, a2"),
    ("a1 console", ["a1", "console"], {}, "virtual aircraft: a1"),
    ("--real", ["base", "a1", "a2", "console"], {"a1": "tcp://a:1", "a2": "tcp://b:2"}, "real"),
    ("base", ["base"], {}, "base: tls/h:1"),
    ("a2 --real", ["a2"], {"a2": "tcp://b:2"}, "real aircraft: a2"),
]


@pytest.mark.parametrize(("words", "names", "urls", "says"), UP, ids=[row[0] for row in UP])
def test_the_parts_of_a_fleet_file_come_up(
    cli: CommandLine,
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    words: str,
    names: list[str],
    urls: dict[str, str],
    says: str,
) -> None:
    """Each in its process; one alone in this one. A virtual one has the firmware of the file."""
    (path := tmp_path / "fleet.toml").write_text(
        '[router.base]\nhosts = ["h"]\n[identity.bert]\n[console]\nidentity = "bert"\n'
        '[aircraft.a1]\nurl = "tcp://a:1"\n[aircraft.a2]\nurl = "tcp://b:2"\nfirmware = "3.1"\n'
        "max_height = 30\n"
    )
    began: list[tuple[dict[str, Any], bool]] = []

    def facts(name: str) -> dict[str, Any]:
        shown = {"base": {"base": "tls/h:1"}, "console": {"console": "http"}}
        return shown.get(name, {"agent": ""})

    @asynccontextmanager
    async def several(_: Path, parts: Any, __: object, *, is_real: bool) -> AsyncIterator[Any]:
        began.append((dict(parts), is_real))
        yield {name: facts(name) for name in parts}

    @asynccontextmanager
    async def alone(
        _: Path, name: str, settings: Any, __: object, *, is_real: bool
    ) -> AsyncIterator[Any]:
        began.append(({name: settings}, is_real))
        yield facts(name)

    monkeypatch.setattr(fleet_setup, "running_parts", several)
    monkeypatch.setattr(fleet_setup, "running_part", alone)
    monkeypatch.setattr(fleet_setup, "ended_by_signal", Over)
    monkeypatch.setattr(fleet_setup, "leave_what_stays", lambda: None)
    outcome = cli("fleet", "up", str(path), *words.split(), "--table")
    assert outcome.status == 0, outcome
    [(parts, is_real)] = began
    assert (list(parts), is_real) == (names, "--real" in words)
    aircraft = {name: one for name, one in parts.items() if name in ("a1", "a2")}
    assert all(parts[name] is None for name in parts.keys() - aircraft.keys())
    for name, settings in aircraft.items():
        virtual = {"a1": (None, True), "a2": ("sim://?firmware=3.1", False)}[name]
        assert (settings.url, settings.sim) == ((urls[name], False) if urls else virtual)
        assert settings.firmware == ("3.1" if name == "a2" and urls else None)
        assert settings.record == default_folder() / name
        assert settings.max_height == (30.0 if name == "a2" else settings_default("max_height"))
    assert says in outcome.out
    assert "agent" not in outcome.out


@pytest.mark.parametrize("is_secure", [False, True])
@pytest.mark.usefixtures("fleet")
def test_the_console_of_a_fleet_is_opened_where_it_is_served(
    cli: CommandLine, monkeypatch: pytest.MonkeyPatch, notes: Notes, tmp_path: Path, is_secure: bool
) -> None:
    @asynccontextmanager
    async def serving(_: object, settings: Settings, names: Any) -> AsyncIterator[Any]:
        notes.note("serve", names, port=settings.console_port)
        yield SimpleNamespace(
            sockets=SimpleNamespace(port={"console": 8123}.__getitem__),
            console_path=lambda: "/?code=1",
            agents={"a1": None},
        )

    monkeypatch.setattr(fleet_setup, "serving_fleet_console", serving)
    monkeypatch.setattr(fleet_setup, "require_packages", lambda: None)
    monkeypatch.setattr(fleet_setup, "webbrowser", SimpleNamespace(open=notes.append))
    words = ["a1", "--console-port", "8100"]
    if is_secure:
        for name in ("cert", "key"):
            (tmp_path / name).write_text("x")
            words += [f"--tls-{name}", str(tmp_path / name)]
    else:
        words.append("--no-open-browser")
    outcome = cli("fleet", "console", *words, "--table")
    url = f"{'https' if is_secure else 'http'}://127.0.0.1:8123/?code=1"
    assert outcome.status == 0, outcome
    assert outcome.out.splitlines()[:2] == [f"console:   {url}", "aircraft:  a1"]
    assert notes[1:] == ["serve(('a1',), port=8100)", *([url] if is_secure else [])]
    assert "an aircraft that was flown from here hovers" in outcome.err


@pytest.mark.usefixtures("fleet")
def test_agents_run_until_the_end(
    cli: CommandLine, monkeypatch: pytest.MonkeyPatch, notes: Notes
) -> None:
    @asynccontextmanager
    async def serving(aircraft: Any, fleet: Any, _: object) -> AsyncIterator[Any]:
        notes.note("serve", list(aircraft), site=fleet.site)
        yield {"b1": None, "b2": None}
        notes.note("over")

    monkeypatch.setattr(fleet_setup, "serving_fleet", serving)
    monkeypatch.setattr(fleet_setup, "leave_what_stays", lambda: notes.note("stays"))
    outcome = cli("fleet", "agent", "sim://", "--name", "b", "--count", "2", "--table")
    assert (outcome.status, outcome.out) == (0, "fleet:     site: b1, b2\n")
    assert notes == ["serve(['b1', 'b2'], site='site')", "stays()", "over()"]
    assert "ending: an aircraft that flies hovers" in outcome.err
    refused = cli("fleet", "agent", "tcp://a:1", "--count", "2")
    assert (refused.status, "--count is for virtual" in refused.err) == (ExitCode.USAGE, True)


@pytest.mark.usefixtures("fleet")
def test_a_list_of_revoked_names_is_brought_to_each(
    cli: CommandLine, monkeypatch: pytest.MonkeyPatch, notes: Notes, tmp_path: Path
) -> None:
    (tmp_path / "revoked.list").write_bytes(b"the list")
    in_force = notes.awaited(SimpleNamespace(number=5), "in_force")["in_force"]
    monkeypatch.setattr(fleet_setup, "in_force", in_force)
    outcome = cli("fleet", "pki", "push", "--all", "--folder", str(tmp_path), "--table")
    assert outcome.status == 0, outcome
    assert notes[1:] == [f"in_force('bus', 'keys of {name}', b'the list')" for name in ("a1", "a2")]


# -- what serves ----------------------------------------------------------------------------------


STATIONS: list[tuple[str, dict[str, dict[str, Any]], dict[str, Any]]] = [
    ("serve --sim", {"m100": {"sim": True, "url": None}}, {"with_console": False}),
    ("serve sim://", {"m100": {"sim": True, "url": None}}, {"with_console": False}),
    (
        "serve left=tcp://a:1 tcp://b:2 --port 9191 --also-port 9292 --max-clients 3",
        {
            name: {"url": url, "port": 9191, "also_ports": (9292,), "max_clients": 3}
            for name, url in (("left", "tcp://a:1"), ("m100_2", "tcp://b:2"))
        },
        {"with_console": False},
    ),
    (
        "serve tcp://a:1 --max-height 30 --max-radius 60 --level 1",
        {"m100": {"max_height": 30, "max_radius": 60, "level": 1}},
        {"with_console": False},
    ),
    (
        "console tcp://a:1 --no-open-browser --console-port 8100",
        {"m100": {"console_port": 8100, "url": "tcp://a:1"}},
        {"with_console": True, "open_browser": False},
    ),
    ("console --sim", {"m100": {"sim": True}}, {"with_console": True, "open_browser": True}),
    (
        "mavlink tcp://a:1",
        {"m100": {"mavlink": (), "mavlink_to": serve.USUAL}},
        {"with_rosbridge": False},
    ),
    (
        "mavlink tcp://a:1 --to udp://127.0.0.1:5 --sysid 7 --autopilot generic",
        {"m100": {"mavlink_to": ("udp://127.0.0.1:5",), "sysid": 7, "autopilot": "generic"}},
        {"with_rosbridge": False},
    ),
    (
        "mavlink tcp://a:1 --listen udp://127.0.0.1:6",
        {"m100": {"mavlink": ("udp://127.0.0.1:6",), "mavlink_to": ()}},
        {"with_rosbridge": False},
    ),
    (
        "ros2 tcp://a:1 --namespace /x --node y --domain 3 --dji-names --remap a:=b",
        {
            "m100": {
                "ros2": True,
                "ros2_namespace": "/x",
                "ros2_node": "y",
                "ros2_domain": 3,
                "ros2_dji_names": True,
                "ros2_remap": ("a:=b",),
            }
        },
        {"with_rosbridge": False},
    ),
    (
        "replay /x/a.mcap --from 60 --until 90.5 --speed 4",
        {"m100": {"url": "replay:///x/a.mcap?speed=4.0&from=60.0&until=90.5", "record": None}},
        {"with_console": True, "with_rosbridge": False, "open_browser": True},
    ),
    (
        "replay /x/a.mcap /x/2.mcap --speed max --no-open-browser",
        {
            "a": {"url": "replay:///x/a.mcap?speed=max&from=0.0"},
            "flight_2": {"url": "replay:///x/2.mcap?speed=max&from=0.0"},
        },
        {"with_console": True, "with_rosbridge": False, "open_browser": False},
    ),
]


@pytest.mark.parametrize(("words", "settings", "how"), STATIONS, ids=[row[0] for row in STATIONS])
def test_what_is_served(
    cli: CommandLine,
    monkeypatch: pytest.MonkeyPatch,
    words: str,
    settings: dict[str, dict[str, Any]],
    how: dict[str, Any],
) -> None:
    """Seconds, metres and ports arrive as they were written."""
    run: list[tuple[Any, Any]] = []

    async def run_station(aircraft: dict[str, Any], _: object, **served: object) -> int:
        run.append((aircraft, served))
        return 0

    monkeypatch.setattr(serve, "run_station", run_station)
    outcome = cli(*words.split())
    assert outcome.status == 0, outcome
    [(aircraft, served)] = run
    asked = {
        name: {key: getattr(one, key) for key in settings[name]} for name, one in aircraft.items()
    }
    assert (asked, served) == (settings, how)


AGENTS: list[tuple[str, list[str], dict[str, Any]]] = [
    (
        "tcp://a:1",
        ["a1"],
        {"lost": LostLinkPlan("hover", 10.0), "order_logs": True, "log_rate": 1e6},
    ),
    ("sim:// --name b --count 2", ["b1", "b2"], {"order_logs": None}),
    ("left=tcp://a:1 right=tcp://b:2", ["left", "right"], {"connect": ("tcp/127.0.0.1:7447",)}),
    (
        "tcp://a:1 --lost land --lost-after 2.5 --connect tcp/c:3 --site north",
        ["a1"],
        {"lost": LostLinkPlan("land", 2.5), "connect": ("tcp/c:3",), "site": "north"},
    ),
    (
        "tcp://a:1 --log-rate 0.25 --order-log /x --lost home",
        ["a1"],
        {"log_rate": 250_000.0, "order_logs": Path("/x"), "lost": LostLinkPlan("home", 10.0)},
    ),
]


@pytest.mark.parametrize(("words", "names", "fleet"), AGENTS, ids=[row[0] for row in AGENTS])
def test_what_is_on_board(
    cli: CommandLine,
    monkeypatch: pytest.MonkeyPatch,
    words: str,
    names: list[str],
    fleet: dict[str, Any],
) -> None:
    """Seconds, and megabytes a second that become bytes."""
    run: list[tuple[Any, Any]] = []

    async def serving(aircraft: Any, found: Any, _: object) -> int:
        run.append((aircraft, found))
        return 0

    monkeypatch.setattr(fleet_setup, "_serve", serving)
    outcome = cli("fleet", "agent", *words.split())
    assert outcome.status == 0, outcome
    [(aircraft, found)] = run
    assert list(aircraft) == names
    assert all(one.record == default_folder() / name for name, one in aircraft.items())
    kept = default_order_logs() if fleet.get("order_logs") is True else None
    expected = fleet | ({"order_logs": kept} if kept else {})
    assert {key: getattr(found, key) for key in expected} == expected


USUAL = "('tcp/127.0.0.1:7447',)"
ROUTERS = [
    ("", USUAL, "()"),
    (
        "--listen tcp/x:1 --connect tcp/b:2 --connect tcp/c:3",
        "('tcp/x:1',)",
        "('tcp/b:2', 'tcp/c:3')",
    ),
]


@pytest.mark.parametrize(("words", "listen", "connect"), ROUTERS)
def test_where_a_router_listens(
    cli: CommandLine,
    monkeypatch: pytest.MonkeyPatch,
    notes: Notes,
    words: str,
    listen: str,
    connect: str,
) -> None:
    @asynccontextmanager
    async def open_fleet(*what: object, **how: object) -> AsyncIterator[None]:
        notes.note("open_fleet", *what, **how)
        yield

    monkeypatch.setattr(fleet_setup, "open_fleet", open_fleet)
    monkeypatch.setattr(fleet_setup, "ended_by_signal", Over)
    outcome = cli("fleet", "router", *words.split())
    assert (outcome.status, notes) == (
        0,
        [f"open_fleet('router', {listen=!s}, {connect=!s})"],
    )


class Over(asyncio.Event):
    """An end that is there."""

    def __init__(self) -> None:
        super().__init__()
        self.set()


# -- the virtual aircraft -------------------------------------------------------------------------


VIRTUAL: list[tuple[str, dict[str, Any]]] = [
    (
        "--seed 5",
        {"seed": 5, "firmware": "1.0", "app_id": DEMO_APP_ID, "key": DEMO_KEY, "level": 2}
        | {"cold": False, "paced": True, "activated": False},
    ),
    (
        "--seed 5 --firmware 3.1 --app-id 9 --level 0 --cold --no-pace --activated",
        {"firmware": "3.1", "app_id": 9, "level": 0, "cold": True}
        | {"paced": False, "activated": True, "api": False},
    ),
    ("--seed 5 --wind-north 3 --wind-east -2", {"wind_north": 3.0, "wind_east": -2.0}),
    ("--seed 5 --loss 0.25 --damage 0.5", {"loss": 0.25, "damage": 0.5}),
    ("--seed 5 --baud 115200 --item-rate rc=10 --item-rate battery=0", {"baud_rate": 115200}),
    ("--seed 5 --tcp 7000 --duration 3", {"tcp": ("127.0.0.1", 7000), "duration": 3.0}),
    ("--seed 5 --tcp 0.0.0.0:0 --link /x", {"tcp": ("0.0.0.0", 0), "link": Path("/x")}),
]


@pytest.mark.parametrize(("words", "expected"), VIRTUAL, ids=[row[0] for row in VIRTUAL])
def test_what_is_simulated(
    cli: CommandLine, monkeypatch: pytest.MonkeyPatch, words: str, expected: dict[str, Any]
) -> None:
    """Wind in m/s, losses as shares, rates in Hz, baud."""
    made: list[dict[str, Any]] = []
    plans: list[Any] = []

    def virtual(**options: Any) -> Any:
        made.append(options)
        return options

    async def serve_plan(plan: Any) -> int:
        plans.append(plan)
        return 0

    monkeypatch.setattr(sim, "VirtualAircraft", virtual)
    monkeypatch.setattr(sim, "_serve", serve_plan)
    outcome = cli("sim", *words.split())
    assert outcome.status == 0, outcome
    [options], [plan] = made, plans
    assistant = options["assistant"]
    found = options | {"api": assistant.api_control_enabled}
    for one in (options["faults"], plan, options["settings"], assistant):
        found |= {name: getattr(one, name) for name in expected if hasattr(one, name)}
    assert {name: found.get(name) for name in expected} == expected
    rates = [assistant.rates_hz[name] for name in ("rc", "battery")]
    assert (rates, plan.seed) == ([10, 0] if "--item-rate" in words else [50, 1], 5)
