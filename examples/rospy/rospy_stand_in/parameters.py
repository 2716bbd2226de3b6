"""Parameters by name: those of the command line and of a launch file, and what the program sets."""

from __future__ import annotations

from importlib import import_module
from importlib.util import find_spec
from typing import Any


class ParameterStore:
    """As a parameter server has them: a dict is a namespace, whose entries have names of their own.

    ``values``: all of them by their whole names.
    """

    def __init__(self) -> None:
        self.values: dict[str, Any] = {}

    def get(self, name: str) -> Any:
        """A value, or a namespace as a dict. Raises KeyError: neither is there."""
        if name in self.values:
            return self.values[name]
        found: dict[str, Any] = {}
        for key in self._below(name):
            *inner, last = key[len(name) :].strip("/").split("/")
            place = found
            for one in inner:
                place = place.setdefault(one, {})
            place[last] = self.values[key]
        if not found:
            raise KeyError(name)
        return found

    def set(self, name: str, value: Any) -> None:
        """In place of what has that name, and of a namespace of that name."""
        for key in (name, *self._below(name)):
            self.values.pop(key, None)
        if not isinstance(value, dict):
            self.values[name] = value
            return
        for key, inner in value.items():
            self.set(f"{name.rstrip('/')}/{key}", inner)

    def _below(self, name: str) -> list[str]:
        return [key for key in self.values if key.startswith(name.rstrip("/") + "/")]


def value_of(text: str) -> Any:
    """As rospy reads it: YAML, where PyYAML is there."""
    if find_spec("yaml") is not None:
        yaml = import_module("yaml")
        try:
            return yaml.safe_load(text)
        except yaml.YAMLError:
            return text
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            pass
    return {"true": True, "false": False}.get(text.lower(), text)
