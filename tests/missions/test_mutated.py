"""Files that were broken by chance: a plan that can be flown, or a BadPlan, and nothing else."""

from __future__ import annotations

import copy
import json
from collections.abc import Iterator
from dataclasses import replace
from random import Random
from typing import Any

import pytest

from m100link import (
    PROFILES,
    AtEnd,
    BadPlan,
    GimbalPitch,
    Heading,
    StartVideo,
    Stay,
    TakePhoto,
    TurnTo,
    Waypoint,
    WaypointPlan,
)
from tests.missions import qgroundcontrol as qgc

PLAN = WaypointPlan(
    [
        Waypoint(52.1, 4.31, 20.0),
        Waypoint(52.1009, 4.31, 35.0, heading_deg=9, actions=[Stay(2), GimbalPitch(-6), TurnTo(5)]),
        Waypoint(52.1009, 4.3113, 20.0, actions=[TakePhoto(), StartVideo()], action_repeat=3),
    ],
    heading=Heading.BY_WAYPOINT,
    at_end=AtEnd.GO_HOME,
)
DRAWN = qgc.file(
    qgc.item(22, 0, 0, 0, None, *qgc.HOME[:2], 20, frame=3),
    qgc.item(178, 1, 4, -1),
    qgc.survey(qgc.waypoint(10), qgc.item(206, 20, 0, 1), qgc.waypoint(99), qgc.item(206)),
    qgc.waypoint(50, yaw=350, hold=1),
    qgc.item(205, -45, 0, 0, 0, 0, 0, 2),
    qgc.item(20),
)
DOCUMENTS = [json.loads(PLAN.to_json()), json.loads(PLAN.to_qgroundcontrol()), DRAWN]
ODD: list[Any] = [None, True, False, 0, -1, 1, 2, 3.0, 1e308, -1e308, 1e-320, 10**300, 16, 22, 206]
ODD += [float("nan"), float("inf"), "", "x", "1", "\ud800", "\0", [], {}, [[]], [None] * 7, [0] * 7]
ODD += [{"stay": 1}, {"a": {"b": 1}}, 180.0, -180, 90.5, 65535]
NAMES = ["x", "stay", "command", "fileType", "format", "m100link", "_"]


def places(value: Any, before: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    if before:
        yield before
    if isinstance(value, dict | list):
        for key in value if isinstance(value, dict) else range(len(value)):
            yield from places(value[key], (*before, key))


def change(document: Any, random: Random) -> None:
    """One value replaced, renamed, doubled, taken away or scaled."""
    *way, key = random.choice(list(places(document)))
    holder = document
    for step in way:
        holder = holder[step]
    how = random.random()
    is_number = isinstance(holder[key], int | float) and not isinstance(holder[key], bool)
    if how < 0.3 and is_number:
        holder[key] *= random.choice((-1, 0, 2, 10, 1.0001, 1e6))
    elif how < 0.7:
        holder[key] = copy.deepcopy(random.choice(ODD))
    elif how < 0.85:
        del holder[key]
    elif isinstance(holder, dict):
        holder[random.choice(NAMES)] = holder.pop(key)
    else:
        holder.insert(key, copy.deepcopy(holder[key]))


def broken(text: bytes, random: Random) -> bytes:
    """Some bytes changed, taken away or put in."""
    found = bytearray(text)
    for _ in range(random.choice((1, 2, 5))):
        at = random.randrange(len(found))
        piece = random.choice((b"{", b"[", b'"', b"null,", b"NaN", b"1e999", b"-", b"\xff", b""))
        found[at : at + random.choice((0, 1, 20))] = piece
        found = found or bytearray(b" ")
    return bytes(found)


@pytest.mark.parametrize("seed", range(6))
def test_only_plans_and_their_errors_come_out(seed: int) -> None:
    random = Random(seed)
    profile = PROFILES["3.1"]
    flown = refused = 0
    told: list[str] = []
    for _ in range(150):
        document = copy.deepcopy(random.choice(DOCUMENTS))
        for _ in range(random.choice((0, 1, 1, 2, 4))):
            change(document, random)
        text = json.dumps(document).encode()
        if random.random() < 0.25:
            text = broken(text, random)
        try:
            plan = WaypointPlan.parse(text, leave_out=random.choice(([], [206], ["survey"])))
        except BadPlan as error:
            refused += 1
            told += [str(one) for one in error.problems]
            continue
        flown += 1
        mission, points = plan.to_wire()
        assert [command.value(profile) for command in (mission, *points)]
        assert WaypointPlan.from_wire(mission, points) == replace(plan, take_off=False)
        assert WaypointPlan.parse(plan.to_json()) == plan
        assert WaypointPlan.parse(plan.to_qgroundcontrol()) == plan
        assert str(plan.estimate(home=(52.0, 4.0)))
        assert isinstance(plan.remarks(), list)
    assert flown > 15
    assert refused > 50
    assert all(told)
