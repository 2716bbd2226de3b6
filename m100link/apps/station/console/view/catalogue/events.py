"""The list of events."""

__all__ = ["WORDS"]

WORDS: dict[str, tuple[str, str]] = {
    "events.title": ("Events", "Ereignisse"),
    "events.level": ("Level", "Stufe"),
    "events.level.info": ("all", "alle"),
    "events.level.warning": ("warnings", "Warnungen"),
    "events.level.error": ("errors", "Fehler"),
    "events.words": ("Words to find", "Gesuchte Wörter"),
    "events.export": ("Save as {how}", "Als {how} sichern"),
    "events.count": ("{shown} of {all}", "{shown} von {all}"),
    "events.none": ("Nothing to show", "Nichts zu zeigen"),
}
