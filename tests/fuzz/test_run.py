"""The short form of the fuzzing; `nox -s fuzz` is the long one."""

from __future__ import annotations

import importlib.util
import subprocess
from random import Random

import pytest

from tests.fuzz import run
from tests.fuzz.guided import quoted
from tests.fuzz.mutation import MOST, changed
from tests.fuzz.run import Finding, execute
from tests.fuzz.targets import TARGETS, Target

SEED = 20151121


@pytest.mark.parametrize("name", TARGETS)
def test_no_input_raises_what_is_not_promised(name: str) -> None:
    target = TARGETS[name]
    told = execute(name, target, 150, SEED)
    assert told.refused < 150, "every input was refused: the seeds are not inputs"


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
