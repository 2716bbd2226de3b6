"""Every pair of authority state and input, against a table written from the document by hand."""

from __future__ import annotations

import asyncio
import dataclasses
import random

import pytest

from m100link.flight.authority import TRANSITIONS, Authority, AuthorityInput, AuthorityState
from m100link.protocol.firmware import PROFILES, FirmwareProfile
from m100link.protocol.items import ItemLayout
from m100link.protocol.packet import TelemetryPacket, encode_telemetry
from m100link.protocol.records import ControlDevice, RcMode, RemoteControl

S, I = AuthorityState, AuthorityInput  # noqa: E741

# (state, input): (next state, reason afterwards, why). QS is the quick start's "Safety during
# flight" and "Remote Controller, Onboard API & Mobile API"; the numbers are sections.
NOTHING_TO_LOSE = "no authority was asked for, so none can pass away"
REQUEST_FIRST = "QS: the onboard device requests authority; a switch or an item gives none"
ACK_DECIDES = "2.2.2.1: the request's own ack says whether authority was obtained"
GRANTED_AND_GONE = "it can only pass away if it was granted: the ack is lost or still to be read"
NOT_ASKED = "an answer to nothing that was sent changes nothing"
GONE_ALREADY = "it passed away before; saying so again is no news"
STILL_OURS = "the item says what is known already"
NEW_REQUEST = "2.2.2.1: after the app took control a new request is needed"
RELEASE_ANY_TIME = "2.2.2.1: a release may be sent at any time; it is how one makes sure"
UNHEARD = "nobody said that it was released: it may be ours, and saying otherwise would be a guess"
MAY_COME_BACK = "QS: the pilot who took it gives it back by going back to F"
RELEASE_PENDING = "2.2.2.1: the ack of the release decides, whatever device holds control meanwhile"
ASK_AGAIN = "2.2.2.1: a request may be sent at any time"
NO_LINE = "without a line nothing is obeyed and nothing is heard"

EXPECTED: dict[tuple[AuthorityState, AuthorityInput], tuple[AuthorityState, str, str]] = {
    (S.NONE, I.OBTAIN): (S.OBTAINING, "", ASK_AGAIN),
    (S.NONE, I.OBTAINED): (S.NONE, "", NOT_ASKED),
    (S.NONE, I.REFUSED): (S.NONE, "", NOT_ASKED),
    (S.NONE, I.RELEASE): (S.RELEASING, "", RELEASE_ANY_TIME),
    (S.NONE, I.RELEASED): (S.NONE, "", NOT_ASKED),
    (S.NONE, I.NOT_RELEASED): (S.NONE, "", NOT_ASKED),
    (S.NONE, I.NOTIFIED): (S.NONE, "", NOTHING_TO_LOSE),
    (S.NONE, I.RC_LEFT_F): (S.NONE, "", NOTHING_TO_LOSE),
    (S.NONE, I.RC_IN_F): (S.NONE, "", REQUEST_FIRST),
    (S.NONE, I.DEVICE_RC): (S.NONE, "", NOTHING_TO_LOSE),
    (S.NONE, I.DEVICE_APP): (S.NONE, "", NOTHING_TO_LOSE),
    (S.NONE, I.DEVICE_ONBOARD): (S.NONE, "", REQUEST_FIRST),
    (S.NONE, I.LINK_LOST): (S.NONE, "", NOTHING_TO_LOSE),
    (S.OBTAINING, I.OBTAIN): (S.OBTAINING, "", "firmware 2.3 and 3.1 want the request twice"),
    (S.OBTAINING, I.OBTAINED): (S.HELD, "", "2.2.2.1: 0x0002, successfully obtained"),
    (S.OBTAINING, I.REFUSED): (S.NONE, "", "2.2.2.1: 0x0003, failed to change"),
    (S.OBTAINING, I.RELEASE): (S.RELEASING, "", RELEASE_ANY_TIME),
    (S.OBTAINING, I.RELEASED): (S.OBTAINING, "", NOT_ASKED),
    (S.OBTAINING, I.NOT_RELEASED): (S.OBTAINING, "", NOT_ASKED),
    (S.OBTAINING, I.NOTIFIED): (S.CONTESTED, "unknown", GRANTED_AND_GONE),
    (S.OBTAINING, I.RC_LEFT_F): (S.CONTESTED, "mode_switch", GRANTED_AND_GONE),
    (S.OBTAINING, I.RC_IN_F): (S.OBTAINING, "", ACK_DECIDES),
    (S.OBTAINING, I.DEVICE_RC): (S.CONTESTED, "mode_switch", GRANTED_AND_GONE),
    (S.OBTAINING, I.DEVICE_APP): (S.OBTAINING, "", ACK_DECIDES),
    (S.OBTAINING, I.DEVICE_ONBOARD): (S.OBTAINING, "", ACK_DECIDES),
    (S.OBTAINING, I.LINK_LOST): (S.LOST, "link", NO_LINE),
    (S.CONTESTED, I.OBTAIN): (
        S.OBTAINING,
        "",
        "a request that is sent after the loss is answered by what holds after it",
    ),
    (S.CONTESTED, I.OBTAINED): (
        S.PAUSED,
        "mode_switch",
        "the ack may be older than the loss: 1.4, a repeated request is answered from memory",
    ),
    (S.CONTESTED, I.REFUSED): (S.NONE, "", "2.2.2.1: 0x0003, failed to change"),
    (S.CONTESTED, I.RELEASE): (S.RELEASING, "", RELEASE_ANY_TIME),
    (S.CONTESTED, I.RELEASED): (S.CONTESTED, "mode_switch", NOT_ASKED),
    (S.CONTESTED, I.NOT_RELEASED): (S.CONTESTED, "mode_switch", NOT_ASKED),
    (S.CONTESTED, I.NOTIFIED): (S.CONTESTED, "mode_switch", GONE_ALREADY),
    (S.CONTESTED, I.RC_LEFT_F): (S.CONTESTED, "mode_switch", GONE_ALREADY),
    (S.CONTESTED, I.RC_IN_F): (
        S.OBTAINING,
        "",
        "QS: back in F the onboard application need not request again",
    ),
    (S.CONTESTED, I.DEVICE_RC): (S.CONTESTED, "mode_switch", GONE_ALREADY),
    (S.CONTESTED, I.DEVICE_APP): (S.CONTESTED, "mode_switch", GONE_ALREADY),
    (S.CONTESTED, I.DEVICE_ONBOARD): (
        S.OBTAINING,
        "",
        "2.2.3.1 CTRL_DEVICE: we have control again",
    ),
    (S.CONTESTED, I.LINK_LOST): (S.LOST, "link", NO_LINE),
    (S.HELD, I.OBTAIN): (S.OBTAINING, "", ASK_AGAIN),
    (S.HELD, I.OBTAINED): (S.HELD, "", NOT_ASKED),
    (S.HELD, I.REFUSED): (S.HELD, "", NOT_ASKED),
    (S.HELD, I.RELEASE): (S.RELEASING, "", RELEASE_ANY_TIME),
    (S.HELD, I.RELEASED): (S.HELD, "", NOT_ASKED),
    (S.HELD, I.NOT_RELEASED): (S.HELD, "", NOT_ASKED),
    (S.HELD, I.NOTIFIED): (
        S.PAUSED,
        "unknown",
        "2.2.3.2: RC or app took it, it does not say which; the pilot is the usual case",
    ),
    (S.HELD, I.RC_LEFT_F): (S.PAUSED, "mode_switch", "QS: out of F, API control is turned off"),
    (S.HELD, I.RC_IN_F): (S.HELD, "", STILL_OURS),
    (S.HELD, I.DEVICE_RC): (S.PAUSED, "mode_switch", "2.2.3.1 CTRL_DEVICE: the RC has control"),
    (S.HELD, I.DEVICE_APP): (
        S.LOST,
        "app",
        "2.2.2.1: the mobile API can interrupt ongoing onboard control",
    ),
    (S.HELD, I.DEVICE_ONBOARD): (S.HELD, "", STILL_OURS),
    (S.HELD, I.LINK_LOST): (S.LOST, "link", NO_LINE),
    (S.PAUSED, I.OBTAIN): (S.OBTAINING, "", ASK_AGAIN),
    (S.PAUSED, I.OBTAINED): (S.PAUSED, "mode_switch", NOT_ASKED),
    (S.PAUSED, I.REFUSED): (S.PAUSED, "mode_switch", NOT_ASKED),
    (S.PAUSED, I.RELEASE): (S.RELEASING, "", RELEASE_ANY_TIME),
    (S.PAUSED, I.RELEASED): (S.PAUSED, "mode_switch", NOT_ASKED),
    (S.PAUSED, I.NOT_RELEASED): (S.PAUSED, "mode_switch", NOT_ASKED),
    (S.PAUSED, I.NOTIFIED): (S.PAUSED, "mode_switch", GONE_ALREADY),
    (S.PAUSED, I.RC_LEFT_F): (S.PAUSED, "mode_switch", GONE_ALREADY),
    (S.PAUSED, I.RC_IN_F): (
        S.HELD,
        "",
        "QS: back in F the onboard application need not request again",
    ),
    (S.PAUSED, I.DEVICE_RC): (S.PAUSED, "mode_switch", GONE_ALREADY),
    (S.PAUSED, I.DEVICE_APP): (S.LOST, "app", "2.2.2.1: the app has it now"),
    (S.PAUSED, I.DEVICE_ONBOARD): (S.HELD, "", "2.2.3.1 CTRL_DEVICE: we have control again"),
    (S.PAUSED, I.LINK_LOST): (S.LOST, "link", NO_LINE),
    (S.LOST, I.OBTAIN): (S.OBTAINING, "", NEW_REQUEST),
    (S.LOST, I.OBTAINED): (S.LOST, "app", NOT_ASKED),
    (S.LOST, I.REFUSED): (S.LOST, "app", NOT_ASKED),
    (S.LOST, I.RELEASE): (S.RELEASING, "", RELEASE_ANY_TIME),
    (S.LOST, I.RELEASED): (S.LOST, "app", NOT_ASKED),
    (S.LOST, I.NOT_RELEASED): (S.LOST, "app", NOT_ASKED),
    (S.LOST, I.NOTIFIED): (S.LOST, "app", GONE_ALREADY),
    (S.LOST, I.RC_LEFT_F): (S.LOST, "app", GONE_ALREADY),
    (S.LOST, I.RC_IN_F): (S.LOST, "app", NEW_REQUEST),
    (S.LOST, I.DEVICE_RC): (S.LOST, "app", GONE_ALREADY),
    (S.LOST, I.DEVICE_APP): (S.LOST, "app", GONE_ALREADY),
    (S.LOST, I.DEVICE_ONBOARD): (S.LOST, "app", NEW_REQUEST),
    (S.LOST, I.LINK_LOST): (S.LOST, "app", GONE_ALREADY),
    (S.RELEASING, I.OBTAIN): (S.RELEASING, "", RELEASE_PENDING),
    (S.RELEASING, I.OBTAINED): (S.RELEASING, "", RELEASE_PENDING),
    (S.RELEASING, I.REFUSED): (S.RELEASING, "", RELEASE_PENDING),
    (S.RELEASING, I.RELEASE): (S.RELEASING, "", "firmware 2.3 and 3.1 want the release twice"),
    (S.RELEASING, I.RELEASED): (S.NONE, "released", "2.2.2.1: 0x0001, successfully released"),
    (S.RELEASING, I.NOT_RELEASED): (S.UNRELEASED, "", UNHEARD),
    (S.RELEASING, I.NOTIFIED): (S.RELEASING, "", RELEASE_PENDING),
    (S.RELEASING, I.RC_LEFT_F): (S.RELEASING, "", RELEASE_PENDING),
    (S.RELEASING, I.RC_IN_F): (S.RELEASING, "", RELEASE_PENDING),
    (S.RELEASING, I.DEVICE_RC): (S.RELEASING, "", RELEASE_PENDING),
    (S.RELEASING, I.DEVICE_APP): (S.RELEASING, "", RELEASE_PENDING),
    (S.RELEASING, I.DEVICE_ONBOARD): (S.RELEASING, "", RELEASE_PENDING),
    (S.RELEASING, I.LINK_LOST): (S.LOST, "link", NO_LINE),
    (S.UNRELEASED, I.OBTAIN): (S.OBTAINING, "", ASK_AGAIN),
    (S.UNRELEASED, I.OBTAINED): (S.UNRELEASED, "", NOT_ASKED),
    (S.UNRELEASED, I.REFUSED): (S.UNRELEASED, "", NOT_ASKED),
    (S.UNRELEASED, I.RELEASE): (S.RELEASING, "", RELEASE_ANY_TIME),
    (S.UNRELEASED, I.RELEASED): (S.UNRELEASED, "", NOT_ASKED),
    (S.UNRELEASED, I.NOT_RELEASED): (S.UNRELEASED, "", NOT_ASKED),
    (S.UNRELEASED, I.NOTIFIED): (S.UNRELEASED, "", MAY_COME_BACK),
    (S.UNRELEASED, I.RC_LEFT_F): (S.UNRELEASED, "", MAY_COME_BACK),
    (S.UNRELEASED, I.RC_IN_F): (S.UNRELEASED, "", UNHEARD),
    (S.UNRELEASED, I.DEVICE_RC): (S.UNRELEASED, "", MAY_COME_BACK),
    (S.UNRELEASED, I.DEVICE_APP): (S.LOST, "app", NEW_REQUEST),
    (S.UNRELEASED, I.DEVICE_ONBOARD): (S.UNRELEASED, "", UNHEARD),
    (S.UNRELEASED, I.LINK_LOST): (S.LOST, "link", NO_LINE),
}

# How a program really comes to each state; a state is nothing that one could set.
WAY_TO: dict[AuthorityState, tuple[AuthorityInput, ...]] = {
    S.NONE: (),
    S.OBTAINING: (I.OBTAIN,),
    S.CONTESTED: (I.OBTAIN, I.RC_LEFT_F),
    S.HELD: (I.OBTAIN, I.OBTAINED),
    S.PAUSED: (I.OBTAIN, I.OBTAINED, I.RC_LEFT_F),
    S.LOST: (I.OBTAIN, I.OBTAINED, I.DEVICE_APP),
    S.RELEASING: (I.OBTAIN, I.OBTAINED, I.RELEASE),
    S.UNRELEASED: (I.OBTAIN, I.OBTAINED, I.RELEASE, I.NOT_RELEASED),
}


class Clock:
    """Seconds, by hand."""

    def __init__(self) -> None:
        self.now = 100.0

    def __call__(self) -> float:
        return self.now


def authority_in(state: AuthorityState, clock: Clock | None = None) -> Authority:
    authority = Authority(clock or Clock())
    for what in WAY_TO[state]:
        authority.feed(what)
    assert authority.state is state
    return authority


@pytest.mark.parametrize("state", S, ids=lambda s: s.name)
@pytest.mark.parametrize("what", I, ids=lambda i: i.name)
def test_each_input_in_each_state_leads_where_the_document_says(
    state: AuthorityState, what: AuthorityInput
) -> None:
    after, reason, why = EXPECTED[state, what]
    authority = authority_in(state)
    changed = authority.feed(what)
    assert authority.state is after, why
    assert authority.reason == reason, why
    assert changed is (after is not state)


def test_every_transition_of_the_code_stands_in_the_expectation() -> None:
    in_code = {(s, i): after for s, row in TRANSITIONS.items() for i, after in row.items()}
    changing = {pair: row[0] for pair, row in EXPECTED.items() if row[0] is not pair[0]}
    assert in_code == changing
    assert set(TRANSITIONS) == set(S)


def test_nothing_but_an_ack_or_the_pilots_return_gives_authority() -> None:
    into_held = {(s, i) for s, row in TRANSITIONS.items() for i, to in row.items() if to is S.HELD}
    assert into_held == {
        (S.OBTAINING, I.OBTAINED),
        (S.PAUSED, I.RC_IN_F),
        (S.PAUSED, I.DEVICE_ONBOARD),
    }


def test_each_change_is_reported_once_and_no_change_is_not() -> None:
    seen: list[tuple[AuthorityState, AuthorityState]] = []
    authority = Authority(Clock())
    unsubscribe = authority.subscribe(lambda before, after: seen.append((before, after)))
    for what in (I.OBTAIN, I.OBTAIN, I.OBTAINED, I.NOTIFIED, I.RC_LEFT_F, I.RC_IN_F, I.RC_IN_F):
        authority.feed(what)
    assert seen == [
        (S.NONE, S.OBTAINING),
        (S.OBTAINING, S.HELD),
        (S.HELD, S.PAUSED),
        (S.PAUSED, S.HELD),
    ]
    unsubscribe()
    unsubscribe()
    authority.feed(I.RELEASE)
    assert len(seen) == 4


def test_a_listener_that_leaves_as_it_is_called_does_not_cost_the_next_its_news() -> None:
    authority = Authority(Clock())
    seen: list[str] = []

    def leave(before: AuthorityState, after: AuthorityState) -> None:
        seen.append("first")
        unsubscribe()

    unsubscribe = authority.subscribe(leave)
    authority.subscribe(lambda before, after: seen.append("second"))
    authority.feed(I.OBTAIN)
    authority.feed(I.OBTAINED)
    assert seen == ["first", "second", "second"]


# -- cross-checks ---------------------------------------------------------------------------------


def rc(mode: RcMode) -> RemoteControl:
    return RemoteControl(0, 0, 0, 0, mode, -4545)


def device(number: int) -> ControlDevice:
    return ControlDevice(number, None)


SETTLING = 0.3


@pytest.mark.parametrize("mode", [RcMode.P, RcMode.A])
def test_a_mode_switch_outside_f_pauses_once_the_items_had_time_to_show_the_grant(
    mode: RcMode,
) -> None:
    clock = Clock()
    authority = authority_in(S.HELD, clock)
    clock.now += SETTLING - 0.01
    authority.observe_remote_control(rc(mode))
    assert authority.state is S.HELD, "made before the grant, perhaps"
    clock.now += 0.02
    authority.observe_remote_control(rc(mode))
    assert (authority.state, authority.reason) == (S.PAUSED, "mode_switch")


def test_a_mode_switch_in_f_gives_no_authority_back_unless_it_was_seen_to_return() -> None:
    """Gains need a change that was seen, losses do not: the app may have it."""
    clock = Clock()
    authority = authority_in(S.HELD, clock)
    authority.feed(I.NOTIFIED)
    clock.now += 10
    for _ in range(3):
        authority.observe_remote_control(rc(RcMode.F))
    assert authority.state is S.PAUSED


def test_a_control_device_that_is_not_ours_pauses_once_it_had_time_to_show_the_grant() -> None:
    clock = Clock()
    authority = authority_in(S.HELD, clock)
    authority.observe_remote_control(rc(RcMode.F))
    authority.observe_control_device(device(0))
    assert authority.state is S.HELD
    clock.now += SETTLING + 0.001
    authority.observe_control_device(device(0))
    # The switch is in F, so it was not the switch.
    assert (authority.state, authority.reason) == (S.PAUSED, "unknown")


def test_levels_are_given_time_anew_after_the_pilot_returned() -> None:
    clock = Clock()
    authority = authority_in(S.HELD, clock)
    clock.now += 5
    for mode in (RcMode.F, RcMode.P, RcMode.F):
        authority.observe_remote_control(rc(mode))
    authority.observe_control_device(device(0))
    assert authority.state is S.HELD
    clock.now += SETTLING + 0.001
    authority.observe_control_device(device(0))
    assert (authority.state, authority.reason) == (S.PAUSED, "unknown")


def test_a_control_device_of_the_time_before_this_request_contests_nothing() -> None:
    authority = authority_in(S.HELD)
    authority.observe_control_device(device(2))
    for what in (I.RELEASE, I.RELEASED, I.OBTAIN):
        authority.feed(what)
    authority.observe_control_device(device(0))
    assert authority.state is S.OBTAINING


def test_a_control_device_that_goes_from_us_to_the_pilot_before_the_ack_contests() -> None:
    authority = authority_in(S.OBTAINING)
    authority.observe_control_device(device(2))
    authority.observe_control_device(device(0))
    assert authority.state is S.CONTESTED
    authority.feed(I.OBTAINED)
    assert (authority.state, authority.reason) == (S.PAUSED, "mode_switch")


def test_what_contested_the_request_is_the_reason_of_the_pause() -> None:
    authority = authority_in(S.OBTAINING)
    authority.feed(I.NOTIFIED)
    assert authority.reason == "unknown"
    authority.observe_control_device(device(1))
    authority.feed(I.OBTAINED)
    assert (authority.state, authority.reason) == (S.PAUSED, "app")


def test_mode_switch_seen_leaving_f_pauses_without_any_notification() -> None:
    authority = authority_in(S.HELD)
    authority.observe_remote_control(rc(RcMode.F))
    authority.observe_remote_control(rc(RcMode.P))
    assert (authority.state, authority.reason) == (S.PAUSED, "mode_switch")


@pytest.mark.parametrize("away", [RcMode.P, RcMode.A])
def test_mode_switch_seen_returning_to_f_gives_authority_back(away: RcMode) -> None:
    authority = authority_in(S.HELD)
    for mode in (RcMode.F, away, RcMode.F):
        authority.observe_remote_control(rc(mode))
    assert (authority.state, authority.reason) == (S.HELD, "")


def test_turning_the_switch_between_p_and_a_is_no_return() -> None:
    authority = authority_in(S.HELD)
    for mode in (RcMode.F, RcMode.P, RcMode.A, RcMode.P):
        authority.observe_remote_control(rc(mode))
    assert authority.state is S.PAUSED


def test_the_mode_switch_gives_the_notification_its_reason() -> None:
    """The notification says nothing, and overtakes the channels by up to 20 ms."""
    authority = authority_in(S.HELD)
    authority.observe_remote_control(rc(RcMode.F))
    authority.feed(I.NOTIFIED)
    assert authority.reason == "unknown"
    authority.observe_remote_control(rc(RcMode.F))  # made before the switch moved
    assert (authority.state, authority.reason) == (S.PAUSED, "unknown")
    authority.observe_remote_control(rc(RcMode.P))
    assert (authority.state, authority.reason) == (S.PAUSED, "mode_switch")


def test_a_switch_outside_f_explains_the_notification_even_if_it_was_never_seen_in_f() -> None:
    authority = authority_in(S.HELD)
    authority.feed(I.NOTIFIED)
    authority.observe_remote_control(rc(RcMode.A))
    assert (authority.state, authority.reason) == (S.PAUSED, "mode_switch")


def test_the_control_device_item_tells_the_app_from_the_pilot() -> None:
    authority = authority_in(S.HELD)
    authority.feed(I.NOTIFIED)
    authority.observe_control_device(device(1))
    assert (authority.state, authority.reason) == (S.LOST, "app")


def test_an_item_made_before_the_grant_takes_nothing_away() -> None:
    authority = authority_in(S.HELD)
    authority.observe_control_device(device(0))
    assert authority.state is S.HELD


def test_control_device_going_from_us_to_the_remote_controller_pauses() -> None:
    authority = authority_in(S.HELD)
    authority.observe_control_device(device(2))
    authority.observe_control_device(device(0))
    assert (authority.state, authority.reason) == (S.PAUSED, "mode_switch")
    authority.observe_control_device(device(2))
    assert authority.state is S.HELD


@pytest.mark.parametrize("number", [3, 4, 5, 6, 7])
def test_a_control_device_that_no_source_lists_changes_nothing(number: int) -> None:
    authority = authority_in(S.HELD)
    authority.observe_control_device(device(2))
    authority.observe_control_device(device(number))
    assert authority.state is S.HELD


def test_the_request_bit_of_later_firmware_does_not_hide_the_device() -> None:
    authority = authority_in(S.HELD)
    authority.observe_control_device(device(0x08 | 1))
    assert (authority.state, authority.reason) == (S.LOST, "app")


# -- whole packages -------------------------------------------------------------------------------


class Pair:
    """An authority that is given packages, and one that is given each of their records."""

    def __init__(self) -> None:
        self.clock = Clock()
        self.watching, self.looking = Authority(self.clock), Authority(self.clock)
        self.told: list[list[tuple[AuthorityState, AuthorityState]]] = [[], []]
        self.watching.subscribe(lambda *change: self.told[0].append(change))
        self.looking.subscribe(lambda *change: self.told[1].append(change))

    def feed(self, what: AuthorityInput) -> None:
        assert self.watching.feed(what) is self.looking.feed(what)

    def observe(self, package: TelemetryPacket) -> None:
        self.watching.observe(package)
        if package.remote_control is not None:
            self.looking.observe_remote_control(package.remote_control)
        if package.control_device is not None:
            self.looking.observe_control_device(package.control_device)

    def check(self, seed: int) -> None:
        assert self.watching.state is self.looking.state, seed
        assert self.watching.reason is self.looking.reason, seed
        assert self.told[0] == self.told[1], seed


# The second reads the mode switch of the same bytes otherwise, which no firmware of DJI does.
FIRMWARES = (
    PROFILES["1.0"],
    dataclasses.replace(
        PROFILES["1.0"],
        name="its own",
        items=dict(PROFILES["1.0"].items)
        | {"rc": ItemLayout("4hHh", PROFILES["1.0"].items["rc"].fields)},
    ),
)


def random_package(dice: random.Random, firmware: FirmwareProfile) -> TelemetryPacket:
    """With and without the watched items, and with more and less around them."""
    items: dict[str, list[float]] = {}
    if dice.random() < 0.5:
        items["quaternion"] = [1, 0, 0, 0]
    if dice.random() < 0.8:
        modes = (8000, 8000, 8000, 57536) if firmware is FIRMWARES[1] else (8000, 8000, 0, -8000)
        items["rc"] = [dice.choice((0, -10000)), 0, 0, 0, dice.choice(modes), -4545]
    if dice.random() < 0.8:
        control: float = dice.choice((0, 0, 1, 2, 2, 2, 0x08 | 2, 0x10, 7))
        items["control_device"] = [control]
    return TelemetryPacket(encode_telemetry(items, firmware), firmware)


@pytest.mark.parametrize("seed", range(60))
def test_packages_are_observed_as_if_each_record_were_looked_at_every_time(seed: int) -> None:
    dice = random.Random(seed)
    pair = Pair()
    firmware = FIRMWARES[0]
    package = random_package(dice, firmware)
    for _ in range(2000):
        match dice.random():
            case chance if chance < 0.02:
                firmware = dice.choice(FIRMWARES)
                package = random_package(dice, firmware)
            case chance if chance < 0.04:
                firmware = dice.choice(FIRMWARES)
                package = TelemetryPacket(package.value, firmware)
            case chance if chance < 0.12:
                pair.feed(dice.choice(list(I)))
            case chance if chance < 0.16:
                pair.feed(I.OBTAIN)
            case chance if chance < 0.2:
                pair.feed(I.OBTAINED)
            case chance if chance < 0.45:
                package = random_package(dice, firmware)
        pair.clock.now += dice.choice((0.0, 0.01, 0.01, 0.1, 0.29, 0.31))
        for _ in range(dice.randint(1, 3)):  # the same once more, as most packages are
            pair.observe(package)
            pair.check(seed)


def test_the_mode_switch_is_found_where_the_firmware_of_the_package_has_it() -> None:
    """The firmware may be known better later; the same flags then stand for other places."""
    first = PROFILES["1.0"]
    wide = ItemLayout("4f4x", first.items["quaternion"].fields)
    later = dataclasses.replace(
        first, name="its own", items=dict(first.items) | {"quaternion": wide}
    )
    authority = Authority()
    authority.feed(I.OBTAIN)
    authority.feed(I.OBTAINED)
    for firmware, mode in ((first, 8000), (later, 8000), (later, 0)):
        assert authority.state is AuthorityState.HELD
        items: dict[str, list[float]] = {
            "quaternion": [1, 0, 0, 0],
            "rc": [0, 0, 0, 0, mode, -4545],
        }
        authority.observe(TelemetryPacket(encode_telemetry(items, firmware), firmware))
    assert authority.state is AuthorityState.PAUSED


@pytest.mark.parametrize("firmware", PROFILES)
def test_a_package_that_says_what_the_last_one_said_is_not_read(
    firmware: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It is most of what a package costs; sticks that move are no news about authority."""
    profile = PROFILES[firmware]
    looks: list[RemoteControl] = []
    observe = Authority.observe_remote_control

    def look(authority: Authority, rc: RemoteControl) -> None:
        looks.append(rc)
        observe(authority, rc)

    monkeypatch.setattr(Authority, "observe_remote_control", look)
    clock = Clock()
    authority = authority_in(S.HELD, clock)
    clock.now += SETTLING + 0.001
    for stick in range(100):
        rc = [stick, -stick, 3 * stick, 0, 8000, -4545][: len(profile.items["rc"].fields)]
        device = [2] * len(profile.items["control_device"].fields)
        value = encode_telemetry({"rc": rc, "control_device": device}, profile)
        authority.observe(TelemetryPacket(value, profile))
    assert 1 <= len(looks) <= 2


# -- waiting --------------------------------------------------------------------------------------


@pytest.mark.anyio
async def test_waiting_for_the_present_state_returns_at_once() -> None:
    await authority_in(S.HELD).wait_for(S.HELD)


@pytest.mark.anyio
async def test_waiting_ends_with_the_change_and_a_cancelled_wait_leaves_nothing_behind() -> None:
    authority = authority_in(S.PAUSED)
    waits = [asyncio.create_task(authority.wait_for(S.HELD)) for _ in range(2)]
    await asyncio.sleep(0)
    waits[0].cancel()
    await asyncio.sleep(0)
    authority.feed(I.RC_IN_F)
    await waits[1]
    assert waits[0].cancelled()
    assert authority._waiters == []
