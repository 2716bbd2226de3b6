"""Which keys a pattern names."""

from __future__ import annotations

import pytest

from m100link.apps.bus.network import fits


@pytest.mark.parametrize(
    ("pattern", "key", "does"),
    [
        ("a/b", "a/b", True),
        ("a/b", "a/c", False),
        ("a/*/c", "a/b/c", True),
        ("a/*/c", "a/b/b/c", False),
        ("a/*", "a", False),
        ("a/**", "a", True),
        ("a/**", "a/b/c", True),
        ("**/c", "a/b/c", True),
        ("a/**/c", "a/c", True),
        ("a/**/c", "a/b/d", False),
        ("*", "a/b", False),
        ("**", "a", True),
        ("a/**/c", "a/b/b/c", True),
        ("a/**/c", "a/c/b", False),
        ("a/b", "a/b/c", False),
    ],
)
def test_words_and_stars(pattern: str, key: str, does: bool) -> None:
    assert fits(pattern, key) is does
