"""A fleet whose router, agent or pilot is lost in flight hovers, and nothing resumes by itself."""

from __future__ import annotations

import shutil
import signal
import subprocess
import sys

import pytest

pytest.importorskip("zenoh", reason="the extra fleet is not installed")

from tests.attacks.fleet import LOSSES, STILL_M_S, WITHIN_S, Loss, lose
from tests.attacks.fleet_legs import CUTS, Cut

pytestmark = [pytest.mark.anyio, pytest.mark.pty]


@pytest.fixture
def anyio_backend() -> str:
    return "asyncio"


@pytest.mark.parametrize(
    "loss",
    [loss for loss in LOSSES if loss.how is signal.SIGSTOP or loss.who in ("agent", "page")],
    ids=lambda loss: f"{loss.who} {loss.how.name}",
)
async def test_it_hovers_then_does_what_was_configured(loss: Loss) -> None:
    measured = await lose(loss)
    assert measured.still_s < WITHIN_S
    assert (measured.landed_s is not None) is loss.lands
    assert measured.moved_m_s < STILL_M_S


def may_have_a_network() -> bool:
    """Whether this user may make a network of its own, and take an interface of it down."""
    if not (shutil.which("unshare") and shutil.which("ip")):
        return False
    tried = subprocess.run(["unshare", "-n", "true"], check=False, capture_output=True)
    return tried.returncode == 0


@pytest.mark.skipif(not may_have_a_network(), reason="needs a network namespace of its own")
def test_a_cable_that_is_cut_without_a_word_costs_a_hover_and_nothing_resumes() -> None:
    flown = f"ip link set lo up && exec {sys.executable} -m tests.attacks.fleet --cable"
    ended = subprocess.run(
        ["unshare", "-n", "sh", "-c", flown], check=False, capture_output=True, text=True
    )
    assert ended.returncode == 0, ended.stdout + ended.stderr
    assert ended.stdout.startswith("cable   cut      still")


def may_drop_packets() -> str:
    """Why this user may not drop packets in a network of its own; empty if he may."""
    if not may_have_a_network():
        return "needs a network namespace of its own"
    if shutil.which("iptables") is None:
        return "needs iptables"
    rule = "iptables -w -A INPUT -p tcp -d 127.0.0.2 --dport 7 -j DROP"
    tried = subprocess.run(["unshare", "-n", "sh", "-c", rule], check=False, capture_output=True)
    return "" if tried.returncode == 0 else f"iptables: {tried.stderr.decode().strip()}"


@pytest.mark.skipif(bool(may_drop_packets()), reason=may_drop_packets() or "it may")
@pytest.mark.parametrize("cut", CUTS, ids=str)
def test_a_leg_that_is_cut_costs_a_hover_and_every_report_is_true(cut: Cut) -> None:
    flown = f"ip link set lo up && exec {sys.executable} -m tests.attacks.fleet_legs --only '{cut}'"
    ended = subprocess.run(
        ["unshare", "-n", "sh", "-c", flown], check=False, capture_output=True, text=True
    )
    assert ended.returncode == 0, ended.stdout + ended.stderr
    assert ended.stdout.startswith(str(cut))
