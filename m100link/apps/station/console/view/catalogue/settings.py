"""The settings of a page."""

__all__ = ["WORDS"]

WORDS: dict[str, tuple[str, str]] = {
    "settings.title": ("This page", "Diese Seite"),
    "settings.name": ("Your name", "Ihr Name"),
    "settings.language": ("Language", "Sprache"),
    "settings.language.en": ("English", "English"),
    "settings.language.de": ("Deutsch", "Deutsch"),
    "settings.english_errors": (
        "Reports of errors and the station's events are in English whatever is chosen here.",
        "Fehlermeldungen und Ereignisse der Station sind immer englisch.",
    ),
    "settings.length": ("Heights and lengths", "Höhen und Längen"),
    "settings.speed": ("Speeds", "Geschwindigkeiten"),
    "settings.theme": ("Looks", "Aussehen"),
    "settings.theme.auto": ("as the device", "wie das Gerät"),
    "settings.theme.light": ("light", "hell"),
    "settings.theme.dark": ("dark", "dunkel"),
    "settings.theme.sun": ("sunlight", "Sonne"),
    "settings.sound": ("Alarms sound", "Alarme klingen"),
    "settings.speech": ("Alarms are spoken", "Alarme werden gesprochen"),
    "settings.try_sound": ("Try sound and speech", "Ton und Sprache probieren"),
    "settings.tried": ("This is how an alarm sounds", "So klingt ein Alarm"),
    "settings.kept": (
        "Kept in this browser.",
        "In diesem Browser gespeichert.",
    ),
}
