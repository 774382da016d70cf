"""What a recording does not determine, and the effects that tracing therefore cannot see."""

from __future__ import annotations

from collections.abc import Mapping

from trimtab.host.effects import Effect
from trimtab.host.effects.unknowns import UNKNOWN, undetermined
from trimtab.host.imports.recording import Recording

TYPICAL_LAG_S = 0.05
"""Motor lag of small quadrotors, for a recording whose vehicle is not known yet."""


def unknown_words(recording: Recording, motor_lag_s: float = TYPICAL_LAG_S) -> tuple[str, ...]:
    """Return what the recording declares unknown, and what its inputs do not determine."""
    words = {*recording.unknown, *undetermined(recording.input_us, motor_lag_s)}
    return tuple(word for word in UNKNOWN if word in words)


def invisible_effects(
    effects: Mapping[str, Effect], recording: Recording, motor_lag_s: float = TYPICAL_LAG_S
) -> dict[str, str]:
    """Return the reason, by effect, for each effect that the recording cannot show."""
    words = unknown_words(recording, motor_lag_s)
    signals = {"voltage_ratio": recording.battery_v, "gyro": recording.gyro}
    titles = {"voltage_ratio": "battery voltage", "gyro": "gyro"}
    reasons = {}
    for name, effect in effects.items():
        absent = [titles[signal] for signal in effect.needs_signals if signals[signal] is None]
        replaced = effect.replaced(words)
        if replaced:
            reasons[name] = f"{', '.join(replaced)} unknown"
        elif absent:
            reasons[name] = f"no {', '.join(absent)}"
        elif effect.noise_dependent:
            reasons[name] = "commands are samples, not means"
    return reasons
