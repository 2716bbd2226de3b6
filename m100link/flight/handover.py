"""Obtaining and releasing control authority (document 2.2.2.1, errata 24)."""

from __future__ import annotations

import asyncio
import logging
from typing import TYPE_CHECKING

from m100link.errors import (
    AckTimeout,
    AuthorityLost,
    AuthorityRefused,
    LossReason,
    M100Error,
    NotActivated,
)
from m100link.flight.authority import AuthorityInput
from m100link.flight.guards import known
from m100link.protocol.codes import AuthorityCode
from m100link.protocol.commands.control import RequestAuthority
from m100link.protocol.records import Battery, ControlDevice, Device, RemoteControl

if TYPE_CHECKING:
    from m100link.flight.tasks import Commander
    from m100link.protocol.firmware import FirmwareProfile
    from m100link.telemetry.state import AircraftState


_logger = logging.getLogger(__name__)

_PAUSE_S = 0.05  # between requests; DJI's C library waits as long
# DJI's library repeats without an end; here the number is bounded (errata 24).
_MAX_REQUESTS = 10
_RELEASE_DEADLINE_S = 2.0
_RELEASE_TIMEOUT_S = 0.4  # two requests of two tries each fit into the deadline
_EXPLANATION_S = 0.15  # seven RC items, or one or two control device items at 10 Hz
_EXPLANATION_STEP_S = 0.01
_EMPTY_PERCENT = 10  # DJI's level at which an aircraft lands by itself


def _needed(commander: Commander) -> int:
    """How many requests the firmware wants; one that is unknown may be one that wants two."""
    requests = commander.requests
    return requests.firmware.authority_requests if requests.knows_firmware else 2


def _most(commander: Commander) -> int:
    """How often to ask: firmware that wants two requests answers the first "in progress"."""
    return _MAX_REQUESTS if _needed(commander) > 1 else 1


async def _request(commander: Commander, *, obtain: bool, timeout: float = 0.5) -> AuthorityCode:
    return await commander.requests.execute(
        RequestAuthority(obtain=obtain), timeout=timeout, tries=2, refusal=AuthorityRefused
    )


async def _request_release(commander: Commander, *, is_last: bool) -> AuthorityCode:
    """Ask once. Unanswered, it may have arrived all the same: the second is sent nevertheless."""
    try:
        return await _request(commander, obtain=False, timeout=_RELEASE_TIMEOUT_S)
    except AckTimeout:
        if is_last:
            raise
        return AuthorityCode.RELEASING


async def obtain_authority(commander: Commander) -> None:
    """Ask until authority is ours.

    Raises ``AuthorityRefused``: with cause and remedy. Raises ``NotActivated, LevelTooLow,
    KeyRejected, AckTimeout, LinkError``: see each class.
    """
    authority = commander.authority
    code = AuthorityCode.NOT_CHANGED
    try:
        for attempt in range(_most(commander)):
            if attempt:
                await asyncio.sleep(_PAUSE_S)
            # Each anew: the answer says how things are at its request, not at the one before.
            authority.feed(AuthorityInput.OBTAIN)
            code = await _request(commander, obtain=True)
            if code != AuthorityCode.NOT_CHANGED:
                break
        if code == AuthorityCode.OBTAINED:
            authority.feed(AuthorityInput.OBTAINED)
            _logger.info("control authority obtained")
            return
    finally:
        authority.feed(AuthorityInput.REFUSED)  # no news once it was obtained
    raise _refused(commander, code)


def _refused(commander: Commander, code: AuthorityCode) -> AuthorityRefused:
    """The refusal with everything that can be behind it, as far as profile and telemetry tell.

    One code stands for most obstacles (document 2.2.2.1, errata 24, 25).
    """
    state, firmware = commander.state, commander.requests.firmware
    switch = state.situation()["mode_switch"] or "unknown"
    what, obstacles = "", [(code.cause, code.remedy)]
    if code in (AuthorityCode.NOT_IN_F, AuthorityCode.NOT_CHANGED):
        obstacles = _obstacles(state, firmware)
    else:
        what = f": {code.meaning or code.name}"
    return AuthorityRefused(
        f"the aircraft did not give control authority{what} "
        f"(code 0x{code:04X}; mode switch {switch})",
        command=RequestAuthority.NAME,
        code=int(code),
        cause=", or ".join(cause for cause, _ in obstacles if cause),
        remedy="; ".join(remedy for _, remedy in obstacles if remedy),
    )


def _obstacles(state: AircraftState, firmware: FirmwareProfile) -> list[tuple[str, str]]:
    """Obstacles to control by the onboard device, each with its remedy; those seen come first."""
    device = known(state, ControlDevice)
    app = ("the mobile app holds control", "let the mobile app release control")
    if device is not None and device.device is Device.APP:
        return [app]
    found = []
    battery = known(state, Battery)
    if battery is not None and battery.percent <= _EMPTY_PERCENT:
        found.append(
            (f"the battery is at {battery.percent} %, and it may not fly any more", "change it")
        )
    rc = known(state, RemoteControl)
    # Some aircraft's item goes on as it was, in F: then nothing in telemetry tells it.
    off = ("the remote control is off or out of reach", "switch it on, or go nearer")
    if rc is None:
        found.append(("the mode switch is not in F", "move the mode switch to F"))
    elif not rc.is_heard:
        return [off]
    elif not rc.is_in_f:
        found.append(
            (f"the mode switch is in {rc.mode_switch.name}, not in F", "move the mode switch to F")
        )
    if firmware.needs_f_toggle and (rc is None or rc.is_in_f):
        found.append(
            (
                "F stands since power-on and was not chosen anew",
                "move the mode switch out of F and back",
            )
        )
    found += [
        ("API control is not enabled", "tick 'enable API control' in the PC assistant"),
        off,
    ]
    if firmware.ioc_must_be_off and not firmware.authority_refusal_has_reason:
        found.append(("IOC is on", "turn IOC off in the DJI app"))
    if device is None:
        found.append(app)
    if not firmware.needs_f_toggle:
        found.append(
            ("a mission of the app holds control", "move the mode switch to P and back to F")
        )
    return found


async def release_authority(commander: Commander) -> bool:
    """Give authority back; returns whether the aircraft said that it has it.

    Within two seconds, and on a slow line the time that the answers take.
    """
    authority = commander.authority
    authority.feed(AuthorityInput.RELEASE)
    outcome = AuthorityInput.NOT_RELEASED
    try:
        slack = _needed(commander) * commander.link.latency.slack_s
        async with asyncio.timeout(_RELEASE_DEADLINE_S + slack):
            for attempt in range(_most(commander)):
                if attempt:
                    await asyncio.sleep(_PAUSE_S)
                is_last = attempt + 1 >= _needed(commander)
                code = await _request_release(commander, is_last=is_last)
                if code not in (AuthorityCode.NOT_CHANGED, AuthorityCode.RELEASING):
                    break
        if code == AuthorityCode.RELEASED:
            outcome = AuthorityInput.RELEASED
            _logger.info("control authority released")
        else:
            _logger.error("control authority may not be released: code 0x%04X", code)
    except NotActivated:
        outcome = AuthorityInput.RELEASED  # nobody has it before an activation
    except (M100Error, TimeoutError) as error:
        # Not raised: the block ends all the same, and without setpoints the aircraft hovers.
        why = str(error) or "the answers came too late"
        _logger.error("control authority may not be released: %s", why)
    finally:
        authority.feed(outcome)
    return outcome is AuthorityInput.RELEASED


async def explained_loss(commander: Commander, loss: AuthorityLost) -> AuthorityLost:
    """The loss with its reason, as far as the items that follow a notification tell it."""
    # It does not name the taker (document 2.2.3.2), and it overtakes the items that do.
    if loss.reason is not LossReason.UNKNOWN:
        return loss
    authority = commander.authority
    clock = asyncio.get_running_loop().time
    deadline = clock() + _EXPLANATION_S
    while authority.reason is LossReason.UNKNOWN and clock() < deadline:  # noqa: ASYNC110 (15 times)
        await asyncio.sleep(_EXPLANATION_STEP_S)
    if authority.reason not in (LossReason.NONE, LossReason.UNKNOWN):
        return authority_lost(authority.reason, commander.state.remote_control)
    remote_control = commander.state.remote_control
    if remote_control is None or not remote_control.is_in_f:
        return loss
    return AuthorityLost(
        "authority passed away while the mode switch is still in F",
        reason=LossReason.UNKNOWN,
        cause="the mobile app took control, or the aircraft itself: remote controller lost, "
        "API control switched off",
        remedy="ask the pilot; the CTRL_DEVICE item would tell (0 Hz by default, PC assistant)",
    )


def is_unexplained(error: BaseException | None) -> bool:
    """Whether a call of the program met a loss before it could be explained."""
    # The block's cancellation comes a pass of the loop later: a call in that pass meets the loss.
    return isinstance(error, AuthorityLost) and error.reason is LossReason.UNKNOWN


def authority_lost(reason: LossReason, rc: RemoteControl | None = None) -> AuthorityLost:
    """The error for a loss of authority with that reason; ``rc``: the channels at that time."""
    if reason is LossReason.MODE_SWITCH and rc is not None and not rc.is_heard:
        return AuthorityLost(
            "the remote control is not heard any more: all its channels read 0",
            reason=reason,
            cause="it is off or out of reach: then the aircraft goes home by itself",
            remedy="switch it on, or go nearer; then start a new control block",
        )
    meaning, remedy = {
        LossReason.MODE_SWITCH: (
            "the pilot moved the mode switch out of F",
            "the pilot has the aircraft; back in F, start a new control block",
        ),
        LossReason.APP: (
            "the mobile app took control",
            "let the app release control, then start a new control block",
        ),
    }.get(reason, ("the aircraft says that authority passed away", "ask the pilot what happened"))
    return AuthorityLost(meaning, reason=reason, remedy=remedy)
