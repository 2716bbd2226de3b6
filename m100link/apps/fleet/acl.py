"""Rules for a router of zenoh, made of the file of rights; and what somebody may do, in words.

Everything is denied that no rule allows, in both directions: a question has to come in from who
asks and to go out to the agent, the answer the other way round, and so has every declaration that
lets the two know of each other. A rule too few looks as if nobody were there. The router sees keys
and not what an order says: whether one may stop or fly is what the agent's own gate decides.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any

from m100link.apps.fleet.keys import LIVE
from m100link.apps.fleet.rights import Identity, Right, Rights

__all__ = ["explain", "router_config"]

_TOLD = ("tel", "tel/**", "state", "event", "told")
_WATCHED = ("state", "told", "log", "mission")  # asked by who watches
_CARDS = ("state",)  # and of all at once
_ORDERED = ("cmd", "status/**", "revoked")  # by who may stop; of who flies besides:
_FLOWN = ("lease", "show")
_PUT = ("setpoint",)
_PLACES = ("place",)  # told by each aircraft of a show, to the others


def router_config(rights: Rights) -> dict[str, Any]:
    """What stands in a configuration of zenoh under ``access_control``."""
    rules: list[dict[str, Any]] = []
    subjects: list[dict[str, Any]] = []
    policies: list[dict[str, Any]] = []
    parts = [
        *((f"agent {name}", cn, _of_agent(rights, name)) for name, cn in rights.aircraft.items()),
        *(
            (f"identity {one.name}", one.common_name, _of_identity(rights, one))
            for one in rights.identities.values()
        ),
    ]
    for who, common_name, made in parts:
        mine = [
            {"id": f"{who}: {number}", "permission": "allow"} | rule
            for number, rule in enumerate(made)
            if rule["key_exprs"]
        ]
        rules += mine
        subjects.append({"id": who, "cert_common_names": [common_name]})
        if mine:
            policies.append({"rules": [rule["id"] for rule in mine], "subjects": [who]})
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": rules,
        "subjects": subjects,
        "policies": policies,
    }


def _rule(flow: str, messages: Iterable[str], keys: Iterable[str]) -> dict[str, Any]:
    """In from who the rules are for, or out to it."""
    return {"flows": [flow], "messages": list(messages), "key_exprs": list(dict.fromkeys(keys))}


def _word(pattern: str) -> str:
    # A star of zenoh is a whole word; part of one has a sign of its own.
    return pattern if pattern == "*" else pattern.replace("*", "$*")


def _keys(rights: Rights, patterns: Iterable[str], ends: Iterable[str]) -> list[str]:
    words = [_word(one) for one in patterns]
    return [f"m100/{rights.site}/{word}/{end}" for word in words for end in ends]


def _tokens(rights: Rights, patterns: Iterable[str]) -> list[str]:
    words = [_word(one) for one in patterns]
    apart = [f"{LIVE}/{rights.site}/{word}/*" for word in words]
    return apart + [f"m100/{rights.site}/{word}/live" for word in words]


def _of_agent(rights: Rights, name: str) -> Iterator[dict[str, Any]]:
    """An agent tells of its own aircraft, and is asked for it."""
    served = _keys(rights, [name], (*_WATCHED, *_ORDERED, *_FLOWN))
    asked = [*served, *_keys(rights, ["*"], _CARDS)]
    told, live = _keys(rights, [name], _TOLD), _tokens(rights, [name])
    # Setpoints, and what another one of its name tells.
    heard = _keys(rights, [name], (*_PUT, *_CARDS))
    yield _rule("ingress", ["put"], told)
    yield _rule("egress", ["declare_subscriber"], told)
    yield _rule("ingress", ["declare_queryable", "reply"], served)
    yield _rule("egress", ["query"], asked)
    yield _rule("ingress", ["declare_subscriber"], heard)
    yield _rule("egress", ["put"], heard)
    mine, everybodys = (_keys(rights, [one], _PLACES) for one in (name, "*"))
    yield _rule("ingress", ["put"], mine)
    yield _rule("egress", ["declare_subscriber"], everybodys)
    yield _rule("ingress", ["declare_subscriber"], everybodys)
    yield _rule("egress", ["put"], everybodys)
    # It looks whether another one has its name.
    messages = ["liveliness_token", "liveliness_query", "declare_liveliness_subscriber"]
    yield _rule("ingress", messages, live)
    yield _rule("egress", ["liveliness_token"], live)


def _of_identity(rights: Rights, one: Identity) -> Iterator[dict[str, Any]]:
    """Who watches hears; who may stop asks, too; who flies takes the lease and sends setpoints."""
    watched, stopped, flown = (one.allowed(right) for right in Right)
    told = _keys(rights, watched, _TOLD)
    everybody = ["*"] if watched else []
    served = [
        *_keys(rights, watched, _WATCHED),
        *_keys(rights, stopped, _ORDERED),
        *_keys(rights, flown, _FLOWN),
    ]
    put, live = _keys(rights, flown, _PUT), _tokens(rights, watched)
    # It may ask for all by one pattern, which has to be allowed as it stands: what it is told is
    # decided for each key as it goes out.
    asked = [*served, *_keys(rights, everybody, _CARDS)]
    yield _rule("ingress", ["declare_subscriber"], _keys(rights, everybody, _TOLD))
    yield _rule("egress", ["put"], told)
    yield _rule("ingress", ["query"], asked)
    yield _rule("egress", ["declare_queryable", "reply"], served)
    yield _rule("ingress", ["put"], put)
    yield _rule("egress", ["declare_subscriber"], put)
    messages = ["liveliness_query", "declare_liveliness_subscriber"]
    yield _rule("ingress", messages, _tokens(rights, everybody))
    yield _rule("egress", ["liveliness_token"], live)


def explain(rights: Rights, who: str) -> list[tuple[str, Right | None]]:
    """The most that somebody may do with each aircraft of the file; None for nothing.

    Besides, by a pattern, with aircraft that are in the file by no name: those are listed as the
    pattern has them.
    """
    one = rights.identities[who]
    names = [*rights.aircraft, *(p for p in one.allowed(Right.WATCH) if p not in rights.aircraft)]
    return [
        (name, max((right for right in Right if one.may(right, name)), default=None))
        for name in names
    ]
