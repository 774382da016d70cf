"""Evidence for sets of effects from whitened, linearised segments.

A segment's residual is r = X dx0 + S dz + Z w + e with sensor noise e of unit variance, a free initial state
dx0 (projected out before it gets here), the scaled parameters theta_scaled of the library form and a process
disturbance w, force and torque in bins of 0.1 s. Only the Gram matrix of [r, S, Z] of a segment is kept, so
that any subset of effects costs one small solve. Spike and slab: a parameter whose effect is not selected
still moves within its declared tolerance; a selected one is free within twice its typical size.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.optimize import minimize

from trimtab.host.trace.decision.rules import RULES

FORCE_LIMITS = (-14.0, 6.0)
TORQUE_LIMITS = (-14.0, 12.0)


@dataclass(frozen=True, kw_only=True)
class Process:
    """Log variances of the process disturbance in body axes: lateral and axial specific force (m/s^2)^2, and
    angular acceleration (rad/s^2)^2 or, where the measured body rate drives the attitude, body rate
    (rad/s)^2.

    Axial stands apart because errors of the thrust act along the thrust.
    """

    log_lateral: float
    log_axial: float
    log_torque: float

    def sigma(self) -> np.ndarray:
        """Return standard deviations (6,) of the disturbance: force x, y, z, torque x, y, z."""
        logs = [self.log_lateral] * 2 + [self.log_axial] + [self.log_torque] * 3
        return np.exp(0.5 * np.array(logs))

    def covariance(self, bins: int) -> np.ndarray:
        """Covariance (6 bins, 6 bins) of the disturbance, bin by bin."""
        return np.kron(correlation(bins), np.diag(self.sigma() ** 2))


def correlation(bins: int) -> np.ndarray:
    """Correlation (bins, bins) of the disturbance between bins."""
    lag = np.abs(np.subtract.outer(np.arange(bins), np.arange(bins)))
    return RULES.disturbance_correlation**lag


@dataclass(frozen=True, kw_only=True)
class Linearisation:
    """Grams of [r | S | L | Z] by segment at one point, initial states already projected out.

    gram: (segments, 1 + P + K + 6 bins, same). flight: (segments,) index of the flight. z: (P,) scaled
    parameters. local: (flights, K) nuisances that are constant over a flight.
    """

    gram: np.ndarray
    flight: np.ndarray
    theta_scaled: np.ndarray
    local: np.ndarray

    @property
    def parameters(self) -> int:
        """Number P of scaled parameters."""
        return len(self.theta_scaled)

    @property
    def bins(self) -> int:
        """Number of disturbance bins in a segment."""
        return (self.gram.shape[1] - 1 - self.parameters - self.local.shape[1]) // 6

    @cached_property
    def by_innovations(self) -> tuple[np.ndarray, np.ndarray]:
        """Grams Z' Z (segments, 6 bins, 6 bins) and Z' [r | S | L] with the disturbance written by what is
        new in each bin: its covariance is then diagonal for every process.
        """
        n = 1 + self.parameters + self.local.shape[1]
        root = np.kron(np.linalg.cholesky(correlation(self.bins)), np.eye(6))
        return root.T @ self.gram[:, n:, n:] @ root, root.T @ self.gram[:, n:, :n]


@dataclass(frozen=True, kw_only=True)
class Prior:
    """Prior sigmas: spike (P,) of an effect left out, scaled; local (K,) of a flight's nuisances, physical.

    `groups` names the columns of each effect or adjustment.
    """

    groups: dict[str, tuple[int, ...]]
    spike: np.ndarray
    local: np.ndarray

    def precision(self, selected: Sequence[str]) -> np.ndarray:
        """Prior precision (P,) when the effects `selected` are in the model."""
        sigma = self.spike.copy()
        for name in selected:
            for column in self.groups[name]:
                sigma[column] = max(RULES.slab_sigma, sigma[column])
        return 1.0 / sigma**2


@dataclass(frozen=True, kw_only=True)
class Whitened:
    """Summed Gram (1 + P, 1 + P) of [r | S] with disturbance and flight nuisances integrated out.

    `log_det` completes the evidence. `flight_grams` (flights, 1 + P, 1 + P) are the same by flight, less the
    nuisances' own prior; `local_gram` (flights, 1 + P + K, same) keeps what the nuisances' posterior needs.
    """

    gram: np.ndarray
    log_det: float
    flight_grams: np.ndarray
    local_gram: np.ndarray


def whitened(lin: Linearisation, process: Process, prior: Prior) -> Whitened:
    """Return the Grams under the covariance I + Z Q Z' (Woodbury), then the nuisances of each flight
    integrated out.
    """
    count, width = lin.local.shape
    m = 1 + lin.parameters
    n = m + width
    square, cross = lin.by_innovations
    sigma = np.tile(process.sigma(), lin.bins)
    inner = np.eye(6 * lin.bins) + square * np.outer(sigma, sigma)
    cross = cross * sigma[:, None]
    each = lin.gram[:, :n, :n] - np.swapaxes(cross, 1, 2) @ np.linalg.solve(inner, cross)
    flights = np.stack([each[lin.flight == flight].sum(0) for flight in range(count)])
    log_det = float(2.0 * np.log(np.einsum("sii->si", np.linalg.cholesky(inner))).sum())
    precision = 1.0 / prior.local**2
    inner = flights[:, m:, m:] + np.diag(precision)
    rhs = flights[:, m:, :m].copy()
    rhs[:, :, 0] -= precision * lin.local
    own = flights[:, :m, :m] - np.swapaxes(rhs, 1, 2) @ np.linalg.solve(inner, rhs)
    gram = own.sum(0)
    gram[0, 0] += float((precision * lin.local**2).sum())
    log_det += float(np.linalg.slogdet(inner)[1].sum() - count * np.log(precision).sum())
    return Whitened(gram=gram, log_det=log_det, flight_grams=own, local_gram=flights)


def local_step(lin: Linearisation, white: Whitened, prior: Prior, step: np.ndarray) -> np.ndarray:
    """Step (flights, K) of the flights' nuisances when the parameters take `step` (P,)."""
    m = 1 + lin.parameters
    precision = 1.0 / prior.local**2
    inner = white.local_gram[:, m:, m:] + np.diag(precision)
    rhs = white.local_gram[:, m:, 0] - white.local_gram[:, m:, 1:m] @ step - precision * lin.local
    return np.linalg.solve(inner, rhs[:, :, None])[:, :, 0]


def log_evidence(
    gram: np.ndarray,
    log_det: float,
    theta_scaled: np.ndarray,
    precision: np.ndarray,
    count: int,
    limits: tuple[np.ndarray, np.ndarray],
) -> float:
    """Log evidence, up to a constant, of a set of `count` effects in the linearisation at theta_scaled.

    gram (1 + P, 1 + P) of the whitened [r | S], log_det of what whitened them. At the best point within
    `limits` (P,) of the scaled parameters: bounds of an effect are physics, and what only a value beyond
    them explains is not explained.
    """
    rhs = gram[0, 1:] - precision * theta_scaled
    normal = gram[1:, 1:] + np.diag(precision)
    chol = np.linalg.cholesky(normal)
    half = np.linalg.solve(chol, rhs)
    quadratic = gram[0, 0] + precision @ (theta_scaled * theta_scaled) - half @ half
    free = np.linalg.solve(chol.T, half)
    off = held(normal, free, limits[0] - theta_scaled, limits[1] - theta_scaled) - free
    quadratic += off @ normal @ off
    occam = 2.0 * np.log(np.diag(chol)).sum() - np.log(precision).sum()
    return float(-0.5 * (quadratic + occam + log_det) + RULES.prior_log_odds * count)


def held(normal: np.ndarray, step: np.ndarray, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
    """Where (P,) between `lower` and `upper` a quadratic of Hessian `normal` (P, P) that is least at `step`
    (P,) is least: what crosses a bound is put on it, the rest solved again.
    """
    fixed, at = np.zeros(len(step), dtype=bool), step
    while ((at < lower) | (at > upper)).any():
        fixed |= (at < lower) | (at > upper)
        at = np.where(fixed, np.clip(step, lower, upper), 0.0)
        free = ~fixed
        shift = normal[np.ix_(free, fixed)] @ (at - step)[fixed]
        at[free] = step[free] - np.linalg.solve(normal[np.ix_(free, free)], shift)
        at = np.where(fixed, np.clip(at, lower, upper), at)
    return at


def posterior(
    gram: np.ndarray, theta_scaled: np.ndarray, precision: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Step (P,) to the posterior mean and the posterior covariance (P, P), scaled units."""
    covariance = np.linalg.inv(gram[1:, 1:] + np.diag(precision))
    return covariance @ (gram[0, 1:] - precision * theta_scaled), covariance


def bounded(
    gram: np.ndarray, theta_scaled: np.ndarray, precision: np.ndarray, limits: tuple[np.ndarray, np.ndarray]
) -> tuple[np.ndarray, np.ndarray]:
    """As `posterior`, the step to the best point within `limits` (P,) of the scaled parameters.

    Cut off at a bound instead, a step would leave undone what it had meant to do beyond it.
    """
    step, covariance = posterior(gram, theta_scaled, precision)
    normal = gram[1:, 1:] + np.diag(precision)
    return held(normal, step, limits[0] - theta_scaled, limits[1] - theta_scaled), covariance


def fit_process(lin: Linearisation, prior: Prior, selected: Sequence[str], start: Process) -> Process:
    """Process variances of greatest evidence, searched from `start` (quasi-Newton in their logarithms)."""
    precision = prior.precision(selected)

    def process(point: np.ndarray) -> Process:
        lateral, axial, torque = map(float, point)
        return Process(log_lateral=lateral, log_axial=axial, log_torque=torque)

    def objective(point: np.ndarray) -> tuple[float, np.ndarray]:
        value, slope = _evidence_and_slope(lin, process(point), prior, precision)
        return -value, -slope

    found = minimize(
        objective,
        np.array([start.log_lateral, start.log_axial, start.log_torque]),
        jac=True,
        method="L-BFGS-B",
        bounds=(FORCE_LIMITS, FORCE_LIMITS, TORQUE_LIMITS),
        options={"gtol": 1.0, "ftol": 1e-10},
    )
    return process(found.x)


def _evidence_and_slope(
    lin: Linearisation, process: Process, prior: Prior, precision: np.ndarray
) -> tuple[float, np.ndarray]:
    """Log evidence of a set of prior `precision` (P,), and its slope (3,) in the process's log variances.

    The slope in a log variance is half the sum of E[w^2] - 1 over its innovations w, in units of their sigma,
    given the data (Fisher's identity).
    """
    m = 1 + lin.parameters
    count, width = lin.local.shape
    n = m + width
    square, cross = lin.by_innovations
    sigma = np.tile(process.sigma(), lin.bins)
    inner = np.eye(6 * lin.bins) + square * np.outer(sigma, sigma)
    cross = cross * sigma[:, None]
    inverse = np.linalg.inv(inner)
    gain = inverse @ cross
    each = lin.gram[:, :n, :n] - np.swapaxes(cross, 1, 2) @ gain
    flights = np.stack([each[lin.flight == flight].sum(0) for flight in range(count)])
    local_precision = 1.0 / prior.local**2
    # All unknowns but the disturbance at once: parameters, then every flight's nuisances.
    size = lin.parameters + count * width
    A, b = np.zeros((size, size)), np.zeros(size)
    square_of_rest = float((local_precision * lin.local**2).sum() + precision @ lin.theta_scaled**2)
    own = np.arange(lin.parameters)
    A[own, own] = precision
    b[own] = -precision * lin.theta_scaled
    for k, gram in enumerate(flights):
        at = np.r_[own, lin.parameters + k * width : lin.parameters + (k + 1) * width]
        A[np.ix_(at, at)] += gram[1:, 1:]
        b[at] += gram[1:, 0]
        nuisances = at[lin.parameters :]
        A[nuisances, nuisances] += local_precision
        b[nuisances] -= local_precision * lin.local[k]
        square_of_rest += gram[0, 0]
    covariance = np.linalg.inv(A)
    best = covariance @ b
    log_dets = 2.0 * np.log(np.einsum("sii->si", np.linalg.cholesky(inner))).sum()
    log_dets += np.linalg.slogdet(A)[1] - np.log(precision).sum() - count * np.log(local_precision).sum()
    value = -0.5 * (square_of_rest - b @ best + log_dets)

    power = np.zeros(6 * lin.bins)
    for k in range(count):
        mine = lin.flight == k
        at = np.r_[own, lin.parameters + k * width : lin.parameters + (k + 1) * width]
        mean = gain[mine, :, 0] - gain[mine, :, 1:] @ best[at]
        slopes = gain[mine, :, 1:]
        spread = np.einsum("szi,szi->sz", slopes @ covariance[np.ix_(at, at)], slopes)
        power += (mean**2 + np.einsum("szz->sz", inverse[mine]) + spread - 1.0).sum(0)
    by_channel = 0.5 * power.reshape(lin.bins, 6).sum(0)
    return float(value), np.array([by_channel[:2].sum(), by_channel[2], by_channel[3:].sum()])


def disturbances(lin: Linearisation, process: Process, step: np.ndarray, local: np.ndarray) -> np.ndarray:
    """Best linear prediction (segments, bins, 6) of the disturbance left by the model at theta_scaled + step.

    local: (flights, K) step of the flights' nuisances.
    """
    m = 1 + lin.parameters
    n = m + lin.local.shape[1]
    rest = lin.gram[:, n:, 0] - lin.gram[:, n:, 1:m] @ step
    rest = rest - np.einsum("szk,sk->sz", lin.gram[:, n:, m:n], local[lin.flight])
    inner = lin.gram[:, n:, n:] + np.linalg.inv(process.covariance(lin.bins))
    return np.linalg.solve(inner, rest[:, :, None])[:, :, 0].reshape(len(lin.gram), lin.bins, 6)
