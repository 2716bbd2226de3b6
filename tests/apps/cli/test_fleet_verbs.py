"""What the list of the fleet's verbs says."""

from __future__ import annotations

import time

import pytest

pytest.importorskip("cyclopts")
pytest.importorskip("zenoh")

from m100link.apps.agent.messages import RemoteError
from m100link.apps.cli.fleet_verbs import _link, app
from m100link.apps.fleet.payloads import Card


def test_every_verb_says_what_it_does_where_all_are_listed() -> None:
    verbs = {name: app[name] for name in app if not name.startswith("-")}
    assert len(verbs) > 10
    assert {name for name, verb in verbs.items() if not verb.help} == set()


@pytest.mark.parametrize(
    ("ahead", "said"),
    [
        (0.0, "connected"),
        (4.0, "connected"),
        (3600.0, "connected; clock 3600 s ahead of this one"),
        (-3600.0, "connected; clock 3600 s behind this one"),
    ],
)
def test_the_list_names_a_clock_by_which_a_signed_order_would_be_refused(
    ahead: float, said: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("time.time", lambda: 1.8e9)
    assert _link(Card("a1", "boot", 1.8e9 + ahead, "connected")) == said


@pytest.mark.parametrize("connection", ["connected", "lost"])
def test_the_list_says_what_would_refuse_the_first_order(connection: str) -> None:
    card = Card("a1", "boot", time.time(), connection, fault=RemoteError("M100-X", "no key"))
    assert _link(card) == f"{connection}: no key"
