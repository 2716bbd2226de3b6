"""What a wheel has beside the modules: the manual for `m100link docs`, and the commit it is of.

The pages are packed as they are written, whatever is installed where the wheel is built; the
command makes their tables by the modules of docs/_ext. The source archive keeps the commit in a
file of its own, because a wheel that is built of it sees no repository.
"""

from __future__ import annotations

import subprocess
import tempfile
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

PLACE = "m100link/manual"
COMMIT = "COMMIT"
PAGES = ("docs/*/*.md", "docs/_ext/*.py", "examples/look_around.py")  # a page shows the program
LEFT_OUT = "docs/project/"


class Manual(BuildHookInterface[Any]):
    """Adds them to what is packed."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Called before anything is packed; an editable install finds all where it is."""
        if version == "editable":
            return
        root = Path(self.root)
        kept = Path(tempfile.mkdtemp()) / COMMIT
        kept.write_text(commit(root), encoding="utf-8")
        is_wheel = self.target_name == "wheel"
        packed = build_data["force_include"]
        packed[str(kept)] = f"{PLACE}/{COMMIT}" if is_wheel else COMMIT
        for path in (path for one in PAGES if is_wheel for path in sorted(root.glob(one))):
            place = path.relative_to(root).as_posix()
            if not place.startswith(LEFT_OUT):
                packed[str(path)] = f"{PLACE}/{place.removeprefix('docs/')}"


def commit(root: Path) -> str:
    """The commit of this tree, with a + if it was changed; empty where nothing says it."""
    kept = root / COMMIT
    if kept.exists():
        return kept.read_text(encoding="utf-8")
    if not (root / ".git").exists():
        return ""
    asked = ("git", "describe", "--always", "--exclude=*", "--abbrev=12", "--dirty=+")
    try:
        told = subprocess.run(asked, cwd=root, capture_output=True, text=True, check=False)
    except OSError:  # there is no git here
        return ""
    return told.stdout.strip()
