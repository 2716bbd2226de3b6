"""The bar of a replay: what is played, how far it is, how fast."""

__all__ = ["WORDS"]

WORDS: dict[str, tuple[str, str]] = {
    "replay.title": ("REPLAY {name}", "WIEDERGABE {name}"),
    "replay.bar": ("Replay", "Wiedergabe"),
    "replay.nothing": ("nothing flies", "es fliegt nichts"),
    "replay.at": ("{position} of {duration}, {when}", "{position} von {duration}, {when}"),
    "replay.at_end": ("at its end", "am Ende"),
    "replay.cut_off": ("the recording was cut off", "die Aufzeichnung ist abgeschnitten"),
    "replay.pause": ("Pause", "Anhalten"),
    "replay.resume": ("Play", "Abspielen"),
    "replay.back": ("10 s back", "10 s zurück"),
    "replay.on": ("10 s on", "10 s vor"),
    "replay.place": ("Place in the recording", "Stelle der Aufzeichnung"),
    "replay.speed": ("Speed", "Tempo"),
}
