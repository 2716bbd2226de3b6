"""Every pair of block state and input or cause, against a table written by hand with reasons."""

from __future__ import annotations

import re
from pathlib import Path
from unittest.mock import AsyncMock

import pytest

from m100link.errors import AuthorityLost, LinkClosed, LinkLost
from m100link.flight import lifecycle, virtual_rc
from m100link.flight.lifecycle import (
    STOP_PLANS,
    TRANSITIONS,
    BlockClaim,
    BlockInput,
    BlockState,
    Lifecycle,
    StopCause,
    StopPlan,
)

S, I, C = BlockState, BlockInput, StopCause  # noqa: E741

# (state, input or cause): (next state, why)
NOT_ENTERED = "before it is entered, a block has nothing that could go on or end"
ONCE = "a block is entered once: what it did the first time is over or under way"
ACK_FIRST = "only the ack of the request lets anything fly"
ENDS = "every cause ends a block from every state in which the aircraft may be ours"
NOT_PAUSED = "only a pause can be ended by going on"
PILOT = "the pilot may take the aircraft at any moment from the ack on"
KNOWN = "it is known already"
UNDER_WAY = "the stop path runs; it asks for authority itself before each step"
FIRST_CAUSE = "the first cause has chosen the plan, and every plan ends with the aircraft at rest"
NO_LINE = "without a line the rest of the stop path has no peer, and the program gets the error"
GUARDED = "the guardian ends the flight; two who do would disturb each other"
NEVER_AGAIN = "a block that is over never sends again; its authority was given back"

EXPECTED: dict[tuple[BlockState, BlockInput | StopCause], tuple[BlockState, str]] = {
    (S.NEW, I.ENTER): (S.ENTERING, "the way in"),
    (S.NEW, I.OBTAINED): (S.NEW, NOT_ENTERED),
    (S.NEW, I.PAUSE): (S.NEW, NOT_ENTERED),
    (S.NEW, I.RESUME): (S.NEW, NOT_ENTERED),
    (S.NEW, I.STOPPED): (S.NEW, NOT_ENTERED),
    (S.NEW, C.LEFT): (S.NEW, NOT_ENTERED),
    (S.NEW, C.NOT_ENTERED): (S.NEW, NOT_ENTERED),
    (S.NEW, C.SIGNALLED): (S.NEW, NOT_ENTERED),
    (S.NEW, C.CLOSED): (S.NEW, NOT_ENTERED),
    (S.NEW, C.AUTHORITY_LOST): (S.NEW, NOT_ENTERED),
    (S.NEW, C.TELEMETRY_STALLED): (S.NEW, NOT_ENTERED),
    (S.NEW, C.NAVIGATION_LOST): (S.NEW, NOT_ENTERED),
    (S.NEW, C.SETPOINTS_IGNORED): (S.NEW, NOT_ENTERED),
    (S.NEW, C.SUSPENDED): (S.NEW, NOT_ENTERED),
    (S.NEW, C.GUARD_REFUSED): (S.NEW, NOT_ENTERED),
    (S.NEW, C.SENDING_FAILED): (S.NEW, NOT_ENTERED),
    (S.NEW, C.LINE_BLOCKED): (S.NEW, NOT_ENTERED),
    (S.NEW, C.LINK_LOST): (S.NEW, NOT_ENTERED),
    (S.NEW, C.GUARDIAN): (S.NEW, NOT_ENTERED),
    (S.ENTERING, I.ENTER): (S.ENTERING, ONCE),
    (S.ENTERING, I.OBTAINED): (S.FLYING, "the ack says obtained"),
    (S.ENTERING, I.PAUSE): (S.PAUSED, PILOT),
    (S.ENTERING, I.RESUME): (S.ENTERING, ACK_FIRST),
    (S.ENTERING, I.STOPPED): (S.ENTERING, "no stop path was begun"),
    (S.ENTERING, C.LEFT): (S.STOPPING, ENDS),
    (S.ENTERING, C.NOT_ENTERED): (S.STOPPING, "refused or cancelled: the ack may be lost"),
    (S.ENTERING, C.SIGNALLED): (S.STOPPING, ENDS),
    (S.ENTERING, C.CLOSED): (S.STOPPING, ENDS),
    (S.ENTERING, C.AUTHORITY_LOST): (S.STOPPING, ENDS),
    (S.ENTERING, C.TELEMETRY_STALLED): (S.STOPPING, ENDS),
    (S.ENTERING, C.NAVIGATION_LOST): (S.STOPPING, ENDS),
    (S.ENTERING, C.SETPOINTS_IGNORED): (S.STOPPING, ENDS),
    (S.ENTERING, C.SUSPENDED): (S.STOPPING, ENDS),
    (S.ENTERING, C.GUARD_REFUSED): (S.STOPPING, ENDS),
    (S.ENTERING, C.SENDING_FAILED): (S.STOPPING, ENDS),
    (S.ENTERING, C.LINE_BLOCKED): (S.STOPPING, ENDS),
    (S.ENTERING, C.LINK_LOST): (S.STOPPING, ENDS),
    (S.ENTERING, C.GUARDIAN): (S.STOPPING, GUARDED),
    (S.FLYING, I.ENTER): (S.FLYING, ONCE),
    (S.FLYING, I.OBTAINED): (S.FLYING, KNOWN),
    (S.FLYING, I.PAUSE): (S.PAUSED, PILOT),
    (S.FLYING, I.RESUME): (S.FLYING, NOT_PAUSED),
    (S.FLYING, I.STOPPED): (S.FLYING, "no stop path was begun"),
    (S.FLYING, C.LEFT): (S.STOPPING, ENDS),
    (S.FLYING, C.NOT_ENTERED): (S.STOPPING, "something raised before the program's first line"),
    (S.FLYING, C.SIGNALLED): (S.STOPPING, ENDS),
    (S.FLYING, C.CLOSED): (S.STOPPING, ENDS),
    (S.FLYING, C.AUTHORITY_LOST): (S.STOPPING, ENDS),
    (S.FLYING, C.TELEMETRY_STALLED): (S.STOPPING, ENDS),
    (S.FLYING, C.NAVIGATION_LOST): (S.STOPPING, ENDS),
    (S.FLYING, C.SETPOINTS_IGNORED): (S.STOPPING, ENDS),
    (S.FLYING, C.SUSPENDED): (S.STOPPING, ENDS),
    (S.FLYING, C.GUARD_REFUSED): (S.STOPPING, ENDS),
    (S.FLYING, C.SENDING_FAILED): (S.STOPPING, ENDS),
    (S.FLYING, C.LINE_BLOCKED): (S.STOPPING, ENDS),
    (S.FLYING, C.LINK_LOST): (S.STOPPING, ENDS),
    (S.FLYING, C.GUARDIAN): (S.STOPPING, GUARDED),
    (S.PAUSED, I.ENTER): (S.PAUSED, ONCE),
    (S.PAUSED, I.OBTAINED): (S.PAUSED, "the pilot took it after the ack: that is newer"),
    (S.PAUSED, I.PAUSE): (S.PAUSED, KNOWN),
    (S.PAUSED, I.RESUME): (S.FLYING, "the program says so, and nobody else"),
    (S.PAUSED, I.STOPPED): (S.PAUSED, "no stop path was begun"),
    (S.PAUSED, C.LEFT): (S.STOPPING, ENDS),
    (S.PAUSED, C.NOT_ENTERED): (S.STOPPING, "something raised before the program's first line"),
    (S.PAUSED, C.SIGNALLED): (S.STOPPING, ENDS),
    (S.PAUSED, C.CLOSED): (S.STOPPING, ENDS),
    (S.PAUSED, C.AUTHORITY_LOST): (S.STOPPING, "the app takes it from the pilot, too"),
    (S.PAUSED, C.TELEMETRY_STALLED): (S.STOPPING, ENDS),
    (S.PAUSED, C.NAVIGATION_LOST): (S.STOPPING, ENDS),
    (S.PAUSED, C.SETPOINTS_IGNORED): (S.STOPPING, ENDS),
    (S.PAUSED, C.SUSPENDED): (S.STOPPING, ENDS),
    (S.PAUSED, C.GUARD_REFUSED): (S.STOPPING, ENDS),
    (S.PAUSED, C.SENDING_FAILED): (S.STOPPING, ENDS),
    (S.PAUSED, C.LINE_BLOCKED): (S.STOPPING, ENDS),
    (S.PAUSED, C.LINK_LOST): (S.STOPPING, ENDS),
    (S.PAUSED, C.GUARDIAN): (S.STOPPING, GUARDED),
    (S.STOPPING, I.ENTER): (S.STOPPING, ONCE),
    (S.STOPPING, I.OBTAINED): (S.STOPPING, "an ack that comes late: the release follows"),
    (S.STOPPING, I.PAUSE): (S.STOPPING, UNDER_WAY),
    (S.STOPPING, I.RESUME): (S.STOPPING, "nothing flies again in this block"),
    (S.STOPPING, I.STOPPED): (S.OVER, "the way out"),
    (S.STOPPING, C.LEFT): (S.STOPPING, FIRST_CAUSE),
    (S.STOPPING, C.NOT_ENTERED): (S.STOPPING, FIRST_CAUSE),
    (S.STOPPING, C.SIGNALLED): (S.STOPPING, FIRST_CAUSE),
    (S.STOPPING, C.CLOSED): (S.STOPPING, FIRST_CAUSE),
    (S.STOPPING, C.AUTHORITY_LOST): (S.STOPPING, UNDER_WAY),
    (S.STOPPING, C.TELEMETRY_STALLED): (S.STOPPING, FIRST_CAUSE),
    (S.STOPPING, C.NAVIGATION_LOST): (S.STOPPING, FIRST_CAUSE),
    (S.STOPPING, C.SETPOINTS_IGNORED): (S.STOPPING, FIRST_CAUSE),
    (S.STOPPING, C.SUSPENDED): (S.STOPPING, FIRST_CAUSE),
    (S.STOPPING, C.GUARD_REFUSED): (S.STOPPING, FIRST_CAUSE),
    (S.STOPPING, C.SENDING_FAILED): (S.STOPPING, FIRST_CAUSE),
    (S.STOPPING, C.LINE_BLOCKED): (S.STOPPING, FIRST_CAUSE),
    (S.STOPPING, C.LINK_LOST): (S.STOPPING, NO_LINE),
    (S.STOPPING, C.GUARDIAN): (S.STOPPING, GUARDED),
    (S.OVER, I.ENTER): (S.OVER, ONCE),
    (S.OVER, I.OBTAINED): (S.OVER, NEVER_AGAIN),
    (S.OVER, I.PAUSE): (S.OVER, NEVER_AGAIN),
    (S.OVER, I.RESUME): (S.OVER, NEVER_AGAIN),
    (S.OVER, I.STOPPED): (S.OVER, KNOWN),
    (S.OVER, C.LEFT): (S.OVER, NEVER_AGAIN),
    (S.OVER, C.NOT_ENTERED): (S.OVER, NEVER_AGAIN),
    (S.OVER, C.SIGNALLED): (S.OVER, NEVER_AGAIN),
    (S.OVER, C.CLOSED): (S.OVER, NEVER_AGAIN),
    (S.OVER, C.AUTHORITY_LOST): (S.OVER, NEVER_AGAIN),
    (S.OVER, C.TELEMETRY_STALLED): (S.OVER, NEVER_AGAIN),
    (S.OVER, C.NAVIGATION_LOST): (S.OVER, NEVER_AGAIN),
    (S.OVER, C.SETPOINTS_IGNORED): (S.OVER, NEVER_AGAIN),
    (S.OVER, C.SUSPENDED): (S.OVER, NEVER_AGAIN),
    (S.OVER, C.GUARD_REFUSED): (S.OVER, NEVER_AGAIN),
    (S.OVER, C.SENDING_FAILED): (S.OVER, NEVER_AGAIN),
    (S.OVER, C.LINE_BLOCKED): (S.OVER, NEVER_AGAIN),
    (S.OVER, C.LINK_LOST): (S.OVER, NEVER_AGAIN),
    (S.OVER, C.GUARDIAN): (S.OVER, NEVER_AGAIN),
}

# They replace the cause of a stop path that runs.
REPLACING: set[tuple[BlockState, BlockInput | StopCause]] = {
    (S.STOPPING, C.LINK_LOST),
    (S.STOPPING, C.GUARDIAN),
}

# How a block really comes to each state.
WAY_TO: dict[BlockState, tuple[BlockInput | StopCause, ...]] = {
    S.NEW: (),
    S.ENTERING: (I.ENTER,),
    S.FLYING: (I.ENTER, I.OBTAINED),
    S.PAUSED: (I.ENTER, I.OBTAINED, I.PAUSE),
    S.STOPPING: (I.ENTER, I.OBTAINED, C.LEFT),
    S.OVER: (I.ENTER, I.OBTAINED, C.LEFT, I.STOPPED),
}


def life_in(state: BlockState) -> Lifecycle:
    life = Lifecycle()
    for what in WAY_TO[state]:
        assert life.feed(what)
    assert life.state is state
    return life


@pytest.mark.parametrize("state", S, ids=lambda s: s.name)
@pytest.mark.parametrize("what", [*I, *C], ids=lambda w: w.name)
def test_each_input_and_cause_in_each_state_leads_where_the_reasons_say(
    state: BlockState, what: BlockInput | StopCause
) -> None:
    assert (state, what) in EXPECTED, f"EXPECTED of this file has no row for {state}, {what}"
    after, why = EXPECTED[state, what]
    life = life_in(state)
    before = life.cause
    is_taken = life.feed(what)
    assert life.state is after, why
    assert is_taken is (after is not state or (state, what) in REPLACING), why
    assert life.cause is (what if is_taken and isinstance(what, C) else before), why


def test_every_transition_of_the_code_stands_in_the_expectation() -> None:
    in_code = {(s, what): after for s, row in TRANSITIONS.items() for what, after in row.items()}
    changing = {pair: row[0] for pair, row in EXPECTED.items() if row[0] is not pair[0]}
    assert in_code == changing | dict.fromkeys(REPLACING, S.STOPPING)
    assert set(TRANSITIONS) == set(S)


def test_from_every_state_that_may_hold_authority_every_cause_stops() -> None:
    for state in (S.ENTERING, S.FLYING, S.PAUSED):
        assert {TRANSITIONS[state][cause] for cause in C} == {S.STOPPING}


def test_the_first_failure_is_the_one_that_is_raised() -> None:
    life = life_in(S.FLYING)
    first, second = AuthorityLost("the pilot"), LinkLost("the plug")
    life.feed(C.AUTHORITY_LOST, first)
    life.feed(C.LINK_LOST, second)
    assert life.failure is first
    assert life.plan == STOP_PLANS[C.LINK_LOST]


def test_a_line_lost_during_the_stop_path_is_reported_when_nothing_else_is() -> None:
    life = life_in(S.STOPPING)
    lost = LinkLost("the plug")
    life.feed(C.LINK_LOST, lost)
    assert life.failure is lost


# Mission, explain, neutral, land, release; why. Written from what each cause leaves possible.
PLANS: dict[StopCause, tuple[tuple[bool, bool, bool, bool, bool], str]] = {
    C.LEFT: ((True, False, True, True, True), "all is well: everything that was asked for"),
    C.NOT_ENTERED: ((False, False, False, False, True), "nothing flew; the ack alone may be lost"),
    C.SIGNALLED: ((True, False, True, True, True), "the program goes, the aircraft does not"),
    C.CLOSED: ((True, False, True, True, True), "as long as the line is there, it is used"),
    C.AUTHORITY_LOST: (
        (True, True, False, False, True),
        "the taker flies it; say who",
    ),
    C.TELEMETRY_STALLED: (
        (True, False, True, True, True),
        "it may hear us though we hear nothing",
    ),
    C.NAVIGATION_LOST: ((True, False, True, True, True), "to stand and to land need no place"),
    C.SETPOINTS_IGNORED: ((True, False, True, True, True), "other commands may be obeyed"),
    C.SUSPENDED: ((True, False, True, True, True), "it hovers, and hears us again"),
    C.GUARD_REFUSED: ((True, False, True, True, True), "a mission that may not fly is stopped"),
    C.SENDING_FAILED: ((True, False, True, True, True), "other commands may still be sent"),
    C.LINE_BLOCKED: ((True, False, True, True, True), "it may drain again at any moment"),
    C.LINK_LOST: ((False, False, False, False, False), "nobody is there"),
    C.GUARDIAN: ((False, False, False, False, False), "the guardian has done it"),
}


@pytest.mark.parametrize("cause", C, ids=lambda c: c.name)
def test_each_cause_has_the_plan_that_it_leaves_possible(cause: StopCause) -> None:
    assert cause in PLANS, f"PLANS of this file has no row for {cause}"
    plan, why = PLANS[cause]
    assert STOP_PLANS[cause] == StopPlan(*plan), why


def test_a_virtual_rc_centres_and_switches_off_unless_the_cause_is_named() -> None:
    """A cause that nobody thought of sends all that can be sent."""
    not_centred = {C.AUTHORITY_LOST, C.LINK_LOST, C.GUARDIAN}
    not_switched_off = {C.LINK_LOST, C.GUARDIAN}
    row = "the row of this cause in STOP_PLANS makes a virtual RC silent"
    assert not_centred == virtual_rc._SILENT, row
    assert not_switched_off == virtual_rc._HOPELESS, row


def test_authority_is_kept_only_where_nobody_hears_or_another_gives_it_back() -> None:
    kept = {cause for cause, plan in STOP_PLANS.items() if not plan.release}
    assert kept == {C.LINK_LOST, C.GUARDIAN}


def test_each_cause_ends_a_block_somewhere() -> None:
    flight = Path(lifecycle.__file__).parent
    others = {path for path in flight.rglob("*.py") if path.name != "lifecycle.py"}
    text = "".join(path.read_text(encoding="utf-8") for path in others)
    given = set(re.findall(r"(?:end\(|_end, |else )\s*StopCause\.(\w+)", text))
    assert set(re.findall(r"StopCause\.([A-Z_]+)", text)) <= set(C.__members__)
    lacks = sorted(set(C.__members__) - given)
    assert not lacks, f"no call of ControlBlock.end in m100link/flight/ gives {lacks}"


# What the page on safety names a failure by, in its table by hand. The rest ends as the program
# says, or before anything flew.
FAILURES: dict[StopCause, str] = {
    C.AUTHORITY_LOST: "AuthorityLost",
    C.TELEMETRY_STALLED: "TelemetryStalled",
    C.NAVIGATION_LOST: "NavigationLost",
    C.SETPOINTS_IGNORED: "SetpointsIgnored",
    C.SUSPENDED: "ComputerSuspended",
    C.GUARD_REFUSED: "GuardRefused",
    C.LINE_BLOCKED: "LineBlocked",
    C.LINK_LOST: "LinkLost",
    C.GUARDIAN: "the guardian ends the flight",
}
NO_FAILURES = {C.LEFT, C.NOT_ENTERED, C.SIGNALLED, C.CLOSED, C.SENDING_FAILED}


@pytest.mark.parametrize(
    "cause", [one for one in C if one not in NO_FAILURES], ids=lambda c: c.name
)
def test_the_page_on_safety_has_each_failure_in_its_table(cause: StopCause) -> None:
    page = (Path(__file__).parents[2] / "docs/explanation/safety.md").read_text(encoding="utf-8")
    rows = [line for line in page.splitlines() if line.startswith("| ")]
    assert cause in FAILURES, f"FAILURES of this file has no row for {cause.name}"
    assert any(FAILURES[cause] in row for row in rows), f"safety.md has no row for {cause.name}"


@pytest.mark.anyio
async def test_no_block_begins_behind_the_end_of_a_connection() -> None:
    claim = BlockClaim()
    claim.take(ended := AsyncMock())
    await claim.close()
    ended.assert_awaited_once_with()
    claim.give_back()
    with pytest.raises(LinkClosed, match="no control block begins any more"):
        claim.take(ended)
