"""The short form of `python -m tests.faults.damaged_files`."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.faults.damaged_files import SEED, run
from tests.faults.damaged_kinds import KINDS

FILES = {"log": 100, "ledger": 60, "mark": 60}


@pytest.mark.parametrize("kind", KINDS)
def test_no_loss_goes_unreported(kind: str, tmp_path: Path) -> None:
    wholes, judge = KINDS[kind](tmp_path)
    found = run(kind, wholes, judge, FILES.get(kind, 300), SEED)
    assert found["untold"] == 0
    assert len(found) >= 8, "of each kind of damage some"
