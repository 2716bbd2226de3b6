"""Certificates, rules and signatures from end to end, in processes of their own."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack
from datetime import UTC, datetime
from pathlib import Path

import pytest

from m100link.cli.outcome import ExitCode
from m100link.fleet.pki import Kind, init, issue
from tests.cli.test_fleet import Site
from tests.fleet.test_acl import free_port

pytest.importorskip("zenoh", reason="the extra fleet is not installed")

pytestmark = pytest.mark.pty


@pytest.fixture
def site(tmp_path: Path) -> Iterator[Site]:
    now, pki = datetime.now(UTC), tmp_path / "pki"
    init(pki, now=now)
    issue(pki, Kind.ROUTER, "base", now=now, hosts=["127.0.0.1"])
    issue(pki, Kind.AGENT, "a1", now=now)
    rights = tmp_path / "rights.toml"
    text = "[aircraft.a1]\n"
    for name, right in (("anna", "fly"), ("bert", "stop"), ("wall", "watch")):
        key = issue(pki, Kind.PILOT, name, now=now).public_key
        text += f'[identity.{name}]\npublic_key = "{key}"\n{right} = ["a1"]\n'
    rights.write_text(text)
    with ExitStack() as stack:
        made = Site(stack, f"tls/127.0.0.1:{free_port()}", tmp_path)
        made.environment["M100LINK_PKI"] = str(pki)
        secured = ("--rights", str(rights), "--json")
        router = made.start("router", "--listen", made.place, "--name", "base", *secured)
        assert router.stdout is not None
        assert router.stdout.readline()
        agent = made.start("agent", "sim://", "--name", "a1", *secured)
        assert agent.stdout is not None
        assert agent.stdout.readline()
        yield made


def test_each_may_do_what_the_file_says_and_nobody_comes_without_a_certificate(site: Site) -> None:
    for who in ("anna", "bert", "wall"):
        status, [card] = site.ask("list", "--identity", who)
        assert (status, card["name"]) == (ExitCode.OK, "a1")
        assert "connection" in card, f"{who} is told where it stands"
        status, [log] = site.ask("log", "list", "a1", "--identity", who)
        assert (status, log["name"]) == (ExitCode.OK, "a1")
        status, [mission] = site.ask("mission", "progress", "a1", "--identity", who)
        assert (status, mission["stage"]) == (ExitCode.OK, "none")
    status, [told] = site.ask("takeoff", "a1", "--identity", "anna")
    assert (status, told["outcome"]) == (ExitCode.OK, "ok")
    for who, expected in (("wall", "unknown"), ("bert", "unknown")):
        status, [told] = site.ask("takeoff", "a1", "--identity", who)
        assert status != ExitCode.OK
        assert told["outcome"] == expected  # a router that routes nothing looks like silence
    assert site.ask("mission", "stop", "a1", "--identity", "wall")[0] == ExitCode.FAILED
    assert site.ask("mission", "stop", "a1", "--identity", "bert")[0] == ExitCode.OK
    status, [told] = site.ask("land", "a1", "--identity", "bert")
    assert (status, told["outcome"]) == (ExitCode.OK, "ok")
    assert site.ask("list")[0] == ExitCode.USAGE
