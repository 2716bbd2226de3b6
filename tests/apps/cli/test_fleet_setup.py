"""Certificates and rights at the shell."""

from __future__ import annotations

import json
import os
import re
import shlex
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import asdict
from datetime import UTC, datetime, timedelta
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest

from m100link.apps.cli import fleet_setup
from m100link.apps.cli.fleet_setup import AgentOptions
from m100link.apps.cli.serve import settings_of
from m100link.apps.cli.terminal import ExitCode
from m100link.apps.fleet.identity import Rights
from m100link.apps.fleet.pki import Kind, init, issue, revoke
from m100link.apps.station.config import Settings
from m100link.apps.station.fleet import recorded_apart
from m100link.apps.station.fleet_file import FleetFault
from m100link.apps.station.run import _flights
from m100link.log import read
from m100link.log.folder import default_folder
from tests.apps.cli.conftest import CommandLine
from tests.apps.cli.test_fleet import Site, site
from tests.apps.fleet.test_pki import free_port, until
from tests.waiting import PATIENCE

__all__ = ["site"]

needs_zenoh = pytest.mark.skipif(
    find_spec("zenoh") is None, reason="the extra fleet is not installed"
)


@pytest.fixture
def folder(tmp_path: Path) -> str:
    init(tmp_path / "pki", now=datetime.now(UTC))
    return str(tmp_path / "pki")


FLEET = """
[router.base]
hosts = ["127.0.0.1"]
port = {port}
[aircraft.a1]
[aircraft.a2]
[identity.anna]
fly = ["a1", "a2"]
[identity.bert]
stop = ["a1", "a2"]
[identity.wall]
watch = ["a1", "a2"]
"""


def fleet_file(folder: Path) -> Path:
    folder.mkdir(exist_ok=True)
    path = folder / "fleet.toml"
    path.write_text(FLEET.format(port=free_port()))
    return path


def test_one_command_makes_what_a_file_needs(cli: CommandLine, tmp_path: Path) -> None:
    path = fleet_file(tmp_path)
    outcome = cli("fleet", "make", str(path))
    assert outcome.status == ExitCode.OK
    assert list(outcome.objects[0]["made"]) == ["base", "a1", "a2", "anna", "bert", "wall"]
    key = (tmp_path / "pki/ca.key").read_bytes()
    signing = (tmp_path / "pki/anna.signing.key").read_bytes()
    assert cli("fleet", "make", str(path)).objects == [{"made": {}}]
    assert len(cli("fleet", "make", str(path), "--renew").objects[0]["made"]) == 6
    assert (tmp_path / "pki/ca.key").read_bytes() == key
    assert (tmp_path / "pki/anna.signing.key").read_bytes() == signing
    words = cli("fleet", "make", str(path), "--renew", "--table").out.splitlines()
    assert [line.split(".pem: until ")[0] for line in words[:2]] == [
        str(tmp_path / "pki/base"),
        str(tmp_path / "pki/a1"),
    ]


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["a3"], "has no a3"),
        (["a1", "--real"], "[aircraft.a1]: no url says where it is"),
        (["a1"], "ca.pem cannot be read"),
    ],
)
def test_a_fleet_that_cannot_run_says_why(
    cli: CommandLine, tmp_path: Path, words: list[str], says: str
) -> None:
    outcome = cli("fleet", "up", str(fleet_file(tmp_path)), *words)
    assert outcome.status == ExitCode.USAGE
    assert says in " ".join(outcome.err.split())


FAULT = FleetFault("wrong clock", "a1", "the clock of a1 is 9 s ahead", "set both clocks")


@pytest.mark.parametrize(
    ("faults", "status", "said"),
    [([], ExitCode.OK, [{"ok": True}]), ([FAULT], ExitCode.FAILED, [asdict(FAULT)])],
)
def test_the_doctor_tells_a_program_that_a_fleet_is_well(
    cli: CommandLine,
    rights: str,
    monkeypatch: pytest.MonkeyPatch,
    faults: list[FleetFault],
    status: int,
    said: list[dict[str, Any]],
) -> None:
    async def examine(_: Rights, tell: Callable[[str], None]) -> list[FleetFault]:
        tell("what is well is for people")
        return faults

    monkeypatch.setattr(fleet_setup, "examine", examine)
    outcome = cli("fleet", "doctor", rights)
    assert (outcome.status, outcome.objects) == (status, said)


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
    assert outcome.objects == [{"who": "anna", "signs": True, "may": {"a1": "fly", "a2": None}}]
    assert [one["who"] for one in cli("fleet", "acl", "check", rights).objects] == ["anna", "wall"]
    assert cli("fleet", "acl", "check", rights, "--table").out.splitlines() == [
        "anna (signs orders)",
        "  a1: watch and fetch logs, stop, fly",
        "  a2: nothing",
        "wall (signs nothing: agents obey no order)",
        "  a1: watch and fetch logs",
        "  a2: watch and fetch logs",
        "  *: watch and fetch logs",
    ]


def test_nobody_of_that_name(cli: CommandLine, rights: str) -> None:
    outcome = cli("fleet", "acl", "check", rights, "--who", "eve")
    assert outcome.status == ExitCode.USAGE
    assert "has no identity eve" in outcome.err
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


def test_a_revoked_name_is_shown_everywhere(cli: CommandLine, rights: str) -> None:
    folder = str(Path(rights).with_name("pki"))
    assert "anna" in cli("fleet", "acl", "zenoh", rights, "-").out
    init(Path(folder), now=datetime.now(UTC))
    outcome = cli("fleet", "pki", "revoke", "anna", "--folder", folder)
    [since] = outcome.objects[0]["names"].values()
    assert outcome.objects == [{"number": 1, "names": {"anna": since}}]
    words = cli("fleet", "pki", "revoke", "wall", "--folder", folder, "--table").out
    assert "list 2" in words
    assert f"anna: revoked since {since}" in words
    [told] = cli("fleet", "acl", "check", rights, "--who", "anna").objects
    assert (told["revoked"], told["may"]) == (since, {"a1": None, "a2": None})
    words = cli("fleet", "acl", "check", rights, "--who", "anna", "--table").out
    assert words.splitlines() == [
        f"anna (revoked since {since})",
        "  a1: nothing",
        "  a2: nothing",
    ]
    assert "anna" not in cli("fleet", "acl", "zenoh", rights, "-").out


def test_a_list_is_brought_by_who_has_one(cli: CommandLine, folder: str) -> None:
    outcome = cli("fleet", "pki", "push", "--all", "--pki", folder)
    assert outcome.status == ExitCode.USAGE
    assert "pki revoke writes it" in outcome.err
    assert cli("fleet", "pki", "revoke", "--folder", folder).status == ExitCode.USAGE


# -- certificates, rules and signatures from end to end, in processes of their own -----------------


class Secured(Site):
    """A fleet of one file: its router here, its agent on a board with nothing but its own keys."""

    router: subprocess.Popen[str]

    def begin(self, file: Path, *names: str) -> subprocess.Popen[str]:
        begun = self.start("up", str(file), *names, "--json")
        assert begun.stdout is not None
        assert json.loads(begun.stdout.readline())["up"] == list(names)
        return begun

    def is_connected(self) -> bool:
        _, cards = self.ask("list", "--identity", "anna")
        return [card.get("connection") for card in cards] == ["connected"]


@pytest.fixture
def secured_site(tmp_path: Path, cli: CommandLine) -> Iterator[Secured]:
    file = fleet_file(tmp_path)
    assert cli("fleet", "make", str(file)).status == ExitCode.OK
    with ExitStack() as stack:
        made = Secured(stack, str(file), tmp_path)
        made.router = made.begin(file, "base")
        made.begin(tmp_path / "boards/a1/fleet.toml", "a1")
        until(made.is_connected)  # which "up" does not say
        yield made


UP = "m100link fleet up fleet.toml &"
HOWTO = Path(__file__).parents[3] / "docs/howto/fly-a-fleet.md"


@pytest.mark.pty
@needs_zenoh
def test_somebody_new_brings_a_fleet_up_by_the_lines_of_the_page(tmp_path: Path) -> None:
    """Two of the page's three; then one agent dies, and then all are ended."""
    page = HOWTO.read_text()
    text = re.search(r"```toml\n(.*?)```", page, re.DOTALL)
    blocks = re.findall(r"```sh\n(.*?)```", page, re.DOTALL)
    assert text is not None
    small = re.sub(r"\[aircraft\.a([3-9]|10)\]\n", "", text[1]).replace("7447", str(free_port()))
    small = small.replace('identity = "anna"', f'identity = "anna"\nconsole_port = {free_port()}')
    (tmp_path / "fleet.toml").write_text(small)
    steps = "".join(blocks[1:5]).replace("# another terminal\nm100link fleet up fleet.toml", UP)
    lines = steps.replace("m100link fleet land --all\n", "").splitlines()
    assert UP in lines
    assert len(lines) < 8
    environment = os.environ | {"XDG_STATE_HOME": str(tmp_path)}
    here: dict[str, Any] = {"cwd": tmp_path, "text": True, "stdout": subprocess.PIPE}
    begun: list[subprocess.Popen[str]] = []
    try:
        for line in lines:
            word, *words = shlex.split(line.removesuffix("&"))
            if word == "export":
                environment |= dict(one.split("=") for one in words)
            elif line.endswith("&"):
                command = [sys.executable, "-m", word, *words]
                begun.append(subprocess.Popen(command, env=environment, **here))
                assert begun[0].stdout is not None
                told = json.loads(begun[0].stdout.readline())
                assert (list(told)[:2], told["real"]) == (["up", "real"], False)
            else:
                command = [sys.executable, "-m", word, *words]
                done = subprocess.run(command, env=environment, check=False, **here)
                assert done.returncode == ExitCode.OK, (line, done.stdout)
        site = Site(ExitStack(), "fleet.toml", tmp_path)
        site.environment = environment | {"M100LINK_FLEET": str(tmp_path / "fleet.toml")}
        in_air = site.listed(2, lambda one: one["phase"] == "in air")
        assert [card["name"] for card in in_air] == ["a1", "a2"]
        _, agent, *_ = children_of(begun[0].pid)
        os.kill(agent, signal.SIGKILL)
        # It begins anew, with a virtual aircraft that stands; the other one flies on.
        is_begun_anew = [False, True]
        until(
            lambda: (
                sorted(card.get("phase") == "in air" for card in site.listed(2)) == is_begun_anew
            )
        )
        begun[0].send_signal(signal.SIGINT)
        assert begun[0].wait(PATIENCE) == ExitCode.OK
        assert site.ask("list")[0] == ExitCode.NO_ROUTER
    finally:
        for one in begun:
            one.kill()
            one.communicate(timeout=PATIENCE)


@pytest.mark.pty
@needs_zenoh
def test_what_up_started_ends_when_it_is_killed(tmp_path: Path, cli: CommandLine) -> None:
    file = fleet_file(tmp_path)
    assert cli("fleet", "make", str(file)).status == ExitCode.OK
    with ExitStack() as stack:
        begun = Site(stack, str(file), tmp_path).start("up", str(file), "--json")
        assert begun.stdout is not None
        assert json.loads(begun.stdout.readline())["up"] == ["base", "a1", "a2"]
        children = children_of(begun.pid)
        assert len(children) >= 3
        begun.kill()
        until(lambda: not any(Path(f"/proc/{child}/exe").exists() for child in children))


@pytest.mark.pty
@needs_zenoh
def test_what_up_started_says_that_its_certificate_ended(tmp_path: Path, cli: CommandLine) -> None:
    """Nothing is up then; what a process of its own warns of came to nobody without --log-level."""
    file, ends = fleet_file(tmp_path), datetime.now(UTC) - timedelta(minutes=5)
    assert cli("fleet", "make", str(file)).status == ExitCode.OK
    for name in ("a1", "a2"):
        (tmp_path / f"pki/{name}.pem").unlink()
        (tmp_path / f"pki/{name}.key").unlink()
        issue(tmp_path / "pki", Kind.AGENT, name, now=ends - timedelta(days=30))
    command = [sys.executable, "-m", "m100link", "fleet", "up", str(file), "a1", "a2"]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as begun:
        assert begun.stderr is not None
        try:
            said = "".join(begun.stderr.readline() for _ in range(4))
        finally:
            begun.send_signal(signal.SIGTERM)
        begun.communicate(timeout=PATIENCE)
    for words in ("certificate of a1 expired on", "certificate of a2 expired on"):
        assert words in said
    assert said.count("no router answers yet") == 2
    assert begun.returncode == ExitCode.OK


def children_of(parent: int) -> list[int]:
    """The children of a process, the one that was begun first at first."""
    return sorted(map(int, Path(f"/proc/{parent}/task/{parent}/children").read_text().split()))


@pytest.mark.pty
@needs_zenoh
def test_each_may_do_what_the_file_says_and_nobody_comes_without_a_certificate(
    secured_site: Site, tmp_path: Path
) -> None:
    for who in ("anna", "bert", "wall"):
        status, [card] = secured_site.ask("list", "--identity", who)
        assert (status, card["name"]) == (ExitCode.OK, "a1")
        assert "connection" in card, f"{who} hears where it stands"
        status, [log] = secured_site.ask("log", "list", "a1", "--identity", who)
        assert (status, log["name"]) == (ExitCode.OK, "a1")
        status, [mission] = secured_site.ask("mission", "progress", "a1", "--identity", who)
        assert (status, mission["stage"]) == (ExitCode.OK, "none")
    status, shown = secured_site.ask("monitor", "--duration", "5", "--identity", "wall")
    assert (status, shown[-1]["battery"]) == (ExitCode.OK, {"percent": 100})
    assert shown[-1]["received"] > 0
    status, packages = secured_site.ask("watch", "a1", "--duration", "3", "--identity", "wall")
    assert status == ExitCode.OK
    assert "position" in {name for one in packages for name in one}
    status, [told] = secured_site.ask("takeoff", "a1", "--identity", "anna")
    assert (status, told["outcome"]) == (ExitCode.OK, "ok")
    for who in ("wall", "bert"):
        status, [told] = secured_site.ask("takeoff", "a1", "--identity", who)
        assert (status, told["outcome"]) == (ExitCode.FAILED, "not_allowed")
        assert told["seen"] == f"{who} may not fly a1; nothing was sent"
    # Without the file a router that routes nothing looks like silence.
    port = Rights.read(tmp_path / "fleet.toml").endpoints
    there = ("--connect", *port, "--pki", str(tmp_path / "pki"), "--patience", "3")
    status, [told] = secured_site.ask("takeoff", "a1", "--identity", "bert", *there)
    assert (status, told["outcome"]) == (ExitCode.FAILED, "unknown")
    assert "acl check" in told["remedy"]
    assert secured_site.ask("mission", "stop", "a1", "--identity", "wall")[0] == ExitCode.FAILED
    assert secured_site.ask("mission", "stop", "a1", "--identity", "bert")[0] == ExitCode.OK
    status, [told] = secured_site.ask("land", "a1", "--identity", "bert")
    assert (status, told["outcome"]) == (ExitCode.OK, "ok")
    here = ("--output", str(tmp_path / "here"), "--identity", "wall")
    status, lines = secured_site.ask("log", "audit", "a1", *here)
    assert status == ExitCode.OK
    done = {line["order"]: line for line in lines if line["outcome"] == "ok"}
    assert (done["take off"]["signer"], done["land"]["signer"]) == ("anna", "bert")
    assert done["land"]["ordered_at"] < done["land"]["at"], "it was ordered, and then it was down"
    status, [fetched] = secured_site.ask("log", "fetch", "a1", *here)
    assert (status, Path(fetched["path"]).stat().st_size) == (ExitCode.OK, fetched["size"])
    assert secured_site.ask("list")[0] == ExitCode.NO_ROUTER


@pytest.mark.pty
@needs_zenoh
def test_a_lost_laptop_steers_no_more_and_hears_no_more(
    secured_site: Secured, tmp_path: Path
) -> None:
    assert secured_site.ask("takeoff", "a1", "--identity", "anna")[0] == ExitCode.OK
    held = secured_site.start("lease", "a1", "--identity", "anna", "--json")
    assert held.stdout is not None
    assert held.stdout.readline()
    revoke(tmp_path / "pki", ["anna"], now=datetime.now(UTC))
    status, [told] = secured_site.ask("pki", "push", "a1", "--identity", "bert")
    assert (status, told["outcome"]) == (ExitCode.OK, "ok")
    assert (tmp_path / "boards/a1/pki/revoked.list").exists()
    assert held.wait(PATIENCE) != ExitCode.OK
    # As of one who fell silent: it ends when it was not renewed for its time.
    until(
        lambda: (
            [card["holder"] for card in secured_site.ask("list", "--identity", "wall")[1]] == [""]
        )
    )
    # The router of this machine reads the list within a second, and lets her hear nothing more.
    until(lambda: secured_site.ask("list", "--identity", "anna")[1] == [])
    until(lambda: secured_site.ask("list", "--identity", "bert")[1])
    assert secured_site.ask("list", "--identity", "anna") == (ExitCode.OK, [])
    status, [told] = secured_site.ask("stop", "a1", "--identity", "anna")
    assert (status, told["outcome"]) == (ExitCode.FAILED, "unreachable")
    assert secured_site.ask("land", "a1", "--identity", "bert")[0] == ExitCode.OK


# -- ``m100link fleet agent`` records as other stations do: a folder for each aircraft -------------


@needs_zenoh
def test_every_aircraft_has_a_folder_of_its_own() -> None:
    settings = recorded_apart(settings_of(AgentOptions()), "a1")
    assert settings.record == default_folder() / "a1"
    assert recorded_apart(settings_of(AgentOptions(no_record=True)), "a1").record is None


@needs_zenoh
@pytest.mark.parametrize("is_ours", [True, False])
def test_logs_make_room_in_our_folder_and_in_no_other(tmp_path: Path, is_ours: bool) -> None:
    folder = default_folder() if is_ours else tmp_path
    settings = recorded_apart(Settings(record=folder, record_keep=1), "a1")
    flights = _flights(settings, lambda text, level: None)
    assert flights is not None
    flights.folder.mkdir(parents=True, exist_ok=True)
    paths = [flights.folder / f"m100link-20260101-00000{n}.mcap" for n in range(3)]
    for path in paths:
        with path.open("wb") as stream:
            header = b"\0\0\0\0" + (13).to_bytes(4, "little") + b"m100link 1.23"
            stream.write(b"\x89MCAP0\r\n\x01" + len(header).to_bytes(8, "little") + header)
    flights.make_room()
    assert sum(path.exists() for path in paths) == (1 if is_ours else 3)
    for path in paths:
        path.unlink(missing_ok=True)


@needs_zenoh
@pytest.mark.pty
def test_each_connection_leaves_a_log_that_is_whole(site: Site, tmp_path: Path) -> None:
    agent = site.start("agent", "sim://", "--name", "a", "--count", "2", "--json")
    assert agent.stdout is not None
    assert json.loads(agent.stdout.readline())["agents"] == ["a1", "a2"]
    assert [card["connection"] for card in site.listed(2)] == ["connected"] * 2
    assert site.ask("takeoff", "a2")[0] == 0
    agent.send_signal(signal.SIGTERM)
    assert agent.wait(PATIENCE) == 0
    for name in ("a1", "a2"):
        [path] = (tmp_path / "m100link/flights" / name).iterdir()
        assert read(path).summary().is_whole


@needs_zenoh
@pytest.mark.pty
@pytest.mark.parametrize("is_json", [False, True])
def test_what_happens_is_reported_once_and_on_one_line(
    site: Site, tmp_path: Path, is_json: bool
) -> None:
    words = ["agent", "sim://", "--name", "a1", *(["--log-json"] if is_json else [])]
    folder = tmp_path / ("a long name of a folder " * 4).strip()
    agent = subprocess.Popen(
        [sys.executable, "-m", "m100link", "fleet", *words, "--record", str(folder)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=site.environment,
    )
    try:
        site.listed(1)
        assert site.ask("takeoff", "a1")[0] == 0
        holder = site.start("lease", "a1", "--json")
        assert holder.stdout is not None
        assert holder.stdout.readline()
        holder.kill()  # the agent warns: its lease ends by silence
        ends = time.monotonic() + PATIENCE
        while time.monotonic() < ends and site.listed(1)[0]["holder"]:
            time.sleep(0.1)
    finally:
        agent.send_signal(signal.SIGTERM)
        _, told = agent.communicate(timeout=PATIENCE)
    lines = told.splitlines()
    assert sum("lost control (expired)" in line for line in lines) == 1
    assert sum(f"recorded into {folder}/a1/" in line for line in lines) == (0 if is_json else 1)
    if is_json:
        expired = [json.loads(line) for line in lines if "expired" in line]
        assert [(one["level"], one["aircraft"]) for one in expired] == [("WARNING", "a1")]


@needs_zenoh
@pytest.mark.pty
def test_where_nothing_can_be_written_it_flies_all_the_same(site: Site, tmp_path: Path) -> None:
    taken = tmp_path / "taken"
    taken.touch()
    site.start("agent", "sim://", "--name", "a1", "--record", str(taken))
    site.start("agent", "sim://", "--name", "a2", "--no-record")
    site.listed(2)
    status, told = site.ask("takeoff", "--all")
    assert (status, [one["outcome"] for one in told]) == (0, ["ok", "ok"])
    assert not (tmp_path / "m100link/flights").exists()
