"""Joys of many axes, inside the limits of frames per second and of size."""

from __future__ import annotations

from tests.attacks.common import again_and_again, main, publish

TOPIC = "/dji_sdk/flight_control_setpoint_generic"


async def attack(host: str, port: int) -> None:
    """At once 60 kB at 190 frames a second."""
    await again_and_again(host, port, publish(TOPIC, axes=[0] * 20_000), rate=190.0)


if __name__ == "__main__":
    main(attack)
