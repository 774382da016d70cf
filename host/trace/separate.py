"""Which flight would tell two effects apart: separation of an effect from its alias along candidate
references.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from firmware_model.law.allocation import allocation_matrix, invert4
from firmware_model.law.flatness import Body, flat_full
from firmware_model.law.rotations import matrix_to_euler
from host.codegen.ops import NUMPY
from host.trace import evidence, segments
from host.trace.data import DT_S, LAGS, SEGMENT_S
from host.trace.diagnose import Fit
from host.trace.form import Form
from host.trace.parameters import Space
from host.trace.segments import BIN_S, PATH_S, Segments
from host.vehicle import Vehicle


@dataclass(frozen=True, kw_only=True)
class NextFlight:
    """A flight that would decide: its route, the two effects it separates, and by how many sigma."""

    route: str
    separates: tuple[str, str]
    expected_sigma: float


def separation(fit_lin: evidence.Linearisation, fit: Fit, space: Space, effect: str, alias: str) -> float:
    """Sigma by which `effect`, of the size fitted, stands out where `alias` may take any value.

    lambda^2 = theta' S' (I - P_alias) S theta in whitened, nuisance-free units.
    """
    groups = space.groups
    mine, other = list(groups[effect]), list(groups[alias])
    rest = [i for i in range(len(space.columns)) if i not in mine and i not in other]
    gram = evidence.whitened(fit_lin, fit.process, space.prior).gram[1:, 1:].copy()
    gram[rest, rest] += 1.0 / space.prior.spike[rest] ** 2
    taken = other + rest
    inner = gram[np.ix_(taken, taken)] + 1e-9 * np.eye(len(taken))
    cross = gram[np.ix_(taken, mine)]
    information = gram[np.ix_(mine, mine)] - cross.T @ np.linalg.solve(inner, cross)
    size = fit.z[mine]
    return float(np.sqrt(max(size @ information @ size, 0.0)))


def propose(
    form: Form, fit: Fit, effect: str, alias: str, flown: Mapping[str, np.ndarray]
) -> NextFlight | None:
    """The manoeuvre of the greatest separation; `flown` gives flat outputs (14, n) each DT_S by route
    name.
    """
    best: NextFlight | None = None
    for route, flat in flown.items():
        data = _along(form.vehicle, flat, fit)
        if data is None:
            continue
        local = np.zeros((1, segments.LOCALS))
        kept = segments.basis(form, data, fit.z, local)
        grams = segments.linearise(form, data, fit.z, local, kept)
        lin = segments.project(grams, data, fit.z, local)
        sigma = separation(lin, fit, form.space, effect, alias)
        if best is None or sigma > best.expected_sigma:
            best = NextFlight(route=route, separates=(effect, alias), expected_sigma=sigma)
    return best


def _along(vehicle: Vehicle, flat: np.ndarray, fit: Fit) -> Segments | None:
    """Segments of a flight that follows flat outputs (14, n) exactly, with the fitted flights' noise."""
    steps = round(SEGMENT_S / DT_S)
    pre = max(1, int(np.ceil(LAGS * vehicle.motor_lag_s / DT_S)))
    count = (flat.shape[1] - pre - 1) // steps
    if count < 1:
        return None
    thrust, R, rate = flat_commands(vehicle, flat)
    if fit.data.in_newton:
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
    felt = bool(fit.data.force_weight.any())
    return Segments(
        dt_s=DT_S,
        flight=np.zeros(count, dtype=int),
        start_s=a * DT_S,
        x0=np.column_stack([flat[0:3, a].T, flat[3:6, a].T, rpy[a], rate[a]]),
        position=flat[0:3].T[take],
        attitude=R[take],
        shift_s=np.zeros(n),
        pose_weight=np.ones(n),
        rate=rate[take],
        rate_weight=np.full(n, 0.0 if fit.data.rate_driven else 1.0),
        force=np.zeros((*n, 3)),
        force_weight=np.full(n, 1.0 if felt else 0.0),
        command=command[long],
        voltage_ratio=np.full(n, float(np.median(fit.data.voltage_ratio))),
        sigma=np.repeat(fit.data.sigma.mean(0, keepdims=True), count, axis=0),
        w=np.zeros((count, round(SEGMENT_S / BIN_S), 6)),
        path_start_s=a * DT_S,
        paths=np.column_stack([flat[0:3].T, flat[3:6].T, rpy, rate])[None, :: round(PATH_S / DT_S)],
        in_newton=fit.data.in_newton,
        rate_driven=fit.data.rate_driven,
    )


def flat_commands(vehicle: Vehicle, flat: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rotor thrusts (n, 4) N, R_ned_frd (n, 9) and body rate (n, 3) of flat outputs (14, n) each DT_S."""
    rotors = vehicle.rotors
    matrix = allocation_matrix(
        [r.position_m for r in rotors], [r.spin_sign for r in rotors], vehicle.torque_per_thrust_m
    )
    snap = np.gradient(flat[9:12], DT_S, axis=1)
    body = Body(vehicle.mass_kg, vehicle.inertia_kg_m2)
    R, rate, _, collective, torque = flat_full(
        NUMPY, list(flat[6:9]), list(flat[9:12]), list(snap), flat[12], flat[13], body
    )
    inverse = np.array(invert4(matrix)).reshape(4, 4)
    shape = flat.shape[1]
    wanted = np.array([np.broadcast_to(row, shape) for row in (collective, *torque)])
    attitude = np.array([np.broadcast_to(row, shape) for row in R]).T
    return (inverse @ wanted).T, attitude, np.array([np.broadcast_to(r, shape) for r in rate]).T
