"""The panel of a virtual aircraft."""

__all__ = ["WORDS"]

WORDS: dict[str, tuple[str, str]] = {
    "sim.mode": ("Mode switch", "Modusschalter"),
    "sim.rc": ("remote control on", "Fernsteuerung an"),
    "sim.app": ("app flies", "App fliegt"),
    "sim.plug": ("plugged in", "eingesteckt"),
    "sim.stall": ("line stalled", "Leitung hängt"),
    "sim.refuse": ("server refuses", "Server verweigert"),
    "sim.line": ("line", "Leitung"),
    "sim.line.clean": ("clean", "sauber"),
    "sim.line.lost_5": ("5 % lost", "5 % verloren"),
    "sim.line.lost_20": ("20 % lost", "20 % verloren"),
    "sim.line.damaged": ("2 % damaged", "2 % beschädigt"),
    "sim.line.late": ("80 ms late", "80 ms später"),
    "sim.line.radio": ("433 MHz radio", "Funk, 433 MHz"),
    "sim.gps": ("GPS health", "GPS-Güte"),
    "sim.battery": ("battery, %", "Batterie, %"),
}
