"""Rules on the residual: its cause is outside the library if it repeats, rings, pulses or was made worse."""

from __future__ import annotations

import math
from dataclasses import dataclass

from trimtab.host.trace.decision.findings import CHANNEL_UNITS, Code, Finding
from trimtab.host.trace.decision.rules import Rules
from trimtab.host.trace.residual.unexplained import ChannelResidual, UnexplainedResidual


@dataclass(frozen=True, kw_only=True)
class ResidualBounds:
    """Bounds on a residual, above which it needs a cause outside the library.

    force, torque: rms that repeats, m/s^2 and rad/s^2. line_ratio: power of a spectral line over its
    surroundings. flight_share: repeatable power of whole flights over turbulence and noise. position_m:
    repeatable position error of whole flights.
    """

    force: float
    torque: float
    line_ratio: float
    flight_share: float
    position_m: float = math.inf


def no_effect_bounds(rules: Rules) -> ResidualBounds:
    """Return the bounds on the residual of the model without effects."""
    return ResidualBounds(
        force=rules.force_floor_m_s2,
        torque=rules.torque_floor_rad_s2,
        line_ratio=rules.line_ratio,
        flight_share=rules.flight_repeat_share,
    )


def residual_bounds(
    without: UnexplainedResidual,
    *,
    has_effects: bool,
    has_memory: bool,
    position_m: float = 0.0,
    rules: Rules,
) -> ResidualBounds:
    """Return the bounds on the residual of the selected set.

    No effect's equation is exact, so the bounds grow with the residual without effects, on which the selected
    set must improve. A great position error is no such inexactness, unless an effect has states of its own.
    If no effect is selected and a visible position error repeats, no more may repeat than by chance.

    without: residual of the model without effects. has_effects: whether any effect is selected. has_memory:
    whether one with states of its own is. position_m: position error of whole flights that repeats with the
    set.
    """
    share, worsened_m = rules.flight_repeat_share, math.inf
    if without.flight_repeat is not None:
        if not has_effects and position_m > rules.visible_error_m:
            share = rules.flight_repeat_chance
        elif has_memory or position_m <= rules.equation_error_m:
            share = max(share, rules.equation_error_amplitude**2 * without.flight_repeat.share)
        worsened_m = max(rules.worsened_m, rules.worsened_ratio * without.flight_repeat.position_m)
    return ResidualBounds(
        force=max(rules.force_floor_m_s2, rules.equation_error_share * without.force.repeat),
        torque=max(rules.torque_floor_rad_s2, rules.equation_error_share * without.torque.repeat),
        line_ratio=rules.line_ratio_with_memory if has_memory else rules.line_ratio,
        flight_share=share,
        position_m=worsened_m,
    )


def residual_findings(residual: UnexplainedResidual, bounds: ResidualBounds, rules: Rules) -> list[Finding]:
    """Return findings on what of `residual` exceeds `bounds`."""
    findings = []
    flight_repeat = residual.flight_repeat
    if flight_repeat is not None:
        lower = flight_repeat.lower_share(rules)
        if lower > bounds.flight_share:
            findings.append(
                Finding(
                    code=Code.FLIGHTS_REPEAT,
                    value=lower,
                    bound=bounds.flight_share,
                    details={
                        "position_m": flight_repeat.position_m,
                        "amplitude": flight_repeat.amplitude,
                        "z": flight_repeat.z_score,
                    },
                )
            )
        if flight_repeat.position_m > bounds.position_m:
            findings.append(
                Finding(
                    code=Code.FLIGHTS_WORSENED,
                    value=flight_repeat.position_m,
                    bound=bounds.position_m,
                    unit="m",
                )
            )
    channels = (
        ("force", residual.force, bounds.force, Code.FORCE_REPEATS, Code.FORCE_RINGS),
        ("torque", residual.torque, bounds.torque, Code.TORQUE_REPEATS, Code.TORQUE_RINGS),
    )
    if flight_repeat is None or findings:
        findings += [
            Finding(
                code=repeats,
                value=channel.repeat,
                bound=bound,
                unit=CHANNEL_UNITS[name],
                details={"z": channel.z_score},
            )
            for name, channel, bound, repeats, _ in channels
            if channel.z_score > rules.repeat_z and channel.repeat > bound
        ]
    pulses = residual.pulses
    if pulses.ratio > rules.pulse_ratio and pulses.peak_m_s2 > rules.force_floor_m_s2:
        findings.append(
            Finding(
                code=Code.FORCE_PULSES,
                value=pulses.peak_m_s2,
                bound=rules.force_floor_m_s2,
                unit=CHANNEL_UNITS["force"],
                details={
                    "period_s": pulses.period_s,
                    "bearing_deg": math.degrees(pulses.bearing_rad),
                    "ratio": pulses.ratio,
                },
            )
        )
    findings += [
        Finding(
            code=rings, value=channel.line.ratio, bound=bounds.line_ratio, details={"hz": channel.line.hz}
        )
        for _, channel, bound, _, rings in channels
        if _rings(channel, bound, bounds.line_ratio, rules)
    ]
    return findings


def _rings(channel: ChannelResidual, floor: float, line_ratio: float, rules: Rules) -> bool:
    """Return whether the spectrum has a line that is strong, improbable under noise, and above `floor`."""
    line = channel.line
    return line.ratio > line_ratio and line.chance < rules.line_false_alarm and line.rms > floor
