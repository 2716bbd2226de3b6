"""A fleet by zenoh alone: who is there, where each stands, a package of telemetry, STOP for all."""

import json
import sys
import time
import uuid
from typing import Any

import zenoh

STOP = {"kind": "Stop"}


def ask(session: zenoh.Session, key: str, payload: bytes | None = None) -> list[Any]:
    replies = session.get(key, payload=payload, timeout=2.0)
    return [json.loads(bytes(one.ok.payload)[1:]) for one in replies if one.ok]


def order(name: str, asked: object) -> bytes:
    body: dict[str, Any] = {
        "id": uuid.uuid4().hex,
        "site": "site",
        "aircraft": name,
        "by": "plain zenoh",
    }
    body |= {"fence": 0, "at": time.time(), "order": asked, "clock": 0.0, "boot": ""}
    body |= {"signer": "", "key": "", "since": 0.0}
    unsigned, unproved = bytes(64), bytes(16)
    return b"\x04" + unsigned + unproved + json.dumps(body).encode()


config = zenoh.Config()
config.insert_json5("mode", '"client"')
config.insert_json5("connect/endpoints", json.dumps(sys.argv[1:] or ["tcp/127.0.0.1:7447"]))
with zenoh.open(config) as session:
    # A ring: what is not taken keeps nothing waiting.
    telemetry = session.declare_subscriber("m100/site/*/tel/5hz", zenoh.handlers.RingChannel(1))
    tokens = session.liveliness().get("m100-live/site/*/*", timeout=2.0)
    for name in sorted(str(one.ok.key_expr).split("/")[2] for one in tokens if one.ok):
        for card in ask(session, f"m100/site/{name}/state"):
            print(name, card["connection"], card["phase"], card["battery_percent"], "%")
        for reply in ask(session, f"m100/site/{name}/cmd", order(name, STOP)):
            print(name, "stop:", reply["outcome"])
    package = telemetry.recv()  # version, kind, time, and a name behind its length
    print(package.key_expr, len(bytes(package.payload)) - 11 - bytes(package.payload)[10], "bytes")
