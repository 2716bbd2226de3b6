"""``m100link fleet show``: look at shows, and check them. No aircraft is needed."""

from __future__ import annotations

import sys
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any

import cyclopts
from cyclopts import Parameter

from m100link.cli.options import Above0
from m100link.cli.outcome import ExitCode, print_json
from m100link.cli.plan import File, require_free
from m100link.errors import UsageError
from m100link.fleet.show import checks
from m100link.fleet.show.document import Show
from m100link.fleet.show.picture import svg
from m100link.fleet.show.track import BadShow
from m100link.flight.guards import Envelope

__all__ = ["app"]

app = cyclopts.App(
    name="show",
    help="Check formations whose aircraft fly timed tracks, and draw them; no aircraft is needed.",
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
        guards: What each aircraft may fly.
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
    report = checks.check(found, guards.envelope)
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


def _told(show: Show, report: checks.Report) -> dict[str, Any]:
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
    from m100link.cli.common import out

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
        guards: What each aircraft may fly.
        force: Write over a file that is there.
    """
    found = _read(show)
    report = checks.check(found, guards.envelope)
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


def _drawn(show: Show) -> list[str]:
    from m100link.cli.canvas import line_plot, track_plot
    from m100link.cli.common import out

    width = max(20, min(out.width, 100))
    samples = checks.places(show)
    # One line through all of them would join the end of a track with the beginning of the next.
    dots = [(place[0], place[1]) for _, there in samples for place in there]
    names = [((t.points[0].north, t.points[0].east), t.name) for t in show.tracks]
    lines = track_plot([], columns=width, rows=min(20, width // 3), marks=names, dots=dots)
    if len(show.tracks) > 1:
        lines += ["", "least distance of any two"]
        lines += line_plot(checks.distances(show), unit="m", columns=width - 10, rows=6)
    return lines


def _write(picture: File, text: str) -> None:
    try:
        Path(picture).write_text(text, encoding="utf-8")
    except OSError as error:
        raise UsageError(
            f"{picture} cannot be written: {error.strerror}", remedy="name another file"
        ) from error
