"""`m100link serve` as a user starts it, and TLS."""

from __future__ import annotations

import asyncio
import datetime
import json
import os
import re
import signal
import socket
import ssl
import subprocess
import sys
import threading
import time
import urllib.request
from collections.abc import AsyncIterator
from contextlib import ExitStack, asynccontextmanager
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import NameOID

from m100link.apps.cli import serve
from m100link.apps.cli.serve import StationOptions, _announce, aircraft_of
from m100link.apps.cli.terminal import OutputFormat
from m100link.apps.mavlink.translator.codec import MavlinkMessage, MessageReader, write_frame
from m100link.apps.station import log_output
from m100link.apps.station.config import Settings
from m100link.apps.station.listeners import FRONTS, Sockets
from m100link.apps.station.log_output import FlightProgress
from m100link.apps.station.run import RunningStation
from m100link.errors import M100Error
from m100link.sim.clock import virtual_clock_loop
from tests.apps.cli.conftest import CommandLine
from tests.apps.station.test_run import Pilot
from tests.sockets import connect
from tests.waiting import PATIENCE

pytest.importorskip("uvicorn")


COMMAND = (sys.executable, "-c", "from m100link.apps.cli import main; main()")


@pytest.fixture
def anyio_backend() -> str:
    return "asyncio"


def run(*arguments: str, **environment: str) -> subprocess.CompletedProcess[str]:
    clean = {name: value for name, value in os.environ.items() if not name.startswith("M100LINK")}
    return subprocess.run(
        [*COMMAND, *arguments],
        capture_output=True,
        text=True,
        timeout=PATIENCE,
        env=clean | environment,
        check=False,
    )


def secret_file(folder: Path) -> Path:
    """A file with a token."""
    token = folder / "token"
    token.write_text("0123456789abcdef")
    token.chmod(0o600)
    return token


def children(process: int) -> list[int]:
    """Process ids of its children."""
    listed = Path(f"/proc/{process}/task/{process}/children").read_text()
    return [int(one) for one in listed.split()]


def test_settings_are_shown_with_their_origin(tmp_path: Path) -> None:
    launch = tmp_path / "sdk.launch"
    launch.write_text(
        '<launch><param name="baud_rate" value="115200"/><param name="use_x" value="1"/></launch>'
    )
    done = run(
        *("serve", "--launch", str(launch), "--show-config", "--port", "1234", "--table"),
        M100LINK_APP_ID="7",
        M100LINK_KEY="00" * 32,
    )
    rows = {line.split()[0]: line.split()[1:] for line in done.stdout.splitlines()}
    assert rows["baud_rate"] == ["115200", str(launch)]
    assert rows["app_id"] == ["7", "environment"]
    assert rows["port"] == ["1234", "command", "line"]
    assert rows["key"] == ["(set)", "environment"]
    assert rows["level"] == ["2", "default"]
    assert "00" * 32 not in done.stdout + done.stderr
    assert "has parameters that nothing reads: use_x" in done.stderr


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (("serve",), "no aircraft was named"),
        (("serve", "simm://"), "there is no transport called 'simm'"),
        (("serve", "one=sim://", "two=simm://"), "there is no transport called 'simm'"),
        (("serve", "a=sim://", "b=sim://", "--single-process"), "one process has one aircraft"),
        (("mavlink", "simm://"), "there is no transport called 'simm'"),
        (("ros2", "simm://"), "there is no transport called 'simm'"),
        (("ros2", "sim://", "--node", "a b"), "cannot be part of a name in ROS"),
        (("ros2", "sim://", "--domain", "300"), "there is no domain 300"),
        (("serve", "--sim", "--host", "0.0.0.0"), "there is no token"),
        (("serve", "--sim", "--launch", "/none.launch"), "/none.launch cannot be read"),
        (("serve", "--sim", "--pages", "/none"), "is not a folder"),
        (("serve", "--sim", "--pages", "x" * 300), "is not a folder"),
        (("serve", "--sim", "--port", "99999"), "there is no port 99999"),
        (("serve", "--sim", "--also-port", "-1"), "there is no port -1"),
        (("console", "--sim", "--console-port", "65536"), "there is no port 65536"),
        (("serve", "--sim", "--tls-cert", "/none", "--tls-key", "/none"), "used: No such file"),
    ],
)
def test_mistakes_are_reported_with_a_remedy(
    cli: CommandLine, monkeypatch: pytest.MonkeyPatch, arguments: tuple[str, ...], says: str
) -> None:
    monkeypatch.setenv("M100LINK_PORT", "0")
    done = cli(*arguments)
    assert done.status == 2
    assert says in done.err.replace("\n", " ")
    assert "Traceback" not in done.err


def test_a_mistake_ends_the_process() -> None:
    done = run("serve", M100LINK_PORT="0")
    assert done.returncode == 2
    assert "no aircraft was named" in done.stderr
    assert "Traceback" not in done.stderr


@pytest.mark.anyio
async def test_the_process_of_the_fronts_serves_the_numbers() -> None:
    process = await asyncio.create_subprocess_exec(
        *(*COMMAND, "serve", "--sim", "--port", "0", "--metrics", "0", "--json"),
        stdout=asyncio.subprocess.PIPE,
        stderr=asyncio.subprocess.PIPE,
    )
    assert process.stdout is not None
    try:
        url = json.loads(await process.stdout.readline())["metrics"]
        assert url.startswith("http://127.0.0.1:")

        def scrape() -> str:
            with urllib.request.urlopen(url, timeout=PATIENCE) as answer:
                return str(answer.read(), "utf-8")

        async with asyncio.timeout(PATIENCE):
            while "m100_link_frames_total{" not in await asyncio.to_thread(scrape):  # noqa: ASYNC110 - a page has no event
                await asyncio.sleep(0.1)
    finally:
        process.terminate()
        await process.communicate()


def test_without_the_package_it_says_what_to_install() -> None:
    blocked = "import sys; sys.modules['prometheus_client'] = None; "
    done = subprocess.run(
        [
            *(sys.executable, "-c", blocked + "from m100link.apps.cli import main; main()"),
            *("serve", "--sim", "--port", "0", "--metrics", "0", "--single-process"),
        ],
        capture_output=True,
        text=True,
        timeout=PATIENCE,
        check=False,
    )
    assert done.returncode == 2
    assert "metrics needs prometheus_client" in done.stderr
    assert "pip install '.[station]'" in done.stderr


@pytest.mark.anyio
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
async def test_a_signal_ends_it_and_control_goes_back(number: signal.Signals) -> None:
    process = await asyncio.create_subprocess_exec(
        *(*COMMAND, "serve", "--sim", "--port", "0", "--json"),
        stdout=asyncio.subprocess.PIPE,
        stderr=asyncio.subprocess.PIPE,
    )
    assert process.stdout is not None
    url = json.loads(await process.stdout.readline())["rosbridge"][0]
    async with connect(url, close_timeout=1) as client:
        call = {"op": "call_service", "service": "/dji_sdk/activation"}
        await client.send(json.dumps(call))
        await client.recv()
        call = {"op": "call_service", "service": "/dji_sdk/sdk_control_authority", "args": [1]}  # type: ignore[dict-item]
        await client.send(json.dumps(call))
        assert json.loads(await client.recv())["values"]["result"] is True
        process.send_signal(number)
        async with asyncio.timeout(PATIENCE):
            _, talk = await process.communicate()
    assert process.returncode == 0
    assert b"control authority released" in talk
    assert b"ending: control authority goes back" in talk
    assert b"Traceback" not in talk


@pytest.mark.anyio
@pytest.mark.parametrize("more", [(), ("/dev/no-port-either",)])
async def test_the_end_without_an_aircraft_says_nothing_of_one(more: tuple[str, ...]) -> None:
    process = await asyncio.create_subprocess_exec(
        *(*COMMAND, "serve", "/dev/no-port", *more, "--port", "0", "--json"),
        stdout=asyncio.subprocess.PIPE,
        stderr=asyncio.subprocess.PIPE,
    )
    assert process.stderr is not None
    async with asyncio.timeout(PATIENCE):
        for _ in ("/dev/no-port", *more):
            async for line in process.stderr:
                if b"not connected: there is no device" in line:
                    break
        process.send_signal(signal.SIGINT)
        _, talk = await process.communicate()
    assert process.returncode == 0
    assert talk.splitlines()[-1] == b"ending"


@pytest.mark.anyio
async def test_a_front_that_died_is_reported_once_and_its_console_can_be_opened_again(
    tmp_path: Path,
) -> None:
    token = secret_file(tmp_path)
    process = await asyncio.create_subprocess_exec(
        *(*COMMAND, "console", "--sim", "--port", "0", "--console-port", "0", "--json"),
        *("--no-open-browser", "--token-file", str(token)),
        stdout=asyncio.subprocess.PIPE,
        stderr=asyncio.subprocess.PIPE,
    )
    assert process.stdout is not None
    first = json.loads(await process.stdout.readline())["console"]
    (child,) = children(process.pid)
    os.kill(child, signal.SIGKILL)
    async with asyncio.timeout(PATIENCE):
        second = json.loads(await process.stdout.readline())["console"]
    assert second != first
    browser = urllib.request.build_opener(urllib.request.HTTPCookieProcessor())
    with await asyncio.to_thread(browser.open, second) as answer:
        assert b"m100link" in answer.read()
    process.send_signal(signal.SIGTERM)
    async with asyncio.timeout(PATIENCE):
        _, talk = await process.communicate()
    assert talk.count(b"the fronts ended (SIGKILL)") == 1


async def _takes_off(pilot: Pilot) -> bool:
    """Whether a flight begins and is given back; a front that got no time has lost its lease."""
    for service, args in (
        ("activation", {}),
        ("sdk_control_authority", {"control_enable": 1}),
        ("drone_task_control", {"task": 4}),
        ("sdk_control_authority", {"control_enable": 0}),
    ):
        answer = await pilot.call(f"/dji_sdk/{service}", **args)
        # The values of a call that was refused are the reason, as a text.
        if not answer["result"] or not answer["values"]["result"]:
            return False
    return True


@pytest.mark.anyio
async def test_a_terminal_that_is_gone_ends_no_flight() -> None:
    read, write = os.pipe()
    process = await asyncio.create_subprocess_exec(
        *(*COMMAND, "serve", "--sim", "--port", "0", "--json"),
        stdout=asyncio.subprocess.PIPE,
        stderr=write,
    )
    os.close(write)
    assert process.stdout is not None
    url = json.loads(await process.stdout.readline())["rosbridge"][0]
    os.close(read)  # each event from now on is a broken pipe
    async with connect(url, close_timeout=1) as client, asyncio.timeout(PATIENCE):
        pilot = Pilot(client)
        while not await _takes_off(pilot):  # noqa: ASYNC110 - what is waited for has no event
            await asyncio.sleep(0.5)
    process.send_signal(signal.SIGTERM)
    async with asyncio.timeout(PATIENCE):
        assert await process.wait() == 0


@pytest.mark.anyio
@pytest.mark.parametrize("host", ["::1", "127.0.0.2", "localhost"])
async def test_somebody_listens_where_it_says(host: str) -> None:
    process = await asyncio.create_subprocess_exec(
        *(*COMMAND, "console", "--sim", "--host", host, "--port", "0", "--console-port", "0"),
        *("--json", "--no-open-browser"),
        stdout=asyncio.subprocess.PIPE,
        stderr=asyncio.subprocess.DEVNULL,
    )
    try:
        assert process.stdout is not None
        said = json.loads(await process.stdout.readline())
        async with connect(said["rosbridge"][0], close_timeout=1) as client:
            await client.send('{"op":"subscribe","topic":"/flight_status"}')
            assert json.loads(await client.recv())["op"] == "publish"
        health = said["console"] + "console/shell.js"
        with await asyncio.to_thread(urllib.request.urlopen, health) as answer:
            assert answer.status == 200
    finally:
        process.terminate()
        await process.wait()


def certificate(folder: Path) -> tuple[Path, Path]:
    """A certificate for localhost that signs itself, and its key."""
    key = ec.generate_private_key(ec.SECP256R1())
    name = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, "localhost")])
    now = datetime.datetime.now(datetime.UTC)
    signed = (
        x509.CertificateBuilder()
        .subject_name(name)
        .issuer_name(name)
        .public_key(key.public_key())
        .serial_number(1)
        .not_valid_before(now - datetime.timedelta(days=1))
        .not_valid_after(now + datetime.timedelta(days=1))
        .add_extension(x509.SubjectAlternativeName([x509.DNSName("localhost")]), critical=False)
        .add_extension(x509.BasicConstraints(ca=True, path_length=None), critical=True)
        .sign(key, hashes.SHA256())
    )
    paths = folder / "cert.pem", folder / "key.pem"
    paths[0].write_bytes(signed.public_bytes(serialization.Encoding.PEM))
    paths[1].write_bytes(
        key.private_bytes(
            serialization.Encoding.PEM,
            serialization.PrivateFormat.PKCS8,
            serialization.NoEncryption(),
        )
    )
    return paths


@pytest.mark.anyio
async def test_tls(tmp_path: Path) -> None:
    from m100link.apps.station.config import Settings
    from m100link.apps.station.run import running

    cert, key = certificate(tmp_path)
    trust = ssl.create_default_context(cafile=str(cert))
    async with running(Settings(sim=True, port=0, tls_cert=cert, tls_key=key)) as one:
        url = f"wss://localhost:{one.sockets.port('rosbridge')}"
        origin = f"https://localhost:{one.sockets.port('rosbridge')}"
        async with connect(url, ssl=trust, additional_headers={"Origin": origin}) as client:
            await client.send('{"op":"subscribe","topic":"/flight_status"}')
            assert json.loads(await client.recv())["op"] == "publish"


@pytest.mark.parametrize(
    ("words", "named"),
    [
        ((), {"m100": None}),
        (("/dev/ttyUSB0",), {"m100": "/dev/ttyUSB0"}),
        (("kite=/dev/ttyUSB0",), {"kite": "/dev/ttyUSB0"}),
        (("tcp://a:1", "tcp://b:1"), {"m100_1": "tcp://a:1", "m100_2": "tcp://b:1"}),
        (("kite=tcp://a:1", "tcp://b:1"), {"kite": "tcp://a:1", "m100_2": "tcp://b:1"}),
        (("sim://?seed=3", "tcp://b:1"), {"m100_1": "sim://?seed=3", "m100_2": "tcp://b:1"}),
        (("sim://", "sim://"), {"m100_1": None, "m100_2": None}),
    ],
)
def test_aircraft_have_the_names_that_they_are_given(
    words: tuple[str, ...], named: dict[str, str | None]
) -> None:
    found = aircraft_of(StationOptions(), words)
    assert {name: one.url for name, one in found.items()} == named
    assert all(one.sim == (one.url is None and bool(words)) for one in found.values())


@pytest.mark.parametrize(
    ("options", "words", "says"),
    [
        ({}, ("a=tcp://a:1", "a=tcp://b:1"), "two aircraft are called a"),
        ({}, ("a-b=tcp://a:1", "a_b=tcp://b:1"), "two aircraft are called a_b"),
        ({}, ("tcp://a:1", "tcp://a:1"), "m100_1 and m100_2 are at the same place"),
        ({"sim": True}, ("tcp://a:1", "tcp://b:1"), "aircraft and --sim were given"),
        ({}, ("tcp://a:1", "nonsense"), "nonsense"),
    ],
)
def test_aircraft_that_could_be_taken_for_each_other_are_refused(
    options: dict[str, Any], words: tuple[str, ...], says: str
) -> None:
    with pytest.raises(M100Error, match=says):
        aircraft_of(StationOptions(**options), words, is_sim=bool(options.get("sim")))


def test_aircraft_of_the_configuration_file_keep_their_names(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path))
    (tmp_path / "m100link.toml").write_text(
        '[aircraft.kite]\nurl = "/dev/ttyUSB0"\nfirmware = "3.1"\n'
        '[aircraft.crow]\nurl = "/dev/ttyUSB1"\n'
    )
    found = aircraft_of(StationOptions(), ("kite", "crow", "tcp://b:1"))
    assert {name: (one.url, one.firmware) for name, one in found.items()} == {
        "kite": ("/dev/ttyUSB0", "3.1"),
        "crow": ("/dev/ttyUSB1", None),
        "m100_3": ("tcp://b:1", None),
    }


# -- how a station is run from the command line: seen as a whole in test_station.py ----------------


def test_what_is_not_read_holds_up_nobody(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(log_output, "_LAST_WORDS", PATIENCE)  # the machine may hold up the thread
    told: list[int] = []
    stopped = threading.Event()
    with FlightProgress("talk", 200) as teller:
        teller.do(lambda: told.append(1))
        teller.do(partial(stopped.wait, PATIENCE))  # Ctrl-S
        for number in range(2000):
            teller.do(partial(told.append, number))
        stopped.set()
    assert told[:2] == [1, 0]
    assert len(told) <= 1 + 200


def test_a_closed_pipe_ends_the_talk_and_nothing_else() -> None:
    def broken() -> None:
        raise BrokenPipeError

    told: list[int] = []
    with FlightProgress("talk", 200) as teller:
        teller.do(broken)
        teller.do(lambda: told.append(1))
    assert told == []


def _recording(state: Path, **more: str) -> dict[str, Any]:
    """How a process runs whose flight logs are to be seen."""
    environment = os.environ | {"XDG_STATE_HOME": str(state)} | more
    return {"stdout": subprocess.PIPE, "text": True, "env": environment}


# -- ``m100link mavlink`` as a process: a ground station on a real socket --------------------------


@pytest.mark.pty
@pytest.mark.smoke
def test_a_ground_station_sees_the_aircraft_and_sigterm_ends_it(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "m100link", "mavlink", "sim://", "--table"]
    with (
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as station,
        subprocess.Popen(
            [*command, "--listen", "udp://127.0.0.1:0"], **_recording(tmp_path)
        ) as bridge,
    ):
        assert bridge.stdout is not None
        found = re.search(r"mavlink: +udp://127\.0\.0\.1:(\d+)", bridge.stdout.readline())
        assert found is not None
        address = ("127.0.0.1", int(found[1]))
        station.bind(("127.0.0.1", 0))
        station.settimeout(PATIENCE)
        beat = write_frame(MavlinkMessage("HEARTBEAT", {"type": 6}), system=255, sequence=0)
        names: set[str] = set()
        ends = time.monotonic() + PATIENCE
        while not {"HEARTBEAT", "HOME_POSITION", "ATTITUDE"} <= names and time.monotonic() < ends:
            station.sendto(beat, address)
            names |= {one.name for one in MessageReader(station.recv(2048))}
        assert {"HEARTBEAT", "HOME_POSITION", "ATTITUDE"} <= names
        bridge.send_signal(signal.SIGTERM)
        assert bridge.wait(PATIENCE) == 0
    assert len([*tmp_path.glob("m100link/flights/*.mcap")]) == 1, "as serve does"


# -- ``m100link ros2`` as a process: a session of zenoh that is not ours sees the node -------------


@pytest.mark.pty
@pytest.mark.smoke
def test_a_session_sees_the_node_and_sigterm_ends_it(tmp_path: Path) -> None:
    zenoh: Any = pytest.importorskip("zenoh", reason="the extra ros2 is not installed")
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        place = json.dumps([f"tcp/127.0.0.1:{probe.getsockname()[1]}"])
    config = zenoh.Config()
    config.insert_json5("listen/endpoints", place)
    config.insert_json5("scouting/multicast/enabled", "false")
    command = [sys.executable, "-m", "m100link", "ros2", "sim://", "--node", "one", "--domain", "7"]
    command.append("--table")
    recording = _recording(tmp_path, ZENOH_CONFIG_OVERRIDE=f"connect/endpoints={place}")
    with (
        zenoh.open(config) as session,
        subprocess.Popen(command, **recording) as node,
    ):
        ring = zenoh.handlers.RingChannel(64)
        imus = session.declare_subscriber("7/one/imu/**", ring)
        tokens = session.liveliness().declare_subscriber("@ros2_lv/7/*/*/*/NN/**", history=True)
        assert node.stdout is not None
        assert node.stdout.readline().split() == ["ros2:", "/one"]
        assert next(iter(tokens)).kind == zenoh.SampleKind.PUT
        ends = time.monotonic() + PATIENCE
        while (imu := imus.try_recv()) is None and time.monotonic() < ends:
            time.sleep(0.05)
        assert imu is not None
        assert bytes(imu.payload).startswith(b"\0\1\0\0")
        node.send_signal(signal.SIGTERM)
        assert node.wait(PATIENCE) == 0
        assert next(iter(tokens)).kind == zenoh.SampleKind.DELETE
    assert len([*tmp_path.glob("m100link/flights/*.mcap")]) == 1


@pytest.mark.parametrize("as_json", [False, True])
def test_each_socket_that_is_opened_is_reported(
    as_json: bool, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also of a front that this file does not know."""
    with ExitStack() as stack:
        by_tcp = FRONTS.keys() - {"mavlink", "ros2"}
        made = {name: [socket.create_server(("127.0.0.1", 0))] for name in by_tcp}
        for row in made.values():
            stack.callback(row[0].close)
        running: Any = SimpleNamespace(sockets=Sockets(made), console_path=lambda: "/?code=1")
        monkeypatch.setattr(OutputFormat, "json", as_json)
        _announce({"one": Settings(ros2=True)}, running)
        told = capsys.readouterr().out
        if as_json:
            facts = json.loads(told)
            alone = {name for name, one in facts.items() if isinstance(one, str)}
            assert (alone, facts["ros2"]) == ({"console", "metrics", "foxglove"}, ["/m100"])
        for name in made:
            assert f"://127.0.0.1:{running.sockets.port(name)}" in told, name
            assert name in told


@pytest.mark.anyio
@pytest.mark.parametrize("has_authority", [False, True])
async def test_the_end_says_that_control_goes_back_where_there_is_some(
    has_authority: bool, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    @asynccontextmanager
    async def played(*_: object) -> AsyncIterator[tuple[RunningStation, None]]:
        task = None if has_authority else "land"
        agent: Any = SimpleNamespace(
            holding=SimpleNamespace(has_authority=has_authority, task=task),
            connection=SimpleNamespace(aircraft="it is there"),
        )
        fronts: Any = SimpleNamespace(console_path=None)
        yield RunningStation(agent, None, fronts, Sockets({})), None

    async def there(*_: object) -> None:
        ended.set()

    ended = asyncio.Event()
    monkeypatch.setattr(serve, "ended_by_signal", lambda: ended)
    monkeypatch.setattr(serve, "_are_there", there)
    monkeypatch.setattr(serve, "_running", played)
    for process_wide in ("tell_elsewhere", "log_of"):
        monkeypatch.setattr(serve, process_wide, lambda _: None)
    monkeypatch.setattr("m100link.apps.station.supervisor.leave_what_stays", lambda: None)
    await serve.run_station({"one": Settings(sim=True)}, serve.AS_USUAL)
    end = "ending: control authority goes back; a flying aircraft hovers"
    assert capsys.readouterr().err.splitlines()[-1] == (end if has_authority else "ending")


def test_recordings_are_files_with_the_firmware_that_is_forced_on_them() -> None:
    aircraft = {
        "a": Settings(url="replay:///a/one.mcap?speed=2", firmware="3.1"),
        "b": Settings(url="replay:///a/two.mcap"),
        "c": Settings(url="/dev/ttyUSB0"),
        "d": Settings(sim=True),
    }
    assert serve._recordings(aircraft) == [("/a/one.mcap", "3.1"), ("/a/two.mcap", "")]


VIRTUAL, RECORDED = Settings(sim=True), Settings(url="replay:///a.mcap")


@pytest.mark.parametrize(
    ("aircraft", "there_after", "waited"),
    [
        ([VIRTUAL], 0.5, 0.5),
        ([VIRTUAL], 9.0, 2.0),
        ([Settings(url="sim://?seed=1"), RECORDED], 0.5, 0.5),
        ([Settings(url="/dev/ttyUSB0")], 0.5, 0.0),
        ([VIRTUAL, Settings(url="tcp://a:7000")], 0.5, 0.0),
    ],
)
def test_an_address_is_reported_once_virtual_aircraft_are_there(
    aircraft: list[Settings], there_after: float, waited: float
) -> None:
    """Seconds: a program flies as soon as it reads the address; a real aircraft takes its time."""
    one = SimpleNamespace(is_connected=False, connection=SimpleNamespace(aircraft=None))
    station = SimpleNamespace(agent=one, **({"agents": {"a": one}} if len(aircraft) > 1 else {}))

    def come() -> None:
        one.is_connected = one.connection.aircraft = True

    async def wait() -> float:
        loop = asyncio.get_running_loop()
        loop.call_later(there_after, come)
        began = loop.time()
        await serve._are_there(dict(zip("ab", aircraft, strict=False)), station)
        return loop.time() - began

    with asyncio.Runner(loop_factory=virtual_clock_loop) as runner:
        assert runner.run(wait()) == pytest.approx(waited, abs=0.02)
