"""What commands show and refuse, as values in and words out: without a process, without real time.

Times are seconds inside the library and milliseconds where the title of a column says so.
"""

from __future__ import annotations

import io
import sys
import time
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from types import SimpleNamespace
from typing import Any

import pytest
from rich.console import Console
from rich.table import Table

from m100link import GuardRefused, UsageError
from m100link.apps.cli import flight, telemetry
from m100link.flight.mission_state import MissionKind
from m100link.protocol import Battery
from m100link.protocol.items import BY_RECORD
from m100link.sim import VirtualClockEventLoop
from m100link.telemetry.state import ItemStatistics
from tests.apps.cli.conftest import CommandLine
from tests.rig import rig

pytestmark = pytest.mark.anyio


@pytest.fixture
def anyio_backend() -> object:
    return "asyncio", {"loop_factory": VirtualClockEventLoop}


# -- tables ---------------------------------------------------------------------------------------


def rows(table: Table) -> dict[str, list[str]]:
    """Cells of each row behind its first one, as they are printed; the caption by its last line."""
    written = io.StringIO()
    Console(file=written, width=200).print(table)
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
    monkeypatch.setattr(telemetry, "out", Console(width=200, file=io.StringIO()))


@pytest.mark.usefixtures("wide")
def test_hz_shows_milliseconds_and_parts_in_a_million() -> None:
    shown = rows(telemetry._rates_table(measured()))
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
    for line in cli("echo", "sim://", "position", "--json", "--count", "3").objects:
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

        @asynccontextmanager
        async def connect() -> AsyncIterator[Any]:
            yield flown.aircraft

        place = SimpleNamespace(connect=connect)
        link: Any = SimpleNamespace(place_among=lambda words, is_one: (place, words))
        await flight.rates("attitude=10", "battery=1", "rc=0", link=link, json=True)
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
