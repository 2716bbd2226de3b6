"""The mission: its plan in a line, and how far it is."""

__all__ = ["WORDS"]

WORDS: dict[str, tuple[str, str]] = {
    "mission.no_plan": ("no plan", "kein Plan"),
    "mission.plan": (
        "{count} waypoints, {length} at {speed}, height {low} to {high}",
        "{count} Wegpunkte, {length} mit {speed}, Höhe {low} bis {high}",
    ),
    "mission.unknown": ("nothing is known of missions", "von Missionen ist nichts bekannt"),
    "mission.none": ("no mission", "keine Mission"),
    "mission.waypoint": ("waypoint mission", "Wegpunktmission"),
    "mission.hotpoint": ("circle around a point", "Kreis um einen Punkt"),
    "mission.follow": ("following a target", "Verfolgen eines Ziels"),
    "mission.other": ("program {name}", "Programm {name}"),
    "mission.to": ("{what}: to waypoint {number}", "{what}: zu Wegpunkt {number}"),
    "mission.to_of": (
        "{what}: to waypoint {number} of {count}",
        "{what}: zu Wegpunkt {number} von {count}",
    ),
}
