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
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

from m100link.apps.agent.messages import VERSION
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


_PAGES = ("docs/reference/telemetry.md", "docs/explanation/safety.md")  # with tables by hand


def copied(folder: Path) -> None:
    """What a trial needs of the project."""
    for name in ("m100link", "tests"):  # with what was compiled: that is most of the time
        shutil.copytree(ROOT / name, folder / name)
    for name in ("pyproject.toml", "README.md", *_PAGES):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(ROOT / name, folder / name)


def carried_out(folder: Path, parts: tuple[Part, ...]) -> None:
    """Edit the copy."""
    for part in parts:
        for edit in part.edits:
            path = folder / edit.place
            before = path.read_text("utf-8") if edit.after else ""
            path.write_text(edit.of(before), "utf-8")
            forget_compiled(path)


def undone(folder: Path, parts: tuple[Part, ...]) -> None:
    """The files of these parts as they are in the project."""
    for place in {edit.place for part in parts for edit in part.edits}:
        forget_compiled(folder / place)
        if (ROOT / place).exists():
            shutil.copy(ROOT / place, folder / place)
        else:
            (folder / place).unlink(missing_ok=True)


def forget_compiled(path: Path) -> None:
    """Else a file that changes twice a second, to the same size, is taken for the one before."""
    for compiled in path.parent.glob(f"__pycache__/{path.stem}.*.pyc"):
        compiled.unlink()


def said(folder: Path, call: Call) -> tuple[bool, str]:
    """Whether it went well, and all that it printed."""
    environment = os.environ | {"PYTHONPATH": str(folder), "PYTHONDONTWRITEBYTECODE": ""}
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
    for call in together(part.noticed_by for part in recipe.parts if part.noticed_by):
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


# In one process, and without what would cost time in each: caches, the slow list.
_PYTEST = ("-m", "pytest", "-q", "-n0", "-x", "-p", "no:cacheprovider")


def test_of(place: str) -> Call:
    return (*_PYTEST, place)


def together(calls: Iterable[Call]) -> list[Call]:
    """The same, with all tests in one process."""
    rows = list(dict.fromkeys(calls))
    tests = [call for call in rows if call[: len(_PYTEST)] == _PYTEST]
    places = [place for call in tests for place in call[len(_PYTEST) :]]
    return [
        *(call for call in rows if call not in tests),
        *([(*_PYTEST, *places)] if tests else []),
    ]


# -- the recipes -----------------------------------------------------------------------------------

_RECORDS, _ITEMS = "m100link/protocol/records.py", "m100link/protocol/items.py"
_TEST_ITEMS = "tests/protocol/test_items.py"
_TEST_NUMBERS = "tests/apps/station/console/view/test_numbers.py"
_PUBLIC = f"{_TEST_ITEMS}::test_the_public_records_are_those_of_the_table"
_UNIT_SHOWN = test_of(f"{_TEST_NUMBERS}::test_each_curve_is_called_by_its_unit")
_SHOWN = test_of(f"{_TEST_NUMBERS}::test_the_history_has_each_value_in_its_column")
_TEXTS = "m100link/apps/station/console/texts"
_SAID_IN_EACH = test_of(
    "tests/apps/station/console/view/test_texts.py::"
    "test_each_language_has_each_key_in_the_same_order_and_with_the_same_braces"
)

_READ = """
import m100link
from m100link.protocol import PROFILES, TelemetryPacket, encode_telemetry
from m100link.sim import VirtualAircraft

VirtualAircraft(firmware="3.1")
profile = PROFILES["3.1"]
packet = TelemetryPacket(encode_telemetry({"outside_air": [1013.25]}, profile), profile)
assert packet.outside_air == m100link.OutsideAir(1013.25), packet.outside_air
"""

_IN_THE_LIBRARY = (
    Part(
        "the record, with its name",
        (
            Edit(
                _RECORDS,
                "        return self.percent <= 100\n",
                "\n\n@quick\nclass OutsideAir(NamedTuple):\n"
                '    """Pressure of the air."""\n\n'
                "    pressure_hpa: float\n",
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
                '        fields=("pressure",),\n'
                '        layouts={"3.1": _layout("f", "pressure")},\n    ),\n',
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
                '        """Pressure of the air."""\n        return self.get(OutsideAir)\n',
            ),
        ),
        noticed_by=test_of(f"{_TEST_ITEMS}::test_every_record_has_its_view_of_packages_and_state"),
        named="outside_air",
    ),
    Part(
        "its reading in the virtual aircraft",
        (
            Edit(
                "m100link/sim/vehicle/sensors.py",
                "        return (math.ceil(self._flight.battery_percent),)\n",
                "\n    def _read_outside_air(self) -> Values:\n        return (1013.25,)\n",
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
                '    "outside_air": ("air", "pressure"),\n',
            ),
        ),
    ),
)

_IN_THE_APPLICATIONS = (
    Part(
        "its words in English",
        (
            Edit(
                f"{_TEXTS}/en.toml", '"item.battery" = "battery"\n', '"item.outside_air" = "air"\n'
            ),
            Edit(
                f"{_TEXTS}/en.toml",
                '"field.percent" = "charge"\n',
                '"field.pressure" = "pressure"\n',
            ),
        ),
        noticed_by=_UNIT_SHOWN,
        named="item.outside_air",
    ),
    Part(
        "its words in German",
        (
            Edit(
                f"{_TEXTS}/de.toml",
                '"item.battery" = "Akku"\n',
                '"item.outside_air" = "Luft"\n',
            ),
            Edit(
                f"{_TEXTS}/de.toml", '"field.percent" = "Ladung"\n', '"field.pressure" = "Druck"\n'
            ),
        ),
        noticed_by=_SAID_IN_EACH,
        named="outside_air",
    ),
    Part(
        "its unit",
        (
            Edit(
                "m100link/apps/station/console/view/data.py",
                '    ("_hz", "Hz"),\n',
                '    ("_hpa", "hPa"),\n',
            ),
        ),
        noticed_by=_UNIT_SHOWN,
        named="field.pressure_hpa",
    ),
    Part(
        "how monitor words it",
        (
            Edit("m100link/apps/cli/telemetry.py", "    Magnetometer,\n", "    OutsideAir,\n"),
            Edit(
                "m100link/apps/cli/telemetry.py",
                '    Battery: "{0.percent} %",\n',
                '    OutsideAir: "{0.pressure_hpa} hPa",\n',
            ),
        ),
        noticed_by=test_of("tests/apps/cli/test_telemetry.py::test_each_record_has_its_words"),
        named="no row for OutsideAir",
    ),
    Part(
        "its row in the reference",
        (
            Edit(
                "docs/reference/telemetry.md",
                "`ctrl_device.status` is `control_device.control` |\n",
                "| `outside_air` | `outside_air` | `air` | `air.pressure` |\n",
            ),
        ),
        noticed_by=test_of(
            "tests/telemetry/test_names.py::test_the_manual_lists_the_names_of_the_document"
        ),
        named="outside_air",
    ),
)

_BY_HAND = (
    Part(
        "its bit and its rate",
        (Edit(_TEST_ITEMS, '    ("control_device", 0),\n', '    ("outside_air", 1),\n'),),
        noticed_by=test_of(f"{_TEST_ITEMS}::test_bits_names_and_rates_are_those_of_the_document"),
        named="outside_air",
    ),
    Part(
        "the rate at which it arrives",
        (
            Edit(
                "tests/telemetry/test_subscription.py",
                "            FlightStatus: 10,\n",
                "            m100link.OutsideAir: 1,\n",
            ),
            Edit("tests/telemetry/test_subscription.py", "import pytest\n\n", "import m100link\n"),
        ),
        noticed_by=test_of(
            "tests/telemetry/test_subscription.py::test_every_item_arrives_with_its_rate_and_age"
        ),
        named="OutsideAir",
    ),
    Part(
        "its size",
        (
            Edit(
                "tests/protocol/test_firmware.py",
                '    "control_device": (1, 1, 2, 1),\n',
                '    "outside_air": (None, None, 4, None),\n',
            ),
            Edit("tests/protocol/test_firmware.py", "(116, 117, 124", " + 4"),
        ),
        noticed_by=test_of(
            "tests/protocol/test_firmware.py::test_items_have_the_sizes_of_their_firmware"
        ),
        named="outside_air",
    ),
    Part(
        "what the known aircraft imports",
        (Edit("tests/known.py", "    Magnetometer,\n", "    OutsideAir,\n"),),
    ),
    Part(
        "its value in the known aircraft",
        (Edit("tests/known.py", "    ControlDevice(0x1A, 6),\n", "    OutsideAir(987.5),\n"),),
        noticed_by=_SHOWN,
        named="outside_air.pressure_hpa",
    ),
    Part(
        "its bytes in the known aircraft",
        (Edit("tests/known.py", '    Battery: {"": "B"},\n', '    OutsideAir: {"3.1": "f"},\n'),),
        noticed_by=_SHOWN,
        named="OutsideAir",
    ),
    Part(
        "its column",
        (
            Edit(
                "tests/known_columns.py",
                '    "control_device.device": 2,\n',
                '    "outside_air.pressure_hpa": 987.5,\n',
            ),
            Edit(
                "tests/known_columns.py",
                '_NEW = {"time.nanoseconds", ',
                '"outside_air.pressure_hpa", ',
            ),
        ),
        noticed_by=test_of("tests/log/test_values.py::test_a_table_has_each_value_in_its_column"),
        named="outside_air.pressure_hpa",
    ),
    Part(
        "its name on the wire",
        (
            Edit(
                "tests/known_columns.py",
                '    "control_device.control": "",\n',
                '    "outside_air.pressure": "outside_air.pressure_hpa",\n',
            ),
        ),
        noticed_by=test_of("tests/log/test_values.py::test_rows_and_places_in_the_file"),
        named="outside_air.pressure",
    ),
    Part(
        "the unit of its curve",
        (
            Edit(
                _TEST_NUMBERS,
                '    **{"time.tick_hz": "Hz", ',
                '"outside_air.pressure_hpa": "hPa", ',
            ),
        ),
        noticed_by=_UNIT_SHOWN,
        named="outside_air.pressure_hpa",
    ),
)

ITEM = Recipe(
    "a telemetry item",
    works=("-c", _READ),
    parts=(*_IN_THE_LIBRARY, *_IN_THE_APPLICATIONS, *_BY_HAND),
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
            "its row with its module and two examples",
            (
                Edit(
                    "m100link/apps/cli/app.py",
                    '    "Fly": (\n',
                    '        ("greet", "greeting", "", "--help"),\n',
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
from m100link.apps.cli.serve import StationOptions, _urls
from m100link.apps.station.config import Settings
from m100link.apps.station.listeners import Fronts, open_sockets

assert "greeting_port" in StationOptions.__dataclass_fields__

async def main():
    async with AsyncExitStack() as stack:
        settings = Settings(host="127.0.0.1", greeting_port=0)
        sockets = open_sockets(stack, settings, with_console=False, with_rosbridge=False)
        url = f"tcp://127.0.0.1:{sockets.port('greeting')}"
        assert _urls(settings, sockets, "greeting") == [url]
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
                    's: _one(s.foxglove_port), "ws"),\n',
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
            ),
            noticed_by=test_of(_TEST_FRONTS),
            named="greeting_port",
        ),
        Part(
            "the help of its flag",
            (
                Edit(
                    "m100link/apps/station/config.py",
                    "8765 is usual.\n",
                    "        greeting_port: Serve greetings on this port.\n",
                ),
            ),
            noticed_by=("-c", "import m100link.apps.cli.serve"),
            named="Settings has no line for greeting_port",
        ),
    ),
)

_LIFECYCLE, _TEST_LIFECYCLE = "m100link/flight/lifecycle.py", "tests/flight/test_lifecycle.py"
_ON_THE_PAGE = test_of(f"{_TEST_LIFECYCLE}::test_the_page_on_safety_has_each_failure_in_its_table")
_STOPPED = """
from m100link.flight.lifecycle import BlockInput, BlockState, Lifecycle, StopCause
from m100link.flight.virtual_rc import _SILENT

life = Lifecycle()
for what in (BlockInput.ENTER, BlockInput.OBTAINED, StopCause.TOO_HOT):
    assert life.feed(what)
assert life.state is BlockState.STOPPING
assert life.plan.release
assert StopCause.TOO_HOT not in _SILENT
"""
_IN_EACH_STATE = "".join(
    f"    (S.{before}, C.TOO_HOT): (S.{after}, {why}),\n"
    for before, after, why in (
        ("NEW", "NEW", "NOT_ENTERED"),
        ("ENTERING", "STOPPING", "ENDS"),
        ("FLYING", "STOPPING", "ENDS"),
        ("PAUSED", "STOPPING", "ENDS"),
        ("STOPPING", "STOPPING", "FIRST_CAUSE"),
        ("OVER", "OVER", "NEVER_AGAIN"),
    )
)

STOP_CAUSE = Recipe(
    "a stop cause",
    works=("-c", _STOPPED),
    parts=(
        Part(
            "its member",
            (
                Edit(
                    _LIFECYCLE,
                    '    LINK_LOST = "the line is gone"\n',
                    '    TOO_HOT = "the computer is too hot to fly on"\n',
                ),
            ),
            noticed_by=("-c", "import m100link.flight.lifecycle"),
            named="TOO_HOT",
        ),
        Part(
            "its plan",
            (Edit(_LIFECYCLE, "    _C.GUARD_REFUSED: _OURS,\n", "    _C.TOO_HOT: _OURS,\n"),),
            noticed_by=test_of(
                f"{_TEST_LIFECYCLE}::test_each_cause_has_the_plan_that_it_leaves_possible"
            ),
            named="TOO_HOT",
        ),
        Part(
            "where it is noticed",
            (
                Edit(
                    "m100link/flight/watchdog.py",
                    "        slept = self._suspended.slept_s()\n",
                    "        if slept > 1e9:\n            self._end(StopCause.TOO_HOT, "
                    'ComputerSuspended.usual("x"))\n',
                ),
            ),
            noticed_by=test_of(f"{_TEST_LIFECYCLE}::test_each_cause_ends_a_block_somewhere"),
            named="TOO_HOT",
        ),
        Part(
            "where it leads from each state, by hand",
            (
                Edit(
                    _TEST_LIFECYCLE,
                    '    (S.NEW, I.ENTER): (S.ENTERING, "the way in"),\n',
                    _IN_EACH_STATE,
                ),
            ),
            noticed_by=test_of(
                f"{_TEST_LIFECYCLE}::"
                "test_each_input_and_cause_in_each_state_leads_where_the_reasons_say"
            ),
            named="TOO_HOT",
        ),
        Part(
            "its plan, by hand",
            (
                Edit(
                    _TEST_LIFECYCLE,
                    '    C.LINK_LOST: ((False, False, False, False, False), "nobody is there"),\n',
                    '    C.TOO_HOT: ((True, False, True, True, True), "it hears us"),\n',
                ),
            ),
            noticed_by=test_of(
                f"{_TEST_LIFECYCLE}::test_each_cause_has_the_plan_that_it_leaves_possible"
            ),
            named="TOO_HOT",
        ),
        Part(
            "its failure, by hand",
            (
                Edit(
                    _TEST_LIFECYCLE,
                    '    C.LINK_LOST: "LinkLost",\n',
                    '    C.TOO_HOT: "TooHot",\n',
                ),
            ),
            noticed_by=_ON_THE_PAGE,
            named="TOO_HOT",
        ),
        Part(
            "its row in the page on safety",
            (
                Edit(
                    "docs/explanation/safety.md",
                    "does | What the aircraft does |\n|---|---|---|\n",
                    "| It is too hot | ends the block with `TooHot` | hovers or lands |\n",
                ),
            ),
            noticed_by=_ON_THE_PAGE,
            named="TOO_HOT",
        ),
    ),
)

_MESSAGES, _AGENT = "m100link/apps/agent/messages.py", "m100link/apps/agent/server/agent.py"
_TEST_CODEC = "tests/apps/agent/test_codec.py"
_HANDLED = ("-c", f"import {_AGENT.removesuffix('.py').replace('/', '.')}")
_KNOWN = test_of(f"{_TEST_CODEC}::test_other_messages_are_another_version")
_ASKED = """
import asyncio
from m100link.apps.agent import orders
from m100link.sim.clock import virtual_clock_loop
from tests.apps.fleet.conftest import Rig

async def main():
    rig = Rig()
    async with rig.stack:
        one, pilot = await rig.aircraft("a1"), await rig.pilot()
        async with pilot["a1"].control(stop="land") as control:
            await control.take_off()
            await {asked}
        told = [event.text for event in one.agent.journal.events]
        assert told.count("change of heading is done") == 4, told

with asyncio.Runner(loop_factory=virtual_clock_loop) as runner:
    runner.run(main())
"""

ORDER = Recipe(
    "an order of the agent",
    works=("-c", _ASKED.format(asked="control.ask(orders.Wiggle(2))")),
    parts=(
        Part(
            "its class",
            (
                Edit(
                    "m100link/apps/agent/orders.py",
                    '    """Fly to the home point and land."""\n',
                    '\n\nclass Wiggle(Order):\n    """Turn the nose to the right and back."""\n\n'
                    "    times: int  #: 1 to 9\n",
                ),
            ),
            noticed_by=_HANDLED,
            named="Wiggle",
        ),
        Part(
            "its row, and what it calls",
            (
                Edit(
                    _AGENT,
                    "    orders.FlyPattern: _fly_pattern,\n",
                    "    orders.Wiggle: _wiggle,\n",
                ),
                Edit(
                    _AGENT,
                    "    await call.agent.replay.order(order.text)\n",
                    "\n\nasync def _wiggle(call: Call, order: orders.Wiggle) -> None:\n"
                    "    if not 1 <= order.times <= 9:\n"
                    '        raise UsageError("times is 1 to 9", remedy="ask for fewer")\n'
                    "    for turn in (20.0, 0.0) * order.times:\n"
                    "        await call.flying.guide(orders.ChangeHeading(turn), call.accepted)\n",
                ),
            ),
            noticed_by=_HANDLED,
            named="Wiggle",
        ),
        Part(
            "the version of the messages",
            (Edit(_MESSAGES, f"\nVERSION = {VERSION}", " + 1"),),
            noticed_by=_KNOWN,
            named="raise VERSION of m100link/apps/agent/messages.py",
        ),
        Part(
            "that version, by hand",
            (Edit(_TEST_CODEC, f"\nKNOWN_VERSION = {VERSION}", " + 1"),),
            noticed_by=_KNOWN,
            named="KNOWN_VERSION",
        ),
        Part(
            "what it is as a message, by hand",
            (Edit(_TEST_CODEC, '\nKNOWN = """\n', "Wiggle:b35051\n"),),
            noticed_by=_KNOWN,
            named="Wiggle:b35051",
        ),
    ),
)

_CONTROL, _TEST_CONTROL = "m100link/apps/fleet/control.py", "tests/apps/fleet/test_control.py"

METHOD = Recipe(
    "a method of a fleet",
    works=("-c", _ASKED.format(asked="control.wiggle(2)")),
    parts=(
        *(replace(part, noticed_by=()) for part in ORDER.parts),
        Part(
            "the method",
            (
                Edit(
                    _CONTROL,
                    "        await self.ask(orders.GoHome())\n",
                    "\n    async def wiggle(self, times: int) -> None:\n"
                    '        """Turn the nose to the right and back."""\n'
                    "        await self.ask(orders.Wiggle(times))\n",
                ),
            ),
            noticed_by=test_of(
                f"{_TEST_CONTROL}::test_each_verb_asks_for_what_it_says_under_its_lease"
            ),
            named="wiggle",
        ),
        Part(
            "what it asks for, by hand",
            (
                Edit(
                    _TEST_CONTROL,
                    '    "go_home": ({}, orders.GoHome()),\n',
                    '    "wiggle": ({"times": 3}, orders.Wiggle(3)),\n',
                ),
            ),
            noticed_by=test_of(f"{_TEST_CONTROL}::test_each_verb_has_its_order_by_hand"),
            named="wiggle",
        ),
    ),
)

RECIPES = (ITEM, VERB, FRONT, STOP_CAUSE, ORDER, METHOD)
