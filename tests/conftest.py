"""Settings that every test shares."""

from __future__ import annotations

import gc
import os
import signal
import sys
from collections.abc import Generator

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

pytest_plugins = [
    "m100link.testing",  # what users load, the suite loads, too
    "tests.speeds",
    "tests.judged",
]

# What starts the suite in the background may have it ignore signals, and programs that tests start
# would inherit that. These are the dispositions of a program that a person starts.
signal.signal(signal.SIGINT, signal.default_int_handler)
for _number in (signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT, signal.SIGXCPU):
    if signal.getsignal(_number) is signal.SIG_IGN:
        signal.signal(_number, signal.SIG_DFL)

# Tests raise KeyboardInterrupt between any two lines. Behind the line by which coverage takes the
# lock of its data, that leaves the lock taken, and the next file that is entered waits for ever.
if (_coverage := sys.modules.get("coverage")) and (_measuring := _coverage.Coverage.current()):
    _measuring._collector.data_lock = None

# Time limits per example say more about the machine than about the code.
_COMMON = settings(
    deadline=None,
    print_blob=True,
    suppress_health_check=[HealthCheck.too_slow],
)
settings.register_profile("dev", _COMMON, max_examples=60)
settings.register_profile("ci", _COMMON, max_examples=60, derandomize=True)
settings.register_profile("thorough", _COMMON, max_examples=2000)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "ci" if "CI" in os.environ else "dev"))


@settings(max_examples=5, database=None, derandomize=True)
@given(st.lists(st.integers(), min_size=200, max_size=200))
def draw_from_what_is_there(numbers: list[int]) -> None:
    """Draw values of all kinds where the source is read for them: one of 20 is from there."""
    assert numbers


@pytest.fixture(autouse=True, scope="session")
def _state_folder(tmp_path_factory: pytest.TempPathFactory) -> None:
    """What is recorded without being asked for stays out of the home folder, of children too."""
    os.environ["XDG_STATE_HOME"] = str(tmp_path_factory.mktemp("state"))


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_collection() -> Generator[None, object, object]:
    """What is imported and collected stays.

    To look for garbage in it again and again took two fifths of the start of a new clone.
    """
    gc.disable()
    try:
        return (yield)
    finally:
        gc.enable()


def pytest_collection_finish(session: pytest.Session) -> None:
    """No search for garbage needs to pass through what was imported and collected."""
    if any(item.get_closest_marker("hypothesis") for item in session.items):
        # It parses all that was imported for values to draw: eight seconds in a new clone, which
        # the first test would pay that uses it.
        draw_from_what_is_there()
    gc.collect()
    gc.freeze()
