"""Orders by name: for ctl, keys and scenario files."""

from __future__ import annotations

import asyncio
import io
import json
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console

from m100link.apps.cli.sim import KEYS, LiveView
from m100link.apps.cli.terminal import read_keys
from m100link.errors import M100Error, UsageError
from m100link.protocol import Setpoint
from m100link.protocol.commands.hotpoint import FollowStart
from m100link.sim import LineFaults, VirtualAircraft
from m100link.sim.orders import (
    ACTIONS,
    CtlServer,
    NoSimulator,
    Scenario,
    SimulatorOrders,
    find_sockets,
    orders_by_socket,
    orders_in_process,
    perform,
    send_order,
    status,
)
from tests.sim.host import Host
from tests.sim.vehicle.missions.flights import begin, hotpoint, point
from tests.sim.vehicle.missions.flights import host as mission_host


def done(order: str) -> VirtualAircraft:
    """A flying aircraft after an order."""
    host = Host().flying()
    perform(host.aircraft, order)
    host.wait(0.1)
    return host.aircraft


@pytest.mark.parametrize(
    ("order", "see"),
    [
        ("status", lambda a: status(a)["flight_status"] == "in_air"),
        ("rc-mode A", lambda a: a.remote.mode.name == "A"),
        ("rc-mode p", lambda a: status(a)["control"] == "rc"),
        ("leave-f", lambda a: status(a)["authority_obstacle"] == "the mode switch is not in F"),
        ("stick pitch=0.5 yaw=-0.25", lambda a: (a.remote.pitch, a.remote.yaw) == (0.5, -0.25)),
        ("rc-off", lambda a: not a.remote.is_connected),
        ("land", lambda a: status(a)["flight_status"] == "landing"),
        ("app internet=off", lambda a: a.app.is_connected and not a.app.has_internet),
        ("no-app", lambda a: not a.app.is_connected),
        ("app-takes-control", lambda a: status(a)["control"] == "app"),
        ("message hello there", lambda a: not a.autopilot._from_mobile),
        ("message hex=00ff", lambda a: not a.autopilot._from_mobile),
        ("server-refuses", lambda a: a.server.is_refusing),
        ("server-refuses off", lambda a: not a.server.is_refusing),
        (f"key {'ab' * 32}", lambda a: a.server.apps[10086].key.reveal() == b"\xab" * 32),
        ("api off", lambda a: not a.vehicle.assistant.api_control_enabled),
        ("ioc on", lambda a: a.vehicle.assistant.ioc_on),
        ("rates battery=10 rc=0", lambda a: a.autopilot.rates_hz["battery"] == 10),
        ("gps 2", lambda a: a.gps_health == 2),
        ("battery 33.5", lambda a: 33.0 < a.battery_percent <= 33.5),
        ("wind 3 -2", lambda a: a.vehicle.flight.dynamics.wind_east == -2.0),
        ("reboot", lambda a: a.vehicle.is_restarting),
        ("faults loss=0.1 delay=0.02", lambda a: a.line.to_host.faults.loss == 0.1),
        ("faults radio", lambda a: a.line.to_aircraft.faults.radio),
        ("faults baud-rate=9600", lambda a: a.line.to_host.faults.baud_rate == 9600),
        ("no-faults", lambda a: a.line.to_host.faults == LineFaults()),
        ("stall", lambda a: a.line.to_host.is_stalled),
        ("stall off", lambda a: not a.line.to_host.is_stalled),
        ("unplug", lambda a: not a.line.is_plugged),
        ("replug", lambda a: a.line.is_plugged),
    ],
)
def test_each_order_does_what_it_says(order: str, see: Any) -> None:
    assert see(done(order))


def test_orders_that_undo_others() -> None:
    aircraft = VirtualAircraft()
    for order in ("leave-f", "return-to-f", "rc-off", "rc-on", "stick roll=1", "release-sticks"):
        perform(aircraft, order)
    for order in ("app-takes-control", "app-releases-control", "take-off"):
        perform(aircraft, order)
    assert status(aircraft)["rc_mode"] == "F"
    assert not aircraft.remote.sticks().are_moved
    assert status(aircraft)["flight_status"] == "taking_off"


def test_faults_add_up_until_they_are_cleared() -> None:
    aircraft = VirtualAircraft()
    perform(aircraft, "faults loss=0.1")
    perform(aircraft, "faults delay=0.05")
    assert aircraft.line.to_host.faults == LineFaults(loss=0.1, delay=0.05)


@pytest.mark.parametrize(
    ("order", "why"),
    [
        ("", "an order needs a word"),
        ("fly-away", "no action called 'fly-away'"),
        ("rc-mode", "no position ''"),
        ("rc-mode Q", "no position 'Q'"),
        ("stick", "nothing is no stick"),
        ("stick roll=2", "2.0 lies outside -1"),
        ("stick rudder=1", "rudder is no stick"),
        ("gps 9", "0 to 5, not 9"),
        ("gps x", "'x' is not a number"),
        ("gps", "a number is missing"),
        ("battery 120", "0 to 100 percent, not 120"),
        ("rates battery=7", "cannot be sent at 7 Hz"),
        ("rates fuel=1", "no telemetry item is called 'fuel'"),
        ("faults bite=1", "no fault is called 'bite'"),
        ("faults loss=2", "0 to 1, not 2"),
        ("wind 3", "a number is missing"),
        ("wind 3 nan", "wind_east is finite, not nan"),
        ("key 123", "64 hex digits are needed"),
        ("message hex=zz", "message: non-hexadecimal"),
        ("api maybe", "neither on nor off"),
    ],
)
def test_orders_that_cannot_be_carried_out_say_why(order: str, why: str) -> None:
    with pytest.raises(UsageError, match=why):
        perform(VirtualAircraft(), order)


def test_the_app_cannot_take_control_out_of_f() -> None:
    aircraft = VirtualAircraft()
    aircraft.leave_f()
    with pytest.raises(UsageError, match="cannot take control"):
        perform(aircraft, "app-takes-control")


def test_every_action_has_help_and_status_is_json() -> None:
    assert all(action.help and action.name == name for name, action in ACTIONS.items())
    assert json.loads(json.dumps(status(VirtualAircraft())))["firmware"] == "1.0"


# --- scenario files -------------------------------------------------------------------------


def scenario(tmp_path: Path, text: str) -> Scenario:
    path = tmp_path / "scenario.toml"
    path.write_text(text)
    return Scenario.read(path)


def test_a_scenario_happens_at_its_times(tmp_path: Path) -> None:
    played = scenario(
        tmp_path,
        '[[step]]\nat = 12.0\ndo = "rc-mode P"\n[[step]]\nat = 3\ndo = ["gps 2", "battery 50"]\n',
    )
    host = Host()
    seen = []
    while host.now < 13.0:
        host.wait(0.1)
        seen += [
            (step.at, step.order, round(host.now, 1)) for step in played.advance(host.aircraft)
        ]
    assert seen == [(3.0, "gps 2", 3.0), (3.0, "battery 50", 3.0), (12.0, "rc-mode P", 12.0)]
    assert host.aircraft.remote.mode.name == "P"


def test_steps_that_wait_for_a_waypoint(tmp_path: Path) -> None:
    played = scenario(
        tmp_path,
        """
        [[step]]
        when = "waypoint 1"
        do = ["wind 1 0", "battery 77"]
        [[step]]
        when = "waypoint 1"
        after = 2.5
        do = "stick yaw=0.1"
        [[step]]
        when = "waypoint 7"
        do = "reboot"
        [[step]]
        at = 5
        do = "status"
        """,
    )
    program = mission_host()
    begin(program, [point(index, 20.0 * index, 0, 10) for index in range(3)], repeat=2)
    seen: list[tuple[str, float]] = []
    arrived = None
    while program.vehicle.missions.running is not None:
        program.wait(0.1)
        if arrived is None and 1 in program.vehicle.missions.arrivals:
            arrived = program.now
        seen += [(step.order, round(program.now, 1)) for step in played.advance(program.aircraft)]
    assert arrived is not None
    assert seen == [
        ("status", 5.0),
        ("wind 1 0", round(arrived, 1)),
        ("battery 77", round(arrived, 1)),
        ("stick yaw=0.1", round(arrived + 2.5, 1)),
    ]


def test_a_mission_is_shown_paused_resumed_and_stopped() -> None:
    program = mission_host()
    assert status(program.aircraft)["mission"] is None
    with pytest.raises(UsageError, match="no mission runs"):
        perform(program.aircraft, "mission stop")
    perform(program.aircraft, "mission")
    begin(program, [point(0, 0, 0, 10), point(1, 60, 0, 10)])
    program.wait(14.0)
    told = {"kind": "waypoint", "doing": "flies", "waypoint": 1, "waypoints": 2}
    assert status(program.aircraft)["mission"] == told | {"is_paused": False}
    perform(program.aircraft, "mission pause")
    assert status(program.aircraft)["mission"] == told | {"is_paused": True}
    with pytest.raises(UsageError, match="mission pause: "):
        perform(program.aircraft, "mission pause")
    perform(program.aircraft, "mission resume")
    perform(program.aircraft, "mission stop")
    assert status(program.aircraft)["mission"]["doing"] == "ended"
    with pytest.raises(UsageError, match="cannot be given 'fly'"):
        perform(program.aircraft, "mission fly")


@pytest.mark.parametrize("order", ["hotpoint", "follow"])
def test_other_missions_are_shown(order: str) -> None:
    program = mission_host()
    program.take_off()
    program.motion.place(0, 0, 15)
    here = hotpoint()
    program.ask(here if order == "hotpoint" else FollowStart(here.latitude, here.longitude))
    told = status(program.aircraft)["mission"]
    assert told["kind"] == order
    program.wait(7.0)
    assert status(program.aircraft)["mission"]["doing"] in _LATER
    program.aircraft.leave_f()
    program.wait(0.1)
    assert "broken off: the remote controller" in status(program.aircraft)["mission"]["doing"]


_LATER = ("flies to the circle", "circles", "hovers: the target is silent")


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("at = ", "not TOML"),
        ("[other]\n", "list of"),
        ("[[step]]\nat = 1\n", "'at'"),
        ('[[step]]\nat = -1\ndo = "status"\n', "seconds"),
        ('[[step]]\nat = "soon"\ndo = "status"\n', "seconds"),
        ("[[step]]\nat = 1\ndo = 5\n", "order"),
        ('[[step]]\nat = 1\ndo = "fly-away"\n', "fly-away"),
        ('[[step]]\nat = 1\ndo = "status"\nwhy = 1\n', "'at'"),
        ('[[step]]\nat = 1\nwhen = "waypoint 3"\ndo = "status"\n', "'when'"),
        ('[[step]]\nafter = 1\ndo = "status"\n', "'when'"),
        ('[[step]]\nwhen = "waypoint"\ndo = "status"\n', "waypoint 3"),
        ('[[step]]\nwhen = "sunset 3"\ndo = "status"\n', "sunset"),
        ('[[step]]\nwhen = "waypoint -1"\ndo = "status"\n', "waypoint -1"),
        ('[[step]]\nwhen = "waypoint 1"\nafter = true\ndo = "status"\n', "'after' is True"),
    ],
)
def test_a_bad_scenario_says_what_and_where(tmp_path: Path, text: str, why: str) -> None:
    with pytest.raises(UsageError, match=why):
        scenario(tmp_path, text)


def test_a_missing_scenario_says_so(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="No such file"):
        Scenario.read(tmp_path / "none.toml")


# --- ctl ------------------------------------------------------------------------------------


def run_with_server(tmp_path: Path, order: list[str], **options: Any) -> dict[str, Any]:
    async def main() -> dict[str, Any]:
        server = CtlServer([VirtualAircraft(), VirtualAircraft()], tmp_path / "sim-1.sock")
        await server.start()
        try:
            return await asyncio.to_thread(send_order, order, **options)
        finally:
            await server.stop()

    return asyncio.run(main())


def test_ctl_carries_out_orders_and_answers_with_the_status(tmp_path: Path) -> None:
    answer = run_with_server(tmp_path, ["rc-mode", "A"], path=tmp_path / "sim-1.sock", aircraft=1)
    assert answer["ok"]
    assert answer["status"]["rc_mode"] == "A"
    assert not (tmp_path / "sim-1.sock").exists()


@pytest.mark.parametrize("order", [["fly-away"], []])
def test_ctl_tells_errors(tmp_path: Path, order: list[str]) -> None:
    answer = run_with_server(tmp_path, order, path=tmp_path / "sim-1.sock")
    assert not answer["ok"]
    assert answer["error"]


@pytest.mark.parametrize(
    "line",
    [b"\n", b"[]\n", b'{"order": 5}\n', b'{"order": ["status"], "aircraft": 9}\n', b"\xff\n"],
)
def test_ctl_survives_nonsense(line: bytes) -> None:
    assert CtlServer([VirtualAircraft()]).answer(line)["ok"] is False


def test_ctl_finds_the_only_simulator(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    (tmp_path / "m100link").mkdir()
    stale = tmp_path / "m100link" / "sim-99.sock"
    stale.touch()
    assert find_sockets() == []
    assert not stale.exists()
    with pytest.raises(NoSimulator, match="no simulator"):
        send_order(["status"])

    async def main() -> None:
        servers = [
            CtlServer([VirtualAircraft()], tmp_path / "m100link" / f"sim-{number}.sock")
            for number in (1, 2)
        ]
        await servers[0].start()
        answer = await asyncio.to_thread(send_order, ["status"])
        assert answer["ok"]
        await servers[1].start()
        with pytest.raises(NoSimulator, match="several"):
            await asyncio.to_thread(send_order, ["status"])
        for server in servers:
            await server.stop()

    asyncio.run(main())


def test_ctl_without_a_simulator_behind_the_socket(tmp_path: Path) -> None:
    with pytest.raises(NoSimulator, match="does not answer"):
        send_order(["status"], path=tmp_path / "none.sock")


# --- keys -----------------------------------------------------------------------------------


def test_every_key_gives_an_order_that_exists() -> None:
    for order, label in KEYS.values():
        assert order.split()[0] in ACTIONS
        assert label


def rendered(view: LiveView) -> str:
    screen = io.StringIO()
    Console(file=screen, width=120, height=50).print(view.render())
    return screen.getvalue()


def test_keys_act_and_the_view_shows_it() -> None:
    aircraft = VirtualAircraft(seed=5)
    view = LiveView(aircraft, ["/dev/pts/9"])
    for key in read_keys(b"p\x1b[A?"):
        view.press(key)
    assert aircraft.remote.mode.name == "P"
    assert aircraft.remote.pitch == 0.5
    text = rendered(view)
    for expected in ("/dev/pts/9", "seed 5", "the mode switch is not in F", "stick pitch=0.5"):
        assert expected in text


def test_a_key_that_cannot_act_says_why() -> None:
    aircraft = VirtualAircraft()
    view = LiveView(aircraft, [])
    view.press("p")
    view.press("m")
    assert "cannot take control" in view._message


def test_the_view_shows_commands_and_movements() -> None:
    host = Host().flying()
    host.move(Setpoint.velocity(north=1.5, east=0, up=0, yaw_rate_deg_s=0))
    text = rendered(LiveView(host.aircraft, []))
    assert "start_task -> 0x0002" in text
    assert "flag 0x48 (1.5, 0, 0, 0)" in text


# -- orders of the panel of the console ------------------------------------------------------------


@pytest.fixture
def anyio_backend() -> str:
    return "asyncio"


async def is_obeyed(orders: SimulatorOrders, virtual: VirtualAircraft) -> None:
    assert orders.status["rc_mode"] == "F"
    await orders.give("rc-mode P", "gps 2")
    assert virtual.remote.mode.name == "P"
    assert (orders.status["rc_mode"], orders.status["gps_health"]) == ("P", 2)
    with pytest.raises(M100Error, match="no action"):
        await orders.give("dance")
    await orders.give("rc-mode F")
    assert orders.status["rc_mode"] == "F"


@pytest.mark.anyio
async def test_in_this_process() -> None:
    virtual = VirtualAircraft(seed=5)
    await is_obeyed(orders_in_process(virtual), virtual)


@pytest.mark.anyio
async def test_through_a_socket(tmp_path: Path) -> None:
    virtual = VirtualAircraft(seed=5)
    path = tmp_path / "orders.sock"
    server = CtlServer([virtual], path)
    await server.start()
    try:
        await is_obeyed(await orders_by_socket(path), virtual)
    finally:
        await server.stop()
    with pytest.raises(M100Error):
        await orders_by_socket(tmp_path / "none.sock")
