"""The buttons that one flies with."""

__all__ = ["WORDS"]

WORDS: dict[str, tuple[str, str]] = {
    "actions.stop": ("STOP", "STOPP"),
    "actions.activate": ("Activate", "Aktivieren"),
    "actions.obtain": ("Obtain control", "Steuerung holen"),
    "actions.release": ("Release control", "Steuerung abgeben"),
    "actions.take_off": ("Take off (hold)", "Starten (halten)"),
    "actions.land": ("Land (hold)", "Landen (halten)"),
    "actions.go_home": ("Go home (hold)", "Heimfliegen (halten)"),
    "actions.simple_task": ("Simple task (hold)", "Einfache Aufgabe (halten)"),
    "actions.why_not": ("Before take-off: {count} to check", "Vor dem Start: {count} zu prüfen"),
}
