"""What an import brings with it. Modules are counted, not seconds: those are the machine's."""

from __future__ import annotations

import ast
import functools
import importlib
import pickle
import pydoc
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import m100link
from tests.test_house import MODULES, is_for_annotations, tree

COSTLY = {"asyncio", "anyio", "logging", "dataclasses", "inspect", "ssl", "subprocess", "pathlib"}
COSTLY |= {"serial", "cryptography", "importlib.metadata", "urllib", "rich", "cyclopts"}


@functools.cache
def loaded_by(statement: str) -> frozenset[str]:
    """The modules that a statement loads into an interpreter that has nothing else to do."""
    program = (
        "import sys; before = set(sys.modules)\n"
        f"{statement}\n"
        "print(*sorted(set(sys.modules) - before), sep='\\n')"
    )
    return frozenset(run(program).stdout.split())


def run(program: str, *options: str) -> subprocess.CompletedProcess[str]:
    # Without site, which loads what the environment likes; the paths are those of this process.
    found = f"import sys; sys.path[:] = {sys.path!r}\n{program}"
    return subprocess.run(
        [sys.executable, "-S", *options, "-c", found], capture_output=True, text=True, check=True
    )


def own(statement: str) -> set[str]:
    return {name for name in loaded_by(statement) if name.startswith("m100link")}


def test_the_package_alone_loads_nothing_of_itself() -> None:
    assert own("import m100link") == {"m100link"}
    assert not COSTLY & loaded_by("import m100link")


@pytest.mark.parametrize(
    ("statement", "rooms", "allowed"),
    [
        ("import m100link.errors", {"errors"}, set()),
        ("from m100link import BadURL", {"errors"}, set()),
        ("import m100link.wire", {"errors", "wire"}, set()),
        (
            "import m100link.protocol",
            {"errors", "wire", "protocol"},
            {"dataclasses", "inspect"},
        ),
        (
            "from m100link import Setpoint",
            {"errors", "wire", "session", "protocol"},
            {"dataclasses", "inspect"},
        ),
    ],
)
def test_a_lower_room_loads_neither_those_above_nor_what_only_they_need(
    statement: str, rooms: set[str], allowed: set[str]
) -> None:
    assert {name.split(".")[1] for name in own(statement) if "." in name} == rooms
    assert loaded_by(statement) & COSTLY <= allowed


def test_a_program_that_reads_a_frame_does_not_load_the_commands_that_it_does_not_have() -> None:
    commands = {f"m100link.protocol.commands.{name}" for name in ("waypoint", "hotpoint", "follow")}
    read = "from m100link.protocol import PROFILES, parse_command; parse_command(bytes({}), {})"
    assert not commands & own("import m100link.protocol")
    assert not commands & own(read.format([0x01, 0x05, 1], "PROFILES['3.1']"))
    assert commands & own(read.format([0x03, 0x12, 1], "PROFILES['3.1']")) == {
        "m100link.protocol.commands.waypoint"
    }


@pytest.mark.parametrize("place", ["m100link", "m100link.missions.plan"])
def test_a_program_that_plans_loads_no_commands(place: str) -> None:
    made = f"from {place} import WaypointPlan"
    assert {name.split(".")[1] for name in own(made) if "." in name} == {
        *("errors", "geodesy", "missions"),
    }


def test_the_names_of_plans_are_those_of_their_room() -> None:
    assert set(importlib.import_module("m100link.missions.plan").__all__) == m100link._OF_PLANS


def test_connecting_waits_with_what_only_some_connections_need() -> None:
    loaded = loaded_by("from m100link import connect, Aircraft")
    assert "asyncio" in loaded
    # Keys, plug-in transports, the virtual aircraft and the command line.
    assert not loaded & {"cryptography", "importlib.metadata", "m100link.sim", "rich", "cyclopts"}


def test_to_connect_loads_what_it_needs_when_it_connects() -> None:
    loaded = own("from m100link import connect, Setpoint")
    assert not {name for name in loaded if name.startswith("m100link.link")}
    program = (
        "import asyncio, m100link\n"
        "async def main():\n"
        "    async with m100link.connect('sim://') as aircraft: await aircraft.version()\n"
        "asyncio.run(main())"
    )
    assert {"m100link.link", "m100link.sim"} <= own(program)


def test_a_program_that_listens_does_not_load_what_flies() -> None:
    loaded = own("from m100link import connect, Aircraft")
    flying = {
        "flight.control",
        "flight.missions.mission_session",
        "missions.plan",
        "protocol.commands.missions",
    }
    assert not {name.removeprefix("m100link.") for name in loaded} & flying


def test_a_key_loads_the_cipher_when_it_is_used() -> None:
    statement = "from m100link.wire import Cipher, Key; key = Key(bytes(32))"
    assert "cryptography" not in loaded_by(statement)
    assert "cryptography" in loaded_by(f"{statement}; Cipher(key).encrypt(b'x')")


def test_every_public_name_is_what_type_checkers_take_it_for() -> None:
    [block] = [node for node in tree(MODULES["m100link"]).body if is_for_annotations(node)]
    all_rooms = {room.partition(".")[0] for room in (*m100link._ROOMS, *m100link._OTHER_ROOMS)}
    seen, rooms = {"__version__"}, set()
    for node in ast.walk(block):
        if isinstance(node, ast.ImportFrom) and node.module not in {"types", "importlib.machinery"}:
            assert node.module is not None
            home = importlib.import_module(node.module)
            for alias in node.names:
                names = home.__all__ if alias.name == "*" else [alias.name]
                for name in names:
                    assert getattr(m100link, name) is getattr(home, name)
                if alias.name in all_rooms:
                    assert alias.asname == alias.name, "checkers take it for private"
                    rooms.add(alias.name)
                else:
                    seen.update(names)
    assert seen == set(m100link.__all__) - rooms
    assert rooms == all_rooms


TYPED = """
import m100link
from typing import assert_type
frame = m100link.geodesy.LocalFrame(52.0, 5.0)
assert_type(frame, m100link.geodesy.LocalFrame)
m100link.sim.loop_factory(1.0)
m100link.doctor.diagnose
m100link.fleet.Fleet
m100link.requests.Requests
m100link.protocol.Arm
m100link.aircraft.Connecting
m100link.errors.LinkLost("gone")
"""
NAMED = "".join(f"from m100link import {name} as {name}\n" for name in m100link.__all__)
UNTYPED = """
import m100link
m100link.sim.no_such_name
m100link.no_such_room
"""


@pytest.mark.parametrize(
    "checker", [("mypy", "--strict", "--python-executable"), ("pyright", "--pythonpath")]
)
def test_rooms_have_their_types_without_an_import_of_their_own(
    checker: tuple[str, ...], tmp_path: Path
) -> None:
    if shutil.which(checker[0]) is None:
        pytest.skip(f"{checker[0]} is not installed")
    good, bad = tmp_path / "typed.py", tmp_path / "untyped.py"
    good.write_text(TYPED + NAMED)
    bad.write_text(UNTYPED)
    told = subprocess.run(
        [*checker, sys.executable, good, bad],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
    )
    lines = re.findall(r"(\w+)\.py:(\d+):.* error:", told.stdout)
    assert lines == [("untyped", "3"), ("untyped", "4")], told.stdout


def test_names_are_found_by_all_who_look_for_them() -> None:
    assert set(m100link.__all__) <= set(dir(m100link))
    namespace: dict[str, object] = {}
    exec("from m100link import *", namespace)
    assert namespace.keys() >= set(m100link.__all__)
    text = pydoc.plain(pydoc.render_doc(m100link))
    assert "class Setpoint" in text
    assert "connect(" in text
    for cls in (m100link.Setpoint, m100link.AuthorityLost, m100link.Attitude):
        assert pickle.loads(pickle.dumps(cls)) is cls


def test_rooms_are_attributes_without_an_import_of_their_own() -> None:
    program = "import m100link; m100link.geodesy.LocalFrame; m100link.protocol.Arm"
    assert "m100link.geodesy" in loaded_by(program)
    aside = "import m100link; m100link.sim.loop_factory; m100link.patterns.survey"
    assert {"m100link.sim", "m100link.missions.patterns"} <= loaded_by(aside)


MOVED = {  # one that loads others comes behind them
    "m100link.requests": "m100link.link.requests",
    "m100link.patterns": "m100link.missions.patterns",
    "m100link.doctor": "m100link.apps.doctor",
    "m100link.fleet": "m100link.apps.fleet",
}


@pytest.mark.parametrize("is_old_first", [True, False])
def test_a_documented_room_that_moved_is_the_same_module_by_its_old_name(
    is_old_first: bool,
) -> None:
    lines = ["import sys"]
    for old, now in MOVED.items():
        first, second = (old, now) if is_old_first else (now, old)
        lines.append(f"import {first}, {second}")
        lines.append(f"assert sys.modules[{old!r}] is sys.modules[{now!r}]")
        lines.append(f"import m100link; assert {old} is {now}")
    assert run("\n".join(lines), "-W", "error").stderr == ""


def test_what_is_below_a_room_that_moved_is_loaded_once_and_warns() -> None:
    program = "import m100link.fleet.show as old, m100link.apps.fleet.show as now"
    asked = run(f"{program}; assert old is now", "-W", "always")
    assert "m100link.fleet.show is m100link.apps.fleet.show now" in asked.stderr
    missing = run("try: import m100link.fleet.nothing\nexcept ModuleNotFoundError as e: print(e)")
    assert missing.stdout == "No module named 'm100link.apps.fleet.nothing'\n"


@pytest.mark.parametrize(
    ("module", "old", "now"),
    [
        ("m100link.apps.agent.lease", "LeaseDesk", "LeaseManager"),
        ("m100link.apps.agent.messages", "FromMobile", "MobileMessage"),
    ],
)
def test_a_documented_class_has_its_old_name_too(module: str, old: str, now: str) -> None:
    room = importlib.import_module(module)
    with pytest.warns(DeprecationWarning, match=f"{module}.{old} is {now} now") as told:
        assert getattr(room, old) is getattr(room, now)
    assert told[0].filename == __file__, "it is reported where the old name stands"
    with pytest.raises(AttributeError, match="has no attribute 'Nothing'"):
        room.Nothing  # noqa: B018 - it is asked for


TAKEN_IN = [
    ("protocol.commands.camera", "protocol.commands.gimbal", "TakePhoto"),
    ("sync.steering", "sync.control", "GimbalRates"),
]


def test_a_documented_module_that_another_took_in_is_that_one_and_warns() -> None:
    program = "\n".join(
        f"import m100link.{old} as old, m100link.{now} as now; assert old is now; old.{name}"
        for old, now, name in TAKEN_IN
    )
    asked = run(program, "-W", "always")
    assert asked.stderr.count("DeprecationWarning") == len(TAKEN_IN), asked.stderr
    for old, now, _ in TAKEN_IN:
        assert asked.stderr.count(f"m100link.{old} is m100link.{now} now") == 1, asked.stderr


def test_a_name_that_does_not_exist_is_an_attribute_error_with_its_name() -> None:
    with pytest.raises(AttributeError, match="'m100link' has no attribute 'Contrl'"):
        _ = m100link.Contrl  # type: ignore[attr-defined] # what is tested
    with pytest.raises(ImportError, match="cannot import name 'Contrl'"):
        exec("from m100link import Contrl")


@pytest.mark.parametrize(
    "door",
    ["aircraft.aircraft", "apps.agent.server.server", "sim", "apps.station.process", "testing"],
)
def test_the_program_behind_each_entry_decides_about_the_log(door: str) -> None:
    statement = f"import m100link.{door}, logging; logging.getLogger('m100link.x').warning('loud')"
    assert "m100link.link" in loaded_by(statement)
    assert run(statement).stderr == ""


def test_the_list_of_verbs_loads_none_of_them() -> None:
    asked = "import sys; sys.argv = ['m100link', '--help']\nfrom m100link.apps.cli import main"
    loaded = loaded_by(f"{asked}\ntry: main()\nexcept SystemExit: pass")
    loaded_of_it = {name for name in loaded if name.startswith("m100link")}
    assert {name for name in loaded_of_it if not name.startswith("m100link.errors.")} == {
        *("m100link", "m100link.apps", "m100link.errors"),
        *("m100link.apps.cli", "m100link.apps.cli.app", "m100link.apps.cli.terminal"),
    }


def test_a_verb_for_a_port_does_not_load_the_virtual_aircraft() -> None:
    asked = "import sys; sys.argv = ['m100link', 'info', '/dev/none']"
    run_it = "from m100link.apps.cli import main\ntry: main()\nexcept SystemExit: pass"
    loaded = own(f"{asked}\n{run_it}")
    assert "m100link.aircraft" in loaded
    assert "m100link.sim" not in loaded


def test_the_process_of_the_page_loads_neither_what_flies_nor_what_no_page_uses() -> None:
    pytest.importorskip("nicegui")
    loaded = loaded_by("import m100link.apps.station.process as it; it._load(0, ['console'], [])")
    assert "m100link.apps.station.console.app" in loaded
    # Of rosbridge, of virtual aircraft, of agents, of a client of engineio.
    assert not loaded & {"m100link.apps.station.web.server", "m100link.sim", "aiohttp.client"}
    assert not loaded & {"m100link.apps.agent.server", "m100link.flight.control", "urllib3"}


def test_decoding_a_frame_loads_neither_an_event_loop_nor_an_aircraft_nor_a_console() -> None:
    asked = (
        "import sys; sys.argv = ['m100link', 'decode', 'aa']\nfrom m100link.apps.cli import main"
    )
    loaded = loaded_by(f"{asked}\ntry: main()\nexcept SystemExit: pass")
    assert "m100link.apps.cli.decode" in loaded
    above = {"asyncio", "m100link.link", "m100link.sim", "m100link.apps.station", "rich.console"}
    assert not loaded & above
