"""Nothing that ends a flight loads, opens, or begins a thread: it may not be there any more.

Processes against the aircraft that shares no line with the library, in which, once they fly, every
import, file, socket and thread is refused, or the table of file descriptors is full. What the
aircraft received is judged, and never when.
"""

from __future__ import annotations

import subprocess
import sys

import pytest

import m100link
from m100link import OutOfResources
from tests.attacks.endings import FORKS, PROCESSES, Draw, end_a_process, fork_a_process
from tests.rig import rig

pytestmark = pytest.mark.pty


def name_of(draw: Draw) -> str:
    return "-".join(draw)


# What is lost has to do with each step of an ending once; every pair is drawn by tests.attacks.
SEALED = [draw for draw in PROCESSES if draw.loss == "sealed" and draw.flight == "hover"]
OTHERS = [
    Draw("sync", "raise", "sealed"),
    Draw("sync", "SIGTERM", "table"),
    Draw("mission", "raise", "sealed"),
    Draw("mission", "SIGTERM", "table"),
    Draw("land", "SIGTERM", "table"),
    Draw("land", "raise", "sealed"),
    Draw("land", "SIGTERM", "log"),
    Draw("hover", "SIGINT", "log"),
    Draw("mission", "SIGHUP", "log"),
    Draw("hover", "SIGTERM", "stderr"),
    Draw("land", "leave", "stderr"),
    Draw("sync", "SIGTERM", "stderr"),
    Draw("land", "SIGTERM", "memory"),
    Draw("hover", "SIGQUIT", "nothing"),
    Draw("hover", "fall", "nothing"),
    Draw("hover", "SIGTERM", "tasks"),
]


@pytest.mark.parametrize("draw", [*SEALED, *OTHERS], ids=name_of)
def test_a_flight_ends_in_order_whatever_the_system_has_lost(draw: Draw) -> None:
    assert end_a_process(draw) == []


@pytest.mark.parametrize("draw", FORKS[:12], ids=name_of)
def test_beside_a_child_the_parent_flies_on_and_ends_in_order(draw: Draw) -> None:
    """Its stdout ends, too: no child holds it open, and so none stays behind."""
    assert fork_a_process(draw) == []


FULL = """
import asyncio, os, resource, sys
import m100link
from tests.flight.ending_programs import fill_the_table
from tests.flight.missions.foreign import foreign

async def connect():
    opened = m100link.connect({line!r})
    fill_the_table()
    async with opened:
        pass

async def control():
    async with foreign() as (there, aircraft):
        fill_the_table()
        async with aircraft.control():
            pass

try:
    asyncio.run({what}())
except m100link.M100Error as error:
    os.write(1, f"{{type(error).__name__}} {{error}}".encode())
"""


@pytest.mark.parametrize(
    ("what", "line", "error"),
    [
        # The first that finds no descriptor is a module of Python: ports are opened in a thread.
        ("connect", "serial:///dev/ptmx:230400", "OutOfResources"),
        ("connect", "tcp://127.0.0.1:1", "PortFailed"),
        ("control", "", "OutOfResources"),
    ],
)
def test_a_full_table_of_descriptors_is_reported_with_cause_and_remedy(
    what: str, line: str, error: str
) -> None:
    program = FULL.format(what=what, line=line)
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True
    )
    assert done.stdout.startswith(error), (done.stdout, done.stderr)
    assert "Too many open files" in done.stdout
    assert "leaks file descriptors" in done.stdout
    assert "what to do" in done.stdout


@pytest.mark.anyio
async def test_what_could_not_be_reserved_leaves_the_next_block_alone(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def no_thread(**_: object) -> None:
        raise RuntimeError("can't start new thread")

    async with rig(firmware="3.1") as flown:
        with monkeypatch.context() as patch:
            patch.setattr("m100link.flight.reserves.LOG_THREAD.hold", no_thread)
            for block in (flown.aircraft.control(), flown.aircraft.virtual_rc()):
                with pytest.raises(OutOfResources, match="can't start new thread"):
                    await block.__aenter__()
        assert flown.virtual.vehicle.authority.device is not m100link.Device.ONBOARD
        async with flown.aircraft.control() as control:
            assert control.has_authority
