"""The table, pair by pair, and the pauses."""

from __future__ import annotations

from random import Random

import pytest

from m100link.aircraft.supervising import (
    ENDED,
    TRANSITIONS,
    BackOff,
    SupervisionInput,
    SupervisionState,
)
from m100link.errors import UsageError

_S, _I = SupervisionState, SupervisionInput

# Every state, and what each input makes of it; what is not named leaves it as it is.
EXPECTED = {
    _S.IDLE: {_I.START: _S.CONNECTING, _I.CLOSE: _S.CLOSED},
    _S.CONNECTING: {
        _I.ANSWERED: _S.ACTIVATING,
        _I.FAILED: _S.WAITING,
        _I.REFUSED: _S.REFUSED,
        _I.CLOSE: _S.CLOSED,
    },
    _S.ACTIVATING: {
        _I.ACTIVATED: _S.CONNECTED,
        _I.FAILED: _S.WAITING,
        _I.LOST: _S.WAITING,
        _I.REFUSED: _S.REFUSED,
        _I.CLOSE: _S.CLOSED,
    },
    _S.CONNECTED: {
        _I.LOST: _S.WAITING,
        _I.DEACTIVATED: _S.ACTIVATING,
        _I.REFUSED: _S.REFUSED,
        _I.CLOSE: _S.CLOSED,
    },
    _S.WAITING: {_I.DUE: _S.CONNECTING, _I.CLOSE: _S.CLOSED},
    _S.REFUSED: {_I.CLOSE: _S.CLOSED},
    _S.CLOSED: {},
}


@pytest.mark.parametrize("happened", _I)
@pytest.mark.parametrize("state", _S)
def test_each_pair(state: SupervisionState, happened: SupervisionInput) -> None:
    assert TRANSITIONS[state].get(happened, state) is EXPECTED[state].get(happened, state)


def test_only_a_state_that_has_ended_has_no_way_back() -> None:
    for state in _S:
        ways = {after for after in TRANSITIONS[state].values() if after is not _S.CLOSED}
        assert (not ways) is (state in ENDED)


def test_pauses_grow_to_the_longest_and_chance_moves_them_a_fifth() -> None:
    plain = BackOff(jitter=0.0)
    random = Random(1)
    pauses = [plain.pause(attempt, random) for attempt in (1, 2, 3, 4, 5, 6, 7, 100_000)]
    assert pauses == [0.5, 1.0, 2.0, 4.0, 8.0, 15.0, 15.0, 15.0]
    moved = [BackOff().pause(9, random) for _ in range(500)]
    assert 12.0 <= min(moved) < 12.3
    assert 17.7 < max(moved) <= 18.0


def test_a_steady_pause_stays() -> None:
    assert BackOff(first=1.0, factor=1.0, jitter=0.0).pause(50, Random(1)) == 1.0


@pytest.mark.parametrize(
    "wrong",
    [
        {"first": 0.0},
        {"first": -1.0},
        {"first": 20.0},
        {"factor": 0.5},
        {"factor": float("inf")},
        {"most": float("inf")},
        {"most": float("nan")},
        {"jitter": 1.0},
        {"jitter": -0.1},
    ],
)
def test_pauses_that_cannot_be_are_refused(wrong: dict[str, float]) -> None:
    with pytest.raises(UsageError):
        BackOff(**wrong)
