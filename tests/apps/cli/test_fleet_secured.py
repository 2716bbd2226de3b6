"""Certificates, rules and signatures from end to end, in processes of their own."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Iterator
from contextlib import ExitStack
from datetime import UTC, datetime
from pathlib import Path

import pytest

from m100link.apps.cli.outcome import ExitCode
from m100link.apps.fleet.pki import Kind, init, issue, revoke
from tests.apps.cli.test_fleet import Site
from tests.apps.fleet.test_pki import free_port, until
from tests.waiting import PATIENCE

pytest.importorskip("zenoh", reason="the extra fleet is not installed")

pytestmark = pytest.mark.pty


class Secured(Site):
    """Behind a router with certificates, which can be started anew."""

    router: subprocess.Popen[str]

    def begin_router(self, folder: Path) -> None:
        rights = str(folder / "rights.toml")
        words = ("--listen", self.place, "--name", "base", "--rights", rights, "--json")
        self.router = self.start("router", *words)
        assert self.router.stdout is not None
        assert self.router.stdout.readline()


@pytest.fixture
def site(tmp_path: Path) -> Iterator[Secured]:
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
        made = Secured(stack, f"tls/127.0.0.1:{free_port()}", tmp_path)
        made.environment["M100LINK_PKI"] = str(pki)
        secured = ("--rights", str(rights), "--json")
        made.begin_router(tmp_path)
        # On board lies what is needed there, and nothing that is made afterwards.
        (tmp_path / "board").mkdir()
        for name in ("ca.pem", "a1.pem", "a1.key"):
            shutil.copy(pki / name, tmp_path / "board" / name)
        board = ("--pki", str(tmp_path / "board"))
        agent = made.start("agent", "sim://", "--name", "a1", *board, *secured)
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


def test_who_lost_a_laptop_steers_no_more_and_after_a_start_of_the_router_hears_no_more(
    site: Secured, tmp_path: Path
) -> None:
    assert site.ask("takeoff", "a1", "--identity", "anna")[0] == ExitCode.OK
    held = site.start("lease", "a1", "--identity", "anna", "--json")
    assert held.stdout is not None
    assert held.stdout.readline()
    revoke(tmp_path / "pki", ["anna"], now=datetime.now(UTC))
    assert site.ask("stop", "a1", "--identity", "anna")[0] == ExitCode.OK, "nobody was told yet"
    status, [told] = site.ask("pki", "push", "--all", "--identity", "bert")
    assert (status, told["outcome"]) == (ExitCode.OK, "ok")
    assert (tmp_path / "board" / "revoked.list").exists()
    status, [told] = site.ask("stop", "a1", "--identity", "anna")
    assert (status, told["outcome"]) == (ExitCode.FAILED, "not_allowed")
    assert told["seen"].startswith("anna is revoked since ")
    assert held.wait(PATIENCE) != ExitCode.OK
    # As of one who fell silent: it ends when it was not renewed for its time.
    until(lambda: [card["holder"] for card in site.ask("list", "--identity", "wall")[1]] == [""])
    assert site.ask("list", "--identity", "anna")[1] != [], "the router that runs knows of no list"
    site.router.kill()
    site.router.wait(PATIENCE)
    site.begin_router(tmp_path)
    until(lambda: site.ask("list", "--identity", "bert")[1])
    assert site.ask("list", "--identity", "anna") == (ExitCode.OK, [])
    status, [told] = site.ask("stop", "a1", "--identity", "anna")
    assert (status, told["outcome"]) == (ExitCode.FAILED, "unreachable")
    assert site.ask("land", "a1", "--identity", "bert")[0] == ExitCode.OK
