"""``m100link completion``: what a shell needs to complete this command."""

from __future__ import annotations

import sys
from typing import Annotated, Literal

from cyclopts import Parameter

from m100link.apps.cli.outcome import ExitCode
from m100link.errors import UsageError

__all__ = ["completion"]

Shell = Literal["bash", "zsh", "fish"]


def completion(
    shell: Annotated[
        Shell | None, Parameter(help="Which shell; by default the one that this is typed in")
    ] = None,
    /,
    *,
    install: Annotated[bool, Parameter(negative=())] = False,
) -> int:
    """Print what completes verbs, options and aircraft in a shell, or install it there.

    Args:
        shell: Which shell.
        install: Write it where the shell looks for it, and have bash and zsh load it: a line in
            ~/.bashrc or ~/.zshrc.
    """
    from m100link.apps.cli.app import app

    shell = shell or _detected()
    if install:
        place = app.install_completion(shell=shell)
        sys.stderr.write(f"written to {place}; a {shell} that is started now completes m100link\n")
    else:
        sys.stdout.write(app.generate_completion(shell=shell))
    return ExitCode.OK


def _detected() -> Shell:
    from cyclopts.completion import ShellDetectionError, detect_shell

    try:
        found = detect_shell()
    except ShellDetectionError:
        found = None
    for shell in ("bash", "zsh", "fish"):
        if shell == found:
            return shell
    raise UsageError("the shell is none that is known here", remedy="name it: bash, zsh or fish")
