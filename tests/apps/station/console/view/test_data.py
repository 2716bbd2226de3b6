"""The link in numbers."""

from __future__ import annotations

import csv
import io
import json
import math
from itertools import pairwise

import anyio
import pytest

from m100link.apps.agent.messages import Event, LeaseChanged, LinkCounted, RemoteError, State
from m100link.apps.station.console.kept import COLUMNS, INTERVAL
from m100link.apps.station.console.view.data import (
    FIRST_CHOICE,
    LEVELS,
    LINK_ITEMS,
    MOST,
    RANGES,
    Diary,
    chart,
    export,
    height,
    known,
    label,
    link_of,
    points,
    select,
    step,
    window,
)
from m100link.apps.station.console.view.situation import Inputs, RecordedFlight
from m100link.apps.station.console.view.texts import (
    METRIC,
    Language,
    LengthUnit,
    SpeedUnit,
    Translator,
    Units,
    tr,
    translations,
)
from m100link.errors import LinkLost
from m100link.log.story import FlightSummary
from m100link.telemetry.state import AircraftState
from m100link.wire.frame import Discard
from tests.apps.station.conftest import Rig
from tests.known import seen

pytestmark = pytest.mark.anyio

SAY = Translator()


def test_without_an_aircraft_nothing_is_counted() -> None:
    state = State(
        0.0, "lost", connection_fault=RemoteError.of(LinkLost("the cable is out")), discards=4
    )
    link = link_of(Inputs(vehicle=seen(None, state=state)))
    assert SAY(link.texts["connection"]) == "lost"
    assert SAY(link.texts["discards"]) == "–"
    assert (link.causes, link.rates) == ((), ())
    assert "the cable is out" in link.reason


def test_with_one_everything_is() -> None:
    state = State(
        0.0, "connected", firmware="3.1", round_trip=0.0123, discards=4, lease_remaining=3
    )
    counted = LinkCounted(1.0, {"late_acks": 2}, {"unheard_of": 1, "frame_crc": 3}, 0.0042)
    link = link_of(
        Inputs(
            vehicle=seen(AircraftState(lambda: 0.0), state=state, holder=LeaseChanged(1, "tab")),
            link=counted,
            front_lag=0.007,
            page_trip=0.0205,
        )
    )
    assert tuple(link.texts) == LINK_ITEMS
    shown = {"aircraft_ms": "12 ms", "page_ms": "20 ms", "agent_lag": "4 ms", "front_lag": "7 ms"}
    shown |= {"discards": "4", "late_acks": "2", "acks": "–", "clients": "tab, 3 s"}
    assert {name: SAY(link.texts[name]) for name in shown} == shown
    said = [(SAY(cause), count) for cause, count in link.causes]
    assert said == [("checksum of the frame", "3"), ("unheard_of", "1")]
    assert link.reason == ""


def test_slow_clients_are_named_the_slowest_first() -> None:
    link = link_of(
        Inputs(
            vehicle=seen(None, state=State(at=0.0)),
            dropped=(("tab", 0), ("rosbridge 127.0.0.1:5", 12), ("a tab", 0)),
        )
    )
    assert link.dropped == (("rosbridge 127.0.0.1:5", "12"), ("a tab", "0"), ("tab", "0"))


def test_an_aircraft_that_does_not_answer_is_said_to() -> None:
    inputs = Inputs(vehicle=seen(AircraftState(lambda: 0.0), state=State(0.0)))
    assert SAY(link_of(inputs).texts["aircraft_ms"]) == "no answer"


def test_an_agent_that_is_not_heard_is_silent() -> None:
    inputs = Inputs(vehicle=seen(None, state=State(0.0, "connected"), heard_at=-9.0))
    assert SAY(link_of(inputs).texts["connection"]) == "silent"


@pytest.mark.parametrize("name", [*LINK_ITEMS, *(f"cause.{one}" for one in Discard)])
def test_every_number_has_a_name(name: str) -> None:
    assert f"link.{name}" in translations()


async def test_the_agent_counts_and_items_arrive(rig: Rig) -> None:
    await anyio.sleep(2.5)
    counted = rig.front.link
    assert counted is not None
    assert counted.counters["frames_received"] > 100
    assert counted.loop_lag >= 0.0
    link = link_of(Inputs(vehicle=seen(rig.front.telemetry, state=rig.front.state), link=counted))
    assert SAY(link.texts["frames_received"]).isdigit()
    rates = {SAY(one.name): one for one in link.rates}
    assert float(rates["attitude"].rate) == pytest.approx(100.0, abs=5.0)
    rig.aircraft.unplug()
    await rig.until(lambda: rig.front.link is None)


# -- plots: names for people, and what goes to the page --------------------------------------------


@pytest.mark.parametrize(
    ("name", "shown"),
    [
        ("position.height_m", "position: height, m"),
        ("velocity.ground_speed_m_s", "velocity: ground speed, m/s"),
        ("angular_velocity.yaw_rate_deg_s", "angular velocity: yaw rate, °/s"),
        ("battery.percent", "battery: charge, %"),
        ("flight_status.status", "flight status: status"),
        ("line.round_trip_ms", "line: round trip, ms"),
        ("line.packages_per_s", "line: packages, 1/s"),
    ],
)
def test_a_number_is_called_by_what_it_is_and_its_unit(name: str, shown: str) -> None:
    assert Translator()(label(name)) == shown


def test_lengths_and_speeds_are_drawn_in_the_units_that_were_chosen() -> None:
    speaker = Translator(Language.GERMAN, Units(LengthUnit.FOOT, SpeedUnit.KM_H))
    names = "position.height_m", "velocity.up_m_s", "acceleration.up_m_s2"
    assert [speaker(label(name)) for name in names] == [
        "Position: Höhe, ft",
        "Geschwindigkeit: nach oben, km/h",
        "Beschleunigung: nach oben, m/s²",
    ]
    made = points([(1.0, 10.0, 10.0, 10.0)], names, speaker.units)
    assert made == [[1000, 32.8084, 36.0, 10.0]]
    assert chart(names, speaker)["yAxis"][0]["name"] == "Position: Höhe, ft"


@pytest.mark.parametrize("language", Language)
def test_every_number_has_a_name_of_its_own(language: Language) -> None:
    speaker = Translator(language)
    assert len({speaker(label(name)) for name in COLUMNS}) == len(COLUMNS)


def test_every_number_with_a_unit_in_its_name_shows_it() -> None:
    endings = ("_m", "_deg", "_s", "_ms", "_rad", "_hz", "_s2", "percent")
    said = [Translator()(label(name)) for name in COLUMNS if name.endswith(endings)]
    assert [text for text in said if ", " not in text] == []


def test_only_what_there_is_can_be_drawn_each_once_and_not_too_much() -> None:
    assert known(["battery.percent", "nonsense", "battery.percent"]) == ["battery.percent"]
    assert len(known(COLUMNS)) == MOST
    assert known(FIRST_CHOICE) == list(FIRST_CHOICE)


def test_no_value_is_null_for_the_page_and_not_a_number() -> None:
    made = points([(1.5, 2.0, math.nan)], COLUMNS[:2], METRIC)
    assert made == [[1500, 2.0, None]]
    assert json.loads(json.dumps(made, allow_nan=False)) == [[1500, 2.0, None]]


@pytest.mark.parametrize("count", [0, 1, MOST])
def test_each_number_has_a_stripe_of_its_own_and_one_cursor_reads_all(count: int) -> None:
    options = chart(COLUMNS[:count], Translator())
    assert len(options["grid"]) == len(options["series"]) == len(options["yAxis"]) == count
    assert options["axisPointer"]["link"] == [{"xAxisIndex": "all"}]
    assert sum(one["axisLabel"]["show"] for one in options["xAxis"]) == min(count, 1)
    assert all(one["axisLabel"]["hideOverlap"] for one in options["xAxis"])
    tops = [grid["top"] for grid in options["grid"]]
    assert all(after - before > 88 for before, after in pairwise(tops))
    assert not tops or tops[-1] + 88 <= height(COLUMNS[:count])


@pytest.mark.parametrize("seconds", RANGES)
def test_a_line_has_no_more_points_than_are_seen(seconds: int) -> None:
    assert seconds / INTERVAL / step(seconds) <= 600
    assert step(seconds) == 1 or seconds / INTERVAL / (step(seconds) - 1) > 600, "nor far fewer"


# -- the list of events ----------------------------------------------------------------------------

WALL = 1_800_000_000.0  # 2027-01-15 08:00 UTC
ENGLISH, GERMAN = Translator(), Translator(Language.GERMAN)


def diary() -> Diary:
    one = Diary()
    one.take(
        [Event(1, 10.0, "info", "connected"), Event(2, 12.5, "error", "connection lost: cable")],
        now=20.0,
        wall=WALL,
    )
    one.write(tr("alarms.gps"), WALL + 1.0, "warning")
    return one


def test_an_event_has_the_time_of_the_wall_and_is_taken_once() -> None:
    one = diary()
    one.take([Event(2, 12.5, "error", "connection lost: cable")], now=30.0, wall=WALL + 7.0)
    assert [line.at - WALL for line in one.lines] == [-10.0, -7.5, 1.0]
    assert [line.number for line in one.lines] == [1, 2, 3]


def test_a_clock_that_is_set_moves_no_event() -> None:
    one = diary()
    one.take([Event(3, 21.0, "info", "later")], now=21.0, wall=WALL + 3600.0)
    assert [line.at - WALL for line in one.lines] == [-10.0, -7.5, 1.0, 3600.0]


def test_very_many_events_are_bounded() -> None:
    one = Diary()
    one.take([Event(number, 0.0, "info", "") for number in range(1, 3000)], 0.0, WALL)
    assert len(one.lines) == 1000
    assert one.lines[-1].number == 2999


@pytest.mark.parametrize(
    ("least", "words", "numbers"),
    [
        ("info", "", [1, 2, 3]),
        ("warning", "", [2, 3]),
        ("error", "", [2]),
        ("info", "CABLE", [2]),
        ("info", "lost cable", [2]),
        ("info", "cable nothing", []),
        ("warning", "gps", [3]),
    ],
)
def test_lines_are_selected_by_level_and_words(least: str, words: str, numbers: list[int]) -> None:
    chosen = select(diary().lines, ENGLISH, least=least, words=words)
    assert [line.number for line in chosen] == numbers


def test_words_are_found_in_the_language_that_is_shown() -> None:
    assert len(select(diary().lines, GERMAN, words="schwach")) == 1
    assert select(diary().lines, ENGLISH, words="schwach") == []


def test_the_list_is_a_table_with_the_operators_clock_and_language() -> None:
    rows = list(csv.DictReader(io.StringIO(export(diary().lines, ENGLISH, -90))))
    assert rows[0] == {
        "time": "2027-01-15T06:29:50.000-01:30",
        "level": "info",
        "source": "station",
        "text": "connected",
    }
    assert [row["source"] for row in rows] == ["station", "station", "page"]
    *_, last = csv.DictReader(io.StringIO(export(diary().lines, GERMAN, utc_offset_min=60)))
    assert last == {
        "time": "2027-01-15T09:00:01.000+01:00",
        "level": "warning",
        "source": "page",
        "text": "GPS ist schwach: das Fluggerät kann abtreiben",
    }


@pytest.mark.parametrize("name", ["=1+1", "+cmd", "-2", "@sum", "\tx", 'say "hi", all'])
def test_what_strangers_wrote_is_no_formula(name: str) -> None:
    one = Diary()
    one.take([Event(1, 0.0, "info", name)], 0.0, WALL)
    [row] = csv.DictReader(io.StringIO(export(one.lines, ENGLISH)))
    assert row["text"].lstrip("'") == name
    assert row["text"][0] not in "=+-@\t"


def test_every_level_has_words() -> None:
    assert {Translator()(tr(f"events.level.{level}")) for level in LEVELS} == {
        "all",
        "warnings",
        "errors",
    }


# -- a recorded flight -----------------------------------------------------------------------------


def test_a_part_of_a_recorded_flight_stays_while_the_cursor_is_in_it() -> None:
    def at(place: float, seconds: float, before: tuple[float, float]) -> tuple[float, float]:
        story = FlightSummary("x.mcap", duration_s=500.0)
        return window(RecordedFlight(story, place), seconds, before)

    assert at(70.0, 0, (0.0, 0.0)) == (0.0, 500.0)
    first = at(100.0, 60, (0.0, 500.0))
    assert first == (94.0, 154.0)
    assert at(94.0, 60, first) == at(154.0, 60, first) == first
    assert at(154.1, 60, first) == pytest.approx((148.1, 208.1))
    assert at(93.9, 60, first) == pytest.approx((87.9, 147.9))
    assert at(2.0, 60, first) == (0.0, 60.0), "nothing is before the beginning"


def test_lines_beside_a_number_and_times_of_alarms_are_drawn_in_its_stripe() -> None:
    names = ["position.height_m", "velocity.up_m_s"]
    drawn = chart(names, SAY, [(1, tr("plots.commanded"), "#888")], [(1000.0, 2000.0)])
    assert [one["yAxisIndex"] for one in drawn["series"]] == [0, 1, 1]
    assert drawn["series"][2]["name"] == "commanded"
    spans = [one.get("markArea", {}).get("data") for one in drawn["series"]]
    assert spans == [[[{"xAxis": 1000.0}, {"xAxis": 2000.0}]]] * 2 + [None]
    assert len(drawn["xAxis"]) == len(drawn["grid"]) == 2
