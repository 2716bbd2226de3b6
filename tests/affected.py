"""Names the test files that a change can touch, by what imports what: ``python -m tests.affected``.

A test file is touched if it changed, or if it imports a module that did, at any distance. The
conftest.py of its folders is imported by it; a string that is the name of a module, of a verb's
module as the command line has it, or of the program counts as an import of that. What is no module,
as a page or a table, touches the tests that name its file, or a pattern like ``*.md``, in a string.
"""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from fnmatch import fnmatch
from functools import cache

from tests.test_house import ROOT, name_of, programs, tree

MODULES = {name_of(path): path for path in programs("m100link", "tests", "benchmarks")}
EVERYWHERE = ("pyproject.toml", "requirements-dev.txt", "tests/conftest.py", "tests/rig.py")
"""What every test depends on, imported or not."""


def changed(since: str) -> set[str]:
    """Paths of files that are not as they were in a commit, or that no commit has."""
    asked = (("diff", "--name-only", since), ("ls-files", "--others", "--exclude-standard"))
    told = [
        subprocess.run(("git", *words), cwd=ROOT, capture_output=True, text=True, check=False)
        for words in asked
    ]
    if why := "".join(one.stderr for one in told):
        sys.exit(why)
    return set("".join(one.stdout for one in told).split())


@cache
def named(module: str) -> frozenset[str]:
    """Modules that a module imports, or names in a string, with the packages that hold them."""
    folders = module.split(".")[:-1]
    found = {".".join([*folders[:end], "conftest"]) for end in range(2, len(folders) + 1)}
    for node in ast.walk(tree(MODULES[module])):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            found |= {node.module, *(f"{node.module}.{alias.name}" for alias in node.names)}
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            text = node.value.partition(":")[0]
            is_verb = module == "m100link.apps.cli.app"
            is_program = text == "m100link" or "from m100link.apps.cli import" in text
            found.add(f"m100link.apps.cli.{text}" if is_verb else text)
            if is_program and module.startswith("tests."):
                found.add("m100link.apps.cli.app")
    return frozenset(found & MODULES.keys())


@cache
def files(module: str) -> frozenset[str]:
    """Names of files, and patterns of them, in the strings of a module."""
    texts = (
        node.value.rpartition("/")[2]
        for node in ast.walk(tree(MODULES[module]))
        if isinstance(node, ast.Constant) and isinstance(node.value, str)
    )
    return frozenset(text for text in texts if re.fullmatch(r"[\w*-]*\.?[\w*-]+\.\w+", text))


def reached(module: str) -> set[str]:
    """Modules that are imported by a module, or by what it imports; and itself."""
    found, waiting = {module}, [module]
    while waiting:
        new = named(waiting.pop()) - found
        found |= new
        waiting += new
    return found


def affected(paths: set[str]) -> list[str]:
    """Test files that a change of these paths can touch."""
    tests = sorted(name for name in MODULES if name.split(".")[-1].startswith("test_"))
    names = {name for name, path in MODULES.items() if str(path.relative_to(ROOT)) in paths}
    others = {path.rpartition("/")[2] for path in paths} - {MODULES[name].name for name in names}
    is_everywhere = bool(paths & {*EVERYWHERE})

    def is_touched(test: str) -> bool:
        there = reached(test)
        read = {text for module in there if module.startswith("tests.") for text in files(module)}
        return bool(names & there) or any(fnmatch(one, text) for one in others for text in read)

    return [
        str(MODULES[test].relative_to(ROOT)) for test in tests if is_everywhere or is_touched(test)
    ]


def main() -> None:
    since = sys.argv[1] if len(sys.argv) > 1 else "HEAD"
    sys.stdout.write("\n".join(affected(changed(since))))


if __name__ == "__main__":
    main()
