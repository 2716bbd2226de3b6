"""The first hour with aircraft that differ in hidden ways: each difference is named, nothing moves.

The aircraft share no line with the library or its simulator (``tests/flight/foreign_aircraft.py``).
"""

from __future__ import annotations

import asyncio
import json
import random
import struct
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest

from m100link import Aircraft, Credentials, connect
from m100link.apps.doctor.first_contact import Contact, Observation, Topic, first_contact
from m100link.link import Link, Tap, connect_in_memory
from m100link.link.statistics import TappedProtocol
from m100link.sim import VirtualClockEventLoop
from tests.flight.foreign_aircraft import (
    APP_ID,
    IN_AIR,
    KEY,
    MODE_F,
    MODE_P,
    ONBOARD,
    RC,
    STANDBY,
    VERSION_NAMES,
    ForeignInMemory,
    frame,
)

pytestmark = pytest.mark.anyio

MODES = {"P": MODE_P, "A": 0, "F": MODE_F}
GEAR_DOWN = -4545
OBTAINED = "control authority is OBTAINED; nothing moves, and it goes back now"
HARMLESS = {(0, 0), (0, 1), (1, 0)}
"""Version, activation, and authority: what first contact may send."""


class Hidden(ForeignInMemory):
    """An aircraft on the ground with a person beside it; the keywords are what is hidden."""

    def __init__(self, firmware: str = "3.1", **hidden: Any) -> None:
        self.hidden: dict[str, Any] = {
            "raw": False,
            "down": False,
            "rc_lost": "zeros",
            "announces": False,
            "idle_status": True,
            "obtains_in": "F",
            "again": 2,
            "latency": 0.0,
            "releases": True,
            "status": STANDBY,
            "without": (),
            "slowed": (),
            "for_ever": False,
            "speed_share": 1.0,
            "answers": True,
        }
        self.hidden |= hidden
        super().__init__(firmware)
        self.status = self.hidden["status"]
        self.commands: list[tuple[int, int]] = []
        self.obtained = 0
        self.rc_is_on, self.yaw, self.held_yaw = True, 0, 0
        self.climbs = self.altitude = 0.0
        self._count = 0

    # -- the wire --------------------------------------------------------------------------------

    def step(self) -> None:
        self._next_at = self.now() + 0.02
        self.altitude += 0.02 * self.climbs
        for _ in range(2):
            self._count += 1
            self._write(frame(b"\x02\x00" + self._package()))
        if self.hidden["idle_status"] and self.firmware == "3.1" and self._count % 10 == 0:
            self._write(frame(b"\x02\x03" + bytes(6)))

    def _package(self) -> bytes:
        up = -self.climbs if self.hidden["down"] else self.climbs
        up *= self.hidden["speed_share"]
        place = 0.39, 1.98, 400.0 + self.altitude, 0.0, 5
        felt = (0.0, 0.0, -1.0) if self.hidden["raw"] else (0.0, 0.0, 0.0)
        newer = self.firmware != "1.0"
        values = {  # by bit: bytes, and every how many hundredths of a second
            0: (struct.pack("<I", self._count * 4) + bytes(5 * (self.firmware == "3.1")), 1),
            1: (struct.pack("<4f", 1, 0, 0, 0), 1),
            2: (struct.pack("<3f", *felt), 1),
            3: (struct.pack("<3f", 0, 0, up) + b"\1" * newer, 1),
            4: (bytes(12), 1),
            5: (struct.pack("<2d2fB", *place), 1),
            7: (struct.pack("<6h", *self._channels()), 2),
            8: (bytes(12) + bytes(self.firmware == "3.1"), 2),
            9: (bytes([self.status]), 10),
            10: (b"\x50", 100),
        }
        if not self.rc_is_on and self.hidden["rc_lost"] == "silent":
            del values[7]
        due = {
            bit: value
            for bit, (value, every) in values.items()
            if bit not in self.hidden["without"]
            and self._count % (every * (5 if bit in self.hidden["slowed"] else 1)) == 0
        }
        return struct.pack("<H", sum(1 << bit for bit in due)) + b"".join(due.values())

    def _channels(self) -> tuple[int, ...]:
        if self.rc_is_on:
            return 0, 0, self.yaw, 0, self.mode, GEAR_DOWN
        lost: dict[str, tuple[int, ...]] = {
            "zeros": (0, 0, 0, 0, 0, 0),
            "kept": (0, 0, self.held_yaw, 0, self.mode, GEAR_DOWN),
            "centred": (0, 0, 0, 0, self.mode, GEAR_DOWN),
            "other": (0, 0, 0, 0, MODE_P, GEAR_DOWN),
        }
        return lost.get(self.hidden["rc_lost"], (0,) * 6)

    def _write(self, data: bytes) -> None:
        is_ack = len(data) > 3 and data[3] & 0x20
        if is_ack and not self.hidden["answers"]:
            return
        if is_ack and self.hidden["latency"]:
            self._loop.call_later(self.hidden["latency"], super()._write, data)
        else:
            super()._write(data)

    # -- what it is asked ------------------------------------------------------------------------

    def _execute(self, group: int, number: int, value: bytes) -> bytes | None:
        self.commands.append((group, number))
        return super()._execute(group, number, value)

    def _version(self) -> bytes:
        name = self.hidden.get("name", VERSION_NAMES[self.firmware])
        return super()._version().replace(VERSION_NAMES[self.firmware], name)

    def _authority(self, *, is_wanted: bool) -> int:
        self._asked += 1
        self.releases += not is_wanted
        is_first = self.firmware != "1.0" and self._asked % 2
        if is_wanted:
            if self.device == ONBOARD:
                self._asked = 0
                return int(self.hidden["again"])
            here = next(name for name, mode in MODES.items() if mode == self.mode)
            if here not in self.hidden["obtains_in"]:
                return 3 if self.firmware == "1.0" else 0
            if is_first or self.hidden["for_ever"]:
                return 3
            self.device = ONBOARD
            self.obtained += 1
            return 2
        if is_first or not self.hidden["releases"]:
            return 4
        if self.device == ONBOARD and self.hidden["announces"]:
            super()._write(frame(b"\x02\x01\x04"))
        self.device = RC
        return 1

    async def asked(self, text: str) -> bool:
        """The person beside it does what the words say."""
        if "Lift" in text:
            self.climbs = 1.0
            await asyncio.sleep(2.0)
            self.climbs = 0.0
            await asyncio.sleep(1.0)
        elif "back on the ground" in text:
            self.altitude = 0.0
        elif "Hold the left stick" in text:
            self.mode, self.yaw = MODE_F, -9000
        elif "remote control OFF" in text:
            self.held_yaw = self.yaw
            self.rc_is_on, self.yaw = False, 0
            await asyncio.sleep(5.0)
        elif "remote control on again" in text:
            self.rc_is_on = True
        elif "Put the mode switch to" in text:
            self.mode = MODES[text.split("switch to ")[1][0]]
        else:
            assert "PROPELLERS OFF" in text or "May I ask" in text, text
        return True


@pytest.fixture
def anyio_backend() -> tuple[str, dict[str, Any]]:
    return "asyncio", {"loop_factory": VirtualClockEventLoop}


async def met(there: Hidden, ask: Any = None, **options: Any) -> tuple[Contact, list[str]]:
    """The contact with an aircraft, and what was said meanwhile."""
    said: list[str] = []
    told: list[Observation] = []

    async def opened(tap: Tap) -> Aircraft:
        link = Link()
        connect_in_memory(TappedProtocol(link, tap, link.clock), there)
        await link.wait_connected()
        return await connect(link)

    options = {"credentials": Credentials(app_id=APP_ID, key=KEY)} | options
    try:
        contact = await first_contact(
            "memory",
            ask=ask or there.asked,
            tell=told.append,
            say=said.append,
            open_aircraft=opened,
            **options,
        )
    finally:
        there.close()
    assert contact.observations == told
    # Whatever it is: nothing that could move it was sent, and it was never asked in the air.
    assert set(there.commands) <= HARMLESS
    assert not there.movements
    assert not there.tasks
    if there.hidden["answers"]:
        assert said.count(OBTAINED) == there.obtained
    assert contact.is_given_back <= (there.device == RC), "nothing that is not so"
    text = json.dumps(contact.to_json())
    for secret in (KEY.hex(), str(APP_ID), "041DABCDEF", "0.39", "22.3"):
        assert secret not in text.replace("0.39 m", ""), secret
    return contact, said


# What is hidden, and all that it is to be named as: topic and finding.
AIRCRAFT: Mapping[str, tuple[dict[str, Any], dict[Topic, str]]] = {
    "as the virtual one": ({}, {}),
    "raw": ({"raw": True}, {Topic.ACCELERATION: "raw"}),
    "down": ({"down": True}, {Topic.VERTICAL_VELOCITY: "down"}),
    "kept": ({"rc_lost": "kept"}, {Topic.RC_LOST: "kept"}),
    "silent": ({"rc_lost": "silent"}, {Topic.RC_LOST: "silent"}),
    "centred, idle": (
        {"rc_lost": "centred", "idle_status": False},
        {Topic.RC_LOST: "centred", Topic.MISSION_STATUS: "not sent"},
    ),
    "announces": ({"announces": True}, {Topic.OWN_RELEASE: "sent"}),
    "obtains anywhere": (
        {"obtains_in": "PAF"},
        {Topic.OBTAIN_P: "obtained", Topic.OBTAIN_A: "obtained"},
    ),
    "another again": ({"again": 3}, {Topic.OBTAIN_AGAIN: "3"}),
    "slow": ({"latency": 0.2}, {Topic.LATENCY: "0.2 s"}),
    "in progress for ever": (
        {"for_ever": True},
        {Topic.OBTAIN_F: "in progress for ever"},
    ),
    "never releases": (
        {"releases": False, "raw": True},
        {Topic.ACCELERATION: "raw", Topic.RELEASE: "not released"},
    ),
    "slower items": (
        {"slowed": (7, 8), "without": (10,)},
        {Topic.ITEM_RATES: "rc 10, gimbal 10, battery 0"},
    ),
    "all at once": (
        {"raw": True, "down": True, "rc_lost": "other", "announces": True, "idle_status": False},
        {
            Topic.ACCELERATION: "raw",
            Topic.VERTICAL_VELOCITY: "down",
            Topic.RC_LOST: "other",
            Topic.OWN_RELEASE: "sent",
            Topic.MISSION_STATUS: "not sent",
        },
    ),
}


@pytest.mark.parametrize("name", AIRCRAFT)
async def test_every_difference_is_named_and_nothing_else(name: str) -> None:
    hidden, expected = AIRCRAFT[name]
    contact, said = await met(Hidden(**hidden))
    assert {one.topic: one.found for one in contact.differences} == expected
    assert [one.topic for one in contact.observations if not one.is_seen] == (
        [Topic.OBTAIN_AGAIN, Topic.RELEASE, Topic.OWN_RELEASE] if hidden.get("for_ever") else []
    )
    assert {one.topic for one in contact.observations} == set(Topic)
    assert not contact.ended_by
    assert ("the aircraft may still have it with this program: put the switch to P" in said) is (
        not contact.is_given_back
    )


async def test_firmware_1_has_no_missions_and_obtains_at_once() -> None:
    contact, _ = await met(Hidden("1.0"))
    assert contact.differences == []
    assert [one.topic for one in contact.observations if not one.is_seen] == [Topic.MISSION_STATUS]


@pytest.mark.parametrize(
    ("hidden", "why"),
    [
        ({"status": IN_AIR}, "it is not seen standing with its motors off"),
        ({"without": (9,)}, "it is not seen standing with its motors off"),
        ({"without": (7,)}, "the switch is not told"),
    ],
)
async def test_authority_is_not_asked_of_an_aircraft_that_may_fly(
    hidden: dict[str, Any], why: str
) -> None:
    there = Hidden(**hidden)
    contact, _ = await met(there)
    assert (1, 0) not in there.commands
    found = contact.get(Topic.OBTAIN_F)
    assert found is not None
    assert (found.found, found.seen) == ("", why)


async def test_an_unknown_firmware_is_only_looked_at() -> None:
    there = Hidden(name=b"SDK-v1.0 BETA M600-01.00.01.60")
    contact, _ = await met(there)
    assert (1, 0) not in there.commands
    version = contact.get(Topic.VERSION)
    assert version is not None
    assert version.found == "unknown"
    assert "M600-01.00.01.60" in version.seen


@pytest.mark.parametrize(
    ("refused", "topic", "why"),
    [
        ("Lift", Topic.VERTICAL_VELOCITY, "nobody lifted it"),
        ("Hold the left stick", Topic.RC_LOST, "nobody switched it off"),
        ("remote control OFF", Topic.RC_LOST, "nobody switched it off"),
        ("May I ask", Topic.OBTAIN_F, "the person did not want it"),
    ],
)
async def test_what_the_person_does_not_do_is_not_seen(
    refused: str, topic: Topic, why: str
) -> None:
    there = Hidden()

    async def ask(text: str) -> bool:
        return refused not in text and await there.asked(text)

    contact, _ = await met(there, ask)
    found = contact.get(topic)
    assert found is not None
    assert (found.found, found.seen) == ("", why)
    if refused == "May I ask":
        assert (1, 0) not in there.commands


@pytest.mark.parametrize(
    ("undone", "topic"),
    [("Lift", Topic.VERTICAL_VELOCITY), ("Hold the left stick", Topic.RC_LOST)],
)
async def test_what_the_person_only_says_is_not_seen(undone: str, topic: Topic) -> None:
    there = Hidden()

    async def ask(text: str) -> bool:
        return undone in text or await there.asked(text)

    contact, _ = await met(there, ask)
    found = contact.get(topic)
    assert found is not None
    assert not found.is_seen


async def test_a_velocity_that_does_not_show_the_lift_has_no_sign() -> None:
    """It shows less than three tenths of it."""
    contact, _ = await met(Hidden(speed_share=0.2))
    found = contact.get(Topic.VERTICAL_VELOCITY)
    assert found is not None
    assert (found.found, found.seen) == (
        "",
        "the barometer rose by 2.00 m, velocity adds up to +0.40 m",
    )


async def test_nothing_is_tried_with_propellers_on_or_without_a_key() -> None:
    there = Hidden()

    async def refuse(text: str) -> bool:
        return False

    contact, _ = await met(there, refuse)
    assert contact.ended_by == "the propellers may be on: nothing was tried"
    assert set(there.commands) == {(0, 0)}
    there = Hidden()
    contact, _ = await met(there, credentials=None)
    assert set(there.commands) == {(0, 0)}
    assert contact.found["vertical_velocity"] == "up"


async def test_a_line_that_goes_ends_it_with_what_was_seen() -> None:
    there = Hidden(raw=True)

    async def ask(text: str) -> bool:
        if "Hold the left stick" in text:
            there.unplug()
        return await there.asked(text)

    contact, _ = await met(there, ask)
    # Without the name of the line, which is a port or an address.
    assert contact.ended_by == "the line went away (LinkLost)"
    assert contact.found["acceleration"] == "raw"


async def test_an_answer_that_is_lost_is_no_refusal() -> None:
    """The request may have arrived: it is released, and what nobody confirms is said."""
    there = Hidden()

    async def ask(text: str) -> bool:
        if "mode switch to F. Is it" in text:
            there.hidden["answers"] = False
        return await there.asked(text)

    contact, said = await met(there, ask)
    assert there.releases > 0
    found = contact.get(Topic.OBTAIN_F)
    assert found is not None
    assert not found.is_seen
    assert not contact.is_given_back
    assert said[-1] == "the aircraft may still have it with this program: put the switch to P"


async def test_a_refusal_says_nothing_of_a_later_request_without_an_answer() -> None:
    class Mute(Hidden):
        """Firmware 1.0: says "not changed", obeys the second request, and is not heard any more."""

        def _authority(self, *, is_wanted: bool) -> int:
            code = super()._authority(is_wanted=is_wanted)
            if is_wanted and code == 3:
                self.hidden |= {"obtains_in": "F"}
            elif is_wanted:
                self.hidden["answers"] = False
            return code

    there = Mute("1.0", obtains_in="")

    async def ask(text: str) -> bool:
        if "mode switch to F. Is it" in text:
            there.hidden["obtains_in"] = ""
        return await there.asked(text)

    contact, _ = await met(there, ask)
    assert there.obtained == 1
    assert there.device == RC
    assert not contact.is_given_back


PROMPTS = (
    *("PROPELLERS OFF", "Lift", "back on the ground", "Hold the left stick"),
    *("remote control OFF", "remote control on again", "May I ask"),
    *("mode switch to P", "mode switch to A", "mode switch to F. Is it"),
)


async def interrupted(
    monkeypatch: pytest.MonkeyPatch,
    there: Hidden,
    after: float,
    *,
    by_signal: bool = True,
    prompt: str = "",
) -> tuple[Contact, list[str]]:
    """Interrupt it so many seconds after its begin, or after a prompt, and again every 0.3 s."""
    stops: list[Any] = []
    kept: list[Contact] = []
    monkeypatch.setattr("m100link.apps.doctor.first_contact.SIGNALS.join", stops.append)
    monkeypatch.setattr("m100link.apps.doctor.first_contact.SIGNALS.leave", stops.remove)
    asked = asyncio.Event()
    if not prompt:
        asked.set()

    async def ask(text: str) -> bool:
        if prompt and prompt in text:
            asked.set()
        return await there.asked(text)

    task = asyncio.ensure_future(met(there, ask, keep=kept.append))

    async def interrupt() -> None:
        await asked.wait()
        await asyncio.sleep(after)
        while not task.done():
            if by_signal:
                for stop in stops:
                    stop()
            else:
                task.cancel()
            await asyncio.sleep(0.3)

    others = asyncio.ensure_future(interrupt())
    try:
        contact, said = await task
    except asyncio.CancelledError:
        contact, said = kept[0], []
    others.cancel()
    assert kept == [contact], "once, whatever happens"
    assert not stops, "signals act again"
    return contact, said


_WHOLE_S, _AUTHORITY_S = 28.5, 9.0  # of a contact with answers after 0.2 s; its last part


@pytest.mark.slow
@pytest.mark.parametrize("by_signal", [True, False])
@pytest.mark.parametrize("seed", range(12))
async def test_an_interrupt_at_any_time_gives_control_back_and_keeps_what_was_seen(
    monkeypatch: pytest.MonkeyPatch, seed: int, by_signal: bool
) -> None:
    chance = random.Random(seed)
    there = Hidden(raw=True, latency=0.2, obtains_in=chance.choice(["F", "PAF"]))
    since = chance.choice([0.0, _WHOLE_S - _AUTHORITY_S])
    after = chance.uniform(since, _WHOLE_S - 0.1)
    contact, said = await interrupted(monkeypatch, there, after, by_signal=by_signal)
    assert there.device == RC, (seed, after, contact, said)
    assert contact.is_given_back
    assert contact.ended_by == "it was interrupted", (seed, after)
    at_rest = contact.get(Topic.ACCELERATION)
    assert at_rest is None or at_rest.found == "raw"
    assert bool(contact.found) == (after > 1.0), (seed, after)


@pytest.mark.parametrize("prompt", PROMPTS)
async def test_an_interrupt_at_any_prompt_keeps_what_was_seen(
    monkeypatch: pytest.MonkeyPatch, prompt: str
) -> None:
    there = Hidden(raw=True)
    contact, _ = await interrupted(monkeypatch, there, 0.0, prompt=prompt)
    assert (contact.ended_by, there.device) == ("it was interrupted", RC)
    assert Topic.VERSION.name.lower() in contact.found
    assert (contact.found.get("acceleration") == "raw") is (prompt != "PROPELLERS OFF")


async def test_a_cancellation_ends_it_as_a_signal_does(monkeypatch: pytest.MonkeyPatch) -> None:
    there = Hidden(raw=True)
    contact, _ = await interrupted(monkeypatch, there, 0.0, by_signal=False, prompt="Lift")
    assert (contact.ended_by, there.device) == ("it was interrupted", RC)
    assert Topic.RC_LOST.name.lower() not in contact.found


async def test_what_an_interrupt_cannot_give_back_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    there = Hidden(releases=False, obtains_in="P")
    prompt = "mode switch to P"
    contact, said = await interrupted(monkeypatch, there, 2.5, prompt=prompt)
    assert there.device == ONBOARD
    assert contact.get(Topic.OBTAIN_P) is None
    assert not contact.is_given_back
    assert said[-1] == "the aircraft may still have it with this program: put the switch to P"


def test_the_manual_says_on_how_many_aircraft_each_assumption_was_seen() -> None:
    page = (Path(__file__).parents[3] / "docs/explanation/simulator-limits.md").read_text("utf-8")
    rows = [line.split(" | ") for line in page.splitlines() if line.startswith("| `")]
    named = "".join(row[0] for row in rows)
    for topic in Topic:
        assert f"`{topic.name.lower()}`" in named, topic
    seen = [row[2] for row in rows if len(row) == 4 and row[2].isdecimal()]
    assert set(seen) == {"0"}, "a number rises with a report, not by itself"
    assert len(seen) == 11
