"""Log evidence of sets of effects from whitened, linearised segments.

The residual of a segment is r = X dx0 + S dtheta + L dl + Z w + e:

- e: sensor noise of unit variance;
- dx0: free initial state, projected out before the Grams reach this module;
- dtheta: change of theta_scaled, the scaled parameters;
- dl: change of the nuisances of the flight;
- w: process disturbance, six components (force and torque) in each bin of 0.1 s.

Segments are reduced flight by flight: of the Gram matrix of [r | S | L | Z], the part without w is summed
over a flight, and the part of w is kept for each segment. So the evidence of any set of effects costs one
small solve. The prior is spike and slab. A parameter of an effect that is not selected moves within
its tolerance and discrepancy combined. A parameter of a selected effect is fitted with a standard deviation
of RULES.slab_sigma typical sizes. The order of magnitude of its size is not known beforehand, so the
evidence averages over smaller standard deviations too (`_gain_of_sizes`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Annotated

import numpy as np
from scipy.optimize import minimize

from trimtab.host.trace.bounds import exact_minimum, minimise_sums
from trimtab.host.trace.decision.rules import RULES
from trimtab.host.trace.linearisation import DisturbanceVariances, Linearisation, innovation_root

FORCE_LIMITS = (-14.0, 6.0)
"""Search range of the log variances of force, (m/s^2)^2."""
TORQUE_LIMITS = (-14.0, 12.0)
"""Search range of the log variance of torque, (rad/s^2)^2 or (rad/s)^2."""


_FIXED = 1e-3
"""Standard deviation, scaled, of a form that cannot act."""


@dataclass(frozen=True, kw_only=True)
class Prior:
    """Prior standard deviations of parameters and nuisances.

    groups: column indices of each candidate or adjustment. strengths: those of them that give the size of a
    candidate. forms: those of the form of its effect. spike: standard deviation of each parameter, scaled, if
    its effect is not selected, or if it belongs to a form. nuisance_sigma: those of a flight's nuisances, in
    physical units. added: for each column, the one to which it adds, so that the bounds are those of the sum;
    -1 for none. None if no column adds to another.
    """

    groups: dict[str, tuple[int, ...]]
    spike: Annotated[np.ndarray, "parameters"]
    nuisance_sigma: Annotated[np.ndarray, "nuisances"]
    forms: dict[str, tuple[int, ...]] = field(default_factory=dict)
    strengths: dict[str, tuple[int, ...]] = field(default_factory=dict)
    added: Annotated[np.ndarray, "parameters"] | None = None

    def precision(
        self, selected: Sequence[str], linearised_with: Sequence[str] = ()
    ) -> Annotated[np.ndarray, "parameters"]:
        """Return the prior precision, scaled, if the effects `selected` are in the model.

        The form of an effect deviates whether the effect is selected or within tolerance. But in a
        linearisation with effects that are not selected (`linearised_with`), the slopes of their forms are
        those of the full effect, so these forms are fixed.
        """
        sigma = self.spike.copy()
        for name in linearised_with:
            sigma[list(self.forms.get(name, ()))] = _FIXED
        for name in selected:
            for column in self.forms.get(name, ()):
                sigma[column] = self.spike[column]
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

    The nuisances of each flight are integrated out under `prior`.
    """
    count, m = len(lin.nuisances), 1 + lin.parameters
    sums = _without_disturbance(lin, process)
    flights = np.stack([flight_sums.gram for flight_sums in sums])
    log_det = sum(flight_sums.log_det for flight_sums in sums) + lin.freedom * np.log(lin.variance_factor)
    precision = 1.0 / prior.nuisance_sigma**2
    inner = flights[:, m:, m:] + np.diag(precision)
    rhs = flights[:, m:, :m].copy()
    rhs[:, :, 0] -= precision * lin.nuisances
    flight_grams = flights[:, :m, :m] - np.swapaxes(rhs, 1, 2) @ np.linalg.solve(inner, rhs)
    gram = flight_grams.sum(0)
    gram[0, 0] += float((precision * lin.nuisances**2).sum())
    log_det += float(np.linalg.slogdet(inner)[1].sum() - count * np.log(precision).sum())
    return MarginalGrams(gram=gram, log_det=log_det, flight_grams=flight_grams, nuisance_gram=flights)


def variance_factor(
    lin: Linearisation, white: MarginalGrams, step: Annotated[np.ndarray, "parameters"]
) -> float:
    """Return the variance of the sensor noise over the stated one that is most probable after `step`.

    Up to RULES.usual_variance_factor it is 1. Beyond, the sensors or the equations have errors that the
    process disturbance does not describe, such as those of a motor controller within a logging interval.
    """
    gram = white.gram
    square = gram[0, 0] - 2.0 * gram[0, 1:] @ step + step @ gram[1:, 1:] @ step
    ratio = lin.variance_factor * float(square) / lin.freedom
    return max(1.0, ratio / RULES.usual_variance_factor)


def nuisance_step(
    lin: Linearisation, white: MarginalGrams, prior: Prior, step: Annotated[np.ndarray, "parameters"]
) -> Annotated[np.ndarray, "flights nuisances"]:
    """Return the step of the nuisances if the scaled parameters move by `step`."""
    m = 1 + lin.parameters
    precision = 1.0 / prior.nuisance_sigma**2
    inner = white.nuisance_gram[:, m:, m:] + np.diag(precision)
    rhs = white.nuisance_gram[:, m:, 0] - white.nuisance_gram[:, m:, 1:m] @ step - precision * lin.nuisances
    return np.linalg.solve(inner, rhs[:, :, None])[:, :, 0]


def log_evidences(
    gram: Annotated[np.ndarray, "columns columns"],
    log_det: float,
    theta_scaled: Annotated[np.ndarray, "parameters"],
    prior: Prior,
    sets: Sequence[Sequence[str]],
    limits: tuple[Annotated[np.ndarray, "parameters"], Annotated[np.ndarray, "parameters"]],
    linearised_with: Sequence[str] = (),
) -> list[float]:
    """Return log evidence plus log prior of sets of effects in a linearisation, in nats, up to a constant.

    gram: of the whitened [r | S], linearised at theta_scaled. log_det: log determinant of the covariance by
    which they were whitened. linearised_with: the effects in the model there. The quadratic is evaluated at
    the best point within `limits`, the lower and upper bounds: an effect cannot gain evidence from a value
    outside its physical bounds.
    """
    precision = np.stack([prior.precision(names, linearised_with) for names in sets])
    rhs = gram[0, 1:] - precision * theta_scaled
    normal = gram[1:, 1:] + precision[:, :, None] * np.eye(len(theta_scaled))
    chol, covariance = np.linalg.cholesky(normal), np.linalg.inv(normal)
    free = (covariance @ rhs[:, :, None])[:, :, 0]
    step = _minimise_within(normal, free, theta_scaled, limits, prior.added)
    excess = step - free
    quadratic = gram[0, 0] + precision @ (theta_scaled * theta_scaled) - (rhs * free).sum(1)
    quadratic += np.einsum("si,sij,sj->s", excess, normal, excess)
    occam = 2.0 * np.log(np.einsum("sii->si", chol)).sum(1) - np.log(precision).sum(1)
    odds = RULES.prior_log_odds * np.array([len(names) for names in sets])
    sizes = _gain_of_sizes(prior, sets, theta_scaled + step, covariance)
    return (-0.5 * (quadratic + occam + log_det) + odds + sizes).tolist()


def _gain_of_sizes(
    prior: Prior,
    sets: Sequence[Sequence[str]],
    mean: Annotated[np.ndarray, "sets parameters"],
    covariance: Annotated[np.ndarray, "sets parameters parameters"],
) -> Annotated[np.ndarray, "sets"]:
    """Return by how many nats the evidence changes if each effect may also be small.

    The prior of the strengths of an effect becomes an equal mixture of normal distributions, with a standard
    deviation of RULES.slab_sigma and with that halved up to RULES.slab_halvings times. The widest alone would
    hold an effect of a fifth of the typical size for improbable, the more so the more strengths it has.

    mean, covariance: of the posterior under the widest, of each set. The change is the mean, over that
    posterior, of the ratio of the two priors. It is exact for each effect, and taken effect by effect.
    """
    widths = RULES.slab_sigma * 0.5 ** np.arange(RULES.slab_halvings + 1)
    added = (widths**-2 - RULES.slab_sigma**-2)[:, None, None]
    gain = np.zeros(len(sets))
    for name, columns in prior.strengths.items():
        rows = [row for row, names in enumerate(sets) if name in names]
        if not rows:
            continue
        variance, axes = np.linalg.eigh(covariance[np.ix_(rows, columns, columns)])
        square = np.einsum("sij,si->sj", axes, mean[np.ix_(rows, columns)]) ** 2
        narrowed = 1.0 + added * variance
        ratios = -np.log(widths / RULES.slab_sigma)[:, None, None] - 0.5 * (
            np.log(narrowed) + added * square / narrowed
        )
        gain[rows] += np.logaddexp.reduce(ratios.sum(2), axis=0) - np.log(len(widths))
    return gain


def _minimise_within(
    normal: Annotated[np.ndarray, "... parameters parameters"],
    minimum: Annotated[np.ndarray, "... parameters"],
    theta_scaled: Annotated[np.ndarray, "parameters"],
    limits: tuple[Annotated[np.ndarray, "parameters"], Annotated[np.ndarray, "parameters"]],
    added: Annotated[np.ndarray, "parameters"] | None,
) -> Annotated[np.ndarray, "... parameters"]:
    """Return the steps from theta_scaled to the minima of quadratics; added: of `Prior`."""
    if added is None:
        return exact_minimum(normal, minimum, limits[0] - theta_scaled, limits[1] - theta_scaled)
    return minimise_sums(normal, minimum, theta_scaled, limits, added)


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
    added: Annotated[np.ndarray, "parameters"] | None = None,
) -> tuple[Annotated[np.ndarray, "parameters"], Annotated[np.ndarray, "parameters parameters"]]:
    """Return the step to the best point within `limits`, and the posterior covariance, scaled.

    Arguments are those of `posterior`; limits: lower and upper bounds; added: of `Prior`. The other
    parameters adapt to a parameter that stops at its bound. If the step of `posterior` were clipped instead,
    they would not.
    """
    step, covariance = posterior(gram, theta_scaled, precision)
    normal = gram[1:, 1:] + np.diag(precision)
    return _minimise_within(normal, step, theta_scaled, limits, added), covariance


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


@dataclass(frozen=True, kw_only=True)
class _FlightSums:
    """Sums over the segments of a flight, with the disturbance integrated out.

    gram: of [r | S | L]. log_det: of the noise covariance. gains: for lateral force, axial force and torque,
    the Gram of the rows of the gain from [r | S | L] to the innovations, in units of sigma. spread: for the
    same, the sum of the posterior variances of the innovations minus 1.
    """

    gram: Annotated[np.ndarray, "columns columns"]
    log_det: float
    gains: Annotated[np.ndarray, "3 columns columns"]
    spread: Annotated[np.ndarray, "3"]


def _without_disturbance(
    lin: Linearisation, process: DisturbanceVariances, *, gains: bool = False
) -> list[_FlightSums]:
    """Return the sums of every flight; `gains` and `spread` are 0 unless `gains`.

    The noise covariance is I + Z Q Z', with Q the covariance of `process`; Woodbury's identity inverts it.
    """
    columns = lin.own.shape[1]
    sigma = np.tile(process.sigma(), lin.bins)
    channel = np.tile([0, 0, 1, 2, 2, 2], lin.bins)

    def sums(segments: np.ndarray, flight: int) -> _FlightSums:
        inner = np.eye(len(sigma)) + lin.square[segments] * np.outer(sigma, sigma)
        cross = lin.cross[segments] * sigma[:, None]
        inverse = np.linalg.inv(inner) if gains else None
        gain = np.linalg.solve(inner, cross) if inverse is None else inverse @ cross
        explained = cross.reshape(-1, columns).T @ gain.reshape(-1, columns)
        by_channel, spread = np.zeros((3, columns, columns)), np.zeros(3)
        if inverse is not None:
            variance = np.einsum("szz->z", inverse) - len(segments)
            for k in range(3):
                rows = gain[:, channel == k].reshape(-1, columns)
                by_channel[k], spread[k] = rows.T @ rows, variance[channel == k].sum()
        return _FlightSums(
            gram=lin.own[lin.piece_flight == flight].sum(0) - explained,
            log_det=float(2.0 * np.log(np.einsum("sii->si", np.linalg.cholesky(inner))).sum()),
            gains=by_channel,
            spread=spread,
        )

    return lin.each(sums)


def _evidence_and_slope(
    lin: Linearisation, process: DisturbanceVariances, prior: Prior, precision: np.ndarray
) -> tuple[float, np.ndarray]:
    """Return the log evidence of a set and its gradient (3,) with respect to the log variances.

    precision: of the prior of the set. The derivative with respect to a log variance is half the sum of
    E[w^2 | data] - 1 over its innovations w, in units of sigma (Fisher's identity). Unknowns other than the
    disturbance are the parameters and the nuisances of every flight; the latter are eliminated flight by
    flight.
    """
    m, (count, width) = 1 + lin.parameters, lin.nuisances.shape
    nuisance_precision = 1.0 / prior.nuisance_sigma**2
    sums = _without_disturbance(lin, process, gains=True)
    flights = np.stack([flight_sums.gram for flight_sums in sums])
    square = flights[:, 0, 0].sum() + (nuisance_precision * lin.nuisances**2).sum()
    square += precision @ lin.theta_scaled**2
    own = flights[:, m:, m:] + np.diag(nuisance_precision)
    own_rhs = flights[:, m:, 0] - nuisance_precision * lin.nuisances
    own_inverse = np.linalg.inv(own)
    to_own = own_inverse @ flights[:, m:, 1:m]
    normal = np.diag(precision) + (flights[:, 1:m, 1:m] - flights[:, 1:m, m:] @ to_own).sum(0)
    rhs = flights[:, 1:m, 0].sum(0) - precision * lin.theta_scaled - np.einsum("kip,ki->p", to_own, own_rhs)
    covariance = np.linalg.inv(normal)
    best = covariance @ rhs
    nuisances = np.einsum("kij,kj->ki", own_inverse, own_rhs) - to_own @ best
    square -= rhs @ best + np.einsum("ki,kij,kj->", own_rhs, own_inverse, own_rhs)
    log_dets = (
        sum(flight_sums.log_det for flight_sums in sums)
        + np.linalg.slogdet(normal)[1]
        - np.log(precision).sum()
    )
    log_dets += np.linalg.slogdet(own)[1].sum() - count * np.log(nuisance_precision).sum()

    slope = np.zeros(3)
    for flight, flight_sums in enumerate(sums):
        mean = np.concatenate([[1.0], -best, -nuisances[flight]])
        cross = -covariance @ to_own[flight].T
        spread = np.zeros((m + width, m + width))
        spread[1:m, 1:m], spread[1:m, m:], spread[m:, 1:m] = covariance, cross, cross.T
        spread[m:, m:] = own_inverse[flight] - to_own[flight] @ cross
        slope += 0.5 * (
            np.einsum("cij,ij->c", flight_sums.gains, np.outer(mean, mean) + spread) + flight_sums.spread
        )
    return -0.5 * float(square + log_dets), slope


def fit_noise(
    lin: Linearisation,
    prior: Prior,
    selected: Sequence[str],
    start: DisturbanceVariances,
    step_of: Callable[[MarginalGrams], Annotated[np.ndarray, "parameters"]],
) -> tuple[Linearisation, DisturbanceVariances, MarginalGrams]:
    """Fit the process disturbance and the variance of the sensor noise.

    Returns the linearisation with that variance, the process of greatest evidence and the Grams with both.
    prior, selected, start: as for `fit_process`. step_of: step of the scaled parameters, given the Grams,
    after which the residual is judged.
    """
    process = fit_process(lin, prior, selected, start)
    white = marginal_grams(lin, process, prior)
    factor = variance_factor(lin, white, step_of(white))
    if factor != lin.variance_factor:
        lin = lin.with_variance_factor(factor)
        process = fit_process(lin, prior, selected, process)
        white = marginal_grams(lin, process, prior)
    return lin, process, white


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
    root = innovation_root(lin.bins)
    precision = np.diag(1.0 / np.tile(process.sigma(), lin.bins) ** 2)

    def expected(segments: np.ndarray, flight: int) -> np.ndarray:
        rhs = lin.cross[segments] @ np.concatenate([[1.0], -step, -nuisances[flight]])
        innovations = np.linalg.solve(lin.square[segments] + precision, rhs[:, :, None])[:, :, 0]
        return (innovations @ root.T).reshape(-1, lin.bins, 6)

    out = np.empty((len(lin.piece), lin.bins, 6))
    out[np.argsort(lin.flight, kind="stable")] = np.concatenate(lin.each(expected))
    return out
