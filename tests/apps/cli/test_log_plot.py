"""``m100link log plot`` as people type it."""

from __future__ import annotations

import errno
from pathlib import Path

import pytest

from m100link.apps.cli.log import new_file
from m100link.apps.cli.outcome import ExitCode
from m100link.errors import UsageError
from tests.apps.cli.conftest import CommandLine

pytest.importorskip("mcap", reason="the extra `log` is not installed")


@pytest.fixture
def flight(cli: CommandLine, tmp_path: Path) -> Path:
    path = tmp_path / "flight.mcap"
    assert cli("record", "sim://", "-o", str(path), "--duration", "0.5").status == ExitCode.OK
    return path


def test_a_page_is_made_beside_the_log(cli: CommandLine, flight: Path) -> None:
    outcome = cli("log", "plot", str(flight))
    assert outcome.status == ExitCode.OK
    assert outcome.err == ""
    assert "flight.mcap</h1>" in flight.with_suffix(".html").read_text("utf-8")


@pytest.mark.parametrize("error", [OSError(errno.ENOSPC, "No space left"), KeyboardInterrupt()])
def test_half_of_a_file_is_not_left_behind(tmp_path: Path, error: BaseException) -> None:
    target = tmp_path / "half"
    with pytest.raises((UsageError, KeyboardInterrupt)):
        break_off(target, error)
    assert not target.exists()


def break_off(target: Path, error: BaseException) -> None:
    with new_file(target) as stream:
        stream.write(b"half")
        raise error


def test_what_cannot_be_is_told_and_nothing_is_written(
    cli: CommandLine, flight: Path, tmp_path: Path
) -> None:
    there = tmp_path / "there.html"
    there.write_text("mine", encoding="utf-8")
    junk = tmp_path / "junk.mcap"
    junk.write_bytes(b"no log")
    for words, why in (
        ((str(flight), "-o", str(tmp_path / "x.svg")), "neither a page nor a picture"),
        ((str(flight), "-o", str(there)), "is there already"),
        ((str(flight), "-o", str(tmp_path / "no/where.html")), "cannot be written"),
        ((str(junk),), "is not a flight log"),
        ((str(tmp_path / "none.mcap"),), "No such file"),
    ):
        outcome = cli("log", "plot", *words)
        assert outcome.status == ExitCode.USAGE, words
        assert why in " ".join(outcome.err.split()), words
    assert there.read_text("utf-8") == "mine"
    assert sorted(path.name for path in tmp_path.glob("*.html")) == ["there.html"]
