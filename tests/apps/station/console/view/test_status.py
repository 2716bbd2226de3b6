"""The status line: every cause, every pair of causes, and nothing that cannot be known."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations, product
from typing import Any

import pytest

from m100link.apps.agent.messages import State
from m100link.apps.agent.remote_error import Fault
from m100link.apps.station.console.view.catalogue import CATALOGUE
from m100link.apps.station.console.view.inputs import Inputs
from m100link.apps.station.console.view.situation import Hearing, Level, Situation
from m100link.apps.station.console.view.status import RULES, Cause, activation_of, status_line
from m100link.apps.station.console.view.words import Speaker
from m100link.protocol.codes import ActivationCode
from m100link.protocol.records import Device, RcMode

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
    C.KEPT: {"has_authority": True},
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
        (C.OTHER, C.KEPT),
        *product((C.OTHER, C.KEPT, C.MISSION, C.YOURS), (C.RC, C.TAKEN, C.NO_AUTHORITY)),
        *product((C.OTHER, C.KEPT), (C.MISSION, C.YOURS)),
    )
}


# The lease without authority, while the aircraft names the remote controller.
MAKE_A_THIRD = {(C.TAKEN, C.FREE_RC): C.RC, (C.NO_AUTHORITY, C.FREE_RC): C.RC}


@pytest.mark.parametrize("cause", Cause)
def test_each_cause_alone_is_told(cause: Cause) -> None:
    assert status_line(replace(FREE, **ALONE[cause])).cause is cause


@pytest.mark.parametrize(
    ("first", "second"),
    [pair for pair in combinations(Cause, 2) if frozenset(pair) not in NO_PAIR],
    ids=lambda cause: cause.value,
)
def test_of_two_causes_the_one_that_comes_first_is_told(first: Cause, second: Cause) -> None:
    both = replace(FREE, **{**ALONE[second], **ALONE[first]})
    assert {first, second} <= {rule.cause for rule in RULES if rule.holds(both)}
    told = status_line(both).cause
    assert told is MAKE_A_THIRD.get((first, second), first)


def test_the_rules_stand_in_the_order_of_the_causes_and_the_last_always_holds() -> None:
    assert [rule.cause for rule in RULES] == list(Cause)
    assert RULES[-1].holds(Situation())


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
    if now.has_authority:
        return C.KEPT
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
    for text in CATALOGUE[f"status.{cause.value}"]:
        assert "ilot" not in text


def test_a_silence_is_counted_from_when_something_was_heard_last() -> None:
    assert status_line(replace(FREE, telemetry_at=97.5)).since == 97.5
    assert status_line(replace(FREE, hearing=Hearing.SILENT, heard_at=96.0)).since == 96.0
    assert status_line(replace(FREE, connection="lost")).since is None
    assert status_line(FREE).since is None


def test_names_and_reasons_are_said() -> None:
    english = Speaker()

    def said(**known: Any) -> str:
        return english(status_line(replace(FREE, **known)).text)

    assert said(holder="Anna") == "Anna has control"
    assert said(switch=RcMode.A) == "The pilot flies: mode switch in A"
    assert said(connection="lost", fault="the port is gone") == (
        "The line to the aircraft is lost: the port is gone"
    )
    assert said(connection="lost") == "The line to the aircraft is lost"


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
    assert Speaker()(flies) == text


def test_nothing_flies_when_nothing_is_known_to() -> None:
    assert status_line(FREE).flies is None


@pytest.mark.parametrize("cause", Cause)
def test_every_cause_has_words_a_level_and_says_what_to_do(cause: Cause) -> None:
    line = status_line(replace(FREE, **ALONE[cause]))
    for speaker in (Speaker(),):
        assert speaker(line.text)
        assert line.remedy is None or speaker(line.remedy)
    assert (line.remedy is None) == (cause in (C.PENDING, C.GIVING_BACK, C.YOURS))
    assert line.level is not Level.GOOD or cause in (C.YOURS, C.MISSION)


def test_a_virtual_aircraft_is_said_to_be_one_whatever_else_is_told() -> None:
    assert status_line(replace(FREE, is_virtual=True, connection="lost")).is_virtual
    assert not status_line(FREE).is_virtual


@pytest.mark.parametrize(
    ("state", "text"),
    [
        (State(at=0.0), "Activation: not done"),
        (State(at=0.0, is_activated=True), "Activation: active"),
        (
            State(at=0.0, activation_code=ActivationCode.NEW_DEVICE),
            f"Activation: {ActivationCode.NEW_DEVICE.meaning}",
        ),
        (
            State(at=0.0, is_activated=True, activation_fault=Fault("LinkError", "no answer")),
            "Activation: no answer",
        ),
    ],
)
def test_how_far_activation_is(state: State, text: str) -> None:
    assert Speaker()(activation_of(Inputs(state=state))) == text
