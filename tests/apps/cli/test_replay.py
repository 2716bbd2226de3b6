"""``m100link replay``: names, and a station that shows a flight and gives no control."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from m100link.apps.cli import serve
from m100link.apps.cli.serve import _names
from tests.apps.cli.conftest import CommandLine


def test_each_file_has_a_name_of_its_own() -> None:
    files = ("a/flight.mcap", "b/flight.mcap", "2026 01.mcap", "a-b.mcap", "a_b.mcap", "ö.mcap")
    names = _names(tuple(map(Path, files)))
    assert names == ["flight", "flight_2", "flight_2026_01", "a_b", "a_b_2", "flight_3"]


def test_what_cannot_be_played_is_reported_before_anything_is_served(
    cli: CommandLine, tmp_path: Path
) -> None:
    for arguments, why in (
        ((), "no flight log was named"),
        ((str(tmp_path / "none.mcap"),), "No such file"),
        ((str(tmp_path),), "Is a directory"),
        ((str(tmp_path / "none.mcap"), "--speed", "0"), "speed"),
        ((str(tmp_path / "none.mcap"), "--from", "5", "--until", "2"), "before it begins"),
        ((str(tmp_path / "none.mcap"), "--max-height", "5"), "Unknown option"),  # nothing flies
    ):
        ports = ("--port", "0", "--console-port", "0", "--no-open-browser")
        outcome = cli("replay", *arguments, *ports)
        assert outcome.status == 2, outcome
        assert why in outcome.err.replace("\n", " ")


def test_a_recorded_flight_is_not_shown_beside_an_aircraft_that_flies(
    cli: CommandLine, tmp_path: Path
) -> None:
    url = f"replay://{tmp_path / 'flight.mcap'}"
    outcome = cli("serve", url, "sim://", "--port", "0")
    assert outcome.status == 2
    assert "beside aircraft that fly" in outcome.err.replace("\n", " ")


@pytest.mark.parametrize(
    ("options", "is_asked_for"),
    [
        ((), False),
        (("--console-port", "0", "--foxglove", "0"), False),
        (("--port", "0"), True),
        (("--also-port", "0"), True),
        (("--pages", "."), True),
        (("--metrics", "0"), True),
    ],
)
def test_rosbridge_opens_only_for_an_option_of_the_command(
    cli: CommandLine,
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    options: tuple[str, ...],
    is_asked_for: bool,
) -> None:
    served: list[dict[str, Any]] = []

    async def run_station(*_: object, **how: Any) -> int:
        served.append(how)
        return 0

    monkeypatch.setattr(serve, "run_station", run_station)
    monkeypatch.setenv("M100LINK_PORT", "9091")  # for flights
    assert cli("replay", str(tmp_path / "flight.mcap"), *options).status == 0
    assert [how["with_rosbridge"] for how in served] == [is_asked_for]
