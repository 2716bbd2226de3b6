"""Whose word for the place holds after a reload, and what ends it."""

from __future__ import annotations

from collections.abc import Awaitable, Callable

import anyio
import pytest

from m100link.apps.station.console import looks
from m100link.apps.station.console.history import History
from m100link.apps.station.console.looks import Looks
from tests.apps.station.conftest import Rig

pytestmark = pytest.mark.anyio

HERE = "aircraft"


class Desk:
    """The words of one console, with an aircraft that stands on the ground."""

    def __init__(self, rig: Rig) -> None:
        self.rig = rig
        self.looks = Looks()
        self.history = History()
        self.person = self.looks.person(None)
        rig.front.background.spawn(self.history.keep(rig.front), "history")

    def say(self, *, is_free: bool = True) -> None:
        self.looks.say(self.person, HERE, self.rig.front, is_free=is_free)

    def said_at(self, secret: str | None = None, aircraft: str = HERE) -> float | None:
        """What a page that is loaded anew, with that secret, is told."""
        person = self.looks.person(self.person if secret is None else secret)
        return self.looks.said_at(person, aircraft, self.rig.front, self.history)


@pytest.fixture
async def desk(rig: Rig) -> Desk:
    made = Desk(rig)
    await anyio.sleep(1.0)
    return made


async def test_a_word_lasts_as_long_as_without_the_reload(
    desk: Desk, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(looks, "FREE_FOR_S", 5.0)  # minutes of telemetry take a while
    began = desk.rig.front.now
    desk.say()
    await anyio.sleep(4.0)
    assert desk.said_at() == began  # and not from the reload on
    await anyio.sleep(2.0)
    assert desk.said_at() is None


async def test_a_word_is_of_one_person_and_one_aircraft(desk: Desk) -> None:
    desk.say()
    await anyio.sleep(1.0)
    assert desk.said_at("guessed") is None
    assert desk.said_at("") is None
    assert desk.said_at(aircraft="kite") is None
    assert desk.said_at() is not None


async def test_a_word_that_was_taken_back_does_not_come_again(desk: Desk) -> None:
    desk.say()
    desk.say(is_free=False)
    await anyio.sleep(1.0)
    assert desk.said_at() is None


async def fly(rig: Rig) -> None:
    rig.aircraft.pilot_takes_off()
    await rig.until(lambda: rig.aircraft.height > 1.0)
    await anyio.sleep(2.0)
    rig.aircraft.pilot_lands()
    await rig.until(lambda: not rig.aircraft.vehicle.flight.dynamics.motors_on)
    await anyio.sleep(3.0)


async def unplug(rig: Rig) -> None:
    rig.aircraft.unplug()
    await anyio.sleep(1.0)
    rig.aircraft.replug()
    await rig.until(lambda: rig.front.is_connected)
    await anyio.sleep(1.0)


async def fall_silent(rig: Rig) -> None:
    rig.aircraft.stall_line()
    await anyio.sleep(4.0)
    rig.aircraft.stall_line(False)
    await anyio.sleep(1.0)


@pytest.mark.parametrize("happens", [fly, unplug, fall_silent])
async def test_whoever_may_have_come_to_another_place_has_to_be_looked_at(
    desk: Desk, happens: Callable[[Rig], Awaitable[None]]
) -> None:
    desk.say()
    await happens(desk.rig)
    assert desk.said_at() is None
    desk.say()
    await anyio.sleep(1.0)
    assert desk.said_at() is not None


async def test_a_station_that_stood_still_saw_nothing(
    desk: Desk, monkeypatch: pytest.MonkeyPatch
) -> None:
    desk.say()
    keep = desk.history.add
    monkeypatch.setattr(desk.history, "add", lambda *row: None)
    await anyio.sleep(3.0)
    monkeypatch.setattr(desk.history, "add", keep)
    await anyio.sleep(3.0)
    assert desk.said_at() is None


def test_the_oldest_persons_are_forgotten() -> None:
    known = Looks()
    first = known.person(None)
    others = [known.person(None) for _ in range(looks.MOST - 1)]
    assert known.person(first) == first  # it was there lately
    known.person(None)
    assert known.person(others[0]) != others[0]
    assert known.person(first) == first
