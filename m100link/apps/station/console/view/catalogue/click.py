"""Click to fly: what it would take, what flies, and what to do about a refusal."""

__all__ = ["WORDS"]

WORDS: dict[str, tuple[str, str]] = {
    "click.title": ("Point and fly", "Zeigen und fliegen"),
    "click.hint": (
        "Click the map, or give distance and bearing",
        "Auf die Karte klicken, oder Entfernung und Richtung angeben",
    ),
    "click.place": ("Fly there", "Hinfliegen"),
    "click.circle": ("Fly around it", "Umkreisen"),
    "click.height": ("Height", "Höhe"),
    "click.heading": ("Heading", "Steuerkurs"),
    "click.speed": ("Speed, {unit}", "Tempo, {unit}"),
    "click.height_m": ("Height, {unit}", "Höhe, {unit}"),
    "click.radius": ("Radius, {unit}", "Radius, {unit}"),
    "click.turns": ("Turns", "Runden"),
    "click.clockwise": ("Clockwise", "Im Uhrzeigersinn"),
    "click.yaw": ("Heading, °", "Steuerkurs, °"),
    "click.distance": ("Distance, {unit}", "Entfernung, {unit}"),
    "click.bearing": ("Bearing, °", "Richtung, °"),
    "click.fly": ("Fly (hold)", "Fliegen (halten)"),
    "click.hover": ("Hover", "Schweben"),
    "click.close": ("Close", "Schließen"),
    "click.way": (
        "{way}, about {time} min, {battery} % of a battery",
        "{way}, etwa {time} min, {battery} % einer Batterie",
    ),
    "click.climb": (
        "{climb}, about {time} min, {battery} % of a battery",
        "{climb}, etwa {time} min, {battery} % einer Batterie",
    ),
    "click.turn": (
        "{turn}°, about {time} min, {battery} % of a battery",
        "{turn}°, etwa {time} min, {battery} % einer Batterie",
    ),
    "click.flying": ("{what}", "{what}"),
    "click.flying_time": ("{what}: {time} min to go", "{what}: noch {time} min"),
    "click.flying_way": ("{what}: {way}, {time} min to go", "{what}: noch {way}, {time} min"),
    "click.what.flight_to_a_place": ("Flies to the point", "Fliegt zum Punkt"),
    "click.what.flight_around_a_place": ("Flies around the point", "Umkreist den Punkt"),
    "click.what.change_of_height": ("Changes height", "Ändert die Höhe"),
    "click.what.change_of_heading": ("Turns", "Dreht sich"),
    "click.remedy.control": ("Obtain control first.", "Zuerst die Steuerung übernehmen."),
    "click.remedy.ground": ("Take off first.", "Zuerst starten."),
    "click.remedy.envelope": (
        "Point inside of the orange circle, lower, or fly more slowly.",
        "Innerhalb des orangen Kreises zeigen, tiefer oder langsamer fliegen.",
    ),
    "click.remedy.battery": (
        "Land; landing and going home are never refused.",
        "Landen; Landen und Heimflug werden nie verweigert.",
    ),
    "click.remedy.gps": (
        "Wait for GPS, or let the pilot fly.",
        "Auf GPS warten, oder den Piloten fliegen lassen.",
    ),
    "click.remedy.telemetry": (
        "Wait until the position comes; have the pilot ready.",
        "Warten, bis die Position kommt; der Pilot muss bereit sein.",
    ),
}
