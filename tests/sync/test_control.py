from __future__ import annotations

import os
import signal
import threading
from collections.abc import Callable

import pytest

from m100link import (
    AuthorityLost,
    AuthorityState,
    Credentials,
    NoAuthority,
    Setpoint,
    TaskProgress,
    sync,
)
from m100link.flight.authority import AuthorityInput

Connect = Callable[[], sync.Aircraft]

NORTH = Setpoint.velocity(north=2.0, east=0.0, up=0.0, yaw_rate_deg_s=0.0)


def activated(connect: Connect) -> sync.Aircraft:
    aircraft = connect()
    aircraft.activate(Credentials(app_id=10086, key=bytes(range(32))))
    return aircraft


def test_a_flight(connect: Connect) -> None:
    aircraft = activated(connect)
    seen: list[TaskProgress] = []
    with aircraft.control() as control:
        control.take_off(progress=seen.append)
        arrival = control.fly_to(north=5.0, east=0.0, up=1.0)
        assert arrival.distance_m < 0.5
        assert repr(control).startswith("<Control flying, authority held")
        control.land()
    assert seen
    assert control.is_over
    assert aircraft.authority.state is AuthorityState.NONE


def test_setpoints_are_repeated_while_this_thread_does_something_else(connect: Connect) -> None:
    aircraft = activated(connect)
    with aircraft.control() as control:
        control.take_off()
        with control.hold(NORTH, lifetime=1.0) as hold:
            for tick in control.ticks(10):
                hold.set(NORTH)
                if tick.elapsed > 2.0:
                    break
        assert control.setpoints_sent > 50
        velocity = aircraft.state.velocity
        assert velocity is not None
        assert velocity.north_m_s > 0.5
        control.stop()


def test_following_asks_in_this_thread(connect: Connect) -> None:
    aircraft = activated(connect)
    threads: set[int] = set()

    def source(tick: object) -> Setpoint | None:
        threads.add(threading.get_ident())
        return NORTH if control.setpoints_sent < 20 else None

    with aircraft.control() as control:
        control.take_off()
        control.follow(source, rate_hz=20, lifetime=1.0)
    assert threads == {threading.get_ident()}


@pytest.mark.parametrize("name", ["hold", "ticks", "hotpoint", "waypoint_mission"])
def test_a_misspelt_argument_is_an_error_of_the_call_and_not_of_its_block(
    connect: Connect, name: str
) -> None:
    with pytest.raises(TypeError):
        getattr(connect().control(), name)(1.0, hight=3.0)


def test_an_error_in_the_block_takes_the_stop_path(connect: Connect) -> None:
    aircraft = activated(connect)
    with pytest.raises(ZeroDivisionError), aircraft.control() as control:
        control.take_off()
        control.send(NORTH, lifetime=1.0)
        raise ZeroDivisionError
    assert control.is_over
    assert aircraft.authority.state is AuthorityState.NONE
    with pytest.raises(NoAuthority):
        control.send(NORTH)


def test_a_lost_authority_is_raised_by_the_call_that_waits(connect: Connect) -> None:
    aircraft = activated(connect)
    with pytest.raises(AuthorityLost), aircraft.control() as control:
        control.take_off()
        lose(aircraft)
        control.fly_to(north=100.0, east=0.0, up=0.0)
    assert control.is_over


def test_a_lost_authority_is_raised_by_the_block_if_no_call_did(connect: Connect) -> None:
    aircraft = activated(connect)
    with pytest.raises(AuthorityLost), aircraft.control() as control:
        lose(aircraft)
        while control.is_flying:
            pass


def lose(aircraft: sync.Aircraft) -> None:
    """As where the pilot leaves F."""
    aircraft._portal.soon(lambda: aircraft.authority.feed(AuthorityInput.RC_LEFT_F))


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_in_the_middle_of_a_call_takes_the_stop_path(
    connect: Connect, number: signal.Signals
) -> None:
    aircraft = activated(connect)
    before = signal.getsignal(number)

    def progress(_: object) -> None:
        os.kill(os.getpid(), number)

    with pytest.raises((KeyboardInterrupt, SystemExit)), aircraft.control() as control:
        control.take_off(progress=progress)
    assert control.is_over
    assert aircraft.authority.state is AuthorityState.NONE
    assert signal.getsignal(number) == before


def test_control_by_hand_at_a_prompt(connect: Connect) -> None:
    aircraft = activated(connect)
    control = aircraft.control().obtain()
    assert control.has_authority
    control.release()
    control.release()
    assert aircraft.authority.state is AuthorityState.NONE
