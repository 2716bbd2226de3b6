"""Completion in the shells themselves, as far as they are installed."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("cyclopts")
from cyclopts import Parameter

from m100link.apps.cli.app import VERBS
from m100link.apps.cli.outcome import ExitCode
from tests.apps.cli.conftest import CommandLine
from tests.apps.cli.test_configuration import FILE
from tests.waiting import PATIENCE

ASKS_BACK = hasattr(Parameter, "completer")
"""Whether a shell may ask for candidates when the tabulator is pressed: cyclopts 5."""

# bash calls the function with the words up to the cursor; it is what readline would do.
BASH = """
source completion
COMP_WORDS=({words} ""); COMP_CWORD={last}
COMP_WORDS[COMP_CWORD]="$1"
_m100link
printf '%s\\n' "${{COMPREPLY[@]}}"
"""


def completed(shell: str, folder: Path, *words: str) -> set[str]:
    """What a shell offers for the last word."""
    script = folder / "completion"
    program = Path(sys.executable).parent
    environment = os.environ | {"PATH": f"{program}{os.pathsep}{os.environ['PATH']}"}
    if shell == "bash":
        known = " ".join(["m100link", *words[:-1]])
        text = BASH.format(words=known, last=len(words))
        command = ["bash", "--norc", "-c", text, "bash", words[-1]]
    else:
        line = " ".join(["m100link", *words])
        command = ["fish", "--no-config", "-c", f"source {script}; complete -C '{line}'"]
    done = subprocess.run(
        command,
        cwd=folder,
        env=environment,
        capture_output=True,
        text=True,
        timeout=PATIENCE,
        check=True,
    )
    return {line.partition("\t")[0] for line in done.stdout.splitlines()}


@pytest.mark.parametrize("shell", ["bash", "fish"])
def test_the_shell_completes_verbs_options_and_aircraft(
    cli: CommandLine, configuration_file: Path, tmp_path: Path, shell: str
) -> None:
    if shutil.which(shell) is None:
        pytest.skip(f"{shell} is not installed")
    if not (Path(sys.executable).parent / "m100link").exists():
        pytest.skip("the command is not installed beside this Python")
    configuration_file.write_text(FILE)
    outcome = cli("completion", shell)
    assert outcome.status == ExitCode.OK
    (tmp_path / "completion").write_text(outcome.out)
    assert completed(shell, tmp_path, "") >= VERBS.keys()
    assert completed(shell, tmp_path, "take") == {"takeoff"}
    assert completed(shell, tmp_path, "sim", "ct") == {"ctl"}
    assert completed(shell, tmp_path, "info", "--fi") == {"--firmware"}
    (tmp_path / "survey.plan").touch()
    for verb in (("mission", "fly"), ("plan", "check"), ("plan", "show"), ("plan", "convert")):
        assert completed(shell, tmp_path, *verb, "sur") == {"survey.plan"}
    if ASKS_BACK:
        assert completed(shell, tmp_path, "fly", "la") == {"lab-m100"}
        assert completed(shell, tmp_path, "takeoff", "--url", "v") == {"virtual"}
        assert completed(shell, tmp_path, "echo", "virtual", "magn") == {"magnetometer"}
        height = {"position.height_m"}
        assert completed(shell, tmp_path, "plot", "virtual", "position.he") == height
        assert completed(shell, tmp_path, "info", "--firmware", "2") == {"2.3"}


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_what_is_printed_is_a_script_of_that_shell(
    cli: CommandLine, tmp_path: Path, shell: str
) -> None:
    outcome = cli("completion", shell)
    assert (outcome.status, outcome.err) == (ExitCode.OK, "")
    assert "takeoff" in outcome.out
    if shutil.which(shell) is not None:
        script = tmp_path / "script"
        script.write_text(outcome.out)
        subprocess.run([shell, "-n", str(script)], check=True, timeout=PATIENCE)


def test_it_is_installed_where_the_shell_looks(
    cli: CommandLine, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))
    outcome = cli("completion", "bash", "--install")
    assert outcome.status == ExitCode.OK
    place = outcome.err.partition("written to ")[2].partition(";")[0]
    assert Path(place).read_text().count("takeoff") > 1
    assert place in (tmp_path / ".bashrc").read_text()


def test_a_shell_that_nobody_knows_is_asked_for(
    cli: CommandLine, monkeypatch: pytest.MonkeyPatch
) -> None:
    def found() -> str:
        return "powershell"

    monkeypatch.setattr("cyclopts.completion.detect_shell", found)
    outcome = cli("completion")
    assert outcome.status == ExitCode.USAGE
    assert "name it: bash, zsh or fish" in outcome.err
