"""The pilot's remote control, as far as the autopilot notices it.

Sticks and switches as the telemetry item has them (document 2.2.3.1, item RC): -10000 to 10000,
mode -8000 for P, 0 for A and 8000 for F, gear -10000 up and -4545 down.
"""

from __future__ import annotations

from m100link.protocol.telemetry import RcMode

__all__ = ["GEAR_DOWN", "GEAR_UP", "RemoteControl"]

GEAR_UP = -10_000
GEAR_DOWN = -4_545
_FULL = 10_000


class RemoteControl:
    """Switches and sticks of the remote control.

    Attributes:
        mode: Position of the mode switch: P and A give the aircraft to the pilot, F lets the
            onboard device or the mobile app fly.
        roll, pitch, yaw, throttle: Stick deflection, -1 (left or down) to 1 (right or up).
        gear_down: Position of the landing gear switch.
        is_on: Off, the autopilot has lost its remote control.
        moved_since_power_on: Whether the mode switch was moved since the autopilot started.
    """

    __slots__ = (
        "gear_down",
        "is_on",
        "mode",
        "moved_since_power_on",
        "pitch",
        "roll",
        "throttle",
        "yaw",
    )

    def __init__(self, mode: RcMode = RcMode.P, *, is_on: bool = True) -> None:
        self.mode = mode
        self.is_on = is_on
        self.gear_down = True
        self.moved_since_power_on = False
        self.roll = self.pitch = self.yaw = self.throttle = 0.0

    def set_mode(self, mode: RcMode | str) -> None:
        """Turn the mode switch. Naming the position it is in already moves nothing."""
        mode = RcMode[mode] if isinstance(mode, str) else mode
        if mode is not self.mode:
            self.mode = mode
            self.moved_since_power_on = True

    def move_stick(
        self,
        *,
        roll: float | None = None,
        pitch: float | None = None,
        yaw: float | None = None,
        throttle: float | None = None,
    ) -> None:
        """Deflect sticks, -1 to 1 each; the ones not named stay where they are.

        Raises:
            ValueError: A deflection beyond -1...1.
        """
        wanted = {"roll": roll, "pitch": pitch, "yaw": yaw, "throttle": throttle}
        for name, value in wanted.items():
            if value is not None and not -1.0 <= value <= 1.0:
                raise ValueError(f"{name} stick: {value} lies outside -1...1")
        for name, value in wanted.items():
            if value is not None:
                setattr(self, name, float(value))

    def release_sticks(self) -> None:
        """Let all sticks go back to the centre."""
        self.roll = self.pitch = self.yaw = self.throttle = 0.0

    @property
    def sticks_moved(self) -> bool:
        """Whether any stick is off its centre by more than the dead zone of 5 %."""
        return max(abs(self.roll), abs(self.pitch), abs(self.yaw), abs(self.throttle)) > 0.05

    def channels(self) -> tuple[int, int, int, int, int, int]:
        """The RC item: roll, pitch, yaw, throttle, mode, gear; centred sticks when it is off."""
        gear = GEAR_DOWN if self.gear_down else GEAR_UP
        if not self.is_on:
            return 0, 0, 0, 0, self.mode.value, gear
        return (
            round(self.roll * _FULL),
            round(self.pitch * _FULL),
            round(self.yaw * _FULL),
            round(self.throttle * _FULL),
            self.mode.value,
            gear,
        )
