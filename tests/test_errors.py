"""The tree of errors: its drawing, and that users can catch every one by name."""

from __future__ import annotations

import inspect
import re

import m100link
from m100link import errors


def error_tree() -> dict[str, str]:
    """Name of each error and of its parent, from the drawing in the docstring."""
    parents: dict[str, str] = {}
    path: list[str] = []
    for line in inspect.cleandoc(errors.__doc__ or "").splitlines():
        match = re.match(r"(?P<indent>\s*(?:│ {3}| {4})*)(?P<branch>[├└]── )?(?P<name>\w+)\b", line)
        if match is None or match["name"] not in vars(errors):
            continue
        name = match["name"]
        depth = (len(match["indent"]) - 4) // 4 + (1 if match["branch"] else 0)
        del path[depth:]
        if path:
            parents[name] = path[-1]
        path.append(name)
    return parents


def test_drawing_of_the_error_tree_matches_the_classes() -> None:
    classes = [vars(errors)[name] for name in errors.__all__]
    actual = {
        cls.__name__: base.__name__
        for cls in classes
        for base in cls.__bases__
        if issubclass(base, errors.M100Error)
    }
    assert error_tree() == actual


def test_every_error_is_public_and_derives_from_one_base() -> None:
    defined = {
        name
        for name, value in vars(errors).items()
        if inspect.isclass(value) and issubclass(value, BaseException)
    }
    assert defined | {"LossReason"} == set(errors.__all__)
    assert defined <= set(m100link.__all__)
