from __future__ import annotations

import ast
import importlib.util
from types import ModuleType

import pytest

from tests.test_house import GENERATED, PACKAGE


@pytest.fixture(scope="module")
def generate() -> ModuleType:
    """By its path: the tests run on the installed package, and the generator is in no wheel."""
    spec = importlib.util.spec_from_file_location("generate", PACKAGE / "sync/generate.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def statements(text: str) -> tuple[set[str], list[str]]:
    """The imported names, and all the rest in its order; how either is written does not count."""
    imported: set[str] = set()
    rest: list[str] = []
    for node in ast.parse(text).body:
        if isinstance(node, ast.ImportFrom):
            imported |= {f"{node.module} {name.name} {name.asname}" for name in node.names}
        else:
            rest.append(ast.dump(node))
    return imported, rest


@pytest.mark.parametrize("name", ["aircraft.py", "control.py", "payload.py"])
def test_what_is_committed_is_what_the_generator_writes_now(
    generate: ModuleType, name: str
) -> None:
    text = (PACKAGE / "sync" / name).read_text(encoding="utf-8")
    written = statements(generate.SOURCES[name]())
    assert statements(text) == written, "the API with await has changed: nox -s sync"


def test_every_generated_module_is_known_to_the_house(generate: ModuleType) -> None:
    assert {PACKAGE / "sync" / name for name in generate.SOURCES} == GENERATED
