"""Rules of a router: that zenoh itself, with certificates, lets through what the file says."""

from __future__ import annotations

import json
import socket
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import pytest

from m100link.apps.fleet.identity import Right, Rights
from m100link.apps.fleet.pki import Kind, explain, init, issue, router_config
from tests.waiting import PATIENCE

zenoh: Any = pytest.importorskip("zenoh", reason="the extra fleet is not installed")

RIGHTS = Rights.parse(
    """
[aircraft.a1]
[aircraft.a2]
[identity.anna]
fly = ["a1"]
[identity.bert]
stop = ["a*"]
[identity.wall]
watch = ["*"]
[identity.none]
"""
)

# -- the rules as they are written ----------------------------------------------------------------


def rules_of(who: str) -> list[dict[str, Any]]:
    found = router_config(RIGHTS)
    [ids] = [one["rules"] for one in found["policies"] if one["subjects"] == [who]] or [[]]
    return [rule for rule in found["rules"] if rule["id"] in ids]


def test_what_no_rule_allows_is_denied() -> None:
    found = router_config(RIGHTS)
    assert (found["enabled"], found["default_permission"]) == (True, "deny")
    assert {rule["permission"] for rule in found["rules"]} == {"allow"}
    assert len({rule["id"] for rule in found["rules"]}) == len(found["rules"])


def test_an_agent_has_rules_for_nobody_elses_keys_but_a_question_and_places() -> None:
    """Where all stand is asked by one pattern, which has to be allowed as it stands."""
    keys = {key for rule in rules_of("agent a1") for key in rule["key_exprs"]}
    others = {key for key in keys if not key.startswith("m100/site/a1/")}
    assert others == {"m100/site/*/state", "m100/site/*/place", "m100-live/site/a1/*"}
    places = [one for one in rules_of("agent a1") if "m100/site/*/place" in one["key_exprs"]]
    assert not any("put" in one["messages"] and one["flows"] == ["ingress"] for one in places)
    [rule] = [one for one in rules_of("agent a1") if "m100/site/*/state" in one["key_exprs"]]
    assert (rule["flows"], rule["messages"]) == (["egress"], ["query"])


def test_part_of_a_name_is_written_as_zenoh_writes_it() -> None:
    queries = [rule for rule in rules_of("identity bert") if rule["messages"] == ["query"]]
    assert "m100/site/a$*/cmd" in queries[0]["key_exprs"]
    assert "m100/site/a$*/lease" not in queries[0]["key_exprs"]


def test_who_may_nothing_has_no_rule_but_is_known() -> None:
    assert rules_of("identity none") == []
    found = router_config(RIGHTS)
    assert {"id": "identity none", "cert_common_names": ["none"]} in found["subjects"]


def test_what_somebody_may_do_in_words() -> None:
    assert explain(RIGHTS, "anna") == [("a1", Right.FLY), ("a2", None)]
    assert explain(RIGHTS, "wall") == [("a1", Right.WATCH), ("a2", Right.WATCH), ("*", Right.WATCH)]


# -- and as zenoh obeys them ----------------------------------------------------------------------


def free_port() -> int:
    with socket.socket() as place:
        place.bind(("127.0.0.1", 0))
        return int(place.getsockname()[1])


def until(predicate: Callable[[], object]) -> None:
    """Wait for what other threads bring."""
    deadline = time.monotonic() + PATIENCE
    while not predicate():
        assert time.monotonic() < deadline
        time.sleep(0.01)


class Site:
    """A router of zenoh with the rules, certificates, and who comes with one."""

    def __init__(self, folder: Path, stack: ExitStack) -> None:
        self.folder = folder
        self.endpoint = f"tls/127.0.0.1:{free_port()}"
        self._stack = stack
        now = datetime.now(UTC)
        init(folder, now=now)
        issue(folder, Kind.ROUTER, "base", now=now, hosts=["127.0.0.1"])
        for name in ("a1", "a2", "anna", "bert", "wall", "stranger"):
            issue(folder, Kind.AGENT, name, now=now)
        issue(folder, Kind.AGENT, "late", now=now - timedelta(days=31))
        config = self._config("router", folder, listen="base")
        config.insert_json5("access_control", json.dumps(router_config(RIGHTS)))
        stack.enter_context(zenoh.open(config))

    def _config(self, mode: str, folder: Path, *, listen: str = "", connect: str = "") -> Any:
        config = zenoh.Config()
        tls: dict[str, Any] = {"root_ca_certificate": str(folder / "ca.pem"), "enable_mtls": True}
        for name, side in ((listen, "listen"), (connect, "connect")):
            if name:
                tls[f"{side}_certificate"] = str(folder / f"{name}.pem")
                tls[f"{side}_private_key"] = str(folder / f"{name}.key")
        endpoints = "listen/endpoints" if listen else "connect/endpoints"
        for key, value in {
            "mode": mode,
            "scouting/multicast/enabled": False,
            "scouting/gossip/enabled": False,
            "transport/link/tls": tls,
            endpoints: [self.endpoint],
            "connect/timeout_ms": 1500,
            "connect/exit_on_failure": True,
        }.items():
            config.insert_json5(key, json.dumps(value))
        return config

    def come(self, name: str, folder: Path | None = None) -> Any:
        config = self._config("client", folder or self.folder, connect=name)
        return self._stack.enter_context(zenoh.open(config))

    def serve(self, session: Any, key: str) -> None:
        def answer(query: Any) -> None:
            with query:
                query.reply(key, b"done")

        self._stack.callback(session.declare_queryable(key, answer).undeclare)

    def hear(self, session: Any, key: str) -> list[tuple[str, bytes]]:
        heard: list[tuple[str, bytes]] = []

        def take(sample: Any) -> None:
            heard.append((str(sample.key_expr), sample.payload.to_bytes()))

        self._stack.callback(session.declare_subscriber(key, take).undeclare)
        return heard


def answers(session: Any, key: str) -> int:
    return sum(reply.ok is not None for reply in session.get(key, timeout=2.0))


def seen(session: Any) -> set[str]:
    replies = session.liveliness().get("m100-live/site/*/*", timeout=2.0)
    return {str(reply.ok.key_expr).split("/")[2] for reply in replies if reply.ok is not None}


Heard = list[tuple[str, bytes]]


def told(agents: dict[str, Any], twin: Any, places: dict[str, Heard], own: Heard) -> bool:
    """Each aircraft tells its own place, one a false one of another, until all are heard."""
    for name, session in agents.items():
        session.put(f"m100/site/{name}/place", name.encode())
    twin.put("m100/site/a1/state", b"twin")
    agents["a2"].put("m100/site/a1/place", b"false")
    is_heard = all(len({key for key, _ in one}) == 2 for one in places.values())
    return is_heard and own == [("m100/site/a1/state", b"twin")] * len(own) != []


@pytest.fixture
def site(tmp_path: Path) -> Iterator[Site]:
    with ExitStack() as stack:
        yield Site(tmp_path / "pki", stack)


def test_a_router_lets_everybody_do_what_the_file_says(site: Site) -> None:
    agents = {name: site.come(name) for name in ("a1", "a2")}
    people = {name: site.come(name) for name in ("anna", "bert", "wall", "stranger")}
    tokens = [
        agents[name].liveliness().declare_token(f"m100-live/site/{name}/{agents[name].zid()}")
        for name in agents
    ]
    for name, session in agents.items():
        for what in ("cmd", "lease", "state"):
            site.serve(session, f"m100/site/{name}/{what}")
    setpoints = site.hear(agents["a1"], "m100/site/a1/setpoint")
    heard = {name: site.hear(one, "m100/site/*/tel/5hz") for name, one in people.items()}

    until(lambda: seen(people["wall"]) == {"a1", "a2"})
    until(lambda: answers(people["anna"], "m100/site/a1/cmd") == 1)
    table = {
        (name, aircraft, what): answers(session, f"m100/site/{aircraft}/{what}") == 1
        for name, session in people.items()
        for aircraft in agents
        for what in ("state", "cmd", "lease")
    }
    allowed = {
        *(("anna", "a1", what) for what in ("state", "cmd", "lease")),
        *(("bert", aircraft, what) for aircraft in agents for what in ("state", "cmd")),
        *(("wall", aircraft, "state") for aircraft in agents),
    }
    assert {what for what, is_answered in table.items() if is_answered} == allowed
    assert {name: seen(one) for name, one in people.items()} == {
        "anna": {"a1"},
        "bert": {"a1", "a2"},
        "wall": {"a1", "a2"},
        "stranger": set(),
    }

    cards = {name: answers(session, "m100/site/*/state") for name, session in people.items()}
    assert cards == {"anna": 1, "bert": 2, "wall": 2, "stranger": 0}

    places = {name: site.hear(one, "m100/site/*/place") for name, one in agents.items()}
    own = site.hear(agents["a1"], "m100/site/a1/state")
    twin = site.come("a1")
    until(lambda: told(agents, twin, places, own))
    assert {word for _, word in places["a1"]} == {b"a1", b"a2"}

    for name, session in people.items():
        session.put("m100/site/a1/setpoint", name.encode())
    agents["a2"].put("m100/site/a1/tel/5hz", b"false")  # an aircraft that says to be another one
    people["bert"].put("m100/site/a1/tel/5hz", b"false")
    for name, session in agents.items():
        session.put(f"m100/site/{name}/tel/5hz", name.encode())
    both = {("m100/site/a1/tel/5hz", b"a1"), ("m100/site/a2/tel/5hz", b"a2")}
    until(lambda: set(heard["wall"]) >= both)
    until(lambda: len(heard["anna"]) >= 1 and len(setpoints) >= 1)
    assert set(heard["wall"]) == both
    assert heard["anna"] == [("m100/site/a1/tel/5hz", b"a1")]
    assert heard["stranger"] == []
    assert setpoints == [("m100/site/a1/setpoint", b"anna")]
    assert len(tokens) == 2


def test_nobody_comes_without_a_certificate_of_the_authority(site: Site, tmp_path: Path) -> None:
    now = datetime.now(UTC)
    init(tmp_path / "other", now=now)
    issue(tmp_path / "other", Kind.AGENT, "anna", now=now)
    # It has to believe the router, or it would go by itself.
    (tmp_path / "other" / "ca.pem").write_bytes((site.folder / "ca.pem").read_bytes())
    site.come("anna")
    for name, folder in (("anna", tmp_path / "other"), ("late", site.folder), ("", site.folder)):
        with pytest.raises(zenoh.ZError):
            site.come(name, folder)
    site.endpoint = site.endpoint.replace("tls/", "tcp/")
    with pytest.raises(zenoh.ZError):
        site.come("anna")
