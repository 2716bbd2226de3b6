"""Keys are written in one place, and names are words."""

from __future__ import annotations

import pytest

from m100link.apps.fleet.keys import Keys, check_name, in_order, name_in
from m100link.errors import UsageError


def test_keys_of_one_and_of_all() -> None:
    keys = Keys("field", "a1")
    assert (keys.live, keys.live_by("9f")) == ("m100-live/field/a1/*", "m100-live/field/a1/9f")
    assert keys.command == "m100/field/a1/cmd"
    assert (keys.telemetry, keys.thinned) == ("m100/field/a1/tel", "m100/field/a1/tel/5hz")
    assert keys.status("abc") == "m100/field/a1/status/abc"
    assert Keys("field").state == "m100/field/*/state"


def test_the_name_in_a_key() -> None:
    assert name_in("m100-live/field/a1/9f") == "a1"
    assert name_in("m100/field") == ""
    assert name_in("other/field/a1") == ""
    assert name_in("m100-live/field/no name/9f") == ""
    assert name_in(f"m100/field/{'a' * 33}/state") == ""


@pytest.mark.parametrize("name", ["", "*", "a/b", "a b", "-a", "ä", "a" * 33, "**", "a$*"])
def test_what_cannot_be_a_name(name: str) -> None:
    with pytest.raises(UsageError, match="is no name for"):
        check_name(name)


def test_a_site_is_checked_as_well() -> None:
    with pytest.raises(UsageError, match="is no name for a site"):
        Keys("**", "a1")


def test_names_are_in_the_order_in_which_people_count() -> None:
    names = ["b1", "a10", "a", "a2", "2", "a2-b10", "a2-b9", "10"]
    assert in_order(names) == ["2", "10", "a", "a2", "a2-b9", "a2-b10", "a10", "b1"]
