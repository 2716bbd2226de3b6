"""What an error keeps, and what becomes of one that the system raises."""

from __future__ import annotations

import ast
import errno
import pickle
import re
from typing import Any, cast

import pytest

from m100link import AckTimeout, BadPlan, CommandRefused, M100Error, OutOfResources, UsageError
from m100link.errors.base import of_the_system
from m100link.errors.usage import renamed, unread
from tests.test_house import PACKAGE


def test_a_value_of_nothing_is_a_value_and_none_is_the_default() -> None:
    """Code 0, session 0 and no tries are what was seen; -1 and 0 stand where nothing was."""
    assert CommandRefused("it was refused", code=0).code == 0
    assert CommandRefused("it was refused", code=cast(Any, None)).code == -1
    assert CommandRefused("it was refused").code == -1
    lost = AckTimeout("no ack", session=0, sequence=0, tries=2)
    assert (lost.session, lost.sequence, lost.tries) == (0, 0, 2)
    with pytest.raises(TypeError, match="has no number"):
        CommandRefused("it was refused", **{"number": cast(Any, 0)})


def test_the_usual_words_of_an_error_are_its_cause_and_its_remedy() -> None:
    class Unplugged(M100Error, cause="the cable is out", remedy="put it in"):
        pass

    error = Unplugged.usual("no bytes come")
    assert (error.seen, error.cause, error.remedy) == (
        "no bytes come",
        "the cable is out",
        "put it in",
    )


def test_the_same_error_again_has_its_cause_and_everything_else() -> None:
    lost = AckTimeout("no ack", cause="noise", remedy="ask again", command="land", tries=3)
    lost.__cause__ = KeyError("what went wrong before")
    again = lost.again()
    assert again is not lost
    assert again.__cause__ is lost.__cause__
    assert again.__traceback__ is None
    told = type(again), str(again), again.command, again.tries
    assert told == (AckTimeout, str(lost), "land", 3)
    copied = pickle.loads(pickle.dumps(lost))
    assert (type(copied), str(copied), copied.command, copied.tries) == told


@pytest.mark.parametrize(
    "error",
    [
        OSError(errno.EMFILE, "Too many open files"),
        ImportError("m100link.flight.control"),
        MemoryError(),
        RuntimeError("can't start new thread"),  # Python has no class of its own for it
    ],
    ids=lambda one: type(one).__name__,
)
def test_what_the_system_lacks_is_reported_as_that(error: Exception) -> None:
    said = "control was not asked for"
    with pytest.raises(OutOfResources, match=said) as caught, of_the_system("control"):
        raise error
    assert caught.value.__cause__ is error
    assert isinstance(caught.value, OSError)


@pytest.mark.parametrize(
    "error",
    [RuntimeError("no running event loop"), ValueError("x"), UsageError("no"), M100Error("no")],
    ids=str,
)
def test_every_other_error_stays_what_it_is(error: Exception) -> None:
    with pytest.raises(type(error)) as caught, of_the_system("control"):
        raise error
    assert caught.value is error


def test_of_two_bases_the_default_of_the_first_holds_as_for_attributes() -> None:
    class First(M100Error):
        limit: int = 1

    class Second(M100Error):
        limit: int = 2

    class Both(First, Second):
        pass

    assert Both("seen").limit == Both.limit == 1


def test_no_text_asks_whether_an_exception_is_true() -> None:
    """It always is, also one that says nothing, as a TimeoutError: its text may be empty."""
    always = re.compile(r"\{(error|exc|failure|raised) or ")
    assert not [p.name for p in PACKAGE.rglob("*.py") if always.search(p.read_text("utf-8"))]


def test_the_problems_of_a_plan_are_all_of_them_this_first() -> None:
    others = BadPlan("too far", point=2), BadPlan("too fast", point=7)
    whole = BadPlan("too high", point=0, others=others)
    assert whole.problems == (whole, *others)
    assert others[0].problems == others[:1]


def test_a_name_of_before_warns_where_it_is_used() -> None:
    look = renamed(__name__, Before="BadPlan")
    with pytest.warns(DeprecationWarning, match=r"test_base\.Before is BadPlan now") as told:
        assert look("Before") is BadPlan
    assert [one.filename for one in told] == [__file__]
    with pytest.raises(AttributeError, match="no attribute 'Never'"):
        look("Never")


_OF_THE_CLI = (
    *("aircraft/rates.py", "apps/bus", "apps/cli", "apps/fleet/logs", "apps/fleet/pki.py"),
    *("apps/fleet/identity.py", "apps/fleet/revocations.py", "apps/fleet/signing.py"),
    *("apps/mavlink/bridge.py", "apps/station/config.py", "link", "log", "missions", "sim"),
)
"""Files and folders whose errors a command prints."""
_PRINTED = {"UsageError", "BadAuthority", "BadPlan", "BadRights", "BadURL", "PortFailed"}


def test_each_error_that_a_command_prints_has_a_remedy() -> None:
    """Passed on as it came is the answer of a simulator: it has the remedy in its text."""
    without = []
    for path in sorted(PACKAGE.rglob("*.py")):
        name = path.relative_to(PACKAGE).as_posix()
        if not any(name == part or name.startswith(f"{part}/") for part in _OF_THE_CLI):
            continue
        for node in ast.walk(ast.parse(path.read_text("utf-8"))):
            if not (isinstance(node, ast.Call) and ast.unparse(node.func) in _PRINTED):
                continue
            is_passed_on = "answer.get" in ast.unparse(node)
            told = {one.arg for one in node.keywords} & {"remedy", None}  # None: **words
            if not (told or is_passed_on):
                without.append(f"{name}:{node.lineno}")
    assert without == []


@pytest.mark.parametrize(
    ("error", "remedy"),
    [
        (FileNotFoundError(errno.ENOENT, "No such file or directory"), "check the path"),
        (PermissionError(errno.EACCES, "Permission denied"), "who may read it"),
        (IsADirectoryError(errno.EISDIR, "Is a directory"), "name a file in that folder"),
    ],
    ids=lambda one: type(one).__name__,
)
def test_the_error_of_an_unread_file_names_it_its_reason_and_a_remedy(
    error: OSError, remedy: str
) -> None:
    made = unread("flight.mcap", error)
    assert made.seen == f"flight.mcap cannot be read: {error.strerror}"
    assert remedy in made.remedy
