"""Keys are written in one place, and names are words."""

from __future__ import annotations

import pytest

from m100link.errors import UsageError
from m100link.fleet.keys import Keys, check_name, name_in


def test_keys_of_one_and_of_all() -> None:
    keys = Keys("field", "a1")
    assert (keys.live, keys.command) == ("m100-live/field/a1", "m100/field/a1/cmd")
    assert (keys.telemetry, keys.thinned) == ("m100/field/a1/tel", "m100/field/a1/tel/5hz")
    assert keys.status("abc") == "m100/field/a1/status/abc"
    assert Keys("field").state == "m100/field/*/state"


def test_the_name_in_a_key() -> None:
    assert name_in("m100-live/field/a1") == "a1"
    assert name_in("m100/field") == ""
    assert name_in("other/field/a1") == ""


@pytest.mark.parametrize("name", ["", "*", "a/b", "a b", "-a", "ä", "a" * 33, "**", "a$*"])
def test_what_cannot_be_a_name(name: str) -> None:
    with pytest.raises(UsageError, match="is no name for"):
        check_name(name)


def test_a_site_is_checked_as_well() -> None:
    with pytest.raises(UsageError, match="is no name for a site"):
        Keys("**", "a1")
