"""The manual in the wheel, for `m100link docs`.

Where Sphinx is installed (`nox -s build`) the pages are made as text, with every table and class in
them. In the environment that pip makes to install from a source tree it is not: the pages are then
taken as they are written, and the command makes their tables by the modules of docs/_ext.
"""

from __future__ import annotations

import importlib.util
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

PLACE = "m100link/manual"
FOLDERS = ("tutorial", "howto", "reference", "explanation")
PROGRAM = "examples/first_flight.py"  # which a page shows


class Manual(BuildHookInterface[Any]):
    """Adds the pages to what is packed."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Called before a wheel is packed; an editable one finds the pages where they are."""
        if version == "editable":
            return
        source = Path(self.root) / "docs"
        suffix = ".md"
        build_data["force_include"][str(Path(self.root) / PROGRAM)] = f"{PLACE}/{PROGRAM}"
        if importlib.util.find_spec("sphinx") and importlib.util.find_spec("myst_parser"):
            made = tempfile.mkdtemp()
            command = ("-m", "sphinx", "-q", "-b", "text", "-d", f"{made}/.doctrees")
            subprocess.run([sys.executable, *command, str(source), f"{made}/text"], check=True)
            source, suffix = Path(made) / "text", ".txt"
        for table in () if suffix == ".txt" else sorted((source / "_ext").glob("*.py")):
            build_data["force_include"][str(table)] = f"{PLACE}/_ext/{table.name}"
        for folder in FOLDERS:
            index = Path(self.root) / "docs" / folder / "index.md"  # `m100link docs` lists by it
            if index.exists():
                build_data["force_include"][str(index)] = f"{PLACE}/{folder}/index.md"
            for page in sorted((source / folder).glob(f"*{suffix}")):
                if page.stem != "index":
                    build_data["force_include"][str(page)] = f"{PLACE}/{folder}/{page.name}"
