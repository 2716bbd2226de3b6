"""Certificates and rights at the shell."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from m100link.apps.cli.outcome import ExitCode
from tests.apps.cli.conftest import CommandLine


@pytest.fixture
def folder(cli: CommandLine, tmp_path: Path) -> str:
    place = tmp_path / "pki"
    assert cli("fleet", "pki", "init", str(place)).status == ExitCode.OK
    return str(place)


def test_an_authority_issues_for_everybody(cli: CommandLine, folder: str) -> None:
    router = cli("fleet", "pki", "issue", "router", "base", "--folder", folder, "--host", "base")
    agent = cli("fleet", "pki", "issue", "agent", "a1", "--folder", folder)
    pilot = cli("fleet", "pki", "issue", "pilot", "anna", "--folder", folder)
    for outcome in (router, agent, pilot):
        assert outcome.status == ExitCode.OK
        assert Path(outcome.objects[0]["certificate"]).exists()
    assert len(pilot.objects[0]["public_key"]) == 64
    words = cli("fleet", "pki", "issue", "pilot", "bert", "--folder", folder, "--table").out
    assert [line.split(":")[0] for line in words.splitlines()] == [
        *("certificate", "key", "ends", "signing key", "public key"),
    ]


def test_what_is_there_stays(cli: CommandLine, folder: str) -> None:
    before = (Path(folder) / "ca.key").read_bytes()
    outcome = cli("fleet", "pki", "init", folder)
    assert outcome.status == ExitCode.USAGE
    assert "M100-BAD-AUTHORITY" in outcome.err
    assert (Path(folder) / "ca.key").read_bytes() == before
    assert cli("fleet", "pki", "init", folder, "--force").status == ExitCode.OK
    assert (Path(folder) / "ca.key").read_bytes() != before


@pytest.fixture
def rights(tmp_path: Path) -> str:
    path = tmp_path / "rights.toml"
    key = f'public_key = "{"0a" * 32}"'
    path.write_text(
        f'[aircraft.a1]\n[aircraft.a2]\n[identity.anna]\n{key}\nfly = ["a1"]\n'
        '[identity.wall]\nwatch = ["*"]\n'
    )
    return str(path)


def test_what_somebody_may_do(cli: CommandLine, rights: str) -> None:
    outcome = cli("fleet", "acl", "check", rights, "--who", "anna")
    assert outcome.objects == [
        {"who": "anna", "certificate": "anna", "signs": True, "may": {"a1": "fly", "a2": None}}
    ]
    assert [one["who"] for one in cli("fleet", "acl", "check", rights).objects] == ["anna", "wall"]
    assert cli("fleet", "acl", "check", rights, "--table").out.splitlines() == [
        "anna (certificate anna, signs orders)",
        "  a1: watch and fetch logs, stop, fly",
        "  a2: nothing",
        "wall (certificate wall, signs nothing: agents obey no order)",
        "  a1: watch and fetch logs",
        "  a2: watch and fetch logs",
        "  *: watch and fetch logs",
    ]


def test_nobody_of_that_name(cli: CommandLine, rights: str) -> None:
    outcome = cli("fleet", "acl", "check", rights, "--who", "eve")
    assert outcome.status == ExitCode.USAGE
    assert "nobody in" in outcome.err
    assert "one of anna, wall" in outcome.err


def test_rules_of_a_router_are_written(cli: CommandLine, rights: str, tmp_path: Path) -> None:
    printed = cli("fleet", "acl", "zenoh", rights, "-")
    found = json.loads(printed.out)["access_control"]
    assert found["default_permission"] == "deny"
    target = tmp_path / "acl.json"
    assert cli("fleet", "acl", "zenoh", rights, str(target)).status == ExitCode.OK
    assert json.loads(target.read_text()) == {"access_control": found}
    assert cli("fleet", "acl", "zenoh", rights, str(target)).status == ExitCode.USAGE
    assert cli("fleet", "acl", "zenoh", rights, "/dev/full", "--force").status == ExitCode.USAGE


# -- who lost a laptop ----------------------------------------------------------------------------


def test_who_is_revoked_is_said_wherever_somebody_looks(
    cli: CommandLine, folder: str, rights: str
) -> None:
    for name in ("anna", "bert"):
        assert cli("fleet", "pki", "issue", "pilot", name, "--folder", folder).status == 0
    outcome = cli("fleet", "pki", "revoke", "anna", "--folder", folder)
    [since] = outcome.objects[0]["names"].values()
    assert outcome.objects == [{"number": 1, "names": {"anna": since}}]
    words = cli("fleet", "pki", "revoke", "wall", "--folder", folder, "--table").out
    assert "list 2" in words
    assert f"anna: revoked since {since}" in words
    listed = cli("fleet", "pki", "list", "--folder", folder).objects
    assert [(one["name"], one["revoked"]) for one in listed] == [("anna", since), ("bert", None)]
    words = cli("fleet", "pki", "list", "--folder", folder, "--table").out
    assert words.splitlines()[0] == f"anna: revoked since {since}"
    assert words.splitlines()[1].startswith("bert: ends 20")
    [told] = cli("fleet", "acl", "check", rights, "--who", "anna", "--pki", folder).objects
    assert (told["revoked"], told["may"]) == (since, {"a1": None, "a2": None})
    words = cli("fleet", "acl", "check", rights, "--who", "anna", "--pki", folder, "--table").out
    assert words.splitlines() == [
        f"anna (certificate anna, revoked since {since})",
        "  a1: nothing",
        "  a2: nothing",
    ]
    rules = cli("fleet", "acl", "zenoh", rights, "-", "--pki", folder).out
    assert "anna" not in rules
    assert "anna" in cli("fleet", "acl", "zenoh", rights, "-").out


def test_a_list_is_brought_by_who_has_one(cli: CommandLine, folder: str) -> None:
    outcome = cli("fleet", "pki", "push", "--all", "--pki", folder)
    assert outcome.status == ExitCode.USAGE
    assert "pki revoke makes it" in outcome.err
    assert cli("fleet", "pki", "revoke", "--folder", folder).status == ExitCode.USAGE
