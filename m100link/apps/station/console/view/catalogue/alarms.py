"""The alarms: what is shown, spoken and written into the list of events."""

__all__ = ["WORDS"]

WORDS: dict[str, tuple[str, str]] = {
    "alarms.none": ("No alarm", "Kein Alarm"),
    "alarms.title": ("Alarms", "Alarme"),
    "alarms.level.danger": ("Danger", "Gefahr"),
    "alarms.level.warning": ("Warning", "Warnung"),
    "alarms.acknowledge": ("Acknowledge", "Quittieren"),
    "alarms.acknowledge_named": ("Acknowledge: {alarm}", "Quittieren: {alarm}"),
    "alarms.passed": ("{alarm} (over)", "{alarm} (vorbei)"),
    "alarms.event.raised": ("Alarm: {alarm}", "Alarm: {alarm}"),
    "alarms.event.acknowledged": ("Acknowledged: {alarm}", "Quittiert: {alarm}"),
    "alarms.event.passed": ("Over, not acknowledged: {alarm}", "Vorbei, nicht quittiert: {alarm}"),
    "alarms.event.quiet": ("Over: {alarm}", "Vorbei: {alarm}"),
    "alarms.link_lost": (
        "The line to the aircraft is lost: have the pilot take over",
        "Leitung zum Fluggerät verloren: den Piloten übernehmen lassen",
    ),
    "alarms.link_old": (
        "The aircraft is silent: all values are old",
        "Das Fluggerät schweigt: alle Werte sind alt",
    ),
    "alarms.lands_itself": ("The aircraft lands by itself", "Das Fluggerät landet von selbst"),
    "alarms.lands_itself.battery": (
        "The aircraft lands by itself: the battery is nearly empty",
        "Das Fluggerät landet von selbst: der Akku ist fast leer",
    ),
    "alarms.battery_critical": (
        "Battery {percent} %: the aircraft is about to land by itself",
        "Akku {percent} %: das Fluggerät landet gleich von selbst",
    ),
    "alarms.battery_floor": (
        "Battery {percent} %: below {floor} % the station does not steer, land now",
        "Akku {percent} %: unter {floor} % steuert die Station nicht, jetzt landen",
    ),
    "alarms.battery_low": ("Battery {percent} %: land soon", "Akku {percent} %: bald landen"),
    "alarms.gps": (
        "GPS is weak: the aircraft may drift",
        "GPS ist schwach: das Fluggerät kann abtreiben",
    ),
    "alarms.navigation": (
        "The telemetry cannot be true ({what}): have the pilot take over",
        "Die Telemetrie kann nicht stimmen ({what}): den Piloten übernehmen lassen",
    ),
    "alarms.authority_lost": (
        "Control is lost, nobody knows to whom",
        "Die Steuerung ist weg, niemand weiß an wen",
    ),
    "alarms.authority_lost.switch": (
        "The pilot took control with the mode switch",
        "Der Pilot nahm die Steuerung mit dem Modusschalter",
    ),
    "alarms.authority_lost.app": (
        "The app on the pilot's phone took control",
        "Die App auf dem Telefon des Piloten nahm die Steuerung",
    ),
    "alarms.authority_lost.link": (
        "Control is lost with the line",
        "Die Steuerung ging mit der Leitung verloren",
    ),
    "alarms.lease_taken": ("You have lost control", "Sie haben die Steuerung verloren"),
    "alarms.lease_taken.taken": (
        "{name} took control from you",
        "{name} hat Ihnen die Steuerung genommen",
    ),
    "alarms.lease_taken.expired": (
        "You have lost control: this page was not heard for too long",
        "Sie haben die Steuerung verloren: diese Seite war zu lange nicht zu hören",
    ),
    "alarms.lease_taken.flown": ("{lost}. {flown}", "{lost}. {flown}"),
    "alarms.flown.nothing": ("The aircraft hovers", "Das Fluggerät schwebt"),
    "alarms.flown.setpoints": (
        "What you steered was stopped: the aircraft brakes and hovers",
        "Was Sie steuerten, wurde beendet: das Fluggerät bremst und schwebt",
    ),
    "alarms.flown.guided flight": (
        "The flight to where you pointed was stopped: the aircraft brakes and hovers",
        "Der Flug zum gezeigten Ort wurde beendet: das Fluggerät bremst und schwebt",
    ),
    "alarms.flown.program": (
        "The simple task was stopped: the aircraft brakes and hovers",
        "Die einfache Aufgabe wurde beendet: das Fluggerät bremst und schwebt",
    ),
    "alarms.flown.mission": (
        "The mission was told to stop: the aircraft brakes and hovers where it is",
        "Die Mission wurde angehalten: das Fluggerät bremst und schwebt, wo es ist",
    ),
    "alarms.flown.take off": (
        "It was taking off: see whether that goes on",
        "Es startete: sehen Sie nach, ob das weitergeht",
    ),
    "alarms.flown.take off.goes_on": (
        "The take-off goes on: the aircraft flies it by itself",
        "Der Start geht weiter: das Fluggerät fliegt ihn von selbst",
    ),
    "alarms.flown.land": (
        "It was landing: see whether that goes on",
        "Es landete: sehen Sie nach, ob das weitergeht",
    ),
    "alarms.flown.land.goes_on": (
        "The landing goes on: the aircraft flies it by itself",
        "Die Landung geht weiter: das Fluggerät fliegt sie von selbst",
    ),
    "alarms.flown.go home": (
        "It was going home: see whether that goes on",
        "Es flog nach Hause: sehen Sie nach, ob das weitergeht",
    ),
    "alarms.flown.go home.goes_on": (
        "The flight home goes on: the aircraft flies it by itself",
        "Der Heimflug geht weiter: das Fluggerät fliegt ihn von selbst",
    ),
    "alarms.mission_aborted": ("Mission broken off: {why}", "Mission abgebrochen: {why}"),
    "alarms.guard_near.height": (
        "Near the limit: {value} high of {limit}",
        "Nahe der Grenze: {value} hoch von {limit}",
    ),
    "alarms.guard_near.radius": (
        "Near the limit: {value} away of {limit}",
        "Nahe der Grenze: {value} entfernt von {limit}",
    ),
    "alarms.sound_blocked": (
        "The browser blocks sound until you click or press a key here",
        "Der Browser sperrt den Ton, bis Sie hier klicken oder eine Taste drücken",
    ),
    "alarms.allow_sound": ("Allow sound", "Ton erlauben"),
}
