"""The shell of the page, what stands over its map, and what one steers with."""

__all__ = ["WORDS"]

WORDS: dict[str, tuple[str, str]] = {
    "page.views": ("views", "Ansichten"),
    "page.view.fly": ("Fly", "Fliegen"),
    "page.view.plan": ("Plan", "Planen"),
    "page.view.check": ("Check", "Prüfen"),
    "page.view.data": ("Data", "Daten"),
    "page.view.events": ("Events", "Logbuch"),
    "page.view.settings": ("Settings", "Optionen"),
    "page.map.in": ("zoom in", "größer"),
    "page.map.out": ("zoom out", "kleiner"),
    "page.map.follow": ("follow the aircraft", "dem Fluggerät folgen"),
    "page.map.turn": ("heading up", "Nase nach oben"),
    "page.steering": ("steering", "Steuern"),
    "page.stick": ("stick: {what}", "Knüppel: {what}"),
    "page.stick.climb": ("climb and turn", "steigen, drehen"),
    "page.stick.move": ("move", "bewegen"),
    "page.legend.idle": (
        "click here, then hold keys to fly",
        "hier klicken, dann Tasten halten",
    ),
    "page.legend.idle.finger": ("hold a stick to fly", "zum Fliegen einen Knüppel halten"),
    "page.legend.keys": (
        "W A S D move, Q E turn, Z C climb and sink, Esc leaves, gamepad: hold a shoulder button",
        "W A S D bewegen, Q E drehen, Z C steigen, sinken, Esc verlässt, Gamepad: Schultertaste",
    ),
    "page.legend.speed": ("speed", "Tempo"),
    "page.legend.slower": ("slower", "langsamer"),
    "page.legend.faster": ("faster", "schneller"),
    "page.legend.mode": ("mode", "Modus"),
    "page.take_over": (
        "{name} has control. Take it over?",
        "{name} hat die Steuerung. Übernehmen?",
    ),
    "page.take_over.effect": (
        "The aircraft stops and hovers; the other side can steer no more.",
        "Das Fluggerät hält und schwebt; die andere Seite kann nicht mehr steuern.",
    ),
    "page.take_over.confirm": ("Take over", "Übernehmen"),
    "page.take_over.leave": ("Leave it", "Lassen"),
    "page.which_task": ("which simple task", "welche einfache Aufgabe"),
    "page.simple.0": ("0: legs, angles", "0: Strecken, Winkel"),
    "page.simple.1": ("1: legs, velocity", "1: Strecken, Tempo"),
    "page.simple.4": ("4: whole flight", "4: ganzer Flug"),
}
