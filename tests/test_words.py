"""The words of the manual, of messages and of comments: what is counted may only become fewer."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
FOLDERS = ("docs", "examples", "m100link")
PAGES = ("README.md", "CHANGELOG.md", "CONTRIBUTING.md")

# What to write instead.
HABITS = {
    "whoever": "name the actor: the pilot, a program, the agent",
    "headless": "begin with a noun: 'a client that connects', 'the data on disk'",
    "told": "say who reports it: 'the agent reports …'",
    "of before": "write 'earlier orders', 'the previous value'",
    "of then": "write 'at that time', 'the time at which …'",
    "outside": "name the errata entry, the section of DJI's document, or a page of the manual",
    "halt": "write 'hover' for the order, 'stop' for STOP and for the end of a program or mission",
}
# One pass over all texts. Lines of a comment begin with "#". A headless sentence has a full stop:
# a question, a heading and a cell of a table have none.
FIND = re.compile(
    r"""\b(?:
      (?P<whoever>[Ww]hoever\b)
    | (?P<headless>(?:Who|What)[\s#]+[a-z](?=(?:[^.?!|\n]|\n(?!\s*\n)|\.(?=\w))*\.))
    | (?P<told>(?<![.`"])told\b(?![`"]))
    | of[\s#]+(?:(?P<of_before>before\b)|(?P<of_then>then\b))
    | (?P<halt>(?<!\.)halt(?:s|ed|ing)?\b(?![("`]))
    | (?P<outside>[Ff]acts[ ](?:[A-Z]\d|§)|facts(?:\.md|-later)|design/|judged/)
    )""",
    re.VERBOSE,
)
TOO_LONG = 35  # words of a sentence

# These may only fall. Lower them when you made them too large.
MOST = {
    "whoever": 0,
    "headless": 0,
    "told": 1,
    "of before": 0,
    "of then": 0,
    "outside": 0,
    "halt": 0,
    "long sentences": 2,
    "shared class names": 12,
}


@cache
def texts() -> dict[str, str]:
    """All that is read, once: by its path."""
    paths = [Path(page) for page in PAGES]
    for folder in FOLDERS:
        paths += [
            path.relative_to(ROOT)
            for path in (ROOT / folder).rglob("*.*")
            if path.suffix in (".md", ".py", ".toml")
        ]
    built = {"_build", "_ext", "manual"}  # what is made of these files, and how
    return {
        str(path): (ROOT / path).read_text(encoding="utf-8")
        for path in sorted(paths)
        if not built & set(path.parts)
    }


def prose(page: str) -> str:
    """A page of Markdown without programs and headings."""
    return re.sub(r"^```.*?^```$|^#[^\n]*$", "", page, flags=re.M | re.S)


def sentences(page: str) -> Iterator[str]:
    """Sentences of a page; an item of a list and a cell of a table end one."""
    text = re.sub(r"\]\([^)]*\)|\]\[[^\]]*\]", "]", prose(page))
    for part in re.split(r"\n\s*\n|\n\s*(?:[-*:]|\d+\.) |\|", text):
        yield from re.split(r"(?<=[.!?])[*_)\"]*\s+", part)


def habits(text: str) -> Iterator[str]:
    """Each habit that a text has, as often as it has it."""
    for match in FIND.finditer(text):
        assert match.lastgroup is not None
        yield match.lastgroup.replace("_", " ")


@cache
def places() -> dict[str, list[str]]:
    """The files that have a habit, each as often as it has it."""
    counted: dict[str, list[str]] = {habit: [] for habit in HABITS}
    for path, text in texts().items():
        for habit in habits(prose(text) if path.endswith(".md") else text):
            counted[habit].append(path)
    return counted


def few(what: str, where: list[str], instead: str) -> None:
    """Fail when there are more of them than ``MOST`` says, or so few that it has to be lowered."""
    most, counted = MOST[what], len(where)
    assert counted <= most, (
        f"{counted} times {what!r}, MOST of {__name__} allows {most}; {instead}. They are in: "
        + ", ".join(f"{place} ({count})" for place, count in Counter(where).items())
    )
    assert counted >= most * 0.9 - 5, f"{counted} times {what!r}: lower the {most} in {__name__}"


@pytest.mark.parametrize("habit", HABITS)
def test_sentences_have_an_actor_the_order_of_english_and_sources_that_can_be_read(
    habit: str,
) -> None:
    few(habit, places()[habit], HABITS[habit])


def test_sentences_of_the_how_tos_are_short() -> None:
    long = [
        f"{path}: {' '.join(sentence.split()[:6])} …"
        for path, text in texts().items()
        if path == "README.md" or path.startswith("docs/howto/")
        for sentence in sentences(text)
        if len(sentence.split()) > TOO_LONG
    ]
    few("long sentences", long, "make two of one")


def test_a_public_class_name_stands_for_one_class() -> None:
    """The blocking API has classes of the same names: they are the same to its users."""
    names = Counter(
        name
        for path, text in texts().items()
        if path.startswith("m100link/") and not path.startswith("m100link/sync/")
        for name in re.findall(r"^class ([A-Z]\w*)", text, re.M)
    )
    shared = [name for name, count in names.items() if count > 1]
    few("shared class names", shared, "give one of the two a longer name")


@pytest.mark.parametrize(
    ("habit", "text", "count"),
    [
        ("whoever", "Whoever comes, and whoever goes.", 2),
        ("headless", "Who comes waits. It ends.\nWhat was\nloaded stays in 1.5 s.", 2),
        ("headless", "What comes? Who flies it?", 0),
        ("headless", "    # What others ask\n    # is refused.", 1),
        ("headless", "| What comes | Who |\n\nWhat it is\n\nIt waits.", 0),
        ("told", "It is told, they are\n    # told; key `told`, keys.told.", 2),
        ("of before", "orders of before, of beforehand", 1),
        ("of then", "the time of then", 1),
        ("outside", "(facts K7), Facts §3, see facts.md, as design/x says", 4),
        ("outside", "the facts of a flight, design / build, not judged", 0),
        ("halt", "It halts, and was halted; a halt.", 3),
        ("halt", "client.halt is hover(), `Halt`, def halt(why), halten", 0),
    ],
)
def test_what_a_habit_is(habit: str, text: str, count: int) -> None:
    assert list(habits(text)) == [habit] * count


def test_what_a_sentence_is() -> None:
    page = "# A head\n\nOne [two](x.md#y) three. Four 1.5\nfive!\n- six\n- seven\n\n| 8 | 9. 10 |\n"
    page += "```sh\nnot one\n```\n"
    read = [" ".join(one.split()) for one in sentences(page)]
    assert [one for one in read if one] == [
        "One [two] three.",
        "Four 1.5 five!",
        "six",
        "seven",
        "8",
        "9.",
        "10",
    ]
