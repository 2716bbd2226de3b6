"""The file of rights: who may do what, and every mistake in it by its name."""

from __future__ import annotations

from pathlib import Path

import pytest

from m100link.apps.fleet.identity import BadRights, Right, Rights

FILE = """
site = "field"

[aircraft.a1]
[aircraft.a2]
common_name = "board-7"
[aircraft.b1]

[identity.anna]
public_key = "{key}"
fly = ["a1"]
stop = ["*"]

[identity.wall]
common_name = "screen"
watch = ["a*"]
""".format(key="0a" * 32)

WATCH, STOP, FLY = Right


# Who, which aircraft, and the most that is allowed; by hand from the file above.
TABLE = [
    ("anna", "a1", FLY),
    ("anna", "a2", STOP),
    ("anna", "b1", STOP),
    ("anna", "later", STOP),
    ("wall", "a1", WATCH),
    ("wall", "a2", WATCH),
    ("wall", "b1", None),
    ("wall", "a", WATCH),
]


@pytest.mark.parametrize(("who", "aircraft", "most"), TABLE)
@pytest.mark.parametrize("right", Right)
def test_who_may_do_what(who: str, aircraft: str, most: Right | None, right: Right) -> None:
    identity = Rights.parse(FILE).identity(who)
    assert identity is not None
    assert identity.may(right, aircraft) == (most is not None and right <= most)


def test_names_keys_and_common_names_are_as_the_file_says() -> None:
    rights = Rights.parse(FILE)
    assert rights.site == "field"
    assert rights.aircraft == {"a1": "a1", "a2": "board-7", "b1": "b1"}
    assert rights.identity("nobody") is None
    anna, wall = rights.identities.values()
    assert (anna.common_name, anna.public_key) == ("anna", b"\x0a" * 32)
    assert (wall.common_name, wall.public_key) == ("screen", None)
    assert anna.allowed(Right.WATCH) == ("*", "a1")
    assert anna.allowed(Right.FLY) == ("a1",)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("site = ", "is not TOML"),
        ('sight = "x"', "the file: there is no field 'sight'"),
        ('site = "a/b"', "site is 'a/b'"),
        ("aircraft = 3", "aircraft is no table of tables"),
        ("[identity]\nanna = 3", "identity is no table of tables"),
        ('[aircraft."a*"]', "aircraft is 'a*'"),
        ("[aircraft.a1]\nname = 3", "aircraft a1: there is no field 'name'"),
        ("[identity.anna]\nflies = []", "identity anna: there is no field 'flies'"),
        ('[identity.anna]\nfly = "a1"', "fly of anna is 'a1'"),
        ('[identity.anna]\nfly = ["a**"]', "fly of anna is 'a**'"),
        ('[identity.anna]\nfly = ["a/b"]', "fly of anna is 'a/b'"),
        ("[identity.anna]\nfly = [1]", "fly of anna is 1"),
        ('[identity.anna]\npublic_key = "12"', "public_key of anna is '12'"),
        ("[aircraft.a1]\n[identity.a1]", "two have the common name a1"),
        ('[identity.x]\n[identity.y]\ncommon_name = "x"', "two have the common name x"),
    ],
)
def test_every_mistake_is_named(text: str, said: str) -> None:
    with pytest.raises(BadRights) as caught:
        Rights.parse(text)
    assert said in caught.value.seen


def test_files_that_cannot_be_read_are_named(tmp_path: Path) -> None:
    with pytest.raises(BadRights, match=r"nowhere\.toml cannot be read"):
        Rights.read(tmp_path / "nowhere.toml")
    (tmp_path / "rights.toml").write_bytes(b"\xff")
    with pytest.raises(BadRights, match="is not text"):
        Rights.read(tmp_path / "rights.toml")
    (tmp_path / "rights.toml").write_text(FILE)
    assert Rights.read(tmp_path / "rights.toml") == Rights.parse(FILE)
    (tmp_path / "rights.toml").write_bytes(b"#" * (1024 * 1024 + 1))
    with pytest.raises(BadRights, match="too large"):
        Rights.read(tmp_path / "rights.toml")


def test_without_somebody_nothing_is_left_of_him_by_either_name() -> None:
    rights = Rights.parse(
        """
[aircraft.a1]
[aircraft.a2]
common_name = "board-2"
[identity.anna]
common_name = "laptop-7"
fly = ["*"]
[identity.bert]
stop = ["*"]
"""
    )
    for names, aircraft, people in (
        ({"anna"}, {"a1", "a2"}, {"bert"}),
        ({"laptop-7"}, {"a1", "a2"}, {"bert"}),
        ({"board-2", "bert"}, {"a1"}, {"anna"}),
        ({"a2"}, {"a1", "a2"}, {"anna", "bert"}),  # no certificate has that name
        ((), {"a1", "a2"}, {"anna", "bert"}),
    ):
        left = rights.without(names)
        assert (set(left.aircraft), set(left.identities)) == (aircraft, people)
