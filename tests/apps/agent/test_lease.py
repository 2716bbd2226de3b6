"""One lease at a time; whatever ended stays ended."""

from __future__ import annotations

import contextlib
from collections.abc import Callable

import pytest
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, rule

from m100link.apps.agent.lease import Lease, LeaseChange, LeaseHeld, LeaseManager, LeaseRefused


def test_the_first_who_asks_gets_it_and_the_second_learns_who_has_it() -> None:
    manager = LeaseManager()
    manager.acquire("field laptop", 0.0)
    with pytest.raises(LeaseHeld) as caught:
        manager.acquire("tablet", 0.1)
    assert caught.value.holder == "field laptop"
    assert "take over" in caught.value.remedy


def test_a_lease_that_nobody_renews_ends() -> None:
    manager = LeaseManager(lifetime=3.0)
    lease = manager.acquire("a", 0.0)
    manager.renew(lease.token, 2.9)
    assert manager.holder(5.8) == lease
    assert manager.holder(5.9) is None
    assert manager.remaining(6.0) == 0.0
    with pytest.raises(LeaseRefused) as caught:
        manager.renew(lease.token, 5.9)
    assert caught.value.seen == "this lease is not in force"
    manager.acquire("b", 6.0)
    with pytest.raises(LeaseRefused) as caught:
        manager.renew(lease.token, 6.1)
    assert caught.value.seen == "this lease is not in force; b has control"


@pytest.mark.parametrize(
    ("call", "expected"),
    [
        (lambda manager, _, __: manager.holder(3.0), None),
        (lambda manager, _, __: manager.remaining(3.0), 0.0),
        (lambda manager, _, __: manager.acquire("b", 3.0).name, "b"),
        (lambda manager, token, _: manager.check(token, 3.0), "not in force"),
        (lambda manager, token, _: manager.renew(token, 3.0), "not in force"),
        (lambda manager, token, _: manager.release(token, 3.0), "not in force"),
        (lambda manager, _, __: manager.ask_take_over("b", 3.0), "nobody has control"),
        (lambda manager, _, asked: manager.confirm(asked, 3.0), "nothing to confirm"),
    ],
)
def test_whatever_is_asked_a_lease_that_nobody_renewed_has_ended(
    call: Callable[[LeaseManager, str, str], object], expected: object
) -> None:
    changes: list[LeaseChange] = []
    manager = LeaseManager(on_change=lambda why, *_: changes.append(why))
    lease = manager.acquire("a", 0.0)
    asked = manager.ask_take_over("b", 2.0)
    try:
        found = call(manager, lease.token, asked.token)
    except LeaseRefused as refused:
        found = refused.seen
    assert str(expected) in str(found)
    assert changes[:2] == [LeaseChange.ACQUIRED, LeaseChange.EXPIRED]


def test_a_released_expired_or_taken_lease_cannot_be_replayed() -> None:
    manager = LeaseManager()
    released = manager.acquire("a", 0.0)
    manager.release(released.token, 0.1)
    expired = manager.acquire("a", 0.2)
    taken = manager.acquire("a", 100.0)
    manager.confirm(manager.ask_take_over("b", 100.1).token, 100.2)
    for old in (released, expired, taken):
        for attempt in (manager.check, manager.renew, manager.release):
            with pytest.raises(LeaseRefused):
                attempt(old.token, 100.3)
    assert manager.holder(100.3).name == "b"  # type: ignore[union-attr]


def test_a_take_over_names_the_loser_and_needs_its_confirmation() -> None:
    manager = LeaseManager(lifetime=60.0)
    first = manager.acquire("a", 0.0)
    wanted = manager.ask_take_over("b", 1.0)
    assert wanted.from_name == "a"
    assert manager.holder(1.0) == first  # asking alone takes nothing
    second = manager.confirm(wanted.token, 2.0)
    assert (second.name, second.number) == ("b", 2)
    with pytest.raises(LeaseRefused, match="nothing to confirm"):
        manager.confirm(wanted.token, 2.0)  # used


@pytest.mark.parametrize("meanwhile", ["too late", "released", "changed hands"])
def test_a_confirmation_holds_for_what_was_asked_only(meanwhile: str) -> None:
    manager = LeaseManager(lifetime=60.0)
    first = manager.acquire("a", 0.0)
    wanted = manager.ask_take_over("b", 1.0)
    now = 2.0
    if meanwhile == "too late":
        now = 11.0
    else:
        manager.release(first.token, 1.5)
        if meanwhile == "changed hands":
            manager.acquire("c", 1.6)
    with pytest.raises(LeaseRefused, match="nothing to confirm"):
        manager.confirm(wanted.token, now)


def test_a_take_over_can_be_confirmed_for_ten_seconds_and_a_lease_lasts_three() -> None:
    manager = LeaseManager()
    assert manager.lifetime == 3.0
    manager = LeaseManager(lifetime=60.0)
    manager.acquire("a", 0.0)
    early, late = manager.ask_take_over("b", 1.0), manager.ask_take_over("c", 1.0)
    assert early.expires_at == 11.0
    manager.void_take_overs()
    with pytest.raises(LeaseRefused):
        manager.confirm(late.token, 1.5)
    assert manager.confirm(manager.ask_take_over("d", 2.0).token, 11.99).name == "d"


@pytest.mark.parametrize("lifetime", [0.0, -1.0, float("nan")])
def test_a_lease_without_a_lifetime_is_none(lifetime: float) -> None:
    with pytest.raises(ValueError, match="is none"):
        LeaseManager(lifetime=lifetime)


def test_a_free_lease_is_not_taken_over() -> None:
    with pytest.raises(LeaseRefused, match="nobody has control"):
        LeaseManager().ask_take_over("b", 0.0)


def test_tokens_stay_out_of_logs_and_names_are_fit_for_a_banner() -> None:
    manager = LeaseManager()
    lease = manager.acquire("x\n\x1b[31m" + "y" * 200, 0.0)
    assert lease.token not in repr(lease)
    assert lease.name.isprintable()
    assert len(lease.name) == 64
    wanted = manager.ask_take_over("\n", 0.0)
    assert wanted.token not in repr(wanted)
    assert wanted.name == "unnamed"


def test_changes_are_reported() -> None:
    seen: list[tuple[LeaseChange, str | None, str | None]] = []

    def note(why: LeaseChange, old: Lease | None, new: Lease | None) -> None:
        seen.append((why, old.name if old else None, new.name if new else None))

    manager = LeaseManager(on_change=note)
    manager.acquire("a", 0.0)
    manager.confirm(manager.ask_take_over("b", 0.0).token, 0.0)
    manager.advance(10.0)
    manager.release(manager.acquire("c", 10.0).token, 10.0)
    assert seen == [
        (LeaseChange.ACQUIRED, None, "a"),
        (LeaseChange.TAKEN_OVER, "a", "b"),
        (LeaseChange.EXPIRED, "b", None),
        (LeaseChange.ACQUIRED, None, "c"),
        (LeaseChange.RELEASED, "c", None),
    ]


class LeaseMachine(RuleBasedStateMachine):
    """Whatever happens: at most one token works, and it is the newest one."""

    def __init__(self) -> None:
        super().__init__()
        self.now = 0.0
        self.manager = LeaseManager()
        self.leases: list[Lease] = []

    @rule(seconds=st.floats(0.0, 4.0))
    def wait(self, seconds: float) -> None:
        self.now += seconds

    @rule()
    def acquire(self) -> None:
        with contextlib.suppress(LeaseHeld):
            self.leases.append(self.manager.acquire("x", self.now))

    @rule(confirm_after=st.floats(0.0, 12.0))
    def take_over(self, confirm_after: float) -> None:
        try:
            wanted = self.manager.ask_take_over("y", self.now)
            self.now += confirm_after
            self.leases.append(self.manager.confirm(wanted.token, self.now))
        except LeaseRefused:
            pass

    @rule(which=st.integers(0, 9), what=st.sampled_from(["renew", "release"]))
    def replay(self, which: int, what: str) -> None:
        if self.leases:
            token = self.leases[which % len(self.leases)].token
            with contextlib.suppress(LeaseRefused):
                getattr(self.manager, what)(token, self.now)

    @invariant()
    def only_the_newest_works(self) -> None:
        works = []
        for lease in self.leases:
            with contextlib.suppress(LeaseRefused):
                works.append(self.manager.check(lease.token, self.now))
        assert works in ([], self.leases[-1:])


TestLeaseMachine = LeaseMachine.TestCase


def test_what_spammers_ask_does_not_push_out_what_others_asked() -> None:
    manager = LeaseManager()
    manager.acquire("holder", 0.0)
    wanted = manager.ask_take_over("operator", 1.0)
    for number in range(500):
        manager.ask_take_over("operator", 1.0)
        with pytest.raises(LeaseRefused):
            manager.confirm(f"guess {number}", 1.0)
    assert manager.confirm(wanted.token, 2.0).name == "operator"


def test_time_in_which_the_program_did_not_run_ends_no_lease() -> None:
    manager = LeaseManager(lifetime=3.0, longest_step=0.5)
    lease = manager.acquire("a", 0.0)
    assert manager.holder(5.0) == lease  # it did not run for 4.5 s
    assert manager.remaining(5.0) == pytest.approx(2.5)
    for step in range(1, 6):
        assert manager.holder(5.0 + 0.5 * step) == (lease if step < 5 else None)


def test_a_desk_after_another_begins_where_that_one_cannot_have_come() -> None:
    manager = LeaseManager(leases_before=1_000_000)
    assert manager.acquire("anybody", 0.0).number == 1_000_001
