"""Each number of the console with its sign, unit, decimals and frame, from the known aircraft.

Up, north, east, nose up, right side down and clockwise are positive (docs/reference/telemetry.md);
a foot is 0.3048 m, a knot 1852 m an hour. Texts are what stands on the page.
"""

from __future__ import annotations

import csv
import io
import json
import math
import re
from collections.abc import Callable
from typing import Any

import pytest

from m100link.apps.agent.messages import GuardLimits, LeaseChanged, LinkCounted, State
from m100link.apps.station.console.kept import LINE_COLUMNS, PlotHistory
from m100link.apps.station.console.view.data import LINK_ITEMS, label, link_of, points
from m100link.apps.station.console.view.fly import instruments_of, live, seen_from_afar
from m100link.apps.station.console.view.header import FleetRow, fleet_of, progress
from m100link.apps.station.console.view.plan import figures_of
from m100link.apps.station.console.view.situation import Inputs, Ship, situation_of
from m100link.apps.station.console.view.texts import (
    Language,
    LengthUnit,
    SpeedUnit,
    Translator,
    Units,
    translations,
)
from m100link.missions.plan import WaypointPlan
from m100link.missions.waypoint import Waypoint
from m100link.protocol.records import (
    Battery,
    Device,
    FlightPhase,
    FlightStatus,
    Gimbal,
    RcMode,
    Velocity,
)
from m100link.telemetry.state import AircraftState
from tests import known
from tests.known import seen
from tests.known_columns import COLUMNS, are

METRIC = Translator()
GERMAN = Translator(Language.GERMAN, Units(LengthUnit.FOOT, SpeedUnit.KM_H))
KNOTS = Translator(Language.ENGLISH, Units(LengthUnit.METRE, SpeedUnit.KNOT))


def heard(*changed: Any, age: float = 0.25) -> AircraftState:
    """A package ten times a second for 5 s, the last of them so many seconds ago."""
    now = [0.0]
    state = AircraftState(lambda: now[0])
    for number in range(51):
        state.update(known.sample(at=number / 10, changed=changed))
    now[0] = 5.0 + age
    return state


# -- instruments ----------------------------------------------------------------------------------

INSTRUMENTS = {
    "flight_status": ("in the air", "in der Luft", "in the air"),
    "battery": ("63 %", "63 %", "63 %"),
    "gps": ("health 4 of 5", "Güte 4 von 5", "health 4 of 5"),
    "flight_time": ("–", "–", "–"),
    "height": ("12.3 m", "40,5 ft", "12.3 m"),
    "altitude": ("87.7 m", "287,6 ft", "87.7 m"),
    "latitude": ("-33.123457°", "-33.123457°", "-33.123457°"),
    "longitude": ("151.234568°", "151.234568°", "151.234568°"),
    "speed": ("3.6 m/s", "12,9 km/h", "6.9 kn"),
    "climb": ("+0.8 m/s", "+3,0 km/h", "+1.6 kn"),
    "heading": ("230°", "230°", "230°"),
    "gimbal": (
        "roll 4° pitch -37° yaw 119°",
        "Rollen 4° Nicken -37° Gieren 119°",
        "roll 4° pitch -37° yaw 119°",
    ),
    "mode_switch": ("F", "F", "F"),
    "control_device": ("onboard computer", "Bordrechner", "onboard computer"),
    "time": ("308.6 s", "308,6 s", "308.6 s"),
}


def test_each_instrument_shows_its_value_and_unit() -> None:
    readings = instruments_of(Inputs(vehicle=seen(heard()))).readings
    assert not any(one.is_stale for one in readings.values())
    assert {
        name: tuple(say(one.text) for say in (METRIC, GERMAN, KNOTS))
        for name, one in readings.items()
    } == INSTRUMENTS


FRAMES = {
    # Of the autopilot; the map's "home" is where it stood last.
    "instruments.height": ("Height above take-off", "Höhe über Start"),
    # Errata 45: no sea level; on the ground it may say 0.
    "instruments.altitude": ("Barometric altitude", "Barometerhöhe"),
    "plots.field.altitude": ("barometric altitude", "Barometerhöhe"),
    "instruments.speed": ("Ground speed", "Tempo über Grund"),
    "plots.field.ground_speed": ("ground speed", "über Grund"),
    # Where the nose points; the way over ground is another one (and "Kurs" would be that).
    "instruments.heading": ("Heading", "Steuerkurs"),
    "click.heading": ("Heading", "Steuerkurs"),
    "click.yaw": ("Heading, °", "Steuerkurs, °"),
    "plan.heading": ("Heading, °", "Steuerkurs, °"),
    "click.height_m": ("Height, {unit}", "Höhe, {unit}"),
    "plan.height": ("Height, {unit}", "Höhe, {unit}"),
    "link.rate": ("Hz", "Hz"),
    "link.jitter": ("jitter, ms", "Jitter, ms"),
    "link.longest_gap": ("longest gap, s", "längste Lücke, s"),
}


@pytest.mark.parametrize("key", FRAMES)
def test_a_label_says_in_which_frame_and_unit_its_number_is(key: str) -> None:
    words = (translations(one)[key] for one in (Language.ENGLISH, Language.GERMAN))
    assert tuple(words) == FRAMES[key]


def test_what_goes_down_below_or_the_other_way_has_its_sign() -> None:
    state = heard(
        Velocity(-3.21, 1.57, -0.84, 7),
        known.position(latitude=33.5, longitude=-70.25, height=-12.34, altitude=-3.21, health=2),
        Gimbal(-4.75, 37.25, -118.75, 6),
        FlightStatus(FlightPhase.LANDING),
    )
    readings = instruments_of(Inputs(vehicle=seen(state))).readings
    said = {name: METRIC(one.text) for name, one in readings.items()}
    assert (
        said
        | {
            **{"height": "-12.3 m", "altitude": "-3.2 m", "speed": "3.6 m/s", "climb": "-0.8 m/s"},
            **{"latitude": "33.500000°", "longitude": "-70.250000°", "flight_status": "landing"},
            **{"gimbal": "roll -5° pitch 37° yaw -119°"},
            **{"gps": "health 2 of 5, too low"},
        }
        == said
    )


@pytest.mark.parametrize(("charge", "said"), [(0, "0 %"), (100, "100 %"), (101, "101?")])
def test_a_charge_above_a_hundred_is_none(charge: int, said: str) -> None:
    readings = instruments_of(Inputs(vehicle=seen(heard(Battery(charge))))).readings
    assert METRIC(readings["battery"].text) == said


def test_a_zero_has_no_minus() -> None:
    state = heard(Velocity(0.0, -0.0, -0.04, 7), known.position(height=-0.04, altitude=-0.0))
    readings = instruments_of(Inputs(vehicle=seen(state))).readings
    said = {name: METRIC(readings[name].text) for name in ("speed", "climb", "height", "altitude")}
    assert said == {"speed": "0.0 m/s", "climb": "+0.0 m/s", "height": "0.0 m", "altitude": "0.0 m"}


def test_the_attitude_is_in_degrees_of_roll_pitch_and_yaw() -> None:
    assert instruments_of(Inputs(vehicle=seen(heard()))).attitude == pytest.approx((10, -20, -130))


@pytest.mark.parametrize(
    ("age", "old"),
    [
        (1.1, set()),
        (1.3, set(INSTRUMENTS) - {"battery", "flight_status", "flight_time"}),
        (2.4, set(INSTRUMENTS) - {"battery", "flight_status", "flight_time"}),
        (2.6, set(INSTRUMENTS) - {"battery"}),
        (4.9, set(INSTRUMENTS) - {"battery"}),
        (5.1, set(INSTRUMENTS)),
    ],
)
def test_from_when_on_a_value_is_old(age: float, old: set[str]) -> None:
    readings = instruments_of(Inputs(vehicle=seen(heard(age=age)))).readings
    assert {name for name, one in readings.items() if one.is_stale} == old
    notes = {METRIC(one.note) for one in readings.values() if one.note is not None}
    assert notes == ({f"{round(age)} s old"} if old else set())


def test_what_the_canvas_draws() -> None:
    assert live(seen(heard())) == {
        **{"op": "live", "t": 5.25, "age": 0.25},
        "att": [10.0, -20.0, -130.0],
        "pos": [-33.1234567, 151.2345678, 12.34],
        "vel": [3.57, 0.84, 3.21, -1.57],  # over ground, up, north, east
        "yaw_rate": 21.2,
        "rc": [1000, -2000, 3000, -4000],
        "rate": 10.0,
    }
    assert "att" in live(seen(heard(age=1.1)))
    assert live(seen(heard(age=1.3))) == {"op": "live", "t": 6.3, "age": 1.3, "rate": 10.0}


def test_what_the_map_draws_of_another_aircraft() -> None:
    assert seen_from_afar("kite", seen(heard())) == {
        "name": "kite",
        "pos": [-33.1234567, 151.2345678, 12.3],
        "yaw": -130,
    }
    assert seen_from_afar("kite", seen(heard(age=1.3))) == {"name": "kite"}


# -- fleet, mission, situation --------------------------------------------------------------------


def ship(telemetry: AircraftState, **state: Any) -> Ship:
    told = State(0.0, "connected", **state)
    return Ship("kite", seen(telemetry, state=told, holder=LeaseChanged(0, "")), True, False)


def row(telemetry: AircraftState, **state: Any) -> FleetRow:
    return fleet_of([ship(telemetry, **state)] * 2)[0]


def test_a_row_of_the_fleet() -> None:
    one = row(heard(), task="landing")
    assert [say(one.flies) for say in (METRIC, GERMAN)] == ["12 m, landing", "40 ft, landing"]
    assert (METRIC(one.battery), one.is_low) == ("63 %", False)
    assert [row(heard(Battery(charge))).is_low for charge in (25, 26)] == [True, False]
    assert [METRIC(row(heard(Battery(charge))).battery) for charge in (100, 101)] == ["100 %", "–"]
    below = row(heard(known.position(height=-1.75)))
    assert METRIC(below.flies) == "-2 m"
    # Old after a second or so; the charge comes once a second and may miss more.
    assert [METRIC(row(heard(age=age)).flies) for age in (1.1, 1.3)] == ["12 m", "–"]
    assert [METRIC(row(heard(age=age)).battery) for age in (4.9, 5.1)] == ["63 %", "–"]


def test_what_is_known_of_the_situation() -> None:
    # 0.003 degrees of latitude are 333.6 m on a sphere of 6371 km.
    limits = GuardLimits(latitude_deg=-33.1204567, longitude_deg=151.2345678)
    state = State(0.0, "connected", round_trip=0.0375, mission_index=4, limits=limits)
    now = situation_of(Inputs(vehicle=seen(heard(), 5.25, state=state), page_trip=0.0125))
    assert (now.telemetry_at, now.telemetry_age) == (5.0, 0.25)
    assert (now.switch, now.device, now.phase) == (RcMode.F, Device.ONBOARD, FlightPhase.IN_AIR)
    assert (now.battery, now.gps, now.mission_index) == (63, 4, 4)
    assert now.height == pytest.approx(12.34, rel=1e-6)
    assert now.place == pytest.approx((-33.1234567, 151.2345678), rel=1e-12)
    assert now.distance == pytest.approx(333.6, rel=5e-3)
    assert (now.round_trip, now.page_trip) == (0.0375, 0.0125)
    low = situation_of(Inputs(vehicle=seen(heard(known.position(health=2)), state=state)))
    assert (low.gps, low.place, low.distance) == (2, None, None)
    assert situation_of(Inputs(vehicle=seen(heard(Battery(101)), state=state))).battery is None


PLAN = WaypointPlan(
    [
        Waypoint(47.0, 8.0, height=12.5),
        Waypoint(47.001, 8.0, height=34.5),  # 111.2 m to the north
        Waypoint(47.001, 8.002, height=23.5),  # 151.7 m to the east
    ],
    speed=4.5,
)


def test_a_plan_in_one_line() -> None:
    """The way climbs: 113.4 and 152.1 m through the air, 265.5 m on a sphere.

    In 59.0 s, with two stops of 3.35 s and a turn of 2 s.
    """
    figures = figures_of(PLAN, PLAN.estimate())
    found = re.fullmatch(r"3 waypoints, (\d+) m, 12 m to 34 m; 1:08 min, .*", METRIC(figures))
    assert found is not None
    assert float(found[1]) == pytest.approx(265.5, abs=1.5)
    german = re.fullmatch(r"3 Wegpunkte, (\d+) ft, 41 ft bis 113 ft; 1:08 min, .*", GERMAN(figures))
    assert german is not None
    assert float(german[1]) == pytest.approx(871.0, abs=5.0)


@pytest.mark.parametrize(
    ("index", "said", "part"),
    [(0, "1 of 3", 0.0), (1, "2 of 3", 1 / 3), (2, "3 of 3", 2 / 3), (-1, "", 0.0)],
)
def test_waypoints_are_counted_from_one(index: int, said: str, part: float) -> None:
    text, done = progress(PLAN, "waypoint mission", index)
    assert said in METRIC(text)
    assert done == pytest.approx(part)


# -- the line -------------------------------------------------------------------------------------

COUNTED = LinkCounted(
    50.0,
    {
        **{"bytes_received": 1001, "bytes_sent": 1002, "frames_received": 103, "frames_sent": 104},
        **{"discarded_bytes": 105, "dropped_writes": 6, "acks": 41, "duplicate_acks": 7},
        **{"late_acks": 8, "foreign_acks": 9, "repeats": 11, "expired": 12},
    },
    {"no_key": 2, "frame_crc": 15, "header_crc": 14},
    loop_lag=0.0146,
)


def test_each_number_of_the_line() -> None:
    state = State(
        *(0.0, "connected"),
        firmware="3.1",
        round_trip=0.0375,
        lease_remaining=2.6,
        discards=31,
        mismatches=17,
    )
    inputs = Inputs(
        vehicle=seen(heard(), state=state, holder=LeaseChanged(3, "tower")),
        link=COUNTED,
        front_lag=0.0066,
        page_trip=1.2345,
    )
    link = link_of(inputs)
    assert {name: METRIC(text) for name, text in link.texts.items()} == {
        **{"connection": "connected", "firmware": "3.1", "clients": "tower, 3 s"},
        **{"aircraft_ms": "38 ms", "page_ms": "1234 ms", "agent_lag": "15 ms", "front_lag": "7 ms"},
        **{"discards": "31", "mismatches": "17", "frames_received": "103", "frames_sent": "104"},
        **{"bytes_received": "1001", "bytes_sent": "1002", "discarded_bytes": "105"},
        **{"acks": "41", "repeats": "11", "expired": "12", "duplicate_acks": "7"},
        **{"late_acks": "8", "foreign_acks": "9", "dropped_writes": "6"},
    }
    assert set(link.texts) == set(LINK_ITEMS)
    causes = [(METRIC(cause), count) for cause, count in link.causes]
    assert causes == [
        ("checksum of the frame", "15"),
        ("checksum of the header", "14"),
        ("encrypted, and no key", "2"),
    ]
    # Hz, jitter in ms, longest gap in s. One of the last 25 intervals is 50 ms too long, one short.
    late = AircraftState(lambda: 9.0)
    for number in range(31):
        at = number / 10 + (0.05 if number == 20 else 0.0)
        late.update(known.sample(at=at, without=[type(one) for one in known.EVERYTHING[2:]]))
    rates = [
        (METRIC(one.name), one.rate, one.jitter, one.longest_gap)
        for one in link_of(Inputs(vehicle=seen(late))).rates
    ]
    assert [one[1:] for one in rates] == [("10.0", "4.0", "0.15")] * 2
    assert [name for name, *_ in rates] == ["time", "attitude"]


# -- plots and what is downloaded -----------------------------------------------------------------

LINE = {
    "line.packages_per_s": 10.0,
    "line.round_trip_ms": 37.5,
    "line.discards": 31.0,
    "line.late_acks": 8.0,
    "line.dropped_writes": 6.0,
    "line.front_lag_ms": 12.5,
}


def kept() -> PlotHistory:
    history = PlotHistory()
    history.lag = 0.0125
    state = State(0.0, "connected", round_trip=0.0375, discards=31, late_acks=8, dropped_writes=6)
    history.add(1_795_420_802.25, seen(heard(), state=state))
    return history


def test_the_history_has_each_value_in_its_column() -> None:
    names = [*COLUMNS, *LINE]
    [(utc, *values)] = kept().rows(names)
    assert utc == 1_795_420_802.25
    are(dict(zip(names, values, strict=True)), COLUMNS | LINE)
    assert tuple(LINE) == LINE_COLUMNS
    [row] = csv.DictReader(io.StringIO(kept().csv(names)))
    assert row.pop("utc") == "2026-11-23T08:00:02.250Z"
    assert row.keys() == dict.fromkeys(names).keys()
    for name, value in (COLUMNS | LINE).items():
        assert float(row[name]) == pytest.approx(value, rel=3e-7, abs=1e-9), name


UNITS = {
    **{"time.tick_hz": "Hz", "battery.percent": "%", "line.packages_per_s": "1/s"},
    **{"line.round_trip_ms": "ms", "line.front_lag_ms": "ms"},
    **{f"quaternion.{angle}_deg": "°" for angle in ("roll", "pitch", "yaw")},
    **{f"gimbal.{angle}_deg": "°" for angle in ("roll", "pitch", "yaw")},
    **{f"acceleration.{axis}_m_s2": "m/s²" for axis in ("north", "east", "up")},
    **{f"velocity.{axis}_m_s": "m/s" for axis in ("north", "east", "up", "ground_speed")},
    **{f"angular_velocity.{axis}_rad_s": "rad/s" for axis in ("forward", "right", "down")},
    **{f"angular_velocity.{angle}_rate_deg_s": "°/s" for angle in ("roll", "pitch", "yaw")},
    **{f"position.{name}_rad": "rad" for name in ("latitude", "longitude")},
    **{f"position.{name}_deg": "°" for name in ("latitude", "longitude")},
    **{"position.altitude_m": "m", "position.height_m": "m"},
}


@pytest.mark.parametrize("name", [*COLUMNS, *LINE])
def test_each_curve_is_called_by_its_unit(name: str) -> None:
    unit = UNITS.get(name)
    feet, knots = {"m": "ft"}, {"m/s": "kn"}
    imperial = Translator(Language.ENGLISH, Units(LengthUnit.FOOT, SpeedUnit.KNOT))
    for speaker, told in ((METRIC, unit), (imperial, (feet | knots).get(unit or "", unit))):
        said = speaker(label(name))
        found = said.rpartition(", ")[2] if ", " in said else None
        assert found == told, f"_UNITS of view/data.py and UNITS of this file differ in {name}"


def test_curves_are_drawn_in_the_units_that_were_chosen() -> None:
    names = [
        *("position.height_m", "velocity.up_m_s", "velocity.ground_speed_m_s"),
        *("acceleration.east_m_s2", "angular_velocity.yaw_rate_deg_s", "position.latitude_deg"),
    ]
    rows = kept().rows(names)
    metric = [1_795_420_802_250, 12.34, 0.84, 3.57337, -2.5, 21.1994, -33.1235]
    assert points(rows, names, Units()) == [metric]
    imperial = [1_795_420_802_250, 40.4856, 3.024, 12.8641, -2.5, 21.1994, -33.1235]
    assert points(rows, names, Units(LengthUnit.FOOT, SpeedUnit.KM_H)) == [imperial]


# -- numbers that are none ------------------------------------------------------------------------

FLOATS = [
    (kind, place)
    for kind, one in enumerate(known.EVERYTHING)
    for place, value in enumerate(one)
    if isinstance(value, float)
]


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize(("kind", "place"), FLOATS)
def test_what_is_no_number_is_reported_as_unknown(kind: int, place: int, bad: float) -> None:
    """One aircraft that sends such a thing must not end the page by which another one is flown."""
    record: Any = known.EVERYTHING[kind]
    if type(record).__name__ == "Magnetometer":  # whole numbers on the wire
        return
    values = list(record)
    values[place] = bad
    state = heard(type(record)(*values))
    told: list[Callable[[], Any]] = [
        lambda: live(seen(state)),
        lambda: seen_from_afar("kite", seen(state)),
        lambda: [
            METRIC(one.text)
            for one in instruments_of(Inputs(vehicle=seen(state))).readings.values()
        ],
        lambda: METRIC(row(state).flies),
        lambda: METRIC(row(state).battery),
        lambda: points(_rows(state), list(COLUMNS), Units()),
        lambda: situation_of(Inputs(vehicle=seen(state, state=State(0.0)))).height,
    ]
    for one in told:
        text = json.dumps(one(), allow_nan=False)
        assert not re.search(r"\bnan\b|\binf\b", text), text


def _rows(state: AircraftState) -> list[tuple[float, ...]]:
    history = PlotHistory()
    history.add(1.0, seen(state))
    return history.rows(list(COLUMNS))
