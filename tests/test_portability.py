"""Windows and macOS as far as Linux can stand in for them: tests/other_systems.py takes away.

Each scene is a process of its own. What a system cannot do ends with one sentence and its remedy.
"""

from __future__ import annotations

import ast
import asyncio
import json
import re
import signal
import socket
import subprocess
import sys
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from m100link.apps.mavlink.translator.codec import MavlinkMessage, write_frame
from tests.apps.station.test_run import Pilot
from tests.other_systems import BREAK, MISSING
from tests.other_systems import MODULES as LACKING
from tests.sockets import connect
from tests.test_house import MODULES, ROOT, tree
from tests.waiting import PATIENCE

SYSTEMS = ["win32", "darwin"]
VERB = "from m100link.apps.cli import main; main()"
LOAD = "import importlib, sys; [importlib.import_module(name) for name in sys.argv[1:]]\n"


def command(system: str, program: str, *words: str) -> list[str]:
    return [sys.executable, "-m", "tests.other_systems", system, program, *words]


def run(system: str, program: str, *words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        command(system, program, *words), capture_output=True, text=True, cwd=ROOT, timeout=PATIENCE
    )


def verb(system: str, *words: str) -> subprocess.CompletedProcess[str]:
    return run(system, VERB, *words)


def modules(*rooms: str) -> list[str]:
    return [name for name in MODULES if name.startswith(rooms) and not name.endswith("__main__")]


LIBRARY = [name for name in modules("m100link") if not name.startswith("m100link.apps.")]

FLIGHT = """
import asyncio, math, signal, m100link
from m100link import Credentials, Position, Setpoint
from m100link.sim import DEMO_APP_ID, DEMO_KEY, loop_factory

async def fly():
    async with m100link.connect("sim://") as aircraft:
        def tell(_, authority):
            height = aircraft.state.fresh(Position, within=1.2).height_m
            print(authority.value, "up" if height > 1.0 else "down", flush=True)

        await aircraft.activate(Credentials(DEMO_APP_ID, DEMO_KEY))
        aircraft.authority.subscribe(tell)
        async with aircraft.control(stop="land") as control:
            await control.take_off()
            tell(None, aircraft.authority.state)
            interrupt()
            await asyncio.sleep(1.0)

with asyncio.Runner(loop_factory=loop_factory(math.inf)) as runner:
    runner.run(fly())
"""


FLOWN = ["obtaining down", "held down", "held up", "releasing down", "none down"]
"""Who has control, and where the aircraft is: it lands, and control goes back, before the end."""


def flies(system: str, number: int, ends: int) -> None:
    ran = run(system, f"interrupt = lambda: signal.raise_signal({number:d})\n{FLIGHT}")
    assert ran.stdout.splitlines() == FLOWN
    assert ran.returncode == ends, ran.stderr


def test_on_windows_the_library_loads() -> None:
    ran = run("win32", LOAD, *LIBRARY)
    assert (ran.stdout, ran.stderr) == ("", "")


def test_on_windows_ctrl_break_lands_what_flies() -> None:
    flies("win32", BREAK, -BREAK)


def test_on_macos_a_signal_lands_what_flies() -> None:
    flies("darwin", signal.SIGTERM, -signal.SIGTERM)


ASKS = r"sys.platform|hasattr|find_spec|TYPE_CHECKING"


def evaluated(node: ast.AST) -> Iterator[ast.AST]:
    """What runs as a module is imported, besides what asks first whether the system has it."""
    parts = list(ast.iter_child_nodes(node))
    if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
        of_call = node.args.defaults, node.args.kw_defaults, node.decorator_list
        parts = [one for row in of_call for one in row if one is not None]
    elif isinstance(node, ast.Lambda):
        parts = []
    elif isinstance(node, ast.If | ast.IfExp) and re.search(ASKS, ast.unparse(node.test)):
        parts = list(node.orelse) if isinstance(node, ast.If) else [node.orelse]
    for part in parts:
        yield part
        yield from evaluated(part)


def lacking(program: ast.AST) -> list[str]:
    """What a module needs at its import that Windows has not."""
    missing, found = MISSING["win32"], list[str]()
    for node in evaluated(program):
        if isinstance(node, ast.Import):
            names = [(alias.name.partition(".")[0], "") for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and not node.level:
            names = [(str(node.module), alias.name) for alias in node.names]
        elif isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
            names = [(node.value.id, node.attr)]
        else:
            continue
        found += [
            f"{module} {name}".strip()
            for module, name in names
            if module in LACKING["win32"] or name in missing.get(module, ())
        ]
    return found


@pytest.mark.parametrize(
    ("program", "found"),
    [
        ("import fcntl, os", ["fcntl"]),
        ("from termios import tcgetattr", ["termios tcgetattr"]),
        ("def now(clock=time.CLOCK_BOOTTIME): pass", ["time CLOCK_BOOTTIME"]),
        ("class One:\n    flags = os.O_NOFOLLOW", ["os O_NOFOLLOW"]),
        ("def late():\n    import fcntl\n    os.fork()", []),
        ("if sys.platform != 'win32':\n    import tty", []),
    ],
)
def test_what_a_module_needs_at_its_import_is_found(program: str, found: list[str]) -> None:
    assert lacking(ast.parse(program)) == found


def test_no_module_needs_at_its_import_what_windows_has_not() -> None:
    """Nor what macOS has not: Windows lacks that, too."""
    found = {name: lacking(tree(path)) for name, path in MODULES.items()}
    assert {name: lacks for name, lacks in found.items() if lacks} == {}


@pytest.mark.parametrize(
    ("name", "places"),
    [
        ("add_signal_handler", {"apps/agent/background.py"}),
        ("flock", {"link/keyfile.py"}),
        ("openpty", {"sim/ports/pty.py"}),
        ("clock_gettime", {"flight/guards.py", "flight/guardian_process.py"}),  # that needs Linux
        ("start_unix_server", {"sim/orders.py"}),
        ("create_unix_server", {"apps/agent/transports.py"}),
        ("pass_fds", {"apps/station/supervisor.py", "flight/guardian.py"}),
    ],
)
def test_one_place_has_what_windows_lacks(name: str, places: set[str]) -> None:
    """What is called later than at an import, and ends there in an error of Python."""
    used = {
        str(path.relative_to(ROOT / "m100link"))
        for path in MODULES.values()
        if name in path.read_text("utf-8")
    }
    assert used == places


@pytest.mark.slow
@pytest.mark.parametrize("system", SYSTEMS)
@pytest.mark.parametrize("rooms", ["agent bus doctor fleet mavlink ros2", "cli", "station"])
def test_the_applications_load(system: str, rooms: str) -> None:
    ran = run(system, LOAD, *modules(*(f"m100link.apps.{room}" for room in rooms.split())))
    assert (ran.stdout, ran.stderr) == ("", "")


VERBS = """
import sys
from m100link.apps.cli import main
for line in sys.stdin.read().splitlines():
    sys.argv[1:] = line.split()
    try:
        main()
    except SystemExit as end:
        print(end.code or 0, line, file=sys.stderr, flush=True)
"""


@pytest.mark.slow
@pytest.mark.parametrize("system", SYSTEMS)
def test_verbs_that_serve_nobody(system: str, tmp_path: Path) -> None:
    lines = [
        "--version",
        "decode aa130001000000000500302e000000b493113d",
        "config",
        f"demo --speed max --json --record {tmp_path}",
        "demo --speed 50 --json --no-record",
        "doctor sim:// --json",
        "info sim:// --json",
    ]
    ran = subprocess.run(
        command(system, VERBS),
        input="\n".join(lines),
        capture_output=True,
        text=True,
        cwd=ROOT,
        timeout=PATIENCE,
    )
    ended = [line for line in ran.stderr.splitlines() if line[:1].isdigit()]
    assert ended == [f"0 {line}" for line in lines]
    assert "Traceback" not in ran.stderr
    (log,) = tmp_path.glob("*.mcap")
    assert verb(system, "log", "info", str(log), "--json").returncode == 0


@pytest.mark.slow
def test_a_recording_of_nothing_leaves_no_file_on_windows(tmp_path: Path) -> None:
    ran = verb("win32", "record", "tcp://127.0.0.1:1", "-o", str(tmp_path), "--duration", "1")
    assert ran.returncode == 3
    assert "recording ended" not in ran.stderr
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
@pytest.mark.parametrize(
    ("words", "status", "says"),
    [
        ("sim --json", 3, "Windows has no pseudo-terminals"),
        ("sim ctl status", 1, "takes no orders from another shell on Windows"),
        ("serve one=sim:// two=sim:// --port 0", 2, "no process of its own can be had on Windows"),
        ("fleet make {}/fleet.toml", 2, "on Windows m100link cannot keep two programs"),
    ],
)
def test_what_windows_cannot_do_ends_with_a_sentence_and_a_remedy(
    words: str, status: int, says: str, tmp_path: Path
) -> None:
    fleet = '[router.base]\nhosts = ["127.0.0.1"]\n[aircraft.a1]\n[identity.anna]\nfly = ["*"]\n'
    (tmp_path / "fleet.toml").write_text(fleet, encoding="utf-8")
    ran = verb("win32", *words.format(tmp_path).split())
    assert (ran.returncode, says in " ".join(ran.stderr.split())) == (status, True), ran.stderr
    assert "what to do:" in ran.stderr
    assert "Traceback" not in ran.stderr


async def started(system: str, *words: str) -> tuple[asyncio.subprocess.Process, dict[str, Any]]:
    """A verb that serves, and its line of JSON."""
    process = await asyncio.create_subprocess_exec(
        *command(system, VERB, *words),
        stdout=asyncio.subprocess.PIPE,
        stderr=asyncio.subprocess.PIPE,
        cwd=ROOT,
    )
    assert process.stdout is not None
    async with asyncio.timeout(PATIENCE):
        line = await process.stdout.readline()
    return process, json.loads(line or b"{}")


async def ended(process: asyncio.subprocess.Process, number: int) -> str:
    """End it by a signal; what it said."""
    process.send_signal(number)
    async with asyncio.timeout(PATIENCE):
        _, talk = await process.communicate()
    assert process.returncode == 0, talk.decode()
    assert b"Traceback" not in talk
    return talk.decode()


ENDINGS = [("win32", signal.SIGINT), ("win32", BREAK), ("darwin", signal.SIGINT)]


@pytest.mark.slow
@pytest.mark.anyio
@pytest.mark.parametrize(("system", "number"), ENDINGS)
async def test_a_simulator_answers_by_tcp(system: str, number: int, tmp_path: Path) -> None:
    process, told = await started(system, "sim", "--tcp", "0", "--json")
    asked = await asyncio.to_thread(verb, system, "info", told["port"], "--json")
    assert json.loads(asked.stdout)["firmware"]
    words = ("record", told["port"], "-o", str(tmp_path), "--duration", "1")
    recorded = await asyncio.to_thread(verb, system, *words)
    assert recorded.returncode == 0, recorded.stderr
    assert re.search(r"\.mcap: [\d,]+\s+bytes", recorded.stderr)
    assert "Traceback" not in await ended(process, number)


@pytest.mark.slow
@pytest.mark.anyio
@pytest.mark.parametrize(("system", "number"), ENDINGS)
async def test_a_station_flies_for_a_client_and_hovers_as_it_ends(system: str, number: int) -> None:
    """The signal orders a hover and gives control back before anything ends."""
    words = ("console", "--sim", "--port", "0", "--console-port", "0", "--json")
    process, told = await started(system, *words, "--no-open-browser", "--no-record")
    with await asyncio.to_thread(urllib.request.urlopen, told["console"]) as page:
        assert b"m100link" in page.read()
    async with connect(told["rosbridge"][0], close_timeout=1) as client:
        await Pilot(client).take_off()
        talk = await ended(process, number)
    assert "ending: control authority goes back; a flying aircraft hovers" in talk
    assert "control authority released" in talk


@pytest.mark.slow
@pytest.mark.anyio
@pytest.mark.parametrize(("system", "number"), ENDINGS)
async def test_mavlink_is_spoken(system: str, number: int) -> None:
    process, told = await started(
        system, "mavlink", "sim://", "--listen", "udp://127.0.0.1:0", "--json"
    )
    host, port = told["mavlink"][0].removeprefix("udp://").split(":")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as station:
        station.settimeout(PATIENCE)
        beat = write_frame(MavlinkMessage("HEARTBEAT", {"type": 6}), system=255, sequence=0)
        await asyncio.to_thread(station.sendto, beat, (host, int(port)))
        data = await asyncio.to_thread(station.recv, 4096)
    assert data[0] == 0xFD
    await ended(process, number)
