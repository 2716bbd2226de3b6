"""Pages that begin with nothing installed and end with a program of the reader, followed literally.

What the blocks of such a page are:

- a file, when the first line is a comment with its name; a later block may replace it;
- a cell of a notebook, when it is Python without a name;
- commands of a shell (``sh``); behind ``# another terminal`` they run until the page ends;
- what the block before it prints (``text``): each line comes, in this order. Numbers may be others,
  and ``…`` stands for anything.

``python -m tests.tutorials`` (``nox -s newcomers``) follows pages as a newcomer does, in a copy of
this tree: it installs what the page says, and nothing else. Tests have that installed already.
"""

from __future__ import annotations

import ast
import asyncio
import inspect
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

from m100link.errors import M100Error
from m100link.sim import VirtualClockEventLoop
from tests.waiting import PATIENCE, again_and_again

ROOT = Path(__file__).parent.parent
# Where each tutorial is: a page, or a section of one.
PAGES = {
    "offboard": ("docs/tutorial/offboard.md", ""),
    "notebook": ("docs/tutorial/notebook.md", ""),
    "tests": ("docs/howto/test-your-program.md", ""),
    "ros2": ("docs/howto/fly-by-ros2.md", "From nothing to a program with rclpy"),
    "roslibpy": ("docs/howto/ground-station.md", "Programs with roslib and roslibpy"),
    "mavsdk": ("docs/howto/fly-by-mavlink.md", "From nothing to a program with MAVSDK"),
    "fleet": ("docs/howto/fly-a-fleet.md", "From nothing to a fleet that flies"),
}
_BLOCK = re.compile(r"^```(\w+)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
_NAME = re.compile(r"# ([\w./-]+\.\w+)\n")
_NUMBER = re.compile(r"\d+(?:\\?\.\d+)?")
_ELSEWHERE = "# another terminal\n"
_INSTALLS = re.compile(r"^(?:python3 -m venv|\. \S+/activate|(?:\S+/)?pip install) ?.*\n", re.M)


class Block(NamedTuple):
    """A block of a page."""

    kind: str
    text: str
    shown: str  # what it prints, by the page

    @property
    def name(self) -> str:
        found = _NAME.match(self.text)
        return found[1] if found else ""

    def lacks(self, printed: str) -> str:
        """The first line that the page shows and that was not printed, in its order."""
        lines = iter(printed.splitlines())
        for shown in self.shown.splitlines():
            wanted = _NUMBER.sub(r"\\d+(?:\\.\\d+)?", re.escape(shown)).replace("…", ".*")
            if not any(re.fullmatch(wanted, line.strip()) for line in lines):
                return shown
        return ""


def blocks(tutorial: str) -> list[Block]:
    """The blocks of a tutorial, in the order of its page."""
    page, section = PAGES[tutorial]
    text = (ROOT / page).read_text(encoding="utf-8")
    if section:
        [text] = re.findall(rf"^## {section}$(.*?)(?=^## |\Z)", text, re.MULTILINE | re.DOTALL)
    made: list[Block] = []
    for kind, block in _BLOCK.findall(text):
        if kind == "text" and made and not made[-1].shown:
            made[-1] = made[-1]._replace(shown=block)
        elif kind in ("sh", "python", "toml"):
            made.append(Block(kind, block, ""))
    return made


# -- on virtual time -------------------------------------------------------------------------------


class Virtual:
    """Runs what needs nothing but the library: cells, and ``python FILE`` of the shell."""

    def __init__(self, folder: Path, capsys: Any, monkeypatch: Any) -> None:
        self.folder, self.capsys, self.monkeypatch = folder, capsys, monkeypatch
        self.cells: dict[str, Any] = {}
        self.ran = 0
        monkeypatch.chdir(folder)
        monkeypatch.syspath_prepend(str(folder))
        monkeypatch.setattr(asyncio, "run", self._wait)

    def follow(self, tutorial: str) -> None:
        for block in blocks(tutorial):
            if block.name:
                (self.folder / block.name).write_text(block.text, encoding="utf-8")
            elif block.text.startswith(_ELSEWHERE):
                return  # from here on it needs a second process
            elif block.kind == "python":
                self._run(block.text, self.cells, block)
            elif found := re.fullmatch(r"python (\w+\.py)\n", block.text):
                program = (self.folder / found[1]).read_text(encoding="utf-8")
                self.monkeypatch.setattr(sys, "argv", [found[1]])
                self._run(program, {"__name__": "__main__"}, block)

    def _run(self, program: str, names: dict[str, Any], block: Block) -> None:
        code = compile(program, block.name or "a cell", "exec", ast.PyCF_ALLOW_TOP_LEVEL_AWAIT)
        try:
            made = eval(code, names)
            if inspect.iscoroutine(made):
                self._wait(made)
        except M100Error as error:
            print(f"m100link.errors.{type(error).__name__}: {error}")  # noqa: T201 - as Python does
        printed = self.capsys.readouterr().out
        assert not block.lacks(printed), (block.shown, printed)
        self.ran += 1

    @staticmethod
    def _wait(coroutine: Any) -> Any:
        with asyncio.Runner(loop_factory=VirtualClockEventLoop) as runner:
            return runner.run(coroutine)


# -- literally -------------------------------------------------------------------------------------


class Reader:
    """Types what a page says, in a folder of its own, in real time.

    Args:
        folder: Where; its folder `clone` has the source, if that is to be installed.
        replaced: Texts of the page that are others here, such as ports.
        python: The Python that stands for the environment of the page.
        installs: Whether it installs as well.
        environment: More variables.
    """

    def __init__(
        self,
        folder: Path,
        replaced: Mapping[str, str] | None = None,
        *,
        python: str = sys.executable,
        installs: bool = False,
        environment: Mapping[str, str] | None = None,
    ) -> None:
        self.folder, self.replaced, self.installs = folder / "clone", replaced or {}, installs
        kept = {k: v for k, v in os.environ.items() if not k.startswith(("M100LINK_", "XDG_"))}
        self.environment = {**kept, "PYTHONUNBUFFERED": "1", **(environment or {})}
        tools = self.folder / (".venv/bin" if installs else "bin")
        self._prepend("PATH", tools)
        if installs:
            self.environment.pop("PYTHONPATH", None)
            return
        self.environment["HOME"] = str(folder)
        self._prepend("PYTHONPATH", ROOT)
        tools.mkdir(parents=True)
        for name, words in {"m100link": "-m m100link", "python": "", "pytest": "-m pytest"}.items():
            (tools / name).write_text(f'#!/bin/sh\nexec {python} {words} "$@"\n')
            (tools / name).chmod(0o755)

    def _prepend(self, variable: str, place: Path) -> None:
        old = self.environment.get(variable)
        self.environment[variable] = os.pathsep.join([str(place), *([old] if old else [])])

    def follow(self, tutorial: str) -> None:
        with ExitStack() as terminals:
            # Simulators of others are not those of this reader, and paths of sockets are short.
            own = terminals.enter_context(TemporaryDirectory())
            self.environment["XDG_RUNTIME_DIR"] = own
            for number, block in enumerate(blocks(tutorial)):
                text = block.text
                for old, new in self.replaced.items():
                    text = text.replace(old, new)
                if block.name:
                    (self.folder / block.name).write_text(text, encoding="utf-8")
                elif block.kind == "sh" and text.startswith(_ELSEWHERE):
                    output = self.folder / f"terminal {number}"
                    terminals.enter_context(self._terminal(text, block, output))
                elif block.kind == "sh":
                    self._type(text if self.installs else _INSTALLS.sub("", text), block)

    @contextmanager
    def _terminal(self, text: str, block: Block, output: Path) -> Iterator[None]:
        """Another terminal: the reader goes on when it shows something, or what the page shows."""
        with (
            output.open("wb") as shown,
            subprocess.Popen(
                ["bash", "-c", text],
                cwd=self.folder,
                env=self.environment,
                stdin=subprocess.DEVNULL,
                stdout=shown,
                stderr=subprocess.STDOUT,
                start_new_session=True,
            ) as process,
        ):
            try:
                for _ in again_and_again():
                    printed = output.read_text(encoding="utf-8")
                    if process.poll() is not None or (printed and not block.lacks(printed)):
                        break
                    time.sleep(0.05)
                assert process.poll() is None, printed
                yield
            finally:
                for number in (signal.SIGINT, signal.SIGTERM, signal.SIGKILL):
                    if process.poll() is None:
                        os.killpg(process.pid, number)
                        with suppress(subprocess.TimeoutExpired):
                            process.wait(PATIENCE / 6)

    def _type(self, text: str, block: Block) -> None:
        if found := re.search(r"^cd (\S+)$", text, re.MULTILINE):
            self.folder = (self.folder / found[1]).resolve()
            self.folder.mkdir()
            return
        for line in re.findall(r"^export (.*)$", text, re.MULTILINE):
            self.environment |= dict(re.findall(r"(\w+)=(\S+)", line))
        done = subprocess.run(
            ["bash", "-e", "-c", text],
            cwd=self.folder,
            env=self.environment,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            timeout=600,
            check=False,
        )
        assert (done.returncode != 0) == ("m100link.errors." in block.shown), done.stdout
        assert not block.lacks(done.stdout), (block.shown, done.stdout)
        if done.returncode:
            time.sleep(6.0)  # the reader reads the error; the aircraft lands meanwhile


def begin_with_nothing(tutorial: str, folder: Path) -> None:
    """Copy this tree, install what the page says and nothing else, and do what it says."""
    left_out = shutil.ignore_patterns(".git", ".venv", ".nox", "_build", "__pycache__")
    shutil.copytree(ROOT, folder / "clone", ignore=left_out)
    reader = Reader(folder, installs=True)
    reader.follow(tutorial)
    cells = [one.text.rstrip() for one in blocks(tutorial) if one.kind == "python" and not one.name]
    if cells:
        kept: dict[str, Any] = {
            "cell_type": "code",
            "metadata": {},
            "execution_count": None,
            "outputs": [],
        }
        listed = [{**kept, "id": f"c{number}", "source": one} for number, one in enumerate(cells)]
        notebook = {"cells": listed, "metadata": {}, "nbformat": 4, "nbformat_minor": 5}
        (reader.folder / "own.ipynb").write_text(json.dumps(notebook), encoding="utf-8")
        environment = reader.environment
        command = ("jupyter", "execute", "--kernel_name=python3", "own.ipynb")
        subprocess.run(command, cwd=reader.folder, env=environment, check=True)


if __name__ == "__main__":
    for asked in sys.argv[1:] or PAGES:
        with TemporaryDirectory() as place:
            began = time.monotonic()
            begin_with_nothing(asked, Path(place))
        print(f"{asked}: {time.monotonic() - began:.0f} s", flush=True)  # noqa: T201 - the result
