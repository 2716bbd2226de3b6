"""What a wheel has beside the modules: the manual for `m100link docs`, its commit, and a README.

The pages are packed as they are written, whatever is installed where the wheel is built; the
command makes their tables by the modules of docs/_ext. The source archive keeps the commit in a
file of its own, because a wheel that is built of it sees no repository. A README that is
read outside of a clone, as on a page of an index, has no links into one.
"""

from __future__ import annotations

import re
import subprocess
import tempfile
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface
from hatchling.metadata.plugin.interface import MetadataHookInterface

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


class Readme(MetadataHookInterface):
    """Gives the metadata the README."""

    def update(self, metadata: dict[str, Any]) -> None:
        """Called before the metadata are written."""
        text = Path(self.root, "README.md").read_text(encoding="utf-8")
        source = metadata.get("urls", {}).get("Source", "")
        place = f"{source}/blob/v{metadata['version']}" if source else ""
        metadata["readme"] = {"content-type": "text/markdown", "text": abroad(text, place)}


_PICTURE = re.compile(r"^!\[[^\]]*\]\((?!\w+:)[^)]*\)\n\n?", re.MULTILINE)
_LINK = re.compile(r"\[([^\]]+)\]\((?!\w+:)(?:docs/([\w/-]+)\.md)?([^)#]*)(#[^)]*)?\)")


def abroad(text: str, place: str) -> str:
    """The text with its links below a place; without one they name a page of the command."""

    def linked(found: re.Match[str]) -> str:
        words, page, path, anchor = found.groups()
        if place:
            target = f"docs/{page}.md" if page else path
            return f"[{words}]({place}/{target}{anchor or ''})"
        folder, _, topic = (page or "").rpartition("/")
        is_packed = folder not in ("", "project") and topic != "index"
        return f"{words} (`m100link docs {topic}`)" if is_packed else words

    return _LINK.sub(linked, _PICTURE.sub("", text))
