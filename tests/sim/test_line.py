"""The spoilt line: loss, damage, delay, repeats, noise, slowness, the radio, the plug."""

from __future__ import annotations

from random import Random
from typing import Any

import pytest

from m100link.sim import NO_FAULTS, Line, LineFaults
from m100link.sim.line import LineDirection, split_frames
from m100link.wire import FrameDecoder, encode_frame

SEED = 20151121


def direction(**faults: Any) -> LineDirection:
    print(f"seed {SEED}")  # noqa: T201
    return LineDirection(Random(SEED), LineFaults(**faults))


def frames(count: int, size: int = 60) -> list[bytes]:
    return [
        encode_frame(number.to_bytes(2, "little") * (size // 2), session=0, sequence=number)
        for number in range(count)
    ]


def carry(
    line: LineDirection, pieces: list[bytes], spacing: float = 0.01
) -> list[tuple[float, bytes]]:
    """Send pieces at even times; returns what arrives and when (looked at every millisecond)."""
    arrived, now = [], 0.0
    for tick in range(round(len(pieces) * spacing * 1000) + 2000):
        now = tick / 1000
        if tick % round(spacing * 1000) == 0 and tick // round(spacing * 1000) < len(pieces):
            line.put(pieces[tick // round(spacing * 1000)], now)
        arrived += [(now, piece) for piece in line.take(now)]
    return arrived


def test_a_clean_line_carries_everything_at_once() -> None:
    line = Line(Random(SEED))
    pieces = frames(3)
    assert line.from_aircraft(pieces, 0.0) == pieces
    assert line.from_host(b"abc", 0.0) == [b"abc"]
    assert line.next_wakeup() is None


def test_loss_is_the_share_that_was_asked_for() -> None:
    line, sent = direction(loss=0.2), frames(2000)
    arrived = [piece for _, piece in carry(line, sent)]
    assert len(arrived) == pytest.approx(1600, abs=60)
    assert line.lost == 2000 - len(arrived)
    assert [piece for piece in sent if piece in set(arrived)] == arrived, "in order"


def test_damage_flips_bits_and_no_damaged_frame_is_accepted() -> None:
    line, sent = direction(damage=0.5), frames(1000)
    arrived = [piece for _, piece in carry(line, sent)]
    changed = [(a, b) for a, b in zip(sent, arrived, strict=True) if a != b]
    assert len(changed) == pytest.approx(500, abs=50)
    assert all(len(a) == len(b) for a, b in changed)
    decoder = FrameDecoder()
    good = {frame.sequence for piece in arrived for frame in decoder.feed(piece)}
    good |= {frame.sequence for frame in decoder.close()}
    assert good == {
        number for number, (a, b) in enumerate(zip(sent, arrived, strict=True)) if a == b
    }


def test_duplicates_arrive_twice_in_a_row() -> None:
    line = direction(duplicate=0.3)
    arrived = [piece for _, piece in carry(line, frames(1000))]
    assert len(arrived) == pytest.approx(1300, abs=60)
    assert sorted(set(arrived), key=arrived.index) == frames(1000)


def test_delay_delays_and_jitter_does_not_reorder() -> None:
    line, sent = direction(delay=0.1, jitter=0.05), frames(300)
    arrived = carry(line, sent)
    assert [piece for _, piece in arrived] == sent
    delays = [time - index * 0.01 for index, (time, _) in enumerate(arrived)]
    assert min(delays) >= 0.1
    assert max(delays) <= 0.1 + 0.05 + 0.002
    assert max(delays) - min(delays) > 0.03


def test_noise_comes_in_bursts_of_random_bytes() -> None:
    line = direction(noise=20.0, noise_bytes=16)
    sent = frames(1000)
    arrived = carry(line, sent)
    noise = [piece for _, piece in arrived if piece not in set(sent)]
    assert len(noise) == pytest.approx(20 * 12, rel=0.25)
    assert max(map(len, noise)) <= 16
    decoder = FrameDecoder()
    found = [frame.sequence for _, piece in arrived for frame in decoder.feed(piece)]
    assert found == list(range(1000)), "noise delays frames and loses none"


def test_noise_asks_to_be_woken() -> None:
    line = direction(noise=1.0)
    line.take(0.0)
    wakeup = line.next_wakeup()
    assert wakeup is not None
    assert line.take(wakeup)


def test_a_slow_line_takes_ten_bits_per_byte() -> None:
    line = direction(baud_rate=9600)
    (piece,) = frames(1, size=84)
    line.put(piece, 0.0)
    assert line.next_wakeup() == pytest.approx(len(piece) * 10 / 9600)


def test_a_line_that_is_too_slow_drops_what_waits_half_a_second() -> None:
    line, sent = direction(baud_rate=57_600), frames(600, size=100)
    arrived = carry(line, sent)
    share = len(arrived) / len(sent)
    assert share == pytest.approx(5760 / (116 * 100), rel=0.12)
    assert len(line._waiting) == 0


def test_a_stalled_line_keeps_a_little_and_goes_on() -> None:
    line = Line(Random(SEED))
    line.stall()
    for index, piece in enumerate(frames(500)):
        assert line.from_aircraft([piece], index / 100) == []
    assert line.next_wakeup() is None
    line.stall(to_host=False, to_aircraft=False)
    assert 40 < len(line.from_aircraft([], 5.0)) < 60


def test_the_half_duplex_radio_loses_when_both_talk() -> None:
    def run(both: bool) -> float:
        line = Line(Random(SEED), LineFaults(radio=True))
        commands, arrived = frames(500, size=20), 0
        for tick in range(5000):
            now = tick / 1000
            if both and tick % 10 == 0:
                line.from_aircraft([frames(1, size=112)[0]], now)
            line.from_aircraft([], now)
            data = commands[tick // 10] if tick % 10 == 3 else b""
            arrived += len(line.from_host(data, now))
        return arrived / 500

    assert run(both=False) == 1.0
    assert 0.4 < run(both=True) < 0.85


def test_unplugged_everything_is_lost_both_ways() -> None:
    line = Line(Random(SEED), LineFaults(delay=0.1))
    line.from_aircraft(frames(3), 0.0)
    line.unplug()
    assert line.from_aircraft(frames(2), 0.2) == []
    assert line.from_host(b"abc", 0.2) == []
    assert line.next_wakeup() is None
    assert (line.to_host.lost, line.to_aircraft.lost) == (5, 1)
    line.replug()
    assert line.from_aircraft(frames(1), 0.3) == []
    assert line.from_aircraft([], 0.41) == frames(1)


@pytest.mark.parametrize(
    "faults", [LineFaults(delay=0.1), LineFaults(baud_rate=9600)], ids=["delayed", "slow"]
)
@pytest.mark.parametrize("arrives_from", ["from_aircraft", "from_host"])
def test_what_is_under_way_when_the_plug_is_pulled_never_arrives(
    arrives_from: str, faults: LineFaults
) -> None:
    """A setpoint from before the plug was pulled would move the aircraft when it is back."""
    line = Line(Random(SEED), faults, to_aircraft=faults)
    carry_: Any = getattr(line, arrives_from)
    sent, nothing = (frames(1), []) if arrives_from == "from_aircraft" else (frames(1)[0], b"")
    assert carry_(sent, 0.0) == []
    line.unplug()
    assert line.next_wakeup() is None
    line.replug()
    assert carry_(nothing, 9.0) == []
    way = line.to_host if arrives_from == "from_aircraft" else line.to_aircraft
    assert way.lost == 1
    assert carry_(sent, 10.0) == []
    assert carry_(nothing, 11.0) == frames(1)


def test_each_direction_may_have_faults_of_its_own() -> None:
    line = Line(Random(SEED), NO_FAULTS, to_aircraft=LineFaults(loss=1.0))
    assert line.from_aircraft(frames(1), 0.0) == frames(1)
    assert line.from_host(frames(1)[0], 0.0) == []


def test_faults_strike_frames_not_reads() -> None:
    line = Line(Random(SEED), LineFaults(loss=0.5))
    sent = frames(100)
    arrived = b"".join(line.from_host(b"".join(sent), 0.0))
    assert 20 < len(FrameDecoder().feed(arrived)) < 80


def test_equal_seeds_spoil_equally() -> None:
    results = []
    for seed in (1, 1, 2):
        line = LineDirection(Random(seed), LineFaults(loss=0.1, damage=0.1, jitter=0.02, noise=5.0))
        results.append(carry(line, frames(200)))
    assert results[0] == results[1] != results[2]


@pytest.mark.parametrize(
    ("data", "pieces"),
    [
        (b"", []),
        (b"abc", [b"abc"]),
        (b"\xaa", [b"\xaa"]),
        (frames(2)[0] + frames(2)[1], frames(2)),
        (frames(1)[0] + b"\xaa\x10", [frames(1)[0], b"\xaa\x10"]),
        (frames(1)[0][5:], [frames(1)[0][5:]]),
        (b"\xaa\x05\x00" + bytes(20), [b"\xaa\x05\x00" + bytes(20)]),
    ],
)
def test_split_frames(data: bytes, pieces: list[bytes]) -> None:
    assert split_frames(data) == pieces


@pytest.mark.parametrize(
    "faults",
    [
        {"loss": 1.1},
        {"damage": -0.1},
        {"duplicate": 2},
        {"delay": -1},
        {"jitter": float("inf")},
        {"noise": float("nan")},
        {"noise_bytes": 0},
        {"baud_rate": 0},
    ],
)
def test_faults_that_cannot_be_are_refused(faults: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match=r"."):
        LineFaults(**faults)
