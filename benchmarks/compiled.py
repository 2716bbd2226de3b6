"""C floors: small programs, compiled on the spot where a compiler is."""

from __future__ import annotations

import os
import shutil
import subprocess
import tempfile
from contextlib import ExitStack
from functools import cache
from pathlib import Path

from benchmarks.rows import NotMeasured

HERE = Path(__file__).parent


@cache
def compiler() -> str | None:
    """The C compiler: what CC names, else the first of the usual names."""
    wanted = os.environ.get("CC") or "cc"
    return next(filter(None, map(shutil.which, (wanted, "gcc", "clang"))), None)


def compiled(source: str, stack: ExitStack) -> Path:
    """The program of a C file that stands beside this one, built with ``-O2``.

    Raises:
        NotMeasured: There is no compiler, or it refused.
    """
    found = compiler()
    if found is None:
        raise NotMeasured("no C compiler")
    place = Path(stack.enter_context(tempfile.TemporaryDirectory()))
    program = place / Path(source).stem
    command = [found, "-O2", "-o", str(program), str(HERE / source)]
    built = subprocess.run(command, capture_output=True, text=True, check=False)
    if built.returncode != 0:
        raise NotMeasured(f"{Path(found).name} refused {source}: {built.stderr.strip()[-200:]}")
    return program
