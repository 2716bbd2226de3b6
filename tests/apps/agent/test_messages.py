"""Errors of the channel are those that the agent met; events are numbered, bounded, sent."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from m100link import errors
from m100link.apps.agent.codec import decode, encode
from m100link.apps.agent.lease import LeaseHeld
from m100link.apps.agent.messages import (
    AuthorityTaken,
    Event,
    EventTopic,
    Journal,
    MessageError,
    RemoteError,
    Replay,
)
from m100link.errors import AuthorityLost, AuthorityRefused, GuardRefused, LossReason, M100Error
from m100link.flight.guards import Envelope, GuardKeeper, Guards
from m100link.telemetry.state import AircraftState

ERRORS: list[M100Error] = [
    M100Error("seen"),
    LeaseHeld("held", holder="tab", remedy="ask"),
    AuthorityRefused("no", command="request_authority", code=3, cause="a switch"),
    AuthorityLost("lost", reason=LossReason.APP),
    GuardRefused("too high", guard="height", measured=51.5, limit=50),
    GuardRefused("lost", guard="gps", measured=float("nan")),
    MessageError("what"),
]


def carried(error: M100Error) -> M100Error:
    message = decode(encode(AuthorityTaken(RemoteError.of(error))))
    assert isinstance(message, AuthorityTaken)
    return message.fault.error()


@pytest.mark.parametrize("error", ERRORS, ids=lambda one: type(one).__name__)
def test_an_error_is_the_same_error_at_the_other_end(error: M100Error) -> None:
    found = carried(error)
    assert type(found) is type(error)
    assert str(found) == str(error)
    for name, value in vars(error).items():
        if value == value:  # not a NaN, which becomes its name
            assert getattr(found, name) == value


@pytest.mark.parametrize(
    ("refuse", "remedy"),
    [
        (
            lambda: Envelope().check("a climb", height=60.0),
            "a target inside, or a larger --max-height of its agent (max_height in a fleet file)",
        ),
        (
            lambda: Envelope().check("fly_to", far=200.0),
            "a target inside, or a larger --max-radius of its agent (max_radius in a fleet file)",
        ),
        (lambda: Envelope().check("fly_to", speed=11.0), "fly slower"),
        (
            lambda: GuardKeeper(Guards(), AircraftState(lambda: 9.0)).check_mission("a flight"),
            "set the item to 1 Hz or more in the PC assistant",
        ),
    ],
)
def test_a_client_of_an_agent_hears_no_remedy_of_a_program(
    refuse: Callable[[], object], remedy: str
) -> None:
    with pytest.raises(GuardRefused) as caught:
        refuse()
    assert "Guards(" in str(caught.value)
    assert carried(caught.value).remedy == remedy
    assert "Guards(" not in str(carried(caught.value))


def test_every_error_of_the_tree_can_be_carried() -> None:
    for name in vars(errors)["__all__"]:
        kind = getattr(errors, name)
        if isinstance(kind, type) and issubclass(kind, M100Error):
            error = kind.__new__(kind)
            M100Error.__init__(error, "seen", cause="cause", remedy="remedy")
            assert type(carried(error)) is kind


def test_a_class_that_is_not_known_becomes_the_base_that_is() -> None:
    class OfAPlugin(AuthorityRefused):
        pass

    assert type(carried(OfAPlugin("no", command="x"))) is AuthorityRefused
    assert type(RemoteError("FromTheFuture", "seen").error()) is M100Error


def test_details_of_a_stranger_leave_an_error_what_it_is() -> None:
    """A front that shows it reads its words, and the attributes of its class."""
    told = {"seen": 5, "remedy": None, "error_code": 7, "args": 1, "manual": "x", "guard": "gps"}
    error = RemoteError("GuardRefused", "seen", "cause", "remedy", told).error()
    assert isinstance(error, GuardRefused)
    assert str(error) == str(GuardRefused("seen", cause="cause", remedy="remedy"))
    assert (error.error_code, error.guard) == ("M100-GUARD-REFUSED", "gps")
    plain = RemoteError("GuardRefused", "seen").error()
    assert isinstance(plain, GuardRefused)
    assert (plain.guard, plain.measured, plain.limit) == ("", None, None)


def test_no_detail_that_a_stranger_names_raises_where_it_is_read() -> None:
    """Errors of the operating system have attributes of their own, which take numbers alone."""
    for name in vars(errors)["__all__"]:
        kind = getattr(errors, name)
        if isinstance(kind, type) and issubclass(kind, M100Error):
            for told in (*dir(kind), "", "no name", "\ud800"):
                for value in (None, True, -1, 1.5, "x"):
                    found = RemoteError(name, "seen", "cause", "remedy", {told: value}).error()
                    assert (found.seen, found.cause, found.remedy) == ("seen", "cause", "remedy")
                    assert str(found) == str(kind("seen", cause="cause", remedy="remedy"))


# -- the clock of a replay -------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("played_at", "has_at", "shown"),
    [
        (None, None, 20.0),  # nothing was played: the replay's clock
        (None, 15.0, 20.0),
        (15.0, None, 20.0),
        (15.0, 15.0, 20.0),  # all that was played is here, and the clock has gone on
        (15.0, 15.1, 20.0),
        (15.0, 14.9, 14.9),  # a package is on its way: nothing grows old meanwhile
        (15.0, 20.5, 20.5),  # this package is newer than the report of the clock
    ],
)
def test_the_clock_of_a_replay_waits_for_what_is_on_its_way(
    played_at: float | None, has_at: float | None, shown: float
) -> None:
    """All in s by the clock of the replay, which reported 20 s."""
    replay = Replay("a.mcap", 1.7e9, 20.0, 0.0, played_at, 20.0, 60.0, 1.0, False, False, False)
    assert replay.time(has_at) == shown


# -- the journal ----------------------------------------------------------------------------------


def test_events_are_numbered_reported_and_bounded() -> None:
    now = 0.0
    journal = Journal(lambda: now)
    told: list[Event] = []
    journal.on_event.append(told.append)
    for number in range(1000):
        now = float(number)
        journal.note(f"event {number}", "warning" if number % 2 else "info")
    assert len(told) == 1000
    assert told[0] == Event(1, 0.0, "info", "event 0")
    assert list(journal.events) == told[-len(journal.events) :]
    assert len(journal.events) == 200


def test_what_a_program_has_to_know_has_a_topic() -> None:
    journal = Journal(lambda: 0.0)
    journal.note(
        "the aircraft broke the mission off: battery", "warning", EventTopic.MISSION_ABORTED
    )
    journal.note("take off begins")
    assert [one.topic for one in journal.events] == [EventTopic.MISSION_ABORTED, EventTopic.NONE]
