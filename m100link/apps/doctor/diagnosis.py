"""All stages, in order, until one fails."""

from __future__ import annotations

import asyncio
import math
from collections.abc import AsyncGenerator, Callable
from contextlib import aclosing
from dataclasses import replace

from m100link.aircraft import Aircraft, connect
from m100link.apps.doctor.line import look_at_line
from m100link.apps.doctor.machine import Machine
from m100link.apps.doctor.port import (
    Finding,
    Report,
    Stage,
    Verdict,
    failed,
    look_at_latency,
    look_at_port,
)
from m100link.errors import (
    AckTimeout,
    AuthorityError,
    AuthorityRefused,
    CommandRefused,
    KeyRejected,
    LinkError,
    M100Error,
    NoAircraft,
    NotActivated,
    UsageError,
)
from m100link.flight.tasks import stands
from m100link.link import Latency
from m100link.link.requests import LONGEST_S
from m100link.link.url import parse_url
from m100link.protocol.codes import ActivationCode, AuthorityCode
from m100link.protocol.commands.activation import Credentials, GetVersion, Version
from m100link.protocol.firmware import PROFILES, FirmwareProfile
from m100link.protocol.items import BY_RECORD
from m100link.protocol.records import (
    AccelerationMode,
    AngularVelocity,
    Attitude,
    ControlDevice,
    Device,
    RcMode,
    RemoteControl,
)
from m100link.telemetry.sample import Sample
from m100link.telemetry.subscription import Newest, Subscription


async def diagnose(
    url: str,
    *,
    credentials: Credentials | None = None,
    firmware: str | FirmwareProfile | None = None,
    baud_rate: int | None = None,
    acceleration: str | None = None,
    authority: bool = False,
    tell: Callable[[Finding], object] = lambda _: None,
    machine: Machine | None = None,
) -> Report:
    """Find out why a line is silent, stage by stage; the first that fails ends it.

    Nothing moves: commands that it sends are version queries, the activation if credentials are
    given, and a request for control authority, with its release, if that is wanted.

    Args:
        url: Where the aircraft is, as :func:`m100link.connect` takes it.
        credentials: App id and key: the aircraft is activated for them, as by every program.
        firmware: Force a firmware profile.
        baud_rate: Rate when the URL has none; 230400 by default.
        acceleration: Force a mode of acceleration, as :func:`m100link.connect` takes it.
        authority: Obtain control authority for a moment, when all else is right and the aircraft
            stands on the ground with its motors off.
        tell: Gets each finding at once.
        machine: The machine that has the port.

    Raises:
        BadURL: Not a connection string.
    """
    address = parse_url(url, baud_rate=baud_rate)
    is_serial = address.scheme == "serial"

    async def look() -> AsyncGenerator[Finding, None]:
        if is_serial:
            here = machine or Machine()
            for finding in look_at_port(address.target, here):
                yield finding
            yield look_at_latency(address.target, here)
        for finding in await look_at_line(address):
            yield finding
        talk = look_at_aircraft(
            url,
            baud_rate=address.number if is_serial else None,
            firmware=firmware,
            credentials=credentials,
            acceleration=acceleration,
            authority=authority,
        )
        async with aclosing(talk):
            async for finding in talk:
                yield finding

    findings = []
    async with aclosing(look()) as stages:
        async for found in stages:
            to_do = (one.replace(" PORT", f" {address}") for one in found.commands)
            finding = replace(found, commands=tuple(to_do))
            findings.append(finding)
            tell(finding)
            if finding.verdict is Verdict.FAILED:
                break
    return Report(str(address), tuple(findings))


# -- the stages at which the aircraft is spoken to: version, activation, key, switch, authority ----


TELEMETRY_S = 1.1
"""Seconds in which an item at 1 Hz, the slowest rate, comes."""

_ACTIVATION_S = 20.0
_MANY_MISMATCHES = 3
_TURNED_DEG = 10.0  # from which on an attitude turns
_ACCELERATION_S = 4.0  # more, in which an aircraft at rest shows its mode at any rate
_NOT_IN_F = (AuthorityCode.NOT_IN_F, AuthorityCode.NOT_CHANGED)


async def look_at_aircraft(
    url: str,
    *,
    baud_rate: int | None,
    firmware: str | FirmwareProfile | None,
    credentials: Credentials | None,
    acceleration: str | None,
    authority: bool,
) -> AsyncGenerator[Finding, None]:
    """Connect and ask, stage by stage; to be closed at the first failure.

    Raises:
        UsageError: The request cannot be fulfilled: that is no matter of the aircraft.
    """
    try:
        aircraft = await connect(
            url, firmware=firmware, baud_rate=baud_rate, acceleration=acceleration
        )
    except UsageError:
        raise
    except NoAircraft as error:
        yield (_no_answer(error) if error.frames_received else _fell_silent(Stage.VERSION, error))
        return
    except M100Error as error:
        yield failed(Stage.VERSION, error)
        return
    stage = Stage.VERSION
    turns = aircraft.telemetry(Attitude, AngularVelocity, policy=Newest(2000))
    try:
        await asyncio.sleep(TELEMETRY_S)
        version = await aircraft.version()
        yield _version(version, aircraft.link.latency)
        yield _firmware(aircraft, version, is_forced=firmware is not None)
        found = await _acceleration(aircraft)
        async with turns:
            yield _at_rest(turns) or found
        stage = Stage.ACTIVATION
        yield await _activation(aircraft, version, credentials)
        stage = Stage.KEY
        yield await _key(aircraft, credentials)
        yield _mode_switch(aircraft)
        stage = Stage.AUTHORITY
        yield await _authority(aircraft, credentials, authority=authority)
    except LinkError as error:
        yield failed(stage, error, "dmesg | tail")
    except AckTimeout as error:
        yield await _unanswered(stage, aircraft, error)
    except M100Error as error:
        yield failed(stage, error, "m100link info PORT shows the counters of the line")
    finally:
        await aircraft.aclose()


def _no_answer(error: NoAircraft) -> Finding:
    return Stage.VERSION.failed(
        error.seen,
        (
            "the wire from our TX to the aircraft's RX carries nothing: it hears no question",
            "another computer on the second UART_CAN2 socket, where only one may talk",
            f"a line whose answers take longer than {LONGEST_S:g} s",
            "an aircraft that does not speak this protocol: A3, N3 and later ones",
        ),
        (
            "check that wire, from the adapter's TX to the aircraft's RX",
            "unplug what is on the other UART_CAN2 socket",
        ),
        {"bytes": error.bytes_received, "frames": error.frames_received},
        error,
    )


def _fell_silent(stage: Stage, error: M100Error) -> Finding:
    return stage.failed(
        f"the aircraft has fallen silent while it was looked at: {error.seen}",
        ("it was switched off, or restarts", "a wire or plug with a bad contact"),
        ("check its power, the plugs and the cable, and run this again",),
        error=error,
    )


async def _unanswered(stage: Stage, aircraft: Aircraft, error: AckTimeout) -> Finding:
    """The aircraft was heard before, and a request of this program has no answer."""
    before = aircraft.statistics().bytes_received
    await asyncio.sleep(TELEMETRY_S)
    counted = aircraft.statistics()
    if counted.bytes_received == before:
        return _fell_silent(stage, error)
    return stage.failed(
        f"{error.seen}; the aircraft is heard, and has answered {counted.acks} of "
        f"{counted.acks + counted.expired} requests",
        (
            "frames are lost on the way: noise, a half-duplex radio, a bad contact",
            f"the answers take longer than this program waits; {aircraft.link.latency}",
        ),
        (
            "check plugs and ground wire; lower the telemetry rates in the PC assistant",
            "m100link info PORT shows the counters of the line",
        ),
        {"acks": counted.acks, "repeats": counted.repeats, "late_acks": counted.late_acks},
        error,
    )


def _version(version: Version, latency: Latency) -> Finding:
    details = {
        "version": version.name,
        "crc_matches": version.crc_matches,
        "round_trip_s": latency.round_trip_s,
    }
    if latency.is_slow:
        return Stage.VERSION.doubtful(
            f"{version.name}; {latency}",
            ("a mobile network, a serial server or a radio is on the way",),
            ("what flies at which latency: m100link docs silent-line",),
            details,
        )
    if version.crc_matches:
        return Stage.VERSION.good(version.name, details=details)
    return Stage.VERSION.doubtful(
        f"{version.name!r}, whose own checksum is another",
        ("a firmware that computes it in another way; nothing follows from it",),
        details=details,
    )


def _firmware(aircraft: Aircraft, version: Version, *, is_forced: bool) -> Finding:
    profile, mismatches = aircraft.firmware, aircraft.telemetry_mismatches
    details = {"firmware": profile.name, "mismatches": mismatches, "forced": is_forced}
    if mismatches >= _MANY_MISMATCHES:
        causes = (
            ("another firmware than the one that was forced",)
            if is_forced
            else ("a firmware whose version text is like that of another",)
        )
        return Stage.FIRMWARE.failed(
            f"{mismatches} packages of telemetry do not fit firmware {profile.name}",
            causes,
            ("leave --firmware out",)
            if is_forced
            else tuple(
                f"m100link doctor PORT --firmware {name}"
                for name in PROFILES
                if name != profile.name
            ),
            details,
        )
    if version.profile is None and not is_forced:
        return Stage.FIRMWARE.doubtful(
            f"the version {version.name!r} is not known: telemetry is read as {profile.name}, and "
            "nothing is flown",
            ("a firmware that nobody has tried with this library",),
            (f"if you know that it fits: --firmware {profile.name}",),
            details,
        )
    return Stage.FIRMWARE.good(
        f"{profile.name}{' (forced)' if is_forced else ''}: {profile.summary}", details=details
    )


async def _acceleration(aircraft: Aircraft) -> Finding:
    """Raw or fused, as the values at rest show."""
    reader = aircraft._telemetry.acceleration
    stage, waited = Stage.ACCELERATION, 0.0
    while reader.has_arrived and reader.seen is None and waited < _ACCELERATION_S:
        await asyncio.sleep(TELEMETRY_S)
        waited += TELEMETRY_S
    mode, seen = reader.mode, reader.seen
    details = {"mode": mode, "seen": seen}
    if not reader.has_arrived:
        return stage.skipped("the telemetry item acceleration does not arrive: nobody knows")
    if mode is None:
        return stage.doubtful(
            "it is neither that of a raw nor that of a fused value at rest: programs get none",
            ("the aircraft was moved meanwhile, or hangs askew by more than 45°",),
            (
                "keep it still for a few seconds, and run this again",
                "if you know how the PC assistant is set: --acceleration raw, or fused",
            ),
            details,
        )
    if seen is not None and seen is not mode:
        return stage.doubtful(
            f"it is read as {mode}, and its values at rest are {seen}",
            ("the PC assistant is set otherwise than --acceleration or the configuration says",),
            ("leave the acceleration out there, or change it in the PC assistant",),
            details,
        )
    words = {
        AccelerationMode.FUSED: "fused: ground axes, m/s²",
        AccelerationMode.RAW: "raw: body axes, in g, with gravity; m100link converts it",
    }
    return stage.good(words[mode] + ("" if seen else "; forced, and not at rest"), details=details)


def _at_rest(turns: Subscription[Sample]) -> Finding | None:
    """An IMU that does not feel that the attitude moves: the PC assistant's simulator flies it."""
    first: Attitude | None = None
    turned = felt = at = 0.0  # degrees; seconds
    while (sample := turns.get_nowait()) is not None:
        attitude, rate = sample.get(Attitude), sample.get(AngularVelocity)
        if attitude is not None:
            first = first or attitude
            product = abs(sum(a * b for a, b in zip(first, attitude, strict=True)))
            turned = max(turned, 2 * math.degrees(math.acos(min(1.0, product))))
        if rate is not None:
            felt += math.degrees(math.hypot(*rate)) * (sample.received_at - at if at else 0.0)
            at = sample.received_at
    if not at or turned < _TURNED_DEG or felt > turned / 2:
        return None
    return Stage.ACCELERATION.doubtful(
        f"the attitude turned by {turned:.0f}°, of which the gyro felt {felt:.0f}°",
        (
            "the PC assistant's simulator flies it on the desk: IMU values are those of the desk",
            "the telemetry item angular_velocity is broken",
        ),
        ("read attitude, velocity and position there, and no IMU: m100link docs simulator-limits",),
        {"turned_deg": turned, "felt_deg": felt},
    )


async def _activation(
    aircraft: Aircraft, version: Version, credentials: Credentials | None
) -> Finding:
    if credentials is not None:
        try:
            await aircraft.activate(
                credentials, timeout=_ACTIVATION_S + 2 * aircraft.link.latency.slack_s
            )
        except CommandRefused as error:
            # Whose app it is belongs into no report.
            found = failed(Stage.ACTIVATION, error)
            if error.code == ActivationCode.NEW_DEVICE:
                found = _asks_for_ever(error)
            return replace(found, seen=found.seen.replace(f" of app {credentials.app_id}", ""))
        return Stage.ACTIVATION.good("for the app that was given")
    if version.is_activated:
        return Stage.ACTIVATION.good("for some app, by an earlier program")
    return Stage.ACTIVATION.failed(
        "it is not activated: telemetry comes, and no command is obeyed",
        ("nobody activated it since it was switched on",),
        ("m100link activate PORT --app-id ID --key-file FILE", "m100link docs activate"),
    )


def _asks_for_ever(error: CommandRefused) -> Finding:
    """Code 3 to the end: DJI's server is reached through the phone, by its account."""
    return Stage.ACTIVATION.failed(
        f"{error.seen}; so for {_ACTIVATION_S:g} s, and a first activation takes a few",
        (
            "the phone at the remote control has no internet",
            "nobody is logged in to a DJI account in the app, or the account is not the app id's",
            "the app was opened before the aircraft was switched on",
        ),
        (
            "open a web page on the phone; log in to the app, and open it anew; run this again",
            "m100link docs activate",
        ),
        {"code": error.code},
        error,
    )


async def _key(aircraft: Aircraft, credentials: Credentials | None) -> Finding:
    """An encrypted version query: harmless, and answered if the aircraft can read it."""
    if credentials is None:
        return Stage.KEY.skipped("no app id and key were given")
    try:
        await aircraft.execute(GetVersion(), encrypted=True, tries=2)
    except KeyRejected as error:
        return Stage.KEY.doubtful(
            "an encrypted version query got no usable answer, a plain one did",
            (
                "the key is not the one that is registered for this app id",
                "a firmware that answers no version query that is encrypted",
            ),
            (
                "compare the key file with the enc key of the app at developer.dji.com",
                "for certainty: run this again with --authority",
            ),
            error=error,
        )
    return Stage.KEY.good("it reads what is encrypted with it")


def _mode_switch(aircraft: Aircraft) -> Finding:
    rc = aircraft.state.fresh(RemoteControl)
    if rc is None:
        return Finding(
            Stage.MODE_SWITCH,
            Verdict.SKIPPED,
            f"the telemetry item {BY_RECORD[RemoteControl].name} does not arrive: nobody knows",
            ("its telemetry rate is 0, or the remote control is off",),
            ("set it in the PC assistant",),
        )
    if not rc.is_heard:
        return Stage.MODE_SWITCH.failed(
            "the remote control is not heard: all its channels read 0",
            ("it is off or out of reach",),
            ("switch it on, and run this again",),
        )
    if rc.is_in_f:
        return Stage.MODE_SWITCH.good("F", details={"mode": rc.mode})
    return Stage.MODE_SWITCH.failed(
        f"it is in {rc.mode_switch.name}, where nobody but the pilot flies",
        (f"the mode switch of the remote control stands in {rc.mode_switch.name}",),
        (f"put it to {RcMode.F.name}",),
        {"mode": rc.mode},
    )


async def _authority(
    aircraft: Aircraft, credentials: Credentials | None, *, authority: bool
) -> Finding:
    if credentials is None:
        return _not_asked("no app id and key were given")
    if not await stands(aircraft.state):
        return _not_asked("it is not seen standing on the ground with its motors off")
    if not authority:
        return _not_asked("it was not to be tried", may_be=True)
    try:
        async with aircraft.control():
            pass
    except AuthorityRefused as error:
        return _refused(aircraft, error)
    except (AuthorityError, KeyRejected, NotActivated) as error:
        return failed(Stage.AUTHORITY, error)
    return Stage.AUTHORITY.good("obtained, and given back at once")


def _refused(aircraft: Aircraft, error: AuthorityRefused) -> Finding:
    """With the switch in F, the code that speaks of it has other causes."""
    rc = aircraft.state.fresh(RemoteControl)
    if rc is None or not rc.is_in_f or error.code not in _NOT_IN_F:
        return failed(Stage.AUTHORITY, error)
    holder = aircraft.state.fresh(ControlDevice)
    if holder is not None and holder.device is Device.APP:
        return Stage.AUTHORITY.failed(
            f"{error.seen}; the mobile app controls the aircraft",
            ("the mobile app holds control",),
            ("let the mobile app release control, and run this again",),
            {"code": error.code},
            error,
        )
    if error.code == AuthorityCode.NOT_CHANGED and aircraft.firmware.authority_requests > 1:
        return Stage.AUTHORITY.failed(
            f"{error.seen}; the switch is in F, and it goes on being in progress",
            ("the app has flown a mission or holds control, and the switch was not in P since",),
            ("put the mode switch to P and back to F, and run this again",),
            {"code": error.code},
            error,
        )
    return Stage.AUTHORITY.failed(
        f"{error.seen}; the switch is in F",
        (
            "API control is not enabled in the PC assistant",
            "the switch was in F when the aircraft was switched on",
            "the mobile app holds control",
            "the remote control is switched off, or out of its range",
        ),
        (
            "tick 'enable API control' in the PC assistant",
            "move the mode switch out of F and back, and run this again",
            "let the mobile app release control",
        ),
        {"code": error.code},
        error,
    )


def _not_asked(why: str, *, may_be: bool = False) -> Finding:
    return Stage.AUTHORITY.skipped(why, details={"may_be_tried": may_be})
