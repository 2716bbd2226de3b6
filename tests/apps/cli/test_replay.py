"""``m100link replay``: names, keys, and a station that shows a flight and gives no control."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from m100link.apps.agent.messages import Replay
from m100link.apps.agent.orders import OrderReplay
from m100link.apps.cli import serve
from m100link.apps.cli.serve import KEYS, _names, _order
from m100link.errors import UsageError
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


@pytest.mark.anyio
async def test_keys_are_orders_that_a_replay_knows(capsys: pytest.CaptureFixture[str]) -> None:
    class Replays:
        def progress(self) -> None:
            return None

    class Agent:
        def __init__(self) -> None:
            self.orders: list[str] = []
            self.replay = Replays()

        async def ask(self, order: OrderReplay) -> None:
            self.orders.append(order.text)
            if order.text == "seek 0":
                raise UsageError("it does not play")

    class Station:
        agent = Agent()

    for order in KEYS.values():
        await _order(Station, order)
    assert Station.agent.orders == list(KEYS.values())
    assert "it does not play" in capsys.readouterr().err


def test_each_key_does_what_its_line_of_help_says() -> None:
    """Space pauses; left is back. Arrows are 10 s, < and > a minute."""
    assert KEYS == {
        " ": "toggle",
        "LEFT": "by -10",
        "RIGHT": "by 10",
        "<": "by -60",
        ">": "by 60",
        "+": "faster",
        "-": "slower",
        "1": "speed 1",
        "m": "speed max",
        "0": "seek 0",
    }


@pytest.mark.anyio
@pytest.mark.parametrize("count", [1, 2, 3])
@pytest.mark.parametrize(
    ("where", "told"),
    [
        ({}, "1:05 of 10:00, 2 ×"),
        ({"position_s": 59.9, "speed": 0.25}, "0:59 of 10:00, 0.25 ×"),
        ({"speed": 0.0}, "1:05 of 10:00, max"),
        ({"is_paused": True}, "1:05 of 10:00, paused"),
        ({"position_s": 600.0, "is_at_end": True}, "10:00 of 10:00, at its end"),
    ],
)
async def test_a_key_is_an_order_to_every_replay_and_is_told_where_the_first_one_is(
    capsys: pytest.CaptureFixture[str], count: int, where: dict[str, Any], told: str
) -> None:
    """Flights that are compared stand still together."""
    asked: list[tuple[int, str]] = []

    def agent(number: int) -> Any:
        async def ask(order: OrderReplay) -> None:
            asked.append((number, order.text))

        flags = {"is_paused": False, "is_at_end": False, "is_cut_off": False}
        values = {"position_s": 65.0, "duration_s": 600.0, "speed": 2.0} | where
        values = values if number == 0 else {**values, "position_s": 300.0}
        replay = Replay("a.mcap", 1.0, 0.0, 0.0, None, **(flags | values))
        return SimpleNamespace(ask=ask, state=SimpleNamespace(replay=replay))

    agents = {f"flight_{number}": agent(number) for number in range(count)}
    await _order(SimpleNamespace(agents=agents), "toggle")
    assert asked == [(number, "toggle") for number in range(count)]
    assert capsys.readouterr().err == told + "\n"


@pytest.mark.anyio
async def test_a_replay_that_refuses_a_key_keeps_it_from_no_other(
    capsys: pytest.CaptureFixture[str],
) -> None:
    asked: list[str] = []

    async def refuse(_: OrderReplay) -> None:
        raise UsageError("nothing is played yet")

    async def take(order: OrderReplay) -> None:
        asked.append(order.text)

    agents = {"left": SimpleNamespace(ask=refuse), "right": SimpleNamespace(ask=take)}
    await _order(SimpleNamespace(agents=agents), "toggle")
    assert asked == ["toggle"]
    assert capsys.readouterr().err == "nothing is played yet\n"
