"""One viewer without a socket: what it is told, what it may ask for, what it loses when slow."""

from __future__ import annotations

import json
import random
import struct
from typing import Any

import pytest

from m100link.apps.station.foxglove.session import Channel, Viewer

CHANNELS = (Channel(1, "/a", "A", "{}"), Channel(2, "/b", "B", "{}"))


def viewer() -> Viewer:
    made = Viewer(CHANNELS, "now")
    made.next_frames(1 << 20)
    return made


def said(one: Viewer) -> list[Any]:
    return [json.loads(frame) for frame in one.next_frames(1 << 20) if isinstance(frame, str)]


def data(one: Viewer) -> list[tuple[int, int, bytes]]:
    frames = [frame for frame in one.next_frames(1 << 20) if isinstance(frame, bytes)]
    assert all(frame[0] == 1 for frame in frames)
    return [(*struct.unpack_from("<IQ", frame, 1), frame[13:]) for frame in frames]


def subscribe(one: Viewer, *pairs: tuple[Any, Any]) -> None:
    wanted = [{"id": number, "channelId": channel} for number, channel in pairs]
    one.receive(json.dumps({"op": "subscribe", "subscriptions": wanted}), 0.0)


def test_it_is_told_what_there_is_and_that_nothing_can_be_sent() -> None:
    info, advertised = said(Viewer(CHANNELS, "now"))
    assert info["op"] == "serverInfo"
    assert info["capabilities"] == []
    assert [one["topic"] for one in advertised["channels"]] == ["/a", "/b"]
    assert {one["schemaEncoding"] for one in advertised["channels"]} == {"jsonschema"}


def test_it_gets_what_it_subscribed_to_until_it_does_not_want_it_any_more() -> None:
    one = viewer()
    subscribe(one, (7, 2))
    assert (one.wants(1), one.wants(2)) == (False, True)
    one.publish(1, 5, b"{}")
    one.publish(2, 6, b'{"x":1}')
    assert data(one) == [(7, 6, b'{"x":1}')]
    one.receive('{"op": "unsubscribe", "subscriptionIds": [7]}', 0.0)
    one.publish(2, 8, b"{}")
    assert data(one) == []
    assert not one.wants(2)


def test_a_slow_one_loses_the_oldest_and_nothing_grows() -> None:
    one = viewer()
    subscribe(one, (1, 1), (2, 2))
    for number in range(1000):
        one.publish(1, number, b"{}")
    one.publish(2, 5, b"{}")
    found = data(one)
    assert [at for number, at, _ in found if number == 1] == list(range(1000 - 64, 1000))
    assert found[1] == (2, 5, b"{}"), "one subscription waits for the other"
    assert one.dropped == 1000 - 64


@pytest.mark.parametrize(
    "frame",
    [
        b"\x01publish",
        "no JSON",
        "[]",
        "5",
        '{"op": "advertise", "channels": []}',
        '{"op": "setParameters"}',
        '{"op": "subscribe"}',
        '{"op": "subscribe", "subscriptions": [{"id": -1, "channelId": 1}]}',
        '{"op": "subscribe", "subscriptions": [{"id": 1, "channelId": 99}]}',
        '{"op": "subscribe", "subscriptions": [{"id": [], "channelId": {}}]}',
        '{"op": "unsubscribe", "subscriptionIds": [3]}',
        '{"op": "unsubscribe", "subscriptionIds": [[]]}',
        "[" * 100_000,
    ],
)
def test_what_makes_no_sense_is_told_and_does_nothing(frame: str | bytes) -> None:
    one = viewer()
    one.receive(frame, 0.0)
    [status] = said(one)
    assert (status["op"], status["level"]) == ("status", 1)
    assert not one.wants(1)
    assert one.close_reason is None


def test_who_talks_without_end_has_to_go() -> None:
    one = viewer()
    for _ in range(150):
        one.receive("{}", 0.0)
    assert one.close_reason is not None
    assert len(said(one)) <= 64


def test_too_many_subscriptions_are_not_taken() -> None:
    one = viewer()
    subscribe(one, *((number, 1) for number in range(300)))
    one.publish(1, 0, b"{}")
    assert len(data(one)) == 200


def test_noise_raises_nothing() -> None:
    chance = random.Random(20261122)
    one = viewer()
    for _ in range(2000):
        junk = chance.randbytes(chance.randrange(40))
        one.receive(junk if chance.random() < 0.3 else junk.decode("latin-1"), chance.random())
        one.next_frames(1000)
