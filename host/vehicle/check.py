"""Check of a vehicle file against a flight log.

The figures come from `fit`, the expected ranges from the file's tolerances, the verdicts are codes.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.spatial.transform import Rotation

from trimtab.firmware_model.law.allocation import command_to_thrust
from trimtab.host.base.errors import UsageError
from trimtab.host.vehicle.fit import (
    Estimate,
    Motion,
    ThrustFigures,
    TorqueFigures,
    Tracks,
    motion,
    thrust_figures,
    torque_figures,
)
from trimtab.host.vehicle.model import SPIN_SIGN, Vehicle

if TYPE_CHECKING:
    from trimtab.host.log import Flight

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
    """One number of a flight, the range that the vehicle file expects, and the verdict."""

    name: str
    value: float | None
    low: float
    high: float
    verdict: Verdict

    def to_json(self) -> dict[str, Any]:
        """Return the figure as plain data."""
        return {
            "name": self.name,
            "value": self.value,
            "low": self.low,
            "high": self.high,
            "verdict": self.verdict.value,
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


def check_flight(flight: Flight, vehicle: Vehicle | None = None, rules: Rules = RULES) -> Check:
    """Return how a vehicle file fits a flight; by default the file in its log.

    Raises UsageError if the log has less than two seconds in the air with inputs, rates and forces.
    """
    chosen = vehicle or flight.vehicle
    tracks = flight_tracks(flight)
    moved = None
    if tracks is not None and flight.tracking is not None:
        moved = motion(tracks, chosen, flight.tracking)
    thrust = None if moved is None else thrust_figures(moved, chosen.mass_kg)
    torque = None if moved is None else torque_figures(moved, chosen)
    if tracks is None or moved is None or (thrust is None and torque is None):
        raise UsageError(
            f"{flight.path}: less than two seconds in the air with motor commands or thrust, and "
            "with poses or inertial measurements; check another log"
        )
    return decide(
        thrust,
        torque,
        chosen,
        limits=_limit_figures(flight, tracks, moved, chosen),
        logged=flight.vehicle,
        unknown=flight.metadata.get("unknown", "").split(),
        voltage=None if flight.battery is None else float(np.median(flight.battery.battery_v)),
        rules=rules,
    )


def flight_tracks(flight: Flight) -> Tracks | None:
    """Return the tracks of a flight for `fit`; None without motor commands or thrust."""
    control, recorded, imu, mocap = flight.control, flight.recorded_inputs, flight.recorded_imu, flight.mocap
    if control is not None and len(control) > 1:
        sensed_us = control.sensed_us.mean(axis=1)
        return Tracks(
            input_us=0.5 * (control.t0_us + control.t1_us),
            motor_command=control.motor_mean,
            rate_us=sensed_us,
            rate_frd=control.gyro_mean,
            force_us=sensed_us,
            specific_force_frd=control.force_mean,
        )
    if recorded is None or len(recorded) < 2 or recorded.level == "reference":
        return None
    has_torque = "torque" not in flight.metadata.get("unknown", "").split()
    return Tracks(
        input_us=recorded.t_us + 0.5 * float(np.median(np.diff(recorded.t_us))),
        motor_command=recorded.motor,
        thrust_n=recorded.thrust_n,
        torque_n_m=recorded.torque_n_m if has_torque else None,
        rate_us=None if imu is None or imu.gyro is None else imu.t_us,
        rate_frd=None if imu is None else imu.gyro,
        force_us=None if imu is None or imu.specific_force is None else imu.t_us,
        specific_force_frd=None if imu is None else imu.specific_force,
        pose_us=None if mocap is None else mocap.t_us,
        p_ned=None if mocap is None else mocap.p,
        q_ned_frd=None if mocap is None else mocap.q,
    )


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


def _thrust(
    thrust: ThrustFigures | None, vehicle: Vehicle, uncalibrated: bool, voltage: float | None, rules: Rules
) -> list[Figure]:
    """Return scale and slope of the thrust and the forces across it."""
    share = 1.0 if voltage is None else max(voltage / vehicle.battery.full_v, 0.1)
    sd = 0.0 if thrust is None else thrust.scale.sd / max(abs(thrust.scale.value), 1e-9)
    spread = math.exp(
        rules.sigmas
        * math.hypot(
            vehicle.tolerance("thrust-gain", "gain", 0.01),
            vehicle.tolerance("mass", "factor", 0.01),
            vehicle.tolerance("battery-sag", "exponent", 0.1) * math.log(share),
            rules.thrust_model,
            sd,
        )
    )
    slope = None if thrust is None else thrust.slope
    sure = slope is not None and slope.sd < rules.slope_sd * max(1.0, abs(slope.value))
    forces = (None, None) if thrust is None else thrust.force_xyz[:2]
    return [
        _figure(
            "thrust", None if thrust is None else thrust.scale.value, 1.0 / spread, spread, not uncalibrated
        ),
        _figure("thrust-slope", slope.value if slope else None, *rules.slope, sure and not uncalibrated),
        *(
            _figure(f"force-{axis}", force, -rules.side_force, rules.side_force)
            for axis, force in zip("xy", forces, strict=True)
        ),
    ]


def _gains(torque: TorqueFigures | None, vehicle: Vehicle, free: bool, rules: Rules) -> list[Figure]:
    """Return the gain of the torque about each axis."""
    lag = vehicle.tolerance("motor-lag", "extra_s", 0.001) / vehicle.motor_lag_s
    gains: Sequence[Estimate | None] = (None, None, None) if torque is None else torque.gain
    figures = []
    for axis, key, gain in zip(AXES, "xyz", gains, strict=True):
        sd = 0.0 if gain is None else gain.sd / max(abs(gain.value), 1e-9)
        spread = math.exp(
            rules.sigmas
            * math.hypot(
                vehicle.tolerance("inertia", key, 0.04),
                vehicle.tolerance("thrust-gain", "gain", 0.01),
                rules.lag_share * lag,
                rules.torque_model,
                min(sd, rules.gain_sd),
            )
        )
        value = None if gain is None else gain.value
        figures.append(
            _figure(f"torque-{axis}", value, 1.0 / spread, spread, not free and sd < rules.gain_sd)
        )
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


def _limit_figures(flight: Flight, tracks: Tracks, moved: Motion, vehicle: Vehicle) -> list[Figure]:
    """Return the greatest thrust, speed, tilt and body rates of a flight against the file's limits."""
    limits = vehicle.limits
    inside = (tracks.input_us >= moved.t_us[0]) & (tracks.input_us <= moved.t_us[-1])
    if tracks.motor_command is not None:
        share = float(command_to_thrust(tracks.motor_command[inside].max(), 1.0, *vehicle.thrust_curve))
    else:
        assert tracks.thrust_n is not None
        share = float(tracks.thrust_n[inside].max()) / (4.0 * vehicle.thrust_max_n)
    thrust = _limit("thrust-share", share, limits.thrust_headroom[1])
    if share > 1.0 + 1e-3:  # more than the file says there is
        thrust = Figure(name="thrust-share", value=share, low=0.0, high=1.0, verdict=Verdict.DIFFERS)
    speed, tilt = _speed_and_tilt(flight)
    rates = np.abs(moved.rate_frd).max(axis=0)
    return [
        thrust,
        _limit("speed-m-s", speed, limits.speed_max_m_s),
        _limit("tilt-deg", tilt, limits.tilt_max_deg),
        *(
            _limit(f"rate-{axis}-rad-s", float(rate), limit)
            for axis, rate, limit in zip(AXES, rates, limits.body_rate_max_rad_s, strict=True)
        ),
    ]


def _limit(name: str, value: float | None, high: float) -> Figure:
    verdict = Verdict.UNKNOWN if value is None else Verdict.FITS if value <= high else Verdict.BEYOND
    return Figure(name=name, value=value, low=0.0, high=high, verdict=verdict)


def _speed_and_tilt(flight: Flight) -> tuple[float | None, float | None]:
    """Return greatest speed (m/s, over 0.2 s) and tilt (deg) of the tracking phase, from the poses."""
    mocap = flight.mocap
    if mocap is None or flight.tracking is None:
        return None, None
    inside = (mocap.t_us >= flight.tracking[0]) & (mocap.t_us <= flight.tracking[1])
    if inside.sum() < 2:
        return None, None
    t_us, p = mocap.t_us[inside], mocap.p[inside]
    at_us = np.arange(t_us[0], t_us[-1] - 200_000, 50_000)
    shifted = [np.column_stack([np.interp(at_us + d, t_us, p[:, k]) for k in range(3)]) for d in (0, 200_000)]
    moved = np.linalg.norm(shifted[1] - shifted[0], axis=1) / 0.2
    up = Rotation.from_quat(mocap.q[inside], scalar_first=True).as_matrix()[:, 2, 2]
    tilt = float(np.rad2deg(np.arccos(np.clip(up.min(), -1.0, 1.0))))
    return float(moved.max()) if len(moved) else None, tilt


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


def to_lines(check: Check) -> list[str]:
    """Return the check as lines of text: figure, value, expected range, verdict."""
    lines = []
    for figure in check.figures:
        value = "-" if figure.value is None else f"{figure.value:.3g}"
        expected = f"{figure.low:.3g} to {figure.high:.3g}"
        lines.append(f"{_WHAT[figure.name]:44} {value:>8}  {expected:>16}  {figure.verdict}")
    told = check.assignment.to_json()
    order, spins = (told[name] for name in ("order", "spins"))
    lines.append(
        f"{'motor command of each rotor':44} {'-' if order is None else ' '.join(map(str, order)):>8}  "
        f"{'1 2 3 4':>16}  {told['order_verdict']}"
    )
    lines.append(f"{'spins':44} {'-' if spins is None else ' '.join(spins):>26}  {told['spins_verdict']}")
    return lines
