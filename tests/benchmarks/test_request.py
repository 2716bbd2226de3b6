"""Requests over a pseudo-terminal: both other ends ack, with a compiler and without."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path

import pytest

from benchmarks import request
from benchmarks.rows import Absent, NotMeasured, Setting


def test_without_a_compiler_python_answers_and_the_floor_says_why_it_is_missing(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def refuse(source: str, stack: ExitStack) -> Path:
        raise NotMeasured("no C compiler")

    monkeypatch.setattr(request, "compiled", refuse)
    setting = Setting(is_quick=True)
    with ExitStack() as stack:
        (side,) = request.ours(setting, stack)
        costs = side.costs()
        assert set(costs) == {f"{request.REQUEST}, CPU", f"{request.REQUEST}, p50"}
        assert all(cost > 0 for cost in costs.values())
        missing = [one for one in request.others(setting, stack) if isinstance(one, Absent)]
    assert (request.FLOOR, "no C compiler") in [(one.name, one.reason) for one in missing]
