"""Numbers with a unit that nobody chooses."""

__all__ = ["WORDS"]

WORDS: dict[str, tuple[str, str]] = {
    "unit.seconds": ("{seconds} s", "{seconds} s"),
    "unit.ms": ("{ms} ms", "{ms} ms"),
    "unit.percent": ("{percent} %", "{percent} %"),
    "unit.unknown": ("unknown", "unbekannt"),
}
