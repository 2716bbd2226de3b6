"""Settings that every test shares."""

from __future__ import annotations

import gc
import importlib
import os
import signal
from contextlib import suppress
from pathlib import Path

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


def pytest_collection(session: pytest.Session) -> None:
    """Every other process reads all tests backwards first: what one compiled, the other finds.

    In a new clone, pytest rewrites each assertion and Hypothesis parses each module, 25 seconds in
    all. Every process has to collect in the same order, and would do all of it beside the others.
    """
    here, config = Path(__file__).parent, session.config
    at = config.invocation_params.dir
    number = os.environ.get("PYTEST_XDIST_WORKER", "gw0").removeprefix("gw")
    if int(number) % 2 == 0 or [at / one for one in config.args] != [here]:
        return
    left_out = [at / folder for folder in config.option.ignore or ()]
    for path in sorted(here.rglob("test_*.py"), reverse=True):
        if not any(path.is_relative_to(folder) for folder in left_out):
            with suppress(Exception, pytest.skip.Exception):  # the collection says why
                importlib.import_module(
                    ".".join(path.relative_to(here.parent).with_suffix("").parts)
                )


def pytest_collection_finish(session: pytest.Session) -> None:
    """What was imported and collected stays: no search for garbage needs to pass through it."""
    if any(item.get_closest_marker("hypothesis") for item in session.items):
        # It parses all that was imported for values to draw: eight seconds in a new clone, which
        # the first test would pay that uses it.
        draw_from_what_is_there()
    gc.collect()
    gc.freeze()
