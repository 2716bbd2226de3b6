"""A view holds everything that the page shows, and nothing that nobody sent."""

from __future__ import annotations

from m100link.apps.agent.messages import Event, Replay, State
from m100link.apps.station.console.view.alarms import AlarmName, AlarmState
from m100link.apps.station.console.view.situation import Inputs, RecordedFlight
from m100link.apps.station.console.view.texts import Translator
from m100link.apps.station.console.view.view_model import Memory, view_of
from m100link.log.story import FlightSummary, Moment, Span
from tests.known import seen


def test_of_nothing_known_nothing_is_shown() -> None:
    view = view_of(Inputs(vehicle=seen(None, 7.0, state=State(at=0.0))))
    assert view.at == 7.0
    assert view.instruments.attitude is None
    assert {reading.text.key for reading in view.instruments.readings.values()} == {
        "instruments.nothing"
    }
    assert all(reading.is_stale for reading in view.instruments.readings.values())
    assert view.mission.part == 0.0
    assert view.events == ()


def test_events_are_as_they_came() -> None:
    events = (Event(1, 0.5, "info", "one"), Event(2, 0.6, "error", "two"))
    lines = view_of(
        Inputs(vehicle=seen(None, 1.0, state=State(at=0.0)), wall=1000.0, events=events)
    ).events
    assert [(line.at, line.level, line.text) for line in lines] == [
        (999.5, "info", "one"),
        (999.6, "error", "two"),
    ]


def test_what_a_page_remembers_goes_from_one_view_to_the_next() -> None:
    memory = Memory()
    event = Event(1, 0.5, "info", "one")
    view_of(Inputs(vehicle=seen(None, state=State(at=0.0)), events=(event,)), memory)
    assert (
        len(
            view_of(Inputs(vehicle=seen(None, state=State(at=0.0)), events=(event,)), memory).events
        )
        == 1
    )


# -- what a page remembers -------------------------------------------------------------------------

LOST = State(at=0.0, connection="lost")
OPEN = State(at=0.0, connection="connected")


def told(memory: Memory) -> list[tuple[float, str, str, str]]:
    english = Translator()
    return [(one.at, one.level, one.source, one.said(english)) for one in memory.diary.lines]


def test_the_life_of_an_alarm_is_in_the_list_of_events() -> None:
    memory = Memory()
    memory.look(Inputs(vehicle=seen(None, 1.0, state=OPEN), wall=1001.0))
    memory.look(Inputs(vehicle=seen(None, 2.0, state=LOST), wall=1002.0))
    said = memory.acknowledge(AlarmName.LINK_LOST)
    assert said is not None
    memory.look(Inputs(vehicle=seen(None, 3.0, state=OPEN), wall=1003.0))
    words = "The link to the aircraft is lost: have the pilot take over"
    assert Translator()(said) == words
    assert told(memory) == [
        (1002.0, "error", "page", f"Alarm: {words}"),
        (1002.0, "info", "page", f"Acknowledged: {words}"),
        (1003.0, "info", "page", f"Over: {words}"),
    ]


def test_what_nobody_acknowledged_is_a_warning_still() -> None:
    memory = Memory()
    memory.look(Inputs(vehicle=seen(None, 2.0, state=LOST), wall=2.0))
    alarms, _ = memory.look(Inputs(vehicle=seen(None, 3.0, state=OPEN), wall=3.0))
    assert [one.state for one in alarms] == [AlarmState.PASSED]
    assert [level for _, level, _, _ in told(memory)] == ["error", "error"]


def test_what_is_quiet_cannot_be_acknowledged() -> None:
    memory = Memory()
    memory.look(Inputs(vehicle=seen(None, state=OPEN)))
    assert memory.acknowledge(AlarmName.GPS) is None
    assert told(memory) == []


def test_the_stations_events_stand_beside_them() -> None:
    memory = Memory()
    memory.look(
        Inputs(
            vehicle=seen(None, 5.0, state=State(at=0.0)),
            wall=100.0,
            events=(Event(1, 4.0, "info", "connected"),),
        )
    )
    assert told(memory) == [(99.0, "info", "station", "connected")]


# -- a replay --------------------------------------------------------------------------------------


def test_a_replay_has_the_alarms_and_events_of_its_file_and_no_others() -> None:
    """The aircraft seems silent, GPS and battery are bad, and the station tells of itself."""
    place = Replay("/x.mcap", 1000.0, 9.0, 0.0, 5.0, 7.0, 60.0, 1.0, False, False, False)
    state = State(at=0.0, connection="connected", replay=place)
    event = Event(1, 0.5, "error", "of the station, now")
    story = FlightSummary(
        "x.mcap",
        began_utc=990.0,
        phases=[Span("ground", 0.0, 20.0)],
        commands=[Moment(2.0, "activate", {}, "SUCCESS", 0.1)],
        alarms=[
            Span("gps", 10.0, 12.0, "GPS health 2"),
            Span("authority_lost", 20.0, 20.0, "control was lost"),
        ],
    )

    def names(at: float, memory: Memory) -> list[AlarmName]:
        flight = RecordedFlight(story, at)
        known = seen(None, 5.0, state=state)
        view = view_of(Inputs(vehicle=known, events=(event,), flight=flight), memory)
        assert view.sounding is None
        assert all(one.state is AlarmState.ACKNOWLEDGED for one in view.alarms)
        return [one.name for one in view.alarms]

    memory = Memory()
    unread = view_of(Inputs(vehicle=seen(None, 5.0, state=state), events=(event,)), memory)
    assert (unread.alarms, unread.events) == ((), ())
    for at, expected in (
        (9.9, []),
        (10.0, [AlarmName.GPS]),
        (12.0, [AlarmName.GPS]),
        (12.1, []),
        (20.0, [AlarmName.AUTHORITY_LOST]),
        (29.9, [AlarmName.AUTHORITY_LOST]),  # what only happened is shown for ten seconds
        (30.1, []),
        (11.0, [AlarmName.GPS]),  # a seek back
    ):
        assert names(at, memory) == expected, at
    assert told(memory) == [
        (990.0, "info", "flight", "phase: ground"),
        (992.0, "info", "flight", "activate: SUCCESS"),
        (1000.0, "warning", "flight", "alarm: GPS health 2"),
        (1002.0, "info", "flight", "alarm has passed: gps"),
        (1010.0, "warning", "flight", "alarm: control was lost"),
    ]
