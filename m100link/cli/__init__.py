"""The command line. Needs the extra ``cli``."""

from __future__ import annotations

import sys

__all__ = ["main"]


def main() -> None:
    """Entry point of the ``m100link`` command."""
    try:
        import cyclopts  # noqa: F401 - only whether it is there
        import rich  # noqa: F401 - only whether it is there
    except ModuleNotFoundError as error:
        sys.stderr.write(
            f"m100link's command line needs {error.name}, which is not installed.\n"
            "  what to do:   pip install 'm100link[cli]'\n"
        )
        raise SystemExit(2) from None
    from m100link.cli.app import run

    run()
