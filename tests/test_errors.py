"""The tree of errors: its drawing, and that users can catch every one by name."""

from __future__ import annotations

import ast
import inspect
import pickle
import re
import warnings
from collections import Counter
from pathlib import Path
from typing import Any

import pytest

import m100link
from m100link import errors
from m100link.apps.cli.manual import error_classes
from m100link.errors import UsageError
from m100link.errors.usage import INSTALL, loads, of_extra
from tests.test_house import MODULES, statements, tree


def error_tree() -> dict[str, str]:
    """Name of each error and of its parent, from the drawing in the docstring."""
    parents: dict[str, str] = {}
    path: list[str] = []
    for line in inspect.cleandoc(errors.__doc__ or "").splitlines():
        match = re.match(r"(?P<indent>\s*(?:│ {3}| {4})*)(?P<branch>[├└]── )?(?P<name>\w+)\b", line)
        if match is None or match["name"] not in vars(errors):
            continue
        name = match["name"]
        depth = (len(match["indent"]) - 4) // 4 + (1 if match["branch"] else 0)
        del path[depth:]
        if path:
            parents[name] = path[-1]
        path.append(name)
    return parents


def test_drawing_of_the_error_tree_matches_the_classes() -> None:
    classes = [vars(errors)[name] for name in vars(errors)["__all__"]]
    actual = {
        cls.__name__: base.__name__
        for cls in classes
        for base in cls.__bases__
        if issubclass(base, errors.M100Error)
    }
    assert error_tree() == actual


def test_the_drawing_says_by_which_builtin_an_error_can_be_caught_too() -> None:
    """`except TimeoutError` catches what was not answered, and what was not seen."""
    drawn = re.findall(r"── (\w+) .*\((\w+Error)\)$", errors.__doc__ or "", re.MULTILINE)
    bases = {
        name: base.__name__
        for name in vars(errors)["__all__"]
        for base in vars(errors)[name].__bases__
        if not issubclass(base, errors.M100Error)
    }
    del bases["M100Error"], bases["LossReason"]  # an Exception, and no error
    assert bases == dict(drawn)
    assert len(bases) > 9


def test_every_error_is_public_and_derives_from_one_base() -> None:
    defined = {
        name
        for name, value in vars(errors).items()
        if inspect.isclass(value) and issubclass(value, BaseException)
    }
    assert defined | {"LossReason"} == set(vars(errors)["__all__"])
    assert defined <= set(m100link.__all__)


# -- codes ----------------------------------------------------------------------------------------

CLASSES = sorted(error_classes(), key=lambda kind: kind.__name__)  # in any order of imports


def test_all_classes_are_found_wherever_they_stand() -> None:
    """By their code, which every one has."""
    classes = [
        node
        for path in MODULES.values()
        for node in statements(tree(path))
        if isinstance(node, ast.ClassDef)
    ]
    declared = {node.name for node in classes if {word.arg for word in node.keywords} & {"code"}}
    bases = {
        node.name
        for node in classes
        if {ast.unparse(base).rpartition(".")[2] for base in node.bases}
        & (declared | {"M100Error"})
    }
    assert bases == declared
    assert {kind.__name__ for kind in CLASSES} == declared | {"M100Error"}


def test_no_code_is_used_twice_and_each_is_short() -> None:
    codes = Counter(kind.error_code for kind in CLASSES)
    assert [code for code, count in codes.items() if count > 1] == []
    assert [code for code in codes if not re.fullmatch(r"M100(-[A-Z]+)+", code)] == []
    assert max(map(len, codes)) <= 24


@pytest.mark.parametrize("kind", CLASSES)
def test_every_class_has_its_own_cause_and_remedy(kind: type[errors.M100Error]) -> None:
    for name in ("error_code", "usual_cause", "usual_remedy"):
        assert name in vars(kind)
        assert getattr(kind, name) not in {getattr(base, name, "") for base in kind.__bases__}


def test_an_error_names_its_code_and_where_the_manual_describes_it() -> None:
    error = errors.CommandRefused("no", code=3)
    assert (error.error_code, error.code) == ("M100-COMMAND-REFUSED", 3)
    assert error.manual == "reference/errors#m100-command-refused"
    assert error.again().error_code == pickle.loads(pickle.dumps(error)).error_code
    assert str(error) == "no", "what it says is what was seen"


def test_a_class_of_a_program_has_the_code_of_its_base() -> None:
    class OfAProgram(errors.LinkLost):
        pass

    assert OfAProgram.error_code == "M100-LINK-LOST"


def test_an_error_is_made_of_what_was_seen_and_of_what_its_class_annotates() -> None:
    class OfAProgram(errors.TaskError):
        wind_m_s: float = 0.0

    told = OfAProgram("no", command="land", wind_m_s=12.0, remedy="wait")
    assert (told.seen, told.cause, told.remedy, told.command) == ("no", "", "wait", "land")
    assert (told.code, told.situation, told.wind_m_s) == (-1, {}, 12.0)
    told.situation["battery_percent"] = 20
    assert errors.TaskRefused("no").situation == {} == errors.NotObserved("no").situation
    assert vars(told.again()) == vars(told)
    with pytest.raises(TypeError, match="TaskRefused has no wind_m_s"):
        errors.TaskRefused("no", wind_m_s=12.0)  # type: ignore[call-arg] # what is asked
    with pytest.raises(TypeError):
        errors.AckTimeout("no", "execute")  # type: ignore[call-arg] # by keyword alone


def test_an_error_of_two_bases_takes_what_both_annotate() -> None:
    class OfAProgram(errors.LinkError, errors.TaskError):
        pass

    told = OfAProgram("no", command="land", situation={"battery_percent": 20})
    assert (told.command, told.code, told.situation) == ("land", -1, {"battery_percent": 20})
    assert OfAProgram("no").situation is not errors.TaskError.situation, "a copy for each"


def test_a_situation_that_nobody_knows_is_an_empty_one() -> None:
    for kind in (errors.TaskRefused, errors.NotObserved):
        assert kind("no", situation=None).situation == {}  # type: ignore[arg-type] # as before


def test_the_page_has_every_class_with_its_anchor(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As the manual's builder makes it."""
    monkeypatch.syspath_prepend(Path(__file__).parent.parent / "docs" / "_ext")
    (tmp_path / "index.md").write_text("# Errors\n\n```{error-list}\n```\n")
    sphinx = pytest.importorskip("sphinx.application")
    pytest.importorskip("myst_parser")
    settings = {"extensions": ["myst_parser", "error_list"], "project": "errors"}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of Sphinx about itself
        app = sphinx.Sphinx(
            *(str(tmp_path), None, str(tmp_path / "out"), str(tmp_path / "trees"), "html"),
            confoverrides=settings,
            status=None,
            warning=None,
        )
        app.build()
    page = (tmp_path / "out" / "index.html").read_text("utf-8")
    for kind in CLASSES:
        assert f'id="{kind.error_code.lower()}"' in page
        assert f"> {kind.__name__}, a kind of" in page
    for label in ("Usual cause: ", "What to do: "):
        assert page.count(label) == len(CLASSES), "each entry says it once"


def test_a_class_of_a_program_takes_what_it_annotates_whatever_its_module_imports() -> None:
    program = """
from m100link import M100Error

class TooWindy(M100Error):
    gusts: float = 0.0
"""
    for first in ("", "from __future__ import annotations\n"):
        names: dict[str, Any] = {"__name__": "program"}
        exec(compile(first + program, "program", "exec", dont_inherit=True), names)
        assert names["TooWindy"]("windy", gusts=12.0).gusts == 12.0
        assert names["TooWindy"]("windy").gusts == 0.0


def test_what_is_not_there_is_named() -> None:
    with pytest.raises(AttributeError, match=r"'m100link\.errors' has no attribute 'Nothing'"):
        loads("m100link.errors", "base")("Nothing")
    with pytest.raises(UsageError) as refusal:
        of_extra("no_such_module", "a gamepad", "station", ", or use the keys")
    assert refusal.value.seen == "a gamepad needs no_such_module, which is not installed"
    assert refusal.value.remedy == f"{INSTALL.format('station')}, or use the keys"
