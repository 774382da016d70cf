"""Verdicts on how a vehicle file fits a flight, as codes, and their words.

The figures come from `fit`, the expected ranges from the file's tolerances. `log_check` takes a log.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Any

from trimtab.host.vehicle.fit import Estimate, ThrustFigures, TorqueFigures
from trimtab.host.vehicle.model import SPIN_SIGN, Vehicle

AXES = ("roll", "pitch", "yaw")


class Verdict(StrEnum):
    """What a figure says of the file."""

    FITS = "fits"
    DIFFERS = "differs"
    UNKNOWN = "unknown"
    """The log does not determine the figure."""
    BEYOND = "beyond"
    """The flight left a limit of the file. Limits bound plans; the file fits all the same."""


@dataclass(frozen=True, kw_only=True)
class Rules:
    """Thresholds of the verdicts. Calibrated on simulated flights, see `tests/host/vehicle`."""

    sigmas: float = 4.0
    """Half the expected range over its standard deviation: tolerances and scatter within the flight."""
    thrust_model: float = 0.01
    """One sigma, relative, of the thrust that no vehicle file states: inflow, drag along the thrust."""
    torque_model: float = 0.08
    """One sigma, relative, of a torque's gain that the method leaves."""
    lag_share: float = 0.3
    """Relative error of a torque's gain over a relative error of the motor lag."""
    slope: tuple[float, float] = (0.6, 1.6)
    """Change of thrust over its level: an offset of the command leaves this range."""
    slope_sd: float = 0.1
    """Standard deviation of that ratio, relative if it is above 1, from which on it is unknown."""
    side_force: float = 0.15
    """Mean specific force across the thrust, over gravity."""
    gain_sd: float = 0.25
    """Standard deviation of a torque's gain, over the gain, above which it is unknown."""
    margin: float = 12.0
    """Log-likelihood by which another order or other spins contradict the file."""
    lead: float = 8.0
    """Log-likelihood by which the file's own order or spins must lead to be confirmed."""


RULES = Rules()


@dataclass(frozen=True, kw_only=True)
class Figure:
    """One number of a flight, the range that the vehicle file expects, and the verdict.

    by_wide_tolerance: it fits, but would differ with the tolerances of measured values.
    """

    name: str
    value: float | None
    low: float
    high: float
    verdict: Verdict
    by_wide_tolerance: bool = False

    def to_json(self) -> dict[str, Any]:
        """Return the figure as plain data."""
        return {
            "name": self.name,
            "value": self.value,
            "low": self.low,
            "high": self.high,
            "verdict": self.verdict.value,
            "by_wide_tolerance": self.by_wide_tolerance,
        }


@dataclass(frozen=True, kw_only=True)
class Assignment:
    """Motor command and spin of each rotor of the file, as the flight shows them. None: it does not."""

    order: tuple[int, ...] | None
    order_verdict: Verdict
    spins: tuple[int, ...] | None
    spins_verdict: Verdict

    def to_json(self) -> dict[str, Any]:
        """Return motors counted from 1 and spins as in the vehicle file."""
        words = {sign: word for word, sign in SPIN_SIGN.items()}
        return {
            "order": None if self.order is None else [k + 1 for k in self.order],
            "order_verdict": self.order_verdict.value,
            "spins": None if self.spins is None else [words[sign] for sign in self.spins],
            "spins_verdict": self.spins_verdict.value,
        }


@dataclass(frozen=True, kw_only=True)
class Check:
    """How a vehicle file fits a log."""

    figures: tuple[Figure, ...]
    assignment: Assignment

    @property
    def fits(self) -> bool:
        """Whether nothing contradicts the file."""
        return Verdict.DIFFERS not in self._verdicts

    @property
    def _verdicts(self) -> list[Verdict]:
        both = (self.assignment.order_verdict, self.assignment.spins_verdict)
        return [*(figure.verdict for figure in self.figures), *both]

    @property
    def differing(self) -> list[str]:
        """Names of what contradicts the file."""
        names = [figure.name for figure in self.figures if figure.verdict is Verdict.DIFFERS]
        pairs = (("order", self.assignment.order_verdict), ("spins", self.assignment.spins_verdict))
        return [*names, *(name for name, verdict in pairs if verdict is Verdict.DIFFERS)]


def decide(
    thrust: ThrustFigures | None,
    torque: TorqueFigures | None,
    vehicle: Vehicle,
    *,
    limits: Sequence[Figure] = (),
    logged: Vehicle | None = None,
    unknown: Sequence[str] = (),
    voltage: float | None = None,
    rules: Rules = RULES,
) -> Check:
    """Return the verdicts on figures of a flight.

    Parameters
    ----------
    thrust, torque
        Figures of `fit`.
    vehicle
        File that is checked.
    limits
        Figures that are already decided.
    logged
        Vehicle that the log declares. Default: the one that is checked.
    unknown
        Properties that the log declares unknown; the figures that depend on them stay unknown.
    voltage
        Median battery voltage, V.
    """
    declared = logged or vehicle
    mass_sigma = math.hypot(
        vehicle.tolerance("mass", "factor", 0.01), declared.tolerance("mass", "factor", 0.01)
    )
    sigma = rules.sigmas
    figures = [
        _figure("mass", declared.mass_kg, vehicle.mass_kg * math.exp(-sigma * mass_sigma),
                vehicle.mass_kg * math.exp(sigma * mass_sigma)),
        *_thrust(thrust, vehicle, "thrust-curve" in unknown, voltage, rules),
        *_gains(torque, vehicle, bool({"torque", "inertia"} & set(unknown)), rules),
        *limits,
    ]  # fmt: skip
    return Check(figures=tuple(figures), assignment=_assignment(torque, rules))


def _figure(name: str, value: float | None, low: float, high: float, known: bool = True) -> Figure:
    """Return a figure with its verdict by number."""
    if value is None or not known:
        verdict = Verdict.UNKNOWN
    else:
        verdict = Verdict.FITS if low <= value <= high else Verdict.DIFFERS
    return Figure(name=name, value=value, low=low, high=high, verdict=verdict)


@dataclass(frozen=True, kw_only=True)
class _Tolerance:
    """A tolerance that a ratio depends on. usual: that of a measured value. weight: share in the ratio."""

    effect: str
    parameter: str
    usual: float
    weight: float = 1.0


def _ratio(
    name: str,
    value: float | None,
    vehicle: Vehicle,
    tolerances: Sequence[_Tolerance],
    others: Sequence[float],
    known: bool,
    rules: Rules,
) -> Figure:
    """Return a figure that is 1 for a perfect file. others: relative sigmas beside the file's tolerances."""

    def spread(sigmas: Sequence[float]) -> float:
        weighted = [t.weight * sigma for t, sigma in zip(tolerances, sigmas, strict=True)]
        return math.exp(rules.sigmas * math.hypot(*weighted, *others))

    stated = spread([vehicle.tolerance(t.effect, t.parameter, t.usual) for t in tolerances])
    usual = spread([t.usual for t in tolerances])
    figure = _figure(name, value, 1.0 / stated, stated, known)
    if value is None or figure.verdict is not Verdict.FITS:
        return figure
    return replace(figure, by_wide_tolerance=not 1.0 / usual <= value <= usual)


def _thrust(
    thrust: ThrustFigures | None, vehicle: Vehicle, uncalibrated: bool, voltage: float | None, rules: Rules
) -> list[Figure]:
    """Return scale and slope of the thrust and the forces across it."""
    share = 1.0 if voltage is None else max(voltage / vehicle.battery.full_v, 0.1)
    sd = 0.0 if thrust is None else thrust.scale.sd / max(abs(thrust.scale.value), 1e-9)
    tolerances = (
        _Tolerance(effect="thrust-gain", parameter="gain", usual=0.01),
        _Tolerance(effect="mass", parameter="factor", usual=0.01),
        _Tolerance(effect="battery-sag", parameter="exponent", usual=0.1, weight=math.log(share)),
    )
    scale = None if thrust is None else thrust.scale.value
    slope = None if thrust is None else thrust.slope
    sure = slope is not None and slope.sd < rules.slope_sd * max(1.0, abs(slope.value))
    forces = (None, None) if thrust is None else thrust.force_xyz[:2]
    return [
        _ratio("thrust", scale, vehicle, tolerances, (rules.thrust_model, sd), not uncalibrated, rules),
        _figure("thrust-slope", slope.value if slope else None, *rules.slope, sure and not uncalibrated),
        *(
            _figure(f"force-{axis}", force, -rules.side_force, rules.side_force)
            for axis, force in zip("xy", forces, strict=True)
        ),
    ]


def _gains(torque: TorqueFigures | None, vehicle: Vehicle, free: bool, rules: Rules) -> list[Figure]:
    """Return the gain of the torque about each axis."""
    by_lag = rules.lag_share / vehicle.motor_lag_s
    gains: Sequence[Estimate | None] = (None, None, None) if torque is None else torque.gain
    figures = []
    for axis, key, gain in zip(AXES, "xyz", gains, strict=True):
        sd = 0.0 if gain is None else gain.sd / max(abs(gain.value), 1e-9)
        tolerances = (
            _Tolerance(effect="inertia", parameter=key, usual=0.04),
            _Tolerance(effect="thrust-gain", parameter="gain", usual=0.01),
            _Tolerance(effect="motor-lag", parameter="extra_s", usual=0.001, weight=by_lag),
        )
        value, others = None if gain is None else gain.value, (rules.torque_model, min(sd, rules.gain_sd))
        known = not free and sd < rules.gain_sd
        figures.append(_ratio(f"torque-{axis}", value, vehicle, tolerances, others, known, rules))
    return figures


def _assignment(torque: TorqueFigures | None, rules: Rules) -> Assignment:
    """Return order and spins with their verdicts."""
    if torque is None or torque.order is None or torque.spins is None:
        return Assignment(
            order=None, order_verdict=Verdict.UNKNOWN, spins=None, spins_verdict=Verdict.UNKNOWN
        )

    def verdict(margin: float, lead: float) -> Verdict:
        if margin > rules.margin:
            return Verdict.DIFFERS
        return Verdict.FITS if margin == 0.0 and lead > rules.lead else Verdict.UNKNOWN

    order, spins = (
        verdict(torque.order_margin, torque.order_lead),
        verdict(torque.spins_margin, torque.spins_lead),
    )
    return Assignment(
        order=None if order is Verdict.UNKNOWN else torque.order,
        order_verdict=order,
        spins=None if spins is Verdict.UNKNOWN or order is Verdict.UNKNOWN else torque.spins,
        spins_verdict=Verdict.UNKNOWN if order is Verdict.UNKNOWN else spins,
    )


_WHAT = {
    "mass": "mass that the log declares, kg",
    "thrust": "measured over commanded thrust, steady flight",
    "thrust-slope": "change of thrust with its command",
    "force-x": "force along x over weight, steady flight",
    "force-y": "force along y over weight, steady flight",
    "torque-roll": "angular acceleration over expected, roll",
    "torque-pitch": "angular acceleration over expected, pitch",
    "torque-yaw": "angular acceleration over expected, yaw",
    "thrust-share": "greatest commanded thrust of a rotor, share",
    "speed-m-s": "greatest speed, m/s",
    "tilt-deg": "greatest tilt, deg",
    "rate-roll-rad-s": "greatest roll rate, rad/s",
    "rate-pitch-rad-s": "greatest pitch rate, rad/s",
    "rate-yaw-rad-s": "greatest yaw rate, rad/s",
}
"""Description of each figure."""


_BY_TOLERANCE = " only by a wide tolerance"


def to_lines(check: Check) -> list[str]:
    """Return the check as lines of text: figure, value, expected range, verdict."""
    lines = []
    for figure in check.figures:
        value = "-" if figure.value is None else f"{figure.value:.3g}"
        expected = f"{figure.low:.3g} to {figure.high:.3g}"
        verdict = f"{figure.verdict}{_BY_TOLERANCE if figure.by_wide_tolerance else ''}"
        lines.append(f"{_WHAT[figure.name]:44} {value:>8}  {expected:>16}  {verdict}")
    told = check.assignment.to_json()
    order, spins = (told[name] for name in ("order", "spins"))
    lines.append(
        f"{'motor command of each rotor':44} {'-' if order is None else ' '.join(map(str, order)):>8}  "
        f"{'1 2 3 4':>16}  {told['order_verdict']}"
    )
    lines.append(f"{'spins':44} {'-' if spins is None else ' '.join(spins):>26}  {told['spins_verdict']}")
    if any(figure.by_wide_tolerance for figure in check.figures):
        lines.append(
            f"{Verdict.FITS}{_BY_TOLERANCE}: with the tolerances of measured values it would differ, so the "
            "file may be wrong by that much; measure its guesses and lower their tolerances"
        )
    return lines
