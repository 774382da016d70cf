"""Choice of the next flight: separation of an effect from its alias, by the flights so far and a manoeuvre.

The separation is computed in the linearisation of command-driven segments, also if the search used whole
flights in closed loop. The motion of the vehicle determines how well a flight separates two effects, however
the flight is predicted.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from trimtab.firmware_model.law.flatness import Body, flat_full
from trimtab.firmware_model.law.rotations import matrix_to_euler
from trimtab.host.codegen.ops import NUMPY
from trimtab.host.trace import evidence
from trimtab.host.trace.data.cutting import DT_S, LAGS, SEGMENT_S
from trimtab.host.trace.data.segments import BIN_S, PATH_S, Segments
from trimtab.host.trace.decision.rules import RULES
from trimtab.host.trace.evidence import DisturbanceVariances, Prior
from trimtab.host.trace.next_flight.manoeuvres import Manoeuvre
from trimtab.host.trace.parameters import ParameterSpace
from trimtab.host.trace.segment_fit import linearise, rollout
from trimtab.host.trace.segment_fit.fit import SegmentFit
from trimtab.host.trace.segment_fit.model import NUISANCES, SegmentModel
from trimtab.host.vehicle import Vehicle
from trimtab.host.vehicle.allocation import allocation_inverse

SIGMA_MAX = 100.0
"""Greatest separation that is reported. Beyond it a linearisation is inaccurate, but the flight decides."""

_ROLLED = 12
"""Segments of a manoeuvre that are rolled out, evenly spaced. Others count as the nearest of them."""

_TURNS = 2
"""Roll-outs from which the disturbance that keeps a manoeuvre on its path is computed."""


@dataclass(frozen=True, kw_only=True)
class NextFlight:
    """The flight that separates two effects best.

    Attributes
    ----------
    route
        Name of the route.
    total_time_s
        Duration of the plan; None if the vehicle can fly the route in the duration that it states.
    separates
        The effect and its alias.
    so_far_sigma
        Separation by the flights so far.
    expected_sigma
        Separation by the flights so far and this one, at most SIGMA_MAX.
    known_measurement
        Measurement that would decide between the two without a flight; None if none is known.
    """

    route: str
    total_time_s: float | None
    separates: tuple[str, str]
    so_far_sigma: float
    expected_sigma: float
    known_measurement: str | None = None

    @property
    def decides(self) -> bool:
        """Whether the flight is expected to separate the two effects by RULES.detectable_sigma."""
        return self.expected_sigma >= RULES.detectable_sigma

    @property
    def measurement(self) -> str | None:
        """Measurement that decides instead; None if the flight decides or no measurement is known."""
        return None if self.decides else self.known_measurement

    def to_json(self) -> dict[str, Any]:
        """Return the JSON object `next_flight`."""
        return {
            "route": self.route,
            "total_time_s": self.total_time_s,
            "separates": list(self.separates),
            "so_far_sigma": self.so_far_sigma,
            "expected_sigma": self.expected_sigma,
            "decides": self.decides,
            "measurement": self.measurement,
        }


@dataclass(frozen=True, kw_only=True, eq=False)
class Instruments:
    """Sensors, battery and disturbance that a planned flight is assumed to have.

    Attributes
    ----------
    sigma
        Standard deviations (4,) of means over DT_S: position m, attitude rad, body rate rad/s, specific force
        m/s^2.
    shares
        Shares (3,) of the steps that have a pose, a body rate and a specific force.
    voltage
        Battery voltage over full voltage at the start, and its slope in 1/s (2,).
    process
        Process disturbance.
    in_newton
        Whether commands are rotor thrusts in N.
    rate_driven
        Whether the measured body rate drives the attitude.
    """

    sigma: np.ndarray
    shares: np.ndarray
    voltage: np.ndarray
    process: DisturbanceVariances
    in_newton: bool
    rate_driven: bool

    def __post_init__(self) -> None:
        if self.sigma.shape != (4,) or not (self.sigma > 0).all():
            raise ValueError(f"sigma {self.sigma} must be four positive numbers")
        if self.shares.shape != (3,) or self.voltage.shape != (2,):
            raise ValueError(f"{self.shares} must be three shares, {self.voltage} a ratio and its slope")

    @classmethod
    def of(cls, fit: SegmentFit) -> Instruments:
        """Return the mean sensors and battery of the fitted flights, with the process of the fit."""
        data = fit.data
        t_s = np.repeat(data.start_s[:, None], data.steps, axis=1) + DT_S * np.arange(data.steps)
        slope, start = np.polyfit(t_s.ravel(), data.voltage_ratio.ravel(), 1)
        return cls(
            sigma=data.sigma.mean(0),
            shares=np.array([w.mean() for w in (data.pose_weight, data.rate_weight, data.force_weight)]),
            voltage=np.array([start, slope]),
            process=fit.process,
            in_newton=data.in_newton,
            rate_driven=data.rate_driven,
        )


def separation(
    space: ParameterSpace,
    gram: np.ndarray,
    present: Iterable[str],
    theta_scaled: np.ndarray,
    effect: str,
    alias: str,
    *,
    prior: Prior | None = None,
) -> float:
    """Return by how many sigma `effect` stands out if `alias` may take any size.

    lambda^2 = theta' S' (I - Q) S theta. S holds the whitened slopes of all parameters. Q projects on the
    alias and the other present effects, free under the slab of the prior, and on all other parameters, under
    the spike.

    Parameters
    ----------
    space
        Parameter space.
    gram
        S' S (P, P).
    present
        Candidates that are present.
    theta_scaled
        Scaled parameters (P,) that give the size of `effect`.
    effect, alias
        Candidates to separate.
    prior
        Prior of the parameters; that of segment fits if None.
    """
    columns = list(space.groups[effect])
    others = [i for i in range(len(space.columns)) if i not in columns]
    free = [name for name in present if name != effect]
    inner = gram[np.ix_(others, others)] + np.diag((prior or space.prior).precision([*free, alias])[others])
    cross = gram[np.ix_(others, columns)]
    information = gram[np.ix_(columns, columns)] - cross.T @ np.linalg.solve(inner, cross)
    return float(np.sqrt(max(theta_scaled[columns] @ information @ theta_scaled[columns], 0.0)))


def propose(
    segment_model: SegmentModel, fit: SegmentFit, effect: str, alias: str, known: Sequence[Manoeuvre]
) -> NextFlight | None:
    """Return the manoeuvre that separates `effect` from `alias` best; None if there is no manoeuvre.

    The separation includes the information of the fitted flights, limited to RULES.undecided_sigma. If one of
    the two acts through an effect that was not selected, such as wind through a drag, that effect is assumed
    present and free, at typical size. So is `effect` itself if it was not selected.

    Parameters
    ----------
    segment_model
        Model of the segments.
    fit
        Fit of the selected set.
    effect, alias
        Candidates to separate.
    known
        Manoeuvres to choose from.
    """
    space = segment_model.space
    carriers = _carriers(space, fit.effects, (effect, alias))
    theta_scaled = fit.theta_scaled.copy()
    for name in (*carriers, *({effect} - set(fit.effects))):
        theta_scaled[list(space.groups[name])] = 1.0
    instruments = Instruments.of(fit)
    present = {*fit.effects, *carriers}

    def sigma(gram: np.ndarray) -> float:
        return separation(space, gram, present, theta_scaled, effect, alias)

    so_far = _flown_information(segment_model, fit, theta_scaled)
    # The search left the alias open, so the flights cannot separate the two by more than undecided_sigma.
    # Segments overestimate the separation, above all of timing effects, since commands contain noise.
    while (before := sigma(so_far)) > RULES.undecided_sigma:
        so_far *= 0.9 * (RULES.undecided_sigma / before) ** 2

    best, greatest = None, -1.0
    for candidate in known:
        added = information(segment_model, candidate.flat, theta_scaled, instruments)
        if added is None:
            continue
        expected = sigma(so_far + added)
        if expected > greatest:
            best, greatest = candidate, expected
    if best is None:
        return None
    return NextFlight(
        route=best.route,
        total_time_s=best.total_time_s if best.slowed else None,
        separates=(effect, alias),
        so_far_sigma=before,
        expected_sigma=min(greatest, SIGMA_MAX),
        known_measurement=_measurement(space, effect, alias),
    )


def _measurement(space: ParameterSpace, effect: str, alias: str) -> str | None:
    """Return the measurement that separates the two without a flight; either effect may state it."""
    first, second = space.effect(effect), space.effect(alias)
    return first.separated_by.get(second.name) or second.separated_by.get(first.name)


def information(
    segment_model: SegmentModel, flat: np.ndarray, theta_scaled: np.ndarray, instruments: Instruments
) -> np.ndarray | None:
    """Return the information (P, P) of one flight along flat outputs; None if it is too short.

    It is S' S of the whitened slopes S, with the nuisances of the flight integrated out. A flight is too
    short if it holds no segment.

    Parameters
    ----------
    segment_model
        Model of the segments.
    flat
        Flat outputs (14, n) every DT_S, as in `Manoeuvre.flat`.
    theta_scaled
        Scaled parameters (P,) of the linearisation.
    instruments
        Sensors, battery and disturbance of the flight.
    """
    data = _along(segment_model.vehicle, flat, instruments)
    if data is None:
        return None
    count = len(data.flight)
    rolled = np.unique(np.round(np.linspace(0, count - 1, min(count, _ROLLED))).astype(int))
    nearest = np.abs(np.arange(count)[:, None] - rolled).argmin(axis=1)
    part, nuisances = data.take(rolled), np.zeros((1, NUISANCES))
    part = _kept_on_path(segment_model, part, theta_scaled)
    basis = linearise.basis(segment_model, part, theta_scaled, nuisances)
    lin = linearise.project(
        linearise.linearise(segment_model, part, theta_scaled, nuisances, basis),
        part,
        theta_scaled,
        nuisances,
    )
    lin = replace(lin, gram=lin.gram[nearest], flight=data.flight)
    return evidence.whitened(lin, instruments.process, segment_model.space.prior).gram[1:, 1:]


def _kept_on_path(segment_model: SegmentModel, data: Segments, theta_scaled: np.ndarray) -> Segments:
    """Return the segments with a disturbance that keeps roll-outs at theta_scaled (P,) on their path.

    The commands are those of the nominal vehicle, so a roll-out at theta_scaled would leave the path. The
    disturbance is an angular acceleration, computed from the error of the body rate. Forces do not rotate the
    vehicle and are not compensated.
    """
    start = data.x0.T[:, None, :]
    nuisances = np.zeros((NUISANCES, *start.shape[1:]))
    per_bin = round(BIN_S / data.dt_s)
    for _ in range(_TURNS):
        predicted = rollout.roll_out(segment_model, data, start, theta_scaled[:, None], nuisances)[:, 6:9, 0]
        error = data.rate_frd - np.transpose(predicted, (2, 0, 1))
        inner = 0.5 * (error[:, per_bin - 1 : -1 : per_bin] + error[:, per_bin::per_bin])
        edges = np.concatenate([np.zeros_like(error[:, :1]), inner, error[:, -1:]], axis=1)
        w = data.disturbance_frd.copy()
        w[:, :, 3:] += np.diff(edges, axis=1) / BIN_S
        data = data.with_w(w)
    return data


def _flown_information(segment_model: SegmentModel, fit: SegmentFit, theta_scaled: np.ndarray) -> np.ndarray:
    """Return the information (P, P) of the fitted flights, linearised at theta_scaled (P,)."""
    lin = fit.lin
    if not np.array_equal(theta_scaled, fit.theta_scaled):
        grams = linearise.linearise(segment_model, fit.data, theta_scaled, fit.nuisances, fit.basis)
        lin = linearise.project(grams, fit.data, theta_scaled, fit.nuisances)
    return evidence.whitened(lin, fit.process, segment_model.space.prior).gram[1:, 1:]


def _carriers(space: ParameterSpace, selected: Sequence[str], pair: Sequence[str]) -> list[str]:
    """Return the effects to assume present because an effect of `pair` acts through them.

    For each effect of the pair whose required effects are neither selected nor in the pair, that is the first
    required effect that the space holds.
    """
    carriers = []
    for name in pair:
        required = space.effect(name).requires_any
        if required and not set(required) & {*selected, *pair}:
            carriers += [other for other in required if other in space.groups][:1]
    return list(dict.fromkeys(carriers))


def _along(vehicle: Vehicle, flat: np.ndarray, instruments: Instruments) -> Segments | None:
    """Return the segments of a flight that follows flat outputs (14, n) exactly; None if it is too short."""
    steps = round(SEGMENT_S / DT_S)
    pre = max(1, int(np.ceil(LAGS * vehicle.motor_lag_s / DT_S)))
    count = (flat.shape[1] - pre - 1) // steps
    if count < 1:
        return None
    thrust, R, rate = flat_commands(vehicle, flat)
    if instruments.in_newton:
        command = thrust
    else:
        c1, c2 = vehicle.thrust_curve
        share = np.clip(thrust / vehicle.thrust_max_n, 0.0, 1.0)
        command = share if c2 == 0 else (np.sqrt(c1 * c1 + 4 * c2 * share) - c1) / (2 * c2)
    rpy = np.array(matrix_to_euler(NUMPY, list(R.T))).T
    first = pre + steps * np.arange(count)
    inside = first[:, None] + np.arange(steps)
    with_run_up = first[:, None] + np.arange(-pre, steps)
    n = (count, steps)
    start, slope = instruments.voltage
    # A measurement in a share s of the steps has the information of one of weight sqrt(s) in every step.
    pose, gyro, accelerometer = np.sqrt(instruments.shares)
    return Segments(
        dt_s=DT_S,
        flight=np.zeros(count, dtype=int),
        start_s=first * DT_S,
        x0=np.column_stack([flat[0:3, first].T, flat[3:6, first].T, rpy[first], rate[first]]),
        p_ned=flat[0:3].T[inside],
        R_ned_frd=R[inside],
        shift_s=np.zeros(n),
        pose_weight=np.full(n, pose),
        rate_frd=rate[inside],
        rate_weight=np.full(n, gyro),
        force_frd=np.zeros((*n, 3)),
        force_weight=np.full(n, accelerometer),
        command=command[with_run_up],
        voltage_ratio=start + slope * DT_S * inside,
        sigma=np.repeat(instruments.sigma[None], count, axis=0),
        disturbance_frd=np.zeros((count, round(SEGMENT_S / BIN_S), 6)),
        path_start_s=first * DT_S,
        paths=np.column_stack([flat[0:3].T, flat[3:6].T, rpy, rate])[None, :: round(PATH_S / DT_S)],
        in_newton=instruments.in_newton,
        rate_driven=instruments.rate_driven,
    )


def flat_commands(vehicle: Vehicle, flat: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the nominal rotor thrusts, attitude and body rate along flat outputs.

    flat (14, n): flat outputs every DT_S, as in `Manoeuvre.flat`. Returns rotor thrusts (n, 4) in N,
    R_ned_frd (n, 9), row-major, and body rate (n, 3) in rad/s, FRD.
    """
    snap = np.gradient(flat[9:12], DT_S, axis=1)
    body = Body(vehicle.mass_kg, vehicle.inertia_kg_m2)
    R, rate, _, collective, torque = flat_full(
        NUMPY, list(flat[6:9]), list(flat[9:12]), list(snap), flat[12], flat[13], body
    )
    shape = flat.shape[1]
    wrench = np.array([np.broadcast_to(row, shape) for row in (collective, *torque)])
    attitude = np.array([np.broadcast_to(row, shape) for row in R]).T
    return (
        (allocation_inverse(vehicle) @ wrench).T,
        attitude,
        np.array([np.broadcast_to(r, shape) for r in rate]).T,
    )
