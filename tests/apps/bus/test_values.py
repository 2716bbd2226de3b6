"""Values in and out of the bus."""

from __future__ import annotations

from tests import limits


def test_each_limit_is_as_agreed() -> None:
    assert limits.differences("apps/bus") == []
