"""A process that the station starts: what its loop is not held up by."""

from __future__ import annotations

import subprocess
import sys

_PROGRAM = """
import gc
import m100link.apps.station.run  # all that such a process loads
from m100link.apps.station.supervisor import leave_what_stays

walked = len(gc.get_objects())
leave_what_stays()
kept = [[] for _ in range(10)]
kept[0].append(kept)
del kept
left, found = len(gc.get_objects()), gc.collect()
print(walked, left, found)
"""


def test_what_stays_is_not_walked_through_and_what_comes_later_is_collected() -> None:
    program = (sys.executable, "-c", _PROGRAM)
    told = subprocess.run(program, capture_output=True, text=True, check=True).stdout
    walked, left, found = map(int, told.split())
    assert walked > 10_000
    assert left < walked / 50
    assert found >= 11
