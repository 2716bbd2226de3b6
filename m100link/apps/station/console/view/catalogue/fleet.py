"""The list of aircraft."""

__all__ = ["WORDS"]

WORDS: dict[str, tuple[str, str]] = {
    "fleet.label": ("Aircraft of this station", "Fluggeräte dieser Station"),
    "fleet.not_heard": ("not heard", "nicht zu hören"),
    "fleet.not_connected": ("not connected", "nicht verbunden"),
    "fleet.ours": ("you have it", "bei Ihnen"),
    "fleet.ours_pilot_has_it": ("obeys the pilot", "gehorcht dem Piloten"),
    "fleet.theirs": ("{name} has it", "bei {name}"),
    "fleet.free": ("the pilot flies", "der Pilot fliegt"),
    "fleet.stands": ("nobody has it", "bei niemandem"),
    "fleet.unknown": ("–", "–"),
    "fleet.percent": ("{percent} %", "{percent} %"),
    "fleet.height": ("{height}", "{height}"),
    "fleet.flies": ("{height}, {what}", "{height}, {what}"),
    "fleet.show": ("show and steer {name}", "{name} zeigen und steuern"),
    "fleet.stop": ("stop {name}", "{name} anhalten"),
}
