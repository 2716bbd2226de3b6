"""Pictures of braille characters."""

from __future__ import annotations

import io
import math
from collections.abc import Callable
from pathlib import Path

import pytest
from rich.console import Console
from rich.progress import Progress

from m100link.apps.cli import display as progress
from m100link.apps.cli.display import items_named, line_plot, row, track_plot
from m100link.errors import UsageError
from m100link.protocol.items import BY_NAME, ITEMS, Item
from m100link.protocol.records import Attitude, Battery, FlightStatus, Position, RemoteControl
from m100link.telemetry.columns import columns_of
from tests.apps.cli.conftest import CommandLine


def dots(lines: list[str], columns: int) -> set[tuple[int, int]]:
    """The dots that are set, from the top left, by the Unicode standard's numbering."""
    places = [(0, 0), (0, 1), (0, 2), (1, 0), (1, 1), (1, 2), (0, 3), (1, 3)]
    return {
        (2 * x + dx, 4 * y + dy)
        for y, line in enumerate(lines)
        for x, character in enumerate(line[-columns:])
        for bit, (dx, dy) in enumerate(places)
        if ord(character) - 0x2800 & 1 << bit
    }


def test_a_track_has_north_at_the_top_and_east_at_the_right() -> None:
    *picture, caption = track_plot([(0.0, 0.0), (10.0, 0.0)], columns=10, rows=5)
    north = dots(picture, 10)
    assert {x for x, _ in north} == {10}  # of 20, in the middle
    assert {y for _, y in north} == set(range(1, 18))  # of 20
    assert caption == "north up; 10.0 m north to south, 1.0 m east to west"
    *picture, caption = track_plot([(0.0, 0.0), (0.0, 10.0)], columns=10, rows=5)
    east = dots(picture, 10)
    assert {y for _, y in east} == {9}
    assert {x for x, _ in east} == set(range(2, 19))
    assert caption == "north up; 1.0 m north to south, 10.0 m east to west"


def test_both_axes_of_a_track_have_one_scale() -> None:
    square = [(0.0, 0.0), (8.0, 0.0), (8.0, 8.0), (0.0, 8.0), (0.0, 0.0)]
    drawn = dots(track_plot(square, columns=40, rows=10)[:-1], 40)
    width = max(x for x, _ in drawn) - min(x for x, _ in drawn)
    height = max(y for _, y in drawn) - min(y for _, y in drawn)
    assert width == pytest.approx(height, abs=1)


def test_a_value_over_time_rises_to_the_right_and_is_labelled() -> None:
    *picture, scale = line_plot([(5.0, 1.0), (7.0, 3.0)], unit="m", columns=10, rows=4)
    drawn = dots(picture, 10)
    assert (0, 15) in drawn
    assert (19, 0) in drawn
    assert picture[0].startswith("3.00 ┤")
    assert picture[-1].startswith("1.00 ┤")
    assert scale.split() == ["m", "0", "2.0", "s"]
    assert len(scale) == len(picture[0])


@pytest.mark.parametrize("plot", [track_plot, line_plot])
def test_nothing_and_one_point_are_pictures_too(plot: Callable[..., list[str]]) -> None:
    assert dots(plot([], columns=5, rows=3), 5) == set()
    assert plot([(1.0, 1.0)], columns=5, rows=3)


def test_names_stand_where_there_is_room_for_them() -> None:
    row = [(0.0, 0.0), (0.0, 1.0), (0.0, 100.0)]
    *picture, _ = track_plot(row, columns=12, rows=3, names=["0", "1", "12"])
    [line] = [line for line in picture if "0" in line]
    assert line.strip("\u2800")[0] == "0"
    assert line.strip("\u2800")[-2:] == "12"
    assert "1" not in line[:-3]
    canvas = progress._Canvas(6, 2)
    canvas.write(0, 7, "t")
    canvas.write(4, 0, "b")
    canvas.write(0, 0, "aa")  # it would stand right beside
    assert [line.replace("\u2800", ".") for line in canvas.lines()] == ["t.....", "..b..."]


# -- telemetry records as rows of named numbers ----------------------------------------------------


def test_a_row_has_the_fields_and_their_views_in_the_units_of_the_api() -> None:
    values = row(Position(math.radians(10.0), math.radians(20.0), 300.0, 12.5, 5))
    assert values["position.latitude_deg"] == pytest.approx(10.0)
    assert values["position.longitude_deg"] == pytest.approx(20.0)
    assert values["position.height_m"] == 12.5
    assert values["position.gps_health"] == 5


def test_an_enumeration_is_shown_by_its_name_and_an_unknown_value_by_none() -> None:
    assert row(RemoteControl(0, 0, 0, 0, 8000, -4545))["rc.mode_switch"] == "F"
    assert row(FlightStatus(3))["flight_status.phase"] == "IN_AIR"
    assert row(FlightStatus(77))["flight_status.phase"] is None


@pytest.mark.parametrize("item", ITEMS, ids=lambda item: item.name)
def test_the_columns_are_announced_as_they_come(item: Item) -> None:
    ones = item.record(*[1] * len(item.record._fields))
    assert columns_of([item.record]) == list(row(ones))


def test_items_are_found_by_name_in_the_order_asked_for() -> None:
    assert items_named(["battery", "position"]) == [Battery, Position]
    assert items_named([]) == [item.record for item in ITEMS]


def test_a_name_that_is_not_an_item_lists_those_that_are() -> None:
    with pytest.raises(UsageError, match="altitude") as caught:
        items_named(["battery", "altitude"])
    assert all(name in caught.value.remedy for name in BY_NAME)
    with pytest.raises(UsageError) as caught:
        items_named(["Positon"])
    assert caught.value.remedy.startswith("did you mean position")


def test_items_are_found_by_the_names_of_the_state_and_of_the_document() -> None:
    assert items_named(["attitude", "Q", "remote_control", "POS"]) == [
        *(Attitude, Attitude, RemoteControl, Position)
    ]


# -- how far a log is read: shown on a terminal after a second, and nowhere else -------------------


@pytest.fixture
def flight(cli: CommandLine, tmp_path: Path) -> Path:
    pytest.importorskip("mcap", reason="the extra `log` is not installed")
    path = tmp_path / "flight.mcap"
    cli("record", "sim://", "-o", str(path), "--duration", "0.5")
    return path


def shown(flight: Path, monkeypatch: pytest.MonkeyPatch, *, terminal: bool) -> tuple[int, str]:
    stream = io.StringIO()
    console = Console(file=stream, force_terminal=terminal, width=60)
    monkeypatch.setattr(progress, "err", console)
    with progress.reading(flight) as log:
        count = sum(1 for _ in log.messages())
    return count, stream.getvalue()


def test_a_pipe_hears_nothing(flight: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(progress, "_PATIENCE_S", 0.0)
    assert shown(flight, monkeypatch, terminal=False)[1] == ""


def test_a_terminal_shows_it_after_a_second(flight: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert shown(flight, monkeypatch, terminal=True)[1] == ""
    monkeypatch.setattr(progress, "_PATIENCE_S", 0.0)
    count, told = shown(flight, monkeypatch, terminal=True)
    assert "reading" in told
    assert count > 10


def test_one_that_was_cut_off_is_read_without_an_end(
    flight: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(progress, "_PATIENCE_S", 0.0)
    flight.write_bytes(flight.read_bytes()[:-400])
    assert "reading" in shown(flight, monkeypatch, terminal=True)[1]


def test_each_reading_of_a_file_is_shown_from_its_beginning(flight: Path) -> None:
    bar, size = Progress(console=Console(file=io.StringIO(), force_terminal=True)), 0
    log = progress._Watched(flight, bar)
    for _ in range(2):
        for _message in log.messages():
            break
        assert sum(1 for _ in log.messages()) > 10
        [task] = bar.tasks
        size = flight.stat().st_size
        assert 0.9 * size < task.completed <= size
        assert task.total == size
