"""Orders that come too late."""

from __future__ import annotations

import pytest

from m100link.apps.fleet.expiry import MOST_AGE_S, OrderAges, require_young
from m100link.errors import GuardRefused


@pytest.fixture
def ages() -> OrderAges:
    return OrderAges()


def test_what_is_in_order_is_heard(ages: OrderAges) -> None:
    ages.hear(1, 10.0, 10.1)
    ages.hear(1, 10.0, 10.2)  # two at once
    ages.hear(1, 11.0, 11.0 + MOST_AGE_S)
    ages.revoke(20.0)
    ages.hear(1, 20.0, 20.1)  # after the answer of what revoked


def test_what_is_old_is_refused(ages: OrderAges) -> None:
    with pytest.raises(GuardRefused, match="nobody waits") as caught:
        ages.hear(1, 10.0, 10.1 + MOST_AGE_S)
    assert caught.value.guard == "order_age"
    with pytest.raises(GuardRefused, match="nobody waits"):
        ages.hear(1, 0.0, 1e6)  # who does not say when


def test_what_was_revoked_is_refused(ages: OrderAges) -> None:
    ages.hear(1, 10.0, 10.0)
    ages.revoke(10.5)
    with pytest.raises(GuardRefused, match="asked for after"):
        ages.check(10.0, 10.6)
    with pytest.raises(GuardRefused, match="asked for after"):
        ages.hear(2, 10.4, 10.6)


def test_of_one_asker_the_newer_one_counts_and_a_later_lease_begins_anew(ages: OrderAges) -> None:
    ages.hear(1, 10.0, 10.0)
    with pytest.raises(GuardRefused, match="later was heard before"):
        ages.hear(1, 9.9, 10.1)
    ages.hear(2, 9.9, 10.1)


def test_a_landing_is_asked_for_its_age_alone(ages: OrderAges) -> None:
    ages.revoke(20.0)
    require_young(16.0, 20.5)  # STOP came between: both want it to be safe
    for made_at in (10.0, 0.0, float("nan"), -1.0):
        with pytest.raises(GuardRefused, match="nobody waits"):
            require_young(made_at, 20.5)


def test_what_was_made_by_the_clock_of_before_a_start_is_refused(ages: OrderAges) -> None:
    require_young(20.9, 20.0)  # who reckons its time from an answer is wrong by a little
    with pytest.raises(GuardRefused, match=r"made 980\.0 s from now") as caught:
        ages.hear(1, 1000.0, 20.0)
    assert caught.value.guard == "order_age"
    ages.hear(1, 20.0, 20.1)
    with pytest.raises(GuardRefused, match="from now"):
        require_young(float("inf"), 20.0)
