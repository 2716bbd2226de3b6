"""C floors: compiled on the spot, or a reason why not."""

from __future__ import annotations

import subprocess
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest

from benchmarks import compiled as module
from benchmarks.compiled import compiled, compiler
from benchmarks.rows import NotMeasured


@pytest.fixture(autouse=True)
def asked_anew() -> Iterator[None]:
    compiler.cache_clear()
    yield
    compiler.cache_clear()


def write(folder: Path, text: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "HERE", folder)
    (folder / "floor.c").write_text(text)


@pytest.mark.skipif(compiler() is None, reason="no C compiler")
def test_a_floor_is_built_and_gone_afterwards(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write(tmp_path, "int main(void) { return 7; }", monkeypatch)
    with ExitStack() as stack:
        program = compiled("floor.c", stack)
        assert subprocess.run([program], check=False).returncode == 7
    assert not program.exists()


@pytest.mark.skipif(compiler() is None, reason="no C compiler")
def test_what_the_compiler_refuses_is_reported(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write(tmp_path, "int main(void) { nonsense }", monkeypatch)
    with (
        ExitStack() as stack,
        pytest.raises(NotMeasured, match=r"refused floor\.c: (?s:.*)nonsense"),
    ):
        compiled("floor.c", stack)


def test_without_a_compiler_there_is_a_reason(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", "")
    monkeypatch.delenv("CC", raising=False)
    with ExitStack() as stack, pytest.raises(NotMeasured, match="no C compiler"):
        compiled("floor.c", stack)
