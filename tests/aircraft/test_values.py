"""What is given to a function of an aircraft in, what reaches the one behind it out."""

from __future__ import annotations

import asyncio
import math
from random import Random
from types import SimpleNamespace
from typing import Any, cast
from unittest.mock import AsyncMock, MagicMock, call

import pytest

from m100link import Aircraft, Credentials, Guards, NotObserved, supervise
from m100link.aircraft import activation, replaying, supervising
from m100link.aircraft.connecting import connect
from m100link.aircraft.payload import AircraftGimbal, _not_shown, angles_command, rates_command
from m100link.aircraft.rates import set_telemetry_rates
from m100link.aircraft.supervising import (
    BackOff,
    SupervisionEvent,
    SupervisionState,
    _is_final,
)
from m100link.errors import (
    AckTimeout,
    ActivationRefused,
    AnotherAircraft,
    BadURL,
    CommandRefused,
    LinkLost,
    ReplayEnded,
    UsageError,
)
from m100link.link import Link
from m100link.link.url import parse_replay
from m100link.protocol.codes import ActivationCode
from m100link.protocol.commands.activation import GetVersion
from m100link.protocol.commands.gimbal import GimbalAngle, GimbalSpeed
from m100link.protocol.commands.waypoint import WaypointPauseResume
from m100link.protocol.firmware import FIRMWARE_3_1
from m100link.protocol.records import AccelerationMode, Attitude, Battery, Gimbal, Position
from m100link.sim import VirtualClockEventLoop
from m100link.telemetry.subscription import Latest, Lossless, Newest
from tests import limits

pytestmark = pytest.mark.anyio


@pytest.fixture
def anyio_backend() -> object:
    return "asyncio", {"loop_factory": VirtualClockEventLoop}


def aircraft() -> Any:
    """Anything that its methods may ask of an aircraft."""
    return MagicMock(
        _requests=MagicMock(execute=AsyncMock(), find_aircraft=AsyncMock(), send=AsyncMock()),
        _telemetry=MagicMock(wait_for=AsyncMock()),
        execute=AsyncMock(return_value=0),
    )


# -- each option reaches its end -------------------------------------------------------------------


@pytest.mark.parametrize("acceleration", ["raw", None])
async def test_what_a_supervision_opens_each_time(
    acceleration: str | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    opened = AsyncMock(return_value="an aircraft")
    monkeypatch.setattr(supervising, "connect", opened)
    credentials, back_off, chance = Credentials(1, b"k" * 32), BackOff(first=2.0), Random(3)
    one = supervise(
        "tcp://here:1",
        credentials,
        firmware="3.1",
        baud_rate=115200,
        timeout=7.5,
        back_off=back_off,
        random=chance,
        acceleration=acceleration,
    )
    found: object = await one._open()
    assert found == "an aircraft"
    options = {"firmware": "3.1", "baud_rate": 115200, "timeout": 7.5}
    assert opened.mock_calls == [call("tcp://here:1", **options, acceleration=acceleration)]
    kept: tuple[object, ...] = one._credentials, one._back_off, one._random
    assert kept == (credentials, back_off, chance)
    usual = supervise("tcp://here:1")
    assert (usual._credentials, usual._back_off) == (None, BackOff(0.5, 2.0, 15.0, 0.2))


@pytest.mark.parametrize("is_link", [False, True])
async def test_what_a_connection_opens_and_looks_for(
    is_link: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    link, made = MagicMock(Link), MagicMock(return_value=aircraft())
    link.name = "a link"
    opened = AsyncMock(return_value=link)
    monkeypatch.setattr("m100link.link.open_link", opened)
    monkeypatch.setattr("m100link.aircraft.aircraft.Aircraft", made)
    tap = None if is_link else MagicMock()
    line: Any = link if is_link else "tcp://here:1"
    await connect(
        line, firmware="3.1", baud_rate=115200, timeout=7.5, tap=tap, acceleration="fused"
    )
    assert opened.mock_calls == (
        [] if is_link else [call("tcp://here:1", baud_rate=115200, tap=tap)]
    )
    mode = AccelerationMode.FUSED
    assert made.mock_calls[0] == call(link, firmware=FIRMWARE_3_1, acceleration=mode)
    assert made.return_value._requests.find_aircraft.mock_calls == [call(7.5)]


async def test_a_connection_is_recorded_and_tapped_at_once_and_ends_its_log(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    found, tap = aircraft(), MagicMock()
    recorder = MagicMock(spec=["begin", "tap", "watch", "aclose"], aclose=AsyncMock())
    found._at_end = []
    opened = AsyncMock()
    monkeypatch.setattr("m100link.link.open_link", opened)
    monkeypatch.setattr("m100link.aircraft.aircraft.Aircraft", MagicMock(return_value=found))
    await connect("tcp://here:1", record=recorder, tap=tap)
    assert recorder.mock_calls[0] == call.begin()
    opened.call_args.kwargs["tap"]("direction", b"bytes", 1.5)
    assert call.tap("direction", b"bytes", 1.5) in recorder.mock_calls
    assert tap.mock_calls == [call("direction", b"bytes", 1.5)]
    _, firmware, _, acceleration = recorder.watch.call_args.args
    found._telemetry.acceleration.mode = "raw"
    assert (firmware(), acceleration()) == (found.firmware, "raw")
    assert found._at_end == [recorder.aclose]
    opened.side_effect = BadURL("no")
    with pytest.raises(BadURL):
        await connect("tcp://here:1", record=recorder)
    assert recorder.aclose.await_count == 1


def test_what_a_control_block_and_a_virtual_rc_are_made_of(monkeypatch: pytest.MonkeyPatch) -> None:
    one, guards = aircraft(), Guards(battery_floor_percent=31)
    control, virtual = MagicMock(), MagicMock()
    monkeypatch.setattr("m100link.flight.control.Control", control)
    monkeypatch.setattr("m100link.flight.virtual_rc.VirtualRc", virtual)
    given: dict[str, Any] = {"guards": guards, "handle_signals": False, "guardian": 5.0}
    usual: dict[str, Any] = {"guards": None, "handle_signals": True, "guardian": True}
    Aircraft.control(one, stop="land", on_pause="wait", **given)
    Aircraft.control(one)
    parts = one._commander, one._claim
    assert control.mock_calls == [
        call(*parts, stop="land", on_pause="wait", **given),
        call(*parts, stop="hover", on_pause="raise", **usual),
    ]
    Aircraft.virtual_rc(one, fall_back=False, **given)
    Aircraft.virtual_rc(one)
    pace = one._rc_settings
    assert virtual.mock_calls == [
        call(*parts, pace, fall_back=False, **given),
        call(*parts, pace, fall_back=True, **usual),
    ]


async def test_what_a_request_a_stream_and_a_wait_are_asked_with() -> None:
    one, ask = aircraft(), GetVersion()
    await Aircraft.execute(one, ask, timeout=1.5, tries=7, encrypted=True, refusal=CommandRefused)
    await Aircraft.execute(one, WaypointPauseResume(0))
    refusal = {"refusal": CommandRefused}
    assert one._requests.execute.mock_calls == [
        call(ask, timeout=1.5, tries=7, encrypted=True, **refusal),
        call(WaypointPauseResume(0), timeout=0.5, tries=3, encrypted=None, **refusal),
    ]
    Aircraft.push(one, GimbalSpeed(1.0))
    one._requests.push.assert_called_once_with(GimbalSpeed(1.0))
    Aircraft.telemetry(one, Attitude, policy=Newest(3), rate_hz=5.0)
    Aircraft.telemetry(one)
    assert one._telemetry.subscribe.mock_calls == [
        call((Attitude,), Newest(3), 5.0),
        call((), Latest(), None),
    ]

    def is_there(_: object) -> bool:
        return True

    await Aircraft.wait_for(one, is_there, timeout=2.5, what="it")
    assert one._telemetry.wait_for.mock_calls == [call(is_there, 2.5, "it")]
    Aircraft.from_mobile(one, policy=Newest(2))
    Aircraft.from_mobile(one)
    assert one._from_mobile.subscribe.mock_calls == [call(Newest(2)), call(Newest(100))]
    await Aircraft.send_to_mobile(one, b"data")
    [sent] = one.execute.mock_calls
    assert (sent.args[0].data, sent.kwargs) == (b"data", {"timeout": 0.5, "tries": 2})


async def test_what_is_collected_and_activated_with(monkeypatch: pytest.MonkeyPatch) -> None:
    one, columns, done = aircraft(), MagicMock(), AsyncMock()
    columns.return_value.collect = AsyncMock()
    monkeypatch.setattr("m100link.aircraft.aircraft.Columns", columns)
    monkeypatch.setattr("m100link.aircraft.aircraft.activate", done)
    await Aircraft.collect(one, Attitude, Battery, seconds=2.5, rate_hz=5.0)
    assert columns.mock_calls[0] == call(Attitude, Battery, utc_offset_s=one.utc_offset_s)
    one.telemetry.assert_called_once_with(Attitude, Battery, policy=Lossless(2000), rate_hz=5.0)
    samples = one.telemetry.return_value
    assert columns.return_value.collect.mock_calls == [call(samples, 2.5, one.link.clock)]
    credentials, progress = Credentials(1, b"k" * 32), MagicMock()
    await Aircraft.activate(one, credentials, timeout=5.0, progress=progress)
    await Aircraft.activate(one, credentials)
    asked = one._requests, one.link, credentials
    assert done.mock_calls == [
        call(*asked, timeout=5.0, progress=progress),
        call(*asked, timeout=60.0, progress=None),
    ]


# -- a connection that is kept ---------------------------------------------------------------------


@pytest.mark.parametrize(
    ("error", "is_final"),
    [
        (LinkLost("x"), False),
        (AckTimeout("x"), False),
        (BadURL("x"), True),
        (AnotherAircraft("x"), True),
        (ReplayEnded("x"), True),
    ],
)
def test_what_is_not_tried_again(error: Any, is_final: bool) -> None:
    assert _is_final(error) is is_final


@pytest.mark.parametrize("code", ActivationCode)
def test_an_app_is_asked_for_again_where_only_the_phone_is_missing(code: ActivationCode) -> None:
    passing = {"NEW_DEVICE", "APP_NOT_CONNECTED", "NO_INTERNET"}
    error = ActivationRefused("x")
    error.code = code
    assert _is_final(error) is (code.name not in passing)


async def test_what_is_refused_before_or_after_it_was_asked() -> None:
    """Orders that move, a push with an ack, the record of a line that is open; and code 0x12."""
    one = aircraft()
    for ask, seen in (
        (Aircraft.execute(one, WaypointPauseResume(1)), "in motion; nothing was sent"),
        (connect(MagicMock(spec=Link), record="x"), "can be neither tapped nor recorded"),
        (connect(MagicMock(spec=Link), tap=print), "can be neither tapped nor recorded"),
    ):
        with pytest.raises(UsageError, match=seen):
            await ask
    with pytest.raises(UsageError, match="cannot be pushed"):
        Aircraft.push(one, cast(Any, GetVersion()))
    assert one._requests.mock_calls == []
    one.execute.return_value = 0x12
    with pytest.raises(CommandRefused, match="code 0x0012") as refusal:
        await Aircraft.send_to_mobile(one, b"x")
    assert (refusal.value.command, refusal.value.code) == ("send_to_mobile", 0x12)


async def test_a_supervision_is_of_one_loop_and_its_samples_end_with_it() -> None:
    one = supervise("tcp://127.0.0.1:1")
    one._task = MagicMock()
    with pytest.raises(UsageError, match="another event loop"):
        await one._change()
    samples = one.telemetry()
    samples.close()
    assert await anext(samples, None) is None
    with pytest.raises(StopAsyncIteration):
        await anext(samples)


async def test_pauses_grow_until_it_is_connected_and_begin_anew_then() -> None:
    """Opened in vain three times, lost at once, and in vain once more."""
    lost = LinkLost("pulled out")
    good: Any = MagicMock(version=AsyncMock(), aclose=AsyncMock())
    good.version.return_value = SimpleNamespace(serial="S1", name="M100", is_activated=True)
    good.wait_closed = AsyncMock(return_value=lost)
    line: list[Any] = [lost, lost, lost, good, lost, asyncio.CancelledError()]
    one = supervise("tcp://here:1", back_off=BackOff(1.0, 2.0, 60.0, 0.0))
    one._open = AsyncMock(side_effect=line)  # no line is opened
    events = one.events()
    async with one:
        await asyncio.sleep(60.0)
    told: list[SupervisionEvent] = []
    while (event := events.get_nowait()) is not None:
        told.append(event)
    pauses = [event.next_attempt_in for event in told if event.next_attempt_in is not None]
    assert pauses == [1.0, 2.0, 4.0, 1.0, 1.0]
    assert good.aclose.await_count == 1
    states = [event.after for event in told]
    connected = states.index(SupervisionState.CONNECTED)
    assert [event.before for event in told][connected] is SupervisionState.ACTIVATING
    assert [event.error for event in told if event.next_attempt_in is not None] == [lost] * 5


# -- the gimbal ------------------------------------------------------------------------------------

YAW, ROLL, PITCH = 11.0, -12.0, -40.0


@pytest.mark.parametrize(
    ("given", "mode"),
    [
        ({"yaw": YAW, "roll": ROLL, "pitch": PITCH}, 1),
        ({"yaw": YAW, "roll": ROLL, "pitch": PITCH, "relative": True}, 0),
        ({"yaw": YAW}, 1 | 4 | 8),
        ({"roll": ROLL}, 1 | 2 | 8),
        ({"pitch": PITCH}, 1 | 2 | 4),
        ({"pitch": PITCH, "relative": True}, 2 | 4),
    ],
)
def test_an_axis_that_is_not_named_keeps_its_angle(given: dict[str, Any], mode: int) -> None:
    """Mode: 1 absolute; 2, 4, 8 keep yaw, roll, pitch."""
    expected = GimbalAngle(
        given.get("yaw", 0.0), given.get("roll", 0.0), given.get("pitch", 0.0), mode, 2.5
    )
    assert angles_command(**given, seconds=2.5) == expected
    rates = rates_command(yaw=1.0, pitch=2.0, roll=3.0)
    assert (rates.yaw_deg_s, rates.pitch_deg_s, rates.roll_deg_s) == (1.0, 2.0, 3.0)


@pytest.mark.parametrize(
    ("pitch", "shown", "is_there"),
    [
        (-40.0, (12.4, -13.4, -41.4), True),  # within a degree and a half
        (-40.0, (12.6, -12.0, -40.0), False),
        (-40.0, (11.0, -10.4, -40.0), False),
        (-40.0, (11.0, -12.0, -38.4), False),
        (-40.0, (371.0, -12.0, -40.0), True),  # a whole turn is none
        (-85.0, (90.0, 0.0, -85.0), False),
        (-86.0, (90.0, 0.0, -86.0), True),  # straight down, yaw and roll mean nothing
    ],
)
async def test_angles_are_shown_when_telemetry_says_so_after_they_were_sent(
    pitch: float, shown: tuple[float, float, float], is_there: bool
) -> None:
    """Nobody knows the age of an earlier item; the wait is three seconds longer than the turn."""
    requests: Any = MagicMock(send=AsyncMock())
    requests.latency.slack_s = 0.75
    telemetry: Any = MagicMock()
    seen = {"yaw_deg": shown[0], "roll_deg": shown[1], "pitch_deg": shown[2], "limits": 0}
    telemetry.state.gimbal = SimpleNamespace(**seen)
    found: list[Any] = []

    async def wait_for(is_shown: Any, timeout: float, what: str) -> None:
        if what == "the gimbal":
            now = asyncio.get_running_loop().time()
            for at in (now, now + 1e-3):
                telemetry.state.received_at.side_effect = lambda _, at=at: at
                found.append(is_shown(None))
            found.append(timeout)

    telemetry.wait_for = wait_for
    gimbal = AircraftGimbal(requests, telemetry)
    await gimbal.set_angles(yaw=YAW, roll=ROLL, pitch=pitch, seconds=2.0, wait=True)
    await gimbal.set_angles(yaw=YAW, roll=ROLL, pitch=pitch, seconds=2.0, wait=True, timeout=9.0)
    assert found == [False, is_there, 5.75, False, is_there, 9.0]


@pytest.mark.parametrize(
    ("limits", "axes"), [(0b001, "pitch"), (0b010, "roll"), (0b100, "yaw"), (0b101, "pitch, yaw")]
)
async def test_a_stop_of_the_gimbal_is_named_by_its_bit(limits: int, axes: str) -> None:
    error = _not_shown({"pitch": -40.0}, Gimbal(1.0, 2.0, 3.0, limits), 0.5, 2.0)
    assert error.cause == f"at its stop: {axes}"
    assert "pitch -40.0° and does not show it within 2 s; it shows pitch 2°" in error.seen
    old = _not_shown({"pitch": -40.0}, Gimbal(1.0, 2.0, 3.0, limits), 1.6, 2.0)
    assert old.cause == "the gimbal item stopped 1.6 s ago"


# -- telemetry rates -------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("rate", "counted", "is_it"),
    [(50, 60, True), (50, 43, True), (50, 38, False), (50, 80, False), (1, 3, True), (1, 9, False)],
)
async def test_a_rate_is_seen_within_a_third_and_one_package(
    rate: int, counted: int, is_it: bool
) -> None:
    """Counted in 1.2 s, or in 3.2 s at 1 Hz, after 0.3 s in which older packages come."""
    requests: Any = MagicMock(execute=AsyncMock(return_value=0))
    loop, begin = asyncio.get_running_loop(), asyncio.get_running_loop().time()
    seconds = 3.2 if rate == 1 else 1.2

    def statistics(record: type[Any]) -> Any:
        assert record is Position
        passed = loop.time() - begin
        assert passed == pytest.approx(0.3) or passed == pytest.approx(0.3 + seconds)
        return SimpleNamespace(count=100 + (counted if passed > 1.0 else 0))

    state: Any = SimpleNamespace(statistics=statistics)
    if is_it:
        observed = await set_telemetry_rates(requests, state, {"position": rate})
        assert observed == {"position": pytest.approx(counted / seconds)}
    else:
        with pytest.raises(NotObserved, match=f"position arrives at .* Hz instead of {rate}"):
            await set_telemetry_rates(requests, state, {"position": rate})
    [asked] = requests.execute.mock_calls
    assert asked.args[0].rates_hz == {"position": rate}
    assert asked.kwargs == {"timeout": 0.3, "tries": 3}


# -- recordings, and an activation in its attempts -------------------------------------------------


async def test_a_recording_is_read_as_its_program_says(monkeypatch: pytest.MonkeyPatch) -> None:
    opened, tap = AsyncMock(), MagicMock()
    monkeypatch.setattr(replaying, "open_replay", opened)
    async with connect("replay://a.mcap", firmware="3.1", acceleration="raw", tap=tap):
        pass
    told = {"firmware": FIRMWARE_3_1, "tap": tap, "acceleration": AccelerationMode.RAW}
    assert opened.await_args == call("replay://a.mcap", **told)


@pytest.mark.parametrize(
    ("options", "told"),
    [
        ("", (1.0, 0.0, math.inf)),
        ("?speed=max&until=9&from=1.5", (math.inf, 1.5, 9.0)),
        ("?speed=0.5&from=0", (0.5, 0.0, math.inf)),
        *((f"?{option}", None) for option in ("from=inf", "to=inf", "from=-1", "from=nan")),
        *((f"?{option}", None) for option in ("from=3&until=3", "speed=0", "speed=inf", "till=3")),
    ],
)
def test_a_part_of_a_recording_is_named_in_seconds(
    options: str, told: tuple[float, ...] | None
) -> None:
    if told is None:
        with pytest.raises(BadURL):
            parse_replay(f"replay://a.mcap{options}")
    else:
        assert parse_replay(f"replay://a.mcap{options}")[1:] == told


async def test_a_recording_of_no_known_firmware_is_asked_for_one(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    flight = MagicMock()
    flight.nameless.return_value = BadURL("which firmware?", remedy="say so")
    monkeypatch.setattr(replaying, "read", MagicMock(return_value=flight))
    begin = MagicMock(firmware=None, duration_s=9.0)
    monkeypatch.setattr(replaying, "begin_of", AsyncMock(return_value=begin))
    with pytest.raises(BadURL, match="which firmware"):
        await replaying.open_replay("replay://a.mcap")


async def test_an_aircraft_that_is_not_found_is_closed(monkeypatch: pytest.MonkeyPatch) -> None:
    made = aircraft()
    made.aclose = AsyncMock()
    made._requests.find_aircraft.side_effect = AckTimeout("nobody answers")
    monkeypatch.setattr("m100link.aircraft.aircraft.Aircraft", MagicMock(return_value=made))
    with pytest.raises(AckTimeout):
        await connect(MagicMock(spec=Link))
    made.aclose.assert_awaited_once_with()


@pytest.mark.parametrize(
    ("timeout", "attempts"),
    [
        (9.0, [(1, 3, 2.0, 9.0), (2, 3, 2.0, 7.0), (3, 0, None, 5.0)]),
        (3.0, [(1, 3, 2.0, 3.0), (2, 3, 1.0, 1.0), (3, 0, None, 0.0)]),
    ],
)
async def test_an_activation_is_tried_again_every_two_seconds(
    timeout: float, attempts: list[tuple[int, int, float | None, float]]
) -> None:
    """Code 3: a new device; 0: success."""
    requests, link = aircraft()._requests, MagicMock()
    told: list[activation.ActivationProgress] = []
    requests.firmware, requests.query_version = FIRMWARE_3_1, AsyncMock()
    requests.execute.side_effect = [ActivationCode(one[1]) for one in attempts]
    await activation.activate(
        requests, link, Credentials(7, "ab" * 32), timeout=timeout, progress=told.append
    )
    assert [(one.attempt, one.code, one.next_attempt_in, one.remaining) for one in told] == attempts


def test_each_limit_is_as_agreed() -> None:
    assert limits.differences("aircraft") == []
