"""The findings of a diagnosis: a stage, its observation, and the remedy."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum, StrEnum
from typing import Any

from m100link.errors import M100Error

Lines = tuple[str, ...]
Details = Mapping[str, Any]


class Stage(Enum):
    """The stages of a diagnosis: conditions, in the order in which they are looked at."""

    PORT = "the port exists"
    PERMISSION = "it may be opened"
    OWNER = "nobody else uses it"
    INTERFERENCE = "no console, no ModemManager"
    LATENCY = "the adapter delivers at once"
    OPENING = "it opens"
    BYTES = "bytes arrive"
    FRAMES = "they are frames"
    TELEMETRY = "telemetry arrives"
    VERSION = "the aircraft answers"
    FIRMWARE = "its firmware is known"
    ACCELERATION = "its acceleration is understood"
    ACTIVATION = "it is activated"
    KEY = "the key is the aircraft's"
    MODE_SWITCH = "the mode switch is in F"
    AUTHORITY = "it gives control"

    @property
    def title(self) -> str:
        """The condition, for people."""
        return self.value

    def good(self, seen: str, details: Details | None = None) -> Finding:
        """It is as it has to be."""
        return Finding(self, Verdict.GOOD, seen, details=details or {})

    def skipped(self, why: str, details: Details | None = None) -> Finding:
        """It was not looked at."""
        return Finding(self, Verdict.SKIPPED, why, details=details or {})

    def doubtful(
        self,
        seen: str,
        causes: Lines = (),
        commands: Lines = (),
        details: Details | None = None,
        error: M100Error | None = None,
    ) -> Finding:
        """It works, and may be the cause of something else."""
        return Finding(self, Verdict.DOUBTFUL, seen, causes, commands, details or {}, error)

    def failed(
        self,
        seen: str,
        causes: Lines = (),
        commands: Lines = (),
        details: Details | None = None,
        error: M100Error | None = None,
    ) -> Finding:
        """Nothing behind it can work."""
        return Finding(self, Verdict.FAILED, seen, causes, commands, details or {}, error)


class Verdict(StrEnum):
    """The outcome of a stage."""

    GOOD = "good"
    DOUBTFUL = "doubtful"
    """It works, and may be the cause of something else."""
    FAILED = "failed"
    """Nothing behind it can work, so the diagnosis ends here."""
    SKIPPED = "skipped"
    """It was not looked at, for the reason that is given."""


@dataclass(frozen=True, slots=True)
class Finding:
    """One stage as it was found."""

    stage: Stage  #: which
    verdict: Verdict  #: what became of it
    seen: str  #: the observation, in one sentence
    causes: Lines = ()  #: the likeliest first
    commands: Lines = ()  #: what to run or do, in this order
    #: Numbers and names behind it, for programs.
    details: Details = field(default_factory=dict)
    error: M100Error | None = None  #: the typed error that a program would get, if one was raised

    def to_json(self) -> dict[str, Any]:
        """As JSON has it."""
        found: dict[str, Any] = {
            "stage": self.stage.name.lower(),
            "asked": self.stage.title,
            "verdict": self.verdict.value,
            "seen": self.seen,
        }
        for name in ("causes", "commands", "details"):
            if getattr(self, name):
                value = getattr(self, name)
                found[name] = dict(value) if name == "details" else list(value)
        if self.error is not None:
            found["error"] = type(self.error).__name__
            found["error_code"] = self.error.error_code
        return found


@dataclass(frozen=True, slots=True)
class Report:
    """The findings, in order; the last one failed if one did."""

    place: str  #: where the aircraft was looked for, without secrets
    findings: tuple[Finding, ...]  #: one for each stage that was reached

    @property
    def failure(self) -> Finding | None:
        """The stage at which it ends, or None."""
        return next((one for one in self.findings if one.verdict is Verdict.FAILED), None)

    @property
    def doubts(self) -> tuple[Finding, ...]:
        """The findings that work and may still be a cause."""
        return tuple(one for one in self.findings if one.verdict is Verdict.DOUBTFUL)

    def to_json(self) -> dict[str, Any]:
        """As JSON has it."""
        failure = self.failure
        return {
            "url": self.place,
            "ok": failure is None,
            "failed": None if failure is None else failure.stage.name.lower(),
            "stages": [one.to_json() for one in self.findings],
        }
