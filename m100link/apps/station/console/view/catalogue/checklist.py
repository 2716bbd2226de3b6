"""The list before take-off."""

__all__ = ["WORDS"]

WORDS: dict[str, tuple[str, str]] = {
    "checklist.title": ("Before take-off", "Vor dem Start"),
    "checklist.green": ("Everything is right", "Alles in Ordnung"),
    "checklist.missing": ("Not right: {count}", "Nicht in Ordnung: {count}"),
    "checklist.impossible": (
        "The aircraft would refuse: mend what is marked as needed",
        "Das Fluggerät würde verweigern: zuerst das Nötige beheben",
    ),
    "checklist.needed": ("needed", "nötig"),
    "checklist.state.right": ("right", "in Ordnung"),
    "checklist.state.wrong": ("wrong", "nicht in Ordnung"),
    "checklist.state.unknown": ("unknown", "unbekannt"),
    "checklist.why": (
        "Why do you take off all the same?",
        "Warum starten Sie trotzdem?",
    ),
    "checklist.why.note": (
        "At least three letters; your reason goes into the events.",
        "Mindestens drei Buchstaben; der Grund steht dann in den Ereignissen.",
    ),
    "checklist.line": ("Line to the aircraft", "Leitung zum Fluggerät"),
    "checklist.line.none": ("not connected", "nicht verbunden"),
    "checklist.line.heard": ("telemetry comes", "Telemetrie kommt"),
    "checklist.line.silent": ("the aircraft is silent", "das Fluggerät schweigt"),
    "checklist.line.remedy": (
        "Look at cable, port, power and the API box of the PC assistant.",
        "Kabel, Anschluss, Strom und API-Haken im PC-Assistenten prüfen.",
    ),
    "checklist.quality": ("Delay", "Verzögerung"),
    "checklist.quality.seen": (
        "{line} ms to the aircraft, {page} ms to this page",
        "{line} ms zum Fluggerät, {page} ms zu dieser Seite",
    ),
    "checklist.quality.remedy": (
        "Look at the network and the radio: nobody steers through this.",
        "Netz und Funk prüfen: so steuert niemand.",
    ),
    "checklist.activation": ("Activation", "Aktivierung"),
    "checklist.activation.done": ("active", "aktiv"),
    "checklist.activation.none": ("not activated", "nicht aktiviert"),
    "checklist.activation.remedy": (
        "Press Activate; the first time, the app on the phone needs the Internet.",
        "Aktivieren drücken; beim ersten Mal braucht die App auf dem Telefon Internet.",
    ),
    "checklist.ground": ("On the ground", "Am Boden"),
    "checklist.ground.yes": ("it stands, motors off", "es steht, Motoren aus"),
    "checklist.ground.no": ("it flies already", "es fliegt schon"),
    "checklist.ground.remedy": ("Land before you take off.", "Vor dem Start landen."),
    "checklist.switch": ("Mode switch", "Modusschalter"),
    "checklist.switch.seen": ("in {switch}", "auf {switch}"),
    "checklist.switch.remedy": ("Ask the pilot for F.", "Den Piloten um F bitten."),
    "checklist.control": ("Control", "Steuerung"),
    "checklist.control.yours": ("you have it", "Sie haben sie"),
    "checklist.control.none": ("not obtained", "nicht geholt"),
    "checklist.control.remedy": ("Press Obtain control.", "Steuerung holen drücken."),
    "checklist.gps": ("GPS", "GPS"),
    "checklist.gps.seen": ("{health} of 5", "{health} von 5"),
    "checklist.gps.remedy": (
        "Wait under open sky until it is 3 or more.",
        "Unter freiem Himmel warten, bis es 3 oder mehr ist.",
    ),
    "checklist.home": ("Home point", "Heimatpunkt"),
    "checklist.home.here": ("here, where it takes off", "hier, wo es startet"),
    "checklist.home.remedy": (
        "It is taken where the aircraft takes off, with GPS: wait for it.",
        "Er wird beim Start genommen, mit GPS: darauf warten.",
    ),
    "checklist.battery": ("Battery", "Akku"),
    "checklist.battery.remedy": (
        "Put in a charged one: above 30 %.",
        "Einen geladenen einsetzen: über 30 %.",
    ),
    "checklist.guards": ("Limits", "Grenzen"),
    "checklist.guards.seen": (
        "{height} high, {radius} around the start",
        "{height} hoch, {radius} um den Start",
    ),
    "checklist.guards.off": ("not all are on", "nicht alle sind an"),
    "checklist.guards.remedy": (
        "The station flies without a limit of height or distance: start it with both.",
        "Die Station fliegt ohne Grenze für Höhe oder Weite: mit beiden starten.",
    ),
    "checklist.free": ("Free space", "Freier Raum"),
    "checklist.free.said": ("you looked around", "Sie haben sich umgesehen"),
    "checklist.free.unsaid": ("not confirmed", "nicht bestätigt"),
    "checklist.free.remedy": (
        "Look around, then tick the box; it holds for five minutes.",
        "Umsehen, dann ankreuzen; es gilt fünf Minuten.",
    ),
    "checklist.free.box": (
        "Nobody within 10 m, nothing above: I have looked",
        "Niemand im Umkreis von 10 m, nichts darüber: ich habe nachgesehen",
    ),
    "checklist.event.although": (
        "{name} takes off although not right: {missing}. Reason: {reason}",
        "{name} startet, obwohl nicht in Ordnung: {missing}. Grund: {reason}",
    ),
}
