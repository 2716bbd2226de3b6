"""What the page says by itself: the part after ``browser.`` is what ``static/said.js`` asks for."""

__all__ = ["WORDS"]

WORDS: dict[str, tuple[str, str]] = {
    "browser.let_go": ("let go: it hovers", "losgelassen: schwebt"),
    "browser.fate_sent": ("sent · {what}", "gesendet · {what}"),
    "browser.fate_flown": ("flown · {what}", "geflogen · {what}"),
    "browser.fate_no_control": (
        "not flown: you have no control · {what}",
        "nicht geflogen: keine Steuerung · {what}",
    ),
    "browser.fate_on_ground": (
        "not flown: it stands on the ground · {what}",
        "nicht geflogen: es steht am Boden · {what}",
    ),
    "browser.fate_slow": (
        "not flown: the way is too slow · {what}",
        "nicht geflogen: der Weg ist zu langsam · {what}",
    ),
    "browser.fate_let_go_first": (
        "not flown: let go, then press again · {what}",
        "nicht geflogen: loslassen, dann neu drücken · {what}",
    ),
    "browser.fate_refused": ("not flown · {what}", "nicht geflogen · {what}"),
    "browser.at_rest": ("held, at rest", "gehalten, in Ruhe"),
    "browser.north": ("north", "nach Norden"),
    "browser.south": ("south", "nach Süden"),
    "browser.east": ("east", "nach Osten"),
    "browser.west": ("west", "nach Westen"),
    "browser.forward": ("forward", "vorwärts"),
    "browser.back": ("back", "rückwärts"),
    "browser.right": ("right", "nach rechts"),
    "browser.left": ("left", "nach links"),
    "browser.turn_right": ("turn right {rate} °/s", "rechts drehen {rate} °/s"),
    "browser.turn_left": ("turn left {rate} °/s", "links drehen {rate} °/s"),
    "browser.climb": ("climb {speed}", "steigen {speed}"),
    "browser.sink": ("sink {speed}", "sinken {speed}"),
    "browser.level": ("speed {level} of {levels}", "Tempo {level} von {levels}"),
    "browser.angles": ("mode 1: angles", "Modus 1: Winkel"),
    "browser.velocity": ("mode 2: velocity over ground", "Modus 2: Tempo über Grund"),
    "browser.angles_hint": ("(angles, W forward)", "(Winkel, W vorwärts)"),
    "browser.velocity_hint": ("(velocity, W north)", "(Tempo, W nach Norden)"),
    "browser.home": ("home {far}", "Start {far}"),
    "browser.home_way": ("home {far} · {bearing}°", "Start {far} · {bearing}°"),
    "browser.home_unseen": ("home was not seen", "Startpunkt nicht gesehen"),
    "browser.home_old": ("home: position is old", "Start: Position ist alt"),
    "browser.no_attitude": ("no attitude", "keine Lage"),
    "browser.old": ("old", "alt"),
    "browser.compass_east": ("E", "O"),
    "browser.hold": ("Hold the button for a second", "Taste eine Sekunde lang halten"),
    "browser.too_soon": (
        "Not taken: the focus had come here by itself. Press again.",
        "Nicht ausgeführt: der Fokus kam von selbst hierher. Noch einmal drücken.",
    ),
    "browser.unanswered": (
        "{orders}: no answer. Whether it was done is not known: have the pilot take over.",
        "{orders}: keine Antwort. Ob es geschah, ist nicht bekannt: den Piloten übernehmen lassen.",
    ),
    "browser.clear": ("Clear", "Leeren"),
    "browser.remove": ("Remove", "Entfernen"),
    "browser.age": ("{seconds} s ago", "vor {seconds} s"),
}
