"""Alarms: when each begins and ends, and every state with every input."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import pytest

from m100link.apps.agent.client import Hearing
from m100link.apps.agent.lease import Flown, LeaseChange
from m100link.apps.agent.messages import GuardLimits, LeaseChanged
from m100link.apps.station.console.view.alarms import (
    ALARMS,
    TRANSITIONS,
    ActiveAlarm,
    AlarmInput,
    AlarmManager,
    AlarmName,
    AlarmState,
)
from m100link.apps.station.console.view.situation import (
    AlarmLevel,
    Situation,
)
from m100link.apps.station.console.view.texts import Translator
from m100link.errors import LossReason
from m100link.protocol.records import FlightPhase

S, In, N = AlarmState, AlarmInput, AlarmName

# In flight, and all is well.
FINE = Situation(
    telemetry_at=0.0,
    is_activated=True,
    has_lease=True,
    has_authority=True,
    holder="tab",
    phase=FlightPhase.IN_AIR,
    battery=80,
    gps=5,
    height=10.0,
    distance=5.0,
    limits=GuardLimits(50.0, 150.0, 10.0, 20),
)

BY_HAND = {
    (S.QUIET, In.BEGINS): S.RAISED,
    (S.QUIET, In.ENDS): S.QUIET,
    (S.QUIET, In.SEEN): S.QUIET,
    (S.RAISED, In.BEGINS): S.RAISED,
    (S.RAISED, In.ENDS): S.PASSED,  # nobody has seen it: it stays on the page
    (S.RAISED, In.SEEN): S.ACKNOWLEDGED,
    (S.ACKNOWLEDGED, In.BEGINS): S.ACKNOWLEDGED,  # it is known
    (S.ACKNOWLEDGED, In.ENDS): S.QUIET,
    (S.ACKNOWLEDGED, In.SEEN): S.ACKNOWLEDGED,
    (S.PASSED, In.BEGINS): S.RAISED,  # once more, and loudly
    (S.PASSED, In.ENDS): S.PASSED,
    (S.PASSED, In.SEEN): S.QUIET,
}


@pytest.mark.parametrize(("before", "what"), BY_HAND)
def test_every_state_with_every_input(before: AlarmState, what: AlarmInput) -> None:
    assert TRANSITIONS[before].get(what, before) is BY_HAND[before, what]
    assert len(BY_HAND) == len(S) * len(In)


class Flight:
    """A flight that the alarms see four times a second."""

    def __init__(self, **known: Any) -> None:
        self.manager = AlarmManager()
        self.now = replace(FINE, now=0.0)
        self.changes: list[ActiveAlarm] = []
        self.fly(1.0)
        self.change(**known)

    def fly(self, seconds: float) -> None:
        for _ in range(round(seconds * 4)):
            at = self.now.now + 0.25
            heard = self.now.telemetry_at == self.now.now
            self.now = replace(
                self.now, now=at, telemetry_at=at if heard else self.now.telemetry_at
            )
            self.changes += self.manager.advance(self.now)

    def change(self, seconds: float = 0.25, **known: Any) -> None:
        self.now = replace(self.now, **known)
        self.fly(seconds)

    def see(self, name: AlarmName) -> None:
        self.changes += self.manager.acknowledge(name, self.now.now)

    @property
    def sounds(self) -> AlarmLevel | None:
        return self.manager.sounding

    @property
    def shown(self) -> dict[AlarmName, AlarmState]:
        return {one.name: one.state for one in self.manager.shown}

    def text(self, name: AlarmName) -> str:
        return next(Translator()(one.text) for one in self.manager.shown if one.name is name)


def lease_lost(number: int = 7) -> LeaseChanged:
    return LeaseChanged(number, "Anna", LeaseChange.TAKEN_OVER)


def silent(seconds: float) -> dict[str, Any]:
    return {"telemetry_at": 1.0, "seconds": seconds}


# What begins each alarm, what ends it, and what it says.
CASES: dict[AlarmName, tuple[dict[str, Any], dict[str, Any], str]] = {
    N.LINK_LOST: ({"connection": "lost"}, {"connection": "connected"}, "link to the aircraft"),
    N.LANDS_ITSELF: (
        {"phase": FlightPhase.LANDING, "seconds": 1.0},
        {"phase": FlightPhase.STANDBY},
        "lands by itself",
    ),
    N.BATTERY_CRITICAL: ({"battery": 10}, {"battery": 30}, "Battery 10 %: the aircraft is about"),
    N.LEASE_TAKEN: (
        {"lease_end": lease_lost(), "has_lease": False},
        {"lease_end": None, "has_lease": True},
        "Anna took control from you",
    ),
    N.LINK_OLD: (silent(1.5), {"telemetry_at": 2.75, "seconds": 1.25}, "silent"),
    N.NAVIGATION: (
        {"contradiction": "the position jumped by 50 m"},
        {"contradiction": "", "seconds": 1.25},
        "cannot be true (the position jumped by 50 m): have the pilot take over",
    ),
    N.BATTERY_FLOOR: ({"battery": 19}, {"battery": 30}, "below 20 % the station does not steer"),
    N.GPS: ({"gps": 2, "seconds": 1.25}, {"gps": 3, "seconds": 2.5}, "GPS is weak"),
    N.AUTHORITY_LOST: (
        {"has_authority": False, "loss": LossReason.MODE_SWITCH},
        {"has_authority": True, "loss": None},
        "The pilot took control",
    ),
    N.MISSION_ABORTED: (
        {"aborted": 3, "aborted_why": "too far away"},
        {"aborted": 0},
        "Mission broken off: too far away",
    ),
    N.GUARD_NEAR: ({"height": 45.0}, {"height": 42.0, "seconds": 1.25}, "height 45 m of 50 m"),
    N.BATTERY_LOW: ({"battery": 25}, {"battery": 30}, "Battery 25 %: land soon"),
}


@pytest.mark.parametrize("name", AlarmName)
def test_each_alarm_begins_is_acknowledged_and_ends(name: AlarmName) -> None:
    begin, end, text = CASES[name]
    flight = Flight()
    assert flight.shown == {}
    flight.change(**begin)
    assert flight.shown == {name: S.RAISED}
    assert text in flight.text(name)
    assert flight.sounds is next(one.level for one in ALARMS if one.name is name)
    flight.see(name)
    flight.change(**end)
    assert flight.shown == {}
    told = [change.state for change in flight.changes if change.name is name]
    assert told == [S.RAISED, S.ACKNOWLEDGED, S.QUIET]


@pytest.mark.parametrize("name", AlarmName)
def test_each_alarm_that_nobody_saw_stays_when_it_is_over(name: AlarmName) -> None:
    begin, end, _ = CASES[name]
    flight = Flight()
    flight.change(**begin)
    flight.change(**end)
    assert flight.shown[name] is S.PASSED
    assert flight.sounds is None
    flight.see(name)
    assert name not in flight.shown


# -- hysteresis, and what is not known -------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "begin", "between"),
    [
        (N.BATTERY_CRITICAL, {"battery": 10}, {"battery": 11}),
        (N.BATTERY_FLOOR, {"battery": 19}, {"battery": 20}),
        (N.BATTERY_LOW, {"battery": 25}, {"battery": 26}),
        (N.GUARD_NEAR, {"height": 46.0}, {"height": 43.0}),
        (N.GUARD_NEAR, {"distance": 140.0}, {"distance": 130.0}),
        (N.BATTERY_LOW, {"battery": 25}, {"battery": None}),
        (N.GPS, {"gps": 1, "seconds": 1.25}, {"gps": None}),
        (N.LANDS_ITSELF, {"phase": FlightPhase.LANDING, "seconds": 1.0}, {"phase": None}),
        (N.LINK_LOST, {"connection": "lost"}, {"connection": "connecting"}),
        (
            N.AUTHORITY_LOST,
            {"has_authority": False, "loss": LossReason.APP},
            {"connection": "lost"},
        ),
    ],
)
def test_between_the_two_and_unknown_an_alarm_stays_as_it_is(
    name: AlarmName, begin: dict[str, Any], between: dict[str, Any]
) -> None:
    quiet = Flight()
    quiet.change(10.0, **between)
    assert name not in quiet.shown
    flight = Flight()
    flight.change(**begin)
    flight.change(10.0, **between)
    assert flight.shown[name] is S.RAISED


@pytest.mark.parametrize(
    ("begins", "stays", "ends", "name"),
    [
        (10, 11, 12, N.BATTERY_CRITICAL),
        (19, 20, 21, N.BATTERY_FLOOR),
        (25, 26, 27, N.BATTERY_LOW),
    ],
)
def test_each_level_of_the_battery_has_a_gap(
    begins: int, stays: int, ends: int, name: AlarmName
) -> None:
    flight = Flight(battery=begins + 1)
    assert name not in flight.shown
    flight.change(battery=begins)
    assert flight.shown == {name: S.RAISED}
    flight.change(battery=stays)
    assert flight.shown == {name: S.RAISED}
    flight.change(battery=ends)
    assert flight.shown[name] is S.PASSED


def test_what_is_acknowledged_is_silent_and_something_new_is_not() -> None:
    flight = Flight(gps=1)
    flight.fly(2.0)
    flight.see(N.GPS)
    silence = flight.sounds
    flight.change(height=47.0)
    assert (silence, flight.sounds) == (None, AlarmLevel.WARNING)


def test_a_value_at_the_edge_rings_once() -> None:
    flight = Flight()
    for height in (45.5, 44.0, 45.5, 44.0, 45.5):
        flight.change(0.25, height=height)
    assert [change.state for change in flight.changes] == [S.RAISED]


def test_what_is_weak_for_a_moment_is_no_alarm() -> None:
    flight = Flight()
    for _ in range(5):
        flight.change(0.75, gps=2)
        flight.change(0.25, gps=4)
    assert flight.changes == []


def test_what_is_well_for_a_moment_ends_nothing() -> None:
    flight = Flight(gps=1)
    flight.fly(2.0)
    for _ in range(3):
        flight.change(1.0, gps=5)
        flight.change(0.5, gps=2)
    assert [change.state for change in flight.changes] == [S.RAISED]


# -- one by one ------------------------------------------------------------------------------------


@pytest.mark.parametrize("hearing", [Hearing.SILENT, Hearing.GONE])
def test_an_agent_that_is_not_heard_is_a_lost_line(hearing: Hearing) -> None:
    flight = Flight(hearing=hearing)
    assert flight.shown == {N.LINK_LOST: S.RAISED}


def test_a_line_that_is_opened_for_the_first_time_is_no_alarm() -> None:
    manager = AlarmManager()
    assert manager.advance(Situation(connection="connecting")) == []


@pytest.mark.parametrize(
    "asked", [{"task": "land"}, {"task": "go home"}, {"mission": "waypoint mission"}]
)
def test_a_landing_that_was_asked_for_is_no_alarm(asked: dict[str, Any]) -> None:
    flight = Flight(**asked)
    flight.change(5.0, phase=FlightPhase.LANDING)
    assert flight.changes == []


def test_a_landing_with_an_empty_battery_says_so() -> None:
    flight = Flight(phase=FlightPhase.LANDING, battery=8)
    flight.fly(1.0)
    assert "the battery is nearly empty" in flight.text(N.LANDS_ITSELF)
    assert flight.manager.shown[0].name is N.LANDS_ITSELF
    assert flight.sounds is AlarmLevel.DANGER


def test_of_the_battery_only_the_strongest_is_shown() -> None:
    flight = Flight()
    for charge, name in ((24, N.BATTERY_LOW), (18, N.BATTERY_FLOOR), (9, N.BATTERY_CRITICAL)):
        flight.change(battery=charge)
        assert flight.shown == {name: S.RAISED}
        flight.see(name)
    flight.change(battery=13)  # another one begins where a stronger one has ended: it is known
    assert flight.shown == {N.BATTERY_FLOOR: S.ACKNOWLEDGED}


@pytest.mark.parametrize(
    "known",
    [
        {"phase": FlightPhase.STANDBY, "gps": 0},
        {"phase": FlightPhase.STANDBY, "battery": 9},
        {"has_authority": False, "height": 200.0},
        {"phase": FlightPhase.STANDBY, "height": 49.0},
        {"limits": GuardLimits(), "height": 200.0, "battery": 30},
    ],
)
def test_what_is_no_danger_there_is_no_alarm(known: dict[str, Any]) -> None:
    flight = Flight()
    flight.change(5.0, **known)
    assert set(flight.shown) <= {N.BATTERY_LOW}


@pytest.mark.parametrize(
    ("reason", "text"),
    [
        (LossReason.MODE_SWITCH, "The pilot took control with the mode switch"),
        (LossReason.APP, "The app on the pilot's phone took control"),
        (LossReason.LINK, "Control is lost: the link to the aircraft failed"),
        (LossReason.UNKNOWN, "Control is lost, and it is unknown who has it"),
    ],
)
def test_the_taker_of_authority_is_named_as_far_as_it_is_known(
    reason: LossReason, text: str
) -> None:
    flight = Flight(has_authority=False, loss=reason)
    assert flight.text(N.AUTHORITY_LOST) == text


@pytest.mark.parametrize(
    ("end", "text"),
    [
        (lease_lost(), "Anna took control from you. The aircraft hovers"),
        (
            LeaseChanged(0, "", LeaseChange.EXPIRED),
            "You have lost control: the station did not hear this page for too long",
        ),
        (LeaseChanged(0, "", LeaseChange.FRONT_LOST), "You have lost control"),
    ],
)
def test_the_taker_of_the_lease_is_named(end: LeaseChanged, text: str) -> None:
    assert Flight(lease_end=end, has_lease=False).text(N.LEASE_TAKEN) == text


T, E = LeaseChange.TAKEN_OVER, LeaseChange.EXPIRED


@pytest.mark.parametrize(
    ("why", "flown", "text"),
    [
        (T, Flown.NOTHING, "from you. The aircraft hovers"),
        (T, Flown.SETPOINTS, "from you. Your steering was stopped: the aircraft brakes and"),
        (T, Flown.GUIDED, "The flight to your point was stopped"),
        (T, Flown.PROGRAM, "The simple task was stopped"),
        (T, Flown.MISSION, "The station ordered the mission to stop: the aircraft brakes"),
        (T, Flown.TAKE_OFF, "The take-off goes on"),
        (T, Flown.LAND, "The landing goes on"),
        (T, Flown.GO_HOME, "The flight home goes on"),
        # Control authority goes back, which ends what the autopilot flies, or it does not.
        (E, Flown.TAKE_OFF, "It was taking off: check whether it goes on"),
        (E, Flown.LAND, "It was landing: check whether"),
        (E, Flown.GO_HOME, "It was going home: check whether"),
        (E, Flown.MISSION, "for too long. The station ordered the mission"),
    ],
)
def test_what_the_end_of_a_lease_stopped_is_said(why: LeaseChange, flown: Flown, text: str) -> None:
    end = LeaseChanged(0 if why is E else 7, "" if why is E else "Anna", why, flown)
    flight = Flight(lease_end=end, has_lease=False, phase=FlightPhase.IN_AIR)
    assert text in flight.text(N.LEASE_TAKEN)


def test_an_aircraft_that_stands_or_that_the_pilot_has_does_not_hover() -> None:
    taken = Flight(lease_end=lease_lost(), has_lease=False, phase=FlightPhase.STANDBY)
    assert taken.text(N.LEASE_TAKEN) == "Anna took control from you"
    expired = LeaseChanged(0, "", LeaseChange.EXPIRED)
    lost = Flight(lease_end=expired, has_lease=False, phase=FlightPhase.IN_AIR)
    assert "hovers" not in lost.text(N.LEASE_TAKEN)


def test_what_only_happens_is_over_when_it_was_seen_and_begins_again() -> None:
    flight = Flight(aborted=3, aborted_why="wind")
    flight.see(N.MISSION_ABORTED)
    flight.fly(5.0)
    assert flight.shown == {}
    flight.change(aborted=9, aborted_why="battery")
    assert flight.text(N.MISSION_ABORTED) == "Mission broken off: battery"
    assert flight.shown == {N.MISSION_ABORTED: S.RAISED}


def test_a_later_client_does_not_hear_what_happened_before() -> None:
    manager = AlarmManager()
    assert manager.advance(replace(FINE, aborted=3)) == []
    assert manager.shown == ()


def test_what_is_so_when_somebody_comes_is_reported() -> None:
    manager = AlarmManager()
    assert [change.name for change in manager.advance(replace(FINE, battery=9))] == [
        N.BATTERY_CRITICAL,
        N.BATTERY_FLOOR,
        N.BATTERY_LOW,
    ]


def test_both_limits_are_watched_and_the_nearer_is_said() -> None:
    flight = Flight(height=46.0, distance=148.0)
    assert flight.text(N.GUARD_NEAR) == "Near the limit: distance 148 m of 150 m"
    assert "height" in Flight(height=49.0, distance=140.0).text(N.GUARD_NEAR), "98 and 93 percent"


def definitions() -> Iterator[tuple[AlarmName, bool, bool]]:
    for one in ALARMS:
        yield one.name, one.judge is not None, one.mark is not None


def test_the_alarms_stand_in_the_order_of_urgency_and_each_has_one_way_to_begin() -> None:
    assert [name for name, _, _ in definitions()] == list(AlarmName)
    assert all(judged is not marked for _, judged, marked in definitions())
    levels = [one.level for one in ALARMS]
    assert levels == sorted(levels, key=[AlarmLevel.DANGER, AlarmLevel.WARNING].index)
