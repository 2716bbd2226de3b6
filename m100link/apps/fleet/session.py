"""A session of a fleet: how it differs from zenoh's default."""

from __future__ import annotations

import json
from collections.abc import Mapping
from contextlib import AbstractAsyncContextManager
from typing import Literal

from m100link.apps.bus.session import LARGEST, Opening, ZenohBus, open_session

LEASE_MS = 1200
"""Milliseconds after which a silent end of a connection counts as gone; zenoh's own 10 s would
leave an aircraft on the wall that long after its cable was cut. Where only the way to an agent is
cut, what it sends goes on to arrive for 0.7 s: until as much waits as TCP sends unacknowledged."""

FIRST_S = 2.0
"""Seconds in which a router has to answer the first time."""

ANSWER_MS = 2000
"""Milliseconds that one router may take to answer before the next one is asked: zenoh's own 10 s
would be those of an aircraft that hovers because the first of two computers is dead."""

_REMEDIES = {
    "client": "m100link fleet router --listen tcp/127.0.0.1:7447",
    "router": "check where it listens, and that the port is free",
}


def open_fleet(
    mode: Literal["client", "router"],
    *,
    connect: tuple[str, ...] = (),  # such as ``tcp/127.0.0.1:7447``: of a router, other routers
    listen: tuple[str, ...] = (),
    options: Mapping[str, str] | None = None,  # more of zenoh's, by name, as JSON
    is_patient: bool = False,  # wait for the first router as long as it takes
) -> AbstractAsyncContextManager[ZenohBus]:
    """A session while the block runs; a router that is lost meanwhile is found again.

    Nobody is looked for by multicast or gossip: who is not named is not met.

    Raises:
        UsageError: The package is missing, an option cannot be, a port is taken, or no router
            answered.
    """
    ours = {
        "mode": json.dumps(mode),
        "connect/endpoints": json.dumps(list(connect)),
        # Each of them is tried once, in turn. With any other time zenoh tries the first alone until
        # that is over, and whoever begins while that one is dead never comes to the second.
        # A router looks for the others without end, and serves whoever is there meanwhile.
        "connect/timeout_ms": "-1" if mode == "router" else "0",
        "connect/exit_on_failure": json.dumps(mode != "router"),
        "transport/unicast/open_timeout": str(ANSWER_MS),
        "listen/endpoints": json.dumps(list(listen)),
        "scouting/multicast/enabled": "false",
        "scouting/gossip/enabled": "false",
        "transport/link/tx/lease": str(LEASE_MS),
        "transport/link/rx/max_message_size": str(LARGEST),
        # Of what goes in one moment while others use the processor, two would drop the rest.
        "transport/link/tx/queue/size/data": "8",
    }
    given = ours | dict(options or {})
    return open_session(
        Opening(
            "a fleet", "fleet", given, patience_s=FIRST_S, is_patient=is_patient, remedies=_REMEDIES
        )
    )
