"""The short form of the fuzzing; `nox -s fuzz` is the long one."""

from __future__ import annotations

import asyncio
import importlib.util
import subprocess
import sys
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress
from pathlib import Path
from random import Random
from types import FrameType

import pytest

import m100link
from m100link.apps.agent.background import TaskSet
from m100link.protocol.firmware import PROFILES
from tests.fuzz import run
from tests.fuzz.connections import http_seeds
from tests.fuzz.guided import quoted
from tests.fuzz.mutation import MOST, changed
from tests.fuzz.readers import WITHOUT, readers
from tests.fuzz.run import Finding, execute
from tests.fuzz.targets import TARGETS, Target
from tests.fuzz.worlds import Take, World

SEED = 20151121


@pytest.mark.parametrize("name", TARGETS)
def test_no_input_raises_what_is_not_promised(name: str) -> None:
    target = TARGETS[name]
    # What has an aircraft behind it costs a hundred times as much.
    executions = 15 if isinstance(target.read, World) else 150
    told = execute(name, target, executions, SEED)
    assert told.refused < executions, "every input was refused: the seeds are not inputs"


def test_every_reader_is_run_by_the_seeds_of_a_target_or_says_why_not() -> None:
    found = {" ".join(one) for one in readers()}
    assert WITHOUT.keys() <= found, "no such reader is there any more"
    ran = set()

    def note(frame: FrameType, event: str, _: object) -> None:
        if event == "call":
            ran.add(frame.f_code)

    for profile in PROFILES.values():
        profile.plans.clear()  # what an earlier test had read is read again
    before = sys.getprofile()
    for target in TARGETS.values():
        target.begin()
        for one in target.seeds():
            sys.setprofile(note)
            try:
                with suppress(*target.refuses):
                    target.read(one)
            finally:
                sys.setprofile(before)
        target.begin()
    installed = Path(m100link.__file__).parent  # perhaps not the tree's
    places = ((Path(one.co_filename), one.co_qualname) for one in ran)
    known = {
        f"{path.relative_to(installed)} {name}"
        for path, name in places
        if path.is_relative_to(installed)
    }
    assert found - known - WITHOUT.keys() == set(), "give it a target: its bytes are others'"


# Each of them raised something else than what its reader promises.
ONCE = [
    ("scenario", b"[[step]]\nat = 1\ndo = " + b"[" * 3000),
    ("scenario", b"[[step]]\nat = 1\ndo = " + b"9" * 4400),
    ("scenario", b'[[step]]\nwhen = "waypoint ' + b"9" * 4400 + b'"\ndo = "status"'),
    ("configuration", b"[defaults]\ntimeout = " + b"[" * 3000),
    ("rights", b"site = " + b"9" * 4400),
    ("rights", b"site = " + b"[" * 3000),
    ("URL", b"replay://%" + b"x" * 300),
    ("URL", b"replay://~nobody_of_that_name/flight.mcap"),
    ("console's events", b'{"name": [], "value": 1}'),
    ("fleet's values", None),
    ("ledger", bytes(47) + b'{"flies": 7, "at": 1' + b"0" * 400 + b"}\n"),
    ("shared lease", b"[" * 3000),
    ("tracks", b"Time [msec],x [m],y [m],z [m]\n0,0,0,4\n250,1e9,0,4\n500,2e9,0,4\n"),
    ("tracks", b"Time [msec],x [m],y [m],z [m]\n0,0,0,4\n250,1e300,0,4\n500,2,0,4\n"),
    ("tracks", b"Time [msec],x [m],y [m],z [m]\n0,0,0,4\n250,9e4,0,4\n500,1e5,0,9e4\n"),
    ("shared lease", b'{"fence": 1e400, "token": "a"}'),
    ("simulator's socket", b'{"order": ' + b"[" * 3000),
    ("machine", b"\x86"),
    ("guardian's page", bytes(12) + b"\5"),
    ("HTTP", http_seeds()[-1].replace(b"Key: A", b"Key: \b")),
    ("rosbridge", b'{"op":"call_service","service":"x","id":"\\ud800","compression":"cbor"}'),
]


@pytest.mark.parametrize(("name", "data"), ONCE)
def test_what_was_found_once_is_refused_as_promised(name: str, data: bytes | None) -> None:
    target = TARGETS[name]
    if data is None:  # a reply that tells another stage
        data = target.seeds()[1].replace(b"flying", b"filing")
    with suppress(*target.refuses):
        target.read(data)


def test_an_error_in_a_world_is_found_wherever_it_was() -> None:
    @asynccontextmanager
    async def running() -> AsyncIterator[Take]:
        async def take(data: bytes) -> None:
            if data == b"task":
                TaskSet().spawn(_fail(), "a task")
            elif data == b"loop":
                asyncio.get_running_loop().call_soon(int, "x")
            elif data == b"here":
                raise KeyError(data)
            await asyncio.sleep(0.01)

        yield take

    world = World(running)
    for data in (b"task", b"loop", b"here"):
        with pytest.raises((KeyError, ValueError)):
            world(data)
        world(b"another")
    world.begin()


async def _fail() -> None:
    raise KeyError("in a task")


def test_an_error_that_is_not_promised_is_found_with_its_input() -> None:
    def read(data: bytes) -> None:
        if data.count(b"a") > 3:
            raise KeyError("unlucky")

    with pytest.raises(Finding, match=r"unlucky.* for b'"):
        execute("unlucky", Target(read, lambda: [b"a letter"]), 1000, SEED)


def test_what_stays_in_memory_is_found() -> None:
    kept: list[bytes] = []

    def read(data: bytes) -> None:
        kept.extend(data[at : at + 8] for at in range(200))

    with pytest.raises(Finding, match="stayed"):
        execute("keeper", Target(read, lambda: [bytes(range(256)) * 2]), 1000, SEED)


def test_changes_follow_from_the_seed_and_have_a_limit() -> None:
    first, second = Random(SEED), Random(SEED)
    seeds = [b"one", b"two" * 1000]
    inputs = [changed(first, seeds) for _ in range(300)]
    assert inputs == [changed(second, seeds) for _ in range(300)]
    assert max(map(len, inputs)) <= MOST
    assert len(set(inputs)) > 200


def test_words_of_a_language_are_written_as_the_other_engine_reads_them() -> None:
    assert quoted((b'"\\', b"", b"op")) == '"\\x22\\x5c"\n"\\x6f\\x70"\n'


def test_a_table_as_the_default_aircraft_is_refused_as_promised() -> None:
    target = TARGETS["configuration"]
    with pytest.raises(target.refuses, match="there is no aircraft"):
        target.read(b"[defaults]\naircraft.aud = 23\n")
    TARGETS["telemetry"].read(bytes(2))  # a package of nothing is one


def test_a_finding_of_the_other_engine_is_shown_with_its_traceback(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Python's report comes by one of its outputs, the input by the other."""

    def found(*_: object, **__: object) -> subprocess.CompletedProcess[str]:
        python, engine = "Traceback (most recent call last):\nKeyError: 7\n", "Base64: AAE=\n"
        return subprocess.CompletedProcess([], 77, python, f"#1 INITED\n{engine}")

    monkeypatch.setattr(importlib.util, "find_spec", lambda name: object())
    monkeypatch.setattr(subprocess, "run", found)
    assert run._guide(["frame"], 1, 1) == 1
    told = capsys.readouterr().out
    assert "KeyError: 7" in told
    assert "Base64: AAE=" in told
