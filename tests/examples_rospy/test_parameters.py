"""Parameters of a program: by name, as a parameter server has them."""

from __future__ import annotations

from typing import Any

import pytest
from rospy_stand_in.parameters import ParameterStore, value_of


def test_a_dict_is_a_namespace() -> None:
    store = ParameterStore()
    store.set("/a", {"b": {"c": 1, "d": [2]}, "e": "f"})
    assert store.values == {"/a/b/c": 1, "/a/b/d": [2], "/a/e": "f"}
    assert (store.get("/a/b/c"), store.get("/a/b")) == (1, {"c": 1, "d": [2]})
    assert store.get("/") == {"a": {"b": {"c": 1, "d": [2]}, "e": "f"}}
    store.set("/a/b", 3)
    assert store.get("/a") == {"b": 3, "e": "f"}
    store.set("/a", {})
    with pytest.raises(KeyError):
        store.get("/a")
    store.set("/ab", 1)
    with pytest.raises(KeyError):
        store.get("/a")


@pytest.mark.parametrize(
    ("text", "value"),
    [("1", 1), ("2.5", 2.5), ("true", True), ("off", False), ("/dev/ttyUSB0", "/dev/ttyUSB0"),
     ("[1, 2]", [1, 2]), ("{a: 1}", {"a": 1}), ("a: b: c", "a: b: c")],
)  # fmt: skip
def test_a_value_of_the_command_line_is_yaml(text: str, value: Any) -> None:
    pytest.importorskip("yaml")
    assert value_of(text) == value
