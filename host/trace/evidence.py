"""Log evidence of sets of effects from whitened, linearised segments.

The residual of a segment is r = X dx0 + S dtheta + L dl + Z w + e:

- e: sensor noise of unit variance;
- dx0: free initial state, projected out before the Grams reach this module;
- dtheta: change of theta_scaled, the scaled parameters;
- dl: change of the nuisances of the flight;
- w: process disturbance, six components (force and torque) in each bin of 0.1 s.

Only the Gram matrix of [r | S | L | Z] of each segment is kept, so the evidence of any set of effects costs
one small solve. The prior is spike and slab. A parameter of an effect that is not selected moves within
its tolerance and discrepancy combined. A parameter of a selected effect has a standard deviation of
RULES.slab_sigma typical sizes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated

import numpy as np
from scipy.optimize import minimize

from trimtab.host.trace.decision.rules import RULES

FORCE_LIMITS = (-14.0, 6.0)
"""Search range of the log variances of force, (m/s^2)^2."""
TORQUE_LIMITS = (-14.0, 12.0)
"""Search range of the log variance of torque, (rad/s^2)^2 or (rad/s)^2."""


@dataclass(frozen=True, kw_only=True)
class DisturbanceVariances:
    """Log variances of the process disturbance, FRD.

    log_lateral, log_axial: specific force across and along the thrust, (m/s^2)^2. They differ because thrust
    errors act along the thrust. log_torque: angular acceleration, (rad/s^2)^2. In rate-driven mode (torque
    unknown; the measured body rate replaces the torque model) it is a body-rate error, (rad/s)^2.
    """

    log_lateral: float
    log_axial: float
    log_torque: float

    def sigma(self) -> Annotated[np.ndarray, "6"]:
        """Return standard deviations of the disturbance, FRD: force x, y, z, torque x, y, z."""
        logs = [self.log_lateral] * 2 + [self.log_axial] + [self.log_torque] * 3
        return np.exp(0.5 * np.array(logs))

    def covariance(self, bins: int) -> Annotated[np.ndarray, "disturbances disturbances"]:
        """Return the covariance of the disturbance, ordered by bin, then component."""
        return np.kron(correlation(bins), np.diag(self.sigma() ** 2))


def correlation(bins: int) -> Annotated[np.ndarray, "bins bins"]:
    """Return the correlation of the disturbance between bins."""
    lag = np.abs(np.subtract.outer(np.arange(bins), np.arange(bins)))
    return RULES.disturbance_correlation**lag


@dataclass(frozen=True, kw_only=True)
class Linearisation:
    """Grams of [r | S | L | Z] of every segment at one point, with initial states projected out.

    flight: index of the flight of each segment. theta_scaled: scaled parameters. nuisances: sensor and flight
    errors that are constant over a flight. Z has six columns for each bin.
    """

    gram: Annotated[np.ndarray, "segments all_columns all_columns"]
    flight: Annotated[np.ndarray, "segments"]
    theta_scaled: Annotated[np.ndarray, "parameters"]
    nuisances: Annotated[np.ndarray, "flights nuisances"]

    @property
    def parameters(self) -> int:
        """Number of scaled parameters."""
        return len(self.theta_scaled)

    @property
    def bins(self) -> int:
        """Number of disturbance bins in a segment."""
        return (self.gram.shape[1] - 1 - self.parameters - self.nuisances.shape[1]) // 6

    @cached_property
    def by_innovations(
        self,
    ) -> tuple[
        Annotated[np.ndarray, "segments innovations innovations"],
        Annotated[np.ndarray, "segments innovations columns"],
    ]:
        """Grams Z' Z and Z' [r | S | L] of the innovations.

        The innovations of the bins are independent, so their covariance is diagonal for every process.
        """
        n = 1 + self.parameters + self.nuisances.shape[1]
        root = np.kron(np.linalg.cholesky(correlation(self.bins)), np.eye(6))
        return root.T @ self.gram[:, n:, n:] @ root, root.T @ self.gram[:, n:, :n]


@dataclass(frozen=True, kw_only=True)
class Prior:
    """Prior standard deviations of parameters and nuisances.

    groups: column indices of each candidate or adjustment. spike: standard deviation of each parameter,
    scaled, if its effect is not selected. nuisance_sigma: those of a flight's nuisances, in physical units.
    """

    groups: dict[str, tuple[int, ...]]
    spike: Annotated[np.ndarray, "parameters"]
    nuisance_sigma: Annotated[np.ndarray, "nuisances"]

    def precision(self, selected: Sequence[str]) -> Annotated[np.ndarray, "parameters"]:
        """Return the prior precision, scaled, if the effects `selected` are in the model."""
        sigma = self.spike.copy()
        for name in selected:
            for column in self.groups[name]:
                sigma[column] = max(RULES.slab_sigma, sigma[column])
        return 1.0 / sigma**2


@dataclass(frozen=True, kw_only=True)
class MarginalGrams:
    """Grams of [r | S] with the disturbance and the nuisances of the flights integrated out.

    gram: sum over all flights. log_det: log determinant of the noise covariance with the nuisances integrated
    out. flight_grams: the same Grams for each flight, without the constant (nuisances / nuisance_sigma)^2 in
    gram[0, 0]. nuisance_gram: Grams of [r | S | L], from which `nuisance_step` solves for the nuisances.
    """

    gram: Annotated[np.ndarray, "columns columns"]
    log_det: float
    flight_grams: Annotated[np.ndarray, "flights columns columns"]
    nuisance_gram: Annotated[np.ndarray, "flights all_columns all_columns"]


def marginal_grams(lin: Linearisation, process: DisturbanceVariances, prior: Prior) -> MarginalGrams:
    """Return the Grams with disturbance and nuisances integrated out.

    The noise covariance is I + Z Q Z', with Q the covariance of `process`; Woodbury's identity inverts it.
    Then the nuisances of each flight are integrated out under `prior`.
    """
    count, width = lin.nuisances.shape
    m = 1 + lin.parameters
    n = m + width
    square, cross = lin.by_innovations
    sigma = np.tile(process.sigma(), lin.bins)
    inner = np.eye(6 * lin.bins) + square * np.outer(sigma, sigma)
    cross = cross * sigma[:, None]
    each = lin.gram[:, :n, :n] - np.swapaxes(cross, 1, 2) @ np.linalg.solve(inner, cross)
    flights = np.stack([each[lin.flight == flight].sum(0) for flight in range(count)])
    log_det = float(2.0 * np.log(np.einsum("sii->si", np.linalg.cholesky(inner))).sum())
    precision = 1.0 / prior.nuisance_sigma**2
    inner = flights[:, m:, m:] + np.diag(precision)
    rhs = flights[:, m:, :m].copy()
    rhs[:, :, 0] -= precision * lin.nuisances
    flight_grams = flights[:, :m, :m] - np.swapaxes(rhs, 1, 2) @ np.linalg.solve(inner, rhs)
    gram = flight_grams.sum(0)
    gram[0, 0] += float((precision * lin.nuisances**2).sum())
    log_det += float(np.linalg.slogdet(inner)[1].sum() - count * np.log(precision).sum())
    return MarginalGrams(gram=gram, log_det=log_det, flight_grams=flight_grams, nuisance_gram=flights)


def nuisance_step(
    lin: Linearisation, white: MarginalGrams, prior: Prior, step: Annotated[np.ndarray, "parameters"]
) -> Annotated[np.ndarray, "flights nuisances"]:
    """Return the step of the nuisances if the scaled parameters move by `step`."""
    m = 1 + lin.parameters
    precision = 1.0 / prior.nuisance_sigma**2
    inner = white.nuisance_gram[:, m:, m:] + np.diag(precision)
    rhs = white.nuisance_gram[:, m:, 0] - white.nuisance_gram[:, m:, 1:m] @ step - precision * lin.nuisances
    return np.linalg.solve(inner, rhs[:, :, None])[:, :, 0]


def log_evidence(
    gram: Annotated[np.ndarray, "columns columns"],
    log_det: float,
    theta_scaled: Annotated[np.ndarray, "parameters"],
    precision: Annotated[np.ndarray, "parameters"],
    count: int,
    limits: tuple[Annotated[np.ndarray, "parameters"], Annotated[np.ndarray, "parameters"]],
) -> float:
    """Return log evidence plus log prior of a set of effects in a linearisation, in nats, up to a constant.

    gram: of the whitened [r | S], linearised at theta_scaled. log_det: log determinant of the covariance by
    which they were whitened. precision: of the prior of the set, scaled. count: number of effects in the set.
    The quadratic is evaluated at the best point within `limits`, the lower and upper bounds: an effect cannot
    gain evidence from a value outside its physical bounds.
    """
    rhs = gram[0, 1:] - precision * theta_scaled
    normal = gram[1:, 1:] + np.diag(precision)
    chol = np.linalg.cholesky(normal)
    half = np.linalg.solve(chol, rhs)
    quadratic = gram[0, 0] + precision @ (theta_scaled * theta_scaled) - half @ half
    free = np.linalg.solve(chol.T, half)
    bounded_step = minimise_in_box(normal, free, limits[0] - theta_scaled, limits[1] - theta_scaled)
    excess = bounded_step - free
    quadratic += excess @ normal @ excess
    occam = 2.0 * np.log(np.diag(chol)).sum() - np.log(precision).sum()
    return float(-0.5 * (quadratic + occam + log_det) + RULES.prior_log_odds * count)


def minimise_in_box(
    normal: Annotated[np.ndarray, "parameters parameters"],
    minimum: Annotated[np.ndarray, "parameters"],
    lower: Annotated[np.ndarray, "parameters"],
    upper: Annotated[np.ndarray, "parameters"],
) -> Annotated[np.ndarray, "parameters"]:
    """Return an approximate minimiser of a quadratic between `lower` and `upper`.

    normal: Hessian of the quadratic. minimum: its unconstrained minimum. Components that cross a bound are
    fixed there, and the others are solved again until none crosses.
    """
    fixed, at = np.zeros(len(minimum), dtype=bool), minimum
    while ((at < lower) | (at > upper)).any():
        fixed |= (at < lower) | (at > upper)
        at = np.where(fixed, np.clip(minimum, lower, upper), 0.0)
        free = ~fixed
        shift = normal[np.ix_(free, fixed)] @ (at - minimum)[fixed]
        at[free] = minimum[free] - np.linalg.solve(normal[np.ix_(free, free)], shift)
        at = np.where(fixed, np.clip(at, lower, upper), at)
    return at


def posterior(
    gram: Annotated[np.ndarray, "columns columns"],
    theta_scaled: Annotated[np.ndarray, "parameters"],
    precision: Annotated[np.ndarray, "parameters"],
) -> tuple[Annotated[np.ndarray, "parameters"], Annotated[np.ndarray, "parameters parameters"]]:
    """Return the step to the posterior mean and the posterior covariance, scaled.

    gram: of the whitened [r | S], linearised at theta_scaled. precision: of the prior.
    """
    covariance = np.linalg.inv(gram[1:, 1:] + np.diag(precision))
    return covariance @ (gram[0, 1:] - precision * theta_scaled), covariance


def bounded_step(
    gram: Annotated[np.ndarray, "columns columns"],
    theta_scaled: Annotated[np.ndarray, "parameters"],
    precision: Annotated[np.ndarray, "parameters"],
    limits: tuple[Annotated[np.ndarray, "parameters"], Annotated[np.ndarray, "parameters"]],
) -> tuple[Annotated[np.ndarray, "parameters"], Annotated[np.ndarray, "parameters parameters"]]:
    """Return the step to the best point within `limits`, and the posterior covariance, scaled.

    Arguments are those of `posterior`; limits: lower and upper bounds. The other parameters adapt to a
    parameter that stops at its bound. If the step of `posterior` were clipped instead, they would not.
    """
    step, covariance = posterior(gram, theta_scaled, precision)
    normal = gram[1:, 1:] + np.diag(precision)
    return minimise_in_box(normal, step, limits[0] - theta_scaled, limits[1] - theta_scaled), covariance


def fit_process(
    lin: Linearisation, prior: Prior, selected: Sequence[str], start: DisturbanceVariances
) -> DisturbanceVariances:
    """Return the variances of greatest evidence for the set `selected`, searched by L-BFGS-B from `start`."""
    precision = prior.precision(selected)

    def process(point: np.ndarray) -> DisturbanceVariances:
        lateral, axial, torque = map(float, point)
        return DisturbanceVariances(log_lateral=lateral, log_axial=axial, log_torque=torque)

    def objective(point: np.ndarray) -> tuple[float, np.ndarray]:
        value, slope = _evidence_and_slope(lin, process(point), prior, precision)
        return -value, -slope

    optimum = minimize(
        objective,
        np.array([start.log_lateral, start.log_axial, start.log_torque]),
        jac=True,
        method="L-BFGS-B",
        bounds=(FORCE_LIMITS, FORCE_LIMITS, TORQUE_LIMITS),
        options={"gtol": 1.0, "ftol": 1e-10},
    )
    return process(optimum.x)


def _evidence_and_slope(
    lin: Linearisation, process: DisturbanceVariances, prior: Prior, precision: np.ndarray
) -> tuple[float, np.ndarray]:
    """Return the log evidence of a set and its gradient (3,) with respect to the log variances.

    precision: of the prior of the set. The derivative with respect to a log variance is half the sum of
    E[w^2 | data] - 1 over its innovations w, in units of sigma (Fisher's identity).
    """
    m = 1 + lin.parameters
    count, width = lin.nuisances.shape
    n = m + width
    disturbance_gram, cross = lin.by_innovations
    sigma = np.tile(process.sigma(), lin.bins)
    inner = np.eye(6 * lin.bins) + disturbance_gram * np.outer(sigma, sigma)
    cross = cross * sigma[:, None]
    inverse = np.linalg.inv(inner)
    gain = inverse @ cross
    each = lin.gram[:, :n, :n] - np.swapaxes(cross, 1, 2) @ gain
    flights = np.stack([each[lin.flight == flight].sum(0) for flight in range(count)])
    nuisance_precision = 1.0 / prior.nuisance_sigma**2
    # Unknowns other than the disturbance: the parameters, then the nuisances of every flight.
    size = lin.parameters + count * width
    A, b = np.zeros((size, size)), np.zeros(size)
    square = float((nuisance_precision * lin.nuisances**2).sum() + precision @ lin.theta_scaled**2)
    parameters = np.arange(lin.parameters)
    A[parameters, parameters] = precision
    b[parameters] = -precision * lin.theta_scaled
    for k, gram in enumerate(flights):
        at = np.r_[parameters, lin.parameters + k * width : lin.parameters + (k + 1) * width]
        A[np.ix_(at, at)] += gram[1:, 1:]
        b[at] += gram[1:, 0]
        columns = at[lin.parameters :]
        A[columns, columns] += nuisance_precision
        b[columns] -= nuisance_precision * lin.nuisances[k]
        square += gram[0, 0]
    covariance = np.linalg.inv(A)
    best = covariance @ b
    log_dets = 2.0 * np.log(np.einsum("sii->si", np.linalg.cholesky(inner))).sum()
    log_dets += np.linalg.slogdet(A)[1] - np.log(precision).sum() - count * np.log(nuisance_precision).sum()
    value = -0.5 * (square - b @ best + log_dets)

    power = np.zeros(6 * lin.bins)
    for k in range(count):
        segments = lin.flight == k
        at = np.r_[parameters, lin.parameters + k * width : lin.parameters + (k + 1) * width]
        mean = gain[segments, :, 0] - gain[segments, :, 1:] @ best[at]
        slopes = gain[segments, :, 1:]
        spread = np.einsum("szi,szi->sz", slopes @ covariance[np.ix_(at, at)], slopes)
        power += (mean**2 + np.einsum("szz->sz", inverse[segments]) + spread - 1.0).sum(0)
    by_channel = 0.5 * power.reshape(lin.bins, 6).sum(0)
    return float(value), np.array([by_channel[:2].sum(), by_channel[2], by_channel[3:].sum()])


def disturbances(
    lin: Linearisation,
    process: DisturbanceVariances,
    step: Annotated[np.ndarray, "parameters"],
    nuisances: Annotated[np.ndarray, "flights nuisances"],
) -> Annotated[np.ndarray, "segments bins 6"]:
    """Return the best linear prediction, FRD, of the disturbance.

    step, nuisances: changes from the linearisation. Force in m/s^2, then angular acceleration in rad/s^2 or,
    if the measured body rate drives the attitude, body rate in rad/s.
    """
    m = 1 + lin.parameters
    n = m + lin.nuisances.shape[1]
    rhs = lin.gram[:, n:, 0] - lin.gram[:, n:, 1:m] @ step
    rhs = rhs - np.einsum("szk,sk->sz", lin.gram[:, n:, m:n], nuisances[lin.flight])
    inner = lin.gram[:, n:, n:] + np.linalg.inv(process.covariance(lin.bins))
    return np.linalg.solve(inner, rhs[:, :, None])[:, :, 0].reshape(len(lin.gram), lin.bins, 6)
