"""The recipes of docs/explanation/house.md, carried out on a copy: each forgotten part is named.

A recipe is a row of text edits. With all of them, a program uses the new part in a fresh process.
Without any one of them, an import or a test fails, and what it prints has the name of what is
missing.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from tests.waiting import PATIENCE

ROOT = Path(__file__).parent.parent.parent

Call = tuple[str, ...]  # arguments of Python


@dataclass(frozen=True)
class Edit:
    """One change of one file; a file that is not there is made."""

    place: str
    after: str  # the text that it goes behind; nothing: the whole file
    text: str

    def of(self, before: str) -> str:
        if not self.after:
            return self.text
        if before.count(self.after) != 1:
            raise LookupError(f"{self.place}: {self.after!r} stands there not once")
        return before.replace(self.after, self.after + self.text)


@dataclass(frozen=True)
class Part:
    """A step of a recipe, and how it is noticed that somebody forgot it."""

    name: str
    edits: tuple[Edit, ...]
    noticed_by: Call = ()  # empty: nothing has to
    named: str = ""  # what stands in that output


@dataclass(frozen=True)
class Recipe:
    name: str
    works: Call  # with all parts
    parts: tuple[Part, ...]


def copied(folder: Path) -> None:
    """What a trial needs of the project."""
    ignored = shutil.ignore_patterns("__pycache__", "*.pyc")
    for name in ("m100link", "tests"):
        shutil.copytree(ROOT / name, folder / name, ignore=ignored)
    for name in ("pyproject.toml", "README.md"):
        shutil.copy(ROOT / name, folder / name)


def carried_out(folder: Path, parts: tuple[Part, ...]) -> None:
    """Edit the copy."""
    for part in parts:
        for edit in part.edits:
            path = folder / edit.place
            before = path.read_text("utf-8") if edit.after else ""
            path.write_text(edit.of(before), "utf-8")


def undone(folder: Path, parts: tuple[Part, ...]) -> None:
    """The files of these parts as they are in the project."""
    for place in {edit.place for part in parts for edit in part.edits}:
        if (ROOT / place).exists():
            shutil.copy(ROOT / place, folder / place)
        else:
            (folder / place).unlink(missing_ok=True)


def said(folder: Path, call: Call) -> tuple[bool, str]:
    """Whether it went well, and all that it printed."""
    environment = os.environ | {"PYTHONPATH": str(folder), "PYTHONDONTWRITEBYTECODE": "1"}
    done = subprocess.run(
        [sys.executable, *call],
        cwd=folder,
        env=environment,
        capture_output=True,
        text=True,
        timeout=PATIENCE,
    )
    return done.returncode == 0, done.stdout + done.stderr


def faults(recipe: Recipe, folder: Path) -> Iterator[str]:
    """What is wrong with a recipe, in words; a copy of the project is in the folder."""
    carried_out(folder, recipe.parts)
    is_well, text = said(folder, recipe.works)
    if not is_well:
        yield f"{recipe.name}: all parts are there, and it does not work:\n{text}"
    for call in dict.fromkeys(part.noticed_by for part in recipe.parts if part.noticed_by):
        is_well, text = said(folder, call)
        if not is_well:  # else it would notice whatever is done
            yield f"{recipe.name}: all parts are there, and {call} fails:\n{text}"
    for part in recipe.parts:
        if not part.noticed_by:
            continue
        undone(folder, recipe.parts)
        carried_out(folder, tuple(one for one in recipe.parts if one is not part))
        is_well, text = said(folder, part.noticed_by)
        if is_well:
            yield f"{recipe.name}: nothing notices that {part.name} is missing"
        elif part.named not in text:
            yield f"{recipe.name}: without {part.name} no output names {part.named!r}:\n{text}"
    undone(folder, recipe.parts)


def test_of(place: str) -> Call:
    # In one process, and without what would cost time in each: plugins, caches, the slow list.
    return ("-m", "pytest", "-q", "-n0", "-x", "-p", "no:cacheprovider", place)


# -- the recipes -----------------------------------------------------------------------------------

_RECORDS, _ITEMS = "m100link/protocol/records.py", "m100link/protocol/items.py"
_TEST_ITEMS = "tests/protocol/test_items.py"
_PUBLIC = f"{_TEST_ITEMS}::test_the_public_records_are_those_of_the_table"

_READ = """
import m100link
from m100link.protocol import PROFILES, TelemetryPacket, encode_telemetry
from m100link.sim import VirtualAircraft

VirtualAircraft(firmware="3.1")
profile = PROFILES["3.1"]
packet = TelemetryPacket(encode_telemetry({"outside_air": [215]}, profile), profile)
assert packet.outside_air == m100link.OutsideAir(215), packet.outside_air
"""

ITEM = Recipe(
    "a telemetry item",
    works=("-c", _READ),
    parts=(
        Part(
            "the record, with its name",
            (
                Edit(
                    _RECORDS,
                    "        return self.percent <= 100\n",
                    "\n\n@quick\nclass OutsideAir(NamedTuple):\n"
                    '    """Temperature of the air."""\n\n'
                    "    tenths: int\n",
                ),
                Edit(_RECORDS, '    "Magnetometer",\n', '    "OutsideAir",\n'),
            ),
            noticed_by=("-c", "import m100link.protocol.items"),
            named="OutsideAir",
        ),
        Part(
            "the name that the package exports",
            (Edit("m100link/__init__.py", '    "Magnetometer",\n', '    "OutsideAir",\n'),),
            noticed_by=test_of(_PUBLIC),
            named="OutsideAir",
        ),
        Part(
            "the row of the table",
            (
                Edit(_ITEMS, "    Magnetometer,\n", "    OutsideAir,\n"),
                Edit(
                    _ITEMS,
                    '        views=("device",),\n    ),\n',
                    '    Item(\n        bit=12,\n        name="outside_air",\n'
                    "        record=OutsideAir,\n        rate_hz=1,\n"
                    '        fields=("tenths",),\n'
                    '        layouts={"3.1": _layout("h", "tenths")},\n    ),\n',
                ),
            ),
            noticed_by=test_of(_PUBLIC),
            named="OutsideAir",
        ),
        Part(
            "its place in Record",
            (Edit(_ITEMS, "    | Battery\n    | ControlDevice\n", "    | OutsideAir\n"),),
            noticed_by=test_of(f"{_TEST_ITEMS}::test_any_record_means_every_record_of_the_table"),
            named="OutsideAir",
        ),
        Part(
            "its view in RecordViews",
            (
                Edit(
                    _ITEMS,
                    "        return self.get(ControlDevice)\n",
                    "\n    @property\n    def outside_air(self) -> OutsideAir | None:\n"
                    '        """Temperature of the air."""\n        return self.get(OutsideAir)\n',
                ),
            ),
            noticed_by=test_of(
                f"{_TEST_ITEMS}::test_every_record_has_its_view_of_packages_and_state"
            ),
            named="outside_air",
        ),
        Part(
            "its reading in the virtual aircraft",
            (
                Edit(
                    "m100link/sim/vehicle/sensors.py",
                    "        return (math.ceil(self._flight.battery_percent),)\n",
                    "\n    def _read_outside_air(self) -> Values:\n        return (215,)\n",
                ),
            ),
            noticed_by=(
                "-c",
                "from m100link.sim import VirtualAircraft; VirtualAircraft(firmware='3.1')",
            ),
            named="outside_air",
        ),
        Part(
            "the names that DJI's document has for it, where it has any",
            (
                Edit(
                    "m100link/telemetry/columns.py",
                    '    "control_device": ("ctrl_device", "status"),\n',
                    '    "outside_air": ("air", "tenths"),\n',
                ),
            ),
        ),
        Part(
            "its row in the table that the test has by hand",
            (Edit(_TEST_ITEMS, '    ("control_device", 0),\n', '    ("outside_air", 1),\n'),),
            noticed_by=test_of(
                f"{_TEST_ITEMS}::test_bits_names_and_rates_are_those_of_the_document"
            ),
            named="outside_air",
        ),
    ),
)

_LISTED = "test_each_verb_is_listed_with_the_first_sentence_of_its_own_help"

VERB = Recipe(
    "a verb of the command line",
    works=(
        "-c",
        "import sys; sys.argv = ['m100link', 'greet']\nfrom m100link.apps.cli import main; main()",
    ),
    parts=(
        Part(
            "its function",
            (
                Edit(
                    "m100link/apps/cli/greeting.py",
                    "",
                    '"""A greeting."""\n\n\ndef greet() -> None:\n    """Say hello."""\n'
                    '    print("hello")\n',
                ),
            ),
            noticed_by=test_of(f"tests/apps/cli/test_app.py::{_LISTED}"),
            named="greeting",
        ),
        Part(
            "its place",
            (
                Edit(
                    "m100link/apps/cli/app.py", "_MODULES = (\n", '    ("greeting", ("greet",)),\n'
                ),
            ),
            noticed_by=("-m", "m100link", "greet"),
            named="greet",
        ),
    ),
)

_OPENED = """
import asyncio
from contextlib import AsyncExitStack
from m100link.apps.station.config import Settings
from m100link.apps.station.listeners import Fronts, open_sockets

async def main():
    async with AsyncExitStack() as stack:
        settings = Settings(host="127.0.0.1", greeting_port=0)
        sockets = open_sockets(stack, settings, with_console=False, with_rosbridge=False)
        assert sockets.ports("greeting")
        fronts = Fronts(stack, settings, sockets, {}, {}, is_kept=False)
        fronts.agents = {"one": None}
        await fronts.serve()

asyncio.run(main())
"""
_TEST_FRONTS = "tests/apps/station/test_listeners.py"

FRONT = Recipe(
    "a front of the station",
    works=("-c", _OPENED),
    parts=(
        Part(
            "its module",
            (
                Edit(
                    "m100link/apps/station/greeting.py",
                    "",
                    '"""A greeting for all."""\n\n\nasync def serve(fronts: object) -> None:\n'
                    '    """Take the sockets, and say nothing yet."""\n'
                    '    fronts.take("greeting")\n',
                ),
            ),
            noticed_by=test_of(f"{_TEST_FRONTS}::test_each_row_names_a_module_that_serves"),
            named="greeting",
        ),
        Part(
            "its row",
            (
                Edit(
                    "m100link/apps/station/listeners.py",
                    '        FrontSpec("foxglove", "foxglove", lambda s: _one(s.foxglove_port)),\n',
                    '        FrontSpec("greeting", "greeting", lambda s: _one(s.greeting_port)),\n',
                ),
            ),
            noticed_by=test_of(f"{_TEST_FRONTS}::test_each_port_of_the_settings_is_of_a_front"),
            named="greeting_port",
        ),
        Part(
            "its setting",
            (
                Edit(
                    "m100link/apps/station/config.py",
                    "    foxglove_port: int | None = None\n",
                    "    greeting_port: int | None = None\n",
                ),
                Edit(
                    "m100link/apps/station/config.py",
                    "(8765 is usual).\n",
                    "        greeting_port: Serve greetings on this port.\n",
                ),
            ),
            noticed_by=test_of(_TEST_FRONTS),
            named="greeting_port",
        ),
    ),
)

RECIPES = (ITEM, VERB, FRONT)
