"""Errors that a pilot can meet: in English as they are, in German with their meaning before that.

A key ends with the code of its class, or with the guard that refused. What has no entry of its own
is told by that of its base.
"""

__all__ = ["WORDS"]

_MEANINGS: dict[str, str] = {
    "error": "Das ging nicht",
    "usage": "Das passt so nicht, gesendet wurde nichts",
    "bad_plan": "Diesen Plan würde das Fluggerät ablehnen",
    "bad_setpoint": "Dieser Steuerwert ist unzulässig, geflogen wurde er nicht",
    "link": "Die Leitung zum Fluggerät ist gestört: den Piloten übernehmen lassen",
    "link_lost": "Die Leitung zum Fluggerät ist verloren: den Piloten übernehmen lassen",
    "no_aircraft": "Das Fluggerät antwortet nicht",
    "ack_timeout": "Keine Antwort, ob es geschah, ist nicht bekannt: auf das Fluggerät sehen",
    "key_rejected": "Das Fluggerät nimmt den Schlüssel nicht an",
    "command_refused": "Das Fluggerät hat den Befehl abgelehnt",
    "activation_refused": "Die Aktivierung wurde abgelehnt",
    "not_activated": "Das Fluggerät ist nicht aktiviert: zuerst aktivieren",
    "command_not_supported": "Dieses Fluggerät kennt den Befehl nicht",
    "authority_refused": "Das Fluggerät gibt die Steuerung nicht her: Modusschalter auf F?",
    "mission_refused": "Die Mission oder der Befehl an sie wurde abgelehnt",
    "task_refused": "Abgelehnt und nicht begonnen",
    "task_failed": "Begonnen und abgebrochen: auf das Fluggerät sehen",
    "not_observed": "Angenommen, aber nicht zu sehen: auf das Fluggerät sehen",
    "mission_aborted": "Das Fluggerät hat die Mission abgebrochen",
    "no_authority": "Die Station hat die Steuerung nicht: zuerst Steuerung holen",
    "mission_running": "Eine Mission fliegt: zuerst anhalten oder beenden",
    "authority_lost": "Die Steuerung ist verloren: der Pilot, die App oder die Leitung nahm sie",
    "lease_refused": "Sie haben die Steuerung nicht mehr: neu holen",
    "lease_held": "Jemand anders hat die Steuerung",
    "telemetry": "Telemetrie fehlt",
    "telemetry_stalled": "Keine Telemetrie mehr: den Piloten übernehmen lassen",
    "message": "Der Agent der Station hat etwas Unverständliches gesagt",
}

_GUARDS: dict[str, str] = {
    "guard_refused": "Abgelehnt, geflogen wurde es nicht",
    "guard_refused.envelope": "Die Grenzen erlauben das nicht: näher, niedriger oder langsamer",
    "guard_refused.battery_floor_percent": "Der Akku reicht dafür nicht: landen",
    "guard_refused.gps": "GPS ist dafür zu schwach: auf GPS warten",
    "guard_refused.way_late": "Die Taste kam zu spät an, geflogen wurde nichts: langsames Netz",
    "guard_refused.way_unheard": "Diese Seite hört die Station nicht, geflogen wurde nichts",
    "guard_refused.way_round_trip": "Das Netz ist zum Steuern zu langsam, geflogen wurde nichts",
    "guard_refused.setpoint_age": "Der Steuerwert kam zu spät an und wurde nicht geflogen",
    "guard_refused.stopped": "STOPP war gedrückt: loslassen, dann neu beginnen",
    "guard_refused.let_go": (
        "Seit STOPP, einem Verlust der Steuerung oder langsamem Netz wird noch etwas gehalten: "
        "Tasten und Knüppel loslassen, dann neu drücken"
    ),
    "guard_refused.order_late": "Die Taste kam zu spät oder ungewiss an, nichts geschah",
    "guard_refused.not_offered": "Der Befehl galt beim Halten nicht mehr, nichts geschah",
    "guard_refused.page_shifted": "Die Seite verschob sich beim Drücken, nichts geschah",
    "guard_refused.order_changed": "Der Punkt änderte sich beim Halten, nichts geschah",
}

WORDS: dict[str, tuple[str, str]] = {
    f"errors.{key}": ("{original}", f"{meaning}\n{{original}}")
    for key, meaning in (_MEANINGS | _GUARDS).items()
}
