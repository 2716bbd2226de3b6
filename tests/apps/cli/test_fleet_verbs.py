"""What the list of the fleet's verbs says."""

from __future__ import annotations

import pytest

pytest.importorskip("cyclopts")
pytest.importorskip("zenoh")

from m100link.apps.cli.fleet_verbs import app


def test_every_verb_says_what_it_does_where_all_are_listed() -> None:
    verbs = {name: app[name] for name in app if not name.startswith("-")}
    assert len(verbs) > 10
    assert {name for name, verb in verbs.items() if not verb.help} == set()
