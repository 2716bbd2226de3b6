"""The last minutes of every number: what is kept, what is a gap, and how it is downloaded."""

from __future__ import annotations

import math

import anyio
import pytest

from m100link.apps.agent.messages import State
from m100link.apps.station.console.history import COLUMNS, INTERVAL, KEPT_S, History
from m100link.protocol.records import Position
from tests.apps.station.conftest import Rig

pytestmark = pytest.mark.anyio

STATE = State(at=0.0, round_trip=0.02, discards=3, late_acks=1)
HEIGHT = "position.height_m"


async def test_rows_are_taken_ten_times_a_second_and_a_stalled_line_is_a_gap(rig: Rig) -> None:
    history = History()
    rig.front.background.spawn(history.keep(rig.front), "history")
    await anyio.sleep(5.0)
    assert history.count == pytest.approx(5.0 / INTERVAL, abs=1)
    assert rig.front.telemetry is not None
    position = rig.front.telemetry.get(Position)
    assert position is not None
    rows = history.rows([HEIGHT, "line.packages_per_s"])
    assert rows[-1][1] == pytest.approx(position.height_m, abs=0.5)
    assert rows[-1][2] == pytest.approx(100.0, abs=5.0)
    assert rows[-1][0] - rows[0][0] == pytest.approx(5.0, abs=0.3)
    rig.aircraft.stall_line()
    await anyio.sleep(3.0)
    assert math.isnan(history.rows([HEIGHT])[-1][1])


def test_the_oldest_rows_go() -> None:
    history = History()
    size = round(KEPT_S / INTERVAL)
    for number in range(size + 50):
        history.add(float(number), None, STATE)
    rows = history.rows(["line.front_lag_ms"])
    assert len(rows) == size
    assert rows[0][0] == 50.0
    assert rows[-1][0] == size + 49.0


def test_without_an_aircraft_nothing_has_a_value() -> None:
    history = History()
    history.add(1.0, None, STATE)
    ((_, *values),) = history.rows(COLUMNS[:-1])
    assert all(math.isnan(value) for value in values)


@pytest.mark.parametrize("begin", [0, 3, 7])
def test_a_window_that_moves_on_keeps_its_points(begin: int) -> None:
    history = History()
    for number in range(100):
        history.add(float(number), None, STATE)
    before = [row[0] for row in history.rows([], last_s=5.0, step=10)]
    for number in range(begin):
        history.add(100.0 + number, None, STATE)
    after = [row[0] for row in history.rows([], last_s=5.0, step=10)]
    assert before == [50.0, 60.0, 70.0, 80.0, 90.0]
    assert set(after) - set(before) <= {100.0}


def test_what_was_seen_does_not_come_again_and_a_pause_hides_what_came_later() -> None:
    history = History()
    for number in range(20):
        history.add(float(number), None, STATE)
    assert [row[0] for row in history.rows([], since=18)] == [18.0, 19.0]
    assert [row[0] for row in history.rows([], until=10, last_s=0.3)] == [7.0, 8.0, 9.0]


def test_a_download_has_a_line_for_each_row_and_nothing_where_there_was_no_value() -> None:
    history = History()
    history.lag = 0.0125
    for number in range(3):
        history.add(1e9 + number / 10, None, STATE)
    text = history.csv([HEIGHT, "line.front_lag_ms"], until=2)
    assert text.splitlines() == [
        "utc,position.height_m,line.front_lag_ms",
        "2001-09-09T01:46:40.000Z,,12.5",
        "2001-09-09T01:46:40.100Z,,12.5",
    ]
