"""``m100link sim compare`` and ``fit``: recorded flights against the virtual aircraft."""

from __future__ import annotations

import io
import math
from collections.abc import Callable, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter
from rich.table import Table

from m100link.apps.cli.common import err, out
from m100link.apps.cli.log import cannot_write, new_file, write_new
from m100link.apps.cli.options import OUTPUT
from m100link.apps.cli.terminal import ExitCode, as_json, print_json
from m100link.errors import BadSetpoint, UsageError
from m100link.errors.usage import of_extra
from m100link.log import read
from m100link.log.channels import COMMAND
from m100link.log.ros2 import joy_move
from m100link.protocol.commands.control import Move
from m100link.protocol.records import Attitude, FlightPhase
from m100link.protocol.setpoint import ReceivedMove
from m100link.sim.fit import (
    SIGNALS,
    Fit,
    FlightRecording,
    ReplayedSpans,
    Residual,
    SpanFlight,
    fit,
    residuals,
)
from m100link.sim.vehicle.dynamics import MEASURED, Airframe, read_airframe

# -- what a recording holds ------------------------------------------------------------------------

# M100: firmware 1.0 to 3.1 has these numbers, and DJI's node passes them on.
_IN_THE_AIR = {FlightPhase.TAKING_OFF, FlightPhase.IN_AIR, FlightPhase.LANDING}


def read_recording(path: Path) -> FlightRecording:
    """A flight log, or a bag of ROS 1 with topics of DJI's node.

    Raises:
        UsageError: It cannot be read, or rosbags is missing.
    """
    recording = _read_bag(path) if path.suffix == ".bag" else _read_log(path)
    for one in fields(FlightRecording):
        rows = getattr(recording, one.name)
        if one.name not in ("name", "moves"):
            rows[:] = [row for row in rows if all(map(math.isfinite, row))]
        if one.name != "name":
            rows.sort(key=lambda row: row[0])
    return recording


def _read_log(path: Path) -> FlightRecording:
    flight, recording = read(path), FlightRecording(name=path.stem)
    profile = flight.firmware
    if profile is None:
        raise flight.nameless("record a flight in which the aircraft answers")
    for message in flight.messages(COMMAND):
        content = message.content()
        movement = content.get("movement")
        if content.get("direction") == "tx" and isinstance(movement, dict):
            try:
                move = ReceivedMove.read(Move(**movement), profile)
            except (BadSetpoint, TypeError, ValueError):
                continue  # illegal, as another program may send it: no aircraft flies it
            recording.moves.append((message.at, move))
    for sample in flight.samples():
        at = sample.received_at
        if (attitude := sample.attitude) is not None:
            recording.attitude.append((at, *_angles(attitude)))
        if (velocity := sample.velocity) is not None:
            recording.velocity.append((at, *velocity[:3]))
        if (rates := sample.angular_velocity) is not None:
            recording.rates.append((at, *rates))
        if (acceleration := sample.acceleration) is not None:
            recording.acceleration.append((at, *acceleration))
        if (position := sample.position) is not None:
            recording.height.append((at, position.height_m))
        if (battery := sample.battery) is not None and battery.is_possible:
            recording.battery.append((at, float(battery.percent)))
        if (status := sample.flight_status) is not None:
            recording.flying.append((at, float(status.status in _IN_THE_AIR)))
    return recording


def _angles(attitude: Attitude) -> tuple[float, float, float]:
    angles = attitude.roll_deg, attitude.pitch_deg, attitude.yaw_deg
    return tuple(map(math.radians, angles))  # type: ignore[return-value]  # three


# -- bags of ROS 1 ---------------------------------------------------------------------------------
# Topics are known by their message type and the last part of their name, for people move them to
# other namespaces. DJI's node of 2015-12 to 2017 (dji_sdk 2.3 and 3.1) publishes the axes of the
# wire: north-east-down, forward-right-down, height and vertical velocity up. That of 2017 to 2020
# (3.2 to 3.8) follows REP 103: east-north-up, forward-left-up.


Hear = Callable[[FlightRecording, float, Any], None]


def _flu_enu(q: Any) -> tuple[float, float, float]:
    """Roll, pitch and yaw of the document from a quaternion of REP 103."""
    half = math.sqrt(0.5)
    w, x, y, z = q.w, q.x, q.y, q.z
    return _angles(Attitude((w + z) * half, (x + y) * half, (x - y) * half, (w - z) * half))


def _frd(flu: Any) -> tuple[float, float, float]:
    return flu.x, -flu.y, -flu.z


def _percent(charge: float) -> float:
    # DJI's node says 0 to 100, although ROS defines 0 to 1.
    return charge * 100.0 if charge <= 1.0 else float(charge)


def _hears(**series: Callable[[Any], tuple[float, ...]]) -> Hear:
    """Keep what each function reads of a message, in the series of that name."""

    def hear(recording: FlightRecording, at: float, message: Any) -> None:
        for name, values in series.items():
            getattr(recording, name).append((at, *values(message)))

    return hear


def _hear_joy(flag: int | None) -> Hear:
    def hear(recording: FlightRecording, at: float, message: Any) -> None:
        axes = [float(one) for one in message.axes]
        if len(axes) < (5 if flag is None else 4) or not all(map(math.isfinite, axes)):
            return
        try:
            move = joy_move(int(axes[4]) & 0xFF if flag is None else flag, *axes[:4])
        except BadSetpoint:
            return  # no aircraft flies it
        recording.moves.append((at, move))

    return hear


_TILT_THRUST_RATE = 0x2A  # in the body frame


def _hear_roll_pitch(recording: FlightRecording, at: float, message: Any) -> None:
    """ETHZ's message; its thrust is taken as percent of full thrust."""
    values = message.roll, message.pitch, message.thrust.z, message.yaw_rate
    if all(map(math.isfinite, values)):
        recording.moves.append((at, joy_move(_TILT_THRUST_RATE, *values)))


_JOY = "sensor_msgs/msg/Joy"
_BATTERY = _hears(battery=lambda m: (_percent(m.percentage),))
_HEARD: dict[tuple[str, str | None], Hear] = {
    ("sensor_msgs/msg/Imu", "imu"): _hears(
        attitude=lambda m: _flu_enu(m.orientation),
        rates=lambda m: _frd(m.angular_velocity),
        acceleration=lambda m: _frd(m.linear_acceleration),
    ),
    ("geometry_msgs/msg/QuaternionStamped", "attitude"): _hears(
        attitude=lambda m: _flu_enu(m.quaternion)
    ),
    ("geometry_msgs/msg/Vector3Stamped", "velocity"): _hears(
        velocity=lambda m: (m.vector.y, m.vector.x, m.vector.z)
    ),
    ("std_msgs/msg/Float32", "height_above_takeoff"): _hears(height=lambda m: (m.data,)),
    ("sensor_msgs/msg/BatteryState", "battery_state"): _BATTERY,
    ("std_msgs/msg/UInt8", "flight_status"): _hears(
        flying=lambda m: (float(m.data in _IN_THE_AIR),)
    ),
    (_JOY, "flight_control_setpoint_generic"): _hear_joy(None),
    (_JOY, "flight_control_setpoint_ENUvelocity_yawrate"): _hear_joy(0x49),
    (_JOY, "flight_control_setpoint_ENUposition_yaw"): _hear_joy(0x91),
    (_JOY, "flight_control_setpoint_rollpitch_yawrate_zposition"): _hear_joy(0x1B),
    ("mav_msgs/msg/RollPitchYawrateThrust", None): _hear_roll_pitch,
    ("dji_sdk/msg/AttitudeQuaternion", None): _hears(
        attitude=lambda m: _angles(Attitude(m.q0, m.q1, m.q2, m.q3)),
        rates=lambda m: (m.wx, m.wy, m.wz),
    ),
    ("dji_sdk/msg/Velocity", None): _hears(velocity=lambda m: (m.vx, m.vy, m.vz)),
    ("dji_sdk/msg/Acceleration", None): _hears(acceleration=lambda m: (m.ax, m.ay, m.az)),
    ("dji_sdk/msg/GlobalPosition", None): _hears(height=lambda m: (m.height,)),
    ("dji_sdk/msg/PowerStatus", None): _BATTERY,
}


def _hearer(kind: str, topic: str) -> Hear | None:
    last = topic.rpartition("/")[2]
    return _HEARD.get((kind, last)) or _HEARD.get((kind, None))


def _read_bag(path: Path) -> FlightRecording:
    rosbags, rosbag1, serde = (
        of_extra(f"rosbags.{name}", "a bag of ROS 1", "analysis")
        for name in ("highlevel", "rosbag1", "serde")
    )
    recording = FlightRecording(name=path.stem)
    errors = rosbags.AnyReaderError, rosbag1.ReaderError, serde.SerdeError, OSError, ValueError
    try:
        with rosbags.AnyReader([path]) as bag:
            heard = {one.id: _hearer(one.msgtype, one.topic) for one in bag.connections}
            chosen = [one for one in bag.connections if heard[one.id] is not None]
            for one, at_ns, data in bag.messages(chosen) if chosen else ():
                hear = heard[one.id]
                assert hear is not None
                at = (at_ns - bag.start_time) / 1e9
                hear(recording, at, bag.deserialize(data, one.msgtype))
    except errors as error:
        raise UsageError(
            f"{path} cannot be read: {error}",
            cause="it is no bag of ROS 1, or it is damaged",
            remedy="name a bag of ROS 1 or a flight log; `rosbag reindex` may mend a bag",
        ) from error
    return recording


# -- the verbs -------------------------------------------------------------------------------------

Recorded = Annotated[
    Path,
    Parameter(help="Flight logs, and bags of ROS 1 (.bag) with the topics of DJI's node."),
]
Start = Annotated[
    str,
    Parameter(
        name="--airframe",
        help="How it flies: document, measured-3.1.10, or a file of `m100link sim fit`.",
    ),
]
Plot = Annotated[Path | None, Parameter(help="Draw both flights into a new PNG file.")]


def compare(*recording: Recorded, airframe: Start = MEASURED, plot: Plot = None) -> int:
    """Fly the commands of recorded flights on the virtual aircraft, and print how far it is off.

    Each flight begins in its recorded state. Columns: root of the mean square of the difference,
    standard deviation of the recorded signal, correlation, and how much later the recorded signal
    is.
    """
    flown = read_airframe(airframe)
    found = [_flights(path, flown) for path in _named(recording)]
    if plot is not None:
        write_new(plot, _drawn(found))
    if as_json():
        for name, flights in found:
            print_json(_told(name, airframe, residuals(flights)))
        return ExitCode.OK
    for name, flights in found:
        _print_residuals(f"{name}: {_length(flights)}", {airframe: residuals(flights)})
    return ExitCode.OK


def fit_recordings(
    *recording: Recorded,
    airframe: Start = MEASURED,
    check: tuple[Path, ...] = (),
    output: Annotated[Path | None, OUTPUT] = None,
    plot: Plot = None,
) -> int:
    """Find the airframe that flies the commands of recorded flights most nearly as they were flown.

    A constant that no command of the recordings shows stays as it is. Fly with the file:
    `m100link sim --airframe FILE`.

    Args:
        check: Recordings that are not fitted: how far off is the airframe there? Repeatable.
        output: Write the airframe into a new TOML file.
    """
    for one in (output, plot):
        if one is not None and one.exists():  # before minutes of work, not behind it
            raise cannot_write(one, FileExistsError())
    begin = read_airframe(airframe)
    checked = [read_recording(path) for path in check]
    recordings = [read_recording(path) for path in _named(recording)]
    with err.status("reading") as status:
        found = fit(ReplayedSpans(recordings), begin, lambda text: status.update(f"fitting {text}"))
    flights = [(one.name, ReplayedSpans([one]).fly(found.airframe)) for one in recordings]
    flights += [
        (f"{one.name}, not fitted", ReplayedSpans([one]).fly(found.airframe)) for one in checked
    ]
    if plot is not None:
        write_new(plot, _drawn(flights))
    if output is not None:
        with new_file(output) as stream:
            stream.write(_toml(found, airframe, flights).encode())
    if as_json():
        constants = {one.name: one._asdict() for one in found.found}
        shown = [_told(name, "fitted", residuals(each)) for name, each in flights]
        print_json({"constants": constants, "residuals": shown})
        return ExitCode.OK
    _print_constants(found, airframe)
    started = [(one.name, ReplayedSpans([one]).fly(begin)) for one in (*recordings, *checked)]
    for (name, after), (_, before) in zip(flights, started, strict=True):
        both = {airframe: residuals(before), "fitted": residuals(after)}
        _print_residuals(f"{name}: {_length(after)}", both)
    if output is not None:
        out.print(f"airframe in {output}", soft_wrap=True)
    return ExitCode.OK


def _named(recording: Sequence[Path]) -> Sequence[Path]:
    if not recording:
        raise UsageError("no recording was named", remedy="name a flight log or a bag of ROS 1")
    return recording


def _flights(path: Path, airframe: Airframe) -> tuple[str, list[SpanFlight]]:
    recording = read_recording(path)
    return recording.name, ReplayedSpans([recording]).fly(airframe)


def _length(flights: Sequence[SpanFlight]) -> str:
    seconds = sum(len(one.flown) for one in flights) / 100.0
    return f"{seconds:.1f} s in {len(flights)} flight{'s' if len(flights) > 1 else ''}"


def _told(name: str, airframe: str, found: Sequence[Residual]) -> dict[str, Any]:
    rows = [
        {key: None if value != value else value for key, value in one._asdict().items()}
        for one in found
    ]
    return {"recording": name, "airframe": airframe, "signals": rows}


def _print_constants(found: Fit, start: str) -> None:
    table = Table(box=None, pad_edge=False)
    table.add_column("")
    for title in (start, "fitted", "±"):
        table.add_column(title, justify="right")
    for one in found.found:
        table.add_row(one.name, f"{one.before:.4g}", f"{one.value:.4g}", f"{one.error:.2g}")
    out.print(table)


def _print_residuals(title: str, found: dict[str, list[Residual]]) -> None:
    """The rms by each airframe, and all else by the last."""
    table = Table(box=None, pad_edge=False, title=title, title_justify="left")
    table.add_column("")
    for column in (*(f"rms, {name}" for name in found), "of", "correlation", "delay"):
        table.add_column(column, justify="right", no_wrap=True)
    for rows in zip(*found.values(), strict=True):
        last = rows[-1]
        table.add_row(
            last.signal,
            *(f"{one.rms:.3f} {one.unit}" for one in rows),
            f"{last.deviation:.2f}",
            f"{last.correlation:.3f}",
            f"{last.delay_s:+z.2f} s",
        )
    out.print(table)


def _toml(found: Fit, start: str, flights: Sequence[tuple[str, list[SpanFlight]]]) -> str:
    """The airframe as a file, with the source of each number."""
    errors = {one.name: one.error for one in found.found}
    lines = ["# An airframe of the virtual Matrice 100: m100link sim --airframe FILE"]
    for name, each in flights:
        parts = [f"{one.signal} {one.rms:.2g} {one.unit}" for one in residuals(each)]
        lines.append(f"# {name}: rms {', '.join(parts)}")
    for one in fields(Airframe):
        value = getattr(found.airframe, one.name)
        known = f"fitted, ± {errors[one.name]:.2g}" if one.name in errors else f"as in {start}"
        lines.append(f"{one.name} = {value:.5g}  # {known}")
    return "\n".join(lines).replace("\r", " ") + "\n"


def _drawn(found: Sequence[tuple[str, list[SpanFlight]]]) -> bytes:
    """Each signal as recorded and as flown, a column for each recording."""
    figures = of_extra("matplotlib.figure", "a picture", "analysis")
    figure = figures.Figure(figsize=(12 * len(found), 12), layout="constrained", dpi=100)
    grid = figure.subplots(len(SIGNALS), len(found), squeeze=False, sharex="col")
    for column, (name, flights) in enumerate(found):
        for place, (signal, unit) in enumerate(SIGNALS.items()):
            axes = grid[place][column]
            for number, one in enumerate(flights):
                for rows, colour, label in (
                    (one.recorded, "#667", "recorded"),
                    (one.flown, "#d64545", "virtual"),
                ):
                    values, named = [row[place] for row in rows], None if number else label
                    axes.plot(one.times, values, color=colour, lw=1.0, label=named)
            axes.set_ylabel(f"{signal}, {unit}")
            axes.grid(alpha=0.3)
        grid[0][column].set_title(name, parse_math=False)
        grid[0][column].legend(loc="upper right")
        grid[-1][column].set_xlabel("s")
    drawn_into = io.BytesIO()
    figure.savefig(drawn_into, format="png")
    return drawn_into.getvalue()
