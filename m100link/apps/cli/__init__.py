"""The command line. Needs the extra ``cli``. Its verbs are promised, its modules are not."""

from __future__ import annotations

import gc
import importlib
import os
import signal
import sys


def main() -> None:
    """Entry point of the ``m100link`` command.

    Loading takes up to seconds on a busy machine: Ctrl-C in that time ends it with a line.
    """
    gc.disable()  # what is loaded stays: walking through it again and again takes a tenth
    is_ours = signal.getsignal(signal.SIGINT) is signal.default_int_handler
    if is_ours:  # and not ignored, as in the background of a script
        signal.signal(signal.SIGINT, end_at_once)
    try:
        for package in ("cyclopts", "rich"):
            importlib.import_module(package)
    except ModuleNotFoundError as error:
        from m100link.errors.usage import INSTALL

        needs = f"m100link's command line needs {error.name}, which is not installed.\n"
        sys.stderr.write(f"{needs}  what to do:   {INSTALL.format('cli')}\n")
        raise SystemExit(2) from None
    from m100link.apps.cli.app import run

    gc.freeze()
    gc.enable()
    run()


def end_at_once(*_: object) -> None:
    """Nothing was opened yet.

    An exception would be a traceback out of whatever is being loaded, or be passed over there.
    """
    os.write(2, b"interrupted\n")
    os._exit(130)
