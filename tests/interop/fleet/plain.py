"""Zenoh alone, nothing of ours: `python plain.py ENDPOINT SECONDS` prints what a fleet shows."""

import json
import sys
import time

import zenoh

config = zenoh.Config()
config.insert_json5("mode", '"client"')
config.insert_json5("connect/endpoints", json.dumps([sys.argv[1]]))
with zenoh.open(config) as session:
    telemetry = session.declare_subscriber("m100/*/*/tel/**", zenoh.handlers.FifoChannel(10_000))
    tokens = session.liveliness().get("m100-live/**", timeout=5.0)
    print(json.dumps({"tokens": [str(one.ok.key_expr) for one in tokens if one.ok]}))
    states = session.get("m100/*/*/state", timeout=5.0)
    answers = {str(one.ok.key_expr): bytes(one.ok.payload) for one in states if one.ok}
    told = {key: [payload[0], json.loads(payload[1:])] for key, payload in answers.items()}
    print(json.dumps({"states": told}))
    time.sleep(float(sys.argv[2]))
    while (sample := telemetry.try_recv()) is not None:
        print(json.dumps({"key": str(sample.key_expr), "payload": bytes(sample.payload).hex()}))
