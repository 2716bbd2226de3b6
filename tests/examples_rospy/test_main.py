"""`python examples/rospy`: its own options, the arguments of the program, and its refusals."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from tests.examples_rospy.conftest import EXAMPLE
from tests.waiting import PATIENCE


def run(*arguments: str) -> subprocess.CompletedProcess[str]:
    command = (sys.executable, str(EXAMPLE), *arguments)
    return subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE, check=False)


def test_a_program_that_is_none_is_named(tmp_path: Path) -> None:
    done = run(str(tmp_path / "none.py"))
    assert done.returncode == 2
    assert "none.py is no file" in done.stderr
    assert "name the program" in run().stderr


@pytest.mark.slow
def test_without_a_station_a_program_hears_how_to_start_one(tmp_path: Path) -> None:
    program = tmp_path / "program.py"
    program.write_text("import rospy, sys\nprint sys.argv[1:]\nrospy.init_node('a')\n")
    done = run(str(program), "-x", "_a:=1", "--station", "ws://127.0.0.1:9")
    assert done.returncode == 1
    assert done.stdout == "['-x', '_a:=1']\n"
    assert "no station answers at ws://127.0.0.1:9" in done.stderr
    assert "m100link serve --sim" in done.stderr
