"""The status line: causes, what to do about them, and what flies."""

__all__ = ["WORDS"]

WORDS: dict[str, tuple[str, str]] = {
    # Shown by the page itself, when nothing comes from the station any more.
    "status.page_lost": (
        "This page does not hear the station: everything here is old",
        "Diese Seite hört die Station nicht: alles hier ist alt",
    ),
    "status.page_lost.remedy": (
        "Have the pilot take over. Look at the network, and whether the station runs.",
        "Den Piloten übernehmen lassen. Netz prüfen, und ob die Station läuft.",
    ),
    "status.agent_gone": (
        "The station's agent has ended: nothing is heard of the aircraft",
        "Der Agent der Station ist beendet: vom Fluggerät ist nichts zu hören",
    ),
    "status.agent_gone.remedy": (
        "Have the pilot take over. Start the station again.",
        "Den Piloten übernehmen lassen. Station neu starten.",
    ),
    "status.agent_silent": (
        "The station's agent is silent: nothing is heard of the aircraft",
        "Der Agent der Station schweigt: vom Fluggerät ist nichts zu hören",
    ),
    "status.agent_silent.remedy": (
        "Have the pilot take over. If this lasts, start the station again.",
        "Den Piloten übernehmen lassen. Wenn es anhält, Station neu starten.",
    ),
    "status.line_lost": (
        "The line to the aircraft is lost{why}",
        "Die Leitung zum Fluggerät ist verloren{why}",
    ),
    "status.line_lost.remedy": (
        "Have the pilot take over. Look at cable, port and power; the station goes on trying.",
        "Den Piloten übernehmen lassen. Kabel, Anschluss und Strom prüfen; es wird neu versucht.",
    ),
    "status.connecting": (
        "Connecting to the aircraft{why}",
        "Verbindung zum Fluggerät wird aufgebaut{why}",
    ),
    "status.connecting.remedy": (
        "If this lasts: aircraft on, cable in, API enabled in the PC assistant, right baud rate.",
        "Wenn es dauert: Fluggerät an, Kabel drin, API im PC-Assistenten an, Baudrate richtig.",
    ),
    "status.never_heard": (
        "The line is open, no telemetry has come yet",
        "Die Leitung ist offen, noch keine Telemetrie",
    ),
    "status.never_heard.remedy": (
        "If this lasts, switch telemetry on in the PC assistant.",
        "Wenn es dauert, Telemetrie im PC-Assistenten einschalten.",
    ),
    "status.aircraft_silent": (
        "The aircraft is silent: all values are old",
        "Das Fluggerät schweigt: alle Werte sind alt",
    ),
    "status.aircraft_silent.remedy": (
        "Have the pilot take over. Look at cable and radio.",
        "Den Piloten übernehmen lassen. Kabel und Funk prüfen.",
    ),
    "status.app": (
        "The app on the pilot's phone has control",
        "Die App auf dem Telefon des Piloten hat die Steuerung",
    ),
    "status.app.remedy": (
        "End the mission or control in the app.",
        "Mission oder Steuerung in der App beenden.",
    ),
    "status.switch": (
        "The pilot flies: mode switch in {switch}",
        "Der Pilot fliegt: Modusschalter auf {switch}",
    ),
    "status.switch.remedy": (
        "Ask the pilot for F.",
        "Den Piloten um F bitten.",
    ),
    "status.other": ("{name} has control", "{name} hat die Steuerung"),
    "status.other.remedy": (
        "Ask there to let go, or take over.",
        "Dort um Abgabe bitten, oder übernehmen.",
    ),
    "status.not_activated": ("The aircraft is not activated", "Das Fluggerät ist nicht aktiviert"),
    "status.not_activated.remedy": ("Activate it.", "Aktivieren."),
    "status.pending": (
        "Control was asked for, the aircraft has not answered yet",
        "Steuerung angefragt, das Fluggerät hat noch nicht geantwortet",
    ),
    "status.giving_back": ("Control is being given back", "Die Steuerung wird abgegeben"),
    "status.yours": ("You have control", "Sie haben die Steuerung"),
    "status.mission": (
        "You have control, and a mission flies: sticks do nothing",
        "Sie haben die Steuerung, eine Mission fliegt: Knüppel wirken nicht",
    ),
    "status.mission.remedy": (
        "Pause or stop it to fly by hand.",
        "Zum Fliegen von Hand anhalten oder beenden.",
    ),
    "status.rc": (
        "You hold the lease, the aircraft obeys the remote controller",
        "Sie sind angemeldet, das Fluggerät folgt der Fernsteuerung",
    ),
    "status.rc.remedy": (
        "Obtain control; if it is refused, ask the pilot to leave F and come back.",
        "Steuerung holen; wenn verweigert, den Piloten bitten, F zu verlassen und neu zu wählen.",
    ),
    "status.taken": (
        "You hold the lease, but somebody took control; who is not known",
        "Sie sind angemeldet, aber jemand nahm die Steuerung; wer, ist nicht bekannt",
    ),
    "status.taken.remedy": (
        "Ask the pilot, then obtain control again.",
        "Den Piloten fragen, dann Steuerung neu holen.",
    ),
    "status.no_authority": (
        "You hold the lease, without control of the aircraft",
        "Sie sind angemeldet, ohne Steuerung des Fluggeräts",
    ),
    "status.no_authority.remedy": ("Obtain control.", "Steuerung holen."),
    "status.kept": (
        "The aircraft hovers: control is kept for a moment for whoever was lost",
        "Das Fluggerät schwebt: die Steuerung wird kurz für den gehalten, der verloren ging",
    ),
    "status.kept.remedy": ("Obtain control to fly on.", "Zum Weiterfliegen Steuerung holen."),
    "status.free_rc": (
        "Nobody has control here: the remote controller flies",
        "Niemand steuert von hier: die Fernsteuerung fliegt",
    ),
    "status.free_rc.remedy": ("Obtain control to fly.", "Zum Fliegen Steuerung holen."),
    "status.free": ("Nobody has control here", "Niemand steuert von hier"),
    "status.free.remedy": ("Obtain control to fly.", "Zum Fliegen Steuerung holen."),
    "status.activation.done": ("Activation: active", "Aktivierung: aktiv"),
    "status.activation.none": ("Activation: not done", "Aktivierung: nicht gemacht"),
    "status.activation.failed": ("Activation: {why}", "Aktivierung: {why}"),
    "status.replay": (
        "Replay of a recorded flight: nothing flies",
        "Wiedergabe eines aufgezeichneten Flugs: es fliegt nichts",
    ),
    "status.replay.remedy": (
        "Values, ages and alarms are those of then.",
        "Werte, Alter und Alarme sind die von damals.",
    ),
    "status.virtual": ("Virtual aircraft", "Virtuelles Fluggerät"),
    "status.since": ("for {seconds} s", "seit {seconds} s"),
    "status.task.take_off": ("take-off", "Start"),
    "status.task.land": ("landing", "Landung"),
    "status.task.go_home": ("going home", "Heimflug"),
    "status.to_waypoint": ("{mission}, to waypoint {number}", "{mission}, zu Wegpunkt {number}"),
    "status.program": ("program {name}", "Programm {name}"),
}
