"""The mission of a tab: a plan from a file, four buttons, and how far it is."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import AsyncExitStack
from dataclasses import replace
from functools import partial
from itertools import combinations, product
from typing import Any

import anyio
import pytest

from m100link.apps.agent import orders
from m100link.apps.agent.client import Hearing
from m100link.apps.agent.messages import LeaseChanged, Replay, State
from m100link.apps.station.console.view.header import (
    RULES,
    Cause,
    fleet_of,
    progress,
    replay_of,
    status_line,
)
from m100link.apps.station.console.view.situation import (
    AlarmLevel,
    Inputs,
    RecordedFlight,
    Ship,
    Situation,
)
from m100link.apps.station.console.view.texts import (
    Language,
    Translator,
    translations,
)
from m100link.apps.station.console.view.view_model import view_of
from m100link.geodesy import LocalFrame
from m100link.log.story import FlightSummary, Span
from m100link.missions.plan import WaypointPlan
from m100link.missions.waypoint import Waypoint
from m100link.protocol.records import Device, RcMode
from m100link.sim.virtual import VirtualAircraft
from m100link.telemetry.state import AircraftState
from tests.apps.station.conftest import Rig
from tests.apps.station.console.test_tab import Browser, airborne, keep_alive
from tests.known import CONNECTED, seen

pytestmark = pytest.mark.anyio

SAY = Translator()


@pytest.fixture
async def newer() -> AsyncIterator[Rig]:
    async with AsyncExitStack() as stack:
        aircraft = VirtualAircraft(seed=5, firmware="3.1")
        yield await stack.enter_async_context(Rig(aircraft).running())


def plan_of(rig: Rig) -> WaypointPlan:
    settings = rig.aircraft.vehicle.settings
    frame = LocalFrame(settings.latitude_deg, settings.longitude_deg)
    places = [frame.to_geodetic(*place) for place in ((15.0, 0.0), (15.0, 15.0), (0.0, 15.0))]
    return WaypointPlan([Waypoint(*place, height=8) for place in places], speed=4)


@pytest.mark.parametrize("as_qgroundcontrol", [False, True])
async def test_a_plan_from_a_file_is_flown(newer: Rig, as_qgroundcontrol: bool) -> None:
    browser = await airborne(newer)
    plan = plan_of(newer)
    text = plan.to_qgroundcontrol() if as_qgroundcontrol else plan.to_json()
    tab = browser.tab
    upload = orders.UploadPlan.of(WaypointPlan.parse(text))
    assert await tab.attempt(lambda: tab.session.ask(upload)), browser.problem
    assert newer.front.plan == plan
    start = orders.StartMission(upload.digest)
    assert await tab.attempt(lambda: tab.session.ask(start)), browser.problem

    async def see() -> list[str]:
        seen: list[str] = []
        while not seen or newer.front.state.mission != "no mission":
            what, part = progress(
                newer.front.plan, newer.front.state.mission, newer.front.state.mission_index
            )
            text = SAY(what)
            assert 0.0 <= part < 1.0
            if text not in seen:
                seen.append(text)
            await anyio.sleep(0.25)
        return seen

    seen: list[str] = []

    async def watch() -> None:
        await anyio.sleep(0.5)
        seen.extend(await see())

    await keep_alive(browser, watch())
    wanted = [f"waypoint mission: to waypoint {number} of 3" for number in (1, 2, 3)]
    assert [text for text in seen if text in wanted] == wanted
    assert newer.aircraft.position == pytest.approx((0.0, 15.0), abs=1.0)


async def test_pause_resume_and_stop(newer: Rig) -> None:
    browser = await airborne(newer)
    tab = browser.tab
    await tab.session.ask(orders.UploadPlan.of(plan_of(newer)))
    await keep_alive(browser, tab.session.ask(orders.StartMission(tab.session.uploaded)))
    for action in (orders.PauseMission(), orders.ResumeMission(), orders.StopMission()):
        await keep_alive(browser, anyio.sleep(1.5))
        assert await tab.attempt(partial(tab.session.ask, action)), browser.problem
    await keep_alive(browser, anyio.sleep(1.0))
    assert newer.front.state.mission == "no mission"


async def test_a_plan_of_somebody_without_control_is_refused(newer: Rig) -> None:
    await airborne(newer)
    other = Browser(newer, "other").tab
    upload = orders.UploadPlan.of(plan_of(newer))
    for order in (upload, orders.StartMission(upload.digest)):
        assert not await other.attempt(partial(other.session.ask, order))
        assert "tab has control" in str(other.refusal)


@pytest.mark.parametrize(
    "plan", [None, WaypointPlan([Waypoint(22.5, 113.9, height=h) for h in (5, 8, 5, 8)])]
)
@pytest.mark.parametrize(
    ("mission", "index", "said"),
    [
        ("", -1, "mission unknown"),
        ("no mission", -1, "no mission"),
        ("hotpoint", -1, "circle around a point"),
        ("of another kind", -1, "program of another kind"),
        ("waypoint mission", 4, "waypoint mission: to waypoint 5"),
    ],
)
def test_how_far_it_is_without_a_plan_of_so_many_waypoints(
    plan: WaypointPlan | None, mission: str, index: int, said: str
) -> None:
    what, part = progress(plan, mission, index)
    assert (SAY(what), part) == (said, 0.0)


# -- the status line -------------------------------------------------------------------------------

C = Cause
FREE = Situation(now=100.0, heard_at=100.0, telemetry_at=99.9, is_activated=True)

# What has to be so for each cause alone, beside what is so when everything is fine.
ALONE: dict[Cause, dict[str, Any]] = {
    C.AGENT_GONE: {"hearing": Hearing.GONE},
    C.AGENT_SILENT: {"hearing": Hearing.SILENT},
    C.LINE_LOST: {"connection": "lost"},
    C.CONNECTING: {"connection": "connecting"},
    C.NEVER_HEARD: {"telemetry_at": None},
    C.AIRCRAFT_SILENT: {"telemetry_at": 98.0},
    C.APP: {"device": Device.APP},
    C.SWITCH: {"switch": RcMode.P},
    C.REPLAY: {"is_replay": True},
    C.OTHER: {"holder": "Anna"},
    C.NOT_ACTIVATED: {"is_activated": False},
    C.PENDING: {"holding": "obtaining"},
    C.GIVING_BACK: {"holding": "releasing"},
    C.MISSION: {"has_lease": True, "has_authority": True, "mission": "waypoint mission"},
    C.YOURS: {"has_lease": True, "has_authority": True},
    C.RC: {"has_lease": True, "device": Device.RC},
    C.TAKEN: {"has_lease": True, "holding": "taken"},
    C.NO_AUTHORITY: {"has_lease": True},
    C.FREE_RC: {"device": Device.RC},
    C.FREE: {},
}

# Pairs in which the two exclude each other, or of which one includes the other.
NO_PAIR = {
    frozenset(pair)
    for pair in (
        (C.AGENT_GONE, C.AGENT_SILENT),
        (C.LINE_LOST, C.CONNECTING),
        (C.NEVER_HEARD, C.AIRCRAFT_SILENT),
        (C.APP, C.RC),
        (C.APP, C.FREE_RC),
        (C.PENDING, C.GIVING_BACK),
        (C.PENDING, C.TAKEN),
        (C.GIVING_BACK, C.TAKEN),
        *product((C.OTHER, C.MISSION, C.YOURS), (C.RC, C.TAKEN, C.NO_AUTHORITY)),
        *product((C.OTHER,), (C.MISSION, C.YOURS)),
    )
}


# The lease without authority, while the aircraft names the remote controller.
MAKE_A_THIRD = {(C.TAKEN, C.FREE_RC): C.RC, (C.NO_AUTHORITY, C.FREE_RC): C.RC}


@pytest.mark.parametrize("cause", Cause)
def test_each_cause_alone_is_reported(cause: Cause) -> None:
    assert status_line(replace(FREE, **ALONE[cause])).cause is cause


@pytest.mark.parametrize(
    ("first", "second"),
    [pair for pair in combinations(Cause, 2) if frozenset(pair) not in NO_PAIR],
    ids=lambda cause: cause.value,
)
def test_of_two_causes_the_one_that_comes_first_is_reported(first: Cause, second: Cause) -> None:
    both = replace(FREE, **{**ALONE[second], **ALONE[first]})
    assert {first, second} <= {cause for cause, (_, holds) in RULES.items() if holds(both)}
    told = status_line(both).cause
    assert told is MAKE_A_THIRD.get((first, second), first)


def test_the_rules_stand_in_the_order_of_the_causes_and_the_last_always_holds() -> None:
    assert list(RULES) == list(Cause)
    _, holds = RULES[list(Cause)[-1]]
    assert holds(Situation())


# By hand: what a glance must say, for whatever is known of lease, authority, switch and device.
def by_hand(now: Situation) -> Cause:
    if now.hearing is not Hearing.HEARD:
        return C.AGENT_GONE if now.hearing is Hearing.GONE else C.AGENT_SILENT
    if now.connection != "connected":
        return C.LINE_LOST if now.connection == "lost" else C.CONNECTING
    if now.telemetry_at is None or now.telemetry_at < 99.0:
        return C.NEVER_HEARD if now.telemetry_at is None else C.AIRCRAFT_SILENT
    if now.device is Device.APP:
        return C.APP
    if now.switch in (RcMode.P, RcMode.A):
        return C.SWITCH
    if now.holder and not now.has_lease:
        return C.OTHER
    if not now.is_activated:
        return C.NOT_ACTIVATED
    if now.has_lease and now.has_authority:
        return C.YOURS
    if now.has_lease:
        return C.RC if now.device is Device.RC else C.NO_AUTHORITY
    return C.FREE_RC if now.device is Device.RC else C.FREE


def test_every_combination_says_what_a_glance_must_say() -> None:
    told = set()
    for hearing, connection, at, device, switch, lease, authority, activated in product(
        Hearing,
        ("connecting", "connected", "lost"),
        (None, 90.0, 99.9),
        (None, *Device),
        (None, *RcMode),
        ("", "mine", "other"),
        (False, True),
        (False, True),
    ):
        now = Situation(
            now=100.0,
            hearing=hearing,
            connection=connection,
            telemetry_at=at,
            device=device,
            switch=switch,
            has_lease=lease == "mine",
            holder=lease,
            has_authority=authority,
            is_activated=activated,
        )
        line = status_line(now)
        assert line.cause is by_hand(now), now
        told.add(line.cause)
    assert told == set(Cause) - {C.REPLAY, C.PENDING, C.GIVING_BACK, C.MISSION, C.TAKEN}


NOT_HEARD = (C.AGENT_GONE, C.AGENT_SILENT, C.LINE_LOST, C.CONNECTING, C.AIRCRAFT_SILENT)


@pytest.mark.parametrize("cause", NOT_HEARD)
def test_while_nothing_is_heard_nobody_is_said_to_fly(cause: Cause) -> None:
    """The switch that was seen before the cable came out proves nothing."""
    line = status_line(replace(FREE, **{**ALONE[C.SWITCH], "task": "land", **ALONE[cause]}))
    assert line.cause is cause
    assert line.flies is None
    for language in Language:
        assert "ilot" not in translations(language)[f"status.{cause.value}"]


def test_a_silence_is_counted_from_when_something_was_heard_last() -> None:
    assert status_line(replace(FREE, telemetry_at=97.5)).since == 97.5
    assert status_line(replace(FREE, hearing=Hearing.SILENT, heard_at=96.0)).since == 96.0
    assert status_line(replace(FREE, connection="lost")).since is None
    assert status_line(FREE).since is None


def test_names_and_reasons_are_said() -> None:
    english = Translator()

    def said(**known: Any) -> str:
        return english(status_line(replace(FREE, **known)).text)

    assert said(holder="Anna") == "Anna has control"
    assert said(switch=RcMode.A) == "The pilot has control: mode switch in A"
    assert said(connection="lost", fault="the port is gone") == (
        "The link to the aircraft is lost: the port is gone"
    )
    assert said(connection="lost") == "The link to the aircraft is lost"


@pytest.mark.parametrize(
    ("known", "text"),
    [
        ({"task": "take off"}, "take-off"),
        ({"task": "go home", "mission": "waypoint mission"}, "going home"),
        ({"task": "arm"}, "program arm"),
        ({"mission": "waypoint mission", "mission_index": 2}, "waypoint mission, to waypoint 3"),
        ({"mission": "hotpoint"}, "circle around a point"),
        ({"mission": "of another kind"}, "program of another kind"),
        ({"mission": "no mission", "pattern": "legs"}, "program legs"),
    ],
)
def test_what_flies_is_said(known: dict[str, Any], text: str) -> None:
    flies = status_line(replace(FREE, **known)).flies
    assert flies is not None
    assert Translator()(flies) == text


def test_nothing_flies_when_nothing_is_known_to() -> None:
    assert status_line(FREE).flies is None


@pytest.mark.parametrize("cause", Cause)
def test_every_cause_has_words_a_level_and_says_what_to_do(cause: Cause) -> None:
    line = status_line(replace(FREE, **ALONE[cause]))
    for speaker in (Translator(),):
        assert speaker(line.text)
        assert line.remedy is None or speaker(line.remedy)
    assert (line.remedy is None) == (cause in (C.PENDING, C.GIVING_BACK, C.YOURS))
    assert line.level is not AlarmLevel.GOOD or cause in (C.YOURS, C.MISSION)


def test_a_virtual_aircraft_is_named_one_whatever_else_is_reported() -> None:
    assert status_line(replace(FREE, is_virtual=True, connection="lost")).is_virtual
    assert not status_line(FREE).is_virtual


# -- what the page says of a recorded flight -------------------------------------------------------

TOLD = Replay(
    path="/logs/flight.mcap",
    utc=1_767_225_600.0,
    clock=500.0,
    since=400.0,
    newest_at=499.9,
    position_s=65.4,
    duration_s=3725.0,
    speed=2.0,
    is_paused=False,
    is_at_end=False,
    is_cut_off=False,
)


READ = RecordedFlight(FlightSummary("flight.mcap"), 65.0)
OUTLINE = replace(READ, is_whole=False)


@pytest.mark.parametrize(
    ("flight", "fault", "note"),
    [
        (None, "", "the file is being read: its alarms and commands follow"),
        (OUTLINE, "", "the file is being read: its alarms and commands follow"),
        (None, "no MCAP", "the file cannot be read: no MCAP"),
        (OUTLINE, "it ended with 7", "the file cannot be read: it ended with 7"),
    ],
)
def test_how_far_a_file_was_read_is_said(
    flight: RecordedFlight | None, fault: str, note: str
) -> None:
    shown = replay_of(TOLD, flight, fault)
    assert shown is not None
    assert shown.note is not None
    assert SAY(shown.note) == note


def test_the_bar_says_what_is_played_and_where_it_is() -> None:
    shown = replay_of(TOLD, READ)
    assert shown is not None
    assert SAY(shown.title) == "REPLAY flight.mcap"
    assert SAY(shown.place) == "1:05 of 1:02:05, 2026-01-01 00:00:00 UTC"
    assert shown.note is None
    assert shown.is_running
    assert replay_of(None) is None


@pytest.mark.parametrize(
    ("changes", "note"),
    [
        ({"is_paused": True}, None),
        ({"is_at_end": True}, "at its end"),
        ({"is_at_end": True, "is_cut_off": True}, "the recording ended without being closed"),
        (
            {"is_at_end": True, "is_cut_off": True, "is_written": True},
            "still being recorded: what came later is not in it",
        ),
    ],
)
def test_one_that_stands_says_why(changes: dict[str, bool], note: str | None) -> None:
    shown = replay_of(replace(TOLD, **changes), READ)  # type: ignore[arg-type] # each is a bool
    assert shown is not None
    assert not shown.is_running
    assert (None if shown.note is None else Translator()(shown.note)) == note


def test_the_alarms_before_and_after_a_place_are_found() -> None:
    alarms = [Span("gps", begin, begin + 2.0) for begin in (10.0, 30.0, 50.0)]
    story = FlightSummary("flight.mcap", alarms=alarms)

    def near(at: float) -> tuple[float | None, float | None]:
        # The first byte came 0.5 s after the first message of the log.
        source = replace(TOLD, position_s=at - 0.5)
        shown = replay_of(source, RecordedFlight(story, at))
        assert shown is not None
        return shown.alarm_before, shown.alarm_after

    assert near(5.0) == (None, 9.5)
    assert near(30.0) == (9.5, 49.5), "the one that begins here is neither"
    assert near(31.5) == (29.5, 49.5)
    assert near(70.0) == (49.5, None)
    assert replay_of(TOLD) is not None, "before the file was read"


def test_nothing_is_offered_and_the_line_says_that_nothing_flies() -> None:
    state = State(at=10.0, connection="connected", replay=TOLD)
    view = view_of(Inputs(vehicle=seen(None, 500.0, state=state)))
    assert view.actions == frozenset(), "not even STOP: there is nothing to stop"
    assert view.replay is not None
    assert replace(seen(None, state=state), at=10.5).now == 500.0, (
        "its clock is that of what was played, however late that arrives"
    )
    assert view.situation.is_replay
    assert view.status.cause in (Cause.REPLAY, Cause.NEVER_HEARD)
    flown = view_of(Inputs(vehicle=seen(None, 500.0, state=replace(state, replay=None))))
    assert "stop" in flown.actions
    assert flown.replay is None


# -- the list of aircraft: one line each, and nothing that is old ----------------------------------


def ship(telemetry: AircraftState | None = None, *, is_ours: bool = False, **more: Any) -> Ship:
    return Ship("kite", seen(telemetry, **more), True, is_ours)


BASE = ship()
OTHER = replace(BASE, name="crow", is_shown=False)


@pytest.fixture
async def telemetry(rig: Rig) -> AircraftState:
    await anyio.sleep(1.5)  # the battery is sent once a second
    assert rig.front.telemetry is not None
    return rig.front.telemetry


def test_of_one_aircraft_there_is_no_list() -> None:
    assert fleet_of([BASE]) == ()


@pytest.mark.parametrize(
    ("one", "kind", "said"),
    [
        (BASE, "free", "the pilot has it"),
        (ship(holder=LeaseChanged(3, "tower")), "theirs", "tower has it"),
        (ship(holder=LeaseChanged(3, "me"), is_ours=True), "mine", "you have it"),
        (
            ship(is_ours=True, state=replace(CONNECTED, has_authority=False)),
            "mine",
            "obeys the pilot",
        ),
        (ship(heard_at=-9.0, is_ours=True), "lost", "not heard"),
        (ship(is_gone=True, is_ours=True), "lost", "not heard"),
        (ship(state=State(0.0, "lost"), is_ours=True), "lost", "not connected"),
    ],
)
def test_the_holder_is_named_in_words_and_by_a_kind(one: Ship, kind: str, said: str) -> None:
    row, other = fleet_of([one, OTHER])
    assert (row.kind, Translator()(row.control)) == (kind, said)
    assert Translator(Language.GERMAN)(row.control)
    assert (row.is_shown, other.is_shown) == (True, False)


async def test_nobody_flies_what_stands_on_the_ground(telemetry: AircraftState) -> None:
    row, _ = fleet_of([ship(telemetry), OTHER])
    assert (row.kind, Translator()(row.control)) == ("free", "nobody has it")


async def test_values_are_shown_while_they_are_new(telemetry: AircraftState) -> None:
    flying = ship(telemetry, state=replace(CONNECTED, mission="waypoint"))
    rows = fleet_of([ship(telemetry), flying, ship(telemetry, is_gone=True)])
    said = [(Translator()(row.flies), Translator()(row.battery)) for row in rows]
    assert said[0][0] == "on the ground"
    assert said[0][1].endswith(" %")
    assert said[1][0] == f"{said[0][0]}, waypoint"
    assert said[2] == ("–", "–")
