"""The 14 modes, their flags and ranges, and how each firmware reads them."""

from __future__ import annotations

import dataclasses
import math
import re
import struct
from collections.abc import Callable
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from m100link.errors import BadSetpoint, UsageError
from m100link.protocol import (
    PROFILES,
    ControlMode,
    FirmwareProfile,
    Horizontal,
    Move,
    ReferenceFrame,
    Setpoint,
    Vertical,
    Yaw,
    profile,
)
from m100link.protocol.setpoint import ReceivedMove

TILT, VELOCITY, OFFSET = Horizontal
CLIMB, HEIGHT, THRUST = Vertical

# Number, mode and flag without frame bits, from the document's table of combinations.
MODES = [
    (1, TILT, CLIMB, Yaw.ANGLE, 0x00),
    (2, TILT, CLIMB, Yaw.RATE, 0x08),
    (3, VELOCITY, CLIMB, Yaw.ANGLE, 0x40),
    (4, VELOCITY, CLIMB, Yaw.RATE, 0x48),
    (5, OFFSET, CLIMB, Yaw.ANGLE, 0x80),
    (6, OFFSET, CLIMB, Yaw.RATE, 0x88),
    (7, TILT, HEIGHT, Yaw.ANGLE, 0x10),
    (8, TILT, HEIGHT, Yaw.RATE, 0x18),
    (9, VELOCITY, HEIGHT, Yaw.ANGLE, 0x50),
    (10, VELOCITY, HEIGHT, Yaw.RATE, 0x58),
    (11, OFFSET, HEIGHT, Yaw.ANGLE, 0x90),
    (12, OFFSET, HEIGHT, Yaw.RATE, 0x98),
    (13, TILT, THRUST, Yaw.ANGLE, 0x20),
    (14, TILT, THRUST, Yaw.RATE, 0x28),
]
BODY = 0x02
FIRMWARES = [PROFILES[name] for name in ("1.0", "2.3", "3.1")]


def only(name: str, value: float) -> dict[str, Any]:
    """Arguments of ``build``, all zero but one."""
    return {"x": 0.0, "y": 0.0, "z": 0.0, "turn": 0.0} | {name: value}


def build(
    horizontal: Horizontal,
    vertical: Vertical,
    yaw: Yaw,
    x: float = 1.0,
    y: float = 2.0,
    z: float = 3.0,
    turn: float = 4.0,
    *,
    frame: ReferenceFrame = ReferenceFrame.BODY,
) -> Setpoint:
    """A setpoint by the constructor that users would take."""
    words: dict[str, Any] = {
        {CLIMB: "up", HEIGHT: "height", THRUST: "thrust_percent"}[vertical]: z,
        {Yaw.ANGLE: "yaw_deg", Yaw.RATE: "yaw_rate_deg_s"}[yaw]: turn,
    }
    if horizontal is TILT:
        return Setpoint.tilt(roll_deg=x, pitch_deg=y, frame=frame, **words)
    make: Callable[..., Setpoint] = (
        Setpoint.velocity if horizontal is VELOCITY else Setpoint.position_offset
    )
    names = ("forward", "right") if frame is ReferenceFrame.BODY else ("north", "east")
    return make(**words | dict(zip(names, (x, y), strict=True)))


def test_a_setpoint_goes_out_as_the_movement_command() -> None:
    """Stated twice, so that a program that makes setpoints loads no other command."""
    for said in ("ADDRESS", "NAME", "LEVEL", "ENCRYPTED", "SINCE", "NEEDS_ACTIVATION"):
        assert getattr(Setpoint, said) == getattr(Move, said)


@pytest.mark.parametrize(("number", "horizontal", "vertical", "yaw", "flag"), MODES)
def test_each_mode_has_its_number_and_its_flag(
    number: int, horizontal: Horizontal, vertical: Vertical, yaw: Yaw, flag: int
) -> None:
    mode = ControlMode(horizontal, vertical, yaw)
    assert mode.is_legal
    assert (mode.number, mode.flag) == (number, flag)
    setpoint = build(horizontal, vertical, yaw)
    assert setpoint.mode == mode
    for firmware in FIRMWARES:
        move = setpoint.to_move(firmware)
        assert move == Move(flag | BODY, 1.0, 2.0, 3.0, 4.0)
        assert Setpoint.from_move(move, firmware) == setpoint


@pytest.mark.parametrize(("number", "horizontal", "vertical", "yaw", "flag"), MODES)
def test_the_ground_frame_has_bit_1_clear(
    number: int, horizontal: Horizontal, vertical: Vertical, yaw: Yaw, flag: int
) -> None:
    setpoint = build(horizontal, vertical, yaw, frame=ReferenceFrame.GROUND)
    for name in ("2.3", "3.1"):
        assert setpoint.to_move(profile(name)).control_flag == flag
        assert Setpoint.from_move(setpoint.to_move(profile(name)), profile(name)) == setpoint


def test_exactly_the_14_modes_of_the_table_are_legal() -> None:
    legal = [
        (mode.number, mode.flag)
        for h in Horizontal
        for v in Vertical
        for y in Yaw
        if (mode := ControlMode(h, v, y)).is_legal
    ]
    assert sorted(legal) == [(number, flag) for number, *_, flag in MODES]


@pytest.mark.parametrize("horizontal", [VELOCITY, OFFSET])
@pytest.mark.parametrize("yaw", Yaw)
def test_thrust_goes_with_tilt_only(horizontal: Horizontal, yaw: Yaw) -> None:
    mode = ControlMode(horizontal, THRUST, yaw)
    with pytest.raises(BadSetpoint, match="THRUST"):
        Setpoint(mode, 0, 0, 0, 0)
    with pytest.raises(BadSetpoint, match="thrust does not go"):
        Setpoint.from_move(Move(mode.flag, 0, 0, 0, 0), profile("3.1"))


# -- ranges ----------------------------------------------------------------------------------------

# Argument, its mode and the range of the document; None where it has no bound.
RANGES = [
    ("x", TILT, CLIMB, Yaw.RATE, -35, 35),
    ("y", TILT, CLIMB, Yaw.RATE, -35, 35),
    ("x", VELOCITY, CLIMB, Yaw.RATE, -10, 10),
    ("y", VELOCITY, CLIMB, Yaw.RATE, -10, 10),
    ("x", OFFSET, CLIMB, Yaw.RATE, None, None),
    ("y", OFFSET, CLIMB, Yaw.RATE, None, None),
    ("z", VELOCITY, CLIMB, Yaw.RATE, -4, 4),
    ("z", VELOCITY, HEIGHT, Yaw.RATE, 0, None),
    ("z", TILT, THRUST, Yaw.RATE, 0, 100),
    ("turn", VELOCITY, CLIMB, Yaw.ANGLE, -180, 180),
    ("turn", VELOCITY, CLIMB, Yaw.RATE, -100, 100),
]


@pytest.mark.parametrize(("name", "horizontal", "vertical", "yaw", "low", "high"), RANGES)
def test_values_reach_to_the_ends_of_their_range_and_not_beyond(
    name: str,
    horizontal: Horizontal,
    vertical: Vertical,
    yaw: Yaw,
    low: float | None,
    high: float | None,
) -> None:
    for bound, beyond in ((low, -math.inf), (high, math.inf)):
        inside = bound if bound is not None else math.copysign(1e6, beyond)
        build(horizontal, vertical, yaw, **only(name, inside))
        if bound is not None:
            with pytest.raises(BadSetpoint, match="outside"):
                build(horizontal, vertical, yaw, **only(name, math.nextafter(bound, beyond)))


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("name", ["x", "y", "z", "turn"])
def test_no_value_may_be_nan_or_infinite(name: str, value: float) -> None:
    for number, horizontal, vertical, yaw, _ in MODES:
        with pytest.raises(BadSetpoint) as caught:
            pytest.fail(f"{number}: {build(horizontal, vertical, yaw, **only(name, value))}")
        assert caught.value.cause == "a computation that went wrong upstream", number


@pytest.mark.parametrize("name", ["x", "z"])
def test_a_value_that_no_32_bit_float_holds_is_refused(name: str) -> None:
    build(OFFSET, HEIGHT, Yaw.RATE, **only(name, 3e38))
    with pytest.raises(BadSetpoint, match="1e\\+39"):
        build(OFFSET, HEIGHT, Yaw.RATE, **only(name, 1e39))


def test_the_largest_value_is_that_of_ieee_754_single_precision() -> None:
    (largest,) = struct.unpack("<f", b"\xff\xff\x7f\x7f")
    for name in ("x", "y", "z"):
        build(OFFSET, HEIGHT, Yaw.RATE, **only(name, largest))
        with pytest.raises(BadSetpoint, match="outside"):
            build(OFFSET, HEIGHT, Yaw.RATE, **only(name, math.nextafter(largest, math.inf)))


def test_a_setpoint_that_was_checked_is_not_changed_behind_the_check() -> None:
    setpoint = build(VELOCITY, CLIMB, Yaw.RATE)
    with pytest.raises(dataclasses.FrozenInstanceError):
        setpoint.x = 99.0  # type: ignore[misc]  # that is the test


SETPOINTS = st.one_of(
    [
        st.builds(
            build,
            st.just(horizontal),
            st.just(vertical),
            st.just(yaw),
            *(
                st.floats(low, high, width=32)
                for low, high in (
                    (-limit, limit),
                    (-limit, limit),
                    {CLIMB: (-4, 4), HEIGHT: (0, 2.0**120), THRUST: (0, 100)}[vertical],
                    {Yaw.ANGLE: (-180, 180), Yaw.RATE: (-100, 100)}[yaw],
                )
            ),
            frame=st.sampled_from(ReferenceFrame)
            if horizontal is not TILT
            else st.just(ReferenceFrame.BODY),
        )
        for _, horizontal, vertical, yaw, _ in MODES
        for limit in [{TILT: 30, VELOCITY: 10, OFFSET: 2.0**120}[horizontal]]
    ]
)


@given(SETPOINTS, st.sampled_from(list(PROFILES.values())))
def test_every_setpoint_can_be_sent_and_is_read_back(
    setpoint: Setpoint, firmware: FirmwareProfile
) -> None:
    value = setpoint.to_move(firmware).value(firmware)
    assert Setpoint.from_move(Move.parse(value, firmware), firmware) == setpoint


@pytest.mark.parametrize(
    ("make", "words", "told"),
    [
        (Setpoint.velocity, {"north": 12.0}, "north 12 m/s is outside -10 to 10"),
        (Setpoint.velocity, {"east": -12.0}, "east -12 m/s is outside -10 to 10"),
        (Setpoint.velocity, {"forward": 12.0, "right": 0.0}, "forward 12 m/s"),
        (Setpoint.velocity, {"forward": 0.0, "right": 12.0}, "right 12 m/s"),
        (Setpoint.position_offset, {"north": math.nan}, "north is nan"),
        (Setpoint.position_offset, {"forward": 0.0, "right": math.inf}, "right is inf"),
        (Setpoint.tilt, {"roll_deg": 36.0}, "roll_deg 36 ° is outside -35 to 35"),
        (Setpoint.tilt, {"pitch_deg": 36.0, "frame": ReferenceFrame.GROUND}, "pitch_deg 36 °"),
        (Setpoint.velocity, {"up": 5.0}, "up 5 m/s is outside -4 to 4"),
        (Setpoint.velocity, {"height": -1.0}, "height -1 m is outside 0 to"),
        (Setpoint.tilt, {"thrust_percent": 101.0}, "thrust_percent 101 %"),
        (Setpoint.velocity, {"yaw_deg": 181.0}, "yaw_deg 181 °"),
        (Setpoint.velocity, {"yaw_rate_deg_s": 120.0}, "yaw_rate_deg_s 120 °/s"),
    ],
)
def test_a_bad_setpoint_is_a_usage_error_in_the_words_of_the_program(
    make: Callable[..., Setpoint], words: dict[str, float], told: str
) -> None:
    usual = {"roll_deg": 0.0, "pitch_deg": 0.0} if make == Setpoint.tilt else {}
    if make != Setpoint.tilt and "forward" not in words:
        usual = {"north": 0.0, "east": 0.0}
    if not words.keys() & {"up", "height", "thrust_percent"}:
        usual["up"] = 0.0
    if not words.keys() & {"yaw_deg", "yaw_rate_deg_s"}:
        usual["yaw_deg"] = 0.0
    with pytest.raises(UsageError, match=re.escape(told)):
        make(**{**usual, **words})


# -- what is given must make one setpoint ----------------------------------------------------------


@pytest.mark.parametrize(
    "words",
    [
        {},
        {"north": 1.0},
        {"forward": 1.0},
        {"north": 1.0, "right": 1.0},
        {"north": 1.0, "east": 1.0, "forward": 1.0},
        {"north": 1.0, "east": 1.0, "forward": 1.0, "right": 1.0},
    ],
)
@pytest.mark.parametrize("make", [Setpoint.velocity, Setpoint.position_offset])
def test_horizontal_values_are_of_one_frame(
    make: Callable[..., Setpoint], words: dict[str, float]
) -> None:
    with pytest.raises(BadSetpoint, match="one frame"):
        make(**words, up=0, yaw_deg=0)


def test_exactly_one_vertical_and_one_yaw_value_are_needed() -> None:
    with pytest.raises(BadSetpoint, match="0 vertical"):
        Setpoint.velocity(north=0, east=0, yaw_deg=0)
    with pytest.raises(BadSetpoint, match="2 vertical"):
        Setpoint.velocity(north=0, east=0, up=0, height=1, yaw_deg=0)
    with pytest.raises(BadSetpoint, match="exactly one yaw"):
        Setpoint.velocity(north=0, east=0, up=0)
    with pytest.raises(BadSetpoint, match="exactly one yaw"):
        Setpoint.velocity(north=0, east=0, up=0, yaw_deg=0, yaw_rate_deg_s=0)


# -- what firmware makes of it ---------------------------------------------------------------------


def test_the_flags_of_djis_own_samples_mean_what_they_flew() -> None:
    firmware = profile("3.1")
    flown = {
        0x0A: (TILT, CLIMB, Yaw.RATE, ReferenceFrame.BODY, False),
        0x48: (VELOCITY, CLIMB, Yaw.RATE, ReferenceFrame.GROUND, False),
        0x40: (VELOCITY, CLIMB, Yaw.ANGLE, ReferenceFrame.GROUND, False),
        0x90: (OFFSET, HEIGHT, Yaw.ANGLE, ReferenceFrame.GROUND, False),
        0x91: (OFFSET, HEIGHT, Yaw.ANGLE, ReferenceFrame.GROUND, True),
        0x12: (TILT, HEIGHT, Yaw.ANGLE, ReferenceFrame.BODY, False),
    }
    for flag, meaning in flown.items():
        setpoint = Setpoint.from_move(Move(flag, 0, 0, 0, 0), firmware)
        assert (*setpoint.mode, setpoint.frame, setpoint.stable) == meaning


def test_bit_0_is_stable_mode_from_3_1_on_and_the_yaw_frame_before() -> None:
    stable = Setpoint.velocity(north=1, east=0, up=0, yaw_rate_deg_s=0, stable=True)
    assert stable.control_flag(profile("3.1")) == 0x49
    for name in ("1.0", "2.3"):
        with pytest.raises(BadSetpoint, match=f"firmware {name} has no stable mode"):
            stable.to_move(profile(name))
        # An aircraft of that firmware reads the bit as a yaw frame, not as stable mode.
        assert not Setpoint.from_move(Move(0x49, 0, 0, 0, 0), profile(name)).stable
    assert Setpoint.from_move(Move(0x49, 0, 0, 0, 0), profile("3.1")).stable


def test_firmware_1_0_knows_tilt_in_the_body_frame_only() -> None:
    ground = build(TILT, CLIMB, Yaw.RATE, frame=ReferenceFrame.GROUND)
    with pytest.raises(BadSetpoint, match="body frame only"):
        ground.to_move(profile("1.0"))
    assert Setpoint.from_move(Move(0x08, 0, 0, 0, 0), profile("1.0")).frame is ReferenceFrame.BODY
    assert Setpoint.from_move(Move(0x08, 0, 0, 0, 0), profile("2.3")).frame is ReferenceFrame.GROUND


def test_every_flag_is_a_setpoint_or_refused() -> None:
    legal = {flag for *_, flag in MODES}
    for flag in range(256):
        move = Move(flag, 0.0, 0.0, 0.0, 0.0)
        if flag & 0x04 or flag & 0xF8 not in legal:
            with pytest.raises(BadSetpoint):
                pytest.fail(f"{flag:#x}: {Setpoint.from_move(move, profile('3.1'))}")
        else:
            setpoint = Setpoint.from_move(move, profile("3.1"))
            assert setpoint.control_flag(profile("3.1")) == flag


def test_an_aircraft_reads_values_beyond_the_range_as_they_are() -> None:
    move = Move(0x48, 99.0, -99.0, 9.0, -500.0)
    with pytest.raises(BadSetpoint):
        Setpoint.from_move(move, profile("3.1"))
    received = ReceivedMove.read(move, profile("3.1"))
    assert received[1:5] == (99.0, -99.0, 9.0, -500.0)


@pytest.mark.parametrize("place", range(1, 5))
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_an_aircraft_refuses_what_is_not_finite(value: float, place: int) -> None:
    values = [0.0] * 4
    values[place - 1] = value
    with pytest.raises(BadSetpoint, match="not finite"):
        ReceivedMove.read(Move(0x48, *values), profile("3.1"))


@pytest.mark.parametrize("name", ["1.0", "1.0-document", "2.3"])
@pytest.mark.parametrize("angles", [(30.5, 0.0), (0.0, -30.5), (35.0, 35.0)])
def test_more_than_30_degrees_are_for_firmware_3_1(angles: tuple[float, float], name: str) -> None:
    """Document 3.2 says 30; recordings of 3.1.10 hold 35.5, DJI's later headers say 35."""
    setpoint = Setpoint.tilt(roll_deg=angles[0], pitch_deg=angles[1], up=0.0, yaw_rate_deg_s=0.0)
    for refused in (setpoint.control_flag, setpoint.encode, setpoint.value, setpoint.to_move):
        with pytest.raises(BadSetpoint, match="tilts by at most 30°"):
            refused(profile(name))
    assert setpoint.to_move(profile("3.1"))[:3] == (0x0A, *angles)
    steepest = Setpoint.tilt(roll_deg=30.0, pitch_deg=-30.0, up=0.0, yaw_rate_deg_s=0.0)
    assert steepest.to_move(profile(name))[1:3] == (30.0, -30.0)


@pytest.mark.parametrize(("number", "horizontal", "vertical", "yaw", "flag"), MODES)
def test_neutral_stops_climb_and_turn_in_the_same_horizontal_mode(
    number: int, horizontal: Horizontal, vertical: Vertical, yaw: Yaw, flag: int
) -> None:
    setpoint = build(horizontal, vertical, yaw)
    neutral = setpoint.neutral()
    assert neutral.mode == (horizontal, CLIMB, Yaw.RATE)
    assert (neutral.x, neutral.y, neutral.z, neutral.yaw) == (0, 0, 0, 0)
    assert neutral.frame is setpoint.frame


@pytest.mark.parametrize("name", PROFILES)
def test_a_setpoint_is_the_movement_command_that_it_asks_for(name: str) -> None:
    """In one step or by way of the raw command: the same bytes, the same refusals."""
    firmware = profile(name)
    rest = {"up": 1.5, "yaw_rate_deg_s": -20.0}
    for frame in ReferenceFrame:
        for stable in (False, True):
            for setpoint in (
                Setpoint.tilt(roll_deg=3.0, pitch_deg=-4.0, frame=frame, stable=stable, **rest),
                Setpoint(ControlMode(VELOCITY, CLIMB, Yaw.RATE), 1, 2, 3, 4, frame, stable),
                Setpoint.position_offset(forward=1.0, right=2.0, stable=stable, **rest),
            ):
                try:
                    move = setpoint.to_move(firmware)
                except BadSetpoint:
                    with pytest.raises(BadSetpoint):
                        setpoint.encode(firmware)
                    continue
                assert setpoint.encode(firmware) == move.encode(firmware)
                assert setpoint.value(firmware) == move.value(firmware)
    assert (Setpoint.ADDRESS, Setpoint.ENCRYPTED) == (Move.ADDRESS, Move.ENCRYPTED)


@pytest.mark.parametrize(
    ("name", "flag", "asked", "flown"),
    [
        ("3.1", 0x48, (99.0, -99.0, 9.0, -500.0), (10.0, -10.0, 4.0, -100.0)),
        ("3.1", 0x48, (1.0, -2.0, -9.0, 270.0), (1.0, -2.0, -4.0, 100.0)),
        ("3.1", 0x02, (45.0, -45.0, 0.0, 190.0), (35.0, -35.0, 0.0, -170.0)),
        ("2.3", 0x02, (45.0, -31.0, 0.0, -530.0), (30.0, -30.0, 0.0, -170.0)),
        ("3.1", 0x22, (0.0, 0.0, 130.0, 180.0), (0.0, 0.0, 100.0, 180.0)),
        ("3.1", 0x22, (0.0, 0.0, -1.0, -180.0), (0.0, 0.0, 0.0, -180.0)),
        ("3.1", 0x90, (500.0, -500.0, 60.0, 0.0), (500.0, -500.0, 60.0, 0.0)),
    ],
)
def test_values_beyond_the_range_end_at_it(
    name: str, flag: int, asked: tuple[float, ...], flown: tuple[float, ...]
) -> None:
    limited = ReceivedMove.read(Move(flag, *asked), profile(name)).limited(profile(name))
    assert (limited.x, limited.y, limited.z, limited.yaw) == pytest.approx(flown)
    assert limited.control_flag(profile(name)) == flag


def test_what_is_no_number_or_below_the_ground_has_no_nearest_setpoint() -> None:
    mode = ControlMode(VELOCITY, HEIGHT, Yaw.RATE)
    for values in ((math.nan, 0, 1, 0), (0, math.inf, 1, 0), (0, 0, 1, -math.inf), (0, 0, -1, 0)):
        with pytest.raises(BadSetpoint):
            ReceivedMove(mode, *values).limited(profile("3.1"))


@pytest.mark.parametrize(
    ("mode", "frame", "said"),
    [
        ((VELOCITY, CLIMB, Yaw.RATE), 0, "1 m/s north, -2 m/s east, 3 m/s up, 4 °/s yaw rate"),
        ((VELOCITY, HEIGHT, Yaw.ANGLE), 1, "1 m/s forward, -2 m/s right, 3 m height, 4 ° yaw"),
        ((OFFSET, HEIGHT, Yaw.ANGLE), 0, "1 m north, -2 m east, 3 m height, 4 ° yaw"),
        ((TILT, THRUST, Yaw.RATE), 1, "1 ° roll, -2 ° pitch, 3 % thrust, 4 °/s yaw rate"),
        ((TILT, CLIMB, Yaw.RATE), 0, "1 ° roll, -2 ° pitch, 3 m/s up, 4 °/s yaw rate"),
    ],
)
def test_a_movement_in_words_has_unit_and_frame(
    mode: tuple[Horizontal, Vertical, Yaw], frame: int, said: str
) -> None:
    move = ReceivedMove(ControlMode(*mode), 1.0, -2.0, 3.0, 4.0, ReferenceFrame(frame))
    assert move.in_words() == said
    assert move._replace(x=-3.3e-5, y=0.05571).in_words().startswith("0 ")
    assert ", 0.056 " in move._replace(y=0.05571).in_words()
