"""Which flight would tell two effects apart: the separation of an effect from its alias, by what was flown so
far and one manoeuvre more.

Everything is counted in the command-driven segments' linearisation, also where the search went over the
closed loop: what a flight tells two forces apart by is in what the vehicle does, however it is predicted.
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
from trimtab.host.trace.evidence import Prior, Process
from trimtab.host.trace.next_flight.manoeuvres import Manoeuvre
from trimtab.host.trace.parameters import ParameterSpace
from trimtab.host.trace.segment_fit import linearise, rollout
from trimtab.host.trace.segment_fit.fit import SegmentFit
from trimtab.host.trace.segment_fit.model import LOCALS, SegmentModel
from trimtab.host.vehicle import Vehicle
from trimtab.host.vehicle.allocation import allocation_inverse

SIGMA_MAX = 100.0
"""More is not told: so far out a linearisation means nothing but that the flight decides."""

_ROLLED = 12
"""Segments of a manoeuvre that are rolled out, spread evenly; each other one counts as its nearest."""

_TURNS = 2
"""Roll-outs after which a disturbance keeps a manoeuvre on its path."""


@dataclass(frozen=True, kw_only=True)
class NextFlight:
    """The flight that tells two effects apart best.

    total_time_s: of the reference, where the route's own time is too short for the vehicle. so_far_sigma: by
    what was flown; expected_sigma: by that and this flight, at most SIGMA_MAX. known_measurement: what would
    decide between the two without a flight.
    """

    route: str
    total_time_s: float | None
    separates: tuple[str, str]
    so_far_sigma: float
    expected_sigma: float
    known_measurement: str | None = None

    @property
    def decides(self) -> bool:
        """Whether it is expected to."""
        return self.expected_sigma >= RULES.detectable_sigma

    @property
    def measurement(self) -> str | None:
        """What decides instead, where the flight does not and something is known."""
        return None if self.decides else self.known_measurement

    def to_json(self) -> dict[str, Any]:
        """Return the object `next_flight` of `trimtab trace`."""
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
    """What a flight is measured with and disturbed by.

    sigma (4,): position m, attitude rad, body rate rad/s, specific force m/s^2, of means over DT_S.
    shares (3,): of the steps that have a pose, a body rate, a specific force. voltage (2,): ratio to the
    full one at the start, and its slope, 1/s.
    """

    sigma: np.ndarray
    shares: np.ndarray
    voltage: np.ndarray
    process: Process
    in_newton: bool
    rate_driven: bool

    def __post_init__(self) -> None:
        if self.sigma.shape != (4,) or not (self.sigma > 0).all():
            raise ValueError(f"sigma {self.sigma} must be four positive numbers")
        if self.shares.shape != (3,) or self.voltage.shape != (2,):
            raise ValueError(f"{self.shares} must be three shares, {self.voltage} a ratio and its slope")

    @classmethod
    def of(cls, fit: SegmentFit) -> Instruments:
        """Those of the fitted flights, with the process noise of the fit."""
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
    """Sigma by which `effect` at its size in theta_scaled (P,) stands out where `alias` may take any size.

    lambda^2 = theta' S' (I - P) S theta, with gram = S' S (P, P) of the whitened columns of all scaled
    parameters. P projects on the alias and on the other effects that are `present`, all free within what an
    effect may have, and on everything else within its tolerance: by the segments' `prior` unless another one
    is given.
    """
    mine = list(space.groups[effect])
    rest = [i for i in range(len(space.columns)) if i not in mine]
    free = [name for name in present if name != effect]
    inner = gram[np.ix_(rest, rest)] + np.diag((prior or space.prior).precision([*free, alias])[rest])
    cross = gram[np.ix_(rest, mine)]
    information = gram[np.ix_(mine, mine)] - cross.T @ np.linalg.solve(inner, cross)
    return float(np.sqrt(max(theta_scaled[mine] @ information @ theta_scaled[mine], 0.0)))


def propose(
    segment_model: SegmentModel, fit: SegmentFit, effect: str, alias: str, known: Sequence[Manoeuvre]
) -> NextFlight | None:
    """Return the manoeuvre after which `effect` and `alias` are furthest apart; None where none is known.

    Counted with what the fitted flights tell already, at most what leaves them undecided. Where one of the
    two acts through an effect that was not found (wind through a drag), that is taken at its typical size and
    free; so is `effect` itself where the fit has none.
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

    so_far = _flown(segment_model, fit, theta_scaled)
    # Flights that leave an alias open tell no more than that: noise in the commands makes segments believe in
    # more, of timing above all.
    while (before := sigma(so_far)) > RULES.undecided_sigma:
        so_far *= 0.9 * (RULES.undecided_sigma / before) ** 2

    best, most = None, -1.0
    for candidate in known:
        told = information(segment_model, candidate.flat, theta_scaled, instruments)
        if told is None:
            continue
        expected = sigma(so_far + told)
        if expected > most:
            best, most = candidate, expected
    if best is None:
        return None
    return NextFlight(
        route=best.route,
        total_time_s=best.total_time_s if best.slowed else None,
        separates=(effect, alias),
        so_far_sigma=before,
        expected_sigma=min(most, SIGMA_MAX),
        known_measurement=_measurement(space, effect, alias),
    )


def _measurement(space: ParameterSpace, effect: str, alias: str) -> str | None:
    """Return what to measure where no flight tells the two apart, as either of them states it."""
    one, other = space.effect(effect), space.effect(alias)
    return one.separated_by.get(other.name) or other.separated_by.get(one.name)


def information(
    segment_model: SegmentModel, flat: np.ndarray, theta_scaled: np.ndarray, instruments: Instruments
) -> np.ndarray | None:
    """Return the information (P, P) at theta_scaled (P,) of one flight along flat outputs (14, n) each DT_S.

    The whitened S' S, the flight's own nuisances integrated out. None where it is shorter than a segment.
    """
    data = _along(segment_model.vehicle, flat, instruments)
    if data is None:
        return None
    count = len(data.flight)
    rolled = np.unique(np.round(np.linspace(0, count - 1, min(count, _ROLLED))).astype(int))
    nearest = np.abs(np.arange(count)[:, None] - rolled).argmin(axis=1)
    part, local = data.take(rolled), np.zeros((1, LOCALS))
    part = _kept_on_path(segment_model, part, theta_scaled)
    kept = linearise.basis(segment_model, part, theta_scaled, local)
    lin = linearise.project(
        linearise.linearise(segment_model, part, theta_scaled, local, kept), part, theta_scaled, local
    )
    lin = replace(lin, gram=lin.gram[nearest], flight=data.flight)
    return evidence.whitened(lin, instruments.process, segment_model.space.prior).gram[1:, 1:]


def _kept_on_path(segment_model: SegmentModel, data: Segments, theta_scaled: np.ndarray) -> Segments:
    """Return the segments with the angular acceleration that keeps roll-outs on their path.

    At theta_scaled (P,). The commands are the nominal vehicle's; with theta_scaled it would need others.

    Read off the body rate. Forces are left alone, they turn nothing.
    """
    start = data.x0.T[:, None, :]
    local = np.zeros((LOCALS, *start.shape[1:]))
    per_bin = round(BIN_S / data.dt_s)
    for _ in range(_TURNS):
        predicted = rollout.roll_out(segment_model, data, start, theta_scaled[:, None], local)[:, 6:9, 0]
        short = data.rate_frd - np.transpose(predicted, (2, 0, 1))
        inner = 0.5 * (short[:, per_bin - 1 : -1 : per_bin] + short[:, per_bin::per_bin])
        edges = np.concatenate([np.zeros_like(short[:, :1]), inner, short[:, -1:]], axis=1)
        w = data.disturbance_frd.copy()
        w[:, :, 3:] += np.diff(edges, axis=1) / BIN_S
        data = data.with_w(w)
    return data


def _flown(segment_model: SegmentModel, fit: SegmentFit, theta_scaled: np.ndarray) -> np.ndarray:
    """(P, P) as `information`, of the fitted flights, linearised at theta_scaled (P,)."""
    lin = fit.lin
    if not np.array_equal(theta_scaled, fit.theta_scaled):
        grams = linearise.linearise(segment_model, fit.data, theta_scaled, fit.local, fit.basis)
        lin = linearise.project(grams, fit.data, theta_scaled, fit.local)
    return evidence.whitened(lin, fit.process, segment_model.space.prior).gram[1:, 1:]


def _carriers(space: ParameterSpace, found: Sequence[str], pair: Sequence[str]) -> list[str]:
    """Return what the pair's effects act through, the first that there is of each, where none of it was
    found.
    """
    out = []
    for name in pair:
        through = space.effect(name).requires_any
        if through and not set(through) & {*found, *pair}:
            out += [other for other in through if other in space.groups][:1]
    return list(dict.fromkeys(out))


def _along(vehicle: Vehicle, flat: np.ndarray, instruments: Instruments) -> Segments | None:
    """Segments of a flight that follows flat outputs (14, n) exactly; None where it is too short for one."""
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
    a = pre + steps * np.arange(count)
    take = a[:, None] + np.arange(steps)
    long = a[:, None] + np.arange(-pre, steps)
    n = (count, steps)
    start, slope = instruments.voltage
    # A measurement in a share of the steps tells as much as one in each of that share's weight.
    pose, gyro, accelerometer = np.sqrt(instruments.shares)
    return Segments(
        dt_s=DT_S,
        flight=np.zeros(count, dtype=int),
        start_s=a * DT_S,
        x0=np.column_stack([flat[0:3, a].T, flat[3:6, a].T, rpy[a], rate[a]]),
        p_ned=flat[0:3].T[take],
        R_ned_frd=R[take],
        shift_s=np.zeros(n),
        pose_weight=np.full(n, pose),
        rate_frd=rate[take],
        rate_weight=np.full(n, gyro),
        force_frd=np.zeros((*n, 3)),
        force_weight=np.full(n, accelerometer),
        command=command[long],
        voltage_ratio=start + slope * DT_S * take,
        sigma=np.repeat(instruments.sigma[None], count, axis=0),
        disturbance_frd=np.zeros((count, round(SEGMENT_S / BIN_S), 6)),
        path_start_s=a * DT_S,
        paths=np.column_stack([flat[0:3].T, flat[3:6].T, rpy, rate])[None, :: round(PATH_S / DT_S)],
        in_newton=instruments.in_newton,
        rate_driven=instruments.rate_driven,
    )


def flat_commands(vehicle: Vehicle, flat: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rotor thrusts (n, 4) N, R_ned_frd (n, 9) and body rate (n, 3) of flat outputs (14, n) each DT_S."""
    snap = np.gradient(flat[9:12], DT_S, axis=1)
    body = Body(vehicle.mass_kg, vehicle.inertia_kg_m2)
    R, rate, _, collective, torque = flat_full(
        NUMPY, list(flat[6:9]), list(flat[9:12]), list(snap), flat[12], flat[13], body
    )
    shape = flat.shape[1]
    wanted = np.array([np.broadcast_to(row, shape) for row in (collective, *torque)])
    attitude = np.array([np.broadcast_to(row, shape) for row in R]).T
    return (
        (allocation_inverse(vehicle) @ wanted).T,
        attitude,
        np.array([np.broadcast_to(r, shape) for r in rate]).T,
    )
