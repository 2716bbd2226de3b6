"""Values in and out of missions."""

from __future__ import annotations

from tests import limits


def test_each_limit_is_as_agreed() -> None:
    assert limits.differences("missions") == []
