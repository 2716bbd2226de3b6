"""``m100link fleet show``: look at shows and check them, and let a fleet fly them."""

from __future__ import annotations

import sys
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any

import cyclopts
from cyclopts import Parameter

from m100link.apps.cli.common import err, out, run_async
from m100link.apps.cli.fleet import NO_OPTIONS, FleetOptions
from m100link.apps.cli.options import Above0
from m100link.apps.cli.outcome import ExitCode, print_json
from m100link.apps.cli.plan import File, require_free
from m100link.apps.fleet.show.conductor import Conductor
from m100link.apps.fleet.show.performer import Leave, Stage
from m100link.apps.fleet.show.plan.document import Report, Show, distances, places, svg
from m100link.apps.fleet.show.plan.document import check as report_on
from m100link.apps.fleet.show.plan.track import BadShow
from m100link.errors import UsageError
from m100link.flight.guards import Envelope

app = cyclopts.App(
    name="show",
    help="Formations whose aircraft fly timed tracks: check them, draw them, fly them.",
    version_flags=(),
)


@Parameter(name="*")
@dataclass(frozen=True)
class EnvelopeOptions:
    """How far the agents' guards let each aircraft fly.

    Attributes:
        max_height: Above its take-off point, m.
        max_radius: From its take-off point, m.
        max_speed: Horizontally, m/s; tracks may have four fifths of it.
    """

    max_height: Annotated[float, Above0] = Envelope().max_height_m
    max_radius: Annotated[float, Above0] = Envelope().max_radius_m
    max_speed: Annotated[float, Above0] = Envelope().max_speed_m_s

    @property
    def envelope(self) -> Envelope:
        """As the guards have it."""
        return Envelope(self.max_height, self.max_radius, self.max_speed)


def _read(file: File) -> Show:
    if str(file) == "-":
        return Show.parse(sys.stdin.buffer.read())
    return Show.read(file)


@app.command
def check(
    show: File,
    /,
    *,
    guards: EnvelopeOptions = EnvelopeOptions(),
    json: Annotated[bool | None, Parameter(negative="--table")] = None,
) -> int:
    """Say what is wrong with a show: limits of each aircraft, and who comes too near to whom, when.

    Ends with 0 if it may be flown, with 2 if not.

    Args:
        show: A file of JSON; - is standard input.
        json: One JSON object instead of text; the default when output is not a terminal.
    """
    as_json = (not sys.stdout.isatty()) if json is None else json
    try:
        found = _read(show)
    except BadShow as error:
        if not as_json:
            raise
        print_json({"ok": False, "problems": [_problem(error)]})
        return ExitCode.USAGE
    report = report_on(found, guards.envelope)
    status = ExitCode.OK if report.ok else ExitCode.USAGE
    if as_json:
        print_json(_told(found, report))
        return status
    lines = [f"✗ {one.seen}\n  {one.remedy}" for one in report.problems]
    lines += [f"! {remark}" for remark in report.remarks]
    mark = "✓" if report.ok else "✗"
    lines.append(f"{mark} {len(found.tracks)} aircraft, {found.duration:g} s")
    if (nearest := report.closest) is not None:
        lines.append(
            f"  nearest: {nearest.first} and {nearest.second}, {nearest.distance_m:.2f} m at "
            f"{nearest.at:.2f} s; {nearest.needed_m:.2f} m are needed"
        )
    lines += [f"  {track.name} {track.digest[:16]}" for track in found.tracks]
    _say(lines)
    return status


def _told(show: Show, report: Report) -> dict[str, Any]:
    return {
        "ok": report.ok,
        "problems": [_problem(problem) for problem in report.problems],
        "remarks": list(report.remarks),
        "duration_s": show.duration,
        "closest": None if report.closest is None else asdict(report.closest),
        "tracks": {track.name: track.digest for track in show.tracks},
    }


def _problem(error: BadShow) -> dict[str, Any]:
    return {
        "aircraft": list(error.aircraft),
        "at": error.at,
        "measured": error.measured,
        "limit": error.limit,
        "seen": error.seen,
        "remedy": error.remedy,
    }


def _say(lines: list[str]) -> None:
    for line in lines:
        out.print(line, markup=False, soft_wrap=True)


@app.command
def preview(
    show: File,
    picture: File | None = None,
    /,
    *,
    guards: EnvelopeOptions = EnvelopeOptions(),
    force: bool = False,
) -> int:
    """Draw a show: its tracks from above, and the least distance of any two over time.

    Without a file it is drawn in the terminal. A show that must not be flown is drawn as well; what
    is wrong with it is told on standard error, and it ends with 2.

    Args:
        show: A file of JSON; - is standard input.
        picture: An SVG file to write; - is standard output.
        force: Write over a file that is there.
    """
    found = _read(show)
    report = report_on(found, guards.envelope)
    if picture is None:
        _say(_drawn(found))
    elif str(picture) == "-":
        sys.stdout.write(svg(found, report))
    else:
        require_free(picture, force=force)
        _write(picture, svg(found, report))
    for problem in report.problems:
        sys.stderr.write(f"✗ {problem.seen}\n")
    return ExitCode.OK if report.ok else ExitCode.USAGE


@app.command
def fly(
    show: File,
    /,
    *,
    leave: Leave = "land",
    yes: bool = False,
    guards: EnvelopeOptions = EnvelopeOptions(),
    options: FleetOptions = NO_OPTIONS,
) -> int:
    """Let the aircraft of a fleet fly a show: all take their places, or none begins.

    It is checked first. Whoever leaves its track hovers or lands by itself, is named, and the
    others fly on. Ctrl-C before the beginning lets all of them leave and hover; later it changes
    nothing: m100link fleet stop --all stops them. Ends with 0 if all have flown it to the end.

    Args:
        show: A file of JSON; - is standard input.
        leave: What each does at its end, and when it has to leave: hover or land.
        yes: Do not ask before they take off.
    """
    found = _read(show)
    report = report_on(found, guards.envelope)
    for problem in report.problems:
        err.print(f"✗ {problem.seen}", markup=False, soft_wrap=True)
    if not report.ok:
        raise UsageError("this show is not flown", remedy="m100link fleet show check FILE")
    if not yes:
        _ask(found)

    def tell(text: str) -> None:
        err.print(text, markup=False, soft_wrap=True)

    async def run() -> int:
        async with options.open() as fleet:
            conductor = Conductor(
                fleet.bus,
                options.site,
                options.who,
                found,
                leave=leave,
                sign=options.sign(),
                tell=tell,
            )
            parts = await conductor.fly()
        for part in parts.values():
            stage = "silent" if part.stage is None else part.stage.value
            if options.json_output:
                print_json({"name": part.name, "stage": stage, "why": part.why})
            else:
                words = part.why or f"at most {part.farthest_m:.2f} m from its track"
                out.print(f"{part.name}: {stage}, {words}", markup=False, soft_wrap=True)
        is_flown = all(part.stage is Stage.FLOWN for part in parts.values())
        return ExitCode.OK if is_flown else ExitCode.FAILED

    return run_async(run())


def _ask(show: Show) -> None:
    """Whether they may take off.

    Raises:
        UsageError: Nobody says so.
    """
    names = ", ".join(track.name for track in show.tracks)
    if not sys.stdin.isatty():
        raise UsageError(f"nobody can be asked whether {names} may take off", remedy="--yes")
    if input(f"{names} take off and fly for {show.duration:g} s. Go on? [y/N] ").lower() != "y":
        raise UsageError("nothing was begun")


def _drawn(show: Show) -> list[str]:
    from m100link.apps.cli.display import line_plot, track_plot

    width = max(20, min(out.width, 100))
    samples = places(show)
    # One line through all of them would join the end of a track with the beginning of the next.
    dots = [(place[0], place[1]) for _, there in samples for place in there]
    names = [((t.points[0].north, t.points[0].east), t.name) for t in show.tracks]
    lines = track_plot([], columns=width, rows=min(20, width // 3), marks=names, dots=dots)
    if len(show.tracks) > 1:
        lines += ["", "least distance of any two"]
        lines += line_plot(distances(show), unit="m", columns=width - 10, rows=6)
    return lines


def _write(picture: File, text: str) -> None:
    try:
        Path(picture).write_text(text, encoding="utf-8")
    except OSError as error:
        raise UsageError(
            f"{picture} cannot be written: {error.strerror}", remedy="name another file"
        ) from error
