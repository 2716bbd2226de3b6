"""Folders that the station serves."""

from __future__ import annotations

import os
from pathlib import Path

from starlette.staticfiles import StaticFiles

__all__ = ["PublicFiles"]


class PublicFiles(StaticFiles):
    """The files of a folder without those whose name, or that of a folder above, has a dot first.

    ``.git``, ``.env`` and the like lie in many a folder, and nobody means to publish them. A link
    counts as what it points to.
    """

    def lookup_path(self, path: str) -> tuple[str, os.stat_result | None]:
        """Where the file is; there is none where one is hidden."""
        found, status = super().lookup_path(path)
        for directory in self.all_directories if status is not None else ():
            inside = os.path.relpath(os.path.realpath(found), os.path.realpath(directory))
            parts = [*Path(path).parts, *Path(inside).parts]
            if any(part.startswith(".") and part not in (".", "..") for part in parts):
                return "", None
        return found, status
