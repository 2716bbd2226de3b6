"""What holds the whole together: sizes, rooms, arrows, and where the test of a module stands."""

from __future__ import annotations

import ast
import gc
import re
import tomllib
from collections import defaultdict
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

from tests.speeds import CLOCK

ROOT = Path(__file__).parent.parent
PACKAGE = ROOT / "m100link"
CONTRACTS = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"][
    "importlinter"
]["contracts"]

# A longer one asks whether it is still one subject. At 500 the limit cut single subjects in two.
LINES_PER_FILE = 700
LINES_PER_FUNCTION = 60  # its docstring not counted
# The bridge to MAVLink is a room of its own: a front with a protocol, a codec and six arrows, which
# the command line begins. The node of ROS 2 is another one, with seven arrows to what lies below
# and two to it, from the station and the command line.
# What many aircraft fly together is a room above all that know one: the command line begins it.
# Its network is another one, of which only it knows.
ROOMS, FLOORS, ARROWS = 27, 11, 141


@cache
def tree(path: Path) -> ast.Module:
    text = path.read_text(encoding="utf-8")
    gc.disable()  # it would look through all that was parsed before, again and again
    try:
        with CLOCK.left_out():  # the first test that reads a file parses it for all
            return ast.parse(text)
    finally:
        gc.freeze()
        gc.enable()


def programs(*folders: str) -> list[Path]:
    return sorted(path for folder in folders for path in (ROOT / folder).rglob("*.py"))


def name_of(path: Path) -> str:
    """The dotted name of a module."""
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


MODULES = {name_of(path): path for path in programs("m100link")}


# Read are the classes from which they are written; what they say stands there.
GENERATED = {PACKAGE / f"sync/{name}.py" for name in ("aircraft", "control", "payload")}


# -- sizes ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("folder", ["m100link", "benchmarks", "examples", "docs/_ext"])
def test_no_file_is_too_long_to_be_read_in_one_go(folder: str) -> None:
    counted = {
        str(path.relative_to(ROOT)): len(path.read_text(encoding="utf-8").splitlines())
        for path in programs(folder)
        if path not in GENERATED
    }
    assert counted
    assert {path: lines for path, lines in counted.items() if lines > LINES_PER_FILE} == {}


def length(function: ast.FunctionDef | ast.AsyncFunctionDef) -> int:
    """Lines of a function without its docstring."""
    assert function.end_lineno is not None
    lines = function.end_lineno - function.lineno + 1
    if ast.get_docstring(function) is not None:
        text = function.body[0]
        assert text.end_lineno is not None
        lines -= text.end_lineno - text.lineno + 1
    return lines


def test_no_function_is_too_long_to_be_seen_at_once() -> None:
    too_long = {
        f"{path.relative_to(ROOT)}:{node.name}": length(node)
        for path in programs("m100link", "benchmarks", "examples", "docs/_ext", "tests")
        for node in ast.walk(tree(path))
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)
        and length(node) > LINES_PER_FUNCTION
    }
    assert too_long == {}


# -- rooms and arrows -----------------------------------------------------------------------------


def is_for_annotations(node: ast.AST) -> bool:
    return isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING"


@cache
def imports(module: str, *, for_annotations: bool = False) -> frozenset[str]:
    """The modules of the package that a module imports when it runs, or names at all."""
    return frozenset(imported(tree(MODULES[module]), for_annotations=for_annotations))


def imported(program: ast.Module, *, for_annotations: bool) -> Iterator[str]:
    skipped = {
        inner for node in ast.walk(program) if is_for_annotations(node) for inner in ast.walk(node)
    }
    for node in ast.walk(program):
        if node in skipped and not for_annotations:
            continue
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names if alias.name in MODULES)
        elif isinstance(node, ast.ImportFrom) and node.module in MODULES:
            inner = {f"{node.module}.{alias.name}" for alias in node.names}
            yield from inner & MODULES.keys() or {node.module}


def arrows(*, between_rooms: bool, for_annotations: bool = False) -> dict[str, set[str]]:
    """Who imports whom, by module or by room: a file or folder right under the package."""
    found: dict[str, set[str]] = defaultdict(set)
    for module in MODULES:
        for target in imports(module, for_annotations=for_annotations):
            ends = [module, target]
            if between_rooms:
                ends = [name.split(".")[1] if "." in name else "" for name in ends]
            if "" not in ends and "__main__" not in ends and ends[0] != ends[1]:
                found[ends[0]].add(ends[1])
    return found


def reach(start: str, graph: dict[str, set[str]]) -> set[str]:
    """Whatever can be reached by arrows."""
    found: set[str] = set()
    waiting = [start]
    while waiting:
        new = graph.get(waiting.pop(), set()) - found
        found |= new
        waiting += new
    return found


@pytest.mark.parametrize("between_rooms", [True, False], ids=["rooms", "modules"])
def test_there_is_no_circle(between_rooms: bool) -> None:
    graph = arrows(between_rooms=between_rooms, for_annotations=True)
    # What a package hands on is not its own.
    graph = {
        name: {target for target in targets if between_rooms or not is_package(target)}
        for name, targets in graph.items()
        if between_rooms or not is_package(name)
    }
    assert [name for name in graph if name in reach(name, graph)] == []


def is_package(module: str) -> bool:
    return MODULES[module].name == "__init__.py"


def test_the_rooms_their_floors_and_their_arrows_stay_few() -> None:
    graph = arrows(between_rooms=True)

    @cache
    def floor(room: str) -> int:
        return 1 + max((floor(below) for below in graph.get(room, ())), default=0)

    rooms = set(graph).union(*graph.values())
    assert len(rooms) <= ROOMS
    assert max(map(floor, rooms)) <= FLOORS
    assert sum(map(len, graph.values())) <= ARROWS


def test_every_room_has_its_place_in_the_contract_of_the_layers() -> None:
    layers = {name.removeprefix("m100link.") for name in CONTRACTS[0]["layers"]}
    graph = arrows(between_rooms=True)
    rooms = set(graph).union(*graph.values())
    # The first two stand on the ground; the other side of the cable has a contract of its own.
    beside = {"geodesy", "keyfile", "patterns", "sim"}
    assert layers | beside == rooms
    assert graph["keyfile"] | graph["geodesy"] | graph["patterns"] <= {"errors", "wire"}


def test_the_manuals_house_names_places_that_exist() -> None:
    page = (ROOT / "docs/explanation/house.md").read_text(encoding="utf-8")
    named = set(re.findall(r"`(m100link/[\w/.]+)`", page))
    assert len(named) > 20
    assert {place for place in named if not (ROOT / place).exists()} == set()


# -- tests ----------------------------------------------------------------------------------------

# Module → the test that shows what it does, and why that one stands elsewhere.
TESTED_ELSEWHERE = {
    "activation.py": ("aircraft/test_aircraft.py", "activating is one method of the aircraft"),
    "agent/actions.py": ("agent/test_message_bytes.py", "each comes out as it went in"),
    "agent/activation.py": ("agent/test_agent.py", "a part that only the agent has"),
    "agent/answers.py": ("agent/test_client.py", "a part that only the client has"),
    "agent/codec.py": ("agent/test_message_bytes.py", "what is said, and how it is written down"),
    "agent/connect.py": ("agent/test_agent.py", "three lines that each open a connection"),
    "agent/front.py": ("agent/test_service.py", "a front is what the service is asked by"),
    "agent/guided.py": ("agent/test_guiding.py", "wishes, and what flies of them"),
    "agent/messages.py": ("agent/test_message_bytes.py", "each comes out as it went in"),
    "agent/orders.py": ("agent/test_service.py", "each is asked for by a message"),
    "agent/patterns.py": ("station/ros/test_node_2015.py", "flown by the commands of 2015"),
    "agent/plan_told.py": ("agent/test_client.py", "there and back is what a client sees"),
    "station/console/parts/replay.py": ("browser/test_replay.py", "a page is seen in a browser"),
    "agent/replay_told.py": ("agent/test_replays.py", "what a front is told of a replay"),
    "agent/steering.py": ("station/console/test_tab.py", "steered by the pad of the console"),
    "aircraft/events.py": ("aircraft/test_aircraft.py", "two names and what they carry"),
    "aircraft/connecting.py": ("aircraft/test_aircraft.py", "whoever tests it connects first"),
    "aircraft/observer.py": ("log/test_recorder.py", "what it tells is read in the log"),
    "doctor/answers.py": ("doctor/test_diagnosis.py", "stages are seen in a whole diagnosis"),
    "doctor/findings.py": ("doctor/test_diagnosis.py", "names and attributes, nothing to run"),
    "errors/aircraft.py": ("test_errors.py", "names and attributes, nothing to run"),
    "errors/base.py": ("test_errors.py", "the tree is tested as a whole"),
    "errors/line.py": ("test_errors.py", "names and attributes, nothing to run"),
    "errors/usage.py": ("test_errors.py", "names and attributes, nothing to run"),
    "cli/fleet_agent.py": ("cli/test_fleet.py", "what runs beside the pilots"),
    "cli/fleet_console.py": ("cli/test_fleet.py", "a page for it"),
    "cli/fleet_watch.py": ("cli/test_fleet.py", "three more verbs of it"),
    "errors/fleet.py": ("test_errors.py", "names and attributes, nothing to run"),
    "cli/fleet_left.py": ("cli/test_fleet_interrupted.py", "what Ctrl-C at those verbs says"),
    "cli/fleet_lease.py": ("cli/test_fleet_mission.py", "orders from two shells are under one"),
    "fleet/missions/told.py": ("fleet/missions/test_board.py", "a card is what somebody asks for"),
    "fleet/sending.py": ("fleet/test_control.py", "what a pilot sends, and a front far away"),
    "fleet/told.py": ("fleet/test_carrier.py", "the other end of that way"),
    "station/fleet.py": ("cli/test_fleet.py", "a process that owns aircraft"),
    "flight/guidance.py": ("flight/test_loops.py", "seen in what the closed loops do"),
    "log/dissector.py": ("interop/test_wireshark.py", "what it makes runs inside tshark"),
    "log/replayed_link.py": ("aircraft/test_replaying.py", "the line of its aircraft"),
    "link/opening.py": ("link/test_serial_pty.py", "what it opens is tested there"),
    "flight/missions/deck.py": (
        "flight/missions/test_run.py",
        "names for its surroundings",
    ),
    "flight/missions/ending.py": (
        "flight/missions/test_flying_on.py",
        "seen in what false pushes lead to",
    ),
    "flight/missions/events.py": (
        "flight/missions/test_waypoint.py",
        "seen by the program",
    ),
    "flight/missions/flight.py": ("flight/missions/test_waypoint.py", "seen in every mission"),
    "flight/missions/missions.py": (
        "flight/missions/test_waypoint.py",
        "each leads to a kind",
    ),
    "flight/missions/orders.py": ("flight/missions/test_keeper.py", "requests by their kind"),
    "flight/missions/refusal.py": ("flight/missions/test_waypoint.py", "seen in what is raised"),
    "log/ros2_definitions.py": ("log/test_cdr.py", "compared with those of others"),
    "ros2/answers.py": ("ros2/test_node.py", "each service answers by it"),
    "ros2/ends.py": ("ros2/test_node.py", "seen in what comes in and goes out"),
    "ros2/flights.py": ("ros2/test_actions.py", "each is a goal of an action"),
    "ros2/helm.py": ("ros2/test_node.py", "seen in what flies"),
    "ros2/topics.py": ("ros2/test_node.py", "a table that all of it is made from"),
    "station/ros2.py": ("cli/test_ros2.py", "a session of a process"),
    "mavlink/crew.py": ("mavlink/test_bridge.py", "seen in what flies"),
    "mavlink/definitions.py": ("mavlink/test_codec.py", "compared with those of others"),
    "mavlink/numbers.py": ("mavlink/test_modes.py", "compared with those of others"),
    "mavlink/orders.py": ("mavlink/test_bridge.py", "values that are seen in what flies"),
    "mavlink/peers.py": ("mavlink/test_bridge.py", "heard by datagrams"),
    "mavlink/standard_modes.py": ("mavlink/test_vehicle.py", "asked for by messages"),
    "mavlink/udp.py": ("cli/test_mavlink.py", "a socket of a process"),
    "mavlink/wishes.py": ("mavlink/test_deck.py", "values that the deck takes"),
    "protocol/records.py": ("protocol/test_packet.py", "records are what packages are read into"),
    "session/events.py": ("session/test_endpoint.py", "names and counters, nothing to run"),
    "sim/orders/ctl.py": ("cli/test_sim.py", "a socket between two processes"),
    "sim/orders/scenario.py": ("sim/orders/test_actions.py", "a scenario is a list of actions"),
    "sim/vehicle/airframe.py": ("sim/vehicle/test_dynamics.py", "numbers that the dynamics uses"),
    "sim/vehicle/missions/settings.py": (
        "sim/vehicle/missions/test_plan.py",
        "numbers that the others use",
    ),
    "sim/vehicle/missions/steering.py": (
        "sim/vehicle/missions/test_waypoints.py",
        "seen in the track of a flight",
    ),
    "sim/vehicle/missions/upload.py": (
        "sim/vehicle/missions/test_computer.py",
        "uploads are one part of it",
    ),
    "sim/vehicle/mobile.py": ("sim/vehicle/test_activation.py", "the app is where activation is"),
    "sim/vehicle/piloting.py": ("sim/vehicle/test_authority.py", "what sticks do to the aircraft"),
    "sim/vehicle/settings.py": ("sim/test_telemetry.py", "numbers that the others use"),
    "sim/virtual.py": ("sim/test_autopilot.py", "it hands on to vehicle, autopilot and line"),
    "station/console/app.py": ("browser/test_console.py", "a page is seen in a browser"),
    "station/console/page.py": ("browser/test_console.py", "a page is seen in a browser"),
    "station/console/view/inputs.py": (
        "station/console/view/test_view.py",
        "what a view is made of",
    ),
    "station/console/installable.py": ("browser/test_console.py", "a browser decides"),
    "station/front.py": ("station/test_apart.py", "a process of its own"),
    "station/fronts.py": ("station/test_apart.py", "it starts and ends processes"),
    "station/launch.py": ("station/test_config.py", "launch files are one source of the settings"),
    "station/ros/encoding.py": ("station/ros/test_client.py", "seen in what a client gets"),
    "station/ros/leases.py": ("station/ros/test_node_2015.py", "taken by opening control"),
    "station/owner.py": ("station/test_several.py", "a process of its own"),
    "station/run.py": ("station/web/test_server.py", "every test there runs it"),
    "station/web/access.py": ("station/web/test_gate.py", "the gate's two questions"),
    "station/web/files.py": ("station/web/test_server.py", "seen by asking the server"),
    "sync/payload.py": ("sync/test_aircraft.py", "an aircraft has its gimbal and its camera"),
    "sync/steering.py": ("sync/test_control.py", "ticks and holds are what a control block gives"),
    "sync/subscription.py": ("sync/test_aircraft.py", "a subscription is what an aircraft gives"),
    "telemetry/stream.py": ("telemetry/test_subscription.py", "seen in what a consumer gets"),
}


def mirrored(module: Path) -> Path:
    place = module.relative_to(PACKAGE)
    return ROOT / "tests" / place.parent / f"test_{place.name}"


TESTED_ELSEWHERE |= {
    str(path.relative_to(PACKAGE)): ("browser/test_console.py", "a part is seen in a browser")
    for path in programs("m100link/station/console/parts")
    if path.name != "__init__.py" and not mirrored(path).exists()
}

TESTED_ELSEWHERE |= {
    str(path.relative_to(PACKAGE)): ("station/console/view/test_words.py", "tested as a whole")
    for path in programs("m100link/station/console/view/catalogue")
    if path.name != "__init__.py"
}


def test_the_test_of_a_module_is_found_where_its_name_says() -> None:
    missing = {
        str(path.relative_to(PACKAGE))
        for path in programs("m100link")
        if path.name not in ("__init__.py", "__main__.py") and not mirrored(path).exists()
    }
    assert missing - TESTED_ELSEWHERE.keys() == set(), "write it, or say where and why"
    assert TESTED_ELSEWHERE.keys() - missing == set(), "no exception is needed any more"


@pytest.mark.parametrize("module", TESTED_ELSEWHERE)
def test_what_is_tested_elsewhere_says_where_and_why(module: str) -> None:
    test, reason = TESTED_ELSEWHERE[module]
    assert (ROOT / "tests" / test).exists()
    assert len(reason) > 10


def test_a_test_that_traces_puts_back_what_traced_before() -> None:
    """Without that nothing behind it in its process is in the figures of coverage."""
    away = re.compile(r"settrace\(None\)")
    found = [path.name for path in programs("tests") if away.search(path.read_text("utf-8"))]
    assert found == []


def test_who_waits_for_a_process_has_patience() -> None:
    """A number of seconds is the machine's: tests/waiting.py says how long is never."""
    number = r"(?:timeout=)?[0-9.]+[,)]"
    waits = re.compile(
        rf"(?:communicate|process\.wait)\({number}|capture_output=True[^()]*timeout=[0-9.]+[,)]"
    )
    found = [path.name for path in programs("tests") if waits.search(path.read_text("utf-8"))]
    assert found == []
